"""AgentDict is a plain dict to everyone: any sequence of operations does to it what it does to a dict."""

from __future__ import annotations

import copy
import json
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, Tuple
from hypothesis import given, settings
from hypothesis import strategies as st

from pearl_marl.interfaces.agent_dict import AgentDict, ended_infos, observations_in


@pytest.fixture(autouse=True)
def few_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have containers of any size filled when they are read, and none from the start."""
    monkeypatch.setattr("pearl_marl.interfaces.agent_dict.FEW", -1)


def pair(n: int) -> tuple[AgentDict, dict[str, Any]]:
    agents = [f"agent_{i}" for i in range(n)]
    array = np.arange(n, dtype=np.float64) / 4
    return AgentDict.of(agents, array, np.ndarray.tolist), dict(zip(agents, array.tolist(), strict=True))


class Named:
    """A function with a name that Hypothesis can show."""

    def __init__(self, name: str, function: Callable[[Any], Any]) -> None:
        self.name, self.function = name, function

    def __repr__(self) -> str:
        return self.name

    def __call__(self, d: Any) -> Any:
        """Return the result, or the type of what was raised."""
        try:
            return self.function(d)
        except (KeyError, TypeError, StopIteration) as error:
            return type(error)


def delete(d: Any, key: str) -> None:
    del d[key]


def assign(d: Any, key: str, value: Any) -> None:
    d[key] = value


def in_place_or(d: Any, other: dict[str, Any]) -> bool:
    before = d
    d |= other
    return d is before


def match(d: Any) -> Any:
    match d:
        case {"agent_1": value, **rest}:
            return value, rest
        case dict():
            return "no agent_1"


def keyword_arguments(**kwargs: Any) -> dict[str, Any]:
    return kwargs


def changed_while_iterating(d: Any) -> Any:
    try:
        for key in d:
            d[key + "_"] = 0
    except RuntimeError as error:
        return str(error)
    return "empty"


OTHER = {"agent_1": -1.0, "new": 5}
KEYS = st.sampled_from(["agent_0", "agent_1", "agent_7", "agent_99", "__all__", "new"])

READS = [
    Named("iter", lambda d: [key for key in d]),  # noqa: C416 (__iter__ is what is tested)
    Named("list", list),
    Named("len", len),
    Named("bool", bool),
    Named("repr", repr),
    Named("reversed", lambda d: list(reversed(d))),
    Named("keys", lambda d: (list(d.keys()), len(d.keys()), "agent_1" in d.keys())),  # noqa: SIM118
    Named("keys & set", lambda d: d.keys() & {"agent_1", "x"}),
    Named("values", lambda d: list(d.values())),
    Named("items", lambda d: list(d.items())),
    Named("reversed items", lambda d: list(reversed(d.items()))),
    Named("next", lambda d: next(iter(d))),
    Named("unpack", lambda d: {**d}),
    Named("unpack into a call", lambda d: keyword_arguments(**d)),
    Named("unpack keys", lambda d: [*d]),
    Named("dict", dict),
    Named("dict with keywords", lambda d: dict(d, x=1)),
    Named("update of a dict", lambda d: (other := {"a": 1}, other.update(d))[0]),
    Named("|= of a dict", lambda d: [other := {"a": 1}, other.__ior__(d)]),
    Named("|", lambda d: d | OTHER),
    Named("| from the right", lambda d: OTHER | d),
    Named("| itself", lambda d: d | d),
    Named("==", lambda d: (d == OTHER, d == dict(d), dict(d) == d, d != OTHER, d == 5)),
    Named("in a list ==", lambda d: [d] == [dict(d)]),
    Named("copy", lambda d: d.copy()),
    Named("copy.copy", copy.copy),
    Named("deepcopy", copy.deepcopy),
    Named("pickle", lambda d: pickle.loads(pickle.dumps(d))),
    Named("old pickle", lambda d: pickle.loads(pickle.dumps(d, protocol=0))),
    Named("json", json.dumps),
    Named("json, indented", lambda d: json.dumps(d, indent=1, sort_keys=True)),
    Named("json, nested", lambda d: json.dumps([{"x": d}])),
    Named("fromkeys", lambda d: type(d).fromkeys(["a", "b"], 3)),
    Named("fromkeys of it", lambda d: dict.fromkeys(d, 0)),
    Named("sorted", sorted),
    Named("max", lambda d: max(d, default=None)),
    Named("zip", lambda d: list(zip(d, d.values(), strict=True))),
    Named("set", set),
    Named("match", match),
    Named("hash", hash),
    Named("isinstance", lambda d: isinstance(d, dict)),
    Named("| of a list", lambda d: d | [1]),
]

WRITES = st.one_of(
    st.tuples(KEYS, st.integers()).map(lambda kv: Named(f"d[{kv[0]!r}] = {kv[1]}", lambda d: assign(d, *kv))),
    KEYS.map(lambda k: Named(f"del d[{k!r}]", lambda d: delete(d, k))),
    KEYS.map(lambda k: Named(f"pop({k!r})", lambda d: d.pop(k))),
    KEYS.map(lambda k: Named(f"pop({k!r}, None)", lambda d: d.pop(k, None))),
    KEYS.map(lambda k: Named(f"d[{k!r}]", lambda d: d[k])),
    KEYS.map(lambda k: Named(f"get({k!r})", lambda d: (d.get(k), d.get(k, "?")))),
    KEYS.map(lambda k: Named(f"{k!r} in d", lambda d: k in d)),
    KEYS.map(lambda k: Named(f"setdefault({k!r}, 8)", lambda d: d.setdefault(k, 8))),
    st.sampled_from(
        [
            Named("popitem", lambda d: d.popitem()),
            Named("clear", lambda d: d.clear()),
            Named("update", lambda d: d.update(OTHER)),
            Named("update by pairs", lambda d: d.update([("new", 1)], agent_0=2)),
            Named("|=", lambda d: in_place_or(d, OTHER)),
            Named("update itself", lambda d: d.update(d)),
            Named("changed while iterating", changed_while_iterating),
        ]
    ),
)


def assert_same(lazy: Any, plain: Any, operation: Named) -> None:
    ours, theirs = operation(lazy), operation(plain)
    assert type(ours) is type(theirs), operation
    assert ours == theirs, operation


@pytest.mark.parametrize("n", [0, 1, 8])
@pytest.mark.parametrize("operation", READS, ids=repr)
def test_first_use(operation: Named, n: int) -> None:
    """Each operation as the very first one, when nothing has been filled in."""
    lazy, plain = pair(n)
    if n == 0 and operation.name == "isinstance":
        assert operation(lazy)
    assert_same(lazy, plain, operation)
    assert list(lazy.items()) == list(plain.items())


@settings(max_examples=300)
@given(st.integers(0, 8), st.lists(st.one_of(WRITES, st.sampled_from(READS)), max_size=12))
def test_any_sequence(n: int, operations: list[Named]) -> None:
    lazy, plain = pair(n)
    for operation in operations:
        assert_same(lazy, plain, operation)
        assert len(lazy) == len(plain)
    assert list(lazy.items()) == list(plain.items())


@pytest.mark.parametrize("n", [0, 1, 8])
def test_two_unread_ones(n: int) -> None:
    """Operations of two AgentDicts, neither of which has been looked into."""
    assert pair(n)[0] == pair(n)[0]
    assert (pair(n)[0] != pair(n)[0]) is False
    assert (pair(n)[0] != pair(n + 1)[0]) is True
    assert pair(n)[0] | pair(n + 1)[0] == pair(n + 1)[1]
    left = pair(n)[0]
    left |= pair(n + 1)[0]
    assert left == pair(n + 1)[1]
    left = pair(n)[0]
    left.update(pair(n + 1)[0])
    assert left == pair(n + 1)[1]


def test_all_marker_of_rllib() -> None:
    lazy, plain = pair(3)
    lazy["__all__"] = plain["__all__"] = False
    assert lazy == plain
    assert list(lazy) == [*plain]


def test_a_copy_is_its_own() -> None:
    for make in (dict, copy.copy, copy.deepcopy, lambda d: d.copy(), lambda d: pickle.loads(pickle.dumps(d))):
        lazy, plain = pair(3)
        other = make(lazy)
        assert type(other) is dict
        other["agent_0"] = "changed"
        assert lazy == plain


def test_nothing_is_filled_before_it_is_needed() -> None:
    """That is what it is for; ``array`` and ``len`` need nothing."""
    calls = []

    def values(array: np.ndarray) -> list[Any]:
        calls.append(array)
        return array.tolist()

    array = np.arange(5.0)
    lazy = AgentDict.of([f"agent_{i}" for i in range(5)], array, values)
    assert len(lazy) == 5
    assert lazy
    assert lazy.array is array
    assert not calls
    assert lazy["agent_3"] == 3.0
    assert list(lazy.values()) == array.tolist()
    assert len(calls) == 1


def test_kinds_of_values() -> None:
    flat, square = np.arange(3), np.arange(6.0).reshape(3, 2)
    scalars, rows = observations_in(Discrete(3)), observations_in(Box(0, 5, (2,)))
    assert [type(v) for v in scalars(flat)] == [np.int64] * 3
    assert np.shares_memory(rows(square)[1], square)
    pairs = observations_in(Tuple((Discrete(5), Discrete(6))))
    assert pairs(square.astype(int)) == [(0, 1), (2, 3), (4, 5)]
    flags = AgentDict.of(["agent_0", "agent_1"], np.array([True, False]), np.ndarray.tolist)
    assert [type(flag) for flag in flags.values()] == [bool, bool]
    infos = ended_infos(square, lambda array, _: rows(array))(np.array([False, True, False]))
    assert infos[0] == infos[2] == {}
    assert infos[0] is not infos[2], "a wrapper may write into each of them"
    np.testing.assert_array_equal(infos[1]["final_obs"], square[1])
