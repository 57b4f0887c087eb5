"""Policies as golden functions, by hand, for environments of every kind of view and action."""

from __future__ import annotations

from typing import Any

from pearl_marl.golden import Draws


def balance(view: Any, draws: Draws) -> Any:
    """Push where the pole falls; in one step of sixteen, anywhere."""
    stumbles, anywhere = draws.below(16) == 0, draws.bits() & 1
    if stumbles:
        return anywhere
    return view.angle + view.angular_velocity > 0


def swing(view: Any, draws: Draws) -> Any:
    """With a real: pump with the speed of the second link."""
    if view.dtheta2 * 0.5 + view.angles[1] > 0.25:
        return 2
    return 0 if view.dtheta2 < 0 else 1


def drive(view: Any, draws: Draws) -> Any:
    """A level of a Box, which is a real."""
    return 0.75 if view.velocity > 0 else -1.0


def brake(view: Any, draws: Draws) -> Any:
    """A level in fixed point, as the environment is written."""
    return -(1 << 29) if view.speed > 0 else 3 << 27


def walk(place: Any, draws: Draws) -> Any:
    """Of a word alone."""
    if place == 36:
        return 0
    return 2 if place % 12 == 11 else 1


def catch(view: Any, draws: Draws) -> Any:
    """Of the words behind planes."""
    return 1 + (view.ball_x > view.paddle_x) - (view.ball_x < view.paddle_x)


def up(view: Any, draws: Draws) -> Any:
    """What masks may forbid."""
    return draws.below(2)


def bet(words: Any, draws: Draws) -> Any:
    """Of several words, for both players."""
    return words[0] & 1
