"""The routes of the editor. They begin with ``/api/edit`` and are only for the operator of a server
started with ``--edit`` (see :func:`refusal`)."""

from __future__ import annotations

import json
from typing import Any, Dict, Mapping, Optional

import flask
from flask import Response, request

from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.visualizer.editing.export import exported
from gspn_framework_package.visualizer.editing.functions import problem_of_function
from gspn_framework_package.visualizer.editing.help_routes import RequestBody, add_help_routes
from gspn_framework_package.visualizer.editing.open_document import Opened
from gspn_framework_package.visualizer.editing.plan_repository import (
    ConflictError,
    PlanRepository,
    template_names,
)
from gspn_framework_package.visualizer.editing.sharing import EditorStream, OutdatedError
from gspn_framework_package.visualizer.guard import OPERATOR, Refusal
from gspn_framework_package.visualizer.project import Project, path_of_key
from gspn_framework_package.visualizer.streams import Streams

PREFIX = "/api/edit"

DOCUMENT_BYTES = 12_000_000
"""Largest request of the editor, in bytes."""


SENT = ("etag", "document", "version", "page")
"""The fields of a request that stores a document."""


def is_editing(path: str) -> bool:
    """Whether a request to ``path`` is one to the editor."""
    return path == PREFIX or path.startswith(PREFIX + "/")


def refusal(project: Project, role: str) -> Optional[Refusal]:
    """Why a request to the editor is refused; None if it is not."""
    if not project.edits:
        return Refusal(
            403, "plans cannot be edited here: start the server with 'gspn serve FOLDER --edit'"
        )
    if role != OPERATOR:
        return Refusal(403, "only the operator may edit plans")
    return None


def add_routes(app: flask.Flask, project: Project, body: RequestBody, streams: Streams) -> None:
    """Add the routes of the editor to the application.

    :param body: returns the JSON object in the body of the request.
    :param streams: counts the streams to the pages that edit.
    """
    if project.folder is None or not project.edits:
        return
    repository = PlanRepository(project.folder)

    def outdated(error: GspnError, theirs: Dict[str, Any]) -> Response:
        return answer({"error": project.without_folders(str(error)), "theirs": theirs}, 412)

    def new_plan(made: str) -> Response:
        return answer({"path": made, "id": project.open(made).key})

    @app.route(PREFIX)
    def open_for_editing() -> Response:
        return answer(_told(repository.open(_path()), repository))

    @app.route(PREFIX + "/save", methods=["POST"])
    def save() -> Response:
        fields = body()
        try:
            saved = repository.save(_path(), *(fields.get(key) for key in SENT))
        except ConflictError as error:
            theirs = {"etag": error.theirs.etag, "document": error.theirs.document}
            return outdated(error, theirs)
        except OutdatedError as error:
            return outdated(error, error.theirs)
        if saved.written:
            project.renew([saved.opened.path, *saved.written])
        return answer(
            {
                "etag": saved.opened.etag,
                "files": saved.opened.files_to_json(),
                "written": saved.written,
                "notes": saved.notes,
            }
        )

    @app.route(PREFIX + "/save_as", methods=["POST"])
    def save_as() -> Response:
        fields = body()
        return new_plan(repository.save_as(_path(), fields.get("document"), fields.get("name")))

    @app.route(PREFIX + "/new", methods=["POST"])
    def new() -> Response:
        fields = body()
        return new_plan(repository.new(fields.get("template", ""), fields.get("name")))

    @app.route(PREFIX + "/draft", methods=["POST"])
    def draft() -> Response:
        fields = body()
        try:
            sent = (fields.get(key) for key in (*SENT, "history"))
            kept = repository.keep_draft(_path(), *sent)
        except OutdatedError as error:
            return outdated(error, error.theirs)
        return answer({"kept": bool(kept), "version": kept})

    @app.route(PREFIX + "/export", methods=["POST"])
    def export() -> Response:
        fields = body()
        file = exported(repository, _path(), fields.get("document"), fields.get("format"))
        response = Response(file.data, mimetype=file.mimetype)
        response.headers["Content-Disposition"] = "attachment; filename=%s" % file.name
        if file.notes:
            response.headers["X-Gspn-Notes"] = json.dumps(file.notes)
        return response

    _add_functions(app, repository, body)
    _add_shared(app, repository, body, streams)
    add_help_routes(app, project, body, answer)


def _add_functions(app: flask.Flask, repository: PlanRepository, body: RequestBody) -> None:
    """Add the route by which the source of a function is read, checked and written."""

    @app.route(PREFIX + "/function", methods=["POST"])
    def function() -> Response:
        fields = body()
        name, text = fields.get("function"), fields.get("text")
        if fields.get("save") is True:
            source = repository.write_function(_path(), name, text, fields.get("version"))
            return answer(source._asdict())
        if text is None:
            try:
                return answer(repository.function(_path(), name)._asdict())
            except GspnError as error:
                if fields.get("look") is not True:
                    raise
                return answer({"problem": error.message})
        return answer(problem_of_function(name, text))


def _add_shared(
    app: flask.Flask, repository: PlanRepository, body: RequestBody, streams: Streams
) -> None:
    """Add the routes through which pages that edit one plan learn of each other."""

    @app.route(PREFIX + "/latest")
    def latest_state() -> Response:
        return answer(repository.latest(_path()))

    @app.route(PREFIX + "/here", methods=["POST"])
    def page_is_here() -> Response:
        fields = body()
        if fields.get("gone") is True:
            repository.leave(_path(), fields.get("page"))
            return answer({"version": "", "editors": []})
        return answer(repository.shared.told(repository.come(_path(), fields.get("page"), fields)))

    @app.route(PREFIX + "/stream")
    def stream_of_plan() -> Response:
        page, peer = request.args.get("page", ""), request.remote_addr or ""
        if not streams.take(peer):
            return answer({"error": "too many streams are open already: this page polls"}, 503)
        try:
            file = repository.come(_path(), page, {}, stream=True)
        except BaseException:
            streams.give_back(peer)
            raise
        sent = EditorStream(repository.shared, file, page, streams, peer)
        response = Response(sent, mimetype="text/event-stream")
        response.headers["X-Accel-Buffering"] = "no"
        return response


def _path() -> str:
    return path_of_key(request.args.get("id", ""))


def offer(project: Project, role: str) -> Dict[str, Any]:
    """The page's information on the editor: whether it may be used, and the plan templates."""
    edits = project.edits and role == OPERATOR
    return {"edits": edits, "templates": template_names() if edits else []}


def answer(data: Mapping[str, Any], status: int = 200) -> Response:
    """An answer in JSON that keeps the order of its keys."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False)
    return Response(text, status=status, mimetype="application/json")


def _told(opened: Opened, repository: PlanRepository) -> Dict[str, Any]:
    return {
        "path": opened.path,
        "etag": opened.etag,
        "document": opened.document,
        "files": opened.files_to_json(),
        "scale": opened.scale,
        "laid_out": opened.laid_out,
        "notes": list(opened.parts.notes),
        "draft": repository.drafts.of(opened.path, opened.etag),
        "read_only": repository.read_only(opened),
    }
