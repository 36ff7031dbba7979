"""What can be asked of a computed policy."""

from __future__ import annotations

import pytest

from gspn_framework_package.analysis.decisions.aims import AtLeast, Objective, Request
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import ExpressionError, UsageError


def test_a_constraint_is_read_from_its_text():
    assert AtLeast.parse("finish >= 0.1") == AtLeast("finish", 0.1)
    assert AtLeast.parse("a>=b>=2") == AtLeast("a>=b", 2.0)


@pytest.mark.parametrize("text", ["", "finish", "finish>=", "finish>=much", ">=1", "finish<=1"])
def test_what_is_no_constraint_is_refused(text):
    with pytest.raises(UsageError, match="NAME>=VALUE"):
        AtLeast.parse(text)


@pytest.mark.parametrize(
    ("objective", "words"),
    [
        (
            Objective.long_run({"check": 1}),
            "the highest reward per second in the long run (check: 1)",
        ),
        (Objective.time_to("End == 2"), "the shortest mean time until End == 2"),
        (Objective.cost_to("End == 2", {"go": 3}), "the least mean cost until End == 2 (go: 3)"),
        (Objective.reach("End == 2"), "the highest probability that End == 2 ever holds"),
        (
            Objective.discounted({"go": 3}, 0.1),
            "the highest reward (go: 3), discounted by 0.1 per second",
        ),
    ],
)
def test_an_objective_is_described_in_words(objective, words):
    assert objective.describe() == words


NET = (
    NetBuilder()
    .place("a", tokens=1)
    .place("b")
    .exponential("go", inputs="a", outputs="b")
    .immediate("back", inputs="b", outputs="a")
    .build()
)
RUN = Objective.long_run({"go": 1.0})


def test_a_request_that_fits_the_net_is_accepted():
    Request(
        RUN,
        never=("a == 0 and b == 0",),
        at_least=(AtLeast("a", 0.1),),
        may_wait=frozenset({"b"}),
    ).check(NET)
    Request(Objective.time_to("b == 1"), uncertain={"go": (0.5, 2.0)}).check(NET)


def test_patterns_stand_for_names_of_the_net():
    found = Request(Objective.long_run({"[ab]": 1, "go": 2, "ba*": 3}), may_wait={"*"}).resolved(
        NET
    )
    assert found.objective.rewards == {"a": 1, "b": 1, "go": 2, "back": 3}
    assert found.may_wait == {"b"}
    with pytest.raises(UsageError, match=r"matches 'x\*'"):
        Request(Objective.long_run({"x*": 1})).resolved(NET)
    with pytest.raises(UsageError, match="'c', which is neither"):
        Request(Objective.long_run({"c": 1})).resolved(NET)


@pytest.mark.parametrize(
    ("request_", "error", "message"),
    [
        (Request(Objective.long_run({})), UsageError, "nothing is rewarded"),
        (Request(Objective.long_run({"c": 1})), UsageError, "'c', which is neither"),
        (Request(Objective.long_run({"go": float("inf")})), UsageError, "inf is not a reward"),
        (Request(Objective.time_to("c == 1")), ExpressionError, "no place 'c'"),
        (Request(Objective.discounted({"go": 1}, 0)), UsageError, "a discount is a rate"),
        (Request(RUN, never=("b >=",)), ExpressionError, "b >="),
        (Request(RUN, at_least=(AtLeast("c", 1),)), UsageError, "a constraint names 'c'"),
        (Request(RUN, may_wait=frozenset({"c"})), UsageError, "no such place"),
        (Request(RUN, uncertain={"back": (1, 2)}), UsageError, "not an exponential transition"),
        (Request(RUN, uncertain={"go": (2, 1)}), UsageError, "not an interval of rates"),
        (Request(RUN, width=0), UsageError, "a width is"),
        (
            Request(Objective.time_to("b == 1"), at_least=(AtLeast("a", 1),)),
            UsageError,
            "need a long-run aim",
        ),
    ],
)
def test_a_request_that_does_not_fit_is_refused(request_, error, message):
    with pytest.raises(error, match=message):
        request_.check(NET)
