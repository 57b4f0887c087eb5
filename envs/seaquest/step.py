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

from pearl_marl.golden import GoldenFunction, Word, i16, u8, u16, u32

NOTHING, LEFT, UP, RIGHT, DOWN, FIRE = range(6)
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


def select(flag: Word, a: Word, b: Word) -> Word:
    """Return ``a`` where ``flag`` is 1 and ``b`` where it is 0, in bytes."""
    mask = u8(u8(0) - u8(flag))
    return u8(u8(a & mask) | u8(b & u8(~mask)))


def select16(flag: Word, a: Word, b: Word) -> Word:
    """Return ``a`` where ``flag`` is 1 and ``b`` where it is 0, in 16 bits."""
    mask = u16(u16(0) - u16(flag))
    return u16(u16(a & mask) | u16(b & u16(~mask)))


def is_zero(word: Word) -> Word:
    """Return 1 where a byte below 128 is 0.

    By arithmetic, for words that are also counted down: ``word == 0`` beside ``word - 1`` becomes one
    operation with a carry to LLVM, and a loop with such an operation in it stays scalar.
    """
    return u8(u8(u8(u8(word) + u8(127)) >> u8(7)) ^ u8(1))


def spread(bit: Word) -> Word:
    """Return a plane of this bit in every place."""
    return u32(u32(0) - u32(bit))


def lowest(plane: Word) -> Word:
    """Keep the lowest set bit only: the first of the list."""
    return u32(plane & u32(u32(0) - plane))


def any_of(plane: Word) -> Word:
    """Return 1 where any place is set."""
    return u8(plane != u32(0))


def taken_if(condition: Word, plane: Word) -> Word:
    """Return the plane where ``condition`` is 1, no place where it is 0."""
    return u32(plane & spread(condition))


def in_row(row_0: Word, row_1: Word, row_2: Word, y: Word) -> Word:
    """Return the places in row ``y`` of the board; their planes count rows of the sea, from 0."""
    row = u8(u8(y) - u8(1))
    differ = u32(row_0 ^ spread(u8(row & u8(1))))
    differ = u32(differ | u32(row_1 ^ spread(u8(u8(row >> u8(1)) & u8(1)))))
    differ = u32(differ | u32(row_2 ^ spread(u8(u8(row >> u8(2)) & u8(1)))))
    return taken_if(u8(row < u8(DEEPEST)), u32(~differ))


def in_column(column_0: Word, column_1: Word, column_2: Word, column_3: Word, x: Word) -> Word:
    """Return the places in column ``x``."""
    differ = u32(column_0 ^ spread(u8(x & u8(1))))
    differ = u32(differ | u32(column_1 ^ spread(u8(u8(x >> u8(1)) & u8(1)))))
    differ = u32(differ | u32(column_2 ^ spread(u8(u8(x >> u8(2)) & u8(1)))))
    differ = u32(differ | u32(column_3 ^ spread(u8(u8(x >> u8(3)) & u8(1)))))
    return u32(~differ)


def moved(
    column_0: Word, column_1: Word, column_2: Word, column_3: Word, rightward: Word, moves: Word
) -> tuple[Word, Word, Word, Word]:
    """Move the places of ``moves`` a column on. From 0 to the left is 15, from 9 to the right is 10."""
    # A carry goes on through ones to the right, a borrow through zeros to the left.
    carry_1 = u32(moves & u32(~u32(column_0 ^ rightward)))
    carry_2 = u32(carry_1 & u32(~u32(column_1 ^ rightward)))
    carry_3 = u32(carry_2 & u32(~u32(column_2 ^ rightward)))
    return (
        u32(column_0 ^ moves),
        u32(column_1 ^ carry_1),
        u32(column_2 ^ carry_2),
        u32(column_3 ^ carry_3),
    )


def off_board(column_1: Word, column_2: Word, column_3: Word) -> Word:
    """Return the places whose column is 10 or more."""
    return u32(column_3 & u32(column_1 | column_2))


def x_of(record: Word) -> Word:
    """Return the column of an own bullet or a diver."""
    return u8(u8(record) & u8(15))


def moved_x(x: Word, rightward: Word, moves: Word) -> Word:
    """Move one column as :func:`moved` does."""
    return u8(u8(u8(x + u8(moves & rightward)) - u8(moves & u8(rightward ^ u8(1)))) & u8(15))


def first_struck(alive: Word, submarine: Word, there: Word) -> Word:
    """Return what a bullet strikes of the enemies there: the first fish, else the first submarine."""
    there = u32(there & alive)
    fish = u32(there & u32(~submarine))
    return lowest(u32(fish | taken_if(u8(fish == u32(0)), there)))


def diver_after(record: Word, x: Word, y: Word, aboard: Word, moves: Word) -> tuple[Word, Word]:
    """Let one diver come aboard or move; return its record and whether it came aboard."""
    alive, rightward = u8(record >> u16(8)), u8(u8(record >> u16(7)) & u8(1))
    column = x_of(record)
    room = u8(i16(aboard) < i16(MAX_DIVERS))
    beside = u8(u8(u8(u8(record >> u16(4)) & u8(7)) == u8(y - u8(1))) & u8(alive & room))
    before = u8(beside & u8(column == x))
    column = moved_x(column, rightward, u8(moves & u8(before ^ u8(1))))
    after = u8(beside & u8(column == x))
    alive = u8(u8(alive & u8(after ^ u8(1))) & u8(column <= LAST_COLUMN))
    record = u16(u16(record & u16(0xF0)) | u16(column))
    return u16(record | u16(u16(alive) << u16(8))), after


def bullet_after(record: Word, column: Word, alive: Word) -> Word:
    """Return an own bullet's record with its new column, and whether it still flies."""
    record = u16(u16(record & u16(0x1F0)) | u16(column))
    return u16(record | u16(u16(alive) << u16(9)))


def with_new(plane: Word, of_enemies: Word, newer: Word, older: Word) -> Word:
    """Return a plane of the hostile bullets with the bits of those just fired above the topmost place."""
    first = u32(u32(any_of(u32(of_enemies & newer))) << u32(BULLETS))
    second = u32(u32(any_of(u32(of_enemies & older))) << u32(BULLETS + 1))
    return u32(u32(plane) | u32(first | second))


def enemies_down(plane: Word, places: Word) -> Word:
    """Move a plane of the enemies down."""
    return u32(u32(plane >> places) & u32(ENEMY_PLACES))


def bullets_down(plane: Word, places: Word) -> Word:
    """Move a plane of the hostile bullets down."""
    return u16(u32(plane >> places) & u32(BULLET_PLACES))


def initial() -> tuple[Word, ...]:
    """Return the state of a new episode: an empty sea, the submarine at its surface, no random draw."""
    submarine = (u8(NOTHING), u8(5), u8(0), u8(0), u8(1), u8(MAX_OXYGEN), i16(0), u8(0))
    timers = (u8(SLOWEST_SPAWN), u8(DIVER_SPAWN), u8(0))
    return (
        *submarine,
        *timers,
        *(u16(0), u16(0), u16(0), u16(0)),
        *(u32(0), u32(0), u32(0), u32(0), u32(0), u32(0), u32(0), u32(0), u32(0)),
        *(u32(0), u32(0), u32(0), u32(0), u32(0), u32(0), u32(0), u32(0)),
        *(u16(0), u16(0), u16(0), u16(0), u16(0), u16(0), u16(0), u16(0), u16(0)),
    )


def make_step(sticky_below: int, ramping: bool) -> GoldenFunction:
    """Return the golden step under its options.

    Parameters
    ----------
    sticky_below
        The last action is repeated where the lower 28 bits of ``draw_1`` are below this.
    ramping
        Whether surfacing makes enemies faster and more frequent.
    """
    ramps = int(ramping)

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
        sticky = u8(u32(draw_1 & u32(CHANCE)) < u32(sticky_below))
        action = select(sticky, last_action, action)
        move_interval = u8(
            u8(SLOWEST_MOVE) - select(u8(ramp >= 2 * MOVE_RAMPS), u8(MOVE_RAMPS), u8(ramp >> u8(1)))
        )
        spawn_interval = u8(u8(SLOWEST_SPAWN) - select(u8(ramp >= LAST_RAMP), u8(LAST_RAMP), ramp))

        # An enemy appears above the topmost place, unless its row has one that swims the other way.
        due = is_zero(enemy_timer)
        rightward: Word = u32(draw_0 >> u32(31))
        row: Word = u8(u32(draw_0 >> u32(28)) & u32(7))
        same_row = in_row(enemy_row_0, enemy_row_1, enemy_row_2, u8(row + u8(1)))
        opposed = u32(u32(same_row & enemy_alive) & u32(enemy_rightward ^ spread(rightward)))
        appears = u32(due & u8(opposed == u32(0)))
        kind = u32(u32(draw_0 & u32(CHANCE)) < u32(THIRD))
        at_nine = u32(rightward ^ u32(1))
        place = u32(ENEMIES)
        enemy_alive = u32(enemy_alive | u32(appears << place))
        enemy_submarine = u32(enemy_submarine | u32(kind << place))
        enemy_rightward = u32(enemy_rightward | u32(rightward << place))
        enemy_row_0 = u32(enemy_row_0 | u32(u32(row & u8(1)) << place))
        enemy_row_1 = u32(enemy_row_1 | u32(u32(u8(row >> u8(1)) & u8(1)) << place))
        enemy_row_2 = u32(enemy_row_2 | u32(u32(row >> u8(2)) << place))
        enemy_column_0 = u32(enemy_column_0 | u32(at_nine << place))
        enemy_column_3 = u32(enemy_column_3 | u32(at_nine << place))
        enemy_move_0 = u32(enemy_move_0 | u32(u32(move_interval & u8(1)) << place))
        enemy_move_1 = u32(enemy_move_1 | u32(u32(u8(move_interval >> u8(1)) & u8(1)) << place))
        enemy_move_2 = u32(enemy_move_2 | u32(u32(move_interval >> u8(2)) << place))
        enemy_fire_1 = u32(enemy_fire_1 | u32(u32(1) << place))  # FIRE_INTERVAL is 10
        enemy_fire_3 = u32(enemy_fire_3 | u32(u32(1) << place))
        enemy_timer = u8(select(due, spawn_interval, enemy_timer) - u8(1))

        # A diver appears; when that is, the older place is empty.
        divers_move = u8(u32(u32(DIVERS_MOVE) >> u32(diver_timer)) & u32(1))
        due = is_zero(diver_timer)
        heading = u16(draw_1 >> u32(31))
        column = u16(u16(LAST_COLUMN) & u16(heading - u16(1)))
        line = u16(u32(draw_1 >> u32(28)) & u32(7))
        new = u16(u16(column | u16(line << u16(4))) | u16(u16(heading << u16(7)) | u16(1 << 8)))
        diver_0 = select16(due, diver_1, diver_0)
        diver_1 = select16(due, new, diver_1)
        diver_timer = u8(select(due, u8(DIVER_SPAWN), diver_timer) - u8(1))

        # The action. A bullet starts where the submarine is.
        fires = u8(u8(action == FIRE) & u8(reload == 0))
        new = u16(u16(u16(x) | u16(u16(y) << u16(4))) | u16(u16(u16(facing_right) << u16(8)) | u16(1 << 9)))
        bullet_0 = select16(fires, bullet_1, bullet_0)
        bullet_1 = select16(fires, new, bullet_1)
        reload = u8(select(fires, u8(RELOAD_STEPS), reload) - u8(u8(fires) | u8(reload > 0)))
        left, right = u8(action == LEFT), u8(action == RIGHT)
        facing_right = u8(u8(facing_right | right) & u8(left ^ u8(1)))
        x = u8(u8(x + u8(right & u8(x < LAST_COLUMN))) - u8(left & u8(x > 0)))
        y = u8(u8(y + u8(u8(action == DOWN) & u8(y < DEEPEST))) - u8(u8(action == UP) & u8(y > 0)))

        # Own bullets move and strike, the newer first.
        bullet_1_x = moved_x(x_of(bullet_1), u8(u8(bullet_1 >> u16(8)) & u8(1)), u8(1))
        bullet_0_x = moved_x(x_of(bullet_0), u8(u8(bullet_0 >> u16(8)) & u8(1)), u8(1))
        bullet_1_alive = u8(u8(bullet_1 >> u16(9)) & u8(bullet_1_x <= LAST_COLUMN))
        bullet_0_alive = u8(u8(bullet_0 >> u16(9)) & u8(bullet_0_x <= LAST_COLUMN))
        enemy_rows = enemy_row_0, enemy_row_1, enemy_row_2
        bullet_1_row = in_row(*enemy_rows, u8(u8(bullet_1 >> u16(4)) & u8(15)))
        bullet_0_row = in_row(*enemy_rows, u8(u8(bullet_0 >> u16(4)) & u8(15)))
        columns = enemy_column_0, enemy_column_1, enemy_column_2, enemy_column_3
        at_1 = u32(bullet_1_row & in_column(*columns, bullet_1_x))
        at_0 = u32(bullet_0_row & in_column(*columns, bullet_0_x))
        struck = taken_if(bullet_1_alive, first_struck(enemy_alive, enemy_submarine, at_1))
        enemy_alive = u32(enemy_alive ^ struck)
        hit = any_of(struck)
        bullet_1_alive = u8(bullet_1_alive ^ hit)
        reward = hit
        struck = taken_if(bullet_0_alive, first_struck(enemy_alive, enemy_submarine, at_0))
        enemy_alive = u32(enemy_alive ^ struck)
        hit = any_of(struck)
        bullet_0_alive = u8(bullet_0_alive ^ hit)
        reward = u8(reward + hit)

        # Divers, the newer first.
        diver_1, aboard = diver_after(diver_1, x, y, divers, divers_move)
        divers = i16(divers + i16(aboard))
        diver_0, aboard = diver_after(diver_0, x, y, divers, divers_move)
        divers = i16(divers + i16(aboard))

        # Enemies meet the submarine, move, meet it again, and may swim into a bullet.
        beside = in_row(*enemy_rows, y)
        met = u32(enemy_alive & u32(beside & in_column(*columns, x)))
        moves = u32(~u32(u32(enemy_move_0 | enemy_move_1) | enemy_move_2))
        columns = moved(*columns, enemy_rightward, moves)
        enemy_column_0, enemy_column_1, enemy_column_2, enemy_column_3 = columns
        # Counting down from 0 gives 7, of which the bits of the interval are kept.
        one, two = enemy_move_0, enemy_move_1
        stays = u32(~moves)
        enemy_move_0 = u32(u32(~one) & u32(stays | spread(u8(move_interval & u8(1)))))
        enemy_move_1 = u32(u32(~u32(two ^ one)) & u32(stays | spread(u8(u8(move_interval >> u8(1)) & u8(1)))))
        enemy_move_2 = u32(
            u32(enemy_move_2 ^ u32(~u32(one | two))) & u32(stays | spread(u8(move_interval >> u8(2))))
        )
        armed = u32(enemy_alive & enemy_submarine)  # a submarine that is struck now may still fire
        enemy_alive = u32(enemy_alive & u32(~off_board(*columns[1:])))
        arrives = u32(enemy_alive & moves)
        there = u32(beside & in_column(*columns, x))
        met = u32(met | u32(arrives & there))
        arrives = u32(arrives & u32(~there))
        at_0 = u32(bullet_0_row & in_column(*columns, bullet_0_x))
        at_1 = u32(bullet_1_row & in_column(*columns, bullet_1_x))
        struck_0 = taken_if(bullet_0_alive, u32(arrives & at_0))
        struck_1 = taken_if(bullet_1_alive, u32(u32(arrives & at_1) & u32(~struck_0)))
        enemy_alive = u32(enemy_alive ^ u32(struck_0 | struck_1))
        hit = any_of(struck_0)
        bullet_0_alive = u8(bullet_0_alive ^ hit)
        reward = u8(reward + hit)
        hit = any_of(struck_1)
        bullet_1_alive = u8(bullet_1_alive ^ hit)
        reward = u8(reward + hit)

        # Submarines fire, the newer first: at most two, `low` the older.
        waits = u32(u32(enemy_fire_0 | enemy_fire_1) | u32(enemy_fire_2 | enemy_fire_3))
        fire = u32(armed & u32(~waits))
        low = lowest(fire)
        high = u32(fire ^ low)
        twice = u32(any_of(high))
        newer = u32(high | taken_if(u32(twice ^ u32(1)), low))
        fired = u32(any_of(newer))
        # Counting down from 0 gives 15, of which 10 is kept.
        one, two, four = enemy_fire_0, enemy_fire_1, enemy_fire_2
        enemy_fire_0 = u32(u32(~one) & waits)
        enemy_fire_1 = u32(~u32(two ^ one))
        enemy_fire_2 = u32(u32(~u32(four ^ u32(one | two))) & waits)
        enemy_fire_3 = u32(enemy_fire_3 ^ u32(~u32(u32(one | two) | four)))

        hostile_alive = u32(
            u32(hostile_alive) | u32(u32(fired << u32(BULLETS)) | u32(twice << u32(BULLETS + 1)))
        )
        hostile_rightward = with_new(hostile_rightward, enemy_rightward, newer, low)
        hostile_row_0 = with_new(hostile_row_0, enemy_row_0, newer, low)
        hostile_row_1 = with_new(hostile_row_1, enemy_row_1, newer, low)
        hostile_row_2 = with_new(hostile_row_2, enemy_row_2, newer, low)
        hostile_column_0 = with_new(hostile_column_0, enemy_column_0, newer, low)
        hostile_column_1 = with_new(hostile_column_1, enemy_column_1, newer, low)
        hostile_column_2 = with_new(hostile_column_2, enemy_column_2, newer, low)
        hostile_column_3 = with_new(hostile_column_3, enemy_column_3, newer, low)

        # Hostile bullets, the new ones too, meet the submarine, move, and meet it again.
        beside = u32(hostile_alive & in_row(hostile_row_0, hostile_row_1, hostile_row_2, y))
        columns = hostile_column_0, hostile_column_1, hostile_column_2, hostile_column_3
        shot = u32(beside & in_column(*columns, x))
        columns = moved(*columns, hostile_rightward, spread(u8(1)))
        hostile_column_0, hostile_column_1, hostile_column_2, hostile_column_3 = columns
        shot = u32(shot | u32(beside & in_column(*columns, x)))
        hostile_alive = u32(hostile_alive & u32(~off_board(*columns[1:])))
        terminated = u8(any_of(met) | any_of(shot))

        # Oxygen and the surface.
        submerged = u8(is_zero(y) ^ u8(1))
        terminated = u8(terminated | u8(oxygen == 0))
        surfaces = u8(u8(submerged ^ u8(1)) & u8(surfaced ^ u8(1)))
        terminated = u8(terminated | u8(surfaces & u8(divers == 0)))
        surfaces = u8(surfaces & u8(divers != 0))
        full = u8(surfaces & u8(divers == MAX_DIVERS))
        # oxygen // 20, which is oxygen * 10 // MAX_OXYGEN; u8(0) - full is a mask
        tenths = u8(u16(u16(u16(oxygen) >> u16(2)) * u16(13)) >> u16(6))
        reward = u8(reward + u8(tenths & u8(u8(0) - full)))
        # MinAtar takes one more diver after it took all six, and so do we: -1 is left.
        divers = i16(divers & i16(i16(full) - i16(1)))
        divers = i16(divers - i16(u8(surfaces & u8(divers > LEAST_DIVERS))))
        oxygen = select(surfaces, u8(MAX_OXYGEN), u8(oxygen - u8(submerged & u8(oxygen > 0))))
        surfaced = u8(u8(surfaced | surfaces) & u8(submerged ^ u8(1)))
        ramp = u8(ramp + u8(u8(surfaces & u8(ramps)) & u8(ramp < LAST_RAMP)))

        # Down by one place for an enemy that appeared, by one for each bullet fired.
        fallen = u32(fired + twice)

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
    bar = u8(u16(u16(u16(oxygen) >> u16(2)) * u16(13)) >> u16(6))  # oxygen // 20
    aboard = u8(i16(divers & i16(i16(divers < 0) - i16(1))) & i16(7))
    return (
        x,
        y,
        facing_right,
        bar,
        aboard,
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
