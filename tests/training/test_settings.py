"""Settings out of their range: one sentence that names setting, value and range, before any work."""

from __future__ import annotations

import dataclasses
import importlib
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pearl_marl import get_spec, register
from pearl_marl.errors import ArgumentError

from ..toy import LADDER

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
training = importlib.import_module("pearl_marl.training.run")

Pearl = Callable[..., tuple[int, str, str]]

SET = {
    "ppo": {
        "rollout_length=0": "an integer from 1 to",
        "epochs=0": "an integer from 1 to",
        "minibatch=0": "an integer from 1 to",
        "minibatch=-3": "an integer from 1 to",
        "minibatch=2.5": "an integer from 1 to",
        "minibatch=true": "an integer from 1 to",
        "width=0": "an integer from 1 to 16,384",
        "width=10000000": "an integer from 1 to 16,384",
        "learning_rate=0": "a number above 0 to 1",
        "learning_rate=NaN": "a number above 0 to 1",
        "learning_rate=Infinity": "a number above 0 to 1",
        "learning_rate=-1e999": "a number above 0 to 1",
        "learning_rate=high": "a number above 0 to 1",
        "discount=1.5": "a number from 0 to 1",
        "discount=-0.1": "a number from 0 to 1",
        "gae_lambda=NaN": "a number from 0 to 1",
        "clip=0": "a number above 0",
        "entropy=-1": "a number of at least 0",
        "entropy=Infinity": "a number of at least 0",
        "reward_scale=NaN": "a number above 0",
        "blocks=0": "an integer from 1 to",
        "blocks=2000": "1 to 512",
    },
    "pqn": {
        "rollout_length=0": "an integer from 1 to",
        "q_lambda=1.5": "a number from 0 to 1",
        "exploration_fraction=0": "a number above 0 to 1",
        "blocks=2000": "1 to 512",
        "memory=lstm": "one of none, gru",
    },
    "dqn": {
        "memory=0": "an integer from 1 to",
        "updates=0": "an integer from 1 to",
        "target_update=0": "an integer from 1 to",
        "warm_up=-1": "an integer from 0 to",
        "exploration_fraction=0": "a number above 0 to 1",
        "epsilon=2": "a number from 0 to 1",
    },
    "q-learning": {
        "learners=0": "an integer from 1 to",
        "learners=5": "it must divide n_agents, 43008",
        "learning_rate=0": "a number above 0 to 1",
        "epsilon=1.5": "a number from 0 to 1",
        "learning_rate_decay=-1": "a number of at least 0",
    },
}
PAGE = Path(__file__).parents[2] / "docs" / "training.md"
CASES = [(algorithm, given, words) for algorithm, cases in SET.items() for given, words in cases.items()]


def refused(pearl: Pearl, folder: Path, *arguments: Any) -> str:
    """Return the sentence with which a training is refused; it leaves no folder."""
    status, out, err = pearl("train", *arguments, "--out", folder / "run")
    assert (status, out) == (2, ""), err
    assert not (folder / "run").exists()
    (sentence,) = (
        err.split("\n\n")[-1].strip().splitlines()
    )  # below what the progress bar leaves, if it began
    assert sentence.startswith("pearl: ")
    return str(sentence)


def test_the_page_lists_every_setting_with_its_default() -> None:
    section = PAGE.read_text().partition("\n## Settings\n")[2].partition("\n## ")[0]
    tables = re.findall(r"^`([\w-]+)`.*:\n\n((?:\|.*\n)+)", section, re.MULTILINE)
    listed = {name: re.findall(r"^\| `(\w+)` \| (\S+) \|", table, re.MULTILINE) for name, table in tables}
    listed["self-play"] = listed["ppo"] + listed["self-play"]
    listed["vdn"] = [row for row in listed["pqn"] if row[0] != "rewards"] + listed["vdn"]
    listed["qmix"] = listed["vdn"] + listed["qmix"]
    assert listed.keys() | {"mappo"} == training.SETTINGS.keys()
    assert training.SETTINGS["mappo"] is training.SETTINGS["ppo"]
    for algorithm, rows in listed.items():
        kind = training.SETTINGS[algorithm]
        assert sorted(rows) == sorted((f.name, str(f.default)) for f in dataclasses.fields(kind)), algorithm


RENAMED = {
    "ppo": {"depth": "rollout_length", "trace": "gae_lambda", "chance": "temperature"},
    "dqn": {
        "refresh": "target_update",
        "explore_first": "epsilon",
        "explore_last": "final_epsilon",
        "exploring": "exploration_fraction",
        "chance": "evaluation_epsilon",
    },
    "q-learning": {"rate": "learning_rate", "fading": "learning_rate_decay"},
}


@pytest.mark.parametrize("algorithm", RENAMED)
def test_earlier_names_warn(algorithm: str) -> None:
    """For one version: the name of a setting says its successor, and does what it did."""
    names = RENAMED[algorithm]
    assert training.SETTINGS[algorithm].successors() == names
    for old, new in names.items():
        with pytest.warns(DeprecationWarning, match=f"the setting '{old}' is now '{new}'"):
            settings = training.settings_for(algorithm, "CliffWalking", {old: 1})
        assert settings == training.settings_for(algorithm, "CliffWalking", {new: 1})
        with pytest.raises(ArgumentError, match=f"'{new}' is given twice, also as '{old}': give it once"):
            training.settings_for(algorithm, "CliffWalking", {new: 1, old: 1})


@pytest.mark.parametrize("algorithm", training.SETTINGS)
def test_no_setting_has_the_earlier_name_of_another(algorithm: str) -> None:
    """A run's folder has names of either kind in one dict."""
    kind = training.SETTINGS[algorithm]
    assert kind.successors().keys().isdisjoint(kind.defaults())


def test_the_earlier_class_warns() -> None:
    q_learning = importlib.import_module("pearl_marl.training.q_learning")
    with pytest.warns(DeprecationWarning, match="Settings is now QLearningSettings"):
        old = q_learning.Settings
    with pytest.warns(DeprecationWarning, match="the setting 'rate' is now 'learning_rate'"):
        assert old(rate=0.25) == q_learning.QLearningSettings(learning_rate=0.25)
    with pytest.raises(AttributeError, match="no attribute 'Setting'"):
        _ = q_learning.Setting


def test_the_command_says_new_names(pearl: Pearl, tmp_path: Path) -> None:
    arguments = ("CliffWalking", "--algo", "q-learning", "--n-agents", 64, "--iterations", 1)
    status, _, err = pearl("train", *arguments, "--set", "rate=0.25", "--out", tmp_path)
    assert status == 0, err
    assert "pearl: the setting 'rate' is now 'learning_rate'" in err


@pytest.mark.parametrize(("algorithm", "given", "words"), CASES)
def test_what_is_set(pearl: Pearl, algorithm: str, given: str, words: str, tmp_path: Path) -> None:
    env = "CliffWalking" if algorithm == "q-learning" else "CartPole"
    sentence = refused(pearl, tmp_path, env, "--algo", algorithm, "--set", given)
    name, _, value = given.partition("=")
    read = {"NaN": "nan", "Infinity": "inf", "-1e999": "-inf", "true": "True"}
    read |= {word: repr(word) for word in ("high", "lstm")}
    shown = read.get(value, value)
    option = f"--{name.replace('_', '-')}" if name in training.OPTIONS else f"--set {name}"
    # What depends on another setting is told by the settings themselves.
    told = (f"{option} is {shown}; it must", f"setting '{name}' is {shown}; it must")
    assert any(words in sentence for words in told)
    assert words in sentence


@pytest.mark.parametrize("algorithm", SET)
@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--iterations", 0, "--iterations is 0; it must be an integer from 1 to"),
        ("--iterations", -1, "--iterations is -1; it must be an integer from 1 to"),
        ("--n-agents", 0, "--n-agents is 0; it must be an integer from 1 to 4,294,967,296"),
        (
            "--n-agents",
            5_000_000_000,
            "--n-agents is 5000000000; it must be an integer from 1 to",
        ),
        ("--seed", -1, "--seed is -1; it must be at least 0"),
        ("--seed", 2**63, "--seed is 9223372036854775808; it must be an integer from 0 to"),
        ("--evaluate-every", 0, "--evaluate-every is 0; it must be an integer of at least 1"),
        ("--evaluate-every", -5, "--evaluate-every is -5; it must be an integer of at least 1"),
        ("--goal", "nan", "--goal is nan; it must be a finite number"),
        ("--set", "depth", "--set is 'depth'; it must be NAME=VALUE"),
        ("--option", "depth", "--option is 'depth'; it must be NAME=VALUE"),
        ("--n-agents", 4_000_000_000, "GiB of memory, and this machine has"),
    ],
)
def test_options(pearl: Pearl, algorithm: str, option: str, value: Any, words: str, tmp_path: Path) -> None:
    env = "CliffWalking" if algorithm == "q-learning" else "CartPole"
    assert words in refused(pearl, tmp_path, env, "--algo", algorithm, option, value)


@pytest.mark.parametrize("given", [("--seed", 3), ("--set", "seed=3")])
def test_the_seed_can_be_given_in_two_ways(pearl: Pearl, given: tuple[str, Any], tmp_path: Path) -> None:
    arguments = ("CliffWalking", "--algo", "q-learning", "--n-agents", 64, "--iterations", 1)
    status, _, err = pearl("train", *arguments, *given, "--out", tmp_path)
    assert status == 0, err
    assert json.loads((tmp_path / "config.json").read_text())["settings"]["settings"]["seed"] == 3


def test_a_critic_of_worlds_takes_several_agents(pearl: Pearl, tmp_path: Path) -> None:
    said = refused(pearl, tmp_path, "CartPole", "--algo", "mappo", "--iterations", 1)
    assert "CartPole has one agent in a world, and mappo's critic sees several: use ppo" in said


def test_shards(pearl: Pearl, tmp_path: Path) -> None:
    assert "--shards is 0; it must be at least 1" in refused(pearl, tmp_path, "CartPole", "--shards", 0)


@pytest.mark.parametrize(
    ("algorithm", "given"),
    [
        ("ppo", {"rollout_length": 10**11}),
        ("pqn", {"n_agents": 2**22, "memory": "gru", "width": 1024, "chunk_length": 1}),
        ("dqn", {"memory": 10**11}),
        ("dqn", {"minibatch": 10**12}),
        ("q-learning", {"n_agents": 2**31, "learners": 2**31}),
    ],
)
def test_what_no_machine_can_hold_is_refused(algorithm: str, given: dict[str, Any]) -> None:
    settings = training.settings_for(algorithm, "CliffWalking", given)
    with pytest.raises(ArgumentError, match=r"takes at least .* GiB of memory, and this machine has .* GiB"):
        training.ALGORITHMS[algorithm](get_spec("CliffWalking"), "native", settings)


@pytest.mark.parametrize("algorithm", training.SETTINGS)
def test_settings_made_by_hand_are_checked_too(algorithm: str) -> None:
    with pytest.raises(ArgumentError, match=re.escape("'iterations' is 0; it must be an integer from 1")):
        training.SETTINGS[algorithm](iterations=0)


def test_one_step_to_learn_from_leaves_finite_weights() -> None:
    """The last minibatch may be of one step, of which there is no deviation."""
    settings = training.settings_for("ppo", "CartPole", {"n_agents": 1, "rollout_length": 5, "minibatch": 2})
    trainer = training.ALGORITHMS["ppo"](get_spec("CartPole"), "native", settings)
    trainer.iterate()
    assert all(tensor.isfinite().all() for tensor in trainer.model.state_dict().values())


def test_the_setting_that_differs_is_named(pearl: Pearl, tmp_path: Path) -> None:
    arguments = (
        "CliffWalking",
        "--algo",
        "q-learning",
        "--n-agents",
        64,
        "--iterations",
        1,
        "--out",
        tmp_path,
    )
    assert pearl("train", *arguments, "--set", "learning_rate=0.25")[0] == 0
    status, _, err = pearl("train", *arguments, "--set", "learning_rate=0.5")
    assert status == 2
    assert f"{tmp_path} holds a run with learning_rate 0.25, not 0.5: " in err
    assert "give the same settings to go on with it, or another --out" in err
    longer = [100 if argument == 1 else argument for argument in arguments]
    assert (
        "holds a run with iterations 1, not 100: "
        in pearl("train", *longer, "--set", "learning_rate=0.25")[2]
    )


def test_without_out_a_run_is_named_after_what_it_is(
    pearl: Pearl, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status, _, err = pearl("train", "Taxi", "--algo", "q-learning", "--n-agents", 64, "--iterations", 1)
    assert status == 0, err
    assert (tmp_path / "out" / "Taxi-q-learning" / "policy.safetensors").exists()


@pytest.mark.usefixtures("toys")
def test_a_preset_is_of_the_spec(pearl: Pearl, tmp_path: Path) -> None:
    """The first says how an environment is learned; what is set by hand goes before it."""
    small = {"n_agents": 8, "iterations": 1, "rollout_length": 4}
    presets = {"pqn": {**small, "q_lambda": 0.5}, "ppo": small}
    register(replace(LADDER, name="LearnedLadder", presets=presets))
    assert training.settings_for("pqn", "LearnedLadder", {"q_lambda": 0.25}).q_lambda == 0.25
    status, _, err = pearl("train", "LearnedLadder", "--out", tmp_path / "run")
    assert status == 0, err
    config = json.loads((tmp_path / "run" / "config.json").read_text())["settings"]
    assert (config["algorithm"], config["settings"]["q_lambda"]) == ("pqn", 0.5)


@pytest.mark.parametrize(
    ("preset", "words"),
    [
        ({"qlambda": 0.5}, "qlambda: pqn has no such setting; did you mean 'q_lambda'?"),
        ({"q_lambda": 2}, "q_lambda is 2; it must be a number from 0 to 1"),
    ],
)
@pytest.mark.usefixtures("toys")
def test_a_preset_is_checked(preset: dict[str, Any], words: str) -> None:
    register(replace(LADDER, name="LearnedLadder", presets={"pqn": preset}))
    with pytest.raises(ArgumentError, match=re.escape(f"LearnedLadder's preset of {words}")):
        training.settings_for("pqn", "LearnedLadder", {})


@pytest.mark.usefixtures("toys")
def test_presets_are_by_algorithm() -> None:
    """An alias stands for its algorithm, and another name is refused, whichever is asked for."""
    register(replace(LADDER, name="LearnedLadder", presets={"ippo": {"clip": 0.3}}))
    assert training.settings_for("ppo", "LearnedLadder", {}).clip == 0.3
    register(replace(LADDER, name="OtherLadder", presets={"ppo": {}, "pnq": {}}))
    with pytest.raises(ArgumentError, match="OtherLadder has a preset of 'pnq'; possible are 'ppo', "):
        training.settings_for("ppo", "OtherLadder", {})
