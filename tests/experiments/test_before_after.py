"""The film of what training changes."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from pearl_marl.experiments import before_after


def test_it_shows_every_stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(before_after, "STEPS", 6)
    monkeypatch.setattr(before_after, "STAGES", (0, 1))
    before_after.main(tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as film:
        assert film.format == "GIF"
        assert film.n_frames == 3
        assert film.height > film.width / before_after.WORLDS
