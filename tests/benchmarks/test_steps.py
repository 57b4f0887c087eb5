"""`pearl bench steps`: what it says it counts, and that every contender plays by the rules."""

from __future__ import annotations

import json
import re
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl import get_spec
from pearl_marl.benchmark import peers, steps, tables
from pearl_marl.benchmark.measure import Contender, Game, UnavailableError, measure
from pearl_marl.cli import bench

from ..sampling import sampled
from ..toy_world import MEADOW

Pearl = Callable[..., tuple[int, str, str]]
PACKAGE = {
    "ConnectFour": "PettingZoo",
    "LevelBasedForaging": "lbforaging",
    "RobotWarehouse": "rware",
}


@pytest.fixture(autouse=True)
def no_simulator(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes a minute to build, and its own tests step it."""

    def refuse(*_: Any) -> None:
        raise UnavailableError("not in this test")

    monkeypatch.setattr(steps, "simulated", refuse)


def test_processes_of_a_peer_end_with_the_measurement() -> None:
    """Before the tests that use EnvPool: processes forked after those may crash."""
    by_name = {contender.name: contender for contender in peers.peers(get_spec("CartPole"), 2)}
    contender = by_name["Gymnasium AsyncVectorEnv"]
    made: list[Any] = []

    def make() -> Any:
        made.append(contender.make())
        return made[0]

    list(measure([Contender("async", "", 2, make)], rounds=1, seconds=0))
    assert made[0].envs.closed
    assert not any(process.is_alive() for process in made[0].envs.processes)


def test_a_peer_that_is_not_installed_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "minigrid", None)
    monkeypatch.delitem(sys.modules, "pearl_marl.envs.mini_grid_oracle", raising=False)
    contender = next(c for c in peers.peers(get_spec("MiniGridEmpty"), 2) if c.name.endswith("SyncVectorEnv"))
    with pytest.raises(UnavailableError, match="not installed: pip install minigrid"):
        contender.make()


@pytest.mark.parametrize("name", sampled(PACKAGE, ("ConnectFour", "LevelBasedForaging")))
def test_games_beside_envpool_and_their_package(pearl: Pearl, name: str) -> None:
    pytest.importorskip("envpool")
    pytest.importorskip("lbforaging")
    status, out, err = pearl("bench", "steps", name, "--n-agents", 8, "--rounds", 1, "--seconds", 0, "--json")
    assert status == 0, err
    result = json.loads(out)
    assert result["steps_of"].startswith("4 worlds of 2 agents: a step of a world is 2 agent-steps")
    masked = bool(get_spec(name).mask_fields)
    legal = "All agents take random legal actions, and choosing them is not timed."
    assert (result["actions"] == legal) == masked
    rows = {row["name"]: row for row in result["contenders"]}
    for timed in (
        "kernel only",
        "step_batch",
        "PettingZoo step, dict actions",
        "EnvPool, sync",
        PACKAGE[name],
    ):
        row = rows[timed]
        assert row["n"] == 8
        seconds = row["microseconds_per_step"] * 1e-6
        assert row["steps_per_second"] == pytest.approx(8 / seconds), "as many as there are agents"
    assert "Gymnasium SyncVectorEnv" not in rows
    assert "one agent each" in rows["Gymnasium VectorEnv step"]["unavailable"]
    assert [row["n"] for row in result["one_agent"]] == [2, 2], "a world"
    assert {"envpool", "lbforaging"} <= set(result["machine"]["versions"])


def test_what_is_counted_is_said(pearl: Pearl) -> None:
    status, out, err = pearl("bench", "steps", "ConnectFour", "--n-agents", 8, "--rounds", 1, "--seconds", 0)
    assert status == 0, err
    said = " ".join(out.split())
    assert "4 worlds of 2 agents: a step of a world is 2 agent-steps, even though they take turns." in said
    assert "choosing them is not timed" in said
    assert "One world of 2 agents: step_batch takes" in said


def test_only_whole_worlds(pearl: Pearl) -> None:
    status, _, err = pearl("bench", "steps", "ConnectFour", "--n-agents", 7)
    assert status == 2
    assert "6 and 8 fit" in err


def games(name: str, n: int) -> dict[str, Game]:
    """Return the contenders that choose actions, by their names."""
    made = {}
    for contender in steps.contenders(get_spec(name), n):
        try:
            step = contender.make()
        except UnavailableError:
            continue
        if isinstance(step, Game):
            made[contender.name] = step
    return made


@pytest.mark.parametrize("name", PACKAGE)
def test_everybody_takes_legal_actions(name: str) -> None:
    """Ours are refused if they are not; of EnvPool and the packages it is looked at what comes of them."""
    for game in games(name, 64).values():
        for _ in range(60):
            game.step(game.choose())


@pytest.mark.parametrize(
    ("name", "options"),
    [("SimpleSpread", {}), ("SimpleTag", {"num_good": 2}), ("SimpleTag", {"continuous_actions": True})],
)
def test_worlds_of_mpe_begin_again(
    monkeypatch: pytest.MonkeyPatch, name: str, options: dict[str, Any]
) -> None:
    """At its time limit a world of MPE2's loses its agents, and a step of none would cost nothing."""
    spec = get_spec(name).with_options(**options)
    package = {"SimpleSpread": "simple_spread", "SimpleTag": "simple_tag"}[name]
    module = pytest.importorskip(f"mpe2.{package}_v3")
    make, worlds = module.parallel_env, []
    monkeypatch.setattr(module, "parallel_env", lambda **wanted: worlds.append(make(**wanted)) or worlds[-1])
    contender = {one.name: one for one in peers.peers(spec, 3 * spec.agents)}["MPE2"]
    step = contender.make()
    for _ in range(spec.max_cycles):
        assert [len(world.agents) for world in worlds] == [spec.agents] * 3
        step()
    assert [len(world.agents) for world in worlds] == [spec.agents] * 3


def test_nobody_drops_a_disc_into_a_full_column_of_envpool() -> None:
    """Its games may come back in any order, and one that ended starts anew in its next step."""
    envpool = pytest.importorskip("envpool")
    envs = envpool.make("ConnectFour-v1", env_type="gymnasium", num_envs=64)
    seen: Counter[str] = Counter()

    class Watched:
        action_space = envs.action_space

        def step(self, actions: Any, worlds: Any) -> Any:
            assert not (~over & (boards[:, 0] >= 0)[np.arange(64), actions[np.argsort(worlds)]]).any()
            result = envs.step(actions, worlds)
            order = result[4]["env_id"]
            boards[order], over[order] = result[4]["board"], result[2]
            seen["ended"] += int(over.sum())
            return result

    boards, over = np.full((64, 6, 7), -1), np.zeros(64, np.bool_)
    game = peers._envpool_worlds(Watched(), *envs.reset())
    for _ in range(60):
        game.step(game.choose())
    assert seen["ended"]


def test_choosing_is_not_timed() -> None:
    log: list[str] = []
    game = Game(lambda: log.append("choose"), lambda actions: log.append("step"))
    contender = Contender("game", "", 2, lambda: game, wait=lambda: log.append("wait"))
    list(measure([contender], rounds=2, seconds=0))
    assert log == ["choose", "wait", "step", "wait"] * 4
    assert len(contender.seconds) == 2


@pytest.mark.parametrize(("name", "package"), [("Overcooked", "overcooked-ai"), ("CoinGame", "JaxMARL")])
def test_packages_that_need_an_environment_of_their_own(
    monkeypatch: pytest.MonkeyPatch, name: str, package: str
) -> None:
    """Nobody has to have them; and one that steps all worlds at once is not held to a thousand."""
    module = {"overcooked-ai": "overcooked_ai_py", "JaxMARL": "jaxmarl"}[package]
    monkeypatch.setitem(sys.modules, f"{module}.mdp.actions", None)
    monkeypatch.setitem(sys.modules, module, None)
    by_name = {contender.name: contender for contender in peers.peers(get_spec(name), 8000)}
    assert by_name[package].n == {"overcooked-ai": 1024, "JaxMARL": 8000}[package]
    with pytest.raises(UnavailableError, match=rf"pip install {package} \(\w+ is missing\)"):
        by_name[package].make()


def test_what_envpool_has_of_ours_is_a_peer() -> None:
    """Under whatever id; its games of Atari are others."""
    envpool = pytest.importorskip("envpool")

    ours = {name.lower(): name for name in pearl_marl.list_envs()}
    atari = {f"{name}-v5" for name in ours.values()}
    found = set()
    for known in set(envpool.list_all_envs()) - atari:
        theirs = known.rpartition("/")[2].replace("-", "").lower()
        found |= {name for own, name in ours.items() if theirs.startswith(own)}
    assert {"MiniGridEmpty", "Minesweeper", "Othello", "Snake"} <= found
    for name in found:
        spec = get_spec(name)
        peers.envpool_of(spec, 4 * spec.agents)


@pytest.mark.parametrize("name", ["MiniGridEmpty", "Minesweeper", "Othello"])
def test_envpool_under_another_name(name: str) -> None:
    pytest.importorskip("envpool")
    contender = peers.peers(get_spec(name), 4)[0]
    step = contender.make()
    if isinstance(step, Game):
        step.step(step.choose())
    else:
        step()


def test_peers_begin_again_when_they_end() -> None:
    class Counting:
        left, begun = 0, 0

        def reset(self) -> None:
            self.left, self.begun = 3, self.begun + 1

        def step(self, action: int) -> tuple[Any, ...]:
            assert (action, self.left > 0) == (7, True)
            self.left -= 1
            return None, 0.0, self.left == 0, False, {}

    envs = [Counting(), Counting()]
    for env in envs:
        env.reset()
    for _ in range(7):
        peers._one_by_one(envs, [7, 7])
    assert [env.begun for env in envs] == [3, 3]


def test_other_worlds_have_no_peers() -> None:
    (only,) = peers.peers(MEADOW, 8)
    assert only.name == "EnvPool, sync"
    pytest.importorskip("envpool")
    with pytest.raises(UnavailableError, match="EnvPool has no Meadow"):
        only.make()


def test_growth(pearl: Pearl, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every environment at every size, in the order of the table."""
    from pearl_marl.benchmark import growth

    monkeypatch.setattr(bench, "growth", lambda rounds: growth.growth(rounds, (64, 128)))
    status, out, _ = pearl("bench", "growth", "--rounds", 1, "--json")
    assert status == 0
    points = json.loads(out)["points"]
    assert [(p["subject"], p["n_agents"]) for p in points] == [
        (subject, n) for subject in growth.SUBJECTS for n in (64, 128)
    ]
    assert all(p["step"] > 0 and p["write"] > 0 for p in points)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (["CartPole", "--json"], ["steps", "CartPole", "--json"]),
        ([], ["steps"]),
        (["--all"], ["steps", "--all"]),
        (["CartPole", "--training", "--quick"], ["training", "CartPole", "--quick"]),
        (["--growth"], ["growth"]),
    ],
)
def test_old_forms_work_and_name_the_new(
    old: list[str], new: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert bench.current(old) == new
    assert f"use `pearl {' '.join(['bench', *new])}`" in capsys.readouterr().err
    assert bench.current(new) == new
    assert capsys.readouterr().err == ""


ROOT = Path(__file__).parents[2]


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split("|")]


def measured_tables() -> list[list[list[str]]]:
    """Return the measured tables of the README: the cells of their rows, headings and rules first."""
    text = (ROOT / "README.md").read_text().partition("## How fast")[2].partition("## Install")[0]
    return [[cells(line) for line in block.splitlines()] for block in re.findall(r"(?:^\|.*\n)+", text, re.M)]


def timed(name: str, rate: float) -> Contender:
    return Contender(name, "what", 8, lambda: lambda: None, seconds=[8 / rate])


PEERS = [timed("step_batch", 1e6), timed("kernel only", 2e9), timed("EnvPool, sync", 1e3)]


def test_the_readme_has_the_tables_of_the_commands() -> None:
    """Their columns, and the names of their rows; the figures are of another day."""
    training = pytest.importorskip("pearl_marl.benchmark.training", exc_type=ImportError)
    one, _, trainings = measured_tables()  # that of policy steps is put together from several commands
    for table, made in (
        (one, tables.steps_table(PEERS)),
        (trainings, tables.training_table([])),
    ):
        assert table[:2] == [cells(line) for line in made.markdown().splitlines()[:2]]
    known = {c.name: c.counts for c in steps.contenders(get_spec("CliffWalking"), 8)}
    assert {row[0]: row[-1] for row in one[2:]}.items() <= known.items()
    trainers = {trainer.name for trainer in training.TRAINERS}
    assert {row[0].rpartition(": ")[2] for row in trainings[2:]} <= trainers


def test_every_environment_has_its_best_peer() -> None:
    rows = [*PEERS, timed("MinAtar", 2e4), timed("Gymnasium SyncVectorEnv", 1e4)]
    *_, line = tables.environments_table([("Seaquest", rows)]).markdown().splitlines()
    assert line == "| Seaquest | 2 G | 1 M | 1 k | 1,000 | 20 k, MinAtar | 50 |"


def test_trainings_of_each_task_are_one_below_the_other() -> None:
    row = {"task": "PPO CartPole", "contender": "PEARL-MARL", "agent_steps_per_second": 810e3, "seeds": 3}
    row |= {"seconds_to_goal": 0.089, "reached": 2, "rate_ratio": [1, 1, 1], "time_ratio": [1, 1, 1]}
    other = row | {"contender": "it", "rate_ratio": [9.04, 8.8, 9.3], "reached": 3, "time_ratio": None}
    lost = {"task": "PPO CartPole", "contender": "PufferLib", "missing": "why"}
    _, _, ours, theirs = tables.training_table([row, other, lost]).markdown().splitlines()
    assert ours == "| **PPO CartPole**: PEARL-MARL | 810 k | | 0.089, 2 of 3 | |"
    assert theirs == "| it | 810 k | 9.04 (8.8 to 9.3) | 0.089 | |"
