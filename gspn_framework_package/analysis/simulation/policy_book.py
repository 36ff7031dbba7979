"""The policy of a plan as the arrays of the kernel."""

from __future__ import annotations

from typing import Any, Dict, List, NamedTuple, Sequence, Set, Tuple

import numpy as np

from gspn_framework_package.analysis.simulation import kernel
from gspn_framework_package.analysis.simulation.machine import integers, ragged
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy import Choices
from gspn_framework_package.model.policy_cell import Cell, ranges

FEW_ENTRIES = 12
"""Up to this many rows for a place are searched one by one."""


class PolicyBook(NamedTuple):
    """A policy, prepared for the kernel.

    :ivar arrays: the policy.
    :ivar reads: for each place, the places whose counts the choices of its robots depend on.
    :ivar some_row_always: whether some row of every scope matches every marking.
    """

    arrays: kernel.Book
    reads: Sequence[Set[int]]
    some_row_always: bool


def policy_book(plan: Plan, deciding: Sequence[int]) -> PolicyBook:
    """The policy of a plan as arrays.

    :param deciding: the numbers of the places whose robots may ask it.
    """
    policy, net = plan.policy, plan.net
    table = policy.bind(net)
    columns = [net.place_index[name] for name in policy.places]
    cells = [
        [
            value
            for column, cell in zip(columns, row.counts)
            if cell is not None
            for value in (column, *_bounds(cell))
        ]
        for row in policy.rows
    ]
    scope_of = list(map(table.scope, range(len(net.places))))
    scopes = [table.in_scope(scope) for scope in range(1 + len(policy.scopes))]
    some_row_always = all(any(not cells[n] for n in rows) for rows in scopes)
    entries: List[List[Tuple[int, Choices]]] = [[] for _ in net.places]
    for p in deciding:
        entries[p] = [(n, table.choices_of_row(n, p)) for n in table.deciding(p)]
    # where the weights decide only if no row matches, all rows of each scope are looked up as well
    weights = not plan.strict and not some_row_always
    entries += [[(n, ()) for n in rows if weights] for rows in scopes]
    reads = [{cell for n, _ in mine for cell in cells[n][::3]} for mine in entries]
    for p in deciding:
        reads[p] |= reads[len(net.places) + scope_of[p]]
    choices = [chosen for mine in entries for _, chosen in mine]
    choice_from, choice = ragged([[t for t, _ in chosen] for chosen in choices])
    priorities = [{net.transitions[t].priority for t, _ in chosen} for chosen in choices]
    book = kernel.Book(
        rows=_row_arrays([[n for n, _ in mine] for mine in entries], cells),
        any_of=len(net.places) + np.array(scope_of, dtype=np.int64),
        entry_mixed=integers([int(len(mine) > 1) for mine in priorities]),
        choice_from=choice_from,
        choice=choice,
        chance=ragged([[v for _, v in chosen] for chosen in choices], np.float64)[1],
    )
    return PolicyBook(book, reads[: len(net.places)], some_row_always)


def _bounds(cell: Cell) -> Tuple[int, int]:
    """The least and the most tokens that fit a cell. If the least is greater than the most, they
    bound what does not fit, exclusively; (-1, -1) if nothing fits."""
    if isinstance(cell, int):
        return cell, cell
    ways = ranges(cell)
    if not ways:
        return -1, -1
    return ways[-1][0], int(min(ways[0][1], kernel.ANY_COUNT))


class _Mask(NamedTuple):
    """The entries whose rows have exact counts in the same ``cells``, and nothing else."""

    cells: Tuple[int, ...]
    entries: List[int]


def _row_arrays(parts: Sequence[Sequence[int]], cells: List[List[int]]) -> kernel.RowArrays:
    """Rows as arrays for look-up.

    :param parts: for each place the numbers of its rows, in order of precedence. The entries have
        numbers in this order.
    :param cells: for each row, its cells that are not wildcards: place, least and most in turn.
    """
    entry_row = [n for part in parts for n in part]
    listed: List[List[int]] = []
    masks: List[List[_Mask]] = []
    first = 0
    for part in parts:
        mine = list(range(first, first + len(part)))
        first += len(part)
        groups: Dict[Tuple[int, ...], List[int]] = {}
        if len(mine) > FEW_ENTRIES:
            tests = []
            for entry in mine:
                its = cells[entry_row[entry]]
                if its[1::3] == its[2::3]:
                    groups.setdefault(tuple(its[::3]), []).append(entry)
                else:
                    tests.append(entry)
            mine = tests
        listed.append(mine)
        masks.append([_Mask(*group) for group in groups.items()])
    all_masks = [mask for mine in masks for mask in mine]
    sizes = [1 << max(2 * len(mask.entries) - 1, 1).bit_length() for mask in all_masks]
    starts = np.cumsum([0, *sizes]).astype(np.int64)
    hashed = np.full(max(int(starts[-1]), 1), -1, dtype=np.int64)
    for mask, start, size in zip(all_masks, starts.tolist(), sizes):
        _fill(hashed[start : start + size], [(e, cells[entry_row[e]]) for e in mask.entries])
    listed_from, flat_listed = ragged(listed)
    mask_cells_from, mask_cells = ragged([list(mask.cells) for mask in all_masks])
    cell_from, flat_cells = ragged(cells)
    return kernel.RowArrays(
        listed_from=listed_from,
        listed=flat_listed,
        mask_from=np.cumsum([0, *map(len, masks)]).astype(np.int64),
        mask_cells_from=mask_cells_from,
        mask_cells=mask_cells,
        mask_table=starts,
        mask_size=integers(sizes),
        tables=hashed,
        entry_row=integers(entry_row),
        cell_from=cell_from,
        cells=flat_cells,
    )


def _fill(table: Any, rows: Sequence[Tuple[int, List[int]]]) -> None:
    """Enter entries into a hash table; of two with equal cells, the first stays."""
    size = len(table)
    held: Dict[int, List[int]] = {}
    for entry, cells in rows:
        mixed = 0
        for count in cells[1::3]:
            mixed = (mixed * 1000003 + count) & 0x7FFFFFFF
        slot = (mixed ^ (mixed >> 15)) & (size - 1)
        while slot in held and held[slot] != cells:
            slot = (slot + 1) & (size - 1)
        if slot not in held:
            held[slot] = cells
            table[slot] = entry
