"""People in the room: they come, walk around robots and go; no robot drives into them."""

from __future__ import annotations

import math
import random
from typing import Iterator, List, Sequence, Tuple

import pytest

from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.model.net import Point
from gspn_framework_package.world import driving_team
from gspn_framework_package.world.driving_team import CONTROL_PERIOD, DrivingTeam
from gspn_framework_package.world.people import ENTRANCE, KEPT_DISTANCE, PEOPLE_PATIENCE, Walker
from gspn_framework_package.world.referee import Referee
from gspn_framework_package.world.room import Person, Pose, Room
from gspn_framework_package.world.room_file import load_room, parse_room

WALLS: Tuple[Tuple[Point, ...], ...] = (((-2, -1.5), (2, -1.5), (2, 1.5), (-2, 1.5), (-2, -1.5)),)
THROUGH = Person(((-1.6, 0.0), (0.0, 0.0), (1.6, 0.0)), away_mean=1.0, stands=1.0)
RADIUS = 0.105


def a_room(*spawn: Pose, person: Person = THROUGH) -> Room:
    return Room("hall", WALLS, spawn=spawn, people=(person,))


def walk(walker: Walker, robots: Sequence[Pose], seconds: float) -> Iterator[Tuple[float, Point]]:
    """The times and places of a visit."""
    for step in range(round(seconds / CONTROL_PERIOD)):
        time = step * CONTROL_PERIOD
        walker.step(time, CONTROL_PERIOD, robots)
        if walker.at is not None:
            yield time, walker.at
        elif walker.visits:
            return


def test_a_person_comes_stands_at_each_point_and_leaves():
    walker = Walker(THROUGH, a_room(), random.Random(1))
    visit = list(walk(walker, [], 60))
    assert walker.at is None and walker.visits == 1
    assert visit[0][1] == (-1.6, 0.0) and math.dist(visit[-1][1], (1.6, 0.0)) < 0.1
    steps = [math.dist(a[1], b[1]) for a, b in zip(visit, visit[1:])]
    assert max(steps) == pytest.approx(THROUGH.speed * CONTROL_PERIOD)
    stood = [at for _, at in visit if math.dist(at, (0.0, 0.0)) < 0.06]
    assert len(stood) >= THROUGH.stands / CONTROL_PERIOD
    assert visit[-1][0] - visit[0][0] < 10


@pytest.mark.parametrize("y", [0.0, 0.2, -0.25])
def test_a_person_goes_around_a_robot_that_stands_in_the_way(y: float):
    walker = Walker(THROUGH, a_room(), random.Random(1))
    robot = Pose(0.8, y)
    gaps = [robot.distance(at) - RADIUS - 0.2 for _, at in walk(walker, [robot], 60)]
    assert walker.visits == 1 and walker.at is None
    assert min(gaps) >= KEPT_DISTANCE - 1e-9


def test_nobody_comes_in_where_a_robot_stands():
    walker = Walker(THROUGH, a_room(), random.Random(1))
    at_the_door = Pose(-1.6 + RADIUS + 0.2 + ENTRANCE - 0.01, 0.0)
    assert not list(walk(walker, [at_the_door], 30))
    assert list(walk(walker, [], 60))


def test_a_person_goes_on_when_a_robot_stands_on_the_next_point():
    walker = Walker(THROUGH, a_room(), random.Random(1))
    visit = list(walk(walker, [Pose(0.0, 0.0)], 60))
    assert walker.at is None and visit[-1][0] - visit[0][0] > PEOPLE_PATIENCE


def test_a_robot_stops_before_a_person_whatever_it_was_asked(monkeypatch):
    """Driven by hand, straight at somebody who stands."""
    standing = Person(((0.5, 0.0), (0.7, 0.0), (0.5, 0.0)), away_mean=0.001, stands=1000.0)

    def drive() -> Tuple[List[float], DrivingTeam]:
        team = DrivingTeam(a_room(Pose(-0.9, 0.02), person=standing), ["r"])
        referee, gaps = Referee(team), []
        for _ in range(150):
            team.teleoperate("r", 0.22, 0.0)
            team.step()
            referee.watch()
            gaps.append(team.people[0].gap(team.physics.pose("r"), RADIUS))
        assert referee.report()["nearest_to_people"] == pytest.approx(min(gaps), abs=0.001)
        assert referee.report()["contacts_with_people"] == len(team.physics.contacts.people)
        return gaps, team

    gaps, team = drive()
    assert min(gaps) > 0.35 and team.physics.contacts.total == 0
    assert min(team.physics.scan("r")) < 0.6  # the scanner sees somebody
    team.close()
    monkeypatch.setattr(driving_team, "halted", lambda *_: False)
    gaps, team = drive()
    assert team.physics.contacts.people == {"r": 1}
    team.close()


def test_a_robot_may_turn_and_leave_beside_a_person():
    standing = Person(((0.5, 0.0), (0.7, 0.0), (0.5, 0.0)), away_mean=0.001, stands=1000.0)
    team = DrivingTeam(a_room(Pose(-0.2, 0.0), person=standing), ["r"])
    team.navigators["r"].go(Pose(-1.5, 0.5), 0.0)
    for _ in range(200):
        team.step()
    assert team.physics.pose("r").distance((-1.5, 0.5)) < 0.1
    team.close()


def test_the_seed_decides_when_somebody_comes():
    first = [DrivingTeam(a_room(), [], seed=seed) for seed in (1, 1, 2)]
    for team in first:
        while team.people[0].at is None:
            team.step()
    assert first[0].time == first[1].time != first[2].time
    for team in first:
        team.close()


@pytest.mark.parametrize(
    "change, element, said",
    [
        ("[[-3.95, 1.3], [0, 1.3]]", "people[0].path[0]", "a person does not fit"),
        ("[[-3.7, 1.3]]", "people[0].path", "needs 2 or more"),
        ("[[-3.7, 1.3], [9.0, 1.3]]", "people[0].path[1]", "no path leads|does not fit"),
    ],
)
def test_a_path_that_nobody_can_walk_is_refused(change: str, element: str, said: str):
    with open(plans_folder() + "/warehouse/warehouse.yaml", encoding="utf-8") as file:
        text = file.read()
    begin = text.index("path: ") + len("path: ")
    wrong = text[:begin] + change + text[text.index(", away_mean") :]
    with pytest.raises(InputError, match=said) as caught:
        parse_room(wrong, "x.yaml")
    assert caught.value.element == element and caught.value.line is not None


def test_robots_of_the_warehouse_have_room_beside_the_person():
    """Wherever robots stop, the person can get out."""
    room = load_room(plans_folder() + "/warehouse/warehouse.yaml")
    for point in room.people[0].path:
        assert float(room.clearance(*point)) > room.people[0].radius
    assert room.people[0].path[0] == room.people[0].path[-1]
