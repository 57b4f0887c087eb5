"""Two environments whose slots are worlds of several agents.

``Meadow``
    Four agents of two roles: hares, with five actions and four words of observation, and snails, with three
    and two. Energies run out one by one, so agents end before their world; there are masks, draws in every
    step, and computed rewards. What is masked leaves an agent where it is.
``Nim``
    Two agents take 1 to 3 counters in turn, and who takes the last one wins. Who is not on turn has no action
    to choose; a masked one is refused.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from gymnasium.spaces import Box, Discrete

from pearl_marl import EnvSpec
from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Bits, Flag
from pearl_marl.spec import Field, Golden, Role

AGENTS = 4
HARES = 2
"""Agents 0 and 1; the others are snails."""
FIELD = 12
STAY, LEFT, RIGHT, JUMP, REST = range(5)


class Meadow(NamedTuple):
    """Where each agent is, and how strong."""

    place: Array[Bits[4], AGENTS]
    energy: Array[Bits[4], AGENTS]


class MeadowView(NamedTuple):
    """What a hare sees; a snail sees the first two."""

    place: Bits[4]
    energy: Bits[4]
    other: Bits[4]
    snail: Bits[5]


def meadow_initial(draws: Draws) -> Meadow:
    first, second = draws.bits(), draws.bits()
    places = [(first * (2 * k + 1) & 0xFFFFFFFF) * FIELD >> 32 for k in range(AGENTS)]
    return Meadow(places, [(second >> 4 * k & 7) + 1 for k in range(AGENTS)])


def meadow_masks(state: Meadow, agent: int) -> tuple[Word, ...]:
    place, energy = state.place[agent], state.energy[agent]
    left, right = place > 0, place < FIELD - 1
    if agent >= HARES:
        return 1, left, right, 0, 0
    return 1, left, right, energy > 3 and place < FIELD - 3, energy < 6


def meadow_step(
    state: Meadow, actions: Sequence[Word], draws: Draws
) -> tuple[Meadow, list[Word], list[Word]]:
    draw = draws.bits()
    places, energies = [*state.place], [*state.energy]
    # A dead agent's reward is of no interest, and here not even 0.
    rewards = [energy == 0 for energy in energies]
    for k, action in enumerate(actions):
        if energies[k] == 0:
            continue
        _, left, right, jump, rest = meadow_masks(state, k)
        hungry = (draw >> 3 * k & 7) < 3
        gain = -1 if hungry else 0
        if action == LEFT and left:
            places[k] -= 1
            rewards[k] = -1
        elif action == RIGHT and right:
            places[k] += 1
            rewards[k] = 2
        elif action == JUMP and jump:
            places[k] += 3
            gain -= 1
        elif action == REST and rest:
            gain += 2
        energies[k] = min(max(energies[k] + gain, 0), 15)
    return Meadow(places, energies), rewards, [energy == 0 for energy in energies]


def meadow_observe(state: Meadow, agent: int) -> MeadowView:
    place, energy = state.place[agent], state.energy[agent]
    if agent >= HARES:
        return MeadowView(place, energy, 0, 0)
    return MeadowView(place, energy, state.place[(agent + 1) % AGENTS], state.energy[HARES] + 16)


HARE = Role("hare", Box(0, 31, (4,), np.int16), Discrete(5))
SNAIL = Role("snail", Box(0, 15, (2,), np.int16), Discrete(3))

MEADOW = EnvSpec(
    name="Meadow",
    version=0,
    summary="Hares and snails feed until they are too weak",
    reward=Field("reward", 4, signed=True, fraction=1),
    rewards=None,
    observation_space=HARE.observation_space,
    action_space=Discrete(5),
    golden=Golden(Meadow, meadow_initial, meadow_step, meadow_observe, meadow_masks, MeadowView),
    agents=AGENTS,
    roles=(HARE, HARE, SNAIL, SNAIL),
    max_cycles=20,
)


class Nim(NamedTuple):
    """The counters that are left, and who takes some next."""

    heap: Bits[4]
    turn: Flag


class NimView(NamedTuple):
    """What both see."""

    heap: Bits[4]


NOTHING, WIN, LOSS = 0, 1, 2


def nim_initial(draws: Draws) -> Nim:
    draw = draws.bits()
    return Nim(5 + (draw * 8 >> 32), draw & 1)


def nim_masks(state: Nim, agent: int) -> list[Word]:
    return [state.turn == agent and state.heap > taken for taken in range(3)]


def nim_step(state: Nim, actions: Sequence[Word], draws: Draws) -> tuple[Nim, list[Word], list[Word]]:
    heap, turn = state
    left = heap - min(actions[turn] + 1, heap)
    over = left == 0
    rewards = [NOTHING, NOTHING]
    if over:
        # Who has moved into an empty heap wins.
        rewards = [LOSS, LOSS]
        rewards[turn] = WIN
    return Nim(left, 1 - turn), rewards, [over, over]


def nim_observe(state: Nim, agent: int) -> NimView:
    return NimView(state.heap)


NIM = EnvSpec(
    name="Nim",
    version=0,
    summary="Take 1 to 3 counters in turn; who takes the last one wins",
    action=Field("taken", 2),
    reward=Field("outcome", 2),
    rewards=(0.0, 1.0, -1.0),
    observation_space=Discrete(16),
    action_space=Discrete(3),
    golden=Golden(Nim, nim_initial, nim_step, nim_observe, nim_masks, NimView),
    agents=2,
    turns=True,
    masked="refused",
)

WORLDS: Sequence[EnvSpec] = (MEADOW, NIM)


def crowd(agents: int, masked: bool = True, pictures: bool = False) -> EnvSpec:
    """Return an environment of so many agents who count down, with a reward table."""

    class State(NamedTuple):
        counts: Array[Bits[4], agents]

    class View(NamedTuple):
        own: Bits[4]
        other: Bits[3]

    def initial(draws: Draws) -> State:
        draw = draws.bits()
        return State([(draw >> k % 29 & 7) + 1 for k in range(agents)])

    def step(state: State, actions: list[Word], draws: Draws) -> tuple[State, list[Word], list[Word]]:
        draw = draws.bits()
        # The dead count on, below 0 and round, which nobody sees; but an action does nothing for them.
        after = [
            (count - (draw >> k % 30 & 1) - (action == 2)) & 15
            for k, (count, action) in enumerate(zip(state.counts, actions, strict=True))
        ]
        rewards = [(count + 3 * action) % 5 for count, action in zip(after, actions, strict=True)]
        return State(after), rewards, [count == 0 for count in after]

    def observe(state: State, agent: int) -> View:
        own = state.counts[agent]
        return View(own, (own + state.counts[agent - 1]) & 7)

    def masks(state: State, agent: int) -> tuple[Word, ...]:
        own, other = observe(state, agent)
        return 1, other > 2, own > 4

    def unpack(own: Word, other: Word, row: Word) -> None:
        for k in range(6):
            row[k] = 1 + (own + other * k) % 3

    return EnvSpec(
        name="Crowd",
        version=agents,
        summary="Count down",
        rewards=(0.5, 1.0, -1.5, 4.0, 0.25),
        observation_space=Box(0, 3, (2, 3), np.uint8) if pictures else Box(0, 15, (2,), np.float32),
        action_space=Discrete(3),
        golden=Golden(State, initial, step, observe, masks if masked else None, View),
        agents=agents,
        unpack=unpack if pictures else None,
    )
