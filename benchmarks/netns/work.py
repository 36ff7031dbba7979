"""What the robots do while the network fails."""

from __future__ import annotations

PAUSE = 0.05
"""Seconds that an action takes."""


def work(is_cancelled) -> str:  # type: ignore[no-untyped-def]
    """A short action; the net and the policy decide what follows."""
    is_cancelled.wait(PAUSE)
    return ""
