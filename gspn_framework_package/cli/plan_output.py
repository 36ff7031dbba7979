"""Writes a plan as one file, or as a folder that includes the files that it names."""

from __future__ import annotations

import ast
import filecmp
import os
import shutil
from typing import Any, Iterator, List, Mapping, Sequence, Set

from gspn_framework_package.formats.json_file import json_text
from gspn_framework_package.formats.plan_file import PLAN_FILE
from gspn_framework_package.formats.source import write_bytes
from gspn_framework_package.model.action import CommandAction, FunctionAction
from gspn_framework_package.model.errors import InputError, UsageError
from gspn_framework_package.model.plan import Plan


def plan_path(output: str) -> str:
    """The file to write: ``output``, or ``plan.json`` in it if it is a folder."""
    return os.path.join(output, PLAN_FILE) if _is_folder(output) else output


def _is_folder(output: str) -> bool:
    """Whether a name refers to a folder: an existing one, or a new one, whose name does not end
    with ``.json``. (No command accepts a file without that ending as a plan.)"""
    return os.path.isdir(output) or not (output.lower().endswith(".json") or os.path.exists(output))


def refuse_existing(path: str, hint: str = "give the name of a new file") -> None:
    """Refuse to overwrite a file. :raises UsageError: the file exists."""
    if os.path.exists(path):
        raise UsageError("the file exists already", file=path, hint=hint)


def write_plan(plan: Plan, data: Mapping[str, Any], output: str) -> List[str]:
    """Write the JSON object of a plan, and return notes on what the user still has to do. In a
    folder, the files that it needs are copied next to it; otherwise the notes name them.

    :param plan: the plan, whose functions and programs are needed.
    :param data: its JSON object.
    :param output: a file, or a folder, which is created if necessary.
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
        raise InputError("cannot create the folder (%s)" % error.strerror, file=path) from None


def _bring_functions(plan: Plan, folder: str, copy: bool) -> List[str]:
    """Make sure that ``folder`` has the files that the plan names, and those that they import, and
    return notes on what the user still has to do. Files are copied only if ``copy``."""
    origin = os.path.realpath(plan.folder or "")
    if origin == os.path.realpath(folder):
        return []
    notes, missing = [], []
    for name in sorted(_files_of(plan, origin)):
        source, target = os.path.join(origin, name), os.path.join(folder, name)
        if os.path.exists(target):
            if not (os.path.isfile(target) and filecmp.cmp(source, target, shallow=False)):
                notes.append("%s differs from the file in %s" % (target, origin))
        elif copy and not name.startswith(os.pardir):
            os.makedirs(os.path.dirname(target), exist_ok=True)
            shutil.copyfile(source, target)
        else:
            missing.append(name)
    if missing:
        verb = "belongs" if len(missing) == 1 else "belong"
        notes.append("%s %s beside the plan, in %s" % (", ".join(missing), verb, folder))
    return notes


def _files_of(plan: Plan, folder: str) -> Set[str]:
    """The files in the plan's folder that its actions and events need, relative to the folder:
    modules with their imports from there, and programs with their arguments."""
    found: Set[str] = set()
    functions = [event.function for event in plan.events.values() if event.function]
    for _, action in plan.bindings():
        if isinstance(action, FunctionAction):
            functions.append(action.function)
        elif isinstance(action, CommandAction):
            words = [word for word in action.command if isinstance(word, str)]
            found.update(w for w in words if w and os.path.isfile(os.path.join(folder, w)))
    found = {os.path.normpath(name) for name in found if not os.path.isabs(name)}
    for function in functions:
        within, _, name = function.rpartition("/")  # of a subnet in another folder
        _add_module(found, folder, within, name.rpartition(".")[0])
    return found


def _add_module(found: Set[str], folder: str, within: str, module: str) -> None:
    """Add the files of a module in the subfolder ``within`` the plan's folder, and of the modules
    that it imports from there."""
    parts = module.split(".")
    path = os.path.join(within, *parts)
    for count in range(1, len(parts)):
        if os.path.isfile(os.path.join(folder, within, *parts[:count], "__init__.py")):
            _add_module(found, folder, within, ".".join(parts[:count]))
    for file in (path + ".py", os.path.join(path, "__init__.py")):
        if file in found or not os.path.isfile(os.path.join(folder, file)):
            continue
        found.add(file)
        package = parts if file.endswith("__init__.py") else parts[:-1]
        for imported in _imports(os.path.join(folder, file), package):
            _add_module(found, folder, within, imported)


def _imports(file: str, package: Sequence[str]) -> Iterator[str]:
    """The names of the modules that a file of this package may import."""
    try:
        with open(file, "rb") as source:
            nodes = list(ast.walk(ast.parse(source.read())))
    except (OSError, SyntaxError, ValueError):
        return  # gspn check reports what is wrong with it
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = list(package[: len(package) - node.level + 1]) if node.level else []
            base += node.module.split(".") if node.module else []
            if base:
                yield ".".join(base)
            yield from (".".join([*base, alias.name]) for alias in node.names)
