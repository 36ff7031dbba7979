"""PNPRO, the project files of GreatSPN."""

from pathlib import Path

import pytest

from gspn_framework_package.formats import read_net, read_net_with_notes, write_net
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.model.net import Arc, Net

DATA = Path(__file__).parent / "data"
PROJECT = DATA / "greatspn.PNPRO"


def read_nodes(tmp_path, nodes, edges=""):
    path = tmp_path / "net.PNPRO"
    path.write_text(
        '<project>\n<gspn name="n">\n<nodes>\n%s\n</nodes><edges>\n%s\n</edges></gspn></project>'
        % (nodes, edges)
    )
    return read_net(path)


def test_expressions_defaults_and_positions():
    net, notes = read_net_with_notes(PROJECT, net="machine")
    bent = [arc.bends for arc in net.arcs if arc.bends]
    assert bent == [((72.0, 64.0),)]  # a unit to the right of, and below, the corner of a place
    straight = Net(net.places, net.transitions, [a._replace(bends=()) for a in net.arcs], net.name)
    assert straight == (
        NetBuilder("machine")
        .place("waiting", tokens=5, position=(64, 64))
        .place("working", position=(192, 64))
        .place("tools", tokens=6, position=(192, 128))
        .exponential("begin", rate=1.0, servers=None, position=(128, 64))
        .exponential("finish", rate=0.15, servers=3, position=(256, 64))
        .exponential("slow", rate=1.0, servers=1, position=(256, 128))
        .immediate("skip", weight=0.25, priority=2, position=(128, 128))
        .immediate("plain", weight=1.0, priority=1, position=(128, 192))
        .arc("waiting", "begin")
        .arc("tools", "begin", 2)
        .arc("begin", "working")
        .arc("working", "finish")
        .arc("finish", "waiting")
        .arc("finish", "tools", 2)
        .arc("working", "slow")
        .inhibitor("working", "skip", 4)
        .arc("waiting", "skip")
        .arc("waiting", "plain")
        .build()
    )
    assert notes == ["N = 5: the value that the template was last used with"]


def test_constants_from_outside_replace_those_of_the_file():
    net, notes = read_net_with_notes(
        PROJECT, net="machine", constants={"N": 7, "K": 2, "lambda": 10.0}
    )
    assert net.initial_marking == (7, 0, 4)
    assert net.transition("begin").rate == 10.0
    assert net.transition("finish").servers == 2
    assert notes == []


def test_the_older_names_of_attributes():
    assert read_net(PROJECT, net="old").arcs == (Arc("A", "t"), Arc("t", "A"))


def test_import_options():
    net = read_net(PROJECT, net="machine", infinite_servers=False, missing_weight=0.0)
    assert net.transition("begin").servers == 1
    assert net.transition("finish").servers == 3  # the file says so
    assert net.transition("plain").weight == 0.0
    assert net.transition("skip").weight == 0.25


def test_several_nets_and_a_composition():
    with pytest.raises(InputError, match=r"holds 2 nets .*'machine', 'old'"):
        read_net(PROJECT)
    with pytest.raises(InputError, match=r"<unfolding> 'both': it is composed of other nets"):
        read_net(PROJECT, net="both")


@pytest.mark.parametrize(
    "nodes, edges, line, message",
    [
        ('<color-class name="C" definition="c{1..2}"/>', "", 4, "a coloured net"),
        ('<place name="a" domain="C"/>', "", 4, "a coloured net"),
        (
            '<place name="a"/><transition name="t"/>',
            '\n<arc head="t" tail="a" kind="INPUT" mult="&lt;x&gt;"/>',
            7,
            "a coloured net",
        ),
        ('<place name="a" type="CONTINUOUS"/>', "", 4, "a fluid place"),
        ('<transition name="t" type="GEN" delay="I[1]"/>', "", 4, "of a general distribution"),
        ('<transition name="t" type="CONT"/>', "", 4, "with a continuous flow"),
        ('<transition name="t" type="ODD"/>', "", 4, "of the unknown type 'ODD'"),
        ('<transition name="t" type="IMM" guard="x = y"/>', "", 4, "its guard"),
        ('<transition name="t" type="EXP" delay="2 * #a"/>', "", 4, "there is no place 'a'"),
        ('<transition name="t" type="EXP" delay="2 * # 3"/>', "", 4, "a place was expected"),
        ('<transition name="t" type="EXP" delay="nu"/>', "", 4, "'nu' has no value"),
        ('<transition name="t" type="EXP" delay="1/0"/>', "", 4, "division by zero"),
        ('<transition name="t" type="EXP" nservers="0"/>', "", 4, "number of servers 0"),
        (
            '<template name="N" type="INTEGER"/>\n<place name="a" marking="N"/>',
            "",
            5,
            "'N' has no value",
        ),
        (
            '<constant name="a" value="b"/>\n<constant name="b" value="a"/><place name="p"/>',
            "",
            4,
            "defined by each other: a -> b -> a",
        ),
        ('<place name="a"/>', '\n<arc head="t" tail="a" kind="INPUT"/>', 7, "'t'"),
        (
            '<place name="a"/><transition name="t"/>',
            '\n<arc head="t" tail="a" kind="RESET"/>',
            7,
            "'RESET'",
        ),
        ("<place/>", "", 4, "neither an id nor a name"),
    ],
)
def test_what_is_wrong_is_reported_with_its_line(tmp_path, nodes, edges, line, message):
    with pytest.raises(InputError, match="net.PNPRO") as raised:
        read_nodes(tmp_path, nodes, edges)
    assert message in str(raised.value)
    assert raised.value.line == line


def test_capacities_are_written_as_inhibitor_arcs(tmp_path):
    net = (
        NetBuilder("n")
        .place("a", 2)
        .place("b", capacity=3)
        .exponential("t", inputs="a", outputs={"b": 2})
        .build()
    )
    notes = write_net(net, tmp_path / "n.pnpro")
    assert notes == ["capacities are written as equivalent inhibitor arcs"]
    back = read_net(tmp_path / "n.pnpro")
    assert back.inhibitors == (((1, 2),),)
    for marking in [(2, 0), (2, 1), (2, 2), (2, 3), (0, 0)]:
        assert back.is_enabled(marking, 0) == net.is_enabled(marking, 0)


@pytest.mark.parametrize(
    "text, value",
    [
        ("Max[2, 3]", 3),
        ("Min[N, 2*N] + Floor[2.7]", 6),
        ("Fract[2*N, 4]", 2),
        ("Max[Fract[9, 3], Abs[-N]]", 4),
        ("Pow[2,Round[2.5]]", 8),
        ("Max[(N), Fract[(8), (Mod[10, 8])]]", 4),
    ],
)
def test_functions_as_the_editor_writes_them(tmp_path, text, value):
    net = (
        '<project><gspn name="n"><nodes><constant name="N" value="Max[4, 1]"/><place name="p" marking="%s"/>'
        '<transition name="t" type="EXP" delay="%s"/></nodes></gspn></project>' % (text, text)
    )
    path = tmp_path / "net.PNPRO"
    path.write_text(net)
    assert read_net(path).place("p").tokens == value
    assert read_net(path).transition("t").rate == value


@pytest.mark.parametrize(
    "text, message",
    [
        ("If[N == 2, 3, 4]", r"uses If\[...\], which is not read"),
        ('FromList["file", 2]', r"uses FromList\[...\], which is not read"),
        ("Fract[1]", "Fract.* without two numbers"),
        ("Fract[1, 2, 3]", "Fract.* without two numbers"),
        ("Max[1, 2", "was expected"),
        ("[2]", "cannot be computed"),
        ("max(2, 3]", "cannot be computed"),
    ],
)
def test_functions_that_are_not_read_are_refused(tmp_path, text, message):
    path = tmp_path / "net.PNPRO"
    escaped = text.replace('"', "&quot;")
    path.write_text(
        '<project><gspn name="n"><nodes>\n<place name="p" marking="%s"/></nodes></gspn></project>'
        % escaped
    )
    with pytest.raises(InputError, match=message) as caught:
        read_net(path)
    assert caught.value.line == 2
    assert caught.value.element == "place 'p'"
