"""Strict PettingZoo lifetimes: an agent that ended sees its last observation, leaves, and stays away."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pearl_marl.devices import Reference
from pearl_marl.errors import ActionError, OrderError
from pearl_marl.testing.case import SIZE, Case, names_of, rows_of


class LifetimesContract:
    """Tests of agents that come and go."""

    @pytest.mark.parametrize("limit", [None, 9])
    def test_lifetimes_against_the_reference(self, case: Case, limit: int | None) -> None:
        """Exactly those agents act, and are answered, that have not ended yet.

        Actions are given as a dict and as an array in turns.
        """
        env = case.parallel(autoreset=False, max_cycles=limit)
        reference = case.open(device=Reference(), max_cycles=limit)
        for seed in (1, None):
            obs, _ = env.reset(seed=seed)
            first = reference.reset(seed=seed)
            np.testing.assert_array_equal(rows_of(obs.values(), first), first)
            assert env.agents == env.possible_agents
            live = np.ones(SIZE * case.agents, bool)
            for t, actions in enumerate(case.habits()):
                here = [f"agent_{i}" for i in np.flatnonzero(live)]
                assert env.agents == here
                asked = env.possible_agents if t % 4 == 0 else here  # what is given for others is ignored
                given = actions if t % 2 else {agent: actions[int(agent[6:])] for agent in asked}
                results: Any = env.step(given)
                # The slots of agents that left run on with any action: they begin again, unseen.
                theirs = reference.step(actions)
                expected = (theirs.arrivals(), theirs.rewards, theirs.terminations, theirs.truncations)
                for result, array in zip(results[:4], expected, strict=True):
                    assert list(result) == here, "exactly the agents that acted"
                    np.testing.assert_array_equal(rows_of(result.values(), array[live]), array[live])
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
                assert env.step({"agent_0": 0}) == ({}, {}, {}, {}, {}), "nobody is there to act"
                with pytest.raises(ActionError, match="there is no such agent"):
                    env.step({"agent_one": 0})

    def test_array_actions_of_agents_that_left_are_ignored(self, case: Case) -> None:
        """Their rows may hold anything: a policy over all slots has no use for looking who is there."""
        env, twin = (case.parallel(autoreset=False, max_cycles=0, seed=3) for _ in range(2))
        for t, actions in enumerate(case.actions(300)):
            live = np.isin(env.possible_agents, env.agents)
            odd = actions.astype(np.int64 if actions.dtype.kind == "u" else np.float64)
            odd[~live], actions[~live] = -7, 0
            ours: Any = env.step(odd)
            theirs: Any = twin.step(actions)
            assert env.agents == twin.agents
            for a, b in zip(ours[:4], theirs[:4], strict=True):
                np.testing.assert_array_equal(a.array, b.array)
            if not live.all() and t % 20 == 0:
                np.testing.assert_equal(ours, theirs)
            if env.num_agents < SIZE * case.agents // 2:
                return
        if env.num_agents == SIZE * case.agents:
            pytest.skip(f"no episode of {case.spec.name} ended in 300 steps of random actions")

    def test_autoreset_keeps_everyone(self, case: Case) -> None:
        """The default: whoever ends begins again."""
        env = case.parallel(max_cycles=3, seed=0)
        for actions in case.habits(10):
            env.step(actions)
            assert env.agents == env.possible_agents

    def test_max_cycles_can_be_assigned(self, case: Case) -> None:
        """As PettingZoo's own test does, before the first reset and later."""
        env = case.parallel(SIZE)
        env.max_cycles = 2  # few hands of Blackjack last longer
        assert env.max_cycles == 2
        env.reset(seed=0)
        assert env.agents == names_of(SIZE * case.agents)
        first, second = (env.step_batch(actions).truncations for actions in case.actions(2, SIZE))
        assert second.any()
        assert not first.any()
        env.max_cycles = None
        assert env.max_cycles == (case.spec.max_cycles or 0)
