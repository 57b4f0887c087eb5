"""What share of this machine's peak the learning of some trainings reaches.

``python experiments/learner_peak.py`` prints the table of docs/training.md ("Share of the peak"): how many
multiplications the networks of PPO's settings take for a sample, forward and back, and how many a second of
processor time that makes. The peak is that of a matrix product by PyTorch, measured before, between and after
the trainings. All is of one thread.
"""

from __future__ import annotations

import time

import torch
from torch import Tensor, nn

from pearl_marl.envs import get_spec
from pearl_marl.experiments.calling import call
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


def multiplications(model: nn.Module, set_elements: float) -> tuple[int, int]:
    """Return the multiplications of a sample by the weights of a model without memory: forward, and back.

    Back, each weight is multiplied twice: for its own gradient, and for that of what it was multiplied by,
    which the first layer's input does not need. Tables are not multiplied by. Filters are, by the elements of
    a picture that are not 0, of which there are ``set_elements``; back, what they made is made again.
    """
    forward = back = 0
    for module in model.modules():
        if isinstance(module, nn.Linear):
            forward += module.weight.numel()
            back += 2 * module.weight.numel()
        elif isinstance(module, nn.Conv2d):
            made = round(module.weight[:, 0].numel() * set_elements)
            forward += made
            back += 2 * made
        elif isinstance(module, Encoder) and module.kind == "vector":
            back -= module.linear.weight.numel()
    return forward, back


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
    in_all = int(encoder.whole(kept).count_nonzero()) if encoder.kind == "picture" else 0
    return *multiplications(trainer.model, in_all / len(kept)), *fastest


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
