"""Where slots are stepped. All devices give the same answers, bit for bit.

``"native"``
    The CPU: :class:`Native`.
``"rtl"``
    The hardware under Verilator: :class:`Rtl`.
``"serial"``
    A board at a serial port: :class:`Serial`.
``"reference"``
    The golden functions as they stand: :class:`Reference`, slow, for others to be held against.

:class:`Lockstep` steps two of them as one and compares every word.
"""

from __future__ import annotations

from pearl_marl.devices.base import Device
from pearl_marl.devices.batch import BatchConfig, BatchStep
from pearl_marl.devices.lockstep import Lockstep
from pearl_marl.devices.native import Native
from pearl_marl.devices.reference import Reference
from pearl_marl.devices.rtl import Rtl
from pearl_marl.devices.serial import Serial
from pearl_marl.errors import ArgumentError

__all__ = [
    "BatchConfig",
    "BatchStep",
    "Device",
    "Lockstep",
    "Native",
    "Reference",
    "Rtl",
    "Serial",
    "make_device",
]

_BY_NAME: dict[str, type[Device]] = {"native": Native, "reference": Reference, "rtl": Rtl, "serial": Serial}


def make_device(device: str | Device) -> Device:
    """Return the device of that name, or the configured device that was given."""
    if isinstance(device, Device):
        return device
    if isinstance(device, type) and issubclass(device, Device):
        raise ArgumentError(f"device is the class {device.__name__}; call it: {device.__name__}()")
    if not isinstance(device, str) or device not in _BY_NAME:
        raise ArgumentError(
            f"there is no device {device!r}; possible are {', '.join(map(repr, _BY_NAME))} "
            "or a device object from pearl_marl.devices"
        )
    return _BY_NAME[device]()
