"""Overcooked against the package ``overcooked-ai``: games that ``record_overcooked.py`` has had it play."""

from __future__ import annotations

import json
import zlib
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl import EnvSpec
from pearl_marl.envs.overcooked.kitchen import LAYOUTS, Kitchen
from pearl_marl.envs.overcooked.picture import COOKS, ONION, SIZE
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import call_reference, reference

Array = np.ndarray[Any, Any]
RECORDED = np.load(Path(__file__).with_name("overcooked.npz"))
CASES = sorted({key.split("/")[0] for key in RECORDED if "/" in key})
MEETINGS = sorted({key.split(": ")[0] for key in RECORDED if ": " in key})
SHAPING = 0.5
spec_of = pearl_marl.get_spec("Overcooked").with_options


def recorded(name: str) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return options, and arrays by step and game; states and checksums begin before the first step."""
    keys = "actions", "states", "paid", "shaped", "checks", "last_checks"
    arrays = {key: RECORDED[f"{name}/{key}"] for key in keys}
    arrays["states"] = np.bitwise_xor.accumulate(arrays["states"], 0)
    return json.loads(str(RECORDED[f"{name}/options"])), arrays


def rows_of(kitchen: Kitchen, state: list[Array]) -> Array:
    """Return states as the recorder writes them."""
    floor, bits = np.array(kitchen.floor), kitchen.item_bits
    soups = {code: 4 + code for code in kitchen.soups}
    items = np.full(1 << bits, 255)
    for code, item in ({0: 0, kitchen.onion: 1, kitchen.dish: 3} | soups).items():
        items[code] = item
    if kitchen.has_tomatoes:
        items[kitchen.tomato] = 2
    columns: list[Array] = []
    for cell, facing, holds in (state[:3], state[3:6]):
        columns += [*np.moveaxis(floor[cell], -1, 0), facing, items[holds]]
    planes = state[6 : 6 + bits]
    for cell in kitchen.cells("X"):
        k = kitchen.counters.index(cell) if cell in kitchen.counters else None
        lies = [] if k is None else [(plane >> k & 1) << bit for bit, plane in enumerate(planes)]
        columns.append(items[sum(lies, np.zeros_like(state[0]))])
    for cell in kitchen.cells("P"):
        k = 6 + bits + 2 * kitchen.pots.index(cell)
        soup, clock = state[k : k + 2]
        ticks = np.array(kitchen.times)[soup] + 2 - clock
        columns += [soup, np.where(clock == 0, 0, ticks)]
    return np.stack([np.broadcast_to(column, state[0].shape) for column in columns], -1).astype(np.uint8)


def state_of(kitchen: Kitchen, rows: Array, times: Array) -> list[Array]:
    """Return states of which these are the rows: the opposite of :func:`rows_of`."""
    codes = np.array([0, kitchen.onion, kitchen.tomato, kitchen.dish, *range(13)])
    cells = np.zeros((kitchen.width, kitchen.height), int)
    cells[tuple(np.array(kitchen.floor).T)] = np.arange(len(kitchen.floor))
    wide = rows.astype(np.int64)
    state: list[Array] = []
    for x, y, facing, item in (wide[:, :4].T, wide[:, 4:8].T):
        state += [cells[x, y], facing, codes[item]]
    counters, pots = kitchen.cells("X"), kitchen.cells("P")
    lying = dict(zip(counters, codes[wide[:, 8 : 8 + len(counters)]].T, strict=True))
    for bit in range(kitchen.item_bits):
        state.append(sum((lying[cell] >> bit & 1) << k for k, cell in enumerate(kitchen.counters)))
    for k in map(pots.index, kitchen.pots):
        soup, ticks = wide[:, 8 + len(counters) + 2 * k :].T[:2]
        state += [soup, np.where(ticks == 0, 0, np.array(kitchen.times)[soup] + 2 - ticks)]
    return [*state, np.minimum(times, 361)]


def replayed(spec: EnvSpec, actions: Array) -> tuple[list[Array], Array]:
    """Take the recorded actions; return all states, and the categories of both cooks."""
    state = [np.full(actions.shape[1], word) for word in call_reference(spec.positional.initial, ())]
    step, states, codes = reference(spec.positional.step), [state], []
    for both in actions.astype(np.int64):
        *state, code_0, code_1, over_0, over_1 = step(*state, *both.T)
        assert not np.any(over_0 | over_1)
        states.append(state)
        codes.append(np.stack([code_0, code_1], 1))
    return [np.stack(column) for column in zip(*states, strict=True)], np.stack(codes)


def layers_of(kitchen: Kitchen, words: list[Array]) -> Array:
    """Return the layers of observations, all at once: what ``unpack`` makes of them one by one."""
    *cooks, pots, urgent = words
    layers = np.zeros((len(urgent), kitchen.width, kitchen.height, 26), np.uint8)
    layers[..., 25] = urgent[:, None, None]
    for layer, kind in enumerate("PXOTDS", 10):
        for x, y in kitchen.cells(kind):
            layers[:, x, y, layer] = 1
    every = np.arange(len(urgent))

    def put(x: Any, y: Any, item: Array) -> None:
        others = kitchen.dish, kitchen.onion, kitchen.tomato
        for layer, other in enumerate(others, 22):
            layers[every, x, y, layer] = item == other
        soup = (item > 0) & ~np.isin(item, others)
        for layer, value in ((18, item & 3), (19, item >> 2), (21, 1)):
            layers[every, x, y, layer] = soup * value

    for k, (cell, facing, holds) in enumerate((cooks[:3], cooks[3:6])):
        x, y = np.array(kitchen.floor)[cell].T
        layers[every, x, y, k] = 1
        layers[every, x, y, 2 + 4 * k + facing] = 1
        put(x, y, holds)
    for k, (x, y) in enumerate(kitchen.counters):
        put(x, y, sum((plane >> k & 1) << bit for bit, plane in enumerate(cooks[6:])))
    time_bits = max(kitchen.times).bit_length()
    for x, y in kitchen.pots:
        soup, clock = (pots & (1 << kitchen.soup_bits) - 1), pots >> kitchen.soup_bits & (1 << time_bits) - 1
        pots = pots >> kitchen.soup_bits + time_bits
        for layer, value in enumerate((soup & 3, soup >> 2)):
            layers[:, x, y, 16 + layer] = np.where(clock == 0, value, 0)
            layers[:, x, y, 18 + layer] = np.where(clock > 0, value, 0)
        layers[:, x, y, 20], layers[:, x, y, 21] = np.maximum(clock, 1) - 1, clock == 1
    return layers


def seen(spec: EnvSpec, kitchen: Kitchen, state: list[Array], agent: int) -> Array:
    """Return the observations of all states, of which ``unpack`` has to make some too."""
    words = np.broadcast_arrays(*reference(spec.positional.observe, agent)(*state), state[0])[:-1]
    flat = [word.ravel() for word in words]
    layers = layers_of(kitchen, flat).reshape(len(flat[0]), -1)
    unpack = spec.positional.unpack
    assert unpack is not None
    row = np.empty(layers.shape[1], np.uint8)
    for i in np.random.default_rng(agent).choice(len(layers), 50):
        unpack(*(word[i] for word in flat), row)
        np.testing.assert_array_equal(row, layers[i])
    return layers.reshape(*state[0].shape, -1)


@pytest.mark.parametrize("name", CASES)
def test_games(name: str) -> None:
    """Every state, reward and observation is the package's."""
    options, package = recorded(name)
    spec, shaped = spec_of(**options), spec_of(**options, reward_shaping_factor=SHAPING)
    spec.check_golden(spec.functions)
    assert spec.max_cycles == options["horizon"] >= len(package["actions"])
    kitchen = LAYOUTS[options["layout"]]
    if options["cook_time"]:
        kitchen = kitchen.cooking(options["cook_time"])
    state, codes = replayed(spec, package["actions"])
    for t, rows in enumerate(rows_of(kitchen, state)):
        np.testing.assert_array_equal(rows, package["states"][t], f"states after step {t}")

    prices = np.array(kitchen.prices)
    np.testing.assert_array_equal(prices[codes % len(prices)], package["paid"][..., ::-1])
    together = package["paid"].sum(-1, keepdims=True) + np.zeros(2)
    np.testing.assert_array_equal(np.array(spec.rewards)[codes], together)
    np.testing.assert_array_equal(np.array(shaped.rewards)[codes], together + SHAPING * package["shaped"])

    views = [seen(spec, kitchen, state, agent) for agent in range(2)]
    checks = np.zeros(codes.shape[1], np.int64)
    for t, kept in enumerate(package["checks"]):
        for view in views:
            checks = np.array([zlib.crc32(row, check) for row, check in zip(view[t], checks, strict=True)])
        np.testing.assert_array_equal(checks & 255, kept, f"observations after step {t}")
    np.testing.assert_array_equal(checks, package["last_checks"])
    assert all(np.all(view <= spec.observation_space.high.max()) for view in views)  # type: ignore[attr-defined]


@pytest.mark.parametrize("layout", MEETINGS)
def test_meetings(layout: str) -> None:
    """Of kitchens where things lie anywhere, both cooks act at once."""
    keys = "actions", "before", "change", "times", "paid", "shaped", "checks"
    actions, before, change, times, paid, shaped, checks = (RECORDED[f"{layout}: {key}"] for key in keys)
    spec, kitchen = spec_of(layout=layout, reward_shaping_factor=SHAPING), LAYOUTS[layout]
    state = state_of(kitchen, before, times)
    np.testing.assert_array_equal(rows_of(kitchen, state), before)
    *state, code_0, code_1, _, _ = reference(spec.positional.step)(*state, *actions.T.astype(np.int64))
    np.testing.assert_array_equal(rows_of(kitchen, state), before ^ change)
    together = paid.sum(-1, keepdims=True) + SHAPING * shaped
    np.testing.assert_array_equal(np.array(spec.rewards)[np.stack([code_0, code_1], 1)], together)
    views = np.concatenate([seen(spec, kitchen, state, agent) for agent in range(2)], 1)
    np.testing.assert_array_equal([zlib.crc32(view) & 255 for view in views], checks)


def test_what_has_been_recorded() -> None:
    """All layouts, and in the games whatever can go wrong in a kitchen."""
    layouts, happened, soups = set(), Counter[str](), Counter[str]()
    for name in CASES:
        options, package = recorded(name)
        layouts.add(options["layout"])
        cooks = package["states"][..., :8].reshape(*package["states"].shape[:2], 2, 4).astype(np.int64)
        before, after, actions, paid = cooks[:-1], cooks[1:], package["actions"], package["paid"]
        step = np.array([(0, -1), (0, 1), (1, 0), (-1, 0), (0, 0), (0, 0)])[actions]
        ahead = before[..., :2] + step
        same = (ahead[:, :, 0] == ahead[:, :, 1]).all(-1)
        change = (ahead == before[:, :, ::-1, :2]).all((-1, -2))
        kitchen = LAYOUTS[options["layout"]]
        counters = package["states"][..., 8 : 8 + len(kitchen.cells("X"))]
        put_down, dish_down = (np.diff(lies.sum(-1), axis=0) > 0 for lies in (counters > 4, counters == 3))
        served = (before[..., 3] > 4) & (after[..., 3] == 0)
        happened["steps"] += actions.shape[0] * actions.shape[1]
        happened["both want one cell"] += int(same.sum())
        happened["both want to change places"] += int(change.sum())
        happened["both act"] += int((actions == 5).all(-1).sum())
        happened["ingredients potted"] += int((package["shaped"] == 3).sum())
        happened["soups taken"] += int((package["shaped"] == 5).sum())
        happened["soups put down"] += int(put_down.sum())
        happened["worthless soups served"] += int((served & (paid == 0) & ~put_down[..., None]).sum())
        happened["dishes put down"] += int(dish_down.sum())
        soups[options["layout"]] += int((paid > 0).sum())
    print(dict(happened), dict(soups))
    assert layouts == set(LAYOUTS)
    assert happened["steps"] >= 45_000
    assert min(happened.values()) >= 50
    assert sum(count >= 10 for count in soups.values()) >= 8


def test_tomatoes_are_none_of_the_others() -> None:
    """Each kitchen's items have numbers of their own."""
    for kitchen in LAYOUTS.values():
        others = [kitchen.onion, kitchen.dish, *([kitchen.tomato] if kitchen.has_tomatoes else [])]
        codes = [0, *kitchen.soups, *others]
        assert len(set(codes)) == len(codes)
        assert max(codes) < 1 << kitchen.item_bits


def test_other_actions_are_stays() -> None:
    spec = spec_of()
    state = call_reference(spec.positional.initial, ())
    stays = call_reference(spec.positional.step, [*state, 4, 4])
    for action in (6, 7):
        assert call_reference(spec.positional.step, [*state, action, action]) == stays


def test_shaped_rewards() -> None:
    """A factor of 0 leaves prices; each parameter is its own."""
    shaping = {"PLACEMENT_IN_POT_REW": 1, "DISH_PICKUP_REWARD": 2, "SOUP_PICKUP_REWARD": 4}
    spec = spec_of(reward_shaping_factor=2, rew_shaping_params=shaping)
    assert spec.rewards == (0, 20, 2, 22, 4, 24, 8, 28, 20, 40)
    assert spec_of(rew_shaping_params=shaping).rewards == (0, 20, 0, 20, 0, 20, 0, 20, 20, 40)
    assert spec_of(reward_shaping_factor=1, rew_shaping_params={"DISH_PICKUP_REWARD": 0}).rewards[2:8:2] == (
        3,
        0,
        5,
    )


def test_where_cooks_are_on_a_map() -> None:
    spec = spec_of(layout="large_room")
    env = pearl_marl.parallel_env("Overcooked", layout="large_room", device="reference")
    observations = env.reset_batch(seed=0)
    assert spec.grid is not None
    assert spec.grid.cell(observations).tolist() == [5 * 7 + 1, 1 * 7 + 5]
    assert (spec.grid.rows, spec.grid.columns) == (7, 7)


def test_pictures() -> None:
    """Cooks are where the state has them, and what they hold is seen."""
    pytest.importorskip("PIL")
    spec, kitchen = spec_of(), LAYOUTS["cramped_room"]
    assert spec.draw is not None
    start = tuple(call_reference(spec.positional.initial, ()))
    drawn = spec.draw(spec.layout.built(start))
    assert (drawn.shape, drawn.dtype) == ((4 * SIZE, 5 * SIZE, 3), np.uint8)

    def cells(drawn: Array, colour: tuple[int, int, int]) -> set[tuple[int, int]]:
        places = np.argwhere((drawn == colour).all(-1))
        return {(x // SIZE, y // SIZE) for y, x in places.tolist()}

    assert [cells(drawn, colour) for colour in COOKS] == [{kitchen.floor[k]} for k in kitchen.starts]
    boxes = set(kitchen.cells("O"))
    assert cells(drawn, ONION) == boxes
    holding = list(start)
    holding[2] = kitchen.onion
    assert cells(spec.draw(spec.layout.built(holding)), ONION) == {*boxes, kitchen.floor[kitchen.starts[0]]}
    lying = list(start)
    lying[8] = 1 << 3  # the highest of three bits, of the fourth counter
    assert cells(spec.draw(spec.layout.built(lying)), ONION) == {*boxes, kitchen.counters[3]}
    cooking = list(start)
    cooking[9:11] = 3, 12
    assert cells(spec.draw(spec.layout.built(cooking)), ONION) == {*boxes, *kitchen.pots}


REFUSED = {
    "layout is 'kitchen'; possible are 'cramped_room', ": {"layout": "kitchen"},
    r"layout is \[\]; possible are ": {"layout": []},
    "horizon is 0; it must be an integer from 1": {"horizon": 0},
    "cook_time is 255; it must be an integer from 1 to 254": {"cook_time": 255},
    "cook_time is 5, and simple_o has cooking times of its own": {"cook_time": 5, "layout": "simple_o"},
    "reward_shaping_factor is inf; it must be a finite number": {"reward_shaping_factor": float("inf")},
    "rew_shaping_params is 3; it must be None or a dict of PLACEMENT": {"rew_shaping_params": 3},
    "rew_shaping_params has 'POT_DISTANCE_REW'; possible are": {
        "rew_shaping_params": {"POT_DISTANCE_REW": 0}
    },
    r"rew_shaping_params\['DISH_PICKUP_REWARD'\] is '3'": {"rew_shaping_params": {"DISH_PICKUP_REWARD": "3"}},
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_is_refused(sentence: str) -> None:
    with pytest.raises(ArgumentError, match=sentence) as caught:
        spec_of(**REFUSED[sentence])
    assert "\n" not in str(caught.value)
