"""Coloured PNML nets become the nets that one would draw without colours."""

import itertools

import pytest

from gspn_framework_package.analysis.state_space import explore
from gspn_framework_package.formats import coloured
from gspn_framework_package.formats.draft import ReadOptions
from gspn_framework_package.formats.net_update import update_net
from gspn_framework_package.formats.registry import read_net_with_notes
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import InputError

SYMMETRIC = "http://www.pnml.org/version-2009/grammar/symmetricnet"


# -- terms -----------------------------------------------------------------------------------------


def term(kind, *parts, attributes=""):
    inside = "".join("<subterm>%s</subterm>" % part for part in parts)
    return "<%s %s>%s</%s>" % (kind, attributes, inside, kind)


def var(name):
    return '<variable refvariable="%s"/>' % name


def constant(name):
    return '<useroperator declaration="%s"/>' % name


def sort(name):
    return '<usersort declaration="%s"/>' % name


def every(name):
    return "<all>%s</all>" % sort(name)


def times(count, inner):
    return term(
        "numberof", '<numberconstant value="%d"><positive/></numberconstant>' % count, inner
    )


def integer(value, first, last):
    return (
        '<finiteintrangeconstant value="%d"><finiteintrange start="%d" end="%d"/>'
        "</finiteintrangeconstant>"
    ) % (value, first, last)


def enumeration(kind, name, colours):
    inside = "".join('<feconstant id="%s%s" name="%s"/>' % (name, c, c) for c in colours)
    return '<namedsort id="%s" name="%s"><%s>%s</%s></namedsort>' % (name, name, kind, inside, kind)


def named(name, inside):
    return '<namedsort id="%s" name="%s">%s</namedsort>' % (name, name, inside)


def variable(name, of):
    return '<variabledecl id="%s" name="%s">%s</variabledecl>' % (name, name, sort(of))


# -- nets ------------------------------------------------------------------------------------------


def place(name, of=None, marking=None):
    text = "<name><text>%s</text></name>" % name
    if of is not None:
        text += "<type><structure>%s</structure></type>" % (of if of[0] == "<" else sort(of))
    if marking is not None:
        text += "<hlinitialMarking><structure>%s</structure></hlinitialMarking>" % marking
    return '<place id="%s">%s</place>' % (name, text)


def transition(name, guard=None, more=""):
    if guard is not None:
        more += "<condition><structure>%s</structure></condition>" % guard
    return '<transition id="%s">%s</transition>' % (name, more)


def arc(source, target, inscription=None):
    text = ""
    if inscription is not None:
        text = "<hlinscription><structure>%s</structure></hlinscription>" % inscription
    return '<arc id="%s_%s" source="%s" target="%s">%s</arc>' % (
        source,
        target,
        source,
        target,
        text,
    )


def document(declarations, elements):
    """A document of one element on each line; the declarations are on the second one."""
    lines = [
        '<pnml xmlns="http://www.pnml.org/version-2009/grammar/pnml"><net id="n" type="%s">'
        % SYMMETRIC,
        "<declaration><structure><declarations>%s</declarations></structure></declaration>"
        % "".join(declarations),
        '<page id="page">',
        *elements,
        "</page></net></pnml>",
    ]
    return "\n".join(lines)


@pytest.fixture
def read(tmp_path):
    def call(declarations, *elements):
        path = tmp_path / "net.pnml"
        path.write_text(document(declarations, elements), "utf-8")
        return read_net_with_notes(path)

    return call


def same(net, builder):
    """Whether a net is the one of a builder, in any order."""

    def parts(net):
        return (
            {(p.name, p.tokens) for p in net.places},
            {t.name for t in net.transitions},
            sorted((a.source, a.target, a.weight) for a in net.arcs),
        )

    assert parts(net) == parts(builder.build())
    return True


def timed(builder, name, inputs, outputs):
    return builder.exponential(name, rate=1.0, inputs=inputs, outputs=outputs)


# -- own nets, coloured and not --------------------------------------------------------------------


def test_philosophers(read):
    number = 4
    fork, next_fork = times(1, var("p")), times(1, term("successor", var("p")))
    net, notes = read(
        [enumeration("cyclicenumeration", "Phil", range(number)), variable("p", "Phil")],
        place("think", "Phil", times(1, every("Phil"))),
        place("fork", "Phil", every("Phil")),
        place("one", "Phil"),
        place("eat", "Phil"),
        transition("first"),
        transition("second"),
        transition("put"),
        arc("think", "first", fork),
        arc("fork", "first", fork),
        arc("first", "one", fork),
        arc("one", "second", fork),
        arc("fork", "second", next_fork),
        arc("second", "eat", fork),
        arc("eat", "put", fork),
        arc("put", "think", fork),
        arc("put", "fork", term("add", fork, next_fork)),
    )
    builder = NetBuilder("by hand")
    for i in range(number):
        builder.place("think.%d" % i, tokens=1).place("fork.%d" % i, tokens=1)
        builder.place("one.%d" % i).place("eat.%d" % i)
    for i in range(number):
        mine, other = "fork.%d" % i, "fork.%d" % ((i + 1) % number)
        timed(builder, "first.%d" % i, ["think.%d" % i, mine], "one.%d" % i)
        timed(builder, "second.%d" % i, ["one.%d" % i, other], "eat.%d" % i)
        timed(builder, "put.%d" % i, "eat.%d" % i, ["think.%d" % i, mine, other])
    assert same(net, builder)
    space = explore(net)
    assert len(space) == len(explore(builder.build())) == 34 and len(space.deadlocks) == 1
    assert "unfolded, with the names PLACE.COLOUR and TRANSITION.VALUES" in notes
    assert "12 transitions without timing: exponential with rate 1" in notes


def test_token_ring(read):
    """The token goes round backwards; a station takes it, works with two tools, and gives it on."""
    here, back = times(1, var("s")), times(1, term("predecessor", var("s")))
    net, _ = read(
        [enumeration("cyclicenumeration", "Station", "abc"), variable("s", "Station")],
        place("token", "Station", times(1, constant("Stationa"))),
        place("busy", "Station"),
        place("tools", "<dot/>", times(2, "<dotconstant/>")),
        transition("take"),
        transition("give", term("inequality", var("s"), constant("Stationb"))),
        arc("token", "take", here),
        arc("tools", "take", times(2, "<dotconstant/>")),
        arc("take", "busy", here),
        arc("busy", "give", here),
        arc("give", "token", back),
        arc("give", "tools", times(2, "<dotconstant/>")),
    )
    builder = NetBuilder("by hand").place("tools", tokens=2)
    for station in "abc":
        builder.place("token.%s" % station, tokens=int(station == "a")).place("busy.%s" % station)
    for station, before in zip("abc", "cab"):
        own = {"token.%s" % station: 1, "tools": 2}
        timed(builder, "take.%s" % station, own, "busy.%s" % station)
        if station != "b":
            after = {"token.%s" % before: 1, "tools": 2}
            timed(builder, "give.%s" % station, "busy.%s" % station, after)
    assert same(net, builder)


def test_messages_from_each_to_all_others(read):
    """Products, ``all`` minus a colour, tuples with ``all``, and ranges of integers."""
    others = term(
        "subtract", term("tuple", var("i"), every("Site")), term("tuple", var("i"), var("i"))
    )
    mail = times(1, term("tuple", var("i"), var("j")))
    net, _ = read(
        [
            named("Site", '<finiteintrange start="2" end="4"/>'),
            named("Mail", "<productsort>%s%s</productsort>" % (sort("Site"), sort("Site"))),
            variable("i", "Site"),
            variable("j", "Site"),
        ],
        place("idle", "Site", every("Site")),
        place("waits", "Site"),
        place("mail", "Mail"),
        place("read", "Mail"),
        transition("send"),
        transition("get", term("inequality", var("j"), var("i"))),
        transition("end"),
        arc("idle", "send", times(1, var("i"))),
        arc("send", "waits", times(1, var("i"))),
        arc("send", "mail", others),
        arc("mail", "get", mail),
        arc("get", "read", mail),
        arc("waits", "end", times(1, var("i"))),
        arc("read", "end", others),
        arc("end", "idle", times(1, var("i"))),
    )
    sites = range(2, 5)
    builder = NetBuilder("by hand")
    for i in sites:
        builder.place("idle.%d" % i, tokens=1).place("waits.%d" % i)
    for pair in itertools.product(sites, sites):
        builder.place("mail.%d.%d" % pair).place("read.%d.%d" % pair)
    for i in sites:
        away = ["%d.%d" % (i, j) for j in sites if j != i]
        timed(builder, "send.%d" % i, "idle.%d" % i, ["waits.%d" % i, *("mail." + a for a in away)])
        timed(builder, "end.%d" % i, ["waits.%d" % i, *("read." + a for a in away)], "idle.%d" % i)
        for ends in away:
            timed(builder, "get." + ends, "mail." + ends, "read." + ends)
    assert same(net, builder)
    assert len(explore(net)) == (1 + 2**2) ** 3  # idle, or each of two messages read or not


@pytest.mark.parametrize(
    ("guard", "holds"),
    [
        (term("lessthan", var("x"), var("y")), lambda x, y: x < y),
        (term("greaterthanorequal", var("x"), integer(2, 0, 5)), lambda x, y: x >= 2),
        (
            term(
                "or", term("equality", var("x"), var("y")), term("greaterthan", var("x"), var("y"))
            ),
            lambda x, y: x >= y,
        ),
        (
            term(
                "and",
                term("not", term("equality", var("y"), integer(1, 0, 3))),
                term("lessthanorequal", var("x"), var("y")),
            ),
            lambda x, y: y != 1 and x <= y,
        ),
        (
            term(
                "imply",
                term("lessthan", var("x"), var("y")),
                term("equality", var("x"), integer(0, 0, 3)),
            ),
            lambda x, y: x >= y or x == 0,
        ),
        (term("booleanconstant", attributes='value="false"'), lambda x, y: False),
    ],
)
def test_guards(read, guard, holds):
    net, _ = read(
        [named("N", '<finiteintrange start="0" end="3"/>'), variable("y", "N"), variable("x", "N")],
        place("p", "N", every("N")),
        transition("t", guard),
        arc("p", "t", term("add", var("x"), times(2, var("y")))),
    )
    allowed = {"t.%d.%d" % (y, x) for x in range(4) for y in range(4) if holds(x, y)}
    assert {t.name for t in net.transitions} == allowed
    for a in net.arcs:  # x and y may be the same
        y, x = map(int, a.target.split(".")[1:])
        assert a.weight == (x == int(a.source[2:])) + 2 * (y == int(a.source[2:]))


def test_pages_references_dots_and_timing(read):
    timing = (
        '<toolspecific tool="StochasticPetriNet" version="0.2">'
        '<property key="distributionType">IMMEDIATE</property><property key="weight">2</property>'
        "</toolspecific>"
    )
    net, _ = read(
        [enumeration("finiteenumeration", "C", ["red", "light blue"]), variable("c", "C")],
        place("p", "C", term("add", constant("Cred"), times(3, constant("Clight blue")))),
        '<page id="inner"><referencePlace id="r" ref="p"/>',
        transition("t", more=timing),
        transition("u"),
        arc("r", "t", var("c")),
        "</page>",
        place("d"),
        arc("t", "d"),
        arc("d", "u"),
    )
    assert {(p.name, p.tokens) for p in net.places} == {("p.red", 1), ("p.light blue", 3), ("d", 0)}
    assert [(t.name, t.timed, t.weight) for t in net.transitions] == [
        ("t.red", False, 2.0),
        ("t.light blue", False, 2.0),
        ("u", True, 1.0),
    ]
    assert len(net.arcs) == 5


# -- what is refused -------------------------------------------------------------------------------

SITES = [named("Site", '<finiteintrange start="1" end="3"/>'), variable("x", "Site")]


@pytest.mark.parametrize(
    ("declarations", "elements", "line", "message"),
    [
        (
            ["<partition/>"],
            [],
            2,
            "declarations: a coloured net: <partition> in it is not unfolded",
        ),
        ([named("S", "<list/>")], [], 2, "<list> in it is not unfolded"),
        ([named("S", sort("T"))], [], 2, "there is no sort 'T'"),
        ([named("S", sort("T")), named("T", sort("S"))], [], 2, "contains itself"),
        (SITES, [place("p", "<integer/>")], 4, "place 'p': a coloured net: <integer> in it"),
        (SITES, [place("p", "Site", var("x"))], 4, "its initial marking has a variable"),
        (SITES, [place("p", "Site", var("y"))], 4, "there is no variable 'y'"),
        (SITES, [place("p", "Site", constant("one"))], 4, "there is no constant 'one'"),
        (SITES, [place("p", "Site", "<dotconstant/>")], 4, "its colours are of another sort"),
        (SITES, [place("p", "Site", integer(9, 1, 9))], 4, "9 is no colour of place 'p'"),
        (SITES, [place("p", "Site", integer(9, 1, 3))], 4, "9 is not in its range"),
        (
            SITES,
            [place("p", "Site", term("subtract", integer(1, 1, 3), every("Site")))],
            4,
            "takes away more of a colour than there is",
        ),
        (
            SITES,
            [transition("t", term("mult", var("x")))],
            4,
            "transition 't': a coloured net: <mult>",
        ),
        (SITES, [transition("t", term("equality", var("x"), "<dotconstant/>"))], 4, "another sort"),
        (SITES, [transition("t", term("equality", var("x"), every("Site")))], 4, "single colours"),
        (SITES, [transition("t", term("not", *2 * [term("and")]))], 4, "<not> needs 1 subterms"),
        (
            SITES,
            [place("p", "Site"), transition("t"), arc("p", "t")],
            6,
            "arc 'p_t': it has no inscription",
        ),
        (
            SITES,
            [place("p", "Site"), transition("t"), arc("p", "t", term("successor", var("x")))],
            6,
            "only a colour of a cyclic enumeration has a next one",
        ),
        (
            SITES,
            [place("p", "Site"), transition("t"), arc("p", "t", "<partitionelementof/>")],
            6,
            "arc 'p_t': a coloured net: <partitionelementof> in it is not unfolded",
        ),
        (SITES, [place("p", "Site"), arc("p", "q", var("x"))], 5, "does not join a place and"),
        (SITES, ["<place><name><text>p</text></name></place>"], 4, "it has no id"),
        (SITES, ['<transition id="t"><guard/></transition>'], 4, "a <guard> in it is not known"),
    ],
)
def test_what_is_not_covered_is_refused_with_its_line(read, declarations, elements, line, message):
    with pytest.raises(InputError) as raised:
        read(declarations, *elements)
    assert message in str(raised.value) and "net.pnml:%d" % line in str(raised.value)


def test_too_large_a_net_is_refused_with_its_size(read):
    def pairs(last):
        return [
            named("N", '<finiteintrange start="1" end="%d"/>' % last),
            named("Pair", "<productsort>%s%s</productsort>" % (sort("N"), sort("N"))),
            variable("x", "N"),
            variable("y", "N"),
        ]

    with pytest.raises(
        InputError, match="has 2,500,000,000 places and up to 0 transitions and 0 ar"
    ):
        read(pairs(50_000), place("p", "Pair"))
    both = [place("p", "N"), transition("t"), arc("p", "t", term("add", var("x"), var("y")))]
    with pytest.raises(
        InputError, match="710 places and up to 504,100 transitions and 1,008,200 arcs"
    ):
        read(pairs(710), *both)
    # the guard leaves few
    both[1] = transition("t", term("equality", var("x"), var("y")))
    net, _ = read(pairs(710), *both)
    assert len(net.transitions) == 710 and {a.weight for a in net.arcs} == {2}


def test_a_net_with_too_many_arcs_is_refused(read, monkeypatch):
    monkeypatch.setattr(coloured, "MOST_ARCS", 8)
    with pytest.raises(InputError, match="3 places and up to 3 transitions and 9 arcs"):
        read(
            SITES,
            place("p", "Site"),
            transition("t", term("equality", var("x"), var("x"))),
            arc("p", "t", every("Site")),
        )


def test_an_unfolded_net_is_not_saved_into_its_coloured_file():
    data = document(SITES, [place("p", "Site", every("Site"))]).encode()
    path = "net.pnml"
    builder = NetBuilder("n")
    for i in range(1, 4):
        builder.place("p.%d" % i, tokens=1)
    same_as_read = update_net(data, path, ReadOptions(), builder.build())
    assert same_as_read == data
    builder.place("p.4", tokens=1)
    assert update_net(data, path, ReadOptions(), builder.build()) is None
