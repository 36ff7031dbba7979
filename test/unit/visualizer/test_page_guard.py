"""The page on a robot network: who may ask for what. Each test fails when its guard is taken
away."""

import pytest
from page_client import HOST, PageClient

from gspn_framework_package.model.errors import InputError, UsageError
from gspn_framework_package.visualizer.guard import GUESSES, Guard, read_tokens


@pytest.fixture(name="client")
def _client():
    return PageClient()


def test_the_page_itself_may_read_and_command(client):
    assert client.get("/api/hello").status_code == 200
    assert client.do("step").get_json() == {"fired": 1, "dead": False}


@pytest.mark.parametrize(
    "host", ["evil.example:8090", "127.0.0.1:9999", "127.0.0.1", "", "192.168.1.7:8090"]
)
def test_a_host_header_of_another_name_is_refused(client, host):
    for path in ("/", "/api/hello", "/api/poll?id=small", "/static/js/main.js"):
        assert client.get(path, Host=host).status_code == 421
    assert (
        client.post("/api/do?id=small", {"command": "step"}, Host=host, Origin=None).status_code
        == 421
    )


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
    answers = [
        client.get("/"),
        client.get("/api/hello"),
        client.get("/nothing"),
        client.get("/", Host="evil"),
    ]
    for answer in answers:
        policy = answer.headers["Content-Security-Policy"]
        assert "default-src 'self'" in policy and "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy and "http" not in policy
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert answer.headers["Referrer-Policy"] == "no-referrer"


BEYOND = {"Host": "10.0.0.5:8090", "Origin": "http://10.0.0.5:8090"}


def log_in(client, token):
    answer = client.post("/api/login", {"token": token}, **BEYOND)
    for cookie in answer.headers.getlist("Set-Cookie"):
        name, value = cookie.split(";")[0].split("=")
        client.client.set_cookie("10.0.0.5", name, value)
    return answer


def test_beyond_this_machine_a_token_is_needed():
    guard = Guard("10.0.0.5", 8090)
    assert guard.token and len(guard.token) > 20
    client = PageClient(guard=guard)
    assert client.get("/api/hello", **BEYOND).status_code == 401
    assert client.get("/api/poll?id=small", **BEYOND).status_code == 401
    assert client.post("/api/do?id=small", {"command": "step"}, **BEYOND).status_code == 401
    assert log_in(client, "guess").status_code == 401
    right = log_in(client, guard.token)
    assert right.status_code == 200
    cookie = right.headers["Set-Cookie"]
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie and guard.token not in cookie
    assert client.get("/api/hello", **BEYOND).get_json()["role"] == "operator"
    assert client.post("/api/do?id=small", {"command": "step"}, **BEYOND).status_code == 200


def test_the_viewers_token_may_look_and_do_nothing():
    guard = Guard("10.0.0.5", 8090)
    client = PageClient(guard=guard)
    assert log_in(client, guard.viewer_token).status_code == 200
    assert client.get("/api/hello", **BEYOND).get_json()["role"] == "viewer"
    assert client.get("/api/session?id=small", **BEYOND).status_code == 200
    posts = [rule.rule for rule in client.app.url_map.iter_rules() if "POST" in rule.methods]
    for rule in posts:
        if rule != "/api/login":
            refused = client.post(
                rule.replace("<job>", "x") + "?id=small", {"command": "step"}, **BEYOND
            )
            assert refused.status_code == 403 and "is read-only" in refused.get_json()["error"], (
                rule
            )
    assert client.get("/api/poll?id=small", **BEYOND).get_json()["snapshot"]["board"]["n"] == 0
    # who knows the other one may go on with that
    assert log_in(client, guard.token).status_code == 200
    assert client.post("/api/do?id=small", {"command": "step"}, **BEYOND).status_code == 200


def test_on_loopback_no_token_is_needed_and_everybody_is_an_operator():
    for host in ("127.0.0.1", "::1"):
        assert Guard(host, 1).token is None and Guard(host, 1).viewer_token is None
    both = Guard("0.0.0.0", 1)
    assert both.token and both.viewer_token and both.token != both.viewer_token
    assert PageClient().get("/api/hello").get_json()["role"] == "operator"
    # a role that may do less asks for one that may do more
    assert Guard("127.0.0.1", 1, viewer_token="v" * 16).token


@pytest.mark.parametrize("token", ["a", "x" * 15, "", "\u00e9" * 20, "a\nb" * 10])
def test_a_token_that_is_short_or_no_plain_text_is_refused(token):
    for field in ("token", "viewer_token"):
        with pytest.raises(UsageError, match="at least 16 characters"):
            Guard("127.0.0.1", 1, **{field: token})
    with pytest.raises(UsageError, match="the same"):
        Guard("127.0.0.1", 1, token="x" * 16, viewer_token="x" * 16)


def test_tokens_are_read_from_a_file_that_nobody_else_can_read(tmp_path):
    file = tmp_path / "tokens"
    for text, expected in (
        ("a" * 16, ("a" * 16, None)),
        ("a" * 16 + "\n" + "b" * 16 + "\n", ("a" * 16, "b" * 16)),
    ):
        file.write_text(text)
        file.chmod(0o600)
        assert read_tokens(str(file)) == expected
    file.chmod(0o640)
    with pytest.raises(InputError, match="other users may read it"):
        read_tokens(str(file))
    file.chmod(0o600)
    for data in (b"", b"\n" + b"b" * 16, b"\xff\xfe"):
        file.write_bytes(data)
        with pytest.raises(InputError, match="holds no token"):
            read_tokens(str(file))
    with pytest.raises(InputError, match="cannot be read"):
        read_tokens(str(tmp_path / "nowhere"))


def test_guessing_is_limited_and_keeps_nobody_out_who_has_a_cookie():
    now = [1000.0]
    guard = Guard("10.0.0.5", 8090, time_source=lambda: now[0])
    known, guesser = PageClient(guard=guard), PageClient(guard=guard)
    log_in(known, guard.token)
    for i in range(GUESSES):
        assert log_in(guesser, "guess %d" % i).status_code == 401
    assert log_in(guesser, guard.token).status_code == 429  # it is not even looked at
    assert guesser.get("/api/hello", X_Gspn_Token=guard.token, **BEYOND).status_code == 429
    assert known.get("/api/hello", **BEYOND).status_code == 200
    now[0] += 61
    assert log_in(guesser, guard.token).status_code == 200


def test_cookies_cannot_be_guessed_faster_and_old_ones_keep_nobody_from_a_login():
    guard = Guard("10.0.0.5", 8090)
    client = PageClient(guard=guard)
    looked_at = []
    seal = guard._seal
    guard._seal = lambda nonce, role: looked_at.append(nonce) or seal(nonce, role)
    for i in range(3 * GUESSES):  # a page that was open when the server was started again
        client.client.set_cookie("10.0.0.5", guard.cookie, "%088x" % i)
        assert client.get("/api/hello", **BEYOND).status_code == 401
    assert len(set(looked_at)) <= GUESSES
    log_in(client, guard.token)
    assert client.get("/api/hello", **BEYOND).status_code == 200


def test_a_cookie_outlives_a_server_with_the_same_token_and_no_other():
    first = PageClient(guard=Guard("10.0.0.5", 8090, token="s" * 20))
    cookie = log_in(first, "s" * 20).headers["Set-Cookie"].split(";")[0].split("=")
    for token, status in (("s" * 20, 200), ("t" * 20, 401)):
        again = PageClient(guard=Guard("10.0.0.5", 8090, token=token))
        again.client.set_cookie("10.0.0.5", *cookie)
        assert again.get("/api/hello", **BEYOND).status_code == status


def test_two_servers_on_one_machine_keep_their_cookies_apart():
    assert Guard("10.0.0.5", 8090).cookie != Guard("10.0.0.5", 8091).cookie


@pytest.mark.parametrize(
    "path", ["/api/hello", "/api/session?id=small", "/api/poll?id=small", "/api/stream?id=small"]
)
def test_a_get_for_another_site_is_refused(client, path):
    assert client.get(path, Sec_Fetch_Site="cross-site").status_code == 403
    assert client.get("/", Sec_Fetch_Site="cross-site").status_code == 200  # a link to the page


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
    assert answer.status_code == 413 and "up to 8 MB" in answer.get_json()["error"]
    answer = client.post("/api/do?id=small", {"command": "step", "padding": "x" * 2_000_001})
    assert answer.status_code == 413 and "up to 2 MB" in answer.get_json()["error"]
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
