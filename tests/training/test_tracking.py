"""Metrics of runs at other services, of which the tests have imitations."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")

Pearl = Callable[..., tuple[int, str, str]]
Points = list[tuple[int, dict[str, float]]]


def imitated_wandb(runs: dict[str, Points]) -> ModuleType:
    """Weights & Biases, as far as it is called."""

    def init(
        *, project: str, name: str, dir: Path, config: dict[str, Any], id: str | None, resume: str
    ) -> Any:
        assert (project, dir.name, resume) == ("pearl-marl", name, "allow")
        assert config["environment"] == "CliffWalking-v0"
        assert config["learning_rate"] > 0
        json.dumps(config)
        key = id or f"run{len(runs)}"
        points = runs.setdefault(key, [])

        def log(metrics: dict[str, float], step: int) -> None:
            points.append((step, metrics))

        return SimpleNamespace(id=key, log=log, finish=lambda: points.append((-1, {})))

    module = ModuleType("wandb")
    module.init = init  # type: ignore[attr-defined]
    return module


def imitated_mlflow(runs: dict[str, Points]) -> ModuleType:
    """MLflow, as far as it is called."""

    class MlflowClient:
        def create_run(self, experiment_id: str, run_name: str) -> Any:
            assert experiment_id == "7"
            key = f"{run_name}{len(runs)}"
            runs[key] = []
            return SimpleNamespace(info=SimpleNamespace(run_id=key))

        def log_param(self, run_id: str, key: str, value: Any) -> None:
            assert not runs[run_id], "settings come first, and once"

        def update_run(self, run_id: str, status: str) -> None:
            assert runs[run_id][-1][0] == -1, "it had ended"

        def log_metric(self, run_id: str, key: str, value: float, step: int) -> None:
            if not runs[run_id] or runs[run_id][-1][0] != step:
                runs[run_id].append((step, {}))
            runs[run_id][-1][1][key] = value

        def set_terminated(self, run_id: str) -> None:
            runs[run_id].append((-1, {}))

    module = ModuleType("mlflow")
    module.MlflowClient = MlflowClient  # type: ignore[attr-defined]
    module.set_experiment = lambda name: SimpleNamespace(experiment_id="7")  # type: ignore[attr-defined]
    return module


IMITATIONS = {"wandb": imitated_wandb, "mlflow": imitated_mlflow}


@pytest.mark.parametrize("service", IMITATIONS)
def test_metrics_arrive_and_a_run_goes_on(
    service: str, pearl: Pearl, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs: dict[str, Points] = {}
    monkeypatch.setitem(sys.modules, service, IMITATIONS[service](runs))
    folder = tmp_path / "cliff"
    small = ("--n-agents", 64, "--iterations", 4, "--evaluate-every", 2, "--algo", "q-learning")
    arguments = ("train", "CliffWalking", *small, "--track", service, "--out", folder)
    for _ in range(2):  # the second time there is nothing left to do
        status, _, err = pearl(*arguments)
        assert status == 0, err
    ((key, points),) = runs.items()
    assert json.loads((folder / "tracking.json").read_text()) == {service: key}
    with (folder / "metrics.csv").open(newline="") as file:
        rows = [{name: float(text) for name, text in row.items() if text} for row in csv.DictReader(file)]
    steps = [row.pop("agent_steps") for row in rows]
    assert points == [*zip(steps, rows, strict=True), (-1, {}), (-1, {})]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--track", "excel"), "track is 'excel'; possible are 'wandb', 'mlflow'"),
        (("--track", "wandb"), "tracking by wandb needs the Python package wandb: pip install wandb"),
    ],
)
def test_refusals(
    arguments: tuple[str, ...], words: str, pearl: Pearl, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "wandb", None)
    status, _, err = pearl("train", "CliffWalking", *arguments, "--out", tmp_path / "run")
    assert status == 2
    assert words in " ".join(err.split())
    assert not (tmp_path / "run").exists()


def test_a_damaged_name_is_refused(pearl: Pearl, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mlflow", imitated_mlflow({}))
    (tmp_path / "tracking.json").write_text("[")
    status, _, err = pearl("train", "CliffWalking", "--track", "mlflow", "--out", tmp_path)
    assert status == 2
    assert "tracking.json is damaged: delete it" in " ".join(err.split())
