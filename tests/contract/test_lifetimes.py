"""Strict PettingZoo lifetimes: an agent that ended sees its last observation, leaves, and stays away."""

from __future__ import annotations

import numpy as np
import pytest

from pearl_marl.devices import BatchConfig, Reference
from pearl_marl.errors import ActionError, OrderError

from ..helpers import SIZE, Case


@pytest.mark.parametrize("as_dict", [True, False])
@pytest.mark.parametrize("limit", [None, 9])
def test_against_the_reference(case: Case, limit: int | None, as_dict: bool) -> None:
    env = case.parallel(autoreset=False, max_cycles=limit)
    config = BatchConfig(spec=case.spec, n_envs=SIZE, max_cycles=limit)
    reference = Reference().open(config)
    for seed in (1, None):
        obs, _ = env.reset(seed=seed)
        np.testing.assert_array_equal(list(obs.values()), reference.reset(seed=seed))
        assert env.agents == env.possible_agents
        live = np.ones(SIZE, bool)
        for actions in case.habits(60):
            here = [f"agent_{i}" for i in np.flatnonzero(live)]
            assert env.agents == here
            given = {agent: actions[int(agent[6:])] for agent in here} if as_dict else actions
            results = env.step(given)
            # The slots of agents that left run on with any action: they begin again, unseen.
            theirs = reference.step(actions)
            last = np.where(
                theirs.ended.reshape(-1, *(1,) * (theirs.obs.ndim - 1)), theirs.final_obs, theirs.obs
            )
            expected = (last, theirs.rewards, theirs.terminations, theirs.truncations)
            for result, array in zip(results, expected, strict=False):
                assert list(result) == here, "exactly the agents that acted"
                np.testing.assert_array_equal(np.array(list(result.values())), array[live])
                np.testing.assert_array_equal(result.array, array[live])
            assert results[4] == {agent: {} for agent in here}
            live &= ~theirs.ended
            if not live.any():
                break
        if limit:
            assert not env.agents
            assert env.step({}) == ({}, {}, {}, {}, {}), "PettingZoo's convention"
            with pytest.raises(OrderError, match="every episode has ended"):
                env.step(actions)
            with pytest.raises(ActionError, match=r"agent_0.*its episode has ended"):
                env.step({"agent_0": 0})


def test_array_actions_of_agents_that_left_are_ignored(case: Case) -> None:
    """Their rows may hold anything: a policy over all slots has no use for looking who is there."""
    env, twin = (case.parallel(autoreset=False) for _ in range(2))
    for e in (env, twin):
        e.reset(seed=3)
    for actions in case.actions(300):
        live = np.isin(env.possible_agents, env.agents)
        odd = actions.astype(np.int64 if actions.dtype.kind == "u" else np.float64)
        odd[~live], actions[~live] = -7, 0
        for a, b in zip(env.step(odd), twin.step(actions), strict=True):
            assert a.keys() == b.keys()
            for agent in a:
                np.testing.assert_equal(a[agent], b[agent])
        if env.num_agents < SIZE // 2:
            break
    assert env.num_agents < SIZE


def test_autoreset_keeps_everyone(case: Case) -> None:
    env = case.parallel(max_cycles=3)
    env.reset(seed=0)
    for actions in case.habits(10):
        env.step(actions)
        assert env.agents == env.possible_agents


def test_max_cycles_can_be_assigned(case: Case) -> None:
    """As PettingZoo's own test does, before the first reset and later."""
    env = case.parallel(n_agents=3)
    env.max_cycles = 4
    assert env.max_cycles == 4
    env.reset(seed=0)
    ends = [env.step_batch(actions).truncations for actions in case.actions(4, 3)]
    assert ends[3].any()
    assert not np.any(ends[:3])
    env.max_cycles = None
    assert env.max_cycles == (case.spec.max_cycles or 0)
