"""``pearl envs``: the table of environments."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from gymnasium import Space
from gymnasium.spaces import Box, Tuple
from rich.markup import escape
from rich.table import Table

from pearl_marl.benchmark.paper import TABLE_2
from pearl_marl.benchmark.tables import MeasuredTable
from pearl_marl.cli.common import AsJson, check_forms, console, print_json
from pearl_marl.envs import get_spec, names
from pearl_marl.spec import EnvSpec, snake_case, word_bits


def command(
    as_json: AsJson = False,
    as_markdown: Annotated[
        bool,
        typer.Option("--markdown", help="Print the tables of docs/environments.md in Markdown."),
    ] = False,
) -> None:
    """List the environments: spaces, widths, rewards, limits."""
    check_forms(as_json, as_markdown)
    if as_markdown:
        typer.echo(markdown([get_spec(name) for name in names()]), nl=False)
        return
    rows = [_row(get_spec(name)) for name in names()]
    if as_json:
        print_json(rows)
        return
    table = Table(title="Environments", show_lines=True)
    table.add_column("environment")
    table.add_column("spaces")
    table.add_column("bits", no_wrap=True)
    table.add_column("rewards and limit")
    for row in rows:
        arguments = ", ".join(f"{name}={value}" for name, value in row["options"].items())
        follows = f"follows {row['follows']}\n" if row["follows"] else ""
        table.add_row(
            f"[bold]{row['name']}[/]\n{row['summary']}\n{follows}{_world(row)}[dim]{escape(arguments)}[/]",
            f"observation {row['observation_space']}\naction {row['action_space']}",
            "\n".join(f"{word} {bits}" for word, bits in row["bits"].items()),
            f"{_rewards(row['rewards'])}\nlimit {row['max_cycles'] or 'none'}",
        )
    console.print(table)


def _row(spec: EnvSpec) -> dict[str, Any]:
    return {
        "name": spec.name,
        "id": spec.id,
        "summary": spec.summary,
        "agents": spec.agents,
        "roles": [role.name for role in spec.roles],
        "turns": spec.turns,
        "masks": spec.masked if spec.mask_fields else None,
        "observation_space": str(spec.observation_space),
        "action_space": str(spec.action_space),
        "bits": dict(zip(("state", "action", "observation", "reward"), _widths(spec), strict=True)),
        "rewards": spec.rewards,
        "max_cycles": spec.max_cycles,
        "options": dict(spec.options),
        "oracle": spec.oracle,
        "follows": _followed(spec),
    }


def _followed(spec: EnvSpec) -> str | None:
    """Return package and name of the environment that this one follows with its default options."""
    return spec.follows or (f"Gymnasium {spec.oracle}" if spec.oracle else None)


def _rewards(table: tuple[float, ...] | None) -> str:
    if table is None:
        return "computed"
    if len(table) > 16:
        return f"{len(table)} from {min(table):g} to {max(table):g}"
    return ", ".join(f"{reward:g}" for reward in table)


def _world(row: dict[str, Any]) -> str:
    """Return a line about what agents share; nothing of environments where each is alone."""
    parts = [f"{row['agents']} agents a world"] if row["agents"] > 1 else []
    parts += [f"roles {', '.join(dict.fromkeys(row['roles']))}"] if row["roles"] else []
    parts += ["in turns"] if row["turns"] else []
    if row["masks"]:
        parts.append("masked actions are " + ("refused" if row["masks"] == "refused" else "stays"))
    return f"{'; '.join(parts)}\n" if parts else ""


def _widths(spec: EnvSpec) -> list[int]:
    words = spec.state, spec.action_fields, spec.observation, (spec.reward,)
    return [word_bits(word) for word in words]


def markdown(specs: list[EnvSpec]) -> str:
    """Return the tables of ``docs/environments.md``: every environment, and widths beside the paper's."""
    headings = (
        *("environment", "observation and action space", "time limit"),
        *("bits: state, action, observation, reward", "arguments", "follows"),
    )
    rows = [
        (
            f"[**{spec.name}**](../envs/{snake_case(spec.name)}/README.md)<br>{spec.summary}",
            f"{_space(spec.observation_space)}<br>{_space(spec.action_space)}",
            str(spec.max_cycles or "none"),
            ", ".join(map(str, _widths(spec))),
            "<br>".join(f"`{name}={_rounded(value)!r}`" for name, value in spec.options.items()) or "none",
            "{} `{}`".format(*followed.split(" ")) if (followed := _followed(spec)) else "none",
        )
        for spec in specs
    ]
    paper = []
    for spec in specs:
        if spec.name in TABLE_2:
            pairs = zip(_widths(spec), TABLE_2[spec.name].widths, strict=True)
            paper.append((spec.name, *(f"{ours} ({theirs})" for ours, theirs in pairs)))
    every = MeasuredTable(headings, rows, range(len(headings))).markdown()
    widths = MeasuredTable(("environment", "state", "action", "observation", "reward"), paper).markdown()
    return f"{every}\n\nBits of a word, in parentheses those of the paper:\n\n{widths}\n"


def _space(space: Space[Any]) -> str:
    if isinstance(space, Tuple):
        return f"`Tuple({', '.join(map(str, space.spaces))})`"
    if isinstance(space, Box) and space.dtype is not None:  # bounds of every element would fill the page
        return f"`Box{space.shape}`, `{space.dtype}`"
    return f"`{space}`"


def _rounded(value: Any) -> Any:
    return round(value, 4) if isinstance(value, float) else value
