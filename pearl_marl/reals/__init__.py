"""Real numbers in golden functions: fixed point that nobody has to write.

A front end gives fields as :class:`Real`, has :data:`FUNCTIONS` in the author's scope, joins branches by
:func:`select`, and keeps what comes out by :func:`stored`. Graphs that it traces are :func:`admitted` to
floats.
"""

from pearl_marl.reals.choices import Choice, choice_of, select, stored
from pearl_marl.reals.names import FUNCTIONS
from pearl_marl.reals.numbers import Real, fraction_for
from pearl_marl.tracing.graph import Graph

__all__ = ["FUNCTIONS", "Choice", "Real", "admitted", "fraction_for", "select", "stored"]


def admitted(graph: Graph) -> Graph:
    """Let integers of a graph meet floats, as they do where golden functions have reals; return it."""
    graph.floats = choice_of
    return graph
