"""The steady state of a chain on disk: Gauss-Seidel sweeps that read the matrix in parts."""

from __future__ import annotations

import itertools
from typing import Any, Dict, Iterator, List, Tuple

import numpy as np
from scipy import sparse

from gspn_framework_package.analysis.arrays import Booleans, Floats
from gspn_framework_package.analysis.on_disk.chain import OnDiskChain
from gspn_framework_package.analysis.on_disk.scratch import ScratchVector
from gspn_framework_package.analysis.solution.anderson import ANDERSON_DEPTH
from gspn_framework_package.analysis.solution.linear import (
    DIRECT_SIZE,
    LinearSolution,
    demand,
    iterate,
    solve_linear,
    sweep_rows,
)
from gspn_framework_package.analysis.solution.measures import Measures, waiting_times
from gspn_framework_package.analysis.state_space.marking_store import PackedStore
from gspn_framework_package.analysis.state_space.numpy_engine import enabled
from gspn_framework_package.analysis.state_space.rated_graph import firing_rate
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import RefusedError

_VECTORS = 2 * ANDERSON_DEPTH + 4
"""Vectors on disk while the system is solved."""


def steady_state_on_disk(
    chain: OnDiskChain, watch: Watch, direct: int = DIRECT_SIZE
) -> Dict[str, Any]:
    """The steady state, with the same keys as in the report of an analysis in memory.

    :param direct: up to this many recurrent states are solved in memory.
    :raises RefusedError: the chain may end in one of several recurrent classes.
    :raises LimitError: the linear system was not solved, or the disk is full.
    """
    dead = np.zeros(len(chain), dtype=bool)
    for part, exits in _with_exits(chain):
        dead[part] = exits == 0
    recurs = _recurrent(chain, dead)
    recurrent = int(recurs.sum())
    if recurrent == 1:
        found = LinearSolution(recurs.astype(np.float64), 0.0, "LU")
    else:
        found = (_solved_in_memory if recurrent <= direct else _solved)(chain, recurs, watch)
    net, space = chain.space.net, chain.space
    means, rates, distributions = _measured(chain, found.values, watch)
    best = int(found.values.argmax())
    marking = space.packed.unpack(space.code.decode(chain.tangible.read(best, best + 1)))[0]
    names = [place.name for place in net.places]
    mean_tokens = dict(zip(names, means))
    throughput = {t.name: value for t, value in zip(net.transitions, rates)}
    deadlock = bool(dead.any())
    only = {"states": recurrent, "probability": 1.0, "deadlock": deadlock, "alike": 1}
    return {
        "mean_tokens": mean_tokens,
        "throughput": throughput,
        "token_distribution": {
            name: {str(count): value for count, value in counts.items()}
            for name, counts in zip(names, distributions)
        },
        "mean_waiting_time": waiting_times(net, mean_tokens, throughput),
        "residual": found.residual,
        "method": found.method,
        "components": [{**only, "marking": net.named(tuple(marking.tolist()), zeros=False)}],
        "component_count": 1,
        "deadlock_count": int(deadlock),
        "probability_of_other_components": 0.0,
    }


def _recurrent(chain: OnDiskChain, dead: Booleans) -> Booleans:
    """Boolean array: which states recur.

    :param dead: boolean array: the states that nothing leaves.
    :raises RefusedError: there are several recurrent classes.
    """
    begins_there = False
    if dead.any():
        state = int(np.flatnonzero(dead)[-1])
    else:
        # the initial state if it is tangible, since it reaches all others
        begins_there = bool(chain.initial.any())
        state = int(np.flatnonzero(chain.initial)[-1]) if begins_there else 0
    while True:
        lead_there = chain.reaching(state)
        if lead_there.all():
            return lead_there if begins_there else chain.reached(state)
        left = np.flatnonzero(chain.reached(state) & ~lead_there)
        if not len(left):  # it is recurrent, and some states never lead to it
            raise RefusedError(
                "the chain may end in one of several recurrent classes",
                hint="raise --memory until the whole chain fits",
            )
        state, begins_there = int(left[-1]), False


def _with_exits(chain: OnDiskChain) -> Iterator[Tuple[slice, Floats]]:
    for part, _ in chain.parts():
        yield part, chain.exit_rates[part]


def _solved_in_memory(chain: OnDiskChain, recurs: Booleans, watch: Watch) -> LinearSolution:
    kept = np.flatnonzero(recurs)
    rows = [rates[recurs[part]][:, kept] for part, rates in chain.blocks()]
    exits = np.concatenate([exits[recurs[part]] for part, exits in _with_exits(chain)])
    solution = solve_linear(sparse.vstack(rows).tocsr(), exits, None, watch=watch)
    values = np.zeros(len(chain))
    values[kept] = solution.values
    return solution._replace(values=values)


def _solved(chain: OnDiskChain, recurs: Booleans, watch: Watch) -> LinearSolution:
    scratch = chain.space.scratch
    scratch.require(8 * _VECTORS * len(chain))
    vectors: List[ScratchVector] = []

    def vector(size: int) -> ScratchVector:
        vectors.append(ScratchVector(scratch, size))
        return vectors[-1]

    sweeps = itertools.count(1)

    def sweep(values: Floats) -> Floats:
        what = "states in sweep %d" % next(sweeps)
        for part, rates in chain.blocks():
            watch.step(what, part.start)
            sweep_rows(rates, chain.exit_rates[part], values, part.start)
        return values

    def residual_of(values: Floats) -> float:
        wrong = scale = 0.0
        for part, rates in chain.blocks():
            terms = chain.exit_rates[part] * values[part]
            wrong = max(wrong, float(np.abs(terms - rates @ values).max()))
            scale = max(scale, float(terms.max()))
        return wrong / scale if scale > 0 else wrong

    begin = recurs / np.count_nonzero(recurs)
    try:
        found = iterate(sweep, residual_of, begin, chain.exit_rates, watch, vector=vector)
    finally:
        for used in vectors:
            used.close()
    return demand(found)


def _measured(
    chain: OnDiskChain, shares: Floats, watch: Watch
) -> Tuple[List[float], List[float], List[Dict[int, float]]]:
    """Mean tokens of each place, throughput (1/s) of each transition, and for each place: number
    of tokens -> probability."""
    space = chain.space
    packed, net = space.packed, space.net
    distributions: List[Dict[int, float]] = [{} for _ in net.places]
    throughput = np.zeros(len(net.transitions))
    for part, keys in chain.parts():
        watch.step("states measured", part.start)
        words = space.code.decode(keys)
        store = PackedStore(packed, words)
        for total, counts in zip(
            distributions, store.distributions(np.arange(len(words)), shares[part])
        ):
            for count, share in counts.items():
                total[count] = total.get(count, 0.0) + share
        if not space.counts.vanishing:
            sources, fired = enabled(packed, words)
            for row, t in enumerate(packed.order.tolist()):
                states = sources[fired == row]
                rates = firing_rate(net, t, store, states)
                throughput[t] += float((shares[part][states] * rates).sum())
    if space.counts.vanishing:
        for part, window in chain.windows():
            watch.step("states measured", part.start)
            weights = np.zeros(len(window))
            weights[: part.stop - part.start] = shares[part]
            throughput += list(Measures(window, weights).throughput.values())
    means = [sum(count * share for count, share in counts.items()) for counts in distributions]
    return means, throughput.tolist(), [dict(sorted(c.items())) for c in distributions]
