"""Where slots are stepped. All devices give the same answers, bit for bit.

``"native"``
    The CPU: :class:`Native`.
``"cuda"``
    An NVIDIA GPU: :class:`Cuda`. ``Cuda(results="torch")`` keeps results there, as tensors.
``"rtl"``
    The hardware under Verilator: :class:`Rtl`.
``"xdma"``
    A board behind the XDMA driver: :class:`Xdma`. ``"xdma:1"`` is board 1, ``"xdma:DIR"`` the board
    that ``pearl serve`` simulates in that folder.
``"serial"``
    A board at a serial port: :class:`Serial`. ``"serial:/dev/ttyUSB1"`` names the port.
``"reference"``
    The golden functions as they stand: :class:`Reference`, slow, for others to be held against.

:class:`Lockstep` steps two of them as one and compares every word. :class:`Sharded` shares the slots among
several, :class:`Ray` among actors of a Ray cluster.
"""

from __future__ import annotations

from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.step import BatchStep
from pearl_marl.devices.base import Device, Phase
from pearl_marl.devices.by_name import make_device
from pearl_marl.devices.cuda import Cuda
from pearl_marl.devices.lockstep import Lockstep
from pearl_marl.devices.native import Native
from pearl_marl.devices.ray import Ray
from pearl_marl.devices.reference import Reference
from pearl_marl.devices.rtl import Rtl
from pearl_marl.devices.serial import Serial
from pearl_marl.devices.sharded import Sharded
from pearl_marl.devices.xdma import Xdma

__all__ = [
    "BatchConfig",
    "BatchStep",
    "Cuda",
    "Device",
    "Lockstep",
    "Native",
    "Phase",
    "Ray",
    "Reference",
    "Rtl",
    "Serial",
    "Sharded",
    "Xdma",
    "make_device",
]
