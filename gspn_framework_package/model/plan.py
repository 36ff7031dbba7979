"""Plans: a net, a policy and a map from places to actions, with everything a run needs to know.

A plan is read by ``formats.plan_file`` (or ``formats.thesis_input``) and checked by
``analysis.preflight``. What its parts mean when it runs is written down in ``docs/semantics.md``.
"""

from __future__ import annotations

import enum
import hashlib
import json
from dataclasses import dataclass, field, replace
from typing import (
    Any,
    Dict,
    FrozenSet,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Tuple,
    Union,
)

from gspn_framework_package.model.errors import PlanError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.policy import Policy

MAX_ROBOTS = 10_000
"""Most robots of a team: a number beyond it is a slip, and would fill the memory."""


def too_many_robots(number: int) -> PlanError:
    """The error of a team that is larger than any could be."""
    return PlanError(
        "a team of %d robots; at most %d are possible" % (number, MAX_ROBOTS),
        element="robots",
        hint="every token in an action place is a robot; are these resource places?",
    )


class Synchronisation(enum.Enum):
    """How much the robots share with each other (thesis 4.3.3)."""

    FULL = "full"
    """Every finished action goes through the shared log, on a topic."""
    PARTIAL = "partial"
    """Moves that concern nobody else stay with the robot; the rest is agreed through services."""


class Outcome(enum.Enum):
    """The ways in which an action of any type can end, by the names that ``outcomes`` uses in a
    plan."""

    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    REJECTED = "rejected"
    PREEMPTED = "preempted"


class FunctionAction(NamedTuple):
    """An action that is a Python function or class of the plan's folder, ``module.function``; in
    ROS it is served as an ExecGSPN action server of the name ``server``. ``settings`` are passed to
    the function, or to the class when it is instantiated, by name."""

    function: str
    server: str
    settings: Mapping[str, Any] = {}

    @property
    def label(self) -> str:
        """What people call it."""
        return self.function


class ServerAction(NamedTuple):
    """An action server that exists already, ``server``, of the action type ``type``
    (package/NameAction).

    An ``ExecGSPNAction`` names its transition itself. For any other type ``goal`` holds the goal's
    fields (nested maps), and ``outcomes`` says which transition each :class:`Outcome` stands for;
    "" lets the policy decide, and an outcome that is not listed is a failure (but success, not
    listed, lets the policy decide).
    """

    type: str
    server: str
    goal: Optional[Mapping[str, Any]] = None
    outcomes: Mapping[str, str] = {}

    @property
    def label(self) -> str:
        """What people call it."""
        return "%s (%s)" % (self.server, self.type)


Action = Union[FunctionAction, ServerAction, None]
"""What happens in an action place; None: nothing, a robot there is done at once."""


class FailureKind(enum.Enum):
    """What to do when an action does not succeed."""

    RETRY = "retry"
    """Try again, same visit, next attempt; when the attempts are used up, wait."""
    FIRE = "fire"
    """Go on as if the action had asked for that transition."""
    WAIT = "wait"
    """Wait for the operator, loudly."""
    STOP = "stop"
    """Stop the whole team."""


class FailureRule(NamedTuple):
    """A failure rule of one place: ``times`` and ``delay`` (seconds) count for RETRY,
    ``transition`` for FIRE."""

    kind: FailureKind = FailureKind.WAIT
    times: int = 0
    delay: float = 0.0
    transition: str = ""


class LostKind(enum.Enum):
    """What to do when a robot is lost that others wait for."""

    HOLD = "hold"
    """They go on waiting (and say for what)."""
    STOP = "stop"
    """The team stops."""
    FIRE = "fire"
    """Those that wait ask for that transition instead, where it leaves their place."""


class LostRule(NamedTuple):
    """``transition`` counts for FIRE."""

    kind: LostKind = LostKind.HOLD
    transition: str = ""


class RobotSpec(NamedTuple):
    """A robot of the plan: its ``name``, its initial ``place`` and the places where it acts
    otherwise than the team does (``actions``, a team of different robots)."""

    name: str
    place: str
    actions: Mapping[str, Action] = {}


class Timing(NamedTuple):
    """Times of the agreement, in seconds. A robot that nobody heard for ``evict_after`` is proposed
    for eviction (0: never); one without contact to a quorum for ``fence_after`` stops itself (0:
    never)."""

    evict_after: float = 10.0
    fence_after: float = 0.0


@dataclass(frozen=True)
class Plan:
    """A plan. Its maker has checked every field against the net: see
    :meth:`validate`."""

    net: Net
    name: str = "plan"
    policy: Policy = field(default_factory=Policy)
    actions: Mapping[str, Action] = field(default_factory=dict)
    resource_places: FrozenSet[str] = frozenset()
    robots: Tuple[RobotSpec, ...] = ()
    spawn: Tuple[str, ...] = ()
    synchronisation: Synchronisation = Synchronisation.FULL
    seed: int = 0
    strict: bool = False
    on_failure: Mapping[str, FailureRule] = field(default_factory=dict)
    timeouts: Mapping[str, float] = field(default_factory=dict)
    routing: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    simulate_environment: bool = False
    on_lost: LostRule = LostRule()
    on_evict: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    until: Optional[str] = None
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
        return tuple(p.name for p in self.net.places if p.name not in self.resource_places)

    def action(self, robot: str, place: str) -> Action:
        """What ``robot`` does in ``place``."""
        for spec in self.robots:
            if spec.name == robot and place in spec.actions:
                return spec.actions[place]
        return self.actions.get(place)

    def bindings(self) -> Iterator[Tuple[str, Action]]:
        """Every place that is bound to an action, and the action: of the team, then of each robot
        that acts otherwise."""
        yield from self.actions.items()
        for robot in self.robots:
            yield from robot.actions.items()

    def failure_rule(self, place: str) -> FailureRule:
        """The failure rule of a place; ``'*'`` in the plan stands for every place without one of
        its own."""
        return self.on_failure.get(place) or self.on_failure.get("*") or FailureRule()

    def timeout(self, place: str) -> Optional[float]:
        """Seconds that an action in ``place`` may take, None for as long as it likes."""
        return self.timeouts.get(place, self.timeouts.get("*"))

    def hash(self) -> str:
        """Hex digest of everything that decides how a run goes: replicas that differ in it must not
        meet."""
        text = json.dumps(self._essence(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    def _essence(self) -> Dict[str, Any]:
        return {
            "places": [[p.name, p.capacity] for p in self.net.places],
            "resources": [
                [p.name, p.tokens] for p in self.net.places if p.name in self.resource_places
            ],
            "transitions": [
                [t.name, t.timed, t.rate, t.weight, t.priority, t.servers]
                for t in self.net.transitions
            ],
            "arcs": [list(a) for a in self.net.arcs],
            "policy": [
                list(self.policy.places),
                [[list(r.counts), list(map(list, r.choices))] for r in self.policy.rows],
            ],
            "idle": sorted(p for p in self.action_places if self.actions.get(p) is None),
            "idle_per_robot": {
                r.name: {p: a is None for p, a in sorted(r.actions.items())}
                for r in self.robots
                if r.actions
            },
            "resource_places": sorted(self.resource_places),
            "synchronisation": self.synchronisation.value,
            "seed": self.seed,
            "strict": self.strict,
            "on_failure": {
                p: [r.kind.value, r.times, r.delay, r.transition]
                for p, r in self.on_failure.items()
            },
            "routing": {t: dict(r) for t, r in self.routing.items()},
            "on_lost": [self.on_lost.kind.value, self.on_lost.transition],
            "on_evict": {p: dict(r) for p, r in self.on_evict.items()},
            "until": self.until,
        }

    def for_robots(self, number: int) -> Plan:
        """The plan for a team of ``number`` robots: its first ones, or more, which start at the
        entries of ``spawn``, cyclically (the places of the plan's own robots where there is no
        ``spawn``). Robots added are named robot_k. The initial marking follows.

        :raises PlanError: ``number`` below 1, or nowhere to start.
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
        """The plan with these robots; the marking of the action places follows from their
        places."""
        counts = {p.name: p.tokens for p in self.net.places if p.name in self.resource_places}
        for robot in robots:
            counts[robot.place] = counts.get(robot.place, 0) + 1
        return replace(self, robots=tuple(robots), net=self.net.with_marking(counts))

    def with_seed(self, seed: int) -> Plan:
        """The plan with another seed for the policy's draws."""
        return replace(self, seed=seed)

    def with_notes(self, notes: Iterable[str]) -> Plan:
        """The plan with more notes of its reader for people."""
        return replace(self, notes=self.notes + tuple(notes))

    # -- checking ----------------------------------------------------------------------------------

    def validate(self) -> Plan:
        """The plan itself, if every name in it exists where it should.

        :raises PlanError: unknown places or transitions, a rule that names a transition it cannot
            fire, two robots of one name, robots in resource places.
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
            if rule.kind is FailureKind.FIRE:
                self._known_transition(rule.transition, "on_failure of '%s'" % place)
                if place != "*" and rule.transition not in self._leaving(place):
                    raise PlanError(
                        "'%s' does not leave that place" % rule.transition,
                        file=self.file,
                        element="on_failure of '%s'" % place,
                    )
        if self.on_lost.kind is LostKind.FIRE:
            self._known_transition(self.on_lost.transition, "on_lost")
        for returned in self.on_evict.values():
            for resource in returned:
                self._known_place(resource, "on_evict")
                if resource not in self.resource_places:
                    raise PlanError(
                        "'%s' is not a resource place" % resource,
                        file=self.file,
                        element="on_evict",
                    )
        self._validate_routing()
        self._validate_robots()
        return self

    def _validate_routing(self) -> None:
        for transition, routes in self.routing.items():
            self._known_transition(transition, "routing")
            t = self.net.transition_number(transition)
            sources = {self.net.places[p].name for p, _ in self.net.inputs[t]}
            targets = {self.net.places[p].name for p, _ in self.net.outputs[t]}
            for source, target in routes.items():
                if source not in sources or target not in targets:
                    raise PlanError(
                        "'%s' does not lead from '%s' to '%s'" % (transition, source, target),
                        file=self.file,
                        element="routing",
                    )

    def _validate_robots(self) -> None:
        if len(self.robots) > MAX_ROBOTS:
            raise too_many_robots(len(self.robots))
        names = set()
        for robot in self.robots:
            if robot.name in names or not robot.name:
                raise PlanError(
                    "two robots are named '%s'" % robot.name
                    if robot.name
                    else "a robot has no name",
                    file=self.file,
                    element="robots",
                )
            names.add(robot.name)
            for place in (robot.place,) + tuple(robot.actions):
                self._known_place(place, "robot '%s'" % robot.name)
                if place in self.resource_places:
                    raise PlanError(
                        "'%s' is a resource place; a robot cannot be there" % place,
                        file=self.file,
                        element="robot '%s'" % robot.name,
                    )
        for place in self.spawn:
            if place in self.resource_places:
                raise PlanError(
                    "'%s' is a resource place; a robot cannot start there" % place,
                    file=self.file,
                    element="spawn",
                )

    def _leaving(self, place: str) -> List[str]:
        p = self.net.place_number(place)
        return [self.net.transitions[t].name for t in self.net.consumers[p]]

    def _known_place(self, place: str, element: str) -> None:
        if place not in self.net.place_index:
            raise PlanError("the net has no place '%s'" % place, file=self.file, element=element)

    def _known_transition(self, transition: str, element: str) -> None:
        if transition not in self.net.transition_index:
            raise PlanError(
                "the net has no transition '%s'" % transition, file=self.file, element=element
            )
