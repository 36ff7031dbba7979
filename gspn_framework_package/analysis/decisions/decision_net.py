"""The net of a decision problem: the plan's net, made such that the exploration of its markings
visits all states of the problem.

In the classical reading it is the plan's net itself. As the plan runs, an action place whose robots
must be distinguished keeps its place, with all robots in it, as inhibitor arcs, capacities,
conditions and policies see them. It gets a further place for each thing that such a robot can be up
to, which are columns of the run net: at an attempt at its action, done and naming a transition,
done and asking the policy, stuck. Every attempt is taken as exponential with its mean. A transition
of the plan may then occur several times, with robots from different ones of these places. An event
that interrupts takes robots from each of them.
"""

from __future__ import annotations

import enum
import itertools
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


class GroupMember(NamedTuple):
    """A transition of the decision net that robots of a group may ask for.

    :ivar transition: its number.
    :ivar weight: by chance, a robot asks for one of those that can fire, by these weights.
    :ivar partners: where the transition of the plan occurs several times for the group: the robots
      that it takes besides the one that asks, as triples (place, robots that are not free although
      they are there, robots that it takes). Each robot that is free is equally likely.
    """

    transition: int
    weight: Value
    partners: Tuple[Tuple[int, int, int], ...]


class Group(NamedTuple):
    """Robots whose requests are identical.

    :ivar step: the kind of the steps that they ask for.
    :ivar place: the place of the decision net that counts them.
    :ivar at: the number of their place in the plan's net.
    :ivar members: what they may ask for.
    :ivar named: whether the action named it, so that no policy is asked.
    """

    step: Stage
    place: int
    at: int
    members: Tuple[GroupMember, ...]
    named: bool


class _Parts(NamedTuple):
    """The places for the robots of one action place. A place that is not split is its own part.

    :ivar entry: where a robot that enters begins.
    :ivar of: column of the run net -> the place that counts its robots.
    :ivar racing: (transition, rate) of exponential transitions that race.
    """

    entry: str
    of: Mapping[int, str] = {}
    racing: Mapping[int, float] = {}


_Taken = Tuple[Tuple[str, int, bool], ...]
"""Robots that a transition takes from one place: (part, how many, whether they named it)."""

NO_COLUMN = -1
"""Stands for a column where the run net has none."""

_Partners = Tuple[Tuple[str, int, int], ...]
"""As :attr:`GroupMember.partners`, with names of places."""

_UNDRAWN = -2
"""Stands for a column: robots that are done on arrival, in one of several columns by chance."""


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
        self._groups: Dict[Tuple[Stage, str], List[Tuple[int, Value, _Partners]]] = {}
        self._at: Dict[str, int] = {}
        self.resting: List[str] = []
        self._stopped = self._place("(stopped)", -1) if run_net.stopped >= 0 else ""
        self._split: Dict[int, _Parts] = {
            p: self._lay_out(p) for p in range(len(self._source.places)) if run_net.acts[p]
        }
        for t in range(len(self._source.transitions)):
            self._add_transition(t)
        for p, parts in self._split.items():
            self._add_ends(p, parts)
        if losses:
            for p in self._split:
                self._add_losses(p)
        if self._stopped:
            self._arcs += [Arc(self._stopped, t.name, 1, True) for t in self._transitions]
        self.net = Net(self._places, self._transitions, self._arcs, self._source.name)
        number = self.net.place_index
        named = {
            self._split[p].of[column]
            for p, columns in run_net.columns.items()
            for column in columns.named.values()
            if column in self._split[p].of
        }
        self.groups = [
            Group(
                step,
                number[place],
                self._at[place],
                tuple(
                    GroupMember(t, weight, tuple((number[q], here, k) for q, here, k in partners))
                    for t, weight, partners in members
                ),
                place in named,
            )
            for (step, place), members in self._groups.items()
        ]
        self.place_of = [number.get(place.name, -1) for place in plan.net.places]

    def ended(self, space: StateSpace) -> Booleans:
        """Boolean array: the states of a space of this net in which a failure has stopped the team,
        or all robots are Inactive."""
        ended = np.zeros(len(space), dtype=bool)
        if self._stopped:
            ended |= space.column(self.net.place_index[self._stopped]) > 0
        if self._run_net.inactive:
            robots = np.zeros(len(space), dtype=np.int64)
            inactive = np.zeros(len(space), dtype=np.int64)
            for p, parts in self._split.items():
                name = self._source.places[p].name
                robots += space.column(self.net.place_index[name])
                if not self._source.consumers[p]:
                    columns = self._run_net.columns.get(p)
                    part = name if columns is None else parts.of[columns.inactive]
                    inactive += space.column(self.net.place_index[part])
            ended |= (inactive == robots) & (robots > 0)
        return ended

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
        ends = [end for found in columns.ends.values() for end in found]
        leads_on = any(end.request is not None or end.stops for end in ends)
        if columns.inactive == NO_COLUMN and ends and not leads_on:
            return _Parts(name)  # whatever happens there, its robots stay
        doing = [attempt.columns[0] for attempt in columns.attempts]
        if not doing and not columns.arriving and len(columns.entry) == 1:
            return _Parts(name, {columns.entry[0][0]: name})
        arriving = list(columns.arriving) or ([] if len(columns.entry) == 1 else [_UNDRAWN])
        of: Dict[int, str] = {}
        for column, part in (
            *(
                (c, "%s (attempt %d)" % (name, n) if n > 1 else "%s (doing)" % name)
                for n, c in enumerate(doing, 1)
            ),
            *((c, "%s (arriving)" % name) for c in arriving),
            (columns.asking, "%s (done)" % name),
            *(
                (c, "%s (done, wants %s)" % (name, self._source.transitions[t].name))
                for t, c in columns.named.items()
            ),
            (columns.stuck, "%s (stuck)" % name),
            (columns.inactive, "%s (inactive)" % name),
        ):
            if column != NO_COLUMN:
                of[column] = self._place(part, full)
        entry = of[columns.entry[0][0] if len(columns.entry) == 1 else _UNDRAWN]
        tokens = self._source.places[p].tokens
        number = next(i for i, place in enumerate(self._places) if place.name == entry)
        self._places[number] = self._places[number]._replace(tokens=tokens)
        # a robot that acts before it asks, or stops, has then completed its last step
        goes_on = columns.asking != NO_COLUMN or columns.inactive != NO_COLUMN
        early = [*doing[0 if goes_on else 1 :], *arriving, *columns.named.values()]
        self.resting += [of[column] for column in early]
        if columns.stuck != NO_COLUMN and (columns.outcomes or goes_on):
            self.resting.append(of[columns.stuck])
        return _Parts(entry, of)

    def _refuse_shared_clocks(self) -> None:
        """Refuse what the rates of this net cannot express: an event occurs for each robot
        separately, but the rate of a transition is limited by everything that it takes."""
        for t, p in self._events.items():
            others = [self._source.places[q].name for q, _ in self._source.inputs[t] if q != p]
            if others and self._plan.team_size > 1:
                raise RefusedError(
                    "it is an event that occurs for each robot separately, and also takes from %s"
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

    def _join_group(
        self, step: Stage, place: str, t: int, weight: Value, partners: _Partners = ()
    ) -> None:
        self._groups.setdefault((step, place), []).append((t, weight, partners))

    def _add_transition(self, t: int) -> None:
        """Add transition ``t`` of the plan's net, once for each way in which robots can ask for
        it."""
        transition = self._source.transitions[t]
        robots = self._run_net.robots_of[t]
        if not robots:
            step = Stage.TIMED if transition.timed else Stage.SPONTANEOUS
            self._fire(step, t, {})
            return
        if t in self._events:
            p = self._events[t]
            for part in self._pieces(p):
                self._fire(Stage.TIMED, t, {p: ((part, 1, False),)})
            if not self._named(p, t) and t not in self._split[p].racing:
                return  # no robot asks for it otherwise
        if t in self._races:
            self._fire(Stage.TIMED, t, {})
            return
        if transition.timed:
            self._add_exponential(t, robots)
            return
        if t in self._run_net.never:
            return
        takes = {taking.place: taking for taking in self._run_net.takes[t]}
        options: List[List[_Taken]] = []  # of each place
        for p, weight in robots:
            named = self._named(p, t) if takes[p].named != NO_COLUMN else ""
            asking = self._asking(p) if takes[p].at_policy else ""
            options.append(
                [
                    tuple(
                        taken
                        for taken in ((named, n, True), (asking, weight - n, False))
                        if taken[1]
                    )
                    for n in range(weight + 1)
                    if (named or not n) and (asking or n == weight)
                ]
            )
        ways = list(itertools.product(*options))
        for way in ways:
            self._add_way(t, dict(zip([p for p, _ in robots], way)), len(ways) > 1)

    def _add_way(self, t: int, way: Mapping[int, _Taken], one_of_several: bool) -> None:
        """Add immediate transition ``t`` with robots from these parts of their places."""
        asked = [(p, part, named) for p, taken in way.items() for part, _, named in taken]
        deciders = {p: self._deciders[self._source.places[p].name] for p, _, n in asked if not n}
        chances = {p: dict(d.chances) for p, d in deciders.items() if not d.policy}
        by_chance = any(named for _, _, named in asked) or any(t in c for c in chances.values())
        policy = [p for p, decider in deciders.items() if decider.policy]
        if not by_chance and not policy:
            return  # chance decides there, and never for this one
        askers = tuple(self._plan.net.place_number(self._source.places[p].name) for p in policy)
        number = self._fire(Stage.NAMED if by_chance else Stage.DECIDED, t, way, askers)
        for p, part, named in asked:
            partners: _Partners = ()
            if one_of_several:
                partners = tuple(
                    (other, int(other == part), n - (other == part))
                    for taken in way.values()
                    for other, n, _ in taken
                )
            if named:
                self._join_group(Stage.NAMED, part, number, 1.0, partners)
            elif p in policy:
                self._join_group(Stage.DECIDED, part, number, 1.0, partners)
            elif t in chances[p]:
                self._join_group(Stage.NAMED, part, number, chances[p][t], partners)

    def _pieces(self, p: int) -> Tuple[str, ...]:
        """The places for the robots of place ``p``, each in one of them."""
        return tuple(self._split[p].of.values()) or (self._source.places[p].name,)

    def _named(self, p: int, t: int) -> str:
        """The place for the robots of place ``p`` that are done and named ``t``; "": none."""
        columns = self._run_net.columns.get(p)
        return "" if columns is None else self._split[p].of.get(columns.named.get(t, NO_COLUMN), "")

    def _asking(self, p: int) -> str:
        """The place for the robots of place ``p`` that ask the policy."""
        return self._split[p].of[self._run_net.columns[p].asking]

    def _add_exponential(self, t: int, robots: Sequence[Tuple[int, int]]) -> None:
        racing = self._split[robots[0][0]].racing
        if len(robots) == 1 and racing:
            if t in racing:
                self._fire(Stage.TIMED, t, {}, rate=racing[t])
            return
        places = {p: self._named(p, t) for p, _ in robots}
        if not all(places.values()):
            return  # no robot ever asks for it
        taken = {p: ((places[p], w, True),) for p, w in robots}
        number = self._fire(Stage.ASKED, t, taken, priority=1)
        for place in places.values():
            self._join_group(Stage.ASKED, place, number, 1.0)

    def _fire(
        self,
        step: Stage,
        t: int,
        taken: Mapping[int, _Taken],
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
            (part, n)
            for p, parts in taken.items()
            for part, n, _ in parts
            if part != net.places[p].name
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
        names = [self._source.places[p].name for p, _ in self._run_net.robots_of[t]]
        return not any(p in self._plan.durations or p in self._plan.outcomes for p in names)

    def _add_ends(self, p: int, parts: _Parts) -> None:
        """Add the ends of attempts at the action of place ``p``."""
        columns = self._run_net.columns.get(p)
        if columns is None or not (columns.ends or _UNDRAWN in parts.of):
            return
        for attempt in columns.attempts:
            source = parts.of.get(attempt.columns[0])
            if not source:
                return  # whatever happens there, its robots stay
            mean = self._run_net.timing[p].duration.mean
            for end in columns.ends[attempt.columns[0]]:
                # a rate of the net makes failures come faster, too
                asked = [(POLICY if end.request is None else end.request, 1.0)]
                if end.failed and self._source.places[p].name not in self._plan.durations:
                    asked = list(columns.outcomes) or asked
                for t, share in asked:
                    self._end(
                        Stage.TIMED,
                        source,
                        parts.of[end.column],
                        rate=attempt.rates[0] * end.probability * share,
                        rated=t
                        if t != POLICY and self._by_net(t) and attempt.duration.mean == mean
                        else -1,
                        stops=end.stops,
                    )
        for column, source in parts.of.items():
            if column in columns.arriving:
                ends = [(e.column, e.probability, e.stops) for e in columns.ends[column]]
            elif column == _UNDRAWN:
                ends = [(c, v, False) for c, v in columns.entry]
            else:
                continue
            for target, chance, stops in ends:
                number = self._end(Stage.ARRIVED, source, parts.of[target], stops=stops)
                self._join_group(Stage.ARRIVED, source, number, chance)

    def _end(
        self,
        step: Stage,
        source: str,
        target: str,
        *,
        rate: float = 1.0,
        rated: int = -1,
        stops: bool,
    ) -> int:
        """Add an end of an attempt."""
        outputs = [(target, 1)] + ([(self._stopped, 1)] if stops else [])
        name = "(%s ends)" % source
        return self._add(step, name, -1, [(source, 1)], outputs, rate=rate, rated=rated)

    def _add_losses(self, p: int) -> None:
        name = self._source.places[p].name
        back = [
            (resource, count)
            for resource, count in self._plan.on_evict.get(name, {}).items()
            if resource not in self._run_net.counters and count > 0
        ]
        for part in self._pieces(p):
            inputs = [(name, 1)] + ([(part, 1)] if part != name else [])
            self._add(Stage.LOST, "(robot lost in %s)" % part, -1, inputs, back)
