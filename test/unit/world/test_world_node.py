"""The program of the world where PyBullet is not installed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parents[3] / "scripts" / "world_node"


def test_a_missing_pybullet_is_told_without_a_traceback(tmp_path):
    pytest.importorskip("rospy")
    (tmp_path / "pybullet.py").write_text(
        "raise ModuleNotFoundError('No module named pybullet', name='pybullet')"
    )
    path = os.pathsep.join(
        [str(tmp_path), os.environ.get("PYTHONPATH", ""), str(PROGRAM.parents[1])]
    )
    done = subprocess.run(
        [sys.executable, str(PROGRAM)],
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=60,
    )
    assert done.returncode == 1
    assert "no Python library 'pybullet'" in done.stdout and "world:=none" in done.stdout
    assert "Traceback" not in done.stdout
