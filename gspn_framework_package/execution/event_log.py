"""The event log of a run: one file of JSON lines that is the write-ahead log, the event log and the
history at once.

The first line is the *header*: format and version, run, robot, the id of this very log, and the
plan, self-contained, so that a run can be replayed and verified from the log alone. Every other
line is a *record*: a JSON object with its ``kind`` beside its fields, the wall clock (``wall``,
seconds since 1970) and a monotonic clock (``mono``, seconds, comparable between the processes of
one host). Kinds:

==============  ====================================================================================
``slot``        a slot of the agreed log: ``slot``, ``entries``, ``origins`` (who put each in:
                robot, incarnation, sequence number; empty in a local log), the ``firings`` that
                followed, ``hash`` (of the chain), ``ballot`` where a team agreed on it
``snapshot``    the state after slot ``slot``, taken over from a peer or kept as a starting point:
                ``state``, ``seen`` (origin -> newest entry), ``logs`` (robot -> the log with which
                it was let in), ``cast_out`` (robot -> slot of its eviction by force), ``hash``
``reset``       earlier records no longer count (``why``); the log is learnt from the others, and
                has the id ``log`` from here on
``active``      this replica takes part from now on
``life``        the node started: ``incarnation``; ``joining`` where it was not in the first team;
                ``host`` as in the header, ``fsync``: whether the log is written through to the disk
``promised``    acceptor: no ballot below ``ballot`` will be accepted in ``slot`` or later
``accepted``    acceptor: accepted ``batch`` under ``ballot`` in ``slot``
``invoked``     a proposal: what this robot wants in the log: ``entry``, ``origin``
``void``        an ``invoked`` proposal can no longer take effect (``why``)
``private``     partial synchronisation: a move that this robot made on its own: ``entry``,
                ``origin``, ``firing``
``goal``        the goal of an action goes out: ``place``, ``incarnation``, ``visit``, ``attempt``
``cancel``      the goals of visits up to ``visit`` are void
``peer``        first contact with a robot: ``robot``, ``log`` (the id of its log)
``forced``      the operator asserts that these ``robots`` (robot -> incarnation) are off
``ended``       the run is over: ``reason``, ``finished``
==============  ====================================================================================

``kill -9`` may cut the last line: nothing that depends on it has left the process, so a reader
drops it, and a writer that resumes the file removes it first.

The last field of every line, ``sum``, is a running hash over all lines before it and the line
itself, which reveals a line that was changed, dropped or inserted. (Logs of version 1 have none.)
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import time
from typing import Any, BinaryIO, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.firing import Firing, firing_from_json
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json
from gspn_framework_package.model.errors import GspnError, LogError
from gspn_framework_package.model.plan import Plan

FORMAT = "gspn event log"
VERSION = 2
UNSUMMED = 1
"""The version whose lines have no running hash; still read and continued."""

Record = Dict[str, Any]


def header(
    plan: Plan, run: str, robot: str, log_id: str, *, agents: bool = False, host: str = ""
) -> Record:
    """The first line of a log.

    :param run: name of the run.
    :param robot: whose log it is ("" for a standalone run).
    :param log_id: unlike that of any other log, e.g. a random hex string: it distinguishes a robot
        that comes back with its memory from one that lost it.
    :param agents: standalone execution, where transitions may create and destroy tokens.
    :param host: the host and boot that the monotonic clock belongs to (the writer fills it in):
        times of different ones are not compared.
    """
    return {
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


def first_hash(plan: Plan) -> str:
    """The start of a run's hash chain."""
    return plan.hash()


def next_hash(
    previous: str, entries: Sequence[Record], origins: Sequence[Any], firings: Sequence[Record]
) -> str:
    """The next link of the hash chain: over the link before, and a slot's entries, their origins
    and the firings that followed, all as they stand in the log."""
    text = json.dumps([previous, entries, origins, firings], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:32]


class EventLogWriter:
    """Appends records to a log; every record has reached the operating system when
    :meth:`append` returns, so that it outlives the process.

    :param path: the file; its folder is made. An existing file is resumed: a partial last line is
        removed, and the header must be of the same run, robot and plan.
    :param first: the header for a new file (see :func:`header`).
    :param fsync: wait until durable records are on the disk, so that they also outlive the power
        supply.
    :raises LogError: the file belongs to another run, robot or plan, or cannot be written.
    """

    def __init__(self, path: str, first: Record, *, fsync: bool = False) -> None:
        self.path = path
        self._fsync = fsync
        self._sum: Optional[str] = ""
        self._host = _host()
        try:
            os.makedirs(os.path.dirname(os.path.abspath(path)), exist_ok=True)
            known = _repair(path)
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
                    _sync_folder(path)
            except LogError:
                self._file.close()
                raise

    def append(self, *records: Record, durable: bool = True) -> None:
        """Write the records, each with the time of now.

        :param durable: where the log is written through, wait until the disk has them, and all
            before them.
        """
        clocks = {"wall": round(time.time(), 6), "mono": round(time.monotonic(), 6)}
        data = "".join(self._line({**r, **clocks}) for r in records).encode()
        try:
            while data:
                data = data[self._file.write(data) :]
            if self._fsync and durable:
                os.fdatasync(self._file.fileno())
        except OSError as error:
            raise LogError("cannot be written (%s)" % error.strerror, file=self.path) from None

    def _line(self, record: Record) -> str:
        if record["kind"] == "life":
            record = {**record, "host": self._host, "fsync": self._fsync}
        if self._sum is None:
            return json.dumps(record, separators=(",", ":")) + "\n"
        text, self._sum = line_of(record, self._sum)
        return text

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def line_of(record: Record, previous: str) -> Tuple[str, str]:
    """The line of a record, and the running hash after it; ``previous``: the one before it ("" at
    first)."""
    text = json.dumps(record, separators=(",", ":"))
    chain = next_sum(previous, text.encode())
    return '%s,"sum":"%s"}\n' % (text[:-1], chain), chain


def next_sum(previous: str, line: bytes) -> str:
    """The running hash of a log after a line.

    :param line: without its ``sum``.
    """
    return hashlib.sha256(previous.encode() + line).hexdigest()[:16]


_SUM = re.compile(rb',"sum":"([0-9a-f]{16})"}\n?$')


def _without_sum(line: bytes) -> Tuple[bytes, str]:
    """A line without its running hash, and that."""
    found = _SUM.search(line)
    if found is None:
        return line, ""
    return line[: found.start()] + b"}", found.group(1).decode()


def _last_sum(path: str) -> str:
    """The running hash of the last line. :raises LogError: it has none."""
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - 64))
        found = _SUM.search(file.read())
    if found is None:
        raise LogError("the last line has no running hash", file=path, hint=DAMAGED)
    return found.group(1).decode()


def _sync_folder(path: str) -> None:
    """Make the name of a new file outlive the power supply."""
    folder = os.open(os.path.dirname(os.path.abspath(path)), os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def end_is_there(event_log: EventLog) -> bool:
    """Whether the end of a log is certainly there, whatever happened to the machine: the log was
    synced to the disk, or the machine has not been restarted since its last node began."""
    newest = next((r for r in reversed(event_log.records) if r["kind"] == "life"), event_log.header)
    return bool(newest.get("fsync")) or newest.get("host", event_log.header.get("host")) == _host()


def _host() -> str:
    """Which monotonic clock this is: that of one boot of one machine."""
    try:
        with open("/proc/sys/kernel/random/boot_id", encoding="ascii") as file:
            return file.read().strip()
    except OSError:
        return platform.node()


def _repair(path: str) -> Optional[Record]:
    """The header of the file, None if there is no file or no whole line in it; a last line that was
    cut is removed."""
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
    :ivar records: all others, in order.
    :ivar cut: whether a cut last line was dropped.
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
        """The plan that the log carries. :raises LogError: it is not one, or not of that hash."""
        if self._plan is None:
            try:
                plan = plan_from_json(self.header["plan"])
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
        """Whose log it is."""
        return str(self.header["robot"])


def read_log(path: str, size: Optional[int] = None) -> EventLog:
    """Read a log.

    A last line that was cut is dropped (``EventLog.cut``).

    :param size: read that many bytes only: logs that are still being written are read as they were
        at one moment.
    :raises LogError: it cannot be read, is not a log of a version that is known, or has a line that
        is not a record; the message says which.
    """
    records: List[Record] = []
    try:
        with open(path, "rb") as file:
            first = file.readline()
            cut = not first.endswith(b"\n")
            head = _header(first, path)
            chain = "" if head["version"] == UNSUMMED else _follow("", first, path, 1)
            left = (size if size is not None else os.path.getsize(path)) - len(first)
            for number, line in enumerate(file, 2):
                left -= len(line)
                if left < 0 and size is not None:
                    break
                if not line.endswith(b"\n"):
                    cut = True
                    break
                record = _record(line, path, number)
                if chain:
                    chain = _follow(chain, line, path, number)
                records.append(record)
    except OSError as error:
        raise LogError("cannot be read (%s)" % error.strerror, file=path) from None
    return EventLog(path, head, records, cut)


LONGEST_LINE = 64_000_000
"""Bytes; a longer one is not taken for a record."""


class LogFile:
    """A log that is read line by line, when it is needed.

    :param path: the file. :raises LogError: it cannot be read, or is not a log of a version that is
      known.
    :ivar header: its first line. :ivar plan: the plan that it carries. :ivar begin: the byte that
      the records begin at.
    :ivar size: of the file, when it was opened. :ivar cut: whether a last line that was cut has
      been met.
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
        """The file, to be read. :raises LogError: it cannot be."""
        try:
            return open(self.path, "rb")
        except OSError as error:
            raise LogError("cannot be read (%s)" % error.strerror, file=self.path) from None

    def records(self, file: BinaryIO, offset: int, number: int) -> Iterator[Tuple[Record, int]]:
        """The records from byte ``offset`` on, which is where line ``number`` begins, and the
        length of each.

        Of a log that is still being written those are read that were there when it was opened. A
        last line that was cut is left out, and noted in ``cut``.

        :raises LogError: a line is no record, or the file cannot be read any more.
        """
        try:
            file.seek(offset)
            while offset < self.size:
                line = file.readline(min(LONGEST_LINE, self.size - offset))
                offset += len(line)
                if not line.endswith(b"\n"):
                    if len(line) >= LONGEST_LINE:
                        raise LogError("is too long for a record", file=self.path, line=number)
                    self.cut = bool(line)
                    break
                yield _record(line, self.path, number), len(line)
                number += 1
        except OSError as error:
            raise LogError("cannot be read (%s)" % error.strerror, file=self.path) from None


DAMAGED = (
    "a line was changed, dropped or put in; "
    "a robot whose log is moved away learns it from the others, and joins again"
)


class DamagedLogError(LogError):
    """A line of a log does not follow from the lines before it."""


def _follow(chain: str, line: bytes, path: str, number: int) -> str:
    """The running hash after a line. :raises DamagedLogError: the line says another one."""
    text, told = _without_sum(line)
    chain = next_sum(chain, text)
    if told != chain:
        raise DamagedLogError(
            "does not follow from the lines before it", file=path, line=number, hint=DAMAGED
        )
    return chain


def _record(line: bytes, path: str, number: int) -> Record:
    try:
        record = json.loads(line.decode())
    except (ValueError, RecursionError):
        raise LogError("is not JSON: %.80r" % line, file=path, line=number) from None
    if not isinstance(record, dict) or not isinstance(record.get("kind"), str):
        raise LogError("is not a record: %.80r" % line, file=path, line=number)
    record.pop("sum", None)
    return record


def _header(line: bytes, path: str) -> Record:
    hint = "the first line of an event log is its header"
    if not line.strip():
        raise LogError("is empty, not an event log", file=path, hint=hint)
    try:
        head = json.loads(line.decode())
    except ValueError:
        raise LogError("is not an event log", file=path, line=1, hint=hint) from None
    if not isinstance(head, dict) or head.get("format") != FORMAT:
        raise LogError("is not an event log", file=path, line=1, hint=hint)
    if head.get("version") not in (UNSUMMED, VERSION):
        raise LogError(
            "is of version %.20r; this program reads versions %d and %d"
            % (head.get("version"), UNSUMMED, VERSION),
            file=path,
            line=1,
            hint="read it with the version of the package that wrote it",
        )
    for key in ("run", "robot", "log", "plan_hash", "plan"):
        if key not in head:
            raise LogError("the header lacks '%s'" % key, file=path, line=1)
    return head


class Replayed(NamedTuple):
    """A replayed slot of a log; ``state`` is after it, and the next one changes it.

    ``entries`` is empty and ``snapshot`` true where the log took over a snapshot instead.
    """

    slot: int
    entries: Tuple[log_entries.Entry, ...]
    firings: List[Firing]
    state: TeamState
    record: Record
    snapshot: bool = False


class Replayer:
    """Reduces the slots of a log again with the token game, record by record.

    :param game: the rules of the plan.
    :param state: where to start; the state before the run by default.
    """

    def __init__(self, game: TokenGame, state: Optional[TeamState] = None) -> None:
        self._game = game
        self.state = state if state is not None else game.new_state()

    def take(self, record: Record) -> Optional[Replayed]:
        """What the next record of the log changed; None if nothing.

        :raises LogError: a slot is missing, does not hold entries, or leads to other firings than
          those it recorded.
        :raises KeyError: or TypeError, the record is damaged.
        """
        if record["kind"] == "snapshot":
            # one kept as a starting point adds nothing
            if record["slot"] != self.state.next_slot - 1:
                self.state = TeamState.from_json(record["state"], self._game.net)
                return Replayed(record["slot"], (), [], self.state, record, True)
        elif record["kind"] == "reset":
            self.state = self._game.new_state()
        elif record["kind"] == "slot":
            return _replay_slot(self._game, self.state, record)
        return None


def replay(event_log: EventLog) -> Iterator[Replayed]:
    """Reduce the slots of a log again, one by one, with the token game.

    :raises LogError: a slot is missing, does not hold entries, or leads to other firings than those
        it recorded.
    """
    plan = event_log.plan
    replayer = Replayer(TokenGame(plan, agents=bool(event_log.header.get("agents"))))
    for number, record in enumerate(event_log.records, 2):
        try:
            step = replayer.take(record)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            raise LogError(
                "the record is damaged (%r)" % error, file=event_log.path, line=number
            ) from None
        except LogError as error:
            raise error.located(file=event_log.path, line=number) from None
        if step is not None:
            yield step


def _replay_slot(game: TokenGame, state: TeamState, record: Record) -> Replayed:
    slot = record["slot"]
    if slot != state.next_slot:
        raise LogError("slot %s follows where slot %d should" % (slot, state.next_slot))
    batch = tuple(log_entries.from_json(e) for e in record["entries"])
    firings = game.reduce(state, slot, batch).firings
    recorded = [firing_from_json(f, game.net) for f in record["firings"]]
    if firings != recorded:
        raise LogError("slot %d leads to other firings than it recorded" % slot)
    return Replayed(slot, batch, firings, state, record)
