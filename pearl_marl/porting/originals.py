"""Somebody else's environment, made by its name and called in one way, however many agents it has."""

from __future__ import annotations

import copy
import importlib
import inspect
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium import Space
from gymnasium.spaces import Box, Dict, Discrete, Tuple

from pearl_marl.batch.actions import random_numbers
from pearl_marl.errors import ArgumentError, one_line
from pearl_marl.porting.contents import kept, replaced, reseeded
from pearl_marl.porting.oracle import Outcome
from pearl_marl.spec import MAX_AGENTS
from pearl_marl.spec.elements import ActionSpace, action_counts, are_numbers, bounds

MOST_ELEMENTS = 4096
"""Elements of an observation: each is a field of a hardware word."""


class Original:
    """An environment of Gymnasium or, with several agents, a parallel one of PettingZoo.

    Parameters
    ----------
    name
        A registered id such as ``"CliffWalking-v1"``, or ``"package.module:Class"``.
    options
        Its keyword arguments.

    Raises
    ------
    ArgumentError
        There is none of that name, or it cannot be made; or it is of a kind that this platform does not have.
    """

    def __init__(self, name: str, **options: Any) -> None:
        self.name, self.options = name, options
        env: Any = _made(name, options)
        self.limit: int | None = getattr(getattr(env, "spec", None), "max_episode_steps", None)
        self.registered = ":" not in name
        self.env: Any = env.unwrapped if isinstance(env, gymnasium.Env) else getattr(env, "unwrapped", env)
        several = not isinstance(env, gymnasium.Env)
        self.names = list(getattr(self.env, "possible_agents", ())) if several else []
        self.agents = max(1, len(self.names))
        if self.agents > MAX_AGENTS:
            raise ArgumentError(f"{name} has {self.agents} agents; a world has 1 to {MAX_AGENTS}")
        self.observation_space, self.action_space = self._space("observation"), self._space("action")
        self._ended: list[bool] = [False] * self.agents
        self.observations: list[Any] = []
        self.over = False
        """Whether the episode is over."""
        for what, why in (
            ("observation", why_no_observation(self.observation_space)),
            ("action", why_no_action(self.action_space)),
        ):
            if why:
                raise ArgumentError(f"{name}: the {what} space is {_short(self._space(what))}; {why}")

    def _space(self, what: str) -> Space[Any]:
        if not self.names:
            space = getattr(self.env, f"{what}_space", None)
            if not isinstance(space, Space):
                raise ArgumentError(
                    f"{self.name} has no {what}_space after it is made; it takes a space of Gymnasium"
                )
            return space
        spaces: list[Space[Any]] = [getattr(self.env, f"{what}_space")(agent) for agent in self.names]
        if any(space != spaces[0] for space in spaces):
            raise ArgumentError(
                f"{self.name}: its agents have different {what} spaces; `pearl new NAME "
                f"--agents {self.agents}` starts a world, whose spec takes roles"
            )
        return spaces[0]

    def reset(self, seed: int | None = None) -> list[Any]:
        """Begin an episode; return what each agent observes."""
        self.over = False
        self._ended = [False] * self.agents
        with _quiet():
            observed, _ = self.env.reset(seed=seed)
        self.observations = [observed[agent] for agent in self.names] if self.names else [observed]
        return self.observations

    def step(self, actions: Sequence[Any]) -> Outcome:
        """Take an action of each agent."""
        given = actions[0]
        if self.names:
            pairs = zip(self.names, actions, strict=True)
            given = {agent: action for agent, action in pairs if agent in self.env.agents}
        with _quiet():
            seen, rewards, ends, truncations, _ = self.env.step(given)
        if self.names:
            self._ended = [
                ended or bool(ends.get(agent)) for agent, ended in zip(self.names, self._ended, strict=True)
            ]
            observed = [seen.get(agent) for agent in self.names]
            paid = [float(rewards.get(agent, 0)) + 0.0 for agent in self.names]
            outcome = Outcome(observed, paid, list(self._ended), any(truncations.values()))
        else:
            outcome = Outcome([seen], [float(rewards) + 0.0], [bool(ends)], bool(truncations))
        self.observations, self.over = outcome.observations, outcome.over
        return outcome

    def actions(self, rng: np.random.Generator) -> list[Any]:
        """Return a random action of each agent."""
        draws = rng.integers(1 << 32, size=self.agents, dtype=np.uint32)
        numbers = random_numbers(cast(ActionSpace, self.action_space), draws)
        return numbers.tolist() if isinstance(self.action_space, Discrete) else list(numbers)

    def habits(self, rng: np.random.Generator, episode: int) -> Iterator[list[Any]]:
        """Yield random actions for an episode: independent ones hardly ever swing up a mountain.

        Of every five episodes one never repeats an action, and the others do for 2, 4, 8 and 16 steps on
        average.
        """
        actions = self.actions(rng)
        while True:
            yield actions
            if rng.random() < 0.5 ** (episode % 5):
                actions = self.actions(rng)

    def copied(self) -> Original:
        """Return a copy that goes its own way; what is no state, such as windows and spaces, is shared."""
        other = copy.copy(self)
        other.env, other._ended = copy.deepcopy(self.env, kept(self.env)), list(self._ended)
        return other

    def reseed(self, seed: int) -> None:
        """Have its next draws depend on a seed."""
        replaced(self.env, lambda old: reseeded(old, seed))


def why_no_observation(space: Space[Any]) -> str | None:
    """Return why an observation space is not taken, as a part of a sentence; ``None`` where it is."""
    kind = type(space).__name__
    if isinstance(space, Dict):
        return "a Dict is not taken, as an observation is one row of words: wrap it in FlattenObservation"
    if isinstance(space, Tuple) and not are_numbers(space):
        return "a Tuple is taken of Discretes only: put a wrapper around it that makes one Box of all"
    if not isinstance(space, Box) and not are_numbers(space):
        return f"a {kind} is not taken: Discrete, Tuple of Discretes, MultiDiscrete, MultiBinary and Box are"
    low, _ = bounds(space)
    if not isinstance(space, Box) and low.min() < 0:
        return f"a {kind} observation starts from 0 or more"
    if low.size > MOST_ELEMENTS:
        return f"its {low.size:,} elements are more than a word has ({MOST_ELEMENTS:,}): observe the state"
    return None


def why_no_action(space: Space[Any]) -> str | None:
    """Return why an action space is not taken, as a part of a sentence; ``None`` where it is."""
    if isinstance(space, Box):
        taken = len(space.shape) == 1 and space.dtype == np.float32 and space.is_bounded()
        return None if taken else "of Boxes a bounded float32 one of shape (n,) is taken"
    if action_counts(space):
        return None
    return "taken are Discrete, MultiDiscrete and MultiBinary, from 0 and of one dimension, and Box"


def _short(space: Space[Any]) -> str:
    text = " ".join(str(space).split())
    return text if len(text) <= 100 else f"{text[:97]}..."


def _quiet() -> warnings.catch_warnings[None]:
    return warnings.catch_warnings(action="ignore")


def _made(name: str, options: Mapping[str, Any]) -> Any:
    """Return the environment of a name."""
    maker = _found(name)
    if maker is None:
        return _registered(name, options)
    _check_call(name, maker, options)
    try:
        with _quiet():
            env = maker(**options)
    except ArgumentError:
        raise
    except Exception as error:
        raise ArgumentError(f"{name} cannot be made: {type(error).__name__}: {one_line(error)}") from error
    if isinstance(env, gymnasium.Env):
        return env
    if hasattr(env, "agent_selection"):
        raise ArgumentError(
            f"{name} is an AEC environment of PettingZoo; take its parallel one: parallel_env"
        )
    if not hasattr(env, "possible_agents"):
        raise ArgumentError(
            f"{name} makes a {type(env).__name__}; it must be an environment of Gymnasium (gymnasium.Env) or "
            "a parallel one of PettingZoo"
        )
    return env


def _found(name: str) -> Any:
    """Return what stands for ``module:attribute``, ``None`` for a registered id."""
    module_name, colon, attribute = name.rpartition(":")
    if not colon:
        return None
    if not module_name or not all(part.isidentifier() for part in module_name.split(".")) or not attribute:
        raise ArgumentError(f"{name!r} is neither 'package.module:Class' nor an id that Gymnasium knows")
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module_name}.".startswith(f"{error.name}."):
            raise ArgumentError(f"module {module_name!r} cannot be imported: {one_line(error)}") from error
        raise ArgumentError(
            f"there is no module {error.name!r} for {name!r}; install its package, or add its folder to "
            "PYTHONPATH"
        ) from None
    if attribute in gymnasium.registry:  # Gymnasium's own form, `module:Id-v0`
        return None
    found: Any = module
    for part in attribute.split("."):
        found = getattr(found, part, None)
    if not callable(found):
        classes = [
            key
            for key, value in vars(module).items()
            if inspect.isclass(value) and issubclass(value, gymnasium.Env) and value is not gymnasium.Env
        ]
        there = f"; there are {', '.join(sorted(classes)[:8])}" if classes else ""
        raise ArgumentError(f"module {module_name!r} has no class {attribute!r}{there}")
    return found


def _check_call(name: str, maker: Any, options: Mapping[str, Any]) -> None:
    """Refuse options that there are not, and to leave out arguments without a default."""
    try:
        parameters = inspect.signature(maker).parameters.values()
    except (TypeError, ValueError):
        return
    takes_any = any(p.kind is p.VAR_KEYWORD for p in parameters)
    known = [p.name for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    for option in options:
        if option not in known and not takes_any:
            raise ArgumentError(f"{name} has no argument {option!r}; it has {', '.join(known) or 'none'}")
    missing = [
        p.name
        for p in parameters
        if p.default is p.empty and p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL) and p.name not in options
    ]
    if missing:
        given = " ".join(f"--option {one}=VALUE" for one in missing)
        raise ArgumentError(f"{name} cannot be made without {', '.join(missing)}: give {given}")


def _registered(name: str, options: Mapping[str, Any]) -> gymnasium.Env[Any, Any]:
    try:
        with _quiet():
            return gymnasium.make(name, **options)
    except gymnasium.error.UnregisteredEnv as error:
        raise ArgumentError(
            f"Gymnasium has no environment {name!r}: {one_line(error)} "
            "(a class is named 'package.module:Class')"
        ) from None
    except gymnasium.error.Error as error:
        raise ArgumentError(f"{name} cannot be made: {one_line(error)}") from None
    except Exception as error:
        raise ArgumentError(f"{name} cannot be made: {type(error).__name__}: {one_line(error)}") from error
