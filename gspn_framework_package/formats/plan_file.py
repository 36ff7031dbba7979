"""Plan files: the package's own form and the two of the thesis, distinguished by their keys."""

from __future__ import annotations

import json
import os
import re
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

from gspn_framework_package.formats import thesis_input
from gspn_framework_package.formats.draft import ReadOptions
from gspn_framework_package.formats.format import is_xml
from gspn_framework_package.formats.json_file import JsonDocument, read_document
from gspn_framework_package.formats.net_json import net_from_json
from gspn_framework_package.formats.plan_json import (
    LEARNED,
    check_schema,
    plan_from_json,
    plan_to_short_json,
    policy_from_json,
    policy_to_json,
)
from gspn_framework_package.formats.registry import AS_THE_FILE_SAYS, read_net, read_net_with_notes
from gspn_framework_package.formats.source import named_file, open_file, read_bytes
from gspn_framework_package.formats.subnets import expand, fill_parameters
from gspn_framework_package.model.data import kind_of
from gspn_framework_package.model.errors import GspnError, InputError, PlanError, UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy import Policy

PLAN_FILE = "plan.json"
"""The name of the plan file in a plan's folder."""

PLAN_BYTES = 32 << 20
"""Number of bytes of a JSON file to search for the keys of a plan."""

_CHUNK = 1 << 20


def read_plan(path: str, within: Optional[str] = None) -> Plan:
    """Read a plan.

    :param path: a plan file, an input file of the thesis (4.1.3, 4.3.6), or a folder with a
        ``plan.json``.
    :param within: the folder that must contain all files named by the plan and its subnets; None
        for no restriction.
    :returns: the validated plan; ``Plan.notes`` has notes for the user on how it was read.
    :raises GspnError: the plan cannot be read; the error has file, line and element.
    """
    try:
        return _read(*_open(path), within)
    except InputError:
        _refuse_net(path)
        raise


def _plan_or_its_net(path: str, net_will_do: bool, within: Optional[str]) -> NetOrPlan:
    """As :func:`read_plan`, but if an input file of the thesis is to be read as a net, return the
    net."""
    try:
        file, document = _open(path)
        if thesis_input.is_thesis_input(document.data):
            found = _net_of_thesis(file, document, net_will_do, within)
            if found is not None:
                return found
        return _as_found(_read(file, document, within))
    except InputError:
        _refuse_net(path)
        raise


def plan_document(path: str, plan: Plan, folder: str) -> Dict[str, Any]:
    """The JSON object of a plan file, updated with the plan's learned parameters, policy and
    robots; everything else is as in the file.

    :param path: the plan file, or its folder.
    :param plan: the plan that was read from it, possibly with other durations, outcomes, failures,
        rates, policy and robots.
    :param folder: where the object will be written: in another folder, it contains the net and the
        policy themselves instead of the names of their files.
    """
    path, document = _open(path)
    whole = plan_to_short_json(plan)
    if thesis_input.is_thesis_input(document.data):
        return whole
    elsewhere = os.path.realpath(os.path.dirname(os.path.abspath(path))) != os.path.realpath(folder)
    read = _read(path, document, None)
    if plan.subnets and (elsewhere or (plan.policy, plan.robots) != (read.policy, read.robots)):
        return whole  # names of files, or of places that have been replaced, would be wrong
    data = {key: value for key, value in document.data.items() if key not in LEARNED}
    if elsewhere:
        data["net"] = whole["net"]
        if isinstance(data.get("policy"), str):
            data["policy"] = whole["policy"]
    if plan.policy != read.policy:
        data["policy"] = policy_to_json(plan.policy)
    if plan.robots != read.robots:
        data.update(net=whole["net"], robots=whole["robots"])
    data.update({key: whole[key] for key in LEARNED if key in whole})
    return data


def _read(path: str, document: JsonDocument, within: Optional[str]) -> Plan:
    try:
        if thesis_input.is_thesis_input(document.data):
            return thesis_input.plan_from_thesis(document.data, path, within)
        return _own_form(document, path, (os.path.realpath(path),), _Reading(within))
    except GspnError as error:
        error.located(file=path)
        raise


def _refuse_net(path: str) -> None:
    """Report a net that was given in place of a plan. :raises GspnError: the file is a net, or XML
    that cannot be read."""
    if not os.path.isfile(path):
        return
    try:
        read_net(path)
    except GspnError:
        if is_xml(read_bytes(path)):
            raise  # the error in the net says more than "not JSON"
        return
    raise UsageError("this is a net, not a plan", file=path, hint="use gspn analyse for a net")


def file_of(path: str) -> str:
    """Return the plan file in a folder; the path itself if it is not a folder.

    :raises PlanError: there is none in the folder.
    """
    path = os.fspath(path)
    if not os.path.isdir(path):
        return path
    file = os.path.join(path, PLAN_FILE)
    if not os.path.isfile(file):
        raise PlanError("there is no %s in that folder" % PLAN_FILE, file=path)
    return file


def _open(path: str) -> Tuple[str, JsonDocument]:
    """Return the file of a plan, and the JSON object in it. :raises PlanError: there is none."""
    path = file_of(path)
    try:
        document = read_document(path)
    except GspnError as error:
        error.located(file=path)
        raise
    if not isinstance(document.data, dict):
        raise PlanError("a plan is a JSON object, not %s" % kind_of(document.data), file=path)
    return path, document


class NetOrPlan(NamedTuple):
    """A subject of simulation and analysis: a ``net``, the ``plan`` if the net is part of one, and
    ``notes`` for the user on how it was read."""

    net: Net
    plan: Optional[Plan]
    notes: Tuple[str, ...]


def read_net_or_plan(
    path: str,
    options: ReadOptions = AS_THE_FILE_SAYS,
    *,
    net_will_do: bool = False,
    within: Optional[str] = None,
) -> NetOrPlan:
    """Read a plan, like :func:`read_plan`, or a net, like
    :func:`~gspn_framework_package.formats.registry.read_net`. A folder or a JSON file is read as a
    plan, unless the options name a format. From an input file of the thesis that maps no place to
    an action, only the net is read (5.3).

    :param options: how to read a net.
    :param net_will_do: read only the net of an input file of the thesis also if the rest of it is
        not a plan; a note says why.
    :param within: see :func:`read_plan`.
    :raises UsageError: the options set something that the plan itself determines.
    :raises GspnError: the plan or net cannot be read.
    """
    if options.format is None and is_plan(path):
        if options != AS_THE_FILE_SAYS:
            raise UsageError(
                "options for reading a net (its name in the file, constants, servers, weights) "
                "apply only to nets",
                hint="this is a plan, which has its own settings for that",
            )
        return _plan_or_its_net(path, net_will_do, within)
    found, notes = read_net_with_notes(path, options)
    return NetOrPlan(found, None, tuple(notes))


def _as_found(plan: Plan) -> NetOrPlan:
    return NetOrPlan(plan.net, plan, tuple(plan.notes))


def _net_of_thesis(
    path: str, document: JsonDocument, net_will_do: bool, within: Optional[str]
) -> Optional[NetOrPlan]:
    """Return the net of an input file of the thesis that is to be read as a net; None if it is to
    be read as a plan."""
    if not thesis_input.has_mapping(document.data):
        reason = "it maps no place to an action"
    elif net_will_do:
        try:
            return _as_found(_read(path, document, within))
        except GspnError as error:
            reason = ": ".join(filter(None, (error.element, error.message)))
    else:
        return None
    try:
        found = thesis_input.net_from_thesis(document.data, path, within)
    except GspnError as error:
        error.located(file=path)
        raise
    return NetOrPlan(
        found.net, None, found.notes + ("taken for a net, not for a plan: %s" % reason,)
    )


def is_plan(path: str) -> bool:
    """Whether ``path`` looks like a plan rather than a net, that is, a folder or a JSON file."""
    return os.path.isdir(path) or os.fspath(path).lower().endswith(".json")


def looks_like_plan(path: str) -> bool:
    """Whether a JSON file has the keys of a plan; it is parsed only when it is opened. (A computed
    policy of many megabytes may precede the last of them.)"""
    wanted, known, end = {b'"net"', b'"actions"'}, b'"gspn"', b""
    try:
        with open_file(path) as file:
            for _ in range(PLAN_BYTES // _CHUNK):
                chunk = file.read(_CHUNK)
                part = end + chunk
                wanted = {key for key in wanted if key not in part}
                if not wanted or known in part:
                    return True
                if not chunk:
                    return False
                end = part[-16:]
    except OSError:
        pass
    return False


def plan_from_object(data: Mapping[str, Any], path: str, within: Optional[str] = None) -> Plan:
    """Return the plan of a plan file's object, as it will be read after saving.

    :param data: the object, with the net and the policy inside.
    :param path: the plan file. It need not exist; subnets and functions are in its folder.
    :param within: see :func:`read_plan`.
    :raises GspnError: the plan cannot be read; see :func:`read_plan`.
    """
    return _own_form(JsonDocument(data, ""), path, (os.path.realpath(path),), _Reading(within))


class _Reading:
    """The state shared by a plan and its subnets while they are read.

    :ivar within: the folder that must contain all files; None for no restriction.
    :ivar known: the subnets that have been read, by file and parameters.
    """

    def __init__(self, within: Optional[str]) -> None:
        self.within = within
        self.known: Dict[Tuple[str, str], Plan] = {}


def _own_form(
    document: JsonDocument,
    path: str,
    around: Tuple[str, ...],
    reading: _Reading,
    given: Optional[Mapping[str, Any]] = None,
) -> Plan:
    """The plan of a file in the package's own form.

    :param around: the files of the plans that use this one as a subnet, and this file.
    :param given: the values of its parameters, if it is used as a subnet.
    """
    folder = os.path.dirname(os.path.abspath(path))

    def named(name: str) -> str:
        return named_file(name, folder, reading.within)

    def read_subnet(name: str, values: Mapping[str, Any]) -> Plan:
        file = named(name)
        key = os.path.realpath(file), json.dumps(values, sort_keys=True)
        if key not in reading.known:
            reading.known[key] = _subnet(os.path.normpath(file), values, around, reading)
        return reading.known[key]

    try:
        data = fill_parameters(document.data, given)
        check_schema(data, file=path, document=document)
        net, notes = _net(data["net"], named)
        policy: Optional[Policy] = None
        if isinstance(data.get("policy"), str):
            policy = read_policy(named(data["policy"]))
        data, whole, parts = expand(data, net or net_from_json(data["net"]), folder, read_subnet)
        plan = plan_from_json(
            data, whole, policy, file=path, folder=folder, checked=True, parts=parts
        )
    except GspnError as error:
        if error.file in (None, path):
            error.located(file=path, line=_line(document, error.element or ""))
        raise
    return plan.with_notes(notes)


def _subnet(
    path: str, values: Mapping[str, Any], around: Tuple[str, ...], reading: _Reading
) -> Plan:
    """The plan of a subnet. :raises GspnError: it cannot be read, or contains itself."""
    path, document = _open(path)
    real = os.path.realpath(path)
    if real in around:
        names = [os.path.basename(file) for file in (*around[around.index(real) :], real)]
        raise PlanError("the plan is a subnet of itself: %s" % " in ".join(reversed(names)))
    try:
        if thesis_input.is_thesis_input(document.data):
            raise PlanError("a subnet is a plan.json, not an input file of the thesis")
        return _own_form(document, path, (*around, real), reading, values)
    except GspnError as error:
        error.located(file=path)
        raise


def _line(document: JsonDocument, element: str) -> Optional[int]:
    """Return the line of an element of a plan, named as in errors: ``transition 't'``,
    ``policy row 2``, ``until``."""
    row = _row_line(document, element, ["policy", "rows"])
    if row is not None:
        return row
    found = re.match(r"(place|transition) '(.*)'$", element)
    net = document.data.get("net")
    if found is None:
        return _line_of(document, element) if element else None
    if isinstance(net, dict):
        for number, node in enumerate(net.get(found.group(1) + "s", ())):
            if node["name"] == found.group(2):
                return document.line(["net", found.group(1) + "s", number])
    return None


def _row_line(
    document: JsonDocument, element: str, rows: Sequence[Union[str, int]]
) -> Optional[int]:
    """Return the line of ``policy row 2``, given the path to the rows; None for another element."""
    found = re.match(r"policy row (\d+)$", element)
    return document.line([*rows, int(found.group(1)) - 1]) if found is not None else None


def _line_of(document: JsonDocument, element: str) -> Optional[int]:
    """Return the line of an element named by its keys (``timeout.Sort``). A key may have dots; for
    a missing element, the line of the innermost enclosing one."""
    key, *rest = element.split(":")[0].split(".")
    path: List[str] = [key]
    line = document.line(path)
    while line is not None and rest:
        for length in range(len(rest), 0, -1):
            deeper = document.line([*path, ".".join(rest[:length])])
            if deeper is not None:
                line, path, rest = deeper, [*path, ".".join(rest[:length])], rest[length:]
                break
        else:
            break
    return line


def _net(data: Any, named: Callable[[str], str]) -> Tuple[Optional[Net], List[str]]:
    if isinstance(data, str):
        return read_net_with_notes(named(data))
    if "file" in data:
        return read_net_with_notes(
            named(data["file"]),
            ReadOptions(data.get("format"), data.get("name"), data.get("constants", {})),
        )
    return None, []


def read_policy(path: str) -> Policy:
    """Read a policy file. :raises GspnError: the file is not a policy."""
    try:
        document = read_document(path)
        check_schema(document.data, "policy", file=path, document=document)
        try:
            return policy_from_json(document.data)
        except GspnError as error:
            error.located(line=_row_line(document, error.element or "", ["rows"]))
            raise
    except GspnError as error:
        error.located(file=path)
        raise


def read_policy_of(path: str) -> Policy:
    """Read the policy of a plan, or a policy file. :raises GspnError: the file is neither."""
    if not os.path.isdir(path):
        data = read_document(path).data
        if isinstance(data, dict) and "net" not in data and "rows" in data:
            return read_policy(path)
    return read_plan(path).policy
