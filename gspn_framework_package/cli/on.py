"""``--on``: who computes long work."""

from __future__ import annotations

from typing import Any, Callable, TypeVar

from gspn_framework_package.analysis.executors import EXECUTOR_FORMS, Executor, open_executor
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.cli.limits import working

_Result = TypeVar("_Result")


def add_on_argument(parser: Any) -> None:
    """Declare who computes, on a parser or on a group of its arguments."""
    parser.add_argument(
        "--on",
        default="local",
        metavar="EXECUTOR",
        help="who computes: %s (default %%(default)s); the results are the same" % EXECUTOR_FORMS,
    )


def working_on(
    on: str,
    work: Callable[[Progress, Cancel, Executor], _Result],
    memory: float,
    option: str = "--limit-memory",
) -> _Result:
    """Do long work as :func:`working` does, with the executor that ``on`` names."""

    def with_executor(progress: Progress, cancel: Cancel) -> _Result:
        with open_executor(on) as executor:
            return work(progress, cancel, executor)

    return working(with_executor, memory, option)
