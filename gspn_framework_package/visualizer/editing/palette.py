"""The possible actions of an edited plan: functions in the plan's Python files, plans usable as
subnets, and servers, services and topics live on ROS. No code of the plan is imported or run."""

from __future__ import annotations

import ast
import os
import re
from typing import Any, Dict, Iterator, List, Mapping, Optional

from gspn_framework_package.execution.actions import ACTION_PARAMETERS
from gspn_framework_package.execution.function_source import method_of
from gspn_framework_package.formats.json_file import read_json
from gspn_framework_package.formats.source import open_file
from gspn_framework_package.model.action import ACTION_KINDS
from gspn_framework_package.model.errors import GspnError, UsageError
from gspn_framework_package.visualizer.documents import Folder

MOST_PALETTE_FILES = 100
"""Largest number of Python files of a plan's folder, and of plans, to search."""

_DEPTH = 3
SOURCE_BYTES = 1_000_000
DOC_CHARACTERS = 600
MASTER_SECONDS = 1.0
ACTION_SUFFIXES = ("goal", "cancel", "status", "feedback", "result")
TYPED = ("server", "service", "publish", "wait_for")
"""The kinds of action that have a ROS type."""

_TYPE_NAME = re.compile(r"[A-Za-z]\w{0,99}/[A-Za-z]\w{0,99}", re.ASCII)


def palette(folder: Folder, path: str) -> Dict[str, Any]:
    """Return the palette of a plan.

    :param folder: the served folder; nothing outside it is read.
    :param path: the plan file, relative to that folder.
    :returns: ``functions``, ``plans``, ``kinds`` (the keys that distinguish the kinds of action in
        a plan file), ``types`` (of messages, by kind of action; none without ROS) and ``ros``: None
        if no master answers or ROS is not installed.
    """
    whole = os.path.join(folder.root, os.path.dirname(path))
    return {
        "functions": list(_functions(folder, whole)),
        "plans": list(_plans(folder, whole, path)),
        "kinds": [*ACTION_KINDS, "plan"],
        "types": _types(),
        "ros": _ros(),
    }


def _files(folder: Folder, top: str, ending: str) -> Iterator[str]:
    """The files in a folder and those inside it, as paths relative to it."""
    count = 0
    for at, folders, names in os.walk(top):
        depth = os.path.relpath(at, top).count(os.sep) + (at != top)
        folders[:] = sorted(f for f in folders if f[0] not in "._" and depth + 1 < _DEPTH)
        for name in sorted(names):
            file = os.path.join(at, name)
            if name.endswith(ending) and os.path.isfile(file) and folder.inside(file) is not None:
                count += 1
                if count > MOST_PALETTE_FILES:
                    return
                yield os.path.relpath(file, top)


# -- functions -------------------------------------------------------------------------------------


def _functions(folder: Folder, top: str) -> Iterator[Dict[str, Any]]:
    for file in _files(folder, top, ".py"):
        parts = file[: -len(".py")].split(os.sep)
        if parts[-1] == "__init__":
            parts.pop()
        if not parts or not all(part.isidentifier() for part in parts):
            continue
        try:
            with open_file(os.path.join(top, file)) as source:
                tree = ast.parse(source.read(SOURCE_BYTES + 1)[:SOURCE_BYTES])
        except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
            continue  # the check reports what is wrong with a module that the plan uses
        for node in tree.body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
                found = described_function(node, file, tree)
                if found is not None:
                    yield {"name": ".".join([*parts, node.name]), **found}


def described_function(node: Any, file: str, tree: ast.Module) -> Optional[Dict[str, Any]]:
    """The description of a function, or of a class with callable instances; None for a class
    without."""
    settings: List[Dict[str, Any]] = []
    call: Optional[ast.FunctionDef] = node
    if isinstance(node, ast.ClassDef):
        made, call = method_of(node, "__init__", tree), method_of(node, "__call__", tree)
        if call is None:
            return None
        settings = _parameters(made, True) if made is not None else []
    assert call is not None
    asked = _parameters(call, isinstance(node, ast.ClassDef))
    names = [p["name"] for p in [*asked, *settings]]
    doc = ast.get_docstring(node) or ast.get_docstring(call) or ""
    return {
        "doc": doc if len(doc) <= DOC_CHARACTERS else doc[:DOC_CHARACTERS] + " ...",
        "file": file,
        "line": node.lineno,
        "parameters": [p for p in [*settings, *asked] if p["name"] not in ACTION_PARAMETERS],
        "asks": [name for name in dict.fromkeys(names) if name in ACTION_PARAMETERS],
        "cancellable": "is_cancelled" in names,
        "event": "emit" in names,
    }


def _parameters(function: ast.FunctionDef, bound: bool) -> List[Dict[str, Any]]:
    """The parameters of a function, with the default of each that is a plain value, and its type if
    that is written as a name."""
    arguments = function.args
    listed = [*getattr(arguments, "posonlyargs", []), *arguments.args]
    missing: List[Optional[ast.expr]] = [None] * (len(listed) - len(arguments.defaults))
    pairs = list(zip(listed, [*missing, *arguments.defaults]))[int(bound) :]
    pairs += zip(arguments.kwonlyargs, arguments.kw_defaults)
    found = []
    for argument, default in pairs:
        entry: Dict[str, Any] = {"name": argument.arg, "required": default is None}
        if default is not None:
            try:
                value = ast.literal_eval(default)
            except (ValueError, TypeError, SyntaxError, RecursionError):
                value = None
            if isinstance(value, (bool, int, float, str, type(None))):
                entry["default"] = value
        if isinstance(argument.annotation, ast.Name):
            entry["type"] = argument.annotation.id
        found.append(entry)
    return found


# -- plans -----------------------------------------------------------------------------------------


def _plans(folder: Folder, top: str, own: str) -> Iterator[Dict[str, Any]]:
    """The plans that can be subnets: in the folder of the plan, and in folders inside and next to
    it."""
    tops = [top]
    if os.path.realpath(top) != folder.root:
        tops.append(os.path.dirname(top))
    seen = {os.path.realpath(os.path.join(folder.root, own))}
    for where in tops:
        for name in _files(folder, where, ".json"):
            file = os.path.join(where, name)
            if os.path.realpath(file) in seen:
                continue
            seen.add(os.path.realpath(file))
            found = _plan(file)
            if found is not None:
                yield {"file": os.path.relpath(file, top).replace(os.sep, "/"), **found}


def _plan(file: str) -> Optional[Dict[str, Any]]:
    try:
        if os.path.getsize(file) > SOURCE_BYTES:
            return None
        data = read_json(file)
    except (GspnError, OSError):
        return None
    actions = data.get("actions") if isinstance(data, dict) else None
    if not isinstance(actions, Mapping) or "net" not in data:
        return None
    parameters = data.get("parameters")
    return {
        "name": str(data.get("plan", os.path.basename(file))),
        "places": list(actions),
        "resources": [p for p in data.get("resource_places", ()) if isinstance(p, str)],
        "parameters": list(parameters) if isinstance(parameters, Mapping) else [],
    }


# -- ROS -------------------------------------------------------------------------------------------


def message_fields(kind: str, name: str) -> Dict[str, Any]:
    """Return the fields of the messages of an action.

    :param kind: one of :data:`TYPED`.
    :param name: its type, e.g. ``move_base_msgs/MoveBaseAction``.
    :returns: ``sent`` and ``received``, as of ``action_fields`` in ``ros.message_fields``, and
        ``why``: "", or why the fields are not known.
    :raises UsageError: there is no such kind.
    """
    if kind not in TYPED:
        raise UsageError("actions of the kind '%.50s' have no message" % kind)
    nothing = {"sent": None, "received": None}
    if _TYPE_NAME.fullmatch(name) is None:
        return {**nothing, "why": "'%.100s' is not the name of a type" % name}
    try:
        from gspn_framework_package.ros.message_fields import action_fields
    except ImportError:
        return {**nothing, "why": "this server runs without ROS"}
    try:
        return {**action_fields(kind, name), "why": ""}
    except GspnError as error:
        return {**nothing, "why": error.message}


def _types() -> Dict[str, List[str]]:
    try:
        from gspn_framework_package.ros.message_fields import installed_types
    except ImportError:
        return {}
    return installed_types()


def _ros() -> Optional[Dict[str, Any]]:
    """The action servers, services and topics that are live, with their types; None without a
    master."""
    if not os.environ.get("ROS_MASTER_URI"):
        return None
    try:
        from gspn_framework_package.ros.live_graph import MASTER_ERRORS, live_graph
    except ImportError:
        return None
    try:
        topics, services = live_graph(MASTER_SECONDS)
    except MASTER_ERRORS:
        return None
    actions = [
        {"name": topic[: -len("/goal")], "type": kind[: -len("ActionGoal")] + "Action"}
        for topic, kind in sorted(topics.items())
        if topic.endswith("/goal") and kind.endswith("ActionGoal")
    ]
    hidden = {"%s/%s" % (a["name"], suffix) for a in actions for suffix in ACTION_SUFFIXES}
    return {
        "actions": actions,
        "services": [{"name": name, "type": kind} for name, kind in sorted(services.items())],
        "topics": [
            {"name": name, "type": kind}
            for name, kind in sorted(topics.items())
            if name not in hidden
        ],
    }
