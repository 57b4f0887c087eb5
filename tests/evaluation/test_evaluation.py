"""`pearl eval`: episodes, confidence, digests, latencies, and its report."""

from __future__ import annotations

import itertools
import json
import re
import time
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from pearl_marl import get_spec
from pearl_marl.devices import BatchConfig, Cuda, Device, Lockstep, Native, by_name
from pearl_marl.devices.simulator.simulation import Simulation
from pearl_marl.devices.transport import STAGES
from pearl_marl.errors import ActionError, ArgumentError, LockstepError, OrderError
from pearl_marl.evaluation.run import LIMIT, Evaluation, interval, spread
from pearl_marl.policies.loading import Policy, load_policy, table_policy
from pearl_marl.spec import EnvSpec
from pearl_marl.testing.case import make_device

from ..devices.boards import OwnBoard
from ..devices.broken import Flips

DEVICES: dict[str, Callable[[EnvSpec], Device]] = {
    "rtl": lambda spec: make_device("rtl", spec, N),
    "xdma": lambda spec: OwnBoard(3),
}
"""Every one of them must do what the native one does."""

CARDS = get_spec("Blackjack")
N = 70


def hit_below_17() -> Policy:
    table = np.zeros((32, 11, 2, 2))
    table[:17, ..., 1] = 1
    return table_policy(table, CARDS)


def along_the_cliff() -> Policy:
    """Up at the start, to the right along the cliff, down above the goal."""
    table = np.zeros((48, 4))
    table[:, 1] = 1
    table[36, 0] = table[[11, 23, 35], 2] = 2
    return table_policy(table, get_spec("CliffWalking"))


def lean(observations: np.ndarray) -> np.ndarray:
    return (observations[:, 2] + 0.3 * observations[:, 3] > 0).astype(np.int64)


POLICIES: dict[str, Policy] = {
    "CliffWalking": along_the_cliff(),
    "CartPole": lean,
    "Blackjack": hit_below_17(),
}


def done(*arguments: Any, **options: Any) -> Evaluation:
    evaluation = Evaluation(*arguments, **options)
    assert sum(1 for _ in evaluation.run()) == evaluation.episodes
    return evaluation


@pytest.mark.parametrize("episodes", [1, 5, 6, 29])
def test_the_first_episodes_of_every_agent_count(episodes: int) -> None:
    n, policy = 6, hit_below_17()
    evaluation = done(CARDS, policy, n, episodes=episodes, seed=2)
    # By hand: all episodes of every agent, in order.
    device = Native().open(BatchConfig(spec=CARDS, n_envs=n))
    obs = device.reset(seed=2)
    found: list[list[tuple[float, int]]] = [[] for _ in range(n)]
    sums, ages = [0.0] * n, [0] * n
    for _ in range(evaluation.steps):
        step = device.step(policy(obs))
        obs = step.obs
        for i in range(n):
            sums[i] += float(step.rewards[i])
            ages[i] += 1
            if step.ended[i]:
                found[i].append((sums[i], ages[i]))
                sums[i], ages[i] = 0.0, 0
    quotas = [episodes // n + (i < episodes % n) for i in range(n)]
    expected = [episode for mine, quota in zip(found, quotas, strict=True) for episode in mine[:quota]]
    assert list(zip(evaluation.returns, evaluation.lengths, strict=True)) == expected
    assert any(len(mine) == quota for mine, quota in zip(found, quotas, strict=True) if quota), (
        "no step too many"
    )


def test_the_best_policy_along_the_cliff() -> None:
    summary = done(get_spec("CliffWalking"), along_the_cliff(), 5, episodes=12).summary()
    assert (summary["return"]["mean"], summary["length"]["mean"]) == (-13, 13)
    assert (summary["steps"], summary["episodes"], summary["truncated"]) == (3 * 13, 12, 0)
    assert summary["max_cycles"] == LIMIT, "CliffWalking has no limit of its own"


def test_time_limits() -> None:
    spec = get_spec("CliffWalking")
    up = table_policy(np.eye(4)[np.zeros(48, int)], spec)  # never gets anywhere
    summary = done(spec, up, 3, max_cycles=7).summary()
    assert (summary["truncated"], summary["length"]["max"], summary["max_cycles"]) == (3, 7, 7)
    assert done(get_spec("CartPole"), lean, 2).summary()["max_cycles"] == 500


def test_intervals() -> None:
    found = interval(np.array([1.0, 2.0, 3.0, 6.0]))
    half = 1.96 * np.std([1, 2, 3, 6], ddof=1) / 2
    assert (found["ci95_low"], found["ci95_high"]) == pytest.approx((3 - half, 3 + half))
    assert interval(np.array([4.0]))["ci95_low"] is None
    values = np.random.default_rng(0).exponential(2.0, (2000, 50))
    inside = [f["ci95_low"] < 2 < f["ci95_high"] for f in map(interval, values)]
    assert 0.90 < np.mean(inside) < 0.96, "a little less than 95 %: 50 skewed values are not quite normal"


def test_spreads_have_every_step_but_the_first() -> None:
    found = spread([1.0, *(k * 1e-6 for k in range(1, 101))])
    assert found["p50_us"] == pytest.approx(50.5)
    assert found["max_us"] == pytest.approx(100)
    assert sum(found["histogram"]["counts"]) == 100
    assert sum(spread([3e-6])["histogram"]["counts"]) == 1


@pytest.mark.parametrize("env_id", POLICIES)
@pytest.mark.parametrize("device", DEVICES)
def test_devices_have_one_digest(device: str, env_id: str) -> None:
    spec = get_spec(env_id)
    run = [
        done(spec, POLICIES[env_id], N, made, episodes=100, seed=5)
        for made in (Native(), DEVICES[device](spec))
    ]
    theirs, ours = (evaluation.summary() for evaluation in run)
    for key in ("digest", "return", "length", "steps", "truncated"):
        assert ours[key] == theirs[key]
    np.testing.assert_array_equal(run[0].returns, run[1].returns)
    assert [row["stage"] for row in ours["latency"]] == ["policy", *STAGES]
    assert ours["clock_cycles"]["max"] > 0
    assert [row["stage"] for row in theirs["latency"]] == ["policy", "pack", "compute"]


def digest(device: Device, **options: Any) -> str:
    found: str = done(CARDS, hit_below_17(), 20, device, **options).summary()["digest"]
    return found


@pytest.mark.parametrize("name", ["ConnectFour", "LevelBasedForaging"])
def test_policies_of_games_are_shown_masks(name: str) -> None:
    """And every agent counts its episodes; the reference comes to the same."""
    digests = set()
    for device in ("native", "reference"):
        evaluation = Evaluation(get_spec(name), load_policy("random", get_spec(name)), 8, device, episodes=12)
        for _ in evaluation.run():
            pass
        digests.add(evaluation.summary()["digest"])
        assert len(evaluation.returns) == 12
    assert len(digests) == 1


def test_masked_actions_of_a_policy_are_refused() -> None:
    spec = get_spec("ConnectFour")
    evaluation = Evaluation(spec, lambda _, masks: np.zeros(len(masks), np.uint8), 8)
    with pytest.raises(ActionError, match="action 0 is masked"):
        list(evaluation.run())


def test_a_digest_sees_every_word() -> None:
    assert digest(Native()) == digest(Native(2))
    others = [digest(Native(), seed=1), digest(Native(), max_cycles=1)]
    others += [
        digest(Flips(field, tick=1, slot=3)) for field in ("obs", "rewards", "terminations", "truncations")
    ]
    others += [digest(Flips("final_obs", tick=0, slot=slot)) for slot in range(20)]
    # Final observations count where a slot ended, and nowhere else.
    assert digest(Native()) not in others[:6]
    assert 1 < len(set(others[6:])) < 20


def test_stages_follow_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = get_spec("CliffWalking")
    device = make_device("rtl", spec, N).open(BatchConfig(spec=spec, n_envs=N))
    other = make_device("rtl", spec, N).open(BatchConfig(spec=spec, n_envs=N))
    seconds = device.timed()
    for each in (device, other):
        each.reset(seed=0)
    actions = np.zeros(N, np.uint8)
    device.step(actions)  # which writes the settings, too
    looks = itertools.count()
    monkeypatch.setattr(time, "perf_counter", lambda: next(looks))
    device.step(actions)
    assert seconds == dict.fromkeys(STAGES, 1)
    assert next(looks) == len(STAGES) + 1
    for _ in range(2):
        other.step(actions)
    for ours, theirs in zip(device.step(actions), other.step(actions), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert "_step" not in vars(other), "a device that nobody times is as it was"
    assert isinstance(other._protocol.transport, Simulation)
    device.close()
    other.close()


def test_in_lockstep() -> None:
    evaluation = done(CARDS, hit_below_17(), 20, Lockstep("native", "reference"))
    summary = evaluation.summary()
    assert summary["words_compared"] > 20 * evaluation.steps
    assert summary["digest"] == digest(Native())
    assert [row["stage"] for row in summary["latency"]] == ["policy", "pack", "compute"]
    with pytest.raises(LockstepError):
        done(CARDS, hit_below_17(), 20, Lockstep(Flips("rewards", tick=1, slot=3), "native"))
    wrong = Flips("elapsed", tick=evaluation.steps - 1, slot=3)
    with pytest.raises(LockstepError):  # the states are compared at the end, if not before
        done(CARDS, hit_below_17(), 20, Lockstep(wrong, "native", state_every=1000))


def test_a_device_that_keeps_its_results_as_tensors() -> None:
    """A policy is a function of NumPy arrays, wherever they come from."""
    pytest.importorskip("numba_cuda", reason="numba-cuda is not installed: pip install '.[cuda]'")
    pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
    assert digest(Cuda(results="torch")) == digest(Native())


def test_refused_evaluations() -> None:
    with pytest.raises(ArgumentError, match="the number of episodes is 0"):
        Evaluation(CARDS, hit_below_17(), 5, episodes=0)
    for episodes in (1.5, "3"):
        with pytest.raises(ArgumentError, match=f"the number of episodes is {episodes!r}"):
            Evaluation(CARDS, hit_below_17(), 5, episodes=episodes)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="the number of agents is 0"):
        Evaluation(CARDS, hit_below_17(), 0)
    with pytest.raises(ActionError, match="agent_0: action 7"):
        done(CARDS, lambda observations: np.full(len(observations), 7), 5)


class Checker(HTMLParser):
    """Holds a page to balanced tags, and collects its text."""

    EMPTY = ("meta", "br", "path", "use", "line")

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.text = ""
        self.feed(page)
        assert not self.open

    def handle_starttag(self, tag: str, attributes: Any) -> None:
        self.tags.append(tag)
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attributes: Any) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.EMPTY:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def test_pearl_eval(pearl: Any, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    np.save(tmp_path / "<q>.npy", np.zeros((32, 11, 2, 2)))
    out_folder = tmp_path / "new" / "folder"
    arguments = ("eval", "Blackjack", "--policy", tmp_path / "<q>.npy", "--n-agents", 30, "--episodes", 45)
    status, out, err = pearl(*arguments, "--lockstep", "--out", out_folder)
    assert status == 0, err
    result = json.loads((out_folder / "evaluation.json").read_text())
    assert result["digest"] in out
    assert "45 of 30 agents" in out
    assert "native is bit-exact with reference" in out
    assert (result["device"], result["lockstep"]) == ("native", "reference")
    page = Checker((out_folder / "evaluation.html").read_text())
    assert page.tags.count("svg") == 2
    for word in (result["digest"], "<q>.npy", "45 episodes", "pack (T1)", "return of an episode", "normal"):
        assert word in page.text
    plain = json.loads(pearl(*arguments, "--json")[1])
    assert plain["digest"] == result["digest"]
    assert plain["lockstep"] is None


def test_a_digest_is_not_cut(pearl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    narrow = Console(width=60)
    monkeypatch.setattr("pearl_marl.cli.eval.console", narrow)
    line = "eval", "CliffWalking", "--policy", "random", "--n-agents", 4
    _, out, _ = pearl(*line)
    digest = json.loads(pearl(*line, "--json")[1])["digest"]
    assert digest in "".join(re.findall("[0-9a-f]{8,}", out))


def test_without_matplotlib_the_figures_are_written(
    pearl: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    status, out, err = pearl("eval", "Blackjack", "--policy", "random", "--n-agents", 9, "--out", tmp_path)
    assert status == 0
    assert "No evaluation.html: drawing needs matplotlib" in err
    assert [path.name for path in tmp_path.iterdir()] == ["evaluation.json"]
    assert "digest" in out


def test_a_device_that_parts_from_the_reference(
    pearl: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(by_name._BY_NAME, "broken", lambda: Flips("rewards", tick=1, slot=3))
    arguments = ("eval", "Blackjack", "--policy", "random", "--n-agents", 9, "--device", "broken")
    assert pearl(*arguments)[0] == 0, "nobody looks"
    status, out, err = pearl(*arguments, "--lockstep", "--out", tmp_path)
    assert (status, out) == (1, "")
    assert "step 1, slot 3: rewards is" in err
    (path,) = tmp_path.iterdir()
    assert f"pearl verify {path}" in err
    assert pearl("verify", path, "--device", "native")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["CliffWaking", "--policy", "random"], "did you mean 'CliffWalking'"),
        (["Blackjack"], "--policy"),
        (["Blackjack", "--policy", "greedy"], "there is no policy 'greedy'"),
        (["Blackjack", "--policy", "random", "--device", "gpu"], "no device 'gpu'"),
        (["Blackjack", "--policy", "random", "--episodes", "0"], "--episodes"),
        (["Blackjack", "--policy", "random", "--max-cycles", "-1"], "--max-cycles is -1"),
        (["Blackjack", "--policy", "random", "--seed", "-1"], "seed"),
    ],
)
def test_refused_calls(pearl: Any, arguments: list[str], says: str) -> None:
    status, out, err = pearl("eval", *arguments)
    assert (status, out) == (2, "")
    assert says in " ".join(err.split())


def test_an_out_that_is_a_file_is_refused_before_the_work(pearl: Any, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    status, _, err = pearl("eval", "Blackjack", "--policy", "random", "--out", tmp_path / "file")
    assert status == 2
    assert "--out" in err


@pytest.mark.parametrize(
    ("spec", "policy", "says"),
    [
        ("Blackjack", print, "spec is 'Blackjack'; it must be an EnvSpec"),
        (CARDS, "random", "policy is 'random'; it must be a function"),
    ],
)
def test_what_is_no_spec_or_policy(spec: Any, policy: Any, says: str) -> None:
    with pytest.raises(ArgumentError, match=says):
        Evaluation(spec, policy, 4)


def test_a_summary_of_nothing() -> None:
    with pytest.raises(OrderError, match=r"summary\(\) before run\(\)"):
        Evaluation(CARDS, load_policy("random", CARDS), 4).summary()


def test_a_policy_by_name() -> None:
    first, second = (done(CARDS, load_policy("random", CARDS, 4), 10).summary() for _ in range(2))
    assert first["digest"] == second["digest"]
