"""Limits of the analysis verbs and where they compute, and support for interrupting them."""

from __future__ import annotations

import argparse
import gc
import math
import resource
import threading
from contextlib import contextmanager
from typing import Callable, Iterator, TypeVar

from gspn_framework_package.analysis.executors import EXECUTOR_FORMS, Executor, open_executor
from gspn_framework_package.analysis.limits import (
    DEFAULT_MEMORY,
    DEFAULT_SECONDS,
    LARGE_NET,
    STATE_LIMIT,
    STRUCTURE_LIMIT,
    TREE_LIMIT,
    Limits,
)
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.cli.interrupts import interruptible, leave
from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.model.errors import CancelledError, LimitError, UsageError
from gspn_framework_package.model.plan import Plan

_Result = TypeVar("_Result")

_PATIENCE = 0.5
"""Time (s) that cancelled work has to end by itself."""

_OBJECTS = 200_000
"""Number of new objects after which Python looks for reference cycles, for work with millions of
objects (Python's default: 700)."""


LIMIT_OPTIONS: Arguments = {
    Argument("--limit", "N", int): (
        "maximum number of markings to visit (default %s; fewer in nets of over %s nodes)"
        % (format(STATE_LIMIT, ","), format(LARGE_NET, ","))
    ),
    Argument("--limit-tree", "N", int, TREE_LIMIT): (
        "maximum number of nodes of a coverability tree (default %(default)s)"
    ),
    Argument("--limit-structure", "N", int): (
        "maximum number of steps of each search for invariants, siphons and traps (default %s, "
        "which takes a second or two; down to half in nets of over %s nodes)"
        % (format(STRUCTURE_LIMIT, ","), format(LARGE_NET, ","))
    ),
    Argument("--limit-time", "S", float): (
        "time limit for each part, in seconds (default %g)" % DEFAULT_SECONDS
    ),
    Argument("--limit-memory", "GB", float): "maximum memory (default %.3g)"
    % (DEFAULT_MEMORY / 1e9),
}

PHASES_OPTION: Arguments = {
    Argument("--phases", "N", int): (
        "at most N exponential phases for each duration of a plan (default: as many as make about "
        "100,000 states, or --limit if that is less; all that are needed if they add no states); "
        "docs/analysis.md"
    ),
}

ON_OPTION: Arguments = {
    Argument("--on", "EXECUTOR", default="local"): (
        "where to compute: %s (default %%(default)s); the results are the same" % EXECUTOR_FORMS
    ),
}
"""The executor of long computations."""


def limits_of(args: argparse.Namespace) -> Limits:
    """Return the limits in the arguments. :raises UsageError: a limit is invalid."""
    for option in ("limit", "limit_tree", "limit_structure", "limit_time", "limit_memory"):
        value = getattr(args, option)
        if value is not None and not (value > 0 and math.isfinite(value)):
            raise UsageError(
                "--%s %g: a limit must be greater than 0" % (option.replace("_", "-"), value)
            )
    return Limits(
        args.limit,
        args.limit_tree,
        args.limit_structure,
        DEFAULT_SECONDS if args.limit_time is None else args.limit_time,
        DEFAULT_MEMORY if args.limit_memory is None else int(args.limit_memory * 1e9),
    )


def check_phases(args: argparse.Namespace, subject: object, takes: bool = True) -> None:
    """Check the option ``--phases``.

    :param takes: whether the verb does anything that depends on it.
    :raises UsageError: it does not apply.
    """
    if args.phases is not None and not (takes and isinstance(subject, Plan)):
        raise UsageError("--phases is for the time of a plan: its chain, or its run net")
    if args.phases is not None and args.phases < 1:
        raise UsageError("--phases: at least one phase")


@contextmanager
def rare_collections() -> Iterator[None]:
    """Make Python look for reference cycles rarely.

    A net of 100,000 nodes consists of a few million objects, none of them in a cycle. Scanning them
    repeatedly while their number grows took a fifth of the time to read and analyse the net. A
    separate limit bounds the memory.
    """
    before = gc.get_threshold()
    gc.set_threshold(_OBJECTS, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


def working(
    work: Callable[[Progress, Cancel], _Result], memory: float, option: str = "--limit-memory"
) -> _Result:
    """Do long work with a progress line; an interrupt ends it at once.

    The work runs on another thread, so that an interrupt is handled even while a library's compiled
    code computes.

    :param work: takes a progress callback and a cancel callback, which it polls regularly.
    :param memory: additional memory that this process may use, in bytes.
    :param option: the option that raises the limit; "" for none.
    :raises LimitError: the work needed more memory.
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
            "the work takes more than %.3g GB of memory" % (memory / 1e9),
            hint="raise %s" % option if option else "",
        ) from None
    except CancelledError:
        raise KeyboardInterrupt from None


def working_on(
    on: str,
    work: Callable[[Progress, Cancel, Executor], _Result],
    memory: float,
    option: str = "--limit-memory",
) -> _Result:
    """Do long work like :func:`working`, with the executor named by ``on``."""

    def with_executor(progress: Progress, cancel: Cancel) -> _Result:
        with open_executor(on) as executor:
            return work(progress, cancel, executor)

    return working(with_executor, memory, option)


@contextmanager
def _memory(memory: float) -> Iterator[None]:
    """Limit the additional memory of this process, in bytes."""
    before = resource.getrlimit(resource.RLIMIT_DATA)
    used = 0
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            used = int(file.read().split()[5]) * resource.getpagesize()
    except (OSError, ValueError, IndexError):
        pass  # not Linux: the limit applies to the total
    soft = used + int(memory)
    if before[1] != resource.RLIM_INFINITY:
        soft = min(soft, before[1])
    resource.setrlimit(resource.RLIMIT_DATA, (soft, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)
