"""A robot's event log, read while it is written."""

from __future__ import annotations

import json
import os
from typing import Any, Dict, Iterator, List

from gspn_framework_package.execution.event_log import Record


class LogTail:
    """A robot's log, as far as it has been written.

    :ivar records: the records so far; call :meth:`read` for new ones.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self.records: List[Record] = []
        self._at = self._file = 0

    def read(self) -> LogTail:
        """Read new records."""
        if os.path.exists(self.path):
            with open(self.path, "rb") as file:
                number = os.fstat(file.fileno()).st_ino
                if number != self._file:  # its robot has lost the previous one
                    self._file, self._at = number, 0
                file.seek(self._at)
                whole, newline, _ = file.read().rpartition(b"\n")
            self._at += len(whole) + len(newline)
            self.records += [json.loads(line) for line in whole.splitlines()]
        return self

    def of(self, kind: str, begin: float = 0.0, end: float = float("inf")) -> List[Record]:
        """The records of a kind that were written between two times of the monotonic clock."""
        return [r for r in self.records if r["kind"] == kind and begin <= r["mono"] < end]

    @property
    def length(self) -> int:
        """The number of slots in the log."""
        return 1 + max(
            (r["slot"] for r in self.records if r["kind"] in ("slot", "snapshot")), default=-1
        )

    @property
    def hash(self) -> str:
        """End of the hash chain."""
        return next(
            (r["hash"] for r in reversed(self.records) if r["kind"] in ("slot", "snapshot")), ""
        )

    def moves(self, begin: float = 0.0, end: float = float("inf")) -> int:
        """How often the robot entered a place in that time, counted by the first attempts at
        actions."""
        return sum(r["attempt"] == 1 for r in self.of("goal", begin, end))

    def entries(self, kind: str, begin: float = 0.0, end: float = float("inf")) -> Iterator[Record]:
        """The entries of a kind in the slots written in that time, each with the slot's
        ``mono``."""
        for record in self.of("slot", begin, end):
            for entry in record["entries"]:
                if entry["entry"] == kind:
                    yield dict(entry, mono=record["mono"])

    def commit_times(self, begin: float, end: float) -> List[float]:
        """For each action of the robot that finished in that time and got a slot: the seconds from
        its end, known only to the robot, to the slot."""
        times: List[float] = []
        asked: Dict[Any, float] = {}
        for record in self.records:
            if (
                record["kind"] == "invoked"
                and record["entry"]["entry"] == "done"
                and begin <= record["mono"] < end
            ):
                asked[tuple(record["origin"])] = record["mono"]
            elif record["kind"] == "slot":
                for origin in map(tuple, record["origins"]):
                    if origin in asked:
                        times.append(record["mono"] - asked.pop(origin))
        return times
