"""What the options of Pursuit come to: the map, and the rewards."""

from __future__ import annotations

from typing import NamedTuple

from pearl_marl.golden import Word


class PursuitRules(NamedTuple):
    """The options that the dynamics depend on; the package's names."""

    x_size: int
    y_size: int
    n_pursuers: int
    n_evaders: int
    obs_range: int
    n_catch: int
    surround: bool
    freeze_evaders: bool
    shared_reward: bool

    @property
    def building(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """The first and the last x, and the first and the last y, of the building."""
        xs = [x for x in range(self.x_size) if 0.3 < x / self.x_size < 1 - 0.3]
        ys = [y for y in range(self.y_size) if 0.2 < y / self.y_size < 1 - 0.2]
        return (xs[0], xs[-1]), (ys[0], ys[-1])

    @property
    def open_cells(self) -> int:
        """How many cells the building leaves."""
        (left, right), (top, bottom) = self.building
        return self.x_size * self.y_size - (right - left + 1) * (bottom - top + 1)

    @property
    def sharers(self) -> int:
        """How many pursuers a reward is for."""
        return self.n_pursuers if self.shared_reward else 1

    @property
    def most_tags(self) -> int:
        """A bound of the tags of a step: by each move an evader counts once or twice."""
        return 3 * self.n_evaders * self.n_pursuers * self.sharers

    @property
    def categories(self) -> int:
        """How many rewards there are."""
        return (self.most_tags + 1) * (self.sharers + 1)

    def blocked(self, x: Word, y: Word) -> Word:
        """Return whether a cell is part of the building."""
        (left, right), (top, bottom) = self.building
        return left <= x <= right and top <= y <= bottom

    def category(self, tags: Word, catches: Word) -> Word:
        """Return the reward's place in the table."""
        return tags * (self.sharers + 1) + catches

    def rewards(self, tag: float, catch: float, urgency: float) -> tuple[float, ...]:
        """Return the table: each pursuer's tags, by each of the moves, count for a share of them all."""
        share = tag / (self.n_pursuers * self.sharers)
        return tuple(
            share * tags + catch / self.sharers * catches + urgency
            for tags in range(self.most_tags + 1)
            for catches in range(self.sharers + 1)
        )
