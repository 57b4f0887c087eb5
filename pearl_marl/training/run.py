"""A training run from its settings to its policy: what ``pearl train`` does."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pearl_marl.batch.config import worlds_of
from pearl_marl.errors import ArgumentError, PearlError, SavedStateError, shown, told
from pearl_marl.evaluation.matches import Match
from pearl_marl.evaluation.run import Evaluation
from pearl_marl.policies.loading import RANDOM, load_policy
from pearl_marl.registry import get_spec
from pearl_marl.spec import EnvSpec
from pearl_marl.training import dqn, ppo, q_learning, self_play
from pearl_marl.training.presets import PRESETS
from pearl_marl.training.run_folder import POLICY, RunFolder
from pearl_marl.training.trainer import threads_for

ALGORITHMS: dict[str, Any] = {
    "ppo": ppo.PPO,
    "mappo": ppo.MAPPO,
    "self-play": self_play.SelfPlay,
    "dqn": dqn.DQN,
    "q-learning": q_learning.QLearning,
}
SETTINGS: dict[str, Any] = {
    "ppo": ppo.PPOSettings,
    "mappo": ppo.PPOSettings,
    "self-play": self_play.SelfPlaySettings,
    "dqn": dqn.DQNSettings,
    "q-learning": q_learning.QLearningSettings,
}

ALIASES = {"ippo": "ppo", "iql": "dqn"}
"""What the algorithms are called where they learn for every agent of a world."""

OPTIONS = ("n_agents", "iterations", "seed")
"""Settings that ``pearl train`` has options of their own for; others are given by ``--set``."""

BLOCKS = 8
"""Into how many blocks agents are divided for shards, unless said otherwise: see ``ppo.PPOSettings``."""

_UNUSABLE = ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError
"""What trainers raise where a checkpoint does not hold what it should."""

_NOT_ITS_FAULT = PearlError, torch.cuda.OutOfMemoryError
"""Of these, what says that a device or a GPU has failed: the checkpoint is as good as it was."""


def settings_for(
    algorithm: str, env_id: str, given: dict[str, Any], shards: int | None = None, agents: int = 1
) -> Any:
    """Return an algorithm's settings for an environment: its preset, and over it those given.

    With ``shards``, agents are in blocks, as many for any number of shards. Unless their number is given, it
    is one of whole worlds, of so many ``agents`` each.

    Raises
    ------
    ArgumentError
        There is no such algorithm or setting, or a value is out of its range.
    """
    algorithm = ALIASES.get(algorithm, algorithm)
    if algorithm not in ALGORITHMS:
        possible = ", ".join(map(repr, (*ALGORITHMS, *ALIASES)))
        raise ArgumentError(f"--algo is {algorithm!r}; possible are {possible}")
    kind = SETTINGS[algorithm]
    names = [setting.name for setting in dataclasses.fields(kind)]
    given = kind.renamed(given)
    for name, value in given.items():
        if name not in names:
            near = difflib.get_close_matches(name, names, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(names)}"
            raise ArgumentError(f"--set {name}: {algorithm} has no such setting; {hint}")
        if value not in (possible := kind.range(name)):
            option = f"--{name.replace('_', '-')}" if name in OPTIONS else f"--set {name}"
            raise ArgumentError(f"{option} is {value!r}; it must be {possible}")
    preset = PRESETS.get((algorithm, get_spec(env_id).name), {})
    settings = SETTINGS[algorithm](**{**preset, **given})
    if "n_agents" not in given:
        n = max(settings.n_agents // agents, 1) * agents
        settings = dataclasses.replace(settings, n_agents=n)
    if shards is None:
        return settings
    if algorithm != "ppo":
        raise ArgumentError(f"{algorithm} does not learn with --shards: leave it out, or use ppo")
    if "blocks" in given:
        return settings
    return dataclasses.replace(settings, blocks=min(BLOCKS, settings.n_agents))


def train(
    env_id: str,
    options: dict[str, Any],
    algorithm: str,
    settings: Any,
    device: str,
    folder: Path,
    goal: float | None = None,
    evaluate_every: int | None = None,
    progress: Callable[[int, int, dict[str, Any]], None] = lambda done, total, row: None,
    checkpoint_seconds: float = 20.0,
    evaluated: int | None = None,
    shards: int | None = None,
    undisturbed: Callable[[], AbstractContextManager[Any]] = contextlib.nullcontext,
    stopped: Callable[[], bool] = lambda: False,
) -> list[dict[str, Any]]:
    """Train, and write the run's folder; return the metrics.

    Parameters
    ----------
    env_id, options, device
        The environment, and where agents are stepped.
    algorithm, settings
        One of :data:`ALGORITHMS` or :data:`ALIASES`, and what :func:`settings_for` made.
    folder
        Of the run. If it holds one of the same settings, that goes on where its last checkpoint was.
    goal
        The mean return of an agent in an evaluation, with which the run is done before its last iteration.
    evaluate_every
        Iterations between evaluations, which are also when metrics are noted; by default there are 50.
    progress
        Called at every evaluation with the iterations done, those in all, and the metrics.
    checkpoint_seconds
        The least time between two checkpoints, which large replay memories take a while to write.
    evaluated
        Agents whose first episodes are an evaluation; by default as many as the algorithm suggests.
    shards
        How many processes step agents, by Ray; ``None`` for this one. Whatever it is, and whatever it was
        before a run was killed, the result is the same.
    undisturbed, stopped
        An iteration, with its evaluation, is done in the first one's context. After it the second one is
        asked, and if it says so, all is kept to go on with, and the run ends.

    Raises
    ------
    KeyboardInterrupt
        The run was stopped.
    ArgumentError
        The folder holds a run of other settings, or cannot be written; or the algorithm does not suit the
        environment.
    """
    algorithm = ALIASES.get(algorithm, algorithm)
    every = max(1, settings.iterations // 50) if evaluate_every is None else evaluate_every
    if every < 1:
        raise ArgumentError(f"--evaluate-every is {every}; it must be a whole number of at least 1")
    if goal is not None and not math.isfinite(goal):
        raise ArgumentError(f"--goal is {goal}; it must be a finite number")
    spec = get_spec(env_id).with_options(**options)
    _check_worlds(spec, algorithm, settings)
    spread = {} if shards is None else {"shards": shards}
    trainer = ALGORITHMS[algorithm](spec, device, settings, **spread)
    run = RunFolder(
        folder,
        {
            "environment": spec.id,
            "options": dict(spec.options),
            "algorithm": algorithm,
            "settings": dataclasses.asdict(settings),
            "device": device,
            "goal": goal,
            "evaluate_every": every,
        },
        SETTINGS[algorithm].successors(),
    )
    with run.claimed():
        seconds, best = 0.0, -np.inf
        if (saved := run.resume()) is not None:
            try:
                seconds, best = float(saved["seconds"]), float(saved["best"])
                trainer.load(saved["trainer"])
                if not isinstance(trainer.done, int) or not 0 <= trainer.done <= settings.iterations:
                    raise ValueError(f"it has done {shown(trainer.done)} iterations of {settings.iterations}")
                if not run.rows and (trainer.done == settings.iterations or best > -math.inf):
                    raise ValueError("it has no metrics of evaluations that were done")
                if not math.isfinite(seconds) or math.isnan(best):
                    raise ValueError(f"it took {seconds} s, and its best return is {best}")
            except _UNUSABLE as error:
                if isinstance(error, _NOT_ITS_FAULT) and not isinstance(
                    error, (ArgumentError, SavedStateError)
                ):
                    raise
                why = told(error) or type(error).__name__
                raise run.damaged(f"and cannot be gone on from ({why})") from error
            run.write_metrics()  # a kill may have left those of an earlier moment
        run.write_config()
        began, kept = time.perf_counter() - seconds, time.perf_counter()
        finished = goal is not None and best >= goal
        curve = f"{spec.name}: {algorithm}, {settings.n_agents:,} agents"
        while trainer.done < settings.iterations and not finished:
            with undisturbed():
                trainer.iterate()
                last = trainer.done == settings.iterations
                noting = last or not trainer.done % every
                if noting:
                    n = max((evaluated or trainer.evaluated) // spec.agents, 1) * spec.agents
                    with threads_for(spec, settings):
                        mean, deviation = evaluate(trainer.policy, spec, n)
                    row = {"seconds": time.perf_counter() - began, **trainer.figures()}
                    row |= {"eval_return": mean, "eval_deviation": deviation}
                    if spec.agents > 1 and not spec.turns:
                        row["eval_world_return"] = mean * spec.agents
                    run.report(trainer.agent_steps, **row)
                    progress(trainer.done, settings.iterations, row)
                    finished = goal is not None and mean >= goal
                    # Whoever always beats a random player can still become better at beating others.
                    if mean > best or spec.turns:
                        best = max(best, mean)
                        trainer.policy.save(folder / POLICY)
                    run.keep(getattr(trainer, "past", {}))
            done = last or finished
            stop = stopped() and not done
            if stop or done or (noting and time.perf_counter() - kept >= checkpoint_seconds):
                seconds = time.perf_counter() - began
                run.checkpoint({"trainer": trainer.state(), "seconds": seconds, "best": best})
                kept = time.perf_counter()
            if stop:
                if run.rows:
                    run.draw_curve(curve, goal)
                raise KeyboardInterrupt
        run.draw_curve(curve, goal)
    return run.rows


def _check_worlds(spec: EnvSpec, algorithm: str, settings: Any) -> None:
    """Refuse worlds that the trainers, with one policy for all agents, cannot learn in."""
    worlds_of(spec, settings.n_agents)
    name = spec.name
    if algorithm == "mappo" and spec.agents < 2:
        raise ArgumentError(f"{name} has one agent in a world, and mappo's critic sees several: use ppo")
    if not spec.mask_fields and any(role.action_space != spec.action_space for role in spec.roles):
        raise ArgumentError(
            f"{name} has roles with other actions, and no masks to tell them: train by a library that learns "
            f"one policy for each role, around pearl_marl.parallel_env({name!r})"
        )
    if spec.agents > 1 and getattr(settings, "blocks", 1) > 1:
        raise ArgumentError(f"agents of {name} share worlds, and --shards is for those that are alone")


def evaluate(policy: Any, spec: EnvSpec, n: int, seed: int = 1) -> tuple[float, float]:
    """Return mean and standard deviation of the return of ``n`` agents' first episodes.

    In a game of turns, the return against players who make random moves: against itself it would be that of
    every policy.
    """
    policy.seed(seed)
    if spec.turns:
        match = Match(spec, policy.choose, load_policy(RANDOM, spec, seed), n, openings=0, seed=seed)
        evaluation: Evaluation = match
        counted = match.seats
    else:
        evaluation, counted = Evaluation(spec, policy.choose, n, seed=seed), np.ones(n, np.bool_)
    for _ in evaluation.run():
        pass
    returns = evaluation.returns[counted]
    return float(returns.mean()), float(returns.std())
