"""Whether words of slots can have come of steps: the checks of a saved state of others, column by column."""

from __future__ import annotations

import math

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode

from pearl_marl.base.arrays import Array
from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.errors import SavedStateError
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import arrays
from pearl_marl.golden.tracing.operations import word_range
from pearl_marl.golden.tracing.trace import trace
from pearl_marl.spec import MAX_CYCLES, EnvSpec
from pearl_marl.spec.elements import are_numbers, bounds

_AT_ONCE = 1 << 16
"""Slots whose observations are made at once: as exact integers they take several times the memory."""


def check_words(config: BatchConfig, slots: SlotMemory) -> None:
    """Raise SavedStateError where a word of the state is wider than its field."""
    for field, column in zip(config.spec.state, slots.state, strict=True):
        low, high = field.range
        if (low, high) != word_range(8 * field.dtype.itemsize, field.signed):
            _check_range(config, f"the state {field.name}", column, low, high)


def check_counters(config: BatchConfig, slots: SlotMemory) -> None:
    """Raise SavedStateError where elapsed steps or flags of ends are none that a step leaves."""
    # A time limit that was lowered under way may be behind: the next step then truncates.
    _check_range(config, "elapsed", slots.elapsed, 0, MAX_CYCLES - 1 if config.limit else 0)
    ended, agents = slots.ended, config.spec.agents
    if agents == 1:
        # Where slots begin anew at once, none is left ended.
        _check_range(config, "ended", ended, 0, int(config.autoreset_mode is AutoresetMode.NEXT_STEP))
        return
    every_agent = (1 << agents + 1) - 2
    _check_range(config, "ended", ended, 0, every_agent | 1)
    resetting = (ended & 1).astype(np.bool_)
    if config.autoreset_mode is not AutoresetMode.NEXT_STEP:
        _check_none(config, "ended", ended, resetting)
    # With its last agent the world ends, and then no agent counts as ended before it.
    _check_none(config, "ended", ended, ended & every_agent == every_agent)
    _check_none(config, "ended", ended, resetting & (ended != 1))


def check_observations(config: BatchConfig, slots: SlotMemory) -> None:
    """Raise SavedStateError where a state shows an agent what its observation space does not have."""
    spec = config.spec
    limits = _bounds(spec)
    if limits is None:
        return
    for k, agent in enumerate(spec.views):
        graph = Graph()
        inputs = [graph.input(f.name, f.bits, f.signed, *f.range) for f in spec.state]
        seen = trace(graph, spec.positional.observe, inputs, *agent)
        # Most observations cannot be wrong, whatever the state.
        due = [
            (field, node, ends)
            for field, node, ends in zip(spec.observation, seen, limits, strict=True)
            if node.low < ends[0] or node.high > ends[1]
        ]
        for first in range(0, config.n_envs, _AT_ONCE) if due else ():
            some = slice(first, first + _AT_ONCE)
            state = {f.name: column[some] for f, column in zip(spec.state, slots.state, strict=True)}
            found = arrays([node for _, node, _ in due], state)
            for (field, _, (low, high)), words in zip(due, found, strict=True):
                wrong = (words < low) | (words > high)
                if spec.agents > 1:
                    wrong &= ~slots.ended_early[some, k]
                if np.any(wrong):
                    unit = 2.0**-field.fraction if field.fraction else 1
                    word = int(np.asarray(words)[wrong][0])
                    raise SavedStateError(
                        f"the saved state shows an agent the {field.name} {word * unit}; "
                        f"{spec.name} has {low * unit} to {high * unit}"
                    )


def _bounds(spec: EnvSpec) -> list[tuple[int, int]] | None:
    """Return between what the words of an observation are, if they are its elements, one by one."""
    space = spec.observation_space
    limits = [field.range for field in spec.observation]
    if spec.unpack is not None or not (isinstance(space, Box) or are_numbers(space)):
        return None
    found = []
    ends = zip(*(end.ravel().tolist() for end in bounds(space)), strict=True)
    for (least, most), (low, high), field in zip(limits, ends, spec.observation, strict=True):
        unit = 1 << field.fraction
        found.append(
            (
                max(least, math.ceil(low * unit)) if low > -math.inf else least,
                min(most, math.floor(high * unit)) if high < math.inf else most,
            )
        )
    return found


def _check_range(config: BatchConfig, name: str, column: Array, low: int, high: int) -> None:
    for value in (int(column.min()), int(column.max())):
        if not low <= value <= high:
            slot = config.first_slot + int((column == value).argmax())
            raise SavedStateError(
                f"slot {slot} of the saved state has {name} = {value}, and possible are {low} to {high}"
            )


def _check_none(config: BatchConfig, name: str, column: Array, wrong: Array) -> None:
    if wrong.any():
        at = int(wrong.argmax())
        raise SavedStateError(
            f"slot {config.first_slot + at} of the saved state has {name} = {int(column[at])}, which no step "
            f"of {config.autoreset_mode.value} mode leaves"
        )
