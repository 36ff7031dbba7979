"""Policies: from a marking to a distribution over immediate transitions (thesis 2.3, Definition 2).

A :class:`Policy` is the table as written. A :class:`PolicyTable` is the table prepared for one net:
it keeps the rows by the place they apply to (the "shortcut" of thesis 7.2.1), grouped by which
cells are wildcards or tests. A look-up costs one dictionary access per group, whether the table has
ten rows or a million.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import (
    Any,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

from gspn_framework_package.model.errors import PolicyError
from gspn_framework_package.model.net import MAX_COUNT, Net
from gspn_framework_package.model.policy_cell import Cell, CountTest, RowIndex, cell_fits, read_cell

SUM_TOLERANCE = 1e-6
"""Tolerance for the sum of a row's probabilities, which must be 1 (people round them by hand)."""


class PolicyRow(NamedTuple):
    """A row: ``counts`` has a cell for each place of the policy's tuple; ``choices`` has pairs
    (transition, probability). A row without choices applies to every place: robots wait in the
    markings that it matches."""

    counts: Tuple[Cell, ...]
    choices: Tuple[Tuple[str, float], ...]

    @property
    def tests(self) -> int:
        """The number of cells that are tests."""
        return sum(isinstance(cell, CountTest) for cell in self.counts)


class PolicyScope(NamedTuple):
    """A part of a plan with its own policy: the rows ``first`` to ``last`` (exclusive, numbered
    from 0) decide for the robots in ``places``, and only for them, as if there were no other
    rows."""

    places: Tuple[str, ...]
    first: int
    last: int


class Policy:
    """A stationary policy as a table over an ordered tuple of places.

    :param places: the places that the cells of a row refer to; other places may have any count.
    :param rows: the rows, in file order.
    :param scopes: the subnets with their own policies. Rows outside all scopes decide in places
        outside all scopes.
    :raises PolicyError: a row has the wrong length, a count is not a number of tokens,
        probabilities are negative or do not sum to 1, or scopes overlap.
    """

    def __init__(
        self,
        places: Sequence[str] = (),
        rows: Iterable[PolicyRow] = (),
        scopes: Iterable[PolicyScope] = (),
    ) -> None:
        self.places: Tuple[str, ...] = tuple(places)
        self.rows: Tuple[PolicyRow, ...] = tuple(rows)
        self.scopes: Tuple[PolicyScope, ...] = tuple(scopes)
        self._check_scopes()
        if len(set(self.places)) != len(self.places):
            doubles = sorted(p for p, n in Counter(self.places).items() if n > 1)
            raise PolicyError("the place '%s' occurs twice in the tuple of places" % doubles[0])
        fits: Set[Tuple[Tuple[str, float], ...]] = set()  # checked choices, of which few differ
        for number, row in enumerate(self.rows, 1):
            if len(row.counts) != len(self.places) or row.choices not in fits:
                self._check_row(number, row)
                fits.add(row.choices)
        self._table: Optional[PolicyTable] = None

    @classmethod
    def from_table(
        cls,
        places: Sequence[str],
        table: Iterable[Tuple[Sequence[object], Mapping[str, object]]],
        scopes: Iterable[PolicyScope] = (),
    ) -> Policy:
        """Create a policy from cells as people write them: numbers, numeric strings, tests such as
        ``'>= 1'``, or ``'-'`` for any count.

        :raises PolicyError: see :class:`Policy`; also if a cell or probability cannot be read.
        """
        rows = []
        for number, (cells, choices) in enumerate(table, 1):
            if isinstance(cells, (str, int)):
                cells = (cells,)
            if type(choices) is not dict and not isinstance(choices, Mapping):
                raise PolicyError(
                    "%r is not a map from transition to probability" % (choices,),
                    element="policy row %d" % number,
                )
            rows.append(
                PolicyRow(
                    tuple(
                        [
                            c if type(c) is int and 0 <= c <= MAX_COUNT else read_cell(c, number)
                            for c in cells
                        ]
                    ),
                    tuple([(str(t), _probability(p, number)) for t, p in choices.items()]),
                )
            )
        return cls(places, rows, scopes)

    def __getstate__(self) -> Dict[str, Any]:
        """The state sent to another process: everything but the search tree, which is rebuilt."""
        return {**self.__dict__, "_table": None}

    def _check_scopes(self) -> None:
        seen: Set[str] = set()
        taken = 0
        for scope in sorted(self.scopes, key=lambda scope: (scope.first, scope.last)):
            if not taken <= scope.first <= scope.last <= len(self.rows):
                raise PolicyError("the rows of two scopes overlap, or do not exist")
            taken = scope.last
            doubles = seen.intersection(scope.places)
            if doubles:
                raise PolicyError("the place '%s' is in two scopes" % min(doubles))
            seen.update(scope.places)

    def _check_row(self, number: int, row: PolicyRow) -> None:
        element = "policy row %d" % number
        if len(row.counts) != len(self.places):
            raise PolicyError(
                "%d cells for %d places" % (len(row.counts), len(self.places)),
                element=element,
                hint="the tuple of places is (%s)" % ", ".join(self.places[:12]),
            )
        total = 0.0
        for transition, probability in row.choices:
            if not 0 <= probability <= 1:
                raise PolicyError(
                    "probability %g of '%s' is not between 0 and 1" % (probability, transition),
                    element=element,
                )
            total += probability
        if row.choices and abs(total - 1) > SUM_TOLERANCE:
            raise PolicyError("the probabilities sum to %g, not to 1" % total, element=element)

    def bind(self, net: Net) -> PolicyTable:
        """Prepare the policy for ``net``. :raises PolicyError: see :class:`PolicyTable`."""
        table = self._table
        if table is None or table.net is not net:
            table = self._table = PolicyTable(self, net)
        return table

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Policy) and self._parts == other._parts

    def __hash__(self) -> int:
        return hash(self._parts)

    @property
    def _parts(self) -> Tuple[object, ...]:
        return self.places, self.rows, self.scopes

    def __repr__(self) -> str:
        return "<Policy: %d rows over %d places>" % (len(self.rows), len(self.places))


Choices = Tuple[Tuple[int, float], ...]
"""What a robot draws from: pairs (transition index, probability)."""


class Distribution(NamedTuple):
    """The choice that a policy gives a robot: the ``row`` that applies (its number, from 0) and
    pairs (transition index, probability), renormalised over the transitions that leave the robot's
    place. Without any pairs, the policy lets the robot wait."""

    row: int
    choices: Choices


Overlap = Tuple[int, int, int]
"""(place, earlier row, later row), all as numbers from 0: two rows of equal precedence that apply
to the place and that match a common marking."""


class PolicyTable:
    """A policy indexed for look-up in one net.

    Among the rows that match the marking and apply to the robot's place, the one with the fewest
    wildcards takes precedence, then the one with the fewest tests, then the first in file order.
    Where the policy has scopes, only the rows of the place's own scope count.

    :raises PolicyError: the policy names a place or transition that the net does not have, or an
        exponential transition.
    """

    def __init__(self, policy: Policy, net: Net) -> None:
        self.policy = policy
        self.net = net
        for name in policy.places:
            if name not in net.place_index:
                raise PolicyError(
                    "the net has no place '%s'" % name, element="the policy's tuple of places"
                )
        self._columns = columns = [net.place_index[p] for p in policy.places]
        self._restricted: Dict[Tuple[int, int], Distribution] = {}
        self._leaving: Dict[Tuple[Tuple[Tuple[str, float], ...], int], Choices] = {}
        self._ranks: Dict[int, Tuple[int, int, int]] = {}
        self._scope: Dict[int, int] = {}  # place -> number of its scope; others: 0
        self._row_scope = row_scope = [0] * len(policy.rows)
        for k, scope in enumerate(policy.scopes, 1):
            row_scope[scope.first : scope.last] = [k] * (scope.last - scope.first)
            for name in scope.places:
                if name not in net.place_index:
                    raise PolicyError(
                        "the net has no place '%s'" % name, element="a scope of the policy"
                    )
                self._scope[net.place_index[name]] = k
        self._any: Dict[int, RowIndex] = {}  # scope -> its rows; rarely needed
        self._by_place: Dict[int, RowIndex] = {}
        self._waits: Dict[int, RowIndex] = {}  # scope -> its rows without choices
        speaks_of: Dict[Tuple[Tuple[str, float], ...], Tuple[int, ...]] = {}
        for number, row in enumerate(policy.rows):
            if row.choices not in speaks_of:
                speaks_of[row.choices] = self._places_of(number, row)
            if not row.choices:
                self._waits.setdefault(row_scope[number], RowIndex(columns)).add(number, row.counts)
            for place in speaks_of[row.choices]:
                if self._scope.get(place, 0) != row_scope[number]:
                    continue
                index = self._by_place.get(place)
                if index is None:
                    index = self._by_place[place] = RowIndex(columns)
                index.add(number, row.counts)

    def _places_of(self, number: int, row: PolicyRow) -> Tuple[int, ...]:
        places: Dict[int, None] = {}
        for name, probability in row.choices:
            t = self.net.transition_index.get(name)
            if t is None:
                raise PolicyError(
                    "the net has no transition '%s'" % name, element="policy row %d" % (number + 1)
                )
            if self.net.transitions[t].timed:
                raise PolicyError(
                    "'%s' is an exponential transition; a policy chooses among immediate ones"
                    % name,
                    element="policy row %d" % (number + 1),
                )
            if probability > 0:
                places.update((p, None) for p, _ in self.net.inputs[t])
        return tuple(places)

    def distribution(self, marking: Sequence[int], place: int) -> Optional[Distribution]:
        """Return the choice of a robot in ``place`` (an index) at ``marking``, None if no matching
        row applies to that place."""
        index = self._by_place.get(place)
        number = index.find(marking) if index is not None else None
        if self._waits:
            silent = self._waits.get(self._scope.get(place, 0))
            waits = silent.find(marking) if silent is not None else None
            if waits is not None and (
                number is None or self.precedence(waits) < self.precedence(number)
            ):
                number = waits
        if number is None:
            return None
        key = (number, place)
        if key not in self._restricted:
            self._restricted[key] = Distribution(number, self.choices_of_row(number, place))
        return self._restricted[key]

    def choices(self, marking: Sequence[int], place: int) -> Optional[Choices]:
        """Return what a robot in ``place`` draws from at ``marking``; nothing if the policy lets it
        wait, None if no row of its scope matches, so that the policy says nothing."""
        found = self.distribution(marking, place)
        if found is not None:
            return found.choices
        return () if self.matches(marking, place) else None

    def matches(self, marking: Sequence[int], place: int) -> bool:
        """Whether any row of the scope of ``place`` matches ``marking``, whichever place of that
        scope the row applies to."""
        scope = self.scope(place)
        if scope not in self._any:
            rows = self._any[scope] = RowIndex(self._columns)
            for number in self.in_scope(scope):
                rows.add(number, self.policy.rows[number].counts)
        return self._any[scope].find(marking) is not None

    def rows_of(self, place: int) -> Sequence[int]:
        """The numbers of the rows in the scope of ``place``."""
        return self.in_scope(self.scope(place))

    def scope(self, place: int) -> int:
        """The number of the scope of ``place``, from 1 on; 0 if it is in none, as the plan's own
        rows are."""
        return self._scope.get(place, 0)

    def in_scope(self, scope: int) -> Sequence[int]:
        """The numbers of the rows in a scope."""
        numbers = range(len(self.policy.rows))
        return (
            [n for n in numbers if self._row_scope[n] == scope] if self.policy.scopes else numbers
        )

    def applies(self, number: int, place: int) -> bool:
        """Whether the row ``number`` is in the scope of ``place``."""
        return self._row_scope[number] == self.scope(place)

    def in_order(self, place: int, strict: bool) -> Iterator[Tuple[Tuple[Cell, ...], Choices]]:
        """The rows that decide for a robot in ``place``, by precedence: their cells and choices,
        as in :meth:`distribution`. Then, unless ``strict``, the other rows of its scope, where it
        waits."""
        rows, decide = self.policy.rows, self.deciding(place)
        others = [] if strict else sorted(set(self.rows_of(place)).difference(decide))
        seen: Set[Tuple[Cell, ...]] = set()
        for n in (*decide, *others):
            if rows[n].counts not in seen:
                seen.add(rows[n].counts)
                yield rows[n].counts, self.choices_of_row(n, place)

    def speaking(self, place: int) -> List[int]:
        """Return the numbers of the rows that choose something for a robot in ``place``."""
        index = self._by_place.get(place)
        return index.numbers() if index is not None else []

    def waiting(self, place: int) -> List[int]:
        """Return the numbers of the rows that let a robot in ``place`` wait."""
        index = self._waits.get(self.scope(place))
        return index.numbers() if index is not None else []

    def deciding(self, place: int) -> List[int]:
        """Return the numbers of the rows of either kind, in the order of precedence."""
        return sorted([*self.speaking(place), *self.waiting(place)], key=self.precedence)

    def row_matches(self, number: int, marking: Sequence[int]) -> bool:
        """Whether the row ``number`` matches ``marking``."""
        cells = self.policy.rows[number].counts
        return all(cell_fits(cell, marking[column]) for cell, column in zip(cells, self._columns))

    def precedence(self, number: int) -> Tuple[int, int, int]:
        """Return the precedence of a row: of those that match, the smallest decides."""
        if number not in self._ranks:
            row = self.policy.rows[number]
            self._ranks[number] = row.counts.count(None), row.tests, number
        return self._ranks[number]

    def choices_of_row(self, number: int, place: int) -> Choices:
        """Return what a robot in ``place`` draws from by the row ``number``, if that decides."""
        row = self.policy.rows[number]
        key = (row.choices, place)
        if key not in self._leaving:
            leaving = []
            for name, probability in row.choices:
                t = self.net.transition_index[name]
                if probability > 0 and any(p == place for p, _ in self.net.inputs[t]):
                    leaving.append((t, probability))
            total = math.fsum(p for _, p in leaving)
            self._leaving[key] = tuple((t, p / total) for t, p in leaving)
        return self._leaving[key]

    def overlaps(self, limit: int = 100) -> List[Overlap]:
        """Return at most ``limit`` pairs of rows whose precedence depends only on file order, as
        (place, earlier row, later row)."""
        found: List[Overlap] = []
        for place, index in self._by_place.items():
            pairs = index.overlaps(limit - len(found))
            waits = self._waits.get(self.scope(place))
            if waits is not None:
                pairs += index.overlaps_with(waits, limit - len(found) - len(pairs))
            found += [(place, earlier, later) for earlier, later in pairs]
            if len(found) >= limit:
                break
        return found


def _probability(value: object, row: int) -> float:
    if type(value) is float and math.isfinite(value):
        return value
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if isinstance(value, bool) or not math.isfinite(number):
        raise PolicyError("%r is not a probability" % (value,), element="policy row %d" % row)
    return number
