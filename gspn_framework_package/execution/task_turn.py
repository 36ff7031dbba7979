"""The effects of log entries on tasks: tasks are submitted, returned to their queues, cancelled
and put before others."""

from __future__ import annotations

from typing import List, Optional

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.firing import Fault
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_state import OUTSIDE_LIMIT, RobotState
from gspn_framework_package.execution.team_tasks import (
    TASK_CANCELLED,
    TASK_LATE,
    FoundTask,
    Task,
    queued,
)
from gspn_framework_package.execution.turn import Turn
from gspn_framework_package.model.event import BY_ARRIVAL

KNOWN_TASKS = 10_000
"""Number of task ids remembered for each transition; older ids count as new."""


class TaskTurn(Turn):
    """A turn with the effects of the entries about tasks."""

    _entry: Optional[log_entries.Entry] = None
    """The entry that is being applied."""

    def _refuse(self, message: str, robot: Optional[RobotState] = None) -> None:
        """Say why the entry has no effect."""
        name = robot.name if robot is not None else ""
        self.commands.append(Fault(name, message, void=self._entry))

    # -- tasks that come in ------------------------------------------------------------------------

    def _submit(self, entry: log_entries.Submit) -> None:
        t = self.net.transition_index.get(entry.transition)
        if t not in self.rules.submissions:
            text = "task %s is refused: '%s' does not take tasks"
            self._refuse(text % (entry.id, entry.transition))
            return
        assert t is not None
        carrier = self.state.gone_with(t, entry.id) if entry.again else None
        if self.state.is_known(t, entry.id) and carrier is None:
            return
        if self.state.is_full(t):
            text = "%d tasks are already waiting for '%s'; '%s' is refused"
            self._refuse(text % (OUTSIDE_LIMIT, entry.transition, entry.id))
            return
        if self._replaces(entry):
            task = Task(entry.id, entry.data, entry.priority, entry.since, 0, entry.until, entry.to)
            task = task._replace(at=entry.at, every=entry.every)
            self._wait_outside(t, task)
        known = self.state.known.setdefault(t, {})
        if carrier is not None:
            carrier.task = None
            del known[entry.id]
        known[entry.id] = None
        if len(known) > KNOWN_TASKS:  # ids of waiting tasks are not forgotten
            waiting = {task.id for other, task in self.state.submitted if other == t}
            done = [name for name in known if name not in waiting]
            for name in done[: len(known) - KNOWN_TASKS]:
                del known[name]

    def _replaces(self, entry: log_entries.Submit) -> bool:
        """Cancel the task that another one replaces; False if that has ended, so that the other is
        not taken."""
        if not entry.replaces:
            return True
        there = self.state.tasks_with(entry.replaces)
        if len(there) == 1:
            self._cancel_task(there[0], "replaced by %s; " % entry.id)
            return True
        why = "it was to replace %s, which was not found" % entry.replaces
        self._end_task(Task(entry.id), TASK_CANCELLED, why)
        return False

    def _wait_outside(self, t: int, task: Task) -> None:
        """Let a task wait outside the net until ``t`` is enabled."""
        waiting = self.state.submitted
        at = len(waiting)
        while at and waiting[at - 1][1].priority < task.priority:
            at -= 1
        waiting.insert(at, (t, task))

    def _task_due(self, entry: log_entries.TaskDue) -> None:
        """Submit a task whose time has come, or another one like it."""
        there = self.state.tasks_with(entry.id)
        if len(there) != 1 or there[0].before is None or there[0].task.at != entry.at:
            return
        found, t = there[0], there[0].before
        self._take_out(found)
        task = found.task
        if not task.every:
            self._wait_outside(t, task._replace(at=0))
            return
        missed = max(0, entry.now - entry.at) // task.every
        later = task._replace(at=task.at + (missed + 1) * task.every, attempts=task.attempts + 1)
        self._wait_outside(t, later)
        name = "%s-%d" % (task.id, later.attempts)
        if not self.state.is_known(t, name):
            one = Task(name, task.data, task.priority, entry.now, to=task.to)
            self._wait_outside(t, one)
            self.state.known.setdefault(t, {})[name] = None

    # -- orders about tasks ------------------------------------------------------------------------

    def _about_task(self, entry: log_entries.TaskOrder) -> None:
        """Carry out an order about a task."""
        there = self.state.tasks_with(entry.id)
        if len(there) != 1:
            return  # it has ended since, or nobody can know which is meant
        if isinstance(entry, log_entries.GiveBack):
            self._give_task_back(there[0])
        elif isinstance(entry, log_entries.PrioritiseTask):
            self._prioritise(there[0], entry.priority)
        elif not entry.late:
            self._cancel_task(there[0])
        elif not there[0].robot:
            self._cancel_task(there[0], "it waited too long; ", TASK_LATE)

    def _cancel_task(self, found: FoundTask, why: str = "", outcome: str = TASK_CANCELLED) -> None:
        state, task, where = self.state, found.task, found.where(self.net)
        robot = state.robots.get(found.robot)
        if robot is not None:
            robot.task = None
            if not robot.phase.gone:
                where += " in " + self._name(robot.place)
                self._goes_on_without(robot, "its task %s was cancelled" % task.id)
        else:
            self._take_out(found)
            if found.place is not None:
                marking = list(state.marking)
                marking[found.place] -= 1
                state.set_marking(tuple(marking))
        self._end_task(task, outcome, why + where, found.robot)

    def _give_task_back(self, found: FoundTask) -> None:
        why = self.rules.why_not_given_back(self.state, found)
        if why:
            self._refuse("task %s was not given back: %s" % (found.task.id, why))
            return
        robot = self.state.robots[found.robot]
        marking = list(self.state.marking)
        self._give_back(robot, marking, only_tasks=True)
        self.state.set_marking(tuple(marking))
        self._goes_on_without(robot, "its task %s was given back" % found.task.id)

    def _take_out(self, found: FoundTask) -> None:
        """Remove a task from those that wait."""
        state = self.state
        if found.place is not None:
            queue = state.queues[found.place]
            state.queues[found.place] = [task for task in queue if task.id != found.task.id]
        else:
            state.submitted = [item for item in state.submitted if item[1].id != found.task.id]

    def _change(self, found: FoundTask, task: Task) -> None:
        """Replace a task of a queue where it is."""
        assert found.place is not None
        queue = self.state.queues[found.place]
        self.state.queues[found.place] = [task if t.id == task.id else t for t in queue]

    def _prioritise(self, found: FoundTask, priority: int) -> None:
        task = found.task._replace(priority=priority)
        robot = self.state.robots.get(found.robot)
        if robot is not None:
            robot.task = task
            return
        order = "" if found.place is None else self.rules.queue_orders[found.place]
        if order == BY_ARRIVAL:
            self._change(found, task)
            return
        self._take_out(found)
        if found.place is not None:
            queue = self.state.queues[found.place]
            self.state.queues[found.place] = queued(queue, task, order)
        elif found.before is not None:
            self._wait_outside(found.before, task)

    def _goes_on_without(self, robot: RobotState, why: str) -> None:
        """Have a robot that has lost its task continue as the plan says; if the plan says nothing,
        it waits for the operator."""
        if robot.phase is Phase.INACTIVE:
            return
        if robot.place in self.rules.on_cancel and self.rules.on_cancel[robot.place] is None:
            return
        self._cancel(robot)
        self.state.remove_waiting(robot)
        t: Optional[int] = self.rules.on_cancel.get(robot.place)
        if t is not None:
            self._ask(robot, t)
            return
        robot.phase, robot.why = Phase.FAILED, why
        text = "%s; it waits in %s for the operator, because tasks.on_cancel says nothing"
        self._fault(robot, text % (why, self._name(robot.place)))

    # -- tasks that return to their queues ---------------------------------------------------------

    def _put_down(self, robot: RobotState, place: int, marking: List[int]) -> None:
        """Return the task of a robot that is moved to a place where robots carry none."""
        if robot.task is None or self.rules.queue_from(place):
            return
        if self.rules.queue_from(robot.place):
            self._give_back(robot, marking, only_tasks=True)
        elif robot.task.id:
            text = "keeps task %s in %s, because %s returns it to no queue (on_evict)"
            self._fault_of_task(
                robot, text % (robot.task.id, self._name(place), self._name(robot.place))
            )

    def _give_back(self, robot: RobotState, marking: List[int], only_tasks: bool = False) -> None:
        for resource, count in self.rules.gives_back(robot.place).items():
            p = self.net.place_number(resource)
            if p in self.rules.queues or not only_tasks:
                marking[p] += count
            if p not in self.rules.queues:
                continue
            # its task goes first, because it arrived before those still waiting
            queue = self.state.queues.get(p, [])
            for task in [*[Task()] * (count - 1), robot.task or Task()]:
                queue = queued(queue, task, self.rules.queue_orders[p], first=True)
            self.state.queues[p] = queue
            if robot.task is not None and robot.task.id:
                self._fault_of_task(robot, "returns task %s to %s" % (robot.task.id, resource))
            robot.task = None
