"""With the pipeline and without, on the paper's board: predicted steps per second.

``python experiments/pipeline.py`` prints the table of docs/latency.md. With is the hardware as it is, in the
paper's sizes; without is the form that the paper compares with: one processing element, nothing overlaps, and
the states travel with every step. Host times are measured on this machine, in seconds; cycles are counted.
"""

from __future__ import annotations

from typing import NamedTuple

from pearl_marl.benchmark.paper import TABLE_2
from pearl_marl.benchmark.tables import MeasuredTable
from pearl_marl.experiments import paper_builds
from pearl_marl.experiments.calling import call
from pearl_marl.hardware.boards import BOARDS
from pearl_marl.hardware.build import Build
from pearl_marl.latency import LINKS, HostTimes, measure_host, predict, step_cycles
from pearl_marl.latency.prediction import Prediction
from pearl_marl.spec import EnvSpec

LINK, CLOCK = LINKS["gen2x8"], BOARDS[paper_builds.BOARD].clock_mhz * 1e6
"""The paper's link, and the clock in hertz that our design for its board has."""


class PipelineGain(NamedTuple):
    """A build with the pipeline and one without it."""

    pipelined: Prediction
    serial: Prediction
    fits: paper_builds.Verdict
    """Whether the first fits the part on the paper's board."""

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
    return predict(*Build.of(spec, n_envs, pe_num, data_wl), LINK, host, CLOCK, pipelined)


def simulated_rate(
    spec: EnvSpec, n_envs: int, pe_num: int, data_wl: int, clock: float, pipelined: bool = True
) -> float:
    """Return the slots' steps per second of the hardware alone at a clock in hertz, by its cycles."""
    return n_envs * clock / step_cycles(*Build.of(spec, n_envs, pe_num, data_wl), pipelined)


def compare(env_id: str, n_envs: int | None = None) -> PipelineGain:
    """Predict both forms of one of the paper's environments, by default with as many slots as memory fits."""
    build = paper_builds.build(env_id, n_envs)
    (spec, layout), n = build, build.layout.n_envs
    host = measure_host(spec, n)
    return PipelineGain(
        predicted(spec, n, layout.pe_num, layout.data_wl, True, host),
        predicted(spec, n, 1, layout.data_wl, False, host),
        paper_builds.verdict(build),
    )


def main() -> None:
    """Print the comparison of the paper's environments as a table in Markdown."""
    rows = []
    for env_id in TABLE_2:
        found = compare(env_id)
        size = [f"{figure:,}" for figure in (found.pipelined.n_envs, found.pipelined.pe_num)]
        cells = [env_id, *size, f"{found.pipelined.data_wl:,}"]
        for step in (found.pipelined, found.serial):
            cells += [f"{step.rate / 1e6:.3g} M", f"{step.device * 1e6:,.1f} us"]
        rows.append([*cells, f"{found.factor:.3g}", f"{found.fits.text} ({found.fits.source})"])
    build, forms = ("environment", "slots", "PEs", "word"), ("with", "T3 to T5", "without", "T3 to T5")
    print(MeasuredTable((*build, *forms, "factor", "on a VC707"), rows, text=(0, 9)).markdown())


if __name__ == "__main__":
    call(main)
