"""The parts of the demonstration and of the network tests that need no network: who is where, and
what makes a result good."""

import json

import pytest

from benchmarks.anywhere.attacks import ATTACKS
from benchmarks.anywhere.machines import THREE, Machine, Sites
from benchmarks.anywhere.report import (
    attack_row,
    orders_in,
    slowed,
    strangers_in,
)
from benchmarks.harness.gateways import Gateways
from benchmarks.harness.log_tail import LogTail
from benchmarks.harness.master_sync import Offer, offers_of


def test_the_layout_follows_from_the_machines():
    layout = Sites.of(THREE)
    assert set(layout.kind_of.values()) == {"ros", "agent"}
    assert sorted(layout.gateways.behind) == ["nat_a", "nat_b"]
    assert layout.alone_behind("nat_b") == ["robot_4"]
    assert layout.place_of["robot_2"] == "machine_2"
    assert [machine.has_master for machine in THREE] == [True, True, False]


@pytest.mark.parametrize(
    "machines, why",
    [
        ([Machine("m", "n", {"r": "boat"})], "neither"),
        ([Machine("m", "n", {"r": "ros"}), Machine("o", "n", {"r": "ros"})], "two machines"),
        ([Machine("hub", "n", {})], "same name"),
    ],
)
def test_a_wrong_layout_is_refused(machines, why):
    with pytest.raises(ValueError, match=why):
        Sites.of(machines)


def test_hosts_get_addresses_and_a_way_out_by_their_gateway():
    two = Gateways({"nat_a": ["one", "two"], "nat_b": ["three"]})
    addresses = two.addresses()
    assert len(set(addresses.values())) == 3
    assert two.of("three") == "nat_b" and two.of("nat_b") == ""
    assert ["route", "add", "default", "via", "10.78.2.1"] in two.host_commands("three")
    assert ["addr", "add", "10.78.2.1/24", "dev", "lan"] in two.commands("nat_b")
    assert "masquerade" in two.ruleset() and "policy drop" in two.ruleset()


@pytest.fixture
def log(tmp_path):
    records = [
        {"kind": "slot", "slot": 0, "mono": 1.0, "hash": "a", "origins": [["", 0, 0]],
         "entries": [{"entry": "start"}]},
        {"kind": "slot", "slot": 1, "mono": 2.0, "hash": "b", "origins": [["thief", 0, 1]],
         "entries": [{"entry": "pause"}]},
    ]  # fmt: skip
    path = tmp_path / "log.jsonl"
    path.write_text("".join(json.dumps(record) + "\n" for record in records))
    return LogTail(str(path)).read()


def test_entries_of_strangers_and_orders_are_found(log):
    assert strangers_in([log], ["robot_1"]) == ["thief"]
    assert strangers_in([log], ["robot_1", "thief"]) == []
    assert orders_in([log], 0.0) == ["pause"]
    assert orders_in([log], 2.5) == []


def test_half_the_speed_is_enough():
    assert slowed(5.0, 10.0) == ""
    assert slowed(4.9, 10.0) == "4.9 slots/s instead of 10.0"


def test_an_attack_fails_only_if_the_attacker_got_nothing_and_the_team_went_on():
    out = {"session": False, "heard": 0, "sent": 0}
    deaf = {"session": True, "heard": 0, "sent": 1}
    loud = {"session": True, "heard": 3, "sent": 9}
    ordered = {"session": True, "sent": 2, "answers": ["done"]}
    for name, found in (("no keys", deaf), ("revoked", loud), ("a robot gives orders", ordered)):
        row = attack_row(name, "", ATTACKS[name].failed(found), found, [], 1.0)
        assert not row.ok and "got through" in row.outcome
    for name, found, told in (
        ("expired", out, "no connection"),
        ("unknown joiner", deaf, "heard nothing"),
        ("a watcher gives orders", {**ordered, "answers": []}, "no answer"),
        ("flood", loud, "9 messages, no effect"),
    ):
        row = attack_row(name, "", ATTACKS[name].failed(found), found, [], 1.0)
        assert row.ok and told in row.outcome
    assert not ATTACKS["flood"].failed({**loud, "sent": 0})  # nothing was tried
    assert not attack_row("flood", "", True, loud, ["it stands still"], 1.0).ok


def test_masters_are_synchronised_in_what_the_documentation_names():
    state = [
        [["/gspn_agreement", ["/robot_1/executor", "/robot_2/executor"]], ["/rosout", ["/a"]]],
        [["/robot_1/agreement", ["/robot_1/executor"]]],
        [["/robot_1/get_state", ["/robot_1/executor"]], ["/robot_1/command", ["/a"]]],
    ]
    apis = {"/robot_1/executor": "http://one:1", "/a": "http://one:2"}  # robot_2 is elsewhere
    types = {"/gspn_agreement": "pkg/Agreement"}
    node = ("/robot_1/executor", "http://one:1")
    assert offers_of(state, types, apis, {"/robot_1/get_state": "rosrpc://one:3"}) == {
        Offer("Publisher", node[0], "/gspn_agreement", "pkg/Agreement", node[1]),
        Offer("Subscriber", node[0], "/robot_1/agreement", "*", node[1]),
        Offer("Service", node[0], "/robot_1/get_state", "rosrpc://one:3", node[1]),
    }
