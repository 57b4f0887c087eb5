"""``pearl quantize``: a trained policy in integers, which devices run beside their environments."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from pearl_marl.cli import common
from pearl_marl.cli.common import console, error_console
from pearl_marl.errors import ArgumentError

AGENTS, BITS = 1000, 8


def command(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="A folder of `pearl train`, or its policy.safetensors.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.safetensors",
            help="The file to write.",
            show_default="integers.safetensors in the run folder",
        ),
    ] = None,
    weight_bits: Annotated[int, typer.Option(min=4, max=16, help="Width of weights.")] = BITS,
    activation_bits: Annotated[
        int, typer.Option(min=4, max=16, help="Width of what goes from layer to layer.")
    ] = BITS,
    n_agents: Annotated[int | None, common.agents_option(AGENTS)] = None,
    seed: common.Seed = 0,
    as_json: common.AsJson = False,
) -> None:
    """Make a policy in integers of a trained one, and measure the returns of both.

    Devices run such a policy beside their environments: see `rollout()`. The change of the return is printed
    with its 95 % confidence interval.
    """
    figures = quantize_run(run, out, weight_bits, activation_bits, n_agents, seed)
    if as_json:
        common.print_json(figures)
    else:
        show(figures)


def quantize_run(
    run: Path,
    out: Path | None = None,
    weight_bits: int = BITS,
    activation_bits: int = BITS,
    n_agents: int | None = None,
    seed: int = 0,
) -> dict[str, Any]:
    """Write the policy in integers of a run, by default into its folder; return the returns of both."""
    from pearl_marl.policies import integer_file

    folder = run if run.is_dir() else run.parent
    file = folder / integer_file.NAME if out is None else out
    if file.suffix != ".safetensors":
        raise ArgumentError(f"--out is {file}; it must be a file that ends in .safetensors")
    common.check_file("--out", file)
    try:
        from pearl_marl.evaluation.quantization import Quantization

        work = Quantization(run, seed, weight_bits, activation_bits)
    except ModuleNotFoundError as error:
        raise ArgumentError(f"{run} takes {error.name}: pip install '.[train]'") from None
    n_agents = common.agents_of(work.spec, n_agents, AGENTS)
    for _ in common.progress(work.run(n_agents), 2 * n_agents, "Evaluating"):
        pass
    integer_file.save(work.network, file)
    return {**work.summary(), "file": str(file)}


def check(policy: Any) -> None:
    """Refuse ``--quantize`` of a training whose policy does not become integers, before it begins."""
    from pearl_marl.policies.quantizing import check_quantizable

    try:
        check_quantizable(policy)
    except ArgumentError as error:
        raise ArgumentError(f"--quantize: {error}") from None


def show(figures: dict[str, Any]) -> None:
    """Print the returns of a trained policy and of the one in integers, and where that is."""
    grid = common.table(f"Return of {figures['environment']}", ["policy"], ["mean", "95 % confidence"])
    widths = f"{figures['weight_bits']}-bit weights, {figures['activation_bits']}-bit activations"
    for name, row in (
        ("trained", figures["return_before"]),
        (f"in integers ({widths})", figures["return_after"]),
        ("change", figures["change"]),
    ):
        low, high = row["ci95_low"], row["ci95_high"]
        grid.add_row(name, f"{row['mean']:,.2f}", "-" if low is None else f"{low:,.2f} to {high:,.2f}")
    console.print(grid)
    if (figures["change"]["ci95_high"] or 0) < 0:
        error_console.print(
            f"The policy in integers is worse, by {-figures['change']['mean']:,.2f}: more bits may help "
            "(--weight-bits, --activation-bits).",
            soft_wrap=True,
        )
    common.say(f"Wrote {figures['file']}.")
