"""``--on``: the executor of long computations."""

from __future__ import annotations

from typing import Callable, TypeVar

from gspn_framework_package.analysis.executors import EXECUTOR_FORMS, Executor, open_executor
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.cli.limits import working
from gspn_framework_package.cli.options import Argument, Arguments

_Result = TypeVar("_Result")


ON_OPTION: Arguments = {
    Argument("--on", "EXECUTOR", default="local"): (
        "where to compute: %s (default %%(default)s); the results are the same" % EXECUTOR_FORMS
    ),
}


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
