"""Large files are read by a sample of their contents: whatever that gives is what reading the whole
file gives, and anything unusual or wrong is left to the usual reader."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_nets import nets

from gspn_framework_package.formats import pnml, read_net_with_notes, registry, repetition
from gspn_framework_package.formats.draft import ReadOptions
from gspn_framework_package.formats.format import NetFile
from gspn_framework_package.model.errors import GspnError, InputError, NetError
from gspn_framework_package.model.net import Net

COPIES = 12
OPTIONS = ReadOptions()


@pytest.fixture(autouse=True, scope="module")
def from_the_first_byte():
    before, registry.MIN_BYTES = registry.MIN_BYTES, 0
    yield
    registry.MIN_BYTES = before


def copies(net):
    """A net that has ``net`` many times, and so repeats itself."""

    def renamed(item, number):
        return item._replace(name="%s %d" % (item.name, number))

    numbers = range(COPIES)
    return Net(
        [renamed(p, i) for i in numbers for p in net.places],
        [renamed(t, i) for i in numbers for t in net.transitions],
        [
            a._replace(source="%s %d" % (a.source, i), target="%s %d" % (a.target, i))
            for i in numbers
            for a in net.arcs
        ],
        net.name,
    )


def by_sample(data, options=OPTIONS):
    return registry._read_sample(NetFile(data, "net.pnml"), options)


def as_a_whole(data, options=OPTIONS):
    return registry._read(NetFile(data, "net.pnml"), options)


def agree(data, options=OPTIONS):
    """Whether the sample gave a net, which is then the right one."""
    found = by_sample(data, options)
    if found is None:
        return False
    assert found == as_a_whole(data, options)
    return True


def document(places="", transitions="", arcs="", before="", after=""):
    """A file with enough elements that are alike, and those given among them."""
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<pnml xmlns="http://www.pnml.org/version-2009/grammar/pnml">'
        '<net id="n" type="http://www.pnml.org/version-2009/grammar/ptnet">'
        '<name><text>the net</text></name><page id="page">%s\n%s\n%s\n%s\n%s</page></net></pnml>'
        % (
            before,
            "".join(
                '<place id="p%d">\n<name><text>P%d</text></name>\n</place>\n' % (i, i)
                for i in range(COPIES)
            )
            + places,
            "".join(
                '<transition id="t%d"><name><text>T%d</text></name></transition>\n' % (i, i)
                for i in range(COPIES)
            )
            + transitions,
            "".join(
                '<arc id="a%d" source="p%d" target="t%d"/>\n' % (i, i, i) for i in range(COPIES)
            )
            + arcs,
            after,
        )
    ).encode()


SIMPLE = nets().filter(lambda net: net.arcs)


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(net=SIMPLE, infinite=st.sampled_from([None, True]), weight=st.sampled_from([1.0, 0.0]))
def test_both_readers_agree_on_what_is_written(net, infinite, weight):
    data = pnml.to_bytes(copies(net))
    options = OPTIONS._replace(infinite_servers=infinite, missing_weight=weight)
    sampled = agree(data, options)
    if not any(set("&<>").intersection(node.name) for node in (*net.places, *net.transitions)):
        assert sampled


SNIPPETS = [
    b"<!-- c -->",
    b"<!--",
    b"-->",
    b"<?p i?>",
    b"<![CDATA[1]]>",
    b"]]>",
    b"&amp;",
    b"&no;",
    b"&",
    b"<",
    b">",
    b'"',
    b"'",
    b"/",
    b" ",
    b"x",
    b"\n",
    b"\0",
    b"\x1c",
    b"\xff",
    "\u2028".encode(),
    "\u00a0".encode(),
    b"<name><text>again</text></name>",
    b"</name>",
    b"</place>",
    b"</arc>",
    b"</transition>",
    b"<place/>",
    b'<place id="p9"/>',
    b'<place\nid="new"></place>',
    b"<page>",
    b'<place id="p3"></place>',
    b'<place id="new"></place>',
    b'</page><page id="q">',
    b'<transition id="u"></transition>',
    b'<arc id="b" source="p1" target="t2"/>',
    b'<arc id="b" source="t1" target="p2"><type value="inhibitor"/></arc>',
    b'<arc id="b" source="p1" target="nowhere"/>',
    b'<arc id="b" source="p1" target="p2"/>',
    b"<initialMarking><text>3</text></initialMarking>",
    b"<inscription><text>2</text></inscription>",
    b"<initialMarking><text>-1</text></initialMarking>",
    b'<type value="test"/>',
    b' type="reset"',
    b'<graphics><position x="1" y="2"/></graphics>',
    b'<graphics><position x="1" y="nan"/></graphics>',
    b'<toolspecific tool="StochasticPetriNet" version="0.2"><property key="weight">3</property>'
    b"</toolspecific>",
    b'<referencePlace id="r" ref="p1"/>',
    b"<hlinitialMarking/>",
    b' xmlns="u"',
]


@settings(max_examples=400, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(0, 1), st.sampled_from(SNIPPETS), st.sampled_from([0, 0, 0, 1, 9, 40])),
        min_size=1,
        max_size=3,
    )
)
def test_both_readers_agree_on_damaged_files(changes):
    """Texts are put in at tags, or replace some bytes."""
    data = document()
    for where, text, gone in changes:
        at = int(where * (len(data) - 1))
        if gone == 0:
            at = max(data.find(b"<", at), data.find(b">", at) + 1 if int(where * 1e6) % 2 else 0)
        data = data[:at] + text + data[at + gone :]
    try:
        as_a_whole(data)
    except GspnError:
        assert by_sample(data) is None
    else:
        agree(data)


PLAIN = {
    "as it is": {},
    "tokens": {"places": '<place id="q"><initialMarking><text>3</text></initialMarking></place>'},
    "positions": {
        "places": '<place id="q"><graphics><position x="1" y="2.5"/></graphics></place>',
        "transitions": '<transition id="u"><graphics>\n<position x="1" y="inf"/></graphics>'
        '<graphics><position x="3" y="4"/></graphics></transition>',
    },
    "kinds of arcs": {
        "arcs": '<arc id="b" source="p1" target="t2"><inscription><text>3</text></inscription>'
        '<type value="inhibitor"/></arc><arc id="c" source="t3" target="p3"></arc>'
    },
    "immediate": {
        "transitions": '<transition id="u"><toolspecific tool="StochasticPetriNet" version="0.2">'
        '<property key="distributionType">IMMEDIATE</property><property key="weight">0.0'
        "</property></toolspecific></transition>"
    },
    "names": {
        "places": '<place id=" q "><name><text> a b </text></name></place>',
        "arcs": '<arc id="" source="a b" target="T1"/>',
    },
    "no name": {"places": '<place id="q"><name><text> </text></name></place>'},
    "more of the net": {
        "before": "<toolspecific tool='x' version='1'/>",
        "after": "<finalmarkings><marking/></finalmarkings>",
    },
}


@pytest.mark.parametrize("case", PLAIN)
def test_plain_files_are_read_by_their_sample(case):
    assert agree(document(**PLAIN[case]))


UNUSUAL = {
    "spaces around an end": {"arcs": '<arc id="b" source="p1" target=" t2"/>'},
    "equal names": {"places": '<place id="q"><name><text>P1</text></name></place>'},
    "a name with an entity": {"places": '<place id="q"><name><text>a&amp;b</text></name></place>'},
    "two lines in a name": {"places": '<place id="q"><name><text>a\nb</text></name></place>'},
    "a comment": {"places": "<!-- here -->"},
    "nodes before the places": {"before": '<transition id="u"/>'},
    "a place before the places": {"before": '<place\nid="q"></place>'},
    "a place after the arcs": {"after": '<place id="q"></place>'},
    "another page": {"after": '</page><page id="2"><place id="q"></place>'},
    "a reference": {
        "after": '<referencePlace id="r" ref="p1"/>',
        "arcs": '<arc id="b" source="r" target="t2"/>',
    },
    "no contents": {"places": '<place id="q"/>'},
    "a very long name": {
        "places": '<place id="q"><name><text>%s</text></name></place>' % ("a" * 2000)
    },
}


@pytest.mark.parametrize("case", UNUSUAL)
def test_unusual_files_are_read_as_a_whole(case):
    data = document(**UNUSUAL[case])
    assert by_sample(data) is None
    assert isinstance(as_a_whole(data)[0], Net)


def test_test_arcs_of_tina_are_read_as_a_whole():
    data = document(arcs='<arc id="b" source="p1" target="t2"><type value="test"/></arc>')
    data = data.replace(
        b"http://www.pnml.org/version-2009/grammar/ptnet", b"http://www.laas.fr/tina/tpn"
    )
    assert by_sample(data) is None
    assert len(as_a_whole(data)[0].arcs) == COPIES + 2


WRONG = {
    "an unknown attribute": ({"places": '<place id="q" colour="1"></place>'}, NetError),
    "an unknown element": ({"places": '<place id="q"><guard/></place>'}, NetError),
    "text": ({"transitions": '<transition id="u">x</transition>'}, NetError),
    "an id that is taken": ({"places": '<place id="p3"></place>'}, NetError),
    "an arc to nowhere": ({"arcs": '<arc id="b" source="p1" target="q"/>'}, NetError),
    "an arc of two places": ({"arcs": '<arc id="b" source="p1" target="p2"/>'}, NetError),
    "a rate of 0": (
        {
            "transitions": '<transition id="u"><toolspecific tool="StochasticPetriNet"><property '
            'key="distributionType">EXPONENTIAL</property><property key="distributionParameters">0'
            "</property></toolspecific></transition>"
        },
        NetError,
    ),
    "an entity": ({"places": '<place id="&no;"></place>'}, InputError),
    "a tag that is not closed": ({"places": '<place id="q"><b></place>'}, InputError),
    "tags that close each other's": (
        {"places": '<place id="q"><b></place><place id="r"></b></place>'},
        InputError,
    ),
    "a control character": ({"places": '<place id="q\x1c"></place>'}, InputError),
    "a control character between": (
        {"places": '<place id="q">\x1c<name><text>a</text></name></place>'},
        InputError,
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_errors_have_the_line_of_the_file(case, tmp_path):
    parts, kind = WRONG[case]
    ((section, text),) = parts.items()
    data = document(**{section: text})
    assert by_sample(data) is None
    path = tmp_path / "net.pnml"
    path.write_bytes(data)
    with pytest.raises(kind) as caught:
        read_net_with_notes(path)
    if section != "arcs" or "nowhere" in case:
        assert caught.value.line == data.decode().split(text)[0].count("\n") + 1
    assert caught.value.file == str(path)


def test_the_number_of_transitions_without_time_is_that_of_the_file():
    net, notes = by_sample(document())
    assert len(net.transitions) == COPIES
    assert notes == ["%d transitions without timing: exponential with rate 1" % COPIES]


@pytest.mark.parametrize("kind", ["place", "transition", "arc"])
@pytest.mark.parametrize(
    "text", ['<{0} id="">', '<{0} id="" source="" target="">' + " " * 5000, '<{0} id=""']
)
def test_a_file_without_end_tags_is_left_in_linear_time(kind, text):
    """In quadratic time, this would take minutes."""
    many = text.format(kind) * (600_000 // len(text))
    parts = {kind + "s": many}
    assert repetition.sample_of(document(**parts)) is None
