"""A plan as the arrays of the kernel."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.simulation import kernel
from gspn_framework_package.analysis.simulation.machine import floats, integers, ragged
from gspn_framework_package.analysis.simulation.net_arrays import (
    compile_condition,
    flattened,
    marking_functions,
    marking_tests,
    numbers_of,
    places_read,
)
from gspn_framework_package.analysis.simulation.policy_book import policy_book
from gspn_framework_package.model.duration import Kind
from gspn_framework_package.model.failure import FailureEnd
from gspn_framework_package.model.plan import LostKind, Plan
from gspn_framework_package.model.plan_timing import (
    FOR_GOOD,
    NO_REQUEST,
    POLICY,
    PlaceVisit,
    PlanTiming,
    rules_of,
)

MOST_AGENTS = 10_000
"""Maximum number of agents in a run that creates them."""

_KINDS: Dict[Any, int] = {
    Kind.EXPONENTIAL: kernel.EXPONENTIAL,
    Kind.ERLANG: kernel.ERLANG,
    Kind.GAMMA: kernel.GAMMA,
    Kind.LOGNORMAL: kernel.LOGNORMAL,
    Kind.DETERMINISTIC: kernel.DETERMINISTIC,
    Kind.UNIFORM: kernel.UNIFORM,
    Kind.EMPIRICAL: kernel.EMPIRICAL,
}
_ENDS = {
    FailureEnd.WAIT: kernel.FAILURE_WAITS,
    FailureEnd.FIRE: kernel.FAILURE_FIRES,
    FailureEnd.STOP: kernel.FAILURE_STOPS,
}


class PlanTables:
    """A plan, prepared for the kernel.

    :param plan: a validated plan.
    :param timing: durations, outcomes and failures.
    :param until: the condition that ends a run, or None.
    :param losses: rate (1/s) at which each robot is lost.
    :ivar means: what the plan means for each of its robots.
    :ivar rules: the plan as arrays.
    :ivar book: its policy as arrays.
    """

    def __init__(
        self, plan: Plan, timing: PlanTiming, until: Optional[str] = None, losses: float = 0.0
    ) -> None:
        self.means = means = rules_of(replace(plan, until=until), timing)
        self.plan = plan
        self.net = net = plan.net
        self.arcs = [(t, p, w) for t, robots in enumerate(means.robots_of) for p, w in robots]
        """The arcs by which transitions take robots: transition, place, weight."""
        self.arc_of = {(t, p): arc for arc, (t, p, _) in enumerate(self.arcs)}
        # positions among the counts that transitions test: lists of robots at the policy, and a 0
        self._of_policy = len(net.places) + len(self.arcs)
        self._zero = self._of_policy + len(net.places)
        self.environment = means.environment
        if not plan.simulate_environment:  # tasks come from outside
            self.environment = [net.transition_number(t) for t in (*plan.submissions, *plan.clock)]
        ranks = {value: i for i, value in enumerate(sorted({t.priority for t in net.transitions}))}
        self.priority = [ranks[t.priority] for t in net.transitions]
        deciding = [p for p, leaving in enumerate(net.immediate_from) if leaving and means.acts[p]]
        self._policy = policy_book(plan, deciding)
        self.book = self._policy.arrays
        self.losses = losses
        self.events_at: List[List[int]] = [[] for _ in net.places]
        """By place: the transitions by which events interrupt robots there."""
        for t, p in means.interrupted.items():
            self.events_at[p].append(t)
        self.events = [t for here in self.events_at for t in here]
        creates = any(flow.put > flow.taken for flow in plan.flows)
        self.room = max(MOST_AGENTS, len(plan.robots)) if creates else max(len(plan.robots), 1)
        self.rules = self._rules()

    # -- rules -------------------------------------------------------------------------------------

    def _rules(self) -> kernel.PlanArrays:
        plan, net = self.plan, self.net
        lost_rule = {LostKind.HOLD: 0, LostKind.STOP: 1, LostKind.FIRE: 2}[plan.on_lost.kind]
        lost_transition = (
            net.transition_number(plan.on_lost.transition)
            if plan.on_lost.kind is LostKind.FIRE
            else -1
        )
        sizes = [
            len(net.places),
            len(net.transitions),
            len(self.arcs),
            self.room,
            int(plan.strict),
            int(self._policy.some_row_always),
            lost_rule,
            lost_transition,
            len(self.events),
        ]
        tests = [self._tests(t) for t in range(len(net.transitions))]
        test_from, flat_tests = ragged(flattened(tests))
        return kernel.PlanArrays(
            sizes=integers(sizes),
            net=kernel.NetArrays(
                test_from=test_from,
                tests=flat_tests,
                immediate=integers([int(not t.timed) for t in net.transitions]),
                priority=integers(self.priority),
                weight=numbers_of(net, range(len(net.transitions))),
            ),
            visits=kernel.Visits(*self._timings(), self._interrupts()),
            arcs=self._arc_arrays(),
            changes=self._changes(tests),
            moves=self._movers(),
            until=kernel.Until(*compile_condition(self.means.until)),
            losses=self._losses(),
        )

    def _tests(self, t: int) -> List[List[int]]:
        """The tests for a firing of transition ``t`` that robots ask for, or nobody: the marking
        must enable it, and of each place enough robots must be done and free for it."""
        net, zero = self.net, self._zero
        tests = marking_tests(net, t, zero)
        for test, (p, _) in zip(tests, net.inputs[t]):
            if self.means.acts[p]:
                policy = zero if net.transitions[t].timed else self._of_policy + p
                test[:2] = [len(net.places) + self.arc_of[t, p], policy]
        return tests

    def _changes(self, tests: Sequence[List[List[int]]]) -> kernel.ChangeArrays:
        """What firings change, and what must be checked again afterwards."""
        net = self.net
        transitions = range(len(net.transitions))
        rising: List[List[int]] = [[] for _ in net.places]
        falling: List[List[int]] = [[] for _ in net.places]
        for t in transitions:
            groups = [t] if self.means.robots_of[t] else []
            if groups and not net.transitions[t].timed:
                groups += self._policy_groups(t)
            for p, _, sign, _ in tests[t]:
                if p < len(net.places):  # not a list of robots
                    (rising if sign > 0 else falling)[p] += groups
        for p, reads in enumerate(self._policy.reads):
            for q in reads:
                rising[q].append(len(net.transitions) + p)
                falling[q].append(len(net.transitions) + p)
        effect_from, effects = ragged(flattened([net.effect(t) for t in transitions]))
        means, environment = self.means, self.environment
        spontaneous_from, spontaneous = ragged(self._readers(means.spontaneous, means.spontaneous))
        environment_from, its_readers = ragged(self._readers(environment, range(len(environment))))
        until_reads = np.zeros(len(net.places), dtype=np.int64)
        if means.until is not None:
            until_reads[[net.place_index[name] for name in means.until.places]] = 1
        return kernel.ChangeArrays(
            effect_from=effect_from,
            effects=effects,
            readers=kernel.Readers(
                *ragged([list(dict.fromkeys(groups)) for groups in rising]),
                *ragged([list(dict.fromkeys(groups)) for groups in falling]),
            ),
            watchers=kernel.Watchers(
                spontaneous_from=spontaneous_from,
                spontaneous=spontaneous,
                environment_from=environment_from,
                environment=its_readers,
                until_reads=until_reads,
                functions=marking_functions(net, environment),
            ),
            rates=kernel.Rates(
                transition=integers(environment),
                rate=numbers_of(net, environment),
                servers=integers([net.transitions[t].servers or 0 for t in environment]),
            ),
        )

    def _losses(self) -> kernel.Losses:
        index, returned = self.net.place_index, self.plan.on_evict
        evicted = [
            [(index[resource], count) for resource, count in returned.get(place.name, {}).items()]
            for place in self.net.places
        ]
        return kernel.Losses(floats([self.losses]), *ragged(flattened(evicted)))

    def _interrupts(self) -> kernel.InterruptArrays:
        """The events that interrupt robots. Their transitions are tested in the marking alone,
        whatever the robots are doing."""
        net = self.net
        sources = [self.plan.events[net.transitions[t].name] for t in self.events]
        rates = [
            net.transitions[t].number if source.comes_after is None else 0.0
            for t, source in zip(self.events, sources)
        ]
        test_from, flat_tests = ragged(
            flattened([marking_tests(net, t, self._zero) for t in self.events])
        )
        return kernel.InterruptArrays(
            event_from=np.cumsum([0, *map(len, self.events_at)]).astype(np.int64),
            event_transition=integers(self.events),
            event_rate=floats(rates),
            event_after=floats([source.comes_after or 0.0 for source in sources]),
            event_hold=integers([int(source.hold) for source in sources]),
            event_test_from=test_from,
            event_tests=flat_tests,
        )

    def _policy_groups(self, t: int) -> List[int]:
        """The groups of the robots at the policy in the places that transition ``t`` leaves."""
        return [len(self.net.transitions) + p for p, _ in self.means.robots_of[t]]

    def _arc_arrays(self) -> kernel.ArcArrays:
        net = self.net
        policy_groups = range(len(net.transitions), len(net.transitions) + len(net.places))
        leaving_from, leaving = ragged(net.immediate_from)
        joins_from, joins = ragged(self._joins())
        return kernel.ArcArrays(
            arc_from=np.cumsum([0, *map(len, self.means.robots_of)]).astype(np.int64),
            arc_place=integers([p for _, p, _ in self.arcs]),
            arc_weight=integers([weight for _, _, weight in self.arcs]),
            leaving_from=leaving_from,
            leaving=leaving,
            list_group=integers([*(t for t, _, _ in self.arcs), *policy_groups]),
            joins_from=joins_from,
            joins=joins,
        )

    def _joins(self) -> List[List[int]]:
        """For each list, the groups to look at again when a robot joins it."""
        net = self.net
        joins: List[List[int]] = []
        for t, _, _ in self.arcs:
            joins.append([t, *([] if net.transitions[t].timed else self._policy_groups(t))])
        for p, leaving in enumerate(net.immediate_from):
            groups = [len(net.transitions) + p]
            for t in leaving:
                if self.means.acts[p] and self.means.robots_of[t] != ((p, 1),):
                    groups += [t, *self._policy_groups(t)]
            joins.append(list(dict.fromkeys(groups)))
        return joins

    def _readers(self, which: Sequence[int], numbers: Sequence[int]) -> List[List[int]]:
        """For each place, the ``numbers`` of the transitions ``which`` that read its count."""
        readers: List[List[int]] = [[] for _ in self.net.places]
        for t, number in zip(which, numbers):
            for p in places_read(self.net, t):
                readers[p].append(number)
        return readers

    def _movers(self) -> kernel.Moves:
        """Where the robots of each transition go: fixed, unless some become void."""
        acts, routes = self.means.acts, self.plan.routes
        sources = [[p for p, w in taken for _ in range(w)] for taken in self.means.robots_of]
        slots = [[p for p, w in put if acts[p] for _ in range(w)] for put in self.net.outputs]
        wants = [[routes.get(t, {}).get(p, -1) for p in mine] for t, mine in enumerate(sources)]
        mover_from, mover_wants = ragged(wants)
        surplus = integers([max(taken - put, 0) for taken, put in self.plan.flows])
        moves = kernel.Moves(mover_from, mover_wants, mover_wants, *ragged(slots), surplus)
        targets = [np.zeros(len(mine), dtype=np.int64) for mine in sources]
        random = integers([])  # nothing is drawn from it
        for t, into in enumerate(slots):
            if not surplus[t]:
                left = np.array(into, dtype=np.int64)
                kernel.choose_targets(t, len(targets[t]), moves, targets[t], left, random)
                slots[t] = left[left >= 0].tolist()
        self.most_movers = max(map(len, sources), default=0)
        self.most_slots = max(map(len, slots), default=0)
        goes = [target for mine in targets for target in mine]
        return kernel.Moves(mover_from, integers(goes), mover_wants, *ragged(slots), surplus)

    # -- durations and outcomes --------------------------------------------------------------------

    def _timings(self) -> Tuple[kernel.Durations, kernel.OutcomeArrays, kernel.Failures]:
        places, visits = len(self.net.places), self.means.visits
        timing_of = np.zeros(len(visits) * places, dtype=np.int64)
        known: Dict[Tuple[int, PlaceVisit], int] = {}
        for c, here in enumerate(visits):
            for p, visit in here.items():
                timing_of[c * places + p] = known.setdefault((p, visit), len(known))
        its = [visit for _, visit in known]
        parts = [part for one in its for part in one.duration.parts]
        kinds = [
            kernel.NULL_ACTION if one.idle else _KINDS[part.kind]
            for one in its
            for _, _, part in one.duration.parts
        ]
        table_from, table = ragged(
            [[float(x) for x in part.parameters] for _, _, part in parts], np.float64
        )
        outcome_from, outcome_list = ragged(
            [[self._list(p, t) for t, _ in visit.asks] for p, visit in known]
        )
        _, outcome_chance = ragged(
            [np.cumsum([chance for _, chance in one.asks]).tolist() for one in its], np.float64
        )
        delay_from, delays = ragged([list(one.rule.delays) or [0.0] for one in its], np.float64)
        return (
            kernel.Durations(
                timing_of,
                part_from=np.cumsum([0, *(len(one.duration.parts) for one in its)]),
                part_chance=floats([chance for chance, _, _ in parts]),
                part_shift=floats([shift for _, shift, _ in parts]),
                part_kind=integers(kinds),
                part_mean=floats([part.mean for _, _, part in parts]),
                table_from=table_from,
                table=table,
                timeout=floats([one.timeout for one in its]),
            ),
            kernel.OutcomeArrays(outcome_from, outcome_list, outcome_chance),
            kernel.Failures(
                failure=floats([one.failure for one in its]),
                rule_times=integers([one.rule.times for one in its]),
                delay_from=delay_from,
                delays=delays,
                rule_end=integers([_ENDS[one.rule.end] for one in its]),
                rule_list=integers([self.arc_of.get((one.fallback, p), -1) for p, one in known]),
            ),
        )

    def _list(self, p: int, asked: int) -> int:
        """The list that a robot in place ``p`` joins that asks for this."""
        others = {
            POLICY: len(self.arcs) + p,
            NO_REQUEST: kernel.BAD_RESULT,
            FOR_GOOD: kernel.NOWHERE,
        }
        return others[asked] if asked in others else self.arc_of[asked, p]
