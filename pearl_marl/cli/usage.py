"""What a wrong command line is told: one sentence with the value, what is possible, and the fix."""

from __future__ import annotations

import difflib
import re
import shlex
from collections.abc import Iterable
from typing import Any

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
    message = error.format_message()
    if message.startswith("No such command"):
        name = next(word for word in words if not word.startswith("-"))
        near = difflib.get_close_matches(name, list(commands), 1)
        hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(commands)}"
        return f"there is no command {name!r}; {hint}"
    if message.startswith("Got unexpected extra argument"):
        extra = message.split("(", 2)[2].rstrip(")")
        return f"{command} does not take {extra!r}, in: pearl {shlex.join(words)}; see {help_}"
    if message.startswith("Missing command"):
        return f"name a command: there are {', '.join(commands)}"
    return str(message)


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


_LIMITS = {"greater than or equal to": "at least", "less than or equal to": "at most"}
"""What pydantic says of the ends of ranges, and what we do."""


def _of_value(error: Any) -> str:
    """Return what is wrong with the value of an option or an argument."""
    param = error.param
    name = max(param.opts, key=len) if param.param_type_name == "option" else param.name.upper()
    reasons: list[Any] = getattr(error.__cause__, "errors", list)()
    if not reasons:
        return f"{name}: {error.message}"
    value, why = reasons[0]["input"], reasons[0]["msg"]
    if "is not one of" in why:
        return f"{name} is {value!r}; it must be one of {why.split('is not one of ')[1].rstrip('.')}"
    for limit, words in _LIMITS.items():
        if limit in why:
            most = why.partition(limit)[2].strip()
            return f"{name} is {value}; it must be {words} {int(most):,}"
    wanted = (
        why.removeprefix("Input should be ").partition(", unable")[0].replace("a valid integer", "an integer")
    )
    return f"{name} is {value!r}; it must be {wanted.replace('a valid ', 'a ')}"


def _lower(text: str | None) -> str:
    words = (text or "").strip().rstrip(".")
    return words[:1].lower() + words[1:]
