"""A log belongs to one node."""

import os

import pytest

from gspn_framework_package.model.errors import LogError
from gspn_framework_package.team import log_file


def test_a_log_is_held_by_one_node(tmp_path, monkeypatch):
    monkeypatch.setattr(log_file, "LOCK_TIME", 0.3)
    path = str(tmp_path / "monday" / "robot_1.jsonl")
    held = log_file.lock_log(path)
    with pytest.raises(LogError, match="another node is writing to this log"):
        log_file.lock_log(path)
    held.close()
    log_file.lock_log(path).close()
    assert os.path.getsize(path) == 0


def test_a_folder_that_cannot_be_made_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError, match="cannot be written"):
        log_file.lock_log(str(tmp_path / "file" / "robot_1.jsonl"))
