"""Reads event logs into a store of a fleet's history.

A run is read once, although each robot of a team has its own log: a log supplies the slots that no
other log has supplied yet, and its other slots are compared with theirs. The position up to which a
log was read is stored, so that the next ingest continues there. The time of a slot is the one in
the log that supplied it.
"""

from __future__ import annotations

import contextlib
import os
import time
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution.event_log import (
    LogClock,
    LogFile,
    LogPosition,
    Record,
    clock_reading,
    log_files,
)
from gspn_framework_package.execution.logged_attempts import ReadingProgress
from gspn_framework_package.fleet.stay_follower import StayFollower
from gspn_framework_package.fleet.store import Manifest, RowWriter, Store, file_stem
from gspn_framework_package.model.errors import GspnError, LogError

CLOCK_WAS_SET = 2.0
"""Seconds; if a log's wall clock drifts further than this from its monotonic clock, it was set."""

MOST_HASHES = 4096
"""Maximum number of slot hashes stored for a run; if there are more, every second one is
dropped."""

_BETWEEN = 2_000
"""Number of records between two reports of progress."""


class IngestedLog(NamedTuple):
    """The result of reading a log.

    ``slots`` is the number of slots read from it, ``rows`` the number of rows made of them.
    ``left_out`` says why a valid log was not read, ``error`` what is wrong with an invalid one. In
    both cases the store is unchanged.
    """

    log: str
    run: str = ""
    slots: int = 0
    rows: int = 0
    left_out: str = ""
    error: str = ""


class _Reader:
    """The reading position and time of one log.

    :param kept: what :meth:`to_json` returned; None for a log that is new.

    :ivar at: the time of the newest record (seconds since 1970).
    :ivar jumped: whether no observed time passed since the previous record.
    """

    def __init__(self, file: LogFile, kept: Optional[Dict[str, Any]]) -> None:
        self.file = file
        self.position = LogPosition(*kept["position"]) if kept is not None else None
        self._clock = LogClock(*kept["clock"]) if kept is not None else LogClock()
        if kept is None:
            self._clock.read(file.header)
        self.at: Optional[float] = kept["at"] if kept is not None else None
        self._last: Optional[float] = kept["clock"][0] if kept is not None else None
        self.seconds = 0.0
        self.jumped = False

    def records(self) -> Iterator[Tuple[int, Record]]:
        """Yield further records with their line numbers; the time is then that of the record,
        ``seconds`` after the previous one."""
        for record, position in self.file.go_on(self.position):
            self._read_time(record)
            yield position.line - 1, record
            self.position = position

    def _read_time(self, record: Record) -> None:
        t = self._clock.read(record)
        self.seconds = t - self._last if self._last is not None else 0.0
        self._last = t
        wall = clock_reading(record, "wall")
        going = self.at + self.seconds if self.at is not None else wall or 0.0
        was_set = wall is not None and abs(wall - going) > CLOCK_WAS_SET
        self.jumped = self.at is None or was_set or record["kind"] == "life"
        self.at = wall if was_set else going

    def to_json(self) -> Dict[str, Any]:
        """The reading position as JSON."""
        return {
            "path": os.path.abspath(self.file.path),
            "robot": self.file.header["robot"],
            "position": list(self.position) if self.position is not None else None,
            "clock": self._clock.to_json(),
            "at": self.at,
        }


class Ingest:
    """Reads logs into a store, which the caller has locked.

    :param progress: called with the number of records read.
    """

    def __init__(self, store: Store, progress: Optional[ReadingProgress] = None) -> None:
        self._store = store
        self._progress = progress
        self._records = 0
        self._started = time.monotonic()
        self._runs = {run["key"]: run for run in store.runs()}

    def read(self, paths: Sequence[str]) -> Iterator[IngestedLog]:
        """Read logs, and yield the result for each. A log given by several names is read once.

        :raises LogError: a folder contains no logs.
        """
        found = [os.path.realpath(path) for path in log_files(paths)]
        files: List[LogFile] = []
        for path in dict.fromkeys(found):
            try:
                files.append(LogFile(path))
            except GspnError as error:
                yield IngestedLog(path, error=str(error))
        # the longest logs come first; the others then only add what those lack
        for file in sorted(files, key=lambda file: -file.size):
            yield self._read_one(file)

    def _read_one(self, file: LogFile) -> IngestedLog:
        try:
            run = self._run_of(file)
            if run is None:
                return IngestedLog(
                    file.path,
                    str(file.header["run"]),
                    left_out="the log begins in the middle of a run that is not in the store "
                    "yet: first ingest the log of a robot that took part from the "
                    "beginning",
                )
            return self._ingest(file, run)
        except GspnError as error:
            return IngestedLog(file.path, str(file.header["run"]), error=str(error))

    # -- runs ---------------------------------------------------------------------------------

    def _run_of(self, file: LogFile) -> Optional[Manifest]:
        """The run of a log, perhaps a new one; None if unknown."""
        header = file.header
        for run in self._runs.values():
            if _id_of(header) in run["logs"]:
                return run
        if not header["robot"]:
            return self._runs.get(file_stem("", header["log"])) or new_run(
                file_stem("", header["log"]), header
            )
        first: Optional[Record] = None
        same = [
            run
            for run in self._runs.values()
            if (run["run"], run["plan_hash"]) == (header["run"], header["plan_hash"])
            and not run["agents"]
        ]
        for record in file.checked_records():
            if record["kind"] not in ("slot", "snapshot"):
                continue
            if first is None:
                first = record
                if record["kind"] == "slot" and record.get("slot") == 0:
                    key = file_stem(header["run"], str(record.get("hash")))
                    return self._runs.get(key) or new_run(key, header)
            known = str(record.get("slot"))
            for run in same:
                if run["hashes"].get(known, record) == record.get("hash"):
                    return run
        return None

    # -- reading -----------------------------------------------------------------------------------

    def _ingest(self, file: LogFile, before: Manifest) -> IngestedLog:
        log = _id_of(file.header)
        kept = before["logs"].get(log)
        reader = _Reader(file, kept)
        run = {**before, "logs": dict(before["logs"]), "hashes": dict(before["hashes"])}
        run["files"] = {table: list(names) for table, names in before["files"].items()}
        run["ingests"] += 1
        follower = StayFollower(
            file.plan, agents=bool(file.header.get("agents")), kept=before["state"]
        )
        first = follower.next_slot
        with contextlib.ExitStack() as stack:
            writer = RowWriter(self._store, run["key"], run["ingests"])
            stack.callback(writer.discard)
            self._follow(reader, follower, run, log, writer)
            follower.cut()
            writer.write(follower.stays, follower.moments)
            writer.close()
            stack.pop_all()
        if reader.position is None or (kept is not None and kept == reader.to_json()):
            return IngestedLog(file.path, run["run"])
        for table, names in writer.files.items():
            run["files"][table] += names
        for table, count in writer.rows.items():
            run["rows"][table] += count
        run["logs"][log] = reader.to_json()
        run["state"] = follower.to_json()
        run["end"] = follower.now
        self._store.merge(run)
        self._store.commit(run)
        self._runs[run["key"]] = run
        return IngestedLog(
            file.path, run["run"], follower.next_slot - first, sum(writer.rows.values())
        )

    def _follow(
        self,
        reader: _Reader,
        follower: StayFollower,
        run: Manifest,
        log: str,
        writer: RowWriter,
    ) -> None:
        gap = False
        for line, record in reader.records():
            self._count()
            kind, leads = record["kind"], run["leader"] == log
            gap = gap or reader.jumped
            try:
                if kind in ("slot", "snapshot"):
                    brings = self._is_new(record, follower, run)
                    if brings and not leads:
                        run["leader"], leads = log, True
                        _catch_up(follower, reader, gap)
                    elif leads:
                        _pass_time(follower, reader)
                    if brings:
                        follower.take(record)
                        _note_hash(run, record)
                    gap = False
                elif leads:
                    _pass_time(follower, reader)
                    if kind == "ended" and run["agents"]:
                        follower.end()
            except LogError as error:
                raise error.located(file=reader.file.path, line=line) from None
            if run["begin"] is None:
                run["begin"] = follower.now
            if follower.stays or follower.moments:
                writer.write(follower.stays, follower.moments)
                follower.stays, follower.moments = [], []

    @staticmethod
    def _is_new(record: Record, follower: StayFollower, run: Manifest) -> bool:
        """Whether a slot or snapshot contains something that no log has supplied yet.

        :raises LogError: it contradicts another log.
        """
        slot = record.get("slot")
        if type(slot) is not int:
            raise LogError("the record is damaged (no slot)")
        if slot >= follower.next_slot:
            return True
        known = run["hashes"].get(str(slot))
        if known is not None and known != record.get("hash"):
            raise LogError(
                "slot %d differs from that in another log of run '%s'" % (slot, run["run"]),
                hint="run 'gspn verify' with both logs for details; two runs with one name need "
                "separate stores if they began alike",
            )
        return False

    def _count(self) -> None:
        self._records += 1
        if self._progress is not None and self._records % _BETWEEN == 0:
            self._progress("records read", self._records, time.monotonic() - self._started)


def _id_of(header: Record) -> str:
    return "%s %s" % (header["log"], header["robot"])


def new_run(key: str, header: Record) -> Manifest:
    """A run from which nothing was read yet, as described by the header of a log."""
    return {
        "key": key,
        "run": header["run"],
        "plan": header["plan"].get("plan", ""),
        "plan_hash": header["plan_hash"],
        "agents": bool(header.get("agents")) or not header["robot"],
        "virtual": header.get("clock") == "virtual",
        "begin": None,
        "end": None,
        "leader": "",
        "rows": {"stays": 0, "moments": 0},
        "logs": {},
        "hashes": {},
        "every": 1,
        "state": None,
        "ingests": 0,
        "files": {"stays": [], "moments": [], "totals": []},
    }


def _pass_time(follower: StayFollower, reader: _Reader) -> None:
    """Advance the time from the previous record."""
    assert reader.at is not None
    if follower.now is None or reader.jumped:
        follower.go_to(reader.at)
    else:
        follower.wait(reader.seconds)


def _catch_up(follower: StayFollower, reader: _Reader, gap: bool) -> None:
    """Continue with a different log. :param gap: its writer was off before this record."""
    assert reader.at is not None
    if follower.now is None or gap:
        follower.go_to(reader.at)
    else:
        follower.wait(reader.at - follower.now)


def _note_hash(run: Manifest, record: Record) -> None:
    """Store the hash of a slot if it is due."""
    hashes, slot = run["hashes"], record["slot"]
    if slot % run["every"] == 0:
        hashes[str(slot)] = record.get("hash")
        if len(hashes) > MOST_HASHES:
            run["every"] *= 2
            run["hashes"] = {s: h for s, h in hashes.items() if int(s) % run["every"] == 0}
