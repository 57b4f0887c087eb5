"""What two linters say of SystemVerilog: Verilator, and slang, which knows more of the standard's rules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from pyslang.driver import Driver

from pearl_marl.hardware import toolchain

OFF = "useless-cast", "shift-count-overflow", "case-redundant-default"
"""The first two are right for other values of a parameter, and a default is for bits that are unknown."""


def lint(
    top: str,
    files: Sequence[Path],
    parameters: Mapping[str, int | str] = {},
    macros: Mapping[str, str] = {},
    off: Sequence[str] = (),
) -> None:
    """Refuse sources that one of the linters has a complaint about; Verilator has rules ``off``."""
    values = [f"-G{name}={value}" for name, value in parameters.items()]
    values += [f"-D{name}={value}" for name, value in macros.items()]
    # Its limit is for numbers that are written by mistake; words of many agents are as wide.
    wide = "--replication-limit", "65536"
    command = ["verilator", "--lint-only", "-Wall", "--assert", *wide, "--top-module", top, *values]
    command += [f"-Wno-{rule}" for rule in off]
    toolchain.run([*command, *map(str, files)])
    slang(top, files, values)


def slang(top: str, files: Sequence[Path], values: Sequence[str] = ()) -> None:
    """Refuse sources that slang has a complaint about, which it writes to the standard error."""
    driver = Driver()
    driver.addStandardArgs()
    options = ["--threads", "1", "-Wextra", "-Werror", *(f"-Wno-{name}" for name in OFF), "--top", top]
    assert driver.parseCommandLine(" ".join(["slang", *options, *values, *map(str, files)]))
    assert driver.processOptions()
    read = driver.parseAllSources()
    compilation = driver.createCompilation()
    driver.reportCompilation(compilation, True)
    driver.runAnalysis(compilation)
    assert all([driver.reportDiagnostics(True), read]), f"slang has a complaint about {top}"
