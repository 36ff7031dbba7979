"""The published values, read from ``published.txt``, which explains its form."""

from __future__ import annotations

from pathlib import Path
from typing import Iterator, List, NamedTuple, Sequence

from benchmarks.literature.answers import Between

FILE = Path(__file__).with_name("published.txt")

COUNTS = (
    "states",
    "arcs",
    "arcs_and_deadlocks",
    "tangible",
    "rates",
    "most_in_place",
    "most_tokens",
)
"""Answers that are whole numbers, which are exact whoever published them."""

DEFAULT_ERROR = 1e-3
"""How much a tool's default answer may be wrong, relative to the value: what the competition QComp
2019 allowed."""

STANDARD_ERRORS = 2.0
"""How many of its standard errors the mean of runs may be off."""

_DIGITS = 1e-15
"""Relative error of an exact value that was printed as a floating-point number."""


class Published(NamedTuple):
    """A published value.

    :ivar family: the kind of net.
    :ivar size: which of its nets.
    :ivar answer: the name of what is asked.
    :ivar text: the value as it was published.
    :ivar kind: how good it is: exact, sound, default, printed or measured.
    :ivar source: where it was published.
    :ivar wrong: whether it is known to be wrong.
    """

    family: str
    size: int
    answer: str
    text: str
    kind: str
    source: str
    wrong: bool = False

    @property
    def lower(self) -> float:
        """The value, or the lower end of its interval."""
        return float(self.text.split("..")[0].split("+-")[0])

    @property
    def upper(self) -> float:
        """The value, or the upper end of its interval."""
        return float(self.text.split("..")[-1].split("+-")[0])

    def agrees(self, ours: Between) -> bool:
        """Whether an interval that holds the value agrees with what was published."""
        if self.kind == "exact" and self.answer in COUNTS:
            return int(self.text) == ours.lower == ours.upper
        return ours.lower - self._slack <= self.upper and self.lower <= ours.upper + self._slack

    @property
    def _slack(self) -> float:
        if self.kind == "default":
            return DEFAULT_ERROR * abs(self.lower)
        if self.kind == "measured":
            return STANDARD_ERRORS * float(self.text.split("+-")[1])
        if self.kind == "printed":
            digits = self.text.lower().split("e")[0].partition(".")[2]
            return 0.5 * 10.0 ** -len(digits)
        return _DIGITS * abs(self.lower)


def read_published(text: str) -> List[Published]:
    """The values that a text holds, in its order."""
    return list(_values(text.splitlines()))


def _values(lines: Sequence[str]) -> Iterator[Published]:
    kind = source = family = ""
    head: List[str] = []
    for line in lines:
        words = line.split("#")[0].split()
        if not words:
            continue
        if words[0] == "source":
            kind, source = words[1].rstrip(":"), " ".join(words[2:])
        elif words[0] == "family":
            family, head = words[1], words[3:]
        else:
            size = int(words[0])
            if len(words) != len(head) + 1:
                raise ValueError("not one value for each answer: " + line)
            for answer, word in zip(head, words[1:]):
                if word != "-":
                    good = "exact" if answer in COUNTS else kind
                    wrong = word.endswith("!")
                    yield Published(family, size, answer, word.rstrip("!"), good, source, wrong)
