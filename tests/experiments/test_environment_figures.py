"""What is known of environments: measured, kept in their folders, and said of which run it is."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from pearl_marl import get_spec
from pearl_marl.benchmark.measure import Contender, Step, UnavailableError
from pearl_marl.benchmark.tables import BATCH, ENVPOOL, KERNEL
from pearl_marl.errors import ArgumentError
from pearl_marl.experiments import environment_figures as figures
from pearl_marl.experiments.calling import call

from ..toy import DRIFT


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two environments, of which nothing is known."""
    for name in ("catch", "taxi"):
        (tmp_path / name).mkdir()
        for file in ("spec.py", "step.py"):
            shutil.copy(figures.FOLDER / name / file, tmp_path / name)
    monkeypatch.setattr(figures, "FOLDER", tmp_path)
    return tmp_path


def called(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", ["environment_figures", *arguments])
    with pytest.raises(SystemExit) as exit_:
        call(figures.main)
    assert not exit_.value.code


def test_of_a_new_environment_nothing_is_known(folder: Path) -> None:
    assert figures.facts("Taxi") == dict.fromkeys(figures.FACTS)
    lines = f"{figures.software()}\n{figures.hardware()}".splitlines()
    assert "| [Taxi](../envs/taxi/README.md#how-it-is-checked) | - | - | 124 | 12 | - | - | - | - |" in lines
    assert any(line.startswith("| Taxi | 4 | - | - | - | - | - | - | - | - | 64 |") for line in lines)
    figures.keep_fact("Taxi", "original", "Gymnasium 1.4.0")
    expected = dict.fromkeys(figures.FACTS) | {"original": "Gymnasium 1.4.0"}
    assert json.loads((folder / "taxi" / "facts.json").read_text()) == expected


def missing() -> Step:
    raise UnavailableError("not installed: pip install jumanji")


def without() -> Step:
    raise UnavailableError("EnvPool has no such game")


def test_rates_are_kept_with_what_was_compared(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    contenders = [
        *(Contender(name, "", n, lambda: lambda: None) for name, n in ((KERNEL, 9), (BATCH, 9), ("pgx", 1))),
        *(Contender("jumanji", "", 1, missing), Contender(ENVPOOL, "", 1, without)),
    ]
    monkeypatch.setattr(figures, "compared", lambda *_: contenders)
    called(monkeypatch, "--measure", "rates", "taxi", "--rounds", "1", "--seconds", "0")
    kept = figures.facts("Taxi")["rates"]
    assert (kept["peer"], kept["absent"]) == ("pgx", ["jumanji"])
    assert kept["kernel"] > 0
    assert "Python" in kept["machine"]
    assert ", pgx (without jumanji) |" in capsys.readouterr().out
    assert not (folder / "catch" / "facts.json").exists()


def test_a_package_of_ones_own_is_measured_and_not_kept(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cells = dict.fromkeys(("latency", "lut", "ff", "dsp"), 1_234)
    core: dict[str, Any] = {"xc7": cells, "ecp5": cells | {"mhz": None}}
    monkeypatch.setattr(figures, "measured_core", lambda _: core)
    monkeypatch.setattr(figures, "get_spec", lambda name: DRIFT if name == "toy:Drift" else get_spec(name))
    called(monkeypatch, "--measure", "core", "toy:Drift", "Catch")
    rows = capsys.readouterr().out.splitlines()[2:]
    columns = f"{' | 1,234' * 8} | -"
    assert rows == [f"| toy:Drift{columns} |", f"| Catch{columns} |"]
    assert figures.facts("Catch")["core"] == core
    assert [path.parent.name for path in folder.glob("*/facts.json")] == ["catch"]


def test_runs_are_told_apart(folder: Path) -> None:
    rates = {"kernel": 2, "step_batch": 1, "peer": None, "peer_rate": None, "absent": [], "machine": "A"}
    figures.keep_fact("Catch", "rates", rates | {"date": "2026-11-28"})
    assert figures.software().endswith("\n\nRates of 2026-11-28: A.")
    figures.keep_fact("Taxi", "rates", rates | {"date": "2026-11-30"})
    runs = "Rates of 2026-11-28: A. These are Catch.\n\nRates of 2026-11-30: A. These are Taxi."
    assert figures.software().endswith(f"\n\n{runs}")


def test_what_is_in_no_folder_has_no_facts(folder: Path) -> None:
    with pytest.raises(ArgumentError, match="Acrobot has no facts"):
        figures.keep_fact("Acrobot", "core", None)


def test_names_are_of_what_to_measure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["environment_figures", "Taxi"])
    with pytest.raises(SystemExit):
        call(figures.main)
    assert "give --measure core or --measure rates" in capsys.readouterr().err


def test_what_differed_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "verdict.json").write_text(json.dumps({"exact": False, "device": "rtl"}))
    monkeypatch.setattr(sys, "argv", ["environment_figures", "--verified", str(tmp_path / "verdict.json")])
    with pytest.raises(SystemExit) as exit_:
        call(figures.main)
    assert exit_.value.code == 2


@pytest.mark.exhaustive
def test_a_core_takes_what_is_said() -> None:
    measured, known = figures.measured_core(get_spec("MemoryChain")), figures.facts("MemoryChain")["core"]
    assert {family: measured[family] for family in figures.FAMILIES} == {
        family: known[family] for family in figures.FAMILIES
    }
