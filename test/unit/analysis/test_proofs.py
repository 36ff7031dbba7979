"""Proofs without visiting markings, and witnesses: never wrong, and found where it matters."""

import copy
import json
import random
import subprocess
import sys
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import pytest
from asked_markings import SHAPES, can_be_reached, questions_about
from generated_nets import bounded_nets
from generated_plans import small_plans, with_events
from hypothesis import given, settings

from gspn_framework_package.analysis import watch
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.plan.markings import PlanMarkings
from gspn_framework_package.analysis.preflight import MARKING_LIMIT, check
from gspn_framework_package.analysis.preflight.markings import COUNTS_BEFORE_PROOFS
from gspn_framework_package.analysis.preflight.report import Severity
from gspn_framework_package.analysis.proofs import checker, policy_rows, prover, witness
from gspn_framework_package.analysis.proofs.checker import (
    ProofError,
    check_certificate,
    fulfils,
)
from gspn_framework_package.analysis.proofs.conditions import formula_of
from gspn_framework_package.analysis.proofs.ladder import (
    NOT_DECIDED,
    PROVEN,
    VIOLATED,
    decide_question,
)
from gspn_framework_package.analysis.proofs.prover import solver_available
from gspn_framework_package.analysis.proofs.questions import (
    DEAD,
    FIRES,
    NEVER,
    MarkingQuestion,
    problem_of,
)
from gspn_framework_package.analysis.proofs.witness import GuidedSearch, played_to
from gspn_framework_package.analysis.report import Questions, report
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.making.site_plan import build_site_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.errors import CancelledError, LimitError
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy, PolicyRow, PolicyTable

PLANS = Path(__file__).parents[3] / "plans"

pytestmark = pytest.mark.skipif(
    not solver_available(), reason="this SciPy has no solver for the state equation"
)


@pytest.fixture(autouse=True)
def no_z3(monkeypatch):
    """The other steps answer; ``test_inductive.py`` is about that one."""
    monkeypatch.setitem(sys.modules, "z3", None)


def never_dead(subject, losses=False, **more):
    """Whether it is proven, without visiting markings, that nothing gets stuck."""
    answer = decide_question(subject, MarkingQuestion(DEAD, losses=losses), limit=0, **more)
    return answer.verdict == PROVEN


@pytest.mark.parametrize(
    "subjects, number",
    [
        (bounded_nets(), 120),
        (bounded_nets(max_places=8, max_transitions=12, max_tokens=5), 60),
        (small_plans(), 40),
        (with_events(small_plans()), 30),
    ],
    ids=["nets", "larger nets", "plans", "events"],
)
def test_answers_are_those_of_visiting_all_markings(subjects, number, monkeypatch):
    """Each answer may visit one marking: the rest is proofs and short guided searches."""
    for name, most in (("FIRST_MARKINGS", 100), ("MOST_SEARCHED", 300), ("MOST_WALKS", 2)):
        monkeypatch.setattr(witness, name, most)
    monkeypatch.setattr(witness, "LONGEST_WALK", 100)
    count = Counter()

    @settings(derandomize=True, max_examples=number, deadline=None)
    @given(subjects)
    def ask(subject):
        for question in questions_about(subject, sum(count.values())):
            expected = can_be_reached(subject, question)
            answer = decide_question(subject, question, limit=1, seconds=60.0)
            problem = problem_of(subject, question)
            assert "not accepted" not in str(answer.steps)
            count[answer.verdict] += 1
            if answer.verdict == PROVEN:
                assert expected in (False, None), (question, answer)
                check_certificate(problem, json.loads(json.dumps(answer.certificate)))
            elif answer.verdict == VIOLATED:
                assert expected in (True, None), (question, answer)
                assert problem.is_bad(played_to(problem, answer.sequence))

    ask()
    assert count[PROVEN] > number and count[VIOLATED] > number
    assert count[NOT_DECIDED] < sum(count.values()) / 4


def fewest_firings(problem):
    """The number of firings that lead to a bad marking, found by trying all that are as short."""
    levels = [{problem.net.initial_marking}]
    while not any(map(problem.is_bad, levels[-1])):
        after = {problem.net.fire(m, t) for m in levels[-1] for t in problem.fires(m)}
        levels.append(after.difference(*levels))
    return len(levels) - 1


@pytest.mark.parametrize("kinds", ["nets", "plans"])
def test_with_exploration_everything_small_is_decided_and_shown_by_the_fewest_firings(kinds):
    subjects, found = {"nets": bounded_nets(), "plans": small_plans()}[kinds], Counter()

    @settings(derandomize=True, max_examples=40, deadline=None)
    @given(subjects)
    def ask(subject):
        for question in questions_about(subject, 3):
            expected = can_be_reached(subject, question)
            answer = decide_question(subject, question, limit=2_000)
            if expected is not None:
                assert answer.verdict == (VIOLATED if expected else PROVEN), (question, answer)
            if answer.verdict == VIOLATED and answer.decided_by == "exploration":
                fewest = fewest_firings(problem_of(subject, question))
                assert len(answer.sequence) == fewest, (question, answer)
                found["losses" if question.losses else "whole"] += fewest > 1

    ask()
    assert found["whole"] > 5 and (found["losses"] > 5 or kinds == "nets")


def test_firings_that_the_policy_never_chooses_make_no_marking_near():
    """``trap`` is one firing away from ``start``, but three as the policy chooses; ``pit`` two."""
    net = (
        NetBuilder("near")
        .place("start", tokens=1)
        .place("trap")
        .place("way")
        .place("pit")
        .place("far")
        .immediate("jump", inputs="start", outputs="trap")
        .immediate("walk", inputs="start", outputs="way")
        .exponential("on", inputs="way", outputs="far")
        .exponential("fall", inputs="way", outputs="pit")
        .exponential("arrive", inputs="far", outputs="trap")
        .build()
    )
    policy = Policy(["start"], [PolicyRow((None,), (("walk", 1.0),))])
    plan = Plan(net, [RobotSpec("r1", "start")], policy=policy)
    answer = decide_question(plan, MarkingQuestion(NEVER, "trap + pit >= 1"))
    assert answer.decided_by == "exploration"
    assert answer.steps[-1].outcome == "2 firings that were played, none are fewer"
    assert answer.sequence == ("walk", "fall")


UNKNOWN = "unknown"


def stuck(plan, losses):
    """A dead marking of a plan; None if it has none, and UNKNOWN if its markings are too many."""
    markings = PlanMarkings(plan, 2_000, losses=losses)
    found = [finding for lost in (False, True) for finding in markings.dead(after_losses=lost)]
    return found[0] if found else None if markings.complete else UNKNOWN


@pytest.mark.parametrize("name", sorted(p.name for p in PLANS.iterdir() if p.is_dir()))
def test_the_example_plans_are_proven_never_to_get_stuck(name):
    plan = read_plan(str(PLANS / name))
    assert never_dead(plan)
    waits_for_the_lost = stuck(plan, True) not in (None, UNKNOWN)
    assert never_dead(plan, True) is not waits_for_the_lost


def site(folder, **more):
    """A plan of six robots on a map of 30 nodes, whose markings are far too many to visit."""
    names = {(x, y): "n%d%d" % (x, y) for x in range(6) for y in range(5)}
    nodes = {name: [4 * x, 4 * y] for (x, y), name in names.items()}
    steps = [((x, y), (x + 1, y)) for x, y in names] + [((x, y), (x, y + 1)) for x, y in names]
    edges = [[names[a], names[b]] for a, b in steps if b in names]
    tasks = {
        "plan": "site",
        "start": ["n00", "n10", "n20", "n30", "n40", "n50"],
        "speed": 1.0,
        "tasks": {"Inspect": {"at": ["n34", "n12", "n53", "n04"], "seconds": 9, "again_after": 60}},
        "battery": {"full": 0.1, "low": 0.1},
        "docks": {"n00": 1},
        "charge": 60,
        **more,
    }
    for name, data in (("map.yaml", {"nodes": nodes, "edges": edges}), ("tasks.yaml", tasks)):
        (folder / name).write_text(json.dumps(data), "utf-8")
    made = build_site_plan(str(folder / "map.yaml"), str(folder / "tasks.yaml"), 6)
    made.write(str(folder / "plan"))
    return read_plan(str(folder / "plan"))


def test_a_plan_of_a_map_is_proven_but_not_if_robots_can_meet_head_on(tmp_path):
    plan = site(tmp_path)
    report = check(plan, limit=100)
    (item,) = report.of("dead_markings")
    assert item.severity is Severity.OK and item.details["losses"]
    assert not report.of("exploration")
    whole = check(plan)
    assert whole.of("dead_markings") == (item,)
    assert COUNTS_BEFORE_PROOFS <= whole.states * len(plan.net.places) < 2 * COUNTS_BEFORE_PROOFS
    assert whole.states < MARKING_LIMIT
    (tmp_path / "narrow").mkdir()
    narrow = site(tmp_path / "narrow", node_capacity=1)
    assert not never_dead(narrow)


WAIT = ()
GO = (("go", 1.0),)
BLOCKED = (("blocked", 1.0),)


@pytest.mark.parametrize(
    "rows, proven",
    [
        ([((None, None), GO)], True),
        ([((1, None), GO), ((0, None), GO)], True),
        ([((None, None), GO), ((1, None), WAIT)], False),
        ([((None, None), GO), ((1, 0), BLOCKED)], False),
        ([((None, None), GO), ((1, 1), BLOCKED)], True),  # "key" holds nothing
        ([((None, None), BLOCKED)], False),
        ([((0, None), GO)], False),  # in a strict plan, no row moves nobody
    ],
)
def test_a_robot_moves_only_by_the_row_that_takes_precedence(rows, proven):
    net = (
        NetBuilder("rows")
        .place("door", tokens=1)
        .place("room")
        .place("key")
        .immediate("go", inputs="door", outputs="room")
        .immediate("blocked", inputs=["door", "key"], outputs=["room", "key"])
        .exponential("back", inputs="room", outputs="door")
        .build()
    )
    plan = Plan(
        net=net,
        resource_places=frozenset(["key"]),
        actions={"door": None, "room": FunctionAction("actions.do", "do")},
        robots=(RobotSpec("robot_1", "door"),),
        policy=Policy(["door", "key"], [PolicyRow(*row) for row in rows]),
        strict=True,
    ).validate()
    assert never_dead(plan) is proven
    assert (stuck(plan, False) is None) is proven


def lanes(first="lane_a", second="lane_b"):
    """Two robots that each take two lanes, one after the other."""
    builder = NetBuilder("lanes").place("lane_a", tokens=1).place("lane_b", tokens=1)
    for robot, lane, other in (("x", "lane_a", "lane_b"), ("y", first, second)):
        builder.place(robot + "_rests", tokens=1).place(robot + "_half").place(robot + "_drives")
        builder.exponential(robot + "_1", inputs=[robot + "_rests", lane], outputs=robot + "_half")
        builder.exponential(
            robot + "_2", inputs=[robot + "_half", other], outputs=robot + "_drives"
        )
        builder.exponential(
            robot + "_3",
            inputs=robot + "_drives",
            outputs=[robot + "_rests", "lane_a", "lane_b"],
        )
    return builder.build()


def test_robots_that_wait_for_each_other_are_not_proven_away():
    assert never_dead(lanes())
    assert not never_dead(lanes("lane_b", "lane_a"))


def trapped():
    """A net whose state equation allows the empty marking, which a marked trap excludes."""
    return (
        NetBuilder("trapped")
        .place("a", tokens=1)
        .place("b")
        .exponential("more", inputs="a", outputs={"a": 1, "b": 1})
        .exponential("join", inputs={"a": 1, "b": 1}, outputs="b")
        .exponential("on", inputs="b", outputs="a")
        .build()
    )


def test_a_marked_trap_excludes_what_the_state_equation_allows(monkeypatch):
    net = trapped()
    assert never_dead(net)
    monkeypatch.setattr(prover, "largest_set", lambda *given, **more: ())
    # it would look for firings that lead to the empty marking until its time is over
    monkeypatch.setattr(GuidedSearch, "go_on", lambda *given: None)
    assert not never_dead(net)


def test_what_waits_for_precedence_in_vain_never_fires_however_many_markings_there_are():
    builder = NetBuilder("busy").place("on", tokens=1).place("log").place("off")
    builder.immediate("first", priority=2, inputs="on", outputs=["on", "log"])
    builder.immediate("second", priority=1, inputs="on", outputs="off")
    net = builder.exponential("timed", inputs="on", outputs="off").build()
    verdicts = {
        name: decide_question(net, MarkingQuestion(FIRES, name), limit=50).verdict
        for name in ("first", "second", "timed")
    }
    assert verdicts == {"first": VIOLATED, "second": PROVEN, "timed": PROVEN}


def test_what_is_too_large_stays_open(monkeypatch):
    plan = read_plan(str(PLANS / "inspection"))
    monkeypatch.setattr(policy_rows, "MOST_PROOF_ROWS", 5)
    (step,) = decide_question(plan, MarkingQuestion(DEAD)).steps
    assert "the policy is too large" in step.outcome
    huge = NetBuilder("huge").place("a", tokens=10**9).exponential("go", inputs="a", outputs="a")
    assert never_dead(huge.build())


def test_a_proof_can_be_cancelled_and_runs_out_of_time():
    with pytest.raises(CancelledError):
        decide_question(lanes(), MarkingQuestion(DEAD), cancel=lambda: True)
    answer = decide_question(lanes(), MarkingQuestion(DEAD), seconds=0)
    assert answer.verdict == NOT_DECIDED and not answer.decided_by
    assert "not decided within" in answer.steps[0].outcome


def test_what_comes_after_exploring_keeps_the_time_too(monkeypatch):
    """Every look at the policy takes a second, of which there are five."""
    plan, clock = read_plan(str(PLANS / "patrol")), [0.0]
    monkeypatch.setattr(watch, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    question = MarkingQuestion(NEVER, " + ".join(plan.net.place_index) + " >= 100 * sqrt(1)")
    look = PolicyTable.choices

    def slow_look(*given):
        clock[0] += 1.0
        return look(*given)

    monkeypatch.setattr(PolicyTable, "choices", slow_look)
    answer = decide_question(plan, question, seconds=5.0)
    assert answer.verdict == NOT_DECIDED and 5.0 < clock[0] < 7.0
    assert "not decided within 5 s (6 answers of the policy)" in answer.steps[-2].outcome
    assert answer.steps[-1].outcome == "no time was left"


def test_the_check_proves_what_its_markings_leave_open(monkeypatch):
    plan = read_plan(str(PLANS / "inspection"))
    whole = check(plan).of("dead_markings")
    (item,) = check(plan, limit=20).of("dead_markings")
    assert [i.severity for i in whole] == [item.severity] == [Severity.OK]
    assert item.details["decided_by"] == "state equation"
    assert "no dead marking can be reached" in item.text
    (open_item,) = check(plan, limit=20, seconds=0).of("dead_markings")
    assert open_item.details["undecided"] and "was not decided within" in open_item.text


def test_without_the_solver_the_ladder_is_shorter_and_says_so(monkeypatch):
    monkeypatch.setattr(prover, "solver_available", lambda: False)
    assert never_dead(read_plan(str(PLANS / "inspection"))), "invariants are enough"
    plan = read_plan(str(PLANS / "fork_join"))
    answer = decide_question(plan, MarkingQuestion(DEAD), limit=0)
    assert answer.verdict == NOT_DECIDED
    assert "needs SciPy 1.7" in answer.steps[0].outcome
    assert decide_question(plan, MarkingQuestion(DEAD)).decided_by == "exploration"


# -- witnesses -------------------------------------------------------------------------------------


def test_a_witness_is_found_far_beyond_the_markings_that_can_be_visited(tmp_path):
    """Robots of a narrow site wait for each other for ever."""
    plan = site(tmp_path, node_capacity=1)
    report = check(plan, limit=100)
    (item,) = report.of("dead_markings")
    assert item.severity is Severity.WARNING and "dead marking" in item.text
    problem = problem_of(plan, MarkingQuestion(DEAD))
    marking = played_to(problem, item.details["sequence"])
    assert not any(problem.fires(marking))


def test_who_can_only_be_stuck_after_a_loss_is_told_so():
    plan = read_plan(str(PLANS / "rendezvous"))
    report = check(plan, limit=1)
    (item,) = report.of("dead_markings")
    assert item.severity is Severity.OK and "as long as no robot is lost" in item.text
    (lost,) = report.of("dead_after_loss")
    assert any(name.startswith("(robot lost in") for name in lost.details["sequence"])


def test_a_report_has_what_proofs_and_searches_find_beyond_its_limit():
    table = NetBuilder("philosophers")
    for i in range(12):
        table.place("fork%d" % i, tokens=1).place("thinks%d" % i, tokens=1)
        table.place("left%d" % i).place("eats%d" % i)
    for i in range(12):
        forks = ["fork%d" % i, "fork%d" % ((i + 1) % 12)]
        table.exponential("take%d" % i, inputs=["thinks%d" % i, forks[0]], outputs="left%d" % i)
        table.exponential("more%d" % i, inputs=["left%d" % i, forks[1]], outputs="eats%d" % i)
        table.exponential("end%d" % i, inputs="eats%d" % i, outputs=["thinks%d" % i, *forks])
    net = table.build()
    asked = Questions(rewards={}, reach=("eats0 + eats1 >= 2", "eats0 + eats2 + eats4 >= 3"))
    data = report(Analysis(net, limit=50), asked)
    assert [found["reachable"] for found in data["reach"]] == [False, True]
    marking = net.initial_marking
    for name in data["deadlocks"]["witness"]:
        marking = net.fire(marking, net.transition_number(name))
    assert net.named(marking, zeros=False) == data["deadlocks"]["marking"]
    assert not net.enabled(marking) and data["deadlocks"]["count"] == 1


# -- conditions ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        *SHAPES,
        "0.25 * (%(a)s + 1) - %(b)s < -%(m)d",
        "true",
        "not max(%(a)s, 2 * %(b)s, 3) - min(%(a)s, %(b)s, %(m)d) >= 3 or min(%(a)s) == 5",
        "abs(%(a)s - %(b)s) / 2 != max(min(%(a)s, %(m)d), %(n)d)",
    ],
)
def test_a_condition_means_the_same_as_inequalities(text):
    draw = random.Random(1)
    condition = parse_condition(text % {"a": "a", "b": "b", "m": 2, "n": 1}, ["a", "b"])
    formula = formula_of(condition)
    for _ in range(200):
        marking = draw.randint(0, 5), draw.randint(0, 5)
        assert fulfils(formula, marking) == condition.holds(marking), marking


@pytest.mark.parametrize("text", ["a * b > 1", "sqrt(a) > 1", "a / 3 > 1", "0.1 * a > 1"])
def test_what_is_not_linear_is_left_to_exploration(text):
    with pytest.raises(LimitError):
        formula_of(parse_condition(text, ["a", "b"]))
    answer = decide_question(trapped(), MarkingQuestion(NEVER, text), limit=50)
    assert answer.steps[0].outcome == "the condition is not linear"


# -- certificates ----------------------------------------------------------------------------------


def proof(subject, question):
    """A problem and the certificate that what it asks for cannot be reached."""
    answer = decide_question(subject, question, limit=0)
    assert answer.verdict == PROVEN
    return problem_of(subject, question), json.loads(json.dumps(answer.certificate))


def numbers_in(value, path=()):
    """The paths of all whole numbers in a certificate."""
    if isinstance(value, dict):
        for key in value:
            yield from numbers_in(value[key], (*path, key))
    elif isinstance(value, list):
        for key, item in enumerate(value):
            yield from numbers_in(item, (*path, key))
    elif type(value) is int:
        yield path


def put(value, path, new):
    """The certificate with another value at a path."""
    changed = copy.deepcopy(value)
    part = changed
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = new
    return changed


def wide():
    """A net whose proofs take lemmas, steps, cases and sums: two robots share a key and two
    rooms."""
    builder = NetBuilder("wide").place("key", tokens=1).place("log")
    for robot in "xy":
        builder.place(robot + "_out", tokens=1).place(robot + "_in").place(robot + "_at_work")
        builder.exponential(robot + "_take", inputs=[robot + "_out", "key"], outputs=robot + "_in")
        builder.exponential(robot + "_do", inputs=robot + "_in", outputs=robot + "_at_work")
        builder.exponential(
            robot + "_give",
            inputs=robot + "_at_work",
            outputs=[robot + "_out", "key", "log"],
        )
    return builder.build()


BAD = "x_in + y_in + x_at_work + y_at_work >= 2 or x_out + x_in >= 2"

FORGED = {
    "no lemmas": lambda c: {**c, "lemmas": []},
    "no tree": lambda c: {"lemmas": c["lemmas"]},
    "an empty tree": lambda c: {**c, "tree": []},
    "an empty node": lambda c: {**c, "tree": [{}]},
    "an end without reason": lambda c: with_tree(c, end=[]),
    "a reason that is a number": lambda c: with_tree(c, end=3),
    "a fact that is not there": lambda c: with_tree(c, end=[[1, 999, 0]]),
    "a negative multiple": lambda c: with_tree(c, end=[[-1, 0, 0], [1, 1, 0]]),
    "a fraction of a fact": lambda c: with_tree(c, end=[[0.5, 0, 0]] * 2),
    "a fact that may hold": lambda c: with_tree(c, end=[[1, len(c["lemmas"]), 0]]),
    "a lemma that fails at the start": lambda c: with_lemma(c, {"key": 1}, 2),
    "a lemma that fails later": lambda c: with_lemma(c, {"key": 1}, 1),
    "a lemma of half tokens": lambda c: with_lemma(c, {"key": 0.5}, 0),
    "a lemma of no place": lambda c: with_lemma(c, {"nowhere": 1}, 0),
    "a lemma that bounds what grows": lambda c: with_lemma(c, {"log": -1}, -5),
    "a step without reason": lambda c: with_tree(c, [[0, False, 0, []]], end=[[1, 0, 0]]),
    "a step of no place": lambda c: with_tree(c, [[99, False, 0, [[1, 0, 0]]]], end=[[1, 0, 0]]),
    "half a token": lambda c: with_tree(c, [[0, False, 0.5, [[1, 0, 0]]]], end=[[1, 0, 0]]),
    "one case of two": lambda c: with_tree(c, cases=[0, 0, 1]),
    "a gap between the cases": lambda c: with_tree(c, cases=[0, 0.5, 1, 1]),
    "a node that refers to itself": lambda c: with_tree(c, cases=[0, 0, 0, 0]),
    "no markings": lambda c: {"markings": 0},
    "too few markings": lambda c: {"markings": 5},
    "markings of another net": lambda c: {"markings": 600},
    "too many markings to visit": lambda c: {"markings": 10**12},
    "a list": lambda c: [c],
    "nothing": lambda c: None,
}


def with_lemma(certificate, weights, least):
    lemma = {"some": [[weights, least]]}
    return {**certificate, "lemmas": [*certificate["lemmas"], lemma]}


def with_tree(certificate, steps=(), **last):
    """The certificate with another root before its nodes."""
    return {**certificate, "tree": [{"steps": steps, **last}, *certificate["tree"]]}


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_certificate_is_refused(name):
    problem, certificate = proof(wide(), MarkingQuestion(NEVER, BAD))
    check_certificate(problem, certificate)
    with pytest.raises(ProofError):
        check_certificate(problem, FORGED[name](certificate))


def test_a_certificate_of_something_else_is_refused():
    _, certificate = proof(wide(), MarkingQuestion(NEVER, BAD))
    for other in ("x_in + y_in >= 1", "log >= 3", "x_out + x_in >= 1"):
        with pytest.raises(ProofError):
            check_certificate(problem_of(wide(), MarkingQuestion(NEVER, other)), certificate)


def test_changed_numbers_prove_nothing_that_is_not_so():
    """Of what can be reached, no certificate is accepted, whatever numbers stand in it."""
    _, certificate = proof(wide(), MarkingQuestion(NEVER, BAD))
    reachable = problem_of(
        wide(), MarkingQuestion(NEVER, "x_in + y_in + x_at_work + y_at_work >= 1")
    )
    draw = random.Random(7)
    paths = list(numbers_in(certificate))
    assert len(paths) > 30
    for _ in range(2_000):
        forged = certificate
        for path in draw.sample(paths, draw.randint(1, 3)):
            forged = put(forged, path, draw.choice([-2, -1, 0, 1, 2, 3, 10**400]))
        with pytest.raises(ProofError):
            check_certificate(reachable, forged)


def test_a_witness_that_does_not_play_is_refused():
    problem = problem_of(wide(), MarkingQuestion(NEVER, "log >= 1"))
    good = ["x_take", "x_do", "x_give"]
    played_to(problem, good)
    for bad in (good[:2], ["x_do"], ["x_take", "y_take"], ["nobody"], []):
        with pytest.raises(ProofError):
            played_to(problem, bad)


def test_the_checker_is_small_and_imports_no_solver():
    assert len(Path(checker.__file__).read_text("utf-8").splitlines()) < 400
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys, gspn_framework_package.analysis.proofs.checker, "
            "gspn_framework_package.analysis.proofs.questions, gspn_framework_package.cli.verify; "
            "print([name for name in sys.modules if name.endswith(('numpy', 'scipy', 'prover'))])",
        ],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert done.stdout == "[]\n"
