"""``save_state``, ``load_state``, ``snapshot`` and ``restore``: the continuation is the same, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.devices import Native
from pearl_marl.testing.case import (
    SIZE,
    Case,
    assert_same_trajectory,
    by_mode,
    rows,
    trajectory,
)


class SavedStatesContract:
    """Tests of what can be stopped and continued."""

    @pytest.mark.parametrize("initial_states", ["random", "stored"])
    @pytest.mark.parametrize("limit", [0, 6])
    def test_a_fresh_environment_continues(self, case: Case, initial_states: str, limit: int) -> None:
        """And so does the one that went on in the meantime."""
        arguments: dict[str, Any] = {"max_cycles": limit, "initial_states": initial_states}
        env = case.parallel(**arguments, seed=6)
        last_obs = trajectory(env, case.actions(20))[-1].obs
        blob = env.save_state()
        assert isinstance(blob, bytes)
        expected = trajectory(env, case.actions(30, seed=1))

        fresh = case.parallel(**arguments)
        obs = fresh.load_state(blob)
        assert fresh.agents == fresh.possible_agents
        assert fresh.save_state() == blob
        np.testing.assert_array_equal(obs, last_obs)
        assert_same_trajectory(trajectory(fresh, case.actions(30, seed=1)), expected)
        assert fresh.save_state() == env.save_state()

        env.load_state(blob)  # and back again in the environment that went on
        assert_same_trajectory(trajectory(env, case.actions(30, seed=1)), expected)

    def test_the_unseeded_resets_continue_too(self, case: Case) -> None:
        """They are part of what a seed says."""
        env, fresh = case.parallel(seed=1), case.parallel()
        fresh.load_state(env.save_state())
        np.testing.assert_array_equal(env.reset_batch(), fresh.reset_batch())

    def test_the_reward_table_is_part_of_it(self, case: Case) -> None:
        """Where there is one."""
        if case.spec.rewards is None:
            pytest.skip(f"{case.spec.name} computes its rewards")
        env, fresh = case.parallel(seed=1), case.parallel()
        env.set_rewards([k / 3 for k in range(len(case.spec.rewards))])
        fresh.load_state(env.save_state())
        assert_same_trajectory(trajectory(env, case.actions(9)), trajectory(fresh, case.actions(9)))

    @by_mode
    def test_a_snapshot_is_of_its_moment(self, case: Case, mode: AutoresetMode) -> None:
        """It must not change with the device that it was taken from."""
        device = case.open(autoreset_mode=mode, max_cycles=5, seed=0)
        trajectory(device, case.actions(8))
        snapshot = device.snapshot()
        expected = trajectory(device, case.actions(20, seed=1))
        device.restore(snapshot)
        assert_same_trajectory(trajectory(device, case.actions(20, seed=1)), expected)
        other = case.open(autoreset_mode=mode, max_cycles=5)
        other.restore(snapshot)
        assert_same_trajectory(trajectory(other, case.actions(20, seed=1)), expected)

    def test_states_can_be_put_into_a_snapshot(self, case: Case) -> None:
        """Tests inject states this way; what is written is what the next step starts from."""
        device = case.open(seed=0)
        trajectory(device, case.actions(5))
        snapshot = device.snapshot()
        columns = SlotMemory(case.spec, SIZE, snapshot.memory).columns
        shuffled = {name: column[::-1].copy() for name, column in columns.items()}
        before = device.state()
        for name, column in columns.items():
            column[:] = shuffled[name]
        obs = device.restore(snapshot)
        np.testing.assert_array_equal(device.state(), before[::-1])
        np.testing.assert_array_equal(obs, device.restore(device.snapshot()))

    def test_between_thread_counts(self, native: Case) -> None:
        """A saved state does not know how many threads made it."""
        n = 5000
        one, two = (native.open(n, device=Native(threads=threads), max_cycles=4) for threads in (1, 2))
        one.reset(seed=0)
        trajectory(one, native.actions(6, n))
        two.restore(one.snapshot())
        actions = native.actions(10, n, seed=1)
        assert_same_trajectory(trajectory(one, actions), trajectory(two, actions))
        one.close()
        two.close()

    def test_strict_lifetimes_are_part_of_it(self, case: Case) -> None:
        """Who has left stays away in the environment that continues."""
        env = case.parallel(autoreset=False, max_cycles=0, seed=3)
        for actions in case.actions(300):
            env.step(actions)
            if env.num_agents < SIZE * case.agents * 3 // 4:
                break
        if env.num_agents == SIZE * case.agents:
            pytest.skip(f"no episode of {case.spec.name} ended in 300 steps of random actions")
        if not env.agents:
            pytest.skip(f"all episodes of {case.spec.name} end in the same step")
        fresh = case.parallel(autoreset=False, max_cycles=0)
        fresh.load_state(env.save_state())
        assert fresh.agents == env.agents
        for actions in case.actions(5, seed=1):
            np.testing.assert_equal(env.step(actions), fresh.step(actions))
            if not env.agents:
                break

    def test_set_rewards_takes_effect_at_the_next_step(self, case: Case) -> None:
        """And is what an environment that had them from the start returns."""
        table = case.spec.rewards
        if table is None:
            pytest.skip(f"{case.spec.name} computes its rewards")
        other = [2 * r + 1 for r in table]
        plain, given, changed = (case.open(rewards=rewards, seed=0) for rewards in (None, other, None))
        assert_same_trajectory(trajectory(plain, case.actions(10)), trajectory(changed, case.actions(10)))
        trajectory(given, case.actions(10))
        changed.set_rewards(other)
        np.testing.assert_array_equal(changed.rewards, given.rewards)
        codes = np.array(table, np.float32)
        ascending = np.argsort(codes)
        for actions in case.actions(20, seed=1):
            a, b, c = plain.step(actions), given.step(actions), changed.step(actions)
            found = ascending[np.searchsorted(codes, a.rewards, sorter=ascending)]
            np.testing.assert_array_equal(b.rewards, np.array(other, np.float32)[found])
            np.testing.assert_array_equal(c.rewards, b.rewards)

    def test_close_twice_and_between_send_and_recv(self, case: Case) -> None:
        """Whatever the moment, what was sent is answered."""
        env = case.parallel(seed=0)
        env.close()
        env.close()
        device = case.open(seed=0)
        device.send(case.actions(1)[0])
        device.close()
        device.close()
        assert rows([device.recv()], 0, 1)[0].obs.shape[0] == 1
