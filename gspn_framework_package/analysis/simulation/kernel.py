"""The inner loops of the simulation: the token game of a plan, and the race of a net.

Every function here is written once and used twice: compiled by numba on arrays, and uncompiled on
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

# In one piece: numba notices a change in this file, but not in files whose functions it calls

from __future__ import annotations

import math
from typing import Any, NamedTuple

from gspn_framework_package.analysis.arrays import Floats, Indices

# Why a loop returned.
GOING = -1
"""It has not."""
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
"""Endless firings without time between them."""
GROW = 7
"""A count outgrew its row of ``spent``."""
LOSS = 10
"""A robot is lost; its number is in ``numbers[LOST_ROBOT]``."""
NO_VALUE = 11
"""A rate or weight is not above 0: see ``numbers[WITHOUT_VALUE]``."""
FULL = 8
"""More agents than there is room for."""
UNDECIDED = 9
"""No weight decides between immediate transitions; their numbers are in ``choice``."""

LONGEST_ROW = 4096
"""Number of counts of a place for which time is booked separately."""

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

# The request of a robot that is done, where it is not a list.
BAD_RESULT = -1
NOWHERE = -2
FAILED_ACTION = -3

# What a robot does when its action has failed and it makes no further attempt.
FAILURE_WAITS = 0
FAILURE_FIRES = 1
FAILURE_STOPS = 2

# The next change of a robot.
ENTERS = 0
ENDS = 1
STARTS = 2
FAILS = 3
IS_DONE = 4
ASKS = 5
NO_MORE = 6
STOPS = 7

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
READY = 15
CHANGED = 16
ENVIRONMENT_DIRTY = 17
GROWN = 18
LOST = 19
FIRED = 20
FIRINGS = 21
FREE = 22
KINDS = 23
ABLE = 24
LOST_ROBOT = 25
ENABLED = 26
ARRIVALS = 27
HELD = 28
HELD_AT = 29
FIRING = 30
REQUESTER = 31
URGENCY = 32
INTERRUPTS = 33
SOURCE = 34
RIVALS = 35
WITHOUT_VALUE = 36
"""1 + the number of an enabled transition whose rate or weight is not above 0; 0: none."""
NUMBERS = 37

NO_VISIT = 1 << 62
"""The first event of a visit in which none comes: later than all."""

# Positions in ``sizes`` of a plan.
PLACE_COUNT = 0
TRANSITION_COUNT = 1
ARC_COUNT = 2
"""ArcArrays of robots."""
ROBOT_ROOM = 3
"""Most robots."""
STRICT = 4
"""Whether no row of the policy means waiting."""
SOME_ROW_ALWAYS = 5
"""Whether some row always matches."""
LOST_RULE = 6
"""What to do when a robot is lost and others wait for it."""
LOST_TRANSITION = 7
"""The transition that they request then."""
ALL_EVENTS = 8
"""Events that interrupt robots."""

# Where the next event comes from.
HEAP_OF_ACTIONS = 0
QUEUE_OF_ACTIONS = 1
ENVIRONMENT = 2
LOSS_OF_ROBOT = 3
INTERRUPTION = 4

# Positions in ``clocks`` of the state.
NOW = 0
ENVIRONMENT_AT = 1
LOSS_AT = 2
NEXT = 3
CLOCKS = 4

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
    return 0.0


# -- heap, tree, tests, conditions ---------------------------------------------------------------


class Heap(NamedTuple):
    """Events in order of time, then tag."""

    time: Any
    tag: Any
    who: Any


def push(time: float, tag: int, what: int, size: int, heap: Heap) -> None:
    """Enter an event into the heap, which has ``size`` events."""
    times, tags, who = heap
    i = size
    while i > 0:
        up = (i - 1) >> 1
        above = times[up]
        if above < time or (above == time and tags[up] < tag):
            break
        times[i] = above
        tags[i] = tags[up]
        who[i] = who[up]
        i = up
    times[i] = time
    tags[i] = tag
    who[i] = what


def drop_first(size: int, heap: Heap) -> None:
    """Remove the first of ``size`` events from the heap."""
    times, tags, who = heap
    size -= 1
    time = times[size]
    tag = tags[size]
    what = who[size]
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
    who[i] = what


def only_current(size: int, heap: Heap, divisor: int, since: Indices, exactly: bool) -> int:
    """Remove the events of a heap that no longer count; returns the size that is left. The robot of
    an event is ``who // divisor``; its tag must be ``since`` of the robot, or also a later one
    unless ``exactly`` is set."""
    times, tags, who = heap
    left = 0
    for i in range(size):
        time = times[i]
        tag = tags[i]
        what = who[i]
        first = since[what // divisor]
        if tag == first or (tag > first and not exactly):
            push(time, tag, what, left, heap)
            left += 1
    return left


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


def value_of(
    begin: int,
    end: int,
    operations: Indices,
    arguments: Floats,
    level: Indices,
    label: float,
    stack: Floats,
) -> float:
    """The value of the steps from ``begin`` on: of a condition 0 if it does not hold, of an
    expression NaN if it has none. ``label`` is the truth of the label of a condition. Comparisons
    with NaN are false."""
    top = 0
    for k in range(begin, end):
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
            stack[top - 1] = of_one(what, stack[top - 1])
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
            top -= 1
            stack[top - 1] = of_two(what, stack[top - 1], stack[top])
    return stack[0]


def of_one(what: int, a: float) -> float:
    """The value of an operation on one number; NaN where it has none."""
    value = math.nan
    if what == 14:
        value = -a
    elif what == 15:
        value = 1.0 if a == 0.0 else 0.0
    elif what == 20:
        value = abs(a)
    elif math.isnan(a) or math.isinf(a):
        value = math.nan
    elif what == 21:
        value = float(math.floor(a))
    elif what == 22:
        value = float(math.ceil(a))
    elif what == 23:
        value = float(math.floor(a + 0.5))
    elif what == 24 and a >= 0.0:
        value = math.sqrt(a)
    elif what == 25 and a < 709.0:
        value = math.exp(a)
    elif what in (26, 27) and a > 0.0:
        value = math.log(a)
    return value


def of_two(what: int, a: float, b: float) -> float:
    """The value of an operation on two numbers; NaN where it has none."""
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
    return value


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

ANY_COUNT = 2**62
"""Stands for no limit on the tokens that fit a cell."""


class RowArrays(NamedTuple):
    """The rows of a policy, by the place that they apply to.

    An *entry* is a row for one place; of those of a place, the smallest takes precedence. Few are a
    list in this order (``listed``). Of many, only those that test a count are; the others are in
    hash tables, one per set of cells that are not wildcards (*mask*), masks with more cells first.
    ``cells`` has the place of a cell, the least and the most tokens that fit it; if the least is
    greater than the most, these bound what does not fit.
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
    cell_from: Any
    cells: Any


class Book(NamedTuple):
    """A policy. Further "places" of ``rows`` stand for all rows of a scope, whatever they apply to;
    ``any_of`` has that of each place."""

    rows: Any
    any_of: Any
    entry_mixed: Any
    choice_from: Any
    choice: Any
    chance: Any


def find_entry(place: int, level: Indices, rows: RowArrays) -> int:
    """The entry that takes precedence among those of ``place`` that match; -1 if none does."""
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
        cell_from,
        cells,
    ) = rows
    first = -1
    for k in range(listed_from[place], listed_from[place + 1]):
        entry = listed[k]
        row = entry_row[entry]
        i = cell_from[row]
        end = cell_from[row + 1]
        while i < end:
            least = cells[i + 1]
            most = cells[i + 2]
            count = level[cells[i]]
            if least <= most:
                if count < least or count > most:
                    break
            elif most < count < least:
                break
            i += 3
        if i >= end:
            first = entry
            break
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
                i += 3
            if i >= last:
                if best < 0 or row < entry_row[best]:
                    best = entry
                    size_of_best = end - begin
                break
            slot = (slot + 1) & (size - 1)
    if first >= 0 and (best < 0 or first < best):
        return first
    return best


class Candidates(NamedTuple):
    """The choice of a robot: transitions, whether each can fire, and weights (0: not a
    candidate)."""

    transition: Any
    able: Any
    weight: Any


class Stamps(NamedTuple):
    """By place: the marking and the candidates of the last choice there, and its stamp. The draw of
    a robot holds as long as it has the stamp of the place."""

    version: Any
    signature: Any
    stamp: Any


# In one piece: a call costs plain Python as much as many of the steps
def weigh(
    place: int,
    sizes: Indices,
    net: NetArrays,
    book: Book,
    leaving_from: Indices,
    leaving: Indices,
    level: Indices,
    candidates: Candidates,
    stamps: Stamps,
    numbers: Indices,
) -> int:
    """Find the candidates of a robot in ``place`` that lets the policy decide.

    Returns their number. ``numbers[ENABLED]`` says how many can fire, ``numbers[KINDS]`` how many
    have a weight, ``numbers[ABLE]`` how many have both. If the marking or the candidates differ
    from the last time, the place gets a new stamp, so that the draws of its robots no longer hold.
    """
    test_from, tests, _, priority, weight = net
    rows, any_of, entry_mixed, choice_from, choice, chance = book
    transitions, able, weights = candidates
    version, signatures, stamp = stamps
    begin = 0
    count = 0
    floor = 0
    signature = -1
    entry = find_entry(place, level, rows)
    if entry >= 0:
        begin = choice_from[entry]
        count = choice_from[entry + 1] - begin
    elif (
        sizes[STRICT] == 0
        and sizes[SOME_ROW_ALWAYS] == 0
        and find_entry(any_of[place], level, rows) < 0
    ):
        begin = leaving_from[place]
        count = leaving_from[place + 1] - begin
        signature = 0
    enabled = 0
    for k in range(count):
        t = choice[begin + k] if entry >= 0 else leaving[begin + k]
        can = 1 if fits(t, level, test_from, tests) else 0
        enabled += can
        transitions[k] = t
        able[k] = can
        if entry >= 0:
            weights[k] = chance[begin + k]
        else:
            weights[k] = weight[t] if can > 0 else 0.0
            if weights[k] < 0.0:
                numbers[WITHOUT_VALUE] = t + 1
            if can > 0:
                signature = (signature * 1000003 + k + 1) & 0x7FFFFFFF
        if can > 0 and priority[t] > floor:
            floor = priority[t]
    if entry >= 0:
        signature = entry
        if entry_mixed[entry] == 0:
            floor = 0
    elif signature >= 0:
        signature = -2 - signature
    numbers[ENABLED] = enabled
    kinds = 0
    both = 0
    for k in range(count):
        if priority[transitions[k]] < floor:
            weights[k] = 0.0
        if weights[k] > 0.0:
            kinds += 1
            both += able[k]
        else:
            able[k] = 0
    numbers[KINDS] = kinds
    numbers[ABLE] = both
    signature = signature * 4096 + floor
    if version[place] != numbers[MARKING_VERSION] or signatures[place] != signature:
        version[place] = numbers[MARKING_VERSION]
        signatures[place] = signature
        numbers[STAMP] += 1
        stamp[place] = numbers[STAMP]
    return count


def pick(count: int, kinds: int, weights: Floats, random: Indices) -> int:
    """Draw one of ``count`` weights, of which ``kinds`` are above 0."""
    u = 0.0
    if kinds > 1:
        total = 0.0
        for k in range(count):
            total += weights[k]
        u = draw_uniform(random) * total
    return at_weight(0, count, weights, u)


def at_weight(begin: int, end: int, weights: Floats, target: float) -> int:
    """The first of the weights from ``begin`` on whose sum exceeds ``target``; the last one above 0
    if rounding leaves none."""
    found = begin
    for k in range(begin, end):
        if weights[k] > 0.0:
            found = k
            target -= weights[k]
            if target < 0.0:
                break
    return found


# -- what plans and nets have in common ------------------------------------------------------------


class NetArrays(NamedTuple):
    """The transitions of a net."""

    test_from: Any
    tests: Any
    immediate: Any
    priority: Any
    weight: Any


class Until(NamedTuple):
    """The condition that ends a run."""

    operations: Any
    arguments: Any


class Rates(NamedTuple):
    """The exponential transitions that race."""

    transition: Any
    rate: Any
    servers: Any


class MarkingFunctions(NamedTuple):
    """Rates and weights that depend on the marking."""

    transition: Any
    race: Any
    """The number among the transitions that race; -1: its value is a weight."""
    read_from: Any
    read: Any
    """By place: the functions that read its count."""
    step_from: Any
    operations: Any
    arguments: Any
    stack: Any


class CountArrays(NamedTuple):
    """The counts of places, and the times that they had them."""

    level: Any
    since: Any
    area: Any
    spent: Any
    spent_from: Any


class Ready(NamedTuple):
    """The immediate transitions that are enabled, whatever their priority."""

    ready: Any
    ready_at: Any


def shift(place: int, amount: int, now: float, counts: CountArrays, numbers: Indices) -> None:
    """Change the count of a place, after booking the time that it had the old one."""
    level, since, area, spent, spent_from = counts
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
    row = spent_from[place + 1] - spent_from[place]
    if row <= count and row < LONGEST_ROW:
        numbers[GROWN] = 1


def book_times(now: float, places: int, counts: CountArrays) -> None:
    """Book the time that all places had their counts."""
    level, since, area, spent, spent_from = counts
    for place in range(places):
        passed = now - since[place]
        if passed > 0.0:
            count = level[place]
            area[place] += passed * count
            at = spent_from[place] + count
            if at < spent_from[place + 1]:
                spent[at] += passed
        since[place] = now


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


def compute(
    k: int, functions: MarkingFunctions, net: NetArrays, rates: Rates, level: Indices
) -> None:
    """Enter the value of a rate or weight that depends on the marking; -1 if it has none above
    0."""
    transition, race, _, _, step_from, operations, arguments, stack = functions
    _, _, _, _, weight = net
    _, rate, _ = rates
    value = value_of(step_from[k], step_from[k + 1], operations, arguments, level, 0.0, stack)
    if not 0.0 < value < math.inf:
        value = -1.0
    if race[k] >= 0:
        rate[race[k]] = value
    else:
        weight[transition[k]] = value


def set_rate(
    i: int, net: NetArrays, rates: Rates, level: Indices, tree: Floats, numbers: Indices
) -> None:
    """Enter the rate of an exponential transition in this marking into the tree."""
    test_from, tests, _, _, _ = net
    transition, rate, servers = rates
    leaves = len(tree) // 2
    degree = busy(transition[i], servers[i], level, test_from, tests)
    value = rate[i] * degree
    if value < 0.0:
        numbers[WITHOUT_VALUE] = transition[i] + 1
        value = 0.0
    if tree[leaves + i] != value:
        set_leaf(tree, leaves, i, value)


def time_of_race(now: float, tree: Floats, random: Indices) -> float:
    """Draw when the next of the exponential transitions fires; infinite if none is enabled."""
    if tree[1] > 0.0:
        return now + exponential(random) / tree[1]
    return math.inf


def winner(tree: Floats, random: Indices) -> int:
    """Draw which of the exponential transitions fires."""
    return find_leaf(tree, len(tree) // 2, draw_uniform(random) * tree[1])


def set_ready(t: int, net: NetArrays, level: Indices, ready_ones: Ready, numbers: Indices) -> None:
    """Note whether an immediate transition is enabled in this marking."""
    test_from, tests, _, _, _ = net
    ready, ready_at = ready_ones
    i = ready_at[t]
    if fits(t, level, test_from, tests):
        if i < 0:
            ready_at[t] = numbers[READY]
            ready[numbers[READY]] = t
            numbers[READY] += 1
    elif i >= 0:
        numbers[READY] -= 1
        last = ready[numbers[READY]]
        ready[i] = last
        ready_at[last] = i
        ready_at[t] = -1


def choose_ready(
    net: NetArrays, ready_ones: Ready, decided: bool, random: Indices, numbers: Indices
) -> int:
    """Draw one of the immediate transitions that are enabled, of those with the highest priority.

    Without weights, it is the first one of the file, unless weights must have ``decided``: then it
    is -1.
    """
    _, _, _, priority, weight = net
    ready, _ = ready_ones
    n_ready = numbers[READY]
    top = -1
    for i in range(n_ready):
        if priority[ready[i]] > top:
            top = priority[ready[i]]
    count = 0
    total = 0.0
    least = math.inf
    first = len(priority)
    for i in range(n_ready):
        t = ready[i]
        if priority[t] == top:
            count += 1
            if weight[t] < 0.0:
                numbers[WITHOUT_VALUE] = t + 1
            total += weight[t]
            least = min(least, weight[t])
            if t < first:
                first = t
    if decided and count > 1 and least <= 0.0:
        return -1
    firing = first
    if total > 0.0 and not (decided and count == 1):
        u = draw_uniform(random) * total
        for i in range(n_ready):
            t = ready[i]
            if priority[t] == top and weight[t] > 0.0:
                firing = t
                u -= weight[t]
                if u < 0.0:
                    break
    return firing


# -- the token game of a plan: rules and state -----------------------------------------------------


class Durations(NamedTuple):
    """How long actions take. ``timing_of`` has, by kind of robot and place, the number by which
    what a robot does there is listed, here and in OutcomeArrays and Failures. A duration is drawn
    from its parts (``part_from``): with their chances, a shift (s) and then a time."""

    timing_of: Any
    part_from: Any
    part_chance: Any
    part_shift: Any
    part_kind: Any
    part_mean: Any
    table_from: Any
    table: Any
    timeout: Any


class OutcomeArrays(NamedTuple):
    """The requests of robots that are done, as lists; the first is that of a robot without an
    action."""

    outcome_from: Any
    outcome_list: Any
    outcome_chance: Any


class Failures(NamedTuple):
    """How often actions fail, and what to do then: the number of further attempts, each after its
    delay (s; the last delay holds for all others), then the end of the rule."""

    failure: Any
    rule_times: Any
    delay_from: Any
    delays: Any
    rule_end: Any
    rule_list: Any


class InterruptArrays(NamedTuple):
    """The events that interrupt robots: ``event_from`` by place. An event comes ``event_after``
    (s) after a robot has entered the place; 0: at its rate."""

    event_from: Any
    event_transition: Any
    event_rate: Any
    event_after: Any
    event_hold: Any
    event_test_from: Any
    event_tests: Any


class Visits(NamedTuple):
    """The actions of robots in places."""

    durations: Any
    outcomes: Any
    failures: Any
    interrupts: Any


class ArcArrays(NamedTuple):
    """The arcs of robots by transition, the immediate transitions by place, the group of each list,
    and the groups that a robot concerns when it joins a list."""

    arc_from: Any
    arc_place: Any
    arc_weight: Any
    leaving_from: Any
    leaving: Any
    list_group: Any
    joins_from: Any
    joins: Any


class Moves(NamedTuple):
    """Where the robots go that a transition moves."""

    mover_from: Any
    mover_target: Any
    mover_wants: Any
    slot_from: Any
    slots: Any
    surplus: Any


class Readers(NamedTuple):
    """By place, the groups that a rising or falling count concerns."""

    rising_from: Any
    rising: Any
    falling_from: Any
    falling: Any


class Watchers(NamedTuple):
    """By place, what a change of its count concerns beside robots: immediate transitions that only
    take resources, exponential ones of the environment, the condition that ends the run, and
    functions of the marking."""

    spontaneous_from: Any
    spontaneous: Any
    environment_from: Any
    environment: Any
    until_reads: Any
    functions: Any


class ChangeArrays(NamedTuple):
    """By transition, the changes of counts, and what they concern."""

    effect_from: Any
    effects: Any
    readers: Any
    watchers: Any
    rates: Any


class Losses(NamedTuple):
    """How often robots are lost, and what their eviction changes, by place."""

    rate: Any
    evicted_from: Any
    evicted: Any


class PlanArrays(NamedTuple):
    """A plan as arrays; ``x_from[i]`` to ``x_from[i + 1]`` is the part of ``x`` that belongs to
    ``i``."""

    sizes: Any
    net: Any
    visits: Any
    arcs: Any
    changes: Any
    moves: Any
    until: Any
    losses: Any


class Robots(NamedTuple):
    """By robot: where it is and what it does. ``visit_from`` is the tag of the first event of its
    visit; NO_VISIT: none comes."""

    at: Any
    phase: Any
    kind: Any
    failures: Any
    due_tag: Any
    due_what: Any
    visit_from: Any


class Members(NamedTuple):
    """The robots that take part, where each is among them, and the numbers that are free."""

    active: Any
    active_at: Any
    free: Any


class Lists(NamedTuple):
    """The robots that wait: their lists, their neighbours there, and what the policy has drawn for
    them; by list, the first and the last one; by group, how many there are."""

    in_list: Any
    following: Any
    preceding: Any
    draw: Any
    draw_stamp: Any
    head: Any
    tail: Any
    waits: Any


class Marks(NamedTuple):
    """The groups to look at again: now, and when the marking has changed."""

    dirty: Any
    is_dirty: Any
    volatile: Any
    is_volatile: Any


class ChoiceArrays(NamedTuple):
    """The choices of robots that let the policy decide."""

    candidates: Any
    stamps: Any


class Held(NamedTuple):
    """Events that fire as soon as they can, if the visit is still the one with that tag."""

    robot: Any
    tag: Any
    event: Any


class Calendar(NamedTuple):
    """The next occurrences: the robots that enter, end, fail or start now; the ends of actions, and
    of those without duration; the events that interrupt robots.

    What comes in ``arrivals`` is ``robot * (events + 1)``, plus the number of an event that comes
    after a fixed time, or plus the number of all events for the next one that comes at a rate.
    """

    pending_robot: Any
    pending_what: Any
    heap: Any
    queue_tag: Any
    queue_robot: Any
    arrivals: Any
    held: Any


class Chance(NamedTuple):
    """Firings without robots: the immediate transitions that only take resources, with those to
    look at again, and the rates of the environment."""

    ready_ones: Any
    changed: Any
    is_changed: Any
    tree: Any


class PlanState(NamedTuple):
    """A run of a plan: everything that changes."""

    numbers: Any
    clocks: Any
    random: Any
    counts: Any
    firings: Any
    robots: Any
    members: Any
    lists: Any
    marks: Any
    choices: Any
    calendar: Any
    chance: Any
    movers: Any
    targets: Any
    stack: Any


# -- what a robot does in a place ------------------------------------------------------------------


# In one piece: a call costs plain Python as much as many of the steps
def serve_pending(
    sizes: Indices,
    visits: Visits,
    arcs: ArcArrays,
    robots: Robots,
    lists: Lists,
    marks: Marks,
    calendar: Calendar,
    level: Indices,
    clocks: Floats,
    random: Indices,
    numbers: Indices,
) -> int:
    """Let the robots that enter, end, fail or start now do so; returns STOPPED if a failure stops
    the team, else GOING."""
    durations, outcomes, failures, interrupts = visits
    _, _, _, _, _, list_group, joins_from, joins = arcs
    _, _, _, _, _, _, _, waits = lists
    timing_of, part_from, _, _, part_kind, _, _, _, _ = durations
    outcome_from, outcome_list, _ = outcomes
    at, phase, kind, tried, _, _, visit_from = robots
    pending_robot, pending_what, heap, queue_tag, queue_robot, arrivals, _ = calendar
    status = GOING
    for k in range(numbers[PENDING]):
        robot = pending_robot[k]
        what = pending_what[k]
        timing = timing_of[kind[robot] * sizes[PLACE_COUNT] + at[robot]]
        wish = BAD_RESULT
        if what == ENTERS:
            tried[robot] = 0
            if sizes[ALL_EVENTS] > 0:
                expect_events(
                    robot,
                    at[robot],
                    sizes[ALL_EVENTS],
                    interrupts,
                    visit_from,
                    arrivals,
                    clocks,
                    random,
                    numbers,
                )
            what = STARTS
            if part_kind[part_from[timing]] == NULL_ACTION:
                what = IS_DONE
                wish = outcome_list[outcome_from[timing]]
        elif what == ENDS:
            wish = result(timing, outcomes, failures, random)
            what = FAILS if wish == FAILED_ACTION else IS_DONE
        if what == IS_DONE:
            what = ASKS
            if wish == NOWHERE:
                phase[robot] = INACTIVE
                numbers[INACTIVES] += 1
                what = NO_MORE
            elif wish == BAD_RESULT:
                what = FAILS
        delay = 0.0
        if what == FAILS:
            what = after_failure(timing, tried[robot], failures)
            if what == STOPS:
                status = STOPPED
                break
            if what == STARTS:
                _, _, delay_from, delays, _, _ = failures
                delay = delays[min(delay_from[timing] + tried[robot], delay_from[timing + 1] - 1)]
                tried[robot] += 1
            elif what == ASKS:
                _, _, _, _, _, rule_list = failures
                wish = rule_list[timing]
            else:
                phase[robot] = FAILED
        if what == STARTS:
            start(
                robot,
                timing,
                delay,
                durations,
                robots,
                heap,
                queue_tag,
                queue_robot,
                clocks,
                random,
                numbers,
            )
        elif what == ASKS:
            tried[robot] = 0
            phase[robot] = WAITING
            join_list(robot, wish, sizes[PLACE_COUNT], list_group, lists, level)
            mark(joins_from[wish], joins_from[wish + 1], joins, waits, marks, numbers)
    numbers[PENDING] = 0
    return status


def result(timing: int, outcomes: OutcomeArrays, failures: Failures, random: Indices) -> int:
    """The list that a robot asks for at the end of its action, or FAILED_ACTION."""
    outcome_from, outcome_list, outcome_chance = outcomes
    failure, _, _, _, _, _ = failures
    if failure[timing] > 0.0 and draw_uniform(random) < failure[timing]:
        return FAILED_ACTION
    i = outcome_from[timing]
    end = outcome_from[timing + 1] - 1
    if i < end:
        u = draw_uniform(random)
        while i < end and u >= outcome_chance[i]:
            i += 1
    return outcome_list[i]


def after_failure(timing: int, tried: int, failures: Failures) -> int:
    """What a robot does after its action has failed: STARTS, ASKS, STOPS, or NO_MORE."""
    _, rule_times, _, _, rule_end, rule_list = failures
    if tried < rule_times[timing]:
        return STARTS
    if rule_end[timing] == FAILURE_FIRES and rule_list[timing] >= 0:
        return ASKS
    if rule_end[timing] == FAILURE_STOPS:
        return STOPS
    return NO_MORE


def only_due(count: int, tags: Indices, robots: Indices, due_tag: Indices) -> int:
    """Keep the entries of a list of actions that are still running; returns their number."""
    kept = 0
    for i in range(count):
        if due_tag[robots[i]] == tags[i]:
            tags[kept] = tags[i]
            robots[kept] = robots[i]
            kept += 1
    return kept


def draw_length(timing: int, durations: Durations, random: Indices) -> float:
    """How long an action takes (s)."""
    _, part_from, chance, shift, kind, mean, table_from, table, _ = durations
    i = part_from[timing]
    last = part_from[timing + 1] - 1
    if i < last:
        left = draw_uniform(random)
        while i < last and left >= chance[i]:
            left -= chance[i]
            i += 1
    return shift[i] + draw_duration(
        kind[i], mean[i], table_from[i], table_from[i + 1], table, random
    )


def start(
    robot: int,
    timing: int,
    delay: float,
    durations: Durations,
    robots: Robots,
    heap: Heap,
    queue_tag: Indices,
    queue_robot: Indices,
    clocks: Floats,
    random: Indices,
    numbers: Indices,
) -> None:
    """Start the action of a robot after a delay (s)."""
    _, _, _, _, _, _, _, _, timeout = durations
    _, phase, _, _, due_tag, due_what, _ = robots
    _, _, heap_robot = heap
    phase[robot] = DOING
    length = draw_length(timing, durations, random)
    numbers[SEQUENCE] += 1
    sequence = numbers[SEQUENCE]
    due_tag[robot] = sequence
    due_what[robot] = ENDS
    if length > timeout[timing]:
        length = timeout[timing]
        due_what[robot] = FAILS
    length += delay
    if length > 0.0:
        if numbers[HEAP] >= len(heap_robot):
            numbers[HEAP] = only_current(numbers[HEAP], heap, 1, due_tag, True)
        push(clocks[NOW] + length, sequence, robot, numbers[HEAP], heap)
        numbers[HEAP] += 1
    else:
        if numbers[QUEUE] >= len(queue_robot):
            numbers[QUEUE] = only_due(numbers[QUEUE], queue_tag, queue_robot, due_tag)
        i = numbers[QUEUE]
        queue_tag[i] = sequence
        queue_robot[i] = robot
        numbers[QUEUE] += 1


# -- events that interrupt robots ------------------------------------------------------------------


def expect(
    time: float,
    what: int,
    divisor: int,
    visit_from: Indices,
    arrivals: Heap,
    numbers: Indices,
) -> None:
    """Enter an event that interrupts into its heap, from which those of visits that are over are
    removed if it is full (see :func:`only_current`)."""
    _, _, who = arrivals
    numbers[SEQUENCE] += 1
    if numbers[ARRIVALS] >= len(who):
        numbers[ARRIVALS] = only_current(numbers[ARRIVALS], arrivals, divisor, visit_from, False)
    push(time, numbers[SEQUENCE], what, numbers[ARRIVALS], arrivals)
    numbers[ARRIVALS] += 1


def expect_events(
    robot: int,
    place: int,
    all_events: int,
    interrupts: InterruptArrays,
    visit_from: Indices,
    arrivals: Heap,
    clocks: Floats,
    random: Indices,
    numbers: Indices,
) -> None:
    """Enter the first events of a robot's visit to a place."""
    event_from, _, event_rate, event_after, _, _, _ = interrupts
    visit_from[robot] = NO_VISIT
    begin = event_from[place]
    end = event_from[place + 1]
    if begin == end:
        return
    visit_from[robot] = numbers[SEQUENCE] + 1
    first = robot * (all_events + 1)
    total = 0.0
    for i in range(begin, end):
        if event_after[i] > 0.0:
            time = clocks[NOW] + event_after[i]
            expect(time, first + i, all_events + 1, visit_from, arrivals, numbers)
        else:
            total += event_rate[i]
    if total > 0.0:
        time = clocks[NOW] + exponential(random) / total
        expect(time, first + all_events, all_events + 1, visit_from, arrivals, numbers)


def draw_event(
    robot: int,
    place: int,
    all_events: int,
    interrupts: InterruptArrays,
    visit_from: Indices,
    arrivals: Heap,
    clocks: Floats,
    random: Indices,
    numbers: Indices,
) -> int:
    """Draw which of the events of a place that come at a rate has come, and when the next does."""
    event_from, _, event_rate, _, _, _, _ = interrupts
    begin = event_from[place]
    end = event_from[place + 1]
    total = 0.0
    for i in range(begin, end):
        total += event_rate[i]
    event = at_weight(begin, end, event_rate, draw_uniform(random) * total)
    time = clocks[NOW] + exponential(random) / total
    what = robot * (all_events + 1) + all_events
    expect(time, what, all_events + 1, visit_from, arrivals, numbers)
    return event


def hold(robot: int, tag: int, event: int, held: Held, numbers: Indices) -> None:
    """Note an event that cannot fire yet."""
    held_robot, held_tag, held_event = held
    count = numbers[HELD]
    i = 0
    while i < count and not (
        held_robot[i] == robot and held_tag[i] == tag and held_event[i] == event
    ):
        i += 1
    if i == count:
        held_robot[i] = robot
        held_tag[i] = tag
        held_event[i] = event
        numbers[HELD] += 1
        numbers[HELD_AT] = -1


def find_held(
    interrupts: InterruptArrays, held: Held, visit_from: Indices, level: Indices, numbers: Indices
) -> int:
    """The transition of an event that is held and can fire now, of the first robot that has one,
    which becomes the requester; -1: none."""
    _, event_transition, _, _, _, event_test_from, event_tests = interrupts
    held_robot, held_tag, held_event = held
    firing = -1
    i = 0
    while i < numbers[HELD]:
        robot = held_robot[i]
        if visit_from[robot] != held_tag[i]:
            numbers[HELD] -= 1
            for j in range(i, numbers[HELD]):
                held_robot[j] = held_robot[j + 1]
                held_tag[j] = held_tag[j + 1]
                held_event[j] = held_event[j + 1]
            continue
        if (firing < 0 or robot < numbers[REQUESTER]) and fits(
            held_event[i], level, event_test_from, event_tests
        ):
            firing = event_transition[held_event[i]]
            numbers[REQUESTER] = robot
            numbers[INTERRUPTS] = 1
        i += 1
    if firing < 0:
        numbers[HELD_AT] = numbers[MARKING_VERSION]
    return firing


# -- what robots ask for ---------------------------------------------------------------------------


def any_of_these(count: int, random: Indices) -> int:
    """A random number from 0 to ``count`` - 1."""
    return int(draw_uniform(random) * count) if count > 1 else 0


def waiting_at(k: int, robot: int, following: Indices) -> int:
    """The robot that is ``k`` places behind ``robot`` in its list."""
    for _ in range(k):
        robot = following[robot]
    return robot


def mark(
    begin: int, end: int, listed: Indices, waits: Indices, marks: Marks, numbers: Indices
) -> None:
    """Put the groups ``listed[begin:end]`` that have robots among the dirty ones."""
    dirty, is_dirty, _, _ = marks
    for k in range(begin, end):
        group = listed[k]
        if waits[group] > 0 and is_dirty[group] == 0:
            is_dirty[group] = 1
            dirty[numbers[DIRTY]] = group
            numbers[DIRTY] += 1


def join_list(
    robot: int, wish: int, places: int, list_group: Indices, lists: Lists, level: Indices
) -> None:
    """Let a robot wait in the list ``wish``, as the last one."""
    in_list, following, preceding, _, draw_stamp, head, tail, waits = lists
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


def leave_list(robot: int, places: int, list_group: Indices, lists: Lists, level: Indices) -> None:
    """Take a robot out of the list in which it waits."""
    in_list, following, preceding, _, _, head, tail, waits = lists
    wish = in_list[robot]
    before = preceding[robot]
    after = following[robot]
    if before < 0:
        head[wish] = after
    else:
        following[before] = after
    if after < 0:
        tail[wish] = before
    else:
        preceding[after] = before
    level[places + wish] -= 1
    waits[list_group[wish]] -= 1


def next_request(
    sizes: Indices,
    net: NetArrays,
    book: Book,
    arcs: ArcArrays,
    lists: Lists,
    marks: Marks,
    choices: ChoiceArrays,
    level: Indices,
    random: Indices,
    numbers: Indices,
) -> int:
    """The transition that fires by the requests of robots, and ``numbers[REQUESTER]`` the robot
    that asks for it; -1: none. Chance decides between requests that are as urgent
    (``numbers[RIVALS]`` of them so far). Groups in which nobody can fire are dirty no longer."""
    dirty, is_dirty, _, _ = marks
    _, _, _, _, _, _, _, waits = lists
    transitions = sizes[TRANSITION_COUNT]
    numbers[FIRING] = -1
    numbers[URGENCY] = -2
    numbers[RIVALS] = 0
    i = 0
    while i < numbers[DIRTY]:
        group = dirty[i]
        can = False
        if waits[group] > 0:
            if group < transitions:
                can = ask_named(group, sizes[PLACE_COUNT], net, arcs, lists, level, random, numbers)
            else:
                can = ask_policy(
                    group - transitions,
                    sizes,
                    net,
                    book,
                    arcs,
                    lists,
                    marks,
                    choices,
                    level,
                    random,
                    numbers,
                )
        if can:
            i += 1
        else:
            is_dirty[group] = 0
            numbers[DIRTY] -= 1
            dirty[i] = dirty[numbers[DIRTY]]
    return numbers[FIRING]


def draw_rival(urgency: int, count: int, random: Indices, numbers: Indices) -> int:
    """Let ``count`` more requests of this urgency compete with the earlier ones, each with the same
    chance. Returns which of the new requests is first now; ``count`` or more if an earlier one is
    still first."""
    if urgency < numbers[URGENCY]:
        return count
    if urgency > numbers[URGENCY]:
        numbers[RIVALS] = 0
        numbers[URGENCY] = urgency
    numbers[RIVALS] += count
    return any_of_these(numbers[RIVALS], random)


def ask_named(
    t: int,
    places: int,
    net: NetArrays,
    arcs: ArcArrays,
    lists: Lists,
    level: Indices,
    random: Indices,
    numbers: Indices,
) -> bool:
    """Consider the robots that have named a transition; returns whether it can fire."""
    test_from, tests, immediate, priority, _ = net
    if not fits(t, level, test_from, tests):
        return False
    _, following, _, _, _, head, _, waits = lists
    k = draw_rival(priority[t] if immediate[t] > 0 else -1, waits[t], random, numbers)
    if k < waits[t]:
        arc_from, _, _, _, _, _, _, _ = arcs
        arc = arc_from[t]
        while k >= level[places + arc]:
            k -= level[places + arc]
            arc += 1
        numbers[FIRING] = t
        numbers[REQUESTER] = waiting_at(k, head[arc], following)
    return True


def ask_policy(
    place: int,
    sizes: Indices,
    net: NetArrays,
    book: Book,
    arcs: ArcArrays,
    lists: Lists,
    marks: Marks,
    choices: ChoiceArrays,
    level: Indices,
    random: Indices,
    numbers: Indices,
) -> bool:
    """Consider the robots in a place that let the policy decide; returns whether one can fire."""
    _, _, _, priority, _ = net
    _, _, _, leaving_from, leaving, _, _, _ = arcs
    _, following, _, draw, draw_stamp, head, _, _ = lists
    candidates, stamps = choices
    transitions, able, weights = candidates
    _, _, stamp = stamps
    count = weigh(
        place, sizes, net, book, leaving_from, leaving, level, candidates, stamps, numbers
    )
    kinds = numbers[KINDS]
    can = False
    if numbers[ABLE] > 0:
        robot = head[sizes[ARC_COUNT] + place]
        while robot >= 0:
            if draw_stamp[robot] != stamp[place]:
                draw_stamp[robot] = stamp[place]
                draw[robot] = pick(count, kinds, weights, random)
            k = draw[robot]
            if able[k] > 0:
                can = True
                if draw_rival(priority[transitions[k]], 1, random, numbers) == 0:
                    numbers[FIRING] = transitions[k]
                    numbers[REQUESTER] = robot
            elif kinds == 1:
                break
            robot = following[robot]
    if not can and numbers[ENABLED] > 0:
        # another draw, or other candidates, in the next marking may be able to fire
        _, _, volatile, is_volatile = marks
        group = sizes[TRANSITION_COUNT] + place
        if is_volatile[group] == 0:
            is_volatile[group] = 1
            volatile[numbers[VOLATILE]] = group
            numbers[VOLATILE] += 1
    return can


# -- a firing --------------------------------------------------------------------------------------


def take_movers(
    firing: int,
    sizes: Indices,
    net: NetArrays,
    arcs: ArcArrays,
    at: Indices,
    lists: Lists,
    movers: Indices,
    level: Indices,
    random: Indices,
    numbers: Indices,
) -> int:
    """Enter the robots that a transition moves into ``movers``, and take them out of their lists:
    of each place any of those that wait for it, but the requester in any case. Returns their
    number."""
    _, _, immediate, _, _ = net
    arc_from, arc_place, arc_weight, _, _, list_group, _, _ = arcs
    _, following, _, _, _, head, _, _ = lists
    places = sizes[PLACE_COUNT]
    requester = numbers[REQUESTER]
    n_movers = 0
    for arc in range(arc_from[firing], arc_from[firing + 1]):
        place = arc_place[arc]
        wish = sizes[ARC_COUNT] + place
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
            leave_list(robot, places, list_group, lists, level)
    return n_movers


def interrupt(
    places: int,
    arcs: ArcArrays,
    robots: Robots,
    lists: Lists,
    marks: Marks,
    movers: Indices,
    level: Indices,
    numbers: Indices,
) -> None:
    """Let the requester, which is interrupted, leave whatever it is doing, its action or a list in
    which it waits, to be the only mover."""
    _, _, _, _, _, list_group, joins_from, joins = arcs
    _, phase, _, _, due_tag, _, visit_from = robots
    in_list, _, _, _, _, _, _, waits = lists
    robot = numbers[REQUESTER]
    movers[0] = robot
    visit_from[robot] = NO_VISIT
    due_tag[robot] = 0
    if phase[robot] == WAITING:
        wish = in_list[robot]
        leave_list(robot, places, list_group, lists, level)
        # without it, others may have other candidates
        mark(joins_from[wish], joins_from[wish + 1], joins, waits, marks, numbers)
    in_list[robot] = -1


def touch(
    place: int,
    net: NetArrays,
    watchers: Watchers,
    rates: Rates,
    chance: Chance,
    level: Indices,
    numbers: Indices,
) -> None:
    """Note what else depends on the count of ``place``, which has changed: transitions that only
    take resources, and the condition that ends the run."""
    spontaneous_from, spontaneous, environment_from, environment, until_reads, functions = watchers
    _, _, read_from, read, _, _, _, _ = functions
    _, changed, is_changed, tree = chance
    for k in range(read_from[place], read_from[place + 1]):
        compute(read[k], functions, net, rates, level)
    for k in range(spontaneous_from[place], spontaneous_from[place + 1]):
        t = spontaneous[k]
        if is_changed[t] == 0:
            is_changed[t] = 1
            changed[numbers[CHANGED]] = t
            numbers[CHANGED] += 1
    for k in range(environment_from[place], environment_from[place + 1]):
        set_rate(environment[k], net, rates, level, tree, numbers)
        numbers[ENVIRONMENT_DIRTY] = 1
    if until_reads[place] > 0:
        numbers[CHECK_UNTIL] = 1


def change_counts(
    firing: int,
    net: NetArrays,
    changes: ChangeArrays,
    waits: Indices,
    marks: Marks,
    chance: Chance,
    counts: CountArrays,
    clocks: Floats,
    numbers: Indices,
) -> None:
    """Change the counts of places by a firing, and note what must be looked at again."""
    effect_from, effects, readers, watchers, rates = changes
    rising_from, rising, falling_from, falling = readers
    _, _, volatile, is_volatile = marks
    level, _, _, _, _ = counts
    begin = effect_from[firing]
    end = effect_from[firing + 1]
    if begin == end:
        return
    numbers[MARKING_VERSION] += 1
    while numbers[VOLATILE] > 0:
        numbers[VOLATILE] -= 1
        last = numbers[VOLATILE]
        is_volatile[volatile[last]] = 0
        mark(last, last + 1, volatile, waits, marks, numbers)
    for k in range(begin, end, 2):
        place = effects[k]
        shift(place, effects[k + 1], clocks[NOW], counts, numbers)
        if effects[k + 1] > 0:
            mark(rising_from[place], rising_from[place + 1], rising, waits, marks, numbers)
        else:
            mark(falling_from[place], falling_from[place + 1], falling, waits, marks, numbers)
    for k in range(begin, end, 2):
        touch(effects[k], net, watchers, rates, chance, level, numbers)


def choose_targets(
    firing: int,
    n_movers: int,
    moves: Moves,
    targets: Indices,
    slots_left: Indices,
    random: Indices,
) -> None:
    """Draw which movers become void, those with a target of -1; the others take the slots, routes
    first."""
    mover_from, _, mover_wants, slot_from, slots, surplus = moves
    first = mover_from[firing]
    for i in range(n_movers):
        targets[i] = 0
    for k in range(surplus[firing]):
        left = int(draw_uniform(random) * (n_movers - k))
        for i in range(n_movers):
            if targets[i] >= 0:
                if left == 0:
                    targets[i] = -1
                    break
                left -= 1
    begin = slot_from[firing]
    n_slots = slot_from[firing + 1] - begin
    for i in range(n_slots):
        slots_left[i] = slots[begin + i]
    for i in range(n_movers):
        if targets[i] >= 0:
            targets[i] = -2
            for j in range(n_slots):
                if slots_left[j] >= 0 and slots_left[j] == mover_wants[first + i]:
                    targets[i] = slots_left[j]
                    slots_left[j] = -1
                    break
    for i in range(n_movers):
        if targets[i] == -2:
            for j in range(n_slots):
                if slots_left[j] >= 0:
                    targets[i] = slots_left[j]
                    slots_left[j] = -1
                    break


def move(
    firing: int,
    n_movers: int,
    moves: Moves,
    robots: Robots,
    members: Members,
    calendar: Calendar,
    movers: Indices,
    targets: Indices,
    numbers: Indices,
) -> int:
    """Let the movers go to their targets, and new agents appear; returns FULL if there is no room
    for them, else GOING."""
    mover_from, mover_target, _, slot_from, slots, surplus = moves
    at, phase, kind, _, _, _, visit_from = robots
    active, active_at, free = members
    pending_robot, pending_what, _, _, _, _, _ = calendar
    first = mover_from[firing]
    for i in range(n_movers):
        robot = movers[i]
        target = targets[i] if surplus[firing] > 0 else mover_target[first + i]
        if target >= 0:
            at[robot] = target
            pending_robot[numbers[PENDING]] = robot
            pending_what[numbers[PENDING]] = ENTERS
            numbers[PENDING] += 1
        else:
            phase[robot] = GONE
            visit_from[robot] = NO_VISIT
            take_out(robot, active, active_at, numbers)
            free[numbers[FREE]] = robot
            numbers[FREE] += 1
    if surplus[firing] > 0:
        return GOING
    for k in range(slot_from[firing], slot_from[firing + 1]):
        if numbers[FREE] == 0:
            return FULL
        numbers[FREE] -= 1
        robot = free[numbers[FREE]]
        at[robot] = slots[k]
        kind[robot] = 0
        active[numbers[ACTIVE]] = robot
        active_at[robot] = numbers[ACTIVE]
        numbers[ACTIVE] += 1
        pending_robot[numbers[PENDING]] = robot
        pending_what[numbers[PENDING]] = ENTERS
        numbers[PENDING] += 1
    return GOING


def take_out(robot: int, active: Indices, active_at: Indices, numbers: Indices) -> None:
    """Remove a robot from those that take part."""
    numbers[ACTIVE] -= 1
    last = active[numbers[ACTIVE]]
    active[active_at[robot]] = last
    active_at[last] = active_at[robot]


# -- the next event --------------------------------------------------------------------------------


def draw_others(
    loss_rate: Floats, tree: Floats, clocks: Floats, random: Indices, numbers: Indices
) -> None:
    """Draw when the environment fires next and when a robot is lost, where it has changed."""
    if numbers[ENVIRONMENT_DIRTY] > 0:
        numbers[ENVIRONMENT_DIRTY] = 0
        clocks[ENVIRONMENT_AT] = time_of_race(clocks[NOW], tree, random)
    active = numbers[ACTIVE]
    if loss_rate[0] > 0.0 and numbers[LOST] != active:
        numbers[LOST] = active  # the number of robots for which the time to the next loss was drawn
        clocks[LOSS_AT] = math.inf
        if active > 0:
            clocks[LOSS_AT] = clocks[NOW] + exponential(random) / (loss_rate[0] * active)


def draw_from_queue(
    due_tag: Indices, calendar: Calendar, random: Indices, numbers: Indices
) -> None:
    """Put one of the actions that take no time, by chance, at the end of their list, where it is
    the next to end; those that were interrupted are dropped."""
    _, _, _, queue_tag, queue_robot, _, _ = calendar
    while numbers[QUEUE] > 0:
        last = numbers[QUEUE] - 1
        i = any_of_these(numbers[QUEUE], random)
        robot = queue_robot[i]
        tag = queue_tag[i]
        queue_robot[i] = queue_robot[last]
        queue_tag[i] = queue_tag[last]
        queue_robot[last] = robot
        queue_tag[last] = tag
        if due_tag[robot] == tag:
            break
        numbers[QUEUE] -= 1


def find_first(
    due_tag: Indices,
    visit_from: Indices,
    all_events: int,
    calendar: Calendar,
    clocks: Floats,
    numbers: Indices,
) -> None:
    """Find the next event: its time is ``clocks[NEXT]``, where it comes from ``numbers[SOURCE]``.

    Drop the first entries that no longer count: actions that were interrupted, and events of
    visits that are over.
    """
    _, _, heap, _, _, arrivals, _ = calendar
    heap_time, heap_tag, heap_robot = heap
    while numbers[HEAP] > 0 and due_tag[heap_robot[0]] != heap_tag[0]:
        drop_first(numbers[HEAP], heap)
        numbers[HEAP] -= 1
    time = math.inf
    source = HEAP_OF_ACTIONS
    if numbers[HEAP] > 0:
        time = heap_time[0]
    if numbers[QUEUE] > 0 and time > clocks[NOW]:
        time = clocks[NOW]
        source = QUEUE_OF_ACTIONS
    if clocks[ENVIRONMENT_AT] < time:
        time = clocks[ENVIRONMENT_AT]
        source = ENVIRONMENT
    if clocks[LOSS_AT] < time:
        time = clocks[LOSS_AT]
        source = LOSS_OF_ROBOT
    if numbers[ARRIVALS] > 0:
        arrival_time, arrival_tag, arrival_who = arrivals
        while numbers[ARRIVALS] > 0 and (
            arrival_tag[0] < visit_from[arrival_who[0] // (all_events + 1)]
        ):
            drop_first(numbers[ARRIVALS], arrivals)
            numbers[ARRIVALS] -= 1
        if numbers[ARRIVALS] > 0 and arrival_time[0] < time:
            time = arrival_time[0]
            source = INTERRUPTION
    clocks[NEXT] = time
    numbers[SOURCE] = source


def advance(stop: float, at_once: int, clocks: Floats, numbers: Indices) -> int:
    """Put the clock forward to the next event; returns GOING, or why that ends the loop."""
    time = clocks[NEXT]
    if time > stop:
        clocks[NOW] = stop
        return AT_STOP
    if time == math.inf:
        return STUCK
    numbers[TIMELESS_EVENTS] = numbers[TIMELESS_EVENTS] + 1 if time <= clocks[NOW] else 0
    if numbers[TIMELESS_EVENTS] > at_once:
        return TIMELESS
    clocks[NOW] = time
    numbers[EVENTS] += 1
    return GOING


def interruption(
    all_events: int,
    interrupts: InterruptArrays,
    at: Indices,
    visit_from: Indices,
    arrivals: Heap,
    held: Held,
    level: Indices,
    clocks: Floats,
    random: Indices,
    numbers: Indices,
) -> int:
    """The transition of the first event that interrupts a robot, which becomes the requester; -1:
    it cannot fire. Then it is held, if it is such an event."""
    _, event_transition, _, _, event_hold, event_test_from, event_tests = interrupts
    _, _, arrival_who = arrivals
    robot = arrival_who[0] // (all_events + 1)
    event = arrival_who[0] % (all_events + 1)
    drop_first(numbers[ARRIVALS], arrivals)
    numbers[ARRIVALS] -= 1
    if event == all_events:
        event = draw_event(
            robot, at[robot], all_events, interrupts, visit_from, arrivals, clocks, random, numbers
        )
    if fits(event, level, event_test_from, event_tests):
        numbers[REQUESTER] = robot
        numbers[INTERRUPTS] = 1
        return event_transition[event]
    if event_hold[event] > 0:
        hold(robot, visit_from[robot], event, held, numbers)
    return -1


def take_event(
    sizes: Indices,
    interrupts: InterruptArrays,
    changes: ChangeArrays,
    robots: Robots,
    active: Indices,
    calendar: Calendar,
    level: Indices,
    tree: Floats,
    clocks: Floats,
    random: Indices,
    numbers: Indices,
) -> int:
    """Let the next event happen; returns the transition that fires by it, -1 if none does."""
    at, _, _, _, due_tag, due_what, visit_from = robots
    pending_robot, pending_what, heap, _, queue_robot, arrivals, held = calendar
    source = numbers[SOURCE]
    if source in (HEAP_OF_ACTIONS, QUEUE_OF_ACTIONS):
        if source == HEAP_OF_ACTIONS:
            _, _, heap_robot = heap
            robot = heap_robot[0]
            drop_first(numbers[HEAP], heap)
            numbers[HEAP] -= 1
        else:
            numbers[QUEUE] -= 1
            robot = queue_robot[numbers[QUEUE]]
        due_tag[robot] = 0
        pending_robot[0] = robot
        pending_what[0] = due_what[robot]
        numbers[PENDING] = 1
    elif source == ENVIRONMENT:
        _, _, _, _, rates = changes
        transition, _, _ = rates
        numbers[ENVIRONMENT_DIRTY] = 1
        return transition[winner(tree, random)]
    elif source == LOSS_OF_ROBOT:
        numbers[LOST] = -1
        numbers[LOST_ROBOT] = active[int(draw_uniform(random) * numbers[ACTIVE])]
    else:
        return interruption(
            sizes[ALL_EVENTS],
            interrupts,
            at,
            visit_from,
            arrivals,
            held,
            level,
            clocks,
            random,
            numbers,
        )
    return -1


# -- the loops -------------------------------------------------------------------------------------


def until_holds(
    until: Until, level: Indices, label: float, stack: Floats, numbers: Indices
) -> bool:
    """Whether the condition that ends the run, if there is one, holds now."""
    operations, arguments = until
    numbers[CHECK_UNTIL] = 0
    end = len(operations)
    return end > 0 and value_of(0, end, operations, arguments, level, label, stack) != 0.0


def next_ready(
    net: NetArrays, chance: Chance, level: Indices, random: Indices, numbers: Indices
) -> int:
    """The transition that fires now because chance alone decides on it; -1 if there is none."""
    ready_ones, changed, is_changed, _ = chance
    while numbers[CHANGED] > 0:
        numbers[CHANGED] -= 1
        t = changed[numbers[CHANGED]]
        is_changed[t] = 0
        set_ready(t, net, level, ready_ones, numbers)
    if numbers[READY] > 0:
        return choose_ready(net, ready_ones, False, random, numbers)
    return -1


# In one piece: a call costs plain Python as much as many of the steps
def play(r: Any, b: Any, s: Any, stop: float, budget: int) -> int:
    """Play the token game until the clock reaches ``stop`` or this many events have happened;
    returns why.

    :param r: PlanArrays, or the same as plain tuples; ``b`` is a Book, ``s`` a PlanState.
    """
    sizes, net, visits, arcs, changes, moves, until, losses = r
    (
        numbers,
        clocks,
        random,
        counts,
        firings,
        robots,
        members,
        lists,
        marks,
        choices,
        calendar,
        chance,
        movers,
        targets,
        stack,
    ) = s
    _, _, _, interrupts = visits
    loss_rate, _, _ = losses
    level, _, _, _, _ = counts
    at, _, _, _, due_tag, _, visit_from = robots
    active, _, _ = members
    _, _, _, _, _, _, _, waits = lists
    (slots_left, _, _), _ = choices
    _, _, _, _, _, surplus = moves
    _, _, _, _, _, _, held = calendar
    _, _, _, tree = chance
    at_once = FIRINGS_PER_ENTRY + 100 * sizes[ROBOT_ROOM]
    enough = numbers[EVENTS] + budget
    status = GOING
    while status == GOING:
        if numbers[WITHOUT_VALUE] > 0:
            status = NO_VALUE
            break
        status = serve_pending(
            sizes, visits, arcs, robots, lists, marks, calendar, level, clocks, random, numbers
        )
        if status != GOING:
            break
        if numbers[CHECK_UNTIL] > 0 and until_holds(until, level, 0.0, stack, numbers):
            status = UNTIL
            break
        numbers[REQUESTER] = -1
        numbers[INTERRUPTS] = 0
        firing = -1
        if numbers[CHANGED] > 0 or numbers[READY] > 0:
            firing = next_ready(net, chance, level, random, numbers)
        if firing < 0 and numbers[DIRTY] > 0:
            firing = next_request(
                sizes, net, b, arcs, lists, marks, choices, level, random, numbers
            )
        if firing < 0 and numbers[HELD] > 0 and numbers[HELD_AT] != numbers[MARKING_VERSION]:
            firing = find_held(interrupts, held, visit_from, level, numbers)
        if firing < 0:
            if numbers[ACTIVE] > 0 and numbers[INACTIVES] == numbers[ACTIVE]:
                status = FINISHED
                break
            if numbers[GROWN] > 0:
                status = GROW
                break
            if numbers[EVENTS] >= enough:
                status = MORE
                break
            if numbers[QUEUE] > 0:
                draw_from_queue(due_tag, calendar, random, numbers)
            if numbers[ENVIRONMENT_DIRTY] > 0 or loss_rate[0] > 0.0:
                draw_others(loss_rate, tree, clocks, random, numbers)
            find_first(due_tag, visit_from, sizes[ALL_EVENTS], calendar, clocks, numbers)
            status = advance(stop, at_once, clocks, numbers)
            if status != GOING:
                break
            numbers[FIRED] = 0
            firing = take_event(
                sizes,
                interrupts,
                changes,
                robots,
                active,
                calendar,
                level,
                tree,
                clocks,
                random,
                numbers,
            )
            if numbers[SOURCE] == LOSS_OF_ROBOT:
                status = LOSS
        if firing >= 0:
            numbers[FIRED] += 1
            numbers[TIMELESS_EVENTS] += 1
            if numbers[FIRED] > FIRINGS_PER_ENTRY or numbers[TIMELESS_EVENTS] > at_once:
                status = TIMELESS
                break
            firings[firing] += 1
            numbers[FIRINGS] += 1
            if numbers[INTERRUPTS] > 0:
                count = 1
                interrupt(sizes[PLACE_COUNT], arcs, robots, lists, marks, movers, level, numbers)
            else:
                count = take_movers(
                    firing, sizes, net, arcs, at, lists, movers, level, random, numbers
                )
            change_counts(firing, net, changes, waits, marks, chance, counts, clocks, numbers)
            if surplus[firing] > 0:
                choose_targets(firing, count, moves, targets, slots_left, random)
            status = move(firing, count, moves, robots, members, calendar, movers, targets, numbers)
    if status in (AT_STOP, UNTIL, FINISHED, STOPPED):
        book_times(clocks[NOW], sizes[PLACE_COUNT], counts)
    return status


# -- the race of a net -----------------------------------------------------------------------------


class RaceArrays(NamedTuple):
    """A net as arrays."""

    sizes: Any
    """The number of places; 1 if the condition asks for deadlocks, otherwise 0."""
    net: Any
    effect_from: Any
    effects: Any
    touched_from: Any
    touched: Any
    rates: Any
    functions: Any
    until_reads: Any
    until: Any


class RaceState(NamedTuple):
    """A run of a net: everything that changes. ``tree`` has the rates of the exponential
    transitions."""

    numbers: Any
    clocks: Any
    random: Any
    counts: Any
    firings: Any
    ready_ones: Any
    tree: Any
    stack: Any


# In one piece: a call costs plain Python as much as many of the steps
def race(r: Any, s: Any, stop: float, budget: int) -> int:
    """Let the enabled transitions race until the clock reaches ``stop`` or this many have fired;
    returns why.

    :param r: RaceArrays, or the same as plain tuples; ``s`` is a RaceState.
    """
    (
        sizes,
        net,
        effect_from,
        effects,
        touched_from,
        touched,
        rates,
        functions,
        until_reads,
        until,
    ) = r
    of, _, read_from, read, _, _, _, _ = functions
    some_functions = len(of) > 0
    numbers, clocks, random, counts, firings, ready_ones, tree, stack = s
    _, _, immediate, _, _ = net
    level, _, _, _, _ = counts
    asks_deadlock = sizes[1]
    enough = numbers[EVENTS] + budget
    status = GOING
    while status == GOING:
        if numbers[WITHOUT_VALUE] > 0:
            status = NO_VALUE
            break
        if numbers[CHECK_UNTIL] > 0 or asks_deadlock > 0:
            deadlock = 1.0 if numbers[READY] == 0 and tree[1] <= 0.0 else 0.0
            if until_holds(until, level, deadlock, stack, numbers):
                status = UNTIL
                break
        if numbers[GROWN] > 0:
            status = GROW
            break
        if numbers[EVENTS] >= enough:
            status = MORE
            break
        fired = -1
        if numbers[READY] > 0:
            fired = choose_ready(net, ready_ones, True, random, numbers)
            if fired < 0:
                status = UNDECIDED
                break
            numbers[EVENTS] += 1
            numbers[TIMELESS_EVENTS] += 1
            if numbers[TIMELESS_EVENTS] > FIRINGS_PER_ENTRY:
                status = TIMELESS
                break
        else:
            clocks[NEXT] = time_of_race(clocks[NOW], tree, random)
            status = advance(stop, FIRINGS_PER_ENTRY, clocks, numbers)
            if status != GOING:
                break
            fired = winner(tree, random)
        firings[fired] += 1
        numbers[FIRINGS] += 1
        begin = effect_from[fired]
        end = effect_from[fired + 1]
        for k in range(begin, end, 2):
            place = effects[k]
            shift(place, effects[k + 1], clocks[NOW], counts, numbers)
            if until_reads[place] > 0:
                numbers[CHECK_UNTIL] = 1
            if some_functions:
                for j in range(read_from[place], read_from[place + 1]):
                    compute(read[j], functions, net, rates, level)
        for k in range(begin, end, 2):
            place = effects[k]
            for j in range(touched_from[place], touched_from[place + 1]):
                t = touched[j]
                if immediate[t] > 0:
                    set_ready(t, net, level, ready_ones, numbers)
                else:
                    set_rate(t, net, rates, level, tree, numbers)
    if status in (AT_STOP, UNTIL):
        book_times(clocks[NOW], sizes[0], counts)
    return status
