"""The original of MyEnvironment: how it is made, and how its state becomes one of ours and back."""

from typing import Any

from pearl_marl.porting import @helpers@

from .step import State


def original() -> Original:
    """Return a new original."""
    return Original(@original_arguments@)


def read(env: Any) -> State:
    """Return the state that an original is in, as one of ours."""
    return State(
@read@
    )


def pose(env: Any, state: State) -> None:
    """Put an original into a state of ours."""
@pose@
