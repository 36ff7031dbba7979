"""The content of one server: a folder of nets, plans and logs, or a single session."""

from __future__ import annotations

import os
import secrets
from typing import Any, Callable, Dict, Iterable, Optional

from gspn_framework_package.execution.phase import phases_to_json
from gspn_framework_package.model.errors import InputError, UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.robot_colours import PALETTE
from gspn_framework_package.team.orders import described
from gspn_framework_package.visualizer.activity import Activity
from gspn_framework_package.visualizer.bag_replay import BagReplay, plans_of
from gspn_framework_package.visualizer.documents import Document, Folder
from gspn_framework_package.visualizer.fleet_page import RUN_KEY, FleetPage
from gspn_framework_package.visualizer.replay import Replay
from gspn_framework_package.visualizer.run_marks import CutRun, cut_runs
from gspn_framework_package.visualizer.session import ActivityMaker, Session, Sessions

FILE_KEY = "file-"


def path_of_key(key: str) -> str:
    """The path of the file of a session. :raises UsageError: the session does not show a file."""
    if not key.startswith(FILE_KEY):
        raise UsageError("only files of the served folder can be edited")
    return key[len(FILE_KEY) :]


def project_of_team(path: str, plan: Plan, activity: Activity) -> Project:
    """A server that only shows a team.

    :param path: where its plan was read from; viewers only see the last part, since they need not
        know this machine's folders.
    :param plan: the plan, with its initial robots.
    :param activity: the activity that watches the team.
    """
    title = os.path.join(*os.path.abspath(path).split(os.sep)[-2:])
    document = Document(title, plan.net, plan, notes=tuple(plan.notes), file=plan.file or "")
    project = Project()
    project.show(Session("live", document, activity))
    return project


class Project:
    """The content of one server.

    :param folder: the served folder, None for a server that only shows one session.
    :param start_execution: starts the execution of an executable plan.
    :param first: path (in the folder) of the document that the page shows first.
    :param runs: the folder of the recorded runs, which is searched for runs that were cut off.
    :param edits: whether the operator may change the plans of the folder in the page.
    :param fleet: the fleet history that the page shows.
    """

    def __init__(
        self,
        folder: Optional[Folder] = None,
        start_execution: Optional[ActivityMaker] = None,
        first: Optional[str] = None,
        runs: Optional[str] = None,
        edits: bool = False,
        fleet: Optional[FleetPage] = None,
    ) -> None:
        self.sessions = Sessions()
        self.fleet = fleet
        self.edits = edits and folder is not None
        self._folder = folder
        self._start_execution = start_execution
        self._first = (
            FILE_KEY + folder.name(first) if first is not None and folder is not None else None
        )
        self._server = secrets.token_hex(8)
        self._runs = runs
        self._cut = cut_runs(runs) if runs is not None else []

    @property
    def folder(self) -> Optional[Folder]:
        """The served folder; None if there is none."""
        return self._folder

    def show(self, session: Session) -> None:
        """Make the page open with this session."""
        self._first = self.sessions.get_or_open(session.key, lambda: session).key

    def to_json(self) -> Dict[str, Any]:
        """The content of the opening screen. ``server`` distinguishes one start of a server from
        another; ``cut`` lists the runs that were cut off when an earlier server died."""
        entries = self._folder.entries() if self._folder is not None else []
        return {
            "server": self._server,
            "robot_colours": list(PALETTE),
            "phases": phases_to_json(),
            "orders": described(),
            "first": self._first,
            "can_open": self._folder is not None,
            "history": self.fleet is not None,
            "files": [entry._asdict() for entry in entries],
            "cut": [
                {"path": r.path, "log": self.path_of(r.log), "events": r.events} for r in self._cut
            ],
        }

    def path_of(self, file: str) -> Optional[str]:
        """The path of a file in the folder; None if it is outside the folder."""
        return self._folder.inside(file) if self._folder is not None else None

    def open(self, path: str, room: bool = True) -> Session:
        """The session of a file of the folder; one per file, however its path is written.

        :param room: see :meth:`~gspn_framework_package.visualizer.session.Sessions.get_or_open`.
        :raises GspnError: it cannot be opened.
        """
        if self._folder is None:
            raise InputError("no folder is served here")
        folder, name = self._folder, self._folder.name(path)
        self._drop_outdated(FILE_KEY + name)
        session = self.sessions.get_or_open(FILE_KEY + name, lambda: self._make(folder, name), room)
        self._take_note(lambda run: self.path_of(run.log) == name)
        return session

    def session(self, key: str, room: bool = False) -> Session:
        """The session of a key; one that shows a file is reopened if it is closed (after a restart
        of the server).

        :raises GspnError: no session has that key, or its file cannot be opened.
        """
        if key.startswith(FILE_KEY) and self._folder is not None:
            known = self.sessions.known(key)
            return known or self.open(key[len(FILE_KEY) :], room)
        fleet = self.fleet
        if key.startswith(RUN_KEY) and fleet is not None:
            return self.sessions.get_or_open(key, lambda: fleet.replay(key), room)
        return self.sessions.get(key)

    def renew(self, paths: Iterable[str]) -> None:
        """Close the sessions of saved files and of plans with subnets, so that they are read again.
        A plan being executed continues as it was started; its session is renewed when it is next
        opened after the run.

        :param paths: the files, relative to the folder.
        """
        keys = {FILE_KEY + path for path in paths}
        for session in self.sessions.all():
            plan = session.document.plan
            uses = session.key.startswith(FILE_KEY) and plan is not None and bool(plan.subnets)
            if session.key in keys or uses:
                session.outdated = True
                self._drop_outdated(session.key)

    def _drop_outdated(self, key: str) -> None:
        session = self.sessions.known(key)
        if session is not None and session.outdated and session.loss is not None:
            self.sessions.drop(session, "the plan was saved and is opened again")

    def without_folders(self, text: str) -> str:
        """A message without this machine's folders, which viewers need not know."""
        for folder in (self._folder.root if self._folder is not None else None, self._runs):
            if folder is not None and len(folder) > 1:
                text = text.replace(folder.rstrip(os.sep) + os.sep, "").replace(
                    folder, "the folder"
                )
        return text

    def _make(self, folder: Folder, path: str) -> Session:
        if folder.kind(path) == "log":
            return self._recorded(folder, path)
        document: Document = folder.open(path)
        start = self._execute if self._start_execution is not None else None
        return Session(FILE_KEY + path, document, start_execution=start, reopens=True)

    def _execute(self, document: Document) -> Activity:
        assert self._start_execution is not None
        execution = self._start_execution(document)
        self._take_note(lambda run: run.path == document.title)
        return execution

    def _take_note(self, which: Callable[[CutRun], bool]) -> None:
        """Drop the cut-off runs that a user has opened or whose plan is started again."""
        for run in [run for run in self._cut if which(run)]:
            run.forget()
            self._cut = [r for r in self._cut if r is not run]

    @staticmethod
    def _recorded(folder: Folder, path: str) -> Session:
        if path.endswith(".bag"):
            bag = BagReplay(folder.resolve(path), plans_of(folder))
            return Session(FILE_KEY + path, bag.document(path), bag, reopens=True)
        replay = Replay(folder.resolve(path))
        return Session(FILE_KEY + path, replay.document(path), replay, reopens=True)

    def close(self) -> None:
        """Close all sessions."""
        self.sessions.close()
