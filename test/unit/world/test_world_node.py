"""The program of the world where PyBullet is not installed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE

PROGRAM = Path(__file__).parents[3] / "scripts" / "world_node"


@pytest.fixture(name="program")
def _program(tmp_path):
    """Runs the program in a Python that finds no PyBullet."""
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.modules['pybullet'] = None\n")
    path = os.pathsep.join(
        [str(tmp_path), os.environ.get("PYTHONPATH", ""), str(PROGRAM.parents[1])]
    )

    def start(*arguments):
        return subprocess.Popen(
            [sys.executable, str(PROGRAM), *arguments],
            env={**os.environ, "PYTHONPATH": path},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    return start


def test_without_pybullet_the_program_says_so_and_fails(program):
    world = program()
    said = world.communicate(timeout=60 * PATIENCE)[0]
    assert world.returncode == 1
    assert "'pybullet' is not installed" in said and said.count("\n") == 1


def test_an_optional_world_says_in_one_line_that_there_is_no_room_and_waits(program):
    world = program("--optional", "__name:=world")
    assert "There is no simulated room" in world.stdout.readline()
    world.send_signal(2)
    assert world.communicate(timeout=60 * PATIENCE)[0] == "" and world.returncode == -2


def test_a_launch_file_can_ask_whether_there_can_be_a_room(program):
    assert program("--if-possible", "a room", "").communicate(timeout=60 * PATIENCE)[0] == ""
    assert (
        program("--if-possible", "true", "false").communicate(timeout=60 * PATIENCE)[0] == "false"
    )
