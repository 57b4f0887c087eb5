"""What ``import pearl_marl`` brings along, and what it does not."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

HEAVY = (
    "torch",
    "matplotlib",
    "pygame",
    "supersuit",
    "stable_baselines3",
    "tensorboard",
    "envpool",
    "numba.cuda",
    "ray",
    "torchrl",
    "tensordict",
    "benchmarl",
)

LIBRARIES = ("numpy", "numba", "gymnasium", "pettingzoo", "typer")
"""What nothing is done without, and `import pearl_marl` does nothing yet."""

SCRIPT = """
import json, sys
from numba.core import event
with event.install_recorder("numba:compile") as compiled:
    from pearl_marl import *
    import pearl_marl
envs = pearl_marl.list_envs()
print(json.dumps({"modules": list(sys.modules), "compiled": len(compiled.buffer), "envs": envs}))
"""


@pytest.fixture(scope="module")
def imported() -> Any:
    """What a fresh process sees once it has all public names."""
    return told(SCRIPT)


def told(script: str) -> Any:
    """Run a script in a folder that is not the project's; return what it prints, which is JSON."""
    output = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd="/"
    )
    return json.loads(output.stdout)


IN_A_CLONE = """
import sys
sys.meta_path = [finder for finder in sys.meta_path if "editable" not in repr(finder).lower()]
import pearl_marl
import pearl_marl.experiments.report
print(pearl_marl.get_spec("CliffWalking").name, pearl_marl.wrappers.__file__)
"""


def test_a_clone_is_whole_where_another_copy_is_installed() -> None:
    """Python finds the folder of the package first there, and four others are linked into it."""
    root = Path(__file__).parents[1]
    printed = subprocess.run([sys.executable, "-c", IN_A_CLONE], capture_output=True, text=True, cwd=root)
    wrappers = root / "pearl_marl" / "wrappers" / "__init__.py"
    assert printed.stdout.split() == ["CliffWalking", str(wrappers)], printed.stderr


def test_the_import_alone_takes_no_library() -> None:
    modules = told("import json, sys, pearl_marl; print(json.dumps(list(sys.modules)))")
    assert not set(modules) & {*HEAVY, *LIBRARIES}


REGISTERED = """
import json, sys
{imports}
registered = {{*gymnasium.registry}} | ({{*pettingzoo.parallel_registry}} & {{*pettingzoo.aec_registry}})
watching = [getattr(finder, "library", None) for finder in sys.meta_path]
watching = [library for library in watching if library in ("gymnasium", "pettingzoo")]
kept = gymnasium.__loader__.get_source("gymnasium") != pettingzoo.__spec__.loader.get_source("pettingzoo")
print(json.dumps({{"registered": sorted(registered), "watching": len(watching), "kept": kept}}))
"""


@pytest.mark.parametrize(
    "imports",
    [
        "import gymnasium, pettingzoo, pearl_marl",
        "import pearl_marl, gymnasium, pettingzoo",
        "import gymnasium, pearl_marl, pettingzoo.utils",
        "import pearl_marl, pettingzoo, gymnasium",
        "import pearl_marl; pearl_marl.parallel_env; import gymnasium, pettingzoo",
        "from importlib.util import find_spec; import pearl_marl; find_spec('gymnasium')\n"
        "import pettingzoo, gymnasium",
    ],
)
def test_both_libraries_know_the_environments_in_whatever_order(imports: str) -> None:
    import pearl_marl

    seen = told(REGISTERED.format(imports=imports))
    ids = [pearl_marl.get_spec(name).id for name in pearl_marl.list_envs()]
    assert {name for name in seen["registered"] if "earl/" in name} >= {
        f"{library}/{env_id}" for library in ("Pearl", "pearl") for env_id in ids
    }
    assert (seen["watching"], seen["kept"]) == (0, True)


@pytest.mark.parametrize("library", ["pettingzoo", "gymnasium"])
def test_a_library_that_is_not_imported_yet_has_its_files(library: str) -> None:
    """Tools look for data, source and resources of a library before they import it, or do not."""
    script = f"""
import importlib.resources, importlib.util, json, pkgutil
import pearl_marl
loader = importlib.util.find_spec("{library}").loader
seen = [
    loader.get_source("{library}"), loader.is_package("{library}"), loader.get_filename("{library}"),
    loader.get_data(loader.path).decode(), pkgutil.get_data("{library}", "__init__.py").decode(),
    importlib.resources.files("{library}").joinpath("__init__.py").read_text(), hasattr(loader, "no_such"),
]
import pettingzoo, gymnasium
print(json.dumps([seen, "Pearl/Taxi-v0" in gymnasium.registry, "pearl/Taxi-v0" in pettingzoo.aec_registry]))
"""
    (source, is_package, file, *same, missing), *registered = told(script)
    assert (is_package, missing) == (True, False)
    assert registered == [True, True]
    text = Path(file).read_text()
    assert [source, *same] == [text] * 4


def test_ids_are_known_without_the_specs() -> None:
    script = "import json, sys; from pearl_marl import envs; known = envs.ids()\n"
    known = told(script + "print(json.dumps([known, 'pearl_marl.spec' in sys.modules]))")
    from pearl_marl.envs import get_spec

    assert known[1] is False
    assert known[0] == {get_spec(name).name: get_spec(name).id for name in known[0]}


@pytest.mark.parametrize("name", HEAVY)
def test_nothing_heavy(imported: Any, name: str) -> None:
    assert name not in imported["modules"]


def test_nothing_is_compiled(imported: Any) -> None:
    assert imported["compiled"] == 0


def test_environments_are_found(imported: Any) -> None:
    assert "CliffWalking" in imported["envs"]


def test_the_old_name_of_the_list_warns() -> None:
    import pearl_marl

    with pytest.warns(DeprecationWarning, match=r"pearl_marl\.list_envs\(\)"):
        assert pearl_marl.envs() == pearl_marl.list_envs()  # type: ignore[operator]


def test_public_names() -> None:
    import pearl_marl

    for name in pearl_marl.__all__:
        assert hasattr(pearl_marl, name)


COMMAND = """
import atexit, json, sys
from pearl_marl.__main__ import main
sys.argv = ["pearl", *{arguments!r}]
atexit.register(lambda: print(json.dumps(list(sys.modules)), file=sys.stderr))
main()
"""


def imported_by(*arguments: str) -> tuple[int, set[str]]:
    """Return the exit status of a command in a process of its own, and what it imported."""
    script = COMMAND.format(arguments=arguments)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd="/")
    return done.returncode, set(json.loads(done.stderr.splitlines()[-1]))


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        (["--help"], 0),
        (["--version"], 0),
        ([], 2),
        (["no-command"], 2),
        (["train", "--help"], 0),
        (["train", "CartPole", "--no-option"], 2),
        (["train"], 2),
    ],
)
def test_what_needs_no_library_imports_none(arguments: list[str], status: int) -> None:
    done, modules = imported_by(*arguments)
    assert done == status
    assert not modules & {*HEAVY, *LIBRARIES} - {"typer"}


TRAINING = ["train", "CartPole", "--n-agents", "8", "--iterations", "1", "--set", "minibatch=64"]


def test_training_imports_what_it_uses(tmp_path: Path) -> None:
    """PyTorch would import its compiler and SymPy for an optimiser and a backward pass."""
    pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
    status, modules = imported_by(*TRAINING, "--out", str(tmp_path / "run"))
    assert status == 0
    assert not modules & {"torch._dynamo", "torch._inductor", "matplotlib.pyplot", "ray", "pygame"}
    assert (tmp_path / "run" / "learning_curve.png").exists()


@pytest.mark.parametrize(
    ("former", "present", "name"),
    [
        ("plan", "latency.planning", "plan"),
        ("reals", "golden.reals", "Real"),
        ("rng", "golden.rng", "draws"),
    ],
)
def test_former_places_of_modules(former: str, present: str, name: str) -> None:
    sys.modules.pop(f"pearl_marl.{former}", None)
    with pytest.warns(DeprecationWarning, match=f"pearl_marl.{former} is deprecated: use pearl_marl."):
        module = importlib.import_module(f"pearl_marl.{former}")
    assert getattr(module, name) is getattr(importlib.import_module(f"pearl_marl.{present}"), name)


FIRST_STEP = """
import json, sys, pearl_marl
env = pearl_marl.make_vec("CliffWalking", num_envs=4)
env.reset()
env.step(env.action_space.sample())
print(json.dumps(list(sys.modules)))
"""


def test_kernels_that_are_kept_load_nothing_of_the_compiler() -> None:
    """What Numba compiles with takes longer to import than all else before the first step."""
    told(FIRST_STEP)  # compiles them where they are not kept yet
    modules = set(told(FIRST_STEP))
    assert "numba.core.compiler" in modules
    assert not modules & {"numba.np.linalg", "numba.typed.dictimpl", "scipy.linalg"}
