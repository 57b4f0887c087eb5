"""Seaquest against MinAtar's: the same decisions given to both, then every word of every step."""

from __future__ import annotations

from typing import Any

from pearl_marl.envs.seaquest.spec import STATE, minatar_attributes

import pearl_marl
from pearl_marl.golden import call_reference

ACTIONS = 6
CHANCE = (1 << 28) - 1
NAMES = [field.name for field in STATE]
ATTRIBUTES = tuple(
    minatar_attributes(tuple(call_reference(pearl_marl.get_spec("Seaquest").golden.initial, ())))
)


class Decisions:
    """Stands for the ``RandomState`` of MinAtar's game and environment, and gives out what we have drawn."""

    def __init__(self) -> None:
        self.queue: list[float] = []

    def rand(self) -> float:
        return self.queue.pop(0)

    def randint(self, low: int, high: int) -> int:
        value = self.queue.pop(0)
        assert low <= value < high
        return int(value)

    def expect(self, game: Any, draw_0: int, draw_1: int, sticky: float) -> None:
        """Line up the decisions of a step, in the order in which MinAtar asks for them."""
        assert not self.queue
        self.queue.append((draw_1 & CHANCE) / 2**28)
        if game.e_spawn_timer == 0:
            self.queue += [0.0 if draw_0 >> 31 else 0.5, (draw_0 & CHANCE) / 2**28, 1 + (draw_0 >> 28 & 7)]
        if game.d_spawn_timer == 0:
            self.queue += [0.0 if draw_1 >> 31 else 0.5, 1 + (draw_1 >> 28 & 7)]
