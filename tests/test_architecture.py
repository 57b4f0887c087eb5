"""The order of the layers: what may import what, in code, in type annotations, and by string.

The table in ``docs/architecture.md`` is the order. These tests enforce it: a layer imports only layers below
it, no files import each other in a circle, and no module uses another one's private names.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

LAYERS = [
    re.findall(r"`(\w+)(?:/|\.py)`", line.split("|")[1])
    for line in (ROOT / "docs" / "architecture.md").read_text().splitlines()
    if line.startswith("| `")
][::-1]
"""From the lowest up, of what each consists: folders, and files at the top of the package.

The package itself, ``pearl_marl/__init__.py``, is above all: no module imports it.
"""

HEIGHTS = {part: height for height, layer in enumerate(LAYERS) for part in layer}

OUTSIDE = ("rtl", "envs", "wrappers", "experiments")
"""Folders of the repository that are linked into the package."""

SCRIPTS = {"benchmarl_foraging", "cliff_walking_q_learning", "sb3_rollout", "sb3_training"}
"""Experiments that are programs of their own: they import the package itself, as a user does."""

PACKAGE = "pearl_marl"

IMPORTERS = ("import_module", "__import__", "importorskip")


def modules() -> dict[str, Path]:
    """Every module of the package by its name, without the package's own."""
    found = {}
    for folder, prefix in ((ROOT / PACKAGE, ()), *((ROOT / PACKAGE / name, (name,)) for name in OUTSIDE)):
        for path in folder.rglob("*.py"):
            parts = (*prefix, *path.relative_to(folder).with_suffix("").parts)
            if "templates" not in parts:
                found[".".join(parts).removesuffix(".__init__")] = path
    return found


MODULES = modules()


def resolved(name: str) -> str:
    """Return the module that a dotted name is of: itself, or what it is an attribute of."""
    parts = name.split(".")
    while parts and ".".join(parts) not in MODULES:
        parts.pop()
    return ".".join(parts) or "__init__"


def imports(module: str, text: str, is_package: bool = False) -> Iterator[str]:
    """Yield what a module imports of this package, wherever in it and however."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                here = [PACKAGE, *module.split(".")]
                here = here[: len(here) - node.level + is_package]
                base = ".".join([*here, *([base] if base else [])])
            names = [f"{base}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            # A string that is nothing but a path of this package, with or without an attribute after a colon.
            path = re.fullmatch(rf"({PACKAGE}(\.\w+)+)(:.*)?", node.value)
            names = [path[1]] if path else []
        elif isinstance(node, ast.JoinedStr) and isinstance(node.values[0], ast.Constant):
            # Of a path that is put together, what is fixed.
            fixed = re.match(rf"{PACKAGE}\.[\w.]*", str(node.values[0].value))
            names = [fixed[0].rstrip(".")] if fixed else []
        elif isinstance(node, ast.Attribute):
            names = [path[0]] if (path := re.fullmatch(rf"{PACKAGE}(\.\w+)+", ast.unparse(node))) else []
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in IMPORTERS:
            # Alone, the name of the package may be any string.
            names = [PACKAGE] if any(ast.unparse(a) == repr(PACKAGE) for a in node.args) else []
        else:
            continue
        for name in names:
            if name == PACKAGE or name.startswith(f"{PACKAGE}."):
                yield resolved(name.removeprefix(PACKAGE).removeprefix("."))


def graph() -> dict[str, set[str]]:
    """Every module with those that it imports. What a package re-exports is its own part's."""
    return {
        module: set(imports(module, path.read_text(), path.stem == "__init__")) - {module}
        for module, path in MODULES.items()
        if module != "__init__"
    }


def top(module: str) -> str:
    """Return the folder or file at the top of the package that a module is in."""
    return module.partition(".")[0]


def upward(module: str, others: set[str]) -> list[str]:
    """Return the imports of a module that do not lead down, or stay in its layer."""
    height = HEIGHTS[top(module)]
    return [other for other in sorted(others) if other == "__init__" or HEIGHTS[top(other)] > height]


def circles(edges: dict[str, set[str]]) -> list[list[str]]:
    """Return the groups of modules that import each other (Tarjan, 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(module: str) -> None:
        index[module] = low[module] = len(index)
        stack.append(module)
        for other in sorted(edges.get(module, ())):
            if other not in index:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in stack:
                low[module] = min(low[module], index[other])
        if low[module] == index[module]:
            group = stack[stack.index(module) :]
            del stack[stack.index(module) :]
            if len(group) > 1:
                found.append(group)

    for module in sorted(edges):
        if module not in index:
            visit(module)
    return found


def test_every_module_is_in_one_layer() -> None:
    assert sorted({top(module) for module in MODULES} - {"__init__"}) == sorted(
        part for layer in LAYERS for part in layer
    )


def test_imports_lead_down() -> None:
    wrong = {module: up for module, others in graph().items() if (up := upward(module, others))}
    assert wrong == {f"experiments.{script}": ["__init__"] for script in SCRIPTS}


def test_no_modules_import_each_other() -> None:
    assert circles(graph()) == []


@pytest.mark.parametrize(
    "line",
    [
        "from pearl_marl.cli import common",
        "import pearl_marl.training.ppo",
        "def f():\n    from pearl_marl.interfaces.parallel import parallel_env",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from pearl_marl.devices import Device",
        "import importlib\nimportlib.import_module('pearl_marl.experiments.report')",
        "entry_point = 'pearl_marl.interfaces.vector:make_vec'",
        "entry_point = f'pearl_marl.interfaces.{name}'",
        "module = f'pearl_marl.{name}'",
        "from ..interfaces import parallel",
        "from .. import cli",
        "__import__('pearl_marl')",
        "import pearl_marl.batch\npearl_marl.cli.common.console",
        "import pearl_marl",
        "from pearl_marl import parallel_env",
    ],
)
def test_a_wrong_import_is_seen(line: str) -> None:
    assert upward("batch.actions", set(imports("batch.actions", line)))


def test_a_circle_is_seen() -> None:
    edges = {"batch.actions": {"batch.step"}, "batch.step": {"spec"}, "spec": {"batch.actions"}}
    assert [sorted(group) for group in circles(edges)] == [["batch.actions", "batch.step", "spec"]]


def test_experiments_are_imported_by_the_report_alone() -> None:
    inside = {module: others for module, others in graph().items() if top(module) != "experiments"}
    users = {module for module, others in inside.items() if any(top(o) == "experiments" for o in others)}
    assert users == {"cli.report"}


# ---- Names of classes ----


def test_no_classes_share_a_name() -> None:
    """Except those of environments: each is a page of its own, with a ``State`` and perhaps a ``Cell``."""
    places: dict[str, list[str]] = {}
    for module, path in sorted(MODULES.items()):
        if top(module) == "envs":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(module)
    assert len(places) > 400
    assert {name: modules for name, modules in places.items() if len(modules) > 1} == {}


# ---- Private names ----

LIBRARIES = {
    "_asdict": "every NamedTuple's",
    "_replace": "every NamedTuple's",
    "_fields": "every NamedTuple's, and every node's of Python's syntax",
    "_attributes": "every node's of Python's syntax",
    "_pytree": "of PyTorch, where every library registers its containers",
    "_reset_seeds": "Stable-Baselines3's, for who derives from it",
    "_get_indices": "Stable-Baselines3's, likewise",
    "_setup_learn": "Stable-Baselines3's, likewise",
    "_exit": "of Python's os",
    "_getvalue": "of Numba's structures, as its own intrinsics use it",
}


def private(name: str) -> bool:
    return name.startswith("_") and not (name.startswith("__") and name.endswith("__"))


ACCESS = {"getattr", "setattr", "hasattr", "delattr"}


def strangers(text: str) -> list[str]:
    """Return the private names that a module uses and does not define: they are another module's."""
    tree = ast.parse(text)
    own: set[str] = set()
    used: list[tuple[int, str]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            for inside in node.body:
                targets = (
                    inside.targets if isinstance(inside, ast.Assign) else [getattr(inside, "target", None)]
                )
                own |= {target.id for target in targets if isinstance(target, ast.Name)}
                if isinstance(inside, (ast.FunctionDef, ast.AsyncFunctionDef)):
                    own.add(inside.name)
        elif isinstance(node, ast.Attribute) and private(node.attr):
            if isinstance(node.ctx, ast.Store) and ast.unparse(node.value) == "self":
                own.add(node.attr)
            else:
                used.append((node.lineno, node.attr))
        elif isinstance(node, ast.ImportFrom):
            names = (alias.name for alias in node.names if alias.name not in LIBRARIES)
            used += [(node.lineno, f"{name} of it") for name in names if private(name)]
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ACCESS and len(node.args) > 1:
            name = getattr(node.args[1], "value", None)
            used += [(node.lineno, name)] if isinstance(name, str) and private(name) else []
    return [f"{line}: {name}" for line, name in sorted(used) if name not in own | set(LIBRARIES)]


@pytest.mark.parametrize("module", sorted(m for m in MODULES if m != "__init__"))
def test_no_module_uses_anothers_private_names(module: str) -> None:
    assert strangers(MODULES[module].read_text()) == []


@pytest.mark.parametrize(
    "text",
    [
        "def f(device):\n    return device._transport",
        "from pearl_marl.envs import _specs",
        "class Mine(Device):\n    def _step(self, actions):\n        return self._tick",
        "def f(device):\n    _tick = 3\n    return device._tick",
        "def f(device):\n    return getattr(device, '_tick')",
    ],
)
def test_a_strangers_name_is_seen(text: str) -> None:
    assert strangers(text)


def test_every_exception_is_needed() -> None:
    attributes = {
        node.attr if isinstance(node, ast.Attribute) else node.name
        for path in MODULES.values()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, (ast.Attribute, ast.alias))
    }
    assert set(LIBRARIES) <= attributes


def test_lengths_that_must_agree_are_held_to_it() -> None:
    """Ruff (B905) wants ``strict`` said; with False, what is left over is dropped without a word."""
    loose = re.compile(r"\bstrict\s*=\s*" + "False")
    folders = ("pearl_marl", "envs", "wrappers", "experiments", "examples", "docs", "tests")
    files = [
        path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".ipynb")
    ]
    assert len(files) > 300
    assert [path for path in files if loose.search(path.read_text())] == []
