"""The golden step of Pursuit: pursuers walk, evaders that they surround are caught, and the others walk.

Follows https://pettingzoo.farama.org/environments/sisl/pursuit/ (``pettingzoo`` 1.27.0, ``pursuit_v5``):
J. Gupta, M. Egorov and M. Kochenderfer, *Cooperative Multi-agent Control Using Deep Reinforcement Learning*,
2017.
"""

from typing import Any, NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Flag, Range
from pearl_marl.spec import Golden

from .rules import PursuitRules
from .starts import scattered

MOVES = ((-1, 0), (1, 0), (0, 1), (0, -1), (0, 0), (0, 0), (0, 0), (0, 0))
"""How an action changes x and y: the first four lead to the cells beside."""


def make_golden(rules: PursuitRules) -> Golden:
    """Return the golden functions of a map."""
    right, bottom, window = rules.x_size - 1, rules.y_size - 1, rules.obs_range**2

    class Pursuer(NamedTuple):
        x: Range[0, right]
        y: Range[0, bottom]

    class Evader(NamedTuple):
        x: Range[0, right]
        y: Range[0, bottom]
        free: Flag

    class State(NamedTuple):
        pursuers: Array[Pursuer, rules.n_pursuers]
        evaders: Array[Evader, rules.n_evaders]

    class View(NamedTuple):
        """An agent's place, and the cells of its window that others are in; ``window`` is out of sight."""

        x: Range[0, right]
        y: Range[0, bottom]
        pursuers: Array[Range[0, window], rules.n_pursuers - 1]
        evaders: Array[Range[0, window], rules.n_evaders]

    def initial(draws: Draws) -> State:
        """Return a start: all evaders are free."""
        pursuers = [Pursuer(*place) for place in scattered(rules, draws, rules.n_pursuers)]
        return State(pursuers, [Evader(*place, 1) for place in scattered(rules, draws, rules.n_evaders)])

    def step(state: State, actions: list[Word], draws: Draws) -> tuple[State, list[Word], list[Word]]:
        """Move pursuers one by one; after each move every pursuer is paid for its tags. Then move evaders."""
        pursuers = [moved(one, action) for one, action in zip(state.pursuers, actions, strict=True)]
        pairs = enumerate(zip(state.pursuers, pursuers, strict=True))
        tagged = [k * tags(old, state) + (rules.n_pursuers - k) * tags(new, state) for k, (old, new) in pairs]
        caught = [one.free and is_caught(one, pursuers) for one in state.evaders]
        # A pursuer catches from a cell beside a surrounded evader, and otherwise from the evader's own cell.
        taken = list(zip(state.evaders, caught, strict=True))
        catches = [any(lost and distance(me, it) == rules.surround for it, lost in taken) for me in pursuers]
        evaders = []
        for (one, lost), move in zip(taken, draws.several(*[5] * rules.n_evaders), strict=True):
            walks = one.free and not lost and not rules.freeze_evaders
            evaders.append((moved(one, move) if walks else one)._replace(free=one.free and not lost))
        rewards = [rules.category(*of_one) for of_one in zip(tagged, catches, strict=True)]
        if rules.shared_reward:
            rewards = [rules.category(sum(tagged), sum(catches))] * rules.n_pursuers
        return State(pursuers, evaders), rewards, [not any(one.free for one in evaders)] * rules.n_pursuers

    def moved(one: Any, action: Word) -> Any:
        """Return a pursuer or an evader after an action: edges and the building are in its way."""
        x, y = MOVES[action]
        x, y = min(max(one.x + x, 0), right), min(max(one.y + y, 0), bottom)
        return one if rules.blocked(x, y) else one._replace(x=x, y=y)

    def tags(pursuer: Pursuer, state: State) -> Word:
        """Return how many evaders are beside a pursuer; beyond an edge, its own cell counts again."""
        far = [distance(pursuer, one) if one.free else 2 for one in state.evaders]
        edges = (pursuer.x == 0) + (pursuer.x == right) + (pursuer.y == 0) + (pursuer.y == bottom)
        return sum(steps == 1 for steps in far) + min(edges, 2) * sum(steps == 0 for steps in far)

    def is_caught(evader: Evader, pursuers: list[Pursuer]) -> Word:
        """Return whether an evader is surrounded, or ``n_catch`` pursuers are in its cell."""
        if not rules.surround:
            return sum(distance(one, evader) == 0 for one in pursuers) >= rules.n_catch
        cells = [(evader.x + x, evader.y + y) for x, y in MOVES[:4]]
        outside = evader.x == 0, evader.x == right, evader.y == bottom, evader.y == 0
        return all(
            edge or rules.blocked(x, y) or any(one.x == x and one.y == y for one in pursuers)
            for (x, y), edge in zip(cells, outside, strict=True)
        )

    def observe(state: State, agent: int) -> View:
        """Return where an agent is, and where in its window others are."""
        me, others = state.pursuers[agent], state.pursuers[:agent] + state.pursuers[agent + 1 :]
        evaders = [cell_of(me, one) if one.free else window for one in state.evaders]
        return View(me.x, me.y, [cell_of(me, one) for one in others], evaders)

    def cell_of(me: Pursuer, other: Any) -> Word:
        """Return the cell of an agent's window where another one is."""
        side = rules.obs_range
        x, y = other.x - me.x + side // 2, other.y - me.y + side // 2
        return side * y + x if 0 <= x < side and 0 <= y < side else window

    return Golden(State, initial, step, observe, view=View)


def distance(one: Any, other: Any) -> Word:
    """Return how many steps there are between two."""
    return abs(one.x - other.x) + abs(one.y - other.y)
