"""Plan files: our own form, and the two input forms of the thesis, told apart by their keys."""

from __future__ import annotations

import os
from typing import Any, Dict, List, Optional, Tuple

from gspn_framework_package.formats import thesis_input
from gspn_framework_package.formats.json_file import read_json
from gspn_framework_package.formats.plan_json import check_schema, plan_from_json, policy_from_json
from gspn_framework_package.formats.registry import read_net_with_notes
from gspn_framework_package.model.errors import GspnError, PlanError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy import Policy

PLAN_FILE = "plan.json"
"""The file that a plan's folder is known by."""


def read_plan(path: str) -> Plan:
    """Read a plan.

    :param path: a plan file, an input file of the thesis (4.1.3, 4.3.6), or a folder with a
        ``plan.json``.
    :returns: the validated plan; ``Plan.notes`` holds what a person should know about how it was
        read.
    :raises GspnError: with file, line and element; nothing is half-loaded.
    """
    path = os.fspath(path)
    if os.path.isdir(path):
        folder, path = path, os.path.join(path, PLAN_FILE)
        if not os.path.isfile(path):
            raise PlanError("there is no %s in that folder" % PLAN_FILE, file=folder)
    try:
        data = read_json(path)
        if not isinstance(data, dict):
            raise PlanError("a plan is a JSON object, not a %s" % type(data).__name__, file=path)
        if thesis_input.is_thesis_input(data):
            return thesis_input.plan_from_thesis(data, path)
        return _own_form(data, path)
    except GspnError as error:
        error.located(file=path)
        raise


def is_plan(path: str) -> bool:
    """Whether ``path`` looks like a plan rather than like a net: a folder, or a JSON file."""
    return os.path.isdir(path) or os.fspath(path).endswith(".json")


def _own_form(data: Dict[str, Any], path: str) -> Plan:
    check_schema(data, file=path)
    folder = os.path.dirname(os.path.abspath(path))
    net, notes = _net(data["net"], folder)
    policy: Optional[Policy] = None
    if isinstance(data.get("policy"), str):
        policy = read_policy(os.path.join(folder, data["policy"]))
    plan = plan_from_json(data, net, policy, file=path, folder=folder)
    return plan.with_notes(notes)


def _net(data: Any, folder: str) -> Tuple[Optional[Net], List[str]]:
    if isinstance(data, str):
        return read_net_with_notes(os.path.join(folder, data))
    if "file" in data:
        return read_net_with_notes(
            os.path.join(folder, data["file"]),
            format=data.get("format"),
            net=data.get("name"),
            constants=data.get("constants", {}),
        )
    return None, []


def read_policy(path: str) -> Policy:
    """Read a policy file. :raises GspnError: not one."""
    try:
        data = read_json(path)
        check_schema(data, "policy", file=path)
        return policy_from_json(data)
    except GspnError as error:
        error.located(file=path)
        raise
