"""Films of evaluations: of first episodes, as many as there are evaluations; the training stays the same."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
images = pytest.importorskip("PIL.Image", reason="Pillow is not installed: pip install '.[render]'")

training = importlib.import_module("pearl_marl.training.run")

Pearl = Callable[..., tuple[int, str, str]]

pytestmark = pytest.mark.usefixtures("toys")


def test_each_evaluation_is_filmed(tmp_path: Path) -> None:
    """ConnectFour takes turns and has masks; a game has 7 moves at least, and 42 at most."""
    given = {"n_agents": 16, "iterations": 4, "rollout_length": 8, "chunk_length": 8, "memory": "gru"}
    settings = training.settings_for("pqn", "ConnectFour", given)
    plan = training.Training("ConnectFour", "pqn", settings, evaluate_every=2)
    for films in (False, True):
        run = training.TrainingRun(plan, tmp_path / str(films), evaluated=8, films=films)
        with run.claimed():
            while not run.finished:
                run.iterate()
    assert not (tmp_path / "False" / "films").exists()
    paths = sorted((tmp_path / "True" / "films").iterdir())
    assert [path.name for path in paths] == ["000002.gif", "000004.gif"]
    for path in paths:
        with images.open(path) as film:
            assert 7 <= film.n_frames <= 42
    policies = [(tmp_path / name / "policy.safetensors").read_bytes() for name in ("False", "True")]
    assert policies[0] == policies[1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("Ladder", "--films"), "render_mode is 'rgb_array'; Ladder has none"),
        (("CartPole", "--films", "--seeds", 2), "leave --shards, --films, --track and --quantize out"),
    ],
)
def test_what_cannot_be_filmed_is_refused(
    pearl: Pearl, arguments: tuple[Any, ...], words: str, tmp_path: Path
) -> None:
    status, _, err = pearl("train", *arguments, "--out", tmp_path / "run")
    assert status == 2
    assert words in err
    assert not (tmp_path / "run").exists()
