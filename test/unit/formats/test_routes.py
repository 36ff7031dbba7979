"""Where arcs and labels of a drawing with fixed nodes go."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.formats.routes import LETTER, LINE_HEIGHT, Line, NodeBox, layout


def place(x, y, label="place"):
    return NodeBox(x, y, 15, 15, True, label)


def transition(x, y, label="go\nλ 1"):
    return NodeBox(x, y, 6, 15, False, label)


def gap(some, others):
    """The least distance between two arcs, away from the nodes where they end."""
    inner = some.points()
    inner = [
        p
        for p in inner
        if min(math.hypot(p[0] - e[0], p[1] - e[1]) for e in (some.start, some.tip)) > 40
    ]
    return min(math.hypot(p[0] - q[0], p[1] - q[1]) for p in inner for q in others.points())


def test_an_arc_alone_is_straight_and_ends_at_its_nodes():
    route = layout([place(0, 0), transition(100, 0)], [Line(0, 1, "", 7)]).routes[0]
    assert route.start == pytest.approx((15, 0))
    assert route.base == pytest.approx((87, 0))
    assert route.tip == pytest.approx((94, 0))
    assert all(y == pytest.approx(0) for _, y in route.points())


def test_an_arc_goes_through_the_bends_that_a_person_drew():
    bends = ((50.0, 80.0), (150.0, 80.0))
    boxes = [place(0, 0), transition(200, 0), place(100, 80)]
    route = layout(boxes, [Line(0, 1, "", 7, bends), Line(0, 1, "", 7)]).routes[0]
    points = route.points()
    assert max(math.dist(a, b) for a, b in zip(points, points[1:])) < 8
    for bend in bends:  # its corners are round
        assert 0 < min(math.dist(bend, point) for point in points) < 14
    assert all(y == pytest.approx(80) for x, y in points if 65 < x < 135)
    assert math.dist(route.start, (0, 0)) == pytest.approx(15)
    assert math.dist(route.base, route.tip) == pytest.approx(7)


def test_arcs_between_the_same_nodes_are_apart():
    found = layout(
        [place(0, 0), transition(200, 0)],
        [Line(0, 1, "2", 7), Line(0, 1, "3", 6), Line(1, 0, "", 7)],
    )
    first, second, back = found.routes
    assert min(gap(first, second), gap(first, back), gap(second, back)) > 8
    assert first.label != second.label


def test_an_arc_goes_around_a_node_and_not_along_another_arc():
    boxes = [place(0, 0), place(100, 4), transition(300, 0)]
    far, near = layout(boxes, [Line(0, 2, "", 6), Line(1, 2, "", 6)]).routes
    assert all(math.hypot(x - 100, y - 4) > 15 for x, y in far.points())
    assert gap(far, near) > 6


def test_labels_lie_on_no_arc_no_node_and_no_label():
    boxes = [transition(0, 0, "Hand_Over\nλ 2 ∞")]
    boxes += [
        place(x, y, "neighbour")
        for x, y in ((-110, 120), (-110, -120), (110, 120), (110, -120), (0, 150))
    ]
    lines = [
        Line(1, 0, "", 7),
        Line(2, 0, "", 7),
        Line(0, 3, "4", 7),
        Line(0, 4, "", 7),
        Line(5, 0, "", 7),
    ]
    found = layout(boxes, lines)
    spots = []
    texts = [*zip(found.labels, (box.label for box in boxes)), (found.routes[2].label, "4")]
    for (x, y), text in texts:
        rows = text.splitlines()
        spots.append((x, y, LETTER * max(map(len, rows)) / 2, LINE_HEIGHT * len(rows) / 2))
    for x, y, w, h in spots:
        for route in found.routes:
            assert not any(abs(px - x) < w and abs(py - y) < h for px, py in route.points())
        for box in boxes:
            assert abs(box.x - x) >= w + box.half_width or abs(box.y - y) >= h + box.half_height
    for i, (x, y, w, h) in enumerate(spots):
        assert all(abs(a - x) >= w + c or abs(b - y) >= h + d for a, b, c, d in spots[:i])


def test_what_would_take_long_is_left_to_graphviz():
    assert layout([place(0, 0), transition(1e300, 0)], [Line(0, 1, "", 7)]) is None
    assert (
        layout([place(i, i) for i in range(1000)], [Line(i, i + 1, "", 7) for i in range(900)])
        is None
    )


spots = st.sampled_from([0.0, 1.0, 15.0, 40.0, 250.5])


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(
    at=st.lists(st.tuples(spots, spots), min_size=2, max_size=6),
    arcs=st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), max_size=8),
)
def test_nodes_on_each_other_break_nothing(at, arcs):
    boxes = [(place, transition)[i % 2](x, y) for i, (x, y) in enumerate(at)]
    lines = [Line(a % len(at), b % len(at), "2", 7) for a, b in arcs]
    found = layout(boxes, lines)
    assert len(found.routes) == len(lines) and len(found.labels) == len(boxes)
    numbers = [v for route in found.routes for p in (*route.points(), route.label) for v in p]
    assert all(map(math.isfinite, numbers + [v for p in found.labels for v in p]))
