"""The net of a decision problem: the plan's net, made such that the exploration of its markings
visits all states of the problem.

In the classical reading it is the plan's net itself. As the plan runs, an action place whose robots
must be distinguished keeps its place, with all robots in it, as inhibitor arcs, capacities,
conditions and policies see them. It gets a further place for each thing that such a robot can be up
to: doing its action, done and naming a transition, done and asking the policy. Every duration is
taken as exponential with its mean. A transition of the plan may then occur several times, with
robots from different ones of these places. An event that interrupts takes robots from each of them.
"""

from __future__ import annotations

import enum
from typing import Dict, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans
from gspn_framework_package.analysis.decisions.who_decides import Decider
from gspn_framework_package.analysis.state_space.space import StateSpace
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.marking_function import Value
from gspn_framework_package.model.net import Arc, Net, Place, Transition
from gspn_framework_package.model.plan_timing import POLICY
from gspn_framework_package.run_net.run_net import RunNet


class Stage(enum.IntEnum):
    """The kinds of steps, in the order in which they happen in zero time."""

    SPONTANEOUS = 0
    """Immediate transitions that only take resources."""
    NAMED = 1
    """Immediate transitions that the action names, or that chance chooses."""
    DECIDED = 2
    """Immediate transitions that the policy chooses."""
    ASKED = 3
    """Exponential transitions that robots which are done ask for."""
    ARRIVED = 4
    """The end of an action that takes no time."""
    TIMED = 5
    """What takes time."""
    LOST = 6
    """The loss of a robot."""


class Group(NamedTuple):
    """Robots that ask alike.

    :ivar step: the kind of the steps that they ask for.
    :ivar place: the place of the decision net that counts them.
    :ivar at: the number of their place in the plan's net.
    :ivar members: transitions of the decision net with weights; by chance, a robot asks for one of
      those that can fire. Where the policy decides, the weights are those of the net.
    :ivar named: whether the action named the only member, so that no policy is asked.
    """

    step: Stage
    place: int
    at: int
    members: Tuple[Tuple[int, float], ...]
    named: bool


class _Parts(NamedTuple):
    """The places for the robots of one action place. A place that is not split is its own part.

    :ivar entry: where a robot that enters begins.
    :ivar doing: it is doing its action; empty: that takes no time.
    :ivar asking: it is done and asks the policy.
    :ivar named: transition -> it is done and named that one.
    :ivar arriving: it has an action that takes no time, and has yet to name what comes next.
    :ivar racing: (transition, rate) of exponential transitions that race.
    """

    entry: str
    doing: str = ""
    asking: str = ""
    named: Mapping[int, str] = {}
    arriving: str = ""
    racing: Mapping[int, float] = {}

    @property
    def pieces(self) -> Tuple[str, ...]:
        """All of them, if the place is split."""
        found = (self.doing, self.arriving, self.asking, *self.named.values())
        return tuple(part for part in found if part)


class DecisionNet:
    """The net of a decision problem.

    :param run_net: the plan, compiled with exponential durations.
    :param deciders: who decides, from :func:`who_decides`.
    :param losses: whether robots can be lost.
    :raises RefusedError: a team move mixes robots in a way that this net cannot express.

    :ivar net: the net; its place numbers are those of ``places``.
    :ivar steps: the kind of each transition.
    :ivar labels: what each transition is called, for people.
    :ivar origins: for each transition its number in the plan's net; -1 if it has none there.
    :ivar rated: for each transition the number (plan's net) of the one whose rate its own is
      proportional to; -1 if there is none.
    :ivar askers: for each transition the numbers (plan's net) of the places whose robots ask the
      policy for it.
    :ivar groups: the robots that ask, by kind.
    :ivar place_of: for each place of the plan's net its number in this one; -1: left out.
    :ivar resting: places of this net in which no robot is if it is as far as it can be without
      time passing and without naming anything; for the choice of typical states.
    """

    def __init__(
        self,
        run_net: RunNet,
        deciders: Mapping[str, Decider],
        *,
        losses: bool,
    ) -> None:
        self._run_net = run_net
        self._plan = plan = run_net.plan
        self._deciders = deciders
        self._source = run_net.net
        self._acts = run_net.acts
        self._source.require_numbers(
            "the computation of a policy",
            [
                t
                for t, transition in enumerate(self._source.transitions)
                if not transition.timed and t not in run_net.spontaneous
            ],
        )
        self._events = run_net.interrupted
        self._races = {race.transition for race in run_net.races}
        self._racing = {racing.column: dict(racing.rates) for racing in run_net.racing}
        self._refuse_shared_clocks()
        self._taken: Set[str] = set(plan.net.place_index)
        self.labels: List[str] = []
        self.rated: List[int] = []
        self._places: List[Place] = list(self._source.places)
        self._transitions: List[Transition] = []
        self._arcs: List[Arc] = []
        self.steps: List[Stage] = []
        self.origins: List[int] = []
        self.askers: List[Tuple[int, ...]] = []
        self._groups: Dict[Tuple[Stage, str], List[Tuple[int, float]]] = {}
        self._at: Dict[str, int] = {}
        self.resting: List[str] = []
        self._split: Dict[int, _Parts] = {
            p: self._lay_out(p) for p in range(len(self._source.places)) if self._acts[p]
        }
        for t in range(len(self._source.transitions)):
            self._add_transition(t)
        for p, parts in self._split.items():
            self._add_ends(p, parts)
        if losses:
            for p, parts in self._split.items():
                self._add_losses(p, parts)
        self.net = Net(self._places, self._transitions, self._arcs, self._source.name)
        number = self.net.place_index
        named = {part for parts in self._split.values() for part in parts.named.values()}
        self.groups = [
            Group(step, number[place], self._at[place], tuple(members), place in named)
            for (step, place), members in self._groups.items()
        ]
        self.place_of = [number.get(place.name, -1) for place in plan.net.places]

    def busy(self, space: StateSpace) -> Booleans:
        """Boolean array: the states of a space of this net in which a robot is not Inactive, or
        there is none; the run has ended in the others."""
        robots = np.zeros(len(space), dtype=np.int64)
        inactive = np.zeros(len(space), dtype=np.int64)
        for p, parts in self._split.items():
            here = space.column(self.net.place_index[self._source.places[p].name])
            robots += here
            if not self._source.consumers[p]:
                inactive += here
                if parts.doing:
                    inactive -= space.column(self.net.place_index[parts.doing])
        return (inactive < robots) | (robots == 0)

    def start(self, marking: Sequence[int]) -> Tuple[int, ...]:
        """The state in which a run with this initial marking (of the plan's net) begins."""
        counts = [0] * len(self.net.places)
        for p, n in enumerate(marking):
            if self.place_of[p] >= 0:
                counts[self.place_of[p]] = n
        for p, parts in self._split.items():
            name = self._source.places[p].name
            if parts.entry != name:
                counts[self.net.place_index[parts.entry]] = counts[self.net.place_index[name]]
        return tuple(counts)

    # -- places ------------------------------------------------------------------------------------

    def _lay_out(self, p: int) -> _Parts:
        name = self._source.places[p].name
        full = self._plan.net.place_number(name)
        self._at[name] = full
        columns = self._run_net.columns.get(p)
        if columns is None:
            return _Parts(name, racing=self._racing.get(self._run_net.whole[p], {}))
        if not columns.outcomes and columns.inactive < 0:
            return _Parts(name)
        outcomes = [t for t, _ in columns.outcomes]
        takes_time = bool(columns.attempts)
        # an action that takes no time ends when all others have moved that can
        arrives = not takes_time and (bool(columns.arriving) or len(outcomes) > 1)
        if not takes_time and not arrives:
            if outcomes == [POLICY]:
                return _Parts(name, asking=name)
            return _Parts(name, named={outcomes[0]: name})
        doing = self._place("%s (doing)" % name, full) if takes_time else ""
        arriving = self._place("%s (arriving)" % name, full) if arrives else ""
        asking = self._place("%s (done)" % name, full) if POLICY in outcomes else ""
        named = {
            t: self._place("%s (done, wants %s)" % (name, self._source.transitions[t].name), full)
            for t in outcomes
            if t != POLICY
        }
        entry = doing or arriving
        tokens = self._source.places[p].tokens
        number = next(i for i, place in enumerate(self._places) if place.name == entry)
        self._places[number] = self._places[number]._replace(tokens=tokens)
        self.resting += named.values()
        if arriving:
            self.resting.append(arriving)
        elif asking or not outcomes:
            self.resting.append(doing)
        return _Parts(entry, doing, asking, named, arriving)

    def _refuse_shared_clocks(self) -> None:
        """Refuse what the rates of this net cannot say: an event comes to each robot by itself, but
        the rate of a transition is limited by all that it takes."""
        for t, p in self._events.items():
            others = [self._source.places[q].name for q, _ in self._source.inputs[t] if q != p]
            if others and self._plan.team_size > 1:
                raise RefusedError(
                    "it is an event that comes to each robot by itself, and also takes from %s"
                    % ", ".join(others),
                    element=self._source.transitions[t].name,
                    hint="for the computation of a policy, let the event lead to a place of its "
                    "own, in which the robot waits for that",
                )

    def _place(self, name: str, at: int) -> str:
        name = self._unused(name)
        self._places.append(Place(name))
        self._at[name] = at
        return name

    def _unused(self, name: str) -> str:
        while name in self._taken:
            name += "'"
        self._taken.add(name)
        return name

    # -- transitions -------------------------------------------------------------------------------

    def _add(
        self,
        step: Stage,
        name: str,
        origin: int,
        inputs: Sequence[Tuple[str, int]],
        outputs: Sequence[Tuple[str, int]],
        *,
        inhibitors: Sequence[Tuple[str, int]] = (),
        rate: Value = 1.0,
        servers: Optional[int] = None,
        weight: Value = 1.0,
        priority: int = 1,
        askers: Tuple[int, ...] = (),
        rated: int = -1,
    ) -> int:
        unique = self._unused(name)
        self.labels.append(name)
        timed = step is Stage.TIMED
        self._transitions.append(Transition(unique, timed, rate, weight, priority, servers))
        self._arcs += [Arc(place, unique, w) for place, w in inputs]
        self._arcs += [Arc(unique, place, w) for place, w in outputs]
        self._arcs += [Arc(place, unique, w, True) for place, w in inhibitors]
        self.steps.append(step)
        self.origins.append(origin)
        self.askers.append(askers)
        self.rated.append(rated)
        return len(self._transitions) - 1

    def _join_group(self, step: Stage, place: str, t: int, weight: float) -> None:
        self._groups.setdefault((step, place), []).append((t, weight))

    def _add_transition(self, t: int) -> None:
        """Add transition ``t`` of the plan's net, once for each way in which robots can ask for
        it."""
        net = self._source
        transition = net.transitions[t]
        robots = [(p, w) for p, w in net.inputs[t] if self._acts[p]]
        if not robots:
            step = Stage.TIMED if transition.timed else Stage.SPONTANEOUS
            self._fire(step, t, {})
            return
        if t in self._events:
            parts = self._split[self._events[t]]
            for part in parts.pieces or (self._source.places[self._events[t]].name,):
                self._fire(Stage.TIMED, t, {self._events[t]: part})
            if t not in parts.named and t not in parts.racing:
                return  # no robot asks for it besides
        if t in self._races:
            self._fire(Stage.TIMED, t, {})
            return
        if transition.timed:
            self._add_exponential(t, robots)
            return
        if t in self._run_net.never:
            return
        options: List[List[Tuple[str, bool]]] = []  # of each place: (part, whether it was named)
        for taking in self._run_net.takes[t]:
            parts = self._split[taking.place]
            options.append(
                ([(parts.named[t], True)] if taking.named >= 0 else [])
                + ([(parts.asking, False)] if taking.at_policy else [])
            )
        if not all(options):
            return  # no robot ever asks for it
        ways = [tuple(option[0] for option in options)]
        if any(len(option) > 1 for option in options):
            if len(robots) > 1 or robots[0][1] > 1:
                raise RefusedError(
                    "some of the robots that it moves together may name it, others leave it to the "
                    "policy",
                    element=transition.name,
                    hint="let the outcomes of a place either name it always or never",
                )
            ways = [(option,) for option in options[0]]
        for way in ways:
            self._add_way(t, robots, way)

    def _add_way(
        self, t: int, robots: Sequence[Tuple[int, int]], way: Sequence[Tuple[str, bool]]
    ) -> None:
        """Add immediate transition ``t`` with robots from these parts of their places."""
        names = [self._source.places[p].name for p, _ in robots]
        chances = [
            {} if named else dict(self._chances(name)) for name, (_, named) in zip(names, way)
        ]
        by_chance = any(named for _, named in way) or any(t in chance for chance in chances)
        policy = [
            name
            for name, (_, named) in zip(names, way)
            if not named and self._deciders[name].policy
        ]
        if not by_chance and not policy:
            return  # chance decides there, and never for this one
        step = Stage.NAMED if by_chance else Stage.DECIDED
        places = {p: part for (p, _), (part, _) in zip(robots, way)}
        askers = tuple(self._plan.net.place_number(name) for name in policy)
        number = self._fire(step, t, places, askers)
        for (part, named), chance, name in zip(way, chances, names):
            if named:
                self._join_group(Stage.NAMED, part, number, 1.0)
            elif t in chance:
                self._join_group(Stage.NAMED, part, number, chance[t])
            elif self._deciders[name].policy:
                self._join_group(Stage.DECIDED, part, number, self._source.transitions[t].number)

    def _chances(self, name: str) -> Tuple[Tuple[int, float], ...]:
        decider = self._deciders[name]
        return () if decider.policy else decider.chances

    def _add_exponential(self, t: int, robots: Sequence[Tuple[int, int]]) -> None:
        parts = [self._split[p] for p, _ in robots]
        if len(robots) == 1 and parts[0].racing:
            if t in parts[0].racing:
                self._fire(Stage.TIMED, t, {}, rate=parts[0].racing[t])
            return
        if any(t not in part.named for part in parts):
            return  # no robot ever asks for it
        places = {p: part.named[t] for (p, _), part in zip(robots, parts)}
        number = self._fire(Stage.ASKED, t, places, priority=1)
        for place in places.values():
            self._join_group(Stage.ASKED, place, number, 1.0)

    def _fire(
        self,
        step: Stage,
        t: int,
        taken: Mapping[int, str],
        askers: Tuple[int, ...] = (),
        *,
        rate: Optional[float] = None,
        priority: Optional[int] = None,
    ) -> int:
        """Add transition ``t``, with robots from the parts ``taken`` of their places."""
        net = self._source
        transition = net.transitions[t]
        inputs = [(net.places[p].name, w) for p, w in net.inputs[t]]
        inputs += [
            (taken[p], w) for p, w in net.inputs[t] if p in taken and taken[p] != net.places[p].name
        ]
        outputs = [(net.places[p].name, w) for p, w in net.outputs[t]]
        outputs += [
            (self._split[p].entry, w)
            for p, w in net.outputs[t]
            if p in self._split and self._split[p].entry != net.places[p].name
        ]
        return self._add(
            step,
            transition.name,
            t,
            inputs,
            outputs,
            inhibitors=[(net.places[p].name, w) for p, w in net.inhibitors[t]],
            rate=transition.rate if rate is None else rate,
            servers=transition.servers,
            weight=transition.weight,
            priority=transition.priority if priority is None else priority,
            askers=askers,
            rated=t
            if transition.timed
            and step is Stage.TIMED
            and transition.function is None
            and (self._by_net(t) or (t in self._events and rate is None))
            else -1,
        )

    def _by_net(self, t: int) -> bool:
        """Whether the time until exponential transition ``t`` fires comes from its rate in the
        net."""
        if self._run_net.classical:
            return True
        names = [self._source.places[p].name for p, _ in self._source.inputs[t] if self._acts[p]]
        return not any(p in self._plan.durations or p in self._plan.outcomes for p in names)

    def _add_ends(self, p: int, parts: _Parts) -> None:
        """Add the ends of actions in place ``p``."""
        source = parts.doing or parts.arriving
        if not source:
            return
        columns = self._run_net.columns[p]
        step = Stage.TIMED if parts.doing else Stage.ARRIVED
        if not columns.outcomes:  # what follows is nothing
            rate = columns.attempts[0].rates[0]
            self._add(step, "(%s ends)" % source, -1, [(source, 1)], [], rate=rate)
        for t, v in columns.outcomes:
            number = self._add(
                step,
                "(%s ends)" % source,
                -1,
                [(source, 1)],
                [(parts.asking if t == POLICY else parts.named[t], 1)],
                rate=v * columns.attempts[0].rates[0] if parts.doing else 1.0,
                rated=t if parts.doing and t != POLICY and self._by_net(t) else -1,
            )
            if not parts.doing:
                self._join_group(step, source, number, v)

    def _add_losses(self, p: int, parts: _Parts) -> None:
        name = self._source.places[p].name
        back = [
            (resource, count)
            for resource, count in self._plan.on_evict.get(name, {}).items()
            if resource not in self._run_net.counters and count > 0
        ]
        for part in parts.pieces or (name,):
            inputs = [(name, 1)] + ([(part, 1)] if part != name else [])
            self._add(Stage.LOST, "(robot lost in %s)" % part, -1, inputs, back)
