"""The demo: what it opens, it closes, and nothing twice on a device that serves one at a time."""

from __future__ import annotations

import contextlib
import importlib
from pathlib import Path
from typing import Any

import pytest
import typer

import pearl_marl

demo = importlib.import_module("pearl_marl.experiments.cliff_walking_q_learning")


class Environments:
    """Makes environments as ``parallel_env`` does, and knows which are open."""

    def __init__(self) -> None:
        self.open: list[str] = []
        self.made = 0

    def __call__(self, *arguments: Any, device: str = "native", **options: Any) -> Any:
        assert device not in self.open or device == "native", f"{device} serves one at a time"
        env = MAKE(*arguments, device=device, **options)
        self.open.append(device)
        self.made += 1
        close = env.close

        def closed() -> None:
            close()
            self.open.remove(device)

        env.close = closed  # type: ignore[method-assign]
        return env


MAKE = pearl_marl.parallel_env


@pytest.fixture
def environments(monkeypatch: pytest.MonkeyPatch) -> Environments:
    made = Environments()
    monkeypatch.setattr(pearl_marl, "parallel_env", made)
    return made


def test_one_environment_at_a_time(environments: Environments, tmp_path: Path) -> None:
    arguments = {"epsilon": 0.2, "learning_rate": 0.5, "discount": 1.0, "seed": 0, "out": tmp_path}
    with contextlib.suppress(typer.Exit):  # so few steps are too few for the goal
        demo.main(n_agents=100, steps=20, device="reference", **arguments)
    assert environments.made == 1 + 20 / demo.EVALUATE_EVERY + 1, "to learn, to evaluate, to draw"
    assert environments.open == []


def test_an_interrupted_demo_closes_its_environment(
    environments: Environments, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(demo, "update", interrupted)
    arguments = {"epsilon": 0.2, "learning_rate": 0.5, "discount": 1.0, "seed": 0, "device": "native"}
    with pytest.raises(KeyboardInterrupt):
        demo.main(n_agents=10, steps=2, out=tmp_path, **arguments)
    assert environments.open == []
