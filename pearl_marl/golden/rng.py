"""Counter-based random numbers: a draw is a hash of ``(seed, slot, tick, index)``.

No slot stores any generator state. A draw depends on four things alone:

- the *seed*, two 32-bit words for the whole run;
- the global *slot* number, so splitting the slots over devices changes nothing;
- the *tick*, a 64-bit count of the steps (and full resets) since seeding;
- the *index* of the draw within its slot and tick.

It is made in two stages, so that the costly part is done once a step instead of once a slot::

    seed, tick, index --chain(A)--> key_a --+
                      --chain(B)--> key_b --+--> draw(slot, key_a, key_b)     (one per slot)

``chain`` absorbs one word a round through :func:`mix32`; ``draw`` is one more pass through the
same two multiplications, with ``key_b`` entering between them. Two keys rather than one keep two
ticks from ever showing the same draws with the slots permuted.

``mix32`` is the function that Chris Wellons published as ``lowbias32`` (Hash Prospector, 2018;
public domain), which has the lowest known avalanche bias of its shape.
"""

from __future__ import annotations

import operator

import numpy as np
import numpy.typing as npt

from pearl_marl.errors import ArgumentError
from pearl_marl.golden import Word, u32, u64

MULTIPLIER_1 = 0x7FEB352D
MULTIPLIER_2 = 0x846CA68B
# The first 64 fractional bits of pi: any two unrelated words would do.
CHAIN_A = 0x243F6A88
CHAIN_B = 0x85A308D3

LAST_TICK = 0xFFFFFFFFFFFFFFFF
"""After it comes 0, as in hardware."""


def mix32(x: Word) -> Word:
    """Mix a 32-bit word so that every input bit flips every output bit about half of the time.

    A bijection: different words stay different.
    """
    x = u32(x ^ u32(x >> u32(16)))
    x = u32(x * u32(MULTIPLIER_1))
    x = u32(x ^ u32(x >> u32(15)))
    x = u32(x * u32(MULTIPLIER_2))
    return u32(x ^ u32(x >> u32(16)))


def key(iv: Word, seed_0: Word, seed_1: Word, tick: Word, index: Word) -> Word:
    """Return one of the two keys of draw ``index`` at ``tick``; ``iv`` chooses which.

    Parameters
    ----------
    iv
        :data:`CHAIN_A` or :data:`CHAIN_B`, a ``u32``.
    seed_0, seed_1
        The words of :func:`seed_words`, ``u32``.
    tick
        A ``u64``.
    index
        A ``u32``.
    """
    h = mix32(u32(iv ^ seed_0))
    h = mix32(u32(h ^ seed_1))
    h = mix32(u32(h ^ u32(u64(tick) >> u64(32))))
    h = mix32(u32(h ^ u32(u64(tick) & u64(0xFFFFFFFF))))
    return mix32(u32(h ^ index))


def draw(slot: Word, key_a: Word, key_b: Word) -> Word:
    """Return the uniform 32-bit draw of a global slot under the keys of a tick and index."""
    x = u32(slot ^ key_a)
    x = u32(x ^ u32(x >> u32(16)))
    x = u32(x * u32(MULTIPLIER_1))
    x = u32(x ^ key_b)
    x = u32(x ^ u32(x >> u32(15)))
    x = u32(x * u32(MULTIPLIER_2))
    return u32(x ^ u32(x >> u32(16)))


def checked_seed(seed: object) -> int:
    """Return a seed as an ``int``; refuse what is no non-negative integer."""
    try:
        value = operator.index(seed)  # type: ignore[arg-type]
    except TypeError:
        value = -1
    if value < 0 or isinstance(seed, bool):
        raise ArgumentError(f"seed is {seed!r}; it must be a non-negative integer")
    return value


def seed_words(seed: int) -> tuple[int, int]:
    """Spread a non-negative seed of any size, and any type of integer, over two 32-bit words.

    Through :class:`numpy.random.SeedSequence`, whose output NumPy guarantees not to change, so
    that neighbouring seeds have nothing in common.
    """
    low, high = np.random.SeedSequence(operator.index(seed)).generate_state(2, np.uint32)
    return int(low), int(high)


def following(tick: int) -> int:
    """Return the tick after one."""
    return (tick + 1) & LAST_TICK


def signed(tick: int) -> np.int64:
    """Return a tick as kernels take it, whose integers are of 64 bits with a sign: they take its bits."""
    return np.uint64(tick).astype(np.int64)


def draws(seed: tuple[int, int], slots: npt.ArrayLike, tick: int, index: int) -> npt.NDArray[np.uint32]:
    """Return draw ``index`` (below ``2**32``) at ``tick`` (below ``2**64``) for many slots at once.

    ``slots`` are global numbers below ``2**32``, of any shape, which is that of the result; the seed is
    that of :func:`seed_words`.
    """
    with np.errstate(over="ignore"):
        words = u32(seed[0]), u32(seed[1]), u64(tick), u32(index)
        key_a, key_b = key(u32(CHAIN_A), *words), key(u32(CHAIN_B), *words)
        result: npt.NDArray[np.uint32] = draw(np.asarray(slots, np.uint32), key_a, key_b)
    return result
