"""Variations of a net or plan: the argument of ``gspn sweep --vary``.

>>> read_variation("robots=1..3").values
(1, 2, 3)
>>> read_variation("rate:check=0.5,1,2")
Variation(kind='rate', element='check', values=(0.5, 1.0, 2.0))
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Sequence, Tuple, Union

from gspn_framework_package.analysis.plan.reading import RUN
from gspn_framework_package.model.errors import GspnError, UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy import Policy

MOST_POINTS = 100_000
"""Largest number of points of a grid."""

LARGEST_TEAM = 10_000

VARIATION_FORMS = (
    "robots=1..20, rate:TRANSITION=0.5,1,2, duration:PLACE=1,2 (means, s), failure:PLACE=0,0.1 "
    "(probabilities), tokens:PLACE=1..5 or policy=FILE,FILE"
)

VariedValue = Union[int, float, str]


class Variation(NamedTuple):
    """One parameter and its values.

    :ivar kind: ``robots``, ``rate``, ``duration``, ``failure``, ``tokens`` or ``policy``.
    :ivar element: the transition or place; empty for robots and policies.
    """

    kind: str
    element: str
    values: Tuple[VariedValue, ...]

    @property
    def name(self) -> str:
        """As it is written: ``rate:check``."""
        return self.kind + ":" + self.element if self.element else self.kind


def read_variation(text: str) -> Variation:
    """Read a variation, such as ``robots=1..20``.

    :raises UsageError: it is invalid.
    """
    name, equals, values = text.partition("=")
    kind, colon, element = name.partition(":")
    known = _KINDS.get(kind)
    wrong = UsageError("--vary '%.80s'" % text, hint="write %s" % VARIATION_FORMS)
    if not equals or not values or known is None or (element != "") != known.of_element:
        raise wrong
    found: List[VariedValue] = []
    for part in values.split(","):
        try:
            found += (
                _range(part, known) if ".." in part and kind != "policy" else [known.read(part)]
            )
        except ValueError:
            raise UsageError(
                "--vary '%.80s': '%.40s' is not %s" % (text, part, known.what)
            ) from None
    if len(set(found)) < len(found):
        raise UsageError("--vary '%.80s' has a value twice" % text)
    return Variation(kind, element, tuple(found))


def _range(part: str, kind: _Kind) -> List[VariedValue]:
    low, _, high = part.partition("..")
    first, last = int(low), int(high)
    if not first <= last < first + MOST_POINTS:
        raise ValueError
    return [kind.read(str(n)) for n in range(first, last + 1)]


def grid(variations: Sequence[Variation]) -> List[Tuple[VariedValue, ...]]:
    """Every combination of the values.

    :raises UsageError: there are too many, or a parameter is varied twice.
    """
    names = [variation.name for variation in variations]
    for name in names:
        if names.count(name) > 1:
            raise UsageError("--vary %s is given twice" % name, hint="write all its values at once")
    points = math.prod(len(variation.values) for variation in variations)
    if points > MOST_POINTS:
        raise UsageError(
            "the grid has %s points, and at most %s are possible"
            % (format(points, ","), format(MOST_POINTS, ","))
        )
    return list(product(*(variation.values for variation in variations)))


def varied(
    subject: Union[Net, Plan],
    variations: Sequence[Variation],
    values: Sequence[VariedValue],
    policies: Mapping[str, Policy],
    timing: str = RUN,
) -> Union[Net, Plan]:
    """A net or plan with one value for each variation.

    :param policies: the policies by the names of their files.
    :param timing: how the times of a plan are interpreted.
    :raises UsageError: the subject has no such element, or the value would have no effect.
    :raises GspnError: the value is invalid there.
    """
    for variation, value in zip(variations, values):
        change = _KINDS[variation.kind].change
        wanted = policies[str(value)] if variation.kind == "policy" else value
        try:
            subject = change(subject, variation.element, wanted, timing)
        except GspnError as error:
            raise error.located(element="%s=%s" % (variation.name, value)) from None
    return subject


# -- the kinds -------------------------------------------------------------------------------------


def _plan(subject: Union[Net, Plan]) -> Plan:
    if not isinstance(subject, Plan):
        raise UsageError("this is a net, but only a plan has that", hint="vary its rates or tokens")
    return subject


def _robots(subject: Union[Net, Plan], _: str, number: Any, __: str) -> Plan:
    return _plan(subject).for_robots(number)


def _policy(subject: Union[Net, Plan], _: str, policy: Any, __: str) -> Plan:
    return _plan(subject).with_policy(policy)


def _rate(subject: Union[Net, Plan], name: str, rate: Any, timing: str) -> Union[Net, Plan]:
    net = subject.net if isinstance(subject, Plan) else subject
    number = net.transition_index.get(name)
    if number is None or not net.transitions[number].timed:
        timed = [t.name for t in net.transitions if t.timed]
        raise UsageError(
            "there is no exponential transition '%s'" % name,
            hint="there are: %s" % ", ".join(timed[:12]),
        )
    if isinstance(subject, Net):
        return subject.with_rates({name: rate})
    for place in subject.durations if timing == RUN else ():
        p = net.place_index[place]
        if number in subject.of_action(p) and name not in subject.interrupts(place):
            raise UsageError(
                "the duration of the action in %s counts, not the rate" % place,
                hint="vary duration:%s" % place,
            )
    return _given(subject.with_rates({name: rate}), "rates", name)


def _given(plan: Plan, key: str, name: str) -> Plan:
    """The plan with a value that does not come from logs."""
    kept = {of: evidence for of, evidence in plan.evidence.items() if of != (key, name)}
    return replace(plan, evidence=kept)


def _duration(subject: Union[Net, Plan], place: str, mean: Any, timing: str) -> Plan:
    plan = _plan(subject)
    old = plan.durations.get(place)
    if old is None or old.mean <= 0 or timing != RUN:
        raise UsageError(
            "the plan has no effective duration there",
            hint="there are: %s" % (", ".join(plan.durations) or "none; vary a rate"),
        )
    factor = mean / old.mean
    return replace(
        _given(plan, "durations", place),
        durations={**plan.durations, place: old.scaled(factor)},
        own_times={robot: own.scaled({place: factor}) for robot, own in plan.own_times.items()},
    )


def _failure(subject: Union[Net, Plan], place: str, chance: Any, _: str) -> Plan:
    plan = _plan(subject)
    if place not in plan.action_places:
        raise UsageError(
            "there is no action in a place '%s'" % place,
            hint="there are: %s" % ", ".join(plan.action_places[:12]),
        )
    own = {
        robot: its._replace(failures={p: v for p, v in its.failures.items() if p != place})
        for robot, its in plan.own_times.items()
    }
    plan = _given(plan, "failures", place)
    return replace(plan, failures={**plan.failures, place: chance}, own_times=own).validate()


def _tokens(subject: Union[Net, Plan], place: str, count: Any, _: str) -> Union[Net, Plan]:
    net = subject.net if isinstance(subject, Plan) else subject
    if place not in net.place_index:
        raise UsageError("there is no place '%s'" % place)
    if isinstance(subject, Plan) and place not in subject.resource_places:
        raise UsageError("robots are there, not tokens of a resource", hint="vary robots")
    new = net.with_marking({**net.named(net.initial_marking), place: count})
    return replace(subject, net=new) if isinstance(subject, Plan) else new


def _whole(least: int, most: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        value = int(text)
        if not least <= value <= most:
            raise ValueError
        return value

    return read


def _number(above: float, most: float) -> Callable[[str], float]:
    def read(text: str) -> float:
        value = float(text)
        if not above < value <= most or math.isinf(value):
            raise ValueError
        return value

    return read


def _probability(text: str) -> float:
    value = float(text)
    if not 0 <= value < 1:
        raise ValueError
    return value


def _named(text: str) -> str:
    if not text:
        raise ValueError
    return text


class _Kind(NamedTuple):
    read: Callable[[str], VariedValue]
    what: str
    change: Callable[[Union[Net, Plan], str, Any, str], Union[Net, Plan]]
    of_element: bool = True


_KINDS: Dict[str, _Kind] = {
    "robots": _Kind(_whole(1, LARGEST_TEAM), "a number of robots", _robots, False),
    "rate": _Kind(_number(0, math.inf), "a rate above 0", _rate),
    "duration": _Kind(_number(0, math.inf), "a time above 0", _duration),
    "failure": _Kind(_probability, "a probability from 0 to below 1", _failure),
    "tokens": _Kind(_whole(0, 10**9), "a number of tokens", _tokens),
    "policy": _Kind(_named, "a file", _policy, False),
}
