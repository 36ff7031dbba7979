"""What a node says of its plan before it starts."""

import pytest

pytest.importorskip("rospy")

from gspn_framework_package.analysis import preflight
from gspn_framework_package.analysis.preflight.report import CheckItem, PreflightReport, Severity
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.ros.node_main import check_plan


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
    monkeypatch.setattr(preflight, "check", lambda plan: report)
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
