"""Handles what reaches this robot from outside the team: events that interrupt it, and new tasks.

Owns ``offered``. Turns events of the robot's present visit into proposals. Keeps tasks, in its log
as well, until the team has them: every robot that a task reached keeps it, the first running member
proposes it, and the others do so only if that takes too long. A task thus survives the loss of a
robot, and is usually proposed once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Optional, Set, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.local_robot import LocalRobot
from gspn_framework_package.execution.agreement.part import ReplicaPart
from gspn_framework_package.execution.breakpoints import RobotBreakpoints
from gspn_framework_package.execution.environment import next_of_clock
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.event_watch import EventWatch, Visit, asked_anew
from gspn_framework_package.execution.team_state import OUTSIDE_LIMIT
from gspn_framework_package.execution.team_tasks import TASK_CANCELLED, TASK_DONE, first_of
from gspn_framework_package.model.errors import LogError

OFFERED_LIMIT = 10_000
"""Maximum number of tasks that a robot keeps for a team that does not take them."""


@dataclass(eq=False)
class Reactions(ReplicaPart):
    """Events and tasks at this robot."""

    robot: LocalRobot
    breaks: RobotBreakpoints

    def __post_init__(self) -> None:
        self._game = self.config.game
        self._watch: Optional[EventWatch] = None
        self._begin_to_watch()
        self._orders: Dict[Tuple[str, str], List[str]] = {}
        """Task -> operators' orders that wait until the team has it."""
        self._named_late_tasks = False

    # -- events ------------------------------------------------------------------------------------

    def follow(self) -> None:
        """Watch the events of the plan that the team follows now."""
        ledger = self.state.ledger
        if self._game is ledger.game:
            return
        before, self._game = self._watch, ledger.game
        self._begin_to_watch()
        if before is not None and self._watch is not None:
            adopted = ledger.state.adopted
            self._watch.go_on_from(before, adopted.mapping if adopted else {})

    def _begin_to_watch(self) -> None:
        plan = self._game.plan
        anew = asked_anew(plan, topics=True)
        self._watch = EventWatch(plan, self.config.name, anew) if plan.events else None

    def observe(self, given: interface.EventObserved) -> None:
        """Take a report of a source."""
        if self._watch is not None:
            self._watch.observe(given.transition, given.holds, given.cause)

    def want_events(self) -> None:
        """Propose the events that should interrupt the robot now."""
        if self._watch is None:
            return
        for event in self._watch.due(self._visit(), self.state.now):
            if not self._is_idle(event):
                if event.transition in self.breaks.breakpoints.transitions:
                    self.robot.pause_at_breakpoint()
                self.proposals.propose(self._readable(event))

    def _is_idle(self, event: log_entries.Interrupt) -> bool:
        """Whether an event would change nothing, as far as we know: the same event of this visit is
        already proposed or held, or its transition is not enabled and would not be held. Sources
        that change all the time must not fill the log."""
        for own in self.state.own_proposals.asking:
            entry = own.item.entry
            if isinstance(entry, log_entries.Interrupt) and entry[:4] == event[:4]:
                return True
        team, robot = self.state.ledger.state, self.electorate.own_robot()
        net = self._game.net
        t = net.transition_number(event.transition)
        if robot is not None and robot.visit == event.visit and t in robot.held:
            return True
        if self._game.plan.events[event.transition].hold or team.paused:
            return False
        paused = robot is not None and robot.paused
        return not paused and not net.is_enabled(self.robot.marking(), t)

    def _readable(self, event: log_entries.Interrupt) -> log_entries.Entry:
        """The event in written form, without its cause if that could not be read back."""
        try:
            return log_entries.checked(event)
        except LogError as error:
            self.outbox.fault("omitting the cause of '%s': %s" % (event.transition, error))
            return event._replace(cause=log_entries.NOTHING)

    def watches(self, transition: str) -> bool:
        """Whether an event could interrupt the robot in its present visit."""
        return self._watch is not None and self._watch.watches(transition)

    def _visit(self) -> Optional[Visit]:
        state = self.state
        at = state.position
        if at is None or not state.active or at.incarnation != state.incarnation:
            return None
        return Visit(self._game.net.places[at.place].name, at.incarnation, at.visit)

    # -- tasks -------------------------------------------------------------------------------------

    def take_task(self, task: log_entries.Submit, order_id: str = "") -> str:
        """Keep a task until the team has it; returns why the task is refused, "" if it is not.

        :param order_id: the operator's order that gave it, answered once the team has the task.
        """
        state = self.state
        task = task._replace(transition=state.ledger.state.present_name(task.transition))
        if state.ledger.entrance(task.transition) is None:
            return "'%s' does not take tasks" % task.transition
        if state.ledger.state.ended is not None:
            return "the run is over: %s" % state.ledger.state.ended
        if order_id and self._is_full(task.transition):
            return "%d tasks are already waiting for '%s'" % (OUTSIDE_LIMIT, task.transition)
        try:
            kept = log_entries.checked(task)
        except LogError as error:
            return str(error)
        assert isinstance(kept, log_entries.Submit)  # a duplicate of a task that we keep
        key = (task.transition, task.id)
        if key not in state.offered and not self.has(key):
            if len(state.offered) >= OFFERED_LIMIT:
                return "%d tasks are already waiting for the team" % OFFERED_LIMIT
            self.outbox.persist({"kind": "offered", "entry": log_entries.to_json(kept)})
            state.offered[key] = (kept, state.now)
        if order_id and key in state.offered:
            self._orders.setdefault(key, []).append(order_id)
        elif order_id:
            team = state.ledger.state
            where = team.whereabouts(task.id, state.ledger.game.net)
            text = "the task was submitted before and is not taken again: %s" % where
            ended = None if team.tasks_with(task.id) else team.end_of(task.id)
            is_undone = ended is not None and ended.outcome != TASK_DONE
            self.outbox.order_result(order_id, not is_undone, text)
        return ""

    def want_tasks(self) -> None:
        """Propose the tasks that the team does not have yet, if that is up to us."""
        state = self.state
        if not state.offered:
            return
        for key in [key for key in state.offered if self.has(key)]:
            del state.offered[key]
            self._answer(key, self._orders.pop(key, []))
        for key in [key for key in state.offered if state.ledger.entrance(key[0]) is None]:
            if not state.active:
                break  # a robot that discarded its log does not yet know the plan of the task
            del state.offered[key]
            why = "'%s' does not take tasks any more" % key[0]
            self.outbox.fault("task %s is refused: %s" % (key[1], why))
            for order in self._orders.pop(key, []):
                self.outbox.order_result(order, False, why)
        if state.ledger.state.ended is not None:
            self._refuse_orders("the run is over: %s" % state.ledger.state.ended)
            self._name_tasks_that_came_too_late()
            return
        if not state.active:
            return
        proposed = self._proposed()
        soon = state.leaving or self.electorate.is_first_running()
        for key, (task, since) in state.offered.items():
            if (key not in proposed and not self._is_full(key[0])) and (
                soon or key in self._orders or state.now >= since + self._patience()
            ):
                self.proposals.propose(task)

    def has(self, key: Tuple[str, str]) -> bool:
        """Whether the team has a task."""
        transition, task = key
        ledger = self.state.ledger
        t = ledger.entrance(transition)
        return t is not None and ledger.state.is_known(t, task)

    def _is_full(self, transition: str) -> bool:
        """Whether no more tasks can wait outside the net; we keep ours until there is room."""
        ledger = self.state.ledger
        t = ledger.entrance(transition)
        return t is not None and ledger.state.is_full(t)

    def _answer(self, key: Tuple[str, str], orders: List[str]) -> None:
        """Answer the operators once the team has their task."""
        team, net = self.state.ledger.state, self.state.ledger.game.net
        where = team.whereabouts(key[1], net)
        outside = [task for _, task in team.submitted if task.id == key[1]]
        if outside:
            time = "its time comes" if outside[0].at else "'%s' is enabled" % key[0]
            where = "it waits until " + time
        text = "the team has the task; " + where
        ended = team.end_of(key[1])
        taken = ended is None or ended.outcome != TASK_CANCELLED
        for order in orders:
            self.outbox.order_result(order, taken, text if taken else where)

    def look_at_times(self, seconds: int) -> None:
        """If that is up to us, propose to submit the tasks whose time has come, to cancel those
        whose time is over, and to advance the clock.

        :param seconds: the time of day, in seconds since 1970.
        """
        state = self.state
        over = state.ledger.state.ended is not None
        if over or not state.active or not self.electorate.is_first_running():
            return
        asking = [own.item.entry for own in state.own_proposals.asking]
        clock = next_of_clock(self._game, state.ledger.state, seconds)
        if clock is not None and not clock[0] and clock[1] not in asking:
            self.proposals.propose(clock[1])
        due = {(entry.id, entry.at) for entry in asking if isinstance(entry, log_entries.TaskDue)}
        for task in [found.task for found in state.ledger.state.tasks() if not found.robot]:
            late = log_entries.CancelTask(task.id, late=True)
            if 0 < task.until <= seconds:
                if late not in asking:
                    self.proposals.propose(late)
            elif 0 < task.at <= seconds and (task.id, task.at) not in due:
                self.proposals.propose(log_entries.TaskDue(task.id, task.at, seconds))

    def _refuse_orders(self, why: str) -> None:
        orders, self._orders = self._orders, {}
        for order in (order for waiting in orders.values() for order in waiting):
            self.outbox.order_result(order, False, why)

    def _name_tasks_that_came_too_late(self) -> None:
        """Say once which tasks reached us, but not the team before the end of the run."""
        left = [task for _, task in self.state.offered]
        if left and not self._named_late_tasks:
            self._named_late_tasks = True
            text = "the run ends before the team has %d tasks: %s"
            self.outbox.fault(text % (len(left), first_of(left)))

    def _proposed(self) -> Set[Tuple[str, str]]:
        entries = (own.item.entry for own in self.state.own_proposals.asking)
        return {(e.transition, e.id) for e in entries if isinstance(e, log_entries.Submit)}

    def _patience(self) -> float:
        """How long we leave a task to the first running member (s)."""
        return 2 * max(self.config.pace.takeover, 3 * self.state.delay)

    # -- time, and our own log ---------------------------------------------------------------------

    def wake_times(self) -> List[float]:
        """When to check again (s)."""
        times = []
        if self._watch is not None:
            time = self._watch.wake_time(self._visit())
            if time is not None:
                times.append(time)
        over = self.state.ledger.state.ended is not None or self.state.halted is not None
        if self.state.offered and self.state.active and not over:
            proposed = self._proposed()
            times += [
                since + self._patience()
                for key, (_, since) in self.state.offered.items()
                if key not in proposed
            ][:1]
        return times

    def recall(self, record: Record) -> None:
        """Take over a record of our own log: a received task, or a slot or snapshot showing that
        the team has it."""
        offered = self.state.offered
        if record["kind"] == "slot":
            for entry in record["entries"]:
                if entry.get("entry") == "submit":
                    offered.pop((entry["transition"], entry["id"]), None)
        elif record["kind"] == "snapshot":
            for transition, ids in record["state"].get("known", {}).items():
                for task in ids:
                    offered.pop((transition, task), None)
        else:
            task = log_entries.from_json(record["entry"])
            if isinstance(task, log_entries.Submit) and len(offered) < OFFERED_LIMIT:
                offered[task.transition, task.id] = (task, self.state.now)
