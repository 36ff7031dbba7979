"""Which nodes cannot reach which, as sets of directed pairs, and as nftables rules for a bridge."""

from __future__ import annotations

from typing import FrozenSet, Iterable, Sequence, Tuple

Cuts = FrozenSet[Tuple[str, str]]
"""Directed pairs (from, to): nothing that ``from`` sends arrives at ``to``."""

TABLE = "gspn_cuts"


def one_way(sources: Iterable[str], targets: Iterable[str]) -> Cuts:
    """Nothing gets from a source to a target; the other direction is open.

    >>> sorted(one_way(["a"], ["a", "b"]))
    [('a', 'b')]
    """
    targets = list(targets)
    return frozenset((s, t) for s in sources for t in targets if s != t)


def partition(groups: Sequence[Sequence[str]]) -> Cuts:
    """Nothing gets from one group to another.

    >>> sorted(partition([["a", "b"], ["c"]]))
    [('a', 'c'), ('b', 'c'), ('c', 'a'), ('c', 'b')]
    """
    pairs = [one_way(g, h) for i, g in enumerate(groups) for j, h in enumerate(groups) if i != j]
    return frozenset().union(*pairs)


def ruleset(cuts: Cuts, loss: float = 0.0) -> str:
    """The input of ``nft -f -`` that replaces, in one transaction, the earlier cuts. Each node's
    bridge port has the node's name; everything from port to port is dropped, ARP included.

    :param loss: share of the IP packets that are dropped at random, in steps of a thousandth.
    """
    lines = [
        "add table bridge " + TABLE,
        "delete table bridge " + TABLE,
        "table bridge %s {" % TABLE,
        "  chain cuts {",
    ]
    lines.append("    type filter hook forward priority 0; policy accept;")
    lines += ['    iifname "%s" oifname "%s" drop' % pair for pair in sorted(cuts)]
    if loss:
        lines.append("    ether type ip numgen random mod 1000 < %d drop" % round(1000 * loss))
    return "\n".join(lines + ["  }", "}", ""])
