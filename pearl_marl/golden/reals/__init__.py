"""Real numbers in golden functions: fixed point that authors need not write.

Fields are :class:`Real`, authors' scopes have :data:`FUNCTIONS`, branches are joined by :func:`select`, and
:func:`pearl_marl.golden.reals.choices.stored` keeps what comes out; graphs that are traced are
:func:`admitted` to floats.
"""

from pearl_marl.golden.reals.choices import Choice, choice_of, joined, select
from pearl_marl.golden.reals.names import FUNCTIONS
from pearl_marl.golden.reals.numbers import Real as Real
from pearl_marl.golden.tracing.graph import Graph


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
