"""The key that a team makes for its run."""

from __future__ import annotations

import os
import stat
import threading

import pytest

from gspn_framework_package.model.errors import KeysError
from gspn_framework_package.team.run_key import find_run_key, make_run_key, run_key_file


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_HOME", str(tmp_path))


def test_robots_that_start_together_share_one_key_that_only_the_owner_reads():
    made = []
    robots = [threading.Thread(target=lambda: made.append(make_run_key("work"))) for _ in range(8)]
    for robot in robots:
        robot.start()
    for robot in robots:
        robot.join()
    assert {path for path, _ in made} == {run_key_file("work")}
    assert [is_new for _, is_new in made].count(True) == 1
    assert stat.S_IMODE(os.stat(run_key_file("work")).st_mode) == 0o600
    assert os.listdir(os.path.dirname(run_key_file("work"))) == ["team.key"]
    first = find_run_key("work")
    assert first.code("text") == find_run_key("work").code("text")
    assert make_run_key("play")[1] and find_run_key("play").code("text") != first.code("text")


def test_no_key_is_found_where_there_is_none_or_others_may_read_it():
    assert find_run_key("work") is None
    path, _ = make_run_key("work")
    os.chmod(path, 0o644)
    assert find_run_key("work") is None
    make_run_key("..")
    assert find_run_key("../..") is None, "what a robot calls its run is no path"


def test_a_key_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "gspn").write_text("")
    with pytest.raises(KeysError, match="cannot be written"):
        make_run_key("work")
