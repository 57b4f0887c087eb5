"""What the latency model says of builds at real sizes.

``python experiments/predictions.py`` prints the tables of docs/latency.md: the paper's loops, bursts, what
``pearl plan`` chooses, the prediction for the paper's link. Cycles are counted, host times measured on this
machine; the clock is that of our design for its board. ``latency_model.py`` has the model beside simulation,
``pipeline.py`` with the pipeline and without.
"""

from __future__ import annotations

from collections.abc import Iterable

from pearl_marl.benchmark.tables import MeasuredTable, duration, rate
from pearl_marl.envs import get_spec, names
from pearl_marl.experiments import paper_builds, pipeline
from pearl_marl.experiments.calling import call
from pearl_marl.experiments.equations import LOOPS
from pearl_marl.hardware.fitting import PARTS, modelled_bram36
from pearl_marl.latency import HostTimes, loop_cycles, plan, predict
from pearl_marl.latency.cycles import read_cycles, write_cycles
from pearl_marl.latency.prediction import Overlap
from pearl_marl.memory_map import memory_map

SLOTS = 43_008
PAPERS_LINK = (64, 256)
"""Processing elements and bits of a word of CliffWalking behind the paper's link."""


def main() -> None:
    """Print every table in Markdown."""
    _print("The paper's loops (docs/latency.md)", "pe_num | word | Eq. 2 | Eq. 3 | this design", _loops())
    _print("Bursts (docs/latency.md)", _HEADINGS_BURSTS, _bursts())
    _print("What pearl plan chooses (docs/latency.md)", _HEADINGS_PLANS, _plans())
    _print("Prediction for the paper's link (docs/latency.md)", _HEADINGS_LINK, _papers_link())


_HEADINGS_BURSTS = "bursts | beats | write | read | of the bus | T2 | T6"
_HEADINGS_PLANS = (
    "environment | slots | PEs | word | BRAM36 | DSP | computing | link | steps/s | halves | by speed alone"
)
_HEADINGS_LINK = "slots | T1 | T2 | T3 to T5 | T6 | T7 | a step | steps/s | two half-batches in flight"


def _print(title: str, headings: str, rows: Iterable[tuple[str, ...]]) -> None:
    print(f"\n{title}\n\n{MeasuredTable(headings.split(' | '), list(rows), text=()).markdown()}")


def _loops() -> Iterable[tuple[str, ...]]:
    spec = get_spec("CliffWalking")
    for loop in LOOPS:
        yield tuple(f"{figure:,}" for figure in (*loop[1:], *loop_cycles(spec, memory_map(spec, *loop))))


def _bursts() -> Iterable[tuple[str, ...]]:
    """Behind the paper's link: of any length, if they are queued, and else of so many bytes at most."""
    spec, (pe_num, data_wl) = get_spec("CliffWalking"), PAPERS_LINK
    layout, nothing = memory_map(spec, SLOTS, pe_num, data_wl), HostTimes(0, 0)
    words = layout.step_read[1] * 8 // data_wl
    for burst in (None, 4096, 512, 256, 128, 64):
        cycles = write_cycles(layout, burst), read_cycles(layout, burst)
        step = predict(spec, layout, pipeline.LINK, nothing, pipeline.CLOCK, burst=burst)
        yield (
            "queued" if burst is None else f"{burst:,} bytes",
            "any" if burst is None else f"{burst * 8 // data_wl:,}",
            *(f"{figure:,}" for figure in cycles),
            f"{words / cycles[1]:.0%}",
            *(duration(seconds) for seconds in (step.write, step.read)),
        )


def _plans() -> Iterable[tuple[str, ...]]:
    """Plan for the paper's board, with 43,008 slots or, 1,024 by 1,024, as many as it has block RAM for."""
    for name in names():
        spec, slots = get_spec(name), SLOTS
        part = PARTS[paper_builds.BOARD]
        while modelled_bram36(memory_map(spec, slots, 1, 1024)) > part.bram36:
            slots -= 1024
        chosen, alone = (plan(spec, slots, pipeline.LINK, pipeline.CLOCK, limit) for limit in (part, None))
        build, step = chosen.chosen, chosen.chosen.prediction
        assert chosen.overlap is not None
        yield (
            name,
            *(f"{figure:,}" for figure in (slots, step.pe_num, step.data_wl, build.bram36, build.dsp)),
            *(duration(seconds) for seconds in (step.device, step.link)),
            *(rate(steps) for steps in (step.rate, chosen.overlap.rate)),
            f"{alone.chosen.layout.pe_num:,} PEs, {alone.chosen.dsp:,} DSP",
        )


def _papers_link() -> Iterable[tuple[str, ...]]:
    spec = get_spec("CliffWalking")
    for slots in (SLOTS, 2 * SLOTS, 4 * SLOTS, 8 * SLOTS):
        step = pipeline.predicted(spec, slots, *PAPERS_LINK)
        both = Overlap(pipeline.predicted(spec, slots // 2, *PAPERS_LINK))
        stages = (step.pack, step.write, step.device, step.read, step.unpack, step.total)
        rates = (rate(steps) for steps in (step.rate, both.rate))
        yield f"{slots:,}", *(duration(seconds) for seconds in stages), *rates


if __name__ == "__main__":
    call(main)
