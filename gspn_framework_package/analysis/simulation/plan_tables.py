"""A plan as the arrays of the kernel."""

# In one piece: a net with clocks, compiled from the plan, is to replace it

from __future__ import annotations

import math
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np

from gspn_framework_package.analysis.simulation import kernel
from gspn_framework_package.analysis.simulation.machine import ragged
from gspn_framework_package.model.condition import Condition, parse_condition
from gspn_framework_package.model.duration import Kind
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.failure import FailureEnd
from gspn_framework_package.model.plan import LostKind, Plan
from gspn_framework_package.model.plan_timing import POLICY, PlaceTiming, PlanTiming
from gspn_framework_package.model.policy import PolicyRow

FEW_ENTRIES = 12
"""Up to this many rows for a place are searched one by one."""

MOST_AGENTS = 10_000
"""Most agents in a run that creates them."""

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
    :ivar rules: the plan as arrays.
    :ivar book: its policy as arrays.
    """

    def __init__(
        self, plan: Plan, timing: PlanTiming, until: Optional[str] = None, losses: float = 0.0
    ) -> None:
        self.plan = plan
        self.net = net = plan.net
        net.require_numbers("the simulation of a plan as it runs")
        self.is_resource = [p.name in plan.resource_places for p in net.places]
        self.arcs: List[Tuple[int, int, int]] = []  # transition, place, weight
        self.arc_of: Dict[Tuple[int, int], int] = {}
        for t, inputs in enumerate(net.inputs):
            for p, weight in inputs:
                if not self.is_resource[p]:
                    self.arc_of[t, p] = len(self.arcs)
                    self.arcs.append((t, p, weight))
        self.moves_robots = [
            any(not self.is_resource[p] for p, _ in inputs) for inputs in net.inputs
        ]
        self.immediate_from = [
            [t for t in consumers if not net.transitions[t].timed] for consumers in net.consumers
        ]
        ranks = {value: i for i, value in enumerate(sorted({t.priority for t in net.transitions}))}
        self.priority = [ranks[t.priority] for t in net.transitions]
        self.condition = (
            None if until is None else parse_condition(until, [p.name for p in net.places])
        )
        self.book, policy_reads, always = _book(self)
        self.classes, self.class_of = _robot_classes(plan)
        self.losses = losses
        creates = any(
            sum(w for p, w in net.outputs[t] if not self.is_resource[p])
            > sum(w for p, w in net.inputs[t] if not self.is_resource[p])
            for t in range(len(net.transitions))
        )
        self.events_at = [
            [] if self.is_resource[p] else list(timing.events[p]) for p in range(len(net.places))
        ]
        """By place: the transitions by which events interrupt robots there."""
        self.events = [t for here in self.events_at for t in here]
        self.room = max(MOST_AGENTS, len(plan.robots)) if creates else max(len(plan.robots), 1)
        self.rules = self._rules(timing, policy_reads, always)

    # -- rules -------------------------------------------------------------------------------------

    # In one piece: a net with clocks, compiled from the plan, is to replace it
    def _rules(
        self, timing: PlanTiming, policy_reads: Sequence[Set[int]], always: bool
    ) -> kernel.PlanArrays:
        plan, net = self.plan, self.net
        places, transitions, arcs = len(net.places), len(net.transitions), len(self.arcs)
        zero = places + arcs + places
        immediate = [not t.timed for t in net.transitions]
        tests: List[List[int]] = []
        rising: List[List[int]] = [[] for _ in range(places)]
        falling: List[List[int]] = [[] for _ in range(places)]
        for t in range(transitions):
            groups = [t] if self.moves_robots[t] else []
            if immediate[t] and groups:
                groups += [transitions + p for p, _ in net.inputs[t] if not self.is_resource[p]]
            found = []
            for p, weight in net.inputs[t]:
                if self.is_resource[p]:
                    found += [p, zero, 1, weight]
                    rising[p] += groups
                else:
                    found += [
                        places + self.arc_of[t, p],
                        places + arcs + p if immediate[t] else zero,
                        1,
                        weight,
                    ]
            for p, weight in net.inhibitors[t]:
                found += [p, zero, -1, 1 - weight]
                falling[p] += groups
            for p, change in net.effect(t):
                capacity = net.places[p].capacity
                if change > 0 and capacity is not None:
                    found += [p, zero, -1, change - capacity]
                    falling[p] += groups
            tests.append(found)
        for p, reads in enumerate(policy_reads):
            for q in reads:
                rising[q].append(transitions + p)
                falling[q].append(transitions + p)
        test_from, flat_tests = ragged(tests)
        effect_from, effects = ragged(
            [[value for pair in net.effect(t) for value in pair] for t in range(transitions)]
        )
        rising_from, flat_rising = ragged([list(dict.fromkeys(groups)) for groups in rising])
        falling_from, flat_falling = ragged([list(dict.fromkeys(groups)) for groups in falling])
        joins_from, joins = ragged(self._joins())
        by_transition: List[List[int]] = [[] for _ in range(transitions)]
        for arc, (t, _, _) in enumerate(self.arcs):
            by_transition[t].append(arc)
        leaving_from, leaving = ragged(self.immediate_from)
        spontaneous = [t for t in range(transitions) if immediate[t] and not self.moves_robots[t]]
        environment = (
            [t for t in range(transitions) if not immediate[t] and not self.moves_robots[t]]
            if plan.simulate_environment
            else [net.transition_number(t) for t in plan.submissions]  # tasks come from outside
        )
        self.spontaneous, self.environment = spontaneous, environment
        spontaneous_from, reads_spontaneous = ragged(self._readers(spontaneous, spontaneous))
        environment_from, reads_environment = ragged(
            self._readers(environment, list(range(len(environment))))
        )
        until_reads = np.zeros(places, dtype=np.int64)
        operations, arguments = compile_condition(self.condition)
        if self.condition is not None:
            until_reads[[net.place_index[name] for name in self.condition.places]] = 1
        evicted_from, evicted = ragged(
            [
                [
                    value
                    for resource, count in plan.on_evict.get(place.name, {}).items()
                    for value in (net.place_index[resource], count)
                ]
                for place in net.places
            ]
        )
        lost_rule = {LostKind.HOLD: 0, LostKind.STOP: 1, LostKind.FIRE: 2}[plan.on_lost.kind]
        lost_transition = (
            net.transition_number(plan.on_lost.transition)
            if plan.on_lost.kind is LostKind.FIRE
            else -1
        )
        return kernel.PlanArrays(
            sizes=np.array(
                [
                    places,
                    transitions,
                    arcs,
                    self.room,
                    int(plan.strict),
                    int(always),
                    lost_rule,
                    lost_transition,
                    len(self.events),
                ],
                dtype=np.int64,
            ),
            net=kernel.NetArrays(
                test_from=test_from,
                tests=flat_tests,
                immediate=_whole([int(i) for i in immediate]),
                priority=_whole(self.priority),
                weight=_real([0.0 if t.timed else t.number for t in net.transitions]),
            ),
            visits=kernel.Visits(*self._timings(timing), self._interrupts(zero)),
            arcs=kernel.ArcArrays(
                arc_from=np.cumsum([0, *map(len, by_transition)]).astype(np.int64),
                arc_place=_whole([p for _, p, _ in self.arcs]),
                arc_weight=_whole([weight for _, _, weight in self.arcs]),
                leaving_from=leaving_from,
                leaving=leaving,
                list_group=_whole(
                    [t for t, _, _ in self.arcs] + [transitions + p for p in range(places)]
                ),
                joins_from=joins_from,
                joins=joins,
            ),
            changes=kernel.ChangeArrays(
                effect_from=effect_from,
                effects=effects,
                readers=kernel.Readers(rising_from, flat_rising, falling_from, flat_falling),
                watchers=kernel.Watchers(
                    spontaneous_from=spontaneous_from,
                    spontaneous=reads_spontaneous,
                    environment_from=environment_from,
                    environment=reads_environment,
                    until_reads=until_reads,
                ),
                rates=kernel.Rates(
                    transition=_whole(environment),
                    rate=_real([net.transitions[t].number for t in environment]),
                    servers=_whole([net.transitions[t].servers or 0 for t in environment]),
                ),
            ),
            moves=self._movers(),
            until=kernel.Until(operations, arguments),
            losses=kernel.Losses(_real([self.losses]), evicted_from, evicted),
        )

    def _interrupts(self, zero: int) -> kernel.InterruptArrays:
        """The events that interrupt robots. Their transitions are tested in the marking alone,
        whatever the robots are doing."""
        net = self.net
        tests: List[List[int]] = []
        for t in self.events:
            found = []
            for p, weight in net.inputs[t]:
                found += [p, zero, 1, weight]
            for p, weight in net.inhibitors[t]:
                found += [p, zero, -1, 1 - weight]
            for p, change in net.effect(t):
                capacity = net.places[p].capacity
                if change > 0 and capacity is not None:
                    found += [p, zero, -1, change - capacity]
            tests.append(found)
        sources = [self.plan.events[net.transitions[t].name] for t in self.events]
        test_from, flat_tests = ragged(tests)
        return kernel.InterruptArrays(
            event_from=np.cumsum([0, *map(len, self.events_at)]).astype(np.int64),
            event_transition=_whole(self.events),
            event_rate=_real(
                [
                    net.transitions[t].number if source.comes_after is None else 0.0
                    for t, source in zip(self.events, sources)
                ]
            ),
            event_after=_real([source.comes_after or 0.0 for source in sources]),
            event_hold=_whole([int(source.hold) for source in sources]),
            event_test_from=test_from,
            event_tests=flat_tests,
        )

    def _joins(self) -> List[List[int]]:
        """For each list, the groups to look at again when a robot joins it."""
        net = self.net
        transitions = len(net.transitions)
        arcs_of: List[List[Tuple[int, int]]] = [[] for _ in range(transitions)]
        for t, p, weight in self.arcs:
            arcs_of[t].append((p, weight))
        joins: List[List[int]] = []
        for t, _, _ in self.arcs:
            groups = [t]
            if not net.transitions[t].timed:
                groups += [transitions + q for q, _ in arcs_of[t]]
            joins.append(groups)
        for p, leaving in enumerate(self.immediate_from):
            groups = [transitions + p]
            for t in leaving:
                if self.is_resource[p] or arcs_of[t] == [(p, 1)]:
                    continue
                groups += [t, *(transitions + q for q, _ in arcs_of[t])]
            joins.append(list(dict.fromkeys(groups)))
        return joins

    def _readers(self, which: Sequence[int], numbers: Sequence[int]) -> List[List[int]]:
        """For each place, the ``numbers`` of the transitions ``which`` that its count may enable or
        disable."""
        net = self.net
        readers: List[List[int]] = [[] for _ in net.places]
        for t, number in zip(which, numbers):
            full = [p for p, _ in net.effect(t) if net.places[p].capacity is not None]
            near = [p for p, _ in net.inputs[t]] + [p for p, _ in net.inhibitors[t]] + full
            for p in dict.fromkeys(near):
                readers[p].append(number)
        return readers

    def _movers(self) -> kernel.Moves:
        """Where the robots of each transition go: fixed, unless some become void."""
        net = self.net
        routing = {
            net.transition_number(t): {
                net.place_number(a): net.place_number(b) for a, b in routes.items()
            }
            for t, routes in self.plan.routing.items()
        }
        targets: List[List[int]] = []
        wants: List[List[int]] = []
        left: List[List[int]] = []
        surplus: List[int] = []
        for t in range(len(net.transitions)):
            sources = [p for p, w in net.inputs[t] if not self.is_resource[p] for _ in range(w)]
            slots = [p for p, w in net.outputs[t] if not self.is_resource[p] for _ in range(w)]
            routes = routing.get(t, {})
            wants.append([routes.get(p, -1) for p in sources])
            surplus.append(max(len(sources) - len(slots), 0))
            goes: List[int] = [-1] * len(sources)
            if not surplus[-1]:
                for i, p in enumerate(sources):
                    if routes.get(p) in slots:
                        slots.remove(routes[p])
                        goes[i] = routes[p]
                goes = [slots.pop(0) if target < 0 else target for target in goes]
            else:
                goes = [0] * len(sources)
            targets.append(goes)
            left.append(slots)
        mover_from, mover_target = ragged(targets)
        _, mover_wants = ragged(wants)
        slot_from, slots_left = ragged(left)
        self.most_movers = max((len(goes) for goes in targets), default=0)
        self.most_slots = max((len(slots) for slots in left), default=0)
        return kernel.Moves(
            mover_from, mover_target, mover_wants, slot_from, slots_left, _whole(surplus)
        )

    # -- durations and outcomes --------------------------------------------------------------------

    def _timings(
        self, timing: PlanTiming
    ) -> Tuple[kernel.Durations, kernel.OutcomeArrays, kernel.Failures]:
        plan, net = self.plan, self.net
        places = len(net.places)
        timing_of = np.zeros(len(self.classes) * places, dtype=np.int64)
        known: Dict[Tuple[int, bool, PlaceTiming], int] = {}
        rows: List[Tuple[int, bool, PlaceTiming]] = []
        for c, robot in enumerate(self.classes):
            for p, place in enumerate(net.places):
                if self.is_resource[p]:
                    continue
                key = (p, plan.action(robot, place.name) is None, timing.of(robot, p))
                if key not in known:
                    known[key] = len(rows)
                    rows.append(key)
                timing_of[c * places + p] = known[key]
        parts: List[Tuple[float, float, int, float]] = []
        lengths, numbers, lists, chances, nulls = [], [], [], [], []
        ends, times, delays, fires, limits, failures = [], [], [], [], [], []
        for p, null, (length, outcomes, failure, limit, _) in rows:
            at_once = null and length.mean == 0.0
            lengths.append(len(length.parts))
            for chance, shift, part in length.parts:
                kind = kernel.NULL_ACTION if at_once else _KINDS[part.kind]
                parts.append((chance, shift, kind, part.mean))
                numbers.append([float(x) for x in part.parameters])
            nulls.append(self._wish(p, POLICY))
            outcomes = tuple(o for o in outcomes if o[1] > 0) or ((POLICY, 1.0),)
            lists.append([self._wish(p, t) for t, _ in outcomes])
            chances.append(np.cumsum([chance for _, chance in outcomes]).tolist())
            failures.append(failure)
            name = net.places[p].name
            rule = plan.failure_rule(name)
            ends.append(_ENDS[rule.end])
            times.append(rule.times)
            delays.append(list(rule.delays) or [0.0])
            fires.append(-1)
            if rule.end is FailureEnd.FIRE:
                t = net.transition_number(rule.transition)
                fires[-1] = self.arc_of.get((t, p), -1)
            limits.append(limit)
        table_from, table = ragged(numbers, np.float64)
        outcome_from, outcome_list = ragged(lists)
        _, outcome_chance = ragged(chances, np.float64)
        delay_from, flat_delays = ragged(delays, np.float64)
        return (
            kernel.Durations(
                timing_of,
                part_from=np.cumsum([0, *lengths]).astype(np.int64),
                part_chance=_real([chance for chance, _, _, _ in parts]),
                part_shift=_real([shift for _, shift, _, _ in parts]),
                part_kind=_whole([kind for _, _, kind, _ in parts]),
                part_mean=_real([mean for _, _, _, mean in parts]),
                table_from=table_from,
                table=table,
                timeout=_real(limits),
            ),
            kernel.OutcomeArrays(outcome_from, outcome_list, outcome_chance, _whole(nulls)),
            kernel.Failures(
                failure=_real(failures),
                rule_times=_whole(times),
                delay_from=delay_from,
                delays=flat_delays,
                rule_end=_whole(ends),
                rule_list=_whole(fires),
            ),
        )

    def _wish(self, p: int, outcome: int) -> int:
        """The list that a robot in place ``p`` joins with this outcome, by the rules of a run."""
        leaving = self.net.consumers[p]
        if not leaving:
            return kernel.NOWHERE
        if outcome != POLICY:
            return self.arc_of.get((outcome, p), kernel.BAD_RESULT)
        asked = self.plan.of_action(p)
        if self.immediate_from[p] or not asked:
            return len(self.arcs) + p
        return self.arc_of[asked[0], p] if len(asked) == 1 else kernel.BAD_RESULT


def _robot_classes(plan: Plan) -> Tuple[List[str], List[int]]:
    """One robot of each kind (robots with equal actions are of one kind; "" is any robot without
    its own), and the kind of each robot of the plan."""
    names = [""]
    kinds: List[Mapping[str, Any]] = [{}]
    of: List[int] = []
    for robot in plan.robots:
        if robot.actions in kinds:
            of.append(kinds.index(robot.actions))
        else:
            of.append(len(kinds))
            kinds.append(robot.actions)
            names.append(robot.name)
    return names, of


# -- the policy ------------------------------------------------------------------------------------


class _Mask(NamedTuple):
    cells: Tuple[int, ...]
    entries: List[int]


# In one piece: a net with clocks, compiled from the plan, is to replace it
def _book(tables: PlanTables) -> Tuple[kernel.Book, List[Set[int]], bool]:
    """The policy as arrays; for each place, the places whose counts its choices depend on; whether
    some row of every scope matches every marking."""
    plan, net = tables.plan, tables.net
    policy = plan.policy
    columns = [net.place_index[name] for name in policy.places]
    places = len(net.places)
    number_of = policy.scope_numbers()
    scope_of = np.array([number_of.get(p.name, 0) for p in net.places], dtype=np.int64)
    row_scope = policy.row_scopes()
    entries: List[List[int]] = [[] for _ in range(places + 1 + len(policy.scopes))]
    entry_row: List[int] = []
    choices: List[List[int]] = []
    chances: List[List[float]] = []
    cells: List[List[int]] = []
    by_choice: Dict[Any, List[Tuple[int, List[int], List[float]]]] = {}
    always: Set[int] = set()  # scopes of which some row matches every marking
    need_all = not plan.strict
    for number, row in enumerate(policy.rows):
        row_cells = [
            value
            for column, count in zip(columns, row.counts)
            if count is not None
            for value in (column, count)
        ]
        cells.append(row_cells)
        if not row_cells:
            always.add(row_scope[number])
        if row.choices not in by_choice:
            by_choice[row.choices] = _by_place(tables, row)
        for place, transitions, probabilities in by_choice[row.choices]:
            if scope_of[place] != row_scope[number]:
                continue
            entries[place].append(len(entry_row))
            entry_row.append(number)
            choices.append(transitions)
            chances.append(probabilities)
    always_all = len(always) == 1 + len(policy.scopes)
    if always_all:
        need_all = False
    if need_all:
        for number in range(len(policy.rows)):
            entries[places + row_scope[number]].append(len(entry_row))
            entry_row.append(number)
            choices.append([])
            chances.append([])
    reads = [
        {cell for entry in entries[p] for cell in cells[entry_row[entry]][::2]}
        for p in range(places)
    ]
    if need_all:
        whole: List[Set[int]] = [set() for _ in range(1 + len(policy.scopes))]
        for number, row_cells in enumerate(cells):
            whole[row_scope[number]].update(row_cells[::2])
        for p in range(places):
            if tables.immediate_from[p] and not tables.is_resource[p]:
                reads[p] |= whole[scope_of[p]]
    listed: List[List[int]] = []
    masks: List[List[_Mask]] = []
    for mine in entries:
        if len(mine) <= FEW_ENTRIES:
            listed.append(sorted(mine, key=lambda e: (-len(cells[entry_row[e]]), entry_row[e])))
            masks.append([])
        else:
            listed.append([])
            groups: Dict[Tuple[int, ...], List[int]] = {}
            for entry in mine:
                groups.setdefault(tuple(cells[entry_row[entry]][::2]), []).append(entry)
            masks.append(
                sorted((_Mask(*item) for item in groups.items()), key=lambda m: -len(m.cells))
            )
    listed_from, flat_listed = ragged(listed)
    mask_from = np.cumsum([0, *map(len, masks)]).astype(np.int64)
    all_masks = [mask for mine in masks for mask in mine]
    mask_cells_from, mask_cells = ragged([list(mask.cells) for mask in all_masks])
    sizes = [1 << max(2 * len(mask.entries) - 1, 1).bit_length() for mask in all_masks]
    starts = np.cumsum([0, *sizes]).astype(np.int64)
    hashed = np.full(max(int(starts[-1]), 1), -1, dtype=np.int64)
    for mask, start, size in zip(all_masks, starts.tolist(), sizes):
        _fill(hashed[start : start + size], [(e, cells[entry_row[e]]) for e in mask.entries])
    choice_from, choice = ragged(choices)
    _, chance = ragged(chances, np.float64)
    cell_from, flat_cells = ragged(cells)
    mixed = [int(len({tables.net.transitions[t].priority for t in mine}) > 1) for mine in choices]
    return (
        kernel.Book(
            rows=kernel.RowArrays(
                listed_from=listed_from,
                listed=flat_listed,
                mask_from=mask_from,
                mask_cells_from=mask_cells_from,
                mask_cells=mask_cells,
                mask_table=starts,
                mask_size=_whole(sizes),
                tables=hashed,
                entry_row=_whole(entry_row),
                cell_from=cell_from,
                cells=flat_cells,
            ),
            any_of=places + scope_of,
            entry_mixed=_whole(mixed),
            choice_from=choice_from,
            choice=choice,
            chance=chance,
        ),
        reads,
        always_all,
    )


def _by_place(tables: PlanTables, row: PolicyRow) -> List[Tuple[int, List[int], List[float]]]:
    """A row's choices for each place of robots: transitions and probabilities that sum to 1. A row
    without choices has none for every place in which robots decide."""
    net = tables.net
    if not row.choices:
        return [
            (p, [], [])
            for p, leaving in enumerate(tables.immediate_from)
            if leaving and not tables.is_resource[p]
        ]
    found: Dict[int, Tuple[List[int], List[float]]] = {}
    for name, probability in row.choices:
        t = net.transition_index[name]
        for p, _ in net.inputs[t]:
            if probability > 0 and not tables.is_resource[p]:
                transitions, probabilities = found.setdefault(p, ([], []))
                transitions.append(t)
                probabilities.append(probability)
    return [
        (p, transitions, [value / math.fsum(values) for value in values])
        for p, (transitions, values) in found.items()
    ]


def _fill(table: Any, rows: Sequence[Tuple[int, List[int]]]) -> None:
    """Enter entries into a hash table; of two with equal cells, the first stays."""
    size = len(table)
    held: Dict[int, List[int]] = {}
    for entry, cells in rows:
        mixed = 0
        for count in cells[1::2]:
            mixed = (mixed * 1000003 + count) & 0x7FFFFFFF
        slot = (mixed ^ (mixed >> 15)) & (size - 1)
        while slot in held and held[slot] != cells:
            slot = (slot + 1) & (size - 1)
        if slot not in held:
            held[slot] = cells
            table[slot] = entry


def compile_condition(condition: Optional[Condition]) -> Tuple[Any, Any]:
    """A condition as operations and arguments of the kernel; empty for None."""
    program = () if condition is None else condition.program
    codes = {name: i for i, name in enumerate(kernel.OPERATIONS)}
    operations = [codes[step] for step, _ in program]
    arguments = [
        float(argument) if isinstance(argument, (int, float)) else 0.0 for _, argument in program
    ]
    return _whole(operations, empty=True), _real(arguments, empty=True)


def _whole(values: Sequence[int], empty: bool = False) -> Any:
    return np.array(values if len(values) or empty else [0], dtype=np.int64)


def _real(values: Sequence[float], empty: bool = False) -> Any:
    return np.array(values if len(values) or empty else [0.0], dtype=np.float64)


__all__ = ["PlanTables", "RefusedError", "compile_condition"]
