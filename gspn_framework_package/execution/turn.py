"""One turn of the token game: robots finish and transitions fire until nothing is enabled."""

from __future__ import annotations

import itertools
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Tuple, TypeVar

from gspn_framework_package.execution.chance import choose, shuffled, uniform
from gspn_framework_package.execution.firing import (
    CancelAction,
    Ended,
    Fault,
    Firing,
    GameCommand,
    Move,
    StartAction,
    TaskEnded,
    TaskMove,
)
from gspn_framework_package.execution.log_entries import NOTHING
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.rules import Rules
from gspn_framework_package.execution.team_state import Draw, RobotState, TeamState
from gspn_framework_package.execution.team_tasks import (
    TASK_DONE,
    TASK_LOST,
    Task,
    first_of,
    queued,
)
from gspn_framework_package.model.data import NAMES_LIMIT, split
from gspn_framework_package.model.failure import FailureEnd
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan_timing import NO_REQUEST, POLICY

_T = TypeVar("_T")

FIRINGS_PER_ENTRY = 10_000
"""Number of firings after one entry that counts as a timeless cycle and ends the run."""

ASKS_POLICY = ("", "None", None)
"""Results of an action that let the policy decide (thesis Algorithm 1)."""


class Turn:
    """The state while one log slot is reduced, the position in the log, and the output so far.

    After each entry (``docs/semantics.md``), immediate transitions with only resource inputs fire
    first, by priority and weight. Then come the requests of robots that are done: higher priority
    takes precedence, and between equals chance decides. Then come held events, and waiting tasks.
    This repeats after each firing until nothing is enabled.
    """

    def __init__(self, rules: Rules, state: TeamState, slot: int) -> None:
        self.rules, self.net, self.plan = rules, rules.net, rules.plan
        self.state = state
        self.slot = slot
        self.firings: List[Firing] = []
        self.commands: List[GameCommand] = []

    # -- settling ----------------------------------------------------------------------------------

    def settle(self) -> None:
        """Fire until nothing is enabled; then check whether the run is over."""
        fired = 0
        while self.state.ended is None and not self.state.paused:
            if self._reached_until() or not (
                self._fire_spontaneous()
                or self._fire_requested()
                or self._fire_held()
                or self._fire_submitted()
            ):
                break
            fired += 1
            if fired >= FIRINGS_PER_ENTRY:
                self._fault(
                    None,
                    "%d firings without an action between them: a cycle without time; cut off"
                    % fired,
                )
                self._end("a cycle of immediate transitions", finished=False)
        phases = [r.phase for r in self.state.robots.values() if not r.phase.gone]
        if self.state.ended is None and 0 < len(phases) == phases.count(Phase.INACTIVE):
            self._end("every robot is in a place without output arcs", finished=True)

    def _reached_until(self) -> bool:
        if (
            self.rules.until is not None
            and self.state.robots
            and self.rules.until.holds(self.state.marking)
        ):
            self._end("until: %s" % self.plan.until, finished=True)
            return True
        return False

    def _fire_spontaneous(self) -> bool:
        if not self.rules.spontaneous:
            return False
        enabled = [t for t in self.rules.spontaneous if self.net.is_enabled(self.state.marking, t)]
        if not enabled:
            return False
        top = max(self.net.transitions[t].priority for t in enabled)
        choices = [
            (t, self.net.value(self.state.marking, t))
            for t in enabled
            if self.net.transitions[t].priority == top
        ]
        drawn = None
        if len(choices) > 1 and any(weight > 0 for _, weight in choices):
            t, drawn = choose(choices, self._uniform("")), self._position()
        else:
            t = choices[0][0]
        self._fire(t, None, drawn)
        return True

    def _fire_requested(self) -> bool:
        if not self.state.waiting:
            return False
        best: Optional[Tuple[int, RobotState]] = None
        refused = set()
        for name in self._in_turn():
            robot = self.state.robots[name]
            if robot.paused:
                continue
            t = robot.request if robot.request != POLICY else self._policy_choice(robot)
            if t is None or t in refused:
                continue
            if not self.rules.may_fire(self.state, t):
                refused.add(t)
                continue
            if not self.rules.may_take(self.state, robot, t):
                continue
            if best is None or self.rules.urgency[t] > self.rules.urgency[best[0]]:
                best = (t, robot)
                if self.rules.urgency[t] == self.rules.top_urgency:
                    break
        if best is None:
            return False
        t, robot = best
        held = robot.drawn if robot.request == POLICY else None
        self._fire(t, robot, (held.slot, held.index) if held else None)
        return True

    def _in_turn(self) -> Iterable[str]:
        """The robots that are done, in the order in which they may move now."""
        waiting = self.state.waiting
        draws = self.state.draws_ties and len(waiting) > 1
        return self._shuffled(waiting, "turn") if draws else waiting

    def _shuffled(self, items: Iterable[_T], what: str) -> Iterator[_T]:
        return shuffled(items, self.state.seed, *self._position(), what)

    def _fire_held(self) -> bool:
        """Fire the first held event that can fire now."""
        if not self.rules.interrupts:
            return False
        for robot in self.state.active():
            for t in robot.held:
                if self.rules.may_interrupt(self.state, robot, t):
                    self._interrupt(robot, t, robot.held[t])
                    return True
        return False

    def _fire_submitted(self) -> bool:
        """Admit the first task whose transition is enabled now."""
        for number, (t, task) in enumerate(self.state.submitted):
            if not task.at and self.net.is_enabled(self.state.marking, t):
                del self.state.submitted[number]
                self._fire(t, None, None, task=task)
                return True
        return False

    def _interrupt(self, robot: RobotState, t: int, cause: Mapping[str, Any]) -> None:
        """Fire the transition of an event, which interrupts ``robot``."""
        self._cancel(robot)
        if self.rules.interrupts[t].resume:
            robot.interrupted[robot.place] = robot.visit
        self._fire(t, robot, None, movers=[robot], cause=cause)

    def _policy_choice(self, robot: RobotState) -> Optional[int]:
        """The policy's choice for ``robot``, None if there is none. A robot keeps its draw until
        the marking or the candidates change."""
        leaving = self.rules.immediate[robot.place]
        if not leaving:
            return self._nothing(robot, "waits for an event")
        distribution = self.rules.policy.distribution(self.state.marking, robot.place)
        if distribution is not None:
            if not distribution.choices:
                return self._nothing(robot, "the policy makes it wait in this marking")
            choices = self._of_top_priority(distribution.choices, robot)
        elif self.rules.policy.matches(self.state.marking, robot.place):
            return self._nothing(
                robot, "no policy row applies to %s in this marking" % self._name(robot.place)
            )
        elif self.plan.strict:
            return self._nothing(robot, "the policy has no row for this marking", fault=True)
        else:
            choices = self._of_top_priority(
                [
                    (t, self.net.value(self.state.marking, t))
                    for t in leaving
                    if self._may_ask(robot, t)
                ],
                robot,
            )
            if not any(weight > 0 for _, weight in choices):
                return self._nothing(
                    robot,
                    "the policy has no row for this marking, and no weight decides"
                    if choices
                    else "no immediate transition is enabled",
                )
        candidates = tuple(t for t, _ in choices)
        held = robot.drawn
        if held is None or (held.version, held.candidates) != (self.state.version, candidates):
            robot.why = ""
            robot.drawn = Draw(
                self.state.version,
                candidates,
                choose(choices, self._uniform(robot.name)),
                *self._position(),
            )
        return robot.drawn.transition if robot.drawn else None

    def _may_ask(self, robot: RobotState, t: int) -> bool:
        """Whether ``t`` can fire now if ``robot`` asks for it."""
        return self.rules.may_fire(self.state, t) and self.rules.may_take(self.state, robot, t)

    def _of_top_priority(
        self, choices: Sequence[Tuple[int, float]], robot: RobotState
    ) -> Sequence[Tuple[int, float]]:
        """The choices without those of lower priority than an enabled choice."""
        priorities = {self.net.transitions[t].priority for t, _ in choices}
        if len(priorities) < 2:
            return choices
        enabled = [self.net.transitions[t].priority for t, _ in choices if self._may_ask(robot, t)]
        floor = max(enabled, default=0)
        return [(t, p) for t, p in choices if self.net.transitions[t].priority >= floor]

    def _nothing(self, robot: RobotState, why: str, fault: bool = False) -> Optional[int]:
        robot.drawn = None
        if robot.why != why:
            robot.why = why
            if fault:
                self._fault(robot, why + "; it waits in %s" % self._name(robot.place))
        return None

    def _position(self) -> Tuple[int, int]:
        return self.slot, len(self.firings)

    def _uniform(self, who: str) -> float:
        return uniform(self.state.seed, *self._position(), who)

    # -- firing ------------------------------------------------------------------------------------

    def _fire(
        self,
        t: int,
        requester: Optional[RobotState],
        drawn: Optional[Tuple[int, int]],
        *,
        movers: Optional[List[RobotState]] = None,
        task: Optional[Task] = None,
        cause: Mapping[str, Any] = NOTHING,
    ) -> None:
        """Fire transition ``t``.

        :param movers: the robots that it moves; by default those that are done and free for it.
        :param task: the task that arrives with it.
        :param cause: the data of the event that fires it.
        """
        if movers is None:
            movers = self._bind(t, requester)
        incarnation, visit = (requester.incarnation, requester.visit) if requester else (0, 0)
        targets = self._targets(t, movers)
        passes = bool(self.rules.queues) or task is not None
        tasks = self._pass_tasks(t, movers, targets, task) if passes else ()
        self.state.set_marking(self.net.fire(self.state.marking, t))
        moves = []
        arrived = []
        for robot, target in zip(movers, targets):
            source = self._name(robot.place)
            self.state.remove_waiting(robot)
            if target is None:
                del self.state.robots[robot.name]
                moves.append(Move(robot.name, source, None, robot.visit + 1))
                continue
            robot.place = target
            robot.visit += 1
            moves.append(Move(robot.name, source, self._name(target), robot.visit))
            arrived.append(robot)
        for target in targets[len(movers) :]:
            assert target is not None
            self.state.created += 1
            robot = RobotState(str(self.state.created), target)
            self.state.robots[robot.name] = robot
            moves.append(Move(robot.name, None, self._name(target), robot.visit))
            arrived.append(robot)
        self.firings.append(
            Firing(
                self.slot,
                len(self.firings),
                self.net.transitions[t].name,
                requester.name if requester else "",
                incarnation,
                visit,
                tuple(moves),
                self.state.marking,
                drawn,
                tasks,
                cause,
            )
        )
        for robot in arrived:
            self._enter(robot)

    def _pass_tasks(
        self,
        t: int,
        movers: List[RobotState],
        targets: List[Optional[int]],
        incoming: Optional[Task],
    ) -> Tuple[TaskMove, ...]:
        """Move the tasks when ``t`` fires: those of its queues, of the robots that it moves, and
        the arriving one.

        A queue first gets the tasks of the robots, then those from other queues, then the arriving
        one. The rest go to the robots that carry none, in order. A task that arrives without a
        queue is done by the firing.
        """
        queues, state = self.rules.queues, self.state
        name = self.net.transitions[t].name
        moves: List[TaskMove] = []
        if t in self.rules.task_done:
            for robot in movers:
                if robot.task is not None:
                    moves.append(TaskMove(robot.task.id, "robot " + robot.name, "done"))
                    why = "%s with %s" % (name, robot.name)
                    self._end_task(robot.task, TASK_DONE, why, robot.name)
                    robot.task = None
        wanted = [p for p, weight in self.net.outputs[t] if p in queues for _ in range(weight)]
        at_hand: List[Tuple[Task, str]] = []
        for robot in movers:
            if robot.task is not None and len(at_hand) < len(wanted):
                at_hand.append((robot.task, "robot " + robot.name))
                robot.task = None
        for p, weight in self.net.inputs[t]:
            if p in queues:
                source = "place " + self._name(p)
                at_hand += [(task, source) for task in self._take(p, weight, movers)]
        if incoming is not None:
            at_hand.append((incoming, ""))
        for p in wanted:
            task, source = at_hand.pop(0) if at_hand else (Task(), "")
            state.queues[p] = queued(state.queues.get(p, ()), task, self.rules.queue_orders[p])
            moves.append(TaskMove(task.id, source, "place " + self._name(p)))
        stay = [robot for robot, target in zip(movers, targets) if target is not None]
        takers = [robot for robot in stay if robot.task is None]
        takers += [robot for robot in stay if robot.task is not None]
        for robot, target in zip(movers, targets):
            if target is None and robot.task is not None:
                moves.append(self._drop_task(robot))
        for task, source in at_hand:
            if not takers:
                done = t in self.rules.task_done or not source
                moves.append(TaskMove(task.id, source, "done" if done else "dropped"))
                self._end_task(task, TASK_DONE if done else TASK_LOST, name)
                if task.id and not done:
                    self._fault_of_task(None, "drops task %s, which was not done" % task.id)
                continue
            robot = takers.pop(0)
            if robot.task is not None:
                moves.append(self._drop_task(robot))
            robot.task = task._replace(attempts=task.attempts + (not source.startswith("robot ")))
            moves.append(TaskMove(task.id, source, "robot " + robot.name))
        return tuple(move for move in moves if move.id)

    def _take(self, p: int, weight: int, movers: List[RobotState]) -> List[Task]:
        """Take tasks out of a queue: the first that are not for other robots."""
        queue = self.state.queues.get(p, [])
        alone = movers[0].name if len(movers) == 1 else ""
        order = sorted(
            range(len(queue)),
            key=lambda i: bool(movers) and not self.rules.is_for(queue[i].to, alone),
        )
        taken = set(order[:weight])
        self.state.queues[p] = [task for i, task in enumerate(queue) if i not in taken]
        return [queue[i] for i in order[:weight]]

    def _end_task(self, task: Task, outcome: str, why: str, robot: str = "") -> None:
        """Record and report that a task has ended; does nothing for a token without a task."""
        if task.id:
            self.state.end_task(task, outcome, why)
            ended = TaskEnded(task.id, outcome, why, robot, task.data, task.since, task.attempts)
            self.commands.append(ended)

    def _drop_task(self, robot: RobotState) -> TaskMove:
        assert robot.task is not None
        move = TaskMove(robot.task.id, "robot " + robot.name, "dropped")
        if move.id:
            self._fault_of_task(robot, "drops task %s, which was not done" % move.id)
        self._end_task(robot.task, TASK_LOST, "dropped by " + robot.name, robot.name)
        robot.task = None
        return move

    def _bind(self, t: int, requester: Optional[RobotState]) -> List[RobotState]:
        """The robots that ``t`` moves, place by place in the order of its arcs: the one that
        requested it, and of the others that are free those that chance selects."""
        movers: List[RobotState] = []
        for p, weight in self.net.inputs[t]:
            if self.rules.acts[p]:
                free = self.rules.free_robots(self.state, p, t)
                if self.state.draws_ties and len(free) > 1:
                    others = [robot for robot in free if robot is not requester]
                    chosen = [robot for robot in free if robot is requester]
                    chosen += itertools.islice(
                        self._shuffled(others, "in " + self._name(p)), weight - len(chosen)
                    )
                    free = chosen
                elif requester in free[weight:]:
                    free = free[: weight - 1] + [requester]
                movers += free[:weight]
        return movers

    def _targets(self, t: int, movers: List[RobotState]) -> List[Optional[int]]:
        """The target place of each mover (None: it is destroyed and becomes Void), followed by the
        places where new agents appear."""
        slots = [
            p for p, weight in self.net.outputs[t] if self.rules.acts[p] for _ in range(weight)
        ]
        if len(movers) == len(slots) == 1:
            return [*slots]
        surplus = len(movers) - len(slots)
        void = set()
        if surplus > 0:
            void = set(itertools.islice(self._shuffled(range(len(movers)), "void"), surplus))
        routes = self.plan.routes.get(t, {})
        targets: Dict[int, int] = {}
        for i, robot in enumerate(movers):
            wanted = routes.get(robot.place)
            if i not in void and wanted in slots:
                slots.remove(wanted)
                targets[i] = wanted
        for i in range(len(movers)):
            if i not in void and i not in targets:
                targets[i] = slots.pop(0)
        return [targets.get(i) for i in range(len(movers))] + list(slots)

    # -- results of actions ------------------------------------------------------------------------

    def _done(
        self, robot: RobotState, result: Optional[str], data: Mapping[str, Any] = NOTHING
    ) -> None:
        if data and not self._write(robot, data):
            return
        leaving = self.net.consumers[robot.place]
        if not leaving:
            robot.phase = Phase.INACTIVE
            return
        if result not in ASKS_POLICY:
            t = self.net.transition_index.get(str(result))
            if t is None or t not in leaving:
                self._failed(
                    robot,
                    Outcome.BAD_RESULT,
                    "'%.200s' does not leave %s" % (result, self._name(robot.place)),
                )
                return
            self._ask(robot, t)
            return
        asked = self.rules.unnamed[robot.place]
        if asked != NO_REQUEST:
            self._ask(robot, asked)
            return
        self._failed(
            robot,
            Outcome.BAD_RESULT,
            "no transition was named, but %s has %d exponential ones"
            % (self._name(robot.place), len(self.plan.of_action(robot.place))),
        )

    def _write(self, robot: RobotState, data: Mapping[str, Any]) -> bool:
        """Write the data that an action returned; if that is not possible, the action has
        failed."""
        task = dict(robot.task.data) if robot.task is not None else None
        stores = {"robot": dict(robot.data), "team": dict(self.state.data), "task": task}
        for full, value in data.items():
            scope, name = split(full)
            store = stores[scope]
            if store is None:
                self._failed(robot, Outcome.BAD_RESULT, "'%s' was written without a task" % full)
                return False
            store[name] = value
            if len(store) > NAMES_LIMIT:
                self._failed(robot, Outcome.BAD_RESULT, "more than %d data names" % NAMES_LIMIT)
                return False
        robot.data, self.state.data = stores["robot"] or {}, stores["team"] or {}
        if robot.task is not None:
            robot.task = robot.task._replace(data=task or {})
        return True

    def _ask(self, robot: RobotState, request: int) -> None:
        robot.request = request
        robot.failures = 0
        robot.why = ""
        self.state.add_waiting(robot)

    def _failed(self, robot: RobotState, reason: str, detail: str) -> None:
        rule = self.plan.failure_rule(self._name(robot.place))
        robot.why = reason + (": " + detail if detail else "")
        what = "the action of %s failed (%s)" % (self._name(robot.place), robot.why)
        if robot.failures < rule.times:
            robot.failures += 1
            robot.attempt += 1
            self._fault(robot, "%s; attempt %d follows" % (what, robot.attempt), reason)
            self._start_action(robot, rule.delay(robot.failures))
            return
        t = self.plan.fallback(robot.place)
        if t >= 0:
            self._fault(robot, "%s; continues with %s" % (what, rule.transition), reason)
            self._ask(robot, t)
            return
        if rule.end is FailureEnd.STOP:
            self._fault(robot, what, reason)
            self._end("%s: %s" % (robot.name, what), finished=False)
            return
        robot.phase = Phase.FAILED
        carries = ", with task %s" % robot.task.id if robot.task and robot.task.id else ""
        self._fault(robot, "%s; waits for the operator%s" % (what, carries), reason)

    # -- robots ------------------------------------------------------------------------------------

    def _name(self, p: int) -> str:
        return self.net.places[p].name

    def _add(self, robot: RobotState) -> None:
        self.state.robots[robot.name] = robot
        marking = list(self.state.marking)
        marking[robot.place] += 1
        self.state.set_marking(tuple(marking))

    def _enter(self, robot: RobotState) -> None:
        """Begin a visit: start the action of the place; if it has none, the robot is done at
        once."""
        robot.attempt = 1
        robot.failures = 0
        robot.why = ""
        if self.rules.interrupts:
            robot.held = {}
            robot.resumed_from = robot.interrupted.pop(robot.place, 0)
        robot.phase = Phase.DOING
        if self.plan.action(robot.name, self._name(robot.place)) is None:
            self._done(robot, "")
        else:
            self._start_action(robot)

    def _start_action(self, robot: RobotState, delay: float = 0.0) -> None:
        if self.state.is_stopped(robot):
            return  # it starts when the pause ends
        self.commands.append(
            StartAction(
                robot.name,
                self._name(robot.place),
                robot.incarnation,
                robot.visit,
                robot.attempt,
                delay,
                self.state.data_of(robot),
                robot.resumed_from,
            )
        )

    def _cancel(self, robot: RobotState) -> None:
        if robot.phase is Phase.DOING and not self.state.is_stopped(robot):
            self.commands.append(CancelAction(robot.name, robot.visit))

    def _fault(self, robot: Optional[RobotState], message: str, failed: str = "") -> None:
        self.commands.append(Fault(robot.name if robot else "", message, failed))

    def _fault_of_task(self, robot: Optional[RobotState], message: str) -> None:
        """Say what becomes of a task."""
        self.commands.append(Fault(robot.name if robot else "", message, about_task=True))

    def _end(self, reason: str, finished: bool, stopped: bool = False) -> None:
        if self.state.ended is None:
            left = self.state.tasks_left(self.net)
            if left:
                text = "the run ends with %d unfinished tasks: %s"
                self._fault_of_task(None, text % (len(left), first_of(left)))
            self.state.ended, self.state.finished = reason, finished
            self.state.fault = not (finished or stopped)
            for robot in self.state.active():
                self._cancel(robot)
            self.commands.append(Ended(reason, finished))
