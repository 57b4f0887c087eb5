"""What is in the wheel and in the source distribution, and that the files of a release are well-formed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from typing import Any

import pytest

import pearl_marl

ROOT = Path(__file__).parents[1]
LINKED = "envs", "experiments", "rtl", "wrappers"
"""Folders of the repository that are linked into the package, and lie in it where they are distributed."""


def tracked() -> list[str]:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("this is no git repository")
    return [name for name in listed.stdout.split() if os.path.lexists(ROOT / name)]


def distributed() -> list[str]:
    """Return every file by its name in a distribution."""
    links = {f"pearl_marl/{folder}" for folder in LINKED}
    inside = tuple(f"{folder}/" for folder in LINKED)
    names = (name for name in tracked() if name not in links)
    return sorted(f"pearl_marl/{name}" if name.startswith(inside) else name for name in names)


@pytest.fixture(scope="module")
def built(once: Any) -> Path:
    def build(folder: Path) -> None:
        for name in tracked():
            (folder / "tree" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / "tree" / name, follow_symlinks=False)
        command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, folder / "tree"]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "Package would be ignored" not in done.stdout + done.stderr

    return once("distribution", build)


def test_the_wheel_has_the_package_and_nothing_else(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert sorted(names) == [name for name in distributed() if name.startswith("pearl_marl/")]


def test_the_source_distribution_is_the_repository(built: Path) -> None:
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as files:
        names = {member.name.partition("/")[2] for member in files if member.isfile()}
    made = {name for name in names if ".egg-info/" in name or name in ("PKG-INFO", "setup.cfg")}
    assert sorted(names - made) == [name for name in distributed() if not name.startswith(".git")]


def test_the_files_are_ready_for_the_index(built: Path) -> None:
    files = [*built.glob("*.whl"), *built.glob("*.tar.gz")]
    done = subprocess.run(
        [sys.executable, "-m", "twine", "check", "--strict", *files], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_changelog_has_this_version() -> None:
    text = (ROOT / "CHANGELOG.md").read_text()
    assert f"\n## [{pearl_marl.__version__}]" in text


SCHEMAS = {
    "vendor.github-workflows": ".github/workflows/*.yml",
    "vendor.github-issue-forms": ".github/ISSUE_TEMPLATE/[!c]*.yml",
    "vendor.github-issue-config": ".github/ISSUE_TEMPLATE/config.yml",
    "vendor.citation-file-format": "CITATION.cff",
}


@pytest.mark.parametrize("schema", SCHEMAS)
def test_files_that_others_read_follow_their_schema(schema: str) -> None:
    pytest.importorskip("check_jsonschema", reason="check-jsonschema is not installed: pip install '.[dev]'")
    files = sorted(ROOT.glob(SCHEMAS[schema]))
    assert files
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", schema, *map(str, files)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_citation_names_this_version() -> None:
    assert f"\nversion: {pearl_marl.__version__}\n" in (ROOT / "CITATION.cff").read_text()
