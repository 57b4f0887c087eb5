"""``pearl new``: an environment in a package of its own, to start from or made of somebody else's."""

from __future__ import annotations

import importlib.util
import keyword
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from pearl_marl.checks import checked_integer
from pearl_marl.cli import common
from pearl_marl.cli.common import console, say
from pearl_marl.envs import names
from pearl_marl.errors import ArgumentError
from pearl_marl.hardware import elaboration
from pearl_marl.spec import MAX_AGENTS, snake_case

WORLD = "AGENTS = 2"
"""What says in the template of a world how many agents share it."""

TESTS = "tests"
"""The folder of a new package's tests, beside that of its code."""

LONGEST = 64
"""Letters of a package's name; file systems take some 200 in all that is made of it."""


def command(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="The new environment's name, for example FrozenLake.")
    ],
    agents: Annotated[int, typer.Option(help="Number of agents that share a world.")] = 1,
    original: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="PACKAGE:CLASS|ID",
            help="An environment to follow, of Gymnasium or a parallel one of PettingZoo: CliffWalking-v1. "
            "Of a finite one the whole is made; of others a package to fill in, with tests against the "
            "original and a page, PORTING.md, that says how.",
        ),
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="An argument of the original; may be repeated."),
    ] = None,
    rules: Annotated[
        bool, typer.Option("--rules", help="Write a package to fill in even where the original is finite.")
    ] = False,
    out: Annotated[Path, common.folder_option("The folder to write the package into.")] = Path(),
    as_json: common.AsJson = False,
) -> None:
    """Write a package with a small environment of that name: golden step, spec, tests, all working.

    With --from it follows an environment that there is.
    """
    folder = _checked(name, out)
    if original is not None:
        if agents != 1:
            raise ArgumentError("--agents is for a world to start from; with --from the original has them")
        _follow(name, original, common.env_options(option), rules, folder, as_json)
        return
    if option or rules:
        raise ArgumentError(f"{'--rules' if rules else '--option'} is about the original of --from: give one")
    checked_integer("--agents", agents, 1, MAX_AGENTS)
    from pearl_marl.porting.package import filled, own_words

    words = {**own_words(name), WORLD: WORLD.replace("2", str(agents))}
    world = filled("world", words) if agents > 1 else {}
    if _write(folder, {**filled("environment", words), **world}, as_json):
        return
    console.print(
        f"It works as it is: [bold]cd {escape(str(folder))}[/], [bold]pip install -e '.\\[test]'[/], "
        f"[bold]pytest[/], [bold]pearl verify {snake_case(name)}:{name} --device rtl "
        f"--n-agents {64 * agents}[/].",
        soft_wrap=True,
    )


def _follow(
    name: str, original_name: str, options: dict[str, Any], rules: bool, folder: Path, as_json: bool
) -> None:
    """Write a package after an environment that there is."""
    from pearl_marl.porting.making import made

    package = made(name, original_name, options, rules)
    more = {"original": original_name, "whole": package.whole, "why": package.why}
    if _write(folder, package.files, as_json, **more):
        return
    say(package.said)
    snake = snake_case(name)
    install = f"[bold]cd {escape(str(folder))}[/], [bold]pip install -e '.\\[test]'[/]"
    if package.whole:
        against = escape(package.against)
        console.print(
            f"It is whole: {install}, [bold]pytest[/], "
            f"[bold]pearl verify {snake}:{name} --against {against}[/], "
            f"[bold]pearl verify {snake}:{name} --device rtl --steps 20 --n-agents 64[/].",
            soft_wrap=True,
        )
    else:
        console.print(f"Go on: {install}, and read [bold]PORTING.md[/].", soft_wrap=True)


def _write(folder: Path, files: Mapping[str, str | bytes], as_json: bool, **more: Any) -> bool:
    """Write files by their paths in a new folder, and say so; return whether that was all, as JSON.

    If that fails, nothing of it stays.
    """
    try:
        for relative, content in files.items():
            path = folder / relative
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
    except OSError as error:
        shutil.rmtree(folder, ignore_errors=True)  # half a package would be in the way of the next try
        raise ArgumentError(
            f"{folder} cannot be written: {error.strerror}; make room for it, or choose another --out"
        ) from None
    written = [str(path) for path in sorted(map(Path, files))]
    if as_json:
        common.print_json({"folder": str(folder), "files": written, **more})
        return True
    say(f"Wrote {folder}:")
    for name in written:
        say(f"  {name}")
    return False


def _checked(name: str, out: Path) -> Path:
    """Return the folder to make for an environment; refuse a name that cannot be one's, or is taken."""
    if not re.fullmatch(r"[A-Z][A-Za-z0-9]*", name):
        raise ArgumentError(
            f"name {name!r}: it takes letters and digits, a capital letter first, as in FrozenLake"
        )
    snake = snake_case(name)
    if len(snake) > LONGEST:
        raise ArgumentError(
            f"name {name!r}: its package's name has {len(snake)} letters; take {LONGEST} at most"
        )
    if snake == TESTS:
        raise ArgumentError(
            f"name {name!r}: the folder {TESTS!r} holds the package's tests; choose another name"
        )
    taken = next((other for other in names() if other.lower() == name.lower()), None)  # as get_spec() has it
    if taken is not None:
        raise ArgumentError(f"there is an environment {taken!r} already; choose another name")
    folder = out / snake
    if folder.exists() or folder.is_symlink():
        raise ArgumentError(f"{folder} exists already; choose another name, or another folder with --out")
    found = importlib.util.find_spec(snake)
    if keyword.iskeyword(snake) or (found is not None and found.origin is not None):  # None is a mere folder
        raise ArgumentError(
            f"name {name!r}: its package would be called {snake!r}, which Python has a meaning for already"
        )
    modules = {path.stem for path in elaboration.backbone_paths()}
    if {f"{snake}_pe", f"{snake}_pkg"} & modules:
        raise ArgumentError(f"name {name!r}: the backbone has a module of its core's name, {snake}_pe")
    return folder
