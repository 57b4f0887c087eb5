"""What the tests of environments in fixed point share."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest

from pearl_marl.spec import EnvSpec, Field

Array = npt.NDArray[Any]


def words(generator: np.random.Generator, field: Field, low: float, high: float, n: int) -> Array:
    """Return uniform words of a field whose values are from ``low`` to ``high``."""
    scale = 2.0**field.fraction
    least, most = int(np.ceil(low * scale)), int(np.floor(high * scale))
    return generator.integers(least, most, size=n, endpoint=True).astype(field.dtype)


def values(word: Array, field: Field) -> Array:
    """Return what words stand for, exactly: float64 has 53 bits for their 32."""
    return word * 2.0**-field.fraction


def worst(name: str, ours: Array, theirs: Array) -> float:
    """Return the greatest difference, and print it: ``pytest -rP`` shows that."""
    error = float(np.abs(ours - theirs).max())
    print(f"{name}: {error:.2e} at worst of {len(ours):,}")
    return error


def drawing(spec: EnvSpec, mode: str = "rgb_array") -> Any:
    """Return Gymnasium's environment of the same name and options, which draws; skip where it cannot."""
    pytest.importorskip("pygame", reason="Gymnasium draws with pygame")
    assert spec.oracle is not None
    env = gymnasium.make(spec.oracle, render_mode=mode, **spec.options)
    env.reset(seed=0)
    return env
