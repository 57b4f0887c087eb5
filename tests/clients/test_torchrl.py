"""TorchRL's own wrappers of PettingZoo's and Gymnasium's environments, around ours as they are."""

from __future__ import annotations

import copy

import numpy as np
import pytest

import pearl_marl

pytest.importorskip("torchrl", reason="TorchRL is not installed")
from torchrl.envs import GymWrapper, PettingZooWrapper
from torchrl.envs.utils import MarlGroupMapType, check_env_specs

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.mark.parametrize("name", ["CartPole", "Pendulum", "CliffWalking", "CoinGame", "LevelBasedForaging"])
def test_pettingzoo_wrapper(name: str) -> None:
    """It asks for actions of agents that have left, too, and shows those as done."""
    n = 2 * pearl_marl.get_spec(name).agents
    inside, twin = (pearl_marl.parallel_env(name, n, autoreset=False, max_cycles=4) for _ in range(2))
    env = PettingZooWrapper(
        inside, use_mask=True, group_map=MarlGroupMapType.ALL_IN_ONE_GROUP, categorical_actions=True
    )
    if not inside.batch.world.masked:  # its check draws any actions
        check_env_specs(env)
    env.set_seed(0)
    rollout = env.rollout(10, break_when_any_done=False)
    group = rollout["next", "agents"]
    twin.reset(seed=0)  # as set_seed does, and the rollout resets once more
    twin.reset()
    for t, given in enumerate(rollout["agents", "action"].numpy()[:4]):
        actions = dict(zip(twin.possible_agents, given, strict=True))
        for name_, theirs in zip(("reward", "terminated", "truncated"), twin.step(actions)[1:4], strict=True):
            shown = group[name_][t].squeeze(-1).tolist()
            assert {agent: shown[twin.rows[agent]] for agent in theirs} == pytest.approx(dict(theirs))
    assert not twin.agents
    assert group["done"][3].all()


def test_agents_that_leave_one_after_the_other() -> None:
    inside = pearl_marl.parallel_env("CartPole", 4, autoreset=False)
    env = PettingZooWrapper(inside, use_mask=True, group_map=MarlGroupMapType.ALL_IN_ONE_GROUP)
    env.set_seed(1)
    rollout = env.rollout(200, break_when_any_done=False, break_when_all_done=False)
    lengths = {int(done.nonzero()[0]) for done in rollout["next", "agents", "done"].squeeze(-1).T}
    assert len(lengths) > 1


def test_turns() -> None:
    env = PettingZooWrapper(
        pearl_marl.raw_env("ConnectFour"),
        use_mask=True,
        group_map=MarlGroupMapType.ONE_GROUP_PER_AGENT,
        categorical_actions=True,
    )
    env.set_seed(0)
    rollout = env.rollout(50)
    assert rollout["next", "done"][-1].all()
    rewards = [float(rollout["next", f"agent_{k}", "reward"].sum()) for k in range(2)]
    assert sorted(rewards) in ([-1, 1], [0, 0])


@pytest.mark.parametrize("mode", ["Disabled", "SameStep"])
@pytest.mark.parametrize("name", ["CartPole", "CliffWalking", "Pendulum"])
def test_gym_wrapper(name: str, mode: str) -> None:
    """It looks for ``autoreset_mode``; where an episode ends it shows the last observation of that."""
    inside = pearl_marl.make_vec(name, 3, autoreset_mode=mode, max_cycles=4)
    env = GymWrapper(inside, categorical_action_encoding=True)
    assert env.batch_size == (3,)
    env.set_seed(0)
    first = env.reset()
    twin = copy.deepcopy(inside)
    rollout = env.rollout(9, auto_reset=False, tensordict=first, break_when_any_done=False)
    done = rollout["next", "truncated"].squeeze(-1)
    assert done.tolist() == [[False, False, False, True] * 2 + [False]] * 3
    for t in range(4):
        step = twin.step_batch(rollout["action"][:, t].numpy())
        np.testing.assert_array_equal(rollout["next", "observation"][:, t].numpy(), step.arrivals())
        np.testing.assert_array_equal(rollout["next", "reward"][:, t, 0].numpy(), step.rewards)
        if t < 3:  # it resets once more where all are done
            np.testing.assert_array_equal(rollout["observation"][:, t + 1].numpy(), step.obs)


def test_next_step_is_refused_by_torchrl() -> None:
    with pytest.raises(RuntimeError, match="SAME_STEP or DISABLED"):
        GymWrapper(pearl_marl.make_vec("CartPole", 3, autoreset_mode="NextStep"))
