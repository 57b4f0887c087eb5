"""Teams: mixers, targets of the team's reward, what agents that ended add to it, and the two-step game."""

from __future__ import annotations

import copy
import dataclasses
import itertools
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
import torch
from gymnasium.spaces import Discrete

from pearl_marl import EnvSpec, get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Bits
from pearl_marl.spec import Golden
from pearl_marl.training.mixers import MonotonicMixer, SumMixer
from pearl_marl.training.recurrent import chunked
from pearl_marl.training.run import ALGORITHMS, SETTINGS, evaluate, settings_for
from pearl_marl.training.teams import QMIX, VDN, QMIXSettings, VDNSettings

from ..sampling import sampled
from ..toy_world import MEADOW, NIM, crowd

DISCOUNT, LAMBDA = 0.9, 0.6
SMALL: dict[str, Any] = {"n_agents": 48, "rollout_length": 24, "minibatch": 96, "width": 16, "iterations": 5}
TRAINERS: dict[str, tuple[Any, Any]] = {
    "vdn": (VDN, VDNSettings),
    "qmix": (QMIX, partial(QMIXSettings, mixer_width=4)),
}

FORAGING = get_spec("LevelBasedForaging")
PAIRS = crowd(3, masked=False)
"""Three agents that end one by one, without masks."""


def trainer_of(algorithm: str, spec: EnvSpec, **given: Any) -> Any:
    make, settings = TRAINERS[algorithm]
    return make(spec, "native", settings(**{**SMALL, **given}))


def unsettled(mixer: MonotonicMixer) -> MonotonicMixer:
    """Give a mixer weights far from those that it begins with, and statistics of states."""
    with torch.no_grad():
        for parameter in mixer.parameters():
            parameter.copy_(torch.randn(parameter.shape))
    mixer.see(5 + 3 * torch.randn(100, mixer.linear.mean.numel()))
    return mixer


def mixed_by_hand(mixer: Any, values: Any, state: Any) -> float:
    """Return the value of one team by the equations, number by number: QMIX's, or the sum."""
    if isinstance(mixer, SumMixer):
        return float(sum(values))
    mean, variance = mixer.linear.mean.numpy(), mixer.linear.variance.numpy()
    s = np.clip((np.asarray(state) - mean) / np.sqrt(variance + 1e-8), -10, 10)
    weight, offset = (
        p.detach().numpy().astype(float) for p in (mixer.linear.linear.weight, mixer.linear.linear.bias)
    )
    functions = iter([float(np.dot(row, s) + b) for row, b in zip(weight, offset, strict=True)])
    width = mixer.bias.in_features
    w1 = [[abs(next(functions)) for _ in range(width)] for _ in values]
    b1 = [next(functions) for _ in range(width)]
    w2 = [abs(next(functions)) for _ in range(width)]
    v = [max(next(functions), 0.0) for _ in range(width)]
    total = float(np.dot(mixer.bias.weight.detach().numpy()[0], v)) + float(mixer.bias.bias.detach()[0])
    for k in range(width):
        x = sum(value * row[k] for value, row in zip(values, w1, strict=True)) + b1[k]
        total += w2[k] * (x if x > 0 else np.exp(x) - 1)
    return total


# ---- Mixers ----


def test_the_sum_is_a_sum() -> None:
    values = torch.tensor([[1.0, -2.0, 0.5], [0.0, 3.0, 0.0]])
    assert SumMixer()(values).tolist() == [-0.5, 3.0]


def test_the_monotonic_mixer_is_qmix() -> None:
    torch.manual_seed(0)
    mixer = unsettled(MonotonicMixer(PAIRS, 5))
    values, states = torch.randn(20, 3), 5 + 3 * torch.randn(20, len(PAIRS.state))
    due = [mixed_by_hand(mixer, *pair) for pair in zip(values.numpy(), states.numpy(), strict=True)]
    np.testing.assert_allclose(mixer(values, states).detach(), due, rtol=1e-4, atol=1e-4)


def test_the_monotonic_mixer_is_monotonic() -> None:
    """Whatever its weights and the state are; and how much an agent counts depends on the state."""
    torch.manual_seed(0)
    slopes = []
    for _ in range(10):
        mixer = unsettled(MonotonicMixer(PAIRS, 4))
        values = torch.randn(50, 3, requires_grad=True)
        total = mixer(values, 5 + 3 * torch.randn(50, len(PAIRS.state)))
        (slope,) = torch.autograd.grad(total.sum(), values)
        slopes.append(slope)
    assert (torch.stack(slopes) >= 0).all()
    assert (slopes[0].std(0) > 0.1).all()


def test_the_monotonic_mixer_begins_near_the_sum() -> None:
    torch.manual_seed(0)
    mixer = MonotonicMixer(PAIRS, 32)
    values = torch.rand(50, 3)
    torch.testing.assert_close(
        mixer(values, torch.randn(50, len(PAIRS.state))), values.sum(1), rtol=0.2, atol=0.1
    )


# ---- Targets ----

WORLDS = {
    "Meadow": dataclasses.replace(MEADOW, max_cycles=6),  # masks, and agents that end before their world
    "Crowd": dataclasses.replace(
        PAIRS, max_cycles=5
    ),  # the same without masks, and known ends at time limits
}


FEW = "vdn Meadow gru", "vdn Crowd none", "qmix Meadow none", "qmix Crowd gru"
CASES = map(" ".join, itertools.product(TRAINERS, WORLDS, ("none", "gru")))


@pytest.mark.parametrize("case", sampled(CASES, FEW))
def test_targets_are_lambda_returns_of_the_team(case: str) -> None:
    """World by world, from what the device returned: of agents that have ended nothing is counted."""
    algorithm, name, memory = case.split()
    spec = WORLDS[name]
    given = {"epsilon": 0.5, "q_lambda": LAMBDA, "discount": DISCOUNT, "memory": memory, "chunk_length": 1}
    trainer = trainer_of(algorithm, spec, **given)
    trainer.iterate()
    worker, mixer = trainer.worker, trainer.model.mixer
    if algorithm == "qmix":
        unsettled(mixer)
    steps, acting, states = [], [], []
    device_step = worker.agents.step

    def note() -> None:
        acting.append(worker.agents.acting.tolist())
        states.append(np.array(worker.agents.device.state(), float))

    def noted(actions: Any) -> Any:
        note()
        result = device_step(actions)
        steps.append(type(result)(*(tensor.clone() for tensor in result)))
        return result

    worker.agents.step, worker.agents.network_beside = noted, lambda *_: None
    gathered = worker.gather(1)
    note()

    def values_of(obs: Any, masks: Any, remembered: Any) -> tuple[list[float], Any]:
        """Return the value of each agent's best action, and what it remembers afterwards."""
        trainer.policy.memory = remembered
        with torch.no_grad():
            outputs = trainer.policy._outputs(obs, masks)
        return outputs.amax(1).tolist(), trainer.policy.memory

    best, finals = [], []
    for t, step in enumerate(steps):
        now = gathered.inputs.pick(t)
        values, after = values_of(now.obs, now.masks, now.memory)
        best.append(values)
        finals.append(values_of(step.final_obs, None, after)[0])
    now = worker.agents.inputs
    best.append(values_of(now.obs, now.masks, worker.memory if memory == "gru" else None)[0])
    learned = cut_off = alone = 0
    for world in range(SMALL["n_agents"] // spec.agents):
        team = range(world * spec.agents, (world + 1) * spec.agents)

        def value(t: int, team: range = team, world: int = world) -> float:
            return mixed_by_hand(mixer, [best[t][i] * acting[t][i] for i in team], states[t][world])

        target: float | None = value(len(steps))
        for t in reversed(range(len(steps))):
            step, acts = steps[t], acting[t]
            ended = (step.terminations | step.truncations).tolist()
            cut = (step.truncations & ~step.terminations).tolist()
            alone += any(acts[i] for i in team) and not all(acts[i] for i in team)
            over = all(ended[i] or not acts[i] for i in team)
            reward = sum(step.rewards[i].item() for i in team)
            if any(cut[i] for i in team):
                cut_off += 1
                known = algorithm == "vdn" and name == "Crowd"
                after = sum(finals[t][i] for i in team if cut[i])
                target = reward + DISCOUNT * after if known else None
            elif over:
                target = reward
            else:
                following = value(t + 1)
                last = following if target is None else target
                target = reward + DISCOUNT * ((1 - LAMBDA) * following + LAMBDA * last)
            for i in team:
                assert gathered.loss_mask[t, i] == (acts[i] and target is not None)
                if gathered.loss_mask[t, i]:
                    assert float(gathered.returns[t, i]) == pytest.approx(target, abs=1e-3, rel=1e-4)
                    learned += 1
    assert min(learned, cut_off, alone) > 20


@pytest.mark.parametrize("memory", ["none", "gru"])
@pytest.mark.parametrize("algorithm", TRAINERS)
def test_the_loss_is_of_teams(algorithm: str, memory: str) -> None:
    """What agents that have ended observe does not matter, nor does how worlds are in minibatches."""
    trainer = trainer_of(
        algorithm, WORLDS["Meadow"], memory=memory, chunk_length=4, epochs=1, minibatch=10**6
    )
    trainer.iterate()
    gathered = trainer.worker.gather(1)
    worlds = SMALL["n_agents"] // MEADOW.agents
    mask = gathered.loss_mask
    with torch.no_grad():
        if memory == "none":
            outputs = trainer.model.outputs(gathered.inputs.flat()).view(*mask.shape, -1)
        else:
            remembered, rows = gathered.inputs.memory[0], []
            for t in range(len(mask)):
                remembered = remembered.masked_fill(gathered.inputs.begins[t, :, None], 0)
                trainer.policy.memory = remembered
                rows.append(trainer.policy._outputs(gathered.inputs.obs[t], gathered.inputs.masks[t]))
                remembered = trainer.policy.memory
            outputs = torch.stack(rows)
    chosen = outputs.gather(2, gathered.actions[..., None])[..., 0]
    states = gathered.inputs.state
    errors = []
    for t in range(len(mask)):
        for world in range(worlds):
            team = slice(world * MEADOW.agents, (world + 1) * MEADOW.agents)
            if mask[t, team].any():
                values = torch.where(mask[t, team], chosen[t, team], 0).tolist()
                state = None if states is None else states[t, team][0].numpy()
                total = mixed_by_hand(trainer.model.mixer, values, state)
                errors.append(total - float(gathered.returns[t, team][mask[t, team]][0]))
    due = 0.5 * np.square(errors).mean()
    assert len(errors) < int(mask.sum()) < mask.numel()

    samples = chunked(gathered, 4) if memory == "gru" else gathered.flat()
    groups = torch.arange(samples.loss_mask.shape[-1] // MEADOW.agents)
    if memory == "none":  # learn() leaves out the others
        groups = groups[samples.loss_mask.view(-1, MEADOW.agents).any(1)]
    blind = samples._replace(inputs=samples.inputs._replace(obs=samples.inputs.obs.clone()))
    blind.inputs.obs[~samples.loss_mask] = 9
    found = []
    assert (trainer.loops(samples) is not None) is (algorithm == "vdn" and memory == "none")
    for rollout, compiled in ((samples, True), (blind, True), (samples, False)):
        loops = trainer.loops(rollout) if compiled else None
        gradients = loops or partial(trainer.autograd, rollout)
        loss = float(gradients(groups))
        found.append((loss, [parameter.grad.clone() for parameter in trainer.model.parameters()]))
    assert found[0][0] == pytest.approx(due, rel=1e-3)
    torch.testing.assert_close(found[0], found[1])
    torch.testing.assert_close(found[0], found[2], rtol=1e-4, atol=2e-5)


def test_minibatches_are_of_whole_worlds() -> None:
    """As many as make so many agent-steps; each once in an epoch, if there is anything to learn."""
    for memory, size in (("none", 24), ("gru", 6)):
        trainer = trainer_of("vdn", WORLDS["Meadow"], memory=memory, chunk_length=4, epochs=2)
        gathered, taken = trainer.worker.gather(0), []

        def noted(minibatch: Any, taken: list[Any] = taken) -> Any:
            taken.append(minibatch)
            return torch.zeros(1)

        trainer.loops = lambda _, noted=noted: noted
        trainer.worker.gather = lambda _, gathered=gathered: gathered
        trainer.iterate()
        assert {len(minibatch) for minibatch in taken[:-1]} >= {size}
        assert max(map(len, taken)) == size
        mask = gathered.loss_mask.view(24 // (4 if memory == "gru" else 1), -1, 12, 4).any(3).any(1)
        assert torch.cat(taken).bincount(minlength=mask.numel()).tolist() == [
            2 * learned for learned in mask.flatten()
        ]


# ---- Runs ----


@pytest.mark.parametrize(
    ("algorithm", "memory", "sharing"),
    [("vdn", "none", "none"), ("vdn", "gru", "indicator"), ("qmix", "none", "all"), ("qmix", "gru", "all")],
)
def test_a_run_goes_on_to_equal_weights(algorithm: str, memory: str, sharing: str) -> None:
    given = {"memory": memory, "chunk_length": 4, "sharing": sharing, "rollout_length": 8}
    whole, resumed = trainer_of(algorithm, FORAGING, **given), trainer_of(algorithm, FORAGING, **given)
    for _ in range(2):
        whole.iterate()
    kept = copy.deepcopy(whole.state())
    for _ in range(2):
        whole.iterate()
    resumed.load(kept)
    for _ in range(2):
        resumed.iterate()
    ours, theirs = resumed.state(), whole.state()
    for name, tensor in theirs["model"].items():
        assert torch.equal(ours["model"][name], tensor), name
        assert tensor.isfinite().all()
    moved = [name for name, tensor in theirs["model"].items() if not torch.equal(kept["model"][name], tensor)]
    mixer = [name for name in theirs["model"] if name.startswith("mixer.")]
    assert set(mixer) <= set(moved), "it learns, and standardises states"
    assert bool(mixer) == (algorithm == "qmix")
    assert any(name.startswith("policy.") for name in moved)
    assert torch.equal(ours["agents"], theirs["agents"])
    assert whole.figures() == resumed.figures()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("CartPole", "CartPole has one agent in a world, and a team has several: use pqn"),
        ("Nim", "a team acts at once, and in Nim agents take turns: use self-play"),
    ],
)
@pytest.mark.parametrize("algorithm", TRAINERS)
def test_what_has_no_team_is_refused(algorithm: str, name: str, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        trainer_of(algorithm, NIM if name == "Nim" else get_spec(name))


@pytest.mark.parametrize(
    ("given", "shards", "words"),
    [
        ({"rewards": "own"}, None, "--set rewards is 'own'; it must be one of sum, mean"),
        ({"mixer_width": 0}, None, "--set mixer_width is 0; it must be an integer from 1 to"),
        ({}, 2, "qmix does not learn with --shards: leave it out, or use ppo or pqn"),
    ],
)
def test_wrong_settings_are_refused(given: dict[str, Any], shards: int | None, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        settings_for("qmix", "LevelBasedForaging", given, shards, 2)


# ---- The two-step game ----


class Rooms(NamedTuple):
    """The room that both agents are in: the first one, or one of two that the first agent leads to."""

    room: Bits[2]


class RoomsView(NamedTuple):
    """What both see."""

    room: Bits[2]


SEVEN, NOTHING, ONE, EIGHT = range(4)


def rooms_initial(draws: Draws) -> Rooms:
    return Rooms(0)


def rooms_step(state: Rooms, actions: list[Word], draws: Draws) -> tuple[Rooms, list[Word], list[Word]]:
    room, (first, second) = state.room, actions
    over = room > 0
    paid = SEVEN if room == 1 else NOTHING
    if room == 2 and first + second > 0:
        paid = EIGHT if first + second == 2 else ONE
    if not over:
        paid = NOTHING
    return Rooms(1 + first), [paid, NOTHING], [over, over]


def rooms_observe(state: Rooms, agent: int) -> RoomsView:
    return RoomsView(state.room)


TWO_STEPS = EnvSpec(
    name="TwoSteps",
    version=0,
    summary="A safe 7, or 8 if both agents dare",
    rewards=(7.0, 0.0, 1.0, 8.0),
    observation_space=Discrete(4),
    action_space=Discrete(2),
    golden=Golden(Rooms, rooms_initial, rooms_step, rooms_observe, view=RoomsView),
    agents=2,
)
"""The two-step game of QMIX's paper (section 5 of arXiv:1803.11485)."""


def learned_return(algorithm: str, seed: int) -> float:
    """Return what a world's best actions earn after a training that explores at random all along."""
    given = {"n_agents": 128, "rollout_length": 4, "iterations": 30, "minibatch": 128, "learning_rate": 0.01}
    given |= {"q_lambda": 0.0, "epsilon": 1.0, "final_epsilon": 1.0, "width": 16, "sharing": "indicator"}
    settings = SETTINGS[algorithm](**given, rewards="sum", seed=seed)
    trainer = ALGORITHMS[algorithm](TWO_STEPS, "native", settings)
    for _ in range(30):
        trainer.iterate()
    return 2 * evaluate(trainer.policy, TWO_STEPS, 2)["eval_return"]


@pytest.mark.parametrize("seed", sampled(range(3), (0,)))
@pytest.mark.parametrize(("algorithm", "due"), [("pqn", 7), ("vdn", 7), ("qmix", 8)])
def test_the_two_step_game(algorithm: str, due: float, seed: int) -> None:
    """Only QMIX can represent that both have to dare: alone, or by a sum, the safe 7 looks better."""
    assert learned_return(algorithm, seed) == due
