"""Advantages of agents that do not act in every step, against their definition, decision by decision."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pearl_marl import get_spec
from pearl_marl.devices import BatchConfig, Native, Reference
from pearl_marl.devices.rollouts import Record
from pearl_marl.errors import ArgumentError

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
rollout = importlib.import_module("pearl_marl.training.rollout")
agents = importlib.import_module("pearl_marl.training.agents")
run = importlib.import_module("pearl_marl.training.run")
trained = importlib.import_module("pearl_marl.policies.trained")

NEXT = AutoresetMode.NEXT_STEP
STEPS, N = 60, 40
DISCOUNT, GAE_LAMBDA = 0.9, 0.7


def trajectories(acting: Any, unknown: Any = None, seed: int = 0) -> Any:
    random = np.random.default_rng(seed)
    rewards, values = random.normal(size=(STEPS, N)), random.normal(size=(STEPS + 1, N))
    ended = random.random((STEPS, N)) < 0.1
    if unknown is None:
        unknown = np.zeros((STEPS, N), np.bool_)
    parts = rewards, values, ended, acting, unknown & ended
    return rollout.Trajectories(*(torch.from_numpy(part) for part in parts))


def of_one(rewards: Any, values: Any, ended: Any, acting: Any, unknown: Any) -> tuple[Any, Any]:
    """What the module computes, of one agent, forward and in so many words."""
    times = np.flatnonzero(acting[:-1])
    errors, traces = {}, {}
    for k, t in enumerate(times):
        later = next((s for s in range(t, STEPS) if ended[s]), None)
        following = times[k + 1] if k + 1 < len(times) else (STEPS if acting[-1] else None)
        if later is not None and (following is None or later < following):
            known, until, value = not unknown[later], later + 1, 0.0
        else:
            known = following is not None
            until, value = (following, values[following]) if known else (STEPS, 0.0)
        if known:
            errors[t] = rewards[t:until].sum() + DISCOUNT * value - values[t]
        traces[t] = following if known and value != 0.0 else None
    result, learned = np.zeros(STEPS), np.zeros(STEPS, np.bool_)
    for t in times[::-1]:
        if t in errors:
            result[t], learned[t] = errors[t], True
            if traces[t] is not None and traces[t] < STEPS:
                result[t] += DISCOUNT * GAE_LAMBDA * result[traces[t]]
    return result, learned


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("cut", [0.0, 0.5])
def test_advantages_of_decisions(share: float, cut: float) -> None:
    random = np.random.default_rng(3)
    acting = random.random((STEPS + 1, N)) < share
    given = trajectories(acting, random.random((STEPS, N)) < cut)
    gains, learned = rollout.estimated_advantages(given, DISCOUNT, GAE_LAMBDA)
    for k in range(N):
        expected, which = of_one(*(part[:, k].numpy() for part in given))
        np.testing.assert_array_equal(learned[:, k], which)
        np.testing.assert_allclose(gains[:, k][which], expected[which], rtol=1e-4, atol=1e-6)
        assert not gains[:, k][~which].any()


def test_who_acts_in_every_step_is_computed_faster_to_the_same() -> None:
    given = trajectories(np.ones((STEPS + 1, N), np.bool_))
    fast, everything = rollout.estimated_advantages(given, DISCOUNT, GAE_LAMBDA)
    one_waits = given.acting.clone()
    one_waits[:, 0] = False
    slow, _ = rollout.estimated_advantages(given._replace(acting=one_waits), DISCOUNT, GAE_LAMBDA)
    assert everything.all()
    torch.testing.assert_close(slow[:, 1:], fast[:, 1:])


@pytest.mark.parametrize(
    ("algorithm", "name", "changes"),
    [
        ("ppo", "CartPole", {"blocks": 3}),
        ("ppo", "CartPole", {"n_agents": 2100, "rollout_length": 20}),  # more blocks of the loop, two threads
        ("pqn", "MountainCar", {"epsilon": 0.3}),
        ("ppo", "Taxi", {}),
        ("ppo", "Blackjack", {}),
        ("pqn", "SimpleTag", {"sharing": "indicator"}),
        ("ppo", "LevelBasedForaging", {"sharing": "indicator", "rewards": "sum"}),
        ("pqn", "Meadow", {}),  # whose agents end before their world
        ("vdn", "Meadow", {}),
        ("ppo", "Inventory", {}),
        ("ppo", "Elevators", {}),
    ],
)
@pytest.mark.usefixtures("toys")
def test_steps_beside_the_environments_are_those_one_by_one(
    algorithm: str, name: str, changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With vectors and numbers, masks, agents that end before their world, fields, and time limits."""
    settings = run.settings_for(algorithm, name, {"n_agents": 60, "rollout_length": 210, **changes})
    calls: list[object] = []
    experience = Native.experience
    monkeypatch.setattr(Native, "experience", lambda *given: calls.append(given) or experience(*given))
    gathered, states = [], []
    for possible in (True, False):
        if not possible:
            monkeypatch.setattr(agents.Agents, "network_beside", lambda *_: None)
        worker = run.ALGORITHMS[algorithm](get_spec(name), Native(threads=2), settings).worker
        gathered.append([worker.gather(k) for k in range(2)])
        states.append(worker.agents)
    assert len(calls) == 2, "one call a rollout, and none where it is not possible"
    for beside, alone in zip(*gathered, strict=True):
        assert beside.ended.any()
        assert beside.loss_mask.all() == (name != "Meadow")
        pairs = zip((*alone.inputs, *alone[1:]), (*beside.inputs, *beside[1:]), strict=True)
        for expected, found in pairs:
            assert (expected is None) == (found is None)
            if expected is not None:
                assert expected.dtype == found.dtype
                torch.testing.assert_close(found, expected, rtol=0, atol=0)
    beside, alone = states
    assert (beside.inputs.masks is None) == (name not in ("LevelBasedForaging", "Meadow"))
    assert beside.obs.untyped_storage().nbytes() == beside.obs.nbytes, "not all rows of the rollout are kept"
    assert beside.state().to_bytes() == alone.state().to_bytes()
    for attribute in ("obs", "alive", "acting", "begins"):
        assert torch.equal(getattr(beside, attribute), getattr(alone, attribute))


@pytest.mark.parametrize("name", ["CartPole", "Pendulum"])
def test_noise_that_was_begun_is_that_of_its_rollout(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is made anew where another rollout follows."""
    settings = run.settings_for("ppo", name, {"n_agents": 8, "rollout_length": 4, "iterations": 9})
    made: list[int] = []
    noise = rollout.RolloutWorker._made_noise

    def noted(worker: Any, number: int) -> Any:
        made.append(number)
        return noise(worker, number)

    monkeypatch.setattr(rollout.RolloutWorker, "_made_noise", noted)
    actions = []
    for begins in (True, False):
        worker, found = run.ALGORITHMS["ppo"](get_spec(name), "native", settings).worker, []
        for number in (0, 1, 5, 8):
            found.append(worker.gather(number).actions)
            if begins:
                worker.begin_noise(number + 1)
        actions.append(found)
        assert [made.count(number) for number in (0, 1, 5, 8)] == [1, 1, 1, 1]
        made.clear()
    for one, other in zip(*actions, strict=True):
        assert torch.equal(one, other)


def test_a_failed_rollout_leaves_the_agents_where_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = run.settings_for("ppo", "CartPole", {"n_agents": 8, "rollout_length": 50})
    worker = run.Training("CartPole", "ppo", settings).trainer(None).worker
    before = worker.agents.state().to_bytes()

    def failing(*_: Any) -> Any:
        raise MemoryError

    monkeypatch.setattr(Record, "experience", failing)  # which is called when the steps are done
    with pytest.raises(MemoryError):
        worker.gather(0)
    assert worker.agents.state().to_bytes() == before


class Failing(Native):
    """A class that does more in a step: rollouts of its trainings have to go through it."""

    def _step(self, actions: Any) -> Any:
        return super()._step(actions)


CARTS = get_spec("CartPole")


@pytest.mark.parametrize(
    ("device", "settings", "network", "noise", "says"),
    [
        (Native, {}, "CartPole", np.zeros((3, 8, 2)), "noise is float64 of shape"),
        (Native, {}, "CartPole", np.zeros((3, 7, 2), np.float32), r"of shape \(steps, 8, 2\)"),
        (Native, {}, "CartPole", np.zeros((0, 8, 2), np.float32), "of at least a step"),
        (Native, {}, "CartPole", np.zeros((2, 8, 3), np.float32).T, "in C order"),
        (Native, {}, "MountainCar", np.zeros((3, 8, 2), np.float32), "the policy is for MountainCar"),
        (Native, {"autoreset_mode": NEXT}, "CartPole", np.zeros((3, 8, 2), np.float32), "takes SAME_STEP"),
        (Reference, {}, "CartPole", np.zeros((3, 8, 2), np.float32), "the reference device runs no networks"),
        (Failing, {}, "CartPole", np.zeros((3, 8, 2), np.float32), "runs no networks"),
    ],
)
def test_refused_experience(device: Any, settings: Any, network: str, noise: Any, says: str) -> None:
    """Before the device has moved: compiled loops would read what lies beside an array."""
    opened = device().open(BatchConfig(spec=CARTS, n_envs=8, **settings))
    opened.reset(seed=0)
    before = opened.snapshot().to_bytes()
    chosen_by = trained.NetworkPolicy(get_spec(network), "logits", 16).dense
    with pytest.raises(ArgumentError, match=says):
        opened.experience(chosen_by, noise)
    assert opened.snapshot().to_bytes() == before


@pytest.mark.parametrize("sharing", ["all", "none"])
def test_the_critic_standardises_as_the_actor_does(sharing: str) -> None:
    given = {"n_agents": 8, "rollout_length": 4, "sharing": sharing}
    trainer = run.ALGORITHMS["ppo"](
        get_spec("LevelBasedForaging"), "native", run.settings_for("ppo", "LevelBasedForaging", given)
    )
    before = [buffer.clone() for buffer in trainer.model.critic.buffers()]
    trainer.iterate()
    own, actors = list(trainer.model.critic.buffers()), list(trainer.model.actor.buffers())
    assert len(own) == len(actors) >= 3
    assert all(torch.equal(one, other) for one, other in zip(own, actors, strict=True))
    assert not any(torch.equal(one, other) for one, other in zip(own, before, strict=True))
