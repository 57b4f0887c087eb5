"""A board behind the Xilinx XDMA driver, or a simulated one that ``pearl serve`` puts behind files.

::

    Xdma  --(devices/comm_bram.py)-->  XdmaTransport  --(pwrite, pread)-->  the board
"""

from __future__ import annotations

import os
from typing import ClassVar

import numpy as np

from pearl_marl.batch.config import BatchConfig
from pearl_marl.checks import checked_choice, checked_count_or_none, checked_number
from pearl_marl.devices.comm_bram import CommBram
from pearl_marl.devices.recovery import CHECKPOINT_EVERY, CheckpointLog
from pearl_marl.devices.transport import Transport
from pearl_marl.devices.xdma_transport import COMPLETIONS, XdmaTransport
from pearl_marl.errors import ArgumentError


class Xdma(CommBram):
    """A board behind the XDMA driver.

    Parameters
    ----------
    board
        Its number *N* in ``/dev/xdmaN_h2c_0``, or the folder of a board that ``pearl serve`` simulates.
    completion
        How the end of a step is noticed. ``"poll"`` reads the results at once; if they are not yet those
        of the step, it reads the status until it is, and the results again. ``"event"`` waits for the
        board's interrupt first. ``None`` is ``"event"`` for a served board, which knows no other way, and
        ``"poll"`` for a real one.
    timeout
        Seconds until a step is given up, or a rollout that gets no further.
    checkpoint_every
        Steps between two states that are kept on the host for :meth:`recover`; ``None`` keeps nothing.
    """

    name = "xdma"
    recovery_type = CheckpointLog
    transport_type: ClassVar[type[XdmaTransport]] = XdmaTransport
    """What moves the bytes; tests put links that fail in its place."""

    def __init__(
        self,
        board: int | str | os.PathLike[str] = 0,
        completion: str | None = None,
        timeout: float = 10.0,
        checkpoint_every: int | None = CHECKPOINT_EVERY,
    ) -> None:
        self.checkpoint_every = checked_count_or_none("checkpoint_every", checkpoint_every)
        if isinstance(board, (str, os.PathLike)):
            self.board: int | str = os.fspath(board)
        elif isinstance(board, (int, np.integer)) and not isinstance(board, bool) and board >= 0:
            self.board = int(board)
        else:
            raise ArgumentError(f"board is {board!r}; it must be a number from 0 on, or a folder")
        self._completion = checked_choice("completion", completion, (*COMPLETIONS, None))
        self.patience = checked_number("timeout", timeout, above=0, below=1e6)

    def _connect(self, config: BatchConfig) -> tuple[Transport, None]:
        return self.transport_type(self.board, self._completion, self.patience), None
