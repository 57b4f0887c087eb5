"""The spec of MemoryChain: its lengths, and bsuite's observations."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_integer
from pearl_marl.spec import EnvSpec, Peer

from .step import make_golden

LONGEST, MOST_BITS = 1000, 40
"""The longest chain that is possible here, and the most bits of bsuite's experiments."""
ZERO, ONE, BLACK, CELL = (240, 150, 40), (40, 85, 200), (0, 0, 0), 48
"""Colours of a picture, and the width of a cell in pixels."""


def configure(memory_length: int = 5, num_bits: int = 1) -> EnvSpec:
    """Return the spec under bsuite's keyword arguments.

    Parameters
    ----------
    memory_length
        How many steps lie between context and answer, 1 to 1,000.
    num_bits
        The bits of the context, 1 to 40.
    """
    length = checked_integer("memory_length", memory_length, 1, LONGEST)
    bits = checked_integer("num_bits", num_bits, 1, MOST_BITS)

    def unpack(view: Any, row: Any) -> None:
        """Write the time that is left, the question, and the context as -1 and 1; 0 for what is not shown."""
        row[0] = 1 - view.time / length
        row[1] = view.query
        for k in range(bits):
            row[2 + k] = 2 * int(view.context >> k & 1) - 1 if view.visible else 0

    def draw(state: Any) -> npt.NDArray[np.uint8]:
        """Draw the bits of the context, the one that is asked for, and below them the time."""
        picture = np.full((3, bits, 3), 255, np.uint8)
        picture[0] = [ONE if state.context >> k & 1 else ZERO for k in range(bits)]
        picture[1, min(state.query, bits - 1)] = BLACK
        cells = picture.repeat(CELL, 0).repeat(CELL, 1)
        cells[2 * CELL :, : round(state.time / (length + 1) * bits * CELL)] = BLACK
        return cells

    return EnvSpec(
        name="MemoryChain",
        version=0,
        summary="Remember what was shown at the start until it is asked for",
        rewards=(0.0, 1.0, -1.0),
        observation_space=Box(-np.inf, np.inf, (1, bits + 2), np.float32),
        action_space=Discrete(2),
        golden=make_golden(length, bits),
        unpack=unpack,
        options={"memory_length": length, "num_bits": bits},
        configure=configure,
        peers={
            "gymnax": Peer("MemoryChain-bsuite", options=("num_bits",), parameters=("memory_length",)),
            "bsuite": "bsuite.environments.memory_chain:MemoryChain",
        },
        draw=draw,
        follows="bsuite memory_chain",
        render_modes=("rgb_array",),
    )


SPEC = configure()
