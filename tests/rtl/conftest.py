"""``pytest tests/rtl --rtl-coverage FILE`` writes what the benches reach of the sources to a file."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import harness
import pytest
import rtl_coverage

from pearl_marl.hardware import elaboration


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--rtl-coverage", metavar="FILE", help="write a report of the benches' coverage to FILE")


def pytest_configure(config: pytest.Config) -> None:
    # The first process makes the folder; those of xdist, and simulators, inherit its name.
    if config.getoption("--rtl-coverage") and harness.COVERAGE_VARIABLE not in os.environ:
        os.environ[harness.COVERAGE_VARIABLE] = tempfile.mkdtemp(prefix="pearl_coverage_")


def pytest_sessionfinish(session: pytest.Session) -> None:
    target = session.config.getoption("--rtl-coverage")
    if target and not hasattr(session.config, "workerinput"):
        data = Path(os.environ.pop(harness.COVERAGE_VARIABLE)).glob("*.dat")
        own = {path.stem for path in elaboration.backbone_paths()}
        modules = {name: found for name, found in rtl_coverage.merge(data).items() if name in own}
        Path(target).write_text(rtl_coverage.report(modules))
