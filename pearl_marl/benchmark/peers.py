"""Other libraries that step environments: EnvPool, Gymnasium's vector environments, packages of games."""

from __future__ import annotations

import copy
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
from pearl_marl.envs.robot_warehouse.spec import SIZES
from pearl_marl.spec import EnvSpec

GYMNASIUM_SYNC_LIMIT = 1024
"""More sub-environments of pure Python cost memory and change nothing about their rate."""

GYMNASIUM_ASYNC_LIMIT = 16
"""A process for each: with more, the machine runs out of cores."""


ENVPOOL_GAMES = {
    "Acrobot": "Acrobot-v1",
    "Catch": "Catch-v0",
    "ConnectFour": "ConnectFour-v1",
    "Game2048": "Jumanji/Game2048-v1",
    "KuhnPoker": "KuhnPoker-v1",
    "LeducPoker": "LeducHoldem-v1",
    "LevelBasedForaging": "LevelBasedForaging-v0",
    "MiniGridDoorKey": "MiniGrid-DoorKey-8x8-v0",
    "MiniGridDynamicObstacles": "MiniGrid-Dynamic-Obstacles-8x8-v0",
    "MiniGridEmpty": "MiniGrid-Empty-8x8-v0",
    "MiniGridFourRooms": "MiniGrid-FourRooms-v0",
    "MiniGridKeyCorridor": "MiniGrid-KeyCorridorS3R1-v0",
    "MiniGridLavaGap": "MiniGrid-LavaGapS7-v0",
    "MiniGridMemory": "MiniGrid-MemoryS13-v0",
    "Minesweeper": "Jumanji/Minesweeper-v0",
    "Othello": "Othello-v1",
    "RobotWarehouse": "RobotWarehouse-v0",
    "Snake": "Jumanji/Snake-v1",
    "TicTacToe": "TicTacToe-v1",
}
"""What EnvPool calls those of its environments whose oracle has another id, or none, by our names."""

PGX_GAMES = {
    "Asterix": "minatar-asterix",
    "Breakout": "minatar-breakout",
    "Freeway": "minatar-freeway",
    "KuhnPoker": "kuhn_poker",
    "LeducPoker": "leduc_holdem",
    "Othello": "othello",
    "Seaquest": "minatar-seaquest",
    "SpaceInvaders": "minatar-space_invaders",
}
"""What pgx calls these games, by our names."""

ENVPOOL_AGENTS = {"RobotWarehouse": 4}
"""How many agents these have, where ours has another number."""

GYMNAX: dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    "Acrobot": ("Acrobot-v1", (), ()),
    "Asterix": ("Asterix-MinAtar", (), ()),
    "Breakout": ("Breakout-MinAtar", (), ()),
    "CartPole": ("CartPole-v1", (), ()),
    "Catch": ("Catch-bsuite", ("rows", "columns"), ()),
    "DeepSea": ("DeepSea-bsuite", ("size",), ("unscaled_move_cost", "randomize_actions")),
    "Freeway": ("Freeway-MinAtar", (), ()),
    "FrozenLake": ("FrozenLake-misc", (), ()),
    "MemoryChain": ("MemoryChain-bsuite", ("num_bits",), ("memory_length",)),
    "MountainCar": ("MountainCar-v0", (), ()),
    "MountainCarContinuous": ("MountainCarContinuous-v0", (), ("goal_velocity",)),
    "Seaquest": ("Seaquest-MinAtar", (), ()),
    "SpaceInvaders": ("SpaceInvaders-MinAtar", (), ()),
}
"""gymnax's names of environments, by ours; then which of our options it takes for one, and as parameters."""

ENVPOOL_SEEDED = (1, 2, 6)
"""The first version of EnvPool whose games of foraging start differently. It takes Python 3.12."""


def peers(spec: EnvSpec, n: int) -> list[Contender]:
    """Return the peers; one that lacks the environment raises :class:`UnavailableError` when it is made."""
    sync, asynchronous = min(n, GYMNASIUM_SYNC_LIMIT), min(n, GYMNASIUM_ASYNC_LIMIT)
    arrays = "all result arrays"
    processes, own = (partial(_vectorised, mode=mode) for mode in ("async", "vector_entry_point"))
    agents = _envpool_agents(spec)
    rows: list[tuple[str, str, int, Callable[[EnvSpec, int], Step | Game]]] = [
        ("EnvPool, sync", f"{arrays}; all cores{_envpool_game(spec)}", max(n // agents, 1) * agents, _envpool)
    ]
    few = max(sync // spec.agents, 1) * spec.agents
    rows += [
        (name, counts, n if name in AT_ONCE else few, make)
        for name, counts, make in PACKAGES.get(spec.name, ())
    ]
    if spec.agents == 1:
        rows += [
            ("Gymnasium SyncVectorEnv", f"{arrays}; one thread", sync, partial(_vectorised, mode="sync")),
            ("Gymnasium AsyncVectorEnv", f"{arrays}; a process a slot", asynchronous, processes),
            ("Gymnasium's own vectorisation", f"{arrays}; NumPy, one thread", n, own),
            ("MinAtar", _ONE_BY_ONE, sync, _minatar),
        ]
    return [Contender(name, counts, count, partial(make, spec, count)) for name, counts, count, make in rows]


@contextmanager
def installed(package: str | None = None) -> Iterator[None]:
    """Import what a package has; without it, or what else is missing, the contender is unavailable."""
    try:
        yield
    except ImportError as error:
        raise UnavailableError(f"not installed: pip install {package or error.name}") from None


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


def _actions_of_jumanji(spec: EnvSpec, count: int, dtype: Any) -> npt.NDArray[Any]:
    """Return actions as Jumanji's games take them: of a mine field, row and column."""
    actions = _actions(spec, count, dtype)
    if spec.name != "Minesweeper":
        return actions
    return np.stack(np.divmod(actions, spec.options["num_cols"]), 1)


def _required(spec: EnvSpec, package: str) -> str:
    """Return the name under which Gymnasium has the environment."""
    if spec.oracle is None:
        raise UnavailableError(f"{package} has no {spec.name}")
    return spec.oracle


def _envpool_game(spec: EnvSpec) -> str:
    """Return what EnvPool's form of a game differs in from ours, and what it counts."""
    if spec.turns:
        return "; the mask of the player on turn"
    if spec.name == "RobotWarehouse":
        return "; Jumanji's warehouse: worlds of 4 robots, 80 shelves"
    if spec.name != "LevelBasedForaging":
        return ""
    text = "; Jumanji's rules: 2 foods and 100 steps"
    try:
        version = metadata.version("envpool")
    except metadata.PackageNotFoundError:
        return text
    seeded = tuple(map(int, version.split(".")[:3])) >= ENVPOOL_SEEDED
    return text if seeded else f"{text}; EnvPool {version} starts every game alike"


def _envpool_agents(spec: EnvSpec) -> int:
    return ENVPOOL_AGENTS.get(spec.name, spec.agents)


def envpool_of(spec: EnvSpec, n: int) -> Any:
    """Return EnvPool's environments, for ``n`` agents; they are not reset yet.

    Raises
    ------
    UnavailableError
        EnvPool is not installed, or has no such environment.
    """
    with installed("'.[bench]'"):
        import envpool
    name = ENVPOOL_GAMES.get(spec.name) or _required(spec, "EnvPool")
    options = dict(spec.options)
    known = envpool.list_all_envs()
    if name not in known:  # it may have another version of it
        family = name.rpartition("-v")[0]
        name = max((other for other in known if other.rpartition("-v")[0] == family), default="")
    if not name:
        raise UnavailableError(f"EnvPool {metadata.version('envpool')} has no {family}")
    if spec.configure is not None and options != spec.configure().options:
        raise UnavailableError(f"measured with default options only, not {options}")
    return envpool.make(name, env_type="gymnasium", num_envs=n // _envpool_agents(spec))


def _envpool(spec: EnvSpec, n: int) -> Step | Game:
    envs = envpool_of(spec, n)
    with quiet_spaces():
        obs, infos = envs.reset()
        if spec.agents > 1:
            return _envpool_worlds(envs, obs, infos)
        actions = _actions_of_jumanji(spec, n, envs.action_space.dtype)
    return lambda: envs.step(actions)


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


def _foraging(spec: EnvSpec, count: int) -> Game:
    with installed("lbforaging"):
        from lbforaging.foraging import ForagingEnv
    options = dict(spec.options)
    options["sight"] = options["sight"] or max(options["field_size"])
    games = [ForagingEnv(**options) for _ in range(count // spec.agents)]
    for i, game in enumerate(games):
        game.reset(seed=i)
    chance = random.Random(0)

    def choose() -> list[Any]:
        return [chance.choice(game.get_valid_actions()) for game in games]

    def step(actions: Sequence[Any]) -> None:
        for game, action in zip(games, actions, strict=True):
            _, _, ended, _, _ = game.step(action)
            if ended:
                game.reset()

    return Game(choose, step)


def _warehouse(spec: EnvSpec, count: int) -> Game:
    with installed("rware"):
        from rware.warehouse import RewardType, Warehouse
    options = dict(spec.options)
    shelf_rows, shelf_columns = SIZES[options["size"]]
    games = [
        Warehouse(
            shelf_rows=shelf_rows,
            shelf_columns=shelf_columns,
            column_height=options["column_height"],
            n_agents=spec.agents,
            msg_bits=0,
            sensor_range=options["sensor_range"],
            request_queue_size=options["request_queue_size"] or spec.agents,
            max_inactivity_steps=None,
            max_steps=spec.max_cycles,
            reward_type=RewardType[options["reward_type"].upper()],
        )
        for _ in range(count // spec.agents)
    ]
    for i, game in enumerate(games):
        game.reset(seed=i)
    rng = np.random.default_rng(0)

    def choose() -> list[list[int]]:
        chosen: list[list[int]] = random_actions(spec, rng, count).reshape(-1, spec.agents).tolist()
        return chosen

    def step(actions: Sequence[Sequence[int]]) -> None:
        for game, action in zip(games, actions, strict=True):
            if game.step(action)[2]:
                game.reset()

    return Game(choose, step)


def _pettingzoo(spec: EnvSpec, count: int, module: str) -> Game:
    with installed("pettingzoo"):
        raw_env = importlib.import_module(f"pettingzoo.classic.{module}.{module}").raw_env
    games = [raw_env() for _ in range(count // spec.agents)]
    observed = []
    for i, game in enumerate(games):
        game.reset(seed=i)
        observed.append(game.last()[0])
    chance = random.Random(0)

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


def _parallel_env(spec: EnvSpec, count: int, module: str) -> Step:
    with installed():
        parallel_env = importlib.import_module(module).parallel_env
    worlds = [parallel_env(max_cycles=spec.max_cycles, **spec.options) for _ in range(count // spec.agents)]
    for i, world in enumerate(worlds):
        world.reset(seed=i)
    rows = _actions(spec, count, worlds[0].action_space(worlds[0].agents[0]).dtype)
    actions = [
        dict(zip(world.agents, row, strict=True))
        for world, row in zip(worlds, rows.reshape(len(worlds), spec.agents, *rows.shape[1:]), strict=True)
    ]

    def step() -> None:
        for world, chosen in zip(worlds, actions, strict=True):
            world.step(chosen)
            if not world.agents:
                world.reset()

    return step


def _overcooked(spec: EnvSpec, count: int) -> Step:
    with installed("overcooked-ai"):
        from overcooked_ai_py.mdp.actions import Action
        from overcooked_ai_py.mdp.overcooked_mdp import OvercookedGridworld
    cook_time, horizon = spec.options["cook_time"], spec.options["horizon"]
    options = {} if cook_time is None else {"cook_time": cook_time}
    mdp = OvercookedGridworld.from_layout_name(spec.options["layout"], **options)
    actions = [Action.INDEX_TO_ACTION[k] for k in _actions(spec, count, np.int64)]
    pairs = list(zip(actions[::2], actions[1::2], strict=True))
    states = [mdp.get_standard_start_state() for _ in pairs]

    def step() -> None:
        for i, pair in enumerate(pairs):
            states[i], _ = mdp.get_state_transition(states[i], pair)
            mdp.lossless_state_encoding(states[i], horizon)
            if states[i].timestep == horizon:
                states[i] = mdp.get_standard_start_state()

    return step


def _coin_game(spec: EnvSpec, count: int) -> Step:
    with installed("jaxmarl"), silence():
        import jax
        from jaxmarl.environments.coin_game import CoinGame
    game, worlds = CoinGame(**spec.options), count // spec.agents
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
    if spec.name not in GYMNAX:
        raise UnavailableError(f"gymnax has no {spec.name}")
    name, of_env, of_params = GYMNAX[spec.name]
    env, params = gymnax.make(name, **{key: spec.options[key] for key in of_env})
    return env, params.replace(**{key: spec.options[key] for key in of_params})


def _gymnax(spec: EnvSpec, count: int) -> Step:
    env, params = gymnax_of(spec)
    import jax

    def reset(key: Any) -> Any:
        return env.reset(key, params)

    def step(key: Any, state: Any, action: Any) -> Any:
        return env.step(key, state, action, params)

    return _compiled(jax, reset, step, random_actions(spec, np.random.default_rng(0), count), count)


def _pgx(spec: EnvSpec, count: int) -> Step | Game:
    with installed("pgx"):
        import jax
        import pgx
        from pgx.experimental.wrappers import auto_reset
    game: Any = pgx.make(PGX_GAMES[spec.name])
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


def _bsuite(spec: EnvSpec, count: int) -> Step:
    with installed("bsuite"):
        from bsuite.environments import catch, deep_sea, memory_chain
    classes = {"Catch": catch.Catch, "DeepSea": deep_sea.DeepSea, "MemoryChain": memory_chain.MemoryChain}
    envs = [classes[spec.name](**spec.options) for _ in range(count)]
    actions = _actions(spec, count, np.int64).tolist()
    for env in envs:
        env.reset()

    def step() -> None:
        for env, action in zip(envs, actions, strict=True):
            env.step(action)

    return step


def _jumanji(spec: EnvSpec, count: int) -> Step:
    with installed("jumanji"):
        import jax
        from jumanji.environments import Game2048, Minesweeper, Snake
        from jumanji.environments.logic.minesweeper.generator import UniformSamplingGenerator
        from jumanji.wrappers import VmapAutoResetWrapper
    actions = _actions_of_jumanji(spec, count, np.int32)
    match spec.name:
        case "Minesweeper":
            game = Minesweeper(UniformSamplingGenerator(**spec.options))
        case "Snake":
            game = Snake(**spec.options)
        case _:
            game = Game2048(**spec.options)
    env = VmapAutoResetWrapper(game)
    last = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), count))
    compiled = jax.jit(env.step)

    def step() -> None:
        nonlocal last
        last = jax.block_until_ready(compiled(last[0], actions))

    return step


def _inventory(spec: EnvSpec, count: int) -> Step:
    with installed("or-gymnasium"):
        from or_gymnasium import InvManagementLostSalesEnv
    return _one_by_one([InvManagementLostSalesEnv() for _ in range(count)], _actions(spec, count, np.int64))


def _elevators(spec: EnvSpec, count: int) -> Step:
    with installed("pyRDDLGym rddlrepository"), silence():
        import pyRDDLGym

        importlib.import_module("rddlrepository")
        game = pyRDDLGym.make("Elevators_MDP_ippc2011", str(spec.options["instance"]))
    kinds = "move-current-dir", "open-door-going-up", "open-door-going-down", "close-door"
    actions = [
        {f"{kinds[kind - 1]}___e{car}": True for car, kind in enumerate(row) if kind}
        for row in _actions(spec, count, np.int64)
    ]
    # It is read and translated anew each time that it is made, which takes half a second.
    return _one_by_one([copy.deepcopy(game) for _ in range(count)], actions)


def _one_by_one(envs: list[Any], actions: Iterable[Any]) -> Step:
    """Return the step of environments of Gymnasium's kind, each of which begins again when it ends."""
    pairs = list(zip(envs, actions, strict=True))
    for env in envs:
        env.reset()

    def step() -> None:
        for env, action in pairs:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()

    return step


_OF_GYMNAX = ("gymnax", "all result arrays; JAX, compiled, on all cores", _gymnax)
_OF_GYMNAX_DEFAULT = ("gymnax", "all result arrays, default options; JAX, compiled, on all cores", _gymnax)
_OF_PGX = ("pgx", "all result arrays, default options; JAX, compiled, on all cores", _pgx)
_OF_JUMANJI = ("jumanji", "all result arrays; JAX, compiled, on all cores", _jumanji)
_ONE_BY_ONE = "observations, rewards, ends; Python, one thread"
_OF_BSUITE = ("bsuite", _ONE_BY_ONE, _bsuite)
_FIVE_DICTS = "five dicts; Python, one thread"
_ONE_PLAYER = "observation, mask, reward, end of one player; no wrappers that check; Python, one thread"
PACKAGES: dict[str, list[tuple[str, str, Callable[[EnvSpec, int], Step | Game]]]] = {
    "Acrobot": [_OF_GYMNAX_DEFAULT],
    "Asterix": [_OF_GYMNAX_DEFAULT, _OF_PGX],
    "Breakout": [_OF_GYMNAX_DEFAULT, _OF_PGX],
    "Catch": [_OF_GYMNAX, _OF_BSUITE],
    "CoinGame": [("jaxmarl", "all result arrays; JAX, compiled, on all cores", _coin_game)],
    "ConnectFour": [("PettingZoo connect_four_v3", _ONE_PLAYER, partial(_pettingzoo, module="connect_four"))],
    "DeepSea": [_OF_GYMNAX_DEFAULT, _OF_BSUITE],
    "Elevators": [("pyRDDLGym", _ONE_BY_ONE, _elevators)],
    "Freeway": [_OF_GYMNAX_DEFAULT, _OF_PGX],
    "Game2048": [_OF_JUMANJI],
    "Inventory": [("or-gymnasium", _ONE_BY_ONE, _inventory)],
    "KuhnPoker": [_OF_PGX],
    "LeducPoker": [_OF_PGX],
    "LevelBasedForaging": [("lbforaging", _ONE_BY_ONE, _foraging)],
    "MemoryChain": [_OF_GYMNAX, _OF_BSUITE],
    "Minesweeper": [_OF_JUMANJI],
    "MountainCarContinuous": [_OF_GYMNAX],
    "Othello": [_OF_PGX],
    "Overcooked": [("overcooked-ai", _ONE_BY_ONE, _overcooked)],
    "Pursuit": [("PettingZoo", _FIVE_DICTS, partial(_parallel_env, module="pettingzoo.sisl.pursuit_v5"))],
    "RobotWarehouse": [("rware", _ONE_BY_ONE, _warehouse)],
    "Seaquest": [_OF_GYMNAX_DEFAULT, _OF_PGX],
    "SimpleSpread": [("MPE2", _FIVE_DICTS, partial(_parallel_env, module="mpe2.simple_spread_v3"))],
    "SimpleTag": [("MPE2", _FIVE_DICTS, partial(_parallel_env, module="mpe2.simple_tag_v3"))],
    "Snake": [_OF_JUMANJI],
    "SpaceInvaders": [_OF_GYMNAX_DEFAULT, _OF_PGX],
    "TicTacToe": [("PettingZoo tictactoe_v3", _ONE_PLAYER, partial(_pettingzoo, module="tictactoe"))],
}
"""Packages that have our games, by our names of these: name, what is counted, and its step."""

AT_ONCE = {"gymnax", "jaxmarl", "jumanji", "pgx"}
"""Packages that step all worlds at once. The others step one after the other, so a thousand are enough."""


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
