"""Observations as the words that an environment makes them of: a row of bytes instead of planes.

Seaquest's ten planes of 100 elements are 69 bytes like this, ConnectFour's two boards 16. Keep or
send many of them packed, and unpack those at hand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial, update_wrapper
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from pearl_marl.base.arrays import Array
from pearl_marl.checks import checked_choice
from pearl_marl.compiler.kernels import compile_kernels
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import GoldenFunction
from pearl_marl.spec import EnvSpec, check_spec

FORMS = ("whole", "packed")
"""How observations are delivered."""


def observed_as(spec: EnvSpec, observations: str) -> EnvSpec:
    """Return a spec whose observations are in one of :data:`FORMS`."""
    checked_choice("observations", observations, FORMS)
    return packed(spec) if observations == "packed" else spec


def row_dtype(spec: EnvSpec) -> np.dtype[Any]:
    """Return the layout of a packed row: the words of the observation one after the other, little-endian."""
    return np.dtype([(field.name, field.dtype.newbyteorder("<")) for field in spec.observation])


def packed(spec: EnvSpec) -> EnvSpec:
    """Return the same environment with packed observations, ``uint8``.

    Raises
    ------
    ArgumentError
        Its observations are numbers, which are no larger than the words.
    """
    if spec.unpack is None:
        raise ArgumentError(
            f"observations is 'packed', and only planes can be, which {spec.name}'s are not: leave it out"
        )
    space = Box(0, 255, (row_dtype(spec).itemsize,), np.uint8)
    roles = tuple(role._replace(observation_space=space) for role in spec.roles)
    whole = spec.configure
    # A spec is pickled as what made it.
    made = partial(packed, spec) if whole is None else update_wrapper(partial(_packed, whole), whole)
    return replace(
        spec,
        golden=spec.golden._replace(view=None),  # words are written as they are
        observation_space=space,
        unpack=_packer(row_dtype(spec)),
        roles=roles,
        configure=made,
    )


def _packed(configure: Callable[..., EnvSpec], **options: Any) -> EnvSpec:
    return packed(configure(**options))


@cache
def _packer(layout: np.dtype[Any]) -> GoldenFunction:
    """Return what writes the words of an observation into a row, as ``unpack`` of a spec does."""
    lines: list[str] = []
    for name, (word, start, *_) in (layout.fields or {}).items():
        shifted = (f"int(word_{name}) >> {8 * byte} & 255" for byte in range(word.itemsize))
        lines += (f"    row[{place}] = {text}" for place, text in enumerate(shifted, start))
    names = ", ".join(f"word_{name}" for name in layout.names or ())  # one may be named row
    scope: dict[str, Any] = {"__name__": __name__}  # of whose module the function is
    exec("\n".join([f"def pack({names}, row):", *lines]), scope)
    pack: GoldenFunction = scope["pack"]

    def plain(*words: Any) -> None:
        words[-1][:] = np.frombuffer(np.array(words[:-1], layout).tobytes(), np.uint8)

    pack.plain = plain  # type: ignore[attr-defined]
    return pack


def unpacked(spec: EnvSpec, rows: Array, out: Array | None = None) -> Array:
    """Return observations of shape ``(n, *spec.observation_shape)`` of packed ones, shape ``(n, bytes)``.

    ``spec`` is that of the environment with its observations as they are. Into ``out`` they are written, if
    it is given: an array of that shape, of the observations' dtype, whose elements follow each other.
    """
    check_spec(spec)
    rows = np.asarray(rows)
    if spec.unpack is None:
        raise ArgumentError(f"only planes are packed, which {spec.name}'s observations are not")
    layout = row_dtype(spec)
    if rows.dtype != np.uint8 or rows.ndim != 2 or rows.shape[1] != layout.itemsize:
        raise ArgumentError(
            f"packed observations have the dtype {rows.dtype} and the shape {rows.shape}; {spec.name}'s are "
            f"uint8 of the shape (n, {layout.itemsize})"
        )
    words = np.ascontiguousarray(rows).view(layout)[:, 0]
    columns = tuple(np.ascontiguousarray(words[f.name], f.dtype) for f in spec.observation)
    shape, dtype = (len(rows), *spec.observation_shape), np.dtype(spec.observation_dtype)
    observations = np.empty(shape, dtype) if out is None else out
    if observations.shape != shape or observations.dtype != dtype or not observations.flags.c_contiguous:
        raise ArgumentError(
            f"out has the dtype {observations.dtype} and the shape {observations.shape}; {spec.name}'s "
            f"observations take a contiguous array of {dtype} of the shape {shape}"
        )
    compile_kernels(spec).deliver(columns, observations, len(rows))
    return observations
