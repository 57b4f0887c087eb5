"""Observations as bytes of the words that they are made of."""

from __future__ import annotations

import numpy as np
import pytest

import pearl_marl
from pearl_marl.batch.actions import random_actions
from pearl_marl.compiler.packing import row_dtype
from pearl_marl.errors import ArgumentError

from ..sampling import KINDS, sampled

PACKING = [name for name in pearl_marl.list_envs() if pearl_marl.get_spec(name).unpack is not None]


def test_environments_with_planes_are_there() -> None:
    assert {"Seaquest", "ConnectFour", "Overcooked", "CoinGame"} <= set(PACKING)


@pytest.mark.parametrize("device", ["native", "reference", "rtl"])
@pytest.mark.parametrize("name", ["ConnectFour", pytest.param("Seaquest", marks=pytest.mark.exhaustive)])
def test_they_say_what_the_planes_say(name: str, device: str) -> None:
    spec, n, rng = pearl_marl.get_spec(name), 40, np.random.default_rng(0)
    whole = pearl_marl.parallel_env(name, n)
    packed = pearl_marl.parallel_env(name, n, device=device, observations="packed")
    seen = whole.reset_batch(seed=3), packed.reset_batch(seed=3)
    ended = 0
    for _ in range(60):
        assert seen[1].dtype == np.uint8
        assert seen[1].shape == (n, row_dtype(spec).itemsize)
        np.testing.assert_array_equal(pearl_marl.unpacked(spec, seen[1]), seen[0])
        actions = random_actions(spec, rng, n, whole.action_masks if spec.mask_fields else None)
        a, b = whole.step_batch(actions), packed.step_batch(actions)
        np.testing.assert_array_equal(a.rewards, b.rewards)
        final = pearl_marl.unpacked(spec, b.final_obs[b.ended])
        np.testing.assert_array_equal(final, a.final_obs[a.ended])
        ended += int(a.ended.sum())
        seen = a.obs, b.obs
    assert ended


@pytest.mark.parametrize("name", sampled(PACKING, KINDS))
def test_spaces(name: str) -> None:
    env = pearl_marl.parallel_env(name, observations="packed")
    observations, _ = env.reset(seed=0)
    for agent in env.agents:
        assert env.observation_space(agent).contains(observations[agent])


def test_of_a_vector_env() -> None:
    envs = pearl_marl.make_vec("Seaquest", 5, observations="packed")
    obs, _ = envs.reset(seed=0)
    assert envs.observation_space.contains(obs)
    assert obs.shape == (5, 69)


@pytest.mark.parametrize(
    ("name", "observations", "message"),
    [
        (
            "Taxi",
            "packed",
            r"observations is 'packed', and only planes can be, which Taxi's are not: leave it out",
        ),
        ("Seaquest", "bits", r"observations is 'bits'; possible are 'whole' and 'packed'"),
    ],
)
def test_refusals(name: str, observations: str, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        pearl_marl.parallel_env(name, observations=observations)


def test_what_is_never_packed() -> None:
    with pytest.raises(
        ArgumentError, match="only planes are packed, which CliffWalking's observations are not"
    ):
        pearl_marl.unpacked(pearl_marl.get_spec("CliffWalking"), np.zeros((3, 1), np.uint8))


@pytest.mark.parametrize("rows", [np.zeros((3, 68), np.uint8), np.zeros((3, 69)), np.zeros(69, np.uint8)])
def test_other_rows_are_refused(rows: np.ndarray) -> None:
    with pytest.raises(ArgumentError, match=r"Seaquest's are uint8 of the shape \(n, 69\)"):
        pearl_marl.unpacked(pearl_marl.get_spec("Seaquest"), rows)


def test_where_they_are_written() -> None:
    spec, rows = pearl_marl.get_spec("Seaquest"), np.zeros((3, 69), np.uint8)
    out = np.ones((3, *spec.observation_shape), spec.observation_dtype)
    assert pearl_marl.unpacked(spec, rows, out) is out
    assert np.array_equal(out, pearl_marl.unpacked(spec, rows))
    for other in (out[:2], out.view(np.uint8).astype(np.int16), np.asfortranarray(out)):
        with pytest.raises(
            ArgumentError, match=r"take a contiguous array of bool of the shape \(3, 10, 10, 10\)"
        ):
            pearl_marl.unpacked(spec, rows, other)
