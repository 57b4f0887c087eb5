"""Training policies that all agents share: PPO, DQN, Q-learning, and the folders of their runs.

May import everything but ``cli`` and the experiments. Needs the ``train`` extra.
"""
