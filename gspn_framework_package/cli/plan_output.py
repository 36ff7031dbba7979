"""Writes a plan as one file, or as a folder with the functions beside it."""

from __future__ import annotations

import os
import shutil
from typing import Any, List, Mapping

from gspn_framework_package.formats.json_file import json_text
from gspn_framework_package.formats.plan_file import PLAN_FILE
from gspn_framework_package.formats.source import write_bytes
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import InputError, UsageError
from gspn_framework_package.model.plan import Plan


def plan_path(output: str) -> str:
    """The file that is meant: ``output``, or the ``plan.json`` in it if it is a folder."""
    return os.path.join(output, PLAN_FILE) if _is_folder(output) else output


def _is_folder(output: str) -> bool:
    """Whether a name stands for a folder: one that exists, or a new one, whose name does not end
    with ``.json``. (No command would take a file without that ending for a plan.)"""
    return os.path.isdir(output) or not (output.lower().endswith(".json") or os.path.exists(output))


def refuse_existing(path: str, hint: str = "give the name of a new file") -> None:
    """Refuse to overwrite a file. :raises UsageError: it exists."""
    if os.path.exists(path):
        raise UsageError("it exists already", file=path, hint=hint)


def write_plan(plan: Plan, data: Mapping[str, Any], output: str) -> List[str]:
    """Write the JSON object of a plan, and return notes on what the user has to do. In a folder the
    files of the functions are put beside it.

    :param plan: the plan, whose functions are needed.
    :param data: its JSON object.
    :param output: a file, or a folder, which is made if necessary.
    :raises InputError: the file cannot be written.
    """
    path = plan_path(output)
    folder = os.path.dirname(os.path.abspath(path))
    as_folder = _is_folder(output)
    if as_folder:
        _make_folder(output)
    notes = _bring_functions(plan, folder, as_folder)
    write_bytes(path, json_text(data).encode())
    return notes


def _make_folder(path: str) -> None:
    try:
        os.makedirs(path, exist_ok=True)
    except OSError as error:
        raise InputError("the folder cannot be made (%s)" % error.strerror, file=path) from None


def _bring_functions(plan: Plan, folder: str, copy: bool) -> List[str]:
    """Make sure that ``folder`` has the files of the plan's functions, and return notes on what the
    user has to do. Files are copied only if ``copy``."""
    modules = {
        action.function.rpartition(".")[0]
        for _, action in plan.bindings()
        if isinstance(action, FunctionAction)
    }
    notes = []
    for module in sorted(modules):
        name = module.replace(".", "/") + ".py"
        source, target = os.path.join(plan.folder or "", name), os.path.join(folder, name)
        if os.path.exists(target) or os.path.realpath(plan.folder or "") == os.path.realpath(
            folder
        ):
            continue
        if copy and os.path.isfile(source):
            os.makedirs(os.path.dirname(target), exist_ok=True)
            shutil.copyfile(source, target)
        elif os.path.exists(source) or os.path.isdir(source[: -len(".py")]):
            notes.append("%s belongs beside the plan, in %s" % (name, folder))
    return notes
