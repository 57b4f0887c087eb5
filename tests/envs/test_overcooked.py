"""Overcooked against the package ``overcooked-ai``: games that ``record_overcooked.py`` has had it play."""

from __future__ import annotations

import json
import zlib
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pearl_marl.envs.overcooked.kitchen import LAYOUTS, Kitchen
from pearl_marl.envs.overcooked.step import NOTHING

import pearl_marl
from pearl_marl import EnvSpec
from pearl_marl.compiler.kernels import compile_kernels
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import call_reference, reference

Array = np.ndarray[Any, Any]
RECORDED = np.load(Path(__file__).with_name("overcooked.npz"))
CASES = sorted({key.split("/")[0] for key in RECORDED})
SHAPING = 0.5


def spec_of(**options: Any) -> EnvSpec:
    return pearl_marl.get_spec("Overcooked").with_options(**options)


def recorded(name: str) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return options, and arrays by step and game; states, checksums begin with what was before the first step."""
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
        columns += [*floor[cell].T, facing, items[holds]]
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


def replayed(spec: EnvSpec, kitchen: Kitchen, actions: Array, states: Array) -> tuple[list[Array], Array]:
    """Take the recorded actions; return all states and the categories of both, after looking at the states."""
    games = actions.shape[1]
    state = [np.full(games, word) for word in call_reference(spec.golden.initial, ())]
    step, seen, codes = reference(spec.golden.step), [state], []
    np.testing.assert_array_equal(rows_of(kitchen, state), states[0])
    for t, both in enumerate(actions):
        *state, code_0, code_1, over_0, over_1 = step(*state, *both.T.astype(np.int64))
        np.testing.assert_array_equal(rows_of(kitchen, state), states[t + 1], f"step {t + 1}")
        assert not np.any(over_0 | over_1)
        seen.append(state)
        codes.append(np.stack([code_0, code_1], 1))
    return [np.stack(column) for column in zip(*seen, strict=True)], np.stack(codes)


def delivered(spec: EnvSpec, state: list[Array], agent: int) -> Array:
    """Return the observations of all states, of shape ``(..., elements)``."""
    words = np.broadcast_arrays(*reference(spec.golden.observe, agent)(*state), state[0])[:-1]
    flat = [word.ravel().astype(f.dtype) for word, f in zip(words, spec.observation, strict=True)]
    observations = np.empty((state[0].size, spec.observation_size), np.uint8)
    compile_kernels(spec).deliver(*flat, observations)
    return observations.reshape(*state[0].shape, -1)


@pytest.mark.parametrize("name", CASES)
def test_games(name: str) -> None:
    """Every state, reward and observation is the package's."""
    options, package = recorded(name)
    spec, shaped = spec_of(**options), spec_of(**options, reward_shaping_factor=SHAPING)
    kitchen = LAYOUTS[options["layout"]]
    if options["cook_time"]:
        kitchen = kitchen.cooking(options["cook_time"])
    state, codes = replayed(spec, kitchen, package["actions"], package["states"])

    assert spec.max_cycles == options["horizon"] == len(codes)
    together = package["paid"].sum(-1, keepdims=True) + np.zeros(2)
    np.testing.assert_array_equal(np.array(spec.rewards)[codes], together)
    np.testing.assert_array_equal(np.array(shaped.rewards)[codes], together + SHAPING * package["shaped"])

    views = [delivered(spec, state, agent) for agent in range(2)]
    checks = np.zeros(codes.shape[1], np.int64)
    for t, kept in enumerate(package["checks"]):
        for view in views:
            checks = np.array([zlib.crc32(row, check) for row, check in zip(view[t], checks, strict=True)])
        np.testing.assert_array_equal(checks & 255, kept, f"observations after step {t}")
    np.testing.assert_array_equal(checks, package["last_checks"])
    assert all(np.all(view <= spec.observation_space.high.max()) for view in views)  # type: ignore[attr-defined]
