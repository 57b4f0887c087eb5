"""Pictures: one world, mostly through the oracle's renderer; several as a film; and all as a heat map."""

from __future__ import annotations

import contextlib
import io
import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.error import DependencyNotInstalled

from pearl_marl.base.files import check_files, replace_file
from pearl_marl.batch.step import BatchStep
from pearl_marl.errors import ArgumentError, OrderError, PearlError
from pearl_marl.spec import EnvSpec

VIDEO_WORLDS, VIDEO_STEPS = 9, 200
"""What a film shows at most: renderers take milliseconds for a picture."""

TILE = 200
"""The greatest width and height of a world in a film, in pixels; smaller ones are magnified up to it."""

GAP = 4
"""Pixels between the worlds in a film."""

_SHADES = " ░▒▓█"


class Renderer:
    """Draws one world in a render mode: by the environment's own drawing, or that of the one it follows."""

    def __init__(self, spec: EnvSpec, mode: str) -> None:
        check_render_mode(spec, mode)
        self._spec, self._mode = spec, mode
        self._env: Any = None
        if spec.draw is None:
            assert spec.oracle is not None
            with _installed(spec):
                self._env = gymnasium.make(spec.oracle, render_mode=mode, **spec.options).unwrapped
                self._env.reset()

    def render(self, state: npt.NDArray[Any]) -> Any:
        """Draw a world's state (its row of :meth:`pearl_marl.devices.Device.state`).

        Returns an image of shape ``(height, width, 3)``, a string, or ``None`` for ``"human"``.
        """
        spec, built = self._spec, self._spec.layout.built(state.tolist())
        if spec.draw is None:
            assert spec.pose is not None
            spec.pose(self._env, built)
        with _installed(spec):
            drawn = self._env.render() if spec.draw is None else spec.draw(built)
        return drawn if spec.draw is None and self._mode != "rgb_array" else _picture(spec, drawn)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._env is not None:
            self._env.close()


def _picture(spec: EnvSpec, drawn: Any) -> npt.NDArray[np.uint8]:
    """Return a picture as everybody takes them; MinAtar's, for one, are floats from 0 to 1."""
    picture = np.asarray(drawn)
    found = f"dtype {picture.dtype} and the shape {picture.shape}"
    right = picture.ndim == 3 and picture.shape[2] == 3 and picture.size > 0
    if right and picture.dtype.kind == "f":
        low, high = picture.min(), picture.max()
        if low >= 0 and high <= 1:
            scaled: npt.NDArray[np.uint8] = np.rint(picture * 255).astype(np.uint8)
            return scaled
        found, right = f"{found}, with values from {low:g} to {high:g}", False
    if not right or picture.dtype != np.uint8:
        raise PearlError(
            f"the drawing of {spec.name} has the {found}; "
            "it must be uint8, or floats from 0 to 1, of the shape (height, width, 3)"
        )
    return picture


@contextlib.contextmanager
def _installed(spec: EnvSpec) -> Iterator[None]:
    """Say how to install a library that the renderer misses; which one, it tells only when it draws."""
    try:
        yield
    except (DependencyNotInstalled, ImportError) as error:
        missing = (getattr(error.__cause__ or error, "name", None) or "pygame").partition(".")[0]
        raise PearlError(
            f"drawing {spec.name} needs {missing.replace('PIL', 'Pillow')}: pip install '.[render]'"
        ) from error


def check_render_mode(spec: EnvSpec, mode: str | None) -> None:
    """Refuse a render mode that the environment does not have; ``None`` is none."""
    if mode is not None and mode not in spec.render_modes:
        raise ArgumentError(
            f"render_mode is {mode!r}; {spec.name} has {', '.join(spec.render_modes) or 'none'}"
        )


class Video:
    """A film of the first worlds, side by side, as a GIF.

    It needs no screen. Takes Pillow, of the ``render`` extra. ``labels`` are written into its rows.
    """

    def __init__(self, spec: EnvSpec, path: Path, labels: Sequence[str] = ()) -> None:
        if path.suffix.lower() != ".gif":
            raise ArgumentError(f"--video is {path}; it must be a file that ends in .gif")
        os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # pygame asks for a screen that is never shown
        try:
            from PIL import Image, ImageDraw
        except ImportError as error:
            raise PearlError("films need Pillow: pip install '.[render]'") from error
        self._image, self._drawing = Image, ImageDraw
        self._labels = labels
        self._path, self._milliseconds = path, 1000 // spec.render_fps
        self._renderer = Renderer(spec, "rgb_array")
        self._frames: list[Any] = []
        self._first: list[npt.NDArray[np.uint8]] = []
        self._still = self._plain = True

    def add(self, states: npt.NDArray[Any]) -> None:
        """Film worlds in these states, a row a world."""
        pictures = [self._renderer.render(state) for state in states[:VIDEO_WORLDS]]
        self._first = self._first or [picture.copy() for picture in pictures]
        self._still &= all(map(np.array_equal, pictures, self._first))
        self._plain &= all(bool((picture == picture[0, 0]).all()) for picture in pictures)
        tiles = [self._tile(picture) for picture in pictures]
        width, height = tiles[0].size
        columns = math.ceil(math.sqrt(len(tiles)))
        across, down = width + GAP, height + GAP
        size = columns * across - GAP, math.ceil(len(tiles) / columns) * down - GAP
        frame = self._image.new("RGB", size, "white")
        for i, tile in enumerate(tiles):
            frame.paste(tile, (i % columns * across, i // columns * down))
        pen = self._drawing.Draw(frame)
        for row, label in enumerate(self._labels):
            pen.text((4, row * down + 4), label, fill="black", font_size=12)
        self._frames.append(frame.convert("P", palette=self._image.Palette.ADAPTIVE))

    def save(self) -> None:
        """Write the film."""
        first, *others = self._frames
        arguments = {"duration": self._milliseconds, "loop": 0}
        film = io.BytesIO()
        first.save(film, "GIF", save_all=True, append_images=others, **arguments)
        replace_file(self._path, film.getvalue())

    def doubt(self) -> str | None:
        """Return a sentence if there is nothing to see in the film, which may be a mistake of the drawing."""
        if self._plain:
            return f"Each picture of {self._path} has one colour only."
        if self._still and len(self._frames) > 1:
            return f"Nothing moves in {self._path}: its {len(self._frames)} pictures are the same."
        return None

    def close(self) -> None:
        """Close the renderer."""
        self._renderer.close()

    def _tile(self, picture: npt.NDArray[np.uint8]) -> Any:
        tile = self._image.fromarray(picture)
        larger = TILE // max(tile.size)
        if larger > 1:
            return tile.resize([larger * side for side in tile.size], self._image.Resampling.NEAREST)
        tile.thumbnail((TILE, TILE))
        return tile


class HeatMap:
    """Counts how often the slots of an environment with a grid visit each of its cells."""

    def __init__(self, spec: EnvSpec) -> None:
        if spec.grid is None:
            raise ArgumentError(f"{spec.name} has no grid to draw a heat map on")
        self._spec, self._grid = spec, spec.grid
        self.counts = np.zeros((spec.grid.rows, spec.grid.columns), np.int64)
        """Visits so far, shape ``(rows, columns)``."""

    def add(self, step: BatchStep) -> None:
        """Count where a step took the slots: an episode's last cell, not the next one's first."""
        arrived = self._grid.cell(step.arrivals())
        self.counts += np.bincount(arrived, minlength=self.counts.size).reshape(self.counts.shape)

    def text(self) -> str:
        """Return the map for a terminal, a line a row, darker for more visits (on a log scale)."""
        scale = np.log1p(self.counts)
        levels = np.ceil(scale / max(scale.max(), 1) * (len(_SHADES) - 1)).astype(int)
        return "\n".join("".join(_SHADES[level] * 2 for level in row) for row in levels)

    def save(self, path: str | Path) -> None:
        """Write the map as a picture. Needs matplotlib, of the ``render`` extra."""
        rows, columns = self.counts.shape
        path = Path(path)
        check_files(path.parent, path.name)
        figure = new_figure(1 + 0.7 * columns, 1.2 + 0.7 * rows)
        from matplotlib.colors import LogNorm

        if not self.counts.any():
            raise OrderError("save() before add(): nothing has been counted that a heat map could show")
        axes = figure.subplots()
        image = axes.imshow(np.where(self.counts, self.counts, np.nan), norm=LogNorm(vmin=1), cmap="viridis")
        axes.set(xticks=range(columns), yticks=range(rows), xlabel="column", ylabel="row")
        axes.set_title(f"{self._spec.name}: visits of all agents ({self.counts.sum():,} steps)")
        figure.colorbar(image, label="visits (log scale)", shrink=0.9)
        save_figure(figure, path)


def new_figure(width: float, height: float) -> Any:
    """Return an empty figure of matplotlib, in inches, to be saved into a file.

    Pyplot would keep it until it is closed, and takes as long to import as the rest of matplotlib.
    """
    try:
        from matplotlib import figure
    except ImportError as error:
        raise PearlError("drawing needs matplotlib: pip install '.[render]'") from error
    return figure.Figure(figsize=(width, height), layout="constrained")


def save_figure(figure: Any, path: Path, dpi: int = 120) -> None:
    """Write a figure of matplotlib as a picture, of the format that the file's name ends in."""
    picture = io.BytesIO()
    figure.savefig(picture, format=path.suffix[1:] or None, dpi=dpi)
    replace_file(path, picture.getvalue())
