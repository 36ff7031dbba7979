"""The web application: routes only, without knowledge of nets.

A GET changes nothing. Every answer of ``/api/`` is JSON; an error is ``{"error": message}`` with
the appropriate status.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import time
from typing import Any, Dict, Iterator, Optional, Tuple, Union

import flask
from flask import Response, request
from werkzeug.exceptions import HTTPException

from gspn_framework_package import __version__
from gspn_framework_package.formats.plan_json import schema
from gspn_framework_package.model.errors import GspnError, InputError, UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.visualizer import deploying, run_stories
from gspn_framework_package.visualizer.activity import whole_field
from gspn_framework_package.visualizer.analysis_jobs import AnalysisJobs
from gspn_framework_package.visualizer.documents import Document, read_upload, run_net_document
from gspn_framework_package.visualizer.editing import routes as editing
from gspn_framework_package.visualizer.fleet_page import FleetPage
from gspn_framework_package.visualizer.guard import SECURITY_HEADERS, Guard, LoginError
from gspn_framework_package.visualizer.hub import Cursor, Hub
from gspn_framework_package.visualizer.openapi import interface
from gspn_framework_package.visualizer.optimise_form import FormError
from gspn_framework_package.visualizer.optimised import ROWS_PER_PART, ExistsError
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.reasons import reasons_in
from gspn_framework_package.visualizer.session import Session
from gspn_framework_package.visualizer.streams import PING, Streams
from gspn_framework_package.visualizer.what_if import (
    EXACT_SECONDS,
    FirstLooks,
    adjustable,
    what_if_in_form,
)

UPLOAD_BYTES = 12_000_000
"""Largest request in bytes; an upload is base64, so files of 8 MB fit."""

COMMAND_BYTES = 2_000_000

LOGIN_BYTES = 4_000
"""Largest request, in bytes, from a peer that has not yet sent a token."""

WHAT_IF_LIMIT = 20.0
"""Seconds after which the simulation that follows a slider is given up."""

GATHER = 0.012
"""Seconds during which a stream gathers events into one message."""

_JsonAndStatus = Tuple[Dict[str, Any], int]


def create_app(project: Project, guard: Guard, viewers: int = 24) -> flask.Flask:
    """Create the application.

    :param project: what can be opened.
    :param guard: decides which requests are allowed.
    :param viewers: how many streams are served at once; further viewers poll.
    """
    app = flask.Flask(__name__, static_url_path="/static")
    app.config["SEND_FILE_MAX_AGE_DEFAULT"] = 0
    jobs = AnalysisJobs()
    streams = Streams(viewers)
    app.extensions.update(gspn_jobs=jobs, gspn_streams=streams)

    _guard(app, project, guard)
    _explain_errors(app, project)
    _add_page(app, project, guard)
    _add_opening(app, project)
    _add_session(app, project, streams)
    _add_analysis(app, project, jobs)
    _add_optimised(app, project, jobs)
    editing.add_routes(app, project, _body, streams)
    deploying.add_routes(app, project, jobs, _body)
    _add_history(app, project)
    run_stories.add_routes(app, project)
    return app


def _guard(app: flask.Flask, project: Project, guard: Guard) -> None:
    """Let in only the requests that are allowed."""

    @app.before_request
    def check() -> Optional[_JsonAndStatus]:
        verdict = guard.check(
            request.method, request.path, request.headers, request.cookies, _peer()
        )
        if verdict.refusal is not None:
            return {"error": verdict.refusal.reason}, verdict.refusal.status
        flask.g.role = verdict.role
        if editing.is_editing(request.path):
            refusal = editing.refusal(project, verdict.role)
            if refusal is not None:
                return {"error": refusal.reason}, refusal.status
        return None

    @app.after_request
    def secure(response: Response) -> Response:
        for name, value in SECURITY_HEADERS.items():
            response.headers[name] = value
        if request.path.startswith("/api/"):
            response.headers["Cache-Control"] = "no-store"
        return response


def _explain_errors(app: flask.Flask, project: Project) -> None:
    """Answer each error with its message."""

    @app.errorhandler(GspnError)
    def explain(error: GspnError) -> _JsonAndStatus:
        answer: Dict[str, Any] = {"error": project.without_folders(str(error))}
        if isinstance(error, FormError):
            answer["fields"] = error.fields
        elif isinstance(error, ExistsError):
            answer["exists"] = True
        return answer, 400 if isinstance(error, InputError) else 409

    @app.errorhandler(413)
    def too_large(error: Exception) -> _JsonAndStatus:
        return {"error": too_large_text(request.path)}, 413

    @app.errorhandler(UnicodeError)
    def no_text(error: UnicodeError) -> _JsonAndStatus:
        return {"error": "the request contains an invalid character"}, 400

    @app.errorhandler(OSError)
    def no_means(error: OSError) -> _JsonAndStatus:
        app.logger.warning("a request failed: %s", error)
        return {"error": "the server cannot do that now: %s" % (error.strerror or "an error")}, 503

    @app.errorhandler(404)
    @app.errorhandler(405)
    def not_here(error: HTTPException) -> _JsonAndStatus:
        return {"error": "not found"}, error.code or 404

    @app.errorhandler(Exception)
    def fault(error: Exception) -> _JsonAndStatus:
        app.logger.exception("a request failed")
        return {"error": "internal error: %s" % type(error).__name__}, 500


def _add_page(app: flask.Flask, project: Project, guard: Guard) -> None:
    """Add the routes of the page itself, and of the login."""

    @app.route("/")
    def page() -> Response:
        return app.send_static_file("index.html")

    @app.route("/favicon.ico")
    def icon() -> Response:
        return app.send_static_file("icon.svg")

    @app.route("/plan.schema.json")
    def plan_schema() -> Response:
        return Response(json.dumps(schema()), mimetype="application/json")

    @app.route("/api/openapi.json")
    def describe_interface() -> Dict[str, Any]:
        return interface(__version__)

    @app.route("/api/login", methods=["POST"])
    def login() -> Union[_JsonAndStatus, Response]:
        try:
            cookie = guard.login(str(_body().get("token", "")), _peer())
        except LoginError as error:
            return {"error": error.reason}, error.status
        response = flask.jsonify({})
        if cookie:
            response.set_cookie(guard.cookie, cookie, httponly=True, samesite="Strict")
        return response

    @app.route("/api/hello")
    def hello() -> Dict[str, Any]:
        role = flask.g.role
        offer = editing.offer(project, role)
        return {"version": __version__, "role": role, **offer, **project.to_json()}


def _add_opening(app: flask.Flask, project: Project) -> None:
    """Add the routes that open a net."""

    @app.route("/api/open", methods=["POST"])
    def open_file() -> Dict[str, Any]:
        path = _body().get("path")
        if not isinstance(path, str):
            raise UsageError("'path' is missing")
        return {"id": project.open(path).key}

    @app.route("/api/upload", methods=["POST"])
    def upload() -> Dict[str, Any]:
        document: Document = read_upload(_body().get("files"))
        key = "upload-" + secrets.token_hex(6)
        return {"id": project.sessions.get_or_open(key, lambda: Session(key, document)).key}

    @app.route("/api/run_net", methods=["POST"])
    def run_net() -> Dict[str, Any]:
        document = run_net_document(_session(project).document)
        key = "run-net-" + secrets.token_hex(6)
        return {"id": project.sessions.get_or_open(key, lambda: Session(key, document)).key}


def _add_session(app: flask.Flask, project: Project, streams: Streams) -> None:
    """Add the routes of an open net: what it shows, its commands and its events."""

    @app.route("/api/session")
    def describe() -> Dict[str, Any]:
        return _session(project).to_json()

    @app.route("/api/do", methods=["POST"])
    def command() -> Dict[str, Any]:
        fields = _body()
        name = fields.pop("command", None)
        if not isinstance(name, str):
            raise UsageError("'command' is missing")
        return _session(project).command(name, fields)

    @app.route("/api/state")
    def state_at() -> Dict[str, Any]:
        hub = _session(project).hub
        return {"epoch": hub.epoch, "board": hub.board_at(_number("at")).to_json()}

    @app.route("/api/scene")
    def scene() -> Dict[str, Any]:
        shown = _session(project)
        return {"epoch": shown.hub.epoch, "scene": shown.scene_at(_number("plan"))}

    @app.route("/api/reasons")
    def why() -> Dict[str, Any]:
        at = _number("at") if request.args.get("at") else None
        return reasons_in(_session(project), request.args.get("transition", ""), at)

    @app.route("/api/slot")
    def after_slot() -> Dict[str, Any]:
        shown = _session(project)
        return {"epoch": shown.hub.epoch, "event": shown.activity.after_slot(_number("slot"))}

    @app.route("/api/moment")
    def event_at() -> Dict[str, Any]:
        hub = _session(project).hub
        return {"epoch": hub.epoch, "event": hub.event_at(_time())}

    @app.route("/api/poses")
    def poses_around() -> Dict[str, Any]:
        hub = _session(project).hub
        return {"epoch": hub.epoch, **hub.poses_around(_time())}

    @app.route("/api/events")
    def past_events() -> Dict[str, Any]:
        hub = _session(project).hub
        return {
            "epoch": hub.epoch,
            "events": hub.events(_number("after"), _number("to"), _number("limit", 5000)),
        }

    @app.route("/api/poll")
    def poll() -> Response:
        hub = _session(project).hub
        news = hub.news(Cursor.parse(request.args.get("since")))
        return Response(news.text, mimetype="application/json")

    @app.route("/api/stream")
    def stream() -> Union[_JsonAndStatus, Response]:
        hub = _session(project).hub
        if not streams.take(_peer()):
            return {"error": "too many streams are open already: this viewer polls"}, 503
        cursor = Cursor.parse(request.headers.get("Last-Event-ID") or request.args.get("since"))
        response = Response(_Stream(hub, cursor, streams, _peer()), mimetype="text/event-stream")
        response.headers["X-Accel-Buffering"] = "no"
        return response


def _add_analysis(app: flask.Flask, project: Project, jobs: AnalysisJobs) -> None:
    """Add the routes that analyse an open net."""

    @app.route("/api/analysis", methods=["POST"])
    def analyse() -> Dict[str, Any]:
        opened, fields = _session(project), _body()
        hub = opened.hub
        board = (
            hub.board_at(whole_field(fields, "event", 0, 0, 10**15))
            if "event" in fields
            else hub.board()
        )
        document = opened.document_at(board.plan)
        key = jobs.start(document, board.marking, fields, opened.key)
        return {"job": key, "event": board.n}

    looks = FirstLooks()

    @app.route("/api/what_if")
    def what_can_change() -> Dict[str, Any]:
        return adjustable(_plan_shown(project))

    @app.route("/api/what_if", methods=["POST"])
    def what_if() -> Dict[str, Any]:
        fields, opened = _body(), _session(project)
        plan = _plan_shown(project)
        changed = what_if_in_form(fields, plan).apply(plan)
        if fields.get("whole") is not True:
            return looks.at(changed)
        asked = {"predict": fields.get("next"), "exact": EXACT_SECONDS}
        asked.update(policy=True, seconds=WHAT_IF_LIMIT)
        document = opened.document._replace(net=changed.net, plan=changed)
        return {"job": jobs.start(document, changed.net.initial_marking, asked, opened.key)}

    @app.route("/api/analysis/<job>")
    def progress(job: str) -> Dict[str, Any]:
        return jobs.report(job)

    @app.route("/api/analysis/<job>/cancel", methods=["POST"])
    def cancel(job: str) -> Dict[str, Any]:
        _body()
        jobs.cancel(job)
        return {}


def _add_optimised(app: flask.Flask, project: Project, jobs: AnalysisJobs) -> None:
    """Add the routes of computed policies."""

    @app.route("/api/optimised")
    def latest_policy() -> Dict[str, Any]:
        return {"job": jobs.latest(_session(project).key)}

    @app.route("/api/analysis/<job>/rows")
    def policy_rows(job: str) -> Dict[str, Any]:
        return jobs.optimised(job).rows(_number("from"), _number("limit", ROWS_PER_PART))

    @app.route("/api/analysis/<job>/choices")
    def choices_at(job: str) -> Dict[str, Any]:
        shown = _session(project)
        board = shown.hub.board_at(_number("at"))
        marking = shown.document_at(board.plan).net.named(board.marking)
        return {"at": board.n, "choices": jobs.optimised(job).choices(marking)}

    @app.route("/api/analysis/<job>/plan")
    def download_plan(job: str) -> Response:
        response = Response(jobs.optimised(job).text, mimetype="application/json")
        response.headers["Content-Disposition"] = "attachment; filename=plan_optimised.json"
        return response

    @app.route("/api/analysis/<job>/save", methods=["POST"])
    def save_plan(job: str) -> Dict[str, Any]:
        fields = _body()
        path = jobs.save(job, fields.get("name"), fields.get("overwrite") is True)
        return {"name": os.path.basename(path), "path": project.path_of(path)}


def _add_history(app: flask.Flask, project: Project) -> None:
    """Add the routes of a fleet's history."""

    def fleet() -> FleetPage:
        if project.fleet is None:
            raise InputError("this server shows no history", hint="gspn serve --history DIR")
        return project.fleet

    @app.route("/api/history/names")
    def names_in_history() -> Dict[str, Any]:
        return fleet().names()

    @app.route("/api/history/report")
    def report_on_history() -> Dict[str, Any]:
        return fleet().report(request.args)

    @app.route("/api/history/moments")
    def moments_of_history() -> Dict[str, Any]:
        return fleet().moments(request.args)


def body_limit(path: str) -> int:
    """Largest body, in bytes, of a request to ``path``."""
    if not path.startswith("/api/"):
        return 0
    if editing.is_editing(path):
        return editing.DOCUMENT_BYTES
    return {"/api/upload": UPLOAD_BYTES, "/api/login": LOGIN_BYTES}.get(path, COMMAND_BYTES)


def too_large_text(path: str) -> str:
    """The message for a request to ``path`` with a larger body."""
    if path == "/api/upload":
        return "too large: files of up to %d MB in total can be uploaded" % (
            UPLOAD_BYTES * 2 // 3_000_000
        )
    if path == "/api/login":
        return "too large for a token"
    if editing.is_editing(path):
        return "too large: plans of up to %d MB can be edited" % (
            editing.DOCUMENT_BYTES // 1_000_000
        )
    return "too large: a command may have up to %d MB" % (COMMAND_BYTES // 1_000_000)


def _session(project: Project) -> Session:
    """The session that a request names."""
    return project.session(request.args.get("id", ""), room=request.method == "POST")


def _plan_shown(project: Project) -> Plan:
    """The plan of that session. :raises UsageError: it is a net."""
    plan = _session(project).document.plan
    if plan is None:
        raise UsageError("only runs of a plan can be predicted; this is a net")
    return plan


def _peer() -> str:
    return request.remote_addr or ""


def _body() -> Dict[str, Any]:
    """The JSON object in the body of a request. :raises UsageError: the body is not one."""
    if (request.content_length or 0) > body_limit(request.path):
        flask.abort(413)
    if request.mimetype != "application/json":
        raise UsageError("a request must be JSON (Content-Type: application/json)")
    try:
        data = json.loads(request.get_data())
    except (ValueError, RecursionError):
        raise UsageError("the request is not JSON") from None
    if not isinstance(data, dict):
        raise UsageError("a request must be a JSON object")
    return data


def _number(key: str, default: int = 0) -> int:
    text = request.args.get(key, "")
    if not text:
        return default
    if not re.fullmatch("[0-9]{1,15}", text):
        raise UsageError("'%s' must be a whole number" % key)
    return int(text)


def _time() -> float:
    """The time of the run that a request names (s)."""
    text = request.args.get("t", "")
    if not re.fullmatch(r"[0-9]{1,9}(\.[0-9]{1,6})?", text):
        raise UsageError("'t' must be a number of seconds")
    return float(text)


class _Stream:
    """The messages to one viewer. It has a cursor but no queue: a viewer that does not read blocks
    only its own thread."""

    def __init__(
        self,
        hub: Hub,
        cursor: Optional[Cursor],
        streams: Streams,
        peer: str,
    ) -> None:
        self._hub, self._cursor, self._streams, self._peer = hub, cursor, streams, peer
        hub.came()
        self._messages = self._run()
        self._open = True

    def _run(self) -> Iterator[bytes]:
        yield b"retry: 1000\n\n"
        while not self._streams.closing:
            if not self._hub.wait(self._cursor, PING):
                yield b"event: ping\ndata: {}\n\n"
                continue
            if self._hub.closed is not None:
                yield (
                    b"event: closed\ndata: %s\n\n"
                    % json.dumps({"reason": self._hub.closed}).encode()
                )
                return
            news = self._hub.news(self._cursor)
            self._cursor = news.cursor
            yield b"id: %s\ndata: %s\n\n" % (str(news.cursor).encode(), news.text.encode())
            time.sleep(GATHER)

    def __iter__(self) -> Iterator[bytes]:
        return self._messages

    def close(self) -> None:
        """Called by the web server when the viewer has disconnected."""
        if self._open:
            self._open = False
            self._hub.came(-1)
            self._streams.give_back(self._peer)
