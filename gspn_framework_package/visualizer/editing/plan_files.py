"""The files that a plan needs in addition to its own: functions, and subnets with their nets."""

from __future__ import annotations

import os
from typing import Any, Dict, List

from gspn_framework_package.formats.plan_parts import JsonObject, read_parts
from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.model.errors import GspnError, LimitError
from gspn_framework_package.visualizer.documents import Folder

MOST_PLAN_FILES, MOST_PLAN_BYTES = 300, 20_000_000
"""Largest number of files and of bytes copied with a plan."""


class PlanFiles:
    """The files that belong to a plan.

    :param plan_file: the plan's file, or that of the net that becomes one.
    :param plan: the object of the plan.
    """

    def __init__(self, folder: Folder, plan_file: str, plan: JsonObject) -> None:
        self._folder = folder
        self._place = os.path.dirname(plan_file)
        self._contents: Dict[str, bytes] = {}
        self._plan = plan

    def contents(self) -> Dict[str, bytes]:
        """Path relative to the plan -> content: all Python files in its folder and in packages
        whose functions it uses, and its subnets.

        :raises LimitError: there are too many.
        """
        for name in self._listed(self._place):
            if name.endswith(".py"):
                self._take(name)
        self._follow(self._plan, "", 0)
        return dict(self._contents)

    @staticmethod
    def _listed(place: str) -> List[str]:
        try:
            return sorted(os.listdir(place))
        except OSError:
            return []

    def _follow(self, plan: JsonObject, inside: str, depth: int) -> None:
        """Collect the files that a plan uses; it is in the folder ``inside`` of the outer one."""
        for text in _texts(plan):
            package = os.path.join(inside, text.split(".")[0])
            if "." in text and os.path.isdir(os.path.join(self._place, package)):
                self._take_package(package)
        for action in _values(plan.get("actions")):
            file = action.get("plan") if isinstance(action, dict) else None
            if not isinstance(file, str) or depth > 8:
                continue
            name = os.path.normpath(os.path.join(inside, file))
            path = os.path.join(self._place, name)
            if name in self._contents or not os.path.exists(path):
                continue
            try:
                parts = read_parts(path, self._folder.root)
            except (GspnError, OSError):
                continue
            for needed in parts.files:
                self._take(os.path.relpath(needed, self._place))
            folder = os.path.dirname(name)
            for module in self._listed(os.path.join(self._place, folder)) if folder else ():
                if module.endswith(".py"):
                    self._take(os.path.join(folder, module))
            self._follow(parts.plan, folder, depth + 1)

    def _take_package(self, package: str) -> None:
        for path, folders, names in os.walk(os.path.join(self._place, package)):
            folders[:] = sorted(f for f in folders if not f.startswith((".", "__pycache__")))
            for name in sorted(names):
                if name.endswith(".py"):
                    self._take(os.path.relpath(os.path.join(path, name), self._place))

    def _take(self, name: str) -> None:
        path = os.path.join(self._place, name)
        outside = os.path.normpath(name).startswith(os.pardir)
        if outside or os.path.isabs(name) or name in self._contents:
            return
        if not os.path.isfile(path) or self._folder.inside(path) is None:
            return
        self._contents[name] = read_bytes(path)
        total = sum(map(len, self._contents.values()))
        if len(self._contents) > MOST_PLAN_FILES or total > MOST_PLAN_BYTES:
            raise LimitError(
                "more than %d files or %d MB belong to the plan"
                % (MOST_PLAN_FILES, MOST_PLAN_BYTES // 1_000_000),
                hint="copy the folder instead",
            )


def _values(value: Any) -> List[Any]:
    return list(value.values()) if isinstance(value, dict) else []


def _texts(value: Any) -> List[str]:
    """All texts in the actions and events of a plan, among them the names of functions."""
    if not isinstance(value, dict):
        return []
    found: List[str] = []
    waiting: List[Any] = [value.get("actions"), value.get("robots"), value.get("events")]
    while waiting:
        part = waiting.pop()
        if isinstance(part, dict):
            waiting += part.values()
        elif isinstance(part, list):
            waiting += part
        elif isinstance(part, str):
            found.append(part)
    return found
