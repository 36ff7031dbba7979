"""A team whose network fails, in network namespaces; skipped, with the reason, where those are not
allowed."""

import subprocess

import pytest

from gspn_framework_package.benchmark.netns import rules

pytest.importorskip("rospy", reason="ROS is not here")
from gspn_framework_package.benchmark.netns.main import why_not
from gspn_framework_package.benchmark.netns.network import Network, why_impossible
from gspn_framework_package.benchmark.netns.scenarios import DELAY, minority, mute
from gspn_framework_package.model.errors import ExecutionError


def test_a_partition_cuts_between_groups_both_ways_and_not_within():
    cuts = rules.partition([["a", "b"], ["c"], ["d"]])
    assert ("a", "b") not in cuts and ("b", "a") not in cuts
    for pair in (("a", "c"), ("c", "a"), ("c", "d"), ("d", "c"), ("b", "d")):
        assert pair in cuts
    assert rules.ruleset(cuts).count(" drop") == len(cuts) == 10


@pytest.fixture
def network():
    reason = why_impossible(DELAY)
    if reason:
        pytest.skip("not possible here: " + reason)
    with Network(["x", "y", "z"]) as network:
        yield network


def test_cuts_are_real_and_heal(network):
    network.verify()
    network.cut(rules.one_way(["x"], ["y"]))
    assert network.travel_time("x", "y", 0.3) is None
    assert network.travel_time("y", "x") is not None
    assert network.travel_time("x", "z") is not None
    network.verify()
    network.heal()
    assert network.travel_time("x", "y") is not None


def test_verify_notices_a_cut_that_is_none(network):
    network.cuts = rules.one_way(["x"], ["y"])  # claimed, but no rule was made
    with pytest.raises(ExecutionError, match="from x to y arrived"):
        network.verify()


def test_the_relay_delays():
    reason = why_impossible(DELAY)
    if reason:
        pytest.skip("not possible here: " + reason)
    with Network(["x", "y"], DELAY) as network:
        network.verify()
        assert network.travel_time("x", "y") >= DELAY


def test_nothing_is_left_behind():
    reason = why_impossible()
    if reason:
        pytest.skip("not possible here: " + reason)
    with pytest.raises(ZeroDivisionError), Network(["x"]) as network:
        sleeper = subprocess.Popen(network.command("x", ["sleep", "100"]))
        names = subprocess.check_output(["ip", "netns", "list"], text=True)
        assert network.namespace("x") in names
        raise ZeroDivisionError
    assert sleeper.wait(20) != 0
    assert network.namespace("x") not in subprocess.check_output(["ip", "netns", "list"], text=True)


@pytest.mark.parametrize("scenario, mode", [(minority, "full"), (mute, "partial")])
def test_a_team_stays_consistent(scenario, mode):
    reason = why_not()
    if reason:
        pytest.skip("not possible here: " + reason)
    numbers = scenario(mode, hold=3.0)  # raises where the team does what it must not
    assert numbers["cut"] >= 3.0
    assert numbers["slots"] > 10
