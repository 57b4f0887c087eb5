"""What a measurement's table says: its columns and cells, the same in a terminal and in Markdown."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from pearl_marl.benchmark.growth import Point
    from pearl_marl.benchmark.measure import Contender

KERNEL, BATCH, ENVPOOL = "kernel only", "step_batch", "EnvPool, sync"
SHORT = {ENVPOOL: "EnvPool", "Gymnasium SyncVectorEnv": "Sync", "Gymnasium's own vectorisation": "NumPy"}
"""Names of peers in the table of all environments, where those of the contenders are longer."""


class MeasuredTable(NamedTuple):
    """Headings and rows; ``text`` are the numbers of the columns that hold text and no figures."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    text: Container[int] = (0,)

    def markdown(self) -> str:
        """Return the table in Markdown."""
        rules = ("---" if column in self.text else "--:" for column in range(len(self.headings)))
        lines = (" | ".join(cells) for cells in (self.headings, rules, *self.rows))
        return "\n".join(f"| {line} |".replace("|  |", "| |") for line in lines)


def steps_table(contenders: Iterable[Contender]) -> MeasuredTable:
    """Return a row for each contender in one environment; those that are unavailable are left out."""
    measured = [contender for contender in contenders if contender.unavailable is None]
    envpool = next((contender.rate for contender in measured if contender.name == ENVPOOL), None)
    return MeasuredTable(
        ("", "agents", "agent-steps/s", "one step of all", "over EnvPool", "what is counted"),
        [
            (
                contender.name,
                f"{contender.n:,}",
                rate(contender.rate),
                duration(contender.seconds_per_step),
                "-" if envpool is None else f"{times(contender.rate / envpool)}x",
                contender.counts,
            )
            for contender in measured
        ],
        (0, 5),
    )


def rollouts_table(contenders: Iterable[Contender]) -> MeasuredTable:
    """Return a row for each way to act and step; ``x`` is what the first one does over it."""
    first, *others = (contender for contender in contenders if contender.unavailable is None)
    return MeasuredTable(
        ("", "policy steps/s", "x", "of a core", "x", "what is counted"),
        [
            (
                c.name,
                rate(c.rate),
                "" if c is first else times(first.rate / c.rate),
                rate(c.rate_of_a_core),
                "" if c is first else times(first.rate_of_a_core / c.rate_of_a_core),
                c.counts,
            )
            for c in (first, *others)
        ],
        (0, 5),
    )


def environments_table(environments: Iterable[tuple[str, Iterable[Contender]]]) -> MeasuredTable:
    """Return a row for each environment: our rates, then EnvPool's and the best other's, and x of each."""
    rows = []
    for name, contenders in environments:
        rates = {c.name: c.rate for c in contenders if c.unavailable is None}
        others = (peer for peer in rates if peer not in (KERNEL, BATCH, ENVPOOL))
        best = max(others, key=rates.__getitem__, default="")
        cells = [name, rate(rates[KERNEL]), rate(rates[BATCH])]
        for peer, label in ((ENVPOOL, ""), (best, f", {SHORT.get(best, best)}")):
            there = peer in rates
            cells += [rate(rates[peer]) + label, times(rates[BATCH] / rates[peer])] if there else ["-", "-"]
        rows.append(cells)
    return MeasuredTable(("", KERNEL, BATCH, "EnvPool", "x", "best other", "x"), rows)


def growth_table(points: Iterable[Point]) -> MeasuredTable:
    """Return a row for each environment and number of agents, in nanoseconds for each agent."""
    return MeasuredTable(
        ("", "agents", "step_batch, ns", "writing, ns", "x"),
        [
            (p.subject, f"{p.n_agents:,}", f"{p.step:.2f}", f"{p.write:.2f}", f"{p.step / p.write:.1f}")
            for p in points
        ],
    )


def training_table(summaries: Iterable[dict[str, Any]]) -> MeasuredTable:
    """Return a row for each trainer of one or several tasks; those without figures are left out."""
    rows, tasks = [], set()
    for row in summaries:
        if "missing" not in row:
            name = row["contender"]
            rows.append((name if row["task"] in tasks else f"**{row['task']}**: {name}", *_trained(row)))
            tasks.add(row["task"])
    return MeasuredTable(("", "agent-steps/s", "x", "seconds to the goal", "x"), rows, (0, 2, 4))


def _trained(row: dict[str, Any]) -> Iterable[str]:
    seconds, reached, seeds = row["seconds_to_goal"], row["reached"], row["seeds"]
    yield rate(row["agent_steps_per_second"])
    yield _range(row["rate_ratio"])
    some = f", {reached} of {seeds}" if reached < seeds else ""
    yield "-" if seconds is None else f"{seconds:.3g}{some}"
    yield _range(row["time_ratio"])


def _range(ratios: list[float] | None) -> str:
    """Return a median with the least and the most; nothing where all are 1, as ours over itself."""
    if ratios is None or set(ratios) == {1}:
        return ""
    median, least, most = (f"{value:.3g}" for value in ratios)
    return median if least == most else f"{median} ({least} to {most})"


def machine_line(facts: dict[str, Any]) -> str:
    """Return the facts of :func:`pearl_marl.evaluation.machine.machine` in a line."""
    versions = {"Python": facts["python"], **facts["versions"]}
    listed = ", ".join(f"{name} {version}" for name, version in versions.items())
    return f"{facts['processor']}, {facts['cores']} cores; {listed}"


def rate(steps_per_second: float) -> str:
    """Return steps per second as people read them: ``2.71 G``."""
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if steps_per_second >= factor:
            return f"{steps_per_second / factor:.3g} {prefix}"
    return f"{steps_per_second:.3g}"


def duration(seconds: float) -> str:
    """Return a duration as people read it: ``17.3 us``."""
    for factor, unit in ((1.0, "s"), (1e-3, "ms")):
        if seconds >= factor:
            return f"{seconds / factor:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} us"


def times(ratio: float) -> str:
    """Return how many times as fast something is: ``5,574``, or ``63.7``."""
    return f"{ratio:,.0f}" if ratio >= 100 else f"{ratio:.3g}"
