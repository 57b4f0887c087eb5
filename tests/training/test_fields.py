"""Trainers on actions of several fields: PPO chooses each for itself, and the others refuse them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")
import torch
from gymnasium.spaces import Box

from pearl_marl.errors import ArgumentError
from pearl_marl.policies import trained
from pearl_marl.policies.loading import table_policy
from pearl_marl.spec import EnvSpec
from pearl_marl.training.actor_critic import ActorCritic
from pearl_marl.training.ppo import MAPPO, PPO, PPOSettings
from pearl_marl.training.run import evaluate

from ..toy import LADDER, SLIDE
from ..toy_fields import FIELDS, GLIDER, LAMPS, RELAY, ROVER

pytestmark = pytest.mark.usefixtures("toys")

SMALL: dict[str, Any] = {
    "n_agents": 256,
    "rollout_length": 16,
    "iterations": 12,
    "minibatch": 1024,
    "seed": 0,
}


@pytest.mark.parametrize(
    ("spec", "gain"),
    [
        (ROVER, 20),
        pytest.param(LAMPS, 0.5, marks=pytest.mark.exhaustive),
        pytest.param(GLIDER, 5, marks=pytest.mark.exhaustive),
        (RELAY, 0.5),
    ],
)
def test_ppo_gets_better(spec: EnvSpec, gain: float, tmp_path: Path) -> None:
    trainer = PPO(spec, "native", PPOSettings(**SMALL))
    before = evaluate(trainer.policy, spec, 200)["eval_return"]
    for _ in range(12):
        trainer.update()
    after = evaluate(trainer.policy, spec, 200)["eval_return"]
    assert after > before + gain
    trainer.policy.save(tmp_path / "policy.safetensors")
    again = trained.load(tmp_path / "policy.safetensors")
    assert evaluate(again, spec, 200) == evaluate(trainer.policy, spec, 200)


def test_a_central_critic_too() -> None:
    trainer = MAPPO(RELAY, "native", PPOSettings(**{**SMALL, "iterations": 1}))
    trainer.update()


def test_fields_are_chosen_independently() -> None:
    model = ActorCritic(ROVER, PPOSettings(width=8))
    assert model.policy.heads == [3, 400]
    chance = torch.Generator().manual_seed(0)
    outputs = torch.randn(5, 403, generator=chance, requires_grad=True)
    actions, given = model.draw(outputs.detach(), model.noise((5, 403), chance))
    assert actions is given
    assert actions.shape == (5, 2)
    heads = [torch.distributions.Categorical(logits=part) for part in outputs.split([3, 400], -1)]
    logs = sum(head.log_prob(actions[:, k]) for k, head in enumerate(heads))
    entropy = sum(head.entropy().mean() for head in heads)
    torch.testing.assert_close(model.evaluate(outputs, actions), (logs, entropy))


def test_each_field_is_drawn() -> None:
    policy = ActorCritic(LAMPS, PPOSettings(width=8, temperature=1.0)).policy
    actions = policy.act(torch.zeros(4000, 4, dtype=torch.int8)).numpy()
    assert np.abs(actions.mean(0) - 0.5).max() < 0.1
    assert np.abs(np.corrcoef(actions.T) - np.eye(3)).max() < 0.1


def test_numbers_reach_both_ends_of_their_field() -> None:
    """Of a Box that is not as far from 0 on either side."""
    flat = replace(SLIDE, observation_space=Box(0, 1, (24,), np.bool_), configure=None)
    for spec in (GLIDER, flat):
        policy, space = ActorCritic(spec, PPOSettings(width=8)).policy, spec.action_space
        for output, end in ((-3.0, space.low), (3.0, space.high), (0.0, (space.low + space.high) / 2)):
            given = policy.within_bounds(torch.full((1, len(end)), output)).numpy()
            np.testing.assert_array_equal(given, end[None])
        assert set(policy.state_dict()) == set(ActorCritic(spec, PPOSettings(width=8)).policy.state_dict())
        assert "low" not in policy.state_dict()


def test_who_chooses_among_numbers_refuses_fields() -> None:
    with pytest.raises(
        ArgumentError, match=r"action values are of numbered actions, and Rover's are in Multi.*use ppo"
    ):
        trained.NetworkPolicy(ROVER, "values", 8)
    with pytest.raises(
        ArgumentError, match=r"a column for each action, and Rover's are in MultiDiscrete.*use ppo"
    ):
        trained.TabularPolicy(ROVER)
    with pytest.raises(ArgumentError, match="a table is for discrete observations and actions; Lamps has"):
        table_policy(np.zeros((2, 2, 2, 2, 8)), LAMPS)


def test_several_numbers_choose_a_row() -> None:
    from gymnasium.spaces import MultiDiscrete

    spec = replace(LADDER, observation_space=MultiDiscrete([10, 2]))
    table, twin = trained.TabularPolicy(spec), trained.TabularPolicy(LADDER)
    obs = torch.tensor([[3, 1], [9, 0]])
    np.testing.assert_array_equal(table.rows(obs), twin.rows(obs))
    values = np.random.default_rng(0).random((10, 2, 2))
    rows = np.array([[3, 1], [9, 0]])
    np.testing.assert_array_equal(table_policy(values, spec)(rows), values[[3, 9], [1, 0]].argmax(1))
    for each in FIELDS:
        ActorCritic(each, PPOSettings(width=4))
