"""The README's tables of measured results, of the data of Figure 6."""

from __future__ import annotations

from typing import Any

from pearl_marl.benchmark.measure import duration, rate

from .figure6 import BATCH, ENVPOOL, KERNEL, PEERS, README_ENV, SIMULATED, SYNC
from .section import Row

ROWS = {
    KERNEL: (KERNEL, "golden step and rewards; no observations, no resets"),
    "step_batch, copy=False": ("`step_batch(copy=False)`", "checked actions, all result arrays"),
    BATCH: ("`step_batch`", "the same, results yours to keep"),
    "Gymnasium VectorEnv step": ("Gymnasium `VectorEnv.step`", "arrays and infos, `int64` actions"),
    "PettingZoo step, array actions": ("PettingZoo `step`, array of actions", "five dicts that nobody reads"),
    "PettingZoo step, dict actions": ("PettingZoo `step`, dict of actions", "five dicts, every key read"),
    SIMULATED: ('`device="rtl"`', "the FPGA design, simulated"),
    ENVPOOL: ("EnvPool", "all result arrays, all cores"),
    SYNC: ("Gymnasium `SyncVectorEnv`", "all result arrays"),
    "Gymnasium AsyncVectorEnv": ("Gymnasium `AsyncVectorEnv`", "all result arrays, a process a slot"),
}
"""Contenders of the first table, with its words for each and for what is counted."""


def tables(data: dict[str, Any]) -> str:
    """Return the README's two tables in Markdown, of the data file of Figure 6."""
    kinds = ("measured", "simulated")
    measured = [row for row in data["rows"] if row["kind"] in kinds and row.get("steps_per_second")]
    lines = [*_one(measured), "", *_all(measured), "", _footnote(data), ""]
    return "\n".join(lines)


def _one(measured: list[Row]) -> list[str]:
    """Return the first table: everything that is timed, of one environment."""
    lines = [
        f"{README_ENV}:",
        "",
        "| | agents | agent-steps/s | one step of all | over EnvPool | what is counted |",
        "| --- | --: | --: | --: | --: | --- |",
    ]
    envpool = _rate(measured, README_ENV, [ENVPOOL])
    for contender, (title, counts) in ROWS.items():
        row = _largest(measured, README_ENV, [contender])
        if row is not None:
            steps, each = row["steps_per_second"], row["microseconds_per_step"] * 1e-6
            over = "-" if envpool is None else f"{_times(steps / envpool)}x"
            middle = f"{row['n_envs']:,} | {rate(steps)} | {duration(each)} | {over}"
            lines.append(f"| {title} | {middle} | {counts} |")
    return lines


def _all(measured: list[Row]) -> list[str]:
    """Return the second table: a row an environment, beside its best peers."""
    largest = max(row["n_envs"] for row in measured)
    lines = [
        f"All, {largest:,} agents (peers of pure Python: fewer); x is `step_batch` over that peer:",
        "",
        "| | kernel only | `step_batch` | EnvPool | x | best of Gymnasium and MinAtar | x |",
        "| --- | --: | --: | --: | --: | --: | --: |",
    ]
    others = [peer for peer in PEERS if peer != ENVPOOL]
    for name in dict.fromkeys(row["environment"] for row in measured):
        batch = _rate(measured, name, [BATCH]) or 0.0
        best = _largest(measured, name, others, by="steps_per_second")
        figures = [rate(_rate(measured, name, [KERNEL]) or 0.0), rate(batch)]
        for peer, label in ((_largest(measured, name, [ENVPOOL]), ""), (best, _short(best))):
            if peer is None:
                figures += ["-", "-"]
            else:
                figures += [rate(peer["steps_per_second"]) + label, _times(batch / peer["steps_per_second"])]
        lines.append(f"| {name} | {' | '.join(figures)} |")
    return lines


def _footnote(data: dict[str, Any]) -> str:
    machine, versions = data["machine"], data["machine"]["versions"]
    packages = ", ".join(
        f"{name} {versions[name]}" for name in ("numpy", "numba", "gymnasium", "envpool") if name in versions
    )
    return (
        f"*{machine['processor']}, {machine['cores']} cores, {data['date'][:10]}; medians; "
        f"Python {machine['python']}, {packages}.*"
    )


def _largest(rows: list[Row], name: str, contenders: list[str], by: str = "n_envs") -> Row | None:
    found = [row for row in rows if row["environment"] == name and row["contender"] in contenders]
    return max(found, key=lambda row: float(row[by]), default=None)


def _rate(rows: list[Row], name: str, contenders: list[str]) -> float | None:
    row = _largest(rows, name, contenders)
    return None if row is None else float(row["steps_per_second"])


def _short(row: Row | None) -> str:
    if row is None:
        return ""
    words = {SYNC: "`SyncVectorEnv`", "Gymnasium's own vectorisation": "its NumPy form"}
    return f", {words.get(row['contender'], row['contender'])}"


def _times(ratio: float) -> str:
    return f"{float(f'{ratio:.3g}'):,.10g}"
