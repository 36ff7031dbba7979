"""What a carrier carries: a firing as a JSON object, and texts from senders that nobody trusts."""

import json

import pytest

from gspn_framework_package.execution.agreement.interface import Fired
from gspn_framework_package.execution.firing import Firing, Move
from gspn_framework_package.execution.team_messages import firing_fields
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.team.carrier import sender_of


def fired():
    plan = read_plan("plans/patrol")
    moves = (Move("robot_1", "Dock", "Hall", 3), Move("robot_2", "Dock", None, 4))
    firing = Firing(7, 1, "go", "robot_1", 1, 2, moves, tuple(range(len(plan.net.places))))
    return plan, Fired(firing, True, "abc", plan)


def test_a_firing_has_the_fields_of_the_ros_message():
    messages = pytest.importorskip("gspn_framework_package.msg")
    _, fact = fired()
    assert set(firing_fields(fact, "r")) | {"header"} == set(messages.FiredTransition.__slots__)


def test_a_firing_names_the_robots_that_it_moved_and_the_whole_marking():
    plan, fact = fired()
    fields = json.loads(json.dumps(firing_fields(fact, "monday")))
    assert (fields["run"], fields["plan"], fields["hash"]) == ("monday", plan.hash(), "abc")
    assert (fields["robots"], fields["robot_places"]) == (["robot_1"], ["Hall"])  # one left the net
    assert fields["places"] == [place.name for place in plan.net.places]
    assert fields["counts"] == list(range(len(plan.net.places)))


def test_the_sender_of_a_message():
    assert sender_of({"from": "robot_1"}) == "robot_1"
    assert sender_of({}) == sender_of({"from": 7}) == ""
