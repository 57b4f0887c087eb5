"""Films of policies while they are learned."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

from pearl_marl.devices import BatchConfig, make_device
from pearl_marl.policies.loading import forget
from pearl_marl.rendering import VIDEO_STEPS, Video
from pearl_marl.spec import EnvSpec

WORLDS = 4
"""Filmed side by side. Renderers take milliseconds for a picture, and a training waits for them."""


def film(policy: Any, spec: EnvSpec, path: Path, seed: int = 1) -> None:
    """Film the first episodes of a trainer's policy in :data:`WORLDS` worlds, as a GIF.

    It acts as in an evaluation, but for all agents of a world. The film ends with the last of these episodes,
    after :data:`~pearl_marl.rendering.VIDEO_STEPS` steps at most.

    Raises
    ------
    PearlError
        The environment has no drawing, or Pillow or the drawing's library is not installed.
    """
    acts = policy.function
    policy.seed(seed)
    forget(acts)
    with closing(Video(spec, path)) as video, closing(make_device("native")) as device:
        device.open(BatchConfig(spec=spec, n_envs=WORLDS))
        obs = device.reset(seed)
        present, done = device.in_episode, ~device.in_episode
        for _ in range(VIDEO_STEPS):
            video.add(device.state())
            masks = device.action_masks
            step = device.step(acts(obs) if masks is None else acts(obs, masks))
            # One that has ended before its world may have had steps of no episode since.
            forget(acts, step.ended | ~present)
            obs, present, done = step.obs, step.in_episode, done | step.ended
            if done.all():
                break
        video.save()
