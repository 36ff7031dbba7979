"""Faults to order: slip, a scanner that drops out, blocked and carried robots, doors, people."""

import math

import pytest

from gspn_framework_package.model.errors import InputError
from gspn_framework_package.world.driving_team import DrivingTeam
from gspn_framework_package.world.faults import read_fault
from gspn_framework_package.world.navigation import NavigationStatus
from gspn_framework_package.world.referee import Referee
from gspn_framework_package.world.room import Pose
from gspn_framework_package.world.room_file import parse_room

# two halls with a door between them
HALLS = """
name: halls
walls:
  - [[-2, -1], [2, -1], [2, 1], [-2, 1], [-2, -1]]
  - [[0, -1], [0, -0.3]]
  - [[0, 1], [0, 0.3]]
doors:
  middle: {at: [0, 0], size: [0.05, 0.6]}
people:
  - {path: [[-1.5, 0.5], [-0.5, 0.5], [-1.5, 0.5]], away_mean: 9999, stands: 3}
spawn:
  - [-1, -0.4, 0]
"""


@pytest.fixture(name="team")
def _team():
    """Makes teams, of one robot unless there are more poses."""
    made = []

    def make(*poses, faults=()):
        text = HALLS + "".join(
            "%s  - %s\n" % ("" if number else "faults:\n", fault)
            for number, fault in enumerate(faults)
        )
        room = parse_room(text)
        poses = poses or room.spawn
        team = DrivingTeam(room, ["r%d" % (n + 1) for n in range(len(poses))], poses)
        made.append(team)
        return team

    yield make
    for one in made:
        one.close()


def run(team, seconds):
    end = team.time + seconds - 1e-6
    while team.time < end:
        team.step()


def order(team, **fault):
    team.faults.order(read_fault(fault))


def test_a_wheel_that_slips_drives_no_robot_and_the_odometry_does_not_know(team):
    def driven(*faults):
        one = team(Pose(-1.5, 0.0), faults=faults)
        for _ in range(30):
            one.teleoperate("r1", 0.2, 0.0)
            one.step()
        assert one.physics.odometry("r1")[0].x > -1.0
        return one.physics.pose("r1")

    sound = driven()
    assert sound.x > -1.0 and abs(sound.yaw) < 0.02
    slip = "{time: 0, fault: slip, robot: r1, wheel: %s, grip: 0}"
    assert driven(slip % "both").x < -1.3
    assert driven(slip % "left").yaw > 0.3  # the right wheel pushes it round
    assert -1.3 < driven("{time: 0, fault: slip, robot: r1, lasts: 1}").x < sound.x - 0.05


def test_a_blocked_robot_stands_for_as_long_as_it_is_said(team):
    one = team(faults=["{time: 1, fault: blocked, robot: r1, lasts: 3}"])
    one.navigators["r1"].go(Pose(-0.4, -0.4), 0.0)
    run(one, 1.5)
    stood = one.physics.pose("r1")
    assert one.faults.report()["active"] == [{"fault": "blocked", "of": "r1", "until": 4.0}]
    run(one, 2.0)
    assert one.physics.pose("r1").distance(stood) < 0.01
    run(one, 4.0)
    assert one.navigators["r1"].status is NavigationStatus.REACHED
    assert one.faults.report()["active"] == []


def test_messages_are_late_for_one_robot_or_for_all(team):
    one = team(faults=["{time: 0, fault: network, delay: 0.5, lasts: 1}"])
    one.step()
    late = {"fault": "network", "of": "", "until": 1.0, "delay": 0.5}
    assert one.faults.report()["active"] == [late]
    order(one, fault="network", delay=2, robot="r1")
    one.step()
    of_one = {"fault": "network", "of": "r1", "until": None, "delay": 2.0}
    assert one.faults.report()["active"] == [late, of_one]
    order(one, fault="network", delay=0, robot="r1", lasts=0)
    run(one, 1.5)
    assert one.faults.report()["active"] == []
    with pytest.raises(ValueError, match="no robot 'r2'"):
        order(one, fault="network", delay=2, robot="r2")


def test_a_robot_that_is_carried_away_finds_its_way_again(team):
    one = team(faults=["{time: 1, fault: carried, robot: r1, to: [1.5, 0.5, 1.57]}"])
    referee = Referee(one)
    one.navigators["r1"].go(Pose(0.5, 0.0), 0.0)
    for _ in range(12):
        one.step()
        referee.watch()
    assert one.physics.pose("r1").distance((1.5, 0.5)) < 0.05
    assert one.physics.odometry("r1")[0].distance((1.5, 0.5)) > 2.0
    assert referee.tallies["r1"].distance < 0.5  # it was not driven
    run(one, 12.0)
    assert one.navigators["r1"].status is NavigationStatus.REACHED


def test_a_robot_is_not_carried_into_a_wall_or_onto_another_robot(team):
    one = team(Pose(-1.0, -0.4), Pose(1.0, 0.0))
    for to, words in (([0.0, 0.8], "does not fit at 0, 0.8"), ([1.1, 0.0], "a robot is at 1.1, 0")):
        order(one, fault="carried", robot="r1", to=to)
        one.step()
        assert words in one.faults.refused
    assert one.physics.pose("r1").distance((-1.0, -0.4)) < 0.01


def test_a_closed_door_is_a_wall_until_it_opens(team):
    one = team()
    order(one, fault="door", door="middle", lasts=8)
    one.step()
    assert one.faults.report()["closed"] == ["middle"]
    one.navigators["r1"].go(Pose(1.0, 0.0), one.time)
    run(one, 1.0)
    assert one.navigators["r1"].reason == "no path leads there"
    one.physics.carry("r1", Pose(-0.5, 0.0))
    assert one.physics.scan("r1")[0] == pytest.approx(0.475, abs=0.01)
    run(one, 7.5)
    assert one.faults.report()["closed"] == []
    assert one.physics.scan("r1")[0] == pytest.approx(2.45, abs=0.02)
    one.navigators["r1"].go(Pose(1.0, 0.0), one.time)
    run(one, 15.0)
    assert one.navigators["r1"].status is NavigationStatus.REACHED
    assert one.physics.contacts.total == 0


def test_a_door_waits_for_a_robot_that_stands_in_it(team):
    one = team(Pose(0.0, 0.0))
    order(one, fault="door", door="middle")
    run(one, 1.0)
    assert one.faults.report()["closed"] == []
    one.navigators["r1"].go(Pose(1.0, 0.0), one.time)
    run(one, 8.0)
    assert one.faults.report()["closed"] == ["middle"] and one.physics.contacts.total == 0


def test_a_person_comes_when_told(team):
    one = team(Pose(1.0, 0.0), faults=["{time: 1, fault: person, person: 0}"])
    run(one, 0.9)
    assert one.people[0].at is None
    run(one, 0.5)
    assert one.people[0].at is not None


def test_a_reset_ends_faults_and_repeats_those_of_the_room_file(team):
    one = team(faults=["{time: 1, fault: lidar, robot: r1, lasts: 9}"])
    order(one, fault="door", door="middle")
    run(one, 1.5)
    assert one.faults.has("lidar", "r1") and one.faults.report()["closed"]
    one.reset(True)
    assert not one.faults.has("lidar", "r1") and not one.faults.report()["closed"]
    run(one, 1.5)
    assert one.faults.has("lidar", "r1")


def test_a_fault_can_be_ended_early_by_one_of_no_length(team):
    one = team()
    order(one, fault="lidar", robot="r1")
    one.step()
    assert one.faults.report()["active"][0]["until"] is None
    order(one, fault="lidar", robot="r1", lasts=0)
    one.step()
    assert not one.faults.has("lidar", "r1")


@pytest.mark.parametrize(
    "fault, words",
    [
        ("{time: 1}", "'fault' is not one of slip, lidar"),
        ("{time: 1, fault: fire}", "'fault' is not one of slip, lidar"),
        ("{time: 1, fault: lidar}", "needs 'robot'"),
        ("{time: 1, fault: lidar, robot: r1, wheel: left}", "has no 'wheel'"),
        ("{time: -1, fault: lidar, robot: r1}", "'time' is not a number of at least 0: -1"),
        ("{time: 1, fault: slip, robot: r1, wheel: middle}", "'wheel' is not one of left, right"),
        ("{time: 1, fault: carried, robot: r1, to: [1]}", "'to' is not a pose"),
        ("{time: 1, fault: door, door: east}", "there is no door 'east'"),
        ("{time: 1, fault: person, person: 3}", "there is no person 3"),
        ("{fault: lidar, robot: r1}", "'time' is missing"),
    ],
)
def test_a_bad_fault_of_a_room_file_is_named(fault, words):
    text = HALLS + "faults:\n  - {time: 1, fault: lidar, robot: r1}\n  - %s\n" % fault
    with pytest.raises(InputError) as told:
        parse_room(text, "halls.yaml")
    assert words in str(told.value)
    assert str(told.value).startswith("halls.yaml:%d: faults[1]: " % len(text.splitlines()))


@pytest.mark.parametrize(
    "data",
    [
        *(3, None, {"fault": []}),
        {"fault": "lidar", "robot": "r1", "lasts": math.nan},
        {"fault": "lidar", "robot": "r1", "lasts": 10**400},
        {"fault": "carried", "robot": "r1", "to": [10**400, 0]},
        {"fault": "person", "person": math.inf},
    ],
)
def test_what_is_no_fault_is_refused(data):
    with pytest.raises(ValueError, match="is not"):
        read_fault(data)


def test_a_fault_of_a_robot_that_is_not_there_is_refused(team):
    with pytest.raises(ValueError, match="there is no robot 'r7'"):
        order(team(), fault="lidar", robot="r7")
