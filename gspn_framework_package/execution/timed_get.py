"""Takes items from queues within a time limit."""

from __future__ import annotations

import queue
from typing import Optional, TypeVar

ItemT = TypeVar("ItemT")


def get_within(source: queue.SimpleQueue[ItemT], timeout: Optional[float]) -> ItemT:
    """Take the next item of a queue from which only this thread takes.

    ``SimpleQueue.get`` of Python 3.8 does not return from a queue that stays empty if the time is
    over before it has begun to wait: with a timeout of 0 s, once in some 20,000 calls. It does not
    look at the time again if a call that does not wait precedes it.

    :param timeout: seconds to wait at most; None: any time.
    :raises queue.Empty: no item came.
    """
    try:
        return source.get_nowait()
    except queue.Empty:
        if timeout is not None and timeout <= 0:
            raise
    return source.get(timeout=timeout)
