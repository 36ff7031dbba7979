"""The loop that computes with decision diagrams: saturation, union and restriction.

A diagram is a set of markings. Its nodes are on levels, one for each place; level 1 is lowest. A
node of level ``k`` stands for a set of markings of the places of levels 1 to ``k``: the child at
``n`` for those with ``n`` tokens in the place of level ``k``. Node 0 is the empty set, and node 1,
the only one of level 0, the set of the one marking of no places. Equal sets are the same node.

A step has nodes as well (see :mod:`~gspn_framework_package.analysis.symbolic.steps`). A transition
whose highest place is that of level ``k`` is fired at the nodes of that level, and each node is
closed under the transitions at or below its level before it is used (saturation; Ciardo, Luettgen,
Siminiceanu 2001).

The recursion has its own stack, so that the loop can stop anywhere, for more room, to report
progress, or to let another order of the places have its turn, and go on later.

The functions run uncompiled on lists, or compiled by numba on arrays: see
:mod:`~gspn_framework_package.analysis.symbolic.machine`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

Numbers = Any
"""A list or an array of integers."""

NO_MARKING = 0
UNIT = 1
"""The set of the one marking of no places."""

IDENTITY = 0
"""The step that changes nothing."""


class NodeStore(NamedTuple):
    """The nodes, and the tables in which they are looked up.

    Node ``n`` has the children ``pool[start[n]:start[n + 1]]``, for ``low[n]`` tokens and more;
    neither the first nor the last of them is empty.
    """

    start: Numbers
    low: Numbers
    pool: Numbers
    table: Numbers
    fired: Numbers
    fired_to: Numbers
    joined: Numbers
    joined_to: Numbers


class StepArrays(NamedTuple):
    """The steps, by number: their level, what they add to the place of that level, whether the
    result is closed under the transitions, and their rows. A row is the part of the step for a
    number of tokens from ``least`` up to ``below``, with the step of the lower levels.

    ``top`` has, for each level, the rows of the transitions that are fired there: from
    ``top[level]`` to ``top[level + 1]``.
    """

    level: Numbers
    change: Numbers
    closing: Numbers
    rows: Numbers
    least: Numbers
    below: Numbers
    rest: Numbers
    top: Numbers
    top_least: Numbers
    top_below: Numbers
    top_change: Numbers
    top_rest: Numbers


# registers
NODES, USED, DEPTH, HEIGHT, RESULT, WORK, FORGOTTEN = range(7)
"""Numbers of nodes, of children, of frames, of values on the second stack; the last result; the
elementary operations so far; the number of stored results that others have replaced."""
REGISTERS = 7

# frames
MODE, FRAME_LEVEL, FIRST, SECOND, AT, FRAME_ROW, WAITS, BASE, LOW = range(9)
FRAME = 9
UNION, FIRE, SATURATE = range(3)
"""The modes of a frame: the union of the nodes FIRST and SECOND; the step FIRST taken from the node
SECOND; closing the set that is on the second stack from BASE on, whose first child is for LOW
tokens, under the transitions of its level."""

# outcomes
DONE, PAUSED, MORE_NODES, MORE_CHILDREN, MORE_FRAMES, MORE_VALUES = range(6)


def pair_hash(a: int, b: int) -> int:
    """A number of 40 bits for two of at most 31 bits."""
    value = (a * 2654435 + b) & 0xFFFFFFFFFF
    value ^= value >> 19
    value = (value * 3266489) & 0xFFFFFFFFFF
    return value ^ (value >> 17)


def recall(keys: Numbers, values: Numbers, a: int, b: int) -> int:
    """The result stored for (a, b); -1 if there is none (any more)."""
    slot = pair_hash(a, b) & (len(keys) - 1)
    if keys[slot] == (a << 32) + b:
        return values[slot]
    return -1


def remember(st: Numbers, keys: Numbers, values: Numbers, a: int, b: int, result: int) -> None:
    """Store a result, in place of an earlier one."""
    slot = pair_hash(a, b) & (len(keys) - 1)
    if keys[slot] != 0:
        st[FORGOTTEN] += 1
    keys[slot] = (a << 32) + b
    values[slot] = result


def node_hash(values: Numbers, begin: int, end: int, low: int) -> int:
    """The hash of a node with these children."""
    value = low
    for i in range(begin, end):
        value = ((value + values[i]) * 2654435 + 1) & 0xFFFFFFFFFF
        value ^= value >> 19
    value = (value * 3266489) & 0xFFFFFFFFFF
    return value ^ (value >> 17)


def enter_node(store: NodeStore, node: int) -> None:
    """Enter a new node into the table."""
    mask = len(store.table) - 1
    start = store.start
    slot = node_hash(store.pool, start[node], start[node + 1], store.low[node]) & mask
    while store.table[slot] != 0:
        slot = (slot + 1) & mask
    store.table[slot] = node


def enter_nodes(store: NodeStore, nodes: int) -> None:
    """Enter the first ``nodes`` nodes into an empty table."""
    for node in range(2, nodes):
        enter_node(store, node)


def node_of(store: NodeStore, st: Numbers, vec: Numbers, begin: int, end: int, low: int) -> int:
    """The node with these children; it is made if there is none yet."""
    while begin < end and vec[end - 1] == NO_MARKING:
        end -= 1
    while begin < end and vec[begin] == NO_MARKING:
        begin += 1
        low += 1
    if begin == end:
        return NO_MARKING
    start, pool, table = store.start, store.pool, store.table
    mask = len(table) - 1
    slot = node_hash(vec, begin, end, low) & mask
    size = end - begin
    while table[slot] != 0:
        node = table[slot]
        first = start[node]
        if store.low[node] == low and start[node + 1] - first == size:
            same = True
            for i in range(size):
                if pool[first + i] != vec[begin + i]:
                    same = False
                    break
            if same:
                return node
        slot = (slot + 1) & mask
    node = st[NODES]
    first = st[USED]
    for i in range(size):
        pool[first + i] = vec[begin + i]
    store.low[node] = low
    start[node + 1] = first + size
    table[slot] = node
    st[NODES] = node + 1
    st[USED] = first + size
    return node


def joined(store: NodeStore, a: int, b: int) -> int:
    """The union of two nodes, if it is known; else -1."""
    if a == b or b == NO_MARKING:
        return a
    if a == NO_MARKING:
        return b
    return recall(store.joined, store.joined_to, min(a, b), max(a, b))


def fired(store: NodeStore, step: int, node: int) -> int:
    """The set after a step, if it is known; else -1."""
    if step == IDENTITY or node == NO_MARKING:
        return node
    return recall(store.fired, store.fired_to, step, node)


def push_frame(
    st: Numbers, stack: Numbers, mode: int, level: int, first: int, second: int, at: int
) -> int:
    """Put a frame on the stack; returns where it begins."""
    f = st[DEPTH] * FRAME
    stack[f + MODE] = mode
    stack[f + FRAME_LEVEL] = level
    stack[f + FIRST] = first
    stack[f + SECOND] = second
    stack[f + AT] = at
    stack[f + WAITS] = 0
    stack[f + BASE] = st[HEIGHT]
    st[DEPTH] += 1
    return f


def push_union(st: Numbers, stack: Numbers, store: NodeStore, level: int, a: int, b: int) -> None:
    """Begin the union of two nodes."""
    push_frame(st, stack, UNION, level, min(a, b), max(a, b), min(store.low[a], store.low[b]))


def push_fire(
    st: Numbers,
    stack: Numbers,
    store: NodeStore,
    steps: StepArrays,
    level: int,
    step: int,
    node: int,
) -> None:
    """Begin a step from a node."""
    f = push_frame(st, stack, FIRE, level, step, node, store.low[node])
    stack[f + FRAME_ROW] = steps.rows[step]


def push_saturate(
    st: Numbers, stack: Numbers, level: int, base: int, low: int, step: int, node: int
) -> None:
    """Begin to close the set that is on the second stack from ``base`` on: the result of a step
    from a node, which is stored; -1: of none."""
    f = push_frame(st, stack, SATURATE, level, step, node, 0)
    stack[f + FRAME_ROW] = -1
    stack[f + BASE] = base
    stack[f + LOW] = low


def pop(st: Numbers, base: int, result: int) -> None:
    """End the work of the frame on top."""
    st[RESULT] = result
    st[HEIGHT] = base
    st[DEPTH] -= 1


def go_on_with_union(store: NodeStore, st: Numbers, stack: Numbers, vec: Numbers, f: int) -> int:
    """Continue a union until it needs another one or is done."""
    start, low, pool = store.start, store.low, store.pool
    a, b = stack[f + FIRST], stack[f + SECOND]
    low_a, low_b = low[a], low[b]
    end_a, end_b = low_a + start[a + 1] - start[a], low_b + start[b + 1] - start[b]
    first, end = min(low_a, low_b), max(end_a, end_b)
    base, at, height = stack[f + BASE], stack[f + AT], st[HEIGHT]
    if base + end - first > len(vec):
        return MORE_VALUES
    if st[USED] + end - first > len(pool):
        return MORE_CHILDREN
    if stack[f + WAITS]:
        stack[f + WAITS] = 0
        vec[height] = st[RESULT]
        height += 1
        at += 1
    while at < end:
        x = pool[start[a] + at - low_a] if low_a <= at < end_a else NO_MARKING
        y = pool[start[b] + at - low_b] if low_b <= at < end_b else NO_MARKING
        found = joined(store, x, y)
        if found < 0:
            stack[f + AT] = at
            stack[f + WAITS] = 1
            st[HEIGHT] = height
            push_union(st, stack, store, stack[f + FRAME_LEVEL] - 1, x, y)
            return DONE
        vec[height] = found
        height += 1
        at += 1
    node = node_of(store, st, vec, base, height, first)
    remember(st, store.joined, store.joined_to, a, b, node)
    pop(st, base, node)
    return DONE


def go_on_with_fire(
    store: NodeStore,
    steps: StepArrays,
    st: Numbers,
    stack: Numbers,
    vec: Numbers,
    dirty: Numbers,
    f: int,
) -> int:
    """Continue a step until it needs a step from a lower node, its result has to be closed, or it
    is done."""
    step, node, level = stack[f + FIRST], stack[f + SECOND], stack[f + FRAME_LEVEL]
    begin, first = store.start[node], store.low[node]
    end = first + store.start[node + 1] - begin
    base, at, row, height = stack[f + BASE], stack[f + AT], stack[f + FRAME_ROW], st[HEIGHT]
    if base + end - first > len(vec):
        return MORE_VALUES
    if st[USED] + end - first > len(store.pool):
        return MORE_CHILDREN
    if stack[f + WAITS]:
        stack[f + WAITS] = 0
        vec[height] = st[RESULT]
        height += 1
        at += 1
    here = steps.level[step] == level
    last = steps.rows[step + 1]
    while at < end:
        rest = step
        child = store.pool[begin + at - first]
        if here:
            while row < last and steps.below[row] <= at:
                row += 1
            if row < last and steps.least[row] <= at:
                rest = steps.rest[row]
            else:
                child = NO_MARKING
        found = fired(store, rest, child)
        if found < 0:
            stack[f + AT] = at
            stack[f + FRAME_ROW] = row
            stack[f + WAITS] = 1
            st[HEIGHT] = height
            push_fire(st, stack, store, steps, level - 1, rest, child)
            return DONE
        vec[height] = found
        height += 1
        at += 1
    if here:
        first += steps.change[step]
    if steps.closing[step] and steps.top[level] < steps.top[level + 1]:
        for i in range(base, height):
            dirty[i] = 1 if vec[i] != NO_MARKING else 0
        st[HEIGHT] = height
        st[DEPTH] -= 1
        push_saturate(st, stack, level, base, first, step, node)
        return DONE
    result = node_of(store, st, vec, base, height, first)
    remember(st, store.fired, store.fired_to, step, node, result)
    pop(st, base, result)
    return DONE


def go_on_with_saturate(
    store: NodeStore,
    steps: StepArrays,
    st: Numbers,
    stack: Numbers,
    vec: Numbers,
    dirty: Numbers,
    f: int,
) -> int:
    """Continue closing a set until a lower node is needed, or it is closed.

    A frame waits for the set after a row (1), or for its union with the child that it goes to (2).
    """
    level, base = stack[f + FRAME_LEVEL], stack[f + BASE]
    if st[USED] + st[HEIGHT] - base > len(store.pool):
        return MORE_CHILDREN
    found, waits = st[RESULT], stack[f + WAITS]
    while True:
        if waits == 0:
            if not next_row(steps, stack, dirty, f, level, base, st[HEIGHT] - base):
                break
            rest, child = steps.top_rest[stack[f + FRAME_ROW]], vec[base + stack[f + AT]]
            found = fired(store, rest, child)
            waits = 1
            if found < 0:
                stack[f + WAITS] = 1
                push_fire(st, stack, store, steps, level - 1, rest, child)
                return DONE
        change = steps.top_change[stack[f + FRAME_ROW]]
        if waits == 1 and found != NO_MARKING:
            if not stretch(st, stack, vec, dirty, f, stack[f + AT] + change):
                stack[f + WAITS] = 1
                st[RESULT] = found
                return MORE_VALUES
            old = vec[base + stack[f + AT] + change]
            union = joined(store, old, found)
            if union < 0:
                stack[f + WAITS] = 2
                push_union(st, stack, store, level - 1, old, found)
                return DONE
            found = union
        to = base + stack[f + AT] + change
        if found != NO_MARKING and found != vec[to]:
            vec[to] = found
            dirty[to] = 1
        stack[f + FRAME_ROW] += 1
        waits = 0
    stack[f + WAITS] = 0
    if st[USED] + st[HEIGHT] - base > len(store.pool):
        return MORE_CHILDREN
    node = node_of(store, st, vec, base, st[HEIGHT], stack[f + LOW])
    if stack[f + FIRST] >= 0:
        remember(st, store.fired, store.fired_to, stack[f + FIRST], stack[f + SECOND], node)
    pop(st, base, node)
    return DONE


def next_row(
    steps: StepArrays, stack: Numbers, dirty: Numbers, f: int, level: int, base: int, size: int
) -> bool:
    """Find the next row to take from a child that has changed since; returns whether there is
    one."""
    at, row, last = stack[f + AT], stack[f + FRAME_ROW], steps.top[level + 1]
    while True:
        if row < 0 or row >= last:
            if row >= last:
                at += 1
            left = size
            while left > 0 and (at >= size or dirty[base + at] == 0):
                at = at + 1 if at < size else 0
                left -= 1
            if at >= size or dirty[base + at] == 0:
                stack[f + FRAME_ROW] = -1
                return False
            dirty[base + at] = 0
            row = steps.top[level]
        tokens = stack[f + LOW] + at
        while row < last and not (steps.top_least[row] <= tokens < steps.top_below[row]):
            row += 1
        if row < last:
            stack[f + AT] = at
            stack[f + FRAME_ROW] = row
            return True


def stretch(st: Numbers, stack: Numbers, vec: Numbers, dirty: Numbers, f: int, to: int) -> bool:
    """Make the set that a frame closes long enough for a child at ``to``; returns whether there was
    room."""
    base, height = stack[f + BASE], st[HEIGHT]
    below, above = max(-to, 0), max(to - (height - base) + 1, 0)
    if below == 0 and above == 0:
        return True
    if height + below + above > len(vec):
        return False
    if below > 0:
        for i in range(height - 1, base - 1, -1):
            vec[i + below] = vec[i]
            dirty[i + below] = dirty[i]
        stack[f + LOW] -= below
        stack[f + AT] += below
    height += below + above
    for i in range(base, base + below):
        vec[i] = NO_MARKING
        dirty[i] = 0
    for i in range(height - above, height):
        vec[i] = NO_MARKING
        dirty[i] = 0
    st[HEIGHT] = height
    return True


def run(
    store: NodeStore,
    steps: StepArrays,
    st: Numbers,
    stack: Numbers,
    vec: Numbers,
    dirty: Numbers,
    turns: int,
) -> int:
    """Work off the stack, for at most ``turns`` visits of a frame."""
    while st[DEPTH] > 0:
        if turns == 0:
            return PAUSED
        if st[NODES] + 2 > len(store.low) or 2 * st[NODES] > len(store.table):
            return MORE_NODES
        if (st[DEPTH] + 2) * FRAME > len(stack):
            return MORE_FRAMES
        turns -= 1
        st[WORK] += 1
        f = (st[DEPTH] - 1) * FRAME
        if stack[f + MODE] == UNION:
            outcome = go_on_with_union(store, st, stack, vec, f)
        elif stack[f + MODE] == FIRE:
            outcome = go_on_with_fire(store, steps, st, stack, vec, dirty, f)
        else:
            outcome = go_on_with_saturate(store, steps, st, stack, vec, dirty, f)
        if outcome != DONE:
            return outcome
    return DONE
