"""A log belongs to one node."""

import os

import pytest

pytest.importorskip("rospy")
pytest.importorskip("gspn_framework_package.msg")

from gspn_framework_package.model.errors import LogError
from gspn_framework_package.ros import execution_node


def test_a_log_is_held_by_one_node(tmp_path, monkeypatch):
    monkeypatch.setattr(execution_node, "LOCK_TIME", 0.3)
    path = str(tmp_path / "monday" / "robot_1.jsonl")
    held = execution_node.lock_log(path)
    with pytest.raises(LogError, match="another node is writing this log"):
        execution_node.lock_log(path)
    held.close()
    execution_node.lock_log(path).close()
    assert os.path.getsize(path) == 0


def test_a_folder_that_cannot_be_made_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError, match="cannot be written"):
        execution_node.lock_log(str(tmp_path / "file" / "robot_1.jsonl"))
