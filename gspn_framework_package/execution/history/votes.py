"""The protocol's own rules, as far as the logs show them: promises kept, votes of members only, and
a quorum for every slot. They find a broken protocol even where luck kept the replicas together."""

from __future__ import annotations

import json
from typing import Any, Dict, List, Sequence, Set, Tuple

from gspn_framework_package.execution.event_log import EventLog, Record
from gspn_framework_package.execution.history.merge import Merged
from gspn_framework_package.execution.history.replay import BrokenRuleError

Vote = Tuple[Tuple[int, str], str]
"""A ballot, and the text of the batch."""


def check_votes(merged: Merged, members: Sequence[Sequence[str]], complete: bool) -> None:
    """Check the acceptors' records; rule 1.

    :param members: for each slot who votes in it.
    :param complete: no log is missing or lost a part, so that every vote is there.
    :raises BrokenRuleError: a promise was broken, a vote came from somebody who had none, or a slot
        was decided without a quorum.
    """
    votes: Dict[int, Dict[str, List[Vote]]] = {}
    asserted: Set[str] = set()
    for number, log in enumerate(merged.logs):
        for vote_slot, vote in _acceptor(number, log, merged):
            votes.setdefault(vote_slot, {}).setdefault(log.robot, []).append(vote)
        for record in log.records:
            if record["kind"] == "forced":
                asserted |= set(record["robots"])
    for slot, by_robot in votes.items():
        _one_value_per_ballot(slot, by_robot)
        if slot < len(members):
            for robot in by_robot:
                if robot not in members[slot]:
                    raise BrokenRuleError(1, "%s votes in slot %d without being a member" % (robot, slot))
    for slot in range(1, len(members)):
        _quorum(slot, merged, votes.get(slot, {}), members[slot], asserted, complete)


def _acceptor(number: int, log: EventLog, merged: Merged) -> List[Tuple[int, Vote]]:
    """The votes of one log, whose promises are kept."""
    promised: Any = None
    active = False
    length = 0
    out = []
    for i, record in enumerate(log.records):
        kind = record["kind"]
        if kind == "active":
            active = True
        elif kind == "reset":
            active, length = False, 0
        elif kind == "slot" or kind == "snapshot":
            length = record["slot"] + 1
        elif kind in ("promised", "accepted"):
            ballot = (int(record["ballot"][0]), str(record["ballot"][1]))
            slot = record["slot"]
            what = "%s %s ballot %s in slot %d" % (log.robot, kind, list(ballot), slot)
            if not active:
                raise BrokenRuleError(1, "%s before it may vote" % what)
            if slot != length:
                raise BrokenRuleError(1, "%s, but its first open slot is %d" % (what, length))
            if promised is not None and ballot < promised:
                raise BrokenRuleError(1, "%s, but has promised %s" % (what, list(promised)))
            promised = ballot
            if kind == "accepted" and not _given_up(number, i, log, merged):
                out.append((slot, (ballot, _text(record["batch"]))))
    return out


def _given_up(number: int, at: int, log: EventLog, merged: Merged) -> bool:
    return any(n == number and i <= at for n, i in merged.void)


def _one_value_per_ballot(slot: int, by_robot: Dict[str, List[Vote]]) -> None:
    batches: Dict[Tuple[int, str], str] = {}
    for votes in by_robot.values():
        for ballot, batch in votes:
            if batches.setdefault(ballot, batch) != batch:
                raise BrokenRuleError(1, "two batches were proposed for slot %d under ballot %s" % (slot, [*ballot]))


def _quorum(
    slot: int,
    merged: Merged,
    by_robot: Dict[str, List[Vote]],
    members: Sequence[str],
    asserted: Set[str],
    complete: bool,
) -> None:
    record = merged.slots[slot]
    if "ballot" not in record:
        return
    if not complete:
        return
    electorate = [m for m in members if m not in asserted] or list(members)
    proposer = record["ballot"][1]
    if _is_quorum({proposer}, electorate) or _is_quorum({proposer}, members):
        return  # alone: the slot's record is the vote
    chosen = set()
    for ballot in {b for votes in by_robot.values() for b, _ in votes}:
        voters = {
            robot for robot, votes in by_robot.items() for b, batch in votes if b == ballot and _leads_to(batch, record)
        }
        if _is_quorum(voters, members) or _is_quorum(voters, electorate):
            chosen.add(ballot)
    if not chosen:
        raise BrokenRuleError(
            1,
            "slot %d was decided without a quorum of %s (votes: %s)"
            % (slot, ", ".join(members), ", ".join(sorted(by_robot)) or "none"),
        )
    first = min(chosen)
    for robot, votes in by_robot.items():
        for ballot, batch in votes:
            if ballot > first and not _leads_to(batch, record):
                raise BrokenRuleError(
                    1,
                    "%s accepted another batch for slot %d under ballot %s, after one was chosen "
                    "under %s" % (robot, slot, list(ballot), list(first)),
                )


def _leads_to(batch: str, record: Record) -> bool:
    """Whether the slot holds what of the batch was new."""
    items = json.loads(batch)
    wanted = [[e, o] for e, o in zip(record["entries"], record["origins"])]
    kept = [[entry, origin] for entry, origin, _ in items if origin in record["origins"]]
    return kept == wanted


def _is_quorum(voters: Set[str], members: Sequence[str]) -> bool:
    count = len(voters.intersection(members))
    if count * 2 == len(members):
        return bool(members) and members[0] in voters
    return count * 2 > len(members)


def _text(batch: Any) -> str:
    return json.dumps(batch, sort_keys=True)
