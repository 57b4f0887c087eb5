"""What a policy loses when it becomes one in integers: both act in the same worlds."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.evaluation.run import CONFIDENCE, Evaluation, interval
from pearl_marl.policies import quantizing, trained
from pearl_marl.policies.integer_network import AgentNetworks, IntegerNetwork

SAMPLES = 4096
"""Observations that a policy is quantised by."""

EVERY = 16
"""Steps between two of which some are taken."""


class Quantization:
    """A trained policy, and what becomes of it in integers.

    Parameters
    ----------
    path
        What ``pearl train`` made: a run folder, or its ``policy.safetensors``.
    seed
        Of both evaluations, so that they meet the same starts.
    weight_bits, activation_bits
        See :func:`pearl_marl.policies.quantizing.quantized`.

    Attributes
    ----------
    spec
        The environment of the policy.
    network
        The policy in integers, after :meth:`run`.
    before, after
        Returns of the trained policy's agents, and of the other one's.
    """

    network: IntegerNetwork | AgentNetworks
    before: Array
    after: Array

    def __init__(self, path: Path, seed: int, weight_bits: int, activation_bits: int) -> None:
        self._policy = trained.load(path)
        quantizing.check_quantizable(self._policy)
        self.spec = self._policy.spec
        self._seed, self._bits = seed, (weight_bits, activation_bits)

    def run(self, n_agents: int) -> Iterator[None]:
        """Evaluate, quantise, evaluate again, with so many agents and an episode each.

        Yields for every episode that has ended.
        """
        samples: list[Array] = []
        steps = 0

        def acting(observations: Array, masks: Array | None = None) -> Array:
            nonlocal steps
            if steps % EVERY == 0 and sum(map(len, samples)) < SAMPLES:
                samples.append(observations[: SAMPLES // 16 // self.spec.agents * self.spec.agents].copy())
            steps += 1
            return self._policy.choose(observations, masks)

        self._policy.seed(self._seed)
        evaluation = Evaluation(self.spec, acting, n_agents, seed=self._seed)
        yield from evaluation.run()
        self.before = evaluation.returns
        self.network = quantizing.quantized(self._policy, np.concatenate(samples), *self._bits)
        evaluation = Evaluation(self.spec, self.network, n_agents, seed=self._seed)
        yield from evaluation.run()
        self.after = evaluation.returns

    def summary(self) -> dict[str, Any]:
        """Return all figures by name, for JSON."""
        before, after = interval(self.before), interval(self.after)
        n = len(self.before)
        change = float(self.after.mean() - self.before.mean())
        low = high = None
        if n > 1:
            half = CONFIDENCE * math.sqrt((self.before.var(ddof=1) + self.after.var(ddof=1)) / n)
            low, high = change - half, change + half
        return {
            "environment": self.spec.id,
            "options": dict(self.spec.options),
            "weight_bits": self._bits[0],
            "activation_bits": self._bits[1],
            "n_agents": n,
            "seed": self._seed,
            "return_before": before,
            "return_after": after,
            "change": {"mean": change, "ci95_low": low, "ci95_high": high},
        }
