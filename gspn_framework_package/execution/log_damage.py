"""Damage to a log by a power loss or disk fault: found, cut off, or set aside."""

from __future__ import annotations

import itertools
import os
import platform
import re
import shutil
from typing import BinaryIO, NamedTuple, Optional, Tuple

from gspn_framework_package.execution.event_log import (
    LONGEST_LINE,
    SUM,
    UNSUMMED,
    EventLog,
    Record,
    follow_sum,
    header_of,
    record_of,
)
from gspn_framework_package.execution.stored_policy import sync_folder
from gspn_framework_package.model.errors import LogError


def end_is_there(event_log: EventLog) -> bool:
    """Whether the log certainly has all records that were written to it, whatever happened to the
    machine: its process shut down properly, the log was synced to the disk, or the machine has not
    restarted since the last node started."""
    if event_log.records and event_log.records[-1]["kind"] == "closed":
        return True
    newest = next((r for r in reversed(event_log.records) if r["kind"] == "life"), event_log.header)
    return bool(newest.get("fsync")) or not _is_of_an_earlier_boot(newest, event_log.header)


def _is_of_an_earlier_boot(record: Record, head: Record) -> bool:
    """Whether the machine has restarted since a record that names its boot."""
    return bool(record.get("host", head.get("host")) != boot_id())


BOOT_ID = "GSPN_BOOT_ID"
"""The environment variable that replaces the id of the machine's boot, for tests."""


def boot_id() -> str:
    """An id of this machine's current boot, to which the monotonic clock belongs."""
    if os.environ.get(BOOT_ID):
        return os.environ[BOOT_ID]
    try:
        with open("/proc/sys/kernel/random/boot_id", encoding="ascii") as file:
            return file.read().strip()
    except OSError:
        return platform.node()


def drop_torn_end(path: str) -> bool:
    """Cut off the damaged end that a power loss may leave in a log: lines of an earlier boot of the
    machine beyond what is known to have reached the disk.

    :returns: whether the log had such an end; otherwise nothing changes.
    :raises LogError: the file cannot be read or changed.
    """
    try:
        with open(path, "rb+") as file:
            whole = _whole_part(file, path)
            if not whole.damaged or whole.size < whole.safe or not whole.earlier_boot:
                return False
            file.truncate(whole.size)
            return True
    except OSError as error:
        raise LogError("cannot be written (%s)" % error.strerror, file=path) from None


class _Whole(NamedTuple):
    """The intact part of a log: its first ``size`` bytes."""

    size: int
    damaged: int
    """The number of the next line; 0 if there is none."""
    safe: int = 0
    """Number of bytes known to have reached the disk."""
    earlier_boot: bool = False
    """Whether the machine has restarted since."""


def _whole_part(file: BinaryIO, path: str) -> _Whole:
    """Read a log up to the first damaged line. :raises LogError: it is not a log."""
    first = file.readline(LONGEST_LINE)
    summed = SUM.search(first) is not None
    try:
        head = life = header_of(first, path)
        chain = "" if head["version"] == UNSUMMED else follow_sum("", first, path, 1)
    except LogError:
        if summed:
            return _Whole(0, 1)
        raise
    good, safe = len(first), 0
    for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), b""), 2):
        try:
            if not line.endswith(b"\n") and not _ENDED.search(line):
                break  # cut off while being written
            record = record_of(line, path, number)
            if chain:
                chain = follow_sum(chain, line, path, number)
        except LogError:
            safe = max(safe, _safe_beyond(file, good + len(line), path))
            return _Whole(good, number, safe, _is_of_an_earlier_boot(life, head))
        good += len(line)
        if record["kind"] == "life":
            life = record
        elif record["kind"] in ("synced", "closed"):
            safe = int(record.get("bytes", good))
    return _Whole(good, 0)


def _safe_beyond(file: BinaryIO, offset: int, path: str) -> int:
    """How many bytes reached the disk, according to records after a damaged line; 0 if there are
    none. A power loss leaves none, since it destroys what was written last.

    :param offset: where these records begin.
    """
    safe = 0
    for line in iter(lambda: file.readline(LONGEST_LINE), b""):
        try:
            record = record_of(line, path, 0)
            if record["kind"] in ("synced", "closed"):
                safe = max(safe, int(record.get("bytes", offset)))
        except (LogError, TypeError, ValueError):
            pass
        offset += len(line)
    return safe


_ENDED = re.compile(rb',"sum":"[0-9a-f]{16}"}.$', re.DOTALL)
"""A complete line, without its line break."""


def set_damage_aside(path: str) -> Optional[Tuple[int, str]]:
    """Save a damaged log under another name, and keep only the intact part before the damage.

    :returns: the number of the first damaged line, and the name of the copy; None if no line is
        damaged.
    :raises LogError: the file is not a log, or cannot be read or changed.
    """
    try:
        with open(path, "rb+") as file:
            whole = _whole_part(file, path)
            if not whole.damaged:
                return None
            names = (path + ".damaged" + ("-%d" % n if n > 1 else "") for n in itertools.count(1))
            copy = next(name for name in names if not os.path.exists(name))
            shutil.copyfile(path, copy)
            with open(copy, "rb") as kept:
                os.fsync(kept.fileno())
            sync_folder(os.path.dirname(os.path.abspath(path)))
            file.truncate(whole.size)  # in place, because the file is locked
            return whole.damaged, copy
    except OSError as error:
        raise LogError("cannot be written (%s)" % error.strerror, file=path) from None


def drop_cut_line(path: str) -> Optional[Record]:
    """Remove a truncated last line; returns the header, or None if there is no file or no complete
    line."""
    if not os.path.exists(path):
        return None
    with open(path, "rb+") as file:
        end = file.seek(0, os.SEEK_END)
        keep = end
        while keep > 0:
            start = max(0, keep - 65536)
            file.seek(start)
            at = file.read(keep - start).rfind(b"\n")
            if at >= 0:
                keep = start + at + 1
                break
            keep = start
        if keep < end:
            file.truncate(keep)
        if keep == 0:
            return None
        file.seek(0)
        return header_of(file.readline(), path)
