"""Small faults in the backbone are noticed: a sample of what ``python tests/rtl/mutation.py`` tries."""

from __future__ import annotations

from pathlib import Path

import mutation
import pytest
from scenarios import BUILD, host_script, rollout_script, with_policy

from pearl_marl.hardware.build import Build

COUNT, SEED = 24, 3


@pytest.mark.exhaustive
def test_faults_in_the_backbone_are_noticed(tmp_path: Path) -> None:
    assert_noticed(BUILD, host_script(BUILD), COUNT, tmp_path)


@pytest.mark.exhaustive
def test_faults_in_what_a_rollout_takes_are_noticed(tmp_path: Path) -> None:
    # About one in seven lies there.
    assert_noticed(with_policy("golden"), rollout_script("golden"), 7 * COUNT, tmp_path)


def assert_noticed(build: Build, script: str, count: int, folder: Path) -> None:
    mutants = mutation.choose(build, folder, count, SEED)
    program = mutation.compile_mutants(mutants, folder)
    by = mutation.caught(program, script, len(mutants))
    unnoticed = [mutant for mutant, part in zip(mutants, by, strict=True) if part is None]
    # Some do nothing. Which ones are in the sample changes with the sources.
    assert len(unnoticed) <= len(mutants) // 4, unnoticed
    assert len(mutants) > COUNT // 2
