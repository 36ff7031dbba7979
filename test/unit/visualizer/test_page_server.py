"""The page's own web server, over real sockets: streams, stalled viewers, limits; and the verbs
that start it."""

import gc
import http.client
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time

import psutil
import pytest
import waitress.trigger
from page_client import small_net
from waiting import PATIENCE, wait_for

from benchmarks.page.viewers import measure_memory
from gspn_framework_package.cli.main import main
from gspn_framework_package.visualizer import serving
from gspn_framework_package.visualizer.documents import Document, Folder
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.serving import WebServer
from gspn_framework_package.visualizer.session import Session


@pytest.fixture(name="serve")
def _serve():
    servers = []

    def make(**options):
        project = Project()
        project.show(Session("small", Document("small", small_net())))
        servers.append(WebServer(project, port=0, **options))
        servers[-1].start()
        return servers[-1]

    yield make
    for server in servers:
        server.stop()


def stream(server, since=None):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=20 * PATIENCE)
    headers = {"Last-Event-ID": since} if since else {}
    connection.request("GET", "/api/stream?id=small", headers=headers)
    return connection, connection.getresponse()


def next_news(response):
    while True:
        line = response.readline()
        assert line, "the stream has ended"
        if line.startswith(b"data: {"):
            found = json.loads(line[6:])
            if found:
                return found


def step(server, steps=1):
    server.project.session("small").command("step", {"steps": steps})


def test_a_stream_gives_a_snapshot_and_then_the_events(serve):
    server = serve()
    _, response = stream(server)
    first = next_news(response)
    assert first["snapshot"]["board"]["n"] == 0
    step(server, 3)
    events = []
    while len(events) < 3:
        events += next_news(response)["events"]
    assert [e["n"] for e in events] == [1, 2, 3]


def test_a_stream_that_broke_goes_on_where_it_was(serve):
    server = serve()
    connection, response = stream(server)
    cursor = next_news(response)["cursor"]
    connection.close()
    step(server, 4)
    _, response = stream(server, since=cursor)
    assert [e["n"] for e in next_news(response)["events"]] == [1, 2, 3, 4]


def test_a_silent_stream_says_that_it_is_alive(serve, monkeypatch):
    monkeypatch.setattr("gspn_framework_package.visualizer.app.PING", 0.1)
    _, response = stream(serve())
    next_news(response)
    seen = b""
    while b"event: ping" not in seen:
        seen += response.readline()


def test_more_streams_than_viewers_are_refused_and_freed_again(serve, monkeypatch):
    monkeypatch.setattr("gspn_framework_package.visualizer.app.PING", 0.05)
    server = serve(viewers=1)
    connection, response = stream(server)
    next_news(response)
    _, second = stream(server)
    assert second.status == 503
    response.close()
    connection.close()
    wait_for(lambda: stream(server)[1].status == 200, what="a place for a viewer")


def test_a_stalled_viewer_grows_no_memory_and_stops_nobody():
    found = measure_memory(events=80_000, nodes=17)
    # the events that come meanwhile take 40 MB and more, were they kept
    assert found["grown_mb"] < 10
    assert found["reader_gaps"] == 0 and found["events"] >= 80_000


@pytest.mark.long
def test_a_viewer_far_behind_is_reported_everything_or_gets_a_snapshot(serve):
    server = serve()
    _, response = stream(server)
    next_news(response)
    hub = server.project.session("small").hub
    for _ in range(65_000):
        hub.publish({"k": "note", "level": "info", "robot": "", "text": "x" * 400})
    last = 0
    while last < 65_000:
        news = next_news(response)
        if "snapshot" in news:
            last = news["snapshot"]["board"]["n"]
        for event in news.get("events", ()):
            assert event["n"] == last + 1
            last = event["n"]


def test_many_viewers_get_every_event(serve):
    server = serve(viewers=20)
    results = []

    def follow():
        _, response = stream(server)
        seen = next_news(response)["snapshot"]["board"]["n"]
        while seen < 200:
            for event in next_news(response)["events"]:
                assert event["n"] == seen + 1
                seen = event["n"]
        results.append(seen)

    threads = [threading.Thread(target=follow) for _ in range(20)]
    for thread in threads:
        thread.start()
    for _ in range(20):
        step(server, 10)
    for thread in threads:
        thread.join(60)
    assert results == [200] * 20


def test_an_interrupt_that_another_thread_is_given_ends_it():
    """The system chooses the thread of a signal; where it is not the main one, nothing wakes that."""
    program = """
import signal, sys, threading, time, traceback
from gspn_framework_package.cli import main

def functions_of_main():
    frame = sys._current_frames()[threading.main_thread().ident]
    return [called.name for called in traceback.extract_stack(frame)]

def interrupt():
    while functions_of_main()[-2:] != ["wait", "wait"] or "wait_for" not in functions_of_main():
        time.sleep(0.01)
    signal.pthread_kill(threading.get_ident(), signal.SIGINT)

threading.Thread(target=interrupt).start()
sys.exit(main.main(["serve", "plans/tokens", "--port", "0"]))
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60 * PATIENCE)


def test_a_request_that_outlives_the_server_writes_into_no_file_of_others(serve, monkeypatch):
    monkeypatch.setattr("gspn_framework_package.visualizer.serving.LAST_REQUESTS", 0.1)
    under_way, go_on = threading.Event(), threading.Event()
    workers = []

    def command(*_):
        workers.append(threading.current_thread())
        under_way.set()
        assert go_on.wait(30)
        return {}

    monkeypatch.setattr(Session, "command", command)
    server = serve()
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=20 * PATIENCE)
    head = {"Content-Type": "application/json", "X-Gspn-Page": "1"}
    connection.request("POST", "/api/do?id=small", '{"command": "step"}', head)
    assert under_way.wait(30)
    server.stop()
    # files that get the numbers of those that the server has closed
    pairs = [socket.socketpair() for _ in range(20)]
    ends = [end for pair in pairs for end in pair]
    go_on.set()
    readable, deadline = [], time.monotonic() + 30
    while workers[0].is_alive() and not readable:
        assert time.monotonic() < deadline
        readable, _, _ = select.select(ends, [], [], 0.05)
    for end in ends:
        end.close()
    assert not readable


def test_a_server_stops_when_its_thread_was_awake_already(serve, monkeypatch):
    def pull(trigger):
        os.write(trigger.trigger, b"x")  # of another thread, a moment before
        wait_for(
            lambda: not (trigger.thunks and trigger._map), seconds=30, what="the server's thread"
        )
        os.write(trigger.trigger, b"x")

    monkeypatch.setattr(waitress.trigger.trigger, "_physical_pull", pull)
    serve().stop()


@pytest.mark.parametrize("requests", [0, 1])
def test_a_server_that_stops_leaves_no_thread_and_no_file(serve, requests):
    gc.collect()  # of earlier tests
    files, threads = psutil.Process().num_fds(), threading.active_count()
    server = serve()
    streams = [stream(server) for _ in range(requests)]
    for _, response in streams:
        next_news(response)
    server.stop()
    server.stop()  # which is no harm
    for connection, response in streams:
        response.close()
        connection.close()
    gc.collect()
    assert psutil.Process().num_fds() <= files
    wait_for(lambda: threading.active_count() <= threads, what="the end of the threads")


def test_a_name_with_several_addresses_is_listened_on_at_one(serve, monkeypatch):
    both = [
        (socket.AF_INET6, socket.SOCK_STREAM, 6, "", ("::1", 0, 0, 0)),
        (socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", 0)),
    ]
    found = socket.getaddrinfo
    monkeypatch.setattr(
        socket,
        "getaddrinfo",
        lambda host, *a, **k: both if host == "pair" else found(host, *a, **k),
    )
    assert serve(host="pair").port > 0


def test_a_host_header_is_checked_on_the_wire(serve):
    server = serve()
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=20 * PATIENCE)
    connection.request("GET", "/api/hello", headers={"Host": "evil.example"})
    assert connection.getresponse().status == 421


def test_a_request_that_is_too_large_is_not_even_received(serve):
    server = serve()
    with socket.create_connection(("127.0.0.1", server.port), 20) as client:
        head = (
            "POST /api/upload HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nContent-Length: 900000000\r\n\r\n"
        )
        client.sendall((head % server.port).encode())
        assert b" 413 " in client.recv(200)


@pytest.mark.parametrize(
    "words",
    [
        ["serve", "nowhere"],
        ["serve", "README.md"],
        ["serve", "plans", "--port", "99999"],
        ["serve", "plans", "--viewers", "0"],
        ["serve", "plans", "--host", "203.0.113.99", "--port", "0"],
        ["replay", "nowhere.jsonl"],
        ["replay", "README.md"],
        ["replay", "plans/patrol/net.xml"],
    ],
)
def test_wrong_usage_is_one_message_and_exit_code_2(words, capsys):
    assert main(words) == 2
    said = capsys.readouterr().err
    assert said.startswith("gspn: error: ") and "Traceback" not in said


def test_the_tokens_are_printed_with_the_address_and_are_nowhere_else(
    tmp_path, capsys, monkeypatch
):
    def start(server):
        print(server.address)
        server.ended.set()

    monkeypatch.setattr(WebServer, "start", start)
    assert main(["serve", "plans", "--host", "0.0.0.0", "--port", "0"]) == 0
    first, second, address = capsys.readouterr().out.splitlines()
    assert len(first.split("#token=")[1].split()[0]) >= 20 and len(second.split("#token=")[1]) >= 20
    assert "Read-only" in second and "token" not in address
    tokens = tmp_path / "tokens"
    tokens.write_text("operator-operator\nviewer-viewer-viewer\n")
    tokens.chmod(0o600)
    assert main(["serve", "plans", "--port", "0", "--token-file", str(tokens)]) == 0
    out = capsys.readouterr().out
    assert "#token=operator-operator " in out and "#token=viewer-viewer-viewer" in out
    assert (
        main(["serve", "plans", "--port", "0", "--token-file", str(tokens), "--token", "x" * 16])
        == 2
    )
    assert main(["serve", "plans", "--port", "0", "--token", "short"]) == 2
    assert "at least 16 characters" in capsys.readouterr().err


def test_a_port_that_is_taken_is_reported(serve, capsys):
    assert main(["serve", "plans", "--port", str(serve().port)]) == 2
    assert "another with --port" in capsys.readouterr().err


@pytest.mark.long
def test_serve_serves_until_it_is_interrupted():
    command = [
        sys.executable,
        "-m",
        "gspn_framework_package",
        "serve",
        "plans/patrol",
        "--port",
        "0",
    ]
    environment = {**os.environ, "PYTHONPATH": os.getcwd()}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, env=environment, **pipes) as process:
        try:
            line = process.stdout.readline()
            port = int(line.split("127.0.0.1:")[1].split("/")[0])
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20 * PATIENCE)
            connection.request("GET", "/api/hello")
            assert json.load(connection.getresponse())["first"] == "file-plan.json"
            viewer = http.client.HTTPConnection("127.0.0.1", port, timeout=20 * PATIENCE)
            viewer.request("GET", "/api/stream?id=file-plan.json")
            next_news(viewer.getresponse())
            process.send_signal(signal.SIGINT)
            assert process.wait(60) == 0
            assert process.stderr.read() == ""
        finally:
            process.kill()


@pytest.mark.parametrize("begins", [False, True])
def test_an_interrupt_while_its_thread_starts_is_no_error(begins, tmp_path, monkeypatch):
    class Interrupted(threading.Thread):
        def start(self):
            if begins:
                threading.Timer(0.1, super().start).start()
            raise KeyboardInterrupt

    server = WebServer(Project(Folder(str(tmp_path))), port=0)
    monkeypatch.setattr(serving, "LAST_REQUESTS", 1.0)
    with monkeypatch.context() as patched:
        patched.setattr(serving.threading, "Thread", Interrupted)
        with pytest.raises(KeyboardInterrupt):
            server.start()
    server.stop()
    assert server.ended.is_set() == begins
