"""The markings that a run of a plan can reach, for the check before any robot moves.

They are the *untimed* ones: a robot in a decision place is busy with its action while others move,
so immediate transitions have no priority here. Counters that nothing reads are omitted, so that the
exploration ends. A robot can be lost anywhere, so smaller teams are covered too. Firings that the
policy never chooses are then removed (this does not foresee a Python action that names an immediate
transition itself, unless the plan's ``outcomes`` say so).
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, Collection, Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Indices
from gspn_framework_package.analysis.graph import (
    ShortestWays,
    adjacency,
    components,
    on_a_cycle,
    reachable_from,
)
from gspn_framework_package.analysis.plan.edited_nets import with_end, with_losses
from gspn_framework_package.analysis.plan.policy_answers import PolicyAnswers
from gspn_framework_package.analysis.plan.structure import may_be_named, terminal_places
from gspn_framework_package.analysis.state_space.space import StateSpace, explore
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.plan import LostKind, Plan
from gspn_framework_package.model.plan_timing import POLICY, PlanRules, PlanTiming, rules_of


class Finding(NamedTuple):
    """A marking with a shortest firing sequence that leads to it, and the ``place`` that the
    finding concerns, if any."""

    marking: Dict[str, int]
    sequence: List[str]
    place: Optional[str] = None

    def to_json(self) -> Dict[str, Any]:
        """As plain JSON values."""
        data: Dict[str, Any] = {"marking": self.marking, "sequence": self.sequence}
        return {**data, "place": self.place} if self.place else data


class PlanMarkings:
    """The reachable markings of a plan.

    :param plan: a validated plan.
    :param limit: most states to visit.
    :param losses: whether robots can be lost.
    :param seconds: the longest time (s), of which half is for visiting.
    :param keep: counters that are not left out.
    :raises CancelledError: ``cancel`` returned true.
    :raises LimitError: what the policy never chooses was not found in the rest of the time.
    """

    def __init__(
        self,
        plan: Plan,
        limit: int,
        *,
        losses: bool,
        progress: Optional[Progress] = None,
        cancel: Optional[Cancel] = None,
        seconds: float = math.inf,
        keep: Collection[str] = (),
    ) -> None:
        self.plan = plan
        self.losses = losses
        self.left_out = tuple(p for p in plan.counters if p not in keep)
        net = plan.net.without_places(self.left_out)
        self._own = len(net.transitions)
        if losses:
            net = with_losses(net, plan, set(self.left_out))
        self.net = net = with_end(net, plan)
        self._watch = Watch(progress, cancel, seconds=seconds)
        self.space: StateSpace = explore(
            net, limit=limit, untimed=True, progress=progress, cancel=cancel, seconds=seconds / 2
        )
        self._table = plan.policy.bind(plan.net)
        self._robots = [
            p for p, place in enumerate(net.places) if place.name not in plan.resource_places
        ]
        self._number = {p: plan.net.place_index[place.name] for p, place in enumerate(net.places)}
        self._sources = self.space.sources
        self._is_loss = self.space.transitions >= self._own
        self._over = self._until()
        self.allowed = ~self._over[self._sources]
        own = {number: p for p, number in self._number.items()}
        self._answers = PolicyAnswers(
            plan.net,
            plan.policy,
            lambda p, states: (
                self.space.column(own[p], states)
                if p in own
                else np.zeros(len(states), dtype=np.int64)
            ),
            self._watch,
        )
        self.possible = self.allowed.copy()
        """The firings that may happen: those that are allowed, and those that nobody but an action
        or a rule of failure asks for."""
        self._cross_out()
        ways = ShortestWays(
            len(self.space), self._sources, self.space.targets, self.possible & ~self._is_loss
        )
        self._ways = ways
        self._ways_with_losses = (
            ShortestWays(len(self.space), self._sources, self.space.targets, self.possible)
            if losses
            else ways
        )

    @property
    def complete(self) -> bool:
        """Whether all reachable markings were visited."""
        return self.space.complete

    def _until(self) -> Booleans:
        if not self.plan.until:
            return np.zeros(len(self.space), dtype=bool)
        return self.space.holds(self.plan.until)

    # -- the policy --------------------------------------------------------------------------------

    def _cross_out(self) -> None:
        """Disallow the firings of immediate transitions that are never chosen."""
        transitions, robots = self.net.transitions, set(self._robots)
        for t in range(self._own):
            if transitions[t].timed:
                continue
            self._watch.step("transitions of the policy", t)
            asking = [p for p, _ in self.net.inputs[t] if p in robots]
            if not asking:
                continue
            arcs = np.flatnonzero(self.space.transitions == t)
            if not len(arcs):
                continue
            wanted = np.zeros(len(arcs), dtype=bool)
            for p in asking:
                unsaid = not self.plan.strict and not transitions[t].is_controllable
                wanted |= self._chosen(p, t, self._sources[arcs], unsaid)
            self.allowed[arcs[~wanted]] = False
            if not may_be_named(self.plan, t, [self._number[p] for p in asking]):
                self.possible[arcs[~wanted]] = False

    def _chosen(self, p: int, t: int, states: Indices, unsaid: bool) -> Booleans:
        """Boolean array: the ``states`` in which the policy gives transition ``t`` some probability
        for a robot in place ``p``, or says nothing, if that counts (``unsaid``)."""
        number, answers = self._answers.of(self._number[p], states)
        found = np.array([t in dict(choices) for choices in answers])
        found[0] = unsaid
        return found[number]

    def _silent(self, p: int, states: Indices) -> Indices:
        """Those of the ``states`` in which the policy says nothing to a robot in place ``p``."""
        return states[self._answers.of(self._number[p], states)[0] == 0]

    def policy_gaps(self) -> Iterator[Finding]:
        """Markings that need a decision but match no row of the policy. A strict plan needs one
        whenever an immediate transition is enabled, other plans only if two or more are."""
        need = 1 if self.plan.strict else 2
        for p, leaving in self._decision_places():
            if not self.plan.strict and not self._table.rows_of(self.original(p)):
                continue  # a subnet without its own policy
            yield from self._findings(self._silent(p, self._deciding(leaving, need)), p)

    def undecided_choices(self) -> Iterator[Finding]:
        """Markings in which neither the policy nor a positive weight decides, so that a robot waits
        indefinitely."""
        if self.plan.strict:
            return
        controllable = [t.is_controllable for t in self.net.transitions]
        for p, leaving in self._decision_places():
            states = self._deciding(leaving, 1)
            weighty = [t for t in leaving if not controllable[t]]
            some = np.zeros(len(self.space), dtype=bool)
            some[self._sources[np.isin(self.space.transitions, weighty)]] = True
            states = states[~some[states]]
            yield from self._findings(self._silent(p, states), p)

    def _decision_places(self) -> Iterator[Tuple[int, Sequence[int]]]:
        for p in self._robots:
            leaving = self.plan.net.immediate_from[self._number[p]]
            if leaving:
                yield p, leaving

    def _deciding(self, leaving: Sequence[int], need: int) -> Indices:
        """States of an unfinished run in which at least ``need`` of the transitions ``leaving`` are
        enabled."""
        arcs = np.isin(self.space.transitions, leaving)
        enabled = np.bincount(self._sources[arcs], minlength=len(self.space))
        return np.flatnonzero((enabled >= need) & self._ways_with_losses.reached & ~self._over)

    # -- dead markings -----------------------------------------------------------------------------

    def dead(self, *, after_losses: bool) -> Iterator[Finding]:
        """Markings in which nothing can happen although some robot has not reached an end: those of
        the whole team, or (with ``after_losses``) those reachable only after losing robots."""
        moving = np.zeros(len(self.space), dtype=bool)
        moving[self._sources[self.allowed & ~self._is_loss]] = True
        ends = terminal_places(self.plan)
        busy = np.zeros(len(self.space), dtype=bool)
        for p in self._robots:
            if self._number[p] not in ends:
                busy |= self.space.column(p) > 0
        dead = ~moving & busy & ~self._over
        dead[self.space.explored :] = False
        if after_losses:
            return self._findings(
                np.flatnonzero(dead & self._ways_with_losses.reached & ~self._ways.reached)
            )
        return self._findings(np.flatnonzero(dead & self._ways.reached))

    def without_robots(self) -> Iterator[Finding]:
        """Markings in which no robot is left and nothing can happen any more."""
        over = self._over.copy()
        over[self._sources[self.allowed & ~self._is_loss]] = True
        over[self.space.explored :] = True
        for p in self._robots:
            over |= self.space.column(p) > 0
        return self._findings(np.flatnonzero(~over & self._ways.reached))

    # -- robots that wait for good -----------------------------------------------------------------

    def waiting_for_good(self, timeless: List[int]) -> Iterator[Tuple[str, Finding]]:
        """Transitions that a robot can request in vain for ever while others continue for ever,
        each with a marking of the whole team in which a robot in the finding's place does.

        The markings do not say what robots have requested. This is certain all the same: the
        marking is reached by firings that the plan's actions and policy ask for, and whatever
        happens then, losses included, no marking enables the transition, an event that interrupts
        the wait, or the end of the run as long as this robot stays. Plans in which immediate
        transitions have different priorities are left out, since the markings ignore these.

        :param timeless: the transitions that may follow another one without time between them.
        """
        space, sources, targets = self.space, self._sources, self.space.targets
        requests = self._requests()
        doubtful = [
            (p, t)
            for p, asked in requests.items()
            for t in sorted(asked)
            if not self.plan.net.fires_alone(t, self.original(p))
        ]
        if not doubtful or len({t.priority for t in self.net.transitions if not t.timed}) > 1:
            return
        certain = self._certain(requests, timeless)
        ways = ShortestWays(len(space), sources, targets, certain)
        for p, t in doubtful:
            taken = np.array([dict(inputs).get(p, 0) for inputs in self.net.inputs])
            here = space.column(p)
            stays = here[sources] > taken[space.transitions]
            ends = self._over.copy()
            ends[sources[np.isin(space.transitions, self._end_of_wait(p, t))]] = True
            others = stays & ~self._over[sources]
            may_end = reachable_from(len(space), targets[others], sources[others], ends)
            waits = ways.reached & (here > 0) & ~may_end
            onward = np.flatnonzero(certain & stays & waits[sources])
            if not len(onward):
                continue
            before, after = sources[onward], targets[onward]
            around = on_a_cycle(len(space), before, after)
            go_on = waits & reachable_from(len(space), after, before, around)
            for state in np.flatnonzero(go_on)[:1].tolist():
                yield self.net.transitions[t].name, self._finding(state, p, ways)

    def held_for_good(self, timeless: List[int]) -> Iterator[Finding]:
        """Markings of the whole team from which no robot ever leaves the finding's place, whatever
        happens, while others continue for ever; one for each place that robots can leave.

        So it is where robots wait for each other. It is certain as in :meth:`waiting_for_good`, but
        for losses: a robot that is lost may free the others.

        :param timeless: as there.
        """
        space, size = self.space, len(self.space)
        if len({t.priority for t in self.net.transitions if not t.timed}) > 1:
            return
        live = np.flatnonzero(self.possible & ~self._is_loss)
        before, after, fired = self._sources[live], space.targets[live], space.transitions[live]
        part = components(size, before, after)
        lasting = np.zeros(part.number, dtype=bool)
        lasting[part.of[before]] = True
        lasting &= part.bottom  # what fires there leads back into it
        members = np.flatnonzero(lasting[part.of])
        inside = lasting[part.of[before]]
        count = len(self.net.transitions)
        firing = np.unique(part.of[before[inside]].astype(np.int64) * count + fired[inside])
        ends = terminal_places(self.plan)
        ways: Optional[ShortestWays] = None
        for p in self._robots:
            exits = [t for t in self.net.consumers[p] if t < self._own]
            if self._number[p] in ends or not exits:
                continue
            marked = part.of[members[space.column(p, members) > 0]]
            left = firing[np.isin(firing % count, exits)] // count
            if not len(np.setdiff1d(marked, left)):
                continue
            can_leave = self._over.copy()
            can_leave[before[np.isin(fired, exits)]] = True
            may_leave = reachable_from(size, after, before, can_leave)
            if ways is None:
                certain = self._certain(self._requests(), timeless)
                ways = ShortestWays(size, self._sources, space.targets, certain)
            held = ways.reached & (space.column(p) > 0) & ~may_leave
            goes_on = held & reachable_from(size, after, before, held & lasting[part.of])
            for state in np.flatnonzero(goes_on)[:1].tolist():
                yield self._finding(state, p, ways)

    @cached_property
    def _rules(self) -> PlanRules:
        return rules_of(self.plan, PlanTiming(self.plan))

    def _requests(self) -> Dict[int, Set[int]]:
        """The transitions that robots request by themselves, for each place."""
        return {p: self._rules.requested(self.original(p)) for p in self._robots}

    def _certain(self, requests: Dict[int, Set[int]], timeless: List[int]) -> Booleans:
        """The firings that a run can certainly make: those that robots request, or that the policy
        chooses for them, and, where something fires without time, only that.

        :param requests: the transitions that robots request by themselves, for each place.
        """
        kinds = self._rules.visits
        policy_asked = {
            p: all(POLICY in dict(visits[self.original(p)].asks) for visits in kinds)
            for p in requests
        }
        never = [
            t
            for t, transition in enumerate(self.net.transitions[: self._own])
            if t not in self._rules.interrupted
            and any(
                t not in requests[p] and (transition.timed or not policy_asked[p])
                for p, _ in self.net.inputs[t]
                if p in requests
            )
        ]
        certain = self.allowed & ~self._is_loss & ~np.isin(self.space.transitions, never)
        at_once = certain & np.isin(self.space.transitions, timeless)
        self._settle_precedence(at_once)
        passing = np.zeros(len(self.space), dtype=bool)
        passing[self._sources[at_once]] = True
        return certain & (~passing[self._sources] | at_once)

    def _end_of_wait(self, p: int, t: int) -> List[int]:
        """The transitions that take away a robot in place number ``p`` that has requested ``t``."""
        names = list(self.plan.interrupts(self.net.places[p].name))
        if self.plan.on_lost.kind is LostKind.FIRE:
            names.append(self.plan.on_lost.transition)
        return [t, *map(self.plan.net.transition_number, names)]

    # -- other questions ---------------------------------------------------------------------------

    def firing(self, transition: int) -> Optional[Finding]:
        """A reachable marking right after transition number ``transition`` of the plan's net fired,
        or None."""
        arcs = np.flatnonzero(
            (self.space.transitions == transition)
            & self.possible
            & self._ways_with_losses.reached[self._sources]
        )
        if not len(arcs):
            return None
        found = self._finding(int(self._sources[arcs[0]]))
        name = self.net.transitions[transition].name
        return found._replace(
            sequence=found.sequence + [name],
            marking=self.space.named(int(self.space.targets[arcs[0]])),
        )

    def never_fire(self) -> List[str]:
        """Transitions that never fire in any reachable marking of the whole team."""
        fired = np.zeros(len(self.net.transitions), dtype=bool)
        fired[self.space.transitions[self.possible & self._ways.reached[self._sources]]] = True
        return [t.name for t, seen in zip(self.net.transitions[: self._own], fired) if not seen]

    def bounds(self) -> Dict[str, int]:
        """The maximum number of tokens that each place holds in any visited marking."""
        return {
            place.name: int(self.space.column(p).max()) for p, place in enumerate(self.net.places)
        }

    def timeless_traps(self, timeless: List[int]) -> Iterator[Finding]:
        """Markings from which no firing sequence of the ``timeless`` transitions ever ends."""
        own = np.zeros(len(self.net.transitions), dtype=bool)
        own[timeless] = True
        arcs = own[self.space.transitions] & self.allowed
        arcs &= self._ways_with_losses.reached[self._sources]
        rests = self._settle_precedence(arcs)
        alive = np.zeros(len(self.space), dtype=bool)
        alive[self._sources[arcs]] = True
        alive &= ~rests
        # Repeatedly remove the states from which some firing leads to a state with none left.
        backward = adjacency(len(self.space), self.space.targets[arcs], self._sources[arcs])
        frontier = np.flatnonzero(~alive)
        while len(frontier):
            before = np.unique(backward[frontier].indices)
            frontier = before[alive[before]]
            alive[frontier] = False
        return self._findings(np.flatnonzero(alive))

    def _settle_precedence(self, arcs: Booleans) -> Booleans:
        """Remove from the timeless ``arcs`` those over which others take precedence, as in a run:
        transitions that take only resources go first, then higher priorities.

        :returns: the states in which every robot may have drawn what cannot fire now, so that
            nothing happens for the time being.
        """
        net, size = self.net, len(self.space)
        losses = len(net.transitions) - self._own
        urgency = np.array([*self._rules.urgency, *[-1] * losses], dtype=np.int64)
        urgency_of = urgency[self.space.transitions]
        idle = self._rules.idle_places(everybody=True)
        takes_robots = np.array([*map(bool, self._rules.robots_of), *[True] * losses], dtype=bool)
        alone = arcs & ~takes_robots[self.space.transitions]
        most = np.full(size, -2)  # the highest urgency that must go first
        np.maximum.at(most, self._sources[alone], urgency_of[alone])
        first = np.zeros(size, dtype=bool)
        first[self._sources[alone]] = True
        arcs &= ~first[self._sources] | (alone & (urgency_of == most[self._sources]))
        rests = ~first
        floor = np.full(size, -2)
        asked = alone.copy()
        for p in self._robots:
            leaving = [t for t in net.consumers[p] if t < self._own]
            here = arcs & np.isin(self.space.transitions, leaving)
            if not here.any():
                continue
            top = np.full(size, -2)
            np.maximum.at(top, self._sources[here], urgency_of[here])
            asked |= here & (urgency_of == top[self._sources])  # its robots draw among these
            waits = self._may_draw_in_vain(p, leaving, top, arcs)
            rests &= waits | (top < -1)
            if self._number[p] in idle:
                floor = np.maximum(floor, np.where(waits, -2, top))
        arcs &= asked & (urgency_of >= floor[self._sources])
        return rests

    def _may_draw_in_vain(
        self, p: int, leaving: List[int], top: Indices, arcs: Booleans
    ) -> Booleans:
        """The states in which a robot in place number ``p`` may draw, by a row of the policy, a
        transition that cannot fire as long as nobody ends an action.

        :param top: for each state, the highest priority of those that can.
        :param arcs: the arcs of the transitions that can.
        """
        waits = np.zeros(len(self.space), dtype=bool)
        if not self.plan.policy.rows:
            return waits
        for t in leaving:
            if self.net.transitions[t].timed:
                continue
            states = np.flatnonzero((top >= -1) & (top <= self.net.transitions[t].priority))
            fires = np.zeros(len(self.space), dtype=bool)
            fires[self._sources[arcs & (self.space.transitions == t)]] = True
            states = states[~fires[states]]
            waits[states[self._chosen(p, t, states, unsaid=False)]] = True
        return waits

    @property
    def reached(self) -> Booleans:
        """Boolean array: the states that firings that may happen lead to."""
        return self._ways_with_losses.reached

    def nearest_first(self) -> Indices:
        """The numbers of these states, ordered by the number of firings that lead to them."""
        states = np.flatnonzero(self.reached)
        return states[np.argsort(self._ways_with_losses.depth[states], kind="stable")]

    def way_to(self, state: int) -> List[str]:
        """A shortest firing sequence to one of these states."""
        return self._finding(state, ways=self._ways_with_losses).sequence

    # -- helpers -----------------------------------------------------------------------------------

    def original(self, p: int) -> int:
        """The number, in the plan's net, of place number ``p`` of the explored net."""
        return self._number[p]

    def _findings(self, states: Indices, place: Optional[int] = None) -> Iterator[Finding]:
        for state in states.tolist():
            yield self._finding(state, place)

    def _finding(
        self, state: int, place: Optional[int] = None, ways: Optional[ShortestWays] = None
    ) -> Finding:
        ways = ways or (self._ways if self._ways.reached[state] else self._ways_with_losses)
        names = [
            self.net.transitions[self.space.transitions[arc]].name for arc in ways.way_to(state)
        ]
        return Finding(
            self.space.named(state), names, None if place is None else self.net.places[place].name
        )
