"""What can be reached again from everywhere, and the most tokens in places: proofs are never wrong,
and need no markings where distances show the way."""

import json
import os
import random
import threading
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from asked_markings import SHAPES
from generated_nets import bounded_nets, reference_space
from generated_plans import small_plans
from hypothesis import HealthCheck, assume, given, settings
from scipy.optimize import OptimizeResult

from gspn_framework_package.analysis import watch as watch_module
from gspn_framework_package.analysis.graph import can_reach
from gspn_framework_package.analysis.plan.markings import PlanMarkings
from gspn_framework_package.analysis.plan.structure import terminal_places
from gspn_framework_package.analysis.proofs import inductive, ladder, returning, witness
from gspn_framework_package.analysis.proofs.checker import (
    CountBox,
    ProofError,
    check_certificate,
)
from gspn_framework_package.analysis.proofs.homing import Homing
from gspn_framework_package.analysis.proofs.ladder import (
    NOT_DECIDED,
    PROVEN,
    VIOLATED,
    decide_question,
)
from gspn_framework_package.analysis.proofs.prover import solver_available
from gspn_framework_package.analysis.proofs.questions import (
    AT_MOST,
    CAN_END,
    CAN_MOVE,
    NEVER,
    RETURNS,
    MarkingQuestion,
    problem_of,
)
from gspn_framework_package.analysis.proofs.returning import settling
from gspn_framework_package.analysis.proofs.witness import played_to
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.registry import write_net
from gspn_framework_package.making.site_plan import build_site_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.errors import CancelledError, LimitError, UsageError
from gspn_framework_package.model.net import Arc, Net, Place
from gspn_framework_package.model.plan import Plan, RobotSpec

PLANS = Path(__file__).parents[3] / "plans"
EXAMPLES = int(os.environ.get("GSPN_RETURNING_EXAMPLES", "20"))

pytestmark = pytest.mark.skipif(
    not solver_available(), reason="this SciPy has no solver for the state equation"
)


def questions_about(subject, seed):
    draw = random.Random(seed)
    net = subject if isinstance(subject, Net) else subject.net
    names = [place.name for place in net.places]
    for losses in (False,) if subject is net else (False, True):
        for shape in draw.sample(SHAPES, 2):
            counts = {"m": draw.randint(0, 2), "n": draw.randint(0, 1)}
            pair = dict(zip("ab", draw.sample(names, 2)))
            yield MarkingQuestion(RETURNS, shape % {**counts, **pair}, losses)
        yield MarkingQuestion(AT_MOST, "%s=%d" % (draw.choice(names), draw.randint(0, 2)), losses)
        if subject is not net and (subject.until or terminal_places(subject)):
            yield MarkingQuestion(CAN_END, losses=losses)
        if subject is not net:
            yield MarkingQuestion(CAN_MOVE, losses=losses)


def holds_everywhere(subject, question):
    """The answer by visiting all markings; None if there are too many."""
    if isinstance(subject, Net):
        graph = reference_space(subject)
        names = [place.name for place in subject.places]
        if question.kind == AT_MOST:
            place, _, most = question.about.partition("=")
            return max(m[names.index(place)] for m in graph) <= int(most)
        good = {m for m in graph if parse_condition(question.about, names).holds(m)}
        while True:
            more = {m for m in set(graph) - good if good & set(graph[m].values())}
            if not more:
                return good == set(graph)
            good |= more
    kept = [place.name for place in subject.net.places]
    markings = PlanMarkings(subject, 2_000, losses=question.losses, keep=kept)
    space = markings.space
    if not markings.complete:
        return None
    if question.kind == AT_MOST:
        place, _, most = question.about.partition("=")
        return not (space.holds("%s > %s" % (place, most)) & markings.reached).any()
    arcs = markings.possible
    sources, targets = space.sources[arcs], space.targets[arcs]
    if question.kind == CAN_MOVE:
        return all(can_leave(subject, markings, p, sources, targets) for p in robots_of(markings))
    if question.kind == CAN_END:
        ends = {subject.net.places[p].name for p in terminal_places(subject)}
        good = np.ones(len(space), dtype=bool)
        for p, place in enumerate(markings.net.places):
            if place.name not in ends and place.name not in subject.resource_places:
                good &= space.column(p) == 0
        if subject.until:
            good |= space.holds(subject.until)
    else:
        good = space.holds(question.about)
    back = can_reach(len(space), sources, targets, good)
    return bool((back | ~markings.reached).all())


def robots_of(markings):
    places = markings.net.places
    ends = {markings.plan.net.places[p].name for p in terminal_places(markings.plan)}
    outside = ends | set(markings.plan.resource_places)
    return [p for p, place in enumerate(places) if place.name not in outside]


def can_leave(plan, markings, p, sources, targets):
    """Whether a robot in a place can leave it or the run can end, whatever happened before."""
    space = markings.space
    own = len(plan.net.transitions)
    exits = [t for t in markings.net.consumers[p] if t < own]
    good = np.zeros(len(space), dtype=bool)
    good[sources[np.isin(space.transitions[markings.possible], exits)]] = True
    if plan.until:
        good |= space.holds(plan.until)
    back = can_reach(len(space), sources, targets, good)
    return bool((back | (space.column(p) == 0) | ~markings.reached).all())


@pytest.mark.parametrize("limit", [1, 2_000])
@pytest.mark.parametrize("subjects", [bounded_nets(), small_plans()], ids=["nets", "plans"])
def test_answers_are_those_of_visiting_all_markings(subjects, limit, monkeypatch):
    for name, most in (("FIRST_MARKINGS", 50), ("MOST_SEARCHED", 100), ("MOST_WALKS", 2)):
        monkeypatch.setattr(witness, name, most)
    monkeypatch.setattr(witness, "LONGEST_WALK", 50)
    count = Counter()

    @settings(derandomize=True, max_examples=EXAMPLES, deadline=None)
    @given(subjects)
    def ask(subject):
        for question in questions_about(subject, sum(count.values())):
            expected = holds_everywhere(subject, question)
            answer = decide_question(subject, question, limit=limit, seconds=60.0)
            count[answer.verdict] += 1
            problem = problem_of(subject, question)
            if answer.verdict == PROVEN:
                assert expected in (True, None), (question, answer)
                check_certificate(problem, json.loads(json.dumps(answer.certificate)))
            elif answer.verdict == VIOLATED:
                assert expected in (False, None), (question, answer)
                assert problem.is_bad(played_to(problem, answer.sequence))
            else:
                assert limit == 1 or expected is None, (question, answer)

    ask()
    assert count[PROVEN] > EXAMPLES / 3 and count[VIOLATED] > EXAMPLES / 3


def switches(number):
    builder = NetBuilder("switches")
    for i in range(number):
        builder.place("on%d" % i, tokens=1).place("off%d" % i)
        builder.exponential("down%d" % i, inputs="on%d" % i, outputs="off%d" % i)
        builder.exponential("up%d" % i, inputs="off%d" % i, outputs="on%d" % i)
    return builder


def test_a_return_is_proven_without_visiting_2_to_the_60_markings():
    net = switches(60).build()
    everything = " and ".join("on%d = 1" % i for i in range(60))
    answer = decide_question(net, MarkingQuestion(RETURNS, everything), limit=0)
    assert answer.verdict == PROVEN and "markings" not in answer.certificate
    broken = switches(8).place("gone").exponential("break", inputs="on3", outputs="gone").build()
    answer = decide_question(broken, MarkingQuestion(RETURNS, "on3 = 1"), limit=100)
    assert answer.verdict == VIOLATED and answer.marking["gone"] == 1


def test_what_goes_before_may_prevent_a_return():
    """The way back is enabled, but what is immediate goes before it."""
    builder = switches(1).place("loop", tokens=1)
    builder.immediate("again", inputs=["off0", "loop"], outputs=["off0", "loop"])
    answer = decide_question(builder.build(), MarkingQuestion(RETURNS, "on0 = 1"))
    assert answer.verdict == VIOLATED and answer.sequence == ("down0",)


def test_too_many_markings_follow(monkeypatch):
    monkeypatch.setattr(returning, "MOST_FOLLOWED", 50)
    net = switches(8).build()
    question = MarkingQuestion(RETURNS, "min(on1, on2) > 1")
    answer = decide_question(net, question)
    assert answer.verdict == NOT_DECIDED
    assert "too many markings follow" in answer.steps[-1].outcome


@pytest.fixture
def work_clock(monkeypatch):
    """A clock that only work moves on: each firing, each fact that is held against counts, a linear
    program as long as it may, and a wait for z3."""
    now = [0.0]

    def takes_time(function, seconds):
        def timed(*given, **more):
            now[0] += seconds
            return function(*given, **more)

        return timed

    def never_ends(*given, options, **more):
        now[0] += options["time_limit"]
        return OptimizeResult(x=None, status=1)

    class Awaited(threading.Thread):
        def join(self, timeout=None):
            now[0] += timeout or 0.0
            super().join(timeout)

    monkeypatch.setattr(watch_module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(inductive, "threading", SimpleNamespace(Thread=Awaited))
    monkeypatch.setattr(Net, "fire", takes_time(Net.fire, 0.01))
    monkeypatch.setattr(CountBox, "allows", takes_time(CountBox.allows, 0.0001))
    monkeypatch.setattr("scipy.optimize.linprog", never_ends)
    return now


@pytest.mark.parametrize(
    ("subject", "kind", "about"),
    [
        ("switches", RETURNS, "min(on1, on2) > 1"),
        ("switches", RETURNS, "on1 + on2 + on3 = 0"),
        ("hall", RETURNS, "At_n0_full = 10 and At_n4_full = 10"),
        ("hall", NEVER, "At_n0_full * At_n4_full > 400"),
        ("hall", CAN_MOVE, ""),
        ("narrow", CAN_MOVE, ""),
    ],
)
def test_every_step_keeps_the_budget(subject, kind, about, work_clock, tmp_path, monkeypatch):
    monkeypatch.setattr(ladder, "PLACES_EXPLORED", 0)
    subject = {
        "switches": lambda: switches(20).build(),
        "hall": lambda: hall(20, tmp_path),
        "narrow": lambda: narrow(12, tmp_path),
    }[subject]()
    for seconds in (0.5, 3.0):
        begun = work_clock[0]
        decide_question(subject, MarkingQuestion(kind, about), limit=0, seconds=seconds)
        assert work_clock[0] - begun <= 1.1 * seconds + 0.2


def test_the_look_at_what_follows_can_be_cancelled(monkeypatch):
    fired = []
    fire = Net.fire
    monkeypatch.setattr(Net, "fire", lambda *given: fired.append(given) or fire(*given))
    question = MarkingQuestion(RETURNS, "min(on1, on2) > 1")
    with pytest.raises(CancelledError):
        decide_question(switches(20).build(), question, cancel=lambda: len(fired) > 100)
    assert len(fired) < 150


def test_what_settles_makes_a_sum_of_tokens_smaller():
    """Two parts of a token, of which one goes around in a circle and the other does not."""
    builder = NetBuilder("settling")
    for name in ("whole", "left", "right", "end", "back"):
        builder.place(name)
    builder.exponential("part", inputs="whole", outputs=["left", "right", "right"])
    builder.exponential("end_left", inputs="left", outputs="end")
    builder.exponential("turn", inputs="right", outputs="back")
    builder.exponential("return", inputs="back", outputs="right")
    net = builder.build()
    found = {net.transitions[t].name for t in settling(net, range(4))}
    assert {"part", "end_left"} < found and found != {"part", "end_left", "turn", "return"}


def hall(robots, folder, **more):
    """Robots with batteries on a ring of nodes, who wait while no task is due."""
    nodes = {"n%d" % i: [4 * i, 0] for i in range(8)}
    edges = [["n%d" % i, "n%d" % ((i + 1) % 8)] for i in range(8)]
    tasks = {
        "plan": "hall",
        "start": ["n0", "n4"],
        "tasks": {"Work": {"at": ["n2", "n7"], "seconds": 9, "again_after": 60}},
        "battery": {"full": 0.1, "low": 0.1},
        "docks": {"n0": 1, "n4": 1},
        **more,
    }
    for name, data in (("map.yaml", {"nodes": nodes, "edges": edges}), ("tasks.yaml", tasks)):
        (folder / name).write_text(json.dumps(data), "utf-8")
    made = build_site_plan(str(folder / "map.yaml"), str(folder / "tasks.yaml"), robots)
    made.write(str(folder / "plan"))
    return read_plan(str(folder / "plan"))


def test_robots_that_wait_for_tasks_do_not_wait_for_ever(tmp_path):
    """Nobody moves while no task is due. But all actions end, then all tasks are due, and everybody
    can move."""
    plan = hall(20, tmp_path)
    due = " and ".join(name + " = 1" for name in plan.net.place_index if name.startswith("Due_"))
    for question in (MarkingQuestion(CAN_MOVE), MarkingQuestion(RETURNS, due)):
        for losses in (False, True):
            question = question._replace(losses=losses)
            answer = decide_question(plan, question, limit=0)
            assert answer.verdict == PROVEN and answer.decided_by == "structure"


HOME = "At_n0_full = 10 and At_n4_full = 10"


def test_robots_get_home_one_after_another(tmp_path):
    """No firing leads everybody nearer to the first places, but one robot gets there while the
    others rest, whatever has happened."""
    plan, question = hall(20, tmp_path), MarkingQuestion(RETURNS, HOME)
    answer = decide_question(plan, question, limit=0)
    assert answer.verdict == PROVEN and answer.decided_by == "ways home"
    certificate = json.loads(json.dumps(answer.certificate))
    assert "ways" in check_certificate(problem_of(plan, question), certificate)
    lost = question._replace(losses=True)
    with pytest.raises(ProofError):
        check_certificate(problem_of(plan, lost), certificate)
    for other in ("At_n0_full = 11", "At_n0_full = 10 and Fresh_Work_n2 = 1"):
        with pytest.raises(ProofError):
            check_certificate(problem_of(plan, MarkingQuestion(RETURNS, other)), certificate)
    ways, distances = certificate["ways"], certificate["distances"]
    assert len(ways) > 10 and certificate["back"]
    for forged in (
        {"ways": ways[1:]},
        {"ways": ways[-1:]},
        {"ways": [way[:-1] for way in ways]},
        {"ways": [[] for _ in ways]},
        {"ways": [*ways, ["no_transition"]]},
        {"ways": [*ways, ["Go_n0_n1_full"]]},
        {"distances": {}},
        {"distances": {**distances, "At_n7_full": -1}},
        {"distances": {**distances, "At_n7_full": 0.5}},
        {"distances": {**distances, "nowhere": 1}},
        {"distances": {**distances, "At_n7_full": 99}},
        {"end": {}},
        {"end": {**certificate["end"], "At_n0_full": 19}},
        {"back": []},
        {"back": certificate["back"][1:]},
        {"rest": {"lemmas": [], "tree": certificate["rest"]["tree"]}},
        {"rest": None},
    ):
        with pytest.raises(ProofError):
            check_certificate(problem_of(plan, question), {**certificate, **forged})


def test_robots_that_hold_narrow_nodes_get_home():
    """In a depot, one robot fits in a node: those in an aisle wait for each other. What nobody moves
    at first is seen to move again, since all come home."""
    plan = read_plan(str(PLANS / "depot"))
    for question in (MarkingQuestion(RETURNS, "At_yard_full = 8"), MarkingQuestion(CAN_MOVE)):
        answer = decide_question(plan, question, limit=0)
        assert answer.verdict == PROVEN and answer.decided_by == "ways home"
        check_certificate(problem_of(plan, question), json.loads(json.dumps(answer.certificate)))
        lost = problem_of(plan, question._replace(losses=True))
        with pytest.raises(ProofError):
            check_certificate(lost, answer.certificate)


def test_the_ways_home_need_what_holds(tmp_path):
    """A run that ends, a robot that rests where no way leads home, and a resource that does not come
    back."""
    plan, question = hall(2, tmp_path), MarkingQuestion(RETURNS, "At_n0_full = 1")
    assert problem_of(plan, question).robots
    assert not problem_of(replace(plan, until="At_n2_full > 1"), question).robots
    elsewhere = MarkingQuestion(RETURNS, "At_n1_full = 1")
    assert not problem_of(plan, elsewhere).robots, "it is not the first marking"
    watch = watch_module.Watch()
    with pytest.raises(LimitError):
        problem = problem_of(ending(3, True), MarkingQuestion(RETURNS, "a = 3"))
        Homing(problem, watch).certificate()
    net = plan.net.with_place(Place("fuel", tokens=99)).with_arc(Arc("fuel", "Go_n0_n1_full"))
    using = replace(plan, net=net, resource_places=plan.resource_places | {"fuel"})
    with pytest.raises(LimitError):
        Homing(problem_of(using, question), watch).certificate()


def narrow(robots, folder):
    """Robots that charge at one end of a lane of nodes for one each, where they work at the other;
    one node is beside it."""
    graph = {
        "nodes": {"hall": [0, 0], "mid": [5, 0], "far": [15, 0], "near": [0, 5]},
        "edges": [["hall", "mid"], ["mid", "far"], ["hall", "near"]],
    }
    tasks = {
        "start": ["hall"],
        "tasks": {
            "Look": {"at": ["far"], "seconds": 5, "again_after": 20},
            "See": {"at": ["near"], "seconds": 5, "again_after": 20},
        },
        "battery": {"full": 0.2, "low": 0.2},
        "docks": {"hall": robots},
        "nodes": {"mid": {"capacity": 1}, "far": {"capacity": 1}},
    }
    for name, data in (("map.yaml", graph), ("tasks.yaml", tasks)):
        (folder / name).write_text(json.dumps(data))
    made = build_site_plan(str(folder / "map.yaml"), str(folder / "tasks.yaml"), robots)
    made.write(str(folder / "plan"))
    return read_plan(str(folder / "plan"))


def test_robots_that_block_each_other_while_others_go_on_are_found_by_walking(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(ladder, "PLACES_EXPLORED", 0)
    monkeypatch.setattr(ladder, "SHORTENING", 60.0)
    for robots, verdict in ((1, PROVEN), (12, VIOLATED)):
        (tmp_path / str(robots)).mkdir()
        plan = narrow(robots, tmp_path / str(robots))
        question = MarkingQuestion(CAN_MOVE)
        answer = decide_question(plan, question)
        assert answer.verdict == verdict
    assert answer.decided_by == "random walks"
    assert {"At_mid_full", "At_far_low"} <= set(answer.marking)
    problem = problem_of(plan, question)
    played_to(problem, answer.sequence)
    # two robots are at fault, and what the others did is left out
    assert sum(name.startswith("Go_hall") for name in answer.sequence) <= 4
    for left_out in range(len(answer.sequence)):
        with pytest.raises(ProofError):
            played_to(problem, answer.sequence[:left_out] + answer.sequence[left_out + 1 :])


def test_how_far_walks_go_grows_with_the_team(tmp_path, monkeypatch):
    monkeypatch.setattr(ladder, "PLACES_EXPLORED", 0)
    monkeypatch.setattr(ladder, "FIRST_FIRINGS", 1)
    monkeypatch.setattr(ladder, "FIRINGS_OF_EACH", 40)
    answer = decide_question(narrow(12, tmp_path), MarkingQuestion(CAN_MOVE), limit=0)
    assert [step.name for step in answer.steps] == ["random walks"]


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
@given(small_plans())
def test_who_is_surely_stuck_is(plan):
    problem = problem_of(plan, MarkingQuestion(CAN_MOVE))
    graph = {problem.net.initial_marking: []}
    waiting = list(graph)
    while waiting:
        marking = waiting.pop()
        for t in problem.fires(marking):
            graph[marking].append((t, problem.net.fire(marking, t)))
            if graph[marking][-1][1] not in graph:
                graph[graph[marking][-1][1]] = []
                waiting.append(graph[marking][-1][1])
        assume(len(graph) < 500)
    assume(problem.surely is not None)
    ends = {plan.net.places[p].name for p in terminal_places(plan)}
    outside = ends | set(plan.resource_places)
    robots = [p for p, place in enumerate(problem.net.places) if place.name not in outside]
    for marking in graph:
        if problem.surely(marking):
            after, waiting = {marking}, [marking]
            left = set()
            while waiting:
                for t, other in graph[waiting.pop()]:
                    left |= {p for p, _ in problem.net.inputs[t]}
                    if other not in after:
                        after.add(other)
                        waiting.append(other)
            assert any(marking[p] and p not in left for p in robots)


def ending(robots, stuck):
    """Robots go from a to the end, or get stuck in b."""
    builder = NetBuilder("ending").place("a", tokens=robots).place("b").place("end")
    builder.exponential("finish", inputs="a", outputs="end")
    builder.exponential("stray", inputs="a", outputs="b")
    if stuck:
        builder.place("key").exponential("leave", inputs=["b", "key"], outputs=["end", "key"])
    else:
        builder.exponential("leave", inputs="b", outputs="end")
    act = FunctionAction("actions.work", "work")
    return Plan(
        net=builder.build(),
        resource_places=frozenset(["key"] if stuck else []),
        robots=tuple(RobotSpec("r%d" % i, "a") for i in range(robots)),
        actions={"a": act, "b": act, "end": None},
    )


def test_the_end_is_reached_from_everywhere_or_not():
    question = MarkingQuestion(CAN_END)
    answer = decide_question(ending(200, False), question, limit=0)
    assert answer.verdict == PROVEN and answer.decided_by in ("structure", "state equation")
    answer = decide_question(ending(3, True), question)
    assert answer.verdict == VIOLATED and "stray" in answer.sequence
    assert decide_question(ending(200, False), MarkingQuestion(CAN_MOVE), limit=0).verdict == PROVEN
    answer = decide_question(ending(3, True), MarkingQuestion(CAN_MOVE))
    assert answer.verdict == VIOLATED and answer.marking["b"] >= 1
    cycle = Plan(
        net=switches(1).build(),
        robots=(RobotSpec("r", "on0"),),
        actions=dict.fromkeys(("on0", "off0"), FunctionAction("actions.work", "work")),
    )
    with pytest.raises(UsageError, match="the plan has no end"):
        problem_of(cycle, question)
    with pytest.raises(UsageError, match="a net has no"):
        problem_of(cycle.net, question)


def test_the_command(tmp_path, capsys):
    path, proofs = tmp_path / "switches.pnpro", tmp_path / "proofs.json"
    write_net(switches(3).build(), path)
    words = ["check", str(path), "--returns", "on0 + on1 + on2 = 3", "--at-most", "o*=1"]
    assert main([*words, "--certificate", str(proofs)]) == 0
    out = capsys.readouterr().out
    assert "proven       on0 + on1 + on2 = 3 can be reached from every marking" in out
    assert "proven       never more tokens than o*=1" in out
    assert main(["verify", str(proofs)]) == 0
    assert main([*words, "--at-most", "on0=0"]) == 1
    assert (
        "violated     never more tokens than on0=0: nothing: at the start"
        in capsys.readouterr().out
    )
    assert main(["check", str(path), "--at-most", "on0"]) == 2
    assert "'on0' is not a pattern and a number" in capsys.readouterr().err
    assert main(["check", str(path), "--ends"]) == 2
    assert "a net has no policy, and no robots that end" in capsys.readouterr().err
