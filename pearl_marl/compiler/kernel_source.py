"""The source of the CPU's kernels: short loops over blocks of slots, around the golden functions."""

from __future__ import annotations

import numpy as np

from pearl_marl import rng
from pearl_marl.batch import slot_memory
from pearl_marl.compiler import pieces
from pearl_marl.compiler.kernel_template import TEMPLATE
from pearl_marl.compiler.pieces import Pieces, assign, call, each, indented, narrowed, start
from pearl_marl.spec import EnvSpec, Field

BLOCK = 2048
"""Slots of a block: what a loop touches then fits a 32 KiB L1 cache. A multiple of 64."""

CROWD = 16
"""Arrays in the loop over the golden step from which on they are copied into one. Of more than a few arrays
LLVM does not check whether they overlap, and leaves the loop scalar; parts of one array it can tell apart."""

CROWDED_BLOCK = 512
"""Slots of a block where there is such a crowd; divides :data:`BLOCK`. Seaquest steps 40 M slots/s like this,
with its 44 arrays as they are 6 M."""

DRAW = "draw(u32(slot_0 + i), key_a{0}, key_b{0})"


def kernel_source(spec: EnvSpec) -> str:
    """Return the source of the kernels of ``spec``, for :mod:`pearl_marl.compiler.kernels` to load."""
    p = _BlockPieces(spec)
    given = each("given_{}", p.observation)
    words = {
        "NAME": spec.name,
        "BLOCK": str(p.size),
        "REWARD_DTYPE": str(spec.reward.dtype),
        "OBSERVED": p.rows("observations"),
        "FINAL": p.rows("final_observations"),
        "BLOCK_ROWS": p.block_rows,
        "FEW": str(p.few),
        "GIVEN": ", ".join(given),
        "FIRST_GIVEN": given[0],
    }
    parts = {
        **p.views(),
        **p.draws(),
        **p.rewards(),
        "golden_step": p.golden_step(),
        "start_over": p.start_over(),
        "observe": each_slot(*p.observe(p.block)),
        "restart": p.restart(),
        "copy_one": p.copy_one,
        "start_one": p.start_one(),
        "observe_one": p.observe(p.new),
        "deliver": p.deliver(each("given_{}[i]", p.observation)),
        "deliver_block": p.deliver(each("part_{}[i]", p.observation)),
    }
    return pieces.filled(TEMPLATE, words, parts)


def each_slot(*lines: str) -> list[str]:
    """Return a loop over the slots of a block."""
    return ["for i in range(m):", *indented(lines)]


def loops(lines: list[str]) -> list[str]:
    """Return such a loop for each line."""
    return [inner for line in lines for inner in each_slot(line)]


class _BlockPieces(Pieces):
    """The pieces of loops over a block ``b``, of which a slot is ``i``."""

    def __init__(self, spec: EnvSpec) -> None:
        size = spec.observation_size
        # A constant stride: LLVM does not vectorise over one that it only knows at run time.
        element = f"O[{size} * i + {{}}]" if size > 1 else "O[i]"
        super().__init__(spec, element, "O[i]")
        flat = spec.unpack is None
        self.block_rows = f"[{size} * b : {size} * (b + m)]" if flat and size > 1 else "[b : b + m]"
        kept = each("F" + element[1:], range(len(spec.observation)))
        copies = assign(kept, each(element, range(len(spec.observation))))
        self.copy_one = copies if flat else ["F[i, :] = O[i, :]"]
        # The arrays that the golden step reads, or writes if those are more, as parts of one.
        others = range(len(spec.state), len(spec.state) + max(1 + spec.step_draws, 2))
        self.lanes = each("lane_{}", [*self.state, *others])
        self.crowded = len(self.lanes) > CROWD
        widest = max(f.dtype.itemsize for f in (*spec.state, spec.action, spec.reward))
        self.lane = "uint64" if widest == 8 else "uint32"
        self.size = CROWDED_BLOCK if self.crowded else BLOCK
        # From about so many on, fewer where a start takes draws, SIMD code for all slots is faster. Not with
        # large observations, of which all would be made anew.
        self.few = self.size // (4 + 3 * spec.reset_draws) if flat else self.size + 1
        self.block = each("block_{}[i]", self.state)
        self.take = assign(self.new, each("stored_{}[b + i]", self.state))

    def rows(self, array: str) -> str:
        """Return an array of observations as a flat one, or for ``unpack`` with a row a slot."""
        rows = array + (".view(np.uint8)" if self.spec.observation_dtype == np.bool_ else "")
        if self.spec.unpack is None:
            return f"{rows}.reshape({array}.size)"
        wide = f".reshape(({array}.shape[0], {self.spec.observation_size}))"
        return rows + (wide if len(self.spec.observation_shape) > 1 else "")

    def views(self) -> dict[str, list[str]]:
        def span(memory: str, c: slot_memory.Column) -> str:
            last = c.bytes_before + c.dtype.itemsize
            return f"{memory}[p * {c.bytes_before} : p * {last}].view(np.{c.dtype})"

        *columns, elapsed, ended = slot_memory.columns(self.spec)
        state = [f"state_{c.name} = {span('memory', c)}" for c in columns]
        stored = [f"stored_{c.name} = {span('stored', c)}" for c in columns]
        others = [f"{c.name} = {span('memory', c)}" for c in (elapsed, ended)]
        block = each("block_{0} = state_{0}[b : b + m]", self.state)
        return {
            "views": [self.padded, *state, *others, *stored],
            "views_of_stored": [self.padded, *stored],
            "views_of_state": [self.padded, *state],
            "block_views": block,
            "part_views": each("part_{0} = given_{0}[b : b + m]", self.observation),
        }

    def draws(self) -> dict[str, list[str]]:
        size, lanes = self.size, range(len(self.lanes))
        scratch = f"draw_{{}} = np.empty({size}, np.uint32)"

        def keys(draws: range, tick: str) -> list[str]:
            chains = ("a", rng.CHAIN_A), ("b", rng.CHAIN_B)
            return [f"key_{side}{d} = {pieces.key(chain, tick, d)}" for d in draws for side, chain in chains]

        views = assign(self.lanes, (f"lanes[{k * size} : {(k + 1) * size}]" for k in lanes))
        lane_views = [f"lanes = np.empty({len(lanes) * size}, np.{self.lane})", *views]
        return {
            "reset_scratch": each(scratch, self.reset_draws),
            "step_scratch": [*each(scratch, self.step_draws), *(lane_views if self.crowded else [])],
            "reset_keys_now": keys(self.reset_draws, "tick"),
            "reset_keys": keys(self.reset_draws, "reset_tick"),
            "step_keys": keys(self.step_draws, "tick"),
            "step_keys_fixed": keys(self.step_draws, "0"),
            "draw_for_step": loops(each("draw_{0}[i] = " + DRAW, self.step_draws)),
        }

    def start_over(self) -> list[str]:
        """Return what starts an episode in the slots of the block that are flagged."""
        initial = call("initial", each("draw_{}[i]", self.reset_draws), self.new)
        draws = loops(each("draw_{0}[i] = " + DRAW, self.reset_draws))
        return start(self.choose(*self.take), [*draws, *self.choose(initial)])

    def start_one(self) -> list[str]:
        """Return what starts one in a single slot, and does not store it."""
        initial = call("initial", each("d{}", self.reset_draws), self.new)
        return start(self.take, [*each("d{0} = " + DRAW, self.reset_draws), initial])

    def choose(self, *sources: str) -> list[str]:
        """Return what stores new words where a slot is flagged."""
        if self.crowded:  # a branch for each field takes long to compile, and few slots end
            return each_slot("if flag[i]:", *indented([*sources, *assign(self.block, self.narrow)]))
        chosen = (f"{word} if c else {old}" for word, old in zip(self.narrow, self.block, strict=True))
        return each_slot("c = flag[i]", *sources, *assign(self.block, chosen))

    def restart(self) -> list[str]:
        """Return what starts over the slots that ended, which are listed."""
        store = [*assign(self.block, self.narrow), "E[i] = np.uint32(0)"]
        one = [*self.copy_one, *self.start_one(), *store, *self.observe(self.new)]
        each = ["for j in range(count):", *indented(["i = np.int64(ended_slots[j])", *one])]
        if self.spec.unpack is not None:
            return each
        at_once = [*each_slot(*self.copy_one), *self.start_over()]
        at_once += each_slot("E[i] = np.uint32(0) if flag[i] else E[i]")
        at_once += each_slot(*self.observe(self.block))
        return [f"if count < {self.few}:", *indented(each), "else:", *indented(at_once)]

    def golden_step(self) -> list[str]:
        draws = each("draw_{}[i]", self.step_draws)
        sources, targets = [*self.block, "A[i]", *draws], [*self.block, "code[i]", "flag[i]"]
        results = [*self.new, "r", "t"]
        if not self.crowded:
            return each_slot(call("golden_step", sources, results), *assign(targets, results))
        # By way of one array, into and out of which words go an array at a time.
        spec, lane, lanes = self.spec, f"np.{self.lane}({{}})", each("{}[i]", self.lanes)
        inputs, outputs = lanes[: len(sources)], lanes[: len(targets)]
        read = [*spec.state, spec.action, *[Field("draw", 32)] * len(draws)]
        written = [*spec.state, spec.reward, Field("terminated", 1)]
        step = call("golden_step", narrowed(read, inputs), results)
        return [
            *loops(assign(inputs, each(lane, sources))),
            *each_slot(step, *assign(outputs, each(lane, results))),
            *loops(assign(targets, narrowed(written, outputs))),
        ]

    def rewards(self) -> dict[str, list[str]]:
        names = each("reward_{}", range(self.categories if self.categories <= 8 else 0))
        lines = [f"R[i] = {self.reward('code[i]', 'code[i]')}"]
        if names:  # a chain of blends; beyond that a gather costs less
            chain = (f"r = {name} if code[i] == {k} else r" for k, name in enumerate(names) if k)
            lines = [f"r = {names[0]}", *chain, "R[i] = r"]
        lookups = each("reward_{0} = table[{0}]", range(len(names)))
        return {"reward_names": lookups, "rewards": each_slot(*lines)}
