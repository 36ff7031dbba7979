"""The result of computing a policy, for scripts and for people."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional

from gspn_framework_package.analysis.decisions.aims import Request
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.errors import CancelledError, GspnError, LimitError
from gspn_framework_package.model.plan import Plan

MOST_CHOICES = 1_000
"""Largest number of choices that a report lists."""

_PLACES = 8
"""Largest number of places of a marking in the text."""

_LISTED = 8
"""Largest number of choices, and of sensitivities, in the text."""


class TeamResult(NamedTuple):
    """The answer for a team of ``robots`` robots: the number of ``states`` of its decision problem
    (None: too many), the ``value`` of the policy, and certified bounds of the best value; all None
    if there is none; ``why`` is the reason. If the policy was improved by simulation, the bounds
    are those of the 95 % confidence interval of its value."""

    robots: int
    states: Optional[int]
    value: Optional[float]
    lower: Optional[float]
    upper: Optional[float]
    why: str = ""


class ConstraintResult(NamedTuple):
    """A constraint: its ``name``, the ``value`` that the policy reaches, its ``bound``, and its
    ``price``: the gain in the aim if the bound were lower by 1. A forbidden condition has neither
    value nor bound; its price is the gain without it."""

    name: str
    value: Optional[float]
    bound: Optional[float]
    price: Optional[float]

    @property
    def kept(self) -> bool:
        """Whether the policy meets it, apart from rounding."""
        if self.value is None or self.bound is None:
            return True
        return self.value >= self.bound - 1e-6 * abs(self.bound)


class Sensitivity(NamedTuple):
    """How the value depends on the ``rate`` (1/s) of a transition: the ``derivative``, and the
    ``elasticity``, that is the relative change of the value per relative change of the rate."""

    transition: str
    rate: float
    derivative: float
    elasticity: Optional[float]


class MarkingChoice(NamedTuple):
    """What robots in ``place`` do in a ``marking`` (places with tokens only): transition ->
    probability under the present policy and under the best one; empty if they wait. ``loss`` is the
    cost of one such choice of the present policy, in units of the aim (None: unknown)."""

    marking: Mapping[str, int]
    place: str
    present: Mapping[str, float]
    best: Mapping[str, float]
    loss: Optional[float] = None


@dataclass
class Report:
    """A computed policy.

    :ivar request: what was asked.
    :ivar plan: the plan with the computed policy.
    :ivar present: the value of the present policy; None: unknown, with the reason in
        ``present_why``.
    :ivar teams: the plan's own team first.
    :ivar rows: rows of the computed policy.
    :ivar silent: pairs of a marking and a place where the policy does not decide, since robots in
        another place decide first.
    :ivar exact: whether the bounds are certified. If not, the policy was improved by simulation.
    :ivar choices: the choices in markings, at most :data:`MOST_CHOICES`; first those that differ
      between the two policies, the costliest of them first.
    :ivar choices_in_all: how many there are, and ``choices_that_differ`` of them.
    :ivar storm: the value of the best policy by Storm; None: not asked, or unknown.
    :ivar simulation: old and new plan, simulated as they run: JSON, with ``text`` for people.
    :ivar failures: what failed after the policy was found; ``undecided`` has it in words.
    """

    request: Request
    plan: Plan
    teams: List[TeamResult]
    rows: int
    silent: int = 0
    exact: bool = True
    present: Optional[float] = None
    present_why: str = ""
    constraints: List[ConstraintResult] = field(default_factory=list)
    sensitivities: List[Sensitivity] = field(default_factory=list)
    assumptions: List[str] = field(default_factory=list)
    undecided: List[str] = field(default_factory=list)
    choices: List[MarkingChoice] = field(default_factory=list)
    choices_in_all: int = 0
    choices_that_differ: int = 0
    storm: Optional[float] = None
    simulation: Optional[Dict[str, Any]] = None
    failures: List[GspnError] = field(default_factory=list)

    def add(self, what: str, compute: Callable[[], None]) -> None:
        """Add something to the answer; if that fails, earlier results stay, and ``what`` is listed
        as undecided.

        :raises CancelledError: it was cancelled.
        """
        try:
            compute()
        except CancelledError:
            raise
        except GspnError as error:
            failure = error
        except MemoryError:
            failure = LimitError("there is too little memory", hint="raise --limit-memory")
        else:
            return
        self.failures.append(failure)
        self.undecided.append("%s: %s" % (what, failure))

    @property
    def gain(self) -> Optional[float]:
        """How much better the computed policy is than the present one, relative to the latter."""
        value = self.teams[0].value
        if _finite(value) is None or not _finite(self.present):
            return None
        assert value is not None and self.present is not None
        gain = (value - self.present) / abs(self.present)
        return gain if self.request.objective.maximise else -gain

    def to_json(self) -> Dict[str, Any]:
        """As plain JSON values."""
        own = self.teams[0]
        objective = self.request.objective
        return {
            "objective": {
                "aim": objective.aim.value,
                "text": objective.describe(),
                "unit": objective.unit,
                "maximise": objective.maximise,
            },
            "exact": self.exact,
            "value": _finite(own.value),
            "lower": _finite(own.lower),
            "upper": _finite(own.upper),
            "present_policy": {"value": _finite(self.present), "why": self.present_why},
            "gain": self.gain,
            "teams": [
                {
                    **team._asdict(),
                    "value": _finite(team.value),
                    "lower": _finite(team.lower),
                    "upper": _finite(team.upper),
                }
                for team in self.teams
            ],
            "rows": self.rows,
            "silent": self.silent,
            "constraints": [constraint._asdict() for constraint in self.constraints],
            "sensitivities": [entry._asdict() for entry in self.sensitivities],
            "assumptions": self.assumptions,
            "undecided": self.undecided,
            "choices": [
                {**choice._asdict(), "marking": dict(choice.marking)}
                for choice in self.choices[:MOST_CHOICES]
            ],
            "choices_in_all": self.choices_in_all,
            "choices_that_differ": self.choices_that_differ,
            "storm": _finite(self.storm),
            "simulation": self.simulation,
            "plan": plan_to_json(self.plan),
        }

    def lines(self) -> List[str]:
        """The report as lines of text."""
        objective = self.request.objective
        lines = ["aim: %s" % objective.describe()]
        lines += self._values()
        lines += [_costs(constraint) for constraint in self.constraints]
        others = "; in %d cases robots in another place decide first" % self.silent
        rows = "%d row%s" % (self.rows, "" if self.rows == 1 else "s")
        lines.append("policy: " + rows + (others if self.silent else ""))
        lines += self._differences()
        lines += self._sensitive()
        if self.simulation is not None:
            lines.append("simulated as it runs: %s" % self.simulation["text"])
        lines += ["not decided: %s" % sentence for sentence in self.undecided]
        lines += ["assumed: %s" % sentence for sentence in self.assumptions]
        return lines

    def _values(self) -> List[str]:
        unit = " " + self.request.objective.unit if self.request.objective.unit else ""
        if self.present is None:
            lines = ["present policy: not known (%s)" % self.present_why]
        else:
            lines = ["present policy: %.9g%s" % (self.present, unit)]
        best = "best policy" if self.exact else "improved policy"
        for team in self.teams:
            who = best if team is self.teams[0] else "team of %d" % team.robots
            if team.value is None:
                lines.append("%s: none (%s)" % (who, team.why))
                continue
            text = "%s: %.9g%s" % (who, team.value, unit)
            if team.lower is not None and team.upper is not None:
                bounds = "the optimum is" if self.exact else "95 % interval:"
                digits = 12 if self.exact else 6
                text += ", %s from %.*g to %.*g" % (bounds, digits, team.lower, digits, team.upper)
            if team is self.teams[0] and self.gain is not None:
                text += ", %+.2f %%" % (100 * self.gain)
            if team.states is not None:
                text += " (%s states)" % format(team.states, ",")
            lines.append(text)
        if self.storm is not None:
            lines.append("by Storm: %.9g%s" % (self.storm, unit))
        return lines

    def _differences(self) -> List[str]:
        different = [choice for choice in self.choices if dict(choice.present) != dict(choice.best)]
        if not different:
            return []
        lines = ["where it differs from the present policy, the costliest first:"]
        for choice in different[:_LISTED]:
            lines.append(
                "  (%s) in %s: %s -> %s"
                % (_shown(choice), choice.place, _said(choice.present), _said(choice.best))
            )
        if self.choices_that_differ > _LISTED:
            lines.append("  and %d more" % (self.choices_that_differ - _LISTED))
        return lines

    def _sensitive(self) -> List[str]:
        known = [(e.transition, e.elasticity) for e in self.sensitivities if e.elasticity]
        if not known:
            return []
        known.sort(key=lambda item: -abs(item[1]))
        changes = ", ".join("%s %+.3g %%" % item for item in known[:_LISTED])
        return ["if a rate rises by 1 %%, the value changes by: %s" % changes]


def _finite(value: Optional[float]) -> Optional[float]:
    """The value for JSON, which has no infinite numbers."""
    return value if value is not None and math.isfinite(value) else None


def _costs(constraint: ConstraintResult) -> str:
    """A constraint and its price."""
    cost = "not known" if constraint.price is None else "%.6g" % constraint.price
    if constraint.value is None or constraint.bound is None:
        return "never %s: it costs %s" % (constraint.name, cost)
    kept = constraint.name, constraint.value, constraint.bound
    return "%s: %.9g, at least %g; it costs %s per unit" % (*kept, cost)


def _shown(choice: MarkingChoice) -> str:
    """The marking of a choice, cut if it is long."""
    shown = ["%s: %d" % item for item in choice.marking.items()]
    more = ["and %d more" % (len(shown) - _PLACES)] if len(shown) > _PLACES else []
    return ", ".join(shown[:_PLACES] + more)


def _said(choices: Mapping[str, float]) -> str:
    if not choices:
        return "wait"
    if len(choices) == 1:
        return next(iter(choices))
    return ", ".join("%s %.3g" % item for item in choices.items())
