"""Machine code of functions that LLVM compiles by themselves, for code that Numba compiles to call.

Numba compiles a whole kernel at once, and optimizes it two to three times. That takes much longer than to
optimize each of its long functions once, and two kernels that call the same function compile it twice. Here a
function is compiled once in a process, and the code that calls it names its symbol. Files of such code hold
the functions that they call, too: see :mod:`pearl_marl.base.machine_code`.
"""

from __future__ import annotations

import functools
import hashlib
import re
from typing import Any

import llvmlite.binding as llvm
import numba
from numba.core.registry import cpu_target

CONFIG: Any = numba.config

PREFIX = "pearl_function_"
"""With what the symbols begin; a hash of the function's instructions follows."""

_objects: dict[str, bytes] = {}
"""The object code of each symbol that code of this process can call."""


def compiled(text: str, name: str, passes: int = 3, effort: int = 3) -> str:
    """Compile the function of that name in LLVM's text of a module; return the symbol to call it by.

    Parameters
    ----------
    text, name
        The module, and the name of its function.
    passes
        How many of LLVM's passes go over it, 0 to 3. Level 1 turns loops into SIMD code already.
    effort
        How well instructions are selected and registers used, 0 to 3.
    """
    symbol = f"{PREFIX}{hashlib.sha256(f'{passes} {effort} {text}'.encode()).hexdigest()[:32]}"
    if symbol not in _objects:
        module = llvm.parse_assembly(text.replace(f'@"{name}"', f'@"{symbol}"'))
        module.verify()  # or LLVM ends the process where something is wrong
        machine = _machine(effort)
        module.data_layout = str(machine.target_data)
        if passes:
            tuning = llvm.create_pipeline_tuning_options(speed_level=passes)
            tuning.loop_vectorization = True
            builder = llvm.create_pass_builder(machine, tuning)
            # The turns that are left over are done one by one. These loops have many turns, and code for
            # fewer at once would take as long again to compile.
            llvm.set_option("pearl_marl", "-enable-epilogue-vectorization=false")
            try:
                builder.getModulePassManager().run(module, builder)
            finally:
                llvm.set_option("pearl_marl", "-enable-epilogue-vectorization=true")
        add({symbol: machine.emit_object(module)})
    return symbol


def called(text: str) -> dict[str, bytes]:
    """Return the object code of all that LLVM's text of a module calls, each after what it calls itself."""
    found: dict[str, bytes] = {}

    def find(symbols: set[str]) -> None:
        for symbol in sorted(symbols - found.keys()):
            code = _objects[symbol]
            # Object code has the names of the symbols that it defines and calls.
            find(_symbols(code.decode("latin-1")) - {symbol})
            found[symbol] = code

    find(_symbols(text))
    return found


def _symbols(text: str) -> set[str]:
    return set(re.findall(PREFIX + "[0-9a-f]{32}", text))


def add(objects: dict[str, bytes]) -> None:
    """Let the code of this process call functions that have been compiled, here or elsewhere."""
    for symbol, code in objects.items():
        if symbol not in _objects:
            engine = _engine()
            engine.add_object_file(llvm.ObjectFileRef.from_data(code))
            engine.finalize_object()
            llvm.add_symbol(symbol, engine.get_function_address(symbol))
            _objects[symbol] = code


@functools.cache
def _engine() -> Any:
    """Return what holds the machine code."""
    empty = llvm.parse_assembly(f'target triple = "{_kind()[0]}"')
    lmm = CONFIG.USE_LLVMLITE_MEMORY_MANAGER
    return llvm.create_mcjit_compiler(empty, _machine(int(CONFIG.OPT)), use_lmm=lmm)


def _machine(effort: int) -> Any:
    """Return what makes machine code, of the kind that Numba's code is; Numba's settings may ask for less."""
    triple, processor, features = _kind()
    target = llvm.Target.from_triple(triple)
    return target.create_target_machine(processor, features, min(effort, int(CONFIG.OPT)), jit=True)


def _kind() -> tuple[str, str, str]:
    kind: tuple[str, str, str] = cpu_target.target_context.codegen().magic_tuple()
    return kind
