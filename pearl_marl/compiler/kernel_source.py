"""The source of the CPU's kernels: short loops over blocks of slots, around the golden functions."""

from __future__ import annotations

import functools
from typing import NamedTuple

from pearl_marl.compiler import pieces
from pearl_marl.compiler.block_pieces import BlockPieces, part
from pearl_marl.compiler.kernel_template import TEMPLATE
from pearl_marl.compiler.lane_pieces import LanePieces
from pearl_marl.compiler.pieces import each
from pearl_marl.compiler.straight_line import golden_functions
from pearl_marl.spec import EnvSpec

CROWD = 16
"""Fields from which on a block's state is copied into lanes. Of more than a few arrays LLVM does not check
whether they overlap, and leaves the loop scalar; parts of one array it can tell apart."""


class _Itself(NamedTuple):
    """A spec that is the same as itself only, since not all that it has can be hashed."""

    spec: EnvSpec

    def __hash__(self) -> int:
        return id(self.spec)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Itself) and self.spec is other.spec


def kernel_source(spec: EnvSpec) -> str:
    """Return the source of the kernels of ``spec``, for :mod:`pearl_marl.compiler.kernels` to load."""
    return _source(_Itself(spec))


@functools.lru_cache(maxsize=64)
def _source(itself: _Itself) -> str:
    spec = itself.spec
    p = LanePieces(spec) if len(spec.state) > CROWD else BlockPieces(spec)
    given = each("given_{}", p.observation)
    size = p.size
    parts = {
        "golden_functions": golden_functions(spec),
        **p.columns(),
        "code": [f"code = {p.space(spec.reward.dtype, size)}"],
        "flag": [f"flag = {p.space('uint8', size)}", "flag_words = uint64_column(flag, 0, 0)"],
        "ended_slots": [f"ended_slots = {p.space('uint16', size)}"],
        "resetting": [f"resetting = {p.space('uint8', size)}"],
        "ended": [f"N = {p.places['N']}"],
        "reset_keys": p.keys("keys_for_start", p.reset_draws, "tick"),
        "step_keys": p.keys("keys_for_step", p.step_draws, "tick"),
        "draw_for_step": p.draws("draw_for_step", p.step_draws),
        "golden_step": p.golden_step(),
        "start_over": p.start_over(),
        "begun": p.over_slots(
            "begun", "E[i] = uint32_choose(flag[i], 0, E[i])", "N[i] = uint8_choose(flag[i], 0, N[i])"
        ),
        "hide": p.over_slots(
            "hide", "T[i] = uint8_choose(resetting[i], 0, flag[i])", "flag[i] = resetting[i]"
        ),
        "flag_terminated": p.over_slots("flag_terminated", "flag[i] = T[i]"),
        "terminated": p.over_slots("terminated", "T[i] = flag[i]"),
        "truncated": p.over_slots(
            "truncated",
            "e = uint32_choose(resetting[i], 0, uint32_add(E[i], 1))",
            "late = uint32_at_least(e, limit)",
            "E[i] = e",
            "U[i] = late",
            "flag[i] = uint8_or(flag[i], late)",
        ),
        "not_truncated": p.over_slots("not_truncated", "U[i] = np.uint8(0)"),
        "ending": p.over_slots("ending", "N[i] = flag[i]"),
        "no_reward": p.over_slots("no_reward", "R[i] = float32_choose(resetting[i], np.float32(0), R[i])"),
        "delivered_ends": p.over_slots(
            "delivered_ends",
            "T[i] = uint8_and(ter[i], 1)",
            "U[i] = uint8_right(ter[i], 1)",
            "flag[i] = ter[i]",
        ),
        "rewards": p.rewards(),
        "observe": p.observed(),
        "restart": p.restart(),
        "start_delivered": p.start_delivered(),
        "deliver": p.delivered("deliver_all", "given_{}[i]"),
        "deliver_block": p.delivered("deliver_block", "part_{}[i]"),
        "compiled": p.compiled(),
    }
    spaces = p.spaces()
    parts["allocate"] = [f"{name} = allocate({count})" for name, count in spaces.items()]
    parts["release"] = [f"release({name})" for name in spaces]
    parts["functions"] = [line for lines in p.functions.values() for line in lines]
    words = {
        "NAME": spec.name,
        "BLOCK": str(size),
        "FLAG_WORDS": str(size // 8),
        "PADDED": p.padded,
        "CODES": part("code_words", spec.reward.dtype),
        "FEW": str(p.few),
        "GIVEN": ", ".join(given),
        "FIRST_GIVEN": given[0],
    }
    return pieces.filled(TEMPLATE, words, parts)
