"""The spec of Blackjack: what the platform has to know besides the dynamics in ``step.py``."""

from __future__ import annotations

from typing import Any

from gymnasium import Env
from gymnasium.spaces import Discrete, Tuple

from pearl_marl.checks import checked_flag
from pearl_marl.spec import EnvSpec, Golden

from .presets import PRESETS
from .step import State, View, initial, make_step, observe


def pose(oracle: Env[Any, Any], state: State) -> None:
    """Put Gymnasium's Blackjack into a state, for rendering."""
    player, ace, showing, hidden, _ = state
    # Any hand of the same total and ace looks the same.
    oracle.player = [1, player - 11] if ace else [player]  # type: ignore[attr-defined]
    oracle.dealer = [showing, hidden]  # type: ignore[attr-defined]
    # Neither suits nor ranks above 10 are part of the state; Gymnasium draws them at random.
    oracle.dealer_top_card_suit = "S"  # type: ignore[attr-defined]
    oracle.dealer_top_card_value_str = {1: "A", 10: "K"}.get(showing, str(showing))  # type: ignore[attr-defined]


def configure(natural: bool = False, sab: bool = True) -> EnvSpec:
    """Return the spec under Gymnasium's keyword arguments, with the defaults of its registration.

    Parameters
    ----------
    natural
        Whether a win with a natural, an ace and a ten at the start, pays 1.5. Of no effect with ``sab``.
    sab
        Whether to play by Sutton and Barto: a natural wins unless the dealer has one, too.
    """
    checked_flag("natural", natural)
    checked_flag("sab", sab)
    return EnvSpec(
        name="Blackjack",
        version=0,
        summary="Get closer to 21 than the dealer, but not beyond",
        rewards=(-1.0, 0.0, 1.0, 1.5),
        observation_space=Tuple((Discrete(32), Discrete(11), Discrete(2))),
        action_space=Discrete(2),
        golden=Golden(
            State, initial, make_step(natural_pays=natural and not sab, natural_wins=sab), observe, view=View
        ),
        options={"natural": natural, "sab": sab},
        configure=configure,
        presets=PRESETS,
        oracle="Blackjack-v1",
        pose=pose,
        render_modes=("human", "rgb_array"),
    )


SPEC = configure()
