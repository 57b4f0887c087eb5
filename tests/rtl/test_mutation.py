"""Small faults in the backbone are noticed: a sample of what ``python tests/rtl/mutation.py`` tries."""

from __future__ import annotations

from pathlib import Path

import mutation
import pytest
from scenarios import BUILD, host_script

COUNT, SEED = 24, 3


@pytest.mark.exhaustive
def test_faults_in_the_backbone_are_noticed(tmp_path: Path) -> None:
    mutants = mutation.choose(BUILD, tmp_path, COUNT, SEED)
    program = mutation.compile_mutants(mutants, tmp_path)
    by = mutation.caught(program, host_script(BUILD), len(mutants))
    unnoticed = [mutant for mutant, part in zip(mutants, by, strict=True) if part is None]
    # Some do nothing. Which ones are in the sample changes with the sources.
    assert len(unnoticed) <= len(mutants) // 4, unnoticed
    assert len(mutants) > COUNT // 2
