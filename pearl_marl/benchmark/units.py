"""Rates and durations as people read them."""

from __future__ import annotations


def rate(steps_per_second: float) -> str:
    """Return steps per second as people read them: ``2.71 G``."""
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if steps_per_second >= factor:
            return f"{steps_per_second / factor:.3g} {prefix}"
    return f"{steps_per_second:.3g}"


def duration(seconds: float) -> str:
    """Return a duration as people read it: ``17.3 us``."""
    for factor, unit in ((1.0, "s"), (1e-3, "ms")):
        if seconds >= factor:
            return f"{seconds / factor:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} us"
