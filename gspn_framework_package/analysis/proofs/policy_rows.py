"""The rows of a policy as facts about markings."""

from __future__ import annotations

import math
from typing import Dict, Iterator, List, Sequence, Tuple

from gspn_framework_package.analysis.proofs.checker import (
    TRUE,
    All,
    Atom,
    Formula,
    Some,
)
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.policy import PolicyRow, PolicyTable
from gspn_framework_package.model.policy_cell import meet, ranges

MOST_PROOF_ROWS = 20_000
"""Maximum number of steps through the rows of a policy."""


_Ranked = Tuple[int, Tuple[Formula, ...], Sequence[int], List[Formula]]
"""See :meth:`RowsOfPlaces.by_precedence`."""


class RowsOfPlaces:
    """The rows of a policy that decide for each place of ``net``, by precedence."""

    def __init__(self, table: PolicyTable, net: Net, original: Sequence[int]) -> None:
        policy = table.policy
        self._policy, self._net, self._table, self._original = policy, net, table, original
        self._steps = 0
        self._matches: Dict[int, Formula] = {}  # scope -> one of its rows matches
        self._ranked: Dict[int, List[_Ranked]] = {}
        self._cells = [tuple(self._row_cells(row)) for row in policy.rows]

    def scope(self, p: int) -> int:
        """The number of the scope of a place."""
        return self._table.scope(self._original[p])

    def _row_cells(self, row: PolicyRow) -> Iterator[Formula]:
        """The condition of a row."""
        for name, cell in zip(self._policy.places, row.counts):
            if cell is None:
                continue
            p = self._net.place_number(name)
            ways = [tuple(_within(p, least, most)) for least, most in ranges(cell)]
            if len(ways) == 1:
                yield from ways[0]
            else:
                yield Some(tuple(map(All, ways)))

    def bits(self, number: int) -> Tuple[int, int]:
        """The places that a row requires to be empty, and those that it requires to be marked, as
        bits of their numbers."""
        empty = marked = 0
        for name, cell in zip(self._policy.places, self._policy.rows[number].counts):
            if cell is None:
                continue
            bit, ways = 1 << self._net.place_number(name), ranges(cell)
            empty |= bit * all(most == 0 for _, most in ways)
            marked |= bit * all(least > 0 for least, _ in ways)
        return empty, marked

    def match(self, number: int) -> Formula:
        """A row matches."""
        return All(self._cells[number])

    def matches(self, scope: int) -> Formula:
        """Some row of a scope matches."""
        if scope not in self._matches:
            rows = [self._cells[number] for number in self._table.in_scope(scope)]
            found = TRUE if () in rows else Some(tuple(map(All, rows)))
            self._matches[scope] = found
        return self._matches[scope]

    def any_matches(self, p: int) -> Formula:
        """Some row of the scope of a place matches."""
        return self.matches(self.scope(p))

    def of(self, p: int) -> Iterator[Tuple[int, Sequence[int]]]:
        """The rows that decide for a place, by precedence, each with the transitions that it lets a
        robot choose there; those without any let robots wait."""
        place = self._original[p]
        for number in self._table.deciding(place):
            yield number, sorted(t for t, _ in self._table.choices_of_row(number, place))

    def by_precedence(self, p: int) -> List[_Ranked]:
        """The rows of :meth:`of`, each with what it asks for, what it lets robots choose, and that
        rows which take precedence match.

        :raises LimitError: there are too many.
        """
        if p in self._ranked:
            return self._ranked[p]
        seen: List[int] = []
        found = []
        for number, chosen in self.of(p):
            before = [self.match(other) for other in seen if self._overlap(other, number)]
            found.append((number, self._cells[number], chosen, before))
            seen.append(number)
            self._steps += 1 + len(seen) // 10 + len(chosen)
            if self._steps > MOST_PROOF_ROWS:
                raise LimitError("not decided: the policy is too large for a proof")
        self._ranked[p] = found
        return found

    def _overlap(self, first: int, second: int) -> bool:
        """Whether two rows match a common marking."""
        rows = self._policy.rows
        return meet(rows[first].counts, rows[second].counts)


def _within(p: int, least: int, most: float) -> Iterator[Atom]:
    """Place number ``p`` has a count in a range."""
    if most < math.inf:
        yield Atom(((p, -1),), -int(most))
    if least > 0:
        yield Atom(((p, 1),), least)
