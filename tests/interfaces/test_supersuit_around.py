"""SuperSuit's conversions and wrappers give the same numbers on our dicts as on plain ones."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from pettingzoo.utils import BaseParallelWrapper

import pearl_marl

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # SuperSuit tells of its successor, and imports what is deprecated
    supersuit = pytest.importorskip("supersuit", reason="SuperSuit is not installed")

pytestmark = [pytest.mark.usefixtures("toys"), pytest.mark.filterwarnings("ignore")]
N = 6


class PlainDicts(BaseParallelWrapper):
    """Returns what the environment returns, as dicts of Python's own."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return tuple(dict(part) for part in self.env.reset(seed=seed, options=options))

    def step(self, actions: dict[str, Any]) -> Any:
        return tuple(dict(part) for part in self.env.step(actions))


def pair(name: str, **arguments: Any) -> tuple[Any, Any]:
    ours, base = (pearl_marl.parallel_env(name, N, **arguments) for _ in range(2))
    return ours, PlainDicts(base)


def assert_same_play(ours: Any, plain: Any, n_actions: int, steps: int = 40) -> int:
    """Step two vector environments alike; return how many episodes ended."""
    np.testing.assert_equal(ours.reset(seed=3), plain.reset(seed=3))
    generator = np.random.default_rng(0)
    ends = 0
    for _ in range(steps):
        actions = generator.integers(n_actions, size=ours.num_envs)
        a, b = ours.step(actions), plain.step(actions)
        np.testing.assert_equal(a, b)
        ends += int(np.sum(a[2] | a[3]))
    return ends


@pytest.mark.parametrize("autoreset", [True, False])
@pytest.mark.parametrize(("name", "n_actions"), [("CliffWalking", 4), ("Drift", 5)])
def test_vec_env(name: str, n_actions: int, autoreset: bool) -> None:
    envs = [
        supersuit.pettingzoo_env_to_vec_env_v1(
            env if autoreset else supersuit.black_death_v3(env)  # the conversion wants constant agents
        )
        for env in pair(name, max_cycles=6, autoreset=autoreset)
        if autoreset or name == "Drift"
    ]
    if not envs:
        pytest.skip("black_death_v3 takes Box observations only")
    assert assert_same_play(*envs, n_actions) > N


@pytest.mark.parametrize(("name", "n_actions"), [("CliffWalking", 4), ("Drift", 5)])
def test_concatenated_vec_envs(name: str, n_actions: int) -> None:
    """Concatenation copies the environment by pickling it."""
    envs = [
        supersuit.concat_vec_envs_v1(
            supersuit.pettingzoo_env_to_vec_env_v1(env), 2, num_cpus=1, base_class="gymnasium"
        )
        for env in pair(name, max_cycles=6)
    ]
    assert envs[0].num_envs == 2 * N
    assert assert_same_play(*envs, n_actions) > N


@pytest.mark.parametrize(
    ("wrap", "autoreset"),
    [
        pytest.param(lambda env: supersuit.black_death_v3(env), False, id="black_death"),
        pytest.param(lambda env: supersuit.frame_stack_v1(env, 3), False, id="frame_stack"),
        pytest.param(lambda env: supersuit.frame_stack_v1(env, 3), True, id="frame_stack, autoreset"),
        pytest.param(lambda env: supersuit.frame_stack_v2(env, 3), True, id="frame_stack_v2, autoreset"),
        pytest.param(lambda env: supersuit.frame_skip_v0(env, (1, 4)), True, id="frame_skip, autoreset"),
        # It gives an action for agents that left on the way.
        pytest.param(lambda env: supersuit.frame_skip_v0(env, 4), False, id="frame_skip"),
        pytest.param(lambda env: supersuit.delay_observations_v0(env, 2), False, id="delay_observations"),
        pytest.param(lambda env: supersuit.max_observation_v0(env, 2), False, id="max_observation"),
        # These go through the AEC form, which has to have strict lifetimes.
        pytest.param(lambda env: supersuit.clip_reward_v0(env, -1, 1), False, id="clip_reward"),
        pytest.param(lambda env: supersuit.agent_indicator_v0(env), False, id="agent_indicator"),
        pytest.param(lambda env: supersuit.normalize_obs_v0(env), False, id="normalize_obs"),
        pytest.param(lambda env: supersuit.dtype_v0(env, np.float64), False, id="dtype"),
    ],
)
def test_wrappers(wrap: Any, autoreset: bool) -> None:
    ours, plain = (wrap(env) for env in pair("Drift", max_cycles=9, autoreset=autoreset))
    generator = np.random.default_rng(1)
    for seed in (4, None):
        np.testing.assert_equal(*(tuple(map(dict, env.reset(seed=seed))) for env in (ours, plain)))
        for _ in range(12):
            assert ours.agents == plain.agents
            actions = {agent: int(generator.integers(5)) for agent in ours.agents}
            if not actions:
                break
            np.testing.assert_equal(*(tuple(map(dict, env.step(actions))) for env in (ours, plain)))
        assert autoreset or not ours.agents
