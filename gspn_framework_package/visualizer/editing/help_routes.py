"""The read-only routes of the editor: check, difference, layout, "what would happen here?", and the
palette."""

from __future__ import annotations

import os
import threading
from typing import Any, Callable, Dict, List, Mapping, Tuple

import flask
from flask import Response, request

from gspn_framework_package.analysis.preflight import MARKING_LIMIT
from gspn_framework_package.formats.difference import document_difference
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.errors import InputError, RefusedError, UsageError
from gspn_framework_package.model.net import Arc, Net, Place, Transition
from gspn_framework_package.visualizer.documents import Folder, check_size
from gspn_framework_package.visualizer.editing.check_workers import CheckWorkers
from gspn_framework_package.visualizer.editing.open_document import open_document
from gspn_framework_package.visualizer.editing.palette import message_fields, palette
from gspn_framework_package.visualizer.layout import lay_out
from gspn_framework_package.visualizer.project import Project, path_of_key

QUICK_STATES = 6_000
"""Markings visited by the first check after an edit; the full check visits as many as ``gspn
check``."""

QUICK_SECONDS = 2.0
FULL_SECONDS = 30.0

RequestBody = Callable[[], Dict[str, Any]]
_Answer = Callable[..., Response]


def add_help_routes(app: flask.Flask, project: Project, body: RequestBody, answer: _Answer) -> None:
    """Add the routes to the application of a project with a folder, in which plans are edited.

    :param body: returns the JSON object in the body of the request.
    :param answer: makes the response with a JSON object.
    """
    assert project.folder is not None
    folder = project.folder
    workers = CheckWorkers()
    app.extensions["gspn_checks"] = workers
    laying_out = threading.Lock()

    def key() -> str:
        return request.args.get("id", "")

    def asked(fields: Mapping[str, Any], *names: str) -> Dict[str, Any]:
        """The fields of a request to a worker: its document, where it is, and others."""
        return {
            "document": _document(fields, "document"),
            "path": os.path.join(folder.root, path_in(folder, key())),
            "root": folder.root,
            **{name: fields.get(name) for name in names},
        }

    @app.route("/api/edit/check", methods=["POST"])
    def check_document() -> Response:
        fields = body()
        full = fields.get("full") is True
        found = _answered(
            workers.ask(
                "check %s %s" % (key(), str(fields.get("page", ""))[:80]),
                "check",
                FULL_SECONDS if full else QUICK_SECONDS,
                **asked(fields),
                limit=MARKING_LIMIT if full else QUICK_STATES,
                standalone=fields.get("standalone") is True,
            )
        )
        for finding in found.get("findings", ()):
            finding["text"] = project.without_folders(finding["text"])
        return answer({"revision": fields.get("revision"), **found})

    @app.route("/api/edit/choices", methods=["POST"])
    def choices_at_marking() -> Response:
        fields = body()
        name = "choices %s %s" % (key(), str(fields.get("page", ""))[:80])
        return answer(
            _answered(workers.ask(name, "choices", QUICK_SECONDS, **asked(fields, "marking")))
        )

    @app.route("/api/edit/diff", methods=["POST"])
    def difference_of_documents() -> Response:
        fields = body()
        new, old = _document(fields, "to"), fields.get("from")
        if old == "running":
            given = {**asked({"document": new}), "running": _running(project, key())}
            return answer(
                _answered(workers.ask("running %s" % key(), "running", FULL_SECONDS, **given))
            )
        if old == "saved":
            old = open_document(folder, path_in(folder, key())).document
        else:
            old = _document(fields, "from")
        changes = document_difference(old, new)
        return answer({"changes": [change.to_json() for change in changes]})

    @app.route("/api/edit/layout", methods=["POST"])
    def layout_of_document() -> Response:
        document = _document(body(), "document")
        return answer(_layout(_drawable(document), _groups(document), laying_out))

    @app.route("/api/edit/palette")
    def palette_of_plan() -> Response:
        workers.warm()  # this request comes before editing
        return answer(palette(folder, path_in(folder, key())))

    @app.route("/api/edit/fields")
    def fields_of_messages() -> Response:
        asked_for = request.args.get("kind", ""), request.args.get("type", "")
        return answer(message_fields(*asked_for))


def _running(project: Project, key: str) -> Dict[str, Any]:
    """The plan that runs in a session, as JSON. :raises InputError: it is a net."""
    session = project.session(key)
    plan = session.document_at(session.hub.board().plan).plan
    if plan is None:
        raise InputError("the run is not one of a plan")
    return plan_to_json(plan)


def _answered(found: Dict[str, Any]) -> Dict[str, Any]:
    """A worker's answer. :raises RefusedError: it could not answer."""
    if "error" in found:
        raise RefusedError(found["error"])
    if "answer" in found:
        answered: Dict[str, Any] = found["answer"]
        return answered
    return {"cancelled": True}


def _groups(document: Mapping[str, Any]) -> Dict[str, List[str]]:
    """The groups of a document that may be unfinished."""
    plan = document.get("plan")
    found = plan.get("groups") if isinstance(plan, dict) else None
    return {
        title: [node for node in nodes if isinstance(node, str)]
        for title, nodes in (found if isinstance(found, dict) else {}).items()
        if isinstance(nodes, list)
    }


def _layout(
    net: Net, groups: Mapping[str, List[str]], laying_out: threading.Lock
) -> Dict[str, Any]:
    """The positions of the nodes of a net, for the page. One net is laid out at a time."""
    if not laying_out.acquire(timeout=QUICK_SECONDS):
        raise RefusedError("another net is being laid out", hint="try again")
    try:
        positions = lay_out(net, groups=groups, anew=True).positions
    finally:
        laying_out.release()
    listed: Tuple[Tuple[str, Any], ...] = (
        ("places", net.places),
        ("transitions", net.transitions),
    )
    return {
        kind: {node.name: [round(v, 1) for v in positions[node.name]] for node in nodes}
        for kind, nodes in listed
    }


def path_in(folder: Folder, key: str) -> str:
    """The path of the file of a session, relative to the served folder.

    :raises GspnError: the session does not show a file of that folder.
    """
    return folder.name(path_of_key(key))


def _document(fields: Mapping[str, Any], key: str) -> Dict[str, Any]:
    found = fields.get(key)
    if not isinstance(found, dict) or not isinstance(found.get("net"), dict):
        raise UsageError("'%s' is not a document with a net" % key)
    return found


def _drawable(document: Mapping[str, Any]) -> Net:
    """The nodes and arcs of a document that may be unfinished, without those that cannot be
    drawn."""
    net = document["net"]

    def listed(key: str) -> Any:
        found = net.get(key)
        return (
            item for item in (found if isinstance(found, list) else ()) if isinstance(item, dict)
        )

    names: Dict[str, str] = {}
    for key in ("places", "transitions"):
        for node in listed(key):
            if isinstance(node.get("name"), str) and node["name"]:
                names.setdefault(node["name"], key)
    arcs = [
        Arc(arc["from"], arc["to"])
        for arc in listed("arcs")
        if isinstance(arc.get("from"), str)
        and isinstance(arc.get("to"), str)
        and {names.get(arc["from"]), names.get(arc["to"])} == {"places", "transitions"}
    ]
    check_size(len(names), len(arcs))
    return Net(
        [Place(name) for name, key in names.items() if key == "places"],
        [Transition(name) for name, key in names.items() if key == "transitions"],
        arcs,
    )
