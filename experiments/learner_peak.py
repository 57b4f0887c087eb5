"""What share of this machine's peak the learning of some trainings reaches.

``python experiments/learner_peak.py`` prints the table of docs/training.md ("Share of the peak"): how many
multiplications the networks of PPO's settings take for a sample, forward and back, and how many a second of
processor time that makes. The peak is that of a matrix product by PyTorch, measured before, between and after
the trainings. All is of one thread.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from pearl_marl.envs import get_spec
from pearl_marl.experiments.calling import call
from pearl_marl.policies.convolution import SIDE
from pearl_marl.policies.convolution_vectors import FILTERS
from pearl_marl.policies.network import Encoder
from pearl_marl.training.ppo import PPO
from pearl_marl.training.rollout import RolloutBuffer
from pearl_marl.training.run import settings_for

ENVIRONMENTS = "CartPole", "Seaquest", "LevelBasedForaging"
ITERATIONS = 5
SIZE = 1024
"""Rows and columns of the matrices whose product is the peak."""


def main() -> None:
    """Print the table in Markdown."""
    torch.set_num_threads(1)
    peaks, rows = [peak()], []
    for name in ENVIRONMENTS:
        rows.append((name, *measured(name)))
        peaks.append(peak())
    print("| `ppo` | multiplications forward | back | ms of learning | of an iteration | GFLOP/s | share |")
    print(f"| --- |{' ---: |' * 6}")
    for name, forward, back, learning, whole, samples in rows:
        rate = 2 * (forward + back) * samples / learning
        figures = f"{1000 * learning:.0f} | {1000 * whole:.0f} | {rate / 1e9:.1f} | {rate / max(peaks):.0%}"
        print(f"| {name} | {forward:,} | {back:,} | {figures} |")
    print(f"\nPeak: {max(peaks) / 1e9:.1f} GFLOP/s, the most of {len(peaks)} times.")


def multiplications(model: nn.Module, squares: tuple[float, float]) -> tuple[int, int]:
    """Return the multiplications of a sample by the weights of a model without memory: forward, and back.

    Back, each weight is multiplied twice: for its own gradient, and for that of what it was multiplied by,
    which the first layer's input does not need. Tables are not multiplied by. Of pictures, only ``squares``
    are, see :func:`squares_of`; back, what filters made of these is made again.
    """
    forward = back = 0
    number, elements = squares
    encoders = [module for module in model.modules() if isinstance(module, Encoder)]
    of_pictures = [encoder for encoder in encoders if encoder.kind == "picture"]
    for encoder in of_pictures:
        made, summed = FILTERS * elements, FILTERS * number * encoder.linear.out_features
        forward += round(made + summed)
        back += round(2 * made + 2 * summed)
    others = {id(encoder.linear) for encoder in of_pictures}
    for module in model.modules():
        if isinstance(module, nn.Linear) and id(module) not in others:
            forward += module.weight.numel()
            back += 2 * module.weight.numel()
    back -= sum(encoder.linear.weight.numel() for encoder in encoders if encoder.kind == "vector")
    return forward, back


def squares_of(pictures: npt.NDArray[Any]) -> tuple[float, float]:
    """Return how many squares of a picture are multiplied by weights, and how many elements of those are set.

    These are the squares of 3 by 3 that are not empty, and differ from those of the same place of the other
    ``pictures``, ``(n, rows, columns, channels)``, which are learned from together.
    """
    windows = np.lib.stride_tricks.sliding_window_view(pictures != 0, (SIDE, SIDE), axis=(1, 2))
    places = windows.reshape(len(pictures), -1, windows[0, 0, 0].size).swapaxes(0, 1)
    kinds = [np.unique(squares[squares.any(1)], axis=0) for squares in places]
    return sum(map(len, kinds)) / len(pictures), sum(int(some.sum()) for some in kinds) / len(pictures)


def measured(name: str) -> tuple[int, int, float, float, int]:
    """Return an environment's multiplications forward and back, and seconds of processor time.

    These are of the iteration that learned fastest, of learning and of the whole; and the samples learned
    from in it, each as often as it was.
    """
    spec = get_spec(name)
    trainer = PPO(spec, "native", settings_for("ppo", name, {}, agents=spec.agents))
    learn, last, kept = trainer.learn, (0.0, 0), torch.empty(0)

    def timed(samples: RolloutBuffer, rows: Tensor) -> None:
        nonlocal last, kept
        began = time.process_time()
        learn(samples, rows)
        last = time.process_time() - began, len(rows) * trainer.settings.epochs
        kept = samples.inputs.obs

    trainer.learn = timed  # type: ignore[method-assign]
    trainer.iterate()  # compiles
    rounds = []
    for _ in range(ITERATIONS):
        began = time.process_time()
        trainer.iterate()
        learning, samples = last
        rounds.append((learning, time.process_time() - began, samples))
    fastest = min(rounds, key=lambda figures: figures[0] / figures[2])
    encoder = trainer.model.actor.encoder
    squares = 0.0, 0.0
    if encoder.kind == "picture":  # a half of a minibatch is learned from together
        some = torch.randperm(len(kept))[: trainer.settings.minibatch // 2]
        squares = squares_of(encoder.whole(kept[some]).numpy())
        print(f"{name}: of a picture's squares, {squares[0]:.1f} are multiplied.\n")
    return *multiplications(trainer.model, squares), *fastest


def peak() -> float:
    """Return the operations a second of a product of matrices, the most of a few."""
    matrix = torch.rand(SIZE, SIZE)
    seconds = []
    for _ in range(10):
        began = time.process_time()
        matrix @ matrix
        seconds.append(time.process_time() - began)
    return 2 * SIZE**3 / min(seconds)


if __name__ == "__main__":
    call(main)
