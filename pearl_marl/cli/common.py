"""What the commands share: options that mean the same everywhere, and how results are shown."""

from __future__ import annotations

import ast
import contextlib
import json
import os
import re
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TypeVar

import typer
from rich.console import Console
from rich.markup import escape

from pearl_marl.base.files import check_files, replace_file
from pearl_marl.checks import MANY
from pearl_marl.envs import get_spec, names
from pearl_marl.errors import ArgumentError

if TYPE_CHECKING:
    from rich.progress import Progress, TextColumn
    from rich.table import Table

    from pearl_marl.benchmark.tables import MeasuredTable
    from pearl_marl.devices import Device
    from pearl_marl.errors import LockstepError
    from pearl_marl.policies.device_policy import DevicePolicy
    from pearl_marl.spec import EnvSpec

T = TypeVar("T")

if os.environ.get("COLUMNS") == "0":  # of a terminal that does not know: Rich would print nothing
    del os.environ["COLUMNS"]
# Without emojis, which a path or a name such as a:b:c would become.
console = Console(highlight=False, emoji=False)
error_console = Console(stderr=True, highlight=False, emoji=False)

ABOUT = 43008
"""How many agents a command has by default: the paper's number, or a little less to have whole worlds."""


def completed(possible: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Return what tells a shell the words that one may become."""

    def complete(incomplete: str) -> list[str]:  # Typer wants this name
        return [name for name in possible() if name.startswith(incomplete)]

    return complete


EnvName = Annotated[
    str,
    typer.Argument(metavar="ENV", help="An environment of `pearl envs`.", autocompletion=completed(names)),
]


def agents_option(about: int) -> Any:
    """Return the option that says how many agents a command has; about so many by default."""
    return typer.Option(
        min=1, help="Number of agents; a multiple of the agents of a world.", show_default=f"about {about:,}"
    )


def max_cycles_option(show_default: bool | str = True) -> Any:
    """Return the option that limits episodes, with what it says of its default."""
    from pearl_marl.spec import MAX_CYCLES

    return typer.Option(
        min=0, max=MAX_CYCLES, help="Time limit of an episode, 0 for none.", show_default=show_default
    )


Agents = Annotated[int | None, agents_option(ABOUT)]
DEVICES = ("native", "rtl", "cuda", "reference", "xdma", "serial")
DeviceName = Annotated[
    str, typer.Option(help="The device that steps the agents.", autocompletion=completed(lambda: DEVICES))
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")]
Steps = Annotated[int, typer.Option(min=1, max=MANY, help="Number of steps of every agent.")]


def check_folder(option: str, folder: Path) -> None:
    """Refuse a folder that cannot be written, before the work whose results go there; make nothing."""
    folders = folder, *folder.absolute().parents
    try:
        there = next(path for path in folders if path.exists() or path.is_symlink())
        with tempfile.TemporaryFile(dir=there):  # what permissions say, they do not say to root
            pass
    except OSError as error:
        raise ArgumentError(
            f"{option} {folder} is no folder that can be written: {error.strerror}; choose another"
        ) from None


def check_file(option: str, path: Path) -> None:
    """Refuse a file that cannot be written, before the work; make nothing."""
    check_folder(option, path.parent)
    check_files(path.parent, path.name)


def check_results(out: Path | None, *names: str) -> None:
    """Refuse an ``--out`` folder where a result of one of these names cannot be written, before the work."""
    if out is not None:
        check_files(out, *names)


def _writable(parameter: typer.CallbackParam, folder: Path | None) -> Path | None:
    if folder is not None:
        check_folder(parameter.opts[0], folder)
    return folder


def folder_option(use: str, show_default: bool | str = True) -> Any:
    """Return an option that names a folder to write into, which is refused if that cannot be."""
    return typer.Option(metavar="DIR", help=use, callback=_writable, show_default=show_default)


Out = Annotated[Path | None, folder_option("Where to write results.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]
AsMarkdown = Annotated[bool, typer.Option("--markdown", help="Print the table in Markdown.")]
InLockstep = Annotated[
    bool, typer.Option("--lockstep", help="Compare every word of every step with the golden functions.")
]
REFERENCE = "reference"
"""The device that ``--lockstep`` compares with."""
Options = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=VALUE", help="An argument of the environment; may be repeated."),
]


def device_policy_option(use: str) -> Any:
    """Return the option that names a policy which :func:`device_policy` reads, and what for."""
    return typer.Option(
        metavar="FILE|FILE.py:NAME",
        help=f"{use} A file of `pearl quantize`, or the name of a GoldenPolicy in a file.",
    )


EnginePolicy = Annotated[
    str | None, device_policy_option("The policy that the hardware gets a policy engine for.")
]


def device_policy(name: str | None, spec: EnvSpec) -> DevicePolicy | None:
    """Return the policy of that name, which runs beside an environment; ``None`` if none is named."""
    from pearl_marl.policies import integer_file, loading
    from pearl_marl.policies.device_policy import DevicePolicy

    if name is None:
        return None
    module, colon, member = name.rpartition(":")
    if not (module and colon and member.isidentifier()):
        return integer_file.load_policy(name)
    policy = loading.load_policy(name, spec)
    if not isinstance(policy, DevicePolicy):
        raise ArgumentError(
            f"--policy {name} is a function of arrays, which cannot run beside the environments; make it a "
            "golden function: GoldenPolicy(spec, act)"
        )
    return policy


def env_options(pairs: Iterable[str] | None, option: str = "--option") -> dict[str, Any]:
    """Turn ``["is_slippery=true"]`` into keyword arguments; values are JSON, Python's, or strings."""
    result: dict[str, Any] = {}
    for pair in pairs or ():
        name, equals, value = pair.partition("=")
        if not equals:
            raise ArgumentError(f"{option} is {pair!r}; it must be NAME=VALUE")
        if (key := name.replace("-", "_")) in result:
            raise ArgumentError(f"{option} gives {key} twice; give it once")
        result[key] = _literal(value)
    return result


def _literal(text: str) -> Any:
    for read in (json.loads, ast.literal_eval):
        with contextlib.suppress(ValueError, SyntaxError, RecursionError, MemoryError):
            return read(text)
    return text


def spec_of(env_id: str, options: Iterable[str] | None) -> EnvSpec:
    """Return the spec that a command is about; ``options`` can only be the environment's own arguments."""
    return get_spec(env_id).with_options(**env_options(options))


def agents_of(spec: EnvSpec, given: int | None, about: int = ABOUT) -> int:
    """Return how many agents a command has: as many as are given, or about so many, in whole worlds."""
    return max(about // spec.agents, 1) * spec.agents if given is None else given


def simulated(device: str) -> bool:
    """Return whether a device is simulated hardware, so that its times say nothing of a board's."""
    name, _, where = device.partition(":")
    return name == "rtl" or (name == "xdma" and bool(where) and not where.isdecimal())


def on_device(what: str, device: str) -> str:
    """Return the title of figures of something on a device; of simulated hardware it says so."""
    return f"{what} on {escape(device)}" + (
        ", simulated: times are the simulator's" if simulated(device) else ""
    )


def counted(n: int, what: str) -> str:
    """Return a number with the name of what is counted: ``1 slot``, ``7 slots``."""
    return f"{n:,} {what}{'' if n == 1 else 's'}"


def device_maker(device: str, lockstep: bool) -> Callable[[], str | Device]:
    """Return a function that makes the device to step with; in lockstep it is compared with the reference."""
    from pearl_marl.devices import Lockstep

    if not lockstep:
        return lambda: device
    if device == REFERENCE:
        raise ArgumentError(
            f"--lockstep compares with {REFERENCE!r}, which always agrees with itself: name another --device"
        )
    return lambda: Lockstep(device, REFERENCE)


def in_file_name(device: str) -> str:
    """Return a device's name as it can be part of a file's: ``xdma:/dev/shm/board`` has more than letters."""
    return re.sub(r"[^\w.-]+", "_", device)


def divergence_file(spec: EnvSpec, device: str) -> str:
    """Return the name of the file that tells where a device differs from the golden functions."""
    return f"divergence_{spec.name}_{in_file_name(device)}.json"


def progress_bar(*more: TextColumn) -> Progress:
    """Return a progress bar on standard error, so that standard output stays for results; more at its end."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    text = TextColumn("{task.description}", markup=False)
    columns = (text, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), *more)
    return Progress(*columns, console=error_console, transient=True, disable=not error_console.is_terminal)


def progress(items: Iterable[T], total: int, label: str) -> Iterator[T]:
    """Iterate with a progress bar."""
    with progress_bar() as bar:
        yield from bar.track(items, total=total, description=label, update_period=0.2)


def table(title: str, text: Iterable[str], figures: Iterable[str]) -> Table:
    """Return an empty table: columns of text, then columns of figures, each as wide as what is in it."""
    from rich.table import Table

    made = Table(title=title)
    for heading in text:
        made.add_column(heading, no_wrap=True)
    for heading in figures:
        made.add_column(heading, justify="right", no_wrap=True)
    return made


def warn_of_old_form(old: Iterable[str], new: Iterable[str]) -> None:
    """Warn of a form of a command that works for one version more, and name the form to use."""
    sentence = f"`pearl {shlex.join(old)}` works for one version more: use `pearl {shlex.join(new)}`"
    error_console.print(sentence, markup=False, soft_wrap=True)


def check_forms(as_json: bool, as_markdown: bool) -> None:
    """Refuse two forms of a result at once."""
    if as_json and as_markdown:
        raise ArgumentError("--json and --markdown are two forms of the same: leave one out")


def print_table(title: str, made: MeasuredTable, notes: Iterable[str], as_markdown: bool) -> None:
    """Print a measurement's table as a grid or in Markdown, and notes below it."""
    if as_markdown:
        typer.echo("\n".join([made.markdown(), "", *notes]))
        return
    from rich import box
    from rich.table import Table

    grid = Table(title=title, box=box.SIMPLE, padding=0, collapse_padding=True)  # all fits into 80 columns
    for column, heading in enumerate(made.headings):
        text = column in made.text
        # A long name is folded, and leaves the figures their room.
        grid.add_column(heading, justify="left" if text else "right", no_wrap=not text, overflow="fold")
    for row in made.rows:
        grid.add_row(*(escape(cell.replace("**", "")) for cell in row))
    console.print(grid)
    for note in notes:
        console.print(escape(note), style="dim")


def say(text: str) -> None:
    """Print a sentence with names and paths in it, which are not broken where lines end."""
    console.print(text, markup=False, soft_wrap=True)


def replaying(path: Path, **named: str) -> str:
    """Return the command that replays a file: with what that does not say, or nobody takes from a file."""
    return f"pearl verify {path}" + "".join(
        f" --{name} {value}" for name, value in named.items() if ":" in value
    )


def end_with(error: LockstepError, out: Path | None, file: str, env_id: str, device: str) -> NoReturn:
    """Print where a device differs, write the file that replays it, and end with status 1."""
    error_console.print(f"[bold red]Not bit-exact.[/] {escape(str(error))}", soft_wrap=True)
    if out is not None:
        path = out / file
        error.replay.write(path)
        again = replaying(path, env=env_id, device=device)
        error_console.print(f"Wrote {path}: {again} replays it.", markup=False, soft_wrap=True)
    sys.exit(1)


def print_json(value: Any) -> None:
    """Print a result for machines."""
    typer.echo(json.dumps(value, indent=2))


def write_json(folder: Path, name: str, value: Any) -> Path:
    """Write a result into the ``--out`` folder; return its path."""
    path = folder / name
    replace_file(path, f"{json.dumps(value, indent=2)}\n".encode())
    return path


def delivered(result: Any, as_json: bool, out: Path | None, name: str) -> bool:
    """Write a result into the ``--out`` folder, if there is one; print it if machines want it, and say so."""
    if out is not None:
        write_json(out, name, result)
    if as_json:
        print_json(result)
    return as_json
