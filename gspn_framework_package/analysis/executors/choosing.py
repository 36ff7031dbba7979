"""Chooses an executor by name, as ``--on`` of the command line does."""

from __future__ import annotations

from gspn_framework_package.analysis.executors.executor import Executor, LocalExecutor
from gspn_framework_package.model.errors import UsageError

EXECUTOR_FORMS = "local, processes, processes:N or dask:ADDRESS"

_MOST_PROCESSES = 1024


def open_executor(text: str) -> Executor:
    """The executor that ``text`` names, one of :data:`EXECUTOR_FORMS`.

    :raises UsageError: the name is invalid.
    :raises WorkersError: the executor is not available: Dask is not installed or does not answer.
    """
    kind, colon, rest = text.partition(":")
    if text == "local":
        return LocalExecutor()
    if kind == "processes" and (rest or not colon):
        from gspn_framework_package.analysis.executors.processes import ProcessExecutor

        if not colon:
            return ProcessExecutor()
        if rest.isdecimal() and 1 <= int(rest) <= _MOST_PROCESSES:
            return ProcessExecutor(int(rest))
        raise UsageError(
            "--on %.80s: the number of processes must be from 1 to %d" % (text, _MOST_PROCESSES)
        )
    if kind == "dask" and rest:
        from gspn_framework_package.analysis.executors.dask_cluster import DaskExecutor

        return DaskExecutor(rest)
    raise UsageError(
        "--on %.80s: there is no such executor" % text, hint="take %s" % EXECUTOR_FORMS
    )
