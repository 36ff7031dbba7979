"""The offline simulator: which transition of a net fires next, and after how long (thesis 5.3).

A step is one firing. Among immediate transitions the weights decide (those of the highest priority
compete), among exponential ones their rates race; *firing probabilities* set by a user take
precedence over both. The firing rule is that of :class:`~gspn_framework_package.model.net.Net`.
"""

from __future__ import annotations

import math
import random
from typing import Iterable, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution.enabled_set import Change, EnabledSet
from gspn_framework_package.model.errors import NetError
from gspn_framework_package.model.net import Marking, Net


class Choice(NamedTuple):
    """A transition (index) that may fire next, and its probability."""

    transition: int
    probability: float


class SimulatedFiring(NamedTuple):
    """One step: ``transition`` (index) fires ``delay`` seconds after the previous step."""

    transition: int
    delay: float


class Simulator:
    """Plays the token game of a net.

    :param source: the random number generator; pass a seeded one to repeat a simulation.
    :param probabilities: transition (index) -> relative firing probability (>= 0) that replaces its
        rate or weight. It changes which transition fires, not how long that takes.
    :raises NetError: a probability is not a finite number of at least 0.

    >>> from gspn_framework_package.model.builder import NetBuilder
    >>> net = NetBuilder().place("a", 1).place("b").immediate("t", inputs="a", outputs="b").build()
    >>> simulator = Simulator(net)
    >>> simulator.step(), simulator.marking, simulator.step()
    (SimulatedFiring(transition=0, delay=0.0), (0, 1), None)
    """

    def __init__(
        self,
        net: Net,
        source: Optional[random.Random] = None,
        probabilities: Optional[Mapping[int, float]] = None,
    ) -> None:
        self.net = net
        self.random = source or random.Random()
        self.enabled = EnabledSet(net, net.initial_marking)
        self.change = Change((), ())
        """How the last move changed the set of enabled transitions."""
        self.probabilities: Mapping[int, float] = {}
        self.set_probabilities(probabilities or {})

    @property
    def marking(self) -> Marking:
        """The current marking."""
        return self.enabled.marking

    def set_probabilities(self, probabilities: Mapping[int, float]) -> None:
        """Replace the firing probabilities set by the user. :raises NetError: see the class."""
        for t, value in probabilities.items():
            if not (math.isfinite(value) and value >= 0):
                raise NetError(
                    "the firing probability %r is not a number of at least 0" % (value,),
                    element="transition '%s'" % self.net.transitions[t].name,
                )
        self.probabilities = dict(probabilities)

    def choices(self) -> List[Choice]:
        """The transitions that may fire next, each with its probability; empty in a dead
        marking."""
        weighted, total = self._weighted()
        return [Choice(t, weight / total) for t, weight in weighted if weight > 0]

    def next_firing(self) -> Optional[SimulatedFiring]:
        """Draw the next firing without firing it; None when nothing can fire."""
        weighted, total = self._weighted()
        if total <= 0:
            return None
        target = self.random.random() * total
        chosen = -1
        for t, weight in weighted:
            if weight <= 0:
                continue
            chosen = t
            target -= weight
            if target < 0:
                break
        return SimulatedFiring(chosen, self._delay(chosen))

    def step(self) -> Optional[SimulatedFiring]:
        """Draw a firing and fire it; None, with the marking unchanged, if nothing can fire."""
        firing = self.next_firing()
        if firing is not None:
            self.change = self.enabled.fire(firing.transition)
        return firing

    def fire(self, t: int) -> SimulatedFiring:
        """Fire a chosen transition (index), even one of lower priority than another enabled one.

        :raises NotEnabledError: the marking does not enable it.
        """
        delay = self._delay(t) if t in self.enabled.now else 0.0
        self.change = self.enabled.fire(t)
        return SimulatedFiring(t, delay)

    def move_to(self, marking: Sequence[int]) -> None:
        """Set another marking, to reset, step back or clear."""
        self.change = self.enabled.move_to(marking)

    def _weighted(self) -> Tuple[List[Tuple[int, float]], float]:
        enabled = sorted(self.enabled.now)
        weighted = [(t, self._weight(t)) for t in enabled]
        total = _sum(weight for _, weight in weighted)
        if math.isinf(total):  # only the ratios matter
            top = max(weight for _, weight in weighted)
            weighted = [
                (t, weight / top if math.isfinite(top) else float(weight == top))
                for t, weight in weighted
            ]
            total = _sum(weight for _, weight in weighted)
        if total <= 0 and not any(t in self.probabilities for t in enabled):
            # only transitions of weight 0, left to a policy: all equally probable
            weighted = [(t, 1.0) for t in enabled]
            total = float(len(enabled))
        return weighted, total

    def _weight(self, t: int) -> float:
        if t in self.probabilities:
            return self.probabilities[t]
        if self.net.transitions[t].timed:
            return self.net.effective_rate(self.marking, t)
        return self.net.value(self.marking, t)

    def _delay(self, t: int) -> float:
        """Draw the seconds until ``t`` wins the race of the enabled transitions; 0 for an immediate
        transition."""
        if not self.net.transitions[t].timed:
            return 0.0
        total = _sum(self.net.effective_rate(self.marking, u) for u in self.enabled.now)
        return self.random.expovariate(total)


def _sum(values: Iterable[float]) -> float:
    """The sum of numbers; infinite if it exceeds the range of a float."""
    try:
        return math.fsum(values)
    except OverflowError:
        return math.inf
