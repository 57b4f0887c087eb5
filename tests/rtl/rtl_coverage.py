"""What the benches reach of the sources: line and toggle coverage, of all runs and builds together."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

# A point in Verilator's data: keys and values, each after a control character of its own, and a count.
_POINT = re.compile(r"^C '(?P<keys>.*)' (?P<count>\d+)$", re.MULTILINE)
_KEY = re.compile(r"\x01([^\x02]*)\x02([^\x01]*)")


@dataclass
class Module:
    """The points of one source file, by place: how often each was reached, in any build."""

    lines: Counter[tuple[int, str]] = field(default_factory=Counter)
    """By line and branch: a statement, or one way out of an if, a case or a conditional."""
    toggles: Counter[tuple[int, str]] = field(default_factory=Counter)
    """By line of its declaration and bit, with the direction."""


def merge(files: Iterable[Path]) -> dict[str, Module]:
    """Add up the data of many runs; a point of a module counts for all of its instances."""
    modules: dict[str, Module] = defaultdict(Module)
    for file in files:
        for point in _POINT.finditer(file.read_text(errors="replace")):
            keys = dict(_KEY.findall(point["keys"]))
            kind = keys["page"].partition("/")[0].removeprefix("v_")
            module = modules[Path(keys["f"]).stem]
            counts = module.toggles if kind == "toggle" else module.lines
            what = keys["o"] if kind == "toggle" else f"{keys['o']} at column {keys['n']}"
            counts[int(keys["l"]), what] += int(point["count"])
    return dict(modules)


def _share(counts: Counter[tuple[int, str]]) -> str:
    return f"{sum(count > 0 for count in counts.values()):,} / {len(counts):,}"


def _signals(counts: Counter[tuple[int, str]]) -> list[str]:
    """The signals with bits that did not change both ways, and how many of theirs did."""
    bits: dict[tuple[int, str], list[bool]] = defaultdict(list)
    for (line, what), count in counts.items():
        bits[line, re.split(r"[\[:]", what)[0]].append(count > 0)
    return [
        f"{name} (line {line}): {sum(found)} of {len(found)}"
        for (line, name), found in sorted(bits.items())
        if not all(found)
    ]


def report(modules: dict[str, Module]) -> str:
    """A table of all modules, then what is left in each."""
    rows = ["| module | lines | toggles |", "| --- | ---: | ---: |"]
    rest = []
    for name, module in sorted(modules.items()):
        rows.append(f"| `{name}` | {_share(module.lines)} | {_share(module.toggles)} |")
        missed = [f"line {line}: {what}" for (line, what), count in sorted(module.lines.items()) if not count]
        rest += [f"- {name}, {where}" for where in missed]
        rest += [f"- {name}, toggles of {signal}" for signal in _signals(module.toggles)]
    return "\n".join([*rows, "", *rest, ""])
