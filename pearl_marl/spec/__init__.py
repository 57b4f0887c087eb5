"""What an environment is to the platform: its words, spaces, rewards and golden functions."""

from __future__ import annotations

import difflib
import hashlib
import inspect
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium import Env, Space
from gymnasium.spaces import Box, Discrete, Tuple

from pearl_marl.base.source_lines import source_line
from pearl_marl.checks import checked_choice, checked_integer
from pearl_marl.errors import ArgumentError, renamed
from pearl_marl.golden import MOST_DRAWS, CountingDraws, GoldenFunction, as_python_runs_it, call_reference
from pearl_marl.golden.tracing.checks import Argument, Result, check
from pearl_marl.golden.tracing.operations import word_range
from pearl_marl.golden.tracing.records import RULES, record
from pearl_marl.layout import Field as Field
from pearl_marl.layout import Interval, Layout, real_field
from pearl_marl.layout import word_bits as word_bits
from pearl_marl.layout.positional import (
    UNPACKED_FRACTION,
    Positional,
    act_of,
    in_fixed_point,
    initial_of,
    plain_unpack_of,
    step_of,
    takes_agent,
    unpack_of,
    view_from,
    view_of,
)
from pearl_marl.spec.elements import ActionSpace, action_counts, are_numbers, bounds
from pearl_marl.spec.peer import Peer as Peer
from pearl_marl.spec.pickling import reduced


def snake_case(name: str) -> str:
    """Return the name of an environment's folder: ``"cliff_walking"`` for ``"CliffWalking"``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


class Golden(NamedTuple):
    """The functions that are an environment's dynamics, in plain Python: see :mod:`pearl_marl.golden`.

    ::

        initial(draws)             -> State
        step(state, action, draws) -> State, reward, terminated
        observe(state)             -> what an agent sees: a word, a tuple of words or a View
        masks(state)               -> a flag for each action: whether it may be taken

    ``draws`` are :class:`~pearl_marl.golden.Draws`; ``terminated`` is 0 or 1. Options are constants of the
    enclosing scope. An action is a word, or a tuple of them where the spec has several fields.

    In a world of several agents ``step`` takes a list of their actions and returns a list of their rewards
    and one of their flags ``terminated``, agent 0 first; and ``observe`` and ``masks`` take the agent that
    they are about, a plain ``int``::

        step(state, actions, draws) -> State, rewards, terminated
        observe(state, agent)
        masks(state, agent)

    Where options may leave one agent alone, the functions are the same: ``observe`` takes it.

    ``step`` takes any action of the action space, masked or not.
    """

    state: type
    """The class of a state: see :mod:`pearl_marl.layout`."""
    initial: GoldenFunction
    step: GoldenFunction
    observe: GoldenFunction
    masks: GoldenFunction | None = None
    view: type | None = None
    """The class of what ``observe`` returns, where it is one."""


class Role(NamedTuple):
    """What one agent of a world is called, and the part of the spec's spaces that is its own."""

    name: str
    observation_space: Space[Any]
    """As the spec's; of a ``Box`` of one dimension it may be the first elements, and 0 then fills the row."""
    action_space: ActionSpace
    """As the spec's; of a ``Discrete`` it may be the first actions, and masks are 0 for the others."""


MAX_CYCLES = (1 << 32) - 1
"""The longest time limit: elapsed steps are words of 32 bits."""

MAX_SLOTS = 1 << 32
"""Slots that random draws can tell apart: see :mod:`pearl_marl.golden.rng`."""

MAX_AGENTS = 63
"""Of one world: with one bit more, what is known of who has ended fits a word of 64 bits."""


class Grid(NamedTuple):
    """How a batch of observations falls onto a grid of cells, for heat maps."""

    rows: int
    columns: int
    cell: Callable[[npt.NDArray[Any]], npt.NDArray[np.integer[Any]]]
    """Maps observations of shape ``(n, ...)`` to cell numbers (row-major) of shape ``(n,)``."""


@dataclass(frozen=True, kw_only=True)
class EnvSpec:
    """The whole description of one environment; every device and interface is made from it.

    Parameters
    ----------
    name, version
        ``"CliffWalking"`` and 0 give ``"Pearl/CliffWalking-v0"`` in the registries.
    summary
        One line for the table of environments.
    observation
        The fields of the observation word, least significant first; by default those of ``golden.view``, or
        those that the observation space takes.
    action
        The field of an action, or a tuple of them, least significant first, one an element of the space. By
        default as wide as the action space takes.
    reward
        The field of a reward: a category code if ``rewards`` is a table, the value itself if not. By default
        as wide as the table takes.
    rewards
        The reward of each category, or ``None``.
    observation_space
        One agent's, equal to the oracle's. A ``Discrete`` takes one field, a ``Tuple`` of them one each,
        a ``MultiDiscrete``, ``MultiBinary`` or ``Box`` one an element. Observations are delivered in the
        space's dtype.
    action_space
        One agent's, equal to the oracle's: a ``Discrete`` from 0; a ``MultiDiscrete`` from 0 or a
        ``MultiBinary``, of one dimension; or a bounded ``float32`` ``Box`` of shape ``(n,)``, each element of
        which becomes the fixed-point word of its field.
    golden
        The dynamics.
    agents
        How many agents share a state, 1 to :data:`MAX_AGENTS`: a slot is a *world* of so many. ``action``,
        ``observation`` and ``reward`` are those of one agent; state, draws and time limit are the world's.
    roles
        A role for each agent of a world, where they are not all alike. The spaces of the spec are then wide
        enough for each of them.
    turns
        Whether agents take turns: who is not on turn has masks that are all 0, and its action is ignored.
    masked
        What becomes of a masked action: ``"stay"`` leaves it to ``golden.step``, by the rules that the spec
        states; ``"refused"`` makes a step with one raise ActionError, and nothing has moved. An agent whose
        masks are all 0 may send anything.
    unpack
        For a ``Box`` whose elements are not the observation's fields: ``unpack(view, row)`` writes what one
        slot sees, a ``golden.view``, into ``row``, a flat array (of 0 and 1 in ``uint8`` where the space's
        dtype is ``bool``). Without a view it is ``unpack(*observation, row)``. Numba compiles it: the view is
        a ``NamedTuple``, and arrays in it are tuples.
    max_cycles
        Steps after which an episode is truncated; ``None`` for no limit.
    options, configure
        The keyword arguments that this spec was made with, and the function that takes them.
    core
        The SystemVerilog file of a hardware core of one's own; ``None`` for one generated from ``golden``.
    oracle
        The Gymnasium id of the environment that this one is held against, if it is one of theirs.
    follows
        Package and name of what this one follows with its default options, such as
        ``"lbforaging Foraging-8x8-2p-3f-v3"``, for lists of environments; by default the oracle.
    pose
        Puts the oracle's environment, unwrapped, into a slot's state, an object of ``golden.state``, so that
        it can render it.
    draw
        Draws such a state itself, as an image of shape ``(height, width, 3)`` and dtype ``uint8`` (or of
        floats from 0 to 1), where no oracle can do so without a screen.
    render_modes, render_fps
        How the oracle can render, as its own metadata say; ``("rgb_array",)`` with ``draw``.
    grid
        How observations fall onto a grid, for heat maps.
    peers
        By library, what it calls this environment, or a :class:`Peer`: ``pearl bench`` times it beside ours.
        The library's name is what pip installs it by. Gymnasium and EnvPool are asked for the oracle, too.
    presets
        By algorithm, settings that differ from its defaults. Without ``--algo``, ``pearl train`` takes the
        first. They are those of default options.
    """

    name: str
    version: int
    summary: str
    observation_space: Space[Any]
    action_space: ActionSpace
    golden: Golden
    rewards: tuple[float, ...] | None
    observation: tuple[Field, ...] = ()
    action: Field = None  # type: ignore[assignment]  # given where it has a default
    reward: Field = None  # type: ignore[assignment]
    agents: int = 1
    roles: tuple[Role, ...] = ()
    turns: bool = False
    masked: str = "stay"
    unpack: GoldenFunction | None = None
    max_cycles: int | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    configure: Callable[..., EnvSpec] | None = None
    core: Path | str | None = None
    oracle: str | None = None
    follows: str | None = None
    pose: Callable[[Env[Any, Any], Any], None] | None = None
    draw: Callable[[Any], npt.NDArray[np.uint8]] | None = None
    render_modes: tuple[str, ...] = ()
    render_fps: int = 4
    grid: Grid | None = None
    peers: Mapping[str, str | Peer] = field(default_factory=dict)
    presets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._set_defaults()
        space = self.observation_space
        if not isinstance(space, Box) and not are_numbers(space):
            raise ArgumentError(
                f"{self.name}: observation space {space} is no Discrete, Tuple of them, MultiDiscrete, "
                "MultiBinary or Box"
            )
        if self.unpack is not None and not isinstance(space, Box):
            raise ArgumentError(f"{self.name}: unpack() makes a Box, and the observation space is {space}")
        if self.unpack is None and len(self.observation) != self.observation_size:
            raise ArgumentError(
                f"{self.name}: observation space {space} takes {self.observation_size} fields, "
                f"the spec lists {len(self.observation)}"
            )
        self._check_names("state", self.state, ("elapsed", "ended"))
        self._check_names("observation", self.agent_fields)
        self._check_action()
        if not isinstance(self.name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9]*", self.name):
            raise ArgumentError(f"name {self.name!r}: it takes letters and digits, a letter first")
        checked_integer(f"{self.name}: version", self.version, 0)
        if self.rewards is not None and self.reward.bits > 16:
            raise ArgumentError(f"{self.name}: a category of {self.reward.bits} bits; a table takes up to 16")
        if self.rewards is not None and self.reward.signed:
            raise ArgumentError(
                f"{self.name}: a signed reward field is no category; leave out signed=True, or the rewards"
            )
        if self.rewards is not None and len(self.rewards) > 1 << self.reward.bits:
            raise ArgumentError(
                f"{self.name}: {len(self.rewards)} rewards do not fit {self.reward.bits} reward bits"
            )
        check_max_cycles(self.max_cycles)
        self._check_world()
        # Those of this package are traced by its tests, so that importing it stays quick.
        self.check_golden([f for f in self.functions if not str(f.__module__).startswith("pearl_marl.envs.")])

    def _set_defaults(self) -> None:
        """Derive the fields that are not given from spaces, the table of rewards and the view."""

        def derive(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        fraction = self.layout.fraction
        if not self.observation:
            view = self._view
            derive("observation", view.fields if view else _fields_of(self.observation_space))
        if self.action is None:
            derive("action", self._action_of(self.action_space))
        interval = next(
            (x for x in getattr(self.reward, "__metadata__", ()) if isinstance(x, Interval)), None
        )
        if interval is not None:
            derive("reward", real_field("reward", interval, fraction or 0))
        if self.reward is None:
            if self.rewards is None:
                raise ArgumentError(f"{self.name}: there is no table of rewards; give reward=Field(...)")
            derive("reward", Field("reward", _width(len(self.rewards))))

    def _action_of(self, space: ActionSpace) -> Field | tuple[Field, ...]:
        """Return the fields that an action space takes."""
        fraction = self.layout.fraction
        if isinstance(space, Box):
            if fraction is None or not space.is_bounded():
                raise ArgumentError(f"{self.name}: the action space is {space}; give action=Field(...)")
            ends = zip(space.low.ravel().tolist(), space.high.ravel().tolist(), strict=True)
            words = tuple(real_field(f"action_{k}", Interval(*pair), fraction) for k, pair in enumerate(ends))
        else:
            words = tuple(Field(f"action_{k}", _width(count)) for k, count in enumerate(action_counts(space)))
        return replace(words[0], name="action") if len(words) == 1 else words

    @cached_property
    def layout(self) -> Layout:
        """What a state looks like in hardware."""
        return Layout(self.golden.state)

    @property
    def _view(self) -> Layout | None:
        return None if self.golden.view is None else Layout(self.golden.view, self.layout.fraction)

    @property
    def state(self) -> tuple[Field, ...]:
        """The fields of the state word, least significant first."""
        return self.layout.fields

    @cached_property
    def positional(self) -> Positional:
        """The golden functions as functions of words."""
        state, golden, n, world = self.layout, self.golden, self.agents, self._is_world
        return Positional(
            initial_of(state, golden.initial),
            step_of(state, golden.step, n, self.action_fields, self.reward, world=world),
            view_of(state, golden.observe, n, self._view, world=world),
            None if golden.masks is None else view_of(state, golden.masks, n, world=world),
            None if self.unpack is None else unpack_of(golden.view, self.unpack, self.observation),
        )

    def act_of_words(self, act: GoldenFunction) -> GoldenFunction:
        """Return an author's ``act(view, draws)`` as a function of an observation's words and of draws."""
        return act_of(self._view, act, len(self.observation), self.action_fields, self.layout.fraction)

    def draws_of(self, act: GoldenFunction) -> int:
        """Return how many draws an author's ``act(view, draws)`` asks for."""
        fraction = self.layout.fraction
        # No path through it changes how many it asks for: any observation will do.
        counting = CountingDraws(fraction)
        as_python_runs_it(act, fraction is not None)(view_from(self._view, self._first_words), counting)
        return counting.count

    @property
    def _first_words(self) -> list[int]:
        """The words that agent 0 may see at a start."""
        state = call_reference(self.positional.initial, [0] * self.reset_draws)
        return list(map(int, call_reference(self.positional.observe, state, *self.views[0])))

    @cached_property
    def plain_unpack(self) -> GoldenFunction | None:
        """``unpack(*observation, row)`` as Python runs it, without the code that is generated for kernels."""
        return None if self.unpack is None else plain_unpack_of(self.golden.view, self.unpack)

    @property
    def _is_world(self) -> bool:
        return self.agents > 1 or takes_agent(self.golden.observe)

    @cached_property
    def _draws(self) -> tuple[int, int]:
        # No path through a golden function changes how many it asks for: any state will do.
        fraction, functions = self.layout.fraction, (self.golden.initial, self.golden.step)
        initial, step = (as_python_runs_it(function, fraction is not None) for function in functions)
        first, second = CountingDraws(fraction), CountingDraws(fraction)
        state = initial(first)
        one = 0 if len(self.action_fields) == 1 else (0,) * len(self.action_fields)
        actions = [one] * self.agents if self._is_world else one
        step(state, actions, second)
        return first.count, second.count

    @property
    def reset_draws(self) -> int:
        """How many 32-bit random draws ``golden.initial`` asks for."""
        return self._draws[0]

    @property
    def step_draws(self) -> int:
        """How many ``golden.step`` asks for."""
        return self._draws[1]

    def check_golden(self, functions: Sequence[GoldenFunction | None]) -> None:
        """Trace some of the golden functions: each takes and returns what the spec says, within its limits.

        Raises
        ------
        ArgumentError
            Names the line of the author's file, and says what is wrong there.
        """

        def arguments(fields: Iterable[Field]) -> tuple[Argument, ...]:
            return tuple(Argument(f.name, f.bits, f.signed, *f.range) for f in fields)

        def results(fields: Iterable[Field]) -> tuple[Result, ...]:
            return tuple(map(_result, fields))

        draws = tuple(Argument(f"draw_{k}", 32, False, 0, (1 << 32) - 1) for k in range(MOST_DRAWS))
        state, rewards = arguments(self.state), results(self.each_agent(self.reward))
        if self.rewards is not None:
            high, fix = len(self.rewards) - 1, "add a reward, or change the category"
            rewards = tuple(Result(r.name, 0, high, "the table of rewards lists", fix) for r in rewards)
        actions = arguments(self.each_agent(*_told_apart(self.action_fields, "action")))
        golden = self.positional
        calls: list[tuple[GoldenFunction, tuple[Argument, ...], tuple[Result, ...], tuple[int, ...]]] = [
            (golden.initial, draws, results(self.state), ()),
            (
                golden.step,
                (*state, *actions, *draws),
                (*results(self.state), *rewards, *results(self.each_agent(TERMINATED))),
                (),
            ),
        ]
        for k, agent in enumerate(self.views):
            role = self.roles[k] if self.roles else None
            words = results(self.observation)
            if role is not None and self.unpack is None:
                size = _elements(role.observation_space)
                words = _none_beyond(
                    words, size, f"role {role.name!r} has {size} elements, so the others hold"
                )
            calls.append((golden.observe, state, words, agent))
            if golden.masks is not None:
                flags = results(self.mask_fields)
                if role is not None:
                    n = action_counts(role.action_space)[0]  # a Discrete's, or there would be no masks
                    flags = _none_beyond(flags, n, f"role {role.name!r} has {n} actions, so the others hold")
                calls.append((golden.masks, state, flags, agent))
        for function, given, due, agent in calls:
            if function in functions:
                check(function, given, due, *agent)
        if golden.observe in functions:
            self._check_unpack()

    def _check_unpack(self) -> None:
        """Refuse an ``unpack()`` that fails: compiled, it would write beyond its row without a word."""
        if (unpack := self.positional.unpack) is None:
            return
        row = np.zeros(self.observation_size, self.observation_dtype)
        # Of a start, since there may be no state that has the least or greatest words of all fields.
        words = self._first_words
        try:
            unpack(*words, row)
        except Exception as error:
            code = getattr(self.unpack, "py_func", self.unpack).__code__  # type: ignore[union-attr]
            raise ArgumentError(
                f"{source_line(code.co_filename, code.co_firstlineno)}: unpack() fails for a row of "
                f"{self.observation_size} elements, as {self.observation_space} has: {error}"
            ) from error

    def _check_names(self, word: str, fields: Iterable[Field], taken: Iterable[str] = ()) -> None:
        seen: set[str] = set()
        for name in (f.name for f in fields):
            if not isinstance(name, str) or not name.isascii() or not name.isidentifier():
                raise ArgumentError(
                    f"{self.name}: {word} field {name!r}: a name takes letters, digits and underscores, "
                    "and no digit first"
                )
            if name in taken:
                raise ArgumentError(
                    f"{self.name}: {word} field {name!r} is named like a column that every slot has"
                )
            if name in seen:
                raise ArgumentError(f"{self.name}: two {word} fields are named {name!r}")
            seen.add(name)

    def _check_action(self) -> None:
        space, words = self.action_space, self.action_fields
        if isinstance(space, Box):
            if len(space.shape) != 1 or space.dtype != np.float32 or not space.is_bounded():
                raise ArgumentError(f"{self.name}: {space} is no bounded float32 Box of shape (n,)")
            ends = list(zip(space.low.tolist(), space.high.tolist(), strict=True))
        elif self.action_counts:
            ends = [(0, n - 1) for n in self.action_counts]
        else:
            raise ArgumentError(
                f"{self.name}: action space {space} is none of Discrete, MultiDiscrete and MultiBinary, from "
                "0 and of one dimension at most, nor a Box"
            )
        if len(ends) != len(words) or not words:
            raise ArgumentError(
                f"{self.name}: action space {space} takes {len(ends)} fields, and at least one; the spec "
                f"lists {len(words)}"
            )
        self._check_names("action", words)
        for word, (low, high) in zip(words, ends, strict=True):
            if not isinstance(space, Box) and (word.signed or word.fraction):
                raise ArgumentError(
                    f"{self.name}: action field {word.name!r} is signed or has a fraction, and {space} "
                    "counts from 0: leave out signed and fraction"
                )
            if not word.low <= low <= high <= word.high:
                of = f" of {word.name}" if len(words) > 1 else ""
                raise ArgumentError(f"{self.name}: {space} does not fit {word.bits} action bits{of}")
        self.action_dtype  # noqa: B018  # which there may not be

    def _check_world(self) -> None:
        n, masks = self.agents, self.golden.masks
        checked_integer(f"{self.name}: agents", n, 1, MAX_AGENTS)
        checked_choice(f"{self.name}: masked", self.masked, ("stay", "refused"))
        if masks is None and (self.turns or self.masked == "refused"):
            what = "turns=True" if self.turns else "masked='refused'"
            raise ArgumentError(f"{self.name}: {what} goes by masks; give Golden(..., masks=...)")
        if masks is not None and not isinstance(self.action_space, Discrete):
            raise ArgumentError(
                f"{self.name}: masks are for a Discrete action space, not {self.action_space}"
            )
        if self.roles and len(self.roles) != n:
            raise ArgumentError(
                f"{self.name}: {len(self.roles)} roles for {n} agents; name one for each, or none"
            )
        for role in self.roles:
            _check_part(self, role, "observation", role.observation_space, self.observation_space)
            _check_part(self, role, "action", role.action_space, self.action_space)

    def each_agent(self, *own: Field) -> tuple[Field, ...]:
        """Return fields of every agent of a world: with the agent's number, where there are several."""
        if self.agents == 1:
            return own
        return tuple(replace(one, name=f"{one.name}_{k}") for k in range(self.agents) for one in own)

    @cached_property
    def action_fields(self) -> tuple[Field, ...]:
        """The fields of an agent's action, one an element of the action space, least significant first."""
        return (self.action,) if isinstance(self.action, Field) else tuple(self.action)

    @cached_property
    def action_counts(self) -> tuple[int, ...]:
        """How many values each element of an action has, from 0; empty where they are in a ``Box``."""
        return action_counts(self.action_space)

    @cached_property
    def action_dtype(self) -> np.dtype[Any]:
        """The narrowest NumPy integer that holds the word of any field of an action."""
        signed = any(f.signed for f in self.action_fields)
        bits = max(f.bits + (signed and not f.signed) for f in self.action_fields)
        if bits > 64:
            raise ArgumentError(
                f"{self.name}: an action's fields of 64 bits, some signed and some not, have no integer in "
                "common that holds them: take fewer bits"
            )
        return Field("action", bits, signed).dtype

    @cached_property
    def in_elements(self) -> EnvSpec:
        """The same environment with the elements of its observations as observations: integers.

        Those of a ``Box`` of floats are its fixed-point words or, where ``unpack`` writes floats, those
        rounded to :attr:`element_fractions`. It is the same spec where they are integers already.
        """
        if self.observation_dtype.kind in "biu":
            return self
        if self.unpack is not None:
            dtype = np.dtype(f"i{self.observation_dtype.itemsize}")
            unpack = in_fixed_point(self.unpack, self.observation_dtype)
            space = Box(np.iinfo(dtype).min, np.iinfo(dtype).max, self.observation_shape, dtype)
            return self._observing(space, unpack=unpack)
        return self._observing_words

    @property
    def in_words(self) -> EnvSpec:
        """The same environment with the words that ``observe()`` returns as observations."""
        return self.in_elements if self.unpack is None else self._observing_words

    @cached_property
    def _observing_words(self) -> EnvSpec:
        words = tuple(replace(word, fraction=0) for word in self.observation)
        dtype = np.dtype(np.int64 if any(word.bits + (not word.signed) > 32 for word in words) else np.int32)
        if any(word.high >= 1 << 63 for word in words):
            raise ArgumentError(
                f"{self.name}: an observation has words of 64 bits; a policy is shown 63 at most"
            )
        low, high = np.array([word.range for word in words], np.int64).T
        kind: Any = dtype
        space = Box(low.astype(dtype), high.astype(dtype), (len(words),), kind)
        return self._observing(space, observation=words, unpack=None)

    def _observing(self, space: Box, **changes: Any) -> EnvSpec:
        """Return the same environment with another observation space."""
        roles = tuple(role._replace(observation_space=space) for role in self.roles)
        return replace(self, observation_space=space, roles=roles, **changes)

    @property
    def element_fractions(self) -> tuple[int, ...]:
        """How many bits of each element (:attr:`in_elements`) are behind the binary point."""
        if self.unpack is None:
            return tuple(word.fraction for word in self.observation)
        return self.observation_size * (UNPACKED_FRACTION if self.observation_dtype.kind == "f" else 0,)

    @cached_property
    def functions(self) -> tuple[GoldenFunction, ...]:
        """The positional golden functions that there are."""
        golden = self.positional[:4]
        return tuple(function for function in golden if function is not None)

    @cached_property
    def behaviour(self) -> str:
        """A hash of what the golden functions do, of the formats of their words and of the table of rewards.

        It is the same in every process. Changing a variable's name or a comment does not change it. Two that
        :func:`pearl_marl.golden.tracing.records.comparable` tells apart may do the same.
        """

        def formats(fields: Iterable[Field]) -> list[tuple[int, bool, int, int]]:
            return [(f.bits, f.signed, *f.range) for f in fields]

        golden, state = self.positional, formats(self.state)
        draw = (32, False, 0, (1 << 32) - 1)
        actions = formats(self.agents * self.action_fields)
        words = (self.state, self.action_fields, self.observation, (self.reward,))
        parts = [
            (self.agents, self.reset_draws, self.step_draws),
            [[(f.bits, f.signed, f.fraction, *f.range) for f in fields] for fields in words],
            None if self.rewards is None else [float(reward).hex() for reward in self.rewards],
            record(golden.initial, [draw] * self.reset_draws),
            record(golden.step, [*state, *actions, *[draw] * self.step_draws]),
            [record(view, state, *agent) for agent in self.views for view in self.functions[2:]],
        ]
        return f"{RULES}:{hashlib.sha256(repr(parts).encode()).hexdigest()[:16]}"

    @cached_property
    def views(self) -> tuple[tuple[int, ...], ...]:
        """For each agent what ``observe`` and ``masks`` take beyond the state: nothing where there is one."""
        return ((),) if self.agents == 1 else tuple((k,) for k in range(self.agents))

    @cached_property
    def mask_fields(self) -> tuple[Field, ...]:
        """The flags that ``masks`` returns, one for each action; empty where there are no masks."""
        if self.golden.masks is None or not isinstance(self.action_space, Discrete):
            return ()
        return tuple(Field(f"mask_{k}", 1) for k in range(int(self.action_space.n)))

    @cached_property
    def agent_fields(self) -> tuple[Field, ...]:
        """The fields of the word that a device delivers of an agent: its observation, then its masks."""
        return (*self.observation, *self.mask_fields)

    seen = renamed("seen", "agent_fields")

    @property
    def observation_shape(self) -> tuple[int, ...]:
        """The shape of one slot's row in a batch of observations."""
        space = self.observation_space
        return (len(space.spaces),) if isinstance(space, Tuple) else space.shape or ()

    @property
    def observation_size(self) -> int:
        """How many elements such a row has."""
        return math.prod(self.observation_shape)

    @property
    def observation_dtype(self) -> np.dtype[Any]:
        """The dtype of a batch of observations."""
        return np.dtype(
            np.int64 if isinstance(self.observation_space, Tuple) else self.observation_space.dtype
        )

    @property
    def id(self) -> str:
        """The name with its version, as in ``"CliffWalking-v0"``."""
        return f"{self.name}-v{self.version}"

    # It never changes, and pickled it comes back by what made it: see `pickling`.
    def __copy__(self) -> EnvSpec:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> EnvSpec:
        return self

    def __reduce_ex__(self, protocol: Any) -> Any:
        return reduced(self) or super().__reduce_ex__(protocol)

    def __getstate__(self) -> dict[str, Any]:
        # Not what is derived, such as `behaviour`: the functions may do something else where it is read.
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def with_options(self, also: Iterable[str] = (), /, **options: Any) -> EnvSpec:
        """Return the spec of this environment under the given keyword arguments.

        Raises ArgumentError for the first that it does not have. ``also`` are names that the caller takes
        himself, to be suggested where that is close to one.
        """
        if not options:
            return self
        known = list(inspect.signature(self.configure).parameters) if self.configure else []
        for name in options:
            if name not in known:
                meant = _MEANT.get(name, "")
                near = [meant] if meant in also else difflib.get_close_matches(name, [*known, *also], n=1)
                hint = f", did you mean {near[0]!r}?" if near else ""
                own = f"{self.name}'s own arguments: {', '.join(known) or 'none'}"
                raise ArgumentError(f"unknown argument {name!r}{hint} ({own})")
        assert self.configure is not None
        return self.configure(**{**self.options, **options})


_MEANT = {
    "num_envs": "n_agents",
    "n_envs": "n_agents",
    "n_agents": "num_envs",
    "max_episode_steps": "max_cycles",
    "max_steps": "max_cycles",
    "time_limit": "max_cycles",
}
"""What arguments of other packages are called here."""

TERMINATED = Field("terminated", 1)
"""What ``golden.step`` tells of an agent's end."""


def _told_apart(own: tuple[Field, ...], name: str) -> tuple[Field, ...]:
    """Return fields as messages name them: an only one by what it is, whatever its author calls it."""
    return own if len(own) > 1 else (replace(own[0], name=name),)


def _elements(space: Space[Any]) -> int:
    return len(space.spaces) if isinstance(space, Tuple) else math.prod(space.shape or ())


def _none_beyond(words: tuple[Result, ...], count: int, limit: str) -> tuple[Result, ...]:
    """Return what a role is due: after its own words only 0."""
    others = (Result(word.name, 0, 0, limit, "return 0 for it") for word in words[count:])
    return (*words[:count], *others)


def _check_part(spec: EnvSpec, role: Role, what: str, own: Space[Any], whole: Space[Any]) -> None:
    """Refuse a role's space that is no part of the spec's."""
    if isinstance(own, Discrete) and isinstance(whole, Discrete):
        fits = bool(own.start == whole.start and own.n <= whole.n)
    elif isinstance(own, Box) and isinstance(whole, Box) and what == "observation" and len(own.shape) == 1:
        fits = own.dtype == whole.dtype and len(whole.shape) == 1 and own.shape <= whole.shape
    else:
        fits = own == whole
    if not fits:
        raise ArgumentError(
            f"{spec.name}: the {what} space of role {role.name!r} is {own}, which is no part of {whole}; the "
            "spec's is as wide as the widest role's"
        )


def _fields_of(space: Space[Any]) -> tuple[Field, ...]:
    """Return the fields that an observation space takes, one an element."""
    whole = are_numbers(space) or (isinstance(space, Box) and np.issubdtype(space.dtype, np.integer))
    low, high = bounds(space) if whole else (np.array([-1]), np.array([0]))
    if low.min() < 0:
        raise ArgumentError(
            f"observation space {space} does not say how wide its words are; give Golden(view=...)"
        )
    words = (Field(f"observation_{k}", _width(int(end) + 1)) for k, end in enumerate(high.ravel()))
    return _told_apart(tuple(words), "observation")


def _width(count: int) -> int:
    """Return the bits of a number below ``count``."""
    return max(1, (count - 1).bit_length())


def _result(word: Field) -> Result:
    low, high = word.range
    wraps = f"{'i' if word.signed else 'u'}{word.bits}()" if word.bits in (8, 16, 32, 64) else f"& {high}"
    fix, limit = "`min` and `max` keep it in", f"{word.bits} bits hold" if word.bits > 1 else "1 bit holds"
    if (low, high) != word_range(word.bits, word.signed):
        limit = "its range is"
    elif "(" in wraps or low == 0:
        fix += f", and `{wraps}` lets it wrap around"
    return Result(word.name, low, high, limit, fix)


def check_spec(value: object) -> None:
    """Refuse what is no spec."""
    if not isinstance(value, EnvSpec):
        raise ArgumentError(f"spec is {value!r}; it must be an EnvSpec, as pearl_marl.get_spec returns")


def check_max_cycles(value: object) -> None:
    """Refuse a time limit that is no integer of ``0 .. 2**32 - 1``; ``None`` stands for the default."""
    if value is not None:
        checked_integer("max_cycles", value, 0, MAX_CYCLES, "; 0 is no limit")


def check_slots(name: str, value: object, first: int = 0) -> None:
    """Refuse a number of slots, called ``name``, that there cannot be from slot ``first`` on."""
    if first + checked_integer(name, value) > MAX_SLOTS:
        there = f" from slot {first:,} on" if first else ""
        raise ArgumentError(
            f"{name} is {value:,}; random draws can tell {MAX_SLOTS - first:,} apart{there}: take no more"
        )


class Itself(NamedTuple):
    """A spec that equals only itself, since not all that it has can be hashed."""

    spec: EnvSpec

    def __hash__(self) -> int:
        return id(self.spec)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Itself) and self.spec is other.spec
