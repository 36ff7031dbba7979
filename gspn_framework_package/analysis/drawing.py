"""Coverability trees and Markov chains as graphs for Graphviz ("draw other models such as a CTMC",
thesis ch. 4)."""

from __future__ import annotations

from typing import Dict, Mapping, Sequence

import numpy as np

from gspn_framework_package.analysis.chain.markov_chain import Chain
from gspn_framework_package.analysis.state_space.coverability import OMEGA, CoverabilityTree
from gspn_framework_package.formats.dot import Attribute, Graph
from gspn_framework_package.model.net import Net

_MAX_LAYERED = 60
"""Largest chain (in states) that is drawn in layers, with its rates. A larger one would give long
rows of nodes with all arcs between them, and numbers that cannot be matched to their arcs."""

_LAYERED: Mapping[str, Attribute] = {
    "rankdir": "TB",
    "layout": "dot",
    "nodesep": 0.4,
    "ranksep": 0.6,
}

_MERGED = 1e-12  # smaller probabilities are rounding errors of the elimination


def tree_graph(tree: CoverabilityTree) -> Graph:
    """The coverability tree: each node is a marking, each arc a firing. The root is bold. A marking
    that is already in the tree is dashed and has no children; one that enables nothing is red."""
    net = tree.net
    graph = _graph(net.name)
    inner = {node.parent for node in tree.nodes}
    for number, node in enumerate(tree.nodes):
        looks: Dict[str, Attribute] = {"label": _text(net, node.marking)}
        if number == 0:
            looks["penwidth"] = 2.5
        if node.same != number:
            looks["style"] = "rounded,dashed,filled"
        elif number not in inner:
            looks["color"] = "red"
        graph.node(str(number), **looks)
        if node.parent >= 0:
            graph.edge(str(node.parent), str(number), label=net.transitions[node.transition].name)
    return graph


def chain_graph(chain: Chain, note: str = "") -> Graph:
    """The Markov chain: each node is a tangible marking, each arc has a rate (1/s). Initial states
    are bold, with their probabilities if there are several; absorbing states are red.

    :param note: a line of text below the drawing; with a note, the drawing shows no rates.
    """
    net = chain.graph.net
    graph = _graph(net.name, {"label": note} if note else {}, large=len(chain) > _MAX_LAYERED)
    starts = int(np.count_nonzero(chain.initial > _MERGED))
    markings = chain.graph.markings(chain.states)
    for number in range(len(chain)):
        label = _text(net, markings[number].tolist())
        for part, robots in chain.graph.named_parts(int(chain.states[number])).items():
            label += "\n%s" % part if robots == 1 else "\n%d %s" % (robots, part)
        looks: Dict[str, Attribute] = {}
        if chain.initial[number] > _MERGED:
            looks["penwidth"] = 2.5
            if starts > 1:
                label += "\nstart %.4g" % chain.initial[number]
        if chain.exit_rates[number] == 0:
            looks["color"] = "red"
        graph.node(str(number), label=label, **looks)
    rates = chain.rates.tocoo()
    for source, target, rate in sorted(
        zip(rates.row.tolist(), rates.col.tolist(), rates.data.tolist())
    ):
        # without the spaces, two adjacent labels read as one number
        shown: Dict[str, Attribute] = {} if note else {"label": " %.4g " % rate}
        graph.edge(str(source), str(target), **shown)
    return graph


def note_of_rates_left_out(chain: Chain) -> str:
    """The note for a chain too large to be drawn with rates; empty for a smaller chain."""
    if len(chain) <= _MAX_LAYERED:
        return ""
    return (
        "%d states; the rates of the %d arcs are left out; gspn convert --to drn has them, and -o "
        "OUT.dot"
        % (
            len(chain),
            chain.rates.nnz,
        )
    )


def _graph(name: str, attributes: Mapping[str, Attribute] = {}, large: bool = False) -> Graph:
    # Nodes are white and drawn over the arcs, so that no arc crosses the text of a node.
    graph = Graph(
        name,
        fontname="Helvetica",
        **({"layout": "sfdp", "overlap": "prism", "splines": "false"} if large else _LAYERED),
        outputorder="edgesfirst",
        **attributes,
    )
    graph.defaults(
        "node",
        fontname="Helvetica",
        fontsize=10,
        shape="box",
        style="rounded,filled",
        fillcolor="white",
        height=0.3,
    )
    graph.defaults("edge", fontname="Helvetica", fontsize=9, arrowsize=0.7)
    return graph


def _text(net: Net, counts: Sequence[int]) -> str:
    """A marking without its empty places: ``2 a, b, ω c``."""
    shown = []
    for place, n in zip(net.places, counts):
        if n:
            shown.append(place.name if n == 1 else "%s %s" % ("ω" if n == OMEGA else n, place.name))
    return ", ".join(shown) or "empty"
