"""Figure 3: bits of a slot's action, observation, reward, ends and state, before and after compression."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from pearl_marl.memory_map import TER_BITS
from pearl_marl.registry import get_spec, names
from pearl_marl.rendering import import_pyplot
from pearl_marl.spec import EnvSpec, word_bits

from . import paper
from .section import BLUE, ORANGE, WIDTH, Progress, Row, select

TITLE = "Figure 3: data compression"
TEXT = (
    "Bits that one slot takes a step, as the arrays of a Gymnasium vector environment have them and as words of the "
    "hardware. A step sends actions and brings observations, rewards and ends; the state stays on the device."
)
COLUMNS = {
    "environment": "environment",
    "quantity": "quantity",
    "bits_before": "bits in arrays",
    "bits_after": "bits in hardware",
    "saved": "saved",
    "counts": "what is counted",
}
SEEDS = (0,)

QUANTITIES = ("action", "observation", "reward", "ends", "state")


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Count the bits of every environment; beside them the paper's, where it states them."""
    specs = [get_spec(name) for name in names()]
    rows = [row for spec in progress(specs, len(specs), "bits") for row in _counted(spec)]
    rows += [
        {
            "kind": "quoted",
            "environment": "CliffWalking",
            "quantity": quantity,
            "saved": getattr(paper.SAVED, quantity),
            "counts": paper.SAVED_SOURCE,
        }
        for quantity in QUANTITIES
    ]
    for name, build in paper.BUILDS.items():
        widths = {
            "action": build.action,
            "observation": build.observation,
            "reward": build.reward,
            "state": build.state,
        }
        rows += [
            {
                "kind": "quoted",
                "environment": name,
                "quantity": quantity,
                "bits_after": bits,
                "counts": paper.BUILDS_SOURCE,
            }
            for quantity, bits in widths.items()
        ]
    return rows


def _counted(spec: EnvSpec) -> list[Row]:
    before = {
        "action": _bits(spec.action_space),
        "observation": _bits(spec.observation_space),
        "reward": 64,
        "ends": 2 * 8,
        "state": 64 * len(spec.state),
    }
    after = {
        "action": spec.action.bits,
        "observation": word_bits(spec.observation),
        "reward": spec.reward.bits,
        "ends": TER_BITS,
        "state": word_bits(spec.state),
    }
    arrays = {
        "reward": "a float64",
        "ends": "two bools",
        "state": "a 64-bit number for each of its variables, as Python keeps them",
    }
    return [
        {
            "kind": "measured",
            "environment": spec.name,
            "quantity": quantity,
            "bits_before": before[quantity],
            "bits_after": after[quantity],
            "saved": 1 - after[quantity] / before[quantity],
            "counts": arrays.get(quantity, "an element of Gymnasium's batched space"),
        }
        for quantity in QUANTITIES
    ]


def _bits(space: gymnasium.Space[Any]) -> int:
    """Return the bits of one element in the arrays of a batch."""
    if isinstance(space, gymnasium.spaces.Tuple):
        return sum(_bits(part) for part in space.spaces)
    assert space.dtype is not None and space.shape is not None
    return 8 * space.dtype.itemsize * int(np.prod(space.shape))


def draw(rows: list[Row]) -> Any:
    """Draw bars before and after, a panel a quantity."""
    plt = import_pyplot()
    figure, grid = plt.subplots(2, 3, figsize=(WIDTH, 6.4), sharey=True, layout="constrained")
    panels = list(grid.flat)
    environments = list(dict.fromkeys(row["environment"] for row in rows))
    height = 0.38
    for axes, quantity in zip(panels, QUANTITIES, strict=False):
        for row in select(rows, quantity=quantity, kind="measured"):
            y = environments.index(row["environment"])
            for key, shift, colour in (
                ("bits_before", -height / 2, ORANGE),
                ("bits_after", height / 2, BLUE),
            ):
                axes.barh(y + shift, row[key], height, color=colour)
                axes.text(row[key] * 1.1, y + shift, f"{row[key]:,}", va="center", fontsize=7)
        quoted = [row for row in select(rows, quantity=quantity, kind="quoted") if row.get("bits_after")]
        axes.plot(
            [row["bits_after"] for row in quoted],
            [environments.index(row["environment"]) + height / 2 for row in quoted],
            linestyle="",
            marker="x",
            color="black",
        )
        axes.set(title=quantity, xscale="log", xlim=(0.7, 4e4), xlabel="bits a slot (log scale)")
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_yticks(range(len(environments)), environments)
    panels[0].invert_yaxis()
    panels[5].axis("off")
    panels[5].legend(
        handles=[
            plt.Rectangle((0, 0), 1, 1, color=ORANGE, label="arrays of Gymnasium (counted)"),
            plt.Rectangle((0, 0), 1, 1, color=BLUE, label="words of the hardware (counted)"),
            plt.Line2D([], [], linestyle="", marker="x", color="black", label="the paper's words (quoted)"),
        ],
        loc="center",
        frameon=False,
    )
    return figure
