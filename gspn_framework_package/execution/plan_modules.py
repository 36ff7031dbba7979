"""The Python modules with the functions of plans: which ones are allowed, and how they are found,
loaded, and reloaded when they change.

A plan may name functions of its own folder, of modules and folders allowed by the user who starts
the run (:func:`allow_modules`), and of :data:`SHIPPED`. Any other module, such as ``subprocess``,
would let a plan run programs without a line of Python.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib
import importlib.machinery
import importlib.util
import itertools
import os
import re
import sys
import threading
from types import ModuleType
from typing import Any, Dict, Iterable, Mapping, Optional, Tuple

from gspn_framework_package.formats.source import Stamp, file_stamp, is_inside
from gspn_framework_package.model.errors import PlanError, UsageError

SHIPPED = (
    "gspn_framework_package.world.counter",
    "gspn_framework_package.world.parking",
    "gspn_framework_package.world.patrol_actions",
)
"""The modules of this package with functions for plans."""

HOW_TO_ALLOW = (
    "put the function into the plan's folder; or, if you trust it, allow its module or folder when "
    "you start the run: --modules %s, in a launch file modules:=%s"
)

_allowed: Tuple[str, ...] = ()
"""Names of modules, and absolute paths of folders."""


def allow_modules(names: Iterable[str]) -> None:
    """Set the modules that may contain functions of plans in this process, replacing earlier ones.
    The user who starts a run decides this, not a plan or the user who deploys it.

    :param names: ``module``, or ``package`` with all its modules; or a folder with all its files,
        whose name must contain a separator.
    :raises UsageError: a name is neither.
    """
    global _allowed
    found = []
    for name in names:
        if os.sep in name:
            if not os.path.isdir(name):
                raise UsageError("there is no folder '%s'" % name, element="modules")
            name = os.path.realpath(name)
        elif not all(part.isidentifier() for part in name.split(".")):
            raise UsageError(
                "'%s' is not a valid module name" % name,
                element="modules",
                hint="package.module, or a folder with a '/' in its name, such as ./parts",
            )
        found.append(name)
    _allowed = tuple(found)


def names_of(text: str) -> Tuple[str, ...]:
    """Split a list of names such as ``package.module,./parts``, as given to a program."""
    return tuple(name for name in re.split(r"[,\s]+", text) if name)


def allowed_modules() -> Tuple[str, ...]:
    """The modules allowed by :func:`allow_modules`."""
    return _allowed


def is_allowed(name: str) -> bool:
    """Whether plans may name functions of an installed module."""
    return name in SHIPPED or any((name + ".").startswith(known + ".") for known in _allowed)


def is_allowed_file(file: str, folder: Optional[str]) -> bool:
    """Whether a file, after following links, is in the folder of a plan or in an allowed one."""
    folders = [folder] if folder else []
    folders += [known for known in _allowed if os.sep in known]
    return any(is_inside(file, known) for known in folders)


def may_hold_functions(folder: str) -> bool:
    """Whether a deployed plan may name this folder for its functions: it contains a plan file or is
    allowed. (Python's own folders, for example, do not qualify.)"""
    from gspn_framework_package.formats.plan_file import looks_like_plan

    if is_allowed_file(os.path.join(folder, "any"), None):
        return True
    try:
        names = os.listdir(folder)
    except (OSError, ValueError):
        return False
    files = (os.path.join(folder, name) for name in names if name.lower().endswith(".json"))
    return any(looks_like_plan(file) for file in files)


def module_file(folder: Optional[str], within: str, name: str) -> Optional[str]:
    """The file of the module ``name`` of a plan; None if it is not in the plan's folder.

    :param folder: the plan's folder; None if it has none.
    :param within: the module's folder, relative to the plan's; "" for that folder itself.
    :raises PlanError: the file is neither in that folder nor in an allowed one.
    """
    if not folder:
        return None
    path = os.path.join(os.path.abspath(folder), within, *name.split("."))
    for file in (path + ".py", os.path.join(path, "__init__.py")):
        if os.path.isfile(file):
            if is_allowed_file(file, folder):
                return file
            where = os.path.dirname(os.path.realpath(file))
            raise PlanError(
                "the module '%s' is outside the plan's folder, in %s" % (name, where),
                hint=HOW_TO_ALLOW % (where, where),
            )
    return None


def refuse_other_module(name: str) -> None:
    """Refuse an installed module that was not allowed. :raises PlanError: it was not."""
    if not is_allowed(name):
        raise PlanError(
            "the module '%s' is not in the plan's folder and was not allowed" % name,
            hint=HOW_TO_ALLOW % (name, name),
        )


def refuse_foreign_function(function: Any, name: str, folder: Optional[str]) -> None:
    """Refuse a function that a module of the plan imports from a module that is not allowed.

    :param function: the function, class or callable object.
    :param name: the name that the plan gives it.
    :param folder: the plan's folder.
    :raises PlanError: the function comes from such a module.
    """
    while isinstance(function, functools.partial):
        function = function.func
    home = getattr(function, "__module__", None)
    module = sys.modules.get(home) if isinstance(home, str) else None
    if module is not None and is_allowed(module.__name__):
        return
    file = getattr(module, "__file__", None)
    if file is None or not is_allowed_file(file, folder):
        raise PlanError(
            "'%s' is not defined there, but in the module '%s'" % (name, home or "builtins"),
            hint=HOW_TO_ALLOW % ((home or "builtins",) * 2),
        )


def load_module(folder: Optional[str], within: str, name: str, element: str) -> ModuleType:
    """Load the module ``name`` of a plan. If a file in the plan's folder changed since it was
    loaded, it is reloaded; functions loaded earlier are unaffected.

    :param folder: the plan's folder, which is searched first; None if it has none.
    :param within: see :func:`module_file`.
    :param element: what uses the module, for messages.
    :raises PlanError: there is no such module, it is not allowed, or importing it failed.
    """
    try:
        file = module_file(folder, within, name)
        if file is not None:
            with _LOADING:
                return _load_file(os.path.join(str(folder), within), file, element)
        if is_installed(name):
            refuse_other_module(name)
    except PlanError as error:
        raise error.located(element=element) from None
    try:
        if not is_installed(name):
            raise ModuleNotFoundError(name=name)
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or not (name + ".").startswith(error.name + "."):
            raise _import_failed(error, None, element) from error
        raise PlanError(
            "there is no module '%s'" % name,
            element=element,
            hint="searched for %s.py in %s and among the allowed modules"
            % (name.replace(".", "/"), os.path.join(folder or "", within) or "no folder"),
        ) from None
    except Exception as error:
        raise _import_failed(error, None, element) from error


_plan_folders: set[str] = set()
"""Plan folders on ``sys.path``, because their modules may import each other."""


def is_installed(name: str) -> bool:
    """Whether Python can find the module, or the package it is in, outside the folders of other
    plans."""
    try:
        spec = importlib.util.find_spec(name.split(".")[0])
    except (ImportError, ValueError):
        return False
    if spec is None:
        return False
    packages = list(spec.submodule_search_locations or ())
    entries = packages or ([spec.origin] if spec.has_location and spec.origin else [])
    return not entries or any(
        os.path.dirname(os.path.abspath(entry)) not in _plan_folders for entry in entries
    )


_LOADING = threading.RLock()
"""Held while a file is loaded, so that no other thread gets an incomplete module."""


_stamps: Dict[str, Tuple[str, str, Stamp]] = {}
"""Name of a module in a plan's folder -> the folder, its file, and the state of the file when it
was loaded."""


class _FromSource(importlib.machinery.SourceFileLoader):
    """Loads only from source. Python's cache of compiled files stores their time in whole seconds,
    which could hide a change."""

    def path_stats(self, path: str) -> Mapping[str, Any]:
        raise OSError("caching is disabled")


def _forget_changed(folder: str) -> None:
    """If a file of a plan's folder changed since it was loaded, forget all modules loaded from
    there, since they may import each other. Running functions keep the old ones."""
    there = {name: known for name, known in _stamps.items() if known[0] == folder}
    changed = [file for _, file, stamp in there.values() if file_stamp(file) != stamp]
    if not changed:
        return
    for name in there:
        sys.modules.pop(name, None)
        del _stamps[name]
    for file in changed:
        with contextlib.suppress(OSError, NotImplementedError):
            # the finder's cache has a resolution of a second
            os.unlink(importlib.util.cache_from_source(file))
    importlib.invalidate_caches()


def _remember_files(folder: str, loaded: str) -> None:
    """Remember the state of the files that the module ``loaded`` imported from a plan's folder.

    Only the modules after it are looked at: in a forked robot, a look at all of them would copy
    most pages that it shares with the others."""
    for name in list(itertools.takewhile(lambda name: name != loaded, reversed(sys.modules))):
        file = getattr(sys.modules[name], "__file__", None)
        root = getattr(sys.modules.get(name.partition(".")[0]), "__file__", None)
        if not file or not root or name.partition(".")[0] == __name__.partition(".")[0]:
            continue
        top = os.path.dirname(os.path.abspath(root))
        if os.path.basename(root) == "__init__.py":
            top = os.path.dirname(top)
        stamp = file_stamp(file)
        if top == folder and stamp is not None:
            _stamps[name] = folder, file, stamp


def _load_file(folder: str, file: str, element: str) -> ModuleType:
    # The name is unique: two plans may both have an actions.py, even in one process.
    digest = hashlib.sha256(os.path.realpath(file).encode()).hexdigest()[:12]
    name = "gspn_plan_%s_%s" % (digest, os.path.splitext(os.path.basename(file))[0])
    folder = os.path.abspath(folder)
    _forget_changed(folder)
    if name in sys.modules:
        return sys.modules[name]
    if folder not in sys.path:
        # appended: modules may import each other, but must not hide Python's own
        sys.path.append(folder)
        _plan_folders.add(folder)
    spec = importlib.util.spec_from_file_location(name, file, loader=_FromSource(name, file))
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    stamp, whole = file_stamp(file), False
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
        whole = True
    except PlanError as error:
        raise error.located(file=file) from None
    except Exception as error:
        raise _import_failed(error, file, element) from error
    finally:
        _remember_files(folder, name)
        if not whole:
            del sys.modules[name]
        elif stamp is not None:
            _stamps[name] = folder, file, stamp
    return module


def _import_failed(error: Exception, file: Optional[str], element: str) -> PlanError:
    line = error.lineno if isinstance(error, SyntaxError) and error.filename == file else None
    frame = error.__traceback__
    while frame is not None:
        if frame.tb_frame.f_code.co_filename == file:
            line = frame.tb_lineno
        frame = frame.tb_next
    text = error.msg if isinstance(error, SyntaxError) else str(error)
    return PlanError(
        "importing the module failed: %s: %s" % (type(error).__name__, text),
        file=file,
        line=line,
        element=element,
        hint="install '%s' for %s" % (error.name, sys.executable)
        if isinstance(error, ModuleNotFoundError)
        else None,
    )
