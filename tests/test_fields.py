"""Actions of several fields, by every interface and on every device; observations of several numbers.

``tests/contract`` has the contract over the same environments; here is what that does not ask.
"""

from __future__ import annotations

import copy
import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, MultiBinary, MultiDiscrete
from gymnasium.vector import AutoresetMode

import pearl_marl
from pearl_marl import verification, wrappers
from pearl_marl.batch.actions import encode, limits, random_actions, random_numbers, room_for_words, why_not
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.compiler.cores import generated_core
from pearl_marl.devices import BatchConfig, Cuda, Device, Lockstep, Native, Reference, Rtl, Sharded
from pearl_marl.devices.replay import Replay
from pearl_marl.errors import ActionError, ArgumentError, LockstepError, SavedStateError
from pearl_marl.hardware.elaboration import TARGET
from pearl_marl.memory_map import stream_bits
from pearl_marl.policies.loading import load_policy
from pearl_marl.spec import EnvSpec, Field
from pearl_marl.spec.elements import action_counts, are_numbers, bounds

from .devices.boards import OwnBoard
from .devices.broken import Flips
from .toy import SLIDE
from .toy_fields import FIELDS, GLIDER, LAMPS, RELAY, ROVER, Rover

N = 70
"""Slots, as many as the contract has of a simulated device, so that one model serves both."""

pytestmark = pytest.mark.usefixtures("toys")


def words_of(spec: EnvSpec, steps: int, seed: int = 0, n: int = N) -> list[Any]:
    chance = np.random.default_rng(seed)
    return [random_actions(spec, chance, n * spec.agents) for _ in range(steps)]


def opened(device: Device, spec: EnvSpec, n: int = N, **config: Any) -> Device:
    device.open(BatchConfig(spec=spec, n_envs=n, **config))
    device.reset(seed=3)
    return device


ELSEWHERE: dict[str, tuple[Callable[[], Device], tuple[EnvSpec, ...]]] = {
    "native": (lambda: Native(2), FIELDS),
    "cuda": (Cuda, FIELDS),
    "rtl": (lambda: Rtl(pe_num=3), (LAMPS, GLIDER)),
    "xdma": (lambda: OwnBoard(3), (ROVER, RELAY)),
    "sharded": (lambda: Sharded([Reference(), Native()], [33, N - 33]), FIELDS),
}
PAIRS = [(name, spec) for name, (_, specs) in ELSEWHERE.items() for spec in specs]
SAME, NEXT = AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP


@pytest.mark.parametrize(
    "mode", [SAME, pytest.param(NEXT, marks=pytest.mark.exhaustive)], ids=["same", "next"]
)
@pytest.mark.parametrize(("name", "spec"), PAIRS, ids=[f"{name}-{spec.name}" for name, spec in PAIRS])
def test_every_device_does_the_same(name: str, spec: EnvSpec, mode: AutoresetMode) -> None:
    lockstep = opened(Lockstep(ELSEWHERE[name][0](), "reference"), spec, autoreset_mode=mode)
    for actions in words_of(spec, 30):
        lockstep.step(actions)
    lockstep.restore(lockstep.snapshot())
    lockstep.send(words_of(spec, 1)[0])
    lockstep.recv()
    lockstep.close()


def test_a_word_is_its_fields_side_by_side() -> None:
    assert [stream_bits(spec)["actions"] for spec in FIELDS] == [11, 3, 19, 8]
    assert [str(spec.action_dtype) for spec in FIELDS] == ["uint16", "uint8", "int16", "uint8"]
    assert room_for_words(ROVER, 4).shape == (4, 2)
    assert room_for_words(SLIDE, 4).shape == (4,)
    names = [field.name for field in RELAY.each_agent(*RELAY.action_fields)]
    assert names == ["go_0", "pass_on_0", "go_1", "pass_on_1"]
    text = generated_core(RELAY, TARGET).text
    assert "input action_t [1:0] action_i" in text
    assert "    logic pass_on;\n    logic [2:0] go;\n  } action_t;" in text
    assert "action_t" not in generated_core(pearl_marl.get_spec("CliffWalking"), TARGET).text


def test_numbers_become_the_nearest_words_of_their_fields() -> None:
    given = np.array([[0, -1.5], [3, 1.5], [1.02, 0.003]], np.float32)
    words = encode(given, GLIDER, room_for_words(GLIDER, 3))
    assert words.tolist() == [[0, -384], [96, 384], [33, 1]]
    for same in (given.astype(np.float64), given.tolist(), np.asfortranarray(given), given[::-1][::-1]):
        np.testing.assert_array_equal(encode(same, GLIDER, room_for_words(GLIDER, 3)), words)


def test_the_field_of_what_is_refused_is_named_and_nothing_moves() -> None:
    cases: list[tuple[EnvSpec, Any, str]] = [
        (ROVER, [2, 400], r"\[2, 400\] is out of range: speed is 400, and 0 to 399 is possible; MultiDiscrete"
         r"\(\[  3 400\]\) takes arrays of shape \(2,\) with integers from 0 to \[2, 399\]"),
        (ROVER, [-1, 0], r"direction is -1, and 0 to 2 is possible"),
        (ROVER, [1.0, 2.0], r"is no integers in an array of shape \(2,\)"),
        (LAMPS, [0, 1, 2], r"switch_right is 2, and 0 to 1 is possible; MultiBinary\(3\) takes .* 0 to 1"),
        (GLIDER, [1.0, 1.75], r"turn is 1.75, and -1.5 to 1.5 is possible; Box.* takes .*numbers from "
         r"\[0.0, -1.5\] to \[3.0, 1.5\]"),
        (GLIDER, [float("nan"), 0.0], r"thrust is nan, and 0.0 to 3.0 is possible"),
        (RELAY, [5, 1], r"go is 5, and 0 to 4 is possible"),
    ]  # fmt: skip
    for spec, wrong, why in cases:
        device = opened(Native(), spec, n=4, first_slot=5)
        before = device.snapshot().to_bytes()
        good = words_of(spec, 1, n=4)[0].tolist()
        agent = 5 * spec.agents + 3
        with pytest.raises(ActionError, match=rf"^agent_{agent}: action .*{why}"):
            device.step([*good[:3], wrong, *good[4:]])
        assert device.snapshot().to_bytes() == before
        flat = [0] * (4 * spec.agents)
        for shape in (flat, np.zeros((4 * spec.agents, 1)), np.zeros((3, len(spec.action_fields)))):
            with pytest.raises(ActionError, match=r"actions have shape .* take \(\d+, \d\)"):
                device.step(shape)
        assert device.snapshot().to_bytes() == before
        device.close()


def test_a_slot_that_only_resets_may_send_anything() -> None:
    device = opened(Native(), ROVER, autoreset_mode=AutoresetMode.NEXT_STEP, max_cycles=1)
    twin = opened(Reference(), ROVER, autoreset_mode=AutoresetMode.NEXT_STEP, max_cycles=1)
    odd = np.full((N, 2), -9)
    for t, actions in enumerate(words_of(ROVER, 4)):
        given = odd if t % 2 else actions
        np.testing.assert_array_equal(device.step(given).obs, twin.step(actions).obs)
    with pytest.raises(ActionError, match=r"agent_0: .* direction is -9"):
        device.step(odd)


def test_dicts_and_agents_one_by_one() -> None:
    env, twin = (pearl_marl.parallel_env("Relay", 8) for _ in range(2))
    env.reset(seed=1)
    twin.reset_batch(seed=1)
    for actions in words_of(RELAY, 25, n=4):
        # One may give a list, a tuple or an array.
        kinds = [list, tuple, np.array, np.int16]
        given = {
            agent: kinds[i % 4](row) for i, (agent, row) in enumerate(zip(env.agents, actions, strict=True))
        }
        seen = env.step(given)[0]
        step = twin.step_batch(actions)
        np.testing.assert_array_equal(np.stack(list(seen.values())), step.obs)
        assert all(seen[agent] in env.observation_space(agent) for agent in env.agents)
    with pytest.raises(ActionError, match=r"agent_0: action 1 is no integers in an array of shape \(2,\)"):
        env.step(dict.fromkeys(env.agents, 1))
    one = pearl_marl.env("Rover", n_agents=2)
    one.reset(seed=0)
    with pytest.raises(ActionError, match=r"agent_0: action \[0, 400\] .* speed is 400"):
        one.step([0, 400])
    one.step([0, 399])
    assert one.agent_selection == "agent_1"


def test_agents_that_have_left_need_no_action() -> None:
    env = pearl_marl.parallel_env("Lamps", 40, autoreset=False)
    env.reset(seed=0)
    for actions in words_of(LAMPS, 11, n=40):
        given = {agent: actions[env.rows[agent]] for agent in env.agents}
        env.step(given)
        if 0 < env.num_agents < 40:
            break
    else:
        pytest.fail("none has left alone")
    odd = np.full((40, 3), 7)
    odd[[env.rows[agent] for agent in env.agents]] = 1
    env.step(odd)


def test_random_actions_are_everywhere_in_their_space() -> None:
    chance = np.random.default_rng(0)
    for spec in FIELDS:
        low, high = bounds(spec.action_space)
        drawn = random_actions(spec, chance, 20_000)
        mixed = random_numbers(spec.action_space, chance.integers(1 << 32, size=20_000, dtype=np.uint32))
        for actions in (drawn, mixed):
            assert actions.shape == (20_000, len(low))
            assert all(row in spec.action_space for row in actions[:50].astype(spec.action_space.dtype))
            near = (high - low) * 0.02
            assert (np.abs(actions.min(0) - low) <= near).all()
            assert (np.abs(actions.max(0) - high) <= near).all()
            # Each field for itself.
            apart = np.corrcoef(actions.T.astype(float)) - np.eye(len(low))
            assert np.abs(apart).max() < 0.05
    numbers = np.array([0, 1 << 31, (1 << 32) - 1], np.uint32)
    assert random_numbers(Box(-1, 1, (1,)), numbers).ravel().tolist() == [-1, 0, 1]
    assert random_numbers(MultiDiscrete([4, 4], start=[2, 0]), numbers)[:, 0].tolist() == [2, 4, 5]


def test_what_spaces_can_be() -> None:
    assert action_counts(MultiDiscrete([3, 4])) == (3, 4)
    assert action_counts(MultiBinary(2)) == (2, 2)
    assert action_counts(Discrete(5)) == (5,)
    for none in (
        Discrete(3, start=1),
        MultiDiscrete([2, 2], start=[0, 1]),
        MultiBinary((2, 2)),
        Box(0, 1, (2,)),
    ):
        assert action_counts(none) == ()
    assert are_numbers(MultiBinary(2))
    assert not are_numbers(Box(0, 1, (2,)))
    assert "integers from 0 to [2, 3]" in limits(MultiDiscrete([3, 4]))
    assert why_not([0, 3], MultiDiscrete([3, 4])) == ""
    assert (
        why_not(np.array([0, 4]), MultiDiscrete([3, 4]))
        == "is out of range: element 1 is 4, and 0 to 3 is possible"
    )
    assert why_not([True, False], MultiBinary(2)) == "is no integers in an array of shape (2,)"


def test_one_field_of_an_array_is_a_column() -> None:
    """With a tuple of one field, and with that field itself."""
    steps = []
    for action in (Field("way", 3), (Field("way", 3),)):
        single = replace(SLIDE, action=(Field("push", 10, signed=True, fraction=6),))
        assert single.behaviour == SLIDE.behaviour
        spec = replace(ROVER, name="Lane", action=action, action_space=MultiDiscrete([5]),
                       golden=ROVER.golden._replace(step=_lane))  # fmt: skip
        device = opened(Lockstep("native", "reference"), spec)
        actions = words_of(spec, 1)[0]
        assert actions.shape == (N, 1)
        steps.append(device.step(actions).obs)
        with pytest.raises(ActionError, match=r"agent_3: action \[5\] is out of range; MultiDiscrete"):
            device.step([*actions[:3], [5], *actions[4:]])
        with pytest.raises(ActionError, match=r"actions have shape \(70,\)"):
            device.step(actions[:, 0])
    np.testing.assert_array_equal(*steps)


def _lane(state: Rover, way: Any, draws: Any) -> Any:
    return state._replace(column=min(state.column + way, 11)), 0, 0


def test_saved_states_go_on_elsewhere() -> None:
    env = pearl_marl.parallel_env("Rover", N)
    env.reset_batch(seed=0)
    actions = words_of(ROVER, 12)
    for row in actions[:6]:
        env.step_batch(row)
    saved = env.save_state()
    others = [pearl_marl.parallel_env("Rover", N, device=device) for device in ("reference", Cuda())]
    for other in (*others, copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        other.load_state(saved)
        for row in actions[6:]:
            other.step_batch(row)
    for row in actions[6:]:
        env.step_batch(row)
    assert len({other.save_state() for other in (env, *others)}) == 1


def test_a_saved_state_shows_what_its_space_has() -> None:
    device = opened(Native(), ROVER)
    saved = device.snapshot()
    saved.memory[:N] = 13  # the rows, of 4 bits
    blob = saved.to_bytes()
    with pytest.raises(SavedStateError, match=r"the row 13; Rover has 0 to 11"):
        SavedState.from_bytes(blob, device.config)


@pytest.mark.parametrize("spec", FIELDS, ids=lambda spec: spec.name)
def test_a_divergence_is_told_with_its_fields_and_replayed(spec: EnvSpec, tmp_path: Path) -> None:
    device = opened(Lockstep(Flips("rewards", tick=3, slot=3 * spec.agents), "reference"), spec)
    steps = words_of(spec, 4)
    for actions in steps[:3]:
        device.step(actions)
    with pytest.raises(LockstepError) as caught:
        device.step(steps[3])
    error = caught.value
    rows = slice(3 * spec.agents, 4 * spec.agents)
    words = encode(steps[3], spec, room_for_words(spec, len(steps[3])))[rows]
    values = words * 2.0 ** -np.array([field.fraction for field in spec.action_fields])
    assert error.divergence.action == values.ravel().tolist()
    alone = error.replay.alone()
    np.testing.assert_array_equal(alone.actions, words)
    alone.write(tmp_path / "replay.json")
    again = Replay.read(tmp_path / "replay.json")
    assert again.actions is not None
    np.testing.assert_array_equal(again.actions, words)
    assert verification.replay(again, Lockstep("native", "reference")) is None


def test_gymnasiums_form() -> None:
    envs = gymnasium.make_vec("Pearl/Rover-v0", num_envs=9, vectorization_mode="vector_entry_point")
    assert envs.single_action_space == ROVER.action_space
    assert envs.single_observation_space == MultiDiscrete([12, 12, 2])
    envs.action_space.seed(0)
    obs, _ = envs.reset(seed=0)
    for _ in range(25):
        assert obs in envs.observation_space
        obs = envs.step(envs.action_space.sample())[0]
    envs.close()


class TestWrappers:
    def test_of_actions(self) -> None:
        given = np.array([[0, 120.0], [np.nan, 5], [2, 399]])
        noop, twin = (
            wrappers.nan_noop_v0(pearl_marl.parallel_env("Rover", 3), [1, 7]),
            pearl_marl.parallel_env("Rover", 3),
        )
        noop.reset_batch(seed=0)
        twin.reset_batch(seed=0)
        np.testing.assert_array_equal(
            noop.step_batch(given).obs, twin.step_batch(np.array([[0, 120], [1, 7], [2, 399]])).obs
        )
        with pytest.raises(ActionError, match=r"agent_0: action \[0.5, 1.0\]"):
            noop.step_batch([[0.5, 1.0], [0, 0], [0, 0]])
        with pytest.raises(ArgumentError, match=r"no_op_action is \[3, 0\]"):
            wrappers.nan_noop_v0(pearl_marl.parallel_env("Rover", 3), [3, 0])
        for wrap in (wrappers.nan_random_v0, wrappers.nan_zeros_v0):
            env = wrap(pearl_marl.parallel_env("Lamps", 4))
            env.reset_batch(seed=0)
            env.step_batch(np.full((4, 3), np.nan))

    def test_sticky_actions(self) -> None:
        env = wrappers.sticky_actions_v0(pearl_marl.parallel_env("Glider", 500), 0.5)
        env.reset_batch(seed=0)
        env.step_batch(np.tile(np.float32([3, 1.5]), (500, 1)))
        before = env.state()
        env.step_batch(np.tile(np.float32([0, -1.5]), (500, 1)))
        # No edge stops who is in the middle.
        moved = (env.state() - before)[np.abs(before[:, 0]) < 1000]
        up, right = moved[:, 1] > 0, moved[:, 0] > 0
        assert 0.4 < right.mean() < 0.6
        np.testing.assert_array_equal(up, right)  # an action repeats as a whole
        with pytest.raises(ActionError, match=r"agent_1: action \[4.0, 0.0\] is out of range: thrust is 4.0"):
            env.step_batch([[0, 0], [4.0, 0], *[[0, 0]] * 498])

    def test_of_a_box(self) -> None:
        env = wrappers.clip_actions_v0(pearl_marl.parallel_env("Glider", 2))
        scaled = wrappers.scale_actions_v0(pearl_marl.parallel_env("Glider", 2), 2.0)
        twin = pearl_marl.parallel_env("Glider", 2)
        for each in (env, scaled, twin):
            each.reset_batch(seed=0)
        right = twin.step_batch([[0, 1.5], [3, 0.5]]).obs
        np.testing.assert_array_equal(env.step_batch([[-2, 9], [3, 0.5]]).obs, right)
        np.testing.assert_array_equal(scaled.step_batch([[0, 0.75], [1.5, 0.25]]).obs, right)

    def test_actions_by_a_function(self) -> None:
        """A number for a rover that has two fields."""
        env = wrappers.action_lambda_v1(
            pearl_marl.parallel_env("Rover", 3),
            lambda actions, inside: np.stack([actions % 3, actions // 3 * 100], 1),
            lambda inside: Discrete(12),
        )
        env.reset_batch(seed=0)
        env.step_batch([0, 5, 11])
        other = wrappers.action_lambda_v1(
            pearl_marl.parallel_env("CliffWalking", 3),
            lambda actions, inside: 2 * actions[:, 0] + actions[:, 1],
            lambda inside: MultiBinary(2),
        )
        other.reset_batch(seed=0)
        other.step_batch([[0, 1], [1, 1], [0, 0]])
        with pytest.raises(ActionError, match=r"agent_2: action \[0, 2\]"):
            other.step_batch([[0, 1], [1, 1], [0, 2]])

    def test_of_observations(self) -> None:
        late = wrappers.delay_observations_v0(pearl_marl.parallel_env("Rover", 5), 1)
        most = wrappers.max_observation_v0(pearl_marl.parallel_env("Rover", 5), 2)
        twin = pearl_marl.parallel_env("Rover", 5)
        seen = [each.reset_batch(seed=0).copy() for each in (late, most, twin)]
        still = np.tile([1, 399], (5, 1))
        after = [each.step_batch(still).obs for each in (late, most, twin)]
        np.testing.assert_array_equal(after[0], seen[2])
        np.testing.assert_array_equal(after[1], np.maximum(seen[2], after[2]))
        late.load_state(late.save_state())
        with pytest.raises(ArgumentError, match="takes observations in a Box"):
            wrappers.normalize_obs_v0(pearl_marl.parallel_env("Rover", 5))


@pytest.mark.parametrize("name", [spec.name for spec in FIELDS])
def test_stable_baselines3_learns(name: str, tmp_path: Path) -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    env = wrappers.sb3_vec_env(pearl_marl.parallel_env(name, 8))
    model = sb3.PPO("MlpPolicy", env, n_steps=8, batch_size=32, n_epochs=1, seed=0)
    model.learn(128)
    model.save(tmp_path / "model.zip")
    spec = pearl_marl.get_spec(name)
    policy = load_policy(str(tmp_path / "model.zip"), spec)
    env.env.step_batch(policy(env.env.reset_batch(seed=0)))
    if isinstance(spec.action_space, MultiBinary):
        with pytest.raises(ActionError, match=r"agent_0: action \[0.5"):
            env.step(np.full((8, 3), 0.5, np.float32))


def test_the_command_line(pearl: Any, tmp_path: Path) -> None:
    for name in ("Rover", "Lamps", "Glider", "Relay"):
        for command in (
            ("run", name, "--n-agents", 40, "--steps", 30, "--json"),
            ("verify", name, "--n-agents", 40, "--steps", 30, "--json"),
            ("eval", name, "--policy", "random", "--episodes", 40, "--json"),
        ):
            status, out, err = pearl(*command)
            assert status == 0, err
            json.loads(out)
    np.save(tmp_path / "actions.npy", np.stack(words_of(ROVER, 5, n=6)))
    status, _, err = pearl(
        "run", "Rover", "--n-agents", 6, "--steps", 5, "--actions", tmp_path / "actions.npy"
    )
    assert status == 0, err
    status, _, err = pearl(
        "run", "Rover", "--n-agents", 7, "--steps", 5, "--actions", tmp_path / "actions.npy"
    )
    assert status
    assert "5 steps of 7 agents need (5, 7, 2)" in err


def test_rllib_gets_vectors_and_agents() -> None:
    pytest.importorskip("ray")
    env = wrappers.rllib_vector_env("Rover")({"num_envs": 3})
    env.reset(seed=0)
    env.step(env.action_space.sample())
    assert env.single_action_space == ROVER.action_space
    env.close()
