"""Exploration of the reachable markings with numpy alone, one frontier at a time.

One round takes the next states in order of discovery, tests every transition on all of them at
once, and looks the successors up in a hash table with open addressing, whose probing is vectorised
too: every key that finds an empty slot writes its candidate number there, reads the slot back, and
continues probing if another key won it.
"""

from __future__ import annotations

from typing import Callable, List, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Indices, Words
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

_MIX = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xFF51AFD7ED558CCD))
_SHIFT = np.uint64(32)
_EMPTY = -1

_SMALL_TABLE = 1 << 17
"""Tables of up to this many slots are at most a quarter full instead of half, which makes long
searches rarer."""

_BLOCK = 1 << 16
"""Number of states entered into a larger table at once; more would cost more memory than the time
saved is worth."""

_ROWS = 1 << 15
"""Largest number of states of one round."""


def explore(
    packed: PackedNet,
    limit: int,
    watch: Watch,
    rounds: Optional[int] = None,
    room: Allowance = ENDLESS,
    representative: Optional[Callable[[Words], Words]] = None,
) -> RawGraph:
    """The reachability graph of ``packed``.

    :param limit: the exploration ends when more than this many states are known.
    :param rounds: it also ends after this many rounds.
    :param room: it also ends when this is used up.
    :param representative: returns the representatives of packed markings, which are visited
        instead; None: each represents itself.
    :raises FieldOverflowError: the fields are too narrow.
    """
    transitions = len(packed.order)
    states = Growing(np.uint64, packed.words)
    states.extend(packed.initial[None, :])
    offsets = Growing(np.int64)
    offsets.extend(np.zeros(1, dtype=np.int64))
    targets = Growing(np.int32 if limit < 2**31 - 2**24 else np.int64)
    labels = Growing(label_type(transitions))
    table = StateTable(states)
    explored = 0
    rows = max(1, min(_ROWS, (1 << 20) // max(transitions, 1)))
    done = 0
    while explored < states.used <= limit and done != rounds:
        if not room.left(
            table.nbytes + sum(a.array.nbytes for a in (states, offsets, targets, labels))
        ):
            break
        done += 1
        block = states.array[explored : min(explored + rows, states.used)]
        sources, fired = enabled(packed, block)
        successors = fire(packed, block, sources, fired)
        if representative is not None:
            successors = representative(successors)
        targets.extend(table.insert(successors, states))
        labels.extend(fired)
        counts = np.bincount(sources, minlength=len(block))
        offsets.extend(np.cumsum(counts) + offsets.array[offsets.used - 1])
        explored += len(block)
        watch.step("states", states.used)
    found = states.used
    open_states = np.full(found - explored, offsets.array[offsets.used - 1], dtype=np.int64)
    offsets.extend(open_states)
    return RawGraph(
        states.finished(), offsets.finished(), targets.finished(), labels.finished(), explored
    )


def enabled(packed: PackedNet, block: Words) -> Tuple[Indices, Indices]:
    """Which transitions fire in which states: row numbers (ascending) and transitions in engine
    order."""
    size, transitions = len(block), len(packed.order)
    if size < 2048 and size * transitions < 1 << 16:
        mask = _mask_broadcast(packed, block)
    else:
        mask = _mask_by_transition(packed, block)
    begin = 0
    taken: Optional[Booleans] = None  # states in which a class of higher precedence is enabled
    for end in packed.class_ends[:-1].tolist():
        if taken is not None:
            mask[taken, begin:end] = False
        some = mask[:, begin:end].any(axis=1)
        taken = some if taken is None else taken | some
        begin = end
    if taken is not None and taken.any():
        mask[taken, begin:] = False
    found = np.flatnonzero(mask)
    if transitions == 0:
        return found, found
    sources = found // transitions
    return sources, found - sources * transitions


def fire(packed: PackedNet, block: Words, sources: Indices, fired: Indices) -> Words:
    """The states after the firings ``fired`` (in engine order) in ``block[sources]``.

    :raises FieldOverflowError: the fields are too narrow.
    """
    successors = block[sources]
    successors += packed.change[fired]
    overflow = np.bitwise_or.reduce(successors, axis=0) & packed.guard
    if overflow.any():
        raise FieldOverflowError(tuple(int(bits) for bits in overflow))
    return successors


def _mask_broadcast(packed: PackedNet, block: Words) -> Booleans:
    mask = np.ones((len(block), len(packed.order)), dtype=bool)
    for w in range(packed.words):
        column = block[:, w, None]
        guard = packed.need_guard[:, w]
        if guard.any():
            mask &= ((column | guard) - packed.need[:, w]) & guard == guard
        guard = packed.inhibit_guard[:, w]
        if guard.any():
            mask &= ((column | guard) - packed.inhibit[:, w]) & guard == 0
    return mask


def _mask_by_transition(packed: PackedNet, block: Words) -> Booleans:
    """The enabled transitions as a mask, transition by transition, reading only the words that each
    needs."""
    mask = np.empty((len(packed.order), len(block)), dtype=bool)
    columns = [np.ascontiguousarray(block[:, w]) for w in range(packed.words)]
    work = np.empty(len(block), dtype=np.uint64)
    for row in range(len(packed.order)):
        _concession(packed, row, columns, work, mask[row])
    return np.ascontiguousarray(mask.T)


def has_concession(packed: PackedNet, row: int, block: Words) -> Booleans:
    """The states in which the transition ``row`` (in engine order) would fire if no other had
    higher precedence."""
    columns = [np.ascontiguousarray(block[:, w]) for w in range(packed.words)]
    mask = np.empty(len(block), dtype=bool)
    _concession(packed, row, columns, np.empty(len(block), dtype=np.uint64), mask)
    return mask


def _concession(
    packed: PackedNet, row: int, columns: List[Words], work: Words, into: Booleans
) -> None:
    result: Optional[Booleans] = None
    for w in range(packed.words):
        for weights, guards, enabled in (
            (packed.need, packed.need_guard, True),
            (packed.inhibit, packed.inhibit_guard, False),
        ):
            guard = guards[row, w]
            if not guard:
                continue
            np.bitwise_or(columns[w], guard, out=work)
            np.subtract(work, weights[row, w], out=work)
            np.bitwise_and(work, guard, out=work)
            if result is None:
                result = np.equal(work, guard if enabled else np.uint64(0), out=into)
            else:
                result &= work == (guard if enabled else np.uint64(0))
    if result is None:
        into[:] = True


class StateTable:
    """A hash table from packed states to their numbers; at most half full.

    Each probe steps one slot further than the last. That still reaches every slot, and keeps long
    searches rare, which matters since all searches continue until the last one ends.
    """

    def __init__(self, states: Growing) -> None:
        self._rebuild(1 << 12, states)

    @property
    def nbytes(self) -> int:
        """Size in bytes."""
        return int(self._slots.nbytes)

    def insert(self, keys: Words, states: Growing) -> Indices:
        """The numbers of ``keys``; new ones are appended to ``states`` in order of appearance."""
        known = states.used
        self._make_room(known + len(keys), states)
        slots = self._slots
        mask = len(slots) - 1
        numbers: Indices = np.empty(len(keys), dtype=slots.dtype)
        at = hashed(keys) & mask
        open_keys: Indices = np.arange(len(keys), dtype=slots.dtype)
        # Copy the keys behind the states, where their candidate numbers point, so that the number
        # in a slot always leads to its key.
        states.reserve(known + len(keys))
        states.array[known : known + len(keys)] = keys
        pool = states.array
        fresh = []
        step = 0
        while len(open_keys):
            here = at[open_keys]
            seen = slots[here]
            empty = (seen == _EMPTY).nonzero()[0]
            if len(empty):
                # Candidates are numbered from ``known`` on. They are written backwards, because the
                # last of several writers to a slot wins: so states are numbered in order of
                # discovery, as in numba.
                candidates = open_keys[empty] + known
                slots[here[empty[::-1]]] = candidates[::-1]
                seen[empty] = slots[here[empty]]
                won = open_keys[empty[seen[empty] == candidates]]
                fresh.append(won)
            same = keys[open_keys, 0] == pool[seen, 0]
            for w in range(1, keys.shape[1]):
                same &= keys[open_keys, w] == pool[seen, w]
            numbers[open_keys[same]] = seen[same]
            open_keys = open_keys[~same]
            step += 1
            at[open_keys] = (at[open_keys] + step) & mask
        return self._number(numbers, keys, fresh, known, at, states)

    def _number(
        self,
        numbers: Indices,
        keys: Words,
        fresh: List[Indices],
        known: int,
        at: Indices,
        states: Growing,
    ) -> Indices:
        """Turn candidate numbers into state numbers."""
        if not fresh:
            return numbers
        winners = np.sort(np.concatenate(fresh))
        final = np.arange(known, known + len(winners), dtype=numbers.dtype)
        self._slots[at[winners]] = final
        state_of = np.empty(len(keys), dtype=numbers.dtype)
        state_of[winners] = final
        new = numbers >= known
        numbers[new] = state_of[numbers[new] - known]
        states.extend(keys[winners])
        return numbers

    def _make_room(self, count: int, states: Growing) -> None:
        capacity = len(self._slots)
        while capacity < (4 if capacity < _SMALL_TABLE else 2) * count:
            capacity *= 2
        if capacity > len(self._slots):
            self._rebuild(capacity, states)

    def _rebuild(self, capacity: int, states: Growing) -> None:
        self._slots = np.zeros(0, dtype=np.int32)  # the old entries are released first
        self._slots = np.full(capacity, _EMPTY, dtype=np.int32 if capacity < 2**31 else np.int64)
        mask = capacity - 1
        for begin in range(0, states.used, _BLOCK):
            keys = states.array[begin : min(begin + _BLOCK, states.used)]
            at = hashed(keys) & mask
            numbers = np.arange(begin, begin + len(keys), dtype=self._slots.dtype)
            open_keys = np.arange(len(keys))
            step = 0
            while len(open_keys):  # keys are distinct: on a collision, probe the next slot
                step += 1
                here = at[open_keys]
                free = self._slots[here] == _EMPTY
                self._slots[here[free]] = numbers[open_keys[free]]
                open_keys = open_keys[self._slots[here] != numbers[open_keys]]
                at[open_keys] = (at[open_keys] + step) & mask


def hashed(keys: Words) -> Indices:
    """The hash of each packed marking: int64, not negative."""
    value = keys[:, 0] * _MIX[0]
    for w in range(1, keys.shape[1]):
        value ^= value >> _SHIFT
        value += keys[:, w]
        value *= _MIX[1]
    value ^= value >> _SHIFT
    value *= _MIX[0]
    value ^= value >> _SHIFT
    return value.astype(np.int64) & np.int64(0x7FFFFFFFFFFFFFFF)
