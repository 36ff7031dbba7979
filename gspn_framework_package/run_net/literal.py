"""A run net as an ordinary net, for other tools and for people: a *literal net*.

Each place of the plan is a place of the literal net and has the same tokens. Where robots are
distinguished, each column is a further place. What happens in zero time (``steps``) has priorities,
from the highest to the lowest:

1. what a firing has begun: draws end, the robots move, those that enter a place begin;
2. the run ends;
3. transitions fire that only take resources;
4. robots that ask the policy draw, one after the other;
5. what robots want, or have drawn, fires;
6. actions end that take no time.

Where each robot has the same chance, the weight is the number of tokens of a place.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.marking_function import Value, parse_value
from gspn_framework_package.model.net import Net, with_places_renamed
from gspn_framework_package.model.policy_cell import Cell, CountTest, ranges
from gspn_framework_package.run_net.columns import PlaceColumns, Shares, Taking
from gspn_framework_package.run_net.ending import ways_to_hold
from gspn_framework_package.run_net.run_net import RunNet
from gspn_framework_package.run_net.staged_net import (
    IN_TIME,
    MOST_TRANSITIONS,
    NOTHING_NEEDED,
    Meaning,
    Needed,
    StagedNet,
    TokenCounts,
    TurnStage,
    too_large,
)

_FORGET, _MOVE, _ENTER, _END, _RESOURCES, _RAISE, _DRAW, _ASK, _ARRIVE = range(9)
_LARGE = {
    IN_TIME: "phases of actions, and races",
    (_DRAW,): "rows of the policy",
    (_ASK,): "requests of robots",
    (_MOVE,): "choices of partners",
}


class LiteralNet(NamedTuple):
    """An ordinary net, and what its places and transitions stand for, by name.

    :ivar counts: place of the plan -> the place with its tokens. Places that only count are left
        out.
    """

    net: Net
    counts: Mapping[str, str]
    places: Mapping[str, Meaning]
    transitions: Mapping[str, Meaning]


def literal_net(run_net: RunNet) -> LiteralNet:
    """A run net as an ordinary net.

    :param run_net: a plan, compiled.
    :raises RefusedError: an ordinary net would not be exact, or too large.
    """
    return _Writer(run_net).literal()


@dataclass
class _Deciding:
    """A place in which robots ask the policy.

    :ivar drawn: transition -> the place of the robots that have drawn it.
    :ivar open: has a token while no row is remembered; "": none ever is.
    :ivar again: has a token when robots have to draw again although the marking stays; "": never.
    :ivar gates: what robots draw from -> the place that has a token while these are remembered.
    """

    asking: str
    drawn: Mapping[int, str]
    open: str = ""
    again: str = ""
    gates: Dict[Shares, str] = field(default_factory=dict)

    @property
    def everybody(self) -> List[str]:
        """The places of all robots that ask the policy."""
        return [self.asking, *self.drawn.values()]


class _Writer(StagedNet):
    def __init__(self, run_net: RunNet) -> None:
        super().__init__(_LARGE)
        self._run, self._net = run_net, run_net.net
        self._columns: Dict[int, str] = {}
        self._parts: List[List[str]] = []  # of each place
        self._entries: List[str] = []
        self._deciding: Dict[int, _Deciding] = {}
        self._of = [
            self.place(p.name, p.name, ("all robots in %s" if acts else "tokens of %s") % p.name)
            for p, acts in zip(self._net.places, run_net.acts)
        ]
        self._changed = ""
        if run_net.until or run_net.inactive or run_net.stopped >= 0:
            self.over = self.place("run over", "", "the run has ended")
        if any(columns.asking >= 0 for columns in run_net.columns.values()):
            self._changed = self.place("changed", "", "the marking has changed, so that draws end")
        for p, place in enumerate(self._net.places):
            if p in run_net.columns:
                self._split(p, run_net.columns[p])
            else:
                self._columns[run_net.whole[p]] = self._of[p]
                self._parts.append([self._of[p]])
                self._entries.append(self._of[p])
            self.tokens[self._entries[p]] = place.tokens

    def literal(self) -> LiteralNet:
        """The literal net."""
        self._pass_time()
        self._spend_resources()
        for p, columns in self._run.columns.items():
            for t, column in columns.named.items():
                if column in self._columns:
                    self._ask(p, t, self._columns[column], "wants it")
        for p, deciding in self._deciding.items():
            self._decide(p, deciding)
            for t, place in deciding.drawn.items():
                self._ask(p, t, place, "has drawn it")
            self._forget(deciding)
        if self._changed:
            self._move((_FORGET, 1), 1.0, "draws have ended", self._changed)
        self._end()
        counts = {p.name: name for p, name in zip(self._net.places, self._of)}
        return LiteralNet(self.net(self._run.plan.name), counts, self.places, self.transitions)

    # -- places ------------------------------------------------------------------------------------

    def _robots(self, place: str, words: str) -> str:
        return self.place(words, place, "robots: %s" % words)

    def _split(self, p: int, columns: PlaceColumns) -> None:
        """Make the places of the columns of place ``p``."""
        place = self._net.places[p].name
        entries = [column for column, _ in columns.entry]
        passed = {c for t, c in columns.named.items() if self._net.fires_alone(t, p)} - {*entries}
        for column, words in columns.words(self._net, p):
            if column not in passed and column != columns.idle:
                self._columns[column] = self._robots(place, words)
        parts = [
            name for column, name in self._columns.items() if column in range(*self._run.parts[p])
        ]
        if columns.asking >= 0:
            drawn = {t: self._columns[column] for t, column in columns.holding.items()}
            for t in self._net.consumers[p]:
                transition = self._net.transitions[t]
                if not transition.timed and t not in drawn:
                    words = "%s (done, has drawn %s)" % (place, transition.name)
                    drawn[t] = self._robots(place, words)
                    parts.append(drawn[t])
            self._deciding[p] = _Deciding(self._columns[columns.asking], drawn)
        self._parts.append(parts)
        enters = self._columns[entries[0]]
        if len(entries) > 1:
            enters = self._robots(place, "%s (enters)" % place)
            for column, chance in columns.entry:
                self._move((_ENTER,), chance, "a robot begins", enters, self._columns[column])
        self._entries.append(enters)
        self.sums[self._of[p]] = dict.fromkeys([*parts, enters], 1)

    # -- transitions -------------------------------------------------------------------------------

    def _move(
        self,
        stage: TurnStage,
        value: Value,
        text: str,
        source: str,
        *targets: str,
        ready: Needed = NOTHING_NEEDED,
    ) -> None:
        """A token moves, and nothing fires in the plan; in time, each at the rate ``value``."""
        wanted = " to ".join([source, *targets]) if targets else "end of " + source
        meaning = Meaning("", "%s: %s" % (text, wanted))
        self.add(wanted, meaning, stage, value, {source: 1}, dict.fromkeys(targets, 1), ready)

    def _fire(
        self,
        t: int,
        text: str,
        stage: TurnStage,
        value: Value,
        takes: TokenCounts,
        ready: Optional[Needed],
        *,
        servers: Optional[int] = None,
        ways: Sequence[Tuple[TokenCounts, Value]] = (({}, 1.0),),
        later: bool = False,
    ) -> None:
        """Transition ``t`` of the plan fires and takes these robots; then, in one of ``ways`` by
        weight, others; ``later``: once draws have ended. Without ``ready`` it never fires."""
        if ready is None:
            return
        name = self._net.transitions[t].name
        meaning = Meaning(name, "%s fires %s" % (name, text), fires=True)
        wanted = " ".join([name, *takes])
        spent = {self._of[p]: w for p, w in self._net.inputs[t] if not self._run.acts[p]}
        puts = {self._entries[p]: w for p, w in self._net.outputs[t]}
        changes = {self._changed: 1} if self._changed and self._run.resets[t] else {}
        if len(ways) == 1 and not later:
            spent.update(Counter(takes) + Counter(ways[0][0]))
            self.add(wanted, meaning, stage, value, spent, {**puts, **changes}, ready, servers)
            return
        under = self.place(wanted + " under way", "", "%s has begun to fire" % name)
        self.add(wanted, meaning, stage, value, takes, {under: 1, **changes}, ready, servers)
        for way, weight in ways:
            meaning = Meaning(name, "%s takes others: %s" % (name, ", ".join(way)))
            takes = {under: 1, **spent, **way}
            self.add(wanted + " with others", meaning, (_MOVE,), weight, takes, puts)

    def _enabled(self, t: int) -> Optional[Needed]:
        """The condition that enables ``t``; None if it is never enabled."""
        needs = {self._of[p]: w for p, w in self._net.inputs[t]}
        below: Dict[str, int] = {}
        for p, most in self._net.most_tokens(t):
            if most < 0:
                return None
            below[self._of[p]] = min(most + 1, below.get(self._of[p], most + 1))
        return Needed(needs, below)

    def _can_fire(self, p: int, t: int) -> Optional[Needed]:
        """What ``t`` needs so that it can fire when a robot in place ``p`` asks for it; None if it
        never can."""
        ready = self._enabled(t)
        if ready is None or t in self._run.never:
            return None
        for taking in self._run.takes[t]:
            del ready.needs[self._of[taking.place]]  # of these robots some are not free
            free = self._free(taking)
            if taking.place == p and taking.weight == 1:
                continue
            if not free:
                return None
            words = self._net.places[taking.place].name, self._net.transitions[t].name
            free_robots = self.sum("%s free for %s" % words, dict.fromkeys(free, 1))
            ready.needs[free_robots] = taking.weight
        return ready

    def _free(self, taking: Taking, draws_ended: bool = False) -> List[str]:
        """Where the robots are that ``taking`` may take."""
        found = [self._columns[taking.named]] if taking.named in self._columns else []
        if taking.at_policy:
            deciding = self._deciding[taking.place]
            found += [deciding.asking] if draws_ended else deciding.everybody
        return found

    def _value(self, t: int) -> Value:
        names = {p.name: name for p, name in zip(self._net.places, self._of)}
        transition = with_places_renamed(self._net.transitions[t], names)
        return transition.rate if transition.timed else transition.weight

    # -- in time -----------------------------------------------------------------------------------

    def _pass_time(self) -> None:
        """Make what takes time: phases and ends of actions, events, and the environment's
        transitions."""
        run = self._run
        for column, rates in run.racing:
            for t, rate in rates:
                self._pass(t, IN_TIME, rate, self._columns[column])
        for columns in run.columns.values():
            for attempt in columns.attempts:
                for column, rate, following in zip(*attempt[:3]):
                    if following >= 0:
                        ends = self._columns[column], self._columns[following]
                        self._move(IN_TIME, rate, "a phase ends", *ends)
                    else:
                        self._end_attempt(columns, column, rate)
            for column in columns.arriving:
                self._end_attempt(columns, column, None)
        for t, rate, _ in run.interrupts:
            for place in self._parts[run.interrupted[t]]:
                each, ready = parse_value("%r * #%s" % (rate, place)), self._enabled(t)
                self._fire(t, "by its event", IN_TIME, each, {place: 1}, ready, servers=1)
        for t, whole, _ in run.races:
            value, servers = self._value(t), self._net.transitions[t].servers
            takes, ready = {self._columns[column]: w for column, w in whole}, self._enabled(t)
            # robots of split places wait there for the policy, and ask again when draws have ended
            others = {
                self._deciding[p].asking: w
                for p, w in self._net.inputs[t]
                if self._run.acts[p] and p in self._deciding
            }
            text = "by its rate" if takes or others else "in the environment"
            self._fire(
                t,
                text,
                IN_TIME,
                value,
                takes,
                ready,
                servers=servers,
                ways=[(others, 1.0)],
                later=bool(others),
            )

    def _end_attempt(self, columns: PlaceColumns, column: int, rate: Optional[float]) -> None:
        """An attempt ends; without a ``rate`` it has taken no time."""
        source = self._columns[column]
        for end in columns.ends[column]:
            stage: TurnStage = IN_TIME
            value: Value = end.probability * (rate or 1.0)
            if rate is None:
                stage, value = (_ARRIVE,), parse_value("%r * #%s" % (value, source))
            if end.column in self._columns:
                targets = [self._columns[end.column], *([self.over] if end.stops else [])]
                self._move(stage, value, "an action ends", source, *targets)
            elif end.request is not None:
                self._pass(end.request, stage, value, source)

    def _pass(self, t: int, stage: TurnStage, value: Value, source: str) -> None:
        """The action of a robot ends, and ``t`` needs nothing else."""
        text = "for a robot whose action ends"
        self._fire(t, text, stage, value, {source: 1}, self._enabled(t))

    # -- in zero time ------------------------------------------------------------------------------

    def _spend_resources(self) -> None:
        """Transitions fire that only take resources. Those without a weight come after the others
        of their priority, in the order of the file."""
        for t in self._run.spontaneous:
            transition, value = self._net.transitions[t], self._value(t)
            stage: TurnStage = (_RESOURCES, -transition.priority)
            if transition.is_controllable:
                stage, value = (*stage, t), 1.0
            self._fire(t, "by itself", stage, value, {}, self._enabled(t))

    def _ask(self, p: int, t: int, place: str, does: str) -> None:
        """Transition ``t`` fires for a robot in ``place``, a part of place ``p``."""
        draws_end = self._run.resets[t]  # then all robots at the policy ask again
        found: List[Tuple[Dict[str, int], str]] = [({}, "1")]
        later = False
        for taking in self._run.takes[t]:
            others = taking.weight - (taking.place == p)
            later |= draws_end and others > 0 and bool(taking.at_policy)
            free = self._free(taking, draws_end)
            count = len(found) * math.comb(len(free) + others - 1, others) if free else 0
            if count > MOST_TRANSITIONS:
                raise too_large(_LARGE[(_MOVE,)], count)
            found = [
                ({**way, **more}, "".join([weight, *itertools.starmap(_chosen, more.items())]))
                for way, weight in found
                for more in map(Counter, itertools.combinations_with_replacement(free, others))
            ]
        ways = [(way, parse_value(weight)) for way, weight in found]
        stage, each = (_ASK, -self._run.urgency[t]), parse_value("#" + place)
        text, ready = "for a robot that %s" % does, self._can_fire(p, t)
        self._fire(t, text, stage, each, {place: 1}, ready, ways=ways, later=later)

    def _decide(self, p: int, deciding: _Deciding) -> None:
        """Robots in place ``p`` draw from the policy."""
        plan, name = self._run.plan, self._net.places[p].name
        read = [self._of[self._net.place_index[place]] for place in plan.policy.places]
        rows: List[Tuple[Dict[str, Cell], Optional[Shares]]] = []
        table = plan.policy.bind(plan.net)
        for counts, draw in table.in_order(plan.net.place_number(name), plan.strict):
            rows.append(({q: n for q, n in zip(read, counts) if n is not None}, draw))
        if not plan.strict:
            rows.append(({}, None))
        certain = next((i for i, (cells, _) in enumerate(rows) if not cells), len(rows))
        rows = rows[: certain + 1]
        while rows and rows[-1][1] == ():  # robots wait in any case
            rows.pop()
        if any(choices is not None and len(self._levels(choices)) != 1 for _, choices in rows):
            deciding.open = self.place(name + " row", name, "no row is kept in mind")
            self.tokens[deciding.open] = 1
        rank = 0
        for number, (cells, choices) in enumerate(rows):
            if number and not _exclusive(cells, rows[number - 1][0]):
                rank += 1
            for ready in _where(cells):
                ready.needs.update({deciding.open: 1} if deciding.open else {})
                if choices is None:
                    self._draw_by_weight(p, deciding, rank, ready)
                elif len(self._levels(choices)) == 1:
                    self._draw(deciding, (_DRAW, rank), choices, ready)
                else:
                    ready.needs[deciding.asking] = 1
                    gate, stage = self._gate(p, deciding, choices), (_DRAW, rank)
                    self._move(stage, 1.0, "a row applies", deciding.open, gate, ready=ready)

    def _levels(self, choices: Shares) -> List[int]:
        """The priorities of these transitions."""
        return sorted({self._net.transitions[t].priority for t, _ in choices})

    def _draw(self, deciding: _Deciding, stage: TurnStage, choices: Shares, ready: Needed) -> None:
        """Robots draw from ``choices``."""
        for t, v in choices:
            self._move(stage, v, "a robot draws", deciding.asking, deciding.drawn[t], ready=ready)

    def _gate(self, p: int, deciding: _Deciding, choices: Shares) -> str:
        """The place that has a token while robots in place ``p`` draw from ``choices``, until
        something can fire that takes precedence over some of them."""
        if choices in deciding.gates:
            return deciding.gates[choices]
        name, transitions = self._net.places[p].name, self._net.transitions
        words = ", ".join("%s %g" % (transitions[t].name, v) for t, v in choices) or "nothing"
        gate = self.place(name + " draws", name, "robots in %s draw from: %s" % (name, words))
        deciding.gates[choices] = gate
        self._draw(deciding, (_DRAW,), choices, Needed({gate: 1}, {}))
        for t, _ in choices:
            level = transitions[t].priority
            ready = self._can_fire(p, t)
            if ready is None or level == self._levels(choices)[0]:
                continue
            self._check_partners(p)
            if not deciding.again:
                text = "robots in %s draw again" % name
                deciding.again = self.place(name + " again", name, text)
            higher = tuple((u, v) for u, v in choices if transitions[u].priority >= level)
            text, ends = "%s can fire" % transitions[t].name, self._gate(p, deciding, higher)
            self._move((_RAISE,), 1.0, text, gate, ends, deciding.again, ready=ready)
        return gate

    def _draw_by_weight(self, p: int, deciding: _Deciding, rank: int, ready: Needed) -> None:
        """Robots in place ``p`` draw from the transitions that can fire."""
        self._check_partners(p)
        transitions = self._net.transitions
        for t, drawn in deciding.drawn.items():
            able = self._can_fire(p, t)
            if able is None:
                continue
            level = transitions[t].priority
            if not transitions[t].is_controllable:
                able.needs.update(ready.needs)
                stage, text = (_DRAW, rank, -level), "a robot draws"
                self._move(stage, self._value(t), text, deciding.asking, drawn, ready=able)
            elif any(transitions[u].priority < level for u in deciding.drawn):
                raise RefusedError(
                    "it has no weight, and precedes others that robots may draw where no row of "
                    "the policy applies, which a run net cannot express",
                    element="transition '%s'" % transitions[t].name,
                    hint="give it a weight, or add a row for every marking",
                )

    def _check_partners(self, p: int) -> None:
        """:raises RefusedError: what robots in place ``p`` draw from may depend on partners that
        can become busy while the marking stays as it is."""
        run, drawn = self._run, self._deciding[p].drawn
        partners = any(
            taking.place != p or taking.weight > 1 for t in drawn for taking in run.takes[t]
        )
        silent = [
            t
            for t, taken in enumerate(run.takes)
            if not run.resets[t]
            and (t in drawn or t in run.interrupted or any(taking.at_policy for taking in taken))
        ]
        if partners and silent:
            raise RefusedError(
                "it moves robots without changing the marking, and what robots in '%s' draw from "
                "depends on who is done, which a run net cannot express" % self._net.places[p].name,
                element="transition '%s'" % self._net.transitions[silent[0]].name,
            )

    def _forget(self, deciding: _Deciding) -> None:
        """Draws end in a place."""
        for flag in filter(None, (self._changed, deciding.again)):
            ready, text = Needed({flag: 1}, {}), "a draw ends"
            for place in deciding.drawn.values():
                self._move((_FORGET,), 1.0, text, place, deciding.asking, ready=ready)
            for gate in deciding.gates.values() if flag == self._changed else ():
                self._move((_FORGET,), 1.0, text, gate, deciding.open, ready=ready)
        if deciding.again:
            self._move((_FORGET, 1), 1.0, "draws have ended", deciding.again)

    def _end(self) -> None:
        """The run ends."""
        run = self._run
        ends: List[Needed] = []
        for bounds in ways_to_hold(run.until) if run.until else ():
            ready = Needed({}, {})
            for parts, least, most in bounds:
                place = self.sum("sum for until", {self._of[p]: n for p, n in parts})
                if least > 0:
                    ready.needs[place] = max(least, ready.needs.get(place, 0))
                if most is not None:
                    ready.below[place] = min(most + 1, ready.below.get(place, most + 1))
            ends.append(ready)
        if run.inactive:
            resting = [self._columns[column] for column in run.inactive]
            robots = (place for p in run.timing for place in self.parts_of(self._of[p]))
            active = {place: 1 for place in robots if place not in resting}
            left = self.sum("robots that are not at rest", active)
            ends += [Needed({place: 1}, {left: 1}) for place in resting]
        for ready in ends:
            self.add(
                "run ends", Meaning("", "the run ends"), (_END,), 1.0, {}, {self.over: 1}, ready
            )


def _exclusive(cells: Mapping[str, Cell], others: Mapping[str, Cell]) -> bool:
    """Whether two different rows surely match no common marking: they count the same places."""
    tested = any(isinstance(cell, CountTest) for cell in (*cells.values(), *others.values()))
    return not tested and cells.keys() == others.keys()


def _where(cells: Mapping[str, Cell]) -> Iterator[Needed]:
    """The markings that a row matches, as the tokens that it needs; ``!= 2`` is one of two ways,
    which exclude each other."""
    for counts in itertools.product(*map(ranges, cells.values())):
        bounds = dict(zip(cells, counts))
        yield Needed(
            {q: least for q, (least, _) in bounds.items() if least},
            {q: int(most) + 1 for q, (_, most) in bounds.items() if most < math.inf},
        )


def _chosen(place: str, count: int) -> str:
    """A factor: in how many ways ``count`` tokens of a place can be chosen."""
    return "".join(" * (#%s - %d) / %d" % (place, k, k + 1) for k in range(count))
