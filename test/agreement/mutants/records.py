"""Faults in the ledger, and in what watchers read of a team. A unit test finds each of them."""

from __future__ import annotations

from typing import Any, List

from agreement.mutants.mutant import Mutant
from gspn_framework_package.execution import ledger, team_messages
from gspn_framework_package.execution.ledger import Ledger
from meaning.edited import applied


def _in(
    part: str, file: str, name: str, text: str, function: Any, old: str, new: str, test: str
) -> Mutant:
    return Mutant(
        name,
        part,
        text,
        lambda: applied([(function, old, new)]),
        test="execution/%s.py::test_%s" % (file, test),
    )


def _ledger(name: str, text: str, function: Any, old: str, new: str, test: str) -> Mutant:
    return _in("ledger", "test_ledger", name, text, function, old, new, test)


def _told(name: str, text: str, function: Any, old: str, new: str, test: str) -> Mutant:
    return _in("team messages", "test_team_messages", name, text, function, old, new, test)


MUTANTS: List[Mutant] = [
    _ledger(
        "same number",
        "the last entry of a robot is news again",
        ledger._is_newer,
        "number > known[1]",
        "number >= known[1]",
        "what_is_no_newer_than_the_last_entry_of_its_robot_is_no_news",
    ),
    _ledger(
        "ended life",
        "numbers go on over the lives of a robot",
        ledger._is_newer,
        "incarnation == known[0] and",
        "",
        "numbers_of_an_earlier_incarnation_are_no_news",
    ),
    _ledger(
        "shared life",
        "two logs of a robot may use one incarnation",
        ledger._is_newer,
        " and log_id == known[2]",
        "",
        "an_incarnation_belongs_to_the_first_log_that_it_came_from",
    ),
    _ledger(
        "twice in a batch",
        "an entry that stands twice in a batch counts twice",
        Ledger.news,
        "seen.get(robot, self.seen.get(robot))",
        "self.seen.get(robot)",
        "an_entry_that_stands_twice_in_a_batch_is_taken_once",
    ),
    _ledger(
        "forgets entries",
        "what is in the log is not remembered",
        Ledger.append,
        "self.seen.update(",
        "dict().update(",
        "an_entry_that_is_in_the_log_is_not_taken_again",
    ),
    _ledger(
        "plays repeats",
        "entries that are no news have their effect again",
        Ledger.append,
        "[item.entry for item in fresh]",
        "[item.entry for item in items]",
        "an_entry_that_is_in_the_log_is_not_taken_again",
    ),
    _ledger(
        "hash of entries",
        "the hash says nothing of the firings",
        Ledger.record,
        "origins, firings)",
        "origins, [])",
        "the_hash_is_of_the_firings_as_well",
    ),
    _ledger(
        "old log let in",
        "a join that has no effect changes the log by which a robot is known",
        Ledger._note_membership,
        "robot and robot.incarnation == entry.incarnation\n            ):",
        "robot\n            ):",
        "a_robot_is_known_by_the_log_with_which_it_was_let_in",
    ),
    _ledger(
        "unknown witness",
        "the log of a witness is not noted",
        Ledger._note_membership,
        "entry.robot in self.state.witnesses or",
        "",
        "a_witness_is_known_by_its_log_too",
    ),
    _ledger(
        "all cast out",
        "every eviction counts as one by force",
        Ledger._note_membership,
        " and entry.forced",
        "",
        "only_an_eviction_by_force_casts_out",
    ),
    _ledger(
        "cast out later",
        "an eviction by force is noted at the next slot",
        Ledger._note_membership,
        "self.length - 1",
        "self.length",
        "who_is_evicted_by_force_is_cast_out_at_that_slot_until_it_joins",
    ),
    _ledger(
        "cast out for ever",
        "who was evicted by force stays cast out when it joins",
        Ledger.is_cast_out,
        "robot is None or robot.phase.gone",
        "True",
        "who_is_evicted_by_force_is_cast_out_at_that_slot_until_it_joins",
    ),
    _ledger(
        "cast out in vain",
        "an eviction of a life that is over casts out the present one",
        Ledger._note_membership,
        "robot is not None\n                and robot.phase is Phase.LOST\n"
        "                and robot.incarnation == entry.incarnation",
        "robot is not None",
        "an_eviction_that_has_no_effect_casts_nobody_out",
    ),
    _ledger(
        "cast out after all",
        "who has left can be cast out",
        Ledger._note_membership,
        "robot.phase is Phase.LOST",
        "robot.phase.gone",
        "an_eviction_that_has_no_effect_casts_nobody_out",
    ),
    _ledger(
        "snapshot without entries",
        "a snapshot does not hold which entries are in the log",
        Ledger.snapshot,
        "for robot, newest in self.seen.items()",
        "for robot, newest in ()",
        "a_snapshot_holds_who_may_do_what",
    ),
    _ledger(
        "restored elsewhere",
        "a snapshot of another slot is taken",
        Ledger.restore,
        'whole_number(record["slot"]) + 1',
        "state.next_slot",
        "a_snapshot_of_another_slot_is_refused_and_changes_nothing",
    ),
    _ledger(
        "rules of before",
        "a restored ledger goes on by the rules that it had",
        Ledger.restore,
        "self.game = self.first.now(state)",
        "pass",
        "a_restored_ledger_goes_on_by_the_rules_of_its_state",
    ),
    _told(
        "gone and here",
        "a robot that is gone is shown in its last place",
        team_messages.robot_fields,
        '"" if gone else game',
        "game",
        "a_robot_that_is_gone_is_in_no_place_and_waits_for_nothing",
    ),
    _told(
        "waits after the end",
        "robots wait though the run is over",
        team_messages.robot_fields,
        "if state.ended is None else",
        "if True else",
        "after_the_end_nobody_waits_or_needs_the_operator",
    ),
    _told(
        "needs in vain",
        "robots need the operator though the run is over",
        team_messages.robot_fields,
        "needs_operator and state.ended is None",
        "needs_operator",
        "after_the_end_nobody_waits_or_needs_the_operator",
    ),
    _told(
        "phase of the log",
        "a pause of the team is not reported of its robots",
        team_messages.robot_fields,
        "reported_phase(state, robot)",
        "robot.phase",
        "a_pause_is_reported_of_every_robot",
    ),
    _told(
        "ends for a reason",
        "a run that ended without a reason goes on, for watchers",
        team_messages.team_fields,
        "state.ended is not None",
        "bool(state.ended)",
        "the_end_of_a_team_says_why",
    ),
    _told(
        "robots as they come",
        "the robots of a team are in any order",
        team_messages.team_fields,
        "for name in sorted(state.robots)",
        "for name in state.robots",
        "the_robots_of_a_team_are_in_the_order_of_their_names",
    ),
    _told(
        "cause or tasks",
        "a firing that has a cause does not say where its tasks went",
        team_messages.firing_fields,
        "if firing.tasks:",
        "if firing.tasks and not firing.cause:",
        "a_firing_says_what_caused_it_and_where_its_tasks_went",
    ),
    _told(
        "all of the log",
        "local transitions look like those of the log",
        team_messages.firing_fields,
        "fired.private",
        "False",
        "a_firing_says_what_caused_it_and_where_its_tasks_went",
    ),
]
