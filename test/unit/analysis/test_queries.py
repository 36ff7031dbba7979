"""Temporal queries against exhaustive references on generated nets, and what is refused."""

import json
import math
import os
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from generated_nets import bounded_nets, reference_space
from generated_plans import small_plans
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from gspn_framework_package.analysis import watch
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.proofs.prover import solver_available
from gspn_framework_package.analysis.queries.answers import answer_query
from gspn_framework_package.analysis.queries.grammar import parse_query
from gspn_framework_package.analysis.queries.states import StateSets
from gspn_framework_package.cli.main import main
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.errors import ExpressionError, RefusedError, UsageError
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy, PolicyRow

EXAMPLES = int(os.environ.get("GSPN_QUERY_EXAMPLES", "40"))
relaxed = settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
PLANS = Path(__file__).parents[3] / "plans"


def machine():
    """A machine that fails, is repaired, or is lost; ``done`` counts its failures."""
    return (
        NetBuilder("machine")
        .place("up", tokens=1)
        .place("down")
        .place("lost")
        .place("done")
        .exponential("fail", rate=1.0, inputs="up", outputs=["down", "done"])
        .exponential("repair", rate=3.0, inputs="down", outputs="up")
        .exponential("lose", rate=1.0, inputs="down", outputs="lost")
        .build()
    )


# -- the reference: sets of markings, as the definitions say ---------------------------------------


@st.composite
def formulas(draw, net, depth=2):
    """A formula of CTL: its text, and a function that maps a graph to the set of its markings."""
    kind = draw(st.integers(0, 7 if depth else 0))
    if kind == 0:
        place = draw(st.sampled_from([p.name for p in net.places]))
        text = "%s %s %d" % (
            place,
            draw(st.sampled_from([">=", "=", "<"])),
            draw(st.integers(0, 2)),
        )
        text = draw(st.sampled_from([text, text, "deadlock"]))
        holds = parse_condition(text, [p.name for p in net.places], ["deadlock"]).holds
        return text, lambda graph: {m for m in graph if holds(m, {"deadlock": not graph[m]})}
    first, one = draw(formulas(net, depth - 1))
    if kind == 1:
        return "not (%s)" % first, lambda graph: set(graph) - one(graph)
    if kind == 2:
        second, two = draw(formulas(net, depth - 1))
        return "(%s) and (%s)" % (first, second), lambda graph: one(graph) & two(graph)
    if kind == 3:
        text = draw(st.sampled_from(["(EF %s)", "(E<> %s)", "E [ F %s ]"])) % first
        return text, lambda graph: until(graph, set(graph), one(graph), any)
    if kind == 4:
        text = draw(st.sampled_from(["(AG %s)", "(A[] %s)", "A [ G %s ]"])) % first
        return text, lambda graph: for_ever(graph, one(graph), all)
    if kind == 5:
        return "(EG %s)" % first, lambda graph: for_ever(graph, one(graph), any)
    if kind == 6:
        return "(AF %s)" % first, lambda graph: until(graph, set(graph), one(graph), all)
    second, two = draw(formulas(net, depth - 1))
    word, quantifier = draw(st.sampled_from([("E", any), ("A", all)]))
    return (
        "%s [ %s U %s ]" % (word, first, second),
        lambda graph: until(graph, one(graph), two(graph), quantifier),
    )


def until(graph, stay, goal, quantifier):
    """The least set that has the goal, and what stays with some (every) successor in the set."""
    found = set(goal)
    while True:
        more = {
            m
            for m in stay - found
            if graph[m] and quantifier(after in found for after in graph[m].values())
        }
        if not more:
            return found
        found |= more


def for_ever(graph, stay, quantifier):
    """The greatest set within ``stay`` that is dead, or has some (every) successor in the set."""
    found = set(stay)
    while True:
        less = {
            m
            for m in found
            if graph[m] and not quantifier(after in found for after in graph[m].values())
        }
        if not less:
            return found
        found -= less


@pytest.mark.long
@relaxed
@given(st.data(), bounded_nets())
def test_branching_formulas_hold_in_the_states_of_the_definitions(data, net):
    text, holding = data.draw(formulas(net, 3))
    graph = reference_space(net)
    wanted = holding(graph)
    answer = answer_query(Analysis(net), text)
    assert answer.holds is (net.initial_marking in wanted), text
    if answer.sequence is not None:
        marking = net.initial_marking
        for name in answer.sequence:
            marking = graph[marking][net.transition_number(name)]
        assert net.named(marking, zeros=False) == answer.marking
    # what was not explored may change what is not decided, and nothing else
    analysis = Analysis(net, limit=max(len(graph) // 2, 1))
    known = StateSets(analysis.space).holding(parse_query(text, [p.name for p in net.places]))
    assert (known.must <= known.may).all()
    for state in range(len(analysis.space)):
        holds = analysis.space.marking(state) in wanted
        assert known.must[state] <= holds <= known.may[state], text


@relaxed
@given(st.data(), bounded_nets(max_tokens=3))
def test_numbers_are_those_of_dense_algebra(data, net):
    names = [p.name for p in net.places]
    graph = reference_space(net)
    stay_text, stay = data.draw(formulas(net, 1))
    goal_text, goal = data.draw(formulas(net, 1))
    time = data.draw(st.sampled_from([0.0, 0.1, 1.0, 7.5]))
    try:
        chance = dense(net, graph, stay(graph), goal(graph), None)
    except np.linalg.LinAlgError:
        assume(False)  # a timeless trap: there is no chain
    analysis = Analysis(net)
    try:
        analysis.chain  # noqa: B018
    except RefusedError:
        assume(False)
    within = dense(net, graph, stay(graph), goal(graph), time)
    ever = dense(net, graph, set(graph), set(graph) - goal(graph), None)
    always = dense(net, graph, set(graph), set(graph) - goal(graph), time)
    for text, wanted in (
        ("P=? [ %s U %s ]" % (stay_text, goal_text), chance),
        ("P=? [ %s U<=%r %s ]" % (stay_text, time, goal_text), within),
        ("P=? [ G %s ]" % goal_text, 1 - ever),
        ("P=? [ G<=%r %s ]" % (time, goal_text), 1 - always),
    ):
        answer = answer_query(analysis, text)
        low, high = answer.interval
        assert low - 1e-9 <= wanted <= high + 1e-9, text
        assert high - low < 1e-9 and low <= answer.value <= high, text
    assert names
    condition = "%s >= 1" % data.draw(st.sampled_from(names))
    share = answer_query(analysis, "S=? [ %s ]" % condition)
    tokens = analysis.measures.token_distribution[condition.split()[0]]
    assert share.value == pytest.approx(sum(v for n, v in tokens.items() if n), abs=1e-12)


def dense(net, graph, stay, goal, time):
    """The probability of staying until the goal is reached, within a time or (None) ever."""
    markings = list(graph)
    index = {marking: i for i, marking in enumerate(markings)}
    final = np.array([m in goal or m not in stay for m in markings])
    moves = np.zeros((len(markings), len(markings)))
    at_once = np.zeros(len(markings), dtype=bool)
    for marking, firings in graph.items():
        row = index[marking]
        for t, after in firings.items():
            transition = net.transitions[t]
            value = transition.number
            if transition.timed:
                degree = min((marking[p] // w for p, w in net.inputs[t]), default=1)
                value *= min(degree, transition.servers or degree)
            at_once[row] |= not transition.timed
            moves[row, index[after]] += value
    moves[final] = 0.0
    at_once &= ~final
    moves[at_once] /= moves[at_once].sum(axis=1, keepdims=True)
    inner = moves[np.ix_(at_once, at_once)]
    ends = np.eye(len(markings))[:, ~at_once]
    ends[at_once] = np.linalg.solve(np.eye(len(inner)) - inner, moves[np.ix_(at_once, ~at_once)])
    start, rates = ends[index[net.initial_marking]], moves[~at_once] @ ends
    np.fill_diagonal(rates, 0.0)
    reached = np.array([m in goal for m in markings])[~at_once]
    if time is not None:
        return float(start @ expm((rates - np.diag(rates.sum(axis=1))) * time) @ reached)
    hopeful = reached.copy()
    for _ in markings:
        hopeful |= (rates[:, hopeful] > 0).any(axis=1)
    inside = hopeful & ~reached
    system = np.diag(rates.sum(axis=1)) - rates
    chance = reached.astype(float)
    into = rates[np.ix_(inside, reached)].sum(axis=1)
    chance[inside] = np.linalg.solve(system[np.ix_(inside, inside)], into)
    return float(start @ chance)


@pytest.mark.long
@settings(relaxed, max_examples=EXAMPLES // 2)
@given(st.data(), small_plans(), st.sampled_from(["run", "net"]))
def test_proofs_about_plans_agree_with_their_states(data, plan, reading):
    """What the ladder of proofs says of a plan is true of the states of its run, however the time
    is read."""
    analysis = Analysis(plan, timing=reading, limit=20_000)
    assume(analysis.space.complete)
    place = data.draw(st.sampled_from([p.name for p in plan.net.places]))
    assume(place not in analysis.left_out)
    condition = "%s >= %d" % (place, data.draw(st.integers(0, 3)))
    reached = analysis.space.holds(condition)
    assert answer_query(analysis, "EF %s" % condition).holds == reached.any()
    assert answer_query(analysis, "AG %s" % condition).holds == reached.all()
    text = "AG EF %s" % condition
    back = reached.copy()
    while True:
        more = np.zeros_like(back)
        np.logical_or.at(more, analysis.space.sources, back[analysis.space.targets])
        if not (more & ~back).any():
            break
        back |= more
    assert answer_query(analysis, text).holds == back.all()


# -- single answers --------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize(
    ("query", "holds"),
    [
        ("P>=1 [ F lost = 1 ]", True),
        ("P>0 [ up = 1 U lost = 1 ]", False),
        ("P>0 [ F<=1e-12 lost = 1 ]", None),
        ("P<0.5 [ F<=2 down = 1 ]", False),
        ("P<=0 [ G up = 1 ]", True),
        ("S>=1 [ lost = 1 ]", True),
        ("EF done >= 3", True),
        ("AG done < 3", False),
        ("AG EF lost = 1", True),
        ("AF lost = 1", False),
        ("AG EF done >= 3", False),
        ("AG AF done >= 3", None),
        ("A [ up = 1 U down = 1 ]", True),
        ("(EF down = 1) and not (EF up + down + lost > 1)", True),
        ("up = 1", True),
        ("deadlock", False),
    ],
)
def test_yes_or_no(query, holds):
    answer = answer_query(Analysis(machine()), query)
    assert answer.holds is holds
    assert bool(answer.undecided) == (holds is None)


@pytest.mark.long
def test_probabilities_of_a_counter_that_grows():
    """A failed machine is repaired with probability 3/4."""
    answer = answer_query(Analysis(machine()), "P=? [ F done >= 3 ]")
    low, high = answer.interval
    assert low <= 0.75**2 <= high and high - low < 1e-12
    timed = answer_query(Analysis(machine()), "P=? [ F<=2 done = 1 ]")
    assert timed.interval[0] <= 1 - math.exp(-2) <= timed.interval[1]


@pytest.mark.long
def test_the_policy_decides_which_counter_grows():
    builder = NetBuilder("counters").place("a", tokens=1).place("d").place("left").place("right")
    builder.exponential("work", inputs="a", outputs="d")
    builder.immediate("l", inputs="d", outputs=["a", "left"])
    builder.immediate("r", inputs="d", outputs=["a", "right"])
    plan = Plan(
        net=builder.build(),
        resource_places=frozenset(["left", "right"]),
        robots=(RobotSpec("robot", "a"),),
        actions={"a": FunctionAction("actions.work", "work"), "d": None},
        policy=Policy([], [PolicyRow((), (("l", 1.0),))]),
    )
    analysis = Analysis(plan)
    assert analysis.left_out == ("left", "right")
    assert answer_query(analysis, "P=? [ F right >= 1 ]").value == 0
    assert answer_query(analysis, "EF right >= 1").holds is False
    assert answer_query(analysis, "EF left >= 3").holds is True
    assert analysis.reach("right >= 1").reachable is False
    found = analysis.reach("left >= 2")
    assert [step.transition for step in found.witness] == ["work", "l", "work", "l"]


@pytest.mark.skipif(not solver_available(), reason="needs SciPy 1.7 or newer")
def test_a_proof_needs_no_markings(monkeypatch):
    """2**60 markings are too many to visit. The budget is processor time: others may be at work."""
    monkeypatch.setattr(watch, "time", SimpleNamespace(monotonic=time.process_time))
    builder = NetBuilder("large")
    for i in range(60):
        builder.place("a%d" % i, tokens=1).place("b%d" % i)
        builder.exponential("to%d" % i, inputs="a%d" % i, outputs="b%d" % i)
        builder.exponential("fro%d" % i, inputs="b%d" % i, outputs="a%d" % i)
    analysis = Analysis(builder.build(), limits=Limits(states=1000))
    answer = answer_query(analysis, "AG a0 + b0 + a59 + b59 = 2")
    assert answer.holds is True and answer.decided_by in ("structure", "state equation")
    assert "space" not in vars(analysis)
    answer = answer_query(analysis, "EF b0 + b1 + b2 + b3 + b59 = 5")
    assert answer.holds is True and len(answer.sequence) >= 5
    answer = answer_query(analysis, "AG EF a0 + a59 = 2")
    assert answer.holds is True and answer.decided_by in ("structure", "state equation")
    answer = answer_query(analysis, "AG (EF a0 = 1 and EF a59 = 1)")
    assert answer.holds is None and "not decided within" in answer.undecided
    assert answer_query(analysis, "AF a0 + b0 = 2").holds is False


@pytest.mark.long
def test_parts_that_are_exchanged_are_not_asked_about():
    analysis = Analysis(machine(), lump=[])
    with pytest.raises(UsageError, match="equal parts"):
        answer_query(analysis, "AG EF lost = 1")


def test_an_unresolved_choice_has_no_probability():
    net = (
        NetBuilder("choice")
        .place("a", tokens=1)
        .place("b")
        .place("c")
        .immediate("left", weight=0, inputs="a", outputs="b")
        .immediate("right", weight=0, inputs="a", outputs="c")
        .build()
    )
    answer = answer_query(Analysis(net), "P=? [ F b = 1 ]")
    assert answer.value is None and "no weights decide" in answer.undecided
    assert answer_query(Analysis(net), "EF b = 1").holds is True


# -- the language ----------------------------------------------------------------------------------


def test_an_operator_reaches_to_the_right_and_quotes_make_a_place():
    names = ["F", "P", "A", "EF", "U", "x"]
    query = parse_query("P=? [ F F >= 1 and x = 2 ]", names)
    assert (query.asked.operator, query.asked.goal.text) == ("F", "F >= 1 and x = 2")
    query = parse_query("P=? [ 'F' >= 1 U<=1.5 U = 1 ]", names)
    assert (query.asked.stay.text, query.asked.goal.text) == ("'F' >= 1", "U = 1")
    assert query.asked.within == 1.5
    assert parse_query("P >= 1 and A <> 1 and EF > 0", names).parts == {}
    (part,) = parse_query("EF EF > 0", names).parts.values()
    assert part.path.goal.text == "EF > 0"
    (part,) = parse_query("A[] x = 1 or E [ F x = 2 ]", names).parts.values()
    assert part.every and part.path.goal.text == "x = 1 or E [ F x = 2 ]"
    assert parse_query("P>=0.25 [ F x = 1 ]", names).bound == (">=", 0.25)


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("P=? [ X up = 1 ]", "operator X (next) is not supported before 'X' (character 7)"),
        ("AX up = 1", "operator AX (next) is not supported before 'AX' (character 1)"),
        ("P=? [ up = 1 W down = 1 ]", "operator W (weak until) is not supported before 'W' (char"),
        ('R{"tokens"}=? [ C<=1 ]', "operator R (release, or rewards) is not supported"),
        ("Pmax=? [ F up = 1 ]", "operator Pmax (optimum, see gspn optimise) is not supported"),
        ("filter(max, up = 1)", "operator filter (filter) is not supported"),
        ("P=? [ F P>0.5 [ F up = 1 ] ]", "P is answered only as the whole query"),
        ("EF S>0.5 [ up = 1 ]", "S is answered only as the whole query"),
        ("P=? [ F[1,2] up = 1 ]", "only an upper bound on the time, <=, is supported, not '['"),
        ("P=? [ F>=1 up = 1 ]", "only an upper bound on the time, <=, is supported, not '>='"),
        ("P=? [ F<=-1 up = 1 ]", "a number was expected before '-' (character 10)"),
        ("E [ F<=1 up = 1 ]", "a time bound is possible only in P"),
        ("P=? [ F G up = 1 ]", "G is not possible here"),
        ("P=? [ up = 1 ]", "F, G or U was expected before ']'"),
        ("P=? F up = 1", "'[' was expected before 'F' (character 5)"),
        ("P>=2 [ F up = 1 ]", "a number from 0 to 1 was expected before '2' (character 4)"),
        ("P=? [ F up ]", "'up' is a number, not a condition"),
        ("EF nowhere = 1", "there is no place 'nowhere' (character 4"),
        ("EF up = 1 ]", "an operator was expected before ']'"),
        ("EF" + " AG EF" * 50 + " up = 1", "nested more than"),
        ("", "at the end of"),
    ],
)
def test_what_is_not_covered_is_refused_by_name_and_position(query, message):
    with pytest.raises(ExpressionError) as caught:
        answer_query(Analysis(machine()), query)
    assert message in str(caught.value)


# -- the command -----------------------------------------------------------------------------------


def test_the_command(capsys):
    words = ["analyse", str(PLANS / "measure")]
    queries = ["P=? [ F<=10 P3 >= 5 ]", "AG P3 <= 3", "S=? [ P1 = 1 ]"]
    code = main([*words, *(word for query in queries for word in ("--query", query)), "--json"])
    data = json.loads(capsys.readouterr().out)
    assert code == 0 and [answer["query"] for answer in data["queries"]] == queries
    timed, always, share = data["queries"]
    assert timed["value"] == pytest.approx(0.999785433, abs=1e-9)
    assert always["holds"] is False and always["marking"]["P3"] > 3
    assert data["timing"]["reading"] == "run" and share["decided_by"] == "Markov chain"
    assert main([*words, "--query", queries[1], "--query", "AG EF P3 = 0"]) == 1
    out = capsys.readouterr().out.splitlines()
    assert out[0].startswith("AG P3 <= 3: no, by T1") and out[0].endswith("(exploration)")
    assert out[1].startswith("AG EF P3 = 0: not decided: P3 can grow without bound")


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--query", "AX P1 = 1"], "the operator AX (next) is not supported"),
        (["--at", "1"], "answers only queries"),
        (["--only-net", "--symbolic"], "exclude each other"),
        (["--only-net", "--lump"], "exclude each other"),
        (["--csv", "rows.csv"], "exclude each other"),
    ],
)
def test_wrong_usage(capsys, more, message):
    assert main(["analyse", str(PLANS / "measure"), "--query", "EF P1 = 1", *more]) == 2
    assert message in capsys.readouterr().err
