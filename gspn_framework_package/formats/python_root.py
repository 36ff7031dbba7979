"""Loads the behaviour tree of py_trees or the state machine of SMACH that a Python file makes.

This runs the file, so it happens only in processes whose operator has allowed it: in the reader,
which writes what it finds as JSON (``python3 -m gspn_framework_package.formats.python_root FILE
NAME ticks|"" OUT``), and in the actions of a plan that was made of it.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import inspect
import json
import os
import sys
import threading
import traceback
from typing import Any, Dict, Iterator, List, Optional, Tuple

from gspn_framework_package.formats.smach_machine import describe_machine, recording
from gspn_framework_package.formats.tree_ticks import NoLeafError, class_name, explore

USUAL_NAMES = ("create_root", "create_tree", "create_machine", "create_state_machine", "main")
"""Functions and variables that are looked for if none is named."""

_Line = Tuple[str, int]
"""A file and a line in it."""


class RootError(Exception):
    """The file has no tree or machine of the given name.

    :param where: the file and line of the fault, if it has one.
    """

    def __init__(self, message: str, where: Optional[_Line] = None, hint: str = "") -> None:
        super().__init__(message)
        self.where = where
        self.hint = hint


class _Found(BaseException):
    """Raised to stop a function before it runs its tree or machine. No ``except Exception`` catches
    it."""

    def __init__(self, root: Any) -> None:
        super().__init__()
        self.root = root


def load_root(
    path: str, wanted: str, module: str, lines: Optional[Dict[int, _Line]] = None
) -> Tuple[str, Any]:
    """Run a file, and return the tree or the machine that one of its functions makes.

    :param path: the file. Its folder becomes one from which modules are imported.
    :param wanted: a variable of it, or a function without parameters, which returns the tree or
        machine, or would run it; "": one of :data:`USUAL_NAMES`, or its only such variable.
    :param module: the name under which the file is imported.
    :param lines: filled in with where each node was made, by its ``id()``.
    :returns: the name that was used, and the root.
    :raises RootError: there is none, or the file fails.
    """
    folder = os.path.dirname(os.path.abspath(path))
    spec = importlib.util.spec_from_file_location(module, path)
    if spec is None or spec.loader is None:
        raise RootError("it is not a Python file")
    loaded = sys.modules[module] = importlib.util.module_from_spec(spec)
    with _failures_of(path), _watched(lines):
        if folder not in sys.path:  # after the imports: it may have a logging.py
            sys.path.insert(0, folder)
        spec.loader.exec_module(loaded)
        name = wanted or _usual_name(vars(loaded))
        if not hasattr(loaded, name):
            raise RootError("there is no '%s' in it" % name)
        root = getattr(loaded, name)
        if library_of(root) is None and callable(root):
            try:
                root = root()
            except _Found as found:
                root = found.root
        root = getattr(root, "root", root)  # of a BehaviourTree
    if library_of(root) is None:
        raise RootError(
            "'%s' makes a %s, neither a tree of py_trees nor a machine of SMACH"
            % (name, type(root).__name__)
        )
    return name, root


def _usual_name(names: Dict[str, Any]) -> str:
    for name in USUAL_NAMES:
        if name in names:
            return name
    found = [name for name, value in names.items() if library_of(value) is not None]
    if len(found) == 1:
        return found[0]
    raise RootError(
        "it has none of %s, and %s variables that are a tree or a machine"
        % (", ".join(USUAL_NAMES), len(found) or "no"),
        hint="--tree NAME: the function that makes it, or the variable that holds it",
    )


def library_of(node: Any) -> Optional[str]:
    """Return the library of a node, ``py_trees`` or ``smach``; None if it is not a node."""
    for name, module, base in (("py_trees", "behaviour", "Behaviour"), ("smach", "state", "State")):
        library = sys.modules.get("%s.%s" % (name, module))
        if library is not None and isinstance(node, getattr(library, base)):
            return name
    return None


@contextlib.contextmanager
def _failures_of(path: str) -> Iterator[None]:
    """Say in one line why a user's file fails, and where."""
    try:
        yield
    except RootError:
        raise
    except (Exception, SystemExit) as error:
        where = None
        if isinstance(error, SyntaxError):
            where = (error.filename or path, error.lineno or 0)
        for frame in traceback.extract_tb(error.__traceback__):
            if os.path.dirname(os.path.abspath(frame.filename)) == os.path.dirname(
                os.path.abspath(path)
            ):
                where = (frame.filename, frame.lineno or 0)
        if isinstance(error, ModuleNotFoundError):
            raise RootError(
                "it needs the Python library '%s', which %s does not have"
                % (error.name, sys.executable),
                where,
            ) from error
        raise RootError("it fails: %s: %s" % (type(error).__name__, error), where) from error


@contextlib.contextmanager
def _watched(lines: Optional[Dict[int, _Line]]) -> Iterator[None]:
    """While this thread loads: note where nodes are made, and stop where the root would run."""
    loading = threading.get_ident()
    replaced: List[Tuple[Any, str, Any]] = []

    def replace(owner: Any, name: str, make: Any) -> None:
        old = getattr(owner, name)
        replaced.append((owner, name, old))
        setattr(owner, name, make(old))

    def noting(old: Any) -> Any:
        def begin(node: Any, *more: Any, **named: Any) -> None:
            if lines is not None and threading.get_ident() == loading:
                lines[id(node)] = _made_at(node)
            old(node, *more, **named)

        return begin

    def stopping(old: Any) -> Any:
        def run(node: Any, *more: Any, **named: Any) -> Any:
            if threading.get_ident() == loading:
                raise _Found(more[0] if more and library_of(node) is None else node)
            return old(node, *more, **named)

        return run

    with contextlib.suppress(ImportError):
        py_trees = importlib.import_module("py_trees")
        replace(py_trees.behaviour.Behaviour, "__init__", noting)
        replace(py_trees.trees.BehaviourTree, "__init__", stopping)
    with contextlib.suppress(ImportError):
        smach = importlib.import_module("smach")
        replace(smach, "logdebug", lambda _: lambda _: None)  # without ROS, it prints
        replace(smach.State, "__init__", noting)
        for name in ("StateMachine", "Concurrence", "Iterator"):
            replace(getattr(smach, name), "execute", stopping)
        smach_ros, rospy = (importlib.import_module(name) for name in ("smach_ros", "rospy"))
        replace(
            smach_ros.SimpleActionState,
            "__init__",
            lambda make: recording(make, always=lines is not None),
        )
        replace(smach_ros.IntrospectionServer, "start", lambda _: lambda *_: None)
        # the robot's node exists already, and the reader only needs a time
        replace(
            rospy,
            "init_node",
            lambda _: lambda *_, **__: rospy.rostime.set_rostime_initialized(True),
        )
    words, sys.argv = sys.argv, sys.argv[:1]  # the arguments of this program are not for the file
    try:
        yield
    finally:
        sys.argv = words
        for owner, name, old in reversed(replaced):
            setattr(owner, name, old)


def _made_at(node: Any) -> _Line:
    """The line that makes a node: outside its own ``__init__``s, and outside its library."""
    frame = inspect.currentframe()
    frame = frame.f_back.f_back if frame is not None and frame.f_back is not None else None
    while frame is not None and frame.f_back is not None:
        code = frame.f_code
        own = code.co_varnames[:1] and frame.f_locals.get(code.co_varnames[0]) is node
        library = frame.f_globals.get("__name__", "").partition(".")[0]
        if not own and library not in ("py_trees", "smach", "smach_ros"):
            break
        frame = frame.f_back
    assert frame is not None
    return frame.f_code.co_filename, frame.f_lineno


def describe_file(path: str, wanted: str, ticks: bool = False) -> Dict[str, Any]:
    """Run a file, and return what it makes: ``kind`` (``py_trees`` or ``smach``), the ``name`` that
    was used, ``root`` (the node, with those below it), and the ``files`` in its folder that it ran,
    relative to it.

    :param wanted: as for :func:`load_root`.
    :param ticks: also find the ``states`` of a tree from tick to tick, as
        :func:`~gspn_framework_package.formats.tree_ticks.explore` returns them.
    :raises RootError: there is no tree or machine, or the file fails.
    """
    lines: Dict[int, _Line] = {}
    name, root = load_root(path, wanted, "the_imported_file", lines)
    kind = library_of(root)
    node = _tree_node(root, lines) if kind == "py_trees" else describe_machine(root, lines)
    folder = os.path.dirname(os.path.abspath(path))
    beside = []
    for module in list(sys.modules.values()):
        file = getattr(module, "__file__", None) or ""
        if file.endswith(".py") and os.path.abspath(file).startswith(folder + os.sep):
            beside.append(os.path.relpath(os.path.abspath(file), folder))
    found: Dict[str, Any] = {"kind": kind, "name": name, "root": node, "files": sorted(set(beside))}
    if ticks:
        if kind != "py_trees":
            raise RootError("a machine of SMACH has no ticks")
        try:
            found["states"] = explore(root)
        except NoLeafError as error:
            raise RootError(str(error), node["line"]) from None
    return found


def _tree_node(node: Any, lines: Dict[int, _Line]) -> Dict[str, Any]:
    found: Dict[str, Any] = {
        "class": class_name(node),
        "name": node.name,
        "line": lines.get(id(node)),
        "children": [_tree_node(child, lines) for child in node.children],
    }
    for key in ("memory", "num_failures", "num_success"):
        found[key] = getattr(node, key, None)
    found["awaited"] = getattr(getattr(node, "succeed_status", None), "name", None)
    return found


def main(words: List[str]) -> None:
    """Write what a file makes, or what is wrong with it."""
    path, wanted, ticks, out = words
    os.dup2(2, 1)  # what the file prints is for people
    try:
        found = describe_file(path, wanted, ticks == "ticks")
    except RootError as error:
        found = {"error": str(error), "where": error.where, "hint": error.hint}
    with open(out, "w", encoding="utf-8") as file:
        json.dump(found, file)
    sys.stdout.flush()
    os._exit(0)  # do not wait for threads that the file has started


if __name__ == "__main__":
    main(sys.argv[1:])
