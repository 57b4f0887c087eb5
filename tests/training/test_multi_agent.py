"""Training of several agents: masks, turns, ends of their own, the world's state, teams, and past selves."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.evaluation.run import Evaluation
from pearl_marl.policies.loading import load_policy

from ..toy_world import MEADOW, NIM

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
training = importlib.import_module("pearl_marl.training.run")
network = importlib.import_module("pearl_marl.policies.network")
trained = importlib.import_module("pearl_marl.policies.trained")
agents = importlib.import_module("pearl_marl.training.agents")
rollout = importlib.import_module("pearl_marl.training.rollout")

Pearl = Callable[..., tuple[int, str, str]]

SMALL: dict[str, Any] = {"n_agents": 32, "rollout_length": 16, "iterations": 3, "minibatch": 64}


pytestmark = pytest.mark.usefixtures("toys")


def trainer_of(algorithm: str, name: str, options: dict[str, Any] | None = None, **given: Any) -> Any:
    spec = get_spec(name).with_options(**(options or {}))
    settings = training.settings_for(algorithm, name, given, None, spec.agents)
    return training.ALGORITHMS[training.ALIASES.get(algorithm, algorithm)](spec, "native", settings)


GAMES = "LevelBasedForaging", "ConnectFour", "Meadow", "Nim"


@pytest.mark.parametrize("name", GAMES)
@pytest.mark.parametrize("algorithm", ["ippo", "mappo", "self-play"])
def test_masks_are_never_violated(algorithm: str, name: str) -> None:
    """In rollouts, and by what is learned; ConnectFour and Nim would refuse, the others would not say so."""
    trainer = trainer_of(algorithm, name, **SMALL)
    for _ in range(SMALL["iterations"]):
        e = trainer.worker.gather(trainer.done)
        allowed = e.inputs.masks.gather(2, e.actions[..., None])[..., 0] == 1
        asked = (e.inputs.masks != 0).any(2)
        assert asked.any()
        assert allowed[asked].all()
        assert not e.loss_mask[~asked].any(), "there was nothing to decide"
        trainer.iterate()
    assert all(tensor.isfinite().all() for tensor in trainer.model.state_dict().values())
    obs, masks = e.inputs.obs[0].numpy(), e.inputs.masks[0].numpy()
    chosen = trainer.policy.choose(obs, masks)
    assert masks[np.arange(len(masks)), chosen][masks.any(1)].all()


@pytest.mark.parametrize("name", ["LevelBasedForaging", "Meadow"])
def test_exploration_keeps_to_masks(name: str) -> None:
    trainer = trainer_of("iql", name, n_agents=32, iterations=30, memory=30, warm_up=5, minibatch=64)
    taken = []
    step = trainer.agents.step

    def watched(actions: Any) -> Any:
        taken.append((trainer.agents.inputs.masks.clone(), actions))
        return step(actions)

    trainer.agents.step = watched
    for _ in range(30):
        trainer.iterate()
    masks, actions = (torch.stack(parts) for parts in zip(*taken, strict=True))
    assert (masks.gather(2, actions[..., None])[..., 0] == 1)[(masks != 0).any(2)].all()
    # And the values that targets go by are of actions that are allowed where the step led.
    kept, alive = trainer.memory["masks"], trainer.memory["alive"]
    goes_on = ~trainer.memory["over"][:-1] & alive[1:]
    assert (kept[:-1] == masks[1:])[goes_on].float().mean() > 0.9, "but where a time limit cut it short"


def test_a_table_of_values_keeps_to_masks() -> None:
    policy = trained.TabularPolicy(NIM)
    policy.values[0, :, 2] = 1  # to take three looks best
    best = policy.best(torch.tensor([5, 2, 1]), torch.tensor([[1, 1, 1], [1, 1, 0], [1, 0, 0]]))
    assert best.tolist() == [2, 0, 0]


def test_logits_of_masked_actions_have_no_probability_and_no_gradient() -> None:
    trainer = trainer_of("ppo", "ConnectFour", **SMALL)
    obs = torch.zeros(2, 6, 7, 2, dtype=torch.int8)
    masks = torch.tensor([[1, 0, 0, 1, 0, 0, 0], [0] * 7])
    outputs = trainer.policy(obs, masks)
    log_probs, entropy = trainer.model.evaluate(outputs, torch.tensor([3, 0]))
    assert outputs.softmax(1)[0, [1, 2, 4, 5, 6]].eq(0).all()
    assert log_probs.exp().tolist() == pytest.approx([0.5, 1 / 7], abs=0.01)
    (gradient,) = torch.autograd.grad(log_probs.sum() + entropy, outputs, retain_graph=True)
    assert gradient.isfinite().all()
    assert (gradient[0, [1, 2, 4, 5, 6]] == 0).all()
    outputs.backward(gradient)
    assert (trainer.policy.network.output.bias.grad[[1, 2, 4, 5, 6]] == 0).all()


def test_blocks_of_a_game_of_turns_are_asked_alone() -> None:
    """So a part of the agents does what it does among all, to the last bit, by whatever number of shards."""
    trainer = trainer_of("ppo", "ConnectFour", n_agents=1024, rollout_length=4, blocks=8)
    whole = trainer.worker.gather(0)
    for blocks in (range(4), range(6, 8)):
        worker = rollout.RolloutWorker(trainer.policy.spec, "native", trainer.settings, trainer.model, blocks)
        part = worker.gather(0)
        columns = slice(128 * blocks.start, 128 * blocks.stop)
        for name in ("actions", "log_probs", "advantages", "returns"):
            assert torch.equal(getattr(part, name), getattr(whole, name)[:, columns]), name


def test_who_waits_is_credited_with_what_the_other_does() -> None:
    """In Nim who moves wins, so nobody loses by a move of its own."""
    e = trainer_of("ppo", "Nim", **SMALL, discount=1.0, gae_lambda=1.0).worker.gather(0)
    losses = e.ended & (e.rewards < 0)
    assert losses.any()
    assert not e.loss_mask[losses].any(), "it was not on turn"
    for t, agent in losses.nonzero().tolist():
        before = e.loss_mask[:t, agent].nonzero()
        started = e.ended[:t, agent].nonzero()
        if len(before) and (not len(started) or before[-1] > started[-1]):
            assert e.returns[before[-1, 0], agent] == -1
    last = (e.inputs.masks[-1] != 0).any(1)
    open_end = last & ~e.ended[-1]
    assert open_end.any()
    assert not e.loss_mask[-1][open_end].any(), "where it led is not known before the other has moved"


def test_the_dead_do_not_learn() -> None:
    trainer = trainer_of("ppo", "Meadow", **{**SMALL, "rollout_length": 40})
    e = trainer.worker.gather(0)
    dead = (e.inputs.masks == 0).all(2)
    assert dead.any()
    assert not e.loss_mask[dead].any()
    # Nothing that a dead agent sees has to do with its last decision.
    died = e.ended[:-1] & dead[1:]
    assert died.any()
    with torch.no_grad():
        values = trainer.model.values(e.inputs.flat()).reshape(e.rewards.shape)
    gains = (e.rewards - values)[:-1]
    torch.testing.assert_close(e.advantages[:-1][died], gains[died])


def test_team_rewards() -> None:
    rewards = torch.tensor([[1.0, 0.0, 4.0, 2.0], [0.0, 0.0, 1.0, 1.0]])
    assert agents.team_rewards(rewards, 2, "own") is rewards
    assert agents.team_rewards(rewards, 2, "mean").tolist() == [[0.5, 0.5, 3, 3], [0, 0, 1, 1]]
    assert agents.team_rewards(rewards, 2, "sum").tolist() == [[1, 1, 6, 6], [0, 0, 2, 2]]


def test_who_is_dead_still_wants_what_the_team_earns() -> None:
    given = {**SMALL, "rollout_length": 60, "discount": 1.0, "gae_lambda": 1.0}
    own, team = (
        trainer_of("ppo", "Meadow", rewards=whose, **given).worker.gather(0) for whose in ("own", "sum")
    )
    assert torch.equal(own.rewards, team.rewards), "the same weights act alike"
    dead = (own.inputs.masks == 0).all(2)
    together = agents.team_rewards(own.rewards, 4, "sum")
    checked = 0
    for t, agent in (own.ended[:-1] & dead[1:]).nonzero().tolist():
        world = slice(agent // 4 * 4, agent // 4 * 4 + 4)
        alive_again = (~dead[t + 1 :, agent]).nonzero()
        if not len(alive_again) or not team.loss_mask[t, agent]:
            continue
        until = t + 1 + int(alive_again[0])
        cut = own.ended[until - 1, world] & (own.rewards[until - 1, world] > -99)
        assert cut.any(), "the world ended"
        torch.testing.assert_close(team.returns[t, agent], together[t:until, agent].sum())
        checked += 1
    assert checked > 3


# ---- The state of the world ----


def test_the_central_critic_sees_the_state_of_the_world_and_nothing_else() -> None:
    trainer = trainer_of("mappo", "LevelBasedForaging", {"sight": 1}, **SMALL)
    agents = trainer.worker.agents
    np.testing.assert_array_equal(agents.inputs.state[::2], agents.device.state())
    np.testing.assert_array_equal(agents.inputs.state[1::2], agents.device.state())
    trainer.iterate()
    inputs, critic = agents.inputs, trainer.model
    with torch.no_grad():
        values, outputs = critic.values(inputs), critic.outputs(inputs)
        blind = inputs._replace(obs=torch.zeros_like(inputs.obs))
        assert torch.equal(critic.values(blind), values), "of what agents observe it sees nothing"
        for column in range(inputs.state.shape[1]):
            state = inputs.state.clone()
            state[:, column] += 1
            moved = inputs._replace(state=state)
            assert (critic.values(moved) != values).any(), f"it sees {trainer.policy.spec.state[column].name}"
            assert torch.equal(critic.outputs(moved), outputs), "the policy does not"
        other = inputs._replace(position=1 - inputs.position)
        assert (critic.values(other) != values).any(), "each agent of a world has its own value"


def test_the_central_critic_learns() -> None:
    """What an agent will get who sees no farther than a cell depends on what the critic sees of the world."""
    trainer = trainer_of("mappo", "LevelBasedForaging", {"sight": 1}, **{**SMALL, "n_agents": 256})
    before = {name: tensor.clone() for name, tensor in trainer.model.critic.state_dict().items()}
    trainer.iterate()
    after = trainer.model.critic.state_dict()
    assert (after["encoder.mean"] != before["encoder.mean"]).any(), "it is standardised"
    assert (after["encoder.linear.weight"] != before["encoder.linear.weight"]).any()
    assert after["output.weight"].shape[0] == 2, "a value for each agent"


@pytest.mark.parametrize("algorithm", ["ppo", "mappo"])
def test_what_is_learned_from_comes_once_an_epoch(algorithm: str) -> None:
    """With a central critic, in whole worlds, but for the rows of which nothing is learned."""
    settings = training.settings_for(
        algorithm,
        "LevelBasedForaging",
        {"n_agents": 64, "rollout_length": 4, "minibatch": 50, "epochs": 2},
    )
    trainer = training.ALGORITHMS[algorithm](get_spec("LevelBasedForaging"), "native", settings)
    rows = torch.cat((torch.arange(1, 90), torch.arange(91, 256)))
    minibatches = list(trainer.minibatches(rows))
    whole = torch.cat(minibatches)
    for epoch in whole.view(2, -1):
        assert torch.equal(epoch.sort().values, rows)
        assert not torch.equal(epoch, rows)
    assert max(map(len, minibatches)) == 50
    if algorithm == "mappo":
        agents = trainer.model.agents_per_state
        changes = int((whole[1:] // agents != whole[:-1] // agents).sum())
        assert changes < 2 * 256 // agents, "a world's rows follow each other"


def test_values_of_whole_worlds_are_those_of_their_agents() -> None:
    for algorithm in ("ppo", "mappo"):
        settings = training.settings_for(
            algorithm, "LevelBasedForaging", {"n_agents": 64, "rollout_length": 4}
        )
        trainer = training.ALGORITHMS[algorithm](get_spec("LevelBasedForaging"), "native", settings)
        inputs = trainer.worker.gather(0).flat().inputs
        with torch.no_grad():
            assert torch.equal(trainer.model.values_of_all(inputs), trainer.model.values(inputs))


def test_a_step_of_which_the_state_is_not_known_is_not_learned_from() -> None:
    """At a time limit the next state is that of another episode, which must not get into the advantages."""
    given = {**SMALL, "n_agents": 200, "rollout_length": 20, "discount": 0.9, "gae_lambda": 0.0}
    trainer = trainer_of("mappo", "LevelBasedForaging", {"max_episode_steps": 7}, **given)
    e = trainer.worker.gather(0)
    with torch.no_grad():
        values = trainer.model.values(e.inputs.flat()).reshape(e.rewards.shape)
    first = ~e.ended[:6].any(0)  # who is in its first episode still
    loaded = e.rewards[6].reshape(-1, 2).any(1).repeat_interleave(2)
    cut = first & ~loaded  # only by loading the last food a game ends before
    assert e.ended[6][cut].all()
    assert cut.sum() > 100
    assert not e.loss_mask[6][cut].any()
    assert e.loss_mask[:6][:, cut].all()
    expected = e.rewards[5] + 0.9 * values[6] - values[5]
    torch.testing.assert_close(e.advantages[5][cut], expected[cut])
    assert e.loss_mask[7:13][:, cut].float().mean() > 0.9


# ---- What agents share ----


@pytest.mark.parametrize("sharing", network.SHARING)
@pytest.mark.parametrize("algorithm", ["ippo", "mappo", "iql"])
def test_networks_are_shared_or_not(algorithm: str, sharing: str, tmp_path: Path) -> None:
    given = {"n_agents": 32, "iterations": 12, "minibatch": 32, "sharing": sharing}
    given |= {"rollout_length": 4} if algorithm != "iql" else {"warm_up": 2}
    trainer = trainer_of(algorithm, "LevelBasedForaging", **given)
    for _ in range(4):
        trainer.iterate()
    policy, obs = (
        trainer.policy,
        torch.as_tensor(trainer.agents.inputs.obs if algorithm == "iql" else trainer.worker.agents.obs),
    )
    with torch.no_grad():
        outputs = policy(obs[:1].expand(4, -1))
    torch.testing.assert_close(outputs[:2], outputs[2:])
    assert torch.allclose(outputs[0], outputs[1]) == (sharing == "all"), "the same seen by another agent"
    trainer.policy.save(tmp_path / "policy.safetensors")
    again = trained.load(tmp_path)
    assert again.about == policy.about
    np.testing.assert_array_equal(again.choose(obs.numpy()), policy.choose(obs.numpy()))


def test_separate_networks_learn_from_their_own_agents_alone() -> None:
    separate = network.networks(get_spec("LevelBasedForaging"), 3, 8, sharing="none")
    obs, position = torch.rand(7, 15), torch.tensor([0, 1, 1, 0, 1, 0, 0])
    outputs = separate(obs, position)
    for k in range(2):
        torch.testing.assert_close(outputs[position == k], separate[k](obs[position == k]))
    outputs[position == 1].sum().backward()
    assert all(not parameter.grad.any() for parameter in separate[0].parameters())


def test_an_unknown_sharing_of_a_file_is_refused(tmp_path: Path) -> None:
    policy = trained.NetworkPolicy(get_spec("LevelBasedForaging"), "values", 4)
    policy.about["sharing"] = "some"
    policy.save(tmp_path / "policy.safetensors")
    with pytest.raises(ArgumentError, match="has the sharing 'some'; possible are all, indicator, none"):
        trained.load(tmp_path)


@pytest.mark.parametrize(
    ("algorithm", "given", "words"),
    [
        ("ppo", {"sharing": "some"}, "--set sharing is 'some'; it must be one of all, indicator, none"),
        ("iql", {"rewards": 3}, "--set rewards is 3; it must be one of own, mean, sum"),
        ("self-play", {"join_every": 0}, "--set join_every is 0"),
        ("self-play", {"mirrored": 1.5}, "--set mirrored is 1.5"),
    ],
)
def test_wrong_settings_are_refused(algorithm: str, given: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        training.settings_for(algorithm, "LevelBasedForaging", given)


def test_other_names_of_algorithms(tmp_path: Path) -> None:
    assert training.settings_for("ippo", "LevelBasedForaging", {}) == training.settings_for(
        "ppo", "LevelBasedForaging", {}
    )
    settings = training.settings_for("iql", "LevelBasedForaging", {"n_agents": 8, "iterations": 1})
    training.train(training.Training("LevelBasedForaging", "iql", settings), tmp_path, evaluated=10)
    assert json.loads((tmp_path / "config.json").read_text())["settings"]["algorithm"] == "dqn"
    same = training.Training("LevelBasedForaging", "dqn", settings)
    assert training.train(same, tmp_path), "the same run"


# ---- Self-play ----


def test_members_of_the_league_act_and_are_not_learned_from() -> None:
    given = {
        **SMALL,
        "n_agents": 64,
        "mirrored": 0.25,
        "opponents": 3,
        "rollout_length": 8,
        "random_moves": 0.0,
    }
    trainer = trainer_of("self-play", "ConnectFour", **given)
    worker = trainer.worker
    players = worker.league.players.reshape(-1, 2)
    assert (players[:8] == 0).all(), "a quarter of the worlds"
    rivals = players[8:]
    assert ((rivals == 0).sum(1) == 1).all(), "one seat of each other world is the learner's"
    assert (rivals == 0).sum(0).tolist() == [12, 12], "each seat as often"
    assert sorted(set(rivals[rivals != 0].tolist())) == [1, 2, 3]
    # A member that has made up its mind: the third column, while it has room.
    member = trainer.league.members[0]
    member["network.output.weight"].zero_()
    member["network.output.bias"].copy_(torch.tensor([0.0, 0, 1e4, 0, 0, 0, 0]))
    e = worker.gather(0)
    theirs = (worker.league.players != 0).expand_as(e.loss_mask) & (e.inputs.masks != 0).any(2)
    room = theirs & (e.inputs.masks[..., 2] == 1)
    assert room.any()
    assert (e.actions[room] == 2).all()
    assert not e.loss_mask[theirs].any()
    mine = (worker.league.players == 0).expand_as(e.loss_mask) & (e.inputs.masks != 0).any(2)
    assert len(e.actions[mine].unique()) == 7
    assert e.loss_mask[:-2][mine[:-2]].all()


def test_random_moves_are_not_learned_from() -> None:
    """But what came before them is, and goes by the value of where they were made."""
    given = {
        **SMALL,
        "n_agents": 128,
        "rollout_length": 12,
        "mirrored": 1.0,
        "random_moves": 0.5,
        "discount": 0.9,
    }
    trainer = trainer_of("self-play", "ConnectFour", **given)
    # A policy that plays in the middle, so that what is not there is random.
    with torch.no_grad():
        trainer.policy.network.output.bias[3] = 1e4
    e = trainer.worker.gather(0)
    decides = (e.inputs.masks != 0).any(2)
    random = trainer.league.random_moves & decides
    assert 0.4 < random[decides].float().mean() < 0.6
    assert not e.loss_mask[random].any()
    assert e.loss_mask[:-2][decides[:-2] & ~random[:-2]].all()
    middle = (e.inputs.masks[..., 3] == 1) & decides
    assert (e.actions[middle & ~random] == 3).all()
    assert (e.actions[middle & random] != 3).float().mean() > 0.6
    with torch.no_grad():
        values = trainer.model.values(e.inputs.flat()).reshape(e.rewards.shape)
    expected = e.rewards[0] + e.rewards[1] + 0.9 * values[2] - values[0]
    before = decides[0] & ~random[0] & random[2] & ~e.ended[:2].any(0)
    assert before.sum() > 3
    torch.testing.assert_close(e.advantages[0][before], expected[before])


def test_the_league_grows_and_is_kept_in_files(tmp_path: Path) -> None:
    settings = training.settings_for("self-play", "ConnectFour", {**SMALL, "join_every": 2, "iterations": 4})
    rows = training.train(training.Training("ConnectFour", "self-play", settings), tmp_path, evaluated=20)
    past = {path.stem: trained.load(path).state_dict() for path in (tmp_path / "past").iterdir()}
    assert sorted(past) == ["000000", "000002", "000004"]
    last = trained.load(tmp_path).state_dict()
    assert all(torch.equal(last[name], past["000004"][name]) for name in last), "the last is the best"
    assert any((last[name] != past["000002"][name]).any() for name in last)
    assert "eval_world_return" not in rows[-1], "who wins, somebody else loses"


def test_self_play_takes_two() -> None:
    with pytest.raises(ArgumentError, match=r"CartPole has one agent in a world.*use ppo"):
        trainer_of("self-play", "CartPole", n_agents=4)


def test_games_of_turns_are_evaluated_against_random_players() -> None:
    """A perfect player of Nim, who loses only where it has no choice."""

    class Perfect:
        seed = staticmethod(lambda seed: None)

        @staticmethod
        def function(obs: Any, masks: Any) -> Any:
            return np.where(masks.any(1), np.maximum(obs % 4, 1) - 1, 0)

    figures = training.evaluate(Perfect, NIM, 400)
    assert 0.7 < figures["eval_return"] < 1
    seats = figures["eval_return_agent_0"], figures["eval_return_agent_1"]
    assert sum(seats) / 2 == pytest.approx(figures["eval_return"])
    assert seats[0] > seats[1], "who begins can win every game"
    assert training.evaluate(Perfect, NIM, 2)["eval_return_agent_1"] is None, "one world, where it sits first"


def test_returns_are_told_by_role_and_agent() -> None:
    """Hares and snails that go right where they may, by the returns of the episodes themselves."""

    class Rightwards:
        beside = None
        seed = staticmethod(lambda seed: None)

        @staticmethod
        def function(obs: Any, masks: Any) -> Any:
            return np.where(masks[:, 2] == 1, 2, masks.argmax(1))

    figures = training.evaluate(Rightwards, MEADOW, 200)
    evaluation = Evaluation(MEADOW, Rightwards.function, 200, seed=1)
    for _ in evaluation.run():
        pass
    roles = ("hare_0", "hare_1", "snail_2", "snail_3")
    each = [figures[f"eval_return_{role}"] for role in roles]
    assert each == pytest.approx(evaluation.world_returns.mean(0))
    assert len(set(each)) == 4
    assert figures["eval_world_return"] == pytest.approx(sum(each))


def test_a_team_learns_to_forage(tmp_path: Path) -> None:
    """A small task, by whose random play a world gets a tenth."""
    options = {"field_size": [5, 5], "max_num_food": 1, "max_player_level": 1, "max_food_level": 1}
    given = {
        "n_agents": 256,
        "rollout_length": 16,
        "iterations": 25,
        "epochs": 2,
        "minibatch": 1024,
        "learning_rate": 5e-3,
    }
    settings = training.settings_for("mappo", "LevelBasedForaging", given)
    plan = training.Training("LevelBasedForaging", "mappo", settings, options)
    rows = training.train(plan, tmp_path, evaluated=200)
    best = max(row["eval_world_return"] for row in rows)
    assert best > 0.9
    policy = load_policy(str(tmp_path), get_spec("LevelBasedForaging").with_options(**options))
    assert callable(policy)
