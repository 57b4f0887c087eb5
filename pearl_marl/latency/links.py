"""T2 and T6: the link between host and hardware, as so much for a call and so much for a byte."""

from __future__ import annotations

from dataclasses import dataclass

from pearl_marl.errors import ArgumentError


@dataclass(frozen=True, slots=True)
class Link:
    """What lies between host and hardware, as ``pearl plan --link`` takes it by name.

    ``call`` is what a transfer takes besides its bytes, in seconds; the rates to the hardware and from it are
    in bytes per second. ``source`` says where the figures are from.
    """

    name: str
    call: float
    write_rate: float
    read_rate: float
    source: str

    def __post_init__(self) -> None:
        for what in ("call", "write_rate", "read_rate"):
            value = getattr(self, what)
            if not value >= 0 or (what != "call" and value == 0):
                raise ArgumentError(f"{what} of the link {self.name!r} is {value}; it must be positive")


_DRIVER = "https://github.com/Xilinx/dma_ip_drivers/issues"
_CALL = 30e-6

LINKS = {
    link.name: link
    for link in (
        Link(
            "gen2x4",
            _CALL,
            1.6e9,
            1.3e9,
            "reported: a K7-325T at 1.6 and 1.3 GB/s (https://github.com/Prandr/dma_ip_drivers/issues/6), "
            f"30 us a call ({_DRIVER}/321)",
        ),
        Link("gen2x8", _CALL, 3.2e9, 2.6e9, "the paper's link: gen2x4 with twice the lanes, 30 us a call"),
        Link(
            "gen3x16",
            _CALL,
            5e9,
            5e9,
            f"reported: 5 to 6 GB/s through the stock driver ({_DRIVER}/293), 30 us a call ({_DRIVER}/321)",
        ),
    )
}
"""Links by name. The figures are of the Xilinx XDMA driver, as its users report them; measure your own."""
