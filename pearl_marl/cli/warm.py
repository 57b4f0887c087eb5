"""``pearl warm``: kernels compiled ahead."""

from __future__ import annotations

from typing import Annotated

import typer

from pearl_marl.cli import common
from pearl_marl.cli.common import console
from pearl_marl.errors import ArgumentError
from pearl_marl.registry import names

SomeEnvs = Annotated[
    list[str] | None,
    typer.Argument(metavar="[ENV ...]", help="Environments of `pearl envs`; all of them if none is named."),
]


def command(env_ids: SomeEnvs = None, option: common.Options = None, as_json: common.AsJson = False) -> None:
    """Compile the kernels of environments ahead, for images and clusters: first steps are then fast."""
    from pearl_marl.cache import cache_folder
    from pearl_marl.devices.warming import warm_all

    if option and not env_ids:
        raise ArgumentError("--option is an argument of an environment: name the environment, too")
    options = common.env_options(option)
    for env_id in env_ids or ():
        common.spec_of(env_id, option)  # refuses what is none, before any work
    done = []
    for warmed in warm_all(env_ids or names(), options):
        done.append(warmed)
        if not as_json:
            what = f"compiled in {warmed.seconds:.1f} s" if warmed.compiled else "is in the cache already"
            console.print(f"{warmed.environment} {what}", markup=False)
    if as_json:
        common.print_json({"cache": str(cache_folder("kernels")), "warmed": [w._asdict() for w in done]})
    else:
        console.print(f"Kernels are kept in {cache_folder('kernels')}", markup=False, soft_wrap=True)
