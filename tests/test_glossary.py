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

RETIRED_AS_DEFINITIONS = {"seen", "shown", "given", "part", "place", "told"}
"""Words that say too little as the name of a function, a class or an attribute; variables may have them."""


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


def definitions(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield the functions, classes and attributes that a module defines, without a leading underscore."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                yield node.lineno, name.removeprefix("_")
            case ast.Attribute(attr=name, ctx=ast.Store()):
                yield node.lineno, name.removeprefix("_")


FILES = sorted(
    path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py") if "templates" not in path.parts
)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_name_is_a_retired_word(path: Path) -> None:
    tree = ast.parse(path.read_text())
    found = [(line, name) for line, name in names(tree) if name in RETIRED]
    found += [(line, name) for line, name in definitions(tree) if name in RETIRED_AS_DEFINITIONS]
    assert found == []


def test_a_retired_word_is_noticed() -> None:
    tree = ast.parse("def bury(gone):\n    return self.way_on\ndef _place(part):\n    self.given = part")
    assert {name for _, name in names(tree)} & RETIRED == {"bury", "gone", "way_on"}
    assert {name for _, name in definitions(tree)} & RETIRED_AS_DEFINITIONS == {"place", "given"}


def test_no_module_has_a_retired_name() -> None:
    assert [path for path in FILES if path.stem in RETIRED] == []
