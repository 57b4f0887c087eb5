"""Reward tables: checked, and with an entry for every word of the reward field."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec

RewardTable = npt.NDArray[np.float32]


def reward_table(spec: EnvSpec, table: npt.ArrayLike | None) -> RewardTable:
    """Return a reward table as :func:`padded` does; refuse what is not a finite number for each category."""
    if spec.rewards is None:
        if table is not None:
            raise ArgumentError(f"{spec.name} computes its rewards; it has no table to replace")
        return np.empty(0, np.float32)
    try:
        with np.errstate(over="ignore"):  # infinite then, and refused below
            array = np.array(table, np.float32)
            numbers = np.asarray(table).dtype.kind in "iuf"
    except (TypeError, ValueError, OverflowError):
        numbers = False
    if not numbers:
        raise ArgumentError(f"rewards are {table!r}; {spec.name} takes {len(spec.rewards)} numbers") from None
    if array.shape != (len(spec.rewards),):
        raise ArgumentError(
            f"a reward table of shape {array.shape}; {spec.name} has {len(spec.rewards)} categories, "
            f"by default {spec.rewards}"
        )
    if not np.isfinite(array).all():
        raise ArgumentError(f"rewards are {array.tolist()}; each must be a finite float32")
    return padded(spec, array)


def padded(spec: EnvSpec, table: npt.ArrayLike) -> RewardTable:
    """Return a table with an entry for every word of the reward field.

    Words that mean nothing are worth NaN. Empty where rewards are computed.
    """
    if spec.rewards is None:
        return np.empty(0, np.float32)
    whole = np.full(1 << spec.reward.bits, np.nan, np.float32)
    whole[: len(spec.rewards)] = table
    return whole


def categories(spec: EnvSpec, table: RewardTable) -> RewardTable | None:
    """Return the entries of a padded table that mean something; ``None`` where rewards are computed."""
    return None if spec.rewards is None else table[: len(spec.rewards)]
