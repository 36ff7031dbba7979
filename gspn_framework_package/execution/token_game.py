"""The token game: log entries in, firings and commands out. Pure and deterministic.

Everything that runs, shows or replays a plan uses :class:`TokenGame`: the standalone executor, each
robot's node, the page and the recorder. The same entries always lead to the same state. ``rules``
holds the rules themselves, and ``turn`` determines what fires when; this module applies the entries
of the log.
"""

from __future__ import annotations

from typing import Any, Dict, Iterable, List, Mapping, NamedTuple, Optional

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.firing import Command, Firing
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.rules import Rules
from gspn_framework_package.execution.team_state import POLICY, RobotState, Task, TeamState
from gspn_framework_package.execution.turn import Turn
from gspn_framework_package.model.plan import LostKind

KNOWN_TASKS = 10_000
"""For each transition, so many ids of tasks are remembered; an older id counts as new."""

INTERRUPTED = (Phase.DOING, Phase.DONE, Phase.FAILED)
"""The phases in which an event takes a robot out of its place."""


class Step(NamedTuple):
    """The effects of some entries, in order."""

    firings: List[Firing]
    commands: List[Command]


def robots_in(
    state: TeamState, entries: Iterable[log_entries.Entry], step: Step
) -> Dict[str, None]:
    """The names of the robots whose visits may have begun or ended with a step: those that its
    entries name, those that moved, and at the start all, in this order."""
    entries = list(entries)
    names = dict.fromkeys(getattr(entry, "robot", "") for entry in entries)
    names.update((move.robot, None) for firing in step.firings for move in firing.moves)
    if any(isinstance(entry, log_entries.Start) for entry in entries):
        names.update(dict.fromkeys(state.robots))
    names.pop("", None)
    return names


class TokenGame(Rules):
    """The token game of one plan: see :class:`~gspn_framework_package.execution.rules.Rules`."""

    def new_state(self) -> TeamState:
        """The state before ``Start``: the resource tokens of the initial marking, and no robots."""
        marking = tuple(0 if not r else p.tokens for p, r in zip(self.net.places, self.is_resource))
        state = TeamState(marking)
        state.queues = {p: [Task()] * marking[p] for p in self.queues if marking[p]}
        return state

    def state_from_json(self, data: Dict[str, Any]) -> TeamState:
        """The state in a JSON object. :raises LogError: it is not a state of this plan."""
        return TeamState.from_json(data, self.net, self.queues)

    def start_entry(self, plan_hash: Optional[str] = None) -> log_entries.Start:
        """The ``Start`` of the plan's own robots, each in its initial place with incarnation 0."""
        roster = tuple((r.name, r.place, 0) for r in self.plan.robots)
        return log_entries.Start(
            roster, self.plan.seed, plan_hash or self.plan.hash(), self.plan.witness
        )

    def reduce(self, state: TeamState, slot: int, batch: Iterable[log_entries.Entry]) -> Step:
        """Apply the entries of log slot ``slot`` to ``state`` in place, and settle after each.

        Stale entries (an old visit or incarnation, a robot that is gone) change nothing.
        """
        turn = _Reducer(self, state, slot)
        for entry in batch:
            if state.ended is None:
                turn.apply(entry)
                turn.settle()
        state.next_slot = slot + 1
        return Step(turn.firings, turn.commands)


class _Reducer(Turn):
    """Applies log entries to the state."""

    def apply(self, entry: log_entries.Entry) -> None:
        if isinstance(entry, log_entries.Start):
            self._start(entry)
        elif isinstance(entry, log_entries.Done):
            robot = self._current(entry.robot, entry.incarnation, entry.visit)
            if robot is not None:
                self._done(robot, entry.result, entry.data)
        elif isinstance(entry, log_entries.Failed):
            robot = self._current(entry.robot, entry.incarnation, entry.visit)
            if robot is not None and robot.attempt == entry.attempt:
                self._failed(robot, entry.reason, entry.detail)
        elif isinstance(entry, log_entries.Retry):
            self._retry(entry.robot)
        elif isinstance(entry, log_entries.Fire):
            self._environment(entry.transition)
        elif isinstance(entry, log_entries.Interrupt):
            self._event(entry)
        elif isinstance(entry, log_entries.Submit):
            self._submit(entry)
        elif isinstance(entry, log_entries.Join):
            self._join(entry)
        elif isinstance(entry, (log_entries.Leave, log_entries.Evict)):
            self._depart(entry)
        elif isinstance(entry, log_entries.SetPlace):
            self._set_place(entry)
        elif isinstance(entry, (log_entries.Pause, log_entries.Resume)):
            self._pause(entry.robot, isinstance(entry, log_entries.Pause))
        elif isinstance(entry, log_entries.Stop):
            self._end(entry.reason, finished=False, stopped=True)

    def _start(self, entry: log_entries.Start) -> None:
        if self.state.robots:
            return
        self.state.seed = entry.seed
        self.state.witnesses = tuple(entry.witnesses)
        for name, place, incarnation in entry.roster:
            self._add(RobotState(name, self.net.place_number(place), incarnation))
        self.state.created = len(entry.roster)
        for robot in list(self.state.robots.values()):
            self._enter(robot)

    def _current(self, name: str, incarnation: int, visit: int) -> Optional[RobotState]:
        """The robot, if its action of exactly that visit still runs; None otherwise."""
        robot = self.state.robots.get(name)
        if robot is None or robot.phase is not Phase.DOING:
            return None
        return robot if (robot.incarnation, robot.visit) == (incarnation, visit) else None

    def _retry(self, name: str) -> None:
        robot = self.state.robots.get(name)
        if robot is not None and robot.phase is Phase.FAILED:
            robot.phase = Phase.DOING
            robot.failures = 0
            robot.attempt += 1
            robot.why = ""
            self._start_action(robot)

    def _environment(self, name: str) -> None:
        t = self.net.transition_index.get(name)
        if (
            t is None
            or self.rules.has_robots[t]
            or (self.rules.makes_robots[t] and not self.rules.agents)
        ):
            self._fault(None, "'%s' is not a transition of the environment" % name)
        elif self.state.paused or not self.net.is_enabled(self.state.marking, t):
            self._fault(
                None,
                "'%s' cannot fire: %s"
                % (
                    name,
                    "; ".join(self.net.why_disabled(self.state.marking, t)) or "the team is paused",
                ),
            )
        else:
            self._fire(t, None, None)

    def _event(self, entry: log_entries.Interrupt) -> None:
        robot = self.state.robots.get(entry.robot)
        t = self.net.transition_index.get(entry.transition)
        if (
            robot is None
            or t not in self.rules.interrupts
            or (robot.incarnation, robot.visit) != (entry.incarnation, entry.visit)
            or robot.phase not in INTERRUPTED
            or t not in self.net.consumers[robot.place]
        ):
            return
        assert t is not None
        if self.rules.may_interrupt(self.state, robot, t):
            self._interrupt(robot, t, entry.cause)
        # a pause delays an event, but does not lose it
        elif self.rules.interrupts[t].hold or self.state.paused or robot.paused:
            robot.held.setdefault(t, entry.cause)

    def _submit(self, entry: log_entries.Submit) -> None:
        t = self.net.transition_index.get(entry.transition)
        if t not in self.rules.submissions:
            self._fault(None, "no tasks come in by '%s'" % entry.transition)
            return
        assert t is not None
        if self.state.is_known(t, entry.id):
            return
        self.state.submitted.append((t, Task(entry.id, entry.data)))
        known = self.state.known.setdefault(t, {})
        known[entry.id] = None
        # the id of a task that still waits is not forgotten; tasks of one transition wait in order
        waits = next(task.id for other, task in self.state.submitted if other == t)
        while len(known) > KNOWN_TASKS:
            oldest = next(iter(known))
            if oldest == waits:
                break
            del known[oldest]

    # -- membership and the operator ---------------------------------------------------------------

    def _join(self, entry: log_entries.Join) -> None:
        if entry.robot in self.state.witnesses:
            return
        robot = self.state.robots.get(entry.robot)
        if robot is None:
            p = self.net.place_index.get(entry.place)
            if p is None or self.rules.is_resource[p]:
                self._fault(None, "%s cannot join in '%s'" % (entry.robot, entry.place))
                return
            robot = RobotState(entry.robot, p, entry.incarnation)
            self._add(robot)
            self._enter(robot)
        elif entry.incarnation <= robot.incarnation:
            return
        elif robot.phase.gone:
            robot.incarnation = entry.incarnation
            robot.visit += 1
            p = self.net.place_index.get(entry.place)
            if p is not None and not self.rules.is_resource[p] and self._gave_back(robot):
                robot.place = p
            self._add(robot)
            self._enter(robot)
        else:
            robot.incarnation = entry.incarnation
            if robot.phase is Phase.DOING:
                robot.attempt += 1
                self._start_action(robot)

    def _depart(self, entry: log_entries.Entry) -> None:
        assert isinstance(entry, (log_entries.Leave, log_entries.Evict))
        robot = self.state.robots.get(entry.robot)
        if robot is None or robot.phase.gone:
            return
        if isinstance(entry, log_entries.Evict) and entry.incarnation != robot.incarnation:
            return
        if self.state.members() == [robot.name] and not self.rules.agents:
            # otherwise nobody would be left to let a robot in
            self._fault(robot, "stays: it is the last one of the team")
            return
        self._cancel(robot)
        self.state.remove_waiting(robot)
        robot.phase = Phase.LOST if isinstance(entry, log_entries.Evict) else Phase.LEFT
        robot.paused = False
        marking = list(self.state.marking)
        marking[robot.place] -= 1
        self._give_back(robot, marking)
        self.state.set_marking(tuple(marking))
        if robot.phase is Phase.LOST:
            self._fault(robot, "is lost; its token was in %s" % self._name(robot.place))
            self._on_lost(robot)

    def _gave_back(self, robot: RobotState) -> Mapping[str, int]:
        """What a robot gives back when it departs from its place: resource place -> tokens."""
        return self.plan.on_evict.get(self._name(robot.place), {})

    def _give_back(self, robot: RobotState, marking: List[int]) -> None:
        for resource, count in self._gave_back(robot).items():
            p = self.net.place_number(resource)
            marking[p] += count
            if p not in self.rules.queues:
                continue
            # its task is the next to be taken: it came before those that still wait
            back = [robot.task or Task()] + [Task()] * (count - 1)
            self.state.queues[p] = [*back, *self.state.queues.get(p, ())]
            if robot.task is not None and robot.task.id:
                self._fault(robot, "gives task %s back to %s" % (robot.task.id, resource))
            robot.task = None

    def _on_lost(self, lost: RobotState) -> None:
        rule = self.plan.on_lost
        stuck = [
            r
            for r in map(self.state.robots.__getitem__, list(self.state.waiting))
            if self._needs(r, lost.place)
        ]
        if not stuck or rule.kind is LostKind.HOLD:
            return
        if rule.kind is LostKind.STOP:
            self._end(
                "%s is lost, and %s waits for it" % (lost.name, stuck[0].name), finished=False
            )
            return
        t = self.net.transition_number(rule.transition)
        for robot in stuck:
            if t in self.net.consumers[robot.place]:
                robot.request = t
                robot.drawn = None

    def _needs(self, robot: RobotState, place: int) -> bool:
        """Whether the request of ``robot`` lacks a robot in ``place``."""
        t = (
            robot.request
            if robot.request != POLICY
            else (robot.drawn.transition if robot.drawn else None)
        )
        return t is not None and any(
            p == place and len(self.rules.free_robots(self.state, p, t)) < weight
            for p, weight in self.net.inputs[t]
        )

    def _set_place(self, entry: log_entries.SetPlace) -> None:
        robot = self.state.robots.get(entry.robot)
        p = self.net.place_index.get(entry.place)
        if robot is None or robot.phase.gone or p is None or self.rules.is_resource[p]:
            self._fault(robot, "'%s' cannot be put into '%s'" % (entry.robot, entry.place))
            return
        self._cancel(robot)
        self.state.remove_waiting(robot)
        marking = list(self.state.marking)
        marking[robot.place] -= 1
        marking[p] += 1
        self.state.set_marking(tuple(marking))
        robot.place = p
        robot.visit += 1
        self._enter(robot)

    def _pause(self, name: str, paused: bool) -> None:
        if not name:
            self.state.paused = paused
        elif name in self.state.robots:
            self.state.robots[name].paused = paused
