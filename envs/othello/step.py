"""The golden step of Othello, on bitboards.

A player's discs are 64 bits, bit ``8 * row + column``. Shifts of a whole board find lines of discs, in each
of the eight directions.

Follows https://github.com/sotetsuk/pgx (``pgx`` 2.6.0, ``othello``).
"""

from collections.abc import Callable
from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Bits, Flag

SIDE, CELLS = 8, 64
PASS = CELLS
FULL = (1 << CELLS) - 1
FIRST, SECOND = 1 << 28 | 1 << 35, 1 << 27 | 1 << 36
"""The discs on the board at first: of the player who begins, and of the other."""


class State(NamedTuple):
    """The discs of each player, whose turn it is, and whether the last move was a pass."""

    boards: Array[Bits[CELLS], 2]
    turn: Flag
    passed: Flag


class View(NamedTuple):
    """The discs of an agent, and those of the other."""

    own: Bits[CELLS]
    other: Bits[CELLS]


def way(down: int, right: int) -> Callable[[Word], Word]:
    """Return the function that moves all discs of a board a cell on; those that leave it are lost."""
    by = SIDE * down + right
    stays = sum(
        1 << SIDE * row + column
        for row in range(max(-down, 0), SIDE - max(down, 0))
        for column in range(max(-right, 0), SIDE - max(right, 0))
    )
    return lambda board: (board & stays) << by if by > 0 else (board & stays) >> -by


WAYS = [way(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right]


def initial(draws: Draws) -> State:
    """Return the state of a new game; either player begins."""
    turn = draws.bits(1)
    return State([SECOND, FIRST] if turn else [FIRST, SECOND], turn, 0)


def step(state: State, actions: list[Word], draws: Draws) -> tuple[State, list[Word], list[Word]]:
    """Place a disc of the player on turn (0 to 63), or pass (64).

    A player that places one where it turns none, or passes without need, loses the game.
    """
    boards, turn, passed = state
    action, own, other = actions[turn], boards[turn], boards[1 - turn]
    disc, passes = 1 << action if action < PASS else 0, action == PASS
    moves = moves_of(own, other)
    legal = moves == 0 if passes else moves & disc != 0
    turned = turned_by(disc, own, other)
    own, other = own | disc | turned, other ^ turned
    boards[turn], boards[1 - turn] = own, other
    over = own | other == FULL or other == 0 or (passes and passed)
    lead = count(own) - count(other)
    gain = (lead > 0) - (lead < 0) if over else 0
    if not legal:
        gain, over = -1, True
    return State(boards, 1 - turn, passes), [-gain, gain] if turn else [gain, -gain], [over, over]


def moves_of(own: Word, other: Word) -> Word:
    """Return the free cells where a disc turns others: beyond a line of them that follows an own one."""
    moves = 0
    for go in WAYS:
        moves |= go(line_of(go, own, other))
    return moves & (FULL ^ (own | other))


def turned_by(disc: Word, own: Word, other: Word) -> Word:
    """Return the discs that a new one turns: the lines from it to an own one."""
    turned = 0
    for go in WAYS:
        line = line_of(go, disc, other)
        if go(line) & own:
            turned |= line
    return turned


def line_of(go: Callable[[Word], Word], start: Word, other: Word) -> Word:
    """Return the other's discs that follow one of these without a gap."""
    line = go(start) & other
    for _ in range(SIDE - 3):
        line |= go(line) & other
    return line


def count(board: Word) -> Word:
    """Return the number of discs, added up in pairs of fields, which become ever wider."""
    for width in (1, 2, 4, 8, 16, 32):
        lower = sum(1 << k for k in range(CELLS) if not k & width)
        board = (board & lower) + (board >> width & lower)
    return board


def observe(state: State, agent: int) -> View:
    """Return what an agent sees."""
    return View(state.boards[agent], state.boards[1 - agent])


def masks(state: State, agent: int) -> list[Word]:
    """Return where a disc turns others, and whether there is only a pass; nothing if it is not its turn."""
    moves, own = moves_of(state.boards[agent], state.boards[1 - agent]), state.turn == agent
    return [*(own and moves >> cell & 1 for cell in range(CELLS)), own and moves == 0]
