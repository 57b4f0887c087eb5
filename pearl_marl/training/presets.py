"""Settings that suit an environment better than an algorithm's defaults; found by trial, on one machine."""

from __future__ import annotations

from typing import Any

BEST: dict[str, str] = {"MountainCar": "pqn"}
"""Algorithms that learn an environment sooner than PPO, with every seed; others are learned by PPO."""

# Two agents that want to be in the same cell need to know which gives way, or act at random.
FORAGING: dict[str, Any] = {
    "n_agents": 512,
    "rollout_length": 16,
    "iterations": 120,
    "minibatch": 1024,
    "entropy": 0.01,
    "sharing": "indicator",
    "temperature": 1.0,
}

# Rewards are made large, to outdo the values that networks begin with. Two agents that want to be in the same
# cell need some random actions.
FORAGING_TEAM: dict[str, Any] = {
    "n_agents": 512,
    "rollout_length": 16,
    "iterations": 120,
    "minibatch": 512,
    "learning_rate": 2e-3,
    "discount": 0.95,
    "q_lambda": 0.8,
    "exploration_fraction": 0.3,
    "reward_scale": 10.0,
    "sharing": "indicator",
    "evaluation_epsilon": 0.1,
}

# Many steps make a soup, which is worth 20: a long view, and small rewards.
# Learn with --option reward_shaping_factor=1; what is cooked counts without it.
COOKING: dict[str, Any] = {
    "n_agents": 256,
    "rollout_length": 64,
    "iterations": 120,
    "minibatch": 2048,
    "learning_rate": 2e-3,
    "discount": 0.99,
    "gae_lambda": 0.95,
    "entropy": 0.01,
    "reward_scale": 0.1,
    "sharing": "indicator",
    "temperature": 1.0,
}

# A random player brings a shelf in one episode of sixty: rewards are made large, so that the first few count.
# Robots that hardly see each other earn by chance: only large batches show the value of an action.
WAREHOUSE: dict[str, Any] = {
    "n_agents": 4096,
    "rollout_length": 64,
    "iterations": 240,
    "minibatch": 8192,
    "learning_rate": 3e-3,
    "discount": 0.99,
    "gae_lambda": 0.95,
    "entropy": 0.01,
    "reward_scale": 10.0,
    "width": 128,
    "sharing": "indicator",
    "temperature": 0.7,
}

WAREHOUSE_TEAM: dict[str, Any] = {
    "n_agents": 1024,
    "rollout_length": 32,
    "iterations": 150,
    "minibatch": 2048,
    "learning_rate": 2e-3,
    "q_lambda": 0.9,
    "exploration_fraction": 0.4,
    "reward_scale": 10.0,
    "sharing": "indicator",
    "evaluation_epsilon": 0.05,
}

# MinAtar's games: pictures of ten by ten, and points that come one at a time.
MINATAR: dict[str, Any] = {
    "n_agents": 512,
    "iterations": 120,
    "minibatch": 1024,
    "learning_rate": 1e-3,
    "discount": 0.99,
    "gae_lambda": 0.95,
    "entropy": 0.01,
    "width": 128,
}

# Grids of cells, and rewards that are rare at first.
GRID: dict[str, Any] = {
    "n_agents": 512,
    "minibatch": 2048,
    "learning_rate": 1e-3,
    "discount": 0.99,
    "entropy": 0.01,
}

# An episode of 25 steps is a rollout. An agent has to know which of the landmarks is its own, or its role.
PARTICLES: dict[str, Any] = {
    "rollout_length": 25,
    "minibatch": 2048,
    "learning_rate": 2e-3,
    "discount": 0.95,
    "entropy": 0.01,
    "reward_scale": 0.1,
    "sharing": "indicator",
}

# A player that always does the same is seen through: much entropy, and actions stay random.
POKER: dict[str, Any] = {
    "n_agents": 1024,
    "rollout_length": 16,
    "iterations": 100,
    "minibatch": 1024,
    "learning_rate": 1e-3,
    "discount": 1.0,
    "entropy": 0.1,
    "width": 32,
    "join_every": 5,
    "temperature": 1.0,
}

PRESETS: dict[tuple[str, str], dict[str, Any]] = {
    # Fast rather than frugal: every step is learned from once, so another one costs little.
    ("ppo", "CartPole"): {
        "n_agents": 512,
        "epochs": 1,
        "minibatch": 512,
        "learning_rate": 1e-2,
        "width": 32,
    },
    ("pqn", "CartPole"): {
        "n_agents": 512,
        "epochs": 1,
        "minibatch": 512,
        "learning_rate": 1e-2,
        "q_lambda": 0.9,
        "width": 32,
    },
    ("ppo", "MountainCar"): {
        # The goal is far: its value has to travel back through some 200 steps.
        "n_agents": 2048,
        "rollout_length": 16,
        "iterations": 150,
        "learning_rate": 1e-3,
        "discount": 0.99,
        "gae_lambda": 0.98,
    },
    ("pqn", "MountainCar"): {
        "n_agents": 2048,
        "rollout_length": 16,
        "iterations": 150,
        "epochs": 4,
        "learning_rate": 2e-3,
        "q_lambda": 0.95,
    },
    ("ppo", "Acrobot"): {"n_agents": 512, "iterations": 40},
    # As above; and the goal is worth 100.
    ("ppo", "MountainCarContinuous"): {
        "n_agents": 2048,
        "rollout_length": 16,
        "iterations": 100,
        "learning_rate": 1e-3,
        "discount": 0.99,
        "gae_lambda": 0.98,
        "reward_scale": 0.1,
    },
    ("ppo", "Pendulum"): {
        "n_agents": 512,
        "iterations": 120,
        "epochs": 8,
        "minibatch": 2048,
        "learning_rate": 2e-3,
        "reward_scale": 0.03,
    },
    ("ppo", "Asterix"): MINATAR,
    ("ppo", "Breakout"): MINATAR,
    ("ppo", "Freeway"): MINATAR,
    ("ppo", "SpaceInvaders"): MINATAR,
    # To come up for air is of no use until the air is gone: much entropy, and a long view.
    ("ppo", "Seaquest"): MINATAR | {"iterations": 250, "discount": 0.995, "entropy": 0.03},
    # For a size of 5.
    ("ppo", "MiniGridDoorKey"): GRID | {"iterations": 120},
    # Many places look alike: actions are sampled, so that an agent does not walk in circles.
    ("ppo", "MiniGridFourRooms"): GRID | {"gae_lambda": 0.95, "temperature": 1.0},
    # Some hundred is lost in an episode: rewards are made small.
    ("ppo", "Elevators"): {"minibatch": 2048, "discount": 0.95, "reward_scale": 0.1},
    # For a grid of 6 by 6.
    ("ppo", "Snake"): GRID | {"iterations": 80},
    ("ppo", "SimpleSpread"): PARTICLES | {"n_agents": 1536, "iterations": 150},
    ("ppo", "SimpleTag"): PARTICLES | {"n_agents": 1024, "iterations": 100},
    # One game is like another unless some moves are random.
    ("self-play", "ConnectFour"): {
        "n_agents": 512,
        "iterations": 80,
        "epochs": 2,
        "minibatch": 512,
        "learning_rate": 2e-3,
        "discount": 0.99,
        "entropy": 0.03,
        "reward_scale": 0.3,
        "width": 128,
        "random_moves": 0.3,
    },
    ("self-play", "KuhnPoker"): POKER,
    ("self-play", "LeducPoker"): POKER | {"iterations": 200, "reward_scale": 0.2, "width": 64},
    ("ppo", "LevelBasedForaging"): FORAGING,
    ("mappo", "LevelBasedForaging"): FORAGING,
    ("vdn", "LevelBasedForaging"): FORAGING_TEAM,
    ("qmix", "LevelBasedForaging"): FORAGING_TEAM,
    ("ppo", "Overcooked"): COOKING,
    ("ppo", "RobotWarehouse"): WAREHOUSE,
    ("mappo", "RobotWarehouse"): WAREHOUSE,
    ("vdn", "RobotWarehouse"): WAREHOUSE_TEAM,
    ("qmix", "RobotWarehouse"): WAREHOUSE_TEAM,
    # Two players that share nothing: each has a network of its own.
    ("ppo", "CoinGame"): {
        "n_agents": 512,
        "rollout_length": 16,
        "minibatch": 2048,
        "entropy": 0.01,
        "sharing": "none",
        "temperature": 1.0,
    },
    # Rewards are random: entries have to become means of many targets.
    ("q-learning", "Blackjack"): {"learning_rate": 1.0, "learning_rate_decay": 0.2, "epsilon": 0.5},
}
