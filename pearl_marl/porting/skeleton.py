"""The files of a package whose golden functions are still to be written, after an original."""

from __future__ import annotations

import re
import textwrap

import numpy as np
from gymnasium.spaces import Box, Discrete

from pearl_marl.porting.attributes import Seen, kind_of
from pearl_marl.porting.originals import Original
from pearl_marl.porting.package import common_words, filled, own_words, spec_words

FRACTION = 16
"""Bits behind the binary point of actions in a ``Box`` where the state has no reals."""

MOST_REWARDS = 16
"""Different rewards that a table is proposed for."""

WIDTH = 108


def of_skeleton(name: str, original: Original, seen: Seen, why: str | None) -> dict[str, str | bytes]:
    """Return the files of a package to fill in; ``why`` says why no tables were made of the original."""
    words = {
        **own_words(name),
        **common_words(original),
        **_step_words(original, seen),
        **_spec_words(original, seen),
    }
    words |= _page_words(original, seen, why)
    return {**filled("environment", words), **filled("port", words)}


def _bits(fraction: int, *numbers: float) -> int:
    """Return the bits of signed words up to twice these, with so many behind the point."""
    most = max([1.0, *(abs(number) for number in numbers if np.isfinite(number))])
    return int(most).bit_length() + 2 + fraction


def _view_kind(original: Original, seen: Seen) -> str | None:
    """Return the annotation of an observation's elements, where the space does not say how wide they are.

    They are reals only if the state has such.
    """
    space = original.observation_space
    if not isinstance(space, Box) or (np.issubdtype(space.dtype, np.integer) and space.low.min() >= 0):
        return None
    low, high = float(seen.observed[0].min()), float(seen.observed[1].max())
    if space.is_bounded() and np.abs([space.low.min(), space.high.max()]).max() < 2**20:
        low, high = float(space.low.min()), float(space.high.max())
    if not seen.whole and not seen.reals:
        return f"Signed[{_bits(FRACTION, low, high)}, {FRACTION}]"
    return kind_of(low, high, not seen.whole)


def _step_words(original: Original, seen: Seen) -> dict[str, str]:
    several = original.agents > 1
    lines, read, pose = [], [], []
    for attribute in seen.attributes:
        if attribute.kind is None:
            lines += _comment(f"{attribute.name}: {attribute.note}")
            continue
        line = f"    {attribute.name}: {attribute.kind}"
        comment = f"  # {attribute.note}"
        lines += [line + comment] if len(line + comment) <= WIDTH else [*_comment(attribute.note), line]
        read.append(f"        {attribute.name}=as_numbers(env.{attribute.path}),")
        pose.append(f"    env.{attribute.path} = like(env.{attribute.path}, state.{attribute.name})")
    helpers = "Original, as_numbers, like" if read else "Original"
    if not read:
        lines.append("    something: Flag  # no attribute that a field holds was seen to change")
        read = ["        something=0,  # what an original has is to be read of `env` here"]
        pose = ["    del env, state  # what an original has is to be set here"]
    view = _view_kind(original, seen)
    size = int(np.prod(original.observation_space.shape or ()))
    kinds = [attribute.kind or "" for attribute in seen.attributes] if "like" in helpers else ["Flag"]
    view_class = ""
    if view:
        kinds.append(f"Array[{view}]")
        view_class = '\n\nclass View(NamedTuple):\n    """What an agent sees, element by element."""\n\n'
        view_class += f"    elements: Array[{view}, {size}]\n"
    result = (
        "View" if view else "Word" if isinstance(original.observation_space, Discrete) else "tuple[Word, ...]"
    )
    table = len(seen.rewards) <= MOST_REWARDS
    if several:
        given = "state: State, actions: list[Word], draws: Draws"
        step = f"def step({given}) -> tuple[State, list[Word], list[Word]]:"
    else:
        step = "def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:"
    return {
        "@kinds@": ", ".join(sorted(set(re.findall(r"[A-Z]\w+", " ".join(kinds))))),
        "@rewards@": repr(tuple(sorted(seen.rewards, key=abs))) if table else "None",
        "@rewards_note@": f"The reward of each category, as seen in {seen.steps:,} steps."
        if table
        else "There are more than a table should have: a step returns the value itself.",
        "@steps@": f"{seen.steps:,}",
        "@fields@": "\n".join(lines),
        "@helpers@": helpers,
        "@read@": "\n".join(read),
        "@view@": view_class,
        "@def_step@": step,
        "@def_observe@": f"def observe(state: State{', agent: int' * several}) -> {result}:",
        "@an_action@": "an action of each agent" if several else "an action",
        "@what_rewards@": "the rewards" if several else "the reward",
        "@what_ends@": "who has ended" if several else "whether the episode ends",
        "@an_agent@": "an agent" if several else "the agent",
    } | ({"\n@pose@\n": "\n" + "\n".join(pose) + "\n"})


def _comment(text: str) -> list[str]:
    return textwrap.wrap(
        text,
        WIDTH,
        initial_indent="    # ",
        subsequent_indent="    #   ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def _spec_words(original: Original, seen: Seen) -> dict[str, str]:
    view = _view_kind(original, seen)
    table = len(seen.rewards) <= MOST_REWARDS
    space = original.action_space
    box = space if isinstance(space, Box) and not seen.reals else None
    reward, action = "", ""
    fraction = 0 if all(float(reward).is_integer() for reward in seen.rewards) else FRACTION
    if not table and seen.reals:
        ends = min(seen.rewards), max(seen.rewards)
        reward = f"reward={kind_of(*ends, True)},  # seen {ends[0]:.3g} to {ends[1]:.3g}: widen it"
    elif not table:
        bits = _bits(fraction, *seen.rewards)
        reward = f'reward=Field("reward", {bits}, signed=True, fraction={fraction}),'
    if box is not None:
        words = [
            f'Field("action_{k}", {_bits(FRACTION, *ends)}, signed=True, fraction={FRACTION})'
            for k, ends in enumerate(zip(box.low.tolist(), box.high.tolist(), strict=True))
        ]
        action = f"action={words[0]}" if len(words) == 1 else f"action=({', '.join(words)})"
    fields = "Field, " * ("Field(" in reward + action)
    imports = "from pearl_marl.layout import Real\n" * ("Real[" in reward)
    imports += f"from pearl_marl.spec import EnvSpec, {fields}Golden"
    drawn = original.registered and not original.options
    tolerance = "1e-5" if seen.reals else "" if seen.whole else "0.001"
    more = ["view=View"] * bool(view) + [f"tolerance={tolerance}"] * bool(tolerance)
    return spec_words(original, bool(view), drawn, imports) | {
        "@step_names@": f"REWARDS, State, {'View, ' * bool(view)}initial, observe, step",
        "@reward@": f"\n        {reward}" if reward else "",
        "@action@": f"\n        {action}," if action else "",
        "@spec_agents@": f"        agents={original.agents},\n" if original.agents > 1 else "",
        "@agents@": str(original.agents) if original.agents > 1 else "1",
        "@imported_view@": "View, " * bool(view),
        "@port_more@": "".join(f"    {part},\n" for part in more),
    }


def _action_note(original: Original, seen: Seen) -> str:
    """Return what a step is given as an action."""
    space = original.action_space
    if not isinstance(space, Box):
        count = int(np.prod(space.shape or ()))
        several = f"It is a tuple of {count} integers. " if count > 1 else ""
        return f"{several}Take any action that its bits can hold, and never fail."
    number = "real" if seen.reals else f"word with {FRACTION} bits behind the point"
    count = space.shape[0]
    return f"It is a tuple of {count} numbers, each a {number}." if count > 1 else f"It is one {number}."


def _page_words(original: Original, seen: Seen, why: str | None) -> dict[str, str]:
    several = original.agents > 1
    table = len(seen.rewards) <= MOST_REWARDS
    rows = [
        f"| `{a.path}` | {f'`{a.name}: {a.kind}`' if a.kind else 'nothing'} | {a.note.replace('|', ' or ')} |"
        for a in seen.attributes
    ] or ["| none was found | | |"]
    agent = ", agent" if several else ""
    view = _view_kind(original, seen)
    agents = (
        f"- **Agents**: {original.agents} share the state, in the order "
        f"{', '.join(map(str, original.names[:8]))}{' ...' if original.agents > 8 else ''}. `actions` is a "
        "list, and rewards and ends are lists, agent 0 first. Who has ended before its world is out: nothing "
        "may depend on its action.\n"
    )
    return {
        "@why@": f"\nNo tables were made of it, which would need no porting:\n{why}.\n" if why else "",
        "@table@": "\n".join(rows),
        "@starts@": "Different seeds of it begin in different states."
        if seen.random_starts
        else "Every seed of it began in the same state.",
        "@view_note@": " to the agent with this number, a plain `int`" if several else "",
        "@words_note@": "return a `View`, whose elements are in the order of the flattened array"
        + (
            f", each a word of {FRACTION} bits behind the point: 1.5 is `3 << {FRACTION - 1}`."
            if "Signed" in view
            else "."
        )
        if view
        else "return one word."
        if isinstance(original.observation_space, Discrete)
        else "return its elements as a tuple, in the order of the flattened array.",
        "@random_note@": "It draws random numbers in a step; each draw of it is a request to `draws`."
        if seen.random_steps
        else "No step was seen to draw a random number.",
        "@reward_note@": "return an index into `REWARDS`, which lists what was seen; add what was not."
        if table
        else "return the value itself. Widen `reward` in the spec to all that there can be: what is beyond\n"
        "  becomes its end. If there are few different ones, list them as `REWARDS`, leave `reward` out, and "
        "return\n  an index.",
        "@action_note@": _action_note(original, seen),
        "@mask_agent@": agent,
        "@agents_note@": agents if several else "",
        "@rtl_agents@": str(original.agents * 64 if several else 64),
        "@pictures@": "the original draws them, put into a slot's state by `pose`; nothing is to be done."
        if original.registered and not original.options
        else "the original has no id with Gymnasium; give the spec `draw=`, which makes an image of a slot's "
        'words, and `render_modes=("rgb_array",)`, or leave them out.',
    }
