"""The golden step of SpaceInvaders, as MinAtar's ``space_invaders`` plays it.

MinAtar has three boards: of aliens, of own bullets and of hostile ones. Here they are what can be on them:

- The aliens are one formation of 4 by 6. Where it is and who is left of it says all.
- Aliens fire every 10 steps, and a bullet that appears in row ``y`` is gone after ``10 - y``: there is one.
- An own bullet flies 9 steps, and the next ones follow 5 and 10 steps later: there are two.

A formation that leaves row 9 goes on in row 0, as in MinAtar, but that step ends the episode.
"""

from typing import NamedTuple

from pearl_marl.envs.minatar import FIRE, LAST, LEFT, NOTHING, RIGHT, SIDE, action_table, sticky
from pearl_marl.envs.minatar_planes import bits
from pearl_marl.golden import Draws, GoldenFunction, Word
from pearl_marl.layout import Array, Bits, Flag, Range

MINIMAL = (NOTHING, LEFT, RIGHT, FIRE)
TO_LEFT, TO_RIGHT, SHOOT = 1, 2, 3
"""Places of three actions in the minimal action set."""
ROWS, COLUMNS = 4, 6
ALIENS = ROWS * COLUMNS
ALL_ALIENS = (1 << ALIENS) - 1
MARGIN = COLUMNS - 1
"""Columns that a formation may be off the board, to the left, as long as one that is left is on it."""
RELOAD_STEPS, BOMB_INTERVAL = 5, 10
SLOWEST_MOVE, LAST_RAMP = 12, 6


class Bullet(NamedTuple):
    """A bullet, own or hostile."""

    x: Range[0, LAST]
    y: Range[0, LAST]
    flies: Flag


class Formation(NamedTuple):
    """The aliens: bit ``6 * r + c`` of ``alive`` is that in row ``top + r`` and column ``left - 5 + c``."""

    left: Range[0, LAST + MARGIN]
    top: Range[0, LAST]
    leftward: Flag
    alive: Bits[ALIENS]


class State(NamedTuple):
    """The game. Of the two own bullets, the first is the older."""

    last_action: Range[0, 3]
    x: Range[0, LAST]
    reload: Range[0, RELOAD_STEPS]
    move_timer: Range[0, SLOWEST_MOVE]
    bomb_timer: Range[0, BOMB_INTERVAL]
    ramp: Range[0, LAST_RAMP]
    bullets: Array[Bullet, 2]
    bomb: Bullet
    aliens: Formation


class View(NamedTuple):
    """What can be seen."""

    x: Range[0, LAST]
    bullets: Array[Bullet, 2]
    bomb: Bullet
    aliens: Formation


def initial(draws: Draws) -> State:
    """Return the state of a new episode, which is always the same."""
    nothing = Bullet(0, 0, 0)
    aliens = Formation(2 + MARGIN, 0, 1, ALL_ALIENS)
    return State(0, 5, 0, SLOWEST_MOVE, BOMB_INTERVAL, 0, [nothing, nothing], nothing, aliens)


def alien_at(aliens: Formation, x: Word, y: Word) -> Word:
    """Return the bit of the alien in a cell of the board; 0 if there is none."""
    row = y - aliens.top if y >= aliens.top else y - aliens.top + SIDE
    column = x + MARGIN - aliens.left
    bit = 1 << COLUMNS * min(row, ROWS - 1) + min(max(column, 0), COLUMNS - 1)
    return aliens.alive & bit if row < ROWS and 0 <= column < COLUMNS else 0


def columns_of(aliens: Formation) -> Word:
    """Return the columns of the board that have aliens, a bit each."""
    columns = 0
    for row in range(ROWS):
        columns = columns | aliens.alive >> COLUMNS * row
    return (columns & (1 << COLUMNS) - 1) << aliens.left >> MARGIN & (1 << SIDE) - 1


def moved(aliens: Formation) -> tuple[Formation, Word]:
    """Move the formation on, or down where it is at the edge; return it and whether it left row 9."""
    left, top, leftward, alive = aliens
    columns = columns_of(aliens)
    at_edge = columns & 1 if leftward else columns >> LAST
    in_last_row = alive >> COLUMNS * (LAST - top) & (1 << COLUMNS) - 1 if top > LAST - ROWS else 0
    if at_edge:
        leftward, top = 1 - leftward, top + 1 if top < LAST else 0
    elif leftward:
        left = max(left - 1, 0)
    else:
        left = min(left + 1, LAST + MARGIN)
    return Formation(left, top, leftward, alive), at_edge and in_last_row != 0


def nearest(aliens: Formation, x: Word) -> Bullet:
    """Return a bullet at the lowest alien of the column that is nearest; of two, of the left one."""
    columns, distance, target, lowest = columns_of(aliens), SIDE, 0, 0
    for column in range(SIDE):
        if columns >> column & 1 and abs(column - x) < distance:
            distance, target = abs(column - x), column
    for row in range(ROWS):
        y = aliens.top + row if aliens.top + row <= LAST else aliens.top + row - SIDE
        lowest = max(lowest, y) if alien_at(aliens, target, y) else lowest
    return Bullet(target, lowest, columns != 0)


def make_step(sticky_action_prob: float, ramping: bool, use_minimal_action_set: bool) -> GoldenFunction:
    """Return the golden step under its options."""
    actions = action_table(MINIMAL, use_minimal_action_set)

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Play one step; return the next state, the reward and whether the episode terminated."""
        action = sticky(actions[action], state.last_action, draws, sticky_action_prob)
        x, reload, bullets, bomb, aliens = state.x, state.reload, state.bullets, state.bomb, state.aliens
        move_timer, bomb_timer, ramp = state.move_timer, state.bomb_timer, state.ramp
        if action == SHOOT and reload == 0:
            bullets, reload = [bullets[1], Bullet(x, LAST, 1)], RELOAD_STEPS
        elif action == TO_LEFT:
            x = max(x - 1, 0)
        elif action == TO_RIGHT:
            x = min(x + 1, LAST)

        bullets = [Bullet(b.x, max(b.y - 1, 0), b.flies and b.y > 0) for b in bullets]
        bomb = Bullet(bomb.x, min(bomb.y + 1, LAST), bomb.flies and bomb.y < LAST)
        terminated = (bomb.flies and bomb.y == LAST and bomb.x == x) or alien_at(aliens, x, LAST) != 0
        if move_timer == 0:
            move_timer = min(sum(bits(aliens.alive, ALIENS)), SLOWEST_MOVE - ramp)
            aliens, left_the_board = moved(aliens)
            terminated = terminated or left_the_board or alien_at(aliens, x, LAST) != 0
        if bomb_timer == 0:
            bomb_timer, bomb = BOMB_INTERVAL, nearest(aliens, x)

        reward, left, alive = 0, [], aliens.alive
        for bullet in bullets:
            struck = alien_at(aliens, bullet.x, bullet.y) if bullet.flies else 0
            alive, reward = alive & ~struck, reward + (struck != 0)
            left.append(bullet._replace(flies=bullet.flies and struck == 0))
        aliens = aliens._replace(alive=alive)
        if alive == 0:
            ramp = min(ramp + 1, LAST_RAMP) if ramping else ramp
            aliens = Formation(2 + MARGIN, 0, aliens.leftward, ALL_ALIENS)
        timers = max(reload - 1, 0), max(move_timer - 1, 0), bomb_timer - 1
        return State(action, x, *timers, ramp, left, bomb, aliens), reward, terminated

    return step


def observe(state: State) -> View:
    """Return what can be seen."""
    return View(state.x, state.bullets, state.bomb, state.aliens)
