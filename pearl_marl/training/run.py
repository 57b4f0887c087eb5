"""A training from its settings to its policy, as ``pearl train`` does it."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import math
import re
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pearl_marl.batch.config import worlds_of
from pearl_marl.checks import checked_integer, checked_number
from pearl_marl.envs import get_spec
from pearl_marl.errors import ArgumentError, PearlError, SavedStateError, brief, one_line
from pearl_marl.evaluation.matches import Match
from pearl_marl.evaluation.run import Evaluation
from pearl_marl.policies.loading import random_policy
from pearl_marl.rendering import Video
from pearl_marl.spec import EnvSpec
from pearl_marl.training import dqn, ppo, pqn, q_learning, self_play, teams
from pearl_marl.training.films import film
from pearl_marl.training.run_folder import POLICY, RunFolder
from pearl_marl.training.trainer import threads_for

_KINDS: dict[str, tuple[Any, Any]] = {
    "ppo": (ppo.PPO, ppo.PPOSettings),
    "mappo": (ppo.MAPPO, ppo.PPOSettings),
    "self-play": (self_play.SelfPlay, self_play.SelfPlaySettings),
    "dqn": (dqn.DQN, dqn.DQNSettings),
    "pqn": (pqn.PQN, pqn.PQNSettings),
    "vdn": (teams.VDN, teams.VDNSettings),
    "qmix": (teams.QMIX, teams.QMIXSettings),
    "q-learning": (q_learning.QLearning, q_learning.QLearningSettings),
}
ALGORITHMS = {name: trainer for name, (trainer, _) in _KINDS.items()}
SETTINGS = {name: settings for name, (_, settings) in _KINDS.items()}

ALIASES = {"ippo": "ppo", "iql": "dqn"}
"""Names of the algorithms where they learn for every agent of a world."""

SHARDED = "ppo", "pqn"
"""Algorithms whose agents several processes may step."""

OPTIONS = ("n_agents", "iterations", "seed")
"""Settings that ``pearl train`` has options of their own for; others are given by ``--set``."""

BLOCKS = 8
"""Into how many blocks agents are divided for shards, unless said otherwise: see ``BlockSettings``."""

_UNUSABLE = ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError
"""Errors that trainers raise where a checkpoint does not hold what it should."""

_NOT_ITS_FAULT = PearlError, torch.cuda.OutOfMemoryError
"""Of these, errors that say that a device or a GPU has failed: the checkpoint is as good as it was."""


def settings_for(
    algorithm: str, env_id: str, changes: dict[str, Any], shards: int | None = None, agents: int = 1
) -> Any:
    """Return an algorithm's settings for an environment: its preset, with changes.

    With ``shards``, agents are in blocks, as many for any number of shards. Unless the changes say how many
    agents there are, they are of whole worlds, of so many ``agents`` each.

    Raises
    ------
    ArgumentError
        There is no such algorithm or setting, or a value is out of its range.
    """
    spec, possible = get_spec(env_id), ", ".join(map(repr, (*ALGORITHMS, *ALIASES)))
    presets = {ALIASES.get(name, name): preset for name, preset in spec.presets.items()}
    for name in presets:
        if name not in ALGORITHMS:
            raise ArgumentError(f"{spec.name} has a preset of {name!r}; possible are {possible}")
    algorithm = ALIASES.get(algorithm, algorithm)
    if algorithm not in ALGORITHMS:
        raise ArgumentError(f"--algo is {algorithm!r}; possible are {possible}")
    changes = _checked(algorithm, changes, _option)
    preset = _checked(algorithm, presets.get(algorithm, {}), lambda name: f"{spec.name}'s preset of {name}")
    settings = SETTINGS[algorithm](**{**preset, **changes})
    if "n_agents" not in changes:
        n = max(settings.n_agents // agents, 1) * agents
        settings = dataclasses.replace(settings, n_agents=n)
    if shards is None:
        return settings
    if algorithm not in SHARDED:
        possible = " or ".join(SHARDED)
        raise ArgumentError(f"{algorithm} does not learn with --shards: leave it out, or use {possible}")
    if "blocks" in changes:
        return settings
    return dataclasses.replace(settings, blocks=min(BLOCKS, settings.n_agents))


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}" if name in OPTIONS else f"--set {name}"


def _checked(algorithm: str, values: Mapping[str, Any], where: Callable[[str], str]) -> dict[str, Any]:
    """Return settings by their present names, after a check of names and values.

    ``where`` says where a setting of that name was given.
    """
    kind = SETTINGS[algorithm]
    names = [setting.name for setting in dataclasses.fields(kind)]
    checked: dict[str, Any] = kind.renamed(values)
    for name, value in checked.items():
        if name not in names:
            near = difflib.get_close_matches(name, names, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(names)}"
            raise ArgumentError(f"{where(name)}: {algorithm} has no such setting; {hint}")
        if value not in (possible := kind.range(name)):
            raise ArgumentError(f"{where(name)} is {value!r}; it must be {possible}")
    return checked


@dataclasses.dataclass(frozen=True)
class Training:
    """A training, by all that its result depends on.

    Parameters
    ----------
    env_id, options, device
        The environment, and where agents are stepped.
    algorithm, settings
        One of :data:`ALGORITHMS` or :data:`ALIASES`, and what :func:`settings_for` made.
    goal
        The mean return of an agent in an evaluation with which it ends before its last iteration.
    evaluate_every
        Iterations between evaluations, which are also when metrics are noted; by default there are 50.
    """

    env_id: str
    algorithm: str
    settings: Any
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    device: str = "native"
    goal: float | None = None
    evaluate_every: int | None = None

    def __post_init__(self) -> None:
        if self.evaluate_every is not None:
            checked_integer("--evaluate-every", self.evaluate_every)
        if self.goal is not None:
            checked_number("--goal", self.goal)

    def trainer(self, shards: int | None) -> Any:
        """Return the trainer; with ``shards``, so many processes step its agents."""
        spec = get_spec(self.env_id).with_options(**self.options)
        algorithm = ALIASES.get(self.algorithm, self.algorithm)
        _check_worlds(spec, algorithm, self.settings)
        spread = {} if shards is None else {"shards": shards}
        return ALGORITHMS[algorithm](spec, self.device, self.settings, **spread)


class TrainingRun:
    """A training in its folder, where it goes on from its last checkpoint.

    ::

        run = TrainingRun(training, folder)
        with run.claimed():
            while not run.finished:
                run.iterate()

    Parameters
    ----------
    training
        What it is.
    folder
        The run's. If it holds a run of the same training, that goes on where its last checkpoint was.
    shards
        How many processes step agents, by Ray; ``None`` for this one. The result is the same for any number,
        and the number may change when the run goes on.
    evaluated
        Agents whose first episodes are an evaluation; by default as many as the algorithm suggests.
    checkpoint_seconds
        The least time between two checkpoints, which large replay memories take a while to write.
    films
        Whether each evaluation is filmed: see :func:`~pearl_marl.training.films.film`.
    track
        A service that gets the metrics, too: ``"wandb"`` or ``"mlflow"``.

    Raises
    ------
    ArgumentError
        The algorithm does not suit the environment, that has no drawing to film, or the service is not
        installed.
    """

    def __init__(
        self,
        training: Training,
        folder: Path,
        shards: int | None = None,
        evaluated: int | None = None,
        checkpoint_seconds: float = 20.0,
        films: bool = False,
        track: str | None = None,
    ) -> None:
        settings, self.goal, self.checkpoint_seconds = training.settings, training.goal, checkpoint_seconds
        self.trainer = training.trainer(shards)
        self.spec = spec = self.trainer.policy.spec
        self.algorithm = ALIASES.get(training.algorithm, training.algorithm)
        self.iterations, self.seed = settings.iterations, settings.seed
        self.evaluate_every = training.evaluate_every or max(1, settings.iterations // 50)
        self.evaluated = max((evaluated or self.trainer.evaluated) // spec.agents, 1) * spec.agents
        self.best = -math.inf
        about = {
            "environment": spec.id,
            "options": dict(spec.options),
            "algorithm": self.algorithm,
            "settings": dataclasses.asdict(settings),
            "device": training.device,
            "goal": training.goal,
            "evaluate_every": self.evaluate_every,
        }
        self.folder = RunFolder(folder, about, SETTINGS[self.algorithm], track)
        self.rows = self.folder.rows  # the metrics so far, a dict for each evaluation
        self.films = films
        if films:  # what cannot be filmed is refused at once
            Video(spec, folder / "film.gif").close()
        self._began = self._kept = time.perf_counter()

    @property
    def done(self) -> int:
        """Iterations so far."""
        return int(self.trainer.done)

    @property
    def finished(self) -> bool:
        """Whether all iterations are done, or the goal is reached."""
        reached = self.goal is not None and self.best >= self.goal
        return reached or self.trainer.done == self.iterations

    @contextlib.contextmanager
    def claimed(self) -> Iterator[None]:
        """Train in the block: the folder is this run's alone, and at the end has the learning curve.

        Raises
        ------
        ArgumentError
            Another process has the folder, it holds a run of another training, or cannot be written.
        """
        with self.folder.claimed():
            seconds = self._resume()
            self.folder.write_config()
            self._kept = time.perf_counter()
            self._began = self._kept - seconds
            yield
            self._draw_curve()

    def iterate(self) -> dict[str, Any] | None:
        """Go on by one iteration; return the metrics, if it was time for an evaluation."""
        self.trainer.iterate()
        row = None
        if self.trainer.done == self.iterations or not self.trainer.done % self.evaluate_every:
            row = self._evaluate()
        due = row is not None and time.perf_counter() - self._kept >= self.checkpoint_seconds
        if due or self.finished:
            self._checkpoint()
        return row

    def keep(self) -> None:
        """Keep all that is needed to go on later, also between two evaluations."""
        self._checkpoint()
        self._draw_curve()

    def _evaluate(self) -> dict[str, Any]:
        """Note the metrics, and keep the policy if it is the best so far."""
        trainer, spec = self.trainer, self.spec
        with threads_for(spec, trainer.settings):
            figures = evaluate(trainer.policy, spec, self.evaluated)
            if self.films:
                film(trainer.policy, spec, self.folder.path / "films" / f"{trainer.done:06}.gif")
        row = {"seconds": time.perf_counter() - self._began, **trainer.figures(), **figures}
        mean = figures["eval_return"]
        self.folder.report(trainer.agent_steps, **row)
        # A policy that always beats a random player can still become better at beating others.
        if mean > self.best or spec.turns:
            self.best = max(self.best, mean)
            trainer.policy.save(self.folder.path / POLICY)
        self.folder.keep(getattr(trainer, "past", {}))
        return row

    def _checkpoint(self) -> None:
        seconds = time.perf_counter() - self._began
        self.folder.checkpoint({"trainer": self.trainer.state(), "seconds": seconds, "best": self.best})
        self._kept = time.perf_counter()

    def _draw_curve(self) -> None:
        if not self.rows:
            return
        title = f"{self.spec.name}: {self.algorithm}, {self.trainer.settings.n_agents:,} agents"
        self.folder.draw_curve(title, self.goal)

    def _resume(self) -> float:
        """Go on from the folder's checkpoint, if it has one; return the seconds that the run has taken."""
        saved = self.folder.resume()
        if saved is None:
            return 0.0
        trainer = self.trainer
        try:
            seconds, best = float(saved["seconds"]), float(saved["best"])
            trainer.load(saved["trainer"])
            if not isinstance(trainer.done, int) or not 0 <= trainer.done <= self.iterations:
                raise ValueError(f"it has done {brief(trainer.done)} iterations of {self.iterations}")
            if not self.rows and (trainer.done == self.iterations or best > -math.inf):
                raise ValueError("it has no metrics of evaluations that were done")
            if not math.isfinite(seconds) or math.isnan(best):
                raise ValueError(f"it took {seconds} s, and its best return is {best}")
        except _UNUSABLE as error:
            refused = isinstance(error, (ArgumentError, SavedStateError))
            if isinstance(error, _NOT_ITS_FAULT) and not refused:
                raise
            why = one_line(error) or type(error).__name__
            raise self.folder.damaged(f"and cannot be gone on from ({why})") from error
        self.best = best
        self.folder.write_metrics()  # a kill may have left those of an earlier moment
        return seconds


def train(training: Training, folder: Path, evaluated: int | None = None) -> list[dict[str, Any]]:
    """Train to the end, in a folder; return the metrics. See :class:`TrainingRun`."""
    run = TrainingRun(training, folder, evaluated=evaluated)
    with run.claimed():
        while not run.finished:
            run.iterate()
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


def evaluate(policy: Any, spec: EnvSpec, n: int, seed: int = 1) -> dict[str, Any]:
    """Return figures of the return of ``n`` agents' first episodes, by the names of metrics.

    ``eval_return`` and ``eval_deviation`` are mean and standard deviation. Of worlds of several agents
    there are also the mean of each agent, by its role and number (``eval_return_agent_0``), and that of all
    agents of a world together, ``eval_world_return``.

    In a game of turns, it is the return against random players: against itself, every policy has the same.
    An agent's is that in its seat, ``None`` where the policy never had it.
    """
    policy.seed(seed)
    if spec.turns:
        match = Match(spec, policy.function, random_policy(spec, seed), n, openings=0, seed=seed)
        evaluation: Evaluation = match
        counted = match.seats
    else:
        evaluation = Evaluation(spec, policy.beside or policy.function, n, seed=seed)
        counted = np.ones(n, np.bool_)
    for _ in evaluation.run():
        pass
    returns = evaluation.returns
    mean, deviation = float(returns[counted].mean()), float(returns[counted].std())
    figures: dict[str, Any] = {"eval_return": mean, "eval_deviation": deviation}
    if spec.agents > 1:
        names = [role.name for role in spec.roles] or ["agent"] * spec.agents
        for k, name in enumerate(names):
            own = returns[k :: spec.agents][counted[k :: spec.agents]]
            figures[re.sub(r"\W", "_", f"eval_return_{name}_{k}")] = float(own.mean()) if len(own) else None
        if not spec.turns:
            figures["eval_world_return"] = mean * spec.agents
    return figures
