"""What a node says of its plan before it starts."""

import pytest

pytest.importorskip("rospy")

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.ros.node_main import check_plan


def test_findings_of_one_kind_are_one_warning():
    warnings = []
    check_plan(read_plan("plans/rendezvous"), warnings.append)
    (warning,) = warnings
    assert warning.startswith("rendezvous: dead_after_loss: when a robot is lost")
    assert warning.endswith("more of this kind: see 'gspn check')")


def test_a_plan_of_which_nothing_is_to_be_said_gets_no_warning():
    check_plan(read_plan("plans/patrol"), pytest.fail)
