"""Which boards are plugged in, as sysfs tells."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path
from typing import NamedTuple

SYS = Path("/sys")
XILINX = "0x10ee"
"""The vendor of the XDMA core's PCI devices."""


class FoundBoard(NamedTuple):
    """A board that the XDMA driver has taken up."""

    number: int
    """*N* in ``/dev/xdmaN_h2c_0``."""
    device_id: str
    """The PCI device, such as ``"10ee:7028"``."""
    slot: str
    """Where it is plugged in, such as ``"0000:01:00.0"``."""


def boards() -> list[FoundBoard]:
    """Return the boards that the XDMA driver has taken up, from sysfs."""
    found = []
    for node in (SYS / "class" / "xdma").glob("xdma*_h2c_0"):
        match = re.fullmatch(r"xdma(\d+)_h2c_0", node.name)
        pci = node / "device"
        with contextlib.suppress(OSError):
            if match and (vendor := _text_of(pci / "vendor")) == XILINX:
                device = _text_of(pci / "device")
                found.append(FoundBoard(int(match[1]), f"{vendor[2:]}:{device[2:]}", pci.resolve().name))
    return sorted(found)


def boards_without_driver() -> list[str]:
    """Return the slots of PCI devices by Xilinx that no driver has taken up."""
    slots = []
    for device in (SYS / "bus" / "pci" / "devices").glob("*"):
        with contextlib.suppress(OSError):
            if _text_of(device / "vendor") == XILINX and not (device / "driver").exists():
                slots.append(device.name)
    return sorted(slots)


def _text_of(file: Path) -> str:
    return file.read_text("utf-8", errors="replace").strip()
