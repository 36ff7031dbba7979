"""The request for a policy: the aim, its constraints and the interpretation of the plan."""

from __future__ import annotations

import enum
import fnmatch
import math
from dataclasses import dataclass, field, replace
from typing import Dict, FrozenSet, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.plan.reading import RUN
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net

AIM_WIDTH = 1e-6
"""Default width of the certified interval, relative to its value."""

NARROWEST = 1e-12
"""Smallest width that can be requested: rounding errors are not much smaller."""

_LISTED = 6
"""Largest number of rewards in the description of an objective."""


class Aim(enum.Enum):
    """The kinds of aims."""

    LONG_RUN = "long_run"
    """The average reward per second in the long run."""
    TIME_TO = "time_to"
    """The mean time (s) until a condition holds; it is minimised."""
    COST_TO = "cost_to"
    """The mean cost until a condition holds; it is minimised."""
    REACH = "reach"
    """The probability that a condition ever holds."""
    DISCOUNTED = "discounted"
    """The sum of the rewards, each discounted by exp(-discount * time)."""


@dataclass(frozen=True)
class Objective:
    """An aim.

    :ivar aim: its kind.
    :ivar rewards: place -> reward per token and second, or transition -> reward per firing;
      negative values are costs. For COST_TO they are costs.
    :ivar goal: the condition of TIME_TO, COST_TO and REACH.
    :ivar discount: the rate (1/s) of DISCOUNTED.
    :ivar maximise: whether more is better.
    """

    aim: Aim
    rewards: Mapping[str, float] = field(default_factory=dict)
    goal: Optional[str] = None
    discount: Optional[float] = None
    maximise: bool = True

    @classmethod
    def long_run(cls, rewards: Mapping[str, float]) -> Objective:
        """The highest average reward per second."""
        return cls(Aim.LONG_RUN, rewards)

    @classmethod
    def time_to(cls, goal: str) -> Objective:
        """The least mean time until ``goal`` holds."""
        return cls(Aim.TIME_TO, goal=goal, maximise=False)

    @classmethod
    def cost_to(cls, goal: str, costs: Mapping[str, float]) -> Objective:
        """The least mean cost until ``goal`` holds."""
        return cls(Aim.COST_TO, costs, goal=goal, maximise=False)

    @classmethod
    def reach(cls, goal: str) -> Objective:
        """The highest probability that ``goal`` ever holds."""
        return cls(Aim.REACH, goal=goal)

    @classmethod
    def discounted(cls, rewards: Mapping[str, float], discount: float) -> Objective:
        """The highest discounted reward."""
        return cls(Aim.DISCOUNTED, rewards, discount=discount)

    @property
    def unit(self) -> str:
        """The unit of its value, for people; empty if it has none."""
        return {Aim.LONG_RUN: "1/s", Aim.TIME_TO: "s"}.get(self.aim, "")

    def resolved(self, net: Net) -> Objective:
        """The objective with the patterns among its rewards replaced by the names in ``net`` that
        they match: ``*`` and ``?`` as in file names. A name of the net is never interpreted as a
        pattern.

        :raises UsageError: nothing matches a pattern.
        """
        names = [*(place.name for place in net.places), *(t.name for t in net.transitions)]
        rewards: Dict[str, float] = {}
        for pattern, value in self.rewards.items():
            for name in _matching(pattern, names):
                rewards[name] = value
        return replace(self, rewards=rewards)

    def describe(self) -> str:
        """The objective in words."""
        named = ["%s: %g" % item for item in self.rewards.items()]
        listed = ", ".join(named[:_LISTED])
        if len(named) > _LISTED:
            listed += " and %d more" % (len(named) - _LISTED)
        if self.aim is Aim.LONG_RUN:
            return "the highest reward per second in the long run (%s)" % listed
        if self.aim is Aim.TIME_TO:
            return "the shortest mean time until %s" % self.goal
        if self.aim is Aim.COST_TO:
            return "the least mean cost until %s (%s)" % (self.goal, listed)
        if self.aim is Aim.REACH:
            return "the highest probability that %s ever holds" % self.goal
        return "the highest reward (%s), discounted by %g per second" % (listed, self.discount or 0)


class AtLeast(NamedTuple):
    """A constraint on the long run: ``name`` is a place, with its mean tokens, or a transition,
    with its firings per second; ``bound`` is the least value."""

    name: str
    bound: float

    @classmethod
    def parse(cls, text: str) -> AtLeast:
        """Read ``NAME>=VALUE``. :raises UsageError: the text has another form."""
        name, sign, bound = text.rpartition(">=")
        try:
            value = float(bound)
        except ValueError:
            sign, value = "", 0.0
        if not sign or not name.strip():
            raise UsageError(
                "'%s' is not a constraint" % text, hint="write NAME>=VALUE, e.g. 'finish>=0.1'"
            )
        return cls(name.strip(), value)


@dataclass(frozen=True)
class Request:
    """Everything that a policy is computed from, except the plan.

    :ivar never: conditions that may never hold.
    :ivar at_least: constraints on the long run.
    :ivar may_wait: places in which a robot may wait although it could leave.
    :ivar reading: how time is interpreted: ``run`` or ``net``.
    :ivar fitted: whether to use the plan's ``durations``, ``outcomes`` and ``rates``, as learned
        from runs, rather than the nominal rates of the net's file.
    :ivar uncertain: transition -> lowest and highest rate (1/s): the policy is the best for the
      worst of them.
    :ivar team_sizes: the numbers of robots for which to compute choices; None: the plan's own, and
        the smaller ones after losses.
    :ivar width: width of the certified interval, relative to its value.
    :ivar limits: how far each part may go.
    """

    objective: Objective
    never: Tuple[str, ...] = ()
    at_least: Tuple[AtLeast, ...] = ()
    may_wait: FrozenSet[str] = frozenset()
    reading: str = RUN
    fitted: bool = True
    uncertain: Mapping[str, Tuple[float, float]] = field(default_factory=dict)
    team_sizes: Optional[Tuple[int, ...]] = None
    width: float = AIM_WIDTH
    limits: Limits = Limits()

    def resolved(self, net: Net) -> Request:
        """The request with its patterns replaced by the names in ``net`` that they match, in
        rewards (:meth:`Objective.resolved`) and in ``may_wait``.

        :raises UsageError: nothing matches a pattern; see also :meth:`check`.
        :raises ExpressionError: see :meth:`check`.
        """
        places = [place.name for place in net.places]
        deciding = [place for place, leaving in zip(places, net.immediate_from) if leaving]
        may_wait = {
            name
            for pattern in self.may_wait
            for name in ([pattern] if pattern in places else _matching(pattern, deciding))
        }
        found = replace(
            self,
            objective=self.objective.resolved(net),
            may_wait=frozenset(may_wait),
        )
        found.check(net)
        return found

    def check(self, net: Net) -> None:
        """Check that all names and conditions fit ``net``, and that the parts fit each other.

        :raises UsageError: a name is not in the net, or the request is invalid.
        :raises ExpressionError: a condition cannot be parsed.
        """
        objective = self.objective
        self._check_rewards(net)
        for condition in (*((objective.goal,) if objective.goal else ()), *self.never):
            parse_condition(condition, net.place_index)
        for name, bound in self.at_least:
            _known(net, name, "a constraint")
            if not math.isfinite(bound):
                raise UsageError("%g is not a bound of '%s'" % (bound, name))
        if self.at_least and objective.aim is not Aim.LONG_RUN:
            raise UsageError("constraints on the long run need a long-run aim", hint="give rewards")
        if self.at_least and self.uncertain:
            raise UsageError("constraints cannot be combined with uncertain rates")
        for place in self.may_wait:
            if place not in net.place_index:
                raise UsageError("a robot may wait in '%s', but there is no such place" % place)
        for name, (low, high) in self.uncertain.items():
            if name not in net.transition_index or not net.transition(name).timed:
                raise UsageError("'%s' is not an exponential transition" % name)
            if not 0 < low <= high < math.inf:
                raise UsageError("%g to %g is not an interval of rates" % (low, high), element=name)
        if not NARROWEST <= self.width < 1:
            raise UsageError("a width is from %g to below 1, not %g" % (NARROWEST, self.width))

    def _check_rewards(self, net: Net) -> None:
        objective = self.objective
        if objective.aim not in (Aim.TIME_TO, Aim.REACH) and not any(objective.rewards.values()):
            raise UsageError(
                "nothing is rewarded", hint="give a place or transition a reward or cost"
            )
        for name, value in objective.rewards.items():
            _known(net, name, "a reward")
            if not math.isfinite(value):
                raise UsageError("%g is not a reward of '%s'" % (value, name))
        if objective.aim is Aim.DISCOUNTED and not 0 < (objective.discount or 0) < math.inf:
            raise UsageError("a discount is a rate above 0, per second")


def _matching(pattern: str, names: Sequence[str]) -> List[str]:
    """The names that a pattern matches; the pattern itself if it is one of them, or no pattern."""
    if pattern in names or not set(pattern) & set("*?["):
        return [pattern]
    found = fnmatch.filter(names, pattern)
    if not found:
        raise UsageError("nothing in the net matches '%s'" % pattern)
    return found


def _known(net: Net, name: str, what: str) -> None:
    if name not in net.place_index and name not in net.transition_index:
        raise UsageError("%s names '%s', which is neither a place nor a transition" % (what, name))
