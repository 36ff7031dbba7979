"""The policy of a plan for a map: go to the nearest task that is due, or to the nearest dock if the
battery is at its lowest level or nothing is due."""

from __future__ import annotations

from collections import deque
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

from gspn_framework_package.making.site_elements import MapEdge, SiteMap


class RobotKind(NamedTuple):
    """Robots with their own places in the net: their type, and the level of their battery.

    :ivar suffix: the suffix of their places.
    """

    type: str
    level: str
    suffix: str


class SiteMove(NamedTuple):
    """A choice of a robot: ``Go`` to a node, ``Start`` a task, or ``Dock`` at a node."""

    what: str
    to: str


class SiteRow(NamedTuple):
    """A row of the policy for a node: whether each task is due (1), not due (0), or either
    ("-")."""

    cells: Sequence[Any]
    node: str
    kind: RobotKind
    move: SiteMove


def ways_to(
    target: str, site: SiteMap, seconds: Callable[[MapEdge], float]
) -> Dict[str, Tuple[float, str]]:
    """Return (seconds, next node) for each node from which the target can be reached."""
    coming: Dict[str, List[MapEdge]] = {}
    for edge in site.edges:
        coming.setdefault(edge.target, []).append(edge)
    found = {target: (0.0, target)}
    front = deque([target])
    while front:
        node = front.popleft()
        for edge in coming.get(node, ()):
            time = found[node][0] + seconds(edge)
            if edge.source not in found or time < found[edge.source][0] - 1e-9:
                found[edge.source] = (time, node)
                front.append(edge.source)
    return found


class SitePolicy:
    """The rows for the robots of one type.

    :param site: the map for that type.
    :param due: the tasks, and their nodes.
    :param docks: the nodes where they charge.
    :param parking: the nodes where they wait while nothing is due; none: at the docks.
    :param kinds: its kinds, from the full battery to the lowest level.
    :param seconds: the time that an edge takes.
    """

    def __init__(
        self,
        site: SiteMap,
        due: Sequence[Tuple[str, str]],
        docks: Sequence[str],
        parking: Sequence[str],
        kinds: Sequence[RobotKind],
        seconds: Callable[[MapEdge], float],
    ) -> None:
        self._due, self._kinds = due, kinds
        here = [at for _, at in due if at in site.nodes]
        self._ways = {node: ways_to(node, site, seconds) for node in here}
        self._docks, self._parking = (
            {node: ways_to(node, site, seconds) for node in nodes if node in site.nodes}
            for nodes in (docks, parking or docks)
        )
        self._battery = len(kinds) > 1 or bool(kinds[0].level)
        self.stuck: Set[str] = set()
        """Nodes from which robots can reach neither a task nor a dock."""
        self.rows = [row for kind in kinds for node in site.nodes for row in self._rows(node, kind)]

    def _rows(self, node: str, kind: RobotKind) -> List[SiteRow]:
        found: List[SiteRow] = []
        charges = self._battery and kind != self._kinds[0]
        lowest = self._battery and kind == self._kinds[-1]
        home = self._docks if charges or lowest else self._parking
        near = [place for place in home if node in home[place]]
        place = min(near, key=lambda p: home[p][node][0]) if near else None
        go_home: Optional[SiteMove] = None
        if place is not None and place != node:
            go_home = SiteMove("Go", home[place][node][1])
        elif place == node and charges:
            go_home = SiteMove("Dock", node)
        cells: List[Any] = ["-"] * len(self._due)
        can = [k for k, (_, at) in enumerate(self._due) if node in self._ways.get(at, ())]
        if go_home and (not can or lowest):
            return [SiteRow([cell, *cells[1:]], node, kind, go_home) for cell in (0, 1)]
        for k in sorted(can, key=lambda k: self._ways[self._due[k][1]][node][0]):
            task, at = self._due[k]
            cells[k] = 1
            move = (
                SiteMove("Start", task) if at == node else SiteMove("Go", self._ways[at][node][1])
            )
            found.append(SiteRow(list(cells), node, kind, move))
            cells[k] = 0
        if go_home:
            found.append(SiteRow(list(cells), node, kind, go_home))
        elif not can:
            self.stuck.add(node)
        return found

    def reached(
        self,
        start: Sequence[str],
        drains: Mapping[str, float],
        stranded: Optional[str],
        anywhere: bool = False,
    ) -> List[SiteRow]:
        """Return the rows of the nodes that robots can reach if they move only by these rows.

        :param start: the nodes where robots start, with a full battery.
        :param drains: level -> probability that it ends on an edge.
        :param stranded: where a robot with an empty battery is brought.
        :param anywhere: more than one level may end on one edge.
        """
        by_node: Dict[Tuple[str, RobotKind], List[SiteRow]] = {}
        for row in self.rows:
            by_node.setdefault((row.node, row.kind), []).append(row)
        front = [(node, self._kinds[0]) for node in start]
        found = set(front)
        while front:
            for row in by_node.get(front.pop(), ()):
                for state in self._after(row, drains, stranded, anywhere):
                    if state not in found:
                        found.add(state)
                        front.append(state)
        return [row for row in self.rows if (row.node, row.kind) in found]

    def _after(
        self, row: SiteRow, drains: Mapping[str, float], stranded: Optional[str], anywhere: bool
    ) -> List[Tuple[str, RobotKind]]:
        if row.move.what == "Start":
            return []
        if row.move.what == "Dock":
            return [(row.node, self._kinds[0])]
        after = [(row.move.to, row.kind)]
        if not drains:
            return after
        lower = self._kinds[self._kinds.index(row.kind) + 1 :]
        after += [(row.move.to, kind) for kind in (lower if anywhere else lower[:1])]
        if stranded is not None and (anywhere or not lower):
            after.append((stranded, self._kinds[0]))
        return after
