"""Handles interrupts (SIGINT), which end the program at once, whatever it is doing."""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from typing import Any, Callable, List, NoReturn, Optional, TypeVar

_Result = TypeVar("_Result")

INTERRUPTED_MESSAGE = "gspn: interrupted"

EXIT_INTERRUPTED = 130  # 128 + SIGINT, as shells report it


def leave() -> NoReturn:
    """Exit at once with the code for an interrupt, since compiled code cannot be asked to stop."""
    sys.stdout.flush()
    print(INTERRUPTED_MESSAGE, file=sys.stderr, flush=True)
    os._exit(EXIT_INTERRUPTED)


class Interrupts:
    """A context manager, for the main thread, that handles interrupts (SIGINT): before a verb
    begins, an interrupt ends the program at once; afterwards it raises KeyboardInterrupt.

    If a compiled module is interrupted while it imports another, it prints the KeyboardInterrupt
    and raises an ImportError instead ("numpy.core.multiarray failed to import"). So no exception is
    raised while the modules of the verb are imported, when there is nothing to clean up yet. Later,
    ``seen`` shows whether an interrupt may have caused an ImportError.

    Python ignores exceptions in callbacks of C libraries and in destructors: while LLVM compiles,
    every interrupt is handled in one. An interrupt that would be lost ends the program at once.

    :param then: the handler of interrupts afterwards.
    :ivar verb_has_begun: the caller sets it when the verb begins.
    :ivar seen: whether there was an interrupt after that.
    """

    def __init__(self, then: Any = signal.default_int_handler) -> None:
        self._then = then
        self.seen = False
        self.verb_has_begun = False
        self._on = False
        self._hook = sys.unraisablehook

    def __enter__(self) -> Interrupts:
        # otherwise interrupts are ignored, or handled by a program that calls main()
        ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
        if ours and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, self._on_interrupt)
            self._on, self._hook = True, sys.unraisablehook
            sys.unraisablehook = self._on_ignored
        return self

    def __exit__(self, *_: Any) -> None:
        if self._on:
            signal.signal(signal.SIGINT, self._then)
            sys.unraisablehook = self._hook

    def _on_ignored(self, ignored: Any) -> None:
        if issubclass(ignored.exc_type, KeyboardInterrupt):
            leave()
        self._hook(ignored)

    def _on_interrupt(self, *_: Any) -> None:
        if not self.verb_has_begun:
            leave()
        self.seen = True
        raise KeyboardInterrupt


def wait_for(event: threading.Event, seconds: Optional[float] = None) -> bool:
    """Wait on the main thread for an event with a timeout in seconds; return whether it is set.

    The system may deliver an interrupt to another thread, which does not wake this one; it
    therefore wakes up once a second. Do not join a thread instead: if that is interrupted, Python
    considers the thread finished (bpo-45274).
    """
    end = math.inf if seconds is None else time.monotonic() + seconds
    while not event.wait(min(1.0, max(0.0, end - time.monotonic()))):
        if time.monotonic() >= end:
            return False
    return True


def interruptible(
    work: Callable[[], _Result], interrupted: Callable[[threading.Event], None] = lambda done: None
) -> _Result:
    """Call ``work`` on another thread, and return its result or raise its exception.

    Python handles an interrupt only between two bytecode instructions, and compiled code (the XML
    parser, a linear solver) may take seconds for one. So the main thread only waits.

    :param interrupted: called on an interrupt, before the exception is raised, with an event that
      is set when the work ends.
    :raises KeyboardInterrupt: there was an interrupt; the work may continue until the process ends,
      but is not waited for.
    """
    result: List[_Result] = []
    errors: List[BaseException] = []
    done = threading.Event()

    def run() -> None:
        try:
            result.append(work())
        except BaseException as error:
            errors.append(error)
        finally:
            done.set()

    thread = threading.Thread(target=run, name="work", daemon=True)
    try:
        thread.start()
        wait_for(done)
    except KeyboardInterrupt:
        interrupted(done)
        raise
    if errors:
        raise errors[0]
    return result[0]
