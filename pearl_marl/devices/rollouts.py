"""What a rollout is made of: a policy's choices, the sums, and where they are wanted the steps.

The rollout by single steps, which every device can do and others are held against, is :class:`Device`'s.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from pearl_marl.base.arrays import Array
from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.results import check_memory
from pearl_marl.batch.rollout import SUMS, Experience, Rollout
from pearl_marl.batch.step import BatchStep, Observed
from pearl_marl.checks import checked_count_or_none, checked_flag, checked_integer
from pearl_marl.compiler.kernels import compile_kernels
from pearl_marl.errors import ArgumentError
from pearl_marl.policies.device_policy import ActionChoice, DevicePolicy, policy_draws
from pearl_marl.spec import EnvSpec

PART_SECONDS = 0.1
"""How long a part of a rollout lasts at most, about."""


def in_parts(steps: int) -> Iterator[tuple[int, int]]:
    """Yield the first step and the number of steps of each part of a rollout, by the time that the last took.

    Between two parts Ctrl-C has its effect.
    """
    done, some = 0, 1
    while done < steps:
        some, began = min(some, steps - done), time.perf_counter()
        yield done, some
        done += some
        seconds = max(time.perf_counter() - began, 1e-6)
        some = max(1, int(some * min(8.0, PART_SECONDS / seconds)))


class Sums(NamedTuple):
    """What a rollout adds up, an element an agent."""

    running: Array  # float64: the return of the episode so far
    length: Array  # int64: its steps so far
    whole: Array  # uint8: whether it began in the rollout or with it
    waiting: Array  # uint8: 1 if it has ended before its world, 2 if its world resets in the next step
    returns: Array  # float64: of whole episodes that ended
    squares: Array  # float64
    lengths: Array  # int64
    ended: Array  # int64
    truncated: Array  # int64
    most: Array  # int64: how many episodes count

    @classmethod
    def of(cls, elapsed: Array, in_episode: Array, resetting: Array, episodes: int | None) -> Sums:
        """Return the sums of no steps.

        ``elapsed`` are each agent's steps of its episode so far. An agent that is not in an episode, or whose
        world spends the next step on its reset, begins a whole one later.
        """
        n = len(in_episode)
        waiting = np.where(resetting, 2, ~in_episode.astype(np.bool_)).astype(np.uint8)
        whole = ((elapsed == 0) | (waiting != 0)).astype(np.uint8)
        most = np.full(n, np.iinfo(np.int64).max if episodes is None else episodes)
        running, returns, squares = np.zeros((3, n), np.float64)
        length, lengths, ended, truncated = np.zeros((4, n), np.int64)
        return cls(running, length, whole, waiting, returns, squares, lengths, ended, truncated, most)

    def add(self, step: BatchStep, next_step: bool) -> None:
        """Count one step; with ``next_step``, worlds that end spend the next one on their reset."""
        acting = self.waiting == 0
        self.running[acting] += step.rewards[acting]
        self.length[acting] += 1
        over = acting & (step.terminations | step.truncations)
        counted = over & (self.whole != 0) & (self.ended < self.most)
        self.returns[counted] += self.running[counted]
        self.squares[counted] += self.running[counted] ** 2
        self.lengths[counted] += self.length[counted]
        self.ended[counted] += 1
        self.truncated[counted] += ~step.terminations[counted]
        self.running[over], self.length[over], self.whole[over] = 0, 0, 1
        # All agents are present again when their world has ended.
        later = np.where(step.in_episode, 2 if next_step else 0, 1)
        self.waiting[:] = np.where(over | (self.waiting == 1), later, 0)

    def result(self, steps: int, recorded: dict[str, Any]) -> Rollout:
        """Return the result of a rollout of so many steps, with what was recorded of them."""
        return Rollout(steps=steps, **{name: getattr(self, name) for name in SUMS}, **recorded)


class Record(NamedTuple):
    """Every step of a rollout, with observations as :func:`recorded_form` has them."""

    observations: Array  # (steps, n_agents, elements)
    masks: Array  # (steps, n_agents, n_actions) int8; of no agents without masks
    words: Array  # (steps, n_agents, fields) int64: actions
    rewards: Array  # (steps, n_agents) float32
    terminations: Array  # (steps, n_agents) uint8
    truncations: Array  # (steps, n_agents) uint8
    logits: Array  # (steps, n_agents, outputs) int32; of no outputs without logits
    # For learners, whose logits are the bits of floats; else of no agents.
    noise: Array  # (steps, n_agents, outputs) uint32: bits of floats, which the policy is given for draws
    present: Array  # (steps, n_agents) uint8: which agents take part
    final: Array  # as observations: what agents saw last, where the time limit ended their episodes

    @classmethod
    def of(cls, config: BatchConfig, steps: int, logits: int, noise: Array | None = None) -> Record:
        """Return room for so many steps; for a learner, whose ``noise`` the policy is given."""
        spec, n = config.spec, config.n_agents
        form = recorded_form(spec)
        rows, masks = (steps, n), len(spec.mask_fields)
        learners = (steps, 0 if noise is None else n)
        return cls(
            np.empty((*rows, form.observation_size), element_dtype(form)),
            np.empty((steps, n if masks else 0, masks), np.int8),
            np.empty((*rows, len(spec.action_fields)), np.int64),
            np.empty(rows, np.float32),
            np.empty(rows, np.uint8),
            np.empty(rows, np.uint8),
            np.empty((*rows, logits), np.int32),
            np.empty((*learners, 0), np.uint32) if noise is None else noise.view(np.uint32),
            np.empty(learners, np.uint8),
            np.empty((*learners, form.observation_size), element_dtype(form)),
        )

    def in_bytes(self) -> Record:
        """Return the same memory with observations as bytes, as the compiled loop takes them."""
        return self._replace(observations=self.observations.view(np.uint8), final=self.final.view(np.uint8))

    def between(self, start: int, stop: int) -> Record:
        """Return some of the steps, in the same memory."""
        return Record(*(array[start:stop] for array in self))

    def arrays(self, config: BatchConfig) -> dict[str, Any]:
        """Return the steps as a :class:`Rollout` has them: as an environment takes and gives them."""
        spec = config.spec
        return {
            "observations": observations_of(spec, self.observations),
            "action_masks": self.masks if spec.mask_fields else None,
            "actions": actions_of(spec, self.words),
            "rewards": self.rewards,
            "terminations": self.terminations.view(np.bool_),
            "truncations": self.truncations.view(np.bool_),
            "logits": self.logits if self.logits.shape[2] else None,
        }

    def experience(self, config: BatchConfig, last: Observed) -> Experience:
        """Return the steps as a learner takes them, and what was observed ``last``."""
        spec, cut = config.spec, self.truncations.view(np.bool_)
        steps, agents = cut.shape
        observations = np.empty((steps + 1, agents, *spec.observation_shape), spec.observation_dtype)
        observations_of(spec, self.observations, observations[:-1])
        observations[-1] = last.obs
        # np.zeros() takes memory that the system clears when it is first used; zeros_like() writes all.
        final = np.zeros((steps, agents, *spec.observation_shape), spec.observation_dtype)
        final[cut] = observations_of(spec, self.final[cut])
        masks = None if last.action_masks is None else np.concatenate([self.masks, last.action_masks[None]])
        return Experience(
            observations=observations,
            action_masks=masks,
            in_episode=np.concatenate([self.present.view(np.bool_), last.in_episode[None]]),
            words=self.words,
            outputs=self.logits.view(np.float32),
            rewards=self.rewards,
            terminations=self.terminations.view(np.bool_),
            truncations=cut,
            final_observations=final,
        )


def observations_of(spec: EnvSpec, elements: Array, out: Array | None = None) -> Array:
    """Return elements of :func:`recorded_form`, shape ``(..., elements)``, as an environment gives them.

    ``out``, if given, is an array in C order, to which they are written, and which is returned.
    """
    dtype = spec.observation_dtype
    if dtype == np.bool_:
        elements = elements.view(dtype)
    elif recorded_form(spec) is not spec:
        scale = np.array([2.0**-bits for bits in spec.element_fractions], dtype)
        rows = None if out is None else out.reshape(elements.shape)  # a view, as they lie one after the other
        elements = np.multiply(elements, scale, out=rows, dtype=dtype, casting="unsafe")
        if out is not None:
            return out
    shaped = elements.reshape(*elements.shape[:-1], *spec.observation_shape)
    if out is None:
        return shaped
    out[:] = shaped
    return out


def actions_of(spec: EnvSpec, words: Array) -> Array:
    """Return words of actions, of shape ``(..., fields)``, as an environment takes them."""
    fractions = np.array([2.0**-field.fraction for field in spec.action_fields])
    actions = words * fractions if fractions.min() < 1 else words
    space = spec.action_space
    return actions.astype(space.dtype).reshape(*words.shape[:-1], *(space.shape or ()))


def chosen(
    config: BatchConfig, policy: DevicePolicy, observed: Observed, seed: tuple[int, int], tick: int
) -> ActionChoice:
    """Return what a policy chooses for all agents at a tick, of elements and masks that they are shown."""
    agents = config.spec.agents
    slots = np.repeat(config.first_slot + np.arange(config.n_envs), agents)
    rows = np.tile(np.arange(agents), config.n_envs)
    draws = policy_draws(policy.draws, seed, tick, slots, rows, agents)
    return policy.choose(observed.obs, rows, observed.action_masks, draws)


def check_experience(config: BatchConfig, network: DevicePolicy, noise: Any) -> None:
    """Refuse what compiled loops do not look at: another environment's network, noise of another form."""
    spec, outputs = config.spec, sum(config.spec.action_counts)
    _check_spaces(spec, network)
    if spec.unpack is not None:
        raise ArgumentError(
            f"{spec.name} unpacks its observations; experience() takes environments that do not"
        )
    if config.autoreset_mode is not AutoresetMode.SAME_STEP:
        raise ArgumentError(f"autoreset_mode is {config.autoreset_mode}; experience() takes SAME_STEP")
    shape = (len(noise), config.n_agents, outputs)
    if not len(noise) or noise.shape != shape or noise.dtype != np.float32 or not noise.flags.c_contiguous:
        raise ArgumentError(
            f"noise is {noise.dtype} of shape {noise.shape}; it must be float32 of shape (steps, "
            f"{config.n_agents}, {outputs}), of at least a step, in C order"
        )


def check(config: BatchConfig, policy: object, steps: Any, record: object, episodes: object) -> None:
    """Refuse what is no policy for an environment, or no number of steps."""
    spec = config.spec
    if not isinstance(policy, DevicePolicy):
        raise ArgumentError(
            f"policy is {policy!r}; a rollout takes a policy in integers, as pearl_marl.load_policy returns, "
            "or a rule of your own, a GoldenPolicy"
        )
    _check_spaces(spec, policy)
    checked_integer("steps", steps)
    checked_count_or_none("episodes", episodes)
    checked_flag("record", record)
    if record:
        seen = recorded_form(spec)
        each = 2 * seen.observation_size * element_dtype(seen).itemsize + len(spec.mask_fields)
        check_memory(config, int(steps) * (each + 16 * len(spec.action_fields) + 6 + 4 * policy.logits))


def _check_spaces(spec: EnvSpec, policy: DevicePolicy) -> None:
    """Refuse a policy for another environment."""
    if policy.spec is spec:
        return
    for what, theirs, own in (
        ("observation_space", policy.spec.observation_space, spec.observation_space),
        ("action_space", policy.spec.action_space, spec.action_space),
        ("elements", policy.form(policy.spec).observation_space, policy.form(spec).observation_space),
    ):
        if theirs != own:
            raise ArgumentError(
                f"the policy is for {policy.spec.name} with the {what} {theirs}; here it is {own}"
            )


def recorded_form(spec: EnvSpec) -> EnvSpec:
    """Return the spec whose observations a rollout records: those in elements, unless rounding made them."""
    return spec if spec.unpack is not None else spec.in_elements


def element_dtype(seen: EnvSpec) -> np.dtype[Any]:
    """Return the dtype of elements: that of observations, whose flags are bytes."""
    return np.dtype(np.uint8) if seen.observation_dtype == np.bool_ else seen.observation_dtype


def look(config: BatchConfig, spec: EnvSpec, memory: Array) -> Observed:
    """Return what agents are shown in the states in some slots' memory.

    Observations are as ``spec`` has them, and have the shape ``(n_agents, elements)``.
    """
    n = config.n_agents
    obs = np.empty((n, *spec.observation_shape), element_dtype(spec))
    masks = np.zeros((n, len(spec.mask_fields)), np.int8)
    in_episode = np.ones(n, np.uint8)
    views = obs, *((masks,) if spec.mask_fields else ()), *((in_episode,) if spec.agents > 1 else ())
    nothing = np.zeros(config.n_envs, np.uint8)
    place = 0, 0, np.int64(0), config.first_slot, False, config.n_envs, 0, config.n_envs
    compile_kernels(spec).reset(memory, memory, nothing, views, *place)
    return Observed(obs.reshape(n, -1), masks if spec.mask_fields else None, in_episode.view(np.bool_))
