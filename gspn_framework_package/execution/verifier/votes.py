"""Checks the protocol's own rules, as far as the logs show them: acceptors keep their promises,
only members vote, and a quorum decides every slot. This detects a faulty protocol even if the
replicas happen to agree."""

from __future__ import annotations

import json
import math
from typing import Any, Dict, FrozenSet, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution.event_log import EventLog, Record
from gspn_framework_package.execution.verifier.logged_team import Situation
from gspn_framework_package.execution.verifier.merge import Merged
from gspn_framework_package.execution.verifier.slot_check import BrokenRuleError
from gspn_framework_package.model.compact_json import compact_sorted

_Ballot = Tuple[int, str, str]


class Vote(NamedTuple):
    """A vote: the ballot, and the text of the batch. ``torn``: the robots whose votes count under
    this ballot although their logs lost their ends; then it needs the votes of all."""

    ballot: _Ballot
    batch: str
    torn: FrozenSet[str] = frozenset()


Lost = Tuple[str, int, float]
"""A robot whose machine lost power, its open slot at that time, and the slot from which on its
votes are complete again: votes in between may have been lost."""


Off = Tuple[str, Optional[int]]
"""A robot that was asserted to be off, and its incarnation (None: an old log does not record
it)."""


def check_votes(
    merged: Merged,
    members: Sequence[Sequence[str]],
    situations: Sequence[Mapping[str, Situation]],
    complete: bool,
) -> None:
    """Check the acceptors' records; rule 1.

    :param merged: the agreed log.
    :param members: for each slot, the names of its voters.
    :param situations: for each slot, the situations of the robots after it.
    :param complete: whether every vote is recorded, because no log is missing or incomplete.
    :raises BrokenRuleError: an acceptor broke a promise, a robot without a vote voted, or a slot
        was decided without a quorum.
    """
    votes: Dict[int, Dict[str, List[Vote]]] = {}
    voters: Dict[Tuple[int, str], Tuple[int, int]] = {}
    asserted: List[Tuple[str, Set[Off]]] = []
    lost: List[Lost] = []
    for number, log in enumerate(merged.logs):
        for vote_slot, memory, vote in _acceptor(number, log, merged):
            votes.setdefault(vote_slot, {}).setdefault(log.robot, []).append(vote)
            known = voters.setdefault((vote_slot, log.robot), (number, memory))
            if known != (number, memory):
                raise BrokenRuleError(
                    1, "%s votes in slot %d from two memories" % (log.robot, vote_slot)
                )
        asserted.append((log.robot, _asserted(log)))
        lost += _lost(log)
    for slot, by_robot in votes.items():
        _one_value_per_ballot(slot, by_robot)
        if slot < len(members):
            for robot in by_robot:
                if robot not in members[slot]:
                    raise BrokenRuleError(
                        1, "%s votes in slot %d without being a member" % (robot, slot)
                    )
    for slot in range(1, len(members)):
        before = situations[slot - 1]
        off = [
            (
                robot,
                {
                    m
                    for m in members[slot]
                    if (m, None) in those or (m in before and (m, before[m].incarnation) in those)
                },
            )
            for robot, those in asserted
            if those
        ]
        may_have = {robot for robot, begin, end in lost if begin <= slot <= end}
        _quorum(slot, merged, votes.get(slot, {}), members[slot], off, complete, may_have)


def _asserted(log: EventLog) -> Set[Off]:
    """The robots that were asserted to be off, according to this log; other logs may hold other
    assertions."""
    asserted: Set[Off] = set()
    for record in log.records:
        if record["kind"] == "forced":
            robots = record["robots"]
            asserted |= {(r, robots[r] if isinstance(robots, dict) else None) for r in robots}
    return asserted


def _lost(log: EventLog) -> List[Lost]:
    """The slots in which the robot may have voted without a trace, since its machine lost power."""
    found: List[Lost] = []
    length, begin = 0, -1
    for record in log.records:
        kind = record["kind"]
        if kind == "slot" or kind == "snapshot":
            length = record["slot"] + 1
        elif kind == "outage" or "damaged" in record:
            begin = length if begin < 0 else begin
        elif kind == "active" and begin >= 0:
            found.append((log.robot, begin, length))
            begin = -1
    return [*found, (log.robot, begin, math.inf)] if begin >= 0 else found


def _acceptor(number: int, log: EventLog, merged: Merged) -> List[Tuple[int, int, Vote]]:
    """Check that one log keeps its promises; returns its votes as (slot, number of resets before,
    vote)."""
    promised: Optional[_Ballot] = None
    active = False
    length = resets = 0
    out = []
    for i, record in enumerate(log.records):
        kind = record["kind"]
        if kind == "active":
            active = True
        elif kind == "outage":
            active = False
        elif kind == "reset":
            active, length = False, 0
            resets += 1
        elif kind == "slot" or kind == "snapshot":
            length = record["slot"] + 1
        elif kind in ("promised", "accepted"):
            ballot = _ballot(record["ballot"])
            slot = record["slot"]
            what = "%s %s ballot %s in slot %d" % (log.robot, kind, list(ballot), slot)
            torn = frozenset(record.get("torn", ()))
            if not active and log.robot not in torn:
                raise BrokenRuleError(1, "%s before it may vote" % what)
            if slot != length:
                raise BrokenRuleError(1, "%s, but its first open slot is %d" % (what, length))
            if promised is not None and ballot < promised:
                raise BrokenRuleError(1, "%s, but has promised %s" % (what, list(promised)))
            promised = ballot
            if kind == "accepted" and not _given_up(number, i, log, merged):
                out.append((slot, resets, Vote(ballot, _text(record["batch"]), torn)))
    return out


def _ballot(value: Any) -> _Ballot:
    counter, robot, *log_id = value
    return int(counter), str(robot), str(log_id[0]) if log_id else ""


def _given_up(number: int, at: int, log: EventLog, merged: Merged) -> bool:
    """Whether the operator gave up a vote: the log diverged from the agreed log earlier, without a
    reset in between."""
    anew = (
        max((i for i in range(at) if log.records[i]["kind"] == "reset"), default=-1)
        if merged.void
        else -1
    )
    return any(n == number and anew < i <= at for n, i in merged.void)


def _one_value_per_ballot(slot: int, by_robot: Dict[str, List[Vote]]) -> None:
    batches: Dict[_Ballot, str] = {}
    for votes in by_robot.values():
        for ballot, batch, _ in votes:
            if batches.setdefault(ballot, batch) != batch:
                raise BrokenRuleError(
                    1, "two batches were proposed for slot %d under ballot %s" % (slot, [*ballot])
                )


def _quorum(
    slot: int,
    merged: Merged,
    by_robot: Dict[str, List[Vote]],
    members: Sequence[str],
    assertions: Sequence[Tuple[str, Set[str]]],
    complete: bool,
    may_have: Set[str],
) -> None:
    record = merged.slots[slot]
    if "ballot" not in record:
        raise BrokenRuleError(1, "slot %d does not record the ballot that decided it" % slot)
    if not complete:
        return
    evicted = {e["robot"] for e in record["entries"] if e["entry"] == "evict" and e.get("forced")}
    off = [those & evicted for _, those in assertions]
    proposer = record["ballot"][1]
    if _may_decide({proposer}, members, off):
        return  # the proposer decides alone: the slot's record is its vote
    chosen, perhaps = set(), _may_decide(may_have, members, off)
    by_all = {v.ballot for votes in by_robot.values() for v in votes if v.torn}
    for ballot in {v.ballot for votes in by_robot.values() for v in votes}:
        voters = {
            robot
            for robot, votes in by_robot.items()
            for v in votes
            if v.ballot == ballot and _leads_to(v.batch, record)
        }
        if ballot in by_all:
            left = [set(members) - those for those in (set(), *off)]
            decides = any(those and those <= voters | may_have for those in left)
            if decides and any(those and those <= voters for those in left):
                chosen.add(ballot)
        else:
            decides = _may_decide(voters | may_have, members, off)
            if _may_decide(voters, members, off):
                chosen.add(ballot)
        perhaps = perhaps or decides
    if not chosen and perhaps:
        return  # decided by votes that were lost in a power loss
    if not chosen:
        raise BrokenRuleError(
            1,
            "slot %d was decided without a quorum of %s (votes: %s)"
            % (slot, ", ".join(members), ", ".join(sorted(by_robot)) or "none"),
        )
    first = min(chosen)
    # a robot that knew that a quorum is off did not have to ask it
    misled = {r for r, those in assertions if not _is_quorum(set(members) - those, members)}
    for robot, votes in by_robot.items():
        if robot in evicted:
            continue  # it was off, and its vote may be for an attempt that was lost
        for ballot, batch, _ in votes:
            if ballot > first and ballot[1] not in misled and not _leads_to(batch, record):
                raise BrokenRuleError(
                    1,
                    "%s accepted another batch for slot %d under ballot %s after one was chosen "
                    "under %s" % (robot, slot, list(ballot), list(first)),
                )


def _leads_to(batch: str, record: Record) -> bool:
    """Whether the slot holds the batch, apart from repeated entries."""
    items = json.loads(batch)
    wanted = [[e, o] for e, o in zip(record["entries"], record["origins"])]
    there = {tuple(origin) for origin in record["origins"]}
    kept = [[entry, origin] for entry, origin, _ in items if tuple(origin) in there]
    return kept == wanted


def _may_decide(voters: Set[str], members: Sequence[str], off: Sequence[Set[str]]) -> bool:
    """Whether the voters can decide: they are a quorum, or, if the robots that were asserted to be
    off (in one of the logs) and that the slot evicts by force leave no quorum, they include all
    remaining members."""
    if _is_quorum(voters, members):
        return True
    return any(
        left and left <= voters and not _is_quorum(left, members)
        for left in (set(members) - those for those in off)
    )


def _is_quorum(voters: Set[str], members: Sequence[str]) -> bool:
    count = len(voters.intersection(members))
    if count * 2 == len(members):
        return bool(members) and members[0] in voters
    return count * 2 > len(members)


def _text(batch: Any) -> str:
    return compact_sorted(batch)
