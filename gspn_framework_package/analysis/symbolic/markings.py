"""All reachable markings of a bounded net, counted without visiting them one by one.

They are one decision diagram (see :mod:`~gspn_framework_package.analysis.symbolic.kernel`), from
which the counts are read off. Several orders of the places run in turns, and the first that ends
wins, since no rule predicts which of them keeps the diagram small.
"""

from __future__ import annotations

from typing import Dict, Iterable, Iterator, List, NamedTuple, Optional, Tuple

from gspn_framework_package.analysis.limits import DEFAULT_MEMORY
from gspn_framework_package.analysis.symbolic.kernel import IDENTITY, NO_MARKING, UNIT
from gspn_framework_package.analysis.symbolic.machine import PLAIN, KernelForm, Machine, best_form
from gspn_framework_package.analysis.symbolic.ordering import PlaceOrder, promising_orders
from gspn_framework_package.analysis.symbolic.steps import (
    NO_CONDITION,
    NO_STEP,
    FiringRule,
    Precedence,
    StepTable,
    TooManyCasesError,
    rule_of,
)
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.formats.symbolic import priority_levels
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net

_FIRST_TURNS = 2_000
"""Operations of each order in the first round; each round doubles them."""

_PLAIN_TURNS = 100_000
"""Operations of all orders together, in plain Python (a second), before the compiled form takes
over: loading that takes as long."""

_ORDERS = 10
"""Largest number of orders to try."""

_SLICE = {False: 10_000, True: 1_000_000}
"""Operations between two checks of the clock, plain and compiled: a tenth of a second."""


_ROWS_AT_ONCE, _ROWS_EACH = 20_000, 16
"""Rows of a step from the markings that enable none of some transitions (a tenth of a second), and
rows for each place that they ask; if it takes more, there is one step for half of them."""


class MarkingCounts(NamedTuple):
    """Properties of all reachable markings.

    :ivar total: number of reachable markings.
    :ivar tangible: of these, how many enable no immediate transition.
    :ivar arcs: number of pairs of a marking and a transition that fires in it.
    :ivar bounds: place -> most tokens that it holds.
    :ivar most_tokens: most tokens in a marking.
    :ivar dead: number of markings that enable no transition.
    :ivar dead_marking: one of them; None if there is none.
    :ivar dead_transitions: the transitions that never fire.
    :ivar nodes: number of nodes of the diagram.
    :ivar memory: bytes of the arrays of all diagrams.
    """

    total: int
    tangible: int
    arcs: int
    bounds: Dict[str, int]
    most_tokens: int
    dead: int
    dead_marking: Optional[Dict[str, int]]
    dead_transitions: List[str]
    nodes: int
    memory: int


def count_markings(
    net: Net,
    together: Iterable[Iterable[str]] = (),
    *,
    memory: float = DEFAULT_MEMORY,
    watch: Optional[Watch] = None,
    form: Optional[KernelForm] = None,
) -> MarkingCounts:
    """Count the reachable markings of a net.

    :param together: names of places that belong together, such as those of a place invariant; they
        only help to find a good order.
    :param memory: most bytes for the diagrams.
    :param watch: reports the number of nodes, and may stop the work.
    :param form: the form of the kernel; None: plain at first, then compiled if numba is installed.
    :raises LimitError: not decided within the memory, or within the time of the watch. An unbounded
        net always ends so.
    :raises CancelledError: the watch was cancelled.
    """
    number = net.place_index
    groups = [[number[name] for name in names if name in number] for names in together]
    orders = promising_orders(net, [group for group in groups if group])[:_ORDERS]
    watch = watch or Watch()
    diagrams = [_Diagram(net, order) for order in orders]
    found = None
    if form is None:
        found = _race(diagrams, PLAIN, memory, watch, _PLAIN_TURNS)
        form = best_form()
    if found is None:
        found = _race(diagrams, form, memory, watch)
    assert found is not None
    return _Counting(found, memory, watch).counts()


class _Diagram:
    """The set of reachable markings under one order of the places, as far as it was found."""

    def __init__(self, net: Net, order: PlaceOrder) -> None:
        self.net = net
        self.order = order
        self.levels = len(order)
        self.level_of = [0] * self.levels
        for i, p in enumerate(order):
            self.level_of[p] = self.levels - i
        self.rules = [rule_of(net, t, self.level_of) for t in range(len(net.transitions))]
        self._table: Optional[StepTable] = None

    def begin(self, form: KernelForm, watch: Watch) -> None:
        """Begin from the initial marking.

        :raises TooManyCasesError: the steps of this order are too large.
        :raises LimitError: making them took too long.
        """
        if self._table is None:
            self._table = self._steps(watch)
        self.table = self._table
        self.form = form
        self.machine = Machine(form, self.table.lists())
        self.root = UNIT
        self._level = 0
        self._next_level()

    def _steps(self, watch: Watch) -> StepTable:
        table = StepTable(self.levels)
        above: List[FiringRule] = []
        for numbers in _by_precedence(self.net):
            rules = [rule for rule in (self.rules[t] for t in numbers) if rule is not None]
            precedence = Precedence(above)
            for done, rule in enumerate(rules):
                watch.step("transitions", done)
                if rule.change:
                    step = table.step(rule, precedence, closing=True)
                    if step != NO_STEP:
                        table.fire_from(step)
            above = above + rules
        return table

    def go_on(self, turns: int) -> None:
        """Continue for about this many operations, or until it is done or needs more room."""
        until = self.machine.work + turns
        while not self.done and self.machine.work < until:
            if not self.machine.go_on(until - self.machine.work):
                return
            self.root = self.machine.result
            self._next_level()

    def _next_level(self) -> None:
        self._level += 1
        self.done = self._level > self.levels
        if not self.done:
            tokens = self.net.initial_marking[self.order[self.levels - self._level]]
            self.machine.begin_close(self._level, tokens, self.root)


def _by_precedence(net: Net) -> List[List[int]]:
    """The transitions in classes, each of which takes precedence over those after it."""
    exponential = [t for t, transition in enumerate(net.transitions) if transition.timed]
    return [*priority_levels(net), exponential]


def _race(
    diagrams: List[_Diagram],
    form: KernelForm,
    memory: float,
    watch: Watch,
    most: Optional[int] = None,
) -> Optional[_Diagram]:
    """The first diagram that is complete; None if none is after ``most`` operations in total.

    Each round has twice as many diagrams as the last, and gives each twice as many operations.
    """
    turns, contestants, spent = _FIRST_TURNS, 1, 0
    left = list(diagrams)
    running: List[_Diagram] = []
    while True:
        for diagram in left[:contestants]:
            if diagram not in running:
                try:
                    diagram.begin(form, watch)
                except TooManyCasesError:
                    left.remove(diagram)
                    if not left:
                        raise
                    continue
                running.append(diagram)
            until = diagram.machine.work + turns
            while diagram in running and diagram.machine.work < until:
                # whatever grows needs the old and the new at the same time
                if sum(each.machine.memory for each in running) > memory / 2:
                    largest = max(running, key=lambda each: each.machine.memory)
                    if len(left) == 1:
                        raise _no_room(memory, largest.machine.nodes)
                    left.remove(largest)
                    running.remove(largest)
                    continue
                diagram.go_on(min(until - diagram.machine.work, _SLICE[form.compiled]))
                if diagram.done:
                    return diagram
                watch.step("nodes", sum(each.machine.nodes for each in running))
            spent += turns
            if most is not None and spent > most:
                return None
        turns *= 2
        contestants *= 2


def _no_room(memory: float, nodes: int) -> LimitError:
    return LimitError(
        "not decided within %.3g GB (%s nodes)" % (memory / 1e9, format(nodes, ",")),
        hint="raise --limit-memory",
    )


class _Counting:
    """Reads the counts off a complete diagram."""

    def __init__(self, diagram: _Diagram, memory: float, watch: Watch) -> None:
        self._diagram = diagram
        self._memory = memory
        self._watch = watch
        self._below: Dict[int, int] = {NO_MARKING: 0, UNIT: 1}

    def counts(self) -> MarkingCounts:
        """All counts."""
        diagram = self._diagram
        net = diagram.net
        levels = self._nodes_by_level(diagram.root)
        remaining, tangible, arcs = diagram.root, 0, 0
        never: List[int] = []
        for numbers in _by_precedence(net):
            tangible = self._count(remaining)  # that of the last class, the exponential ones
            by_level = self._nodes_by_level(remaining)
            ways = self._ways_to(remaining, by_level)
            for t in numbers:
                rule = diagram.rules[t]
                fires = 0 if rule is None else self._enabled(rule, by_level, ways)
                arcs += fires
                if not fires:
                    never.append(t)
            remaining = self._without(remaining, numbers)
        return MarkingCounts(
            total=self._count(diagram.root),
            tangible=tangible,
            arcs=arcs,
            bounds=self._bounds(levels),
            most_tokens=self._most_tokens(levels),
            dead=self._count(remaining),
            dead_marking=self._example(remaining),
            dead_transitions=[net.transitions[t].name for t in sorted(never)],
            nodes=sum(len(nodes) for nodes in levels),
            memory=diagram.machine.memory,
        )

    def _nodes_by_level(self, root: int) -> List[List[int]]:
        """The nodes of a set, by level, that of the root last; ascending."""
        found = [[root] if root != NO_MARKING else []]
        for _ in range(self._diagram.levels):
            self._watch.step("nodes", sum(map(len, found)))
            below = {c for node in found[-1] for c in self._children(node)[1]}
            below.discard(NO_MARKING)
            found.append(sorted(below))
        return found[::-1]

    def _children(self, node: int) -> Tuple[int, List[int]]:
        return self._diagram.machine.children(node)

    def _count(self, root: int) -> int:
        """The number of markings of a set."""
        below = self._below
        if root not in below:
            for nodes in self._nodes_by_level(root)[1:]:
                for node in nodes:
                    if node not in below:
                        below[node] = sum(below[c] for c in self._children(node)[1])
        return below[root]

    def _ways_to(self, root: int, levels: List[List[int]]) -> Dict[int, int]:
        """For each node of a set, the number of markings of the places above it."""
        ways: Dict[int, int] = {root: 1}
        for nodes in reversed(levels[1:]):
            self._watch.step("nodes", len(ways))
            for node in nodes:
                here = ways[node]
                for child in self._children(node)[1]:
                    if child != NO_MARKING:
                        ways[child] = ways.get(child, 0) + here
        return ways

    def _enabled(self, rule: FiringRule, levels: List[List[int]], ways: Dict[int, int]) -> int:
        """The number of markings of a set in which a guard holds."""
        if not rule.guard:
            return sum(ways[node] * self._count(node) for node in levels[-1])
        highest, lowest = max(rule.guard), min(rule.guard)
        known: Dict[int, int] = {}
        for level in range(lowest, highest + 1):
            least, below = rule.guard.get(level, (0, None))
            above: Dict[int, int] = {}
            for node in levels[level]:
                low, children = self._children(node)
                begin = max(least - low, 0)
                end = len(children) if below is None else max(below - low, 0)
                part = children[begin:end]
                values = self._below if level == lowest else known
                above[node] = sum(values[c] for c in part if c != NO_MARKING)
            known = above
        return sum(ways[node] * value for node, value in known.items())

    def _without(self, root: int, transitions: Iterable[int]) -> int:
        """The markings of a set that enable none of these transitions."""
        diagram = self._diagram
        rules = [rule for rule in (diagram.rules[t] for t in transitions) if rule is not None]
        rules.sort(key=lambda rule: (max(rule.guard, default=0), min(rule.guard, default=0)))
        steps = list(self._none_enabled(rules))
        diagram.machine.use(diagram.table.lists())
        for step in steps:
            if step == NO_STEP or root == NO_MARKING:
                return NO_MARKING
            if step == IDENTITY:
                continue
            diagram.machine.begin_step(diagram.levels, step, root)
            while not diagram.machine.go_on(_SLICE[diagram.form.compiled]):
                self._watch.step("nodes", diagram.machine.nodes)
                if diagram.machine.memory > self._memory / 2:
                    raise _no_room(self._memory, diagram.machine.nodes)
            root = diagram.machine.result
        return root

    def _none_enabled(self, rules: List[FiringRule]) -> Iterator[int]:
        """Steps from the markings in which none of these rules is enabled, to be taken one after
        the other: one for as many rules as it stays small for."""
        number = len(rules)
        while rules:
            some = rules[:number]
            rows = min(_ROWS_AT_ONCE, _ROWS_EACH * sum(len(rule.guard) for rule in some))
            try:
                yield self._diagram.table.step(NO_CONDITION, Precedence(some), most_rows=rows)
            except TooManyCasesError:
                if number == 1:
                    raise
                number = min(number, len(some)) // 2
            else:
                rules = rules[number:]
                self._watch.step("transitions", len(rules))

    def _bounds(self, levels: List[List[int]]) -> Dict[str, int]:
        diagram = self._diagram
        most = [0] * diagram.levels
        for level, nodes in enumerate(levels[1:], 1):
            p = diagram.order[diagram.levels - level]
            for node in nodes:
                low, children = self._children(node)
                most[p] = max(most[p], low + len(children) - 1)
        return {place.name: most[p] for p, place in enumerate(diagram.net.places)}

    def _most_tokens(self, levels: List[List[int]]) -> int:
        most: Dict[int, int] = {UNIT: 0}
        for nodes in levels[1:]:
            for node in nodes:
                low, children = self._children(node)
                most[node] = max(
                    low + i + most[c] for i, c in enumerate(children) if c != NO_MARKING
                )
        return most[self._diagram.root]

    def _example(self, root: int) -> Optional[Dict[str, int]]:
        """The marking of a set with the fewest tokens in the highest places; None if it is
        empty."""
        if root == NO_MARKING:
            return None
        diagram = self._diagram
        marking = [0] * diagram.levels
        for p in diagram.order:
            low, children = self._children(root)
            marking[p], root = low, int(children[0])
        return diagram.net.named(marking, zeros=False)
