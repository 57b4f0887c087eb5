"""The CPU as a device: the compiled golden step, on one thread or several."""

from __future__ import annotations

import itertools
import time
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Discrete
from gymnasium.vector import AutoresetMode

from pearl_marl.base.arrays import Array
from pearl_marl.base.deferral import completed, uninterrupted
from pearl_marl.batch.actions import are_words, room_for_words
from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.results import ResultArrays
from pearl_marl.batch.rollout import Rollout
from pearl_marl.batch.slot_memory import SlotMemory, aligned_bytes, counter_dtype
from pearl_marl.batch.step import BatchStep, Observed
from pearl_marl.checks import checked_count_or_none
from pearl_marl.compiler.addresses import address_of
from pearl_marl.compiler.kernel_loops import BLOCK, RESULTS, STEP_ARGUMENTS
from pearl_marl.compiler.kernels import compile_kernels
from pearl_marl.devices.base import READY, Device
from pearl_marl.devices.native_rollout import StepArrays, compiled_policy, compiled_rollout
from pearl_marl.devices.rollouts import Record, Sums, element_dtype, in_parts, recorded_form
from pearl_marl.devices.threads import ThreadCount, Threads, cores
from pearl_marl.errors import ActionError
from pearl_marl.golden import rng
from pearl_marl.policies.dense_policy import DenseNetwork
from pearl_marl.policies.device_policy import CompiledPolicy, DevicePolicy

_TICK = STEP_ARGUMENTS.index("tick")
_SEEDS = slice(STEP_ARGUMENTS.index("seed_0"), STEP_ARGUMENTS.index("seed_1") + 1)

TRIAL_STEPS, TRIAL_PARTS = 5, 2
"""Steps in a row, and parts of a rollout, that decide how many threads they take."""


class Native(Device):
    """The CPU.

    Parameters
    ----------
    threads
        How many threads share a step, or a rollout. ``None`` starts with one, takes more once steps prove
        long enough, and gives them up again if they do not help. Results are the same.
    """

    name = "native"

    def __init__(self, threads: int | None = None) -> None:
        threads = checked_count_or_none("threads", threads)
        self._threads, self._of_rollouts = (ThreadCount(threads, n) for n in (TRIAL_STEPS, TRIAL_PARTS))

    @property
    def tick(self) -> int:
        """See :class:`Device`. It is an argument of the kernels, which may move it with the slots."""
        return int(self._arguments[_TICK])

    @tick.setter
    def tick(self, tick: int) -> None:
        self._arguments[_TICK] = tick

    def _open(self, config: BatchConfig) -> None:
        spec, n = config.spec, config.n_envs
        self._results = ResultArrays(config)
        self._slots = SlotMemory(spec, n)
        self._memory = self._slots.bytes
        self._arguments = np.zeros(len(STEP_ARGUMENTS), np.uint64)
        self._count(config, self._slots.elapsed)
        # Without stored initial states the kernels get the memory itself, and do not look.
        self._stored = SlotMemory(spec, n).bytes if config.initial_states == "stored" else self._memory
        more = ("action_masks",) * bool(spec.mask_fields) + ("alive",) * (spec.agents > 1)
        self._address_of_results = np.array([STEP_ARGUMENTS.index(name) for name in (*RESULTS, *more)])
        self._words = room_for_words(spec, config.n_agents)  # as the kernel takes them
        # Others are checked by what the kernel does not know: roles, and masks of before the step. Of a
        # class that does more in a step, the tick moves after that.
        unknown = spec.roles or spec.masked == "refused" or type(self)._step is not Native._step
        self._checks = isinstance(spec.action_space, Discrete) and not unknown
        self._set("memory", self._memory.ctypes.data)
        self._set("stored", self._stored.ctypes.data)
        self._set("first_slot", config.first_slot)
        self._set("next_step", config.autoreset_mode is AutoresetMode.NEXT_STEP)
        self._set("use_stored", self._stored is not self._memory)
        self._set("n", n)
        self._set("checked", self._checks)
        self._addresses: Array | None = None
        self._seed: tuple[int, int] | None = None
        self._pool = Threads(max(self._threads.now, cores()), "pearl-native")

    def _count(self, config: BatchConfig, elapsed: Array) -> None:
        """Keep elapsed steps in the narrowest words that can count on: every step reads and writes them all.

        The environment's own limit counts, too, so that lower ones need no other kernels.
        """
        most = max(config.limit, config.spec.max_cycles or 0, int(elapsed.max()) + 1)
        words = counter_dtype(most)
        self._elapsed = aligned_bytes(config.n_envs * words.itemsize).view(words)
        self._elapsed[:] = elapsed
        self._set("elapsed", self._elapsed.ctypes.data)
        self._set("limit", config.limit)
        self._kernels = compile_kernels(config.spec, words)

    def _set(self, name: str, value: int) -> None:
        """Change an argument of every step."""
        self._arguments[STEP_ARGUMENTS.index(name)] = value

    def _run(self, threads: int, kernel: Any, arguments: tuple[Any, ...]) -> Any:
        """Call ``kernel(*arguments, lo, hi)`` for every range, one of them on this thread.

        Where there is only one range, return what it returns.
        """
        n = self.config.n_envs
        if threads == 1:
            return kernel(*arguments, 0, n)
        blocks = -(-n // BLOCK)
        parts = min(threads, blocks)
        # Ranges end where blocks do.
        edges = [blocks * i // parts * BLOCK for i in range(parts)] + [n]
        first, *others = itertools.pairwise(edges)
        tasks = [self._pool.submit(partial(kernel, *arguments, lo, hi)) for lo, hi in others]
        kernel(*arguments, *first)
        for task in tasks:
            task.result()
        return True

    def _reset(self, mask: Array | None, seed: int | None) -> Observed:
        config, stored = self.config, self._stored
        n = config.n_envs
        flags = np.ones(n, np.uint8) if mask is None else mask.astype(np.uint8)
        results = self._results.take()
        use_stored = stored is not self._memory
        observed = results.obs, *results.arrays[5:]
        again = use_stored and mask is not None
        position = (*self.seed, rng.signed(self.tick), config.first_slot, again, n)
        self._run(self._threads.now, self._kernels.reset, (self._memory, stored, flags, observed, *position))
        self._elapsed[slice(None) if mask is None else mask] = 0
        if use_stored and mask is None:
            stored[:] = self._read()[0]
        return results.observed

    def step(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every slot once; see :meth:`Device.step`."""
        # The kernel looks at the actions itself, where no other thread has begun by then.
        if not (
            self.phase is READY and self._checks and self._threads.now == 1 and self.stage_seconds is None
        ):
            return super().step(actions)
        if not are_words(actions, self._words):
            actions = self.encoded(actions)
        tick = self._arguments[_TICK]
        try:
            if self.remembers:  # which step_words() does, and keeps Ctrl-C off until it has
                return self.step_words(actions)  # type: ignore[arg-type]
            # One call of the kernel moves slots and tick, so that Ctrl-C comes before both or after both.
            return self._step(actions)  # type: ignore[arg-type]
        except ActionError:
            if self.config.autoreset_mode is not AutoresetMode.NEXT_STEP:
                raise
            return super().step(actions)  # which looks whether they are of slots that only reset
        except BaseException as error:
            if self._arguments[_TICK] != tick and not self.remembers:
                completed(error, "step")
            raise

    def _step(self, actions: Array) -> BatchStep:
        results, block = self._results.take_block()
        addresses = block.addresses
        threads = self._threads
        began = time.perf_counter() if threads.tuning else 0.0
        arguments = self._arguments
        # They may be results of the last step, which this one writes over, unless they own their memory.
        if (
            actions.base is not None
            and not self.config.copy
            and np.may_share_memory(actions, results.obs.base)
        ):
            self._words[:] = actions
            actions = self._words
        # For few slots, to write the same again would be a good part of a step.
        if addresses is not self._addresses:
            arguments[self._address_of_results] = self._addresses = addresses
        if self.seed is not self._seed:
            arguments[_SEEDS] = self._seed = self.seed
        if actions.ndim > 1:  # to the kernel, fields of one agent are like more agents of a slot
            actions = actions.reshape(-1)
        if not self._run(threads.now, self._kernels.step, (arguments, actions, self.reward_table)):
            raise self.action_rules.refusal(actions)
        if threads.tuning:
            threads.learn(time.perf_counter() - began)
        return results

    def _rollout(
        self, policy: DevicePolicy, steps: int, record: bool, episodes: int | None
    ) -> tuple[Rollout, Observed]:
        config, spec = self.config, self.config.spec
        seen = policy.form(spec)
        by_single_steps = record and recorded_form(spec) is not seen
        compiled = None if by_single_steps else compiled_policy(policy, element_dtype(seen))
        if compiled is None:
            return super()._rollout(policy, steps, record, episodes)
        kept = Record.of(config, steps if record else 0, policy.logits)
        sums, observed = self._compiled_rollout(policy, compiled, steps, kept, episodes)
        return sums.result(steps, kept.arrays(config) if record else {}), observed

    @property
    def runs_networks(self) -> bool:
        """See :class:`Device`; a class that does more in a step does it in single ones only."""
        return type(self)._step is Native._step

    def _experience(self, network: DenseNetwork, noise: Array) -> tuple[Record, Observed]:
        compiled = compiled_policy(network, element_dtype(network.form(self.config.spec)))
        assert compiled is not None
        record = Record.of(self.config, len(noise), noise.shape[2], noise)
        _, observed = self._compiled_rollout(network, compiled, len(noise), record, None)
        return record, observed

    def _compiled_rollout(
        self,
        policy: DevicePolicy,
        compiled: CompiledPolicy,
        steps: int,
        record: Record,
        episodes: int | None,
    ) -> tuple[Sums, Observed]:
        """Do the steps of a rollout in the compiled loop; return its sums, and what is observed last."""
        config, spec = self.config, self.config.spec
        kernels = compile_kernels(policy.form(spec), self._elapsed.dtype)
        actions = np.zeros(0, spec.action_dtype)
        step = address_of(kernels.step, self._arguments, actions, self.reward_table, 0, 0)
        elapsed = self._elapsed.repeat(spec.agents)
        sums = Sums.of(elapsed, self.in_episode, self.resetting(), episodes)
        in_bytes = record.in_bytes()
        for done, some in in_parts(steps):
            rows = in_bytes.between(done, done + some)
            self._run_part(compiled, self.shown_to(policy), step, sums, rows, some)
        return sums, self._reset(np.zeros(config.n_envs, np.bool_), None)

    @uninterrupted
    def _run_part(
        self, policy: CompiledPolicy, seen: Observed, step: int, sums: Sums, record: Record, steps: int
    ) -> None:
        batch = StepArrays.of(self.config, seen)
        self._arguments[_SEEDS] = self._seed = self.seed
        arguments = self._arguments.copy()
        arguments[STEP_ARGUMENTS.index("checked")] = 0
        batch.put_into(arguments)
        agents = self.config.spec.agents
        whole = *policy.arguments, step, arguments, self.reward_table, batch, sums, record, agents, steps
        began = time.perf_counter()
        self._run(self._of_rollouts.now, compiled_rollout(), whole)
        if self._of_rollouts.tuning:
            self._of_rollouts.learn(time.perf_counter() - began, steps)
        self.tick = (self.tick + steps) & rng.LAST_TICK

    def _read(self) -> tuple[Array, Array]:
        self._slots.elapsed[:] = self._elapsed
        return self._memory, self._stored if self._stored is not self._memory else self._memory[:0]

    def _write(self, memory: Array, stored: Array) -> Observed:
        self._memory[:] = memory
        self._count(self.config, self._slots.elapsed)
        if stored.size:
            self._stored[:] = stored
        return self._reset(np.zeros(self.config.n_envs, np.bool_), None)

    def _apply_limit(self, config: BatchConfig) -> None:
        super()._apply_limit(config)
        self._count(config, self._elapsed)

    def _close(self) -> None:
        self._pool.close()
