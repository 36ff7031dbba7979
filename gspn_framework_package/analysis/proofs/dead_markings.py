"""Proofs that a net, or a run of a plan, never gets stuck.

A marking is dead if nothing is enabled in it. Priorities do not matter: where anything is enabled,
something of the highest priority is. In a plan, a marking is also dead if the policy chooses
nothing that is enabled; those in which every robot has reached an end, or that fulfil ``until``,
are not.

Everything is asked of a program that has more solutions than there are dead markings. What a policy
forbids on the way is left out: it only makes fewer markings reachable. What it forbids in the
marking itself makes more markings dead, so a transition is only required to be disabled where the
policy surely lets a robot choose it.
"""

from __future__ import annotations

import time
from typing import Dict, Iterator, List, Optional, Sequence, Set, Tuple

from gspn_framework_package.analysis.plan.edited_nets import counts_that_end, with_losses
from gspn_framework_package.analysis.plan.structure import terminal_places
from gspn_framework_package.analysis.proofs.program import MarkingProgram
from gspn_framework_package.analysis.structure.invariants import place_invariants
from gspn_framework_package.analysis.structure.siphons import Directions, largest_trap
from gspn_framework_package.analysis.watch import Cancel
from gspn_framework_package.model.errors import CancelledError, LimitError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

MOST_DRAWS = 20_000
"""Most choices of rows of a policy that a proof follows."""

INVARIANT_STEPS = 200_000
"""Longest search for the invariants that bound the places, in steps."""


def never_dead(net: Net, seconds: float, cancel: Optional[Cancel] = None) -> bool:
    """Whether it is proven that no reachable marking of a net is dead. False leaves it open.

    :param seconds: time limit.
    :raises CancelledError: ``cancel`` returned true.
    """
    try:
        program = MarkingProgram(net, place_invariants(net, INVARIANT_STEPS))
        for t in _simplest_first(net):
            program.require_disabled(t)
        return _impossible(program, net, seconds, cancel)
    except LimitError:
        return False


def plan_never_dead(
    plan: Plan, seconds: float, *, losses: bool, cancel: Optional[Cancel] = None
) -> bool:
    """Whether it is proven that no run of a plan reaches a dead marking. False leaves it open.

    :param seconds: time limit.
    :param losses: whether robots can be lost.
    :raises CancelledError: ``cancel`` returned true.
    """
    try:
        stuck = _StuckPlan(plan, losses)
        return _impossible(stuck.program, stuck.net, seconds, cancel)
    except LimitError:
        return False


def _simplest_first(net: Net) -> List[int]:
    """The numbers of the transitions, those of few conditions first: what they require limits
    places, and so simplifies the conditions of others."""
    return sorted(
        range(len(net.transitions)), key=lambda t: len(net.inputs[t]) + len(net.inhibitors[t])
    )


def _impossible(
    program: MarkingProgram, net: Net, seconds: float, cancel: Optional[Cancel]
) -> bool:
    """Whether no reachable marking of ``net`` fulfils the conditions of ``program``.

    A solution in which a trap is empty that is marked at the start is not reachable: no firing
    empties a marked trap, whatever else is required of firings. It is excluded, and another one
    sought.
    """
    end = time.monotonic() + seconds
    arcs: Optional[Directions] = None
    while time.monotonic() < end:
        if cancel is not None and cancel():
            raise CancelledError("cancelled during a proof")
        solution = program.solve(end - time.monotonic())
        if solution is None:
            return True
        arcs = arcs or Directions(net)
        empty = [place.name for place, n in zip(net.places, solution) if n < 0.5]
        trap = [net.place_number(name) for name in largest_trap(net, empty, arcs=arcs)]
        if not any(net.places[p].tokens for p in trap):
            return False
        program.add_row(dict.fromkeys(trap, 1), 1, float("inf"))
    return False


class _StuckPlan:
    """The program of the dead markings of a plan: ``net`` is the untimed net without the counters
    that nothing reads, with the losses of robots if these are asked for.

    ``until`` ends a run in markings that are not dead. The firings after it are not excluded, which
    only adds markings.
    """

    def __init__(self, plan: Plan, losses: bool) -> None:
        self._plan = plan
        net = plan.net.without_places(plan.counters)
        self._own = len(net.transitions)
        invariants = place_invariants(net, INVARIANT_STEPS)
        self.net = net = with_losses(net, plan, set(plan.counters)) if losses else net
        self.program = MarkingProgram(net, invariants)
        self._robots = {
            p for p, place in enumerate(net.places) if place.name not in plan.resource_places
        }
        self._some_robot_is_not_at_an_end()
        self._run_is_not_over()
        for t in _simplest_first(plan.net):
            if net.transitions[t].timed or not any(p in self._robots for p, _ in net.inputs[t]):
                self.program.require_disabled(t)
        rows = _RowsOfPlaces(plan)
        self._matches: Dict[int, int] = {}
        self._followed = 0
        for p in sorted(self._robots):
            self._policy_moves_nobody(p, rows)

    def _some_robot_is_not_at_an_end(self) -> None:
        ends = {self._plan.net.places[p].name for p in terminal_places(self._plan)}
        busy = {p: 1 for p in self._robots if self.net.places[p].name not in ends}
        self.program.add_row(busy, 1, float("inf"))

    def _run_is_not_over(self) -> None:
        for name, count in counts_that_end(self.net, self._plan):
            self.program.limit(self.net.place_number(name), count - 1)

    def _policy_moves_nobody(self, p: int, rows: _RowsOfPlaces) -> None:
        """Require that the policy lets no robot in place number ``p`` choose what is enabled."""
        program, transitions = self.program, self.net.transitions
        leaving = [t for t in self.net.consumers[p] if t < self._own and not transitions[t].timed]
        if not leaving:
            return
        original = self._plan.net.place_number(self.net.places[p].name)
        seen: List[int] = []
        for number, chosen in rows.of(original):
            fails: List[int] = []
            for place, count in self._cells(number):
                fails += [program.at_most(place, count - 1), program.at_least(place, count + 1)]
            others = [self._match(other) for other in seen if self._overlap(other, number)]
            for t in chosen:
                program.require_disabled(t, otherwise=[*fails, *others])
            seen.append(number)
            self._spend(1 + len(seen) // 10 + len(chosen))  # each row is compared with those before
        if self._plan.strict:
            return
        scope = self._plan.policy.bind(self._plan.net).rows_of(original)
        some_row = [program.any_of([self._match(number) for number in scope])] if scope else []
        for t in leaving:
            if not transitions[t].is_controllable:
                program.require_disabled(t, otherwise=some_row)

    def _spend(self, steps: int) -> None:
        self._followed += steps
        if self._followed > MOST_DRAWS:
            raise LimitError("not decided: the policy is too large for a proof")

    def _cells(self, number: int) -> Iterator[Tuple[int, int]]:
        """The places and counts that a row asks for."""
        policy = self._plan.policy
        for name, count in zip(policy.places, policy.rows[number].counts):
            if count is not None:
                yield self.net.place_number(name), count

    def _match(self, number: int) -> int:
        """The term for: row ``number`` matches."""
        if number not in self._matches:
            terms: List[int] = []
            for place, count in self._cells(number):
                terms += [self.program.at_most(place, count), self.program.at_least(place, count)]
            self._matches[number] = self.program.all_of(terms)
            self._spend(1)
        return self._matches[number]

    def _overlap(self, first: int, second: int) -> bool:
        """Whether two rows match a common marking."""
        rows = self._plan.policy.rows
        return all(
            None in cells or cells[0] == cells[1]
            for cells in zip(rows[first].counts, rows[second].counts)
        )


class _RowsOfPlaces:
    """The rows of a policy that decide for each place, by precedence."""

    def __init__(self, plan: Plan) -> None:
        policy, net = plan.policy, plan.net
        scope_of = {net.place_number(name): k for name, k in policy.scope_numbers().items()}
        row_scope = policy.row_scopes()
        self._rows = policy.rows
        self._scope_of = scope_of
        self._chosen: Dict[int, Dict[int, Set[int]]] = {}  # place -> row -> transitions
        self._waits: Dict[int, List[int]] = {}  # scope -> its rows without choices
        for number, row in enumerate(policy.rows):
            if not row.choices:
                self._waits.setdefault(row_scope[number], []).append(number)
            for name, probability in row.choices:
                t = net.transition_number(name)
                for p, _ in net.inputs[t]:
                    if probability > 0 and scope_of.get(p, 0) == row_scope[number]:
                        self._chosen.setdefault(p, {}).setdefault(number, set()).add(t)

    def of(self, place: int) -> Iterator[Tuple[int, Sequence[int]]]:
        """The rows that decide for place number ``place``, by precedence, each with the transitions
        that it lets a robot choose there; those without any let robots wait."""
        chosen = self._chosen.get(place, {})
        numbers = {*chosen, *self._waits.get(self._scope_of.get(place, 0), ())}
        for number in sorted(numbers, key=lambda n: (self._rows[n].counts.count(None), n)):
            yield number, sorted(chosen.get(number, ()))
