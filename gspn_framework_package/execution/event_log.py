"""The event log of a run: one file of JSON lines that serves as write-ahead log, event log and
history.

The first line is the *header*: format and version, run, robot, the id of this log, and the complete
plan, so that a run can be replayed and verified from the log alone (a large policy is in a file
beside the logs, see ``stored_policy``). Every other line is a *record*: a JSON object with its
``kind``, its fields, the wall clock (``wall``, seconds since 1970) and a monotonic clock (``mono``,
seconds, comparable between the processes of one host). Kinds:

==============  ====================================================================================
``slot``        a slot of the agreed log: ``slot``, ``entries``, ``origins`` (the robot that put
                each in, its incarnation and a sequence number; empty in a local log), the
                ``firings`` that followed, ``hash`` (of the chain), ``ballot`` if a team agreed on
                it
``snapshot``    the state after slot ``slot``, taken over from a peer or kept as a starting point:
                ``state``, ``seen`` (origin -> newest entry), ``logs`` (robot -> the log with which
                it was let in), ``cast_out`` (robot -> slot of its eviction by force), ``hash``
``reset``       earlier records no longer count (``why``); the robot learns the log from the others,
                and its log has the id ``log`` from here on; ``keep`` if the slots count,
                ``damaged`` if the log was, and its whole file is kept elsewhere
``outage``      the machine lost power, so records may be missing here (``why``); earlier records
                count, and the log has the id ``log`` from here on
``synced``      the first ``bytes`` bytes of the file, with ``length`` slots, are on the disk
``closed``      the process ended in order, and everything before is on the disk
``active``      this replica takes part from now on
``life``        the node started: ``incarnation``; ``joining`` if it was not in the first team;
                ``host`` as in the header; ``fsync``: whether the log is synced to the disk
``promised``    acceptor: no ballot below ``ballot`` will be accepted in ``slot`` or later; ``torn``
                where the slot needs the votes of all (robot whose log lost its end -> the id of its
                log, and of those that it goes on from)
``accepted``    acceptor: accepted ``batch`` under ``ballot`` in ``slot``; ``torn`` as above
``invoked``     a proposal of this robot for the log: ``entry``, ``origin``
``offered``     a task reached this robot, and waits to get into the log: ``entry``
``order``       an operator gave this robot an order: ``command``, ``robot``, ``argument``
                (shortened), ``operator`` (who it was) and ``proof`` (what shows that)
``void``        an ``invoked`` proposal can no longer take effect (``why``)
``private``     partial synchronisation: a local transition of this robot: ``entry``, ``origin``,
                ``firing``
``goal``        the goal of an action is sent: ``place``, ``incarnation``, ``visit``, ``attempt``;
                if the action reads data, ``reads``, a digest of it, and ``resumed_from`` as in
                :class:`~gspn_framework_package.execution.firing.StartAction`
``cancel``      the goals of visits up to ``visit`` are void
``peer``        first contact with a robot: ``robot``, ``log`` (the id of its log); or, with
                ``torn``, its log lost its end: the ids of the logs that this one goes on from
``forced``      the operator asserts that these ``robots`` (robot -> incarnation) are off
``ended``       the run is over: ``reason``, ``finished``
==============  ====================================================================================

``kill -9`` may truncate the last line. Nothing that depends on that line has left the process, so a
reader drops it, and a writer that resumes the file first removes it.

The last field of every line, ``sum``, is a running hash of this line and all lines before it. It
reveals a line that was changed, dropped or inserted. (Logs of version 1 have none. Version 3 is
version 2 with the policy in a file of its own.)
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import os
import platform
import re
import shutil
import threading
import time
from typing import (
    Any,
    BinaryIO,
    Callable,
    Dict,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.firing import Command, Firing, firing_from_json
from gspn_framework_package.execution.stored_policy import (
    hash_of,
    read_stored,
    stored_separately,
    with_policies,
    without_large_policies,
)
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.formats.json_file import MAX_DEPTH, is_too_deep
from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json
from gspn_framework_package.formats.source import open_file
from gspn_framework_package.model.compact_json import compact, compact_sorted
from gspn_framework_package.model.errors import GspnError, LogError, NetError
from gspn_framework_package.model.plan import Plan

FORMAT = "gspn event log"
VERSION = 2
UNSUMMED = 1
"""The version whose lines have no running hash; still read and continued."""
POLICY_APART = 3
"""The version whose header has only the hash of the policy."""

ORDER_GIVEN = "order"
"""The kind of a record of who gave an order. Only the log of the robot that was asked has it; the
origin of the entry in the agreed log says which robot that is."""

Record = Dict[str, Any]

_WITH_PLANS = ("slot", "snapshot", "accepted", "invoked")
_HOLDS_PLAN = '"plan":{'
"""The kinds of records that can hold a plan that was staged."""


def header(
    plan: Plan,
    run: str,
    robot: str,
    log_id: str,
    *,
    agents: bool = False,
    host: str = "",
    virtual: bool = False,
) -> Record:
    """The first line of a log.

    :param plan: the plan, which the header contains in full.
    :param run: name of the run.
    :param robot: the robot that keeps the log ("" for a standalone run).
    :param log_id: unique to this log, e.g. a random hex string. It distinguishes a robot that comes
        back with its log from one that lost it.
    :param agents: whether this is a standalone run, where transitions may create and destroy
        tokens.
    :param host: the host and boot that the monotonic clock belongs to (the writer fills it in).
        Times of different hosts or boots are not compared.
    :param virtual: whether the run is simulated: its clocks are virtual, and start at 0.
    """
    first = {
        "kind": "header",
        "format": FORMAT,
        "version": VERSION,
        "run": run,
        "robot": robot,
        "log": log_id,
        "agents": agents,
        "host": host,
        "plan_hash": plan.hash(),
        "plan": plan_to_json(plan),
    }
    return {**first, "clock": "virtual"} if virtual else first


def first_hash(plan: Plan) -> str:
    """The start of a run's hash chain."""
    return plan.hash()


def next_hash(
    previous: str, entries: Sequence[Record], origins: Sequence[Any], firings: Sequence[Record]
) -> str:
    """The next link of the hash chain: a hash of the previous link and of a slot's entries, their
    origins and the firings that followed, in their JSON form in the log."""
    text = compact_sorted([previous, entries, origins, firings])
    return hashlib.sha256(text.encode()).hexdigest()[:32]


class EventLogWriter:
    """Appends records to a log. When :meth:`append` returns, every record has reached the operating
    system, so it survives the process.

    :param path: the file; its folder is made if necessary. An existing file is resumed: a partial
        last line is removed, and the header must be of the same run, robot and plan.
    :param first: the header for a new file (see :func:`header`).
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
        self._host = _host()
        self._lock = threading.Lock()  # another thread may sync
        self._news = False
        self._slots = self.synced_length = 0
        try:
            os.makedirs(os.path.dirname(os.path.abspath(path)), exist_ok=True)
            known = _repair(path)
            plan = stored_separately(first["plan"], path, fsync)
            if plan is not first["plan"]:
                first = {**first, "version": POLICY_APART, "plan": plan}
            if known is not None:
                for key in ("run", "robot", "plan_hash"):
                    if known.get(key) != first[key]:
                        raise LogError(
                            "the log is of %s '%s', not '%s'" % (key, known.get(key), first[key]),
                            file=path,
                            hint="give the run another name, or move the file away",
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
        :param synced: wait for that in any case.
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
        """Bring what was written to the disk, on any thread, and note in the log how much that is.
        Nobody who appends waits for it.

        :raises OSError: the disk does not take it.
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
        if _HOLDS_PLAN in text and record["kind"] in _WITH_PLANS:
            text = compact(without_large_policies(record, self.path, self._fsync))
        if self._sum is None:
            return text + "\n"
        text, self._sum = _summed(text, self._sum)
        return text

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def close_whole(self) -> None:
        """Mark the log as whole, on the disk, and close the file: nothing was sent that is not in
        it. If the mark cannot be written, the log is closed without it."""
        try:
            self.append({"kind": "closed"}, synced=True)
        except LogError:
            pass
        finally:
            self.close()


def line_of(record: Record, previous: str) -> Tuple[str, str]:
    """The line of a record, and the running hash after it.

    :param previous: the running hash before it ("" for the first line).
    """
    return _summed(compact(record), previous)


def _summed(text: str, previous: str) -> Tuple[str, str]:
    chain = next_sum(previous, text.encode())
    return '%s,"sum":"%s"}\n' % (text[:-1], chain), chain


def next_sum(previous: str, line: bytes) -> str:
    """The running hash of a log after a line.

    :param previous: the running hash before the line ("" for the first line).
    :param line: the line without its ``sum``.
    """
    return hashlib.sha256(previous.encode() + line).hexdigest()[:16]


_SUM = re.compile(rb',"sum":"([0-9a-f]{16})"}\n?$')


def _without_sum(line: bytes) -> Tuple[bytes, str]:
    """A line without its running hash, and that hash ("" if the line has none)."""
    found = _SUM.search(line)
    if found is None:
        return line, ""
    return line[: found.start()] + b"}", found.group(1).decode()


def _last_sum(path: str) -> str:
    """The running hash of the last line. :raises LogError: the line has none."""
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - 64))
        found = _SUM.search(file.read())
    if found is None:
        raise LogError("the last line has no running hash", file=path, hint=DAMAGED)
    return found.group(1).decode()


def sync_folder(path: str) -> None:
    """Sync a folder, so that the name of a new file in it survives a power failure."""
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def end_is_there(event_log: EventLog) -> bool:
    """Whether the log certainly has all records that were written to it, whatever happened to the
    machine: its process ended in order, it was synced to the disk, or the machine has not restarted
    since its last node started."""
    if event_log.records and event_log.records[-1]["kind"] == "closed":
        return True
    newest = next((r for r in reversed(event_log.records) if r["kind"] == "life"), event_log.header)
    return bool(newest.get("fsync")) or not _is_of_an_earlier_boot(newest, event_log.header)


def _is_of_an_earlier_boot(record: Record, head: Record) -> bool:
    """Whether the machine has restarted since a record that names its boot."""
    return bool(record.get("host", head.get("host")) != _host())


BOOT_ID = "GSPN_BOOT_ID"
"""The environment variable that replaces the id of the machine's boot, for tests."""


def _host() -> str:
    """An id of this machine's current boot, to which the monotonic clock belongs."""
    if os.environ.get(BOOT_ID):
        return os.environ[BOOT_ID]
    try:
        with open("/proc/sys/kernel/random/boot_id", encoding="ascii") as file:
            return file.read().strip()
    except OSError:
        return platform.node()


def drop_torn_end(path: str) -> bool:
    """Cut off the damaged end that a loss of power may leave in a log: lines beyond what is known
    to have reached the disk, of an earlier boot of the machine.

    :returns: whether that was the damage; otherwise nothing changes.
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
    """What is whole of a log: its first ``size`` bytes."""

    size: int
    damaged: int
    """The number of the line after it; 0 if there is none."""
    safe: int = 0
    """Bytes that are known to have reached the disk."""
    earlier_boot: bool = False
    """Whether the machine has restarted since."""


def _whole_part(file: BinaryIO, path: str) -> _Whole:
    """Read a log up to the first damaged line. :raises LogError: it is no log."""
    first = file.readline(LONGEST_LINE)
    summed = _SUM.search(first) is not None
    try:
        head = life = _header(first, path)
        chain = "" if head["version"] == UNSUMMED else _follow("", first, path, 1)
    except LogError:
        if summed:
            return _Whole(0, 1)
        raise
    good, safe = len(first), 0
    for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), b""), 2):
        try:
            if not line.endswith(b"\n") and not _ENDED.search(line):
                break  # cut off while it was written
            record = _record(line, path, number)
            if chain:
                chain = _follow(chain, line, path, number)
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
    """How many bytes reached the disk, as records after a damaged line say; 0 where none does. A
    loss of power leaves none: it takes what was written last.

    :param offset: where these records begin.
    """
    safe = 0
    for line in iter(lambda: file.readline(LONGEST_LINE), b""):
        try:
            record = _record(line, path, 0)
            if record["kind"] in ("synced", "closed"):
                safe = max(safe, int(record.get("bytes", offset)))
        except (LogError, TypeError, ValueError):
            pass
        offset += len(line)
    return safe


_ENDED = re.compile(rb',"sum":"[0-9a-f]{16}"}.$', re.DOTALL)
"""A complete line, but for its end."""


def set_damage_aside(path: str) -> Optional[Tuple[int, str]]:
    """Keep a damaged log under another name, and leave what is whole before the damage.

    :returns: the number of the first damaged line, and the name of the copy; None if no line is
        damaged.
    :raises LogError: the file is no log, or cannot be read or changed.
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
            file.truncate(whole.size)  # in place: the file is locked
            return whole.damaged, copy
    except OSError as error:
        raise LogError("cannot be written (%s)" % error.strerror, file=path) from None


def _repair(path: str) -> Optional[Record]:
    """Remove a truncated last line; returns the header, or None if there is no file or it has no
    complete line."""
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
        return _header(file.readline(), path)


class EventLog:
    """A log that was read.

    :ivar header: its first line.
    :ivar records: all other lines, in order.
    :ivar cut: whether a truncated last line was dropped.
    """

    def __init__(
        self,
        path: str,
        header: Record,
        records: List[Record],
        cut: bool = False,
        plan: Optional[Plan] = None,
    ) -> None:
        self.path = path
        self.header = header
        self.records = records
        self.cut = cut
        self._plan = plan

    @property
    def plan(self) -> Plan:
        """The plan in the header. :raises LogError: it is invalid, its hash differs from the
        recorded one, or its policy, which is in another file, is missing or was altered."""
        if self._plan is None:
            data = self.header["plan"]
            name = hash_of(data)
            policy = None if name is None else read_stored(self.path, name)
            if policy is not None:
                data = {key: value for key, value in data.items() if key != "policy"}
            try:
                plan = plan_from_json(data, policy=policy)
            except (GspnError, KeyError) as error:
                raise LogError("holds no plan (%s)" % error, file=self.path, line=1) from None
            if plan.hash() != self.header["plan_hash"]:
                raise LogError(
                    "the hash of its plan differs from the recorded one", file=self.path, line=1
                )
            self._plan = plan
        return self._plan

    @property
    def robot(self) -> str:
        """The robot that kept the log; "" for a standalone run."""
        return str(self.header["robot"])


def read_log(path: str, size: Optional[int] = None) -> EventLog:
    """Read a log.

    A truncated last line is dropped (``EventLog.cut``).

    :param size: read only that many bytes, to read logs that are still being written as they were
        at one moment.
    :raises LogError: the file cannot be read, is not a log of a known version, or has a line that
        is not a record; the message says which.
    """
    records: List[Record] = []
    try:
        with open_file(path) as file:
            first = file.readline(LONGEST_LINE)
            cut = not first.endswith(b"\n")
            head = _header(first, path)
            chain = "" if head["version"] == UNSUMMED else _follow("", first, path, 1)
            left = math.inf if size is None else size - len(first)
            for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), b""), 2):
                left -= len(line)
                if left < 0:
                    break
                if not line.endswith(b"\n"):
                    if len(line) >= LONGEST_LINE:
                        raise LogError(TOO_LONG, file=path, line=number)
                    cut = True
                    break
                records.append(_record(line, path, number))
                if chain:
                    chain = _follow(chain, line, path, number)
    except OSError as error:
        raise LogError("cannot be read (%s)" % error.strerror, file=path) from None
    return EventLog(path, head, records, cut)


class LogPosition(NamedTuple):
    """Where to go on reading a log: byte ``offset``, at which line ``line`` begins, and the running
    hash (``sum``) of the lines before it, "" in a log of version 1."""

    offset: int
    line: int
    sum: str


LONGEST_LINE = 64_000_000
"""Bytes; a longer line is not accepted as a record."""

TOO_LONG = "is too long for a record"


class LogFile:
    """A log that is read line by line, on demand.

    :param path: the file.
    :raises LogError: it cannot be read, or is not a log of a known version.

    :ivar header: the first line.
    :ivar plan: the plan in the header.
    :ivar begin: the byte offset of the first record.
    :ivar size: the size of the file in bytes when it was opened.
    :ivar cut: whether a truncated last line has been met.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self.cut = False
        with self.open() as file:
            first = file.readline(LONGEST_LINE)
            self.size = os.fstat(file.fileno()).st_size
        self.header = _header(first, path)
        self.begin = len(first)
        self.plan = EventLog(path, self.header, []).plan

    def open(self) -> BinaryIO:
        """Open the file for reading. :raises LogError: it cannot be read."""
        try:
            return open_file(self.path)
        except OSError as error:
            raise LogError("cannot be read (%s)" % error.strerror, file=self.path) from None

    def records(self, file: BinaryIO, offset: int, number: int) -> Iterator[Tuple[Record, int]]:
        """Yield the records from byte ``offset`` on, each with the length of its line in bytes.

        If the log is still being written, only records that were there when it was opened are read.
        A truncated last line is left out and noted in ``cut``.

        :param file: the file, from :meth:`open`.
        :param offset: the byte at which line ``number`` begins.
        :param number: the number of that line, for messages (the header is line 1).
        :raises LogError: a line is not a record, or the file can no longer be read.
        """
        for line in self._lines(file, offset, number):
            yield _record(line, self.path, number), len(line)
            number += 1

    def _lines(self, file: BinaryIO, offset: int, number: int) -> Iterator[bytes]:
        """Yield the complete lines from byte ``offset`` on, at which line ``number`` begins."""
        try:
            file.seek(offset)
            while offset < self.size:
                line = file.readline(min(LONGEST_LINE, self.size - offset))
                offset += len(line)
                if not line.endswith(b"\n"):
                    if len(line) >= LONGEST_LINE:
                        raise LogError(TOO_LONG, file=self.path, line=number)
                    self.cut = bool(line)
                    break
                yield line
                number += 1
        except OSError as error:
            raise LogError("cannot be read (%s)" % error.strerror, file=self.path) from None

    def go_on(self, position: Optional[LogPosition]) -> Iterator[Tuple[Record, LogPosition]]:
        """Yield the records from a position on, each with the position behind it, and compare the
        running hash of every line with the recorded one.

        A log that is still being written and a truncated last line are handled as by
        :meth:`records`.

        :param position: where an earlier reader stopped; None: at the first record.
        :raises LogError: a line is not a record or does not follow from the lines before it, the
            lines before the position are not those that were read, or the file cannot be read.
        """
        self.cut = False
        with self.open() as file:
            offset, number, chain = position or self._first_position(file)
            if position is not None and not self._has(file, position):
                raise DamagedLogError(
                    "is no longer the log that was read up to line %d" % (number - 1),
                    file=self.path,
                    hint=DAMAGED,
                )
            for line in self._lines(file, offset, number):
                record = _record(line, self.path, number)
                if chain:
                    chain = _follow(chain, line, self.path, number)
                offset += len(line)
                number += 1
                yield record, LogPosition(offset, number, chain)

    def _first_position(self, file: BinaryIO) -> LogPosition:
        """The position of the first record."""
        summed = self.header["version"] != UNSUMMED
        chain = _follow("", file.readline(LONGEST_LINE), self.path, 1) if summed else ""
        return LogPosition(self.begin, 2, chain)

    def _has(self, file: BinaryIO, position: LogPosition) -> bool:
        """Whether the line before a position is the one that was read there."""
        if position.offset > self.size:
            return False
        file.seek(max(0, position.offset - 64))
        found = _SUM.search(file.read(min(64, position.offset)))
        return (found.group(1).decode() if found else "") == position.sum

    def checked_records(self) -> Iterator[Record]:
        """Yield all records, and compare the running hash of every line with the recorded one.

        A log that is still being written and a truncated last line are handled as by
        :meth:`records`.

        :raises LogError: a line is not a record or does not follow from the lines before it, or the
            file can no longer be read.
        """
        return (record for record, _ in self.go_on(None))


def log_files(paths: Sequence[str]) -> List[str]:
    """The logs that are meant: files as they are, and the logs (``*.jsonl``) in each folder.

    :raises LogError: a folder holds none.
    """
    found: List[str] = []
    for path in paths:
        if not os.path.isdir(path):
            found.append(path)
            continue
        inside = [name for name in sorted(os.listdir(path)) if name.endswith(".jsonl")]
        if not inside:
            raise LogError("holds no event logs (*.jsonl)", file=path)
        found += [os.path.join(path, name) for name in inside]
    return found


DAMAGED = (
    "a line was changed, dropped or put in; "
    "a robot whose log is moved away learns it from the others, and joins again"
)


class DamagedLogError(LogError):
    """A line of a log does not follow from the lines before it."""


def _follow(chain: str, line: bytes, path: str, number: int) -> str:
    """The running hash after a line. :raises DamagedLogError: the line records a different one."""
    text, told = _without_sum(line)
    chain = next_sum(chain, text)
    if told != chain:
        raise DamagedLogError(
            "does not follow from the lines before it", file=path, line=number, hint=DAMAGED
        )
    return chain


def _parsed(line: bytes) -> Any:
    """The JSON of a line. :raises ValueError: it is none.
    :raises RecursionError: it is nested too deeply."""
    data = json.loads(line.decode())
    if line.count(b"[") + line.count(b"{") > MAX_DEPTH and is_too_deep(data):
        raise RecursionError
    return data


def _record(line: bytes, path: str, number: int) -> Record:
    try:
        record = _parsed(line)
    except (ValueError, RecursionError):
        raise LogError("is not JSON: %.80r" % line, file=path, line=number) from None
    if not isinstance(record, dict) or not isinstance(record.get("kind"), str):
        raise LogError("is not a record: %.80r" % line, file=path, line=number)
    record.pop("sum", None)
    if b'"policy":{"hash":' in line and record["kind"] in _WITH_PLANS:
        return with_policies(record, path)
    return record


def _header(line: bytes, path: str) -> Record:
    hint = "the first line of an event log is its header"
    if not line.strip():
        raise LogError("is empty, not an event log", file=path, hint=hint)
    try:
        head = _parsed(line)
    except (ValueError, RecursionError):
        raise LogError("is not an event log", file=path, line=1, hint=hint) from None
    if not isinstance(head, dict) or head.get("format") != FORMAT:
        raise LogError("is not an event log", file=path, line=1, hint=hint)
    if head.get("version") not in (UNSUMMED, VERSION, POLICY_APART):
        raise LogError(
            "is of version %.20r; this program reads versions %d to %d"
            % (head.get("version"), UNSUMMED, POLICY_APART),
            file=path,
            line=1,
            hint="read it with the version of the package that wrote it",
        )
    for key in ("run", "robot", "log", "plan_hash", "plan"):
        if key not in head:
            raise LogError("the header lacks '%s'" % key, file=path, line=1)
    return head


class LogClock:
    """Seconds on a log's own clock, which never decrease: the host's monotonic clock, continued by
    the wall clock when the host restarts.

    :param t: where to begin (s); by default, at the monotonic time of the first record, so that the
        logs of one boot of one host share their times.
    :param mono: the monotonic time of the last record that was read, if any.
    :param wall: the wall time of that record.
    :param host: the host and boot that the monotonic time belongs to.
    """

    def __init__(
        self,
        t: Optional[float] = None,
        mono: Optional[float] = None,
        wall: Optional[float] = None,
        host: str = "",
    ) -> None:
        self._t, self._mono, self._wall, self._host = t, mono, wall, host

    def read(self, record: Record) -> float:
        """The time of the next record (s)."""
        mono, wall = _seconds(record.get("mono")), _seconds(record.get("wall"))
        host = str(record.get("host") or self._host)
        if self._t is None:
            self._t = mono if mono is not None else wall or 0.0
        gone = None
        same = host == self._host or not self._host
        if mono is not None and self._mono is not None and mono >= self._mono and same:
            gone = mono - self._mono
        elif wall is not None and self._wall is not None:
            gone = wall - self._wall
        self._t += max(0.0, gone or 0.0)
        self._mono = mono if mono is not None else self._mono
        self._wall = wall if wall is not None else self._wall
        self._host = host
        return self._t

    def to_json(self) -> List[Any]:
        """The arguments of a clock that goes on from here."""
        return [self._t, self._mono, self._wall, self._host]


def _seconds(value: object) -> Optional[float]:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


class Replayed(NamedTuple):
    """A replayed slot of a log. ``state`` is the state after it; replaying the next slot changes it
    in place. ``commands`` is what it had the robots do, ``adopted`` the plans that the team adopted
    in it (see :class:`~gspn_framework_package.execution.token_game.Step`).

    If the log took over a snapshot instead, ``snapshot`` is true and ``entries`` is empty.
    """

    slot: int
    entries: Tuple[log_entries.Entry, ...]
    firings: List[Firing]
    state: TeamState
    record: Record
    snapshot: bool = False
    commands: Sequence[Command] = ()
    adopted: Tuple[Tuple[int, TokenGame], ...] = ()


class Replayer:
    """Replays the slots of a log with the token game, record by record.

    :param game: the rules of the plan in the header.
    :param state: the state to start from; by default, the state before the run.

    :ivar game: the rules of the plan that the team follows now.
    """

    def __init__(self, game: TokenGame, state: Optional[TeamState] = None) -> None:
        self._first = game
        self.state = state if state is not None else game.new_state()
        self.game = game.now(self.state)

    def take(self, record: Record) -> Optional[Replayed]:
        """Replay the next record of the log.

        :returns: what it changed; None if it holds no slot or new snapshot.
        :raises LogError: a slot is missing, does not hold entries, or leads to other firings than
          those it recorded; or the record is damaged, or not of this plan.
        """
        try:
            return self._take(record)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            raise LogError("the record is damaged (%r)" % error) from None
        except NetError as error:
            raise LogError("the record is not of this plan (%s)" % error) from None

    def _take(self, record: Record) -> Optional[Replayed]:
        if record["kind"] == "snapshot":
            # a snapshot that was kept as a starting point changes nothing
            if record["slot"] != self.state.next_slot - 1:
                self.state = self._first.state_from_json(record["state"])
                self.game = self._first.now(self.state)
                return Replayed(record["slot"], (), [], self.state, record, True)
        elif record["kind"] == "reset":
            self.game, self.state = self._first, self._first.new_state()
        elif record["kind"] == "slot":
            step = _replay_slot(self.game, self.state, record)
            self.game = self._first.now(self.state)
            return step
        return None


def replay(event_log: EventLog) -> Iterator[Replayed]:
    """Replay the slots of a log, one by one, with the token game.

    :raises LogError: a record is damaged; or a slot is missing, does not hold entries, or leads to
        other firings than those it recorded.
    """
    plan = event_log.plan
    replayer = Replayer(TokenGame(plan, agents=bool(event_log.header.get("agents"))))
    for number, record in enumerate(event_log.records, 2):
        try:
            step = replayer.take(record)
        except LogError as error:
            raise error.located(file=event_log.path, line=number) from None
        if step is not None:
            yield step


def _replay_slot(game: TokenGame, state: TeamState, record: Record) -> Replayed:
    slot = record["slot"]
    if slot != state.next_slot:
        raise LogError("slot %s follows where slot %d should" % (slot, state.next_slot))
    batch = tuple(log_entries.from_json(e) for e in record["entries"])
    step = game.reduce(state, slot, batch)
    recorded = [
        firing_from_json(f, step.game_of(i, game).net) for i, f in enumerate(record["firings"])
    ]
    if step.firings != recorded:
        raise LogError("slot %d leads to other firings than it recorded" % slot)
    return Replayed(slot, batch, step.firings, state, record, False, step.commands, step.adopted)
