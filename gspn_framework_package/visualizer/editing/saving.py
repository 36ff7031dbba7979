"""How saving a document changes the files of its plan: only what was edited."""

from __future__ import annotations

import json
import math
import os
from typing import Any, Dict, List, NamedTuple, Optional

from gspn_framework_package.formats.edited_document import plan_of_document
from gspn_framework_package.formats.json_file import read_document
from gspn_framework_package.formats.json_update import same, update_json
from gspn_framework_package.formats.net_json import net_from_json
from gspn_framework_package.formats.net_update import update_net
from gspn_framework_package.formats.plan_json import check_schema
from gspn_framework_package.formats.plan_parts import JsonObject
from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.model.errors import GspnError, InputError, UsageError
from gspn_framework_package.visualizer.documents import check_size
from gspn_framework_package.visualizer.editing.open_document import Opened, with_nodes

_DEPTH = 60
"""Largest nesting depth of a document."""

ORDERED = ("robots",)
"""The keys of a plan whose entries have an order that matters: it numbers the robots."""

IN_PLAN = "the net is now in the plan file: %s files cannot represent it"


class Changes(NamedTuple):
    """The new contents of files, by path, and notes for the user."""

    contents: Dict[str, bytes]
    notes: List[str]


def document_in(value: object) -> JsonObject:
    """The document in a request.

    :raises InputError: it is not a document: a part is missing, its net or policy does not fit the
        schema, it is nested too deeply, or contains numbers or characters that a file cannot hold.
    """
    found = unfinished(value)
    plan, net, policy = (found[key] for key in ("plan", "net", "policy"))
    _check_part(net, "net")
    check_size(len(net["places"]) + len(net["transitions"]), len(net["arcs"]))
    if policy is not None:
        _check_part(policy, "policy")
    plan = {key: part for key, part in plan.items() if key not in ("net", "policy")}
    return {"plan": plan, "net": net, "policy": policy}


def _check_part(part: Any, name: str) -> None:
    try:
        check_schema(part, name)
    except GspnError as error:
        error.element = ".".join(filter(None, (name, error.element)))
        raise


def unfinished(value: object) -> JsonObject:
    """Like :func:`document_in`, but the parts may be invalid."""
    if not isinstance(value, dict):
        raise UsageError("'document' is missing")
    _check_values(value)
    plan, net, policy = (value.get(key) for key in ("plan", "net", "policy"))
    if not isinstance(plan, dict) or not isinstance(net, dict):
        raise UsageError("a document needs a 'plan' and a 'net'")
    return {"plan": plan, "net": net, "policy": policy}


def _check_values(value: Any) -> None:
    level: List[Any] = [value]
    for _ in range(_DEPTH):
        inner: List[Any] = []
        for part in level:
            if isinstance(part, dict):
                for key in part:
                    _check_text(key)
                inner += part.values()
            elif isinstance(part, list):
                inner += part
            elif isinstance(part, str):
                _check_text(part)
            elif isinstance(part, float) and not math.isfinite(part):
                raise UsageError("the document contains an invalid number: %r" % part)
            elif isinstance(part, int) and abs(part) > 10**300:
                raise UsageError("the document contains a number of more than 300 digits")
        if not inner:
            return
        level = inner
    raise UsageError("the document is nested too deeply")


def _check_text(text: str) -> None:
    try:
        text.encode()
    except UnicodeEncodeError:
        raise UsageError("the document contains an invalid character") from None


def read_back(document: JsonObject, path: str) -> None:
    """Check that a document is a readable plan.

    :param path: its future location.
    :raises GspnError: it is not.
    """
    try:
        plan_of_document(document, path)
    except GspnError as error:
        if error.file == path:
            error.file = None
        if not error.hint:
            error.hint = "your changes are kept as a draft until the plan can be saved"
        raise


def changes_of(opened: Opened, document: JsonObject) -> Changes:
    """Return the contents that the files of an open plan will have once the document is saved.

    :raises GspnError: the document does not read as a plan.
    """
    parts = opened.parts
    net = settled_net(opened, document["net"])
    written = {**document, "net": net}
    if _same_document({"plan": parts.plan, "net": parts.net, "policy": parts.policy}, written):
        return Changes({}, [])
    read_back(written, parts.plan_file)
    contents: Dict[str, bytes] = {}
    notes: List[str] = []
    text = read_document(parts.plan_file).text
    old = json.loads(text.lstrip("\ufeff"))
    whole = dict(document["plan"])
    whole["net"] = old["net"] if parts.net_file else net
    if parts.net_file and not same(parts.net, net):
        before = read_bytes(parts.net_file)
        data = update_net(before, parts.net_file, parts.options, net_from_json(net))
        if data is None:
            whole["net"] = net
            notes.append(IN_PLAN % (os.path.splitext(parts.net_file)[1] or "such"))
        elif data != before:
            contents[parts.net_file] = data
    policy = document["policy"]
    if policy is not None:
        whole["policy"] = old["policy"] if parts.policy_file else policy
        if parts.policy_file:
            contents.update(_updated(parts.policy_file, policy))
    contents.update(_updated(parts.plan_file, whole, ORDERED))
    return Changes(contents, notes)


def _updated(path: str, new: Any, ordered: Any = ()) -> Dict[str, bytes]:
    """The new content of a JSON file; nothing if its meaning has not changed."""
    before = read_bytes(path)
    mark = "\ufeff" if before.startswith(b"\xef\xbb\xbf") else ""
    text = mark + before.decode("utf-8-sig")
    after = update_json(text, new, ordered)
    if not same(json.loads(after.lstrip("\ufeff")), new):
        raise InputError("the file cannot be changed in place", file=path)
    return {path: after.encode()} if after != text else {}


def _same_document(old: JsonObject, new: JsonObject) -> bool:
    robots = [list(part["plan"].get("robots") or ()) for part in (old, new)]
    is_object = isinstance(old["plan"].get("robots"), dict)
    return same(old, new) and (not is_object or robots[0] == robots[1])


def settled_net(opened: Opened, net: JsonObject) -> JsonObject:
    """The net with the positions to save: those that the page generated are left out unless a node
    was moved, or an arc bent."""
    shown, file = _positions(opened.document["net"]), _positions(opened.parts.net)
    now = _positions(net)
    unmoved = {name for name, where in now.items() if same(where, shown.get(name))}
    bent = not same(*(_bends(n) for n in (opened.parts.net, net)))
    if opened.laid_out and (bent or len(unmoved) < len(now)):
        return net

    def settled(node: JsonObject) -> JsonObject:
        name = node["name"]
        if name not in unmoved or file.get(name) == node.get("position"):
            return node
        kept = {key: value for key, value in node.items() if key != "position"}
        if file.get(name) is not None:
            kept["position"] = file[name]
        return kept

    return with_nodes(net, settled)


def _bends(net: JsonObject) -> List[JsonObject]:
    return [arc["bends"] for arc in net["arcs"] if arc.get("bends")]


def _positions(net: JsonObject) -> Dict[str, Optional[List[float]]]:
    return {node["name"]: node.get("position") for node in [*net["places"], *net["transitions"]]}
