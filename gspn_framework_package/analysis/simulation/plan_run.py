"""Runs of a plan as it is executed: the state of the kernel, and what is rare enough for plain
Python: the start, and the loss of a robot."""

from __future__ import annotations

import math
from typing import Any, Dict, List

import numpy as np

from gspn_framework_package.analysis.simulation import kernel
from gspn_framework_package.analysis.simulation.kernel_run import (
    KernelRun,
    first_rows,
    real,
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
            kernel.touch(
                p, rules.net, changes.watchers, changes.rates, s.chance, s.counts.level, s.numbers
            )
        s.numbers[kernel.MARKING_VERSION] += 1

    def _leave(self, robot: int) -> None:
        s = self.state
        groups = self.arrays[0].arcs.list_group
        kernel.leave_list(robot, len(self.net.places), groups, s.lists, s.counts.level)

    def _drawn(self) -> Dict[int, int]:
        """What each waiting robot requests in this marking: a transition; robots to which the
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


# In one piece: a net with clocks, compiled from the plan, is to replace it
def _new_state(tables: PlanTables) -> kernel.PlanState:
    """The state before the robots enter their first places."""
    net = tables.net
    places, transitions, arcs = len(net.places), len(net.transitions), len(tables.arcs)
    groups, lists, room = transitions + places, arcs + places, tables.room
    robots = tables.plan.robots
    count = len(robots)
    marking = [place.tokens if tables.is_resource[p] else 0 for p, place in enumerate(net.places)]
    at = [net.place_index[robot.place] for robot in robots]
    for p in at:
        marking[p] += 1
    level = whole_numbers(places + lists + 1)
    level[:places] = marking
    numbers = whole_numbers(kernel.NUMBERS)
    numbers[kernel.ACTIVE] = count
    numbers[kernel.PENDING] = count
    numbers[kernel.CHECK_UNTIL] = 1
    numbers[kernel.ENVIRONMENT_DIRTY] = 1
    numbers[kernel.LOST] = -1
    numbers[kernel.FREE] = room - count
    spontaneous = tables.spontaneous
    numbers[kernel.CHANGED] = len(spontaneous)
    changed, is_changed = whole_numbers(transitions), whole_numbers(transitions)
    changed[: len(spontaneous)] = spontaneous
    is_changed[spontaneous] = 1
    clocks = real(kernel.CLOCKS)
    clocks[kernel.ENVIRONMENT_AT] = clocks[kernel.LOSS_AT] = math.inf
    robots_at, kind, active, active_at = (
        whole_numbers(room),
        whole_numbers(room),
        whole_numbers(room),
        whole_numbers(room),
    )
    robots_at[:count] = at
    kind[:count] = tables.class_of
    active[:count] = active_at[:count] = np.arange(count)
    free = whole_numbers(room)
    free[: room - count] = np.arange(room - 1, count - 1, -1)
    pending_robot, pending_what = whole_numbers(room + 1), whole_numbers(room + 1)
    pending_robot[:count] = np.arange(count)  # all of them enter
    leaves = 1
    while leaves < len(tables.environment):
        leaves *= 2
    tree = real(2 * leaves)
    for i, t in enumerate(tables.environment):
        kernel.set_leaf(tree, leaves, i, net.effective_rate(tuple(marking), t))
    spent_from = first_rows(marking)
    choices = max(
        max((len(leaving) for leaving in tables.immediate_from), default=0),
        int(np.diff(tables.book.choice_from).max()) if len(tables.book.choice_from) > 1 else 0,
        tables.most_slots,
        1,
    )
    # the events of one visit: those after a fixed time, and the next one that comes at a rate
    most = max(map(len, tables.events_at), default=0)
    arrivals = 2 * room * (most + 1) + 1 if most else 1
    held = room * most + 1
    return kernel.PlanState(
        numbers=numbers,
        clocks=clocks,
        random=whole_numbers(4),
        counts=kernel.CountArrays(
            level=level,
            since=real(places),
            area=real(places),
            spent=real(int(spent_from[-1])),
            spent_from=spent_from,
        ),
        firings=whole_numbers(transitions),
        robots=kernel.Robots(
            at=robots_at,
            phase=whole_numbers(room),
            kind=kind,
            failures=whole_numbers(room),
            due_tag=whole_numbers(room),
            due_what=whole_numbers(room),
            visit_from=whole_numbers(room, kernel.NO_VISIT),
        ),
        members=kernel.Members(active, active_at, free),
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
        choices=kernel.ChoiceArrays(
            kernel.Candidates(whole_numbers(choices), whole_numbers(choices), real(choices)),
            kernel.Stamps(whole_numbers(places, -1), whole_numbers(places), whole_numbers(places)),
        ),
        calendar=kernel.Calendar(
            pending_robot=pending_robot,
            pending_what=pending_what,
            heap=new_heap(2 * room + 1),
            queue_tag=whole_numbers(2 * room + 1),
            queue_robot=whole_numbers(2 * room + 1),
            arrivals=new_heap(arrivals),
            held=kernel.Held(whole_numbers(held), whole_numbers(held), whole_numbers(held)),
        ),
        chance=kernel.Chance(
            ready_ones=kernel.Ready(whole_numbers(transitions), whole_numbers(transitions, -1)),
            changed=changed,
            is_changed=is_changed,
            tree=tree,
        ),
        movers=whole_numbers(max(tables.most_movers, 1)),
        targets=whole_numbers(max(tables.most_movers, 1)),
        stack=real(len(tables.rules.until.operations) + 1),
    )


def new_heap(size: int) -> kernel.Heap:
    """An empty heap with room for so many events."""
    return kernel.Heap(real(size), whole_numbers(size), whole_numbers(size))
