"""The times of a plan as it runs: a robot is *doing* the action of its place for a duration, then
*done* with an outcome, and the transition that it asks for fires as soon as it can.

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
"""

from __future__ import annotations

import math
from typing import Dict, List, NamedTuple, Sequence, Tuple

from gspn_framework_package.model.duration import Duration, Kind
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

POLICY = -1
"""In place of a transition: the action named none, and the policy decides."""


NO_REQUEST = -2
"""In place of a transition: none, and the policy does not decide either."""


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
        self._assume()

    def of(self, robot: str, place: int) -> PlaceTiming:
        """The timing of ``robot`` in action place number ``place``, with the robot's own action if
        it has one."""
        return self._idle[place] if self._is_idle(place, robot) else self.places[place]

    @property
    def splits(self) -> Dict[str, str]:
        """Place -> why the run differs there from the classical reading of the net: the places
        where *doing* and *done* must be distinguished."""
        found = {}
        for p, timing in self.places.items():
            why = self._why_split(p, self._idle[p] if self._is_idle(p) else timing)
            if why:
                found[self._net.places[p].name] = why
        return found

    def _is_idle(self, p: int, robot: str = "") -> bool:
        """Whether the place is mapped to no action: for the robot, or for the team."""
        name = self._net.places[p].name
        for spec in self._plan.robots:
            if spec.name == robot and name in spec.actions:
                return spec.actions[name] is None
        return name in self._plan.actions and self._plan.actions[name] is None

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
        if self._is_idle(p) and not any(name in r.actions for r in plan.robots):
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
            pairs = tuple(
                (net.transition_index[t] if t else POLICY, chance)
                for t, chance in outcomes.items()
                if chance > 0
            )
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

    def _asked_at_once(self, p: int) -> Tuple[Tuple[int, float], ...]:
        """What a robot requests in a place without an action (``docs/semantics.md``)."""
        asked = unnamed(self._plan, p)
        return ((asked, 1.0),) if asked != NO_REQUEST and self._net.consumers[p] else ()

    def _blocked(self, p: int) -> str:
        named = self._plan.outcomes.get(self._net.places[p].name, {})
        for t in self._net.consumers[p]:
            transition = self._net.transitions[t]
            if transition.timed and (t not in self.events[p] or named.get(transition.name)):
                why = why_blocked(self._net, t, p)
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
            if self._is_idle(p) or not self._of_action[p]:
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
            and not self._is_idle(p)
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
                "tasks from %s are alike: how long an action takes and what it names does not "
                "depend on their data" % listed(plan.tasks.queues)
            )
        if plan.tasks.order:
            told = ["%s (by %s)" % item for item in plan.tasks.order.items()]
            self.assumptions.append(
                "tokens are counted, so the order in which tasks are taken from %s changes nothing "
                "here; it does in runs, and in what simulate --log records" % listed(told)
            )


def unnamed(plan: Plan, place: int) -> int:
    """What a robot in place number ``place`` requests whose action has named no transition:
    :data:`POLICY` if immediate transitions leave the place, or nothing but events; otherwise the
    only transition; :data:`NO_REQUEST` if there are several, so that its action has failed."""
    leaving = plan.of_action(place)
    if not leaving or plan.net.immediate_from[place]:
        return POLICY
    return leaving[0] if len(leaving) == 1 else NO_REQUEST


def why_blocked(net: Net, t: int, place: int) -> str:
    """What may disable transition number ``t`` other than the one token in ``place`` that requests
    it, for people; empty if nothing can."""
    for p, weight in net.inputs[t]:
        if p != place:
            return "also takes from %s" % net.places[p].name
        if weight > 1:
            return "takes %d tokens" % weight
    for p, _ in net.inhibitors[t]:
        return "has an inhibitor arc from %s" % net.places[p].name
    for p, change in net.effect(t):
        if change > 0 and net.places[p].capacity is not None:
            return "leads to %s, which has a capacity" % net.places[p].name
    return ""


def listed(names: Sequence[str]) -> str:
    """The first names of a list, and how many more there are."""
    more = len(names) - 5
    return ", ".join(names[:5]) + (", and %d more" % more if more > 0 else "")
