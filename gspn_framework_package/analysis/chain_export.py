"""Converts a computed Markov chain for export to a model checker."""

from __future__ import annotations

from typing import Mapping

import numpy as np

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.formats.markov_chain import ExplicitChain
from gspn_framework_package.model.errors import RefusedError

_ROUNDING = 1e-12


def explicit_chain(analysis: Analysis, labels: Mapping[str, str] = {}) -> ExplicitChain:
    """The explicit chain of a net, or of a plan under its policy.

    :param labels: label -> condition on markings.
    :raises LimitError: the state space is larger than the limit.
    :raises RefusedError: there is no chain, or its initial state is random, which the formats
        cannot express.
    :raises ExpressionError: a condition cannot be parsed.
    """
    chain = analysis.chain
    starts = np.flatnonzero(chain.initial > _ROUNDING)
    if len(starts) != 1:
        raise RefusedError(
            "the initial state is random (%d states), which files of model checkers cannot express"
            % len(starts),
            hint="start from a marking that enables no immediate transition",
        )
    rates = chain.rates.tocoo()
    graph = chain.graph
    states = graph.markings(chain.states)
    if graph.part_counts is not None:  # several states may have the same marking
        states = np.hstack([states, graph.part_counts[chain.states]])
    return ExplicitChain(
        [*(place.name for place in graph.net.places), *graph.parts],
        states.tolist(),
        list(zip(rates.row.tolist(), rates.col.tolist(), rates.data.tolist())),
        int(starts[0]),
        {
            label: np.flatnonzero(analysis.space.holds(condition)[chain.states]).tolist()
            for label, condition in labels.items()
        },
    )
