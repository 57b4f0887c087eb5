"""Loops of functions that are written straight into a kernel, cut into parts where they are long.

To turn a loop into SIMD code, LLVM compares every two of its memory accesses, which takes seconds for a
thousand of them. Where the body of a loop gets long, the rest of it is therefore written into a loop of its
own; some slots go through the one before they go through the other, so no slot may read what another writes.
LLVM is told so of such loops, and compares nothing in them. A word that is needed after the cut is loaded
again, if it was loaded, or else kept in scratch space.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from llvmlite.ir.values import MDValue, MetaDataString

MOST = 160
"""Accesses to memory in a part of a loop. No environment of this package has as many in one by default."""

WORK = 6
"""Operations for each word that goes into a slot's row, from which on a part becomes SIMD code. That scatters
the words, which takes longer than a few operations."""

SLOTS = 64
"""Turns of a loop that one part does before the next one does them."""

INDEX = ir.IntType(64)

PARTS = 12
"""Parts of a loop that become SIMD code, which is longer than other code and takes longer to compile."""


class Writer(ir.IRBuilder):  # type: ignore[misc]
    """Writes instructions from where another builder is, and knows in which loops it is.

    ``memory`` has ``allocate`` and ``free``, as Numba's contexts have them.
    """

    def __init__(self, builder: Any, memory: Any) -> None:
        super().__init__(builder.block)
        self.memory = memory
        self.loops: list[Loop] = []

    def gep(self, pointer: Any, indices: Any, inbounds: bool = True, **named: Any) -> Any:
        """Return an address among the words that a pointer leads to.

        LLVM is told that it stays among them. Else it takes addresses that wrap into account, and leaves a
        loop with many of them as it is.
        """
        return super().gep(pointer, indices, inbounds=inbounds, **named)

    def load(self, *arguments: Any, **named: Any) -> Any:
        """Write a load; the loop that it is in takes note of it."""
        return self._noted(super().load(*arguments, **named))

    def store(self, *arguments: Any, **named: Any) -> Any:
        """Write a store, likewise."""
        return self._noted(super().store(*arguments, **named))

    def _noted(self, access: Any) -> Any:
        if self.loops:
            self.loops[-1].touching[-1].append(access)
        return access

    def count(self, operations: int = 0, accesses: int = 0, scattered: int = 0) -> None:
        """Say what is written next; in a loop that is too long, it begins a new part."""
        if self.loops:
            self.loops[-1].count(operations, accesses, scattered)

    def loop(self, start: Any, stop: Any) -> Loop:
        """Begin a loop; what is written until it is closed is its body."""
        if self.loops:
            self.loops[-1].whole = True
        self.loops.append(Loop(self, start, stop))
        return self.loops[-1]


class Loop:
    """A loop whose body is being written, part by part."""

    def __init__(self, writer: Writer, start: Any, stop: Any) -> None:
        self._writer, self._start, self._stop = writer, start, stop
        self._entry = writer.block
        self._outer: Any = None
        """Where the loop around the parts has its condition, once there are several."""
        self._room: Any = None
        self._bytes = 0
        self._indices: list[Any] = []
        self._tests: list[Any] = []
        self._ends: list[Any] = []
        self._plain: list[bool] = []
        """Of each part, whether it is to stay as it is, and not to become SIMD code."""
        self.touching: list[list[Any]] = []
        """The loads and stores of each part."""
        self.operations = self.accesses = self.scattered = 0
        """What has been counted in this part."""
        self.whole = False
        """Whether there are loops in this part, after which it is not cut any more."""
        self._begin()

    @property
    def part_number(self) -> int:
        """The number of the part that is being written."""
        return len(self._indices) - 1

    @property
    def index(self) -> Any:
        """The index in this part."""
        return self._indices[-1]

    def count(self, operations: int, accesses: int, scattered: int) -> None:
        """See :meth:`Writer.count`."""
        if self.accesses >= MOST and not self.whole:
            self._end()
            self._begin()
            self.operations = self.accesses = self.scattered = 0
        self.operations += operations
        self.accesses += accesses
        self.scattered += scattered

    def _begin(self) -> None:
        writer = self._writer
        condition, body = writer.append_basic_block("for.cond"), writer.append_basic_block("for.body")
        if self._indices:
            writer.branch(condition)
        self._came_from = writer.block
        self._condition, self._after = condition, writer.append_basic_block("for.end")
        writer.position_at_end(condition)
        self.touching.append([])
        self._indices.append(writer.phi(INDEX, name="loop.index"))
        self._tests.append(writer.icmp_signed("<", self.index, self._stop))
        writer.cbranch(self._tests[-1], body, self._after)
        writer.position_at_end(body)

    def _end(self, last: bool = False) -> None:
        writer = self._writer
        self._plain.append(self.operations < WORK * self.scattered or self.part_number >= PARTS)
        # LLVM is to know that the sign never changes.
        self.index.add_incoming(writer.add(self.index, INDEX(1), flags=["nsw"]), writer.block)
        self._ends.append(writer.branch(self._condition))
        if self._outer is None and not last:
            self._surround()
        first = self._start if self._outer is None else self._first
        self.index.add_incoming(
            first, self._came_from if self.part_number or self._outer is None else self._inside
        )
        writer.position_at_end(self._after)

    def _surround(self) -> None:
        """Begin the loop around the parts, of so many slots a turn."""
        writer = self._writer
        self._outer, self._inside = (writer.append_basic_block(name) for name in ("some.cond", "some.body"))
        self._done = writer.append_basic_block("some.end")
        writer.position_at_end(self._outer)
        self._first = writer.phi(INDEX, name="some.first")
        writer.cbranch(writer.icmp_signed("<", self._first, self._stop), self._inside, self._done)
        writer.position_at_end(self._inside)
        end = writer.add(self._first, INDEX(SLOTS), flags=["nsw"])
        self._end_of_some = writer.select(writer.icmp_signed("<", end, self._stop), end, self._stop)
        writer.branch(self._condition)

    def close(self) -> None:
        """End the loop: what is written next comes after it."""
        writer = self._writer
        writer.loops.pop()
        self._end(last=True)
        after = writer.block
        writer.position_at_end(self._entry)
        if self._outer is None:
            writer.branch(self._condition)
            writer.position_at_end(after)
            return
        writer.branch(self._outer)
        self._first.add_incoming(self._start, self._entry)
        parts = self._indices, self._tests, self._ends, self.touching, self._plain
        for index, test, end, touching, plain in zip(*parts, strict=True):
            test.operands = index, self._end_of_some
            _describe(writer.module, end, touching, plain)
        writer.position_at_end(after)
        self._first.add_incoming(writer.add(self._first, INDEX(SLOTS), flags=["nsw"]), after)
        writer.branch(self._outer)
        writer.position_at_end(self._done)
        if self._room is not None:
            self._size.operands = INDEX(self._bytes), INDEX(0)
            writer.memory.free(writer, self._room)

    def keep(self, value: Any, part: int) -> int:
        """Write into a part that a value of it is kept; return where."""
        writer, at = self._writer, self._bytes
        bits = getattr(value.type, "width", 32 if isinstance(value.type, ir.FloatType) else 64)
        self._bytes += SLOTS * bits // 8
        here = writer.block
        if self._room is None:
            writer.position_at_end(self._entry)
            self._size = writer.add(INDEX(0), INDEX(0))  # known when the loop is closed
            self._room = writer.memory.allocate(writer, self._size)
            self._entry = writer.block  # a check of what was allocated has branches
        writer.position_before(self._ends[part])
        address = self._address(at, self._indices[part], value.type)
        # The part that it belongs to takes note of it, and not the loop that is being written.
        self.touching[part].append(ir.IRBuilder.store(writer, value, address))
        writer.position_at_end(here)
        return at

    def kept(self, at: int, type_: Any) -> Any:
        """Return the value that an earlier part has kept there."""
        self.accesses += 1
        return self._writer.load(self._address(at, self.index, type_))

    def _address(self, at: int, index: Any, type_: Any) -> Any:
        writer = self._writer
        first = writer.bitcast(writer.gep(self._room, [INDEX(at)]), type_.as_pointer())
        return writer.gep(first, [writer.sub(index, self._first)])


class _Distinct(MDValue):  # type: ignore[misc]
    """A node of metadata that is no other one, even with the same operands."""

    def descr(self, buf: list[str]) -> None:
        """Write it."""
        operands = (
            f"{operand.type} {operand.get_reference()}"
            if isinstance(operand, ir.Constant)
            else operand.get_reference()
            for operand in self.operands
        )
        buf += (f"distinct !{{ {', '.join(operands)} }}", "\n")


def _describe(module: Any, end: Any, touching: list[Any], plain: bool) -> None:
    """Tell LLVM of a loop that no turn reads or writes what another one writes; and what is to become of it.

    ``end`` is the branch back to where the loop begins.
    """

    def node(*operands: Any) -> _Distinct:
        return _Distinct(module, operands, name=str(len(module.metadata)))

    group, loop = node(), node()
    loop.operands = loop, node(MetaDataString(module, "llvm.loop.parallel_accesses"), group)
    if plain:
        loop.operands += (node(MetaDataString(module, "llvm.loop.vectorize.enable"), ir.IntType(1)(0)),)
    end.set_metadata("llvm.loop", loop)
    for access in touching:
        access.set_metadata("llvm.access.group", group)
