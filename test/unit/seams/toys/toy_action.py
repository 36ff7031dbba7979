"""A kind of action: names its transitions in turn."""

from __future__ import annotations

from typing import List


class InTurn:
    def __init__(self, transitions: List[str]) -> None:
        self.transitions = transitions

    def __call__(self, visit: int) -> str:
        return self.transitions[visit % len(self.transitions)]
