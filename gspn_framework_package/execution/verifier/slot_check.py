"""A second implementation of the rules: checks on the net whether the firings of a log are
possible.

It shares no code with the token game. Instead of computing what must happen, it checks whether the
rules (``docs/semantics.md``) allow what the log records.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.verifier.cargo import recorded_moves
from gspn_framework_package.execution.verifier.logged_team import Direct, LoggedRobot, LoggedTeam
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy_cell import CountTest

NO_EVENT = EventSource()

CYCLE = 10_000
"""Number of firings after one entry that ends the run (a timeless cycle)."""


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

    def _take_rules(self, plan: Plan) -> None:
        super()._take_rules(plan)
        # the policy: places that rows read -> their counts -> numbers of rows
        self._rows: Dict[Tuple[str, ...], Dict[Tuple[int, ...], List[int]]] = {}
        self._tests: Dict[int, List[Tuple[str, str, int]]] = {}  # row -> place, sign, tokens
        for number, row in enumerate(plan.policy.rows):
            cells = []
            for p, c in zip(plan.policy.places, row.counts):
                if isinstance(c, CountTest):
                    self._tests.setdefault(number, []).append((p, *c))
                elif c is not None:
                    cells.append((p, c))
            group = self._rows.setdefault(tuple(p for p, _ in cells), {})
            group.setdefault(tuple(c for _, c in cells), []).append(number)
        # subnets with their own policies, by number from 1; the plan's own policy is 0
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
            of_entry = int(direct is not None)  # excluding the firing of the entry itself
            while at < len(firings) and since < CYCLE + of_entry:
                if self.ended is None and not (direct and since == 0):
                    self._look_at_until()
                first = direct if since == 0 else None
                why = self._why_not(firings[at], first)
                if why:
                    if self._is_direct(firings[at], first):
                        raise BrokenRuleError(2, "slot %d: %s" % (slot, why))
                    break
                self._fire(slot, at, firings[at], first)
                at += 1
                since += 1
            if direct and not since and not self.perhaps_ended:
                raise BrokenRuleError(
                    7, "slot %d: %s is due, but does not fire" % (slot, direct.transition)
                )
            self._settled(slot, since - of_entry, firings[at] if at < len(firings) else None)
        if at < len(firings):
            why = self._why_not(firings[at], None) or "no entry of the slot causes it"
            raise BrokenRuleError(
                2,
                "slot %d, firing %d: %s fires, but %s"
                % (slot, at, firings[at].get("transition"), why),
            )
        self._conserved(slot)

    def _settled(self, slot: int, fired: int, following: Optional[Record]) -> None:
        """Check that no firing that was due is missing, and note whether the run is over.

        :param fired: the number of firings after the entry.
        :param following: the next recorded firing, which is not possible here; None if there is
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
                    7, "slot %d: %s is due, but does not fire" % (slot, " and ".join(due))
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
        """Transitions that should have fired: immediate ones with only resource inputs and those
        that robots named; if there are none, held events; if there are none, waiting tasks."""
        due = [t for t in self.spontaneous if self._has_concession(t)]
        for robot in self._waiting():
            if robot.asks is not None and self._may_ask(robot, robot.asks):
                due.append(robot.asks)
        return due or self._held() or self._waiting_tasks()[:1]

    def _held(self) -> List[str]:
        """The held events that can interrupt a robot."""
        return [
            t for r in self.robots.values() if r.here for t in r.held if self._may_interrupt(r, t)
        ]

    def _waiting_tasks(self) -> List[str]:
        """The transitions through which a waiting task can arrive, that of the oldest first."""
        waiting = [t for t, task in self.cargo.outside if not task.at]
        return [t for t in waiting if self._has_concession(t)]

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

    def _is_direct(self, firing: Record, direct: Optional[Direct]) -> bool:
        who = firing.get("transition"), firing.get("robot", "")
        return direct is not None and direct[:2] == who

    def _why_not(self, firing: Record, direct: Optional[Direct]) -> str:
        """Why a firing is not possible now; "" if it is. ``direct``: the firing that the preceding
        entry causes."""
        t = firing.get("transition", "")
        if t not in self.kind:
            return "the net has no transition '%s'" % t
        if self.ended is not None:
            return "the run is over (%s)" % self.ended
        if self.paused:
            return "the team is paused"
        if not self._has_concession(t):
            return "it is not enabled in %s" % _short(self.marking)
        name = firing.get("robot", "")
        if self._is_direct(firing, direct):
            if name and direct is not None:
                return self._why_not_event(firing, t, name, direct.cause)
            return self._why_not_moved(firing, t)
        if t not in self.spontaneous and any(self._has_concession(s) for s in self.spontaneous):
            return "an immediate transition of resources takes precedence"
        robot = self.robots.get(name)
        if robot is not None and self._is_held(robot, t):
            if self._asked():
                return "a robot that is done takes precedence over a held event"
            return self._why_not_event(firing, t, name, robot.held[t])
        if firing.get("cause"):
            return "no event with this cause occurred"
        if not name and t not in self.spontaneous:
            return self._why_not_task(firing, t)
        return self._why_not_robots(firing, t, name)

    def _is_held(self, robot: LoggedRobot, t: str) -> bool:
        """Whether ``t`` interrupts the robot because its event is held."""
        asks = robot.phase is Phase.DONE and t in (robot.asks, robot.may_ask)
        return t in robot.held and not (asks and not robot.paused)

    def _asked(self) -> bool:
        """Whether a transition that a robot named may fire."""
        return any(r.asks is not None and self._may_ask(r, r.asks) for r in self._waiting())

    def _may_ask(self, robot: LoggedRobot, t: str) -> bool:
        """Whether a transition may fire if this robot asks for it."""
        return self._may_fire(t) and self._may_take(robot, t)

    def _why_not_task(self, firing: Record, t: str) -> str:
        """Why no task arrives through ``t`` now."""
        tasks = self._waiting_tasks()
        if t not in tasks:
            return "no robot asked for it, and no task is waiting for it"
        if tasks[0] != t:
            return "an older task waits for %s" % tasks[0]
        if self._asked() or self._held():
            return "robots take precedence over an arriving task"
        return self._why_not_moved(firing, t)

    def _why_not_moved(self, firing: Record, t: str) -> str:
        return self._why_not_robots(firing, t, "")

    def _why_not_event(self, firing: Record, t: str, name: str, cause: Mapping[str, Any]) -> str:
        """Why the event of ``t`` does not interrupt this robot with this cause."""
        robot = self.robots.get(name)
        if robot is None or not robot.here or robot.place not in self.inputs[t]:
            return "%s is not in the place of the event" % name
        if robot.paused:
            return "%s is paused" % name
        if not self._may_take(robot, t):
            return "the tasks there are for other robots than %s" % name
        if (firing["incarnation"], firing["visit"]) != (robot.incarnation, robot.visit):
            return "%s is at visit %d" % (name, robot.visit)
        movers = [(r, source, visit) for r, source, _, visit in firing["moves"] if source]
        if firing.get("cause", {}) != cause:
            return "its cause is %s" % dict(cause)
        if movers != [(name, robot.place, robot.visit + 1)]:
            return "the event moves only %s" % name
        return self._why_not_targets(firing, t)

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
                return "a robot in %s asked for something else" % place
            if self.draws_ties:
                drawn = self._drawn(firing, free, n, requester)
                if {r.name for r in movers} != set(drawn):
                    return "chance selects %s in %s" % (" and ".join(drawn), place)
                continue
            first = free[:n]
            if any(r.name == requester for r in free[n:]) and requester:
                first = [*free[: n - 1], self.robots[requester]]
            if {r.name for r in movers} != {r.name for r in first}:
                return "robots that were done earlier in %s are skipped" % place
        if taken:
            return "it takes robots of %s" % ", ".join(taken)
        return self._why_not_targets(firing, t) or self._why_not_requester(firing, t, requester)

    def _drawn(self, firing: Record, free: List[LoggedRobot], n: int, requester: str) -> List[str]:
        """The ``n`` robots that move of those that are free in a place: the one that asked if it is
        among them, and others by chance."""
        names = [r.name for r in free]
        drawn = [name for name in names if name == requester]
        rest = [name for name in names if name != requester]
        for k in range(n - len(drawn)):
            who = "in %s#%d" % (free[0].place, k)
            number = _uniform(self.seed, firing["slot"], firing["index"], who)
            drawn.append(rest.pop(int(number * len(rest))))
        return drawn

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
            return "the policy makes %s wait" % robot.name
        drawn = firing.get("drawn")
        if not drawn:
            return "no draw is recorded"
        if tuple(drawn) <= self.last_change:
            return "the draw is older than the marking"
        if tuple(drawn) <= self.moved.get(robot.name, self.last_change):
            return "the draw is older than the visit"
        number = _uniform(self.seed, drawn[0], drawn[1], robot.name)
        chosen = _choose(choices, number)
        return "" if chosen == t else "the policy's draw is %s" % chosen

    def _choices(self, robot: LoggedRobot) -> List[Tuple[str, float]]:
        """The choices that the policy gives the robot: those of the most specific matching row that
        has a transition leaving its place or has none at all (then the robot waits); if no row
        matches and the plan is not strict, the weights."""
        leaving = [t for t in self.leaving[robot.place] if not self.kind[t].timed]
        best: Optional[Tuple[Tuple[int, int, int], List[Tuple[str, float]]]] = None
        matches = False
        scope = self._scope.get(robot.place, 0)
        for number in self._matching_rows():
            if self._row_scope[number] != scope:
                continue
            row = self.plan.policy.rows[number]
            matches = True
            speaks = [(t, p) for t, p in row.choices if p > 0 and t in leaving]
            wildcards = sum(cell is None for cell in row.counts)
            rank = (wildcards, len(self._tests.get(number, ())), number)
            if (speaks or not row.choices) and (best is None or rank < best[0]):
                best = (rank, speaks)
        if best is not None:
            total = sum(p for _, p in best[1])
            return self._first_priority([(t, p / total) for t, p in best[1]], robot)
        if matches or self.plan.strict:
            return []
        open_ones = [(t, self._weight(t)) for t in leaving if self._may_ask(robot, t)]
        kept = self._first_priority(open_ones, robot)
        return kept if any(w > 0 for _, w in kept) else []

    def _weight(self, t: str) -> float:
        function = self.kind[t].function
        return self.kind[t].number if function is None else function.value(self.marking)

    def _matching_rows(self) -> Iterator[int]:
        """The numbers of the policy's rows that match the marking."""
        for places, rows in self._rows.items():
            for number in rows.get(tuple(self.marking[p] for p in places), ()):
                tests = self._tests.get(number, ())
                if all(_passes(self.marking[p], sign, n) for p, sign, n in tests):
                    yield number

    def _first_priority(
        self, choices: List[Tuple[str, float]], robot: LoggedRobot
    ) -> List[Tuple[str, float]]:
        if len({self.kind[t].priority for t, _ in choices}) < 2:
            return choices
        ready = [self.kind[t].priority for t, _ in choices if self._may_ask(robot, t)]
        floor = max(ready, default=0)
        return [(t, w) for t, w in choices if self.kind[t].priority >= floor]

    def _fire(self, slot: int, index: int, firing: Record, direct: Optional[Direct]) -> None:
        self._note_interrupt(firing, direct)
        self._pass_tasks(slot, index, firing, direct)
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
        if any(self._effect(firing["transition"]).values()):
            self.last_change = (slot, index)
        self.moved.update((move[0], (slot, index)) for move in firing["moves"])
        arrived = []
        for name, source, target, visit in firing["moves"]:
            if target is None:
                del self.robots[name]
                continue
            if source is None:
                if not self.agents or name in self.robots:
                    raise BrokenRuleError(3, "%s creates %s" % (where, name))
                self.robots[name] = LoggedRobot(name, target, 0)
            robot = self.robots[name]
            robot.place, robot.visit, robot.may_ask = target, visit, None
            arrived.append(robot)
        for robot in arrived:
            self._enter(robot)

    def _note_interrupt(self, firing: Record, direct: Optional[Direct]) -> None:
        """Note the visit that an event interrupts, if a later one may continue it."""
        t, robot = firing["transition"], self.robots.get(firing.get("robot", ""))
        if robot is None or not self.plan.events.get(t, NO_EVENT).resume:
            return
        if self._is_direct(firing, direct) or self._is_held(robot, t):
            robot.interrupted = {**robot.interrupted, robot.place: robot.visit}

    def _pass_tasks(self, slot: int, index: int, firing: Record, direct: Optional[Direct]) -> None:
        """Move the tasks as the firing records; rule 11."""
        t, cargo = firing["transition"], self.cargo
        robots = [
            (name, target is not None) for name, source, target, _ in firing["moves"] if source
        ]
        comes = not firing.get("robot") and not self._is_direct(firing, direct)
        incoming = cargo.enter(t) if comes and t in cargo.entrances else None
        expected = cargo.pass_on(t, robots, incoming)
        recorded = recorded_moves(firing)
        if sorted(expected) != sorted(recorded):
            raise BrokenRuleError(
                11,
                "slot %d, firing %d (%s) moves the tasks as %s, not as %s"
                % (slot, index, t, recorded, expected),
            )


def _short(marking: Mapping[str, int]) -> str:
    return "{%s}" % ", ".join("%s: %d" % (p, n) for p, n in sorted(marking.items()) if n)


def _passes(count: int, sign: str, tokens: int) -> bool:
    """Whether ``count`` tokens in a place fit a cell."""
    if sign == "!=":
        return count != tokens
    if count == tokens:
        return sign in ("<=", ">=")
    return (count < tokens) == sign.startswith("<")


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
