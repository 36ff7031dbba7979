#!/usr/bin/env python3
"""Every command in the documents that speaks to a running team does so, against one; every launch
file that they name is evaluated with the arguments that they give."""

import os
import pty
import re
import socket
import subprocess
import sys
import tempfile
import traceback
import unittest
from contextlib import ExitStack, contextmanager
from pathlib import Path

import rosgraph
from roslaunch.config import ROSLaunchConfig
from roslaunch.node_args import get_node_list
from roslaunch.rlutil import resolve_launch_arguments
from roslaunch.xmlloader import XmlLoader

HERE = os.path.dirname(os.path.realpath(__file__))
TEST = os.path.dirname(os.path.dirname(HERE))
sys.path[:0] = [os.path.join(TEST, "unit"), os.path.join(os.path.dirname(HERE), "support")]

from document_commands import ROOT, Command, File, documents, steps
from terminal import Terminal
from waiting import PATIENCE, wait_for

PACKAGE = "gspn_framework_package"

WITHOUT_END = ("rostopic echo", "rostopic hz")
"""They print until they are stopped: what counts is that they print."""

ORDERS_TRIED_ELSEWHERE = ("deploy", "evict", "force-evict", "leave", "retry", "stop")
"""They would end the team that the other commands need, or need a robot that failed, or a plan of
one's own: test/rostest/deploy, services, failures and faults try them."""


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
            ["rostopic", "echo", "-n", "1", "/fired_transitions"],
            stdout=subprocess.DEVNULL,
            timeout=60 * PATIENCE,
        )
        assert shown.returncode == 0

    def commands(self, *starts):
        """Each once, in however many documents it is."""
        found = {}
        for document in documents():
            for step in steps(document):
                if isinstance(step, Command) and step.line.startswith(starts):
                    found.setdefault(step.line, step)
        self.assertTrue(found, starts)
        return list(found.values())

    @contextmanager
    def trying(self, command):
        """As ``subTest``, whose failures rosunit counts but does not show."""
        with self.subTest(str(command)):
            try:
                yield
            except Exception:
                print("%s failed:" % command, traceback.format_exc(), flush=True)
                raise

    def test_service_calls(self):
        for command in self.commands("rosservice call"):
            if command.words[2].startswith("/world/"):
                continue  # there is no room here: test/rostest/world tries them
            with self.trying(command):
                answer = self.run_to_the_end(command.line)
                self.assertNotIn("success: False", answer)

    def test_topics(self):
        for command in self.commands("rostopic"):
            with self.trying(command):
                if command.line.startswith(WITHOUT_END) and " -n " not in command.line:
                    self.sees_output(command.line)
                else:
                    self.run_to_the_end(command.line)

    def test_programs(self):
        for command in self.commands("rosrun %s" % PACKAGE):
            if command.words[3] not in ORDERS_TRIED_ELSEWHERE:
                with self.trying(command):
                    self.run_to_the_end(command.line)
        self.run_to_the_end("rosrun %s gspn resume" % PACKAGE)  # one of them pauses the team

    def test_launch_files(self):
        """Their nodes are named, which evaluates every argument and every included file: as
        ``roslaunch --nodes`` does, but without a process for each."""
        for command in self.commands("roslaunch"):
            with self.trying(command):
                words = self.run_to_the_end("printf '%s\\n' " + command.line).splitlines()
                (file,) = resolve_launch_arguments(words[1:])  # without the arguments
                config = ROSLaunchConfig()
                loader = XmlLoader()
                loader.ignore_unset_args = False  # as roslaunch does before it loads
                loader.load(file, config, argv=words, verbose=False)
                self.assertTrue(get_node_list(config))

    def test_own_robots_typed_in_terminals(self):
        """The document's two robots, each launched in its own terminal, with a master of their
        own."""
        lines = [s.line for s in steps(ROOT / "docs/own_robots.md") if isinstance(s, Command)]
        launches = [line for line in lines if "robot.launch" in line][:2]
        self.assertEqual(
            [re.findall(r"robot:=(\w+)", line) for line in launches], [["robot_1"], ["robot_2"]]
        )
        with tempfile.TemporaryDirectory() as home, ExitStack() as stack:
            self.write_greenhouse(Path(home))
            with socket.socket() as free:
                free.bind(("localhost", 0))
                master = "http://localhost:%d" % free.getsockname()[1]
            environment = {
                **os.environ,
                "HOME": home,
                "ROS_HOME": home + "/.ros",
                "ROS_MASTER_URI": master,
            }
            teams = [stack.enter_context(Terminal(Path(home), environment)) for _ in launches]
            for number, (terminal, line) in enumerate(zip(teams, launches), 1):
                terminal.begin(line)
                terminal.shows(r"process\[robot_%d/executor-\d+\]: started" % number)
            teams[1].shows(r"robot_2: does ")
            operator = stack.enter_context(Terminal(Path(home), environment))
            (question,) = [
                line for line in lines if line.startswith("rosservice call /robot_2/get_place")
            ]
            code, text = operator.type(question)
            self.assertEqual(code, 0, text)
            self.assertRegex(text, r"Water|Look|Refill")
            (listening,) = [line for line in lines if line.startswith("rostopic hz")]
            operator.begin(listening)
            operator.shows("average rate")
            operator.interrupt()
            for terminal in [operator, *reversed(teams)]:  # the first has the master
                if terminal is not operator:
                    terminal.interrupt()
                code, text = terminal.end()
                self.assertEqual(code, 0, text)
                self.assertNotIn("Traceback", text)

    # -- helpers ---------------------------------------------------------------------------------

    def write_greenhouse(self, home):
        """The plan of the first document, with time to look around, as it says."""
        (home / "greenhouse").mkdir()
        for step in steps(ROOT / "docs/first_plan.md"):
            if isinstance(step, File):
                text = step.text.replace("Watered >= 12", "Watered >= 1000")
                (home / step.path).write_text(text, encoding="utf-8")

    def run_to_the_end(self, line):
        # rosservice asks for arguments where it reads from a terminal
        master, slave = pty.openpty()
        try:
            ended = subprocess.run(
                ["bash", "-c", line],
                cwd=str(ROOT),
                stdin=slave,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=60 * PATIENCE,
            )
        finally:
            os.close(master)
            os.close(slave)
        self.assertEqual(ended.returncode, 0, "%s\n%s" % (line, ended.stdout))
        return ended.stdout

    def sees_output(self, line):
        with subprocess.Popen(
            ["bash", "-c", "exec " + line],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            universal_newlines=True,
        ) as running:
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
