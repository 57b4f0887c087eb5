"""PQN: targets are lambda-returns of the values of best actions, and a share of actions is random."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
import torch

from pearl_marl import get_spec
from pearl_marl.training.pqn import PQN, PQNSettings

from ..toy_memory import POSITIONS
from ..toy_world import MEADOW

DISCOUNT, LAMBDA, STEPS, AGENTS = 0.9, 0.6, 32, 64


@pytest.mark.parametrize("memory", ["none", "gru"])
def test_targets_are_lambda_returns(memory: str) -> None:
    """``r + g ((1 - l) max Q' + l R')`` of each step of the device, and ``r + g max Q'`` at time limits.

    Both falls and time limits end episodes.
    """
    spec = dataclasses.replace(get_spec("CartPole") if memory == "none" else POSITIONS, max_cycles=20)
    settings = PQNSettings(
        n_agents=AGENTS, rollout_length=STEPS, chunk_length=1, memory=memory, width=16, epsilon=0.3
    )
    trainer = PQN(spec, "native", dataclasses.replace(settings, q_lambda=LAMBDA, discount=DISCOUNT))
    trainer.iterate()
    trainer.iterate()
    agents, steps = trainer.worker.agents, []
    step = agents.step

    def noted(actions: Any) -> Any:
        result = step(actions)
        steps.append([tensor.clone() for tensor in result])
        return result

    agents.step, agents.network_beside = noted, lambda *_: None
    gathered = trainer.worker.gather(2)
    policy = trainer.policy

    def values(obs: Any, before: Any) -> Any:
        policy.memory = before
        with torch.no_grad():
            return policy._outputs(obs, None).amax(1), policy.memory

    memories = [None] * STEPS if memory == "none" else gathered.inputs.memory
    expected = [values(*pair) for pair in zip(gathered.inputs.obs, memories, strict=True)]
    obs, _, terminations, truncations, _ = steps[-1]
    after = expected[-1][1]
    if after is not None:
        after = after.masked_fill((terminations | truncations)[:, None], 0)
    value = target = values(obs, after)[0]
    cuts = 0
    for t in reversed(range(STEPS)):
        _, rewards, terminations, truncations, final_obs = steps[t]
        cut = truncations & ~terminations
        cuts += int(cut.sum())
        own, after = expected[t]
        following = torch.where(cut, values(final_obs, after)[0], (1 - LAMBDA) * value + LAMBDA * target)
        target = rewards + DISCOUNT * following * ~terminations
        torch.testing.assert_close(gathered.returns[t], target)
        value = own
    assert 0 < cuts < gathered.ended.sum()


@pytest.mark.parametrize("memory", ["none", "gru"])
def test_steps_to_a_time_limit_are_left_out_where_there_are_masks(memory: str) -> None:
    """As nobody knows what would have been allowed there; the step before goes by its value."""
    spec = dataclasses.replace(MEADOW, max_cycles=3)
    settings = PQNSettings(
        n_agents=64, rollout_length=16, width=16, memory=memory, q_lambda=LAMBDA, discount=DISCOUNT
    )
    trainer = PQN(spec, "native", settings)
    step, cuts = trainer.worker.agents.step, []

    def noted(actions: Any) -> Any:
        result = step(actions)
        cuts.append(result.truncations & ~result.terminations)
        return result

    agents = trainer.worker.agents
    agents.step, agents.network_beside = noted, lambda *_: None
    gathered = trainer.worker.gather(0)
    cut = torch.stack(cuts)
    assert cut.any()
    assert not gathered.loss_mask[cut].any()
    values = gathered.returns - gathered.advantages
    going_on = gathered.loss_mask[:-1] & cut[1:] & ~gathered.ended[:-1]
    assert going_on.any()
    due = gathered.rewards[:-1] + DISCOUNT * values[1:]
    torch.testing.assert_close(gathered.returns[:-1][going_on], due[going_on])


@pytest.mark.parametrize("epsilon", [0.0, 0.25, 1.0])
def test_a_share_of_actions_is_random(epsilon: float) -> None:
    """A random action is the best one by chance, too; none is one that masks forbid."""
    settings = PQNSettings(n_agents=256, rollout_length=16, width=16, epsilon=epsilon, iterations=10)
    trainer = PQN(MEADOW, "native", settings)
    gathered = trainer.worker.gather(0)
    with torch.no_grad():
        best = trainer.policy(*gathered.flat().inputs[:3]).argmax(1).view_as(gathered.actions)
    masks = gathered.inputs.masks[gathered.loss_mask] != 0
    actions, best = gathered.actions[gathered.loss_mask], best[gathered.loss_mask]
    assert masks.gather(1, actions[:, None]).all()
    due = epsilon * (1 - (1 / masks.sum(1)).mean())
    deviation = float(torch.sqrt(due * (1 - due) / len(best)))
    assert float((actions != best).float().mean()) == pytest.approx(float(due), abs=4 * deviation)


def test_exploration_falls_to_its_last_share() -> None:
    settings = PQNSettings(iterations=20, epsilon=0.9, final_epsilon=0.1, exploration_fraction=0.5)
    trainer = PQN(get_spec("CartPole"), "native", settings)
    shares = []
    for trainer.done in (0, 5, 10, 20):
        shares.append(trainer.figures()["explored"])
    assert shares == pytest.approx([0.9, 0.5, 0.1, 0.1])
