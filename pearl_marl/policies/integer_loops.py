"""Integer networks, compiled for a CPU: a few agents at a time go through all layers, in the first cache.

Where each agent of a world has a network of its own, that of one takes the agents of its place in all worlds.

What the processor has instructions for is in :mod:`pearl_marl.policies.integer_vectors`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

import numpy as np
from numba import njit, types

from pearl_marl.base.arrays import Array
from pearl_marl.compiler import addresses
from pearl_marl.compiler.addresses import address_of, call_act, fields_at, in_memory
from pearl_marl.compiler.loading import compiled_loop
from pearl_marl.policies import integer_vectors
from pearl_marl.policies.device_policy import ACT_ARGUMENTS, CompiledPolicy, best_of_fields
from pearl_marl.policies.integer_network import (
    ENTRIES,
    HALF,
    AgentNetworks,
    Dense,
    Head,
    IntegerNetwork,
    Levels,
    Patches,
    Rows,
    loop_parts,
)
from pearl_marl.policies.integer_vectors import (
    HIGH,
    TILE,
    pairs_gathered,
    pairs_looked_up,
    pairs_to_pairs,
    pairs_to_sums,
    quads_looked_up,
    quads_to_quads,
    quads_to_sums,
    take,
    take_greatest,
    takes_gathers,
    takes_quads,
)

SCALED, LOOKED_UP, PICKED, PLANES = range(4)
GREATEST, DRAWN, LEVELS = range(3)
PAIR, QUAD = 2, 4
SIZE, GROUPS, OUTPUTS, SHIFT, LIMIT, HAS_TABLE = range(6)
MIDDLE = 128
"""What is added to bytes with a sign, so that they have none."""


Words = Annotated[Array, types.Array(types.int64, 1, "C")]
Words2 = Annotated[Array, types.Array(types.int64, 2, "C")]
Sums1 = Annotated[Array, types.Array(types.int32, 1, "C")]
Sums2 = Annotated[Array, types.Array(types.int32, 2, "C")]
Sums4 = Annotated[Array, types.Array(types.int32, 4, "C")]
Bytes = Annotated[Array, types.Array(types.uint8, 1, "C")]


class Prepared(NamedTuple):
    """A network as compiled loops take it. Weights of all layers lie one after the other, in groups."""

    kind: int  # SCALED, LOOKED_UP, PICKED or PLANES
    size: int  # bytes of an element
    signed: int  # 1 where it has a sign
    width: int  # elements of an observation
    offset: Words  # one an element; of LOOKED_UP and PICKED one a choice: the row of zeros
    multiplier: Words
    input_shift: Words  # of PLANES, that of sums and that of elements
    input_limit: int
    factors: Words2  # (choices, elements)
    table: Sums2  # (rows, width)
    picks: Sums2  # (rows, fields): the action of each row, where a row decides
    indicator: Sums2  # (agents, width)
    filters: Sums4  # (planes, 3 rows, 3 columns from last to first, filters)
    filter_bias: Sums1
    shape: Words  # rows, columns, planes
    weights: Sums1  # groups of weights, a row an output
    bias: Sums1
    layers: Words2  # (layers, 6): inputs of a group, groups, outputs rounded up to a multiple of HIGH, ...
    tables: Sums1  # (layers, 1024) as one axis
    gathers: int  # 1 where the processor looks up the words of a vector
    bytes: Bytes  # the same from the entry of 0 on, plus MIDDLE, for layers of quads
    chooses: int  # GREATEST, DRAWN or LEVELS
    counts: Words
    chance_shift: int
    chances: Words
    levels: Words2  # (4, fields): multiplier, offset, low, high
    level_shift: int


def prepared(network: IntegerNetwork, dtype: np.dtype[Any]) -> Prepared:
    """Return a network as compiled loops take it, for elements of a dtype."""
    inputs, head, layers = network.inputs, network.head, network.layers
    parts, kind = loop_parts(network), SCALED
    picks, filters = np.zeros((0, 0), np.int32), np.zeros((0, 0, 0, 0), np.int32)
    if isinstance(inputs, Rows):
        kind, alone = LOOKED_UP, len(inputs.first) == 1 == len(layers) and not len(network.indicator)
        greatest = isinstance(head, Head) and not len(head.weights) and not network.spec.mask_fields
        if alone and greatest:  # a row of the table is all that an action depends on
            logits = parts["table"] + layers[0].bias.astype(np.int64)
            kind, picks = PICKED, best_of_fields(logits, parts["counts"]).astype(np.int32)
    elif isinstance(inputs, Patches):
        kind = PLANES
        filters = np.array(inputs.weights.transpose(3, 1, 2, 0)[:, :, ::-1], np.int32, order="C")
    weights, bias = [], []
    facts = np.zeros((len(layers), 6), np.int64)
    tables, as_bytes = np.zeros((len(layers), ENTRIES), np.int32), np.zeros((len(layers), ENTRIES), np.uint8)
    quads = takes_quads() and _fits_quads(network)
    for k, (before, layer) in enumerate(zip((inputs, *layers[:-1]), layers, strict=True)):
        outputs, width = layer.weights.shape
        size = QUAD if quads and isinstance(before, Patches | Dense) else PAIR
        groups, up = -(-width // size), -(-outputs // HIGH) * HIGH
        padded = np.zeros((up, size * groups), np.int16 if size == PAIR else np.int8)
        padded[:outputs, :width] = layer.weights
        weights.append(padded.view(np.int32).ravel())
        own = np.zeros(up, np.int64)
        own[:outputs] = layer.bias
        if size == QUAD and isinstance(before, Dense) and len(before.activation):
            own -= MIDDLE * padded.sum(1, np.int64)
        bias.append(own.astype(np.int32))  # those of quads may overflow, and come back when all is added up
        if len(layer.activation):
            tables[k] = layer.activation
            as_bytes[k] = np.roll(tables[k] + MIDDLE, -HALF)  # where they do not fit, nothing reads them
        facts[k] = size, groups, up, layer.shift, layer.limit, len(layer.activation) > 0
    return Prepared(
        kind=kind,
        size=dtype.itemsize,
        signed=int(dtype.kind == "i"),
        width=network.spec.observation_size,
        picks=picks,
        filters=filters,
        weights=np.concatenate(weights),
        bias=np.concatenate(bias),
        layers=facts,
        tables=tables.ravel(),
        gathers=int(takes_gathers()),
        bytes=as_bytes.ravel(),
        chooses=LEVELS if isinstance(head, Levels) else DRAWN if len(head.weights) else GREATEST,
        **parts,
    )


def _fits_quads(network: IntegerNetwork) -> bool:
    """Return whether weights, and what goes from one layer to the next, have 8 bits.

    The first layer may be one of pairs; then a table follows.
    """
    inputs, layers = network.inputs, network.layers
    planes = isinstance(inputs, Patches)
    if isinstance(inputs, Patches):
        if inputs.limit > 255:
            return False
    elif len(layers) > 1 and not len(layers[0].activation):
        return False
    made = [
        layer.activation if len(layer.activation) else np.array([layer.limit - 128]) for layer in layers[:-1]
    ]
    weights = [layer.weights for layer in layers[0 if planes else 1 :]]
    ends = np.iinfo(np.int8)
    return all(ends.min <= some.min(initial=0) and some.max(initial=0) <= ends.max for some in made + weights)


_FOR_LOOPS: Any = {
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "forceinline": True,  # to hand over a network and its room takes longer than the work on a tile
}
allocating: Callable[..., Any] = njit(**_FOR_LOOPS)
called: Callable[..., Any] = njit(**_FOR_LOOPS, **dict[str, Any](_nrt=False))
"""For functions that allocate nothing: they count no references, so they compile sooner."""


class TileArrays(NamedTuple):
    """What a tile is on its way through the layers."""

    taken: Array  # int64, (elements, TILE)
    flags: Array  # uint8: an agent's planes
    filtered: Array  # int32: what filters find in them
    x: Array  # int32, (groups, TILE)
    sums: Array  # int32, (outputs, TILE)
    all_x: Array  # int32: the same in one line, as are the next two; NumPy's reshape takes long in a loop
    all_y: Array  # int32: other groups, which layers write that take those of x, and the other way round
    all_sums: Array
    best: Array  # int32, (TILE,): actions
    greatest: Array  # int32, (TILE,): their logits
    rows: Array  # int64, (TILE,): rows of a table
    chances: Array  # int64, (actions of a field, TILE)
    left: Array  # int64, (TILE,): what is left of a random number when chances are taken away
    drawn: Array  # int64, (TILE,): actions


@allocating
def _lines(rows: int) -> Array:
    """Return rows of a tile that begin where cache lines do."""
    room = np.zeros((rows + 1) * TILE, np.int32)
    skipped = -(room.ctypes.data >> 2) & 15
    return room[skipped : skipped + rows * TILE]


@allocating
def _room_for(net: Prepared) -> TileArrays:
    """Return room for a tile."""
    groups, outputs, planes = 1, 1, net.kind == PLANES
    for layer in range(len(net.layers)):
        outputs = max(outputs, net.layers[layer, OUTPUTS])
        groups = max(groups, net.layers[layer, GROUPS], (outputs + 1) // 2)
    found = len(net.filter_bias) * (net.shape[0] - 2) * (net.shape[1] - 2) if planes else 0
    x, y, sums = _lines(groups), _lines(groups), _lines(outputs)
    return TileArrays(
        np.zeros((net.width, 1 if planes else TILE), np.int64),
        np.zeros((net.width + 7) // 8 * 8 if planes else 0, np.uint8),
        np.zeros((found + QUAD - 1) // QUAD * QUAD, np.int32),
        x.reshape((groups, TILE)),
        sums.reshape((outputs, TILE)),
        x,
        y,
        sums,
        np.zeros(TILE, np.int32),
        np.zeros(TILE, np.int32),
        np.zeros(TILE, np.int64),
        np.zeros((net.counts.max() if net.chooses == DRAWN else 0, TILE), np.int64),
        np.zeros(TILE, np.int64),
        np.zeros(TILE, np.int64),
    )


@called
def _scale(net: Prepared, taken: Array, x: Array) -> None:
    """Put a tile's inputs in pairs."""
    count, limit = len(net.offset), net.input_limit
    for k in range(count):
        offset, multiplier, shift = net.offset[k], net.multiplier[k], net.input_shift[k]
        for s in range(TILE):
            scaled = (taken[k, s] - offset) * multiplier >> shift
            scaled = min(max(scaled, -limit), limit)
            if k & 1:
                x[k >> 1, s] |= np.int32(scaled) << np.int32(16)
            else:
                x[k >> 1, s] = np.int32(scaled) & np.int32(0xFFFF)


@called
def _see_planes(net: Prepared, elements: Array, first: int, n: int, room: TileArrays) -> None:
    """Put what filters find in a tile's planes in groups. Most elements are 0, and cost nothing."""
    rows, columns, planes = net.shape[0], net.shape[1], net.shape[2]
    high, wide, filters = rows - 2, columns - 2, len(net.filter_bias)
    shift, cut, taken = net.input_shift[0], net.input_shift[1], room.taken
    flags, filtered, weights = room.flags, room.filtered, net.filters.reshape(-1)
    words = flags.view(np.uint64)
    for s in range(n):
        if net.size == 1:
            start = (first + s) * net.width
            for k in range(net.width):
                flags[k] = elements[np.uint64(start + k)]
        else:
            take((elements, taken), (first + s, 1, net.width, net.size, net.signed, 1))
            for k in range(net.width):
                flags[k] = taken[k, 0] >> cut != 0
        for at in range(high * wide):
            for f in range(filters):
                filtered[np.uint64(at * filters + f)] = net.filter_bias[f]
        for w in range(len(words)):
            if not words[w]:
                continue
            for k in range(w * 8, w * 8 + 8):
                if not flags[k]:
                    continue
                number = np.int32(flags[k] if net.size == 1 else taken[k, 0] >> cut)
                plane, row, column = k % planes, k // planes // columns, k // planes % columns
                left = max(0, column - 2)
                length = (min(wide - 1, column) - left + 1) * filters
                for i in range(max(0, row - high + 1), min(3, row + 1)):
                    at = ((row - i) * wide + left) * filters
                    of = ((plane * 3 + i) * 3 + 2 - column + left) * filters
                    if number == 1:  # as most are: nothing is multiplied
                        for f in range(length):
                            filtered[np.uint64(at + f)] += weights[np.uint64(of + f)]
                    else:
                        for f in range(length):
                            filtered[np.uint64(at + f)] += np.int32(weights[np.uint64(of + f)] * number)
        size = net.layers[0, SIZE]
        bits = np.int32(32 // size)
        for k in range(net.layers[0, GROUPS]):
            group = np.int32(0)
            for i in range(size):
                found = min(max(filtered[size * k + i] >> shift, 0), net.input_limit)
                group |= np.int32(found) << (bits * np.int32(i))
            room.x[k, s] = group


@called
def _look_up_pairs(sums: Array, table: Array, shift: Any, outputs: int, made: Array) -> None:
    """Look up what sums become in a table of any numbers, and put that in pairs; the sums are lost."""
    # Entries first, which is vectorised; no index below counts from the end.
    for j in range(outputs):
        for s in range(TILE):
            entry = min(max(sums[j, s] >> shift, np.int32(-HALF)), np.int32(HALF - 1))
            sums[j, s] = entry + np.int32(HALF)
    for j in range(0, outputs, 2):
        for s in range(TILE):
            low, high = table[np.uint64(sums[j, s])], table[np.uint64(sums[j + 1, s])]
            made[np.uint64((j >> 1) * TILE + s)] = (low & np.int32(0xFFFF)) | (high << np.int32(16))


@called
def _find_rows(net: Prepared, choice: int, room: TileArrays) -> None:
    """Find the row of the table that each agent of a tile chooses."""
    rows, taken = room.rows, room.taken
    for s in range(TILE):
        rows[s] = net.offset[choice]
    for e in range(net.width):
        factor = net.factors[choice, e]
        for s in range(TILE):
            rows[s] += factor * taken[e, s]


@called
def _pick(net: Prepared, first: int, n: int, room: TileArrays, words: Array, logits: Array) -> None:
    """Choose the actions of a tile by its rows alone."""
    own = words[first : first + n]
    for k in range(words.shape[1]):
        for s in range(n):
            own[s, k] = net.picks[np.uint64(room.rows[s]), k]
    if len(logits):
        for s in range(n):
            for j in range(logits.shape[1]):
                logits[first + s, j] = net.table[room.rows[s], j] + net.bias[j]


@called
def _begin(net: Prepared, n: int, first_agent: int, room: TileArrays) -> None:
    """Begin the first sums with biases, and with what rows of tables add to them."""
    sums = room.sums
    for j in range(net.layers[0, OUTPUTS]):
        for s in range(TILE):
            sums[j, s] = net.bias[j]
    if net.kind == LOOKED_UP:
        for k in range(len(net.offset)):
            _find_rows(net, k, room)
            for s in range(n):
                for j in range(net.table.shape[1]):
                    sums[j, s] += net.table[room.rows[s], j]
    agents = len(net.indicator)
    if agents:
        for s in range(n):
            for j in range(net.indicator.shape[1]):
                sums[j, s] += net.indicator[(first_agent + s) % agents, j]


@called
def _add_up(net: Prepared, elements: Array, first: int, n: int, room: TileArrays) -> None:
    """Compute the last sums of the ``n`` agents from ``first`` on, at most :data:`TILE`."""
    if net.kind == PLANES:
        _see_planes(net, elements, first, n, room)
    else:
        take((elements, room.taken), (first, n, net.width, net.size, net.signed, TILE))
    if net.kind == SCALED:
        _scale(net, room.taken, room.x)
    begun = net.kind == LOOKED_UP or len(net.indicator) > 0
    if begun:
        _begin(net, n, first, room)
    weight, bias, last = 0, 0, len(net.layers) - 1
    inputs, made = room.all_x, room.all_y
    for layer in range(last + 1):
        size, groups, outputs = net.layers[layer, SIZE], net.layers[layer, GROUPS], net.layers[layer, OUTPUTS]
        shift, has_table = net.layers[layer, SHIFT], net.layers[layer, HAS_TABLE]
        following = net.layers[layer + 1, SIZE] if layer < last else 0
        arrays = inputs, made, room.all_sums, net.weights, net.bias, net.bytes, net.tables
        end = layer * ENTRIES if has_table else net.layers[layer, LIMIT]
        of = weight, groups, bias, outputs, np.int64(begun), shift, end
        if following == QUAD:
            if size == QUAD:
                if has_table:
                    quads_looked_up(arrays, of)
                else:
                    quads_to_quads(arrays, of)
            else:
                pairs_looked_up(arrays, of)
        elif size == QUAD:
            quads_to_sums(arrays, of)
        elif following == PAIR and not has_table:
            pairs_to_pairs(arrays, of)
        elif following == PAIR and net.gathers:
            pairs_gathered(arrays, of)
        else:
            pairs_to_sums(arrays, of)
            if has_table:
                _look_up_pairs(room.sums, net.tables[end : end + ENTRIES], np.int32(shift), outputs, made)
        inputs, made, begun = made, inputs, False
        weight += groups * outputs
        bias += outputs


@called
def _take_greatest_allowed(room: TileArrays, masks: Array, start: int, count: int) -> None:
    """Find the greatest sum of each agent among those that its mask allows; 0 where it allows none."""
    for s in range(len(masks)):
        best, greatest, found = 0, np.int32(0), False
        for j in range(count):
            more = room.sums[start + j, s]
            if masks[s, j] and (not found or more > greatest):
                best, greatest, found = j, more, True
        room.best[s], room.greatest[s] = best, greatest


@called
def _draw(net: Prepared, room: TileArrays, start: int, count: int, masks: Array, draws: Array) -> None:
    """Replace the greatest by actions that are drawn; it stays where no action has a chance.

    A loop over the agents for each action: which one is drawn, no processor can predict.
    """
    chances, left, drawn = room.chances, room.left, room.drawn
    for s in range(len(draws)):
        left[s] = drawn[s] = 0
    for j in range(count):
        for s in range(len(draws)):
            distance = (np.int64(room.greatest[s]) - room.sums[start + j, s]) >> net.chance_shift
            # What is not allowed may be greater than the greatest.
            chance = net.chances[np.uint64(max(min(distance, ENTRIES - 1), 0))]
            if len(masks) and not masks[s, j]:
                chance = 0
            chances[j, s] = chance
            left[s] += chance
    for s in range(len(draws)):
        left[s] = np.int64((np.uint64(draws[s]) * np.uint64(left[s])) >> np.uint64(32))
    for j in range(count):
        for s in range(len(draws)):
            left[s] -= chances[j, s]
            drawn[s] += left[s] >= 0
    for s in range(len(draws)):
        if drawn[s] < count:
            room.best[s] = drawn[s]


@called
def _choose(
    net: Prepared,
    room: TileArrays,
    first: int,
    n: int,
    masks: Array,
    draws: Array,
    words: Array,
    logits: Array,
) -> None:
    """Choose the actions of a tile by its last sums; ``masks`` and ``logits`` may have no rows."""
    sums = room.sums
    if net.chooses == LEVELS:
        for k in range(net.levels.shape[1]):
            for s in range(n):
                word = (np.int64(sums[k, s]) * net.levels[0, k] + net.levels[1, k]) >> net.level_shift
                words[first + s, k] = min(max(word, net.levels[2, k]), net.levels[3, k])
        return
    start, last = 0, first + n
    own, allowed = words[first:last], masks[first:last]
    for field in range(len(net.counts)):
        count = net.counts[field]
        if len(allowed):
            _take_greatest_allowed(room, allowed, start, count)
        else:
            take_greatest((room.all_sums, room.best, room.greatest), (start, count))
        if net.chooses == DRAWN:
            _draw(net, room, start, count, allowed, draws[first:last, field])
        for s in range(n):
            own[s, field] = room.best[np.uint64(s)]
        start += count
    if len(logits):
        for s in range(n):
            for j in range(logits.shape[1]):
                logits[first + s, j] = sums[j, s]


_network_at = fields_at(Prepared)


def _act(network, elements, masks, draws, words, logits):  # type: ignore[no-untyped-def]
    net = _network_at(network)
    room = _room_for(net)
    for start in range(0, len(words), TILE):
        some = min(TILE, len(words) - start)
        if net.kind == PICKED:
            take((elements, room.taken), (start, some, net.width, net.size, net.signed, TILE))
            _find_rows(net, 0, room)
            _pick(net, start, some, room, words, logits)
        else:
            _add_up(net, elements, start, some, room)
            _choose(net, room, start, some, masks, draws, words, logits)


compiled_act = compiled_loop(_act, addresses, integer_vectors)


def compiled(network: IntegerNetwork, elements: np.dtype[Any]) -> CompiledPolicy:
    """Return a network as a rollout calls it, for elements of a dtype."""
    fields, act = prepared(network, elements), address_of(compiled_act(), *ACT_ARGUMENTS)
    return CompiledPolicy(act, in_memory(fields), network.draws, fields)


class AgentFields(NamedTuple):
    """The networks of a world's agents, as compiled loops take them: an element an agent."""

    agents: int
    acts: Words  # addresses of functions
    memory: Words  # addresses of what they work on


_agents_at = fields_at(AgentFields)


@called
def put(own: Array, to: Array) -> None:
    """Copy a row: to assign it takes Numba seconds to compile, for the message of another length."""
    for i in range(np.uint64(len(own))):
        to[i] = own[i]


@called
def put_rows(own: Array, to: Array) -> None:
    """Copy rows; there may be more where they are copied to."""
    for i in range(len(own)):
        put(own[i], to[i])


def _act_apart(networks, elements, masks, draws, words, logits):  # type: ignore[no-untyped-def]
    net = _agents_at(networks)
    agents = net.agents
    n = len(words) // agents
    rows = elements.reshape((len(words), len(elements) // len(words)))
    own = np.empty((n, rows.shape[1]), np.uint8)
    own_masks = np.empty((n if len(masks) else 0, masks.shape[1]), np.int8)
    own_draws = np.empty((n, draws.shape[1]), np.uint32)
    own_words = np.empty((n, words.shape[1]), np.int64)
    own_logits = np.empty((n if len(logits) else 0, logits.shape[1]), np.int32)
    for agent in range(agents):
        put_rows(rows[agent::agents], own)
        put_rows(masks[agent::agents], own_masks)
        put_rows(draws[agent::agents], own_draws)
        arguments = net.memory[agent], own.reshape(-1), own_masks, own_draws, own_words, own_logits
        call_act(net.acts[agent], arguments)
        put_rows(own_words, words[agent::agents])
        put_rows(own_logits, logits[agent::agents])


compiled_act_apart = compiled_loop(_act_apart, addresses)


def compiled_apart(networks: AgentNetworks, elements: np.dtype[Any]) -> CompiledPolicy | None:
    """Return the networks of a world's agents as :func:`compiled` does a network.

    ``None``, if one of them tells agents apart: it takes all agents of a world at a time.
    """
    if any(len(network.indicator) for network in networks.networks):
        return None
    each = [compiled(network, elements) for network in networks.networks]
    acts, memory = ([of[k] for of in (network.arguments for network in each)] for k in (0, 1))
    fields = AgentFields(len(each), np.array(acts), np.array(memory))
    act = address_of(compiled_act_apart(), *ACT_ARGUMENTS)
    return CompiledPolicy(act, in_memory(fields), networks.draws, (fields, each))
