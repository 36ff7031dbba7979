"""What a node says of its plan before it starts."""

import json
import os
import subprocess
import sys

import pytest

pytest.importorskip("rospy")

from gspn_framework_package.analysis.preflight.report import CheckItem, PreflightReport, Severity
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.ros.node_main import check_plan
from gspn_framework_package.team import plan_examination, verdict
from gspn_framework_package.team.own_process import in_own_process


def test_findings_of_one_kind_are_one_warning(monkeypatch):
    items = [
        CheckItem(*item)
        for item in (
            ("policy", Severity.WARNING, "no row for A", {}),
            ("policy", Severity.WARNING, "no row for B", {}),
            ("initial", Severity.OK, "as it should be", {}),
            ("servers", Severity.WARNING, "two in T", {}),
        )
    ]
    report = PreflightReport("rendezvous", tuple(items), 0, True, 0.0)
    monkeypatch.setattr(verdict, "check", lambda plan: report)
    monkeypatch.setattr(plan_examination, "in_own_process", lambda function, plan: function(plan))
    warnings = []
    check_plan(read_plan("plans/rendezvous"), warnings.append)
    assert warnings == [
        "rendezvous: policy: no row for A (and 1 more of this kind: see 'gspn check')",
        "rendezvous: servers: two in T",
    ]


def test_the_losses_of_a_plan_are_one_warning():
    warnings = []
    check_plan(read_plan("plans/rendezvous"), warnings.append)
    (warning,) = warnings
    assert warning.startswith("rendezvous: dead_after_loss: when a robot is lost")


def test_a_plan_of_which_nothing_is_to_be_said_gets_no_warning():
    check_plan(read_plan("plans/patrol"), pytest.fail)


PACKAGE = "gspn_framework_package."

OF_A_ROBOT = """
import sys
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.ros import execution_node, node_main, place_servers
from gspn_framework_package.ros.transport import master_watch
from gspn_framework_package.team import agent, plan_examination

plan = read_plan("plans/patrol")
plan_examination.check_plan(plan, print)
plan_examination.why_refused_in_own_process(plan)
print("imported", *sys.modules)
"""


def test_the_process_of_a_robot_has_no_analysis():
    """Each of them would take 15 MB more."""
    done = subprocess.run(
        [sys.executable, "-c", OF_A_ROBOT], stdout=subprocess.PIPE, text=True, check=True
    )
    imported = done.stdout.split()
    assert PACKAGE + "team.host" in imported
    assert [n for n in imported if n.startswith((PACKAGE + "analysis", "scipy", "numba"))] == []
    of_others = (PACKAGE + "visualizer", PACKAGE + "cli", PACKAGE + "benchmark")
    assert [n for n in imported if n.startswith(of_others)] == []


OF_A_PLAN_IN_JSON = """
import sys
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.ros import execution_node, node_main

read_plan(sys.argv[1])
print("imported", *sys.modules)
"""


def test_robots_of_a_plan_without_xml_have_no_reader_of_xml(tmp_path):
    """It would take 5 MB of a team."""
    net = {"places": [{"name": "P", "tokens": 1}], "transitions": [], "arcs": []}
    plan = tmp_path / "plan.json"
    plan.write_text(json.dumps({"plan": "p", "net": net, "actions": {"P": None}}))
    done = subprocess.run(
        [sys.executable, "-c", OF_A_PLAN_IN_JSON, str(plan)],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    imported = done.stdout.split()
    assert PACKAGE + "ros.execution_node" in imported
    assert [n for n in imported if n.startswith("lxml")] == []


AFTER_THE_FORK = """
import sys
import rosgraph.roslogging
from gspn_framework_package.ros import node_main

before = set(sys.modules)
node_main.share_log_configuration()
rosgraph.roslogging.configure_logging("rosout")
import benchmarks.load

print("imported", *set(sys.modules) - before)
"""


def test_robots_import_nothing_that_they_could_share(tmp_path):
    """What rospy imports when a node starts took 1 MB of each robot; what the package of the
    benchmarks imported, 2 MB of each of theirs."""
    done = subprocess.run(
        [sys.executable, "-c", AFTER_THE_FORK],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        env={**os.environ, "ROS_LOG_DIR": str(tmp_path)},
    )
    imported = set(done.stdout.splitlines()[-1].split()[1:])
    assert imported == {"benchmarks", "benchmarks.load"}


def _end_at_once(code):
    print("not a result")
    os._exit(code)


def _refuse():
    raise ExecutionError("it cannot", hint="do something else")


def test_what_a_process_of_its_own_raises_is_raised_here():
    with pytest.raises(ExecutionError, match=r"it cannot \(do something else\)"):
        in_own_process(_refuse)


def test_a_process_that_ends_without_a_result_is_an_error():
    with pytest.raises(ExecutionError, match="end_at_once ended with exit code 3"):
        in_own_process(_end_at_once, 3)
