"""How far the verbs of the analysis go, and how they are stopped."""

from __future__ import annotations

import argparse
import gc
import math
import resource
import threading
from contextlib import contextmanager
from typing import Any, Callable, Iterator, TypeVar

from gspn_framework_package.analysis.limits import (
    LARGE_NET,
    MEMORY,
    SECONDS,
    STATE_LIMIT,
    STRUCTURE_LIMIT,
    TREE_LIMIT,
    Limits,
)
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.cli.interrupts import interruptible, leave
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.model.errors import CancelledError, LimitError, UsageError

Result = TypeVar("Result")

_PATIENCE = 0.5
"""Time (s) that cancelled work has to come to its end by itself."""

_OBJECTS = 200_000
"""New objects after which Python looks for reference cycles, where there are millions (its own
number: 700)."""


def add_limit_arguments(parser: Any) -> None:
    """Declare the limits (of a parser or a group of its arguments)."""
    parser.add_argument(
        "--limit",
        type=int,
        metavar="N",
        help="maximum number of markings to visit (default %s; fewer in nets of over %s nodes)"
        % (format(STATE_LIMIT, ","), format(LARGE_NET, ",")),
    )
    parser.add_argument(
        "--limit-tree",
        type=int,
        default=TREE_LIMIT,
        metavar="N",
        help="maximum number of nodes of a coverability tree (default %(default)s)",
    )
    parser.add_argument(
        "--limit-structure",
        type=int,
        default=STRUCTURE_LIMIT,
        metavar="N",
        help="steps of each search for invariants, siphons and traps at most (default "
        "%(default)s: a second or two)",
    )
    parser.add_argument(
        "--limit-time",
        type=float,
        default=SECONDS,
        metavar="S",
        help="longest time of each part, in seconds (default %(default)g)",
    )
    parser.add_argument(
        "--limit-memory",
        type=float,
        default=MEMORY / 1e9,
        metavar="GB",
        help="maximum memory (default %(default).3g)",
    )


def limits_of(args: argparse.Namespace) -> Limits:
    """The limits that the arguments give. :raises UsageError: one makes no sense."""
    for option in ("limit", "limit_tree", "limit_structure", "limit_time", "limit_memory"):
        value = getattr(args, option)
        if value is not None and not (value > 0 and math.isfinite(value)):
            raise UsageError(
                "--%s %g: a limit is a number above 0" % (option.replace("_", "-"), value)
            )
    return Limits(
        args.limit,
        args.limit_tree,
        args.limit_structure,
        args.limit_time,
        int(args.limit_memory * 1e9),
    )


@contextmanager
def rare_collections() -> Iterator[None]:
    """Have Python look for reference cycles seldom.

    A net of 100,000 nodes is some millions of objects, none of them in a cycle; looking through
    them again and again while they become more took a fifth of the time of reading and analysing.
    Memory is bounded by its own limit.
    """
    before = gc.get_threshold()
    gc.set_threshold(_OBJECTS, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


def working(work: Callable[[Progress, Cancel], Result], memory: float) -> Result:
    """Do long work with a progress line, so that an interrupt ends it at once.

    The work is done on another thread: so the interrupt is seen while a library's compiled code
    computes.

    :param work: gets a progress callback, and asks a cancel callback now and then.
    :param memory: bytes that this process may take more than now.
    :raises LimitError: it took more.
    """
    cancelled = threading.Event()
    try:
        with _memory(memory), ProgressLine() as progress:

            def cancel(done: threading.Event) -> None:
                cancelled.set()
                if not done.wait(_PATIENCE):
                    progress.__exit__()
                    leave()

            return interruptible(lambda: work(progress, cancelled.is_set), cancel)
    except MemoryError:
        raise LimitError(
            "it takes more than %.3g GB of memory" % (memory / 1e9), hint="raise --limit-memory"
        ) from None
    except CancelledError:
        raise KeyboardInterrupt from None


@contextmanager
def _memory(memory: float) -> Iterator[None]:
    """Let this process take so many bytes more than now."""
    before = resource.getrlimit(resource.RLIMIT_DATA)
    used = 0
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            used = int(file.read().split()[5]) * resource.getpagesize()
    except (OSError, ValueError, IndexError):
        pass  # not Linux: the limit is for all of it
    soft = used + int(memory)
    if before[1] != resource.RLIM_INFINITY:
        soft = min(soft, before[1])
    resource.setrlimit(resource.RLIMIT_DATA, (soft, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)
