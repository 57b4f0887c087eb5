"""Services that collect the metrics of runs, where they are installed: Weights & Biases, and MLflow."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pearl_marl.base.files import replace_file
from pearl_marl.errors import ArgumentError

PROJECT = "pearl-marl"
"""The project, or experiment, that runs are in."""
IDS = "tracking.json"
"""The file of a run's folder that has the run's name at each service, by which it goes on there."""


class _Wandb:
    def __init__(self, wandb: Any, folder: Path, settings: Mapping[str, Any], run: str | None) -> None:
        self._run = wandb.init(
            project=PROJECT, name=folder.name, dir=folder, config=dict(settings), id=run, resume="allow"
        )
        self.id = self._run.id

    def log(self, agent_steps: int, metrics: Mapping[str, float]) -> None:
        self._run.log(dict(metrics), step=agent_steps)

    def close(self) -> None:
        self._run.finish()


class _Mlflow:
    def __init__(self, mlflow: Any, folder: Path, settings: Mapping[str, Any], run: str | None) -> None:
        # The client has no active run, of which a program may have one of its own.
        self._client = mlflow.MlflowClient()
        if run is None:
            experiment = mlflow.set_experiment(PROJECT).experiment_id
            run = self._client.create_run(experiment, run_name=folder.name).info.run_id
            for name, value in settings.items():
                self._client.log_param(run, name, value)
        else:
            self._client.update_run(run, status="RUNNING")
        self.id = run

    def log(self, agent_steps: int, metrics: Mapping[str, float]) -> None:
        for name, value in metrics.items():
            self._client.log_metric(self.id, name, value, step=agent_steps)

    def close(self) -> None:
        self._client.set_terminated(self.id)


Tracker = _Wandb | _Mlflow
"""A run, at a service: ``log`` sends the figures of the moment, and ``close`` ends it for now."""

SERVICES: Mapping[str, Callable[..., Tracker]] = {"wandb": _Wandb, "mlflow": _Mlflow}
"""By the names of their packages."""


def check(service: str) -> None:
    """Raise ArgumentError for a service that is unknown, or not installed."""
    if service not in SERVICES:
        raise ArgumentError(f"track is {service!r}; possible are {', '.join(map(repr, SERVICES))}")
    try:
        importlib.import_module(service)
    except ModuleNotFoundError as error:
        raise ArgumentError(
            f"tracking by {service} needs the Python package {error.name}: pip install {service}"
        ) from None


def tracker(service: str, folder: Path, settings: Mapping[str, Any]) -> Tracker:
    """Begin a run at a service, or go on with the one that a folder has there.

    Parameters
    ----------
    service
        One of :data:`SERVICES`. Where it sends to, and as who, is its own configuration.
    folder
        The run's folder, after which the run is named.
    settings
        What the run depends on, by name.
    """
    path = folder / IDS
    try:
        ids = dict(json.loads(path.read_bytes()))
    except FileNotFoundError:
        ids = {}
    except (OSError, ValueError, TypeError):
        raise ArgumentError(f"{path} is damaged: delete it, to begin a run anew at {service}") from None
    found = SERVICES[service](importlib.import_module(service), folder, settings, ids.get(service))
    replace_file(path, json.dumps({**ids, service: found.id}).encode())
    return found
