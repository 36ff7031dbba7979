"""Writes an event log (see :mod:`.event_log`)."""

from __future__ import annotations

import os
import threading
import time
from typing import BinaryIO, Callable, Optional, Sequence, Tuple

from gspn_framework_package.execution.event_log import (
    DAMAGED,
    KINDS_WITH_PLANS,
    POLICY_APART,
    SUM,
    UNSUMMED,
    Record,
    next_sum,
)
from gspn_framework_package.execution.log_damage import boot_id, drop_cut_line
from gspn_framework_package.execution.stored_policy import (
    stored_separately,
    sync_folder,
    without_large_policies,
)
from gspn_framework_package.model.compact_json import compact
from gspn_framework_package.model.errors import LogError

_HOLDS_PLAN = '"plan":{'
"""Text in every record that holds a plan."""


class EventLogWriter:
    """Appends records to a log. When :meth:`append` returns, every record has reached the operating
    system, so it survives the process.

    :param path: the file; its folder is created if necessary. An existing file is resumed: a
        partial last line is removed, and the header must belong to the same run, robot and plan.
    :param first: the header for a new file (see :func:`.event_log.header`).
    :param fsync: wait until durable records are on the disk, so that they also survive a power
        failure.
    :param clocks: returns the wall clock and the monotonic clock (s).
    :raises LogError: the file belongs to another run, robot or plan, or cannot be written.
    """

    def __init__(
        self,
        path: str,
        first: Record,
        *,
        fsync: bool = False,
        clocks: Callable[[], Tuple[float, float]] = lambda: (time.time(), time.monotonic()),
    ) -> None:
        self.path = path
        self._clocks = clocks
        self._fsync = fsync
        self._sum: Optional[str] = ""
        self._host = boot_id()
        self._lock = threading.Lock()  # another thread may be syncing
        self._news = False
        self._slots = self.synced_length = 0
        try:
            os.makedirs(os.path.dirname(os.path.abspath(path)), exist_ok=True)
            known = drop_cut_line(path)
            plan = stored_separately(first["plan"], path, fsync)
            if plan is not first["plan"]:
                first = {**first, "version": POLICY_APART, "plan": plan}
            if known is not None:
                for key in ("run", "robot", "plan_hash"):
                    if known.get(key) != first[key]:
                        raise LogError(
                            "the log is of %s '%s', not '%s'" % (key, known.get(key), first[key]),
                            file=path,
                            hint="choose another name for the run, or move the file away",
                        )
                self._sum = None if known["version"] == UNSUMMED else _last_sum(path)
            self._file: BinaryIO = open(path, "ab", buffering=0)  # noqa: SIM115
        except OSError as error:
            raise LogError("cannot be written (%s)" % error.strerror, file=path) from None
        if known is None:
            try:
                self.append({**first, "host": first.get("host") or self._host}, durable=True)
                if self._fsync:
                    sync_folder(os.path.dirname(os.path.abspath(path)))
            except LogError:
                self._file.close()
                raise

    def append(self, *records: Record, durable: bool = True, synced: bool = False) -> None:
        """Write the records, each with the current time.

        :param durable: if the log is synced (``fsync``), wait until these and all earlier records
            are on the disk.
        :param synced: wait for that even without ``fsync``.
        :raises LogError: the file cannot be written.
        """
        with self._lock:
            try:
                self._write(records)
                if synced or (self._fsync and durable):
                    os.fdatasync(self._file.fileno())
                    self._news, self.synced_length = False, self._slots
            except OSError as error:
                raise LogError("cannot be written (%s)" % error.strerror, file=self.path) from None

    def _write(self, records: Sequence[Record]) -> None:
        wall, mono = self._clocks()
        clocks = {"wall": round(wall, 6), "mono": round(mono, 6)}
        data = "".join(self._line({**r, **clocks}) for r in records).encode()
        for record in records:
            if record["kind"] in ("slot", "snapshot"):
                self._slots = record.get("slot", -1) + 1
        self._news = True
        while data:
            data = data[self._file.write(data) :]

    def sync(self) -> None:
        """Sync everything written so far to the disk, on any thread, and record in the log how much
        that is. Appending does not wait for it.

        :raises OSError: the disk cannot be written.
        """
        with self._lock:
            if not self._news:
                return
            self._news = False
            length, size = self._slots, os.fstat(self._file.fileno()).st_size
        os.fdatasync(self._file.fileno())
        with self._lock:
            news, self.synced_length = self._news, length
            self._write([{"kind": "synced", "bytes": size, "length": length}])
            self._news = news

    def _line(self, record: Record) -> str:
        if record["kind"] == "life":
            record = {**record, "host": self._host, "fsync": self._fsync}
        text = compact(record)
        if _HOLDS_PLAN in text and record["kind"] in KINDS_WITH_PLANS:
            text = compact(without_large_policies(record, self.path, self._fsync))
        if self._sum is None:
            return text + "\n"
        text, self._sum = _summed(text, self._sum)
        return text

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def close_whole(self) -> None:
        """Mark the log as complete and synced, and close the file: everything sent is in it. If the
        mark cannot be written, the log is closed without it."""
        try:
            self.append({"kind": "closed"}, synced=True)
        except LogError:
            pass
        finally:
            self.close()


def record_line(record: Record, previous: str) -> Tuple[str, str]:
    """The line of a record, and the running hash after it.

    :param previous: the running hash before it ("" for the first line).
    """
    return _summed(compact(record), previous)


def _summed(text: str, previous: str) -> Tuple[str, str]:
    chain = next_sum(previous, text.encode())
    return '%s,"sum":"%s"}\n' % (text[:-1], chain), chain


def _last_sum(path: str) -> str:
    """The running hash of the last line. :raises LogError: the line has none."""
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - 64))
        found = SUM.search(file.read())
    if found is None:
        raise LogError("the last line has no running hash", file=path, hint=DAMAGED)
    return found.group(1).decode()
