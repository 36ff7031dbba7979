"""The interface of the page for other programs, as an OpenAPI 3.1 document.

It is written here; a test compares it with the routes of the application.
"""

from __future__ import annotations

import re
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

from gspn_framework_package.visualizer.editing.palette import TYPED
from gspn_framework_package.visualizer.guard import HEADER, TOKEN_HEADER
from gspn_framework_package.visualizer.named_schemas import (
    ADJUSTABLE,
    ANALYSIS_FIELDS,
    BOARD,
    CHANGES,
    CHECK,
    EDITORS,
    EPOCH,
    NAMED_SCHEMAS,
    POSES,
    SCENE,
    STORY,
    WHAT_IF,
)
from gspn_framework_package.visualizer.order_schemas import any_order
from gspn_framework_package.visualizer.schemas import (
    FLAG,
    NAMES,
    NUMBER,
    OBJECT,
    OBJECTS,
    POINT,
    TEXT,
    WHOLE,
    Schema,
    component,
    described_as,
    list_with,
    map_to,
    object_with,
    or_null,
)

API_VERSION = "1.5.0"
"""Version of the interface: the first number grows with each incompatible change, the second with
each addition."""

API_PARAMETERS: Dict[str, Tuple[Schema, str]] = {
    "id": (
        TEXT,
        "key of the open net, from /api/open; in /api/hello, 'first' is the one shown",
    ),
    "job": (TEXT, "the computation, as POST /api/analysis answered"),
    "at": (WHOLE, "number of an event"),
    "plan": (WHOLE, "number of a plan that the team followed; 0: the initial plan"),
    "slot": (WHOLE, "number of a slot of the log"),
    "t": (NUMBER, "seconds since the run began"),
    "after": (WHOLE, "number of the event after which to start"),
    "to": (WHOLE, "number of the last event"),
    "limit": (WHOLE, "maximum number"),
    "from": (WHOLE, "number of the first row"),
    "since": (
        TEXT,
        "for news: the cursor of the last answer; without it, the whole board comes first. For the "
        "history: the first day, YYYY-MM-DD",
    ),
    "transition": (TEXT, "name of a transition"),
    "kind": ({**TEXT, "enum": list(TYPED)}, "kind of an action that has a ROS type"),
    "type": (TEXT, "name of a ROS type, such as std_msgs/String"),
    "by": (TEXT, "grouping of the rows, separated by commas"),
    "until": (TEXT, "the day after the last day, YYYY-MM-DD"),
    "robot": (TEXT, "only this robot"),
    "place": (TEXT, "only this place"),
    "page": (TEXT, "distinguishes a page that edits a plan from other pages"),
}


class ApiOperation(NamedTuple):
    """A request that a client may send.

    :ivar name: its identifier.
    :ivar about: what it does, as one sentence.
    :ivar query: names of its parameters; with a question mark if optional.
    :ivar body: the fields of its JSON object, with their schemas; with a question mark if optional.
        None for an order, which has its own schema for each command.
    :ivar answer: the fields of its answer, likewise; empty if it only confirms. A text is the name
        of a schema in :data:`NAMED_SCHEMAS`.
    :ivar media: the type of its answer.
    :ivar sends: of a stream: event -> the name of the schema of its data, JSON in one line; the
        event "" has no name.
    """

    name: str
    about: str
    query: Sequence[str] = ()
    body: Optional[Mapping[str, Schema]] = {}
    answer: Union[str, Mapping[str, Schema]] = {}
    media: str = "application/json"
    sends: Mapping[str, str] = {}


NEW_PLAN = {"path": TEXT, "id": TEXT}
SHARED: Dict[str, Schema] = {"version?": TEXT, "page?": TEXT}
DOCUMENT = {"document": OBJECT}
CHECKED = {**DOCUMENT, "page?": TEXT}
EVENT_AT = {**EPOCH, "event": or_null(WHOLE)}
HISTORY = ("since?", "until?", "robot?", "place?")

API_OPERATIONS: Dict[Tuple[str, str], ApiOperation] = {
    ("GET", "/api/openapi.json"): ApiOperation(
        "describe_interface",
        "This document.",
        answer={"openapi": TEXT, "info": OBJECT, "paths": OBJECT},
    ),
    ("POST", "/api/login"): ApiOperation(
        "login", "Exchange a token for a cookie, as the page does.", body={"token": TEXT}
    ),
    ("GET", "/api/hello"): ApiOperation(
        "hello",
        "The server, the role of the client, and the files that can be opened.",
        answer={
            "version": TEXT,
            "role": {**TEXT, "enum": ["operator", "viewer"]},
            "orders": OBJECT,
            "first": or_null(TEXT),
            "files": list_with({"path": TEXT, "kind": TEXT}),
        },
    ),
    ("POST", "/api/open"): ApiOperation(
        "open_file", "Open a file of the folder.", body={"path": TEXT}, answer={"id": TEXT}
    ),
    ("POST", "/api/upload"): ApiOperation(
        "upload",
        "Open a net, or an input file with its net; contents are base64.",
        body={
            "files": {
                "type": "array",
                "items": {
                    "type": "object",
                    "required": ["name", "content"],
                    "properties": {"name": TEXT, "content": TEXT},
                },
            }
        },
        answer={"id": TEXT},
    ),
    ("POST", "/api/run_net"): ApiOperation(
        "run_net", "Open the run net of an open plan.", ("id",), {}, {"id": TEXT}
    ),
    ("GET", "/api/session"): ApiOperation(
        "session",
        "An open net: its title, and its scene with all places, transitions and arcs.",
        ("id",),
        answer={"id": TEXT, "title": TEXT, "executable": FLAG, "scene": SCENE},
    ),
    ("POST", "/api/do"): ApiOperation(
        "command",
        "Give an order to the simulation, the run or the team. The field "
        "'commands' of the 'info' of a snapshot lists those that are possible.",
        ("id",),
        None,
        {
            "message?": described_as(TEXT, "of an order to a run or a team: what was done"),
            "fired?": described_as(WHOLE, "of step and fire: how many transitions fired"),
            "dead?": described_as(FLAG, "of step: whether none can fire any more"),
            "back?": described_as(WHOLE, "of back: how many firings were undone"),
            "engine?": described_as(TEXT, "of layout: what computed it"),
            "places?": described_as({"type": "array", "items": POINT}, "of layout: positions"),
            "transitions?": described_as({"type": "array", "items": POINT}, "of layout: positions"),
        },
    ),
    ("GET", "/api/state"): ApiOperation(
        "state_at", "The board after an event.", ("id", "at"), answer={**EPOCH, "board": BOARD}
    ),
    ("GET", "/api/scene"): ApiOperation(
        "scene",
        "The scene of the net of one of the plans.",
        ("id", "plan?"),
        answer={**EPOCH, "scene": SCENE},
    ),
    ("GET", "/api/reasons"): ApiOperation(
        "reasons",
        "Why a transition cannot fire.",
        ("id", "transition", "at?"),
        answer={"transition": TEXT, "enabled": FLAG, "reasons": NAMES, "at": WHOLE},
    ),
    ("GET", "/api/slot"): ApiOperation(
        "after_slot", "The first event after a slot of the log.", ("id", "slot"), answer=EVENT_AT
    ),
    ("GET", "/api/moment"): ApiOperation(
        "event_at", "The last event up to a time; null if unknown.", ("id", "t"), answer=EVENT_AT
    ),
    ("GET", "/api/poses"): ApiOperation(
        "poses_around", "Where the robots were around a time.", ("id", "t"), answer=POSES
    ),
    ("GET", "/api/events"): ApiOperation(
        "events",
        "Past events.",
        ("id", "after", "to", "limit?"),
        answer={**EPOCH, "events": list_with({"n": WHOLE, "t": NUMBER, "k": TEXT})},
    ),
    ("GET", "/api/poll"): ApiOperation(
        "poll",
        "News since a cursor: first a snapshot of the board, then events.",
        ("id", "since?"),
        answer="News",
    ),
    ("GET", "/api/stream"): ApiOperation(
        "stream",
        "The same as server-sent events; Last-Event-ID resumes. 503 if there are too many viewers.",
        ("id", "since?"),
        media="text/event-stream",
        sends={"": "News", "ping": "Ping", "closed": "Closed"},
    ),
    ("POST", "/api/analysis"): ApiOperation(
        "analyse",
        "Start a computation for the present marking, or that after an event: an analysis, a "
        "question about all markings, a simulation, a sweep, or a policy.",
        ("id",),
        ANALYSIS_FIELDS,
        {"job": TEXT, "event": WHOLE},
    ),
    ("GET", "/api/what_if"): ApiOperation(
        "what_can_change", "What can be changed in a prediction.", ("id",), answer=ADJUSTABLE
    ),
    ("POST", "/api/what_if"): ApiOperation(
        "what_if", "A first look at changed runs; 'whole' starts a job.", ("id",), *WHAT_IF
    ),
    ("GET", "/api/analysis/{job}"): ApiOperation(
        "analysis_progress",
        "The progress of a computation, and its result.",
        answer={
            "state": TEXT,
            "seconds": NUMBER,
            "progress": {},
            "result": or_null(OBJECT),
            "error": or_null(TEXT),
            "saves_as": or_null(TEXT),
        },
    ),
    ("POST", "/api/analysis/{job}/cancel"): ApiOperation(
        "analysis_cancel", "Cancel a computation."
    ),
    ("GET", "/api/optimised"): ApiOperation(
        "latest_policy",
        "The policy last computed for a net.",
        ("id",),
        answer={"job": or_null(TEXT)},
    ),
    ("GET", "/api/analysis/{job}/rows"): ApiOperation(
        "policy_rows",
        "Rows of a computed policy.",
        ("from?", "limit?"),
        answer={"places": NAMES, "total": WHOLE, "changed": WHOLE, "rows": OBJECTS},
    ),
    ("GET", "/api/analysis/{job}/choices"): ApiOperation(
        "policy_choices",
        "What a computed policy chooses after an event.",
        ("id", "at?"),
        answer={"at": WHOLE, "choices": OBJECTS},
    ),
    ("GET", "/api/analysis/{job}/plan"): ApiOperation(
        "policy_plan",
        "The plan with a computed policy, as a file.",
        answer={"net": OBJECT, "actions": OBJECT, "policy?": OBJECT},
    ),
    ("POST", "/api/analysis/{job}/save"): ApiOperation(
        "policy_save",
        "Save that plan next to the original.",
        body={"name": TEXT, "overwrite?": FLAG},
        answer={"name": TEXT, "path": or_null(TEXT)},
    ),
    ("GET", "/api/deploy/targets"): ApiOperation(
        "deploy_targets",
        "The runs to which another plan can be deployed.",
        answer={"runs": list_with({"id": TEXT, "title": TEXT, "run": or_null(TEXT)})},
    ),
    ("POST", "/api/deploy/look"): ApiOperation(
        "deploy_look",
        "The changes for a run under another plan: a file, or a computed policy.",
        ("id",),
        {"path?": TEXT, "job?": TEXT},
        {
            "present": TEXT,
            "plan": TEXT,
            "verdict": TEXT,
            "refused": FLAG,
            "findings": list_with({"level": TEXT, "text": TEXT}),
            "changes": CHANGES,
            "gone": list_with({"name": TEXT, "kind": TEXT}),
            "names": OBJECT,
        },
    ),
    ("POST", "/api/deploy"): ApiOperation(
        "deploy",
        "Make a running team follow another plan.",
        ("id",),
        {
            "path?": described_as(TEXT, "the plan, as a file of the folder; or 'job'"),
            "job?": described_as(TEXT, "the computation that found its policy"),
            "map?": described_as(
                map_to(TEXT), "present name -> name in the plan, where they differ"
            ),
            "run?": described_as(TEXT, "the run that is meant; refused if another one is shown"),
        },
    ),
    ("GET", "/api/deploy"): ApiOperation(
        "deploy_progress",
        "The progress of the deployment; no state if there was none.",
        ("id",),
        answer={
            "state?": described_as(
                {**TEXT, "enum": ["looking", "done", "refused"]}, "how far it is"
            ),
            "plan?": described_as(TEXT, "name of the plan"),
            "says?": described_as(TEXT, "the reason, or what was done"),
            "votes?": described_as(
                map_to({"type": ["string", "null"]}),
                "robot -> why it refuses the plan; empty: it agrees; null: not yet known",
            ),
        },
    ),
    ("GET", "/api/history/names"): ApiOperation(
        "history_names",
        "The robots, places and days of the fleet's history.",
        answer={"robots": NAMES, "places": NAMES, "days": NAMES},
    ),
    ("GET", "/api/history/report"): ApiOperation(
        "history_report",
        "A report on the fleet's history.",
        ("by?", *HISTORY),
        answer={"rows": OBJECTS, "left_out": WHOLE},
    ),
    ("GET", "/api/history/moments"): ApiOperation(
        "history_moments",
        "The moments behind a row, each with the net that replays it.",
        HISTORY,
        answer={"moments": list_with({"id": TEXT})},
    ),
    ("GET", "/api/story"): ApiOperation(
        "story", "Who waited for whom, and what happened, in seconds.", ("id",), answer=STORY
    ),
    ("GET", "/api/report"): ApiOperation(
        "report", "The same as one HTML file.", ("id",), media="text/html"
    ),
    ("GET", "/api/edit"): ApiOperation(
        "edit_open",
        "A plan of the folder as a document.",
        ("id",),
        answer={
            "path": TEXT,
            "etag": TEXT,
            "document": OBJECT,
            "files": OBJECT,
            "scale": NUMBER,
            "laid_out": FLAG,
            "notes": NAMES,
            "draft": or_null(OBJECT),
            "read_only": TEXT,
        },
    ),
    ("POST", "/api/edit/save"): ApiOperation(
        "edit_save",
        "Save a document; 412, with theirs, if the files or the draft have changed since.",
        ("id",),
        {"etag": TEXT, **SHARED, **DOCUMENT},
        {"etag": TEXT, "files": OBJECT, "written": NAMES, "notes": NAMES},
    ),
    ("POST", "/api/edit/save_as"): ApiOperation(
        "edit_save_as", "Save it under a new name.", ("id",), {"name": TEXT, **DOCUMENT}, NEW_PLAN
    ),
    ("POST", "/api/edit/new"): ApiOperation(
        "edit_new",
        "Make a plan from a template, or an empty one.",
        body={"template?": TEXT, "name": TEXT},
        answer=NEW_PLAN,
    ),
    ("POST", "/api/edit/draft"): ApiOperation(
        "edit_draft",
        "Store an unsaved document as a draft; null deletes the draft. 412, with theirs, if "
        "somebody else has changed it since the version.",
        ("id",),
        {"etag": TEXT, **SHARED, "document": or_null(OBJECT), "history?": or_null(OBJECT)},
        {"kept": FLAG, "version": TEXT},
    ),
    ("GET", "/api/edit/latest"): ApiOperation(
        "edit_latest",
        "The state that all who edit a plan share: its draft or, without one, its files.",
        ("id",),
        answer={"version": TEXT, "etag": TEXT, "document": OBJECT, "draft": FLAG},
    ),
    ("POST", "/api/edit/here"): ApiOperation(
        "edit_here",
        "Say that a page edits a plan, and what is selected there; or that it is gone.",
        ("id",),
        {
            "page": TEXT,
            "gone?": FLAG,
            "selection?": NAMES,
            "at?": or_null(POINT),
        },
        EDITORS,
    ),
    ("GET", "/api/edit/stream"): ApiOperation(
        "edit_stream",
        "The latest version of a plan and who edits it, as server-sent events.",
        ("id", "page"),
        media="text/event-stream",
        sends={"": "Editing", "ping": "Ping"},
    ),
    ("POST", "/api/edit/export"): ApiOperation(
        "edit_export",
        "A document in another format.",
        ("id",),
        {"format": TEXT, **DOCUMENT},
        media="application/octet-stream",
    ),
    ("POST", "/api/edit/check"): ApiOperation(
        "edit_check",
        "Check a document; cancelled if another check replaces this one.",
        ("id",),
        {**CHECKED, "full?": FLAG, "standalone?": FLAG},
        CHECK,
    ),
    ("POST", "/api/edit/function"): ApiOperation(
        "edit_function",
        "A function of a plan. Without 'text', its source; with 'look', also why there is none."
        " With 'text', what is wrong with it; with 'save', write it if its version is unchanged.",
        ("id",),
        {"function": TEXT, "text?": TEXT, "look?": FLAG, "save?": FLAG, "version?": TEXT},
        {
            "file?": TEXT,
            "text?": TEXT,
            "version?": TEXT,
            "problem?": TEXT,
            "line?": or_null(WHOLE),
            "parameters?": OBJECTS,
        },
    ),
    ("POST", "/api/edit/choices"): ApiOperation(
        "edit_choices",
        "What the policy of a document chooses in a marking.",
        ("id",),
        {**CHECKED, "marking": OBJECT},
        {"places?": OBJECTS, "enabled?": NAMES, "over?": FLAG, "cancelled?": FLAG},
    ),
    ("POST", "/api/edit/diff"): ApiOperation(
        "edit_diff",
        "The differences between two documents; 'from' may be 'saved' (the files) or "
        "'running' (the run).",
        ("id",),
        {"to": OBJECT, "from": {"oneOf": [TEXT, OBJECT]}},
        {"changes?": CHANGES, "cancelled?": FLAG},
    ),
    ("POST", "/api/edit/layout"): ApiOperation(
        "edit_layout",
        "Positions for the nodes of a document.",
        ("id",),
        DOCUMENT,
        {"places": map_to(POINT), "transitions": map_to(POINT)},
    ),
    ("GET", "/api/edit/palette"): ApiOperation(
        "edit_palette",
        "The actions that a plan can choose from.",
        ("id",),
        answer={
            "functions": list_with({"name": TEXT, "doc": TEXT}),
            "plans": list_with({"file": TEXT, "name": TEXT}),
            "kinds": NAMES,
            "types": OBJECT,
            "ros": or_null(OBJECT),
        },
    ),
    ("GET", "/api/edit/fields"): ApiOperation(
        "edit_fields",
        "The fields of a ROS type.",
        ("kind", "type"),
        answer={"sent": {}, "received": {}, "why": TEXT},
    ),
}

TEXTS: Dict[str, Schema] = {
    "text/event-stream": TEXT,
    "application/octet-stream": {**TEXT, "format": "binary"},
}
"""The types of answers that are not JSON."""

ABOUT = f"""The page of `gspn serve`, `gspn replay` and the node `visualizer`, for other programs.

A GET changes nothing. A POST must carry the header `{HEADER}: 1`, and no Origin of another page.
On this machine no token is needed unless one was set; otherwise each request carries one in the
header `{TOKEN_HEADER}`; with the viewers' token, everything but GET is refused. The routes of
`/api/edit` exist only with `gspn serve --edit`, and only for the operator."""


TASK_HOOK: Dict[str, Any] = {
    "operationId": "task_ended",
    "summary": "A task of a team ended.",
    "description": "What `gspn tasks --follow --post URL` sends; each task once, and up to three "
    "times until the answer is 2xx.",
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": component("TaskEnded")}},
    },
    "responses": {"2XX": {"description": "it was taken"}},
}
"""The request to a web hook."""


def interface(version: str) -> Dict[str, Any]:
    """The OpenAPI document.

    :param version: version of the package.
    """
    paths: Dict[str, Dict[str, Any]] = {}
    for (method, path), operation in API_OPERATIONS.items():
        paths.setdefault(path, {})[method.lower()] = _described(method, path, operation)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "gspn_framework_package",
            "version": API_VERSION,
            "description": "%s\n\nServed by version %s of the package." % (ABOUT, version),
        },
        "servers": [{"url": "/"}],
        "security": [{"token": []}, {}],
        "paths": paths,
        "webhooks": {"task_ended": {"post": TASK_HOOK}},
        "components": {
            "securitySchemes": {"token": {"type": "apiKey", "in": "header", "name": TOKEN_HEADER}},
            "schemas": NAMED_SCHEMAS,
            "parameters": {
                "page": {
                    "name": HEADER,
                    "in": "header",
                    "required": True,
                    # not a "const": client generators do not accept one in a header
                    "schema": {**TEXT, "default": "1"},
                    "description": "forms of other pages cannot send it",
                }
            },
        },
    }


def _described(method: str, path: str, operation: ApiOperation) -> Dict[str, Any]:
    parameters: List[Dict[str, Any]] = [
        _parameter(name, "path", True) for name in re.findall("{(.*?)}", path)
    ]
    parameters += [
        _parameter(name.rstrip("?"), "query", not name.endswith("?")) for name in operation.query
    ]
    if method == "POST":
        parameters.append({"$ref": "#/components/parameters/page"})
    described: Dict[str, Any] = {
        "operationId": operation.name,
        "summary": operation.about,
        "parameters": parameters,
        "responses": {
            "200": {
                "description": "the answer",
                "content": {operation.media: {"schema": _answer(operation)}},
            },
            "default": {
                "description": "the reason: 400 wrong input, 401 and 403 not allowed, 409 refused",
                "content": {"application/json": {"schema": component("Error")}},
            },
        },
    }
    if method == "POST":
        body = any_order() if operation.body is None else object_with(operation.body)
        described["requestBody"] = {
            "required": True,
            "content": {"application/json": {"schema": body}},
        }
    return described


def _answer(operation: ApiOperation) -> Schema:
    if operation.sends:
        sends = ["%s: %s" % (event or "message", name) for event, name in operation.sends.items()]
        return described_as(
            TEXTS[operation.media], "event: the schema of its data. " + ", ".join(sends)
        )
    if isinstance(operation.answer, str):
        return component(operation.answer)
    return TEXTS.get(operation.media) or object_with(operation.answer)


def _parameter(name: str, where: str, required: bool) -> Dict[str, Any]:
    schema, about = API_PARAMETERS[name]
    return {
        "name": name,
        "in": where,
        "required": required,
        "schema": schema,
        "description": about,
    }
