"""A robot's process that can be ordered to die while it writes its log.

``python3 -m gspn_framework_package.benchmark.faults.dying_node`` is ``gspn_executor`` with two
additional signals. A process cannot be killed from outside at the exact moment of a write, so it
kills itself with SIGKILL:

- :data:`CUT`: in the next write, of which only a part reaches the file;
- :data:`UNSENT`: after the next write, before the process sends anything that depends on it.
"""

from __future__ import annotations

import os
import random
import signal
import sys
from typing import Any, BinaryIO, List

from gspn_framework_package.execution.event_log import EventLogWriter, Record

CUT, UNSENT = signal.SIGUSR1, signal.SIGUSR2

AT_ONCE = "--cut-the-first-write"
"""An argument of the process: die in its very first write."""


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


def die_when_told(*told_already: int) -> None:
    """Make this process die at its next log write after one of the signals has arrived.

    :param told_already: the signals to treat as received from the start.
    """
    told: List[int] = list(told_already)
    append = EventLogWriter.append

    def append_or_die(self: Any, *records: Record, durable: bool = True) -> None:
        if told:
            self._file = DyingFile(self._file, told[0])
        append(self, *records, durable=durable)

    setattr(EventLogWriter, "append", append_or_die)  # noqa: B010  (mypy lets no method be assigned)
    for number in (CUT, UNSENT):
        signal.signal(number, lambda number, frame: told.append(number))


def main() -> None:
    """Run the execution node of a robot, with its parameters from ROS."""
    from gspn_framework_package.ros import node_main
    from gspn_framework_package.ros.transport import node_process

    die_when_told(*([CUT] if AT_ONCE in sys.argv else []))
    node_process.exit_with(node_main.run_execution_node())


if __name__ == "__main__":
    main()
