"""With the pipeline and without, on the paper's board: predicted steps per second.

``python experiments/pipeline.py`` prints the table of docs/latency.md. With is the hardware as it is, in the
paper's sizes; without is the form that the paper compares with: one processing element, nothing overlaps, and
the states travel with every step. Host times are measured on this machine, in seconds; cycles are counted.
"""

from __future__ import annotations

from typing import NamedTuple

import typer

from pearl_marl.benchmark.paper import TABLE_2
from pearl_marl.hardware.boards import BOARDS
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.fitting import PARTS, modelled_bram36
from pearl_marl.latency import LINKS, HostTimes, measure_host, predict, step_cycles
from pearl_marl.latency.prediction import Prediction
from pearl_marl.memory_map import memory_map
from pearl_marl.registry import get_spec
from pearl_marl.spec import EnvSpec

BOARD = "vc707"
LINK = LINKS["gen2x8"]
"""The paper's."""

MOST, STEP = 43_008, 1024


class Comparison(NamedTuple):
    """A build with the pipeline and one without it."""

    pipelined: Prediction
    serial: Prediction

    @property
    def factor(self) -> float:
        """How many times as many steps a second the pipeline takes."""
        return self.pipelined.rate / self.serial.rate


def predicted(
    spec: EnvSpec,
    n_envs: int,
    pe_num: int,
    data_wl: int,
    pipelined: bool = True,
    host: HostTimes | None = None,
) -> Prediction:
    """Predict a step on the paper's board and link; ``.rate`` has the slots' steps per second.

    Parameters
    ----------
    spec, n_envs, pe_num, data_wl
        What is stepped, and the build's sizes.
    pipelined
        See :func:`pearl_marl.latency.predict`; the paper's form without pipeline has a ``pe_num`` of 1.
    host
        What the host takes; measured if not given.
    """
    host = host or measure_host(spec, n_envs)
    return predict(
        *Build.of(spec, n_envs, pe_num, data_wl), LINK, host, BOARDS[BOARD].clock_mhz * 1e6, pipelined
    )


def simulated_rate(
    spec: EnvSpec, n_envs: int, pe_num: int, data_wl: int, clock: float, pipelined: bool = True
) -> float:
    """Return the slots' steps per second of the hardware alone at a clock in hertz, by its cycles."""
    return n_envs * clock / step_cycles(*Build.of(spec, n_envs, pe_num, data_wl), pipelined)


def fitting(spec: EnvSpec, pe_num: int, data_wl: int) -> int:
    """Return the most slots, in steps of 1,024 up to 43,008, whose memories fit the board's part."""
    sizes = range(MOST, 0, -STEP)
    return next(
        n for n in sizes if modelled_bram36(memory_map(spec, n, pe_num, data_wl)) <= PARTS[BOARD].bram36
    )


def compare(env_id: str, n_envs: int | None = None) -> Comparison:
    """Predict both forms of one of the paper's environments, by default with as many slots as fit."""
    spec, sizes = get_spec(env_id), TABLE_2[env_id]
    n = n_envs or fitting(spec, sizes.pe_num, sizes.data_wl)
    host = measure_host(spec, n)
    return Comparison(
        predicted(spec, n, sizes.pe_num, sizes.data_wl, True, host),
        predicted(spec, n, 1, sizes.data_wl, False, host),
    )


def main() -> None:
    """Print the comparison of the paper's environments as a table in Markdown."""
    print("| environment | slots | PEs | word | with | T3 to T5 | without | T3 to T5 | factor |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for env_id in TABLE_2:
        found = compare(env_id)
        ours = found.pipelined
        rates = [f"{step.rate / 1e6:.3g} M | {step.device * 1e6:,.1f} us" for step in found]
        size = f"{ours.n_envs:,} | {ours.pe_num} | {ours.data_wl:,}"
        print(f"| {env_id} | {size} | {rates[0]} | {rates[1]} | {found.factor:.3g} |")


if __name__ == "__main__":
    typer.run(main)
