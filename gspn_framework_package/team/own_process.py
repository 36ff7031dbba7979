"""Calls a function in a separate, short-lived process, so that a robot's process need not load the
libraries of the analysis."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from typing import Any, Callable, TypeVar

from gspn_framework_package.execution.plan_modules import allow_modules, allowed_modules
from gspn_framework_package.model.errors import ExecutionError, GspnError

_Result = TypeVar("_Result")


def in_own_process(function: Callable[..., _Result], *arguments: Any) -> _Result:
    """Call a function in a separate process and return its result.

    :param function: a module-level function that imports the libraries only when it is called.
    :param arguments: values that can be pickled, such as plans.
    :raises GspnError: the function raised it, or the process ended without a result.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-c", "from %s import be_process; be_process()" % __name__],
            input=pickle.dumps((function, arguments, allowed_modules())),
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            check=False,
        )
    except OSError as error:
        raise ExecutionError("cannot start a process: %s" % error.strerror) from None
    if done.returncode != 0:
        raise ExecutionError(
            "%s ended with exit code %d, without a result"
            % (function.__name__.strip("_"), done.returncode),
            hint="see its output for the reason; perhaps it ran out of memory",
        )
    result = pickle.loads(done.stdout)
    if isinstance(result, GspnError):
        raise result
    return result


def be_process() -> None:
    """Entry point of the separate process: read the call from stdin, and write the result to
    stdout."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # keeps the function's own output out of stdout
    function, arguments, modules = pickle.load(sys.stdin.buffer)
    try:
        allow_modules(modules)
        result = function(*arguments)
    except GspnError as error:
        result = error
    with out:
        pickle.dump(result, out)
