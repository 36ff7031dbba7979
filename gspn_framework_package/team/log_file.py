"""Opens the log file of one robot: locks it, reads it, and appends to it."""

from __future__ import annotations

import contextlib
import fcntl
import os
import threading
import time
import uuid
from typing import BinaryIO, List, NamedTuple, Optional, Tuple

from gspn_framework_package.execution.event_log import EventLog, Record, header, read_log
from gspn_framework_package.execution.log_damage import (
    drop_torn_end,
    end_is_there,
    set_damage_aside,
)
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.stored_policy import sync_folder
from gspn_framework_package.model.errors import LogError, UsageError
from gspn_framework_package.model.plan import Plan

LOCK_TIME = 8.0
"""Seconds to wait for a lock that a node still holds while it ends."""


def log_path(folder: str, run: str, robot: str) -> str:
    """The path of the log of a robot.

    :param folder: the folder of the logs; by default ``~/.ros/gspn``.
    :param run: name of the run; see :func:`check_run_name`.
    """
    home = os.environ.get("ROS_HOME") or os.path.join(os.path.expanduser("~"), ".ros")
    folder = os.path.expanduser(folder) or os.path.join(home, "gspn")
    return os.path.join(folder, run, robot + ".jsonl")


def check_run_name(run: str, option: str) -> None:
    """Refuse a name that cannot be the name of a folder.

    :param option: the option that gave the name, for the message.
    :raises UsageError: the name is not valid for a run.
    """
    if os.sep in run or run in ("", ".", ".."):
        raise UsageError("'%s' is not a valid name for a run" % run, element=option)


def lock_log(path: str) -> BinaryIO:
    """Lock a log: two nodes writing to the same file would make it unreadable.

    :returns: the file; closing it releases the lock.
    :raises LogError: another process holds the lock, or the file cannot be written.
    """
    deadline = time.monotonic() + LOCK_TIME
    try:
        os.makedirs(os.path.dirname(path), exist_ok=True)
        file = open(path, "ab")  # noqa: SIM115
    except OSError as error:
        raise LogError("cannot be written (%s)" % error.strerror, file=path) from None
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return file
        except BlockingIOError:
            if time.monotonic() > deadline:
                file.close()
                raise LogError(
                    "another node is writing to this log",
                    file=path,
                    hint="a robot has only one node in a run; stop that node, or choose "
                    "another run",
                ) from None
            time.sleep(0.1)
        except OSError:  # the file system does not support locks
            return file


SYNC_PERIOD_NAME = "GSPN_SYNC_PERIOD"
"""Environment variable for the number of seconds between two syncs of a log."""

SYNC_PERIOD = float(os.environ.get(SYNC_PERIOD_NAME) or 1.0)
"""Seconds between two syncs of a log."""


class SyncedLog(EventLogWriter):
    """A log that a background thread syncs to the disk continually, so that a power loss destroys
    at most the last second. Writers do not wait for it.

    :param length: number of slots that the log already has.
    """

    def __init__(self, path: str, first: Record, length: int, *, fsync: bool) -> None:
        self._lost = False
        super().__init__(path, first, fsync=fsync)
        try:  # the directory entry must survive a power loss too
            os.fsync(self._file.fileno())
            folder = os.path.dirname(os.path.abspath(path))
            sync_folder(folder)
            sync_folder(os.path.dirname(folder))
        except OSError as error:
            super().close()
            raise LogError("cannot be written (%s)" % error.strerror, file=path) from None
        self._slots = self.synced_length = length
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._keep_synced, name="sync", daemon=True)
        self._thread.start()

    def _keep_synced(self) -> None:
        while not self._over.wait(SYNC_PERIOD):
            # a full disk is reported by the next append
            with contextlib.suppress(OSError):
                self._lost = not self._is_there()
                if self._lost:
                    break
                self.sync()

    def _is_there(self) -> bool:
        """Whether the path still refers to the open file."""
        try:
            named = os.stat(self.path)
        except (FileNotFoundError, NotADirectoryError):
            return False
        return os.path.samestat(named, os.fstat(self._file.fileno()))

    def append(self, *records: Record, durable: bool = True, synced: bool = False) -> None:
        """See :class:`EventLogWriter`."""
        self.check()
        super().append(*records, durable=durable, synced=synced)

    def check(self) -> None:
        """Check that the log can still be written.

        :raises LogError: the file was removed or replaced while it was open.
        """
        if self._lost:
            raise LogError(
                "was removed or replaced while its robot was writing to it",
                file=self.path,
                hint="restart the robot; it gets the log from the others and rejoins",
            )

    def close(self) -> None:
        """See :class:`EventLogWriter`."""
        self._stop()
        super().close()

    def close_whole(self) -> None:
        """See :class:`EventLogWriter`."""
        self._stop()  # nothing may follow the mark
        super().close_whole()

    def _stop(self) -> None:
        self._over.set()
        self._thread.join()


class OpenLog(NamedTuple):
    """A log that this process has open for writing."""

    lock: BinaryIO
    """Lock file; close it after the writer."""
    log_id: str
    records: List[Record]
    """The records that the log already held."""
    whole: bool
    """Whether the end of the log is intact."""
    damage: str
    """What was damaged, and where the damaged file is kept; "" for no damage."""
    writer: SyncedLog


def open_log(path: str, plan: Plan, run: str, robot: str) -> OpenLog:
    """Open the log of a robot, creating it if necessary.

    :param plan: the first plan of the run.
    :raises LogError: another process writes it, it belongs to another run, robot or plan, or the
        file cannot be used.
    """
    lock = lock_log(path)
    log_id, records, whole, damage = uuid.uuid4().hex, [], True, ""
    if os.path.exists(path) and os.path.getsize(path):
        try:
            known, damage = _read(path)
            if known is not None:
                log_id, records = str(known.header["log"]), known.records
                whole = end_is_there(known)
        except LogError:
            with open(path, "rb") as file:
                if (
                    b"\n" in file.readline()
                ):  # otherwise the process was killed while writing the first line
                    raise
    first = header(plan, run, robot, log_id)
    slots = (r["slot"] + 1 for r in reversed(records) if r["kind"] in ("slot", "snapshot"))
    writer = SyncedLog(path, first, next(slots, 0), fsync=plan.fsync)
    return OpenLog(lock, log_id, records, whole, damage, writer)


def _read(path: str) -> Tuple[Optional[EventLog], str]:
    """Read the log, without a damaged end that a power loss may have left. Of a log with other
    damage, read the intact part before it (None if there is none), and describe the damage."""
    try:
        known = read_log(path)
        found = set_damage_aside(path) if known.cut else None
        if found is None:
            return known, ""
    except LogError:
        if drop_torn_end(path):
            return read_log(path), ""
        found = set_damage_aside(path)
        if found is None:
            raise
    line, copy = found
    damage = "line %d of %s is damaged; the whole file is kept as %s" % (line, path, copy)
    return (read_log(path) if os.path.getsize(path) else None), damage
