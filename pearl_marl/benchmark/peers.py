"""Other libraries that step environments: EnvPool, Gymnasium's vector environments, packages of games."""

from __future__ import annotations

import importlib
import io
import random
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from pearl_marl.batch.actions import random_actions, random_allowed
from pearl_marl.benchmark.measure import Contender, Game, Step, UnavailableError
from pearl_marl.benchmark.tables import ENVPOOL
from pearl_marl.spec import EnvSpec, Peer

GYMNASIUM_SYNC_LIMIT = 1024
"""More sub-environments of pure Python cost memory and change nothing about their rate."""

GYMNASIUM_ASYNC_LIMIT = 16
"""A process for each: with more, the machine runs out of cores."""

_ENVPOOL, ASYNCHRONOUS = "EnvPool", "Gymnasium AsyncVectorEnv"
_ONE_BY_ONE = "observations, rewards, ends; Python, one thread"
_ONE_PLAYER = "observation, mask, reward, end of one player; no wrappers that check; Python, one thread"


def peers(spec: EnvSpec, n: int) -> list[Contender]:
    """Return the peers; one that lacks the environment raises :class:`UnavailableError` when it is made."""
    sync, asynchronous = min(n, GYMNASIUM_SYNC_LIMIT), min(n, GYMNASIUM_ASYNC_LIMIT)
    arrays = "all result arrays"
    processes, own = (partial(_vectorised, mode=mode) for mode in ("async", "vector_entry_point"))
    texts = [f"{arrays}; all cores", "the mask of the player on turn"][: 1 + spec.turns]
    of_envpool = _of_envpool(spec)
    agents = of_envpool.agents or spec.agents
    counts = "; ".join([*texts, *filter(None, [of_envpool.differs])])
    rows: list[tuple[str, str, int, Callable[[EnvSpec, int], Step | Game]]] = [
        (ENVPOOL, counts, max(n // agents, 1) * agents, _envpool)
    ]
    few = max(sync // spec.agents, 1) * spec.agents
    for library in spec.peers:
        if library in AT_ONCE:
            peer = peer_of(spec, library)
            given = {*(peer.options or ()), *peer.parameters}
            by_default = library in IDS and not given.issuperset(spec.options)
            text = f"{arrays}{', default options' if by_default else ''}; JAX, compiled, on all cores"
            rows.append((library, text, n, AT_ONCE[library]))
        elif library != _ENVPOOL:
            text = _ONE_PLAYER if spec.turns else _ONE_BY_ONE
            rows.append((library, text, few, partial(_in_python, library)))
    if spec.agents == 1:
        rows += [
            ("Gymnasium SyncVectorEnv", f"{arrays}; one thread", sync, partial(_vectorised, mode="sync")),
            (ASYNCHRONOUS, f"{arrays}; a process a slot", asynchronous, processes),
            ("Gymnasium's own vectorisation", f"{arrays}; NumPy, one thread", n, own),
            ("MinAtar", _ONE_BY_ONE, sync, _minatar),
        ]
    return [Contender(name, counts, count, partial(make, spec, count)) for name, counts, count, make in rows]


def peer_of(spec: EnvSpec, library: str) -> Peer:
    """Return what a library calls an environment.

    Raises
    ------
    UnavailableError
        The spec names none.
    """
    peer = spec.peers.get(library)
    if peer is None:
        raise UnavailableError(f"{library} has no {spec.name}")
    return Peer(peer) if isinstance(peer, str) else peer


@contextmanager
def installed(package: str | None = None) -> Iterator[None]:
    """Import what a package has; without it, or what else is missing, the contender is unavailable."""
    try:
        yield
    except ImportError as error:
        missing = str(error.name).partition(".")[0]
        text = f"pip install {package or missing}"
        if package is not None and package != missing:
            text += f" ({missing} is missing)"
        raise UnavailableError(f"not installed: {text}") from None


@contextmanager
def quiet_spaces() -> Iterator[None]:
    """Keep Gymnasium quiet while EnvPool makes its spaces: it warns of float64 limits in float32 boxes."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*precision lowered by casting")
        yield


@contextmanager
def silence() -> Iterator[None]:
    """Swallow what an import prints; JaxMARL's puts Python's own output back and prints to that."""
    sink, own = io.StringIO(), sys.__stdout__
    with redirect_stdout(sink):
        sys.__stdout__ = sink  # type: ignore[misc,assignment]
        try:
            yield
        finally:
            sys.__stdout__ = own  # type: ignore[misc]


def _actions(spec: EnvSpec, count: int, dtype: Any) -> npt.NDArray[Any]:
    return random_actions(spec, np.random.default_rng(0), count).astype(dtype)


def _as_taken(peer: Peer, spec: EnvSpec, actions: npt.NDArray[Any]) -> Any:
    """Return actions as a library takes them."""
    return actions if peer.actions is None else peer.actions(spec, actions)


def _required(spec: EnvSpec, package: str) -> str:
    """Return the name under which Gymnasium has the environment."""
    if spec.oracle is None:
        raise UnavailableError(f"{package} has no {spec.name}")
    return spec.oracle


def _of_envpool(spec: EnvSpec) -> Peer:
    """Return what EnvPool calls an environment: by default what Gymnasium does, or nothing."""
    return peer_of(spec, _ENVPOOL) if _ENVPOOL in spec.peers else Peer(spec.oracle or "")


def envpool_of(spec: EnvSpec, n: int, seed: int = 42) -> Any:
    """Return EnvPool's environments, for ``n`` agents; they are not reset yet.

    Raises
    ------
    UnavailableError
        EnvPool is not installed, or has no such environment.
    """
    with installed("'.[bench]'"):
        import envpool
    peer = _of_envpool(spec)
    if not peer.make:
        raise UnavailableError(f"EnvPool has no {spec.name}")
    name = str(peer.make)
    options = dict(spec.options)
    known = envpool.list_all_envs()
    if name not in known:  # it may have another version of it
        family = name.rpartition("-v")[0]
        name = max((other for other in known if other.rpartition("-v")[0] == family), default="")
    if not name:
        raise UnavailableError(f"EnvPool {metadata.version('envpool')} has no {family.rpartition('/')[2]}")
    if spec.configure is not None and options != spec.configure().options:
        raise UnavailableError(f"measured with default options only, not {options}")
    return envpool.make(name, env_type="gymnasium", num_envs=n // (peer.agents or spec.agents), seed=seed)


def _envpool(spec: EnvSpec, n: int) -> Step | Game:
    envs = envpool_of(spec, n)
    with quiet_spaces():
        obs, infos = envs.reset()
        if spec.agents > 1:
            return _envpool_worlds(envs, obs, infos)
        actions = _actions(spec, n, envs.action_space.dtype)
    taken = _as_taken(_of_envpool(spec), spec, actions)
    return lambda: envs.step(taken)


def _envpool_worlds(envs: Any, obs: Any, infos: Any) -> Game:
    """Return a step of EnvPool's games: one action in each game of turns, else one for each player."""
    rng, dtype = np.random.default_rng(0), envs.action_space.dtype
    last = [obs, infos]

    def choose() -> tuple[npt.NDArray[Any], Any]:
        obs, infos = last
        turns = "legal_action_mask" in infos
        masks = infos["legal_action_mask"] if turns else obs["action_mask"]
        rows = masks.reshape(-1, masks.shape[-1]).view(np.int8)
        actions = random_allowed(rows, rng.integers(1 << 32, size=len(rows), dtype=np.uint32), dtype)
        # Games may come back in any order.
        return actions.reshape(masks.shape[:-1]), infos["env_id"]

    def step(chosen: tuple[npt.NDArray[Any], Any]) -> None:
        last[0], *_, last[1] = envs.step(*chosen)

    return Game(choose, step)


def _made(spec: EnvSpec, library: str) -> Any:
    """Return one environment of a library."""
    peer = peer_of(spec, library)
    if not isinstance(peer.make, str):
        return peer.make(spec)
    module, _, name = peer.make.partition(":")
    taken = spec.options if peer.options is None else peer.options
    return getattr(importlib.import_module(module), name)(**{key: spec.options[key] for key in taken})


def _in_python(library: str, spec: EnvSpec, count: int) -> Step | Game:
    with installed(library), silence():
        worlds = [_made(spec, library) for _ in range(count // spec.agents)]
    of_dm_env, by_agent = (hasattr(worlds[0], name) for name in ("action_spec", "possible_agents"))
    for i, world in enumerate(worlds):
        world.reset(**{} if of_dm_env else {"seed": i})
    if spec.turns:
        return _turn_by_turn(worlds)
    peer = peer_of(spec, library)
    step = partial(_step_endless if of_dm_env else _step_by_agent if by_agent else _one_by_one, worlds)
    if (choose := peer.choose) is not None:
        chance = random.Random(0)
        return Game(lambda: [choose(world, chance) for world in worlds], step)
    actions = _as_taken(peer, spec, random_actions(spec, np.random.default_rng(0), count))
    if peer.actions is None and spec.agents > 1:
        actions = actions.reshape(len(worlds), spec.agents, *actions.shape[1:])
    if isinstance(actions, np.ndarray) and actions.ndim == 1 + (spec.agents > 1):
        actions = actions.tolist()  # games in Python index faster by its own numbers
    if by_agent:
        pairs = zip(worlds, actions, strict=True)
        actions = [dict(zip(world.agents, row, strict=True)) for world, row in pairs]
    return partial(step, actions)


def _one_by_one(worlds: Sequence[Any], actions: Iterable[Any]) -> None:
    """Step each of Gymnasium's environments; those that end begin again."""
    for world, chosen in zip(worlds, actions, strict=True):
        _, _, terminated, truncated, _ = world.step(chosen)
        if terminated or truncated:
            world.reset()


def _step_by_agent(worlds: Sequence[Any], actions: Iterable[Any]) -> None:
    """Step each of PettingZoo's worlds; those that no agent is left in begin again."""
    for world, chosen in zip(worlds, actions, strict=True):
        world.step(chosen)
        if not world.agents:
            world.reset()


def _step_endless(worlds: Sequence[Any], actions: Iterable[Any]) -> None:
    """Step each of dm_env's environments, which begin again by themselves."""
    for world, chosen in zip(worlds, actions, strict=True):
        world.step(chosen)


def _turn_by_turn(games: Sequence[Any]) -> Game:
    """Return a step of PettingZoo's games of turns, which have begun."""
    observed, chance = [game.last()[0] for game in games], random.Random(0)

    def choose() -> list[int]:
        return [chance.choice(np.flatnonzero(obs["action_mask"]).tolist()) for obs in observed]

    def step(actions: Sequence[int]) -> None:
        for i, action in enumerate(actions):
            game = games[i]
            game.step(action)
            observed[i], _, ended, _, _ = game.last()
            if ended:
                game.reset()
                observed[i] = game.last()[0]

    return Game(choose, step)


def _jaxmarl(spec: EnvSpec, count: int) -> Step:
    with installed("JaxMARL"), silence():
        import jax

        game = _made(spec, "JaxMARL")
    worlds = count // spec.agents
    actions = dict(zip(game.agents, _actions(spec, count, np.int32).reshape(worlds, -1).T, strict=True))
    return _compiled(jax, game.reset, game.step, actions, worlds)


def gymnax_of(spec: EnvSpec) -> tuple[Any, Any]:
    """Return gymnax's environment and its parameters.

    Raises
    ------
    UnavailableError
        gymnax is not installed, or has no such environment.
    """
    with installed("gymnax"):
        import gymnax
    peer = peer_of(spec, "gymnax")
    env, params = gymnax.make(peer.make, **{key: spec.options[key] for key in peer.options or ()})
    return env, params.replace(**{key: spec.options[key] for key in peer.parameters})


def _gymnax(spec: EnvSpec, count: int) -> Step:
    env, params = gymnax_of(spec)
    import jax

    reset, step = (partial(call, params=params) for call in (env.reset, env.step))
    return _compiled(jax, reset, step, random_actions(spec, np.random.default_rng(0), count), count)


def _pgx(spec: EnvSpec, count: int) -> Step | Game:
    with installed("pgx"):
        import jax
        import pgx
        from pgx.experimental.wrappers import auto_reset
    game: Any = pgx.make(peer_of(spec, "pgx").make)
    advance, worlds, rng = auto_reset(game.step, game.init), count // spec.agents, np.random.default_rng(0)

    def reset(key: Any) -> Any:
        return None, game.init(key)

    def step(key: Any, state: Any, action: Any) -> Any:
        return None, advance(state, action, key)

    if not spec.turns:
        return _compiled(jax, reset, step, _actions(spec, count, np.int32), worlds)
    last, advanced = _worlds(jax, reset, step, worlds)

    def choose() -> npt.NDArray[Any]:
        masks = np.asarray(last[1].legal_action_mask).view(np.int8)
        return random_allowed(masks, rng.integers(1 << 32, size=worlds, dtype=np.uint32), np.int32)

    return Game(choose, advanced)


def _compiled(jax: Any, reset: Any, step: Any, actions: Any, worlds: int) -> Step:
    """Return the compiled step of many worlds at once, always by the same actions."""
    return partial(_worlds(jax, reset, step, worlds)[1], actions)


def _worlds(jax: Any, reset: Any, step: Any, worlds: int) -> tuple[list[Any], Callable[[Any], None]]:
    """Return key and state of many worlds, and what steps them, by functions of one that take a key first."""
    key, start = jax.random.split(jax.random.PRNGKey(0))
    _, state = jax.vmap(reset)(jax.random.split(start, worlds))

    def advance(key: Any, state: Any, actions: Any) -> Any:
        key, now = jax.random.split(key)
        return key, jax.vmap(step)(jax.random.split(now, worlds), state, actions)

    compiled, last = jax.jit(advance), [key, state]

    def advanced(actions: Any) -> None:
        last[0], results = compiled(*last, actions)
        last[1] = jax.block_until_ready(results)[1]

    return last, advanced


def _jumanji(spec: EnvSpec, count: int) -> Step:
    with installed("jumanji"):
        import jax
        from jumanji.wrappers import VmapAutoResetWrapper

        env: Any = VmapAutoResetWrapper(_made(spec, "jumanji"))
    actions = _as_taken(peer_of(spec, "jumanji"), spec, _actions(spec, count, np.int32))
    last = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), count))
    compiled = jax.jit(env.step)

    def step() -> None:
        nonlocal last
        last = jax.block_until_ready(compiled(last[0], actions))

    return step


AT_ONCE: dict[str, Callable[[EnvSpec, int], Step | Game]] = {
    "gymnax": _gymnax,
    "JaxMARL": _jaxmarl,
    "jumanji": _jumanji,
    "pgx": _pgx,
}
"""Libraries that step all worlds at once. The others step one after the other, so a thousand are enough."""

IDS = {"gymnax", "pgx"}
"""Those of them that make environments by ids, with few of their options."""


def _vectorised(spec: EnvSpec, count: int, mode: str) -> Step:
    name = _required(spec, "Gymnasium")
    module, _, env_id = name.rpartition(":")
    if module:  # registers it
        with installed():
            importlib.import_module(module)
    if mode == "vector_entry_point" and gymnasium.spec(env_id).vector_entry_point is None:
        raise UnavailableError(f"Gymnasium has no vectorised {env_id}")
    envs = gymnasium.make_vec(name, num_envs=count, vectorization_mode=mode, **dict(spec.options))
    envs.reset(seed=0)
    return _Vectorised(envs, _actions(spec, count, envs.single_action_space.dtype))


@dataclass
class _Vectorised:
    """The step of Gymnasium's vector environment; ``close`` ends its processes."""

    envs: Any
    actions: Any

    def __call__(self) -> None:
        self.envs.step(self.actions)

    def close(self) -> None:
        self.envs.close()


def _minatar(spec: EnvSpec, count: int) -> Step:
    name = _required(spec, "MinAtar")
    if "MinAtar/" not in name:
        raise UnavailableError(f"MinAtar has no {spec.name}")
    with installed("minatar"):
        envs: list[Any] = [gymnasium.make(name, **dict(spec.options)).unwrapped for _ in range(count)]
    games = [env.game for env in envs]  # without what Gymnasium adds to a step
    actions = [
        env.action_set[action] for env, action in zip(envs, _actions(spec, count, np.int64), strict=True)
    ]
    for i, game in enumerate(games):
        game.seed(i)

    def step() -> None:
        for game, action in zip(games, actions, strict=True):
            _, ended = game.act(action)
            game.state()
            if ended:
                game.reset()

    return step
