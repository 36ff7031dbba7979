"""LIVE without ROS: the page executes a plan of the served folder on threads, and records it."""

from __future__ import annotations

import os
import re
import time
import uuid
from typing import Any, Dict, List, Optional, Sequence, Tuple

from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.execution import entries as log
from gspn_framework_package.execution.event_log import EventLogWriter, header
from gspn_framework_package.execution.firing import Firing
from gspn_framework_package.execution.standalone import Listener, StandaloneExecutor
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.visualizer.activity import Activity, Fields, text_field
from gspn_framework_package.visualizer.board import Event
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.feedback import Feedback
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.team_events import TeamEvents

RUNS = "runs"
"""The folder, in the served one, that recorded runs are kept in."""


class StandaloneRun(Activity, Listener):
    """One execution of a plan.

    :param document: the plan; it is checked first.
    :param runs: folder for the event log, None for no recording.
    :raises RefusedError: the check refuses the plan. :raises PlanError: it cannot run standalone.
    """

    mode = "LIVE"

    def __init__(self, document: Document, runs: Optional[str] = None) -> None:
        super().__init__()
        plan = document.plan
        assert plan is not None
        report = check(plan, standalone=True)
        if report.refused:
            raise RefusedError("the check refuses this plan: %s" % " ".join(str(report).split()))
        self.path = _log_path(runs, plan) if runs is not None else None
        writer = None
        if self.path is not None:
            run = os.path.basename(self.path)[: -len(".jsonl")]
            writer = EventLogWriter(self.path, header(plan, run, "", uuid.uuid4().hex, agents=True))
        self._plan = plan
        self._executor = StandaloneExecutor(plan, self, writer)
        self._events = TeamEvents(self._executor.game)
        self._visits: Dict[str, int] = {}
        self.commands = {
            "stop": self._order(lambda fields: log.Stop("stopped on the page")),
            "pause": self._order(lambda fields: log.Pause("")),
            "resume": self._order(lambda fields: log.Resume("")),
            "retry": self._order(lambda fields: log.Retry(text_field(fields, "robot"))),
            "fire": self._order(lambda fields: log.Fire(self._transition(fields))),
        }

    def begin(self, hub: Hub) -> None:
        """Start the run."""
        self._hub = hub
        self._feedback = Feedback(hub)
        info: Dict[str, Any] = {
            "commands": sorted(self.commands),
            "says": "%s runs on this server" % self._plan.name,
        }
        if self.path is not None:
            info["log"] = self.path
        hub.restart(self.mode, self._events.board(running=True), info)
        self._executor.start()

    def end(self) -> None:
        """Stop the run, and wait a moment for its end."""
        self._executor.stop("the page was closed")
        self._executor.wait(2.0)

    def _order(self, entry: Any) -> Any:
        def run(fields: Fields) -> Dict[str, Any]:
            if self._executor.result is not None:
                raise RefusedError("the run is over")
            self._executor.order(entry(fields))
            return {}

        return run

    def _transition(self, fields: Fields) -> str:
        name = text_field(fields, "transition")
        self._plan.net.transition_number(name)
        return name

    # -- what the executor tells -------------------------------------------------------------------

    def on_step(
        self,
        slot: int,
        entries: Sequence[log.Entry],
        firings: Sequence[Firing],
        state: TeamState,
    ) -> None:
        """On the executor's thread: events for the hub."""
        self._hub.publish(*self._events.step(entries, firings, state))
        for entry in entries:
            if isinstance(entry, (log.Done, log.Failed)):
                self._feedback.forget(entry.robot)

    def on_feedback(self, agent: str, visit: int, progress: Tuple[Any, ...]) -> None:
        """On the action's thread."""
        self._feedback.tell(agent, "feedback: %s" % ", ".join(str(p) for p in progress))

    def on_fault(self, agent: str, message: str) -> None:
        """On the executor's thread."""
        self._hub.publish({"k": "note", "level": "fault", "robot": agent, "text": message})

    def on_end(self, reason: str, finished: bool) -> None:
        """On the executor's thread."""
        events: List[Event] = self._events.status(
            running=False, ended=reason, finished=finished, stalled=""
        )
        self._hub.publish(*events)


def _log_path(runs: str, plan: Plan) -> str:
    """A new file, named after the plan and the time."""
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", plan.name).strip("_") or "plan"
    stem = "%s-%s" % (name, time.strftime("%Y%m%d-%H%M%S"))
    path = os.path.join(runs, stem + ".jsonl")
    number = 2
    while os.path.exists(path):
        path = os.path.join(runs, "%s-%d.jsonl" % (stem, number))
        number += 1
    return path
