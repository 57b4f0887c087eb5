"""The former place of :mod:`pearl_marl.golden.rng`, for one version."""

import warnings

from pearl_marl.golden.rng import draw, draws, key

__all__ = ["draw", "draws", "key"]

warnings.warn("pearl_marl.rng is deprecated: use pearl_marl.golden.rng", DeprecationWarning, stacklevel=2)
