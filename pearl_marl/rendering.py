"""Pictures: one slot through the oracle's own renderer, and all of them as a heat map."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.error import DependencyNotInstalled

from pearl_marl.batch.step import BatchStep
from pearl_marl.errors import ArgumentError, PearlError
from pearl_marl.spec import EnvSpec

_SHADES = " ░▒▓█"


class OracleRenderer:
    """Draws one slot with the renderer of the environment that ours follows, in one of its render modes."""

    def __init__(self, spec: EnvSpec, mode: str) -> None:
        check_render_mode(spec, mode)
        assert spec.oracle is not None
        assert spec.pose is not None
        self._pose, self._spec = spec.pose, spec
        with _installed(spec):
            self._env = gymnasium.make(spec.oracle, render_mode=mode, **spec.options).unwrapped
            self._env.reset()

    def render(self, state: npt.NDArray[Any]) -> Any:
        """Draw a slot's state (its row of :meth:`pearl_marl.devices.Device.state`).

        Returns an image of shape ``(height, width, 3)``, a string, or ``None`` for ``"human"``.
        """
        self._pose(self._env, tuple(state.tolist()))
        with _installed(self._spec):
            return self._env.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self._env.close()


@contextlib.contextmanager
def _installed(spec: EnvSpec) -> Iterator[None]:
    """Say how to install a library that the renderer misses; which one, it tells only when it draws."""
    try:
        yield
    except (DependencyNotInstalled, ImportError) as error:
        missing = getattr(error.__cause__ or error, "name", None) or "pygame"
        raise PearlError(
            f"drawing {spec.name} needs {missing.partition('.')[0]}: pip install 'pearl-marl[render]'"
        ) from error


def check_render_mode(spec: EnvSpec, mode: str | None) -> None:
    """Refuse a render mode that the environment does not have; ``None`` is none."""
    if mode is not None and mode not in spec.render_modes:
        raise ArgumentError(
            f"render_mode is {mode!r}; {spec.name} has {', '.join(spec.render_modes) or 'none'}"
        )


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
        plt = import_pyplot()
        from matplotlib.colors import LogNorm

        path = Path(path)
        rows, columns = self.counts.shape
        figure, axes = plt.subplots(figsize=(1 + 0.7 * columns, 1.2 + 0.7 * rows), layout="constrained")
        image = axes.imshow(np.where(self.counts, self.counts, np.nan), norm=LogNorm(vmin=1), cmap="viridis")
        axes.set(xticks=range(columns), yticks=range(rows), xlabel="column", ylabel="row")
        axes.set_title(f"{self._spec.name}: visits of all agents ({self.counts.sum():,} steps)")
        figure.colorbar(image, label="visits (log scale)", shrink=0.9)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=120)
        plt.close(figure)


def import_pyplot() -> Any:
    """Import matplotlib for drawing into files, or say how to install it."""
    try:
        import matplotlib
    except ImportError as error:
        raise PearlError("drawing needs matplotlib: pip install 'pearl-marl[render]'") from error
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt
