"""Gymnasium's Taxi with its own control flow, statement by statement, and once more without any branch.

Follows ``gymnasium.envs.toy_text.taxi`` (Taxi-v4), itself after Dietterich, *Hierarchical Reinforcement
Learning with the MAXQ Value Function Decomposition*, 2000.
"""

from typing import Any, NamedTuple

from gymnasium.spaces import Discrete

from pearl_marl import EnvSpec
from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Range
from pearl_marl.spec import Field, Golden

MAP = [
    "+---------+",
    "|R: | : :G|",
    "| : | : : |",
    "| : : : : |",
    "| | : | : |",
    "|Y| : |B: |",
    "+---------+",
]
DESC = [[ord(letter) for letter in line] for line in MAP]
COLON = ord(":")
LOCS = [(0, 0), (0, 4), (4, 0), (4, 3)]
MAX_ROW = MAX_COL = 4


class State(NamedTuple):
    row: Range[0, 4]
    col: Range[0, 4]
    pass_idx: Range[0, 4]
    dest_idx: Range[0, 3]


def initial(draws: Draws) -> State:
    row, col, pass_idx, other = draws.several(5, 5, 4, 3)
    return State(row, col, pass_idx, other + (other >= pass_idx))


def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
    row, col, pass_idx, dest_idx = state
    taxi_loc = (row, col)
    new_row, new_col, new_pass_idx = row, col, pass_idx
    reward = -1  # default reward when there is no pickup/dropoff
    terminated = False

    if action == 0:
        new_row = min(row + 1, MAX_ROW)
    elif action == 1:
        new_row = max(row - 1, 0)
    if action == 2 and DESC[1 + row][2 * col + 2] == COLON:
        new_col = min(col + 1, MAX_COL)
    elif action == 3 and DESC[1 + row][2 * col] == COLON:
        new_col = max(col - 1, 0)
    elif action == 4:  # pickup
        new_pass_idx, reward = _pickup(taxi_loc, new_pass_idx, reward)
    elif action == 5:  # dropoff
        new_pass_idx, reward, terminated = _dropoff(taxi_loc, new_pass_idx, dest_idx, reward)

    return State(new_row, new_col, new_pass_idx, dest_idx), reward, terminated


def _pickup(taxi_loc: tuple[Word, Word], pass_idx: Word, reward: Word) -> tuple[Word, Word]:
    if pass_idx < 4 and taxi_loc == LOCS[pass_idx]:
        new_pass_idx = 4
        new_reward = reward
    else:  # passenger not at location
        new_pass_idx = pass_idx
        new_reward = -10

    return new_pass_idx, new_reward


def _dropoff(
    taxi_loc: tuple[Word, Word], pass_idx: Word, dest_idx: Word, default_reward: Word
) -> tuple[Word, Word, Word]:
    if (taxi_loc == LOCS[dest_idx]) and pass_idx == 4:
        new_pass_idx = dest_idx
        new_terminated = True
        new_reward = 20
    elif (taxi_loc in LOCS) and pass_idx == 4:
        new_pass_idx = LOCS.index(taxi_loc)
        new_terminated = False
        new_reward = default_reward
    else:  # dropoff at wrong location
        new_pass_idx = pass_idx
        new_terminated = False
        new_reward = -10

    return new_pass_idx, new_reward, new_terminated


def step_without_branches(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
    """Do the same by arithmetic on flags, as it had to be written before there were branches."""
    row, col, pass_idx, dest_idx = state
    top, bottom, odd = row < 2, row > 2, col & 1
    # Walls are east of column 1 in the upper two rows, and of columns 0 and 2 in the lower two.
    east_wall = (top & (col == 1)) | (bottom & (odd == 0))
    west_wall = (top & (col == 2)) | (bottom & odd)
    down, up = (action == 0) & (row < MAX_ROW), (action == 1) & (row > 0)
    right = (action == 2) & (col < MAX_COL) & (east_wall == 0)
    left = (action == 3) & (col > 0) & (west_wall == 0)

    at_red, at_green = (row == 0) & (col == 0), (row == 0) & (col == 4)
    at_yellow, at_blue = (row == 4) & (col == 0), (row == 4) & (col == 3)
    at_stand = at_red | at_green | at_yellow | at_blue
    stand = at_green + 2 * at_yellow + 3 * at_blue
    picks_up = (action == 4) & at_stand & (pass_idx == stand)
    drops_off = (action == 5) & at_stand & (pass_idx == 4)
    delivered = drops_off & (stand == dest_idx)
    illegal = ((action == 4) | (action == 5)) & ((picks_up | drops_off) == 0)
    new_pass_idx = picks_up * (4 - pass_idx) + drops_off * (stand - pass_idx) + pass_idx
    reward = 21 * delivered - 9 * illegal - 1
    after = State(row + down - up, col + right - left, new_pass_idx & 7, dest_idx)
    return after, reward, delivered


def observe(state: State) -> Word:
    return ((state.row * 5 + state.col) * 5 + state.pass_idx) * 4 + state.dest_idx


def spec_of(step: Any = step, name: str = "GymTaxi") -> EnvSpec:
    return EnvSpec(
        name=name,
        version=0,
        summary="Pick up a passenger and drive to the destination",
        reward=Field("reward", 6, signed=True),
        rewards=None,
        observation_space=Discrete(500),
        action_space=Discrete(6),
        golden=Golden(State, initial, step, observe),
    )
