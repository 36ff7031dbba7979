"""The page's interface for programs: its description agrees with the routes and the answers, and
the client in the documents works."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import jsonschema
import pytest
from page_client import PageClient, folder_project, small_net
from waiting import PATIENCE

from gspn_framework_package.execution.team_tasks import OUTCOMES_OF_TASKS, EndedTask
from gspn_framework_package.formats import encode_net, format_named
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.team.orders import ORDERS, PAGE
from gspn_framework_package.visualizer.app import create_app
from gspn_framework_package.visualizer.documents import Document, Folder
from gspn_framework_package.visualizer.guard import Guard
from gspn_framework_package.visualizer.openapi import API_OPERATIONS
from gspn_framework_package.visualizer.order_schemas import schema_name
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.serving import WebServer
from gspn_framework_package.visualizer.session import Session
from gspn_framework_package.visualizer.simulation import OfflineSimulation
from gspn_framework_package.visualizer.standalone_run import ANSWERS

ROOT = Path(__file__).parents[3]


@pytest.fixture(name="page")
def _page():
    return PageClient()


def operations(page):
    return {
        (method.upper(), path): operation
        for path, item in document_of(page)["paths"].items()
        for method, operation in item.items()
    }


def document_of(page):
    return page.get("/api/openapi.json").get_json()


def whole(schema, page):
    """The schema, with those that it refers to by name."""
    components = document_of(page)["components"]
    if "$ref" in schema:
        schema = components["schemas"][schema["$ref"].split("/")[-1]]
    return {**schema, "components": components}


def answer_schema(operation, page):
    return whole(operation["responses"]["200"]["content"]["application/json"]["schema"], page)


def body_schema(operation, page):
    return whole(operation["requestBody"]["content"]["application/json"]["schema"], page)


def test_every_route_is_described_and_every_description_is_a_route(page, tmp_path):
    app = create_app(Project(Folder(str(tmp_path)), edits=True), Guard("127.0.0.1", 8090))
    routes = {
        (method, re.sub("<(.*?)>", r"{\1}", rule.rule))
        for rule in app.url_map.iter_rules()
        for method in rule.methods - {"HEAD", "OPTIONS"}
        if rule.rule.startswith("/api/")
    }
    assert set(operations(page)) == routes == set(API_OPERATIONS)


def test_the_description_is_whole(page):
    document = document_of(page)
    assert document["openapi"] == "3.1.0" and document["info"]["version"]
    names = [operation["operationId"] for operation in operations(page).values()]
    assert len(set(names)) == len(names)
    for (method, path), operation in operations(page).items():
        given = [p for p in operation["parameters"] if "$ref" not in p]
        assert {p["name"] for p in given if p["in"] == "path"} == set(re.findall("{(.*?)}", path))
        posted = {"$ref": "#/components/parameters/page"} in operation["parameters"]
        assert posted == ("requestBody" in operation) == (method == "POST")
        assert operation["summary"].endswith(".")
        for p in given:
            jsonschema.Draft7Validator.check_schema(p["schema"])


DONE = {"login", "analysis_cancel", "deploy"}  # their answers say nothing else


def test_generators_of_clients_find_all_that_they_need(page):
    """They leave out an operation that has a constant in its header, and leave untyped what is not
    described."""
    document = document_of(page)
    header = document["components"]["parameters"]["page"]
    assert header["schema"] == {"type": "string", "default": "1"} and header["in"] == "header"
    for operation in operations(page).values():
        for parameter in operation["parameters"]:
            assert "$ref" in parameter or parameter["schema"]["type"] in (
                "string",
                "integer",
                "number",
            )
        for media, content in operation["responses"]["200"]["content"].items():
            schema = whole(content["schema"], page)
            typed = media != "application/json" or bool(schema["properties"])
            assert typed != (operation["operationId"] in DONE), operation["operationId"]
    for part in parts_of(document):
        assert "const" not in part
        assert part.get("type") != "array" or "items" in part, part


def parts_of(value):
    """All objects in a JSON value."""
    if isinstance(value, list):
        return [part for item in value for part in parts_of(item)]
    if not isinstance(value, dict):
        return []
    return [value, *(part for item in value.values() for part in parts_of(item))]


def test_answers_are_as_described(page):
    described = operations(page)
    page.do("step")
    for path in (
        "/api/hello",
        "/api/session?id=small",
        "/api/state?id=small&at=0",
        "/api/scene?id=small",
        "/api/events?id=small&after=0&to=1",
        "/api/poll?id=small",
        "/api/slot?id=small&slot=0",
        "/api/optimised?id=small",
        "/api/deploy/targets",
        "/api/analysis/no_such_job",
        "/api/session?id=nothing",
        "/api/history/names",
        "/api/openapi.json",
        "/api/reasons?id=small&transition=t",
        "/api/deploy?id=small",
    ):
        plain = re.sub("no_such_job", "{job}", path.partition("?")[0])
        responses, answer = described["GET", plain]["responses"], page.get(path)
        if answer.status_code == 200:
            schema = answer_schema(described["GET", plain], page)
        else:
            assert responses["default"]["content"]["application/json"]["schema"] == {
                "$ref": "#/components/schemas/Error"
            }
            schema = document_of(page)["components"]["schemas"]["Error"]
        jsonschema.validate(answer.get_json(), schema)
    assert page.get("/api/session?id=nothing").status_code == 400


def test_answers_to_orders_and_edits_are_as_described(tmp_path):
    shutil.copytree(str(ROOT / "plans" / "patrol"), str(tmp_path / "patrol"))
    page = PageClient(Project(Folder(str(tmp_path)), edits=True))
    described = operations(page)

    def answer(method, path, body=None):
        found = page.get(path) if method == "GET" else page.post(path, body)
        assert found.status_code == 200, (path, found.get_data())
        operation = described[method, path.partition("?")[0]]
        schema = answer_schema(operation, page)
        jsonschema.validate(found.get_json(), schema)
        said = set(found.get_json()) - {"revision"}
        assert said <= set(schema["properties"]), path
        return found.get_json()

    key = "?id=" + answer("POST", "/api/open", {"path": "patrol"})["id"]
    for command in ("step", "back", "reset", "clear", "layout"):
        answer("POST", "/api/do" + key, {"command": command})
    answer("POST", "/api/analysis" + key, {})
    opened = answer("GET", "/api/edit" + key)
    document = {"document": opened["document"]}
    answer("POST", "/api/edit/check" + key, document)
    answer("POST", "/api/edit/choices" + key, {**document, "marking": {}})
    answer("POST", "/api/edit/diff" + key, {"to": opened["document"], "from": "saved"})
    answer("POST", "/api/edit/layout" + key, document)
    answer("POST", "/api/edit/draft" + key, {**document, "etag": opened["etag"]})
    answer("POST", "/api/edit/save" + key, {**document, "etag": opened["etag"]})
    answer("POST", "/api/edit/save_as" + key, {**document, "name": "copy"})
    answer("POST", "/api/edit/new", {"name": "mine"})
    answer("GET", "/api/edit/palette" + key)
    answer("POST", "/api/edit/function" + key, {"function": "tasks.sweep"})
    answer("POST", "/api/edit/function" + key, {"function": "tasks.sweep", "text": "("})
    answer("GET", "/api/edit/fields?kind=publish&type=std_msgs/String")


def test_every_command_is_described_and_every_description_is_a_command():
    page = PageClient()
    orders = {name for name, kind in ORDERS.items() if kind.form is not None}
    simulation = OfflineSimulation(small_net()).commands
    assert {*ANSWERS, "stop", "breakpoints"} <= orders
    schema = body_schema(operations(page)["POST", "/api/do"], page)
    described = schema["discriminator"]["mapping"]
    assert set(described) == {*orders, *simulation, "layout", "start", "simulate"}
    assert sorted(described.values()) == sorted(each["$ref"] for each in schema["oneOf"])
    for command, where in described.items():
        order = whole({"$ref": where}, page)
        assert order["properties"]["command"]["enum"] == [command]
        fields = (
            {field.name: field for field in ORDERS[command].fields} if command in orders else {}
        )
        assert set(fields) <= set(order["properties"]), command
        required = {name for name, field in fields.items() if field.required}
        assert set(order["required"]) >= {"command", *required}
        assert all(order["properties"][name]["description"] for name in [*fields, "run"])


ORDERS_OF_CLIENTS = [
    ({"command": "pause"}, True),
    ({"command": "pause", "robot": "robot_1", "stop": True, "run": "monday"}, True),
    ({"command": "pause", "stop": "yes"}, False),
    ({"command": "submit", "transition": "t", "id": 7, "data": {"a": 1}, "until": "+10m"}, True),
    ({"command": "submit", "transition": "t", "at": "+1h", "every": "10m"}, True),
    ({"command": "submit", "transition": "t", "data": []}, False),
    ({"command": "submit", "transition": "t", "priority": 1.5}, False),
    ({"command": "submit", "id": "o1"}, False),
    ({"command": "set_place", "robot": "robot_1"}, False),
    ({"command": "prioritise", "id": "o1", "priority": 3}, True),
    ({"command": "breakpoints", "names": ["Door"]}, True),
    ({"command": "breakpoints", "names": [1]}, False),
]


@pytest.mark.parametrize(("order", "taken"), ORDERS_OF_CLIENTS)
def test_an_order_is_taken_if_it_is_as_described(order, taken):
    page = PageClient()
    schema = whole({"$ref": "#/components/schemas/" + schema_name(order["command"])}, page)
    assert jsonschema.Draft7Validator(schema).is_valid(order) == taken
    if taken:
        ORDERS[order["command"]].checked(order, PAGE)
    else:
        with pytest.raises(GspnError):
            ORDERS[order["command"]].checked(order, PAGE)


@pytest.mark.long
def test_the_messages_of_streams_are_as_described():
    page = PageClient()
    operation = operations(page)["GET", "/api/stream"]
    says = operation["responses"]["200"]["content"]["text/event-stream"]["schema"]["description"]
    assert "message: News, ping: Ping, closed: Closed" in says
    messages = page.get("/api/stream?id=small").response
    assert next(messages) == b"retry: 1000\n\n"

    def told(name):
        *_, data = next(messages).decode().rstrip().splitlines()
        schema = whole({"$ref": "#/components/schemas/" + name}, page)
        jsonschema.validate(json.loads(data.partition("data: ")[2]), schema)
        return json.loads(data.partition("data: ")[2])

    assert told("News")["snapshot"]["board"]["n"] == 0
    page.do("step")
    assert told("News")["events"][0]["k"] == "fire"
    page.project.sessions.get("small").close("the test is over")
    assert told("Closed")["reason"] == "the test is over"


def test_the_web_hook_is_described():
    page = PageClient()
    hook = document_of(page)["webhooks"]["task_ended"]["post"]
    schema = whole(hook["requestBody"]["content"]["application/json"]["schema"], page)
    for outcome in OUTCOMES_OF_TASKS:
        jsonschema.validate(EndedTask("o1", outcome, "why")._asdict(), schema)
    assert not jsonschema.Draft7Validator(schema).is_valid({"id": "o1"})
    assert set(schema["required"]) == set(EndedTask._fields)


def test_a_field_that_is_described_as_needed_is_needed(tmp_path):
    page = PageClient(folder_project(tmp_path))
    for path, field in (("/api/open", "path"), ("/api/upload", "files"), ("/api/do?id=x", "")):
        schema = body_schema(operations(page)["POST", path.partition("?")[0]], page)
        assert not field or field in schema["required"]
        assert page.post(path, {}).status_code == 400


def test_a_viewer_may_read_the_description_and_nobody_without_a_token():
    guard = Guard("127.0.0.1", 8090, token="o" * 20, viewer_token="v" * 20)
    project = Project()
    project.show(Session("small", Document("small", small_net())))
    page = PageClient(project, guard)
    assert page.get("/api/openapi.json").status_code == 401
    assert page.get("/api/openapi.json", X_Gspn_Token="v" * 20).status_code == 200
    refused = page.post("/api/do?id=small", {"command": "step"}, X_Gspn_Token="v" * 20)
    assert refused.status_code == 403 and "read-only" in refused.get_json()["error"]


@pytest.mark.parametrize("served", ["net", "folder"])
def test_the_client_in_the_documents_works(served, tmp_path):
    text = (ROOT / "docs" / "tools.md").read_text(encoding="utf-8")
    others = [path for path in (ROOT / "docs").glob("*.md") if "urllib" in path.read_text("utf-8")]
    assert [path.name for path in others] == ["tools.md"]  # each is to be run by a test
    client = re.search(r":caption: look\.py\n(.*?)```", text, re.DOTALL).group(1)
    order = re.search(r'`(ask\("do.*?)`', text).group(1)
    assert len([line for line in client.splitlines() if line.strip()]) <= 14
    project = Project(Folder(str(tmp_path)) if served == "folder" else None)
    if served == "net":
        project.show(Session("small", Document("small", small_net())))
    else:
        (tmp_path / "small.xml").write_bytes(encode_net(small_net(), format_named("pipe"))[0])
    server = WebServer(project, port=0, token="o" * 20)
    server.start()
    try:
        client = client.replace(":8090/", ":%d/" % server.port)
        client = client.replace(', ""', ', "%s"' % ("o" * 20))
        done = subprocess.run(
            [sys.executable, "-c", client + order.replace("pause", "step")],
            capture_output=True,
            text=True,
            timeout=60 * PATIENCE,
        )
        assert done.stderr == "" and done.stdout.split() == ["a", "1", "b", "0"]
        (session,) = project.sessions.all()
        board = session.hub.board()
        assert board.n == 1
    finally:
        server.stop()
