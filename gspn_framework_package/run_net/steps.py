"""What happens in a state of a run net, under the policy of its plan.

After each event (an action is done, a transition has fired) the following is repeated in zero time,
as in ``execution/turn.py``:

1. ``until`` ends the run.
2. Transitions that only take resources fire, by priority and weight.
3. Robots that ask the policy draw. A draw holds until the marking changes, or until the candidates
   do: a partner that becomes done can make one of higher priority possible. A partner that becomes
   done does not change the marking.
4. Among the requests that can fire, the most urgent goes first: immediate transitions by priority,
   then exponential ones. Between equals chance decides: each is equally likely.
5. A transition takes robots that are done and free for it: those that named it, and, if it is
   immediate, those that ask the policy, whatever they have drawn. Each of them is equally likely.
6. One of the robots is done whose action takes no time.

Rates and probabilities leave a state accordingly: phases end at their rates, the outcome of an
action is drawn when it is done, and exponential transitions race.
"""

from __future__ import annotations

import itertools
import math
from operator import itemgetter
from typing import Callable, Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np

from gspn_framework_package.model.net import Marking
from gspn_framework_package.model.plan_timing import POLICY
from gspn_framework_package.run_net.columns import End, spread
from gspn_framework_package.run_net.requests import Requests, by_weight, first_to_fire
from gspn_framework_package.run_net.run_net import RunNet, State

_TINY = 1e-12
"""A probability below this is a rounding error."""


class RunStep(NamedTuple):
    """A step to ``target``: ``label`` is the number of the transition that fires, or ``waits`` or
    ``ends`` of :class:`Steps`; ``value`` is a rate (1/s), or a probability in zero time."""

    target: State
    label: int
    value: float


_BLOCK = 1 << 12
"""Number of states whose counts are in one array, as at most eight bytes each."""


def _rows(states: Sequence[State]) -> np.ndarray:
    """The counts of states, one row each."""
    try:
        counts = np.frombuffer(b"".join(map(bytes, states)), dtype=np.uint8)
    except ValueError:  # more than 255 in a column
        counts = np.array(states, dtype=np.int64)
    return counts.reshape(len(states), -1)


def _counts_in(columns: Sequence[int]) -> Callable[[State], Sequence[int]]:
    """A function that returns the counts in some columns of a state: a plan with many phases has
    hundreds, most of them empty."""
    if len(columns) > 1:
        return itemgetter(*columns)
    return lambda state: [state[column] for column in columns]


class Steps:
    """The steps between the states of a run net.

    :ivar start: the first state: that in which the run begins, or before chance has drawn it.
    :ivar waits, ends: labels of steps in which nothing fires: robots have drawn and wait; a phase
        of an action ends, or the action is done.
    """

    BEGIN: State = ()

    def __init__(self, run_net: RunNet) -> None:
        self.run_net = run_net
        net = run_net.net
        self._net, self._draws = net, run_net.draws
        self.waits, self.ends = len(net.transitions), len(net.transitions) + 1
        self._immediate = [
            t for t, transition in enumerate(net.transitions) if not transition.timed
        ]
        self._deciding = [p for p, c in run_net.columns.items() if c.asking >= 0]
        # columns of robots that may have something to do in zero time, each with its place
        self._waiting = [
            (column, p)
            for p, c in run_net.columns.items()
            for column in (*c.named.values(), *c.at_policy)
        ]
        self._counts_waiting = _counts_in([column for column, _ in self._waiting])
        # where robots at the policy go when the marking changes, and when they have drawn nothing
        asked = [c for c in run_net.columns.values() if c.asking >= 0]
        self._draws_end = [
            (column, c.asking) for c in asked for column in c.at_policy if column != c.asking
        ]
        self._rests = [(c.asking, c.idle) for c in asked]
        self._arriving = [
            (column, p) for p, c in sorted(run_net.columns.items()) for column in c.arriving
        ]
        self._working = [
            (p, *phase)
            for p, c in run_net.columns.items()
            for attempt in c.attempts
            for phase in zip(attempt.columns, attempt.rates, attempt.following)
        ]
        self._counts_working = _counts_in([column for _, column, _, _ in self._working])
        self._settled: Dict[State, State] = {}
        # of states that are not expanded yet: the steps of vanishing ones, the markings of others
        self._pending: Dict[State, List[RunStep]] = {}
        self._markings: Dict[State, Marking] = {}
        begin = run_net.begin
        self.start = self._settle(begin[0][0]) if len(begin) == 1 else self.BEGIN

    # -- states ------------------------------------------------------------------------------------

    def expand(self, state: State) -> Tuple[bool, List[RunStep]]:
        """Whether a state is vanishing, and its steps to states in canonical form. Call it once for
        each state."""
        if state == self.BEGIN:
            begin = self.run_net.begin
            return True, [RunStep(self._settle(first), self.ends, v) for first, v in begin]
        self._settle(state)
        pending = self._pending.pop(state, None)
        steps = self._in_time(state, self._markings.pop(state)) if pending is None else pending
        return pending is not None, [
            RunStep(self._settle(s.target), s.label, s.value) for s in steps
        ]

    def markings(self, states: Sequence[State]) -> np.ndarray:
        """The markings of states, one row each."""
        first = self.run_net.first_columns
        add = np.add.reduceat
        return self._blocks(states, lambda counts: add(counts, first, axis=1, dtype=np.int64))

    def counts(self, states: Sequence[State], columns: Sequence[int]) -> np.ndarray:
        """The counts in some columns of states, one row each."""
        return self._blocks(states, lambda counts: counts[:, columns])

    def _blocks(
        self, states: Sequence[State], of: Callable[[np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """Results of ``of`` for all states, block by block: the counts in all columns would take
        much memory at once."""
        start = self.run_net.begin[0][0]
        found = []
        for first in range(0, len(states), _BLOCK):
            block = [state or start for state in states[first : first + _BLOCK]]
            found.append(of(_rows(block)).astype(np.int32))
        return np.concatenate(found)

    def _settle(self, state: State) -> State:
        found = self._settled.get(state)
        if found is None:
            marking = self.run_net.marking(state)
            found, steps = self._one_form(state, marking)
            if found not in self._settled:
                self._settled[found] = found
                if steps:
                    self._pending[found] = steps
                else:
                    self._markings[found] = marking
            self._settled[state] = found
        return found

    def _one_form(self, state: State, marking: Marking) -> Tuple[State, List[RunStep]]:
        """The state in canonical form, and its steps in zero time, if there are any."""
        if self.run_net.has_ended(state, marking):
            return self._at_rest(state), []
        while True:
            steps = self._at_once(state, marking)
            if steps:
                return state, steps
            state = self._at_rest(state)
            done = self._arrived(state, marking)
            if len(done) != 1:
                return state, done
            state = done[0].target

    def _at_rest(self, state: State) -> State:
        """The state after all robots that ask the policy have drawn nothing that can ever fire
        here."""
        counts: Optional[List[int]] = None
        for column, idle in self._rests:
            if state[column]:
                counts = counts or list(state)
                counts[idle] += counts[column]
                counts[column] = 0
        return state if counts is None else tuple(counts)

    # -- in time -----------------------------------------------------------------------------------

    def _in_time(self, state: State, marking: Marking) -> List[RunStep]:
        """What happens in a state in which nothing happens in zero time: steps with rates."""
        run_net, net = self.run_net, self._net
        if self.run_net.has_ended(state, marking):
            return []
        steps: List[RunStep] = []
        for column, rates in run_net.racing:
            if state[column]:
                for t, rate in rates:
                    steps += self._fires(state, t, ((column, 1),), state[column] * rate)
        working = itertools.compress(self._working, self._counts_working(state))
        for p, column, rate, following in working:
            robots = state[column]
            if following >= 0:
                counts = list(state)
                counts[column] -= 1
                counts[following] += 1
                steps.append(RunStep(tuple(counts), self.ends, robots * rate))
            else:
                for end in run_net.columns[p].ends[column]:
                    steps += self._ended(state, marking, p, column, end, robots * rate)
        for t, rate, where in run_net.interrupts:
            if net.is_enabled(marking, t):
                for column in where:
                    if state[column]:
                        steps += self._fires(state, t, ((column, 1),), state[column] * rate)
        for t, taken, split in run_net.races:
            if net.is_enabled(marking, t):
                for columns, w in split:
                    taken += _pick(state, (columns,), (w,))
                steps += self._fires(state, t, taken, net.effective_rate(marking, t))
        return steps

    def _ended(
        self, state: State, marking: Marking, p: int, column: int, end: End, rate: float
    ) -> Iterator[RunStep]:
        """The steps when an attempt of a robot in ``column`` of place ``p`` ends in this way;
        attempts end at ``rate`` in all."""
        counts = self._after_end(state, column, end)
        rate *= end.probability
        asked = end.request is not None and self._ask_again(
            state, marking, counts, self.run_net.watching[p]
        )
        target = tuple(counts)
        t = end.request
        if t is None or t == POLICY or asked or not self._can_fire(target, marking, t):
            yield RunStep(target, self.ends, rate)
            return
        # Whoever waited could not fire before, so only this request can fire now.
        for taken, v in self._takings(target, t, end.column):
            yield from self._fires(target, t, taken, rate * v)

    def _ask_again(
        self,
        before: Sequence[int],
        marking: Marking,
        counts: List[int],
        places: Sequence[int],
    ) -> bool:
        """Let robots at the policy, which have drawn, draw again where the candidates differ from
        those ``before``. Returns whether any do."""
        asked = False
        ready: Optional[Tuple[Set[int], Set[int]]] = None
        for q in places:
            columns = self.run_net.columns[q]
            drawn = (columns.idle, *columns.holding.values())
            if not any(counts[c] for c in drawn):
                continue
            if ready is None:
                ready = self._ready(before, marking), self._ready(counts, marking)
            if ready[0] == ready[1]:
                break
            old, new = ([t for t, _ in self._draws.of(marking, q, able)] for able in ready)
            if old != new:
                asked = True
                for c in drawn:
                    counts[columns.asking] += counts[c]
                    counts[c] = 0
        return asked

    # -- in zero time ------------------------------------------------------------------------------

    def _can_fire(self, state: Sequence[int], marking: Marking, t: int) -> bool:
        """Whether ``t`` is enabled and has enough robots that are done and free for it."""
        if t in self.run_net.never or not self._net.is_enabled(marking, t):
            return False
        for _, weight, named, at_policy in self.run_net.takes[t]:
            free = state[named] if named >= 0 else 0
            for column in at_policy:
                free += state[column]
            if free < weight:
                return False
        return True

    def _ready(self, state: Sequence[int], marking: Marking) -> Set[int]:
        """The immediate transitions that can fire."""
        return {t for t in self._immediate if self._can_fire(state, marking, t)}

    def _at_once(self, state: State, marking: Marking) -> List[RunStep]:
        """The steps in zero time, except the ends of actions that take no time."""
        net = self._net
        spontaneous = [t for t in self.run_net.spontaneous if net.is_enabled(marking, t)]
        if not spontaneous and not any(self._counts_waiting(state)):
            return []
        if spontaneous:
            return [
                step
                for t, chance in by_weight(net, marking, spontaneous)
                for step in self._fires(state, t, (), chance)
            ]
        asked = self._requests(state, marking)
        if asked.first and self._may_outlast(state, asked):
            return self._draw_all(state, asked.first, 1.0)
        if not asked.groups:
            return (
                self._draw_all(state, asked.drawing, 1.0)
                if any(robots.kept for robots in asked.drawing)
                else []
            )
        steps: List[RunStep] = []
        whole = 0.0
        fires = first_to_fire(asked.groups, self.run_net.urgency)
        for column, chances in zip(asked.columns, fires):
            for t, chance in chances.items():
                whole += chance
                if chance > 0:
                    for taken, v in self._takings(state, t, column):
                        steps += self._fires(state, t, taken, chance * v)
        if steps and 1.0 - whole > _TINY:
            return steps + self._draw_all(state, asked.drawing, 1.0 - whole)
        return [RunStep(target, t, value / whole) for target, t, value in steps]

    def _requests(self, state: State, marking: Marking) -> _Asked:
        """The requests of the robots that are done."""
        asked = _Asked([], [], [], [])
        for p in dict.fromkeys([p for column, p in self._waiting if state[column]]):
            columns = self.run_net.columns[p]
            ready = {t for t in self._net.consumers[p] if self._can_fire(state, marking, t)}
            for table in (columns.named, columns.holding):
                for t, column in table.items():
                    if state[column] and t in ready:
                        asked.groups.append(Requests(state[column], {t: 1.0}))
                        asked.columns.append(column)
            if columns.asking >= 0 and state[columns.asking]:
                self._ask_policy(asked, state, marking, p, ready)
        return asked

    def _ask_policy(
        self, asked: _Asked, state: State, marking: Marking, p: int, ready: Set[int]
    ) -> None:
        columns = self.run_net.columns[p]
        draw = self._draws.of(marking, p, ready)
        able = {t: v for t, v in draw if t in ready}
        drawn = []
        if columns.holding:
            drawn = [
                (t, v) for t, v in draw if t in columns.holding and self._net.is_enabled(marking, t)
            ]
        if self.run_net.keeps_draws and drawn:
            kept = [(columns.holding[t], v) for t, v in drawn]
            asked.first.append(_Drawing(columns.asking, columns.idle, kept, 1.0))
        kept = [(columns.holding[t], v) for t, v in drawn if t not in ready]
        asked.drawing.append(_Drawing(columns.asking, columns.idle, kept, 1.0 - sum(able.values())))
        if able:
            asked.groups.append(Requests(state[columns.asking], able))
            asked.columns.append(columns.asking)

    def _may_outlast(self, state: State, asked: _Asked) -> bool:
        """Whether one of the requests may fire without resetting the draws of robots that have yet
        to draw. Then all robots draw before anything fires."""
        at_policy = {self.run_net.columns[p].asking for p in self._deciding}
        asking = sum(state[robots.column] for robots in asked.first)
        return any(
            not self.run_net.resets[t] and asking > (column in at_policy)
            for group, column in zip(asked.groups, asked.columns)
            for t in group.draw
        )

    def _draw_all(self, state: State, drawing: Sequence[_Drawing], chance: float) -> List[RunStep]:
        """The steps, with a probability of ``chance`` in all, when all that ask the policy have
        drawn what they keep."""
        found: List[Tuple[List[int], float]] = [(list(state), chance)]
        for column, idle, kept, whole in drawing:
            rest = whole - sum(v for _, v in kept)
            entry = [(to, v / whole) for to, v in kept]
            if rest > _TINY:
                entry.append((idle, rest / whole))
            robots = state[column]
            for counts, _ in found:
                counts[column] -= robots
            found = spread(found, entry, robots)
        return [RunStep(tuple(counts), self.waits, v) for counts, v in found]

    def _arrived(self, state: State, marking: Marking) -> List[RunStep]:
        """The steps when an attempt that takes no time ends, of any of the robots."""
        arriving = [(p, column) for column, p in self._arriving if state[column]]
        total = sum(state[column] for _, column in arriving)
        steps = []
        for p, column in arriving:
            for end in self.run_net.columns[p].ends[column]:
                counts = self._after_end(state, column, end)
                if end.request is not None:
                    self._ask_again(state, marking, counts, self.run_net.watching[p])
                chance = state[column] / total * end.probability
                steps.append(RunStep(tuple(counts), self.ends, chance))
        return steps

    def _after_end(self, state: State, column: int, end: End) -> List[int]:
        """The counts when an attempt of a robot in ``column`` has ended."""
        counts = list(state)
        counts[column] -= 1
        counts[end.column] += 1
        if end.stops:
            counts[self.run_net.stopped] = 1
        return counts

    # -- firing ------------------------------------------------------------------------------------

    def _takings(self, state: State, t: int, requester: int) -> List[Tuple[Taken, float]]:
        """Which robots transition ``t`` takes when one in column ``requester`` asks for it: pairs
        (columns with counts, probability). Any other robots that are free are equally likely."""
        found: List[Tuple[Taken, float]] = [((), 1.0)]
        for _, weight, named, at_policy in self.run_net.takes[t]:
            # If the draws end, all at the policy draw again: they are interchangeable.
            classes = [at_policy] if self.run_net.resets[t] else [(c,) for c in at_policy]
            classes = [((named,) if named >= 0 else ()), *classes]
            free = [sum(state[c] for c in members) for members in classes]
            certain = [int(requester in members) for members in classes]
            ways = _choices([n - sure for n, sure in zip(free, certain)], weight - sum(certain))
            found = [
                (
                    taken + _pick(state, classes, [k + sure for k, sure in zip(way, certain)]),
                    v * u,
                )
                for taken, v in found
                for way, u in ways
            ]
        return found

    def _fires(self, state: State, t: int, taken: Taken, value: float) -> Iterator[RunStep]:
        """The steps, with a rate or probability of ``value`` in all, when ``t`` fires and takes
        these robots."""
        run_net = self.run_net
        counts = list(state)
        for column, n in taken:
            counts[column] -= n
        for column, n in run_net.moves[t]:
            counts[column] += n
        found = [(counts, value)]
        for entry, n in run_net.spreads[t]:
            found = spread(found, entry, n)
        for counts, v in found:
            if run_net.resets[t]:
                for column, asking in self._draws_end:
                    if counts[column]:
                        counts[asking] += counts[column]
                        counts[column] = 0
            else:
                self._ask_again(state, run_net.marking(state), counts, self._deciding)
            yield RunStep(tuple(counts), t, v)


Taken = Tuple[Tuple[int, int], ...]
"""PlaceColumns, each with the number of robots that a transition takes from it."""


class _Drawing(NamedTuple):
    """Robots that ask the policy: those in ``column`` go to ``kept`` columns (pairs with
    probabilities) or else to ``idle``; ``whole`` is the probability that they do either."""

    column: int
    idle: int
    kept: List[Tuple[int, float]]
    whole: float


class _Asked(NamedTuple):
    """The requests of the robots that are done in a state.

    :ivar groups: the requests that can fire, each from one of ``columns``.
    :ivar drawing: the robots that ask the policy, as they draw what cannot fire.
    :ivar first: the same, as they draw anything, where draws may outlast a firing.
    """

    groups: List[Requests]
    columns: List[int]
    drawing: List[_Drawing]
    first: List[_Drawing]


def _choices(numbers: Sequence[int], wanted: int) -> List[Tuple[Tuple[int, ...], float]]:
    """The distribution of how many of ``wanted`` members, chosen at random, are in each class."""
    if sum(numbers) == wanted:
        return [(tuple(numbers), 1.0)]
    ways = math.comb(sum(numbers), wanted)
    return [
        (way, math.prod([math.comb(n, k) for n, k in zip(numbers, way)]) / ways)
        for way in itertools.product(*(range(min(n, wanted) + 1) for n in numbers))
        if sum(way) == wanted
    ]


def _pick(state: State, classes: Sequence[Tuple[int, ...]], numbers: Sequence[int]) -> Taken:
    """A number of robots of each class, in any of its columns."""
    taken = []
    for members, left in zip(classes, numbers):
        for column in members:
            n = min(state[column], left)
            if n:
                taken.append((column, n))
                left -= n
    return tuple(taken)
