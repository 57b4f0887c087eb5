"""Networks in integers: sums of products that are exact, so that every device computes the same.

The first layer takes elements of observations in one of three ways (:class:`Scaling`, :class:`Rows`,
:class:`Patches`). A layer's sums are shifted to the right and then looked up in a table of 1,024 numbers, or
cut at both ends. The last sums are *logits*, of which each field of an action takes the greatest, or one that
is drawn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pearl_marl.base.arrays import Array
from pearl_marl.errors import ArgumentError
from pearl_marl.policies.device_policy import ActionChoice, DevicePolicy
from pearl_marl.spec import EnvSpec
from pearl_marl.spec.elements import bounds

ENTRIES = 1024
"""Numbers in a table: of activations for sums from -512 on, of weights for distances from 0 on."""

HALF = ENTRIES // 2

MOST = (1 << 15) - 1
"""The greatest of weights and of what they are multiplied by, which have 16 bits, sign included."""

SUM_BITS = 32
"""Width of sums, sign included."""

# Elements that go through all layers at once: what they become on the way stays in the processor's cache.
_BLOCK = 1 << 15


class Scaling(NamedTuple):
    """Elements become inputs: ``(element - offset) * multiplier >> shift``, cut at both limits."""

    offset: Array  # int64, one an element
    multiplier: Array  # int64
    shift: Array  # int64
    limit: int


class Rows(NamedTuple):
    """Elements choose rows of a table, ``first + factors @ elements``, which are added to the first sums.

    With a row of factors for each element, each chooses for itself, as in a one-hot form. With one row of
    factors the elements choose together, as in a table of action values: such a network needs no more than
    its last layer.
    """

    first: Array  # int64, one a choice
    factors: Array  # int64, of shape (choices, elements)
    table: Array  # int32, of shape (rows, width)


class Patches(NamedTuple):
    """Elements are planes of numbers from 0 on, of which patches of 3 by 3 are multiplied by ``weights``.

    Elements are shifted right by ``element_shift`` first: those of planes of floats have many bits behind the
    binary point.
    """

    shape: tuple[int, int, int]  # rows, columns, planes: planes are the last axis
    weights: Array  # int16, of shape (filters, 3, 3, planes)
    bias: Array  # int32, one a filter
    shift: int
    limit: int
    element_shift: int = 0


class Dense(NamedTuple):
    """A layer: ``weights @ inputs + bias``, and what its sums become."""

    weights: Array  # int16, of shape (outputs, inputs)
    bias: Array  # int32
    shift: int = 0
    activation: Array = np.zeros(0, np.int16)  # of 1,024 entries; if empty, sums are cut at 0 and the limit
    limit: int = 0


class Head(NamedTuple):
    """How logits become an action.

    ``counts`` are the logits of each field of an action. With ``weights`` a logit is drawn: one that is ``d``
    less than the greatest has the weight ``weights[d >> shift]``, and one further away than the table goes
    the last weight. Without, the greatest is taken, the first of equals.
    """

    counts: tuple[int, ...]
    shift: int = 0
    weights: Array = np.zeros(0, np.int32)  # 0 to 65535, of 1,024 entries


class Levels(NamedTuple):
    """How sums become an action of a ``Box``: ``sum * multiplier + offset >> shift``, cut at the ends."""

    multiplier: Array  # int64, one a field
    offset: Array
    shift: int
    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class IntegerNetwork(DevicePolicy):
    """A network of integers that chooses actions.

    ``indicator`` has a row for each agent of a world, ``int32`` of shape ``(agents, width)``, which is added
    to its first sums; no rows where they are not told apart.
    """

    spec: EnvSpec
    inputs: Scaling | Rows | Patches
    indicator: Array
    layers: tuple[Dense, ...]
    head: Head | Levels

    def __post_init__(self) -> None:
        _check(self)

    @property
    def draws(self) -> int:  # type: ignore[override]
        """How many random numbers an action takes: one a field, if actions are drawn."""
        return len(self.head.counts) if isinstance(self.head, Head) and len(self.head.weights) else 0

    @property
    def logits(self) -> int:  # type: ignore[override]
        """How many logits an action is chosen by; none, where sums are levels."""
        return 0 if isinstance(self.head, Levels) else sum(self.head.counts)

    def choose(self, elements: Array, agents: Array, masks: Array | None, draws: Array) -> ActionChoice:
        """See :class:`DevicePolicy`."""
        sums = self.sums(elements, agents)
        if isinstance(self.head, Levels):
            head = self.head
            words = (sums.astype(np.int64) * head.multiplier + head.offset) >> head.shift
            return ActionChoice(words.clip(head.low, head.high), None)
        words = np.empty((len(sums), len(self.head.counts)), np.int64)
        for field, logits in enumerate(np.split(sums, np.cumsum(self.head.counts)[:-1], 1)):
            words[:, field] = self._chosen(logits, masks, draws[:, field] if self.draws else None)
        return ActionChoice(words, sums)

    def sums(self, elements: Array, agents: Array) -> npt.NDArray[np.int32]:
        """Return what the last layer adds up, of shape ``(n, outputs)``."""
        sums = np.empty((len(elements), len(self.layers[-1].bias)), np.int32)
        at_once = max(1, _BLOCK // self.spec.observation_size)
        for start in range(0, len(sums), at_once):
            rows = slice(start, start + at_once)
            sums[rows] = self._sums_of(elements[rows], agents[rows])
        return sums

    def _sums_of(self, elements: Array, agents: Array) -> Array:
        x, inputs = elements.reshape(len(elements), -1).astype(np.int64), self.inputs
        first: Array | int = 0
        match inputs:
            case Scaling():
                x = (x - inputs.offset) * inputs.multiplier >> inputs.shift
                x = x.clip(-inputs.limit, inputs.limit)
            case Rows():
                first, x = inputs.table[x @ inputs.factors.T + inputs.first].sum(1, np.int64), x[:, :0]
            case Patches():
                x = (_patches(x >> inputs.element_shift, inputs) >> inputs.shift).clip(0, inputs.limit)
        if len(self.indicator):
            first = first + self.indicator[agents]
        for k, layer in enumerate(self.layers):
            sums = _products(x, layer.weights) + layer.bias + first
            first = 0
            if k + 1 < len(self.layers):
                x = sums >> layer.shift
                if len(layer.activation):
                    x = layer.activation[x.clip(-HALF, HALF - 1) + HALF].astype(np.int64)
                else:
                    x = x.clip(0, layer.limit)
        return sums

    def _chosen(self, logits: Array, masks: Array | None, drawn: Array | None) -> Array:
        head = self.head
        assert isinstance(head, Head)
        allowed = np.ones(logits.shape, np.bool_) if masks is None else masks != 0
        seen = np.where(allowed, logits.astype(np.int64), -(1 << 62))
        best: Array = seen.argmax(1)
        if drawn is None:
            return best
        distance = (seen.max(1, keepdims=True) - seen) >> head.shift
        weights = np.where(allowed, head.weights[distance.clip(0, ENTRIES - 1)], 0).astype(np.uint64)
        ends = weights.cumsum(1)
        # As fairly as a product of 32 bits allows: see `golden.uniform_below`.
        number = (drawn.astype(np.uint64) * ends[:, -1]) >> np.uint64(32)
        drawn_one: Array = np.where(ends[:, -1] > 0, (number[:, None] >= ends).sum(1), best)
        return drawn_one


@dataclass(frozen=True, eq=False)
class AgentNetworks(DevicePolicy):
    """A network of integers for each agent of a world, which share nothing.

    Raises
    ------
    ArgumentError
        They are not as many as a world has agents, or are of different environments or kinds of heads.
    """

    networks: tuple[IntegerNetwork, ...]

    def __post_init__(self) -> None:
        if not self.networks:
            raise ArgumentError("there is no network; a world needs one for each agent")
        spec, count = self.spec, len(self.networks)
        if count != spec.agents:
            raise ArgumentError(
                f"a world of {spec.name} needs {spec.agents} networks, one for each agent; given: {count}"
            )
        for k, network in enumerate(self.networks):
            other, own = network.spec, spec
            if (other.id, other.options) != (own.id, own.options):
                raise ArgumentError(
                    f"the network of agent {k} is for {other.id} with {dict(other.options)}, and that of "
                    f"agent 0 for {own.id} with {dict(own.options)}: all must be for one environment"
                )
            if (network.draws, network.logits) != (self.draws, self.logits):
                raise ArgumentError(
                    f"the network of agent {k} chooses actions in another way than that of agent 0: all must "
                    "draw them, or none"
                )

    @property
    def spec(self) -> EnvSpec:  # type: ignore[override]
        """The environment that they are for."""
        return self.networks[0].spec

    @property
    def draws(self) -> int:  # type: ignore[override]
        """How many random numbers an action takes."""
        return self.networks[0].draws

    @property
    def logits(self) -> int:  # type: ignore[override]
        """How many logits an action is chosen by."""
        return self.networks[0].logits

    def choose(self, elements: Array, agents: Array, masks: Array | None, draws: Array) -> ActionChoice:
        """See :class:`DevicePolicy`."""
        words = np.empty((len(elements), len(self.spec.action_fields)), np.int64)
        logits = np.empty((len(elements), self.logits), np.int32)
        for agent, network in enumerate(self.networks):
            own = agents == agent
            choice = network.choose(
                elements[own], agents[own], None if masks is None else masks[own], draws[own]
            )
            words[own] = choice.words
            if choice.logits is not None:
                logits[own] = choice.logits
        return ActionChoice(words, logits if self.logits else None)


def loop_parts(network: IntegerNetwork) -> dict[str, Any]:
    """Return what loops take of a network's inputs, indicator and head: arrays of their own, and numbers.

    What a network has no part of is empty, or 0.
    """
    inputs, head = network.inputs, network.head
    lines = "offset", "multiplier", "input_shift", "filter_bias", "shape", "counts", "chances"
    arrays: dict[str, Any] = dict.fromkeys(lines, ())
    arrays |= dict.fromkeys(("factors", "table", "levels"), np.zeros((0, 0)))
    arrays["indicator"] = network.indicator
    numbers = {"input_limit": getattr(inputs, "limit", 0), "chance_shift": 0, "level_shift": 0}
    match inputs:
        case Scaling():
            arrays |= {"offset": inputs.offset, "multiplier": inputs.multiplier, "input_shift": inputs.shift}
        case Rows():
            arrays |= {"offset": inputs.first, "factors": inputs.factors, "table": inputs.table}
        case Patches():
            shifts = inputs.shift, inputs.element_shift
            arrays |= {"shape": inputs.shape, "input_shift": shifts, "filter_bias": inputs.bias}
    if isinstance(head, Head):
        arrays |= {"counts": head.counts, "chances": head.weights}
        numbers["chance_shift"] = head.shift
    else:
        arrays["levels"] = head.multiplier, head.offset, head.low, head.high
        numbers["level_shift"] = head.shift
    dtypes = dict.fromkeys(("table", "filter_bias", "indicator"), np.int32)
    made = {name: np.array(array, dtypes.get(name, np.int64), order="C") for name, array in arrays.items()}
    return numbers | made


# NumPy multiplies matrices of integers a number at a time, and those of floats by BLAS. That is exact: sums
# have 32 bits, and a double holds integers of 53, a float those of 24.
def _products(x: Array, weights: Array) -> npt.NDArray[np.int64]:
    """Return ``x @ weights.T``."""
    return (x.astype(np.float64) @ weights.T.astype(np.float64)).astype(np.int64)


def _patches(x: Array, inputs: Patches) -> npt.NDArray[np.int64]:
    """Return the sums of all patches of planes, of shape ``(n, patches * filters)``."""
    (rows, columns, planes), filters = inputs.shape, len(inputs.bias)
    most = np.abs(inputs.weights.astype(np.int64)).sum((1, 2, 3)).max() * x.max(initial=0)
    dtype = np.float32 if most + np.abs(inputs.bias.astype(np.int64)).max() < 1 << 24 else np.float64
    weights = inputs.weights.transpose(1, 2, 0, 3).reshape(-1, planes).astype(dtype)
    parts = (weights @ x.reshape(-1, planes).T.astype(dtype)).reshape(9, filters, -1)
    sums = np.repeat(inputs.bias.astype(dtype)[:, None], parts.shape[2], 1)
    # A patch is counted at its first corner; those that would reach beyond a plane are left out at the end.
    for k in range(9):
        after = k // 3 * columns + k % 3
        sums[:, : sums.shape[1] - after] += parts[k, :, after:]
    whole = sums.reshape(filters, len(x), rows, columns)[:, :, : rows - 2, : columns - 2]
    return whole.transpose(1, 2, 3, 0).reshape(len(x), -1).astype(np.int64)


def table_network(spec: EnvSpec, values: Array) -> IntegerNetwork:
    """Return the policy that takes the greatest of the values of an observation, the first of equals.

    ``values`` are integers of 32 bits of shape ``(observations, actions)``; observations are counted as a
    NumPy array of shape ``(*elements, actions)`` counts its rows.
    """
    low, high = (end.ravel().astype(np.int64) for end in bounds(spec.observation_space))
    sizes = high - low + 1
    strides = np.array([math.prod(sizes[k + 1 :].tolist()) for k in range(len(sizes))], np.int64)
    rows = Rows(np.array([-(low * strides).sum()]), strides[None], values.astype(np.int32))
    actions = values.shape[1]
    layer = Dense(np.zeros((actions, 0), np.int16), np.zeros(actions, np.int32))
    return IntegerNetwork(spec, rows, np.zeros((0, actions), np.int32), (layer,), Head((actions,)))


def no_planes(spec: EnvSpec) -> str | None:
    """Return why an environment's pictures are no planes of numbers that patches take, or ``None``."""
    low, high = bounds(spec.observation_space)
    fractions = set(spec.element_fractions)
    if low.min() < 0 or not np.isfinite(high).all():
        reached = f"{low.min()} to {high.max()}"
        return f"patches are of planes of numbers from 0 to a bound, and observations reach {reached}"
    if len(fractions) > 1:
        return f"planes have one binary point, and elements have {sorted(fractions)} bits behind theirs"
    return None


def unchanging_network(spec: EnvSpec) -> IntegerNetwork:
    """Return the policy that always takes the first action, or a ``Box``'s 0 or what is nearest to it."""
    size, outputs = spec.observation_size, sum(spec.action_counts) or len(spec.action_fields)
    none = np.zeros(size, np.int64)
    head: Head | Levels = Head(spec.action_counts)
    if not spec.action_counts:
        zero = np.zeros(outputs, np.int64)
        low, high = np.array([field.range for field in spec.action_fields], np.int64).T
        head = Levels(zero, zero, 0, low, high)
    layer = Dense(np.zeros((outputs, size), np.int16), np.zeros(outputs, np.int32))
    indicator = np.zeros((0, outputs), np.int32)
    return IntegerNetwork(spec, Scaling(none, none, none, 1), indicator, (layer,), head)


def _check(network: IntegerNetwork) -> None:
    """Refuse a network whose shapes do not follow from each other, or whose sums might not fit."""
    spec, inputs, layers = network.spec, network.inputs, network.layers

    def refuse(what: str) -> None:
        raise ArgumentError(f"this is no network for {spec.name}: {what}")

    def within(what: str, numbers: Array, most: int) -> None:
        for number in (numbers.min(), numbers.max()):
            if not 0 <= number <= most:
                refuse(f"{what} is {number}; possible are 0 to {most:,}")

    if not layers:
        refuse("it has no layers")
    if network.indicator.ndim != 2 or any(
        layer.weights.ndim != 2 or layer.bias.ndim != 1 for layer in layers
    ):
        refuse("weights have two axes, and biases one")
    elements = spec.observation_size
    match inputs:
        case Scaling():
            width, most = elements, np.full(elements, inputs.limit)
            arrays = {"offset": inputs.offset, "multiplier": inputs.multiplier, "shift": inputs.shift}
            for name, array in arrays.items():
                if array.shape != (elements,):
                    refuse(f"{name} has the shape {array.shape}, and an observation {elements} elements")
            within("a multiplier", inputs.multiplier, (1 << 31) - 1)
            within("a shift", inputs.shift, 62)
            if not 1 <= inputs.limit <= MOST:
                refuse(f"the limit of inputs is {inputs.limit}; possible are 1 to {MOST}")
            added: Array | int = 0
        case Rows():
            width, most = 0, np.zeros(0, np.int64)
            choices = len(inputs.first)
            if inputs.factors.shape != (choices, elements) or inputs.table.ndim != 2:
                refuse(
                    f"factors have the shape {inputs.factors.shape}, and an observation {elements} elements"
                )
            low, high = (end.ravel().astype(np.int64) for end in bounds(spec.observation_space))
            ends = np.stack([inputs.factors * low, inputs.factors * high])
            least, greatest = ends.min(0).sum(1) + inputs.first, ends.max(0).sum(1) + inputs.first
            if least.min() < 0 or greatest.max() >= len(inputs.table):
                refuse(f"rows {least.min()} to {greatest.max()} may be chosen of {len(inputs.table)}")
            added = choices * int(np.abs(inputs.table.astype(np.int64)).max(initial=0))
        case Patches():
            rows, columns, planes = inputs.shape
            if spec.observation_shape != inputs.shape or inputs.weights.shape[1:] != (3, 3, planes):
                refuse(
                    f"patches of {inputs.shape}, where observations have the shape {spec.observation_shape}"
                )
            fraction = max(spec.element_fractions)
            if not 0 <= inputs.element_shift <= fraction:
                refuse(f"elements are shifted by {inputs.element_shift}; possible are 0 to {fraction}")
            if why := no_planes(spec):
                refuse(why)
            reached = bounds(spec.observation_space)[1].max((0, 1)) * 2.0 ** (fraction - inputs.element_shift)
            weights, bias = (np.abs(array.astype(np.float64)) for array in (inputs.weights, inputs.bias))
            sums = weights.sum((1, 2)) @ reached + bias
            if sums.max() >= 1 << SUM_BITS - 1:
                refuse(
                    f"sums of patches may reach {sums.max():,.0f}, and have {SUM_BITS} bits: take weights of "
                    "fewer bits"
                )
            width = len(inputs.bias) * (rows - 2) * (columns - 2)
            most, added = np.full(width, inputs.limit), 0
    if len(network.indicator):
        if network.indicator.shape != (spec.agents, len(layers[0].bias)):
            refuse(f"indicator has the shape {network.indicator.shape}, and a world {spec.agents} agents")
        added = added + int(np.abs(network.indicator.astype(np.int64)).max(initial=0))
    for k, layer in enumerate(layers):
        if layer.weights.shape != (len(layer.bias), width):
            refuse(f"layer {k} has weights of shape {layer.weights.shape}, and takes {width} inputs")
        sums = np.abs(layer.weights.astype(np.int64)) @ most + np.abs(layer.bias.astype(np.int64)) + added
        if sums.size and sums.max() >= 1 << SUM_BITS - 1:
            refuse(f"sums of layer {k} may reach {sums.max():,}, and have {SUM_BITS} bits")
        if not 0 <= layer.shift < SUM_BITS:
            refuse(f"layer {k} shifts by {layer.shift}; possible are 0 to {SUM_BITS - 1}")
        if k + 1 < len(layers):
            if layer.activation.shape not in ((0,), (ENTRIES,)):
                refuse(
                    f"layer {k} has a table of shape {layer.activation.shape}; it takes {ENTRIES:,} numbers"
                )
            table = np.abs(layer.activation.astype(np.int64))
            limit = int(table.max()) if len(table) else layer.limit
            if not 0 <= limit <= MOST:
                refuse(f"what layer {k} makes may reach {limit}; possible are 0 to {MOST}")
            width, added, most = len(layer.bias), 0, np.full(len(layer.bias), limit)
    outputs, head = len(layers[-1].bias), network.head
    if isinstance(head, Levels):
        needed = len(spec.action_fields) if not spec.action_counts else -1
        for name, array in head._asdict().items():
            if name != "shift" and array.shape != (len(spec.action_fields),):
                refuse(f"{name} has the shape {array.shape}, and an action {len(spec.action_fields)} fields")
        within("a multiplier", head.multiplier, (1 << 31) - 1)
        within("an offset", np.abs(head.offset), (1 << 62) - 1)
        for least, greatest, field in zip(head.low, head.high, spec.action_fields, strict=True):
            if not field.range[0] <= least <= greatest <= field.range[1]:
                refuse(f"actions from {least} to {greatest} do not fit the field {field.name}")
    else:
        needed = sum(head.counts) if head.counts == spec.action_counts else -1
        if not 0 <= head.shift < SUM_BITS:
            refuse(f"distances are shifted by {head.shift}; possible are 0 to {SUM_BITS - 1}")
        if head.weights.shape not in ((0,), (ENTRIES,)):
            refuse(f"the weights of chances have the shape {head.weights.shape}; they take {ENTRIES:,}")
        if len(head.weights):
            within("a weight of a chance", head.weights, 65535)
            if not head.weights[0]:
                refuse("the best action has no chance: the first weight is 0")
    if outputs != needed:
        refuse(f"it has {outputs} outputs for actions in {spec.action_space}")
