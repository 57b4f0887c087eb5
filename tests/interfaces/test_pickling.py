"""Pickles and copies of environments: of every one of the registry, in every form, they go on as it does."""

from __future__ import annotations

import copy
import functools
import multiprocessing
import pickle
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode

import pearl_marl
from pearl_marl import devices, wrappers
from pearl_marl.batch.actions import random_actions
from pearl_marl.errors import OrderError
from pearl_marl.testing.case import assert_same_step

from ..sampling import KINDS, sampled

ENVIRONMENTS = sampled(pearl_marl.list_envs(), KINDS)

WORLDS = 3


def pickled(env: Any) -> Any:
    return pickle.loads(pickle.dumps(env))


def cloudpickled(env: Any) -> Any:
    return pickle.loads(pytest.importorskip("cloudpickle").dumps(env))


DUPLICATES: dict[str, Callable[[Any], Any]] = {
    "pickle": pickled,
    "cloudpickle": cloudpickled,
    "deepcopy": copy.deepcopy,
    "copy": copy.copy,
}


def actions(env: Any, seed: int) -> Any:
    """Actions that may be taken in the next step."""
    spec = env.unwrapped.device.config.spec
    return random_actions(spec, np.random.default_rng(seed), env.batch.batch_size, env.action_masks)


def parallel(name: str, **arguments: Any) -> Any:
    return pearl_marl.parallel_env(name, WORLDS * pearl_marl.get_spec(name).agents, **arguments)


def pictured(name: str) -> Any:
    env = parallel(name, render_mode="rgb_array")
    env.reset()
    env.render()  # what draws is no part of the copies
    return env


def packed(name: str) -> Any:
    if pearl_marl.get_spec(name).unpack is None:
        pytest.skip("its observations are not planes")
    return parallel(name, observations="packed", device="reference")  # or kernels would be compiled for that


def vector(name: str, mode: AutoresetMode = AutoresetMode.SAME_STEP) -> Any:
    if pearl_marl.get_spec(name).agents > 1:
        pytest.skip("a VectorEnv has no worlds of several agents")
    return pearl_marl.make_vec(name, WORLDS, autoreset_mode=mode)


def wrapped(name: str) -> Any:
    return wrappers.normalize_reward_v0(wrappers.clip_reward_v0(wrappers.shared_reward_v0(parallel(name))))


BATCHES: dict[str, Callable[[str], Any]] = {
    "parallel": parallel,
    "strict": functools.partial(parallel, autoreset=False, max_cycles=3),
    "stored": functools.partial(parallel, initial_states="stored", max_cycles=2),
    "packed": packed,
    "pictured": pictured,
    "vector": vector,
    "next step": functools.partial(vector, mode=AutoresetMode.NEXT_STEP),
    "wrapped": wrapped,
}


@pytest.mark.parametrize("form", BATCHES)
@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_environments_go_on(name: str, form: str) -> None:
    env = BATCHES[form](name)
    env.reset(seed=5)
    env.step_batch(actions(env, 0))
    copies = [duplicate(env) for duplicate in DUPLICATES.values()]
    for t in range(1, 3):
        if env.batch.present.any():
            given = actions(env, t)
            step = env.step_batch(given)
            for other in copies:
                assert_same_step(other.step_batch(given), step)
        for other in copies:
            np.testing.assert_array_equal(other.batch.present, env.batch.present)
            if form not in ("vector", "next step"):
                assert other.agents == env.agents


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_environments_that_have_not_begun(name: str) -> None:
    env = parallel(name)
    other = pickled(env)
    assert other.agents == []
    with pytest.raises(OrderError, match=r"call reset\(\) first"):
        other.step_batch(np.zeros(other.batch.batch_size, np.int64))
    np.testing.assert_array_equal(other.reset_batch(3), env.reset_batch(3))


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_the_turns_of_the_aec_form_go_on(name: str) -> None:
    env = pearl_marl.env(name)
    env.reset(seed=1)

    def act(one: Any, seed: int) -> tuple[Any, ...]:
        agent = one.agent_selection
        observation, reward, *ends, _ = one.last()
        space = one.action_space(agent)
        space.seed(seed)
        mask = observation["action_mask"] if isinstance(observation, dict) else None
        one.step(None if any(ends) else space.sample(mask))
        return agent, reward, ends, one.agents, pickle.dumps(np.asarray(observation))

    act(env, 0)
    copies = [pickled(env), copy.deepcopy(env), cloudpickled(env), copy.copy(env.env)]
    for t in range(1, 6):
        if env.agents:
            expected = act(env, t)
            assert [act(other, t) for other in copies] == [expected] * len(copies)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_sb3_environments_go_on(name: str) -> None:
    pytest.importorskip("stable_baselines3")
    inside = parallel(name, max_cycles=2)
    if pearl_marl.get_spec(name).roles:
        inside = wrappers.pad_action_space_v0(wrappers.pad_observations_v0(inside))
    env = wrappers.sb3_vec_env(inside)
    env.seed(5)
    env.reset()
    given = actions(inside, 0)
    env.step(given)
    copies = [pickled(env), copy.deepcopy(env), copy.copy(env)]
    if inside.batch.world.masked != "refused":
        observations, rewards, dones, infos = env.step(given)
        for other in copies:
            again = other.step(given)
            for one, same in zip(again[:3], (observations, rewards, dones), strict=True):
                np.testing.assert_array_equal(one, same)
            assert [info.keys() for info in again[3]] == [info.keys() for info in infos]


TRANSFORMS: dict[str, Callable[[Any], Any]] = {
    "dtype_v0": lambda env: wrappers.dtype_v0(env, np.float64),
    "flatten_v0": wrappers.flatten_v0,
    "reshape_v0": lambda env: wrappers.reshape_v0(env, (3, 1)),
    "normalize_obs_v0": wrappers.normalize_obs_v0,
    "agent_indicator_v0": wrappers.agent_indicator_v0,
    "observation_lambda_v0": lambda env: wrappers.observation_lambda_v0(env, halved),
    "frame_stack_v1": lambda env: wrappers.frame_stack_v1(env, 2),
    "delay_observations_v0": lambda env: wrappers.delay_observations_v0(env, 1),
    "max_observation_v0": lambda env: wrappers.max_observation_v0(env, 2),
    "normalize_observation_v0": wrappers.normalize_observation_v0,
    "normalize_reward_v0": wrappers.normalize_reward_v0,
    "clip_reward_v0": wrappers.clip_reward_v0,
    "reward_lambda_v0": lambda env: wrappers.reward_lambda_v0(env, np.sign),
    "shared_reward_v0": wrappers.shared_reward_v0,
    "sticky_actions_v0": lambda env: wrappers.sticky_actions_v0(env, 0.5),
    "nan_zeros_v0": wrappers.nan_zeros_v0,
    "nan_random_v0": wrappers.nan_random_v0,
    "nan_noop_v0": lambda env: wrappers.nan_noop_v0(env, 1),
    "action_lambda_v1": lambda env: wrappers.action_lambda_v1(env, same_actions, same_space),
    "frame_skip_v0": lambda env: wrappers.frame_skip_v0(env, (1, 3)),
}


def halved(observations: Any, space: Any) -> Any:
    return observations / 2


def same_actions(given: Any, space: Any) -> Any:
    return given


def same_space(space: Any) -> Any:
    return space


@pytest.mark.usefixtures("toys")
@pytest.mark.parametrize("make", [pearl_marl.parallel_env, pearl_marl.make_vec])
@pytest.mark.parametrize("wrap", TRANSFORMS.values(), ids=TRANSFORMS)
def test_wrapped_environments_go_on(wrap: Any, make: Any) -> None:
    env = wrap(make("Drift", 5))
    env.reset(seed=2)
    env.step_batch(actions(env, 0))
    other = pickled(env)
    for t in range(1, 15):
        given = actions(env, t)
        assert_same_step(other.step_batch(given), env.step_batch(given))


@pytest.mark.parametrize("mode", ["R", "full"])
def test_wrapped_pictures_and_numbers_go_on(mode: str) -> None:
    env = parallel("LevelBasedForaging")
    shape = env.batch.observation_space.shape
    pictures = wrappers.reshape_v0(env, (1, shape[0] // 3, 3))
    env = wrappers.resize_v1(wrappers.color_reduction_v0(pictures, mode), 2, 2)
    np.testing.assert_array_equal(pickled(env).reset_batch(1), env.reset_batch(1))
    numbers = wrappers.agent_indicator_v0(parallel("FrozenLake"))
    np.testing.assert_array_equal(pickled(numbers).reset_batch(1), numbers.reset_batch(1))
    scaled = wrappers.scale_actions_v0(wrappers.clip_actions_v0(parallel("Pendulum")), 0.5)
    scaled.reset(seed=1)
    other, given = pickled(scaled), np.full((WORLDS, 1), 0.9)
    assert_same_step(other.step_batch(given), scaled.step_batch(given))


DEVICES: dict[str, Callable[[], Any]] = {
    "native": lambda: devices.Native(threads=2),
    "reference": devices.Reference,
    "sharded": lambda: devices.Sharded(["native", "native"]),
    "lockstep": lambda: devices.Lockstep("native"),
}


@pytest.mark.parametrize("device", DEVICES.values(), ids=DEVICES)
@pytest.mark.parametrize("name", ["FrozenLake", "CoinGame"])  # whose golden functions are made of options
def test_other_devices_go_on(name: str, device: Any) -> None:
    env = parallel(name, device=device())
    env.reset(seed=5)
    env.step_batch(actions(env, 0))
    other, given = pickled(env), actions(env, 1)
    assert_same_step(other.step_batch(given), env.step_batch(given))


def test_what_is_closed_comes_back_closed() -> None:
    env = parallel("Taxi")
    env.reset()
    env.close()
    for other in (pickled(env), copy.deepcopy(pickled(env))):
        with pytest.raises(OrderError, match=r"reset\(\) after close\(\)"):
            other.reset()
        other.close()


@pytest.mark.parametrize("duplicate", DUPLICATES.values(), ids=DUPLICATES)
def test_there_is_no_copy_of_a_step_under_way(duplicate: Any) -> None:
    env = parallel("Taxi")
    env.reset(seed=0)
    env.send(np.zeros(WORLDS, np.int64))
    with pytest.raises(OrderError, match=r"between send\(\) and recv\(\)"):
        duplicate(env)
    env.recv()


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_specs_come_back(name: str) -> None:
    """With every function doing the same, which is what the hash of a kernel or of hardware goes by."""
    from pearl_marl.hardware.elaboration import env_hash

    spec = pearl_marl.get_spec(name)
    for changed in (spec, replace(spec, max_cycles=77)):
        other = pickled(changed)
        assert (other.id, other.options, other.max_cycles) == (spec.id, spec.options, changed.max_cycles)
        assert env_hash(other) == env_hash(spec)
        assert other.with_options(**spec.options).options == spec.options
        assert copy.deepcopy(changed) is copy.copy(changed) is changed


def test_options_come_back() -> None:
    for other in (pickled(parallel("FrozenLake", map_name="8x8")), pickled(parallel("Taxi", is_rainy=True))):
        spec = other.spec
        assert spec.options == pearl_marl.get_spec(spec.name).with_options(**spec.options).options
    assert pickled(pearl_marl.get_spec("FrozenLake").with_options(map_name="8x8")).observation_space.n == 64


def test_what_was_replaced_by_hand_comes_back() -> None:
    spec = pearl_marl.get_spec("MountainCar")  # whose golden functions are made of options
    space = spec.observation_space
    assert isinstance(space, Box)
    low = space.low - np.float32(1e-6)  # which Gymnasium's == overlooks
    other = pickled(replace(spec, observation_space=Box(low, space.high), summary="steeper"))
    assert other.summary == "steeper"
    np.testing.assert_array_equal(other.observation_space.low, low)
    seen = packed("Overcooked").spec
    assert pickled(seen).observation_space == seen.observation_space
    assert seen.with_options(layout="coordination_ring").options["layout"] == "coordination_ring"


USERS = """
from typing import NamedTuple
from gymnasium.spaces import Discrete
import pearl_marl
from pearl_marl import EnvSpec
from pearl_marl.layout import Bits
from pearl_marl.spec import Golden, Peer

class State(NamedTuple):
    place: Bits[4]

def make_step(by):
    def step(state, action, draws):
        return State((state.place + by * action) & 15), 0, state.place == 9
    return step

def configure(by=1):
    return EnvSpec(
        name="Configured", version=0, summary="", rewards=(1.0,),
        observation_space=Discrete(16), action_space=Discrete(2),
        golden=Golden(State, lambda draws: State(0), make_step(by), lambda state: state.place),
        options={"by": by}, configure=configure)

def plain_step(state, action, draws):
    return State((state.place + action) & 15), 0, state.place == 9

def plain(name, step, **more):
    return EnvSpec(
        name=name, version=0, summary="", rewards=(1.0,),
        observation_space=Discrete(16), action_space=Discrete(2),
        golden=Golden(State, initial, step, observe), **more)

def initial(draws):
    return State(0)

def observe(state):
    return state.place

CONFIGURED = configure()
PLAIN = plain("Plain", plain_step)
HELD = plain("Held", make_step(3))
for spec in (CONFIGURED, PLAIN, HELD):
    pearl_marl.register(spec)
del spec
pearl_marl.register(plain("Registered", make_step(2)))
pearl_marl.register(plain("Peered", plain_step, peers={"games": Peer(lambda spec: None)}))
"""


@pytest.fixture
def users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A module with environments of a user, which other processes have not imported."""
    (tmp_path / "users_environments.py").write_text(USERS)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(pearl_marl.envs, "_specs", dict(pearl_marl.envs._specs))
    yield "users_environments"
    sys.modules.pop("users_environments", None)


def steps(env: Any) -> list[Any]:
    """What an environment shows in a few steps."""
    return [env.step_batch(np.ones(env.batch.batch_size, np.int64)).obs.tolist() for _ in range(4)]


def test_environments_of_users_go_on(users: str) -> None:
    for name in ("Configured", "Plain", "Held", "Registered", "Peered"):
        env = pearl_marl.parallel_env(f"{users}:{name}", 2, device="reference")
        env.reset()
        other = pickled(env)
        assert steps(other) == steps(env)
    other = pickled(pearl_marl.parallel_env(f"{users}:Configured", 2, device="reference", by=5))
    other.reset()
    assert steps(other)[0] == [5, 5]


def test_a_spec_that_pickle_cannot_write_is_refused(users: str) -> None:
    import users_environments as module  # type: ignore[import-not-found]

    with pytest.raises((AttributeError, pickle.PicklingError), match=r"make_step\.<locals>\.step"):
        pickle.dumps(module.plain("Nowhere", module.make_step(4)))


@pytest.mark.slow
def test_another_process_goes_on(users: str) -> None:
    """As with multiprocessing's spawn, which knows nothing but the pickles."""
    environments = [parallel(name) for name in KINDS if name not in ("Pendulum", "ConnectFour")]
    environments += [
        pearl_marl.parallel_env(f"{users}:{name}", 2, device="reference")
        for name in ("Configured", "Held", "Registered")
    ]
    for env in environments:
        env.reset(seed=4)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        theirs = pool.map(steps, environments)
    assert theirs == [steps(env) for env in environments]
