"""The document that an editor works on: a plan as written, its net and its policy, as one JSON
object ``{"plan": ..., "net": ..., "policy": ... or null}``.

``plan`` is the object of the plan file without the keys ``net`` and ``policy``. A subnet stays a
reference. A document may be incomplete; only :func:`plan_of_document` requires a complete one.
"""

from __future__ import annotations

from typing import Any, Dict, Optional

from gspn_framework_package.formats.plan_file import file_of, plan_from_object
from gspn_framework_package.formats.plan_parts import read_parts
from gspn_framework_package.model.errors import GspnError, PlanError
from gspn_framework_package.model.plan import Plan

EditedDocument = Dict[str, Any]
"""See the module."""


def document_of(path: str) -> EditedDocument:
    """Return the document of a plan file, of a folder with a plan, or of a net (whose ``plan`` is
    empty).

    :raises GspnError: the file, its net or its policy cannot be read.
    """
    parts = read_parts(file_of(path))
    return {"plan": parts.plan, "net": parts.net, "policy": parts.policy}


def document_from_json(data: Dict[str, Any]) -> EditedDocument:
    """Return the document of the JSON object of a plan that contains its net and policy."""
    plan = {key: value for key, value in data.items() if key not in ("net", "policy")}
    return {"plan": plan, "net": data.get("net", {}), "policy": data.get("policy")}


def document_to_json(document: EditedDocument) -> Dict[str, Any]:
    """Return the JSON object of a plan that contains the net and the policy of a document.

    :raises PlanError: it is not a document.
    """
    plan, net, policy = (document.get(key) for key in ("plan", "net", "policy"))
    for key, part in (("plan", plan), ("net", net)):
        if not isinstance(part, dict):
            raise PlanError("it is not an object", element=key)
        if "file" in part:
            raise PlanError("it must be in the document itself, not in a file", element=key)
    if policy is not None and not isinstance(policy, dict):
        raise PlanError("it is not an object", element="policy")
    assert isinstance(plan, dict)
    data = {**plan, "net": net, "policy": policy}
    if policy is None:
        del data["policy"]
    return data


def plan_of_document(document: EditedDocument, path: str, root: Optional[str] = None) -> Plan:
    """Return the plan of a document.

    :param path: the plan file, which need not exist; subnets are read from its folder.
    :param root: a folder outside which the document may name no subnet; None for no such limit.
    :raises GspnError: it is not a valid plan; the error names the element.
    """
    try:
        return plan_from_object(document_to_json(document), path, root)
    except GspnError as error:
        error.located(file=path)
        raise
