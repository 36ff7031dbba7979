"""Rooms and room files."""

import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.world.room import Area, Box, Cylinder, HotSpot, Pose, TemperatureField
from gspn_framework_package.world.room_file import load_room, parse_room

ROOT = Path(__file__).resolve().parents[3]
CRITICAL_ROOM = ROOT / "plans" / "patrol" / "critical_room.yaml"


def test_the_critical_room_is_that_of_the_thesis():
    room = load_room(CRITICAL_ROOM)
    walls = room.wall_boxes()
    inside = min(math.hypot(*wall.at) - room.wall_thickness / 2 for wall in walls)
    assert inside == pytest.approx(5.2 / 2)
    centres = sorted(o.at for o in room.obstacles)
    assert centres == sorted((x, y) for x in (-1.1, 0.0, 1.1) for y in (-1.1, 0.0, 1.1))
    assert {o.radius for o in room.obstacles} == {0.15}
    assert list(room.locations) == ["L1", "L2", "L3", "L4"]
    robot = room.robot
    assert (robot.max_speed, robot.max_turn_rate, robot.radius) == (0.22, 2.84, 0.105)
    # eight robots fit in each bay, and at the start
    assert {len(place.bay) for place in room.locations.values()} == {8}
    assert len(room.spawn) == 8


def test_a_room_that_says_little_gets_the_defaults():
    room = parse_room("name: bare\nwalls: []\n")
    assert room.robot.max_speed == 0.22
    assert room.temperature.at((0.0, 0.0), 0.0) == 21.0
    assert room.clearance(0.0, 0.0) == math.inf


coordinate = st.floats(-3, 3)


@settings(deadline=None)
@given(coordinate, coordinate, st.floats(-math.pi, math.pi), coordinate, coordinate)
def test_a_turned_box_is_as_far_as_the_unturned_one_seen_from_its_frame(x, y, yaw, px, py):
    turned = Box((x, y), (0.8, 0.3), yaw)
    dx, dy = px - x, py - y
    local = (
        dx * math.cos(yaw) + dy * math.sin(yaw),
        dy * math.cos(yaw) - dx * math.sin(yaw),
    )
    plain = Box((0.0, 0.0), (0.8, 0.3))
    assert turned.distance(px, py) == pytest.approx(plain.distance(*local), abs=1e-9)


@settings(deadline=None)
@given(coordinate, coordinate)
def test_the_distance_to_a_box_is_that_to_its_nearest_point(px, py):
    box, area = Box((0.5, 0.0), (1.0, 2.0)), Area((0.0, -1.0), (1.0, 1.0))
    assert max(box.distance(px, py), 0.0) == pytest.approx(area.distance((px, py)), abs=1e-9)
    assert Cylinder((1.0, 0.0), 0.25).distance(px, py) == pytest.approx(
        math.hypot(px - 1.0, py) - 0.25
    )


def test_a_hot_spot_burns_in_turns_and_walks_its_path():
    spot = HotSpot(((0.0, 0.0), (2.0, 0.0)), 10.0, 0.5, speed=0.5, hot_for=3.0, cold_for=2.0)
    assert [spot.burns(time) for time in (0.0, 2.9, 3.1, 4.9, 5.1)] == [
        True,
        True,
        False,
        False,
        True,
    ]
    # there and back again: the path is closed
    assert spot.at(2.0) == (1.0, 0.0)
    assert spot.at(6.0) == (1.0, 0.0)
    field = TemperatureField(20.0, (spot,))
    assert field.at((1.0, 0.0), 2.0) == pytest.approx(30.0)
    assert field.at((1.5, 0.0), 2.0) == pytest.approx(20.0 + 10.0 * math.exp(-0.5))
    assert field.at((1.0, 0.0), 4.0) == 20.0


def test_the_page_gets_everything_to_draw():
    room = load_room(CRITICAL_ROOM)
    drawn = room.as_json()
    assert len(drawn["cylinders"]) == 9
    assert len(drawn["boxes"]) == 4
    assert drawn["locations"]["L2"]["area"] == [(1.3, -0.8), (2.5, 0.8)]
    assert Pose(*drawn["locations"]["L1"]["entry"]) == room.locations["L1"].entry
