"""Changes of net files: what is not changed keeps its text, and what is changed reads back."""

import glob
import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from random_nets import NAMES, nets

from gspn_framework_package.formats.draft import ReadOptions
from gspn_framework_package.formats.format import Format, TextReader
from gspn_framework_package.formats.net_equality import same_net
from gspn_framework_package.formats.net_update import update_net
from gspn_framework_package.formats.registry import FORMATS, read_net
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.net import Arc, Net, Place, Transition

OPTIONS = ReadOptions()
PLANS = sorted(glob.glob("plans/*/*.xml"))
DATA = [
    (str(path), "machine" if path.suffix == ".PNPRO" else None)
    for path in sorted(Path("test/unit/formats/data").iterdir())
    if path.suffix != ".net"
]


def read(tmp_path, data, name="net.xml", options=OPTIONS):
    (tmp_path / name).write_bytes(data)
    return read_net(str(tmp_path / name), options)


def changed(net, places=None, transitions=None, arcs=None):
    return Net(
        net.places if places is None else places,
        net.transitions if transitions is None else transitions,
        net.arcs if arcs is None else arcs,
        net.name,
    )


def edited(net):
    """The net after one edit of each kind."""
    first, gone = net.places[0], net.transitions[-1]
    names = {first.name: "renamed"}
    places = [first._replace(name="renamed", tokens=7, position=(12.5, -3.0)), *net.places[1:]]
    places.append(Place("new place", 2, None, (1.0, 2.0)))
    transitions = [
        t._replace(rate=2.5) if t.timed else t._replace(weight=0.25) for t in net.transitions[:-1]
    ]
    transitions.append(Transition("new timed", True, 0.5, 1.0, 1, None, (5.0, 6.0)))
    transitions.append(Transition("new", False, 1.0, 3.0, 2, 1, (7.0, 8.0)))
    arcs = [
        a._replace(
            source=names.get(a.source, a.source), target=names.get(a.target, a.target), weight=3
        )
        for a in net.arcs
        if gone.name not in a[:2]
    ]
    arcs += [Arc("new place", "new", 2), Arc("new", "renamed"), Arc("new place", "new timed")]
    arcs.append(Arc("renamed", "new timed", 2, True))
    return changed(net, places, transitions, arcs)


@pytest.mark.long
@pytest.mark.parametrize("path", PLANS)
def test_one_edit_changes_one_line(path, tmp_path):
    data = Path(path).read_bytes()
    net = read_net(path)
    assert update_net(data, path, OPTIONS, net) is data
    for change in (
        {"places": [net.places[0]._replace(tokens=net.places[0].tokens + 1), *net.places[1:]]},
        {"places": [net.places[0]._replace(position=(1.5, 2.5)), *net.places[1:]]},
        {"arcs": net.arcs[:-1]},
        {"arcs": [net.arcs[0]._replace(bends=((1.5, 2.5), (3.0, -4.0))), *net.arcs[1:]]},
    ):
        new = changed(net, **change)
        text = update_net(data, path, OPTIONS, new)
        assert same_net(read(tmp_path, text), new)
        lines = data.splitlines(), text.splitlines()
        assert len(set(lines[0]) ^ set(lines[1])) <= 2
        back = update_net(text, path, OPTIONS, net)
        assert "arcs" in change or back == data


@pytest.mark.long
@pytest.mark.parametrize("path", PLANS)
def test_many_edits_of_a_shipped_net(path, tmp_path):
    data = Path(path).read_bytes()
    new = edited(read_net(path))
    text = update_net(data, path, OPTIONS, new)
    assert text is not None and same_net(read(tmp_path, text), new)
    assert b"new place" in text and b"<!--" not in text
    back = update_net(text, path, OPTIONS, read_net(path))
    assert back is not None and same_net(read(tmp_path, back), read_net(path))


@pytest.mark.parametrize(("path", "name"), DATA)
def test_files_of_other_tools_keep_what_is_not_read(path, name, tmp_path):
    data = Path(path).read_bytes()
    options = ReadOptions(net=name) if name and name.encode() in data else OPTIONS
    net = read_net(path, options)
    assert update_net(data, path, options, net) is data
    new = changed(net, [net.places[0]._replace(tokens=9), *net.places[1:]])
    text = update_net(data, path, options, new)
    assert text is not None and same_net(read(tmp_path, text, options=options), new)
    gone = set(data.splitlines()) - set(text.splitlines())
    assert len(gone) <= 1, gone
    everything = edited(net)
    if not path.endswith("PNPRO") or not any(p.capacity for p in everything.places):
        text = update_net(data, path, options, everything)
        assert text is not None and same_net(read(tmp_path, text, options=options), everything)
        elements = re.findall(rb"<(?:toolspecific|arcpath|text-box|point|stateGroup)\b", data)
        assert len(re.findall(rb"<arcpath\b", text)) <= len(elements) + 4


def test_comments_annotations_and_colours_stay(tmp_path):
    data = b"""<?xml version="1.0" encoding="ISO-8859-1"?>
<!-- drawn by Ad\xe9le -->
<pnml>\r
 <net id="n" type="P/T net">\r
  <token id="Red" enabled="true" red="255" green="0" blue="0"/>\r
  <labels x="3" y="4"><text>Mind the step</text></labels>\r
  <place id="P0"><graphics><position x="10" y="20"/></graphics><name><value>a</value>
   <graphics><offset x="-5" y="3"/></graphics></name><initialMarking><value>Red,1</value></initialMarking></place>\r
  <transition id="T0"><name><value>t</value></name><rate><value>2</value></rate>
   <timed><value>true</value></timed></transition><!-- slow -->\r
  <arc id="A" source="P0" target="T0"><inscription><value>Red,1</value></inscription>
   <arcpath id="000" x="1" y="2" curvePoint="false"/></arc>\r
 </net>\r
</pnml>\r
"""
    net = read(tmp_path, data)
    place, transition = net.places[0], net.transitions[0]
    new = changed(
        net,
        [place._replace(tokens=2), Place("b", 1, None, (1.0, 1.0))],
        [transition._replace(rate=3.0)],
        [*net.arcs, Arc("t", "b")],
    )
    text = update_net(data, "net.xml", OPTIONS, new)
    assert same_net(read(tmp_path, text), new)
    for kept in (
        b'<?xml version="1.0" encoding="ISO-8859-1"?>', b"Ad\xe9le", b"Mind the step", b"slow",
        b'<offset x="-5" y="3"/>', b"arcpath", b"Red,2", b"Red,1", b"\r\n </net>\r\n</pnml>\r\n",
    ):  # fmt: skip
        assert kept in text, kept
    assert b"Default" not in text
    renamed = changed(new, [new.places[0]._replace(name="c"), new.places[1]], None,
                      [Arc("c", "t"), Arc("t", "b")])  # fmt: skip
    text = update_net(text, "net.xml", OPTIONS, renamed)
    assert same_net(read(tmp_path, text), renamed)
    assert b'id="P0"' in text and b"<value>c</value>" in text and b"arcpath" in text


@pytest.mark.parametrize("format", ["pipe", "pnml", "pnpro", "tina"])
def test_a_place_and_a_transition_exchange_their_names(format, tmp_path):
    """The arc between them has the same ends, and is another one."""
    old = NetBuilder("m").place("a").immediate("b", inputs="a").immediate("c").build()
    new = NetBuilder("m").place("b").place("c").immediate("a", outputs="b").build()
    for before, after in [(old, new), (new, old)]:
        data = FORMATS[format].to_bytes(before)
        text = update_net(data, "net.xml", OPTIONS, after)
        assert text is not None and same_net(read(tmp_path, text), after)


@st.composite
def pairs(draw, **features):
    """A net, and one that came of it by edits."""
    old, other = draw(nets(**features)), draw(nets(**features))
    names = {n.name for n in [*other.places, *other.transitions]}
    places = [p for p in old.places if draw(st.booleans()) and p.name not in names]
    places += other.places
    transitions = [t for t in old.transitions if draw(st.booleans()) and t.name not in names]
    transitions += other.transitions
    known = {n.name for n in [*places, *transitions]}
    arcs = [a for a in old.arcs if a.source in known and a.target in known]
    kinds = {p.name for p in places}
    arcs = [a for a in arcs if (a.source in kinds) != (a.target in kinds)]
    arcs = [a for a in arcs if not a.inhibitor or a.source in kinds]
    if places and draw(st.booleans()):
        name = draw(NAMES)
        if name not in known:
            was = places[0].name
            places[0] = places[0]._replace(name=name)
            arcs = [
                a._replace(source=name if a.source == was else a.source,
                           target=name if a.target == was else a.target)
                for a in arcs
            ]  # fmt: skip
            renamed = {was: name}
        else:
            renamed = {}
    else:
        renamed = {}
    arcs += [
        a._replace(source=renamed.get(a.source, a.source), target=renamed.get(a.target, a.target))
        for a in other.arcs
    ]
    return old, Net(places, transitions, arcs, old.name)


def plain(net):
    """The net without what TINA's files cannot hold."""
    return Net(
        [place._replace(position=None) for place in net.places],
        [t._replace(rate=1.0, weight=1.0, priority=1, position=None) for t in net.transitions],
        [arc._replace(bends=()) for arc in net.arcs],
        net.name,
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("format", "features"),
    [
        ("pipe", {"servers": (1, None)}),
        ("pnml", {}),
        ("pnpro", {"capacities": False}),
        ("tina", {"capacities": False, "servers": (1,)}),
    ],
)
def test_any_net_becomes_any_other(format, features, tmp_path_factory):
    folder = tmp_path_factory.mktemp("nets")

    @settings(suppress_health_check=list(HealthCheck), deadline=None, max_examples=30)
    @given(pairs(**features))
    def becomes(pair):
        written, wanted = map(plain, pair) if format == "tina" else pair
        data = FORMATS[format].to_bytes(written)
        old = read(folder, data)
        assume(same_net(old, written))
        assert update_net(data, "net.xml", OPTIONS, old) is data
        text = update_net(data, "net.xml", OPTIONS, wanted)
        assert text is not None
        assert same_net(read(folder, text), wanted)
        again = update_net(text, "net.xml", OPTIONS, old)
        assert again is not None and same_net(read(folder, again), old)

    becomes()


def test_lines_of_tina_files_stay(tmp_path):
    data = b"""# a machine\r
net m\r
pl  idle   (1)\r
pl waiting (0)\r
tr start [0,0] idle*1  waiting?-1 -> busy\r
nt n 1 {Mind the step}\r
tr stop  [0,w[ busy*1 ->  idle*1\r
"""
    net = read(tmp_path, data, "net.net")
    assert update_net(data, "net.net", OPTIONS, net) is data
    waiting = net.places[net.place_index["waiting"]]
    others = [place for place in net.places if place is not waiting]
    new = changed(net, [*others, waiting._replace(tokens=2)])
    text = update_net(data, "net.net", OPTIONS, new)
    assert text == data.replace(b"waiting (0)", b"waiting (2)")
    arcs = [a._replace(weight=3) if a.source == "busy" else a for a in net.arcs]
    more = changed(net, [*net.places, Place("done")], None, [*arcs, Arc("stop", "done")])
    text = update_net(data, "net.net", OPTIONS, more)
    assert same_net(read(tmp_path, text, "net.net"), more)
    gone = set(data.splitlines()) - set(text.splitlines())
    assert gone == {b"tr stop  [0,w[ busy*1 ->  idle*1"} and b"\r\npl done (0)\r\n" in text
    fewer = changed(net, None, net.transitions[:1], [a for a in net.arcs if "stop" not in a[:2]])
    text = update_net(data, "net.net", OPTIONS, fewer)
    assert same_net(read(tmp_path, text, "net.net"), fewer) and b"Mind the step" in text
    fast = changed(net, None, [t._replace(rate=2.0) if t.timed else t for t in net.transitions])
    assert update_net(data, "net.net", OPTIONS, fast) is None


def test_what_a_format_cannot_hold_is_not_written(tmp_path):
    net = read_net("plans/tokens/net.xml")
    timed = next(t for t in net.transitions if t.timed)
    others = [t for t in net.transitions if t is not timed]
    many = changed(net, None, [timed._replace(servers=3), *others])
    data = Path("plans/tokens/net.xml").read_bytes()
    assert update_net(data, "net.xml", OPTIONS, many) is None
    full = changed(net, [net.places[0]._replace(capacity=5), *net.places[1:]])
    assert update_net(FORMATS["pnpro"].to_bytes(net), "n", OPTIONS, full) is None


def test_a_format_is_changed_as_its_record_says(monkeypatch):
    """Also one from outside the package; without ``update`` its files are left alone."""

    def read(text, path, options):
        return Net([Place(name) for name in text.split()[1:]], []), []

    mine = Format(
        "listed",
        "a list",
        (".listed",),
        lambda net: b"",
        TextReader(read, lambda text: text.startswith("listed")),
        update=lambda data, options, old, new: data + b" " + new.places[-1].name.encode(),
    )
    monkeypatch.setitem(FORMATS, "listed", mine)
    bigger = Net([Place("A"), Place("B")], [])
    assert update_net(b"listed A", "x", ReadOptions(), bigger) == b"listed A B"
    monkeypatch.setitem(FORMATS, "listed", replace(mine, update=None))
    assert update_net(b"listed A", "x", ReadOptions(), bigger) is None
