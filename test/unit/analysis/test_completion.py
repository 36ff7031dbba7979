"""A bare net is completed to a plan that can be read."""

import itertools
import sys
from pathlib import Path

import pytest
from hypothesis import given

from gspn_framework_package.analysis.plan.completion import complete
from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.analysis.preflight.report import Severity
from gspn_framework_package.formats import read_net
from gspn_framework_package.formats.draft import ReadOptions
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.plan_json import plan_from_json
from gspn_framework_package.model.builder import NetBuilder

ROOT = Path(__file__).parents[3]
sys.path.append(str(ROOT / "test" / "unit" / "formats"))
from random_nets import nets  # noqa: E402

PLANS = sorted((ROOT / "plans").glob("*/plan.json"))
SAMPLES = sorted((ROOT / "test" / "unit" / "formats" / "data").iterdir())


def completed(net):
    found = complete(net)
    plan = plan_from_json({**found.document["plan"], "net": found.document["net"]})
    assert plan.net == net and found.document["policy"] is None
    assert sum(net.place(p).tokens for p in plan.action_places) == len(plan.robots)
    return plan, " ".join(found.notes)


@pytest.mark.parametrize("path", PLANS, ids=lambda path: path.parent.name)
def test_it_tells_robots_from_counters_as_the_shipped_plans_do(path):
    plan = read_plan(str(path))
    assert completed(plan.net)[0].resource_places == plan.resource_places


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.name)
def test_the_samples_of_all_formats_become_plans(path):
    name = "machine" if path.name == "greatspn.PNPRO" else None  # which has several nets
    net = read_net(str(path), ReadOptions(net=name))
    plan, notes = completed(net)
    assert plan.robots and notes
    assert [p.position for p in plan.net.places] == [p.position for p in net.places]


@given(nets())
def test_any_net_becomes_a_plan_that_can_be_read(net):
    completed(net)


def ring(net, name, tokens=1):
    names = [name + number for number in "12"]
    net.place(names[0], tokens).place(names[1])
    for here, there in (names, names[::-1]):
        net.exponential("%s_%s" % (here, there), inputs=here, outputs=there)
    return net


def test_teams_that_do_not_meet_are_all_robots():
    plan, _ = completed(ring(ring(NetBuilder("two"), "a"), "b", 2).build())
    assert plan.resource_places == set()
    assert [robot.place for robot in plan.robots] == ["a1", "b1", "b1"]
    refused = [item.check for item in check(plan).items if item.severity is Severity.REFUSED]
    assert sorted(refused) == ["ends_at_once", "timeless_cycle"]  # it has no actions yet


def test_slots_that_only_move_with_robots_are_counters():
    net = NetBuilder("store").place("free", 3).place("used")
    for robot, taken, given_back in (("fills", "free", "used"), ("empties", "used", "free")):
        net.place(robot, 2).place(robot + " one")
        net.exponential("begin " + robot, inputs=robot, outputs=robot + " one")
        net.exponential("end " + robot, inputs=[robot + " one", taken], outputs=[robot, given_back])
    plan, notes = completed(net.build())
    assert plan.resource_places == {"free", "used"}
    assert "the tokens in free, used only move together with those of other places" in notes


def test_a_token_that_is_split_makes_agents():
    plan, notes = completed(read_net(str(ROOT / "plans" / "fork_join" / "net.xml")))
    assert "Right" in plan.actions and "a token is split" in notes


def test_a_queue_without_robots_is_no_robot():
    net = NetBuilder("queue").place("waiting")
    net.exponential("come", outputs="waiting").exponential("go", inputs="waiting")
    plan, notes = completed(net.build())
    assert plan.resource_places == {"waiting"} and plan.simulate_environment
    assert "waiting: resource places" in notes


def test_more_tokens_than_a_team_has_robots_are_counters():
    plan, notes = completed(ring(ring(NetBuilder("many"), "a"), "b", 20_000).build())
    assert plan.resource_places == {"b1", "b2"} and len(plan.robots) == 1
    assert "at most 10000 robots" in notes


def test_a_net_whose_invariants_are_too_many_becomes_a_plan_too():
    net = NetBuilder("layers")  # each way through the layers is an invariant
    layers = [["p%d_%d" % (layer, k) for k in range(8)] for layer in range(10)]
    for name in itertools.chain(*layers):
        net.place(name, int(name.startswith("p0")))
    for number, (here, there) in enumerate(zip(layers, layers[1:])):
        net.immediate("t%d" % number, inputs=here, outputs=there)
    plan, notes = completed(net.build())
    assert len(plan.robots) == 8 and "too large" in notes
