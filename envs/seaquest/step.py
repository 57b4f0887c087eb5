"""The golden step of Seaquest: MinAtar's game, its lists turned into bit planes.

MinAtar keeps lists of ``[x, y, direction, timers]`` and loops over them. Here a list is a *conveyor*: a few
planes, one for each bit of an entry, in which bit ``k`` of all planes together is the entry in place
``k``. One instruction then does the same to all entries, which is fast on a CPU and nearly free in hardware:

- the oldest entry is bit 0, so the order of the bits is the order of MinAtar's list;
- a new entry goes above the topmost place and then everything moves down by one, out at the bottom;
- an entry that leaves the game only loses its bit of the plane ``alive``. Nothing is closed up.

A conveyor needs as many places as entries can arrive during the life of one, and that is bounded:

- enemies arrive at most one a step, and only when the difficulty is at its highest, where one crosses the
  board in 30 steps, 29 of which see it at their end: 29 places for fish and submarines together;
- at that speed submarines fire 10 and 21 steps after they appeared, from columns 3 and 7: at most two a step,
  and the bullets last 6 steps: 12 places. Slower submarines are too far apart to need as many;
- an own bullet lasts 9 steps and needs 5 to reload; a diver lasts 60 and one comes every 30: 2 places each.

So no list overflows, ever; the tests drive it to these limits. What the order of play in MinAtar comes to for
planes rests on two more facts: no two enemies of a row have the same place and the same move timer, because
they appeared at different steps and slower times had them 14 steps apart; and own bullets never meet.

Follows https://github.com/kenjyoung/MinAtar (1.0.15, ``seaquest``): K. Young and T. Tian, *MinAtar: An
Atari-Inspired Testbed for Thorough and Reproducible Reinforcement Learning Experiments*, 2019.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from pearl_marl.envs.minatar import DOWN, FIRE, LEFT, NOTHING, RIGHT, UP
from pearl_marl.envs.minatar_planes import (
    bits,
    counted_down,
    lowest,
    moved,
    off_board,
    places_of,
    spread,
)
from pearl_marl.golden import Draws, GoldenFunction, Word, i16
from pearl_marl.layout import Array, Bits, Flag, Range, Signed

LAST_COLUMN, DEEPEST = 9, 8  # the sea has rows 1 to 8; 0 is the surface
MAX_OXYGEN, MAX_DIVERS, LEAST_DIVERS = 200, 6, -(1 << 15)
RELOAD_STEPS, FIRE_INTERVAL = 5, 10
SLOWEST_SPAWN, DIVER_SPAWN = 20, 30
SLOWEST_MOVE, MOVE_RAMPS = 5, 3
LAST_RAMP = SLOWEST_SPAWN - 1

ENEMIES, BULLETS = 29, 12
"""Places of the two conveyors."""
ENEMY_PLACES, BULLET_PLACES = (1 << ENEMIES) - 1, (1 << BULLETS) - 1

CHANCE_BITS = 28
"""Of a draw, the bits below a direction and a row: they decide by comparison."""
CHANCE = (1 << CHANCE_BITS) - 1
THIRD = -(-(1 << CHANCE_BITS) // 3)

DIVERS_MOVE = sum(1 << timer for timer in (1, 7, 13, 19, 25))
"""By the diver spawn timer, whether this step moves the divers: 30 is a multiple of the 6 steps that
they take for a cell, so they all move at the same time."""


class Enemies(NamedTuple):
    """What is seen of fish and submarines: the planes of their conveyor."""

    alive: Bits[ENEMIES]
    submarine: Bits[ENEMIES]
    rightward: Bits[ENEMIES]
    row: Array[Bits[ENEMIES], 3]
    column: Array[Bits[ENEMIES], 4]


class Timers(NamedTuple):
    """How many steps it takes the enemies to move and to fire: more planes of theirs."""

    move: Array[Bits[ENEMIES], 3]
    fire: Array[Bits[ENEMIES], 4]


class Hostile(NamedTuple):
    """The conveyor of hostile bullets."""

    alive: Bits[BULLETS]
    rightward: Bits[BULLETS]
    row: Array[Bits[BULLETS], 3]
    column: Array[Bits[BULLETS], 4]


class State(NamedTuple):
    """The game. Of two bullets or divers, the first is the older."""

    last_action: Bits[3]
    x: Range[0, LAST_COLUMN]
    y: Range[0, DEEPEST]
    facing_right: Flag
    surfaced: Flag
    oxygen: Range[0, MAX_OXYGEN]
    aboard: Signed[16]
    reload: Range[0, RELOAD_STEPS]
    enemy_timer: Range[0, SLOWEST_SPAWN]
    diver_timer: Range[0, DIVER_SPAWN]
    ramp: Range[0, LAST_RAMP]
    bullets: Array[Bits[10], 2]
    """Column (4 bits), row of the board (4), rightward (1), alive (1)."""
    divers: Array[Bits[9], 2]
    """Column (4 bits), row of the sea (3), rightward (1), alive (1)."""
    enemies: Enemies
    timers: Timers
    hostile: Hostile


class Bullets(NamedTuple):
    """What is seen of hostile bullets: not where they are heading."""

    alive: Bits[BULLETS]
    row: Array[Bits[BULLETS], 3]
    column: Array[Bits[BULLETS], 4]


class View(NamedTuple):
    """What can be seen: of the state, all but timers and where hostile bullets are heading."""

    x: Range[0, LAST_COLUMN]
    y: Range[0, DEEPEST]
    facing_right: Flag
    oxygen_bar: Bits[4]
    aboard: Bits[3]
    bullets: Array[Bits[10], 2]
    divers: Array[Bits[9], 2]
    enemies: Enemies
    hostile: Bullets


def each_plane(change: Callable[..., Word], *groups: Any) -> Any:
    """Return a group whose planes are what ``change`` makes of those of groups like it."""
    first = groups[0]
    if not isinstance(first, (list, tuple)):
        return change(*groups)
    planes = [each_plane(change, *parts) for parts in zip(*groups, strict=True)]
    return type(first)(*planes) if hasattr(first, "_fields") else planes


def in_row(row: list[Word], y: Word) -> Word:
    """Return the places in row ``y`` of the board; their planes count rows of the sea, from 0."""
    return places_of(row, y - 1) if 1 <= y <= DEEPEST else 0


def moved_x(x: Word, rightward: Word, moves: Word) -> Word:
    """Move one column as :func:`moved` does."""
    return (x + (moves & rightward) - (moves & (rightward == 0))) & 15


def repeated(timer: list[Word], interval: Word) -> tuple[list[Word], Word]:
    """Count a timer down in all places; return it, beginning anew where it was 0, and these places."""
    timer, ends = counted_down(timer, -1)
    kept = [~ends | spread(bit) for bit in bits(interval, len(timer))]
    return [plane & bit for plane, bit in zip(timer, kept, strict=True)], ends


def first_struck(there: Word, submarine: Word) -> Word:
    """Return what a bullet strikes of the enemies there: the first fish, else the first submarine."""
    fish = there & ~submarine
    return lowest(fish if fish else there)


def diver_after(record: Word, x: Word, y: Word, aboard: Word, moves: Word) -> tuple[Word, Word]:
    """Let one diver come aboard or move; return its record and whether it came aboard."""
    column, line = record & 15, record >> 4 & 7
    rightward, alive = record >> 7 & 1, record >> 8
    beside = (line == y - 1) & alive & (aboard < MAX_DIVERS)
    before = beside & (column == x)
    column = moved_x(column, rightward, moves & (before == 0))
    after = beside & (column == x)
    alive = alive & (after == 0) & (column <= LAST_COLUMN)
    return column | (record & 0xF0) | (alive << 8), after


def tenths(oxygen: Word) -> Word:
    """Return ``oxygen // 20``, how many tenths are left; this product takes hardware no multiplier."""
    return (oxygen >> 2) * 13 >> 6


def initial(draws: Draws) -> State:
    """Return the state of a new episode: an empty sea, the submarine at its surface."""
    return State(
        last_action=NOTHING,
        x=5,
        y=0,
        facing_right=0,
        surfaced=1,
        oxygen=MAX_OXYGEN,
        aboard=0,
        reload=0,
        enemy_timer=SLOWEST_SPAWN,
        diver_timer=DIVER_SPAWN,
        ramp=0,
        bullets=[0] * 2,
        divers=[0] * 2,
        enemies=Enemies(0, 0, 0, [0] * 3, [0] * 4),
        timers=Timers([0] * 3, [0] * 4),
        hostile=Hostile(0, 0, [0] * 3, [0] * 4),
    )


def make_step(sticky_below: int, ramping: bool) -> GoldenFunction:
    """Return the golden step under its options.

    Parameters
    ----------
    sticky_below
        The last action is repeated where the lower 28 bits of the second draw are below this.
    ramping
        Whether surfacing makes enemies faster and more frequent.
    """

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Play one step; return the next state, the reward and whether the episode terminated."""
        # Of each draw, bit 31 is a direction and bits 30 to 28 are a row; the rest decides by comparison.
        of_enemy, of_diver = draws.bits(), draws.bits()
        if (of_diver & CHANCE) < sticky_below:
            action = state.last_action
        move_interval = SLOWEST_MOVE - min(state.ramp >> 1, MOVE_RAMPS)
        spawn_interval = SLOWEST_SPAWN - min(state.ramp, LAST_RAMP)

        # An enemy appears above the topmost place, unless its row has one that swims the other way.
        enemies, timers, enemy_timer = state.enemies, state.timers, state.enemy_timer
        rightward, row = of_enemy >> 31, of_enemy >> 28 & 7
        opposed = in_row(enemies.row, row + 1) & enemies.alive & (enemies.rightward ^ spread(rightward))
        appears = (enemy_timer == 0) & (opposed == 0)
        submarine, edge = (of_enemy & CHANCE) < THIRD, 0 if rightward else LAST_COLUMN
        enemy = Enemies(appears, submarine, rightward, bits(row, 3), bits(edge, 4))
        timer = Timers(bits(move_interval, 3), bits(FIRE_INTERVAL, 4))
        enemies, timers = each_plane(
            lambda plane, bit: plane | bit << ENEMIES, (enemies, timers), (enemy, timer)
        )
        enemy_timer = (spawn_interval if enemy_timer == 0 else enemy_timer) - 1

        # A diver appears; when that is, the older place is empty.
        divers, diver_timer = state.divers, state.diver_timer
        divers_move = DIVERS_MOVE >> diver_timer & 1
        if diver_timer == 0:
            heading = of_diver >> 31
            edge, row = 0 if heading else LAST_COLUMN, of_diver >> 28 & 7
            divers = [divers[1], edge | row << 4 | heading << 7 | 1 << 8]
            diver_timer = DIVER_SPAWN
        diver_timer = diver_timer - 1

        # The action. A bullet starts where the submarine is.
        x, y, facing_right, bullets = state.x, state.y, state.facing_right, state.bullets
        reload = max(state.reload - 1, 0)
        if action == FIRE and state.reload == 0:
            bullets = [bullets[1], x | y << 4 | facing_right << 8 | 1 << 9]
            reload = RELOAD_STEPS - 1
        elif action == LEFT:
            x, facing_right = max(x - 1, 0), 0
        elif action == RIGHT:
            x, facing_right = min(x + 1, LAST_COLUMN), 1
        elif action == UP:
            y = max(y - 1, 0)
        elif action == DOWN:
            y = min(y + 1, DEEPEST)

        # Own bullets move and strike, the newer first.
        bullets_x = [moved_x(bullet & 15, bullet >> 8 & 1, 1) for bullet in bullets]
        flying = [bullet >> 9 & (at <= LAST_COLUMN) for bullet, at in zip(bullets, bullets_x, strict=True)]
        bullets_row = [in_row(enemies.row, bullet >> 4 & 15) for bullet in bullets]
        alive, hits = enemies.alive, [0, 0]
        for k in (1, 0):
            there = alive & bullets_row[k] & places_of(enemies.column, bullets_x[k])
            struck = first_struck(there, enemies.submarine) if flying[k] else 0
            alive = alive ^ struck
            hits[k] = struck != 0
            flying[k] = flying[k] & (struck == 0)

        # Divers, the newer first.
        aboard = state.aboard
        newer, joins = diver_after(divers[1], x, y, aboard, divers_move)
        aboard = aboard + joins
        older, joins = diver_after(divers[0], x, y, aboard, divers_move)
        aboard = aboard + joins

        # Enemies meet the submarine, move, meet it again, and may swim into a bullet.
        beside = in_row(enemies.row, y)
        met = alive & beside & places_of(enemies.column, x)
        move, moves = repeated(timers.move, move_interval)
        column = moved(enemies.column, enemies.rightward, moves)
        armed = alive & enemies.submarine  # a submarine that is struck now may still fire
        alive = alive & ~off_board(column)
        arrives = alive & moves
        there = beside & places_of(column, x)
        met = met | (arrives & there)
        arrives = arrives & ~there
        for k in range(2):
            struck = arrives & bullets_row[k] & places_of(column, bullets_x[k]) if flying[k] else 0
            alive, arrives = alive ^ struck, arrives & ~struck
            hits[k] = hits[k] | (struck != 0)
            flying[k] = flying[k] & (struck == 0)
        enemies = enemies._replace(alive=alive, column=column)

        # Submarines fire, the newer first: at most two, `low` the older.
        fire, ready = repeated(timers.fire, FIRE_INTERVAL)
        fires = armed & ready
        low = lowest(fires)
        high = fires ^ low
        twice = high != 0
        newest = high if twice else low
        fired = newest != 0

        def with_new(plane: Word, of_enemies: Word) -> Word:
            """Return a plane with the bits of the bullets just fired above the topmost place."""
            first, second = (of_enemies & newest) != 0, (of_enemies & low) != 0
            return plane | first << BULLETS | second << BULLETS + 1

        hostile = state.hostile
        shooters = enemies.rightward, enemies.row, enemies.column
        hostile = Hostile(
            hostile.alive | fired << BULLETS | twice << BULLETS + 1,
            *each_plane(with_new, hostile[1:], shooters),
        )

        # Hostile bullets, the new ones too, meet the submarine, move, and meet it again.
        beside = hostile.alive & in_row(hostile.row, y)
        shot = beside & places_of(hostile.column, x)
        column = moved(hostile.column, hostile.rightward, -1)
        shot = shot | (beside & places_of(column, x))
        hostile = hostile._replace(alive=hostile.alive & ~off_board(column), column=column)

        # Oxygen and the surface.
        oxygen, surfaced, ramp, reward = state.oxygen, state.surfaced, state.ramp, hits[0] + hits[1]
        returns = (y == 0) & (surfaced == 0)
        surfaces = returns & (aboard != 0)
        terminated = (met != 0) | (shot != 0) | (oxygen == 0) | (returns & (aboard == 0))
        if surfaces:
            full = aboard == MAX_DIVERS
            reward = reward + (tenths(oxygen) if full else 0)
            # MinAtar takes one more diver after it took all six, and so do we: -1 is left.
            aboard = (0 if full else aboard) - (aboard > LEAST_DIVERS)
            oxygen, surfaced = MAX_OXYGEN, 1
            ramp = min(ramp + ramping, LAST_RAMP)
        elif y > 0:
            oxygen, surfaced = max(oxygen - 1, 0), 0
        aboard = i16(aboard)  # no more than six get in, which the compiler cannot see

        # Down by one place for an enemy that appeared, by one for each bullet fired.
        enemies, timers = each_plane(
            lambda plane: plane >> appears & ENEMY_PLACES, (enemies, Timers(move, fire))
        )
        hostile = each_plane(lambda plane: plane >> fired + twice & BULLET_PLACES, hostile)
        bullets = [
            at | bullet & 0x1F0 | flies << 9
            for bullet, at, flies in zip(bullets, bullets_x, flying, strict=True)
        ]
        after = State(
            *(action, x, y, facing_right, surfaced, oxygen, aboard, reload, enemy_timer, diver_timer, ramp),
            *(bullets, [older, newer], enemies, timers, hostile),
        )
        return after, reward, terminated

    return step


def observe(state: State) -> View:
    """Return what can be seen."""
    return View(
        state.x,
        state.y,
        state.facing_right,
        tenths(state.oxygen),
        max(state.aboard, 0) & 7,
        state.bullets,
        state.divers,
        state.enemies,
        Bullets(state.hostile.alive, state.hostile.row, state.hostile.column),
    )
