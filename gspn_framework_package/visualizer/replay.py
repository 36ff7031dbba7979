"""REPLAY: a recorded run, played by the token game again."""

from __future__ import annotations

import threading
from typing import Any, Dict, List, Optional

from gspn_framework_package.execution.event_log import EventLog, read_log, replay
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.visualizer.activity import Activity
from gspn_framework_package.visualizer.board import Event
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.team_events import TeamEvents

EVENTS = 400_000
"""Most events that are kept of a recorded run; of a longer one, the end."""

BATCH = 200
"""Slots that are handed to the hub at once while a log is read."""


class Replay(Activity):
    """A recorded run. It is read in a thread of its own, and the page can look at what has been
    read.

    :param event_log: the log.
    """

    mode = "REPLAY"

    def __init__(self, event_log: EventLog) -> None:
        super().__init__()
        self._log = event_log
        self._game = TokenGame(event_log.plan, agents=bool(event_log.header.get("agents")))
        self._events = TeamEvents(self._game)
        self._stop = threading.Event()

    @classmethod
    def of_file(cls, path: str) -> Replay:
        """The replay of an event log. :raises LogError: it is none."""
        return cls(read_log(path))

    def document(self, title: str) -> Document:
        """The plan that was run, to be shown."""
        return Document(title, self._log.plan.net, self._log.plan)

    def begin(self, hub: Hub) -> None:
        """Read the log into the hub."""
        self._hub = hub
        who = "run %s" % self._log.header["run"]
        if self._log.robot:
            who += ", as %s recorded it" % self._log.robot
        info: Dict[str, Any] = {"says": who, "loading": True}
        hub.restart(self.mode, self._events.board(running=False), info, ring=EVENTS)
        threading.Thread(target=self._read, name="replay", daemon=True).start()

    def end(self) -> None:
        """Stop reading."""
        self._stop.set()

    def _read(self) -> None:
        first: Optional[float] = None
        t = 0.0
        events: List[Event] = []
        try:
            for number, slot in enumerate(replay(self._log)):
                if self._stop.is_set():
                    return
                wall = slot.record.get("wall")
                if isinstance(wall, (int, float)):
                    first = wall if first is None else first
                    t = max(t, wall - first)
                events += self._events.step(slot.entries, slot.firings, slot.state, t)
                if number % BATCH == BATCH - 1:
                    self._hub.publish(*events)
                    events = []
            ended = [r for r in self._log.records if r["kind"] == "ended"]
            if ended:
                last = ended[-1]
                for event in self._events.status(
                    ended=str(last.get("reason", "")), finished=bool(last.get("finished"))
                ):
                    events.append({**event, "t": round(t, 4)})
            if self._log.cut:
                events.append(_note(t, "warning", "the last line of the log was cut off"))
        except GspnError as error:
            events.append(_note(t, "fault", "the log cannot be followed further: %s" % error))
        self._hub.publish(*events)
        self._hub.change_info(loading=False)


def _note(t: float, level: str, text: str) -> Event:
    return {"k": "note", "t": round(t, 4), "level": level, "robot": "", "text": text}
