"""Golden functions as straight-line source for kernels: a line an operation, on words of one width.

An operation has the narrowest type that its users can do with, since the more slots then fit a vector
register; or a wider one if all of them want it, since conversions cost, too. The operations themselves are
:mod:`~pearl_marl.compiler.llvm_words` on a CPU and :mod:`~pearl_marl.compiler.scalar_words` on a GPU.
"""

from __future__ import annotations

import functools
import itertools
import keyword
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pearl_marl.compiler import scalar_words
from pearl_marl.compiler.agents_alike import Order, Traced, alike
from pearl_marl.compiler.widths import used_bits
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import GoldenFunction
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node, in_order
from pearl_marl.golden.tracing.operations import bits_of, wrapped
from pearl_marl.golden.tracing.trace import location, trace
from pearl_marl.spec import TERMINATED, EnvSpec, Field, Itself

WIDEST = 64
"""Bits of the widest word that a kernel computes with."""

MOST_CHOICES = 4
"""A table in which at most so many entries differ from the most common one is as many choices."""
MOST_NUMBERS = 16
"""Numbers that a table is packed into at most."""


MANY = 256
"""Results from which on a function makes one after the other, each as soon as what it is made of is known."""


def golden_functions(spec: EnvSpec, in_turn: bool = False) -> list[str]:
    """Return the lines of ``initial()``, ``golden_step()``, :func:`observers` and :func:`maskers`.

    They are for ``inlined`` to compile. With ``in_turn`` those of :data:`MANY` results are generators: what
    goes through their results has few of them at hand at a time.

    Raises
    ------
    ArgumentError
        A word takes more than 64 bits; the message names the file and the line.
    """
    return [line for function in _written(Itself(spec))[0] for line in function.text(in_turn)]


def orders(spec: EnvSpec) -> list[Order]:
    """Return for each agent the order in which its observer and masker take the words of a state."""
    itself = tuple(range(len(spec.state)))
    return [order or itself for order in _written(Itself(spec))[1]]


def observers(spec: EnvSpec) -> list[str]:
    """Return the names of the functions that say what an agent sees, for each agent of a world."""
    return _for_agents("observe", spec, _written(Itself(spec))[1])


def maskers(spec: EnvSpec) -> list[str]:
    """Return the names of the functions that say which actions an agent may take, if there are masks."""
    return _for_agents("find_masks", spec, _written(Itself(spec))[1]) if spec.mask_fields else []


def _for_agents(name: str, spec: EnvSpec, orders: Sequence[Order | None]) -> list[str]:
    if spec.agents == 1:
        return [name]
    return [f"{name}_{0 if order else k}" for k, order in enumerate(orders)]


@functools.lru_cache(maxsize=64)
def _written(itself: Itself) -> tuple[list[_Written], list[Order | None]]:
    """Return golden functions, and for each agent what :func:`alike` finds."""
    spec = itself.spec
    draws = [Field(f"draw_{k}", 32) for k in range(spec.reset_draws + spec.step_draws)]
    reset, step = draws[: spec.reset_draws], draws[spec.reset_draws :]
    inputs = [*spec.state, *spec.each_agent(*spec.action_fields), *step]
    results = *spec.state, *spec.each_agent(spec.reward), *spec.each_agent(TERMINATED)
    functions = [
        _function("initial", _traced(spec.positional.initial, reset, spec.state), reset),
        _function("golden_step", _traced(spec.positional.step, inputs, results), inputs),
    ]
    views = [("observe", spec.positional.observe, spec.observation)]
    if spec.mask_fields:
        views.append(("find_masks", spec.functions[-1], spec.mask_fields))
    firsts = [_traced(function, spec.state, fields, *spec.views[0]) for _, function, fields in views]
    alike_in = alike(spec, firsts)
    for (name, function, fields), first in zip(views, firsts, strict=True):
        names = _for_agents(name, spec, alike_in)
        functions.append(_function(names[0], first, spec.state))
        for agent, order in enumerate(alike_in[1:], 1):
            if order is None:
                traced = _traced(function, spec.state, fields, agent)
                functions.append(_function(names[agent], traced, spec.state))
    return functions, alike_in


def _traced(
    function: GoldenFunction, inputs: Sequence[Field], fields: Sequence[Field], *agent: int
) -> Traced:
    graph = Graph(early=False)
    words = [graph.input(f"{k} {f.name}", f.bits, f.signed, *f.range) for k, f in enumerate(inputs)]
    results = trace(graph, function, words, *agent)
    results = [graph.wrap(node, f.bits, f.signed) for node, f in zip(results, fields, strict=True)]
    return Traced(function, graph, words, results, fields)


def golden_function(
    name: str, function: GoldenFunction, inputs: Sequence[Field], results: Sequence[Field]
) -> list[str]:
    """Return the lines of one golden function of words, for ``inlined`` to compile."""
    return _function(name, _traced(function, inputs, results), inputs).text()


class _Written(NamedTuple):
    """A function as text: before its body, the lines that make each result, and the results."""

    head: list[str]
    lines: list[list[str]]
    results: list[str]

    def text(self, in_turn: bool = False) -> list[str]:
        if in_turn and len(self.results) >= MANY:
            made = itertools.zip_longest(self.lines, self.results, fillvalue="")
            body = [line for some, result in made for line in (*some, f"yield {result}")]
        else:
            body = [*itertools.chain(*self.lines), f"return {', '.join(self.results)}"]
        return [*self.head, *(f"    {line}" for line in body)]


def _function(name: str, traced: Traced, inputs: Sequence[Field]) -> _Written:
    function, graph, words, nodes, fields = traced
    results = list(zip(_with_merged_sums(graph, nodes), (str(f.dtype) for f in fields), strict=True))
    types = {word: str(f.dtype) for word, f in zip(words, inputs, strict=True)}
    writer = _LineWriter(name, function, types, results)
    returned = [f"np.{type_}({writer.operand(node, type_)})" for node, type_ in results]
    arguments = ", ".join(writer.names[word] for word in words)
    head = [*writer.tables, "", "", "@inlined", f"def {name}({arguments}):"]
    return _Written(head, writer.lines, returned)


def _first_uses(order: Sequence[Node], results: Sequence[Node]) -> dict[Node, int]:
    """Return for each node of an order the first result that it is part of."""
    first: dict[Node, int] = {}
    for k, node in enumerate(results):
        first.setdefault(node, k)
    for node in reversed(order):
        for arg in node.args:
            first[arg] = min(first.get(arg, len(results)), first[node])
    return first


def _with_merged_sums(graph: Graph, results: Sequence[Node]) -> list[Node]:
    """Return results in which ``(x >> k) + c`` is ``x + (c << k) >> k``.

    Where ``x`` is a sum with a constant, as that of a rounded product is, this spares an addition.
    """
    order = in_order(results)
    users = Counter(arg for node in order for arg in node.args)
    new: dict[Node, Node] = {}
    for node in order:
        again = graph.again(node, [new[arg] for arg in node.args])
        new[node] = graph.within(again, node.low, node.high)
        if node.op == again.op == "add" and again.args[1].is_constant() and users[node.args[0]] == 1:
            shifted, constant = again.args
            if shifted.op == "right":
                whole = graph.add(shifted.args[0], graph.left(constant, shifted.imm))
                if whole.bits <= WIDEST:
                    new[node] = graph.right(whole, shifted.imm)
    return [new[node] for node in results]


def _size(type_: str) -> int:
    return int(type_.lstrip("uint"))


def _number(value: int, type_: str) -> int:
    return wrapped(value, _size(type_), not type_.startswith("u"))


def _type(low: int, high: int, least: int = 0) -> str:
    """Return the narrowest type of a range, of so many bits at least.

    SIMD units multiply words of one kind, so those of 32 bits and more are signed if they can be.
    """
    bits = bits_of(low, high)
    size = 1 << (max(bits, least, 8) - 1).bit_length()
    return f"{'int' if low < 0 or 32 <= size > bits else 'uint'}{size}"


def _is_compared(node: Node) -> bool:
    """Return whether a node is written as one comparison."""
    return node.op in ("equal", "less") or (node.op == "not" and node.args[0].op in ("equal", "less"))


def _is_extreme(node: Node) -> bool:
    """Return whether a choice is the less or the greater of two."""
    return node.op == "choose" and node.args[0].op == "less" and set(node.args[1:]) == set(node.args[0].args)


def _is_bit(node: Node) -> bool:
    """Return whether a node is one bit of a byte, at a place that is not known."""
    if node.op != "wrap" or node.imm != (1, False) or node.args[0].op != "right_by":
        return False
    byte, by = node.args[0].args
    return byte.low >= 0 and byte.bits <= 8 and by.low >= 0 and by.high < 8


def _may_be_no_flag(node: Node) -> bool:
    """Return whether an unused flag can be another number: then ``1 | flag`` is no flag either."""
    if not node.loose or not node.is_flag:
        return False
    match node.op:
        case "equal" | "less" | "not":
            return False
        case "wrap":
            return bool(node.imm != (1, False))
        case "table":
            return not {0, 1}.issuperset(node.imm)
        case "and":
            return not any(arg.is_flag for arg in node.args)
        case "or" | "xor":
            return not all(arg.is_flag for arg in node.args)
        case "choose":
            return not all(arg.is_flag for arg in node.args[1:])
    return True


class _LineWriter:
    """Writes the lines that results are made by, given the types of the words that they are made of."""

    def __init__(
        self,
        name: str,
        function: GoldenFunction,
        words: Mapping[Node, str],
        results: Sequence[tuple[Node, str]],
    ) -> None:
        self.lines: list[list[str]] = []
        """Those that make each result, as far as the results before it have not made it."""
        self.tables: list[str] = []
        self._masks: dict[tuple[Node, int], str] = {}
        """The byte in which only the bit at this place is set, if it is one of so many."""
        self._name = name
        self.types = dict(words)
        self._function = function
        self._taken = set(_RESERVED)
        self._numbers: dict[str, int] = defaultdict(lambda: 1)
        """The last number that a name has got: to count from 1 takes long for many words of one name."""
        self.names = {word: self._fresh(word.imm.split()[1]) for word in words}
        # As the author has it: LLVM keeps the order, and sums right behind their flags are slower.
        order = sorted(in_order(node for node, _ in results), key=lambda node: node.number)
        self._used = used_bits(order, [(node, node.bits) for node, _ in results], words=True)
        typed = self._typed(order, results)
        first = dict.fromkeys(typed, 0)
        if len(results) >= MANY:
            first = _first_uses(order, [node for node, _ in results])
        for node in sorted(typed, key=first.__getitem__):
            while len(self.lines) <= first[node]:
                self.lines.append([])
            text = self._expression(node, self.types[node])
            if _may_be_no_flag(node):
                text = f"{self.types[node]}_and({text}, 1)"
            self.names[node] = self._assign(node.name or f"_{node.op}", text)

    def operand(self, node: Node, type_: str) -> str:
        """Return a word as an operation in a type takes it."""
        return str(_number(node.imm, type_)) if node.is_constant() else self.names[node]

    def _assign(self, name: str, text: str) -> str:
        name = self._fresh(name)
        self.lines[-1].append(f"{name} = {text}")
        return name

    def _fresh(self, name: str) -> str:
        fresh = name
        while fresh in self._taken:
            self._numbers[name] += 1
            fresh = f"{name}_{self._numbers[name]}"
        self._taken.add(fresh)
        return fresh

    def _typed(self, order: Sequence[Node], results: Sequence[tuple[Node, str]]) -> list[Node]:
        """Choose the type of each operation that is needed; return these in order."""
        wanted: dict[Node, int] = {}

        def want(node: Node, type_: str) -> None:
            wanted[node] = min(wanted.get(node, WIDEST), _size(type_))

        for node, type_ in results:
            want(node, type_)
        needed = []
        for node in reversed(order):
            if node in wanted and node.op not in ("input", "constant"):
                bits = self._bits(node)
                least = wanted[node]
                if node.op == "left_by":  # by less than its width: all else is undefined
                    least = max(least, node.args[1].high + 1)
                # Bits beyond those that are used may be anything.
                exact = bits == node.bits
                self.types[node] = (
                    _type(node.low, node.high, least) if exact else _type(0, (1 << bits) - 1, least)
                )
                needed.append(node)
                for arg, type_ in self._operands(node):
                    want(arg, type_)
        return needed[::-1]

    def _bits(self, node: Node) -> int:
        return self._possible(node, min(node.bits, max(1, self._used[node].bit_length())))

    def _possible(self, node: Node, bits: int) -> int:
        if bits > WIDEST:
            raise ArgumentError(
                f"{location(self._function, node.line)}: {node.name or 'a word'} takes {bits} bits here; "
                f"a word of a kernel has up to {WIDEST}"
            )
        return bits

    def _operands(self, node: Node) -> list[tuple[Node, str]]:
        """Return the words that an operation is written with, and the type that it takes them in."""
        args, type_ = node.args, self.types[node]
        if _is_compared(node) or _is_extreme(node):
            args = args[0].args if node.op in ("not", "choose") else args
            type_ = self._holding(node, *args)
        elif _is_bit(node):
            args, type_ = args[0].args, "uint8"
        elif node.op == "right_by":
            type_ = _type(args[0].low, args[0].high, min(args[1].high, WIDEST - 1) + 1)
        elif node.op == "right":
            type_ = _type(args[0].low, args[0].high) if args[0].bits <= WIDEST else "int64"
        elif node.op in ("divide_by", "modulo_by"):
            type_ = self._holding(node, *args)
        elif node.op in ("divide", "modulo"):
            type_ = _type(min(args[0].low, 0), max(args[0].high, node.imm))
        elif node.op == "table":
            type_ = _type(args[0].low, args[0].high) if _packing(node) else "int64"
        return [(arg, type_) for arg in args]

    def _holding(self, node: Node, *words: Node) -> str:
        low, high = min(w.low for w in words), max(w.high for w in words)
        self._possible(node, bits_of(low, high))
        return _type(low, high)

    def _expression(self, node: Node, type_: str) -> str:
        operands = self._operands(node)
        own = operands[0][1]
        texts = [self.operand(*operand) for operand in operands]
        text = ", ".join(texts)
        match node.op:
            case "not" if _is_compared(node):
                return f"{own}_{_OPPOSITE[node.args[0].op]}({text})"
            case "not":
                return f"{type_}_xor({text}, 1)"
            case "invert":
                return f"{type_}_xor({text}, {_number(-1, type_)})"
            case "mask":
                return f"{type_}_sub(0, {text})"
            case "left" if node.imm >= _size(type_):  # the bits above are not used
                return f"np.{type_}(0)"
            case "left":
                return f"{type_}_left({text}, {node.imm})"
            case "left_by":
                return f"{type_}_left({texts[0]}, {self._shift(node, type_, texts[1])})"
            case "right":
                return f"np.{type_}({own}_right({text}, {min(node.imm, _size(own) - 1)}))"
            case "right_by":
                if node.args[1].high < WIDEST:
                    return f"np.{type_}({own}_right({texts[0]}, {self._shift(node, own, texts[1])}))"
                # A shift is by less than the width, so one by more takes two.
                most = f"{own}_right({texts[0]}, uint64_minimum({texts[1]}, {WIDEST - 1}))"
                return f"np.{type_}({own}_right({most}, uint64_less({WIDEST - 1}, {texts[1]})))"
            case "mul" if own == "int64":
                # LLVM does not see that they are short, and of short ones SIMD units multiply more at a time.
                short = (
                    f"np.int64(np.int32({x}))" if a.bits <= 32 - (a.low >= 0) and a.args else x
                    for a, x in zip(node.args, texts, strict=True)
                )
                return f"int64_mul({', '.join(short)})"
            case "divide" | "modulo" | "divide_by" | "modulo_by":
                sign = "//" if node.op.startswith("divide") else "%"
                by = self._divisor(node, own, texts[1]) if node.imm is None else node.imm
                return f"np.{type_}(np.{own}({texts[0]}) {sign} np.{own}({by}))"
            case "choose" if _is_extreme(node):
                which = "minimum" if node.args[1] is node.args[0].args[0] else "maximum"
                return f"np.{type_}({own}_{which}({text}))"
            case "table":
                return self._entry(node, type_, text, own)
            case "wrap" if _is_bit(node):
                return self._bit(node)
            case "wrap":
                return self._wrapped(node, type_, text)
            case "narrow":
                return f"np.{type_}({text})"
        return f"{own}_{node.op}({text})"

    def _wrapped(self, node: Node, type_: str, text: str) -> str:
        bits, signed = node.imm
        size = _size(type_)
        if self._bits(node) < node.bits or bits == size:
            return f"np.{type_}({text})"
        if not signed:
            return f"{type_}_and({text}, {(1 << bits) - 1})"
        return f"{type_}_right({type_}_left({text}, {size - bits}), {size - bits})"

    def _shift(self, node: Node, own: str, by: str) -> str:
        """Return what a word is shifted by, less than the width: all else is undefined."""
        return f"{own}_and({by}, {_size(own) - 1})" if node.args[1].loose else by

    def _divisor(self, node: Node, own: str, by: str) -> str:
        """Return what a word is divided by, 1 or more: by 0 or -1 a processor may stop."""
        divisor = node.args[1]
        if not divisor.loose:
            return by
        by = self._assign("_divisor", f"{own}_and({by}, {(1 << divisor.bits) - 1})")
        return f"{own}_or({by}, {own}_equal({by}, 0))"

    def _bit(self, node: Node) -> str:
        """Return a bit of a byte: a shift by a number that is not known takes more than a mask."""
        byte, by = node.args[0].args
        known = by, byte.bits
        if known not in self._masks:
            bits = {k: 1 << k for k in range(min(by.high + 1, byte.bits))}
            self._masks[known] = self._chosen(self.operand(by, "uint8"), "uint8", "uint8", bits, 0)
        return f"uint8_differ(uint8_and({self.operand(byte, 'uint8')}, {self._masks[known]}), 0)"

    def _chosen(self, index: str, own: str, type_: str, entries: Mapping[int, int], other: int) -> str:
        """Return one of few numbers: what none of them is for is another one."""
        text = f"np.{type_}({_number(other, type_)})"
        for k, entry in entries.items():
            chosen = f"{type_}_choose({own}_equal({index}, {k}), {_number(entry, type_)}, {text})"
            text = self._assign("_entry", chosen)
        return text

    def _entry(self, node: Node, type_: str, index: str, own: str) -> str:
        """Return the entry of a table: no loop that reads one from memory becomes SIMD code."""
        function = node.args[0].function
        possible = range(len(node.imm)) if function is None else np.unique(function.values).tolist()
        (usual, _), *_ = Counter(node.imm[k] for k in possible).most_common()
        unusual = {k: node.imm[k] for k in possible if node.imm[k] != usual}
        if len(unusual) <= MOST_CHOICES:
            return self._chosen(index, own, type_, unusual, usual)
        packing = _packing(node)
        if packing is None:
            table = self._fresh(f"{self._name.upper()}_TABLE")
            entries = [_number(entry, type_) for entry in node.imm]
            if node.args[0].loose:  # nothing beyond the table is read, whatever the index is
                entries += entries[-1:] * (-len(entries) % (1 << (len(entries) - 1).bit_length()))
                index = f"{own}_and({index}, {len(entries) - 1})"
            self.tables.append(f"{table} = np.array({entries}, np.{type_})")
            return f"{table}[{index}]"
        size, width = packing
        least, per_number, packed = min(node.imm), size // width, f"uint{size}"
        numbers: dict[int, int] = defaultdict(int)
        for k in possible:
            numbers[k // per_number] |= node.imm[k] - least << k % per_number * width
        (common, _), *others = Counter(numbers.values()).most_common()
        number = str(common)
        if others:
            which = self._assign("_which", f"{own}_right({index}, {per_number.bit_length() - 1})")
            for k, other in numbers.items():
                if other != common:
                    chosen = f"{packed}_choose({own}_equal({which}, {k}), {other}, {number})"
                    number = self._assign("_entries", chosen)
        if len(node.imm) > per_number or node.args[0].loose:
            index = f"{own}_and({index}, {per_number - 1})"
        entry = f"{packed}_right({number}, {packed}_left({index}, {width.bit_length() - 1}))"
        entry = f"{packed}_and({entry}, {(1 << width) - 1})"
        return (
            f"{type_}_add(np.{type_}({entry}), {_number(least, type_)})" if least else f"np.{type_}({entry})"
        )


def _packing(node: Node) -> tuple[int, int] | None:
    """Return how a table is a few numbers: the bits of a number, and of an entry in it."""
    span = bits_of(0, max(node.imm) - min(node.imm))
    width = 1 << (span - 1).bit_length()
    for size in (16, 32, 64):
        if width < size and width * len(node.imm) <= MOST_NUMBERS * size:
            return size, width
    return None


_RESERVED = {"np", *keyword.kwlist, *scalar_words.operations()}

_OPPOSITE = {"equal": "differ", "less": "at_least"}
