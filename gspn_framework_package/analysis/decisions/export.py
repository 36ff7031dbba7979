"""Converts decisions for each marking to a policy with few rows.

The decision of a robot depends on few of the places. So the markings are split by one place after
another until all markings of a part have the same decision; a part becomes a row with a cell for
each place that it was split by, and wildcards elsewhere. The next place is the one that separates
the decisions best (the Gini impurity of Breiman et al., *Classification and Regression Trees*,
1984). A row with more cells takes precedence, so a part whose decisions are mostly the same becomes
one row plus a row for each exception. The smallest set of rows follows from the leaves of the tree
to its root (Draves, King, Venkatachary, Zill, *Constructing optimal IP routing tables*, INFOCOM
1999).

Robots that decide in different places depend on different counts, so each place has its own tree;
places that share an immediate transition share a tree, since its rows apply to all of them. Rows
with the same cells become one row. If a robot must wait although another one decides, no row may
apply to its place. If all wait, they follow the last row, which matches everything and chooses
nothing.
"""

from __future__ import annotations

import math
from typing import Dict, FrozenSet, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Indices
from gspn_framework_package.analysis.state_space.rated_graph import enabled_in
from gspn_framework_package.analysis.watch import Cancel, Watch
from gspn_framework_package.model.errors import PolicyError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy import Policy, PolicyRow
from gspn_framework_package.model.policy_cell import Cells

Probabilities = Tuple[Tuple[int, float], ...]
"""Pairs (number of a transition, probability); the probabilities sum to 1. Empty: wait."""

SAME_PROBABILITY = 1e-12
"""Two probabilities are equal if they differ by no more than this, since rows of several places are
rescaled."""


class Decided(NamedTuple):
    """What to do in each of some markings.

    :ivar markings: integer array (markings x places of the plan's net).
    :ivar choices: for each marking transition -> probability. Robots in a place that none of the
      transitions leaves wait there. A chance place needs its probabilities too.
    """

    markings: Indices
    choices: Tuple[Mapping[str, float], ...]


def policy_of(plan: Plan, decided: Decided, *, cancel: Optional[Cancel] = None) -> Policy:
    """Return a policy that makes the given decisions in each of the markings, for every place in
    which the marking enables an immediate transition. In other markings, its decisions are
    unspecified.

    The same decisions give the same rows in any order.

    :param plan: the plan; its own policy is not used.
    :raises PolicyError: a transition is unknown or exponential, or one marking has two decisions.
    :raises CancelledError: ``cancel`` returned true.
    """
    watch = Watch(cancel=cancel)
    asked = _Asked(plan, decided)
    found = _merged(asked, watch)
    policy = _written(plan.net, found)
    _verify(asked, policy, watch)
    return policy


class _Group:
    """Places that decide together: they share immediate transitions.

    :ivar places: their numbers.
    :ivar transitions: the numbers of the immediate transitions that leave them.
    """

    def __init__(self, places: Sequence[int], net: Net, immediate: Sequence[int]) -> None:
        inside = set(places)
        self.places = sorted(places)
        self.transitions = [t for t in immediate if any(p in inside for p, _ in net.inputs[t])]

    def spoken_of(self, choice: Probabilities, net: Net) -> FrozenSet[int]:
        """The places of the group to which a row with this choice applies."""
        inputs = {p for t, _ in choice for p, _ in net.inputs[t]}
        return frozenset(inputs.intersection(self.places))


class _Asked:
    """Decisions as arrays.

    :ivar kinds: the distinct choices.
    :ivar kind: int array: the number of each marking's choice.
    :ivar enabled: transition -> boolean array: whether each marking enables it (immediate ones).
    :ivar groups: the places that decide together.
    """

    def __init__(self, plan: Plan, decided: Decided) -> None:
        self.net = net = plan.net
        self.markings = np.asarray(decided.markings)
        acts = [p for p, acts in enumerate(plan.acts) if acts]
        immediate = [t for t, transition in enumerate(net.transitions) if not transition.timed]
        numbers: Dict[Tuple[Tuple[str, float], ...], int] = {}
        self.kind = np.array(
            [numbers.setdefault(tuple(sorted(c.items())), len(numbers)) for c in decided.choices],
            dtype=np.int64,
        )
        self.kinds = [_choice(net, written) for written in numbers]
        column = self.markings.T.__getitem__
        self.enabled = {t: enabled_in(net, t, column, len(self.markings)) for t in immediate}
        self.groups = [_Group(places, net, immediate) for places in _joint(net, acts, immediate)]

    def __len__(self) -> int:
        return len(self.markings)

    def cares(self, p: int) -> Booleans:
        """Boolean array: the markings in which robots in place ``p`` could fire something."""
        found = np.zeros(len(self), dtype=bool)
        for t in self.net.consumers[p]:
            if t in self.enabled:
                found |= self.enabled[t]
        return found

    def effective(self, transitions: Sequence[int]) -> Tuple[List[Probabilities], Indices]:
        """The decisions about these transitions: the distinct choices, the empty one first, then in
        the order of the net; and the number of each marking's choice. A choice without enabled
        transitions counts as empty."""
        inside = set(transitions)
        per_kind = [_restricted(kind, inside) for kind in self.kinds]
        choices = sorted({(), *per_kind})
        number = {choice: i for i, choice in enumerate(choices)}
        labels = np.array([number[c] for c in per_kind], dtype=np.int64)[self.kind]
        for i, choice in enumerate(choices):
            some = np.zeros(len(self), dtype=bool)
            for t, _ in choice:
                some |= self.enabled[t]
            labels[(labels == i) & ~some] = 0
        return choices, labels


def _choice(net: Net, written: Sequence[Tuple[str, float]]) -> Probabilities:
    """Transition numbers for names. :raises PolicyError: one is unknown or exponential."""
    found = []
    for name, probability in written:
        t = net.transition_index.get(name)
        if t is None or net.transitions[t].timed:
            raise PolicyError("'%s' is not an immediate transition of the net" % name)
        if probability > 0:
            found.append((t, float(probability)))
    return _restricted(sorted(found), {t for t, _ in found})


def _restricted(choice: Sequence[Tuple[int, float]], inside: set[int]) -> Probabilities:
    kept = [(t, v) for t, v in choice if t in inside]
    total = math.fsum(v for _, v in kept)
    return tuple((t, v / total) for t, v in kept)


def _joint(net: Net, acts: Sequence[int], immediate: Sequence[int]) -> List[List[int]]:
    """The action places that immediate transitions leave, grouped if they share one."""
    group = {p: {p} for p in acts}
    for t in immediate:
        sources = [p for p, _ in net.inputs[t] if p in group]
        for p in sources[1:]:
            if group[p] is not group[sources[0]]:
                joined = group[sources[0]] | group[p]
                group.update((q, joined) for q in joined)
    deciding = {p for t in immediate for p, _ in net.inputs[t]}
    whole = {min(places): places for places in group.values()}
    return [sorted(places) for _, places in sorted(whole.items()) if places & deciding]


# -- rows ------------------------------------------------------------------------------------------


def _merged(asked: _Asked, watch: Watch) -> Dict[Cells, List[Probabilities]]:
    """The rows of all groups, by their cells."""
    found: Dict[Cells, List[Probabilities]] = {}
    all_wait = np.zeros(len(asked), dtype=bool)
    speaks = np.zeros(len(asked), dtype=bool)
    for group in asked.groups:
        care = np.zeros(len(asked), dtype=bool)
        for p in group.places:
            care |= asked.cares(p)
        choices, labels = asked.effective(group.transitions)
        all_wait |= care & (labels == 0)
        speaks |= care & (labels != 0)
        spoken = [group.spoken_of(choice, asked.net) for choice in choices]
        order = {places: i for i, places in enumerate(dict.fromkeys(spoken))}
        tree = _Tree(
            asked.markings[care], labels[care], [order[places] for places in spoken], watch
        )
        for cells, label in tree.rows():
            found.setdefault(cells, []).append(choices[label])
    if (all_wait & ~speaks).any() and () not in found:
        found[()] = []
    return found


def _written(net: Net, found: Mapping[Cells, Sequence[Probabilities]]) -> Policy:
    """The policy with these rows, and only the places that they read."""
    columns = sorted({p for cells in found for p, _ in cells})
    column = {p: i for i, p in enumerate(columns)}
    rows = []
    for cells, choices in found.items():
        counts: List[Optional[int]] = [None] * len(columns)
        for p, count in cells:
            counts[column[p]] = count
        share = 1.0 / max(len(choices), 1)
        rows.append(
            PolicyRow(
                tuple(counts),
                tuple((net.transitions[t].name, v * share) for c in choices for t, v in c),
            )
        )
    rows.sort(key=lambda row: [(c is None, c or 0) for c in row.counts])
    return Policy([net.places[p].name for p in columns], rows)


# -- the tree --------------------------------------------------------------------------------------


class _Node:
    """A part of the markings.

    :ivar up: the number of the part that it was split from; -1 for the whole.
    :ivar cell: the place and count by which it was split.
    :ivar members: its markings.
    :ivar label: the decision in all of them; -1 if they differ.
    :ivar mixed: whether a row for the whole part could not be overridden where it does not apply.
    :ivar best: the labels, as bits, that rows of the parts above should give here; any other label
        costs one more row.
    """

    __slots__ = ("best", "cell", "counts", "label", "members", "mixed", "up")

    def __init__(self, up: int, cell: Tuple[int, int], members: Indices) -> None:
        self.up = up
        self.cell = cell
        self.members = members
        self.label = -1
        self.mixed = False
        self.best = 0
        self.counts: Dict[int, int] = {}


class _Tree:
    """Splits markings until all of a part have the same label.

    :param labels: of each marking; 0: no robot moves.
    :param spoken: label -> a number for the places that its rows apply to. A row only overrides
        another one that applies to the same places.
    """

    def __init__(
        self, markings: Indices, labels: Indices, spoken: Sequence[int], watch: Watch
    ) -> None:
        self._labels = labels
        self._spoken = np.asarray(spoken, dtype=np.int64)
        self._watch = watch
        varying = (
            np.flatnonzero((markings != markings[:1]).any(axis=0))
            if len(markings)
            else np.zeros(0, dtype=np.int64)
        )
        self._columns = varying.tolist()
        values = markings[:, varying].astype(np.int64)
        self._values = values
        spans = values.max(axis=0) + 1 if len(values) else np.zeros(0, dtype=np.int64)
        self._starts = np.concatenate([[0], np.cumsum(spans)]).astype(np.int64)
        self._codes = values + self._starts[:-1]
        self._nodes: List[_Node] = []
        if len(markings):
            self._grow()
            self._choose()

    def _grow(self) -> None:
        todo = [_Node(-1, (-1, 0), np.arange(len(self._labels)))]
        while todo:
            node = todo.pop()
            number = len(self._nodes)
            self._nodes.append(node)
            if number % 256 == 0:
                self._watch.step("parts", number)
            labels = self._labels[node.members]
            if (labels == labels[0]).all():
                node.label = int(labels[0])
                continue
            found, compact = np.unique(labels, return_inverse=True)
            spoken = self._spoken[found]
            node.mixed = bool((spoken != spoken[0]).any() or found[0] == 0)
            column = self._best_column(node.members, compact, len(found))
            values = self._values[node.members, column]
            order = np.argsort(values, kind="stable")
            ends = np.flatnonzero(np.diff(values[order])) + 1
            for part in np.split(node.members[order], ends):
                cell = self._columns[column], int(self._values[part[0], column])
                todo.append(_Node(number, cell, part))

    def _best_column(self, members: Indices, labels: Indices, kinds: int) -> int:
        """The column with the smallest remaining impurity. :raises PolicyError: all columns are
        equal."""
        if not self._columns:
            raise PolicyError("one marking has two decisions")
        width = int(self._starts[-1])
        keys = self._codes[members] * kinds + labels.reshape(-1, 1)
        counts = np.bincount(keys.ravel(), minlength=width * kinds).reshape(width, kinds)
        sizes = counts.sum(axis=1)
        squares = (counts * counts).sum(axis=1) / np.maximum(sizes, 1)
        starts = self._starts[:-1]
        pure = np.add.reduceat(squares, starts)
        parts = np.add.reduceat((sizes > 0).astype(np.int64), starts)
        pure[parts < 2] = -1.0
        best = int(np.argmax(np.round(pure, 9)))
        if parts[best] < 2:
            raise PolicyError("one marking has two decisions")
        return best

    def _choose(self) -> None:
        """From the leaves to the root: find the labels that need the fewest rows in each part."""
        for number in range(len(self._nodes) - 1, -1, -1):
            node = self._nodes[number]
            if node.label >= 0:
                node.best = 1 << node.label if node.label else 0
                node.mixed = node.label == 0
            elif not node.mixed:
                most = max(node.counts.values())
                node.best = sum(1 << label for label, n in node.counts.items() if n == most)
            if node.up >= 0:
                above = self._nodes[node.up].counts
                best = node.best
                while best:
                    label = best.bit_length() - 1
                    above[label] = above.get(label, 0) + 1
                    best ^= 1 << label

    def rows(self) -> List[Tuple[Cells, int]]:
        """The rows: cells and label."""
        found: List[Tuple[Cells, int]] = []
        cells: List[Cells] = []
        says: List[int] = []  # the label given by the rows of a part and of those above it
        for node in self._nodes:
            mine: Cells = ()
            label = 0
            if node.up >= 0:
                mine = tuple(sorted((*cells[node.up], node.cell)))
                label = says[node.up]
            if not node.mixed and not (label and node.best >> label & 1):
                label = self._most_frequent(node)
                found.append((mine, label))
            cells.append(mine)
            says.append(label)
        return found

    def _most_frequent(self, node: _Node) -> int:
        """Of the best labels, the most frequent one; of these, the first."""
        if node.label >= 0:
            return node.label
        counts = np.bincount(self._labels[node.members])
        best = [label for label in range(len(counts)) if node.best >> label & 1]
        return max(best, key=lambda label: (counts[label], -label))


def _verify(asked: _Asked, policy: Policy, watch: Watch) -> None:
    """Look up every marking in the policy. :raises PolicyError: it decides differently."""
    net = asked.net
    table = policy.bind(net)
    for group in asked.groups:
        for p in group.places:
            leaving = [t for t in group.transitions if t in net.consumers[p]]
            choices, labels = asked.effective(leaving)
            for done, number in enumerate(np.flatnonzero(asked.cares(p)).tolist()):
                if done % 4096 == 0:
                    watch.step("markings", done)
                marking = asked.markings[number].tolist()
                said = table.choices(marking, p)
                found = dict(said or ())
                wanted = dict(choices[labels[number]])
                if not any(asked.enabled[t][number] for t in found):
                    found = {}
                if (
                    found.keys() != wanted.keys()
                    or any(abs(found[t] - v) > SAME_PROBABILITY for t, v in wanted.items())
                    or said is None
                ):
                    raise PolicyError(
                        "the merged rows decide differently for a robot in %s in the marking %s"
                        % (net.places[p].name, net.named(marking, zeros=False))
                    )
