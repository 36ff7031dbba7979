"""Open nets: each has a scene, a hub, and one activity at a time."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any, Callable, Dict, List, Optional

from gspn_framework_package.model.errors import InputError, RefusedError, UsageError
from gspn_framework_package.visualizer.activity import Activity, RequestFields, text_field
from gspn_framework_package.visualizer.board import Board
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.layout import lay_out
from gspn_framework_package.visualizer.scene import boxes_of, layout_to_json, scene_to_json
from gspn_framework_package.visualizer.simulation import OfflineSimulation

SESSIONS = 24
"""Largest number of nets open at once; opening another one closes the least needed."""

ActivityMaker = Callable[[Document], Activity]


class Session:
    """An open net.

    :param key: its name in addresses.
    :param document: the net.
    :param activity: the initial activity; the simulation by default.
    :param start_execution: makes the execution of an executable plan; None if plans cannot be
        executed (a page that watches a ROS team).
    :param reopens: it comes from a file and can be reopened.
    """

    def __init__(
        self,
        key: str,
        document: Document,
        activity: Optional[Activity] = None,
        start_execution: Optional[ActivityMaker] = None,
        reopens: bool = False,
    ) -> None:
        self.key = key
        self.document = document
        self.scene = scene_to_json(document.net, document.plan)
        self.hub = Hub("", Board(len(document.net.transitions), document.net.initial_marking))
        self.reopens = reopens
        self.touched = False
        """Whether it has received a command."""
        self.outdated = False
        """Whether its file has been saved since it was opened."""
        self._lock = threading.RLock()
        self._layout = threading.Lock()
        self._starting = False
        self._start_execution = start_execution
        self._home = activity
        self.activity: Activity = activity or OfflineSimulation(document.net)
        self.activity.begin(self.hub)

    def document_at(self, plan: int) -> Document:
        """The net of the plan with this number, which the run shown has followed.

        :raises InputError: there is no such plan, perhaps because another run is shown now.
        """
        if not plan:
            return self.document
        found = self.activity.plan_of(plan)
        if found is None:
            raise InputError("the run shown has not followed a plan with the number %d" % plan)
        return self.document._replace(
            net=found.net, plan=found, executable=False, notes=tuple(found.notes)
        )

    def scene_at(self, plan: int) -> Dict[str, Any]:
        """The scene of that net. :raises InputError: as :meth:`document_at`."""
        document = self.document_at(plan)
        return scene_to_json(document.net, document.plan) if plan else self.scene

    @property
    def executable(self) -> bool:
        """Whether the page may start an execution."""
        return self.document.executable and self._start_execution is not None

    def to_json(self) -> Dict[str, Any]:
        """The data that the page loads once."""
        return {
            "id": self.key,
            "title": self.document.title,
            "executable": self.executable,
            "simulable": self._home is None,
            "saves": bool(self.document.file),
            "notes": list(self.document.notes),
            "meanings": dict(self.document.meanings),
            "scene": self.scene,
        }

    def command(self, name: str, fields: RequestFields) -> Dict[str, Any]:
        """Execute a command of the page: start or end an execution, or a command of the activity.

        An order for a run names it in the field ``run``; it is refused if another run has replaced
        that run. Long operations (a layout, the check before a start) do not block other commands.

        :raises GspnError: the command cannot be executed; the message gives the reason.
        """
        if name == "layout":
            return self._lay_out()
        self.touched = True
        if name == "start":
            return self._start(fields)
        if name == "simulate":
            return self._simulate()
        return self.activity_meant(fields).command(name, fields)

    def activity_meant(self, fields: RequestFields) -> Activity:
        """The activity for which an order is meant.

        :raises RefusedError: the order names another run than the one that is shown.
        """
        meant = text_field(fields, "run", "")
        with self._lock:
            shown = str(self.hub.status().get("run") or "")
            if meant not in ("", shown):
                raise RefusedError(
                    "the order is for run '%s'; %s: nothing was done"
                    % (
                        meant,
                        "the page shows run '%s'" % shown if shown else "the page shows no run",
                    )
                )
            return self.activity

    def _lay_out(self) -> Dict[str, Any]:
        if not self._layout.acquire(blocking=False):
            raise RefusedError("it is being laid out already", hint="wait for that")
        try:
            net = self.document.net
            return layout_to_json(net, lay_out(net, **boxes_of(self.document.plan), anew=True))
        finally:
            self._layout.release()

    def _start(self, fields: RequestFields) -> Dict[str, Any]:
        if not self.document.executable:
            raise RefusedError(
                "this net can be simulated, not executed",
                hint="only plans of the folder that 'gspn serve' was started on are executed",
            )
        if self.outdated:
            raise RefusedError("the plan was saved since it was opened here", hint="open it again")
        if self._start_execution is None:
            raise RefusedError("plans cannot be executed here")
        if fields.get("confirmed") is not True:
            raise UsageError("starting an execution needs a confirmation")
        with self._lock:
            if self._starting or self._is_running():
                raise RefusedError("it is already running")
            self._starting = True
        try:
            execution = self._start_execution(self.document)
            with self._lock:
                self._switch(execution)
        finally:
            self._starting = False
        return {}

    def _simulate(self) -> Dict[str, Any]:
        if self._home is not None:
            raise RefusedError("there is nothing to simulate here")
        simulation = OfflineSimulation(self.document.net)
        with self._lock:
            if self._starting or self._is_running():
                raise RefusedError("it is being executed", hint="stop the execution first")
            self._switch(simulation)
        return {}

    def _is_running(self) -> bool:
        running = self.activity.running
        return bool(self.hub.status().get("running")) if running is None else running

    def _switch(self, activity: Activity) -> None:
        old, self.activity = self.activity, activity
        old.end()
        activity.begin(self.hub)

    @property
    def loss(self) -> Optional[int]:
        """How much would be lost by closing it, from 0 (nothing: an unchanged file) to 3 (changed,
        and with a viewer); None if it must not be closed because it is running."""
        with self._lock:
            if self._starting or self._is_running():
                return None
        worked_on = self.touched or not self.reopens
        return 2 * int(self.hub.viewers > 0) + int(worked_on)

    def close(self, why: str = "the server is stopping") -> None:
        """End the activity, and notify the viewers."""
        with self._lock:
            self.activity.end()
        self.hub.close(why)


class Sessions:
    """The open nets of one server, by key."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sessions: OrderedDict[str, Session] = OrderedDict()

    def get(self, key: str) -> Session:
        """The session of that key. :raises InputError: no open session has it."""
        found = self.known(key)
        if found is None:
            raise InputError("this net is not open (any more)", element=key[:80])
        return found

    def known(self, key: str) -> Optional[Session]:
        """The session of that key; None if there is none."""
        with self._lock:
            if key in self._sessions:
                self._sessions.move_to_end(key)
            return self._sessions.get(key)

    def all(self) -> List[Session]:
        """All open sessions."""
        with self._lock:
            return list(self._sessions.values())

    def drop(self, session: Session, why: str) -> None:
        """Close a session and send its viewers the reason."""
        with self._lock:
            if self._sessions.get(session.key) is not session:
                return
            del self._sessions[session.key]
        session.close(why)

    def get_or_open(self, key: str, make: Callable[[], Session], room: bool = True) -> Session:
        """The session of that key, created if there is none.

        :param make: makes the session.
        :param room: whether to close the least needed session if too many are open, rather than
            refuse.
        :raises RefusedError: there is no room for it.
        """
        with self._lock:
            if key in self._sessions:
                self._sessions.move_to_end(key)
                return self._sessions[key]
            self._check_room(room)
        session = make()
        closed: List[Session] = []
        try:
            with self._lock:
                if key not in self._sessions:
                    self._check_room(room)
                    self._sessions[key] = session
                    closed = self._surplus(key)
                known = self._sessions[key]
        except RefusedError:
            session.close()
            raise
        for old in closed + ([session] if known is not session else []):
            old.close("it was closed on the server to make room for another net")
        return known

    def _check_room(self, room: bool) -> None:
        full = len(self._sessions) >= SESSIONS
        if full and not room:
            raise RefusedError(
                "%d nets are open already" % SESSIONS, hint="open it from the list of files"
            )
        if full and all(session.loss is None for session in self._sessions.values()):
            raise RefusedError(
                "%d plans are being executed already" % SESSIONS, hint="stop one of them"
            )

    def _surplus(self, new: str) -> List[Session]:
        """The sessions to close for a new one: first those with the smallest loss, and of these the
        least recently used."""
        closed: List[Session] = []
        while len(self._sessions) > SESSIONS:
            known = [(s.loss, key) for key, s in self._sessions.items() if key != new]
            losses = [(loss, key) for loss, key in known if loss is not None]
            if not losses:
                break
            closed.append(self._sessions.pop(min(losses, key=lambda item: item[0])[1]))
        return closed

    def close(self) -> None:
        """Close all sessions."""
        with self._lock:
            sessions = list(self._sessions.values())
            self._sessions.clear()
        for session in sessions:
            session.close()
