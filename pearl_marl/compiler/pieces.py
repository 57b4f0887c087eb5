"""The pieces of source that the kernels of the CPU and those of the GPU are both put together from.

A piece is an expression or a list of lines. Where words lie and how slots are gone through differs, and comes
in as expressions. Variables that stand for a field are named as :data:`PREFIXES` says.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from pearl_marl.batch import slot_memory
from pearl_marl.compiler.straight_line import maskers, observers
from pearl_marl.spec import EnvSpec, Field

PREFIXES = {
    "block": "the field's words of the block of slots at hand",
    "stored": "the same of the stored starts",
    "at": "where the field's column begins",
    "word": "the slot's word of the field",
    "new": "what a golden function returned for the field, not yet narrowed to its dtype",
    "observed": "what observe() returned for a field of the observation, likewise",
    "given": "the words of a field of the observation, as a device delivered them",
    "part": "what of those words belongs to the block at hand",
}
"""What a variable holds whose name is prefix, underscore and field. Nothing else in a kernel begins so,
and no keyword: a field may be called anything, ``i`` and ``for`` too."""


def each(pattern: str, values: Iterable[object]) -> list[str]:
    """Return what a pattern makes of names or numbers: ``block_row`` and ``block_column`` of ``block_{}``."""
    return [pattern.format(value) for value in values]


def narrowed(fields: Iterable[Field], values: Iterable[str]) -> list[str]:
    """Return values in the dtypes of their fields."""
    return [f"np.{f.dtype}({value})" for f, value in zip(fields, values, strict=True)]


def assign(targets: Iterable[str], values: Iterable[str]) -> list[str]:
    """Return an assignment a line."""
    return [f"{target} = {value}" for target, value in zip(targets, values, strict=True)]


def call(function: str, arguments: Iterable[str], results: Iterable[str]) -> str:
    """Return the call of a golden function."""
    return f"{', '.join(results)} = {function}({', '.join(arguments)})"


def key(chain: object, tick: str, draw: object) -> str:
    """Return one of the two keys of a draw, which are the same for all slots."""
    return f"key(u32({chain}), u32(seed_0), u32(seed_1), np.uint64({tick}), u32({draw}))"


def indented(lines: Iterable[str]) -> list[str]:
    """Return lines of source one level further in."""
    return [f"    {line}" for line in lines]


def start(stored: Iterable[str], fresh: Iterable[str]) -> list[str]:
    """Return how an episode begins: as it is stored, or afresh."""
    return ["if use_stored:", *indented(stored), "else:", *indented(fresh)]


def filled(template: str, words: dict[str, str], parts: dict[str, list[str]]) -> str:
    """Return a template with ``$WORD`` replaced anywhere, and each line that is only ``$part`` by lines.

    ``$PREFIXES`` stands for the explanation of those that are in use.
    """
    text = re.sub(
        r"^( *)\$([a-z_]+)\n",
        lambda match: "".join(f"{match[1]}{line}\n" for line in parts[match[2]]),
        template,
        flags=re.MULTILINE,
    )
    used = (p for p in PREFIXES if re.search(rf"\b{p}_", text))
    words["PREFIXES"] = "\n".join(f"    {f'{p}_x':<12}{PREFIXES[p]}" for p in used)
    return re.sub(r"\$([A-Z_]+)", lambda match: words[match[1]], text)


def cell_dtype(spec: EnvSpec) -> np.dtype[Any]:
    """Return what an element of an observation is written as: of a bool the byte."""
    return np.dtype(np.uint8 if spec.observation_dtype == np.bool_ else spec.observation_dtype)


class Pieces:
    """The pieces of one environment.

    Patterns say where what the agents of a slot see goes: ``element`` of observations, ``row`` of those that
    are unpacked (its arguments are what to add to the row's first element and to its end), ``mask`` of masks.
    """

    def __init__(self, spec: EnvSpec, element: str, row: str, mask: str) -> None:
        self.spec, self.element, self.row, self.mask = spec, element, row, mask
        self.agents = spec.agents
        self.state = [f.name for f in spec.state]
        self.observation = [f.name for f in spec.observation]
        self.seen = [f.name for f in spec.seen]
        self.new = each("new_{}", self.state)
        self.narrow = narrowed(spec.state, self.new)
        self.reset_draws = range(spec.reset_draws)
        self.step_draws = range(spec.reset_draws, spec.reset_draws + spec.step_draws)
        self.table = "table"
        self.categories = 0 if spec.rewards is None else 1 << spec.reward.bits
        self.dtype = cell_dtype(spec)
        pad = slot_memory.ALIGNMENT
        self.padded = f"p = (n + {pad - 1}) // {pad} * {pad}  # slots of a column, padded"

    def each_agent(self, name: str, own: int = 1) -> list[str]:
        """Return the names of a variable of every agent of a slot: numbered, where there are several.

        ``own`` is how many such variables an agent has, one after the other.
        """
        count = self.agents * own
        return [name] if count == 1 else [f"{name}{k}" for k in range(count)]

    def of_agents(self, array: str, own: int = 1) -> list[str]:
        """Return where a slot's agents have their elements of an array, of which each has ``own``."""
        count = self.agents * own
        return [f"{array}[i]"] if count == 1 else [f"{array}[{count} * i + {k}]" for k in range(count)]

    def actions(self, array: str) -> list[str]:
        """Return the words of a slot's actions in an array of them, each in its field's dtype."""
        fields, common = self.spec.action_fields, self.spec.action_dtype
        places = zip(self.agents * fields, self.of_agents(array, len(fields)), strict=True)
        return [at if f.dtype == common else f"np.{f.dtype}({at})" for f, at in places]

    def reward(self, code: str, index: str) -> str:
        """Return the reward of a code, which is ``index`` where rewards are looked up."""
        if self.categories:
            return f"{self.table}[{index} & {self.categories - 1}]"
        return f"np.float32({code})" + _scale("float32", self.spec.reward)

    def observe(self, state: Iterable[str]) -> list[str]:
        """Return what makes the observations and masks of a slot in a state."""
        lines, state, words = [], list(state), each("observed_{}", self.seen)
        for k in range(self.agents):
            lines += [*self.look(state, k), *self.judge(state, k)]
            lines += [*self.deliver(words, k), *self.masks(words, k)]
        return lines

    def look(self, state: Sequence[str], agent: int) -> list[str]:
        """Return what finds the words that an agent observes."""
        shown = each("observed_{}", self.observation)
        return [call(observers(self.spec)[agent], state, shown)]

    def judge(self, state: Sequence[str], agent: int) -> list[str]:
        """Return what finds the words of an agent's masks, if there are any."""
        flags = each("observed_{}", self.seen[len(self.observation) :])
        return [call(maskers(self.spec)[agent], state, flags)] if flags else []

    def masks(self, words: Sequence[str], agent: int = 0) -> list[str]:
        """Return what writes an agent's masks, the last of the words that it is shown."""
        flags = words[len(self.spec.observation) :]
        places = each(self.mask, range(agent * len(flags), (agent + 1) * len(flags)))
        return assign(places, each("np.int8({})", flags))

    def deliver(self, words: Iterable[str], agent: int = 0) -> list[str]:
        """Return what makes an observation of the words that are shown, one by one or by ``unpack``."""
        fields, size = self.spec.observation, self.spec.observation_size
        own = narrowed(fields, list(words)[: len(fields)])
        if self.spec.unpack is not None:
            more = f" + {agent * size}" if agent else ""
            return [f"unpack({', '.join(own)}, {self.row.format(more)})"]
        values = (element(word, field, self.dtype) for word, field in zip(own, fields, strict=True))
        return assign(each(self.element, range(agent * size, (agent + 1) * size)), values)


def times(count: int, what: str) -> str:
    """Return a product; where the count is 1, what there is that often."""
    return what if count == 1 else f"{count} * {what}"


def element(word: str, field: Field, dtype: np.dtype[Any]) -> str:
    """Return the element of a row that a word of a field is delivered as."""
    return f"np.{dtype}({word}){_scale(str(dtype), field)}"


def _scale(dtype: str, field: Field) -> str:
    return f" * np.{dtype}({2.0**-field.fraction!r})" if field.fraction else ""
