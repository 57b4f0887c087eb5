"""What is traced of branches, loops and lists is what Python makes of them; and mistakes are told."""

from __future__ import annotations

import importlib.util
import itertools
import linecache
import random
import re
import textwrap
import time
from collections import namedtuple
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from pearl_marl.errors import ArgumentError
from pearl_marl.golden import Draws, i8, i16, reference, u8
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node, in_order, values
from pearl_marl.golden.tracing.trace import trace

from ..rtl.programs import TABLE, Program, defined
from ..sampling import sampled

WORDS = [("a", 4, False), ("b", 8, True), ("c", 2, False), ("d", 32, False)]


def function(text: str, file: str = "pump/step.py", **scope: Any) -> Callable[..., Any]:
    """Return the function ``f`` of a text, which is known as its source."""
    names = {
        "__name__": __name__,
        "TABLE": TABLE,
        "u8": u8,
        "i8": i8,
        "i16": i16,
        "Draws": Draws,
        "namedtuple": namedtuple,
    }
    found: Callable[..., Any] = defined(textwrap.dedent(text).lstrip("\n"), {**names, **scope}, file)["f"]
    return found


def traced(f: Callable[..., Any], *words: tuple[str, int, bool]) -> list[Node]:
    graph = Graph()
    return trace(graph, f, [graph.input(*word) for word in words])


def assert_same(
    f: Callable[..., Any], words: Sequence[tuple[str, int, bool]], cases: Sequence[Sequence[int]]
) -> None:
    """Compare what Python does with what is traced, and with what is known of it."""
    nodes, run = traced(f, *words), reference(f)
    for case in cases:
        found = values(nodes, {name: value for (name, *_), value in zip(words, case, strict=True)})
        assert [found[node] for node in nodes] == [int(word) for word in run(*case)], case
        assert all(node.low <= found[node] <= node.high for node in nodes), case


def test_writes_into_lists_that_a_branch_has_joined() -> None:
    """Such a list is made after the branch; what a side knows of an element is not known of the old one."""
    f = function("""
        def f(a, b):
            rows = [a, b]
            if a == 1:
                rows = [b, a]
            if b == 3:
                rows[0] = 7
            if a == 2:
                rows[1] = b + rows[0]
            if rows[0] == 5:
                rows[0] = 8
            return rows[0], rows[1]
    """)
    words = [("a", 4, False), ("b", 4, False)]
    assert_same(f, words, list(itertools.product(range(16), repeat=2)))
    wide = function("""
        def f(a, b):
            rows = [a]
            if a == 3:
                rows[0] = b
            return rows[0]
    """)
    assert_same(wide, [("a", 32, False), ("b", 4, False)], [(3, 4), (5, 6), (1 << 31, 3)])


@pytest.mark.parametrize("seed", sampled(range(2000), range(20)))
def test_random_programs(seed: int) -> None:
    """With every kind of statement, some inside others."""
    program = Program(random.Random(seed))
    names = [name for name, *_ in WORDS]
    program.function(
        "f", names, names, 14 + seed % 3 * 8, lambda: f"{program.everything()}, {program.word()}"
    )
    chance = random.Random(seed)

    def word(bits: int, signed: bool) -> int:
        value = chance.choice([chance.randrange(1 << bits), chance.randrange(min(1 << bits, 8)), 0])
        return value - (signed << bits - 1)

    cases = [[word(bits, signed) for _, bits, signed in WORDS] for _ in range(40)]
    assert_same(function("\n".join(program.lines), f"<program {seed}>"), WORDS, cases)


SMALL = [("a", 2, False), ("b", 2, False), ("c", 1, False)]
PROGRAMS = {
    "an early return in a helper": """
        def helper(a, b):
            if a == 3:
                return 7
            if a > b:
                if a == 2:
                    return b
                b += 1
            else:
                return a - b
            return b * 2
        def f(a, b, c):
            return helper(a, b), helper(b, a) if c else helper(c, c)
    """,
    "returns of loops inside others": """
        def f(a, b, c):
            for i in range(3):
                for j in range(3):
                    if i == a and j == b:
                        return 10 * i + j, c
                    if j > i:
                        break
                    if c:
                        continue
                    if i + j == b:
                        return 50 + i, j
                else:
                    if a == 3:
                        return 99, i
            return 77, b
    """,
    "else of loops": """
        def f(a, b, c):
            found = 5
            for k in range(3):
                if k == a:
                    found = k
                    break
                if c:
                    continue
            else:
                found += b
            left = b
            while left > 0:
                if left == a:
                    break
                left -= 1
            else:
                found += 100
            return found, left
    """,
    "a while whose rounds all end it": """
        def f(a, b, c):
            while a > 1 and b:
                return b, 1
            while True:
                a += 1
                break
            return a, 0
    """,
    "nested closures": """
        def f(a, b, c):
            def outer(x):
                limit = x + c
                def inner(y):
                    if y > limit:
                        return limit
                    return y + b
                return inner
            first, second = outer(a), outer(b)
            return first(b), second(a), first(second(c))
    """,
    "recursion that ends": """
        def depth(n, a):
            if n == 0:
                return 0
            if a == n:
                return n + 10
            return depth(n - 1, a) + 1
        def f(a, b, c):
            return depth(3, a), depth(2, b)
    """,
    "a list that two words index": """
        def f(a, b, c):
            board = [[k + 4 * j for k in range(4)] for j in range(4)]
            board[a][b] = 99
            board[b][a] += 1
            board[c][1] = board[a][c]
            if c:
                board[a % 2][b] = board[b][b]
            return [x for row in board for x in row]
    """,
    "a row with a name of its own": """
        def f(a, b, c):
            board = [[1, 2], [3, 4], [5, 6], [7, 8]]
            row = board[a]
            row[c] = 9
            other = row if c else board[b]
            other[0] += 10
            board[2][1] = 40
            return [*row, *other, *(x for each in board for x in each)]
    """,
    "two names that may be of one list": """
        def f(a, b, c):
            p, q = [1, 2], [3, 4]
            if a == 1:
                q = p
            elif a == 2:
                p, q = q, p
            q[c] = 9
            p[0] += b
            return *p, *q
    """,
    "a name that changes hands in a loop": """
        def f(a, b, c):
            p, q = [1, 2], [3, 4]
            for k in range(4):
                if a == k:
                    break
                if b == k:
                    p = q
                p[k % 2] += 1
            return *p, *q
    """,
    "a list that a helper may hand back": """
        def kept(p, c):
            if c:
                return p
            new = list(p)
            new[0] = 5
            return new
        def f(a, b, c):
            p = [1, 2, 3, 4]
            q = kept(p, c)
            q[a] = 9
            p[b] += 1
            return *p, *q
    """,
    "a row that is put into a list": """
        def f(a, b, c):
            board, row = [[1, 2], [3, 4]], [5, 6]
            board[c] = row
            row[a % 2] = 9
            board[1][b % 2] += 1
            return [*board[0], *board[1], *row]
    """,
    "an element of many at once": """
        def f(a, b, c):
            board = [0, 0, 0, 0]
            board[a], board[b] = 1, 2
            (x, board[c]), y = (a, 3), b
            board[a] = board[b] = x + y
            return board
    """,
    "changes under conditions that exclude each other": """
        def f(a, b, c):
            board = [0] * 4
            if a == 0:
                board[b] = 1
            elif a == 1:
                board[0], board[3] = board[3] + 2, 5
            else:
                for k in range(4):
                    if k == b:
                        continue
                    board[k] = a
                    if c:
                        break
            return board
    """,
    "what is known on a path only": """
        def f(a, b, c):
            board = [a] * 3
            if board[1] == 2:
                board[b % 3] = 7
                board[0] = a + c
            elif a:
                return board
            return [*board, 0][:3]
    """,
    "records that change": """
        from typing import NamedTuple
        class Robot(NamedTuple):
            row: int
            column: int
        def f(a, b, c):
            robots = [Robot(0, 1), Robot(2, 3), Robot(1, 1), Robot(a, b)]
            robots[a] = robots[a]._replace(row=b)
            if c:
                robots[b] = Robot(7, robots[a].row)
            one = robots[a] if c else Robot(column=3, row=0)
            return [word for robot in (*robots, one) for word in robot]
    """,
    "objects with attributes": """
        from dataclasses import dataclass
        @dataclass
        class Robot:
            row: int
            load: int = 0
        def f(a, b, c):
            robots = [Robot(k) for k in range(2)]
            robots[0].load += 1
            for robot in robots:
                if robot.row == a:
                    robot.load = b
                    continue
                robot.row += 1
            chosen = robots[0] if c else robots[1]
            chosen.row = 9
            return [word for robot in robots for word in (robot.row, robot.load)]
    """,
    "chains and comparisons of sequences": """
        def f(a, b, c):
            inside = 0 <= a < b <= 3 != c
            equal = (a, b) == (b, a), [a, c] != [c, a], a == b == c
            among = a in (b, 3), c not in [a, b], a in range(1, 3), a in {0, 2}
            return [inside, *equal, *among]
    """,
    "and, or and not, of numbers too": """
        def f(a, b, c):
            return a and b, a or b, not a, a and not b or c, (a or 7) + (b and 5), bool(a) + bool(b)
    """,
    "reductions": """
        def f(a, b, c):
            board = [a, b, c, 2]
            return [
                any(x > 2 for x in board), all(x != a for x in board[1:]), sum(x for x in board if x > b),
                sum(1 for x in board if x == 2), min(board), max(a, b, 1), abs(a - b), board.count(2),
                any(x == y for x in board for y in (a, 3) if x > 1), sum(board), len(board), board.index(2),
            ]
    """,
    "conditional expressions inside others": """
        def f(a, b, c):
            x = (a if b > 1 else b) if c else (c if a else 3)
            y = [a, b][c] if a > b else TABLE[a + b]
            return x, y, (x if x < y else y) + (1 if x == y else 0)
    """,
    "what is known in a branch": """
        def f(a, b, c):
            places = [5, 6, 7]
            x = places[a] if a < 3 else -1
            if 1 <= b <= 3:
                x += places[b - 1]
            if a == b:
                x += TABLE[a + b]
            return x, places[min(a, 2)]
    """,
    "constant lists, which are lists": """
        GOAL, GOALS, START = [1, 0], [[1, 0], [2, 2]], [[1, 0], [2, 3]]
        def f(a, b, c):
            equal = [a, b] == GOAL, (a, b) == GOAL, [a, b] in GOALS, (a, b) in GOALS
            longer, own, board = GOAL + [a], GOAL.copy() * 2, [row[:] for row in START]
            own[a] = board[c][c] = b
            chosen = list(GOAL if c else [a, b])
            chosen[c] = 7
            return [*equal, *longer, *own, *board[0], *board[1], *chosen, *START[c]]
    """,
    "an array of NumPy's": """
        import numpy as np
        TWO = np.array([[1, 2, 3, 4], [5, 6, 7, 8], [9, 8, 7, 6], [1, 1, 1, 1]])
        FLAGS = np.array([True, False, True, True])
        def f(a, b, c):
            return TWO[a, b], TWO[a][b], TWO[2, b], *TWO[b][1:3], 5 if FLAGS[a] else len(TWO)
    """,
    "methods that decide and write": """
        from dataclasses import dataclass
        from typing import NamedTuple
        @dataclass
        class Robot:
            row: int
            load: list
            def move(self, by):
                if by == 2:
                    self.load[0] = 5
                    return
                self.row += by
        class Point(NamedTuple):
            x: int
            def moved(self, by):
                return self if by > 2 else self._replace(x=self.x + by)
        def f(a, b, c):
            robot, point = Robot(3, [1, 2]), Point(b)
            if a > 1:
                robot.move(b)
                setattr(robot, "row", robot.row + 1)
                point = point.moved(a)
            return robot.row, *robot.load, point.x
    """,
    "functions that no name leads to": """
        import functools
        def first(board, x):
            board[0] = x
        def second(board, x):
            if x:
                board[1] = x
        ACTS, NAMED = (first, second), {"second": second}
        part = functools.partial(first, x=7)
        def by_default(board, x, act=second):
            act(board, x)
        def f(a, b, c):
            board, other, third = [0, 0], [0, 0], [0, 0]
            for act in ACTS:
                if a > 1:
                    act(board, b)
            if a > 2:
                NAMED["second"](other, a)
                part(other)
            if c:
                by_default(third, b)
            return board + other + third
    """,
    "dicts whose keys are words": """
        MOVES = {0: (-1, 0), 1: (0, 1), 2: (1, 0), 3: (0, -1)}
        def f(a, b, c):
            row, column = MOVES[c]
            made = {1: [a], 2: [b], 3: [c]}
            found = 0
            if 1 <= a <= 3:
                made[a][0] = 7
                found = made[a][0] + {1: 4, 2: a, 3: 6, 4: 5}[a]
            return row, column, made[1][0], made[2][0], made[3][0], found
    """,
    "slices that are written where a word decides": """
        def f(a, b, c):
            board, other = [a, b, c, 1, 2], [0] * 4
            if a > 1:
                board[1:3] = board[3:]
            else:
                board[::2] = [c, c, a]
                if c:
                    other[1:] = [a, b, c]
                other[:0] = []
            return *board, *other
    """,
    "slices of what may be the same list": """
        def f(a, b, c):
            d, e = [[1, 2, 3], [3, 4, 5]], {0: [1, 2, 3], 1: [4, 5, 6]}
            p, q = d[b & 1], d[b >> 1]
            p[::-1] = q
            row = e[a & 1]
            if c:
                row[::-1] = row
                row[0:2] = (x + 1 for x in [a, b])
            return *d[0], *d[1], *e[0], *e[1]
    """,
    "draws below a word that may be 0": """
        def f(a, b, c):
            k = Draws([(a << 30) + 12345]).below(b)
            return k if b > c else b
    """,
    "slices and lengths that a condition tells": """
        def f(a, b, c):
            v = [a, b, c, 4]
            if a == 2:
                return sum(v[a:]) + sum([b] * a)
            return 0
    """,
    "lists that grow in place": """
        from dataclasses import dataclass
        @dataclass
        class Box:
            rows: list
        def f(a, b, c):
            grid, one = [[a], [b]], [c]
            row, box = grid[0], Box(one)
            grid[0] += [b]
            box.rows += [a]
            return [*row, *one, *grid[0]]
    """,
    "lists of a branch that grow there": """
        import copy
        def longer(x, y):
            made = x + [y]
            made.append(y)
            twice, same = made * 2, made.copy()
            twice.pop()
            same.append(7)
            deep = copy.deepcopy([x, made])
            deep[1].append(x[0])
            return sum(twice) + sum(same) + sum(deep[1])
        def f(a, b, c):
            return longer([a, c], b) if a > 1 else 0
    """,
    "objects that a word chooses": """
        from dataclasses import dataclass
        @dataclass
        class Robot:
            row: int
            load: list
        def f(a, b, c):
            robots = [Robot(k, [k, a]) for k in range(4)]
            robots[a].row += 5
            robot = robots[b]
            robot.load[c] = 9
            robots[3].load[0] += 1
            equal = robot == robots[a], robot != Robot(b, [b, a]), robot is robots[2]
            return [*equal, *(x for r in robots for x in (r.row, *r.load))]
    """,
    "the order of sequences": """
        def f(a, b, c):
            less = (a, b) < (b, a), [a, b] <= [b, a], (a, 1) > (b, c), (a,) < (a, b), [a, b, c] >= [b, a]
            return [*less, *max((a, b), (b, a)), *min([a, c], [c, a], [b, b])]
    """,
    "the least by a key": """
        def f(a, b, c):
            board = [a, b, c + 1]
            places = min(range(3), key=lambda k: board[k]), max(range(3), key=board.__getitem__)
            others = min(board, key=lambda x: -x), max(b, a, key=lambda x: x ^ 1)
            return [*places, *others, min(board, default=9)]
    """,
    "reductions of loops inside others": """
        def f(a, b, c):
            board = [[a, b], [b, c], [c, a]]
            return [
                any(x == 2 for i in range(3) if i < 2 for x in board[i + 1]),
                sum((x for i in range(4) if i < 3 if i != b for x in board[i] if x > 1), 10),
                all(x > 0 for i in range(3) if i < 2 if a for x in board[i + 1] if x != 2),
            ]
    """,
    "what is looked for in an iterator": """
        import itertools
        def f(a, b, c):
            named, found = {"a": a, "b": b}, 0
            for k in itertools.count(1, step=2):
                if k > 6:
                    break
                found += k
            return 3 in (x for x in [a, b]), 2 in named.values(), found, round(a), (a == b) is not None
    """,
    "what a branch keeps from being divided by": """
        def f(a, b, c):
            first = a // b if b else 0, a % b if b > 0 else 7, b and a // b
            x = a << (b - 1) if b >= 1 else 0
            if b == 0:
                return [*first, x, a]
            while b:
                a, b = b, a % b
            return [*first, x, a]
    """,
    "types by other names": """
        from typing import NamedTuple
        def f(a, b, c):
            class Point(NamedTuple):
                x: int
            kinds = isinstance(a, int), isinstance([a], (list, tuple)), isinstance(c == 1, float), bool()
            point = type(Point(1))(a)
            return [*kinds, point.x, int("11", 2), int.from_bytes(b"a", "big"), pow(a, 2, 3)]
    """,
    "all numbers in any order": """
        def f(a, b, c):
            draws = Draws([a << 30, b << 30, a << 29, b << 29, c << 31, a << 30, b << 30])
            names = [5, 6, 7, 8, 9, 10, 11, 12]
            return [names[k] for k in draws.permutation(8)]
    """,
    "a row that a branch puts into a list, and changes": """
        from dataclasses import dataclass
        @dataclass
        class Robot:
            load: list
        def f(a, b, c):
            board, robot = [[1, 2], [3, 4]], Robot([1, 2])
            if c:
                row = robot.load = [5, 6]
                board[b & 1] = row
                board[a & 1][1] = 9
                robot.load[a & 1] = 7
                row[0] = 8
                if a > 1:
                    board[0] = [a, b]
                    board[0][0] += 1
            else:
                board[0] = board[1]
                board[0][a & 1] = 4
            return board[0] + board[1] + robot.load
    """,
    "objects that begin and are called": """
        from dataclasses import dataclass
        class Counter:
            def __init__(self, n, *, k=1):
                self.n = n if n > 1 else k
                if n == 3:
                    self.n = 0
            def __call__(self, x):
                if x > 1:
                    self.n += x
        @dataclass
        class Filler:
            row: list
            size: int = 2
            def __post_init__(self):
                self.row[0] = 5
                if self.size > 2:
                    self.size = 1
        def f(a, b, c):
            row, counter, sizes = [1, 2], Counter(a, k=c), 0
            if b > 1:
                inner = Counter(b)
                inner(a)
                sizes = Filler(row, a).size + inner.n
                counter(a)
            if c:
                list(map(counter, [a, b]))
            return *row, counter.n, sizes
    """,
    "constant dicts": """
        NAMED = {"u": [1, 2, 3, 4], "v": {"w": (4, 5, 6, 7)}}
        def f(a, b, c):
            own = dict(NAMED, n=a)
            own["n"] += 1
            return NAMED["u"][a] + NAMED["v"]["w"][b], own["n"], (NAMED | {"z": c})["z"], NAMED.get("x", 3)
    """,
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_programs(name: str) -> None:
    """For all their arguments."""
    cases = list(itertools.product(range(4), range(4), range(2)))
    assert_same(function(PROGRAMS[name]), SMALL, cases)


def test_what_is_traced_grows_with_the_text() -> None:
    """Not with the number of paths."""

    def nodes(count: int) -> int:
        lines = [
            f"    if d >> {k % 32} & 1:\n        b = b + {k} & 255\n        x ^= b" for k in range(count)
        ]
        f = function("\n".join(["def f(b, d):", "    x = 0", *lines, "    return x"]), f"<{count} branches>")
        begin = time.process_time()
        found = traced(f, ("b", 8, False), ("d", 32, False))
        assert count > 40 or time.process_time() - begin < 1
        return len(in_order(found))

    assert nodes(80) < 2.2 * nodes(40)


MISTAKES = {
    "a variable of one side": (
        """
        def f(a, b):
            if a > 3:
                v = b
            return v
        """,
        (4, "`v` has no value on every path that leads here; give it one before"),
    ),
    "a variable of a loop that may break": (
        """
        def f(a, b):
            for k in range(3):
                if a == k:
                    v = b
                    break
            return v + 1
        """,
        (6, "`v` has no value on every path"),
    ),
    "shapes that differ": (
        """
        def f(a, b):
            if a > 3:
                v = [a, b]
            else:
                v = [a]
            return v[0]
        """,
        (6, "one side of a branch leaves 2 elements and the other 1; a length cannot depend on a word"),
    ),
    "a list or a number": (
        """
        def f(a, b):
            v = [a, b] if a > 3 else a
            return v
        """,
        (2, "one side of a branch leaves 2 elements and the other a word"),
    ),
    "no value on one side": (
        """
        def f(a, b):
            if a > 3:
                return b
        """,
        (2, "one side of a branch leaves a word and the other nothing"),
    ),
    "a while without a bound": (
        """
        def f(a, b):
            while a > 0:
                a = a * 5 & 15
            return a
        """,
        (2, "a `while` goes round more than 1000 times: nothing that is known of its words ends it"),
    ),
    "a list that grows": (
        """
        def f(a, b):
            v = []
            if a > 3:
                v.append(b)
            return len(v)
        """,
        (4, "a list grows or shrinks where a word decides whether it does; give it its full length before"),
    ),
    "a list that grows in place": (
        """
        def f(a, b):
            v = [1] + [2]
            if a > 3:
                v += [b]
            return len(v)
        """,
        (4, "a list grows or shrinks"),
    ),
    "a list that shrinks": (
        """
        def f(a, b):
            v = [1, 2]
            if a > 3:
                del v[0]
            return v[0]
        """,
        (4, "a list grows or shrinks"),
    ),
    "a list that a word has chosen, and that grows": (
        """
        def f(a, b):
            v, w = [1, 2], [3, 4]
            x = v if a > 3 else w
            x.append(b)
            return len(v)
        """,
        (4, "a list grows or shrinks"),
    ),
    "a float": (
        """
        def f(a, b):
            v = 1.5 if a > 3 else 0
            return v
        """,
        (2, "1.5 is a float; golden functions work on integers"),
    ),
    "a division that makes a float": (
        """
        def f(a, b):
            return round(a / 2)
        """,
        (2, "`/` makes a float; golden functions divide by `//`"),
    ),
    "an index beyond a list": (
        """
        def f(a, b):
            return [1, 2, 3][a]
        """,
        (2, "an index can be 0 to 15, and there are 3 elements; `min`, `max` or an `if` keeps it in"),
    ),
    "a write beyond a list": (
        """
        def f(a, b):
            v = [1, 2, 3]
            v[a] = b
            return v[0]
        """,
        (3, "an index can be 0 to 15, and there are 3 elements"),
    ),
    "an index that may be negative": (
        """
        def f(a, b):
            return [1, 2, 3][a % 3 - 1]
        """,
        (2, "an index can be -1 to 1, and there are 3 elements"),
    ),
    "a dict that lacks a key": (
        """
        def f(a, b):
            return {0: 1, 1: 2, 3: 4}[a & 3]
        """,
        (2, "a key can be 0 to 3, and the dict has no 2"),
    ),
    "a slice of another length": (
        """
        def f(a, b):
            v = [a, b, 0]
            if a > 3:
                v[1:] = [a]
            return len(v)
        """,
        (4, "a list grows or shrinks where a word decides whether it does"),
    ),
    "a key of a dict": (
        """
        def f(a, b):
            return len({a: 1})
        """,
        (2, "a word is in a set, or looked up by what wants its value; `d[word]` reads a dict, and a list"),
    ),
    "a set": (
        """
        def f(a, b):
            return len(set([a, b]))
        """,
        (2, "a set of words; golden functions have lists and tuples of them"),
    ),
    "a print": (
        """
        def f(a, b):
            print("a is", a)
            return a
        """,
        (2, "print() of a word, which has no value before hardware runs"),
    ),
    "a text": (
        """
        def f(a, b):
            return len(f"{a}")
        """,
        (2, "a word becomes text, and it has no value before hardware runs"),
    ),
    "a random number": (
        """
        import random
        def f(a, b):
            return a + random.randint(0, 3)
        """,
        (3, "golden functions cannot use random.randint"),
    ),
    "a generator": (
        """
        def g(a):
            yield a
        def f(a, b):
            return sum(g(a))
        """,
        (2, "golden functions are no generators; return a list"),
    ),
    "a range": (
        """
        def f(a, b):
            v = 0
            for k in range(a):
                v += k
            return v
        """,
        (3, "range() of a word; go over all rounds that there can be, and `break` where it is enough"),
    ),
    "a recursion": (
        """
        def g(a):
            if a == 0:
                return 0
            return 1 + g(a * 3 & 15)
        def f(a, b):
            return g(a)
        """,
        (None, "a function calls itself without end: nothing that is known of words stops it"),
    ),
    "a match": (
        """
        def f(a, b):
            match a:
                case 0:
                    return b
            return a
        """,
        (2, "golden functions have no `match`; use `if`, `elif` and `else`"),
    ),
    "a draw under an if": (
        """
        def f(a, b):
            draws = Draws([b])
            if a > 3:
                return draws.below(4)
            return a
        """,
        (4, "a draw is asked for where a word decides whether it is, in line 3; ask before that, since"),
    ),
    "a draw under a flag that was known before": (
        """
        def f(a, b):
            draws, big = Draws([b]), a > 3
            if b > 1:
                b = 1
            if big:
                if b:
                    a = draws.below(4)
            return a
        """,
        (7, "a draw is asked for where a word decides whether it is, in line 5; ask before that"),
    ),
    "a variable of one side for a helper, by its name": (
        """
        def twice(v):
            return v * 2

        def f(a, b):
            if a > 3:
                v = b
            return twice(v=v)
        """,
        (7, "`v` has no value on every path that leads here; give it one before"),
    ),
    "a word times a list": (
        """
        def f(a, b):
            return len(a * [0])
        """,
        (2, "a sequence where a number is due; the length of one depends on no word"),
    ),
    "a draw that a helper asks for": (
        """
        def take(draws):
            return draws.below(4)

        def f(a, b):
            draws = Draws([b])
            if a > 3:
                a = take(draws)
            return a
        """,
        (2, "a draw is asked for where a word decides whether it is, in line 6; ask before that"),
    ),
    "a variable of one side for a helper": (
        """
        def twice(v):
            w = v * 2
            return w

        def f(a, b):
            if a > 3:
                v = b
            return twice(v)
        """,
        (8, "`v` has no value on every path that leads here; give it one before"),
    ),
    "returns of two and of three": (
        """
        def f(a, b):
            if a > 3:
                return a, b
            return a, b, 0
        """,
        (None, "one `return` gives 2 values and another 3; each has to give the same"),
    ),
    "a list of a word's length": (
        """
        def f(a, b):
            v = [0] * a
            return len(v)
        """,
        (2, "a list as long as a word says; give it its full length"),
    ),
    "a slice that a word ends": (
        """
        def f(a, b):
            v = [a, b, 0]
            return len(v[:a])
        """,
        (3, "a word ends a slice, and its length would depend on it; take all elements, and an `if`"),
    ),
    "a slice that a word ends and that is written": (
        """
        def f(a, b):
            v = [a, b, 0]
            v[a:] = [0]
            return len(v)
        """,
        (3, "a word ends a slice"),
    ),
    "a place that nothing has": (
        """
        def f(a, b):
            return [a, 3].index(16)
        """,
        (2, "index() of a value that no element can be"),
    ),
    "no numbers to draw from": (
        """
        def f(a, b):
            return Draws([b]).below(0)
        """,
        (2, "draws.below(0) asks for a number from 0 to -1; it takes 1 or more"),
    ),
    "an attribute of a NamedTuple": (
        """
        Pair = namedtuple("Pair", ["x"])

        def f(a, b):
            pair = Pair(a)
            pair.x = b
            return pair.x
        """,
        (5, "attribute 'x' of a NamedTuple is written: take `_replace(x=...)`, or make Pair a dataclass"),
    ),
    "a draw after a return": (
        """
        def f(a, b):
            draws = Draws([b])
            if a > 3:
                return 0
            return draws.bits(3)
        """,
        (5, "a draw is asked for where a word decides whether it is"),
    ),
    "a draw in half of an expression": (
        """
        def f(a, b):
            draws = Draws([b])
            return a > 3 and draws.chance(1, 2)
        """,
        (3, "a draw is asked for where a word decides whether it is"),
    ),
    "a try": (
        """
        def f(a, b):
            try:
                return [1, 2][a]
            except IndexError:
                return 0
        """,
        (2, "golden functions have no `try`"),
    ),
    "a variable of the function around": (
        """
        def f(a, b):
            v = 0
            def g():
                nonlocal v
                v = v + 1
            if a:
                g()
            return v
        """,
        (4, "`v` of a function around it is assigned to; return it instead"),
    ),
    "an import": (
        """
        def f(a, b):
            import time
            return int(time.time())
        """,
        (2, "golden functions have no `import`; import where the file begins"),
    ),
    "an exception": (
        """
        def f(a, b):
            if a > 3:
                raise ValueError("no")
            return a
        """,
        (3, "a `raise` where a word decides; hardware has nobody to tell"),
    ),
    "an assertion": (
        """
        def f(a, b):
            if a > 3:
                assert False
            return a
        """,
        (3, "an `assert` on a word; hardware has nobody to tell"),
    ),
    "an identity": (
        """
        def f(a, b):
            return 1 if (a > 3) is True else 0
        """,
        (2, "`is` on a word; use `==`"),
    ),
    "a constant list that is written": (
        """
        BOARD = [1, 2]
        def f(a, b):
            BOARD[a & 1] = b
            return BOARD[0]
        """,
        (3, "what is made outside of the function is written, and each slot would need its own"),
    ),
    "a default list that grows": (
        """
        def g(a, seen=[]):
            seen.append(a)
            return len(seen)
        def f(a, b):
            return g(a)
        """,
        (2, "what is made outside of the function is written"),
    ),
    "a slice of a table": (
        """
        import numpy as np
        TABLE = np.array([[1, 2], [3, 4]])
        def f(a, b):
            return TABLE[:, 1]
        """,
        (4, "a table is indexed by one number for each of its dimensions; a slice is none"),
    ),
    "a set that grows": (
        """
        def f(a, b):
            seen = set()
            if a > 3:
                seen.add(1)
            return len(seen)
        """,
        (4, "a set changes where a word decides whether it does; use a list of a flag, or a number"),
    ),
    "a dict that changes": (
        """
        def f(a, b):
            v = {"x": 1}
            if a > 3:
                v.update(x=b)
            return v["x"]
        """,
        (4, "a dict changes where a word decides whether it does"),
    ),
    "a dict that gets a key": (
        """
        def f(a, b):
            v = {"x": 1}
            if a > 3:
                v["y"] = b
            return len(v)
        """,
        (4, "a dict changes where a word decides whether it does"),
    ),
    "a queue": (
        """
        from collections import deque
        def f(a, b):
            v = deque([1])
            if a > 3:
                v.appendleft(b)
            return len(v)
        """,
        (5, "a deque changes where a word decides whether it does"),
    ),
    "a list that is turned round": (
        """
        def f(a, b):
            v = [1, 2]
            if a > 3:
                v.reverse()
            return v[0]
        """,
        (4, "reverse() of a list where a word decides whether it is; write its elements"),
    ),
    "a cast in a method": (
        """
        from typing import NamedTuple
        class Robot(NamedTuple):
            row: int
            def moved(self):
                return u8(self.row + 1)
        def f(a, b):
            return Robot(a).moved()
        """,
        (5, "golden functions cannot use uint8 in a method or a function of a list; write a function"),
    ),
    "a type": (
        """
        def f(a, b):
            return 1 if type(a) is int else 0
        """,
        (2, "type() of a number or a list, which is of another one before hardware runs"),
    ),
    "a flag's type": (
        """
        def f(a, b):
            return 1 if isinstance(a, bool) else 0
        """,
        (2, "isinstance() asks whether a word is a bool, and a flag is a word like others"),
    ),
    "an exponent": (
        """
        def f(a, b):
            return 2**a
        """,
        (2, "a word is an exponent; powers of 2 are `1 << k`, and those of others a list"),
    ),
    "an attribute that a branch makes": (
        """
        from types import SimpleNamespace
        def f(a, b):
            v = SimpleNamespace()
            if a:
                v.x = b
            return v.x
        """,
        (5, "attribute 'x' is new where a word decides whether it is; give it a value before"),
    ),
    "objects of no record": (
        """
        class Robot:
            pass
        def f(a, b):
            v = Robot() if a else Robot()
            return v.x
        """,
        (4, "a word chooses between two objects of Robot; make Robot a NamedTuple or a dataclass"),
    ),
    "functions that a word chooses": (
        """
        def f(a, b):
            return (min if a else max)(a, b)
        """,
        (2, "a word chooses between two functions; call each on its side of the branch"),
    ),
    "a chance that is a word": (
        """
        def f(a, b):
            return Draws([b]).chance(a, 16)
        """,
        (2, "draws.chance() takes numbers, and a word is none yet; draws.below(n) < word is such a chance"),
    ),
    "bits that are a word": (
        """
        def f(a, b):
            return Draws([b]).bits(a)
        """,
        (2, "draws.bits(a word): a draw has 1 to 32 bits"),
    ),
    "an order by words": (
        """
        def f(a, b):
            return sorted(range(2), key=lambda k: [a, b][k])[0]
        """,
        (2, "sorted() of words; pearl_marl.golden.inserted puts one into its place"),
    ),
    "a field of another name": (
        """
        from typing import NamedTuple
        class Robot(NamedTuple):
            row: int
        def f(a, b):
            return Robot(a)._replace(column=b)[0]
        """,
        (5, "ValueError: Got unexpected field names: ['column']"),
    ),
    "nothing": (
        """
        def f(a, b):
            return a, None
        """,
        (1, "f() returns None, and an integer is due"),
    ),
    "a coroutine": (
        """
        async def f(a, b):
            return a
        """,
        (1, "golden functions have no `async`"),
    ),
    "a constant dict that is written": (
        """
        COUNTS = {"n": 0}
        def f(a, b):
            COUNTS["n"] += 1
            return COUNTS["n"]
        """,
        (3, "what is made outside of the function is written"),
    ),
    "an attribute of a class": (
        """
        class Count:
            n = 0
        def f(a, b):
            Count.n += 1
            return Count.n
        """,
        (4, "attribute 'n' of what all slots share is written; return it, or keep it in the state"),
    ),
    "an element that counts": (
        """
        def f(a, b):
            v = [0]
            for v[0] in range(3):
                a += 1
            return a
        """,
        (3, "a `for` counts in an element or an attribute; count in a variable, and assign it"),
    ),
    "an iterator": (
        """
        def f(a, b):
            v = iter([1, 2, 3])
            if a > 3:
                next(v)
            return next(v)
        """,
        (4, "next() where a word decides whether it is; go on before the `if`"),
    ),
    "a heap": (
        """
        from heapq import heappush
        def f(a, b):
            v = []
            if a > 3:
                heappush(v, 1)
            return len(v)
        """,
        (5, "heappush() writes where a word decides whether it does; assign instead"),
    ),
    "an operator that changes an object": (
        """
        class Count:
            n = 0
            def __iadd__(self, by):
                self.n = by
                return self
        def f(a, b):
            v = Count()
            if a > 3:
                v += 1
            return v.n
        """,
        (9, "an operator of Count changes it where a word decides; write a function"),
    ),
    "a comprehension that leaves out": (
        """
        def f(a, b):
            return len([x for x in (a, b) if x > 3])
        """,
        (2, "a word decides whether an element is left out, and a length depends on no word"),
    ),
    "a decision of a library": (
        """
        def f(a, b):
            return sum(filter(lambda x: x > 3, [a, b]))
        """,
        (2, "a word decides what Python does next, where its source is not at hand"),
    ),
    "an order": (
        """
        def f(a, b):
            v = [a, b]
            v.sort()
            return v[0]
        """,
        (3, "sort() of a list of words: their order is not known before hardware runs"),
    ),
    "an assignment in a condition": (
        """
        def f(a, b):
            if a > 3 and (v := b) > 2:
                return v
            return a
        """,
        (2, "`v :=` in what is not always evaluated; assign it before"),
    ),
}


@pytest.mark.parametrize("what", MISTAKES)
def test_mistakes(what: str) -> None:
    text, (line, words) = MISTAKES[what]
    place = r"pump/step.py, line \d+: " if line is None else f"pump/step.py, line {line}: "
    with pytest.raises(ArgumentError, match=place + re.escape(words)) as found:
        traced(function(text), ("a", 4, False), ("b", 32, False))
    assert str(found.value).startswith("pump/step.py, line ")
    assert "\n" not in str(found.value)


def test_a_file_that_has_changed_since_it_was_imported_is_noticed(tmp_path: Path) -> None:
    """Or Python would run the old function, and kernels and hardware the new one."""
    file = tmp_path / "changing.py"
    file.write_text("def step(a):\n    if a > 3:\n        return a - 3\n    return a\n")
    spec = importlib.util.spec_from_file_location("changing", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    file.write_text("def step(a):\n    if a > 3:\n        return a - 2\n    return a\n")
    linecache.clearcache()
    graph = Graph()
    with pytest.raises(ArgumentError, match=r"changing.py, line 1: step\(\) is not what its file says"):
        trace(graph, module.step, [graph.input("a", 4)])
