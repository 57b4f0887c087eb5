"""What the trainers reach: every environment learned with its preset, and the policy evaluated at length."""

from __future__ import annotations

import functools
import math
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from pearl_marl.envs import get_spec
from pearl_marl.evaluation.run import Evaluation
from pearl_marl.policies import trained
from pearl_marl.training.run import Training, settings_for, train

from . import paper
from .section import Colour, Progress, Row, labelled, legend, panels, row_of, select, tidy

TITLE = "What the trainers reach"
TEXT = (
    "Each environment learned by the algorithm named, with the settings that `pearl train` has for it, and "
    "stopped at the first evaluation that reaches `--goal`; then the best policy's mean return over fresh "
    "episodes of another seed, of at most 1,000 steps where an environment has no limit. Seconds are of the "
    "whole training, its evaluations included, on the machine named below."
)
COLUMNS = {
    "environment": "environment",
    "algorithm": "algorithm",
    "n_agents": "agents",
    "seed": "seed",
    "wanted": "wanted",
    "mean_return": "mean return",
    "ci95": "+-",
    "reached": "reached",
    "episodes": "episodes",
    "agent_steps": "agent-steps",
    "seconds": "s of training",
    "counts": "what is wanted, or from where",
}
SEEDS = (0, 1, 2)
FRESH = 1000
"""Seed of the episodes by which a trained policy is judged."""


QUICK_AGENTS, QUICK_EVALUATIONS = 10_752, 6
"""Of a quick report's trainings: a quarter of the agents, and how often they are evaluated."""


class Goal(NamedTuple):
    """What is to be reached, and what a training run aims at: a little more, for its few episodes."""

    env_id: str
    algorithm: str
    wanted: float
    aim: float | None
    episodes: int
    counts: str


def goals() -> list[Goal]:
    """Return what is wanted of each environment."""
    dqn = paper.MINATAR_SEAQUEST_DQN_CURVE
    return [
        Goal("CliffWalking", "q-learning", -13.0, -13.0, 43_008, "the shortest way"),
        Goal("FrozenLake", "q-learning", 0.70, None, 100_000, "share of successes, slippery"),
        Goal("Taxi", "q-learning", 7.0, None, 100_000, ""),
        Goal(
            "Blackjack",
            "q-learning",
            blackjack_optimum() - 0.02,
            None,
            400_000,
            f"within 0.02 of the optimal policy's {blackjack_optimum():.4f}, which is computed",
        ),
        Goal("CartPole", "ppo", 475.0, 495.0, 100_000, "500 is the most"),
        Goal("MountainCar", "ppo", -115.0, -111.0, 20_000, ""),
        Goal("Pendulum", "ppo", -180.0, -165.0, 20_000, ""),
        Goal(
            "Seaquest",
            "ppo",
            dqn,
            dqn + 5,
            2_000,
            f"above MinAtar's DQN: {paper.MINATAR_SEAQUEST_DQN} at the end, {dqn} at most; "
            f"{paper.MINATAR_SOURCE}",
        ),
    ]


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Train and evaluate; with ``quick`` what is learned in seconds, with one seed."""
    work = [
        (goal, seed)
        for goal in goals()
        for seed in (SEEDS[:1] if quick else SEEDS)
        if not quick or goal.algorithm == "q-learning"
    ]
    return [_reach(goal, seed, quick) for goal, seed in progress(work, len(work), "training")]


def _reach(goal: Goal, seed: int, quick: bool) -> Row:
    spec = get_spec(goal.env_id)
    given = {"seed": seed, "n_agents": QUICK_AGENTS} if quick else {"seed": seed}
    settings = settings_for(goal.algorithm, goal.env_id, given)
    every = settings.iterations // QUICK_EVALUATIONS if quick else None
    with tempfile.TemporaryDirectory() as folder:
        training = Training(goal.env_id, goal.algorithm, settings, goal=goal.aim, evaluate_every=every)
        rows = train(training, Path(folder))
        best = trained.load(Path(folder))
    n = min(goal.episodes, 20_000)
    evaluation = Evaluation(spec, best.choose, n, episodes=goal.episodes, seed=FRESH)
    for _ in evaluation.run():
        pass
    mean = float(evaluation.returns.mean())
    return row_of(
        "measured",
        goal.counts,
        environment=goal.env_id,
        algorithm=goal.algorithm,
        n_agents=settings.n_agents,
        seed=seed,
        wanted=goal.wanted,
        mean_return=mean,
        ci95=1.96 * float(evaluation.returns.std()) / math.sqrt(goal.episodes),
        reached=mean >= goal.wanted,
        episodes=goal.episodes,
        agent_steps=rows[-1]["agent_steps"],
        seconds=rows[-1]["seconds"],
    )


def draw(rows: list[Row]) -> Any:
    """Draw a panel an environment: what each seed reached, beside what is wanted."""
    names = list(dict.fromkeys(row["environment"] for row in rows))
    figure, grid = panels(names, 0.6, 2.1)
    for name, axes in grid.items():
        runs = select(rows, environment=name)
        axes.errorbar(
            range(len(runs)),
            [row["mean_return"] for row in runs],
            [row["ci95"] for row in runs],
            fmt="o",
            color=Colour.BLUE,
            capsize=3,
            label="reached",
        )
        axes.axhline(runs[0]["wanted"], color=Colour.ORANGE, linestyle="--", label="wanted")
        axes.set(title=f"{name}\n{runs[0]['algorithm']}", xlim=(-0.5, len(runs) - 0.5))
        axes.set_xticks(range(len(runs)), [f"seed {row['seed']}\n{row['seconds']:.1f} s" for row in runs])
        axes.tick_params(labelsize=8)
        axes.margins(y=0.3)
        axes.grid(alpha=0.3, axis="y")
    tidy(*grid.values(), grid=False)
    figure.supylabel("mean return, with its 95 % interval", fontsize=10)
    legend(figure, labelled(grid[names[0]]), 2)
    return figure


# ---- The optimal policy of Blackjack, with an endless deck: cards are independent of one another ----

_CARDS = {**dict.fromkeys(range(1, 10), 1 / 13), 10: 4 / 13}


def blackjack_optimum() -> float:
    """Return the mean return of the optimal policy, from the rules: by going through all hands."""
    total = 0.0
    for first, p in _CARDS.items():
        for second, q in _CARDS.items():
            for up, r in _CARDS.items():
                natural = {first, second} == {1, 10}
                ace = 1 in (first, second)
                total += (
                    p * q * r * max(_stick(first + second, ace, up, natural), _hit(first + second, ace, up))
                )
    return total


def _score(total: int, ace: bool) -> int:
    return total + 10 if ace and total + 10 <= 21 else total


def _stick(total: int, ace: bool, up: int, natural: bool = False) -> float:
    """Return what is won with a hand as it is. A natural, of two cards, beats all but another one."""
    if natural:
        return 1 - _CARDS.get({1: 10, 10: 1}.get(up, 0), 0.0)
    score, won = _score(total, ace), 0.0
    for second, p in _CARDS.items():
        for dealer, q in _dealer(up + second, 1 in (up, second)):
            won += p * q * ((score > dealer) - (score < dealer))
    return won


@functools.cache
def _hit(total: int, ace: bool, up: int) -> float:
    """Return what is won by taking a card, and playing optimally from there."""
    won = 0.0
    for card, p in _CARDS.items():
        after, with_ace = total + card, ace or card == 1
        won += p * (-1.0 if after > 21 else max(_stick(after, with_ace, up), _hit(after, with_ace, up)))
    return won


@functools.cache
def _dealer(total: int, ace: bool) -> tuple[tuple[int, float], ...]:
    """Return the dealer's scores and how probable they are; 0 for a bust."""
    score = _score(total, ace)
    if score >= 17:
        return ((score if score <= 21 else 0, 1.0),)
    ends: dict[int, float] = {}
    for card, p in _CARDS.items():
        for end, q in _dealer(total + card, ace or card == 1):
            ends[end] = ends.get(end, 0.0) + p * q
    return tuple(ends.items())
