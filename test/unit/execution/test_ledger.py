"""What a ledger takes for new, whom it knows by which log, and what its snapshots hold."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from agreement.plans import make_plan
from gspn_framework_package.execution.ledger import Item, Ledger, Origin
from gspn_framework_package.execution.log_entries import Done, Evict, Join, Leave, Pause
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.errors import LogError

PLAN = make_plan(2, 3, False, 0.0, 0.0, True)


def started() -> Ledger:
    ledger = Ledger(TokenGame(PLAN))
    ledger.append([Item(ledger.game.start_entry(), Origin("", 0, 0))])
    return ledger


def by(robot: str, number: int, entry: Any, incarnation: int = 0, log: str = "a") -> Item:
    return Item(entry, Origin(robot, incarnation, number, log))


def taken(ledger: Ledger, *items: Item) -> int:
    """The number of entries that got into the log."""
    record, _ = ledger.append(items)
    return len(record["entries"])


def test_what_is_no_newer_than_the_last_entry_of_its_robot_is_no_news() -> None:
    ledger = started()
    assert taken(ledger, by("r1", 5, Pause(), 2)) == 1
    assert not ledger.is_news(Origin("r1", 2, 5, "a"))
    assert not ledger.is_news(Origin("r1", 2, 4, "a"))
    assert ledger.is_news(Origin("r1", 2, 6, "a"))
    assert ledger.is_news(Origin("r2", 0, 1, "b"))


def test_numbers_of_an_earlier_incarnation_are_no_news() -> None:
    ledger = started()
    taken(ledger, by("r1", 5, Pause(), 2))
    assert not ledger.is_news(Origin("r1", 1, 6, "a"))
    assert ledger.is_news(Origin("r1", 3, 1, "a"))


def test_an_incarnation_belongs_to_the_first_log_that_it_came_from() -> None:
    ledger = started()
    taken(ledger, by("r1", 5, Pause(), 2))
    assert not ledger.is_news(Origin("r1", 2, 6, "b"))
    assert ledger.is_news(Origin("r1", 3, 1, "b"))


def test_an_entry_that_stands_twice_in_a_batch_is_taken_once() -> None:
    assert taken(started(), by("r1", 1, Pause()), by("r1", 1, Pause()), by("r2", 1, Pause())) == 2


def test_an_entry_that_is_in_the_log_is_not_taken_again() -> None:
    ledger = started()
    assert taken(ledger, by("r1", 1, Done("r1", 0, 1, "t1"))) == 1
    _, step = ledger.append([by("r1", 1, Done("r1", 0, 2, "t2"))])
    assert not step.firings


def test_the_hash_is_of_the_firings_as_well() -> None:
    with_it, without = started(), started()
    written = [by("r1", 1, Done("r1", 0, 1, "t1"))]
    with_it.append(written)
    step = without.game.reduce(without.state, without.length, [])
    without.record(1, [written[0].entry], [list(written[0].origin)], step)
    assert with_it.hash != without.hash


def test_a_robot_is_known_by_the_log_with_which_it_was_let_in() -> None:
    ledger = started()
    taken(ledger, by("r1", 1, Join("r1", 2, log="new"), 2))
    assert ledger.logs == {"r1": "new"}
    taken(ledger, by("r2", 1, Join("r1", 1, log="old")))  # of a life that is over
    assert ledger.logs == {"r1": "new"}


def test_a_witness_is_known_by_its_log_too() -> None:
    ledger = started()
    (witness,) = ledger.state.witnesses
    taken(ledger, by(witness, 1, Join(witness, 1, log="new"), 1))
    assert ledger.logs == {witness: "new"}


def test_only_an_eviction_by_force_casts_out() -> None:
    ledger = started()
    taken(ledger, by("r1", 1, Evict("r2", 0)))
    assert ledger.cast_out == {} and not ledger.is_cast_out("r2")


def test_who_is_evicted_by_force_is_cast_out_at_that_slot_until_it_joins() -> None:
    ledger = started()
    slot = ledger.length
    taken(ledger, by("r1", 1, Evict("r2", 0, True)))
    assert ledger.cast_out == {"r2": slot} and ledger.is_cast_out("r2")
    taken(ledger, by("r2", 1, Join("r2", 1, log="new"), 1))
    assert ledger.cast_out == {"r2": slot} and not ledger.is_cast_out("r2")


def test_an_eviction_that_has_no_effect_casts_nobody_out() -> None:
    ledger = started()
    taken(ledger, by("r2", 1, Join("r2", 1, log="new"), 1))
    taken(ledger, by("r1", 1, Evict("r2", 0, True)))  # of a life that is over
    assert ledger.cast_out == {}
    taken(ledger, by("r3", 1, Leave("r3")))
    taken(ledger, by("r1", 2, Evict("r3", 0, True)))  # left before
    assert ledger.cast_out == {}


def test_a_snapshot_holds_who_may_do_what() -> None:
    ledger = started()
    taken(ledger, by("r1", 1, Join("r1", 2, log="new"), 2))
    taken(ledger, by("r1", 2, Evict("r2", 0, True), 2))
    again = Ledger(ledger.first)
    again.restore(json.loads(json.dumps(ledger.snapshot())))
    for name in ("seen", "logs", "cast_out", "hash", "length", "state"):
        assert getattr(again, name) == getattr(ledger, name), name


def test_a_snapshot_of_another_slot_is_refused_and_changes_nothing() -> None:
    ledger = started()
    taken(ledger, by("r1", 1, Pause()))
    again = Ledger(ledger.first)
    with pytest.raises(LogError, match="does not belong to the slot"):
        again.restore({**ledger.snapshot(), "slot": ledger.length})
    assert again.length == 0 and again.seen == {}


def test_a_restored_ledger_goes_on_by_the_rules_of_its_state() -> None:
    ledger = started()
    snapshot = ledger.snapshot()
    again = Ledger(ledger.first)
    again.game = TokenGame(replace(PLAN, seed=PLAN.seed + 1))
    again.restore(snapshot)
    assert again.game.plan.hash() == PLAN.hash()
