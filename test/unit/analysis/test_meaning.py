"""All statements of what a plan means while it runs say the same, and a wrong rule in one of them is
found. More plans and all mutants: ``test/campaigns/one_meaning.py``."""

import random
from dataclasses import replace

import pytest

from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.model.marking_function import parse_value, quoted_place
from meaning.comparing import COMPARISONS, Case, told_by
from meaning.edited import applied, source_of
from meaning.mutant import hunt
from meaning.mutants import MUTANTS
from meaning.plans import FAMILIES, made


@pytest.mark.long
@pytest.mark.parametrize("family", FAMILIES)
def test_all_statements_agree(family):
    case = Case(made(family, 1, 0))
    for name, comparison in COMPARISONS.items():
        assert not told_by(comparison, case), name


@pytest.mark.long
@pytest.mark.parametrize(
    "family",
    [
        "spontaneous_first",
        "policy_rows",
        "degrees",
        "candidates",
        "inhibitors",
        "counters",
        "held_draws",
        "draw_again",
        "who_asked",
        "anything",
    ],
)
def test_all_statements_agree_about_weights_and_rates_that_depend_on_the_marking(family):
    sample = made(family, 7, 0)
    case = Case(sample._replace(plan=dependent(sample.plan)))
    for name in (
        "chain_and_run",
        "net_and_run",
        "optimiser_and_run",
        "optimiser_and_net",
        "optimum_and_run",
        "check_and_run",
        "simulation_and_run",
        "table_and_run",
    ):
        assert not told_by(COMPARISONS[name], case), name


@pytest.mark.long
@pytest.mark.parametrize(
    "family", ["capacities", "degrees", "spontaneous_first", "at_rest", "unequal_classes"]
)
def test_policies_are_computed_for_weights_and_rates_that_depend_on_the_marking(family):
    for number in range(2):
        sample = made(family, 7, number)
        case = Case(sample._replace(plan=dependent(sample.plan)))
        assert case.plan.net.functions
        for name in ("optimiser_and_run", "optimiser_and_net", "optimum_and_run"):
            assert told_by(COMPARISONS[name], case) == [], name


def dependent(plan):
    """The plan with weights, and rates of its environment, that depend on the marking."""
    source, net = random.Random(plan.name), plan.net
    for t, transition in enumerate(plan.net.transitions):
        place = quoted_place(source.choice(net.places).name)
        text = "%r * (0.5 + #%s) / (1 + 0.3 * #%s)" % (transition.number, place, place)
        if transition.timed and not plan.moves_robots(t):
            net = net.with_transition(transition._replace(rate=parse_value(text)))
        elif not (transition.timed or transition.is_controllable):
            net = net.with_transition(transition._replace(weight=parse_value(text)))
    return replace(plan, net=net).validate()


@pytest.mark.parametrize("family", ["spontaneous_first", "policy_rows", "policy_tests", "degrees"])
def test_a_run_whose_weights_depend_on_the_marking_can_be_verified(family, tmp_path):
    for number in range(3):
        plan = dependent(made(family, 7, number).plan)
        run = VirtualRun(plan, seed=number)
        path = tmp_path / ("%d.jsonl" % number)
        writer = run.record_in(str(path), "run", "log")
        run.run(200.0, firings=200)
        writer.close()
        log = read_log(str(path))
        assert sum(len(step.firings) for step in replay(log)) > 0
        assert verify([log]).violation is None


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
