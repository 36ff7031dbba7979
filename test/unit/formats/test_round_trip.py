"""The formats meet in one model: what is written is read back, through every chain of formats."""

import itertools

import pytest
from hypothesis import HealthCheck, example, given, settings
from random_nets import nets

from gspn_framework_package.formats import FORMATS, read_net, read_net_with_notes, write_net
from gspn_framework_package.formats.net_json import net_from_json, net_to_json
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import NetError, UsageError
from gspn_framework_package.model.marking_function import parse_value
from gspn_framework_package.model.net import Net

RELAXED = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
EXACT = ["pipe", "pnml", "pnpro"]


def through(net, formats, folder):
    for number, name in enumerate(formats):
        path = folder / ("%d%s" % (number, FORMATS[name].extensions[0]))
        write_net(net, path)
        net, notes = read_net_with_notes(path)
        assert notes == []
    return net


@pytest.mark.long
@pytest.mark.parametrize("name", EXACT)
@RELAXED
@given(net=nets(capacities=False, servers=(1, None)))
def test_a_net_comes_back_as_it_was(tmp_path, name, net):
    assert through(net, [name], tmp_path) == net


@pytest.mark.long
@RELAXED
@given(net=nets())
def test_pnml_holds_capacities_and_numbers_of_servers(tmp_path, net):
    assert through(net, ["pnml"], tmp_path) == net


@pytest.mark.long
@RELAXED
@given(net=nets(servers=(1, None)))
def test_pipe_holds_capacities(tmp_path, net):
    assert through(net, ["pipe"], tmp_path) == net


@pytest.mark.long
@RELAXED
@given(net=nets(capacities=False))
def test_pnpro_holds_numbers_of_servers(tmp_path, net):
    assert through(net, ["pnpro"], tmp_path) == net


@pytest.mark.long
@pytest.mark.parametrize("name", ["pnml", "pnpro"])
@RELAXED
@example(
    net=NetBuilder("net")
    .place("[")
    .place("], 2")
    .immediate("t", weight=parse_value("min(#'[', #'], 2') + 1"))
    .build()
)
@given(net=nets(capacities=False, dependent=True))
def test_rates_and_weights_that_depend_on_the_marking(tmp_path, name, net):
    assert through(net, [name], tmp_path) == net
    assert net_from_json(net_to_json(net)) == net


@pytest.mark.long
@pytest.mark.parametrize("chain", list(itertools.permutations(EXACT)), ids="-".join)
@settings(parent=RELAXED, max_examples=20)
@given(net=nets(capacities=False, servers=(1, None)))
def test_any_way_through_the_formats(tmp_path, chain, net):
    assert through(net, chain, tmp_path) == net


@pytest.mark.long
@RELAXED
@given(net=nets(capacities=False))
def test_tina_keeps_structure_and_kinds(tmp_path, net):
    write_net(net, tmp_path / "n.net")
    back = read_net(tmp_path / "n.net")
    assert [(p.name, p.tokens) for p in back.places] == [(p.name, p.tokens) for p in net.places]
    assert [(t.name, t.timed) for t in back.transitions] == [
        (t.name, t.timed) for t in net.transitions
    ]
    assert sorted(back.arcs) == sorted(arc._replace(bends=()) for arc in net.arcs)
    assert back.name == net.name


@pytest.mark.long
@RELAXED
@given(net=nets(capacities=False, servers=(1, None)))
def test_writing_twice_gives_the_same_file(net):
    for name in EXACT:
        assert FORMATS[name].to_bytes(net) == FORMATS[name].to_bytes(net)


def test_nodes_called_like_the_ids_of_others(tmp_path):
    net = NetBuilder("n").place("t0").place("p1").immediate("p0", inputs="t0", outputs="p1").build()
    for name in EXACT:
        assert through(net, [name], tmp_path) == net


def test_parallel_arcs_stay_apart(tmp_path):
    net = NetBuilder("n").place("a").immediate("t").arc("a", "t").arc("a", "t", 2).build()
    for name in EXACT:
        assert through(net, [name], tmp_path) == net


def test_pipe_has_no_number_of_servers(tmp_path):
    net = NetBuilder().place("a", 1).exponential("t", servers=3, inputs="a").build()
    with pytest.raises(NetError, match="single and infinite servers, not 3"):
        write_net(net, tmp_path / "n.xml")
    assert list(tmp_path.iterdir()) == []  # nothing half-written


@pytest.mark.parametrize("name", EXACT)
def test_a_name_that_xml_cannot_hold(tmp_path, name):
    net = NetBuilder().place("a\x01b").immediate("t").build()
    with pytest.raises(NetError, match="cannot be written in XML"):
        write_net(net, tmp_path / "n", name)


def test_an_unknown_format(tmp_path):
    net = NetBuilder().place("a").build()
    with pytest.raises(UsageError, match="there is no format 'word'"):
        write_net(net, tmp_path / "n", "word")
    with pytest.raises(UsageError, match="does not show the format"):
        write_net(net, tmp_path / "n.doc")
    with pytest.raises(UsageError, match="JANI is written, not read"):
        read_net(tmp_path / "n", format="jani")


def test_a_net_of_20_000_arcs(tmp_path):
    count = 5_000
    builder = NetBuilder("ring")
    for n in range(count):
        builder.place("p%d" % n, tokens=n % 3)
    for n in range(count):
        builder.exponential(
            "t%d" % n,
            rate=n + 1,
            inputs={"p%d" % n: 2, "p%d" % ((n + 7) % count): 1},
            outputs=["p%d" % ((n + 1) % count), "p%d" % ((n + 5) % count)],
        )
    net = builder.build()
    assert isinstance(net, Net)
    assert len(net.arcs) == 4 * count
    assert through(net, ["pipe"], tmp_path) == net
