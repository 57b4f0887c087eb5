"""Many learners at once: 43,008 that learn alone, and populations that differ in rates or rewards."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.evaluation import Evaluation
from pearl_marl.registry import get_spec
from pearl_marl.rendering import import_pyplot
from pearl_marl.spec import EnvSpec

from .q_learning import QLearning, Settings
from .section import BLUE, GREEN, ORANGE, WIDTH, Progress, Row, select

TITLE = "Many learners at once"
TEXT = (
    "CliffWalking, Q-learning, one step of all 43,008 agents at a time. Rates: 32 learners of 1,344 agents "
    "each, every one with a learning rate of its own. Rewards: 32 learners on slippery ground, for whom a "
    "fall from the cliff costs from 1 to 300 and a step 1; the more it costs, the farther they keep away. "
    "Alone: 43,008 learners, each with its own table and nobody's experience but its own. By best actions; "
    "an episode of an evaluation ends after 1,000 steps."
)
COLUMNS = {
    "part": "part",
    "n_agents": "agents",
    "learners": "learners",
    "rate": "learning rate",
    "fall_costs": "a fall costs",
    "iterations": "steps of all",
    "falls": "falls an episode",
    "length": "steps an episode",
    "reached": "share of learners at -13",
    "counts": "what is counted",
}
SEEDS = (0,)

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
    settings = Settings(n_agents=n, learners=POPULATION, iterations=most)
    trainer = QLearning(get_spec("CliffWalking"), "native", settings, rates=rates)
    found = np.full(POPULATION, -1)
    for evaluation in _trained(trainer, every, progress, "learning rates"):
        known = evaluation.returns == SHORTEST
        found = np.where(known, np.where(found < 0, trainer.done, found), -1)
    return [
        {
            "kind": "measured",
            "part": "rates",
            "n_agents": n,
            "learners": POPULATION,
            "rate": float(rate),
            "iterations": None if steps < 0 else int(steps),
            "counts": f"until its best actions are the shortest way, seen every {every}; none: not in {most}",
        }
        for rate, steps in zip(rates, found, strict=True)
    ]


def _rewards(n: int, quick: bool, progress: Progress) -> list[Row]:
    """Return how learners behave for whom falling from the cliff costs more or less."""
    spec = get_spec("CliffWalking").with_options(is_slippery=True)
    costs = np.geomspace(1, 300, POPULATION)
    assert spec.rewards is not None
    step, fall = spec.rewards
    tables = np.stack([np.full(POPULATION, step), -costs], 1)
    most = 300 if quick else 3000
    settings = Settings(
        n_agents=n, learners=POPULATION, iterations=most, rate=1.0, fading=0.05, epsilon=0.3, discount=0.99
    )
    trainer = QLearning(spec, "native", settings, rewards=tables)
    for _ in progress(_iterations(trainer), most, "reward tables"):
        pass
    each = 10 if quick else 500
    evaluation = _evaluated(trainer, spec, each)
    returns, lengths = (
        values.reshape(POPULATION, each) for values in (evaluation.returns, evaluation.lengths)
    )
    falls = (returns - step * lengths) / (fall - step)
    return [
        {
            "kind": "measured",
            "part": "rewards",
            "n_agents": n,
            "learners": POPULATION,
            "fall_costs": float(cost),
            "iterations": most,
            "falls": float(mean_falls),
            "length": float(length),
            "counts": f"means of {each} episodes",
        }
        for cost, mean_falls, length in zip(costs, falls.mean(1), lengths.mean(1), strict=True)
    ]


def _alone(n: int, quick: bool, progress: Progress) -> list[Row]:
    """Return how many of those that learn alone know the shortest way, as they go on."""
    every, most = 250, 2500
    settings = Settings(n_agents=n, learners=n, iterations=most, rate=1.0, epsilon=0.1)
    trainer = QLearning(get_spec("CliffWalking"), "native", settings)
    rows: list[Row] = []
    for evaluation in _trained(trainer, every, progress, "independent learners"):
        rows.append(
            {
                "kind": "measured",
                "part": "alone",
                "n_agents": n,
                "learners": n,
                "rate": settings.rate,
                "iterations": trainer.done,
                "reached": float(np.mean(evaluation.returns == SHORTEST)),
                "counts": "an episode of every learner",
            }
        )
    return rows


def _iterations(trainer: QLearning) -> Iterator[int]:
    while trainer.done < trainer.settings.iterations:
        trainer.iterate()
        yield trainer.done


def _trained(trainer: QLearning, every: int, progress: Progress, label: str) -> Iterator[Evaluation]:
    """Train to the end; yield an evaluation, an episode a learner, now and then."""
    for done in progress(_iterations(trainer), trainer.settings.iterations, label):
        if done % every == 0:
            yield _evaluated(trainer, trainer.policy.spec)


def _evaluated(trainer: QLearning, spec: EnvSpec, each: int = 1) -> Evaluation:
    """Evaluate the best actions of all learners, some episodes of each, the first learner's first."""
    evaluation = Evaluation(spec, trainer.policy.choose, trainer.settings.learners * each, seed=1)
    for _ in evaluation.run():
        pass
    return evaluation


def draw(rows: list[Row]) -> Any:
    """Draw the three, side by side."""
    plt = import_pyplot()
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(WIDTH, 3.3), layout="constrained")

    found = [row for row in select(rows, part="rates") if row["iterations"] is not None]
    left.plot(*_columns(found, "rate", "iterations"), "o-", color=BLUE, markersize=3)
    left.set(
        xscale="log",
        yscale="log",
        xlabel="learning rate (log scale)",
        ylabel="steps of all agents (log scale)",
        title="until the shortest way is known",
    )

    wanted = select(rows, part="rewards")
    middle.plot(*_columns(wanted, "fall_costs", "length"), "o-", color=GREEN, markersize=3, label="steps")
    middle.set(
        xscale="log",
        xlabel="what a fall costs (log scale)",
        ylabel="steps an episode",
        title="learners who want different things",
    )
    other = middle.twinx()
    other.plot(*_columns(wanted, "fall_costs", "falls"), "s--", color=ORANGE, markersize=3, label="falls")
    other.set(ylabel="falls an episode")
    lines = [*middle.get_lines(), *other.get_lines()]
    middle.legend(lines, [line.get_label() for line in lines], fontsize=8, loc="center right")

    alone = select(rows, part="alone")
    right.plot(*_columns(alone, "iterations", "reached"), "o-", color=BLUE, markersize=3)
    right.set(
        xlabel="steps of each",
        ylabel="share that knows the shortest way",
        ylim=(-0.03, 1.03),
        title=f"{alone[0]['learners']:,} learners, each alone",
    )
    for axes in (left, middle, right):
        axes.grid(alpha=0.3)
        axes.title.set_fontsize(10)
        axes.spines["top"].set_visible(False)
    other.spines["top"].set_visible(False)
    return figure


def _columns(rows: list[Row], x: str, y: str) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    return np.array([row[x] for row in rows]), np.array([row[y] for row in rows])
