"""Slots with several agents: the rules of their ends, held against a model in plain Python."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete
from gymnasium.vector import AutoresetMode

from pearl_marl import get_spec, verification
from pearl_marl.batch import actions
from pearl_marl.batch.config import worlds_of
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.devices import BatchConfig, BatchStep, Cuda, Device, Lockstep, Native, Reference, Rtl, Sharded
from pearl_marl.errors import ActionError, ArgumentError, LockstepError
from pearl_marl.golden import call_reference, rng
from pearl_marl.spec import EnvSpec, Field, Role

from ..sampling import sampled
from ..toy_world import MEADOW, NIM, SNAIL, crowd
from .boards import OwnBoard
from .broken import Flips

WORLDS = 17
SAME, NEXT = AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP


class World:
    """One world of the meadow, by the rules and nothing else."""

    def __init__(self, spec: EnvSpec, slot: int, seed: int) -> None:
        self.spec, self.slot, self.seed = spec, slot, rng.seed_words(seed)
        self.next_step_resets = False
        self.start(0)

    def draws(self, tick: int, first: int, count: int) -> list[Any]:
        slots = np.array([self.slot])
        return [int(rng.draws(self.seed, slots, tick, first + k)[0]) for k in range(count)]

    def start(self, tick: int) -> None:
        draws = self.draws(tick, 0, self.spec.reset_draws)
        self.state = [int(word) for word in call_reference(self.spec.positional.initial, draws)]
        self.ended, self.elapsed = [False] * self.spec.agents, 0

    def observed(self, k: int) -> list[int]:
        return [int(word) for word in call_reference(self.spec.positional.observe, self.state, k)]

    def allowed(self, k: int) -> list[int]:
        assert self.spec.positional.masks is not None
        return [int(word) for word in call_reference(self.spec.positional.masks, self.state, k)]

    def step(self, actions: list[int], tick: int, mode: AutoresetMode) -> Iterator[dict[str, Any]]:
        """Yield what each agent gets."""
        spec, agents = self.spec, range(self.spec.agents)
        none = [0] * len(spec.observation), [0] * len(spec.mask_fields)
        if self.next_step_resets:
            self.next_step_resets = False
            self.start(tick)
            for k in agents:
                yield {"reward": 0, "ends": (False, False), "alive": True, "obs": self.observed(k),
                       "masks": self.allowed(k)}  # fmt: skip
            return
        draws = self.draws(tick, spec.reset_draws, spec.step_draws)
        words = [int(w) for w in call_reference(spec.positional.step, [*self.state, *actions, *draws])]
        count = len(spec.state)
        self.state, outcome = words[:count], words[count:]
        rewards, flags = outcome[: spec.agents], outcome[spec.agents :]
        self.elapsed += 1
        late = self.elapsed >= (spec.max_cycles or 1 << 40)
        before = self.ended
        self.ended = [was or bool(flag) for was, flag in zip(before, flags, strict=True)]
        over = all(self.ended) or late
        last = [self.observed(k) for k in agents]
        if over and mode is SAME:
            self.start(tick + 1)
        self.next_step_resets = over and mode is NEXT
        for k in agents:
            alive = over or not self.ended[k]
            yield {
                "reward": 0 if before[k] else rewards[k] * 2.0**-spec.reward.fraction,
                "ends": (bool(flags[k]) and not before[k], late and not before[k]),
                "final": last[k],
                "alive": alive,
                "obs": self.observed(k) if alive else none[0],
                "masks": self.allowed(k) if alive else none[1],
            }


def open_device(device: Device, spec: EnvSpec = MEADOW, mode: AutoresetMode = SAME, **config: Any) -> Device:
    device.open(BatchConfig(**{"spec": spec, "n_envs": WORLDS, "autoreset_mode": mode, **config}))
    device.reset(seed=5)
    return device


def random_actions(device: Device, chance: np.random.Generator) -> Any:
    """Return actions of each agent's role, masked or not."""
    spec = device.config.spec
    most = [role.action_space.n for role in spec.roles] or [spec.action_space.n] * spec.agents
    return chance.integers(np.tile(most, device.config.n_envs)).astype(spec.action.dtype)


DEVICES = {
    "reference": Reference,
    "native": Native,
    "sharded": lambda: Sharded([Reference(), Native()], [3, WORLDS - 3]),
    "lockstep": lambda: Lockstep("native", "reference"),
    "rtl": lambda: Rtl(pe_num=3),
    "xdma": lambda: OwnBoard(3),
    "cuda": Cuda,
}


@pytest.fixture(params=DEVICES)
def device(request: pytest.FixtureRequest) -> Iterator[Device]:
    made = DEVICES[request.param]()
    yield made
    made.close()


# The compiled loops and the hardware know of modes; those that share slots or compare do not.
BY_MODE = [(name, mode) for name in DEVICES for mode in (SAME, NEXT)]


@pytest.mark.parametrize(
    ("device", "mode"),
    sampled(BY_MODE, [pair for pair in BY_MODE if pair[1] is SAME or pair[0] in ("native", "rtl", "cuda")]),
    indirect=["device"],
)
def test_every_world_goes_by_the_rules(device: Device, mode: AutoresetMode) -> None:
    open_device(device, mode=mode)
    worlds = [World(MEADOW, slot, 5) for slot in range(WORLDS)]
    chance = np.random.default_rng(1)
    died = truncated = 0
    for tick in range(60):
        actions = random_actions(device, chance)
        step = device.step(actions)
        assert step.action_masks is not None
        assert step.action_masks is device.action_masks
        for w, world in enumerate(worlds):
            told = world.step(actions[4 * w : 4 * w + 4].tolist(), tick, mode)
            for i, one in enumerate(told, 4 * w):
                assert step.rewards[i] == one["reward"], (tick, i)
                assert (step.terminations[i], step.truncations[i]) == one["ends"], (tick, i)
                assert step.obs[i].tolist() == one["obs"], (tick, i)
                assert step.action_masks[i].tolist() == one["masks"], (tick, i)
                assert step.in_episode[i] == device.in_episode[i] == one["alive"], (tick, i)
                if any(one["ends"]):
                    assert step.final_obs[i].tolist() == one["final"], (tick, i)
                died += not one["alive"]
                truncated += one["ends"][1]
    assert died > 100
    assert truncated > 10


@pytest.mark.parametrize("mode", [SAME, NEXT], ids=["same", "next"])
def test_a_restored_state_shows_what_was_seen_and_goes_on(device: Device, mode: AutoresetMode) -> None:
    open_device(device, mode=mode)
    chance = np.random.default_rng(2)
    for _ in range(9):
        step = device.step(random_actions(device, chance))
    assert not step.in_episode.all()
    seen = [array.copy() for array in step.observed]
    saved = SavedState.from_bytes(device.snapshot().to_bytes(), device.config)
    rows = [random_actions(device, chance) for _ in range(12)]
    expected = [device.step(row).map(np.copy) for row in rows]
    again = Reference().open(device.config)
    found = [again.restore(saved), again.action_masks, again.in_episode]
    for ours, theirs in zip(found, seen, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    for row, one in zip(rows, expected, strict=True):
        assert_same(again.step(row), one)


CROWDS = {
    "one with masks": crowd(1),
    "one without": crowd(1, masked=False),
    "two without masks": crowd(2, masked=False),
    "pictures": crowd(3, pictures=True),
    "pictures without masks": crowd(2, masked=False, pictures=True),
    "as many as fit a byte": crowd(7),
    "in lanes": crowd(20),
    "pictures in lanes": crowd(17, pictures=True),
}


@pytest.mark.parametrize("name", sampled(CROWDS, ("one with masks", "pictures", "in lanes")))
@pytest.mark.parametrize(
    "config",
    [
        {"autoreset_mode": SAME, "max_cycles": 7},
        pytest.param(
            {"autoreset_mode": NEXT, "max_cycles": 7, "initial_states": "stored"},
            marks=pytest.mark.exhaustive,
        ),
        pytest.param(
            {"autoreset_mode": SAME, "initial_states": "stored", "copy": False}, marks=pytest.mark.exhaustive
        ),
        pytest.param({"autoreset_mode": NEXT}, marks=pytest.mark.exhaustive),
    ],
    ids=["same limited", "next limited stored", "same stored", "next"],
)
def test_worlds_of_all_sizes_agree_with_the_reference(name: str, config: dict[str, Any]) -> None:
    device = open_device(Lockstep("native", "reference"), CROWDS[name], n_envs=2100, **config)
    chance = np.random.default_rng(4)
    for tick in range(9):
        device.step(random_actions(device, chance))
        if tick == 4:
            device.reset(mask=chance.random(2100) < 0.5)
        if tick == 6:
            device.restore(device.snapshot())
    device.close()


@pytest.mark.parametrize("mode", [SAME, NEXT], ids=["same", "next"])
@pytest.mark.parametrize("name", ["pictures", "one with masks"])
@pytest.mark.parametrize("where", ["rtl", "cuda"])
def test_what_golden_functions_say_of_the_dead_does_not_matter(
    where: str, name: str, mode: AutoresetMode
) -> None:
    """Here they say all sorts of things, and that they are alive again."""
    device = Lockstep(DEVICES[where](), "reference")
    open_device(device, CROWDS[name], mode, n_envs=20, max_cycles=15)
    chance = np.random.default_rng(6)
    for tick in range(25):
        device.step(random_actions(device, chance))
        if tick == 12:
            device.reset(mask=chance.random(20) < 0.5)
        if tick == 17:
            device.restore(device.snapshot())
    device.close()


def test_a_word_that_differs_is_told_with_its_agent() -> None:
    device = open_device(Lockstep(Flips("rewards", tick=3, slot=6), "reference"))
    chance = np.random.default_rng(7)
    for _ in range(3):
        device.step(random_actions(device, chance))
    actions = random_actions(device, chance)
    with pytest.raises(LockstepError) as caught:
        device.step(actions)
    error = caught.value
    assert (error.step, error.slot, error.field) == (3, 1, "agent 2: rewards")
    assert error.divergence.action == actions[4:8].tolist()
    alone = error.replay.alone()
    assert alone.config.n_envs == 1
    assert verification.replay(alone, Lockstep("native", "reference")) is None
    device.close()


def test_results_that_nobody_keeps_are_used_again() -> None:
    """What a device remembers of them is its own, and stays as it is for who keeps it."""
    spec = get_spec("ConnectFour")
    device = Native().open(BatchConfig(spec=spec, n_envs=2000))
    device.reset(seed=0)
    chance = np.random.default_rng(0)
    places, kept, copies = set(), [], []
    for _ in range(6):
        masks = device.action_masks
        assert masks is not None
        kept.append(masks)
        copies.append(masks.copy())
        places.add(device.step(actions.random_actions(spec, chance, 4000, masks)).obs.ctypes.data)
    assert len(places) == 1
    np.testing.assert_array_equal(kept, copies)
    device.close()


def test_agents_come_in_whole_worlds() -> None:
    assert worlds_of(MEADOW, 12) == 3
    for n, fit in ((10, "8 and 12"), (3, "4 and 8")):
        with pytest.raises(ArgumentError, match=rf"{n}, and a world of Meadow has 4 agents; {fit} fit$"):
            worlds_of(MEADOW, n)


def test_a_device_that_recovers_knows_who_is_alive() -> None:
    device = open_device(Sharded(["native", "native"], checkpoint_every=4))
    twin = open_device(Reference())
    chance = np.random.default_rng(8)
    for _ in range(9):
        actions = random_actions(device, chance)
        device.step(actions)
        twin.step(actions)
    device.in_episode = np.ones_like(device.in_episode)
    device.recover()
    np.testing.assert_array_equal(device.in_episode, twin.in_episode)
    np.testing.assert_array_equal(device.action_masks, twin.action_masks)
    actions = random_actions(device, chance)
    assert_same(device.step(actions), twin.step(actions))
    device.close()


def assert_same(ours: BatchStep, theirs: BatchStep) -> None:
    for mine, other in zip(
        ours.arrays[:4] + ours.arrays[5:], theirs.arrays[:4] + theirs.arrays[5:], strict=True
    ):
        np.testing.assert_array_equal(mine, other)
    np.testing.assert_array_equal(ours.final_obs[theirs.ended], theirs.final_obs[theirs.ended])


def test_masked_resets_are_of_worlds(device: Device) -> None:
    open_device(device)
    chance = np.random.default_rng(3)
    while device.in_episode.reshape(WORLDS, 4).all(1).any():
        device.step(random_actions(device, chance))
    mask = np.arange(WORLDS) % 2 == 0
    dead = ~device.in_episode.reshape(WORLDS, 4)[~mask]
    device.reset(mask=mask)
    assert device.in_episode.reshape(WORLDS, 4)[mask].all()
    assert (device.in_episode.reshape(WORLDS, 4)[~mask] == ~dead).all()
    with pytest.raises(ArgumentError, match=r"bool of shape \(17,\)"):
        device.reset(mask=np.ones(4 * WORLDS, np.bool_))


def test_actions_are_those_of_the_agents_role() -> None:
    device = open_device(Reference())
    actions = np.zeros(4 * WORLDS, np.uint8)
    actions[1] = 4
    device.step(actions)
    actions[6] = 3
    before = device.snapshot().to_bytes()
    with pytest.raises(ActionError, match=r"agent_6: action 3 is out of range; .* from 0 to 2"):
        device.step(actions)
    assert device.snapshot().to_bytes() == before


def test_masked_actions_are_refused_where_the_spec_says_so() -> None:
    device = open_device(Reference(), NIM, first_slot=3)
    assert device.action_masks is not None
    while device.action_masks.any(1).sum() == (device.action_masks.sum(1) == 3).sum():
        device.step(np.zeros(2 * WORLDS, np.uint8))
    actions = np.where(device.action_masks.any(1), 0, 2)  # who waits may send anything
    i = int(np.flatnonzero(device.action_masks.any(1) & (device.action_masks[:, 2] == 0))[0])
    actions[i] = 2
    before = device.snapshot().to_bytes()
    with pytest.raises(ActionError, match=rf"agent_{6 + i}: action 2 is masked; it may take 0"):
        device.step(actions)
    assert device.snapshot().to_bytes() == before


def wrong(error: str, base: EnvSpec = MEADOW, **changes: Any) -> None:
    with pytest.raises(ArgumentError, match=error):
        replace(base, **changes)


def test_what_a_spec_may_not_say() -> None:
    wrong(r"agents is 64; it must be an integer from 1 to 63", agents=64)
    wrong(r"agents is True", agents=True)
    wrong(r"masked is 'no'; possible are 'stay' and 'refused'", masked="no")
    bare = MEADOW.golden._replace(masks=None)
    wrong(r"turns=True goes by masks; give Golden\(..., masks=...\)", golden=bare, turns=True)
    wrong(r"masked='refused' goes by masks", golden=bare, masked="refused")
    wrong(r"3 roles for 4 agents", roles=MEADOW.roles[:3])
    wide = Role("bird", Box(0, 31, (5,), np.int16), Discrete(5))
    wrong(r"the observation space of role 'bird' is .*, which is no part of", roles=(wide, *MEADOW.roles[1:]))
    many = Role("bird", SNAIL.observation_space, Discrete(6))
    wrong(r"the action space of role 'bird' is Discrete\(6\)", roles=(many, *MEADOW.roles[1:]))
    wrong(
        r"two observation fields are named 'mask_1'",
        observation=(*MEADOW.observation[:3], Field("mask_1", 5)),
    )
    beyond = (
        r"(other|mask_3) of agent 0, and role 'snail' has \d (elements|actions), so the others hold 0 to 0"
    )
    wrong(beyond, roles=(SNAIL,) * 4)


def test_golden_functions_are_traced_for_every_agent() -> None:
    def observe(state: Any, agent: int) -> Any:
        snail = state.energy[2] + (16 if agent == 3 else 0)
        return state.place[agent], state.energy[0], state.energy[1], snail

    narrow = (*MEADOW.observation[:3], Field("snail", 4))
    golden = MEADOW.golden._replace(observe=observe)
    wrong(r"returns 16 to 31 for snail of agent 3, and 4 bits", golden=golden, observation=narrow, roles=())

    def step(state: Any, actions: Any) -> Any:
        return state, [0, 0], [0, 0]

    wrong(r"step\(\) is called with \(state, actions, draws\): too many", NIM,
          golden=NIM.golden._replace(step=step))  # fmt: skip

    def short(state: Any, actions: Any, draws: Any) -> Any:
        return state, [0, 0], [0]

    wrong(r"step\(\) returns \[0\] for its flags of termination; there are 2 agents", NIM,
          golden=NIM.golden._replace(step=short))  # fmt: skip

    def alone(state: Any) -> Any:
        return state.heap

    wrong(r"alone\(\) is called with \(state, agent\): too many", NIM,
          golden=NIM.golden._replace(observe=alone))  # fmt: skip

    def flags(state: Any, agent: int) -> Any:
        return 2, 1, 0

    wrong(
        r"flags\(\) returns 2 for mask_0 of agent 0, and 1 bit holds 0 to 1",
        NIM,
        golden=NIM.golden._replace(masks=flags),
    )
