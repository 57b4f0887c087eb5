"""Drawing without the libraries that draw: one sentence that says what to install."""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import pearl_marl
from pearl_marl.errors import ArgumentError, OrderError, PearlError
from pearl_marl.rendering import HeatMap

INSTALL = r"pip install '\.\[render\]'"
DRAWN = [
    (name, mode)
    for name in pearl_marl.envs()
    for mode in pearl_marl.get_spec(name).render_modes
    if mode != "ansi"
]


def without(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have imports of a library fail as where it is not installed."""
    for module in [module for module in sys.modules if module.partition(".")[0] == name]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, name, None)


@pytest.mark.parametrize(("name", "mode"), DRAWN)
def test_pictures_without_their_library(name: str, mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for library in ("pygame", "minatar", "matplotlib", "PIL"):
        without(library, monkeypatch)
    monkeypatch.delitem(sys.modules, "pearl_marl.envs.seaquest.oracle", raising=False)
    with closing(pearl_marl.parallel_env(name, n_agents=2, render_mode=mode)) as env:
        draw = env.render if mode == "rgb_array" else env.reset
        if mode == "rgb_array":
            env.reset(seed=0)
        with pytest.raises(PearlError, match=INSTALL) as caught:
            draw()
        assert "\n" not in str(caught.value)
        assert name in str(caught.value)
        env.device.step(np.zeros((2, *env.spec.action_space.shape), env.spec.action_space.dtype))


def test_a_drawing_in_letters_needs_none(monkeypatch: pytest.MonkeyPatch) -> None:
    without("pygame", monkeypatch)
    with closing(pearl_marl.parallel_env("CliffWalking", render_mode="ansi")) as env:
        env.reset(seed=0)
        assert "x" in env.render()


def test_heat_maps_that_cannot_be_saved(tmp_path: Path) -> None:
    heat_map = HeatMap(pearl_marl.get_spec("CliffWalking"))
    with pytest.raises(OrderError, match=r"save\(\) before add\(\)"):
        heat_map.save(tmp_path / "map.png")
    with pytest.raises(ArgumentError, match="is a folder, and a file is to be written there"):
        heat_map.save(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_heat_map_without_matplotlib(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without("matplotlib", monkeypatch)
    heat_map = HeatMap(pearl_marl.get_spec("CliffWalking"))
    with pytest.raises(PearlError, match=f"matplotlib: {INSTALL}"):
        heat_map.save(tmp_path / "map.png")
