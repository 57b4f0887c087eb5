"""Drawing without the libraries that draw: one sentence that says what to install."""

from __future__ import annotations

import re
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.errors import ArgumentError, OrderError, PearlError
from pearl_marl.experiments.environment_figures import facts, ours
from pearl_marl.rendering import HeatMap, Renderer, Video
from pearl_marl.spec import EnvSpec

INSTALL = r"pip install '\.\[render\]'"
DRAWN = [(name, mode) for name in ours() for mode in pearl_marl.get_spec(name).render_modes if mode != "ansi"]


def without(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have imports of a library fail as where it is not installed."""
    for module in [module for module in sys.modules if module.partition(".")[0] == name]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, name, None)


@pytest.mark.parametrize(("name", "mode"), DRAWN)
def test_pictures_without_their_library(name: str, mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for library in ("pygame", "minatar", "minigrid", "mpe2", "matplotlib", "PIL"):
        without(library, monkeypatch)
    # Modules that may hold on to what they imported. `from package import module` asks the package first.
    holding = re.compile(r"pearl_marl\.envs\.\w+_oracle$|pettingzoo\.classic\.")
    for module in filter(holding.match, list(sys.modules)):
        monkeypatch.delitem(sys.modules, module)
        package, _, attribute = module.rpartition(".")
        if package in sys.modules:
            monkeypatch.delattr(sys.modules[package], attribute, raising=False)
    n = 2 * pearl_marl.get_spec(name).agents
    with closing(pearl_marl.parallel_env(name, n, render_mode=mode)) as env:
        draw = env.render if mode == "rgb_array" else env.reset
        if mode == "rgb_array":
            env.reset(seed=0)
        refusal = None
        try:
            picture = draw()
        except PearlError as error:
            refusal = str(error)
        if facts(name)["pictures"] == "NumPy":
            assert refusal is None
            assert picture.dtype == np.uint8
        else:
            assert refusal is not None
            assert re.search(INSTALL, refusal)
            assert "\n" not in refusal
            assert name in refusal
            env.device.step(np.zeros((n, *env.spec.action_space.shape), env.spec.action_space.dtype))


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


PLAIN = np.full((6, 9, 3), 70, np.uint8)


def drawn_by(draw: Any) -> EnvSpec:
    """CliffWalking with a drawing of its own."""
    return replace(
        pearl_marl.get_spec("CliffWalking"), draw=draw, render_modes=("rgb_array",), configure=None
    )


@pytest.mark.parametrize("name", pearl_marl.list_envs())
def test_pictures_are_bytes(name: str) -> None:
    for library in ("pygame", "minatar", "minigrid", "mpe2", "seaborn", "PIL"):
        pytest.importorskip(library)
    with closing(pearl_marl.parallel_env(name, render_mode="rgb_array")) as env:
        env.reset(seed=0)
        picture = env.render()
    assert picture.dtype == np.uint8
    assert picture.shape[2:] == (3,)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 1
    assert picture.max() > 50  # and not floats up to 1


def test_floats_become_bytes() -> None:
    for dtype in (np.float16, np.float32, np.float64):
        shades = np.linspace(0, 1, 256, dtype=dtype).repeat(3).reshape(16, 16, 3)
        picture = Renderer(drawn_by(lambda state, shades=shades: shades), "rgb_array").render(
            np.zeros(2, int)
        )
        assert picture.dtype == np.uint8
        assert picture.ravel().tolist() == np.arange(256).repeat(3).tolist()


@pytest.mark.parametrize(
    ("drawn", "words"),
    [
        (PLAIN[..., 0], r"uint8 and the shape \(6, 9\)"),
        (np.zeros((6, 9, 4), np.uint8), r"the shape \(6, 9, 4\)"),
        (np.zeros((0, 9, 3), np.uint8), r"the shape \(0, 9, 3\)"),
        (PLAIN.astype(np.int64), "int64"),
        (PLAIN > 0, "bool"),
        (PLAIN.astype(np.float32), "float32.* from 70 to 70"),
        (PLAIN / -100, "from -0.7 to -0.7"),
        (np.full((6, 9, 3), np.nan), "from nan to nan"),
        (None, r"object and the shape \(\)"),
        ("x", r"the shape \(\)"),
    ],
)
def test_pictures_that_are_none(drawn: Any, words: str) -> None:
    with pytest.raises(PearlError, match=f"CliffWalking has the .*{words}.*must be uint8") as caught:
        Renderer(drawn_by(lambda state: drawn), "rgb_array").render(np.zeros(2, int))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("sides", "shown"), [((6, 9), (132, 198)), ((100, 40), (200, 80)), ((150, 120), None)]
)
def test_small_pictures_are_magnified(
    sides: tuple[int, int], shown: tuple[int, int] | None, tmp_path: Path
) -> None:
    images = pytest.importorskip("PIL.Image")
    shades = np.zeros((*sides, 3), np.uint8)
    shades[0, 0] = 255
    with closing(Video(drawn_by(lambda state: shades), tmp_path / "film.gif")) as film:
        film.add(np.zeros((1, 2), int))
        film.save()
    with images.open(tmp_path / "film.gif") as written:
        height, width = shown or sides
        assert written.size == (width, height)
        bright = np.asarray(written.convert("L")) > 128
    larger = height // sides[0]
    assert bright.sum() == larger**2
    assert bright[:larger, :larger].all()


def test_films_with_nothing_to_see(tmp_path: Path) -> None:
    pytest.importorskip("PIL")

    def doubt(*shown: Any) -> str | None:
        pictures = iter(shown)
        with closing(Video(drawn_by(lambda state: next(pictures)), tmp_path / "film.gif")) as film:
            for _ in shown:
                film.add(np.zeros((1, 2), int))
            return film.doubt()

    spot, other = PLAIN.copy(), PLAIN.copy()
    spot[0, 0] = other[1, 1] = 0
    assert doubt(spot, other) is doubt(spot) is doubt(spot, spot, other) is doubt(spot, PLAIN) is None
    assert "has one colour only" in str(doubt(PLAIN, PLAIN // 2))
    assert "its 3 pictures are the same" in str(doubt(spot, spot, spot))
