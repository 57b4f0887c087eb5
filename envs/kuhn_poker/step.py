"""The golden step of KuhnPoker: each of two players holds one of three cards, and sees no other.

Both have put in a chip. A player bets another one or passes; to pass after a bet is to fold, and to bet after
a bet is to call it.

Follows https://github.com/sotetsuk/pgx (``pgx`` 2.6.0, ``kuhn_poker``), after H. W. Kuhn, *A simplified
two-person poker*, 1950.
"""

from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Flag, Range

JACK, QUEEN, KING = range(3)
BET, PASS, NOTHING = range(3)


class State(NamedTuple):
    """The cards, whose turn it is, the action before, and who has bet."""

    cards: Array[Range[JACK, KING], 2]
    turn: Flag
    last: Range[BET, NOTHING]
    bets: Array[Flag, 2]


def initial(draws: Draws) -> State:
    """Deal two of the cards; either player may begin."""
    first, second, turn = draws.several(3, 2, 2)
    return State([first, second + (second >= first)], turn, NOTHING, [0, 0])


def step(state: State, actions: list[Word], draws: Draws) -> tuple[State, list[Word], list[Word]]:
    """Bet (0) or pass (1) for the player on turn; the reward is what a player wins or loses."""
    cards, turn, last, bets = state
    action = actions[turn]
    showdown = 1 if cards[turn] > cards[1 - turn] else -1
    gain, over = 0, False
    if last == BET:
        gain, over = 2 * showdown if action == BET else -1, True
    elif last == PASS and action == PASS:
        gain, over = showdown, True
    bets[turn] = bets[turn] or action == BET
    rewards = [-gain, gain] if turn else [gain, -gain]
    return State(cards, 1 - turn, action, bets), rewards, [over, over]


def observe(state: State, agent: int) -> list[Word]:
    """Return flags: which card the agent holds, whether it has bet, and whether the other has."""
    card, own, other = state.cards[agent], state.bets[agent], state.bets[1 - agent]
    return [card == JACK, card == QUEEN, card == KING, not own, own, not other, other]


def masks(state: State, agent: int) -> list[Word]:
    """Return that both actions are allowed; none for an agent that is not on turn."""
    return [state.turn == agent] * 2
