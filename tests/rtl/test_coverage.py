"""The report of coverage tells what a bench reaches and what it does not."""

from __future__ import annotations

from pathlib import Path

import harness
import pytest
import rtl_coverage
from harness import Variant, module, run_variants

from pearl_marl.hardware import elaboration


@pytest.mark.exhaustive
def test_one_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data, bench = tmp_path / "data", tmp_path / "bench"
    data.mkdir()
    bench.mkdir()
    monkeypatch.setenv(harness.COVERAGE_VARIABLE, str(data))
    assert run_variants([Variant("8", module("pearl_fifo", DEPTH=8), {"depth": 8})], "bench_fifo", bench) == [
        ""
    ]
    (file,) = data.iterdir()
    text = file.read_text()
    fifo = rtl_coverage.merge([file])["pearl_fifo"]
    assert min(fifo.lines.values()) > 0
    assert sum(count > 0 for count in fifo.toggles.values()) > 0.9 * len(fifo.toggles)
    # Two runs add up, and a run that reached nothing takes nothing away.
    nothing = data / "nothing.dat"
    nothing.write_text("\n".join(line.rpartition(" ")[0] + " 0" for line in text.splitlines()))
    assert rtl_coverage.merge([file, nothing])["pearl_fifo"] == fifo
    missed = rtl_coverage.report(rtl_coverage.merge([nothing]))
    assert f"| `pearl_fifo` | 0 / {len(fifo.lines)} | 0 / {len(fifo.toggles)} |" in missed
    (source,) = (path for path in elaboration.backbone_paths() if path.stem == "pearl_fifo")
    lines = source.read_text().splitlines()
    declared = 1 + next(i for i, line in enumerate(lines) if "data_i," in line)
    block = 1 + next(i for i, line in enumerate(lines) if "always_ff" in line)
    assert f"- pearl_fifo, line {block}: " in missed
    assert f"toggles of data_i (line {declared}): 0 of 64" in missed
