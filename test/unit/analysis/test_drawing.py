"""Coverability trees and Markov chains as pictures."""

import re
import shutil

import pytest

from benchmarks.large_nets import ring
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.drawing import chain_graph, tree_graph
from gspn_framework_package.analysis.state_space.coverability import CoverabilityTree
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import write_net
from gspn_framework_package.model.builder import NetBuilder


def growing_net():
    return (
        NetBuilder("growing")
        .place("a", 1)
        .place("b")
        .place("c")
        .exponential("make", inputs="a", outputs=["a", "b"])
        .exponential("stop", inputs="a", outputs="c")
        .build()
    )


def choosing_net():
    return (
        NetBuilder("choosing")
        .place("a", 1)
        .place("b")
        .place("c")
        .place("d")
        .exponential("go", rate=4, inputs="a", outputs="b")
        .immediate("left", weight=1, inputs="b", outputs="c")
        .immediate("right", weight=3, inputs="b", outputs="d")
        .exponential("back", rate=0.5, inputs="c", outputs="a")
        .build()
    )


def nodes(text):
    return dict(re.findall(r'^  "(\d+)" \[label="([^"]*)"', text, re.MULTILINE))


def edges(text):
    return set(re.findall(r'^  "(\d+)" -> "(\d+)" \[label=" ?([^"]*?) ?"\]', text, re.MULTILINE))


def test_a_tree_with_omega():
    text = tree_graph(CoverabilityTree(growing_net())).text()
    shown = nodes(text)
    assert sorted(shown.values()) == ["a", "a, ω b", "a, ω b", "c", "ω b, c"]
    firings = sorted((shown[s], name, shown[t]) for s, t, name in edges(text))
    assert firings == [
        ("a", "make", "a, ω b"),
        ("a", "stop", "c"),
        ("a, ω b", "make", "a, ω b"),
        ("a, ω b", "stop", "ω b, c"),
    ]
    assert text.count('color="red"') == 2  # where nothing can fire
    assert text.count("dashed") == 1  # the marking that the tree has already


def test_labels_beside_each_other_do_not_read_as_one():
    text = chain_graph(Analysis(choosing_net()).chain).text()
    assert 'label=" 0.5 "' in text and "edgesfirst" in text


def test_a_chain_without_its_vanishing_markings():
    text = chain_graph(Analysis(choosing_net()).chain).text()
    shown = nodes(text)
    assert sorted(shown.values()) == ["a", "c", "d"]
    rates = sorted((shown[s], shown[t], rate) for s, t, rate in edges(text))
    assert rates == [("a", "c", "1"), ("a", "d", "3"), ("c", "a", "0.5")]
    assert text.count('color="red"') == 1
    assert text.count("penwidth") == 1


def test_a_large_chain_is_drawn_without_its_rates_and_says_so(tmp_path, capsys):
    write_net(ring(150), tmp_path / "n.xml")
    words = ["draw", str(tmp_path / "n.xml"), "--what", "chain", "-o"]
    assert main([*words, str(tmp_path / "n.dot")]) == 0
    assert capsys.readouterr().err == ""
    text = (tmp_path / "n.dot").read_text(encoding="utf-8")
    assert len(edges(text)) == 150  # each with its rate
    assert 'layout="sfdp"' in text
    if shutil.which("dot") is None:
        pytest.skip("Graphviz is not installed")
    assert main([*words, str(tmp_path / "n.svg")]) == 0
    note = "150 states; the rates of the 150 arcs are left out"
    assert note in capsys.readouterr().err
    picture = (tmp_path / "n.svg").read_text(encoding="utf-8").replace("&#160;", " ")
    assert note in picture
    assert picture.count("<text") == 151  # the states and the note


def test_a_chain_that_starts_by_chance():
    net = choosing_net().with_marking({"b": 1})
    text = chain_graph(Analysis(net).chain).text()
    assert "c\\nstart 0.25" in nodes(text).values()
    assert "d\\nstart 0.75" in nodes(text).values()


@pytest.mark.skipif(shutil.which("dot") is None, reason="Graphviz is not installed")
def test_the_command_draws_both(tmp_path, capsys):
    write_net(choosing_net(), tmp_path / "n.xml")
    for what in ["coverability", "chain"]:
        out = tmp_path / (what + ".svg")
        assert main(["draw", str(tmp_path / "n.xml"), "-o", str(out), "--what", what]) == 0
        assert b"<svg" in out.read_bytes()
    assert capsys.readouterr() == ("", "")


def test_a_limit_that_is_met(tmp_path, capsys):
    write_net(choosing_net().with_marking({"a": 40}), tmp_path / "n.xml")
    for what in ["coverability", "chain"]:
        words = ["draw", str(tmp_path / "n.xml"), "-o", str(tmp_path / "n.svg"), "--what", what]
        assert main([*words, "--limit", "20"]) == 1
        shown = capsys.readouterr().err
        assert shown.startswith("gspn: error: ")
        assert "more than 20 nodes" in shown or "not decided within" in shown
    assert not (tmp_path / "n.svg").exists()
