"""Faults in the verifier, in the seal of messages and in what limits their number. A unit test finds
each of them."""

from __future__ import annotations

from typing import List

from agreement.mutants.mutant import Mutant
from gspn_framework_package.execution.verifier import votes
from gspn_framework_package.execution.verifier.slot_check import SlotCheck
from gspn_framework_package.team import seal
from gspn_framework_package.team.message_filter import MessageFilter
from meaning.edited import Edit, applied


def _of(part: str, file: str, name: str, text: str, edit: Edit, test: str) -> Mutant:
    return Mutant(name, part, text, lambda: applied([edit]), test="%s::test_%s" % (file, test))


def _verifier(name: str, text: str, edit: Edit, test: str) -> Mutant:
    return _of("verifier", "execution/test_history.py", name, text, edit, test)


def _seal(name: str, text: str, edit: Edit, test: str) -> Mutant:
    return _of("seal", "team/test_seal.py", name, text, edit, test)


def _filter(name: str, text: str, edit: Edit, test: str) -> Mutant:
    return _of("filter", "team/test_message_filter.py", name, text, edit, test)


MUTANTS: List[Mutant] = [
    _verifier(
        "two memories",
        "a robot may vote in a slot from two memories",
        (votes.check_votes, "if known != (number, memory):", "if False:"),
        "votes_of_one_slot_from_two_memories_are_found",
    ),
    _verifier(
        "slot of a vote",
        "a robot may vote in a slot that is not its open one",
        (votes._acceptor, "if slot != length:", "if False:"),
        "a_vote_in_a_slot_that_is_not_open_is_found",
    ),
    _verifier(
        "later ballot",
        "another batch may be accepted after one was chosen",
        (votes._quorum, "ballot > first and", "False and"),
        "a_later_vote_for_another_batch_is_found",
    ),
    _verifier(
        "skipped visit",
        "a firing may skip a visit",
        (SlotCheck._why_not_robots, "if visit != robot.visit + 1:", "if False:"),
        "a_visit_that_is_skipped_is_named",
    ),
    _verifier(
        "old draw",
        "a draw may be older than the marking",
        (SlotCheck._why_not_policy, "if tuple(drawn) <= self.last_change:", "if False:"),
        "a_draw_that_is_older_than_the_marking_is_named",
    ),
    _seal(
        "open window",
        "numbers before the first one of a session count",
        (seal._Numbers.__init__, "first, _ALL_SEEN", "first, 1"),
        "what_was_recorded_before_the_first_message_that_came_does_not_count",
    ),
    _seal(
        "future session",
        "a session may begin in the future",
        (seal.Seal.open, "abs(now - line.time) > FRESH", "now - line.time > FRESH"),
        "clocks_may_differ_by_so_much_and_no_more",
    ),
    _seal(
        "future order",
        "an order may come from the future",
        (seal.Seal.open_order, "abs(now - line.time) > FRESH", "now - line.time > FRESH"),
        "clocks_may_differ_by_so_much_and_no_more",
    ),
    _seal(
        "order again",
        "an order is forgotten after 15 s, and counts again until it is 30 s old",
        (seal.Seal.open_order, "4 * FRESH", "0.5 * FRESH"),
        "an_order_is_remembered_for_as_long_as_it_could_be_played_again",
    ),
    _seal(
        "endless purpose",
        "the purpose of a sealed text runs into its line",
        (seal.Seal._code, "len(purpose), purpose", "0, purpose"),
        "nothing_that_is_sealed_runs_into_what_follows",
    ),
    _seal(
        "endless run",
        "the name of the run runs into the purpose of a sealed text",
        (seal.Seal._code, "len(self._run), self._run", "0, self._run"),
        "nothing_that_is_sealed_runs_into_what_follows",
    ),
    _filter(
        "full bucket",
        "the limit of a robot's messages is full again at once",
        (
            MessageFilter.admits,
            "tokens + (now - before) * self._fastest",
            "self._fastest if now > before else tokens",
        ),
        "a_burst_that_is_used_up_comes_back_at_the_rate_of_the_limit",
    ),
    _filter(
        "no debt",
        "who floods is heard as soon as it pauses",
        (MessageFilter.admits, "max(-self._fastest, tokens)", "max(0.0, tokens)"),
        "who_floods_is_heard_again_only_after_a_silence",
    ),
]
