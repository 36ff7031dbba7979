"""From a plan to its run net.

**As the plan runs** (``--timing run``) each robot is *doing* its action for a duration, then
*done*, and moves as soon as it can (``docs/semantics.md``). An action place has the columns of
``columns`` where that has to be known. It is kept as it is where the net is the same chain: a robot
whose exponential transitions need nothing but its own token, with an exponential duration, moves on
the moment that it is done. Its action and the race of those transitions are then the same, because
an exponential duration is memoryless. So is a place that only events leave. Robots in a decision
place without a duration are done at once. If it has an action, which takes no time, they are done
one after the other, each when all others have moved that can; without one they are done on arrival.

An attempt *fails* with the probability of the plan's ``failures``, or when the timeout cuts it off,
or when it says nothing that is possible; then the plan's rule for the place applies. An attempt
that may be cut off takes the lesser of its duration and the timeout, one after a delay also that:
both are matched by their mean and variance, and whether they fail does not depend on how long they
took.

**In the classical reading** (``--timing net``) the plan is its net under its policy: exponential
transitions race while they are enabled, and robots take no time in a place with immediate outputs,
even where an action runs there. Only these places have columns. Every firing ends the draws.

In both, an event that interrupts comes at the rate of its transition to each robot in the place,
whatever it is doing there, and has an effect if the marking then enables the transition.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from dataclasses import replace
from types import MappingProxyType
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.failure import FailureEnd
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import (
    NO_REQUEST,
    POLICY,
    PlaceVisit,
    PlanRules,
    PlanTiming,
    rules_of,
)
from gspn_framework_package.run_net.columns import (
    End,
    EventClock,
    PlaceColumns,
    Race,
    Racing,
    Shares,
    Taking,
    TimedAttempt,
    spread,
)
from gspn_framework_package.run_net.phases import (
    MOST_PHASES,
    is_tiny,
    number_of_phases,
    phases_of,
)
from gspn_framework_package.run_net.requests import PolicyDraws
from gspn_framework_package.run_net.run_net import RunNet

FEW_PHASES = 4
"""Maximum number of phases of an attempt that is cut off or delayed, unless its action has more."""

MOST_RETRIES = 20
"""A rule that allows more retries than this counts as unlimited."""

_NEVER = 1e-12
"""A failure with a smaller probability counts as impossible."""

_ROUNDING = 1e-15
"""A probability below this is a rounding error."""


def one_phase_each(plan: Plan) -> Dict[str, float]:
    """``phases`` of :func:`compile_plan`: one for each duration."""
    return dict.fromkeys(plan.action_places, 1.0)


def no_time_if_tiny(plan: Plan, timing: PlanTiming) -> Dict[str, float]:
    """``phases`` of :func:`compile_plan`: none for durations that are tiny compared with others."""
    durations = {plan.net.places[p].name: one.duration for p, one in timing.places.items()}
    longest = max((duration.mean for duration in durations.values()), default=0.0)
    return {name: 0.0 for name, one in durations.items() if is_tiny(one, longest)}


def compile_plan(
    plan: Plan,
    timing: Optional[PlanTiming],
    *,
    phases: Mapping[str, float] = MappingProxyType({}),
    exponential: bool = False,
    left_out: Optional[Sequence[str]] = None,
) -> RunNet:
    """Compile a plan.

    :param plan: a validated plan.
    :param timing: its durations and outcomes; None: the classical reading.
    :param phases: place -> the most phases of each duration there. With one for each, the same
        markings are reached in far fewer states; with none, the action takes no time.
    :param exponential: whether each duration is exponential with its mean, so that no place is
        split for its duration alone; whether an attempt fails still follows from the true one.
    :param left_out: resource places that nothing reads; None: all of them.
    """
    if timing is not None and plan.own_times:  # states do not distinguish robots
        plan = replace(plan, own_times={})
        timing = PlanTiming(plan)
    rules = rules_of(plan, timing, plan.counters if left_out is None else left_out)
    splits = timing.splits if timing is not None else {}
    return _Compiler(replace(rules, net=_net_of(rules)), splits, phases, exponential).run_net()


class _Compiler:
    def __init__(
        self,
        rules: PlanRules,
        splits: Dict[str, str],
        phases: Mapping[str, float],
        exponential: bool,
    ) -> None:
        self._rules, self._exponential, self._phases = rules, exponential, phases
        self._net = net = rules.net
        self._assumptions: List[str] = []
        self._timing = {p: self._of_team(p) for p in rules.visits[0]}
        self._failures = {p: self._failure(p) for p in self._timing}
        self._outlives_robots = not self._rules.classical and not all(self._rules.robots_of)
        self._late = {p for p in self._timing if self._takes_time(p) or self._ends_at_once(p)}
        self._keeps_draws = not self._rules.classical and any(
            self._rules.robots_of[t]
            and not rules.resets[t]
            and self._is_asked_for(t)
            and not any(self._races(p) for p, _ in self._rules.robots_of[t])
            for t in range(len(net.transitions))
        )
        self._columns: Dict[int, PlaceColumns] = {}
        self._whole: Dict[int, int] = {}
        self._racing: List[Racing] = []
        self._parts: List[Tuple[int, int]] = []
        self._stopped = -1
        self._lay_out()
        self._splits: Dict[str, str] = {}
        for p in self._columns:
            name = net.places[p].name
            if name in splits:
                self._splits[name] = splits[name]
            elif self._failures.get(p):
                self._splits[name] = "an attempt at its action can fail"

    # -- places ------------------------------------------------------------------------------------

    def _of_team(self, p: int) -> PlaceVisit:
        """What every robot does in a place, since states do not distinguish robots."""
        rules = self._rules
        team = rules.visits[0][p]
        own = Counter(rules.visits[kind][p] for kind in rules.kind_of)
        if any(one != team for one in own):
            ((team, _),) = own.most_common(1)
            if len(own) > 1:
                self._assumptions.append(
                    "every robot in %s does what most of them do there, since states do not "
                    "distinguish robots (the simulation does)" % self._net.places[p].name
                )
        name = self._net.places[p].name
        if self._phases.get(name) == 0:
            self._assumptions.append(
                "the duration of %s (%s) counts as 0, since it is tiny compared with others"
                % (name, team.duration.describe())
            )
            team = team._replace(duration=Duration.none())
        asked: Dict[int, float] = {}
        for t, v in team.asks:
            asked[t] = asked.get(t, 0) + v
        return team._replace(asks=tuple(asked.items()))

    def _only_events(self, p: int) -> bool:
        """Whether nothing but events takes a robot out of place ``p``."""
        return not self._rules.of_action(p) and all(t == POLICY for t, _ in self._timing[p].asks)

    def _outcomes(self, p: int) -> Shares:
        """The requests of a robot whose action in place ``p`` succeeded; empty if the action never
        names a possible transition."""
        if self._rules.classical:
            return ((POLICY, 1.0),)
        possible = self._possible(p)
        total = sum(v for _, v in possible)
        return tuple((t, v / total if total < 1.0 - _ROUNDING else v) for t, v in possible)

    def _possible(self, p: int) -> List[Tuple[int, float]]:
        """Those of the plan's outcomes in place ``p`` that name a possible transition."""
        return [(t, v) for t, v in self._timing[p].asks if t != NO_REQUEST]

    def _failure(self, p: int) -> float:
        """The probability that an attempt in place ``p`` fails: it is cut off, or does not succeed,
        or names no possible transition."""
        succeeds = 1.0 - self._timing[p].failure
        succeeds *= min(sum(v for _, v in self._possible(p)), 1.0)
        failure = 1.0 - (1.0 - self._cut_off(p)) * succeeds
        return failure if failure > _NEVER else 0.0

    def _cut_off(self, p: int) -> float:
        """The probability that the timeout cuts an attempt in place ``p`` off."""
        timing = self._timing[p]
        if timing.timeout == math.inf or timing.duration.mean == 0:
            return 0.0
        cut_off = float(timing.duration.survival(timing.timeout))
        return cut_off if cut_off > _NEVER else 0.0

    def _failure_leads_on(self, p: int) -> bool:
        """Whether a failure in place ``p`` has any effect other than that the robot stays there."""
        return self._failures[p] > 0 and (self._stops(p) or self._timing[p].fallback >= 0)

    def _stops(self, p: int) -> bool:
        """Whether a failure in place ``p`` stops the team."""
        return self._failures[p] > 0 and self._timing[p].rule.end is FailureEnd.STOP

    def _races(self, p: int) -> bool:
        """Whether place ``p`` is not split although its action takes time: its transitions need
        only the robot's own token, and the duration is exponential."""
        timing = self._timing[p]
        return (
            timing.duration.mean > 0
            and (self._exponential or _is_exponential(timing.duration))
            and not self._failures[p]
            and all(t >= 0 for t, _ in timing.asks)
            and all(
                self._net.transitions[t].timed and self._net.fires_alone(t, p)
                for t in {*self._rules.of_action(p), *(t for t, _ in timing.asks)}
            )
        )

    def _is_asked_for(self, t: int) -> bool:
        """Whether a robot ever asks for transition ``t``; if not, only its event fires it."""
        p = self._rules.interrupted.get(t)
        return p is None or any(asked == t for asked, _ in self._outcomes(p))

    def _takes_time(self, p: int) -> bool:
        """Whether robots in place ``p`` are distinguished by doing and done."""
        return not self._stays_whole(p) and self._timing[p].duration.mean > 0 and not self._races(p)

    def _ends_at_once(self, p: int) -> bool:
        """Whether robots in place ``p`` have an action that takes no time. They are done one after
        the other, when the others have moved; without an action they are done on arrival."""
        return (
            not self._stays_whole(p)
            and self._timing[p].duration.mean == 0
            and not self._timing[p].idle
        )

    def _stays_whole(self, p: int) -> bool:
        """Whether only the number of robots in place ``p`` matters."""
        if not self._rules.acts[p]:
            return True
        if self._rules.classical:
            return all(self._net.transitions[t].timed for t in self._net.consumers[p])
        if self._failure_leads_on(p):
            return False
        if self._net.consumers[p]:
            return self._only_events(p)
        # when its action is done matters where the run could continue without robots
        return not self._outlives_robots or not (
            self._failures[p] or self._timing[p].duration.mean > 0
        )

    def _waits_for_partners(self, p: int, t: int) -> bool:
        """Whether transition ``t``, drawn in place ``p``, may have to wait for a partner that is
        still doing."""
        return any(q in self._late and (q != p or w > 1) for q, w in self._rules.robots_of[t])

    def _lay_out(self) -> None:
        width = 0
        if any(map(self._stops, self._timing)):
            self._stopped, width = 0, 1
        for p in range(len(self._net.places)):
            first = width
            if self._stays_whole(p):
                self._whole[p] = width
                width += 1
            elif not self._rules.classical and self._races(p):
                self._whole[p] = width
                rate = 1.0 / self._timing[p].duration.mean
                rates = tuple((t, rate * v) for t, v in self._outcomes(p))
                self._racing.append(Racing(width, rates))
                width += 1
            else:
                self._columns[p], width = self._split(p, width)
            self._parts.append((first, width))

    def _split(self, p: int, first: int) -> Tuple[PlaceColumns, int]:
        """The columns of place ``p``, from column ``first`` on, and the column after them."""
        outcomes = self._outcomes(p) if self._net.consumers[p] else ()
        numbers = itertools.count(first)
        tries, repeats = self._tries(p)
        entries: List[Shares] = []
        exits: List[List[int]] = []  # of each attempt: the columns in which it ends
        attempts: List[TimedAttempt] = []
        arriving: List[int] = []
        most = 1 if self._exponential else self._phases.get(self._net.places[p].name, MOST_PHASES)
        for duration, what in tries:
            if duration.mean == 0:
                arriving.append(next(numbers))
                entries.append(((arriving[-1], 1.0),))
                exits.append([arriving[-1]])
                continue
            phases = phases_of(duration, most)
            doing = tuple(next(numbers) for _ in phases.rates)
            following = tuple(f if f < 0 else doing[f] for f in phases.following)
            attempts.append(TimedAttempt(doing, phases.rates, following, duration, what))
            entries.append(tuple((doing[phase], v) for phase, v in phases.start))
            exits.append([column for column, f in zip(doing, following) if f < 0])
        failure = self._failures[p] if tries else float(not self._rules.classical and not outcomes)
        fallback = self._timing[p].fallback if failure else -1
        asked = [t for t, _ in outcomes if t != POLICY]
        if fallback >= 0 and fallback not in asked:
            asked.append(fallback)
        named = {t: next(numbers) for t in asked}
        stuck = -1
        inactive = next(numbers) if not self._net.consumers[p] else -1
        if (not outcomes and inactive < 0) or (failure and fallback < 0):
            stuck = next(numbers)
        asking = idle = -1
        holding: Dict[int, int] = {}
        if any(t == POLICY for t, _ in outcomes):
            asking, idle = next(numbers), next(numbers)
            for t in self._net.consumers[p]:
                if not self._net.transitions[t].timed and (
                    self._keeps_draws or self._waits_for_partners(p, t)
                ):
                    holding[t] = next(numbers)
        done = [End(t, asking if t == POLICY else named[t], v) for t, v in outcomes]
        if not outcomes:
            done = [End(None, inactive if inactive >= 0 else stuck, 1.0)]
        if fallback >= 0:
            failed = [End(fallback, named[fallback], 1.0, failed=True)]
        else:
            failed = [End(None, stuck, 1.0, bool(tries) and self._stops(p), failed=True)]
        ends: Dict[int, Tuple[End, ...]] = {}
        again = [*entries[1:], *(entries[-1:] if repeats else ())]
        for columns, following_entry in itertools.zip_longest(exits, again):
            fails = failed
            if following_entry is not None:
                fails = [End(None, column, v, failed=True) for column, v in following_entry]
            here = [end._replace(probability=end.probability * (1.0 - failure)) for end in done]
            here += [end._replace(probability=end.probability * failure) for end in fails]
            ends.update(dict.fromkeys(columns, tuple(end for end in here if end.probability > 0)))
        layout = PlaceColumns(
            entries[0] if entries else tuple((end.column, end.probability) for end in done),
            ends=ends,
            outcomes=outcomes,
            attempts=tuple(attempts),
            arriving=tuple(arriving),
            named=named,
            asking=asking,
            idle=idle,
            holding=holding,
            stuck=stuck,
            inactive=inactive,
        )
        return layout, next(numbers)

    def _tries(self, p: int) -> Tuple[List[Tuple[Duration, str]], bool]:
        """The attempts at the action of place ``p``: how long each takes, also in words, and
        whether a robot continues trying after the last of them. Empty if there is no action."""
        if p not in self._late:
            return [], False
        timing, rule = self._timing[p], self._timing[p].rule
        first, what = timing.duration, timing.duration.describe()
        plain = number_of_phases(first) if first.mean > 0 else 1
        if self._cut_off(p):
            what += ", cut off after %g s" % timing.timeout
            first = self._few_phases(p, first.cut_off(timing.timeout), plain, what)
            self._assumptions.append(
                "whether an attempt in %s is cut off does not depend on how long it takes"
                % self._net.places[p].name
            )
        failure = self._failures[p]
        if not rule.times or not failure:
            return [(first, what)], False
        count = rule.times
        endless = failure**count <= _NEVER or count > MOST_RETRIES
        if endless:
            count = min(len(rule.delays), MOST_RETRIES, count)
            if failure**rule.times > _NEVER:
                self._assumptions.append(
                    "robots in %s try again for ever (in a run, %d times)"
                    % (self._net.places[p].name, rule.times)
                )
            if count < len(rule.delays):
                self._assumptions.append(
                    "robots in %s try again after %g s from failure %d on"
                    % (self._net.places[p].name, rule.delay(count), count)
                )
        again = {0.0: (first, what)}
        delays = [rule.delay(failures) for failures in range(1, count + 1)]
        for delay in delays:
            if delay not in again:
                words = "%s, after %g s" % (what, delay)
                again[delay] = self._few_phases(p, first.delayed(delay), plain, words), words
        return [(first, what), *(again[delay] for delay in delays)], endless

    def _few_phases(self, p: int, duration: Duration, plain: float, what: str) -> Duration:
        """The duration of an attempt in place ``p``, or one of its mean if it needs many more
        phases than the ``plain`` duration of the action."""
        most = max(plain if plain <= MOST_PHASES else 1, FEW_PHASES)
        if self._exponential or number_of_phases(duration) <= most:
            return duration
        self._assumptions.append(
            "an attempt in %s (%s) is taken as Erlang with %d phases, of the same mean"
            % (self._net.places[p].name, what, most)
        )
        return Duration.erlang(int(most), duration.mean)

    def _inactive(self) -> Tuple[int, ...]:
        return tuple(
            self._columns[p].inactive if p in self._columns else self._whole[p]
            for p in self._timing
            if not self._net.consumers[p]
        )

    def _entry(self, p: int) -> Shares:
        return self._columns[p].entry if p in self._columns else ((self._whole[p], 1.0),)

    # -- steps -------------------------------------------------------------------------------------

    def run_net(self) -> RunNet:
        """The run net."""
        net = self._net
        numbers = range(len(net.transitions))
        begin: List[Tuple[List[int], float]] = [([0] * self._parts[-1][1], 1.0)]
        for p, place in enumerate(net.places):
            begin = spread(begin, self._entry(p), place.tokens)
        return RunNet(
            **vars(self._rules),
            timing=self._timing,
            draws=PolicyDraws(self._rules.plan, net),
            columns=self._columns,
            whole=self._whole,
            parts=self._parts,
            stopped=self._stopped,
            inactive=self._inactive() if self._outlives_robots else (),
            begin=[(tuple(counts), v) for counts, v in begin],
            racing=self._racing,
            interrupts=[
                EventClock(t, net.transitions[t].number, tuple(range(*self._parts[p])))
                for t, p in self._rules.interrupted.items()
            ],
            races=[self._race(t) for t in numbers if self._is_race(t)],
            takes=[self._takes(t) for t in numbers],
            never={
                t for t in numbers if any(p in self._whole for p, _ in self._rules.robots_of[t])
            },
            moves=[self._moves(t) for t in numbers],
            spreads=[[(entry, w) for entry, w in self._puts(t) if len(entry) > 1] for t in numbers],
            keeps_draws=self._keeps_draws,
            watching={p: self._watched_from(p) for p in self._late},
            splits=self._splits,
            assumptions=self._assumptions,
        )

    def _is_race(self, t: int) -> bool:
        """Whether exponential transition ``t`` fires at the rate that the marking gives it."""
        if self._rules.classical:
            return self._net.transitions[t].timed and t not in self._rules.interrupted
        return t in self._rules.environment

    def _race(self, t: int) -> Race:
        robots = self._rules.robots_of[t]
        return Race(
            t,
            tuple((self._whole[p], w) for p, w in robots if p in self._whole),
            tuple((tuple(range(*self._parts[p])), w) for p, w in robots if p in self._columns),
        )

    def _takes(self, t: int) -> Tuple[Taking, ...]:
        """The robots that transition ``t`` takes from split places."""
        timed = self._net.transitions[t].timed
        return tuple(
            Taking(
                p,
                w,
                self._columns[p].named.get(t, -1),
                () if timed else self._columns[p].at_policy,
            )
            for p, w in self._rules.robots_of[t]
            if p in self._columns
        )

    def _puts(self, t: int) -> Sequence[Tuple[Shares, int]]:
        return [(self._entry(p), w) for p, w in self._net.outputs[t]]

    def _moves(self, t: int) -> List[Tuple[int, int]]:
        taken = [(self._whole[p], -w) for p, w in self._net.inputs[t] if not self._rules.acts[p]]
        return taken + [(entry[0][0], w) for entry, w in self._puts(t) if len(entry) == 1]

    def _watched_from(self, p: int) -> List[int]:
        """The places in which a robot that becomes done in place ``p`` can change what others may
        draw."""
        return [
            q
            for q, columns in self._columns.items()
            if columns.asking >= 0
            and any(
                not self._net.transitions[t].timed
                and any(r == p and (q != p or w > 1) for r, w in self._rules.robots_of[t])
                for t in self._net.consumers[q]
            )
        ]


def _is_exponential(duration: Duration) -> bool:
    return number_of_phases(duration) == 1 and duration.branches is not None


def _net_of(rules: PlanRules) -> Net:
    """The net of a plan for analysis: the exponential transitions that leave action places get as
    many servers as there are robots."""
    transitions = [
        t._replace(servers=None) if t.timed and robots else t
        for t, robots in zip(rules.net.transitions, rules.robots_of)
    ]
    return Net(rules.net.places, transitions, rules.net.arcs, rules.net.name)
