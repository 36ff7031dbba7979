"""The simulation and the checker find faults that were put there on purpose (some; all of them:
``python3 -m benchmarks.mutants``)."""

from __future__ import annotations

import pytest

from agreement.mutants import MUTANTS, hunt

QUICK = {
    "bare half": 3,
    "promises": 0,
    "accepted values": 8,
    "amnesia": 6,
    "any vote": 10,
    "repeats": 14,
    "dropped proposals": 3,
    "all private": 0,
    "local dice": 3,
    "loaded dice": 3,
    "enabling": 16,
    "early goals": 23,
    "mixed results": 0,
    "lost promises": 0,
    "no jury": 0,
    "leaves at once": 3,
    "own sleep": 0,
    "short chunks": 20,
    "newest first": 0,
    "rest decides": 5,
    "decides and stays": 64,
    "any log": 45,
    "trusts the end": 7,
    "no sync": 0,
    "whole though torn": 7,
    "torn without all": 40,
    "members unsynced": 0,
    "torn votes unsynced": 0,
    "unsynced votes": 0,
    "moves while paused": 1,
    "drops the first": 3,
    "lost moves": 1,
    "keeps cancelled": 1,
    "no priority": 0,
    "of others": 5,
    "same incarnation": 1,
    "quorum only": 13,
    "no freeze": 0,
    "returned followers": 6,
    "numbers only": 15,
    "eager start": 18,
    "low promise": 18,
    "stale event": 0,
    "two winners": 0,
    "never held": 6,
    "event in a pause": 5,
    "no cause": 0,
    "continues again": 0,
    "tasks first": 6,
    "never done": 0,
    "keeps task": 7,
    "back to the end": 3,
    "first writer": 0,
    "reads ahead": 0,
    "reads late": 0,
    "unwritten task": 3,
    "forgotten task": 3,
    "snapshot without queues": 2,
    "snapshot without task": 7,
    "snapshot without data": 3,
    "stand-in": 25,
    "any state": 8,
    "votes stay": 7,
}
"""Those that random schedules find, and the seed of one that does. Should it no longer, those after it are run."""


TARGETED = [m.name for m in MUTANTS if m.seeds or m.transcript or m.test]
"""Those with schedules, a transcript or a unit test of their own."""


@pytest.mark.parametrize(
    "mutant", [m for m in MUTANTS if m.name in (*QUICK, *TARGETED)], ids=lambda m: m.name
)
def test_a_seeded_fault_is_caught(mutant) -> None:
    caught = hunt(mutant, 400, QUICK.get(mutant.name, 0))
    assert caught.schedules is not None, caught.text


def test_no_quick_mutant_was_renamed() -> None:
    names = [m.name for m in MUTANTS]
    assert set(QUICK) <= set(names)
    assert len(set(names)) == len(names)


def test_a_fault_that_nothing_can_find_has_its_reason() -> None:
    harmless = [m for m in MUTANTS if m.harmless]
    assert all(m.harmless.endswith(".") for m in harmless)
    assert not {m.name for m in harmless} & {*QUICK, *TARGETED}
