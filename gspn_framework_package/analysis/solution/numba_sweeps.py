"""Gauss-Seidel sweeps compiled by numba; the import fails if numba is not installed."""

from __future__ import annotations

from gspn_framework_package.analysis.arrays import Floats, Indices
from gspn_framework_package.analysis.machine_code import KeptCode


@KeptCode
def gauss_seidel_sweep(
    offsets: Indices,
    columns: Indices,
    data: Floats,
    constant: Floats,
    share: Floats,
    values: Floats,
    backward: bool,
    first: int,
) -> None:
    """One sweep of ``values = (constant + matrix @ values) * share``, in place; the matrix is in
    CSR form. The matrix, ``constant`` and ``share`` may cover only some rows, from ``first`` on."""
    size = len(share)
    for i in range(size):
        row = size - 1 - i if backward else i
        total = constant[row]
        for k in range(offsets[row], offsets[row + 1]):
            total += data[k] * values[columns[k]]
        values[first + row] = total * share[row]
