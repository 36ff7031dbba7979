"""``gspn export``: recorded runs as messages that other tools read."""

import csv
import json
import os

import jsonschema
import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.event_log import LogFile
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_messages import ROBOT_STATES
from gspn_framework_package.formats.message_files import MESSAGE_KINDS, definition, ros_type_name
from gspn_framework_package.ros.recorded_messages import recorded_messages

PACKAGE = "gspn_framework_package"

PANEL = {"type": "string", "pattern": "^(StateTransitions|Plot|RawMessages)![a-z]+$"}

LAYOUT = {
    "type": "object",
    "required": ["configById", "globalVariables", "userNodes", "playbackConfig", "layout"],
    "additionalProperties": False,
    "properties": {
        "configById": {
            "type": "object",
            "propertyNames": PANEL,
            "additionalProperties": {
                "type": "object",
                "properties": {
                    "paths": {
                        "type": "array",
                        "minItems": 1,
                        "items": {
                            "type": "object",
                            "required": ["value", "timestampMethod"],
                            "properties": {
                                "value": {"type": "string", "pattern": "^/"},
                                "timestampMethod": {"enum": ["receiveTime", "headerStamp"]},
                            },
                        },
                    },
                    "topicPath": {"type": "string", "pattern": "^/"},
                },
            },
        },
        "globalVariables": {"type": "object"},
        "userNodes": {"type": "object"},
        "playbackConfig": {"type": "object"},
        "layout": {"$ref": "#/definitions/tree"},
    },
    "definitions": {
        "tree": {
            "anyOf": [
                PANEL,
                {
                    "type": "object",
                    "required": ["direction", "first", "second", "splitPercentage"],
                    "properties": {
                        "direction": {"enum": ["row", "column"]},
                        "first": {"$ref": "#/definitions/tree"},
                        "second": {"$ref": "#/definitions/tree"},
                    },
                },
            ]
        }
    },
}
"""The form of the layouts that Foxglove exports, as far as ours use it."""


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = str(tmp_path_factory.mktemp("run") / "patrol.jsonl")
    assert main(["simulate", "plans/patrol", "--time", "200", "--seed", "3", "--log", path]) == 0
    return path


def messages(*paths):
    return list(recorded_messages([LogFile(path) for path in paths]))


def test_the_messages_follow_the_log(log):
    found = messages(log)
    with open(log, encoding="utf-8") as file:
        records = [json.loads(line) for line in file]
    firings = [f for record in records if record["kind"] == "slot" for f in record["firings"]]
    fired = [m.fields for m in found if m.kind == "FiredTransition"]
    assert [f["transition"] for f in fired] == [f["transition"] for f in firings]
    assert [m.time for m in found] == sorted(m.time for m in found)
    assert found[0].time == pytest.approx(records[1]["wall"])
    # the last marking is that after the last firing
    marking = [m.fields for m in found if m.kind == "Marking"][-1]
    counts = dict(zip(marking["places"], marking["counts"]))
    assert {p: n for p, n in counts.items() if n} == firings[-1]["marking"]
    # and each robot is where the last firing that moved it put it
    last = {robot: to for f in firings for robot, _, to, _ in f["moves"]}
    team = [m.fields for m in found if m.kind == "TeamState"][-1]
    assert {r["robot"]: r["place"] for r in team["robots"]} == last
    assert team["ended"] and {r["state_name"] for r in team["robots"]} == {"Inactive"}


def test_what_did_not_change_is_not_repeated(log):
    told = {}
    for message in messages(log):
        if message.kind != "FiredTransition":
            new = {k: v for k, v in message.fields.items() if k != "slot"}
            assert told.get(message.topic) != new
            told[message.topic] = new
    assert set(told) == {"/marking", "/team_state"} | {
        "/robot_%d/robot_activity" % n for n in (1, 2, 3, 4)
    }


def test_a_layout_for_foxglove_shows_topics_and_fields_that_are_there(log, tmp_path):
    path = tmp_path / "layout.json"
    assert main(["export", log, "--foxglove-layout", str(path)]) == 0
    layout = json.loads(path.read_text())
    jsonschema.validate(layout, LAYOUT)

    def panels(tree):
        return [tree] if isinstance(tree, str) else panels(tree["first"]) + panels(tree["second"])

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    kinds = {m.topic: (m.kind, m.fields) for m in messages(log)}
    seen = set()
    for config in layout["configById"].values():
        for value in [p["value"] for p in config.get("paths", [])] + [config.get("topicPath")]:
            if value is not None:
                topic, _, field = value.partition(".")
                name, _, at = field.partition("[")
                fields = kinds[topic][1]
                assert not name or name in fields
                assert not at or int(at.rstrip("]")) < len(fields[name])
                seen.add(topic)
    assert seen == set(kinds)


def test_every_reported_state_has_a_number_in_the_message():
    constants = dict(
        line.split("#")[0].split()[1].split("=")
        for line in definition("RobotActivity").splitlines()
        if line.startswith("uint8 ") and "=" in line
    )
    assert {name: int(number) for name, number in constants.items()} == {
        state.upper() or "UNKNOWN": number for number, state in enumerate(ROBOT_STATES)
    }
    assert {phase.report.state for phase in Phase} == set(ROBOT_STATES) - {"Done"} | {
        phase.report.state for phase in Phase if phase is Phase.DONE
    }


def test_files_for_other_tools(log, tmp_path, capsys):
    paths = {kind: str(tmp_path / ("run." + kind)) for kind in ("bag", "mcap", "csv")}
    options = [part for kind, path in paths.items() for part in ("--" + kind, path)]
    assert main(["export", log, *options, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    expected = messages(log)
    assert sum(told["messages"].values()) == len(expected)
    _compare_bag(paths["bag"], expected)
    _compare_mcap(paths["mcap"], expected)
    with open(paths["csv"], newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    robots = [m for m in expected if m.kind == "RobotActivity"]
    assert [(row["robot"], row["place"], row["state"]) for row in rows] == [
        (m.fields["robot"], m.fields["place"], m.fields["state_name"]) for m in robots
    ]
    assert float(rows[5]["time"]) == pytest.approx(robots[5].time)
    assert sorted(os.listdir(tmp_path)) == ["run.bag", "run.csv", "run.mcap"]


def _compare_bag(path, expected):
    from rosbags.rosbag1 import Reader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Reader(path) as bag:
        for connection in bag.connections:  # what a reader knows of the types is in the file
            store.register(get_types_from_msg(_definition(connection), connection.msgtype))
        read = [
            (
                connection.topic,
                connection.msgtype,
                at,
                store.deserialize_ros1(data, connection.msgtype),
            )
            for connection, at, data in bag.messages()
        ]
    assert sorted((topic, kind, at) for topic, kind, at, _ in read) == sorted(
        (m.topic, ros_type_name(m.kind), round(m.time * 1e9)) for m in expected
    )
    for topic in {
        topic for topic, _, _, _ in read
    }:  # each topic is numbered, whatever else is written
        numbers = [m.header.seq for of, _, _, m in read if of == topic]
        assert numbers == list(range(len(numbers)))
    marking = [m for _, kind, _, m in read if kind.endswith("/Marking")][-1]
    fields = [m.fields for m in expected if m.kind == "Marking"][-1]
    assert (list(marking.places), list(marking.counts)) == (fields["places"], fields["counts"])


def _definition(connection):
    text = connection.msgdef
    return text if isinstance(text, str) else text.data


def _compare_mcap(path, expected):
    from mcap.reader import make_reader

    with open(path, "rb") as file:
        read = [(c.topic, s.name, m.log_time) for s, c, m in make_reader(file).iter_messages()]
    assert sorted(read) == sorted(
        (m.topic, "%s/%s" % (PACKAGE, m.kind), round(m.time * 1e9)) for m in expected
    )


def test_the_types_are_those_of_ros():
    messages = pytest.importorskip("gspn_framework_package.msg")
    from gspn_framework_package.formats.message_files import Encoder

    store = Encoder().store
    for kind in MESSAGE_KINDS:
        md5 = store.generate_msgdef(ros_type_name(kind), ros_version=1)[1]
        assert md5 == getattr(messages, kind)._md5sum


def test_several_logs_of_a_run_each_tell_of_their_own_robot(log, tmp_path):
    own = str(tmp_path / "robot_2.jsonl")
    with open(log, encoding="utf-8") as file, open(own, "w", encoding="utf-8") as copy:
        header = json.loads(next(file))
        copy.write(json.dumps({**header, "robot": "robot_2"}, separators=(",", ":")) + "\n")
        for line in list(file)[:-5]:
            record = json.loads(line)
            # a moment later than the other log, and not a whole multiple of anything there
            record["wall"] += 0.0625
            copy.write(json.dumps(record, separators=(",", ":")) + "\n")
    whole, both = messages(log), messages(log, own)
    assert sum(m.kind == "FiredTransition" for m in both) == sum(
        m.kind == "FiredTransition" for m in whole
    )
    own_times = {m.time for m in both if m.topic == "/robot_2/robot_activity"}
    assert own_times and not own_times & {m.time for m in whole}


@pytest.mark.parametrize("option", ["--bag", "--mcap", "--csv"])
def test_nothing_is_left_of_a_log_that_cannot_be_followed(log, tmp_path, capsys, option):
    damaged = tmp_path / "damaged.jsonl"
    with open(log, encoding="utf-8") as file:
        lines = file.readlines()
    damaged.write_text("".join(lines[:9] + lines[10:]), encoding="utf-8")
    assert main(["export", str(damaged), option, str(tmp_path / "out")]) != 0
    assert "damaged.jsonl" in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["damaged.jsonl"]


@pytest.mark.parametrize(
    "options, says",
    [
        ([], "nothing to write"),
        (["--csv", "run.csv", "--bag", "run.csv"], "same name"),
        (["--csv", "missing/run.csv"], "cannot be written"),
        (["--bag", "missing/run.bag"], "cannot be written"),
        (["--mcap", "missing/run.mcap"], "cannot be written"),
        (["--csv", "there.csv"], "exists already"),
    ],
)
def test_what_cannot_be_written_is_refused(log, tmp_path, monkeypatch, capsys, options, says):
    (tmp_path / "there.csv").write_text("mine")
    monkeypatch.chdir(tmp_path)
    assert main(["export", log, *options]) == 2
    assert says in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["there.csv"] and (tmp_path / "there.csv").read_text() == "mine"


def test_a_missing_library_is_named(log, tmp_path, monkeypatch, capsys):
    import builtins

    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name.startswith("rosbags"):
            raise ModuleNotFoundError("No module named 'rosbags'", name="rosbags")
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    assert main(["export", log, "--bag", str(tmp_path / "run.bag")]) == 2
    error = capsys.readouterr().err
    assert "'rosbags' is not installed" in error and "pip install" in error
