"""Figure 3: bits of a slot's action, observation, reward, ends and state, before and after compression."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from pearl_marl.benchmark.paper import TABLE_2, TABLE_2_SOURCE
from pearl_marl.envs import get_spec, names
from pearl_marl.memory_map import ter_bits
from pearl_marl.spec import EnvSpec, word_bits

from . import paper
from .section import HATCHES, Colour, Progress, Row, bars, having, row_of, select, subplots, tidy

TITLE = "Figure 3: data compression"
TEXT = (
    "Bits of one slot, as the arrays of a Gymnasium vector environment have them and as words of the "
    "hardware. A step sends actions and brings observations, rewards and ends; the state stays on the "
    "device."
)
COLUMNS = {
    "environment": "environment",
    "quantity": "quantity",
    "bits_before": "bits in arrays",
    "bits_after": "bits in hardware",
    "saved": "saved",
    "share": "share",
    "counts": "what is counted",
}

QUANTITIES = ("action", "observation", "reward", "ends", "state")


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Count the bits of every environment; beside them the paper's, where it states them."""
    specs = [get_spec(name) for name in names()]
    rows = [row for spec in progress(specs, len(specs), "bits") for row in _counted(spec)]
    rows += [
        row_of(
            "quoted", paper.SAVED_SOURCE, environment="CliffWalking", quantity=what, saved=paper.SAVED[what]
        )
        for what in QUANTITIES
    ]
    for spec in specs:
        action = word_bits(spec.action_fields)
        sent = action / (action + word_bits(spec.state))
        rows.append(_share("measured", spec.name, sent, "bits in hardware"))
    for name, sent in paper.ACTION_SHARE.items():
        rows.append(_share("quoted", name, sent, paper.ACTION_SHARE_SOURCE))
    for name, column in TABLE_2.items():
        rows += [
            row_of(
                "quoted", TABLE_2_SOURCE, environment=name, quantity=what, bits_after=getattr(column, what)
            )
            for what in ("action", "observation", "reward", "state")
        ]
    return rows


def _share(kind: str, name: str, share: float, counts: str) -> Row:
    return row_of(kind, counts, environment=name, quantity="action / (action + state)", share=share)


def _counted(spec: EnvSpec) -> list[Row]:
    as_one = isinstance(spec.observation_space, gymnasium.spaces.Discrete)
    bits = {
        "action": (_bits(spec.action_space), word_bits(spec.action_fields)),
        "observation": (_bits(spec.observation_space), word_bits(spec.observation)),
        "reward": (64, spec.reward.bits),
        "ends": (2 * 8, ter_bits(spec)),
        "state": (64 if as_one else 64 * len(spec.state), word_bits(spec.state)),
    }
    arrays = {
        "reward": "a float64",
        "ends": "two bools",
        "state": "64 bits, as Python keeps numbers, for each variable; one where it is observed as one",
    }
    return [
        row_of(
            "measured",
            arrays.get(quantity, "an element of Gymnasium's batched space"),
            environment=spec.name,
            quantity=quantity,
            bits_before=before,
            bits_after=after,
            saved=1 - after / before,
        )
        for quantity, (before, after) in bits.items()
    ]


def _bits(space: gymnasium.Space[Any]) -> int:
    """Return the bits of one element in the arrays of a batch."""
    if isinstance(space, gymnasium.spaces.Tuple):
        return sum(_bits(part) for part in space.spaces)
    assert space.dtype is not None
    assert space.shape is not None
    return 8 * space.dtype.itemsize * int(np.prod(space.shape))


def draw(rows: list[Row]) -> Any:
    """Draw bars before and after, a panel a quantity."""
    figure, grid = subplots(2, 3, 8.0, sharey=True)
    *panels, rest = grid.flat
    environments = list(dict.fromkeys(row["environment"] for row in rows))
    height = 0.27
    forms = (
        ("measured", "bits_before", Colour.ORANGE, -1, "arrays of Gymnasium (counted)"),
        ("measured", "bits_after", Colour.BLUE, 0, "words of our hardware (counted)"),
        ("quoted", "bits_after", Colour.SKY, 1, "words of the paper's (quoted)"),
    )
    for axes, quantity in zip(panels, QUANTITIES, strict=True):
        for kind, key, colour, place, label in forms:
            points = having(select(rows, quantity=quantity, kind=kind), key)
            places = [environments.index(row["environment"]) + place * height for row in points]
            style = {"color": colour, "hatch": HATCHES[kind], "label": label}
            bars(axes, places, [row[key] for row in points], height, **style)
        axes.set(title=quantity, xscale="log", xlim=(0.7, 4e4), xlabel="bits a slot (log scale)")
    tidy(*panels, grid=False)
    panels[0].set_yticks(range(len(environments)), environments)
    panels[0].invert_yaxis()
    rest.axis("off")
    rest.legend(*panels[0].get_legend_handles_labels(), loc="center", frameon=False)
    return figure
