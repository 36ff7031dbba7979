"""The Python modules in the folders of plans: found, loaded, and loaded anew when they changed."""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import importlib.machinery
import importlib.util
import os
import sys
import threading
from types import ModuleType
from typing import Any, Dict, Mapping, Optional, Set, Tuple

from gspn_framework_package.model.errors import PlanError


def load_module(folder: Optional[str], name: str, element: str) -> ModuleType:
    """The module ``name`` of a plan. If a file in the plan's folder changed since it was loaded, it
    is loaded anew; functions that were loaded before keep what they had.

    :param folder: the plan's folder, which is searched first; None if it has none.
    :param element: what the module is for, for messages.
    :raises PlanError: there is no such module, or importing it failed.
    """
    path = os.path.join(os.path.abspath(folder), *name.split(".")) if folder else ""
    for file in (path + ".py", os.path.join(path, "__init__.py")):
        if path and os.path.isfile(file):
            return _load_file(str(folder), file, element)
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
            hint="searched for %s.py in %s, and among the installed modules"
            % (name.replace(".", "/"), folder or "no folder"),
        ) from None
    except Exception as error:
        raise _import_failed(error, None, element) from error


_plan_folders: set[str] = set()
"""Plan folders that were put on ``sys.path``, because their modules may import each other."""


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
"""Held while a file is loaded: no other thread gets a module that is not whole yet."""


def _load_file(folder: str, file: str, element: str) -> ModuleType:
    with _LOADING:
        return _load_file_once(folder, file, element)


_Stamp = Tuple[int, int, int]

_stamps: Dict[str, Tuple[str, str, _Stamp]] = {}
"""Name of a module in a plan's folder -> the folder, its file, and what the file was like when it
was loaded."""


def _stamp(file: str) -> Optional[_Stamp]:
    try:
        found = os.stat(file)
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino


class _FromSource(importlib.machinery.SourceFileLoader):
    """Reads the source alone. What Python keeps of a compiled file has its time in whole seconds,
    and would hide a change."""

    def path_stats(self, path: str) -> Mapping[str, Any]:
        raise OSError("not to be kept")


def _forget_changed(folder: str) -> None:
    """If a file of a plan's folder changed since it was loaded, forget all modules that were loaded
    from there, since they may import each other. What still runs keeps the old ones."""
    there = {name: known for name, known in _stamps.items() if known[0] == folder}
    changed = [file for _, file, stamp in there.values() if _stamp(file) != stamp]
    if not changed:
        return
    for name in there:
        sys.modules.pop(name, None)
        del _stamps[name]
    for file in changed:
        with contextlib.suppress(OSError, NotImplementedError):
            os.unlink(importlib.util.cache_from_source(file))  # its time has whole seconds
    importlib.invalidate_caches()


def _remember_files(folder: str, before: Set[str]) -> None:
    """Remember what the files were like of modules that were just imported from a plan's folder."""
    for name in set(sys.modules) - before:
        file = getattr(sys.modules[name], "__file__", None)
        root = getattr(sys.modules.get(name.partition(".")[0]), "__file__", None)
        if not file or not root or name.partition(".")[0] == __name__.partition(".")[0]:
            continue
        top = os.path.dirname(os.path.abspath(root))
        if os.path.basename(root) == "__init__.py":
            top = os.path.dirname(top)
        stamp = _stamp(file)
        if top == folder and stamp is not None:
            _stamps[name] = folder, file, stamp


def _load_file_once(folder: str, file: str, element: str) -> ModuleType:
    # The name is unique: two plans may both have an actions.py, even in one process.
    digest = hashlib.sha256(os.path.realpath(file).encode()).hexdigest()[:12]
    name = "gspn_plan_%s_%s" % (digest, os.path.splitext(os.path.basename(file))[0])
    folder = os.path.abspath(folder)
    _forget_changed(folder)
    if name in sys.modules:
        return sys.modules[name]
    if folder not in sys.path:
        sys.path.append(folder)  # its modules may import each other, but hide none of Python's own
        _plan_folders.add(folder)
    spec = importlib.util.spec_from_file_location(name, file, loader=_FromSource(name, file))
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    before, stamp = set(sys.modules), _stamp(file)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except PlanError as error:
        del sys.modules[name]
        raise error.located(file=file) from None
    except Exception as error:
        del sys.modules[name]
        raise _import_failed(error, file, element) from error
    except BaseException:  # it is not whole either
        del sys.modules[name]
        raise
    finally:
        _remember_files(folder, before)
        if name in sys.modules and stamp is not None:
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
    )
