"""Counting markings with decision diagrams: the firing rule on generated nets, published counts,
limits."""

import json
import re

import pytest
from generated_nets import bounded_nets, reference_space
from hypothesis import HealthCheck, given, settings

from benchmarks.nets import courier, flexible_manufacturing, kanban
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.compiling import numba_is_there
from gspn_framework_package.analysis.state_space.space import explore
from gspn_framework_package.analysis.symbolic import machine, markings
from gspn_framework_package.analysis.symbolic.markings import count_markings
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.registry import write_net
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import CancelledError, LimitError

FORMS = [
    "plain",
    pytest.param(
        "compiled", marks=pytest.mark.skipif(not numba_is_there(), reason="numba is missing")
    ),
]


def form_of(name):
    return machine.PLAIN if name == "plain" else machine.compiled_form()


def counts_by_definition(net):
    graph = reference_space(net)
    enabled = [set(successors) for successors in graph.values()]
    timed = {t for t, transition in enumerate(net.transitions) if transition.timed}
    return graph, {
        "total": len(graph),
        "tangible": sum(found <= timed for found in enabled),
        "arcs": sum(map(len, enabled)),
        "bounds": {p.name: max(m[i] for m in graph) for i, p in enumerate(net.places)},
        "most_tokens": max(map(sum, graph)),
        "dead": sum(not found for found in enabled),
        "dead_transitions": [
            transition.name
            for t, transition in enumerate(net.transitions)
            if not any(t in found for found in enabled)
        ],
    }


@pytest.mark.long
@pytest.mark.parametrize("form", FORMS)
def test_counts_by_definition(form, monkeypatch):
    # room for a few nodes only, and many pauses: the work continues where it stopped
    monkeypatch.setattr(machine, "_ROOM", 8)
    monkeypatch.setattr(markings, "_FIRST_TURNS", 30)
    monkeypatch.setattr(markings, "_SLICE", {False: 10, True: 10})

    @settings(deadline=None, max_examples=300, suppress_health_check=list(HealthCheck))
    @given(bounded_nets(max_places=5, max_transitions=8, max_tokens=5))
    def check(net):
        graph, expected = counts_by_definition(net)
        found = count_markings(net, form=form_of(form))
        assert {key: getattr(found, key) for key in expected} == expected
        if found.dead:
            assert graph[net.marking(found.dead_marking)] == {}
        else:
            assert found.dead_marking is None

    check()


def test_many_cases_are_taken_one_by_one(monkeypatch):
    net = NetBuilder("many").place("left", tokens=4).place("right")
    for i in range(4):
        net.place("p%d" % i, tokens=1).place("q%d" % i)
        net.exponential("e%d" % i, inputs=["p%d" % i, "left"], outputs=["q%d" % i, "right"])
    built = net.build()
    expected = count_markings(built, form=machine.PLAIN)
    assert expected.dead == 1 and expected.total == 16

    monkeypatch.setattr(markings, "_ROWS_AT_ONCE", 5)
    assert count_markings(built, form=machine.PLAIN)._replace(memory=0) == expected._replace(
        memory=0
    )


def two_handed(number):
    """Dining philosophers who take both forks in any order (SMART's example)."""
    net = NetBuilder("philosophers")
    for i in range(number):
        net.place("thinks%d" % i, tokens=1).place("fork%d" % i, tokens=1)
        for hand in ("left", "right"):
            net.place("wants_%s%d" % (hand, i)).place("has_%s%d" % (hand, i))
    for i in range(number):
        forks = {"left": "fork%d" % i, "right": "fork%d" % ((i + 1) % number)}
        wants = ["wants_%s%d" % (hand, i) for hand in forks]
        has = ["has_%s%d" % (hand, i) for hand in forks]
        net.exponential("hunger%d" % i, inputs="thinks%d" % i, outputs=wants)
        for hand, fork in forks.items():
            net.exponential(
                "take_%s%d" % (hand, i),
                inputs=["wants_%s%d" % (hand, i), fork],
                outputs="has_%s%d" % (hand, i),
            )
        net.exponential("stop%d" % i, inputs=has, outputs=["thinks%d" % i, *forks.values()])
    return net.build()


def referendum(voters):
    """Everybody may vote when it begins, and says yes or no."""
    net = NetBuilder("referendum").place("ready", tokens=1)
    for i in range(voters):
        net.place("votes%d" % i).place("yes%d" % i).place("no%d" % i)
    net.exponential("begin", inputs="ready", outputs=["votes%d" % i for i in range(voters)])
    for i in range(voters):
        net.exponential("say_yes%d" % i, inputs="votes%d" % i, outputs="yes%d" % i)
        net.exponential("say_no%d" % i, inputs="votes%d" % i, outputs="no%d" % i)
    return net.build()


def shared_memory(processors):
    """Each uses its own memory, or that of another over the bus, as one of them can at a time."""
    net = NetBuilder("memory").place("bus", tokens=1)
    for i in range(processors):
        net.place("active%d" % i, tokens=1).place("memory%d" % i, tokens=1)
        net.place("asks%d" % i).place("own%d" % i)
    for i in range(processors):
        at_home = ["active%d" % i, "memory%d" % i]
        net.exponential("ask%d" % i, inputs=at_home[0], outputs="asks%d" % i)
        net.exponential("begin%d" % i, inputs=at_home, outputs="own%d" % i)
        net.exponential("end%d" % i, inputs="own%d" % i, outputs=at_home)
        for j in set(range(processors)) - {i}:
            pair, others = "%d_%d" % (i, j), ["bus", "memory%d" % j]
            net.place("uses" + pair)
            net.exponential("take" + pair, inputs=["asks%d" % i, *others], outputs="uses" + pair)
            net.exponential("free" + pair, inputs="uses" + pair, outputs=[at_home[0], *others])
    return net.build()


MANUFACTURING = """raw1 > wait1, wait1 M1 > in1, in1 > made1 M1, made1 > out1, out1 > raw1
raw2 > wait2, wait2 M2 > in2, in2 > made2 M2, made2 > out2, out2 > raw2
raw3 > wait3, wait3 M2 > out3 M2, out3 > raw3
made1 > join1, made2 > join2, join1 join2 > raw12, raw12 > wait12
wait12 M3 > in12, in12 > out12 M3, out12 > raw1 raw2"""


def untimed_manufacturing(pallets):
    """The system of Ciardo and Trivedi in the form whose markings tools count: no transition takes
    precedence."""
    net = NetBuilder("manufacturing")
    tokens = {"raw1": pallets, "raw2": pallets, "raw3": pallets, "M1": 3, "M2": 1, "M3": 2}
    for place in sorted(set(re.findall(r"\w+", MANUFACTURING))):
        net.place(place, tokens=tokens.get(place, 0))
    for i, step in enumerate(re.split("[,\n]", MANUFACTURING)):
        inputs, outputs = step.split(">")
        net.exponential("t%d" % i, inputs=inputs.split(), outputs=outputs.split())
    return net.build()


@pytest.mark.parametrize(
    "net, total, tangible, dead",
    [
        (kanban(10), 1_005_927_208, 1_005_927_208, 0),
        (kanban(50), 10_425_941_194_901_336, 10_425_941_194_901_336, 0),
        (untimed_manufacturing(10), 2_501_413_200, 2_501_413_200, 0),
        (flexible_manufacturing(5), None, 152_712, 0),
        (courier(1), 29_010, 11_700, 0),
        (
            two_handed(100),
            *[496926405783746676393791436882468230898067489522034699520200002] * 2,
            2,
        ),
        (referendum(100), 3**100 + 1, 3**100 + 1, 2**100),
    ],
    ids=[
        "kanban 10",
        "kanban 50",
        "untimed",
        "manufacturing",
        "courier",
        "philosophers",
        "referendum",
    ],
)
def test_published_counts(net, total, tangible, dead):
    found = count_markings(net)
    assert (total or found.total, tangible, dead) == (found.total, found.tangible, found.dead)
    assert found.dead_transitions == []


def test_published_numbers_of_arcs():
    assert count_markings(kanban(5)).arcs == 24_460_016
    assert count_markings(kanban(50)).arcs == 156_123_354_932_013_560


@pytest.mark.long
def test_the_counts_are_those_of_exploration():
    for net in (flexible_manufacturing(2), two_handed(4), courier(1)):
        space, found = explore(net), count_markings(net)
        assert (found.total, found.arcs) == (len(space), space.whole_arcs)
        assert found.total - found.tangible == space.is_vanishing.sum()


@pytest.mark.long
@pytest.mark.parametrize("form", FORMS)
def test_an_unbounded_net_ends_at_the_limit(form):
    net = NetBuilder("grows").place("p").exponential("t", outputs="p").build()
    with pytest.raises(LimitError, match="not decided within 0.004 GB"):
        count_markings(net, memory=4e6, form=form_of(form))
    with pytest.raises(LimitError, match="not decided within 0 s"):
        count_markings(net, watch=Watch(seconds=0), form=form_of(form))


def test_it_can_be_cancelled_and_reports_its_nodes():
    seen = []
    watch = Watch(
        lambda what, count, seconds: seen.append(what), lambda: seen.count("nodes") > 2, interval=0
    )
    with pytest.raises(CancelledError):
        count_markings(two_handed(30), watch=watch)
    assert seen.count("nodes") == 3


def analysed(capsys, tmp_path, net, *words):
    write_net(net, tmp_path / "net.pnml")
    code = main(["analyse", str(tmp_path / "net.pnml"), *words])
    return code, capsys.readouterr()


@pytest.mark.long
def test_the_command_counts_where_asked(capsys, tmp_path):
    net = two_handed(20)
    code, printed = analysed(capsys, tmp_path, net, "--symbolic", "--json", "--no-structure")
    data, counts = json.loads(printed.out), count_markings(net)
    assert code == 0
    assert data["engine"] == "symbolic"
    assert data["states"] == {
        "total": counts.total,
        "tangible": counts.total,
        "vanishing": 0,
        "arcs": counts.arcs,
    }
    assert data["deadlocks"]["count"] == 2
    assert set(net.enabled(net.marking(data["deadlocks"]["marking"]))) == set()
    assert (data["bounded"], data["k_safe"], data["live"]) == (True, 1, False)
    assert data["home_states"] is None and data["steady_state"] is None

    code, printed = analysed(capsys, tmp_path, net, "--symbolic")
    assert code == 0
    assert "{:,} tangible".format(counts.total) in printed.out
    assert "deadlocks: 2, e.g. (" in printed.out
    assert "transitions that never fire: none" in printed.out


@pytest.mark.long
def test_the_command_counts_where_the_visit_does_not_end(capsys, tmp_path):
    code, printed = analysed(capsys, tmp_path, two_handed(20), "--json", "--limit", "1000")
    data = json.loads(printed.out)
    assert code == 1  # the steady state is still open
    assert data["states"]["total"] == count_markings(two_handed(20)).total
    assert (data["engine"], data["deadlocks"]["count"], data["bounded"]) == ("symbolic", 2, True)
    assert data["live"] is False
    assert {"states", "deadlocks", "bounds", "live"}.isdisjoint(data["undecided"])
    assert "--limit" in data["undecided"]["steady_state"]


def test_what_is_visited_stays_what_it_was(capsys, tmp_path):
    _, printed = analysed(capsys, tmp_path, two_handed(3), "--json")
    assert json.loads(printed.out)["engine"] != "symbolic"


def test_an_unbounded_net_is_not_counted(capsys, tmp_path):
    net = NetBuilder("grows").place("p").exponential("t", outputs="p").exponential("u", inputs="p")
    code, printed = analysed(capsys, tmp_path, net.build(), "--symbolic", "--json")
    data = json.loads(printed.out)
    assert code == 1
    assert (data["states"], data["bounded"], data["bounds"]) == (None, False, {"p": "infinite"})
    assert "p can grow without bound" in data["undecided"]["states"]


@pytest.mark.parametrize(
    "words",
    [["--reach", "deadlock"], ["--lump"], ["--memory", "1GB"], ["--engine", "numpy"]],
    ids=lambda words: words[0],
)
def test_what_counting_does_not_answer_is_refused(capsys, tmp_path, words):
    code, printed = analysed(capsys, tmp_path, two_handed(3), "--symbolic", *words)
    assert code == 2 and "--symbolic" in printed.err


def test_a_plan_is_not_counted(capsys):
    assert main(["analyse", "plans/warehouse", "--symbolic"]) == 2
    assert "--only-net" in capsys.readouterr().err


def test_places_that_only_count_are_left_out(capsys):
    words = ["analyse", "plans/warehouse", "--only-net", "--no-structure", "--json"]
    main(words)
    visited = json.loads(capsys.readouterr().out)
    assert main([*words, "--symbolic"]) == 1  # whether Delivered is bounded
    counted = json.loads(capsys.readouterr().out)
    for key in ("states", "left_out", "dead_transitions"):
        assert counted[key] == visited[key]
    assert visited["left_out"] == ["Delivered"] and visited["bounds"]["Delivered"] == "infinite"
    assert counted["bounds"] == {**visited["bounds"], "Delivered": None}
    assert "Delivered" in counted["undecided"]["bounds"]


def test_places_that_only_count_but_are_bounded_are_counted():
    # not even the coverability tree tells that they are: it is too large
    net = NetBuilder("cycles").place("left", tokens=2).place("done")
    for i in range(12):
        net.place("a%d" % i, tokens=1).place("b%d" % i)
        net.exponential("go%d" % i, inputs="a%d" % i, outputs="b%d" % i)
        net.exponential("back%d" % i, inputs="b%d" % i, outputs="a%d" % i)
    net.exponential("count", inputs="left", outputs="done").exponential("drop", inputs="left")
    analysis = Analysis(net.build())
    assert analysis.uncounted == ("done",)
    assert (analysis.counts().total, analysis.uncounted) == (6 * 2**12, ())


@pytest.mark.long
def test_many_steps_between_few_nodes_keep_their_results():
    counts = count_markings(shared_memory(6))
    assert counts.total == len(explore(shared_memory(6)))


def test_nets_without_places_or_transitions_and_with_many_tokens():
    assert count_markings(NetBuilder("empty").build()).total == 1
    lonely = count_markings(NetBuilder("lonely").place("p", tokens=2**53).build())
    assert (lonely.total, lonely.dead, lonely.bounds) == (1, 1, {"p": 2**53})
    net = NetBuilder("rich").place("p", tokens=2**53, capacity=2**53).place("q", capacity=3)
    net.exponential("t", inputs="p", outputs="q").exponential("u", inputs="q", outputs="p")
    rich = count_markings(net.build())
    assert (rich.total, rich.bounds) == (4, {"p": 2**53, "q": 3})
