"""From a build to what a hardware tool is given: sources, parameters, macros.

Simulation, synthesis and lint all elaborate the same design from the same three lists.
"""

from __future__ import annotations

import ast
import hashlib
import operator
import os
import re
import tempfile
import zlib
from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import Path
from typing import NamedTuple

from pearl_marl.cache import cache_folder
from pearl_marl.compiler.cores import generated_core
from pearl_marl.compiler.loading import fingerprint
from pearl_marl.compiler.targets import Target
from pearl_marl.compiler.verilog import HEADER
from pearl_marl.errors import DeviceError
from pearl_marl.hardware.build import Build
from pearl_marl.memory_map import MemoryMap
from pearl_marl.spec import EnvSpec, snake_case, word_bits

_PACKAGES_OF_CORES = ("pearl_pkg", "pearl_fixed_pkg")
"""The packages that a core may use, and that have to be read before it."""


TARGET = Target("xc7", 150.0)
"""What the cores that devices and tools generate are made for; ``pearl core`` makes them for others too."""


def core_path(spec: EnvSpec) -> Path:
    """Return the core's file: its author's, if there is one beside the golden step, else a generated one.

    An author's is ``<name>_pe.sv`` in the folder ``<name>``.

    Raises
    ------
    ArgumentError
        There is none, and the golden functions do what no hardware can.
    """
    return _own_core(spec) or _generated_core(spec)


def _own_core(spec: EnvSpec) -> Path | None:
    folder = Path(spec.golden.step.__code__.co_filename).parent
    path = folder / f"{folder.name}_pe.sv"
    if not path.is_file() or HEADER in path.read_text().partition("\n")[0]:
        return None  # what `pearl core` wrote would only grow stale there
    return path


def _generated_core(spec: EnvSpec) -> Path:
    words = spec.state, spec.action, spec.observation, spec.reward, spec.reset_draws, spec.step_draws
    key = repr((spec.id, spec.options, words, [fingerprint(function) for function in spec.golden]))
    if key not in _generated:
        text = generated_core(spec, TARGET).text
        digest = hashlib.sha256(text.encode()).hexdigest()[:16]
        _generated[key] = cache_folder("cores") / digest / f"{snake_case(spec.name)}_pe.sv"
        if not _generated[key].exists():
            _generated[key].parent.mkdir(exist_ok=True)
            # Written beside and renamed, so that another process never reads half a file.
            with tempfile.NamedTemporaryFile("w", dir=cache_folder("cores"), delete=False) as file:
                file.write(text)
            os.replace(file.name, _generated[key])
    return _generated[key]


_generated: dict[str, Path] = {}
"""Files by all that they depend on."""


def backbone_paths() -> list[Path]:
    """Return the files of the backbone; packages come first, as the tools demand."""
    folder = Path(str(resources.files("pearl_marl.rtl")))
    packages = [folder / f"{name}.sv" for name in (*_PACKAGES_OF_CORES, "pearl_core_pkg")]
    return packages + sorted(path for path in folder.glob("*.sv") if path not in packages)


def sources(spec: EnvSpec) -> list[Path]:
    """Return every file of a design, in the order in which they have to be read."""
    paths = backbone_paths()
    before = len(_PACKAGES_OF_CORES)
    return [*paths[:before], core_path(spec), *paths[before:]]


def macros(spec: EnvSpec) -> dict[str, str]:
    """Return the macros that name the core and set its parameters."""
    core = core_path(spec).stem
    defined = {"PEARL_CORE": core, "PEARL_CORE_PKG": core.removesuffix("_pe") + "_pkg"}
    given = ",".join(f".{name}({literal})" for name, literal in core_parameters(spec).items())
    return {**defined, "PEARL_CORE_OPTIONS": given} if given else defined


def core_parameters(spec: EnvSpec) -> dict[str, str]:
    """Return the core's parameters by name, as SystemVerilog literals.

    They are ``spec.core_parameters``, or the environment's options under their names in capitals. In a
    generated core the options are constants.
    """
    if _own_core(spec) is None:
        return {}
    given = spec.core_parameters
    if given is None:
        given = {name.upper(): int(value) for name, value in spec.options.items()}
    return {name: _literal(value) for name, value in given.items()}


def _literal(value: int) -> str:
    # A number without a size is a signed one of 32 bits. Sizes are powers of two, because tools warn of
    # a literal narrower than its parameter.
    if -(1 << 31) <= value < 1 << 31:
        return str(value)
    return f"{max(32, 1 << (value.bit_length() - 1).bit_length())}'d{value}"


class Timing(NamedTuple):
    """When a core answers, in clock cycles."""

    latency: int
    """From an input to its result: ``LATENCY`` of the core's package."""
    interval: int
    """From one input to the next: ``II``."""


def core_timing(spec: EnvSpec) -> Timing:
    """Return when a core answers, as its package states it in numbers and constants of packages."""
    core = core_path(spec)
    folder = backbone_paths()[0].parent
    constants: dict[str, str] = {}
    for path in (*(folder / f"{name}.sv" for name in _PACKAGES_OF_CORES), core):
        package = path.read_text().partition("endpackage")[0]
        constants |= re.findall(r"localparam\s+int\s+unsigned\s+(\w+)\s*=\s*([^;]+);", package)
    try:
        return Timing(*(_constant(name, constants) for name in ("LATENCY", "II")))
    except (KeyError, TypeError, RecursionError) as error:
        raise DeviceError(
            f"{core} does not state LATENCY and II as `localparam int unsigned`, in whole numbers and "
            f"constants of packages: {error}"
        ) from None


_OPERATORS: dict[type[ast.operator], Callable[[int, int], int]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.floordiv,
}


def _constant(name: str, constants: Mapping[str, str]) -> int:
    """Return the value of a constant; its expression is one that Python writes in the same way."""

    def value(node: ast.expr) -> int:
        match node:
            case ast.Constant(int(number)):
                return number
            case ast.Name(other):
                return _constant(other, constants)
            case ast.BinOp(left, sign, right) if type(sign) in _OPERATORS:
                return _OPERATORS[type(sign)](value(left), value(right))
        raise TypeError(f"{name} = {constants[name]}")

    try:
        tree = ast.parse(re.sub(r"\w+::", "", constants[name]).strip(), mode="eval")
    except SyntaxError:
        raise TypeError(f"{name} = {constants[name]}") from None
    return value(tree.body)


def env_hash(spec: EnvSpec) -> int:
    """Return a number that names an environment with its options, for the control region.

    It has 31 bits, because a parameter given to Yosys as a plain number is a signed one of 32.
    """
    return zlib.crc32(repr((spec.id, sorted(spec.options.items()))).encode()) & 0x7FFFFFFF


def address_bits(layout: MemoryMap) -> int:
    """Return how many bits of byte address reach the whole map and a hole after it."""
    return layout.end(layout.regions[-1].name).bit_length()


def parameters(build: Build) -> dict[str, int]:
    """Return the parameters of ``pearl_top``, but for the widths of its bus's addresses and ids."""
    spec, layout = build
    word_bytes = layout.data_wl // 8
    offsets = {f"{region.name.upper()}_OFFSET": region.offset // word_bytes for region in layout.regions}
    return {
        "N_ENVS": layout.n_envs,
        "PE_NUM": layout.pe_num,
        "DATA_WL": layout.data_wl,
        "STATE_BITS": word_bits(spec.state),
        "ACTION_BITS": spec.action.bits,
        "OBS_BITS": word_bits(spec.observation),
        "REWARD_BITS": spec.reward.bits,
        "DRAWS": spec.reset_draws + spec.step_draws,
        "ENV_HASH": env_hash(spec),
        **offsets,
        "END_OFFSET": layout.end("status") // word_bytes,
    }


def top_parameters(build: Build) -> dict[str, int]:
    """Return :func:`parameters` and the width of an address that reaches the whole map, and not much more.

    So everything that simulates or measures the design alone has it; a board's bus has a width of its own.
    """
    return {**parameters(build), "ADDR_BITS": address_bits(build.layout)}
