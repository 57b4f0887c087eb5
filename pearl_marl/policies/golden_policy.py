"""A policy that an author writes as a golden function: ``act(view, draws)`` returns an action.

It is written as the functions of an environment are (:mod:`pearl_marl.golden`), and does the same in plain
Python and compiled.
"""

from __future__ import annotations

import hashlib
import inspect
import zlib
from functools import cache, cached_property, partial
from typing import Any

import numba
import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.base.machine_code import kept_code
from pearl_marl.compiler import scalar_words
from pearl_marl.compiler.addresses import address_of
from pearl_marl.compiler.loading import load
from pearl_marl.compiler.straight_line import golden_function
from pearl_marl.golden import MOST_DRAWS, GoldenFunction, call_reference
from pearl_marl.golden.tracing.checks import Argument, Result, check
from pearl_marl.golden.tracing.records import RULES, record
from pearl_marl.policies.device_policy import (
    ACT_ARGUMENTS,
    ActionChoice,
    CompiledPolicy,
    DevicePolicy,
)
from pearl_marl.spec import EnvSpec, Field, check_spec


class GoldenPolicy(DevicePolicy):
    """A golden function that chooses an agent's action.

    Parameters
    ----------
    spec
        The environment's.
    act
        ``act(view, draws)``: given what the environment's ``observe()`` returns, an object of its ``view``
        class, or without one a word or a tuple of words, it returns an action; a tuple, where actions have
        several fields.

    Attributes
    ----------
    of_words
        ``act`` as a function of the words of an observation and of draws.

    Raises
    ------
    ArgumentError
        The function cannot be traced, or returns what is no action for some observation. The message names
        the line.

    Examples
    --------
    >>> import pearl_marl
    >>> spec = pearl_marl.get_spec("CartPole")
    >>> def act(view, draws):
    ...     return view.angle + view.angular_velocity > 0
    >>> policy = GoldenPolicy(spec, act)
    """

    def __init__(self, spec: EnvSpec, act: GoldenFunction) -> None:
        check_spec(spec)
        self.spec = spec
        self.of_words = spec.act_of_words(act)
        inputs = tuple(Argument(f.name, f.bits, f.signed, *f.range) for f in self._inputs(MOST_DRAWS))
        ends = [(0, n - 1) for n in spec.action_counts] or [field.range for field in spec.action_fields]
        due = tuple(
            Result(field.name, *pair, "the action space has", "return an action of it")
            for field, pair in zip(spec.action_fields, ends, strict=True)
        )
        check(self.of_words, inputs, due)
        self.draws = spec.draws_of(act)

    def _inputs(self, draws: int) -> list[Field]:
        return [*self.spec.observation, *(Field(f"draw_{k}", 32) for k in range(draws))]

    def form(self, spec: EnvSpec) -> EnvSpec:
        """See :class:`DevicePolicy`: the words that ``observe()`` returns."""
        return spec.in_words

    def choose(self, elements: Array, agents: Array, masks: Array | None, draws: Array) -> ActionChoice:
        """See :class:`DevicePolicy`."""
        columns = call_reference(self.of_words, [*elements.reshape(len(elements), -1).T, *draws.T])
        words = np.stack([np.broadcast_to(column, len(elements)) for column in columns], 1).astype(np.int64)
        if masks is not None:
            forbidden = masks[np.arange(len(words)), words[:, 0]] == 0
            words[forbidden, 0] = masks[forbidden].argmax(1)
        return ActionChoice(words, None)

    @cached_property
    def number(self) -> int:
        """What names the function to hardware, 31 bits: a hash of what it does to the words that it is given.

        It is the same in every process, whatever variables are called, as that of an environment is
        (:attr:`pearl_marl.spec.EnvSpec.behaviour`).
        """
        inputs = [(f.bits, f.signed, *f.range) for f in self._inputs(self.draws)]
        return zlib.crc32(f"{RULES}:{record(self.of_words, inputs)}".encode()) & 0x7FFFFFFF

    @cached_property
    def source(self) -> str:
        """What is compiled of it."""
        spec, inputs = self.spec, self._inputs(self.draws)
        count, element = len(spec.observation), spec.in_words.observation_dtype
        columns = [f"np.{f.dtype}(elements_of[s, {k}])" for k, f in enumerate(inputs[:count])]
        given = ", ".join([*columns, *(f"draws[s, {k}]" for k in range(self.draws))])
        chosen = ", ".join(f"action_{k}" for k in range(len(spec.action_fields)))
        lines = [
            *golden_function("act", self.of_words, inputs, spec.action_fields),
            "",
            "",
            "def act_all(at, elements, masks, draws, words, logits):",
            f"    elements_of = elements.view(np.{np.uint8 if element == np.bool_ else element})"
            f".reshape((len(words), {count}))",
            "    for s in range(len(words)):",
            f"        {chosen} = act({given})",
            *(f"        words[s, {k}] = action_{k}" for k in range(len(spec.action_fields))),
        ]
        if spec.mask_fields:
            lines += [
                "        if not masks[s, action_0]:",
                "            words[s, 0] = masks[s].argmax()",
            ]
        return "\n".join(lines)


def compiled(policy: GoldenPolicy, elements: np.dtype[Any]) -> CompiledPolicy:
    """Return a policy as a rollout calls it; its elements have one dtype only."""
    parts = policy.source, inspect.getsource(scalar_words), numba.__version__, np.__version__
    digest = hashlib.sha256(repr(parts).encode()).hexdigest()
    act = _loaded(f"{policy.spec.name}_act_{digest[:16]}", policy.source)
    return CompiledPolicy(address_of(act, *ACT_ARGUMENTS), np.zeros(1, np.int64), policy.draws, act)


@cache
def _loaded(name: str, source: str) -> Any:
    """Return a policy's loop; its name is a hash of all that the code depends on."""
    inlined = partial(numba.njit, error_model="numpy", forceinline=True)
    words = {name: inlined(operation) for name, operation in scalar_words.operations().items()}
    module, _ = load(name, source, inlined=inlined, **words)
    return kept_code(numba.njit(nogil=True, error_model="numpy")(module.act_all), name)
