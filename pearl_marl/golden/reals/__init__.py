"""Real numbers in golden functions: fixed point that authors need not write.

Fields are :class:`Real`, authors' scopes have :data:`FUNCTIONS`, branches are joined by :func:`select`, and
:func:`stored` keeps what comes out; graphs that are traced are :func:`admitted` to floats.
"""

from typing import Any

from pearl_marl.golden.reals.choices import Choice, choice_of, joined, select, stored
from pearl_marl.golden.reals.names import FUNCTIONS
from pearl_marl.golden.reals.numbers import Real, constant, fraction_for
from pearl_marl.golden.rebinding import TypeLike
from pearl_marl.golden.tracing.graph import Graph

__all__ = [
    "BUILTINS",
    "FUNCTIONS",
    "Choice",
    "Real",
    "admitted",
    "constant",
    "fraction_for",
    "select",
    "stored",
]

BUILTINS: dict[str, Any] = {
    **{function.__name__: FUNCTIONS[function] for function in (min, max, round)},
    "int": TypeLike(int, FUNCTIONS[int]),
}
"""Of the functions, those that golden functions name without an import."""


class _Floats:
    """What graphs ask for where words meet floats."""

    select = staticmethod(select)
    chosen = staticmethod(joined)
    functions = FUNCTIONS

    def __call__(self, word: object) -> Choice:
        return choice_of(word)  # type: ignore[arg-type]


def admitted(graph: Graph) -> Graph:
    """Let integers of a graph meet floats, as in the golden functions of an environment with reals."""
    graph.floats = _Floats()
    return graph
