"""Exploration of the reachable markings of nets of thousands of places, one marking at a time.

A marking is kept as what differs from the initial one, and its enabled transitions come from those of the marking
before: only the transitions around the places that the firing changed are looked at. So a firing costs what it changes,
and not what the net has.
"""

from __future__ import annotations

from array import array
from typing import Any, Dict, List, Sequence, Set, Tuple

import numpy as np

from gspn_framework_package.analysis.exploration import ENDLESS, RawGraph, Room, Watch, label_type
from gspn_framework_package.analysis.marking_store import SparseStore
from gspn_framework_package.analysis.packing import MAX_WIDTH, precedence_classes, thresholds
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net

_STATE_BYTES = 230
"""What a state takes beside its changed places: the object and its entry in the index."""

_ARC_BYTES = 16

_WHOLE = 4_000_000
"""Up to this many entries the markings are told as they are, and not as what differs from the initial one."""


def explore(
    net: Net, limit: int, watch: Watch, *, by_priority: bool = True, room: Room = ENDLESS
) -> Tuple[RawGraph, SparseStore, Any]:
    """The reachability graph (without its ``states``), the markings, and the order of the transitions: engine order to
    number in the net.

    :param limit: the exploration ends when more than this many states are known.
    :param room: it also ends where this is used up.
    :raises LimitError: a count is too large.
    """
    rules = _Rules(net, by_priority)
    initial = rules.initial
    keys: List[bytes] = [b""]
    index: Dict[bytes, int] = {b"": 0}
    enabled_before: List[Tuple[int, ...]] = [rules.enabled_at_first()]
    came_by: List[int] = [-1]
    before: List[int] = [0]  # of each waiting state: the number in ``enabled_before``
    offsets, targets, labels = array("q", [0]), array("q"), array("l")
    explored = changed = 0
    while explored < len(keys) <= limit:
        if explored % 64 == 0:
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
        for t in firing:
            after = dict(marking)
            for p, change in rules.effects[t]:
                count = after.get(p, initial[p]) + change
                if count >> MAX_WIDTH:
                    raise LimitError("a count of place '%s' exceeds 2**%d" % (net.places[p].name, MAX_WIDTH))
                if count == initial[p]:
                    after.pop(p, None)
                else:
                    after[p] = count
            key = _key(after)
            number = index.get(key)
            if number is None:
                number = index[key] = len(keys)
                keys.append(key)
                came_by.append(t)
                before.append(len(enabled_before) - 1)
                changed += len(after)
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
    """The firing rule by places: transitions in engine order, as the other engines have them."""

    def __init__(self, net: Net, by_priority: bool) -> None:
        classes = precedence_classes(net) if by_priority else [list(range(len(net.transitions)))]
        self.order: List[int] = [t for members in classes for t in members]
        self._class_of = [number for number, members in enumerate(classes) for _ in members]
        self._single = len(classes) <= 1
        self.initial: Sequence[int] = net.initial_marking
        self._needs = [net.inputs[t] for t in self.order]
        self._limits = [tuple(thresholds(net, t).items()) for t in self.order]
        self.effects = [net.effect(t) for t in self.order]
        self._looking: List[List[int]] = [[] for _ in net.places]  # at each place: the transitions that look at it
        for row in range(len(self.order)):
            for p in {p for p, _ in self._needs[row]} | {p for p, _ in self._limits[row]}:
                self._looking[p].append(row)

    def enabled_at_first(self) -> Tuple[int, ...]:
        return tuple(t for t in range(len(self.order)) if self._is_enabled({}, t))

    def enabled_after(self, marking: Dict[int, int], before: Tuple[int, ...], fired: int) -> Tuple[int, ...]:
        """What is enabled in ``marking``, which came from one that enabled ``before``, when ``fired`` fired there."""
        near: Set[int] = set()
        for p, _ in self.effects[fired]:
            near.update(self._looking[p])
        found = [t for t in before if t not in near]
        found += [t for t in near if self._is_enabled(marking, t)]
        found.sort()
        return tuple(found)

    def _is_enabled(self, marking: Dict[int, int], t: int) -> bool:
        initial = self.initial
        for p, weight in self._needs[t]:
            if marking.get(p, initial[p]) < weight:
                return False
        return all(marking.get(p, initial[p]) < most for p, most in self._limits[t])

    def first_class(self, enabled: Tuple[int, ...]) -> Tuple[int, ...]:
        """Those that take precedence."""
        if self._single or not enabled:
            return enabled
        first = self._class_of[enabled[0]]
        if self._class_of[enabled[-1]] == first:
            return enabled
        return tuple(t for t in enabled if self._class_of[t] == first)


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
    lengths = np.array([len(key) >> 4 for key in keys], dtype=np.int64)
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    entries = np.frombuffer(b"".join(keys), dtype=np.int64).reshape(-1, 2)
    places, counts = entries[:, 0].astype(np.int32), entries[:, 1].copy()
    initial = np.array(net.initial_marking, dtype=np.int64)
    marked = np.flatnonzero(initial)
    if len(keys) * len(marked) + len(places) > _WHOLE:
        return SparseStore(initial, offsets, places, counts)
    # The marked places of every state, and what became of them: so a place that is never empty has no rest.
    states = np.repeat(np.arange(len(keys)), lengths)
    key = np.concatenate([states * len(initial) + places, _grid(len(keys), marked, len(initial))])
    value = np.concatenate([counts, np.tile(initial[marked], len(keys))])
    key, first = np.unique(key, return_index=True)  # of two, the changed one comes first
    value = value[first]
    key, value = key[value != 0], value[value != 0]
    state, place = key // len(initial), key % len(initial)
    return SparseStore(
        np.zeros_like(initial), np.searchsorted(state, np.arange(len(keys) + 1)), place.astype(np.int32), value
    )


def _grid(states: int, marked: Any, places: int) -> Any:
    return (np.arange(states)[:, None] * places + marked[None, :]).reshape(-1)
