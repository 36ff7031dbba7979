"""The reading of a plan as it runs (``--timing run``): each robot is *doing* its action for a
duration, then *done*, and moves as soon as it can (``docs/semantics.md``).

**Where the net is the same chain.** A robot in a place whose exponential transitions need nothing
but its own token, with an exponential duration, moves on the moment that it is done. Its action and
the race of those transitions are then the same, because an exponential duration is memoryless. Such
a place is kept as it is. So is a decision place without a duration: robots there are done at once.
If it has an action, which takes no time, they are done one after the other, each when all others
have moved that can; without one they are done on arrival.

**Events.** An event that interrupts comes at the rate of its transition to each robot in the place,
whatever it is doing there, and has an effect if the marking then enables the transition. A place
that only events leave is kept as it is.

**The split.** Elsewhere a place has several *columns* (sub-places), and a state counts the robots
in each:

* one for each phase of its duration (one phase if it is exponential): the robot is doing;
* one for each transition that its action can name: done, with that request;
* *newest*, *asking*, *holding t* and *idle*: done, and the policy decides. It has just finished, as
  the last of all; it has yet to draw; it has drawn t, which can fire as soon as a partner is done;
  it has drawn what this marking does not enable, or there is nothing to draw.

Enabled is what the marking enables, and the marking counts all robots of a place, doing or done:
inhibitor arcs, capacities, rows of the policy and ``until`` see the same marking as in the run.

**What happens in zero time.** After each event (an action is done, the environment fires, a
transition has fired) the following is repeated, as in ``execution/turn.py``:

1. ``until`` ends the run.
2. Transitions that only take resources fire, by priority and weight.
3. Robots that ask the policy draw. A draw holds until the marking changes, or until the candidates
   do: a partner that gets done can make one of higher priority possible. A partner that gets done
   does not change the marking.
4. Among the requests that can fire, the most urgent goes first: immediate transitions by priority,
   then exponential ones. Between equals the first robot to finish goes first. A state does not know
   that order, so each is equally likely; only the robot that has just finished is known to be last.
5. A transition takes robots that are done and free for it: those that named it, and, if it is
   immediate, those that ask the policy, whatever they have drawn.

Rates and probabilities leave a state accordingly: phases end at their rates, the outcome of an
action is drawn when it is done, and the environment races at its own rates.
"""

# In one piece: a net with clocks, compiled from the plan, is to replace it

from __future__ import annotations

import itertools
import math
from typing import Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.analysis.plan.phases import (
    MOST_PHASES,
    Phases,
    number_of_phases,
    phases_of,
    single_phase,
)
from gspn_framework_package.analysis.plan.rules import PlanRules, Requests, first_to_fire
from gspn_framework_package.analysis.plan.structure import fires_alone
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.net import Marking
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import POLICY, PlaceTiming, PlanTiming

State = Tuple[int, ...]
"""The robots in each column, and the tokens of the resource places."""

_TINY = 1e-12
"""A probability below this is a rounding error."""


class RunArc(NamedTuple):
    """A step to ``target``: ``label`` is the number of the transition that fires, or ``waits`` or
    ``ends`` of the rules; ``value`` is a rate (1/s), or a probability in zero time."""

    target: State
    label: int
    value: float


class _Columns(NamedTuple):
    """The columns of an action place.

    :ivar entry: where a robot that enters begins: pairs (column, probability).
    :ivar phases: the columns in which it is doing.
    :ivar rates: their rates (1/s).
    :ivar following: for each phase the column after it; -1: the action is done.
    :ivar outcomes: requests of a robot that is done, with their probabilities.
    :ivar arriving: column of the robots whose action takes no time, and has yet to end; -1 if it
      takes time, or there is none.
    :ivar named: transition -> column of the robots that named it.
    :ivar newest, asking, idle: columns of robots that ask the policy; -1 where none does.
    :ivar holding: transition -> column of the robots that have drawn it.
    :ivar stuck: column of the robots whose action can never say what to do next; -1 if it can.
    """

    entry: Tuple[Tuple[int, float], ...]
    phases: Tuple[int, ...] = ()
    rates: Tuple[float, ...] = ()
    following: Tuple[int, ...] = ()
    outcomes: Tuple[Tuple[int, float], ...] = ()
    named: Mapping[int, int] = {}
    newest: int = -1
    asking: int = -1
    idle: int = -1
    holding: Mapping[int, int] = {}
    stuck: int = -1
    arriving: int = -1

    @property
    def at_policy(self) -> Tuple[int, ...]:
        """The columns of the robots that ask the policy."""
        if self.asking < 0:
            return ()
        newest = (self.newest,) if self.newest >= 0 else ()
        return (*newest, self.asking, self.idle, *self.holding.values())


class _Racing(NamedTuple):
    """A place that is not split: robots in ``column`` fire each transition at a rate (1/s)."""

    column: int
    rates: Tuple[Tuple[int, float], ...]


class _Interrupt(NamedTuple):
    """An event: each robot in one of ``columns`` fires ``transition`` at this ``rate`` (1/s)."""

    transition: int
    rate: float
    columns: Tuple[int, ...]


class RunRules:
    """The states of a plan as it runs, and the steps between them.

    :param plan: a validated plan.
    :param timing: its durations and outcomes.
    :param phases: whether durations get their phases. If not, each is exponential with its mean:
        far fewer states, from which :meth:`states_with_phases` computes how many there would be.
    :ivar net: the plan's net without the counters that nothing reads (``counters``).
    :ivar timing: number of each action place -> its timing, the same for every robot.
    :ivar begin: the states that a run begins in: pairs (state, probability).
    :ivar splits: place -> why doing and done are distinguished there.
    :ivar assumptions: what these rules had to assume: sentences for people.
    :ivar first_columns: the first column of each place.
    :ivar waits, ends: labels of steps in which nothing fires: robots have drawn and wait; a phase
      of an action ends, or the action is done.
    """

    def __init__(self, plan: Plan, timing: PlanTiming, *, phases: bool = True) -> None:
        self._rules = PlanRules(plan)
        self.plan = plan
        self.net = net = self._rules.net
        self.counters = self._rules.counters
        self.waits, self.ends = len(net.transitions), len(net.transitions) + 1
        self._full = [plan.net.transition_number(t.name) for t in net.transitions]
        self._short = {t: i for i, t in enumerate(self._full)}
        self.assumptions: List[str] = []
        self.timing = {
            p: self._of_team(timing, place.name)
            for p, place in enumerate(net.places)
            if self._rules.acts[p]
        }
        self._interrupting = self._rules.interrupts  # transition -> place
        self._changes = [bool(plan.net.effect(t)) for t in self._full]
        self._robots_of = [
            tuple((p, w) for p, w in arcs if self._rules.acts[p]) for arcs in net.inputs
        ]
        self._immediate = [
            t for t, transition in enumerate(net.transitions) if not transition.timed
        ]
        self._spontaneous = [t for t in self._immediate if not self._robots_of[t]]
        self._environment = [
            t
            for t, transition in enumerate(net.transitions)
            if transition.timed and not self._robots_of[t]
        ]
        self._doing = {p for p in self.timing if self._takes_time(p)}
        self._ending = {p for p in self.timing if self._ends_at_once(p)}
        # Robots that move in zero time without changing the marking leave the draws of the others
        # as they are, so every draw has to be known.
        self._keeps_draws = any(
            self._robots_of[t]
            and not self._changes[t]
            and self._is_asked_for(t)
            and not any(self._races(p) for p, _ in self._robots_of[t])
            for t in range(len(net.transitions))
        )
        self._lay_out(phases)
        self._prepare()

        self.splits = {
            name: why
            for name, why in timing.splits.items()
            if net.place_number(name) in self._columns
        }

    # -- layout ------------------------------------------------------------------------------------

    def _of_team(self, timing: PlanTiming, place: str) -> PlaceTiming:
        """The timing of a place for every robot, since states do not distinguish robots."""
        p = self.plan.net.place_number(place)
        team = timing.of("", p)
        own = [timing.of(robot.name, p) for robot in self.plan.robots]
        if any(one != team for one in own):
            team = max(own, key=own.count)
            if any(one != team for one in own):
                self.assumptions.append(
                    "every robot in %s does what most of them do there, since states do not "
                    "distinguish robots (the simulation does)" % place
                )
        leaving = self.plan.of_action(p)
        if len(leaving) == 1 and self.plan.net.transitions[leaving[0]].timed:
            # who names nothing asks for the only transition that there is
            asked: Dict[int, float] = {}
            for t, v in team.outcomes:
                t = leaving[0] if t == POLICY else t
                asked[t] = asked.get(t, 0) + v
            team = team._replace(outcomes=tuple(asked.items()))
        return team

    def _of_action(self, p: int) -> List[int]:
        """The transitions that leave place ``p`` without an event."""
        return [t for t in self.net.consumers[p] if t not in self._interrupting]

    def only_events(self, p: int) -> bool:
        """Whether nothing but events takes a robot out of place ``p``."""
        return not self._of_action(p) and all(t == POLICY for t, _ in self.timing[p].outcomes)

    def _outcomes(self, p: int) -> Tuple[Tuple[int, float], ...]:
        """The requests of a robot that is done in place ``p``, in the numbers of the explored
        net."""
        return tuple(
            (t if t == POLICY else self._short[t], v) for t, v in self.timing[p].outcomes if v > 0
        )

    def _races(self, p: int) -> bool:
        """Whether place ``p`` is not split although its action takes time: what leaves it needs
        only the own token, and the duration is exponential."""
        timing = self.timing[p]
        return (
            timing.duration.mean > 0
            and _is_exponential(timing.duration)
            and bool(timing.outcomes)
            and all(t != POLICY for t, v in timing.outcomes if v > 0)
            and all(
                self.net.transitions[t].timed and fires_alone(self.net, t, p)
                for t in {*self._of_action(p), *(t for t, v in self._outcomes(p) if v > 0)}
            )
        )

    def _is_asked_for(self, t: int) -> bool:
        """Whether a robot ever asks for transition ``t``; if not, only its event fires it."""
        p = self._interrupting.get(t)
        return p is None or any(asked == t for asked, _ in self._outcomes(p))

    def _takes_time(self, p: int) -> bool:
        """Whether robots in place ``p`` are distinguished by doing and done."""
        return (
            bool(self.net.consumers[p])
            and not self.only_events(p)
            and self.timing[p].duration.mean > 0
            and not self._races(p)
        )

    def _ends_at_once(self, p: int) -> bool:
        """Whether robots in place ``p`` have an action that takes no time. They are done one after
        the other, when the others have moved; without an action they are done on arrival."""
        name = self.net.places[p].name
        return (
            bool(self.timing[p].outcomes)
            and not self.only_events(p)
            and self.timing[p].duration.mean == 0
            and self.plan.actions.get(name, True) is not None
        )

    def _waits_for_partners(self, p: int, t: int) -> bool:
        """Whether transition ``t``, drawn in place ``p``, may have to wait for a partner that is
        still doing."""
        late = self._doing | self._ending
        return any(q in late and (q != p or w > 1) for q, w in self._robots_of[t])

    def _lay_out(self, with_phases: bool) -> None:
        net = self.net
        self._column: Dict[int, int] = {}  # of the places that have only one
        self._columns: Dict[int, _Columns] = {}
        self._racing: List[_Racing] = []
        self._parts: List[Tuple[int, int]] = []  # the columns of each place: from, to
        width = 0
        for p in range(len(net.places)):
            first = width
            if not self._rules.acts[p] or not net.consumers[p] or self.only_events(p):
                self._column[p] = width
                width += 1
            elif self._races(p):
                self._column[p] = width
                rate = 1.0 / self.timing[p].duration.mean
                self._racing.append(
                    _Racing(width, tuple((t, rate * v) for t, v in self._outcomes(p)))
                )
                width += 1
            else:
                self._columns[p], width = self._split(p, width, with_phases)
            self._parts.append((first, width))
        self.width = width
        self.first_columns = [a for a, _ in self._parts]

    def _split(self, p: int, first: int, with_phases: bool) -> Tuple[_Columns, int]:
        """The columns of place ``p``, from column ``first`` on, and the column after them."""
        outcomes = self._outcomes(p)
        duration = self.timing[p].duration
        width = first
        phases: Optional[Phases] = None
        if duration.mean > 0:
            phases = phases_of(duration) if with_phases else single_phase(duration)
            assert phases is not None  # the caller has asked
            width += len(phases.rates)
        named: Dict[int, int] = {}
        for t, _ in outcomes:
            if t != POLICY:
                named[t] = width
                width += 1
        newest = asking = idle = stuck = arriving = -1
        holding: Dict[int, int] = {}
        if not outcomes:
            stuck, width = width, width + 1
        if p in self._ending:
            arriving, width = width, width + 1
        if any(t == POLICY for t, _ in outcomes):
            if phases is not None or p in self._ending:
                newest, width = width, width + 1
            asking, idle, width = width, width + 1, width + 2
            for t in self.net.consumers[p]:
                if not self.net.transitions[t].timed and (
                    self._keeps_draws or self._waits_for_partners(p, t)
                ):
                    holding[t] = width
                    width += 1
        entry: Tuple[Tuple[int, float], ...]
        if phases is not None:
            entry = tuple((first + phase, v) for phase, v in phases.start)
        elif arriving >= 0:
            entry = ((arriving, 1.0),)
        elif outcomes:
            entry = tuple((asking if t == POLICY else named[t], v) for t, v in outcomes)
        else:
            entry = ((stuck, 1.0),)
        columns = _Columns(
            entry,
            phases=tuple(range(first, first + len(phases.rates))) if phases else (),
            rates=phases.rates if phases else (),
            following=tuple(f if f < 0 else first + f for f in phases.following) if phases else (),
            outcomes=outcomes,
            named=named,
            newest=newest,
            asking=asking,
            idle=idle,
            holding=holding,
            stuck=stuck,
            arriving=arriving,
        )
        return columns, width

    # In one piece: a net with clocks, compiled from the plan, is to replace it
    def _prepare(self) -> None:
        """Tables for the steps."""
        net = self.net
        self._single = all(b - a == 1 for a, b in self._parts)
        self._deciding = [(p, c) for p, c in self._columns.items() if c.asking >= 0]
        # columns of robots that may have something to do in zero time, each with its place
        self._waiting = [
            (column, p)
            for p, c in self._columns.items()
            for column in (*c.named.values(), *c.at_policy)
        ]
        # where robots at the policy go when the marking changes, and when they have drawn nothing
        self._draws_end = [
            (column, c.asking)
            for _, c in self._deciding
            for column in c.at_policy
            if column != c.asking
        ]
        self._rests = [
            (column, c.idle)
            for _, c in self._deciding
            for column in (c.newest, c.asking)
            if column >= 0
        ]
        self._arriving = [(self._columns[p].arriving, p) for p in sorted(self._ending)]
        self._interrupts = [
            _Interrupt(t, net.transitions[t].rate, tuple(range(*self._parts[p])))
            for t, p in self._interrupting.items()
        ]
        self._working = [(p, c) for p, c in self._columns.items() if c.phases]
        # for each transition: (place, weight, column of those that named it, columns at the policy)
        self._takes = [
            tuple(
                (
                    p,
                    w,
                    self._columns[p].named.get(t, -1),
                    () if net.transitions[t].timed else self._columns[p].at_policy,
                )
                for p, w in self._robots_of[t]
                if p in self._columns
            )
            for t in range(len(net.transitions))
        ]
        # racing robots are always doing, so a transition that needs one and a partner cannot be
        self._never = {
            t
            for t in range(len(net.transitions))
            if any(p in self._column for p, _ in self._robots_of[t])
        }
        self._moves: List[List[Tuple[int, int]]] = []  # columns whose counts change for certain
        self._spreads: List[List[Tuple[Tuple[Tuple[int, float], ...], int]]] = []  # and by chance
        for t in range(len(net.transitions)):
            moves: List[Tuple[int, int]] = []
            spreads = []
            for p, w in net.inputs[t]:
                if not self._rules.acts[p]:
                    moves.append((self._column[p], -w))
            for p, w in net.outputs[t]:
                entry = self._entry(p)
                if len(entry) == 1:
                    moves.append((entry[0][0], w))
                else:
                    spreads.append((entry, w))
            self._moves.append(moves)
            self._spreads.append(spreads)
        # the places where a robot that gets done in a place can change what others may draw
        self._watching: Dict[int, List[Tuple[int, _Columns]]] = {
            p: [
                (q, c)
                for q, c in self._deciding
                if any(
                    not net.transitions[t].timed
                    and any(r == p and (q != p or w > 1) for r, w in self._robots_of[t])
                    for t in net.consumers[q]
                )
            ]
            for p in self._doing | self._ending
        }
        begins: List[Tuple[List[int], float]] = [([0] * self.width, 1.0)]
        for p, place in enumerate(net.places):
            begins = _spread(begins, self._entry(p), place.tokens)
        self.begin = [(tuple(counts), v) for counts, v in begins]

    def _entry(self, p: int) -> Tuple[Tuple[int, float], ...]:
        if p in self._columns:
            return self._columns[p].entry
        return ((self._column[p], 1.0),)

    # -- states ------------------------------------------------------------------------------------

    def marking(self, state: State) -> Marking:
        """The marking of a state: all robots of each place."""
        if self._single:
            return state
        return tuple([sum(state[a:b]) if b - a > 1 else state[a] for a, b in self._parts])

    def settle(self, state: State) -> Tuple[State, List[RunArc]]:
        """The state in its one form, and its steps in zero time, if there are any."""
        marking = self.marking(state)
        if self._rules.is_over(marking):
            return self._at_rest(state), []
        while True:
            arcs = self._at_once(state, marking)
            if arcs:
                return state, arcs
            state = self._at_rest(state)
            done = self._arrived(state, marking)
            if len(done) != 1:
                return state, done
            state = done[0].target

    def _arrived(self, state: State, marking: Marking) -> List[RunArc]:
        """The steps when one of the robots is done whose action takes no time."""
        arriving = [(p, state[column]) for column, p in self._arriving if state[column]]
        total = sum(robots for _, robots in arriving)
        arcs = []
        for p, robots in arriving:
            columns = self._columns[p]
            for request, v in columns.outcomes:
                counts = list(state)
                counts[columns.arriving] -= 1
                counts[columns.newest if request == POLICY else columns.named[request]] += 1
                self._ask_again(state, marking, counts, self._watching[p])
                arcs.append(RunArc(tuple(counts), self.ends, robots / total * v))
        return arcs

    def _at_rest(self, state: State) -> State:
        """The state after all robots that ask the policy have drawn nothing that can ever fire
        here."""
        counts: Optional[List[int]] = None
        for column, idle in self._rests:
            if state[column]:
                counts = counts or list(state)
                counts[idle] += counts[column]
                counts[column] = 0
        return state if counts is None else tuple(counts)

    def steps(self, state: State) -> List[RunArc]:
        """What happens in a settled state, in which nothing happens in zero time: arcs with
        rates."""
        marking = self.marking(state)
        if self._rules.is_over(marking):
            return []
        arcs: List[RunArc] = []
        for column, rates in self._racing:
            robots = state[column]
            if robots:
                for t, rate in rates:
                    for target, v in self._after(state, t, ((column, 1),)):
                        arcs.append(RunArc(target, t, robots * rate * v))
        for p, columns in self._working:
            for column, rate, following in zip(columns.phases, columns.rates, columns.following):
                robots = state[column]
                if not robots:
                    continue
                if following >= 0:
                    counts = list(state)
                    counts[column] -= 1
                    counts[following] += 1
                    arcs.append(RunArc(tuple(counts), self.ends, robots * rate))
                    continue
                if not columns.outcomes:
                    counts = list(state)
                    counts[column] -= 1
                    counts[columns.stuck] += 1
                    arcs.append(RunArc(tuple(counts), self.ends, robots * rate))
                for request, v in columns.outcomes:
                    arcs += self._done(state, marking, p, column, request, robots * rate * v)
        for t, rate, where in self._interrupts:
            if self.net.is_enabled(marking, t):
                for column in where:
                    robots = state[column]
                    if robots:
                        for target, v in self._after(state, t, ((column, 1),)):
                            arcs.append(RunArc(target, t, robots * rate * v))
        for t in self._environment:
            if self.net.is_enabled(marking, t):
                rate = self.net.effective_rate(marking, t)
                for target, v in self._after(state, t, ()):
                    arcs.append(RunArc(target, t, rate * v))
        return arcs

    def _done(
        self, state: State, marking: Marking, p: int, column: int, request: int, rate: float
    ) -> Iterator[RunArc]:
        """The steps, at ``rate`` in all, when a robot in ``column`` of place ``p`` is done and
        makes a request."""
        columns = self._columns[p]
        counts = list(state)
        counts[column] -= 1
        if request == POLICY:
            counts[columns.newest] += 1
        else:
            counts[columns.named[request]] += 1
        asked = self._ask_again(state, marking, counts, self._watching[p])
        target = tuple(counts)
        if request == POLICY or asked or not self._can_fire(target, marking, request):
            yield RunArc(target, self.ends, rate)
            return
        # Whoever waited could not fire before, so only this request can fire now.
        for taken, v in self._takings(target, request, columns.named[request]):
            for after, u in self._after(target, request, taken):
                yield RunArc(after, request, rate * v * u)

    def _ask_again(
        self,
        before: Sequence[int],
        marking: Marking,
        counts: List[int],
        places: Sequence[Tuple[int, _Columns]],
    ) -> bool:
        """Let robots at the policy, which have drawn, draw again where the candidates are others
        than ``before``. Returns whether any do."""
        asked = False
        ready: Tuple[set[int], set[int]] = (set(), set())
        known = False
        for q, columns in places:
            drawn = (columns.idle, *columns.holding.values())
            if not any(counts[c] for c in drawn):
                continue
            if not known:
                known = True
                ready = (
                    self._ready(before, marking),
                    self._ready(counts, marking),
                )
            if ready[0] == ready[1]:
                break
            old, new = (
                [t for t, _ in self._rules.draw(marking, q, fireable)] for fireable in ready
            )
            if old != new:
                asked = True
                for c in drawn:
                    counts[columns.asking] += counts[c]
                    counts[c] = 0
        return asked

    # -- in zero time ------------------------------------------------------------------------------

    def _can_fire(self, state: Sequence[int], marking: Marking, t: int) -> bool:
        """Whether ``t`` is enabled and has enough robots that are done and free for it."""
        if t in self._never or not self.net.is_enabled(marking, t):
            return False
        for _, weight, named, at_policy in self._takes[t]:
            free = state[named] if named >= 0 else 0
            for column in at_policy:
                free += state[column]
            if free < weight:
                return False
        return True

    def _ready(self, state: Sequence[int], marking: Marking) -> set[int]:
        """The immediate transitions that can fire."""
        return {t for t in self._immediate if self._can_fire(state, marking, t)}

    def _at_once(self, state: State, marking: Marking) -> List[RunArc]:
        """The steps in zero time."""
        net = self.net
        spontaneous = [t for t in self._spontaneous if net.is_enabled(marking, t)]
        if spontaneous:
            return [
                RunArc(target, t, chance * v)
                for t, chance in self._rules.by_weight(spontaneous)
                if t is not None
                for target, v in self._after(state, t, ())
            ]
        groups: List[Requests] = []
        columns_of: List[int] = []  # the column of each group
        drawing: List[_Drawing] = []
        first: List[_Drawing] = []
        for p in dict.fromkeys([p for column, p in self._waiting if state[column]]):
            columns = self._columns[p]
            ready = {t for t in net.consumers[p] if self._can_fire(state, marking, t)}
            for table in (columns.named, columns.holding):
                for t, column in table.items():
                    if state[column] and t in ready:
                        groups.append(Requests(state[column], {t: 1.0}))
                        columns_of.append(column)
            for column in (columns.newest, columns.asking):
                if column < 0 or not state[column]:
                    continue
                draw = self._rules.draw(marking, p, ready)
                able = {t: v for t, v in draw if t in ready}
                drawn = [
                    (t, v) for t, v in draw if t in columns.holding and net.is_enabled(marking, t)
                ]
                if self._keeps_draws and drawn and column == columns.asking:
                    kept = [(columns.holding[t], v) for t, v in drawn]
                    first.append(_Drawing(column, columns.idle, kept, 1.0))
                kept = [(columns.holding[t], v) for t, v in drawn if t not in ready]
                drawing.append(_Drawing(column, columns.idle, kept, 1.0 - sum(able.values())))
                if able:
                    groups.append(Requests(state[column], able, column == columns.newest))
                    columns_of.append(column)
        if first and self._may_outlast(groups, columns_of, sum(state[d.column] for d in first)):
            return self._draw_all(state, first, 1.0)
        if not groups:
            return (
                self._draw_all(state, drawing, 1.0)
                if any(robots.kept for robots in drawing)
                else []
            )
        arcs: List[RunArc] = []
        whole = 0.0
        for column, chances in zip(columns_of, first_to_fire(groups, self._rules.urgency)):
            for t, chance in chances.items():
                whole += chance
                if chance > 0:
                    for taken, v in self._takings(state, t, column):
                        for target, u in self._after(state, t, taken):
                            arcs.append(RunArc(target, t, chance * v * u))
        if arcs and 1.0 - whole > _TINY:
            return arcs + self._draw_all(state, drawing, 1.0 - whole)
        return [RunArc(target, t, value / whole) for target, t, value in arcs]

    def _may_outlast(
        self, groups: Sequence[Requests], columns_of: Sequence[int], asking: int
    ) -> bool:
        """Whether one of the requests may fire and leave draws of others, which are ``asking``, as
        they are. Then all draw before anything fires. Not so the robot that has just finished: it
        goes last, and if a partner takes it its own draw is never needed."""
        at_policy = {c.asking for _, c in self._deciding}
        return any(
            not self._changes[t] and asking > (column in at_policy)
            for group, column in zip(groups, columns_of)
            for t in group.draw
        )

    def _draw_all(self, state: State, drawing: Sequence[_Drawing], chance: float) -> List[RunArc]:
        """The steps, with a probability of ``chance`` in all, when all that ask the policy have
        drawn what they keep."""
        found: List[Tuple[List[int], float]] = [(list(state), chance)]
        for column, idle, kept, whole in drawing:
            rest = whole - sum(v for _, v in kept)
            entry = [(to, v / whole) for to, v in kept]
            if rest > _TINY:
                entry.append((idle, rest / whole))
            robots = state[column]
            for counts, _ in found:
                counts[column] -= robots
            found = _spread(found, entry, robots)
        return [RunArc(tuple(counts), self.waits, v) for counts, v in found]

    # -- firing ------------------------------------------------------------------------------------

    def _takings(self, state: State, t: int, requester: int) -> List[Tuple[Taken, float]]:
        """Which robots transition ``t`` takes when one in column ``requester`` asks for it: pairs
        (columns with counts, probability). Any other robots that are free are equally likely."""
        found: List[Tuple[Taken, float]] = [((), 1.0)]
        for _, weight, named, at_policy in self._takes[t]:
            # If the marking changes, all at the policy draw again: they are alike.
            classes = [at_policy] if self._changes[t] else [(c,) for c in at_policy]
            classes = [((named,) if named >= 0 else ()), *classes]
            free = [sum(state[c] for c in members) for members in classes]
            certain = [int(requester in members) for members in classes]
            ways = _choices([n - sure for n, sure in zip(free, certain)], weight - sum(certain))
            found = [
                (
                    taken + _pick(state, classes, [k + sure for k, sure in zip(way, certain)]),
                    v * u,
                )
                for taken, v in found
                for way, u in ways
            ]
        return found

    def _after(self, state: State, t: int, taken: Taken) -> List[Tuple[State, float]]:
        """The states after ``t`` fires and takes these robots, with their probabilities."""
        counts = list(state)
        for column, n in taken:
            counts[column] -= n
        for column, n in self._moves[t]:
            counts[column] += n
        found = [(counts, 1.0)]
        for entry, n in self._spreads[t]:
            found = _spread(found, entry, n)
        for counts, _ in found:
            if self._changes[t]:
                for column, asking in self._draws_end:
                    if counts[column]:
                        counts[asking] += counts[column]
                        counts[column] = 0
            else:
                self._ask_again(state, self.marking(state), counts, self._deciding)
        return [(tuple(counts), v) for counts, v in found]

    # -- for people --------------------------------------------------------------------------------

    @property
    def parts(self) -> List[Tuple[int, str]]:
        """The columns of the places that are split, with names for people."""
        found: List[Tuple[int, str]] = []
        for p, columns in self._columns.items():
            if not (columns.phases or columns.named or columns.holding):
                continue  # all robots are done, and alike
            place = self.net.places[p].name
            names = {t: self.net.transitions[t].name for t in self.net.consumers[p]}
            count = len(columns.phases)
            for number, column in enumerate(columns.phases, 1):
                what = (
                    "doing its action" if count == 1 else "doing, phase %d of %d" % (number, count)
                )
                found.append((column, "%s (%s)" % (place, what)))
            found += [
                (c, "%s (done, wants %s)" % (place, names[t])) for t, c in columns.named.items()
            ]
            found += [
                (c, "%s (done, has drawn %s)" % (place, names[t]))
                for t, c in columns.holding.items()
            ]
            for column, what in (
                (columns.newest, "just done"),
                (columns.asking, "done, asks the policy"),
                (columns.idle, "done, waits"),
                (columns.stuck, "done, stuck"),
            ):
                if column >= 0:
                    found.append((column, "%s (%s)" % (place, what)))
        return found

    # -- how many states ---------------------------------------------------------------------------

    def _many(self) -> List[Tuple[int, float]]:
        """The places with durations of several phases, and how many."""
        found = [(p, number_of_phases(self.timing[p].duration)) for p, _ in self._working]
        return [(p, k) for p, k in found if k > 1]

    @property
    def most_phases(self) -> float:
        """The largest number of phases of a duration."""
        return max((k for _, k in self._many()), default=1)

    def matches(self) -> List[str]:
        """With what durations that are not made of phases were replaced: sentences for people."""
        found = []
        for p, _ in self._many():
            duration = self.timing[p].duration
            phases = phases_of(duration)
            if duration.branches is None and phases is not None:
                found.append(
                    "the duration of %s (%s) was replaced by phases of the same mean and variance: "
                    "%s" % (self.net.places[p].name, duration.describe(), phases.matched)
                )
        return found

    def states_with_phases(self, states: Sequence[State]) -> float:
        """How many states there would be if durations had their phases: each of ``states``, found
        with one phase for each, as often as its robots can be spread over the phases."""
        many = [(self._columns[p].phases[0], k) for p, k in self._many()]
        total = 0.0
        known: Dict[Tuple[int, ...], float] = {}
        for state in states:
            doing = tuple([state[column] for column, _ in many]) if state else ()
            if doing not in known:
                known[doing] = math.prod([_spreadings(n, k) for n, (_, k) in zip(doing, many)])
            total += known[doing]
        return total

    def why_so_many(self, states: float, limit: int) -> str:
        """Why the phases of the durations are too many, for people."""
        p, k = max(self._many(), key=lambda entry: entry[1])
        longest = "that of %s (%s)" % (
            self.net.places[p].name,
            self.timing[p].duration.describe(),
        )
        if math.isinf(k):
            return "durations that never vary have no exponential phases: %s" % longest
        takes = "%s alone takes %s phases" % (longest, format(int(k), ","))
        if states <= limit:
            return "a duration may take up to %d phases, and %s" % (MOST_PHASES, takes)
        return "the durations take about %s states, more than the limit of %s; %s" % (
            format(int(states), ",") if states < 1e15 else "%.1e" % states,
            format(limit, ","),
            takes,
        )


Taken = Tuple[Tuple[int, int], ...]
"""Columns, each with the number of robots that a transition takes from it."""


class _Drawing(NamedTuple):
    """Robots that ask the policy: those in ``column`` go to ``kept`` columns (pairs with
    probabilities) or else to ``idle``; ``whole`` is the probability that they do either."""

    column: int
    idle: int
    kept: List[Tuple[int, float]]
    whole: float


def _is_exponential(duration: Duration) -> bool:
    return number_of_phases(duration) == 1 and duration.branches is not None


def _spreadings(robots: int, phases: float) -> float:
    """The number of ways in which robots that are alike can be in phases."""
    if not robots:
        return 1.0
    if math.isinf(phases):
        return math.inf
    return float(math.comb(robots + int(phases) - 1, robots))


def _spread(
    found: List[Tuple[List[int], float]], entry: Sequence[Tuple[int, float]], robots: int
) -> List[Tuple[List[int], float]]:
    """Put ``robots`` more into the columns of ``entry``, each by chance: the counts that may
    follow, with probabilities. It may change the lists in ``found``."""
    if not robots:
        return found
    if len(entry) == 1:
        for counts, _ in found:
            counts[entry[0][0]] += robots
        return found
    result = []
    for numbers in _compositions(robots, len(entry)):
        chance = float(math.factorial(robots))
        for n, (_, v) in zip(numbers, entry):
            chance *= v**n / math.factorial(n)
        for counts, u in found:
            more = list(counts)
            for n, (column, _) in zip(numbers, entry):
                more[column] += n
            result.append((more, u * chance))
    return result


def _compositions(total: int, parts: int) -> Iterator[Tuple[int, ...]]:
    """All ways to write ``total`` as a sum of so many numbers of at least 0."""
    if parts == 1:
        yield (total,)
        return
    for first in range(total, -1, -1):
        for rest in _compositions(total - first, parts - 1):
            yield (first, *rest)


def _choices(numbers: Sequence[int], wanted: int) -> List[Tuple[Tuple[int, ...], float]]:
    """How many of each class are among ``wanted`` ones that are chosen from all at random: with
    probabilities."""
    if sum(numbers) == wanted:
        return [(tuple(numbers), 1.0)]
    ways = math.comb(sum(numbers), wanted)
    return [
        (way, math.prod([math.comb(n, k) for n, k in zip(numbers, way)]) / ways)
        for way in itertools.product(*(range(min(n, wanted) + 1) for n in numbers))
        if sum(way) == wanted
    ]


def _pick(state: State, classes: Sequence[Tuple[int, ...]], numbers: Sequence[int]) -> Taken:
    """So many robots of each class, whichever columns of it they are in."""
    taken = []
    for members, left in zip(classes, numbers):
        for column in members:
            n = min(state[column], left)
            if n:
                taken.append((column, n))
                left -= n
    return tuple(taken)
