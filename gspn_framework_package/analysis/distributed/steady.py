"""The steady state of a chain whose states are distributed over ranks.

Each rank sweeps its own states (Gauss-Seidel) with the values that the others had before, so that
between ranks it is a Jacobi iteration; Anderson acceleration spans them all.
"""

from __future__ import annotations

from typing import Dict, List, Tuple

import numpy as np
from scipy import sparse

from gspn_framework_package.analysis.arrays import Booleans, Floats
from gspn_framework_package.analysis.distributed.long_run import (
    SEVERAL_CLASSES,
    LongRun,
    recurrent_states,
)
from gspn_framework_package.analysis.distributed.ranks import AgreedWatch
from gspn_framework_package.analysis.distributed.rates import RankChain
from gspn_framework_package.analysis.solution.linear import (
    DIRECT_SIZE,
    LinearSolution,
    Reduction,
    demand,
    iterate,
    solve,
    sweeper,
)
from gspn_framework_package.analysis.solution.measures import Measures
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import RefusedError

_STEP = 0.9
"""A sweep goes this share of its way. A whole one would only pass values around where the ranks are
visited in turn, such as two ranks with one state each."""


def steady_share(chain: RankChain, watch: Watch, direct: int = DIRECT_SIZE) -> LongRun:
    """Where the chain is in the long run. All ranks call it together.

    :param direct: up to this many states, every rank solves the whole chain.
    :raises RefusedError: the chain may end in one of several recurrent classes.
    :raises LimitError: the linear system was not solved.
    """
    ranks = chain.ranks
    # the initial state, if it is tangible and of this rank
    initial = np.zeros(len(chain), dtype=bool)
    initial[:1] = chain.states.has_initial and not chain.states.vanishing[0]
    dead = chain.exit_rates == 0
    recurs = recurrent_states(ranks, dead, initial, chain.reaching, chain.reached)
    if recurs is None:
        raise RefusedError(SEVERAL_CLASSES, hint="leave --on out, which tells them apart")
    recurrent = int(ranks.total(int(recurs.sum())))
    if recurrent == 1:
        deadlock = bool(ranks.total(int((chain.exit_rates == 0).sum())))
        return LongRun(recurs.astype(np.float64), 1, deadlock, 0.0, "LU")
    if recurrent <= direct:
        found = _solved_by_each(chain, recurs)
    else:
        found = _solved_together(chain, recurs, recurrent, watch)
    return LongRun(found.values, recurrent, False, found.residual, found.method)


def _solved_by_each(chain: RankChain, recurs: Booleans) -> LinearSolution:
    ranks = chain.ranks
    begin = int(chain.first[ranks.rank])
    near, far = chain.near.tocoo(), chain.far.tocoo()
    outside = chain.fetch(np.arange(len(chain)) + begin)
    rows = np.concatenate([near.row, far.row]) + begin
    columns = np.concatenate([near.col + begin, outside[far.col]])
    values = np.concatenate([near.data, far.data])
    told = ranks.gather((rows, columns, values, recurs, chain.exit_rates))
    every_row, every_column, every_value, every_recurs, exits = (
        np.concatenate(parts) for parts in zip(*told)
    )
    whole = sparse.csr_matrix(
        (every_value, (every_row, every_column)), shape=(chain.total, chain.total)
    )
    kept = np.flatnonzero(every_recurs)
    solution = solve(whole[kept][:, kept], exits[kept], None)
    shares = np.zeros(chain.total)
    shares[kept] = solution.values
    return solution._replace(values=shares[begin : begin + len(chain)])


def _solved_together(
    chain: RankChain, recurs: Booleans, recurrent: int, watch: Watch
) -> LinearSolution:
    ranks = chain.ranks
    reduction = Reduction(ranks.total, lambda numbers: np.max(ranks.gather(numbers), axis=0))
    inflow = np.zeros(len(chain))
    near_sweep = sweeper(chain.near, chain.exit_rates, inflow, False) if len(chain) else None

    def sweep(values: Floats) -> Floats:
        inflow[:] = chain.far @ chain.fetch(values)
        kept = (1.0 - _STEP) * values
        return kept if near_sweep is None else kept + _STEP * near_sweep(values)

    def residual_of(values: Floats) -> float:
        terms = chain.exit_rates * values
        imbalance = terms - chain.near @ values - chain.far @ chain.fetch(values)
        extremes = [np.abs(part).max(initial=0.0) for part in (imbalance, terms)]
        wrong, scale = reduction.largest(np.array(extremes)).tolist()
        return wrong / scale if scale > 0 else wrong

    found = iterate(
        sweep,
        residual_of,
        np.where(recurs, 1.0 / recurrent, 0.0),
        chain.exit_rates,
        AgreedWatch(ranks, watch),
        reduction=reduction,
    )
    return demand(found)


def measured(chain: RankChain, shares: Floats) -> Tuple[List[float], List[float]]:
    """Mean tokens of each place and throughput (1/s) of each transition, of all ranks."""
    net = chain.states.packed.net
    throughput = np.zeros(len(net.transitions))
    for part, window in chain.windows():
        weights = np.zeros(len(window))
        weights[: part.stop - part.start] = shares[part]
        throughput += list(Measures(window, weights).throughput.values())
    means = np.array(chain.states.store.means(chain.tangible, shares))
    return chain.ranks.total(means).tolist(), chain.ranks.total(throughput).tolist()


def token_distribution(chain: RankChain, shares: Floats) -> List[Dict[int, float]]:
    """For each place: number of tokens -> probability, of all ranks."""
    mine = chain.states.store.distributions(chain.tangible, shares)
    merged: List[Dict[int, float]] = [{} for _ in mine]
    for found in chain.ranks.gather(mine):
        for place, counts in zip(merged, found):
            for count, value in counts.items():
                place[count] = place.get(count, 0.0) + value
    return [dict(sorted(counts.items())) for counts in merged]
