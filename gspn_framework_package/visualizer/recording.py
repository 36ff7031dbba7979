"""An event log as a history that reads from the file on demand: only an index is kept in memory.

The log is read once from beginning to end. At regular intervals, the state of the run (a few
kilobytes) and its position in the file are stored as a *mark*. The events between two marks are
recreated from the file on request.
"""

from __future__ import annotations

import json
import os
import threading
import time
import zlib
from bisect import bisect_right
from collections import OrderedDict
from typing import BinaryIO, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.displayed_data import decided_order_text, order_text
from gspn_framework_package.execution.event_log import ORDER_GIVEN, LogClock, LogFile, Record
from gspn_framework_package.execution.replayer import RECORD_FAULTS, Replayer, unusable
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.compact_json import compact
from gspn_framework_package.model.errors import GspnError, LogError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.visualizer.board import Board, Event, note_event
from gspn_framework_package.visualizer.hub import KeptEvents
from gspn_framework_package.visualizer.team_events import TeamEvents

LINES_BETWEEN = 250
"""Initial number of lines between two marks."""

MARKS = 2048
"""Largest number of marks. Beyond it, every second mark is dropped and the interval doubles."""

AT_HAND = 20_000
"""Largest number of events in the cache of recently requested stretches."""


class Mark(NamedTuple):
    """``n`` events precede line ``line`` of the file, which begins at byte ``offset``; ``packed``
    is the state at that point."""

    n: int
    line: int
    offset: int
    packed: bytes


class _Reader:
    """Reads the lines of a log from a mark on, and turns them into events.

    :param plans: number -> plan that the team followed; updated.
    :ivar board: the board after the events so far.
    """

    def __init__(self, file: LogFile, plans: Dict[int, Plan], mark: Optional[Mark] = None) -> None:
        self._file = file
        self._game = TokenGame(file.plan, agents=bool(file.header.get("agents")))
        self._robot = str(file.header.get("robot", ""))
        self._events = TeamEvents(self._game, plans)
        self.board = self._events.board(running=False, run=str(file.header["run"]))
        self._clock = LogClock(0.0)
        self.line, self.offset = 2, file.begin
        state = None
        if mark is not None:
            kept = json.loads(zlib.decompress(mark.packed))
            self.line, self.offset = mark.line, mark.offset
            self.board = Board.from_json(kept["board"])
            self._clock = LogClock(*kept["clock"])
            state = self._game.state_from_json(kept["state"])
            self._events.restore(kept["events"], self._game.now(state))
        self._replayer = Replayer(self._game, state)

    @staticmethod
    def board_of(mark: Mark) -> Board:
        """The board at a mark."""
        return Board.from_json(json.loads(zlib.decompress(mark.packed))["board"])

    @staticmethod
    def next_slot_of(mark: Mark) -> int:
        """The slot after a mark."""
        return int(json.loads(zlib.decompress(mark.packed))["state"]["next_slot"])

    @property
    def next_slot(self) -> int:
        """The next slot."""
        return self._replayer.state.next_slot

    def mark(self) -> Mark:
        """A mark from which reading can continue here."""
        kept = {
            "board": self.board.to_json(),
            "events": self._events.to_json(),
            "clock": self._clock.to_json(),
            "state": self._replayer.state.to_json(self._replayer.game.net),
        }
        packed = zlib.compress(compact(kept).encode(), 1)
        return Mark(self.board.n, self.line, self.offset, packed)

    def lines(self, file: BinaryIO) -> Iterator[List[Event]]:
        """Yield the events of each further line, numbered and applied to the board.

        :raises LogError: a line does not follow from the ones before; the message gives its number.
        """
        for record, length in self._file.records(file, self.offset, self.line):
            events = self._step(record)
            self.line += 1
            self.offset += length
            for event in events:
                self.board.admit(event)
            yield events

    def _step(self, record: Record) -> List[Event]:
        try:
            step = self._replayer.take(record)
            if step is not None:
                t = self._clock.read(record)
                orders = self._orders_elsewhere(step.entries, record, round(t, 4))
                return orders + self._events.step(
                    step.entries, step.firings, step.state, t, step.adopted
                )
            if record["kind"] == ORDER_GIVEN:
                t = round(self._clock.read(record), 4)
                return [_order_note(record["robot"], order_text(record), t)]
            if record["kind"] == "ended":
                t = round(self._clock.read(record), 4)
                ended = str(record.get("reason", ""))
                state = self._replayer.state
                changes = self._events.status(
                    ended=ended, finished=bool(record.get("finished")), fault=state.fault
                )
                return [{**event, "t": t} for event in changes]
            return []
        except LogError as error:
            raise error.located(line=self.line) from None
        except RECORD_FAULTS as error:
            raise unusable(error).located(line=self.line) from None

    def _orders_elsewhere(
        self, entries: Sequence[log_entries.Entry], record: Record, t: float
    ) -> List[Event]:
        """Notes on the orders in a slot that were given to other robots; the log already has those
        given to its own robot, from when they were given."""
        notes = []
        for entry, origin in zip(entries, record.get("origins", ())):
            text = decided_order_text(entry, str(origin[0]))
            if text and origin[0] != self._robot:
                notes.append(_order_note(getattr(entry, "robot", ""), text, t))
        return notes


def _order_note(robot: str, text: str, t: float) -> Event:
    return {**note_event("info", text, robot), "t": t}


class Recording(KeptEvents):
    """An event log as a history; see the module. All methods may be called from any thread, except
    :meth:`read`, which only one thread may call."""

    def __init__(self, file: LogFile) -> None:
        self._file = file
        self._lock = threading.Lock()
        self._reading = threading.Lock()
        self._plans: Dict[int, Plan] = {}
        first = _Reader(file, self._plans)
        self._marks: List[Mark] = [first.mark()]
        self._between = LINES_BETWEEN
        self._known = 0
        self._complete = False
        self._last: List[Event] = []
        self._looking = 0
        self._stretches: OrderedDict[int, Tuple[Board, List[Event]]] = OrderedDict()

    def first_board(self) -> Board:
        """The board before the run began."""
        return _Reader(self._file, self._plans).board

    def plan_of(self, number: int) -> Optional[Plan]:
        """The plan with that number, which the team followed; None if it has not been read."""
        return self._plans.get(number)

    def read(self) -> Iterator[Tuple[Board, float]]:
        """Read the log. Yield the board so far and the share of the file read (0 to 1) at
        intervals.

        An error in the log becomes a note at its end.
        """
        reader = _Reader(self._file, self._plans)
        size = max(1, self._file.size)
        try:
            with self._file.open() as file:
                for _ in reader.lines(file):
                    while self._looking:
                        time.sleep(0.005)  # viewers take precedence
                    if reader.line - self._marks[-1].line >= self._between:
                        self._keep(reader.mark())
                        yield reader.board.copy(), min(1.0, reader.offset / size)
            if self._file.cut:
                self._append(reader, "warning", "the last line of the log was cut off")
        except GspnError as error:
            where = "%s:%d: " % (os.path.basename(self._file.path), error.line or reader.line)
            self._append(
                reader, "fault", "the log cannot be read further: %s%s" % (where, error.message)
            )
        except Exception as error:
            self._append(
                reader, "fault", "the log cannot be read further: %s" % type(error).__name__
            )
        with self._lock:
            self._known = reader.board.n
            self._complete = True
        yield reader.board.copy(), 1.0

    def _keep(self, mark: Mark) -> None:
        with self._lock:
            self._known = mark.n
            self._marks.append(mark)
            if len(self._marks) > MARKS:
                self._marks = self._marks[::2]
                self._between *= 2
                self._stretches.clear()

    def _append(self, reader: _Reader, level: str, text: str) -> None:
        """Add a note after all events of the file."""
        event = {**note_event(level, text), "t": round(reader.board.t, 4)}
        reader.board.admit(event)
        self._last.append(event)

    # -- looking up --------------------------------------------------------------------------------

    def after_slot(self, slot: int) -> Optional[int]:
        """The number of the last event of a slot of the log, or of the whole log if it ends
        earlier; None if it has not been read that far."""
        with self._lock:
            marks, complete, known = list(self._marks), self._complete, self._known
        low, high = 0, len(marks)
        while high - low > 1:  # the last mark before the slot
            middle = (low + high) // 2
            if _Reader.next_slot_of(marks[middle]) <= slot:
                low = middle
            else:
                high = middle
        if high == len(marks) and not complete:
            return None
        reader = _Reader(self._file, self._plans, marks[low])
        with self._file.open() as file:
            try:
                for _ in reader.lines(file):
                    if reader.next_slot > slot:
                        break
            except LogError:
                pass  # the last event of the log reports the error
        return min(reader.board.n, known) if reader.next_slot > slot else known

    def board_at(self, n: int) -> Board:
        """The board after event ``n``, or after the last one read."""
        with self._lock:
            n = max(0, min(n, self._known))
            at = bisect_right([mark.n for mark in self._marks], n) - 1
            if self._marks[at].n == n:
                return _Reader.board_of(self._marks[at])
        board, events = self._stretch(n)
        board = board.copy()
        for event in events:
            if event["n"] > n:
                break
            board.apply(event)
        return board

    def events(self, after: int, to: int) -> List[Event]:
        """The events numbered above ``after`` and up to ``to`` that have been read."""
        with self._lock:
            to = min(to, self._known)
        found: List[Event] = []
        at = max(0, after)
        while at < to:
            _, events = self._stretch(at + 1)
            new = [event for event in events if at < event["n"] <= to]
            if not new:
                break
            found += new
            at = new[-1]["n"]
        return found

    def _stretch(self, n: int) -> Tuple[Board, List[Event]]:
        """The stretch between two marks that contains event ``n``: the board before it, and its
        events.

        :raises LogError: the file has changed since it was read.
        """
        with self._lock:
            # the last mark before event n: several may lie between the same two events
            at = max(0, bisect_right([mark.n for mark in self._marks], n - 1) - 1)
            mark = self._marks[at]
            end = self._marks[at + 1].n if at + 1 < len(self._marks) else None
            known = self._known
            self._looking += 1
        try:
            return self._made_again(mark, end if end is not None else known)
        finally:
            with self._lock:
                self._looking -= 1

    def _made_again(self, mark: Mark, last: int) -> Tuple[Board, List[Event]]:
        with self._reading:
            kept = self._stretches.get(mark.offset)
            if kept is not None and (kept[1][-1]["n"] if kept[1] else mark.n) >= last:
                self._stretches.move_to_end(mark.offset)
                return kept
            reader = _Reader(self._file, self._plans, mark)
            before = reader.board.copy()
            events: List[Event] = []
            with self._file.open() as file:
                try:
                    for new in reader.lines(file):
                        events += new
                        if reader.board.n >= last:
                            break
                # if the log had this error when it was first read, its last event reports it
                except LogError:
                    pass
            events += [event for event in self._last if event["n"] == reader.board.n + 1]
            if (events[-1]["n"] if events else mark.n) < last:
                raise LogError("the log has changed since it was opened", hint="open it again")
            self._stretches[mark.offset] = (before, events)
            self._stretches.move_to_end(mark.offset)
            while len(self._stretches) > 1 and self._at_hand() > AT_HAND:
                self._stretches.popitem(last=False)
            return before, events

    def _at_hand(self) -> int:
        return sum(len(events) for _, events in self._stretches.values())
