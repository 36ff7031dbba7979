"""Processes that are forked from one parent, which has imported everything, and that end with
it."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
import time
import traceback
from typing import Callable, Dict, List, NamedTuple, Optional

from gspn_framework_package.execution.parent_death import end_with_parent

PATIENCE = 10.0
"""Seconds that processes have to shut down when the parent has to end; ``roslaunch`` gives the
parent 15."""

RESPAWN_DELAY = 1.0
"""Seconds until a process that ended is restarted; the launch files use the same for nodes."""

_WATCHED = (signal.SIGCHLD, signal.SIGINT, signal.SIGTERM)


class FamilyMember(NamedTuple):
    """A process to start: its name, for messages, and its work, which returns the exit code."""

    name: str
    body: Callable[[], int]


def run_family(members: List[FamilyMember], respawn: bool = False) -> int:
    """Fork a process for each member, and wait until all have ended. On SIGINT or SIGTERM, all of
    them get SIGTERM; a second signal, or :data:`PATIENCE` seconds, kills them. When this process is
    killed, they also get SIGTERM.

    The parent must have no other thread: a fork does not copy other threads, only the locks that
    they hold.

    :param members: the processes to start.
    :param respawn: whether a process is restarted when it ends, for whatever reason.
    :returns: the largest exit code; 128 + the signal if a signal ended the family.
    :raises RuntimeError: there are other threads.
    """
    if threading.active_count() > 1:
        raise RuntimeError("cannot fork: there are %d threads" % threading.active_count())
    gc.collect()
    gc.freeze()  # objects that exist now are shared: no collection should write to their pages
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, _WATCHED)
    try:
        return _Parent(members, respawn, mask).run()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


class _Parent:
    def __init__(self, members: List[FamilyMember], respawn: bool, mask: object) -> None:
        self._respawn, self._mask = respawn, mask
        self._due: Dict[float, List[FamilyMember]] = {0.0: list(members)}
        self._running: Dict[int, FamilyMember] = {}
        self._ended_by: Optional[int] = None
        self._kill_at = 0.0
        self._code = 0

    def run(self) -> int:
        while self._running or self._due:
            self._start_due()
            received = signal.sigtimedwait(_WATCHED, self._wait())
            if received is not None and received.si_signo != signal.SIGCHLD:
                self._end(received.si_signo)
            elif self._ended_by is not None and time.monotonic() >= self._kill_at:
                self._kill()
            self._reap()
        return self._code if self._ended_by is None else self._code or 128 + self._ended_by

    def _wait(self) -> float:
        times = list(self._due) + ([self._kill_at] if self._ended_by is not None else [])
        return max(0.0, min(times, default=time.monotonic() + 5.0) - time.monotonic())

    def _start_due(self) -> None:
        now = time.monotonic()
        for when in [when for when in self._due if when <= now]:
            for member in self._due.pop(when):
                self._start(member)

    def _start(self, member: FamilyMember) -> None:
        sys.stdout.flush()
        sys.stderr.flush()
        parent = os.getpid()
        pid = os.fork()
        if pid == 0:
            self._be(member, parent)
        self._running[pid] = member

    def _be(self, member: FamilyMember, parent: int) -> None:
        """In the child, do its work and end the process."""
        code = 1
        try:
            family = end_with_parent(parent, signal.SIGTERM)
            signal.pthread_sigmask(signal.SIG_SETMASK, self._mask)  # type: ignore[arg-type]
            if family:  # otherwise it died before the call above took effect
                code = member.body()
        except BaseException:  # no code of the parent may run in the child
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)

    def _reap(self) -> None:
        while self._running:
            pid, status = os.waitpid(-1, os.WNOHANG)
            if pid == 0:
                return
            member = self._running.pop(pid, None)
            if member is None:
                continue
            code = -os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.WEXITSTATUS(status)
            if self._ended_by is not None:
                continue
            if code:
                how = (
                    "was killed by signal %d" % -code
                    if code < 0
                    else "ended with exit code %d" % code
                )
                print("%s %s" % (member.name, how), file=sys.stderr, flush=True)
            if self._respawn:
                self._due.setdefault(time.monotonic() + RESPAWN_DELAY, []).append(member)
            else:
                self._code = max(self._code, code if code >= 0 else 128 - code)

    def _end(self, number: int) -> None:
        """End all processes in order at the first signal, and kill them at the second."""
        self._due.clear()
        if self._ended_by is not None:
            self._kill()
            return
        self._ended_by, self._kill_at = number, time.monotonic() + PATIENCE
        for pid in self._running:
            os.kill(pid, signal.SIGTERM)

    def _kill(self) -> None:
        self._kill_at = time.monotonic() + PATIENCE
        for pid in self._running:
            os.kill(pid, signal.SIGKILL)
