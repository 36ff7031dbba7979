"""What happens in a marking of a net, one marking at a time, for simulation, which does not visit
all of them."""

from __future__ import annotations

from typing import List, Optional, Tuple

from gspn_framework_package.analysis.plan.rules import Branch
from gspn_framework_package.model.condition import Condition
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.net import Marking, Net


class NetRules:
    """The rules of a net, in the form of
    :class:`~gspn_framework_package.analysis.plan.rules.PlanRules`."""

    def __init__(self, net: Net, until: Optional[Condition] = None) -> None:
        self.net = net
        self._until = until

    def is_over(self, marking: Marking) -> bool:
        """Whether the condition that ends the run holds."""
        if self._until is None:
            return False
        labels = {"deadlock": not self.net.enabled(marking)} if self._until.labels else {}
        return self._until.holds(marking, labels)

    def timed(self, marking: Marking) -> List[Tuple[int, float]]:
        """The enabled exponential transitions, with their rates (1/s)."""
        net = self.net
        return [
            (t, net.effective_rate(marking, t))
            for t in net.enabled(marking)
            if net.transitions[t].timed
        ]

    def outcomes(self, marking: Marking) -> List[Branch]:
        """The enabled immediate transitions of the highest priority, with their probabilities.

        :raises RefusedError: no weight decides a choice.
        """
        transitions = self.net.transitions
        enabled = [t for t in self.net.enabled(marking) if not transitions[t].timed]
        if len(enabled) > 1 and any(transitions[t].weight == 0 for t in enabled):
            raise RefusedError(
                "no weight decides between %s" % ", ".join(transitions[t].name for t in enabled),
                hint="give them weights, or take a plan with a policy",
            )
        total = sum(transitions[t].weight for t in enabled) or 1.0
        return [
            Branch(t, transitions[t].weight / total if len(enabled) > 1 else 1.0) for t in enabled
        ]
