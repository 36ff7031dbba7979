"""The history checker: whether the logs of a run are consistent and valid.

:func:`verify` uses only the logs. It checks the invariants of ``docs/agreement.md`` and the
protocol's own rules, and shares no code with the token game or the protocol implementation.

Modules: ``cargo``, ``logged_team``, ``merge``, ``robots``, ``slot_check``, ``stages``, ``votes``.
"""

from __future__ import annotations

from typing import Any, Dict, List, NamedTuple, Optional, Sequence

from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.execution.verifier.merge import Merged
from gspn_framework_package.execution.verifier.robots import (
    LoggedOrigin,
    LoggedProposals,
    RobotCheck,
    check_real_time,
)
from gspn_framework_package.execution.verifier.slot_check import BrokenRuleError, SlotCheck
from gspn_framework_package.execution.verifier.votes import check_votes
from gspn_framework_package.model.errors import LogError


class Violation(NamedTuple):
    """The first broken rule: its number (``docs/agreement.md``), and what happened."""

    rule: int
    text: str


class Verdict(NamedTuple):
    """The result of a check.

    :ivar violation: the first violation; None if there is none.
    :ivar slots: number of slots found in the agreed log.
    :ivar firings: number of firings in them.
    :ivar robots: number of robots at the end, including lost ones.
    :ivar logs: number of logs read.
    :ivar notes: remarks other than violations.
    """

    violation: Optional[Violation]
    slots: int
    firings: int
    robots: int
    logs: int
    notes: List[str]

    def to_json(self) -> Dict[str, Any]:
        """The verdict as a JSON object."""
        data: Dict[str, Any] = self._asdict()
        data["valid"] = self.violation is None
        data["violation"] = self.violation._asdict() if self.violation else None
        return data


def verify(logs: Sequence[EventLog], *, settled: bool = False, complete: bool = True) -> Verdict:
    """Check the logs of one run.

    :param logs: the logs of the robots, in any order of robots; if a robot has an older log that it
        lost, include it before its newer one.
    :param settled: whether the team was left undisturbed until nothing was pending. If so, a
        proposal that is not in the log and an action that was not started are also violations
        (rules 8 and 9).
    :param complete: whether all logs of the run are given; otherwise votes cannot be counted.
    :raises LogError: there are no logs, they belong to different runs or plans, or a record is
        damaged.
    """
    if not logs:
        raise LogError("no logs were given")
    for key in ("run", "plan_hash"):
        values = {str(log.header[key]) for log in logs}
        if len(values) > 1:
            raise LogError(
                "the logs belong to different %ss: %s" % (key, ", ".join(sorted(values)))
            )
    notes: List[str] = []
    state = _Check(logs, settled, complete, notes)
    violation = None
    try:
        state.run()
    except BrokenRuleError as error:
        violation = Violation(error.rule, error.text)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, ArithmeticError) as error:
        raise LogError("a record is damaged (%r)" % error) from None
    return Verdict(violation, state.length, state.firings, state.robots, len(logs), notes)


class _Check:
    def __init__(
        self, logs: Sequence[EventLog], settled: bool, complete: bool, notes: List[str]
    ) -> None:
        self.logs = logs
        self.settled = settled
        self.complete = complete
        self.notes = notes
        self.length = self.firings = self.robots = 0

    def run(self) -> None:
        merged = Merged(self.logs)
        self.length = merged.length
        for log in self.logs:
            if log.cut:
                self.notes.append("the last line of %s was cut off" % log.path)
            self.notes += [
                "%s lost the end of its log: %s" % (log.robot, r["why"])
                for r in log.records
                if "damaged" in r
            ]
        if self.length < len(merged.slots):
            self.notes.append("no log has slot %d, so later slots cannot be checked" % self.length)
        plan = self.logs[0].plan
        replay = SlotCheck(plan, bool(self.logs[0].header.get("agents")))
        situations, members, markings, plans = [], [], [], []
        ended_at: Optional[int] = None
        for slot in range(self.length):
            members.append(replay.members())
            record = merged.slots[slot]
            replay.slot(record)
            self.firings += len(record["firings"])
            situations.append(replay.situations())
            markings.append({place: n for place, n in replay.marking.items() if n})
            plans.append(replay.plan)
            if ended_at is None and replay.ended is not None:
                ended_at = slot
        self.robots = len(replay.robots)
        proposals = LoggedProposals(merged, self.length)
        if self.logs[0].robot:
            check_votes(merged, members, situations, self.complete)
            if self.complete:
                self._check_presence(merged, replay)
        invoked: Dict[LoggedOrigin, float] = {}
        newest = {log.robot: i for i, log in enumerate(self.logs)}
        for i, log in enumerate(self.logs):
            check = RobotCheck(
                log,
                merged,
                proposals,
                situations,
                markings,
                i,
                plans,
                ended_at,
                newest[log.robot] != i,
            )
            check.check()
            invoked.update(check.invoked)
            last = self.settled and newest[log.robot] == i and replay.ended is None
            if last:
                check.check_goal_at_end()
                here = replay.robots.get(log.robot)
                if here is not None and here.here:
                    check.check_tasks_at_end(replay.stages)
            if check.open:
                text = "%s: %d proposals are not in the log" % (log.robot, len(check.open))
                here = replay.robots.get(log.robot)
                wanted = any(o in check.invoked for o in check.open)
                if last and wanted and here is not None and here.here:
                    raise BrokenRuleError(9, text)
                self.notes.append(text)
        if len({str(log.header.get("host", "")) for log in self.logs}) == 1:
            check_real_time(merged, proposals, invoked)
        self.notes += [
            "the team adopted the plan '%s' (%s)" % (adopted.name, adopted.hash()[:12])
            for adopted in replay.stages.plans
        ]
        if merged.void:
            self.notes.append(
                "%d slots were given up by an eviction by force, or lost with the power"
                % len(merged.void)
            )

    def _check_presence(self, merged: Merged, replay: SlotCheck) -> None:
        """Check that every robot that did anything has a log; robots that were never switched on
        have none. Rule 9."""
        here = {log.robot for log in self.logs}
        said = {
            origin[0]
            for slot in range(1, self.length)
            for origin in merged.slots[slot]["origins"]
            if origin[0]
        }
        needed = {r.name for r in replay.robots.values() if r.here} | set(replay.witnesses) | said
        missing = sorted(needed - here)
        if missing:
            raise BrokenRuleError(
                9, "the log of %s is missing; if it is lost, use --incomplete" % ", ".join(missing)
            )
