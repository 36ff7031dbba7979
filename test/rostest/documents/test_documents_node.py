#!/usr/bin/env python3
"""Every command in the documents that speaks to a running team does so, against one; every launch file that they name
is evaluated with the arguments that they give."""

import os
import pty
import subprocess
import sys
import unittest

import rosgraph

HERE = os.path.dirname(os.path.realpath(__file__))
TEST = os.path.dirname(os.path.dirname(HERE))
sys.path[:0] = [os.path.join(TEST, "unit"), os.path.join(os.path.dirname(HERE), "support")]

from document_commands import ROOT, Command, documents, steps  # noqa: E402
from waiting import wait_for  # noqa: E402

PACKAGE = "gspn_framework_package"

WITHOUT_END = ("rostopic echo", "rostopic hz")
"""They print until they are stopped: what counts is that they print."""

ORDERS_TRIED_ELSEWHERE = ("evict", "force-evict", "leave", "stop")
"""They would end the team that the other commands need: test/rostest/services and faults try them."""


class Documents(unittest.TestCase):
    """Against the team that the .test file starts."""

    @classmethod
    def setUpClass(cls):
        master = rosgraph.Master("/documents")

        def fired():
            topics = {name for name, _ in master.getPublishedTopics("/")}
            return "/robot_3/activity" in topics and "/fired_transitions" in topics

        wait_for(fired, 60, "the team")
        shown = subprocess.run(
            ["rostopic", "echo", "-n", "1", "/fired_transitions"], stdout=subprocess.DEVNULL, timeout=60
        )
        assert shown.returncode == 0

    def commands(self, *starts):
        found = []
        for document in documents():
            for step in steps(document):
                if isinstance(step, Command) and step.line.startswith(starts):
                    found.append(step)
        self.assertTrue(found, starts)
        return found

    def test_service_calls(self):
        for command in self.commands("rosservice call"):
            with self.subTest(str(command)):
                answer = self.run_to_the_end(command.line)
                self.assertNotIn("success: False", answer)

    def test_topics(self):
        for command in self.commands("rostopic"):
            with self.subTest(str(command)):
                if command.line.startswith(WITHOUT_END) and " -n " not in command.line:
                    self.sees_output(command.line)
                else:
                    self.run_to_the_end(command.line)

    def test_programs(self):
        for command in self.commands("rosrun %s" % PACKAGE):
            if command.words[3] not in ORDERS_TRIED_ELSEWHERE:
                with self.subTest(str(command)):
                    self.run_to_the_end(command.line)

    def test_launch_files(self):
        """Their nodes are named, which evaluates every argument and every included file."""
        for command in self.commands("roslaunch"):
            with self.subTest(str(command)):
                listed = "" if "--ros-args" in command.line else " --nodes"
                output = self.run_to_the_end(command.line.replace("roslaunch", "roslaunch" + listed, 1))
                self.assertTrue(output.strip())

    # -- helpers ---------------------------------------------------------------------------------

    def run_to_the_end(self, line):
        master, slave = pty.openpty()  # rosservice asks for arguments where it reads from a terminal
        try:
            ended = subprocess.run(
                ["bash", "-c", line], cwd=str(ROOT), stdin=slave, stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT, text=True, timeout=60,
            )  # fmt: skip
        finally:
            os.close(master)
            os.close(slave)
        self.assertEqual(ended.returncode, 0, "%s\n%s" % (line, ended.stdout))
        return ended.stdout

    def sees_output(self, line):
        with subprocess.Popen(
            ["bash", "-c", "exec " + line], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            universal_newlines=True,
        ) as running:  # fmt: skip
            try:
                text = ""
                while "transition:" not in text and "average rate" not in text:
                    read = running.stdout.readline()
                    self.assertTrue(read, "%s ended: %s" % (line, text))
                    text += read
            finally:
                running.terminate()


if __name__ == "__main__":
    import rostest

    rostest.rosrun(PACKAGE, "documents", Documents)
