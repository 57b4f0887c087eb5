"""Devices that are wrong on purpose, each in one way."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pearl_marl.batch.step import Observed
from pearl_marl.devices import BatchConfig, BatchStep, Native

Array = np.ndarray[Any, Any]


class Flips(Native):
    """Flips the lowest bit of one word, in the step at one tick.

    ``field`` is one of a :class:`BatchStep` or a column of the slots' memory, whose bit is flipped
    once the step is done. ``lasting=False`` does it only once, whatever is tried again.
    """

    name = "flips"

    def __init__(self, field: str, tick: int, slot: int, lasting: bool = True, column: int = 0) -> None:
        super().__init__()
        self.flip, self.lasting, self.flips = (field, tick, slot, column), lasting, 0

    def _step(self, actions: Array) -> BatchStep:
        results = super()._step(actions)
        field, tick, slot, column = self.flip
        if self.tick == tick and (self.lasting or not self.flips):
            self.flips += 1
            if field in BatchStep._fields:
                flip_bit(getattr(results, field), slot, column)
            else:
                flip_bit(self._elapsed if field == "elapsed" else self._slots.columns[field], slot)
        return results


class FlipsStart(Native):
    """Starts one slot wrongly at every reset, full or masked."""

    name = "flips start"

    def __init__(self, slot: int) -> None:
        super().__init__()
        self.slot = slot

    def _reset(self, mask: Array | None, seed: int | None) -> Observed:
        seen = super()._reset(mask, seed)
        if mask is None or mask[self.slot]:
            flip_bit(seen.obs, self.slot)
        return seen


class Forgets(Native):
    """Loses the elapsed steps of one slot when its state is replaced."""

    name = "forgets"

    def _write(self, memory: Array, stored: Array) -> Observed:
        seen = super()._write(memory, stored)
        self._elapsed[3] ^= 1
        return seen


class OtherWidth(Native):
    """Returns observations in another dtype."""

    name = "other width"

    def _step(self, actions: Array) -> BatchStep:
        results = super()._step(actions)
        return results._replace(obs=results.obs.astype(np.int16))


class Elsewhere(Native):
    """Runs other golden functions than those of its spec: a core with a mistake in it."""

    name = "elsewhere"

    def __init__(self, golden: Any) -> None:
        super().__init__()
        self.golden = golden

    def _open(self, config: BatchConfig) -> None:
        super()._open(replace(config, spec=replace(config.spec, golden=self.golden)))


def flip_bit(array: Array, slot: int, column: int = 0) -> None:
    """Flip the lowest bit of one word, whatever its dtype."""
    words = array.view(f"u{array.itemsize}")
    words[(slot, column) if words.ndim == 2 else slot] ^= 1
