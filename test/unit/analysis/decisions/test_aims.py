"""What can be asked of a computed policy."""

from __future__ import annotations

import pytest

from gspn_framework_package.analysis.decisions.aims import AtLeast, Objective
from gspn_framework_package.model.errors import UsageError


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
