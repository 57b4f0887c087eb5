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

import numpy as np

from pearl_marl.golden import GoldenFunction, Word, i16

NOTHING, LEFT, UP, RIGHT, DOWN, FIRE = range(6)
LAST_COLUMN, DEEPEST = 9, 8  # the sea has rows 1 to 8; 0 is the surface
MAX_OXYGEN, MAX_DIVERS, LEAST_DIVERS = 200, 6, -(1 << 15)
RELOAD_STEPS, FIRE_INTERVAL = 5, 10
SLOWEST_SPAWN, DIVER_SPAWN = 20, 30
SLOWEST_MOVE, MOVE_RAMPS = 5, 3
LAST_RAMP = SLOWEST_SPAWN - 1

ENEMIES, BULLETS = 29, 12
"""Places of the two conveyors."""
RECORDS, ENEMY_PLANES, HOSTILE_PLANES = 4, 17, 9
"""Bullets and divers of their own fields, and the planes of the two conveyors."""
ENEMY_PLACES, BULLET_PLACES = (1 << ENEMIES) - 1, (1 << BULLETS) - 1

CHANCE_BITS = 28
"""Of a draw, the bits below a direction and a row: they decide by comparison."""
CHANCE = (1 << CHANCE_BITS) - 1
THIRD = -(-(1 << CHANCE_BITS) // 3)

DIVERS_MOVE = sum(1 << timer for timer in (1, 7, 13, 19, 25))
"""By the diver spawn timer, whether this step moves the divers: 30 is a multiple of the 6 steps that
they take for a cell, so they all move at the same time."""


def spread(bit: Word) -> Word:
    """Return a plane of this bit in every place."""
    return np.where(bit, -1, 0)


def lowest(plane: Word) -> Word:
    """Keep the lowest set bit only: the first of the list."""
    return plane & -plane


def in_row(row_0: Word, row_1: Word, row_2: Word, y: Word) -> Word:
    """Return the places in row ``y`` of the board; their planes count rows of the sea, from 0."""
    row = y - 1
    differ = row_0 ^ spread(row & 1)
    differ = differ | (row_1 ^ spread(row >> 1 & 1))
    differ = differ | (row_2 ^ spread(row >> 2 & 1))
    return np.where((y >= 1) & (y <= DEEPEST), ~differ, 0)


def in_column(column_0: Word, column_1: Word, column_2: Word, column_3: Word, x: Word) -> Word:
    """Return the places in column ``x``."""
    differ = column_0 ^ spread(x & 1)
    differ = differ | (column_1 ^ spread(x >> 1 & 1))
    differ = differ | (column_2 ^ spread(x >> 2 & 1))
    differ = differ | (column_3 ^ spread(x >> 3 & 1))
    return ~differ


def moved(
    column_0: Word, column_1: Word, column_2: Word, column_3: Word, rightward: Word, moves: Word
) -> tuple[Word, Word, Word, Word]:
    """Move the places of ``moves`` a column on. From 0 to the left is 15, from 9 to the right is 10."""
    # A carry goes on through ones to the right, a borrow through zeros to the left.
    carry_1 = moves & ~(column_0 ^ rightward)
    carry_2 = carry_1 & ~(column_1 ^ rightward)
    carry_3 = carry_2 & ~(column_2 ^ rightward)
    return column_0 ^ moves, column_1 ^ carry_1, column_2 ^ carry_2, column_3 ^ carry_3


def off_board(column_1: Word, column_2: Word, column_3: Word) -> Word:
    """Return the places whose column is 10 or more."""
    return column_3 & (column_1 | column_2)


def moved_x(x: Word, rightward: Word, moves: Word) -> Word:
    """Move one column as :func:`moved` does."""
    return (x + (moves & rightward) - (moves & (rightward == 0))) & 15


def first_struck(alive: Word, submarine: Word, there: Word) -> Word:
    """Return what a bullet strikes of the enemies there: the first fish, else the first submarine."""
    there = there & alive
    fish = there & ~submarine
    return lowest(np.where(fish == 0, there, fish))


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


def bullet_after(record: Word, column: Word, alive: Word) -> Word:
    """Return an own bullet's record with its new column, and whether it still flies."""
    return column | (record & 0x1F0) | (alive << 9)


def with_new(plane: Word, of_enemies: Word, newer: Word, older: Word) -> Word:
    """Return a plane of the hostile bullets with the bits of those just fired above the topmost place."""
    first, second = (of_enemies & newer) != 0, (of_enemies & older) != 0
    return plane | (first << BULLETS) | (second << BULLETS + 1)


def enemies_down(plane: Word, places: Word) -> Word:
    """Move a plane of the enemies down."""
    return (plane >> places) & ENEMY_PLACES


def bullets_down(plane: Word, places: Word) -> Word:
    """Move a plane of the hostile bullets down."""
    return (plane >> places) & BULLET_PLACES


def tenths(oxygen: Word) -> Word:
    """Return ``oxygen // 20``, how many tenths are left; this product takes hardware no multiplier."""
    return (oxygen >> 2) * 13 >> 6


def initial() -> tuple[Word, ...]:
    """Return the state of a new episode: an empty sea, the submarine at its surface, no random draw."""
    submarine = (NOTHING, 5, 0, 0, 1, MAX_OXYGEN, 0, 0)
    timers = (SLOWEST_SPAWN, DIVER_SPAWN, 0)
    return (*submarine, *timers, *[0] * (RECORDS + ENEMY_PLANES + HOSTILE_PLANES))


def make_step(sticky_below: int, ramping: bool) -> GoldenFunction:
    """Return the golden step under its options.

    Parameters
    ----------
    sticky_below
        The last action is repeated where the lower 28 bits of ``draw_1`` are below this.
    ramping
        Whether surfacing makes enemies faster and more frequent.
    """

    def step(
        last_action: Word,
        x: Word,
        y: Word,
        facing_right: Word,
        surfaced: Word,
        oxygen: Word,
        divers: Word,
        reload: Word,
        enemy_timer: Word,
        diver_timer: Word,
        ramp: Word,
        bullet_0: Word,
        bullet_1: Word,
        diver_0: Word,
        diver_1: Word,
        enemy_alive: Word,
        enemy_submarine: Word,
        enemy_rightward: Word,
        enemy_row_0: Word,
        enemy_row_1: Word,
        enemy_row_2: Word,
        enemy_column_0: Word,
        enemy_column_1: Word,
        enemy_column_2: Word,
        enemy_column_3: Word,
        enemy_move_0: Word,
        enemy_move_1: Word,
        enemy_move_2: Word,
        enemy_fire_0: Word,
        enemy_fire_1: Word,
        enemy_fire_2: Word,
        enemy_fire_3: Word,
        hostile_alive: Word,
        hostile_rightward: Word,
        hostile_row_0: Word,
        hostile_row_1: Word,
        hostile_row_2: Word,
        hostile_column_0: Word,
        hostile_column_1: Word,
        hostile_column_2: Word,
        hostile_column_3: Word,
        action: Word,
        draw_0: Word,
        draw_1: Word,
    ) -> tuple[Word, ...]:
        """Play one step; return the next state, the reward and whether the episode terminated.

        ``draw_0`` makes the enemy that may appear: direction (bit 31), row (30 to 28), kind (the rest, a
        submarine below a third); ``draw_1`` a diver: direction, row; and its rest repeats the last action.
        """
        sticky = (draw_1 & CHANCE) < sticky_below
        action = np.where(sticky, last_action, action)
        move_interval = SLOWEST_MOVE - np.minimum(ramp >> 1, MOVE_RAMPS)
        spawn_interval = SLOWEST_SPAWN - np.minimum(ramp, LAST_RAMP)

        # An enemy appears above the topmost place, unless its row has one that swims the other way.
        due = enemy_timer == 0
        rightward: Word = draw_0 >> 31
        row: Word = draw_0 >> 28 & 7
        same_row = in_row(enemy_row_0, enemy_row_1, enemy_row_2, row + 1)
        opposed = same_row & enemy_alive & (enemy_rightward ^ spread(rightward))
        appears = due & (opposed == 0)
        submarine = (draw_0 & CHANCE) < THIRD
        at_nine = rightward == 0
        enemy_alive = enemy_alive | (appears << ENEMIES)
        enemy_submarine = enemy_submarine | (submarine << ENEMIES)
        enemy_rightward = enemy_rightward | (rightward << ENEMIES)
        enemy_row_0 = enemy_row_0 | ((row & 1) << ENEMIES)
        enemy_row_1 = enemy_row_1 | ((row >> 1 & 1) << ENEMIES)
        enemy_row_2 = enemy_row_2 | ((row >> 2) << ENEMIES)
        enemy_column_0 = enemy_column_0 | (at_nine << ENEMIES)
        enemy_column_3 = enemy_column_3 | (at_nine << ENEMIES)
        enemy_move_0 = enemy_move_0 | ((move_interval & 1) << ENEMIES)
        enemy_move_1 = enemy_move_1 | ((move_interval >> 1 & 1) << ENEMIES)
        enemy_move_2 = enemy_move_2 | ((move_interval >> 2) << ENEMIES)
        enemy_fire_1 = enemy_fire_1 | (1 << ENEMIES)  # FIRE_INTERVAL is 10
        enemy_fire_3 = enemy_fire_3 | (1 << ENEMIES)
        enemy_timer = np.where(due, spawn_interval, enemy_timer) - 1

        # A diver appears; when that is, the older place is empty.
        divers_move = (DIVERS_MOVE >> diver_timer) & 1
        due = diver_timer == 0
        heading = draw_1 >> 31
        column, line = np.where(heading, 0, LAST_COLUMN), draw_1 >> 28 & 7
        new = column | (line << 4) | (heading << 7) | (1 << 8)
        diver_0 = np.where(due, diver_1, diver_0)
        diver_1 = np.where(due, new, diver_1)
        diver_timer = np.where(due, DIVER_SPAWN, diver_timer) - 1

        # The action. A bullet starts where the submarine is.
        fires = (action == FIRE) & (reload == 0)
        new = x | (y << 4) | (facing_right << 8) | (1 << 9)
        bullet_0 = np.where(fires, bullet_1, bullet_0)
        bullet_1 = np.where(fires, new, bullet_1)
        reload = np.maximum(np.where(fires, RELOAD_STEPS, reload) - 1, 0)
        left, right = action == LEFT, action == RIGHT
        facing_right = (facing_right | right) & (left == 0)
        x = x + (right & (x < LAST_COLUMN)) - (left & (x > 0))
        y = y + ((action == DOWN) & (y < DEEPEST)) - ((action == UP) & (y > 0))

        # Own bullets move and strike, the newer first.
        bullet_1_x = moved_x(bullet_1 & 15, bullet_1 >> 8 & 1, 1)
        bullet_0_x = moved_x(bullet_0 & 15, bullet_0 >> 8 & 1, 1)
        bullet_1_alive = (bullet_1 >> 9) & (bullet_1_x <= LAST_COLUMN)
        bullet_0_alive = (bullet_0 >> 9) & (bullet_0_x <= LAST_COLUMN)
        enemy_rows = enemy_row_0, enemy_row_1, enemy_row_2
        bullet_1_row = in_row(*enemy_rows, bullet_1 >> 4 & 15)
        bullet_0_row = in_row(*enemy_rows, bullet_0 >> 4 & 15)
        columns = enemy_column_0, enemy_column_1, enemy_column_2, enemy_column_3
        at_1 = bullet_1_row & in_column(*columns, bullet_1_x)
        at_0 = bullet_0_row & in_column(*columns, bullet_0_x)
        struck = np.where(bullet_1_alive, first_struck(enemy_alive, enemy_submarine, at_1), 0)
        enemy_alive = enemy_alive ^ struck
        hit_1 = struck != 0
        bullet_1_alive = bullet_1_alive & (struck == 0)
        struck = np.where(bullet_0_alive, first_struck(enemy_alive, enemy_submarine, at_0), 0)
        enemy_alive = enemy_alive ^ struck
        hit_0 = struck != 0
        bullet_0_alive = bullet_0_alive & (struck == 0)

        # Divers, the newer first.
        diver_1, aboard_1 = diver_after(diver_1, x, y, divers, divers_move)
        divers = divers + aboard_1
        diver_0, aboard_0 = diver_after(diver_0, x, y, divers, divers_move)
        divers = divers + aboard_0

        # Enemies meet the submarine, move, meet it again, and may swim into a bullet.
        beside = in_row(*enemy_rows, y)
        met = enemy_alive & beside & in_column(*columns, x)
        moves = ~(enemy_move_0 | enemy_move_1 | enemy_move_2)
        columns = moved(*columns, enemy_rightward, moves)
        enemy_column_0, enemy_column_1, enemy_column_2, enemy_column_3 = columns
        # Counting down from 0 gives 7, of which the bits of the interval are kept.
        one, two = enemy_move_0, enemy_move_1
        enemy_move_0 = ~one & (~moves | spread(move_interval & 1))
        enemy_move_1 = ~(two ^ one) & (~moves | spread(move_interval >> 1 & 1))
        enemy_move_2 = (enemy_move_2 ^ ~(one | two)) & (~moves | spread(move_interval >> 2))
        armed = enemy_alive & enemy_submarine  # a submarine that is struck now may still fire
        enemy_alive = enemy_alive & ~off_board(*columns[1:])
        arrives = enemy_alive & moves
        there = beside & in_column(*columns, x)
        met = met | (arrives & there)
        arrives = arrives & ~there
        at_0 = bullet_0_row & in_column(*columns, bullet_0_x)
        at_1 = bullet_1_row & in_column(*columns, bullet_1_x)
        struck_0 = np.where(bullet_0_alive, arrives & at_0, 0)
        struck_1 = np.where(bullet_1_alive, arrives & at_1 & ~struck_0, 0)
        enemy_alive = enemy_alive ^ (struck_0 | struck_1)
        hit_0, hit_1 = hit_0 | (struck_0 != 0), hit_1 | (struck_1 != 0)
        bullet_0_alive = bullet_0_alive & (struck_0 == 0)
        bullet_1_alive = bullet_1_alive & (struck_1 == 0)

        # Submarines fire, the newer first: at most two, `low` the older.
        waits = enemy_fire_0 | enemy_fire_1 | enemy_fire_2 | enemy_fire_3
        fire = armed & ~waits
        low = lowest(fire)
        high = fire ^ low
        twice = high != 0
        newer = high | np.where(twice, 0, low)
        fired = newer != 0
        # Counting down from 0 gives 15, of which 10 is kept.
        one, two, four = enemy_fire_0, enemy_fire_1, enemy_fire_2
        enemy_fire_0 = ~one & waits
        enemy_fire_1 = ~(two ^ one)
        enemy_fire_2 = ~(four ^ (one | two)) & waits
        enemy_fire_3 = enemy_fire_3 ^ ~(one | two | four)

        hostile_alive = hostile_alive | (fired << BULLETS) | (twice << BULLETS + 1)
        hostile_rightward = with_new(hostile_rightward, enemy_rightward, newer, low)
        hostile_row_0 = with_new(hostile_row_0, enemy_row_0, newer, low)
        hostile_row_1 = with_new(hostile_row_1, enemy_row_1, newer, low)
        hostile_row_2 = with_new(hostile_row_2, enemy_row_2, newer, low)
        hostile_column_0 = with_new(hostile_column_0, enemy_column_0, newer, low)
        hostile_column_1 = with_new(hostile_column_1, enemy_column_1, newer, low)
        hostile_column_2 = with_new(hostile_column_2, enemy_column_2, newer, low)
        hostile_column_3 = with_new(hostile_column_3, enemy_column_3, newer, low)

        # Hostile bullets, the new ones too, meet the submarine, move, and meet it again.
        beside = hostile_alive & in_row(hostile_row_0, hostile_row_1, hostile_row_2, y)
        columns = hostile_column_0, hostile_column_1, hostile_column_2, hostile_column_3
        shot = beside & in_column(*columns, x)
        columns = moved(*columns, hostile_rightward, spread(1))
        hostile_column_0, hostile_column_1, hostile_column_2, hostile_column_3 = columns
        shot = shot | (beside & in_column(*columns, x))
        hostile_alive = hostile_alive & ~off_board(*columns[1:])

        # Oxygen and the surface.
        submerged = y != 0
        returns = (submerged == 0) & (surfaced == 0)
        surfaces = returns & (divers != 0)
        terminated = (met != 0) | (shot != 0) | (oxygen == 0) | (returns & (divers == 0))
        full = surfaces & (divers == MAX_DIVERS)
        reward = hit_0 + hit_1 + np.where(full, tenths(oxygen), 0)
        # MinAtar takes one more diver after it took all six, and so do we: -1 is left.
        # No more than six get in, which the compiler cannot see: the cast says so.
        divers = i16(np.where(full, 0, divers) - (surfaces & (divers > LEAST_DIVERS)))
        oxygen = np.where(surfaces, MAX_OXYGEN, np.maximum(oxygen - submerged, 0))
        surfaced = (surfaced | surfaces) & (submerged == 0)
        ramp = ramp + (surfaces & ramping & (ramp < LAST_RAMP))

        # Down by one place for an enemy that appeared, by one for each bullet fired.
        fallen = fired + twice

        return (
            action,
            x,
            y,
            facing_right,
            surfaced,
            oxygen,
            divers,
            reload,
            enemy_timer,
            diver_timer,
            ramp,
            bullet_after(bullet_0, bullet_0_x, bullet_0_alive),
            bullet_after(bullet_1, bullet_1_x, bullet_1_alive),
            diver_0,
            diver_1,
            enemies_down(enemy_alive, appears),
            enemies_down(enemy_submarine, appears),
            enemies_down(enemy_rightward, appears),
            enemies_down(enemy_row_0, appears),
            enemies_down(enemy_row_1, appears),
            enemies_down(enemy_row_2, appears),
            enemies_down(enemy_column_0, appears),
            enemies_down(enemy_column_1, appears),
            enemies_down(enemy_column_2, appears),
            enemies_down(enemy_column_3, appears),
            enemies_down(enemy_move_0, appears),
            enemies_down(enemy_move_1, appears),
            enemies_down(enemy_move_2, appears),
            enemies_down(enemy_fire_0, appears),
            enemies_down(enemy_fire_1, appears),
            enemies_down(enemy_fire_2, appears),
            enemies_down(enemy_fire_3, appears),
            bullets_down(hostile_alive, fallen),
            bullets_down(hostile_rightward, fallen),
            bullets_down(hostile_row_0, fallen),
            bullets_down(hostile_row_1, fallen),
            bullets_down(hostile_row_2, fallen),
            bullets_down(hostile_column_0, fallen),
            bullets_down(hostile_column_1, fallen),
            bullets_down(hostile_column_2, fallen),
            bullets_down(hostile_column_3, fallen),
            reward,
            terminated,
        )

    return step


def observe(
    last_action: Word,
    x: Word,
    y: Word,
    facing_right: Word,
    surfaced: Word,
    oxygen: Word,
    divers: Word,
    reload: Word,
    enemy_timer: Word,
    diver_timer: Word,
    ramp: Word,
    bullet_0: Word,
    bullet_1: Word,
    diver_0: Word,
    diver_1: Word,
    enemy_alive: Word,
    enemy_submarine: Word,
    enemy_rightward: Word,
    enemy_row_0: Word,
    enemy_row_1: Word,
    enemy_row_2: Word,
    enemy_column_0: Word,
    enemy_column_1: Word,
    enemy_column_2: Word,
    enemy_column_3: Word,
    enemy_move_0: Word,
    enemy_move_1: Word,
    enemy_move_2: Word,
    enemy_fire_0: Word,
    enemy_fire_1: Word,
    enemy_fire_2: Word,
    enemy_fire_3: Word,
    hostile_alive: Word,
    hostile_rightward: Word,
    hostile_row_0: Word,
    hostile_row_1: Word,
    hostile_row_2: Word,
    hostile_column_0: Word,
    hostile_column_1: Word,
    hostile_column_2: Word,
    hostile_column_3: Word,
) -> tuple[Word, ...]:
    """Return what can be seen: of the state, all but timers and where hostile bullets are heading."""
    return (
        x,
        y,
        facing_right,
        tenths(oxygen),
        np.where(divers < 0, 0, divers) & 7,
        bullet_0,
        bullet_1,
        diver_0,
        diver_1,
        enemy_alive,
        enemy_submarine,
        enemy_rightward,
        enemy_row_0,
        enemy_row_1,
        enemy_row_2,
        enemy_column_0,
        enemy_column_1,
        enemy_column_2,
        enemy_column_3,
        hostile_alive,
        hostile_row_0,
        hostile_row_1,
        hostile_row_2,
        hostile_column_0,
        hostile_column_1,
        hostile_column_2,
        hostile_column_3,
    )
