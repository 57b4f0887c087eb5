"""The source of the CPU's kernels: short loops over blocks of slots, around the golden functions."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from pearl_marl.batch.slot_memory import counter_dtype
from pearl_marl.compiler import pieces
from pearl_marl.compiler.block_pieces import BlockPieces, part
from pearl_marl.compiler.end_pieces import end_pieces
from pearl_marl.compiler.kernel_template import TEMPLATE
from pearl_marl.compiler.lane_pieces import LanePieces
from pearl_marl.compiler.pieces import each
from pearl_marl.compiler.straight_line import golden_functions
from pearl_marl.spec import EnvSpec

RESULTS = ("observations", "rewards", "terminations", "truncations", "final_observations")
ADDRESSES = ("memory", "stored", "elapsed", *RESULTS, "action_masks", "alive")
"""What the kernel ``step`` is given the addresses of; the last two are 0 where there is no such array."""

SETTINGS = (
    *("seed_0", "seed_1", "tick", "first_slot", "limit", "next_step", "use_stored", "n"),
    # Whether it is all that a step does: where actions are not in the space it does nothing, and otherwise it
    # moves the tick, too.
    "checked",
)
GIVEN = *ADDRESSES, *SETTINGS
"""What the kernel ``step`` is given in one array, in its order. Numba looks at each argument of a call, and
longest at arrays: for few slots that was most of a step."""

CROWD = 8
"""Fields above which a block's state is copied into lanes. Of more than a few arrays LLVM does not check
whether they overlap, and leaves the loop scalar; parts of one array it can tell apart. With the 10 fields of
LevelBasedForaging with one food, a golden step takes a seventh of the time in lanes."""


class _Itself(NamedTuple):
    """A spec that is the same as itself only, since not all that it has can be hashed."""

    spec: EnvSpec

    def __hash__(self) -> int:
        return id(self.spec)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Itself) and self.spec is other.spec


def kernel_source(spec: EnvSpec, counter: np.dtype[Any] | None = None) -> str:
    """Return the source of the kernels of ``spec``, for :mod:`pearl_marl.compiler.kernels` to load.

    ``counter`` is the dtype of elapsed steps; ``None`` is what the environment's own time limit takes.
    """
    return _source(_Itself(spec), str(counter or counter_dtype(spec.max_cycles or 0)))


@functools.lru_cache(maxsize=64)
def _source(itself: _Itself, counter: str) -> str:
    spec = itself.spec
    p = (LanePieces if len(spec.state) > CROWD else BlockPieces)(spec, counter)
    given, seen = each("given_{}", p.observation), each("given_{}", p.seen)
    size, ended = p.size, p.ended.dtype
    several = p.agents > 1
    shown = (" action_masks," if spec.mask_fields else "") + (" alive," if several else "")
    parts = {
        "golden_functions": golden_functions(spec),
        **p.columns(),
        "code": [f"code = {p.space(spec.reward.dtype, p.agents * size)}"],
        "flag": [f"flag = {p.space('uint8', size)}", "flag_words = uint64_column(flag, 0, 0)"],
        "ended_slots": [f"ended_slots = {p.space('uint16', size)}"],
        "resetting": [f"resetting = {p.space('uint8', size)}"],
        "ended": [f"N = {p.places['N']}"],
        "reset_keys": p.keys("keys_for_start", p.reset_draws, "tick"),
        "step_keys": p.keys("keys_for_step", p.step_draws, "tick"),
        "draw_for_step": p.draws("draw_for_step", p.step_draws),
        "golden_step": p.golden_step(),
        "start_over": p.start_over(),
        "begun": p.over_slots("begun", f"N[i] = {ended}_choose(flag[i], 0, N[i])"),
        **end_pieces(p),
        "rewards": p.rewards(),
        "observe": p.observed(),
        "restart": p.restart(),
        "start_delivered": p.start_delivered(),
        "deliver": p.delivered("deliver_all", each("given_{}[i]", p.observation), 1),
        "deliver_block": p.delivered("deliver_block", each("part_{}[i]", p.seen), p.agents),
        "compiled": p.compiled(),
    }
    spaces = p.spaces()
    parts["allocate"] = [f"{name} = allocate({count})" for name, count in spaces.items()]
    parts["release"] = [f"release({name})" for name in spaces]
    parts["functions"] = [line for lines in p.functions.values() for line in lines]
    parts["given"] = [
        f"{name} = {'address' if name in ADDRESSES else 'np.int64'}(given[{k}])"
        for k, name in enumerate(GIVEN)
    ]
    words = {
        "NAME": spec.name,
        "AGENTS": str(p.agents),
        # Numbers are checked before they become words.
        "LAST_ACTION": str(getattr(spec.action_space, "n", 0) - 1),
        "BLOCK": str(size),
        "FLAG_WORDS": str(size // 8),
        "PADDED": p.padded,
        "CODES": part("code_words", spec.reward.dtype, p.agents),
        "TERS": part("ter_words", ended),
        "OVER": "np.uint8(N[i] & 1)" if several else "N[i]",
        "GONE": " gone_words," if several else "",
        "SHOWN": shown,
        "GIVEN": ", ".join(given),
        "SEEN": ", ".join(seen),
        "FIRST_GIVEN": given[0],
        "TICK": str(GIVEN.index("tick")),
    }
    return pieces.filled(TEMPLATE, words, parts)
