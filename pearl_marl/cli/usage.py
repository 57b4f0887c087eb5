"""What a wrong command line is told: one sentence with the value, what is possible, and the fix."""

from __future__ import annotations

import difflib
import enum
import re
import shlex
from collections.abc import Iterable
from typing import Any, get_args

from pearl_marl.errors import ArgumentError


def sentence(error: Any, commands: Iterable[str], arguments: Iterable[str]) -> str:
    """Return it for one of Typer's errors, the names of all commands, and the words of the command line."""
    kind, context = type(error).__name__, getattr(error, "ctx", None)
    words = list(arguments)
    of_command = _path(context)
    # An option without its value is found before its command has a context.
    named = of_command or next((word for word in words if word in commands), None)
    command, help_ = of_command or "pearl", f"pearl {named} --help" if named else "pearl --help"
    if kind == "BadParameter":
        return _of_value(error)
    if kind == "MissingParameter":
        what = getattr(error.param, "metavar", None) or error.param.name.upper()
        name = error.param.opts[0] if error.param.param_type_name == "option" else what
        return f"{command} needs {name}: {_lower(error.param.help)} ({help_} tells more)"
    if kind == "NoSuchOption":
        near = difflib.get_close_matches(error.option_name, error.possibilities or (), 1)
        hint = f"did you mean {near[0]}?" if near else f"{help_} lists those that there are"
        if named and not of_command:
            hint = f"options stand after the command, and pearl {named} --help lists its own"
        return f"{command} has no option {error.option_name}; {hint}"
    if kind == "BadOptionUsage":
        return f"{error.format_message().rstrip('.')}: see {help_}"
    if kind == "UsageError" and context is not None and not of_command:
        return no_command(words, commands)
    return str(error.format_message())


def no_command(words: list[str], commands: Iterable[str]) -> str:
    """Return what a command line is told that names no command, or none that there is."""
    name = next((word for word in words if not word.startswith("-")), None)
    if name is None:
        return f"name a command: there are {', '.join(commands)}"
    near = difflib.get_close_matches(name, list(commands), 1)
    hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(commands)}"
    return f"there is no command {name!r}; {hint}"


def refuse_others(context: Any, others: list[str], arguments: list[str]) -> None:
    """Refuse arguments that the command of a context does not take."""
    if others:
        command = _path(context)
        raise ArgumentError(
            f"{command} does not take {' '.join(others)!r}, in: pearl {shlex.join(arguments)}; "
            f"see pearl {command} --help"
        )


def _path(context: Any) -> str:
    """Return the words that name a command, without ``pearl``: ``"bench steps"``."""
    if context is None or context.parent is None:
        return ""
    return f"{_path(context.parent)} {context.info_name}".strip()


def refuse_empty(arguments: Iterable[str]) -> None:
    """Refuse an argument that is empty, also as an option's value: a path would be the current folder."""
    before = ""
    for word in arguments:
        if word == "":
            what = before if before.startswith("--") else "an argument"
            raise ArgumentError(f"{what} is empty; give it a value, or leave it out")
        if re.fullmatch(r"--[\w-]+=", word):
            raise ArgumentError(f"{word[:-1]} is empty; give it a value, or leave it out")
        before = word


_KINDS = {"int_parsing": "an integer", "float_parsing": "a number"}
"""What a value has to be, by the type of pydantic's error."""


def _of_value(error: Any) -> str:
    """Return what is wrong with the value of an option or an argument."""
    param = error.param
    name = max(param.opts, key=len) if param.param_type_name == "option" else param.name.upper()
    reasons: list[Any] = getattr(error.__cause__, "errors", list)()
    if not reasons:
        return f"{name}: {error.message}"
    value, kind, limits = reasons[0]["input"], reasons[0]["type"], reasons[0].get("ctx", {})
    if choices := _choices(param):
        return f"{name} is {value!r}; it must be one of {', '.join(map(repr, choices))}"
    for end, words in (("ge", "at least"), ("le", "at most")):
        if end in limits:
            return f"{name} is {value}; it must be {words} {limits[end]:,}"
    return f"{name} is {value!r}; it must be {_KINDS[kind]}" if kind in _KINDS else f"{name}: {error.message}"


def _choices(param: Any) -> list[Any]:
    """Return the values of an option that is an enumeration, if it is one."""
    kind = getattr(getattr(param, "type_descriptor", None), "annotation", None)
    kinds = (kind, *get_args(kind))
    enums = (one for one in kinds if isinstance(one, type) and issubclass(one, enum.Enum))
    return [member.value for member in next(enums, ())]


def _lower(text: str | None) -> str:
    words = (text or "").strip().rstrip(".")
    return words[:1].lower() + words[1:]
