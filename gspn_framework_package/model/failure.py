"""Failure rules: what a robot does when an attempt at its action fails.

Every rule is a composition of the same few steps: a number of further attempts, each after its
delay, and then an end. The run, ``gspn verify``, the analysis and the simulation know the steps
alone. A
*kind* of rule is the way in which a plan file writes a composition: a row of :data:`FAILURE_KINDS`.
"""

from __future__ import annotations

import enum
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple


class FailureEnd(enum.Enum):
    """What a robot does when it makes no further attempt."""

    WAIT = "wait"
    """Wait for the operator, and report that prominently."""
    FIRE = "fire"
    """Continue as if the action had requested that transition."""
    STOP = "stop"
    """Stop the whole team."""


class FailureRule(NamedTuple):
    """The failure rule of a place.

    :ivar kind: its kind, a key of :data:`FAILURE_KINDS`.
    :ivar times: further attempts within the same visit.
    :ivar delays: seconds before the first of them, the second, and so on; the last holds for all
        others. Without any, they begin at once.
    :ivar end: what the robot does when these have failed too.
    :ivar transition: the transition of FIRE; if it does not leave the robot's place, it waits.
    """

    kind: str = "wait"
    times: int = 0
    delays: Tuple[float, ...] = ()
    end: FailureEnd = FailureEnd.WAIT
    transition: str = ""

    @classmethod
    def retry(cls, times: int, delay: float = 0.0) -> FailureRule:
        """Make ``times`` further attempts, each after a delay (s), then wait."""
        return cls("retry", times, (delay,) if delay else ())

    @classmethod
    def fire(cls, transition: str) -> FailureRule:
        """Continue with a transition."""
        return cls("fire", end=FailureEnd.FIRE, transition=transition)

    @classmethod
    def stop(cls) -> FailureRule:
        """Stop the team."""
        return cls("stop", end=FailureEnd.STOP)

    def delay(self, failures: int) -> float:
        """Return the seconds between failure number ``failures`` of a visit (from 1) and the next
        attempt."""
        return self.delays[min(failures, len(self.delays)) - 1] if self.delays else 0.0

    def essence(self) -> List[Any]:
        """Return what determines the course of a run, for the plan's hash."""
        found = [self.kind, self.times, self.delay(1), self.transition]
        return found if self.kind in _OF_PLANS else [*found, self.delays, self.end.value]


class FailureKind(NamedTuple):
    """How a plan file writes a kind of rule: a text that begins with the kind's name, or an object
    that has this name as a key.

    :ivar read: makes a rule of what fits the form. It may raise a
        :class:`~gspn_framework_package.model.errors.PlanError`.
    :ivar write: makes what ``read`` takes from a rule.
    :ivar form: the JSON Schema of an object, with a ``title`` for the page; None if
        ``plan.schema.json`` has it.
    """

    read: Callable[[Any], FailureRule]
    write: Callable[[FailureRule], Any]
    form: Optional[Mapping[str, Any]] = None


def _read_retry(data: Any) -> FailureRule:
    if isinstance(data, dict):
        return FailureRule.retry(data["retry"], float(data.get("delay", 0.0)))
    return FailureRule.retry(int(data.split(" ")[1]))


FAILURE_KINDS: Dict[str, FailureKind] = {
    "wait": FailureKind(lambda _: FailureRule(), lambda _: "wait"),
    "retry": FailureKind(_read_retry, lambda rule: {"retry": rule.times, "delay": rule.delay(1)}),
    "fire": FailureKind(
        lambda text: FailureRule.fire(text.partition(" ")[2]),
        lambda rule: "fire " + rule.transition,
    ),
    "stop": FailureKind(lambda _: FailureRule.stop(), lambda _: "stop"),
}
"""The kinds of rules, by name."""

_OF_PLANS = tuple(FAILURE_KINDS)


def failure_rule_from_json(data: Any) -> FailureRule:
    """The rule in a value of a plan file that fits the schema.

    :raises PlanError: a kind does not accept it.
    """
    words = data.split(" ")[:1] if isinstance(data, str) else data
    return FAILURE_KINDS[next(word for word in words if word in FAILURE_KINDS)].read(data)


def failure_rule_to_json(rule: FailureRule) -> Any:
    """The value of a plan file."""
    return FAILURE_KINDS[rule.kind].write(rule)
