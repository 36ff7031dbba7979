"""PIPE XML: every generation's way to write the same thing, and what is refused."""

import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gspn_framework_package.formats import read_net, read_net_with_notes
from gspn_framework_package.formats.draft import NetDraft
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import InputError

DATA = Path(__file__).parent / "data"


def read_text(tmp_path, text, **options):
    path = tmp_path / "net.xml"
    path.write_text(text, encoding="utf-8")
    return read_net_with_notes(path, **options)


def document(*elements, net='<net id="n" type="P/T net">'):
    return "<pnml>\n%s\n%s\n</net></pnml>" % (net, "\n".join(elements))


def place(name, rest=""):
    return '<place id="%s"><name><value>%s</value></name>%s</place>' % (name, name, rest)


def transition(name, rest=""):
    return '<transition id="%s"><name><value>%s</value></name>%s</transition>' % (name, name, rest)


def arc(source, target, rest=""):
    return '<arc id="%s to %s" source="%s" target="%s">%s</arc>' % (
        source,
        target,
        source,
        target,
        rest,
    )


def test_version_2_plain_numbers_and_nothing_else():
    assert read_net(DATA / "pipe_2.xml") == (
        NetBuilder("Net-One")
        .place("Café", tokens=2, position=(90, 105))
        .place("Busy", position=(285, 105))
        .exponential("start", rate=0.25, inputs="Café", outputs={"Busy": 2}, position=(195, 45))
        .immediate("stop", weight=3, inputs={"Busy": 2}, outputs="Café", position=(195, 165))
        .build()
    )


def test_the_dialect_of_the_thesis():
    net, notes = read_net_with_notes(DATA / "pipe_3_thesis.xml")
    cold, go_on = "t1:Cold", "t2:Go on"
    assert net == (
        NetBuilder("Net-One")
        .place("p1:Check_Temperature_L1", tokens=1, position=(30, 60))
        .place("p2:Decide Next L1", capacity=3)
        .place("r:battery", tokens=5)
        .exponential(cold, rate=0.5, servers=None)
        .immediate(go_on, weight=0.75, priority=2)
        .arc("p1:Check_Temperature_L1", cold)
        .arc(cold, "p2:Decide Next L1")
        .arc("p2:Decide Next L1", go_on)
        .arc(go_on, "p1:Check_Temperature_L1")
        .arc("r:battery", cold, 2)
        .inhibitor("p1:Check_Temperature_L1", go_on, 4)
        .build()
    )
    assert notes == []


def test_colours_that_are_declared_but_not_used():
    net = read_net(DATA / "pipe_4_colours_declared.xml")
    assert net.initial_marking == (3, 0)
    assert net.fire(net.initial_marking, 0) == (2, 2)  # @ is a comma: min(2, 3)


def test_version_5_empty_values_and_expressions():
    net = read_net(DATA / "pipe_5.xml")
    assert net == (
        NetBuilder("")
        .place("P0", tokens=1, position=(255, 240))
        .place("P1")
        .exponential("T0", rate=1.0)
        .exponential("T1", rate=0.5)
        .arc("P0", "T0")
        .arc("T0", "P1")
        .arc("P1", "T1")
        .arc("T1", "P0")
        .inhibitor("P1", "T0")
        .build()
    )


def test_a_constant_from_outside_goes_first():
    net = read_net(DATA / "pipe_5.xml", constants={"base": 16})
    assert net.transition("T1").rate == 2.0


def test_everything_is_optional(tmp_path):
    net, notes = read_text(
        tmp_path,
        '<pnml><net><place id="a"/><transition id="t"/><arc source="a" target="t"/></net></pnml>',
    )
    assert net == NetBuilder().place("a").exponential("t", 1.0, inputs="a").build()
    assert notes == ["1 transition without timing: exponential with rate 1"]


def test_servers_and_weights_that_are_not_said(tmp_path):
    text = document(
        place("a"),
        transition("e", "<timed><value>true</value></timed>"),
        transition("i", "<priority><value>1</value></priority>"),
    )
    assert read_text(tmp_path, text)[0].transition("e").servers == 1
    assert read_text(tmp_path, text, infinite_servers=True)[0].transition("e").servers is None
    assert read_text(tmp_path, text)[0].transition("i").weight == 1
    assert read_text(tmp_path, text, missing_weight=0.0)[0].transition("i").weight == 0


def test_names_that_several_elements_share_fall_back_to_ids(tmp_path):
    net, notes = read_text(
        tmp_path,
        document(
            '<place id="P0"><name><value>same</value></name></place>',
            '<place id="P1"><name><value>same</value></name></place>',
            '<place id="P2"><name><value> </value></name></place>',
            '<transition id="T0"><name><value>P0</value></name><timed/></transition>',
            arc("P0", "T0"),
        ),
    )
    assert [p.name for p in net.places] == ["P0", "P1", "P2"]
    assert [t.name for t in net.transitions] == ["T0"]
    assert net.arcs[0][:2] == ("P0", "T0")
    assert len(notes) == 1
    assert "named by id" in notes[0]


def test_arcs_may_name_their_ends(tmp_path):
    net, _ = read_text(
        tmp_path,
        document(
            '<place id="P0"><name><value>here</value></name></place>',
            '<transition id="T0"><name><value>leave</value></name></transition>',
            '<arc source="here" target="leave"/>',
        ),
    )
    assert net.arcs[0][:2] == ("here", "leave")


def test_the_spelling_of_other_tools(tmp_path):
    net, _ = read_text(
        tmp_path,
        document(
            place("a", "<capacity><value>Default,2</value></capacity>"),
            transition("t"),
            arc("t", "a", '<type value="regular"/>'),
            arc("a", "t", '<type value="inhibition"/>'),
        ),
    )
    assert net.place("a").capacity == 2
    assert [a.inhibitor for a in net.arcs] == [False, True]


def test_one_of_several_nets(tmp_path):
    text = '<pnml><net id="x"><place id="a"/></net><net id="y"><place id="b"/></net></pnml>'
    assert read_text(tmp_path, text, net="y")[0].places[0].name == "b"
    with pytest.raises(InputError, match=r"holds 2 nets .*choose one by name: 'x', 'y'"):
        read_text(tmp_path, text)
    with pytest.raises(InputError, match=r"there is no net 'z'"):
        read_text(tmp_path, text, net="z")


@pytest.mark.parametrize(
    "elements, line, message",
    [
        ([place("a"), transition("t"), arc("a", "b")], 5, "there is no place or transition 'b'"),
        ([place("a"), place("b"), arc("a", "b")], 5, "joins two places"),
        ([place("a"), transition("t"), '<arc id="x" source="a"/>'], 5, "it has no target"),
        ([place("a"), place("a")], 4, "the id is already taken by a place in line 3"),
        (
            [place("a", "<initialMarking><value>-1</value></initialMarking>")],
            3,
            "initial marking -1 is not a whole number",
        ),
        (
            [place("a", "<initialMarking><value>1.5</value></initialMarking>")],
            3,
            "'1.5' is not a whole number",
        ),
        (
            [
                place(
                    "a",
                    "<initialMarking><value>3</value></initialMarking>"
                    "<capacity><value>2</value></capacity>",
                )
            ],
            3,
            "above its capacity",
        ),
        (
            [
                place("a"),
                transition("t"),
                arc("a", "t", "<inscription><value>-2</value></inscription>"),
            ],
            5,
            "weight -2",
        ),
        (
            [
                place("a"),
                transition("t"),
                arc("a", "t", "<inscription><value>0</value></inscription>"),
            ],
            5,
            "weight 0",
        ),
        ([place("a"), transition("t"), arc("a", "t", '<type value="reset"/>')], 5, "'reset'"),
        (
            [place("a"), transition("t"), arc("t", "a", '<type value="inhibitor"/>')],
            5,
            "an inhibitor arc goes from a place to a transition",
        ),
        ([place("a"), transition("t", "<rate><value>-1</value></rate>")], 4, "weight -1.0"),
        (
            [
                place("a"),
                transition("t", "<rate><value>0</value></rate><timed><value>true</value></timed>"),
            ],
            4,
            "rate 0.0",
        ),
        (
            [place("a"), transition("t", "<rate><value>speed</value></rate>")],
            4,
            "'speed' has no value",
        ),
        (
            [place("a"), transition("t", "<rate><value>#(a)</value></rate>")],
            4,
            "depends on the marking",
        ),
        (
            [place("a"), transition("t", "<timed><value>maybe</value></timed>")],
            4,
            "neither true nor false",
        ),
        (
            [place("a", "<initialMarking><value>Default,1,Red,1</value></initialMarking>")],
            3,
            "a coloured net",
        ),
        (
            [
                place("a"),
                transition("t"),
                arc("a", "t", "<inscription><value>Red,1</value></inscription>"),
                arc("t", "a", "<inscription><value>Default,1</value></inscription>"),
            ],
            6,
            "a coloured net",
        ),
        (
            ['<definition name="x" expression="y"/>', '<definition name="y" expression="x"/>'],
            None,
            "constants are defined by each other: x -> y -> x",
        ),
        (['<page id="p"/>'], 3, "a page in a PIPE net"),
        ([], None, "no place and no transition"),
    ],
)
def test_what_is_wrong_is_reported_with_its_line(tmp_path, elements, line, message):
    with pytest.raises(InputError, match="net.xml") as raised:
        read_text(tmp_path, document(*elements), format="pipe")
    assert message in str(raised.value)
    assert raised.value.line == line
    assert "\n" not in str(raised.value)


@given(
    st.lists(st.sampled_from(["", "0", "1", "2", "3", "a", "b"]), min_size=1, max_size=7),
)
def test_however_names_and_ids_are_mixed_up_all_elements_have_different_names(names):
    draft = NetDraft()
    for identifier, name in enumerate(names):
        draft.add_place(str(identifier), name)
    found = [place.name for place in draft.net("n").places]
    assert len(set(found)) == len(names)
    for identifier, (name, used) in enumerate(zip(names, found)):
        assert used in (name, str(identifier))
        if name and names.count(name) == 1 and not name.isdigit():
            assert used == name


@pytest.mark.long
def test_a_long_chain_of_names_that_are_ids_of_others():
    draft = NetDraft()
    for number in range(50_000):
        draft.add_place("i%d" % number, "i%d" % (number - 1) if number else "same")
    draft.add_place("last", "same")
    start = time.monotonic()
    assert draft.net("n").places[49_999].name == "i49999"
    assert time.monotonic() - start < 20


@pytest.mark.parametrize(
    "text", ["Red,1,Default", "Default,1,Red,1,", "Red-1,2,Default,1", "1,2", "Default:1,Red:1"]
)
def test_a_marking_of_classes_that_cannot_be_read_says_what_a_pair_is(tmp_path, text):
    with pytest.raises(InputError) as caught:
        read_text(
            tmp_path,
            document(place("P", "<initialMarking><value>%s</value></initialMarking>" % text)),
        )
    assert "neither a number nor pairs of a class of tokens and a number" in str(caught.value)
    assert caught.value.line == 3
