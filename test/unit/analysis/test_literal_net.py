"""The run net of a plan as an ordinary net: the same numbers as those of the plan, by the package's
own chain, by Storm, and by the run itself."""

import json
import re
from dataclasses import replace

import pytest

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.plan.run_net_export import run_net_of
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import read_net, write_net
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.plan_timing import PlanTiming
from gspn_framework_package.model.policy import Policy, PolicyRow
from gspn_framework_package.run_net import staged_net
from gspn_framework_package.run_net.compiling import compile_plan
from gspn_framework_package.run_net.literal import literal_net
from meaning import old
from meaning.comparing import COMPARISONS, OWN_WAYS, Case, differences, exponential, told_by
from meaning.plans import FAMILIES, Sample, made, samples


def two_picks(plan):
    """The depot with two robots that pick in two of its eight places. With all of them, one robot
    alone takes Storm 41,663 states and more than a minute."""
    due = {"Due_Pick_a2", "Due_Pick_c2"}
    plan = plan.for_robots(2)
    tokens = plan.net.named(plan.net.initial_marking, zeros=False)
    kept = {p: n for p, n in tokens.items() if p in due or not p.startswith("Due_")}
    return replace(plan, net=plan.net.with_marking(kept)).validate()


GO_ON = {
    "plans/measure": read_plan,
    "plans/tokens": read_plan,
    "plans/tokens/instant.json": read_plan,
    "plans/rendezvous": read_plan,
    "plans/patrol": read_plan,
    # their durations take too many phases
    "plans/warehouse": lambda path: exponential(read_plan(path)),
    "plans/inspection": lambda path: exponential(read_plan(path)),
    "plans/depot": lambda path: exponential(two_picks(read_plan(path))),
}
END = {"plans/fork_join": "End >= 1", "plans/warehouse/dock.json": "Docked >= 1"}
"""Plans that end, and when they do."""

FEWER_ROBOTS = {"plans/warehouse": 2, "plans/inspection": 1, "plans/depot": 2}
"""Those that have many states, and with how many robots they are compared."""

QUICK = [path for path in GO_ON if path not in FEWER_ROBOTS]
"""Those that Storm solves in a few seconds as they are."""


def of_few_robots(path):
    plan = GO_ON[path](path)
    return plan.for_robots(FEWER_ROBOTS[path]) if path in FEWER_ROBOTS else plan


def literal_of(plan, timing="run"):
    return literal_net(compile_plan(plan, PlanTiming(plan) if timing == "run" else None))


@pytest.mark.parametrize(
    ("path", "timing"),
    [
        pytest.param(path, "run", marks=pytest.mark.long)
        if path in ("plans/inspection", "plans/warehouse")
        else (path, "run")
        for path in GO_ON
    ]
    + [(path, "net") for path in QUICK],
)
def test_the_long_run_of_every_plan(path, timing):
    plan = of_few_robots(path)
    literal = literal_of(plan, timing)
    mine, found = Analysis(plan, timing=timing).measures, Analysis(literal.net).measures
    tokens, counted = mine.mean_tokens, found.mean_tokens
    assert literal.counts.keys() | set(plan.counters) == {p.name for p in plan.net.places}
    assert {place: counted[name] for place, name in literal.counts.items()} == pytest.approx(
        {place: tokens[place] for place in literal.counts}, abs=1e-9
    )
    fired, throughput = found.throughput, dict.fromkeys(mine.throughput, 0.0)
    for name, meaning in literal.transitions.items():
        if meaning.fires:
            throughput[meaning.of] += fired[name]
    assert throughput == pytest.approx(mine.throughput, abs=1e-9)


@pytest.mark.parametrize("path", END)
def test_how_long_every_plan_takes_that_ends(path):
    plan = read_plan(path)
    literal = literal_of(plan)
    times = [1.0, 10.0, 60.0]
    mine = Analysis(plan, timing="run").first_passage(END[path], times)
    found = Analysis(literal.net).first_passage(END[path], times)
    assert found.mean_time == pytest.approx(mine.mean_time, rel=1e-9)
    assert found.within == pytest.approx(mine.within, abs=1e-9)


def storm(tmp_path, net, properties):
    """What Storm computes of a net from its JANI file."""
    stormpy = pytest.importorskip("stormpy")
    write_net(net, tmp_path / "n.jani")
    jani, _ = stormpy.parse_jani_model(str(tmp_path / "n.jani"))
    parsed = stormpy.parse_properties("; ".join(properties), jani)
    model = stormpy.build_model(jani, parsed)
    state = model.initial_states[0]
    return [stormpy.model_checking(model, each).get_value(state) for each in parsed]


@pytest.mark.parametrize("path", GO_ON)
def test_storm_computes_the_same_long_run(path, tmp_path):
    plan = of_few_robots(path)
    literal = literal_of(plan)
    shares = Analysis(plan, timing="run").measures.token_distribution
    names = literal.counts
    least = 0.05 if path in FEWER_ROBOTS else 1e-3
    wanted = {(p, n): v for p in names for n, v in shares[p].items() if n and v > least}
    properties = ["LRAmin=? [%s = %d]" % (names[p], n) for p, n in wanted]
    found = storm(tmp_path, literal.net, properties)
    assert len(wanted) > 3
    assert found == pytest.approx(list(wanted.values()), abs=1e-5)


@pytest.mark.parametrize("path", END)
def test_storm_computes_the_same_time(path, tmp_path):
    plan = read_plan(path)
    net = literal_of(plan).net
    kind = "T" if all(t.timed for t in net.transitions) else "Tmin"
    found = storm(tmp_path, net, ["%s=? [F %s]" % (kind, END[path])])
    mean = Analysis(plan, timing="run").first_passage(END[path]).mean_time
    assert found == pytest.approx([mean], rel=1e-5)


def test_generated_plans():
    """Sixty plans, each aimed at a rule, and some that find what they do not; the campaign
    one_meaning.py compares more."""
    families = [family for family in FAMILIES if family not in OWN_WAYS]
    # by priority among resources, and in the order of the file; by weight; a failure that stops
    more = [("spontaneous_first", 7), ("spontaneous_first", 4), ("policy_rows", 8), ("failures", 9)]
    compared = 0
    for sample in (*samples(5, 60, families), *(made(family, 5, k) for family, k in more)):
        told = told_by(COMPARISONS["literal_and_run"], Case(sample))
        assert not told, sample.name
        compared += told == []
    assert compared > 60


@pytest.mark.long
@pytest.mark.parametrize(
    "condition",
    [
        "b + c >= 2",
        "2 * b + c > 3 and true",
        "not (b < 2) or sink == 2",
        "sink != 0 and (a == 0 or c * 1 >= 1)",
        "-b <= -2 or not (sink != 2)",
        "2 <= sink + b",
    ],
)
def test_conditions_that_end_the_run(condition):
    plan = made("ends", 3, 0).plan
    plan = replace(plan, until=condition + " or count >= 5").validate()
    case = Case(Sample(condition, plan))
    assert not differences(case.numbers(old.LiteralSteps(plan)), case.run)


@pytest.mark.parametrize("condition", ["b - c >= 1", "b * c >= 1", "min(b, c) >= 1", "b / 2 > 1"])
def test_conditions_that_no_arc_expresses(condition):
    plan = replace(made("ends", 3, 0).plan, until=condition).validate()
    with pytest.raises(RefusedError, match="until: .*does not compare sums of tokens with numbers"):
        literal_of(plan)


@pytest.mark.parametrize(
    ("family", "seed", "number", "text"),
    [
        ("policy_rows", 1, 32, "it has no weight, and precedes others"),
        ("anything", 7, 8, "it moves robots without changing the marking"),
    ],
)
def test_what_a_run_net_cannot_express_is_refused(family, seed, number, text):
    with pytest.raises(RefusedError, match="transition '.*': " + text):
        literal_of(made(family, seed, number).plan)


def test_a_net_that_would_be_too_large(monkeypatch):
    monkeypatch.setattr(staged_net, "MOST_TRANSITIONS", 20)
    with pytest.raises(RefusedError, match=r"more than 20 transitions, \d+ of them for"):
        literal_of(read_plan("plans/patrol"))


def test_too_many_ways_to_choose_partners():
    net = NetBuilder("crowd").place("a", 60).place("b")
    inputs = {"a": 50}
    for k in range(8):
        net.immediate("t%d" % k, inputs="a", outputs="b")
    net.immediate("all", inputs=inputs, outputs=inputs)
    net.exponential("back", inputs="b", outputs="a")
    plan = made("counters", 1, 0).plan
    row = PolicyRow((), (("all", 0.2), *(("t%d" % k, 0.1) for k in range(8))))
    robots = tuple(plan.robots[0]._replace(name="r%d" % k, place="a") for k in range(60))
    plan = replace(
        plan,
        net=net.build(),
        robots=robots,
        resource_places=frozenset(),
        actions={"a": plan.actions["d"], "b": None},
        durations={"a": plan.durations["d"]} if "d" in plan.durations else {},
        policy=Policy([], [row]),
    ).validate()
    with pytest.raises(RefusedError, match="choices of partners"):
        literal_of(plan)


def test_names_that_every_tool_can_read():
    literal = literal_of(read_plan("plans/patrol"))
    names = [*literal.places, *literal.transitions]
    assert all(re.fullmatch("[A-Za-z][A-Za-z0-9_]*", name) for name in names)
    assert literal.counts["p3:Decide_L1"] == "p3_Decide_L1"
    assert literal.places["p3_Decide_L1"].of == "p3:Decide_L1"


@pytest.mark.parametrize("ending", ["PNPRO", "pnml"])
def test_what_other_tools_read_is_the_same_net(ending, tmp_path):
    net = literal_of(read_plan("plans/rendezvous")).net
    write_net(net, tmp_path / ("n." + ending))
    read = read_net(tmp_path / ("n." + ending))
    found, expected = Analysis(read).measures, Analysis(net).measures
    assert found.mean_tokens == pytest.approx(expected.mean_tokens, abs=1e-12)
    assert found.throughput == pytest.approx(expected.throughput, abs=1e-12)


@pytest.mark.parametrize("ending", ["pnpro", "pnml", "jani"])
def test_the_command_writes_it(ending, tmp_path, capsys):
    path = tmp_path / ("run." + ending)
    assert main(["convert", "plans/rendezvous", "--run-net", str(path)]) == 0
    assert "take exponential times" in capsys.readouterr().err
    if ending == "jani":
        names = [each["name"] for each in json.loads(path.read_text())["variables"]]
    else:
        names = [place.name for place in read_net(path).places]
    assert names == list(literal_of(read_plan("plans/rendezvous")).places)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["plans/patrol/net.xml", "x.jani"], "--run-net applies to plans"),
        (["plans/patrol", "x.json"], "a run net is a net, but x.json is a plan"),
        (["plans/patrol", "x.tra"], "the chain of a plan does not need it"),
        (["plans/patrol", "x.jani", "--expand", "a", "b", "c", "d"], "--run-net to plans"),
    ],
)
def test_what_has_no_run_net(words, text, capsys):
    assert main(["convert", *words, "--run-net"]) == 2
    assert text in capsys.readouterr().err


def test_the_run_net_of_either_reading_of_time_is_written(tmp_path, capsys):
    clock = "the clock of an exponential transition runs only while it is enabled"
    path, docked = str(tmp_path / "x.json"), {}
    for timing in ("run", "net"):
        words = ["convert", "plans/rendezvous", str(tmp_path / "x.pnpro"), "--run-net"]
        assert main([*words, "--timing", timing]) == 0
        assert (clock in capsys.readouterr().err) is (timing == "net")
        net = read_net(tmp_path / "x.pnpro")
        docked[timing] = Analysis(net).measures.mean_tokens["Docked"]
        plan = read_plan("plans/rendezvous")
        mine = Analysis(plan, timing=timing).measures.mean_tokens["Docked"]
        assert docked[timing] == pytest.approx(mine, abs=1e-9)
        assert main(["explain", "plans/rendezvous", "--run-net", "--timing", timing]) == 0
        assert (clock in capsys.readouterr().err) is (timing == "net")
    assert docked["run"] != pytest.approx(docked["net"], abs=1e-3)
    for verb, *words in (
        ["explain", "plans/rendezvous"],
        ["convert", "plans/rendezvous", path],
        ["convert", "plans/rendezvous/net.xml", str(tmp_path / "y.pnml")],
    ):
        assert main([verb, *words, "--timing", "net"]) == 2
        assert "--run-net" in capsys.readouterr().err


@pytest.mark.parametrize("most", [None, 3])
def test_durations_of_too_many_phases_are_those_of_the_analysis(most):
    plan = read_plan("plans/rendezvous")
    plan = replace(plan, durations={"Docked": Duration.deterministic(2.0)}).validate()
    literal, notes = run_net_of(plan, most=most)
    assert any(
        "was replaced by phases of the same mean: Erlang with %d" % (most or 28) in n for n in notes
    )
    mine, its = (Analysis(of, phases=most).measures.mean_tokens for of in (plan, literal.net))
    for place, name in literal.counts.items():
        assert its[name] == pytest.approx(mine[place], abs=1e-9)
