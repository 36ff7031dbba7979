"""Actions that run programs on the robot's computer, without ROS."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import select
import signal
import subprocess
import threading
from typing import IO, Any, Dict, List, Optional, Set

from gspn_framework_package.execution.actions import ActionContext, ActionFailed, ActionResult
from gspn_framework_package.model.action import CommandAction
from gspn_framework_package.model.data import VALUE_LIMIT, check_values, fill
from gspn_framework_package.model.errors import DataError
from gspn_framework_package.model.outcome import Outcome

_LOOK_EVERY = 0.1
"""Seconds between two checks of a program that has closed its output or passed it to its
children."""

_DYING = 10.0
"""Maximum number of seconds to wait for a killed program to end: a busy machine takes a while to
end it."""

READ_SIZE = 65_536
"""Number of bytes read at once."""

PIPE_SIZE = 1_048_576
"""Maximum capacity of a pipe on Linux, in bytes."""


class Command:
    """A command, ready to be run for any robot.

    It runs in the plan's folder, without a shell and without input. Its environment has
    ``GSPN_ROBOT``, ``GSPN_PLACE``, ``GSPN_VISIT`` and ``GSPN_ATTEMPT``. When a command is
    cancelled, its whole process group gets SIGTERM, and SIGKILL if it does not end.

    :param action: the command in the plan.
    :param folder: the plan's folder.
    :param grace: seconds between SIGTERM and SIGKILL.
    """

    def __init__(self, action: CommandAction, folder: Optional[str], grace: float) -> None:
        self._action, self._folder, self._grace = action, folder, grace

    def __call__(self, context: ActionContext) -> ActionResult:
        """Run the command until it ends.

        :raises DataError: data that the command refers to is missing, or its last line is not JSON.
        :raises ActionFailed: the command cannot be started, or its exit code is not 0 and the plan
            names no transition for ``aborted``.
        """
        words = [_word(part) for part in fill(self._action.command, context.data)]
        given = {
            "GSPN_ROBOT": context.robot,
            "GSPN_PLACE": context.place,
            "GSPN_VISIT": str(context.visit),
            "GSPN_ATTEMPT": str(context.attempt),
        }
        with _starting:
            try:
                process = subprocess.Popen(
                    words,
                    cwd=self._folder,
                    env={**os.environ, **given},
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    start_new_session=True,
                )
            except (OSError, ValueError) as error:
                text = error.strerror if isinstance(error, OSError) else str(error)
                raise ActionFailed("'%s' cannot be started: %s" % (words[0], text)) from None
            killer = _Killer(process, self._grace)
            _running.add(killer)
        context.is_cancelled.on_cancel(killer.end)
        try:
            output, errors = _last_lines(process)
        finally:
            _running.discard(killer)
            killer.over()
        if context.is_cancelled():
            raise ActionFailed("'%s' was cancelled" % words[0])
        outcomes = self._action.outcomes
        if process.returncode == 0:
            return ActionResult(outcomes.get(Outcome.SUCCEEDED, ""), self._data(output))
        if Outcome.ABORTED in outcomes:
            return ActionResult(outcomes[Outcome.ABORTED], {})
        code = process.returncode
        how = "exit code %d" % code if code > 0 else "signal %d" % -code
        raise ActionFailed("'%s': %s%s" % (words[0], how, ": " + errors if errors else ""))

    def _data(self, line: str) -> Dict[str, Any]:
        if not self._action.keep:
            return {}
        try:
            value = json.loads(line)
        except (ValueError, RecursionError):
            raise DataError(
                "the last line of the output is not JSON, so '%s' is not written: %.100r"
                % (self._action.keep, line)
            ) from None
        return check_values({self._action.keep: value})


def _word(value: Any) -> str:
    """Format an argument: text unchanged, any other value as JSON."""
    return value if isinstance(value, str) else json.dumps(value)


class _Killer:
    """Ends a program that is cancelled, with its process group."""

    def __init__(self, process: subprocess.Popen[bytes], grace: float) -> None:
        self._process, self._grace = process, grace
        self._lock = threading.Lock()
        self._over = False
        self._timer: Optional[threading.Timer] = None

    def end(self) -> None:
        """Send SIGTERM, and SIGKILL after the grace period."""
        with self._lock:
            if self._over or self._timer is not None:
                return
            self._timer = threading.Timer(self._grace, self._kill)
            self._timer.daemon = True
            self._signal(signal.SIGTERM)
            self._timer.start()

    def over(self) -> None:
        """Note that the program has ended. If it was cancelled, end the processes that it left
        running."""
        with self._lock:
            self._over = True
            if self._timer is not None:
                self._timer.cancel()
                self._signal(signal.SIGKILL)

    def _kill(self) -> None:
        with self._lock:
            if not self._over:
                self._signal(signal.SIGKILL)

    def _signal(self, number: int) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, number)

    def finish(self) -> None:
        """End the program, and wait for its end."""
        self.end()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(self._grace)
        self._kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_DYING)


_running: Set[_Killer] = set()
"""The running programs; they are ended with this process, unless it is killed."""


_starting = threading.Lock()
"""Held while a program starts, so that each that has started is in ``_running``."""


@atexit.register
def _end_all() -> None:
    _starting.acquire()  # for good: no program starts any more
    for killer in list(_running):
        killer.finish()


def _last_lines(process: subprocess.Popen[bytes]) -> List[str]:
    """Wait until a program has ended, and return the last lines of its output and errors. Children
    that it leaves behind may keep both streams open."""
    assert process.stdout is not None and process.stderr is not None
    streams = [_LastLine(process.stdout), _LastLine(process.stderr)]
    open_ones = list(streams)
    while open_ones:
        if process.poll() is not None:
            for stream in open_ones:
                stream.drain()
            break
        ready, _, _ = select.select(open_ones, [], [], _LOOK_EVERY)
        for stream in ready:
            if not stream.read():
                open_ones.remove(stream)
    process.wait()
    for stream in streams:
        stream.close()
    return [stream.text for stream in streams]


class _LastLine:
    """Finds the last non-empty line of a stream, cutting off its beginning if it is too long."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._line = self._begun = b""

    def fileno(self) -> int:
        return self._stream.fileno()

    def read(self) -> bool:
        """Read what is available; False at the end of the stream."""
        data = os.read(self._stream.fileno(), READ_SIZE)
        *lines, self._begun = (self._begun + data).split(b"\n")
        self._begun = self._begun[-4 * VALUE_LIMIT :]
        self._line = next((line for line in reversed(lines) if line.strip()), self._line)
        return bool(data)

    def drain(self) -> None:
        """Read what an ended program left in the pipe: at most its capacity, since a child may
        still be writing."""
        for _ in range(PIPE_SIZE // READ_SIZE + 1):
            if not select.select([self], [], [], 0)[0] or not self.read():
                return

    @property
    def text(self) -> str:
        line = self._begun if self._begun.strip() else self._line
        return line.decode(errors="replace").strip()

    def close(self) -> None:
        self._stream.close()
