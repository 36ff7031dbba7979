"""LIVE without ROS: executes a plan of the served folder on threads, and records the run."""

from __future__ import annotations

import contextlib
import os
import re
import threading
import time
import uuid
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from gspn_framework_package.analysis.preflight.report import PreflightReport
from gspn_framework_package.analysis.preflight.while_running import CHECK_MARKINGS, why_refused
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.breakpoints import BreakpointFile, Breakpoints
from gspn_framework_package.execution.event_log import header
from gspn_framework_package.execution.firing import Firing
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.standalone import Listener, StandaloneExecutor
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.model.errors import ExecutionError, GspnError, LogError, RefusedError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.deploy_team import DeployOutcome, Votes
from gspn_framework_package.team.orders import ORDERS, PAGE
from gspn_framework_package.team.verdict import obey, verdict
from gspn_framework_package.visualizer.activity import Activity, Handler, RequestFields
from gspn_framework_package.visualizer.board import Event, note_event
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.feedback import FeedbackStream
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.live_comparison import LiveComparison
from gspn_framework_package.visualizer.run_marks import RunMark
from gspn_framework_package.visualizer.team_events import TeamEvents

RUNS = "runs"
"""The subfolder of the served folder for recorded runs."""

SERVER = "this server"
"""The voter on a new plan in a standalone run."""

STOP_SECONDS = 5.0
"""Seconds that a run has to obey an order to stop before it is abandoned."""

LAST_SECONDS = 2.0
"""The same while the page's server shuts down."""

ANSWERS = {
    "pause": "{whom} is paused",
    "resume": "{whom} is resumed",
    "retry": "{whom} tries again",
    "leave": "{whom} leaves",
    "set_place": "{whom} is now in {place}",
    "fire": "{transition} is fired",
    "submit": "task {id} enters by {transition}",
    "cancel": "task {id} is cancelled",
    "give_back": "task {id} is given back",
    "prioritise": "task {id} has priority {priority}",
}
"""The orders that become an entry of the log -> the answer to the page."""


class StandaloneRun(Activity, Listener):
    """An execution of a plan.

    :param document: the plan; it is checked first.
    :param runs: folder for the event log, None for no recording.
    :raises RefusedError: the check refuses the plan.
    :raises PlanError: it cannot run standalone.
    """

    mode = "LIVE"

    def __init__(self, document: Document, runs: Optional[str] = None) -> None:
        super().__init__()
        plan = document.plan
        assert plan is not None
        obey(verdict(plan, standalone=True), plan)
        self._plan = plan
        self._executor = StandaloneExecutor(plan, self)
        self._breakpoints = self._executor.breakpoint_file = BreakpointFile(plan)
        self.run = _run_name(plan)
        self.path: Optional[str] = None
        self._log: Optional[EventLogWriter] = None
        self._mark: Optional[RunMark] = None
        self._comparison: Optional[LiveComparison] = None
        self._title = document.title
        if runs is not None:
            self._record(runs)
        self._events = TeamEvents(self._executor.game)
        self._over = threading.Lock()
        self._reported_end = False
        self._changed_plan = False
        self.commands = {
            "stop": self._stop,
            "breakpoints": self._set_breakpoints,
            **{command: self._order(command, says) for command, says in ANSWERS.items()},
        }

    def plan_of(self, number: int) -> Optional[Plan]:
        """See :class:`Activity`."""
        return self._events.plans.get(number)

    def deploy(
        self, plan: Plan, mapping: Mapping[str, str], tell: Callable[[Votes], None]
    ) -> DeployOutcome:
        """See :class:`Activity`."""
        if self._reported_end:
            raise RefusedError("the run is over")
        agents = not self._plan.keeps_robots
        obey(self.verdict(plan), plan)
        tell({SERVER: None})
        try:
            self._executor.deploy(plan, mapping, check=lambda here: why_refused(here, agents))
        except GspnError as error:
            return DeployOutcome(False, str(error), votes={SERVER: str(error)})
        return DeployOutcome(True, "the run follows the plan '%s'" % plan.name, votes={SERVER: ""})

    def verdict(self, plan: Plan) -> PreflightReport:
        """See :class:`Activity`."""
        return verdict(plan, standalone=not self._plan.keeps_robots, limit=CHECK_MARKINGS)

    def _record(self, runs: str) -> None:
        """Begin an event log: a new file, named after the run."""
        self.run, self.path = _new_file(runs, self.run)
        first = header(self._plan, self.run, "", uuid.uuid4().hex, agents=True)
        try:
            self._log = EventLogWriter(self.path, first, fsync=self._plan.fsync)
            self._mark = RunMark(self.path, self._title)
        except LogError as error:
            self._close_log()
            with contextlib.suppress(OSError):
                os.remove(self.path)
            raise ExecutionError(
                "the run cannot be recorded: %s" % error.message,
                hint="free some space, or record somewhere else ('gspn serve --record FOLDER')",
            ) from None
        self._executor.record_to(self._log)

    @property
    def log(self) -> Optional[str]:
        """See :class:`Activity`."""
        return self.path

    @property
    def running(self) -> bool:
        """Whether the plan is being executed."""
        return not self._reported_end

    def begin(self, hub: Hub) -> None:
        """Start the run."""
        self._hub = hub
        self._feedback = FeedbackStream(hub)
        info: Dict[str, Any] = {
            "commands": sorted([*self.commands, "deploy"]),
            "says": "%s runs on this server" % self._plan.name,
        }
        if self.path is not None:
            whole = os.path.abspath(self.path).split(os.sep)
            info["log"] = os.path.join(*whole[-2:])  # viewers need not know this machine's folders
        hub.restart(self.mode, self._events.board(running=True, run=self.run), info)
        self._comparison = LiveComparison(self._plan, hub, complete=True)
        self._executor.start()

    def end(self) -> None:
        """Stop the run, and wait briefly for its end."""
        self._stop_it("the page was closed", LAST_SECONDS)
        if self._comparison is not None:
            self._comparison.end()

    def _stop(self, fields: RequestFields) -> Dict[str, Any]:
        """End the run; it is over when this returns."""
        if self._reported_end:
            raise RefusedError("the run is over")
        reason = ORDERS["stop"].values(fields, PAGE)["reason"]
        self._stop_it(reason, STOP_SECONDS)
        return {"message": "the run is over"}

    def _stop_it(self, reason: str, seconds: float) -> None:
        self._executor.stop(reason)
        with contextlib.suppress(ExecutionError):  # the page already shows it
            self._executor.wait(seconds)
        if not self._executor.over:
            text = "it did not react to the order to stop (%s) within %g s and was abandoned"
            self._gave_way(text % (reason, seconds))

    def _order(self, command: str, answer: str) -> Handler:
        """The handler of an order that becomes an entry of the log; ``answer`` is filled in with
        the fields of the order."""

        def run(fields: RequestFields) -> Dict[str, Any]:
            if self._reported_end:
                raise RefusedError("the run is over")
            kind = ORDERS[command]
            values = kind.values(fields, PAGE, self._plan)
            self._look_at(command, values)
            assert kind.entry is not None
            self._executor.order(kind.entry(**values))
            return {"message": answer.format(**values, whom=values.get("robot") or "the team")}

        return run

    def _look_at(self, command: str, values: Mapping[str, Any]) -> None:
        """Refuse an order. :raises RefusedError: the order is not possible at present."""
        name = values.get("robot", "")
        robot = self._executor.state.robots.get(name)
        if name and (robot is None or robot.phase.gone):
            raise RefusedError("there is no agent '%s' in the run" % name[:80])
        if command == "retry" and robot is not None and robot.phase is not Phase.FAILED:
            raise RefusedError("the action of %s has not failed" % name)
        why, about = "", values.get("id") if command != "submit" else values["replace"]
        if about is not None and about != "":
            why = self._executor.state.why_not_one_task(str(about))
        if not why and command == "give_back":
            team, game = self._executor.state, self._executor.game
            why = game.why_not_given_back(team, team.tasks_with(str(about))[0])
        if command == "submit" and (values["until"] or values["at"]):
            why = "a run on this server takes no task with a time to come in or a time limit"
        if command == "submit" and values["to"] and not why:
            why = self._executor.game.why_not_to(values["transition"])
            if values["to"] not in self._executor.state.robots:
                why = "there is no agent '%s' in the run" % values["to"][:80]
        if why:
            raise RefusedError(why)
        if values.get("place") in self._plan.resource_places:
            raise RefusedError("'%s' is a resource place: no agent can be in it" % values["place"])

    def _set_breakpoints(self, fields: RequestFields) -> Dict[str, Any]:
        names = ORDERS["breakpoints"].values(fields, PAGE)["names"]
        found = Breakpoints.of_names(names, self._plan)
        try:
            self._breakpoints.write(found)
        finally:
            self._show_breakpoints()
        return {"message": "agents stop at: %s" % found.in_words}

    def _show_breakpoints(self) -> None:
        """Show on the page where agents stop."""
        names = [*self._breakpoints.breakpoints.places, *self._breakpoints.breakpoints.transitions]
        if self._hub.info.get("breakpoints", []) != names:
            self._hub.change_info(breakpoints=names)

    # -- events of the executor --------------------------------------------------------------------

    def on_plan(self, plan: Plan) -> None:
        """Continue under another plan, on the executor's thread; the events of its step follow."""
        self._plan = plan
        self._breakpoints.follow(plan)
        self._changed_plan = True

    def on_step(
        self,
        slot: int,
        entries: Sequence[log_entries.Entry],
        firings: Sequence[Firing],
        state: TeamState,
    ) -> None:
        """Publish the events of a step, on the executor's thread."""
        if self._reported_end:
            return  # this run was abandoned and no longer owns the hub
        self._hub.publish(*self._events.step(entries, firings, state))
        if self._changed_plan:
            self._changed_plan = False
            self._hub.change_info(says="%s runs on this server" % self._plan.name)
            if self._comparison is not None:
                self._comparison = self._comparison.go_on(self._plan)
        self._show_breakpoints()
        for entry in entries:
            if isinstance(entry, (log_entries.Done, log_entries.Failed)):
                self._feedback.forget(entry.robot)

    def on_feedback(self, agent: str, visit: int, progress: Tuple[Any, ...]) -> None:
        """Process feedback, on the action's thread."""
        if not self._reported_end:
            self._feedback.show(agent, "feedback: %s" % ", ".join(str(p) for p in progress))

    def on_fault(self, agent: str, message: str) -> None:
        """Publish a fault, on the executor's thread."""
        if not self._reported_end:
            self._hub.publish(note_event("fault", message, agent))

    def on_end(self, reason: str, finished: bool) -> None:
        """Publish the end of the run, on the executor's thread."""
        self._ended(reason, finished, self._executor.state.fault)
        self._close_log()

    def on_broken(self, reason: str) -> None:
        """Publish a failure of the run, on the executor's thread."""
        if self.path is not None:
            reason = reason.replace(self.path, os.path.basename(self.path))
        self._gave_way(reason)
        self._close_log()

    def _gave_way(self, reason: str) -> None:
        """End the run by a fault that has not been reported yet."""
        if not self._reported_end:
            self._hub.publish(note_event("fault", reason))
        self._ended(reason, fault=True)

    def _ended(self, reason: str, finished: bool = False, fault: bool = False) -> None:
        """Publish the end, once."""
        with self._over:
            if self._reported_end:
                return
            self._reported_end = True
        events: List[Event] = self._events.status(
            running=False, ended=reason, finished=finished, stalled="", fault=fault
        )
        self._hub.publish(*events)

    def _close_log(self) -> None:
        if self._log is not None:
            self._log.close()
        if self._mark is not None:
            self._mark.remove()


def _run_name(plan: Plan) -> str:
    """A name composed of the plan's name and the time."""
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", plan.name).strip("_") or "plan"
    return "%s-%s" % (name, time.strftime("%Y%m%d-%H%M%S"))


def _new_file(runs: str, stem: str) -> Tuple[str, str]:
    """A name like ``stem`` that no log in ``runs`` has, and the path of its log."""
    run, number = stem, 2
    while os.path.exists(os.path.join(runs, run + ".jsonl")):
        run, number = "%s-%d" % (stem, number), number + 1
    return run, os.path.join(runs, run + ".jsonl")
