"""The routes of the editor. All of them begin with ``/api/edit``, and are for the operator of a
server that was started with ``--edit`` (see :func:`refusal`)."""

from __future__ import annotations

import json
from typing import Any, Callable, Dict, Mapping, Optional

import flask
from flask import Response, request

from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.visualizer.editing.open_document import Opened
from gspn_framework_package.visualizer.editing.workshop import Workshop
from gspn_framework_package.visualizer.guard import OPERATOR, Refusal
from gspn_framework_package.visualizer.project import FILE_KEY, Project

PREFIX = "/api/edit"

DOCUMENT_BYTES = 12_000_000
"""Largest request of the editor, in bytes."""

Body = Callable[[], Dict[str, Any]]


def is_editing(path: str) -> bool:
    """Whether a request to ``path`` is one to the editor."""
    return path == PREFIX or path.startswith(PREFIX + "/")


def refusal(project: Project, role: str) -> Optional[Refusal]:
    """Why a request to the editor is refused; None if it is not."""
    if not project.edits:
        return Refusal(403, "plans are not edited here: start it with 'gspn serve FOLDER --edit'")
    if role != OPERATOR:
        return Refusal(403, "only the operator edits plans")
    return None


def add_routes(app: flask.Flask, project: Project, body: Body) -> None:
    """Add the routes of the editor to the application.

    :param body: returns the JSON object in the body of the request.
    """
    if project.folder is None or not project.edits:
        return
    workshop = Workshop(project.folder)

    def path() -> str:
        return path_of_key(request.args.get("id", ""))

    @app.route(PREFIX)
    def open_for_editing() -> Response:
        return answer(_told(workshop.open(path()), workshop))


def path_of_key(key: str) -> str:
    """The path of the file of a session. :raises UsageError: the session is not one of a file."""
    if not key.startswith(FILE_KEY):
        raise UsageError("only files of the served folder are edited")
    return key[len(FILE_KEY) :]


def answer(data: Mapping[str, Any], status: int = 200) -> Response:
    """An answer in JSON, with its keys in the order in which they are."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False)
    return Response(text, status=status, mimetype="application/json")


def _told(opened: Opened, workshop: Workshop) -> Dict[str, Any]:
    return {
        "path": opened.path,
        "etag": opened.etag,
        "document": opened.document,
        "files": opened.files_to_json(),
        "scale": opened.scale,
        "notes": list(opened.parts.notes),
        "draft": None,
        "read_only": workshop.read_only(opened),
    }
