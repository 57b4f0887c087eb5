"""The best actions of networks of floats, beside the environments: those of the network for each step."""

from __future__ import annotations

import importlib
from typing import Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from numba import types

from pearl_marl import get_spec
from pearl_marl.compiler.addresses import in_memory
from pearl_marl.devices import BatchConfig, make_device
from pearl_marl.devices.native import Native
from pearl_marl.evaluation.run import Evaluation

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
trained = importlib.import_module("pearl_marl.policies.trained")
run = importlib.import_module("pearl_marl.training.run")


def policy_for(name: str, kind: str = "logits", **options: Any) -> Any:
    """Return a policy that takes several actions, by statistics of its own."""
    torch.manual_seed(5)
    policy = trained.NetworkPolicy(get_spec(name), kind, 24, **options)
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter += 0.3 * torch.randn_like(parameter)
        if policy.network.encoder.kind == "vector":
            policy.network.encoder.mean += 0.01
            policy.network.encoder.variance.fill_(0.5)
    return policy


def episodes(policy: Any, chosen_by: Any) -> list[npt.NDArray[Any]]:
    evaluation = Evaluation(policy.spec, chosen_by, policy.spec.agents * 70, seed=3, max_cycles=80)
    assert sum(1 for _ in evaluation.run()) == evaluation.episodes
    return [evaluation.returns, evaluation.lengths]


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("CartPole", {}),
        ("Acrobot", {"kind": "values", "layer_norm": True}),
        ("Blackjack", {}),
        ("Taxi", {"kind": "values"}),
        ("Game2048", {}),
        ("CoinGame", {"sharing": "indicator"}),
        ("LevelBasedForaging", {"sharing": "indicator", "layer_norm": True}),
    ],
)
def test_episodes_are_those_of_single_steps(name: str, options: dict[str, Any]) -> None:
    """With vectors, numbers, masks, several agents and layers that are standardised."""
    policy = policy_for(name, **options)
    assert policy.beside is not None
    alone, beside = (episodes(policy, chosen_by) for chosen_by in (policy.function, policy.beside))
    for expected, found in zip(alone, beside, strict=True):
        np.testing.assert_array_equal(found, expected)
    space = policy.spec.observation_space
    space.seed(0)
    assert len(np.unique(policy.choose(np.stack([space.sample() for _ in range(50)])))) > 1


def test_compiled_it_does_as_called_for_each_step() -> None:
    """What it chooses where no loop is compiled for it."""
    policy, found = policy_for("Game2048").beside, []
    for name in ("native", "reference"):
        device = make_device(name)
        device.open(BatchConfig(spec=policy.spec, n_envs=70, max_cycles=40))
        device.reset(1)
        result = device.rollout(policy, 60)
        found.append((result.returns, result.lengths, device.snapshot().memory))
    for native, reference in zip(*found, strict=True):
        np.testing.assert_array_equal(native, reference)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("CartPole", {"temperature": 1.0}),
        ("CartPole", {"kind": "values", "epsilon": 0.1}),
        ("CartPole", {"memory": "gru"}),
        ("Pendulum", {"kind": "mean"}),
        ("Seaquest", {}),
        ("MemoryChain", {}),
        ("CoinGame", {"sharing": "none"}),
    ],
)
def test_others_are_called_for_each_step(name: str, options: dict[str, Any]) -> None:
    """Those of drawn actions, memories, levels, pictures, rounded floats and networks of several agents."""
    options = {"kind": "logits", **options}
    assert trained.NetworkPolicy(get_spec(name), options.pop("kind"), 8, **options).beside is None


def test_evaluations_of_trainings_run_beside(monkeypatch: pytest.MonkeyPatch) -> None:
    policy, rolled_out = policy_for("CartPole"), []
    found = Native.rollout

    def noted(self: Native, *arguments: Any, **options: Any) -> Any:
        rolled_out.append(arguments[0])
        return found(self, *arguments, **options)

    monkeypatch.setattr(Native, "rollout", noted)
    figures = run.evaluate(policy, policy.spec, 50)
    assert {type(policy).__name__ for policy in rolled_out} == {"DenseNetwork"}
    returns = Evaluation(policy.spec, policy.function, 50, seed=1)
    for _ in returns.run():
        pass
    assert figures["eval_return"] == returns.returns.mean()
    assert figures["eval_deviation"] == returns.returns.std()


def test_fields_of_other_types_are_refused() -> None:
    class Fields(NamedTuple):
        whole: Annotated[npt.NDArray[Any], types.Array(types.int64, 1, "C")]

    with pytest.raises(TypeError, match=r"array\(float64.*it must be .*array\(int64"):
        in_memory(Fields(np.zeros(2)))
