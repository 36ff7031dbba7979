"""What a plan means for each robot as it runs: the robot is *doing* the action of its place for a
duration, then *done* with an outcome, and the transition that it asks for fires as soon as it can.

The duration and the outcomes of a place come from the plan (``durations``, ``outcomes``,
``failures``). If it gives none, the net determines them: with exponential transitions of the rates
r_1, r_2, ... leaving the place, the duration is exponential with the mean 1 / (r_1 + r_2 + ...),
and outcome j has the probability r_j / (r_1 + r_2 + ...). A robot in a decision place takes no time
then, and the policy decides. A place that is mapped to no action (``null``) takes no time in any
case; one that the plan does not map at all is treated as if it had an action.

A transition with an event is not an outcome of the action: the event interrupts the robot, whatever
it is doing in the place. While a robot is there, its event occurs at the rate of the transition, or
after the event's ``after``.

This is the same as the classical reading of the net, in which exponential transitions race while
they are enabled, wherever nothing but the robot's own token can disable them, since exponential
times are memoryless. :attr:`PlanTiming.splits` names the places where the two differ.

A run net counts interchangeable robots in columns made of :class:`PlanRules`
(``run_net/compiling``); the simulation, which follows each robot, and the check read them as they
are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

from gspn_framework_package.model.condition import Condition, parse_condition
from gspn_framework_package.model.duration import Duration, Kind
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import OwnTimes, Plan

POLICY = -1
"""Stands for a transition: the action named none, and the policy decides."""


NO_REQUEST = -2
"""Stands for a transition: none, and the policy does not decide either."""

FOR_GOOD = -3
"""Stands for a transition: nothing ever, since no transition leaves the place."""


class PlaceTiming(NamedTuple):
    """The timing of a robot in an action place.

    :ivar duration: how long an attempt at the action takes, if the timeout does not cut it off.
    :ivar outcomes: pairs (transition number or :data:`POLICY`, probability); empty if no
        transition leaves the place.
    :ivar failure: the probability that an attempt fails that the timeout does not cut off.
    :ivar timeout: when an attempt is cut off, and fails (s); infinite: never.
    :ivar blocked: why a transition that the robot asks for may have to wait, for people; empty if
        nothing but the robot's own token can disable any of them.
    """

    duration: Duration
    outcomes: Tuple[Tuple[int, float], ...]
    failure: float
    timeout: float
    blocked: str


class PlanTiming:
    """The times of a plan's places.

    :param plan: a validated plan.

    :ivar places: number of each action place -> its timing, with the action of the team.
    :ivar events: number of each action place -> the transitions by which events interrupt a robot
        there.
    :ivar assumptions: sentences for people about what the plan leaves open and this class assumes.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._net = plan.net
        self.assumptions: List[str] = []
        self.events: Dict[int, Tuple[int, ...]] = {
            self._net.place_index[name]: tuple(
                self._net.transition_index[t] for t in plan.interrupts(name)
            )
            for name in plan.action_places
        }
        self._of_action = {p: plan.of_action(p) for p in self.events}
        self.places: Dict[int, PlaceTiming] = {
            self._net.place_index[name]: self._timing(name) for name in plan.action_places
        }
        self._idle = {
            p: timing._replace(
                duration=Duration.none(),
                outcomes=self._asked_at_once(p),
                failure=0.0,
                timeout=math.inf,
            )
            for p, timing in self.places.items()
        }
        self._own: Dict[Tuple[str, int], PlaceTiming] = {}
        for robot, own in plan.own_times.items():
            for place in (*own.durations, *own.outcomes, *own.failures):
                p = self._net.place_index[place]
                team = self.places[p]
                self._own[robot, p] = team._replace(
                    duration=own.durations.get(place, team.duration),
                    outcomes=self._named(own.outcomes[place])
                    if place in own.outcomes
                    else team.outcomes,
                    failure=own.failures.get(place, team.failure),
                )
        self._assume()

    def of(self, robot: str, place: int) -> PlaceTiming:
        """The timing of ``robot`` in action place number ``place``, with the robot's own action if
        it has one, and in its own time."""
        if self.is_idle(place, robot):
            return self._idle[place]
        return self._own.get((robot, place), self.places[place])

    @property
    def differing(self) -> str:
        """Why states that do not distinguish robots give no times; empty if they do."""
        team = {robot.name for robot in self._plan.robots}
        for robot, p in self._own:
            if robot in team:
                return (
                    "robots differ: %s has its own times or outcomes in %s (own_times), and states "
                    "do not distinguish robots" % (robot, self._net.places[p].name)
                )
        return ""

    @property
    def splits(self) -> Dict[str, str]:
        """Place -> why the run differs there from the classical reading of the net: the places
        where *doing* and *done* must be distinguished."""
        found = {}
        for p, timing in self.places.items():
            why = self._why_split(p, self._idle[p] if self.is_idle(p) else timing)
            if why:
                found[self._net.places[p].name] = why
        return found

    def is_idle(self, p: int, robot: str = "") -> bool:
        """Whether the place is mapped to no action: for the robot, or for the team."""
        name, plan = self._net.places[p].name, self._plan
        mapped = name in plan.actions or name in plan.own_actions.get(robot, {})
        return mapped and plan.action(robot, name) is None

    def _why_split(self, p: int, timing: PlaceTiming) -> str:
        leaving = self._of_action[p]
        timed = [t for t in leaving if self._net.transitions[t].timed]
        if not leaving and all(t == POLICY for t, _ in timing.outcomes):
            return ""  # no robot leaves when the action is done
        if timing.duration.mean == 0:
            return "its action takes no time" if timed else ""
        if timing.duration.kind is not Kind.EXPONENTIAL:
            return "its action takes a time that is not exponential (%s)" % (
                timing.duration.describe()
            )
        if len(timed) < len(leaving):
            return "its action takes time before the policy decides"
        return timing.blocked

    # -- one place ---------------------------------------------------------------------------------

    def _timing(self, name: str) -> PlaceTiming:
        plan, net = self._plan, self._net
        p = net.place_index[name]
        if self.is_idle(p) and not any(name in r.actions for r in plan.robots):
            return PlaceTiming(
                Duration.none(), self._asked_at_once(p), 0.0, math.inf, self._blocked(p)
            )
        given = plan.durations.get(name)
        leaving = self._of_action[p]
        rates = [(t, net.transitions[t].number) for t in leaving if net.transitions[t].timed]
        decides = len(rates) < len(leaving)
        total = sum(rate for _, rate in rates)
        if given is not None:
            duration = given
        elif decides or not rates:
            duration = Duration.none()
        else:
            duration = Duration.exponential(1 / total)
        outcomes = plan.outcomes.get(name)
        if outcomes is not None:
            pairs = self._named(outcomes)
        elif decides or (not leaving and self.events[p]):
            pairs = ((POLICY, 1.0),)
        else:
            pairs = tuple((t, rate / total) for t, rate in rates)
        limit = plan.timeout(name)
        return PlaceTiming(
            duration,
            pairs,
            plan.failures.get(name, 0.0),
            math.inf if limit is None else limit,
            self._blocked(p),
        )

    def _named(self, outcomes: Mapping[str, float]) -> Tuple[Tuple[int, float], ...]:
        number = self._net.transition_index
        return tuple((number[t] if t else POLICY, v) for t, v in outcomes.items() if v > 0)

    def _asked_at_once(self, p: int) -> Tuple[Tuple[int, float], ...]:
        """What a robot requests in a place without an action (``docs/semantics.md``)."""
        asked = unnamed(self._plan, p)
        return ((asked, 1.0),) if asked != NO_REQUEST and self._net.consumers[p] else ()

    def _blocked(self, p: int) -> str:
        named = self._plan.outcomes.get(self._net.places[p].name, {})
        for t in self._net.consumers[p]:
            transition = self._net.transitions[t]
            if transition.timed and (t not in self.events[p] or named.get(transition.name)):
                why = self._net.why_blocked(t, p)
                if why:
                    return "%s %s" % (self._net.transitions[t].name, why)
        return ""

    # -- assumptions --------------------------------------------------------------------------

    def _assume(self) -> None:
        plan, net = self._plan, self._net
        no_time: List[str] = []
        by_rates: List[str] = []
        for p, timing in self.places.items():
            name = net.places[p].name
            if self.is_idle(p) or not self._of_action[p]:
                continue
            if name not in plan.durations:
                (no_time if timing.duration.mean == 0 else by_rates).append(name)
        if no_time:
            self.assumptions.append(
                "the actions of %s take no time, since the plan gives no durations for them"
                % listed(no_time)
            )
        if by_rates:
            self.assumptions.append(
                "the actions of %s take exponential times, by the rates of the net"
                % listed(by_rates)
            )
        decided = [
            net.places[p].name
            for p, timing in self.places.items()
            if timing.outcomes == ((POLICY, 1.0),)
            and net.places[p].name not in plan.outcomes
            and not self.is_idle(p)
            and not (self.events[p] and not self._of_action[p])
        ]
        if decided:
            self.assumptions.append("the policy, not the action, decides in %s" % listed(decided))
        by_rate = [
            net.transitions[t].name
            for events in self.events.values()
            for t in events
            if plan.events[net.transitions[t].name].comes_after is None
        ]
        if by_rate:
            self.assumptions.append(
                "while a robot is in their place, the events %s occur at the rates of the net"
                % listed(by_rate)
            )
        resumed = [
            net.transitions[t].name
            for events in self.events.values()
            for t in events
            if plan.events[net.transitions[t].name].resume
        ]
        if resumed:
            self.assumptions.append(
                "a visit that continues one that %s interrupted takes as long, and ends, as any "
                "other" % listed(resumed)
            )
        if plan.tasks.queues:
            self.assumptions.append(
                "tasks from %s are interchangeable: how long an action takes or what it names "
                "cannot depend on their data" % listed(plan.tasks.queues)
            )
        if plan.tasks.order:
            orders = ["%s (by %s)" % item for item in plan.tasks.order.items()]
            self.assumptions.append(
                "tokens are counted, so the order in which tasks are taken from %s changes nothing "
                "here; it does in runs, and in what simulate --log records" % listed(orders)
            )


class PlaceVisit(NamedTuple):
    """What a robot does in an action place.

    :ivar idle: whether it has no action, so that it is done on arrival.
    :ivar duration: how long an attempt at its action takes, if the timeout does not cut it off.
    :ivar timeout: when an attempt is cut off, and fails (s); infinite: never.
    :ivar failure: the probability that an attempt fails that the timeout does not cut off.
    :ivar asks: pairs (what it asks for when an attempt succeeded, probability): a transition,
        ``POLICY``, :data:`FOR_GOOD`, or ``NO_REQUEST``: what it says is not possible there, so that
        the attempt has failed. Several pairs may ask for the same.
    :ivar rule: what it does when an attempt has failed.
    :ivar fallback: the transition that it asks for when no further attempt is made; -1: none.
    """

    idle: bool
    duration: Duration
    timeout: float
    failure: float
    asks: Tuple[Tuple[int, float], ...]
    rule: FailureRule
    fallback: int


@dataclass(frozen=True)
class PlanRules:
    """What a plan means for each of its robots, made by :func:`rules_of`.

    :ivar plan: the plan.
    :ivar net: its net without the counters that nothing reads (``counters``). All numbers of places
        and transitions here are those of this net.
    :ivar classical: whether this is the classical reading.
    :ivar acts: for each place whether its tokens are robots.
    :ivar robots_of: for each transition the robots that it takes: pairs (place, robots).
    :ivar urgency: for each transition its priority; -1 if it is exponential.
    :ivar interrupted: the transitions by which events interrupt robots -> the place of the robot.
    :ivar spontaneous: immediate transitions that only take resources.
    :ivar environment: exponential ones that only take resources.
    :ivar resets: for each transition whether its firing ends the draws of all robots: a firing
        that changes the marking does.
    :ivar until: the condition that ends the run, or None.
    :ivar kinds: one robot of each kind: robots with equal actions and times are of one. The first,
        "", is any robot without its own.
    :ivar kind_of: the kind of each robot of the plan.
    :ivar visits: for each kind, action place -> what it does there; empty in the classical reading.
    """

    plan: Plan
    net: Net
    counters: Tuple[str, ...]
    classical: bool
    acts: Sequence[bool]
    robots_of: Sequence[Tuple[Tuple[int, int], ...]]
    urgency: Sequence[int]
    interrupted: Mapping[int, int]
    spontaneous: Sequence[int]
    environment: Sequence[int]
    resets: Sequence[bool]
    until: Optional[Condition]
    kinds: Sequence[str]
    kind_of: Sequence[int]
    visits: Sequence[Mapping[int, PlaceVisit]]

    def of_action(self, p: int) -> List[int]:
        """The transitions that leave place ``p`` without an event: those that a robot can ask
        for by itself."""
        return [t for t in self.net.consumers[p] if t not in self.interrupted]

    def requested(self, p: int) -> Set[int]:
        """The transitions that robots in place ``p`` ask for by themselves, not by the policy."""
        asked = {t for visits in self.visits for t, _ in visits[p].asks}
        return asked.intersection(self.of_action(p))

    def idle_places(self, everybody: bool = False) -> Dict[int, int]:
        """The places in which some robot has no action -> what it asks for there at once.

        :param everybody: only those in which no robot has one.
        """
        found: Dict[int, int] = {}
        for p in self.visits[0]:
            idle = [visits[p] for visits in self.visits if visits[p].idle]
            mapped = self.net.places[p].name in self.plan.actions
            kinds = {*self.kind_of, 0} if mapped else {*self.kind_of}
            if idle and not (everybody and any(not self.visits[k][p].idle for k in kinds)):
                asked, fallback = idle[0].asks[0][0], idle[0].fallback
                found[p] = fallback if asked == NO_REQUEST and fallback >= 0 else asked
        return found


def rules_of(plan: Plan, timing: Optional[PlanTiming], left_out: Sequence[str] = ()) -> PlanRules:
    """What a plan means for each of its robots.

    :param plan: a validated plan.
    :param timing: its durations and outcomes; None: the classical reading.
    :param left_out: resource places that nothing reads.
    """
    net = plan.net.without_places(left_out) if left_out else plan.net
    numbers = range(len(net.transitions))
    acts = [p.name not in plan.resource_places for p in net.places]
    robots_of = [tuple((p, w) for p, w in arcs if acts[p]) for arcs in net.inputs]
    alone = [t for t in numbers if not robots_of[t]]
    kinds, kind_of = _kinds(plan)
    return PlanRules(
        plan,
        net,
        tuple(left_out),
        timing is None,
        acts,
        robots_of,
        [-1 if t.timed else t.priority for t in net.transitions],
        {
            t: p
            for t in numbers
            if net.transitions[t].timed and net.transitions[t].name in plan.events
            for p, _ in robots_of[t]
        },
        [t for t in alone if not net.transitions[t].timed],
        [t for t in alone if net.transitions[t].timed],
        # a firing that only adds to a counter changes the marking of the run
        [timing is None or bool(plan.net.effect(t)) for t in numbers],
        parse_condition(plan.until, net.place_index) if plan.until else None,
        kinds,
        kind_of,
        [{} if timing is None else _visits(plan, timing, net, kind) for kind in kinds],
    )


def _visits(plan: Plan, timing: PlanTiming, net: Net, robot: str) -> Dict[int, PlaceVisit]:
    """What a robot does in each action place."""
    found: Dict[int, PlaceVisit] = {}
    for p, place in enumerate(net.places):
        if place.name in plan.resource_places:
            continue
        number = plan.net.place_index[place.name]
        default, possible = unnamed(plan, number), {POLICY, *net.consumers[p]}
        times = timing.of(robot, number)
        outcomes = [(default if t == POLICY else t, v) for t, v in times.outcomes if v > 0]
        asks = [(t if t in possible else NO_REQUEST, v) for t, v in outcomes or [(default, 1.0)]]
        found[p] = PlaceVisit(
            timing.is_idle(number, robot),
            times.duration,
            times.timeout,
            times.failure,
            tuple(asks) if net.consumers[p] else ((FOR_GOOD, 1.0),),
            plan.failure_rule(place.name),
            plan.fallback(number),
        )
    return found


def _kinds(plan: Plan) -> Tuple[List[str], List[int]]:
    """One robot of each kind, and the kind of each robot of the plan."""
    names = [""]
    kinds: List[Tuple[Mapping[str, Any], Optional[OwnTimes]]] = [({}, None)]
    of: List[int] = []
    for robot in plan.robots:
        kind = robot.actions, plan.own_times.get(robot.name)
        if kind not in kinds:
            kinds.append(kind)
            names.append(robot.name)
        of.append(kinds.index(kind))
    return names, of


def unnamed(plan: Plan, place: int) -> int:
    """The request of a robot in place number ``place`` whose action has named no transition:
    :data:`POLICY` if immediate transitions leave the place, or nothing but events; otherwise the
    only transition; :data:`NO_REQUEST` if there are several, so that its action has failed."""
    leaving = plan.of_action(place)
    if not leaving or plan.net.immediate_from[place]:
        return POLICY
    return leaving[0] if len(leaving) == 1 else NO_REQUEST


def listed(names: Sequence[str]) -> str:
    """The first names of a list, and how many more there are."""
    more = len(names) - 5
    return ", ".join(names[:5]) + (", and %d more" % more if more > 0 else "")
