"""Operations as SystemVerilog expressions: each of what its arguments are in its stage.

Signals have the author's names, and in later stages the number of the stage (``row_q2``).

Every expression here is unsigned and exactly as wide as its word, whatever the integer is. A signed one would
read a table below its start, or make others around it signed; only the operators that need a sign get one.
"""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Sequence

from pearl_marl.compiler.core_graph import Output
from pearl_marl.compiler.scheduling import Schedule
from pearl_marl.compiler.widths import WIRES, width
from pearl_marl.golden.tracing.nodes import Node
from pearl_marl.golden.tracing.operations import VALUES

KEYWORDS = frozenset(
    """
    accept_on alias always always_comb always_ff always_latch and assert assign assume automatic before
    begin bind bins binsof bit break buf bufif0 bufif1 byte case casex casez cell chandle checker class
    clocking cmos config const constraint context continue cover covergroup coverpoint cross deassign
    default defparam design disable dist do edge else end endcase endchecker endclass endclocking
    endconfig endfunction endgenerate endgroup endinterface endmodule endpackage endprimitive endprogram
    endproperty endsequence endspecify endtable endtask enum event eventually expect export extends
    extern final first_match for force foreach forever fork forkjoin function generate genvar global
    highz0 highz1 if iff ifnone ignore_bins illegal_bins implements implies import incdir include
    initial inout input inside instance int integer interconnect interface intersect join join_any
    join_none large let liblist library local localparam logic longint macromodule matches medium
    modport module nand negedge nettype new nexttime nmos nor noshowcancelled not notif0 notif1 null or
    output package packed parameter pmos posedge primitive priority program property protected pull0
    pull1 pulldown pullup pulsestyle_ondetect pulsestyle_onevent pure rand randc randcase randsequence
    rcmos real realtime ref reg reject_on release repeat restrict return rnmos rpmos rtran rtranif0
    rtranif1 s_always s_eventually s_nexttime s_until s_until_with scalared sequence shortint shortreal
    showcancelled signed small soft solve specify specparam static string strong strong0 strong1 struct
    super supply0 supply1 sync_accept_on sync_reject_on table tagged task this throughout time
    timeprecision timeunit tran tranif0 tranif1 tri tri0 tri1 triand trior trireg type typedef union
    unique unique0 unsigned until until_with untyped use uwire var vectored virtual void wait wait_order
    wand weak weak0 weak1 while wildcard wire with within wor xnor xor
    """.split()  # noqa: SIM905
)
"""All of IEEE 1800-2017, to which the edition of 2023 adds none."""

TAKEN = frozenset(
    """
    clk_i rst_ni valid_i first_i hold_i state_i action_i rng_i valid_o state_o obs_o reward_o terminated_o
    valid_q state_t action_t unused LATENCY II STATE_BITS ACTION_BITS OBS_BITS REWARD_BITS
    obs_i action_o view_t
    """.split()  # noqa: SIM905
)
"""Names that every core has, of an environment or of a policy."""

UNNAMED = {
    "sum": "sum", "mul": "product", "choose": "chosen", "and": "both", "or": "either", "xor": "differs",
    "equal": "same", "less": "less", "table": "entry", "left_by": "raised", "right_by": "lowered",
    "word": "word",
}  # fmt: skip
SIGNS = {"and": "&", "or": "|", "xor": "^"}


def identifier(name: str) -> str:
    """Return a name that is no keyword, and that of no other name."""
    return f"{name}_" if name.rstrip("_") in KEYWORDS else name


def literal(value: int, bits: int) -> str:
    """Return a constant of so many bits."""
    value &= (1 << bits) - 1
    return f"{bits}'d{value}" if value < 1000 else f"{bits}'h{value:x}"


def bare(expression: str) -> str:
    """Return an expression without parentheses around all of it."""
    if not expression.startswith("("):
        return expression
    depth = 0
    for i, character in enumerate(expression):
        depth += (character == "(") - (character == ")")
        if depth == 0:
            return expression[1:-1] if i == len(expression) - 1 else expression
    raise AssertionError(expression)


def _inverted(sign: str, expression: str) -> str:
    """Return an expression behind a sign; the language has no two signs in a row."""
    return f"{sign}({expression})" if expression[0] in "!~" else f"{sign}{expression}"


class Expressions:
    """The operations of a core: their names, which are written inside others, and the tables they take."""

    def __init__(self, outputs: Sequence[Output], schedule: Schedule) -> None:
        self.schedule, self.stage = schedule, schedule.stage
        self.tables: dict[tuple[tuple[int, ...], int], str] = {}
        self.remarks: dict[Node, str] = {}
        """What operations that are tables mean."""
        self.taken = set(TAKEN)
        self.names = self._names()
        self.late: dict[tuple[Node, int], str] = {}
        self.inlined: set[Node] = set()
        self._inline(outputs)

    def width(self, node: Node) -> int:
        """Return how many bits of an operation are made."""
        return width(node, self.schedule.used)

    def _names(self) -> dict[Node, str]:
        names: dict[Node, str] = {}
        for node in self.schedule.order:
            if node.op == "input":
                port, _, field = node.imm.partition(".")
                names[node] = f"{port}.{identifier(field)}" if field else port
                continue
            known = node.name is not None and node.name.isascii()
            names[node] = self._free(str(node.name) if known else f"{UNNAMED[node.op]}_{node.number}")
        return names

    def _free(self, name: str) -> str:
        """Return a name that nothing else has, and take it."""
        base = identifier(name)
        names = (base if i == 1 else f"{base}_{i}" for i in itertools.count(1))
        found = next(name for name in names if name not in self.taken)
        self.taken.add(found)
        return found

    def _inline(self, outputs: Sequence[Output]) -> None:
        """Write what has no name and one use into that use, unless it would get too deep to read."""
        direct, uses = Counter[Node](), Counter[Node]()
        user: dict[Node, Node] = {}
        seen: set[Node] = set()

        def count(node: Node) -> None:
            for arg in node.args:
                uses[arg] += 1
                parted = node.op in ("mul", "table", "left_by", "right_by") or (
                    node.op == "less" and node.imm
                )
                if node.op not in WIRES and not parted:
                    direct[arg] += 1
                    user[arg] = node
                if arg.op in WIRES and arg not in seen:
                    seen.add(arg)
                    count(arg)

        for node in self.schedule.order:
            count(node)
        for output in outputs:
            uses[output.node] += 1
            if output.node.op in WIRES:
                count(output.node)
        depth: dict[Node, int] = {}
        for node in self.schedule.order:
            depth[node] = 1 + max((depth[a] for a in node.args if a in self.inlined), default=0)
            if (
                node.op not in ("input", "mul", "word")
                and node.name is None
                and uses[node] == direct[node] == 1
                and self.stage[user[node]] == self.stage[node]
                and depth[node] <= 3
            ):
                self.inlined.add(node)

    def at(self, node: Node, stage: int) -> str:
        """Return the name of an operation's result in a stage."""
        if stage == self.stage[node]:
            return self.names[node]
        if (node, stage) not in self.late:
            base = re.sub(r"[^a-zA-Z0-9]+", "_", self.names[node]).strip("_")
            self.late[node, stage] = self._free(f"{base}_q{stage}")
        return self.late[node, stage]

    def slice(self, node: Node, low: int, bits: int, stage: int) -> str:
        """Return so many bits of a node from ``low`` on, as they are in a stage."""
        args = node.args
        match node.op:
            case "constant":
                return literal(node.imm >> low, bits)
            case "wrap":
                have = node.imm[0] - low
                if bits <= have:
                    return self.slice(args[0], low, bits, stage)
                if have <= 0:
                    return self._beyond(args[0], node.imm[0], node.low < 0, bits, stage)
                return self._extended(self.slice(args[0], low, have, stage), have, bits, node.low < 0)
            case "right":
                return self.slice(args[0], low + node.imm, bits, stage)
            case "left" | "join":
                return self._shifted(node, low, bits, stage)
            case "mask":
                flag = self.slice(args[0], 0, 1, stage)
                return flag if bits == 1 else f"{{{bits}{{{flag}}}}}"
            case "not":
                if low:
                    return literal(0, bits)
                return self._extended(_inverted("!", self.slice(args[0], 0, 1, stage)), 1, bits, signed=False)
            case "invert":
                if node.low >= 0 and low + bits > node.bits:  # the sign of an inverted word is not used
                    have = node.bits - low
                    if have <= 0:
                        return literal(0, bits)
                    return self._extended(self.slice(node, low, have, stage), have, bits, signed=False)
                return _inverted("~", self.slice(args[0], low, bits, stage))
        if node in self.inlined:
            assert (low, stage) == (0, self.stage[node])
            value, have = self.expression(node), self.width(node)
            if bits < have:
                return f"{bits}'({bare(value)})"
            return self._extended(value, have, bits, node.low < 0 and have == node.bits)
        return self._named(node, low, bits, stage)

    def _named(self, node: Node, low: int, bits: int, stage: int) -> str:
        name, wide = self.at(node, stage), self.width(node)
        if node.op == "input" and stage == 0:  # a port has all its bits, used or not
            wide = node.bits
        signed = node.low < 0 and wide == node.bits
        if low >= wide:
            top = f"{name}[{wide - 1}]" if wide > 1 else name
            return (top if bits == 1 else f"{{{bits}{{{top}}}}}") if signed else literal(0, bits)
        taken = min(bits, wide - low)
        if wide == taken:
            piece = name
        else:
            piece = f"{name}[{low + taken - 1}:{low}]" if taken > 1 else f"{name}[{low}]"
        return self._extended(piece, taken, bits, signed)

    def _beyond(self, node: Node, wide: int, signed: bool, bits: int, stage: int) -> str:
        """Return bits above a word: its sign, or none."""
        if not signed:
            return literal(0, bits)
        top = self.slice(node, wide - 1, 1, stage)
        return top if bits == 1 else f"{{{bits}{{{top}}}}}"

    def _shifted(self, node: Node, low: int, bits: int, stage: int) -> str:
        """Return bits of a word and what is below it: another word, or zeros."""
        upper, cut = node.args[0], node.imm
        if low >= cut:
            return self.slice(upper, low - cut, bits, stage)
        have = cut - low

        def below(bits: int) -> str:
            return literal(0, bits) if node.op == "left" else self.slice(node.args[1], low, bits, stage)

        if bits <= have:
            return below(bits)
        return f"{{{self.slice(upper, 0, bits - have, stage)}, {below(have)}}}"

    def _extended(self, piece: str, have: int, bits: int, signed: bool) -> str:
        if have == bits:
            return piece
        if signed:  # a size cast keeps the sign
            return f"unsigned'({bits}'(signed'({bare(piece)})))"
        return f"{{{literal(0, bits - have)}, {bare(piece)}}}"

    def expression(self, node: Node) -> str:
        """Return an operation on what its arguments are in its stage."""
        stage, bits, args = self.stage[node], self.width(node), node.args

        def word(arg: Node, wide: int = bits) -> str:
            return self.slice(arg, 0, wide, stage)

        match node.op:
            case "and" | "or" | "xor":
                return f"({word(args[0])} {SIGNS[node.op]} {word(args[1])})"
            case "choose":
                return f"({word(args[0], 1)} ? {word(args[1])} : {word(args[2])})"
            case "sum" | "less" if self.schedule.target.is_small(node, bits):
                return self._small(node)
            case "equal" | "less":
                return self._compared(node)
            case "sum":
                return self._sum(node)
            case "mul":
                product = " * ".join(self._factor(arg, stage) for arg in args)
                # An assignment widens factors to the product, and would have to be told to narrow them.
                return f"{bits}'({product})" if bits < max(a.bits + (a.low >= 0) for a in args) else product
            case "left_by":
                return f"({word(args[0])} << {word(args[1], args[1].bits)})"
            case "right_by":
                value, by = word(args[0], args[0].bits), word(args[1], args[1].bits)
                # In a cast, since beside an unsigned word it would not be shifted as a signed one.
                shifted = (
                    f"unsigned'(signed'({bare(value)}) >>> {by})" if args[0].low < 0 else f"({value} >> {by})"
                )
                return shifted if bits == args[0].bits else f"{bits}'({bare(shifted)})"
            case "word":
                return word(args[0])
            case "table":
                return f"{self._table_name(node.imm, bits)}[{word(args[0], args[0].bits)}]"
        raise AssertionError(node.op)

    def _factor(self, arg: Node, stage: int) -> str:
        if arg.op == "constant":
            bits = arg.bits + (arg.low >= 0)
            return f"{bits}'sh{arg.imm & ((1 << bits) - 1):x}"
        value = self.slice(arg, 0, arg.bits, stage)
        return f"signed'({bare(value)})" if arg.low < 0 else f"signed'({{1'b0, {bare(value)}}})"

    def _compared(self, node: Node) -> str:
        signed = any(a.low < 0 for a in node.args)
        wide = max(a.bits + (signed and a.low >= 0) for a in node.args)
        a, b = (self.slice(arg, 0, wide, self.stage[node]) for arg in node.args)
        if node.op == "equal":
            return f"({a} == {b})"
        if node.imm:
            return self._entered(node, wide)
        if signed:
            return f"(signed'({bare(a)}) < signed'({bare(b)}))"
        return f"({a} < {b})"

    def _entered(self, node: Node, wide: int) -> str:
        """Return a comparison with a constant whose lowest bits come first, as the carry into the others.

        Where the others are equal, a 1 in their place makes it not less: the bit that goes in is that.
        """
        stage, low = self.stage[node], node.imm
        (word, constant), turned = node.args, node.args[0].is_constant()
        if turned:
            word, constant = constant, word
        limit = constant.imm + turned
        bits = wide - low
        entering = f"{self.slice(word, 0, low, stage)} < {literal(limit, low)}"
        value = f"{{{bare(self.slice(word, low, bits, stage))}, !({entering})}}"
        most = literal((limit >> low) * 2, bits + 1)
        if any(a.low < 0 for a in node.args):
            value, most = f"signed'({value})", f"signed'({most})"
        return f"({most} < {value})" if turned else f"({value} <= {most})"

    def _sum(self, node: Node) -> str:
        constant, weights = node.imm
        bits, stage = self.width(node), self.stage[node]
        text = ""
        for (sign, shift), arg in sorted(zip(weights, node.args, strict=True), key=lambda term: -term[0][0]):
            if shift >= bits:
                continue
            value = self.slice(arg, 0, bits - shift, stage)
            value = f"{{{bare(value)}, {literal(0, shift)}}}" if shift else value
            if not text:
                text = value if sign > 0 else f"{literal(constant, bits)} - {value}"
                constant = constant if sign > 0 else 0
            else:
                text += f" {'+' if sign > 0 else '-'} {value}"
        if not text:  # all that is added is above the bits that are used
            return literal(constant, bits)
        up, down = constant & ((1 << bits) - 1), -constant & ((1 << bits) - 1)
        if up:
            text += f" - {literal(down, bits)}" if down < up else f" + {literal(up, bits)}"
        return f"({text})"

    def _small(self, node: Node) -> str:
        """Return a small operation as a table of all its cases, which takes no carry chain."""
        stage, bits = self.stage[node], self.width(node)
        words = list(dict.fromkeys(a for a in node.args if a.op != "constant"))
        entries = []
        for case in itertools.product(*(range(1 << w.bits) for w in words)):
            values = {
                w: v - (1 << w.bits) if w.low < 0 and v >> (w.bits - 1) else v
                for w, v in zip(words, case, strict=True)
            }
            result = VALUES[node.op](node.imm, *(values.get(a, a.imm) for a in node.args))
            entries.append(int(result) & ((1 << bits) - 1))
        index = [self.slice(w, 0, w.bits, stage) for w in words]
        if node not in self.inlined:
            self.remarks[node] = bare(self._sum(node) if node.op == "sum" else self._compared(node))
        joined = index[0] if len(index) == 1 else f"{{{', '.join(map(bare, index))}}}"
        return f"{self._table_name(entries, bits)}[{joined}]"

    def _table_name(self, entries: Sequence[int], bits: int) -> str:
        key = tuple(e & ((1 << bits) - 1) for e in entries), bits
        if key not in self.tables:
            self.tables[key] = self._free(f"TABLE_{len(self.tables)}")
        return self.tables[key]
