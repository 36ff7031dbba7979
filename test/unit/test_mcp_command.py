"""``gspn mcp``: the protocol over standard input and output, and the tools behind it."""

import contextlib
import io
import json
import os
import queue
import re
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import jsonschema
import psutil
import pytest
from waiting import PATIENCE

from gspn_framework_package.cli import mcp_tools
from gspn_framework_package.cli.main import verb_parser
from gspn_framework_package.cli.mcp_resources import Resources
from gspn_framework_package.cli.mcp_server import VERSIONS, ModelContextServer
from gspn_framework_package.cli.mcp_tools import CallLimits, PlanTools
from gspn_framework_package.model.errors import CancelledError, GspnError, LimitError

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module", name="plans")
def _plans(tmp_path_factory):
    folder = tmp_path_factory.mktemp("served") / "plans"
    for name in ("tokens", "rendezvous"):
        shutil.copytree(ROOT / "plans" / name, folder / name)
    (folder / "json.py").write_text("raise SystemExit('the code of a plan was imported')\n")
    (folder.parent / "outside.json").write_text("{}")
    (folder / "way_out").symlink_to(folder.parent)
    return folder


@pytest.fixture(name="tools")
def _tools(plans):
    return PlanTools(str(plans), False, CallLimits(100.0, 200_000))


def call(tools, name, **arguments):
    answer = json.loads(tools.call(name, arguments, lambda seconds: False))
    (schema,) = (tool["outputSchema"] for tool in tools.listed() if tool["name"] == name)
    jsonschema.validate(answer, schema)
    assert set(schema["required"]) <= set(answer)
    return answer


def refused(tools, name, **arguments):
    with pytest.raises(GspnError) as caught:
        tools.call(name, arguments, lambda seconds: False)
    return str(caught.value)


# -- the tools


def test_plans_are_listed_and_checked(tools):
    assert "tokens/plan.json" in [entry["path"] for entry in call(tools, "list_plans")["files"]]
    report = call(tools, "check", plan="rendezvous", robots=4)
    assert report["accepted"] and report["items"]
    (found,) = call(tools, "explain_witness", plan="rendezvous/plan.json")["sequences"]
    assert found["steps"] and found["check"] == "dead_after_loss"


def test_questions_about_all_markings_are_decided(tools):
    report = call(tools, "check", plan="tokens", never=["p3 >= 1"], moves=True, seconds=5)
    reached, moves = report["answers"]
    assert reached["verdict"] == "violated" and moves["verdict"] == "proven"
    played = call(tools, "explain_witness", plan="tokens", transitions=reached["sequence"])
    assert played["sequences"][0]["stopped_by"] == ""


def test_numbers_are_those_of_the_command_line(tools):
    analysis = call(
        tools, "analyse", plan="tokens", reach="p3 >= 1", at=[1, 2.5], no_structure=True
    )
    assert analysis["places"] == 7 and "p3 >= 1" in json.dumps(analysis)
    assert analysis["place_invariants"] is None
    asked = ["P=? [ F<=10 p3 >= 1 ]", "AG EF p1 = 1"]
    answers = call(tools, "analyse", plan="tokens/net.xml", query=asked, servers="single")[
        "queries"
    ]
    assert [answer["query"] for answer in answers] == asked
    simulated = call(tools, "simulate", plan="tokens", time=50, replications=20, seed=3)
    assert simulated["replications"] == 20 and simulated["seed"] == 3


def test_who_calls_says_how_long_the_answer_may_take(tools):
    assert call(tools, "analyse", plan="tokens", may_wait=90)["places"] == 7
    told = refused(tools, "simulate", plan="tokens", time=1e9, replications=10**6, may_wait=0.2)
    assert "no answer within 0.2 seconds" in told


@pytest.mark.long
def test_plans_are_compared_and_optimised_under_constraints(tools):
    compared = call(
        tools, "simulate", plan="rendezvous", against="rendezvous", reward="Fetched=1", seconds=0.5
    )
    assert compared["old"] == compared["new"]
    assert "only files" in refused(tools, "simulate", plan="tokens", against="../outside.json")
    best = call(
        tools,
        "optimise",
        plan="rendezvous",
        reward=["Fetched=1"],
        may_wait_in=["Low"],
        simulate=0,
    )
    assert best["lower"] <= best["value"] <= best["upper"]
    names = call(tools, "explain_witness", plan="tokens", run_net=True)
    assert names["places"] and "sequences" not in names


def test_every_option_of_the_verbs_is_a_field_or_withheld_for_a_reason(tools):
    listed = {tool["name"]: tool for tool in tools.listed()}
    for name, tool in mcp_tools.TOOLS.items():
        schema = listed[name]["inputSchema"]
        jsonschema.Draft7Validator.check_schema(schema)
        jsonschema.Draft7Validator.check_schema(listed[name]["outputSchema"])
        assert all(
            field.get("description") or "enum" in field for field in schema["properties"].values()
        )
        if tool.verb:
            options = {
                action.option_strings[-1].lstrip("-")
                for action in verb_parser(tool.verb)._actions
                if action.option_strings
            }
            assert not set(tool.options) & set(mcp_tools.WITHHELD)
            assert options == {*tool.options, *(options & set(mcp_tools.WITHHELD))}, name


def test_a_refused_plan_is_an_answer_and_not_an_error(tools, plans):
    plan = json.loads((plans / "tokens" / "plan.json").read_text())
    plan["actions"] = {**plan["actions"], "p1": "actions.no_such_function"}
    (plans / "tokens" / "broken.json").write_text(json.dumps(plan))
    assert call(tools, "check", plan="tokens/broken.json")["accepted"] is False


@pytest.mark.parametrize(
    "path", ["../outside.json", "/etc/passwd", "way_out/outside.json", "no_such", "--help", "a\0b"]
)
def test_nothing_outside_the_folder_is_read(tools, path):
    assert refused(tools, "check", plan=path)


@pytest.mark.parametrize(
    "change",
    [
        {"net": "../../outside.json"},
        {"net": {"file": "/etc/passwd"}},
        {"policy": "../way_out/outside.json"},
        {"actions": {"p1": {"plan": "../../outside.json"}}},
    ],
)
def test_a_plan_that_names_files_outside_is_not_read(tools, plans, change):
    plan = {**json.loads((plans / "tokens" / "plan.json").read_text()), **change}
    (plans / "tokens" / "leaves.json").write_text(json.dumps(plan))
    assert "outside the folder" in refused(tools, "check", plan="tokens/leaves.json")


def test_arguments_are_checked_and_never_taken_for_options(tools):
    assert "required" in refused(tools, "check")
    assert "unexpected" in refused(tools, "check", plan="tokens", output="x")
    assert "robots" in refused(tools, "check", plan="tokens", robots=0)
    assert refused(tools, "analyse", plan="tokens", reach="--csv=stolen.csv")
    assert "stopped_by" in json.dumps(
        call(tools, "explain_witness", plan="tokens", transitions=["--help"])
    )
    assert "begin" in refused(tools, "draft_plan", template="patrol", places=["--json", "b"])


def test_a_draft_is_checked_and_nothing_is_written(tools, plans):
    before = sorted(os.listdir(plans))
    drafted = call(tools, "draft_plan", template="patrol", robots=3, places=["a", "b"])
    assert drafted["check"]["accepted"] and drafted["written_to"] is None
    assert "plan.json" in drafted["files"]
    document = json.loads((plans / "tokens" / "instant.json").read_text())
    assert "must not name files" in refused(
        tools, "draft_plan", document=document
    )  # it names its net's file
    assert "--allow-write" in refused(tools, "draft_plan", template="patrol", output="new")
    assert "--allow-write" in refused(
        tools, "optimise", plan="rendezvous", reward=["Fetched=1"], output="better.json"
    )
    assert refused(tools, "draft_plan") and refused(tools, "draft_plan", document={"net": 1})
    assert sorted(os.listdir(plans)) == before


def test_new_plans_are_written_where_that_is_allowed(plans):
    tools = PlanTools(str(plans), True, CallLimits(100.0, 200_000))
    net = {
        "places": [{"name": "a", "tokens": 1}, {"name": "b"}],
        "transitions": [
            {"name": "go", "timed": True, "rate": 1},
            {"name": "back", "timed": True, "rate": 1},
        ],
        "arcs": [
            {"from": "a", "to": "go"},
            {"from": "go", "to": "b"},
            {"from": "b", "to": "back"},
            {"from": "back", "to": "a"},
        ],
    }
    document = {"net": net, "actions": {"a": {"server": "a"}, "b": None}}
    drafted = call(tools, "draft_plan", document=document, output="drafted")
    assert drafted["check"]["accepted"], drafted
    assert call(tools, "check", plan="drafted")["accepted"]
    assert "already exists" in refused(tools, "draft_plan", document=document, output="drafted")
    for path in ("../drafted", "way_out/drafted", "..", "/tmp/drafted", ".hidden", "no/such/dir"):
        assert refused(tools, "draft_plan", document=document, output=path)
    call(
        tools,
        "optimise",
        plan="rendezvous",
        reward=["Fetched=1"],
        simulate=0,
        output="rendezvous/best.json",
    )
    assert call(tools, "check", plan="rendezvous/best.json")["accepted"]


def test_a_call_has_limits_and_can_be_cancelled(plans, monkeypatch):
    monkeypatch.setattr(mcp_tools, "TICK", 0.01)
    short = PlanTools(str(plans), False, CallLimits(0.02, 300))
    with pytest.raises(LimitError, match="no answer within"):
        short.call("simulate", {"plan": "tokens", "time": 1e9}, lambda seconds: False)
    with pytest.raises(CancelledError):
        short.call("simulate", {"plan": "tokens", "time": 1e9}, lambda seconds: True)
    short = PlanTools(str(plans), False, CallLimits(100.0, 300))
    with pytest.raises(LimitError, match="of which these are the first 300:"):
        short.call("check", {"plan": "tokens"}, lambda seconds: False)


# -- what can be read


def test_plans_and_documents_can_be_read(plans):
    resources = Resources(str(plans), 200_000)
    listed = {resource["uri"]: resource for resource in resources.listed()}
    assert listed["gspn://files/tokens/plan.json"]["mimeType"] == "application/json"
    assert listed["gspn://docs/plan_file.md"]["description"]
    for uri, whole in (
        ("gspn://files/tokens/plan.json", plans / "tokens" / "plan.json"),
        ("gspn://docs/plan_file.md", ROOT / "docs" / "plan_file.md"),
    ):
        (content,) = resources.read(uri)["contents"]
        assert (content["uri"], content["text"]) == (uri, whole.read_text("utf-8"))
    for uri in listed:
        resources.read(uri)


@pytest.mark.parametrize(
    "uri",
    [
        "gspn://files/../outside.json",
        "gspn://files/way_out/outside.json",
        "gspn://files/%2Fetc/passwd",
        "gspn://files/tokens/actions.py",
        "gspn://files/no_such.json",
        "gspn://docs/../setup.py",
        "gspn://docs/conf.py",
        "file:///etc/passwd",
        "None",
    ],
)
def test_nothing_else_can_be_read(plans, uri):
    with pytest.raises(GspnError):
        Resources(str(plans), 200_000).read(uri)


def test_what_is_too_long_is_not_read(plans):
    with pytest.raises(LimitError, match="more than 100 characters"):
        Resources(str(plans), 100).read("gspn://files/tokens/plan.json")


def test_every_tool_is_documented():
    text = (ROOT / "docs" / "tools.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)) == set(mcp_tools.TOOLS)


# -- the protocol


class _Echo:
    """Tools that answer what the test wants."""

    instructions = "for the test"

    def __init__(self):
        self.begun, self.go_on = threading.Event(), threading.Event()

    def listed(self):
        return [{"name": name} for name in ("say", "fail", "break", "wait")]

    def call(self, name, arguments, tick):
        if name == "fail":
            raise GspnError("no", hint="yes")
        if name == "break":
            raise ValueError("a fault")
        if name == "wait":
            self.begun.set()
            while not tick(1.0):
                self.go_on.wait(0.01)
            raise CancelledError("cancelled")
        return json.dumps({"said": arguments})


def exchange(*messages):
    """What the server answers to messages that come at once."""
    lines = [m if isinstance(m, bytes) else json.dumps(m).encode() for m in messages]
    answers = io.BytesIO()
    ModelContextServer(_Echo(), None, io.BytesIO(b"\n".join(lines) + b"\n"), answers).run()
    return [json.loads(line) for line in answers.getvalue().splitlines()]


def request(method, key=1, **params):
    return {"jsonrpc": "2.0", "id": key, "method": method, "params": params}


def test_the_greeting_agrees_on_a_version():
    for asked, answered in (("2024-11-05", "2024-11-05"), ("2099-01-01", VERSIONS[0])):
        (answer,) = exchange(request("initialize", protocolVersion=asked))
        assert answer["result"]["protocolVersion"] == answered
        assert answer["result"]["serverInfo"]["name"] == "gspn"
        assert answer["result"]["capabilities"] == {"tools": {}, "resources": {}}


def test_requests_are_answered_and_notifications_are_not():
    notice = {"jsonrpc": "2.0", "method": "notifications/initialized"}
    answers = exchange(notice, request("ping", "x"), request("tools/list", 2))
    assert answers[0] == {"jsonrpc": "2.0", "id": "x", "result": {}}
    assert [tool["name"] for tool in answers[1]["result"]["tools"]][0] == "say"


@pytest.mark.parametrize(
    "message, code",
    [
        (b"{", -32700),
        (b"[" * 100_000, -32700),
        (b"[]", -32600),
        (b'{"id": 1}', -32600),
        ({"id": None, "method": "ping"}, -32600),
        ({"id": True, "method": "ping"}, -32600),
        (request("no/such"), -32601),
        (request("tools/call", name="no_such"), -32602),
        (request("tools/call", name="say", arguments=[1]), -32602),
        (b"x" * 4_000_001, -32600),
    ],
)
def test_a_wrong_message_is_answered_with_an_error(message, code):
    (answer,) = exchange(message)
    assert answer["error"]["code"] == code and answer["error"]["message"]


def serve():
    """A server at pipes: its tools, a function that sends, and the queue of its answers."""
    requests, to_server = os.pipe()
    from_server, answers = os.pipe()
    tools, news = _Echo(), queue.Queue()
    ends = [os.fdopen(requests, "rb"), os.fdopen(answers, "wb")]

    def run():
        with ends[0], ends[1]:
            ModelContextServer(tools, None, ends[0], ends[1]).run()

    def read():
        with os.fdopen(from_server, "rb") as file:
            for line in file:
                news.put(json.loads(line))
        news.put(None)

    threads = [threading.Thread(target=each, daemon=True) for each in (run, read)]
    for thread in threads:
        thread.start()
    return tools, os.fdopen(to_server, "wb", buffering=0), news


def test_calls_end_in_an_answer_progress_or_silence():
    tools, send, news = serve()
    meta = {"progressToken": "p"}
    for message in (
        request("tools/call", 1, name="say", arguments={"a": "ü"}),
        request("tools/call", 2, name="fail"),
        request("tools/call", 3, name="break"),
    ):
        send.write(json.dumps(message).encode() + b"\n")
    answers = {
        answer["id"]: answer["result"]
        for answer in (news.get(timeout=20 * PATIENCE) for _ in "123")
    }
    assert answers[1]["content"] == [{"type": "text", "text": '{"said": {"a": "\\u00fc"}}'}]
    assert answers[1]["structuredContent"] == {"said": {"a": "ü"}}
    assert not answers[1]["isError"] and answers[2]["isError"] and answers[3]["isError"]
    assert answers[2]["content"][0]["text"] == "error: no (yes)"
    assert "ValueError" in answers[3]["content"][0]["text"]
    send.write(json.dumps(request("tools/call", 4, name="wait", _meta=meta)).encode() + b"\n")
    assert tools.begun.wait(20)
    progress = news.get(timeout=20 * PATIENCE)
    assert progress["method"] == "notifications/progress"
    assert progress["params"]["progressToken"] == "p"
    cancel = {"jsonrpc": "2.0", "method": "notifications/cancelled", "params": {"requestId": 4}}
    send.write(
        json.dumps(cancel).encode() + b"\n" + json.dumps(request("ping", 5)).encode() + b"\n"
    )
    send.close()
    left = list(iter(lambda: news.get(timeout=20 * PATIENCE), None))
    assert [m["id"] for m in left if "id" in m] == [5]  # nobody waits for a cancelled call


def test_resources_are_listed_and_read_over_the_protocol(plans):
    lines = [
        request("resources/list"),
        request("resources/templates/list", 2),
        request("resources/read", 3, uri="gspn://files/tokens/plan.json"),
        request("resources/read", 4, uri="gspn://files/../outside.json"),
        request("resources/read", 5),
    ]
    answers, text = io.BytesIO(), b"\n".join(json.dumps(line).encode() for line in lines)
    resources = Resources(str(plans), 200_000)
    ModelContextServer(_Echo(), resources, io.BytesIO(text + b"\n"), answers).run()
    listed, templates, read, *refusals = map(json.loads, answers.getvalue().splitlines())
    assert "gspn://files/tokens/plan.json" in [r["uri"] for r in listed["result"]["resources"]]
    assert templates["result"] == {"resourceTemplates": []}
    assert json.loads(read["result"]["contents"][0]["text"])["net"]
    assert [refusal["error"]["code"] for refusal in refusals] == [-32002, -32002]


@contextlib.contextmanager
def program(plans):
    """``gspn mcp`` at pipes; it ends with the block at the latest."""
    server = subprocess.Popen(
        [sys.executable, "-m", "gspn_framework_package", "mcp", str(plans)],
        cwd=str(ROOT),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    with server:
        try:
            yield server
        finally:
            server.kill()


def send_call(server, name, **arguments):
    message = request("tools/call", name=name, arguments=arguments)
    server.stdin.write(json.dumps(message).encode() + b"\n")
    server.stdin.flush()


def test_the_program_answers_until_its_input_ends(plans):
    with program(plans) as server:
        send_call(server, "check", plan="tokens")
        result = json.loads(server.stdout.readline())["result"]
        assert json.loads(result["content"][0]["text"])["accepted"] and not result["isError"]
        assert result["structuredContent"] == json.loads(result["content"][0]["text"])
        out, err = server.communicate(timeout=60 * PATIENCE)
        assert (server.returncode, out, err) == (0, b"", b"")


def test_what_a_call_runs_ends_with_a_killed_program(plans):
    with program(plans) as server:
        send_call(server, "simulate", plan="tokens", time=1e9, replications=1000)
        deadline, children = time.monotonic() + 60, []
        while not children and time.monotonic() < deadline:
            children = psutil.Process(server.pid).children()
            time.sleep(0.02)
        server.kill()
        assert children and not psutil.wait_procs(children, timeout=30 * PATIENCE)[1]
