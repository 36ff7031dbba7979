"""The check before any robot moves: every item, refused and passed; structure decides where it
can."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.decisions.aims import Objective, Request
from gspn_framework_package.analysis.decisions.optimise import optimise
from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.analysis.preflight.report import Severity
from gspn_framework_package.analysis.simulation import simulate
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.action import FunctionAction, ServerAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import (
    CancelledError,
    NetError,
    PlanError,
    RefusedError,
)
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.marking_function import parse_value, quoted_place
from gspn_framework_package.model.plan import (
    Plan,
    RobotSpec,
    Timing,
    Transport,
)
from gspn_framework_package.model.policy import Policy, PolicyRow

PLANS = Path(__file__).parents[3] / "plans"
DO = FunctionAction("actions.do", "do")


def make_plan(builder, resources=(), idle=(), **more):
    """A plan with a robot for every token in an action place, and an action in every one that is
    not ``idle``."""
    net = builder.build()
    robots = [p.name for p in net.places if p.name not in resources for _ in range(p.tokens)]
    return Plan(
        net=net,
        resource_places=frozenset(resources),
        actions={
            p.name: None if p.name in idle else DO for p in net.places if p.name not in resources
        },
        robots=tuple(RobotSpec("robot_%d" % i, place) for i, place in enumerate(robots, 1)),
        **more,
    )


def severities(report, name):
    return [item.severity for item in report.of(name)]


def loop():
    return (
        NetBuilder("loop")
        .place("a", tokens=2)
        .place("b")
        .exponential("go", inputs="a", outputs="b", servers=None)
        .exponential("back", inputs="b", outputs="a", servers=None)
    )


def choice():
    """Robots in ``d`` choose; ``alone`` is for one, ``meet`` for two."""
    return (
        NetBuilder("choice")
        .place("a", tokens=2)
        .place("d")
        .place("b")
        .place("c")
        .exponential("arrive", inputs="a", outputs="d", servers=None)
        .immediate("alone", inputs="d", outputs="b")
        .immediate("meet", inputs={"d": 2}, outputs={"c": 2})
        .exponential("b_back", inputs="b", outputs="a", servers=None)
        .exponential("c_back", inputs="c", outputs="a", servers=None)
    )


def policy(*rows, places=("d",)):
    return Policy(places, [PolicyRow(counts, tuple(choices.items())) for counts, choices in rows])


def test_a_good_plan_is_decided_by_structure():
    report = check(make_plan(loop()))
    assert report.exit_code == 0 and not report.refused and report.states == 0
    assert {item.severity for item in report.items} == {Severity.OK}


def test_fifty_robots_and_two_hundred_places_are_decided_by_structure():
    builder = NetBuilder("large")
    for i in range(200):
        builder.place("p%d" % i, tokens=int(i % 4 == 0))
    for i in range(200):
        for step in (1, 7):
            builder.exponential(
                "t%d_%d" % (i, step), inputs="p%d" % i, outputs="p%d" % ((i + step) % 200)
            )
    report = check(make_plan(builder))
    assert len(make_plan(builder).robots) == 50
    assert report.exit_code == 0 and report.states == 0


def test_names_that_do_not_exist_are_no_plan():
    with pytest.raises(PlanError, match="no place 'nowhere'"):
        check(replace(make_plan(loop()), timeouts={"nowhere": 1.0}))


def test_maps():
    plan = make_plan(loop().place("tools", tokens=1), resources=["tools"])
    assert severities(check(plan), "actions") == [Severity.OK]
    report = check(replace(plan, actions={"a": DO}))
    assert report.exit_code == 1 and report.of("actions")[0].details["places"] == ["b"]
    report = check(replace(plan, actions={"a": DO, "b": None, "tools": DO}))
    assert report.exit_code == 1 and report.of("actions")[0].details["places"] == ["tools"]
    each = tuple(r._replace(actions={"b": DO}) for r in plan.robots)
    assert check(replace(plan, actions={"a": DO}, robots=each)).exit_code == 0


def test_initial_places():
    plan = make_plan(loop())
    report = check(replace(plan, robots=plan.robots[:1]))
    assert severities(report, "initial") == [Severity.REFUSED]
    assert report.of("initial")[0].details["places"] == {"a": {"tokens": 2, "robots": 1}}


@pytest.mark.long
def test_not_conservative_is_refused_with_a_firing_sequence():
    report = check(make_plan(loop().exponential("split", inputs="b", outputs=["a", "b"])))
    (item,) = report.of("conservative")
    assert report.exit_code == 1
    assert item.details["sequence"] == ["go", "split"]
    assert (item.details["taken"], item.details["put"]) == (1, 2)
    assert item.details["marking"] == {"a": 2, "b": 1}


def test_not_conservative_but_never_enabled_is_accepted():
    builder = loop().place("key").exponential("split", inputs=["b", "key"], outputs=["a", "b"])
    report = check(make_plan(builder, resources=["key"]))
    (item,) = report.of("conservative")
    assert item.severity is Severity.OK and item.details["decided_by"] == "exploration"
    assert severities(report, "never_fire") == [Severity.WARNING]


def test_agents_may_be_created():
    plan = make_plan(loop().exponential("split", inputs="b", outputs=["a", "b"]))
    assert check(plan, standalone=True, limit=500).exit_code == 0


def test_a_transition_without_robots_cannot_make_one():
    builder = loop().place("energy", tokens=1).exponential("magic", inputs="energy", outputs="a")
    report = check(make_plan(builder, resources=["energy"]))
    assert severities(report, "creates_robots") == [Severity.REFUSED]
    assert not report.of("conservative")


def test_timeless_cycles():
    def ring(weight_out):
        return (
            NetBuilder("ring")
            .place("a", tokens=1)
            .place("x")
            .place("y")
            .place("b")
            .exponential("start", inputs="a", outputs="x")
            .immediate("xy", inputs="x", outputs="y")
            .immediate("yx", inputs="y", outputs="x")
            .immediate("out", inputs={"y": weight_out}, outputs={"b": weight_out})
        )

    # An action on the way takes time; without one the robot goes round for ever, unless there is a
    # way out.
    assert severities(check(make_plan(ring(1), idle=["x"])), "timeless_cycle") == [Severity.OK]
    (item,) = check(make_plan(ring(1), idle=["x", "y"])).of("timeless_cycle")
    assert item.severity is Severity.OK and item.details["decided_by"] == "exploration"
    (item,) = check(make_plan(ring(2), idle=["x", "y"])).of("timeless_cycle")
    assert item.severity is Severity.REFUSED and item.details["sequence"] == ["start"]
    assert item.details["cycle"] in (["x", "xy", "y", "yx", "x"], ["y", "yx", "x", "xy", "y"])
    # The policy can close the way out.
    closed = make_plan(
        ring(1), idle=["x", "y"], policy=policy(((None,), {"xy": 0.5, "yx": 0.5}), places=("x",))
    )
    assert severities(check(closed), "timeless_cycle") == [Severity.REFUSED]


def test_an_immediate_source_never_stops():
    report = check(
        make_plan(loop().place("count").immediate("spin", outputs="count"), resources=["count"])
    )
    assert severities(report, "timeless_cycle") == [Severity.REFUSED]


def crossing():
    """Two robots that each hold one tool and want the other's."""
    return (
        NetBuilder("crossing")
        .place("left", tokens=1)
        .place("right", tokens=1)
        .place("l1")
        .place("r1")
        .place("t1", tokens=1)
        .place("t2", tokens=1)
        .exponential("take1", inputs=["left", "t1"], outputs="l1")
        .exponential("take2", inputs=["right", "t2"], outputs="r1")
        .exponential("both1", inputs=["l1", "t2"], outputs=["left", "t1", "t2"])
        .exponential("both2", inputs=["r1", "t1"], outputs=["right", "t1", "t2"])
    )


def test_dead_markings_come_with_a_firing_sequence():
    plan = make_plan(crossing(), resources=["t1", "t2"], timing=Timing(evict_after=0))
    report = check(plan)
    (item,) = report.of("dead_markings")
    assert report.exit_code == 0 and item.severity is Severity.WARNING
    assert sorted(item.details["sequence"]) == ["take1", "take2"]
    assert item.details["marking"] == {"l1": 1, "r1": 1}


def test_smaller_teams_are_covered():
    builder = (
        NetBuilder("pair")
        .place("a", tokens=1)
        .place("b", tokens=1)
        .exponential("both", inputs=["a", "b"], outputs=["a", "b"])
    )
    report = check(make_plan(builder))
    assert severities(report, "dead_markings") == [Severity.OK]
    assert report.of("dead_after_loss")[0].details["sequence"][0].startswith("(robot lost in ")
    assert not check(make_plan(builder, timing=Timing(evict_after=0))).of("dead_after_loss")


def test_what_a_lost_robot_held_can_come_back():
    plan = make_plan(crossing(), resources=["t1", "t2"])
    (item,) = check(plan).of("dead_after_loss")
    stuck = {tuple(sorted(i["marking"].items())) for i in (item.details, *item.details["others"])}
    assert (("right", 1), ("t1", 1)) not in stuck
    # One alone holds t1 and is lost: the other needs it.
    assert any(("r1", 1) in marking for marking in stuck)
    returned = replace(plan, on_evict={"l1": {"t1": 1}, "r1": {"t2": 1}})
    assert not check(returned).of("dead_after_loss")


def test_robots_at_an_end_are_not_dead():
    builder = (
        NetBuilder("end")
        .place("a", tokens=1)
        .place("end")
        .exponential("go", inputs="a", outputs="end")
    )
    report = check(make_plan(builder))
    assert severities(report, "dead_markings") == [Severity.OK]


def test_until_is_an_end():
    plan = make_plan(
        crossing(),
        resources=["t1", "t2"],
        timing=Timing(evict_after=0),
        until="l1 == 1 and r1 == 1",
    )
    assert severities(check(plan), "dead_markings") == [Severity.OK]


def test_markings_are_untimed():
    """A robot that decides is busy with its action meanwhile, so two can be in the decision
    place."""
    rows = policy(((1,), {"alone": 1.0}))
    (gap,) = check(make_plan(choice(), policy=rows)).of("policy")
    assert gap.details["marking"] == {"d": 2} and gap.severity is Severity.WARNING
    assert gap.details["sequence"] == ["arrive", "arrive"] and gap.details["place"] == "d"


def test_policy_gaps_of_a_strict_plan_are_refused():
    rows = policy(((1,), {"alone": 1.0}))
    report = check(make_plan(choice(), policy=rows, strict=True))
    assert report.exit_code == 1 and severities(report, "policy") == [Severity.REFUSED]
    rows = policy(((1,), {"alone": 1.0}), ((2,), {"meet": 1.0}))
    assert check(make_plan(choice(), policy=rows, strict=True)).exit_code == 0


def test_gaps_only_where_the_policy_leads():
    """Row 1 sends the first robot on at once; but untimed, the second may arrive before it goes."""
    rows = policy(((0, None), {"alone": 1.0}), ((None, 1), {"alone": 1.0}), places=("c", "d"))
    assert severities(check(make_plan(choice(), policy=rows, strict=True)), "policy") == [
        Severity.OK
    ]


def test_a_policy_that_keeps_everybody_waiting():
    rows = policy(((None,), {"meet": 1.0}))
    plan = make_plan(choice(), policy=rows)
    assert severities(check(plan), "dead_markings") == [Severity.OK]
    three = make_plan(
        choice().place("far", tokens=1).exponential("near", inputs="far", outputs="b"), policy=rows
    )
    assert severities(check(three), "dead_markings") == [Severity.OK]
    odd = check(make_plan(choice(), policy=rows).for_robots(1))
    assert odd.of("dead_markings")[0].details["marking"] == {"d": 1}


def test_a_row_without_choices_is_a_row():
    rows = policy(((1,), {}), ((2,), {"meet": 1.0}))
    report = check(make_plan(choice(), policy=rows, strict=True, timing=Timing(evict_after=0)))
    assert report.exit_code == 0 and severities(report, "policy") == [Severity.OK]
    assert severities(report, "dead_markings") == [Severity.OK]
    forever = policy(((1,), {"alone": 1.0}), ((2,), {}))
    report = check(make_plan(choice(), policy=forever, strict=True))
    (item,) = report.of("dead_markings")
    assert item.details["marking"] == {"d": 2} and item.severity is Severity.WARNING


@pytest.mark.parametrize(
    ("rows", "dead"),
    [
        ([((None, None), {"alone": 1.0})], []),
        ([((None, None), {"alone": 1.0}), ((None, None), {})], []),
        ([((None, None), {}), ((None, None), {"alone": 1.0})], [{"d": 1}, {"d": 2}]),
        ([((1, None), {"alone": 1.0}), ((2, None), {"alone": 1.0}), ((None, None), {})], []),
        ([((None, None), {"alone": 1.0}), ((0, None), {})], []),
        ([((None, None), {"alone": 1.0}), ((2, None), {})], [{"d": 2}]),
        ([((2, None), {"alone": 1.0}), ((None, None), {})], [{"d": 1}]),
        ([((1, None), {"alone": 1.0}), ((None, 0), {})], [{"d": 2}]),
    ],
)
def test_dead_markings_where_rows_let_robots_wait(rows, dead):
    """Structure and exploration agree on which rows can make everybody wait."""
    plan = make_plan(choice(), policy=policy(*rows, places=("d", "b")))
    found = [
        item.details["marking"]
        for name in ("dead_markings", "dead_after_loss")
        for item in check(plan).of(name)
        if item.severity is not Severity.OK
    ]
    assert sorted(map(str, found)) == sorted(map(str, dead))


def test_rows_that_speak_of_nobody_there():
    builder = (
        choice()
        .place("e")
        .exponential("to_e", inputs="a", outputs="e")
        .immediate("e_alone", inputs="e", outputs="b")
        .immediate("e_too", inputs="e", outputs="c")
    )
    report = check(make_plan(builder, policy=policy(((None,), {"alone": 1.0}))))
    assert any(item.details.get("places") == ["e"] for item in report.of("policy"))


def test_weights_decide_without_a_policy_but_not_with_weight_zero():
    assert severities(check(make_plan(choice())), "policy") == [Severity.OK]
    zero = (
        NetBuilder("zero")
        .place("a", tokens=1)
        .place("d")
        .exponential("go", inputs="a", outputs="d")
        .immediate("x", weight=0, inputs="d", outputs="a")
        .immediate("y", weight=0, inputs="d", outputs="a")
    )
    report = check(make_plan(zero))
    assert report.of("policy")[0].details["marking"] == {"d": 1}


def test_overlapping_rows_are_reported():
    rows = policy(((1, None), {"alone": 1.0}), ((None, 0), {"alone": 1.0}), places=("d", "c"))
    overlaps = check(make_plan(choice(), policy=rows)).of("policy_overlaps")
    assert [item.details for item in overlaps] == [{"place": "d", "rows": [1, 2]}]


def test_rows_that_share_only_a_resource_do_not_overlap():
    """Both rows speak of transitions that take the tool, but robots of different places draw."""
    net = (
        NetBuilder("tools")
        .place("a", tokens=1)
        .place("b", tokens=1)
        .place("tool", tokens=1)
        .place("c")
        .place("d")
        .immediate("take_a", inputs=["a", "tool"], outputs="c")
        .immediate("take_b", inputs=["b", "tool"], outputs="d")
        .exponential("back_c", inputs="c", outputs=["a", "tool"])
        .exponential("back_d", inputs="d", outputs=["b", "tool"])
    )
    rows = policy(((1,), {"take_a": 1.0}), ((1,), {"take_b": 1.0}), places=("tool",))
    assert not check(make_plan(net, resources=["tool"], policy=rows)).of("policy_overlaps")


def test_counters_and_resource_bounds():
    builder = (
        loop()
        .place("done")
        .place("tool", tokens=3)
        .exponential("use", inputs=["a", "tool"], outputs=["a", "tool", "done"], servers=None)
    )
    report = check(make_plan(builder, resources=["done", "tool"]))
    assert report.of("counters")[0].details["places"] == ["done"]
    assert report.of("resource_bounds")[0].details["bounds"] == {"tool": 3}
    growing = (
        loop()
        .place("heap")
        .exponential("add", inputs="a", outputs=["a", "heap"], servers=None)
        .exponential("use", inputs=["b", "heap"], outputs="b", servers=None)
    )
    report = check(make_plan(growing, resources=["heap"]), limit=500)
    assert report.exit_code == 0
    assert severities(report, "resource_bounds") == [Severity.WARNING]
    assert report.of("resource_bounds")[0].details["grows"] == ["heap"]
    assert "not decided within" in report.of("exploration")[0].text


def test_a_counter_that_the_policy_reads_is_not_left_out():
    builder = choice().place("count").exponential("tick", inputs="a", outputs=["a", "count"])
    reading = policy(((None, 0), {"alone": 1.0}), places=("d", "count"))
    assert not check(make_plan(builder, resources=["count"], policy=reading), limit=300).of(
        "counters"
    )
    not_reading = policy(((None, None), {"alone": 1.0}), places=("d", "count"))
    assert check(make_plan(builder, resources=["count"], policy=not_reading), limit=300).of(
        "counters"
    )


def test_servers_of_transitions_and_places_that_decide():
    single = NetBuilder("single").place("a", tokens=2).exponential("go", inputs="a", outputs="a")
    (item,) = check(make_plan(single)).of("servers")
    # nothing was said of servers
    assert (item.details["transitions"], item.severity) == (["go"], Severity.OK)
    two = (
        NetBuilder("two").place("a", tokens=2).exponential("go", inputs="a", outputs="a", servers=2)
    )
    (item,) = check(make_plan(two)).of("servers")
    assert (item.details["transitions"], item.severity) == (["go"], Severity.WARNING)
    assert check(make_plan(choice())).of("decision_actions")[0].details["places"] == ["d"]
    assert not check(make_plan(choice(), idle=["d"])).of("decision_actions")


def test_a_server_that_several_robots_may_use_at_once():
    drive = ServerAction("move_base_msgs/MoveBaseAction", "/move_base")
    both = make_plan(loop())
    shared = replace(both, actions={"a": drive, "b": DO})
    (item,) = check(shared).of("shared_servers")
    assert item.severity is Severity.WARNING and item.details["places"] == ["a"]
    assert item.text.startswith("robot_1, robot_2 may use the server /move_base at the same time")
    own = replace(both, actions={"a": drive._replace(server="move_base"), "b": DO})
    assert not check(own).of("shared_servers")
    guarded = (
        NetBuilder("guarded")
        .place("a", tokens=2)
        .place("b")
        .place("free", tokens=1)
        .exponential("go", inputs=["a", "free"], outputs="b", servers=None)
        .exponential("back", inputs="b", outputs=["a", "free"], servers=None)
    )
    one_at_a_time = replace(make_plan(guarded, resources=["free"]), actions={"a": DO, "b": drive})
    assert not check(one_at_a_time).of("shared_servers")


def test_what_a_prediction_takes_for_a_cycle_without_time():
    builder = NetBuilder("round").place("a", tokens=1).place("b")
    builder.immediate("on", inputs="a", outputs="b").immediate("back", inputs="b", outputs="a")
    builder.place("c", tokens=1).immediate("stay", inputs="c", outputs="c", inhibitors={"a": 1})
    plan = make_plan(builder, idle=["c"])  # the cycle of c is another matter
    report = check(plan)
    (item,) = report.of("predictions")
    assert (item.severity, item.details["places"]) == (Severity.WARNING, ["a", "b"])
    plan = replace(plan, actions={**plan.actions, "c": DO})
    assert not check(plan).refused  # a run takes the time that the actions take
    with pytest.raises(RefusedError, match="without time"):
        simulate(plan, time=1.0, replications=1)
    timed = replace(plan, durations={p: Duration.exponential(1.0) for p in "bc"})
    assert not check(timed).of("predictions")
    assert simulate(timed, time=1.0, replications=1).time == 1.0


def test_nobody_asks_for_one_of_several_exponential_transitions():
    builder = loop().exponential("other", inputs="a", outputs="b", servers=None)
    assert not check(make_plan(builder)).of("unasked")
    plan = make_plan(builder, idle=["a"])
    (item,) = check(plan).of("unasked")
    assert item.details["place"] == "a" and item.severity is Severity.REFUSED
    says = {"a": FailureRule.fire("other")}
    assert not check(replace(plan, on_failure=says)).refused
    nowhere = replace(make_plan(builder, idle=["a", "b"]), on_failure=says)
    assert severities(check(nowhere), "timeless_cycle") == [Severity.REFUSED]


def test_servers_that_do_not_answer_are_refused():
    plan = make_plan(loop(), idle=["b"])
    asked = []

    def probe(robot, place, action):
        asked.append((robot, place, action))
        return "no server /robot_2/do" if robot == "robot_2" else None

    report = check(plan, server_probe=probe)
    assert asked == [("robot_1", "a", DO), ("robot_2", "a", DO)]
    assert report.exit_code == 1
    (item,) = report.of("servers_answer")
    assert (item.details["robot"], item.details["place"]) == ("robot_2", "a")
    assert check(plan, server_probe=lambda *_: None).exit_code == 0


@pytest.mark.parametrize(
    "until", ["done >= 12", "12 <= done", "done > 11", "done >= 100000 or done >= 12"]
)
def test_what_comes_after_the_end_is_not_explored(until):
    """A counter that only ``until`` reads has no bound but the end of the run."""
    builder = (
        NetBuilder("n")
        .place("a", tokens=2)
        .place("d")
        .place("done")
        .exponential("work", inputs="a", outputs=["d", "done"], servers=None)
        .immediate("x", inputs="d", outputs="a")
        .immediate("y", inputs="d", outputs="a")
    )
    rows = Policy.from_table(["a"], [([1], {"x": 1})])
    report = check(make_plan(builder, resources=["done"], policy=rows, until=until), limit=500)
    assert report.complete
    assert report.of("resource_bounds")[0].details["bounds"] == {"done": 12}
    assert severities(report, "dead_markings") == [Severity.OK]
    assert report.of("policy")[0].details["marking"].get("a", 0) == 0


def test_limit_and_cancel():
    plan = make_plan(crossing(), resources=["t1", "t2"])
    report = check(plan, limit=2)
    assert not report.complete and report.exit_code == 0
    assert all(
        "decided within" in i.text or i.details.get("sequence")
        for i in report.items
        if i.severity is Severity.WARNING and i.check != "servers"
    )
    with pytest.raises(CancelledError):
        check(plan, cancel=lambda: True)


def test_the_report_is_plain_json():
    report = check(make_plan(crossing(), resources=["t1", "t2"]))
    data = json.loads(json.dumps(report.to_json()))
    assert data["accepted"] is True and data["exit_code"] == 0
    assert {item["severity"] for item in data["items"]} == {"ok", "warning"}
    assert str(report).splitlines()[-1].startswith("plan may run")


@pytest.mark.long
@pytest.mark.parametrize("name", ["measure", "patrol", "rendezvous", "tokens", "warehouse"])
def test_the_example_plans_may_run(name):
    assert check(read_plan(PLANS / name)).exit_code == 0


def test_the_fork_of_the_example_is_for_agents():
    assert check(read_plan(PLANS / "fork_join")).exit_code == 1
    assert check(read_plan(PLANS / "fork_join"), standalone=True).exit_code == 0


@pytest.mark.parametrize("there", [False, True])
def test_a_missing_zenoh_library_is_reported(monkeypatch, there):
    known = object() if there else None
    monkeypatch.setattr(
        "gspn_framework_package.analysis.preflight.names.find_spec", lambda name: known
    )
    builder = NetBuilder().place("A", tokens=1).immediate("t", inputs="A", outputs="A")
    found = severities(check(make_plan(builder, transport=Transport.ZENOH)), "transport")
    assert found == ([] if there else [Severity.WARNING])


def null_ring(*timed):
    """One robot goes round in places without an action; ``timed`` ones are left by exponential
    transitions."""
    names = ["x", "y", "z"]
    builder = NetBuilder("null").place("x", tokens=1).place("y").place("z")
    builder.place("rest")
    for name, target in zip(names, [*names[1:], names[0]]):
        kind = builder.exponential if name in timed else builder.immediate
        kind("leave_" + name, inputs=name, outputs=target)
    return builder


@pytest.mark.parametrize("timed", ["", "x", "xy", "xyz"])
def test_an_exponential_transition_takes_no_time_after_a_place_without_an_action(timed):
    ways = null_ring(*timed).exponential("never", inputs="rest", outputs="rest")
    report = check(make_plan(ways, idle=["x", "y", "z"]))
    (item,) = report.of("timeless_cycle")
    assert item.severity is Severity.REFUSED and "x" in item.text and "give one" in item.text
    assert check(make_plan(ways, idle=["x", "y"])).exit_code == 0


def test_what_takes_precedence_is_no_way_out():
    """The way out of a cycle without time has a lower priority, or comes after the resources."""

    def plan(priority, **more):
        builder = NetBuilder().place("a", tokens=1).place("b").place("c")
        builder.immediate("round", inputs="a", outputs="b")
        builder.immediate("back", inputs="b", outputs="a", priority=priority)
        builder.immediate("out", inputs="b", outputs="c")
        builder.exponential("home", inputs="c", outputs="a")
        return make_plan(builder, idle=["a", "b"], **more)

    assert severities(check(plan(1)), "timeless_cycle") == [Severity.OK]
    assert severities(check(plan(2)), "timeless_cycle") == [Severity.REFUSED]


def test_a_policy_that_may_draw_a_partner_who_is_busy_is_a_way_out():
    builder = NetBuilder().place("a", tokens=1).place("b", tokens=1).place("c")
    builder.immediate("round", inputs="a", outputs="a")
    builder.immediate("meet", inputs=["a", "b"], outputs=["c", "b"])
    builder.exponential("home", inputs="c", outputs="a")
    builder.exponential("on", inputs="b", outputs="b")
    by_weight = make_plan(builder, idle=["a"])
    assert severities(check(by_weight), "timeless_cycle") == [Severity.REFUSED]
    drawn = replace(by_weight, policy=policy(((None,), {"round": 0.5, "meet": 0.5}), places=["a"]))
    assert severities(check(drawn), "timeless_cycle") == [Severity.OK]


def test_what_ends_as_it_begins_is_refused():
    ends = NetBuilder().place("a", tokens=1).place("b").exponential("go", inputs="a", outputs="b")
    (item,) = check(make_plan(ends, idle=["a", "b"])).of("ends_at_once")
    assert item.severity is Severity.REFUSED and "no place has an action" in item.text
    assert not check(make_plan(ends, idle=["b"])).refused
    (item,) = check(replace(make_plan(loop()), until="a >= 1")).of("ends_at_once")
    assert item.severity is Severity.REFUSED and "'until'" in item.text
    stuck = NetBuilder().place("a", tokens=1).place("key").place("b")
    stuck.exponential("go", inputs=["a", "key"], outputs="b")
    report = check(make_plan(stuck, resources=["key"]))
    assert severities(report, "dead_markings") == [Severity.REFUSED]


def test_what_gets_stuck_or_never_comes_about_is_in_the_verdict():
    builder = loop().place("key", tokens=2).place("nowhere")
    builder.exponential("lose", inputs=["a", "key"], outputs="nowhere")
    builder.exponential("leave", inputs={"nowhere": 3}, outputs={"a": 3})
    report = check(make_plan(builder, resources=["key"]))
    assert not report.refused and report.verdict == (
        "may run, but can get stuck (1 dead marking), and can let robots wait forever, and has 1 "
        "transition that never fires"
    )
    assert report.to_json()["verdict"] == report.verdict and report.verdict in str(report)
    assert check(make_plan(loop())).verdict == "may run"


def test_agents_may_end_but_not_all():
    builder = loop().place("arrivals")
    builder.exponential("last", inputs="b")
    plan = make_plan(builder, resources=["arrivals"])
    (item,) = check(plan, standalone=True).of("agents_left")
    assert item.severity is Severity.REFUSED and item.details["sequence"][-1] == "last"
    more = make_plan(builder.exponential("come", outputs="a"), resources=["arrivals"])
    assert not check(more, standalone=True, limit=500).refused


def test_robots_are_not_counted_without_an_action_of_their_own():
    """The team has no action in `b`, but every robot has one of its own."""
    ring = null_ring("z")
    plan = make_plan(ring, idle=["x", "y", "z"])
    own = tuple(r._replace(actions={"y": DO}) for r in plan.robots)
    actions = {p: a for p, a in plan.actions.items() if p != "y"}
    assert severities(check(replace(plan, robots=own, actions=actions)), "timeless_cycle") == [
        Severity.OK
    ]


def test_what_an_action_may_name_can_fire_although_the_policy_never_chooses_it():
    chosen = policy(((None,), {"alone": 1.0}))
    plan = make_plan(choice(), policy=chosen, until="b >= 9")
    assert check(plan).of("never_fire")[0].details["transitions"] == ["meet", "c_back"]
    named = replace(plan, outcomes={"d": {"": 0.5, "meet": 0.5}})
    assert not check(named).of("never_fire")
    rule = {"d": FailureRule.fire("meet")}
    assert not check(replace(plan, on_failure=rule)).of("never_fire")


def test_a_rate_of_robots_that_depends_on_the_marking_is_refused():
    plan = read_plan(PLANS / "patrol")
    timed = next(t for t in plan.net.transitions if t.timed)
    rate = parse_value("1 + #" + quoted_place(plan.net.places[0].name))
    plan = replace(plan, net=plan.net.with_transition(timed._replace(rate=rate)))
    assert severities(check(plan), "rates") == [Severity.REFUSED]
    for ask in (
        lambda: Analysis(plan).chain,
        lambda: simulate(plan, time=1.0, replications=1),
        lambda: optimise(plan, Request(Objective.long_run({timed.name: 1}))),
        lambda: optimise(plan, Request(Objective.long_run({timed.name: 1}), reading="net")),
    ):
        with pytest.raises(RefusedError, match="depends on the marking"):
            ask()
    by_net = Analysis(plan, timing="net").measures.throughput[timed.name]
    simulated = simulate(plan, time=2000.0, replications=20, timing="net")
    assert simulated.throughput[timed.name].mean == pytest.approx(by_net, rel=0.05)


def choosing(weight):
    return make_plan(
        NetBuilder()
        .place("a", 1)
        .place("b")
        .place("left", 2)
        .exponential("back", inputs="b", outputs="a")
        .exponential("more", "1 / (1 + #left)", inputs="left")
        .immediate("go", weight=weight, inputs="a", outputs="b")
        .immediate("stay", inputs="a", outputs="b"),
        resources=["left"],
    )


def test_weights_are_computed_in_all_markings():
    assert severities(check(choosing("1 + #left")), "rates") == [Severity.OK, Severity.OK]
    (item,) = [i for i in check(choosing("#left")).of("rates") if i.severity is Severity.REFUSED]
    assert item.text.startswith("transition 'go': its weight '#left' is 0 in (a: 1)")
    assert simulate(choosing("1 + #left"), time=30.0, replications=2).throughput["go"].mean > 0
    with pytest.raises(NetError, match="its weight '#left - 2' is 0 in"):
        simulate(choosing("#left - 2"), time=30.0, replications=2)
