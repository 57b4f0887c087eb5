"""Table III: frameworks of parallel environments beside each other, on CliffWalking."""

from __future__ import annotations

from pearl_marl.benchmark.tables import BATCH, ENVPOOL
from pearl_marl.envs import get_spec
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.fitting import largest_fit
from pearl_marl.hardware.synthesis import synthesise

from . import figure6, figure8, paper
from .figure9 import BUILDS
from .section import Progress, Row, row_of

TITLE = "Table III: frameworks"
TEXT = (
    "Gymnasium's vector environment, EnvPool and this platform on CliffWalking: agent-steps per second, "
    "those per joule, and how many environments each was run with or has room for."
)
COLUMNS = {
    "framework": "framework",
    "platform": "on",
    "n_envs": "environments",
    "steps_per_second": "steps/s",
    "steps_per_joule": "steps/J",
    "most_envs": "most environments",
    "counts": "what is counted, or from where",
}

ENV = "CliffWalking"


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Time the frameworks at the largest size; predict the board, and how many slots fit it."""
    spec = get_spec(ENV)
    n = figure6.QUICK_SIZES[-1] if quick else figure6.SIZES[-1]
    shown = {
        figure6.SYNC: ("Gymnasium SyncVectorEnv", "CPU"),
        ENVPOOL: ("EnvPool", "CPU"),
        BATCH: ("this platform, step_batch", "CPU"),
        figure6.SIMULATED: ("this platform, simulated", "FPGA, by Verilator"),
        figure6.BOARD: ("this platform, predicted", "CPU + FPGA"),
    }
    timed = figure6.throughput(spec, n, (), quick, progress, list(shown)) + figure6.predicted(spec, n)
    rows: list[Row] = []
    for row in timed:
        if row["contender"] in shown:
            framework, platform = shown[row["contender"]]
            rows.append(
                row_of(
                    row["kind"],
                    row["counts"],
                    framework=framework,
                    platform=platform,
                    n_envs=row["n_envs"],
                    steps_per_second=row.get("steps_per_second"),
                )
            )
    if not quick:
        rows.append(_most())
    rows += [
        {**row, "framework": f"steps/J of {row['contender']}"}
        for row in figure8.measured([ENV], quick, progress)
    ]
    rows += [
        row_of(
            "quoted",
            paper.FRAMEWORKS_SOURCE,
            framework=name,
            platform="CPU + FPGA" if "board" in name else "CPU",
            steps_per_second=framework.steps_per_second,
            steps_per_joule=framework.steps_per_joule,
            most_envs=framework.n_envs,
        )
        for name, framework in paper.FRAMEWORKS.items()
    ]
    return rows


def _most() -> Row:
    spec, (pe_num, data_wl) = get_spec(ENV), BUILDS[ENV]
    usage = synthesise(Build.of(spec, figure6.SIZES[-1], pe_num, data_wl))
    fit = largest_fit(spec, [usage], figure6.PART)
    counts = f"block RAM of a {fit.part.name}, {pe_num} PEs, {data_wl}-bit words, as --fit predicts"
    return row_of("predicted", counts, framework="this platform", platform="CPU + FPGA", most_envs=fit.n_envs)
