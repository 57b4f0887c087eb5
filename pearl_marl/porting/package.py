"""The files of the package that ``pearl new NAME --from`` writes: of tables, or to be filled in."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete, MultiBinary, MultiDiscrete, Tuple

from pearl_marl.base.placeholders import fill
from pearl_marl.porting.finite import Finite
from pearl_marl.porting.originals import Original
from pearl_marl.porting.tables import Tables, padded_size, side_by_side, written
from pearl_marl.spec import snake_case

TEMPLATE = "MyEnvironment"
SPACES = ("Box", "Discrete", "MultiBinary", "MultiDiscrete", "Tuple")
WIDTH = 110
"""Letters of a line of code."""


def own_words(name: str) -> dict[str, str]:
    """Return what stands for the template's own name in a package of another name."""
    snake = snake_case(name)
    return {
        TEMPLATE: name,
        snake_case(TEMPLATE): snake,
        snake_case(TEMPLATE).replace("_", "-"): snake.replace("_", "-"),
    }


def filled(template: str, words: Mapping[str, str]) -> dict[str, str]:
    """Return the files of a template's folder by their paths, with words replaced in both."""

    def walk(folder: Traversable, path: str) -> dict[str, str]:
        files: dict[str, str] = {}
        for item in folder.iterdir():
            if item.is_file():
                files[fill(f"{path}{item.name}", words)] = fill(item.read_text("utf-8"), words)
            elif not item.name.startswith((".", "_")):  # caches of pip and of linters
                files |= walk(item, f"{path}{item.name}/")
        return files

    return walk(resources.files("pearl_marl") / "templates" / template, "")


def of_tables(name: str, original: Original, found: Finite, made: Tables) -> dict[str, str | bytes]:
    """Return the files of a package that looks into the tables of a finite original."""
    module = written(made, name, named(original))
    words = {**own_words(name), **common_words(original), **_table_words(original, found, made)}
    words["@files@"] = (
        "``tables.py``" if module.arrays is None else "``tables.npz``, which ``tables.py`` reads"
    )
    folder = snake_case(name)
    listed = [f"`{folder}/tables.py`", *[f"`{folder}/tables.npz`"][: module.arrays is not None]]
    words["@tables@"] = ", ".join(listed)
    names = list(module.names)
    words["from .tables import @names@"] = import_line(".tables", names)
    files: dict[str, str | bytes] = {**filled("environment", words), **filled("table", words)}
    files[f"{folder}/tables.py"] = module.text
    if module.arrays is not None:
        files[f"{folder}/tables.npz"] = module.arrays
        project = files["pyproject.toml"]
        assert isinstance(project, str)
        packages = f'packages = ["{folder}"]\n'
        files["pyproject.toml"] = project.replace(
            packages, f'{packages}\n[tool.setuptools.package-data]\n"{folder}" = ["tables.npz"]\n'
        )
    return files


def common_words(original: Original) -> dict[str, str]:
    """Return what stands for the placeholders that all templates have."""
    given = [f"{key}={quoted(value)}" for key, value in original.options.items()]
    return {
        "@original@": original.name,
        "@option@": options_on_a_command(original.options),
        "@against@": original.name + options_on_a_command(original.options, "--original-option"),
        "@original_arguments@": ", ".join([quoted(original.name), *given]),
        "@observation_space@": space_text(original.observation_space),
        "@action_space@": space_text(original.action_space),
        "        observation_space=@observation_space@,": space_line(
            "observation_space", original.observation_space
        ),
        "@max_cycles@": str(original.limit),
        "@summary@": f"As {named(original)}",
    }


def named(original: Original) -> str:
    """Return an original's name with its options, as a command takes them."""
    return original.name + options_on_a_command(original.options)


def quoted(value: Any) -> str:
    """Return texts as ruff writes them."""
    return repr(value).replace("'", '"')


def options_on_a_command(options: Mapping[str, Any], option: str = "--option") -> str:
    """Return options as a command takes them, after a blank."""
    return "".join(f" {option} {shlex.quote(f'{key}={value}')}" for key, value in options.items())


def import_line(module: str, names: list[str]) -> str:
    """Return an import as ruff writes it."""
    line = f"from {module} import {', '.join(names)}"
    if len(line) <= WIDTH:
        return line
    return "\n".join([f"from {module} import (", *(f"    {name}," for name in names), ")"])


def space_line(name: str, space: Any) -> str:
    """Return a space as an argument of the spec, on several lines if it is long."""
    line = f"        {name}={space_text(space)},"
    if len(line) <= WIDTH or not isinstance(space, Box):
        return line
    lines = [f"            {part}," for part in _box_parts(space)]
    lines = [part if len(part) <= WIDTH else f"{part}  # noqa: E501" for part in lines]
    return "\n".join([f"        {name}=Box(", *lines, "        ),"])


def _box_parts(space: Box) -> list[str]:
    """Return the arguments of a Box; one of its bounds may say its shape."""
    dtype = f"np.{space.dtype}" if space.dtype != bool else "np.bool_"
    ends = [_bound_text(end, dtype) for end in (space.low, space.high)]
    shape = [] if any(end.startswith("np.array") for end in ends) else [repr(space.shape)]
    return [*ends, *shape, f"dtype={dtype}"]


def space_text(space: Any) -> str:
    """Return a space as Python writes it."""
    if isinstance(space, Discrete):
        return f"Discrete({space.n})" if space.start == 0 else f"Discrete({space.n}, start={space.start})"
    if isinstance(space, Tuple):
        parts = [space_text(part) for part in space.spaces]
        return f"Tuple(({', '.join(parts)}{',' * (len(parts) == 1)}))"
    if isinstance(space, MultiBinary):
        return f"MultiBinary({space.n if isinstance(space.n, int) else list(space.n)})"
    if isinstance(space, MultiDiscrete):
        start = f", start={space.start.tolist()}" if space.start.any() else ""
        dtype = "" if space.dtype == np.int64 else f", dtype=np.{space.dtype}"
        return f"MultiDiscrete({space.nvec.tolist()}{dtype}{start})"
    assert isinstance(space, Box)
    return f"Box({', '.join(_box_parts(space))})"


def spaces_import(text: str) -> str:
    """Return the import of the spaces that a text makes."""
    kinds = sorted({match[1] for match in re.finditer(r"\b(\w+)\(", text)} & set(SPACES))
    return f"from gymnasium.spaces import {', '.join(kinds)}"


def _bound_text(bound: Any, dtype: str) -> str:
    def number(value: Any) -> str:
        if np.isinf(value):
            return "-np.inf" if value < 0 else "np.inf"
        return str(value)

    def listed(part: Any) -> str:
        return f"[{', '.join(map(listed, part))}]" if np.ndim(part) else number(part)

    if (bound == bound.flat[0]).all():
        return number(bound.flat[0])
    return f"np.array({listed(bound)}, {dtype})"


def _table_words(original: Original, found: Finite, made: Tables) -> dict[str, str]:
    actions = len(found.rows[0])
    row = "ACTIONS * state.number + " + (
        "action" if actions & (actions - 1) == 0 else "min(action, ACTIONS - 1)"
    )
    lines = [f"row = {row}"]
    entry = "row"
    helpers = False
    if made.outcomes > 1:
        if side_by_side(made):
            lines += ["draw = draws.bits()", "outcome = sum(draw >= least for least in LEAST)"]
        else:
            padded = padded_size(made)
            kind = f"{padded} * CHANCES[row]" if len(made.least) > 1 else "0"
            lines.append(f"outcome = min(place_of(draws.bits(), LEAST, {kind}, {padded}), OUTCOMES - 1)")
            helpers = True
        lines.append("entry = OUTCOMES * row + outcome")
        entry = "entry"
    lines.append(f"return State(NEXT[{entry}]), REWARD[{entry}], TERMINATED[{entry}]")
    if len(made.starts) == 1:
        start = [f"return State({made.starts[0]})"]
    elif made.start_least is None:
        start = ["return State(STARTS[draws.below(len(STARTS))])"]
    else:
        size = 1 << (len(made.starts) - 1).bit_length()
        start = [
            f"place = place_of(draws.bits(), START_LEAST, 0, {size})",
            "return State(STARTS[min(place, len(STARTS) - 1)])",
        ]
        helpers = True
    view = _view(original, made)
    shown = "state.number" if made.observations is None else "OBSERVATIONS[state.number]"
    if view:
        shown = f"View(list({shown}))" if len(found.observations[0]) > 1 else f"View([{shown}])"
    kinds = ["Range"] + (["Array"] if view else []) + (["Signed"] if "Signed[" in view else [])
    rendered = original.registered and not original.options and found.of_table and hasattr(original.env, "s")
    return {
        "@kinds@": ", ".join(sorted(kinds)),
        "@states@": str(found.states),
        "@actions@": str(actions),
        "@outcomes@": str(made.outcomes),
        "@which@": ": the original's own number"
        if found.of_table
        else ", in the order in which they were found",
        "@source@": "the original's own" if found.of_table else "all that can be reached",
        "@start@": f"{len(made.starts)} state{'s' * (len(made.starts) > 1)}",
        "@rewards@": ", ".join(map(str, made.rewards))
        if len(made.rewards) <= 16
        else f"{len(made.rewards)} values",
        "@view@": view,
        "@initial@": "\n".join(f"    {line}" for line in start),
        "@step@": "\n".join(f"    {line}" for line in lines),
        "@observed@": "View" if view else "Word" if len(found.observations[0]) == 1 else "tuple[Word, ...]",
        "@observe@": f"return {shown}",
        "@helpers@": _PLACE_OF if helpers else "",
        "@step_names@": "State, View, initial, observe, step" if view else "State, initial, observe, step",
        "@pose@": _POSE.format(name=original.name) if rendered else "",
        **spec_words(original, bool(view), rendered, posed_here=rendered),
    }


def spec_words(
    original: Original, view: bool, drawn: bool, imports: str = "", posed_here: bool = False
) -> dict[str, str]:
    """Return what stands for the placeholders that all specs have; the original may draw it."""
    spaces = space_text(original.observation_space) + space_text(original.action_space)
    lines = ["from typing import Any", ""] * posed_here + ["import numpy as np"] * ("np." in spaces)
    lines += ["from gymnasium import Env"] * posed_here + [spaces_import(spaces)]
    lines.append(imports or "from pearl_marl.spec import EnvSpec, Golden")
    more = [f"follows={quoted(named(original))}"]
    if drawn:
        modes = tuple(getattr(original.env, "metadata", {}).get("render_modes", ()))
        more = [
            f"oracle={quoted(original.name)}",
            *["pose=pose"] * posed_here,
            f"render_modes={quoted(modes)}",
        ]
    return {
        "@spec_imports@": "\n".join([*lines, ""]),
        "@golden_view@": ", view=View" if view else "",
        "@more@": "".join(f"        {line},\n" for line in more),
    }


def _view(original: Original, made: Tables) -> str:
    """Return the class of what is observed; nothing where the space says how wide it is."""
    if not isinstance(original.observation_space, Box):
        return ""
    words = np.array([[0], [max(made.after)]] if made.observations is None else made.observations)
    low, high, size = int(words.min()), int(words.max()), words.shape[1]
    if made.fraction:
        bits = max(high.bit_length(), (~low).bit_length() if low < 0 else 0, made.fraction) + 1
        kind = f"Signed[{bits}, {made.fraction}]"
    else:
        kind = f"Range[{low}, {high}]"
    return f'''

class View(NamedTuple):
    """What an agent sees, element by element."""

    elements: Array[{kind}, {size}]
'''


_PLACE_OF = '''

def place_of(draw: Word, least: tuple[int, ...], first: Word, size: int) -> Word:
    """Return the last of ``size`` places, a power of two, whose least draw is not above the draw."""
    place = 0
    half = size // 2
    while half:
        if draw >= least[first + place + half]:
            place = place + half
        half = half // 2
    return place
'''

_POSE = '''

def pose(oracle: Env[Any, Any], state: State) -> None:
    """Put {name} into a state, for rendering and for `pearl verify --against`."""
    oracle.s = state.number  # type: ignore[attr-defined]
    oracle.lastaction = None  # type: ignore[attr-defined]
'''
