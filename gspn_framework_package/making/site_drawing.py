"""Positions for drawing the net of a plan for a map: the map once for each kind of robot, side by
side."""

from __future__ import annotations

import math
from typing import Mapping, Sequence

from gspn_framework_package.making.site_elements import MapNode, SiteMap
from gspn_framework_package.model.net import Point


class SiteDrawing:
    """Positions of the elements of the net.

    :param kinds: the kinds of robots, each of which has its own places.
    """

    LANE = 45

    def __init__(self, site: SiteMap, kinds: Sequence[str]) -> None:
        nodes = site.nodes
        lengths = sorted(
            math.hypot(nodes[e.source].x - nodes[e.target].x, nodes[e.source].y - nodes[e.target].y)
            for e in site.edges
        )
        lengths = [length for length in lengths if length > 0]
        usual = lengths[len(lengths) // 4] if lengths else 1.0
        extent = max(
            max(n.x for n in nodes.values()) - min(n.x for n in nodes.values()),
            max(n.y for n in nodes.values()) - min(n.y for n in nodes.values()),
        )
        self._scale = min(560 / usual, 40_000 / max(extent, usual))
        self._left = min(n.x for n in nodes.values())
        self._top = max(n.y for n in nodes.values())
        self._nodes: Mapping[str, MapNode] = nodes
        self._kinds = list(kinds)
        self._width = (max(n.x for n in nodes.values()) - self._left) * self._scale + 800

    def node(self, node: str, kind: str) -> Point:
        """A node, for robots of a kind."""
        found = self._nodes[node]
        x = 400 + self._kinds.index(kind) * self._width + (found.x - self._left) * self._scale
        return (round(x), round(700 + (self._top - found.y) * self._scale))

    def along(self, a: str, b: str, kind: str, share: float, lanes: float = 1.0) -> Point:
        """A point of the lane from a to b."""
        (ax, ay), (bx, by) = self.node(a, kind), self.node(b, kind)
        length = math.hypot(bx - ax, by - ay)
        ex, ey = ((bx - ax) / length, (by - ay) / length) if length else (1.0, 0.0)
        if not length:
            bx, by = ax + 300, ay
        off = lanes * self.LANE
        return (round(ax + share * (bx - ax) - ey * off), round(ay + share * (by - ay) + ex * off))

    def top(self, column: int, row: int) -> Point:
        """A point above the maps."""
        return (400 + column * 260, 100 + 120 * row)
