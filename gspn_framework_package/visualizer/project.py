"""What one server offers: a folder of nets, plans and logs, or one thing that it was started
for."""

from __future__ import annotations

from typing import Any, Dict, Optional

from gspn_framework_package.model.errors import InputError
from gspn_framework_package.visualizer.bag_replay import BagReplay, plans_of
from gspn_framework_package.visualizer.documents import Document, Folder
from gspn_framework_package.visualizer.replay import Replay
from gspn_framework_package.visualizer.session import ActivityMaker, Session, Sessions

FILE_KEY = "file-"


class Project:
    """See the module.

    :param folder: the served folder, None for a server that only shows ``session``.
    :param start_execution: how an executable plan is executed.
    :param first: path (in the folder) of what the page opens with.
    """

    def __init__(
        self,
        folder: Optional[Folder] = None,
        start_execution: Optional[ActivityMaker] = None,
        first: Optional[str] = None,
    ) -> None:
        self.sessions = Sessions()
        self._folder = folder
        self._start_execution = start_execution
        self._first = FILE_KEY + first if first is not None else None

    def show(self, session: Session) -> None:
        """Open with this session."""
        self._first = self.sessions.get_or_open(session.key, lambda: session).key

    def to_json(self) -> Dict[str, Any]:
        """What the opening screen shows."""
        entries = self._folder.entries() if self._folder is not None else []
        return {
            "first": self._first,
            "can_open": self._folder is not None,
            "files": [entry._asdict() for entry in entries],
        }

    def open(self, path: str) -> Session:
        """The session of a file of the folder. :raises GspnError: it cannot be opened."""
        if self._folder is None:
            raise InputError("no folder is served here")
        folder = self._folder
        return self.sessions.get_or_open(FILE_KEY + path, lambda: self._make(folder, path))

    def session(self, key: str) -> Session:
        """The session of a key; a file's is opened again where it is not open any more (the server
        was restarted)."""
        if key.startswith(FILE_KEY) and self._folder is not None:
            return self.open(key[len(FILE_KEY) :])
        return self.sessions.get(key)

    def _make(self, folder: Folder, path: str) -> Session:
        if folder.kind(path) == "log":
            return self._recorded(folder, path)
        document: Document = folder.open(path)
        return Session(FILE_KEY + path, document, start_execution=self._start_execution)

    @staticmethod
    def _recorded(folder: Folder, path: str) -> Session:
        if path.endswith(".bag"):
            bag = BagReplay(folder.resolve(path), plans_of(folder))
            return Session(FILE_KEY + path, bag.document(path), bag)
        replay = Replay.of_file(folder.resolve(path))
        return Session(FILE_KEY + path, replay.document(path), replay)

    def close(self) -> None:
        """End everything."""
        self.sessions.close()
