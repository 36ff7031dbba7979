"""Notices of tasks that ended, and the web address that gets them."""

from __future__ import annotations

import http.server
import json
import threading
from typing import Any, Iterator, List, Tuple

import pytest

from gspn_framework_package.cli.tasks import follow
from gspn_framework_package.model.errors import ExecutionError, UsageError
from gspn_framework_package.team.ended_tasks import EndedTasks, WebHook


def notices(*numbers: int) -> Any:
    return [{"id": "o%d" % n, "outcome": "done", "why": "delivered"} for n in numbers]


def test_each_task_is_news_once() -> None:
    ended = EndedTasks()
    assert ended.news(notices(1, 2)) == []  # before anybody followed
    assert ended.news(notices(1, 2)) == []
    assert ended.news(notices(1, 2, 3)) == notices(3)
    assert ended.news(notices(3, 4, 5)) == notices(4, 5)  # the team has forgotten the first ones
    assert ended.news(notices(8, 9)) == notices(8, 9)


class Answers:
    """A team that answers so, and then the follower is interrupted."""

    def __init__(self, *answers: Any) -> None:
        self.left = list(answers)

    def order(self, *asked: str) -> Tuple[bool, str]:
        if not self.left:
            raise KeyboardInterrupt
        answer = self.left.pop(0)
        if isinstance(answer, str):
            raise ExecutionError(answer)
        return True, json.dumps({"tasks": [], "ended": answer})


def test_who_follows_hears_of_tasks_also_after_a_silence(monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.setattr("gspn_framework_package.cli.tasks._ASK_EVERY", 0.0)
    told: List[Any] = []
    team = Answers(notices(1), notices(1, 2), "no robot", "no robot", notices(1, 2, 3))
    with pytest.raises(KeyboardInterrupt):
        follow(team, "", told.append)  # type: ignore[arg-type]
    assert told == notices(2, 3)
    assert capsys.readouterr().err == "no answer: no robot\n"
    with pytest.raises(ExecutionError):
        follow(Answers("no robot"), "", told.append)  # type: ignore[arg-type]


@pytest.fixture
def site() -> Iterator[Any]:
    """A web server of this machine: its address, and what it was given."""
    given: List[Any] = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            given.append((self.path, json.loads(body)))
            self.send_response(302 if self.path == "/moved" else 204)
            self.send_header("Location", "/tasks")
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            pass

    server = http.server.HTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield "http://127.0.0.1:%d" % server.server_port, given
    server.shutdown()
    thread.join()
    server.server_close()


def test_a_private_host_is_called_only_if_it_is_listed(site: Any) -> None:
    address, given = site
    with pytest.raises(ExecutionError, match="private address"):
        WebHook(address + "/tasks").post(notices(1)[0])
    with pytest.raises(ExecutionError, match="private address"):
        WebHook(address.replace("127.0.0.1", "localhost"), ["127.0.0.1"]).post(notices(1)[0])
    assert given == []
    WebHook(address + "/tasks?team=a", ["127.0.0.1"]).post(notices(1)[0])
    assert given == [("/tasks?team=a", notices(1)[0])]


def test_what_a_host_does_not_take_is_an_error(site: Any) -> None:
    address, given = site
    with pytest.raises(ExecutionError, match="answers 302"):
        WebHook(address + "/moved", ["127.0.0.1"]).post(notices(1)[0])
    assert [path for path, _ in given] == ["/moved"]  # it is not followed
    with pytest.raises(ExecutionError, match="cannot be reached"):
        WebHook("https" + address[4:], ["127.0.0.1"]).post(notices(1)[0])


@pytest.mark.parametrize(
    "url", ["", "tasks", "ftp://example.org", "file:///etc/passwd", "http://:80", "http://a:x"]
)
def test_an_address_has_to_be_one_of_the_web(url: str) -> None:
    with pytest.raises(UsageError, match="not a web address"):
        WebHook(url)
