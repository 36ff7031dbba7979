"""Exploration of the reachable markings, compiled by numba and cached: the fast engine, if numba is
installed.

States are taken in order of discovery, in rounds. First every core expands its share of the round:
it computes the successors, and looks them up in a hash table that does not change meanwhile. Most
successors are known; the others are then entered sequentially in the order of their arcs. So the
numbering does not depend on the number of cores, and no locks are needed.

Within a share, the engine computes the successors of a block of states and touches their slots in
the table, so that many memory accesses are in flight at once; only then does it look them up. The
speed of a core comes from this order, not from the arithmetic.

The number of cores is that of the machine, or the environment variable ``NUMBA_NUM_THREADS``.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any, List, NamedTuple, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Indices, Words
from gspn_framework_package.analysis.machine_code import KeptCode
from gspn_framework_package.analysis.state_space.exploration import (
    ENDLESS,
    Allowance,
    FieldOverflowError,
    Growing,
    RawGraph,
    label_type,
)
from gspn_framework_package.analysis.state_space.packing import PackedNet
from gspn_framework_package.analysis.watch import Watch

_Width = Tuple[int, ...]
"""A tuple with an element for each word of a marking. Its length is a part of its type: the
compiler unrolls the loops over it, and keeps the machine code of each length on the disk."""

_MIX_1 = np.uint64(0x9E3779B97F4A7C15)
_MIX_2 = np.uint64(0xFF51AFD7ED558CCD)
_HALF = np.uint64(32)
_ZERO = np.uint64(0)
_ONE = np.uint64(1)
_LOW = np.uint64(0xFFFFFFFF)

_BLOCK = 32
"""Number of states, or of pending entries, whose memory accesses are in flight together."""

_LINE = 16
"""Number of words that no two cores write at the same time, at least a cache line."""

_SHARE = 8192
"""Largest number of states of a round that one core expands; a smaller round uses a single core."""

_SHARE_ARCS = 1 << 17
"""Largest number of arcs that the buffers of a share hold (except in nets of very many
transitions)."""

_NARROW = 512
"""Rounds of fewer states run consecutively inside compiled code, since calling it takes longer than
such a round."""

_STRIDE = 1 << 18
"""Number of new states between two checks of the watch inside compiled code."""

_CORES = 8
"""More cores do not help, since entering waits for all of them, and they wait for it."""


def explore(
    packed: PackedNet,
    limit: int,
    watch: Watch,
    cores: int = 0,
    room: Allowance = ENDLESS,
    begun: Optional[RawGraph] = None,
) -> RawGraph:
    """The reachability graph of ``packed``; the parameters are those of ``numpy_engine``.

    :param cores: number of cores, at most 8; 0: as many as there are.
    :param room: the exploration ends when it is used up.
    :param begun: a part of the graph, which ``numpy_engine`` found: it numbers states alike.
    """
    transitions = len(packed.order)
    wanted = os.environ.get("NUMBA_NUM_THREADS", "")  # numba ignores other texts
    cores = cores or int(wanted if wanted.isdigit() else 0) or len(os.sched_getaffinity(0))
    cores = min(cores, _CORES)
    share = max(_BLOCK, min(_SHARE, _SHARE_ARCS // max(transitions, 1)))
    narrow = min(_NARROW, share)
    known = packed.initial[None, :] if begun is None or begun.states is None else begun.states
    graph = states, offsets, targets, labels = _Graph(
        Growing(np.uint64, packed.words),
        Growing(np.int64),
        Growing(np.int32 if limit < 2**31 - 2**24 else np.int64),
        Growing(label_type(transitions)),
    )
    states.reserve(len(known))
    offsets.extend(np.zeros(1, dtype=np.int64))
    table = _with_room(np.zeros(1 << 12, dtype=np.uint64), len(known))
    width = (0,) * packed.words
    no_arcs = np.zeros(0, np.int64)
    rules = _Rules(*(getattr(packed, name) for name in _Rules._fields))
    buffers = [_new_buffers(share, transitions, packed.words, targets, labels)]
    hashes = buffers[0].hashes
    states.used = _enter(width, table, states.array, 0, known, no_arcs, targets.array, hashes)
    explored = 0
    if begun is not None:
        explored = begun.explored
        offsets.extend(begun.offsets[1 : explored + 1])
        targets.extend(begun.targets)
        labels.extend(begun.labels)
    with ThreadPoolExecutor(max(cores - 1, 1), thread_name_prefix="explore") as others:
        while explored < states.used <= limit:
            if not room.left(table.nbytes + sum(part.array.nbytes for part in graph)):
                break
            if states.used - explored < narrow:
                explored = _go_narrow(rules, explored, limit, table, graph, buffers[0])
                table = _with_room(table, states.used + narrow * transitions)
                watch.step("states", states.used)
                continue
            end = min(explored + share * cores, states.used)
            bounds = _shares(explored, end, -(-(end - explored) // share))
            while len(buffers) < len(bounds):
                buffers.append(_new_buffers(share, transitions, packed.words, targets, labels))
            work: List[Tuple[Any, ...]] = [
                (width, rules, states.array, table, part, buffer, 0)
                for part, buffer in zip(bounds, buffers)
            ]
            running = [others.submit(_expand, *arguments) for arguments in work[1:]]
            done = [_expand(*work[0])] + [future.result() for future in running]
            _check_overflow(buffers)
            table = _append(graph, table, list(zip(done, bounds, buffers)))
            explored = end
            watch.step("states", states.used)
    rest = np.full(states.used - explored, targets.used, dtype=np.int64)
    offsets.extend(rest)
    return RawGraph(
        states.finished(), offsets.finished(), targets.finished(), labels.finished(), explored
    )


class _Graph(NamedTuple):
    """The parts of a :class:`RawGraph` while they grow."""

    states: Growing
    offsets: Growing
    targets: Growing
    labels: Growing


class _Rules(NamedTuple):
    """The parts of a packed net that the compiled code reads."""

    first_word: Indices
    first_need: Words
    first_guard: Words
    need: Words
    need_guard: Words
    inhibit: Words
    inhibit_guard: Words
    change: Words
    class_ends: Indices
    guard: Words


class _Buffers(NamedTuple):
    """The results of one core for its share: targets (-1: unknown so far) and labels of the arcs,
    and the end of each state's arcs; for arcs with unknown targets, their numbers and the packed
    markings they lead to. ``batch``, ``hashes`` and ``hit`` are for the work on a block."""

    targets: Indices
    labels: Indices
    ends: Indices
    keys: Words
    arcs: Indices
    overflow: Words
    batch: Words
    hashes: Words
    hit: Words


def _new_buffers(
    states: int, transitions: int, words: int, targets: Growing, labels: Growing
) -> _Buffers:
    room = states * transitions
    return _Buffers(
        np.empty(room, dtype=targets.array.dtype),
        np.empty(room, dtype=labels.array.dtype),
        np.empty(states, dtype=np.int64),
        np.empty((room, words), dtype=np.uint64),
        np.empty(room, dtype=np.int64),
        np.zeros(words, dtype=np.uint64),
        np.empty((_BLOCK * transitions, words), dtype=np.uint64),
        np.empty(_BLOCK * max(transitions, 1), dtype=np.uint64),
        # far from another core's, which would slow both down in the same cache line
        np.zeros(words + 2 * _LINE, dtype=np.uint64)[_LINE : _LINE + words],
    )


def _shares(begin: int, end: int, cores: int) -> List[Tuple[int, int]]:
    """The ranges of states that divide a round among the cores."""
    cuts = [begin + (end - begin) * core // cores for core in range(cores + 1)]
    return list(zip(cuts, cuts[1:]))


def _append(
    graph: _Graph,
    table: Words,
    shares: List[Tuple[Tuple[int, int, np.uint64], Tuple[int, int], _Buffers]],
) -> Words:
    """Append what each share found (what ``_expand`` returned, the range of its states, and its
    buffers); returns the table."""
    states, offsets, targets, labels = graph
    new = sum(misses for (_, misses, _), _, _ in shares)
    states.reserve(states.used + new)
    table = _with_room(table, states.used + new)
    offsets.reserve(offsets.used + sum(stop - begin for _, (begin, stop), _ in shares))
    for (arcs, misses, _), (begin, stop), buffer in shares:
        base = targets.used
        targets.extend(buffer.targets[:arcs])
        labels.extend(buffer.labels[:arcs])
        offsets.extend(buffer.ends[: stop - begin] + base)
        states.used = _enter(
            (0,) * states.array.shape[1],
            table,
            states.array,
            states.used,
            buffer.keys[:misses],
            buffer.arcs[:misses],
            targets.array[base:],
            shares[0][2].hashes,
        )
    return table


def _check_overflow(buffers: List[_Buffers]) -> None:
    overflow = np.bitwise_or.reduce([buffer.overflow for buffer in buffers])
    if overflow.any():
        raise FieldOverflowError(tuple(int(bits) for bits in overflow))


def _go_narrow(
    rules: _Rules,
    explored: int,
    limit: int,
    table: Words,
    graph: _Graph,
    buffer: _Buffers,
) -> int:
    """Run rounds of few states until they grow or the room is used up; returns the first unexplored
    state."""
    states, offsets, targets, labels = graph
    room = _NARROW * max(len(rules.need), 1)
    states.reserve(states.used + 2 * room)
    targets.reserve(targets.used + 2 * room)
    labels.reserve(len(targets.array))
    offsets.reserve(len(states.array) + 1)
    most = min(limit, len(states.array) - room, states.used + _STRIDE)
    explored, states.used, targets.used = _narrow(
        (0,) * len(rules.guard),
        rules,
        explored,
        states.used,
        most,
        min(_NARROW, len(buffer.ends)),
        states.array,
        table,
        offsets.array,
        buffer._replace(targets=targets.array, labels=labels.array),
        targets.used,
    )
    labels.used, offsets.used = targets.used, explored + 1
    _check_overflow([buffer])
    return int(explored)


# -- the hash table --------------------------------------------------------------------------------
#
# The low half of a slot holds the number of a state plus 1, the high half the high half of its
# hash. A search begins at the slot given by the top bits of the hash. So the entries are nearly
# sorted, and a table of twice the size is filled from one end to the other without reading the
# states.


def _with_room(table: Words, states: int) -> Words:
    """The table, or a larger one with the same entries, such that this many states fill at most
    half of it."""
    while 2 * states > len(table):
        larger = np.empty(2 * len(table), dtype=np.uint64)  # in huge pages, unlike zeros
        larger.fill(0)
        _refill(table, larger)
        table = larger
    return table


@KeptCode
def _shift(table: Words) -> np.uint64:
    """The number of bits to shift a hash right to get its first slot."""
    shift = np.uint64(64)
    size = len(table)
    while size > 1:
        size >>= 1
        shift -= _ONE
    return shift


@KeptCode
def _refill(table: Words, larger: Words) -> None:
    shift, mask = _shift(larger), np.uint64(len(larger) - 1)
    for i in range(len(table)):
        entry = table[i]
        if entry != _ZERO:
            slot = entry >> shift
            while larger[slot] != _ZERO:
                slot = (slot + _ONE) & mask
            larger[slot] = entry


@KeptCode
def _hash(keys: Words, row: int, words: int) -> np.uint64:
    value = keys[row, 0] * _MIX_1
    for w in range(1, words):
        value ^= value >> _HALF
        value += keys[row, w]
        value *= _MIX_2
    value ^= value >> _HALF
    value *= _MIX_1
    return value


@KeptCode
def _find(
    width: _Width,
    table: Words,
    states: Words,
    keys: Words,
    row: int,
    value: np.uint64,
    shift: np.uint64,
) -> Tuple[np.uint64, np.int64]:
    """Look a row of ``keys`` with this hash up; returns its slot and the number of the state, or a
    free slot and -1."""
    mask = np.uint64(len(table) - 1)
    slot = value >> shift
    high = value & ~_LOW
    while True:
        entry = table[slot]
        if entry == _ZERO:
            return slot, np.int64(-1)
        if entry & ~_LOW == high:
            number = np.int64(entry & _LOW) - 1
            same = True
            for w in range(len(width)):
                if states[number, w] != keys[row, w]:
                    same = False
                    break
            if same:
                return slot, number
        slot = (slot + _ONE) & mask


@KeptCode
def _enter(
    width: _Width,
    table: Words,
    states: Words,
    known: np.integer[Any],
    keys: Words,
    arcs: Indices,
    targets: Indices,
    hashes: Words,
) -> np.integer[Any]:
    """Number the states ``keys`` that are not known yet, from ``known`` on, and store the targets
    of ``arcs``; returns the number of states then known. The keys are entered even if there are no
    arcs. A block is as long as ``hashes``, where it works."""
    words, block = len(width), len(hashes)
    shift = _shift(table)
    for begin in range(0, len(keys), block):
        stop = min(begin + block, len(keys))
        for i in range(begin, stop):
            hashes[i - begin] = _hash(keys, i, words)
        for i in range(begin, stop):
            value = hashes[i - begin]
            slot, number = _find(width, table, states, keys, i, value, shift)
            if number < 0:
                for w in range(words):
                    states[known, w] = keys[i, w]
                number = known
                known += 1
                table[slot] = (value & ~_LOW) | np.uint64(known)
            if len(arcs):
                targets[arcs[i]] = number
    return known


# In one piece: a function called for each transition would cost as much as the test itself
@KeptCode
def _expand(
    width: _Width,
    rules: _Rules,
    states: Words,
    table: Words,
    share: Tuple[int, int],
    found: _Buffers,
    arcs: int,
) -> Tuple[int, int, np.uint64]:
    """Expand the states from the first of ``share`` up to the second; the results go into
    ``found``, which has the targets and labels of ``arcs`` arcs already.

    Returns the number of arcs, the number of arcs that lead to markings not known yet, and a value
    that keeps the compiler from removing the touching.
    """
    words = len(width)
    first_word, first_need, first_guard = rules[:3]
    need, need_guard, inhibit, inhibit_guard, change, class_ends, guard = rules[3:]
    targets, labels, ends, keys, key_arcs, overflow, batch, hashes, hit = found
    begin, end = share
    # what it writes fits, whatever _BLOCK was when this was compiled
    block = len(hashes) // max(need.shape[0], 1)
    shift = _shift(table)
    for w in range(words):
        hit[w] = _ZERO
    touched = _ZERO
    misses = 0
    for here in range(begin, end, block):
        n = 0
        for s in range(here, min(here + block, end)):
            first = 0
            for c in range(len(class_ends)):
                before = n
                for t in range(first, class_ends[c]):
                    g = first_guard[t]
                    if ((states[s, first_word[t]] | g) - first_need[t]) & g != g:
                        continue  # as most do in a large net
                    enabled = True
                    for w in range(words):
                        word = states[s, w]
                        g = need_guard[t, w]
                        if ((word | g) - need[t, w]) & g != g:
                            enabled = False
                            break
                        g = inhibit_guard[t, w]
                        if ((word | g) - inhibit[t, w]) & g != _ZERO:
                            enabled = False
                            break
                    if enabled:
                        for w in range(words):
                            batch[n, w] = states[s, w] + change[t, w]
                            hit[w] |= batch[n, w] & guard[w]
                        hashes[n] = _hash(batch, n, words)
                        labels[arcs + n] = t
                        n += 1
                first = class_ends[c]
                if n > before:
                    break
            ends[s - begin] = arcs + n
        for w in range(words):
            if hit[w] != _ZERO:
                for v in range(words):
                    overflow[v] = hit[v]
                return arcs, misses, touched
        # such a short loop has more accesses in flight than one that computes, too
        for i in range(n):
            touched ^= table[hashes[i] >> shift]
        for i in range(n):
            entry = table[hashes[i] >> shift]
            if entry != _ZERO:
                number = np.int64(entry & _LOW) - 1
                touched ^= states[number, 0] ^ states[number, words - 1]
        for i in range(n):
            _, number = _find(width, table, states, batch, i, hashes[i], shift)
            targets[arcs + i] = number
            if number < 0:
                for w in range(words):
                    keys[misses, w] = batch[i, w]
                key_arcs[misses] = arcs + i
                misses += 1
        arcs += n
    return arcs, misses, touched


@KeptCode
def _narrow(
    width: _Width,
    rules: _Rules,
    explored: int,
    known: int,
    most: int,
    few: int,
    states: Words,
    table: Words,
    offsets: Indices,
    found: _Buffers,
    arcs: int,
) -> Tuple[int, int, int]:
    """Continue while fewer than ``few`` states are waiting, at most ``most`` are known, and there
    is room for their successors. ``found`` holds all targets and labels, ``arcs`` of them at the
    start.

    Returns the first unexplored state, the number of known states, and the number of arcs.
    """
    while explored < known <= most and known - explored < few:
        new = (known - explored) * rules.need.shape[0]
        if 2 * (known + new) > len(table) or arcs + new > len(found.targets):
            break
        more, misses, _ = _expand(width, rules, states, table, (explored, known), found, arcs)
        over = _ZERO
        for w in range(len(width)):
            over |= found.overflow[w]
        if over != _ZERO:
            break
        for s in range(explored, known):
            offsets[s + 1] = found.ends[s - explored]
        more_known = _enter(
            width,
            table,
            states,
            known,
            found.keys[:misses],
            found.arcs[:misses],
            found.targets,
            found.hashes,
        )
        explored, known, arcs = known, more_known, more
    return explored, known, arcs
