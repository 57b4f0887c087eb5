"""What a host does to a backbone that may have a fault: it tries every mode, limit, error and reset.

The environment is made for this: a wrong bit anywhere shows in a result.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Discrete
from gymnasium.vector import AutoresetMode
from port_script import ALL, HOLE, REFUSED, Script, kept, settings
from random_policies import random_network, random_planes

from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.golden import Draws, Word
from pearl_marl.hardware import elaboration
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.engines import with_engine
from pearl_marl.hardware.policy_words import policy_words
from pearl_marl.layout import Bits, Flag
from pearl_marl.memory_map import (
    MAGIC,
    PROTOCOL_VERSION,
    SECTION_BITS,
    Control,
    Mode,
    Statistics,
    Status,
    StatusError,
    memory_map,
)
from pearl_marl.policies.golden_policy import GoldenPolicy
from pearl_marl.policies.integer_network import IntegerNetwork
from pearl_marl.spec import EnvSpec, Field, Golden, word_bits


def folded(draw: Word) -> Word:
    """Return sixteen bits that change with any bit of a draw, and with any that goes into its last mixing."""
    return ((draw & 0xFFFF) + ((draw >> 16) << 1)) & 0xFFFF


class State(NamedTuple):
    word: Bits[16]


class View(NamedTuple):
    word: Bits[16]
    odd: Flag


def initial(draws: Draws) -> State:
    return State(folded(draws.bits()))


def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
    word = (state.word + action + folded(draws.bits())) & 0xFFFF
    return State(word), word & 31, (word & 7) == 0


def observe(state: State) -> View:
    return View(state.word ^ 0x5A5A, state.word & 1)


SPEC = EnvSpec(
    name="Mixing",
    version=0,
    summary="Hides nothing: a wrong bit anywhere, of a draw too, is a wrong result",
    reward=Field("reward", 5),
    rewards=None,
    observation_space=Box(0, 65535, (2,), np.uint16),
    action_space=Discrete(8),
    golden=Golden(State, initial, step, observe, view=View),
)

# No row divides into words here, rewards and observations are more than one, and the last group is not full.
BUILD = Build.of(SPEC, 37, 5, 32)


def act(view: View, draws: Draws) -> Word:
    """A policy of the same kind."""
    first, second = folded(draws.bits()), folded(draws.bits())
    return (first + second + view.word + (view.word >> 5) + view.odd) & 7


def show(view: View, picture: Any) -> None:
    for k in range(16):
        picture[k] = view.word >> k & 1


PICTURES = replace(SPEC, observation_space=Box(0, 1, (4, 4, 1), np.uint8), unpack=show)
"""The same environment, of which agents see a picture."""


def undecided(network: IntegerNetwork) -> IntegerNetwork:
    """Return the network with logits so near each other that inputs and draws decide, not biases."""
    *layers, last = network.layers
    layers.append(last._replace(bias=last.bias >> 4))
    return replace(network, layers=tuple(layers), head=network.head._replace(shift=10))


POLICIES = {
    "golden": GoldenPolicy(SPEC, act),
    "network": undecided(random_network(np.random.default_rng(3), SPEC, [6], drawn=True)),
    "planes": undecided(random_planes(np.random.default_rng(3), PICTURES, 10, [6, 5], drawn=True)),
}
"""Of these, rollouts are made: see :func:`rollout_script`."""


def with_policy(name: str) -> Build:
    """Return the build with an engine for one of them."""
    policy, layout = POLICIES[name], BUILD.layout
    sizes = layout.n_envs, layout.pe_num, layout.data_wl
    build = with_engine(Build.of(policy.spec, *sizes), policy)
    engine = build.layout.engine
    if engine is None or not engine.is_network:
        return build
    # Layers take several words, and the last batch has less groups than the others.
    engine = engine._replace(products=4, side=3, rounds=min(engine.rounds, 2))
    return Build(policy.spec, memory_map(policy.spec, *sizes, engine))


MEMORIES = ("initial_states", "current_states", "elapsed", "reset_mask", "actions")
RESULTS = ("observations", "rewards", "ters")


def host_script(build: Build) -> str:
    """Return all that the host does, one part after the other."""
    script = Script(build)
    identity(script)
    written = memory(script)
    address_map(script, written)
    steps(script)
    limits(script)
    busy(script)
    keys(script)
    parts_of_the_reset(script)
    resets(script)
    return "\n".join(script.lines) + "\n"


def rollout_script(name: str) -> str:
    """Return rollouts of one of the policies, whose sums are to be those of the CPU."""
    build, policy = with_policy(name), POLICIES[name]
    script, engine = Script(build), build.layout.engine
    assert engine is not None
    region = build.layout["policy"]
    script.part("policy")
    script.wait(40)
    for i, word in enumerate(engine.words):
        script.read(script.first("statistics") + Statistics.ENGINE + i, word)
    for section, words in policy_words(policy, engine).items():
        first = script.first("policy") + section * (region.words >> SECTION_BITS)
        for i, word in enumerate(words):
            script.write(first + i, int(word))
    for mode in (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP):
        for limit in (1, 3, 11):
            script.part(f"{mode.name.lower()}_{limit}")
            rollouts(script, name, mode, limit)
    script.part("long")
    long_episodes(script, name)
    script.part("reset")
    for delay in (5, 30, 90, 200):
        ring_rollout(script, Mode.RESET_ALL, ALL)
        script.wait(delay)
        script.reset(soft=True)
    rollouts(script, name, AutoresetMode.SAME_STEP, 3)
    return "\n".join(script.lines) + "\n"


def rollouts(script: Script, name: str, mode: AutoresetMode, limit: int) -> None:
    """Make rollouts of several lengths, one after the other, and compare what they add up and leave."""
    native, n = Native(), script.layout.n_envs
    first = int(script.random.integers(0, (1 << 32) - n))
    native.open(
        BatchConfig(spec=script.spec, n_envs=n, max_cycles=limit, first_slot=first, autoreset_mode=mode)
    )
    native.reset(seed=int(script.random.integers(1 << 32)))
    native.restore(replace(native.snapshot(), tick=ALL - 2))  # the lower half is about to carry
    native.reset()
    for k, steps in enumerate((1, 7, 20)):
        compare_rollout(script, native, name, Mode(0) if k else Mode.RESET_ALL, steps)


def long_episodes(script: Script, name: str) -> None:
    """Make a rollout from elapsed steps of every size: only episodes that begin in it count."""
    native, n, model = Native(), script.layout.n_envs, script.model
    native.open(BatchConfig(spec=script.spec, n_envs=n, max_cycles=ALL))
    native.reset(seed=5)
    saved = native.snapshot()
    slots = SlotMemory(script.spec, n, saved.memory)
    slots.elapsed[:] = [1 << k % 32 for k in range(n)]
    native.restore(saved)
    model.states, model.elapsed, model.ters = slots.state, slots.elapsed, np.zeros(n, np.uint8)
    load_states(script)
    compare_rollout(script, native, name, Mode(0), 30)


def compare_rollout(script: Script, native: Native, name: str, mode: Mode, steps: int) -> None:
    """Make a rollout, and compare what it adds up and leaves with the CPU's."""
    model, at, config = script.model, script.first("statistics"), native.config
    model.seed, model.tick = native.seed, native.tick
    model.first_slot, model.max_cycles = config.first_slot, config.limit
    script.load()
    if config.autoreset_mode is AutoresetMode.NEXT_STEP:
        mode |= Mode.NEXT_STEP
    ring_rollout(script, mode, steps)
    script.finish(within=1024 * steps)
    script.status(Status.SEQUENCE, script.sequence)
    found = native.rollout(POLICIES[name], steps)
    sums = {
        Statistics.STEPS: steps,
        Statistics.EPISODES: found.episodes,
        Statistics.TRUNCATED: int(found.truncated.sum()),
        Statistics.LENGTHS: int(found.lengths.sum()),
        Statistics.RETURNS: int(found.returns.sum()),
    }
    for word, value in sums.items():
        script.read(at + word, value & ALL)
        script.read(at + word + 1, value >> 32)
    model.tick = native.tick
    for word, value in settings(model).items():
        script.read(script.first("control") + word, value)
    for word in (at + Statistics.CYCLES, script.first("status") + Status.CYCLES):
        script.read_the_same(word)
    for region in ("current_states", "elapsed"):
        for i in range(script.layout[region].words):
            script.read_the_same(script.first(region) + i)


def ring_rollout(script: Script, mode: Mode, steps: int) -> None:
    """Ring for a rollout; the mask of resets and the bits that mean nothing do nothing in one."""
    script.control(Control.STEPS, steps)
    script.write_bytes("reset_mask", bytes([0xFF] * script.layout.size("reset_mask")))
    mode |= Mode.ROLLOUT | Mode.RESET_MASK
    script.write(script.first("doorbell"), mode | int(script.random.integers(0, 1 << 27)) << 5)
    script.sequence ^= 1 << int(script.random.integers(32))
    script.write(script.first("doorbell") + 1, script.sequence)


def identity(script: Script) -> None:
    """Read the registers as a reset leaves them."""
    script.part("identity")
    script.wait(40)
    read_control(script, [0] * 8)
    read_fresh_status(script)
    for i in range(2):
        script.read(script.first("doorbell") + i, 0)


def read_control(script: Script, settings: list[int]) -> None:
    """Read the control region: the words that name the design, and then the settings."""
    spec, layout = script.spec, script.layout
    fixed = [
        MAGIC,
        PROTOCOL_VERSION,
        elaboration.env_hash(spec),
        *(layout.n_envs, layout.pe_num, layout.data_wl),
        word_bits(spec.state),
        word_bits(spec.observation) + spec.reward.bits + 2,
    ]
    for i, value in enumerate([*fixed, *settings]):
        script.read(i, value)


def read_fresh_status(script: Script) -> None:
    """Read the interrupt and the status, as a reset leaves them."""
    script.interrupt(False)
    for word, value in ((Status.SEQUENCE, 0), (Status.CYCLES, 0), (Status.ERROR, StatusError.RESET)):
        script.status(word, value)


def memory(script: Script) -> list[tuple[int, int]]:
    """Write and read every word that can be written; return the memories' words and what they hold."""
    script.part("memory")
    layout = script.layout
    written = []
    for name in MEMORIES:
        region = layout[name]
        # The last group's elements that have no slot have memory all the same.
        everything = region.rows * region.row_slots
        for i in range(region.words):
            value = int(script.random.integers(0, 1 << 32))
            written.append((script.first(name) + i, value & kept(region, i, everything)))
            script.write(written[-1][0], value)
    for word, value in written:
        script.read(word, value)
    for word, value in reversed(written):  # one at a time
        script.read(word, value)
        script.wait(3)
    for word, value in reversed(written):  # a write into another region would now be the last
        script.write(word, value)
    for word, value in written:
        script.read(word, value)
    # A control word is written back as a whole after a part of it has changed.
    script.fetch(Control.SEED_0)
    values = {word: int(script.random.integers(0, 1 << 32)) for word in Control if 8 <= word < 14}
    for word, value in values.items():
        script.control(word, value)
    read_control(script, [*values.values(), 0, 0])
    script.status(Status.ERROR, 0)
    return written


def address_map(script: Script, written: list[tuple[int, int]]) -> None:
    """Write to read-only regions and to holes of the map, and see that ``written`` is as it was."""
    script.part("map")
    layout = script.layout
    end = layout.end("status") // 4
    for name in (*RESULTS, "status"):
        script.write(script.first(name), ALL, REFUSED)
        script.write(layout.end(name) // 4 - 1, ALL, REFUSED)
    holes = [end, 1 << end.bit_length() - 1, (1 << end.bit_length()) - 1]
    for hole in (word for word in holes if word >= end):
        script.read(hole, answer=HOLE)
        script.write(hole, ALL, HOLE)
    script.status(Status.SEQUENCE, 0)
    for word, value in written:
        script.read(word, value)


def steps(script: Script) -> None:
    """Take steps in every mode, with and without a limit of cycles."""
    for base in (Mode(0), Mode.NEXT_STEP, Mode.STORED, Mode.STORED | Mode.NEXT_STEP):
        script.part(f"steps_{int(base)}")
        for max_cycles in (0, 1, 3):
            steps_of(script, base, max_cycles)


def steps_of(script: Script, base: Mode, max_cycles: int) -> None:
    """Take steps in one mode with one limit of cycles."""
    model, random, spec = script.model, script.random, script.spec
    n = script.layout.n_envs
    model.seed = tuple(int(w) for w in random.integers(0, 1 << 32, 2))
    # The lower half is about to carry.
    model.tick = (int(random.integers(0, 1 << 30)) << 32) + ALL - int(random.integers(0, 4))
    model.first_slot = int(random.integers(0, 1 << 32))
    model.max_cycles = max_cycles
    model.initial_states = [random.integers(*f.range, n, f.dtype, endpoint=True) for f in spec.state]
    initial = model.bytes_of("initial_states", spec.state, model.initial_states)
    script.write_bytes("initial_states", initial)
    script.load()
    for step in range(4):
        mode = base | (Mode.RESET_ALL if step == 0 else Mode(0))
        mode |= Mode.RESET_MASK if step % 2 else Mode(0)
        script.wait(int(random.choice([0, 40])))
        expected = script.ring(mode, *script.some())
        script.finish()
        script.status(Status.SEQUENCE, script.sequence)
        script.read_the_same(script.first("status") + Status.CYCLES)
        # Other results than the first word leave the warning.
        script.read(script.first("observations") + 1, mask=0)
        script.read(script.first("ters"), mask=0)
        script.fetch(script.first("observations"), answer=REFUSED)
        script.write(script.first("observations"), ALL, REFUSED)
        script.status(Status.ERROR, StatusError.TORN_READ)
        script.results(expected)
        script.status(Status.ERROR, 0)
        script.registers()
        # The same doorbell again rings nothing.
        script.write(script.first("doorbell") + 1, script.sequence)
        script.wait(8)
        script.interrupt(True)
    compare_states(script)
    script.read_bytes("initial_states", initial)


def limits(script: Script) -> None:
    """Take steps with limits of every size, from elapsed steps just below the limit."""
    script.part("limits")
    model, n, state = script.model, script.layout.n_envs, script.spec.state
    for limit in (0, ALL, 5, *(1 << bit for bit in range(32)), 0x55555555, 0x2AAAAAAA):
        model.max_cycles = limit
        below = script.random.choice([1, 1, 2, 2, 3, limit // 2 + 1], n)
        model.elapsed = np.minimum(np.maximum(limit - below, 0), ALL - 1).astype(np.uint32)
        model.states = [script.random.integers(*f.range, n, f.dtype, endpoint=True) for f in state]
        model.ters = script.random.choice([0, 0, 0, 1, 2, 3], n).astype(np.uint8)
        load_states(script)
        script.load()
        expected = script.ring(Mode(0), *script.some())
        script.finish()
        script.results(expected)
        compare_states(script)


def busy(script: Script) -> None:
    """Access the memories, the doorbell and the results while a step is under way."""
    script.part("busy")
    layout = script.layout
    for error in (0, StatusError.BUSY_WRITE, StatusError.BUSY_DOORBELL, StatusError.TORN_READ):
        for name in MEMORIES if error in (0, StatusError.BUSY_WRITE) else RESULTS:
            old = script.sequence
            expected = script.ring(Mode(0), *script.some())
            script.wait(7)
            script.interrupt(False)
            script.status(Status.SEQUENCE, old)
            script.read(script.first("doorbell") + 1, script.sequence)
            script.read(Control.N_ENVS, layout.n_envs)
            match error:
                case 0:
                    script.read(script.first(name), answer=REFUSED)
                    # Nothing that a step could have lost.
                    script.write(script.first("rewards"), ALL, REFUSED)
                    script.fetch(script.first("ters"), answer=REFUSED)
                    script.write(layout.end("status") // 4, ALL, HOLE)
                case StatusError.BUSY_WRITE if name == "elapsed":
                    script.fetch(Control.SEED_1, answer=REFUSED)
                case StatusError.BUSY_WRITE:
                    script.write(script.first(name), ALL, REFUSED)
                case StatusError.BUSY_DOORBELL:
                    script.write(script.first("doorbell") + 1, ALL, REFUSED)
                case StatusError.TORN_READ:
                    script.read(script.first(name), mask=0)
            script.finish()
            script.status(Status.SEQUENCE, script.sequence)
            script.read_the_same(script.first("status") + Status.CYCLES)
            script.status(Status.ERROR, int(error | StatusError.TORN_READ))
            script.results(expected)
            script.registers()
            script.status(Status.ERROR, int(error & ~StatusError.TORN_READ))
    # The same sequence again, and the mode alone, ring nothing.
    script.write(script.first("doorbell"), Mode.RESET_ALL)
    script.write(script.first("doorbell") + 1, script.sequence)
    script.write_the_same(script.first("reset_mask"), 0)
    script.write_the_same(script.first("reset_mask"), 0)
    script.wait(60)
    script.interrupt(True)
    script.mode = Mode.RESET_ALL
    script.registers()
    script.results(expected)
    compare_states(script)


def keys(script: Script) -> None:
    """Change what the random keys are made of while they are being made."""
    script.part("keys")
    model = script.model
    for delay in range(0, 44, 3):
        model.seed = tuple(int(w) for w in script.random.integers(0, 1 << 32, 2))
        model.tick = int(script.random.integers(0, 1 << 62))
        script.load()
        script.wait(delay)
        model.tick = int(script.random.integers(0, 1 << 62)) | ALL
        script.load()
        for _ in range(3):
            # At once, before the keys of the next tick are there; and the step has begun all the same.
            expected = script.ring(Mode.RESET_ALL, *script.some())
            script.write(script.first("actions"), ALL, REFUSED)
            script.write(script.first("doorbell") + 1, ALL, REFUSED)
            script.wait(8)
            script.write(script.first("actions"), ALL, REFUSED)
            script.read(script.first("current_states"), answer=REFUSED)
            script.finish()
            script.read_the_same(script.first("status") + Status.CYCLES)
        script.results(expected)


def parts_of_the_reset(script: Script) -> None:
    """Fetch the word that resets in a step, and write it then or after it."""
    script.part("reset_in_parts")
    for delay in range(0, 60, 4):
        for gap in (0, 30):
            expected = script.ring(Mode.RESET_ALL, *script.some())
            script.wait(delay)
            script.fetch(Control.RESET)
            script.wait(gap)
            script.write_the_same(Control.RESET, 0)
            script.wait(60)
            script.interrupt(True)
            script.read_the_same(script.first("status") + Status.ERROR)
            script.results(expected)
            script.registers()


def resets(script: Script) -> None:
    """Reset at different times in a step and after it, and then take a whole step."""
    model = script.model
    for soft in (False, True):
        script.part("soft_reset" if soft else "reset")
        for delay in (0, 1, 2, 5, 9, 14, 20, 50):
            script.ring(Mode.RESET_ALL, *script.some())
            script.wait(delay)
            script.reset(soft)
            read_fresh_status(script)
            read_control(script, [0] * 8)
            model.tick, model.seed, model.first_slot, model.max_cycles = delay, (7, 8), 3, 0
            script.load()
            expected = script.ring(Mode.RESET_ALL, *script.some())
            script.finish()
            script.results(expected)
            compare_states(script)


def load_states(script: Script) -> None:
    states, elapsed = script.states()
    script.write_bytes("current_states", states)
    script.write_bytes("elapsed", elapsed)


def compare_states(script: Script) -> None:
    states, elapsed = script.states()
    for name, data in (("current_states", states), ("elapsed", elapsed)):
        region = script.layout[name]
        for i, value in enumerate(np.frombuffer(data, "<u4")):
            script.read(script.first(name) + i, int(value), mask=kept(region, i, script.layout.n_envs))
