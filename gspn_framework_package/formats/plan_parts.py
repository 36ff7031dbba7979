"""A plan as written: its JSON object, its net and its policy, and their files.

:func:`~gspn_framework_package.formats.plan_file.read_plan` combines them, replacing references to
subnets by the subnets. An editor needs the parts as they are in the files.
"""

from __future__ import annotations

import os
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

from gspn_framework_package.formats import thesis_input
from gspn_framework_package.formats.draft import ReadOptions
from gspn_framework_package.formats.json_file import read_json
from gspn_framework_package.formats.net_json import net_to_json
from gspn_framework_package.formats.plan_file import is_plan, read_net_or_plan
from gspn_framework_package.formats.plan_json import check_schema, plan_to_short_json
from gspn_framework_package.formats.registry import read_net_with_notes
from gspn_framework_package.formats.source import named_file
from gspn_framework_package.model.data import kind_of
from gspn_framework_package.model.errors import GspnError, PlanError

JsonObject = Dict[str, Any]


class PlanParts(NamedTuple):
    """The content of a plan's files.

    :ivar plan: the object of the plan file without ``net`` and ``policy``.
    :ivar net: the net as a JSON object.
    :ivar policy: the policy as a JSON object, None if there is none.
    :ivar plan_file: path of the plan file, "" for a bare net.
    :ivar net_file: path of the net's file, "" if the net is in the plan file.
    :ivar policy_file: path of the policy's file, "" if the policy is in the plan file.
    :ivar options: how the net's file is read.
    :ivar thesis: whether the plan file is an input file of the thesis.
    :ivar notes: notes for the user on how the files were read.
    """

    plan: JsonObject
    net: JsonObject
    policy: Optional[JsonObject]
    plan_file: str
    net_file: str
    policy_file: str
    options: ReadOptions
    thesis: bool = False
    notes: Tuple[str, ...] = ()

    @property
    def files(self) -> List[str]:
        """The files, the plan's first."""
        return [path for path in (self.plan_file, self.net_file, self.policy_file) if path]


def read_parts(path: str, within: Optional[str] = None) -> PlanParts:
    """Read the parts of a plan, or a bare net, whose plan is then empty.

    The parts are not checked against each other, and subnets are not read, so that an invalid plan
    can be opened and repaired.

    :param within: the folder that must contain all files; None for no restriction.
    :raises GspnError: a file cannot be read, or has the wrong kind of content.
    """
    if not is_plan(path):
        net, notes = read_net_with_notes(path)
        return PlanParts({}, net_to_json(net), None, "", path, "", ReadOptions(), False, (*notes,))
    data = read_json(path)
    if not isinstance(data, dict):
        raise PlanError("a plan is a JSON object, not %s" % kind_of(data), file=path)
    if thesis_input.is_thesis_input(data):
        return _of_thesis(path, data, within)
    folder = os.path.dirname(os.path.abspath(path))
    named = {}
    for key in ("net", "policy"):
        value = data.get(key)
        if key == "net" and isinstance(value, dict):
            value = value.get("file")
        if isinstance(value, str):
            try:
                file = named_file(value, folder, within)
            except GspnError as error:
                raise error.located(file=path, element=key) from None
            named[key] = os.path.realpath(file) if within else os.path.normpath(file)
    options = ReadOptions()
    net_data: Any = data.get("net")
    found_notes: Tuple[str, ...] = ()
    if "net" in named:
        if isinstance(net_data, dict):
            _check_net_reference(net_data, path)
            options = ReadOptions(
                net_data.get("format"), net_data.get("name"), net_data.get("constants", {})
            )
        net, notes = read_net_with_notes(named["net"], options)
        net_data, found_notes = net_to_json(net), tuple(notes)
    else:
        _check(net_data, "net", path, "net")
    policy = data.get("policy")
    if "policy" in named:
        policy = read_json(named["policy"])
    if policy is not None:
        _check(policy, "policy", named.get("policy", path), "policy")
    plan = {key: value for key, value in data.items() if key not in ("net", "policy")}
    return PlanParts(
        plan,
        net_data,
        policy,
        path,
        named.get("net", ""),
        named.get("policy", ""),
        options,
        False,
        found_notes,
    )


def _check_net_reference(data: JsonObject, path: str) -> None:
    constants = data.get("constants", {})
    names = [data.get("format"), data.get("name")]
    if not isinstance(constants, dict) or any(not isinstance(n, (str, type(None))) for n in names):
        raise PlanError("it does not say how the net's file is read", file=path, element="net")


def _check(data: Any, definition: str, path: str, element: str) -> None:
    try:
        check_schema(data, definition, file=path)
    except GspnError as error:
        error.element = ".".join(filter(None, (element, error.element)))
        raise


def _of_thesis(path: str, data: JsonObject, within: Optional[str]) -> PlanParts:
    """The parts of an input file of the thesis, in the package's own form; only its net if the rest
    of it is not a plan."""
    found = read_net_or_plan(path, net_will_do=True, within=within)
    whole: JsonObject = {}
    if found.plan is not None:
        whole = plan_to_short_json(found.plan)
        whole.pop("net")
    policy = whole.pop("policy", None)
    net_file = thesis_input.net_file(data, path, within)
    net = net_to_json(found.net)
    return PlanParts(whole, net, policy, path, net_file, "", ReadOptions(), True, found.notes)
