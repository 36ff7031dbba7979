"""What a robot is to other programs: its description, its odometry, and a reset."""

import pytest

from gspn_framework_package.world.bodies import connect_bullet
from gspn_framework_package.world.driving_team import DrivingTeam
from gspn_framework_package.world.navigation import NavigationStatus
from gspn_framework_package.world.physics import Physics
from gspn_framework_package.world.robot_urdf import FIXED_FRAMES, WHEEL_JOINTS, robot_urdf
from gspn_framework_package.world.room import ROBOT_TYPES, Pose
from gspn_framework_package.world.room_file import parse_room

HALL = """
name: hall
walls:
  - [[-2, -2], [2, -2], [2, 2], [-2, 2], [-2, -2]]
spawn:
  - [0, 0, 0]
"""
ROOM = parse_room(HALL)


@pytest.fixture(name="closed")
def _closed():
    """Closes what a test makes."""
    made = []

    def keep(one):
        made.append(one)
        return one

    yield keep
    for one in made:
        one.close()


@pytest.mark.parametrize("model", sorted(ROBOT_TYPES))
def test_bullet_reads_the_description_of_a_robot_as_the_size_that_it_has(model, tmp_path):
    kind = ROBOT_TYPES[model]
    (tmp_path / "robot.urdf").write_text(robot_urdf(kind))
    client = connect_bullet(False)
    body = client.loadURDF(str(tmp_path / "robot.urdf"))
    joints = [client.getJointInfo(body, n) for n in range(client.getNumJoints(body))]
    turning = {joint[1].decode() for joint in joints if joint[2] == client.JOINT_REVOLUTE}
    assert turning == set(WHEEL_JOINTS)
    links = {joint[12].decode(): joint[0] for joint in joints}
    assert set(FIXED_FRAMES) < set(links)
    assert client.getDynamicsInfo(body, links["base_link"])[0] == pytest.approx(kind.mass)
    assert min(client.getDynamicsInfo(body, links["base_link"])[2]) > 0.0  # its inertia
    left, right = (
        client.getLinkState(body, links[j.replace("_joint", "_link")])[4] for j in WHEEL_JOINTS
    )
    assert left[1] - right[1] == pytest.approx(kind.wheel_separation)
    assert left[2] == right[2] == pytest.approx(kind.wheel_radius)
    client.disconnect()


def test_a_room_may_have_robots_of_another_type_and_change_them():
    waffle = parse_room(HALL + "robot: {model: waffle, mass: 2.0}").robot
    assert (waffle.radius, waffle.mass) == (ROBOT_TYPES["waffle"].radius, 2.0)


def test_a_waffle_drives_as_far_as_its_wheels_turn(closed):
    physics = closed(Physics(parse_room(HALL + "robot: {model: waffle}"), ["r"]))
    physics.drive("r", 0.26, 0.0)
    physics.advance(4.0)
    assert physics.pose("r").x == pytest.approx(1.02, abs=0.03)
    assert physics.odometry("r")[0].distance(physics.pose("r")) < 0.01


def test_the_odometry_drifts_as_asked_and_by_the_seed(closed):
    def error(drift, seed):
        physics = closed(Physics(ROOM, ["r"], drift=drift, seed=seed))
        physics.drive("r", 0.2, 0.0)
        physics.advance(4.0)
        return physics.odometry("r")[0].distance(physics.pose("r"))

    assert error(0.1, 1) == error(0.1, 1) != error(0.1, 2)
    assert error(0.0, 1) < 0.01 < error(0.1, 1)


def test_a_robot_that_is_carried_stands_there_and_its_odometry_knows_nothing(closed):
    physics = closed(Physics(ROOM, ["r"]))
    physics.drive("r", 0.2, 0.0)
    physics.advance(1.0)
    before = physics.odometry("r")[0]
    physics.drive("r", 0.0, 0.0)
    physics.carry("r", Pose(-1.0, 1.0, 2.0))
    physics.advance(1.0)
    pose = physics.pose("r")
    assert pose.distance((-1.0, 1.0)) < 0.01 and pose.yaw == pytest.approx(2.0, abs=0.02)
    assert physics.odometry("r")[0].distance(before) < 0.01
    physics.drive("r", 0.2, 0.0)
    physics.advance(2.0)
    assert physics.pose("r").distance(pose) > 0.3


@pytest.mark.parametrize("time", [False, True])
def test_a_reset_puts_robots_back_and_ends_their_goals(closed, time):
    team = closed(DrivingTeam(ROOM, ["r"]))
    team.navigators["r"].go(Pose(1.0, 0.0), 0.0)
    for _ in range(30):
        team.step()
    assert team.physics.pose("r").x > 0.3
    team.reset(time)
    team.step()
    assert team.physics.pose("r").distance((0.0, 0.0)) < 0.01
    assert team.physics.odometry("r")[0].distance((0.0, 0.0)) < 0.01
    navigator = team.navigators["r"]
    assert (navigator.status, navigator.reason) == (
        NavigationStatus.FAILED,
        "the world was reset",
    )
    assert team.time == pytest.approx(0.1 if time else 3.1)
    team.navigators["r"].go(Pose(1.0, 0.0), team.time)
    for _ in range(80):
        team.step()
    assert navigator.status is NavigationStatus.REACHED


def test_a_command_by_hand_takes_effect_in_the_next_step_of_the_physics(closed):
    team = closed(DrivingTeam(ROOM, ["r"]))
    seen = []

    def after():
        if not seen:
            team.teleoperate("r", 0.2, 0.0)
        seen.append(team.physics.odometry("r")[1])

    team.step(after)
    assert seen[0] == 0.0 < seen[1] and len(seen) == 12
