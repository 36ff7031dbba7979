"""The form of the page's *Optimise* tab: its fields as a request for a policy."""

from __future__ import annotations

import math
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple, TypeVar

from gspn_framework_package.analysis.decisions.aims import Aim, AtLeast, Objective, Request
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.plan.reading import RUN, checked_reading
from gspn_framework_package.model.errors import GspnError, UsageError
from gspn_framework_package.model.plan import Plan

MOST_ENTRIES = 100
"""Maximum number of entries of each list of the form."""

LONGEST_CONDITION = 2_000
"""Maximum number of characters of a condition."""

LONGEST_SIMULATION = 60.0
"""Longest time (s) for which the form may have the old and the new plan simulated."""

_GOALS = (Aim.TIME_TO, Aim.COST_TO, Aim.REACH)
_REWARDED = (Aim.LONG_RUN, Aim.COST_TO, Aim.DISCOUNTED)

_Value = TypeVar("_Value")


class FormError(UsageError):
    """The form contains errors; ``fields`` has the message for each field by name, such as
    ``rewards.0.value``."""

    def __init__(self, fields: Mapping[str, str]) -> None:
        count = len(fields)
        super().__init__("%d field%s of the form cannot be used" % (count, "s"[count == 1 :]))
        self.fields = dict(fields)


def request_in_form(form: object, plan: Plan, limits: Optional[Limits] = None) -> Request:
    """Read the form.

    :param form: the JSON object that the page sends: ``aim``, ``maximise``, ``goal``, ``discount``,
        ``rewards`` (``name`` and ``value`` each), ``never`` (conditions), ``at_least`` (``name``
        and ``bound`` each), ``may_wait`` (places), ``uncertain`` (``name``, ``low`` and ``high``
        each), ``timing``, ``fitted``, ``teams``.
    :raises FormError: fields cannot be used.
    """
    return _Form(form, plan).read(limits or Limits())


def simulated_of(form: Mapping[str, Any]) -> float:
    """How many seconds to simulate the old and the new plan. :raises FormError: the field is
    invalid."""
    value = _number(form.get("simulated", 0.0), "simulated", "a number of seconds")
    if not 0 <= value <= LONGEST_SIMULATION:
        raise FormError({"simulated": "choose 0 to %g seconds" % LONGEST_SIMULATION})
    return value


class _Form:
    """The fields of one form. Each is checked alone, so that all errors are found at once."""

    def __init__(self, form: object, plan: Plan) -> None:
        if not isinstance(form, dict):
            raise UsageError("'optimise' must be an object")
        self._form: Dict[str, Any] = form
        self._net = plan.net
        self._robots = len(plan.robots)
        self._wrong: Dict[str, str] = {}

    def read(self, limits: Limits) -> Request:
        objective = self._objective()
        request = Request(
            objective,
            never=tuple(self._list("never", self._never)),
            at_least=tuple(self._list("at_least", self._at_least)),
            may_wait=frozenset(self._list("may_wait", self._may_wait)),
            reading=self._field("timing", self._timing, RUN),
            fitted=self._form.get("fitted", True) is not False,
            uncertain=dict(self._list("uncertain", self._uncertain)),
            team_sizes=self._field("teams", self._teams, None),
            limits=limits,
        )
        self._field("simulated", lambda: simulated_of(self._form), 0.0)
        if not self._wrong:
            request = self._field("aim", lambda: request.resolved(self._net), request)
        if self._wrong:
            raise FormError(self._wrong)
        return request

    def _field(self, name: str, read: Callable[[], _Value], instead: _Value) -> _Value:
        """Return the result of ``read``; if it raises an error, record it for the field ``name``
        and return ``instead``."""
        try:
            return read()
        except FormError as error:
            self._wrong.update(error.fields)
        except GspnError as error:
            self._wrong.setdefault(name, str(error))
        return instead

    def _list(self, name: str, read: Callable[[str, Any], _Value]) -> List[_Value]:
        items = self._form.get(name, [])
        if not isinstance(items, list) or len(items) > MOST_ENTRIES:
            self._wrong[name] = "give a list of at most %d entries" % MOST_ENTRIES
            return []
        found: List[_Value] = []
        for i, item in enumerate(items):
            field = "%s.%d" % (name, i)
            self._field(field, lambda field=field, item=item: found.append(read(field, item)), None)  # type: ignore[misc]
        return found

    def _objective(self) -> Objective:
        try:
            aim = Aim(self._form.get("aim"))
        except ValueError:
            raise FormError({"aim": "choose an aim"}) from None
        maximise = aim not in (Aim.TIME_TO, Aim.COST_TO)
        if maximise and self._form.get("maximise") is False:
            maximise = False
        return Objective(
            aim,
            rewards=self._rewards() if aim in _REWARDED else {},
            goal=self._field("goal", self._goal, None) if aim in _GOALS else None,
            discount=(
                self._field("discount", self._discount, None) if aim is Aim.DISCOUNTED else None
            ),
            maximise=maximise,
        )

    def _goal(self) -> Optional[str]:
        return self._condition(self._form.get("goal"))

    def _discount(self) -> float:
        value = _number(self._form.get("discount"), "discount", "a rate per second")
        self._check(Objective.discounted({self._net.places[0].name: 1.0}, value))
        return value

    def _rewards(self) -> Dict[str, float]:
        if not self._form.get("rewards"):
            self._wrong["rewards"] = "add a place or a transition that counts"
            return {}
        found: Dict[str, float] = {}
        for name, value in self._list("rewards", self._reward):
            if name in found:
                self._wrong["rewards"] = "'%s' occurs twice" % name
            found[name] = value
        if found and not self._wrong and not any(found.values()):
            self._wrong["rewards"] = "at least one must not be 0"
        return found

    def _reward(self, field: str, item: Any) -> Tuple[str, float]:
        name, value = _pair(field, item, "value")
        self._check(Objective.long_run({name: value or 1.0}), field + ".name")
        return name, value

    def _never(self, field: str, item: Any) -> str:
        return self._condition(item)

    def _at_least(self, field: str, item: Any) -> AtLeast:
        found = AtLeast(*_pair(field, item, "bound"))
        self._check(Objective.long_run({found.name: 1.0}), field + ".name")
        return found

    def _may_wait(self, field: str, item: Any) -> str:
        if not isinstance(item, str):
            raise UsageError("choose a place")
        Request(Objective.reach("true"), may_wait=frozenset((item,))).check(self._net)
        return item

    def _uncertain(self, field: str, item: Any) -> Tuple[str, Tuple[float, float]]:
        name, low = _pair(field, item, "low", "an exponential transition")
        found = name, (low, _number(item.get("high"), field + ".high", "a rate per second"))
        Request(Objective.reach("true"), uncertain=dict([found])).check(self._net)
        return found

    def _teams(self) -> Optional[Tuple[int, ...]]:
        """The sizes of teams, largest first; None: that of the plan, and the smaller ones after
        losses."""
        sizes = {"plan": None, "own": (self._robots,), "all": tuple(range(self._robots, 0, -1))}
        chosen = self._form.get("teams", "plan")
        if not isinstance(chosen, str) or chosen not in sizes:
            raise UsageError("choose %s" % ", ".join(sizes))
        return sizes[chosen]

    def _timing(self) -> str:
        return checked_reading(str(self._form.get("timing", RUN)))

    def _condition(self, text: Any) -> str:
        if not isinstance(text, str) or not text.strip():
            raise UsageError("write a condition", hint="e.g. p1 >= 1 and p2 == 0")
        if len(text) > LONGEST_CONDITION:
            raise UsageError("a condition has at most %d characters" % LONGEST_CONDITION)
        self._check(Objective.reach(text.strip()))
        return text.strip()

    def _check(self, objective: Objective, field: Optional[str] = None) -> None:
        try:
            Request(objective).check(self._net)
        except GspnError as error:
            if field is None:
                raise
            raise FormError({field: str(error)}) from None


def _pair(
    field: str, item: Any, key: str, what: str = "a place or a transition"
) -> Tuple[str, float]:
    """The name and the number of an entry."""
    name = item.get("name") if isinstance(item, dict) else None
    if not isinstance(name, str) or not name:
        raise FormError({field + ".name": "choose %s" % what})
    return name, _number(item.get(key), "%s.%s" % (field, key), "a number")


def _number(value: Any, field: str, what: str) -> float:
    """The number in a field, which a browser sends as text."""
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise FormError({field: "give %s" % what})
    return number
