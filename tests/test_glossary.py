"""Words that were retired stay so: no function, class, argument, variable or attribute has them as a name."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

FOLDERS = "pearl_marl", "envs", "wrappers", "experiments", "examples"

RETIRED = {
    *("remaking", "mends", "Apart", "GIVEN", "gone", "dead", "bury", "hide", "learned"),
    *("travelling", "parcel", "filling", "way_on"),
}
"""Private words of earlier versions; ``docs/concepts.md`` has those that are used."""


def names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield the names that a module gives or uses, with their lines."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                yield node.lineno, name
            case ast.arg(arg=name) | ast.Name(id=name) | ast.Attribute(attr=name):
                yield node.lineno, name
            case ast.alias():
                yield node.lineno, (node.asname or node.name).rpartition(".")[2]


FILES = sorted(
    path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py") if "templates" not in path.parts
)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_name_is_a_retired_word(path: Path) -> None:
    tree = ast.parse(path.read_text())
    found = [(line, name) for line, name in names(tree) if name in RETIRED]
    assert found == []


def test_a_retired_word_is_noticed() -> None:
    text = "def bury(gone):\n    return self.way_on"
    assert {name for _, name in names(ast.parse(text))} & RETIRED == {"bury", "gone", "way_on"}


def test_no_module_has_a_retired_name() -> None:
    assert [path for path in FILES if path.stem in RETIRED] == []
