"""Saved states: go back in time, try every action from the same place, and go on elsewhere."""

import numpy as np

import pearl_marl

env = pearl_marl.parallel_env("FrozenLake", n_agents=1000)
env.reset_batch(seed=0)
generator = np.random.default_rng(0)
for _ in range(3):
    env.step_batch(generator.integers(4, size=1000))

# All that the future depends on. The ice is slippery, but in the same way each time.
saved = env.save_state()
for action, name in enumerate(("left", "down", "right", "up")):
    env.load_state(saved)
    step = env.step_batch(np.full(1000, action))
    print(f"{name:>5}: {step.terminations.sum()} of 1000 agents end")

env.load_state(saved)
once = [env.step_batch(np.full(1000, 1)).obs for _ in range(20)]
another = pearl_marl.parallel_env("FrozenLake", n_agents=1000, device=pearl_marl.devices.Native(threads=2))
another.load_state(saved)  # the same environment, on any device
again = [another.step_batch(np.full(1000, 1)).obs for _ in range(20)]
print("The same future twice:", all((a == b).all() for a, b in zip(once, again, strict=True)))
