"""Results read by compiled code, which calls no method: it gets the truth or an error, never nothing."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.interfaces.agent_dict import FEW

MANY = FEW + 1


def there_and_back(library: str) -> Callable[[Any], Any]:
    """Return what encodes by a library and decodes the bytes again, by another where that reads the same."""
    module = importlib.import_module(library)
    if library == "msgspec":
        return lambda value: module.json.decode(module.json.encode(value))
    if library == "msgpack":
        return lambda value: module.unpackb(module.packb(value))
    if library == "cbor2":
        return lambda value: module.loads(module.dumps(value))
    return lambda value: json.loads(module.dumps(value))


def pydantic(value: Any) -> Any:
    adapter = importlib.import_module("pydantic").TypeAdapter(type(plain(value)))
    return json.loads(adapter.dump_json(value))


def polars(value: Any) -> Any:
    frame = importlib.import_module("polars")
    return (
        frame.DataFrame([value]).to_dicts()[0] if isinstance(value, dict) else frame.Series(value).to_list()
    )


def pyarrow(value: Any) -> Any:
    (there,) = importlib.import_module("pyarrow").array([value]).to_pylist()
    return there


def pandas(value: Any) -> Any:
    series = importlib.import_module("pandas").Series(value)
    return series.to_dict() if isinstance(value, dict) else series.to_list()


LIBRARIES: dict[str, Callable[[Any], Any] | None] = {
    **dict.fromkeys(["orjson", "msgspec", "ujson", "rapidjson", "msgpack", "cbor2", "simplejson"]),
    "pydantic": pydantic,
    "polars": polars,
    "pyarrow": pyarrow,
    "pandas": pandas,
}

RESULTS = {
    "observations": 0,
    "rewards": 1,
    "terminations": 2,
    "infos": 4,
}


def plain(value: Any) -> Any:
    """Return the truth, by Python's own means."""
    return dict(value.items()) if isinstance(value, dict) else list(iter(value))


def twice(rewards: dict[str, float]) -> dict[str, float]:
    return {name: 2 * reward for name, reward in rewards.items()}


def results(n: int) -> dict[str, Any]:
    """Return what a user may get from an environment, nothing of it read."""
    env = pearl_marl.parallel_env("CliffWalking", n, autoreset=False)
    possible = env.possible_agents
    env.reset(seed=0)
    step = env.step(np.full(n, 1))
    found = {what: step[index] for what, index in RESULTS.items()}
    return {**found, "agents": env.agents, "possible_agents": possible}


@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize("what", [*RESULTS, "agents", "possible_agents"])
@pytest.mark.parametrize("n", [1, FEW, MANY, 300])
def test_compiled_code_gets_the_truth_or_an_error(library: str, what: str, n: int) -> None:
    pytest.importorskip(library)
    encode = LIBRARIES[library] or there_and_back(library)
    value, truth = results(n)[what], plain(results(n)[what])
    assert len(truth) == n
    try:
        expected = encode(truth)
    except Exception as error:  # NumPy's numbers are none of an encoder's, as in a plain dict
        with pytest.raises(type(error)):
            encode(value)
        return
    try:
        got = encode(value)
    except Exception:
        assert n > FEW, "few are there from the start"
    else:
        assert got == expected
    # Nothing is lost by it, and what has been read is encoded as any dict or list is.
    assert plain(value) == truth
    assert encode(value) == expected


@pytest.mark.parametrize("n", [1, FEW, MANY])
def test_another_of_the_same_type_takes_what_dict_takes(n: int) -> None:
    for name, value in results(n).items():
        other = type(value)(plain(value))
        assert other == plain(value), name
        assert isinstance(other, type(plain(value))), name
    made: Any = type(results(n)["rewards"])
    assert made([("a", 1)], b=2) == {"a": 1, "b": 2}
    assert made() == {}


@pytest.mark.parametrize("n", [1, FEW, MANY])
class TestTrees:
    def test_dm_tree(self, n: int) -> None:
        tree = pytest.importorskip("tree")
        first, other = results(n), results(n)
        if n > FEW:  # it reads a dict's memory
            with pytest.raises(TypeError, match="_Unread"):
                tree.map_structure(lambda a, b: a + b, first["rewards"], other["rewards"])
            assert plain(first["rewards"]) == plain(other["rewards"])
        total = tree.map_structure(lambda a, b: a + b, first["rewards"], other["rewards"])
        assert dict(total) == twice(first["rewards"])
        observations = plain(first["observations"])
        assert tree.flatten(first["observations"]) == [observations[name] for name in sorted(observations)]

    def test_torch(self, n: int) -> None:
        from torch.utils import _pytree as trees

        self.check(trees.tree_map, trees.tree_leaves, n)
        paths = [path for path, _ in trees.tree_flatten_with_path(results(n)["rewards"])[0]]
        assert paths[0] == (trees.MappingKey("agent_0"),)

    def test_jax(self, n: int) -> None:
        trees = pytest.importorskip("jax.tree_util")
        self.check(trees.tree_map, trees.tree_leaves, n)
        paths = [path for path, _ in trees.tree_flatten_with_path(results(n)["rewards"])[0]]
        assert paths[0] == (trees.DictKey("agent_0"),)

    def check(self, mapped: Callable[..., Any], leaves: Callable[[Any], list[Any]], n: int) -> None:
        first, other = results(n), results(n)
        assert leaves(first["terminations"]) == [False] * n
        total = mapped(lambda a, b: a + b, first["rewards"], other["rewards"])
        assert total == twice(first["rewards"])
        assert type(total) is dict
        assert len(leaves([first["observations"], {"x": other["observations"]}])) == 2 * n

    def test_collating(self, n: int) -> None:
        from torch.utils.data import default_collate

        rewards = plain(results(n)["rewards"])
        batch = default_collate([results(n)["rewards"], results(n)["rewards"]])
        assert {name: value.tolist() for name, value in batch.items()} == {
            name: [reward, reward] for name, reward in rewards.items()
        }
