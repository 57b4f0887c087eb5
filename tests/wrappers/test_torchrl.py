"""TorchRL through our bridge: specs, episodes as they are, ends where they were, collectors, learning."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from unittest import mock

import numpy as np
import pytest
from gymnasium.spaces import Discrete, Tuple

import pearl_marl
from pearl_marl import envs
from pearl_marl.errors import ActionError, ArgumentError, OrderError
from pearl_marl.golden import reference
from pearl_marl.wrappers import agent_indicator_v0, dtype_v0, flatten_v0, frame_skip_v0, frame_stack_v1

from ..sampling import KINDS, sampled
from ..toy import TOYS
from ..toy_fields import FIELDS
from ..toy_world import HARES, WORLDS, crowd

pytest.importorskip("torchrl", reason="TorchRL is not installed: pip install '.[torchrl]'")

import torch
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import RewardSum, TransformedEnv
from torchrl.envs.utils import check_env_specs, step_mdp

from pearl_marl.wrappers import to_torchrl


@pytest.fixture(autouse=True)
def toys() -> Iterator[None]:
    with mock.patch.dict(envs._specs):
        for spec in (*TOYS, *FIELDS, *WORLDS, crowd(4)):
            pearl_marl.register(spec)
        yield


TOY_NAMES = sorted(spec.name for spec in (*TOYS, *FIELDS, *WORLDS, crowd(4)))


def made(name: str, worlds: int, **arguments: Any) -> Any:
    return pearl_marl.parallel_env(name, worlds * pearl_marl.get_spec(name).agents, **arguments)


def rows(tensordict: Any, groups: list[str], key: str) -> Any:
    """Return a key of all agents, a row each; of roles it is as wide as it is."""
    return [tensordict[group, key].numpy() for group in groups]


@pytest.mark.parametrize("name", [*sampled(pearl_marl.list_envs(), KINDS), *TOY_NAMES])
@pytest.mark.parametrize("state", [False, True])
def test_specs(name: str, state: bool) -> None:
    env = to_torchrl(made(name, 3, max_cycles=2), state=state)
    check_env_specs(env, break_when_any_done="both", seed=0)
    assert ("state" in env.observation_spec.keys()) is state  # noqa: SIM118  # a spec iterates otherwise


FORAGING = {"field_size": (5, 5), "max_num_food": 1, "max_player_level": 1}
"""Options with which random players soon find all food."""


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("LevelBasedForaging", {"max_cycles": 20, **FORAGING}),
        ("ConnectFour", {"max_cycles": 11}),
        ("CartPole", {"max_cycles": 15}),
        ("Ladder", {}),  # without a limit
        ("Meadow", {"max_cycles": 25}),
        ("Crowd", {"max_cycles": 6}),
    ],
)
def test_episodes_are_those_of_the_environment(name: str, options: dict[str, Any]) -> None:
    """Step for step: what is seen, allowed, rewarded and over, across many ends of every kind."""
    torch.manual_seed(0)  # of the random actions
    n, k = 9, pearl_marl.get_spec(name).agents
    plain, env = made(name, n, **options), to_torchrl(made(name, n, **options))
    groups = list(env.group_map)
    obs = plain.reset_batch(5)
    env.set_seed(5)
    before = env.reset()
    ends = {"terminated": 0, "truncated": 0, "alone": 0}
    for _ in range(60):
        assert_seen(before, groups, obs, plain.action_masks, plain.in_episode)
        acting = plain.in_episode.copy()
        env.rand_action(before)
        actions = np.concatenate(rows(before, groups, "action"), 1)
        step = plain.step_batch(actions.reshape(n * k, *actions.shape[2:]))
        after, before = env.step_and_maybe_reset(before)
        after = after["next"]
        over = step.ended.reshape(n, k).any(1) & step.in_episode.reshape(n, k).all(1)
        np.testing.assert_array_equal(after["done"][:, 0], over)
        last = np.where(step.ended.reshape(-1, *(1,) * (obs.ndim - 1)), step.final_obs, step.obs)
        last[~acting] = 0
        assert_observed(after, groups, last, acting | True)
        for key, expected in (
            ("reward", step.rewards),
            ("terminated", step.terminations | ~acting),
            ("truncated", step.truncations),
            ("done", step.ended | ~acting),
        ):
            np.testing.assert_array_equal(
                np.concatenate(rows(after, groups, key), 1)[..., 0], expected.reshape(n, k)
            )
        truncated = step.truncations.reshape(n, k).any(1)
        np.testing.assert_array_equal(after["truncated"][:, 0], truncated)
        np.testing.assert_array_equal(
            after["terminated"][:, 0],
            over & np.concatenate(rows(after, groups, "terminated"), 1)[..., 0].all(1),
        )
        ends["terminated"] += int(after["terminated"].sum())
        ends["truncated"] += int(truncated.sum())
        ends["alone"] += int((step.ended & ~step.in_episode).sum())
        obs = step.obs
    assert ends["terminated"]
    assert bool(ends["truncated"]) is ("max_cycles" in options)
    assert bool(ends["alone"]) is (name in ("Meadow", "Crowd"))


def assert_seen(tensordict: Any, groups: list[str], obs: Any, masks: Any, in_episode: Any) -> None:
    assert_observed(tensordict, groups, obs, in_episode)
    if masks is not None:
        n = len(tensordict)
        expected = masks.astype(bool)
        expected[~expected.any(1), 0] = True
        expected[~in_episode] = [True] + [False] * (masks.shape[1] - 1)
        assert_wide(rows(tensordict, groups, "action_mask"), expected.reshape(n, -1, masks.shape[1]))
    assert not tensordict["done"].any()


def assert_observed(tensordict: Any, groups: list[str], obs: Any, looking: Any) -> None:
    """Compare who is looking: who has died is shown once more where he did, as TorchRL goes on from there."""
    n, place = len(tensordict), 0
    expected = obs.reshape(n, -1, *obs.shape[1:])
    for values in rows(tensordict, groups, "observation"):
        k = values.shape[1]
        there = looking.reshape(n, -1)[:, place : place + k]
        part = expected[:, place : place + k, ..., : values.shape[-1]] if values.ndim > 2 else expected
        assert values.dtype == part.dtype
        np.testing.assert_array_equal(values[there], part[there])
        place += k


def assert_wide(parts: list[Any], expected: Any) -> None:
    place = 0
    for values in parts:
        k, width = values.shape[1:]
        np.testing.assert_array_equal(values, expected[:, place : place + k, :width])
        assert not expected[:, place : place + k, width:].any()
        place += k


def test_where_a_world_is_truncated_its_state_and_its_masks_are_the_last_ones() -> None:
    """By the golden functions, of the state before and the actions: of the next episode would be wrong."""
    env = to_torchrl(made("LevelBasedForaging", 50, max_cycles=7, **FORAGING), state=True)
    spec = env.env.spec
    env.set_seed(1)
    before = env.reset()
    truncated = terminated = 0
    for _ in range(40):
        env.rand_action(before)
        after, following = env.step_and_maybe_reset(before)
        state = before["state"].numpy().astype(np.int64)
        actions = before["agents", "action"].numpy()
        words = reference(spec.positional.step)(*state.T, *actions.T)[: len(spec.state)]
        expected = np.stack([np.broadcast_to(word, len(state)) for word in words], 1)
        over = after["next", "terminated"][:, 0].numpy()
        np.testing.assert_array_equal(after["next", "state"][~over], expected[~over])
        assert not after["next", "state"][over].any()
        for k in range(2):
            flags = np.broadcast_arrays(*reference(spec.positional.masks, k)(*expected.T))
            masks = np.stack(flags, 1).astype(bool)
            shown = after["next", "agents", "action_mask"][:, k].numpy()
            np.testing.assert_array_equal(shown[~over], masks[~over])
            assert (shown[over] == [True] + [False] * 5).all()
        np.testing.assert_array_equal(following["state"], env.env.state())
        truncated += int((after["next", "truncated"][:, 0].numpy() & ~over).sum())
        terminated += int(over.sum())
        before = following
    assert truncated
    assert terminated


def test_what_a_step_has_shown_stays() -> None:
    """Resets and later steps leave it alone, though TorchRL fills in what a reset shows."""
    env = to_torchrl(made("LevelBasedForaging", 20, max_cycles=4), state=True)
    before = env.reset()
    shown, copies = [], []
    for _ in range(30):
        env.rand_action(before)
        after, before = env.step_and_maybe_reset(before)
        shown.append(after)
        copies.append(after.clone())
    for now, then in zip(shown, copies, strict=True):
        assert (now == then).all()


def test_tensors_share_the_memory_of_results() -> None:
    inside = made("LevelBasedForaging", 4)
    env = to_torchrl(inside)
    before = env.rand_action(env.reset())
    steps = []
    original = inside.step_batch
    with mock.patch.object(
        inside, "step_batch", lambda actions: steps.append(original(actions)) or steps[-1]
    ):
        after = env.step(before)["next", "agents"]
    assert np.shares_memory(after["observation"].numpy(), steps[0].obs)
    assert np.shares_memory(after["reward"].numpy(), steps[0].rewards)
    assert np.shares_memory(after["terminated"].numpy(), steps[0].terminations)


class TestResets:
    def test_some_worlds(self) -> None:
        env = to_torchrl(made("CartPole", 6))
        env.set_seed(0)
        now = step_mdp(env.step(env.rand_action(env.reset())))
        kept = now.clone()
        mask = torch.tensor([1, 0, 0, 1, 0, 0], dtype=torch.bool)
        begun = env.reset(now.set("_reset", mask[:, None]))
        moved = (begun["agents", "observation"] != kept["agents", "observation"]).flatten(1).any(1)
        assert moved.tolist() == mask.tolist()
        plain = made("CartPole", 6, max_cycles=0)
        expected = plain.load_state(env.env.save_state())
        np.testing.assert_array_equal(begun["agents", "observation"][:, 0], expected)

    def test_a_reset_begins_the_time_limit_anew(self) -> None:
        env = to_torchrl(made("CliffWalking", 2, max_cycles=3))
        now = env.reset()
        still = torch.zeros(2, 1, dtype=torch.int64)
        for reset_now in (False, True, False):
            if reset_now:
                now = env.reset(now.set("_reset", torch.tensor([[True], [False]])))
            now = step_mdp(env.step(now.set(("agents", "action"), still)))
        assert now["truncated"][:, 0].tolist() == [False, True]

    def test_seeds(self) -> None:
        env = to_torchrl(made("LevelBasedForaging", 5))
        runs = []
        for seed in (3, 3, 4):
            torch.manual_seed(0)
            env.set_seed(seed)
            runs.append(env.rollout(60, break_when_any_done=False))
        assert (runs[0] == runs[1]).all()
        assert not (runs[0] == runs[2]).all()
        expected = made("LevelBasedForaging", 5).reset_batch(3).reshape(5, 2, 15)
        np.testing.assert_array_equal(runs[0]["agents", "observation"][:, 0], expected)

    def test_a_reset_without_a_seed_goes_on(self) -> None:
        env = to_torchrl(made("LevelBasedForaging", 5))
        env.set_seed(3)
        first, second = env.reset(), env.reset()
        assert not (first == second).all()


def test_groups_are_roles() -> None:
    env = to_torchrl(made("Meadow", 3))
    assert env.group_map == {"hare": ["agent_0", "agent_1"], "snail": ["agent_2", "agent_3"]}
    shapes = {group: env.observation_spec[group, "observation"].shape for group in env.group_map}
    assert shapes == {"hare": (3, HARES, 4), "snail": (3, 2, 2)}
    assert env.full_action_spec["snail", "action"].space.n == 3
    assert env.observation_spec["snail", "action_mask"].shape == (3, 2, 3)


def test_roles_that_take_turns_in_a_world() -> None:
    """Whose rows do not lie side by side."""
    meadow = WORLDS[0]
    hare, snail = meadow.roles[0], meadow.roles[2]
    inside = made("Meadow", 3)
    with mock.patch.object(
        inside.batch, "world", inside.batch.world._replace(roles=(hare, snail, hare, snail))
    ):
        env = to_torchrl(inside)
    assert env.group_map == {"hare": ["agent_0", "agent_2"], "snail": ["agent_1", "agent_3"]}
    env.set_seed(0)
    now = env.reset()
    obs = made("Meadow", 3).reset_batch(0).reshape(3, 4, 4)
    np.testing.assert_array_equal(now["hare", "observation"], obs[:, ::2])
    np.testing.assert_array_equal(now["snail", "observation"], obs[:, 1::2, :2])
    now["hare", "action"], now["snail", "action"] = torch.tensor([[1, 2]] * 3), torch.tensor([[0, 1]] * 3)
    with mock.patch.object(inside, "step_batch", side_effect=inside.step_batch) as step_batch:
        env.step(now)
    np.testing.assert_array_equal(step_batch.call_args.args[0], [1, 0, 2, 1] * 3)


def test_wrapped_environments() -> None:
    inside = agent_indicator_v0(frame_stack_v1(made("LevelBasedForaging", 4, max_cycles=5), 2))
    env = to_torchrl(inside)
    check_env_specs(env, seed=0)
    plain = agent_indicator_v0(frame_stack_v1(made("LevelBasedForaging", 4, max_cycles=5), 2))
    obs = plain.reset_batch(2)
    env.set_seed(2)
    now = env.reset()
    for _ in range(12):
        np.testing.assert_array_equal(now["agents", "observation"], obs.reshape(4, 2, 32))
        env.rand_action(now)
        obs = plain.step_batch(now["agents", "action"].numpy().ravel()).obs
        _, now = env.step_and_maybe_reset(now)


def test_boards_as_numbers() -> None:
    env = to_torchrl(dtype_v0(flatten_v0(made("ConnectFour", 4)), np.float32))
    assert env.rollout(9)["agents", "observation"].shape == (4, 9, 2, 84)


class TestActions:
    def test_random_ones_are_allowed(self) -> None:
        """ConnectFour refuses others: a few hundred steps of 50 games would not go well for long."""
        env = TransformedEnv(to_torchrl(made("ConnectFour", 50)), RewardSum())
        whole = env.rollout(100, break_when_any_done=False)
        assert whole["next", "done"].any()
        for group in ("agents",):
            taken = whole[group, "action_mask"].gather(-1, whole[group, "action"][..., None])
            assert taken.all()

    def test_impossible_ones_are_refused(self) -> None:
        env = to_torchrl(made("LevelBasedForaging", 2))
        now = env.reset()
        now["agents", "action"] = torch.tensor([[0, 0], [6, 0]])
        with pytest.raises(ActionError, match="agent_2: action 6 is out of range"):
            env.step(now)

    def test_a_step_before_the_first_reset(self) -> None:
        env = to_torchrl(made("LevelBasedForaging", 2))
        with pytest.raises(OrderError, match=r"step\(\) before reset"):
            env.rand_step(TensorDict(batch_size=2))


def test_collected_batches_are_whole_episodes() -> None:
    """A transition's next observation is the following one's, but where an episode ended."""
    env = to_torchrl(made("LevelBasedForaging", 16, max_cycles=10))
    collector = Collector(env, policy=None, frames_per_batch=16 * 25, total_frames=16 * 75)
    collector.set_seed(0)
    batches = list(collector)
    assert [batch.shape for batch in batches] == [(16, 25)] * 3
    whole = torch.cat(batches, 1)
    done, seen = whole["next", "done"][:, :-1, 0], whole["agents", "observation"]
    following = (whole["next", "agents", "observation"][:, :-1] == seen[:, 1:]).flatten(2).all(-1)
    assert following[~done].all()
    assert not following[done].any()
    assert whole["next", "truncated"].any()
    collector.shutdown()


def test_it_closes() -> None:
    env = to_torchrl(made("CartPole", 2))
    env.reset()
    env.close()
    with pytest.raises(OrderError, match="after close"):
        env.reset()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: to_torchrl(pearl_marl.make_vec("CartPole", 2)),
            "PearlVectorEnv is no environment of this package's parallel_env; to_torchrl takes those, in "
            "this package's wrappers or none",
        ),
        (
            lambda: to_torchrl(pearl_marl.parallel_env("CartPole", 2, autoreset=False)),
            "agents of autoreset=False leave when their episode ends, and TorchRL's stay: make the "
            "environment with autoreset=True",
        ),
        (
            lambda: to_torchrl(pearl_marl.parallel_env("CartPole", 2, copy=False)),
            "copy=False lets the next step overwrite results, and TorchRL keeps them: make the environment "
            "with copy=True",
        ),
        (
            lambda: to_torchrl(flatten_v0(frame_skip_v0(pearl_marl.parallel_env("CartPole", 2), 3))),
            "the time limit counts steps of the environment, and frame_skip_v0 takes several in one: use "
            "TorchRL's FrameSkipTransform instead",
        ),
        (
            lambda: to_torchrl(pearl_marl.parallel_env("CartPole", 2), state=1),  # type: ignore[arg-type]
            "state is 1; it must be True or False",
        ),
        (
            lambda: to_torchrl(two_kinds_of_hares()),
            "two roles are named 'hare' and differ in their spaces, which a group has in common: give each a "
            "name",
        ),
    ],
)
def test_what_is_refused(make: Any, message: str) -> None:
    with pytest.raises(ArgumentError) as error:
        make()
    assert str(error.value) == message


def two_kinds_of_hares() -> Any:
    env = made("Meadow", 1)
    *others, last = env.batch.world.roles
    env.batch.world = env.batch.world._replace(roles=(*others, last._replace(name="hare")))
    return env


def test_spaces_that_do_not_begin_at_zero() -> None:
    from pearl_marl.wrappers.torchrl import _spec

    spec = _spec(Discrete(3, start=5), (2,))
    assert spec.contains(torch.tensor([5, 7]))
    assert not spec.contains(torch.tensor([4, 7]))
    pair = _spec(Tuple([Discrete(3, start=5), Discrete(2)]), (2,))
    assert pair.contains(torch.tensor([[5, 0], [7, 1]]))
    assert not pair.contains(torch.tensor([[5, 0], [7, 2]]))


def test_another_time_limit() -> None:
    env = to_torchrl(made("CartPole", 2))
    assert env.max_cycles == 500
    env.max_cycles = 3
    done = env.rollout(7, break_when_any_done=False)["next", "truncated"][0, :, 0]
    assert done.tolist() == [False, False, True] * 2 + [False]
    with pytest.raises(ArgumentError, match="max_cycles is -1"):
        env.max_cycles = -1
    env.max_cycles = None
    assert env.max_cycles == 500
