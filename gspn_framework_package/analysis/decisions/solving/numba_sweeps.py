"""The loops over a model compiled by numba; the import fails if numba is not installed."""

from __future__ import annotations

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.machine_code import KeptCode


@KeptCode
def sweep(
    tangible: Booleans,
    rows: Indices,
    arcs: Indices,
    targets: Indices,
    data: Floats,
    constant: Floats,
    share: Floats,
    gain: float,
    backward: bool,
    values: Floats,
) -> None:
    """One Gauss-Seidel sweep of the highest values, in place."""
    size = len(values)
    for i in range(size):
        state = size - 1 - i if backward else i
        first, last = rows[state], rows[state + 1]
        if tangible[state]:
            total = constant[first] - gain
            for k in range(arcs[first], arcs[first + 1]):
                total += data[k] * values[targets[k]]
            values[state] = total * share[state]
            continue
        best = 0.0
        for row in range(first, last):
            total = constant[row]
            for k in range(arcs[row], arcs[row + 1]):
                total += data[k] * values[targets[k]]
            if row == first or total > best:
                best = total
        values[state] = best


@KeptCode
def backed_up(
    arcs: Indices,
    targets: Indices,
    data: Floats,
    constant: Floats,
    values: Floats,
    result: Floats,
) -> None:
    """The value of each row: its constant, and its arcs times the values they lead to."""
    for row in range(len(result)):
        total = constant[row]
        for k in range(arcs[row], arcs[row + 1]):
            total += data[k] * values[targets[k]]
        result[row] = total


@KeptCode
def settle(
    order: Indices,
    blocks: Indices,
    cyclic: Booleans,
    rows: Indices,
    arcs: Indices,
    targets: Indices,
    data: Floats,
    constant: Floats,
    chosen: Indices,
    tolerance: float,
    most: int,
    values: Floats,
) -> bool:
    """Set the values of the vanishing states from those of the tangible ones, block by block in
    ``order``; a cyclic block is repeated until nothing changes by more than ``tolerance``.
    ``chosen``: the row of each state, or empty for the best. Returns whether all blocks settled."""
    settled = True
    free = len(chosen) == 0
    for block in range(len(cyclic)):
        for turn in range(most):
            change = 0.0
            for i in range(blocks[block], blocks[block + 1]):
                state = order[i]
                first, last = rows[state], rows[state + 1]
                if not free:
                    first = chosen[state]
                    last = first + 1
                best = 0.0
                for row in range(first, last):
                    total = constant[row]
                    for k in range(arcs[row], arcs[row + 1]):
                        total += data[k] * values[targets[k]]
                    if row == first or total > best:
                        best = total
                change = max(change, abs(best - values[state]))
                values[state] = best
            if not cyclic[block] or change <= tolerance:
                break
            if turn == most - 1:
                settled = False
    return settled
