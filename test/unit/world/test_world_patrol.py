"""The patrol in the critical room, without ROS: rules, right of entry, loss and return; and the
referee."""

import math
from pathlib import Path

import pytest

from gspn_framework_package.execution.actions import ActionFailed
from gspn_framework_package.world import patrol
from gspn_framework_package.world.driving_team import DrivingTeam
from gspn_framework_package.world.referee import STUCK_SECONDS, Referee
from gspn_framework_package.world.room import Pose
from gspn_framework_package.world.room_file import load_room
from gspn_framework_package.world.traffic import Patrol

FOLDER = Path(__file__).resolve().parents[3] / "plans" / "patrol"
ROOM = load_room(FOLDER / "critical_room.yaml")


def names(count):
    return ["robot_%d" % (index + 1) for index in range(count)]


def report_without_faults(run):
    """What the referee saw of a patrol that is over, which has to be no fault."""
    report = run.referee.report()
    run.team.close()
    assert run.failures == []
    for nothing in (
        "contacts_between_robots",
        "contacts_with_solids",
        "stuck_minutes",
        "goals_aborted",
        "two_in_one_location",
        "overtakings",
    ):
        assert report[nothing] == 0, nothing
    return report


@pytest.mark.parametrize("count, seconds", [(1, 100), (8, 30)])
def test_a_team_patrols_by_the_rules(count, seconds):
    run = Patrol(ROOM, names(count), seed=count)
    run.run(seconds)
    report = report_without_faults(run)
    # half a minute for a location is slow already
    assert report["entries"] >= min(count, 4) * seconds / 40
    if count == 1:
        assert report["laps"] == 1


@pytest.mark.parametrize("name", ["two_halls", "four_rooms"])
def test_a_team_patrols_rooms_with_a_corridor_and_with_doors(name):
    room = load_room(FOLDER / "rooms" / (name + ".yaml"))
    assert list(room.locations) == list(ROOM.locations)
    run = Patrol(room, names(4), seed=3)
    run.run(65)
    report = report_without_faults(run)
    # each into its first location, and some through the corridor or two doors into the next
    assert report["entries"] > 4


def test_the_same_seed_gives_the_same_patrol():
    def report(seed):
        run = Patrol(ROOM, names(2), seed=seed)
        run.run(6)
        poses = [run.team.physics.pose(name) for name in run.team.robots]
        run.team.close()
        return poses, run.referee.report()

    assert report(5) == report(5)
    assert report(5) != report(6)


def test_the_hot_spot_raises_the_alarm():
    run = Patrol(ROOM, names(2), seed=1)
    alarms = set()
    while run.team.time < 60 and not alarms:
        run.step()
        alarms = {m.at for m in run._members if m.state == "alarm"}
    run.team.close()
    assert alarms == {"L2"}


def test_a_lost_robot_holds_its_location_until_it_returns():
    run = Patrol(ROOM, names(3), seed=2)
    # robot_2 dies in the middle of L2
    while ROOM.locations["L2"].area.distance(position(run, "robot_2")) > 0.0:
        run.step()
    run.kill("robot_2")
    dead = position(run, "robot_2")
    run.run(50)
    # the others have gone on to where they may go, and nobody has come into L2
    assert {m.at for m in run._members} == {"L1", "L2"}
    assert any("robot_2 is in it" in m.feedback for m in run._members)
    assert run.referee.together == []
    assert math.dist(dead, position(run, "robot_2")) < 0.02
    entries = run.referee.report()["entries"]
    run.revive("robot_2")
    run.run(60)
    report = run.referee.report()
    run.team.close()
    assert report["entries"] >= entries + 3
    assert report["contacts_between_robots"] == report["two_in_one_location"] == 0
    assert report["goals_aborted"] == 0
    assert run.failures == []


def test_a_lost_robot_in_a_bay_is_planned_around():
    run = Patrol(ROOM, names(5), seed=2)
    run.kill("robot_5")
    run.run(45)
    report = run.referee.report()
    run.team.close()
    assert report["robots"]["robot_5"]["distance"] < 0.1
    assert report["entries"] >= 5
    assert report["contacts_between_robots"] == report["contacts_with_solids"] == 0
    assert run.failures == []


def position(run, robot):
    pose = run.team.physics.pose(robot)
    return (pose.x, pose.y)


# --- actions


class Base:
    """A robot that is wherever it is sent, at once; ``fails`` goals are given up first."""

    name = "me"

    def __init__(self, fails=0):
        self.at = Pose(0.0, 0.0)
        self.neighbours = {}
        self.clock = 0.0
        self.goals = []
        self.fails = fails
        self.arrives = True

    def now(self):
        self.clock += 0.5
        return self.clock

    def pose(self):
        return self.at

    def others(self):
        return self.neighbours

    def temperature(self):
        return ROOM.temperature.at((self.at.x, self.at.y), 10.0)

    def go(self, goal):
        self.goals.append(goal)
        if self.fails:
            self.fails -= 1
        elif self.arrives:
            self.at = goal

    def arrived(self):
        return self.goals[-1] == self.at if self.arrives else None

    def trouble(self):
        return "blocked"


def finish(action):
    """The result of an action, and what it said."""
    said = []
    while True:
        try:
            said.append(next(action))
        except StopIteration as done:
            return done.value, said


@pytest.mark.parametrize("location, answer", [("L2", "high"), ("L3", "low")])
def test_a_check_sweeps_the_location_and_reads_the_thermometer(location, answer):
    base = Base()
    action = patrol.measure_temperature(base, ROOM, location, 30.0, "high", "low")
    assert finish(action)[0] == answer
    place = ROOM.locations[location]
    assert [(goal.x, goal.y) for goal in base.goals] == list(place.sweep)


def test_a_check_waits_at_the_entry_until_the_location_is_clear():
    base = Base()
    base.neighbours["other"] = Pose(0.85, -1.9)  # its edge is still in L1
    action = patrol.measure_temperature(base, ROOM, "L1", 30.0, "high", "low")
    for _ in range(20):
        said = next(action)
    assert said == "waiting at the entry of L1, other is in it"
    assert base.goals == [ROOM.locations["L1"].entry]
    base.neighbours["other"] = Pose(0.95, -1.9)
    assert finish(action)[0] == "low"


def test_a_check_begins_even_where_a_lost_robot_stands_at_the_entry():
    run = Patrol(ROOM, names(2), seed=4)
    # robot_1 is to check L1; robot_2 is dead, on the entry of L1
    run.kill("robot_2")
    entry = ROOM.locations["L1"].entry
    run.team.physics.show("robot_2", entry)
    run.run(40)
    report = run.referee.report()
    run.team.close()
    assert run.failures == []
    assert report["robots"]["robot_1"]["entries"] >= 1
    assert report["contacts_between_robots"] == 0


def test_waiting_takes_a_slot_that_is_free():
    bay = ROOM.locations["L1"].bay
    base = Base()
    base.neighbours["other"] = bay[2]
    finish(patrol.wait_in_bay(base, ROOM, "L1", 2.0, first_slot=2))
    assert base.at == bay[3]


def test_a_slot_that_another_one_takes_meanwhile_is_left_to_it():
    bay = ROOM.locations["L1"].bay
    base = Base()
    base.arrives = False
    action = patrol.wait_in_bay(base, ROOM, "L1", 2.0)
    next(action)
    assert base.goals == [bay[0]]
    base.neighbours["other"] = bay[0]
    base.arrives = True
    finish(action)
    assert base.goals == [bay[0], bay[1]]
    assert base.at == bay[1]


def test_robots_of_a_team_prefer_different_slots():
    wishes = {patrol.preferred_slot("robot_%d" % number) % 8 for number in range(1, 9)}
    assert len(wishes) == 8
    assert (
        patrol.preferred_slot("carol")
        == patrol.preferred_slot("carol")
        != patrol.preferred_slot("dave")
    )


def test_a_slot_that_cannot_be_reached_is_left_for_the_next():
    base = Base(fails=1)
    finish(patrol.wait_in_bay(base, ROOM, "L1", 2.0))
    assert base.goals == list(ROOM.locations["L1"].bay[:2])


def test_an_action_that_cannot_get_there_says_why():
    base = Base(fails=100)
    with pytest.raises(ActionFailed, match="cannot reach .*: blocked"):
        finish(patrol.measure_temperature(base, ROOM, "L1", 30.0, "high", "low"))
    assert len(base.goals) == 3


# --- the referee


@pytest.fixture
def scene():
    """Returns a function that puts robots somewhere and gives the team and its referee."""
    made = []

    def put(*poses):
        team = DrivingTeam(ROOM, names(len(poses)), poses)
        made.append(team)
        return team, Referee(team)

    yield put
    for team in made:
        team.close()


def test_the_referee_sees_two_in_one_location(scene):
    team, referee = scene(Pose(0.0, -1.9), Pose(0.5, -1.9), Pose(1.9, 0.0))
    team.step()
    referee.watch()
    referee.watch()
    assert [(name, who) for _, name, who in referee.together] == [("L1", ("robot_1", "robot_2"))]


class Unruly(Patrol):
    """A patrol whose plan has lost its rule: everybody goes on to the next location, whoever is in
    it."""

    def _decide(self, member, answer):
        member.state, member.at = "check", self._next(member.at)
        self.referee.order.grant(member.robot.name, member.at)


@pytest.mark.parametrize("looks", [True, False])
def test_a_plan_without_its_rule_is_found_out_by_the_poses(monkeypatch, looks):
    """The robots' own look before they enter holds the rule all the same; without it two are in one
    location."""
    if not looks:
        monkeypatch.setattr(patrol, "occupant", lambda location, robots, radius: None)
    run = Unruly(ROOM, names(4), seed=1)
    # robot_2 stays in L2
    while ROOM.locations["L2"].area.distance(position(run, "robot_2")) > 0.0:
        run.step()
    run.kill("robot_2")
    while run.team.time < 45 and not run.referee.together:
        run.step()
    found = run.referee.report()["two_in_one_location"]
    run.team.close()
    if looks:
        assert found == 0
        assert any("robot_2 is in it" in member.feedback for member in run._members)
    else:
        assert found == 1
        assert run.referee.together[0][1:] == ("L2", ("robot_1", "robot_2"))


def test_the_referee_sees_an_entry_out_of_turn(scene):
    team, referee = scene(Pose(0.0, -1.9), Pose(1.9, 0.0))
    for robot, location in (("robot_2", "L1"), ("robot_1", "L1"), ("robot_2", "L2")):
        referee.order.grant(robot, location)
    referee.watch()
    assert [(name, who) for _, name, who in referee.order.out_of_turn] == [("L1", "robot_1")]


def test_the_referee_counts_the_time_that_a_robot_is_stuck(scene):
    team, referee = scene(Pose(0.0, 0.55), Pose(0.4, 0.55))
    team.navigators["robot_1"].go(Pose(0.4, 0.55), team.time)
    # where it cannot move: a navigator that never gets its command through
    team.navigators["robot_1"].step = lambda seen, dt: (0.0, 0.0)
    while team.time < STUCK_SECONDS + 10:
        team.step()
        referee.watch()
    assert referee.tallies["robot_1"].stuck == pytest.approx(10.0, abs=1.0)
    assert referee.tallies["robot_2"].stuck == 0.0


def test_the_referee_counts_laps_and_distance(scene):
    team, referee = scene(Pose(-1.15, -1.65))
    base = team.navigators["robot_1"]
    for location in ("L1", "L2", "L3", "L4"):
        for x, y in (ROOM.locations[location].sweep[0], ROOM.locations[location].sweep[-1]):
            base.go(Pose(x, y), team.time, turn=False)
            while base.active:
                team.step()
                referee.watch()
    tally = referee.tallies["robot_1"]
    assert (tally.laps, tally.entries, tally.reached) == (1, 4, 8)
    assert 8.0 < tally.distance < 14.0
