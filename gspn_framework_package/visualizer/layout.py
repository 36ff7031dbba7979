"""The layout of a net: the positions of its nodes, the same in every mode of the page, which draws
the arcs between them.

Positions in the file are used if it has any; nodes without one are put below the others. Otherwise,
Graphviz lays the net out: ``dot`` in layers, with a deadline; ``sfdp`` if that takes too long. If
both fail or there are no arcs, a grid is used. A layout is computed once for a net and cached by
its hash.

A net with subnets is laid out plan by plan: the surrounding plan with one node for each subnet, and
each subnet separately, with its entry at that node. When the page unfolds a subnet, it moves
overlapping nodes aside. Layers keep the nodes of a group together.
"""

from __future__ import annotations

import hashlib
import json
import math
import subprocess
from typing import Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

from gspn_framework_package.model.kept import Kept
from gspn_framework_package.model.net import Arc, Net, Place, Point, Transition
from gspn_framework_package.model.subnet import Subnet

PLACE_RADIUS = 20.0
"""Radius of a place, in the units of the drawing (CSS pixels at zoom 1)."""

NEAREST = 68.0
"""Positions from a file are scaled until the two nearest nodes are this far apart."""

ROW = 90.0
"""Distance of the nodes placed below the others, as a multiple of the smallest distance."""

LABEL_HEIGHT = 16.0
LABEL_CHARACTERS = 22
CHARACTER_WIDTH = 6.4

DEADLINE = 8.0
"""Deadline of Graphviz, in seconds."""

DOT_NODES = 2500
"""Larger nets are not laid out in layers, which would take too long."""

SCREEN = (1000.0, 620.0)
"""Space for the net on a typical screen, in pixels."""

LEGIBLE = 0.35
"""A layout that fits on the screen at this zoom is used. Otherwise the next engine is tried too,
and its layout is used if its zoom is more than :data:`MUCH_LARGER` times as large."""

MUCH_LARGER = 1.5

SPACE = (110.0, 80.0)
"""Horizontal and vertical distances of neighbours in a layout by ``sfdp``."""

MOST_PUSHES = 60
"""How often nodes that are nearer than :data:`SPACE` are pushed apart."""

_KEPT = 32


class Layout(NamedTuple):
    """``positions``: node name -> centre. ``engine``: the origin of the layout (a Graphviz engine,
    ``file``, ``grid`` or ``empty``)."""

    positions: Dict[str, Point]
    engine: str


_Groups = Mapping[str, Sequence[str]]
_kept: Kept[Tuple[str, bool, str], Layout] = Kept(_KEPT)


def net_hash(net: Net) -> str:
    """Hex digest of everything that affects the layout of a net: its nodes, arcs and positions, but
    not its tokens."""
    essence: List[object] = [
        [[p.name, p.position] for p in net.places],
        [[t.name, t.timed, t.position] for t in net.transitions],
        [list(a.meaning) for a in net.arcs],
    ]
    return hashlib.sha256(json.dumps(essence).encode()).hexdigest()[:24]


def lay_out(
    net: Net,
    *,
    subnets: Mapping[str, Subnet] = {},
    groups: Mapping[str, Sequence[str]] = {},
    anew: bool = False,
    deadline: float = DEADLINE,
) -> Layout:
    """Return the layout of a net.

    :param subnets: the subnets in it, by name.
    :param groups: title -> nodes, or subnets, that are drawn in one box.
    :param anew: ignore the positions in the file.
    :param deadline: deadline of each Graphviz run, in seconds.
    """
    if subnets:
        return _Parts(net, subnets).lay_out(groups, anew, deadline)
    key = net_hash(net), anew, json.dumps(list(groups.values()))
    return _kept.get(key, lambda: _compute(net, groups, anew, deadline))


class _Parts:
    """Split a net with subnets into its drawings: that of the outermost plan, whose name is "", and
    one for each subnet."""

    def __init__(self, net: Net, subnets: Mapping[str, Subnet]) -> None:
        self._net, self._subnets = net, subnets
        self._owner: Dict[str, str] = {}
        for name in sorted(subnets, key=self._depth):
            self._owner.update(
                dict.fromkeys((*subnets[name].places, *subnets[name].transitions), name)
            )

    def _depth(self, name: str) -> int:
        parent = self._subnets[name].parent
        return 1 + self._depth(parent) if parent else 0

    def lay_out(self, groups: _Groups, anew: bool, deadline: float) -> Layout:
        positions: Dict[str, Point] = {}
        engine = ""
        for name in ["", *sorted(self._subnets, key=self._depth)]:
            layout = lay_out(self._part(name), groups=groups, anew=anew, deadline=deadline)
            right = down = 0.0
            if name:  # known as the node of the subnet in the surrounding plan
                entry = self._subnets[name].entry
                x, y = layout.positions[self._node(entry, name) or entry]
                right, down = positions[entry][0] - x, positions[entry][1] - y
            else:
                engine = layout.engine
            for node, (x, y) in layout.positions.items():
                found = self._subnets[node].entry if node in self._subnets else node
                positions[found] = (x + right, y + down)
        return Layout(positions, engine)

    def _part(self, part: str) -> Net:
        """The net of one drawing."""
        places: Dict[str, Place] = {}
        for place in self._net.places:
            node = self._node(place.name, part)
            if node is not None and (node == place.name or node not in places):
                entry = place.name if node == place.name else self._subnets[node].entry
                places[node] = self._net.place(entry)._replace(name=node)
        transitions = [
            # the places that a rate or weight names may be in another drawing
            t._replace(rate=1.0, weight=1.0)
            for t in self._net.transitions
            if self._owner.get(t.name, "") == part
        ]
        inside = {*places, *(t.name for t in transitions)}
        arcs: Dict[Arc, None] = {}  # without repetition, in their order
        for arc in self._net.arcs:
            source, target = self._node(arc.source, part), self._node(arc.target, part)
            if source in inside and target in inside and (source in places) != (target in places):
                arcs[Arc(str(source), str(target), 1, arc.inhibitor)] = None
        return Net(list(places.values()), transitions, list(arcs))

    def _node(self, name: str, part: str) -> Optional[str]:
        """The name under which a drawing shows a node of the net: its own, or that of the folded
        subnet around it; None if the drawing does not show it."""
        owner = self._owner.get(name, "")
        while owner != part:
            if not owner:
                return None
            name, owner = owner, self._subnets[owner].parent
        return name


def _compute(net: Net, groups: _Groups, anew: bool, deadline: float) -> Layout:
    nodes: List[Union[Place, Transition]] = [*net.places, *net.transitions]
    if not nodes:
        return Layout({}, "empty")
    given = None if anew else drawn({node.name: node.position for node in nodes})
    if given is not None:
        scale = scale_of(given.values())
        return Layout({name: (x * scale, y * scale) for name, (x, y) in given.items()}, "file")
    if not net.arcs:  # Graphviz would put all nodes in one line
        return Layout(_grid(net), "grid")
    best: Optional[Layout] = None
    for engine in ("dot", "sfdp"):
        layout = None
        if engine != "dot" or len(nodes) <= DOT_NODES:
            layout = _graphviz(net, groups, engine, deadline)
        if layout is not None and (best is None or _zoom(layout) > MUCH_LARGER * _zoom(best)):
            best = layout
        if best is not None and _zoom(best) >= LEGIBLE:
            break
    return best or Layout(_grid(net), "grid")


def _zoom(layout: Layout) -> float:
    """The zoom at which the whole net fits on the screen."""
    xs = [x for x, _ in layout.positions.values()]
    ys = [y for _, y in layout.positions.values()]
    return min(SCREEN[0] / (max(xs) - min(xs) + 120), SCREEN[1] / (max(ys) - min(ys) + 120))


def _names(net: Net) -> List[str]:
    return [p.name for p in net.places] + [t.name for t in net.transitions]


def drawn(nodes: Mapping[str, Optional[Point]]) -> Optional[Dict[str, Point]]:
    """The positions that a person gave the nodes; a node without one gets a position below the
    others. None if nobody placed them: no node has a position, or all have the same.

    :param nodes: name -> position in the file.
    """
    known = {name: point for name, point in nodes.items() if point is not None}
    if not known or (len(set(known.values())) == 1 < len(nodes)):
        return None
    missing = [name for name in nodes if name not in known]
    return {**known, **below([*known.values()], missing)}


def scale_of(points: Iterable[Point]) -> float:
    """The factor by which the page enlarges a drawing so that the symbols of the two nearest spots
    do not touch."""
    nearest = nearest_distance([*{*points}])
    return min(max(0.3, NEAREST / nearest), 8.0) if 1e-6 < nearest < math.inf else 1.0


def below(known: List[Point], missing: List[str]) -> Dict[str, Point]:
    """Rows of places for the ``missing`` nodes, below the points that are ``known``."""
    if not missing:
        return {}
    nearest = nearest_distance(known)
    step = ROW * (nearest / NEAREST if 0 < nearest < math.inf else 1.0)
    left, bottom = min(x for x, _ in known), max(y for _, y in known)
    columns = max(1, math.ceil(math.sqrt(len(missing) * 1.6)))
    return {
        name: (left + step * (i % columns), bottom + step * (1 + i // columns))
        for i, name in enumerate(missing)
    }


def nearest_distance(points: List[Point]) -> float:
    """Distance between the two nearest points, by a sweep over x."""
    best = math.inf
    points = sorted(points)
    for i, (x, y) in enumerate(points):
        for j in range(i - 1, -1, -1):
            if x - points[j][0] >= best:
                break
            best = min(best, math.hypot(x - points[j][0], y - points[j][1]))
    return best


def label_width(name: str) -> float:
    """Width of a node's label on the page, which shortens long names."""
    return min(len(name), LABEL_CHARACTERS) * CHARACTER_WIDTH


def _graphviz(net: Net, groups: _Groups, engine: str, deadline: float) -> Optional[Layout]:
    """The layout by Graphviz, or None if it fails or takes longer than ``deadline`` seconds."""
    names = _names(net)
    number = {name: i for i, name in enumerate(names)}
    try:
        done = subprocess.run(
            [engine, "-Tplain", "-y"],
            input=_dot_text(net, groups, number, engine).encode(),
            capture_output=True,
            timeout=deadline,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    if done.returncode != 0:
        return None
    positions: Dict[str, Point] = {}
    for line in done.stdout.decode().splitlines():
        words = line.split()
        if words[:1] == ["node"]:
            positions[names[int(words[1])]] = (float(words[2]) * 72, float(words[3]) * 72)
    if len(positions) != len(names):
        return None
    return Layout(_pushed_apart(positions) if engine == "sfdp" else positions, engine)


def _dot_text(net: Net, groups: _Groups, number: Dict[str, int], engine: str) -> str:
    """The net in DOT, with numbers for names, so that nothing needs quoting."""
    if engine == "dot":
        settings = "rankdir=LR nodesep=0.28 ranksep=0.5 nslimit=6 mclimit=0.6 splines=false;"
    else:  # a force that fades with the distance lets long chains curl, where a ring has no end
        settings = "K=0.9 repulsiveforce=3 quadtree=fast overlap=true splines=false;"
    lines = ["digraph {", settings, 'node [shape=box fixedsize=true label=""];']
    size = 2 * PLACE_RADIUS + 4
    for name in number:
        width = max(size, label_width(name) + 8)
        shape = "width=%.3f height=%.3f" % (width / 72, (size + 2 * LABEL_HEIGHT) / 72)
        lines.append("%d [%s];" % (number[name], shape))
    for arc in net.arcs:
        lines.append("%d -> %d;" % (number[arc.source], number[arc.target]))
    for i, nodes in enumerate(groups.values()):
        inside = " ".join("%d;" % number[node] for node in nodes if node in number)
        lines.append("subgraph cluster_%d { margin=30 %s }" % (i, inside))
    lines.append("}")
    return "\n".join(lines)


def _pushed_apart(positions: Dict[str, Point]) -> Dict[str, Point]:
    """The positions with :data:`SPACE` between neighbours; Graphviz itself takes four times as long
    for that as for the layout of a large net."""
    import numpy as np
    from scipy.spatial import cKDTree

    space = np.array(SPACE)
    points = np.array(list(positions.values())) / space
    if len(points) > 1:
        apart = cKDTree(points).query(points, 2)[0][:, 1]
        points /= max(float(np.quantile(apart, 0.3)), 1e-9)
        points += np.random.default_rng(0).normal(0, 1e-3, points.shape)  # none on another
    for _ in range(MOST_PUSHES):
        pairs = cKDTree(points).query_pairs(1.0, output_type="ndarray")
        if not len(pairs):
            break
        first, second = pairs.T
        way = points[first] - points[second]
        length = np.hypot(*way.T)
        push = way * (0.35 * (1.02 - length) / length)[:, None]
        np.add.at(points, first, push)
        np.add.at(points, second, -push)
    points *= space
    return {name: (float(x), float(y)) for name, (x, y) in zip(positions, points)}


def _grid(net: Net) -> Dict[str, Point]:
    """A grid of the nodes, ordered by following the arcs."""
    neighbours: Dict[str, List[str]] = {name: [] for name in _names(net)}
    for arc in net.arcs:
        neighbours[arc.source].append(arc.target)
    order: List[str] = []
    seen = set()
    for start in neighbours:
        stack = [start]
        while stack:
            name = stack.pop()
            if name not in seen:
                seen.add(name)
                order.append(name)
                stack += reversed(neighbours[name])
    columns = max(1, math.ceil(math.sqrt(len(order) * 1.6)))
    points = {}
    for i, name in enumerate(order):
        row, column = divmod(i, columns)
        if row % 2:
            column = columns - 1 - column
        points[name] = (column * 110.0, row * 90.0)
    return points
