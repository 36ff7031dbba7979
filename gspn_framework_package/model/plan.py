"""Plans: a net, a policy and a map from places to actions, with all the settings of a run.

``formats.plan_file`` (or ``formats.thesis_input``) reads a plan, and ``analysis.preflight`` checks
it. ``docs/semantics.md`` defines what its parts mean at run time.
"""

# In one piece: a plan is one value; the checks of its fields stand beside them

from __future__ import annotations

import enum
import hashlib
import json
import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import (
    Any,
    Callable,
    Container,
    Dict,
    FrozenSet,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Tuple,
)

from gspn_framework_package.model.action import Action, outcomes_of, why_not_valid
from gspn_framework_package.model.condition import Condition, parse_condition
from gspn_framework_package.model.duration import Duration, Evidence
from gspn_framework_package.model.errors import PlanError
from gspn_framework_package.model.event import QUEUE_ORDERS, EventSource, Tasks
from gspn_framework_package.model.failure import FailureEnd, FailureRule
from gspn_framework_package.model.marking_function import Value, written
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.policy import SUM_TOLERANCE, Policy
from gspn_framework_package.model.subnet import SEPARATOR, Subnet

MAX_ROBOTS = 10_000
"""Maximum number of robots in a team: a larger number is a typo, and would exhaust the memory."""


def too_many_robots(number: int) -> PlanError:
    """Return the error for a team of more than :data:`MAX_ROBOTS` robots."""
    return PlanError(
        "a team of %d robots; at most %d are possible" % (number, MAX_ROBOTS),
        element="robots",
        hint="every token in an action place is a robot; are these resource places?",
    )


class Synchronisation(enum.Enum):
    """How much the robots synchronise with each other (thesis 4.3.3)."""

    FULL = "full"
    """Every finished action goes through the shared log, over a topic."""
    PARTIAL = "partial"
    """A robot makes moves that affect no other robot locally; the rest is agreed through
    services."""


class Transport(enum.Enum):
    """What carries the messages between robots."""

    ROS = "ros"
    """Topics and services of one ROS master."""
    ZENOH = "zenoh"
    """Zenoh: robots need neither a common master nor ROS."""


class LostKind(enum.Enum):
    """What to do when other robots wait for a robot that is lost."""

    HOLD = "hold"
    """They keep waiting, and report what they wait for."""
    STOP = "stop"
    """The team stops."""
    FIRE = "fire"
    """Waiting robots request that transition instead, if it leaves their place."""


class LostRule(NamedTuple):
    """The rule for lost robots; ``transition`` applies to FIRE."""

    kind: LostKind = LostKind.HOLD
    transition: str = ""


class RobotSpec(NamedTuple):
    """A robot of the plan: its ``name``, its initial ``place`` and its own ``actions``, which
    override those of the team (for teams of different robots). ``capabilities`` are words by which
    a task may ask for such robots."""

    name: str
    place: str
    actions: Mapping[str, Action] = {}
    capabilities: Tuple[str, ...] = ()


TIME_KEYS = ("durations", "outcomes", "failures")
"""The keys of the plan file of what :class:`OwnTimes` holds."""


class OwnTimes(NamedTuple):
    """What a robot does in its own time and with its own outcomes, in place of the team's:
    ``durations``, ``outcomes`` and ``failures``, each by place as in the plan, and the ``evidence``
    of those that were learned, by key of the plan file and place."""

    durations: Mapping[str, Duration] = {}
    outcomes: Mapping[str, Mapping[str, float]] = {}
    failures: Mapping[str, float] = {}
    evidence: Mapping[Tuple[str, str], Evidence] = {}

    def scaled(self, factors: Mapping[str, float]) -> OwnTimes:
        """Those with longer or shorter durations: place -> factor (> 0)."""
        known, learned = self.durations.items(), self.evidence.items()
        return self._replace(
            durations={p: d.scaled(factors[p]) if p in factors else d for p, d in known},
            evidence={
                (key, p): of.scaled(factors.get(p, 1.0) if key == "durations" else 1.0)
                for (key, p), of in learned
            },
        )

    def nominal(self) -> OwnTimes:
        """Those that were not learned."""
        return self._kept(lambda key, place: (key, place) not in self.evidence)

    def without(self, places: Container[str]) -> OwnTimes:
        """Those of other places."""
        return self._kept(lambda _, place: place not in places)

    def _kept(self, keep: Callable[[str, str], bool]) -> OwnTimes:
        def kept(key: str) -> Dict[str, Any]:
            return {place: v for place, v in getattr(self, key).items() if keep(key, place)}

        evidence = {name: of for name, of in self.evidence.items() if keep(*name)}
        return self._replace(evidence=evidence, **{key: kept(key) for key in TIME_KEYS})


class Timing(NamedTuple):
    """Times of the agreement protocol, in seconds. A robot that no other has heard for
    ``evict_after`` is proposed for eviction (0 for never). A robot without contact to a quorum for
    ``fence_after`` stops itself (0 for never)."""

    evict_after: float = 10.0
    fence_after: float = 0.0


class RobotFlow(NamedTuple):
    """The number of robots that a transition takes from action places and puts into them."""

    taken: int
    put: int


@dataclass(frozen=True)
class Plan:
    """A plan. The code that creates one calls :meth:`validate`, which checks every field against
    the net.

    :ivar net: the net, whose initial marking has the robots and the resources.
    :ivar name: name of the plan.
    :ivar policy: the policy; without rows, the weights of the net decide.
    :ivar actions: place -> action of the team.
    :ivar resource_places: the places whose tokens are counters, not robots.
    :ivar robots: the robots of the team.
    :ivar spawn: the places where the robots of a larger team start, cyclically.
    :ivar synchronisation: how much the robots synchronise with each other.
    :ivar transport: the transport of messages for robots that do not override it at their start.
        Not part of :meth:`hash`.
    :ivar seed: seed of the policy's random draws.
    :ivar strict: whether a marking without a policy row is a fault.
    :ivar on_failure: place or ``'*'`` -> failure rule.
    :ivar timeouts: place or ``'*'`` -> maximum time that an action may take, in seconds.
    :ivar routing: transition -> {place that a robot leaves: place that it enters}; otherwise the
        order of the arcs decides.
    :ivar simulate_environment: whether transitions without robots fire at their rates; if not, the
        operator fires them.
    :ivar on_lost: what robots do when they wait for a lost robot.
    :ivar on_evict: place -> {resource place: tokens given back when a robot is evicted there}.
    :ivar until: a condition on the marking that ends the run, or None.
    :ivar durations: place -> how long its action takes, for analysis and simulation.
    :ivar outcomes: place -> {transition that its action names, or "" for none: probability}.
    :ivar failures: place -> probability that an attempt of its action fails.
    :ivar own_times: robot -> its own durations, outcomes and failures.
    :ivar chance: decision places where the policy does not choose: the action determines what comes
        next, or the weights do. Used for computing policies.
    :ivar rates: transition -> rate (1/s) that replaces the one in the net's file; ``net`` has it.
        :meth:`with_rates` sets both.
    :ivar own_rates: transition -> rate (1/s) in the net's file, for each one in ``rates``.
    :ivar evidence: (key of the plan file, place or transition) -> the origin of that learned value.
    :ivar events: exponential transition -> the event that fires it.
    :ivar tasks: the places where tasks queue, and the transitions at which they are done.
    :ivar subnets: name -> the part of the net that came from another plan.
    :ivar groups: title -> nodes that are drawn in one box; the name of a subnet stands for its
        nodes. Not part of :meth:`hash`.
    :ivar cancel_grace: seconds that the server of an interrupted action has to end it before a
        fault is reported.
    :ivar timing: times of the agreement protocol.
    :ivar fsync: whether promises and votes are synced to the disk before they are sent.
    :ivar witness: names of nodes that vote but have no token.
    :ivar folder: the folder with the functions.
    :ivar file: the file that the plan comes from.
    :ivar notes: notes for the user on how the plan was read.
    """

    net: Net
    name: str = "plan"
    policy: Policy = field(default_factory=Policy)
    actions: Mapping[str, Action] = field(default_factory=dict)
    resource_places: FrozenSet[str] = frozenset()
    robots: Tuple[RobotSpec, ...] = ()
    spawn: Tuple[str, ...] = ()
    synchronisation: Synchronisation = Synchronisation.FULL
    transport: Transport = Transport.ROS
    seed: int = 0
    strict: bool = False
    on_failure: Mapping[str, FailureRule] = field(default_factory=dict)
    timeouts: Mapping[str, float] = field(default_factory=dict)
    routing: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    simulate_environment: bool = False
    on_lost: LostRule = LostRule()
    on_evict: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    until: Optional[str] = None
    durations: Mapping[str, Duration] = field(default_factory=dict)
    outcomes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    failures: Mapping[str, float] = field(default_factory=dict)
    own_times: Mapping[str, OwnTimes] = field(default_factory=dict)
    chance: FrozenSet[str] = frozenset()
    rates: Mapping[str, float] = field(default_factory=dict)
    own_rates: Mapping[str, Value] = field(default_factory=dict)
    evidence: Mapping[Tuple[str, str], Evidence] = field(default_factory=dict)
    events: Mapping[str, EventSource] = field(default_factory=dict)
    tasks: Tasks = Tasks()
    subnets: Mapping[str, Subnet] = field(default_factory=dict)
    groups: Mapping[str, Tuple[str, ...]] = field(default_factory=dict)
    cancel_grace: float = 5.0
    timing: Timing = Timing()
    fsync: bool = False
    witness: Tuple[str, ...] = ()
    folder: Optional[str] = None
    file: Optional[str] = None
    notes: Tuple[str, ...] = ()

    # -- derived -----------------------------------------------------------------------------------

    @property
    def action_places(self) -> Tuple[str, ...]:
        """The places whose tokens are robots, in net order."""
        return tuple(p.name for p, acts in zip(self.net.places, self.acts) if acts)

    @cached_property
    def acts(self) -> Tuple[bool, ...]:
        """For each place of the net whether its tokens are robots."""
        return tuple(p.name not in self.resource_places for p in self.net.places)

    @cached_property
    def flows(self) -> Tuple[RobotFlow, ...]:
        """The robot flow of every transition (thesis 4.3.5: with the resource places removed)."""
        return tuple(
            RobotFlow(*(sum(w for p, w in arcs if self.acts[p]) for arcs in ways))
            for ways in zip(self.net.inputs, self.net.outputs)
        )

    @cached_property
    def routes(self) -> Dict[int, Dict[int, int]]:
        """``routing``, by numbers."""
        at, number = self.net.place_number, self.net.transition_number
        return {
            number(t): {at(a): at(b) for a, b in routes.items()}
            for t, routes in self.routing.items()
        }

    @property
    def keeps_robots(self) -> bool:
        """Whether no transition creates or destroys robots."""
        return all(flow.taken == flow.put for flow in self.flows)

    @property
    def team_size(self) -> int:
        """The number of robots in the initial marking."""
        return sum(p.tokens for p, acts in zip(self.net.places, self.acts) if acts)

    @property
    def file_net(self) -> Net:
        """The net with the rates of its file, without the replacements in ``rates``."""
        return self.net.with_rates(self.own_rates)

    def action(self, robot: str, place: str) -> Action:
        """Return the action of ``robot`` in ``place``."""
        own = self.own_actions.get(robot, self.actions)
        return own[place] if place in own else self.actions.get(place)

    @cached_property
    def own_actions(self) -> Dict[str, Mapping[str, Action]]:
        """The actions of the robots that have their own actions."""
        return {spec.name: spec.actions for spec in self.robots if spec.actions}

    @property
    def times(self) -> OwnTimes:
        """The durations, outcomes and failures of the team."""
        return OwnTimes(self.durations, self.outcomes, self.failures, self.evidence)

    def bindings(self) -> Iterator[Tuple[str, Action]]:
        """Yield every place that is bound to an action, with the action: first those of the team,
        then those of each robot with its own."""
        yield from self.actions.items()
        for robot in self.robots:
            yield from robot.actions.items()

    def subnet_of(self, place: str) -> str:
        """Return the name of the innermost subnet that has the place, "" if there is none."""
        found = ""
        for name, subnet in self.subnets.items():
            if place in subnet.places and len(name) > len(found):
                found = name
        return found

    @property
    def group_nodes(self) -> Dict[str, Tuple[str, ...]]:
        """Group -> its nodes of the net, with those of a subnet in place of its name."""

        def nodes(member: str) -> Tuple[str, ...]:
            subnet = self.subnets.get(member)
            return (*subnet.places, *subnet.transitions) if subnet is not None else (member,)

        return {name: sum(map(nodes, members), ()) for name, members in self.groups.items()}

    def decided_in(self, subnet: str) -> Tuple[str, ...]:
        """Return the action places where the policy of a subnet decides ("": that of the plan
        itself): its places, but not those of subnets inside it other than their exits, and not its
        own exit."""
        found = []
        for place in self.action_places:
            within = self.subnet_of(place)
            while within and self.subnets[within].exit == place:
                within = self.subnets[within].parent
            if within == subnet:
                found.append(place)
        return tuple(found)

    def transition_meant(self, place: str, name: str) -> str:
        """Return the transition that an action in ``place`` means by the name that it returns. An
        action of a subnet uses the transition's name in the subnet's own plan; if that transition
        does not leave the place, the name is looked up in the surrounding plan, and so on."""
        if not name or not self.subnets or place not in self.net.place_index:
            return name
        leaving = self._leaving(place)
        within = self.subnet_of(place)
        while within:
            full = within + SEPARATOR + name
            if full in leaving:
                return full
            within = self.subnets[within].parent
        return name

    @cached_property
    def ending(self) -> Optional[Condition]:
        """``until``, as a condition on the markings of the net."""
        return parse_condition(self.until, self.net.place_index) if self.until else None

    @cached_property
    def counters(self) -> Tuple[str, ...]:
        """Resource places that nothing reads: no transition, inhibitor arc, capacity, rate, weight,
        policy cell or ``until`` condition. They only count, and cannot affect the behaviour."""
        net = self.net
        inhibiting = {p for arcs in net.inhibitors for p, _ in arcs}
        cells = zip(self.policy.places, zip(*(row.counts for row in self.policy.rows)))
        read = {place for place, counts in cells if any(count is not None for count in counts)}
        read |= net.named_by_functions()
        if self.ending is not None:
            read.update(self.ending.places)
        return tuple(
            place.name
            for p, place in enumerate(net.places)
            if place.name in self.resource_places
            and not net.consumers[p]
            and p not in inhibiting
            and place.capacity is None
            and place.name not in read
        )

    def of_action(self, place: int) -> Tuple[int, ...]:
        """Return the numbers of the transitions that leave place number ``place`` without an event:
        those that a robot can request."""
        transitions = self.net.transitions
        return tuple(t for t in self.net.consumers[place] if transitions[t].name not in self.events)

    def interrupts(self, place: str) -> Tuple[str, ...]:
        """Return the event transitions that leave a place, in the order of the net."""
        if not self.events:
            return ()
        return tuple(t for t in self._leaving(place) if t in self.events)

    @property
    def clock(self) -> Tuple[str, ...]:
        """The transitions of the environment that fire in certain hours of the day."""
        return tuple(t for t, source in self.events.items() if source.from_hour is not None)

    @property
    def submissions(self) -> Tuple[str, ...]:
        """The transitions of the environment through which tasks arrive: those with an event, other
        than hours, and those that lead into a queue."""
        return tuple(
            t.name
            for t, flow, outputs in zip(self.net.transitions, self.flows, self.net.outputs)
            if t.timed
            and not any(flow)
            and (
                (t.name in self.events and self.events[t.name].from_hour is None)
                or any(self.net.places[p].name in self.tasks.queues for p, _ in outputs)
            )
        )

    @property
    def cancellations(self) -> FrozenSet[str]:
        """The transitions by which robots move only because their task is cancelled: those of
        ``tasks.on_cancel`` that have an event without a source. Their rates say how often that is.
        """
        named = {t for t in self.tasks.on_cancel.values() if t is not None and t in self.events}
        return frozenset(
            t for t in named if not self.events[t].is_watched and self.events[t].comes_after is None
        )

    def failure_rule(self, place: str) -> FailureRule:
        """Return the failure rule of a place; ``'*'`` in the plan stands for every place without
        its own rule."""
        return self.on_failure.get(place) or self.on_failure.get("*") or FailureRule()

    def fallback(self, place: int) -> int:
        """Return the number of the transition that a robot in place number ``place`` requests when
        its action has failed; -1 if it requests none."""
        rule = self.failure_rule(self.net.places[place].name)
        if rule.end is not FailureEnd.FIRE:
            return -1
        t = self.net.transition_number(rule.transition)
        return t if t in self.net.consumers[place] else -1

    def timeout(self, place: str) -> Optional[float]:
        """Return the seconds that an action in ``place`` may take, None for no limit."""
        return self.timeouts.get(place, self.timeouts.get("*"))

    def hash(self) -> str:
        """Return a hex digest of everything that determines the course of a run; replicas whose
        digests differ must not cooperate."""
        return self._hash

    @cached_property
    def _hash(self) -> str:
        text = json.dumps(self._essence(), separators=(",", ":"), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    def _essence(self) -> Dict[str, Any]:
        return {
            "places": [[p.name, p.capacity] for p in self.net.places],
            "resources": [
                [p.name, p.tokens] for p in self.net.places if p.name in self.resource_places
            ],
            "transitions": [
                # an exponential transition has no weight; the JSON of a net leaves it out
                [
                    t.name,
                    t.timed,
                    written(t.rate),
                    1.0 if t.timed else written(t.weight),
                    t.priority,
                    t.servers,
                ]
                for t in self.net.transitions
            ],
            "arcs": [list(a.meaning) for a in self.net.arcs],
            "policy": [
                list(self.policy.places),
                self.policy.rows,  # named tuples become lists
                *([self.policy.scopes] if self.policy.scopes else []),
            ],
            "idle": sorted(p for p in self.action_places if self.actions.get(p) is None),
            "idle_per_robot": {
                r.name: {p: a is None for p, a in sorted(r.actions.items())}
                for r in self.robots
                if r.actions
            },
            **self._capabilities_essence(),
            "resource_places": sorted(self.resource_places),
            "synchronisation": self.synchronisation.value,
            "seed": self.seed,
            "strict": self.strict,
            "on_failure": {p: rule.essence() for p, rule in self.on_failure.items()},
            "routing": {t: dict(r) for t, r in self.routing.items()},
            "on_lost": [self.on_lost.kind.value, self.on_lost.transition],
            "on_evict": {p: dict(r) for p, r in self.on_evict.items()},
            "until": self.until,
            **self._reacting_essence(),
        }

    def _capabilities_essence(self) -> Dict[str, Any]:
        """The capabilities of robots, which decide who takes a task; may be empty."""
        found = {r.name: sorted(r.capabilities) for r in self.robots if r.capabilities}
        return {"capabilities": found} if found else {}

    def _reacting_essence(self) -> Dict[str, Any]:
        """The parts of events and tasks that the token game reads; empty for a plan without
        them."""
        found: Dict[str, Any] = {}
        if self.events:
            found["events"] = {
                t: [e.hold, e.resume] + ["hours"] * (e.from_hour is not None)
                for t, e in self.events.items()
            }
        if self.tasks != Tasks():
            found["tasks"] = [list(self.tasks.queues), list(self.tasks.done)]
            if self.tasks.on_cancel:
                found["tasks"].append(dict(self.tasks.on_cancel))
            if self.tasks.order:
                found["tasks"].append(["order", dict(self.tasks.order)])
        return found

    def for_robots(self, number: int) -> Plan:
        """Return the plan for a team of ``number`` robots. A smaller team consists of the plan's
        first robots; additional ones, named robot_k, start at the entries of ``spawn``, cyclically
        (without ``spawn``, at the places of the plan's own robots). The initial marking changes
        accordingly.

        :raises PlanError: ``number`` is below 1, or there is no place to start at.
        """
        if not 1 <= number <= MAX_ROBOTS:
            raise PlanError("a team has from 1 to %d robots, not %d" % (MAX_ROBOTS, number))
        robots = list(self.robots[:number])
        cycle = self.spawn or tuple(r.place for r in self.robots)
        taken = {r.name for r in robots}
        k = len(robots)
        while len(robots) < number:
            k += 1
            if not cycle:
                raise PlanError(
                    "the plan has no robots and no 'spawn' places to start more", file=self.file
                )
            name = "robot_%d" % k
            if name not in taken:
                robots.append(RobotSpec(name, cycle[len(robots) % len(cycle)]))
                taken.add(name)
        return self.with_robots(robots)

    def with_robots(self, robots: List[RobotSpec]) -> Plan:
        """Return the plan with these robots; their places determine the marking of the action
        places."""
        counts = {p.name: p.tokens for p in self.net.places if p.name in self.resource_places}
        for robot in robots:
            counts[robot.place] = counts.get(robot.place, 0) + 1
        return replace(self, robots=tuple(robots), net=self.net.with_marking(counts))

    def with_seed(self, seed: int) -> Plan:
        """Return the plan with a different seed for the policy's random draws."""
        return replace(self, seed=seed)

    def with_policy(self, policy: Policy) -> Plan:
        """Return the plan with another policy.

        :raises PolicyError: it names a place or transition that the net does not have, or an
            exponential transition.
        """
        policy.bind(self.net)
        return replace(self, policy=policy)

    def with_rates(self, rates: Mapping[str, float]) -> Plan:
        """Return the plan with further rates (1/s) in place of those of the net's file: exponential
        transition -> rate. The plan remembers the rates of the file."""
        known = self.net.transition_index
        timed = [t for t in rates if t in known and self.net.transition(t).timed]
        own = {t: self.net.transition(t).rate for t in timed}
        return replace(
            self,
            net=self.net.with_rates(rates),
            rates={**self.rates, **rates},
            own_rates={**own, **self.own_rates},
        )

    def nominal(self) -> Plan:
        """Return the plan with the rates of its net's file, and without the durations, outcomes and
        failures that were learned from runs (those with ``evidence``). Its hash differs if a rate
        does: it is for analysis, not for a run."""
        given = self.times.nominal()
        own = {robot: times.nominal() for robot, times in self.own_times.items()}
        return replace(
            self,
            net=self.file_net,
            durations=given.durations,
            outcomes=given.outcomes,
            failures=given.failures,
            own_times={robot: times for robot, times in own.items() if any(times)},
            rates={},
            own_rates={},
            evidence={},
        )

    def with_notes(self, notes: Iterable[str]) -> Plan:
        """Return the plan with further notes for the user on how it was read."""
        return replace(self, notes=self.notes + tuple(notes))

    # -- checking ----------------------------------------------------------------------------------

    def validate(self) -> Plan:
        """Check that every name in the plan refers to something suitable, and return the plan.

        :raises PlanError: unknown places or transitions, a rule that names a transition it cannot
            fire, two robots with the same name, robots in resource places.
        :raises PolicyError: see :class:`~gspn_framework_package.model.policy.PolicyTable`.
        """
        self.policy.bind(self.net)
        for what, places in (
            ("actions", self.actions),
            ("resource_places", self.resource_places),
            ("on_failure", self.on_failure),
            ("timeout", self.timeouts),
            ("on_evict", self.on_evict),
            ("spawn", self.spawn),
        ):
            for place in places:
                if place != "*" or what not in ("on_failure", "timeout"):
                    self._known_place(place, what)
        for place, rule in self.on_failure.items():
            if rule.end is FailureEnd.FIRE:
                self._known_transition(rule.transition, "on_failure of '%s'" % place)
                if place != "*" and rule.transition not in self._leaving(place):
                    raise self._error(
                        "on_failure of '%s'" % place,
                        "'%s' does not leave that place" % rule.transition,
                    )
        if self.on_lost.kind is LostKind.FIRE:
            self._known_transition(self.on_lost.transition, "on_lost")
        for returned in self.on_evict.values():
            for resource in returned:
                self._known_place(resource, "on_evict")
                if resource not in self.resource_places:
                    raise self._error("on_evict", "'%s' is not a resource place" % resource)
        self._validate_actions()
        self._validate_routing()
        self._validate_robots()
        self._validate_times()
        self._validate_events()
        self._validate_subnets()
        self._validate_groups()
        return self

    def _validate_actions(self) -> None:
        for place, action in self.bindings():
            self._known_place(place, "actions")
            problem = why_not_valid(action)
            if problem:
                raise self._error("actions.%s" % place, problem)
            for outcome, transition in outcomes_of(action).items():
                if transition and transition not in self._leaving(place):
                    raise self._error(
                        "actions.%s" % place,
                        "its outcome '%s' leads to '%s', which does not leave that place"
                        % (outcome, transition),
                        "choose from: %s" % ", ".join(self._leaving(place)),
                    )

    def _validate_subnets(self) -> None:
        for name, subnet in self.subnets.items():
            element = "subnets.%s" % name
            for place in (subnet.entry, subnet.exit, *subnet.places):
                self._known_place(place, element)
            for transition in subnet.transitions:
                self._known_transition(transition, element)
            if not {subnet.entry, subnet.exit} <= set(subnet.places):
                raise self._error(element, "its entry or exit is outside")
            if subnet.parent and subnet.parent not in self.subnets:
                raise self._error(element, "there is no subnet '%s'" % subnet.parent)

    def _validate_groups(self) -> None:
        owner: Dict[str, str] = {}
        for name, members in self.groups.items():
            for node in members:
                known = (self.net.place_index, self.net.transition_index, self.subnets)
                if not any(node in names for names in known):
                    raise self._error(
                        "groups.%s" % name, "there is no place or transition '%s'" % node
                    )
                if owner.setdefault(node, name) != name:
                    raise self._error(
                        "groups.%s" % name,
                        "'%s' is in the group '%s' already" % (node, owner[node]),
                        "a node is in one group at most",
                    )

    def _validate_events(self) -> None:
        net = self.net
        for name in self.events:
            self._known_transition(name, "events")
            t = net.transition_number(name)
            if not net.transitions[t].timed:
                raise self._error(
                    "events.%s" % name,
                    "an immediate transition cannot wait for an event",
                    "make it exponential; its rate is how often the event comes",
                )
            if self.flows[t].taken > 1:
                raise self._error(
                    "events.%s" % name,
                    "it moves several robots, but an event interrupts one",
                    "let the event move one robot, and synchronise afterwards",
                )
            source, outside = self.events[name], not self.moves_robots(t)
            if outside and (
                source.when or source.edge or source.resume or source.comes_after is not None
            ):
                raise self._error(
                    "events.%s" % name,
                    "it touches no robot, so each message is a task",
                    "'when', 'edge', 'resume' and 'after' are for events of robots",
                )
            if source.from_hour is not None:
                self._validate_hours(t, source, outside)
            if not outside and (source.id or source.json):
                raise self._error(
                    "events.%s" % name, "'id' and 'json' are for tasks; it moves a robot"
                )
        for place in self.tasks.queues:
            self._known_place(place, "tasks.queues")
            if place not in self.resource_places:
                raise self._error(
                    "tasks.queues",
                    "'%s' is not a resource place; its tokens are robots, not tasks" % place,
                )
        for place, order in self.tasks.order.items():
            if place not in self.tasks.queues or order not in QUEUE_ORDERS:
                raise self._error(
                    "tasks.order.%s" % place,
                    "there is no queue '%s' with an order '%s'" % (place, order),
                    "choose a place of tasks.queues, and from: %s" % ", ".join(QUEUE_ORDERS),
                )
        for name in self.tasks.done:
            self._known_transition(name, "tasks.done")
        for place, transition in self.tasks.on_cancel.items():
            self._validate_on_cancel(place, transition)

    def _validate_hours(self, t: int, source: EventSource, outside: bool) -> None:
        """Check a transition of the clock, and that the clock does not cycle in its first hour."""
        net, name = self.net, self.net.transitions[t].name
        element = "events.%s" % name
        if not outside or name in self.submissions or not net.inputs[t]:
            raise self._error(
                element,
                "only a transition that takes a resource, moves no robot and leads into no queue "
                "fires by the hours of the day",
            )
        assert source.from_hour is not None
        seconds, reached, new = 3600.0 * source.from_hour, {t}, {t}
        now = [
            net.transition_number(other)
            for other in self.clock
            if other in net.transition_index and not self.events[other].seconds_to_hours(seconds)
        ]
        while new:
            after = {p for one in new for p, _ in net.outputs[one]}
            new = {one for one in now if any(p in after for p, _ in net.inputs[one])}
            if t in new:
                raise self._error(
                    element,
                    "at %g h the transitions of the clock fire in a cycle" % source.from_hour,
                    "at each hour of the day, at least one transition of the cycle must not fire",
                )
            new, reached = new - reached, reached | new

    def _validate_on_cancel(self, place: str, transition: Optional[str]) -> None:
        element = "tasks.on_cancel.%s" % place
        self._known_place(place, element)
        if place in self.resource_places:
            raise self._error(element, "a robot carries a task, and '%s' holds no robots" % place)
        if transition is None:
            return
        self._known_transition(transition, element)
        t = self.net.transition_number(transition)
        if t not in self.net.consumers[self.net.place_number(place)]:
            raise self._error(element, "'%s' does not leave '%s'" % (transition, place))
        into = [self.net.places[p].name for p, _ in self.net.outputs[t]]
        queues = [name for name in into if name in self.tasks.queues]
        if queues:
            raise self._error(
                element,
                "'%s' puts a token into the queue '%s', but the task is cancelled"
                % (transition, queues[0]),
                "name a transition that leads to no queue",
            )

    def moves_robots(self, t: int) -> bool:
        """Return whether transition number ``t`` takes or puts robots."""
        return any(self.flows[t])

    def _validate_times(self) -> None:
        self._validate_values("", self.times)
        for robot, own in self.own_times.items():
            within = "own_times.%s." % robot
            self._validate_values(within, own)
            # what the check says of the team must hold for each of its robots
            new = [
                ("durations", p)
                for p, duration in own.durations.items()
                if p not in self.durations or (self.durations[p].mean == 0) != (duration.mean == 0)
            ]
            new += [
                ("outcomes", p)
                for p, chances in own.outcomes.items()
                if any(v > 0 and not self.outcomes.get(p, {}).get(t) for t, v in chances.items())
            ]
            new += [
                ("failures", p)
                for p, chance in own.failures.items()
                if chance > 0 and not self.failures.get(p)
            ]
            if new:
                key, place = new[0]
                raise self._error(
                    "%s%s.%s" % (within, key, place),
                    "a robot cannot have a duration, an outcome or failures that the team lacks",
                    "give %s.%s, too" % (key, place),
                )
        for place in self.chance:
            self._known_place(place, "chance")
            if all(self.net.transition(t).timed for t in self._leaving(place)):
                raise self._error(
                    "chance", "no immediate transition leaves '%s', so there is no choice" % place
                )
        for name in self.rates:
            self._known_transition(name, "rates")
            if not self.net.transition(name).timed:
                raise self._error("rates.%s" % name, "an immediate transition has no rate")

    def _validate_values(self, within: str, values: OwnTimes) -> None:
        """Check values that may be learned. :param within: what is before their keys."""
        for key in TIME_KEYS:
            for place in getattr(values, key):
                self._known_place(place, within + key)
                if place in self.resource_places:
                    raise self._error(
                        "%s%s.%s" % (within, key, place),
                        "a resource place has no action",
                        "remove the entry",
                    )
        for place, chances in values.outcomes.items():
            leaving = self._leaving(place)
            for transition, chance in chances.items():
                if transition and transition not in leaving:
                    raise self._error(
                        "%soutcomes.%s" % (within, place),
                        "'%s' does not leave that place" % transition,
                        "choose from: %s" % ", ".join(leaving),
                    )
                if not 0 <= chance <= 1:
                    raise self._error(
                        "%soutcomes.%s" % (within, place), "%g is not a probability" % chance
                    )
            total = math.fsum(chances.values())
            if abs(total - 1.0) > SUM_TOLERANCE:
                raise self._error(
                    "%soutcomes.%s" % (within, place),
                    "the probabilities sum to %g, not to 1" % total,
                )
        for place, chance in values.failures.items():
            if not 0 <= chance < 1:
                raise self._error(
                    "%sfailures.%s" % (within, place),
                    "%g is not a possible probability" % chance,
                    "0 <= p < 1",
                )

    def _error(self, element: str, message: str, hint: Optional[str] = None) -> PlanError:
        return PlanError(message, file=self.file, element=element, hint=hint)

    def _validate_routing(self) -> None:
        for transition, routes in self.routing.items():
            self._known_transition(transition, "routing")
            t = self.net.transition_number(transition)
            sources = {self.net.places[p].name for p, _ in self.net.inputs[t]}
            targets = {self.net.places[p].name for p, _ in self.net.outputs[t]}
            for source, target in routes.items():
                if source not in sources or target not in targets:
                    raise self._error(
                        "routing",
                        "'%s' does not lead from '%s' to '%s'" % (transition, source, target),
                    )

    def _validate_robots(self) -> None:
        if len(self.robots) > MAX_ROBOTS:
            raise too_many_robots(len(self.robots))
        names = set()
        for robot in self.robots:
            if robot.name in names or not robot.name:
                raise self._error(
                    "robots",
                    "two robots are named '%s'" % robot.name
                    if robot.name
                    else "a robot has no name",
                )
            names.add(robot.name)
            for word in robot.capabilities:
                if any(word == other.name for other in self.robots):
                    raise self._error(
                        "robot '%s'" % robot.name,
                        "its capability '%s' is the name of a robot, so that no task could tell "
                        "which is meant" % word,
                    )
            for place in (robot.place,) + tuple(robot.actions):
                self._known_place(place, "robot '%s'" % robot.name)
                if place in self.resource_places:
                    raise self._error(
                        "robot '%s'" % robot.name,
                        "'%s' is a resource place; a robot cannot be there" % place,
                    )
        for place in self.spawn:
            if place in self.resource_places:
                raise self._error(
                    "spawn", "'%s' is a resource place; a robot cannot start there" % place
                )

    def _leaving(self, place: str) -> List[str]:
        p = self.net.place_number(place)
        return [self.net.transitions[t].name for t in self.net.consumers[p]]

    def _known_place(self, place: str, element: str) -> None:
        if place not in self.net.place_index:
            raise self._error(element, "the net has no place '%s'" % place)

    def _known_transition(self, transition: str, element: str) -> None:
        if transition not in self.net.transition_index:
            raise self._error(element, "the net has no transition '%s'" % transition)
