"""Equal parts that are exchanged change nothing but the number of visited markings."""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from generated_nets import split
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.nets import machines, philosophers
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.report import Questions, asked_conditions, report
from gspn_framework_package.analysis.state_space.space import explore
from gspn_framework_package.analysis.symmetry import factors
from gspn_framework_package.analysis.symmetry.automorphisms import automorphisms
from gspn_framework_package.analysis.symmetry.factors import Exchange, Listed, Turned
from gspn_framework_package.analysis.symmetry.lumped_space import explore_lumped
from gspn_framework_package.analysis.symmetry.symmetry import Symmetry
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import write_net
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import RefusedError, UsageError

pytest.importorskip("igraph")
relaxed = settings(
    deadline=None, derandomize=True, max_examples=60, suppress_health_check=list(HealthCheck)
)
PLANS = Path(__file__).parents[3] / "plans"
IN_TIME = ("mean_tokens", "throughput", "mean_waiting_time", "token_distribution")


@st.composite
def nets_of_equal_parts(draw):
    """Equal parts around some shared places; in a ring, a transition may reach into the next one.
    Every firing keeps the number of tokens."""
    number = draw(st.integers(2, 4))
    ring = draw(st.booleans())
    own = ["p%d" % i for i in range(draw(st.integers(1, 2)))]
    shared = ["s%d" % i for i in range(draw(st.integers(0, 2)))]
    builder = NetBuilder("equal parts")
    for place in shared:
        builder.place(place, tokens=draw(st.integers(0, 2)))
    tokens = split(draw, draw(st.integers(1, 2)), own)
    for k in range(number):
        for place in own:
            builder.place("%s_%d" % (place, k), tokens=tokens.get(place, 0))
    reach = own + shared + (["next p0"] if ring else [])
    for i in range(draw(st.integers(1, 3))):
        total = draw(st.integers(1, 2))
        inputs, outputs = split(draw, total, reach), split(draw, total, reach)
        inhibitors = {draw(st.sampled_from(reach)): 2} if draw(st.integers(0, 3)) == 0 else {}
        timed = draw(st.integers(0, 3)) > 0
        behaviour = (
            {"rate": draw(st.sampled_from([0.5, 1.0, 3.0])), "servers": draw(servers)}
            if timed
            else {"weight": draw(st.sampled_from([1.0, 2.0])), "priority": draw(st.integers(1, 2))}
        )
        for k in range(number):

            def here(weights, k=k):
                return {
                    place
                    if place in shared
                    else "p0_%d" % ((k + 1) % number)
                    if place.startswith("next")
                    else "%s_%d" % (place, k): weight
                    for place, weight in weights.items()
                }

            (builder.exponential if timed else builder.immediate)(
                "t%d_%d" % (i, k),
                inputs=here(inputs),
                outputs=here(outputs),
                inhibitors=here(inhibitors),
                **behaviour,
            )
    return builder.build()


servers = st.sampled_from([1, 2, None])


def check_measures(found, whole):
    """The same numbers to 1e-9, wherever both are known."""
    for measure in IN_TIME:
        if measure in whole:
            for name, value in whole[measure].items():
                check_number(found[measure][name], value)


def check_number(found, whole):
    if isinstance(whole, dict):
        for n in found.keys() | whole.keys():
            check_number(found.get(n, 0.0), whole.get(n, 0.0))
    elif isinstance(whole, float):
        assert found == pytest.approx(whole, rel=1e-9, abs=1e-9)
    else:
        assert found == whole  # infinite, or none


def check_witness(net, names, marking):
    now = net.initial_marking
    for name in names:
        t = net.transition_number(name)
        assert t in net.enabled(now)
        now = net.fire(now, t)
    assert net.named(now, zeros=False) == marking


def both_reports(net, questions):
    whole = report(Analysis(net, structure=False), questions)
    found = report(Analysis(net, structure=False, lump=asked_conditions(questions)), questions)
    return found, whole


@pytest.mark.long
@relaxed
@given(net=nets_of_equal_parts())
def test_the_answers_are_those_of_the_whole(net):
    questions = Questions(
        structure=False,
        at=(0.7,),
        reach=("deadlock", "p0_0 >= 2"),
        mean_time_to=("deadlock",),
        settling=0.01,
        rewards={"p0_0": 2.0, "t0_1": 3.0},
    )
    # questions about a place keep it apart: the answers without them exchange more
    for asked in (questions._replace(reach=("deadlock",)), questions):
        found, whole = both_reports(net, asked)
        assert found["lumped"]["visited"] <= whole["states"]["total"]
        for key in ("states", "bounded", "bounds", "k_safe", "reversible", "dead_transitions"):
            assert found[key] == whole[key] or key in found["undecided"], key
        for key in ("live", "liveness"):
            assert found[key] == whole[key] or key in found["undecided"]
        if found["home_states"] is not None:
            assert found["home_states"]["count"] == whole["home_states"]["count"]
        assert found["deadlocks"]["count"] == whole["deadlocks"]["count"]
        if whole["deadlocks"]["count"]:
            assert len(found["deadlocks"]["witness"]) == len(whole["deadlocks"]["witness"])
            check_witness(net, found["deadlocks"]["witness"], found["deadlocks"]["marking"])
        for one, other in zip(found["reach"], whole["reach"]):
            assert (one["reachable"], one["count"]) == (other["reachable"], other["count"])
        assert (found["steady_state"] is None) == (whole["steady_state"] is None)
        if whole["steady_state"]:
            check_measures(found["steady_state"], whole["steady_state"])
            assert found["steady_state"]["reward"] == pytest.approx(
                whole["steady_state"]["reward"], abs=1e-9
            )
            for key in ("component_count", "deadlock_count"):
                assert found["steady_state"][key] in (whole["steady_state"][key], None)
            assert found["time_to_steady_state"] == pytest.approx(
                whole["time_to_steady_state"], rel=0.02
            )
            check_measures(found["transient"][0], whole["transient"][0])
            for one, other in zip(found["mean_time_to"], whole["mean_time_to"]):
                assert one["probability"] == pytest.approx(other["probability"], abs=1e-9)
                check_number(one["mean_time"], other["mean_time"])


@relaxed
@given(net=nets_of_equal_parts())
def test_every_generator_leaves_the_net_as_it_is(net):
    places = len(net.places)
    for generator in automorphisms(net):
        on_places, on_transitions = generator[:places], generator[places:] - places
        assert sorted(on_places) == list(range(places))
        for p, place in enumerate(net.places):
            assert net.places[on_places[p]].tokens == place.tokens
        for t, transition in enumerate(net.transitions):
            image = int(on_transitions[t])
            assert net.transitions[image]._replace(name="") == transition._replace(name="")
            for rows in (net.inputs, net.outputs, net.inhibitors):
                assert {(int(on_places[p]), w) for p, w in rows[t]} == set(rows[image])


@pytest.mark.long
@relaxed
@given(net=nets_of_equal_parts())
def test_there_is_one_marking_of_each_orbit_and_its_size_is_right(net):
    symmetry = Symmetry(net)
    markings = explore(net).markings()
    least = markings.copy()
    sizes = symmetry.reduce(least)
    found, counts = np.unique(least, axis=0, return_counts=True)
    assert dict(zip(map(tuple, least.tolist()), sizes.tolist())) == dict(
        zip(map(tuple, found.tolist()), counts.tolist())
    )
    for generator in symmetry.generators:
        image = np.empty_like(markings)
        image[:, generator[: len(net.places)]] = markings
        symmetry.reduce(image)
        assert (image == least).all()


@pytest.mark.long
@relaxed
@given(net=nets_of_equal_parts(), data=st.data())
def test_one_rate_that_differs_makes_a_part_another(net, data):
    timed = [t.name for t in net.transitions if t.timed]
    if not timed:
        return
    changed = data.draw(st.sampled_from(timed))
    other = net.with_rates({changed: 7.0})
    orbits = Symmetry(other).transition_orbits
    assert np.bincount(orbits)[orbits[other.transition_number(changed)]] == 1
    check_measures_of(other)


def check_measures_of(net):
    questions = Questions(structure=False)
    found, whole = both_reports(net, questions)
    if whole["steady_state"]:
        check_measures(found["steady_state"], whole["steady_state"])


def robots(number, rates=None, groups=1):
    """Robots with places of their own, who share two tools; in groups that share a room each."""
    net = NetBuilder("robots").place("tools", tokens=2)
    for group in range(groups):
        net.place("room%d" % group, tokens=1)
        for i in range(number):
            name = "%d_%d" % (group, i)
            net.place("idle" + name, tokens=1).place("wait" + name).place("busy" + name)
            net.exponential(
                "ask" + name,
                rate=1.0,
                inputs=["idle" + name, "room%d" % group],
                outputs=["wait" + name, "room%d" % group],
            )
            net.immediate("take" + name, inputs=["wait" + name, "tools"], outputs="busy" + name)
            net.exponential(
                "end" + name,
                rate=(rates or {}).get(name, 2.0),
                inputs="busy" + name,
                outputs=["idle" + name, "tools"],
            )
    return net.build()


def lumped(net, **options):
    options.setdefault("bounds", [None] * len(net.places))
    return explore_lumped(Symmetry(net), **options)


def test_equal_robots_are_sorted():
    symmetry = Symmetry(robots(6))
    (factor,) = symmetry.factors
    assert isinstance(factor, Exchange) and factor.blocks.shape == (6, 3)
    space = lumped(robots(6))
    assert len(space) < 20 and space.count(slice(None)) == len(explore(robots(6)))


@pytest.mark.long
def test_many_equal_robots_have_more_markings_than_a_word_can_count():
    space = lumped(robots(80))
    # each marking by the number of robots that are idle, wait and are busy
    assert space.complete and len(space) < 300
    assert space.count(slice(None)) > 2**62


def test_one_robot_that_differs_stays_apart():
    (factor,) = Symmetry(robots(5, rates={"0_2": 2.5})).factors
    assert len(factor.blocks) == 4
    assert not Symmetry(robots(2, rates={"0_1": 2.5})).factors


def test_groups_of_equal_robots_are_exchanged_too():
    net = robots(3, groups=3)
    symmetry = Symmetry(net)
    (factor,) = symmetry.factors
    assert factor.order == 6**3 * 6 and len(factor.inner) == 3 and not symmetry.unused
    assert "within them" in factor.text
    check_measures_of(robots(2, groups=2))


def cells(number, inside):
    """A ring of cells, each with equal machines, that pass parts on."""
    net = NetBuilder("cells")
    for c in range(number):
        net.place("buffer%d" % c, tokens=1)
        for i in range(inside):
            net.place("free%d_%d" % (c, i), tokens=1).place("works%d_%d" % (c, i))
    for c in range(number):
        for i in range(inside):
            name = "%d_%d" % (c, i)
            net.exponential(
                "begin" + name, inputs=["buffer%d" % c, "free" + name], outputs="works" + name
            )
            net.exponential(
                "end" + name,
                rate=2.0,
                inputs="works" + name,
                outputs=["buffer%d" % ((c + 1) % number), "free" + name],
            )
    return net.build()


@pytest.mark.parametrize(("number", "inside", "order"), [(3, 2, 24), (4, 3, 5184)])
def test_a_ring_turns_whose_cells_have_equal_machines(number, inside, order):
    net = cells(number, inside)
    symmetry = Symmetry(net)
    (factor,) = symmetry.factors
    assert isinstance(factor, Turned) and not symmetry.unused
    assert symmetry.order == order and "within them" in factor.text
    whole = explore(net)
    least = whole.markings()
    sizes = symmetry.reduce(least)
    found, counts = np.unique(least, axis=0, return_counts=True)
    assert dict(zip(map(tuple, least.tolist()), sizes.tolist())) == dict(
        zip(map(tuple, found.tolist()), counts.tolist())
    )
    space = lumped(net)
    assert len(space) == len(found) and space.count(slice(None)) == len(whole)


def test_a_ring_of_cells_with_equal_machines_has_the_measures_of_the_whole():
    check_measures_of(cells(3, 2))


def test_a_ring_turns():
    symmetry = Symmetry(philosophers(7))
    (factor,) = symmetry.factors
    assert isinstance(factor, Listed) and factor.order == 7
    assert len(lumped(philosophers(7))) < len(explore(philosophers(7))) / 5


def test_groups_of_unknown_form_are_used_in_part(monkeypatch):
    monkeypatch.setattr(factors, "MOST_LISTED", 3)
    net = philosophers(6)
    symmetry = Symmetry(net)
    assert symmetry.unused > 0
    whole = explore(net)
    assert explore_lumped(symmetry, bounds=[1] * 24).count(slice(None)) == len(whole)
    check_measures_of(net)


def test_a_condition_that_an_exchange_changes_is_refused():
    analysis = Analysis(robots(3), lump=())
    with pytest.raises(RefusedError, match="busy0_1"):
        analysis.reach("busy0_1 == 1")
    assert analysis.reach("tools == 0").reachable


@pytest.mark.parametrize(
    ("condition", "order"),
    [
        ("busy0_1 == 1", 6),
        ("busy0_0 + 1 == 1 + busy0_2", 4),
        ("busy0_0 - busy0_1 < 1", 2),
        ("busy0_0 + busy0_1 + busy0_2 + busy0_3 >= 2", 24),
        ("busy0_0 * 2 + busy0_1 >= 2", 2),
        ("busy0_0 + busy0_1 + 0.5 >= 2", 4),
        ("busy0_3 == 1 or busy0_2 >= 1 or (busy0_1 == 1 or busy0_0 == 1)", 6),
        ("max(busy0_3, wait0_1) < min(idle0_1, idle0_3) or not deadlock", 2),
        ("not (busy0_0 + wait0_0 >= 1) and busy0_1 + busy0_2 == 1", 2),
    ],
)
def test_a_condition_leaves_what_it_does_not_tell_apart(condition, order):
    net = robots(4)
    analysis = Analysis(net, lump=[condition])
    assert analysis.space.symmetry.order == order
    assert analysis.space.symmetry.keeps(analysis.space.condition(condition))
    found, whole = analysis.reach(condition), Analysis(net).reach(condition)
    assert (found.reachable, found.number) == (whole.reachable, whole.number)


def test_final_markings_that_exchange_into_each_other_are_several():
    net = NetBuilder("one tool for good").place("tool", tokens=1)
    for i in range(3):
        net.place("a%d" % i, tokens=1).place("b%d" % i).place("c%d" % i)
        net.exponential("take%d" % i, inputs=["a%d" % i, "tool"], outputs="b%d" % i)
        net.exponential("go%d" % i, inputs="b%d" % i, outputs="c%d" % i)
        net.exponential("back%d" % i, inputs="c%d" % i, outputs="b%d" % i)
    found, whole = both_reports(net.build(), Questions(structure=False))
    assert whole["steady_state"]["component_count"] == 3
    assert found["steady_state"]["component_count"] is None
    assert "steady_state.component_count" in found["undecided"]
    assert "liveness" in found["undecided"] and "home_states" in found["undecided"]
    check_measures(found["steady_state"], whole["steady_state"])


def test_counters_that_are_left_out_tell_what_feeds_them_apart():
    net = NetBuilder("counting").place("made0").place("made1").place("s", tokens=30_000)
    for i in range(2):
        net.place("a%d" % i, tokens=1).place("b%d" % i)
        net.exponential("go%d" % i, inputs="a%d" % i, outputs=["b%d" % i, "made%d" % i])
        net.exponential("back%d" % i, inputs="b%d" % i, outputs="a%d" % i)
    analysis = Analysis(net.build(), lump=())
    assert analysis.left_out == ("made0", "made1")
    assert len(analysis.space) == 4


def depending(rate):
    """Two equal robots, and a machine whose rate is ``rate``."""
    net = NetBuilder("depending").place("up", tokens=1).place("down")
    for i in range(2):
        net.place("a%d" % i, tokens=1).place("b%d" % i)
        net.exponential("go%d" % i, inputs="a%d" % i, outputs="b%d" % i)
        net.exponential("back%d" % i, inputs="b%d" % i, outputs="a%d" % i)
    net.exponential("fails", inputs="up", outputs="down")
    return net.exponential("mended", rate, inputs="down", outputs="up").build()


def test_places_that_a_rate_names_are_told_apart():
    assert Symmetry(depending(2.0)).factors
    for rate in ("1 + #a0", "1 + #a0 + 2 * #a1", "1 + #b1"):
        assert not Symmetry(depending(rate)).factors
        check_measures_of(depending(rate))
    assert Symmetry(depending("1 + #down")).factors
    check_measures_of(depending("1 + #down"))


def test_a_counter_that_a_rate_names_is_not_left_out():
    net = NetBuilder("slower").place("a", tokens=3).place("made")
    net.exponential("make", "1 / (1 + #made)", inputs="a", outputs="made")
    assert Analysis(net.build()).left_out == ()


def test_a_net_without_equal_parts_is_visited_as_a_whole():
    net = robots(2, rates={"0_1": 2.5})
    space = lumped(net)
    assert len(space) == len(explore(net)) and not space.symmetry.factors


def test_limits_end_it():
    space = lumped(philosophers(12), limit=100)
    assert not space.complete and space.shortage == ("--limit", "")
    analysis = Analysis(philosophers(12), limits=Limits(states=100), lump=())
    assert report(analysis, Questions(structure=False))["lumped"]["factor"] is None


@pytest.mark.long
def test_more_permutations_than_a_float_can_count_are_reported(tmp_path, capsys):
    file = tmp_path / "machines.pnml"
    write_net(machines(175), file)
    assert main(["analyse", str(file), "--lump", "--no-structure", "--limit", "5"]) == 1
    assert "each for up to 1.124e+318" in capsys.readouterr().out
    assert main(["analyse", str(file), "--lump", "--no-structure", "--limit=5", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["lumped"]["permutations"] == math.factorial(175)


def test_the_command_says_the_factor(tmp_path, capsys):
    file = tmp_path / "robots.pnml"
    write_net(robots(6), file)
    assert main(["analyse", str(file), "--lump", "--no-structure"]) == 0
    text = capsys.readouterr().out
    assert "times fewer" in text and "6 equal parts of 3 places" in text
    assert main(["analyse", str(file), "--lump", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["lumped"]["permutations"] == 720


def test_the_command_refuses_what_does_not_go_together(tmp_path, capsys):
    assert main(["analyse", str(PLANS / "tokens"), "--lump"]) == 2
    assert "policy" in capsys.readouterr().err
    assert main(["analyse", str(PLANS / "tokens"), "--only-net", "--lump", "--engine=numpy"]) == 2
    assert "--engine" in capsys.readouterr().err


def test_a_missing_igraph_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "igraph", None)
    with pytest.raises(UsageError, match="pip install igraph"):
        Symmetry(robots(2))
