"""RobotWarehouse as rware has it."""

from __future__ import annotations

from typing import Any

from pearl_marl.spec import EnvSpec

from .rules import SIZES


def make(spec: EnvSpec) -> Any:
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
