"""The former place of :mod:`pearl_marl.golden.reals`, for one version."""

import warnings

from pearl_marl.golden.reals import Real

__all__ = ["Real"]

warnings.warn("pearl_marl.reals is deprecated: use pearl_marl.golden.reals", DeprecationWarning, stacklevel=2)
