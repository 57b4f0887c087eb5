"""The proof that a core's text does what its schedule says, operation by operation.

For all words that an operation's arguments can be, what the text assigns to its signal is what the operation
means, in the bits that somebody uses, and made of signals of the same cycle.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import z3

from pearl_marl.compiler.core_graph import Output
from pearl_marl.compiler.expressions import Expressions
from pearl_marl.compiler.scheduling import Schedule
from pearl_marl.golden.tracing.nodes import Node
from pearl_marl.spec import EnvSpec, word_bits

from .netlist import Netlist
from .words import always, fitted, in_range, operation, size

DEPTH = 3
"""So many operations are looked at together where one alone does not tell."""


def unproved_signals(
    path: Path, top: str, spec: EnvSpec, outputs: Sequence[Output], schedule: Schedule
) -> Iterator[str]:
    """Yield the signals and ports of a core's text that are not proved."""
    yield from _Proof(Netlist(path, top), spec, outputs, schedule).unproved()


def _vector(word: Any) -> Any:
    return z3.If(word, z3.BitVecVal(1, 1), z3.BitVecVal(0, 1)) if z3.is_bool(word) else word


class _Proof:
    def __init__(
        self, netlist: Netlist, spec: EnvSpec, outputs: Sequence[Output], schedule: Schedule
    ) -> None:
        self.netlist, self.spec, self.outputs, self.schedule = netlist, spec, outputs, schedule
        self.text = Expressions(outputs, schedule)
        self.made: dict[Node, tuple[str, int]] = {}
        """The signals that have a proof of their own, in their cycle."""
        self.signals: dict[tuple[str, int], Any] = {}
        """These as words."""
        self.integers: dict[Node, Any] = {}
        """The integers that these stand for."""
        self.facts: dict[Node, list[Any]] = {}
        for node in schedule.order:
            if node.op == "input":
                self._know(node, self._port(node))
            elif node not in self.text.inlined:
                name, stage = netlist.signal(self.text.names[node]), schedule.stage[node]
                # Of a signal that is put together of others, these others are looked at.
                if name in netlist.made and (name, stage) not in self.signals:
                    body, written = netlist.made[name], self.text.names[node]
                    word = z3.Bool(written) if z3.is_bool(body) else z3.BitVec(written, body.size())
                    self.made[node], self.signals[name, stage] = (name, stage), word
                    self._know(node, _vector(word))

    def unproved(self) -> Iterator[str]:
        for node, (name, stage) in self.made.items():
            opened = {node}
            if not any(self._proved(node, name, stage, opened) for _ in range(DEPTH)):
                yield self.text.names[node]
        for port in dict.fromkeys(output.port for output in self.outputs):
            facts: list[Any] = []
            parts = [
                fitted(self._integer(o.node, facts, set()), o.bits) for o in self.outputs if o.port == port
            ]
            due = z3.Concat(*reversed(parts)) if len(parts) > 1 else parts[0]
            if not always(self._port_at(port, self.schedule.latency) == due, facts):
                yield port
        if not self._valid_in_time():
            yield "valid_o"

    def _valid_in_time(self) -> bool:
        """Return whether a result is valid if its input was, unless there was a reset in between."""
        name, top, latency = self.netlist.signal("rst_ni"), self.netlist.top, self.schedule.latency
        on = z3.BoolVal(True) if z3.is_const(self.netlist.made[f"{top}_n rst_ni"]) else z3.BitVecVal(1, 1)
        ready = {(name, cycle): on for cycle in range(latency + 1)}
        due = self.netlist.value(f"{top}_n valid_i", 0, {})
        return always(_vector(self.netlist.value(f"{top}_n valid_o", latency, ready)) == _vector(due), [])

    def _port_at(self, port: str, cycle: int) -> Any:
        return _vector(self.netlist.value(f"{self.netlist.top}_n {port}", cycle, self.signals))

    def _port(self, node: Node) -> Any:
        """Return the word of an input, as the graph has it: a port or a part of one."""
        match = re.fullmatch(r"(\w+?)(?:\.(\w+)|\[(\d+)\])?", node.imm)
        assert match
        names = [f.name for f in self.spec.state]
        fields = self.spec.state[: names.index(match[2])] if match[2] else ()
        each = word_bits(self.spec.action_fields) if match[1] == "action_i" else 32
        low = each * int(match[3] or 0) + sum(f.bits for f in fields)
        return z3.Extract(low + node.bits - 1, low, self._port_at(match[1], 0))

    def _used(self, node: Node) -> int:
        """Return the bits of a node that somebody uses, or that are known to be 0."""
        return int(self.schedule.used[node] | (~node.ones if node.low >= 0 else 0))

    def _know(self, node: Node, word: Any) -> None:
        """Note what integers a node can be whose signal is ``word``."""
        whole = (1 << word.size()) - 1
        used = self._used(node) & whole
        if node.op == "input" or (used == whole and word.size() >= node.bits):
            integer = z3.Extract(node.bits - 1, 0, word)
            integer = z3.ZeroExt(1, integer) if node.low >= 0 else integer
            facts = []
        else:
            integer = z3.BitVec(f"{self.text.names[node]} as an integer", size(node))
            facts = [(fitted(integer, word.size()) ^ word) & used == 0]
        self.integers[node], self.facts[node] = integer, [*facts, *in_range(node, integer)]

    def _integer(self, node: Node, facts: list[Any], opened: set[Node]) -> Any:
        """Return a node made of those that are not opened; note facts about these."""
        made: dict[Node, Any] = {}

        def make(n: Node) -> Any:
            if n not in made:
                if n in self.integers and n not in opened:
                    facts.extend(self.facts[n])
                    made[n] = self.integers[n]
                else:
                    made[n] = operation(n, [make(a) for a in n.args])
                    facts.extend(in_range(n, made[n]))
                    if n.op == "table":  # what is beyond its end nobody looks at
                        facts.append(made[n.args[0]] <= len(n.imm) - 1)
            return made[n]

        result = make(node)
        opened |= {n for n in made if n in self.made}
        return result

    def _proved(self, node: Node, name: str, stage: int, opened: set[Node]) -> bool:
        """Return whether a signal is proved of what is not opened; if not, open what it is made of."""
        facts: list[Any] = []
        known = dict(self.signals)
        for n in opened:
            del known[self.made[n]]
        integer = self._integer(node, facts, opened)
        word = _vector(self.netlist.value(name, stage, known))
        return always((word ^ fitted(integer, word.size())) & self._used(node) == 0, facts)
