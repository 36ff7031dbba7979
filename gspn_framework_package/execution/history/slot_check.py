"""A second implementation of the rules: checks on the net whether the firings of a log are
possible.

It shares no code with the token game: it does not compute what must happen, but checks whether the
rules (``docs/semantics.md``) allow what the log records.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from typing import Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.history.logged_team import LoggedRobot, LoggedTeam
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.plan import Plan

CYCLE = 10_000
"""This many firings after one entry end the run (a timeless cycle)."""


class BrokenRuleError(Exception):
    """A rule was broken: ``rule`` is the number of the invariant (``docs/agreement.md``)."""

    def __init__(self, rule: int, text: str) -> None:
        super().__init__(text)
        self.rule = rule
        self.text = text


class SlotCheck(LoggedTeam):
    """Checks the slots of a log in order.

    :param plan: the plan in the log's header.
    :param agents: whether transitions may create and destroy agents.
    """

    def __init__(self, plan: Plan, agents: bool = False) -> None:
        super().__init__(plan, agents)
        # the policy: places that rows read -> their counts -> numbers of rows
        self._rows: Dict[Tuple[str, ...], Dict[Tuple[int, ...], List[int]]] = {}
        for number, row in enumerate(plan.policy.rows):
            cells = [(p, c) for p, c in zip(plan.policy.places, row.counts) if c is not None]
            group = self._rows.setdefault(tuple(p for p, _ in cells), {})
            group.setdefault(tuple(c for _, c in cells), []).append(number)
        # subnets with policies of their own, by number from 1; the plan's own policy is 0
        self._scope: Dict[str, int] = {}
        self._row_scope = [0] * len(plan.policy.rows)
        for k, scope in enumerate(plan.policy.scopes, 1):
            self._scope.update((place, k) for place in scope.places)
            for number in range(scope.first, scope.last):
                self._row_scope[number] = k

    # -- a slot ------------------------------------------------------------------------------------

    def slot(self, record: Record) -> None:
        """Check the next slot. :raises BrokenRuleError: it breaks a rule."""
        slot = record["slot"]
        firings = list(record["firings"])
        at = 0
        for data in record["entries"]:
            try:
                entry = log_entries.from_json(data)
            except LogError as error:
                raise BrokenRuleError(2, str(error)) from None
            if self.ended is not None:
                break
            direct = self._apply(entry)
            since = 0
            while at < len(firings) and since < CYCLE:
                if self.ended is None and not (direct and since == 0):
                    self._look_at_until()
                why = self._why_not(firings[at], direct if since == 0 else None)
                if why:
                    if direct and since == 0 and self._is_direct(firings[at], direct):
                        raise BrokenRuleError(2, "slot %d: %s" % (slot, why))
                    break
                self._fire(slot, at, firings[at])
                at += 1
                since += 1
            self._settled(slot, since, firings[at] if at < len(firings) else None)
        if at < len(firings):
            why = self._why_not(firings[at], None) or "no entry of the slot leads to it"
            raise BrokenRuleError(
                2,
                "slot %d, firing %d: %s fires, but %s"
                % (slot, at, firings[at].get("transition"), why),
            )
        self._conserved(slot)

    def _settled(self, slot: int, fired: int, following: Optional[Record]) -> None:
        """Check that no firing that was due is missing, and note whether the run is over.

        :param fired: the number of firings after the entry.
        :param following: the next recorded firing, which was not possible here; None if there is
            none.
        """
        if self.ended is None:
            if fired >= CYCLE:
                self.ended = "a cycle of immediate transitions"
                return
            if not self.paused:
                self._look_at_until()
        if self.ended is None and not self.paused and not self.perhaps_ended:
            due = self._due()
            if due and following is not None and following.get("transition") in due:
                raise BrokenRuleError(
                    2,
                    "slot %d: %s fires, but %s"
                    % (slot, following["transition"], self._why_not(following, None)),
                )
            if due:
                raise BrokenRuleError(
                    7, "slot %d: %s is due, and does not fire" % (slot, " and ".join(due))
                )
        here = [r for r in self.robots.values() if r.here]
        if self.ended is None and here and all(r.phase is Phase.INACTIVE for r in here):
            self.ended = "every robot is in a place without output arcs"

    def _look_at_until(self) -> None:
        if self.until is not None and self.robots and not self.paused:
            counts = [self.marking[p.name] for p in self.plan.net.places]
            if self.until.holds(counts):
                self.ended = "until"

    def _due(self) -> List[str]:
        """Transitions that should have fired: immediate ones with only resource inputs, and those
        that robots named."""
        due = [t for t in self.spontaneous if self._has_concession(t)]
        for robot in self._waiting():
            if robot.asks is not None and self._may_fire(robot.asks):
                due.append(robot.asks)
        return due

    def _conserved(self, slot: int) -> None:
        counts = Counter(r.place for r in self.robots.values() if r.here)
        for place, count in self.marking.items():
            if count < 0:
                raise BrokenRuleError(2, "slot %d: %s holds %d tokens" % (slot, place, count))
            if place not in self.resources and counts.get(place, 0) != count:
                raise BrokenRuleError(
                    3,
                    "slot %d: %s holds %d tokens, but %d robots are there"
                    % (slot, place, count, counts.get(place, 0)),
                )

    # -- firings -----------------------------------------------------------------------------------

    def _is_direct(self, firing: Record, direct: Optional[str]) -> bool:
        return firing.get("transition") == direct and not firing.get("robot")

    def _why_not(self, firing: Record, direct: Optional[str]) -> str:
        """Why a firing is not possible now; "" if it is. ``direct``: the environment's transition
        that the preceding entry fires."""
        t = firing.get("transition", "")
        if t not in self.kind:
            return "the net has no transition '%s'" % t
        if self.ended is not None:
            return "the run is over (%s)" % self.ended
        if self.paused:
            return "the team is paused"
        if not self._has_concession(t):
            return "it is not enabled in %s" % _short(self.marking)
        robot = firing.get("robot", "")
        if not robot:
            if t not in self.spontaneous and not self._is_direct(firing, direct):
                return "no robot asked for it"
        elif any(self._has_concession(s) for s in self.spontaneous):
            return "an immediate transition of resources goes first"
        return self._why_not_robots(firing, t, robot)

    def _why_not_robots(self, firing: Record, t: str, requester: str) -> str:
        taken: Dict[str, List[LoggedRobot]] = {}
        for name, source, _, visit in firing["moves"]:
            if source is None:
                continue
            robot = self.robots.get(name)
            if robot is None or not robot.here or robot.place != source:
                return "%s is not in %s" % (name, source)
            if robot.phase is not Phase.DONE:
                return "%s is not done" % name
            if visit != robot.visit + 1:
                return "%s would skip from visit %d to %d" % (name, robot.visit, visit)
            taken.setdefault(source, []).append(robot)
        for place, n in self.inputs[t].items():
            if place in self.resources:
                continue
            free = self._free(place, t)
            movers = taken.pop(place, [])
            if len(movers) != n:
                return "it takes %d robots of %s, not %d" % (len(movers), place, n)
            if any(r not in free for r in movers):
                return "a robot of %s asked for something else" % place
            first = free[:n]
            if any(r.name == requester for r in free[n:]) and requester:
                first = [*free[: n - 1], self.robots[requester]]
            if {r.name for r in movers} != {r.name for r in first}:
                return "robots that were done earlier in %s are passed over" % place
        if taken:
            return "it takes robots of %s" % ", ".join(taken)
        return self._why_not_targets(firing, t) or self._why_not_requester(firing, t, requester)

    def _why_not_targets(self, firing: Record, t: str) -> str:
        targets = Counter(target for _, _, target, _ in firing["moves"] if target is not None)
        expected = {p: n for p, n in self.outputs[t].items() if p not in self.resources}
        if targets != Counter(expected):
            return "robots go to %s, not to %s" % (_short(targets), _short(expected))
        routes = dict(self.plan.routing.get(t, {}))
        room = dict(expected)
        for _, source, target, _ in firing["moves"]:
            wanted = routes.get(source)
            if target is not None and wanted is not None and room.get(wanted, 0) > 0:
                if target != wanted and not self.agents:
                    return "the plan sends the robot of %s to %s" % (source, wanted)
                room[wanted] -= 1
        return ""

    def _why_not_requester(self, firing: Record, t: str, name: str) -> str:
        if not name:
            return ""
        robot = self.robots.get(name)
        if robot is None or robot.phase is not Phase.DONE:
            return "%s, which asked, is not done" % name
        if (firing["incarnation"], firing["visit"]) != (robot.incarnation, robot.visit):
            return "%s is at visit %d" % (name, robot.visit)
        if t in (robot.asks, robot.may_ask):
            return ""
        if robot.asks is not None:
            return "%s asked for %s" % (name, robot.asks)
        return self._why_not_policy(firing, t, robot)

    def _why_not_policy(self, firing: Record, t: str, robot: LoggedRobot) -> str:
        choices = self._choices(robot)
        if not choices:
            return "the policy gives %s nothing to do" % robot.name
        drawn = firing.get("drawn")
        if not drawn:
            return "no draw is recorded"
        if tuple(drawn) <= self.last_firing:
            return "the draw is older than the marking"
        number = _uniform(self.seed, drawn[0], drawn[1], robot.name)
        chosen = _choose(choices, number)
        return "" if chosen == t else "the policy's draw is %s" % chosen

    def _choices(self, robot: LoggedRobot) -> List[Tuple[str, float]]:
        """The choices that the policy gives the robot: those of the most specific matching row with
        a transition that leaves its place, or without any (then the robot waits); if no row matches
        and the plan is not strict, the weights."""
        leaving = [t for t in self.leaving[robot.place] if not self.kind[t].timed]
        best: Optional[Tuple[int, int, List[Tuple[str, float]]]] = None
        matches = False
        scope = self._scope.get(robot.place, 0)
        for number in self._matching_rows():
            if self._row_scope[number] != scope:
                continue
            row = self.plan.policy.rows[number]
            matches = True
            speaks = [(t, p) for t, p in row.choices if p > 0 and t in leaving]
            wildcards = sum(cell is None for cell in row.counts)
            if (speaks or not row.choices) and (best is None or (wildcards, number) < best[:2]):
                best = (wildcards, number, speaks)
        if best is not None:
            total = sum(p for _, p in best[2])
            return self._first_priority([(t, p / total) for t, p in best[2]])
        if matches or self.plan.strict:
            return []
        open_ones = [(t, self.kind[t].weight) for t in leaving if self._may_fire(t)]
        kept = self._first_priority(open_ones)
        return kept if any(w > 0 for _, w in kept) else []

    def _matching_rows(self) -> Iterator[int]:
        """The numbers of the policy's rows that match the marking."""
        for places, rows in self._rows.items():
            yield from rows.get(tuple(self.marking[p] for p in places), ())

    def _first_priority(self, choices: List[Tuple[str, float]]) -> List[Tuple[str, float]]:
        if len({self.kind[t].priority for t, _ in choices}) < 2:
            return choices
        floor = max([self.kind[t].priority for t, _ in choices if self._may_fire(t)], default=0)
        return [(t, w) for t, w in choices if self.kind[t].priority >= floor]

    def _fire(self, slot: int, index: int, firing: Record) -> None:
        where = "slot %d, firing %d (%s)" % (slot, index, firing["transition"])
        if (firing["slot"], firing["index"]) != (slot, index):
            raise BrokenRuleError(1, "the recorded position of %s differs" % where)
        for p, change in self._effect(firing["transition"]).items():
            self.marking[p] += change
        if {p: n for p, n in self.marking.items() if n} != firing["marking"]:
            raise BrokenRuleError(
                2,
                "%s leads to %s, not to %s as recorded"
                % (where, _short(self.marking), _short(firing["marking"])),
            )
        self.last_firing = (slot, index)
        arrived = []
        for name, source, target, visit in firing["moves"]:
            if target is None:
                del self.robots[name]
                continue
            if source is None:
                if not self.agents or name in self.robots:
                    raise BrokenRuleError(3, "%s brings %s into being" % (where, name))
                self.robots[name] = LoggedRobot(name, target, 0)
            robot = self.robots[name]
            robot.place, robot.visit, robot.may_ask = target, visit, None
            arrived.append(robot)
        for robot in arrived:
            self._enter(robot)


def _short(marking: Mapping[str, int]) -> str:
    return "{%s}" % ", ".join("%s: %d" % (p, n) for p, n in sorted(marking.items()) if n)


def _uniform(seed: int, slot: int, index: int, who: str) -> float:
    """The first 53 bits of the SHA-256 of seed, slot, index and robot, as a number in [0, 1)."""
    text = "|".join([str(seed), str(slot), str(index), who])
    bits = int(hashlib.sha256(text.encode()).hexdigest(), 16) >> (256 - 53)
    return bits / 2.0**53


def _choose(choices: Sequence[Tuple[str, float]], number: float) -> str:
    left = number * sum(w for _, w in choices)
    for t, w in choices:
        left -= w
        if left < 0:
            return t
    return [t for t, w in choices if w > 0][-1]
