"""Where nodes are drawn: nothing over anything, the file's positions kept, an end in time."""

import copy
import itertools
import json
import math

import pytest

from benchmarks.nets import kanban, philosophers
from benchmarks.page.feed import workshop
from gspn_framework_package.formats.net_json import net_from_json, net_to_json
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.net import Arc, Net, Place, Transition
from gspn_framework_package.visualizer import layout
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.editing.open_document import open_document, with_positions
from gspn_framework_package.visualizer.layout import PLACE_RADIUS, lay_out


def nearest(points):
    return min(math.dist(a, b) for a, b in itertools.combinations(points.values(), 2))


def test_no_two_nodes_overlap():
    for net in (kanban(2), philosophers(5), philosophers(20)):
        found = lay_out(net)
        assert len(found.positions) == len(net.places) + len(net.transitions)
        assert nearest(found.positions) >= 2 * PLACE_RADIUS


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


def test_positions_that_lie_on_each_other_are_not_used():
    net = Net(
        [Place("a", position=(0.0, 0.0))], [Transition("t", position=(0.0, 0.0))], [Arc("a", "t")]
    )
    assert lay_out(net).engine == "dot"


def test_a_drawing_with_two_nodes_in_one_spot_stays_a_drawing():
    net = drawn()
    places = [*net.places[:-1], net.places[-1]._replace(position=net.places[0].position)]
    stacked = Net(places, net.transitions, net.arcs)
    found = lay_out(stacked)
    assert found.engine == "file"
    assert found.positions["p4"] == found.positions["p0"]
    assert found.positions["p1"] == lay_out(net).positions["p1"]


@pytest.mark.parametrize("with_positions_in_file", [True, False])
def test_the_editor_and_the_board_show_one_drawing(tmp_path, with_positions_in_file):
    net = drawn() if with_positions_in_file else philosophers(6)
    (tmp_path / "plan.json").write_text(json.dumps({"net": net_to_json(net)}))
    opened = open_document(Folder(str(tmp_path)), "plan.json")
    found = lay_out(net).positions
    for node in (*opened.document["net"]["places"], *opened.document["net"]["transitions"]):
        shown = [value * opened.scale for value in node["position"]]
        assert shown == pytest.approx(found[node["name"]], abs=0.5)


@pytest.mark.long
def test_a_large_net_is_laid_out_soon_and_not_as_a_grid():
    found = lay_out(workshop(5000), anew=True, deadline=60.0)
    assert found.engine == "sfdp"
    spots = list(found.positions.values())
    assert layout.nearest_distance(spots) >= 2 * PLACE_RADIUS
    width, height = (max(v) - min(v) for v in zip(*spots))
    assert 0.5 < width / height < 2 and width < 30_000  # seen as a whole at the smallest zoom


def test_a_node_without_a_position_leaves_the_drawing_of_the_others():
    net = drawn()
    places = [*net.places, Place("new"), Place("newer")]
    found, before = lay_out(Net(places, net.transitions, net.arcs)), lay_out(net)
    assert found.engine == "file"
    for name, where in before.positions.items():
        assert found.positions[name] == pytest.approx(where)
    assert nearest(found.positions) >= 2 * PLACE_RADIUS
    edited = with_positions(net_to_json(Net(places, net.transitions, net.arcs)))[0]
    scale = before.positions["p1"][0] / 30.0
    new = {node["name"]: node["position"] for node in edited["places"]}
    for name in ("new", "newer"):  # every mode shows them in one place
        assert found.positions[name] == pytest.approx([v * scale for v in new[name]], abs=1)


def test_without_graphviz_a_grid_does(monkeypatch):
    monkeypatch.setattr(layout, "_graphviz", lambda *arguments: None)
    found = lay_out(philosophers(9))
    assert found.engine == "grid" and nearest(found.positions) >= 2 * PLACE_RADIUS


def test_graphviz_has_a_deadline():
    assert layout._graphviz(philosophers(60), {}, "dot", 0.001) is None


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


# -- subnets ---------------------------------------------------------------------------------------


def plan_with_docks(folder, around_dock=(300.0, 200.0), inside=True, nested=False):
    """A drawn plan whose places Dock and Bay stand for another drawn plan."""

    def at(x, y):
        return {"position": [x, y]} if inside else {}

    dock = {
        "net": {
            "places": [{"name": "In", **at(0, 0)}, {"name": "Out", **at(0, 240)}],
            "transitions": [{"name": "in", **at(40, 120)}],
            "arcs": [{"from": "In", "to": "in"}, {"from": "in", "to": "Out"}],
        },
        "actions": {"In": "a.b", "Out": "a.b"},
    }
    link = {"plan": "dock.json", "entry": "In", "exit": "Out"}
    if nested:
        dock["actions"]["In"] = {"plan": "inner.json", "entry": "In", "exit": "Out"}
        inner = copy.deepcopy(dock)
        inner["actions"]["In"] = "a.b"
        (folder / "inner.json").write_text(json.dumps(inner))
    nodes = {"Work": (10.0, 20.0), "Dock": around_dock, "Bay": (300.0, 20.0)}
    turns = {"go": (155.0, 110.0), "back": (155.0, 300.0), "park": (155.0, 20.0)}
    arcs = [("Work", "go"), ("go", "Dock"), ("Dock", "back"), ("back", "Work")]
    arcs += [("Work", "park"), ("park", "Bay"), ("Bay", "back")]
    plan = {
        "net": {
            "places": [{"name": n, "position": at} for n, at in nodes.items() if at],
            "transitions": [{"name": n, "position": at} for n, at in turns.items()],
            "arcs": [{"from": a, "to": b} for a, b in arcs],
        },
        "actions": {"Work": "a.b", "Dock": link, "Bay": link},
    }
    (folder / "dock.json").write_text(json.dumps(dock))
    (folder / "plan.json").write_text(json.dumps(plan))
    return read_plan(str(folder)), net_from_json(plan["net"])


def test_a_group_stays_together():
    places = [Place("p%d" % i) for i in range(12)]
    transitions = [Transition("t%d" % i) for i in range(11)]
    arcs = [Arc("p%d" % i, "t%d" % i) for i in range(11)]
    arcs += [Arc("t%d" % i, "p%d" % (i // 2)) for i in range(11)]
    net = Net(places, transitions, arcs)
    group = ["p2", "p9", "t9", "p11"]

    def in_box(found):
        """The nodes in the box around the group."""
        low, high = (
            [pick(found.positions[node][axis] for node in group) for axis in (0, 1)]
            for pick in (min, max)
        )
        return {
            name
            for name, at in found.positions.items()
            if all(low[i] - 20 < at[i] < high[i] + 20 for i in (0, 1))
        }

    assert in_box(lay_out(net)) > set(group)  # others are among them
    assert in_box(lay_out(net, groups={"G": group})) == set(group)


@pytest.mark.parametrize("nested", [False, True])
def test_a_plan_with_subnets_is_laid_out_as_it_is_drawn(tmp_path, nested):
    plan, drawn_net = plan_with_docks(tmp_path, nested=nested)
    found, wanted = lay_out(plan.net, subnets=plan.subnets), lay_out(drawn_net)
    assert found.engine == wanted.engine == "file"
    assert found.positions.keys() == {
        node.name for node in (*plan.net.places, *plan.net.transitions)
    }
    entries = {name: subnet.entry for name, subnet in plan.subnets.items()}
    for name, where in wanted.positions.items():
        assert found.positions[entries.get(name, name)] == pytest.approx(where)
    entry, leaving = (found.positions[name] for name in (entries["Dock"], "Dock.Out"))
    assert leaving[0] == pytest.approx(entry[0]) and leaving[1] > entry[1] + 2 * PLACE_RADIUS


def test_a_subnet_without_a_drawing_leaves_that_of_its_plan(tmp_path):
    plan, drawn_net = plan_with_docks(tmp_path, inside=False)
    found, wanted = lay_out(plan.net, subnets=plan.subnets), lay_out(drawn_net)
    for name in ("Work", "go", "back"):
        assert found.positions[name] == pytest.approx(wanted.positions[name])
    assert found.positions["Dock.In"] == pytest.approx(wanted.positions["Dock"])
    parts = [
        [found.positions["%s.%s" % (n, p)] for p in ("In", "in", "Out")] for n in ("Dock", "Bay")
    ]
    for part in parts:
        assert nearest(dict(enumerate(part))) >= 2 * PLACE_RADIUS


def test_anew_every_drawing_is_laid_out(tmp_path):
    plan, drawn_net = plan_with_docks(tmp_path)
    found = lay_out(plan.net, subnets=plan.subnets, anew=True)
    wanted = lay_out(drawn_net, anew=True)
    assert found.engine == wanted.engine == "dot"
    assert found.positions["Dock.In"] == pytest.approx(wanted.positions["Dock"])
    assert found.positions["go"] == pytest.approx(wanted.positions["go"])
