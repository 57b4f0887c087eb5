"""Wrappers on whole batches: SuperSuit's by their names, in a stack."""

import numpy as np

import pearl_marl
from pearl_marl import wrappers

env = pearl_marl.parallel_env("MountainCar", n_agents=5000)
env = wrappers.sticky_actions_v0(env, 0.25)  # the motor misses a command in four
env = wrappers.reward_lambda_v0(env, lambda rewards: rewards / 10)  # gets the rewards of all agents
env = wrappers.normalize_observation_v0(env)
env = wrappers.frame_stack_v1(env, 4)
print("An observation has", env.observation_space("agent_0").shape[0], "numbers: four frames of two")

observations = env.reset_batch(seed=0)
reached = np.zeros(5000, bool)
for _ in range(200):
    speed = observations[:, -1]  # of the newest frame
    step = env.step_batch(np.where(speed > 0, 2, 0))  # push where the car rolls
    observations = step.obs
    reached |= step.terminations
print(f"{reached.mean():.0%} are up the hill within 200 steps; a step is worth {step.rewards[0]:.1f}")
