"""The report of the check before any robot moves: items as text and as JSON."""

from __future__ import annotations

import enum
import itertools
from typing import Any, Dict, Iterable, List, Mapping, NamedTuple, Sequence, Tuple


class Severity(enum.Enum):
    """The severity of an item."""

    OK = "ok"
    """Nothing to do."""
    WARNING = "warning"
    """The plan may run, but should be reviewed."""
    REFUSED = "refused"
    """The plan must not run."""


class CheckItem(NamedTuple):
    """One question and its answer: ``check`` names the question, ``text`` is for people and
    ``details`` for programs (plain JSON values)."""

    check: str
    severity: Severity
    text: str
    details: Mapping[str, Any] = {}


class PreflightReport(NamedTuple):
    """The answers of :func:`gspn_framework_package.analysis.preflight.check`.

    :ivar states: number of markings visited; 0 if the structure decided everything.
    :ivar complete: whether these were all.
    :ivar seconds: duration of the check (s).
    """

    plan: str
    items: Tuple[CheckItem, ...]
    states: int
    complete: bool
    seconds: float

    @property
    def refused(self) -> bool:
        """Whether the plan must not run."""
        return any(item.severity is Severity.REFUSED for item in self.items)

    @property
    def doubts(self) -> Tuple[str, ...]:
        """Doubts about a plan that may run, in a few words each: a run can get stuck, robots can
        wait forever, or transitions never fire."""
        if self.refused:
            return ()
        warnings = [item for item in self.items if item.severity is Severity.WARNING]
        dead = [i for i in warnings if i.check == "dead_markings" and "marking" in i.details]
        counts = [i.details.get("count", 0) for i in warnings if i.check == "dead_markings"]
        number = max([len(dead), *counts])
        never = [t for i in warnings if i.check == "never_fire" for t in i.details["transitions"]]
        found = []
        if number:
            found.append("can get stuck (%d dead marking%s)" % (number, "s"[: number > 1]))
        if any(item.details.get("waits") for item in warnings):
            found.append("can let robots wait forever")
        if never:
            found.append(
                "has %d transition%s"
                % (len(never), " that never fires" if len(never) == 1 else "s that never fire")
            )
        return tuple(found)

    @property
    def verdict(self) -> str:
        """The verdict of the check, in a few words."""
        if self.refused:
            return "refused"
        return ", but ".join(filter(None, ("may run", ", and ".join(self.doubts))))

    @property
    def why(self) -> str:
        """The first reasons why the plan must not run; "" if it may."""
        refused = [item.text for item in self.items if item.severity is Severity.REFUSED]
        return "; ".join(refused[:3])

    @property
    def exit_code(self) -> int:
        """0: the plan may run (perhaps with warnings); 1: it is refused."""
        return int(self.refused)

    def of(self, check: str) -> Tuple[CheckItem, ...]:
        """The items of one question."""
        return tuple(item for item in self.items if item.check == check)

    def to_json(self) -> Dict[str, Any]:
        """The report as plain JSON values."""
        return {
            "plan": self.plan,
            "accepted": not self.refused,
            "verdict": self.verdict,
            "exit_code": self.exit_code,
            "warnings": sum(item.severity is Severity.WARNING for item in self.items),
            "states": self.states,
            "complete": self.complete,
            "seconds": round(self.seconds, 6),
            "items": [
                {
                    "check": item.check,
                    "severity": item.severity.value,
                    "text": item.text,
                    **item.details,
                }
                for item in self.items
            ],
        }

    def __str__(self) -> str:
        lines = [
            "%-8s %s: %s" % (item.severity.value, item.check, item.text) for item in self.items
        ]
        how = (
            "by structure alone"
            if not self.states
            else "%d markings visited%s"
            % (self.states, "" if self.complete else ", possibly not all")
        )
        return "\n".join(
            lines + ["%s %s (%s, %.3f s)" % (self.plan, self.verdict, how, self.seconds)]
        )


SHARED_EFFORT = 100_000
"""Maximum number of steps of a search for invariants: which robots share a server, and what they
hold."""

LISTED = 10
"""Largest number of findings of one kind, and of names in one sentence, that a report lists; it
always gives the total number."""


class Checklist:
    """A report under construction."""

    def __init__(self) -> None:
        self.items: List[CheckItem] = []

    def add(self, check: str, severity: Severity, text: str, **details: Any) -> None:
        """Add an item."""
        self.items.append(CheckItem(check, severity, text, details))

    def report_bounds(self, bounds: Dict[str, int], how: str) -> None:
        """Report that these resource places are bounded.

        :param bounds: place -> largest number of tokens.
        :param how: how this was decided.
        """
        listed = ", ".join("%s %d" % item for item in itertools.islice(bounds.items(), LISTED))
        self.add(
            "resource_bounds",
            Severity.OK,
            "resource places are bounded: %s%s" % (listed, ", ..." if len(bounds) > LISTED else ""),
            bounds=bounds,
            decided_by=how,
        )


def name_list(listed: Iterable[str]) -> str:
    """Names for a sentence, abbreviated if there are many."""
    everyone = list(listed)
    more = ", ... (%d in total)" % len(everyone) if len(everyone) > LISTED else ""
    return ", ".join(everyone[:LISTED]) + more


def sequence(firings: Sequence[str]) -> str:
    """A firing sequence for a sentence."""
    if not firings:
        return "nothing: at the start"
    if len(firings) > 12:
        return "%s, ... (%d firings) ..., %s" % (
            ", ".join(firings[:8]),
            len(firings),
            ", ".join(firings[-3:]),
        )
    return ", ".join(firings)


def marking_text(marking: Mapping[str, int]) -> str:
    """A marking for a sentence."""
    return "(%s)" % ", ".join("%s: %d" % item for item in marking.items())
