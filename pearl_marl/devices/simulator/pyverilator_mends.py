"""What PyVerilator 0.7.0 needs to build and load a model under Verilator 5 on a Python of today.

PyVerilator was written for Verilator 3 and 4. It is used here for what it does: it drives
Verilator and the C++ compiler, generates the C++ that gives Python a model's signals, loads the
library, and reads signals by name. Each mend below names what fails without it. They are made when
this module is first asked for a model, and ``tests/devices/test_pyverilator_mends.py`` fails if the
package is no longer the one that they mend.
"""

from __future__ import annotations

import functools
import importlib.metadata
import re
import sys
import threading
import types
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest import mock

from pearl_marl.errors import DeviceError
from pearl_marl.hardware import toolchain

VERSION = "0.7.0"
"""The version that these mends are for."""

TOP = "pearl_top"
"""The module that a model is made of."""

_Signals = Sequence[tuple[str, int]]

# The package is changed while a build runs, so one runs at a time in a process.
_lock = threading.Lock()

# What our change to the generated C++ replaces.
_CONSTRUCT = """    Verilated::traceEverOn(true);
    V{top}* top = new V{top}();
"""
_OWN_CONTEXT = """    auto* context = new VerilatedContext;
    context->traceEverOn(true);
    V{top}* top = new V{top}(context);
"""
_TRACE_FUNCTIONS = re.compile(r"VerilatedVcdC\* start_vcd_trace.*?(?=bool get_finished)", re.DOTALL)
# A signal of Verilator 5's root class: `CData/*0:0*/ pearl_top__DOT__u_backbone__DOT__busy;`
# Names with __V are Verilator's own.
_SIGNAL = re.compile(
    rf"^\s*(?:CData|SData|IData|QData|VlWide<\d+>)/\*(\d+):0\*/ ({TOP}__DOT__(?!\w*__V)\w+);", re.MULTILINE
)


@functools.cache
def package() -> Any:
    """Import PyVerilator.

    Raises
    ------
    DeviceError
        It is missing, or of a version that these mends are not for.
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
    with mock.patch.dict(sys.modules, {"tclwrapper": types.ModuleType("tclwrapper")}):
        import pyverilator.pyverilator as module

    module.verilator_name_to_standard_modular_name = _path
    return module


def _path(name: str) -> tuple[str, ...]:
    """Return the instances and the signal that a name of Verilator stands for, without the top.

    The package's own function gives up at the brackets of generate loops.
    """
    name = name.removeprefix(f"{TOP}__DOT__").replace("__BRA__", "[").replace("__KET__", "]")
    name = name.replace("__DOT__", ".")
    return tuple(re.sub(r"__0([0-9A-F]{2})", lambda match: chr(int(match[1], 16)), name).split("."))


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
    module = package()
    wrapper = folder / "pyverilator_wrapper.cpp"

    def call_process(_arguments: Sequence[str]) -> None:
        # The package's own arguments choose C++11, which Verilator 5 cannot be compiled with, take
        # one source file and no parameters, turn tracing on always and lint errors off.
        names = ["--top-module", TOP, "--prefix", f"V{TOP}", "-Mdir", str(folder)]
        # A table of constants would be one for the whole process, that of the first model that is loaded.
        flags = ["-CFLAGS", "-fPIC -fno-gnu-unique -DVL_USER_FINISH"]
        toolchain.run(["verilator", "--cc", "--exe", str(wrapper), *names, *flags, *arguments])

    template = module.template_cpp.template_cpp

    def template_cpp(top: str, inputs: _Signals, outputs: _Signals, _internals: _Signals, json: str) -> str:
        # Verilator 5 declares ports as references, VL_IN8(&clk,0,0), and the package takes the & for
        # a part of the name; and it keeps a model's internal signals in a class of their own.
        inputs, outputs = (
            [(name.lstrip("&"), width) for name, width in ports] for ports in (inputs, outputs)
        )
        root = (folder / f"V{top}___024root.h").read_text("utf-8")
        internals = [(name, int(high) + 1) for high, name in _SIGNAL.findall(root)]
        text: str = template(top, inputs, outputs, internals, json)
        text = text.replace(f"top->{top}__DOT__", f"top->rootp->{top}__DOT__")
        # Models that share the default context cannot run in different threads. A context outlives its
        # model, because Verilator's library keeps pointers to it in every thread that it ran in.
        text = _replace(text, _CONSTRUCT.format(top=top), _OWN_CONTEXT.format(top=top))
        if not traced:  # the library then lacks what these call
            text = _TRACE_FUNCTIONS.sub("", text)
        return f'#include "V{top}___024root.h"\n#define PEARL_MODEL V{top}\n{text}\n{code}'

    # It also looks for Verilator on the PATH, which toolchain.run() does its own way.
    programs = types.SimpleNamespace(which=toolchain.find)
    with (
        _lock,
        mock.patch.multiple(module, call_process=call_process, shutil=programs),
        mock.patch.object(module.template_cpp, "template_cpp", template_cpp),
    ):
        module.PyVerilator.build(f"{TOP}.v", build_dir=str(folder), gen_only=True)


def load(library: Path) -> Any:
    """Load a compiled model; return its ``PyVerilator`` object.

    Raises
    ------
    DeviceError
        The file is no library of a model.
    """
    try:
        return package().PyVerilator(str(library), auto_eval=False)
    except (OSError, AttributeError, ValueError) as error:
        raise DeviceError(f"the simulated device's library {library} cannot be loaded: {error}") from error


def _replace(text: str, old: str, new: str) -> str:
    if text.count(old) != 1:
        raise DeviceError(f"PyVerilator's C++ is not as version {VERSION} writes it: it lacks\n{old}")
    return text.replace(old, new)
