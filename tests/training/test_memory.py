"""Policies with memory: what they remember, where they forget it, and that learning sees the same."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
import torch

from pearl_marl import EnvSpec, get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.evaluation.matches import Match, cross_table
from pearl_marl.evaluation.run import Evaluation
from pearl_marl.policies import trained
from pearl_marl.policies.loading import load_policy, random_policy
from pearl_marl.policies.memory import Memory, Recall, acting
from pearl_marl.policies.quantizing import quantized
from pearl_marl.training.recurrent import chunked
from pearl_marl.training.run import ALGORITHMS, SETTINGS, evaluate, settings_for

from ..toy_memory import POSITIONS
from ..toy_world import MEADOW, NIM

pytestmark = pytest.mark.usefixtures("toys")

Pearl = Callable[..., tuple[int, str, str]]

LEA = dataclasses.replace(MEADOW, name="Lea", roles=(), golden=MEADOW.golden._replace(masks=None))
"""Where agents that have ended before their world are stepped, and no masks tell."""

STEPS = 12


@pytest.mark.parametrize(("agents", "size"), [(5, 8), (70, 20), (128, 64)])
@pytest.mark.parametrize(("begins", "acts"), [(0.0, 1.0), (0.3, 1.0), (0.0, 0.7), (0.3, 0.7)])
def test_a_memory_is_pytorchs_gru(agents: int, size: int, begins: float, acts: float) -> None:
    """With all its gradients; it is empty where episodes begin, and stays where its agent does not act."""
    random = torch.Generator().manual_seed(1)
    torch.manual_seed(0)
    memory, by_memories = Memory(size), torch.randn(STEPS, agents, size, generator=random)
    start, given = torch.randn(agents, size), torch.randn(STEPS, agents, size)
    at_begins, at_acts = (torch.rand(STEPS, agents, generator=random) < share for share in (begins, acts))

    def step_by_step(given: Any, start: Any) -> Any:
        memories = [start]
        for t in range(STEPS):
            before = memories[t].masked_fill(at_begins[t, :, None], 0)
            memories.append(torch.where(at_acts[t, :, None], memory.cell(given[t], before), before))
        return torch.stack(memories[1:])

    def at_once(given: Any, start: Any) -> Any:
        recall = Recall(start, at_begins if begins else None, at_acts if acts < 1 else None)
        return memory(given.flatten(0, 1), recall)

    made = []
    for function in (at_once, step_by_step):
        inputs = [tensor.clone().requires_grad_() for tensor in (given, start)]
        memories = function(*inputs)
        parameters: list[Any] = [*inputs, *memory.parameters()]
        made.append([memories.detach(), *torch.autograd.grad(memories, parameters, by_memories)])
    for ours, theirs in zip(*made, strict=True):
        assert theirs.abs().max() > 0.1
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5 * float(theirs.abs().max()))


CASES = [
    (algorithm, spec)
    for algorithm in ("ppo", "pqn")
    for spec in (POSITIONS, MEADOW, NIM, get_spec("Seaquest"))
]

SMALL: dict[str, Any] = {
    "n_agents": 24,
    "rollout_length": 24,
    "chunk_length": 6,
    "memory": "gru",
    "width": 16,
}


def small(algorithm: str, spec: EnvSpec, **given: Any) -> Any:
    return ALGORITHMS[algorithm](spec, "native", SETTINGS[algorithm](**{**SMALL, **given}))


@pytest.mark.parametrize(("algorithm", "spec"), CASES, ids=lambda case: getattr(case, "name", case))
def test_chunks_remember_what_the_rollout_did(algorithm: str, spec: EnvSpec) -> None:
    """Episodes end within them, agents end before their world, and they take turns."""
    trainer = small(algorithm, spec)
    trainer.worker.gather(0)
    step, due = trainer.worker.stepped, []

    def noted(*given: Any) -> Any:
        due.append(step(*given))
        return due[-1]

    trainer.worker.stepped = noted
    rollout = trainer.worker.gather(1)
    assert rollout.ended.any() or spec.name == "Seaquest"
    chunks = chunked(rollout, 6)
    with torch.no_grad():
        outputs, values, _ = trainer.model.unrolled(chunks.inputs)
    outputs, values = outputs.reshape(6, 4 * 24, -1), values.reshape(6, 4 * 24)
    for t in range(24):
        columns = slice(t // 6 * 24, (t // 6 + 1) * 24)
        torch.testing.assert_close(outputs[t % 6, columns], due[t][0])
        torch.testing.assert_close(values[t % 6, columns], due[t][1])


@pytest.mark.parametrize("spec", [POSITIONS, MEADOW, LEA, NIM], ids=lambda spec: spec.name)
def test_an_evaluation_remembers_what_a_rollout_does(spec: EnvSpec) -> None:
    """With equal actions, from the same reset."""
    trainer = small("pqn", spec, epsilon=0.0, final_epsilon=0.0, seed=5, chunk_length=1)
    rollout = trainer.worker.gather(0)
    remembered = []

    class Noted:
        def __init__(self) -> None:
            self.function = trainer.policy.function
            self.forget = self.function.forget

        def __call__(self, *observed: Any) -> Any:
            memory = trainer.policy.memory
            remembered.append(torch.zeros(24, 16) if memory is None else memory.clone())
            return self.function(*observed)

    evaluation = Evaluation(spec, Noted(), 24, episodes=24 * 40, seed=5)
    for _ in evaluation.run():
        if len(remembered) > 24:
            break
    torch.testing.assert_close(torch.stack(remembered[:24]), rollout.inputs.memory)


def test_gradients_go_back_through_a_chunk_and_no_further() -> None:
    trainer = small("ppo", POSITIONS, rollout_length=12)
    chunks = chunked(trainer.worker.gather(0), 6)
    obs = chunks.inputs.obs.clone().requires_grad_()
    inputs = chunks.inputs._replace(obs=obs, begins=torch.zeros_like(chunks.inputs.begins))
    outputs, _, _ = trainer.model.unrolled(inputs)
    second = range(24, 48)  # columns of each agent's second chunk
    outputs.reshape(6, 48, -1)[-1, second].sum().backward()
    assert (obs.grad[:, second] != 0).any(2).all()
    assert not obs.grad[:, :24].any()
    # What the second chunk begins with came of the first chunk's steps, and is a constant here.
    assert inputs.memory[0, second].any()
    assert not inputs.memory.requires_grad


@pytest.mark.parametrize(
    ("algorithm", "spec", "given"),
    [("ppo", POSITIONS, {}), ("pqn", POSITIONS, {}), ("self-play", NIM, {"join_every": 1, "opponents": 2})],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_run_goes_on_to_equal_weights(algorithm: str, spec: EnvSpec, given: dict[str, Any]) -> None:
    whole, stopped, again = (small(algorithm, spec, **given) for _ in range(3))
    for _ in range(5):
        whole.iterate()
    for _ in range(2):
        stopped.iterate()
    again.load(stopped.state())
    for _ in range(3):
        again.iterate()
    for name, tensor in whole.policy.state_dict().items():
        assert torch.equal(again.policy.state_dict()[name], tensor), name
    assert again.worker.memory.any()
    state = stopped.state()
    state["memory"] = state["memory"] + 2
    with pytest.raises(ArgumentError, match="memory of agents has numbers that no training leaves"):
        again.load(state)


def among_members(spec: EnvSpec) -> Any:
    """Return a run of self-play against members that have nothing to do with each other."""
    trainer = small("self-play", spec, n_agents=64, mirrored=0.25, opponents=3, random_moves=0.3)
    for done in range(3):
        let_join(trainer.league, done)
    return trainer


def let_join(league: Any, done: int) -> None:
    torch.manual_seed(done)
    league.members[done] = trained.NetworkPolicy(league.policy.spec, "logits", 16, memory="gru").state_dict()
    league.members[done]["network.output.weight"] *= 100


@pytest.mark.parametrize("spec", [MEADOW, LEA, NIM], ids=lambda spec: spec.name)
def test_players_of_a_league_remember_what_they_have_seen_themselves(spec: EnvSpec) -> None:
    """Until another one takes their agents over. The learner goes on, and chunks begin with what it knew."""
    trainer = among_members(spec)
    worker, league = trainer.worker, trainer.league
    stepped, taken_over = worker.stepped, {False: 0, True: 0}
    met = [-1, *league.met(2)]
    worker.gather(2)
    for rollout in range(3, 8):
        let_join(league, rollout)
        before, noted = worker.memory.clone(), []

        def watched(*given: Any, noted: list[Any] = noted) -> Any:
            noted.append(stepped(*given))
            return noted[-1]

        worker.stepped = watched
        e = worker.gather(rollout)
        outputs, values = (torch.stack([made[k] for made in noted[:24]]) for k in range(2))
        met, last = [-1, *league.met(rollout)], met
        for player, (done, previous) in enumerate(zip(met, last, strict=True)):
            theirs = league.players == player
            start = before[theirs] * (done == previous)
            inputs = e.inputs._replace(memory=None).pick((slice(None), theirs))
            if player:
                taken_over[done != previous] += 1
                recall = Recall(start[:, :16], inputs.begins, acting(inputs.masks))
                flat = inputs.flat()
                due, _ = league.member(done).unrolled(flat.obs, flat.masks, flat.position, recall)
            else:
                assert start.any()
                begun = start.masked_fill(inputs.begins[0][:, None], 0)
                assert torch.equal(e.inputs.memory[0][theirs], begun)
                with torch.no_grad():
                    due, expected, _ = trainer.model.unrolled(inputs._replace(memory=start[None]))
                torch.testing.assert_close(values[:, theirs].flatten(), expected)
            torch.testing.assert_close(outputs[:, theirs].flatten(0, 1), due)
    assert all(taken_over.values())


def test_chunks_of_self_play_remember_what_the_learner_did() -> None:
    """Also in steps whose move was random."""
    trainer = among_members(NIM)
    for rollout in range(2):
        e = trainer.worker.gather(rollout)
    mine = (trainer.league.players == 0).repeat(4)
    chunks = chunked(e, 6)
    with torch.no_grad():
        outputs, _, _ = trainer.model.unrolled(chunks.inputs)
    found = trainer.model.log_probs(outputs.reshape(6, 4 * 64, -1), chunks.actions)
    assert chunks.loss_mask[:, mine].any()
    assert not chunks.loss_mask[:, ~mine].any()
    torch.testing.assert_close(found[chunks.loss_mask], chunks.log_probs[chunks.loss_mask])


def test_self_play_with_memory_by_the_command_line(pearl: Pearl, tmp_path: Path) -> None:
    out = str(tmp_path / "kuhn")
    small = ["--n-agents", "16", "--iterations", "4", "--set", "join_every=2", "--set", "width=8"]
    code, _, err = pearl("train", "KuhnPoker", "--algo", "self-play", "--memory", "gru", *small, "--out", out)
    assert code == 0, err
    first = f"{out}/past/000000.safetensors"
    assert trained.load(Path(first)).remembers
    for command in (
        ("eval", "KuhnPoker", "--policy", out, "--n-agents", "20"),
        ("match", "KuhnPoker", out, first, "random", "--openings", "0", "--n-agents", "20"),
    ):
        code, _, err = pearl(*command)
        assert code == 0, err


def test_a_policys_file_remembers(tmp_path: Path) -> None:
    trainer = small("pqn", MEADOW)
    trainer.iterate()
    trainer.policy.save(tmp_path / "policy.safetensors")
    again = trained.load(tmp_path)
    assert again.remembers
    loaded: Any = load_policy(str(tmp_path), MEADOW)
    results = [
        Match(MEADOW, policy, random_policy(MEADOW), 40, seed=3)
        for policy in (loaded, trainer.policy.function)
    ]
    for match in results:
        for _ in match.run():
            pass
    assert results[0].digest == results[1].digest
    assert evaluate(again, MEADOW, 40) == evaluate(trainer.policy, MEADOW, 40)


@pytest.fixture
def players(tmp_path: Path) -> list[Any]:
    """One policy with memory, loaded twice."""
    trainer = small("pqn", MEADOW)
    trainer.iterate()
    trainer.policy.save(tmp_path / "policy.safetensors")
    return [load_policy(str(tmp_path), MEADOW) for _ in range(2)]


def test_a_policy_against_itself_remembers_each_step_once(players: list[Any]) -> None:
    one, other = players
    again = trained.Remembering(one._policy)
    digests = []
    for against in (other, one, again):
        match = Match(MEADOW, one, against, 40, seed=3)
        for _ in match.run():
            pass
        digests.append(match.digest)
    assert len(set(digests)) == 1


def test_a_match_forgets_what_the_last_one_left(players: list[Any]) -> None:
    """A policy has one result against equal opponents."""
    policies = {"one": players[0], "second": random_policy(MEADOW, 1), "third": random_policy(MEADOW, 1)}
    first, second, _ = cross_table(MEADOW, policies, 40, seed=3)
    assert first["digest"] == second["digest"]


def test_what_cannot_remember_is_refused(tmp_path: Path) -> None:
    trainer = small("ppo", POSITIONS)
    with pytest.raises(ArgumentError, match="the policy has a memory, for which integers have no layer"):
        quantized(trainer.policy, np.zeros((1, 2), np.float32))
    with pytest.raises(ArgumentError, match="the network has a memory, and one call does not say"):
        trainer.policy(torch.zeros(1, 2))
    with pytest.raises(
        ArgumentError, match="'chunk_length' is 7; with a memory it must divide rollout_length, 24"
    ):
        small("ppo", POSITIONS, chunk_length=7)
    with pytest.raises(ArgumentError, match="agents with memory share a network"):
        small("ppo", MEADOW, sharing="none")
    about = trainer.policy.about
    about["memory"] = "lstm"
    trainer.policy.save(tmp_path / "policy.safetensors")
    with pytest.raises(ArgumentError, match="has the memory 'lstm'; possible are none, gru"):
        trained.load(tmp_path)


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("algorithm", ["ppo", "pqn"])
@pytest.mark.parametrize("memory", ["none", "gru"])
def test_a_pole_whose_velocities_nobody_sees(memory: str, algorithm: str, seed: int) -> None:
    given = {"n_agents": 512, "iterations": 40, "memory": memory, "minibatch": 512, "seed": seed}
    settings = settings_for(algorithm, POSITIONS.name, given)
    if algorithm == "pqn":
        settings = dataclasses.replace(settings, q_lambda=0.9)
    trainer = ALGORITHMS[algorithm](POSITIONS, "native", settings)
    best = 0.0
    while best < 475 and trainer.done < settings.iterations:
        trainer.iterate()
        best = max(best, evaluate(trainer.policy, POSITIONS, 100)["eval_return"])
    assert best >= 475 if memory == "gru" else best < 100
