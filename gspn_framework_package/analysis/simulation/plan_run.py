"""Runs of a plan as it is executed: the state of the kernel, and what is rare enough for plain
Python: the start, and the loss of a robot."""

from __future__ import annotations

import math
from typing import Dict, List

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
        rules, book = self.arrays
        # plain tuples: numba's cache on the disk could not be read where a class of its types has
        # been renamed since
        return int(
            self.functions["play"](tuple(rules), tuple(book), tuple(self.state), stop, budget)
        )

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
        tables, s, rules = self.tables, self.state, self.arrays[0]
        numbers = s.numbers
        place = int(s.at[robot])
        drawn = self._drawn() if rules.sizes[7] else {}
        if s.phase[robot] == kernel.WAITING:
            wish = s.in_list[robot]
            kernel.unlink(robot, s.in_list, s.following, s.preceding, s.head, s.tail)
            s.level[len(self.net.places) + wish] -= 1
            s.waits[rules.list_group[wish]] -= 1
            drawn.pop(robot, None)
        elif s.phase[robot] == kernel.INACTIVE:
            numbers[kernel.INACTIVES] -= 1
        s.due_tag[robot] = 0
        s.visit_from[robot] = kernel.NO_VISIT
        s.phase[robot] = kernel.GONE
        numbers[kernel.ACTIVE] -= 1
        last = s.active[numbers[kernel.ACTIVE]]
        s.active[s.active_at[robot]] = last
        s.active_at[last] = s.active_at[robot]
        changes = [(place, -1)]
        begin, end = rules.evicted_from[place], rules.evicted_from[place + 1]
        changes += [(rules.evicted[k], rules.evicted[k + 1]) for k in range(begin, end, 2)]
        for p, amount in changes:
            kernel.shift(
                p, amount, self.now, s.level, s.since, s.area, s.spent, s.spent_from, numbers
            )
            kernel.touch(
                p,
                s.level,
                rules.spontaneous_from,
                rules.spontaneous,
                s.spontaneous_dirty,
                s.is_spontaneous_dirty,
                rules.environment_from,
                rules.environment,
                rules.environment_transition,
                rules.server_rate,
                rules.servers,
                rules.test_from,
                rules.tests,
                s.tree,
                rules.until_reads,
                numbers,
            )
        numbers[kernel.MARKING_VERSION] += 1
        if rules.sizes[7]:
            stuck = [other for other, t in drawn.items() if self._lacks(t, place)]
            if stuck and rules.sizes[7] == 1:
                return True
            for other in stuck:
                wish = tables.arc_of.get((int(rules.sizes[8]), int(s.at[other])))
                if wish is not None:
                    self._ask_instead(other, wish)
        for group in range(len(s.waits)):  # losses are rare: look at everything again
            if s.waits[group] > 0 and s.is_dirty[group] == 0:
                s.is_dirty[group] = 1
                s.dirty[numbers[kernel.DIRTY]] = group
                numbers[kernel.DIRTY] += 1
        return False

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
            count = kernel.weigh(
                p,
                s.numbers[kernel.MARKING_VERSION],
                rules.sizes[5],
                rules.sizes[6],
                book.any_of,
                s.level,
                rules.test_from,
                rules.tests,
                rules.priority,
                rules.weight,
                rules.leaving_from,
                rules.leaving,
                book.listed_from,
                book.listed,
                book.mask_from,
                book.mask_cells_from,
                book.mask_cells,
                book.mask_table,
                book.mask_size,
                book.tables,
                book.entry_row,
                book.entry_mixed,
                book.choice_from,
                book.choice,
                book.chance,
                book.cell_from,
                book.cells,
                s.candidate,
                s.candidate_ok,
                s.candidate_weight,
                s.group_version,
                s.group_signature,
                s.group_stamp,
                s.numbers,
            )
            kinds = s.numbers[kernel.KINDS]
            if kinds == 0:
                continue
            for robot in robots:
                if s.draw_stamp[robot] != s.group_stamp[p]:
                    s.draw_stamp[robot] = s.group_stamp[p]
                    s.draw[robot] = kernel.pick(count, kinds, s.candidate_weight, s.random)
                found[robot] = int(s.candidate[s.draw[robot]])
        return found

    def _listed(self, wish: int) -> List[int]:
        found = []
        robot = int(self.state.head[wish])
        while robot >= 0:
            found.append(robot)
            robot = int(self.state.following[robot])
        return found

    def _lacks(self, t: int, place: int) -> bool:
        """Whether transition ``t`` lacks a robot in ``place``."""
        s, places, arcs = self.state, len(self.net.places), len(self.tables.arcs)
        arc = self.tables.arc_of.get((t, place))
        if arc is None:
            return False
        there = s.level[places + arc]
        if not self.net.transitions[t].timed:
            there += s.level[places + arcs + place]
        return bool(there < self.tables.arcs[arc][2])

    def _ask_instead(self, robot: int, wish: int) -> None:
        """Let a waiting robot request something else."""
        s, places = self.state, len(self.net.places)
        old = s.in_list[robot]
        kernel.unlink(robot, s.in_list, s.following, s.preceding, s.head, s.tail)
        s.level[places + old] -= 1
        s.waits[self.arrays[0].list_group[old]] -= 1
        last = int(s.tail[wish])
        s.in_list[robot] = wish
        s.preceding[robot] = last
        s.following[robot] = -1
        if last < 0:
            s.head[wish] = robot
        else:
            s.following[last] = robot
        s.tail[wish] = robot
        s.level[places + wish] += 1
        s.waits[self.arrays[0].list_group[wish]] += 1

    def _book_times(self) -> None:
        s = self.state
        kernel.book_times(
            self.now, len(self.net.places), s.level, s.since, s.area, s.spent, s.spent_from
        )


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
    numbers[kernel.SPONTANEOUS_DIRTY] = len(spontaneous)
    spontaneous_dirty, is_spontaneous_dirty = whole_numbers(transitions), whole_numbers(transitions)
    spontaneous_dirty[: len(spontaneous)] = spontaneous
    is_spontaneous_dirty[spontaneous] = 1
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
        level=level,
        since=real(places),
        area=real(places),
        spent=real(int(spent_from[-1])),
        spent_from=spent_from,
        firings=whole_numbers(transitions),
        at=robots_at,
        phase=whole_numbers(room),
        kind=kind,
        failures=whole_numbers(room),
        in_list=whole_numbers(room),
        following=whole_numbers(room),
        preceding=whole_numbers(room),
        due_tag=whole_numbers(room),
        due_what=whole_numbers(room),
        draw=whole_numbers(room),
        draw_stamp=whole_numbers(room),
        active=active,
        active_at=active_at,
        free=free,
        head=whole_numbers(lists, -1),
        tail=whole_numbers(lists, -1),
        waits=whole_numbers(groups),
        dirty=whole_numbers(groups),
        is_dirty=whole_numbers(groups),
        volatile=whole_numbers(groups),
        is_volatile=whole_numbers(groups),
        group_version=whole_numbers(places, -1),
        group_signature=whole_numbers(places),
        group_stamp=whole_numbers(places),
        heap_time=real(2 * room + 1),
        heap_tag=whole_numbers(2 * room + 1),
        heap_robot=whole_numbers(2 * room + 1),
        queue_tag=whole_numbers(2 * room + 1),
        queue_robot=whole_numbers(2 * room + 1),
        pending_robot=pending_robot,
        pending_what=pending_what,
        movers=whole_numbers(max(tables.most_movers, 1)),
        targets=whole_numbers(max(tables.most_movers, 1)),
        candidate=whole_numbers(choices),
        candidate_ok=whole_numbers(choices),
        candidate_weight=real(choices),
        may_spontaneous=whole_numbers(transitions),
        spontaneous_at=whole_numbers(transitions, -1),
        spontaneous_dirty=spontaneous_dirty,
        is_spontaneous_dirty=is_spontaneous_dirty,
        tree=tree,
        stack=real(len(tables.rules.until_operations) + 1),
        visit_from=whole_numbers(room, kernel.NO_VISIT),
        arrival_time=real(arrivals),
        arrival_tag=whole_numbers(arrivals),
        arrival_who=whole_numbers(arrivals),
        held_robot=whole_numbers(held),
        held_tag=whole_numbers(held),
        held_event=whole_numbers(held),
    )
