"""``pearl verify``: verdicts, modes, replay files and refused calls."""

from __future__ import annotations

import base64
import json
import zlib
from pathlib import Path

import numpy as np
import pytest

from pearl_marl.cli.common import in_file_name
from pearl_marl.devices import Native, by_name
from pearl_marl.devices import replay as replaying
from pearl_marl.envs import get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.policies import integer_file
from pearl_marl.policies.integer_network import table_network

from ..devices.broken import Flips


class Broken(Flips):
    """Flips a reward of slot 6 at tick 2, whatever the size of the batch."""

    name = "broken"

    def __init__(self) -> None:
        super().__init__("rewards", tick=2, slot=6)

    def _step(self, actions):
        self.flip = ("rewards", 2, min(6, self.config.n_envs - 1), 0)
        return super()._step(actions)


class BrokenNeighbours(Native):
    """As a wrong packer would: an observation is wrong only among others."""

    name = "neighbours"

    def _step(self, actions):
        results = super()._step(actions)
        results.obs[5:6] += 1
        return results


@pytest.fixture
def broken(monkeypatch):
    for device in (Broken, BrokenNeighbours):
        monkeypatch.setitem(by_name._BY_NAME, device.name, device)


def test_the_native_device_is_exact(pearl):
    status, out, err = pearl("verify", "CliffWalking", "--n-agents", 300, "--steps", 320)
    assert status == 0, err
    assert "native is bit-exact with reference over 96,000 agent-steps" in out
    assert out.count("bit-exact") == 9
    for mode in ("same-step", "next-step"):
        for starts in ("random", "stored"):
            assert sum(mode in line and starts in line for line in out.splitlines()) == 2
    assert "Warning" not in err


def test_json_and_the_modes(pearl):
    out = pearl("verify", "CliffWalking", "--n-agents", 40, "--steps", 83, "--json")[1]
    result = json.loads(out)
    assert result["exact"] is True
    assert result["agent_steps"] == 40 * 83
    assert sum(mode["steps"] for mode in result["modes"]) == 83
    modes = {(m["autoreset_mode"], m["initial_states"], m["max_cycles"] > 0) for m in result["modes"]}
    assert len(modes) == len(result["modes"]) == 8
    assert all(mode["truncated"] for mode in result["modes"] if mode["max_cycles"])
    assert result["episodes"] == sum(mode["episodes"] for mode in result["modes"]) > 0
    assert result["words"] == sum(mode["words"] for mode in result["modes"]) > 40 * 83 * 4


def test_options_narrow_the_modes(pearl):
    arguments = ("--autoreset-mode", "next-step", "--initial-states", "stored", "--max-cycles", "7")
    out = pearl("verify", "CliffWalking", "--n-agents", 40, "--steps", 20, "--json", *arguments)[1]
    (mode,) = json.loads(out)["modes"]
    assert (mode["autoreset_mode"], mode["initial_states"], mode["max_cycles"]) == ("next-step", "stored", 7)
    assert (mode["steps"], mode["exact"]) == (20, True)


def test_options_of_the_environment(pearl):
    arguments = ("--option", "is_slippery=true", "--n-agents", 40, "--steps", 20, "--json")
    assert json.loads(pearl("verify", "CliffWalking", *arguments)[1])["options"] == {"is_slippery": True}


def test_episodes_really_end(pearl):
    """By themselves too, with nothing but random actions: the slots keep theirs for a while."""
    arguments = ("--max-cycles", 0, "--n-agents", 3000, "--steps", 200, "--json")
    result = json.loads(pearl("verify", "CliffWalking", *arguments)[1])
    assert result["episodes"] > 100
    assert not any(mode["truncated"] for mode in result["modes"])


def test_a_warning_where_no_episode_ended(pearl):
    status, _, err = pearl("verify", "CliffWalking", "--n-agents", 5, "--steps", 4, "--max-cycles", 0)
    assert status == 0
    assert "no episode ended" in err


@pytest.mark.usefixtures("broken")
def test_a_divergence_is_shown_written_replayed_and_mended(pearl, tmp_path, monkeypatch):
    arguments = ("--device", "broken", "--n-agents", 40, "--steps", 80, "--out", tmp_path / "new" / "folder")
    status, out, _ = pearl("verify", "CliffWalking", *arguments)
    assert status == 1
    assert "on broken differs from reference at step 2, slot 6" in out
    assert "slot 6: rewards is -1.0000001192092896, not -1.0" in out
    assert out.count("differs") == 2, "in that sentence, and of the mode in the table"
    assert out.count("not run") == 7
    (path,) = (tmp_path / "new" / "folder").iterdir()
    assert f"pearl verify {path}" in out
    value = json.loads(path.read_text())
    assert value["batch"]["n_agents"] == 1, "this slot differs by itself, so it is enough"
    assert path.stat().st_size < 2500

    status, out, _ = pearl("verify", path)
    assert status == 1
    assert "replayed here with 1 agent:" in out
    assert out.count("step 2, slot 6: rewards is -1.0000001192092896, not -1.0") == 2

    status, out, _ = pearl("verify", path, "--device", "native")
    assert status == 0
    assert "The divergence is gone: native agrees with reference" in out

    monkeypatch.setitem(by_name._BY_NAME, "broken", Native)  # the fixed one, under its own name
    status, out, _ = pearl("verify", path, "--json")
    assert (status, json.loads(out)["exact"], json.loads(out)["divergence"]) == (0, True, None)
    assert json.loads(out)["recorded"]["slot"] == 6


@pytest.mark.parametrize(
    "option",
    ["--n-agents 5", "--steps 3", "--seed 1", "--max-cycles 0", "--option x=1", "--out ."],
)
def test_a_replay_has_its_own_options(pearl, option):
    status, out, err = pearl("verify", "call.json", *option.split())
    assert (status, out) == (2, "")
    assert err.startswith("pearl: call.json is one recorded call: of the options, it takes --env, --device, ")


@pytest.mark.usefixtures("broken")
def test_the_whole_batch_where_the_slot_alone_is_right(pearl, tmp_path):
    arguments = ("--device", "neighbours", "--n-agents", 5000, "--steps", 80, "--out", tmp_path, "--json")
    status, out, _ = pearl("verify", "CliffWalking", *arguments)
    result = json.loads(out)
    assert (status, result["exact"], result["divergence"]["slot"]) == (1, False, 5)
    path = Path(result["replay"])
    assert json.loads(path.read_text())["batch"]["n_agents"] == 5000
    assert path.stat().st_size < 10_000
    status, out, _ = pearl("verify", path, "--json")
    replayed = json.loads(out)
    assert status == 1
    assert replayed["divergence"] == replayed["recorded"] == result["divergence"]


def test_the_states_after_the_last_step_are_compared(pearl, monkeypatch):
    """Also where that step is not one after which they would be anyway."""
    monkeypatch.setitem(by_name._BY_NAME, "late", lambda: Flips("elapsed", tick=4, slot=8))
    modes = ("--autoreset-mode", "same-step", "--initial-states", "random", "--max-cycles", 100)
    arguments = ("--device", "late", "--n-agents", 5000, "--steps", 5, "--json", *modes)
    status, out, _ = pearl("verify", "CliffWalking", *arguments)
    divergence = json.loads(out)["divergence"]
    assert (status, divergence["step"], divergence["field"]) == (1, 4, "elapsed")


@pytest.mark.usefixtures("broken")
def test_without_out_nothing_is_written(pearl, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, _ = pearl("verify", "CliffWalking", "--device", "broken", "--n-agents", 9, "--steps", 80)
    assert (status, list(tmp_path.iterdir())) == (1, [])
    assert "Wrote" not in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["CliffWalking", "--device", "gpu"], ["no device 'gpu'", "'native'", "'reference'"]),
        (["CliffWalking", "--reference", "gpu"], ["no device 'gpu'"]),
        (["CliffWaking"], ["no environment 'CliffWaking'", "did you mean 'CliffWalking'"]),
        (["CliffWalking", "--n-agents", "0"], ["--n-agents is 0"]),
        (["CliffWalking", "--max-cycles", "-1"], ["--max-cycles is -1"]),
        (["CliffWalking", "--steps", "0"], ["--steps"]),
        (["CliffWalking", "--seed", "-1"], ["seed"]),
        (["CliffWalking", "--autoreset-mode", "disabled"], ["same-step"]),
        (["CliffWalking", "--option", "slippery=1"], ["unknown argument 'slippery'", "is_slippery"]),
        (["nothing.json"], ["nothing.json cannot be read"]),
    ],
)
def test_refused_calls(pearl, arguments, words):
    status, out, err = pearl("verify", *arguments)
    assert (status, out) == (2, "")
    for word in words:
        assert word in " ".join(err.split())


def test_an_out_that_is_a_file_is_refused_before_the_work(pearl, tmp_path):
    (tmp_path / "file").write_text("")
    status, _, err = pearl("verify", "CliffWalking", "--n-agents", 5, "--out", tmp_path / "file")
    assert status == 2
    assert "--out" in err


def packed(data):
    return base64.b64encode(zlib.compress(data)).decode()


def edited(text, inside=None, **changes):
    value = json.loads(text)
    (value if inside is None else value[inside]).update(changes)
    return json.dumps(value)


def sealed(text):
    """Return a file's text with the right checksum, if it has one."""
    try:
        value = json.loads(text)
        if not isinstance(value, dict):
            return text
        value["checksum"] = replaying.checksum(value)
        return json.dumps(value)
    except (ValueError, RecursionError):
        return text


FOREIGN = {
    "no JSON": (lambda text: text[:100], "cannot be read as a replay file"),
    "bytes": (lambda text: "\x00\x01\x02", "cannot be read as a replay file"),
    "a list": (lambda text: "[1, 2]", "no replay file"),
    "other JSON": (lambda text: '{"format": "run"}', "no replay file"),
    "another version": (lambda text: text.replace('"version": 2', '"version": 1'), "version 1"),
    "another environment": (lambda text: text.replace("CliffWalking-v0", "CliffWaking-v0"), "CliffWaking"),
    "another version of it": (lambda text: text.replace("CliffWalking-v0", "CliffWalking-v9"), "v9"),
    "another size": (lambda text: text.replace('"n_agents": 1', '"n_agents": 2'), "n_agents"),
    "another mode": (lambda text: text.replace('"SameStep"', '"Someday"'), "damaged"),
    "a lost key": (lambda text: text.replace('"before"', '"after"'), "damaged: KeyError: 'before'"),
    "a damaged state": (lambda text: text.replace('"before": "eN', '"before": "eM'), "damaged"),
    "no differences": (lambda text: edited(text, "divergence", differences=[]), "it has no differences"),
    "a slot in words": (lambda text: edited(text, "divergence", slots="x"), "its slots is 'x'"),
    "no state": (lambda text: edited(text, "divergence", state_before=[1]), "its state_before is [1]"),
    "another slot": (lambda text: edited(text, "divergence", slot=7), "its slot 7"),
    "another call": (lambda text: edited(text, "divergence", call="frob"), "its call is 'frob'"),
    "no step": (lambda text: edited(text, "divergence", call="snapshot"), "has what that does not take"),
    "no actions": (lambda text: edited(text, actions=None), "it lacks what a step begins with"),
    "a seed": (lambda text: edited(text, seed=3), "a step has no seed"),
    "no action": (lambda text: edited(text, actions=packed(bytes([255]))), "agent_6: action 255 is out of"),
    "other actions": (lambda text: edited(text, actions=packed(bytes(7))), "longer than the 1 bytes"),
    "no actions at all": (lambda text: edited(text, actions=packed(b"")), "actions have shape (0,)"),
    "a bomb": (
        lambda text: edited(text, before=packed(bytes(1 << 26))),
        "its before is cut short, or longer",
    ),
    "bytes after": (lambda text: edited(text, before=packed(b"") + packed(b"")), "damaged"),
    "a mask": (lambda text: edited(text, mask=packed(bytes([2]))), "its mask is none of 1 worlds"),
    "a step": (lambda text: edited(text, "divergence", step=-1), "its step is -1"),
    "many slots": (lambda text: edited(text, "divergence", slots=10**30), "of 1 slots differ"),
    "codes": (lambda text: edited(text, "divergence", device="\x1b[2J"), "its device is '\\x1b[2J'"),
    "a difference": (
        lambda text: edited(text, "divergence", differences=[{"field": "x"}]),
        "one of its differences is {'field': 'x'}",
    ),
    "an action": (lambda text: edited(text, "divergence", action={"x": 1}), "its action is {'x': 1}"),
    "words": (lambda text: edited(text, "divergence", state_before={"row\n": 1}), "must be words by name"),
    "a number of agents": (lambda text: edited(text, "batch", n_agents=10**30), "the number of agents"),
    "many agents": (lambda text: edited(text, "batch", n_agents=2**32), "random draws can tell"),
    "options": (lambda text: edited(text, "batch", options={"self": 1}), "unknown argument 'self'"),
    "a device at a place": (
        lambda text: edited(text, "divergence", device="xdma:/tmp"),
        "it was recorded on xdma:/tmp: give --device xdma:/tmp",
    ),
    "deep": (lambda text: text[:-1] + ', "x": ' + "[" * 993 + "]" * 993 + "}", ""),
    "brackets": (lambda text: "[" * 100_000, "cannot be read as a replay file"),
    "no base64": (lambda text: text.replace('"before": "eN', '"before": "%%'), "damaged"),
}


@pytest.mark.usefixtures("broken")
@pytest.mark.parametrize("how", FOREIGN)
def test_foreign_replay_files(pearl, tmp_path, how):
    change, word = FOREIGN[how]
    arguments = ("--device", "broken", "--n-agents", 40, "--steps", 80, "--out", tmp_path, "--json")
    path = Path(json.loads(pearl("verify", "CliffWalking", *arguments)[1])["replay"])
    text = path.read_text()
    assert change(text) != text
    path.write_text(sealed(change(text)))
    status, out, err = pearl("verify", path)
    assert (status, out) == (2, "")
    assert word in err
    assert len(err.splitlines()) == 1
    assert path.name in err or "it was recorded on" in err


@pytest.mark.usefixtures("broken")
def test_every_flip_of_a_bit_in_a_replay_file(pearl, tmp_path):
    """It is refused, or read as it was: there are blanks and lines in JSON."""
    arguments = ("--device", "broken", "--n-agents", 40, "--steps", 80, "--out", tmp_path, "--json")
    path = Path(json.loads(pearl("verify", "CliffWalking", *arguments)[1])["replay"])
    content = path.read_bytes()
    value = json.loads(content)
    for at in np.random.default_rng(0).choice(8 * len(content), 300, replace=False):
        damaged = bytearray(content)
        damaged[at // 8] ^= 1 << at % 8
        path.write_bytes(damaged)
        try:
            replaying.Replay.read(path)
        except ArgumentError as error:
            said = str(error)
        else:
            said = ""
            assert json.loads(damaged) == value, at
        assert len(said.splitlines()) <= 1, at


def test_sticky_actions_are_all_there_is():
    from pearl_marl import get_spec
    from pearl_marl.verification import sticky_actions

    actions = np.array(list(sticky_actions(get_spec("CliffWalking"), 1000, 400, seed=3)))
    assert actions.dtype == np.uint8
    assert set(np.unique(actions)) == {0, 1, 2, 3}
    changed = (actions[1:] != actions[:-1]).mean(0).reshape(-1, 5).mean(0) / 0.75
    np.testing.assert_allclose(changed, [1, 1 / 2, 1 / 4, 1 / 8, 1 / 16], rtol=0.1)


def test_a_device_in_a_folder_has_a_file_name():
    assert in_file_name("xdma:/dev/shm/my board") == "xdma_dev_shm_my_board"


@pytest.mark.usefixtures("toys")
def test_agents_that_share_a_state(pearl):
    status, out, err = pearl("verify", "Meadow", "--n-agents", 40, "--steps", 160)
    assert status == 0, err
    assert "native is bit-exact with reference over 6,400 agent-steps" in out
    status, _, err = pearl("verify", "Meadow", "--n-agents", 42)
    assert status == 2
    assert "n_agents is 42, and a world of Meadow has 4 agents; 40 and 44 fit" in err


def test_a_device_is_not_held_against_itself(pearl) -> None:
    status, out, err = pearl("verify", "Taxi", "--device", "reference", "--n-agents", 4)
    assert (status, out) == (2, "")
    assert "--device and --reference are both 'reference', which always agrees with itself" in err


@pytest.fixture(scope="module")
def right(tmp_path_factory):
    """A policy that always goes right."""
    spec = get_spec("CliffWalking")
    path = tmp_path_factory.mktemp("policy") / "right.safetensors"
    integer_file.save(table_network(spec, np.tile([0, 1, 0, 0], (48, 1))), path)
    return path


@pytest.mark.parametrize("device", ["native", pytest.param("rtl", marks=pytest.mark.slow)])
def test_rollouts(pearl, right, device):
    given = "--policy", right, "--device", device, "--n-agents", 3, "--steps", 64, "--max-cycles", 2
    status, out, err = pearl("verify", "CliffWalking", *given, "--json")
    assert status == 0, err
    result = json.loads(out)
    assert result["exact"]
    assert result["agent_steps"] == 3 * 64
    assert result["episodes"] > 0


class Wrong(Native):
    """Its rollouts leave another state behind from tick 6 on."""

    name = "wrong"

    def _rollout(self, policy, steps, record, episodes):
        result, observed = super()._rollout(policy, steps, record, episodes)
        if self.tick > 6:
            self._memory[0] ^= 1
        return result, observed


def test_the_step_in_a_rollout_that_differs(pearl, right, monkeypatch):
    monkeypatch.setitem(by_name._BY_NAME, Wrong.name, Wrong)
    given = "--policy", right, "--device", "wrong", "--n-agents", 3, "--steps", 64
    status, out, _ = pearl("verify", "CliffWalking", *given, "--autoreset-mode", "same-step")
    assert status == 1
    assert "Not bit-exact" in out
    assert "rollout() before step 6" in out
    status, _, err = pearl("verify", "CliffWalking", *given, "--out", right.parent)
    assert status == 2
    assert "--out is for a file that is replayed" in err
