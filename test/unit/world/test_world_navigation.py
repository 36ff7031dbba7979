"""The navigator: alone, among parked robots, face to face, at crossings; never a touch."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import room_tight
from gspn_framework_package.world.avoidance import (
    STANDING_GAP,
    OtherRobot,
    brake,
    choose_velocity,
    steer,
)
from gspn_framework_package.world.driving_team import CONTROL_PERIOD, DrivingTeam
from gspn_framework_package.world.grid import RESOLUTION, SPARE, Grid
from gspn_framework_package.world.navigation import (
    GIVE_UP_AFTER,
    NavigationStatus,
    Navigator,
    Observation,
)
from gspn_framework_package.world.room import Pose
from gspn_framework_package.world.room_file import parse_room


def room(width, height, *boxes):
    """A hall of that size with boxes (x, y, width, height) in it."""
    w, h = width / 2, height / 2
    text = "name: hall\nwalls:\n  - [[%g,%g],[%g,%g],[%g,%g],[%g,%g],[%g,%g]]\n" % (
        -w,
        -h,
        w,
        -h,
        w,
        h,
        -w,
        h,
        -w,
        -h,
    )
    if boxes:
        text += "boxes:\n"
    for box in boxes:
        text += "  - {at: [%g, %g], size: [%g, %g]}\n" % box
    return parse_room(text)


OPEN = room(4, 4)
# two halls and between them a corridor that one robot only fits through
NARROW = room(5, 2, (0, 0.58, 2, 0.8), (0, -0.58, 2, 0.8))
DOOR = room(5, 3, (0, 0.85, 0.2, 1.3), (0, -0.85, 0.2, 1.3))
# lanes half a metre wide between four blocks, wider ones around them
CROSSING = room(4.8, 4.8, *((x, y, 1.2, 1.2) for x in (-0.85, 0.85) for y in (-0.85, 0.85)))


def drive(where, starts, goals, limit):
    """Send robots from poses to points; returns the team when all have ended, or time is up."""
    names = ["r%d" % index for index in range(len(starts))]
    team = DrivingTeam(where, names, [Pose(*start) for start in starts])
    for name, goal in zip(names, goals):
        if goal is not None:
            team.navigators[name].go(Pose(*goal), team.time, turn=len(goal) == 3)
    while team.time < limit and any(n.active for n in team.navigators.values()):
        team.step()
    team.close()
    return team


def all_arrived(team, goals):
    """Whether every robot says it has arrived; that it has, is asserted."""
    for name, goal in zip(team.robots, goals):
        if team.navigators[name].status is not NavigationStatus.REACHED:
            return False
        assert goal is not None
    return team.physics.contacts.total == 0


def test_a_robot_goes_around_a_wall_and_looks_where_it_was_asked():
    where = room(4, 4, (0, -0.5, 0.2, 3))
    robot = DrivingTeam(where, ["r0"], [Pose(-1.0, -1.0, 0.0)])
    robot.navigators["r0"].go(Pose(1.0, -1.0, 1.5), robot.time)
    while robot.navigators["r0"].active and robot.time < 60:
        robot.step()
    pose = robot.physics.pose("r0")
    assert robot.navigators["r0"].status is NavigationStatus.REACHED
    assert pose.distance((1.0, -1.0)) < 0.1
    assert pose.yaw == pytest.approx(1.5, abs=0.2)
    assert robot.physics.contacts.total == 0
    robot.close()


def test_parked_robots_are_planned_around():
    team = drive(OPEN, [(-1, 0, 0), (0, 0, 0), (0, 0.4, 0)], [(1, 0), None, None], 30)
    assert team.navigators["r0"].status is NavigationStatus.REACHED
    assert team.physics.contacts.total == 0


SCENES = {
    "corridor, face to face": (
        NARROW,
        [(-2, 0, 0), (2, 0, math.pi)],
        [(2, 0), (-2, 0)],
    ),
    "corridor, met in the middle": (
        NARROW,
        [(-0.3, 0, 0), (0.3, 0, math.pi)],
        [(2, 0), (-2, 0)],
    ),
    "corridor, two against two in it": (
        NARROW,
        [(-0.3, 0, 0), (-0.7, 0, 0), (0.3, 0, math.pi), (0.7, 0, math.pi)],
        [(2, 0.4), (2, -0.4), (-2, 0.4), (-2, -0.4)],
    ),
    "door, two against two": (
        DOOR,
        [(-1, -0.4, 0), (-1, 0.4, 0), (1, -0.4, math.pi), (1, 0.4, math.pi)],
        [(1.5, -0.4), (1.5, 0.4), (-1.5, -0.4), (-1.5, 0.4)],
    ),
    "crossing of four": (
        CROSSING,
        [(-1.7, 0, 0), (1.7, 0, math.pi), (0, -1.7, 1.57), (0, 1.7, -1.57)],
        [(1.7, 0), (-1.7, 0), (0, 1.7), (0, -1.7)],
    ),
    "circle of eight": (
        OPEN,
        [
            (1.4 * math.cos(a), 1.4 * math.sin(a), a + math.pi)
            for a in (k * math.pi / 4 for k in range(8))
        ],
        [(-1.4 * math.cos(a), -1.4 * math.sin(a)) for a in (k * math.pi / 4 for k in range(8))],
    ),
}


@pytest.mark.parametrize("scene", sorted(SCENES))
def test_nobody_touches_and_everybody_arrives(scene):
    where, starts, goals = SCENES[scene]
    assert all_arrived(drive(where, starts, goals, 150), goals)


@pytest.mark.parametrize(
    "where, starts, goal, reason",
    [
        (OPEN, [(-1, 0, 0)], (2, 2), "no path leads there"),
        (OPEN, [(-1, 0, 0), (1, 0, 0)], (1, 0), "blocked by standing robots"),
        (NARROW, [(-2, 0, 0), (0, 0, 0)], (2, 0), "blocked by standing robots"),
    ],
)
def test_a_goal_that_cannot_be_reached_is_given_up_with_a_reason(where, starts, goal, reason):
    team = drive(where, starts, [goal], 100)
    assert team.navigators["r0"].status is NavigationStatus.FAILED
    assert reason in team.navigators["r0"].reason
    assert team.physics.contacts.total == 0


@pytest.mark.parametrize("gap", [0.2, 0.24, 0.27, 0.3, 0.34])
def test_a_gap_beside_a_parked_robot_is_passed_or_the_goal_is_given_up(gap):
    """It never tries for ever: what the search takes for a way, the robot dares to go."""
    radius = OPEN.robot.radius
    half = (2 * radius + 0.02 + gap) / 2
    corridor = room(5, 2, *((0, side * (1 + half) / 2, 1.0, 1 - half) for side in (-1, 1)))
    parked = (0, -half + radius + 0.02, 0)
    team = drive(corridor, [(-1.5, 0, 0), parked], [(1.5, 0), None], 100)
    assert team.physics.contacts.total == 0
    navigator = team.navigators["r0"]
    assert not navigator.active
    if gap < 2 * radius + STANDING_GAP:
        assert "blocked by standing robots" in navigator.reason
    elif gap > 2 * radius + STANDING_GAP + SPARE + RESOLUTION:
        assert navigator.status is NavigationStatus.REACHED


def test_a_narrow_gap_between_corners_is_driven_through():
    """Where nothing ahead is in sight but for the next cell."""
    result = room_tight.measure("clutter", 17)
    assert (result["arrived"], result["touches"], result["touches_of_solids"]) == (2, 0, 0)
    assert result["seconds"] < 20


def test_who_gets_nowhere_gives_up_in_the_end_however_often_it_stepped_aside():
    team = DrivingTeam(OPEN, ["r0"], [Pose(-1, 0, 0)])
    navigator = team.navigators["r0"]
    navigator.go(Pose(1, 0), 0.0)
    # motors that do not answer
    team.physics.drive = lambda robot, speed, turn_rate: None
    stepped_aside = 0
    while navigator.active and team.time < 120:
        team.step()
        stepped_aside += navigator.status is NavigationStatus.YIELDING
    assert stepped_aside
    assert navigator.status is NavigationStatus.FAILED
    assert navigator.reason == "stuck for 60 s"
    assert team.time == pytest.approx(GIVE_UP_AFTER, abs=2.0)
    team.close()


def test_a_way_that_opens_is_taken():
    """A parked robot blocks the corridor for a while."""
    team = DrivingTeam(NARROW, ["r0", "r1"], [Pose(-2, 0, 0), Pose(0, 0, 0)])
    team.navigators["r0"].go(Pose(2, 0), 0.0, turn=False)
    while team.time < 15:
        team.step()
    assert team.navigators["r0"].active
    team.navigators["r1"].go(Pose(2, 0.6), team.time, turn=False)
    while team.navigators["r0"].active and team.time < 90:
        team.step()
    assert team.navigators["r0"].status is NavigationStatus.REACHED
    team.close()


def test_a_cancelled_goal_stops_the_robot():
    navigator = Navigator(Grid(OPEN), 0)
    navigator.go(Pose(1, 0), 0.0)
    seen = Observation(0.1, Pose(0, 0, 0))
    assert navigator.step(seen, 0.1)[0] > 0.1
    navigator.cancel()
    assert navigator.status is NavigationStatus.IDLE
    assert navigator.step(seen, 0.1) == (0.0, 0.0)


def test_who_gets_the_same_goal_again_drives_on_past_a_robot_that_stands():
    team = DrivingTeam(OPEN, ["r0", "r1"], [Pose(-1.5, 0, 0), Pose(1.0, 1.5, 0)])
    navigator, goal = team.navigators["r0"], Pose(1.5, 0, 0)
    navigator.go(goal, team.time)
    while team.time < 2:
        team.step()
    navigator.cancel()
    team.step()
    navigator.go(goal, team.time)
    while team.time < 30 and navigator.active:
        team.step()
    team.close()
    assert navigator.status is NavigationStatus.REACHED


def test_the_older_goal_has_the_right_of_way_whatever_the_index():
    first, second = Navigator(Grid(OPEN), 5), Navigator(Grid(OPEN), 0)
    first.go(Pose(1, 0), 1.0)
    second.go(Pose(-1, 0), 2.0)
    assert first.rank < second.rank
    second.cancel()
    assert second.rank > first.rank


def test_two_who_meet_both_keep_to_the_right():
    grid = Grid(OPEN)
    west, east = Pose(-0.6, 0.0, 0.0), Pose(0.6, 0.0, math.pi)
    for me, other, target in ((west, east, (1.0, 0.0)), (east, west, (-1.0, 0.0))):
        peer = OtherRobot(
            "other", other, (0.2 * math.cos(other.yaw), 0.0), True, (1.0,), ((-target[0], 0.0),)
        )
        direction, speed = choose_velocity(grid, me, target, 0.22, [peer], (2.0,), None)
        assert speed > 0.0
        assert math.remainder(direction - me.yaw, math.tau) < -0.1


def test_a_robot_that_looks_away_turns_before_it_drives():
    assert steer(math.pi / 2, 0.2, 0.0) == (0.0, pytest.approx(2.0))
    speed, turn = steer(0.1, 0.2, 0.0)
    assert speed > 0.19
    assert turn > 0.0


angle = st.floats(-math.pi, math.pi)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(angle, angle), min_size=40, max_size=40),
    st.floats(0.26, 0.6),
    angle,
)
def test_braking_keeps_two_robots_apart_whatever_they_want(headings, distance, bearing):
    """Both drive at full speed wherever they like, and only the brake is between them."""
    grid = Grid(OPEN)
    limit = OPEN.robot.max_speed
    poses = [Pose(0.0, 0.0), Pose(distance * math.cos(bearing), distance * math.sin(bearing))]
    speeds = [0.0, 0.0]
    for wanted in headings:
        poses = [Pose(p.x, p.y, yaw) for p, yaw in zip(poses, wanted)]
        peers = [
            OtherRobot("p", p, (s * math.cos(p.yaw), s * math.sin(p.yaw)))
            for p, s in zip(poses, speeds)
        ]
        speeds = [brake(grid, poses[i], limit, CONTROL_PERIOD, [peers[1 - i]]) for i in (0, 1)]
        poses = [
            Pose(
                p.x + s * CONTROL_PERIOD * math.cos(p.yaw),
                p.y + s * CONTROL_PERIOD * math.sin(p.yaw),
                p.yaw,
            )
            for p, s in zip(poses, speeds)
        ]
        assert poses[0].distance(poses[1]) > 2 * OPEN.robot.radius
        assert all(float(OPEN.clearance(p.x, p.y)) > OPEN.robot.radius for p in poses)
