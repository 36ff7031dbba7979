"""``gspn room``: rooms of maps and of worlds of Gazebo."""

import json
import math
import struct
import tempfile

import numpy as np
import pytest
from PIL import Image

from gspn_framework_package.cli.main import main
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.world.grid import Grid, merged_boxes
from gspn_framework_package.world.map_room import read_occupancy_map
from gspn_framework_package.world.physics import Physics
from gspn_framework_package.world.room import Box, Cylinder, Room
from gspn_framework_package.world.room_file import load_room
from gspn_framework_package.world.sdf_world import read_world

WALL, FREE, UNKNOWN = 0, 254, 205


def a_map(folder, cells=None, **changes):
    """Write a map: by default a room of 4 m x 2 m with a wall of 5 cm around it, in a larger image."""
    if cells is None:
        cells = np.full((60, 100), UNKNOWN, np.uint8)
        cells[5:47, 10:92] = WALL
        cells[6:46, 11:91] = FREE
        cells[6:20, 50] = WALL  # from the north wall to the middle
    Image.fromarray(cells).save(folder / "hall.pgm")
    data = {
        "image": "hall.pgm",
        "resolution": 0.05,
        "origin": [-1.0, -2.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
        **changes,
    }
    lines = [
        "%s: %s" % (key, json.dumps(value)) for key, value in data.items() if value is not None
    ]
    (folder / "hall.yaml").write_text("\n".join(lines) + "\n")
    return str(folder / "hall.yaml")


def test_boxes_cover_the_filled_cells_and_nothing_else():
    filled = np.random.default_rng(1).random((12, 17)) < 0.4
    boxes = merged_boxes(filled, 0.5, (1.0, 2.0))
    assert len(boxes) < filled.sum()
    xs, ys = np.meshgrid(1.25 + 0.5 * np.arange(17), 2.25 + 0.5 * np.arange(12))
    inside = np.array([box.distance(xs, ys) < 0.0 for box in boxes])
    assert (inside.any(axis=0) == filled).all() and inside.sum(axis=0).max() == 1


def test_a_grid_has_the_clearance_of_a_room_with_many_boxes():
    filled = np.random.default_rng(2).random((30, 40)) < 0.2
    room = Room("many", (), obstacles=tuple(merged_boxes(filled, 0.1, (0.0, 0.0))))
    grid = Grid(room)
    assert (grid.clearance == room.clearance(grid.xs, grid.ys)).all()


def test_a_map_becomes_a_room_in_which_robots_drive(tmp_path, capsys):
    file = str(tmp_path / "room.yaml")
    assert main(["room", a_map(tmp_path), "-o", file, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["output"] == file
    room = load_room(file)
    assert (room.name, len(room.spawn)) == ("hall", 4)
    # the image's first row is in the north: its height is 60 cells
    bounds = room.bounds()
    assert bounds.low == pytest.approx((-0.5, -2.0 + 13 * 0.05))
    assert bounds.high == pytest.approx((-1.0 + 92 * 0.05, -2.0 + 55 * 0.05))
    assert float(room.clearance(1.525, 0.2)) < 0.0 < float(room.clearance(1.525, -0.5))
    physics = Physics(room, ["r"])
    physics.advance(0.2)
    assert 0.1 < min(physics.scan("r")) < 2.0 and physics.contacts.total == 0
    physics.close()


def test_a_map_may_be_turned_and_negated(tmp_path):
    (box,) = read_occupancy_map(
        a_map(
            tmp_path,
            cells=np.array([[0, 0], [200, 0]], np.uint8),
            resolution=1.0,
            origin=[1.0, 0.0, math.pi / 2],
            negate=1,
        )
    )
    assert box.at == pytest.approx((0.5, 0.5)) and box.yaw == pytest.approx(math.pi / 2)


@pytest.mark.parametrize(
    "change, element, words",
    [
        ({"resolution": 0}, "resolution", "0 is not a resolution"),
        ({"resolution": 10**400}, "resolution", "is not a resolution"),
        ({"resolution": "fine"}, "resolution", "'fine' is not a resolution"),
        ({"resolution": 5.0}, "resolution", "the map is 410 m x 210 m"),
        ({"resolution": 5e-4}, "resolution", "the map is 0.041 m x 0.021 m (no robot fits"),
        ({"origin": [0, 0]}, "origin", "pose"),
        ({"negate": 2}, "negate", "neither 0 nor 1"),
        ({"occupied_thresh": 65}, "occupied_thresh", "from 0 to 1"),
        ({"mode": "raw"}, "mode", "'raw' is not read"),
        ({"image": "none.pgm"}, "image", "none.pgm: No such file"),
        ({"image": "hall.yaml"}, "image", "is not an image"),
        ({"rooms": 3}, "rooms", "there is no key 'rooms'"),
        ({"resolution": None}, None, "'resolution' is missing"),
        ({"image": None}, None, "not a map"),
    ],
)
def test_a_bad_map_is_refused_with_file_line_and_key(tmp_path, capsys, change, element, words):
    file = a_map(tmp_path, **change)
    assert main(["room", file, "-o", str(tmp_path / "room.yaml")]) == 2
    told = capsys.readouterr()
    assert told.out == "" and file in told.err and words in told.err
    if element:
        with open(file) as text:
            line = next(n for n, line in enumerate(text, 1) if line.startswith(element))
        assert "%s:%d: %s: " % (file, line, element) in told.err
    assert not (tmp_path / "room.yaml").exists()


def test_a_map_without_walls_or_with_too_little_room_is_refused(tmp_path):
    with pytest.raises(InputError, match="no cell of the image is occupied"):
        read_occupancy_map(a_map(tmp_path, cells=np.full((5, 5), FREE, np.uint8)))
    assert main(["room", a_map(tmp_path), "--robots", "100"]) == 2
    assert main(["room", a_map(tmp_path, resolution=0.005)]) == 2


# --- worlds of Gazebo

COLLADA = """
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>
  <library_geometries><geometry id="wall"><mesh>
    <source id="points">
      <float_array id="numbers" count="12">0 0 0 2 0 0 2 0 1 0 0 1</float_array>
      <technique_common><accessor source="#numbers" count="4" stride="3">
        <param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
      </accessor></technique_common>
    </source>
    <vertices id="corners"><input semantic="POSITION" source="#points"/></vertices>
    <triangles count="2">
      <input semantic="VERTEX" source="#corners" offset="0"/><p>0 1 2 0 2 3</p>
    </triangles>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="scene"><node id="node">
    <instance_geometry url="#wall"/>
  </node></visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>
"""
MESH = "<mesh><uri>%s</uri></mesh>"


def a_world(folder, *models, around=""):
    text = "<?xml version='1.0'?>\n<sdf version='1.6'>\n<world name='w'>\n"
    text += "<include><uri>model://sun</uri></include>\n"
    text += "<include><uri>model://ground_plane</uri></include>\n"
    text += around + "\n".join(models) + "\n</world>\n</sdf>\n"
    (folder / "hall.world").write_text(text)
    return str(folder / "hall.world")


def a_model(geometry, pose="0 0 0 0 0 0", link="", name="m", static="true"):
    return (
        "<model name='%s'>\n<static>%s</static>\n<pose>%s</pose>\n<link name='l'>\n%s\n"
        "<collision name='c'>\n<geometry>%s</geometry>\n</collision>\n</link>\n</model>"
        % (name, static, pose, link, geometry)
    )


def solids(folder, *models, around=""):
    return read_world(a_world(folder, *models, around=around))


def test_upright_shapes_of_a_world_are_read_as_they_are(tmp_path):
    found, notes = solids(
        tmp_path,
        a_model("<box><size>2 0.1 1</size></box>", "1 2 0.5 0 0 1.5", "<pose>1 0 0 0 0 0.5</pose>"),
        a_model("<cylinder><radius>0.2</radius><length>0.5</length></cylinder>", "3 0 0.25 0 0 0"),
        a_model("<plane><normal>0 0 1</normal><size>9 9</size></plane>"),
        a_model("<sphere><radius>0.5</radius></sphere>", "0 0 0.6 0 0 0"),
    )
    box, cylinder, sphere = found
    assert isinstance(box, Box) and isinstance(cylinder, Cylinder) and notes == []
    assert box.at == pytest.approx((1.0 + math.cos(1.5), 2.0 + math.sin(1.5)))
    assert (box.size, box.yaw, box.height) == ((2.0, 0.1), pytest.approx(2.0), 1.0)
    assert (cylinder.at, cylinder.radius, cylinder.height) == ((3.0, 0.0), 0.2, 0.5)
    assert sphere.radius == pytest.approx(0.3)  # at the height of a robot


def test_what_no_robot_touches_is_left_out_and_said(tmp_path):
    found, notes = solids(
        tmp_path,
        a_model("<box><size>1 1 0.05</size></box>", "0 0 0.75 0 0 0", name="table"),
        a_model("<box><size>9 9 0.1</size></box>", "0 0 -0.05 0 0 0", name="floor"),
        a_model("<sphere><radius>0.1</radius></sphere>", "0 0 0.1 0 0 0", name="ball", static="0"),
    )
    assert len(found) == 1
    assert [note.split(":")[0] for note in notes[:2]] == [
        "model 'table', link 'l', collision 'c'",
        "model 'floor', link 'l', collision 'c'",
    ]
    assert "model 'ball' can be pushed in Gazebo" in notes[2]


def near(found, x, y):
    return min(float(solid.distance(x, y)) for solid in found)


def test_tilted_shapes_and_meshes_are_solid_where_a_robot_touches_them(tmp_path):
    (tmp_path / "wall.obj").write_text(
        "v 0 0 0\nv 2 0 0\nv 2 0 1\nv 0 0 1\nv 0 2 0\nv 0 2 1\nf 1 2 3\nf 1 3 4\nf 1 5 6\nf 1 6 4\n"
    )
    (tmp_path / "wall.dae").write_text(COLLADA)
    triangle = [(0, 0, 0), (4, 0, 0), (4, 0, 4)]
    stl = bytes(80) + struct.pack("<I", 1) + struct.pack("<12fH", 0, -1, 0, *sum(triangle, ()), 0)
    (tmp_path / "wall.stl").write_bytes(stl)
    found, _ = solids(
        tmp_path,
        a_model(MESH % "wall.obj", "1 1 0 0 0 %f" % math.pi),
        a_model(MESH % "file://wall.stl", "5 0 -1 0 0 0"),
        a_model(MESH % "wall.dae", "-5 0 0 0 0 0"),
        a_model(
            "<cylinder><radius>0.1</radius><length>1</length></cylinder>", "-2 3 0.1 1.5708 0 0"
        ),
    )
    assert len(found) < 60
    assert near(found, -3.1, 0.0) < 0.03 < 0.9 < near(found, -4.0, 1.0)
    for x in np.arange(-0.9, 0.9, 0.1):  # the wall, turned by half a turn, and its corner
        assert near(found, x, 1.0) < 0.03 and near(found, 1.0, x) < 0.03
    assert near(found, 0.0, 0.0) > 0.9
    assert near(found, 7.0, 0.0) < 0.03 < 0.9 < near(found, 5.0, 1.0)
    assert near(found, -2.0, 2.55) < 0.03 < 0.07 < near(found, -2.2, 3.0)  # it lies along y
    found, _ = solids(
        tmp_path, a_model((MESH % "wall.obj").replace("</mesh>", "<scale>2 1 1</scale></mesh>"))
    )
    assert near(found, 3.9, 0.0) < 0.03


def test_models_are_found_by_their_names_and_stand_where_gazebo_saved_them(tmp_path, monkeypatch):
    folder = tmp_path / "models" / "pillar"
    folder.mkdir(parents=True)
    pillar = "<cylinder><radius>0.1</radius><length>1</length></cylinder>"
    model = a_model(pillar, static="false")
    (folder / "model.sdf").write_text("<sdf version='1.6'>" + model + "</sdf>")
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(tmp_path / "models"))
    include = (
        "<include><uri>model://pillar</uri><name>%s</name><pose>%s 0 0 0 0 0</pose>%s</include>"
    )
    state = "<state><model name='two'><pose>7 0 0 0 0 0</pose></model></state>"
    one = include % ("one", 1, "<static>true</static>")
    found, notes = solids(tmp_path, one, include % ("two", 2, ""), around=state)
    assert [solid.at for solid in found] == [(1.0, 0.0), (7.0, 0.0)]
    assert [note.split(" can ")[0] for note in notes] == ["model 'two'"]


@pytest.mark.parametrize(
    "model, line, words",
    [
        (
            a_model("<heightmap/>"),
            13,
            "model 'm', link 'l', collision 'c': <heightmap> is not read",
        ),
        (a_model(MESH % "none.obj"), 13, "there is no 'none.obj'"),
        (a_model(MESH % "hall.world"), 13, "PyBullet does not load"),
        (a_model(MESH % "bad.dae"), 13, "PyBullet does not load"),
        (
            a_model(MESH % "points.obj"),
            13,
            "line 5 of {folder}/points.obj names a point that is not",
        ),
        (a_model(MESH[:-7] % "bad.dae" + "<scale>1 0 1</scale></mesh>"), 13, "is 0"),
        (a_model("<box><size>1e9 1 1</size></box>", "0 0 0 1 0 0"), 13, "too large for a room"),
        (a_model("<box><size>1 1</size></box>"), 13, "<size> has not 3 numbers"),
        (a_model("<box><size>1 0 1</size></box>"), 13, "<size> is not more than 0"),
        (a_model("<sphere/>"), 13, "<radius> is missing"),
        (a_model("<plane/>", "0 0 1 0 0 0"), 13, "not the floor"),
        (a_model("<box><size>1 1 1</size></box>", "0 0 inf 0 0 0"), 9, "<pose> has not 6 numbers"),
        (
            a_model("<plane/>").replace("<pose>", "<pose relative_to='x'>"),
            9,
            "a pose with 'relative_to'",
        ),
        ("<include><uri>model://no_such</uri></include>", 7, "there is no 'model://no_such'"),
        ("<model name='m' placement_frame='l'/>", 7, "'placement_frame' is not read"),
        ("<actor name='walker'/>", 7, "<actor> is not read"),
    ],
)
def test_what_cannot_be_read_is_named_and_nothing_is_written(
    tmp_path, capsys, monkeypatch, model, line, words
):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    (tmp_path / "bad.dae").write_text("<COLLADA/>")
    (tmp_path / "points.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 1\nf -3 2/1 3\nf 1 2 4\n")
    file = a_world(tmp_path, a_model("<plane/>").replace("\n", ""), model)
    assert main(["room", file, "-o", str(tmp_path / "room.yaml")]) == 2
    told = capsys.readouterr()
    words = words.format(folder=tmp_path)
    assert "%s:%d: " % (file, line) in told.err and words in told.err, told.err
    assert told.out == "" and not (tmp_path / "room.yaml").exists()
    assert not list(temporary.iterdir())


def test_a_world_becomes_a_room(tmp_path, capsys):
    wall = "<box><size>%s 1</size></box>"
    file = a_world(
        tmp_path,
        *(a_model(wall % "0.1 4", "%d 0 0.5 0 0 0" % x) for x in (-2, 2)),
        *(a_model(wall % "4 0.1", "0 %d 0.5 0 0 0" % y) for y in (-2, 2)),
    )
    room = str(tmp_path / "room.yaml")
    assert main(["room", file, "-o", room, "--robots", "2", "--model", "waffle"]) == 0
    made = load_room(room)
    assert (len(made.obstacles), len(made.spawn), made.robot.radius) == (4, 2, 0.22)
    assert main(["room", file, "-o", room]) == 2  # the file exists
    assert "exists" in capsys.readouterr().err
    for bad in ("<sdf/>", "<world/>", "<sdf><world/><world/></sdf>", "<sdf><world/></sdf>"):
        (tmp_path / "hall.world").write_text(bad)
        assert main(["room", file]) == 2
    assert "nothing solid is in it" in capsys.readouterr().err
