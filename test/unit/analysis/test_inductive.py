"""Inductive invariants: what z3 says is shown by a certificate or played, and never believed."""

import copy
import json
import sys
from collections import Counter

import pytest
from asked_markings import can_be_reached, questions_about
from generated_nets import bounded_nets
from generated_plans import small_plans
from hypothesis import given, settings

from gspn_framework_package.analysis.proofs import ladder
from gspn_framework_package.analysis.proofs.checker import (
    Atom,
    CountBox,
    ProofError,
    Some,
    check_certificate,
    check_tree,
)
from gspn_framework_package.analysis.proofs.inductive import search_inductive
from gspn_framework_package.analysis.proofs.ladder import NOT_DECIDED, PROVEN, decide_question
from gspn_framework_package.analysis.proofs.questions import NEVER, MarkingQuestion, problem_of
from gspn_framework_package.analysis.proofs.witness import GuidedSearch, played_to
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import CancelledError, LimitError


def desk(first=True):
    """A desk that grows without bound, at which what is asked for is noted and filed before
    anything else happens; without ``first``, at some time."""
    builder = NetBuilder("desk").place("asked").place("noted").place("log")
    add = builder.immediate if first else builder.exponential
    builder.exponential("ask", outputs="asked")
    add("note", inputs="asked", outputs="noted")
    add("file", inputs="noted", outputs={"log": 2})
    builder.exponential("lose", inputs="log")
    return builder.build()


TWO_AT_WORK = MarkingQuestion(NEVER, "asked >= 2 or noted >= 2")

ONE_ASKED, ONE_NOTED = {"some": [[{"asked": -1}, -1]]}, {"some": [[{"noted": -1}, -1]]}
NOT_BOTH = {"some": [[{"asked": -1}, 0], [{"noted": -1}, 0]]}


def follows(*steps, end):
    """A proof of one node, without lemmas of its own. Facts 0 to 2 are the three lemmas."""
    return {"lemmas": [], "tree": [{"steps": list(steps), "end": end}]}


# where one firing is possible, what fires before it is not: then its lemma holds afterwards
CERTIFICATE = {
    "lemmas": [
        {**ONE_ASKED, "kept": {"ask": follows([0, False, 0, [[1, 3, 0]]], end=[[1, 5, 0]])}},
        {
            **ONE_NOTED,
            "kept": {
                "note": follows(
                    [0, True, 1, [[1, 3, 0]]], [1, False, 0, [[1, 2, 0]]], end=[[1, 4, 0]]
                )
            },
        },
        {
            **NOT_BOTH,
            "kept": {
                "ask": follows([1, False, 0, [[1, 4, 0]]], end=[[1, 5, 0]]),
                "note": follows([0, False, 1, [[1, 0, 0]]], end=[[1, 4, 0]]),
            },
        },
    ],
    "tree": [
        {
            "steps": [[0, False, 1, [[1, 0, 0]]], [1, False, 1, [[1, 1, 0]]]],
            "end": [[1, 3, 0]],
        }
    ],
}


def changed(*path, to=None):
    """The certificate with another value at a path; without one, nothing is there."""
    forged = copy.deepcopy(CERTIFICATE)
    part = forged
    for key in path[:-1]:
        part = part[key]
    if to is None:
        del part[path[-1]]
    else:
        part[path[-1]] = to
    return forged


def nested(depth):
    """A proof in a proof in a proof."""
    proof = {"lemmas": [], "tree": []}
    for _ in range(depth):
        proof = {"lemmas": [{**ONE_ASKED, "kept": {"ask": proof}}], "tree": []}
    return proof


FORGED = {
    "a lemma without its proofs": changed("lemmas", 0, "kept"),
    "a proof for one of two transitions": changed("lemmas", 2, "kept", "ask"),
    "the proof of another transition": changed(
        "lemmas", 2, "kept", "note", to=CERTIFICATE["lemmas"][2]["kept"]["ask"]
    ),
    "a lemma that the others need is missing": changed("lemmas", 2),
    "a lemma that is too strong": changed("lemmas", 0, "some", 0, 1, to=0),
    "a lemma that fails at the start": changed("lemmas", 0, "some", 0, 1, to=1),
    "a lemma of nothing": changed("lemmas", 1, "some", to=[]),
    "a step that does not follow": changed(
        "lemmas", 1, "kept", "note", "tree", 0, "steps", 0, 2, to=-1
    ),
    "a reason that is none": changed("lemmas", 1, "kept", "note", "tree", 0, "end", to=[[1, 0, 0]]),
    "visited markings": changed("lemmas", 1, "kept", "note", to={"markings": 3}),
    "ways home": changed("lemmas", 1, "kept", "note", to={"ways": [], "rest": {"markings": 1}}),
    "no proof": changed("lemmas", 1, "kept", "note", to=7),
    "a list of proofs": changed("lemmas", 1, "kept", to=["note"]),
    "proofs without end": nested(3_000),
}


def test_lemmas_that_need_each_other_are_accepted():
    check_certificate(problem_of(desk(), TWO_AT_WORK), CERTIFICATE)


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_certificate_is_refused(name):
    with pytest.raises(ProofError):
        check_certificate(problem_of(desk(), TWO_AT_WORK), FORGED[name])


def test_a_proof_by_precedence_says_nothing_where_nothing_takes_precedence():
    with pytest.raises(ProofError):
        check_certificate(problem_of(desk(first=False), TWO_AT_WORK), CERTIFICATE)


def test_a_sum_with_a_fact_that_cannot_hold_by_itself_is_a_reason():
    possible, impossible = Atom(((0, 4), (1, -1)), 4), Atom(((0, -4), (1, 1)), 2)
    facts = [Some((impossible,)), Some((possible, Atom(((0, 1),), 3)))]
    tree = [{"steps": [], "end": [[1, 1, 0], [1, 0, 0]]}]
    check_tree(CountBox([1, 0], [1, 0]), facts, tree, lambda what, count: None)


def test_without_z3_the_ladder_is_shorter_and_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "z3", None)
    monkeypatch.setattr(GuidedSearch, "go_on", lambda *given: None)  # it would use up the time
    answer = decide_question(desk(), TWO_AT_WORK, limit=50, seconds=2.0)
    assert answer.verdict == NOT_DECIDED
    (step,) = [step for step in answer.steps if step.name == "inductive invariants"]
    assert step.outcome == (
        "z3 is not there: it comes with the extra [proofs]: in a checkout, pip install '.[proofs]'"
    )


def test_what_only_precedence_excludes_is_proven_however_much_there_is():
    pytest.importorskip("z3")
    problem = problem_of(desk(), TWO_AT_WORK)
    answer = decide_question(desk(), TWO_AT_WORK, limit=50, seconds=100.0)
    assert (answer.verdict, answer.decided_by) == (PROVEN, "inductive invariants")
    check_certificate(problem, json.loads(json.dumps(answer.certificate)))
    # there, it is not so
    found = search_inductive(problem_of(desk(first=False), TWO_AT_WORK), Watch())
    played_to(problem_of(desk(first=False), TWO_AT_WORK), found)


def test_a_wrong_answer_of_z3_proves_nothing_and_shows_nothing(monkeypatch):
    # it would look for firings that lead there until its time is over
    monkeypatch.setattr(GuidedSearch, "go_on", lambda *given: None)
    wrong = changed("lemmas", 0, "some", 0, 1, to=0)
    for answer in (wrong, ["ask", "ask"], ["note"]):
        monkeypatch.setattr(ladder, "search_inductive", lambda *_, a=answer: a)
        found = decide_question(desk(), TWO_AT_WORK, limit=50, seconds=2.0)
        assert found.verdict == NOT_DECIDED


def test_z3_can_be_cancelled_and_runs_out_of_time():
    pytest.importorskip("z3")
    problem = problem_of(desk(), TWO_AT_WORK)
    before = len(problem.transitions)  # the watch is asked at each of them first
    asked = iter(range(before))
    with pytest.raises(CancelledError, match="places in the rules of z3"):
        search_inductive(problem, Watch(cancel=lambda: next(asked, None) is None))
    with pytest.raises(LimitError, match="not decided within 0 s"):
        search_inductive(problem, Watch(seconds=0.0))


@pytest.mark.parametrize("kind", ["nets", "plans"])
def test_answers_are_those_of_visiting_all_markings(kind):
    pytest.importorskip("z3")
    subjects, count = {"nets": bounded_nets(), "plans": small_plans()}[kind], Counter()

    @settings(derandomize=True, max_examples=8, deadline=None)
    @given(subjects)
    def ask(subject):
        for question in questions_about(subject, sum(count.values())):
            problem, expected = problem_of(subject, question), can_be_reached(subject, question)
            if not problem.facts or expected is None:
                continue
            try:
                found = search_inductive(problem, Watch(seconds=60.0))
            except LimitError:
                count["open"] += 1
                continue
            if isinstance(found, dict):
                check_certificate(problem, json.loads(json.dumps(found)))
            else:
                played_to(problem, found)
            assert expected == isinstance(found, list), question
            count[expected] += 1

    ask()
    assert count[True] > 6 and count[False] > 6 and count["open"] < 10
