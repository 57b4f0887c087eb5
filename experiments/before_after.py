"""A film of what training changes: CartPole before it, on the way, and after it.

``python -m pearl_marl.experiments.before_after film.gif`` makes the README's picture, in some seconds.
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pearl_marl.envs import get_spec
from pearl_marl.experiments.calling import call
from pearl_marl.interfaces.parallel import parallel_env
from pearl_marl.rendering import Video
from pearl_marl.training.ppo import PPO
from pearl_marl.training.run import settings_for

ENV, WORLDS, STEPS, EVERY = "CartPole", 3, 180, 2
STAGES = (0, 1, 8)
"""Updates after which the policy is filmed, a row of the picture for each."""


def policies() -> list[Any]:
    """Return the policy at each stage of a training."""
    trainer = PPO(get_spec(ENV), "native", settings_for("ppo", ENV, {}))
    found = []
    for stage in STAGES:
        while trainer.done < stage:
            trainer.iterate()
        found.append(copy.deepcopy(trainer.policy))
    return found


def main(path: Annotated[Path, typer.Argument(metavar="FILE.gif", help="Where to write the film.")]) -> None:
    """Train, and film the first worlds under each policy."""
    spec = get_spec(ENV)
    film = Video(spec, path, [f"{stage} updates" if stage != 1 else "1 update" for stage in STAGES])
    envs = [parallel_env(ENV, WORLDS) for _ in STAGES]
    seen = [env.reset_batch(seed=0) for env in envs]
    chosen = policies()
    for step in range(STEPS):
        if step % EVERY == 0:
            film.add(np.concatenate([env.state() for env in envs]))
        seen = [
            env.step_batch(policy.choose(obs)).obs
            for env, policy, obs in zip(envs, chosen, seen, strict=True)
        ]
    film.save()
    film.close()


if __name__ == "__main__":
    call(main)
