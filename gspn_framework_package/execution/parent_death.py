"""Processes that do not outlive the one that started them, however that one ends."""

from __future__ import annotations

import ctypes
import os
import sys

_SET_PARENT_DEATH_SIGNAL = 1  # prctl(2)


def end_with_parent(parent: int, number: int) -> bool:
    """Have the kernel send this process a signal when its parent has ended.

    Linux counts the thread of the parent that started this process: it must last as long. On other
    systems this does nothing.

    :param parent: the process id of the parent, as the parent knows it.
    :param number: the signal.
    :returns: whether the parent is still there.
    """
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, number)
    return os.getppid() == parent
