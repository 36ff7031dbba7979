"""Exploration of the reachable markings, compiled by numba and cached: the fast engine, where numba is there.

States are taken in order of discovery, a block at a time. First the successors of the whole block are computed
and the hash table's slots for them touched, so that the memory of many slots is on its way at once; only then are
they looked up. That order, not the arithmetic, is what the speed comes from.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from gspn_framework_package.analysis.exploration import (
    FieldOverflowError,
    Growing,
    RawGraph,
    Watch,
    label_type,
)
from gspn_framework_package.analysis.packing import PackedNet

_MIX_1 = np.uint64(0x9E3779B97F4A7C15)
_MIX_2 = np.uint64(0xFF51AFD7ED558CCD)
_HALF = np.uint64(32)
_ZERO = np.uint64(0)
_ONE = np.uint64(1)
_LOW = np.uint64(0xFFFFFFFF)

_BLOCK = 32
"""States whose successors are in flight together."""

_FILL_BLOCK = 256
"""States that a new table takes up together."""

_STRIDE = 1 << 16
"""States between two looks at the limit, the room left and the watch."""


def explore(packed: PackedNet, limit: int, watch: Watch) -> RawGraph:
    """The reachability graph of ``packed``; same meaning as in ``numpy_engine``."""
    transitions = len(packed.order)
    states = Growing(np.uint64, packed.words)
    states.extend(packed.initial[None, :])
    offsets = Growing(np.int64)
    offsets.extend(np.zeros(1, dtype=np.int64))
    targets = Growing(np.int32 if limit < 2**31 - 2**24 else np.int64)
    labels = Growing(label_type(transitions))
    table = _new_table(states, 1 << 12)
    overflow = np.zeros(packed.words, dtype=np.uint64)
    advance = _advance_for(packed.words)
    explored = 0
    while explored < states.used <= limit:
        end = min(explored + _STRIDE, states.used)
        successors = (end - explored) * transitions
        room = max(states.used // 2, 1 << 10)  # new states that this round may bring
        if 2 * (states.used + room) > len(table):
            table = _new_table(states, 2 * len(table))
            continue
        states.reserve(states.used + room + _BLOCK * transitions)
        targets.reserve(targets.used + min(successors, 4 * room + _BLOCK * transitions))
        labels.reserve(len(targets.array))
        offsets.reserve(offsets.used + end - explored)
        explored, states.used, targets.used, _ = advance(
            explored,
            end,
            states.array,
            states.used,
            states.used + room,
            table,
            offsets.array,
            targets.array,
            labels.array,
            targets.used,
            packed.need,
            packed.need_guard,
            packed.inhibit,
            packed.inhibit_guard,
            packed.change,
            packed.class_ends,
            packed.guard,
            overflow,
        )
        labels.used = targets.used
        offsets.used = explored + 1
        if overflow.any():
            raise FieldOverflowError(tuple(int(bits) for bits in overflow))
        watch.step("states", states.used)
    rest = np.full(states.used - explored, offsets.array[explored], dtype=np.int64)
    offsets.extend(rest)
    return RawGraph(states.finished(), offsets.finished(), targets.finished(), labels.finished(), explored)


def _new_table(states: Growing, capacity: int) -> Any:
    """A table of ``capacity`` slots that knows ``states``. A slot holds the number of a state plus 1 in its low
    half, and half of the hash in its high half."""
    table = np.zeros(capacity, dtype=np.uint64)
    _fill(table, states.array, states.used)
    return table


@njit(cache=True, nogil=True)
def _hash(states: Any, row: int, words: int) -> Any:
    value = states[row, 0] * _MIX_1
    for w in range(1, words):
        value ^= value >> _HALF
        value += states[row, w]
        value *= _MIX_2
    value ^= value >> _HALF
    value *= _MIX_1
    value ^= value >> _HALF
    return value


@njit(cache=True, nogil=True)
def _fill(table: Any, states: Any, count: int) -> Any:
    mask = np.uint64(len(table) - 1)
    words = states.shape[1]
    hashes = np.empty(_FILL_BLOCK, np.uint64)
    touched = _ZERO
    for begin in range(0, count, _FILL_BLOCK):
        end = min(begin + _FILL_BLOCK, count)
        for s in range(begin, end):
            value = _hash(states, s, words)
            hashes[s - begin] = value
            touched ^= table[value & mask]
        for s in range(begin, end):
            value = hashes[s - begin]
            slot = value & mask
            while table[slot] != _ZERO:
                slot = (slot + _ONE) & mask
            table[slot] = (value & ~_LOW) | np.uint64(s + 1)
    return touched


@lru_cache(maxsize=None)
def _advance_for(words: int) -> Any:
    """The inner loop for markings of that many words: a constant, so that the compiler unrolls what depends on it."""

    @njit(cache=True, nogil=True)
    def advance(
        begin: Any,
        end: Any,
        states: Any,
        known: Any,
        most: Any,
        table: Any,
        offsets: Any,
        targets: Any,
        labels: Any,
        arcs: Any,
        need: Any,
        need_guard: Any,
        inhibit: Any,
        inhibit_guard: Any,
        change: Any,
        class_ends: Any,
        guard: Any,
        overflow: Any,
    ) -> Any:
        """Explore the states ``begin`` to ``end``, or fewer when the arrays are full; returns the first state not
        explored, the number of states known, the number of arcs, and what keeps the compiler from leaving the touching
        out."""
        transitions = need.shape[0]
        mask = np.uint64(len(table) - 1)
        batch = np.empty((_BLOCK * transitions, words), np.uint64)
        hashes = np.empty(_BLOCK * transitions, np.uint64)
        touched = _ZERO
        here = begin
        while here < end:
            stop = min(here + _BLOCK, end)
            if known > most or arcs + (stop - here) * transitions > len(targets):
                break
            n = 0
            for s in range(here, stop):
                first = 0
                for c in range(len(class_ends)):
                    before = n
                    for t in range(first, class_ends[c]):
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
                                overflow[w] |= batch[n, w] & guard[w]
                            value = _hash(batch, n, words)
                            hashes[n] = value
                            touched ^= table[value & mask]
                            labels[arcs + n] = t
                            n += 1
                    first = class_ends[c]
                    if n > before:
                        break
                offsets[s + 1] = arcs + n
            for w in range(words):
                if overflow[w] != _ZERO:
                    return here, known, arcs, touched
            for i in range(n):
                entry = table[hashes[i] & mask]
                if entry != _ZERO:
                    touched ^= states[np.int64(entry & _LOW) - 1, 0]
            for i in range(n):
                value = hashes[i]
                slot = value & mask
                high = value & ~_LOW
                while True:
                    entry = table[slot]
                    if entry == _ZERO:
                        for w in range(words):
                            states[known, w] = batch[i, w]
                        known += 1
                        table[slot] = high | np.uint64(known)
                        targets[arcs + i] = known - 1
                        break
                    if entry & ~_LOW == high:
                        number = np.int64(entry & _LOW) - 1
                        same = True
                        for w in range(words):
                            if states[number, w] != batch[i, w]:
                                same = False
                                break
                        if same:
                            targets[arcs + i] = number
                            break
                    slot = (slot + _ONE) & mask
            arcs += n
            here = stop
        return here, known, arcs, touched

    return advance
