"""Calls a function in a process of its own, which ends with the call: a robot's process does not
carry the libraries of the analysis."""

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
    """The result of a function, called in a process of its own.

    :param function: a function of a module, which imports the libraries only when it is called.
    :param arguments: values that can be pickled, like plans.
    :raises GspnError: what the function raises, or that the process ended without a result.
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
        raise ExecutionError("no process can be started: %s" % error.strerror) from None
    if done.returncode != 0:
        raise ExecutionError(
            "%s ended with exit code %d and without a result"
            % (function.__name__.strip("_"), done.returncode),
            hint="what it printed says why; too little memory?",
        )
    result = pickle.loads(done.stdout)
    if isinstance(result, GspnError):
        raise result
    return result


def be_process() -> None:
    """Be that process: read the call on stdin, and write the result on stdout."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever the function prints must not come between
    function, arguments, modules = pickle.load(sys.stdin.buffer)
    try:
        allow_modules(modules)
        result = function(*arguments)
    except GspnError as error:
        result = error
    with out:
        pickle.dump(result, out)
