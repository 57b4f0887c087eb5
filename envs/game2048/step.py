"""The golden step of the game 2048: tiles slide as far as they can, and equal ones that meet become one.

A tile is a power of two, and a cell holds its exponent, 0 where there is none.

Follows https://github.com/instadeepai/jumanji (``jumanji`` 1.1.2, ``Game2048-v1``), after G. Cirulli's game.
"""

from itertools import pairwise
from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Range
from pearl_marl.spec import Golden

UP, RIGHT, DOWN, LEFT = range(4)


def greatest(size: int) -> int:
    """Return the greatest exponent: of a board whose other cells hold all that it is made of."""
    return size * size + 1


def make_golden(size: int) -> Golden:
    """Return the golden functions of a board of so many rows and columns."""
    last, most = size - 1, greatest(size)

    class State(NamedTuple):
        """The exponents of the tiles."""

        board: Array[Range[0, most], size, size]

    def initial(draws: Draws) -> State:
        """Put a tile on an empty board."""
        return State(with_tile([[0] * size for _ in range(size)], True, draws))

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Slide all tiles up (0), right (1), down (2) or left (3); what changes nothing adds no tile."""
        upright, backwards = action in (UP, DOWN), action in (RIGHT, DOWN)
        board, after, reward, changed = state.board, [], 0, False
        for i in range(size):
            # A line begins where its tiles slide to.
            line = [board[j][i] if upright else board[i][j] for j in range(size)]
            line = [line[last - j] if backwards else line[j] for j in range(size)]
            moved, worth = slid(line, most)
            reward, changed = reward + worth, changed or moved != line
            after.append([moved[last - j] if backwards else moved[j] for j in range(size)])
        turned = [[after[j][i] if upright else after[i][j] for j in range(size)] for i in range(size)]
        board = with_tile(turned, changed, draws)
        return State(board), reward, not any(movable(board))

    def observe(state: State) -> State:
        """Return the observation: the state."""
        return state

    def masks(state: State) -> list[Word]:
        """Return which actions change the board."""
        return movable(state.board)

    return Golden(State, initial, step, observe, masks, view=State)


def slid(line: list[Word], most: int) -> tuple[list[Word], Word]:
    """Return a line whose tiles have slid to its beginning and merged, and what the new ones are worth."""
    line, size, worth = [*line], len(line), 0
    for end in range(size - 1, 0, -1):
        for k in range(end):
            if line[k] == 0:
                line[k], line[k + 1] = line[k + 1], 0
    for k in range(size - 1):
        if line[k] > 0 and line[k] == line[k + 1]:
            line[k] = min(line[k] + 1, most)
            worth += 1 << line[k]
            line[k + 1 :] = [*line[k + 2 :], 0]
    return line, worth


def with_tile(board: list[list[Word]], adds: Word, draws: Draws) -> list[list[Word]]:
    """Return a board with a new tile in any free cell: of ten, nine are a 2 and one is a 4."""
    free = sum(cell == 0 for row in board for cell in row)
    chosen, tile = draws.below(max(free, 1)), 2 if draws.chance(0.1) else 1
    before, after = 0, []
    for row in board:
        line = []
        for cell in row:
            line.append(tile if adds and cell == 0 and before == chosen else cell)
            before += cell == 0
        after.append(line)
    return after


def movable(board: list[list[Word]]) -> list[Word]:
    """Return for each action whether it changes a board."""
    flags = [False] * 4
    rows, columns = board, list(zip(*board, strict=True))
    for lines, forwards, backwards in ((columns, UP, DOWN), (rows, LEFT, RIGHT)):
        for line in lines:
            for one, other in pairwise(line):
                merges = one > 0 and one == other
                flags[forwards] = flags[forwards] or merges or (one == 0 and other > 0)
                flags[backwards] = flags[backwards] or merges or (other == 0 and one > 0)
    return flags
