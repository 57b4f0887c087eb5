"""Worlds that agents share: a thousand games of ConnectFour, and players who keep to the rules."""

import numpy as np

import pearl_marl

env = pearl_marl.parallel_env("ConnectFour", n_agents=2000)  # 1,000 worlds of 2 players
env.reset_batch(seed=0)
generator = np.random.default_rng(0)
won = np.zeros(2)
for _ in range(100):
    # Which of the seven columns each player may choose; none where it is the other's turn.
    masks = env.action_masks
    favour = generator.random(masks.shape)
    favour[::2, 3] += 0.5  # the first player of each world likes the middle
    step = env.step_batch((favour * masks).argmax(1))
    won += (step.rewards.reshape(env.n_worlds, 2) > 0).sum(0)
print(f"Games won by the player that prefers the middle: {won[0]:.0f}; by the random one: {won[1]:.0f}")
assert won[0] > won[1]

# PettingZoo's way has the mask beside the observation, and refuses what it forbids.
observations, infos = env.reset(seed=0)
print("agent_0 may take", np.flatnonzero(observations["agent_0"]["action_mask"]))
for _ in range(6):
    env.step_batch(np.full(2000, 3))  # fills the column in the middle; who is not on turn is not asked
try:
    env.step_batch(np.full(2000, 3))
except pearl_marl.errors.ActionError as error:
    print(error)
