"""``pearl envs``: the table of environments."""

from __future__ import annotations

from typing import Any

from rich.markup import escape
from rich.table import Table

from pearl_marl.cli.common import AsJson, console, print_json
from pearl_marl.registry import get_spec, names
from pearl_marl.spec import EnvSpec, word_bits


def command(as_json: AsJson = False) -> None:
    """List the environments: spaces, widths, rewards, limits."""
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
        rewards = "computed" if row["rewards"] is None else ", ".join(f"{r:g}" for r in row["rewards"])
        table.add_row(
            f"[bold]{row['name']}[/]\n{row['summary']}\n[dim]{escape(arguments)}[/]",
            f"observation {row['observation_space']}\naction {row['action_space']}",
            "\n".join(f"{word} {bits}" for word, bits in row["bits"].items()),
            f"{rewards}\nlimit {row['max_cycles'] or 'none'}",
        )
    console.print(table)


def _row(spec: EnvSpec) -> dict[str, Any]:
    return {
        "name": spec.name,
        "id": spec.id,
        "summary": spec.summary,
        "observation_space": str(spec.observation_space),
        "action_space": str(spec.action_space),
        "bits": {
            "state": word_bits(spec.state),
            "action": spec.action.bits,
            "observation": word_bits(spec.observation),
            "reward": spec.reward.bits,
        },
        "rewards": spec.rewards,
        "max_cycles": spec.max_cycles,
        "options": dict(spec.options),
        "oracle": spec.oracle,
    }
