"""Compares nets regardless of drawing and order."""

from __future__ import annotations

import math
from typing import Any, Tuple, Union

from gspn_framework_package.model.net import Net, Place, Transition

Node = Union[Place, Transition]

CLOSE = 1e-5
"""Relative tolerance of positions that are read back (absolute below 1)."""


def same_net(a: Net, b: Net) -> bool:
    """Whether two nets are equivalent; the order of their elements does not matter."""
    if len(a.places) != len(b.places) or len(a.transitions) != len(b.transitions):
        return False
    for mine, others in ((a.places, b.places), (a.transitions, b.transitions)):
        named = {node.name: node for node in others}
        for node in mine:
            other = named.get(node.name)
            if other is None or not same_node(node, other):
                return False
    return sorted(a.arcs) == sorted(b.arcs)


def same_node(a: Node, b: Node) -> bool:
    """Whether two nodes are equal, up to the rounding of their positions."""
    if (a.position is None) != (b.position is None):
        return False
    if a.position is not None and b.position is not None:
        for x, y in zip(a.position, b.position):
            if not math.isclose(x, y, rel_tol=CLOSE, abs_tol=CLOSE):
                return False
    return meaning(a) == meaning(b)


def meaning(node: Node) -> Tuple[Any, ...]:
    """The node without its position, and without attributes that do not apply to its kind."""
    if isinstance(node, Place):
        return (node.name, node.tokens, node.capacity)
    if node.timed:
        return (node.name, True, node.rate, node.servers)
    return (node.name, False, node.weight, node.priority)
