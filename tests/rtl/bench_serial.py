"""The ULX3S plugged in: its serial line behind a pseudo-terminal, for a host in another process."""

from __future__ import annotations

import os
import pty
import time
from pathlib import Path
from typing import Any

import cocotb
import harness
from bench_ulx3s import BIT, start
from cocotb.triggers import Timer

PORT, UNPLUG = (Path(harness.arguments()[name]) for name in ("port", "unplug"))


@cocotb.test
async def until_it_is_unplugged(dut: Any) -> None:
    line = await start(dut)
    board, host = pty.openpty()
    os.set_blocking(board, False)
    PORT.symlink_to(os.ttyname(host))
    while not UNPLUG.exists():
        if line.received:
            os.write(board, line.received)
            line.received.clear()
        try:
            data = os.read(board, 4096)
        except BlockingIOError:
            data = b""
            time.sleep(0.0002)
        await line.send(data)
        await Timer(20 * BIT, "ns")
