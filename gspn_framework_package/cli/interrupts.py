"""Work that an interrupt ends at once, whatever it is doing."""

from __future__ import annotations

import threading
from typing import Callable, List, TypeVar

Result = TypeVar("Result")


def interruptible(
    work: Callable[[], Result], interrupted: Callable[[threading.Event], None] = lambda done: None
) -> Result:
    """What ``work`` returns, or raises; it is done on another thread.

    Python sees an interrupt between two of its own steps only, and compiled code (the parser of XML, a linear solver)
    may take seconds from one to the next. So the main thread does nothing but wait.

    :param interrupted: called on an interrupt, before it is raised: with the event that the work has come to its end.
    :raises KeyboardInterrupt: there was one; the work may go on until the process ends, and nobody waits for it.
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
        while not done.wait(1.0):  # not join: an interrupt there has a thread taken for ended (bpo-45274)
            pass
    except KeyboardInterrupt:
        interrupted(done)
        raise
    if errors:
        raise errors[0]
    return result[0]
