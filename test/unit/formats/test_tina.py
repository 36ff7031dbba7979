"""The .net format of TINA."""

from pathlib import Path

import pytest

from gspn_framework_package.formats import read_net_with_notes
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import InputError

DATA = Path(__file__).parent / "data"


def read_text(tmp_path, text):
    path = tmp_path / "n.net"
    path.write_text(text)
    return read_net_with_notes(path)[0]


def test_a_net_by_hand():
    net, notes = read_net_with_notes(DATA / "tina.net")
    assert net == (
        NetBuilder("a net")
        .place("p1", tokens=4)
        .place("p 2", tokens=1)
        .place("p3")
        .place("p4", tokens=2)
        .exponential("t1")
        .immediate("t2")
        .exponential("t3")
        .arc("p1", "t1", 2)
        .arc("p 2", "t1")
        .arc("t1", "p 2")
        .arc("t1", "p3", 1000)
        .arc("p3", "t2")
        .inhibitor("p1", "t2", 3)
        .arc("t2", "p1")
        .arc("t2", "p 2")
        .arc("t3", "p4")
        .arc("p4", "t3", 2)
        .build()
    )
    assert "no rates" in notes[0]


def test_a_transition_may_be_told_twice(tmp_path):
    net = read_text(tmp_path, "tr t [0,0] a -> b\ntr t -> c\npl a (1)\npl a (2)\n")
    assert net == (
        NetBuilder()
        .place("a", 3)
        .place("b")
        .place("c")
        .immediate("t", inputs="a", outputs=["b", "c"])
        .build()
    )


@pytest.mark.parametrize(
    "text, line, message",
    [
        ("tr t [1,2] a -> b", 1, "the time interval [1,2]"),
        ("pl a\ntr t a!1 -> b", 2, "stopwatch"),
        ("tr t a -> b\ntr u a -> b\npr t > u", 3, "priorities"),
        ("tr t a b", 1, "'->' was expected"),
        ("tr t a -> b (2)", 1, "'(2)' is not possible there"),
        ("tr", 1, "the name of a transition was expected"),
        ("tr t a -> b?1", 1, "cannot be a test arc"),
        ("pl a (x)", 1, "cannot be read"),
        ("pl a (%s)" % ("9" * 40), 1, "a number of"),
        ("tr t a -> t", 1, "already taken"),
        ("pl a\nxy z", 2, "begins with 'xy'"),
        ("tr t a*0 -> b", 1, "weight 0"),
        ("net {x}", None, "no place and no transition"),
    ],
)
def test_what_is_wrong_is_reported_with_its_line(tmp_path, text, line, message):
    with pytest.raises(InputError, match="n.net") as raised:
        read_text(tmp_path, text)
    assert message in str(raised.value)
    assert raised.value.line == line
