"""PNML of ISO/IEC 15909-2, with the stochastic data of process-mining tools."""

from pathlib import Path

import pytest

from gspn_framework_package.formats import read_net, read_net_with_notes
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import InputError

DATA = Path(__file__).parent / "data"


def read_text(tmp_path, text):
    path = tmp_path / "net.pnml"
    path.write_text(text)
    return read_net_with_notes(path)


def page(*elements, kind="http://www.pnml.org/version-2009/grammar/ptnet"):
    return '<pnml><net id="n" type="%s"><page id="g">\n%s\n</page></net></pnml>' % (
        kind,
        "\n".join(elements),
    )


def test_nested_pages_and_references():
    net, notes = read_net_with_notes(DATA / "pages.pnml")
    assert net == (
        NetBuilder("pages")
        .place("first", tokens=2, position=(20, 30))
        .place("second")
        .exponential("go")
        .exponential("back")
        .arc("first", "go", 2)
        .arc("go", "second")
        .arc("second", "back")
        .arc("back", "first", 2)
        .inhibitor("first", "back")
        .build()
    )
    assert notes == ["2 transitions without timing: exponential with rate 1"]


def test_stochastic_data_as_pm4py_writes_it():
    net, notes = read_net_with_notes(DATA / "process_mining.pnml")
    assert net == (
        NetBuilder("imdf_net")
        .place("source", tokens=1)
        .place("sink")
        .exponential("u1", rate=4.0)
        .immediate("u2", weight=0.25, priority=2)
        .arc("source", "u1")
        .arc("u1", "sink")
        .arc("source", "u2")
        .inhibitor("sink", "u2")
        .build()
    )
    assert any("rates, as pm4py" in note for note in notes)
    assert any("named by id" in note for note in notes)


def test_prom_writes_means(tmp_path):
    text = (DATA / "process_mining.pnml").read_text()
    prom = '<toolspecific tool="StochasticPetriNet" version="0.2"><property key="timeUnit">HOURS</property></toolspecific>'
    net, notes = read_text(tmp_path, text.replace('<page id="n0">', prom + '<page id="n0">'))
    assert net.transition("u1").rate == 0.25
    assert any("means, as ProM" in note for note in notes)


@pytest.mark.parametrize(
    "elements, kind, line, message",
    [
        ([], "http://www.pnml.org/version-2009/grammar/netwithqueues", 1, "are not known"),
        ([], "http://example.org/timed-net", 1, "nets of the type 'http://example.org/timed-net'"),
        (['<place id="p"><hlinitialMarking/></place>'], "", 2, "a coloured net"),
        (
            [
                '<place id="p"/><transition id="t"/>',
                '<arc id="a" source="p" target="t"><hlinscription/></arc>',
            ],
            "",
            3,
            "a coloured net",
        ),
        (
            [
                '<referencePlace id="r1" ref="r2"/>',
                '<referencePlace id="r2" ref="r1"/>',
                '<transition id="t"/><arc id="a" source="r1" target="t"/>',
            ],
            "",
            2,
            "references lead to each other: r1 -> r2 -> r1",
        ),
        (
            [
                '<referencePlace id="r1" ref="r1"/><transition id="t"/>',
                '<arc id="a" source="t" target="r1"/>',
            ],
            "",
            2,
            "references lead to each other",
        ),
        (
            [
                '<referencePlace id="r1" ref="gone"/><transition id="t"/>',
                '<arc id="a" source="r1" target="t"/>',
            ],
            "",
            3,
            "no place or transition 'gone'",
        ),
        (['<referencePlace id="r1"/>'], "", 2, "an id and a ref"),
        (
            [
                '<place id="p"/><transition id="t"/>',
                '<arc id="a" source="p" target="t"><type value="reset"/></arc>',
            ],
            "",
            3,
            "'reset'",
        ),
        (
            ['<place id="p"><initialMarking><text>many</text></initialMarking></place>'],
            "",
            2,
            "'many' has no value",
        ),
        (
            [
                '<transition id="t"><toolspecific tool="StochasticPetriNet" version="0.2">'
                '<property key="distributionType">NORMAL</property></toolspecific></transition>'
            ],
            "",
            2,
            "the distribution NORMAL",
        ),
        (['<place id="p"/><place id="p"/>'], "", 2, "already taken"),
    ],
)
def test_what_is_wrong_is_reported_with_its_line(tmp_path, elements, kind, line, message):
    with pytest.raises(InputError, match="net.pnml") as raised:
        read_text(tmp_path, page(*elements, kind=kind))
    assert message in str(raised.value)
    assert raised.value.line == line


def test_own_data_of_other_tools_is_left_alone(tmp_path):
    net = read_text(
        tmp_path,
        page(
            '<place id="p"><toolspecific tool="other" version="1"><property key="capacity">'
            "x</property></toolspecific></place>"
        ),
    )[0]
    assert net.places[0].capacity is None
    assert read_net(tmp_path / "net.pnml", format="pnml") == net
