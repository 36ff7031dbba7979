"""A team whose network fails, in network namespaces; skipped, with the reason, where those are not
allowed."""

import subprocess

import pytest

from benchmarks.harness import rules

pytest.importorskip("rospy", reason="ROS is not here")
from benchmarks.harness.gateways import Gateways
from benchmarks.harness.network import Network, why_impossible
from benchmarks.netns.main import why_not
from benchmarks.netns.scenarios import minority, mute, router_killed
from gspn_framework_package.model.errors import ExecutionError

DELAY = 0.05


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


def test_lost_packets_are_drawn_and_cuts_stay_whole():
    text = rules.ruleset(rules.one_way(["a"], ["b"]), 0.3)
    assert text.index('oifname "b" drop') < text.index("numgen random mod 1000 < 300 drop")
    assert "numgen" not in rules.ruleset(frozenset())


def test_hosts_get_out_of_their_gateway_and_nobody_gets_in():
    reason = why_impossible()
    if reason:
        pytest.skip("not possible here: " + reason)
    two = Gateways({"nat_a": ["one"], "nat_b": ["two", "three"]})
    with Network(["router", "nat_a", "nat_b"], gateways=two) as network:
        network.verify()
        assert network.travel_time("one", "router") is not None
        assert network.travel_time("router", "one", 0.2) is None
        assert network.travel_time("one", "two", 0.2) is None
        assert network.travel_time("two", "three") is not None
        network.cut(rules.partition([["router", "nat_a"], ["nat_b"]]))
        assert network.travel_time("two", "router", 0.2) is None
        network.verify()
        network.heal()
        before = network.address("nat_b")
        network.move("nat_b")
        assert network.address("nat_b") != before
        network.verify()


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


def test_a_team_finds_its_router_again():
    reason = why_not(transport="zenoh")
    if reason:
        pytest.skip("not possible here: " + reason)
    numbers = router_killed("full", hold=2.0)
    assert numbers["away"] >= 2.0
    assert numbers["slots"] > 10
