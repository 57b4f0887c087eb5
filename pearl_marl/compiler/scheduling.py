"""In which stage of the pipeline each operation is done.

Two operations that are too long for one stage together are a stage apart. Of the schedules of the least
latency it is one with the fewest register bits: a linear programme of differences, whose solution is whole by
itself. Where tools make shift registers of long delays, which cost the same at any length, it also decides by
integers which ones are long, and is content with nearly the least.
"""

from __future__ import annotations

import hashlib
import heapq
import inspect
import json
import math
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from pearl_marl.base.cache import cache_folder, keep, kept
from pearl_marl.compiler.core_graph import Output
from pearl_marl.compiler.targets import Target
from pearl_marl.compiler.widths import WIRES, used_bits, width
from pearl_marl.errors import DeviceError
from pearl_marl.golden.tracing.nodes import Node, in_order

SHORT = 2
"""Registers in a row that never become a shift register."""
NEAR, MOST_NODES = 0.05, 50
"""How much more than the least a schedule may cost, and after how many steps the search ends anyway: most of
the time would go into the proof that there is none better."""


class Schedule(NamedTuple):
    """When operations are done. Wires and constants are in no stage: they are wherever they are used."""

    order: list[Node]
    """The operations, each after what it is made of."""
    used: Mapping[Node, int]
    """The bits of each node that are used."""
    sources: Mapping[Node, list[Node]]
    """The operations that each node is made of by wires alone, or that it is itself."""
    stage: Mapping[Node, int]
    last: Mapping[Node, int]
    """The last stage in which it is used."""
    latency: int
    longest: float
    """What the slowest stage's operations take together, in ns."""
    target: Target

    @property
    def register_bits(self) -> int:
        """How many bits are kept from a stage to the next, all stages together."""
        return sum(self.used[n].bit_count() * (self.last[n] - self.stage[n]) for n in self.order)


def scheduled(outputs: Sequence[Output], target: Target) -> Schedule:
    """Return the schedule of a lowered core."""
    whole = in_order(o.node for o in outputs)
    used = used_bits(whole, [(o.node, o.bits) for o in outputs])
    sources: dict[Node, list[Node]] = {}
    for node in whole:
        sources[node] = (
            [node]
            if (node.op not in WIRES and node.args) or node.op == "input"
            else list(dict.fromkeys(s for a in node.args for s in sources[a]))
        )
    order = [n for n in whole if sources[n] == [n]]
    number = {n: i for i, n in enumerate(order)}
    arguments = [sorted({number[s] for a in n.args for s in sources[a]}) for n in order]
    delays = [target.delay(n, width(n, used)) for n in order]
    reach: Counter[int] = Counter()
    for node, below in zip(order, arguments, strict=True):
        reach.update(dict.fromkeys((i for i in below if width(order[i], used) == 1), width(node, used)))
    delays = [delay + target.fan_out(reach[i]) for i, delay in enumerate(delays)]
    ends = {number[s] for o in outputs for s in sources[o.node]}
    gaps = _gaps(order, arguments, delays, target)
    early = [0] * len(order)
    for j, below in enumerate(arguments):
        later = [early[i] + stages for i, stages in gaps[j].items()]
        early[j] = max([0, *(early[i] for i in below), *later])
    latency = max((early[i] for i in ends), default=0) + 1
    bits = [used[n].bit_count() for n in order]
    # A multiplier with an adder has registers of its own: two before it, one between them, one behind.
    before = [2 * (target.family.accumulator > 0 and n.op == "mul") for n in order]
    behind = [int(b > 0 or target.accumulates(n, width(n, used))) for b, n in zip(before, order, strict=True)]
    late = [0 if n.op == "input" else latency - 1 for n in order]
    for j in reversed(range(len(order))):
        for i in arguments[j]:
            late[i] = min(late[i], late[j])
        for i, stages in gaps[j].items():
            late[i] = min(late[i], late[j] - stages)
    window = list(zip(early, late, strict=True))
    problem = _Problem(
        arguments, gaps, sorted(ends), bits, latency, window, before, behind, target.family.shift_register
    )
    stage = _fewest_registers(problem) if order else []  # a policy may always return the same
    last = list(stage)
    for j, below in enumerate(arguments):
        for i in below:
            last[i] = max(last[i], stage[j])
    for i in ends:
        last[i] = latency
    arrival = list(delays)
    for j, below in enumerate(arguments):
        arrival[j] += max((arrival[i] for i in below if stage[i] == stage[j]), default=0)
    begins_at, ends_at = (dict(zip(order, numbers, strict=True)) for numbers in (stage, last))
    return Schedule(order, used, sources, begins_at, ends_at, latency, max(arrival, default=0.0), target)


def _gaps(
    order: Sequence[Node], arguments: Sequence[Sequence[int]], delays: Sequence[float], target: Target
) -> list[dict[int, int]]:
    """Return for each operation those before it that have to be in an earlier stage, and how much earlier."""
    gaps = _too_far(arguments, delays, target.budget)
    if travel := target.family.travel:
        for j, below in enumerate(arguments):
            for i in below:
                if order[j].op == "mul" or order[i].op == "mul":
                    # The stage of an input does nothing but travel.
                    gaps[j][i] = travel + (order[i].op != "input")
    return gaps


def _too_far(
    arguments: Sequence[Sequence[int]], delays: Sequence[float], budget: float
) -> list[dict[int, int]]:
    """Return for each operation those before it that are too long to be in one stage with it: 1 for each."""
    users: list[list[int]] = [[] for _ in arguments]
    for j, below in enumerate(arguments):
        for i in below:
            users[i].append(j)
    gaps: list[dict[int, int]] = [{} for _ in arguments]
    for i in range(len(arguments)):
        longest, queue, done = {i: delays[i]}, [i], set()
        while queue:
            j = heapq.heappop(queue)
            if j in done:
                continue
            done.add(j)
            if j != i and longest[j] > budget + 1e-9:
                gaps[j][i] = 1
                continue  # what is beyond it is further still
            for k in users[j]:
                longest[k] = max(longest.get(k, 0.0), longest[j] + delays[k])
                heapq.heappush(queue, k)
    return gaps


class _Problem(NamedTuple):
    """Operations to be put into stages; all but the numbers of stages and registers are by operation."""

    arguments: Sequence[Sequence[int]]
    gaps: Sequence[Mapping[int, int]]
    ends: Sequence[int]
    """The outputs' operations."""
    bits: Sequence[int]
    latency: int
    """How many stages there are; after them are the outputs' registers."""
    window: Sequence[tuple[int, int]]
    """The first and the last stage that an operation can be in."""
    before: Sequence[int]
    """Registers of the arguments that cost nothing."""
    behind: Sequence[int]
    """Registers of the result that cost nothing."""
    shift_register: int
    """How many registers a bit of a shift register costs. Up to where all but the last of its users look at
    it, a result is in registers; from there on it may be in a shift register. 0 is none."""


def _fewest_registers(problem: _Problem) -> list[int]:
    """Return the stage of each operation; it is kept, since finding it can take seconds."""
    text = repr((problem, inspect.getsource(sys.modules[__name__])))
    path = cache_folder("schedules") / hashlib.sha256(text.encode()).hexdigest()[:16]
    if (content := kept(path)) is not None:
        stages: list[int] = json.loads(content)
        return stages
    found = _solved(problem)
    keep(path, json.dumps(found).encode())
    return found


def _solved(problem: _Problem) -> list[int]:
    arguments, gaps, ends, bits, latency, window, before, behind, shift_register = problem
    try:
        from scipy.optimize import Bounds, LinearConstraint, milp
        from scipy.sparse import coo_array
    except ModuleNotFoundError as error:
        raise DeviceError(
            f"generating a core needs the Python package {error.name}; install it with: pip install '.[rtl]'"
        ) from None
    count = len(arguments)
    users: list[list[int]] = [[] for _ in arguments]
    for j, below in enumerate(arguments):
        for i in below:
            users[i].append(j)
    # Of each operation its stage, the end of its first registers, that of its last ones, how many these are,
    # and whether they are a shift register.
    stage, first, last, kept, shifted = (range(k * count, (k + 1) * count) for k in range(5))
    rows: list[tuple[list[tuple[int, float]], float]] = []
    for j, below in enumerate(arguments):
        rows += (([(stage[i], 1), (stage[j], -1)], 0) for i in below)
        rows += (([(stage[i], 1), (stage[j], -1)], -stages) for i, stages in gaps[j].items())
    for i in range(count):
        others = sorted(users[i], key=lambda j: window[j])
        if others and i not in ends:
            latest = others.pop()
            rows.append(([(stage[latest], 1), (last[i], -1)], before[latest]))
        rows += (([(stage[j], 1), (first[i], -1)], before[j]) for j in others)
        rows.append(([(stage[i], 1), (first[i], -1)], -behind[i]))
        if not others:
            rows.append(([(first[i], 1), (stage[i], -1)], behind[i]))
        rows.append(([(first[i], 1), (last[i], -1)], 0))
        rows.append(([(last[i], 1), (first[i], -1), (kept[i], -1), (shifted[i], -latency)], 0))
    cells = ((value, number, column) for number, (terms, _) in enumerate(rows) for column, value in terms)
    values, numbers, columns = zip(*cells, strict=True)
    matrix = coo_array((values, (numbers, columns)), shape=(len(rows), 5 * count))
    weights = [b + 1e-2 for b in bits]
    # A little for being late, so that of equally good schedules it is always the same one.
    cost = (
        [1e-4 - w for w in weights]
        + weights
        + [0.0] * count
        + weights
        + [shift_register * w for w in weights]
    )
    bounds = [
        *window,
        *[(0, latency + 1)] * count,
        *((latency * (i in ends), latency + 1) for i in range(count)),
    ]
    bounds += [(0, SHORT if shift_register else latency)] * count
    bounds += [(0, int(shift_register > 0))] * count
    found = milp(
        cost,
        constraints=LinearConstraint(matrix.tocsr(), ub=[limit for _, limit in rows]),
        bounds=Bounds(*zip(*bounds, strict=True)),
        integrality=[int(column in shifted) for column in range(5 * count)],
        options={"mip_rel_gap": NEAR, "node_limit": MOST_NODES},
    )
    if found.x is None:
        raise DeviceError(f"the stages of the core could not be found: {found.message}")
    # Whichever solution it is, so rounded its stages are still as far apart as they have to be.
    found_at = [math.floor(value + 0.5) for value in found.x[:count]]
    for j, below in enumerate(arguments):
        if any(found_at[i] > found_at[j] for i in below) or any(
            found_at[i] + stages > found_at[j] for i, stages in gaps[j].items()
        ):
            raise DeviceError(
                "the stages of the core that were found are not in order; ask for another clock"
            )
    return found_at
