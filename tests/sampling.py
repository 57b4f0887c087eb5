"""Which parameters `make test` has, where only `make test-exhaustive` has them all."""

from __future__ import annotations

from collections.abc import Container, Iterable
from typing import Any

import pytest


def sampled(values: Iterable[Any], always: Container[Any]) -> list[Any]:
    """Return parameters of a test; those that are not among ``always`` are exhaustive."""
    return [
        value if value in always else pytest.param(value, marks=pytest.mark.exhaustive) for value in values
    ]
