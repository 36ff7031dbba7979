"""A second reading of the rules: what entries and firings of a log may be, checked on the net.

This is written apart from the token game and shares no code with it: it does not work out what
must happen, but looks at what is said to have happened, and whether the rules
(``docs/semantics.md``) allow it.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import dataclass
from typing import Any, Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution import entries as log
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.plan import FailureKind, LostKind, Plan

Record = Dict[str, Any]

CYCLE = 10_000
"""More firings after one entry end the run (a cycle without time)."""


class BrokenRuleError(Exception):
    """A rule was broken: ``rule`` is the number of the invariant (``docs/agreement.md``)."""

    def __init__(self, rule: int, text: str) -> None:
        super().__init__(text)
        self.rule = rule
        self.text = text


class Situation(NamedTuple):
    """Where a robot is after some slot; ``phase`` is one of doing, done, failed, inactive, lost,
    left."""

    place: str
    incarnation: int
    visit: int
    attempt: int
    phase: str


@dataclass
class Token:
    """A robot, as the log tells it."""

    name: str
    place: str
    incarnation: int
    visit: int = 1
    attempt: int = 1
    phase: str = "doing"
    asks: Optional[str] = None
    """A transition; None: the policy decides."""
    may_ask: Optional[str] = None
    """A transition it asks for instead, if it waited for a robot that was lost."""
    order: int = 0
    failures: int = 0
    paused: bool = False

    @property
    def goal(self) -> Tuple[int, int, int]:
        """(incarnation, visit, attempt)."""
        return self.incarnation, self.visit, self.attempt

    @property
    def here(self) -> bool:
        """Whether its token is in the net."""
        return self.phase not in ("lost", "left")


class Replay:
    """The state of a team as far as the entries and firings that were looked at.

    :param plan: the plan that the log carries.
    :param agents: transitions may create and destroy tokens.
    """

    def __init__(self, plan: Plan, agents: bool = False) -> None:
        self.plan = plan
        self.agents = agents
        net = plan.net
        self.resources = set(plan.resource_places)
        self.marking: Dict[str, int] = {p.name: p.tokens if p.name in self.resources else 0 for p in net.places}
        self.robots: Dict[str, Token] = {}
        self.witnesses: Tuple[str, ...] = ()
        self.seed = 0
        self.paused = False
        self.ended: Optional[str] = None
        self.perhaps_ended = False
        self.orders = 0
        self.last_firing = (-1, -1)
        self.inputs: Dict[str, Dict[str, int]] = {}
        self.outputs: Dict[str, Dict[str, int]] = {}
        self.limits: Dict[str, Dict[str, int]] = {}
        for t in net.transitions:
            self.inputs[t.name], self.outputs[t.name], self.limits[t.name] = {}, {}, {}
        for arc in net.arcs:
            if arc.source in self.inputs:
                _add(self.outputs[arc.source], arc.target, arc.weight)
            elif arc.inhibitor:
                known = self.limits[arc.target].get(arc.source, arc.weight)
                self.limits[arc.target][arc.source] = min(known, arc.weight)
            else:
                _add(self.inputs[arc.target], arc.source, arc.weight)
        self.kind = {t.name: t for t in net.transitions}
        self.capacity = {p.name: p.capacity for p in net.places}
        self.leaving: Dict[str, List[str]] = {p.name: [] for p in net.places}
        for t in net.transitions:
            for place in self.inputs[t.name]:
                self.leaving[place].append(t.name)
        self.spontaneous = [
            t.name
            for t in net.transitions
            if not t.timed
            and self.resources.issuperset(self.inputs[t.name])
            and (agents or self.resources.issuperset(self.outputs[t.name]))
        ]
        self.until = parse_condition(plan.until, [p.name for p in net.places]) if plan.until else None

    # -- a slot ------------------------------------------------------------------------------------

    def slot(self, record: Record) -> None:
        """Look at one slot. :raises BrokenRuleError: it breaks a rule."""
        slot = record["slot"]
        firings = list(record["firings"])
        at = 0
        for data in record["entries"]:
            try:
                entry = log.from_json(data)
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
                "slot %d, firing %d: %s fires, but %s" % (slot, at, firings[at].get("transition"), why),
            )
        self._conserved(slot)

    def _settled(self, slot: int, fired: int, following: Optional[Record]) -> None:
        """Nothing that is due was left out; see whether the run is over.

        :param following: the firing that is recorded next, which did not fit here.
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
                    2, "slot %d: %s fires, but %s" % (slot, following["transition"], self._why_not(following, None))
                )
            if due:
                raise BrokenRuleError(7, "slot %d: %s is due, and does not fire" % (slot, " and ".join(due)))
        here = [r for r in self.robots.values() if r.here]
        if self.ended is None and here and all(r.phase == "inactive" for r in here):
            self.ended = "every robot is in a place without output arcs"

    def _look_at_until(self) -> None:
        if self.until is not None and self.robots and not self.paused:
            counts = [self.marking[p.name] for p in self.plan.net.places]
            if self.until.holds(counts):
                self.ended = "until"

    def _due(self) -> List[str]:
        """Transitions that should have fired: resources' own, and those that robots named."""
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
                    "slot %d: %s holds %d tokens, but %d robots are there" % (slot, place, count, counts.get(place, 0)),
                )

    # -- firings -----------------------------------------------------------------------------------

    def _has_concession(self, t: str) -> bool:
        if any(self.marking[p] < n for p, n in self.inputs[t].items()):
            return False
        if any(self.marking[p] >= n for p, n in self.limits[t].items()):
            return False
        return all(
            limit is None or change <= 0 or self.marking[p] + change <= limit
            for p, change in self._effect(t).items()
            for limit in (self.capacity[p],)
        )

    def _effect(self, t: str) -> Dict[str, int]:
        change = dict(self.outputs[t])
        for p, n in self.inputs[t].items():
            change[p] = change.get(p, 0) - n
        return change

    def _waiting(self) -> List[Token]:
        done = [r for r in self.robots.values() if r.phase == "done" and not r.paused]
        return sorted(done, key=lambda r: r.order)

    def _free(self, place: str, t: str) -> List[Token]:
        return [
            r
            for r in self._waiting()
            if r.place == place and (t in (r.asks, r.may_ask) or (r.asks is None and not self.kind[t].timed))
        ]

    def _may_fire(self, t: str) -> bool:
        return self._has_concession(t) and all(
            len(self._free(p, t)) >= n for p, n in self.inputs[t].items() if p not in self.resources
        )

    def _is_direct(self, firing: Record, direct: Optional[str]) -> bool:
        return firing.get("transition") == direct and not firing.get("robot")

    def _why_not(self, firing: Record, direct: Optional[str]) -> str:
        """Why a firing cannot have happened now; "" if it can. ``direct``: the environment's
        transition of the entry just before."""
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
        taken: Dict[str, List[Token]] = {}
        for name, source, _, visit in firing["moves"]:
            if source is None:
                continue
            robot = self.robots.get(name)
            if robot is None or not robot.here or robot.place != source:
                return "%s is not in %s" % (name, source)
            if robot.phase != "done":
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
        if robot is None or robot.phase != "done":
            return "%s, which asked, is not done" % name
        if (firing["incarnation"], firing["visit"]) != (robot.incarnation, robot.visit):
            return "%s is at visit %d" % (name, robot.visit)
        if t in (robot.asks, robot.may_ask):
            return ""
        if robot.asks is not None:
            return "%s asked for %s" % (name, robot.asks)
        return self._why_not_policy(firing, t, robot)

    def _why_not_policy(self, firing: Record, t: str, robot: Token) -> str:
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

    def _choices(self, robot: Token) -> List[Tuple[str, float]]:
        """What the policy lets the robot choose from: the best row that matches and speaks of its
        place, else (no row matches) the weights."""
        leaving = [t for t in self.leaving[robot.place] if not self.kind[t].timed]
        columns = self.plan.policy.places
        best: Optional[Tuple[int, int, List[Tuple[str, float]]]] = None
        matches = False
        for number, row in enumerate(self.plan.policy.rows):
            cells = zip(columns, row.counts)
            if any(cell is not None and self.marking[p] != cell for p, cell in cells):
                continue
            matches = True
            speaks = [(t, p) for t, p in row.choices if p > 0 and t in leaving]
            wildcards = sum(cell is None for cell in row.counts)
            if speaks and (best is None or (wildcards, number) < best[:2]):
                best = (wildcards, number, speaks)
        if best is not None:
            total = sum(p for _, p in best[2])
            return self._first_priority([(t, p / total) for t, p in best[2]])
        if matches or self.plan.strict:
            return []
        open_ones = [(t, self.kind[t].weight) for t in leaving if self._may_fire(t)]
        kept = self._first_priority(open_ones)
        return kept if any(w > 0 for _, w in kept) else []

    def _first_priority(self, choices: List[Tuple[str, float]]) -> List[Tuple[str, float]]:
        if len({self.kind[t].priority for t, _ in choices}) < 2:
            return choices
        floor = max([self.kind[t].priority for t, _ in choices if self._may_fire(t)], default=0)
        return [(t, w) for t, w in choices if self.kind[t].priority >= floor]

    def _fire(self, slot: int, index: int, firing: Record) -> None:
        where = "slot %d, firing %d (%s)" % (slot, index, firing["transition"])
        if (firing["slot"], firing["index"]) != (slot, index):
            raise BrokenRuleError(1, "%s says that its position is another" % where)
        for p, change in self._effect(firing["transition"]).items():
            self.marking[p] += change
        if {p: n for p, n in self.marking.items() if n} != firing["marking"]:
            raise BrokenRuleError(
                2,
                "%s leads to %s, not to %s as recorded" % (where, _short(self.marking), _short(firing["marking"])),
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
                self.robots[name] = Token(name, target, 0)
            robot = self.robots[name]
            robot.place, robot.visit, robot.may_ask = target, visit, None
            arrived.append(robot)
        for robot in arrived:
            self._enter(robot)

    # -- entries -----------------------------------------------------------------------------------

    def _apply(self, entry: log.Entry) -> Optional[str]:
        """Take an entry; the environment's transition that must fire at once, if it is about
        one."""
        if isinstance(entry, log.Start):
            self._start(entry)
        elif isinstance(entry, log.Done):
            robot = self.robots.get(entry.robot)
            key = (entry.incarnation, entry.visit)
            if robot and robot.phase == "doing" and key == (robot.incarnation, robot.visit):
                self._done(robot, entry.result)
        elif isinstance(entry, log.Failed):
            robot = self.robots.get(entry.robot)
            attempt = (entry.incarnation, entry.visit, entry.attempt)
            if robot and robot.phase == "doing" and attempt == robot.goal:
                self._failed(robot)
        elif isinstance(entry, log.Retry):
            robot = self.robots.get(entry.robot)
            if robot and robot.phase == "failed":
                robot.phase, robot.failures = "doing", 0
                robot.attempt += 1
        elif isinstance(entry, log.Fire):
            t = entry.transition
            if t in self.kind and not self.paused and self._has_concession(t):
                touched = set(self.inputs[t]) | (set() if self.agents else set(self.outputs[t]))
                if self.resources.issuperset(touched):
                    return t
        elif isinstance(entry, log.Join):
            self._join(entry)
        elif isinstance(entry, (log.Leave, log.Evict)):
            self._gone(entry)
        elif isinstance(entry, log.SetPlace):
            robot = self.robots.get(entry.robot)
            if robot and robot.here and entry.place in self.plan.action_places:
                self.marking[robot.place] -= 1
                self.marking[entry.place] += 1
                robot.place = entry.place
                robot.visit += 1
                self._enter(robot)
        elif isinstance(entry, (log.Pause, log.Resume)):
            paused = isinstance(entry, log.Pause)
            if not entry.robot:
                self.paused = paused
            elif entry.robot in self.robots:
                self.robots[entry.robot].paused = paused
        elif isinstance(entry, log.Stop):
            self.ended = entry.reason
        return None

    def _start(self, entry: log.Start) -> None:
        if self.robots:
            return
        self.seed, self.witnesses = entry.seed, entry.witnesses
        for name, place, incarnation in entry.roster:
            self.robots[name] = Token(name, place, incarnation)
            self.marking[place] += 1
        for robot in list(self.robots.values()):
            self._enter(robot)

    def _enter(self, robot: Token) -> None:
        robot.attempt, robot.failures = 1, 0
        robot.asks = robot.may_ask = None
        robot.phase = "doing"
        if self.plan.action(robot.name, robot.place) is None:
            self._done(robot, "")

    def _done(self, robot: Token, result: Optional[str]) -> None:
        leaving = self.leaving[robot.place]
        if not leaving:
            robot.phase = "inactive"
        elif result and result != "None":
            if result in leaving:
                self._ask(robot, result)
            else:
                self._failed(robot)
        elif any(not self.kind[t].timed for t in leaving):
            self._ask(robot, None)
        elif len(leaving) == 1:
            self._ask(robot, leaving[0])
        else:
            self._failed(robot)

    def _ask(self, robot: Token, what: Optional[str]) -> None:
        self.orders += 1
        robot.phase, robot.asks, robot.order, robot.failures = "done", what, self.orders, 0

    def _failed(self, robot: Token) -> None:
        rule = self.plan.failure_rule(robot.place)
        if rule.kind is FailureKind.RETRY and robot.failures < rule.times:
            robot.failures += 1
            robot.attempt += 1
        elif rule.kind is FailureKind.FIRE and rule.transition in self.leaving[robot.place]:
            self._ask(robot, rule.transition)
        else:
            if rule.kind is FailureKind.STOP:
                self.ended = "an action of %s failed" % robot.name
            else:
                robot.phase = "failed"

    def _join(self, entry: log.Join) -> None:
        robot = self.robots.get(entry.robot)
        if entry.robot in self.witnesses:
            return
        if robot is None:
            if entry.place in self.plan.action_places:
                robot = Token(entry.robot, entry.place, entry.incarnation)
                self.robots[entry.robot] = robot
                self.marking[entry.place] += 1
                self._enter(robot)
        elif entry.incarnation > robot.incarnation:
            robot.incarnation = entry.incarnation
            if not robot.here:
                robot.visit += 1
                self.marking[robot.place] += 1
                self._enter(robot)
            elif robot.phase == "doing":
                robot.attempt += 1

    def _gone(self, entry: log.Entry) -> None:
        assert isinstance(entry, (log.Leave, log.Evict))
        robot = self.robots.get(entry.robot)
        if robot is None or not robot.here:
            return
        if isinstance(entry, log.Leave):
            robot.phase = "left"
            self.marking[robot.place] -= 1
            robot.paused = False
            return
        if entry.incarnation != robot.incarnation:
            return
        robot.phase, robot.paused = "lost", False
        self.marking[robot.place] -= 1
        for place, n in self.plan.on_evict.get(robot.place, {}).items():
            self.marking[place] += n
        rule = self.plan.on_lost
        stuck = [r for r in self._all_waiting() if self._waits_for(r, robot.place)]
        sure = any(r.asks is not None for r in stuck)
        if stuck and rule.kind is LostKind.STOP:
            self.perhaps_ended = not sure
            if sure:
                self.ended = "%s is lost" % robot.name
        elif rule.kind is LostKind.FIRE:
            for other in stuck:
                if rule.transition in self.leaving[other.place]:
                    if other.asks is None:  # if its draw was for the robot that is lost
                        other.may_ask = rule.transition
                    else:
                        other.asks = rule.transition

    def _all_waiting(self) -> List[Token]:
        return [r for r in self.robots.values() if r.phase == "done"]

    def _waits_for(self, robot: Token, place: str) -> bool:
        wanted: Iterable[str] = [robot.asks] if robot.asks else self.leaving[robot.place]
        return any(
            n > len(self._free(place, t))
            for t in wanted
            for p, n in self.inputs[t].items()
            if p == place and p not in self.resources
        )

    # -- questions ---------------------------------------------------------------------------------

    def members(self) -> List[str]:
        """Who votes in the next slot."""
        return [r.name for r in self.robots.values() if r.here] + list(self.witnesses)

    def situations(self) -> Dict[str, Situation]:
        """Where every robot is."""
        return {r.name: Situation(r.place, r.incarnation, r.visit, r.attempt, r.phase) for r in self.robots.values()}


def _add(weights: Dict[str, int], place: str, weight: int) -> None:
    weights[place] = weights.get(place, 0) + weight


def _short(marking: Any) -> str:
    return "{%s}" % ", ".join("%s: %d" % (p, n) for p, n in sorted(marking.items()) if n)


def _uniform(seed: int, slot: int, index: int, who: str) -> float:
    """The first 53 bits of SHA-256 over seed, slot, index and robot, as a number in [0, 1)."""
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
