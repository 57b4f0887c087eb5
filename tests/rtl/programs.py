"""Random programs of plain Python: branches, loops, helpers and lists that words index and write.

Whatever their arguments, they end, raise nothing and take no index beyond a list, so that Python itself says
what they do.
"""

from __future__ import annotations

import linecache
import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

TABLE = [3, 1, 4, 1, 5, 9, 2, 6]
NUMBERS = [
    "{} + {}",
    "{} - {}",
    "{} & {}",
    "{} | {}",
    "{} ^ {}",
    "{} * {c}",
    "{} // {d}",
    "{} % {d}",
    "{} >> {n}",
    "({} & 15) << {n}",
    "-{}",
    "~{}",
    "abs({})",
    "abs({} - {})",
    "min({}, {})",
    "max({}, {}, {c})",
    "min(max({}, {c}), {c} + 9)",
    "({} if {?} else {})",
    "({} if {?} else {} if {?} else {c})",
    "({?} and {})",
    "({} or {})",
    "({} and {})",
    "sum([{}, {}, {c}])",
    "sum([{?}, {?}, {?}])",
    "TABLE[{} & 7]",
    "TABLE[abs({}) % 8]",
    "[{}, {}, {c}][{} % 3]",
    "sum(k * {} for k in range(3) if {?})",
    "sum(1 for k in range(4) if {} > k)",
]
FLAGS = [
    "{} == {}",
    "{} != {}",
    "{} < {}",
    "{} <= {c}",
    "{} > {}",
    "{} >= {c}",
    "{c} < {} <= {}",
    "{} < {} < {} != {c}",
    "{} == {} == {}",
    "not {?}",
    "{?} and {?}",
    "{?} or {?}",
    "{?} and not {?} or {?}",
    "{} in (1, {c}, {})",
    "{} not in [0, {}]",
    "{} in range({c}, {c} + 6)",
    "any(x > {} for x in ({}, {}, {c}))",
    "all(x != {c} for x in [{}, {}])",
    "any([{?}, {?}])",
    "({}, {}) == ({}, {c})",
    "{?} & {?}",
    "{?} == {?}",
    "bool({})",
    "{}",
]
WRAPS = [
    "i16({})",
    "({}) & 15",
    "({}) % 7",
    "min(max({}, 0), 9)",
    "({}) & 1",
    "u8({})",
    "i8({})",
    "({}) % 5 - 2",
]


class Program:
    """Writes one function after the other; each is of a few words."""

    def __init__(self, chance: random.Random, numbers: Sequence[str] = NUMBERS) -> None:
        self.chance, self.numbers = chance, numbers
        self.lines: list[str] = []
        self.indent = 0
        self.words: list[str] = []
        self.fixed: list[str] = []
        """Words that are read, not assigned to."""
        self.lists: dict[str, int] = {}
        self.elsewhere: set[str] = set()
        """Lists of the function around, which would be another's if a name were assigned to."""
        self.helpers: list[tuple[str, int]] = []
        self.count = 0
        self.loops = 0
        self.rounds = 1
        """How often the statement at hand runs, at most."""
        self.result: Callable[[], str] | None = None
        self.before: list[str] = []
        """Statements that a function begins with."""

    def write(self, line: str) -> None:
        self.lines.append("    " * self.indent + line)

    def new(self, kind: str = "v") -> str:
        self.count += 1
        return f"{kind}{self.count}"

    @contextmanager
    def inside(self) -> Iterator[None]:
        """Indent; names that are made inside are known there only."""
        words, fixed, lists, helpers = self.words[:], self.fixed[:], dict(self.lists), self.helpers[:]
        self.indent += 1
        yield
        self.indent -= 1
        self.words, self.fixed, self.lists, self.helpers = words, fixed, lists, helpers

    def word(self) -> str:
        every = [*self.words, *self.words[-3:], *self.fixed]
        if self.lists and self.chance.random() < 0.2:
            name, length = self.chance.choice(list(self.lists.items()))
            return f"{name}[{self.index(length)}]"
        if not every or self.chance.random() < 0.1:
            return str(self.chance.randint(-9, 20))
        return self.chance.choice(every)

    def index(self, length: int) -> str:
        every = [*self.words, *self.fixed]
        if every and self.chance.random() < 0.5:
            return f"{self.chance.choice(every)} % {length}"
        return str(self.chance.randrange(-length, length))

    def filled(self, pattern: str, depth: int) -> str:
        parts = []
        while "{" in pattern:
            before, _, rest = pattern.partition("{")
            kind, _, pattern = rest.partition("}")
            parts += [before, self.part(kind, depth)]
        return "".join([*parts, pattern])

    def part(self, kind: str, depth: int) -> str:
        match kind:
            case "c":
                return str(self.chance.choice([-20, -7, -1, 0, 1, 2, 3, 5, 9, 16, 100]))
            case "n":
                return str(self.chance.randint(0, 7))
            case "d":
                return str(self.chance.randint(1, 20))
            case "?":
                return f"({self.flag(depth - 1)})"
        return self.word() if depth <= 0 or self.chance.random() < 0.6 else f"({self.number(depth - 1)})"

    def number(self, depth: int = 1) -> str:
        if self.helpers and self.chance.random() < 0.1:
            name, count = self.chance.choice(self.helpers)
            return f"{name}({', '.join(self.word() for _ in range(count))})"
        return self.filled(self.chance.choice(self.numbers), depth)

    def flag(self, depth: int = 1) -> str:
        return self.filled(self.chance.choice(FLAGS if depth > 0 else FLAGS[:8]), depth)

    def value(self) -> str:
        return self.chance.choice(WRAPS).format(self.number())

    def assignment(self) -> None:
        kind = self.chance.random()
        if self.lists and kind < 0.25:
            name, length = self.chance.choice(list(self.lists.items()))
            at = f"{name}[{self.index(length)}]"
            if kind < 0.05:
                self.write(f"{at} = min({at} + {self.value()}, 9)")
            elif kind < 0.1:
                self.write(f"{at}, {self.chance.choice(self.words)} = {self.value()}, {self.value()}")
            elif kind < 0.15:
                self.write(f"{at} ^= {self.value()}")
            else:
                self.write(f"{at} = {self.value()}")
        elif self.lists and kind < 0.3:
            self.rename()
        elif self.words and kind < 0.6:
            name = self.chance.choice(self.words)
            if kind < 0.35:
                self.write(f"{name} {self.chance.choice(['^', '|', '&'])}= {self.value()}")
            elif kind < 0.4 and len(self.words) > 1:
                a, b = self.chance.sample(self.words, 2)
                self.write(f"{a}, {b} = {b}, {self.value()}")
            else:
                self.write(f"{name} = {self.value()}")
        else:
            self.bind()

    def bind(self) -> None:
        """Write the first assignment to a word."""
        value, name = self.value(), self.new()
        self.write(f"{name} = {value}")
        self.words.append(name)

    def rename(self) -> None:
        """Let a list's name be one of another, which a word may decide."""
        name, length = self.chance.choice(list(self.lists.items()))
        same = [other for other, its in self.lists.items() if its == length]
        a, b = self.chance.choice(same), self.chance.choice(same)
        if name in self.elsewhere:
            return
        text = f"{a} if {self.flag()} else {b}" if self.chance.random() < 0.6 else a
        if "[" in name:  # a row, whose name is a place in a list
            name = self.new("list")
            self.lists[name] = length
        self.write(f"{name} = {text}")

    def board(self) -> None:
        """Write a list of lists, whose rows are lists like others."""
        name, rows, columns = self.new("board"), self.chance.randint(2, 3), self.chance.randint(2, 3)
        texts = [f"[{', '.join(self.value() for _ in range(columns))}]" for _ in range(rows)]
        same = [other for other, length in self.lists.items() if length == columns]
        if same and self.chance.random() < 0.5:
            texts[0] = self.chance.choice(same)
        self.write(f"{name} = [{', '.join(texts)}]")
        for place in dict.fromkeys(self.index(rows) for _ in range(2)):
            self.lists[f"{name}[{place}]"] = columns

    def list_(self) -> None:
        name, length = self.new("list"), self.chance.randint(2, 4)
        if self.chance.random() < 0.3:
            return self.board()
        if self.lists and self.chance.random() < 0.3:  # another name of the same
            other = self.chance.choice(list(self.lists))
            self.write(f"{name} = {other}{self.chance.choice(['', '', '[:]'])}")
            length = self.lists[other]
        elif self.chance.random() < 0.3:
            self.write(f"{name} = [{self.value()} for k in range({length})]")
        elif self.chance.random() < 0.2:
            self.write(f"{name} = [{self.value()}] * {length}")
        else:
            self.write(f"{name} = [{', '.join(self.value() for _ in range(length))}]")
        self.lists[name] = length
        return None

    def branch(self, size: int) -> None:
        self.write(f"if {self.flag(2)}:")
        with self.inside():
            self.block(size // 2)
        while self.chance.random() < 0.3:
            self.write(f"elif {self.flag(2)}:")
            with self.inside():
                self.block(size // 3)
        if self.chance.random() < 0.5:
            self.write("else:")
            with self.inside():
                self.block(size // 2)

    def loop(self, size: int) -> None:
        count, name = self.chance.randint(1, 4), self.new("k")
        kind = self.chance.random()
        if kind < 0.25:
            self.write(f"{name} = ({self.number()}) & 3")
            more = f" and ({self.flag()})" if self.chance.random() < 0.4 else ""
            self.write(f"while {name} > 0{more}:")
            count = 3
        elif kind < 0.35:
            self.write(f"{name} = 0")
            self.write(f"while {name} < {count}:")
        elif self.lists and kind < 0.6:
            of = self.chance.choice(list(self.lists))
            count, item = self.lists[of], self.new("x")
            self.write(f"for {name}, {item} in enumerate({of}):")
        else:
            item = ""
            self.write(f"for {name} in range({count}):")
        before, self.rounds = self.rounds, self.rounds * count
        result = self.result
        with self.inside():
            self.fixed.append(name)
            if kind < 0.25:
                self.write(f"{name} -= 1")
            elif kind < 0.35:
                self.write(f"{name} += 1")
            elif item:
                self.fixed.append(item)
            self.loops += 1
            self.block(size // 2)
            self.loops -= 1
        self.rounds, self.result = before, result
        if self.chance.random() < 0.2:
            self.write("else:")
            with self.inside():
                self.block(size // 3)

    def leave(self) -> None:
        """Write an exit under a condition, or without."""
        ways = ["break", "continue"] * (self.loops > 0)
        if self.result is not None:
            ways.append("return")
        if not ways:
            return self.assignment()
        way = self.chance.choice(ways)
        if self.indent < 2 or self.chance.random() < 0.85:
            self.write(f"if {self.flag(2)}:")
            with self.inside():
                if self.chance.random() < 0.5:
                    self.assignment()
                self.write(f"return {self.result()}" if way == "return" and self.result else way)
        else:
            self.write(f"return {self.result()}" if way == "return" and self.result else way)
        return None

    def helper(self, size: int) -> None:
        """Write a function inside of this one, which sees its words and writes its lists."""
        name, args = self.new("f"), [self.new("a") for _ in range(self.chance.randint(1, 2))]
        if self.chance.random() < 0.2:
            given = ", ".join(args)
            words, self.words = self.words, [*self.words, *args]
            self.write(f"{name} = lambda {given}: {self.number()}")
            self.words = words
        else:
            self.write(f"def {name}({', '.join(args)}):")
            loops, self.loops, result, self.result = self.loops, 0, self.result, self.value
            fixed, elsewhere = self.fixed, self.elsewhere
            self.elsewhere = {*self.lists}
            with self.inside():
                # Words around it are read in it, and would be its own if it assigned to them.
                self.fixed, self.words = [*fixed, *self.words], [*args]
                self.block(size // 2)
                self.write(f"return {self.value()}")
            self.loops, self.result, self.elsewhere = loops, result, elsewhere
        self.helpers.append((name, len(args)))

    def block(self, size: int) -> None:
        """Write statements."""
        start = len(self.lines)
        while True:
            kind = self.chance.random()
            if size > 3 and kind < 0.3:
                self.branch(size - 1)
            elif size > 3 and kind < 0.5 and self.rounds < 12:
                self.loop(size - 1)
            elif size > 4 and kind < 0.58 and self.indent < 3:
                self.helper(size - 1)
            elif kind < 0.66:
                self.leave()
            elif kind < 0.72:
                self.list_()
            else:
                self.assignment()
            size -= len(self.lines) - start
            start = len(self.lines)
            if size <= 0:
                return

    def function(
        self, name: str, args: Sequence[str], words: Sequence[str], size: int, result: Callable[[], str]
    ) -> None:
        """Write a function of some arguments and words, which returns what ``result`` writes."""
        self.write(f"def {name}({', '.join(args)}):")
        with self.inside():
            self.words, self.result = [], result
            for line in self.before:
                self.write(line)
            for word in words:
                variable, _, given = word.partition(" = ")
                if given:
                    self.write(word)
                self.words.append(variable)
            for _ in range(2):
                self.bind()
            self.list_()
            self.block(size)
            self.write(f"return {result()}")
            self.result = None

    def everything(self) -> str:
        """Return a sum in which all that is known shows."""
        items = [*self.words, *(f"sum({of})" for of in self.lists)]
        return " + ".join(f"{2 * k + 1} * {item}" for k, item in enumerate(items))


def defined(text: str, scope: dict[str, Any], file: str) -> dict[str, Any]:
    """Run the text of some functions, which is then known as the source of them."""
    lines = text.splitlines(keepends=True)
    linecache.cache[file] = len(text), None, lines, file
    exec(compile(text, file, "exec"), scope)
    return scope
