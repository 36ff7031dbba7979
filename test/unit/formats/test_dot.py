"""Drawing with Graphviz."""

import math
import re
import shutil
import sys
import time

import pytest
from hypothesis import HealthCheck, example, given, settings
from lxml import etree
from random_nets import nets

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import dot, read_net, write_net
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import InputError, LimitError, UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.subnet import Subnet

needs_graphviz = pytest.mark.skipif(shutil.which("dot") is None, reason="Graphviz is not installed")


def small_net(**position):
    return (
        NetBuilder("small")
        .place("a", tokens=7, capacity=9)
        .place("b", tokens=2)
        .exponential("slow", rate=0.5, servers=None, inputs={"a": 3}, outputs="b")
        .immediate("fast", weight=2, priority=4, inputs="b", outputs="a", inhibitors={"a": 5})
        .build()
    )


def titles(svg, kind):
    """The names of the nodes or edges in a picture."""
    root = etree.fromstring(svg)
    groups = [g for g in root.iter("{*}g") if g.get("class") == kind]
    return sorted(g.findtext("{*}title") for g in groups)


def texts(svg):
    return [text.text for text in etree.fromstring(svg).iter("{*}text")]


@needs_graphviz
def test_a_picture_has_every_node_and_arc_and_number():
    svg = dot.render(dot.net_graph(small_net()).text())
    assert titles(svg, "node") == ["a", "b", "fast", "slow"]
    assert titles(svg, "edge") == ["a->fast", "a->slow", "b->fast", "fast->a", "slow->b"]
    shown = texts(svg)
    for text in ["7", "●●", "≤ 9", "λ 0.5 ∞", "w 2", "π 4", "3", "5"]:
        assert text in shown


@needs_graphviz
def test_another_marking():
    shown = texts(dot.render(dot.net_graph(small_net(), marking=(0, 12)).text()))
    assert "12" in shown
    assert "7" not in shown


@needs_graphviz
@pytest.mark.parametrize("image, start", [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_kinds_of_pictures(image, start):
    assert dot.render(dot.net_graph(small_net()).text(), image).startswith(start)


@needs_graphviz
def test_positions_are_kept():
    net = (
        NetBuilder("n")
        .place("left", position=(0, 10))
        .place("right", position=(300, 10))
        .immediate("top", position=(150, -90), inputs="left", outputs="right")
        .build()
    )
    svg = dot.render(dot.net_graph(net).text()).decode()
    at = {}
    for name, x, y in re.findall(
        r"<title>(left|right|top)</title>.*?(?:cx=|points=)\"(-?[\d.]+)\"?[ ,](?:cy=\")?(-?[\d.]+)",
        svg,
        re.DOTALL,
    ):
        at[name] = float(x), float(y)
    assert at["right"][0] - at["left"][0] == pytest.approx(300, abs=1)
    assert at["right"][1] == pytest.approx(at["left"][1], abs=1)
    assert at["top"][1] < at["left"][1] - 60  # y goes down in our drawings, as on the screen


def test_fixed_nodes_get_arcs_and_labels_at_fixed_spots():
    net = (
        NetBuilder("n")
        .place("left", position=(0, 10))
        .place("right", position=(300, 10))
        .immediate("top", position=(150, -90), inputs={"left": 2}, outputs="right")
        .build()
    )
    text = dot.net_graph(net).text()
    assert 'layout="nop2"' in text
    assert len(re.findall(r'xlp="[-\d.]+,[-\d.]+"', text)) == 3
    assert len(re.findall(r'-> "\w+" \[.*pos="e,', text)) == 2
    assert len(re.findall(r' lp="', text)) == 1
    far = NetBuilder("far").place("a", position=(0, 0)).place("b", position=(1e300, 3)).build()
    assert 'layout="neato"' in dot.net_graph(far).text()


def test_a_subnet_is_drawn_as_it_was_and_the_nodes_around_it_make_room():
    net = (
        NetBuilder("n")
        .place("a", position=(0, 0))
        .place("S.in", position=(100, 0))
        .place("S.out", position=(300, -50))
        .immediate("S.t", position=(200, 0), inputs="S.in", outputs="S.out")
        .immediate("go", position=(50, 0), inputs="a", outputs="S.in")
        .immediate("back", position=(150, 0), inputs="S.out", outputs="a")
        .build()
    )
    arcs = [a._replace(bends=((225.0, 70.0),)) if a.source == "S.out" else a for a in net.arcs]
    bent = Net(net.places, net.transitions, arcs, net.name)
    subnets = {"S": Subnet("plan", "S.in", "S.out", ("S.in", "S.out"), ("S.t",))}
    text = dot.net_graph(bent, subnets=subnets).text()
    at = dict(re.findall(r'^ *"([\w.]+)" \[.*\bpos="([-\d.,]+)!', text, re.MULTILINE))
    assert at["S.out"] == "300.00,50.00" and at["go"] == "50.00,0.00"
    assert at["back"] == "350.00,0.00"  # as far to the right as the subnet reaches
    course = re.findall(r'"S.out" -> "back" \[.*pos="e,([-\d., ]+)', text)[0]
    points = [tuple(map(float, point.split(","))) for point in course.split()]
    assert min(math.dist(point, (325, -70)) for point in points) < 20
    assert text.count("bb=") == 1


@pytest.mark.long
@needs_graphviz
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(net=nets())
@example(net=NetBuilder().place("&lt;&amp;").place("a\\").place('"\\n"').place("<b>x</b>").build())
def test_names_are_shown_as_they_are(net):
    shown = [text.replace("\xa0", " ") for text in texts(dot.render(dot.net_graph(net).text()))]
    for node in (*net.places, *net.transitions):
        assert node.name in shown


@needs_graphviz
def test_text_that_is_no_graph():
    with pytest.raises(InputError, match="Graphviz cannot draw it: Error: "):
        dot.render("digraph { a -> ")


def test_an_unknown_kind_of_picture():
    with pytest.raises(UsageError, match="'gif' is not supported"):
        dot.render("digraph {}", "gif")


def test_graphviz_that_is_missing_or_hangs(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError, match="not installed"):
        dot.render("digraph {}")
    sleeper = tmp_path / "dot"
    sleeper.write_text("#!%s\nimport time\ntime.sleep(60)\n" % sys.executable)
    sleeper.chmod(0o755)
    start = time.monotonic()
    with pytest.raises(LimitError, match="did not finish in 0.5 s"):
        dot.render("digraph {}", timeout=0.5)
    assert time.monotonic() - start < 30


@needs_graphviz
def test_the_command_draws(tmp_path, capsys):
    write_net(small_net(), tmp_path / "n.xml")
    for name in ["n.svg", "n.png", "n.dot"]:
        assert main(["draw", str(tmp_path / "n.xml"), "-o", str(tmp_path / name)]) == 0
        assert (tmp_path / name).stat().st_size > 200
    assert capsys.readouterr() == ("", "")


def test_the_command_refuses_other_pictures(tmp_path, capsys):
    write_net(small_net(), tmp_path / "n.xml")
    assert main(["draw", str(tmp_path / "n.xml"), "-o", str(tmp_path / "n.gif")]) == 2
    assert "use the ending .svg" in capsys.readouterr().err
    assert read_net(tmp_path / "n.xml") == small_net()
