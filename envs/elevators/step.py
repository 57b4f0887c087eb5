"""The golden step of Elevators: cars fetch passengers from the floors between, for the top or the bottom.

Follows ``Elevators_MDP_ippc2011`` of https://github.com/pyrddlgym-project/rddlrepository (2.2), 2011.
"""

from typing import Any, NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Flag, Range
from pearl_marl.spec import Golden

MOVE, OPEN_UP, OPEN_DOWN, CLOSE = range(1, 5)
RIGHT, WRONG, WAITING = 3, 12, 4
"""What passengers cost a step, in quarters: in a car that goes their way or the other, and on a floor."""


def make_golden(count: int, arrivals: tuple[float, ...]) -> Golden:
    """Return the golden functions for so many cars, and the chance of an arrival on each floor between."""
    between, top = len(arrivals), len(arrivals) + 1

    class Car(NamedTuple):
        floor: Range[0, top]
        up: Flag
        closed: Flag
        takes_up: Flag
        takes_down: Flag

    class State(NamedTuple):
        waiting_up: Array[Flag, between]
        waiting_down: Array[Flag, between]
        cars: Array[Car, count]

    class View(NamedTuple):
        waiting_up: Array[Flag, top + 1]
        waiting_down: Array[Flag, top + 1]
        takes_up: Array[Flag, count]
        takes_down: Array[Flag, count]
        up: Array[Flag, count]
        closed: Array[Flag, count]
        at_floor: Array[Flag, count, top + 1]

    def initial(draws: Draws) -> State:
        """Return what a day begins with: all cars at the bottom, closed and bound upwards."""
        return State([0] * between, [0] * between, [Car(0, 1, 1, 0, 0)] * count)

    def step(state: State, action: Any, draws: Draws) -> tuple[State, Word, Word]:
        """Let passengers arrive and board, and move cars; the reward is of the state before."""
        actions = action if count > 1 else [action]
        up, down = ([draws.chance(chance) for chance in arrivals] for _ in range(2))
        for k in range(between):
            # Passengers go on waiting unless a car stands open that goes their way.
            ways = [(car.floor == k + 1 and not car.closed, car.up) for car in state.cars]
            up[k] = up[k] or (state.waiting_up[k] and not any(stands and way for stands, way in ways))
            down[k] = down[k] or (state.waiting_down[k] and not any(stands > way for stands, way in ways))
        after = [moved(state, car, chosen) for car, chosen in zip(state.cars, actions, strict=True)]
        cost = WAITING * (sum(state.waiting_up) + sum(state.waiting_down)) + sum(map(cost_of, state.cars))
        return State(up, down, after), -cost, False

    def moved(state: State, car: Car, action: Word) -> Car:
        """Return a car after its action."""
        floor, closed = car.floor, (car.closed and action not in (OPEN_UP, OPEN_DOWN)) or action == CLOSE
        if car.closed and action == MOVE:
            floor = min(max(floor + (1 if car.up else -1), 0), top)
        boards = not car.closed and [0, *(state.waiting_up if car.up else state.waiting_down), 0][car.floor]
        takes_up = car.floor != top if car.takes_up else boards and car.up
        takes_down = car.floor != 0 if car.takes_down else boards and not car.up
        return Car(floor, action == OPEN_UP or (car.up and action != OPEN_DOWN), closed, takes_up, takes_down)

    def cost_of(car: Car) -> Word:
        """Return what the passengers in a car cost."""
        return (RIGHT if car.up else WRONG) * car.takes_up + (WRONG if car.up else RIGHT) * car.takes_down

    def observe(state: State) -> View:
        """Return the domain's fluents in their order."""
        waiting = [0, *state.waiting_up, 0], [0, *state.waiting_down, 0]
        _, up, closed, takes_up, takes_down = zip(*state.cars, strict=True)
        floors = [[car.floor == k for k in range(top + 1)] for car in state.cars]
        return View(*waiting, takes_up, takes_down, up, closed, floors)

    return Golden(State, initial, step, observe, view=View)
