"""The pieces of the CPU's kernels about ends: whose episode is over, and what is left to see of whom.

A slot's ``flag`` says that its episode is over. In a world of several agents each has a bit in ``gone``, as
the column ``ended`` has them, and another one in ``gone_before``, which is what it was before the step.
"""

from __future__ import annotations

from pearl_marl.compiler.block_pieces import BlockPieces, part
from pearl_marl.compiler.pieces import assign, each, indented

Parts = dict[str, list[str]]

LONG = 16
"""Elements of an observation from which on they are hidden by a loop; it would take longer for a few."""


def counted(counter: str, resetting: bool) -> list[str]:
    """Return what counts a step, and finds out whether it was the last one that the time limit allows."""
    e = f"{counter}_add(E[i], 1)"
    if resetting:
        e = f"{counter}_choose(resetting[i], 0, {e})"
    return [f"e = {e}", f"late = {counter}_at_least(e, limit)", "E[i] = e"]


def end_pieces(p: BlockPieces) -> Parts:
    """Return these pieces by the names that the template of the kernels has for them."""
    return _of_one(p) if p.agents == 1 else _of_several(p)


def _of_one(p: BlockPieces) -> Parts:
    return {
        "hide": p.over_slots("hide", "T[i] = uint8_choose(resetting[i], 0, T[i])", "flag[i] = resetting[i]"),
        "end_agents": [],
        "truncated": _truncated(p, "U[i] = late", "flag[i] = uint8_or(T[i], late)"),
        "not_truncated": p.over_slots("not_truncated", "U[i] = np.uint8(0)", "flag[i] = T[i]"),
        "ending": p.over_slots("ending", "N[i] = flag[i]"),
        "no_reward": p.over_slots("no_reward", "R[i] = float32_choose(resetting[i], np.float32(0), R[i])"),
        "delivered_ends": p.over_slots(
            "delivered_ends",
            "T[i] = uint8_and(ter[i], 1)",
            "U[i] = uint8_right(ter[i], 1)",
            "flag[i] = ter[i]",
        ),
        "gone": [],
        "gone_delivered": [],
        "gone_before": [],
        "gone_at_reset": [],
        "bury_rewards": [],
        "bury": [],
        "bury_at_reset": [],
    }


def _of_several(p: BlockPieces) -> Parts:
    word, agents = str(p.ended.dtype), range(p.agents)
    every = ((1 << p.agents) - 1) << 1
    terminated, truncated, rewards = (p.of_agents(array) for array in "TUR")

    def bit(bits: str, k: int) -> str:
        return f"uint8_and({word}_right({bits}, {k + 1}), 1)"

    def lives(bits: str, k: int) -> str:
        return f"uint8_xor({bit(bits, k)}, 1)"

    end_agents = ["g = N[i]", "gone_before[i] = g"]
    for k in agents:
        end_agents.append(f"t{k} = uint8_and({terminated[k]}, {lives('g', k)})")
        end_agents.append(f"{terminated[k]} = t{k}")
    end_agents += [f"g = {word}_or(g, {word}_left(t{k}, {k + 1}))" for k in agents]
    end_agents += ["gone[i] = g", "N[i] = g", f"flag[i] = {word}_equal(g, {every})"]
    delivered = ["t = ter[i]", "before = gone_before[i]", f"late = uint8_and({word}_right(t, {p.agents}), 1)"]
    for k in agents:
        delivered.append(f"{terminated[k]} = uint8_and({word}_right(t, {k}), {lives('before', k)})")
        delivered.append(f"{truncated[k]} = uint8_and(late, {lives('before', k)})")
    delivered += [f"g = {word}_and({word}_left(t, 1), {every})", "gone[i] = g"]
    delivered.append(f"flag[i] = uint8_or(late, {word}_equal(g, {every}))")
    scratch = [f"{name} = {p.space(p.ended.dtype, p.size)}" for name in ("gone", "gone_before")]
    hidden = [f"hidden = {p.space('uint8', p.size)}", "hidden_words = uint64_column(hidden, 0, 0)"]
    return {
        "hide": p.over_slots(
            "hide",
            *(f"{t} = uint8_choose(resetting[i], 0, {t})" for t in terminated),
            f"N[i] = {word}_choose(resetting[i], 0, N[i])",
            "flag[i] = resetting[i]",
        ),
        "end_agents": p.over_slots("end_agents", *end_agents),
        "truncated": _truncated(
            p,
            *(f"{truncated[k]} = uint8_and(late, {lives('gone_before[i]', k)})" for k in agents),
            "flag[i] = uint8_or(flag[i], late)",
        ),
        "not_truncated": p.over_agents("not_truncated", "U[i] = np.uint8(0)"),
        "ending": p.over_slots("ending", f"N[i] = {word}_choose(flag[i], 1, N[i])"),
        "no_reward": p.over_slots(
            "no_reward", *(f"{r} = float32_choose(resetting[i], np.float32(0), {r})" for r in rewards)
        ),
        "delivered_ends": p.over_slots("delivered_ends", *delivered),
        "gone": [*scratch, *hidden],
        "gone_delivered": [*scratch[:1], *hidden],
        "gone_before": [f"gone_before = {part('gone_words', p.ended.dtype)}"],
        "gone_at_reset": p.over_slots("gone_at_reset", f"gone[i] = {word}_and(N[i], {every})"),
        "bury_rewards": p.over_slots(
            "bury_rewards",
            *(
                f"{r} = float32_choose({bit('gone_before[i]', k)}, np.float32(0), {r})"
                for k, r in enumerate(rewards)
            ),
        ),
        **_seen_of_several(p, [bit("gone[i]", k) for k in agents], [lives("gone[i]", k) for k in agents]),
    }


def _truncated(p: BlockPieces, *lines: str) -> list[str]:
    """Return what ends episodes by the time limit; few steps have slots that spend them resetting."""
    some = p.over_slots("truncated_or_reset", *counted(p.counter, resetting=True), *lines)
    none = p.over_slots("truncated", *counted(p.counter, resetting=False), *lines)
    return ["if any_resetting:", *indented(some), "else:", *indented(none)]


def _seen_of_several(p: BlockPieces, gone: list[str], lives: list[str]) -> Parts:
    """Return what hides what agents that have ended would see, and keeps what they saw last."""
    own, masks = p.spec.observation_size, len(p.spec.mask_fields)
    lines = []
    for k, bit in enumerate(gone):
        lines.append(f"dead = {bit}")
        for array, dtype, size in (("O", p.dtype, own), ("M", "int8", masks)):
            at = f"{array}[{p.agents * size} * i + {{}}]"
            if size > LONG:
                of_one = at.format(f"{k * size} + e")
                lines += [f"for e in range({size}):", f"    {of_one} = {dtype}_choose(dead, 0, {of_one})"]
            else:
                places = each(at, range(k * size, (k + 1) * size))
                lines += assign(places, (f"{dtype}_choose(dead, 0, {place})" for place in places))
    bury = p.apart("bury", lines)
    keep = p.apart("keep_last", p.copy_one)
    shown = [
        f"{place} = uint8_or(flag[i], {alive})" for place, alive in zip(p.of_agents("L"), lives, strict=True)
    ]
    # Few slots have something to hide or to keep in most steps: eight that have not are one comparison.
    # SAME_STEP keeps what was seen last in an episode when it starts the next.
    found = f"hidden[i] = uint8_choose(flag[i], next_step, {p.ended.dtype}_differ(gone[i], 0))"
    one = [
        "if flag[i]:",
        *indented(keep),
        "else:",
        *indented(["if gone[i] != gone_before[i]:", *indented(keep), *bury]),
    ]
    some = ["if hidden[i]:", *indented(one)]
    each_eight = ["if hidden_words[w]:", "    for i in range(8 * w, 8 * w + 8):", *indented(indented(some))]
    hide = [f"clear(hidden, m, {p.size})", *p.over_slots("show_alive", *shown, found)]
    hide += [f"for w in range({p.size // 8}):", *indented(each_eight)]
    return {
        "bury": hide,
        "bury_at_reset": [
            *p.over_slots("show_alive_at_reset", *shown),
            "for i in range(m):",
            *indented(["if gone[i]:", *indented(bury)]),
        ],
    }
