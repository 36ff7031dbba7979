"""The set of enabled transitions, updated incrementally: the cost depends only on what changed in
the marking."""

from __future__ import annotations

from typing import FrozenSet, List, NamedTuple, Sequence, Set, Tuple

from gspn_framework_package.model.net import Marking, Net


class Change(NamedTuple):
    """The transitions (indices, ascending) that became enabled, and those that became disabled."""

    added: Tuple[int, ...]
    removed: Tuple[int, ...]


class EnabledSet:
    """The enabled transitions of a net in a changing marking.

    It agrees with :meth:`Net.enabled` in every marking (a test compares the two), but calls
    :meth:`Net.is_enabled` only for the transitions that touch a place whose count changed.

    :param marking: the marking to start from.
    :param by_priority: immediate transitions take precedence over exponential ones, and only the
        immediate ones of the highest priority count as enabled. If false, all transitions with
        concession count as enabled.
    """

    def __init__(self, net: Net, marking: Sequence[int], *, by_priority: bool = True) -> None:
        self.net = net
        self.by_priority = by_priority
        self.marking: Marking = tuple(marking)
        touching: List[Set[int]] = [set() for _ in net.places]
        for t in range(len(net.transitions)):
            for arcs in (net.inputs[t], net.inhibitors[t], net.outputs[t]):
                for p, _ in arcs:
                    if arcs is not net.outputs[t] or net.places[p].capacity is not None:
                        touching[p].add(t)
        self._touching = [tuple(sorted(ts)) for ts in touching]
        self._timed: Set[int] = set()
        self._immediate: Set[int] = set()
        for t in range(len(net.transitions)):
            self._set(t, net.is_enabled(self.marking, t))
        self.now: FrozenSet[int] = self._select()
        """The enabled transitions, by index."""

    def move_to(self, marking: Sequence[int]) -> Change:
        """Move to another marking; returns what changed."""
        old, new = self.marking, tuple(marking)
        self.marking = new
        asked: Set[int] = set()
        for p, touching in enumerate(self._touching):
            if old[p] != new[p]:
                asked.update(touching)
        return self._refresh(asked)

    def fire(self, t: int) -> Change:
        """Fire transition ``t`` (index); returns what changed. :raises NotEnabledError: it has no
        concession."""
        self.marking = self.net.fire(self.marking, t)
        asked: Set[int] = set()
        for p, _ in self.net.effect(t):
            asked.update(self._touching[p])
        return self._refresh(asked)

    def _refresh(self, asked: Set[int]) -> Change:
        for t in asked:
            self._set(t, self.net.is_enabled(self.marking, t))
        before, self.now = self.now, self._select()
        return Change(tuple(sorted(self.now - before)), tuple(sorted(before - self.now)))

    def _set(self, t: int, enabled: bool) -> None:
        kind = self._timed if self.net.transitions[t].timed else self._immediate
        if enabled:
            kind.add(t)
        else:
            kind.discard(t)

    def _select(self) -> FrozenSet[int]:
        if not self.by_priority:
            return frozenset(self._timed | self._immediate)
        if not self._immediate:
            return frozenset(self._timed)
        transitions = self.net.transitions
        top = max(transitions[t].priority for t in self._immediate)
        return frozenset(t for t in self._immediate if transitions[t].priority == top)
