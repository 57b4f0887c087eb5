"""A model of the hardware by PyVerilator 0.7.0, under Verilator 5 and on a Python of today.

PyVerilator was written for Verilator 3 and 4. It is used here for what it does: it generates the C++ that
gives Python a model's signals, loads the library, and reads signals by name. Verilator is run here, with
arguments that its present version takes, and :class:`Model` names signals of generate loops, too.
``tests/devices/test_pyverilator_model.py`` fails if the package is no longer the one that this is for.
"""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import re
import sys
import types
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pearl_marl.errors import DeviceError
from pearl_marl.hardware import toolchain

VERSION = "0.7.0"
"""The version of PyVerilator that this is for."""

TOP = "pearl_top"
"""The module that a model is made of."""

Signals = list[tuple[str, int]]
"""Names in C++, and widths in bits."""

# What replaces what in the generated C++.
_CONSTRUCT = """    Verilated::traceEverOn(true);
    V{top}* top = new V{top}();
"""
_OWN_CONTEXT = """    auto* context = new VerilatedContext;
    context->traceEverOn(true);
    V{top}* top = new V{top}(context);
"""
_TRACE_FUNCTIONS = re.compile(r"VerilatedVcdC\* start_vcd_trace.*?(?=bool get_finished)", re.DOTALL)
# A port of Verilator 5's model class, a reference: `VL_IN8(&clk_i,0,0);`
_PORT = re.compile(r"VL_(IN|OUT)\w*\(&?(\w+),(\d+),(\d+)(?:,\d+)?\);")
# A signal of its root class: `CData/*0:0*/ pearl_top__DOT__u_backbone__DOT__busy;`
# Names with __V are Verilator's own.
_SIGNAL = re.compile(
    rf"^\s*(?:CData|SData|IData|QData|VlWide<\d+>)/\*(\d+):0\*/ ({TOP}__DOT__(?!\w*__V)\w+);", re.MULTILINE
)
# An environment's core has thousands of signals, and functions to read them take a fifth of a build.
_IN_A_CORE = "__DOT__u_core__DOT__"


@functools.cache
def package() -> Any:
    """Import PyVerilator.

    Raises
    ------
    DeviceError
        It is missing, or of another version.
    """
    try:
        found = importlib.metadata.version("pyverilator")
    except importlib.metadata.PackageNotFoundError:
        found = "not installed"
    if found != VERSION:
        raise DeviceError(
            f"PyVerilator {VERSION} loads simulated devices, and it is {found}; "
            "install it with: pip install '.[rtl]'"
        )
    # tclwrapper fails to import on Python 3.11 and without a Tk; only GTKWave's remote control uses it.
    installed = sys.modules.get("tclwrapper")
    sys.modules["tclwrapper"] = types.ModuleType("tclwrapper")
    try:
        return importlib.import_module("pyverilator.pyverilator")
    finally:
        del sys.modules["tclwrapper"]
        if installed is not None:
            sys.modules["tclwrapper"] = installed


@functools.cache
def model_class() -> Any:
    """Return the package's ``PyVerilator`` with names of signals as in the hardware's source."""
    module = package()
    base: Any = module.PyVerilator

    class Model(base):  # type: ignore[misc]  # pyverilator has no types
        def _populate_signal_collections(self) -> None:
            # The package's own function gives up at the brackets of generate loops.
            signals = (*self.inputs, *self.outputs, *self.internal_signals)
            self.by_path = {signal_path(name): name for name, _ in signals}
            self.io = module.Collection({})

        def value(self, path: str) -> int | None:
            """Return the present value of a signal, by its path under the top; ``None`` if there is none."""
            name = self.by_path.get(path)
            return None if name is None else int(self[name])

    return Model


def signal_path(name: str) -> str:
    """Return the instances and the signal that a name of Verilator stands for, without the top."""
    name = name.removeprefix(f"{TOP}__DOT__").replace("__BRA__", "[").replace("__KET__", "]")
    return re.sub(r"__0([0-9A-F]{2})", lambda match: chr(int(match[1], 16)), name.replace("__DOT__", "."))


def generate(folder: Path, arguments: Sequence[str], code: str, traced: bool) -> None:
    """Let Verilator and PyVerilator write a model's C++ and its makefile.

    Parameters
    ----------
    folder
        Where to; it exists.
    arguments
        Verilator's: sources, parameters and options.
    code
        C++ to stand after the generated wrapper, in which the model's class is ``PEARL_MODEL``.
    traced
        Whether ``arguments`` ask for waveforms.

    Raises
    ------
    DeviceError
        A tool is missing or failed, with its words.
    """
    wrapper = folder / "pyverilator_wrapper.cpp"
    names = ["--top-module", TOP, "--prefix", f"V{TOP}", "-Mdir", str(folder)]
    # A table of constants would be one for the whole process, that of the first model that is loaded.
    flags = ["-CFLAGS", "-fPIC -fno-gnu-unique -DVL_USER_FINISH"]
    toolchain.run(["verilator", "--cc", "--exe", str(wrapper), *names, *flags, *arguments])
    header, root = ((folder / f"V{TOP}{end}.h").read_text("utf-8") for end in ("", "___024root"))
    wrapper.write_text(wrapper_code(header, root, code, traced), "utf-8")


def wrapper_code(header: str, root: str, code: str, traced: bool) -> str:
    """Return the C++ around a model, by the headers of its class and its root class.

    Signals of cores can be read if the model is ``traced``.
    """
    ports: dict[str, Signals] = {"IN": [], "OUT": []}
    for kind, name, high, low in _PORT.findall(header):
        ports[kind].append((name, int(high) - int(low) + 1))
    found = [(name, int(high) + 1) for high, name in _SIGNAL.findall(root)]
    signals = [(name, bits) for name, bits in found if traced or _IN_A_CORE not in name]
    text: str = package().template_cpp.template_cpp(TOP, ports["IN"], ports["OUT"], signals, '"null"')
    # Verilator 5 keeps a model's internal signals in a class of their own.
    text = text.replace(f"top->{TOP}__DOT__", f"top->rootp->{TOP}__DOT__")
    # Models that share the default context cannot run in different threads. A context outlives its
    # model, because Verilator's library keeps pointers to it in every thread that it ran in.
    text = _replace(text, _CONSTRUCT.format(top=TOP), _OWN_CONTEXT.format(top=TOP))
    if not traced:  # the library then lacks what these call
        text = _TRACE_FUNCTIONS.sub("", text)
    return f'#include "V{TOP}___024root.h"\n#define PEARL_MODEL V{TOP}\n{text}\n{code}'


def load(library: Path) -> Any:
    """Load a compiled model; return it as :func:`model_class` has it.

    Raises
    ------
    DeviceError
        The file is no library of a model.
    """
    try:
        return model_class()(str(library), auto_eval=False)
    except (OSError, AttributeError, ValueError) as error:
        raise DeviceError(f"the simulated device's library {library} cannot be loaded: {error}") from error


def _replace(text: str, old: str, new: str) -> str:
    if text.count(old) != 1:
        raise DeviceError(f"PyVerilator's C++ is not as version {VERSION} writes it: it lacks\n{old}")
    return text.replace(old, new)
