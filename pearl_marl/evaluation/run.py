"""Evaluating a policy on a device: returns, lengths, what each stage of a step took, and a digest.

The digest is a hash over everything that the policy saw and did. Devices give the same answers bit for
bit, so one policy has one digest on all of them. A device policy runs beside the environments, in
rollouts; the digest is then over the return, length and end of each episode.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.base.arrays import Array
from pearl_marl.batch.config import worlds_of
from pearl_marl.batch.results import check_memory, memory_of_machine
from pearl_marl.batch.step import BatchStep, on_host
from pearl_marl.checks import checked_count_or_none, checked_function
from pearl_marl.devices import BatchConfig, Device, make_device, rollouts
from pearl_marl.devices.transport import STAGES
from pearl_marl.errors import ArgumentError, OrderError
from pearl_marl.evaluation.episodes import RunningEpisodes
from pearl_marl.golden.rng import checked_seed
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.policies.loading import Policy, forget
from pearl_marl.spec import MAX_CYCLES, EnvSpec, check_spec

LIMIT = 1000
"""The time limit where neither the environment nor the caller has one: a policy that gets nowhere would
never end."""

CONFIDENCE = 1.96
"""Standard errors to either side of a mean that make 95 % of a normal distribution."""

FIRST_STEPS = 64
"""Steps of the first rollout of a policy that runs beside the environments."""

FASTER, SLOWER = 8, 2
"""How many times as many steps the next rollout has: where no episode has ended yet, and where some have."""

BINS = 60

EPISODE_BYTES = 16
"""What an episode takes: its return and its length."""


class Evaluation:
    """One policy on one device, for a given number of episodes.

    Every agent counts its first episodes and no others: of ``n`` agents and ``m`` episodes each has
    ``m // n``, and the first ``m % n`` one more. To take the episodes that end first would prefer short ones.

    Parameters
    ----------
    policy
        What chooses actions; see :mod:`pearl_marl.policies.loading`. Of a device policy, agents do their
        second and further episodes in worlds of other seeds, which follow from ``seed``.
    device
        A name or a device. Of a :class:`~pearl_marl.devices.Lockstep`, the device that is checked is timed.
    episodes
        How many count; one an agent, if not given.
    max_cycles
        Time limit of an episode, 0 for none; ``None`` is the environment's own, or :data:`LIMIT` where it has
        none.

    Attributes
    ----------
    returns, lengths
        Of every counted episode, the first agent's first; in the course of the run, those done.
    truncated
        How many of them only the time limit ended.
    steps
        Steps taken by every agent; of a device policy, those of the rollouts whose episodes count.
    """

    def __init__(
        self,
        spec: EnvSpec,
        policy: Policy | DevicePolicy,
        n_agents: int,
        device: str | Device = "native",
        *,
        episodes: int | None = None,
        seed: int = 0,
        max_cycles: int | None = None,
    ) -> None:
        check_spec(spec)
        if not isinstance(policy, DevicePolicy):
            checked_function("policy", policy)
        most = memory_of_machine() // EPISODE_BYTES
        episodes = checked_count_or_none("the number of episodes", episodes)
        if episodes is not None and episodes > most:
            raise ArgumentError(
                f"the number of episodes is {episodes:,}; it must be at least 1, and this machine has memory "
                f"for {most:,}"
            )
        if max_cycles is None:
            max_cycles = spec.max_cycles or LIMIT
        worlds = worlds_of(spec, n_agents)
        self.config = BatchConfig(spec=spec, n_envs=worlds, max_cycles=max_cycles, copy=False)
        check_memory(self.config, 48)  # bytes of notes for each agent
        self.episodes = n_agents if episodes is None else episodes
        self.device = make_device(device)
        self.seed, self._policy = checked_seed(seed), policy
        self._players: tuple[Policy | DevicePolicy, ...] = (policy,)
        self.steps = self.truncated = 0
        self._quota = np.full(n_agents, self.episodes // n_agents)
        self._quota[: self.episodes % n_agents] += 1
        self._first = np.cumsum(self._quota) - self._quota  # the index of an agent's first episode
        self._done = np.zeros(n_agents, np.int64)
        self._running = RunningEpisodes(n_agents)
        self._returns, self._lengths = np.full(self.episodes, np.nan), np.zeros(self.episodes, np.int64)
        self._digest = hashlib.sha256()
        self._seconds: list[dict[str, float]] = []
        self._agent_steps_per_second: list[float] = []
        self._cycles: set[int] = set()

    @property
    def returns(self) -> npt.NDArray[np.float64]:
        """Sums of rewards."""
        return self._returns[self._lengths > 0]

    @property
    def lengths(self) -> npt.NDArray[np.int64]:
        """Numbers of steps."""
        return self._lengths[self._lengths > 0]

    def run(self) -> Iterator[None]:
        """Run it, once; yields for every episode that counts.

        Raises
        ------
        ActionError
            The policy's actions are not actions of the environment.
        LockstepError
            The device is a lockstep, and its two devices differ.
        """
        self.device.open(self.config)
        try:
            if isinstance(self._policy, DevicePolicy):
                yield from self._roll_out(self._policy)
            else:
                yield from self._step_by_step(self._policy)
            if self.device.words_compared is not None:
                self.device.snapshot()  # compares the states after the last step
        finally:
            self.device.close()

    def _step_by_step(self, policy: Policy) -> Iterator[None]:
        stages = self.device.timed()
        for player in self._players:
            forget(player)
        observed = self._observed(self.device.reset(self.seed))
        self._add(*observed)
        present = np.ones(self.config.n_agents, np.bool_)
        remaining = self.episodes
        while remaining:
            began = time.perf_counter()
            actions = policy(*observed)
            chosen = time.perf_counter()
            encoded = self.device.encoded(actions)
            checked = time.perf_counter() - chosen
            step = self.device.step_words(encoded).on_host()
            packed = checked + stages.get("pack", 0.0)
            self._seconds.append({"policy": chosen - began, **stages, "pack": packed})
            if self.device.cycles is not None:
                self._cycles.add(self.device.cycles)
            # One that has ended before its world may have had steps of no episode since.
            for player in self._players:
                forget(player, step.ended | ~present)
            present = step.in_episode.copy()
            observed = self._observed(step.obs)
            self._add(encoded, *step[:4], step.final_obs[step.ended], *observed[1:])
            counted = self._count(step)
            remaining -= counted
            yield from (None,) * counted

    def _roll_out(self, policy: DevicePolicy) -> Iterator[None]:
        """Count one episode of each agent that has one left, from a reset, until none has."""
        limit, seed = self.config.limit, self.seed
        later = np.random.default_rng(self.seed)
        while len(agents := np.flatnonzero(self._done < self._quota)):
            steps = counted = 0
            # How long the longest episode is, is not known; to begin again costs at most as many steps again.
            while counted < len(agents):
                growth = SLOWER if counted else FASTER
                steps = min(max(growth * steps, FIRST_STEPS), limit or MAX_CYCLES)
                self.device.reset(seed)
                began = time.perf_counter()
                sums = self.device.rollout(policy, steps, episodes=1)
                seconds = time.perf_counter() - began
                self._agent_steps_per_second.append(steps * self.config.n_agents / seconds)
                ended = int(sums.ended[agents].sum())
                yield from (None,) * (ended - counted)
                counted = ended
            self.steps += steps
            results = [array[agents] for array in (sums.returns, sums.lengths, sums.truncated)]
            self._add(*results)
            self._record(agents, *results)
            seed = int(later.integers(1 << 31))

    def _observed(self, obs: Array) -> tuple[Array, ...]:
        """Return the arguments of the policy: observations, and masks if there are any."""
        masks = self.device.action_masks
        return (on_host(obs),) if masks is None else (on_host(obs), on_host(masks))

    def _add(self, *arrays: Array) -> None:
        for array in arrays:
            self._digest.update(np.ascontiguousarray(array).view(np.uint8).data)

    def _count(self, step: BatchStep) -> int:
        self.steps += 1
        ended = self._running.add(step)
        wanted = self._done[ended.slots] < self._quota[ended.slots]
        agents, *results = (
            array[wanted] for array in (ended.slots, ended.returns, ended.lengths, ended.truncated)
        )
        self._record(agents, *results)
        return agents.size

    def _record(self, agents: Array, returns: Array, lengths: Array, truncated: Array) -> None:
        """Keep the next episode of each of some agents."""
        episodes = self._first[agents] + self._done[agents]
        self._returns[episodes], self._lengths[episodes] = returns, lengths
        self.truncated += int(truncated.sum())
        self._done[agents] += 1

    @property
    def digest(self) -> str:
        """SHA-256 over all that the policy has seen and done so far."""
        return self._digest.hexdigest()

    @property
    def world_returns(self) -> npt.NDArray[np.float64]:
        """Returns of each agent of a world, shape ``(episodes, K)``: of those that count for all of them."""
        agents = self.config.spec.agents
        whole = self._quota.reshape(-1, agents).min(1)
        first = np.repeat(self._first.reshape(-1, agents), whole, axis=0)
        number = np.arange(whole.sum()) - np.repeat(np.cumsum(whole) - whole, whole)
        returns: npt.NDArray[np.float64] = self._returns[first + number[:, None]]
        return returns

    def _of_worlds(self) -> dict[str, Any]:
        """Return how teams did: all agents of a world together, and each of them."""
        spec, returns = self.config.spec, self.world_returns
        if spec.agents == 1 or not len(returns):
            return {}
        names = [role.name for role in spec.roles] or ["agent"] * spec.agents
        each = [{"agent": k, "role": name, **interval(returns[:, k])} for k, name in enumerate(names)]
        return {"world_return": interval(returns.sum(1)), "agents": each}

    def summary(self) -> dict[str, Any]:
        """Return all figures by name, for JSON.

        Latencies leave out the first step, which loads the code. Rollouts have a rate, that of the fastest.
        """
        if not (self._seconds or self._agent_steps_per_second):
            raise OrderError("summary() before run(): iterate over run() first")
        result = {
            "environment": self.config.spec.id,
            "options": dict(self.config.spec.options),
            "device": self.device.name,
            "n_agents": self.config.n_agents,
            "seed": self.seed,
            "max_cycles": self.config.limit,
            "steps": self.steps,
            "episodes": len(self.returns),
            "truncated": self.truncated,
            "return": interval(self.returns),
            "length": interval(self.lengths),
            "interval": "mean +- 1.96 standard errors: 95 %, by normal approximation",
            **self._of_worlds(),
            "digest": self.digest,
        }
        if self._seconds:
            stages = [name for name in ("policy", *STAGES) if name in self._seconds[-1]]
            result["latency"] = [
                {"stage": name, "paper": STAGES.get(name), **spread([row[name] for row in self._seconds])}
                for name in stages
            ]
            result["step"] = spread([sum(row.values()) - row["policy"] for row in self._seconds])
        elif self.device.words_compared is None:  # else most of the time goes into comparing
            result["agent_steps_per_second"] = max(self._agent_steps_per_second)
        if self._cycles:
            result["clock_cycles"] = {"min": min(self._cycles), "max": max(self._cycles)}
        if self.device.words_compared is not None:
            result["words_compared"] = self.device.words_compared
        return result


def acting(policy: Policy | DevicePolicy, device: Callable[[], Device]) -> Policy:
    """Return a policy as a function of observations; one in integers looks at the slots of ``device()``."""
    if not isinstance(policy, DevicePolicy):
        return policy

    def choose(*_: Array) -> Array:
        on = device()
        choice = rollouts.chosen(on.config, policy, on.shown_to(policy), on.seed, on.tick)
        return rollouts.actions_of(on.config.spec, choice.words)

    return choose


def interval(values: Array) -> dict[str, float | None]:
    """Return mean, standard deviation, extremes and the 95 % confidence interval of the mean.

    The interval is that of the normal approximation; of one value there is none.
    """
    mean, low, high = float(values.mean()), None, None
    deviation = float(values.std(ddof=1)) if values.size > 1 else None
    if deviation is not None:
        half = CONFIDENCE * deviation / math.sqrt(values.size)
        low, high = mean - half, mean + half
    return {
        "mean": mean,
        "std": deviation,
        "min": float(values.min()),
        "max": float(values.max()),
        "ci95_low": low,
        "ci95_high": high,
    }


def spread(seconds: list[float]) -> dict[str, Any]:
    """Return how a duration is spread over steps: percentiles in microseconds, and a histogram."""
    times = np.array(seconds[1:] or seconds) * 1e6
    # Log-spaced, as one step in a thousand may take a thousand times as long.
    low, high = max(times.min(), 1e-3), max(times.max(), 2e-3)
    counts, edges = np.histogram(times, np.geomspace(low * 0.99, high * 1.01, BINS + 1))
    percentiles = np.percentile(times, [50, 90, 99])
    return {
        "mean_us": float(times.mean()),
        **{f"p{p}_us": float(value) for p, value in zip((50, 90, 99), percentiles, strict=True)},
        "max_us": float(times.max()),
        "histogram": {"edges_us": edges.tolist(), "counts": counts.tolist()},
    }
