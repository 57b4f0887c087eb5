"""From a name, as users write it, to a device."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from pearl_marl.devices.base import Device
from pearl_marl.devices.cuda import Cuda
from pearl_marl.devices.native import Native
from pearl_marl.devices.reference import Reference
from pearl_marl.devices.rtl import Rtl
from pearl_marl.devices.serial import Serial
from pearl_marl.devices.xdma import Xdma
from pearl_marl.errors import ArgumentError

_KINDS: tuple[type[Device], ...] = (Cuda, Native, Reference, Rtl, Serial, Xdma)
_BY_NAME = {kind.name: kind for kind in _KINDS}


def make_device(device: str | Device, *, tensors: bool = False) -> Device:
    """Return the device of that name, or the configured device itself.

    With ``tensors``, one made by name keeps its results as tensors, if it can.
    """
    if isinstance(device, Device):
        return device
    if isinstance(device, type) and issubclass(device, Device):
        raise ArgumentError(f"device is the class {device.__name__}; call it: {device.__name__}()")
    name, colon, board = device.partition(":") if isinstance(device, str) else ("", "", "")
    if name == Xdma.name and board:
        return Xdma(int(board) if board.isdecimal() else board)
    if name == Serial.name and board:
        return Serial(board)
    near = difflib.get_close_matches(name.lower(), _BY_NAME, 1)
    if name not in _BY_NAME and near:
        raise ArgumentError(f"there is no device {device!r}; did you mean {near[0] + colon + board!r}?")
    if name not in _BY_NAME or colon:
        raise ArgumentError(
            f"there is no device {device!r}; possible are {', '.join(map(repr, _BY_NAME))}, "
            "'xdma:N' for board N, 'xdma:DIR' for a served one, 'serial:PORT', or a device object from "
            "pearl_marl.devices"
        )
    return Cuda(results="torch") if tensors and name == Cuda.name else _BY_NAME[name]()


def make_distinct(name: str, devices: Sequence[str | Device], use: str) -> list[Device]:
    """Return devices for as many shares of slots; refuse what is no list of them, or has one twice."""
    if isinstance(devices, str) or not isinstance(devices, Sequence) or not devices:
        raise ArgumentError(f"{name} is {devices!r}; it must be a list of at least one device")
    made = [make_host_device(device) for device in devices]
    if len(set(map(id, made))) < len(made):
        raise ArgumentError(f"the same device is among the {name} twice; {use}")
    return made


def make_host_device(device: str | Device) -> Device:
    """Do the same, where results are worked on with NumPy; refuse a device that keeps them as tensors."""
    made = make_device(device)
    if made.tensors:
        raise ArgumentError("its results are needed on the host: give Cuda(results='numpy'), or 'cuda'")
    return made
