"""The cells of a policy's rows, each what a row asks of the count of a place, and the index that
finds the rows whose cells all fit a marking."""

from __future__ import annotations

import math
import operator
import re
from operator import itemgetter
from typing import Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

from gspn_framework_package.model.errors import PolicyError
from gspn_framework_package.model.net import MAX_COUNT


class CountTest(NamedTuple):
    """A cell that asks for more or fewer tokens than a number, such as ``>= 1``.

    :ivar sign: one of ``<``, ``<=``, ``>``, ``>=`` and ``!=``.
    """

    sign: str
    tokens: int

    def __str__(self) -> str:
        return "%s %d" % self


Cell = Union[int, CountTest, None]
"""The condition of a row on the count of a place: a number, a test of it, or nothing (None)."""

_SIGNS: Dict[str, Callable[[int, int], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "!=": operator.ne,
}


def cell_fits(cell: Cell, count: int) -> bool:
    """Whether ``count`` tokens in a place fit the cell."""
    if isinstance(cell, CountTest):
        return _SIGNS[cell.sign](count, cell.tokens)
    return cell is None or cell == count


def ranges(cell: Cell) -> List[Tuple[int, float]]:
    """The counts that fit a cell, as ranges (least, most); ``most`` may be infinite.

    >>> ranges(CountTest("!=", 2)), ranges(CountTest("<", 3)), ranges(4)
    ([(0, 1), (3, inf)], [(0, 2)], [(4, 4)])
    """
    if cell is None:
        return [(0, math.inf)]
    if not isinstance(cell, CountTest):
        return [(cell, cell)]
    n = cell.tokens
    found: List[Tuple[int, float]] = []
    if cell.sign in ("<", "<=", "!="):
        found.append((0, n if cell.sign == "<=" else n - 1))
    if cell.sign in (">", ">=", "!="):
        found.append((n if cell.sign == ">=" else n + 1, math.inf))
    return [(least, most) for least, most in found if least <= most]


def meet(first: Sequence[Cell], second: Sequence[Cell]) -> bool:
    """Whether rows with these cells match a common marking."""
    for one, other in zip(first, second):
        if isinstance(one, CountTest) or isinstance(other, CountTest):
            pairs = ((a, b) for a in ranges(one) for b in ranges(other))
            if not any(max(a[0], b[0]) <= min(a[1], b[1]) for a, b in pairs):
                return False
        elif one is not None and other is not None and one != other:
            return False
    return True


_TEST = re.compile(r"(<=?|>=?|!=)?\s*([0-9]{1,20})")


def read_cell(cell: object, row: int) -> Cell:
    """Return a cell of a policy as people write it.

    :param row: the number of its row, from 1, for the message.
    :raises PolicyError: it is neither a number of tokens, nor a test, nor ``'-'``.
    """
    sign, tokens = None, -1
    if isinstance(cell, str):
        text = cell.strip()
        if text == "-":
            return None
        found = _TEST.fullmatch(text)
        if found is not None:
            sign, tokens = found.group(1), int(found.group(2))
    elif isinstance(cell, (int, float)) and not isinstance(cell, bool) and float(cell).is_integer():
        tokens = int(cell)
    if tokens < 0:
        raise PolicyError(
            "%r is not a number of tokens" % (cell,),
            element="policy row %d" % row,
            hint="write a whole number, a comparison such as '>= 1', or '-' for any",
        )
    if tokens > MAX_COUNT:
        raise PolicyError(
            "%d is more than 2**53 tokens (%d)" % (tokens, MAX_COUNT),
            element="policy row %d" % row,
        )
    if sign is None:
        return tokens
    test = CountTest(sign, tokens)
    if not ranges(test):
        raise PolicyError("no number of tokens is %s" % str(test), element="policy row %d" % row)
    return test


def written_cell(cell: Cell) -> Union[int, str]:
    """Return a cell as :func:`read_cell` reads it."""
    if isinstance(cell, CountTest):
        return str(cell)
    return "-" if cell is None else cell


Projection = Callable[[Sequence[int]], Tuple[int, ...]]
KeyedRows = Dict[Tuple[int, ...], int]
Cells = Tuple[Tuple[int, int], ...]
"""Pairs (number of a place, tokens), by place."""
Tests = Tuple[Tuple[int, CountTest], ...]
"""Pairs (number of a cell or of a place, what it asks for)."""
Mask = Tuple[Tuple[int, ...], Tests]
"""The common part of rows that differ only in their exact counts: the numbers of the cells that
have one, and the tests."""


MANY_GROUPS = 24
"""Number of groups above which rows are stored in a tree, since trying group by group would be
slow."""


class RowIndex:
    """Rows grouped by the set of cells that have an exact count, and by the tests in the others,
    with one dictionary per group."""

    def __init__(self, columns: Sequence[int]) -> None:
        self._columns = columns
        self._groups: Dict[Mask, Dict[Tuple[int, ...], int]] = {}
        self._doubles: List[Tuple[int, int]] = []
        self._levels: Optional[List[List[Tuple[Projection, KeyedRows, Tests]]]] = None
        self._tree: Optional[_RowTree] = None

    def add(self, number: int, row: Tuple[Cell, ...]) -> None:
        """Add a row, given as its cells."""
        tests: Tests = ()
        if CountTest in map(type, row):
            tests = tuple((i, c) for i, c in enumerate(row) if isinstance(c, CountTest))
        if tests or None in row:
            cells = tuple(i for i, count in enumerate(row) if isinstance(count, int))
            key = tuple(row[i] for i in cells)
        else:
            cells, key = tuple(range(len(row))), row
        group = self._groups.setdefault((cells, tests), {})
        first = group.setdefault(key, number)  # type: ignore[arg-type]
        if first != number:
            self._doubles.append((first, number))
        self._levels = self._tree = None

    def numbers(self) -> List[int]:
        """The numbers of all rows."""
        found = [number for rows in self._groups.values() for number in rows.values()]
        return found + [later for _, later in self._doubles]

    def find(self, marking: Sequence[int]) -> Optional[int]:
        """The row that takes precedence of those that match ``marking``; None if none does."""
        if len(self._groups) > MANY_GROUPS:
            if self._tree is None:
                self._tree = _RowTree(self._columns, self._groups)
            return self._tree.find(marking)
        if self._levels is None:
            self._levels = self._sorted_levels()
        for level in self._levels:
            best: Optional[int] = None
            for project, rows, tests in level:
                number = rows.get(project(marking))
                if (
                    number is not None
                    and (best is None or number < best)
                    and (not tests or all(cell_fits(test, marking[c]) for c, test in tests))
                ):
                    best = number
            if best is not None:
                return best
        return None

    def _sorted_levels(self) -> List[List[Tuple[Projection, KeyedRows, Tests]]]:
        levels: Dict[Tuple[int, int], List[Tuple[Projection, KeyedRows, Tests]]] = {}
        for mask, rows in self._groups.items():
            cells, tests = mask
            levels.setdefault(_level(mask), []).append(
                (
                    _projection([self._columns[i] for i in cells]),
                    rows,
                    tuple((self._columns[i], test) for i, test in tests),
                )
            )
        return [levels[level] for level in sorted(levels)]

    def overlaps(self, limit: int) -> List[Tuple[int, int]]:
        """At most ``limit`` pairs of rows that have equal precedence and match a common marking."""
        found = self._doubles[:limit]
        groups = list(self._groups.items())
        for i, (mask, rows) in enumerate(groups):
            for other, other_rows in groups[i + 1 :]:
                if _level(other) == _level(mask) and len(found) < limit:
                    found += _compatible(mask, rows, other, other_rows, limit - len(found))
        return found[:limit]

    def overlaps_with(self, other: RowIndex, limit: int) -> List[Tuple[int, int]]:
        """Return at most ``limit`` pairs of one row of each index that have equal precedence and
        match a common marking."""
        found: List[Tuple[int, int]] = []
        for mask, rows in self._groups.items():
            for other_mask, other_rows in other._groups.items():
                if _level(other_mask) == _level(mask) and len(found) < limit:
                    found += _compatible(mask, rows, other_mask, other_rows, limit - len(found))
        return found


def _level(mask: Mask) -> Tuple[int, int]:
    """The precedence of a group: the smallest comes first."""
    cells, tests = mask
    return -len(cells) - len(tests), len(tests)


class _Branch:
    """A node of a tree of rows.

    :ivar ends: the rows that end here, the best first: precedence, and the cells that remain to be
        matched. Only the last has none.
    :ivar column: the place that distinguishes the other rows.
    :ivar by_count: tokens there -> node.
    :ivar any: the node of the rows that have no exact count there.
    """

    __slots__ = ("any", "by_count", "column", "ends")

    def __init__(self) -> None:
        self.ends: List[Tuple[_Rank, Sequence[Tuple[int, Cell]]]] = []
        self.column = -1
        self.by_count: Dict[int, _Branch] = {}
        self.any: Optional[_Branch] = None


_Rank = Tuple[int, int, int]
"""The level of a row's group, and its number."""


class _RowTree:
    """Rows of many groups, in a tree: each node compares one place, and rows without an exact count
    there are in a separate branch. A look-up visits the nodes whose rows still match; rows that
    a few places distinguish are found in a few steps."""

    def __init__(self, columns: Sequence[int], groups: Mapping[Mask, KeyedRows]) -> None:
        self._root = _Branch()
        rows: List[Tuple[_Rank, Cells, Tests]] = [
            (
                (*_level((cells, tests)), number),
                tuple((columns[cell], count) for cell, count in zip(cells, key)),
                tuple((columns[cell], test) for cell, test in tests),
            )
            for (cells, tests), keyed in groups.items()
            for key, number in keyed.items()
        ]
        todo = [(self._root, rows)]
        while todo:
            node, rows = todo.pop()
            if len(rows) == 1:
                rank, cells, tests = rows[0]
                node.ends = [(rank, (*cells, *tests))]
                continue
            for rank, cells, tests in sorted(rows):
                if not cells:
                    node.ends.append((rank, tests))
                    if not tests:
                        break
            frequency: Dict[int, int] = {}
            for _, cells, _ in rows:
                for column, _ in cells:
                    frequency[column] = frequency.get(column, 0) + 1
            if not frequency:
                continue
            node.column = max(frequency, key=lambda column: (frequency[column], -column))
            parts: Dict[Optional[int], List[Tuple[_Rank, Cells, Tests]]] = {}
            for rank, cells, tests in rows:
                if cells:
                    count = next((n for column, n in cells if column == node.column), None)
                    rest = tuple(cell for cell in cells if cell[0] != node.column)
                    parts.setdefault(count, []).append((rank, rest, tests))
            for count, part in parts.items():
                branch = _Branch()
                if count is None:
                    node.any = branch
                else:
                    node.by_count[count] = branch
                todo.append((branch, part))

    def find(self, marking: Sequence[int]) -> Optional[int]:
        best: Optional[_Rank] = None
        todo = [self._root]
        while todo:
            node = todo.pop()
            for rank, cells in node.ends:
                if best is not None and best < rank:
                    break
                if all(cell_fits(cell, marking[column]) for column, cell in cells):
                    best = rank
                    break
            if node.column >= 0:
                if node.any is not None:
                    todo.append(node.any)
                branch = node.by_count.get(marking[node.column])
                if branch is not None:
                    todo.append(branch)
        return None if best is None else best[-1]


def _compatible(
    mask: Mask,
    rows: KeyedRows,
    other: Mask,
    other_rows: KeyedRows,
    limit: int,
) -> List[Tuple[int, int]]:
    """Return pairs of rows, one from each group, that match a common marking because they agree on
    the cells that both groups have."""
    cells, other_cells = mask[0], other[0]
    shared = [c for c in cells if c in other_cells]
    mine, theirs = [cells.index(c) for c in shared], [other_cells.index(c) for c in shared]
    seen: Dict[Tuple[int, ...], List[Tuple[int, ...]]] = {}
    for key in rows:
        seen.setdefault(tuple(key[i] for i in mine), []).append(key)
    found: List[Tuple[int, int]] = []
    for key, number in other_rows.items():
        for match in seen.get(tuple(key[i] for i in theirs), ()):
            if (mask[1] or other[1]) and not _tests_meet(mask, match, other, key):
                continue
            found.append((min(rows[match], number), max(rows[match], number)))
            if len(found) >= limit:
                return found
    return found


def _tests_meet(mask: Mask, key: Tuple[int, ...], other: Mask, other_key: Tuple[int, ...]) -> bool:
    """Whether a count fits both of two rows in each place that one of them tests."""
    one: Dict[int, Cell] = {**dict(zip(mask[0], key)), **dict(mask[1])}
    two: Dict[int, Cell] = {**dict(zip(other[0], other_key)), **dict(other[1])}
    both = [cell for cell in one if cell in two]
    return meet([one[cell] for cell in both], [two[cell] for cell in both])


def _projection(columns: Sequence[int]) -> Projection:
    if not columns:
        return lambda marking: ()
    if len(columns) == 1:
        only = columns[0]
        return lambda marking: (marking[only],)
    return itemgetter(*columns)
