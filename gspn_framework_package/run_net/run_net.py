"""A run net: the columns in which the robots of a plan are, and what takes them from one to the
next.

A state counts the robots in each column and the tokens of the resource places. What changes it are

* *races*: exponential transitions at the rates that the marking gives them: those of the
  environment, and in the classical reading all of them;
* *phases* of actions, which end at their rates, and *racing* robots, whose action and exponential
  transitions are the same clock (``compiling``);
* *interrupts*: events that come to each robot of a place;
* in zero time, in the order of ``steps``: *spontaneous* transitions, which only take resources,
  and the transitions for which robots that are done ask.

Enabled is what the marking enables, and the marking counts all robots of a place, whichever column
they are in: inhibitor arcs, capacities, rows of the policy and ``until`` see the same marking as in
the run.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from functools import cached_property
from typing import List, Mapping, Sequence, Set, Tuple

from gspn_framework_package.model.net import Marking
from gspn_framework_package.model.plan_timing import PlaceVisit, PlanRules
from gspn_framework_package.run_net.columns import (
    EventClock,
    PlaceColumns,
    Race,
    Racing,
    Shares,
    Taking,
)
from gspn_framework_package.run_net.requests import PolicyDraws

State = Tuple[int, ...]
"""The robots in each column, and the tokens of the resource places."""


@dataclass(frozen=True)
class RunNet(PlanRules):
    """A plan, compiled (``compiling.compile_plan``): the rules, and the columns made of them.

    :ivar timing: action place -> what every robot does there; empty in the classical reading.
    :ivar draws: what robots at the policy draw from.
    :ivar columns: the columns of each place that is split.
    :ivar whole: the column of each other place.
    :ivar parts: the columns of each place: from, to.
    :ivar stopped: the column that counts whether a failure has stopped the team; -1: none can.
    :ivar inactive: the columns of robots that are Inactive; empty where it makes no difference that
        a run ends when all are.
    :ivar begin: the states that a run begins in, with probabilities.
    :ivar racing: the places that are not split although actions there take time.
    :ivar interrupts: the events that interrupt robots.
    :ivar races: exponential transitions with rates by the marking.
    :ivar takes: for each transition the robots that it takes where one asks for it, by place.
    :ivar never: the transitions for which no robot can ever ask: one of those that they need is
        always doing.
    :ivar moves: for each transition the columns whose counts its firing changes for certain: pairs
        (column, change). Robots that it takes from split places are not among them.
    :ivar spreads: for each transition the robots that it puts into columns by chance: pairs
        (columns with probabilities, robots).
    :ivar keeps_draws: whether a transition moves robots in zero time without ending draws, so that
        every draw has to be known.
    :ivar watching: for a place in which robots get done, the places in which that can change what
        others may draw.
    :ivar splits: place -> why doing and done are distinguished there.
    :ivar assumptions: what had to be assumed: sentences for people.
    """

    timing: Mapping[int, PlaceVisit]
    draws: PolicyDraws
    columns: Mapping[int, PlaceColumns]
    whole: Mapping[int, int]
    parts: Sequence[Tuple[int, int]]
    stopped: int
    inactive: Tuple[int, ...]
    begin: Sequence[Tuple[State, float]]
    racing: Sequence[Racing]
    interrupts: Sequence[EventClock]
    races: Sequence[Race]
    takes: Sequence[Tuple[Taking, ...]]
    never: Set[int]
    moves: Sequence[Sequence[Tuple[int, int]]]
    spreads: Sequence[Sequence[Tuple[Shares, int]]]
    keeps_draws: bool
    watching: Mapping[int, Sequence[int]]
    splits: Mapping[str, str] = field(default_factory=dict)
    assumptions: Sequence[str] = ()

    @property
    def width(self) -> int:
        """The number of columns."""
        return self.parts[-1][1] if self.parts else 0

    @property
    def first_columns(self) -> List[int]:
        """The first column of each place."""
        return [first for first, _ in self.parts]

    @property
    def named_columns(self) -> List[Tuple[int, str]]:
        """The columns of the places that are split, with names for people."""
        return [named for p, c in self.columns.items() for named in c.named_for_people(self.net, p)]

    def marking(self, state: State) -> Marking:
        """The marking of a state: all robots of each place."""
        counts = [0] * (len(self.parts) + 1)
        places = self._place_of
        for column in itertools.compress(range(len(state)), state):
            counts[places[column]] += state[column]
        return tuple(counts[:-1])

    @cached_property
    def _place_of(self) -> List[int]:
        """The place of each column; ``stopped`` has none, which is one more than there are."""
        places = [len(self.parts)] * self.width
        for p, (first, end) in enumerate(self.parts):
            places[first:end] = [p] * (end - first)
        return places

    def is_over(self, marking: Marking) -> bool:
        """Whether ``until`` holds, so that the run ends."""
        return self.until is not None and self.until.holds(marking)

    def has_ended(self, state: State, marking: Marking) -> bool:
        """Whether the run has ended in a state, which has this marking."""
        if self.stopped >= 0 and state[self.stopped] > 0:
            return True
        robots = [state[column] for column in self.inactive]
        if any(robots) and sum(robots) == sum(n for n, acts in zip(marking, self.acts) if acts):
            return True
        return self.is_over(marking)
