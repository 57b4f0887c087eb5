"""The Gymnasium interface beyond the contract: modes, refused masks, Gymnasium's wrappers."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as wrappers

import pearl_marl
from pearl_marl import devices
from pearl_marl.errors import ActionError, ArgumentError, OrderError
from pearl_marl.wrappers import clip_reward_v0, frame_stack_v1, sticky_actions_v0


def test_gymnasium_chooses_the_vector_entry_point_by_itself() -> None:
    env = gymnasium.make_vec("Pearl/CliffWalking-v0", num_envs=3, is_slippery=True)
    assert env.unwrapped.device.config.spec.options == {"is_slippery": True}
    env.close()


@pytest.mark.parametrize("mode", AutoresetMode)
def test_modes_by_object_and_name(mode: AutoresetMode) -> None:
    """Gymnasium has two names of each, and the command line another."""
    for given in (mode, mode.value, mode.name, mode.name.lower().replace("_", "-")):
        env = pearl_marl.make_vec("CliffWalking", 2, autoreset_mode=given)
        assert env.metadata["autoreset_mode"] is mode
        env.close()


def test_no_pictures() -> None:
    with pytest.raises(ArgumentError, match=r"draws nothing: .*parallel_env"):
        pearl_marl.make_vec("CliffWalking", 2, render_mode="rgb_array")
    env = pearl_marl.make_vec("CliffWalking", 2, render_mode=None)
    with pytest.raises(OrderError, match=r"draws nothing: .*parallel_env"):
        env.render()


def test_no_mask() -> None:
    env = pearl_marl.make_vec("CliffWalking", 2)
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match=r"mask is None; reset_batch\(\)"):
        env.reset_slots(None)  # type: ignore[arg-type]


def test_unknown_mode() -> None:
    with pytest.raises(ArgumentError, match=r"'sometimes'.*'NEXT_STEP' or 'NextStep'"):
        pearl_marl.make_vec("CliffWalking", 2, autoreset_mode="sometimes")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"reset_mask": np.zeros(4, bool)}, "nothing"),
        ({"reset_mask": np.ones(3, bool)}, r"\(3,\)"),
        ({"reset_mask": np.ones(4)}, "float64"),
        ({"reset_mask": [[True], [True, False]]}, "ragged"),
        (3, "options is 3; it must be a dict"),
        ([], r"options is \[\]"),
        ({"mask": np.ones(4, bool)}, "'mask'.*'reset_mask'"),
    ],
)
@pytest.mark.parametrize("mode", AutoresetMode, ids=lambda mode: mode.name)
def test_refused_masks(mode: AutoresetMode, options: Any, words: str, toys: None) -> None:
    env, twin = (pearl_marl.make_vec("Drift", 4, autoreset_mode=mode) for _ in range(2))
    env.reset(seed=0)
    twin.reset(seed=0)
    with pytest.raises(ArgumentError, match=words):
        env.reset(options=options)
    for a, b in zip(env.step([1] * 4), twin.step([1] * 4), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_mask_may_be_a_list(toys: None) -> None:
    env, twin = (pearl_marl.make_vec("Drift", 2, autoreset_mode="Disabled", max_cycles=1) for _ in range(2))
    for e in (env, twin):
        e.reset(seed=0)
        e.step([1, 1])
    a, _ = env.reset(options={"reset_mask": [True, False]})
    b, _ = twin.reset(options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(a, b)


def test_a_mask_before_the_first_reset() -> None:
    env = pearl_marl.make_vec("CliffWalking", 2, autoreset_mode="Disabled")
    with pytest.raises(OrderError, match="without a mask first"):
        env.reset(options={"reset_mask": np.array([True, False])})


@pytest.mark.skipif(
    gymnasium.__version__.startswith("1.2."),
    reason="Gymnasium 1.2 counts as in NEXT_STEP mode, whatever it is",
)
@pytest.mark.parametrize("n", [50, 43008])
def test_episode_statistics(toys: None, n: int) -> None:
    """Gymnasium's own counts of lengths and returns equal sums made by hand."""
    env = wrappers.RecordEpisodeStatistics(pearl_marl.make_vec("Drift", n), buffer_length=10 * n)
    env.reset(seed=0)
    generator = np.random.default_rng(0)
    length, total = np.zeros(n, int), np.zeros(n)
    lengths: list[int] = []
    totals: list[float] = []
    for _ in range(30):
        _, rewards, terminations, truncations, infos = env.step(generator.integers(5, size=n))
        ended = terminations | truncations
        length += 1
        total += rewards
        if ended.any():
            np.testing.assert_array_equal(infos["_final_obs"], ended)
            np.testing.assert_array_equal(infos["_episode"], ended)
            np.testing.assert_array_equal(infos["episode"]["l"][ended], length[ended])
            np.testing.assert_allclose(infos["episode"]["r"][ended], total[ended], rtol=1e-4, atol=1e-3)
            lengths += length[ended].tolist()
            totals += total[ended].tolist()
            length[ended], total[ended] = 0, 0
    assert len(lengths) >= 2 * n
    assert list(env.length_queue) == lengths
    np.testing.assert_allclose(env.return_queue, totals, rtol=1e-4, atol=1e-3)
    env.close()


@pytest.mark.parametrize("n", [50, 43008])
def test_wrappers_in_same_step_mode(toys: None, n: int) -> None:
    plain = pearl_marl.make_vec("Drift", n)
    scaled = wrappers.TransformReward(pearl_marl.make_vec("Drift", n), lambda r: 2 * r + 1)
    clipped = wrappers.ClipReward(pearl_marl.make_vec("Drift", n), -1, 1)
    shifted = wrappers.TransformAction(pearl_marl.make_vec("Drift", n), lambda action: action - 2)
    normal = wrappers.NormalizeReward(pearl_marl.make_vec("Drift", n))
    envs = [plain, scaled, clipped, normal, shifted]
    for env in envs:
        env.reset(seed=0)
    generator = np.random.default_rng(0)
    for _ in range(14):
        actions = generator.integers(5, size=n)
        steps = [env.step(actions + 2 * (env is shifted)) for env in envs]
        obs, rewards, terminations, truncations, infos = steps[0]
        np.testing.assert_allclose(steps[1][1], 2 * rewards + 1)
        np.testing.assert_array_equal(steps[2][1], np.clip(rewards, -1, 1))
        assert np.isfinite(steps[3][1]).all()
        for step in steps[1:]:
            np.testing.assert_array_equal(step[0], obs)
            np.testing.assert_array_equal(step[2], terminations)
            np.testing.assert_array_equal(step[3], truncations)
            assert ("final_obs" in step[4]) == ("final_obs" in infos)
    assert (terminations | truncations).any()
    for env in envs:
        env.close()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED], ids=lambda m: m.name)
def test_flattened_observations(mode: AutoresetMode) -> None:
    """One-hot. Gymnasium 1.4's own observation wrappers refuse SAME_STEP."""
    plain, base = (
        pearl_marl.make_vec("CliffWalking", 20, autoreset_mode=mode, max_cycles=3) for _ in range(2)
    )
    flat = wrappers.FlattenObservation(base)
    np.testing.assert_array_equal(flat.reset(seed=0)[0].argmax(1), plain.reset(seed=0)[0])
    generator = np.random.default_rng(0)
    for t in range(7):
        actions = generator.integers(4, size=20)
        a, b = plain.step(actions), flat.step(actions)
        assert b[0].shape == (20, 48)
        np.testing.assert_array_equal(b[0].argmax(1), a[0])
        if mode is AutoresetMode.DISABLED and t % 3 == 2:
            plain.reset(options={"reset_mask": np.ones(20, bool)})
            flat.reset(options={"reset_mask": np.ones(20, bool)})
    flat.close()


def against_gymnasium(mode: AutoresetMode, wrap: Any, n: int = 12, limit: int = 7) -> int:
    """Step a wrapped environment and Gymnasium's own, wrapped alike; return how many episodes ended."""
    theirs = gymnasium.make_vec(
        "CliffWalking-v1",
        num_envs=n,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        max_episode_steps=limit,
    )
    ours = wrap(pearl_marl.make_vec("CliffWalking", n, autoreset_mode=mode, max_cycles=limit))
    theirs = wrap(theirs)
    np.testing.assert_array_equal(ours.reset(seed=0)[0], theirs.reset(seed=0)[0])
    assert ours.single_observation_space == theirs.single_observation_space
    generator, ends = np.random.default_rng(0), 0
    for _ in range(40):
        actions = generator.integers(4, size=n)
        mine, other = ours.step(actions), theirs.step(actions)
        for a, b in zip(mine[:4], other[:4], strict=True):
            np.testing.assert_allclose(np.asarray(a, float), np.asarray(b, float), rtol=1e-5, atol=1e-6)
        ended = mine[2] | mine[3]
        ends += int(ended.sum())
        for key in ("_final_obs", "_episode", "final_obs", "episode"):
            assert (key in mine[4]) == (key in other[4]), key
        for slot in np.flatnonzero(mine[4].get("_final_obs", [])):
            np.testing.assert_array_equal(mine[4]["final_obs"][slot], other[4]["final_obs"][slot])
        if "episode" in mine[4]:
            for key in ("r", "l"):
                np.testing.assert_array_equal(mine[4]["episode"][key], other[4]["episode"][key])
        if mode is AutoresetMode.DISABLED and ended.any():
            # A dict each: a wrapper takes the mask out.
            after = [env.reset(options={"reset_mask": ended.copy()})[0] for env in (ours, theirs)]
            np.testing.assert_array_equal(*after)
    theirs.close()
    ours.close()
    return ends


MODES = {mode.name: mode for mode in AutoresetMode}


@pytest.mark.parametrize(
    ("wrap", "modes"),
    [
        pytest.param(wrappers.RecordEpisodeStatistics, MODES, id="RecordEpisodeStatistics"),
        pytest.param(wrappers.FlattenObservation, ["NEXT_STEP", "DISABLED"], id="FlattenObservation"),
        pytest.param(
            lambda env: wrappers.TransformObservation(
                wrappers.FlattenObservation(env), lambda obs: obs * 2 - 1
            ),
            ["NEXT_STEP", "DISABLED"],
            id="TransformObservation",
        ),
        pytest.param(
            lambda env: wrappers.NormalizeObservation(wrappers.FlattenObservation(env)),
            ["NEXT_STEP"],
            id="NormalizeObservation",
        ),
        pytest.param(wrappers.NormalizeReward, MODES, id="NormalizeReward"),
        pytest.param(lambda env: wrappers.TransformReward(env, np.sqrt), MODES, id="TransformReward"),
        pytest.param(lambda env: wrappers.ClipReward(env, -5, 0), MODES, id="ClipReward"),
        pytest.param(
            lambda env: wrappers.TransformAction(env, lambda actions: 3 - actions),
            MODES,
            id="TransformAction",
        ),
    ],
)
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.filterwarnings("ignore:invalid value encountered in sqrt")
def test_gymnasiums_wrappers_do_the_same_as_around_its_own(wrap: Any, modes: Any, mode: str) -> None:
    if mode not in modes:
        with pytest.raises((AssertionError, ValueError)):  # Gymnasium's, which refuses its own too
            wrap(pearl_marl.make_vec("CliffWalking", 3, autoreset_mode=MODES[mode]))
        return
    assert against_gymnasium(MODES[mode], wrap) > 24


def test_dict_infos_to_list(toys: None) -> None:
    env = wrappers.DictInfoToList(pearl_marl.make_vec("Drift", 5, max_cycles=2))
    env.reset(seed=0)
    env.step([0] * 5)
    *_, infos = env.step([0] * 5)
    assert len(infos) == 5
    assert all("final_obs" in info for info in infos)


@pytest.mark.parametrize("wrap", [lambda env: env, clip_reward_v0])
def test_random_numbers_are_those_of_gymnasium(wrap: Any) -> None:
    env = wrap(pearl_marl.make_vec("CartPole", 2))
    env.reset(seed=7)
    assert env.np_random_seed == 7
    assert env.np_random.integers(1 << 30) == np.random.default_rng(7).integers(1 << 30)
    assert env.np_random_seed == 7
    before = env.np_random
    env.reset()
    assert env.np_random is before


class TestTimeLimit:
    @pytest.mark.parametrize("wrap", [lambda env: env, lambda env: frame_stack_v1(clip_reward_v0(env), 2)])
    @pytest.mark.parametrize("mode", AutoresetMode)
    def test_assigning_it(self, wrap: Any, mode: AutoresetMode) -> None:
        env = wrap(pearl_marl.make_vec("MountainCar", 2, autoreset_mode=mode))
        assert env.max_cycles == env.unwrapped.max_cycles == 200
        env.reset(seed=0)
        env.max_cycles = 2
        assert env.max_cycles == env.unwrapped.device.config.limit == 2
        assert [env.step([1, 1])[3].tolist() for _ in range(2)] == [[False] * 2, [True] * 2]
        env.max_cycles = None
        assert env.max_cycles == 200
        for bad in (-1, 0.5, "3", True):
            with pytest.raises(ArgumentError, match="max_cycles"):
                env.max_cycles = bad
        assert env.max_cycles == 200

    @pytest.mark.parametrize(
        ("before", "after", "ends"),
        [
            # Episodes under way count from their beginning, and one that is too long ends at once.
            (10, 4, [4, 8]),
            (10, 2, [4, 6, 8]),
            # Nobody has counted where there was no limit.
            (0, 4, [7]),
            (10, 0, []),
        ],
    )
    @pytest.mark.parametrize("device", ["native", "reference"])
    def test_what_it_counts_from(self, device: str, before: int, after: int, ends: list[int]) -> None:
        for make in (pearl_marl.make_vec, pearl_marl.parallel_env):
            env: Any = make("MountainCar", 1, max_cycles=before, device=device)
            env.reset(seed=0)
            seen = []
            for step in range(1, 9):
                if step == 4:
                    env.max_cycles = after
                if env.step_batch([1]).truncations[0]:
                    seen.append(step)
            assert seen == ends

    @pytest.mark.parametrize("name", ["max_episode_steps", "max_steps", "time_limit"])
    @pytest.mark.parametrize("make", [pearl_marl.make_vec, pearl_marl.parallel_env, pearl_marl.raw_env])
    def test_other_names_for_it(self, make: Any, name: str) -> None:
        with pytest.raises(ArgumentError, match=f"unknown argument '{name}', did you mean 'max_cycles'"):
            make("Taxi", **{name: 5})
        if make is pearl_marl.make_vec:
            with pytest.raises(ArgumentError, match="did you mean 'max_cycles'"):
                gymnasium.make_vec("Pearl/Taxi-v0", num_envs=2, **{name: 5})


DEVICES: dict[str, Any] = {
    "native": devices.Native,
    "two threads": lambda: devices.Native(2),
    "reference": devices.Reference,
    "sharded": lambda: devices.Sharded(["native", "native"]),
    "lockstep": lambda: devices.Lockstep("native"),
}


class TestActionsOfSlotsThatReset:
    """In NEXT_STEP mode they are ignored, as Gymnasium's own environments do."""

    @pytest.mark.parametrize("wrap", [lambda env: env, lambda env: sticky_actions_v0(env, 0.5)])
    @pytest.mark.parametrize("device", DEVICES.values(), ids=DEVICES)
    @pytest.mark.parametrize(
        ("name", "good", "bad"),
        [("CartPole", 1, 9), ("CartPole", 1, -1), ("Pendulum", [0.5], [99.0]), ("Pendulum", [0.5], [np.nan])],
    )
    def test_they_may_be_anything(self, name: str, good: Any, bad: Any, device: Any, wrap: Any) -> None:
        env, twin = (
            wrap(pearl_marl.make_vec(name, 4, autoreset_mode="NextStep", device=device())) for _ in range(2)
        )
        for one in (env, twin):
            one.reset(seed=0)
            one.max_cycles = 2
            one.step(np.array([good] * 4))
            one.reset_slots(np.array([False, True, False, True]))
            one.step(np.array([good] * 4))  # the last of slots 0 and 2
        given = np.array([bad, good, bad, good])
        before = given.copy()
        for mine, other in zip(env.step(given)[:4], twin.step(np.array([good] * 4))[:4], strict=True):
            np.testing.assert_array_equal(mine, other)
        np.testing.assert_array_equal(given, before)
        with pytest.raises(ActionError, match=r"agent_0: action .* is out of range"):
            env.step(given)  # they have begun, and act

    @pytest.mark.parametrize("kind", [list, tuple, torch.as_tensor])
    def test_in_any_container(self, kind: Any) -> None:
        env = pearl_marl.make_vec("CartPole", 3, autoreset_mode="NextStep", max_cycles=1)
        env.reset(seed=0)
        env.step([0, 0, 0])
        env.step(kind(np.array([9, 9, 9])))
        with pytest.raises(ActionError, match="agent_0"):
            env.step(kind(np.array([9, 9, 9])))

    def test_what_is_no_action_at_all(self) -> None:
        env = pearl_marl.make_vec("CartPole", 2, autoreset_mode="NextStep", max_cycles=1)
        env.reset(seed=0)
        env.step([0, 0])
        env.send([7, 7])
        assert env.recv()[1].tolist() == [0, 0]
        env.step([0, 0])
        for given in (3, [0], None, "ab", {"agent_0": 0}, [0.5, 0.5, 0.5], np.zeros((2, 2))):
            with pytest.raises(ActionError):
                env.step(given)
        assert env.step([None, "?"])[1].tolist() == [0, 0]

    def test_the_others_are_checked(self) -> None:
        env = pearl_marl.make_vec("CartPole", 3, autoreset_mode="NextStep", max_cycles=2)
        env.reset(seed=0)
        env.step([0] * 3)
        env.reset_slots(np.array([False, True, False]))
        env.step([0] * 3)
        state = env.device.state()
        with pytest.raises(ActionError, match="agent_1: action 5 is out of range"):
            env.step([8, 5, 8])
        np.testing.assert_array_equal(env.device.state(), state)
