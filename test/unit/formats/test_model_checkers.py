"""What is exported means the same to a model checker: Storm builds and solves it.

The expected values come from the firing rule itself: markings are explored with ``Net.enabled`` and
``Net.fire``, and long-run and reachability probabilities are the limit of the chain's powers.
"""

import json
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, note, settings
from hypothesis import strategies as st

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import jani, prism, write_net
from gspn_framework_package.formats.markov_chain import ExplicitChain, drn, prism_files
from gspn_framework_package.formats.symbolic import identifiers
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import NetError
from gspn_framework_package.model.marking_function import parse_value, quoted_place
from gspn_framework_package.model.net import Arc, Net, Place, Transition

stormpy = pytest.importorskip("stormpy")

MAX_MARKINGS = 60
RELAXED = settings(
    max_examples=50,
    deadline=None,
    suppress_health_check=[
        HealthCheck.function_scoped_fixture,
        HealthCheck.filter_too_much,
        HealthCheck.too_slow,
    ],
)
NAMES = ["p", "p 1", "p:1", "min", "é", "1st"]
FUNCTIONS = [
    "1 + #%s + #%s / 4 - -0.5",
    "min(#%s, 2) + max(0.25, #%s, 1)",
    "2 * exp(-#%s) + ln(2 + #%s)",
    "sqrt(1 + #%s) + pow(2, -#%s)",
    "(1 + #%s) ^ 2 / (1 + #%s)",
    "ceil((1 + #%s) / 2) + floor(#%s / 2) + round(0.5)",
]
"""Rates and weights that depend on the marking; above 0 everywhere."""


@st.composite
def small_nets(draw, immediate=True):
    """Nets of few markings, most of them: transitions move one or two tokens."""
    places = [
        Place(name, draw(st.integers(0, 2)), draw(st.sampled_from([None, None, 3])))
        for name in NAMES[: draw(st.integers(2, 4))]
    ]
    transitions, arcs = [], []
    for number in range(draw(st.integers(1, 5))):
        name = "t%d" % number
        if immediate and draw(st.booleans()):
            transitions.append(
                Transition(
                    name,
                    weight=draw(st.sampled_from([0.5, 1.0, 3.0])),
                    priority=draw(st.sampled_from([1, 1, 2])),
                )
            )
        else:
            transitions.append(
                Transition(
                    name,
                    timed=True,
                    rate=draw(st.sampled_from([0.25, 1.0, 2.0])),
                    servers=draw(st.sampled_from([1, 2, None])),
                )
            )
        if draw(st.integers(0, 2)) == 0:
            names = [quoted_place(draw(st.sampled_from(places)).name) for _ in range(2)]
            function = parse_value(draw(st.sampled_from(FUNCTIONS)) % tuple(names))
            key = "rate" if transitions[-1].timed else "weight"
            transitions[-1] = transitions[-1]._replace(**{key: function})
        weight = draw(st.sampled_from([1, 1, 1, 2]))
        ends = draw(st.lists(st.sampled_from(places), min_size=2, max_size=2, unique=True))
        arcs += [Arc(ends[0].name, name, weight), Arc(name, ends[1].name, weight)]
        if draw(st.integers(0, 3)) == 0:
            inhibiting = draw(st.sampled_from(places)).name
            arcs.append(Arc(inhibiting, name, draw(st.integers(1, 3)), inhibitor=True))
    return Net(places, transitions, arcs, "n")


class Chain:
    """The embedded jumps and the times of a net, from the firing rule."""

    def __init__(self, net):
        self.markings = [net.initial_marking]
        index = {net.initial_marking: 0}
        moves = []
        for number, marking in enumerate(self.markings):
            enabled = net.enabled(marking)
            for t in enabled:
                after = net.fire(marking, t)
                if after not in index:
                    assume(len(index) < MAX_MARKINGS)
                    index[after] = len(self.markings)
                    self.markings.append(after)
                transition = net.transitions[t]
                speed = (net.effective_rate if transition.timed else net.value)(marking, t)
                moves.append((number, index[after], speed, transition.timed))
        size = len(self.markings)
        self.timed = [True] * size
        speeds = np.zeros((size, size))
        for source, target, speed, timed in moves:
            speeds[source, target] += speed
            self.timed[source] = timed
        self.speeds = speeds

    def tangible_generator(self):
        """Rates between tangible markings after elimination, and how each marking gets to one."""
        slow = [i for i, timed in enumerate(self.timed) if timed]
        fast = [i for i, timed in enumerate(self.timed) if not timed]
        jump = self.speeds[fast] / self.speeds[fast].sum(axis=1, keepdims=True)
        inner = np.eye(len(fast)) - jump[:, fast]
        assume(not fast or abs(np.linalg.det(inner)) > 1e-9)  # else a timeless trap
        entry = np.zeros((len(self.markings), len(slow)))
        entry[slow] = np.eye(len(slow))
        if fast:
            entry[fast] = np.linalg.solve(inner, jump[:, slow])
        return self.speeds[slow] @ entry, entry, slow

    def long_run(self):
        """The long-run fraction of time in each marking."""
        rates, entry, slow = self.tangible_generator()
        fastest = 1.1 * max(rates.sum(axis=1).max(), 1e-3)
        step = rates / fastest
        step += np.diag(1 - step.sum(axis=1))
        for _ in range(40):
            step = step @ step
            step /= step.sum(axis=1, keepdims=True)
        found = np.zeros(len(self.markings))
        found[slow] = entry[0] @ step
        return found

    def reach(self, goal):
        """The probability of ever reaching a marking where ``goal`` is true."""
        jump = self.speeds.copy()
        for i, marking in enumerate(self.markings):
            if goal(marking) or not jump[i].any():
                jump[i] = 0
                jump[i, i] = 1
        jump /= jump.sum(axis=1, keepdims=True)
        for _ in range(40):
            jump = jump @ jump
            jump /= jump.sum(axis=1, keepdims=True)
        return sum(jump[0, i] for i, marking in enumerate(self.markings) if goal(marking))


def build_jani(tmp_path, net, property_text=None):
    write_net(net, tmp_path / "n.jani")
    model, _ = stormpy.parse_jani_model(str(tmp_path / "n.jani"))
    properties = stormpy.parse_properties(property_text, model) if property_text else None
    return stormpy.build_model(model, properties), properties


def build_prism(tmp_path, net, property_text):
    write_net(net, tmp_path / "n.prism")
    program = stormpy.parse_prism_program(str(tmp_path / "n.prism"), prism_compatibility=True)
    properties = stormpy.parse_properties(property_text, program)
    return stormpy.build_model(program, properties), properties


def value(model, property_):
    try:
        return stormpy.model_checking(model, property_).get_value(model.initial_states[0])
    except RuntimeError as error:
        assume("UnmetRequirementException" not in str(error))  # Storm has no solver for it
        raise


def place_identifier(net, p):
    return list(identifiers([place.name for place in net.places])[0].values())[p]


@RELAXED
@given(net=small_nets())
def test_jani_has_the_markings_of_the_net(tmp_path, net):
    chain = Chain(net)
    model, _ = build_jani(tmp_path, net)
    assert model.nr_states == len(chain.markings)


@RELAXED
@given(net=small_nets(), data=st.data())
def test_jani_has_the_probabilities_of_the_net(tmp_path, net, data):
    chain = Chain(net)
    chain.tangible_generator()
    p = data.draw(st.integers(0, len(net.places) - 1))
    bound = data.draw(st.integers(0, 3))
    goal = "%s >= %d" % (place_identifier(net, p), bound)
    kind = "max" if any(not t.timed for t in net.transitions) else ""
    model, properties = build_jani(tmp_path, net, "P%s=? [F %s]" % (kind, goal))
    expected = chain.reach(lambda marking: marking[p] >= bound)
    assert value(model, properties[0]) == pytest.approx(expected, abs=1e-6)


@RELAXED
@given(net=small_nets(), data=st.data())
def test_jani_has_the_long_run_of_the_net(tmp_path, net, data):
    note(repr((net.places, net.transitions, net.arcs)))
    chain = Chain(net)
    assume(all(row.any() for row in chain.speeds))  # Storm makes a deadlock of a net its own way
    p = data.draw(st.integers(0, len(net.places) - 1))
    goal = "%s >= 1" % place_identifier(net, p)
    kind = "max" if any(not t.timed for t in net.transitions) else ""
    model, properties = build_jani(tmp_path, net, "LRA%s=? [%s]" % (kind, goal))
    long_run = chain.long_run()
    expected = sum(share for share, marking in zip(long_run, chain.markings) if marking[p] >= 1)
    assert value(model, properties[0]) == pytest.approx(expected, abs=1e-5)


@RELAXED
@given(net=small_nets(immediate=False), data=st.data())
def test_prism_has_the_markings_probabilities_and_throughput_of_the_net(tmp_path, net, data):
    chain = Chain(net)
    p = data.draw(st.integers(0, len(net.places) - 1))
    goal = "%s >= 2" % place_identifier(net, p)
    model, properties = build_prism(tmp_path, net, 'P=? [F %s]; R{"throughput_t0"}=? [LRA]' % goal)
    assert model.nr_states == len(chain.markings)
    expected = chain.reach(lambda marking: marking[p] >= 2)
    assert value(model, properties[0]) == pytest.approx(expected, abs=1e-6)
    throughput = sum(
        share * net.effective_rate(marking, 0)
        for share, marking in zip(chain.long_run(), chain.markings)
    )
    assert value(model, properties[1]) == pytest.approx(throughput, abs=1e-5)


def test_philosophers(tmp_path):
    """Four philosophers: 34 markings, mean time to deadlock 550/101."""
    builder = NetBuilder("philosophers")
    for n in range(4):
        builder.place("think%d" % n, 1).place("wait%d" % n).place("eat%d" % n).place(
            "fork%d" % n, 1
        )
    for n in range(4):
        left, right = "fork%d" % n, "fork%d" % ((n + 1) % 4)
        builder.exponential("take%d" % n, inputs=["think%d" % n, left], outputs="wait%d" % n)
        builder.exponential("both%d" % n, inputs=["wait%d" % n, right], outputs="eat%d" % n)
        builder.exponential("done%d" % n, inputs="eat%d" % n, outputs=["think%d" % n, left, right])
    net = builder.build()
    for build in (build_jani, build_prism):
        model, properties = build(tmp_path, net, 'T=? [F "deadlock"]')
        assert model.nr_states == 34
        assert value(model, properties[0]) == pytest.approx(550 / 101, rel=1e-5)


def test_weight_0_is_a_nondeterministic_choice(tmp_path):
    net = (
        NetBuilder("n")
        .place("a", 1)
        .place("b")
        .place("c")
        .immediate("left", weight=0, inputs="a", outputs="b")
        .immediate("right", weight=0, inputs="a", outputs="c")
        .build()
    )
    for kind, expected in (("max", 1), ("min", 0)):
        model, properties = build_jani(tmp_path, net, "P%s=? [F b=1]" % kind)
        assert value(model, properties[0]) == expected


def test_the_bounds_that_are_known_are_said():
    net = NetBuilder("n").place("a", 1).place("b", capacity=4).place("c").exponential("t").build()
    document = json.loads(jani.to_bytes(net, {"a": 2}))
    bounds = [
        v["type"] if v["type"] == "int" else v["type"]["upper-bound"] for v in document["variables"]
    ]
    assert bounds == [2, 4, "int"]
    text = prism.to_bytes(net, {"a": 2}).decode()
    assert re.findall(r"^  (\w) : (.*) init", text, re.MULTILINE) == [
        ("a", "[0..2]"),
        ("b", "[0..4]"),
        ("c", "int"),
    ]


def test_a_place_that_is_always_empty_has_a_variable_of_two_values(tmp_path):
    """Storm computes wrong numbers with a variable whose only value is 0."""
    net = (
        NetBuilder("n")
        .place("a", 1)
        .place("b")
        .place("never")
        .place("full", 2, capacity=2)
        .exponential("t", rate=2, inputs="a", outputs="b")
        .exponential("u", inputs={"b": 1, "never": 1}, outputs={"a": 1, "never": 1})
        .exponential("back", rate=3, inputs="b", outputs="a")
        .build()
    )
    known = {"a": 1, "b": 1, "never": 0, "full": 0}
    document = json.loads(jani.to_bytes(net, known))
    assert [v["type"]["upper-bound"] for v in document["variables"]] == [1, 1, 1, 2]
    text = prism.to_bytes(net, known).decode()
    assert re.findall(r" : \[0\.\.(\d)\] init", text) == ["1", "1", "1", "2"]
    path = tmp_path / "n.jani"
    assert main(["convert", _written(net, tmp_path), str(path)]) == 0
    assert [v["type"]["upper-bound"] for v in json.loads(path.read_text())["variables"]] == [
        1,
        1,
        1,
        2,
    ]


def _written(net, folder):
    write_net(net, folder / "n.xml")
    return str(folder / "n.xml")


def test_the_command_finds_the_bounds_by_invariants(tmp_path):
    net = NetBuilder("n").place("a", 3).place("b").exponential("t", inputs="a", outputs="b").build()
    write_net(net, tmp_path / "n.xml")
    assert main(["convert", str(tmp_path / "n.xml"), str(tmp_path / "n.prism")]) == 0
    assert "  b : [0..3] init 0;" in (tmp_path / "n.prism").read_text()


def test_prism_refuses_immediate_transitions():
    net = NetBuilder("n").place("a", 1).immediate("t", inputs="a").build()
    with pytest.raises(NetError, match="PRISM has no immediate transitions"):
        prism.to_bytes(net)


def test_names_become_different_identifiers():
    places, transitions = identifiers(["a b", "a.b", "a_b", "min", "1"], ["a b", "T"])
    assert list(places.values()) == ["a_b", "a_b_2", "a_b_3", "min_2", "_1"]
    assert list(transitions.values()) == ["a_b_4", "T"]


SMALL_CHAIN = ExplicitChain(
    ["a", "b c"], [(0, 1), (1, 0), (2, 2)], [(1, 2, 0.1), (0, 1, 0.5), (1, 0, 2.0)], 0, {"x": [1]}
)


def test_the_files_of_a_chain_for_prism():
    files = prism_files(SMALL_CHAIN)
    assert files["sta"].decode().splitlines() == ["(a,b_c)", "0:(0,1)", "1:(1,0)", "2:(2,2)"]
    assert files["tra"].decode().splitlines() == ["3 3", "0 1 0.5", "1 0 2.0", "1 2 0.1"]
    assert files["lab"].decode().splitlines() == [
        '0="init" 1="deadlock" 2="x"',
        "0: 0",
        "1: 2",
        "2: 1",
    ]


def test_labels_that_no_model_checker_takes():
    for label in ["init", "deadlock", "two words", "1st", "min"]:
        with pytest.raises(NetError, match="a label cannot be called"):
            drn(SMALL_CHAIN._replace(labels={label: [0]}))


@RELAXED
@given(net=small_nets(), data=st.data())
def test_the_computed_chain_as_storm_reads_it(tmp_path, net, data):
    """Immediate transitions eliminated by the analysis, written by the command, solved by Storm."""
    chain = Chain(net)
    rates, _, slow = chain.tangible_generator()
    assume(slow)
    p = data.draw(st.integers(0, len(net.places) - 1))
    write_net(net, tmp_path / "n.pnml")
    label = "goal='%s' >= 2" % net.places[p].name
    code = main(["convert", str(tmp_path / "n.pnml"), str(tmp_path / "n.drn"), "--label", label])
    assume(code == 0)  # 1: it starts in one of several states by chance
    # the others: below
    assume(re.search("^state .* goal", (tmp_path / "n.drn").read_text(), re.MULTILINE))
    model = stormpy.build_model_from_drn(str(tmp_path / "n.drn"))
    assert model.nr_states <= len(slow)  # the chain has only what is reached
    found = value(model, stormpy.parse_properties('P=? [F "goal"]')[0])
    vanishing = [m for m, timed in zip(chain.markings, chain.timed) if not timed]
    expected = chain.reach(lambda marking: marking[p] >= 2 and marking not in vanishing)
    assert found == pytest.approx(expected, abs=1e-6)


def test_a_label_that_no_state_has_is_reported(tmp_path, capsys):
    """DRN names labels at states only, so that Storm cannot know of it."""
    net = NetBuilder("n").place("a", 1).exponential("t", inputs="a").build()
    write_net(net, tmp_path / "n.xml")
    assert (
        main(
            ["convert", str(tmp_path / "n.xml"), str(tmp_path / "n.drn"), "--label", "goal=a >= 2"]
        )
        == 0
    )
    assert "no state has the label 'goal'; the file cannot express that" in capsys.readouterr().err
    assert "// no state has the label goal\n" in (tmp_path / "n.drn").read_text()
    assert stormpy.build_model_from_drn(str(tmp_path / "n.drn")).nr_states == 2
    assert (
        main(
            ["convert", str(tmp_path / "n.xml"), str(tmp_path / "n.tra"), "--label", "goal=a >= 2"]
        )
        == 0
    )
    assert '"goal"' in (tmp_path / "n.lab").read_text()


def test_a_chain_that_starts_by_chance(tmp_path, capsys):
    net = (
        NetBuilder("n")
        .place("a", 1)
        .place("b")
        .place("c")
        .immediate("left", inputs="a", outputs="b")
        .immediate("right", inputs="a", outputs="c")
        .exponential("back", inputs="b", outputs="c")
        .build()
    )
    write_net(net, tmp_path / "n.xml")
    assert main(["convert", str(tmp_path / "n.xml"), str(tmp_path / "n.tra")]) == 1
    assert "the initial state is random (2 states)" in capsys.readouterr().err


def test_the_command_writes_the_three_files_of_prism(tmp_path, capsys):
    net = (
        NetBuilder("n")
        .place("a", 1)
        .place("b")
        .place("c")
        .exponential("go", rate=2, inputs="a", outputs="b")
        .immediate("pass", inputs="b", outputs="c")
        .build()
    )
    write_net(net, tmp_path / "n.xml")
    assert main(["convert", str(tmp_path / "n.xml"), str(tmp_path / "n.tra"), "--json"]) == 0
    done = json.loads(capsys.readouterr().out)
    assert (done["states"], done["rates"]) == (2, 1)
    assert (tmp_path / "n.tra").read_text() == "2 1\n0 1 2.0\n"
    assert (tmp_path / "n.sta").read_text() == "(a,b,c)\n0:(1,0,0)\n1:(0,0,1)\n"
    assert (tmp_path / "n.lab").read_text() == '0="init" 1="deadlock"\n0: 0\n1: 1\n'
