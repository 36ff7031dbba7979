"""Runs of a plan as it is executed: the state of the kernel, and what is rare enough for plain
Python: the start, and the loss of a robot."""

from __future__ import annotations

from typing import Any, Dict, List, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.simulation import kernel
from gspn_framework_package.analysis.simulation.kernel_run import (
    KernelRun,
    first_clocks,
    first_counts,
    real,
    sum_tree,
    whole_numbers,
)
from gspn_framework_package.analysis.simulation.plan_tables import PlanTables
from gspn_framework_package.model.errors import RefusedError


class PlanRun(KernelRun):
    """Runs of one plan as it is executed.

    :param tables: the plan.
    """

    def __init__(self, tables: PlanTables) -> None:
        self.tables = tables
        super().__init__(tables.net, (tables.rules, tables.book), _new_state(tables))

    def step(self, stop: float, budget: int) -> int:
        """Play the token game; see :meth:`KernelRun.step`."""
        return int(self.functions["play"](*self.arguments, stop, budget))

    def _values(self) -> Tuple[kernel.MarkingFunctions, kernel.NetArrays, kernel.Rates]:
        rules = self.arrays[0]
        return rules.changes.watchers.functions, rules.net, rules.changes.rates

    def after(self, status: int) -> int:
        """Evict a robot that was lost; see :meth:`KernelRun.after`."""
        if status == kernel.LOSS:
            if not self._lose(int(self.state.numbers[kernel.LOST_ROBOT])):
                return kernel.MORE
            self._book_times()
            return kernel.STOPPED
        if status == kernel.FULL:
            raise RefusedError(
                "a run creates more than %d agents" % self.tables.room,
                hint="'gspn simulate --log FILE' plays the token game without that limit",
            )
        return status

    # -- a robot is lost ---------------------------------------------------------------------------

    def _lose(self, robot: int) -> bool:
        """Evict a robot by the rules of a run; returns whether that stops the team."""
        s, rules = self.state, self.arrays[0]
        numbers, robots = s.numbers, s.robots
        lost_rule = rules.sizes[kernel.LOST_RULE]
        place = int(robots.at[robot])
        drawn = self._drawn() if lost_rule else {}
        if robots.phase[robot] == kernel.WAITING:
            self._leave(robot)
            drawn.pop(robot, None)
        elif robots.phase[robot] == kernel.INACTIVE:
            numbers[kernel.INACTIVES] -= 1
        robots.due_tag[robot] = 0
        robots.visit_from[robot] = kernel.NO_VISIT
        robots.phase[robot] = kernel.GONE
        kernel.take_out(robot, s.members.active, s.members.active_at, numbers)
        self._free_resources(place)
        if lost_rule:
            stuck = [other for other, t in drawn.items() if self._lacks(t, place)]
            if stuck and lost_rule == 1:
                return True
            for other in stuck:
                asked = int(rules.sizes[kernel.LOST_TRANSITION]), int(robots.at[other])
                wish = self.tables.arc_of.get(asked)
                if wish is not None:
                    self._ask_instead(other, wish)
        self.look_at_all()  # losses are rare
        return False

    def look_at_all(self) -> None:
        """Look again at the requests of all robots that wait."""
        s = self.state
        groups: Any = range(len(s.lists.waits))
        kernel.mark(0, len(groups), groups, s.lists.waits, s.marks, s.numbers)

    def _free_resources(self, place: int) -> None:
        """Change the counts as the eviction of a robot in ``place`` does."""
        s, rules = self.state, self.arrays[0]
        losses, changes = rules.losses, rules.changes
        begin, end = losses.evicted_from[place], losses.evicted_from[place + 1]
        freed = [(losses.evicted[k], losses.evicted[k + 1]) for k in range(begin, end, 2)]
        for p, amount in [(place, -1), *freed]:
            kernel.shift(p, amount, self.now, s.counts, s.numbers)
        for p, _ in [(place, -1), *freed]:
            kernel.touch(
                p, rules.net, changes.watchers, changes.rates, s.chance, s.counts.level, s.numbers
            )
        s.numbers[kernel.MARKING_VERSION] += 1

    def _leave(self, robot: int) -> None:
        s = self.state
        groups = self.arrays[0].arcs.list_group
        kernel.leave_list(robot, len(self.net.places), groups, s.lists, s.counts.level)

    def _drawn(self) -> Dict[int, int]:
        """The transition that each waiting robot requests in this marking; robots to which the
        policy gives nothing are left out."""
        s, rules, book = self.state, self.arrays[0], self.arrays[1]
        arcs = len(self.tables.arcs)
        places = len(self.net.places)
        found: Dict[int, int] = {}
        for arc, (t, _, _) in enumerate(self.tables.arcs):
            for robot in self._listed(arc):
                found[robot] = t
        for p in range(places):
            robots = self._listed(arcs + p)
            if not robots:
                continue
            candidates, stamps = s.choices
            count = kernel.weigh(
                p,
                rules.sizes,
                rules.net,
                book,
                rules.arcs.leaving_from,
                rules.arcs.leaving,
                s.counts.level,
                candidates,
                stamps,
                s.numbers,
            )
            kinds = s.numbers[kernel.KINDS]
            if kinds == 0:
                continue
            draw, draw_stamp = s.lists.draw, s.lists.draw_stamp
            for robot in robots:
                if draw_stamp[robot] != stamps.stamp[p]:
                    draw_stamp[robot] = stamps.stamp[p]
                    draw[robot] = kernel.pick(count, kinds, candidates.weight, s.random)
                found[robot] = int(candidates.transition[draw[robot]])
        return found

    def _listed(self, wish: int) -> List[int]:
        found = []
        robot = int(self.state.lists.head[wish])
        while robot >= 0:
            found.append(robot)
            robot = int(self.state.lists.following[robot])
        return found

    def _lacks(self, t: int, place: int) -> bool:
        """Whether transition ``t`` lacks a robot in ``place``."""
        s, places, arcs = self.state, len(self.net.places), len(self.tables.arcs)
        arc = self.tables.arc_of.get((t, place))
        if arc is None:
            return False
        there = s.counts.level[places + arc]
        if not self.net.transitions[t].timed:
            there += s.counts.level[places + arcs + place]
        return bool(there < self.tables.arcs[arc][2])

    def _ask_instead(self, robot: int, wish: int) -> None:
        """Let a waiting robot request something else."""
        s = self.state
        self._leave(robot)
        groups = self.arrays[0].arcs.list_group
        kernel.join_list(robot, wish, len(self.net.places), groups, s.lists, s.counts.level)

    def _book_times(self) -> None:
        kernel.book_times(self.now, len(self.net.places), self.state.counts)


def _new_state(tables: PlanTables) -> kernel.PlanState:
    """The state before the robots enter their first places."""
    net, room = tables.net, tables.room
    places, transitions = len(net.places), len(net.transitions)
    groups, lists = transitions + places, len(tables.arcs) + places
    marking = [0 if tables.means.acts[p] else place.tokens for p, place in enumerate(net.places)]
    for robot in tables.plan.robots:
        marking[net.place_index[robot.place]] += 1
    robots, members = _first_robots(tables)
    return kernel.PlanState(
        numbers=_first_numbers(tables),
        clocks=first_clocks(),
        random=whole_numbers(4),
        counts=first_counts(marking, lists + 1),
        firings=whole_numbers(transitions),
        robots=robots,
        members=members,
        lists=kernel.Lists(
            in_list=whole_numbers(room),
            following=whole_numbers(room),
            preceding=whole_numbers(room),
            draw=whole_numbers(room),
            draw_stamp=whole_numbers(room),
            head=whole_numbers(lists, -1),
            tail=whole_numbers(lists, -1),
            waits=whole_numbers(groups),
        ),
        marks=kernel.Marks(
            dirty=whole_numbers(groups),
            is_dirty=whole_numbers(groups),
            volatile=whole_numbers(groups),
            is_volatile=whole_numbers(groups),
        ),
        choices=_no_choices(tables),
        calendar=_first_calendar(tables),
        chance=_first_chance(tables, marking),
        movers=whole_numbers(max(tables.most_movers, 1)),
        targets=whole_numbers(max(tables.most_movers, 1)),
        stack=real(len(tables.rules.until.operations) + 1),
    )


def _first_numbers(tables: PlanTables) -> Any:
    count = len(tables.plan.robots)
    numbers = whole_numbers(kernel.NUMBERS)
    numbers[kernel.ACTIVE] = count
    numbers[kernel.PENDING] = count
    numbers[kernel.CHECK_UNTIL] = 1
    numbers[kernel.ENVIRONMENT_DIRTY] = 1
    numbers[kernel.LOST] = -1
    numbers[kernel.FREE] = tables.room - count
    numbers[kernel.CHANGED] = len(tables.means.spontaneous)
    return numbers


def _first_robots(tables: PlanTables) -> Tuple[kernel.Robots, kernel.Members]:
    robots, room = tables.plan.robots, tables.room
    count = len(robots)
    at, kind, active, active_at, free = (whole_numbers(room) for _ in range(5))
    at[:count] = [tables.net.place_index[robot.place] for robot in robots]
    kind[:count] = tables.means.kind_of
    active[:count] = active_at[:count] = np.arange(count)
    free[: room - count] = np.arange(room - 1, count - 1, -1)
    return (
        kernel.Robots(
            at=at,
            phase=whole_numbers(room),
            kind=kind,
            failures=whole_numbers(room),
            due_tag=whole_numbers(room),
            due_what=whole_numbers(room),
            visit_from=whole_numbers(room, kernel.NO_VISIT),
        ),
        kernel.Members(active, active_at, free),
    )


def _no_choices(tables: PlanTables) -> kernel.ChoiceArrays:
    places = len(tables.net.places)
    most = max(
        *map(len, tables.net.immediate_from),
        *np.diff(tables.book.choice_from).tolist(),
        tables.most_slots,
        1,
    )
    return kernel.ChoiceArrays(
        kernel.Candidates(whole_numbers(most), whole_numbers(most), real(most)),
        kernel.Stamps(whole_numbers(places, -1), whole_numbers(places), whole_numbers(places)),
    )


def _first_calendar(tables: PlanTables) -> kernel.Calendar:
    room, count = tables.room, len(tables.plan.robots)
    pending_robot = whole_numbers(room + 1)
    pending_robot[:count] = np.arange(count)  # all of them enter
    # the events of one visit: those after a fixed time, and the next one that comes at a rate
    most = max(map(len, tables.events_at), default=0)
    arrivals = 2 * room * (most + 1) + 1 if most else 1
    held = room * most + 1
    return kernel.Calendar(
        pending_robot=pending_robot,
        pending_what=whole_numbers(room + 1),
        heap=new_heap(2 * room + 1),
        queue_tag=whole_numbers(2 * room + 1),
        queue_robot=whole_numbers(2 * room + 1),
        arrivals=new_heap(arrivals),
        held=kernel.Held(whole_numbers(held), whole_numbers(held), whole_numbers(held)),
    )


def _first_chance(tables: PlanTables, marking: Sequence[int]) -> kernel.Chance:
    transitions, spontaneous = len(tables.net.transitions), tables.means.spontaneous
    changed, is_changed = whole_numbers(transitions), whole_numbers(transitions)
    changed[: len(spontaneous)] = spontaneous
    is_changed[spontaneous] = 1
    return kernel.Chance(
        ready_ones=kernel.Ready(whole_numbers(transitions), whole_numbers(transitions, -1)),
        changed=changed,
        is_changed=is_changed,
        tree=sum_tree([tables.net.effective_rate(marking, t) for t in tables.environment]),
    )


def new_heap(size: int) -> kernel.Heap:
    """An empty heap with this capacity."""
    return kernel.Heap(real(size), whole_numbers(size), whole_numbers(size))
