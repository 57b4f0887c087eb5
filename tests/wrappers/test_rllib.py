"""RLlib through our bridges; it pins another Gymnasium, so the half with it runs by ``make test-rllib``."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import pearl_marl
from pearl_marl.errors import ArgumentError
from pearl_marl.wrappers import dtype_v0, flatten_v0, frame_stack_v1, rllib_multi_agent_env, rllib_vector_env

# Of what RLlib itself is not asked, also where it is not installed.


def test_the_vector_bridge_resets_in_the_next_step() -> None:
    env = rllib_vector_env("CliffWalking", max_cycles=2)({"num_envs": 3})
    assert isinstance(env, pearl_marl.PearlVectorEnv)
    assert env.num_envs == 3
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    env.reset(seed=0)
    steps = [env.step(np.zeros(3, np.int64)) for _ in range(3)]
    assert [int(step[0][0]) for step in steps] == [24, 12, 36]
    assert [bool(step[3][0]) for step in steps] == [False, True, False]
    assert steps[2][1][0] == 0


def test_env_config_adds_arguments() -> None:
    env = rllib_vector_env("FrozenLake", is_slippery=True)({"num_envs": 2, "is_slippery": False})
    assert env.device.config.spec.options["is_slippery"] is False


def test_wrapped_vector_environments() -> None:
    env = rllib_vector_env("CartPole", wrap=lambda env: frame_stack_v1(env, 2))({"num_envs": 2})
    assert env.single_observation_space.shape == (8,)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP


def wrong_mode(env: Any) -> Any:
    return pearl_marl.make_vec("CliffWalking", env.num_envs)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rllib_vector_env("CartPole", autoreset_mode="SameStep"), "'SameStep'.*NEXT_STEP"),
        (
            lambda: rllib_vector_env("CartPole")({"num_envs": 2, "autoreset_mode": AutoresetMode.DISABLED}),
            "DISABLED.*leave it out",
        ),
        (lambda: rllib_vector_env("CartPole", copy=False), "copy is False"),
        (lambda: rllib_vector_env("CartPole")({}), "no num_envs.*vector_entry_point"),
        (lambda: rllib_vector_env("CartPole", wrap=wrong_mode)({"num_envs": 2}), "wrap returned PearlVec"),
        (
            lambda: rllib_vector_env("Pendulum", wrap=gymnasium.wrappers.vector.ClipAction)({"num_envs": 2}),
            "wrap returned ClipAction",
        ),
        (lambda: rllib_multi_agent_env("CartPole", 2, autoreset=True), "autoreset is True"),
        (lambda: rllib_multi_agent_env("CartPole", 2)({"autoreset": True}), "autoreset is True"),
        (lambda: rllib_multi_agent_env("CartPole", 2, copy=False), "copy is False"),
        (
            lambda: rllib_multi_agent_env("CartPole", 2, wrap=lambda env: env.unwrapped.device)({}),
            "wrap returned Native",
        ),
    ],
)
def test_what_rllib_would_get_wrong_is_refused(make: Any, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        make()


# With RLlib


@pytest.fixture(scope="module")
def ray() -> Iterator[Any]:
    reason = "RLlib is not installed: make test-rllib runs this with it"
    pytest.importorskip("ray.rllib", reason=reason, exc_type=ImportError)  # Ray may be, without RLlib
    ray = importlib.import_module("ray")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, ignore_reinit_error=True)
    yield ray
    ray.shutdown()


def ppo_config(name: str, creator: Any, **env_runners: Any) -> Any:
    from ray import tune
    from ray.rllib.algorithms.ppo import PPOConfig

    tune.register_env(name, creator)
    return PPOConfig().environment(name).env_runners(num_env_runners=0, **env_runners)


def sampled_episodes(creator: Any, n: int) -> list[Any]:
    from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner

    modes = {"gym_env_vectorize_mode": "vector_entry_point", "num_envs_per_env_runner": n}
    config = ppo_config("pearl-episodes", creator, **modes).debugging(seed=3)
    runner = SingleAgentEnvRunner(config=config, worker_index=0)
    episodes = runner.sample(num_timesteps=60 * n, random_actions=True)
    runner.stop()
    return [episode for episode in episodes if episode.is_done]


def positions_that_jump(episodes: list[Any]) -> int:
    """Count transitions that are none of CartPole's: a cart moves by 0.02 of its velocity."""
    jumps = 0
    for episode in episodes:
        obs = np.array(episode.get_observations(), np.float64)
        jumps += int((np.abs(obs[1:, 0] - obs[:-1, 0] - 0.02 * obs[:-1, 1]) > 1e-4).sum())
    return jumps


def test_rllibs_episodes_are_whole_and_end_where_they_ended(ray: Any) -> None:
    n, limit = 5, 11
    episodes = sampled_episodes(rllib_vector_env("CartPole", max_cycles=limit), n)
    assert len(episodes) >= 4 * n
    assert positions_that_jump(episodes) == 0
    ends = set()
    for episode in episodes:
        obs, steps = np.array(episode.get_observations()), len(episode.get_actions())
        assert len(obs) == steps + 1
        assert episode.get_return() == steps
        assert np.abs(obs[0]).max() <= 0.05
        fallen = abs(obs[-1, 2]) > np.radians(12)
        assert episode.is_terminated == fallen
        assert episode.is_truncated == (steps == limit)
        ends.add((episode.is_terminated, episode.is_truncated))
    assert {(True, False), (False, True)} <= ends


def test_rllib_joins_episodes_wrongly_in_another_mode(ray: Any) -> None:
    """Why the bridge chooses the mode: RLlib takes any, and says nothing."""
    episodes = sampled_episodes(
        lambda config: pearl_marl.make_vec(
            "CartPole", config["num_envs"], autoreset_mode="SameStep", max_cycles=11
        ),
        5,
    )
    assert positions_that_jump(episodes) > 0


def test_multi_agent_lifetimes(ray: Any) -> None:
    env = rllib_multi_agent_env("CartPole", 3, max_cycles=9)({})
    assert set(env.possible_agents) == {"agent_0", "agent_1", "agent_2"}
    for _ in range(3):
        obs, _ = env.reset(seed=1)
        assert set(obs) == {"agent_0", "agent_1", "agent_2"}
        here = set(obs)
        for t in range(9):
            actions = {agent: 1 if agent == "agent_0" else t % 2 for agent in here}
            obs, rewards, terminations, truncations, _ = env.step(actions)
            assert set(rewards) == here == set(obs)
            gone = {agent for agent in here if terminations[agent] or truncations[agent]}
            here -= gone
            assert (terminations["__all__"] or truncations["__all__"]) == (not here)
        assert not here
    env.close()


def test_masks_are_where_rllibs_module_looks(ray: Any) -> None:
    env = rllib_multi_agent_env("LevelBasedForaging", max_cycles=3)({})
    plain = pearl_marl.parallel_env("LevelBasedForaging", max_cycles=3, autoreset=False)
    expected, _ = plain.reset(seed=4)
    seen, _ = env.reset(seed=4)
    for _ in range(3):
        assert set(seen) == set(expected)
        for agent in expected:
            assert env.observation_space[agent].contains(seen[agent])
            assert set(seen[agent]) == {"observations", "action_mask"}
            np.testing.assert_array_equal(seen[agent]["observations"], expected[agent]["observation"])
            np.testing.assert_array_equal(seen[agent]["action_mask"], expected[agent]["action_mask"])
        actions = {agent: int(np.argmax(seen[agent]["action_mask"][::-1])) for agent in seen}
        actions = {agent: 5 - action for agent, action in actions.items()}
        expected, *_ = plain.step(actions)
        seen, *_ = env.step(actions)


def masked_ppo(name: str, creator: Any, **training: Any) -> Any:
    """Return PPO whose agents share RLlib's own module for masks."""
    from ray.rllib.core.rl_module import MultiRLModuleSpec, RLModuleSpec
    from ray.rllib.examples.rl_modules.classes.action_masking_rlm import ActionMaskingTorchRLModule

    module = RLModuleSpec(module_class=ActionMaskingTorchRLModule)
    config = ppo_config(name, creator, num_envs_per_env_runner=16)
    config = config.multi_agent(policies={"shared"}, policy_mapping_fn=lambda agent, episode, **_: "shared")
    config = config.rl_module(rl_module_spec=MultiRLModuleSpec(rl_module_specs={"shared": module}))
    return config.training(minibatch_size=512, num_epochs=4, **training).debugging(seed=0).build_algo()


def boards_as_numbers(env: Any) -> Any:
    return dtype_v0(flatten_v0(env), np.float32)


@pytest.mark.slow
def test_masked_actions_are_not_taken(ray: Any) -> None:
    """ConnectFour refuses them, and columns are full soon enough."""
    creator = rllib_multi_agent_env("ConnectFour", wrap=boards_as_numbers)
    algorithm = masked_ppo("pearl-connect-four", creator, train_batch_size_per_learner=2048)
    assert algorithm.train()["env_runners"]["num_episodes"] > 20
    algorithm.stop()


@pytest.mark.slow
def test_ppo_learns_to_forage(ray: Any) -> None:
    creator = rllib_multi_agent_env("LevelBasedForaging", field_size=(5, 5), max_num_food=1)
    settings = {"train_batch_size_per_learner": 2048, "lr": 2e-3, "gamma": 0.97, "entropy_coeff": 0.01}
    algorithm = masked_ppo("pearl-foraging", creator, **settings)
    returns = []
    for _ in range(15):
        returns.append(algorithm.train()["env_runners"]["episode_return_mean"])
        if returns[-1] > 0.8:
            break
    algorithm.stop()
    assert returns[0] < 0.7
    assert returns[-1] > 0.8, returns


@pytest.mark.slow
def test_ppo_learns_cart_pole_through_vectors(ray: Any) -> None:
    config = ppo_config(
        "pearl-cart-pole",
        rllib_vector_env("CartPole"),
        gym_env_vectorize_mode="vector_entry_point",
        num_envs_per_env_runner=32,
    )
    config = config.training(
        train_batch_size_per_learner=2048, minibatch_size=256, num_epochs=6, lr=2e-3, gamma=0.98, lambda_=0.9
    ).debugging(seed=0)
    algorithm = config.build_algo()
    returns = []
    for _ in range(15):
        returns.append(algorithm.train()["env_runners"]["episode_return_mean"])
        if returns[-1] > 100:
            break
    algorithm.stop()
    assert returns[-1] > 100, returns


@pytest.mark.slow
def test_ppo_trains_several_agents(ray: Any) -> None:
    config = ppo_config("pearl-agents", rllib_multi_agent_env("CartPole", 4, max_cycles=100))
    config = config.multi_agent(policies={"shared"}, policy_mapping_fn=lambda agent, episode, **_: "shared")
    config = config.training(train_batch_size_per_learner=400, minibatch_size=64, num_epochs=2)
    algorithm = config.debugging(seed=0).build_algo()
    result = algorithm.train()["env_runners"]
    algorithm.stop()
    assert set(result["agent_episode_returns_mean"]) == {f"agent_{i}" for i in range(4)}
    assert result["num_episodes"] > 0
