"""The source of the CPU's kernels: short loops over blocks of slots, around the golden functions."""

from __future__ import annotations

from pearl_marl.compiler import pieces
from pearl_marl.compiler.block_pieces import BlockPieces, each_slot, part
from pearl_marl.compiler.kernel_template import TEMPLATE
from pearl_marl.compiler.lane_pieces import LanePieces
from pearl_marl.compiler.llvm_words import LINE
from pearl_marl.compiler.pieces import each
from pearl_marl.compiler.straight_line import golden_functions
from pearl_marl.spec import EnvSpec

CROWD = 16
"""Fields from which on a block's state is copied into lanes. Of more than a few arrays LLVM does not check
whether they overlap, and leaves the loop scalar; parts of one array it can tell apart."""


def kernel_source(spec: EnvSpec) -> str:
    """Return the source of the kernels of ``spec``, for :mod:`pearl_marl.compiler.kernels` to load."""
    p = LanePieces(spec) if len(spec.state) > CROWD else BlockPieces(spec)
    given = each("given_{}", p.observation)
    words = {
        "NAME": spec.name,
        "BLOCK": str(p.size),
        "PADDED": p.padded,
        "ELAPSED": p.column("memory", p.elapsed),
        "ENDED": p.column("memory", p.ended),
        "CODES": part("code_words", spec.reward.dtype),
        "ACTIONS": part("actions", spec.action.dtype),
        "OBSERVED": p.rows("observations"),
        "FINAL": p.rows("final_observations"),
        "ALL_OBSERVED": f"{p.dtype}_column(observations, 0, 0)",
        "FEW": str(p.few),
        "GIVEN": ", ".join(given),
        "FIRST_GIVEN": given[0],
    }
    parts = {
        "golden_functions": golden_functions(spec),
        **p.columns(),
        **p.draws(),
        **p.rewards(),
        "code": [p.space("code", spec.reward.dtype)],
        "flag": [p.space("flag", "uint8"), "flag_words = uint64_column(flag, 0, 0)"],
        "ended_slots": [p.space("ended_slots", "uint16")],
        "resetting": [p.space("resetting", "uint8")],
        "golden_step": p.golden_step(),
        "start_over": p.start_over(),
        "observe": each_slot(*p.observed()),
        "restart": p.restart(),
        "copy_one": p.copy_one,
        "start_one": p.start_one(),
        "observe_one": p.observed_start(),
        "given_parts": p.given_parts(),
        "deliver": p.deliver(each("given_{}[i]", p.observation)),
        "deliver_block": p.deliver(each("part_{}[i]", p.observation)),
    }
    words["SPACE"] = str(p.taken + LINE)
    words["FLAG_WORDS"] = str(p.size // 8)
    return pieces.filled(TEMPLATE, words, parts)
