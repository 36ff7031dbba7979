"""The carrier on ROS topics and services, with a ROS that only keeps what was published."""

import json
from types import SimpleNamespace

import pytest

pytest.importorskip("rospy")

import rospy

from gspn_framework_package.execution.agreement.interface import EVERYBODY, Send
from gspn_framework_package.msg import Agreement
from gspn_framework_package.ros import facts, inbound, links, messages
from gspn_framework_package.ros.inbound import InboundMessages
from gspn_framework_package.team.message_filter import FASTEST
from gspn_framework_package.team.seal import Seal, TeamKey

OTHER = {"callerid": "/robot_2/executor"}


class Topic:
    """A publisher to which one other node is connected, and a subscriber."""

    def __init__(self, name, kind, callback=None, **options):
        self.name, self.callback, self.sent = name, callback, []
        self.impl = SimpleNamespace(connections=[SimpleNamespace(endpoint_id="/other")])

    def publish(self, message):
        self.sent.append(message)

    def get_num_connections(self):
        return 1

    def unregister(self):
        pass


@pytest.fixture
def make(monkeypatch):
    monkeypatch.setattr(links.rospy, "Subscriber", Topic)
    monkeypatch.setattr(facts.rospy, "Publisher", Topic)
    monkeypatch.setattr(links, "eager_publisher", Topic)
    monkeypatch.setattr(facts, "eager_publisher", Topic)
    monkeypatch.setattr(links.rospy, "get_rostime", rospy.Time)
    made = []

    def make(robot, run="run", key=None):
        monkeypatch.setattr(links.rospy, "get_name", lambda: "/%s/executor" % robot)
        got = []
        host = SimpleNamespace(
            robot=robot,
            run=run,
            receive=got.append,
            serve=None,
            knows=lambda name: not name.startswith("stranger"),
            heartbeat=5.0 / 3,
        )
        inbound = InboundMessages(seal=Seal(key, run, robot) if key else None)
        link = links.TopicLink(host, "/" + robot, "", inbound)
        link.got = got
        link._neighbours = dict  # each as in a separate process
        made.append(link)
        return link

    yield make
    for link in made:
        link._calls.close()


def came(news, connection=OTHER):
    """A message as it comes in from another node."""
    copy = Agreement(*(getattr(news, name) for name in Agreement.__slots__))
    copy._connection_header = connection
    return copy


def said(link, to=EVERYBODY, **fields):
    """The message that a robot publishes."""
    link.send([Send(to, {"from": link.robot, "kind": "hello", **fields})])
    return link._publisher.sent[-1]


def test_a_message_is_filled_as_its_class_would(monkeypatch):
    monkeypatch.setattr(messages.rospy, "get_rostime", lambda: rospy.Time(7, 5))
    fields = {"run": "run", "sender": "r1", "to": "", "body": "{}"}
    made = Agreement(**fields)
    made.header.stamp = rospy.Time(7, 5)
    assert messages.stamped_message(Agreement, **fields) == made
    assert messages.stamped_message(Agreement, **fields).namespace == ""
    with pytest.raises(AttributeError):
        messages.stamped_message(Agreement, no_field="")


def test_a_message_reaches_the_robots_of_the_run(make):
    one, two, stranger = make("robot_1"), make("robot_2"), make("robot_2", run="another")
    one._on_message(came(said(two, number=1)))
    one._on_message(came(said(stranger, number=2)))
    assert [message["number"] for message in one.got] == [1]
    assert not one.refusals()


def test_a_forged_message_is_dropped_and_its_sender_not_believed(make):
    one, two = make("robot_1"), make("robot_2")
    forged = came(said(two), {"callerid": "/thief"})
    forged.sender, forged.service_uri = "robot_3", "rosrpc://thief:1"
    one._on_message(forged)
    assert one.got == [] and one._peers == {}
    (kind,) = one.refusals()
    assert (kind.robot, kind.why) == (
        "robot_3 (node /thief)",
        "in the name of another robot",
    )


def test_a_flood_of_another_run_is_braked(make, monkeypatch):
    braked = []
    monkeypatch.setattr(inbound.time, "sleep", braked.append)
    monkeypatch.setattr(inbound.time, "monotonic", lambda: 7.0)
    one, stranger = make("robot_1"), make("robot_2", run="another")
    flood = came(said(stranger), {"callerid": "/flooder"})
    for _ in range(int(FASTEST)):
        one._on_message(flood)
    assert not braked and not one.refusals()
    one._on_message(flood)
    one._on_message(came(said(make("robot_3"), to="robot_4"), {"callerid": "/flooder"}))
    one._on_message(came(said(make("robot_2"))))
    assert len(one.got) == 1
    assert braked == [inbound.BRAKE] * 2
    (kind,) = one.refusals()
    assert kind == ("others (node /flooder)", "too many messages", 2)


def test_an_answer_is_taken_from_the_robot_that_was_asked(make):
    one = make("robot_1")
    body = json.dumps({"from": "robot_2", "kind": "promise"})
    response = SimpleNamespace(agreement=body, _connection_header=OTHER)
    one._answered("robot_3", response)
    one._answered("robot_3", SimpleNamespace(agreement="", _connection_header=OTHER))
    assert one.got == [] and [kind.times for kind in one.refusals()] == [1]
    one._answered("robot_2", response)
    assert one.got == [json.loads(body)]


KEY, OTHER_KEY = TeamKey(b"k" * 32), TeamKey(b"o" * 32)


def test_a_team_with_a_key_hears_its_own_and_nobody_else(make):
    one, two = make("robot_1", key=KEY), make("robot_2", key=KEY)
    outsider, plain = make("robot_2", key=OTHER_KEY), make("robot_2")
    good = said(two, number=1)
    redirected, renamed = came(good), came(good)
    redirected.service_uri = "rosrpc://thief:1"
    renamed.sender = "robot_3"
    for news in (redirected, renamed, said(outsider, number=2), said(plain, number=3)):
        one._on_message(came(news, {"callerid": "/thief"}))
    assert one.got == [] and one._peers == {} and one._heard == {}
    one._on_message(came(good))
    one._on_message(came(good, {"callerid": "/thief"}))  # played again
    assert [message["number"] for message in one.got] == [1]
    assert list(one._peers) == ["robot_2"]
    assert {kind.robot for kind in one.refusals()} == {
        "robot_2 (node /thief)",
        "robot_3 (node /thief)",
    }
    assert sum(kind.times for kind in one.refusals()) == 5


def test_what_one_robot_is_reported_is_not_taken_by_another(make):
    one, two, three = (make(robot, key=KEY) for robot in ("robot_1", "robot_2", "robot_3"))
    told = came(said(two, to="robot_3"))
    three._on_message(told)
    told.to = "robot_1"
    one._on_message(told)
    assert (len(three.got), len(one.got)) == (1, 0)
    assert [kind.why for kind in one.refusals()] == ["a message for another robot"]


def test_senders_that_the_robot_does_not_know_cost_no_thread_and_no_connection(make):
    one, other = make("r1"), make("r2")
    called = []
    one._calls.call = lambda name, *rest: called.append(name)
    for number in range(10_000):
        other.robot = "stranger %d" % number
        one._on_message(came(other._news("", '{"kind": "hello", "from": "%s"}' % other.robot)))
    other.robot = "r2"
    assert len(one._peers) == links.MOST_ADDRESSES
    hello = {"kind": "hello", "from": "r1"}
    one._heard = dict.fromkeys(one._heard, -1e9)  # all are silent
    one.send([Send("stranger 1", hello), Send("", hello)])
    assert (called, one._inboxes, one._peers) == ([], {}, {})
    one._on_message(came(other._news("", '{"kind": "hello", "from": "r2"}')))
    assert list(one._peers) == ["r2"]
