"""The loops of the CPU's kernels about ends: which agents have ended, and which episodes are over.

In a world of several agents each has a bit in a slot's ``end_bits``, as the column ``ended`` has them, and
another one in ``end_bits_before``, which is what it was before the step.
:mod:`~pearl_marl.compiler.kernel_loops` says what else a frame has.
"""

from __future__ import annotations

from typing import Any

from numba import types

from pearl_marl.compiler.llvm_functions import Code, Frame, Value, WordArray


class Ends:
    """The loops about ends, where the column ``ended`` has words of a type, and elapsed steps of another."""

    def __init__(self, agents: int, type_: Any, counter: Any) -> None:
        self.agents, self.type, self.counter = agents, type_, counter
        self.all = ((1 << agents) - 1) << 1
        """The bits of a slot whose agents have all ended."""

    def bit(self, end_bits: Value, agent: int) -> Value:
        """Return whether an agent has ended."""
        return (end_bits >> agent + 1).to(types.uint8) & 1

    def lives(self, end_bits: Value, agent: int) -> Value:
        """Return whether an agent has not ended."""
        return self.bit(end_bits, agent) ^ 1

    def _each(self, i: Value) -> list[Value]:
        """Return where a slot's agents have their elements."""
        return [i] if self.agents == 1 else [i * self.agents + k for k in range(self.agents)]

    def _clear_where(self, code: Code, column: WordArray, i: Value, flag: Value) -> None:
        """Set the elements of a slot's agents to 0 where a flag is set."""
        for at in self._each(i):
            column[at] = code.choose(column.type, flag, 0, column[at])

    def discard_step(self, code: Code, f: Frame) -> None:
        """Make nothing of what slots did that are resetting, and start over these."""
        for i in code.range(f.m):
            self._clear_where(code, f.terminations, i, f.resetting[i])
            if self.agents > 1:
                f.ended[i] = code.choose(self.type, f.resetting[i], 0, f.ended[i])
            f.over[i] = f.resetting[i]

    def find(self, code: Code, f: Frame) -> None:
        """Find out which agents have ended, and which episodes are over; count the steps of the others."""
        if self.agents > 1:
            code.run(self.end_agents, f)
        with code.either(f.limit) as (limited, unlimited):
            with limited, code.either(f.any_resetting) as (some, none):
                # Few steps have slots that spend them resetting.
                with some:
                    code.run(self.truncate, f, True)
                with none:
                    code.run(self.truncate, f, False)
            with unlimited:
                code.run(self.not_truncated, f)

    def end_agents(self, code: Code, f: Frame) -> None:
        """End agents that terminate; a slot is over where all have ended."""
        for i in code.range(f.m):
            end_bits = before = f.ended[i]
            f.end_bits_before[i] = before
            ends = []
            for k, at in enumerate(self._each(i)):
                f.terminations[at] = terminated = f.terminations[at] & self.lives(before, k)
                ends.append(terminated)
            for k, terminated in enumerate(ends):
                end_bits = end_bits | (terminated.to(self.type) << k + 1)
            f.end_bits[i] = end_bits
            f.ended[i] = end_bits
            f.over[i] = end_bits.equals(self.all)

    def truncate(self, code: Code, f: Frame, some_reset: bool) -> None:
        """Count a step, and end episodes by the time limit."""
        for i in code.range(f.m):
            elapsed = f.elapsed[i] + 1
            if some_reset:
                elapsed = code.choose(self.counter, f.resetting[i], 0, elapsed)
            late = elapsed >= f.limit
            f.elapsed[i] = elapsed
            if self.agents == 1:
                f.truncations[i] = late
                f.over[i] = f.terminations[i] | late
                continue
            for k, at in enumerate(self._each(i)):
                f.truncations[at] = late & self.lives(f.end_bits_before[i], k)
            f.over[i] = f.over[i] | late

    def not_truncated(self, code: Code, f: Frame) -> None:
        """Truncate nothing, as there is no time limit."""
        for i in code.range(f.m * self.agents):
            f.truncations[i] = 0
            if self.agents == 1:
                f.over[i] = f.terminations[i]

    def take_delivered(self, code: Code, f: Frame) -> None:
        """Find out from another device's words which agents have ended, and which episodes are over."""
        for i in code.range(f.m):
            word = f.end_words[i]
            if self.agents == 1:
                f.terminations[i] = word.to(types.uint8) & 1
                f.truncations[i] = word.to(types.uint8) >> 1
                f.over[i] = word
                continue
            before = f.end_bits_before[i]
            late = (word >> self.agents).to(types.uint8) & 1
            for k, at in enumerate(self._each(i)):
                f.terminations[at] = (word >> k).to(types.uint8) & self.lives(before, k)
                f.truncations[at] = late & self.lives(before, k)
            f.end_bits[i] = end_bits = word << 1 & self.all
            f.over[i] = late | end_bits.equals(self.all)

    def mark_over(self, code: Code, f: Frame) -> None:
        """Note which slots spend their next step on a reset."""
        for i in code.range(f.m):
            over = f.over[i]
            f.ended[i] = over if self.agents == 1 else code.choose(self.type, over, 1, f.ended[i])

    def no_reward(self, code: Code, f: Frame) -> None:
        """Reward nothing where a slot is resetting."""
        for i in code.range(f.m):
            self._clear_where(code, f.rewards, i, f.resetting[i])

    # Of several agents.

    def bits_at_reset(self, code: Code, f: Frame) -> None:
        """Find out which agents have ended, at a reset."""
        for i in code.range(f.m):
            f.end_bits[i] = f.ended[i] & self.all

    def blank_rewards(self, code: Code, f: Frame) -> None:
        """Reward nothing to agents that ended before the step."""
        for i in code.range(f.m):
            for k, at in enumerate(self._each(i)):
                has_ended = self.bit(f.end_bits_before[i], k)
                f.rewards[at] = code.choose(types.float32, has_ended, 0, f.rewards[at])

    def show_alive(self, code: Code, f: Frame) -> None:
        """Show which agents are in an episode."""
        for i in code.range(f.m):
            self._show(f, i)

    def _show(self, f: Frame, i: Value) -> None:
        for k, at in enumerate(self._each(i)):
            f.alive[at] = f.over[i] | self.lives(f.end_bits[i], k)

    def find_changed(self, code: Code, f: Frame) -> None:
        """Show which agents are in an episode; find slots of which something is blanked, or is the last."""
        for i in code.range(f.m):
            self._show(f, i)
            some = f.end_bits[i].differs(0)
            f.changed[i] = code.choose(types.uint8, f.over[i], f.next_step, some)
