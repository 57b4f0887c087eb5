"""Small faults in the backbone are noticed: a sample of what ``python tests/rtl/mutation.py`` tries."""

from __future__ import annotations

from pathlib import Path

import mutation

# Of so many faults, that many do no harm: nothing changes, or only in states that never come.
COUNT, SEED = 24, 3
HARMLESS: set[str] = set()


def test_faults_in_the_backbone_are_noticed(tmp_path: Path) -> None:
    mutants = mutation.choose(mutation.BUILD, tmp_path, COUNT, SEED)
    assert len(mutants) > COUNT / 2
    program = mutation.compile_mutants(mutants, tmp_path)
    by = mutation.caught(program, mutation.host_script(mutation.BUILD), len(mutants))
    unnoticed = {mutant.command for mutant, part in zip(mutants, by, strict=True) if part is None}
    assert unnoticed == HARMLESS
