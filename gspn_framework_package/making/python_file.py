"""Makes a plan of a Python file that builds a behaviour tree of py_trees or a machine of SMACH.

Trees and machines are built by functions, loops and classes, so only running the file shows what
they are. Another process does that, and only if the operator has allowed it.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from typing import Any, Callable, Dict, Mapping

from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.making.leaf_plan import ImportedPlan
from gspn_framework_package.making.python_machine import plan_of_machine
from gspn_framework_package.making.python_tree import plan_of_ticks, plan_of_tree
from gspn_framework_package.model.errors import InputError, UsageError

LONGEST_READING = 60.0
"""Time limit for a file to build its tree or machine (s)."""

ORIGINAL = "original"
"""The folder within a plan's folder for the file that it was made from and what that imports."""

_READER = "gspn_framework_package.formats.python_root"

_Make = Callable[[str, str, Mapping[str, Any], int], ImportedPlan]

_MAKERS: Mapping[str, _Make] = {"py_trees": plan_of_tree, "smach": plan_of_machine}


def import_python(
    path: str, robots: int = 1, name: str = "", allowed: bool = False, ticks: bool = False
) -> ImportedPlan:
    """Make a plan of a Python file.

    :param path: the file.
    :param robots: number of robots; each runs the tree or machine on its own.
    :param name: the function that makes the tree or machine, or would run it, or the variable that
        holds it; "" for one of the usual names.
    :param ticks: whether each tick of a leaf of a tree is an action.
    :param allowed: whether the operator lets the file run.
    :raises UsageError: the file may not run.
    :raises InputError: it fails, makes no tree or machine, or one that a plan cannot express; the
        error has its line.
    """
    read_bytes(path)
    if not allowed:
        raise UsageError(
            "only running this file shows what it makes",
            file=path,
            hint="--run-file, if you trust it and what it imports",
        )
    found = _read(path, name, ticks)
    if "error" in found:
        file, line = found["where"] or (path, None)
        raise InputError(found["error"], file=file, line=line, hint=found["hint"] or None)
    return plan_of_found(path, found, robots)


def plan_of_found(path: str, found: Mapping[str, Any], robots: int) -> ImportedPlan:
    """Make a plan of the tree or machine that a file makes.

    :param found: what :func:`~gspn_framework_package.formats.python_root.describe_file` returns.
    :raises InputError: a plan cannot express it.
    """
    folder, base = os.path.split(os.path.abspath(path))
    try:
        if "states" in found:
            made = plan_of_ticks(base, found["name"], found["root"], found["states"], robots)
        else:
            made = _MAKERS[found["kind"]](base, found["name"], found["root"], robots)
    except InputError as error:
        raise error.located(file=path) from None
    texts = {
        os.path.join(ORIGINAL, name): read_bytes(os.path.join(folder, name)).decode()
        for name in {base, *found["files"]}
    }
    return made._replace(files={**made.files, **texts})


def _read(path: str, name: str, ticks: bool) -> Dict[str, Any]:
    """The tree or machine that the file makes, read by another process."""
    package = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    paths = (package, os.environ.get("PYTHONPATH"))  # the same package that this process runs
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "found.json")
        words = [sys.executable, "-m", _READER, path, name, "ticks" if ticks else "", out]
        reader = subprocess.Popen(
            words,
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(filter(None, paths)),
                "PYTHONDONTWRITEBYTECODE": "1",  # nothing is written beside the file
            },
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            code = reader.wait(LONGEST_READING)
        except subprocess.TimeoutExpired:
            raise InputError(
                "it has made no tree or machine within %g s" % LONGEST_READING,
                file=path,
                hint="--tree NAME: a function that only makes it",
            ) from None
        finally:  # with the processes that the file has started
            with contextlib.suppress(ProcessLookupError):
                os.killpg(reader.pid, signal.SIGKILL)
            reader.wait()
        try:
            with open(out, "rb") as file:
                return dict(json.load(file))
        except (OSError, ValueError):
            raise InputError(
                "it ended the process that read it (exit code %d)" % code, file=path
            ) from None
