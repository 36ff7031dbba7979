"""The decision problem of a plan: the Markov automaton of all choices of its robots.

In zero time, the following happens in this order until nothing more can happen: transitions that
only take resources fire, by priority and weight; transitions that an action names, or that chance
chooses, fire; then the policy makes one decision, among the transitions of the highest priority
that can fire, or lets the robots wait where they may; then robots that request an exponential
transition move. The states are those of the *untimed closure*, also after losses of robots: every
marking in which a run may ask the policy.
"""

# In one piece: the problem, its teams and what a policy does in them are the same arrays

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Dict, Iterable, List, Mapping, Optional, Sequence, Set, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.decisions.aims import Objective
from gspn_framework_package.analysis.decisions.automaton import CHANCE, Automaton, Rewards
from gspn_framework_package.analysis.decisions.building import (
    Built,
    Stages,
    build_automaton,
    part_of,
)
from gspn_framework_package.analysis.decisions.decision_net import DecisionNet, Stage
from gspn_framework_package.analysis.decisions.playing import (
    ROUNDING,
    DecidedAnswers,
    Play,
    answers_of,
    play_answers,
)
from gspn_framework_package.analysis.decisions.safety import Safety
from gspn_framework_package.analysis.decisions.who_decides import Decider, who_decides
from gspn_framework_package.analysis.graph import components, flat_ranges, reachable_from
from gspn_framework_package.analysis.limits import Limits, states_of
from gspn_framework_package.analysis.plan.edited_nets import with_end
from gspn_framework_package.analysis.plan.policy_answers import distinct_rows
from gspn_framework_package.analysis.plan.reading import RUN, checked_reading, net_notes, of_events
from gspn_framework_package.analysis.state_space.rated_graph import enabled_in
from gspn_framework_package.analysis.state_space.space import StateSpace, explore
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.duration import Kind
from gspn_framework_package.model.errors import RefusedError, UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming, listed
from gspn_framework_package.model.policy import Policy
from gspn_framework_package.run_net.compiling import compile_plan


@dataclass(frozen=True)
class SizedTeam:
    """The decision problem of a team of one size.

    :ivar robots: its size.
    :ivar automaton: the states, rows and arcs.
    :ivar distinct: the markings that occur, one row each, in the place order of the plan's net;
      omitted counters are 0.
    :ivar marking_of: int array: for each state the number of its marking in ``distinct``.
    :ivar twin: boolean array: the states in which robots wait although they could move.
    :ivar decides: boolean array: the states in which the policy chooses.
    :ivar by_policy: boolean array, one value per row: a policy may choose it if nothing else
        forbids it. Other rows of such a state serve the evaluation of policies.
    :ivar states_in: int array: for each state its number among the states of all teams.
    :ivar rows_in: int array: the same for its rows.
    :ivar problem: the decision problem that it belongs to.
    """

    robots: int
    automaton: Automaton
    distinct: Indices
    marking_of: Indices
    twin: Booleans
    decides: Booleans
    by_policy: Booleans
    states_in: Indices
    rows_in: Indices
    problem: DecisionProblem = field(repr=False)

    @property
    def markings(self) -> Indices:
        """The marking of each state."""
        return self.distinct[self.marking_of]


class DecisionProblem:
    """The decision problems of a plan.

    :param plan: a validated plan.
    :param reading: how time is interpreted: ``run`` or ``net``.
    :param may_wait: places in which a robot may wait although it could leave.
    :param never: conditions that may never hold.
    :param conditions: further conditions that will be queried, so that no counter in them is
        omitted.
    :param team_sizes: the sizes of teams; None: the plan's own, and the smaller ones after losses.
    :param limits: how far the exploration may go.
    :raises LimitError: there are too many states.
    :raises RefusedError: it is ambiguous who decides, or a forbidden condition cannot be avoided.
    :raises UsageError: a name or a team size does not fit the plan.

    :ivar teams: the problem of each team size, that of the plan's own team first.
    :ivar deciders: place -> reason why the policy chooses there.
    :ivar chance: place -> reason why chance or the action chooses there.
    :ivar assumptions: sentences for people.
    :ivar found: place -> who decides there.
    :ivar left_out: counters that nothing reads.
    :ivar stages: the states of all teams, and the steps between them.
    :ivar built: their automaton.
    :ivar present: what the plan's own policy does.
    :ivar safety: what may never be; None: nothing was asked.
    """

    def __init__(
        self,
        plan: Plan,
        *,
        reading: str = RUN,
        may_wait: Iterable[str] = (),
        never: Iterable[str] = (),
        conditions: Iterable[str] = (),
        team_sizes: Optional[Iterable[int]] = None,
        limits: Limits = Limits(),  # noqa: B008 (immutable)
        progress: Optional[Progress] = None,
        cancel: Optional[Cancel] = None,
    ) -> None:
        reading, never = checked_reading(reading), tuple(never)
        sizes = None if team_sizes is None else sorted(set(team_sizes), reverse=True)
        self.plan = plan
        self.reading = reading
        self.may_wait = frozenset(may_wait)
        found = who_decides(plan, reading, self.may_wait)
        self.deciders: Dict[str, str] = {p: d.reason for p, d in found.items() if d.policy}
        self.chance: Dict[str, str] = {p: d.reason for p, d in found.items() if not d.policy}
        own = plan.team_size
        largest = max(sizes) if sizes else own
        if sizes and largest != own:
            plan = plan.for_robots(largest)
        losses = plan.timing.evict_after > 0 and largest > 1
        if sizes and min(sizes) < largest:
            losses = True
        if not plan.keeps_robots:
            losses = False
        self._largest = plan
        timing = PlanTiming(plan)
        if reading == RUN and timing.differing:
            raise RefusedError(timing.differing, hint="leave own_times out of the plan")
        self.left_out = _left_out(plan, [*never, *conditions])
        self._run_net = compile_plan(
            plan, timing if reading == RUN else None, exponential=True, left_out=self.left_out
        )
        self._net = DecisionNet(self._run_net, found, losses=losses)
        self.assumptions = self._assume(found, timing)
        net = with_end(self._net.net, plan)
        self.space: StateSpace = explore(
            net,
            limit=limits.states or states_of(len(net.places) + len(net.transitions)),
            untimed=True,
            progress=progress,
            cancel=cancel,
            memory=limits.memory,
            seconds=limits.seconds,
        )
        self.space.require_complete("the choices of the robots")
        over = self._net.ended(self.space)
        if plan.until:
            over |= self.space.holds(plan.until)
        self.stages = Stages(self._net, self.space, over)
        self._plays: Dict[Policy, Play] = {}
        self.present = self._play(plan.policy)
        self.built: Built = build_automaton(
            self.stages, self._voluntary(), self.present.waits > ROUNDING
        )
        self._check_chosen(plan.policy, found)
        self.found = found
        self.safety: Optional[Safety] = self._judge(never) if never else None
        self.teams: List[SizedTeam] = self._teams(own, sizes)

    # -- assumptions ---------------------------------------------------------------------------

    def _assume(self, found: Mapping[str, Decider], timing: PlanTiming) -> List[str]:
        alike: Dict[Tuple[bool, str], List[str]] = {}
        for place, decider in found.items():
            alike.setdefault((decider.policy, decider.reason), []).append(place)
        sentences = [
            "%s decides in %s: %s" % ("the policy" if policy else "chance", listed(places), reason)
            for (policy, reason), places in alike.items()
        ]
        levels = {t.priority for t in self.plan.net.transitions if not t.timed}
        if len(levels) > 1:
            sentences.append(
                "of the immediate transitions that can fire, the policy chooses one of the highest "
                "priority"
            )
        if self._run_net.classical:
            return sentences + net_notes(self.plan).assumptions
        sentences += timing.assumptions + list(self._run_net.assumptions)
        net = self._run_net.net
        longer = []
        for p, timing_there in self._run_net.timing.items():
            durations = [timing_there.duration]
            if p in self._run_net.columns:
                durations += [a.duration for a in self._run_net.columns[p].attempts]
            if any(d.mean > 0 and d.kind is not Kind.EXPONENTIAL for d in durations):
                longer.append(net.places[p].name)
        if longer:
            sentences.append(
                "durations are taken as exponential with their means (%s)" % listed(longer)
            )
        return sentences + of_events(self.plan)

    # -- states ------------------------------------------------------------------------------------

    def _voluntary(self) -> Booleans:
        """The states in which robots may wait by choice: no transition that could fire takes robots
        only from places where waiting is not permitted, and nothing else happens first in zero
        time."""
        net, stages = self._net, self.stages
        count = len(stages)
        waiting = {self.plan.net.place_number(name) for name in self.may_wait}
        later = self._partner_comes()
        allowed = np.ones(count, dtype=bool)
        for t, askers in enumerate(net.askers):
            if net.steps[t] is not Stage.DECIDED or waiting.intersection(askers):
                continue
            states = stages.sources[stages.arcs_of(t)]
            free = np.zeros(len(states), dtype=bool)
            for p in askers:
                if p in later:
                    free |= later[p][states]
            allowed[states[~free]] = False
        for step in (Stage.ASKED, Stage.ARRIVED):
            allowed |= stages.has(np.flatnonzero(stages.kinds == step))
        return allowed

    def _partner_comes(self) -> Dict[int, Booleans]:
        """For places of the plan's net: the states in which a robot there may wait for a partner
        that is still doing, since the marking enables a transition that lacks it."""
        if self._run_net.classical:
            return {}
        plan, stages, space = self.plan.net, self.stages, self.space
        found: Dict[int, Booleans] = {}
        late = self._doing_places
        by_origin: Dict[int, List[int]] = {}
        for t, origin in enumerate(self._net.origins):
            if self._net.steps[t] in (Stage.DECIDED, Stage.NAMED):
                by_origin.setdefault(origin, []).append(t)
        for origin, variants in by_origin.items():
            robots = [(p, w) for p, w in plan.inputs[origin] if self.plan.acts[p]]
            if not any(p in late and (len(robots) > 1 or w > 1) for p, w in robots):
                continue
            enabled = self._enabled(origin)
            for t in variants:
                enabled[stages.sources[stages.arcs_of(t)]] = False
            for p, _ in robots:
                found.setdefault(p, np.zeros(len(space), dtype=bool))
                found[p] |= enabled
        return found

    def _enabled(self, t: int) -> Booleans:
        """The states whose marking enables transition number ``t`` of the plan's net."""
        number = self._net.place_of
        return enabled_in(self.plan.net, t, lambda p: self.space.column(number[p]), len(self.space))

    @cached_property
    def _doing_places(self) -> Set[int]:
        """The places (numbers of the plan's net) in which robots are distinguished by doing and
        done."""
        if self._run_net.classical:
            return set()
        whole = {q for q in self._net.place_of if q >= 0}
        return {group.at for group in self._net.groups if group.place not in whole}

    def _markings_of(self, states: Indices) -> Indices:
        """The markings of states in the place order of the plan's net."""
        number = self._net.place_of
        kept = [p for p, q in enumerate(number) if q >= 0]
        columns = [self.space.column(number[p], states) for p in kept]
        most = max((int(c.max(initial=0)) for c in columns), default=0)
        full = np.zeros((len(states), len(number)), dtype=np.min_scalar_type(most))
        for p, column in zip(kept, columns):
            full[:, p] = column
        return full

    # -- teams -------------------------------------------------------------------------------------

    def _teams(self, own: int, sizes: Optional[Sequence[int]]) -> List[SizedTeam]:
        space, built = self.space, self.built
        robots = np.zeros(len(space), dtype=np.int64)
        if self.plan.keeps_robots:
            for name in self.plan.action_places:
                robots += space.column(self._net.place_of[self.plan.net.place_number(name)])
        else:
            robots[:] = own
        found = sorted(set(np.unique(robots).tolist()) - {0}, reverse=True) or [own]
        wanted = [n for n in found if sizes is None or n in sizes]
        if own in wanted:
            wanted.remove(own)
            wanted.insert(0, own)
        needed = self._needed()
        teams = []
        for n in wanted:
            mine = (robots == n)[built.original]
            part = mine & needed
            # in a team that never needs a decision, no state is more typical than another
            teams.append(self._team(n, part if part.any() else mine, self._start(n, robots)))
        return teams

    def _needed(self) -> Booleans:
        """The states reachable with time from any marking in which a run may ask the policy."""
        built = self.built
        automaton = built.automaton
        count = len(self.space)
        starts = np.zeros(len(automaton), dtype=bool)
        starts[0] = True
        starts[:count] |= ~self._is_named()
        if starts[:count].all():
            return np.ones(len(automaton), dtype=bool)
        return reachable_from(
            len(automaton),
            automaton.row_states[automaton.arc_rows],
            automaton.targets,
            starts,
        )

    def _is_named(self) -> Booleans:
        """The states in which some robot is further than necessary to cover all markings: it has
        named a transition, or is acting before it asks the policy."""
        found = np.zeros(len(self.space), dtype=bool)
        for name in self._net.resting:
            found |= self.space.column(self._net.net.place_number(name)) > 0
        return found

    def _start(self, size: int, robots: Indices) -> int:
        """The initial state of a team of this size."""
        if size == int(robots[0]):
            return 0
        if len(self._largest.robots) < size:  # only the net says where they are
            return int(np.flatnonzero(robots == size)[0])
        net = self._largest.for_robots(size).net
        marking = self._net.start(net.initial_marking)
        state = self.space.find(marking)
        return int(np.flatnonzero(robots == size)[0]) if state is None else state

    def _team(self, size: int, states: Booleans, start: int) -> SizedTeam:
        built = self.built
        part, kept, rows = part_of(built.automaton, states, ((start, 1.0),))
        original = built.original[kept]
        occurs = np.zeros(len(self.space), dtype=bool)
        occurs[original] = True
        distinct = self._markings_of(np.flatnonzero(occurs))
        marking_of = (np.cumsum(occurs) - 1)[original]
        if self._doing_places:
            first, of = distinct_rows(distinct)
            distinct, marking_of = distinct[first], of[marking_of]
        stage = self.stages.stage[original]
        twin = kept >= len(self.space)
        return SizedTeam(
            size,
            part,
            distinct,
            marking_of,
            twin,
            (stage == Stage.DECIDED) & ~twin,
            built.allowed[rows],
            kept,
            rows,
            self,
        )

    # -- queries -----------------------------------------------------------------------------

    def enabled(self, team: SizedTeam, t: int) -> Booleans:
        """Boolean array: which of the team's distinct markings enable transition number ``t`` of
        the plan's net."""
        return enabled_in(self.plan.net, t, team.distinct.T.__getitem__, len(team.distinct))

    def rewards(self, team: SizedTeam, objective: Objective) -> Rewards:
        """The rewards of a run in a team's automaton.

        :raises UsageError: the net has no such place or transition, or a reward is on a counter.
        :raises RefusedError: a reward is earned on a cycle that takes no time.
        """
        return self.earnings(team, objective.rewards)

    def earnings(self, team: SizedTeam, rewards: Mapping[str, float]) -> Rewards:
        """The same for a map from places (per token and second) and transitions (per firing)."""
        net, automaton = self.plan.net, team.automaton
        per_state = np.zeros(len(team.distinct), dtype=np.float64)
        per_firing = np.zeros(len(net.transitions) + 1, dtype=np.float64)
        for name, value in rewards.items():
            if name in net.place_index:
                if name in self.left_out:
                    raise UsageError(
                        "'%s' only counts and grows without bound, so its tokens cannot be rewarded"
                        % name,
                        hint="reward the transition that counts",
                    )
                per_state += value * team.distinct[:, net.place_index[name]]
            elif name in net.transition_index:
                per_firing[net.transition_index[name]] += value
            else:
                raise UsageError("the net has no place or transition '%s'" % name)
        impulse = per_firing[automaton.fired]
        self._check_timeless(team, impulse)
        return Rewards(per_state[team.marking_of], impulse)

    def _check_timeless(self, team: SizedTeam, impulse: Floats) -> None:
        """:raises RefusedError: a reward is earned on a cycle that takes no time."""
        automaton = team.automaton
        if not impulse.any():
            return
        rows = automaton.arc_rows
        sources = automaton.row_states[rows]
        timeless = ~automaton.tangible[sources] & ~automaton.tangible[automaton.targets]
        timeless &= self.allowed(team)[rows]
        if not (impulse[timeless] != 0).any():
            return
        cycles = components(len(automaton), sources[timeless], automaton.targets[timeless]).of
        wrong = np.flatnonzero(
            timeless & (impulse != 0) & (cycles[sources] == cycles[automaton.targets])
        )
        if len(wrong):
            arc = int(wrong[0])
            name = self.plan.net.transitions[automaton.fired[arc]].name
            raise RefusedError(
                "it has a reward, but can fire forever in zero time at %s"
                % self.named(team, int(sources[arc])),
                element=name,
                hint="reward something that takes time",
            )

    def rate_labels(self, team: SizedTeam) -> Indices:
        """int array over the arcs of a team: the number of the plan's transition whose rate that of
        the arc is proportional to; -1: none, as where the plan gives a duration."""
        arcs = self.built.automaton.arcs
        return self.built.rated[flat_ranges(arcs[team.rows_in], arcs[team.rows_in + 1])]

    def goal(self, team: SizedTeam, condition: str) -> Booleans:
        """The states of a team in which a condition holds.

        :raises ExpressionError: it cannot be parsed.
        :raises UsageError: it uses a counter that the model leaves out.
        """
        parsed = parse_condition(condition, self.plan.net.place_index)
        unknown = [p for p in self.left_out if p in parsed.places]
        if unknown:
            raise UsageError(
                "'%s' only counts and was omitted" % unknown[0],
                hint="announce the condition in advance",
            )
        holds = parsed.holds_in_columns(team.distinct.astype(np.int64).T, len(team.distinct))
        return np.asarray(holds[team.marking_of], dtype=bool)

    def allowed(self, team: SizedTeam) -> Booleans:
        """The rows of a team that a policy may choose: forbidden conditions are taken into
        account."""
        if self.safety is None:
            return team.by_policy
        safe = self.safety.safe[self.built.original[team.states_in]]
        automaton = team.automaton
        wrong = np.zeros(len(automaton.choices), dtype=bool)
        wrong[automaton.arc_rows[~safe[automaton.targets]]] = True
        chosen = automaton.choices != CHANCE
        unsafe_state = ~safe[automaton.row_states]
        return team.by_policy & (~wrong | ~chosen | unsafe_state)

    def _judge(self, never: Sequence[str]) -> Safety:
        waits = self.built.wait_row >= 0
        waits[waits] = self.built.allowed[self.built.wait_row[waits]]
        return Safety(self._largest, self.stages, never, waits)

    # -- policies ----------------------------------------------------------------------------------

    def _play(self, policy: Policy) -> Play:
        found = self._plays.get(policy)
        if found is None:
            answers = answers_of(self._largest, policy, self.stages)
            found = play_answers(self._largest, answers, self.stages, not self._run_net.classical)
            self._plays = {policy: found}
        return found

    def weights_of(self, team: SizedTeam, policy: Policy) -> Floats:
        """The probability of each row under a policy, according to the plan's rules.

        :raises RefusedError: the rows do not determine what the policy does.
        """
        self._check_chosen(policy, self.found)
        return self._weights(team, self._play(policy))

    def weights_of_decided(
        self, team: SizedTeam, kind: Indices, kinds: Sequence[Mapping[int, float]]
    ) -> Floats:
        """The probability of each row under decisions.

        :param kind: int array: for each of the team's distinct markings the number of its decision;
          -1: none.
        :param kinds: the decisions: transition -> probability.
        :raises RefusedError: the rows do not determine what the decisions do.
        """
        of_state = np.full(len(self.space), -1, dtype=np.int64)
        mine = np.flatnonzero(~team.twin)
        of_state[team.states_in[mine]] = kind[team.marking_of[mine]]
        answers = DecidedAnswers(self.plan, of_state, kinds)
        return self._weights(
            team, play_answers(self.plan, answers, self.stages, not self._run_net.classical)
        )

    def _weights(self, team: SizedTeam, played: Play) -> Floats:
        built, stages = self.built, self.stages
        weights = np.zeros(len(built.automaton.choices), dtype=np.float64)
        states = np.flatnonzero(np.diff(built.automaton.rows) == 1)
        weights[built.automaton.rows[states]] = 1.0
        arcs = np.flatnonzero(built.arc_row >= 0)
        weights[built.arc_row[arcs]] = played.shares[arcs]
        waiting = np.flatnonzero(played.waits > ROUNDING)
        waiting = waiting[np.isin(stages.stage[waiting], (Stage.NAMED, Stage.DECIDED))]
        unheard = np.zeros(len(built.original), dtype=bool)
        lost = waiting[built.wait_row[waiting] < 0]
        lost = lost[np.diff(built.automaton.rows)[lost] > 1]
        unheard[lost] = True
        heard = waiting[built.wait_row[waiting] >= 0]
        weights[built.wait_row[heard]] = played.waits[heard]
        single = states[states < len(stages)]
        single = single[stages.stage[single] == Stage.DECIDED]
        unheard[single[played.waits[single] > ROUNDING]] = True
        mine = weights[team.rows_in]
        self._check_heard(team, mine, unheard, played)
        return mine

    def _check_heard(
        self, team: SizedTeam, weights: Floats, unheard: Booleans, played: Play
    ) -> None:
        """Check the policy. :raises RefusedError: it leads to a state in which its rows do not
        determine what it does."""
        wrong = unheard.copy()
        wrong[: len(played.unsettled)] |= played.unsettled
        wrong = wrong[team.states_in]
        if not wrong.any():
            return
        automaton = team.automaton
        taken = weights[automaton.arc_rows] > 0
        reached = reachable_from(
            len(automaton),
            automaton.row_states[automaton.arc_rows][taken],
            automaton.targets[taken],
            np.array([s for s, _ in automaton.initial]),
        )
        states = np.flatnonzero(reached & wrong)
        if not len(states):
            return
        state = int(states[0])
        if unheard[team.states_in[state]]:
            raise RefusedError(
                "the policy lets robots wait at %s, which is not among the choices"
                % self.named(team, state),
                hint="name the place with --may-wait",
            )
        raise RefusedError(
            "what the policy does at %s depends on what robots have drawn before"
            % self.named(team, state),
            hint="gspn analyse and gspn simulate take that into account",
        )

    def _check_chosen(self, policy: Policy, found: Mapping[str, Decider]) -> None:
        """:raises RefusedError: the policy chooses what chance never does."""
        for row in policy.rows:
            for name, chance in row.choices:
                t = self.plan.net.transition_number(name)
                for p, _ in self.plan.net.inputs[t]:
                    decider = found.get(self.plan.net.places[p].name)
                    if (
                        chance > 0
                        and decider is not None
                        and not decider.policy
                        and t not in {u for u, _ in decider.chances}
                    ):
                        raise RefusedError(
                            "a row of the policy chooses it, but chance decides in %s and never "
                            "does: %s" % (self.plan.net.places[p].name, decider.reason),
                            element=name,
                        )

    # -- for people --------------------------------------------------------------------------------

    def named(self, team: SizedTeam, state: int) -> str:
        """The marking of a state, for messages."""
        counts = team.distinct[team.marking_of[state]].tolist()
        return "(%s)" % ", ".join(
            "%s: %d" % (place.name, n) for place, n in zip(self.plan.net.places, counts) if n
        )


def _left_out(plan: Plan, conditions: Sequence[str]) -> Tuple[str, ...]:
    """Counters that nothing reads, and no condition either."""
    read: Set[str] = set()
    for condition in conditions:
        read.update(parse_condition(condition, plan.net.place_index).places)
    return tuple(name for name in plan.counters if name not in read)
