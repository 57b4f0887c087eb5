"""Ten thousand agents of CartPole, a policy that is a line of NumPy, and how long they last."""

import numpy as np

import pearl_marl

env = pearl_marl.parallel_env("CartPole", n_agents=10_000)

# PettingZoo's way: dicts with a value for each agent. They cost nothing until somebody looks inside.
observations, infos = env.reset(seed=0)
observations, rewards, terminations, truncations, infos = env.step(np.zeros(10_000, np.uint8))
print("agent_42 sees", observations["agent_42"])

# The same as arrays, with a row for each agent.
observations = env.reset_batch(seed=0)
lengths = np.zeros(10_000, int)
first = np.ones(10_000, bool)  # who is still in its first episode
for _ in range(500):
    angle, speed = observations[:, 2], observations[:, 3]
    step = env.step_batch((angle + 0.3 * speed > 0).astype(np.uint8))
    lengths += first
    first &= ~step.ended
    observations = step.obs  # who ended has started over already
print(f"The pole stays up for {lengths.mean():.0f} steps, of 500 at most")
