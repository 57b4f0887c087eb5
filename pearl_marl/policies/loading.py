"""Policies to evaluate, from what people have: a table, a saved model, a function.

A policy is a function from a batch of observations to a batch of actions, in the form in which
:meth:`pearl_marl.devices.Device.step` returns the ones and takes the others.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import traceback
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Discrete, MultiBinary, MultiDiscrete, Tuple

from pearl_marl.base.arrays import Array, load_array
from pearl_marl.base.files import check_uncompressed
from pearl_marl.batch.actions import random_actions
from pearl_marl.errors import ArgumentError, one_line
from pearl_marl.golden.rng import checked_seed
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.spec import EnvSpec, check_spec
from pearl_marl.spec.elements import are_numbers, bounds

Policy = Callable[..., Any]
"""Observations, shape ``(n, *observation_shape)``, in; actions, shape ``(n, *action_space.shape)``, out.

Where the environment has masks, they are a second argument, shape ``(n, n_actions)``. A policy with memory
also has a method ``forget``: see :func:`forget`.
"""

RANDOM = "random"


def load_policy(name: str, spec: EnvSpec, seed: int = 0) -> Policy | DevicePolicy:
    """Return the policy of that name.

    Parameters
    ----------
    name
        ``"random"``: uniform actions, of those that masks allow. ``FILE.npy`` or ``FILE.npz`` (its array
        ``q``): a table of action values, of shape ``(*observations, actions)``; the greedy policy.
        ``FILE.zip``: a model of Stable-Baselines3, without exploration. A folder of ``pearl train``, or its
        ``policy.safetensors``: what was learned. A file of ``pearl quantize``: a policy in integers.
        ``MODULE:NAME`` or ``FILE.py:NAME``: a function, or a policy that runs beside the environments.
    spec
        The environment it is for.
    seed
        Of random actions, where a policy has any.

    Raises
    ------
    ArgumentError
        There is no such policy, or it is not one for this environment.
    """
    check_spec(spec)
    if not isinstance(name, str):
        raise ArgumentError(f"policy is {name!r}; it must be its name, such as {RANDOM!r} or a file's")
    if name == RANDOM:
        return random_policy(spec, seed)
    path = Path(name)
    if name and path.is_dir():
        path /= "policy.safetensors"
    for suffixes, load in _LOADERS.items():
        if path.suffix in suffixes:
            if not path.is_file():
                raise ArgumentError(f"there is no file {path}")
            return load(path, spec, seed)
    module, colon, function = name.rpartition(":")
    if colon and module and function.isidentifier():
        return _function(module, function)
    if difflib.get_close_matches(name.lower(), (RANDOM,)):
        raise ArgumentError(f"{name!r} names no policy; did you mean {RANDOM!r}?")
    raise ArgumentError(
        f"there is no policy {name!r}; possible are {RANDOM!r}, a table of action values (FILE.npy, "
        "FILE.npz), a model of Stable-Baselines3 (FILE.zip), a folder of `pearl train`, and a function "
        "(MODULE:FUNCTION, FILE.py:FUNCTION)"
    )


def forget(policy: Policy | DevicePolicy, ended: Array | None = None) -> None:
    """Have a policy with memory forget agents: those whose flag, shape ``(n,)``, says so, or all."""
    if (method := getattr(policy, "forget", None)) is not None:
        method(*(() if ended is None else (ended,)))


def random_policy(spec: EnvSpec, seed: int = 0) -> Policy:
    """Return the policy that chooses uniformly, of the actions that masks allow."""
    rng = np.random.default_rng(checked_seed(seed))
    return lambda observations, masks=None: random_actions(spec, rng, len(observations), masks)


def table_policy(table: npt.ArrayLike, spec: EnvSpec) -> Policy:
    """Return the greedy policy of a table of action values, the first of equal actions.

    Parameters
    ----------
    table
        Numbers of shape ``(*observations, actions)``: an axis for each number of an observation.
    spec
        The environment it is for.

    Raises
    ------
    ArgumentError
        The shape is another, or there is no number somewhere.
    """
    check_spec(spec)
    try:
        values = np.asarray(table)
    except ValueError:  # a ragged list
        values = np.asarray(None)
    _check_table(spec, values.shape, values.dtype)
    if (missing := np.isnan(values)).any():
        place = tuple(int(index) for index in np.argwhere(missing)[0])
        raise ArgumentError(f"the table has NaN, {missing.sum():,} times, first at {place}; it takes numbers")
    greedy = values.argmax(axis=-1).astype(spec.action_dtype)
    if spec.observation_shape:
        return lambda observations, _=None: greedy[tuple(observations.T)]
    return lambda observations, _=None: greedy[observations]


def _check_table(spec: EnvSpec, given: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Refuse a table of another shape than an environment's, or not of numbers."""
    space = spec.observation_space
    if not are_numbers(space) or not isinstance(spec.action_space, Discrete):
        raise ArgumentError(
            f"a table is for discrete observations and actions; {spec.name} has {space} and "
            f"{spec.action_space}"
        )
    low, high = bounds(space)
    shape = (*(high - low + 1).ravel().tolist(), int(spec.action_space.n))
    if given != shape or dtype.kind not in "iuf":
        raise ArgumentError(
            f"the table has shape {given} and dtype {dtype}; {spec.name} takes numbers of shape {shape}"
        )


def _table(path: Path, spec: EnvSpec, _: int) -> Policy:
    def named(call: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return call(*arguments)
        except ArgumentError as error:
            raise ArgumentError(f"{path}: {error}") from None

    table = load_array(path, "table", lambda *found: named(_check_table, spec, *found), "q")
    policy: Policy = named(table_policy, table, spec)
    return policy


def _function(module: str, name: str) -> Policy | DevicePolicy:
    path = Path(module)
    try:
        if path.suffix == ".py":
            spec = importlib.util.spec_from_file_location(path.stem, path)
            assert spec is not None
            assert spec.loader is not None
            found = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(found)
        else:
            found = importlib.import_module(module)
    except (Exception, SystemExit) as error:
        raise ArgumentError(
            f"the module of the policy, {module}, cannot be imported: {_what_happened(error)}"
        ) from error
    policy = getattr(found, name, None)
    if isinstance(policy, DevicePolicy):
        return policy
    if not callable(policy):
        raise ArgumentError(f"{module} has no function or policy {name!r}")

    def guarded(call: Callable[..., Any]) -> Any:
        def called(*arguments: Array) -> Any:
            try:
                return call(*arguments)
            except (Exception, SystemExit) as error:
                raise ArgumentError(f"the policy {module}:{name} failed: {_what_happened(error)}") from error

        return called

    function = guarded(policy)
    if callable(method := getattr(policy, "forget", None)):
        function.forget = guarded(method)
    return function  # type: ignore[no-any-return]


def _what_happened(error: BaseException) -> str:
    """Return what an exception of a user's code says, and the line that it is from."""
    if isinstance(error, (ImportError, OSError)):
        return str(error)
    if isinstance(error, SyntaxError):
        return f"{Path(error.filename or '').name}, line {error.lineno}: {error.msg}"
    last = traceback.extract_tb(error.__traceback__)[-1]
    where = "" if last.filename == __file__ else f"{Path(last.filename).name}, line {last.lineno}: "
    return f"{where}{type(error).__name__}: {error}"


def _stable_baselines3(path: Path, spec: EnvSpec, _: int) -> Policy:
    try:
        import stable_baselines3 as sb3
        from stable_baselines3.common.save_util import load_from_zip_file
    except ImportError:
        raise ArgumentError(f"{path} takes stable-baselines3: pip install '.[train]'") from None
    try:
        with zipfile.ZipFile(path) as archive:
            check_uncompressed(archive, path.stat().st_size)
        data = load_from_zip_file(path, device="cpu")[0] or {}
        kind = data["policy_class"].__module__.split(".")[1]
        # A model does not say by which algorithm it was made; two have the same policy.
        by_policy: dict[str, Any] = {"dqn": sb3.DQN, "sac": sb3.SAC, "td3": sb3.TD3}
        algorithm = by_policy.get(kind, sb3.PPO if "clip_range" in data else sb3.A2C)
        model = algorithm.load(path, device="cpu")
    except (KeyError, AttributeError, IndexError):
        raise ArgumentError(f"{path} is no model of stable-baselines3: it does not say its policy") from None
    except MemoryError:
        raise
    except Exception as error:  # it may hold any objects of Python, and damaged ones
        why = one_line(error) or type(error).__name__
        raise ArgumentError(f"{path} is no model of stable-baselines3: {why}") from error
    observations: Any = spec.observation_space
    if isinstance(observations, Tuple):  # as wrappers.sb3_vec_env shows it
        observations = MultiDiscrete([part.n for part in observations.spaces])  # type: ignore[attr-defined]
    _check_space(path, "observations", model.observation_space, observations)
    _check_space(path, "actions", model.action_space, spec.action_space)
    flags = isinstance(spec.action_space, MultiBinary)  # which it gives as floats

    def predicted(observations: Array, _: Any = None) -> Any:
        actions = model.predict(observations, deterministic=True)[0]
        return actions.astype(spec.action_space.dtype) if flags else actions

    return predicted


def _check_space(path: Path, what: str, theirs: Any, ours: Any) -> None:
    if theirs != ours:
        raise ArgumentError(f"{path} was trained on {what} in {theirs}; here they are in {ours}")


def _trained(path: Path, spec: EnvSpec, seed: int) -> Policy | DevicePolicy:
    found: Any
    try:
        from pearl_marl.policies import integer_file, policy_file, trained  # which take torch

        about, _ = policy_file.read(path)
        in_integers = isinstance(about, dict) and about.get("kind") == integer_file.KIND
        found = integer_file.load_policy(path) if in_integers else trained.load(path)
    except ModuleNotFoundError as error:
        raise ArgumentError(f"{path} takes {error.name}: pip install '.[train]'") from None
    _check_space(path, "observations", found.spec.observation_space, spec.observation_space)
    _check_space(path, "actions", found.spec.action_space, spec.action_space)
    if isinstance(found, DevicePolicy):
        return found
    found.seed(seed)
    function: Policy = found.function
    return function


_LOADERS: dict[tuple[str, ...], Callable[[Path, EnvSpec, int], Policy | DevicePolicy]] = {
    (".npy", ".npz"): _table,
    (".safetensors",): _trained,
    (".zip",): _stable_baselines3,
}
