"""The event log of a run: a file of JSON lines that serves as write-ahead log and history.

The first line is the *header*: format and version, run, robot, the id of this log, and the complete
plan, so that a run can be replayed and verified from the log alone (a large policy is stored in a
separate file, see ``stored_policy``). Every other line is a *record*: a JSON object with its
``kind``, its fields, the wall clock (``wall``, seconds since 1970) and a monotonic clock (``mono``,
seconds, comparable between the processes of one host). Kinds:

==============  ====================================================================================
``slot``        a slot of the agreed log: ``slot``, ``entries``, ``origins`` (each entry's
                robot, incarnation and sequence number; empty in a local log), the
                ``firings`` that followed, ``hash`` (of the chain), ``ballot`` if a team agreed on
                it
``snapshot``    the state after slot ``slot``, taken over from a peer or kept as a starting point:
                ``state``, ``seen`` (origin -> newest entry), ``logs`` (robot -> the log with which
                it was admitted), ``cast_out`` (robot -> slot of its eviction by force), ``hash``
``reset``       earlier records no longer count (``why``); the robot gets the log from the others,
                and its log has the id ``log`` from here on; ``keep`` if the slots count,
                ``damaged`` if the log was, and its whole file is kept elsewhere
``outage``      the machine lost power, so records may be missing here (``why``); earlier records
                count, and the log has the id ``log`` from here on
``synced``      the first ``bytes`` bytes of the file, with ``length`` slots, are on the disk
``closed``      the process shut down properly, and everything before is on the disk
``active``      this replica takes part from now on
``life``        the node started: ``incarnation``; ``joining`` if it was not in the first team;
                ``host`` as in the header; ``fsync``: whether the log is synced to the disk
``promised``    acceptor: no ballot below ``ballot`` will be accepted in ``slot`` or later; ``torn``
                if the slot needs the votes of all (robot whose log lost its end -> the ids of
                its log and of those that it continues)
``accepted``    acceptor: accepted ``batch`` under ``ballot`` in ``slot``; ``torn`` as above
``invoked``     a proposal of this robot for the log: ``entry``, ``origin``
``offered``     a task reached this robot and waits to get into the log: ``entry``
``order``       an operator gave this robot an order: ``command``, ``robot``, ``argument``
                (shortened), ``operator`` (its name) and ``proof`` (how the
                name was authenticated)
``void``        an ``invoked`` proposal can no longer take effect (``why``)
``private``     partial synchronisation: a local transition of this robot: ``entry``, ``origin``,
                ``firing``
``goal``        the goal of an action is sent: ``place``, ``incarnation``, ``visit``, ``attempt``;
                if the action reads data, ``reads``, a digest of it, and ``resumed_from`` as in
                :class:`~gspn_framework_package.execution.firing.StartAction`
``cancel``      the goals of visits up to ``visit`` are void
``peer``        first contact with a robot: ``robot``, ``log`` (the id of its log); or, with
                ``torn``, its log lost its end: the ids of the logs that this one continues
``forced``      the operator asserts that these ``robots`` (robot -> incarnation) are off
``ended``       the run is over: ``reason``, ``finished``
==============  ====================================================================================

``kill -9`` may truncate the last line. Nothing that depends on that line has left the process, so
readers drop it, and a writer that resumes the file removes it first. What is in this file reads
logs; ``log_writer`` writes them, ``log_damage`` looks for what a loss of power took.

The last field of every line, ``sum``, is a running hash of this line and all lines before it. It
reveals changed, dropped and inserted lines. (Logs of version 1 have none. Version 3 is version 2
with the policy in a separate file.)
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from typing import Any, BinaryIO, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution.stored_policy import hash_of, read_stored, with_policies
from gspn_framework_package.formats.json_file import DEEPEST_JSON, is_too_deep
from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json
from gspn_framework_package.formats.source import open_file
from gspn_framework_package.model.compact_json import compact_sorted
from gspn_framework_package.model.errors import GspnError, LogError
from gspn_framework_package.model.plan import Plan

LOG_FORMAT = "gspn event log"
LOG_VERSION = 2
UNSUMMED = 1
"""The version whose lines have no running hash; still read and continued."""
POLICY_APART = 3
"""The version whose header has only the hash of the policy."""

ORDER_GIVEN = "order"
"""The kind of a record of the giver of an order. Only the robot that received the order has it in
its log; the origin of the entry in the agreed log identifies that robot."""

Record = Dict[str, Any]

KINDS_WITH_PLANS = ("slot", "snapshot", "accepted", "invoked")
"""The kinds of records that can hold a staged plan."""


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
    :param robot: the robot that keeps the log ("" for a standalone run).
    :param log_id: unique to this log, e.g. a random hex string. It distinguishes a robot that
        returns with its log from one that lost it.
    :param agents: whether this is a standalone run, where transitions may create and destroy
        tokens.
    :param host: the host and boot that the monotonic clock belongs to (the writer fills it in).
        Times of different hosts or boots are not compared.
    :param virtual: whether the run is simulated: its clocks are virtual, and start at 0.
    """
    first = {
        "kind": "header",
        "format": LOG_FORMAT,
        "version": LOG_VERSION,
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


def next_sum(previous: str, line: bytes) -> str:
    """The running hash of a log after a line.

    :param previous: the running hash before the line ("" for the first line).
    :param line: the line without its ``sum``.
    """
    return hashlib.sha256(previous.encode() + line).hexdigest()[:16]


SUM = re.compile(rb',"sum":"([0-9a-f]{16})"}\n?$')
"""The end of a line: its running hash."""


def _without_sum(line: bytes) -> Tuple[bytes, str]:
    """A line without its running hash, and that hash ("" if the line has none)."""
    found = SUM.search(line)
    if found is None:
        return line, ""
    return line[: found.start()] + b"}", found.group(1).decode()


class EventLog:
    """The content of a log.

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
        recorded one, or its separately stored policy is missing or was altered."""
        if self._plan is None:
            data = self.header["plan"]
            name = hash_of(data)
            policy = None if name is None else read_stored(self.path, name)
            if policy is not None:
                data = {key: value for key, value in data.items() if key != "policy"}
            try:
                plan = plan_from_json(data, policy=policy)
            except (GspnError, KeyError) as error:
                raise LogError("contains no plan (%s)" % error, file=self.path, line=1) from None
            if plan.hash() != self.header["plan_hash"]:
                raise LogError(
                    "the hash of its plan differs from the recorded one", file=self.path, line=1
                )
            self._plan = plan
        return self._plan

    @property
    def robot(self) -> str:
        """The robot that wrote the log; "" for a standalone run."""
        return str(self.header["robot"])


def read_log(path: str, size: Optional[int] = None) -> EventLog:
    """Read a log.

    A truncated last line is dropped (``EventLog.cut``).

    :param size: read only that many bytes, to read a consistent state of logs that are still being
        written.
    :raises LogError: the file cannot be read, is not a log of a known version, or has a line that
        is not a record, which the message names.
    """
    records: List[Record] = []
    try:
        with open_file(path) as file:
            first = file.readline(LONGEST_LINE)
            cut = not first.endswith(b"\n")
            head = header_of(first, path)
            chain = "" if head["version"] == UNSUMMED else follow_sum("", first, path, 1)
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
                records.append(record_of(line, path, number))
                if chain:
                    chain = follow_sum(chain, line, path, number)
    except OSError as error:
        raise LogError("cannot be read (%s)" % error.strerror, file=path) from None
    return EventLog(path, head, records, cut)


class LogPosition(NamedTuple):
    """The position at which to continue reading a log: byte ``offset``, at which line ``line``
    begins, and the running hash (``sum``) of the lines before it ("" in a log of version 1)."""

    offset: int
    line: int
    sum: str


LONGEST_LINE = 64_000_000
"""Bytes; a longer line is not accepted as a record."""

TOO_LONG = "is too long for a record"


class LogFile:
    """A log that is read line by line, on demand.

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
        self.header = header_of(first, path)
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

        If the log is still being written, only records that existed when it was opened are read. A
        truncated last line is left out and noted in ``cut``.

        :param file: the file, from :meth:`open`.
        :param offset: the byte at which line ``number`` begins.
        :param number: the number of that line, for messages (the header is line 1).
        :raises LogError: a line is not a record, or the file can no longer be read.
        """
        for line in self._lines(file, offset, number):
            yield record_of(line, self.path, number), len(line)
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
        """Yield the records from a position on, each with the position after it, and compare the
        running hash of every line with the recorded one.

        A log that is still being written and a truncated last line are handled as by
        :meth:`records`.

        :param position: where an earlier reader stopped; None for the first record.
        :raises LogError: a line is not a record or does not follow from the lines before it, the
            lines before the position have changed, or the file cannot be read.
        """
        self.cut = False
        with self.open() as file:
            offset, number, chain = position or self._first_position(file)
            if position is not None and not self._has(file, position):
                raise DamagedLogError(
                    "has changed since it was read up to line %d" % (number - 1),
                    file=self.path,
                    hint=DAMAGED,
                )
            for line in self._lines(file, offset, number):
                record = record_of(line, self.path, number)
                if chain:
                    chain = follow_sum(chain, line, self.path, number)
                offset += len(line)
                number += 1
                yield record, LogPosition(offset, number, chain)

    def _first_position(self, file: BinaryIO) -> LogPosition:
        """The position of the first record."""
        summed = self.header["version"] != UNSUMMED
        chain = follow_sum("", file.readline(LONGEST_LINE), self.path, 1) if summed else ""
        return LogPosition(self.begin, 2, chain)

    def _has(self, file: BinaryIO, position: LogPosition) -> bool:
        """Whether the line before a position is unchanged."""
        if position.offset > self.size:
            return False
        file.seek(max(0, position.offset - 64))
        found = SUM.search(file.read(min(64, position.offset)))
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
    """The logs named by files and folders: files as they are, and the logs (``*.jsonl``) in each
    folder.

    :raises LogError: a folder contains no logs.
    """
    found: List[str] = []
    for path in paths:
        if not os.path.isdir(path):
            found.append(path)
            continue
        inside = [name for name in sorted(os.listdir(path)) if name.endswith(".jsonl")]
        if not inside:
            raise LogError("contains no event logs (*.jsonl)", file=path)
        found += [os.path.join(path, name) for name in inside]
    return found


DAMAGED = (
    "a line was changed, dropped or inserted; a robot whose log is moved away gets it from the "
    "others and rejoins"
)


class DamagedLogError(LogError):
    """A line of a log does not follow from the lines before it."""


def follow_sum(chain: str, line: bytes, path: str, number: int) -> str:
    """The running hash after a line. :raises DamagedLogError: the line records a different one."""
    text, recorded = _without_sum(line)
    chain = next_sum(chain, text)
    if recorded != chain:
        raise DamagedLogError(
            "does not follow from the lines before it", file=path, line=number, hint=DAMAGED
        )
    return chain


def _parsed(line: bytes) -> Any:
    """Parse the JSON of a line. :raises ValueError: it is not JSON.
    :raises RecursionError: it is nested too deeply."""
    data = json.loads(line.decode())
    if line.count(b"[") + line.count(b"{") > DEEPEST_JSON and is_too_deep(data):
        raise RecursionError
    return data


def record_of(line: bytes, path: str, number: int) -> Record:
    """The record in a line of a log. :raises LogError: there is none."""
    try:
        record = _parsed(line)
    except (ValueError, RecursionError):
        raise LogError("is not JSON: %.80r" % line, file=path, line=number) from None
    if not isinstance(record, dict) or not isinstance(record.get("kind"), str):
        raise LogError("is not a record: %.80r" % line, file=path, line=number)
    record.pop("sum", None)
    if b'"policy":{"hash":' in line and record["kind"] in KINDS_WITH_PLANS:
        return with_policies(record, path)
    return record


def header_of(line: bytes, path: str) -> Record:
    """The header in the first line of a log. :raises LogError: there is none."""
    hint = "the first line of an event log is its header"
    if not line.strip():
        raise LogError("is empty, not an event log", file=path, hint=hint)
    try:
        head = _parsed(line)
    except (ValueError, RecursionError):
        raise LogError("is not an event log", file=path, line=1, hint=hint) from None
    if not isinstance(head, dict) or head.get("format") != LOG_FORMAT:
        raise LogError("is not an event log", file=path, line=1, hint=hint)
    if head.get("version") not in (UNSUMMED, LOG_VERSION, POLICY_APART):
        raise LogError(
            "has version %.20r; this program reads versions %d to %d"
            % (head.get("version"), UNSUMMED, POLICY_APART),
            file=path,
            line=1,
            hint="use the version of the package that wrote it",
        )
    for key in ("run", "robot", "log", "plan_hash", "plan"):
        if key not in head:
            raise LogError("the header lacks '%s'" % key, file=path, line=1)
    return head


class LogClock:
    """Seconds on a log's own clock, which never decrease: the host's monotonic clock, continued by
    the wall clock when the host restarts.

    :param t: the start time (s); by default the monotonic time of the first record, so that the
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
        mono, wall = clock_reading(record, "mono"), clock_reading(record, "wall")
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

    def by_hour(self, seconds: float) -> Iterator[Tuple[int, float]]:
        """The last ``seconds`` before the last record, cut where an hour ends, as pairs: hour of
        the day (UTC), seconds. Nothing if the log does not say what time it was."""
        end = self._wall
        while end is not None and seconds > 0:
            part = min(seconds, end % 3600 or 3600.0)
            yield int((end - part / 2) // 3600 % 24), part
            end, seconds = end - part, seconds - part

    @property
    def hour(self) -> Optional[int]:
        """The hour of the day (UTC) of the last record, if it is known."""
        return None if self._wall is None else int(self._wall // 3600 % 24)

    def to_json(self) -> List[Any]:
        """The arguments for a clock that continues from here."""
        return [self._t, self._mono, self._wall, self._host]


def clock_reading(record: Record, clock: str) -> Optional[float]:
    """Return what a clock (``wall`` or ``mono``) showed when a record was written; None if that is
    not known."""
    value = record.get(clock)
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None
