"""Exploration of the reachable markings of nets of thousands of places, one marking at a time.

A marking is kept as its differences from the initial one. Its enabled transitions are derived from
those of its predecessor, by checking only the transitions around the places that the firing
changed. So the cost of a firing depends on what it changes, not on the size of the net.
"""

from __future__ import annotations

from array import array
from itertools import chain
from typing import Dict, Iterable, List, Optional, Sequence, Set, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Indices
from gspn_framework_package.analysis.graph import flat_ranges
from gspn_framework_package.analysis.state_space.exploration import (
    ENDLESS,
    Allowance,
    RawGraph,
    label_type,
)
from gspn_framework_package.analysis.state_space.marking_store import SparseStore
from gspn_framework_package.analysis.state_space.packing import (
    MAX_WIDTH,
    precedence_classes,
    thresholds,
)
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net

_STATE_BYTES = 230
"""Memory of a state in addition to its changed places: the object and its entry in the index."""

_ARC_BYTES = 16

_ENTRY_BYTES = 16
"""Bytes of a key per place that it contains: two machine words, the place and its count."""

_ASKING = 10_000
"""Number of arcs between two checks of the watch."""

_MANY = 64
"""From this number of transitions on, firing them all together pays off."""

_WHOLE = 4_000_000
"""Up to this many entries, markings are stored as a whole instead of as differences from the
initial one."""


def explore(
    net: Net, limit: int, watch: Watch, *, by_priority: bool = True, room: Allowance = ENDLESS
) -> Tuple[RawGraph, SparseStore, Indices]:
    """The reachability graph (without its ``states``), the markings, and the order of the
    transitions: engine order to number in the net.

    :param limit: the exploration ends when more than this many states are known.
    :param room: it also ends when this is used up.
    :raises LimitError: a count is too large.
    """
    rules = _Rules(net, by_priority)
    keys: List[bytes] = [b""]
    index: Dict[bytes, int] = {b"": 0}
    enabled_before: List[Tuple[int, ...]] = [rules.enabled_at_first()]
    came_by: List[int] = [-1]
    before: List[int] = [0]  # for each waiting state, its index in ``enabled_before``
    offsets, targets, labels = array("q", [0]), array("q"), array("l")
    explored = changed = asked = 0
    while explored < len(keys) <= limit:
        if explored % 64 == 0 or len(targets) - asked > _ASKING:
            asked = len(targets)
            watch.step("states", len(keys))
            if not room.left(len(keys) * _STATE_BYTES + 16 * changed + len(targets) * _ARC_BYTES):
                break
        marking = _marking(keys[explored])
        enabled = enabled_before[before[explored]]
        if came_by[explored] >= 0:
            enabled = rules.enabled_after(marking, enabled, came_by[explored])
        firing = rules.first_class(enabled)
        if firing:
            enabled_before.append(enabled)
        for t, key in zip(firing, rules.successors(marking, firing)):
            number = index.get(key)
            if number is None:
                number = index[key] = len(keys)
                keys.append(key)
                came_by.append(t)
                before.append(len(enabled_before) - 1)
                changed += len(key) // _ENTRY_BYTES
            targets.append(number)
            labels.append(t)
        offsets.append(len(targets))
        before[explored] = -1
        explored += 1
    offsets.extend([len(targets)] * (len(keys) - explored))
    graph = RawGraph(
        None,
        np.array(offsets, dtype=np.int64),
        np.array(targets, dtype=np.int32 if limit < 2**31 - 2**24 else np.int64),
        np.array(labels, dtype=label_type(len(rules.order))),
        explored,
    )
    return graph, _store(net, keys), np.array(rules.order, dtype=np.int32)


class _Rules:
    """The firing rule, indexed by places; transitions are in engine order, as in the other
    engines."""

    def __init__(self, net: Net, by_priority: bool) -> None:
        classes = precedence_classes(net) if by_priority else [list(range(len(net.transitions)))]
        self.order: List[int] = [t for members in classes for t in members]
        self._class_of = [number for number, members in enumerate(classes) for _ in members]
        self._single = len(classes) <= 1
        self._net = net
        self._initial: Sequence[int] = net.initial_marking
        self._needs: Sequence[Sequence[Tuple[int, int]]] = [net.inputs[t] for t in self.order]
        self._limits: List[Tuple[Tuple[int, int], ...]] = [()] * len(self.order)
        if any(net.inhibitors) or any(place.capacity is not None for place in net.places):
            self._limits = [tuple(thresholds(net, t).items()) for t in self.order]
        self._effects = [net.effect(t) for t in self.order]
        # for each place, the transitions that take tokens from it
        self._taking: Sequence[Sequence[int]] = net.consumers
        if not self._single:
            row_of = np.argsort(self.order).tolist()
            self._taking = [[row_of[t] for t in taking] for taking in net.consumers]
        # and the transitions that read it, with those that its count may disable
        self._looking: Sequence[Sequence[int]] = self._taking
        if any(self._limits):
            looking = list(map(list, self._taking))
            for row, limits in enumerate(self._limits):
                for p, _ in limits:
                    looking[p].append(row)
            self._looking = looking
        # the transitions that take from no place
        self._always = [row for row, needs in enumerate(self._needs) if not needs]
        self._marked = [p for p, count in enumerate(self._initial) if count]
        self._together: Optional[_Together] = None

    def enabled_at_first(self) -> Tuple[int, ...]:
        return tuple(t for t in range(len(self.order)) if self._is_enabled({}, t))

    def enabled_after(
        self, marking: Dict[int, int], before: Tuple[int, ...], fired: int
    ) -> Tuple[int, ...]:
        """The transitions enabled in ``marking``, which resulted from firing ``fired`` in a marking
        that enabled ``before``."""
        work = len(before) + sum(len(self._looking[p]) for p, _ in self._effects[fired])
        if len(self._marked) + len(marking) < work // 4:
            marked = [p for p in self._marked if p not in marking] + [
                p for p, count in marking.items() if count
            ]
            if len(self._always) + sum(len(self._taking[p]) for p in marked) < work:
                return self._enabled_by(marking, marked)
        near: Set[int] = set()
        for p, _ in self._effects[fired]:
            near.update(self._looking[p])
        found = [t for t in before if t not in near]
        found += [t for t in near if self._is_enabled(marking, t)]
        found.sort()
        return tuple(found)

    def _enabled_by(self, marking: Dict[int, int], marked: Sequence[int]) -> Tuple[int, ...]:
        """The enabled transitions, found from the marked places. This is used if these are few and
        the firing emptied a place that thousands of transitions take from."""
        near = set(self._always)
        for p in marked:
            near.update(self._taking[p])
        return tuple(sorted(t for t in near if self._is_enabled(marking, t)))

    def successors(self, marking: Dict[int, int], firing: Sequence[int]) -> Iterable[bytes]:
        """The keys of the markings that result from firing each of ``firing``.

        :raises LimitError: a count is too large.
        """
        if len(firing) < _MANY:
            return [_key(self._after(marking, t)) for t in firing]
        if self._together is None:
            self._together = _Together(self._net, self._effects)
        return self._together.successors(marking, firing)

    def _after(self, marking: Dict[int, int], t: int) -> Dict[int, int]:
        after = dict(marking)
        for p, change in self._effects[t]:
            count = after.get(p, self._initial[p]) + change
            if count >> MAX_WIDTH:
                raise _too_large(self._net, p)
            if count == self._initial[p]:
                after.pop(p, None)
            else:
                after[p] = count
        return after

    def _is_enabled(self, marking: Dict[int, int], t: int) -> bool:
        initial = self._initial
        for p, weight in self._needs[t]:
            if marking.get(p, initial[p]) < weight:
                return False
        return all(marking.get(p, initial[p]) < most for p, most in self._limits[t])

    def first_class(self, enabled: Tuple[int, ...]) -> Tuple[int, ...]:
        """Those of ``enabled`` that take precedence."""
        if self._single or not enabled:
            return enabled
        first = self._class_of[enabled[0]]
        if self._class_of[enabled[-1]] == first:
            return enabled
        return tuple(t for t in enabled if self._class_of[t] == first)


class _Together:
    """Computes many firings from one marking at once. In a net with thousands of tokens each
    marking has thousands of successors; computing them one by one takes five times as long."""

    def __init__(self, net: Net, effects: Sequence[Sequence[Tuple[int, int]]]) -> None:
        self._net = net
        self._initial = np.array(net.initial_marking, dtype=np.int64)
        flat = list(chain.from_iterable(effects))
        self._places = np.array([p for p, _ in flat], dtype=np.int64)
        # Changes of more than MAX_WIDTH bits are clipped: they are too large in any case, and two
        # clipped numbers can be added without overflow.
        most = 1 << MAX_WIDTH
        self._changes = np.array(
            [max(-most, min(change, most)) for _, change in flat], dtype=np.int64
        )
        self._ends = np.concatenate(
            [[0], np.cumsum([len(effect) for effect in effects], dtype=np.int64)]
        )

    def successors(self, marking: Dict[int, int], firing: Sequence[int]) -> Iterable[bytes]:
        """See :meth:`_Rules.successors`."""
        rows = np.array(firing, dtype=np.int64)
        begin, end = self._ends[rows], self._ends[rows + 1]
        entries = flat_ranges(begin, end)
        places = self._places[entries]
        now = self._initial.copy()
        differing = np.fromiter(marking, dtype=np.int64, count=len(marking))
        now[differing] = np.fromiter(marking.values(), dtype=np.int64, count=len(marking))
        counts = now[places] + self._changes[entries]
        large = np.flatnonzero(counts >> MAX_WIDTH)
        if len(large):
            raise _too_large(self._net, int(places[large[0]]))
        # The changes of a firing precede the earlier differences, so that they take precedence
        # among equal keys.
        size = len(now)
        keys = np.concatenate(
            [
                np.repeat(np.arange(len(rows)), end - begin) * size + places,
                _grid(len(rows), differing, size),
            ]
        )
        counts = np.concatenate([counts, np.tile(now[differing], len(rows))])
        keys, first = np.unique(keys, return_index=True)
        places, counts = keys % size, counts[first]
        kept = counts != self._initial[places]
        table = np.stack([places[kept], counts[kept]], axis=1).tobytes()
        ends = _ENTRY_BYTES * np.cumsum(np.bincount(keys[kept] // size, minlength=len(rows)))
        at = 0
        for to in ends.tolist():
            yield table[at:to]
            at = to


def _too_large(net: Net, place: int) -> LimitError:
    return LimitError("a count of place '%s' exceeds 2**%d" % (net.places[place].name, MAX_WIDTH))


def _key(marking: Dict[int, int]) -> bytes:
    flat: List[int] = []
    for item in sorted(marking.items()):
        flat += item
    return array("q", flat).tobytes()


def _marking(key: bytes) -> Dict[int, int]:
    flat = array("q")
    flat.frombytes(key)
    return dict(zip(flat[::2], flat[1::2]))


def _store(net: Net, keys: List[bytes]) -> SparseStore:
    lengths = np.array([len(key) // _ENTRY_BYTES for key in keys], dtype=np.int64)
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    entries = np.frombuffer(b"".join(keys), dtype=np.int64).reshape(-1, 2)
    places, counts = entries[:, 0].astype(np.int32), entries[:, 1].copy()
    initial = np.array(net.initial_marking, dtype=np.int64)
    marked = np.flatnonzero(initial)
    if len(keys) * len(marked) + len(places) > _WHOLE:
        return SparseStore(initial, offsets, places, counts)
    # Store the marked places of every state over an empty base, so that a place that is never empty
    # never equals the base.
    states = np.repeat(np.arange(len(keys)), lengths)
    key = np.concatenate([states * len(initial) + places, _grid(len(keys), marked, len(initial))])
    value = np.concatenate([counts, np.tile(initial[marked], len(keys))])
    key, first = np.unique(key, return_index=True)  # of equal keys, the changed one is first
    value = value[first]
    key, value = key[value != 0], value[value != 0]
    state, place = key // len(initial), key % len(initial)
    return SparseStore(
        np.zeros_like(initial),
        np.searchsorted(state, np.arange(len(keys) + 1)),
        place.astype(np.int32),
        value,
    )


def _grid(states: int, marked: Indices, places: int) -> Booleans:
    return (np.arange(states)[:, None] * places + marked[None, :]).reshape(-1)
