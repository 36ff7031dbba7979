"""Open nets: each has a scene, a hub, and one activity at a time."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any, Callable, Dict, List, Optional

from gspn_framework_package.model.errors import InputError, RefusedError, UsageError
from gspn_framework_package.visualizer.activity import Activity, Fields, text_field
from gspn_framework_package.visualizer.board import Board
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.layout import lay_out
from gspn_framework_package.visualizer.scene import layout_to_json, scene_to_json
from gspn_framework_package.visualizer.simulation import Simulation

SESSIONS = 24
"""How many nets are open at once; the one that was used least recently, and runs nothing, is
closed."""

ActivityMaker = Callable[[Document], Activity]


class Session:
    """An open net.

    :param key: its name in addresses.
    :param document: the net.
    :param activity: what goes on at first; the simulation by default.
    :param start_execution: makes the execution of an executable plan; None where plans cannot be
        executed (a page that watches a ROS team).
    """

    def __init__(
        self,
        key: str,
        document: Document,
        activity: Optional[Activity] = None,
        start_execution: Optional[ActivityMaker] = None,
    ) -> None:
        self.key = key
        self.document = document
        self.scene = scene_to_json(document.net, document.plan)
        self.hub = Hub("", Board(len(document.net.transitions), document.net.initial_marking))
        self._lock = threading.RLock()
        self._start_execution = start_execution
        self._home = activity
        self.activity: Activity = activity or Simulation(document.net)
        self.activity.begin(self.hub)

    @property
    def executable(self) -> bool:
        """Whether the page may start an execution."""
        return self.document.executable and self._start_execution is not None

    def to_json(self) -> Dict[str, Any]:
        """What the page needs to know once."""
        return {
            "id": self.key,
            "title": self.document.title,
            "executable": self.executable,
            "simulable": self._home is None,
            "notes": list(self.document.notes),
            "scene": self.scene,
        }

    def command(self, name: str, fields: Fields) -> Dict[str, Any]:
        """Do what the page asks: start and stop of an execution, and what the activity offers.

        An order for a run names it in the field ``run``: one that another run has taken the place of gets no orders.

        :raises GspnError: it cannot be done, and why.
        """
        meant = text_field(fields, "run", "")
        with self._lock:
            if name == "start":
                return self._start(fields)
            if name == "simulate":
                return self._simulate()
            if name == "layout":
                return layout_to_json(self.document.net, lay_out(self.document.net, anew=True))
            shown = str(self.hub.board().status.get("run") or "")
            if meant not in ("", shown):
                raise RefusedError(
                    "the order is for run '%s'; %s: nothing was done"
                    % (meant, "the page shows run '%s'" % shown if shown else "the page shows no run")
                )
            activity = self.activity
        return activity.command(name, fields)

    def _start(self, fields: Fields) -> Dict[str, Any]:
        if not self.document.executable:
            raise RefusedError(
                "this net can be simulated, not executed",
                hint="only plans of the folder that 'gspn serve' was started on are executed",
            )
        if self._start_execution is None:
            raise RefusedError("plans are not executed from here")
        if fields.get("confirmed") is not True:
            raise UsageError("starting an execution asks for a confirmation")
        if self._is_running():
            raise RefusedError("it is running already")
        self._switch(self._start_execution(self.document))
        return {}

    def _simulate(self) -> Dict[str, Any]:
        if self._home is not None:
            raise RefusedError("there is nothing to simulate here")
        if self._is_running():
            raise RefusedError("it is being executed", hint="stop the execution first")
        self._switch(Simulation(self.document.net))
        return {}

    def _is_running(self) -> bool:
        return bool(self.hub.board().status.get("running"))

    def _switch(self, activity: Activity) -> None:
        old, self.activity = self.activity, activity
        old.end()
        activity.begin(self.hub)

    @property
    def idle(self) -> bool:
        """Whether it may be closed without anybody losing more than a simulation."""
        return not self._is_running()

    def close(self) -> None:
        """End whatever goes on."""
        with self._lock:
            self.activity.end()
        self.hub.close()


class Sessions:
    """The open nets of one server, by key."""

    def __init__(self, limit: int = SESSIONS) -> None:
        self._lock = threading.Lock()
        self._limit = limit
        self._sessions: OrderedDict[str, Session] = OrderedDict()

    def get(self, key: str) -> Session:
        """The session of that key. :raises InputError: there is none (any more)."""
        with self._lock:
            if key not in self._sessions:
                raise InputError("this net is not open (any more)", element=key[:80])
            self._sessions.move_to_end(key)
            return self._sessions[key]

    def get_or_open(self, key: str, make: Callable[[], Session]) -> Session:
        """The session of that key, made if there is none."""
        with self._lock:
            if key in self._sessions:
                self._sessions.move_to_end(key)
                return self._sessions[key]
        session = make()
        with self._lock:
            known = self._sessions.setdefault(key, session)
            closed = self._surplus()
        for old in closed + ([session] if known is not session else []):
            old.close()
        return known

    def _surplus(self) -> List[Session]:
        closed = []
        for key in list(self._sessions)[:-1]:
            if len(self._sessions) <= self._limit:
                break
            if self._sessions[key].idle:
                closed.append(self._sessions.pop(key))
        return closed

    def close(self) -> None:
        """Close all."""
        with self._lock:
            sessions = list(self._sessions.values())
            self._sessions.clear()
        for session in sessions:
            session.close()
