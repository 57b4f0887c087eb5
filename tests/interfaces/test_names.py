"""Agents' names: lists to everybody, and made only when somebody reads them."""

from __future__ import annotations

import copy
import json
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.interfaces.agent_dict import AgentList, Names

N = 12
PLAIN = [f"agent_{i}" for i in range(N)]


@pytest.fixture(autouse=True)
def few_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have containers of any size filled when they are read, and none from the start."""
    monkeypatch.setattr("pearl_marl.interfaces.agent_dict.FEW", -1)


def filled(names: list[str]) -> bool:
    """Whether a list's strings have been made."""
    return type(names) is AgentList


def changed(change: Callable[[list[str]], Any]) -> Callable[[list[str]], Any]:
    def made(names: list[str]) -> Any:
        return change(names), names

    return made


READS: dict[str, Callable[[list[str]], Any]] = {
    "length": len,
    "truth": bool,
    "element": lambda names: (names[0], names[-1], names[N - 1]),
    "NumPy's index": lambda names: names[np.int64(3)],
    "slice": lambda names: (names[:], names[2:5], names[::-3], names[N:]),
    "in": lambda names: [
        one in names
        for one in ("agent_0", f"agent_{N}", "agent_-1", "agent_00", "agent_+1", "agent_1_0", "agent_", "", 3)
    ],
    "long": lambda names: "agent_" + "1" * 5000 in names,
    "other digits": lambda names: "agent_\u0663" in names,
    "other lengths": lambda names: (names == [], names != [], names == [], names == PLAIN[1:]),
}
"""What takes no strings but those that are asked for."""

USES: dict[str, Callable[[list[str]], Any]] = {
    "iteration": lambda names: [*names],
    "list": list,
    "tuple": tuple,
    "set": set,
    "sorted": sorted,
    "reversed": lambda names: list(reversed(names)),
    "repr": repr,
    "equal": lambda names: (names == PLAIN, names == PLAIN, names != PLAIN, names == [*PLAIN[1:], "x"]),
    "order": lambda names: (names < ["b"], names > ["b"], names >= PLAIN, names >= PLAIN),
    "index": lambda names: (names.index("agent_5"), names.count("agent_5")),
    "plus": lambda names: (names + ["x"], ["x"] + names, names * 2, 2 * names),  # noqa: RUF005
    "other plus": lambda names: ["x"] + names,  # noqa: RUF005
    "+= another": lambda names: ["x"].__iadd__(names),
    "slice of another": lambda names: (other := ["x"], other.__setitem__(slice(0, 1), names), other),
    "json": json.dumps,
    "array": lambda names: np.array(names).tolist(),
    "isin": lambda names: np.isin(names, ["agent_3"]).tolist(),
    "join": "".join,
    "fromkeys": lambda names: dict.fromkeys(names, 0),
    "zip": lambda names: dict(zip(names, range(N), strict=True)),
    "unpacked": lambda names: "{} {}".format(*names),
    "append": changed(lambda names: names.append("x")),
    "insert": changed(lambda names: names.insert(1, "x")),
    "extend": changed(lambda names: names.extend(["x"])),
    "pop": changed(lambda names: names.pop()),
    "remove": changed(lambda names: names.remove("agent_3")),
    "clear": changed(lambda names: names.clear()),
    "sort": changed(lambda names: names.sort(reverse=True)),
    "reverse": changed(lambda names: names.reverse()),
    "assign": changed(lambda names: names.__setitem__(0, "x")),
    "delete": changed(lambda names: names.__delitem__(slice(2, 4))),
    "+=": changed(lambda names: names.__iadd__(["x"])),
    "*=": changed(lambda names: names.__imul__(2)),
}


@pytest.mark.parametrize("read", READS)
def test_reads_without_making_names(read: str) -> None:
    names = AgentList(Names(N))
    assert READS[read](names) == READS[read](PLAIN)
    assert not filled(names)


@pytest.mark.parametrize("use", [*READS, *USES])
@pytest.mark.parametrize("before", [False, True], ids=["unfilled", "filled"])
def test_is_a_list(use: str, before: bool) -> None:
    names = AgentList(Names(N))
    if before:
        iter(names)
    call = {**READS, **USES}[use]
    assert call(names) == call(PLAIN.copy())


@pytest.mark.parametrize(
    "copied",
    [copy.copy, copy.deepcopy, lambda names: pickle.loads(pickle.dumps(names)), lambda names: names.copy()],
)
def test_copies_are_plain_lists(copied: Callable[[list[str]], list[str]]) -> None:
    names = AgentList(Names(N))
    made = copied(names)
    made.append("x")
    assert (type(made), made, names) == (list, [*PLAIN, "x"], PLAIN)


@pytest.mark.parametrize("wrong", [N, -N - 1, "0", 1.5])
@pytest.mark.parametrize("before", [False, True])
def test_no_such_element(wrong: Any, before: bool) -> None:
    names = AgentList(Names(N))
    if before:
        iter(names)
    with pytest.raises(IndexError if isinstance(wrong, int) else TypeError) as expected:
        PLAIN[wrong]
    with pytest.raises(expected.type):
        names[wrong]


def test_two_lists_of_the_same_names_are_equal_unfilled() -> None:
    names = Names(N)
    one, other = AgentList(names), AgentList(names)
    assert one == other
    assert not filled(one)
    assert AgentList(Names(N)) == other
    iter(one)
    assert one == other == one
    one.append("x")
    assert one != other


def test_names_of_some() -> None:
    present = np.arange(N) % 3 == 1
    here = AgentList(Names(N).of(present))
    expected = [name for name, there in zip(PLAIN, present, strict=True) if there]
    assert (len(here), here[1], here[1:]) == (len(expected), expected[1], expected[1:])
    assert [name in here for name in PLAIN] == present.tolist()
    assert not filled(here)
    assert here == expected
    assert Names(N).of(~present | present)[:] == PLAIN


@pytest.mark.parametrize("env_id", ["CliffWalking", "LevelBasedForaging"])
@pytest.mark.parametrize("autoreset", [True, False])
@pytest.mark.parametrize("wrapped", [False, True])
def test_steps_of_arrays_make_no_names(env_id: str, autoreset: bool, wrapped: bool) -> None:
    env: Any = pearl_marl.parallel_env(env_id, 24, autoreset=autoreset, max_cycles=3)
    zeros = np.zeros(24, env.spec.action.dtype)
    if wrapped:
        env = pearl_marl.wrappers.clip_reward_v0(env)
    assert env.agents == []
    env.reset(seed=0)
    for _ in range(2):
        env.step(zeros)
    env.step_batch(zeros)
    assert env.observation_space("agent_23") is not None
    assert len(env.agents) == (24 if autoreset else 0)
    for names in (env.possible_agents, env.agents) if autoreset else (env.possible_agents,):
        assert isinstance(names, list)
        assert not filled(names)
    assert "slots" not in vars(env)
    assert env.rows == {agent: slot for slot, agent in enumerate(env.possible_agents)}
    env.close()


def test_what_is_done_to_the_public_lists_is_nobody_elses() -> None:
    env = pearl_marl.parallel_env("CliffWalking", 4)
    env.reset(seed=0)
    env.agents.clear()
    env.possible_agents.reverse()
    assert list(env.step(np.zeros(4, np.int64))[0]) == PLAIN[:4]
    assert env.rows["agent_3"] == 3
    env.close()
