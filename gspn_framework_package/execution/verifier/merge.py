"""Merges the logs of a run into one agreed sequence of slots, or finds the first slot where two
logs differ."""

from __future__ import annotations

import hashlib
from typing import Any, Dict, List, NamedTuple, Sequence, Set, Tuple

from gspn_framework_package.execution.event_log import EventLog, Record
from gspn_framework_package.execution.verifier.slot_check import BrokenRuleError
from gspn_framework_package.model.compact_json import compact, compact_sorted

COMPARED = ("entries", "origins", "firings", "hash")


class Memory(NamedTuple):
    """Records ``begin`` to ``end`` (exclusive) of log ``number``, in which its robot forgot
    nothing. ``forgotten``: whether it reset or lost its log afterwards. ``took_part``: whether the
    team let it in meanwhile. ``left``: whether it was out of the team again at the end. ``time``:
    the time of the newest of these records (s)."""

    number: int
    begin: int
    end: int
    forgotten: bool
    took_part: bool
    left: bool
    time: float


class Merged:
    """The agreed log.

    :param logs: the logs of one run.
    :raises BrokenRuleError: a log contradicts the others or itself (rule 1).

    :ivar slots: slot -> its record, from the first log that has it.
    :ivar heard: slot -> when a replica first had it (s, monotonic clock of the host).
    :ivar void: (index of the log, index of the record) of slots that the operator gave up by an
        eviction by force, or that the team lost with the power supply and only a robot outside the
        team has.
    """

    def __init__(self, logs: Sequence[EventLog]) -> None:
        self.logs = logs
        self.slots: Dict[int, Record] = {}
        self.heard: Dict[int, float] = {}
        self.void: Set[Tuple[int, int]] = set()
        self._source: Dict[int, str] = {}
        evictions = _evictions_by_force(logs)
        cast_out = {robot for robot, _ in evictions}
        self._last_forced = max((slot for _, slot in evictions), default=-1)
        self._decided_anew = _decided_after_outages(logs)
        memories = _memories(logs)
        # robots in the team come first, of these the memories kept to the end, then robots never
        # cast out, then the newest memories
        memories.sort(
            key=lambda m: (
                not m.took_part or m.left,
                m.forgotten,
                logs[m.number].robot in cast_out,
                -m.time if cast_out else 0.0,
            )
        )
        for memory in memories:
            self._add(
                memory,
                logs[memory.number],
                memory.forgotten or logs[memory.number].robot in cast_out,
            )

    def _add(self, memory: Memory, log: EventLog, may_differ: bool) -> None:
        """Compare a robot's memory with the slots so far, and add those that are new; rule 1.

        :param may_differ: whether the memory may differ, starting at a slot no later than the last
            eviction by force. What a robot learned outside the team may also differ from a slot on
            that was decided after a loss of power.
        """
        number = memory.number
        inside = memory.took_part
        length, chain = 0, str(log.header["plan_hash"])
        given_up = False
        for i in range(memory.begin, memory.end):
            record = log.records[i]
            kind = record["kind"]
            if kind == "snapshot":
                length, chain = record["slot"] + 1, record["hash"]
                known = self.slots.get(record["slot"])
                if known is not None and known["hash"] != chain:
                    given_up = given_up or (may_differ and record["slot"] <= self._last_forced)
                    anew = () if inside else self._decided_anew
                    given_up = given_up or any(slot <= record["slot"] for slot in anew)
                if known is not None and known["hash"] != chain and not given_up:
                    raise BrokenRuleError(
                        1,
                        "%s took a snapshot after slot %d that does not fit the log"
                        % (log.robot, record["slot"]),
                    )
            elif kind == "slot":
                slot = record["slot"]
                if slot != length:
                    raise BrokenRuleError(
                        1, "%s has slot %d instead of slot %d" % (log.robot, slot, length)
                    )
                self._check_origins(log, record)
                chain = _link(chain, record)
                if chain != record["hash"]:
                    raise BrokenRuleError(
                        1, "slot %d of %s breaks the hash chain" % (slot, log.robot)
                    )
                length += 1
                known = self.slots.get(slot)
                if known is not None and any(known[k] != record[k] for k in COMPARED):
                    given_up = given_up or (may_differ and slot <= self._last_forced)
                    given_up = given_up or (not inside and slot in self._decided_anew)
                    if not given_up:
                        raise BrokenRuleError(
                            1,
                            "%s and %s differ in slot %d: %s and %s"
                            % (self._source[slot], log.robot, slot, _short(known), _short(record)),
                        )
                inside = is_in_team_after(log.robot, record, inside)
                if given_up:
                    self.void.add((number, i))
                    continue
                if known is None:
                    self.slots[slot] = record
                    self._source[slot] = log.robot
                time = float(record.get("mono", 0.0))
                self.heard[slot] = min(self.heard.get(slot, time), time)

    @staticmethod
    def _check_origins(log: EventLog, record: Record) -> None:
        """Check that each entry of an agreed log has an origin."""
        entries, origins = record["entries"], record["origins"]
        if log.robot and (len(entries) != len(origins) or any(len(o) != 4 for o in origins)):
            raise BrokenRuleError(
                1,
                "slot %s of %s does not name the origin of each entry"
                % (record["slot"], log.robot),
            )

    @property
    def length(self) -> int:
        """The number of slots before the first one that no log has."""
        slot = 0
        while slot in self.slots:
            slot += 1
        return slot


def _memories(logs: Sequence[EventLog]) -> List[Memory]:
    """The memories of the robots: each log, split where it was reset."""
    newest = {log.robot: i for i, log in enumerate(logs)}
    out = []
    for number, log in enumerate(logs):
        resets = [i for i, r in enumerate(log.records) if r["kind"] == "reset"]
        for begin, end in zip([0, *resets], [*resets, len(log.records)]):
            records = log.records[begin:end]
            forgotten = end < len(log.records) or newest[log.robot] != number
            took_part = not log.robot or any(r["kind"] == "active" for r in records)
            inside = not log.robot
            for record in records:
                inside = is_in_team_after(log.robot, record, inside)
            time = max((float(r.get("mono", 0.0)) for r in records), default=0.0)
            out.append(Memory(number, begin, end, forgotten, took_part, not inside, time))
    return out


def is_in_team_after(robot: str, record: Record, before: bool) -> bool:
    """Whether a robot is in the team after a record of its log, as far as that says."""
    if record["kind"] == "active":
        return True
    if record["kind"] == "reset":
        return False
    if record["kind"] == "slot":
        for entry in record["entries"]:
            if entry.get("robot") == robot and entry["entry"] in ("join", "leave", "evict"):
                before = entry["entry"] == "join"
    return before


def _decided_after_outages(logs: Sequence[EventLog]) -> Set[int]:
    """The first slots that logs have after losses of power. Only a robot outside the team can have
    another one there: it was decided before, and lost."""
    found = set()
    for log in logs:
        torn = False
        for record in log.records:
            if record["kind"] == "slot" and torn:
                found.add(record["slot"])
            if record["kind"] in ("slot", "outage"):
                torn = record["kind"] == "outage"
    return found


def _evictions_by_force(logs: Sequence[EventLog]) -> Set[Tuple[str, int]]:
    """(robot, slot) of every eviction by force."""
    return {
        (str(e["robot"]), r["slot"])
        for log in logs
        for r in log.records
        if r["kind"] == "slot"
        for e in r["entries"]
        if e.get("entry") == "evict" and e.get("forced")
    }


def _link(previous: str, record: Record) -> str:
    parts = [previous, record["entries"], record["origins"], record["firings"]]
    text = compact_sorted(parts)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()[:32]


def _short(record: Record) -> str:
    entries: List[Any] = record["entries"]
    text = compact(entries)
    return text if len(text) < 200 else text[:200] + "..."
