"""Ray: finding a cluster, placing actors in it by what they need, and telling one that is lost.

An actor is an object of a plain class in a process of its own, on whichever machine has what it needs. Where
:func:`get` raises one of :func:`lost`, the actor or its machine is gone; what the actor's own code raised on
purpose, a :class:`~pearl_marl.errors.PearlError`, arrives as itself.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import platform
import socket
from collections.abc import Mapping
from typing import Any

from pearl_marl.base import version
from pearl_marl.errors import ArgumentError, DeviceError, PearlError

START_SECONDS = 120.0
"""How long an actor may take to start: most of it may be waiting for others to end, or for a machine."""

ANSWER_SECONDS = 5.0
"""How long a cluster's address may take to answer at all."""

_OPTIONS = {"CPU": "num_cpus", "GPU": "num_gpus", "memory": "memory"}


def ray_module() -> Any:
    """Return the module ``ray``, or raise DeviceError where it is not installed."""
    try:
        return importlib.import_module("ray")
    except ModuleNotFoundError as error:
        raise DeviceError(
            f"Ray is not installed, as {error.name!r} is missing; pip install '.[ray]'"
        ) from error


def connect() -> Any:
    """Return the module ``ray``, connected to a cluster; raise DeviceError where that cannot be.

    That is the one this process is connected to already, or the one that ``RAY_ADDRESS`` names, or a new
    one on this machine, which ends with this process.
    """
    ray = ray_module()
    if ray.is_initialized():
        return ray
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    address = os.environ.get("RAY_ADDRESS")
    if not address:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        try:
            ray.init(address="local", include_dashboard=False, **quiet)
        except Exception as error:  # Ray has no class of its own for it
            raise DeviceError(
                f"Ray could not start on this machine: {error}; where the machine was busy, try again"
            ) from error
        return ray
    check_address(address)
    try:
        ray.init(address=address, **quiet)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise DeviceError(
            f"the Ray cluster at RAY_ADDRESS={address} cannot be joined: {error}; start one with `ray start "
            "--head`, or unset RAY_ADDRESS for one on this machine alone"
        ) from error
    return ray


def check_address(address: str) -> None:
    """Raise DeviceError where nothing answers at a cluster's address; Ray itself would try for minutes."""
    host, colon, port = address.rpartition("://")[2].rpartition(":")
    if not colon or not port.isdecimal():  # "auto", or what Ray knows better
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), ANSWER_SECONDS).close()
    except OSError as error:
        raise DeviceError(
            f"no Ray cluster answers at RAY_ADDRESS={address}: {error.strerror or error}; start one with "
            "`ray start --head`, or unset RAY_ADDRESS for one on this machine alone"
        ) from None


def start_actor(cls: type, resources: Mapping[str, float] | None) -> Any:
    """Start an actor where its resources are, and return its handle once it is ready.

    Without resources it takes none, not even a core: any number of them fits on any machine. Ray spreads
    them over the machines.

    Parameters
    ----------
    cls
        A plain class, whose constructor takes nothing.
    resources
        What it holds while it lives, by Ray's names: ``{"CPU": 2}``, ``{"GPU": 1}``, ``{"fpga": 1}``.

    Raises
    ------
    DeviceError
        No machine of the cluster has these resources, or none has them free in time; or the actor's machine
        runs another version of this package.
    lost()
        It ended while it started.
    """
    resources = checked_resources(resources)
    ray = connect()
    _check_available(ray, resources)
    options: dict[str, Any] = {"num_cpus": 0, "resources": {}, "scheduling_strategy": "SPREAD"}
    for name, amount in resources.items():
        if name in _OPTIONS:
            options[_OPTIONS[name]] = amount
        else:
            options["resources"][name] = amount
    actor = ray.remote(cls).options(**options).remote()

    def facts(_: object) -> tuple[str, str, str]:  # inside, so that it travels as code, not as a name
        import platform

        from pearl_marl.base import version

        return platform.node(), version.__version__, platform.python_version()

    try:
        machine, theirs, python = get(actor.__ray_call__.remote(facts), START_SECONDS)
        if theirs != version.__version__:
            raise DeviceError(
                f"{machine} runs version {theirs} of pearl-marl (Python {python}), this process "
                f"{version.__version__} (Python {platform.python_version()}): install the same on every "
                "machine of the cluster"
            )
    except ray.exceptions.GetTimeoutError:
        kill(actor)
        raise DeviceError(
            f"no actor with the resources {resources} started within {START_SECONDS:g} seconds: the cluster "
            f"has {_listed(ray.cluster_resources())}, of which {_listed(ray.available_resources())} are "
            "free; ask for less, or end what holds them"
        ) from None
    except BaseException:
        kill(actor)
        raise
    return actor


def get(references: Any, timeout: float | None = None) -> Any:
    """Wait for what calls of actors return; ``references`` are what ``actor.method.remote(...)`` returned.

    A PearlError arrives as it was raised. After ``timeout`` seconds Ray's ``GetTimeoutError`` is raised.
    """
    ray = ray_module()
    try:
        return ray.get(references, timeout=timeout)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, PearlError):
            raise error.cause from None
        raise


def lost() -> tuple[type[BaseException], ...]:
    """Return the exceptions that mean: the actor, its machine, or the connection to it is gone."""
    errors = ray_module().exceptions
    return (
        errors.RayActorError,
        errors.WorkerCrashedError,
        errors.NodeDiedError,
        errors.LocalRayletDiedError,
        errors.ObjectLostError,
        errors.OutOfMemoryError,  # Ray's own, with which it ends the process that takes the most
    )


def kill(actor: Any) -> None:
    """End an actor at once, whatever it is doing, if it is there; frees what it holds."""
    ray = ray_module()
    if ray.is_initialized():  # or Ray would begin a cluster to end it in
        with contextlib.suppress(Exception):  # it is of another cluster
            ray.kill(actor)


def checked_resources(resources: Mapping[str, float] | None) -> dict[str, float]:
    """Return resources by name as Ray takes them, ``{}`` for ``None``; refuse what is none."""
    if resources is None:
        return {}
    if not isinstance(resources, Mapping) or not all(
        isinstance(name, str) and name and isinstance(amount, (int, float)) and amount > 0
        for name, amount in resources.items()
    ):
        raise ArgumentError(
            f"resources are {resources!r}; they must be positive numbers by name: {{'GPU': 1}}"
        )
    return dict(resources)


def _check_available(ray: Any, resources: Mapping[str, float]) -> None:
    """Refuse what no machine has at all: Ray would wait for one forever."""
    machines = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    if any(all(has.get(name, 0) >= amount for name, amount in resources.items()) for has in machines):
        return
    name = next((n for n, amount in resources.items() if all(m.get(n, 0) < amount for m in machines)), None)
    lacking = f"has the resource {name!r}: {resources[name]:g}" if name else f"has all of {dict(resources)}"
    if name is None or name in _OPTIONS:
        mend = "`ray start --address=HEAD`, which finds CPUs and GPUs by itself"
    else:
        mend = f"`ray start --address=HEAD --resources='{{\"{name}\": {resources[name]:g}}}'`"
    raise DeviceError(
        f"no machine of the Ray cluster {lacking}; there is {'; '.join(map(_listed, machines)) or 'none'}. "
        f"Start Ray on the machine that has it: {mend} (--head for the first one), and set RAY_ADDRESS"
    )


def _listed(resources: Mapping[str, float]) -> str:
    """Return resources as people name them, without what Ray keeps for itself."""
    known = {n: v for n, v in resources.items() if ":" not in n and "memory" not in n}
    return ", ".join(f"{name}: {value:g}" for name, value in sorted(known.items())) or "nothing"
