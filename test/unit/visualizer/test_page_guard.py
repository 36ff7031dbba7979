"""The page on a robot network: who may ask for what. Each test fails when its guard is taken away."""

import pytest
from page_client import HOST, PageClient

from gspn_framework_package.visualizer.guard import COOKIE, Guard


@pytest.fixture(name="client")
def _client():
    return PageClient()


def test_the_page_itself_may_read_and_command(client):
    assert client.get("/api/hello").status_code == 200
    assert client.do("step").get_json() == {"fired": 1, "dead": False}


@pytest.mark.parametrize("host", ["evil.example:8090", "127.0.0.1:9999", "127.0.0.1", "", "192.168.1.7:8090"])
def test_a_host_header_of_another_name_is_refused(client, host):
    for path in ("/", "/api/hello", "/api/poll?id=small", "/static/js/main.js"):
        assert client.get(path, Host=host).status_code == 421
    assert client.post("/api/do?id=small", {"command": "step"}, Host=host, Origin=None).status_code == 421


@pytest.mark.parametrize("name", ["localhost:8090", "LOCALHOST:8090", "[::1]:8090"])
def test_the_names_of_this_machine_are_known(client, name):
    assert client.get("/api/hello", Host=name).status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "https://" + HOST},
        {"Origin": "http://127.0.0.1:9999"},
        {"Origin": None, "Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
        {"X_Gspn_Page": None},
        {"X_Gspn_Page": "0"},
    ],
)
def test_a_post_from_another_page_changes_nothing(client, headers):
    answer = client.post("/api/do?id=small", {"command": "step"}, **headers)
    assert answer.status_code == 403
    assert client.board()["n"] == 0


def test_a_form_cannot_command(client):
    for kind in ("text/plain", "application/x-www-form-urlencoded"):
        answer = client.post("/api/do?id=small", {"command": "step"}, Content_Type=kind)
        assert answer.status_code == 400
    assert client.board()["n"] == 0


def test_no_get_changes_anything(client):
    rules = [rule for rule in client.app.url_map.iter_rules() if "GET" in rule.methods]
    for rule in rules:
        if rule.rule not in ("/api/stream", "/static/<path:filename>"):
            client.get(rule.rule.replace("<job>", "x") + "?id=small&command=step")
    assert client.board()["n"] == 0
    for path in ("/api/do", "/api/open", "/api/upload", "/api/login"):
        assert client.get(path + "?id=small").status_code in (404, 405)


def test_there_is_no_cors(client):
    answer = client.client.options(
        "/api/do?id=small",
        headers={
            "Host": HOST,
            "Origin": "http://evil.example",
            "Access-Control-Request-Method": "POST",
        },
    )
    assert not [h for h, _ in answer.headers if h.lower().startswith("access-control")]


def test_every_answer_carries_the_security_headers(client):
    answers = [client.get("/"), client.get("/api/hello"), client.get("/nothing"), client.get("/", Host="evil")]
    for answer in answers:
        policy = answer.headers["Content-Security-Policy"]
        assert "default-src 'self'" in policy and "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy and "http" not in policy
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert answer.headers["Referrer-Policy"] == "no-referrer"


def test_beyond_this_machine_a_token_is_needed():
    guard = Guard("10.0.0.5", 8090)
    assert guard.token and len(guard.token) > 20
    client = PageClient(guard=guard)
    host = {"Host": "10.0.0.5:8090"}
    assert client.get("/api/hello", **host).status_code == 401
    assert client.get("/api/poll?id=small", **host).status_code == 401
    wrong = client.post("/api/login", {"token": "guess"}, Origin="http://10.0.0.5:8090", **host)
    assert wrong.status_code == 401
    right = client.post("/api/login", {"token": guard.token}, Origin="http://10.0.0.5:8090", **host)
    assert right.status_code == 200
    cookie = right.headers["Set-Cookie"]
    assert COOKIE in cookie and "HttpOnly" in cookie and "SameSite=Strict" in cookie
    client.client.set_cookie("10.0.0.5", COOKIE, guard.token)
    assert client.get("/api/hello", **host).status_code == 200


def test_on_loopback_no_token_is_needed():
    assert Guard("127.0.0.1", 1).token is None
    assert Guard("::1", 1).token is None
    assert Guard("0.0.0.0", 1).token is not None


def test_debug_is_off(client):
    assert not client.app.debug
    assert not client.app.testing


def test_a_fault_tells_no_traceback(client, monkeypatch):
    monkeypatch.setattr(client.project, "to_json", lambda: 1 / 0)
    answer = client.get("/api/hello")
    assert answer.status_code == 500
    assert "Traceback" not in answer.get_data(as_text=True)
    assert "/" not in answer.get_json()["error"]


@pytest.mark.parametrize("steps", [0, -1, 10_001, 10**30, "5", 1.5, True, None])
def test_the_number_of_steps_is_limited(client, steps):
    assert client.do("step", steps=steps).status_code == 400
    assert client.board()["n"] == 0


def test_a_request_that_is_too_large_is_refused(client):
    answer = client.post("/api/upload", data=b"x" * 12_000_001)
    assert answer.status_code == 413
    answer = client.post("/api/do?id=small", {"command": "step", "padding": "x" * 2_000_001})
    assert answer.status_code == 413
    assert client.board()["n"] == 0


@pytest.mark.parametrize("body", ["[]", "3", "{", '"step"', "[" * 100_000])
def test_a_request_that_is_no_object_is_refused(client, body):
    assert client.post("/api/do?id=small", data=body).status_code == 400


def test_starting_asks_for_a_confirmation_and_an_executable_plan():
    started = []
    client = PageClient(start_execution=started.append)
    assert client.do("start", confirmed=True).status_code == 409  # only a net
    session = client.project.session("small")
    session.document = session.document._replace(executable=True)
    assert client.do("start").status_code == 400
    assert client.do("start", confirmed="yes").status_code == 400
    assert not started
