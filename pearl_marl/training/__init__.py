"""Training policies that all agents share: PPO, DQN, Q-learning, and the folders of their runs.

Needs the ``train`` extra.
"""

import os

# Before PyTorch is imported. Threads that wait by spinning take the time of those that they wait for, where
# another program is busy: a minibatch of 4,096 then took four times as long as with one thread.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
