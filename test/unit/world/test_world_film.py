"""Pictures, recordings and films."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gspn_framework_package.cli.main import main
from gspn_framework_package.cli.replay import recorded_poses
from gspn_framework_package.model.errors import InputError, LogError
from gspn_framework_package.model.robot_colours import colour_of
from gspn_framework_package.world.bodies import rgba
from gspn_framework_package.world.camera import Camera
from gspn_framework_package.world.driving_team import DrivingTeam
from gspn_framework_package.world.film import Film, find_ffmpeg
from gspn_framework_package.world.recording import Recorder, read_recording
from gspn_framework_package.world.room import Pose
from gspn_framework_package.world.room_file import parse_room

ROOM_TEXT = """
name: hall
walls:
  - [[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]
locations:
  A:
    area: [[-0.2, -0.2], [0.2, 0.2]]
    entry: [-0.5, 0]
    sweep: [[0, 0]]
spawn: [[0.5, 0.5], [-0.5, -0.5]]
"""


@pytest.fixture
def team():
    team = DrivingTeam(parse_room(ROOM_TEXT), ["robot_1", "robot_2"])
    yield team
    team.close()


@pytest.fixture
def recording(team, tmp_path):
    """The file of a run of three seconds in which robot_1 drives south."""
    file = tmp_path / "run.jsonl"
    team.navigators["robot_1"].go(Pose(0.5, -0.5), 0.0)
    with Recorder(file, ROOM_TEXT, team) as recorder:
        for _ in range(30):
            team.step()
            recorder.record()
    return file


def colors_near(image, x, y):
    """The pixels in a square around a point of a picture."""
    return np.asarray(image)[int(y) - 6 : int(y) + 7, int(x) - 6 : int(x) + 7].reshape(-1, 3) / 255


@pytest.mark.parametrize("view", ["corner", "top"])
def test_a_picture_shows_each_robot_in_its_colour_where_it_is(team, view):
    camera = Camera(team.physics, 400, 300, view)
    image = camera.picture(0.0)
    assert image.size == (400, 300)
    for name in team.robots:
        pose = team.physics.pose(name)
        pixels = colors_near(image, *camera.pixel(pose.x, pose.y, 0.1))
        hue = np.array(rgba(colour_of(name))[:3])
        # of the same hue, whatever the light makes of it
        shades = pixels @ hue / (np.linalg.norm(pixels, axis=1) * np.linalg.norm(hue) + 1e-9)
        assert (shades > 0.98).mean() > 0.1, name
    corners = [camera.pixel(x, y) for x in (-1, 1) for y in (-1, 1)]
    assert all(0 < x < 400 and 0 < y < 300 for x, y in corners)


def test_a_recording_is_read_as_it_was_written(team, recording):
    read = read_recording(recording)
    assert read.robots == team.robots
    assert read.room.locations["A"] == team.room.locations["A"]
    assert len(read.moments) == 30
    time, poses = read.moments[-1]
    assert time == pytest.approx(3.0)
    assert poses[0].distance(team.physics.pose("robot_1")) < 1e-3
    assert [round(t, 1) for t, _ in read.every(1.0)] == [0.1, 1.1, 2.1, 3.0]


def test_a_recording_places_the_robots_of_a_log(team, recording, tmp_path, record_run):
    """By the wall clock: robots of the log's run that the recording has are on the page."""
    read = read_recording(recording)
    assert len(read.wall) == len(read.moments) and list(read.wall) == sorted(read.wall)
    track = recorded_poses(str(recording), [team.robots[0], "another"], read.wall[0])
    assert track.room == read.room.as_json()
    pose = read.moments[0][1][0]
    assert track.first() == {team.robots[0]: {"pose": [pose.x, pose.y, pose.yaw]}}
    with pytest.raises(LogError, match="no poses of the robots"):
        recorded_poses(str(recording), ["another"], read.wall[0])


def test_people_are_recorded_and_filmed(tmp_path, capsys):
    person = "{path: [[-0.7, -0.7], [0.7, -0.7]], away_mean: 0.001, color: '#00ff00'}"
    text = ROOM_TEXT + "people: [%s]\n" % person
    team = DrivingTeam(parse_room(text), ["robot_1"])
    file = tmp_path / "run.jsonl"
    with Recorder(file, text, team) as recorder:
        for _ in range(30):
            team.step()
            recorder.record()
    team.close()
    where = list(read_recording(file).people.values())
    assert len(where) == 30 and where[:2] == [(None,), ((-0.7, -0.7),)]
    words = ["--recording", str(file), "--seconds", "3", "--rate", "1", "--speed", "1"]
    film = tmp_path / "film"
    code = main(["film", str(film), *words, "--size", "320x240", "--view", "top"])
    assert code == 0, capsys.readouterr().err

    def green(picture):
        pixels = np.asarray(Image.open(picture).convert("RGB")).astype(int)
        return int(((pixels[..., 1] - pixels[..., [0, 2]].max(axis=2)) > 60).sum())

    pictures = sorted(film.iterdir())
    assert green(pictures[0]) == 0 and green(pictures[1]) > 20
    file.write_text(file.read_text()[:-3])
    assert len(read_recording(file).moments) == 29


def test_a_recording_that_was_cut_off_is_read_as_far_as_it_goes(recording):
    text = recording.read_text()
    recording.write_text(text[:-20])
    assert len(read_recording(recording).moments) == 29


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "not a recording"),
        ("{}\n", "not a recording"),
        ('{"format": "other", "robots": [], "room": ""}\n', "the format is 'other'"),
        (json.dumps({"format": "gspn_world_1", "robots": ["a"], "room": "walls: 1"}), "run.jsonl"),
        (
            json.dumps({"format": "gspn_world_1", "robots": ["a"], "room": ROOM_TEXT})
            + "\n[0.1, [[0,0,0],[1,1,0]]]\n",
            "run.jsonl:2: not a recording of a world: 2 poses of 1 robots",
        ),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, text, words):
    file = tmp_path / "run.jsonl"
    file.write_text(text)
    with pytest.raises(InputError) as refused:
        read_recording(file)
    assert words in str(refused.value)


def test_a_recorded_run_becomes_pictures_in_a_folder(recording, tmp_path, capsys):
    folder = tmp_path / "pictures"
    words = [
        "film",
        str(folder),
        "--recording",
        str(recording),
        "--size",
        "160x120",
        "--view",
        "top",
    ]
    assert main([*words, "--speed", "10", "--rate", "10", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["pictures"] == 4
    frames = sorted(folder.iterdir())
    assert [frame.name for frame in frames] == ["frame_%05d.png" % n for n in (1, 2, 3, 4)]
    first, last = (np.asarray(Image.open(frame)).astype(int) for frame in (frames[0], frames[-1]))
    assert first.shape == (120, 160, 3)
    assert (abs(first - last).max(axis=2) > 60).sum() > 10  # the robot has moved


@pytest.mark.parametrize("kind", [".gif", ".webp", ".mp4"])
def test_a_film_file_has_all_pictures(kind, tmp_path):
    if kind == ".mp4" and find_ffmpeg() is None:
        pytest.skip("no ffmpeg here")
    target = tmp_path / ("film" + kind)
    film = Film(target, 64, 48, 10)
    for level in (0, 120, 240):
        film.add(Image.new("RGB", (64, 48), (level, 0, 255 - level)))
    film.close()
    if kind == ".mp4":
        words = [str(find_ffmpeg()), "-i", str(target), "-f", "framemd5", "-"]
        listed = subprocess.run(
            words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True
        )
        assert len([line for line in listed.stdout.splitlines() if not line.startswith(b"#")]) == 3
    else:
        assert Image.open(target).n_frames == 3


@pytest.mark.parametrize(
    "words, said",
    [
        (["film.avi"], "not a film format"),
        (["/no/such/folder/film.gif"], "the folder does not exist"),
        (["pictures", "--size", "huge"], "--size"),
        (["pictures", "--speed", "0"], "argument --speed: '0' is not a number above 0"),
        (["pictures", "--recording", "/no/such/file"], "cannot read the recording"),
        (["pictures", "--robots", "9"], "only 8 robots"),
    ],
)
def test_wrong_wishes_are_told_and_exit_with_2(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["film", *words]) == 2
    assert said in capsys.readouterr().err


def test_mp4_without_ffmpeg_says_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setattr("gspn_framework_package.world.film.find_ffmpeg", lambda: None)
    with pytest.raises(InputError, match="needs ffmpeg"):
        Film(tmp_path / "film.mp4", 64, 48, 10)


def test_a_simulated_patrol_is_filmed_from_a_bare_checkout(tmp_path):
    words = [
        "film",
        str(tmp_path / "film.gif"),
        "--robots",
        "2",
        "--seconds",
        "4",
        "--size",
        "120x90",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "gspn_framework_package", *words],
        cwd=str(Path(__file__).resolve().parents[3]),
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert done.returncode == 0, done.stderr
    assert "pictures in" in done.stdout
    assert Image.open(tmp_path / "film.gif").n_frames >= 8
