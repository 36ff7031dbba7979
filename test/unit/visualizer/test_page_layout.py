"""Where nodes are drawn: nothing over anything, the file's positions kept, an end in time."""

import itertools
import math

from gspn_framework_package.benchmark.nets import kanban, philosophers
from gspn_framework_package.model.net import Arc, Net, Place, Transition
from gspn_framework_package.visualizer import layout
from gspn_framework_package.visualizer.layout import PLACE_RADIUS, lay_out


def nearest(points):
    return min(math.dist(a, b) for a, b in itertools.combinations(points.values(), 2))


def test_no_two_nodes_overlap():
    for net in (kanban(2), philosophers(5), philosophers(20)):
        found = lay_out(net)
        assert len(found.positions) == len(net.places) + len(net.transitions)
        assert nearest(found.positions) >= 2 * PLACE_RADIUS


def test_routes_run_from_centre_to_centre():
    net = kanban(2)
    found = lay_out(net)
    assert found.engine == "dot" and len(found.routes) == len(net.arcs)
    for a, curve in found.routes.items():
        assert len(curve) % 3 == 1
        assert math.dist(curve[0], found.positions[net.arcs[a].source]) < 2
        assert math.dist(curve[-1], found.positions[net.arcs[a].target]) < 2


def drawn():
    places = [Place("p%d" % i, position=(30.0 * i, 10.0 * (i % 2))) for i in range(5)]
    transitions = [Transition("t%d" % i, position=(30.0 * i + 15, 60.0)) for i in range(4)]
    arcs = [Arc("p%d" % i, "t%d" % i) for i in range(4)] + [
        Arc("t%d" % i, "p%d" % (i + 1)) for i in range(4)
    ]
    return Net(places, transitions, arcs)


def test_positions_of_the_file_are_kept_to_scale():
    net = drawn()
    found = lay_out(net)
    assert found.engine == "file"
    scale = found.positions["p1"][0] / 30.0
    for node in (*net.places, *net.transitions):
        assert math.dist(found.positions[node.name], [v * scale for v in node.position]) < 1e-6
    assert nearest(found.positions) >= 2 * PLACE_RADIUS
    assert lay_out(net, anew=True).engine != "file"


def test_routes_of_a_drawn_net_meet_its_nodes():
    net = drawn()
    found = lay_out(net)
    assert found.routes
    for a, curve in found.routes.items():
        assert math.dist(curve[0], found.positions[net.arcs[a].source]) < 3
        assert math.dist(curve[-1], found.positions[net.arcs[a].target]) < 3


def test_positions_that_lie_on_each_other_are_not_used():
    net = Net(
        [Place("a", position=(0.0, 0.0))], [Transition("t", position=(0.0, 0.0))], [Arc("a", "t")]
    )
    assert lay_out(net).engine == "dot"


def test_without_graphviz_a_grid_does(monkeypatch):
    monkeypatch.setattr(layout, "_graphviz", lambda *arguments: None)
    found = lay_out(philosophers(9))
    assert found.engine == "grid" and nearest(found.positions) >= 2 * PLACE_RADIUS


def test_graphviz_has_a_deadline():
    assert layout._graphviz(philosophers(60), "dot", 0.001) is None


def test_a_layout_is_computed_once(monkeypatch):
    net = philosophers(7)
    first = lay_out(net)
    monkeypatch.setattr(layout, "_compute", None)
    assert lay_out(net) is first


def test_names_of_any_kind_are_laid_out():
    names = ['"', "a\nb", "<b>x</b>", "\\", "--", "ü" * 300, "digraph{"]
    net = Net([Place(n) for n in names], [Transition("t")], [Arc(n, "t") for n in names])
    assert set(lay_out(net).positions) == {*names, "t"}


def test_places_without_arcs_fill_the_screen_instead_of_one_line():
    found = lay_out(Net([Place("p%d" % i) for i in range(60)], [], []))
    xs, ys = zip(*found.positions.values())
    assert nearest(found.positions) >= 2 * PLACE_RADIUS
    assert 0.5 < (max(xs) - min(xs)) / (max(ys) - min(ys)) < 4
