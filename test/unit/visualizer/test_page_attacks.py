"""What peers do on purpose: the page goes on answering, and nothing is lost. One server stands it
all."""

import base64
import http.client
import json
import os
import shutil
import socket
import threading
from pathlib import Path

import pytest
from waiting import PATIENCE, wait_for

from gspn_framework_package.visualizer import connections, serving
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.guard import HEADER
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.serving import WebServer

TOKEN = "t" * 20
ROOM = 30
"""Connections beside those of the viewers: a few, so that a test need not open many."""

VIEWERS = 4


class Attacked:
    """A server with files, and the page's own requests to it."""

    def __init__(self, folder):
        self.server = WebServer(Project(Folder(str(folder))), port=0, token=TOKEN, viewers=VIEWERS)
        self.server.start()
        self.sockets = []
        self.head = {
            "X-Gspn-Token": TOKEN,
            HEADER: "1",
            "Content-Type": "application/json",
            "Host": "127.0.0.1:%d" % self.server.port,
        }

    def ask(self, method, path, body=None, **headers):
        """Status and JSON of a request of the page."""
        connection = http.client.HTTPConnection(
            "127.0.0.1", self.server.port, timeout=30 * PATIENCE
        )
        head = {
            name: value for name, value in {**self.head, **headers}.items() if value is not None
        }
        try:
            data = body if body is None or isinstance(body, bytes) else json.dumps(body)
            connection.request(method, path, data, head)
            answer = connection.getresponse()
            return answer.status, json.loads(answer.read() or b"{}")
        finally:
            connection.close()

    def send(self, data):
        """A socket of an attacker, to which ``data`` was sent."""
        attacker = socket.create_connection(("127.0.0.1", self.server.port), 30)
        self.sockets.append(attacker)
        attacker.sendall(data)
        return attacker

    def close(self):
        for attacker in self.sockets:
            attacker.close()
        self.server.stop()


@pytest.fixture(name="attacked")
def _attacked(tmp_path, monkeypatch):
    monkeypatch.setattr(serving, "MOST_WAITING_CONNECTIONS", ROOM)
    for i in range(30):
        shutil.copy("plans/patrol/net.xml", str(tmp_path / ("net%d.xml" % i)))
    made = Attacked(tmp_path)
    yield made
    made.close()


def upload(attacked):
    """The key of a net that was uploaded, and in which something was done."""
    content = base64.b64encode(Path("plans/patrol/net.xml").read_bytes()).decode()
    status, answer = attacked.ask(
        "POST", "/api/upload", {"files": [{"name": "mine.xml", "content": content}]}
    )
    assert status == 200
    assert attacked.ask("POST", "/api/do?id=" + answer["id"], {"command": "step"})[0] == 200
    return answer["id"]


def alive(attacked, key):
    """See that the page answers, and that what was uploaded is there."""
    assert attacked.ask("GET", "/api/hello")[0] == 200
    status, news = attacked.ask("GET", "/api/poll?id=" + key)
    assert status == 200 and news["snapshot"]["board"]["n"] == 1


def header(attacked, path, **fields):
    lines = ["POST %s HTTP/1.1" % path] + [
        "%s: %s" % item for item in {**attacked.head, **fields}.items()
    ]
    return ("\r\n".join(lines) + "\r\n\r\n").encode()


def answer_to(attacker):
    """All that the server says until it closes the connection."""
    parts = []
    while True:
        try:
            part = attacker.recv(65536)
        except ConnectionResetError:
            part = b""
        if not part:
            return b"".join(parts)
        parts.append(part)


def is_closed(attacker):
    attacker.setblocking(False)
    try:
        return attacker.recv(65536) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


def test_slow_sockets_streams_and_foreign_requests_leave_the_page_usable(attacked):
    key = upload(attacked)
    for _ in range(4 * ROOM):  # a header that never ends
        attacked.send(b"GET /api/hello HTTP/1.1\r\nHost: x\r\nX-Slow: ")
    alive(attacked, key)
    for _ in range(2 * ROOM):  # nothing at all, and a body that never comes
        attacked.send(b"")
        attacked.send(header(attacked, "/api/do?id=" + key, **{"Content-Length": "1000"}) + b"{")
    alive(attacked, key)
    stream = "GET /api/stream?id=%s HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n" % (
        key,
        attacked.server.port,
    )
    for _ in range(3 * ROOM):  # streams without the token, and with it
        attacked.send((stream + "\r\n").encode())
        attacked.send((stream + "X-Gspn-Token: %s\r\n\r\n" % TOKEN).encode())
    alive(attacked, key)
    assert len(attacked.server._server.active_channels) <= ROOM + VIEWERS
    for i in range(30):  # a page that is open elsewhere, in a browser that does not say so
        status, _ = attacked.ask("GET", "/api/session?id=file-net%d.xml" % i)
        assert status in (200, 409)
    alive(attacked, key)
    # the page itself opens what it likes, and what was worked on is closed last
    for i in range(30):
        assert attacked.ask("POST", "/api/open", {"path": "net%d.xml" % i})[0] == 200
    alive(attacked, key)


@pytest.mark.parametrize(
    ("path", "size", "told"),
    [
        ("/api/do?id=x", 2_100_000, "up to 2 MB"),
        ("/api/upload", 12_100_000, "up to 8 MB"),
        ("/api/login", 5_000, "too large for a token"),
        ("/", 10, "too large"),
    ],
)
def test_what_is_too_large_is_reported_with_the_right_size(attacked, path, size, told):
    status, answer = attacked.ask("POST", path, b"x" * size)
    assert status == 413 and told in answer["error"]


def test_who_has_no_token_makes_the_server_keep_nothing(attacked):
    for fields in ({"X-Gspn-Token": "x" * 20}, {HEADER: "0"}, {"Origin": "http://evil.example"}):
        # the header alone: the answer comes before the body, of which nothing is waited for
        attacker = attacked.send(
            header(attacked, "/api/upload", **{"Content-Length": "11000000", **fields})
        )
        answer = answer_to(attacker)
        assert answer.split()[1] in (b"401", b"403") and b'{"error": ' in answer


def test_a_body_in_chunks_is_limited_too(attacked):
    attacker = attacked.send(header(attacked, "/api/login", **{"Transfer-Encoding": "chunked"}))
    for _ in range(10):
        try:
            attacker.sendall(b"3e8\r\n" + b"x" * 1000 + b"\r\n")
        except OSError:
            break
    answer = answer_to(attacker)
    assert b" 413 " in answer.split(b"\r\n")[0] and b"too large for a token" in answer


@pytest.mark.long
def test_a_request_has_a_deadline_and_a_peer_that_does_not_read_is_cut_off(attacked, monkeypatch):
    key = upload(attacked)
    monkeypatch.setattr(connections, "HEADER_SECONDS", 0.2)
    monkeypatch.setattr(connections, "BODY_SECONDS", 0.2)
    slow = attacked.send(b"GET /api/hello HTTP/1.1\r\nHost: x\r\nX-Slow: ")
    dumb = attacked.send(b"")
    body = attacked.send(header(attacked, "/api/do?id=" + key, **{"Content-Length": "1000"}) + b"{")
    for attacker in (slow, dumb, body):
        wait_for(
            lambda attacker=attacker: is_closed(attacker),
            what="the end of a request that does not come",
        )
    monkeypatch.undo()
    monkeypatch.setattr(connections, "STALLED_SECONDS", 0.5)
    hub = attacked.server.project.session(key).hub
    stalled = socket.socket()
    stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    stalled.connect(("127.0.0.1", attacked.server.port))
    attacked.sockets.append(stalled)
    request = "GET /api/stream?id=%s HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nX-Gspn-Token: %s\r\n\r\n"
    stalled.sendall((request % (key, attacked.server.port, TOKEN)).encode())
    wait_for(lambda: hub.viewers == 1, what="the stream")
    fill = threading.Event()

    def publish():
        while not fill.wait(0.001):
            hub.publish({"k": "note", "level": "info", "robot": "", "text": "x" * 20_000})

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        wait_for(
            lambda: hub.viewers == 0, seconds=60, what="the end of the stream that nobody reads"
        )
    finally:
        fill.set()
        thread.join()


def test_a_net_that_is_closed_ends_its_streams_and_says_why(attacked):
    assert attacked.ask("POST", "/api/open", {"path": "net0.xml"})[0] == 200
    connection = http.client.HTTPConnection(
        "127.0.0.1", attacked.server.port, timeout=30 * PATIENCE
    )
    connection.request("GET", "/api/stream?id=file-net0.xml", headers=attacked.head)
    answer = connection.getresponse()
    attacked.server.project.sessions.known("file-net0.xml").close("it was closed, to make room")
    said = answer.read()  # as far as it goes: it ends
    connection.close()
    assert said.endswith(b'event: closed\ndata: {"reason": "it was closed, to make room"}\n\n')
    assert said.count(b"event: closed") == 1


def test_a_pipe_in_the_folder_holds_nobody(attacked, tmp_path):
    key = upload(attacked)
    for name in ("pipe.json", "pipe.xml", "pipe.jsonl"):
        os.mkfifo(str(tmp_path / name))
    (tmp_path / "plan.json").write_text('{"net": "pipe.xml", "actions": {}}')
    (tmp_path / "policy.json").write_text(
        '{"net": "net0.xml", "policy": "pipe.json", "actions": {}}'
    )
    files = [file["path"] for file in attacked.ask("GET", "/api/hello")[1]["files"]]
    assert "net0.xml" in files and not [name for name in files if name.startswith("pipe")]
    for name in ("pipe.json", "pipe.xml", "pipe.jsonl", "plan.json", "policy.json"):
        status, answer = attacked.ask("POST", "/api/open", {"path": name})
        assert status == 400 and "file" in answer["error"]
        assert str(tmp_path) not in answer["error"]
    alive(attacked, key)


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", "/api/login", b'{"token": "\\ud800"}'),
        ("POST", "/api/open", b'{"path": "\\ud800"}'),
        ("POST", "/api/open", b'{"path": "' + b"x" * 5000 + b'"}'),
        ("POST", "/api/upload", b'{"files": [{"name": "\\ud800.xml", "content": ""}]}'),
        (
            "POST",
            "/api/upload",
            ('{"files": [{"name": "%s.xml", "content": ""}]}' % ("\u00fc" * 115)).encode(),
        ),
        ("POST", "/api/do?id=file-net0.xml", b'{"command": "fire", "transition": "\\ud800"}'),
        (
            "POST",
            "/api/do?id=file-net0.xml",
            b'{"command": "probabilities", "probabilities": {"t1": 1e999}}',
        ),
        ("POST", "/api/do?id=file-net0.xml", b'{"command": "\\ud800", "run": 3}'),
        ("GET", "/api/state?id=file-net0.xml&at=%C2%B2", None),
        ("GET", "/api/events?id=file-net0.xml&to=%C2%B2", None),
        ("GET", "/api/session?id=file-%00", None),
        ("GET", "/api/session?id=file-../../etc/passwd", None),
    ],
)
def test_odd_values_are_refused_in_words(attacked, tmp_path, method, path, body):
    assert attacked.ask("POST", "/api/open", {"path": "net0.xml"})[0] == 200
    status, answer = attacked.ask(method, path, body)
    assert status in (400, 401, 409) and answer["error"]
    assert str(tmp_path) not in answer["error"]


def test_a_cursor_of_odd_digits_is_none(attacked):
    key = upload(attacked)
    for since in ("a:%C2%B2", "a:1:%C2%B2", "%F0%9D%9F%91:1"):
        status, news = attacked.ask("GET", "/api/poll?id=%s&since=%s" % (key, since))
        assert status == 200 and "snapshot" in news


def test_errors_do_not_tell_where_the_folder_is(attacked, tmp_path):
    (tmp_path / "broken.xml").write_text("<pnml")
    (tmp_path / "plan.json").write_text('{"net": "nowhere.xml", "actions": {}}')
    for name in ("broken.xml", "plan.json", "nowhere.xml"):
        status, answer = attacked.ask("POST", "/api/open", {"path": name})
        assert status == 400 and str(tmp_path) not in answer["error"], answer
