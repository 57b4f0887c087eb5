"""TorchRL's ``EnvBase`` around a ``ParallelEnv``: worlds are its batch, and their agents its groups."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium.spaces import Box, Discrete, Space, Tuple
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, MultiCategorical, TensorSpec, Unbounded
from torchrl.envs import EnvBase

from pearl_marl.base.arrays import Array
from pearl_marl.batch.actions import random_allowed
from pearl_marl.checks import checked_flag
from pearl_marl.devices.by_name import make_host_device
from pearl_marl.errors import ArgumentError
from pearl_marl.interfaces.parallel import PearlParallelEnv
from pearl_marl.spec import Role
from pearl_marl.spec.elements import action_counts, bounds

from .episodes import skips_frames
from .waiting import WaitingWorlds, WorldsStep

FLAGS = "done", "terminated", "truncated"


def to_torchrl(env: Any, *, state: bool = False) -> TorchRLEnv:
    """Make a TorchRL environment of a :func:`pearl_marl.parallel_env`.

    ::

        env = to_torchrl(pearl_marl.parallel_env("LevelBasedForaging", n_agents=2048))
        env.batch_size, env.group_map  # (1024,), {"agents": ["agent_0", "agent_1"]}

    Parameters
    ----------
    env
        Made with ``autoreset=True`` and ``copy=True``; in this package's wrappers or none. It is the result's
        from now on, which keeps its time limit: ``env.max_cycles`` becomes 0.
    state
        Whether ``"state"`` is shown, ``env.state()`` in ``float32``, for critics that see all of a world.

    Raises
    ------
    ArgumentError
        It is no such environment, or in a wrapper that skips frames.
    """
    checked_flag("state", state)
    return TorchRLEnv(_checked(env), state)


class _RoleGroup(NamedTuple):
    """The agents of one role."""

    role: Role
    members: list[int]
    """Where in a world they are."""

    def own(self, rows: Array, space: Space[Any] | None = None) -> torch.Tensor:
        """Return their part of an array of shape ``(n, K, ...)``: of their rows, what is in their space."""
        first, last, size = self.members[0], self.members[-1], len(self.members)
        own = rows[:, first : last + 1] if last - first < size else rows[:, self.members]
        if isinstance(space, Discrete):  # masks: as many actions as there are
            own = own[..., : space.n]
        elif isinstance(space, Box) and len(space.shape) == 1:
            own = own[..., : space.shape[0]]
        return torch.from_numpy(own)


class TorchRLEnv(EnvBase):  # type: ignore[misc]  # torchrl has no types
    """The worlds of an environment as TorchRL's batch; made by :func:`to_torchrl`.

    ``batch_size`` is ``(n_worlds,)``. The ``K`` agents of a role are a group, in ``group_map``: ``"agents"``
    where all are alike, else the names of the roles. Of ``n`` worlds, a tensordict has

    ``(group, "observation")``
        Shape ``(n, K, ...)``. Where an episode ended, its last; ``reset`` then shows the first of the next.
    ``(group, "action_mask")``
        ``bool``, shape ``(n, K, n_actions)``, where there are masks. An agent without a choice, being
        over or not on turn, may take action 0, which is ignored.
    ``(group, "reward")``
        ``float32``, shape ``(n, K, 1)``.
    ``"done"``, ``"terminated"``, ``"truncated"``
        Of the world, shape ``(n, 1)``: it is to be reset; because all its agents have terminated; because of
        its time limit.
    ``(group, "done")`` and so on
        Of each agent, shape ``(n, K, 1)``. One that ended before its world is done until that is reset.
    ``"state"``
        ``float32``, shape ``(n, fields)``, if it was asked for; zeros where a world has terminated.

    Tensors share the memory of the arrays that a step returns. Random actions are ones that may be taken.

    ``max_cycles`` is the time limit, 0 for none.
    """

    def __init__(self, env: PearlParallelEnv, state: bool) -> None:
        super().__init__(device="cpu", batch_size=(env.n_worlds,))
        self.env = env
        self._worlds = WaitingWorlds(env)
        self._with_state = state
        self._next_seed: int | None = None
        self._groups = _groups(env)
        self.group_map = {
            name: [env.possible_agents[member] for member in group.members]
            for name, group in self._groups.items()
        }
        self._make_specs()

    @property
    def max_cycles(self) -> int:
        """The time limit, 0 for none; ``None`` assigns the environment's own."""
        return self._worlds.max_cycles

    @max_cycles.setter
    def max_cycles(self, value: int | None) -> None:
        self._worlds.max_cycles = replace(self.env.device.config, max_cycles=value).limit

    def _make_specs(self) -> None:
        seen, acted, rewarded = Composite(), Composite(), Composite()
        done = Composite({flag: _bools((1,)) for flag in FLAGS})
        for name, (role, members) in self._groups.items():
            k = (len(members),)
            shown = {"observation": _spec(role.observation_space, k)}
            if self.env.batch.world.masked:
                shown["action_mask"] = _bools((*k, action_counts(role.action_space)[0]))
            seen[name] = Composite(shown, shape=k)
            acted[name] = Composite({"action": _spec(role.action_space, k)}, shape=k)
            rewarded[name] = Composite({"reward": Unbounded((*k, 1))}, shape=k)
            done[name] = Composite({flag: _bools((*k, 1)) for flag in FLAGS}, shape=k)
        if self._with_state:
            space = self.env.state_space
            low, high = (bound[0].astype(np.float32) for bound in (space.low, space.high))
            seen["state"] = _spec(Box(low, high, dtype=np.float32), ())
        self.full_observation_spec_unbatched = seen
        self.full_action_spec_unbatched = acted
        self.full_reward_spec_unbatched = rewarded
        self.full_done_spec_unbatched = done

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        chosen = None if tensordict is None else tensordict.get("_reset", None)
        if chosen is None:
            shown = self._worlds.reset(self._next_seed)
            self._next_seed = None
        else:
            shown = self._worlds.reset_some(chosen.reshape(-1).cpu().numpy())
        return self._tensordict(shown)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._tensordict(self._worlds.step(self._actions(tensordict)), rewarded=True)

    def _actions(self, tensordict: TensorDictBase) -> Array:
        """Return the actions of all groups, a row an agent."""
        worlds = self._worlds
        actions = {name: tensordict.get((name, "action")).cpu().numpy() for name in self._groups}
        if len(actions) == 1:
            (whole,) = actions.values()
        else:
            first = next(iter(actions.values()))
            whole = np.empty((worlds.n, worlds.k, *first.shape[2:]), first.dtype)
            for name, group in self._groups.items():
                whole[:, group.members] = actions[name]
        rows: Array = whole.reshape(worlds.n * worlds.k, *whole.shape[2:])
        return rows

    def _tensordict(self, step: WorldsStep, rewarded: bool = False) -> TensorDictBase:
        def flags(terminated: Array, truncated: Array) -> dict[str, Array]:
            columns = terminated | truncated, terminated, truncated
            return {flag: column[..., None] for flag, column in zip(FLAGS, columns, strict=True)}

        n, agents = len(step.obs), flags(step.terminated, step.truncated)
        if rewarded:
            agents["reward"] = step.rewards[..., None]
        worlds = flags(step.world_terminated, step.world_truncated)
        out: dict[str, Any] = {flag: torch.from_numpy(column) for flag, column in worlds.items()}
        for name, group in self._groups.items():
            own = {key: group.own(rows) for key, rows in agents.items()}
            own["observation"] = group.own(step.obs, group.role.observation_space)
            if step.masks is not None:
                own["action_mask"] = group.own(step.masks, group.role.action_space)
            out[name] = TensorDict(own, batch_size=(n, len(group.members)), device=self.device)
        if self._with_state:
            out["state"] = torch.from_numpy(self._worlds.state())
        return TensorDict(out, batch_size=(n,), device=self.device)

    def rand_action(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        """Draw actions, uniformly among those that may be taken, into ``tensordict`` or a new one."""
        worlds = self._worlds
        masks = worlds.action_masks if self.env.ready else None
        if masks is None:
            return super().rand_action(tensordict)
        draws = torch.randint(1 << 32, (worlds.n * worlds.k,)).numpy().astype(np.uint32)
        actions = random_allowed(masks.reshape(len(draws), -1).view(np.int8), draws)
        drawn = TensorDict(batch_size=self.batch_size) if tensordict is None else tensordict
        for name, group in self._groups.items():
            drawn[name, "action"] = group.own(actions.reshape(worlds.n, worlds.k)).to(self.device)
        return drawn

    def _set_seed(self, seed: int | None) -> None:
        """Set the seed of the next reset of all worlds, which draw different numbers from it."""
        self._next_seed = seed

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Close the environment inside."""
        super().close(raise_if_closed=raise_if_closed)
        self.env.close()


def _checked(env: Any) -> PearlParallelEnv:
    """Return an environment that TorchRL can have, or refuse it."""
    if not isinstance(env, PearlParallelEnv):
        raise ArgumentError(
            f"{type(env).__name__} is no environment of this package's parallel_env; to_torchrl takes those, "
            "in this package's wrappers or none"
        )
    if not env.autoreset:
        raise ArgumentError(
            "agents of autoreset=False leave when their episode ends, and TorchRL's stay: make the "
            "environment with autoreset=True"
        )
    if not make_host_device(env.device).config.copy:
        raise ArgumentError(
            "copy=False lets the next step overwrite results, and TorchRL keeps them: make the environment "
            "with copy=True"
        )
    if skips_frames(env):
        raise ArgumentError(
            "the time limit counts steps of the environment, and frame_skip_v0 takes several in one: use "
            "TorchRL's FrameSkipTransform instead"
        )
    return env


def _groups(env: PearlParallelEnv) -> dict[str, _RoleGroup]:
    """Return the groups of a world's agents by their names."""
    roles = env.batch.world.roles
    if not roles:
        space = env.batch.observation_space, env.batch.action_space
        return {"agents": _RoleGroup(Role("agent", *space), list(range(env.agents_per_world)))}
    groups: dict[str, _RoleGroup] = {}
    for member, role in enumerate(roles):
        group = groups.setdefault(role.name, _RoleGroup(role, []))
        if group.role != role:
            raise ArgumentError(
                f"two roles are named {role.name!r} and differ in their spaces, which a group has in common: "
                "give each a name"
            )
        group.members.append(member)
    return groups


def _bools(shape: tuple[int, ...]) -> TensorSpec:
    return Categorical(2, shape=shape, dtype=torch.bool)


def _spec(space: Space[Any], agents: tuple[int, ...]) -> TensorSpec:
    """Return TorchRL's spec of a space for so many agents."""
    if not isinstance(space, Box):
        first, last = bounds(space)
        shape = (*agents, *first.shape)
        dtype = torch.int64 if isinstance(space, Tuple) else getattr(torch, str(space.dtype))
        if first.any() or first.ndim > 1:
            low, high = (torch.from_numpy(np.broadcast_to(end, shape).copy()) for end in (first, last))
            return Bounded(low, high, shape=shape, dtype=dtype)
        if first.ndim:
            return MultiCategorical((last + 1).tolist(), shape=shape, dtype=dtype)
        return Categorical(int(last) + 1, shape=shape, dtype=dtype)
    shape = (*agents, *space.shape)
    if space.dtype == np.bool_:
        return _bools(shape)
    low, high = (torch.from_numpy(np.broadcast_to(bound, shape).copy()) for bound in (space.low, space.high))
    if math.prod(shape) and torch.isinf(low).all() and torch.isinf(high).all():
        return Unbounded(shape, dtype=low.dtype)
    return Bounded(low, high, shape=shape, dtype=low.dtype)
