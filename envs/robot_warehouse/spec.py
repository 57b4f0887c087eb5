"""The spec of RobotWarehouse: what the package's options come to, in words."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_choice, checked_integer
from pearl_marl.layout import Layout
from pearl_marl.spec import EnvSpec, Grid, Peer

from .moves import MOST
from .picture import make_draw
from .presets import PRESETS
from .rules import SIZES, WarehouseRules
from .step import make_golden

REWARDS = {"individual": (0.0, 1.0), "global": (0.0, 1.0, 2.0), "two_stage": (0.0, 0.5)}
"""The rewards of each category, by the package's names."""
HEIGHTS, SIGHTS, REQUESTS = (1, 15), (1, 5), 19
"""Those that the package registers warehouses with."""
MOST_STEPS = (1 << 32) - 1


def configure(
    size: str = "tiny",
    robots: int = 2,
    request_queue_size: int | None = None,
    column_height: int = 8,
    sensor_range: int = 1,
    reward_type: str = "individual",
    max_steps: int | None = 500,
) -> EnvSpec:
    """Return the spec of a warehouse; by default it is the package's ``rware-tiny-2ag-v2``.

    Parameters
    ----------
    size
        How many blocks of racks there are: ``"tiny"``, ``"small"``, ``"medium"`` or ``"large"``.
    robots
        How many robots there are, 1 to 4; the package's ``n_agents``.
    request_queue_size
        How many shelves are asked for at a time. None is one for each robot; what the package calls easy is
        twice, hard half as many.
    column_height
        Racks in a column of a block, 1 to 15.
    sensor_range
        How many cells far a robot sees, 1 to 5.
    reward_type
        Who is paid: ``"individual"``, ``"global"`` or ``"two_stage"``.
    max_steps
        The time limit; None is none.
    """
    rules = rules_of(size, robots, request_queue_size, column_height, sensor_range, reward_type)
    if max_steps is not None:
        max_steps = checked_integer("max_steps", max_steps, 1, MOST_STEPS)
    golden, table = make_golden(rules), REWARDS[reward_type]
    assert golden.view is not None
    size_seen = len(Layout(golden.view).fields)
    return EnvSpec(
        name="RobotWarehouse",
        version=0,
        summary="Carry requested shelves to a goal and back, in each other's way",
        rewards=table,
        observation_space=Box(-np.inf, np.inf, (size_seen,), np.float32),
        action_space=Discrete(5),
        golden=golden,
        agents=rules.robots,
        max_cycles=max_steps,
        options={
            "size": size,
            "robots": rules.robots,
            "request_queue_size": request_queue_size,
            "column_height": rules.column_height,
            "sensor_range": rules.sight,
            "reward_type": reward_type,
            "max_steps": max_steps,
        },
        configure=configure,
        peers={
            "EnvPool": Peer(
                "RobotWarehouse-v0", agents=4, differs="Jumanji's warehouse: worlds of 4 robots, 80 shelves"
            ),
            "rware": Peer(_rwares),
        },
        presets=PRESETS,
        draw=make_draw(rules),
        follows="rware rware-tiny-2ag-v2",
        render_modes=("rgb_array",),
        grid=grid(rules),
    )


def rules_of(
    size: str,
    robots: int,
    request_queue_size: int | None,
    column_height: int,
    sensor_range: int,
    reward_type: str,
) -> WarehouseRules:
    """Return the warehouse of some options; ArgumentError says which one is not possible."""
    ties = ": with more, rware breaks ties in ways that this package does not reproduce"
    rules = WarehouseRules(
        *SIZES[checked_choice("size", size, SIZES)],
        column_height=checked_integer("column_height", column_height, *HEIGHTS),
        robots=checked_integer("robots", robots, 1, MOST, ties),
        requests=0,
        sight=checked_integer("sensor_range", sensor_range, *SIGHTS),
        reward=checked_choice("reward_type", reward_type, REWARDS),
    )
    # One shelf has to be left that can be asked for next.
    requests = rules.robots if request_queue_size is None else request_queue_size
    return rules._replace(
        requests=checked_integer("request_queue_size", requests, 1, min(len(rules.racks) - 1, REQUESTS))
    )


def grid(rules: WarehouseRules) -> Grid:
    """Return where robots are who see where they are."""

    def cell(observations: npt.NDArray[Any]) -> npt.NDArray[Any]:
        places = observations.astype(np.int64)
        return places[:, 1] * rules.width + places[:, 0]

    return Grid(rules.height, rules.width, cell)


def _rwares(spec: EnvSpec) -> Any:
    """Return rware's environment."""
    from rware.warehouse import RewardType, Warehouse

    options = spec.options
    shelf_rows, shelf_columns = SIZES[options["size"]]
    return Warehouse(
        shelf_rows=shelf_rows,
        shelf_columns=shelf_columns,
        column_height=options["column_height"],
        n_agents=spec.agents,
        msg_bits=0,
        sensor_range=options["sensor_range"],
        request_queue_size=options["request_queue_size"] or spec.agents,
        max_inactivity_steps=None,
        max_steps=spec.max_cycles,
        reward_type=RewardType[options["reward_type"].upper()],
    )


SPEC = configure()
