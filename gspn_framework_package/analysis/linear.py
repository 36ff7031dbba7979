"""The linear systems of Markov chains, ``x = (b + M x) / d``, and who solves them.

Small systems go to a sparse LU decomposition, large ones to Gauss-Seidel sweeps (compiled by numba where it is
there, else a triangular solve per sweep). Nobody is believed: the residual of the answer decides.
"""

from __future__ import annotations

import warnings
from typing import Any, Callable, NamedTuple, Optional

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from gspn_framework_package.analysis.exploration import Watch
from gspn_framework_package.model.errors import LimitError

TOLERANCE = 1e-13
"""Residual at which sweeps stop."""

ACCEPTED = 1e-9
"""Residual above which an answer is not given."""

DIRECT_SIZE = 2_000
"""Up to this many unknowns LU goes first."""

FALLBACK_SIZE = 50_000
"""Up to this many unknowns LU is tried where the sweeps fail."""

MAX_SWEEPS = 20_000


class Solution(NamedTuple):
    """``values``; ``residual``: the largest imbalance of an equation, relative to the largest term ``d x``;
    ``method``: ``LU``, ``Gauss-Seidel`` or ``GTH``; ``sweeps``: how many were done."""

    values: Any
    residual: float
    method: str
    sweeps: int = 0


def solve(
    matrix: Any,
    diagonal: Any,
    rhs: Optional[Any],
    *,
    backward: bool = False,
    watch: Optional[Watch] = None,
    start: Optional[Any] = None,
) -> Solution:
    """Solve ``diagonal * x = rhs + matrix @ x``.

    :param matrix: sparse, non-negative, nothing on its diagonal.
    :param diagonal: float array, above 0.
    :param rhs: float array; None for 0: then ``x`` is the solution that sums to 1.
    :param backward: sweep from the last unknown to the first: better where information flows against the
        numbering.
    :param start: a first guess.
    :raises LimitError: no method came to a residual of :data:`ACCEPTED`.
    :raises CancelledError: the watch said so.
    """
    matrix = sparse.csr_matrix(matrix)
    size = len(diagonal)
    best: Optional[Solution] = None
    if size <= DIRECT_SIZE:
        best = _direct(matrix, diagonal, rhs)
    if best is None or not best.residual <= ACCEPTED:
        best = _better(best, _sweeps(matrix, diagonal, rhs, backward, watch or Watch(), start))
    if not best.residual <= ACCEPTED and DIRECT_SIZE < size <= FALLBACK_SIZE:
        best = _better(best, _direct(matrix, diagonal, rhs))
    if not best.residual <= ACCEPTED:
        raise LimitError(
            "the linear system was not solved: %s came to a residual of %.1e after %d sweeps"
            % (best.method, best.residual, best.sweeps)
        )
    return best


def residual(matrix: Any, diagonal: Any, rhs: Optional[Any], values: Any) -> float:
    """The largest imbalance of an equation, relative to the largest term."""
    terms = diagonal * values
    scale = float(np.abs(terms).max(initial=0.0))
    imbalance = terms - matrix @ values
    if rhs is not None:
        imbalance -= rhs
        scale = max(scale, float(np.abs(rhs).max(initial=0.0)))
    worst = float(np.abs(imbalance).max(initial=0.0))
    return worst / scale if scale > 0 else worst


def _better(first: Optional[Solution], second: Solution) -> Solution:
    return second if first is None or not first.residual <= second.residual else first


def _direct(matrix: Any, diagonal: Any, rhs: Optional[Any]) -> Solution:
    """Sparse LU; of the homogeneous system one unknown is set to 1 and its equation left out."""
    size = len(diagonal)
    if rhs is None and size == 1:
        return Solution(np.ones(1), 0.0, "LU")
    system = (sparse.diags(diagonal) - matrix).tocsc()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", linalg.MatrixRankWarning)
            if rhs is None:
                # The column sums vanish, so the reduced matrix is a non-singular M-matrix: LU is stable on it.
                tail = linalg.splu(system[1:, 1:]).solve(-system[1:, 0].toarray().reshape(-1))
                values = np.concatenate([[1.0], np.maximum(tail, 0.0)])
                values /= values.sum()
            else:
                values = linalg.splu(system).solve(np.asarray(rhs, dtype=np.float64))
    except (RuntimeError, MemoryError):  # singular, or it does not fit
        return Solution(np.full(size, np.nan), float("inf"), "LU")
    return Solution(values, residual(matrix, diagonal, rhs, values), "LU")


def _sweeps(
    matrix: Any, diagonal: Any, rhs: Optional[Any], backward: bool, watch: Watch, start: Optional[Any]
) -> Solution:
    scaled = matrix.copy()
    scaled.data = matrix.data / np.repeat(diagonal, np.diff(matrix.indptr))
    constant = None if rhs is None else np.asarray(rhs, dtype=np.float64) / diagonal
    sweep = _sweeper(scaled, constant, backward)
    size = len(diagonal)
    if start is None:
        values = np.full(size, 1.0 / size) if rhs is None else np.zeros(size)
    else:
        values = np.array(start, dtype=np.float64)
    best, best_residual, best_at = values.copy(), float("inf"), 0
    done, pause = 0, 4
    while done < MAX_SWEEPS:
        for _ in range(pause):
            values = sweep(values)
        done += pause
        if rhs is None:
            values /= values.sum()
        now = residual(matrix, diagonal, rhs, values)
        if now < 0.5 * best_residual:
            best_at = done
        if now < best_residual:
            best, best_residual = values.copy(), now
        if now <= TOLERANCE or not np.isfinite(now):
            break
        if best_residual <= 1e-11 and done - best_at >= 200:
            break  # rounding: it will not get better
        pause = min(16, 2 * pause)
        watch.step("sweeps (residual %.0e)" % now, done)
    return Solution(best, best_residual, "Gauss-Seidel", done)


def _sweeper(scaled: Any, constant: Optional[Any], backward: bool) -> Callable[[Any], Any]:
    """One Gauss-Seidel sweep, as a function of the values; it may change them in place."""
    try:
        from gspn_framework_package.analysis.numba_sweeps import sweep
    except ImportError:
        return _scipy_sweeper(scaled, constant, backward)
    if constant is None:
        constant = np.zeros(scaled.shape[0])

    def compiled(values: Any) -> Any:
        sweep(scaled.indptr, scaled.indices, scaled.data, constant, values, backward)
        return values

    return compiled


def _scipy_sweeper(scaled: Any, constant: Optional[Any], backward: bool) -> Callable[[Any], Any]:
    eye = sparse.identity(scaled.shape[0], format="csr")
    lower, upper = sparse.tril(scaled, -1, format="csr"), sparse.triu(scaled, 1, format="csr")
    solved, known = (eye - upper, lower) if backward else (eye - lower, upper)
    # With the natural order and no pivoting the decomposition of a triangular matrix is that matrix.
    factor = linalg.splu(solved.tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    def triangular(values: Any) -> Any:
        right = known @ values
        return factor.solve(right if constant is None else right + constant)

    return triangular
