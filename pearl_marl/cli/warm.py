"""``pearl warm``: kernels compiled ahead."""

from __future__ import annotations

import time
from importlib.util import find_spec
from typing import Annotated

import typer

from pearl_marl.cli import common
from pearl_marl.cli.common import console
from pearl_marl.envs import names
from pearl_marl.errors import ArgumentError


def command(
    env_ids: Annotated[
        list[str] | None,
        typer.Argument(metavar="[ENV ...]", help="Environments of `pearl envs`; without any, all of them."),
    ] = None,
    option: common.Options = None,
    as_json: common.AsJson = False,
) -> None:
    """Compile ahead, for images and clusters: some environments, or all and the trainers."""
    from pearl_marl.base.cache import cache_folder, is_kept
    from pearl_marl.devices.warming import Warmed, warm_all

    if option and not env_ids:
        raise ArgumentError("--option is an argument of an environment: name the environment, too")
    options = common.env_options(option)
    for env_id in env_ids or ():
        common.spec_of(env_id, option)  # refuses what is none, before any work
    if not is_kept(cache_folder("kernels")):
        raise ArgumentError(
            "the cache folder cannot be written, so no kernel would be kept: make it writable, or set "
            "PEARL_CACHE_DIR to a folder that is"
        )
    done = []

    def tell(warmed: Warmed) -> None:
        done.append(warmed)
        if not as_json:
            what = f"compiled in {warmed.seconds:.1f} s" if warmed.compiled else "is in the cache already"
            console.print(f"{warmed.environment} {what}", markup=False)

    for one in warm_all(env_ids or names(), options):
        tell(one)
    if not env_ids and find_spec("torch") is not None:
        from pearl_marl.training.warming import warm_training

        began = time.perf_counter()
        compiled = warm_training()
        tell(Warmed("training", compiled, time.perf_counter() - began))
    if as_json:
        common.print_json({"cache": str(cache_folder("kernels")), "warmed": [w._asdict() for w in done]})
    else:
        console.print(f"Kernels are kept in {cache_folder('kernels')}", markup=False, soft_wrap=True)
