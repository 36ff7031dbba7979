"""REPLAY: plays a recorded run again with the token game."""

from __future__ import annotations

import threading
import time
from typing import Any, Callable, Dict, Optional, Sequence

from gspn_framework_package.execution.event_log import LogFile, clock_reading
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.visualizer.activity import Activity
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.poses import PoseTrack
from gspn_framework_package.visualizer.recording import Recording

TELL = 0.25
"""Seconds between two reports on the progress of reading the log."""


class Replay(Activity):
    """A recorded run. A separate thread reads its log; the page can show the part read so far.

    :param path: the event log.
    :param poses: where the robots were, by the wall clock at which the log began (seconds since
        1970) and their names; None: that is unknown.
    :raises LogError: the file is not one.
    """

    mode = "REPLAY"

    def __init__(
        self, path: str, poses: Optional[Callable[[Sequence[str], float], PoseTrack]] = None
    ) -> None:
        super().__init__()
        self._file = LogFile(path)
        self._recording = Recording(self._file)
        names = [robot.name for robot in self._file.plan.robots]
        self._track = None if poses is None else poses(names, self._began())
        self._stop = threading.Event()

    def _began(self) -> float:
        with self._file.open() as file:
            for record, _ in self._file.records(file, self._file.begin, 2):
                wall = clock_reading(record, "wall")
                if wall is not None and self._file.header.get("clock") != "virtual":
                    return wall
        raise LogError(
            "its robots cannot be placed: it has no wall clock, as recorded poses have",
            file=self._file.path,
        )

    @property
    def log(self) -> Optional[str]:
        """See :class:`Activity`."""
        return self._file.path

    def document(self, title: str) -> Document:
        """The plan of the recorded run, for display."""
        return Document(title, self._file.plan.net, self._file.plan)

    def plan_of(self, number: int) -> Optional[Plan]:
        """See :class:`Activity`."""
        return self._recording.plan_of(number)

    def after_slot(self, slot: int) -> Optional[int]:
        """See :class:`Activity`."""
        return self._recording.after_slot(slot)

    def begin(self, hub: Hub) -> None:
        """Start reading the log, which becomes the history of the hub."""
        header = self._file.header
        who = "run %s" % header["run"]
        if header["robot"]:
            who += ", as %s recorded it" % header["robot"]
        info: Dict[str, Any] = {"says": who, "loading": True, "progress": 0.0}
        hub.restart(
            self.mode,
            self._recording.first_board(),
            info,
            history=self._recording,
            track=self._track,
        )
        threading.Thread(target=self._read, args=(hub,), name="replay", daemon=True).start()

    def end(self) -> None:
        """Stop reading."""
        self._stop.set()

    def _read(self, hub: Hub) -> None:
        reported = 0.0
        for board, share in self._recording.read():
            if self._stop.is_set():
                return
            now = time.monotonic()
            if share >= 1.0 or now - reported >= TELL:
                reported = now
                hub.advance(board)
                hub.change_info(loading=share < 1.0, progress=round(share, 3))
            time.sleep(0)  # viewers take precedence
        hub.change_info(loading=False, progress=1.0)
