"""The golden step of Freeway, as MinAtar's ``freeway`` plays it.

MinAtar has a list of eight cars, one in each of the rows 1 to 8. Here they are bits of planes: bit ``k`` of
all of them is the car in row ``k + 1``. Each row has only one car, so the order of MinAtar's loop over them
does not matter.
"""

from typing import NamedTuple

from pearl_marl.envs.minatar import DOWN, LAST, NOTHING, UP, action_table, sticky
from pearl_marl.envs.minatar_planes import bits, counted_down, moved, number_in, off_board, places_of
from pearl_marl.golden import Draws, GoldenFunction, Word
from pearl_marl.layout import Array, Bits, Range

MINIMAL = (NOTHING, UP, DOWN)
GO_UP, GO_DOWN = 1, 2
"""Places of two actions in the minimal action set."""
LANES, SPEEDS = 8, 5
EVERY_LANE = (1 << LANES) - 1
OWN_COLUMN = 4
"""The column that the chicken goes up and down in."""
MOVE_INTERVAL, TIME_LIMIT = 3, 2500


class Cars(NamedTuple):
    """Planes of a bit a lane. ``interval`` is how many steps a car stands."""

    rightward: Bits[LANES]
    interval: Array[Bits[LANES], 3]
    column: Array[Bits[LANES], 4]


class State(NamedTuple):
    """The game; ``timer`` are planes of the cars, too."""

    last_action: Range[0, 2]
    y: Range[1, LAST]
    move_timer: Range[0, MOVE_INTERVAL]
    steps_left: Range[0, TIME_LIMIT]
    cars: Cars
    timer: Array[Bits[LANES], 3]


class View(NamedTuple):
    """What can be seen: of each car its column (4 bits), interval (3) and whether it goes rightward (1)."""

    y: Range[1, LAST]
    cars: Array[Bits[8], LANES]


def new_speeds(draws: Draws) -> tuple[Word, list[Word]]:
    """Return directions and intervals of eight cars, all equally likely."""
    cases = draws.several(*[2 * SPEEDS] * LANES)
    rightward, interval = 0, [0, 0, 0]
    for lane, case in enumerate(cases):
        goes_right = case >= SPEEDS
        rightward = rightward | goes_right << lane
        steps = bits((case - SPEEDS if goes_right else case) + 1, 3)
        interval = [plane | bit << lane for plane, bit in zip(interval, steps, strict=True)]
    return rightward, interval


def initial(draws: Draws) -> State:
    """Return the state of a new episode: all cars in column 0."""
    rightward, interval = new_speeds(draws)
    return State(0, LAST, MOVE_INTERVAL, TIME_LIMIT, Cars(rightward, interval, [0] * 4), interval)


def drive(cars: Cars, timer: list[Word]) -> tuple[Cars, list[Word]]:
    """Move the cars whose timers are 0, around the board's edges; return cars and timers."""
    timer, moves = counted_down(timer, EVERY_LANE)
    timer = [plane & (~moves | bit) for plane, bit in zip(timer, cars.interval, strict=True)]
    ones, twos, fours, eights = moved(cars.column, cars.rightward, moves)
    # To the left of 0 stands 15, which becomes 9; to the right of 9 stands 10, which becomes 0.
    off = off_board([ones, twos, fours, eights])
    column = [ones, twos & ~off, fours & ~off, eights & ~(off & cars.rightward)]
    return cars._replace(column=column), timer


def make_step(sticky_action_prob: float, use_minimal_action_set: bool) -> GoldenFunction:
    """Return the golden step under its options."""
    actions = action_table(MINIMAL, use_minimal_action_set)

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Play one step; return the next state, the reward and whether the episode terminated."""
        action = sticky(actions[action], state.last_action, draws, sticky_action_prob)
        rightward, interval = new_speeds(draws)
        y, move_timer, cars, timer = state.y, state.move_timer, state.cars, state.timer
        if move_timer == 0 and action != 0:
            y = y - 1 if action == GO_UP else min(y + 1, LAST)
            move_timer = MOVE_INTERVAL
        arrives = y == 0
        if arrives:
            y, cars, timer = LAST, Cars(rightward, interval, cars.column), interval

        ahead = places_of(cars.column, OWN_COLUMN)
        cars, timer = drive(cars, timer)
        hit = (ahead | places_of(cars.column, OWN_COLUMN)) >> y - 1 & 1 if y <= LANES else 0
        if hit:
            y = LAST
        after = State(action, y, max(move_timer - 1, 0), max(state.steps_left - 1, 0), cars, timer)
        return after, arrives, state.steps_left == 0

    return step


def observe(state: State) -> View:
    """Return what can be seen."""
    planes = [*state.cars.column, *state.cars.interval, state.cars.rightward]
    return View(state.y, [number_in(planes, lane) for lane in range(LANES)])
