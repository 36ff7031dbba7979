"""A robot's process that can be ordered to die while it writes its log.

``python3 -m benchmarks.faults.dying_node`` is ``gspn_executor`` with two
additional signals. A process cannot be killed from outside at the exact moment of a write, so it
kills itself with SIGKILL:

- :data:`CUT`: in the next write, of which only a part reaches the file;
- :data:`UNSENT`: after the next write, before the process sends anything that depends on it.

With the argument :data:`DEATH` and a file name, it also dies as the :class:`Death` in that file
orders.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import sys
from typing import Any, BinaryIO, List, Optional, Sequence

from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.log_writer import EventLogWriter

CUT, UNSENT = signal.SIGUSR1, signal.SIGUSR2

AT_ONCE = "--cut-the-first-write"
"""An argument of the process: die in its very first write."""


DEATH = "--death="
"""An argument of the process: the file of its :class:`Death`."""


class Death:
    """An order to a process to die when it writes a certain record, kept in a file."""

    def __init__(self, path: str) -> None:
        self._path = path

    def order(self, kind: str, entry: str, cut: bool) -> None:
        """Order it to die at the next record of a ``kind`` that has an ``entry`` of this kind.

        :param cut: in the write, of which only a part reaches the file; otherwise right after it.
        """
        with open(self._path + ".part", "w", encoding="utf-8") as file:
            json.dump([kind, entry, cut], file)
        os.replace(self._path + ".part", self._path)

    def withdraw(self) -> None:
        """Order nothing any more."""
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._path)

    def due(self, records: Sequence[Record]) -> Optional[int]:
        """:data:`CUT` or :data:`UNSENT` if the process has to die at one of these records."""
        try:
            with open(self._path, encoding="utf-8") as file:
                kind, entry, cut = json.load(file)
        except FileNotFoundError:
            return None
        if any(record["kind"] == kind and entry in _entries_of(record) for record in records):
            self.withdraw()
            return CUT if cut else UNSENT
        return None


def _entries_of(record: Record) -> List[str]:
    """The kinds of the entries in a record."""
    entries = [item[0] for item in record.get("batch", ())] + list(record.get("entries", ()))
    if "entry" in record:
        entries.append(record["entry"])
    return [entry["entry"] for entry in entries]


class DyingFile:
    """A file whose next write ends this process.

    :param told: :data:`CUT` or :data:`UNSENT`.
    """

    def __init__(self, file: BinaryIO, told: int) -> None:
        self._file, self._told = file, told

    def write(self, data: bytes) -> int:
        """Write part of ``data``, or all of it, and die."""
        size = random.randrange(1, len(data)) if self._told == CUT else len(data)
        self._file.write(data[:size])
        os.kill(os.getpid(), signal.SIGKILL)
        return size  # never reached


def die_on_signal(*received_already: int, death: Optional[Death] = None) -> None:
    """Make this process die at its next log write after one of the signals has arrived.

    :param received_already: the signals to treat as received from the start.
    :param death: also at the records that it orders.
    """
    told: List[int] = list(received_already)
    append = EventLogWriter.append

    def append_or_die(
        self: Any, *records: Record, durable: bool = True, synced: bool = False
    ) -> None:
        due = death.due(records) if death is not None else None
        if due is not None:
            told.append(due)
        if told:
            self._file = DyingFile(self._file, told[0])
        append(self, *records, durable=durable, synced=synced)

    setattr(EventLogWriter, "append", append_or_die)  # noqa: B010  (mypy lets no method be assigned)
    for number in (CUT, UNSENT):
        signal.signal(number, lambda number, frame: told.append(number))


def main() -> None:
    """Run the execution node of a robot, with its parameters from ROS."""
    from gspn_framework_package.ros import node_main
    from gspn_framework_package.ros.transport import node_process

    deaths = [Death(word[len(DEATH) :]) for word in sys.argv if word.startswith(DEATH)]
    die_on_signal(*([CUT] if AT_ONCE in sys.argv else []), death=deaths[0] if deaths else None)
    node_process.exit_with(node_main.run_execution_node())


if __name__ == "__main__":
    main()
