"""A network that the simulated world makes slow."""

import json
import queue
import time

import pytest

rospy = pytest.importorskip("rospy")
from std_msgs.msg import String  # noqa: E402

from gspn_framework_package.ros.network_fault import SlowNetwork  # noqa: E402


@pytest.fixture(name="heard")
def _heard(monkeypatch):
    """A network of robot_1, and a function that has it hear of faults."""
    callbacks = []
    monkeypatch.setattr(
        rospy, "Subscriber", lambda _topic, _kind, heard, **_: callbacks.append(heard)
    )
    network = SlowNetwork("robot_1")

    def tell(**delays):
        active = [
            {"fault": "network", "of": of.replace("everybody", ""), "until": None, "delay": delay}
            for of, delay in delays.items()
        ]
        active.append({"fault": "lidar", "of": "robot_1", "until": 3.0})
        callbacks[0](String(json.dumps({"active": active, "closed": [], "refused": ""})))
        return network

    return tell


def test_messages_come_at_once_unless_the_world_says_otherwise(heard):
    taken = []
    heard(robot_2=5.0).pass_on(taken.append, "now")
    assert taken == ["now"]


def test_the_longest_delay_holds_and_the_order_stays(heard):
    network = heard(everybody=0.05, robot_1=0.2)
    taken, began = queue.Queue(), time.monotonic()
    for number in range(20):
        network.pass_on(taken.put, number)
    assert taken.empty()
    assert [taken.get(timeout=30) for _ in range(20)] == list(range(20))
    assert time.monotonic() - began >= 0.2
    heard().pass_on(taken.put, "at once")
    assert taken.get_nowait() == "at once"
