#!/usr/bin/env python3
"""The rostest that ``gspn new`` writes, in a folder that is in no package and whose name is none:
it passes, and fails when the team does not do what it should."""

import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path[:0] = [os.path.join(os.path.dirname(HERE), "support")]

from waiting import PATIENCE

from gspn_framework_package.making import templates

FOLDER = "2nd team's rönd"


def change(path, old, new):
    """Write a file anew, with one text in the place of another."""
    text = path.read_text(encoding="utf-8")
    assert text.count(old) == 1, text
    path.write_text(text.replace(old, new), encoding="utf-8")


class NewPlan(unittest.TestCase):
    def setUp(self):
        home = tempfile.TemporaryDirectory()
        self.addCleanup(home.cleanup)
        self.home = Path(home.name)
        templates.write("patrol", str(self.home / FOLDER))
        (self.file,) = (self.home / FOLDER).glob("rostest_*.py")
        (launch,) = (self.home / FOLDER).glob("*.test")
        change(self.file, "SECONDS = 60.0", "SECONDS = %g" % (60 * PATIENCE))
        change(launch, 'time-limit="180"', 'time-limit="%g"' % (180 * PATIENCE))

    def run_it(self):
        """As README.md says."""
        readme = (self.home / FOLDER / "README.md").read_text(encoding="utf-8")
        (line,) = [line for line in readme.splitlines() if line.startswith("rostest")]
        return subprocess.run(
            ["bash", "-c", line],
            cwd=str(self.home),
            env={**os.environ, "ROS_HOME": str(self.home / "ros")},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=200 * PATIENCE,
        )

    def test_it_passes(self):
        ended = self.run_it()
        self.assertEqual(ended.returncode, 0, ended.stdout)
        self.assertIn("TESTS: 1", ended.stdout)

    def test_it_fails_if_the_team_does_not_do_what_is_promised(self):
        change(self.file, "'looked_B'", "'looked_nowhere'")
        change(self.file, "SECONDS = %g" % (60 * PATIENCE), "SECONDS = %g" % (15 * PATIENCE))
        ended = self.run_it()
        self.assertNotEqual(ended.returncode, 0, ended.stdout)
        self.assertIn("no {'looked_nowhere'}", ended.stdout)
        self.assertIn("FAILURES: 1", ended.stdout)


if __name__ == "__main__":
    import rostest

    rostest.rosrun("gspn_framework_package", "new", NewPlan)
