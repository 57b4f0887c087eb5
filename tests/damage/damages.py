"""What happens to files on their way: damages of bytes, and insane values in what has a right checksum."""

from __future__ import annotations

import copy
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

TRAP = "pearl_trap"
"""A module that no file may have imported: names of environments, of devices and of classes name it."""

INSANE: tuple[Any, ...] = (
    *(None, True, False, -1, 0, 1, 7, 255, 256, 2**31, 2**32, 2**63 - 1, 2**63, 2**64, 10**30, -(10**30)),
    *(0.5, -0.0, 1e308, 5e-324, float("nan"), float("inf"), -float("inf")),
    *("", "x", "0", "\n\n", "\x1b[2J", "../../x", "9" * 5000, f"{TRAP}:X", TRAP, f"xdma:{TRAP}"),
    *([], {}, [[]], [0] * 1000, [10**7, 0, 4], {"x": {"y": []}}, [None], [float("nan")], "CartPole", "Taxi"),
)


def damaged(content: bytes, others: Sequence[bytes], rng: np.random.Generator) -> bytes:
    """Return bytes as a disk, a network or an editor might leave them."""
    data = bytearray(content)
    size = len(data)
    begin, end = sorted(rng.integers(size + 1, size=2).tolist())
    early = int(rng.integers(min(size, 256)))
    match int(rng.integers(10)):
        case 0:  # bits, anywhere
            for at in rng.integers(8 * size, size=int(rng.integers(1, 9))).tolist():
                data[at // 8] ^= 1 << at % 8
        case 1:  # a bit of what comes first, where headers are
            data[early] ^= 1 << int(rng.integers(8))
        case 2:
            del data[begin:]
        case 3:
            data[begin:end] = bytes(end - begin)
        case 4:
            data[begin:end] = b"\xff" * (end - begin)
        case 5:  # parts in another order
            data = data[begin:end] + data[:begin] + data[end:]
        case 6:
            data[begin:begin] = rng.bytes(int(rng.integers(1, 100)))
        case 7:  # the beginning of a file of another kind
            other = others[int(rng.integers(len(others)))]
            data[:early] = other[:early]
        case 8:  # large numbers, where there is one
            data[early : early + 8] = int(INSANE[int(rng.integers(8, 14))]).to_bytes(16, "little")[:8]
        case _:
            data = bytearray(rng.bytes(size) if rng.integers(2) else bytes(size))
    return bytes(data)


def mutated(value: Any, rng: np.random.Generator) -> Any:
    """Return a value of JSON in which some are insane, are missing, or are too many."""
    value = copy.deepcopy(value)
    for _ in range(int(rng.integers(1, 4))):
        places = list(_places(value))
        holder, key = places[int(rng.integers(len(places)))]
        insane = copy.deepcopy(INSANE[int(rng.integers(len(INSANE)))])
        match int(rng.integers(6)):
            case 0:
                del holder[key]
            case 1 if isinstance(holder, dict):
                holder[str(rng.choice([f"{key}_", "\n\n", "x" * 5000, "self", TRAP]))] = insane
            case 1:
                holder.append(insane)
            case 2 if type(holder[key]) is int:
                holder[key] += int(rng.choice([-1, 1, 8, 1 << 20]))
            case 3:  # what stands elsewhere
                other, there = places[int(rng.integers(len(places)))]
                if there in other if isinstance(other, dict) else there < len(other):
                    holder[key] = copy.deepcopy(other[there])
            case _:
                holder[key] = insane
        if not value:
            break
    return value


def _places(value: Any) -> Any:
    """Yield all places in a value, as what holds it and the key there."""
    for key in list(value) if isinstance(value, dict) else range(len(value)):
        yield value, key
        if isinstance(value[key], (dict, list)):
            yield from _places(value[key])


def as_json(value: Any) -> bytes:
    """Return JSON of a mutated value."""
    return json.dumps(value).encode()
