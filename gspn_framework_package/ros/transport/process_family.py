"""Processes forked from one parent, which has imported everything, and ended with it."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import signal
import sys
import threading
import time
import traceback
from typing import Callable, Dict, List, NamedTuple, NoReturn, Optional

if __name__ != "__main__":  # the waiting program must not import the package
    from gspn_framework_package.execution.parent_death import end_with_parent

ENDING_PATIENCE = 10.0
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
    them get SIGTERM; a second signal, or :data:`ENDING_PATIENCE` seconds, kills them. When this
    process is killed, they also get SIGTERM.

    The parent must have no other thread: a fork does not copy other threads, only the locks that
    they hold. Unless it has to restart processes, the parent replaces itself with a program of the
    same process id that only waits for them; otherwise it would keep its own copy of all memory
    that they change. In that case it does not return, but exits with the code.

    :param members: the processes to start.
    :param respawn: whether a process is restarted when it ends, for whatever reason.
    :returns: the largest exit code; 128 + the signal if a signal ended the family.
    :raises RuntimeError: there are other threads.
    """
    if threading.active_count() > 1:
        raise RuntimeError("cannot fork: there are %d threads" % threading.active_count())
    gc.collect()
    _look_up_in_all_classes()
    gc.freeze()  # existing objects are shared: garbage collection should not write to their pages
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, _WATCHED)
    try:
        return _Parent(members, ENDING_PATIENCE, respawn, mask).run()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _look_up_in_all_classes() -> None:
    """Let Python number all classes for its cache of attributes, as the first look-up in a class
    does. Otherwise each process writes these numbers into pages that it could share."""
    for found in gc.get_objects():
        if issubclass(type(found), type):  # isinstance asks proxies, which answer for their objects
            type.__getattribute__(found, "__init__")  # "__doc__" is found without a look-up


class _Parent:
    def __init__(
        self,
        members: List[FamilyMember],
        patience: float,
        respawn: bool = False,
        mask: object = None,
        running: Optional[Dict[int, FamilyMember]] = None,
    ) -> None:
        self._respawn, self._mask, self._patience = respawn, mask, patience
        self._due: Dict[float, List[FamilyMember]] = {0.0: list(members)}
        self._running = running or {}
        self._ended_by: Optional[int] = None
        self._kill_at = 0.0
        self._code = 0

    def run(self) -> int:
        self._start_due()
        if not self._respawn:
            self._become_small()
        return self.wait()

    def _become_small(self) -> None:
        """Continue in a program without the modules of the processes: :func:`_wait_for`. The
        signals remain blocked there, and those that arrive in the meantime stay pending."""
        names = json.dumps({pid: member.name for pid, member in self._running.items()})
        program = [
            sys.executable,
            "-I",
            "-S",
            os.path.abspath(__file__),
            names,
            str(ENDING_PATIENCE),
        ]
        sys.stdout.flush()
        sys.stderr.flush()
        with contextlib.suppress(OSError):  # on failure, this process waits itself
            os.execv(sys.executable, program + sys.argv)  # extra words for the output of 'ps'

    def wait(self) -> int:
        """Wait until all processes have ended; returns the exit code of the family."""
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
            if family:  # otherwise the parent died before the call above took effect
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
        self._ended_by, self._kill_at = number, time.monotonic() + self._patience
        for pid in self._running:
            os.kill(pid, signal.SIGTERM)

    def _kill(self) -> None:
        self._kill_at = time.monotonic() + self._patience
        for pid in self._running:
            os.kill(pid, signal.SIGKILL)


def _wait_for(names: Dict[str, str], patience: float) -> NoReturn:
    """Wait for processes that this process has forked; exit with the code of the family.

    :param names: process id -> name.
    :param patience: as :data:`ENDING_PATIENCE`.
    """
    running = {int(pid): FamilyMember(name, lambda: 0) for pid, name in names.items()}
    sys.exit(_Parent([], patience, running=running).wait())


if __name__ == "__main__":
    _wait_for(json.loads(sys.argv[1]), float(sys.argv[2]))
