"""What other nodes send to a robot on ROS is checked, and who sends nonsense is named."""

import json

import pytest

from gspn_framework_package.ros import entrance as module
from gspn_framework_package.ros.entrance import Entrance
from gspn_framework_package.team.carrier import NotTaken
from gspn_framework_package.team.gate import BURST, LARGEST_MESSAGE

NODE = {"callerid": "/robot_2/executor"}
HELLO = json.dumps({"from": "robot_2", "kind": "hello"})


@pytest.fixture
def entrance(monkeypatch):
    made = Entrance()
    made.braked = []
    monkeypatch.setattr(module.time, "sleep", made.braked.append)
    return made


def test_a_message_is_taken_from_the_robot_that_it_names(entrance):
    assert entrance.read(HELLO, NODE, "robot_2") == json.loads(HELLO)
    assert entrance.read(HELLO, NODE) == json.loads(HELLO)  # a call that names nobody itself
    assert not entrance.refusals()


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
def test_who_sends_nonsense_is_named(entrance, text, claimed, why):
    assert entrance.read(text, NODE, claimed) is None
    named = "%s (node /robot_2/executor)" % claimed
    assert entrance.refusals() == [NotTaken(named, why, 1)]


def test_a_sender_without_a_name_is_counted_too(entrance):
    assert entrance.read("{}", None) is None
    assert [kind.robot for kind in entrance.refusals()] == ["node without a name"]


def test_a_flood_is_braked_and_hurts_no_other_node(entrance):
    taken = sum(entrance.read(HELLO, NODE, "robot_2") is not None for _ in range(3 * int(BURST)))
    assert taken < 2.5 * BURST  # it is refilled while this test runs
    assert set(entrance.braked) == {module.BRAKE}
    (kind,) = entrance.refusals()
    assert (kind.why, kind.times) == ("too many messages", len(entrance.braked))
    other = HELLO.replace("robot_2", "robot_3")
    assert entrance.read(other, {"callerid": "/robot_3"}, "robot_3") is not None


def test_a_team_that_does_not_talk_over_ros_takes_nothing_there():
    entrance = Entrance(is_open=False)
    assert entrance.read(HELLO, NODE, "robot_2") is None
    assert entrance.refusals()[0].why == "the team does not talk over ROS"
