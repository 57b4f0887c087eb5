"""The golden step of LeducPoker: two players hold a card each, and see a third after a round of bets.

There are six cards, two of each rank. Both players have put in a chip. A raise puts in 2 chips more than the
other has in the first round and 4 in the second, and a round has at most two raises. A pair with the third
card wins, then the higher card.

Follows https://github.com/sotetsuk/pgx (``pgx`` 2.6.0, ``leduc_holdem``), after F. Southey et al., *Bayes'
bluff: opponent modelling in poker*, 2005.
"""

from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Flag, Range

RANKS, MOST_CHIPS, MOST_RAISES = 3, 13, 2
CALL, RAISE, FOLD = range(3)


class State(NamedTuple):
    """The cards of both players and the one that is shown later; chips; and how far the bets are.

    At the end of a game the round is one more, as in pgx: so a fold in the first one shows the third card.
    """

    cards: Array[Range[0, RANKS - 1], 3]
    chips: Array[Range[0, MOST_CHIPS], 2]
    turn: Flag
    first: Flag
    round: Range[0, 2]
    begun: Flag
    raises: Range[0, MOST_RAISES]


def initial(draws: Draws) -> State:
    """Deal three of the six cards, which are numbered; either player may begin."""
    one, two, three, first = draws.several(6, 5, 4, 2)
    two += two >= one
    # The third is counted among the four that are left.
    three += three >= min(one, two)
    three += three >= max(one, two)
    return State([one >> 1, two >> 1, three >> 1], [1, 1], first, first, 0, 0, 0)


def step(state: State, actions: list[Word], draws: Draws) -> tuple[State, list[Word], list[Word]]:
    """Call (0), raise (1) or fold (2) for the player on turn; the reward is what a player wins or loses.

    A player that does what its masks forbid loses one point to the other, and the game is over.
    """
    cards, chips, turn, first, round_, begun, raises = state
    action, own, other = actions[turn], chips[turn], chips[1 - turn]
    illegal = not legal(state)[action] if action <= FOLD else True
    if action == CALL:
        own = other
    elif action == RAISE:
        own = min(max(own, other) + (4 if round_ > 0 else 2), MOST_CHIPS)
    called = action == CALL and begun
    over = illegal or action == FOLD or (called and round_ > 0)
    gain = 0
    if illegal:
        gain = -1
    elif action == FOLD:
        gain = -min(own, other)
    elif over:
        gain = showdown(cards[turn], cards[1 - turn], cards[2]) * min(own, other)
    chips[turn] = own
    rewards, ends = [-gain, gain] if turn else [gain, -gain], [over, over]
    if called or action == FOLD:
        return State(cards, chips, first, first, min(round_ + 1, 2), 0, 0), rewards, ends
    raises = min(raises + (action == RAISE), MOST_RAISES)
    return State(cards, chips, 1 - turn, first, round_, 1, raises), rewards, ends


def showdown(own: Word, other: Word, public: Word) -> Word:
    """Return whether a player's card wins (1), loses (-1) or is as good as the other's (0)."""
    if own == other:
        return 0
    return 1 if own == public or (other != public and own > other) else -1


def legal(state: State) -> list[Word]:
    """Return which actions the player on turn may take: none folds what it can call for nothing."""
    return [True, state.raises < MOST_RAISES, state.raises > 0]


def observe(state: State, agent: int) -> list[Word]:
    """Return flags: the agent's card, the shown card, and the chips of the agent and of the other."""
    card, public = state.cards[agent], state.cards[2]
    flags = [card == rank for rank in range(RANKS)]
    flags += [state.round == 1 and public == rank for rank in range(RANKS)]
    for player in (agent, 1 - agent):
        flags += [state.chips[player] == count for count in range(MOST_CHIPS + 1)]
    return flags


def masks(state: State, agent: int) -> list[Word]:
    """Return which actions are allowed; none for an agent that is not on turn."""
    return [state.turn == agent and allowed for allowed in legal(state)]
