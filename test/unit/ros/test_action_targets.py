"""What the results of action servers mean."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rospy")
messages = pytest.importorskip("gspn_framework_package.msg")

from gspn_framework_package.ros.action_targets import ActionTarget  # noqa: E402


def target(**outcomes):
    return ActionTarget("p", "/robot_1/p", None, {}, outcomes, True)


def test_only_a_result_of_the_thesis_type_names_a_transition():
    ours = messages.ExecGSPNResult("T1")
    foreign = SimpleNamespace(_type="gearbox/ShiftResult", transition="park")
    assert target().transition_of("succeeded", ours) == "T1"
    assert target().transition_of("succeeded", foreign) == ""
    assert target().transition_of("succeeded", None) == ""
    assert target(succeeded="T2").transition_of("succeeded", foreign) == "T2"
    assert target(aborted="T3").transition_of("aborted", foreign) == "T3"
    assert target().transition_of("aborted", foreign) is None
