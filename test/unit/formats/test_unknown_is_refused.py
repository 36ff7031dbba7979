"""What a reader does not know could change the meaning of a net, so it is refused; what tools add
for themselves is not.

The samples are written after what the tools write: TAPAAL, WoPeD, ePNK, ProM, PIPE, TINA, GreatSPN.
"""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lxml import etree

from gspn_framework_package.analysis.state_space import explore
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import read_net, read_net_with_notes
from gspn_framework_package.formats.draft import ReadOptions
from gspn_framework_package.formats.net_update import update_net
from gspn_framework_package.model.errors import InputError

DATA = Path(__file__).parent / "data"
ISO = 'xmlns="http://www.pnml.org/version-2009/grammar/pnml"'
PTNET = 'type="http://www.pnml.org/version-2009/grammar/ptnet"'

TAPAAL = """<?xml version="1.0" encoding="UTF-8" standalone="no"?>
<pnml %s>
  <net id="ComposedModel" %s>
    <page id="page0">
      <place id="P0"><graphics><position x="270" y="240"/></graphics>
        <name><graphics><offset x="-5" y="35"/></graphics><text>P0</text></name>
        <initialMarking><graphics><offset x="0" y="0"/></graphics><text>2</text></initialMarking></place>
      <place id="P1"><initialMarking><text>1</text></initialMarking></place>
      <place id="P2"/>
      <transition id="T0"><name><text>T0</text></name></transition>
      <transition id="T1"/>
      <arc id="I0" source="P0" target="T0" type="normal"><inscription><text>1</text></inscription></arc>
      <arc id="I1" source="P1" target="T0" type="inhibitor"/>
      <arc id="I2" source="P1" target="T1" type="normal"><graphics><position x="4" y="3"/></graphics></arc>
      <arc id="I3" source="T0" target="P2" type="normal"/>
    </page>
    <name><text>ComposedModel</text></name>
  </net>
</pnml>
""" % (ISO, PTNET)

WOPED = """<?xml version="1.0" encoding="UTF-8"?>
<pnml>
  <net type="http://www.informatik.hu-berlin.de/top/pntd/ptNetb" id="noID">
    <place id="p1"><name><text>begin</text><graphics><offset x="40" y="80"/></graphics></name>
      <graphics><position x="40" y="40"/><dimension x="40" y="40"/></graphics>
      <initialMarking><text>1</text></initialMarking></place>
    <place id="p2"><name><text>end</text></name></place>
    <transition id="t1_op_1"><name><text>t1</text></name>
      <toolspecific tool="WoPeD" version="1.0"><trigger id="" type="200"/><operator id="t1" type="101"/>
        <transitionResource roleName="clerk" organizationalUnitName="all"/><time>0</time></toolspecific></transition>
    <arc id="a1" source="p1" target="t1_op_1"><inscription><text>1</text><graphics/></inscription><graphics/>
      <toolspecific tool="WoPeD" version="1.0"><probability>1.0</probability></toolspecific></arc>
    <arc id="a2" source="t1_op_1" target="p2"/>
    <toolspecific tool="WoPeD" version="1.0"><bounds><position x="2" y="25"/></bounds><resources/></toolspecific>
  </net>
</pnml>
"""

EPNK = """<pnml %s xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
    xsi:schemaLocation="http://www.pnml.org/version-2009/grammar/pnml pnml.xsd">
  <net %s id="n1">
    <page id="top-level"><name><text>An example</text></name>
      <place id="p1"><name><graphics><offset y="-10.0"/></graphics><text>ready</text></name>
        <graphics><position x="20.0" y="20.0"/><fill color="red"/></graphics>
        <initialMarking>
          <toolspecific tool="org.pnml.tool" version="1.0"><tokengraphics><tokenposition x="2"/></tokengraphics>
          </toolspecific><text>3</text></initialMarking></place>
      <transition id="t1"/>
      <arc id="a1" source="p1" target="t1"><graphics><position x="30" y="5"/></graphics>
        <inscription><graphics><offset y="5.0"/></graphics><text>2</text></inscription></arc>
    </page>
  </net>
</pnml>
""" % (ISO, PTNET)

PIPE = """<?xml version="1.0" encoding="iso-8859-1"?>
<pnml>
<net id="Net-One" type="P/T net">
<token id="Default" enabled="true" red="0" green="0" blue="0"/>
<definition defType="real" expression="2.0" id="foo" name="foo" type="text"/>
<labels x="93" y="145" width="48" height="20" border="false"><text>#P1 waits</text></labels>
<place id="P0"><graphics><position x="135.0" y="75.0"/></graphics><name><value>P0</value><graphics/></name>
<initialMarking><value>Default,1</value><graphics/></initialMarking><capacity><value>0</value></capacity></place>
<transition id="T0"><graphics><position x="1" y="2"/></graphics><name><value>T0</value></name>
<infiniteServer><value>false</value></infiniteServer><timed><value>true</value></timed>
<priority><value>1</value></priority><orientation><value>90</value></orientation><rate><value>6.0</value></rate>
<toolspecific tool="PIPE" version="2.5" rateDefinition="foo"/></transition>
<arc id="P0 to T0" source="P0" target="T0"><graphics/><inscription><value>Default,1</value><graphics/></inscription>
<tagged><value>false</value></tagged><arcpath id="000" x="145" y="100" curvePoint="false"/><type value="normal"/></arc>
<stategroup id="SG0"><name><value>SG</value></name><statecondition><value>P0 > 4</value></statecondition></stategroup>
</net>
</pnml>
"""

TINA = (
    """<?xml version="1.0" encoding="UTF-8"?>
<pnml %s>
  <net id="n-1" type="http://www.laas.fr/tina/tpn">
    <name><text>buffer</text></name>
    <page id="g-1">
      <place id="p-1"><name><text>full</text></name><initialMarking><text>2</text></initialMarking></place>
      <place id="p-2"><name><text>gate</text></name><initialMarking><text>1</text></initialMarking>
        <label><text>open</text></label></place>
      <transition id="t-1"><name><text>take</text></name>
        <delay><interval xmlns="http://www.w3.org/1998/Math/MathML" closure="closed-open"><cn>0</cn><ci>infty</ci>
        </interval><graphics><offset x="-10" y="0"/></graphics></delay></transition>
      <transition id="t-2"><name><text>shut</text></name>
        <delay><interval xmlns="http://www.w3.org/1998/Math/MathML" closure="closed"><cn>0</cn><cn>0</cn></interval>
        </delay></transition>
      <arc id="e-1" source="p-1" target="t-1"/>
      <arc id="e-2" source="p-2" target="t-1"><type value="test"/></arc>
      <arc id="e-3" source="p-2" target="t-2"><inscription><text>1</text></inscription></arc>
      <arc id="e-4" source="p-1" target="t-2"><type value="inhibitor"/></arc>
    </page>
  </net>
</pnml>
"""
    % ISO
)

GREATSPN = """<?xml version="1.0" encoding="UTF-8" standalone="no"?>
<project name="FMS" version="121">
  <gspn name="FMS" show-color-cmd="false" show-fluid-cmd="false" show-timed-cmd="false"
      view-guards="false" view-names="false" view-priorities="false" view-rates="false"
      view-superpos-tags="false" zoom="80">
    <nodes>
      <constant alt-name-fn="LATEX_TEXT" consttype="INTEGER" name="N" text-size="LARGE" value="4" x="3.0" y="17.0"/>
      <place alt-name-fn="LATEX_TEXT" label-x="2.5" label-y="1.0" marking="N" name="Pallets" partition="a"
        partition-x="0.0" superpos-x="0.0" superposition-tags="" text-size="SMALL" x="3.0" y="5.0"/>
      <transition delay="2.0" delay-x="1.0" height="2.0" superposition-tags="sync" guard-x="1.0" label-x="2.0" magnets="THREE_PER_SIDE" name="load"
        nservers="1" nservers-x="0.5" rotation="1.57" shown-as="L" type="EXP" x="3.5" y="9.0"/>
      <transition name="go" priority="2" priority-x="-2.5" type="IMM" weight="3" weight-x="1" x="1.0" y="1.0"/>
      <text-box border="true" height="3" name="t" width="4" x="0.0" y="0.0">words</text-box>
    </nodes>
    <edges>
      <arc broken="true" head="load" head-magnet="10" kind="INPUT" mult="1" mult-k="0.5" mult-x="0.1" tail="Pallets" tail-magnet="0">
        <point x="10.5" y="9.5"/>
      </arc>
      <arc head="go" kind="INHIBITOR" tail="Pallets"/>
    </edges>
  </gspn>
  <measures gspn-name="FMS" name="Measures"><assignments/><greatspn/></measures>
  <resource-list/>
</project>
"""

JARP = """<?xml version="1.0" encoding="ISO-8859-1"?>
<pnml>
  <!--generator: JARP 1.2-->
  <net id="n1" type="PTNet">
    <name><value>P/T net</value></name>
    <comment><value>drawn by hand</value></comment>
    <place id="p1"><graphics><position x="244" y="105"/><size width="32" height="32"/></graphics>
      <name><value>wait.exec</value></name><initialMarking><value>1</value></initialMarking>
      <comment><value>a note</value></comment></place>
    <transition id="t1" ><name><value>[ready]</value></name>
      <toolspecific tool="JARP" version="1.2"><FillColor><value>java.awt.Color[r=1]</value></FillColor></toolspecific>
    </transition>
    <arc id="a1" source="p1" target="t1" tagged="false"><inscription><value>1</value></inscription>
      <toolspecific tool="JARP" version="1.2"><ArrowMode><value>2</value></ArrowMode></toolspecific></arc>
  </net>
</pnml>
"""

PM4PY = """<?xml version='1.0' encoding='UTF-8'?>
<pnml>
  <net id="net1" type="http://www.pnml.org/version-2009/grammar/pnmlcoremodel">
    <page id="n0">
      <place id="source"><name><text>source</text></name><initialMarking><text>1</text></initialMarking></place>
      <transition id="a"><name><text>a</text></name>
        <toolspecific tool="ProM" version="6.4" activity="$invisible$" localNodeID="efb0609a"/></transition>
      <arc id="1" source="source" target="a"/>
    </page>
  </net>
  <finalmarkings><marking><place idref="source"><text>0</text></place></marking></finalmarkings>
</pnml>
"""

VENDORS = {
    "jarp.pnml": JARP,
    "pm4py.pnml": PM4PY,
    "tapaal.pnml": TAPAAL,
    "woped.pnml": WOPED,
    "epnk.pnml": EPNK,
    "pipe.xml": PIPE,
    "tina.pnml": TINA,
    "greatspn.PNPRO": GREATSPN,
}
SAMPLES = dict(
    VENDORS,
    **{path.name: path.read_text() for path in sorted(DATA.iterdir()) if path.suffix != ".net"},
)
FREE = {
    "toolspecific",
    "graphics",
    "name",
    "labels",
    "token",
    "orientation",
    "arcpath",
    "tagged",
    "finalmarkings",
    "comment",
    "stategroup",
    "text-box",
    "point",
    "measures",
    "resource-list",
    "unfolding",
    "label",
}
"""Elements that mean nothing for the net, whatever is in them."""


def read_text(tmp_path, name, text, **options):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return read_net_with_notes(path, **options)


def changed_file(path, net):
    """What is read from a file after the net in it has changed."""
    path.write_bytes(update_net(path.read_bytes(), str(path), ReadOptions(), net))
    return read_net_with_notes(path)


@pytest.mark.parametrize("name", VENDORS)
def test_what_tools_add_for_themselves_is_read(tmp_path, name):
    net, notes = read_text(tmp_path, name, VENDORS[name])
    assert net.places and net.transitions and net.arcs
    assert not any("ignored" in note for note in notes)


@pytest.mark.parametrize("name", VENDORS)
def test_what_tools_add_for_themselves_is_kept_when_the_net_changes(tmp_path, name):
    net, notes = read_text(tmp_path, name, VENDORS[name])
    more = net.with_place(net.places[0]._replace(tokens=net.places[0].tokens + 1))
    assert changed_file(tmp_path / name, more) == (more, notes)
    before, after = (
        [(node.tag, set(node.attrib)) for node in etree.fromstring(text).iter()]
        for text in (VENDORS[name].encode(), (tmp_path / name).read_bytes())
    )
    assert after == before


def test_a_net_of_jarp_has_no_timing_until_it_is_given(tmp_path):
    net, notes = read_text(tmp_path, "jarp.pnml", JARP)
    assert net.transition("[ready]").timed and net.transition("[ready]").rate == 1.0
    assert notes == ["1 transition without timing: exponential with rate 1"]
    faster = net.with_rates({"[ready]": 2.5})
    assert changed_file(tmp_path / "jarp.pnml", faster) == (faster, [])


@pytest.mark.parametrize(
    "name, old, new, note",
    [
        (
            "woped.pnml",
            "<time>0</time>",
            "<time>12</time><timeUnit>1</timeUnit>",
            "'time' of the tool WoPeD is not used: transition 't1_op_1' has 12 there",
        ),
        (
            "woped.pnml",
            "<probability>1.0",
            "<probability>0.3",
            "'probability' of the tool WoPeD is not used: arc 'a1' has 0.3 there",
        ),
        (
            "pm4py.pnml",
            'localNodeID="efb0609a"/>',
            'localNodeID="e"/><toolspecific tool="Other" version="1" meanDelay="3"/>',
            "'meanDelay' of the tool Other is not used: transition 'a' has 3 there",
        ),
        (
            "jarp.pnml",
            "<FillColor>",
            "<FiringRate><value>0.5</value></FiringRate><FillColor>",
            "'FiringRate' of the tool JARP is not used: transition 't1' has 0.5 there",
        ),
    ],
)
def test_the_timing_of_other_tools_is_named(tmp_path, name, old, new, note):
    assert VENDORS[name].count(old) == 1
    _, before = read_text(tmp_path, name, VENDORS[name])
    _, notes = read_text(tmp_path, name, VENDORS[name].replace(old, new))
    assert sorted(notes) == sorted([*before, note])


def test_an_inhibitor_arc_of_tapaal_is_one(tmp_path):
    net, _ = read_text(tmp_path, "tapaal.pnml", TAPAAL)
    assert [(a.source, a.target) for a in net.arcs if a.inhibitor] == [("P1", "T0")]
    assert len(explore(net)) == 4  # T1 first; with an arc in its place it would be 3


def test_a_net_of_tina_is_read_from_pnml(tmp_path):
    net, notes = read_text(tmp_path, "tina.pnml", TINA)
    assert not net.transition("shut").timed
    assert net.transition("take").timed
    both = {(a.source, a.target) for a in net.arcs if not a.inhibitor}
    assert {("gate", "take"), ("take", "gate")} <= both
    assert any("without timing" in note for note in notes)
    with pytest.raises(InputError, match=r"time interval \[2,5\]") as caught:
        read_text(
            tmp_path,
            "tina.pnml",
            TINA.replace("<cn>0</cn><ci>infty</ci>", "<cn>2</cn><cn>5</cn>").replace(
                "closed-open", "closed"
            ),
        )
    assert caught.value.line == 10


@pytest.mark.parametrize("kind", ["reset", "transport", "read", "timed", "tapnInhibitor", "test"])
@pytest.mark.parametrize(
    "way",
    [
        ' type="%s">',
        '><type value="%s"/>',
        "><type><text>%s</text></type>",
        "><arctype><text>%s</text></arctype>",
    ],
)
def test_arcs_of_other_kinds_are_refused_however_they_are_written(tmp_path, kind, way):
    text = TAPAAL.replace(' type="normal"><inscription>', way % kind + "<inscription>")
    with pytest.raises(InputError) as caught:
        read_text(tmp_path, "net.pnml", text)
    assert "arcs of type '%s' are not known" % kind.lower() in str(caught.value)
    assert caught.value.line == 12
    assert caught.value.element == "arc 'I0'"


def test_an_arc_of_two_kinds_is_refused(tmp_path):
    text = TAPAAL.replace(
        'target="T0" type="inhibitor"/>',
        'target="T0" type="inhibitor"><type value="normal"/></arc>',
    )
    with pytest.raises(InputError, match="arcs of type 'inhibitor and normal'"):
        read_text(tmp_path, "net.pnml", text)


TAPN = """<?xml version="1.0" encoding="UTF-8" standalone="no"?>
<pnml xmlns="http://www.informatik.hu-berlin.de/top/pnml/ptNetb">
  %s
  <net active="true" id="Light" type="P/T net">
    <place displayName="true" id="P0" initialMarking="1" invariant="&lt; inf" name="P0" positionX="1" positionY="2"/>
    <transition angle="0" id="T0" infiniteServer="false" name="T0" urgent="false"/>
    <arc id="I0" inscription="[2,inf)" source="P0" target="T0" type="timed" weight="1"/>
  </net>
  <k-bound bound="3"/>
  <feature isGame="false" isTimed="true"/>
</pnml>
"""


@pytest.mark.parametrize(
    "first", ["", '<constant name="k" value="2"/>', "<declaration/>", '<shared-place name="S"/>']
)
@pytest.mark.parametrize("form", [None, "pipe", "pnml"])
def test_a_tapn_file_is_refused(tmp_path, first, form):
    with pytest.raises(InputError) as caught:
        read_text(tmp_path, "net.tapn", TAPN % first, format=form)
    assert caught.value.line is not None
    if form is None:
        assert "TAPAAL's own form" in str(caught.value)


def test_a_subprocess_of_woped_is_refused(tmp_path):
    inner = '<page id="t1"><net><place id="p9"/></net></page></net>'
    with pytest.raises(InputError, match="a net inside a page"):
        read_text(tmp_path, "net.pnml", WOPED.replace("</net>", inner))


@pytest.mark.parametrize(
    "name, old, new, message",
    [
        ("tapaal.pnml", "<text>2</text>", "<value>2</value>", "a <value> in it"),
        (
            "tapaal.pnml",
            "<text>2</text>",
            "2",
            "the text '2' must not be directly in <initialMarking>",
        ),
        (
            "tapaal.pnml",
            '</initialMarking></place>\n      <place id="P1">',
            '</initialMarking><initialMarking/></place>\n      <place id="P1">',
            "a second <initialMarking>",
        ),
        (
            "tapaal.pnml",
            '<transition id="T1"/>',
            '<transition id="T1"><player><value>1</value></player></transition>',
            "a <player> in it",
        ),
        ("pipe.xml", "<rate>", "<rate><value>1</value></rate><rate>", "a second <rate>"),
        ("pipe.xml", "<capacity><value>0", "<capacity><text>4</text><value>0", "a <text> in it"),
        (
            "greatspn.PNPRO",
            'partition="a"',
            'type="HYBRID"',
            "a place of the unknown type 'HYBRID'",
        ),
        (
            "greatspn.PNPRO",
            '<arc head="go" kind="INHIBITOR"',
            '<arc head="go" kind="RESET"',
            "arcs of kind 'RESET'",
        ),
    ],
)
def test_what_would_be_overlooked_is_refused(tmp_path, name, old, new, message):
    assert VENDORS[name].count(old) == 1
    with pytest.raises(InputError) as caught:
        read_text(tmp_path, name, VENDORS[name].replace(old, new))
    assert message in str(caught.value)
    assert caught.value.line is not None


def test_a_property_of_ours_that_is_not_known_is_refused(tmp_path):
    own = '<place id="P2"><toolspecific tool="gspn_framework_package" version="9"><property key="%s">1</property></toolspecific></place>'
    assert (
        read_text(tmp_path, "a.pnml", TAPAAL.replace('<place id="P2"/>', own % "capacity"))[0]
        .place("P2")
        .capacity
        == 1
    )
    with pytest.raises(InputError, match="its property 'leak' is not known"):
        read_text(tmp_path, "a.pnml", TAPAAL.replace('<place id="P2"/>', own % "leak"))


def meaningful(root, net=None):
    """The elements whose attributes and children could change the meaning, of the net that is
    read."""
    found = []
    waiting = [root]
    while waiting:
        element = waiting.pop()
        name = etree.QName(element).localname
        if name in FREE or (name == "gspn" and net is not None and element.get("name") != net):
            continue
        if name != "project":  # it holds what has nothing to do with its nets
            found.append(element)
        waiting += [child for child in element if isinstance(child.tag, str)]
    return found


@pytest.mark.long
@pytest.mark.parametrize("name", SAMPLES)
@settings(
    max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(data=st.data())
def test_anything_unknown_is_refused_with_its_line(tmp_path, name, data):
    net = "machine" if name == "greatspn.PNPRO" and SAMPLES[name] is not GREATSPN else None
    root = etree.fromstring(SAMPLES[name].encode())
    element = data.draw(st.sampled_from(meaningful(root, net)))
    how = data.draw(st.sampled_from(["attribute", "first", "last", "text"]))
    word = data.draw(
        st.sampled_from(
            ["reset", "guard", "player", "urgent", "marking2", "Type", "x", "initialmarking"]
        )
    )
    if how == "attribute":
        before = set(element.attrib)
        element.set(word + "_", "1")
        assert before < set(element.attrib)
    elif how == "text" and etree.QName(element).localname in ("arc", "place", "transition", "type"):
        element.text = (element.text or "") + "7"
    else:
        element.insert(0 if how == "first" else len(element), etree.Element(word + "_"))
    path = tmp_path / name
    path.write_bytes(etree.tostring(root, xml_declaration=True, encoding="UTF-8"))
    with pytest.raises(InputError) as caught:
        read_net(path, net=net)
    assert caught.value.file == str(path)
    assert caught.value.line is not None
    assert caught.value.element is not None


@pytest.mark.parametrize("name", SAMPLES)
def test_anything_free_is_read(tmp_path, name):
    net = "machine" if name == "greatspn.PNPRO" and SAMPLES[name] is not GREATSPN else None
    root = etree.fromstring(SAMPLES[name].encode())
    (tmp_path / ("same" + name)).write_text(SAMPLES[name])
    same = read_net(tmp_path / ("same" + name), net=net)
    for element in root.iter("{*}toolspecific", "{*}graphics", "{*}labels", "{*}text-box"):
        element.set("something", "1")
        element.append(etree.Element("anything"))
    path = tmp_path / name
    path.write_bytes(etree.tostring(root, xml_declaration=True, encoding="UTF-8"))
    assert read_net(path, net=net) == same


def test_iso_pnml_whose_type_is_p_t_net_is_not_taken_for_pipe(tmp_path):
    text = TAPAAL.replace(PTNET, 'type="P/T net"').replace(ISO, "")
    assert read_text(tmp_path, "net.pnml", text)[0].place("P0").tokens == 2


def test_the_command_line_says_file_line_and_element(tmp_path, capsys):
    path = tmp_path / "net.pnml"
    path.write_text(TAPAAL.replace('id="I0"', 'id="I0" weight="3"'))
    assert main(["convert", str(path), "-", "--to", "pnml"]) == 2
    shown = capsys.readouterr().err
    assert "%s:12: arc 'I0': the attribute weight=\"3\" of <arc> is not known" % path in shown, (
        shown
    )
