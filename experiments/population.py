"""Many learners at once: 43,008 that learn alone, and populations that differ in rates or rewards."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.envs import get_spec
from pearl_marl.evaluation.run import Evaluation
from pearl_marl.training.q_learning import QLearning, QLearningSettings

from .section import Colour, Progress, Row, having, log_axis, row_of, select, subplots, tidy

TITLE = "Many learners at once"
TEXT = (
    "Q-learning, one step of all agents at a time. Rates: CliffWalking, 32 learners, each of as many agents "
    "and with a learning rate of its own. Alone: as many learners as agents, each with its own table and "
    "nobody's experience but its own. Rewards: CliffWalking, 32 learners for whom a fall from the cliff is "
    "worth from -10 to 10 and a step -1; as soon as falling costs nothing, they jump for ever. All by best "
    "actions; an episode of an evaluation ends after 1,000 steps."
)
COLUMNS = {
    "part": "part",
    "n_agents": "agents",
    "learners": "learners",
    "rate": "learning rate",
    "fall_worth": "a fall is worth",
    "iterations": "steps of all",
    "falls": "falls an episode",
    "length": "steps an episode",
    "reached": "share of learners at -13",
    "counts": "what is counted",
}

SHORTEST = -13.0
POPULATION = 32


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Train all three; with ``quick`` a hundredth of the agents."""
    n = 448 if quick else 43_008
    return [*_rates(n, quick, progress), *_rewards(n, quick, progress), *_alone(n, quick, progress)]


def _rates(n: int, quick: bool, progress: Progress) -> list[Row]:
    """Return after how many steps the learner of each rate knew the shortest way, and kept to it."""
    every, most = (100, 600) if quick else (10, 600)
    rates = np.geomspace(0.01, 1.0, POPULATION)
    settings = QLearningSettings(n_agents=n, learners=POPULATION, iterations=most)
    trainer = QLearning(get_spec("CliffWalking"), "native", settings, rates=rates)
    found = np.full(POPULATION, -1)
    for evaluation in _trained(trainer, every, progress, "learning rates"):
        known = evaluation.returns == SHORTEST
        found = np.where(known, np.where(found < 0, trainer.done, found), -1)
    counts = f"until its best actions are the shortest way, seen every {every}; none: not in {most}"
    return [
        row_of(
            "measured",
            counts,
            part="rates",
            n_agents=n,
            learners=POPULATION,
            rate=float(rate),
            iterations=None if steps < 0 else int(steps),
        )
        for rate, steps in zip(rates, found, strict=True)
    ]


def _rewards(n: int, quick: bool, progress: Progress) -> list[Row]:
    """Return what learners do for whom falling from the cliff is worth less or more."""
    spec = get_spec("CliffWalking")
    worth = np.linspace(-10, 10, POPULATION)
    step, fall = np.array(spec.rewards)
    tables = np.stack([np.full(POPULATION, step), worth], 1)
    settings = QLearningSettings(
        n_agents=n, learners=POPULATION, iterations=100 if quick else 600, discount=0.99
    )
    trainer = QLearning(spec, "native", settings, rewards=tables)
    for _ in progress(_iterations(trainer), settings.iterations, "reward tables"):
        pass
    evaluation = _evaluated(trainer)
    # By the environment's own rewards, from which falls can be told.
    falls = (evaluation.returns - step * evaluation.lengths) / (fall - step)
    return [
        row_of(
            "measured",
            "the one episode of its best actions: nothing in it is random",
            part="rewards",
            n_agents=n,
            learners=POPULATION,
            fall_worth=float(value),
            iterations=settings.iterations,
            falls=float(falls_of_one),
            length=int(length),
        )
        for value, falls_of_one, length in zip(worth, falls, evaluation.lengths, strict=True)
    ]


def _alone(n: int, quick: bool, progress: Progress) -> list[Row]:
    """Return how many of those that learn alone know the shortest way, as they go on."""
    every, most = (500, 2000) if quick else (250, 2500)
    settings = QLearningSettings(n_agents=n, learners=n, iterations=most, learning_rate=1.0, epsilon=0.1)
    trainer = QLearning(get_spec("CliffWalking"), "native", settings)
    return [
        row_of(
            "measured",
            "an episode of every learner",
            part="alone",
            n_agents=n,
            learners=n,
            rate=settings.learning_rate,
            iterations=trainer.done,
            reached=float(np.mean(evaluation.returns == SHORTEST)),
        )
        for evaluation in _trained(trainer, every, progress, "independent learners")
    ]


def _iterations(trainer: QLearning) -> Iterator[int]:
    while trainer.done < trainer.settings.iterations:
        trainer.iterate()
        yield trainer.done


def _trained(trainer: QLearning, every: int, progress: Progress, label: str) -> Iterator[Evaluation]:
    """Train to the end; yield an evaluation, an episode a learner, now and then."""
    for done in progress(_iterations(trainer), trainer.settings.iterations, label):
        if done % every == 0:
            yield _evaluated(trainer)


def _evaluated(trainer: QLearning) -> Evaluation:
    """Evaluate the best actions of all learners, an episode each."""
    evaluation = Evaluation(trainer.policy.spec, trainer.policy.choose, trainer.settings.learners, seed=1)
    for _ in evaluation.run():
        pass
    return evaluation


def draw(rows: list[Row]) -> Any:
    """Draw the three, side by side."""
    figure, panels = subplots(1, 3, 3.3)
    left, middle, right = panels

    found = having(select(rows, part="rates"), "iterations")
    left.plot(*_columns(found, "rate", "iterations"), "o-", color=Colour.BLUE, markersize=3)
    log_axis(left, "y", [row["iterations"] for row in found])
    left.set(
        xscale="log",
        xlabel="learning rate (log scale)",
        ylabel="steps of all agents (log scale)",
        title="until the shortest way is known",
    )

    wanted = select(rows, part="rewards")
    middle.plot(*_columns(wanted, "fall_worth", "falls"), "s-", color=Colour.ORANGE, markersize=3)
    middle.set(
        xlabel="what a fall is worth, a step is -1",
        ylabel="falls in an episode",
        title="learners who want different things",
    )

    alone = select(rows, part="alone")
    right.plot(*_columns(alone, "iterations", "reached"), "o-", color=Colour.BLUE, markersize=3)
    right.set(
        xlabel="steps of each",
        ylabel="share that knows the shortest way",
        ylim=(-0.03, 1.03),
        title=f"{alone[0]['learners']:,} learners, each alone",
    )
    tidy(*panels)
    for axes in panels:
        axes.title.set_fontsize(10)
    return figure


def _columns(rows: list[Row], x: str, y: str) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    return np.array([row[x] for row in rows]), np.array([row[y] for row in rows])
