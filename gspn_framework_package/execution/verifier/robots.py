"""Checks each robot's proposals, goals and local transitions, as its own log records them, against
the agreed log."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, OrderedDict
from typing import Any, Dict, List, Mapping, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution.event_log import ORDER_GIVEN, EventLog, Record
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.verifier.cargo import digest
from gspn_framework_package.execution.verifier.logged_team import Situation
from gspn_framework_package.execution.verifier.merge import Merged
from gspn_framework_package.execution.verifier.slot_check import BrokenRuleError
from gspn_framework_package.execution.verifier.stages import LoggedStages
from gspn_framework_package.model.plan import Plan

LoggedOrigin = Tuple[str, int, int, str]

_Position = Tuple[str, int, int, int, Phase]
"""A robot's place, incarnation, visit, attempt and phase."""


class LoggedProposals:
    """The position of each entry in the agreed log, by its origin; rule 4.

    :param merged: the agreed log.
    :param length: the number of slots to check.
    :raises BrokenRuleError: an entry occurs twice, the entries of a robot are out of order, or a
        robot begins a visit twice.
    """

    def __init__(self, merged: Merged, length: int) -> None:
        self.where: Dict[LoggedOrigin, Tuple[int, Record]] = {}
        self.tasks: Set[Tuple[str, str]] = set()
        self._newest: Dict[str, Tuple[int, int]] = {}
        self._newest_of: Dict[Tuple[str, int, str], int] = {}
        self._fired: Dict[int, Set[Tuple[str, int, str]]] = {}
        newest = self._newest
        moved: Set[Tuple[str, int]] = set()
        for slot in range(length):
            record = merged.slots[slot]
            for entry, origin in zip(record["entries"], record["origins"]):
                key = _key(origin)
                if key in self.where:
                    raise BrokenRuleError(
                        4,
                        "%s is in the log twice: slots %d and %d"
                        % (_name(key), self.where[key][0], slot),
                    )
                if newest.get(key[0], (-1, -1)) >= key[1:3]:
                    raise BrokenRuleError(
                        4,
                        "%s is in slot %d, after a newer proposal of that robot"
                        % (_name(key), slot),
                    )
                if entry["entry"] == "submit":
                    self.tasks.add((entry["transition"], entry["id"]))
                newest[key[0]] = key[1:3]
                self._newest_of[key[0], key[1], key[3]] = key[2]
                self.where[key] = (slot, entry)
            self._fired[slot] = {
                (f["robot"], f["visit"], f["transition"]) for f in record["firings"]
            }
            for firing in record["firings"]:
                for robot, source, _, visit in firing["moves"]:
                    if source is not None and (robot, visit) in moved:
                        raise BrokenRuleError(
                            4, "%s begins its visit %d twice (slot %d)" % (robot, visit, slot)
                        )
                    moved.add((robot, visit))

    def newest_before(self, key: LoggedOrigin) -> bool:
        """Whether a newer proposal of the same robot, incarnation and log is in the agreed log."""
        return self._newest_of.get((key[0], key[1], key[3]), -1) > key[2]

    def overtaken(self, key: LoggedOrigin) -> bool:
        """Whether a proposal of the same robot that is at least as new is in the agreed log."""
        return self._newest.get(key[0], (-1, -1)) >= key[1:3]

    def fired(self, slot: int, firing: Record) -> bool:
        """Whether a slot contains that firing of the robot, as far as it concerns the robot."""
        return (firing["robot"], firing["visit"], firing["transition"]) in self._fired[slot]


def check_real_time(
    merged: Merged, proposals: LoggedProposals, invoked: Mapping[LoggedOrigin, float]
) -> None:
    """Check that every slot known when a proposal was made precedes it in the log; rule 5. Use this
    only for logs of one host, which share a clock.

    :param merged: the agreed log.
    :param proposals: the positions of the entries in it.
    :param invoked: when each proposal (other than local transitions) was made, in s.
    :raises BrokenRuleError: a proposal precedes a slot that was known before it was made.
    """
    by_time = sorted((time, slot) for slot, time in merged.heard.items())
    times = [time for time, _ in by_time]
    latest: List[int] = []
    for _, slot in by_time:
        latest.append(max(slot, latest[-1] if latest else -1))
    for key, time in invoked.items():
        where = proposals.where.get(key)
        if where is None:
            continue
        at = bisect_left(times, time)
        if at and latest[at - 1] >= where[0]:
            raise BrokenRuleError(
                5,
                "%s was proposed after slot %d was known, but is in slot %d"
                % (_name(key), latest[at - 1], where[0]),
            )


class RobotCheck:
    """Checks one log from its robot's point of view; rules 4, 8 and 10.

    :param log: the log to check.
    :param merged: the agreed log.
    :param proposals: the positions of the entries in the agreed log.
    :param situations: for each slot, the situations of the robots after it.
    :param markings: for each slot, the marking after it, without empty places.
    :param number: the index of the log among all logs.
    :param plans: for each slot, the plan that the team followed after it.
    :param ended_at: the slot in which the run ended; None if it did not.
    :param lost: whether the robot lost this log and later kept another one, so that local
        transitions that only this log knew may be void.
    """

    def __init__(
        self,
        log: EventLog,
        merged: Merged,
        proposals: LoggedProposals,
        situations: Sequence[Dict[str, Situation]],
        markings: Sequence[Dict[str, int]],
        number: int,
        plans: Sequence[Plan],
        ended_at: Optional[int],
        lost: bool,
    ) -> None:
        self.log = log
        self.robot = log.robot
        self.merged = merged
        self.proposals = proposals
        self.situations = situations
        self.markings = markings
        self.number = number
        self.plans = plans
        self._ended_at = ended_at
        self._lost = lost
        self._jumped = False
        self.invoked: Dict[LoggedOrigin, float] = {}
        self.open: List[LoggedOrigin] = []
        """Proposals that never got into the agreed log."""
        self._length = 0
        self._incarnation = 0
        self._ahead: OrderedDict[LoggedOrigin, Tuple[Record, Record]] = OrderedDict()
        """Local transitions that are not in the agreed log yet: entry, firing."""
        self._from: Optional[_Position] = None
        """The robot's position before them."""
        self._at: Optional[_Position] = None
        """The robot's position after them."""
        self._astray = True
        """Whether these positions must be recomputed."""
        self._entered: Counter[str] = Counter()
        """How often they led it to each place."""
        self._goals: Set[Tuple[int, int, int]] = set()
        self._last_goal: Optional[Tuple[int, int, int]] = None
        self._void: Set[LoggedOrigin] = set()
        self._offered: Set[Tuple[str, str]] = set()
        """(transition, id) of the tasks that reached the robot."""
        self._givers: Set[Tuple[str, str]] = set()
        """The operators that gave this robot an order: name and proof."""

    def check(self) -> None:
        """Check the log. :raises BrokenRuleError: a rule is broken."""
        known: Dict[LoggedOrigin, Record] = {}
        differs = {i for n, i in self.merged.void if n == self.number}
        given_up = False
        for i, record in enumerate(self.log.records):
            kind = record["kind"]
            given_up = (given_up or i in differs) and kind != "reset"
            if kind in ("invoked", "private") and _origin(record) in known:
                raise BrokenRuleError(4, "%s was proposed twice" % _name(_origin(record)))
            if kind in ("invoked", "private"):
                known[_origin(record)] = record
                self._ordered(_origin(record), record["entry"])
            elif kind == "life":
                self._incarnation = record["incarnation"]
                self._last_goal = None
            elif kind == ORDER_GIVEN:
                self._givers.add((str(record["operator"]), str(record["proof"])))
            elif kind == "offered":
                entry = record["entry"]
                self._offered.add((entry["transition"], entry["id"]))
            if given_up and kind == "slot":  # the team had these tasks, and lost them with the slot
                submits = (e for e in record["entries"] if e["entry"] == "submit")
                self._offered -= {(e["transition"], e["id"]) for e in submits}
            if not given_up:
                self._compare(record, known)
            elif kind in ("invoked", "private"):  # until it forgets, its log is another one
                self._void.add(_origin(record))
        if given_up:
            self._void |= set(known)
        for origin, record in known.items():
            self._proposal(origin, record)

    def _compare(self, record: Record, known: Mapping[LoggedOrigin, Record]) -> None:
        """Compare a record with the agreed log.

        :param known: the proposals up to and including this record.
        """
        kind = record["kind"]
        if kind == "slot" or kind == "snapshot":
            self._length = record["slot"] + 1
            self._jumped = kind == "snapshot"
            self._follow()
        elif kind == "reset":
            self._length = 0
            self._ahead.clear()
            self._astray = True
            self._void |= set(known)
        elif kind == "void":
            origin = _origin(record)
            self._ruled_out(origin, known)
            self._void.add(origin)
            self._astray = self._ahead.pop(origin, None) is not None or self._astray
        elif kind == "invoked":
            self.invoked[_origin(record)] = float(record.get("mono", 0.0))
        elif kind == "private":
            self._local_transition(_origin(record), record)
        elif kind == "goal":
            self._goal(record)

    def _ordered(self, origin: LoggedOrigin, entry: Record) -> None:
        """Check that the operator named by a proposal had given this robot an order."""
        by = entry.get("by")
        if by is not None and tuple(by) not in self._givers:
            raise BrokenRuleError(
                4,
                "%s names '%s', who had not given %s an order" % (_name(origin), by[0], self.robot),
            )

    @property
    def _plan(self) -> Plan:
        """The plan that the team followed, as this log knew it."""
        return self.plans[min(self._length, len(self.plans)) - 1]

    def _ruled_out(self, origin: LoggedOrigin, known: Mapping[LoggedOrigin, Record]) -> None:
        """Check that a local transition is void only if the robot was lost or has left, or the run
        is over."""
        record = known.get(origin)
        if record is None or record["kind"] != "private" or self._jumped:
            return
        over = self._ended_at is not None and self._length > self._ended_at
        at = self._base()
        if not over and at is not None and not at[4].gone:
            raise BrokenRuleError(
                10,
                "the local transition %s was withdrawn, although the robot was never lost"
                % _name(origin),
            )

    def _in_log(self, origin: LoggedOrigin) -> bool:
        where = self.proposals.where.get(origin)
        return where is not None and where[0] < self._length

    def _proposal(self, origin: LoggedOrigin, record: Record) -> None:
        where = self.proposals.where.get(origin)
        if where is None:
            private = record["kind"] == "private"
            if private and origin not in self._void and self.proposals.newest_before(origin):
                raise BrokenRuleError(
                    4, "%s was acknowledged, but skipped in the log" % _name(origin)
                )
            if origin not in self._void and not self.proposals.overtaken(origin):
                self.open.append(origin)
        elif where[1] != record["entry"]:
            raise BrokenRuleError(
                4, "%s is in slot %d as a different entry" % (_name(origin), where[0])
            )
        elif record["kind"] == "private":
            self._merged_transition(origin, record, where[0])

    # -- local transitions -------------------------------------------------------------------------

    def _base(self) -> Optional[_Position]:
        """The robot's position as this log knew it, without local transitions that are not in the
        agreed log; None if the log did not know it."""
        if not 0 < self._length <= len(self.situations):
            return None
        at = self.situations[self._length - 1].get(self.robot)
        return None if at is None else at[:5]

    def _follow(self) -> None:
        """Process an extension of the log. If it contains the first local transitions as they were
        made, the robot's position is unchanged."""
        while self._ahead and self._in_log(next(iter(self._ahead))):
            _, (entry, firing) = self._ahead.popitem(last=False)
            target = firing["moves"][0][2]
            self._entered[target] -= 1
            if self._from is not None:
                after = entry["visit"] + 1
                self._from = target, entry["incarnation"], after, 1, self._from[4]
        self._astray = self._astray or self._base() != self._from

    def _position(self) -> Optional[_Position]:
        """The robot's position as this log knew it, including local transitions; None if the log
        did not know it."""
        if self._astray:
            self._astray = False
            self._from = self._at = self._base()
            self._entered.clear()
            for entry, firing in self._ahead.values():
                self._step(entry, firing)
        return self._at

    def _step(self, entry: Record, firing: Record) -> None:
        """Process a local transition of the robot."""
        target = firing["moves"][0][2]
        self._entered[target] += 1
        if self._at is None:
            return
        _, incarnation, visit, _, phase = self._at
        if (entry["incarnation"], entry["visit"]) == (incarnation, visit):
            self._at = target, incarnation, visit + 1, 1, phase

    def _local_transition(self, origin: LoggedOrigin, record: Record) -> None:
        entry, firing = record["entry"], record["firing"]
        at = self._position()
        what = "the local transition %s" % _name(origin)
        if at is None or at[4] is not Phase.DOING:
            raise BrokenRuleError(10, "%s: the robot has no action to end" % what)
        if (entry["incarnation"], entry["visit"]) != at[1:3]:
            raise BrokenRuleError(
                10, "%s is of visit %d, the robot is at %d" % (what, entry["visit"], at[2])
            )
        self._check_local(what, at[0], firing)
        if (
            not self._jumped
            and not self._void
            and firing["marking"] != self._known_marking(firing["moves"][0][2])
        ):
            raise BrokenRuleError(
                10, "%s leads to a marking that differs from the recorded one" % what
            )
        self._ahead[origin] = (entry, firing)
        self._step(entry, firing)

    def _known_marking(self, target: str) -> Dict[str, int]:
        """The marking as this log knew it after a local transition to ``target``."""
        marking = dict(self.markings[self._length - 1])
        place = self.situations[self._length - 1][self.robot].place
        marking[place] -= 1
        marking[target] = marking.get(target, 0) + 1
        return {p: n for p, n in marking.items() if n}

    def _check_local(self, what: str, place: str, firing: Record) -> None:
        """Check that the transition moves this robot from its place and changes nothing else."""
        arcs = [a for a in self._plan.net.arcs if firing["transition"] in (a.source, a.target)]
        inputs = [a for a in arcs if a.target == firing["transition"]]
        outputs = [a for a in arcs if a.source == firing["transition"]]
        ((_, source, target, _),) = firing["moves"]
        plain = (
            len(inputs) == len(outputs) == 1
            and not inputs[0].inhibitor
            and inputs[0].weight == outputs[0].weight == 1
            and (inputs[0].source, outputs[0].target) == (source, target)
        )
        if not plain or source != place or target in self._plan.resource_places:
            raise BrokenRuleError(
                10,
                "%s: %s does not move this robot alone from %s"
                % (what, firing["transition"], place),
            )

    def _merged_transition(self, origin: LoggedOrigin, record: Record, slot: int) -> None:
        """Check that a local transition has the same effect in the agreed log as it had for its
        robot."""
        before = self.situations[slot - 1].get(self.robot) if slot else None
        after = self.situations[slot].get(self.robot)
        if origin in self._void or (before and before.phase.gone) or (after and after.phase.gone):
            return  # void, because it entered the log after the robot was lost
        if self._lost:
            return
        mine = record["firing"]
        if self.proposals.fired(slot, mine):
            return
        raise BrokenRuleError(
            10, "the local transition %s did not happen in slot %d" % (_name(origin), slot)
        )

    # -- goals -------------------------------------------------------------------------------------

    def _goal(self, record: Record) -> None:
        key = (record["incarnation"], record["visit"], record["attempt"])
        what = "the goal of %s for visit %d, attempt %d" % (self.robot, key[1], key[2])
        at = self._position()
        if at is None or at[4] is not Phase.DOING:
            raise BrokenRuleError(8, "%s: the robot has no action to start" % what)
        if (record["place"], *key) != at[:4]:
            raise BrokenRuleError(
                8,
                "%s in %s, but the robot is in %s at visit %d, attempt %d"
                % (what, record["place"], at[0], at[2], at[3]),
            )
        if key in self._goals:
            raise BrokenRuleError(8, "%s was sent twice" % what)
        self._memory(record, what, at[0])
        self._goals.add(key)
        self._last_goal = key

    def _memory(self, record: Record, what: str, place: str) -> None:
        """Check that the action reads the data that the log had before it, and continues the right
        visit; rule 11."""
        if not self._plan.events and "reads" not in record:
            return  # a log of a version without data
        memory = self.situations[self._length - 1][self.robot].memory
        data = memory.data()
        if record.get("reads", "") != (digest(data) if data else ""):
            raise BrokenRuleError(11, "%s reads data that differs from the log before it" % what)
        if not self._ahead:
            expected = memory.resumed_from
        else:
            expected = 0 if self._entered[place] > 1 else memory.interrupted.get(place, 0)
        if record.get("resumed_from", 0) != expected:
            raise BrokenRuleError(11, "%s does not continue visit %d" % (what, expected))

    def check_tasks_at_end(self, stages: LoggedStages) -> None:
        """Check that every task that reached the robot is in the agreed log; rule 9. Under an
        adopted plan, a transition may take no more tasks; pending ones are then refused. Call this
        only for robots whose nodes are up and take part."""
        there = {(stages.present_name(t), task) for t, task in self.proposals.tasks}
        offered = {
            (stages.present_name(t), task) for t, task in self._offered if t not in stages.closed
        }
        missing = [task for _, task in sorted(offered - there)]
        if missing:
            raise BrokenRuleError(
                9, "task %s reached %s, but is not in the log" % (missing[0], self.robot)
            )

    def check_goal_at_end(self) -> None:
        """Check that the robot runs the right action, if its log has all slots; rule 8. Call this
        only for robots whose nodes are up and take part."""
        at = self._position()
        if self._length != len(self.situations) or at is None or at[4] is not Phase.DOING:
            return
        if at[1] != self._incarnation or self._plan.action(self.robot, at[0]) is None:
            return
        if self._last_goal != at[1:4]:
            raise BrokenRuleError(
                8,
                "%s has no goal for visit %d, attempt %d in %s" % (self.robot, at[2], at[3], at[0]),
            )


def _origin(record: Record) -> LoggedOrigin:
    return _key(record["origin"])


def _key(origin: Any) -> LoggedOrigin:
    robot, incarnation, number, log_id = origin
    return str(robot), int(incarnation), int(number), str(log_id)


def _name(origin: LoggedOrigin) -> str:
    return "proposal %d of %s (incarnation %d)" % (origin[2], origin[0], origin[1])
