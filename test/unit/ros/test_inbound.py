"""What other nodes send to a robot on ROS is checked, and who sends nonsense is named."""

import json

import pytest

from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.ros import inbound as module
from gspn_framework_package.ros.inbound import ASKED, InboundMessages, said
from gspn_framework_package.team.carrier import NotTaken, Operator, OperatorRequest
from gspn_framework_package.team.message_filter import FASTEST, LARGEST_MESSAGE
from gspn_framework_package.team.seal import SEALED, Seal, TeamKey

NODE = {"callerid": "/robot_2/executor"}
KEY = TeamKey(b"k" * 32)
HELLO = json.dumps({"from": "robot_2", "kind": "hello"})


@pytest.fixture
def inbound(monkeypatch):
    made = InboundMessages()
    made.braked = []
    monkeypatch.setattr(module.time, "sleep", made.braked.append)
    return made


def test_a_message_is_taken_from_the_robot_that_it_names(inbound):
    assert inbound.read(HELLO, NODE, ASKED, "robot_2") == json.loads(HELLO)
    assert inbound.read(HELLO, NODE, ASKED) == json.loads(HELLO)  # a call that names nobody itself
    assert not inbound.refusals()


@pytest.mark.parametrize(
    "text, claimed, why",
    [
        ("x" * (LARGEST_MESSAGE + 1), "robot_2", "too large"),
        ("nonsense", "robot_2", "not a JSON object"),
        (HELLO, "robot_3", "in the name of another robot"),
        ("{}", "robot_3", "in the name of another robot"),
        ('{"from": 7}', "robot_3", "in the name of another robot"),
    ],
)
def test_who_sends_nonsense_is_named(inbound, text, claimed, why):
    assert inbound.read(text, NODE, ASKED, claimed) is None
    named = "%s (node /robot_2/executor)" % claimed
    assert inbound.refusals() == [NotTaken(named, why, 1)]


def test_a_sender_without_a_name_is_counted_too(inbound):
    assert inbound.read("{}", None, ASKED) is None
    assert [kind.robot for kind in inbound.refusals()] == ["node without a name"]


def test_a_flood_is_braked_and_hurts_no_other_node(inbound):
    taken = sum(
        inbound.read(HELLO, NODE, ASKED, "robot_2") is not None for _ in range(3 * int(FASTEST))
    )
    assert taken < 2.5 * FASTEST  # it is refilled while this test runs
    assert set(inbound.braked) == {module.BRAKE}
    (kind,) = inbound.refusals()
    assert (kind.why, kind.times) == ("too many messages", len(inbound.braked))
    other = HELLO.replace("robot_2", "robot_3")
    assert inbound.read(other, {"callerid": "/robot_3"}, ASKED, "robot_3") is not None


def test_a_team_that_does_not_talk_over_ros_takes_nothing_there():
    inbound = InboundMessages(is_open=False)
    assert inbound.read(HELLO, NODE, ASKED, "robot_2") is None
    assert inbound.refusals()[0].why == "the team does not communicate over ROS"


def keyed(name, run="run", key=KEY):
    return InboundMessages(seal=Seal(key, run, name))


@pytest.fixture
def one(inbound):
    return keyed("robot_1")


def test_with_a_key_a_message_is_taken_from_who_has_it(one):
    text = keyed("robot_2").sealed("", HELLO, said("/a", "rosrpc://b:1"))
    assert one.read(text, NODE, said("/a", "rosrpc://b:1"), "robot_2") == json.loads(HELLO)
    assert not one.refusals()


@pytest.mark.parametrize(
    ("sender", "purpose", "claimed", "why"),
    [
        (InboundMessages(), ASKED, "robot_2", "without the key of the team"),
        (keyed("robot_2", key=TeamKey(b"x" * 32)), ASKED, "robot_2", "not sealed with the key"),
        (keyed("robot_2", run="other"), ASKED, "robot_2", "not sealed with the key"),
        (keyed("robot_2"), said("/a", "rosrpc://thief:1"), "robot_2", "not sealed with the key"),
        (keyed("robot_2"), ASKED, "robot_3", "in the name of another robot"),
        (keyed("robot_3"), ASKED, "robot_3", "in the name of another robot"),
    ],
)
def test_with_a_key_nothing_else_is_taken(one, sender, purpose, claimed, why):
    text = sender.sealed("", HELLO, ASKED)
    assert one.read(text, NODE, purpose, claimed) is None
    (kind,) = one.refusals()
    assert kind.robot == "%s (node /robot_2/executor)" % claimed and why in kind.why


def test_a_message_that_is_played_again_is_refused(one):
    text = keyed("robot_2").sealed("robot_1", HELLO, ASKED)
    assert one.read(text, NODE, ASKED, "robot_2")
    assert one.read(text, {"callerid": "/thief"}, ASKED, "robot_2") is None
    assert one.refusals() == [NotTaken("robot_2 (node /thief)", "a repeated message", 1)]


def test_without_a_key_a_sealed_message_is_named_as_such(inbound):
    assert inbound.read(keyed("robot_2").sealed("", HELLO, ASKED), NODE, ASKED) is None
    assert "which this robot does not have" in inbound.refusals()[0].why


PAUSE = OperatorRequest("pause", "robot_2", "", "run")


def sealed_order(request, to="robot_1", **options):
    seal = Seal(options.get("key", KEY), "run", "ann")
    return OperatorRequest(SEALED, "", seal.close(to, json.dumps(request._asdict()), "order"))


def test_an_order_is_taken_with_the_key_and_questions_without(one):
    assert one.order(sealed_order(PAUSE), NODE) == (PAUSE, Operator("ann", "team key"))
    for question in (OperatorRequest("status"), OperatorRequest("breakpoints")):
        assert one.order(question, NODE) == (question, Operator("node /robot_2/executor"))
    assert not one.refusals()


@pytest.mark.parametrize(
    ("given", "why"),
    [
        (lambda: PAUSE, "--team-key-file"),
        (lambda: OperatorRequest("breakpoints", "", '["p1"]'), "--team-key-file"),
        (lambda: sealed_order(PAUSE, key=TeamKey(b"x" * 32)), "not sealed with the key"),
        (lambda: sealed_order(PAUSE, to="robot_3"), "for another robot"),
        (lambda: sealed_order(PAUSE._replace(argument=7)), "not an order"),
        (lambda: OperatorRequest(SEALED, "", "nonsense"), "without the key"),
    ],
)
def test_an_order_without_the_right_is_refused_and_counted(one, given, why):
    with pytest.raises(RefusedError, match=why):
        one.order(given(), {"callerid": "/thief"})
    (kind,) = one.refusals()
    assert (kind.robot, kind.times) == ("node /thief", 1)


def test_an_order_is_not_taken_twice(one):
    order = sealed_order(PAUSE)
    one.order(order, NODE)
    with pytest.raises(RefusedError, match="a repeated order"):
        one.order(order, NODE)


def test_a_team_without_a_key_takes_orders_from_everybody(inbound):
    assert inbound.order(PAUSE, NODE) == (PAUSE, Operator("node /robot_2/executor"))
    with pytest.raises(RefusedError, match="no team key"):
        inbound.order(sealed_order(PAUSE), NODE)
