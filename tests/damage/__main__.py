"""Damages files of all kinds, and reads them.

``python -m tests.damage FOLDER COUNT [KIND [NUMBER]]``: it has a process of its own, as a limit of memory
holds for all of one. The last line is JSON of what came of each kind, and of what is neither refused nor
right.
"""

from __future__ import annotations

import contextlib
import faulthandler
import json
import os
import re
import resource
import sys
import time
import traceback
import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from pearl_marl.errors import PearlError

from .commands import CommandLine
from .damages import TRAP
from .devices import Boards, Locks, Replays
from .kind import Kind, WrongError, expect
from .policies import Archives, Arrays, NumberPolicies, Policies, Tables
from .states import SavedStates, StatesOfTurns, StatesOfWrappers, StatesWithoutAutoreset
from .trainings import Configs, Leagues, Memories, Training

MOST = 256 << 20
"""Bytes of memory that all cases together may take, beyond what undamaged files took."""

SECONDS = 10.0
"""Of processor time, for one case."""

KINDS: dict[str, type[Kind]] = {
    kind.__name__: kind
    for kind in (
        SavedStates,
        StatesOfTurns,
        StatesWithoutAutoreset,
        StatesOfWrappers,
        Policies,
        Tables,
        NumberPolicies,
        Arrays,
        Archives,
        Replays,
        Training,
        Memories,
        Leagues,
        Configs,
        Boards,
        Locks,
        CommandLine,
    )
}


def memory(field: str) -> int:
    """Return a figure of this process's memory, in bytes."""
    found = re.search(rf"{field}:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found is not None
    return int(found[1]) << 10


def one(name: str, kind: Kind, number: int, others: list[bytes]) -> str:
    """Do a case; return "refused" or "right", or raise WrongError with all that helps."""
    rng = np.random.default_rng([zlib.crc32(name.encode()), number])
    content, sealed = kind.case(others, rng)
    began = time.process_time()
    try:
        kind.read(content, sealed)
        outcome = "right"
    except PearlError as error:
        outcome, said = "refused", str(error)
        if len(said.splitlines()) != 1 or len(said) > 2000:
            raise WrongError(f"{name} {number}: it is refused by {said!r}") from error
    except BaseException as error:
        raise WrongError(f"{name} {number}: {''.join(traceback.format_exception(error))}") from error
    took = time.process_time() - began
    expect(took < SECONDS, f"{name} {number}: it took {took:.1f} s")
    return outcome


def cases(count: int, only: str | None, number: int | None) -> Iterator[tuple[str, int]]:
    """Yield kinds and numbers of cases."""
    names = [only] if only else list(KINDS)
    if number is not None:
        yield names[0], number
        return
    weights = {name: KINDS[name].weight for name in names}
    for name in names:
        for k in range(max(1, round(count * weights[name] / sum(weights.values())))):
            yield name, k


def main(folder: Path, count: int, only: str | None = None, number: int | None = None) -> None:
    """Do as many cases; print what came of each kind."""
    faulthandler.enable()
    torch.set_num_threads(1)
    kinds: dict[str, Kind] = {}
    for name, kind in KINDS.items():
        if only in (None, name):
            (folder / name).mkdir()
            kinds[name] = kind(folder / name)
    others = [kind.sample for kind in kinds.values()]
    for kind in kinds.values():
        kind.warm_up()
    (folder / f"{TRAP}.py").write_text("raise SystemExit('imported')")
    sys.path.insert(0, str(folder))
    os.chdir(folder)
    known = set(sys.modules)
    with contextlib.suppress(OSError):  # not every container lets the peak begin anew
        Path("/proc/self/clear_refs").write_text("5")
    before = memory("VmHWM")
    limit = memory("VmSize") + 4 * MOST
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    outcomes: dict[str, Counter[str]] = {name: Counter() for name in kinds}
    failures = []
    for name, k in cases(count, only, number):
        Path("at").write_text(f"{name} {k}")  # which a crash would not tell
        try:
            outcomes[name][one(name, kinds[name], k, others)] += 1
        except WrongError as error:
            failures.append(str(error))
            outcomes[name]["wrong"] += 1
    taken = memory("VmHWM") - before
    # What the registry knows, and compiles (Numba imports parts of itself for that); and codes of text, as
    # JSON may be of any.
    ours = "pearl_marl.envs.", "pearl_marl_kernel_", "numba.", "encodings."
    imported = [name for name in set(sys.modules) - known if not name.startswith(ours)]
    if imported:
        failures.append(f"imported: {imported}")
    if taken > MOST:
        failures.append(f"memory: {taken >> 20} MiB")
    for kind in kinds.values():
        kind.close()
    print(json.dumps({"outcomes": outcomes, "MiB": taken >> 20, "failures": failures}))


if __name__ == "__main__":
    _, where, many, *rest = sys.argv
    main(Path(where), int(many), *rest[:1], *map(int, rest[1:]))
