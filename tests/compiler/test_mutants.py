"""The compiler with one deliberate fault at a time: each is found by a check that passes without it."""

from __future__ import annotations

import importlib
import inspect
import random
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import pytest

from pearl_marl.compiler.targets import Target
from pearl_marl.envs import get_spec
from pearl_marl.errors import DeviceError

from ..rtl.random_steps import random_spec
from ..rtl.wide_steps import wide_spec
from .test_proofs import unproved_gating, unproved_lowering, unproved_text
from .test_straight_line import assert_means_the_golden_functions, wide

TARGETS = Target("xc7", 150), Target("ecp5", 300)


@contextmanager
def fault(name: str, old: str, new: str) -> Iterator[None]:
    """Put a fault into a module of the compiler, and in all who have imported from it."""
    module = importlib.import_module(f"pearl_marl.compiler.{name}")
    source = inspect.getsource(module)
    assert source.count(old) == 1, f"{name} no longer has the line that this fault changes"
    before = dict(vars(module))
    exec(compile(source.replace(old, new), str(module.__file__), "exec"), vars(module))
    put: list[tuple[ModuleType, str]] = []
    for user in [m for n, m in sys.modules.items() if n.startswith("pearl_marl.compiler.")]:
        for key, value in before.items():
            if user is not module and not key.startswith("__") and vars(user).get(key) is value:
                put.append((user, key))
                setattr(user, key, vars(module)[key])
    try:
        yield
    finally:
        for user, key in put:
            setattr(user, key, before[key])
        vars(module).update(before)


def check_gating(_: Path) -> None:
    for spec in (get_spec("CliffWalking"), get_spec("Blackjack"), *map(random_spec, (0, 1, 2, 35))):
        assert not unproved_gating(spec)


def check_lowering(_: Path) -> None:
    for env in ("Taxi", "Blackjack", "MountainCar"):
        assert next(unproved_lowering(get_spec(env), TARGETS[: 1 + (env == "MountainCar")]), None) is None
    divided = wide(lambda state: ((state.word & 0xFFF) // 13, (state.word & 0x7FF) % 20))
    assert next(unproved_lowering(divided, TARGETS), None) is None
    by_words = wide(lambda s: (((s.word & 0xF) - 7) // ((s.by & 7) | 1), (s.word & 0xF) % ((s.by & 7) | 1)))
    assert next(unproved_lowering(by_words, TARGETS), None) is None


def check_text(folder: Path) -> None:
    random_specs = (*map(random_spec, (2, 3, 7, 11)), *map(wide_spec, range(2)))
    for spec in (get_spec("Taxi"), *random_specs, get_spec("MountainCar")):
        assert next(unproved_text(spec, TARGETS[0], folder), None) is None


def check_kernels(_: Path) -> None:
    assert_means_the_golden_functions(get_spec("FrozenLake"), random.Random(0))
    bit = wide(lambda s: ((s.word & 0xFF) >> (s.by & 7) & 1, 0))
    assert_means_the_golden_functions(bit, random.Random(0))
    for seed in range(15):
        assert_means_the_golden_functions(random_spec(seed), random.Random(seed))


FAULTS: list[tuple[Callable[[Path], None], str, str, str]] = [
    (
        check_gating,
        "gating",
        '"and" | "mul":\n            yield from (("zero", None), (None, "zero"))',
        '"and" | "mul":\n            yield None, None',
    ),
    (
        check_gating,
        "gating",
        '"sub" | "left_by" | "right_by":\n            yield demand, "zero"',
        '"sub" | "left_by" | "right_by":\n            yield demand, None',
    ),
    (
        check_gating,
        "gating",
        "made = graph.choose(self.hold, demand, whole)",
        "made = graph.choose(self.go, demand, whole)",
    ),
    (check_lowering, "lowering", "low_x + low_y + doubled, product", "low_x + low_y, product"),
    (check_lowering, "lowering", "constant(-(-(1 << fraction) // by))", "constant((1 << fraction) // by)"),
    (check_lowering, "lowering", "fraction = a.bits + by.bit_length()", "fraction = a.bits - 1"),
    (check_lowering, "lowering", '-sign if node.op == "sub" else sign', "sign"),
    (check_lowering, "lowering", "bits = by.bits + 1", "bits = by.bits"),
    (check_lowering, "joining", "graph.constant(a * b.imm)", "graph.constant(a * b.imm + 1)"),
    (check_lowering, "joining", "graph.left(y, x.imm)", "graph.left(y, x.imm + 1)"),
    (
        check_lowering,
        "lowering",
        "Term(1, 0, graph.right(below, cut))",
        "Term(1, 0, graph.right(below, cut + 1))",
    ),
    (check_lowering, "lowering", "digits[-n:]) >> low", "digits[-n:]) >> low + 1"),
    (check_text, "widths", "ask_signed(arg, full >> shift)", "ask_signed(arg, full >> shift + 2)"),
    (
        check_lowering,
        "widths",
        "ask_signed(node.args[0], bits << node.imm)",
        "ask_signed(node.args[0], bits)",
    ),
    (check_text, "scheduling", "last[i] = max(last[i], stage[j])", "last[i] = max(last[i], stage[j] - 1)"),
    (check_text, "verilog", "written.slice(node, 0, bits, k - 1)", "written.slice(node, 0, bits, stage)"),
    (
        check_text,
        "verilog",
        "output.node, 0, output.bits, self.schedule.latency",
        "output.node, 0, output.bits, self.schedule.latency - 1",
    ),
    (check_text, "verilog", '"{valid_q[LATENCY-2:0], valid_i}"', '"{LATENCY{valid_i}}"'),
    (check_text, "expressions", "signed = any(a.low < 0 for a in node.args)", "signed = False"),
    (
        check_text,
        "expressions",
        "return self.slice(args[0], low + node.imm, bits, stage)",
        "return self.slice(args[0], low, bits, stage)",
    ),
    (check_text, "expressions", "self.stage[user[node]] == self.stage[node]", "True"),
    (check_text, "expressions", "up, down = constant", "down, up = constant"),
    (
        check_text,
        "expressions",
        "unsigned'({bits}'(signed'({bare(piece)})))",
        "{bits}'(signed'({bare(piece)}))",
    ),
    (check_text, "expressions", "'(signed'({bare(value)}) >>> {by})", "'({bare(value)} >> {by})"),
    (check_kernels, "straight_line", "least = max(least, node.args[1].high + 1)", "least = max(least, 8)"),
    (
        check_kernels,
        "straight_line",
        '_OPPOSITE = {"equal": "differ", "less": "at_least"}',
        '_OPPOSITE = {"equal": "differ", "less": "less"}',
    ),
    (check_kernels, "straight_line", "bits = {k: 1 << k for k", "bits = {k: 2 << k for k"),
    (check_kernels, "straight_line", "unusual = {k: node.imm[k]", "unusual = {k: node.imm[k - 1]"),
    (check_kernels, "widths", "            bits = own", "            bits |= 0"),
    (
        check_kernels,
        "straight_line",
        "node.imm[k] - least << k % per_number * width",
        "node.imm[k] << k % per_number * width",
    ),
]


LONG = (check_text, check_lowering)
"""Checks that are exhaustive: z3 takes seconds; Yosys is WebAssembly, and takes a minute to compile."""


@pytest.mark.parametrize(
    "check",
    [
        pytest.param(check, marks=pytest.mark.exhaustive if check in LONG else ())
        for check in dict.fromkeys(check for check, *_ in FAULTS)
    ],
    ids=lambda check: check.__name__,
)
def test_without_a_fault(check: Callable[[Path], None], tmp_path: Path) -> None:
    check(tmp_path)


OF_PASSES = {(check, module): fault for fault in reversed(FAULTS) for check, module in [fault[:2]]}
FIRST = [fault for fault in OF_PASSES.values() if fault[0] not in LONG]
"""A fault of each pass that each check has to find; the others are exhaustive."""


@pytest.mark.parametrize(
    ("check", "module", "old", "new"),
    [pytest.param(*fault, marks=[] if fault in FIRST else pytest.mark.exhaustive) for fault in FAULTS],
)
def test_faults_are_found(
    check: Callable[[Path], None], module: str, old: str, new: str, tmp_path: Path
) -> None:
    with fault(module, old, new), pytest.raises((AssertionError, DeviceError)):
        check(tmp_path)
