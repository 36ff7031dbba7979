"""The inner loops of the simulation: the token game of a plan, and the race of a net.

Every function here is written once and used twice: compiled by numba on arrays, and as it stands on
lists, where numba is missing or not worth its loading (see ``machine``). Both give the same numbers
for the same seed. Therefore the code uses whole numbers of fewer than 63 bits, floats, and flat
arrays only; everything is in this one file, because numba notices a change in the file of a
function but not in the files of the functions that it calls.

An event costs the same in a net of ten places as in one of ten thousand. What depends on a place is
listed by place; requests that could not fire are looked at again only when a count that they read
has changed (*dirty*); the ends of actions are in a heap, and the events that interrupt robots in
another.

*Lists* of waiting robots: list ``a`` holds the robots that named a transition, by the arc from
their place to it; list ``arcs + p`` holds those in place ``p`` that let the policy decide. *Groups*
are what is looked at again: group ``t`` are all robots that named transition ``t``, group
``transitions + p`` is the policy's list of ``p``. The array ``level`` holds all counts that
transitions test: the marking, then the length of every list, then a zero.
"""

# In one piece: a net with clocks, compiled from the plan, is to replace it

from __future__ import annotations

import math
from typing import Any, NamedTuple

from gspn_framework_package.analysis.arrays import Floats, Indices

# Why a loop returned.
MORE = 0
"""The budget of events is used up; call again."""
AT_STOP = 1
"""The clock reached the end of the window."""
UNTIL = 2
"""The condition holds."""
FINISHED = 3
"""Every robot is in a place without output arcs."""
STOPPED = 4
"""A failure or loss stopped the team."""
STUCK = 5
"""Nothing will ever happen again, and the window has no end."""
TIMELESS = 6
"""Firings without time between them, and no end of it."""
GROW = 7
"""A count outgrew its row of ``spent``."""
LOSS = 10
"""A robot is lost; its number is in ``numbers[LOST_ROBOT]``."""
FULL = 8
"""More agents than there is room for."""
UNDECIDED = 9
"""No weight decides between immediate transitions; their numbers are in ``choice``."""

FIRINGS_PER_ENTRY = 10_000
"""This many firings after one event are a timeless cycle, as in a run."""

# Kinds of durations.
NULL_ACTION = 0
EXPONENTIAL = 1
ERLANG = 2
GAMMA = 3
LOGNORMAL = 4
DETERMINISTIC = 5
UNIFORM = 6
EMPIRICAL = 7
HYPER_ERLANG = 8

# What a robot asks for when it is done, where that is not a list.
BAD_RESULT = -1
NOWHERE = -2

# What to do when an action fails.
ON_FAILURE_WAIT = 0
ON_FAILURE_RETRY = 1
ON_FAILURE_FIRE = 2
ON_FAILURE_STOP = 3

# What happens to a robot next.
ENTERS = 0
ENDS = 1
STARTS = 2
FAILS = 3
IS_DONE = 4
ASKS = 5
NO_MORE = 6

# Where a robot is in its visit.
GONE = 0
DOING = 1
WAITING = 2
FAILED = 3
INACTIVE = 4

# Positions in ``numbers`` of the state.
MARKING_VERSION = 0
SEQUENCE = 1
STAMP = 3
DIRTY = 4
VOLATILE = 5
HEAP = 6
QUEUE = 8
PENDING = 9
ACTIVE = 10
INACTIVES = 11
EVENTS = 12
TIMELESS_EVENTS = 13
CHECK_UNTIL = 14
SPONTANEOUS = 15
SPONTANEOUS_DIRTY = 16
ENVIRONMENT_DIRTY = 17
GROWN = 18
LOST = 19
FIRED = 20
FIRINGS = 21
FREE = 22
KINDS = 23
ABLE = 24
LOST_ROBOT = 25
READY = 26
ARRIVALS = 27
HELD = 28
HELD_AT = 29
NUMBERS = 30

NO_VISIT = 1 << 62
"""The first event of a visit in which none comes: later than all."""

# Positions in ``clocks`` of the state.
NOW = 0
ENVIRONMENT_AT = 1
LOSS_AT = 2
CLOCKS = 3

# Steps of a condition's program: an operation and its argument.
OPERATIONS = (
    "value",
    "place",
    "label",
    "+",
    "-",
    "*",
    "/",
    "^",
    "==",
    "!=",
    "<",
    "<=",
    ">",
    ">=",
    "negate",
    "not",
    "and",
    "or",
    "min",
    "max",
    "abs",
    "floor",
    "ceil",
    "round",
    "sqrt",
    "exp",
    "log",
    "ln",
    "pow",
    "mod",
)

_WORD = 0xFFFFFFFF


# -- random numbers ----------------------------------------------------------------------------


def draw_uniform(random: Indices) -> float:
    """A number in [0, 1) of 53 bits: two steps of xoshiro128++, whose four words are ``random``."""
    s0, s1, s2, s3 = random[0], random[1], random[2], random[3]
    x = (s0 + s3) & _WORD
    high = (((x << 7) | (x >> 25)) + s0) & _WORD
    t = (s1 << 9) & _WORD
    s2 ^= s0
    s3 ^= s1
    s1 ^= s2
    s0 ^= s3
    s2 ^= t
    s3 = ((s3 << 11) | (s3 >> 21)) & _WORD
    x = (s0 + s3) & _WORD
    low = (((x << 7) | (x >> 25)) + s0) & _WORD
    t = (s1 << 9) & _WORD
    s2 ^= s0
    s3 ^= s1
    s1 ^= s2
    s0 ^= s3
    s2 ^= t
    s3 = ((s3 << 11) | (s3 >> 21)) & _WORD
    random[0] = s0
    random[1] = s1
    random[2] = s2
    random[3] = s3
    return ((high >> 5) * 67108864.0 + (low >> 6)) * 1.1102230246251565e-16


def exponential(random: Indices) -> float:
    """An exponential time of mean 1."""
    return -math.log(1.0 - draw_uniform(random))


def draw_normal(random: Indices) -> float:
    """A standard normal number, by Marsaglia's polar method."""
    while True:
        x = 2.0 * draw_uniform(random) - 1.0
        y = 2.0 * draw_uniform(random) - 1.0
        square = x * x + y * y
        if 0.0 < square < 1.0:
            return x * math.sqrt(-2.0 * math.log(square) / square)


def gamma(shape: float, random: Indices) -> float:
    """A gamma number of scale 1, by the method of Marsaglia and Tsang."""
    boost = 1.0
    if shape < 1.0:
        boost = math.exp(math.log(1.0 - draw_uniform(random)) / shape)
        shape += 1.0
    d = shape - 1.0 / 3.0
    c = 1.0 / math.sqrt(9.0 * d)
    while True:
        x = draw_normal(random)
        v = 1.0 + c * x
        if v > 0.0:
            v = v * v * v
            if math.log(1.0 - draw_uniform(random)) < 0.5 * x * x + d - d * v + d * math.log(v):
                return boost * d * v


def erlang(phases: float, random: Indices) -> float:
    """The sum of that many exponential times of mean 1."""
    if phases > 12.0:
        return gamma(phases, random)
    product = 1.0
    while phases > 0.5:
        product *= 1.0 - draw_uniform(random)
        phases -= 1.0
    return -math.log(product)


def draw_duration(
    kind: int, mean: float, begin: int, end: int, table: Floats, random: Indices
) -> float:
    """A duration (s); its parameters are ``table[begin:end]``."""
    if kind == EXPONENTIAL:
        return mean * exponential(random)
    if kind == DETERMINISTIC:
        return mean
    if kind == ERLANG:
        phases = table[begin]
        return mean / phases * erlang(phases, random)
    if kind == GAMMA:
        shape = table[begin]
        return mean / shape * gamma(shape, random)
    if kind == LOGNORMAL:
        sigma = table[begin]
        return mean * math.exp(sigma * draw_normal(random) - 0.5 * sigma * sigma)
    if kind == UNIFORM:
        low = table[begin]
        return low + (table[begin + 1] - low) * draw_uniform(random)
    if kind == EMPIRICAL:
        at = draw_uniform(random) * (end - begin - 1)
        k = int(at)
        low = table[begin + k]
        return low + (table[begin + k + 1] - low) * (at - k)
    if kind == HYPER_ERLANG:
        left = draw_uniform(random)
        k = begin
        while k + 3 < end and left >= table[k]:
            left -= table[k]
            k += 3
        return table[k + 2] / table[k + 1] * erlang(table[k + 1], random)
    return 0.0


# -- heap, tree, tests, conditions ---------------------------------------------------------------


def push(
    time: float, sequence: int, robot: int, size: int, times: Floats, tags: Indices, who: Indices
) -> None:
    """Enter an event into the heap of ``size`` events, which is ordered by time, then sequence."""
    i = size
    while i > 0:
        up = (i - 1) >> 1
        above = times[up]
        if above < time or (above == time and tags[up] < sequence):
            break
        times[i] = above
        tags[i] = tags[up]
        who[i] = who[up]
        i = up
    times[i] = time
    tags[i] = sequence
    who[i] = robot


def drop_first(size: int, times: Floats, tags: Indices, who: Indices) -> None:
    """Remove the first of ``size`` events from the heap."""
    size -= 1
    time = times[size]
    tag = tags[size]
    robot = who[size]
    i = 0
    while True:
        below = 2 * i + 1
        if below >= size:
            break
        if below + 1 < size and (
            times[below + 1] < times[below]
            or (times[below + 1] == times[below] and tags[below + 1] < tags[below])
        ):
            below += 1
        if time < times[below] or (time == times[below] and tag < tags[below]):
            break
        times[i] = times[below]
        tags[i] = tags[below]
        who[i] = who[below]
        i = below
    times[i] = time
    tags[i] = tag
    who[i] = robot


def only_current(
    size: int,
    times: Floats,
    tags: Indices,
    who: Indices,
    divisor: int,
    since: Indices,
    exactly: bool,
) -> int:
    """Remove the events of a heap that no longer count; returns the size that is left. The robot of
    an event is ``who // divisor``; its tag must be ``since`` of the robot, or also a later one
    unless ``exactly`` is set."""
    left = 0
    for i in range(size):
        time = times[i]
        tag = tags[i]
        what = who[i]
        first = since[what // divisor]
        if tag == first or (tag > first and not exactly):
            push(time, tag, what, left, times, tags, who)
            left += 1
    return left


def put(
    time: float,
    tag: int,
    what: int,
    size: int,
    times: Floats,
    tags: Indices,
    who: Indices,
    divisor: int,
    since: Indices,
) -> int:
    """Enter an event that interrupts into a heap of ``size`` events, from which those of visits
    that are over are removed if it is full (see :func:`only_current`); returns the new size."""
    if size >= len(who):
        size = only_current(size, times, tags, who, divisor, since, False)
    push(time, tag, what, size, times, tags, who)
    return size + 1


def set_leaf(tree: Floats, leaves: int, i: int, value: float) -> None:
    """Set leaf ``i`` of a tree of sums; node 1 is the whole sum."""
    i += leaves
    tree[i] = value
    i >>= 1
    while i > 0:
        tree[i] = tree[2 * i] + tree[2 * i + 1]
        i >>= 1


def find_leaf(tree: Floats, leaves: int, target: float) -> int:
    """The leaf in which ``target``, of the whole sum, falls; never one of value 0."""
    i = 1
    while i < leaves:
        i *= 2
        if target >= tree[i] and tree[i + 1] > 0.0:
            target -= tree[i]
            i += 1
    return i - leaves


def fits(t: int, level: Indices, test_from: Indices, tests: Indices) -> bool:
    """Whether all tests of transition ``t`` hold: four numbers each, such that
    ``(level[i] + level[j]) * sign >= bound``."""
    k = test_from[t]
    end = test_from[t + 1]
    while k < end:
        if (level[tests[k]] + level[tests[k + 1]]) * tests[k + 2] < tests[k + 3]:
            return False
        k += 4
    return True


# In one piece: a net with clocks, compiled from the plan, is to replace it
def holds(
    operations: Indices, arguments: Floats, level: Indices, label: float, stack: Floats
) -> bool:
    """Whether a condition holds; ``label`` is the truth of its label. Comparisons with NaN are
    false."""
    top = 0
    for k in range(len(operations)):
        what = operations[k]
        argument = arguments[k]
        if what == 0:
            stack[top] = argument
            top += 1
        elif what == 1:
            stack[top] = 1.0 * level[int(argument)]
            top += 1
        elif what == 2:
            stack[top] = label
            top += 1
        elif what in (14, 15) or 20 <= what <= 27:
            a = stack[top - 1]
            stack[top - 1] = math.nan
            if what == 14:
                stack[top - 1] = -a
            elif what == 15:
                stack[top - 1] = 1.0 if a == 0.0 else 0.0
            elif what == 20:
                stack[top - 1] = abs(a)
            elif math.isnan(a) or math.isinf(a):
                stack[top - 1] = math.nan
            elif what == 21:
                stack[top - 1] = float(math.floor(a))
            elif what == 22:
                stack[top - 1] = float(math.ceil(a))
            elif what == 23:
                stack[top - 1] = float(math.floor(a + 0.5))
            elif what == 24 and a >= 0.0:
                stack[top - 1] = math.sqrt(a)
            elif what == 25 and a < 709.0:
                stack[top - 1] = math.exp(a)
            elif what in (26, 27) and a > 0.0:
                stack[top - 1] = math.log(a)
        elif what in (18, 19):
            count = int(argument)
            best = stack[top - count]
            for i in range(top - count + 1, top):
                value = stack[i]
                if math.isnan(value) or math.isnan(best):
                    best = math.nan
                elif (value < best) == (what == 18) and value != best:
                    best = value
            top -= count - 1
            stack[top - 1] = best
        else:
            a = stack[top - 2]
            b = stack[top - 1]
            top -= 1
            value = math.nan
            if what == 3:
                value = a + b
            elif what == 4:
                value = a - b
            elif what == 5:
                value = a * b
            elif what == 6:
                if b != 0.0:
                    value = a / b
            elif what in (7, 28):
                value = power(a, b)
            elif what == 8:
                value = 1.0 if a == b else 0.0
            elif what == 9:
                value = 1.0 if a < b or a > b else 0.0
            elif what == 10:
                value = 1.0 if a < b else 0.0
            elif what == 11:
                value = 1.0 if a <= b else 0.0
            elif what == 12:
                value = 1.0 if a > b else 0.0
            elif what == 13:
                value = 1.0 if a >= b else 0.0
            elif what == 16:
                value = 1.0 if a != 0.0 and b != 0.0 else 0.0
            elif what == 17:
                value = 1.0 if a != 0.0 or b != 0.0 else 0.0
            elif what == 29 and b != 0.0 and not math.isinf(a):
                value = math.copysign(abs(a) % abs(b), a)
            stack[top - 1] = value
    return stack[0] != 0.0


def power(a: float, b: float) -> float:
    """``a`` to the power ``b``; NaN where that is not a real number, or too large."""
    if b == 0.0 or a == 1.0:
        return 1.0
    if math.isnan(a) or math.isnan(b) or math.isinf(a) or math.isinf(b):
        return math.nan
    if a == 0.0:
        return 0.0 if b > 0.0 else math.nan
    if a < 0.0 and b != math.floor(b):
        return math.nan
    if b * math.log(abs(a)) > 709.0:
        return math.nan
    return a**b


# -- the policy ----------------------------------------------------------------------------------


class Book(NamedTuple):
    """The rows of a policy, by the place that they apply to. Further "places" stand for all rows of
    a scope, whatever they apply to; ``any_of`` has that of each place.

    An *entry* is a row for one place. Few entries of a place are a list in order of precedence
    (``listed``); many are in hash tables, one per set of cells that are not wildcards (*mask*),
    masks with more cells first.
    """

    listed_from: Any
    listed: Any
    mask_from: Any
    mask_cells_from: Any
    mask_cells: Any
    mask_table: Any
    mask_size: Any
    tables: Any
    entry_row: Any
    entry_mixed: Any
    choice_from: Any
    choice: Any
    chance: Any
    cell_from: Any
    cells: Any
    any_of: Any


def find_entry(
    place: int,
    level: Indices,
    listed_from: Indices,
    listed: Indices,
    mask_from: Indices,
    mask_cells_from: Indices,
    mask_cells: Indices,
    mask_table: Indices,
    mask_size: Indices,
    tables: Indices,
    entry_row: Indices,
    cell_from: Indices,
    cells: Indices,
) -> int:
    """The entry that takes precedence among those of ``place`` that match; -1 if none does."""
    for k in range(listed_from[place], listed_from[place + 1]):
        entry = listed[k]
        row = entry_row[entry]
        i = cell_from[row]
        end = cell_from[row + 1]
        while i < end and level[cells[i]] == cells[i + 1]:
            i += 2
        if i >= end:
            return entry
    best = -1
    size_of_best = -1
    for mask in range(mask_from[place], mask_from[place + 1]):
        begin = mask_cells_from[mask]
        end = mask_cells_from[mask + 1]
        if best >= 0 and end - begin < size_of_best:
            break
        mixed = 0
        for k in range(begin, end):
            mixed = (mixed * 1000003 + level[mask_cells[k]]) & 0x7FFFFFFF
        size = mask_size[mask]
        slot = (mixed ^ (mixed >> 15)) & (size - 1)
        while True:
            entry = tables[mask_table[mask] + slot]
            if entry < 0:
                break
            row = entry_row[entry]
            i = cell_from[row]
            last = cell_from[row + 1]
            while i < last and level[cells[i]] == cells[i + 1]:
                i += 2
            if i >= last:
                if best < 0 or row < entry_row[best]:
                    best = entry
                    size_of_best = end - begin
                break
            slot = (slot + 1) & (size - 1)
    return best


# In one piece: a net with clocks, compiled from the plan, is to replace it
def weigh(
    place: int,
    version: int,
    strict: int,
    always: int,
    any_of: Indices,
    level: Indices,
    test_from: Indices,
    tests: Indices,
    priority: Indices,
    weight: Floats,
    leaving_from: Indices,
    leaving: Indices,
    listed_from: Indices,
    listed: Indices,
    mask_from: Indices,
    mask_cells_from: Indices,
    mask_cells: Indices,
    mask_table: Indices,
    mask_size: Indices,
    tables: Indices,
    entry_row: Indices,
    entry_mixed: Indices,
    choice_from: Indices,
    choice: Indices,
    chance: Floats,
    cell_from: Indices,
    cells: Indices,
    candidate: Indices,
    candidate_ok: Indices,
    candidate_weight: Floats,
    group_version: Indices,
    group_signature: Indices,
    group_stamp: Indices,
    numbers: Indices,
) -> int:
    """Fill the ``candidate`` arrays with the choice of a robot in ``place`` that lets the policy
    decide: transitions, whether each can fire, and weights (0: not a candidate).

    Returns their number. ``numbers[READY]`` says how many can fire, ``numbers[KINDS]`` how many
    have a weight, ``numbers[ABLE]`` how many have both. If the marking or the candidates differ
    from the last time, the place gets a new stamp, so that the draws of its robots no longer hold.
    """
    count = 0
    floor = 0
    signature = -1
    entry = find_entry(
        place,
        level,
        listed_from,
        listed,
        mask_from,
        mask_cells_from,
        mask_cells,
        mask_table,
        mask_size,
        tables,
        entry_row,
        cell_from,
        cells,
    )
    if entry >= 0:
        begin = choice_from[entry]
        count = choice_from[entry + 1] - begin
        for k in range(count):
            t = choice[begin + k]
            candidate[k] = t
            candidate_weight[k] = chance[begin + k]
            candidate_ok[k] = 0
            if fits(t, level, test_from, tests):
                candidate_ok[k] = 1
                if priority[t] > floor:
                    floor = priority[t]
        if entry_mixed[entry] == 0:
            floor = 0
        signature = entry
    elif (
        strict == 0
        and always == 0
        and find_entry(
            any_of[place],
            level,
            listed_from,
            listed,
            mask_from,
            mask_cells_from,
            mask_cells,
            mask_table,
            mask_size,
            tables,
            entry_row,
            cell_from,
            cells,
        )
        < 0
    ):
        begin = leaving_from[place]
        count = leaving_from[place + 1] - begin
        signature = 0
        for k in range(count):
            t = leaving[begin + k]
            candidate[k] = t
            candidate_weight[k] = 0.0
            candidate_ok[k] = 0
            if fits(t, level, test_from, tests):
                candidate_weight[k] = weight[t]
                candidate_ok[k] = 1
                signature = (signature * 1000003 + k + 1) & 0x7FFFFFFF
                if priority[t] > floor:
                    floor = priority[t]
        signature = -2 - signature
    ready = 0
    kinds = 0
    able = 0
    for k in range(count):
        ready += candidate_ok[k]
        if priority[candidate[k]] < floor:
            candidate_weight[k] = 0.0
        if candidate_weight[k] > 0.0:
            kinds += 1
            able += candidate_ok[k]
        else:
            candidate_ok[k] = 0
    numbers[KINDS] = kinds
    numbers[ABLE] = able
    numbers[READY] = ready
    signature = signature * 4096 + floor
    if group_version[place] != version or group_signature[place] != signature:
        group_version[place] = version
        group_signature[place] = signature
        numbers[STAMP] += 1
        group_stamp[place] = numbers[STAMP]
    return count


def pick(count: int, kinds: int, weights: Floats, random: Indices) -> int:
    """Draw one of ``count`` weights, of which ``kinds`` are above 0."""
    u = 0.0
    if kinds > 1:
        total = 0.0
        for k in range(count):
            total += weights[k]
        u = draw_uniform(random) * total
    drawn = 0
    for k in range(count):
        if weights[k] > 0.0:
            drawn = k
            u -= weights[k]
            if u < 0.0:
                break
    return drawn


# -- counts --------------------------------------------------------------------------------------


def shift(
    place: int,
    amount: int,
    now: float,
    level: Indices,
    since: Floats,
    area: Floats,
    spent: Floats,
    spent_from: Indices,
    numbers: Indices,
) -> int:
    """Change the count of a place, after booking the time that it had the old one."""
    count = level[place]
    passed = now - since[place]
    if passed > 0.0:
        area[place] += passed * count
        at = spent_from[place] + count
        if at < spent_from[place + 1]:
            spent[at] += passed
        since[place] = now
    count += amount
    level[place] = count
    if spent_from[place] + count >= spent_from[place + 1]:
        numbers[GROWN] = 1
    return count


def book_times(
    now: float,
    places: int,
    level: Indices,
    since: Floats,
    area: Floats,
    spent: Floats,
    spent_from: Indices,
) -> None:
    """Book the time that all places had their counts."""
    for place in range(places):
        passed = now - since[place]
        if passed > 0.0:
            count = level[place]
            area[place] += passed * count
            at = spent_from[place] + count
            if at < spent_from[place + 1]:
                spent[at] += passed
        since[place] = now


def mark(
    begin: int, end: int, listed: Indices, waits: Indices, dirty: Indices, is_dirty: Indices, n: int
) -> int:
    """Put the groups ``listed[begin:end]`` that have robots among the ``n`` dirty ones; returns how
    many there are then."""
    for k in range(begin, end):
        group = listed[k]
        if waits[group] > 0 and is_dirty[group] == 0:
            is_dirty[group] = 1
            dirty[n] = group
            n += 1
    return n


def any_of_these(count: int, random: Indices) -> int:
    """One of so many things, by chance; its number, from 0."""
    return int(draw_uniform(random) * count) if count > 1 else 0


def waiting_at(k: int, robot: int, following: Indices) -> int:
    """The robot that is ``k`` places behind ``robot`` in its list."""
    for _ in range(k):
        robot = following[robot]
    return robot


def only_due(count: int, tags: Indices, robots: Indices, due_tag: Indices) -> int:
    """Keep the entries of a list of actions that are still running; how many they are."""
    kept = 0
    for i in range(count):
        if due_tag[robots[i]] == tags[i]:
            tags[kept] = tags[i]
            robots[kept] = robots[i]
            kept += 1
    return kept


def unlink(
    robot: int,
    in_list: Indices,
    following: Indices,
    preceding: Indices,
    head: Indices,
    tail: Indices,
) -> None:
    """Take a robot out of the list in which it waits."""
    before = preceding[robot]
    after = following[robot]
    if before < 0:
        head[in_list[robot]] = after
    else:
        following[before] = after
    if after < 0:
        tail[in_list[robot]] = before
    else:
        preceding[after] = before


def touch(
    place: int,
    level: Indices,
    spontaneous_from: Indices,
    spontaneous: Indices,
    spontaneous_dirty: Indices,
    is_spontaneous_dirty: Indices,
    environment_from: Indices,
    environment: Indices,
    environment_transition: Indices,
    server_rate: Floats,
    servers: Indices,
    test_from: Indices,
    tests: Indices,
    tree: Floats,
    until_reads: Indices,
    numbers: Indices,
) -> None:
    """Note what else depends on the count of ``place``, which has changed: transitions that only
    take resources, and the condition that ends the run."""
    for k in range(spontaneous_from[place], spontaneous_from[place + 1]):
        t = spontaneous[k]
        if is_spontaneous_dirty[t] == 0:
            is_spontaneous_dirty[t] = 1
            spontaneous_dirty[numbers[SPONTANEOUS_DIRTY]] = t
            numbers[SPONTANEOUS_DIRTY] += 1
    for k in range(environment_from[place], environment_from[place + 1]):
        i = environment[k]
        t = environment_transition[i]
        degree = busy(t, servers[i], level, test_from, tests)
        set_leaf(tree, len(tree) // 2, i, server_rate[i] * degree)
        numbers[ENVIRONMENT_DIRTY] = 1
    if until_reads[place] > 0:
        numbers[CHECK_UNTIL] = 1


def busy(t: int, servers: int, level: Indices, test_from: Indices, tests: Indices) -> int:
    """The number of busy servers of an exponential transition: the tests of its inputs are those
    with a sign of 1."""
    if not fits(t, level, test_from, tests):
        return 0
    degree = 0
    for k in range(test_from[t], test_from[t + 1], 4):
        if tests[k + 2] > 0:
            times = level[tests[k]] // tests[k + 3]
            if degree == 0 or times < degree:
                degree = times
    if degree == 0:
        return 1  # no input arcs
    return servers if 0 < servers < degree else degree


# -- the token game of a plan --------------------------------------------------------------------


class PlanArrays(NamedTuple):
    """A plan as arrays; ``x_from[i]`` to ``x_from[i + 1]`` is the part of ``x`` that belongs to
    ``i``."""

    sizes: Any
    """Places, transitions, arcs of robots, whether the environment fires, most robots, whether
    no row means waiting (strict), whether some row always matches, what to do when a robot is lost
    and others wait for it, transition that they request then, events that interrupt."""
    test_from: Any
    tests: Any
    effect_from: Any
    effects: Any
    rising_from: Any
    rising: Any
    falling_from: Any
    falling: Any
    joins_from: Any
    joins: Any
    arc_from: Any
    arc_place: Any
    arc_weight: Any
    immediate: Any
    priority: Any
    weight: Any
    leaving_from: Any
    leaving: Any
    mover_from: Any
    mover_target: Any
    mover_wants: Any
    slot_from: Any
    slots: Any
    surplus: Any
    timing_of: Any
    timing_kind: Any
    timing_mean: Any
    timing_from: Any
    timing_table: Any
    outcome_from: Any
    outcome_list: Any
    outcome_chance: Any
    null_list: Any
    failure: Any
    timeout: Any
    rule: Any
    rule_times: Any
    rule_delay: Any
    rule_list: Any
    list_group: Any
    spontaneous_from: Any
    spontaneous: Any
    environment_from: Any
    environment: Any
    environment_transition: Any
    server_rate: Any
    servers: Any
    until_reads: Any
    until_operations: Any
    until_arguments: Any
    evicted_from: Any
    evicted: Any
    loss_rate: Any
    event_from: Any
    """By place: the events that interrupt robots there."""
    event_transition: Any
    event_rate: Any
    event_after: Any
    """How long after a robot has entered the place the event comes (s); 0: at its rate."""
    event_hold: Any
    event_test_from: Any
    event_tests: Any


class PlanState(NamedTuple):
    """A run of a plan: everything that changes."""

    numbers: Any
    clocks: Any
    random: Any
    level: Any
    since: Any
    area: Any
    spent: Any
    spent_from: Any
    firings: Any
    at: Any
    phase: Any
    kind: Any
    failures: Any
    in_list: Any
    following: Any
    preceding: Any
    due_tag: Any
    due_what: Any
    draw: Any
    draw_stamp: Any
    active: Any
    active_at: Any
    free: Any
    head: Any
    tail: Any
    waits: Any
    dirty: Any
    is_dirty: Any
    volatile: Any
    is_volatile: Any
    group_version: Any
    group_signature: Any
    group_stamp: Any
    heap_time: Any
    heap_tag: Any
    heap_robot: Any
    queue_tag: Any
    queue_robot: Any
    pending_robot: Any
    pending_what: Any
    movers: Any
    targets: Any
    candidate: Any
    candidate_ok: Any
    candidate_weight: Any
    may_spontaneous: Any
    spontaneous_at: Any
    spontaneous_dirty: Any
    is_spontaneous_dirty: Any
    tree: Any
    stack: Any
    visit_from: Any
    """Of each robot: the tag of the first event of its visit; NO_VISIT: none comes."""
    arrival_time: Any
    arrival_tag: Any
    arrival_who: Any
    """The heap of events: ``robot * (events + 1)``, plus the number of an event that comes after a
    fixed time, or plus the number of all events for the next one that comes at a rate."""
    held_robot: Any
    held_tag: Any
    held_event: Any
    """Events that fire as soon as they can, if the visit is still the one with that tag."""


# In one piece: a net with clocks, compiled from the plan, is to replace it
def play(r: Any, b: Any, s: Any, stop: float, budget: int) -> int:
    """Play the token game until the clock reaches ``stop`` or this many events have happened;
    returns why.

    :param r: PlanArrays, or the same as a plain tuple; ``b`` is a Book, ``s`` a PlanState.
    """
    (
        sizes,
        test_from,
        tests,
        effect_from,
        effects,
        rising_from,
        rising,
        falling_from,
        falling,
        joins_from,
        joins,
        arc_from,
        arc_place,
        arc_weight,
        immediate,
        priority,
        weight,
        leaving_from,
        leaving,
        mover_from,
        mover_target,
        mover_wants,
        slot_from,
        slots,
        surplus,
        timing_of,
        timing_kind,
        timing_mean,
        timing_from,
        timing_table,
        outcome_from,
        outcome_list,
        outcome_chance,
        null_list,
        failure,
        timeout,
        rule,
        rule_times,
        rule_delay,
        rule_list,
        list_group,
        spontaneous_from,
        spontaneous,
        environment_from,
        environment,
        environment_transition,
        server_rate,
        servers,
        until_reads,
        until_operations,
        until_arguments,
        evicted_from,
        evicted,
        loss_rate,
        event_from,
        event_transition,
        event_rate,
        event_after,
        event_hold,
        event_test_from,
        event_tests,
    ) = r
    (
        listed_from,
        listed,
        mask_from,
        mask_cells_from,
        mask_cells,
        mask_table,
        mask_size,
        tables,
        entry_row,
        entry_mixed,
        choice_from,
        choice,
        chance,
        cell_from,
        cells,
        any_of,
    ) = b
    (
        numbers,
        clocks,
        random,
        level,
        since,
        area,
        spent,
        spent_from,
        firings,
        at,
        phase,
        kind,
        failures,
        in_list,
        following,
        preceding,
        due_tag,
        due_what,
        draw,
        draw_stamp,
        active,
        active_at,
        free,
        head,
        tail,
        waits,
        dirty,
        is_dirty,
        volatile,
        is_volatile,
        group_version,
        group_signature,
        group_stamp,
        heap_time,
        heap_tag,
        heap_robot,
        queue_tag,
        queue_robot,
        pending_robot,
        pending_what,
        movers,
        targets,
        candidate,
        candidate_ok,
        candidate_weight,
        may_spontaneous,
        spontaneous_at,
        spontaneous_dirty,
        is_spontaneous_dirty,
        tree,
        stack,
        visit_from,
        arrival_time,
        arrival_tag,
        arrival_who,
        held_robot,
        held_tag,
        held_event,
    ) = s
    places = sizes[0]
    transitions = sizes[1]
    arcs = sizes[2]
    with_environment = sizes[3]
    most = sizes[4]
    strict = sizes[5]
    always = sizes[6]
    all_events = sizes[9]
    leaves = len(tree) // 2
    queue_room = len(queue_robot)
    with_until = len(until_operations)

    now = clocks[NOW]
    version = numbers[MARKING_VERSION]
    sequence = numbers[SEQUENCE]
    n_dirty = numbers[DIRTY]
    n_volatile = numbers[VOLATILE]
    n_heap = numbers[HEAP]
    n_arrivals = numbers[ARRIVALS]
    n_held = numbers[HELD]
    heap_room = len(heap_robot)
    interrupted = False
    n_queue = numbers[QUEUE]
    n_pending = numbers[PENDING]
    n_active = numbers[ACTIVE]
    inactives = numbers[INACTIVES]
    events = numbers[EVENTS]
    timeless = numbers[TIMELESS_EVENTS]
    n_spontaneous = numbers[SPONTANEOUS]
    fired = numbers[FIRED]
    enough = events + budget
    at_once = FIRINGS_PER_ENTRY + 100 * most
    status = MORE

    while True:
        # -- robots that enter, end, fail or start ---------------------------------------------
        k = 0
        while k < n_pending:
            robot = pending_robot[k]
            what = pending_what[k]
            k += 1
            timing = timing_of[kind[robot] * places + at[robot]]
            wish = BAD_RESULT
            delay = 0.0
            if what == ENTERS:
                failures[robot] = 0
                if all_events > 0:
                    visit_from[robot] = NO_VISIT
                    begin = event_from[at[robot]]
                    end = event_from[at[robot] + 1]
                    if begin < end:
                        visit_from[robot] = sequence + 1
                        total = 0.0
                        for i in range(begin, end):
                            if event_after[i] > 0.0:
                                sequence += 1
                                n_arrivals = put(
                                    now + event_after[i],
                                    sequence,
                                    robot * (all_events + 1) + i,
                                    n_arrivals,
                                    arrival_time,
                                    arrival_tag,
                                    arrival_who,
                                    all_events + 1,
                                    visit_from,
                                )
                            else:
                                total += event_rate[i]
                        if total > 0.0:
                            sequence += 1
                            n_arrivals = put(
                                now + exponential(random) / total,
                                sequence,
                                robot * (all_events + 1) + all_events,
                                n_arrivals,
                                arrival_time,
                                arrival_tag,
                                arrival_who,
                                all_events + 1,
                                visit_from,
                            )
                if timing_kind[timing] == NULL_ACTION:
                    what = IS_DONE
                    wish = null_list[timing]
                else:
                    what = STARTS
            elif what == ENDS:
                if failure[timing] > 0.0 and draw_uniform(random) < failure[timing]:
                    what = FAILS
                else:
                    what = IS_DONE
                    i = outcome_from[timing]
                    end = outcome_from[timing + 1] - 1
                    if i < end:
                        u = draw_uniform(random)
                        while i < end and u >= outcome_chance[i]:
                            i += 1
                    wish = outcome_list[i]
            if what == IS_DONE:
                if wish == NOWHERE:
                    phase[robot] = INACTIVE
                    inactives += 1
                elif wish == BAD_RESULT:
                    what = FAILS
                else:
                    what = ASKS
            if what == FAILS:
                if rule[timing] == ON_FAILURE_RETRY and failures[robot] < rule_times[timing]:
                    failures[robot] += 1
                    delay = rule_delay[timing]
                    what = STARTS
                elif rule[timing] == ON_FAILURE_FIRE and rule_list[timing] >= 0:
                    wish = rule_list[timing]
                    what = ASKS
                elif rule[timing] == ON_FAILURE_STOP:
                    status = STOPPED
                    break
                else:
                    phase[robot] = FAILED
            if what == STARTS:
                phase[robot] = DOING
                length = draw_duration(
                    timing_kind[timing],
                    timing_mean[timing],
                    timing_from[timing],
                    timing_from[timing + 1],
                    timing_table,
                    random,
                )
                sequence += 1
                due_tag[robot] = sequence
                due_what[robot] = ENDS
                if length > timeout[timing]:
                    length = timeout[timing]
                    due_what[robot] = FAILS
                length += delay
                if length > 0.0:
                    if n_heap >= heap_room:
                        n_heap = only_current(
                            n_heap, heap_time, heap_tag, heap_robot, 1, due_tag, True
                        )
                    push(now + length, sequence, robot, n_heap, heap_time, heap_tag, heap_robot)
                    n_heap += 1
                else:
                    if n_queue >= queue_room:
                        n_queue = only_due(n_queue, queue_tag, queue_robot, due_tag)
                    queue_tag[n_queue] = sequence
                    queue_robot[n_queue] = robot
                    n_queue += 1
            elif what == ASKS:
                failures[robot] = 0
                phase[robot] = WAITING
                in_list[robot] = wish
                draw_stamp[robot] = 0
                following[robot] = -1
                last = tail[wish]
                preceding[robot] = last
                if last < 0:
                    head[wish] = robot
                else:
                    following[last] = robot
                tail[wish] = robot
                level[places + wish] += 1
                waits[list_group[wish]] += 1
                n_dirty = mark(
                    joins_from[wish],
                    joins_from[wish + 1],
                    joins,
                    waits,
                    dirty,
                    is_dirty,
                    n_dirty,
                )
        n_pending = 0
        if status == STOPPED:
            break
        if with_until > 0 and numbers[CHECK_UNTIL] > 0:
            numbers[CHECK_UNTIL] = 0
            if holds(until_operations, until_arguments, level, 0.0, stack):
                status = UNTIL
                break

        # -- what fires next ---------------------------------------------------------------------
        firing = -1
        requester = -1
        dirty_spontaneous = numbers[SPONTANEOUS_DIRTY]
        while dirty_spontaneous > 0:
            dirty_spontaneous -= 1
            t = spontaneous_dirty[dirty_spontaneous]
            is_spontaneous_dirty[t] = 0
            i = spontaneous_at[t]
            if fits(t, level, test_from, tests):
                if i < 0:
                    spontaneous_at[t] = n_spontaneous
                    may_spontaneous[n_spontaneous] = t
                    n_spontaneous += 1
            elif i >= 0:
                n_spontaneous -= 1
                last = may_spontaneous[n_spontaneous]
                may_spontaneous[i] = last
                spontaneous_at[last] = i
                spontaneous_at[t] = -1
        numbers[SPONTANEOUS_DIRTY] = 0
        if n_spontaneous > 0:
            top = -1
            for i in range(n_spontaneous):
                if priority[may_spontaneous[i]] > top:
                    top = priority[may_spontaneous[i]]
            total = 0.0
            first = transitions
            for i in range(n_spontaneous):
                t = may_spontaneous[i]
                if priority[t] == top:
                    total += weight[t]
                    if t < first:
                        first = t
            firing = first  # without weights, the first one of the file
            if total > 0.0:
                u = draw_uniform(random) * total
                for i in range(n_spontaneous):
                    t = may_spontaneous[i]
                    if priority[t] == top and weight[t] > 0.0:
                        firing = t
                        u -= weight[t]
                        if u < 0.0:
                            break
        else:
            best_urgency = -2
            rivals = 0  # robots whose requests are as urgent as that
            i = 0
            while i < n_dirty:
                group = dirty[i]
                asked = False
                if group < transitions:
                    if waits[group] > 0 and fits(group, level, test_from, tests):
                        asked = True
                        urgency = priority[group] if immediate[group] > 0 else -1
                        if urgency >= best_urgency:
                            rivals = waits[group] + (rivals if urgency == best_urgency else 0)
                            best_urgency = urgency
                            k = any_of_these(rivals, random)
                            if k < waits[group]:
                                firing = group
                                arc = arc_from[group]
                                while k >= level[places + arc]:
                                    k -= level[places + arc]
                                    arc += 1
                                requester = waiting_at(k, head[arc], following)
                elif waits[group] > 0:
                    place = group - transitions
                    count = weigh(
                        place,
                        version,
                        strict,
                        always,
                        any_of,
                        level,
                        test_from,
                        tests,
                        priority,
                        weight,
                        leaving_from,
                        leaving,
                        listed_from,
                        listed,
                        mask_from,
                        mask_cells_from,
                        mask_cells,
                        mask_table,
                        mask_size,
                        tables,
                        entry_row,
                        entry_mixed,
                        choice_from,
                        choice,
                        chance,
                        cell_from,
                        cells,
                        candidate,
                        candidate_ok,
                        candidate_weight,
                        group_version,
                        group_signature,
                        group_stamp,
                        numbers,
                    )
                    kinds = numbers[KINDS]
                    if numbers[ABLE] > 0:
                        robot = head[arcs + place]
                        while robot >= 0:
                            if draw_stamp[robot] != group_stamp[place]:
                                draw_stamp[robot] = group_stamp[place]
                                draw[robot] = pick(count, kinds, candidate_weight, random)
                            k = draw[robot]
                            if candidate_ok[k] > 0:
                                asked = True
                                urgency = priority[candidate[k]]
                                if urgency >= best_urgency:
                                    rivals = rivals + 1 if urgency == best_urgency else 1
                                    best_urgency = urgency
                                    if any_of_these(rivals, random) == 0:
                                        firing = candidate[k]
                                        requester = robot
                            elif kinds == 1:
                                break
                            robot = following[robot]
                    if not asked and numbers[READY] > 0 and is_volatile[group] == 0:
                        # another draw, or other candidates, in the next marking may be able to fire
                        is_volatile[group] = 1
                        volatile[n_volatile] = group
                        n_volatile += 1
                if not asked:
                    is_dirty[group] = 0
                    n_dirty -= 1
                    dirty[i] = dirty[n_dirty]
                else:
                    i += 1

        if firing < 0 and n_held > 0 and numbers[HELD_AT] != version:
            # events that are held: the first robot whose event can fire now
            i = 0
            while i < n_held:
                robot = held_robot[i]
                if visit_from[robot] != held_tag[i]:
                    n_held -= 1
                    for j in range(i, n_held):
                        held_robot[j] = held_robot[j + 1]
                        held_tag[j] = held_tag[j + 1]
                        held_event[j] = held_event[j + 1]
                    continue
                if (firing < 0 or robot < requester) and fits(
                    held_event[i], level, event_test_from, event_tests
                ):
                    firing = event_transition[held_event[i]]
                    requester = robot
                    interrupted = True
                i += 1
            if firing < 0:
                numbers[HELD_AT] = version

        # -- nothing fires: the next event -------------------------------------------------------
        if firing < 0:
            if n_active > 0 and inactives == n_active:
                status = FINISHED
                break
            if numbers[GROWN] > 0:
                status = GROW
                break
            if events >= enough:
                break
            while n_heap > 0 and due_tag[heap_robot[0]] != heap_tag[0]:
                drop_first(n_heap, heap_time, heap_tag, heap_robot)
                n_heap -= 1
            while n_queue > 0:  # actions that take no time end in any order
                last = n_queue - 1
                i = any_of_these(n_queue, random)
                robot = queue_robot[i]
                tag = queue_tag[i]
                queue_robot[i] = queue_robot[last]
                queue_tag[i] = queue_tag[last]
                queue_robot[last] = robot
                queue_tag[last] = tag
                if due_tag[robot] == tag:
                    break
                n_queue -= 1
            if with_environment > 0 and numbers[ENVIRONMENT_DIRTY] > 0:
                numbers[ENVIRONMENT_DIRTY] = 0
                clocks[ENVIRONMENT_AT] = math.inf
                if tree[1] > 0.0:
                    clocks[ENVIRONMENT_AT] = now + exponential(random) / tree[1]
            if loss_rate[0] > 0.0 and numbers[LOST] != n_active:
                numbers[LOST] = n_active  # the time to the next loss is drawn for so many robots
                clocks[LOSS_AT] = math.inf
                if n_active > 0:
                    clocks[LOSS_AT] = now + exponential(random) / (loss_rate[0] * n_active)
            time = math.inf
            source = 0
            if n_heap > 0:
                time = heap_time[0]
            if n_queue > 0 and time > now:
                time = now
                source = 1
            if clocks[ENVIRONMENT_AT] < time:
                time = clocks[ENVIRONMENT_AT]
                source = 2
            if clocks[LOSS_AT] < time:
                time = clocks[LOSS_AT]
                source = 3
            while n_arrivals > 0 and (
                arrival_tag[0] < visit_from[arrival_who[0] // (all_events + 1)]
            ):
                drop_first(n_arrivals, arrival_time, arrival_tag, arrival_who)
                n_arrivals -= 1
            if n_arrivals > 0 and arrival_time[0] < time:
                time = arrival_time[0]
                source = 4
            if time > stop:
                now = stop
                status = AT_STOP
                break
            if time == math.inf:
                status = STUCK
                break
            timeless = timeless + 1 if time <= now else 0
            if timeless > at_once:
                status = TIMELESS
                break
            now = time
            events += 1
            fired = 0
            if source < 2:
                if source == 0:
                    robot = heap_robot[0]
                    drop_first(n_heap, heap_time, heap_tag, heap_robot)
                    n_heap -= 1
                else:
                    n_queue -= 1
                    robot = queue_robot[n_queue]
                due_tag[robot] = 0
                pending_robot[0] = robot
                pending_what[0] = due_what[robot]
                n_pending = 1
                continue
            if source == 3:
                numbers[LOST] = -1
                numbers[LOST_ROBOT] = active[int(draw_uniform(random) * n_active)]
                status = LOSS
                break
            if source == 4:
                robot = arrival_who[0] // (all_events + 1)
                event = arrival_who[0] % (all_events + 1)
                drop_first(n_arrivals, arrival_time, arrival_tag, arrival_who)
                n_arrivals -= 1
                if event == all_events:
                    begin = event_from[at[robot]]
                    end = event_from[at[robot] + 1]
                    total = 0.0
                    for i in range(begin, end):
                        total += event_rate[i]
                    u = draw_uniform(random) * total
                    for i in range(begin, end):
                        if event_rate[i] > 0.0:
                            event = i
                            u -= event_rate[i]
                            if u < 0.0:
                                break
                    sequence += 1
                    n_arrivals = put(
                        now + exponential(random) / total,
                        sequence,
                        robot * (all_events + 1) + all_events,
                        n_arrivals,
                        arrival_time,
                        arrival_tag,
                        arrival_who,
                        all_events + 1,
                        visit_from,
                    )
                if not fits(event, level, event_test_from, event_tests):
                    if event_hold[event] > 0:
                        i = 0
                        while i < n_held and not (
                            held_robot[i] == robot
                            and held_tag[i] == visit_from[robot]
                            and held_event[i] == event
                        ):
                            i += 1
                        if i == n_held:
                            held_robot[i] = robot
                            held_tag[i] = visit_from[robot]
                            held_event[i] = event
                            n_held += 1
                            numbers[HELD_AT] = -1
                    continue
                firing = event_transition[event]
                requester = robot
                interrupted = True
            else:
                firing = environment_transition[
                    find_leaf(tree, leaves, draw_uniform(random) * tree[1])
                ]
                numbers[ENVIRONMENT_DIRTY] = 1

        # -- fire ----------------------------------------------------------------------------------
        fired += 1
        timeless += 1
        if fired > FIRINGS_PER_ENTRY or timeless > at_once:
            status = TIMELESS
            break
        firings[firing] += 1
        numbers[FIRINGS] += 1
        n_movers = 0
        if not interrupted:
            for arc in range(arc_from[firing], arc_from[firing + 1]):
                place = arc_place[arc]
                wish = arcs + place
                for i in range(arc_weight[arc]):
                    if i == 0 and requester >= 0 and at[requester] == place:
                        robot = requester
                    else:
                        named = level[places + arc]
                        k = any_of_these(
                            named + (level[places + wish] if immediate[firing] > 0 else 0), random
                        )
                        if k < named:
                            robot = waiting_at(k, head[arc], following)
                        else:
                            robot = waiting_at(k - named, head[wish], following)
                    movers[n_movers] = robot
                    n_movers += 1
                    unlink(robot, in_list, following, preceding, head, tail)
                    level[places + in_list[robot]] -= 1
                    waits[list_group[in_list[robot]]] -= 1
        else:
            # it leaves whatever it is doing: its action, or a list in which it waits
            interrupted = False
            movers[0] = requester
            n_movers = 1
            visit_from[requester] = NO_VISIT
            due_tag[requester] = 0
            if phase[requester] == WAITING:
                wish = in_list[requester]
                unlink(requester, in_list, following, preceding, head, tail)
                level[places + wish] -= 1
                waits[list_group[wish]] -= 1
                # without it, others may have other candidates
                n_dirty = mark(
                    joins_from[wish], joins_from[wish + 1], joins, waits, dirty, is_dirty, n_dirty
                )
            in_list[requester] = -1
        begin = effect_from[firing]
        end = effect_from[firing + 1]
        if begin < end:
            version += 1
            while n_volatile > 0:
                n_volatile -= 1
                group = volatile[n_volatile]
                is_volatile[group] = 0
                if waits[group] > 0 and is_dirty[group] == 0:
                    is_dirty[group] = 1
                    dirty[n_dirty] = group
                    n_dirty += 1
        for k in range(begin, end, 2):
            place = effects[k]
            amount = effects[k + 1]
            shift(place, amount, now, level, since, area, spent, spent_from, numbers)
            if amount > 0:
                n_dirty = mark(
                    rising_from[place],
                    rising_from[place + 1],
                    rising,
                    waits,
                    dirty,
                    is_dirty,
                    n_dirty,
                )
            else:
                n_dirty = mark(
                    falling_from[place],
                    falling_from[place + 1],
                    falling,
                    waits,
                    dirty,
                    is_dirty,
                    n_dirty,
                )
            touch(
                place,
                level,
                spontaneous_from,
                spontaneous,
                spontaneous_dirty,
                is_spontaneous_dirty,
                environment_from,
                environment,
                environment_transition,
                server_rate,
                servers,
                test_from,
                tests,
                tree,
                until_reads,
                numbers,
            )
        first = mover_from[firing]
        spare = surplus[firing]
        for i in range(n_movers):
            targets[i] = mover_target[first + i]
        begin = slot_from[firing]
        end = slot_from[firing + 1]
        if spare > 0:
            # some become void; the others take the slots, routes first
            for k in range(spare):
                left = int(draw_uniform(random) * (n_movers - k))
                for i in range(n_movers):
                    if targets[i] >= 0:
                        if left == 0:
                            targets[i] = -1
                            break
                        left -= 1
            n_slots = end - begin
            for i in range(n_slots):
                candidate[i] = slots[begin + i]
            for i in range(n_movers):
                if targets[i] >= 0:
                    targets[i] = -2
                    for j in range(n_slots):
                        if candidate[j] >= 0 and candidate[j] == mover_wants[first + i]:
                            targets[i] = candidate[j]
                            candidate[j] = -1
                            break
            for i in range(n_movers):
                if targets[i] == -2:
                    for j in range(n_slots):
                        if candidate[j] >= 0:
                            targets[i] = candidate[j]
                            candidate[j] = -1
                            break
            begin = end
        for i in range(n_movers):
            robot = movers[i]
            if targets[i] >= 0:
                at[robot] = targets[i]
                pending_robot[n_pending] = robot
                pending_what[n_pending] = ENTERS
                n_pending += 1
            else:
                phase[robot] = GONE
                visit_from[robot] = NO_VISIT
                n_active -= 1
                active[active_at[robot]] = active[n_active]
                active_at[active[n_active]] = active_at[robot]
                free[numbers[FREE]] = robot
                numbers[FREE] += 1
        for k in range(begin, end):
            if numbers[FREE] == 0:
                status = FULL
                break
            numbers[FREE] -= 1
            robot = free[numbers[FREE]]
            at[robot] = slots[k]
            kind[robot] = 0
            active[n_active] = robot
            active_at[robot] = n_active
            n_active += 1
            pending_robot[n_pending] = robot
            pending_what[n_pending] = ENTERS
            n_pending += 1
        if status == FULL:
            break

    if status in (AT_STOP, UNTIL, FINISHED, STOPPED):
        book_times(now, places, level, since, area, spent, spent_from)
    clocks[NOW] = now
    numbers[MARKING_VERSION] = version
    numbers[SEQUENCE] = sequence
    numbers[DIRTY] = n_dirty
    numbers[VOLATILE] = n_volatile
    numbers[HEAP] = n_heap
    numbers[ARRIVALS] = n_arrivals
    numbers[HELD] = n_held
    numbers[QUEUE] = n_queue
    numbers[PENDING] = n_pending
    numbers[ACTIVE] = n_active
    numbers[INACTIVES] = inactives
    numbers[EVENTS] = events
    numbers[TIMELESS_EVENTS] = timeless
    numbers[SPONTANEOUS] = n_spontaneous
    numbers[FIRED] = fired
    return status


# -- the race of a net -----------------------------------------------------------------------------


class RaceArrays(NamedTuple):
    """A net as arrays."""

    sizes: Any
    """Places, whether the condition asks for deadlocks."""
    test_from: Any
    tests: Any
    effect_from: Any
    effects: Any
    touched_from: Any
    touched: Any
    timed: Any
    rate: Any
    servers: Any
    weight: Any
    priority: Any
    until_reads: Any
    until_operations: Any
    until_arguments: Any


class RaceState(NamedTuple):
    """A run of a net: everything that changes. ``ready`` are the immediate transitions that are
    enabled, whatever their priority; ``tree`` has the rates of the exponential ones."""

    numbers: Any
    clocks: Any
    random: Any
    level: Any
    since: Any
    area: Any
    spent: Any
    spent_from: Any
    firings: Any
    tree: Any
    ready: Any
    ready_at: Any
    stack: Any


# In one piece: a net with clocks, compiled from the plan, is to replace it
def race(r: Any, s: Any, stop: float, budget: int) -> int:
    """Let the enabled transitions race until the clock reaches ``stop`` or this many have fired;
    returns why.

    :param r: RaceArrays, or the same as a plain tuple; ``s`` is a RaceState.
    """
    (
        sizes,
        test_from,
        tests,
        effect_from,
        effects,
        touched_from,
        touched,
        timed,
        rate,
        servers,
        weight,
        priority,
        until_reads,
        until_operations,
        until_arguments,
    ) = r
    (
        numbers,
        clocks,
        random,
        level,
        since,
        area,
        spent,
        spent_from,
        firings,
        tree,
        ready,
        ready_at,
        stack,
    ) = s
    places = sizes[0]
    asks_deadlock = sizes[1]
    leaves = len(tree) // 2
    with_until = len(until_operations)
    now = clocks[NOW]
    n_ready = numbers[READY]
    timeless = numbers[TIMELESS_EVENTS]
    enough = numbers[EVENTS] + budget
    status = MORE

    while True:
        if with_until > 0 and (numbers[CHECK_UNTIL] > 0 or asks_deadlock > 0):
            numbers[CHECK_UNTIL] = 0
            deadlock = 1.0 if n_ready == 0 and tree[1] <= 0.0 else 0.0
            if holds(until_operations, until_arguments, level, deadlock, stack):
                status = UNTIL
                break
        if numbers[GROWN] > 0:
            status = GROW
            break
        if numbers[EVENTS] >= enough:
            break
        if n_ready > 0:
            top = -1
            for i in range(n_ready):
                if priority[ready[i]] > top:
                    top = priority[ready[i]]
            count = 0
            total = 0.0
            least = math.inf
            for i in range(n_ready):
                t = ready[i]
                if priority[t] == top:
                    count += 1
                    total += weight[t]
                    least = min(least, weight[t])
            if count > 1 and least <= 0.0:
                status = UNDECIDED
                break
            timeless += 1
            if timeless > FIRINGS_PER_ENTRY:
                status = TIMELESS
                break
            u = 0.0
            if count > 1:
                u = draw_uniform(random) * total
            fired = ready[0]
            for i in range(n_ready):
                t = ready[i]
                if priority[t] == top:
                    fired = t
                    u -= weight[t]
                    if u < 0.0:
                        break
        else:
            time = math.inf
            if tree[1] > 0.0:
                time = now + exponential(random) / tree[1]
            if time > stop:
                now = stop
                status = AT_STOP
                break
            if time == math.inf:
                status = STUCK
                break
            now = time
            timeless = 0
            fired = find_leaf(tree, leaves, draw_uniform(random) * tree[1])
        numbers[EVENTS] += 1
        numbers[FIRINGS] += 1
        firings[fired] += 1
        begin = effect_from[fired]
        end = effect_from[fired + 1]
        for k in range(begin, end, 2):
            place = effects[k]
            shift(place, effects[k + 1], now, level, since, area, spent, spent_from, numbers)
            if until_reads[place] > 0:
                numbers[CHECK_UNTIL] = 1
        for k in range(begin, end, 2):
            place = effects[k]
            for j in range(touched_from[place], touched_from[place + 1]):
                t = touched[j]
                if timed[t] > 0:
                    degree = busy(t, servers[t], level, test_from, tests)
                    if tree[leaves + t] != rate[t] * degree:
                        set_leaf(tree, leaves, t, rate[t] * degree)
                else:
                    i = ready_at[t]
                    if fits(t, level, test_from, tests):
                        if i < 0:
                            ready_at[t] = n_ready
                            ready[n_ready] = t
                            n_ready += 1
                    elif i >= 0:
                        n_ready -= 1
                        last = ready[n_ready]
                        ready[i] = last
                        ready_at[last] = i
                        ready_at[t] = -1

    if status in (AT_STOP, UNTIL):
        book_times(now, places, level, since, area, spent, spent_from)
    clocks[NOW] = now
    numbers[READY] = n_ready
    numbers[TIMELESS_EVENTS] = timeless
    return status
