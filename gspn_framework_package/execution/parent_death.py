"""Ends a process when its parent ends, however the parent ends."""

from __future__ import annotations

import ctypes
import os
import sys

_SET_PARENT_DEATH_SIGNAL = 1  # prctl(2)


def end_with_parent(parent: int, number: int) -> bool:
    """Have the kernel send this process a signal when its parent has ended.

    On Linux, the signal is sent when the parent's thread that started this process ends, so that
    thread must live as long. Does nothing on other systems.

    :param parent: the process id of the parent, as passed by the parent.
    :param number: the signal.
    :returns: whether the parent is still running.
    """
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, number)
    return os.getppid() == parent
