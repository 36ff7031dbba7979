"""Routes arcs and places labels in drawings of nets whose nodes have fixed positions.

With fixed nodes, Graphviz draws arcs on top of each other and labels across arcs, so this module
places both. An arc goes through the bends that a person drew. Without them, it is straight if
possible, and bends away from nodes and from arcs that run along it; a label takes the nearest free
spot to its node. Lengths are in points (1/72 inch), y upwards.
"""

from __future__ import annotations

import math
from typing import Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple

from gspn_framework_package.model.net import Point

# distance between the sampled points of an arc; two arcs that are closer than this overlap
_STEP = 6.0
_NEAR = 28.0  # this close to its ends, an arc may overlap others that end there
_BENDS = (0, 14, -14, 28, -28, 45, -45, 65, -65, 90, -90, 120, -120)
_GAPS = (3.0, 10.0, 20.0, 32.0)
_DIRECTIONS = [
    math.radians(a)
    for a in (90, 270, 135, 45, 225, 315, 180, 0, 112, 68, 248, 292, 158, 22, 202, 338)
]
_MAX_EXTENT = 20_000.0
_MAX_LENGTH = 300_000.0
_CORNER = 14.0  # this far before and after a bend that a person drew, an arc is round
LINE_HEIGHT = 12.5
LETTER = 6.4
"""Mean width of a letter in a node's label; wider than in most fonts, so that no label is cut."""


class NodeBox(NamedTuple):
    """A node: its centre, half its width and height, whether it is round, and its label."""

    x: float
    y: float
    half_width: float
    half_height: float
    round: bool
    label: str


class Line(NamedTuple):
    """An arc between two boxes (by number), with its label, the length of its arrow head, and the
    bends that a person drew."""

    source: int
    target: int
    label: str
    head: float
    bends: Tuple[Point, ...] = ()


class Route(NamedTuple):
    """The route of an arc: its course from its start to the base of its head, the tip of the head,
    and the position of its label. The course is a Bézier curve: points on it, with two control
    points between each and the next."""

    course: Tuple[Point, ...]
    tip: Point
    label: Optional[Point] = None

    @property
    def start(self) -> Point:
        """Where the arc leaves its source."""
        return self.course[0]

    @property
    def base(self) -> Point:
        """Where its head begins."""
        return self.course[-1]

    def points(self) -> List[Point]:
        """Return positions along the route, at most about 6 pt apart."""
        found = [self.start]
        for piece in range(0, len(self.course) - 1, 3):
            corners = self.course[piece : piece + 4]
            number = max(4, int(sum(map(_distance, corners, corners[1:])) / _STEP) + 1)
            for i in range(1, number + 1):
                t = i / number
                weights = ((1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3)
                found.append(_mean(weights, corners))
        return [*found, self.tip]


class Routing(NamedTuple):
    """The routes, in the order of the lines, and the centre of each box's label."""

    routes: List[Route]
    labels: List[Point]


def layout(boxes: Sequence[NodeBox], lines: Sequence[Line]) -> Optional[Routing]:
    """Route the lines and place the labels; None if the drawing is too large to do this quickly."""
    ends = [*(box[:2] for box in boxes), *(bend for line in lines for bend in line.bends)]
    extent = max((abs(v) for end in ends for v in end), default=0.0)
    if extent > _MAX_EXTENT or len(boxes) * len(lines) > 100_000:
        return None
    lengths = []
    for line in lines:
        stops = [boxes[line.source][:2], *line.bends, boxes[line.target][:2]]
        lengths.append(sum(map(_distance, stops, stops[1:])))
    if sum(lengths) > _MAX_LENGTH:
        return None
    routes: Dict[int, Route] = {}
    taken: Dict[Tuple[int, int], Set[int]] = {}
    # what a person drew, then the shortest first: long arcs can bend around others more easily
    for number in sorted(range(len(lines)), key=lambda i: (not lines[i].bends, lengths[i])):
        routes[number] = _route(boxes, lines, number, routes, taken)
        for x, y in routes[number].points():
            for i in (-1, 0, 1):
                for j in (-1, 0, 1):
                    taken.setdefault((int(x // _STEP) + i, int(y // _STEP) + j), set()).add(number)
    spots = _Spots(boxes)
    for number, route in routes.items():
        spots.add_arc(number, route)
    labels = [spots.put(_around(box), *_size(box.label)) for box in boxes]
    ready = []
    for number, line in enumerate(lines):
        route = routes[number]
        if line.label:
            route = route._replace(label=spots.put(_along(route), *_size(line.label)))
        ready.append(route)
    return Routing(ready, labels)


def _distance(a: Sequence[float], b: Sequence[float]) -> float:
    return math.hypot(a[0] - b[0], a[1] - b[1])


def _mean(weights: Sequence[float], points: Sequence[Point]) -> Point:
    return sum(w * p[0] for w, p in zip(weights, points)), sum(
        w * p[1] for w, p in zip(weights, points)
    )


def _size(label: str) -> Tuple[float, float]:
    lines = label.splitlines() or [""]
    return LETTER * max(map(len, lines)), LINE_HEIGHT * len(lines)


def _border(box: NodeBox, towards: Point) -> Point:
    """Return the point where a straight line from the centre of the box to a point leaves it."""
    dx, dy = towards[0] - box.x, towards[1] - box.y
    length = math.hypot(dx, dy)
    if length < 1e-9:
        return box.x + box.half_width, box.y
    if box.round:
        part = box.half_width / length
    else:
        part = min(half / abs(d) for half, d in ((box.half_width, dx), (box.half_height, dy)) if d)
    return box.x + part * dx, box.y + part * dy


def _bent(boxes: Sequence[NodeBox], line: Line, bend: float) -> Route:
    a, b = boxes[line.source], boxes[line.target]
    dx, dy = b.x - a.x, b.y - a.y
    length = math.hypot(dx, dy) or 1.0
    middle = ((a.x + b.x) / 2 - 2 * bend * dy / length, (a.y + b.y) / 2 + 2 * bend * dx / length)
    start, base, tip = _ends(boxes, line, middle, middle)
    return Route((start, *_round(start, middle, base)), tip)


def _ends(
    boxes: Sequence[NodeBox], line: Line, first: Point, last: Point
) -> Tuple[Point, Point, Point]:
    """The start of an arc that leaves towards ``first``, and the base and the tip of the head with
    which it comes from ``last``."""
    tip = _border(boxes[line.target], last)
    head = min(line.head, _distance(last, tip) / 2)
    return _border(boxes[line.source], first), _toward(tip, last, head), tip


def _toward(a: Point, b: Point, length: float) -> Point:
    """The point that is ``length`` from a on the way to b."""
    part = length / (_distance(a, b) or 1.0)
    return a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])


def _round(start: Point, corner: Point, end: Point) -> Tuple[Point, Point, Point]:
    """The rest of the curve that leaves ``start`` towards a corner and comes to ``end`` from it."""
    return _mean((1 / 3, 2 / 3), (start, corner)), _mean((1 / 3, 2 / 3), (end, corner)), end


def _drawn(boxes: Sequence[NodeBox], line: Line) -> Route:
    """The route through the bends that a person drew: straight, with round corners."""
    start, base, tip = _ends(boxes, line, line.bends[0], line.bends[-1])
    stops = [start, *line.bends, base]
    course = [start]
    for before, bend, after in zip(stops, stops[1:], stops[2:]):
        ends = [_toward(bend, p, min(_CORNER, _distance(bend, p) / 2)) for p in (before, after)]
        course += _round(course[-1], _mean((0.5, 0.5), (course[-1], ends[0])), ends[0])
        course += _round(ends[0], bend, ends[1])
    course += _round(course[-1], _mean((0.5, 0.5), (course[-1], base)), base)
    return Route(tuple(course), tip)


def _route(
    boxes: Sequence[NodeBox],
    lines: Sequence[Line],
    number: int,
    routes: Dict[int, Route],
    taken: Dict[Tuple[int, int], Set[int]],
) -> Route:
    """Return the route with the lowest cost among the possible bends."""
    line = lines[number]
    if line.bends:
        return _drawn(boxes, line)
    ends = (boxes[line.source][:2], boxes[line.target][:2])
    others = [box for i, box in enumerate(boxes) if i not in (line.source, line.target)]
    tips = [routes[i].tip for i in routes if lines[i].target == line.target]
    tips += [routes[i].start for i in routes if lines[i].source == line.target]
    pair = {line.source, line.target}
    beside = [
        _middle(route) for i, route in routes.items() if {lines[i].source, lines[i].target} == pair
    ]
    room = _distance(*ends) / 2
    best, least = _bent(boxes, line, 0), math.inf
    for bend in _BENDS:
        if abs(bend) > max(room, 14):
            continue
        route = _bent(boxes, line, bend)
        points = route.points()
        cost = abs(bend) * 0.25
        for box in others:
            reach = max(box.half_width, box.half_height) + 5
            if any(abs(x - box.x) < reach and abs(y - box.y) < reach for x, y in points):
                cost += 100
        along: Dict[int, int] = {}
        for x, y in points:
            if min(_distance((x, y), ends[0]), _distance((x, y), ends[1])) > _NEAR:
                for other in taken.get((int(x // _STEP), int(y // _STEP)), ()):
                    along[other] = along.get(other, 0) + 1
        for times in along.values():
            # crossing another arc costs little, running along it costs more
            cost += 2 if times <= 4 else 2 * times
        cost += sum(60 for middle in beside if _distance(middle, _middle(route)) < 10)
        cost += sum(8 for tip in tips if _distance(tip, route.tip) < 6)
        if cost < least:
            best, least = route, cost
        if not least:
            break
    return best


def _middle(route: Route) -> Point:
    begin = 3 * (len(route.course) // 6)
    return _mean((0.125, 0.375, 0.375, 0.125), route.course[begin : begin + 4])


def _around(box: NodeBox) -> Iterator[Tuple[Point, Point, float]]:
    """Yield spots for the label of a box: a point beside the box, the direction away from it, and
    the cost of the spot."""
    for gap in _GAPS:
        for rank, angle in enumerate(_DIRECTIONS):
            way = (math.cos(angle), math.sin(angle))
            at = (box.x + way[0] * (box.half_width + gap), box.y + way[1] * (box.half_height + gap))
            yield at, way, gap * 0.1 + rank * 0.02


def _along(route: Route) -> Iterator[Tuple[Point, Point, float]]:
    """Yield spots for the label of an arc, like :func:`_around`."""
    points = route.points()
    for gap in (3.0, 8.0):
        for part in (0.5, 0.4, 0.6, 0.3, 0.7):
            i = max(1, min(len(points) - 2, int(part * len(points))))
            dx, dy = points[i + 1][0] - points[i - 1][0], points[i + 1][1] - points[i - 1][1]
            length = math.hypot(dx, dy) or 1.0
            for side in (1, -1):
                way = (-side * dy / length, side * dx / length)
                at = (points[i][0] + gap * way[0], points[i][1] + gap * way[1])
                yield at, way, gap * 0.1 + abs(part - 0.5)


class _Spots:
    """Keeps track of what is drawn, to compute how much of it a rectangle would cover."""

    _CELL = 30.0

    def __init__(self, boxes: Sequence[NodeBox]) -> None:
        self._boxes = boxes
        self._points: Dict[Tuple[int, int], List[Tuple[float, float, int]]] = {}
        self._labels: List[Tuple[float, float, float, float]] = []

    def add_arc(self, number: int, route: Route) -> None:
        for x, y in route.points():
            cell = int(x // self._CELL), int(y // self._CELL)
            self._points.setdefault(cell, []).append((x, y, number))

    def put(
        self, spots: Iterator[Tuple[Point, Point, float]], width: float, height: float
    ) -> Point:
        """Put a label of this size at the best of the spots, which is then occupied, and return the
        centre of the label."""
        best, least = (0.0, 0.0), math.inf
        for at, way, cost in spots:
            if cost >= least:
                continue
            x, y = at[0] + way[0] * width / 2, at[1] + way[1] * height / 2
            cost += self._covered(x, y, width / 2 + 1, height / 2 + 1)
            if cost < least:
                best, least = (x, y), cost
        self._labels.append((*best, width / 2, height / 2))
        return best

    def _covered(self, x: float, y: float, w: float, h: float) -> float:
        arcs: Dict[int, int] = {}
        for i in range(int((x - w) // self._CELL), int((x + w) // self._CELL) + 1):
            for j in range(int((y - h) // self._CELL), int((y + h) // self._CELL) + 1):
                for px, py, number in self._points.get((i, j), ()):
                    if abs(px - x) < w and abs(py - y) < h:
                        arcs[number] = arcs.get(number, 0) + 1
        cost = sum(20 + times for times in arcs.values())
        cost += sum(
            50
            for b in self._boxes
            if abs(b.x - x) < w + b.half_width and abs(b.y - y) < h + b.half_height
        )
        cost += sum(
            50 for b in self._labels if abs(b[0] - x) < w + b[2] and abs(b[1] - y) < h + b[3]
        )
        return cost
