"""Names, spaces, shapes and dtypes of what every environment returns, and the actions that it takes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, Tuple

from pearl_marl.errors import ActionError
from pearl_marl.spec.elements import bounds
from pearl_marl.testing.case import SIZE, STEPS, Case, names_of, rows_of, shown_space
from pearl_marl.testing.golden_functions import contains_all


def _just_beyond(space: Any) -> Iterator[Any]:
    """Yield actions with an element that is just not possible."""
    for end, sign in zip(bounds(space), (-1, 1), strict=True):
        for k, value in enumerate(end):
            is_real = isinstance(space, Box)
            for other in (np.nextafter(value, sign * np.inf), np.nan) if is_real else (value + sign,):
                changed = end.copy()
                changed[k] = other
                yield changed


class SpacesContract:
    """Tests of the data that go in and out."""

    @pytest.mark.parametrize("autoreset", [True, False], ids=["autoreset", "strict"])
    def test_agents_and_spaces(self, case: Case, autoreset: bool) -> None:
        """What PettingZoo asks an environment about itself."""
        env = case.parallel(autoreset=autoreset)
        n, k = SIZE * case.agents, case.agents
        assert env.possible_agents == names_of(n)
        assert env.max_num_agents == n
        assert (env.n_worlds, env.agents_per_world) == (SIZE, k)
        env.reset(seed=0)
        assert env.agents == env.possible_agents
        assert env.num_agents == n
        for space in (env.observation_space, env.action_space):
            assert all(space(agent) is space(f"agent_{i % k}") for i, agent in enumerate(env.possible_agents))
        for i, agent in enumerate(env.possible_agents[:k]):
            role = case.spec.roles[i] if case.spec.roles else None
            assert env.observation_space(agent) == shown_space(case.spec, i)
            assert env.action_space(agent) == (role.action_space if role else case.spec.action_space)
            assert env.role(agent) == (role.name if role else "agent")
        name, version = str(env.metadata["name"]).rsplit("_v", 1)
        assert name.replace("_", "") == case.spec.name.lower()
        assert re.fullmatch("[a-z0-9_]+", name)
        assert version == str(case.spec.version)
        assert env.metadata["is_parallelizable"] is True
        assert env.render_mode is None

    def test_two_environments_share_no_space(self, case: Case) -> None:
        """Sampling from a shared one would make the second environment's samples depend on the first's."""
        first, second = (case.parallel().action_space("agent_0") for _ in range(2))
        assert first is not second
        first.seed(0)
        second.seed(0)
        drawn = [first.sample() for _ in range(20)]
        np.testing.assert_array_equal(drawn, [second.sample() for _ in range(20)])

    @pytest.mark.parametrize("copy", [True, False], ids=["copy", "no copy"])
    def test_shapes_dtypes_and_ranges_of_batches(self, case: Case, copy: bool) -> None:
        """Every array, at every step."""
        env = case.parallel(copy=copy, max_cycles=7)
        space = case.spec.observation_space
        shape, dtype = space.shape, space.dtype
        if isinstance(space, Tuple):
            shape, dtype = (len(space.spaces),), np.dtype(np.int64)
        assert shape is not None
        obs = env.reset_batch(seed=4)
        n = SIZE * case.agents
        assert obs.shape == (n, *shape)
        assert obs.dtype == dtype
        assert contains_all(space, obs)
        for actions in case.actions():
            step = env.step_batch(actions)
            for array in (step.obs, step.final_obs):
                assert array.shape == (n, *shape)
                assert array.dtype == dtype
            for array, kind in (
                (step.rewards, np.float32),
                (step.terminations, bool),
                (step.truncations, bool),
            ):
                assert array.shape == (n,)
                assert array.dtype == kind
            np.testing.assert_array_equal(step.ended, step.terminations | step.truncations)
            assert contains_all(space, step.obs[step.in_episode])
            assert contains_all(space, step.final_obs[step.ended])
            arrived = step.arrivals()
            np.testing.assert_array_equal(arrived[step.ended], step.final_obs[step.ended])
            np.testing.assert_array_equal(arrived[~step.ended], step.obs[~step.ended])

    def test_values_of_the_dicts(self, case: Case) -> None:
        """Each agent's own, in the types that its spaces and PettingZoo promise."""
        env = case.parallel(max_cycles=5)
        obs, infos = env.reset(seed=0)
        assert list(obs) == list(infos) == env.agents
        assert all(info == {} for info in infos.values())
        for actions in case.actions(12):
            results = env.step(actions)
            obs, rewards, terminations, truncations, infos = results
            spaces = {agent: env.observation_space(agent) for agent in env.agents}
            for result in results:
                assert isinstance(result, dict)
                assert list(result) == env.agents
            assert all(
                spaces[agent].contains(obs[agent]) for agent in env.agents if env.in_episode[env.rows[agent]]
            )
            if isinstance(
                spaces["agent_0"], Discrete
            ):  # PettingZoo's AEC test insists on NumPy's own scalars
                assert all(isinstance(o, np.integer) for o in obs.values())
            assert all(type(r) is float for r in rewards.values())
            assert all(type(t) is bool for t in (*terminations.values(), *truncations.values()))
            for agent in env.agents:
                ended = terminations[agent] or truncations[agent]
                assert ("final_obs" in infos[agent]) == ended
                if ended:
                    assert spaces[agent].contains(infos[agent]["final_obs"])

    def test_dicts_hold_what_the_arrays_hold(self, case: Case) -> None:
        """Dict actions, array actions and no dict at all are three ways to the same numbers."""
        by_dict, by_array, batched = (case.parallel(max_cycles=6) for _ in range(3))
        first_obs, _ = by_dict.reset(seed=2)
        by_array.reset(seed=2)
        first = batched.reset_batch(seed=2)
        np.testing.assert_array_equal(first, rows_of(first_obs.values(), first))
        for actions in case.actions():
            from_dict: Any = by_dict.step(dict(zip(by_dict.agents, actions, strict=True)))
            from_array: Any = by_array.step(actions)
            step = batched.step_batch(actions)
            for a, b, array in zip(from_dict[:4], from_array[:4], step[:4], strict=True):
                np.testing.assert_array_equal(a.array, array)
                np.testing.assert_array_equal(b.array, array)
                np.testing.assert_array_equal(rows_of(a.values(), array), array)
            for one, other in zip(from_dict[4].values(), from_array[4].values(), strict=True):
                assert one.keys() == other.keys()
            for slot in np.flatnonzero(step.ended):
                info, last = from_dict[4][f"agent_{slot}"], step.final_obs[slot : slot + 1]
                np.testing.assert_array_equal(rows_of([info["final_obs"]], last), last)

    @pytest.mark.parametrize("dtype", ["int8", "uint8", "int16", "uint32", "int32", "int64", ">i4", "uint64"])
    def test_any_integer_dtype_of_actions(self, case: Case, dtype: str) -> None:
        """Also where the array is not contiguous, or is a list."""
        if isinstance(case.spec.action_space, Box):
            pytest.skip(f"the actions of {case.spec.name} are no integers")
        if max(case.spec.action_counts) > np.iinfo(dtype).max:
            pytest.skip(f"{dtype} does not hold the actions of {case.spec.name}")
        plain, other = (case.open(seed=0) for _ in range(2))
        for actions in case.actions(4):
            wide = np.repeat(actions.astype(dtype), 2, axis=0)[::2]  # not contiguous
            np.testing.assert_array_equal(plain.step(actions).obs, other.step(wide).obs)
            np.testing.assert_array_equal(plain.step(actions).obs, other.step(actions.tolist()).obs)

    def test_numbers_as_actions(self, case: Case) -> None:
        """Integers and floats of any width are the same number, and so the same word."""
        if not isinstance(case.spec.action_space, Box):
            pytest.skip(f"the actions of {case.spec.name} are integers")
        space, actions, dtypes = case.spec.action_space, case.actions(1)[0], ["float32", ">f8"]
        least, most = np.ceil(space.low), np.floor(space.high)
        if (least < most).all():
            actions, dtypes = np.clip(np.round(actions), least, most), [*dtypes, "int64"]
        device = case.open()
        steps = []
        for dtype in dtypes:
            device.reset(seed=0)
            steps.append(device.step(actions.astype(dtype)))
        for other in steps[1:]:
            np.testing.assert_array_equal(steps[0].obs, other.obs)
            np.testing.assert_array_equal(steps[0].rewards, other.rewards)
        for wrong in (actions[:, 0], actions[:-1], actions.astype(bool), actions.tolist()[1:]):
            with pytest.raises(ActionError):
                device.step(wrong)

    def test_the_least_and_the_greatest_action(self, case: Case) -> None:
        """Both ends of the space are taken, and the number after each is not."""
        if case.spec.roles:
            pytest.skip(f"agents of {case.spec.name} have spaces of their roles")
        space, n = case.spec.action_space, SIZE * case.agents
        device = case.open(SIZE, seed=0)
        least: Any
        most: Any
        beyond: list[Any]
        if isinstance(space, Discrete):
            least, most = 0, int(space.n) - 1
            beyond = [-1, most + 1]
        else:
            least, most = bounds(space)
            beyond = [*_just_beyond(space)]
        others: Any = ([most, least] * n)[: n - 1]
        device.step([*others, least])
        for outside in beyond:
            with pytest.raises(ActionError, match=rf"agent_{n - 1}: action .* is out of range"):
                device.step([*others, outside])

    def test_state_and_its_space(self, case: Case) -> None:
        """The state of all slots, as values."""
        env = case.parallel(seed=0)
        for actions in case.actions(STEPS):
            state = env.state()
            assert state.shape == (SIZE, len(case.spec.state)) == env.state_space.shape
            assert env.state_space.contains(state)
            env.step_batch(actions)
