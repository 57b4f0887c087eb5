"""Two environments whose slots are worlds of several agents.

``Meadow``
    Four agents of two roles: hares, with five actions and four words of observation, and snails, with three
    and two. Energies run out one by one, so agents end before their world; there are masks, draws in every
    step, and computed rewards. What is masked leaves an agent where it is.
``Nim``
    Two agents take 1 to 3 counters in turn, and who takes the last one wins. Who is not on turn has no action
    to choose; a masked one is refused.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium.spaces import Box, Discrete

from pearl_marl import EnvSpec
from pearl_marl.golden import Word, uniform_below
from pearl_marl.spec import Field, Golden, Role

AGENTS = 4
HARES = 2
"""Agents 0 and 1; the others are snails."""
FIELD = 12
STAY, LEFT, RIGHT, JUMP, REST = range(5)


def meadow_initial(first: Word, second: Word) -> tuple[Word, ...]:
    places = [uniform_below(first * (2 * k + 1) & 0xFFFFFFFF, FIELD) for k in range(AGENTS)]
    return *places, *((second >> 4 * k & 7) + 1 for k in range(AGENTS))


def meadow_masks(*state_and_agent: Word) -> tuple[Word, ...]:
    *state, agent = state_and_agent
    place, energy = state[agent], state[AGENTS + agent]
    left, right = place > 0, place < FIELD - 1
    if agent >= HARES:
        return 1, left, right, 0, 0
    return 1, left, right, (energy > 3) & (place < FIELD - 3), energy < 6


def meadow_step(*words: Word) -> tuple[Word, ...]:
    state, actions, (draw,) = words[: 2 * AGENTS], words[2 * AGENTS : 3 * AGENTS], words[3 * AGENTS :]
    places, energies, rewards = [], [], []
    for k in range(AGENTS):
        place, energy, action = state[k], state[AGENTS + k], actions[k]
        allowed = meadow_masks(*state, k)
        lives = energy > 0
        moves = [(action == a) & allowed[a] & lives for a in range(5)]
        place = place - moves[LEFT] + moves[RIGHT] + 3 * moves[JUMP]
        hungry = (draw >> 3 * k & 7) < 3
        energy = energy - (lives & hungry) + 2 * moves[REST] - moves[JUMP]
        energy = np.clip(energy, 0, 15)
        places.append(np.minimum(place, 15))
        energies.append(energy)
        # A dead agent's reward is of no interest, and here not even 0.
        rewards.append(2 * moves[RIGHT] - moves[LEFT] + (lives == 0))
    ends = [energy == 0 for energy in energies]
    return *places, *energies, *rewards, *ends


def meadow_observe(*state_and_agent: Word) -> tuple[Word, ...]:
    *state, agent = state_and_agent
    own = state[agent], state[AGENTS + agent]
    if agent >= HARES:
        return *own, 0, 0
    return *own, state[(agent + 1) % AGENTS], state[AGENTS + HARES] + 16


def _fields(name: str) -> tuple[Field, ...]:
    return tuple(Field(f"{name}_{k}", 4) for k in range(AGENTS))


HARE = Role("hare", Box(0, 31, (4,), np.int16), Discrete(5))
SNAIL = Role("snail", Box(0, 15, (2,), np.int16), Discrete(3))

MEADOW = EnvSpec(
    name="Meadow",
    version=0,
    summary="Hares and snails feed until they are too weak",
    state=(*_fields("place"), *_fields("energy")),
    action=Field("action", 3),
    observation=(Field("place", 4), Field("energy", 4), Field("other", 4), Field("snail", 5)),
    reward=Field("reward", 4, signed=True, fraction=1),
    rewards=None,
    observation_space=HARE.observation_space,
    action_space=Discrete(5),
    golden=Golden(meadow_initial, meadow_step, meadow_observe, meadow_masks),
    agents=AGENTS,
    roles=(HARE, HARE, SNAIL, SNAIL),
    reset_draws=2,
    step_draws=1,
    max_cycles=20,
)


def nim_initial(draw: Word) -> tuple[Word, ...]:
    return 5 + uniform_below(draw, 8), draw & 1


def nim_masks(heap: Word, turn: Word, agent: int) -> tuple[Word, ...]:
    return tuple((turn == agent) & (heap > taken) for taken in range(3))


def nim_step(heap: Word, turn: Word, *actions: Word) -> tuple[Word, ...]:
    taken = np.minimum(np.where(turn, actions[1], actions[0]) + 1, heap)
    left = heap - taken
    over = left == 0
    # Win, loss, or nothing yet: who has moved into an empty heap wins.
    rewards = [np.where(over, np.where(turn == k, 1, 2), 0) for k in range(2)]
    return left, turn ^ 1, *rewards, over, over


def nim_observe(heap: Word, turn: Word, agent: int) -> Word:
    return heap


NIM = EnvSpec(
    name="Nim",
    version=0,
    summary="Take 1 to 3 counters in turn; who takes the last one wins",
    state=(Field("heap", 4), Field("turn", 1)),
    action=Field("taken", 2),
    observation=(Field("heap", 4),),
    reward=Field("outcome", 2),
    rewards=(0.0, 1.0, -1.0),
    observation_space=Discrete(16),
    action_space=Discrete(3),
    golden=Golden(nim_initial, nim_step, nim_observe, nim_masks),
    agents=2,
    turns=True,
    masked="refused",
    reset_draws=1,
)

WORLDS: Sequence[EnvSpec] = (MEADOW, NIM)


def crowd(agents: int, masked: bool = True, pictures: bool = False) -> EnvSpec:
    """Return an environment of so many agents who count down, with a reward table."""

    def initial(draw: Word) -> tuple[Word, ...]:
        return tuple((draw >> k % 29 & 7) + 1 for k in range(agents))

    def step(*words: Word) -> tuple[Word, ...]:
        counts, actions, draw = words[:agents], words[agents:-1], words[-1]
        # The dead count on, below 0 and round, which nobody sees; but an action does nothing for them.
        after = [
            (count - (draw >> k % 30 & 1) - (action == 2)) & 15
            for k, (count, action) in enumerate(zip(counts, actions, strict=True))
        ]
        return (
            *after,
            *((count + 3 * action) % 5 for count, action in zip(after, actions, strict=True)),
            *(count == 0 for count in after),
        )

    def observe(*state_and_agent: Word) -> tuple[Word, ...]:
        state, agent = (state_and_agent, 0) if agents == 1 else (state_and_agent[:-1], state_and_agent[-1])
        return state[agent], (state[agent] + state[agent - 1]) & 7

    def masks(*state_and_agent: Word) -> tuple[Word, ...]:
        own, other = observe(*state_and_agent)
        return 1, other > 2, own > 4

    def unpack(own: Word, other: Word, row: Word) -> None:
        for k in range(6):
            row[k] = 1 + (own + other * k) % 3

    return EnvSpec(
        name="Crowd",
        version=agents,
        summary="Count down",
        state=tuple(Field(f"count_{k}", 4) for k in range(agents)),
        action=Field("action", 2),
        observation=(Field("own", 4), Field("other", 3)),
        reward=Field("category", 3),
        rewards=(0.5, 1.0, -1.5, 4.0, 0.25),
        observation_space=Box(0, 3, (2, 3), np.uint8) if pictures else Box(0, 15, (2,), np.float32),
        action_space=Discrete(3),
        golden=Golden(initial, step, observe, masks if masked else None),
        agents=agents,
        unpack=unpack if pictures else None,
        reset_draws=1,
        step_draws=1,
    )
