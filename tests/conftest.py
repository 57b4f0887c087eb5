"""Slow tests, and the toy environments."""

from __future__ import annotations

import os
from collections.abc import Iterator
from unittest import mock

import pytest

# Rendering needs no screen in a test; SDL reads this when pygame starts it.
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

import pearl_marl
from pearl_marl import registry

from .toy import TOYS


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "slow: takes seconds or gigabytes; runs where --slow is given")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the tests marked slow too")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--slow"):
        for item in items:
            if "slow" in item.keywords:
                item.add_marker(pytest.mark.skip(reason="slow: run pytest --slow"))


@pytest.fixture
def toys() -> Iterator[None]:
    """Register the toy environments for one test; the list of environments is as before afterwards."""
    with mock.patch.dict(registry._specs()):
        for spec in TOYS:
            pearl_marl.register(spec)
        yield
