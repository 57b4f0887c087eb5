"""What a step returned stays as it was (``copy=True``), or is written over by the next (``copy=False``)."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np
import pytest

from pearl_marl.base.arrays import Array
from pearl_marl.testing.case import Case


def listed(value: Any) -> Any:
    """Return results with lists for arrays of arrays and of ``None``, which some infos are."""
    if isinstance(value, dict):
        return {key: listed(part) for key, part in value.items()}
    return list(value) if isinstance(value, np.ndarray) and value.dtype == object else value


class BuffersContract:
    """Tests of whose memory results are."""

    @pytest.mark.parametrize("interface", ["device", "parallel", "vector"])
    def test_results_survive_all_later_steps(self, case: Case, interface: str) -> None:
        """Whatever has been returned, however long ago."""
        env = getattr(case, "open" if interface == "device" else interface)(max_cycles=6)
        held, copies = [], []

        def hold(result: Any) -> None:
            held.append(result)
            copies.append(deepcopy(result))

        hold(env.reset(seed=0))
        for t, actions in enumerate(case.actions(30)):
            hold(env.step(actions))
            if t % 11 == 10:
                hold(env.reset())
        for before, after in zip(copies, held, strict=True):
            np.testing.assert_equal([*map(listed, after)], [*map(listed, before)])

    def test_a_view_of_a_result_keeps_it_too(self, case: Case) -> None:
        """The arrays are used again once nobody refers to them; a slice of one refers to it."""
        device = case.open(max_cycles=3, seed=0)
        views: list[tuple[Any, ...]] = []
        copies: list[tuple[Array, ...]] = []
        for actions in case.actions(30):
            step: Any = device.step(actions)
            views.append((step.obs[3:9], step.rewards[::2], memoryview(step.terminations)))
            copies.append(tuple(np.array(view) for view in views[-1]))
            del step
        for view, copy in zip(views, copies, strict=True):
            for a, b in zip(view, copy, strict=True):
                np.testing.assert_array_equal(np.asarray(a), b)

    def test_unread_dicts_keep_their_step(self, case: Case) -> None:
        """The dicts are filled on first use, which may be long after the step."""
        env, other = (case.parallel(max_cycles=4, seed=0) for _ in range(2))
        unread = [env.step(actions) for actions in case.actions(25)]
        for results, actions in zip(unread, case.actions(25), strict=True):
            np.testing.assert_equal(results, tuple(dict(result) for result in other.step(actions)))

    def test_without_copies_the_arrays_are_the_same_ones(self, case: Case) -> None:
        """They hold what the last step gave."""
        device, copying = (case.open(copy=copy, seed=0) for copy in (False, True))
        first = device.step(case.actions()[0])
        copying.step(case.actions()[0])
        for actions in case.actions()[1:]:
            again, fresh = device.step(actions), copying.step(actions)
            for name in ("obs", "rewards", "terminations", "truncations", "final_obs"):
                assert getattr(again, name) is getattr(first, name)
            np.testing.assert_array_equal(again.obs, fresh.obs)
            np.testing.assert_array_equal(again.rewards, fresh.rewards)

    def test_results_do_not_pile_up_memory(self, case: Case) -> None:
        """Dropped results are written again: the addresses repeat."""
        device = case.open(seed=0)
        addresses = {device.step(actions).obs.__array_interface__["data"][0] for actions in case.actions(40)}
        assert len(addresses) <= 4

    def test_results_are_writable(self, case: Case) -> None:
        """And what is written there does not reach the device (SB3 and wrappers write into rewards)."""
        written, twin = (case.open(seed=0) for _ in range(2))
        for actions in case.actions(10):
            step = written.step(actions)
            expected = twin.step(actions)
            np.testing.assert_array_equal(step.obs, expected.obs)
            for array in step[:4]:
                array[:] = 1
