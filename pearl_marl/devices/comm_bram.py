"""Whatever stands behind a Comm-BRAM becomes a device: the protocol, and the host's mirror of the batch.

::

    actions -> codec -> [reset mask | actions | doorbell] --one write-->  hardware
    results <- codec <- [observations | rewards | ters | status] <--one read--

The hardware is lazy where :class:`~pearl_marl.devices.native.Native` is eager: it begins a slot's
next episode within the next step, because only then it knows the action. So what a device shows of
that beginning, first observations and the states of a snapshot, is computed here, by the same
kernel as the native device's, from the seed and the tick.
"""

from __future__ import annotations

import itertools
from abc import abstractmethod

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from pearl_marl.base.arrays import Array
from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.results import ResultArrays
from pearl_marl.batch.rollout import Rollout
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.batch.step import BatchStep, Observed
from pearl_marl.compiler.kernels import compile_kernels
from pearl_marl.devices.base import Device
from pearl_marl.devices.identity import stated_map
from pearl_marl.devices.link_rollout import LinkRollout
from pearl_marl.devices.transport import STAGES, Protocol, Settings, Transport
from pearl_marl.errors import DeviceError
from pearl_marl.golden import rng
from pearl_marl.memory_map import ELAPSED_BITS, Doorbell, MemoryMap, Mode
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.spec import Field

_ELAPSED = Field("elapsed", ELAPSED_BITS)


class CommBram(Device):
    """A device behind a Comm-BRAM; a subclass connects to it.

    After a failed step the device's state is unknown, so it refuses to go on until it is reset, given a
    saved state, or recovered. ``cycles`` are those from doorbell to last result.
    """

    patience = 10.0
    """Seconds to wait at a reset for a step that was left under way, before the hardware is reset; and in a
    rollout for its next step."""

    @abstractmethod
    def _connect(self, config: BatchConfig) -> tuple[Transport, MemoryMap | None]:
        """Return the transport to the hardware, and the memory map that it has to have.

        ``None`` stands for the map of the sizes and the engine that the hardware states.
        """

    def _open(self, config: BatchConfig) -> None:
        transport, layout = self._connect(config)
        try:
            layout = layout or stated_map(transport.read, config.spec, config.n_envs)
            transport.recoverable = True
            self._protocol = Protocol(self.name, config.spec, transport, layout)
            self._protocol.synchronise(self.patience)
        except BaseException:
            transport.close()
            raise
        self._mirror = Mirror(config, self._protocol.end_field)

    @property
    def has_engine(self) -> bool:  # type: ignore[override]
        """Whether the hardware has a policy engine."""
        return self._protocol.layout.engine is not None

    @property
    def cycles(self) -> int:
        """Clock cycles that the last step took, from doorbell to last result."""
        return self._protocol.cycles

    def timed(self) -> dict[str, float]:
        """Time every stage of every step from now on: see :meth:`Device.timed`.

        ``"compute"`` lies between the end of the write and the beginning of the read that had the results.
        """
        seconds = super().timed()
        self._protocol.transport.timed = True
        return seconds

    def _stages(self, began: float, ended: float) -> dict[str, float]:
        edges = itertools.pairwise((began, *self._protocol.transport.times, ended))
        return {stage: end - begin for stage, (begin, end) in zip(STAGES, edges, strict=True)}

    def _reset(self, mask: Array | None, seed: int | None) -> Observed:
        mirror = self._mirror
        if mask is not None:
            before = mirror.due
            mirror.due = before | mask
            try:
                return self._slots()[1]
            except BaseException:
                mirror.due = before
                raise
        try:
            self._protocol.synchronise(self.patience)
            mirror.all_due = True
            mirror.due = np.zeros_like(mirror.due)
            if mirror.repeats:
                every = np.ones_like(mirror.due)
                mirror.start(mirror.starts, every, self.seed, self.tick, use_stored=False)
                self._protocol.write_region("initial_states", self.config.spec.state, mirror.starts.state)
            return self._slots()[1]
        except BaseException:
            self.fail()
            raise

    def _step(self, actions: Array) -> BatchStep:
        protocol, mirror = self._protocol, self._mirror
        protocol.set(self._settings(self.tick))
        mode = mirror.begin_due()
        wrong = protocol.step(mode, actions, mirror.due)
        if wrong:
            raise DeviceError(f"the {self.name} device{wrong}; {self.remedy}")
        tick = (self.tick + 1) & rng.LAST_TICK
        words = (*protocol.observations, protocol.rewards, protocol.end_bits)
        results = mirror.results_of(words, self.seed, tick, self.reward_table)
        mirror.begun(mode)
        protocol.confirm(self._settings(tick))
        return results

    def _may_have_moved(self) -> bool:
        return self._protocol.unconfirmed

    def check_engine(self, policy: DevicePolicy, steps: int) -> None:
        """See :meth:`Device.check_engine`."""
        if self.has_engine:
            self._of_engine(policy, steps)

    def _of_engine(self, policy: DevicePolicy, steps: int) -> LinkRollout:
        config, layout = self.config, self._protocol.layout
        return LinkRollout.of(policy, layout, config.spec, self.rewards, steps, config.limit)

    def _rollout_alone(
        self, policy: DevicePolicy, steps: int, record: bool, episodes: int | None
    ) -> Rollout | None:
        protocol, mirror, config = self._protocol, self._mirror, self.config
        if not self.has_engine or record or episodes is not None:
            return None
        run = self._of_engine(policy, steps)
        if mirror.due.any():  # the mask is of one step only
            self._write(*self._read())
        try:
            if policy is not protocol.policy:
                protocol.policy = None  # should the write fail half way
                run.load(protocol.transport)
                protocol.policy = policy
            if not (config.limit or mirror.all_due):
                # Without a limit the hardware counts steps of episodes, too; Rollout says what counts then.
                protocol.write_region("elapsed", (_ELAPSED,), [np.zeros(config.n_envs, np.uint32)])
            protocol.set(self._settings(self.tick))
            mode = mirror.begin_due()
            protocol.doorbell[Doorbell.SEQUENCE] = sequence = (protocol.sequence + 1) & 0xFFFFFFFF
            result, cycles = run.run(protocol.transport, mode, sequence, self.patience)
            self.tick = (self.tick + steps) & rng.LAST_TICK
            protocol.confirm(self._settings(self.tick), cycles)
            mirror.begun(mode)
            if config.spec.agents > 1 or config.spec.mask_fields or mirror.next_step:
                memory, (_, self.action_masks, self.in_episode) = self._slots()
                mirror.continue_from(SlotMemory(config.spec, config.n_envs, memory))
        except BaseException:
            self.fail()
            raise
        return result

    def _slots(self) -> tuple[Array, Observed]:
        """Return the slots' memory as the native device would have it now, and what agents see."""
        config, mirror = self.config, self._mirror
        memory = SlotMemory(config.spec, config.n_envs)
        starting = np.ones(config.n_envs, np.bool_)
        if not mirror.all_due:
            end_bits = np.empty_like(self._protocol.end_bits)
            fields = (*config.spec.state, self._protocol.end_field)
            self._protocol.read_region("current_states", fields, [*memory.state, end_bits])
            self._protocol.read_region("elapsed", (_ELAPSED,), [memory.elapsed])
            if not config.limit:
                memory.elapsed[:] = 0
            starting = mirror.starting(end_bits)
            memory.ended[:] = mirror.ended_after(end_bits)
        return memory.bytes, mirror.start(memory, starting, self.seed, self.tick, use_stored=mirror.repeats)

    def _read(self) -> tuple[Array, Array]:
        starts = self._mirror.starts.bytes
        return self._slots()[0], starts if self._mirror.repeats else starts[:0]

    def _write(self, memory: Array, stored: Array) -> Observed:
        protocol, mirror = self._protocol, self._mirror
        spec, slots = self.config.spec, SlotMemory(self.config.spec, self.config.n_envs, memory)
        try:
            protocol.synchronise(self.patience)
            if stored.size:
                mirror.starts.bytes[:] = stored
                protocol.write_region("initial_states", spec.state, mirror.starts.state)
            end_bits = mirror.end_bits_of(slots.ended)
            protocol.write_region(
                "current_states", (*spec.state, protocol.end_field), [*slots.state, end_bits]
            )
            protocol.write_region("elapsed", (_ELAPSED,), [slots.elapsed])
            mirror.continue_from(slots)
            return self._slots()[1]
        except BaseException:
            self.fail()
            raise

    def _settings(self, tick: int) -> Settings:
        return Settings(*self.seed, tick, self.config.first_slot, self.config.limit)

    def _close(self) -> None:
        self._protocol.transport.close()


class Mirror:
    """What the host keeps of a batch that is in hardware, to show what the hardware does only later.

    Attributes
    ----------
    starts
        Where each slot starts, if those starts are stored (``repeats``); the kernels get it in any case.
    next_step
        Whether slots that end spend the next step on their reset.
    all_due, due
        Which slots the next step has to start afresh: all, or those masked, ``bool`` of shape ``(n_envs,)``.
    """

    def __init__(self, config: BatchConfig, end_field: Field) -> None:
        spec, n = config.spec, config.n_envs
        self._config = config
        self._kernels = compile_kernels(spec)
        self._results = ResultArrays(config)
        self.next_step = config.autoreset_mode is AutoresetMode.NEXT_STEP
        self.repeats = config.initial_states == "stored"
        self.starts = SlotMemory(spec, n)
        self.all_due = False
        self.due = np.zeros(n, np.bool_)
        self._mode = Mode(0)
        if self.next_step:
            self._mode |= Mode.NEXT_STEP
        if self.repeats:
            self._mode |= Mode.STORED
        # After the last step, as the column of that name in the slots' memory.
        self._ended: Array = np.zeros(n, end_field.dtype)
        # The tick as kernels take it: with a sign.
        self._tick = np.zeros(1, np.uint64)
        self._signed_tick = self._tick.view(np.int64)

    def begin_due(self) -> Mode:
        """Take note that the next step starts the slots that are due; return its mode."""
        if self.all_due:
            self._ended[:] = 0
            return self._mode | Mode.RESET_ALL
        if self.due.any():
            self._ended[self.due] = 0
            return self._mode | Mode.RESET_MASK
        return self._mode

    def begun(self, mode: Mode) -> None:
        """Take note that a step of this mode has succeeded."""
        if mode & (Mode.RESET_ALL | Mode.RESET_MASK):
            self.all_due = False
            self.due = np.zeros_like(self.due)

    def results_of(
        self, words: tuple[Array, ...], seed: tuple[int, int], tick: int, reward_table: Array
    ) -> BatchStep:
        """Return the results of a step whose words these are: observations, rewards, and bits of ends.

        ``tick`` is the next step's: the episode that begins in the hardware's next step begins here in this.
        """
        config, n = self._config, self._config.n_envs
        results, block = self._results.take_block()
        # What agents that ended before do not get is the host's affair.
        absent: tuple[Array, ...] = ()
        if config.spec.agents > 1:
            absent = (np.where(self._ended & 1, 0, self._ended).astype(self._ended.dtype),)
        self._tick[0] = tick
        self._kernels.results(
            words[:-2], words[-2], (words[-1], *absent), self.starts.bytes, reward_table,
            tuple(block.arrays), *seed, self._signed_tick[0],
            config.first_slot, self.next_step, self.repeats, n, 0, n,
        )  # fmt: skip
        if self.next_step:
            results.rewards.reshape(n, -1)[self._ended & 1 != 0] = 0
        if self.next_step or config.spec.agents > 1:
            self._ended = self.ended_after(words[-1])
        return results

    def start(
        self, memory: SlotMemory, mask: Array, seed: tuple[int, int], tick: int, *, use_stored: bool
    ) -> Observed:
        """Begin an episode in the masked slots of ``memory``; return what the agents of all slots see."""
        config, results, n = self._config, self._results.take(), self._config.n_envs
        memory.elapsed[mask] = 0
        self._kernels.reset(
            memory.bytes, self.starts.bytes, mask.view(np.uint8), (results.obs, *results.arrays[5:]), *seed,
            rng.signed(tick), config.first_slot, use_stored, n, 0, n,
        )  # fmt: skip
        return results.observed

    def continue_from(self, slots: SlotMemory) -> None:
        """Take up slots that the hardware has been given."""
        self.all_due = False
        self.due = np.zeros_like(self.due)
        self._ended = slots.ended.copy()

    def starting(self, end_bits: Array) -> npt.NDArray[np.bool_]:
        """Return which slots the next step starts afresh, by the hardware's bits after the last one."""
        return self.due if self.next_step else self.due | self._over(end_bits)

    def _over(self, end_bits: Array) -> npt.NDArray[np.bool_]:
        """Return which slots have ended: by the time limit, or as all agents have."""
        # An only agent's two bits are more than 0 in either case.
        over: npt.NDArray[np.bool_] = end_bits >= (1 << self._config.spec.agents) - 1
        return over

    def ended_after(self, end_bits: Array) -> Array:
        """Return the column ``ended`` of slots with such bits."""
        over = self._over(end_bits)
        if self._config.spec.agents == 1:
            return (over & self.next_step).view(np.uint8)
        ended: Array = end_bits << 1
        ended[over] = self.next_step
        return ended

    def end_bits_of(self, ended: Array) -> Array:
        """Return such bits of slots with this column: the inverse."""
        end_bits = ended >> 1
        end_bits[ended & 1 != 0] = (1 << self._config.spec.agents) - 1
        return end_bits
