"""The spec of RobotWarehouse: what the package's options come to, in words."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.errors import ArgumentError
from pearl_marl.golden import draws_of
from pearl_marl.spec import EnvSpec, Field, Golden, Grid

from .moves import MOST
from .rules import Rules
from .step import decisions, make_initial, make_observe, make_step

SIZES = {"tiny": (1, 3), "small": (2, 3), "medium": (2, 5), "large": (3, 5)}
"""Rows and columns of blocks of shelves, by the package's names."""
REWARDS = {"individual": (0.0, 1.0), "global": (0.0, 1.0, 2.0), "two_stage": (0.0, 0.5)}
"""The rewards of each category, by the package's names."""


def configure(
    size: str = "tiny",
    robots: int = 2,
    request_queue_size: int | None = None,
    column_height: int = 8,
    sensor_range: int = 1,
    reward_type: str = "individual",
    max_steps: int = 500,
) -> EnvSpec:
    rules = rules_of(size, robots, request_queue_size, column_height, sensor_range, reward_type)
    table = REWARDS[reward_type]
    return EnvSpec(
        name="RobotWarehouse",
        version=0,
        summary="Carry shelves that are asked for to a goal, and back, in each other's way",
        state=state_fields(rules),
        action=Field("action", 3),
        observation=observation_fields(rules),
        reward=Field("reward", (len(table) - 1).bit_length()),
        rewards=table,
        observation_space=Box(-np.inf, np.inf, (len(observation_fields(rules)),), np.float32),
        action_space=Discrete(5),
        golden=Golden(make_initial(rules), make_step(rules), make_observe(rules)),
        agents=robots,
        reset_draws=draws_of(decisions(rules))[-1] + 1,
        step_draws=len(rules.goals),
        max_cycles=max_steps,
        options={
            "size": size,
            "robots": robots,
            "request_queue_size": request_queue_size,
            "column_height": column_height,
            "sensor_range": sensor_range,
            "reward_type": reward_type,
            "max_steps": max_steps,
        },
        configure=configure,
    )


def rules_of(
    size: str, robots: int, request_queue_size: int | None, column_height: int, sensor_range: int, reward_type: str
) -> Rules:
    return Rules(*SIZES[size], column_height, robots, request_queue_size or robots, sensor_range, reward_type)


def state_fields(rules: Rules) -> tuple[Field, ...]:
    """Return the state's fields."""
    x, y = (rules.width - 1).bit_length(), (rules.height - 1).bit_length()
    fields: list[Field] = []
    for k in range(rules.robots):
        fields += [Field(f"robot_{k}_x", x), Field(f"robot_{k}_y", y), Field(f"robot_{k}_direction", 2)]
        fields.append(Field(f"robot_{k}_origin", rules.cell_bits))
        if rules.reward == "two_stage":
            fields.append(Field(f"robot_{k}_brought", 1))
    return (*fields, *(Field(f"request_{r}", rules.cell_bits) for r in range(rules.requests)))


def observation_fields(rules: Rules) -> tuple[Field, ...]:
    """Return the observation's fields: as many as its space has elements."""
    x, y = (rules.width - 1).bit_length(), (rules.height - 1).bit_length()
    flags = ["carries", "up", "down", "left", "right", "highway"]
    seen = "robot", "up", "down", "left", "right", "shelf", "request"
    side = 2 * rules.sight + 1
    flags += [f"sensor_{cell}_{what}" for cell in range(side * side) for what in seen]
    return (Field("x", x), Field("y", y), *(Field(flag, 1) for flag in flags))


SPEC = configure()
