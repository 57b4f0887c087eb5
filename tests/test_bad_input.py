"""Bad input: an error that names what was wrong, and an environment that goes on undisturbed."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, MultiBinary, MultiDiscrete, Text
from gymnasium.vector import AutoresetMode

import pearl_marl
from pearl_marl.devices import BatchConfig, Native, Ray, Rtl, Sharded
from pearl_marl.devices.served import ServedBoard
from pearl_marl.envs import ARGUMENTS
from pearl_marl.errors import ActionError, ArgumentError, OrderError, PearlError, SavedStateError
from pearl_marl.latency import LINKS, plan
from pearl_marl.layout import Array, Bits
from pearl_marl.memory_map import memory_map
from pearl_marl.policies.loading import load_policy, table_policy
from pearl_marl.spec import Field, Golden
from pearl_marl.wrappers import reward_lambda_v0

from .toy import DRIFT

N = 5
Call = Callable[[Any], Any]


def by_name(*actions: Any) -> dict[str, Any]:
    return {f"agent_{i}": action for i, action in enumerate(actions)}


def refused(name: str, call: Call, error: type[PearlError], *words: str) -> Any:
    """Return a test parameter: ``words`` have to stand in the message, in that order."""
    return pytest.param(call, error, ".*".join(map(re.escape, words)), id=name)


ACTIONS = [
    refused(
        "out of range",
        lambda e: e.step([0, 0, 9, 0, 99]),
        ActionError,
        "agent_2",
        "9",
        "out of range",
        "Disc",
    ),
    refused("negative", lambda e: e.step_batch(np.array([0, -1, 0, 0, 0])), ActionError, "agent_1", "-1"),
    refused("int8", lambda e: e.step(np.array([0, 0, 0, 0, -1], np.int8)), ActionError, "agent_4", "-1"),
    refused("wraps to 0", lambda e: e.step(np.array([0, 256, 0, 0, 0])), ActionError, "agent_1", "256"),
    refused(
        "in a dict", lambda e: e.step(by_name(0, 0, 0, 77, 0)), ActionError, "agent_3", "77", "out of range"
    ),
    refused("huge", lambda e: e.step([0, 0, 0, 2**70, 0]), ActionError, "agent_3", str(2**70)),
    refused("missing", lambda e: e.step(by_name(0, 0, 0, 0)), ActionError, "agent_4"),
    refused("none at all", lambda e: e.step({}), ActionError, "agent_0"),
    refused("unknown agent", lambda e: e.step(by_name(*[0] * 6)), ActionError, "agent_5", "no such agent"),
    refused(
        "other name", lambda e: e.step({**by_name(*[0] * 5), "bob": 0}), ActionError, "bob", "no such agent"
    ),
    refused("too few", lambda e: e.step([0, 0]), ActionError, "(2,)", "(5,)"),
    refused("a column", lambda e: e.step_batch(np.zeros((N, 1), int)), ActionError, "(5, 1)", "(5,)"),
    refused("a number", lambda e: e.step(3), ActionError, "()", "(5,)"),
    refused("nothing", lambda e: e.step(None), ActionError, "None", "array of shape (5,)"),
    refused("a word", lambda e: e.step("left"), ActionError, "a str", "array of shape (5,)"),
    refused(
        "a dict for a batch",
        lambda e: e.step_batch(by_name(*[0] * 5)),
        ActionError,
        "actions are a dict; 5 agents take an array of shape (5,), or a dict by agent in step()",
    ),
    refused("ragged", lambda e: e.step([0, [1, 2], 0, 0, 0]), ActionError, "agent_1", "[1, 2]"),
    refused("floats", lambda e: e.step(np.full(N, 1.0)), ActionError, "agent_0", "1.0", "no integer"),
    refused("bools", lambda e: e.step(np.ones(N, bool)), ActionError, "agent_0", "True", "no integer"),
    refused("one float", lambda e: e.step([0, 0, 1.5, 0, 0]), ActionError, "agent_2", "1.5", "no integer"),
    refused("a float by name", lambda e: e.step(by_name(0, 0, 1.5, 0, 0)), ActionError, "agent_2", "1.5"),
    refused("a word by name", lambda e: e.step(by_name(0, "up", 0, 0, 0)), ActionError, "agent_1", "'up'"),
    refused("None by name", lambda e: e.step(by_name(0, 0, 0, 0, None)), ActionError, "agent_4", "None"),
    refused("an array by name", lambda e: e.step(by_name(0, [0], 0, 0, 0)), ActionError, "agent_1", "[0]"),
    refused(
        "arrays by name",
        lambda e: e.step(by_name(*[np.array([1])] * 5)),
        ActionError,
        "agent_0",
        "array([1])",
    ),
]

OTHERS = [
    refused("negative seed", lambda e: e.reset(seed=-3), ArgumentError, "seed is -3"),
    refused("fractional seed", lambda e: e.reset(seed=1.5), ArgumentError, "seed is 1.5"),
    refused("seed of a batch", lambda e: e.reset_batch("1"), ArgumentError, "seed is '1'"),
    refused("seed in a list", lambda e: e.reset(seed=np.array([5])), ArgumentError, "seed is array([5])"),
    refused("negative limit", lambda e: setattr(e, "max_cycles", -1), ArgumentError, "max_cycles is -1"),
    refused("fractional limit", lambda e: setattr(e, "max_cycles", 2.5), ArgumentError, "max_cycles is 2.5"),
    refused("true limit", lambda e: setattr(e, "max_cycles", True), ArgumentError, "max_cycles is True"),
    refused("large limit", lambda e: setattr(e, "max_cycles", 2**32), ArgumentError, str(2**32)),
    refused("render", lambda e: e.render(), OrderError, "render_mode"),
    refused("short mask", lambda e: e.device.reset(mask=[True]), ArgumentError, "(5,)", "(1,)"),
    refused(
        "mask of numbers", lambda e: e.device.reset(mask=[0, 1, 2, 3, 4]), ArgumentError, "bool", "int64"
    ),
    refused("ragged mask", lambda e: e.reset_slots([[True], [True, False]]), ArgumentError, "(5,)", "ragged"),
    refused("mask and seed", lambda e: e.device.reset(1, [True] * N), ArgumentError, "seed", "mask"),
    refused("no mask", lambda e: e.reset_slots(None), ArgumentError, "mask is None; reset_batch()"),
    refused("a stranger's actions", lambda e: e.action_space("x"), ArgumentError, "no agent 'x'", "agent_4"),
    refused("nobody's view", lambda e: e.observation_space(0), ArgumentError, "there is no agent 0"),
    refused("nobody's role", lambda e: e.role("agent_5"), ArgumentError, "there is no agent 'agent_5'"),
    refused("recv", lambda e: e.device.recv(), OrderError, "call send() first"),
    refused("send", lambda e: e.device.send([9] * N), ActionError, "agent_0", "9"),
    refused("open twice", lambda e: e.device.open(e.device.config), OrderError, "opened before"),
    refused("empty blob", lambda e: e.load_state(b""), SavedStateError, "no saved state"),
    refused("foreign blob", lambda e: e.load_state(b"\x89PNG" * 99), SavedStateError, "no saved state"),
    refused("text", lambda e: e.load_state("PEARLST1"), SavedStateError, "not str"),
]


@pytest.mark.parametrize("name", ["CliffWalking", "ConnectFour"])
@pytest.mark.parametrize("seed", [np.array(5), np.uint8(5)], ids=repr)
def test_a_seed_of_any_type_of_integer_is_taken_by_all(name: str, seed: Any) -> None:
    env, twin = (reward_lambda_v0(pearl_marl.parallel_env(name, 2), np.negative) for _ in range(2))
    env.reset(seed=seed)
    twin.reset(seed=5)
    assert env.save_state() == twin.save_state()
    assert env.unwrapped.np_random.integers(2**60) == twin.unwrapped.np_random.integers(2**60)


TABLES = [
    refused("short table", lambda e: e.set_rewards([1.0]), ArgumentError, "(1,)", "2 categories"),
    refused("long table", lambda e: e.set_rewards([1, 2, 3]), ArgumentError, "(3,)", "2 categories"),
    refused("a number", lambda e: e.set_rewards(1.0), ArgumentError, "()", "2 categories"),
    refused("NaN", lambda e: e.set_rewards([0.0, np.nan]), ArgumentError, "nan", "finite"),
    refused("too large", lambda e: e.set_rewards([0.0, 1e300]), ArgumentError, "inf", "finite"),
    refused("words", lambda e: e.set_rewards(["low", "high"]), ArgumentError, "'low'", "2 numbers"),
    refused("None", lambda e: e.set_rewards(None), ArgumentError, "2"),
]


def make(env_id: str, autoreset: bool) -> pearl_marl.PearlParallelEnv:
    env = pearl_marl.parallel_env(env_id, N, autoreset=autoreset, max_cycles=9)
    env.reset(seed=5)
    for actions in np.random.default_rng(0).integers(4, size=(4, N)):
        env.step(actions)
    return env


def assert_refused_without_a_trace(
    env: Any, twin: Any, call: Call, error: type[PearlError], words: str
) -> None:
    """Make a bad call, and then see that both environments have the same future."""
    before = twin.save_state()
    with pytest.raises(error, match=f"(?s){words}") as caught:
        call(env)
    assert type(caught.value) is error
    assert env.save_state() == before
    assert env.agents == twin.agents
    for actions in np.random.default_rng(1).integers(4, size=(12, N)):
        given = {agent: actions[int(agent[6:])] for agent in env.agents}
        np.testing.assert_equal([dict(d) for d in env.step(given)], [dict(d) for d in twin.step(given)])
        if not env.agents:
            break
    np.testing.assert_array_equal(env.reset_batch(), twin.reset_batch())


@pytest.mark.parametrize("autoreset", [True, False])
@pytest.mark.parametrize("name", ["CliffWalking", "Drift"])
@pytest.mark.parametrize(("call", "error", "words"), ACTIONS + OTHERS)
def test_a_refused_call_changes_nothing(
    toys: None, name: str, autoreset: bool, call: Call, error: type[PearlError], words: str
) -> None:
    assert_refused_without_a_trace(make(name, autoreset), make(name, autoreset), call, error, words)


@pytest.mark.parametrize(("call", "error", "words"), TABLES)
def test_reward_tables(call: Call, error: type[PearlError], words: str) -> None:
    envs = [make("CliffWalking", True) for _ in range(2)]
    assert_refused_without_a_trace(*envs, call, error, words)


def test_no_table_where_rewards_are_computed(toys: None) -> None:
    envs = [make("Drift", True) for _ in range(2)]
    assert_refused_without_a_trace(
        *envs, lambda e: e.set_rewards([1.0]), ArgumentError, "computes its rewards"
    )
    with pytest.raises(ArgumentError, match="computes its rewards"):
        pearl_marl.parallel_env("Drift", 2, rewards=[1.0])


def test_an_action_for_an_agent_that_left() -> None:
    env, twin = (pearl_marl.parallel_env("CliffWalking", 3, autoreset=False) for _ in range(2))
    for e in (env, twin):
        e.reset(seed=0)
        for action in [0, *[1] * 11]:
            e.step([3, action, 3])
        e.step([3, 2, 3])
        assert e.agents == ["agent_0", "agent_2"]
    for actions, words in (
        ({"agent_0": 0, "agent_2": 0, "agent_3": 0}, "'agent_3', but there is no such agent"),
        ({"agent_0": 0, "agent_1": 0, "agent_2": 0, 1: 0}, "for 1, but there is no such agent"),
        ({"agent_0": 0}, "'agent_2'"),
        ({"agent_0": 0, "agent_2": 4}, "agent_2: action 4"),
        ({"agent_0": 0, "agent_2": 0.5}, "agent_2: action 0.5"),
    ):
        with pytest.raises(ActionError, match=words):
            env.step(actions)
        assert env.save_state() == twin.save_state()
    # For who has left it may be anything.
    for odd in (0, -3, None, "left", [1, 2]):
        for e, actions in ((env, {"agent_1": odd, "agent_0": 0, "agent_2": 0}), (twin, [0, 0, 0])):
            assert list(e.step(actions)[0]) == ["agent_0", "agent_2"]
        assert env.save_state() == twin.save_state()


def test_the_first_slot_names_the_agents() -> None:
    """Where a batch is a part of a larger one, its agents have the numbers they have there."""
    device = Native().open(BatchConfig(spec=DRIFT, n_envs=4, first_slot=1000))
    device.reset(seed=0)
    with pytest.raises(ActionError, match="agent_1002: action 5 is out of range"):
        device.step([0, 0, 5, 0])


MAKE = [
    refused(
        "unknown",
        lambda f: f("CliffWalkin", 2),
        ArgumentError,
        "'CliffWalkin'",
        "did you mean 'CliffWalking'",
    ),
    refused("far from all", lambda f: f("Quux", 2), ArgumentError, "'Quux'", "CliffWalking"),
    refused("no name", lambda f: f(7, 2), ArgumentError, "7"),
    refused("no agents", lambda f: f("CliffWalking", 0), ArgumentError, "agents is 0", "at least 1"),
    refused("negative", lambda f: f("CliffWalking", -4), ArgumentError, "agents is -4"),
    refused("fractional", lambda f: f("CliffWalking", 2.5), ArgumentError, "agents is 2.5"),
    refused("whole float", lambda f: f("CliffWalking", 2.0), ArgumentError, "agents is 2.0"),
    refused("true", lambda f: f("CliffWalking", True), ArgumentError, "agents is True"),
    refused("text", lambda f: f("CliffWalking", "3"), ArgumentError, "agents is '3'"),
    refused("too many", lambda f: f("CliffWalking", 2**32 + 1), ArgumentError, "4,294,967,297", f"{2**32:,}"),
    refused(
        "keyword",
        lambda f: f("CliffWalking", 2, is_slipery=True),
        ArgumentError,
        "is_slipery",
        "'is_slippery'",
    ),
    refused(
        "other keyword",
        lambda f: f("CliffWalking", 2, wings=2),
        ArgumentError,
        "'wings'",
        "own arguments: is_slippery",
    ),
    refused("option value", lambda f: f("CliffWalking", 2, is_slippery=1), ArgumentError, "is_slippery is 1"),
    refused("device", lambda f: f("CliffWalking", 2, device="gpu"), ArgumentError, "'gpu'", "'native'"),
    refused("no device", lambda f: f("CliffWalking", 2, device=None), ArgumentError, "None", "'native'"),
    refused("limit", lambda f: f("CliffWalking", 2, max_cycles=-1), ArgumentError, "max_cycles is -1"),
    refused(
        "initial", lambda f: f("CliffWalking", 2, initial_states="same"), ArgumentError, "'same'", "'stored'"
    ),
    refused(
        "initial states in an array",
        lambda f: f("CliffWalking", 2, initial_states=np.array(["random", "x"])),
        ArgumentError,
        "initial_states is array",
    ),
    refused(
        "observations in an array",
        lambda f: f("CliffWalking", 2, observations=np.array(["whole", "x"])),
        ArgumentError,
        "observations is array",
    ),
    refused(
        "a huge number",
        lambda f: f("FrozenLake", 2, success_rate=10**400),
        ArgumentError,
        "success_rate is 1000",
        "it must be a number from 0 to 1",
    ),
    refused(
        "huge rewards",
        lambda f: f("FrozenLake", 2, reward_schedule=(10**400, 0, 0)),
        ArgumentError,
        "reward_schedule is (1000",
        "three finite numbers",
    ),
    refused("rewards", lambda f: f("CliffWalking", 2, rewards=[1]), ArgumentError, "(1,)", "2 categories"),
]


@pytest.mark.parametrize("function", [pearl_marl.parallel_env, pearl_marl.make_vec, pearl_marl.env])
@pytest.mark.parametrize(("call", "error", "words"), MAKE)
def test_making(call: Call, error: type[PearlError], words: str, function: Any) -> None:
    if function is pearl_marl.make_vec:  # there it is another argument
        words = words.replace(re.escape("agents is"), re.escape("num_envs is"))
    with pytest.raises(error, match=words):
        call(function)


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        refused(
            "autoreset", lambda f: f("CliffWalking", autoreset="yes"), ArgumentError, "'yes'", "True or False"
        ),
        refused("mode", lambda f: f("CliffWalking", render_mode="3d"), ArgumentError, "'3d'", "human"),
    ],
)
def test_making_a_parallel_env(call: Call, error: type[PearlError], words: str) -> None:
    with pytest.raises(error, match=words):
        call(pearl_marl.parallel_env)


def test_no_renderer(toys: None) -> None:
    with pytest.raises(ArgumentError, match="Drift has none"):
        pearl_marl.parallel_env("Drift", render_mode="human")


@pytest.mark.parametrize("make", [pearl_marl.env, pearl_marl.raw_env])
@pytest.mark.parametrize("name", ["CliffWalking", "ConnectFour"])
def test_observing_nobody(make: Any, name: str) -> None:
    env = make(name, 2)
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match=r"there is no agent 'x'; agents are agent_0 to agent_1"):
        env.observe("x")
    assert env.observe("agent_0") is not None


def test_observing_who_has_left() -> None:
    env = pearl_marl.raw_env("CliffWalking", 2)
    env.reset(seed=0)
    for action in (0, *[1] * 11, 2):
        env.step(3)
        env.step(action)
    assert env.agent_selection == "agent_1"
    env.step(None)
    env.step(3)
    with pytest.raises(OrderError, match=r"'agent_1'.*: its episode has ended"):
        env.observe("agent_1")


def test_rendering_an_unknown_agent() -> None:
    env = pearl_marl.parallel_env("CliffWalking", 3, render_mode="ansi")
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match=r"'agent_3'.*agent_0 to agent_2"):
        env.render("agent_3")
    assert env.render() is not None


ORDER = [
    pytest.param(lambda e: e.step([0] * N), id="step"),
    pytest.param(lambda e: e.step(by_name(*[0] * N)), id="step by name"),
    pytest.param(lambda e: e.step_batch([0] * N), id="step_batch"),
    pytest.param(lambda e: e.state(), id="state"),
    pytest.param(lambda e: e.save_state(), id="save_state"),
    pytest.param(lambda e: e.device.send([0] * N), id="send"),
    pytest.param(lambda e: e.device.snapshot(), id="snapshot"),
]


@pytest.mark.parametrize("autoreset", [True, False])
@pytest.mark.parametrize("call", ORDER)
def test_before_reset_and_after_close(call: Call, autoreset: bool) -> None:
    env = pearl_marl.parallel_env("CliffWalking", N, autoreset=autoreset)
    with pytest.raises(OrderError, match=r"before reset\(\)"):
        call(env)
    env.reset(seed=0)
    blob = env.save_state()
    call(env)
    env.close()
    for late in (call, lambda e: e.reset(), lambda e: e.load_state(blob), lambda e: e.set_rewards([0, 0])):
        with pytest.raises(OrderError, match=r"after close\(\)"):
            late(env)


def test_what_it_is() -> None:
    env = pearl_marl.parallel_env("LevelBasedForaging", 4)
    assert repr(env) == "PearlParallelEnv(LevelBasedForaging-v0, n_agents=4, device=native)"
    with pytest.raises(OrderError, match=r"save_state\(\) before reset\(\)"):
        env.save_state()


def test_a_mask_at_the_first_reset() -> None:
    device = Native().open(BatchConfig(spec=DRIFT, n_envs=2))
    with pytest.raises(OrderError, match="without a mask first"):
        device.reset(mask=np.array([True, False]))
    with pytest.raises(OrderError, match="before reset"):
        device.step([0, 0])


def test_between_send_and_recv() -> None:
    device, twin = (Native().open(BatchConfig(spec=DRIFT, n_envs=N)) for _ in range(2))
    device.reset(seed=0)
    twin.reset(seed=0)
    device.send([1] * N)
    for call in (
        lambda: device.step([0] * N),
        lambda: device.send([0] * N),
        lambda: device.reset(),
        lambda: device.snapshot(),
        lambda: device.state(),
        lambda: device.set_max_cycles(4),
    ):
        with pytest.raises(OrderError, match=r"call recv\(\) first"):
            call()
    np.testing.assert_array_equal(device.recv().obs, twin.step([1] * N).obs)
    np.testing.assert_array_equal(device.step([2] * N).obs, twin.step([2] * N).obs)


def test_a_device_without_a_batch() -> None:
    for call in (lambda d: d.reset(), lambda d: d.step([0]), lambda d: d.set_rewards([1])):
        with pytest.raises(OrderError, match=r"before open\(\)"):
            call(Native())
    with pytest.raises(OrderError, match="call send"):
        Native().recv()


@pytest.mark.parametrize("threads", [0, -1, 1.0, True, "2"])
def test_threads(threads: Any) -> None:
    with pytest.raises(ArgumentError, match=re.escape(repr(threads))):
        Native(threads=threads)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"first_slot": -1}, "first_slot is -1"),
        ({"first_slot": 2**32 - 1}, "random draws can tell 1 apart from slot 4,294,967,295 on"),
        ({"autoreset_mode": AutoresetMode.DISABLED}, "DISABLED"),
        ({"n_envs": None}, "None"),
        ({"spec": "Drift"}, "spec is 'Drift'; it must be an EnvSpec"),
    ],
)
def test_configurations(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        BatchConfig(**{"spec": DRIFT, "n_envs": 2, **arguments})


TWO = ["native", "native"]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Sharded(None), "parts is None; it must be a list of at least one device"),
        (lambda: Sharded(3), "parts is 3"),
        (lambda: Sharded(TWO, sizes="22"), "sizes is '22'; it must be 2 positive integers"),
        (lambda: Sharded(TWO, sizes=[2.0, 2.0]), "sizes is [2.0, 2.0]"),
        (lambda: Sharded(TWO, sizes=3), "sizes is 3"),
        (lambda: Ray(2), "shards is 2; it must be a list"),
        (lambda: Ray(TWO, resources=2), "resources is 2"),
        (lambda: Rtl(trace=3), "trace is 3; it must be a file name"),
        (lambda: Native().open(None), "open() takes a BatchConfig, not None"),
        (lambda: Native().open(DRIFT), "open() takes a BatchConfig, not EnvSpec"),
        (lambda: ServedBoard("/dev/null", DRIFT, 4, path="zz"), "path is 'zz'; possible are 'backdoor'"),
    ],
)
def test_devices(make: Callable[[], Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=re.escape(words)):
        make()


def test_sizes_in_an_array() -> None:
    device = Sharded(TWO, sizes=np.array([1, 3])).open(BatchConfig(spec=DRIFT, n_envs=4))
    assert [part.config.n_envs for part in device.parts] == [1, 3]


@pytest.mark.parametrize(
    ("spec", "rows", "words"),
    [
        ("Seaquest", np.zeros((1, 69), np.uint8), "spec is 'Seaquest'"),
        (pearl_marl.get_spec("Seaquest"), None, "have the dtype object and the shape ()"),
        (pearl_marl.get_spec("Seaquest"), [[0] * 69], "have the dtype int64 and the shape (1, 69)"),
    ],
)
def test_unpacking(spec: Any, rows: Any, words: str) -> None:
    with pytest.raises(ArgumentError, match=re.escape(words)):
        pearl_marl.unpacked(spec, rows)


# Saved states.


def saved(env_id: str = "Drift", n: int = N, autoreset: bool = True, **arguments: Any) -> bytes:
    env = pearl_marl.parallel_env(env_id, n, autoreset=autoreset, **{"max_cycles": 9, **arguments})
    env.reset(seed=1)
    return env.save_state()


@pytest.mark.parametrize(
    ("blob", "words"),
    [
        pytest.param(
            lambda: saved("CliffWalking"), "environment = 'CliffWalking-v0'.*'Drift-v3'", id="environment"
        ),
        pytest.param(lambda: saved(push=21), "options = .*21.*20", id="options"),
        pytest.param(lambda: saved(n=6), "n_agents = 6.*5", id="size"),
        pytest.param(lambda: saved(autoreset=False), "autoreset = False.*True", id="mode"),
        pytest.param(lambda: saved(max_cycles=8), "max_cycles = 8.*9", id="limit"),
        pytest.param(
            lambda: saved(initial_states="stored"), "initial_states = 'stored'.*'random'", id="initial"
        ),
        pytest.param(lambda: b"PEARLST2" + saved()[8:], "version '2'.*version '1'", id="version"),
    ],
)
def test_saved_states_of_others(toys: None, blob: Callable[[], bytes], words: str) -> None:
    data = blob()
    assert_refused_without_a_trace(
        make("Drift", True), make("Drift", True), lambda e: e.load_state(data), SavedStateError, words
    )


def test_every_damaged_byte_is_noticed(toys: None) -> None:
    env = make("Drift", True)
    blob = saved()
    before = env.save_state()
    generator = np.random.default_rng(0)
    for position in range(len(blob)):
        damaged = bytearray(blob)
        damaged[position] ^= 1 << int(generator.integers(8))
        with pytest.raises(SavedStateError):
            env.load_state(bytes(damaged))
    for length in {*range(40), len(blob) - 1, len(blob) // 2}:
        with pytest.raises(SavedStateError):
            env.load_state(blob[:length])
    with pytest.raises(SavedStateError):
        env.load_state(blob + b"\0")
    assert env.save_state() == before
    env.load_state(bytearray(blob))
    assert env.save_state() == blob


def test_a_snapshot_of_another_batch(toys: None) -> None:
    """Devices are used on their own too, and a snapshot of another size must not be written into one."""
    device, twin = (Native().open(BatchConfig(spec=DRIFT, n_envs=N)) for _ in range(2))
    other = Native().open(BatchConfig(spec=DRIFT, n_envs=N + 100))
    for d in (device, twin, other):
        d.reset(seed=0)
    with pytest.raises(SavedStateError, match=r"n_agents = 105.*5"):
        device.restore(other.snapshot())
    np.testing.assert_array_equal(device.step([1] * N).obs, twin.step([1] * N).obs)


# Specs.


@pytest.mark.parametrize("bits", [0, 65, -1])
def test_fields(bits: int) -> None:
    with pytest.raises(ArgumentError, match=f"'x' has {bits} bits"):
        Field("x", bits)


def kept(name: str, **before: Any) -> Golden:
    """Return golden functions of a state that has a field of that name."""
    state = type("State", (), {"__annotations__": {**before, name: Bits[3]}})
    return DRIFT.golden._replace(state=state)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"observation": DRIFT.observation[:2]}, "takes 3 fields.*lists 2"),
        ({"action": Field("action", 2)}, r"Discrete\(5\) does not fit 2"),
        ({"unpack": print, "observation_space": Discrete(4)}, "unpack.. makes a Box"),
        ({"action_space": Box(-2, 2, (2, 1))}, r"no bounded float32 Box of shape \(n,\)"),
        ({"action_space": Box(-2, 2, (2,))}, r"action space Box.* takes 2 fields, .*; the spec lists 1"),
        ({"action_space": MultiDiscrete([4, 3])}, "takes 2 fields, and at least one; the spec lists 1"),
        ({"action_space": Box(0, 1, (0,)), "action": ()}, "takes 0 fields, and at least one"),
        (
            {"action_space": MultiDiscrete([4, 3]), "action": (Field("way", 2), Field("far", 1))},
            r"MultiDiscrete\(\[4 3\]\) does not fit 1 action bits of far",
        ),
        (
            {"action_space": MultiBinary(2), "action": (Field("left", 1), Field("left", 1))},
            "two action fields are named 'left'",
        ),
        (
            {"action": Field("way", 4, signed=True)},
            r"action field 'way' is signed or has a fraction, and Discrete\(5\) counts from 0",
        ),
        (
            {
                "action_space": Box(0, 1, (2,)),
                "action": (Field("way", 64, fraction=2), Field("far", 8, signed=True)),
            },
            "an action's fields of 64 bits, some signed and some not",
        ),
        ({"action_space": MultiDiscrete([4, 3], start=[0, 1])}, "is none of Discrete, MultiDiscrete"),
        ({"action_space": MultiBinary((2, 2))}, "is none of Discrete, MultiDiscrete"),
        ({"action_space": Box(-8, 8, (1,))}, "does not fit 3 action bits"),
        (
            {"action_space": Discrete(3, start=1)},
            "is none of Discrete, MultiDiscrete and MultiBinary, from 0",
        ),
        ({"observation_space": Text(3)}, "no Discrete, Tuple of them, MultiDiscrete, MultiBinary or Box"),
        ({"rewards": (0.0,) * 9, "reward": Field("reward", 3)}, "9 rewards do not fit 3"),
        (
            {"rewards": (0.0,) * 4, "reward": Field("reward", 3, signed=True)},
            "a signed reward field is no category",
        ),
        ({"max_cycles": -2}, "max_cycles is -2"),
        ({"name": 3}, "name 3: it takes letters"),
        ({"version": "x"}, "Drift: version is 'x'; it must be an integer of at least 0"),
        ({"golden": kept("two words")}, "Drift: state field 'two words': a name takes letters, digits"),
        ({"golden": kept("0")}, "Drift: state field '0': .* and no digit first"),
        ({"golden": kept("Höhe")}, "Drift: state field 'Höhe': a name"),
        ({"golden": kept("ended")}, "'ended' is named like a column that every slot has"),
        ({"golden": kept("a_0", a=Array[Bits[3], 1])}, "Drift: two state fields are named 'a_0'"),
        ({"observation": DRIFT.state[:1] * 3}, "Drift: two observation fields are named 'position'"),
        ({"observation": (*DRIFT.state[:2], Field("", 3))}, "Drift: observation field '': a name"),
    ],
)
def test_specs(changes: dict[str, Any], words: str) -> None:
    from dataclasses import replace

    with pytest.raises(ArgumentError, match=words):
        replace(DRIFT, **changes)


def test_registering() -> None:
    with pytest.raises(ArgumentError, match="takes an EnvSpec, not str"):
        pearl_marl.register("Drift")  # type: ignore[arg-type]


def test_options_do_not_hide_arguments() -> None:
    """`pearl run` gives both by name, and one of them would be lost."""
    from dataclasses import replace

    makers = pearl_marl.parallel_env, pearl_marl.make_vec
    assert {*ARGUMENTS, "options"} == {name for make in makers for name in inspect.signature(make).parameters}
    for name in pearl_marl.list_envs():
        assert not ARGUMENTS & {*pearl_marl.get_spec(name).options}, name
    with pytest.raises(ArgumentError, match="Drift has an option 'max_cycles', which parallel_env"):
        pearl_marl.register(replace(DRIFT, options={"max_cycles": 9}, configure=lambda max_cycles: DRIFT))


def test_registering_twice_warns(toys: None) -> None:
    with pytest.warns(UserWarning, match="'Drift' was registered before"):
        pearl_marl.register(DRIFT)
    assert pearl_marl.get_spec("DRIFT") is DRIFT
    assert "Drift" in pearl_marl.list_envs()


def test_memory_maps_of_too_many_elements() -> None:
    with pytest.raises(ArgumentError, match="pe_num is 3"):
        memory_map(DRIFT, 2, 3, 32)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: memory_map(DRIFT, 4, 2, "32"), "data_wl is '32'"),
        (lambda: load_policy("random", DRIFT, "x"), "seed is 'x'"),
        (lambda: load_policy("random", DRIFT, 1.5), "seed is 1.5"),
        (lambda: load_policy("random", "Drift"), "spec is 'Drift'; it must be an EnvSpec"),
        (
            lambda: table_policy([[1], [1, 2]], pearl_marl.get_spec("CliffWalking")),
            "takes numbers of shape (48, 4)",
        ),
        (lambda: plan(DRIFT, 4, "gen2x8", 1e8), "link is 'gen2x8'; it must be a Link"),
        (lambda: plan(DRIFT, 4, LINKS["gen2x8"], 1e8, "vc707"), "part is 'vc707'; it must be one of"),
    ],
)
def test_plans_and_policies(call: Callable[[], Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=re.escape(words)):
        call()


@pytest.mark.parametrize("command", ["run", "eval", "bench", "verify"])
def test_more_agents_than_there_is_memory_for(command: str, pearl: Any) -> None:
    """Refused before any of it is taken: half of it would be enough to have the system end other programs."""
    more = ["--policy", "random"] if command == "eval" else []
    status, _, err = pearl(command, "CliffWalking", "--n-agents", 4_000_000_000, *more)
    assert status == 2
    assert "4,000,000,000 agents of CliffWalking take at least" in err
    assert "agents at most" in err
