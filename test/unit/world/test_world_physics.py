"""The bodies: wheels, contacts, sensors."""

import math
import sys

import pytest

from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.robot_colours import colour_of
from gspn_framework_package.world.bodies import rgba
from gspn_framework_package.world.physics import TIME_STEP, Physics
from gspn_framework_package.world.room import Pose
from gspn_framework_package.world.room_file import parse_room
from gspn_framework_package.world.window import set_up_window

ROOM = parse_room(
    """
name: hall
walls:
  - [[-2, -2], [2, -2], [2, 2], [-2, 2], [-2, -2]]
cylinders:
  - {at: [0, 1.5], radius: 0.2}
temperature:
  ambient: 20
  hot_spots:
    - {path: [[1, 0]], excess: 15, radius: 0.3}
"""
)


@pytest.fixture
def hall():
    """Returns a function that puts robots at poses."""
    made = []

    def put(*poses):
        physics = Physics(ROOM, ["r%d" % i for i in range(len(poses))], poses)
        made.append(physics)
        return physics

    yield put
    for physics in made:
        physics.close()


def test_a_robot_drives_because_its_wheels_turn(hall):
    physics = hall(Pose(-1.0, 0.0, 0.0))
    physics.drive("r0", 0.2, 0.0)
    physics.advance(5.0)
    pose, odometry = physics.pose("r0"), physics.odometry("r0")[0]
    # 5 s at 0.2 m/s, less the way lost while it gathers speed
    assert pose.x == pytest.approx(0.0, abs=0.02)
    assert abs(pose.y) < 0.01
    assert odometry.distance(pose) < 0.01


def test_a_robot_turns_on_the_spot(hall):
    physics = hall(Pose(0.0, 0.0, 0.0))
    physics.drive("r0", 0.0, 1.0)
    physics.advance(3.0)
    physics.drive("r0", 0.0, 0.0)
    physics.advance(1.0)
    pose = physics.pose("r0")
    assert pose.distance((0.0, 0.0)) < 0.01
    # gathering and losing speed cancel out
    assert pose.yaw == pytest.approx(3.0, abs=0.1)
    assert physics.odometry("r0")[0].yaw == pytest.approx(pose.yaw, abs=0.05)


def test_commands_are_cut_to_the_limits_of_the_robot(hall):
    physics = hall(Pose(-1.5, 0.0, 0.0), Pose(0.0, -1.0, 0.0))
    physics.drive("r0", 5.0, 0.0)
    physics.drive("r1", 0.0, -50.0)
    fastest, fastest_turn = 0.0, 0.0
    for _ in range(int(2.0 / TIME_STEP)):
        physics.step()
        fastest = max(fastest, math.hypot(*physics.velocity("r0")[:2]))
        fastest_turn = max(fastest_turn, abs(physics.velocity("r1")[2]))
    assert 0.2 < fastest < 0.22 * 1.05
    assert 2.5 < fastest_turn < 2.84 * 1.05


def test_a_parked_robot_stays_where_it_is(hall):
    physics = hall(Pose(0.5, 0.5, 1.0))
    physics.drive("r0", 0.1, 0.5)
    physics.advance(1.0)
    physics.drive("r0", 0.0, 0.0)
    physics.advance(1.0)
    parked = physics.pose("r0")
    physics.advance(120.0)
    assert physics.pose("r0").distance(parked) < 0.002
    # and wakes up when it is to drive again
    physics.drive("r0", 0.2, 0.0)
    physics.advance(1.0)
    assert physics.pose("r0").distance(parked) > 0.15


def test_touches_are_counted_once_each_by_who_touched_whom(hall):
    physics = hall(Pose(1.5, 0.0, 0.0), Pose(-1.0, -1.0, 0.0), Pose(-0.5, -1.0, math.pi))
    physics.advance(0.5)
    assert physics.contacts.total == 0
    physics.drive("r0", 0.2, 0.0)
    physics.drive("r1", 0.2, 0.0)
    physics.advance(4.0)
    assert set(physics.contacts.solids) == {"r0"}
    assert set(physics.contacts.robots) == {("r1", "r2")}
    # one that presses on is one touch, give or take a bounce
    assert physics.contacts.robots[("r1", "r2")] < 20
    # pushed, because bodies are solid
    assert physics.pose("r2").x > -0.45
    assert physics.pose("r0").x < 2.0 - 0.05 - ROOM.robot.radius + 0.01


def test_the_scanner_sees_walls_cylinders_and_robots(hall):
    physics = hall(Pose(0.0, 0.5, math.pi / 2), Pose(1.0, 0.5, 0.0))
    ranges = physics.scan("r0")
    quarter = len(ranges) // 4
    assert ranges[0] == pytest.approx(1.0 - 0.2, abs=0.01)  # the cylinder, straight ahead
    assert ranges[quarter] == pytest.approx(2.0 - 0.05, abs=0.01)  # the wall on the left
    assert ranges[3 * quarter] == pytest.approx(1.0 - 0.105, abs=0.01)  # the robot on the right


def test_the_thermometer_reads_the_field(hall):
    physics = hall(Pose(1.0, 0.0), Pose(-1.0, 0.0))
    assert physics.temperature("r0") == pytest.approx(35.0, abs=0.1)
    assert physics.temperature("r1") == pytest.approx(20.0, abs=0.1)


def test_the_same_commands_give_the_same_run(hall):
    def run():
        physics = hall(Pose(-1.0, 0.0, 0.3), Pose(1.0, 0.2, 3.0))
        for step in range(400):
            physics.drive("r0", 0.2, 0.3)
            physics.drive("r1", 0.15, -0.2 if step < 200 else 0.4)
            physics.step()
        return physics.pose("r0"), physics.pose("r1")

    assert run() == run()


def test_more_robots_than_places_to_start_is_an_error():
    with pytest.raises(ValueError, match="2 robots, but 0"):
        Physics(ROOM, ["a", "b"])


def test_the_window_shows_each_robot_in_its_colour(hall):
    physics = hall(Pose(1.0, 0.0), Pose(-1.0, 0.0))
    shown = [physics.client.getBodyUniqueId(i) for i in range(physics.client.getNumBodies())][-2:]
    # without a window its commands do nothing, but for the colours of the bodies
    set_up_window(physics.client, ROOM, dict(zip(("r0", "r1"), shown)))
    for body, name in zip(shown, ("r0", "r1")):
        assert physics.client.getVisualShapeData(body)[0][7] == pytest.approx(
            rgba(colour_of(name)), abs=0.01
        )


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="displays are X servers on Linux")
def test_a_window_without_a_display_is_refused(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(UsageError, match="no display"):
        Physics(ROOM, ["a"], [Pose(0.0, 0.0)], gui=True)


def test_the_chatter_of_the_physics_engine_stays_off_standard_output(capfd):
    Physics(ROOM, ["a"], [Pose(0.0, 0.0)]).close()
    assert capfd.readouterr().out == ""
