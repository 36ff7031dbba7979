"""The simulation and the checker find faults that were put there on purpose (some; all of them:
``python3 -m benchmarks.mutants``)."""

from __future__ import annotations

import pytest

from agreement.mutants import MUTANTS, hunt

QUICK = (
    "bare half",
    "promises",
    "accepted values",
    "amnesia",
    "any vote",
    "repeats",
    "dropped proposals",
    "all private",
    "local dice",
    "loaded dice",
    "enabling",
    "early goals",
    "mixed results",
    "lost promises",
    "no jury",
    "leaves at once",
    "own sleep",
    "short chunks",
    "newest first",
    "off for ever",
    "rest decides",
    "decides and stays",
    "any log",
    "trusts the end",
    "no sync",
    "whole though torn",
    "quorum of torn",
    "torn without all",
    "members unsynced",
    "torn votes unsynced",
    "unsynced votes",
    "moves while paused",
    "drops the first",
    "lost moves",
    "keeps cancelled",
    "no priority",
    "of others",
    "same incarnation",
    "quorum only",
    "no freeze",
    "returned followers",
    "numbers only",
    "eager start",
    "snapshot without logs",
    "low promise",
    "learns what it holds",
    "stale event",
    "two winners",
    "never held",
    "event in a pause",
    "no cause",
    "continues again",
    "tasks first",
    "never done",
    "keeps task",
    "back to the end",
    "first writer",
    "reads ahead",
    "reads late",
    "unwritten task",
    "forgotten task",
    "snapshot without queues",
    "snapshot without task",
    "snapshot without data",
    "stand-in",
    "overruled",
    "any state",
    "lost tasks",
    "votes stay",
    "votes of the dead",
)


TARGETED = [m.name for m in MUTANTS if m.seeds or m.transcript or m.test]
"""Those with schedules, a transcript or a unit test of their own."""


@pytest.mark.parametrize(
    "mutant", [m for m in MUTANTS if m.name in (*QUICK, *TARGETED)], ids=lambda m: m.name
)
def test_a_seeded_fault_is_caught(mutant) -> None:
    caught = hunt(mutant, 400)
    assert caught.schedules is not None, caught.text


def test_no_quick_mutant_was_renamed() -> None:
    names = [m.name for m in MUTANTS]
    assert set(QUICK) <= set(names)
    assert len(set(names)) == len(names)


def test_a_fault_that_nothing_can_find_has_its_reason() -> None:
    harmless = [m for m in MUTANTS if m.harmless]
    assert all(m.harmless.endswith(".") for m in harmless)
    assert not {m.name for m in harmless} & {*QUICK, *TARGETED}
