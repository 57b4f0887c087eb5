"""Table I: how long a core computes a step, in clock cycles and in nanoseconds."""

from __future__ import annotations

from pearl_marl.envs import get_spec, names
from pearl_marl.errors import DeviceError
from pearl_marl.hardware import elaboration
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.synthesis import PLACEMENTS, Family, synthesise
from pearl_marl.spec import EnvSpec

from . import paper
from .section import QUICK_ENVS, Progress, Row, row_of

TITLE = "Table I: compute time"
TEXT = (
    "From an action to its result in one core: clock cycles as the core states them and as its bench in "
    "simulation checks, and nanoseconds at the clock rate that nextpnr reaches for a build of 1,024 slots on "
    "an ECP5, the family that has free tools for it and that these cores are generated for. A VC707 has "
    "another rate. A core takes a new action every II cycles, so throughput does not wait for the latency."
)
COLUMNS = {
    "environment": "environment",
    "latency_cycles": "cycles",
    "interval_cycles": "II, cycles",
    "fmax_mhz": "MHz",
    "compute_ns": "ns",
    "counts": "what is counted, or from where",
}

N_ENVS, PE_NUM, DATA_WL = 1024, 1, 32
"""The build that is placed and routed: one core, because of some no two fit, and so many slots that memories
are block RAM. Of fewer, the paths through it are not seen."""


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Read the cores' latencies; place and route each for its clock rate; with ``quick`` only read a few."""
    specs = [get_spec(name) for name in (QUICK_ENVS if quick else names())]
    rows: list[Row] = []
    for spec in progress(specs, len(specs), "place and route"):
        timing = elaboration.core_timing(spec, Family.ECP5.target)
        common: Row = {
            "environment": spec.name,
            "latency_cycles": timing.latency,
            "interval_cycles": timing.interval,
        }
        rows.append(row_of("simulated", "stated by the core, checked by its bench in simulation", **common))
        if not quick:
            rows.append(_placed(spec, common))
        if spec.name in paper.COMPUTE_NS:
            quoted = {"environment": spec.name, "compute_ns": paper.COMPUTE_NS[spec.name]}
            rows.append(row_of("quoted", paper.COMPUTE_NS_SOURCE, **quoted))
    return rows


def _placed(spec: EnvSpec, common: Row) -> Row:
    build = f"{N_ENVS} slots, {PE_NUM} PE, {DATA_WL}-bit words"
    try:
        usage = synthesise(Build.of(spec, N_ENVS, PE_NUM, DATA_WL), Family.ECP5, fmax=True)
    except DeviceError as error:  # too large for the device, or a tool is missing
        return row_of("missing", f"{build}: {error}", **common)
    assert usage.fmax_mhz is not None
    counts = f"{build}, {PLACEMENTS[Family.ECP5].device}: nextpnr's estimate after routing, without pads"
    nanoseconds = common["latency_cycles"] * 1e3 / usage.fmax_mhz
    return row_of("predicted", counts, **common, fmax_mhz=usage.fmax_mhz, compute_ns=nanoseconds)
