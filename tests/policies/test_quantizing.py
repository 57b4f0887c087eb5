"""From trained policies to policies in integers, and their files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box

import pearl_marl
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.devices.rollouts import look
from pearl_marl.errors import ArgumentError
from pearl_marl.evaluation import Evaluation
from pearl_marl.policies import integer_file
from pearl_marl.policies.device_policy import Array, policy_draws
from pearl_marl.policies.integer_network import AgentNetworks, IntegerNetwork, Patches, table_network
from pearl_marl.spec import EnvSpec

from .networks import random_network

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install '.[train]'")

from pearl_marl.policies.quantizing import quantized  # noqa: E402
from pearl_marl.policies.trained import NetworkPolicy, TabularPolicy  # noqa: E402

N = 60


def reached(name: str, steps: int = 30) -> tuple[Array, Array, Array | None]:
    """Return observations after random steps: as the environment shows them, as elements, and their masks."""
    spec = pearl_marl.get_spec(name)
    device = Native()
    device.open(BatchConfig(spec=spec, n_envs=N))
    obs, rng = device.reset(seed=1), np.random.default_rng(2)
    for _ in range(steps):
        masks = device.action_masks
        if masks is not None:
            actions = (rng.random(masks.shape) * masks).argmax(1)
        elif spec.action_counts:
            actions = rng.integers(0, spec.action_counts[0], N * spec.agents)
        else:
            actions = rng.uniform(-1, 1, (N * spec.agents, len(spec.action_fields)))
        obs = device.step(actions).obs
    elements = look(device.config, spec.in_elements, device.snapshot().memory).obs
    return obs, elements, device.action_masks


def trained(name: str, kind: str, width: int = 24, **how: Any) -> NetworkPolicy:
    """Return a network as if it had been trained: with statistics, and outputs that tell actions apart."""
    torch.manual_seed(3)
    policy = NetworkPolicy(pearl_marl.get_spec(name), kind, width, **how)
    obs = torch.from_numpy(reached(name)[0])
    policy.network.see(obs, policy.positions(len(obs)))
    with torch.no_grad():
        for network in policy.network if how.get("sharing") == "none" else [policy.network]:
            network.output.weight.mul_(100 if kind != "values" else 3)
    return policy


@pytest.mark.parametrize(
    ("name", "kind", "how"),
    [
        ("CartPole", "logits", {}),
        ("Taxi", "values", {}),
        ("ConnectFour", "logits", {}),
        ("LevelBasedForaging", "logits", {"sharing": "indicator"}),
        ("LevelBasedForaging", "logits", {"sharing": "none"}),
        # Planes of numbers, and of floats.
        ("Overcooked", "logits", {"sharing": "indicator"}),
        ("Snake", "logits", {"bits": 10}),
        ("Pendulum", "mean", {}),
        # Floats that unpack() writes, and reals.
        ("Catch", "logits", {}),
        ("MemoryChain", "logits", {}),
        ("Acrobot", "logits", {}),
        ("MountainCarContinuous", "mean", {}),
    ],
)
def test_integers_choose_as_floats_do(name: str, kind: str, how: dict[str, Any]) -> None:
    how = {"bits": 12, **how}
    bits = how.pop("bits")
    policy = trained(name, kind, **how)
    obs, elements, masks = reached(name, 12)
    network = quantized(policy, obs, weight_bits=bits, activation_bits=bits)
    agents = np.arange(len(obs)) % policy.spec.agents
    words = network.choose(elements, agents, masks, np.zeros((len(obs), 0), np.uint32)).words
    wanted = policy.choose(obs, masks)
    if kind == "mean":
        values = words * 2.0 ** -policy.spec.action_fields[0].fraction
        assert np.abs(values - wanted).max() < 0.05
        assert np.ptp(values) > 0.2
    else:
        rows = np.ones(len(obs), np.bool_) if masks is None else masks.any(1)
        assert (words[rows, 0] == wanted[rows]).mean() > 0.97
        assert len(np.unique(wanted[rows])) > 1


def test_planes_that_may_be_below_0_are_refused() -> None:
    bits = pearl_marl.get_spec("TicTacToe")
    below = replace(bits, observation_space=Box(-1, 1, bits.observation_shape, np.int8))
    with pytest.raises(ArgumentError, match=r"planes of numbers from 0 to a bound, and .* reach -1"):
        replace(random_network(bits, 5), spec=below)
    with pytest.raises(ArgumentError, match=r"cannot become one in integers: .* reach -1"):
        quantized(NetworkPolicy(below, "logits", 8), np.zeros((4, *bits.observation_shape), np.int8))


def test_elements_without_a_binary_point_are_not_shifted() -> None:
    network = random_network(pearl_marl.get_spec("TicTacToe"), 5)
    assert isinstance(network.inputs, Patches)
    with pytest.raises(ArgumentError, match="elements are shifted by 1; possible are 0 to 0"):
        replace(network, inputs=network.inputs._replace(element_shift=1))


def test_layers_share_a_table_where_weights_are_large_enough() -> None:
    """An engine in hardware has one."""
    policy = trained("CartPole", "logits")
    first, second, _ = quantized(policy, reached("CartPole")[0]).layers
    assert len(first.activation)
    assert np.array_equal(first.activation, second.activation)
    coarse = quantized(policy, reached("CartPole")[0], 4, 4).layers
    assert max(np.abs(layer.weights).max() for layer in coarse) <= 7


def test_drawn_actions_keep_their_probabilities() -> None:
    policy = trained("CartPole", "logits", temperature=2.0)
    obs, elements, _ = reached("CartPole", 12)
    network = quantized(policy, obs, 12, 12)
    with torch.no_grad():
        chances = (policy(torch.from_numpy(obs)) / 2.0).softmax(-1).numpy()[:, 1]
    slots, agents = np.arange(N), np.zeros(N, np.int64)
    drawn = [
        network.choose(elements, agents, None, policy_draws(1, (1, 2), tick, slots, agents, 1)).words[:, 0]
        for tick in range(800)
    ]
    assert np.abs(np.mean(drawn, 0) - chances).max() < 0.08


def test_tables_keep_the_order_of_their_values() -> None:
    policy = TabularPolicy(pearl_marl.get_spec("Blackjack"))
    policy.values.copy_(torch.randn(policy.values.shape).round(decimals=1))
    network = quantized(policy, np.zeros((0, 3)))
    obs, elements, _ = reached("Blackjack")
    words = network.choose(elements, np.zeros(N, int), None, np.zeros((N, 0), np.uint32)).words[:, 0]
    assert np.array_equal(words, policy.choose(obs))


def test_more_bits_are_nearer() -> None:
    policy = trained("CartPole", "logits")
    obs, elements, _ = reached("CartPole", 12)
    with torch.no_grad():
        wanted = policy(torch.from_numpy(obs)).numpy()
    wanted = wanted[:, 1] - wanted[:, 0]
    errors = []
    for bits in (4, 6, 8, 12):
        sums = quantized(policy, obs, bits, bits).sums(elements, np.zeros(N, int))
        found = (sums[:, 1] - sums[:, 0]).astype(float)
        found *= np.linalg.lstsq(found[:, None], wanted, rcond=None)[0][0]
        errors.append(np.abs(found - wanted).mean())
    assert errors == sorted(errors, reverse=True)


def test_what_cannot_be_quantised_is_refused() -> None:
    obs = reached("CartPole", 1)[0]
    with pytest.raises(ArgumentError, match="weight_bits is 3"):
        quantized(trained("CartPole", "logits"), obs, weight_bits=3)
    foraging = pearl_marl.get_spec("LevelBasedForaging")
    for given, says in (
        ({"memory": "gru"}, "the policy has a memory"),
        ({"layer_norm": True}, "the policy's layers are standardised"),
    ):
        with pytest.raises(ArgumentError, match=says):
            quantized(NetworkPolicy(foraging, "logits", 8, **given), obs)


def test_commands_refuse_before_they_evaluate_or_train(
    tmp_path: Path, pearl: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Evaluation, "run", None)
    policy = NetworkPolicy(pearl_marl.get_spec("CartPole"), "values", 8, layer_norm=True)
    policy.save(tmp_path / "policy.safetensors")
    status, _, err = pearl("quantize", str(tmp_path))
    assert status == 2
    assert "the policy's layers are standardised" in err
    out = tmp_path / "out"
    for line, says in (
        ("CartPole --algo pqn --quantize", "--quantize: the policy's layers are standardised"),
        ("CartPole --memory gru --quantize", "--quantize: the policy has a memory"),
        # What an environment is learned by depends on --quantize, and an error says what it is.
        ("MountainCar --quantize --set clip=0", "--set clip is 0; it must be"),
        ("MountainCar --set clip=0.1", "pqn has no such setting; there are"),
        ("MountainCar --set clip=0.1", "(without --algo, pqn learns MountainCar)"),
        ("MountainCar --quantize --set q_lambda=1", "(without --algo, ppo learns MountainCar)"),
    ):
        status, _, err = pearl("train", *line.split(), "--out", str(out))
        assert status == 2
        assert says in err
    assert not out.exists()


@pytest.mark.parametrize("name", ["CartPole", "Taxi", "ConnectFour", "Pendulum"])
def test_files_keep_policies(tmp_path: Path, name: str) -> None:
    network, file = random_network(pearl_marl.get_spec(name), 4), tmp_path / "integers.safetensors"
    integer_file.save(network, file)
    again = pearl_marl.load_policy(tmp_path)
    assert isinstance(again, IntegerNetwork)
    elements = reached(name)[1]
    agents = np.arange(len(elements)) % network.spec.agents
    draws = np.random.default_rng(0).integers(0, 1 << 32, (len(elements), network.draws), np.uint32)
    one, other = (of.choose(elements, agents, None, draws) for of in (network, again))
    assert np.array_equal(one.words, other.words)


MEETING = pearl_marl.get_spec("LevelBasedForaging")


def networks_of_agents(spec: EnvSpec = MEETING) -> AgentNetworks:
    """Return a network for each agent of a world, each another one."""
    made = (random_network(spec, seed) for seed in range(spec.agents))
    return AgentNetworks(tuple(replace(network, indicator=network.indicator[:0]) for network in made))


def test_each_agent_may_have_a_network(tmp_path: Path) -> None:
    """A rollout of them is as their own choices say, and their file keeps them."""
    policy = networks_of_agents()
    integer_file.save(policy, tmp_path / "integers.safetensors")
    again = pearl_marl.load_policy(tmp_path)
    assert isinstance(again, AgentNetworks)
    device = Native()
    device.open(BatchConfig(spec=MEETING, n_envs=5, max_cycles=4))
    device.reset(seed=1)
    rolled = device.rollout(again, 9, record=True)
    assert rolled.observations is not None
    assert rolled.logits is not None
    for agent, network in enumerate(policy.networks):
        for observed, logits in zip(rolled.observations, rolled.logits, strict=True):
            own = observed[agent :: MEETING.agents]
            due = network.sums(own, np.zeros(len(own), int))
            assert np.array_equal(logits[agent :: MEETING.agents], due)


def test_each_agent_is_given_its_own_masks_and_draws() -> None:
    policy, n = networks_of_agents(pearl_marl.get_spec("ConnectFour")), 12
    rng = np.random.default_rng(1)
    elements = rng.integers(0, 2, (n, 84))
    masks = rng.integers(0, 2, (n, 7)).astype(np.int8)
    draws = rng.integers(0, 1 << 32, (n, 1), np.uint32)
    agents = np.arange(n) % 2
    choice = policy.choose(elements, agents, masks, draws)
    for k in range(n):
        alone = slice(k, k + 1)
        own = policy.networks[k % 2].choose(elements[alone], agents[alone], masks[alone], draws[alone])
        assert choice.words[k] == own.words[0]


def test_rollouts_of_networks_of_agents_are_not_timed(tmp_path: Path, pearl: Any) -> None:
    integer_file.save(networks_of_agents(), tmp_path / "integers.safetensors")
    status, _, err = pearl("bench", "rollouts", str(tmp_path))
    assert status == 2
    assert "has a network for each of the 2 agents of a world" in err


def test_networks_of_agents_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    from pearl_marl.policies import policy_file

    policy, file = networks_of_agents(), tmp_path / "integers.safetensors"
    with pytest.raises(ArgumentError, match="needs 2 networks, one for each agent; given: 1"):
        AgentNetworks(policy.networks[:1])
    others = networks_of_agents(MEETING.with_options(sight=2)).networks
    with pytest.raises(ArgumentError, match=r"agent 1 is for LevelBasedForaging-v. with .*'sight': 2"):
        AgentNetworks((policy.networks[0], others[1]))
    integer_file.save(policy, file)
    about, tensors = policy_file.read(file)
    for change, says in (
        ({"agents": about["agents"][:1]}, "a tensor 'agent.1.*of none of its agents"),
        ({"agents": [1, 2]}, "must describe each agent's network"),
        ({"agents": []}, "must describe each agent's network"),
    ):
        policy_file.write(file, {**about, **change}, tensors)
        with pytest.raises(ArgumentError, match=says):
            pearl_marl.load_policy(file)


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    """Each in one sentence; with a right checksum, too, where what it says is impossible."""
    file, rng = tmp_path / "policy.safetensors", np.random.default_rng(1)
    integer_file.save(random_network(pearl_marl.get_spec("CartPole"), 4), file)
    content = file.read_bytes()
    for _ in range(200):
        damaged = bytearray(content)
        damaged[rng.integers(len(damaged))] ^= 1 << int(rng.integers(8))
        file.write_bytes(bytes(damaged[: rng.integers(len(damaged))] if rng.random() < 0.2 else damaged))
        with pytest.raises(ArgumentError):
            pearl_marl.load_policy(file)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"environment": "os:system"}, "no environment"),
        ({"layers": 10**9}, "1000000000 layers"),
        ({"layers": 2}, "6 outputs for actions"),
        ({"layer.0": {"shift": -1, "limit": 127}}, "layer.0 has the shift -1"),
        ({"layer.0": {"shift": 5}}, "layer.0 has the fields"),
        ({"inputs": {"kind": "rows"}}, "inputs.first is nothing"),
        ({"head": {"kind": "actions", "counts": [3], "shift": 3}}, "2 outputs for actions"),
        ({"head": {"kind": "actions", "counts": [2], "shift": "x"}}, "head has the shift"),
    ],
)
def test_impossible_descriptions_are_refused(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    from pearl_marl.policies import policy_file

    file = tmp_path / "policy.safetensors"
    integer_file.save(random_network(pearl_marl.get_spec("CartPole"), 4), file)
    about, tensors = policy_file.read(file)
    policy_file.write(file, {**about, **change}, tensors)
    with pytest.raises(ArgumentError, match=message) as caught:
        pearl_marl.load_policy(file)
    assert "\n" not in str(caught.value)


def test_values_of_a_table_are_taken_as_they_are_counted() -> None:
    spec = pearl_marl.get_spec("FrozenLake")
    values = np.random.default_rng(0).integers(0, 9, (16, 4))
    network = table_network(spec, values)
    words = network.choose(np.arange(16), np.zeros(16, int), None, np.zeros((16, 0), np.uint32)).words[:, 0]
    assert np.array_equal(words, values.argmax(1))


def test_the_command(tmp_path: Path, pearl: Any) -> None:
    """It evaluates both, writes the file, and names what is wrong in one sentence."""
    policy = TabularPolicy(pearl_marl.get_spec("CliffWalking"))
    policy.values[0, :, 0] = 1.0
    policy.save(tmp_path / "policy.safetensors")
    status, out, _ = pearl("quantize", str(tmp_path), "--n-agents", "4", "--json")
    assert status == 0
    figures = json.loads(out)
    assert figures["change"]["mean"] == 0
    assert figures["return_before"]["mean"] == figures["return_after"]["mean"] == -1000
    pearl_marl.load_policy(tmp_path)
    for arguments, sentence in (
        ((str(tmp_path / "none"),), "there is no such file"),
        ((str(tmp_path), "--out", "x.npy"), "ends in .safetensors"),
        ((str(tmp_path), "--weight-bits", "3"), "--weight-bits"),
    ):
        status, _, err = pearl("quantize", *arguments)
        assert status == 2
        assert sentence in err


def test_training_ends_with_it_on_request(tmp_path: Path, pearl: Any) -> None:
    line = ("train", "CliffWalking", "--algo", "q-learning", "--n-agents", "8", "--iterations", "2")
    status, out, _ = pearl(*line, "--quantize", "--out", str(tmp_path / "run"), "--json")
    assert status == 0
    assert json.loads(out)["quantized"]["file"] == str(tmp_path / "run" / "integers.safetensors")
    assert isinstance(pearl_marl.load_policy(tmp_path / "run"), IntegerNetwork)
