"""Holding a device against the golden functions in every mode, and replaying where it differed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from pearl_marl.batch.actions import encode, random_actions, room_for_words
from pearl_marl.batch.config import worlds_of
from pearl_marl.devices import BatchConfig, Lockstep
from pearl_marl.devices.replay import Replay
from pearl_marl.errors import ArgumentError, LockstepError
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.spec import EnvSpec


@dataclass
class Run:
    """One mode, how many steps it gets, and what has come of it so far."""

    config: BatchConfig
    steps: int
    taken: int = 0
    words: int = 0
    """How many have been compared."""
    episodes: int = 0
    truncated: int = 0
    """How many of the episodes were only truncated."""
    exact: bool | None = None
    """Whether all was the same; ``None`` before the end."""


def runs(
    spec: EnvSpec,
    n_agents: int,
    steps: int,
    autoreset_mode: AutoresetMode | None = None,
    initial_states: str | None = None,
    max_cycles: int | None = None,
) -> list[Run]:
    """Return the modes to run in: every combination of what is ``None``, with the steps shared out.

    Without ``max_cycles`` there is once no limit, and once one that is reached twice.

    Raises
    ------
    ArgumentError
        There are fewer steps than modes.
    """
    modes = [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP] if autoreset_mode is None else [autoreset_mode]
    starts = ["random", "stored"] if initial_states is None else [initial_states]
    limited = [False, True] if max_cycles is None else [True]
    combinations = list(product(modes, starts, limited))
    if steps < len(combinations):
        raise ArgumentError(
            f"the number of steps is {steps}; {len(combinations)} modes share them: take more"
        )
    result, worlds = [], worlds_of(spec, n_agents)
    for i, (mode, start, limit) in enumerate(combinations):
        share = steps // len(combinations) + (i < steps % len(combinations))
        cycles = max_cycles
        if cycles is None:
            cycles = min(max(1, share // 2), spec.max_cycles or share) if limit else 0
        config = BatchConfig(
            spec=spec,
            n_envs=worlds,
            autoreset_mode=mode,
            initial_states=start,
            max_cycles=cycles,
            copy=False,
        )
        result.append(Run(config, share))
    return result


def verify(run: Run, lockstep: Lockstep, seed: int, policy: DevicePolicy | None = None) -> Iterator[Run]:
    """Step a lockstep through a run, with a masked reset half way; yield the run after every step.

    With a policy it does rollouts: of one step, of two, and so on. At the first word that differs it raises
    LockstepError.
    """
    lockstep.open(run.config)
    try:
        lockstep.reset(seed)
        half = np.random.default_rng(seed).random(run.config.n_envs) < 0.5
        for done in _steps(run, lockstep, seed) if policy is None else _rollouts(run, lockstep, policy):
            for _ in range(done):
                run.taken += 1
                if run.taken == (run.steps + 1) // 2:
                    lockstep.reset(mask=half)
                yield run
        lockstep.snapshot()
        run.exact = True
    except LockstepError:
        run.exact = False
        raise
    finally:
        run.words = lockstep.words_compared
        lockstep.close()


def _steps(run: Run, lockstep: Lockstep, seed: int) -> Iterator[int]:
    """Do the steps of a run with random actions; yield 1 for each."""
    words = room_for_words(run.config.spec, run.config.n_agents)
    for actions in sticky_actions(run.config.spec, run.config.n_agents, run.steps, seed):
        # As words, since masked actions have to do the same on both too.
        step = lockstep.step_words(encode(actions, run.config.spec, words))
        run.episodes += int(np.count_nonzero(step.ended))
        run.truncated += int(np.count_nonzero(step.truncations & ~step.terminations))
        yield 1


def _rollouts(run: Run, lockstep: Lockstep, policy: DevicePolicy) -> Iterator[int]:
    """Do the steps of a run in longer and longer rollouts; yield how many each does."""
    steps = 1
    while run.taken < run.steps:
        done = min(steps, run.steps - run.taken)
        result = lockstep.rollout(policy, done)
        run.episodes += result.episodes
        run.truncated += int(result.truncated.sum())
        steps += 1
        yield done


def sticky_actions(spec: EnvSpec, n: int, steps: int, seed: int) -> Iterator[npt.NDArray[Any]]:
    """Yield random actions that end episodes: independent ones hardly ever swing up a mountain.

    Of every five slots one never repeats its action, and the others do for 2, 4, 8 and 16 steps on average.
    """
    rng = np.random.default_rng(seed)
    changes = 0.5 ** (np.arange(n) % 5)
    actions = random_actions(spec, rng, n)
    for _ in range(steps):
        yield actions
        drawn = random_actions(spec, rng, n)
        change = (rng.random(n) < changes).reshape(-1, *(1,) * (drawn.ndim - 1))
        actions = np.where(change, drawn, actions)


def replay(recorded: Replay, lockstep: Lockstep) -> LockstepError | None:
    """Make a call again on a new ``lockstep`` of the two devices, which is closed afterwards.

    Returns where they differ now, ``None`` if they agree.
    """
    lockstep.open(recorded.config)
    try:
        if recorded.before is not None:
            lockstep.restore(recorded.before)
        if recorded.actions is not None:
            lockstep.step_words(recorded.actions)
        elif recorded.divergence.call == "reset":
            lockstep.reset(recorded.seed, recorded.mask)
        lockstep.snapshot()
    except LockstepError as error:
        return error
    finally:
        lockstep.close()
    return None
