"""Tasks that are given by hand: ``gspn submit`` and the command ``submit``."""

import json

import pytest

pytest.importorskip("gspn_framework_package.srv")

from gspn_framework_package.cli.main import main
from gspn_framework_package.cli.orders import read_data
from gspn_framework_package.execution.log_entries import Submit
from gspn_framework_package.model.errors import DataError, GspnError
from gspn_framework_package.team.orders import ORDERS


def submitted(argument):
    kind = ORDERS["submit"]
    return kind.entry(**kind.read("", argument, "robot_1"))


def test_the_command_takes_a_task():
    argument = json.dumps({"transition": "order", "id": "o1", "data": {"pose": [1, 2]}})
    assert submitted(argument) == Submit("order", "o1", {"pose": [1, 2]})


def test_a_task_without_an_id_gets_a_new_one():
    first, second = (submitted('{"transition": "order"}') for _ in range(2))
    assert first.id and first.id != second.id
    assert first.data == {}


@pytest.mark.parametrize(
    "argument",
    [
        "",
        "order",
        "[]",
        "{}",
        '{"transition": ""}',
        '{"transition": 3}',
        '{"transition": "order", "data": [1]}',
        '{"transition": "order", "data": {"not a name": 1}}',
        '{"transition": "order", "data": {"x": NaN}}',
        '{"transition": "order", "id": [1]}',
        '{"transition": "order", "id": "%s"}' % ("x" * 201),
        '{"transition": "order", "pose": 1}',
        "[" * 100_000,
    ],
)
def test_what_is_no_task_is_refused(argument):
    with pytest.raises(DataError):
        submitted(argument)


def test_data_are_json_or_the_name_of_a_file(tmp_path, monkeypatch, capsys):
    path = tmp_path / "task.json"
    path.write_text('{"pose": [1, 2]}')
    assert read_data(str(path)) == read_data(' {"pose": [1, 2]}') == {"pose": [1, 2]}
    path.write_bytes(b"\xff")
    for text in (str(path), str(tmp_path), "no such file", "{", '{"a": 1} x'):
        with pytest.raises(GspnError):
            read_data(text)
    path.write_text("[1]")
    assert main(["submit", "order", "--data", str(path)]) == 2
    assert "%s: is not a JSON object but [1]\n" % path in capsys.readouterr().err
    assert main(["submit", "order", "--data", '{"id": 1}']) == 2
    assert "'id' is not a valid name for a task's data" in capsys.readouterr().err
