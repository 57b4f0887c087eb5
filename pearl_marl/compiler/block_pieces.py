"""The pieces of the CPU's kernels: loops over blocks of slots, whose state is worked on where it lies.

All that has no branches is in functions of its own, which :mod:`~pearl_marl.compiler.llvm_functions` inlines.
Numba is left with what is between them.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from pearl_marl import rng
from pearl_marl.batch import slot_memory
from pearl_marl.compiler import flag_pieces, pieces
from pearl_marl.compiler.pieces import Pieces, assign, call, cell_dtype, each, indented, start, times
from pearl_marl.spec import EnvSpec

BLOCK = 1024
"""Slots of a block: what its loops touch then fits a 32 KiB L1 cache. A multiple of 64, and at most 2040: the
template counts flags in bytes."""

LARGE = 64
"""Elements above which an observation is large."""

CROWDED = 512
"""Words that a world's agents are shown, above which each agent is observed by a function of its own: LLVM's
work on a function grows faster than its length. And a slot that starts is then observed by the same functions
as all slots are, rather than by others that have to be compiled, too."""

KNOWN = re.compile(
    r"np|u32|range|draw|key|initial|golden_step|(?:observe|find_masks)(?:_\d+)?|"
    r"u?int\d+_[a-z_]+|float\d+_[a-z_]+|[A-Z]+_\w+"
)
"""Names in the lines of a function that are no variables of the kernel."""

COMPILED = {"unpack", "begin", "show"}
"""Functions that Numba compiles. What calls one stays with Numba, too."""


def each_slot(*lines: str, rows: int = 1) -> list[str]:
    """Return a loop over the slots of a block, or over their rows where each has several."""
    return [f"for i in range({times(rows, 'm')}):", *indented(lines)]


def part(array: str, dtype: np.dtype[Any] | str, size: int = 1) -> str:
    """Return what belongs to the block of an array that has ``size`` elements a slot."""
    return f"{dtype}_column({array}, 0, {times(size, 'b')})"


class BlockPieces(Pieces):
    """The pieces of loops over a block ``b``, of which a slot is ``i``."""

    size = BLOCK

    def __init__(self, spec: EnvSpec, counter: str) -> None:
        own, agents, masks = spec.observation_size, spec.agents, len(spec.mask_fields)

        def patterns(agents: int) -> tuple[str, str, str]:
            # A constant stride: LLVM does not vectorise over one that it only knows at run time.
            size = own * agents
            element = f"O[{size} * i + {{}}]" if size > 1 else "O[i]"
            row = f"{cell_dtype(spec)}_row(O, {size} * i{{}}, {own})"
            return element, row, f"M[{agents * masks} * i + {{}}]"

        super().__init__(spec, *patterns(agents))
        # The same of single agents, whatever slot they are in.
        self.alone = Pieces(spec, *patterns(1))
        self.whole, element = own * agents, self.element
        self.table = "rates"
        self.flat = spec.unpack is None
        kept = each("F" + element[1:], range(len(spec.observation)))
        self.copy_one = assign(kept, each(element, range(len(spec.observation))))
        self.crowded = agents * len(self.seen) > CROWDED
        # From about so many on, fewer where a start takes draws, SIMD code for all slots is faster. Not with
        # large observations, of which all would be made anew, nor those of agents that have ended.
        self.listed = not self.flat or agents > 1 or self.whole > LARGE
        self.few = self.size // (16 + 3 * spec.reset_draws)
        if self.listed:
            self.copy_one = [f"{self.dtype}_copy(F, O, {self.whole} * i, {self.whole})"]
        *self.fields, _, self.ended = slot_memory.columns(spec)
        self.counter = counter
        # What a slot that starts over has to forget.
        self.forget_one = [f"E[i] = np.{counter}(0)"]
        self.forget = [f"E[i] = {counter}_choose(flag[i], 0, E[i])"]
        if agents > 1:
            self.forget_one.append(f"N[i] = np.{self.ended.dtype}(0)")
            self.forget.append(f"N[i] = {self.ended.dtype}_choose(flag[i], 0, N[i])")
        self.block = each("block_{}[i]", self.state)
        self.take = assign(self.new, each("stored_{}[i]", self.state))
        self.functions: dict[str, list[str]] = {}
        self._taken, draws = 0, self.step_draws.stop
        self.runs = flag_pieces.runs(spec)
        self.places = {
            "E": part("elapsed", counter),
            "N": self.column("memory", self.ended),
            "O": part("observations", self.dtype, self.whole),
            "F": part("final_observations", self.dtype, self.whole),
            "A": part("actions", spec.action_dtype, agents * len(spec.action_fields)),
            "R": part("rewards", "float32", agents),
            "T": part("terminations", "uint8", agents),
            "U": part("truncations", "uint8", agents),
            "M": part("action_masks", "int8", agents * masks),
            "L": part("alive", "uint8", agents),
            "rates": "float32_column(table, 0, 0)",
            "keys": self.space("uint32", 2 * draws),
            **{f"draw_{d}": f"uint32_column(draws, 0, {self.size * d})" for d in range(draws)},
            "all_draws": "uint32_column(draws, 0, 0)",
            **self.words(),
            **{f"part_{f.name}": part(f"given_{f.name}", f.dtype, agents) for f in spec.seen},
            **{
                f"run_{k}_{r}": self.space(spec.seen[run.word].dtype, self.size)
                for k in range(agents)
                for r, run in enumerate(self.runs)
            },
        }
        """Where words lie, by name; a function is given what that takes."""

    def words(self) -> dict[str, str]:
        """Return where the words of the state lie."""
        return {
            f"{prefix}_{field.name}": self.column(memory, field)
            for prefix, memory in (("block", "memory"), ("stored", "stored"))
            for field in self.fields
        }

    def column(self, memory: str, column: slot_memory.Column) -> str:
        """Return what belongs to the block of a column."""
        return f"{column.dtype}_column({memory}, p * {column.bytes_before}, b)"

    def space(self, dtype: np.dtype[Any] | str, words: int) -> str:
        """Return where so many words lie in the scratch space; nothing else does."""
        begin = self._taken
        self._taken += slot_memory.padded(words * np.dtype(dtype).itemsize)
        return f"{dtype}_column(space, {begin}, 0)"

    def spaces(self) -> dict[str, int]:
        """Return the bytes of each scratch space.

        Words that one loop works on, and that are not of one width, are in spaces of their own: LLVM does not
        find out by itself that they are apart, and gives up a loop of too many words that might not be.
        """
        draws = {"draws": 4 * self.size * self.step_draws.stop} if self.step_draws.stop else {}
        return {"space": self._taken} | draws

    def apart(self, name: str, lines: Sequence[str], results: Sequence[str] = ()) -> list[str]:
        """Return the call of a function that does what some lines do, and gives the results that are named.

        It begins with where the words lie that the lines name, and takes what else they name.
        """
        nodes = [node for node in ast.walk(ast.parse("\n".join(lines))) if isinstance(node, ast.Name)]
        names = {node.id for node in nodes if isinstance(node.ctx, ast.Load)}
        found = []
        for place, where in reversed(self.places.items()):
            if place in names:
                found.append(f"{place} = {where}")
                names |= set(re.findall(r"[A-Za-z_]\w*", where))
        whole = [*reversed(found), *lines]
        if names & COMPILED:
            return whole
        own = {node.id for node in nodes if isinstance(node.ctx, ast.Store)} | set(self.places)
        given = ", ".join(sorted(name for name in names - own if not KNOWN.fullmatch(name)))
        if results:
            whole.append(f"return {', '.join(results)}")
        function = ["", "", "@inlined", f"def {name}({given}):", *indented(whole)]
        if self.functions.setdefault(name, function) != function:
            raise ValueError(f"two functions are called {name}")
        assigned = f"{', '.join(results)} = " if results else ""
        return [f"{assigned}{name}({given})"]

    def over_slots(self, name: str, *lines: str) -> list[str]:
        """Return the call of a function that is a loop over the slots of a block."""
        return self.apart(name, each_slot(*lines))

    def over_agents(self, name: str, *lines: str) -> list[str]:
        """Return the call of a function that is a loop over the agents of a block."""
        return self.apart(name, each_slot(*lines, rows=self.agents))

    def compiled(self) -> list[str]:
        """Return the functions that are not loops over slots."""
        return []

    def columns(self) -> dict[str, list[str]]:
        """Return what finds a block's state, and stores it."""
        return {"load_block": [], "load_stored": [], "store_block": []}

    def keys(self, name: str, draws: range, tick: str) -> list[str]:
        """Return what makes the keys of some draws, which are the same for all slots."""
        if not draws:
            return []
        chains = enumerate((rng.CHAIN_A, rng.CHAIN_B))
        made = (f"keys[2 * d + {k}] = {pieces.key(chain, tick, 'd')}" for k, chain in chains)
        return self.apart(name, [f"for d in range({draws.start}, {draws.stop}):", *indented(made)])

    def draws(self, name: str, draws: range) -> list[str]:
        """Return what makes some draws of all slots of a block."""
        if not draws:
            return []
        lines = [
            f"for d in range({draws.start}, {draws.stop}):",
            "    key_a = keys[2 * d]",
            "    key_b = keys[2 * d + 1]",
            "    for i in range(m):",
            f"        all_draws[{self.size} * d + i] = draw(u32(slot_0 + i), key_a, key_b)",
        ]
        return self.apart(name, lines)

    def draw_one(self) -> list[str]:
        """Return what makes the draws that start a single slot."""
        keys = ((d, f"keys[{2 * d}], keys[{2 * d + 1}]") for d in self.reset_draws)
        return [f"d{d} = draw(u32(slot_0 + i), {pair})" for d, pair in keys]

    def start_over(self) -> list[str]:
        """Return what starts an episode in the slots of the block that are flagged."""
        initial = call("initial", each("draw_{}[i]", self.reset_draws), self.new)
        stored = self.over_slots("start_stored", *self.chosen(*self.take))
        fresh = self.over_slots("start_fresh", *self.chosen(initial))
        return start(stored, [*self.draws("draw_for_start", self.reset_draws), *fresh])

    def chosen(self, *sources: str) -> list[str]:
        """Return what stores new words where a slot is flagged."""
        # No `if`: LLVM would move the start into its branch, and the loop would stay scalar.
        chosen = (
            f"{f.dtype}_choose(c, {new}, {old})"
            for f, new, old in zip(self.spec.state, self.new, self.block, strict=True)
        )
        return ["c = flag[i]", *sources, *assign(self.block, chosen)]

    def start_one(self) -> list[str]:
        """Return what starts an episode in a single slot, and stores nothing."""
        lines = [*self.draw_one(), call("initial", each("d{}", self.reset_draws), self.new)]
        return start(self.apart("take_start", self.take, self.new), self.apart("make_start", lines, self.new))

    def store_one(self) -> list[str]:
        """Return what stores the start of a single slot."""
        return self.apart("store_start", [*assign(self.block, self.narrow), *self.forget_one])

    def observed(self) -> list[str]:
        """Return what observes all slots of a block."""
        return self.seen_in(self.block)

    def seen_in(self, state: Sequence[str]) -> list[str]:
        """Return what observes all slots of a block in a state."""
        return ["first = 0", "end = m", *self.see(state)]

    def see(self, state: Sequence[str]) -> list[str]:
        """Return what observes the slots from ``first`` to before ``end``."""
        if self.crowded:
            return [line for k in range(self.agents) for line in self.see_agents(f"agent_{k}", [k], state)]
        return self.see_agents("all", range(self.agents), state)

    def see_agents(self, name: str, agents: Iterable[int], state: Sequence[str]) -> list[str]:
        """Return what observes some agents of these slots."""
        packing, writing, single = [], [], []
        only_masks = all(run.array == "M" for run in self.runs)
        widths = {"O": self.spec.observation_size, "M": len(self.spec.mask_fields)}
        dtypes = {"O": self.dtype, "M": np.dtype(np.int8)}
        observed = each("observed_{}", self.seen)
        for k in agents:
            packing += [*([] if only_masks else self.look(state, k)), *self.judge(state, k)]
            for r, run in enumerate(self.runs):
                word, width = f"run_{k}_{r}[i]", widths[run.array]
                at = f"{self.agents * width} * i + {k * width + run.at}"
                field = self.spec.seen[run.word]
                packing.append(f"{word} = {flag_pieces.packed(run, str(field.dtype), observed)}")
                if run.size > 1:
                    writing.append(f"{dtypes[run.array]}_flags({run.array}, {at}, {word}, {run.size})")
                else:
                    writing.append(f"{run.array}[{at}] = {pieces.element(word, field, dtypes[run.array])}")
            if only_masks:
                single += [*self.look(state, k), *self.deliver(observed, k)]
        loops = {"pack": packing, "write": writing, "observe": single}
        turns = "for i in range(first, end):"
        return [
            line
            for verb, lines in loops.items()
            if lines
            for line in self.apart(f"{verb}_{name}", [turns, *indented(lines)])
        ]

    def observed_start(self) -> list[str]:
        """Return what observes a slot that has just started."""
        return self.apart("observe_start", self.observe(self.new))

    def restart(self) -> list[str]:
        """Return what starts over the slots that ended: one by one where they are few, else all at once."""
        keep = self.apart("keep_last", self.copy_one)
        one = [*keep, *self.start_one(), *self.store_one(), *self.observed_start()]
        number = "i = np.int64(ended_slots[j])"
        listed = [
            "count = 0",
            f"for w in range({self.size // 8}):",
            "    if flag_words[w]:",
            "        for i in range(8 * w, 8 * w + 8):",
            "            ended_slots[count] = i",
            "            count += flag[i]",
        ]
        if self.listed:
            fetch = self.apart("fetch_last", [f"{self.dtype}_prefetch(F, {self.whole} * i, {self.whole})"])
            listed += ["for j in range(count):", *indented([number, *fetch])]
        listed += ["for j in range(count):", *indented([number, *one])]
        if self.listed:
            return listed
        at_once = [
            *self.over_slots("keep_all_last", *self.copy_one),
            *self.start_over(),
            *self.over_slots("reset_elapsed", *self.forget),
            *self.observed(),
        ]
        return [f"if ended < {self.few}:", *indented(listed), "else:", *indented(at_once)]

    def start_delivered(self) -> list[str]:
        """Return what starts a single slot and observes it, after another device has ended it."""
        return [*self.apart("keep_last", self.copy_one), *self.start_one(), *self.observed_start()]

    def delivered(self, name: str, words: Sequence[str], agents: int) -> list[str]:
        """Return what turns the words of observations into the observations themselves, a row an agent."""
        return self.apart(name, each_slot(*self.alone.deliver(words), *self.alone.masks(words), rows=agents))

    def golden_step(self) -> list[str]:
        """Return the loop over the golden step."""
        return self.stepped(self.block, self.new)

    def stepped(self, sources: Sequence[str], results: Sequence[str]) -> list[str]:
        """Return the loop over the golden step, from words of the state to words of the next one."""
        outcome = [*self.each_agent("r"), *self.each_agent("t")]
        given = [*sources, *self.actions("A"), *each("draw_{}[i]", self.step_draws)]
        step = call("golden_step", given, [*self.new, *outcome])
        targets = [*self.block, *self.of_agents("code"), *self.of_agents("T")]
        return self.over_slots("step_all", step, *assign(targets, [*results, *outcome]))

    def rewards(self) -> list[str]:
        """Return what makes rewards of their codes."""
        if self.categories > 8 or not self.categories:
            return self.over_agents("reward_all", f"R[i] = {self.reward('code[i]', 'code[i]')}")
        # A chain of blends; beyond that a gather costs less.
        dtype, others = self.spec.reward.dtype, range(1, self.categories)
        chain = (f"r = float32_choose({dtype}_equal(code[i], {k}), reward_{k}, r)" for k in others)
        lookups = (f"reward_{k} = rates[{k}]" for k in range(self.categories))
        loop = each_slot("r = reward_0", *chain, "R[i] = r", rows=self.agents)
        return self.apart("reward_all", [*lookups, *loop])
