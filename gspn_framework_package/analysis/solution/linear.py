"""The linear systems of Markov chains, ``x = (b + M x) / d``, and their solvers.

Small systems are solved by sparse LU decomposition, large ones by Gauss-Seidel sweeps (compiled by
numba if it is installed, otherwise one triangular solve per sweep) with Anderson acceleration. An
answer is accepted by its residual, whatever the method. The residual is relative to the largest
term, so it says little about much smaller unknowns; :func:`polished` improves these.
"""

from __future__ import annotations

import warnings
from typing import Callable, NamedTuple, Optional, Tuple

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from gspn_framework_package.analysis.arrays import Floats, Indices, Matrix
from gspn_framework_package.analysis.compiling import numba_is_there
from gspn_framework_package.analysis.solution.anderson import Anderson, Vector, parts
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError

RESIDUAL_TOLERANCE = 1e-12
"""Residual at which the sweeps stop."""

ACCEPTED = 1e-9
"""A steady state with a larger residual is rejected."""

ACCEPTED_TIMES = 1e-4
"""Mean times and similar solutions with a larger residual are rejected. The residual bounds their
relative error, which is usually far smaller; rounding alone comes close only if a time is 10^11
times a sojourn."""

GTH_SIZE = 500
"""Stationary distributions over up to this many states are computed without subtractions."""

DIRECT_SIZE = 2_000
"""Up to this many unknowns, LU is tried first."""

FALLBACK_SIZE = 50_000
"""Up to this many unknowns, LU is tried if the sweeps fail."""

MAX_SWEEPS = 20_000

_REFINEMENTS = 2
"""Number of iterative refinements of an LU solution."""

_STRIDE = 2
"""Sweeps between two accelerations; an acceleration costs about as much as one sweep."""

_STALLED, _DAMPING = 250, 0.3
"""If the residual has not halved in this many strides, each sweep is damped: this share of the
values before it is kept. Sweeps over a chain in which time passes in cycles, as in Erlang phases,
may only turn the error around; the mean of two of its turns is smaller."""

_CHECKED = 8
"""The residual is computed after at most this many strides, and sooner once the changes are
small."""

_ROUNDING = 1e-14
"""Imbalance, relative to the largest term, that rounding alone may cause."""

_WORTH_LOADING = 50_000
"""Matrix entries above which compiled sweeps save more time than loading them takes."""

_POLISHED, _POLISHING = 5, 20
"""Number of sweeps between two computations of the relative changes of all unknowns, and largest
number of these, unless the solution itself took far more sweeps."""

_SLOWEST = 0.99
"""If changes shrink more slowly than by this factor, this factor is assumed."""

_SURE = 1e-9
"""Relative error of all unknowns at which polishing ends."""

_PATIENCE = 100
"""If the residual has not halved in this many strides, an acceptable answer is returned: the rest
is rounding."""


class LinearSolution(NamedTuple):
    """The solution of a linear system.

    :ivar values: float array: the unknowns.
    :ivar residual: see :func:`residual`.
    :ivar method: ``GTH``, ``LU`` or ``Gauss-Seidel``.
    :ivar sweeps: number of sweeps done.
    """

    values: Floats
    residual: float
    method: str
    sweeps: int = 0


def solve_linear(
    matrix: Matrix,
    diagonal: Floats,
    rhs: Optional[Floats],
    *,
    backward: bool = False,
    order: Optional[Indices] = None,
    watch: Optional[Watch] = None,
    direct: Optional[int] = None,
) -> LinearSolution:
    """Solve ``diagonal * x = rhs + matrix @ x``.

    :param matrix: sparse, non-negative, with an empty diagonal.
    :param diagonal: float array, all positive.
    :param rhs: float array; None for 0: then ``x`` is the solution that sums to 1.
    :param order: the order in which to sweep, as positions of unknowns; None: by number.
    :param backward: sweep from the last unknown to the first: better if information flows against
      the order.
    :param watch: receives progress, and may stop the sweeps.
    :param direct: up to this many unknowns, LU is tried first; None: :data:`DIRECT_SIZE`.
    :raises LimitError: no method reached a residual of :data:`ACCEPTED`, or :data:`ACCEPTED_TIMES`
      with a ``rhs``.
    :raises CancelledError: the watch cancelled the work.
    """
    matrix = sparse.csr_matrix(matrix)
    size = len(diagonal)
    direct = DIRECT_SIZE if direct is None else direct
    accepted = ACCEPTED if rhs is None else ACCEPTED_TIMES
    best: Optional[LinearSolution] = None
    if size <= direct:
        best = _direct(matrix, diagonal, rhs)
    if best is None or not best.residual <= accepted:
        best = _better(
            best, _swept_in_order(matrix, diagonal, rhs, backward, order, watch or Watch())
        )
    if not best.residual <= accepted and direct < size <= FALLBACK_SIZE:
        best = _better(best, _direct(matrix, diagonal, rhs))
    return demand(best, accepted)


def demand(found: LinearSolution, accepted: float = ACCEPTED) -> LinearSolution:
    """The solution, if its residual is small enough.

    :raises LimitError: the residual is too large.
    """
    if not found.residual <= accepted:
        raise LimitError(
            "the linear system was not solved: %s reached a residual of %.1e after %d sweeps"
            % (found.method, found.residual, found.sweeps)
        )
    return found


def residual(matrix: Matrix, diagonal: Floats, rhs: Optional[Floats], values: Floats) -> float:
    """The largest imbalance of an equation, relative to the largest term ``d x``, or to the largest
    entry of ``rhs``.

    With a ``rhs`` of ones (mean times) the latter bounds the relative error of every unknown: the
    inverse of the system has no negative entry, so the error is at most the imbalance times the
    solution for a ``rhs`` of ones.
    """
    terms = diagonal * values
    scale = float(np.abs(terms if rhs is None else rhs).max(initial=0.0))
    imbalance = terms - matrix @ values
    if rhs is not None:
        imbalance -= rhs
    worst = float(np.abs(imbalance).max(initial=0.0))
    return worst / scale if scale > 0 else worst


def _better(first: Optional[LinearSolution], second: LinearSolution) -> LinearSolution:
    return second if first is None or not first.residual <= second.residual else first


def _direct(matrix: Matrix, diagonal: Floats, rhs: Optional[Floats]) -> LinearSolution:
    """Sparse LU; for the homogeneous system, one unknown is set to 1 and its equation dropped."""
    size = len(diagonal)
    if rhs is None and size <= GTH_SIZE:
        found = _gth(matrix)
        if np.isfinite(found).all():
            return LinearSolution(found, residual(matrix, diagonal, rhs, found), "GTH")
    system = (sparse.diags(diagonal) - matrix).tocsc()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", linalg.MatrixRankWarning)
            if rhs is None:
                # The column sums vanish, so the reduced matrix is a non-singular M-matrix: LU is
                # stable on it.
                tail = linalg.splu(system[1:, 1:]).solve(-system[1:, 0].toarray().reshape(-1))
                values = np.concatenate([[1.0], np.maximum(tail, 0.0)])
                values /= values.sum()
            else:
                factor = linalg.splu(system)
                values = factor.solve(np.asarray(rhs, dtype=np.float64))
                for _ in range(_REFINEMENTS):
                    values += factor.solve(rhs - diagonal * values + matrix @ values)
    except (RuntimeError, MemoryError):  # singular, or out of memory
        return LinearSolution(np.full(size, np.nan), float("inf"), "LU")
    return LinearSolution(values, residual(matrix, diagonal, rhs, values), "LU")


def _gth(matrix: Matrix) -> Floats:
    """The stationary distribution by Gaussian elimination without subtractions, so that each entry
    has nearly all digits, however small (W. K. Grassmann, M. I. Taksar, D. P. Heyman, *Regenerative
    Analysis and Steady State Distributions for Markov Chains*, Operations Research 33, 1985)."""
    rates = matrix.T.toarray()
    size = len(rates)
    values = np.ones(size)
    with np.errstate(all="ignore"):  # a ratio that no float can hold gives no finite values
        for k in range(size - 1, 0, -1):
            rates[:k, k] /= rates[k, :k].sum()
            rates[:k, :k] += np.outer(rates[:k, k], rates[k, :k])
        for k in range(1, size):
            values[k] = values[:k] @ rates[:k, k]
        values /= values.sum()
    return values


def polished(
    matrix: Matrix,
    diagonal: Floats,
    rhs: Optional[Floats],
    found: LinearSolution,
    order: Optional[Indices] = None,
    watch: Optional[Watch] = None,
) -> Tuple[LinearSolution, Floats]:
    """A solution with more digits of its small unknowns, and the estimated relative error of each.

    Sweeps only add positive terms, so each unknown gets as many digits as those it depends on. The
    error is estimated from the rate at which the changes shrink. The arguments are those of
    :func:`solve_linear`, with the solution.
    """
    size = len(diagonal)
    rounding = np.finfo(float).eps * size
    if found.method == "GTH":
        return found, np.full(size, rounding)
    if order is not None:
        place, matrix = _in_order(matrix, order)
        rhs = None if rhs is None else rhs[order]
        found = found._replace(values=found.values[order])
        there, errors = polished(matrix, diagonal[order], rhs, found, None, watch)
        return there._replace(values=there.values[place]), errors[place]
    constant = np.zeros(size) if rhs is None else np.asarray(rhs, dtype=np.float64)
    sweep = sweeper(matrix, diagonal, constant, False)
    values = np.maximum(found.values, 0.0)  # rounding may have left negative values
    before, errors = np.ones(size), np.ones(size)
    most = max(_POLISHING, found.sweeps // (2 * _POLISHED))
    for number in range(1, most + 1):
        earlier = values.copy()
        for _ in range(_POLISHED):
            values = sweep(values)
        if rhs is None:
            values /= values.sum()
        with np.errstate(divide="ignore", invalid="ignore"):
            change = np.where(values > 0, np.abs(values - earlier) / values, 0.0)
            speed = np.clip(np.where(before > 0, change / before, 0.0), 0.0, _SLOWEST)
        errors = np.minimum(change * (speed / (1 - speed) + 1), 1.0) + rounding
        if number > 1 and float(errors.max(initial=0.0)) <= _SURE:
            break
        before = change
        if watch is not None:
            watch.step("sweeps for the small values", number * _POLISHED)
    worst = residual(matrix, diagonal, rhs, values)
    return LinearSolution(values, worst, found.method, found.sweeps), errors


def _in_order(matrix: Matrix, order: Indices) -> Tuple[Indices, Matrix]:
    """The new position of each unknown, and the matrix with its unknowns in another order."""
    place = np.empty(len(order), dtype=matrix.indices.dtype)
    place[order] = np.arange(len(order), dtype=place.dtype)
    matrix = matrix[order]
    matrix.indices = place[matrix.indices]
    matrix.has_sorted_indices = False
    return place, matrix


def _swept_in_order(
    matrix: Matrix,
    diagonal: Floats,
    rhs: Optional[Floats],
    backward: bool,
    order: Optional[Indices],
    watch: Watch,
) -> LinearSolution:
    if order is None:
        return _swept(matrix, diagonal, rhs, backward, watch)
    place, sorted_matrix = _in_order(matrix, order)
    sorted_rhs = None if rhs is None else rhs[order]
    found = _swept(sorted_matrix, diagonal[order], sorted_rhs, backward, watch)
    return found._replace(values=found.values[place])


def _swept(
    matrix: Matrix,
    diagonal: Floats,
    rhs: Optional[Floats],
    backward: bool,
    watch: Watch,
) -> LinearSolution:
    size = len(diagonal)
    constant = np.zeros(size) if rhs is None else np.asarray(rhs, dtype=np.float64)
    values = np.full(size, 1.0 / size) if rhs is None else np.zeros(size)
    return iterate(
        sweeper(matrix, diagonal, constant, backward),
        lambda image: residual(matrix, diagonal, rhs, image),
        values,
        diagonal,
        watch,
        scale=None if rhs is None else float(np.abs(constant).max()) or 1.0,
    )


def iterate(
    sweep: Callable[[Floats], Floats],
    residual_of: Callable[[Floats], float],
    values: Floats,
    diagonal: Vector,
    watch: Watch,
    *,
    scale: Optional[float] = None,
    vector: Callable[[int], Vector] = np.empty,
) -> LinearSolution:
    """Repeat accelerated sweeps until the residual is small or stops shrinking.

    :param sweep: one sweep; it may change its argument.
    :param residual_of: the residual of some values, see :func:`residual`.
    :param values: the initial guess; it is overwritten.
    :param diagonal: all positive.
    :param scale: the largest entry of the right-hand side; None if that is 0: then the solution
        sums to 1.
    :param vector: creates the vectors that only this function uses. The sweeps get float arrays.
    """
    size = len(values)
    accelerated = Anderson(size, vector=vector)
    image = values
    point, best = vector(size), vector(size)
    for part in parts(size):
        point[part] = best[part] = image[part]
    best_residual = float("inf")
    halved, halved_at = best_residual, 0
    unchecked = sweeps = 0
    damped = False
    for stride in range(1, MAX_SWEEPS // _STRIDE + 1):
        for part in parts(size):
            image[part] = point[part]
        damped = damped or stride - halved_at >= _STALLED
        for _ in range(1 if damped else _STRIDE):
            image = sweep(image)
            sweeps += 1
        if damped:
            for part in parts(size):
                image[part] += _DAMPING * (point[part] - image[part])
        unchecked += 1
        # The change made by the sweeps shows, at no cost, when to compute the residual.
        largest, changed = _largest_terms(diagonal, point, image)
        tolerance = RESIDUAL_TOLERANCE
        if scale is None:
            changed /= largest or 1.0
        else:
            changed /= scale
            tolerance = max(RESIDUAL_TOLERANCE, _ROUNDING * largest / scale)
        if changed <= 2 * tolerance or unchecked >= _CHECKED:
            unchecked = 0
            now = residual_of(image)
            if now < 0.5 * halved:
                halved, halved_at = now, stride
            if now < best_residual:
                best_residual = now
                for part in parts(size):
                    best[part] = image[part]
            if now <= tolerance or (best_residual <= 1e-11 and stride - halved_at >= _PATIENCE):
                break
            if not np.isfinite(now) or now > 1e6 * best_residual:
                accelerated.forget()
                for part in parts(size):
                    point[part] = best[part]
                continue
            watch.step("sweeps (residual %.0e)" % now, sweeps)
        accelerated.next(point, image)
    total = 0.0
    for part in parts(size):
        image[part] = best[part]
        total += float(image[part].sum())
    if scale is None:
        image /= total
    return LinearSolution(image, best_residual, "Gauss-Seidel", sweeps)


def _largest_terms(diagonal: Vector, before: Vector, after: Floats) -> Tuple[float, float]:
    """The largest ``diagonal * after``, and the largest absolute ``diagonal * (after - before)``;
    at least 0."""
    largest = changed = 0.0
    for part in parts(len(after)):
        weights, values = diagonal[part], after[part]
        largest = max(largest, float((weights * values).max()))
        changed = max(changed, float(np.abs(weights * (values - before[part])).max()))
    return largest, changed


def sweeper(
    matrix: Matrix, diagonal: Floats, constant: Floats, backward: bool
) -> Callable[[Floats], Floats]:
    """One Gauss-Seidel sweep, as a function of the values; it may change them in place.

    It reads ``constant`` in each call, so the caller may change it."""
    worth = matrix.nnz >= _WORTH_LOADING
    sweep = _compiled_sweep() if worth else None
    if sweep is None:
        return _scipy_sweeper(matrix, diagonal, constant, backward)
    share = 1.0 / diagonal

    def compiled(values: Floats) -> Floats:
        sweep(matrix.indptr, matrix.indices, matrix.data, constant, share, values, backward, 0)
        return values

    return compiled


def sweep_rows(matrix: Matrix, diagonal: Floats, values: Floats, first: int) -> None:
    """One Gauss-Seidel sweep over some of the rows of ``diagonal * x = matrix @ x``, in place;
    compiled by numba if it is installed.

    :param matrix: these rows, sparse (CSR), with as many columns as there are ``values``.
    :param diagonal: float array: the diagonal in these rows.
    :param first: the number of the first of them.
    """
    sweep, rows = _compiled_sweep(), slice(first, first + len(diagonal))
    constant = np.zeros(len(diagonal))
    if sweep is not None:
        arrays = (matrix.indptr, matrix.indices, matrix.data)
        sweep(*arrays, constant, 1.0 / diagonal, values, False, first)
        return
    mine = values[rows].copy()
    values[rows] = 0.0
    constant += matrix @ values
    values[rows] = _scipy_sweeper(matrix[:, rows], diagonal, constant, False)(mine)


def _compiled_sweep() -> Optional[Callable[..., None]]:
    """The compiled sweep, if numba is installed."""
    if not numba_is_there():
        return None
    from gspn_framework_package.analysis.solution.numba_sweeps import gauss_seidel_sweep

    compiled: Callable[..., None] = gauss_seidel_sweep
    return compiled


def _scipy_sweeper(
    matrix: Matrix, diagonal: Floats, constant: Floats, backward: bool
) -> Callable[[Floats], Floats]:
    own = sparse.diags(diagonal, format="csr")
    lower, upper = sparse.tril(matrix, -1, format="csr"), sparse.triu(matrix, 1, format="csr")
    solved, known = (own - upper, lower) if backward else (own - lower, upper)
    # With the natural order and no pivoting, the LU decomposition of a triangular matrix is the
    # matrix itself.
    factor = linalg.splu(
        solved.tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )

    def triangular(values: Floats) -> Floats:
        return factor.solve(known @ values + constant)

    return triangular
