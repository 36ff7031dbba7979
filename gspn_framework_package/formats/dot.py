"""Drawing with Graphviz: writes graphs as DOT text and renders DOT text as SVG, PNG or PDF.

:class:`Graph` writes correct DOT for any names. The analysis uses it to draw coverability trees and
Markov chains; :func:`net_graph` uses it to draw nets."""

from __future__ import annotations

import subprocess
from typing import Dict, FrozenSet, List, Mapping, Optional, Sequence, Tuple, Union

from gspn_framework_package.formats.routes import Line, NodeBox, Routing, layout
from gspn_framework_package.model.errors import InputError, LimitError, UsageError
from gspn_framework_package.model.marking_function import MarkingFunction, Value
from gspn_framework_package.model.net import Arc, Net, Place, Point, Transition
from gspn_framework_package.model.subnet import Subnet

IMAGE_FORMATS = ("svg", "png", "pdf")
"""The image formats that :func:`render` supports."""

_MAX_LAYERED = 300
"""Number of nodes above which the layout is force-directed: the layered one would take too long."""

_MAX_DOTS = 4
"""Maximum number of tokens drawn as dots; more are shown as a number."""

_ARROW_LENGTH, _DOT_LENGTH = 7.0, 5.6
"""Lengths of the two kinds of arc heads, in points, at the size used for nets."""

_SHADE = "#5a708c22"
"""Background of a box; translucent, so that nested boxes are darker."""

Attribute = Union[str, int, float]


class Graph:
    """A builder of directed graphs for Graphviz.

    >>> graph = Graph("g", rankdir="LR")
    >>> graph.node("a", label='say "hi"')
    >>> graph.edge("a", "b", label="2")
    >>> print(graph.text(), end="")
    digraph "g" {
      graph [rankdir="LR"];
      "a" [label="say \\"hi\\""];
      "a" -> "b" [label="2"];
    }
    """

    def __init__(self, name: str = "", **attributes: Attribute) -> None:
        self.name = name
        self._lines: List[str] = []
        self._open = self._boxes = 0
        if attributes:
            self._lines.append("graph%s;" % _attributes(attributes))

    def defaults(self, kind: str, **attributes: Attribute) -> None:
        """Set default attributes of each ``node`` or ``edge`` (the ``kind``) added later."""
        self._lines.append("%s%s;" % (kind, _attributes(attributes)))

    def node(self, identifier: str, **attributes: Attribute) -> None:
        """Add a node; labels are shown literally, with their line breaks."""
        self._lines.append("%s%s;" % (_quote(identifier), _attributes(attributes)))

    def edge(self, source: str, target: str, **attributes: Attribute) -> None:
        """Add an edge."""
        self._lines.append(
            "%s -> %s%s;" % (_quote(source), _quote(target), _attributes(attributes))
        )

    def cluster(
        self,
        label: str,
        nodes: Sequence[str],
        parents: int,
        at: Mapping[str, Attribute],
    ) -> None:
        """Begin a box around nodes that have been added; ``parents`` boxes stay open around it.
        ``close`` ends them all.

        :param at: where the box and its label are, if nodes have positions.
        """
        self.close(parents)
        self._lines.append("subgraph %s {" % _quote("cluster_%d" % self._boxes))
        self._boxes += 1
        self._open += 1
        # a shade instead of a line, which could cross names, since Graphviz leaves no room for them
        look = {"label": label, "style": "rounded,filled", "fillcolor": _SHADE, "color": "none"}
        self._lines.append("graph%s;" % _attributes({**look, **at}))
        self._lines += ["%s;" % _quote(node) for node in nodes]

    def close(self, left: int = 0) -> None:
        """End boxes until ``left`` are open."""
        while self._open > left:
            self._lines.append("}")
            self._open -= 1

    def text(self) -> str:
        """Return the graph in the DOT language."""
        body = "".join("  %s\n" % line for line in self._lines)
        return "digraph %s {\n%s}\n" % (_quote(self.name), body)


def _quote(text: str) -> str:
    """Return a DOT string that shows ``text`` literally."""
    flat = text.replace("\0", "").replace("&", "&amp;")  # Graphviz expands HTML entities
    flat = flat.replace("\\", "\\\\").replace('"', '\\"')
    return '"%s"' % "\\n".join(flat.splitlines() or [""])


def _attributes(values: Mapping[str, Attribute]) -> str:
    if not values:
        return ""
    return " [%s]" % ", ".join("%s=%s" % (k, _quote(str(v))) for k, v in values.items())


def net_graph(
    net: Net,
    marking: Optional[Sequence[int]] = None,
    subnets: Mapping[str, Subnet] = {},
    groups: Mapping[str, Sequence[str]] = {},
) -> Graph:
    """Draw a net as a graph. Places are circles with their tokens, immediate transitions are black
    and thin, exponential ones are white and thick, and inhibitor arcs end in a circle. Rates,
    weights, priorities, capacities and arc weights are shown where they differ from the default.

    If all nodes of the net have positions, the drawing uses them and the bends of arcs, and moves
    the nodes around a subnet aside; otherwise, Graphviz lays it out.

    :param marking: the tokens to show, in place order; the initial marking by default.
    :param subnets: the parts of the net to draw a box around.
    :param groups: nodes to draw a box around, by its title.
    """
    nodes = len(net.places) + len(net.transitions)
    positions = _unfolded(_positions(net), subnets)
    attributes: Dict[str, Attribute] = {"fontname": "Helvetica", "forcelabels": "true"}
    placed = _placed(net, positions) if positions else None
    if placed is not None:
        attributes.update(layout="nop2", notranslate="true", outputorder="edgesfirst")
    elif positions:
        attributes.update(layout="neato", inputscale=72, splines="true", notranslate="true")
    elif nodes > _MAX_LAYERED and not (subnets or groups):
        attributes.update(layout="sfdp", overlap="prism", splines="false")
    else:
        attributes.update(layout="dot", rankdir="LR", nodesep=0.5, ranksep=0.5)
    graph = Graph(net.name, **attributes)
    graph.defaults("node", fontname="Helvetica", fontsize=10, margin=0, fixedsize="true")
    graph.defaults("edge", fontname="Helvetica", fontsize=9, arrowsize=0.7)
    counts = net.initial_marking if marking is None else marking
    spots = (
        [{"xlp": _point(spot)} for spot in placed.labels] if placed else [{} for _ in range(nodes)]
    )
    for place, tokens, spot in zip(net.places, counts, spots):
        graph.node(
            place.name, **_place_attributes(place, tokens), **_at(place.name, positions), **spot
        )
    for transition, spot in zip(net.transitions, spots[len(net.places) :]):
        graph.node(
            transition.name,
            **_transition_attributes(transition),
            **_at(transition.name, positions),
            **spot,
        )
    for number, arc in enumerate(net.arcs):
        looks: Dict[str, Attribute] = {}
        if arc.weight != 1:
            looks["label"] = arc.weight
        if arc.inhibitor:
            looks["arrowhead"] = "odot"
        if placed is not None:
            route = placed.routes[number]
            looks["pos"] = "e,%s %s" % (_point(route.tip), " ".join(map(_point, route.course)))
            if route.label is not None:
                looks["lp"] = _point(route.label)
        graph.edge(arc.source, arc.target, **looks)
    boxes = [(name, (*subnet.places, *subnet.transitions)) for name, subnet in subnets.items()]
    boxes += [(title, tuple(nodes)) for title, nodes in groups.items()]
    _draw_boxes(graph, sorted(boxes, key=lambda box: -len(box[1])), positions)
    graph.close()
    return graph


def _draw_boxes(
    graph: Graph,
    boxes: Sequence[Tuple[str, Tuple[str, ...]]],
    positions: Mapping[str, Point],
    depth: int = 0,
) -> None:
    """Draw boxes with titles around nodes, the larger ones first; ``depth`` boxes stay open."""
    left = list(boxes)
    while left:
        title, nodes = left.pop(0)
        around = {*nodes}
        inside = [box for box in left if around.issuperset(box[1])]
        spots = [positions[node] for node in nodes] if positions else []
        graph.cluster(title, nodes, depth, _box(spots, _levels(inside)))
        _draw_boxes(graph, inside, positions, depth + 1)
        left = [box for box in left if not around.issuperset(box[1])]


def _levels(boxes: Sequence[Tuple[str, Tuple[str, ...]]]) -> int:
    """How deeply boxes are nested, of which the larger ones come first."""
    levels: List[Tuple[int, FrozenSet[str]]] = []
    for _, nodes in reversed(boxes):
        around = frozenset(nodes)
        levels.append((1 + max((n for n, box in levels if box <= around), default=0), around))
    return max((n for n, _ in levels), default=0)


def to_bytes(net: Net) -> bytes:
    """Return the net as DOT text."""
    return net_graph(net).text().encode("utf-8")


def _positions(net: Net) -> Dict[str, Point]:
    """Return the positions of the nodes, if all nodes have one and they are not all the same."""
    found = net.positions
    if len(found) < len(net.places) + len(net.transitions) or len(set(found.values())) < 2:
        return {}
    return found


def _unfolded(positions: Mapping[str, Point], subnets: Mapping[str, Subnet]) -> Mapping[str, Point]:
    """Positions at which each subnet has room, as on the page: the nodes around it move aside as
    far as its drawing extends from its entry."""
    at = {name: list(point) for name, point in positions.items()}
    inside = {name: {*subnet.places, *subnet.transitions} for name, subnet in subnets.items()}
    for name, subnet in reversed(list(subnets.items()) if at else []):
        beside = [n for n, other in subnets.items() if n != name and other.parent == subnet.parent]
        around = (inside[subnet.parent] if subnet.parent else at.keys()) - inside[name]
        for axis in (0, 1):
            begin = at[subnet.entry][axis]
            reach = [at[node][axis] - begin for node in inside[name]]
            # another subnet stays in one piece
            piece = {node: subnets[n].entry for n in beside for node in inside[n]}
            sides = {node: at[piece.get(node, node)][axis] - begin for node in around}
            for node, side in sides.items():
                at[node][axis] += max(reach) if side > 0 else min(reach) if side < 0 else 0
    return {name: (x, y) for name, (x, y) in at.items()}


def _box(spots: Sequence[Point], levels: int) -> Dict[str, Attribute]:
    """The box around nodes that are drawn there, and around ``levels`` nested boxes, with its
    label at the top; empty without nodes."""
    if not spots:
        return {}
    (left, right), (top, bottom) = ((min(v), max(v)) for v in zip(*spots))
    side, above = 40 + 8 * levels, 60 + 20 * levels
    box = (left - side, -bottom - side, right + side, above - top)
    return {"bb": "%.2f,%.2f,%.2f,%.2f" % box, "lp": _point(((left + right) / 2, above - 12 - top))}


def _at(name: str, positions: Mapping[str, Point]) -> Dict[str, Attribute]:
    if not positions:
        return {}
    x, y = positions[name]
    return {"pos": "%.2f,%.2f!" % (x, 0 - y)}  # Graphviz counts y upwards


def _placed(net: Net, positions: Mapping[str, Point]) -> Optional[Routing]:
    """Route the arcs and place the labels; None if Graphviz has to do that."""
    looks = [_place_attributes(place, 0) for place in net.places] + [
        _transition_attributes(t) for t in net.transitions
    ]
    names = [place.name for place in net.places] + [
        transition.name for transition in net.transitions
    ]
    number = {name: i for i, name in enumerate(names)}
    boxes: List[NodeBox] = []
    for name, look in zip(names, looks):
        half = [36.0 * float(look.get(key, look["width"])) for key in ("width", "height")]
        x, y = positions[name]
        boxes.append(
            NodeBox(x, 0 - y, half[0], half[1], look["shape"] == "circle", str(look["xlabel"]))
        )
    lines = [
        Line(
            number[arc.source],
            number[arc.target],
            str(arc.weight) if arc.weight != 1 else "",
            _DOT_LENGTH if arc.inhibitor else _ARROW_LENGTH,
            _moved(net, arc, positions),
        )
        for arc in net.arcs
    ]
    return layout(boxes, lines)


def _moved(net: Net, arc: Arc, positions: Mapping[str, Point]) -> Tuple[Point, ...]:
    """The bends of an arc, which move with the middle between its ends; y upwards."""
    (x, y), (drawn_x, drawn_y) = (
        tuple(sum(at[end][axis] for end in (arc.source, arc.target)) / 2 for axis in (0, 1))
        for at in (positions, net.positions)
    )
    return tuple((bx + x - drawn_x, drawn_y - y - by) for bx, by in arc.bends)


def _point(point: Point) -> str:
    return "%.2f,%.2f" % point


def _place_attributes(place: Place, tokens: int) -> Dict[str, Attribute]:
    dots = "●" * tokens if tokens <= _MAX_DOTS else str(tokens)
    if tokens == _MAX_DOTS:
        dots = "●●\n●●"
    label = place.name
    if place.capacity is not None:
        label += "\n≤ %d" % place.capacity
    return {"shape": "circle", "width": 0.42, "label": dots, "xlabel": label}


def _transition_attributes(transition: Transition) -> Dict[str, Attribute]:
    label = transition.name
    if transition.timed:
        servers = {None: " ∞", 1: ""}.get(transition.servers, " ×%s" % transition.servers)
        label += "\nλ %s%s" % (_value_text(transition.rate), servers)
        return {"shape": "box", "width": 0.16, "height": 0.42, "label": "", "xlabel": label}
    if transition.weight != 1:
        label += "\nw %s" % _value_text(transition.weight)
    if transition.priority != 1:
        label += "\nπ %d" % transition.priority
    return {
        "shape": "box",
        "width": 0.06,
        "height": 0.42,
        "style": "filled",
        "fillcolor": "black",
        "label": "",
        "xlabel": label,
    }


def _value_text(value: Value) -> str:
    return value.text if isinstance(value, MarkingFunction) else "%g" % value


def render(text: str, image: str = "svg", timeout: float = 60.0) -> bytes:
    """Render a graph in the DOT language as a picture.

    :param image: one of :data:`IMAGE_FORMATS`.
    :param timeout: maximum time for Graphviz, in seconds.
    :raises UsageError: ``image`` is not supported, or Graphviz is not installed.
    :raises InputError: Graphviz cannot read the text.
    :raises LimitError: Graphviz takes longer than ``timeout``.
    """
    if image not in IMAGE_FORMATS:
        raise UsageError(
            "the picture format '%s' is not supported" % image,
            hint="known: %s" % ", ".join(IMAGE_FORMATS),
        )
    try:
        done = subprocess.run(
            ["dot", "-T" + image],
            input=text.encode("utf-8"),
            capture_output=True,
            timeout=timeout,
            check=False,
        )
    except FileNotFoundError:
        raise UsageError(
            "Graphviz, which draws pictures, is not installed",
            hint="apt install graphviz; DOT text does not need it",
        ) from None
    except subprocess.TimeoutExpired:
        raise LimitError(
            "Graphviz did not finish in %g s" % timeout,
            hint="draw something smaller, or allow more time",
        ) from None
    if done.returncode != 0 or not done.stdout:
        reason = done.stderr.decode("utf-8", "replace").strip().splitlines()[:1] or [
            "no reason given"
        ]
        raise InputError("Graphviz cannot draw it: %s" % reason[0])
    return done.stdout
