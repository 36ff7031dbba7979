"""All statements of what a plan means while it runs say the same, and a wrong rule in one of them is
found. More plans and all mutants: ``test/campaigns/one_meaning.py``."""

import pytest

from meaning.comparing import COMPARISONS, Case, told_by
from meaning.mutant import applied, hunt, source_of
from meaning.mutants import MUTANTS
from meaning.plans import FAMILIES, made


@pytest.mark.long
@pytest.mark.parametrize("family", FAMILIES)
def test_all_statements_agree(family):
    case = Case(made(family, 1, 0))
    for name, comparison in COMPARISONS.items():
        assert not told_by(comparison, case), name


# one of each rule in these statements, which compute fast
QUICK = {(m.rule, m.statement): m for m in MUTANTS if m.statement in ("chain", "net", "check")}


@pytest.mark.long
@pytest.mark.parametrize("mutant", QUICK.values(), ids=lambda m: m.name)
def test_a_wrong_rule_is_found(mutant):
    assert hunt(mutant, 40).plans is not None


def test_every_mutant_still_fits_the_program():
    for mutant in MUTANTS:
        for function, words, _ in mutant.edits:
            of_before = any(words in others for _, _, others in mutant.edits)
            assert of_before or words in source_of(function), mutant.name


def test_a_mutant_leaves_nothing_behind():
    mutant = MUTANTS[0]
    before = [function.__code__ for function, _, _ in mutant.edits]
    with applied(mutant.edits):
        assert [function.__code__ for function, _, _ in mutant.edits] != before
    assert [function.__code__ for function, _, _ in mutant.edits] == before
