"""The hardware tools: those of WebAssembly, which compile themselves at their first call."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from pearl_marl.hardware import toolchain


def test_a_tool_is_made_ready_by_one_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Or each would compile it, for most of a minute of all cores."""
    log, program = tmp_path / "log", tmp_path / "yowasp-tool"
    program.write_text(f"#!/bin/sh\necho begin $1 >> {log}\nsleep 0.2\necho end $1 >> {log}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(toolchain.prepare, [program.name] * 2))
    assert log.read_text().split("\n") == ["begin --version", "end --version"] * 2 + [""]
    toolchain.run([program.name, "work"])
    assert log.read_text().splitlines()[4:] == ["begin work", "end work"], "it is ready in this process"
