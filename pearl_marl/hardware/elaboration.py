"""From a build to what a hardware tool is given: sources and parameters.

Simulation, synthesis and lint all elaborate the same design from the same two lists.
"""

from __future__ import annotations

import functools
import hashlib
import operator
import re
import zlib
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pearl_marl.base.cache import cache_folder
from pearl_marl.base.files import write_whole
from pearl_marl.compiler.cores import (
    ACT,
    SHOW,
    Core,
    core_name,
    generated_act,
    generated_core,
    generated_show,
)
from pearl_marl.compiler.loading import fingerprint
from pearl_marl.compiler.targets import Target
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware.build import Build
from pearl_marl.memory_map import Engine, stream_bits
from pearl_marl.spec import EnvSpec, snake_case, word_bits

if TYPE_CHECKING:
    from pearl_marl.policies.golden_policy import GoldenPolicy

TARGET = Target("xc7", 150.0)
"""What cores are generated for where there is no FPGA, as in simulation."""


MARGIN = 1.5
"""How many times as fast as it is clocked a core is to be, because delays before placement are estimates."""


def clocked(family: str, mhz: float) -> Target:
    """Return what a core is generated for that is clocked with so many MHz on a family of FPGAs."""
    most = Target(family, 1.0).family.fastest // MARGIN
    if not 1 <= mhz <= most:
        raise ArgumentError(
            f"the clock is {mhz:g} MHz; for {family} it can be 1 to {most:g}, as cores are made for "
            f"{MARGIN:g} times that"
        )
    return Target(family, MARGIN * mhz)


def core_path(spec: EnvSpec, target: Target = TARGET) -> Path:
    """Return the core's file: the one that the spec names, or else one generated for the target.

    Raises
    ------
    ArgumentError
        The file that the spec names is missing or does not state its timing; or the golden functions do what
        no hardware can.
    """
    if spec.core is None:
        return _generated_core(spec, target)
    path = Path(spec.core)
    if not path.is_file():
        raise ArgumentError(f"{spec.id}: its core is to be {path}, and there is no such file")
    if core_name(spec) != snake_case(spec.name):
        raise ArgumentError(
            f"{spec.id}: its own core would be the module {snake_case(spec.name)}_pe, and names that begin "
            "with pearl are for the modules around cores; give the environment another name"
        )
    _timing(path)
    return path


def _generated_core(spec: EnvSpec, target: Target) -> Path:
    drawn = spec.reset_draws, spec.step_draws
    words = spec.state, spec.action_fields, spec.agent_fields, spec.reward, *drawn, spec.agents
    functions = [fingerprint(function) for function in spec.functions]
    # A state's methods are called by no name that its functions see.
    functions += [fingerprint(kind) for kind in spec.layout.classes]
    key = repr((spec.id, spec.options, words, functions, target))
    if key not in _generated:
        _generated[key] = generated_core(spec, target).text
    return _kept(_generated[key], f"{core_name(spec)}_pe.sv")


def _kept(text: str, name: str) -> Path:
    """Return a file of that name and text in the cache."""
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    path = cache_folder("cores") / digest / name
    try:
        if not path.exists() or path.read_bytes() != text.encode():
            write_whole(path, text.encode())
    except OSError as error:
        raise DeviceError(
            f"the core could not be written to {path}: {error.strerror}; make room there, or set "
            "PEARL_CACHE_DIR to another folder"
        ) from error
    return path


_generated: dict[str, str] = {}
"""Their texts, by all that they depend on."""


def act_core(spec: EnvSpec, engine: Engine, target: Target = TARGET) -> Core:
    """Return the core of an engine for a golden function.

    Raises
    ------
    ArgumentError
        The engine does not have its policy, or that is for another environment; or it does what no hardware
        can.
    """
    policy = engine.function
    if policy is None:
        raise ArgumentError(
            "an engine for a golden function is built of its policy, and this one has the number "
            f"{engine.stated}: give Engine('golden', function=GoldenPolicy(...))"
        )
    if (policy.spec.id, policy.spec.behaviour) != (spec.id, spec.behaviour):
        raise ArgumentError(
            f"the engine's policy is for {policy.spec.id} with options {dict(policy.spec.options)}, and the "
            f"build for {spec.id} with {dict(spec.options)}: make the policy with the spec of the build"
        )
    return _act_core(policy, target)


@functools.lru_cache(maxsize=64)
def _act_core(policy: GoldenPolicy, target: Target) -> Core:
    return generated_act(policy.spec, policy.of_words, policy.draws, target)


def show_core(spec: EnvSpec, target: Target = TARGET) -> Core:
    """Return the core that makes pictures of what agents are shown, for an engine for networks on planes.

    Raises
    ------
    ArgumentError
        ``unpack()`` does what no hardware can; the message names the file and the line.
    """
    unpack = None if spec.unpack is None else fingerprint(spec.unpack)
    key = repr((spec.id, spec.options, spec.agent_fields, spec.observation_shape, unpack, target))
    if key not in _shown:
        _shown[key] = generated_show(spec, target)
    return _shown[key]


_shown: dict[str, Core] = {}
"""Their cores, likewise."""


WRAPPER = "pearl_core.sv"
"""The file that ties a core to the backbone: :func:`core_wrapper`."""


def core_wrapper(spec: EnvSpec, engine: Engine | None = None, target: Target = TARGET) -> str:
    """Return the module and packages under which the backbone knows an environment's core, and its engine.

    The core keeps its own name, so one bitstream may hold any environment.

    Raises
    ------
    ArgumentError
        An option, which is a parameter of the core, is not an integer.
    """
    core, bits = core_name(spec), stream_bits(spec)
    assigned = ", ".join(f".{name}({literal})" for name, literal in core_parameters(spec).items())
    template = resources.files("pearl_marl.rtl") / f"{WRAPPER}.in"
    return template.read_text("utf-8").format(
        id=spec.id,
        core=core,
        parameters=f" #({assigned})" if assigned else "",
        state_bits=word_bits(spec.state),
        agents=spec.agents,
        action_bits=bits["actions"],
        obs_bits=bits["observations"],
        reward_bits=bits["rewards"],
        draws=spec.reset_draws + spec.step_draws,
        env_hash=f"32'h{env_hash(spec):08X}",
        **_engine_constants(spec, engine, target),
    )


def _engine_constants(spec: EnvSpec, engine: Engine | None, target: Target) -> dict[str, object]:
    """Return the constants of the engine's package; of no engine, the least that are legal."""
    shape, fields = engine or Engine(), spec.observation
    golden, pictures = shape.kind == "golden", shape.kind == "planes"
    height, width, planes = spec.observation_shape if pictures else (3, 3, 1)
    offsets = [word_bits(fields[:k]) for k in range(len(fields))]
    return {
        **shape._asdict(),
        "engine": "NoEngine" if engine is None else f"{engine.kind.title()}Engine",
        "agent_obs_bits": word_bits(spec.agent_fields),
        "elements": len(fields),
        "element_bits": max(field.bits + (not field.signed) for field in fields),
        "element_offsets": ", ".join(map(str, offsets)),
        "element_widths": ", ".join(str(field.bits) for field in fields),
        "element_signs": ", ".join(str(int(field.signed)) for field in fields),
        "masked": int(bool(spec.mask_fields)),
        "actions": max(1, sum(spec.action_counts)),
        "agent_reward_bits": spec.reward.bits,
        "reward_tabled": int(bool(spec.rewards)),
        "reward_signed": int(spec.reward.signed),
        "drawn": int(shape.drawn),
        "inputs": shape.inputs(spec),
        "height": height,
        "width": width,
        "planes": planes,
        "show_latency": show_core(spec, target).latency if pictures else 1,
        "weight_words": shape.weight_words(spec),
        "act_draws": shape.draws if golden else 0,
        "act_latency": act_core(spec, shape, target).latency if golden else 1,
        "act_number": f"31'h{shape.number:08X}",
        "policy_index_bits": shape.index_bits(spec),
    }


def backbone_paths() -> list[Path]:
    """Return the files of the backbone; packages come first, as the tools demand."""
    folder = Path(str(resources.files("pearl_marl.rtl")))
    packages = [folder / "pearl_pkg.sv", folder / "pearl_map_pkg.sv"]
    return packages + sorted(path for path in folder.glob("*.sv") if path not in packages)


def sources(spec: EnvSpec, target: Target = TARGET, engine: Engine | None = None) -> list[Path]:
    """Return every file of a design, in the order in which they have to be read."""
    package, *rest = backbone_paths()
    cores = [core_path(spec, target)]
    if engine is not None and engine.kind == "golden":
        cores.append(_kept(act_core(spec, engine, target).text, f"{ACT}.sv"))
    if engine is not None and engine.kind == "planes":
        cores.append(_kept(show_core(spec, target).text, f"{SHOW}.sv"))
    return [package, *cores, _kept(core_wrapper(spec, engine, target), WRAPPER), *rest]


def core_parameters(spec: EnvSpec) -> dict[str, str]:
    """Return the parameters of a core that the spec names, as SystemVerilog literals.

    They are the environment's options, under their names in capitals. In a generated core they are constants.
    """
    if spec.core is None:
        return {}
    try:
        return {name.upper(): _literal(operator.index(value)) for name, value in spec.options.items()}
    except TypeError as error:
        raise ArgumentError(
            f"{spec.id}: options are parameters of its core, {spec.core}, and have to be integers: {error}"
        ) from None


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


def core_timing(spec: EnvSpec, target: Target = TARGET) -> Timing:
    """Return when a core answers, as its package states it."""
    return _timing(core_path(spec, target))


def _timing(core: Path) -> Timing:
    package = core.read_text("utf-8").partition("endpackage")[0]
    stated = dict(re.findall(r"localparam\s+int\s+unsigned\s+(\w+)\s*=\s*(\d+)\s*;", package))
    for name in ("LATENCY", "II"):
        if name not in stated:
            raise ArgumentError(
                f"{core} does not state {name}: its package needs `localparam int unsigned {name} = 1;` with "
                "a number of cycles"
            )
    timing = Timing(int(stated["LATENCY"]), int(stated["II"]))
    if min(timing) < 1:
        raise ArgumentError(
            f"{core} states LATENCY {timing.latency} and II {timing.interval}; both must be at least 1"
        )
    return timing


def env_hash(spec: EnvSpec) -> int:
    """Return a number that names an environment and what its golden functions do, for the control region.

    Its options are in there by what they make of the functions. It has 31 bits, because a parameter given to
    Yosys as a plain number is a signed one of 32.
    """
    return zlib.crc32(f"{spec.id} {spec.behaviour}".encode()) & 0x7FFFFFFF


def top_parameters(build: Build) -> dict[str, int]:
    """Return the parameters of ``pearl_top``, with addresses that reach the whole map and a hole after it.

    So everything that simulates or measures the design alone has it; a board's bus has a width of its own.
    """
    layout = build.layout
    bits = layout.end(layout.regions[-1].name).bit_length()
    return {"N_ENVS": layout.n_envs, "PE_NUM": layout.pe_num, "DATA_WL": layout.data_wl, "ADDR_BITS": bits}
