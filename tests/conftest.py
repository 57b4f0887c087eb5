"""Slow tests, and the toy environments."""

from __future__ import annotations

import fcntl
import gc
import importlib.util
import os
import shutil
import signal
import sys
from collections.abc import Callable, Container, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

# Rendering needs no screen in a test; SDL reads this when pygame starts it.
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
# Without a GPU, numba's simulator stands in for one. Numba reads this when numba.cuda is imported, here and
# in the processes that tests start.
os.environ.setdefault("NUMBA_ENABLE_CUDASIM", "0" if os.path.exists("/dev/nvidiactl") else "1")
# Processes of tests share the cores. PyTorch with as many threads as cores in each of them is slower than
# with one, and on a busy machine many times.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Ray gives way to all other processes in what its actors do, and on a busy machine they never get to it.
os.environ.setdefault("RAY_worker_niceness", "0")
# Simulated devices take longer to compile than a test takes to step them.
os.environ.setdefault("PEARL_LIGHT_SIMULATION", "1")

import pearl_marl
from pearl_marl import cli, envs

from . import sampling
from .toy import TOYS
from .toy_fields import FIELDS
from .toy_memory import POSITIONS
from .toy_world import WORLDS

HAS_HYPOTHESIS = importlib.util.find_spec("hypothesis") is not None
"""The environments of single libraries have it not."""

if HAS_HYPOTHESIS:
    from hypothesis import HealthCheck, settings

    # How long an example takes depends on what else the machine does. `make test` always has the same ones.
    slow = [HealthCheck.too_slow]
    settings.register_profile("tests", deadline=None, suppress_health_check=slow, derandomize=True)
    settings.register_profile("exhaustive", deadline=None, suppress_health_check=slow)


def pytest_configure(config: pytest.Config) -> None:
    # Ten thousand tests and what they import are kept to the end: to look for garbage among them at the usual
    # pace takes a third of the time in which they are collected.
    gc.set_threshold(50_000, 20, 50)
    sampling.exhaustive = config.getoption("--exhaustive")
    if HAS_HYPOTHESIS:  # before tests are imported, whose settings begin with the profile's
        settings.load_profile("exhaustive" if sampling.exhaustive else "tests")
    config.addinivalue_line("markers", "slow: takes seconds or gigabytes; runs where --slow is given")
    exhaustive = "exhaustive: at more sizes, for longer or by Yosys; runs where --exhaustive is given"
    config.addinivalue_line("markers", exhaustive)
    config.addinivalue_line("markers", "gpu: needs an NVIDIA GPU; skipped, and said so, where there is none")
    config.addinivalue_line("markers", "simulatable: the same, but runs where --simulated-gpu is given too")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the tests marked slow too")
    parser.addoption("--exhaustive", action="store_true", help="run the tests marked exhaustive too")
    help = "run the contract over every environment on a simulated GPU too, which takes 20 minutes of a core"
    parser.addoption("--simulated-gpu", action="store_true", help=help)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    from .scheduling import Scheduling

    return Scheduling(config, log)


def left_out(config: pytest.Config, marks: Container[str]) -> bool:
    """Return whether this run does without tests that have such marks: thousands, which are not collected."""
    return ("exhaustive" in marks and not config.getoption("--exhaustive")) or (
        "simulatable" in marks
        and os.environ["NUMBA_ENABLE_CUDASIM"] == "1"
        and not config.getoption("--simulated-gpu")
    )


def pytest_pycollect_makeitem(collector: pytest.Collector, obj: object) -> list[pytest.Item] | None:
    """Collect nothing of a class that is left out."""
    if not isinstance(obj, type):
        return None
    marks = [mark.name for mark in getattr(obj, "pytestmark", ())]
    return [] if left_out(collector.config, marks) else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    chosen = [item for item in items if not left_out(config, item.keywords)]
    config.hook.pytest_deselected(items=[item for item in items if left_out(config, item.keywords)])
    items[:] = chosen
    gc.freeze()
    if hasattr(config, "workerinput"):
        from .scheduling import group, urgency

        items.sort(key=lambda item: urgency(group(item.nodeid)))
    if os.environ["NUMBA_ENABLE_CUDASIM"] == "1":
        for item in items:
            if "gpu" in item.keywords:
                item.add_marker(pytest.mark.skip(reason="no GPU here: not run on a real one, only simulated"))
    for item in [] if config.getoption("--slow") else items:
        if "slow" in item.keywords:
            item.add_marker(pytest.mark.skip(reason="slow: run pytest --slow"))


Once = Callable[[str, Callable[[Path], object]], Path]


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Once:
    """Return a function that has a folder made once a run, by the process of xdist that asks first."""
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent

    def once(name: str, make: Callable[[Path], object]) -> Path:
        folder, made = shared / f"once-{name}", shared / f"once-{name}.made"
        with (shared / f"once-{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not made.exists():
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
                make(folder)
                made.touch()
        return folder

    return once


@pytest.fixture
def ray_cluster(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have this process in a Ray cluster with one board, which takes seconds to begin."""
    ray = importlib.import_module("ray")
    if ray.is_initialized():
        if ray.get_runtime_context().namespace == OF_THE_TESTS:
            return
        ray.shutdown()
    # Else its workers look for modules where this process stood when Ray began: in a folder of the docs'. By
    # a runtime environment each of them would take a second longer to begin.
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))
    ray.init(
        address="local",  # or it would join the cluster of another test that runs beside
        num_cpus=1,
        resources={"fpga": 1},
        namespace=OF_THE_TESTS,
        object_store_memory=100_000_000,
        include_dashboard=False,
        log_to_driver=False,
        logging_level="ERROR",
    )


OF_THE_TESTS = "of_the_tests"
"""The namespace by which a process knows the tests' cluster."""


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """End the cluster after the last test that is in it: a tenth of a core goes to it even if it idles."""
    ours, next_ones = (getattr(each, "fixturenames", ()) for each in (item, nextitem))
    if "ray_cluster" in ours and "ray_cluster" not in next_ones:
        importlib.import_module("ray").shutdown()


@pytest.fixture
def toys() -> Iterator[None]:
    """Register the toy environments for one test; the list of environments is as before afterwards."""
    with mock.patch.dict(envs._specs):
        for spec in (*TOYS, *WORLDS, *FIELDS, POSITIONS):
            pearl_marl.register(spec)
        yield


@pytest.fixture
def pearl(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Call the command line in this process; return its exit status, standard output and error."""

    def call(*arguments: Any) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["pearl", *map(str, arguments)])
        monkeypatch.setenv("COLUMNS", "200")
        with pytest.raises(SystemExit) as exit_:
            cli.main()
        captured = capsys.readouterr()
        return int(exit_.value.code or 0), captured.out, captured.err

    return call


@pytest.fixture
def one_thread() -> Iterator[None]:
    """Sums of several threads may differ from run to run, and with them what is learned."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """Ctrl-C as a program has it: a test runner, or a shell that starts one, may have set another handler."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
