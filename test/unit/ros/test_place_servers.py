"""What a place server keeps in its status."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rospy")

import rospy
import yaml
from actionlib.status_tracker import StatusTracker
from actionlib_msgs.msg import GoalID, GoalStatus

from gspn_framework_package.ros.place_servers import KEPT_ENDED, PlaceServer


def goal(name, status, ended):
    tracker = StatusTracker(GoalID(id=name), status)
    tracker.handle_destruction_time = rospy.Time(ended)
    return tracker


def test_a_status_names_the_last_ended_goals_and_costs_no_yaml(monkeypatch):
    """The library formats each goal that it drops, for a debug message that nobody reads."""
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: rospy.Time(100)))
    monkeypatch.setattr(yaml, "dump", lambda *_, **__: pytest.fail("formatted as YAML"))
    published = []
    server = PlaceServer(SimpleNamespace(cancel=None), "/robot_1/work", {})
    server.status_pub = SimpleNamespace(
        publish=published.append, impl=SimpleNamespace(has_connections=lambda: True)
    )
    server.status_list_timeout = rospy.Duration(5)
    server.started = True
    running = goal("running", GoalStatus.ACTIVE, 0)
    old, recent = goal("old", GoalStatus.SUCCEEDED, 94), goal("recent", GoalStatus.ABORTED, 96)
    watched = [goal("watched %d" % n, GoalStatus.SUCCEEDED, 0) for n in range(KEPT_ENDED)]
    server.status_list = [running, old, recent]
    server.send_status()
    server.status_list += watched
    server.publish_status()
    names = [[status.goal_id.id for status in message.status_list] for message in published]
    assert names[0] == ["running", "recent"]
    assert names[1] == ["running", *(tracker.status.goal_id.id for tracker in watched[1:])]
