"""CoinGame against the package ``jaxmarl``: episodes of ``record_coin_game.py``, with their draws."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import pearl_marl
from pearl_marl import EnvSpec
from pearl_marl.envs.coin_game.picture import BLUE_COLOUR, CELL, RED_COLOUR, draw
from pearl_marl.envs.coin_game.step import STAY
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import call_reference, reference

Array = np.ndarray[Any, Any]
RECORDED = np.load(Path(__file__).with_name("coin_game.npz"))
CASES = sorted({key.split("/")[0] for key in RECORDED if "/" in key})
PLACES = 3**8
DIGITS = 3 ** np.arange(7, -1, -1)
spec_of = pearl_marl.get_spec("CoinGame").with_options


def draws_of(numbers: Array) -> Array:
    """Return draws that decide on eight digits as this number has them."""
    return -(-(numbers.astype(np.int64) << 32) // PLACES)


def number(places: list[Array]) -> Array:
    """Return eight digits as one number."""
    return np.tensordot(DIGITS, np.stack(places), 1)


def recorded(name: str) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return what is known of a case, and arrays by step and episode."""
    keys = "actions", "draws", "rewards", "places", "seen"
    return json.loads(str(RECORDED[f"{name}/options"])), {key: RECORDED[f"{name}/{key}"] for key in keys}


def seen(spec: EnvSpec, state: list[Array], agent: int) -> Array:
    """Return the observations of all states, made one by one."""
    assert spec.positional.unpack is not None
    words = np.broadcast_arrays(*reference(spec.positional.observe, agent)(*state), state[0])[:-1]
    rows = np.empty((state[0].size, spec.observation_size), np.uint8)
    for *own, row in zip(*(word.ravel() for word in words), rows, strict=True):
        spec.positional.unpack(*own, row)
    return rows.reshape(*state[0].shape, -1)


@pytest.mark.parametrize("name", CASES)
def test_episodes(name: str) -> None:
    """Every state, reward, observation and end is the package's."""
    case, package = recorded(name)
    spec = spec_of(**case["options"])
    spec.check_golden(spec.functions)
    assert spec.observation_shape == tuple(case["shape"])
    assert spec.max_cycles == case["steps"] == len(package["actions"])
    state = list(call_reference(spec.positional.initial, [draws_of(package["places"][0])]))
    step, states, codes = reference(spec.positional.step), [np.broadcast_arrays(*state)], []
    for actions, numbers in zip(package["actions"], package["draws"], strict=True):
        *state, red, blue, over_0, over_1 = step(*state, *actions.T.astype(np.int64), draws_of(numbers))
        assert not np.any(over_0 | over_1)
        states.append(np.broadcast_arrays(*state))
        codes.append(np.stack([red, blue], 1))
    *places, time = (np.stack(column) for column in zip(*states, strict=True))
    inner = spec.options["num_inner_steps"]
    np.testing.assert_array_equal(number(places), package["places"])
    np.testing.assert_array_equal(time[:, 0], np.arange(len(time)) % inner)
    np.testing.assert_array_equal(np.float32(spec.rewards)[np.stack(codes)], package["rewards"])
    views = np.concatenate([seen(spec, [*places, time], agent) for agent in range(2)], -1)
    np.testing.assert_array_equal(np.packbits(views, -1), package["seen"])


def test_what_has_been_recorded() -> None:
    """Coins are taken by whom they are for and by the other, two at once, and one by two."""
    happened: Counter[str] = Counter()
    for name in CASES:
        _, package = recorded(name)
        places = package["places"].astype(np.int64)[..., None] // DIGITS % 3
        red, blue, red_coin, blue_coin = (places[..., k : k + 2] for k in range(0, 8, 2))
        happened["steps"] += package["draws"].size
        happened["players in one cell"] += int((red == blue).all(-1).sum())
        happened["coins in one cell"] += int((red_coin == blue_coin).all(-1).sum())
        happened["a player where a coin is"] += int((red == red_coin).all(-1).sum())
    _, package = recorded("default")
    for reward in (1, -2, -1, 2):
        happened[f"reward {reward}"] = int((package["rewards"] == reward).sum())
    print(dict(happened))
    assert happened["steps"] >= 10_000
    assert min(happened.values()) >= 20


def test_starts() -> None:
    """All starts are equally likely, as the package's are."""
    spec, n = spec_of(), 1 << 16
    draws = (np.arange(n) << 16) + (1 << 15)
    *places, time = call_reference(spec.positional.initial, [draws])
    counts = np.bincount(number(places), minlength=PLACES)
    assert not np.any(time)
    assert len(counts) == PLACES
    assert set(counts) == {n // PLACES, n // PLACES + 1}
    starts = RECORDED["starts"][:, None] // DIGITS % 3
    # Each number, and each pair of them, of the package's.
    for a in range(8):
        for b in range(a):
            pairs = np.bincount(starts[:, a] * 3 + starts[:, b], minlength=9)
            assert stats.chisquare(pairs).pvalue > 1e-5


def test_other_actions_are_stays() -> None:
    step, state = spec_of().positional.step, (0, 1, 2, 2, 1, 1, 0, 0, 3)
    stays = call_reference(step, [*state, STAY, STAY, 99])
    for action in (5, 6, 7):
        assert call_reference(step, [*state, action, action, 99]) == stays


def test_pictures() -> None:
    """Each player and coin is where the state has it."""
    pytest.importorskip("PIL")
    built = spec_of().layout.built
    drawn = draw(built((0, 1, 2, 2, 0, 1, 1, 0, 5)))
    assert (drawn.shape, drawn.dtype) == ((3 * CELL + 1, 3 * CELL + 1, 3), np.uint8)

    def has(colour: tuple[int, int, int], row: int, column: int) -> bool:
        cell = drawn[(2 - row) * CELL : (3 - row) * CELL, column * CELL : (column + 1) * CELL]
        return bool((cell == colour).all(-1).any())

    for row in range(3):
        for column in range(3):
            assert has(RED_COLOUR, row, column) == ((row, column) == (0, 1))
            assert has(BLUE_COLOUR, row, column) == ((row, column) in {(2, 2), (1, 0)})
    assert not np.array_equal(drawn, draw(built((0, 1, 2, 2, 2, 2, 1, 0, 5))))


REFUSED = {
    "num_inner_steps is 0; it must be an integer from 1": {"num_inner_steps": 0},
    "num_outer_steps is 1.0; it must be an integer from 1": {"num_outer_steps": 1.0},
    "cnn is 1; it must be True or False": {"cnn": 1},
    "payoff_matrix is \\[\\[1, 1\\], \\[1, 1, -2\\]\\]; it must be two rows": {
        "payoff_matrix": [[1, 1], [1, 1, -2]]
    },
    "payoff_matrix is .*nan.*; it must be two rows": {"payoff_matrix": [[1, 1, float("nan")], [1, 1, -2]]},
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_is_refused(sentence: str) -> None:
    with pytest.raises(ArgumentError, match=sentence) as caught:
        spec_of(**REFUSED[sentence])
    assert "\n" not in str(caught.value)
