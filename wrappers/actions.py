"""Wrappers that change actions, each as SuperSuit's of the same name unless it says otherwise."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space

from pearl_marl.base.arrays import Array
from pearl_marl.batch.actions import random_allowed, random_numbers
from pearl_marl.batch.step import BatchStep
from pearl_marl.checks import checked_function, checked_number
from pearl_marl.errors import ArgumentError
from pearl_marl.interfaces.batch import Batch
from pearl_marl.interfaces.world import Mask
from pearl_marl.spec.elements import ActionSpace

from .base import Env, box, checked, differing, wrap
from .transform import Rows, Transform


class _MappedActions(Transform):
    """Actions through a function of whole batches."""

    def __init__(
        self, batch: Batch, observation_space: Space[Any], action_space: Any, change: Callable[[Array], Array]
    ) -> None:
        super().__init__(batch, observation_space, action_space)
        self._change = change

    def actions(self, actions: Array) -> Array:
        return self._change(actions)


class _Checked(_MappedActions):
    """Refuses what is not in the space shown, which the environment inside would not know of."""

    def actions(self, actions: Array) -> Array:
        self.check(actions)
        return super().actions(actions)


def action_lambda_v1(
    env: Env,
    change_action_fn: Callable[[Array, Any], Array],
    change_space_fn: Callable[[Any], ActionSpace],
) -> Any:
    """Change actions by a function of the whole batch.

    Parameters
    ----------
    change_action_fn
        Takes actions of shape ``(n, ...)`` and one agent's space inside; returns as many rows for there.
    change_space_fn
        Takes one agent's space inside and returns the one to show.
    """
    checked_function("change_action_fn", change_action_fn)
    checked_function("change_space_fn", change_space_fn)

    def make(batch: Batch, space: Space[Any], inside: Any) -> Transform:
        new_space = change_space_fn(inside)
        if not isinstance(new_space, ActionSpace):
            raise ArgumentError(
                f"change_space_fn made {new_space}; possible are Discrete, MultiDiscrete, MultiBinary and Box"
            )

        return _Checked(batch, space, new_space, partial(_by_function, change_action_fn, inside))

    return wrap(env, make)


def _by_function(change_action_fn: Callable[[Array, Any], Array], inside: Any, actions: Array) -> Array:
    return np.asarray(change_action_fn(actions, inside))


class _Clip(Transform):
    def actions(self, actions: Array) -> Array:
        limits: Any = self.action_space
        clipped: Array = np.clip(actions, limits.low, limits.high)
        return clipped

    def possible(self, actions: Array) -> Mask:
        return ~_nan_rows(actions) | super().possible(actions)


def clip_actions_v0(env: Env) -> Any:
    """Move actions beyond the bounds of their ``Box`` to the bounds."""

    def make(batch: Batch, space: Space[Any], action_space: Any) -> Transform:
        return _Clip(batch, space, box(action_space, "clip_actions_v0", "actions"))

    return wrap(env, make)


def scale_actions_v0(env: Env, scale: float) -> Any:
    """Multiply actions in a ``Box`` by ``scale``.

    As in SuperSuit the bounds shown are those inside times ``scale`` too, so it is for policies whose
    actions are ``scale`` times too small: put :func:`clip_actions_v0` inside to catch larger ones.
    """

    def make(batch: Batch, space: Space[Any], action_space: Any) -> Transform:
        old = box(action_space, "scale_actions_v0", "actions")
        checked_number("scale", scale, above=0)
        new = Box(old.low * scale, old.high * scale, dtype=np.float32)
        return _MappedActions(batch, space, new, partial(np.multiply, scale))

    return wrap(env, make)


class _PaddedActions(Transform):
    """Action 0 in place of those beyond an agent's own space."""

    def __init__(self, batch: Batch, space: Space[Any], action_space: Any) -> None:
        super().__init__(batch, space, action_space)
        self.world = batch.world.with_spaces(None, action_space)
        own: list[Any] = [role.action_space for role in batch.world.roles]
        self._counts = np.tile([space.n for space in own], self.n // batch.world.agents)

    def actions(self, actions: Array) -> Array:
        self.check(actions)
        return np.where(actions < self._counts, actions, actions.dtype.type(0))


def pad_action_space_v0(env: Env) -> Any:
    """Pad action spaces to the widest role's; what is beyond an agent's own becomes action 0.

    Where all agents are alike this returns ``env`` as it is.
    """
    return wrap(env, _PaddedActions) if differing(checked(env).batch, "action_space") else env


class _NoNans(Transform):
    """Something else in place of actions that are not a number, or of which one element is not."""

    def __init__(self, batch: Batch, space: Space[Any], action_space: Any) -> None:
        super().__init__(batch, space, action_space)
        self.action_rules.kinds = "iuf"  # NaN is a float, whatever the action space

    def actions(self, actions: Array) -> Array:
        if actions.dtype.kind != "f":
            return actions
        rows = np.flatnonzero(_nan_rows(actions))
        if rows.size:
            actions = actions.copy()
            actions[rows] = self.instead(rows)
        if isinstance(self.action_space, Box):
            return actions
        self.check(actions)
        return actions.astype(np.int64)

    def possible(self, actions: Array) -> Mask:
        return _nan_rows(actions) | super().possible(actions)

    def instead(self, rows: Rows) -> Array:
        """Return actions for these rows."""
        raise NotImplementedError


class _NanNoop(_NoNans):
    def __init__(self, batch: Batch, space: Space[Any], action_space: Any, action: Any) -> None:
        super().__init__(batch, space, action_space)
        self._action = np.asarray(action)

    def instead(self, rows: Rows) -> Array:
        return self._action


class _NanRandom(_NoNans):
    def instead(self, rows: Rows) -> Array:
        draws, masks = self.draws()[rows], self.batch.action_masks
        return (
            random_numbers(self.action_space, draws) if masks is None else random_allowed(masks[rows], draws)
        )


def nan_noop_v0(env: Env, no_op_action: Any) -> Any:
    """Take ``no_op_action`` where an action is not a number."""

    def make(batch: Batch, space: Space[Any], action_space: Any) -> Transform:
        if no_op_action not in action_space:
            raise ArgumentError(f"no_op_action is {no_op_action!r}, which is not in {action_space}")
        return _NanNoop(batch, space, action_space, no_op_action)

    return wrap(env, make)


def nan_zeros_v0(env: Env) -> Any:
    """Take zero where an action is not a number."""
    return wrap(
        env, lambda batch, space, actions: _NanNoop(batch, space, actions, np.zeros(actions.shape or ()))
    )


def nan_random_v0(env: Env) -> Any:
    """Take a random action where one is not a number, drawn for each agent and step from the seed.

    Where there are masks, it is one that may be taken.
    """
    return wrap(env, _NanRandom)


class _Sticky(Transform):
    """Now and then the action of the step before; never in the first step of an episode."""

    def __init__(self, batch: Batch, space: Space[Any], action_space: Any, probability: float) -> None:
        super().__init__(batch, space, action_space)
        self._below = round(probability * 2**32)
        dtype = np.float64 if "f" in self.action_rules.kinds else np.int64
        self._taken = np.zeros((self.n, *(action_space.shape or ())), dtype)
        self._may_stick = np.zeros(self.n, np.bool_)
        self.memory = {"taken": self._taken, "may_stick": self._may_stick}
        self._sent: Array = self._taken

    def is_possible(self, name: str, saved: dict[str, Array]) -> bool:
        # Of those that may be taken again; and a wrapper inside may have taken what is no number.
        return name != "taken" or bool((self.possible(saved["taken"]) | ~saved["may_stick"]).all())

    def actions(self, actions: Array) -> Array:
        self.check(actions)  # or whether a bad one is refused would be left to chance
        sticks = np.flatnonzero(self._may_stick & (self.draws() < self._below))
        masks = self.batch.action_masks
        if masks is not None:
            sticks = sticks[masks[sticks, self._taken[sticks]] != 0]
        self._sent = actions.astype(self._taken.dtype)
        self._sent[sticks] = self._taken[sticks]
        return self._sent

    def results(self, step: BatchStep) -> BatchStep:
        # Only now is it sure that the actions were not refused.
        self._taken[...] = self._sent
        self._may_stick[:] = True
        return super().results(step)

    def episode_began(self, rows: Rows) -> None:
        self._may_stick[rows] = False


def sticky_actions_v0(env: Env, repeat_action_probability: float) -> Any:
    """Repeat an agent's last action with a probability, drawn for each agent and step from the seed.

    Where there are masks, one that is masked now is not repeated. SuperSuit draws the same for every agent if
    there is a seed.
    """
    probability = checked_number("repeat_action_probability", repeat_action_probability, least=0, below=1)
    return wrap(env, _Sticky, probability)


def _nan_rows(actions: Array) -> Mask:
    """Return whose actions are not a number, or have an element that is not."""
    if actions.dtype.kind != "f":
        return np.zeros(len(actions), np.bool_)
    nan: Any = np.isnan(actions).reshape(len(actions), -1).any(1)
    return np.asarray(nan)
