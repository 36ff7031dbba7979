"""Faults that the agreement once had, put back where the mending is a few words of it.
``docs/faults.md`` says how each was found; the rest of them is in ``survivors``."""

from __future__ import annotations

from typing import List

from agreement.mutants.mutant import Mutant
from agreement.world import World
from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.electorate import Electorate
from gspn_framework_package.execution.agreement.membership import Membership
from gspn_framework_package.execution.agreement.proposals import ProposalQueue
from gspn_framework_package.execution.agreement.proposer import Proposer
from gspn_framework_package.execution.agreement.replica import Replica
from gspn_framework_package.execution.verifier import votes
from meaning.edited import Edit, applied


def _mended(name: str, text: str, edit: Edit, test: str = "", transcript: str = "") -> Mutant:
    return Mutant(
        name,
        "mended",
        text,
        lambda: applied([edit]),
        test=test and _UNIT + test,
        transcript=transcript,
    )


def _checker(name: str, text: str, edit: Edit, seed: str) -> Mutant:
    """A fault in what checks the agreement: it finds fault with what is right."""
    kind = seed.split(":")[3:] or [""]
    return Mutant(name, "mended", text, lambda: applied([edit]), kinds=kind, seeds=(seed,))


_UNIT = "execution/test_"

MUTANTS: List[Mutant] = [
    _mended(
        "lost witness",
        "a witness that lost its log never comes back",
        (Membership.note_members, "(taken or self.config.witness)", "taken"),
        "protocol_steps.py::test_a_witness_that_lost_its_log_comes_back",
    ),
    _mended(
        "waits for a lost life",
        "a member that lost its log is waited for, although it returns in that slot",
        (Electorate.ends_life, "and robots.get(entry.robot):", "and False:"),
        "operator_and_memory.py::"
        "test_a_return_that_was_lost_with_its_memory_keeps_no_later_one_out",
    ),
    _mended(
        "both let in for ever",
        "two processes of one name let each other in and out, and none halts",
        (
            Membership.hear_own_name,
            "elif state.superseded_at is not None and not same:",
            "elif False:",
        ),
        transcript="another_log_let_in",
    ),
    _mended(
        "repeated is slow",
        "the answer to a message that was repeated is taken for slow",
        (Consensus._measure, "if attempt.tries:", "if False:"),
        "replica.py::test_lost_messages_are_not_taken_for_a_slow_network",
    ),
    _mended(
        "refused for ever",
        "a join of a lost log that is refused keeps out the later one of its robot",
        (
            Electorate.without_ghosts,
            "(item.origin.robot, item.origin.log)",
            '(item.origin.robot, "")',
        ),
        "protocol_steps.py::test_a_join_of_a_lost_log_keeps_no_later_one_out",
    ),
    _mended(
        "only a header",
        "a log of which a loss of power left only the header is taken for a new one",
        (Replica.start, "or not self.config.trusted", "or False"),
        "operator_and_memory.py::"
        "test_a_log_of_which_only_the_header_is_left_is_not_taken_for_a_new_one",
    ),
    _mended(
        "no room",
        "a full batch lacks the entry for which the slot waits",
        (ProposalQueue.batch, "if len(items) > most and unasked:", "if False:"),
        "operator_and_memory.py::test_an_eviction_gets_into_a_full_batch",
    ),
    _mended(
        "pause overtakes",
        "a pause that has to be in a full batch overtakes local transitions",
        (ProposalQueue._up_to_those_who_end, "return needed | ", "return needed or "),
        "operator_and_memory.py::"
        "test_no_local_transition_waits_behind_a_pause_that_comes_with_an_eviction",
    ),
    _mended(
        "evicted twice",
        "a forced eviction that an operator ordered is proposed once more",
        (ProposalQueue.batch_without_quorum, "e._replace(by=log_entries.NOBODY)", "e"),
        "operator_and_memory.py::"
        "test_an_eviction_by_force_is_in_the_log_once_with_whoever_ordered_it",
    ),
    _mended(
        "follows what was given up",
        "a log that was given up is followed on",
        (
            Membership._is_given_up,
            "return any(other[robot] < length for robot in new)",
            "return False",
        ),
        "operator_and_memory.py::"
        "test_whoever_followed_a_log_that_was_given_up_forgets_it_and_nobody_else",
    ),
    _mended(
        "only its own eviction",
        "a robot forgets a log that was given up only if it was evicted itself",
        (Membership._is_given_up, "if robot == owner or robot not in one", "if robot == owner"),
        "operator_and_memory.py::"
        "test_whoever_followed_a_log_that_was_given_up_forgets_it_and_nobody_else",
    ),
    _mended(
        "evicted in both",
        "of two logs that evict one robot by force in different slots, none counts it",
        (
            Membership._is_given_up,
            "if slot > other.get(robot, -1)}\n        by_other",
            "if robot not in other}\n        by_other",
        ),
        "protocol_steps.py::test_of_two_logs_with_evictions_by_force_the_one_with_fewer_is_kept",
    ),
    _mended(
        "gives way again",
        "a robot gives way anew whenever an attempt is repeated",
        (Proposer.on_vote, "if before != self.state.promised == body.ballot:", "if True:"),
        "operator_and_memory.py::"
        "test_an_attempt_that_cannot_succeed_does_not_keep_others_from_trying",
    ),
    _mended(
        "never patient",
        "an answer that cannot be matched to a message does not make the next attempt wait longer",
        (Consensus._measure, "0.0 if attempt.patient else took", "0.0"),
        transcript="another_log_let_in",
    ),
    _mended(
        "busy with ghosts",
        "a join that nobody answers for is proposed again and again",
        (
            Proposer._others_want,
            "return bool(self.electorate.without_ghosts(self.proposals.reported_by(without_vote)))",
            "return True",
        ),
        "protocol_steps.py::test_a_join_that_nobody_answers_for_keeps_nobody_busy",
    ),
    _mended(
        "same eviction",
        "an eviction by force that is in both logs counts for one of them",
        (
            Membership._is_given_up,
            "if slot > other.get(robot, -1)",
            "if slot >= other.get(robot, -1)",
        ),
        "protocol_steps.py::test_a_log_that_ends_before_an_eviction_by_force_was_not_given_up",
    ),
    _checker(
        "misses lost votes",
        "the verifier misses votes that a loss of power may have taken",
        (votes._quorum, "if not chosen and perhaps:", "if False:"),
        "7:3:full:outage",
    ),
    _checker(
        "misses votes of one",
        "the verifier does not know that one robot may be all that is left",
        (votes._quorum, "if _may_decide({proposer}, members, off):", "if False:"),
        "0:3:partial:operator",
    ),
    _checker(
        "settled though fenced",
        "the simulation takes a fenced robot for one that has settled",
        (World.has_settled, "or replica.fenced", ""),
        "210:2:partial",
    ),
]
