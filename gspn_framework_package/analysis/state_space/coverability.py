"""The coverability tree and graph of Karp and Miller (1969): the reachable markings of an unbounded
net, with ``OMEGA`` for "any number of tokens".

It is exact for nets without inhibitor arcs, capacities and priorities. For other nets a growing
sequence is accepted only if the additional tokens cannot prevent it from firing again; otherwise
the answer is "not decided", since the problem is undecidable in general with inhibitor arcs.
"""

from __future__ import annotations

import math
from collections import deque
from operator import le
from typing import Deque, Dict, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple, Union

from gspn_framework_package.analysis.limits import TREE_LIMIT
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net

OMEGA = 1 << 62
"""Stands for "any number of tokens" in a marking of the tree."""


_COMPARISONS = 400
"""Budget of comparisons with ancestor markings, per node that the limit allows."""

_NODE_BYTES = 400
"""Memory of a node in addition to its counts."""


class TreeNode(NamedTuple):
    """A node of the tree.

    :ivar marking: counts, or OMEGA.
    :ivar parent: the number of the parent node (-1 at the root).
    :ivar transition: the number of the transition that leads here from the parent (-1 at the root).
    :ivar same: the number of the first node with the same marking, possibly this one. Only the
        first has children.
    """

    marking: Tuple[int, ...]
    parent: int
    transition: int
    same: int


class CoverabilityTree:
    """The tree of a net.

    :param untimed: immediate transitions have no precedence (plain Petri net rule).
    :param limit: largest number of nodes.
    :param memory: largest number of bytes.
    :param seconds: longest time (s).
    :raises LimitError: a limit was reached, or a growth could not be decided.
    """

    def __init__(
        self,
        net: Net,
        *,
        untimed: bool = False,
        limit: int = TREE_LIMIT,
        progress: Optional[Progress] = None,
        cancel: Optional[Cancel] = None,
        memory: float = math.inf,
        seconds: float = math.inf,
    ) -> None:
        self.net = net
        self.untimed = untimed
        self.nodes: List[TreeNode] = []
        self._exact = _Monotone(net, untimed)
        self._near = _Near(net)
        self._most = memory / (8 * len(net.places) + _NODE_BYTES)
        self._memory = memory
        self._comparisons = _COMPARISONS * limit
        self._build(limit, Watch(progress, cancel, seconds=seconds))

    def _build(self, limit: int, watch: Watch) -> None:
        first: Dict[Tuple[int, ...], int] = {self.net.initial_marking: 0}
        self.nodes.append(TreeNode(self.net.initial_marking, -1, -1, 0))
        with_concession = self.net.enabled(self.net.initial_marking, by_priority=False)
        # numbers of nodes, with the transitions enabled in the parent of each
        waiting: Deque[Tuple[int, Tuple[int, ...]]] = deque([(0, with_concession)])
        while waiting:
            number, with_concession = waiting.popleft()
            node = self.nodes[number]
            marking = node.marking
            if number:
                before = self.nodes[node.parent].marking
                with_concession = self._near.enabled(marking, before, with_concession)
            for t in self._preferred(with_concession):
                after = self._accelerate(number, t, _fire(self.net, marking, t))
                same = first.setdefault(after, len(self.nodes))
                if same == len(self.nodes):
                    waiting.append((same, with_concession))
                else:
                    after = self.nodes[same].marking  # share one tuple
                self.nodes.append(TreeNode(after, number, t, same))
                if len(self.nodes) > limit or self._comparisons < 0:
                    raise LimitError(
                        "the coverability tree has more than %d nodes" % limit
                        if self._comparisons >= 0
                        else "the coverability tree is too deep: %d nodes took too long"
                        % len(self.nodes),
                        hint="raise --limit-tree",
                    )
                if len(self.nodes) > self._most:
                    raise LimitError(
                        "the coverability tree takes more than %.3g GB" % (self._memory / 1e9),
                        hint="raise --limit-memory",
                    )
                watch.step("nodes", len(self.nodes))

    def _preferred(self, with_concession: Sequence[int]) -> Sequence[int]:
        """The transitions that take precedence; see
        :meth:`~gspn_framework_package.model.net.Net.enabled`."""
        transitions = self.net.transitions
        immediate = [t for t in with_concession if not transitions[t].timed]
        if self.untimed or not immediate:
            return with_concession
        top = max(transitions[t].priority for t in immediate)
        return [t for t in immediate if transitions[t].priority == top]

    def _accelerate(self, number: int, t: int, after: Tuple[int, ...]) -> Tuple[int, ...]:
        """``after`` with OMEGA where repeating the path from an ancestor to here adds tokens."""
        fired = {t}
        while number >= 0:
            node = self.nodes[number]
            self._comparisons -= 1
            # the hottest loop, in nets of thousands of places
            if all(map(le, node.marking, after)):
                growing = [p for p, (a, b) in enumerate(zip(node.marking, after)) if a < b < OMEGA]
                if growing:
                    self._exact.require(growing, fired)
                    counts = list(after)
                    for p in growing:
                        counts[p] = OMEGA
                    after = tuple(counts)
            fired.add(node.transition)
            number = node.parent
        return after

    # -- answers -----------------------------------------------------------------------------------

    @property
    def bounded(self) -> bool:
        """Whether no marking of the tree has an OMEGA."""
        return not self.unbounded_places

    @property
    def unbounded_places(self) -> List[str]:
        """The places that can hold any number of tokens."""
        return [place.name for place, most in zip(self.net.places, self._largest) if most == OMEGA]

    @property
    def _largest(self) -> List[int]:
        """The largest count of each place."""
        most = list(self.nodes[0].marking)
        for number, node in enumerate(self.nodes):
            if node.same == number:
                most = list(map(max, most, node.marking))
        return most

    @property
    def bounds(self) -> Dict[str, Optional[int]]:
        """The maximum number of tokens that each place can hold; None if there is no bound."""
        return {
            place.name: None if n == OMEGA else n
            for place, n in zip(self.net.places, self._largest)
        }

    @property
    def dead_transitions(self) -> List[str]:
        """Transitions that can never fire."""
        fired = {node.transition for node in self.nodes}
        return [t.name for i, t in enumerate(self.net.transitions) if i not in fired]

    def covers(self, marking: Union[Sequence[int], Mapping[str, int]]) -> Optional[List[str]]:
        """The transitions on the path to a node that covers ``marking``, or None if none does.

        If the node has an OMEGA, the path gives the order of the firings, and its loops must be
        repeated often enough.

        :param marking: the least number of tokens in each place; a mapping may omit places.
        """
        wanted = self.net.marking(marking) if isinstance(marking, Mapping) else tuple(marking)
        for number, node in enumerate(self.nodes):
            if all(n <= have for n, have in zip(wanted, node.marking)):
                return self.path_to(number)
        return None

    def path_to(self, number: int) -> List[str]:
        """The names of the transitions from the root to a node."""
        names = []
        while self.nodes[number].transition >= 0:
            names.append(self.net.transitions[self.nodes[number].transition].name)
            number = self.nodes[number].parent
        return names[::-1]

    def graph(self) -> Tuple[List[Tuple[int, ...]], List[Tuple[int, int, int]]]:
        """The coverability graph: its markings, and its arcs (from, transition, to; numbers of
        markings)."""
        index: Dict[int, int] = {}
        for number, node in enumerate(self.nodes):
            if node.same == number:
                index[number] = len(index)
        markings = [self.nodes[number].marking for number in index]
        arcs = [
            (index[self.nodes[node.parent].same], node.transition, index[node.same])
            for node in self.nodes
            if node.transition >= 0
        ]
        return markings, arcs

    def text(self, marking: Sequence[int]) -> str:
        """A marking as text without its empty places: ``2 a, w b``, with the Greek letter for
        OMEGA."""
        parts = [
            "%s %s" % ("ω" if n == OMEGA else n, place.name)
            for place, n in zip(self.net.places, marking)
            if n
        ]
        return ", ".join(parts) or "empty"


class _Near:
    """Derives the transitions enabled in a marking from those of its predecessor by checking only
    the transitions next to changed places."""

    def __init__(self, net: Net) -> None:
        self._net = net
        self._looking: List[Sequence[int]] = list(net.consumers)
        for p, transitions in net.inhibited_by().items():
            self._looking[p] = (*self._looking[p], *transitions)
        for p, place in enumerate(net.places):
            if place.capacity is not None:
                self._looking[p] = (*self._looking[p], *net.producers[p])

    def enabled(
        self, marking: Sequence[int], before: Sequence[int], with_concession: Sequence[int]
    ) -> Tuple[int, ...]:
        """The transitions with concession in ``marking``, given those (``with_concession``) of its
        predecessor ``before``."""
        near: Set[int] = set()
        for p, count in enumerate(marking):
            if count != before[p]:
                near.update(self._looking[p])
        if not near:
            return tuple(with_concession)
        found = [t for t in with_concession if t not in near]
        found += [t for t in near if self._net.is_enabled(marking, t)]
        return tuple(sorted(found))


class _Monotone:
    """Decides whether a firing sequence stays possible with more tokens in some places."""

    def __init__(self, net: Net, untimed: bool) -> None:
        self._net = net
        inhibiting = {p for arcs in net.inhibitors for p, _ in arcs}
        limited = {p for p, place in enumerate(net.places) if place.capacity is not None}
        self._disturbing: Set[int] = inhibiting | limited
        self._urgency = [
            0 if untimed else (t.priority + 1 if not t.timed else 0) for t in net.transitions
        ]

    def require(self, growing: Sequence[int], fired: Set[int]) -> None:
        """Check a growth. :raises LimitError: tokens in ``growing`` might prevent the transitions
        ``fired``."""
        lowest = min(self._urgency[t] for t in fired)
        for p in growing:
            urgent = any(self._urgency[t] > lowest for t in self._net.consumers[p])
            if p in self._disturbing or urgent:
                why = (
                    "an immediate transition of higher priority"
                    if urgent
                    else "an inhibitor arc or a capacity"
                )
                raise LimitError(
                    "whether place '%s' grows without bound depends on %s, which the coverability "
                    "tree cannot judge" % (self._net.places[p].name, why)
                )


def _fire(net: Net, marking: Sequence[int], t: int) -> Tuple[int, ...]:
    after = list(marking)
    for p, change in net.effect(t):
        if after[p] != OMEGA:
            after[p] += change
    return tuple(after)
