"""The golden step of Asterix, as MinAtar's ``asterix`` plays it.

MinAtar has a slot for each of the rows 1 to 8, empty or with one enemy or treasure. Here the slots are bits
of planes: bit ``k`` of all of them is what is in row ``k + 1``. The two speeds of MinAtar follow from how
often the difficulty has been raised, at most 9 times.
"""

from typing import NamedTuple

from pearl_marl.envs.minatar import DOWN, LAST, LEFT, NOTHING, RIGHT, UP, action_table, sticky
from pearl_marl.envs.minatar_planes import bits, lowest, moved, off_board, places_of
from pearl_marl.golden import Draws, GoldenFunction, Word
from pearl_marl.layout import Array, Bits, Range

MINIMAL = (NOTHING, LEFT, UP, RIGHT, DOWN)  # the first five, so an action is its place among them
ROWS = 8
EVERY_ROW = (1 << ROWS) - 1
SLOWEST_SPAWN, SLOWEST_MOVE = 10, 5
RAMP_STEPS, LAST_RAMP = 101, 9
"""Steps from one rise of the difficulty to the next, less one; and how often it rises."""


class Entities(NamedTuple):
    """What is in the eight rows: planes of a bit a row."""

    alive: Bits[ROWS]
    rightward: Bits[ROWS]
    gold: Bits[ROWS]
    column: Array[Bits[ROWS], 4]


class State(NamedTuple):
    """The game."""

    last_action: Range[0, 4]
    x: Range[0, LAST]
    y: Range[1, ROWS]
    spawn_timer: Range[0, SLOWEST_SPAWN]
    move_timer: Range[0, SLOWEST_MOVE]
    ramp_timer: Range[0, RAMP_STEPS]
    ramp: Range[0, LAST_RAMP]
    entities: Entities


class View(NamedTuple):
    """What can be seen."""

    x: Range[0, LAST]
    y: Range[1, ROWS]
    entities: Entities


def initial(draws: Draws) -> State:
    """Return the state of a new episode: the player in the middle of empty rows."""
    return State(0, 5, 5, SLOWEST_SPAWN, SLOWEST_MOVE, RAMP_STEPS, 0, Entities(0, 0, 0, [0] * 4))


def spawned(entities: Entities, draws: Draws) -> Entities:
    """Put an enemy or, once in three, treasure at an end of a row that is empty, if there is one."""
    rightward, gold = draws.digit(2), draws.digit(3) == 0
    empty = ~entities.alive & EVERY_ROW
    skipped = draws.digit(sum(bits(empty, ROWS)), ROWS)
    for k in range(ROWS - 1):
        empty = empty & (empty - 1) if k < skipped else empty
    row = lowest(empty)

    def put(plane: Word, bit: Word) -> Word:
        return plane | row if bit else plane & ~row

    edge = bits(0 if rightward else LAST, 4)
    return Entities(
        entities.alive | row,
        put(entities.rightward, rightward),
        put(entities.gold, gold),
        [put(plane, bit) for plane, bit in zip(entities.column, edge, strict=True)],
    )


def make_step(sticky_action_prob: float, ramping: bool, use_minimal_action_set: bool) -> GoldenFunction:
    """Return the golden step under its options."""
    actions = action_table(MINIMAL, use_minimal_action_set)

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Play one step; return the next state, the reward and whether the episode terminated."""
        action = sticky(actions[action], state.last_action, draws, sticky_action_prob)
        entities, spawn_timer, move_timer = state.entities, state.spawn_timer, state.move_timer
        with_new, x, y = spawned(entities, draws), state.x, state.y
        if spawn_timer == 0:
            entities, spawn_timer = with_new, SLOWEST_SPAWN - state.ramp

        if action == LEFT:
            x = max(x - 1, 0)
        elif action == RIGHT:
            x = min(x + 1, LAST)
        elif action == UP:
            y = max(y - 1, 1)
        elif action == DOWN:
            y = min(y + 1, ROWS)

        alive, rightward, gold, column = entities
        beside = 1 << y - 1
        met = alive & beside & places_of(column, x)
        alive = alive & ~(met & gold)
        if move_timer == 0:
            move_timer = SLOWEST_MOVE - (state.ramp >> 1)
            column = moved(column, rightward, EVERY_ROW)
            alive = alive & ~off_board(column)
            meets = alive & beside & places_of(column, x)
            met, alive = met | meets, alive & ~(meets & gold)
        reward, terminated = met & gold, met & ~gold

        ramp, ramp_timer = state.ramp, state.ramp_timer
        if ramping and ramp < LAST_RAMP:
            if ramp_timer > 0:
                ramp_timer = ramp_timer - 1
            else:
                ramp, ramp_timer = ramp + 1, RAMP_STEPS
        entities = Entities(alive, rightward, gold, column)
        after = State(action, x, y, spawn_timer - 1, move_timer - 1, ramp_timer, ramp, entities)
        return after, reward != 0, terminated != 0

    return step


def observe(state: State) -> View:
    """Return what can be seen."""
    return View(state.x, state.y, state.entities)
