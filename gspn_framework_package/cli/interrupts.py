"""What an interrupt (SIGINT) does: it ends the program at once, whatever it is doing."""

from __future__ import annotations

import os
import signal
import sys
import threading
from typing import Any, Callable, List, NoReturn, TypeVar

Result = TypeVar("Result")

INTERRUPTED = "gspn: interrupted"

EXIT_INTERRUPTED = 130  # 128 + SIGINT, as shells report it


def leave() -> NoReturn:
    """End the process as interrupted, whatever it is doing: compiled code cannot be asked to
    stop."""
    sys.stdout.flush()
    print(INTERRUPTED, file=sys.stderr, flush=True)
    os._exit(EXIT_INTERRUPTED)


class Interrupts:
    """What an interrupt (SIGINT) does: it ends the program on the spot until a verb begins, then it
    is an exception. For the ``with`` statement, on the main thread.

    A compiled module that is interrupted while it imports another prints the KeyboardInterrupt and
    raises an ImportError in its place ("numpy.core.multiarray failed to import"). So while the
    modules of the verb are imported, and there is nothing to tidy up yet, no exception is raised;
    later, ``seen`` tells what an ImportError means.

    :ivar verb_has_begun: to be set then.
    :ivar seen: whether an interrupt came since.
    """

    def __init__(self) -> None:
        self.seen = False
        self.verb_has_begun = False
        self._on = False

    def __enter__(self) -> Interrupts:
        # else: interrupts are ignored, or belong to a program that calls main()
        ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
        if ours and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, self._on_interrupt)
            self._on = True
        return self

    def __exit__(self, *_: Any) -> None:
        if self._on:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def _on_interrupt(self, *_: Any) -> None:
        if not self.verb_has_begun:
            leave()
        self.seen = True
        raise KeyboardInterrupt


def interruptible(
    work: Callable[[], Result], interrupted: Callable[[threading.Event], None] = lambda done: None
) -> Result:
    """What ``work`` returns, or raises; it is done on another thread.

    Python sees an interrupt between two of its own steps only, and compiled code (the parser of
    XML, a linear solver) may take seconds from one to the next. So the main thread does nothing but
    wait.

    :param interrupted: called on an interrupt, before it is raised: with the event that the work
      has come to its end.
    :raises KeyboardInterrupt: there was one; the work may go on until the process ends, and nobody
      waits for it.
    """
    result: List[Result] = []
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
        # not join: an interrupt there has a thread taken for ended (bpo-45274)
        while not done.wait(1.0):
            pass
    except KeyboardInterrupt:
        interrupted(done)
        raise
    if errors:
        raise errors[0]
    return result[0]
