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

    :param labels: label -> the condition on markings that it stands for.
    :raises LimitError: the state space is larger than the limit.
    :raises RefusedError: there is no chain, or its initial state is random, which the formats
        cannot express.
    :raises ExpressionError: a condition cannot be parsed.
    """
    chain = analysis.chain
    starts = np.flatnonzero(chain.initial > _ROUNDING)
    if len(starts) != 1:
        raise RefusedError(
            "the chain starts in one of %d states by chance, which model checkers' files cannot say"
            % len(starts),
            hint="begin in a marking that enables no immediate transition",
        )
    rates = chain.rates.tocoo()
    graph = chain.graph
    states = graph.markings(chain.states)
    if graph.part_counts is not None:  # several states may have one marking
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
