"""The team according to its log: the net, the marking, the robots, and the effects of entries.

This was written independently of the token game and shares no code with it (see
:mod:`.slot_check`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Dict, Iterable, List, Mapping, NamedTuple, Optional, Tuple, Union

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.verifier.cargo import Cargo, LoggedTask
from gspn_framework_package.execution.verifier.stages import LoggedStages, starting_place
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.failure import FailureEnd
from gspn_framework_package.model.plan import LostKind, Plan

MOST_NAMES = 1_000
"""Maximum number of data names of a robot, task or team."""

Values = Mapping[str, Any]


class KnownData(NamedTuple):
    """The values that an action of a robot may read: the data of the robot, the team and its task,
    the visit that this one continues, and the visits (by place) that later ones may continue."""

    own: Values
    team: Values
    task: Optional[Tuple[str, Values]]
    resumed_from: int
    interrupted: Mapping[str, int]

    def data(self) -> Dict[str, Any]:
        """The data by full name."""
        scopes = [("robot", self.own), ("team", self.team)]
        if self.task is not None:
            scopes.append(("task", {"id": self.task[0], **self.task[1]}))
        return {"%s.%s" % (s, name): v for s, values in scopes for name, v in values.items()}


class Situation(NamedTuple):
    """The situation of a robot after some slot."""

    place: str
    incarnation: int
    visit: int
    attempt: int
    phase: Phase
    memory: KnownData


class Direct(NamedTuple):
    """A firing that an entry causes directly: of the environment, or by an event that interrupts
    ``robot`` with this cause."""

    transition: str
    robot: str = ""
    cause: Values = {}


@dataclass
class LoggedRobot:
    """A robot, according to the log."""

    name: str
    place: str
    incarnation: int
    visit: int = 1
    attempt: int = 1
    phase: Phase = Phase.DOING
    asks: Optional[str] = None
    """The transition that it asks for; None to let the policy decide."""
    may_ask: Optional[str] = None
    """A transition that it asks for instead if its draw needed a robot that is now lost."""
    order: int = 0
    failures: int = 0
    paused: bool = False
    stopped: bool = False
    """Whether its own pause keeps it from acting."""
    data: Values = field(default_factory=dict)
    held: Dict[str, Values] = field(default_factory=dict)
    """The held events, which interrupt it as soon as they can, in order, with their causes."""
    interrupted: Mapping[str, int] = field(default_factory=dict)
    """Place -> the visit there that the next one continues."""
    resumed_from: int = 0

    @property
    def goal(self) -> Tuple[int, int, int]:
        """(incarnation, visit, attempt)."""
        return self.incarnation, self.visit, self.attempt

    @property
    def here(self) -> bool:
        """Whether its token is in the net."""
        return not self.phase.gone


class LoggedTeam:
    """The state of a team after the entries and firings checked so far.

    :param plan: the plan in the log's header.
    :param agents: whether transitions may create and destroy agents.
    """

    def __init__(self, plan: Plan, agents: bool = False) -> None:
        self.agents = agents
        self.robots: Dict[str, LoggedRobot] = {}
        self.witnesses: Tuple[str, ...] = ()
        self.seed = 0
        self.draws_ties = False
        """Whether chance decides between robots that could make the same move."""
        self.paused = self.stopped = False
        self.ended: Optional[str] = None
        self.perhaps_ended = False
        self.orders = 0
        self.last_change = (-1, -1)
        """The last firing that changed the marking, as slot and index."""
        self.moved: Dict[str, Tuple[int, int]] = {}
        """Robot -> the last firing that moved it."""
        self.data: Values = {}
        self.stages = LoggedStages(agents)
        self._take_rules(plan)
        self.marking: Dict[str, int] = {
            p.name: p.tokens if p.name in self.resources else 0 for p in plan.net.places
        }
        self.cargo = Cargo(plan, self.inputs, self.outputs)

    def _take_rules(self, plan: Plan) -> None:
        """Apply the rules of this plan from now on."""
        self.plan = plan
        net, agents = plan.net, self.agents
        self.resources = set(plan.resource_places)
        self.inputs: Dict[str, Dict[str, int]] = {}
        self.outputs: Dict[str, Dict[str, int]] = {}
        self.limits: Dict[str, Dict[str, int]] = {}
        for t in net.transitions:
            self.inputs[t.name], self.outputs[t.name], self.limits[t.name] = {}, {}, {}
        for arc in net.arcs:
            if arc.source in self.inputs:
                _add(self.outputs[arc.source], arc.target, arc.weight)
            elif arc.inhibitor:
                known = self.limits[arc.target].get(arc.source, arc.weight)
                self.limits[arc.target][arc.source] = min(known, arc.weight)
            else:
                _add(self.inputs[arc.target], arc.source, arc.weight)
        self.kind = {t.name: t for t in net.transitions}
        self.capacity = {p.name: p.capacity for p in net.places}
        self.leaving: Dict[str, List[str]] = {p.name: [] for p in net.places}
        for t in net.transitions:
            for place in self.inputs[t.name]:
                self.leaving[place].append(t.name)
        self.spontaneous = [
            t.name
            for t in net.transitions
            if not t.timed
            and self.resources.issuperset(self.inputs[t.name])
            and (agents or self.resources.issuperset(self.outputs[t.name]))
        ]
        self.until = (
            parse_condition(plan.until, [p.name for p in net.places]) if plan.until else None
        )

    # -- queries ---------------------------------------------------------------------------------

    def members(self) -> List[str]:
        """The names of the voters in the next slot."""
        return [r.name for r in self.robots.values() if r.here] + list(self.witnesses)

    def situations(self) -> Dict[str, Situation]:
        """The situation of every robot, by name; a robot that a pause keeps from acting is
        PAUSED."""
        found = {}
        for r in self.robots.values():
            idle = r.phase is Phase.DOING and (self.stopped or r.stopped)
            phase = Phase.PAUSED if idle else r.phase
            found[r.name] = Situation(
                r.place, r.incarnation, r.visit, r.attempt, phase, self._memory(r)
            )
        return found

    def _memory(self, robot: LoggedRobot) -> KnownData:
        task = self.cargo.carried.get(robot.name)
        # changes replace these maps, so sharing them is safe
        return KnownData(
            robot.data,
            self.data,
            None if task is None else (task.id, task.data),
            robot.resumed_from,
            robot.interrupted,
        )

    def _has_concession(self, t: str) -> bool:
        if any(self.marking[p] < n for p, n in self.inputs[t].items()):
            return False
        if any(self.marking[p] >= n for p, n in self.limits[t].items()):
            return False
        return all(
            limit is None or change <= 0 or self.marking[p] + change <= limit
            for p, change in self._effect(t).items()
            for limit in (self.capacity[p],)
        )

    def _effect(self, t: str) -> Dict[str, int]:
        change = dict(self.outputs[t])
        for p, n in self.inputs[t].items():
            change[p] = change.get(p, 0) - n
        return change

    def _waiting(self) -> List[LoggedRobot]:
        done = [r for r in self.robots.values() if r.phase is Phase.DONE and not r.paused]
        return sorted(done, key=lambda r: r.order)

    def _free(self, place: str, t: str) -> List[LoggedRobot]:
        return [
            r
            for r in self._waiting()
            if r.place == place
            and (t in (r.asks, r.may_ask) or (r.asks is None and not self.kind[t].timed))
            and self._may_take(r, t)
        ]

    def _may_take(self, robot: LoggedRobot, t: str) -> bool:
        """Whether the tasks that ``t`` takes are there for this robot."""
        robots = sum(n for p, n in self.inputs[t].items() if p not in self.resources)
        return self.cargo.are_there(t, robot.name if robots == 1 else "")

    def _may_fire(self, t: str) -> bool:
        return self._has_concession(t) and all(
            len(self._free(p, t)) >= n for p, n in self.inputs[t].items() if p not in self.resources
        )

    # -- entries -----------------------------------------------------------------------------------

    def _apply(self, entry: log_entries.Entry) -> Optional[Direct]:
        """Apply an entry. Returns the firing that a valid ``Fire`` or ``Interrupt`` causes
        directly."""
        entry = self.stages.in_present_names(entry)
        if isinstance(entry, log_entries.Start):
            self._start(entry)
        elif isinstance(entry, log_entries.Done):
            robot = self.robots.get(entry.robot)
            key = (entry.incarnation, entry.visit)
            if robot and robot.phase is Phase.DOING and key == (robot.incarnation, robot.visit):
                self._done(robot, entry.result, entry.data)
        elif isinstance(entry, log_entries.Failed):
            robot = self.robots.get(entry.robot)
            attempt = (entry.incarnation, entry.visit, entry.attempt)
            if robot and robot.phase is Phase.DOING and attempt == robot.goal:
                self._failed(robot)
        elif isinstance(entry, log_entries.Retry):
            robot = self.robots.get(entry.robot)
            if robot and robot.phase is Phase.FAILED:
                robot.phase, robot.failures = Phase.DOING, 0
                robot.attempt += 1
        elif isinstance(entry, log_entries.Fire):
            t = entry.transition
            if t in self.kind and not self.paused and self._has_concession(t):
                touched = set(self.inputs[t]) | (set() if self.agents else set(self.outputs[t]))
                if self.resources.issuperset(touched):
                    return Direct(t)
        elif isinstance(entry, log_entries.Interrupt):
            return self._event(entry)
        elif isinstance(entry, log_entries.Submit):
            gone = [r.name for r in self.robots.values() if not r.here]
            self._cancel(self.cargo.comes(entry, gone))
        elif isinstance(entry, log_entries.CancelTask):
            if not (entry.late and self.cargo.find(entry.id)[0] == "robot"):
                self._cancel(entry.id)
        elif isinstance(entry, log_entries.TaskDue):
            self.cargo.due(entry)
        elif isinstance(entry, log_entries.GiveBack):
            self._give_back(entry.id)
        elif isinstance(entry, log_entries.PrioritiseTask):
            self.cargo.prioritise(entry.id, entry.priority)
        elif isinstance(entry, log_entries.Join):
            self.stages.joins(entry.robot, self.witnesses)
            self._join(entry)
        elif isinstance(entry, (log_entries.Leave, log_entries.Evict)):
            self._gone(entry)
        elif isinstance(entry, log_entries.SetPlace):
            robot = self.robots.get(entry.robot)
            if robot and robot.here and entry.place in self.plan.action_places:
                self.marking[robot.place] -= 1
                self.marking[entry.place] += 1
                if entry.returns and robot.name in self.cargo.carried:
                    self._puts_task_down(robot, entry.place)
                robot.place = entry.place
                robot.visit += 1
                self._enter(robot)
        elif isinstance(entry, (log_entries.Pause, log_entries.Resume)):
            self._pause(entry)
        elif isinstance(entry, log_entries.Stop):
            self.ended = entry.reason
        elif isinstance(entry, log_entries.Adopt):
            self._adopt(entry)
        else:
            self.stages.apply(entry, self.robots.get(getattr(entry, "robot", "")), self.witnesses)
        return None

    def _pause(self, entry: Union[log_entries.Pause, log_entries.Resume]) -> None:
        """A pause begins or ends; robots that it kept from acting then make the next attempt."""
        idle = [r for r in self.robots.values() if r.here and (self.stopped or r.stopped)]
        begins = isinstance(entry, log_entries.Pause)
        stops = isinstance(entry, log_entries.Pause) and entry.stop
        if not entry.robot:
            self.paused, self.stopped = begins, stops or (begins and self.stopped)
        elif entry.robot in self.robots:
            robot = self.robots[entry.robot]
            robot.paused, robot.stopped = begins, stops or (begins and robot.stopped)
        for robot in idle:
            if robot.phase is Phase.DOING and not (self.stopped or robot.stopped):
                robot.attempt += 1

    def _cancel(self, task_id: str) -> None:
        """A task is cancelled; its robot continues without it as the plan says."""
        kind, where = self.cargo.find(task_id)
        if not kind:
            return
        self.cargo.remove(task_id)
        if kind == "place":
            self.marking[where] -= 1
        elif kind == "robot" and self.robots[where].here:
            self._loses_task(self.robots[where])

    def _give_back(self, task_id: str) -> None:
        """A robot gives its task back to a queue, and continues without it."""
        kind, name = self.cargo.find(task_id)
        robot = self.robots.get(name if kind == "robot" else "")
        if robot is None or not robot.here:
            return
        returned = {
            q: n
            for q, n in self.plan.on_evict.get(robot.place, {}).items()
            if q in self.cargo.queues
        }
        for queue, n in returned.items():
            self.marking[queue] += n
            self.cargo.returned(robot.name, queue, n)
        if returned:
            self._loses_task(robot)

    def _loses_task(self, robot: LoggedRobot) -> None:
        rule = self.plan.tasks.on_cancel
        if robot.phase is Phase.INACTIVE or (robot.place in rule and rule[robot.place] is None):
            return
        robot.may_ask = None
        asks = rule.get(robot.place)
        if asks is None:
            robot.phase = Phase.FAILED
        else:
            self._ask(robot, asks)

    # -- plan changes ------------------------------------------------------------------------------

    def _adopt(self, entry: log_entries.Adopt) -> None:
        """Switch to the staged plan if the rules allow it."""
        found = self.stages.adopted(entry, self)
        if found is None:
            return
        new, called = found
        old, resources = self.plan, self.resources
        asking = [
            (r, "" if r.asks is None else called.get(r.asks, r.asks)) for r in self._all_waiting()
        ]
        asking.sort(key=lambda pair: pair[0].order)
        asking += [(r, "") for r in self.robots.values() if r.phase is Phase.INACTIVE]
        before = self.marking
        self._take_rules(new)
        heirs = [
            (p, called.get(p, p))
            for p in before
            if p in resources and called.get(p, p) in self.resources
        ]
        self.marking = {p.name: 0 for p in new.net.places}
        for place in new.net.places:
            if place.name in self.resources and place.name not in {h for _, h in heirs}:
                self.marking[place.name] = place.tokens
        for p, heir in heirs:
            self.marking[heir] += before[p]
        for robot in self.robots.values():
            self._move_over(robot, old, called)
        self.cargo.follow(new, self.inputs, self.outputs, called, heirs, before)
        for robot, wish in asking:
            if self.ended is None:
                robot.phase, robot.asks = Phase.DOING, None
                self._done(robot, wish)

    def _move_over(self, robot: LoggedRobot, old: Plan, called: Mapping[str, str]) -> None:
        """Convert the place and the events of a robot to the new plan."""
        place = called.get(robot.place, robot.place)
        if robot.here:
            self.marking[place] += 1
        elif place not in self.plan.action_places or old.on_evict.get(robot.place):
            place = starting_place(self.plan, robot.name)
        robot.place = place
        robot.held = {
            called.get(t, t): cause
            for t, cause in robot.held.items()
            if called.get(t, t) in self.plan.events and called.get(t, t) in self.leaving[place]
        }
        robot.interrupted = {
            called.get(p, p): visit
            for p, visit in robot.interrupted.items()
            if called.get(p, p) in self.capacity
        }
        if robot.may_ask is not None:
            robot.may_ask = called.get(robot.may_ask, robot.may_ask)

    def _event(self, entry: log_entries.Interrupt) -> Optional[Direct]:
        robot, t = self.robots.get(entry.robot), entry.transition
        if robot is None or t not in self.plan.events or t not in self.leaving[robot.place]:
            return None
        if (entry.incarnation, entry.visit) != (robot.incarnation, robot.visit) or not robot.here:
            return None
        if self._may_interrupt(robot, t):
            return Direct(t, robot.name, entry.cause)
        if self.paused or robot.paused or self.plan.events[t].hold:
            robot.held.setdefault(t, entry.cause)
        return None

    def _may_interrupt(self, robot: LoggedRobot, t: str) -> bool:
        if self.paused or robot.paused:
            return False
        return self._has_concession(t) and self._may_take(robot, t)

    def _start(self, entry: log_entries.Start) -> None:
        if self.robots:
            return
        self.seed, self.witnesses = entry.seed, entry.witnesses
        self.draws_ties = entry.draws_ties
        for name, place, incarnation in entry.roster:
            self.robots[name] = LoggedRobot(name, place, incarnation)
            self.marking[place] += 1
        for robot in list(self.robots.values()):
            self._enter(robot)

    def _enter(self, robot: LoggedRobot) -> None:
        robot.attempt, robot.failures = 1, 0
        robot.asks = robot.may_ask = None
        robot.phase = Phase.DOING
        robot.held = {}
        robot.resumed_from = robot.interrupted.get(robot.place, 0)
        if robot.resumed_from:
            left = {p: v for p, v in robot.interrupted.items() if p != robot.place}
            robot.interrupted = left
        if self.plan.action(robot.name, robot.place) is None:
            self._done(robot, "")

    def _done(
        self, robot: LoggedRobot, result: Optional[str], data: Optional[Values] = None
    ) -> None:
        if data and not self._write(robot, data):
            self._failed(robot)
            return
        leaving = self.leaving[robot.place]
        if not leaving:
            robot.phase = Phase.INACTIVE
            return
        leaving = [t for t in leaving if t not in self.plan.events or t == result]
        if result and result != "None":
            if result in leaving:
                self._ask(robot, result)
            else:
                self._failed(robot)
        elif any(not self.kind[t].timed for t in leaving) or not leaving:
            self._ask(robot, None)
        elif len(leaving) == 1:
            self._ask(robot, leaving[0])
        else:
            self._failed(robot)

    def _write(self, robot: LoggedRobot, data: Values) -> bool:
        """Write the data that an action returned, all or nothing; returns whether that is
        possible."""
        by_scope: Dict[str, Dict[str, Any]] = {"robot": {}, "team": {}, "task": {}}
        for name, value in data.items():
            scope, _, short = name.rpartition(".")
            by_scope[scope or "robot"][short] = value
        task: Optional[LoggedTask] = self.cargo.carried.get(robot.name)
        if by_scope["task"] and task is None:
            return False
        own = {**robot.data, **by_scope["robot"]}
        team = {**self.data, **by_scope["team"]}
        of_task = {**(task.data if task is not None else {}), **by_scope["task"]}
        if max(len(own), len(team), len(of_task)) > MOST_NAMES:
            return False
        robot.data, self.data = own, team
        if task is not None:
            task.data = of_task
        return True

    def _ask(self, robot: LoggedRobot, what: Optional[str]) -> None:
        self.orders += 1
        robot.phase, robot.asks, robot.order, robot.failures = Phase.DONE, what, self.orders, 0

    def _failed(self, robot: LoggedRobot) -> None:
        rule = self.plan.failure_rule(robot.place)
        if robot.failures < rule.times:
            robot.failures += 1
            robot.attempt += 1
        elif rule.end is FailureEnd.FIRE and rule.transition in self.leaving[robot.place]:
            self._ask(robot, rule.transition)
        else:
            if rule.end is FailureEnd.STOP:
                self.ended = "an action of %s failed" % robot.name
            else:
                robot.phase = Phase.FAILED

    def _join(self, entry: log_entries.Join) -> None:
        robot = self.robots.get(entry.robot)
        if entry.robot in self.witnesses:
            return
        if robot is None:
            if entry.place in self.plan.action_places:
                robot = LoggedRobot(entry.robot, entry.place, entry.incarnation)
                self.robots[entry.robot] = robot
                self.marking[entry.place] += 1
                self._enter(robot)
        elif entry.incarnation > robot.incarnation:
            robot.incarnation = entry.incarnation
            if not robot.here:
                robot.visit += 1
                gave_back = self.plan.on_evict.get(robot.place)  # an empty map gives nothing back
                if gave_back and entry.place in self.plan.action_places:
                    robot.place = entry.place  # its resources there were given back
                self.marking[robot.place] += 1
                self._enter(robot)
            elif robot.phase is Phase.DOING:
                robot.attempt += 1

    def _puts_task_down(self, robot: LoggedRobot, place: str) -> None:
        """Return the task of a robot, unless it is moved to a place where robots carry one."""
        here, there = (
            {q: n for q, n in self.plan.on_evict.get(p, {}).items() if q in self.cargo.queues}
            for p in (robot.place, place)
        )
        for queue, n in here.items() if not there else ():
            self.marking[queue] += n
            self.cargo.returned(robot.name, queue, n)

    def _gone(self, entry: log_entries.Entry) -> None:
        assert isinstance(entry, (log_entries.Leave, log_entries.Evict))
        robot = self.robots.get(entry.robot)
        if robot is None or not robot.here:
            return
        if self.members() == [robot.name] and not self.agents:
            return  # the last member of a team stays
        leaves = isinstance(entry, log_entries.Leave)
        if isinstance(entry, log_entries.Evict) and entry.incarnation != robot.incarnation:
            return
        robot.phase = Phase.LEFT if leaves else Phase.LOST
        robot.paused = robot.stopped = False
        self.marking[robot.place] -= 1
        for place, n in self.plan.on_evict.get(robot.place, {}).items():
            self.marking[place] += n
            self.cargo.returned(robot.name, place, n)
        if leaves:
            return
        rule = self.plan.on_lost
        stuck = [r for r in self._all_waiting() if self._waits_for(r, robot.place)]
        sure = any(r.asks is not None for r in stuck)
        if stuck and rule.kind is LostKind.STOP:
            self.perhaps_ended = not sure
            if sure:
                self.ended = "%s is lost" % robot.name
        elif rule.kind is LostKind.FIRE:
            for other in stuck:
                if rule.transition in self.leaving[other.place]:
                    if other.asks is None:  # its draw may have needed the lost robot
                        other.may_ask = rule.transition
                    else:
                        other.asks = rule.transition

    def _all_waiting(self) -> List[LoggedRobot]:
        return [r for r in self.robots.values() if r.phase is Phase.DONE]

    def _waits_for(self, robot: LoggedRobot, place: str) -> bool:
        wanted: Iterable[str] = [robot.asks] if robot.asks else self.leaving[robot.place]
        return any(
            n > len(self._free(place, t))
            for t in wanted
            for p, n in self.inputs[t].items()
            if p == place and p not in self.resources
        )


def _add(weights: Dict[str, int], place: str, weight: int) -> None:
    weights[place] = weights.get(place, 0) + weight
