"""What a kind of file is: a right one, ways to craft others, and what is right of those that are read."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np

from pearl_marl.errors import PearlError

from .damages import damaged

Rng = np.random.Generator


class WrongError(Exception):
    """A case that is neither refused nor right."""


def expect(right: Any, why: str) -> None:
    if not right:
        raise WrongError(why)


class Kind:
    """A kind of file: ``sample`` is a right one, and ``read`` reads one and raises :class:`WrongError`."""

    weight = 10
    """How many of a hundred or so cases it gets: by how long one takes."""

    sample: bytes

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def case(self, others: list[bytes], rng: Rng) -> tuple[bytes, bool]:
        """Return a damaged file, and whether its checksums are right; there may be none."""
        if rng.integers(2) and (crafted := self.crafted(rng)) is not None:
            return crafted, True
        return damaged(self.sample, others, rng), False

    def crafted(self, rng: Rng) -> bytes | None:
        """Return a file of insane content and right checksums."""
        return None

    def read(self, content: bytes, sealed: bool) -> None:
        """Read it: a PearlError refuses it."""
        raise NotImplementedError

    def warm_up(self) -> None:
        """Read a right one and a short one, so that what is loaded late is loaded."""
        for content in (self.sample, self.sample[:40]):
            with contextlib.suppress(PearlError):
                self.read(content, False)

    def close(self) -> None:
        """Clean up."""
