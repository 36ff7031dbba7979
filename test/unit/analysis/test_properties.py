"""Liveness, home states, coverability, boundedness: known nets, and the definitions on generated
ones."""

import pytest
from generated_nets import bounded_nets, reference_space
from hypothesis import HealthCheck, given, settings

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.state_space import explore
from gspn_framework_package.analysis.state_space.coverability import OMEGA, CoverabilityTree
from gspn_framework_package.analysis.state_space.properties import Liveness, Properties
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import LimitError

relaxed = settings(deadline=None, suppress_health_check=list(HealthCheck))


def closure(graph, start):
    seen, waiting = set(), [start]
    while waiting:
        marking = waiting.pop()
        if marking not in seen:
            seen.add(marking)
            waiting += graph[marking].values()
    return seen


@relaxed
@given(bounded_nets())
def test_properties_by_definition(net):
    graph = reference_space(net)
    reach = {marking: closure(graph, marking) for marking in graph}
    properties = Properties(explore(net))
    assert properties.reversible == all(net.initial_marking in reach[m] for m in graph)
    home = {m for m in graph if all(m in reach[other] for other in graph)}
    assert {properties.space.marking(int(s)) for s in properties.home_states} == home
    dead = {m for m, successors in graph.items() if not successors}
    assert {properties.space.marking(s) for s in properties.deadlocks} == dead
    for t, transition in enumerate(net.transitions):
        level = properties.liveness[transition.name]
        fires_at = {m for m, successors in graph.items() if t in successors}
        assert (level >= Liveness.L1) == bool(fires_at)
        assert (level >= Liveness.L3) == any(m in reach[graph[m][t]] for m in fires_at)
        assert (level is Liveness.L4) == all(reach[m] & fires_at for m in graph)
    for p, place in enumerate(net.places):
        assert properties.bounds[place.name] == max(m[p] for m in graph)


@relaxed
@given(bounded_nets(immediate=False))
def test_the_tree_of_a_bounded_net_is_its_state_space(net):
    try:
        tree = CoverabilityTree(net)
    except LimitError:
        return  # an inhibitor arc or a capacity that the tree cannot judge
    assert tree.bounded
    assert set(tree.graph()[0]) == set(reference_space(net))


def producer_consumer():
    return (
        NetBuilder("producer")
        .place("ready", tokens=1)
        .place("made")
        .place("buffer")
        .exponential("make", inputs="ready", outputs="made")
        .exponential("put", inputs="made", outputs=["ready", "buffer"])
        .exponential("get", inputs={"buffer": 2})
        .exponential("never", inputs=["ready", "made"])
        .build()
    )


def test_unbounded_net():
    tree = CoverabilityTree(producer_consumer())
    assert tree.unbounded_places == ["buffer"]
    assert tree.bounds == {"ready": 1, "made": 1, "buffer": None}
    assert tree.dead_transitions == ["never"]
    assert tree.covers({"buffer": 1000, "made": 1}) is not None
    assert tree.covers({"ready": 1, "made": 1}) is None
    assert any(OMEGA in marking for marking in tree.graph()[0])
    assert "ω buffer" in [tree.text(m) for m in tree.graph()[0]][-1]


def test_analysis_of_an_unbounded_net():
    analysis = Analysis(producer_consumer(), limit=2000)
    assert analysis.boundedness.bounded is False
    assert analysis.boundedness.bounds["buffer"] is None
    with pytest.raises(LimitError, match=r"unbounded \(buffer can grow without bound\)"):
        _ = analysis.properties
    found = analysis.reach("buffer == 7")
    assert found.reachable and [step.transition for step in found.witness] == ["make", "put"] * 7
    assert analysis.reach("ready == 1 and made == 1").reachable is None
    assert analysis.cover({"ready": 1, "made": 1}).reachable is False
    covered = analysis.cover({"buffer": 3})
    assert covered.reachable and covered.witness[-1].marking["buffer"] >= 3


def test_a_time_that_only_finitely_many_markings_matter_for_is_known_in_an_unbounded_net():
    """The first time that a queue is n long, with arrivals as fast as services: n (n + 1) / 2."""
    queue = (
        NetBuilder("queue")
        .place("jobs")
        .exponential("come", outputs="jobs")
        .exponential("go", inputs="jobs")
    )
    analysis = Analysis(queue.build())
    assert analysis.first_passage("jobs >= 20").mean_time == pytest.approx(210, rel=1e-9)
    with pytest.raises(LimitError, match="unbounded"):
        _ = analysis.chain


@pytest.mark.long
def test_counters_that_nothing_reads_are_left_out():
    net = (
        NetBuilder("counting")
        .place("up", tokens=1)
        .place("down")
        .place("failures")
        .place("broken")
        .exponential("fail", rate=1, inputs="up", outputs=["down", "failures"])
        .exponential("repair", rate=3, inputs="down", outputs="up")
        .build()
    )
    analysis = Analysis(net)
    assert analysis.left_out == ("failures",)
    assert len(analysis.space) == 2
    assert analysis.boundedness == (False, {"up": 1, "down": 1, "failures": None, "broken": 0}, "")
    assert analysis.properties.live and not analysis.reversible
    assert analysis.measures.mean_tokens["up"] == pytest.approx(0.75)
    assert analysis.reach("failures >= 3").reachable
    # Three failures, and two repairs between them:
    assert analysis.first_passage("failures >= 3").mean_time == pytest.approx(3 / 1 + 2 / 3)


def test_what_the_tree_cannot_judge_is_not_decided():
    net = (
        NetBuilder()
        .place("a")
        .place("go", tokens=1)
        .exponential("more", inputs="go", outputs=["go", "a"], inhibitors={"a": 50})
        .build()
    )
    with pytest.raises(LimitError, match="an inhibitor arc or a capacity"):
        CoverabilityTree(net)
    assert Analysis(net).boundedness == (True, {"a": 50, "go": 1}, "")
    urgent = (
        NetBuilder()
        .place("a")
        .place("go", tokens=1)
        .exponential("more", inputs="go", outputs=["go", "a"])
        .immediate("drain", inputs="a")
        .build()
    )
    assert Analysis(urgent).boundedness.bounds == {"a": 1, "go": 1}
    with pytest.raises(LimitError, match="higher priority"):
        CoverabilityTree(
            NetBuilder()
            .place("a")
            .place("go", tokens=1)
            .exponential("more", inputs="go", outputs=["go", "a"])
            .immediate("drain", inputs={"a": 5})
            .build()
        )


def test_a_tree_too_large_is_said():
    with pytest.raises(LimitError, match="more than 5 nodes"):
        CoverabilityTree(producer_consumer(), limit=5)


def test_incomplete_spaces_answer_no_questions():
    with pytest.raises(LimitError, match="its properties: not decided within"):
        Properties(explore(producer_consumer(), limit=10))
