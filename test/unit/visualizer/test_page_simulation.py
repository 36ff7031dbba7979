"""The tools of thesis Figure 5.4 through the page's own requests: step, n steps, fire, reset,
clear, probabilities, and step back."""

import pytest
from page_client import PageClient

from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.session import Session


def open_net(net):
    project = Project()
    project.show(Session("small", Document("net", net)))
    return PageClient(project)


@pytest.fixture(name="client")
def _client():
    return PageClient()


def test_one_step_and_n_steps(client):
    assert client.do("step").get_json()["fired"] == 1
    assert client.board()["marking"] == [0, 1]
    assert client.board()["enabled"] == [1]
    assert client.do("step", steps=9).get_json()["fired"] == 9
    assert client.board()["counts"] == [5, 5]


def test_steps_end_where_nothing_is_enabled():
    client = open_net(NetBuilder().place("p", 2).immediate("t", inputs="p").build())
    assert client.do("step", steps=10).get_json() == {"fired": 2, "dead": True}


def test_a_chosen_transition_fires_if_it_is_enabled(client):
    assert client.do("fire", transition="t").status_code == 200
    refused = client.do("fire", transition="t")
    assert refused.status_code == 409 and "a has 0 of 1 token" in refused.get_json()["error"]
    assert client.do("fire", transition="nonsense").status_code == 400
    assert client.board()["n"] == 1


def test_an_immediate_transition_goes_before_a_chosen_exponential_one():
    net = (
        NetBuilder()
        .place("p", 1)
        .exponential("slow", inputs="p")
        .immediate("now", inputs="p")
        .build()
    )
    refused = open_net(net).do("fire", transition="slow")
    assert refused.status_code == 409 and "go first" in refused.get_json()["error"]


def test_a_firing_sequence_of_a_run_does_not_wait_for_priorities():
    net = NetBuilder().place("p", 1).exponential("slow", inputs="p").immediate("now", inputs="p")
    client = open_net(net.build())
    assert client.do("fire", transition="slow", any_priority=True).status_code == 200
    assert client.board()["marking"] == [0]
    refused = client.do("fire", transition="slow", any_priority=True)
    assert refused.status_code == 409  # it still needs its tokens


def test_a_simulation_moves_to_a_marking_and_back(client):
    before = client.board()
    assert client.do("move", marking=[0, 3]).status_code == 200
    assert client.board()["marking"] == [0, 3] and client.board()["enabled"] == [1]
    for wrong in ([0], [0, -1], [0, 1.5], [0, True], [0, 10**10], "01", None):
        refused = client.do("move", marking=wrong)
        assert refused.status_code == 400 and "all 2 places" in refused.get_json()["error"]
    client.do("back")
    assert client.board()["marking"] == before["marking"]


def test_steps_are_taken_back_to_the_beginning(client):
    boards = [client.board()]
    for _ in range(4):
        client.do("step")
        boards.append(client.board())
    for before in reversed(boards[:-1]):
        assert client.do("back").status_code == 200
        now = client.board()
        assert [now[k] for k in ("marking", "enabled", "counts", "t")] == [
            before[k] for k in ("marking", "enabled", "counts", "t")
        ]
    assert client.do("back").status_code == 409


def test_reset_and_clear(client):
    client.do("step", steps=3)
    client.do("clear")
    assert client.board()["marking"] == [0, 0] and client.board()["enabled"] == []
    client.do("back")
    assert client.board()["marking"] == [0, 1]
    client.do("reset")
    board = client.board()
    assert board["marking"] == [1, 0] and board["counts"] == [0, 0] and board["t"] == 0


def test_a_reset_is_taken_back(client):
    client.do("step", steps=3)
    before = client.board()
    client.do("reset")
    client.do("step", steps=2)
    client.do("back", steps=3)
    now = client.board()
    assert [now[k] for k in ("marking", "enabled", "counts", "t")] == [
        before[k] for k in ("marking", "enabled", "counts", "t")
    ]
    client.do("back", steps=3)
    assert client.board()["counts"] == [0, 0] and client.board()["marking"] == [1, 0]
    assert client.do("back").status_code == 409


def test_firing_probabilities_of_the_user():
    net = NetBuilder().place("p", 1).exponential("a", 1, inputs="p", outputs="p")
    client = open_net(net.exponential("b", 1, inputs="p", outputs="p").build())
    assert client.do("probabilities", probabilities={"a": 0}).status_code == 200
    client.do("step", steps=50)
    assert client.board()["counts"] == [0, 50]
    latest = client.get("/api/poll?id=small").get_json()["latest"]
    assert latest["choices"] == [[1, 1.0]]


def test_huge_probabilities_are_shares_like_others():
    net = NetBuilder().place("p", 1)
    for name in ("a", "b", "c"):
        net = net.exponential(name, 1e308, inputs="p", outputs="p")
    client = open_net(net.build())
    assert (
        client.do("probabilities", probabilities={"a": 1e308, "b": 1e308, "c": 0}).status_code
        == 200
    )
    assert client.get("/api/poll?id=small").get_json()["latest"]["choices"] == [[0, 0.5], [1, 0.5]]
    assert client.do("step", steps=100).get_json()["fired"] == 100
    assert client.board()["counts"][2] == 0
    assert client.do("probabilities", probabilities={}).status_code == 200
    assert client.do("step", steps=100).get_json()["fired"] == 100


@pytest.mark.parametrize(
    "given", [None, [], {"t": 10**400}, {"a": -1}, {"a": "x"}, {"nonsense": 1}, {"t": True}]
)
def test_probabilities_that_make_no_sense_are_refused(client, given):
    assert client.do("probabilities", probabilities=given).status_code == 400


def test_two_viewers_see_the_same(client):
    first = client.get("/api/poll?id=small").get_json()
    client.do("step", steps=5)
    late = client.get("/api/poll?id=small&since=" + first["cursor"]).get_json()
    marking = list(first["snapshot"]["board"]["marking"])
    for event in late["events"]:
        for p, change in event["d"]:
            marking[p] += change
    assert marking == client.board()["marking"]


def test_unknown_commands_and_sessions_are_reported(client):
    assert client.do("dance").status_code == 400
    assert client.do("stop").status_code == 400
    assert client.do("step", session="nothing").status_code == 400
