"""What the demonstration found: a row for each fault and attack, and what makes it good."""

from __future__ import annotations

from typing import Any, Dict, Iterable, List, NamedTuple, Optional, Sequence, Set

from benchmarks.harness.log_tail import LogTail

HALF = 0.5
"""The share of its speed that a team must keep while it is flooded."""


class Row(NamedTuple):
    """One line of the table. ``subject``: the fault or attack. ``done``: what was done.
    ``outcome``: what came of it. ``seconds``: until every robot moved again. ``ok``: whether that
    is as it must be."""

    subject: str
    done: str
    outcome: str
    seconds: Optional[float]
    ok: bool

    def to_json(self) -> Dict[str, Any]:
        """The fields as a JSON object."""
        return dict(self._asdict())


def strangers_in(logs: Iterable[LogTail], members: Iterable[str]) -> List[str]:
    """Whose entries are in the logs although they are not of the team."""
    known = {"", *members}
    found: Set[str] = set()
    for log in logs:
        for record in log.of("slot"):
            found |= {origin[0] for origin in record["origins"] if origin[0] not in known}
    return sorted(found)


def orders_in(logs: Iterable[LogTail], since: float) -> List[str]:
    """The orders that the logs hold from some time on."""
    kinds = ("pause", "resume", "stop", "evict", "place", "adopt")
    return sorted({kind for log in logs for kind in kinds for _ in log.entries(kind, since)})


def slowed(speed: float, before: float) -> str:
    """Why a speed (slots/s) is too low after what it was before; "" if it is not."""
    if speed >= HALF * before:
        return ""
    return "%.1f slots/s instead of %.1f" % (speed, before)


def attack_row(
    name: str,
    what: str,
    failed: bool,
    found: Dict[str, Any],
    wrong: Sequence[str],
    seconds: float,
) -> Row:
    """The row of an attack.

    :param failed: whether the attacker got nothing.
    :param found: what it got.
    :param wrong: what is wrong with the team since then.
    :param seconds: how long every robot took to move after the attack.
    """
    if not failed:
        outcome = "got through: %s" % found
    elif not found.get("session", True):
        outcome = "no connection"
    elif "answers" in found:
        outcome = "no answer"
    elif found.get("heard") == 0:
        outcome = "connected, heard nothing, was not heard"
    else:
        outcome = "%d messages, no effect" % found.get("sent", 0)
    if wrong:
        outcome += "; " + "; ".join(wrong)
    return Row(name, what, outcome, seconds, failed and not wrong)
