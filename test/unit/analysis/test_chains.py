"""Markov chains by hand: recurrent classes, cycles without time, times to steady state, waiting
times, rewards."""

import math
from fractions import Fraction

import numpy as np
import pytest
from generated_nets import bounded_nets
from hypothesis import HealthCheck, assume, given, settings
from scipy import sparse
from scipy.linalg import expm

from benchmarks.large_nets import endings
from benchmarks.nets import kanban, polling
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.chain import Chain
from gspn_framework_package.analysis.report import Questions, report
from gspn_framework_package.analysis.solution import linear
from gspn_framework_package.analysis.solution.linear import solve_linear
from gspn_framework_package.analysis.solution.measures import Measures
from gspn_framework_package.analysis.solution.ordering import sweep_order
from gspn_framework_package.analysis.solution.passage import first_passage
from gspn_framework_package.analysis.solution.steady_state import stationary, steady_state
from gspn_framework_package.analysis.solution.transient import (
    Evolution,
    poisson,
    time_to_steady_state,
    transient,
)
from gspn_framework_package.analysis.state_space import explore
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.cli.analysis_text import analysis_text
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import LimitError, RefusedError, UsageError
from gspn_framework_package.model.net import Net

relaxed = settings(deadline=None, suppress_health_check=list(HealthCheck))


def fork(end_loops=True):
    """From ``start`` to the left (rate 1) or right (rate 3); on the right two places take turns."""
    builder = (
        NetBuilder("fork")
        .place("start", tokens=1)
        .place("left")
        .place("right")
        .place("far")
        .exponential("go_left", rate=1, inputs="start", outputs="left")
        .exponential("go_right", rate=3, inputs="start", outputs="right")
        .exponential("away", rate=2, inputs="right", outputs="far")
        .exponential("back", rate=4, inputs="far", outputs="right")
    )
    return builder.build()


def test_several_recurrent_classes():
    steady = Analysis(fork()).steady
    assert sorted((len(c.states), round(c.probability, 12)) for c in steady.components) == [
        (1, 0.25),
        (2, 0.75),
    ]
    means = Analysis(fork()).measures.mean_tokens
    assert means == pytest.approx({"start": 0, "left": 0.25, "right": 0.5, "far": 0.25})
    assert Analysis(fork()).measures.throughput["away"] == pytest.approx(0.75 * 4 / 3)


@relaxed
@given(bounded_nets(immediate=False))
def test_small_recurrent_classes_together_and_each_by_itself(net):
    chain = Chain.of(explore(net))
    steady = steady_state(chain)
    assert sum(c.probability for c in steady.components) == pytest.approx(1.0)
    for component in steady.components:
        alone = stationary(chain, component.states)[0].values
        assert component.distribution == pytest.approx(alone, abs=1e-10)
    # The probability to end up in a class, by dense algebra.
    within = np.concatenate([c.states for c in steady.components])
    outside = np.setdiff1d(np.arange(len(chain)), within)
    rates = chain.rates.toarray()
    stays = np.linalg.solve(
        np.diag(chain.exit_rates[outside]) - rates[np.ix_(outside, outside)].T,
        chain.initial[outside],
    )
    for component in steady.components:
        reached = (
            chain.initial[component.states].sum()
            + (stays @ rates[np.ix_(outside, component.states)]).sum()
        )
        assert component.probability == pytest.approx(reached, abs=1e-10)


def test_of_many_recurrent_classes_the_likeliest_are_named():
    data = report(Analysis(endings(5, 40)), Questions(structure=False))
    steady = data["steady_state"]
    assert (steady["component_count"], steady["deadlock_count"], len(steady["components"])) == (
        200,
        200,
        10,
    )
    first = steady["components"][0]
    assert first["deadlock"] and first["marking"] == {"way4": 1, "at0": 1}
    leaving = 5.0 + sum(0.1 + 0.01 * k for k in range(5))
    assert first["probability"] == pytest.approx(0.14 / leaving)
    told = sum(part["probability"] for part in steady["components"])
    assert steady["probability_of_other_components"] == pytest.approx(1 - told)
    loop = NetBuilder().place("a", tokens=1).exponential("t", inputs="a", outputs="a").build()
    (only,) = report(Analysis(loop), Questions())["steady_state"]["components"]
    assert not only["deadlock"]  # it is never left, but something happens there


def test_passages_that_may_never_come():
    passage = Analysis(fork()).first_passage("left == 1", [1.0])
    assert passage.probability == pytest.approx(0.25) and math.isinf(passage.mean_time)
    assert passage.within[0] == pytest.approx(0.25 * (1 - math.exp(-4)))
    assert Analysis(fork()).first_passage("far == 7") == (0.0, math.inf, [], 0.0)
    assert Analysis(fork()).first_passage("start == 1", [0.0]) == (1.0, 0.0, [1.0], 0.0)


def vanishing_cycle(out=1.0):
    """A cycle of immediate transitions with a way out that is taken with probability 1/4 each time
    round."""
    return (
        NetBuilder("cycle")
        .place("a", tokens=1)
        .place("x")
        .place("y")
        .place("b")
        .exponential("start", rate=2, inputs="a", outputs="x")
        .immediate("xy", inputs="x", outputs="y")
        .immediate("yx", weight=3, inputs="y", outputs="x")
        .immediate("out", weight=out, inputs="y", outputs="b")
        .exponential("again", rate=2, inputs="b", outputs="a")
        .build()
    )


def test_cycles_of_immediate_firings_end():
    measures = Analysis(vanishing_cycle()).measures
    assert measures.mean_tokens == pytest.approx({"a": 0.5, "x": 0, "y": 0, "b": 0.5})
    # Once round the net every second; four times through the cycle each time, three of them back.
    assert measures.throughput == pytest.approx(
        {"start": 1, "xy": 4, "yx": 3, "out": 1, "again": 1}
    )


def test_timeless_traps_are_refused():
    net = vanishing_cycle()
    arcs = [arc for arc in net.arcs if "out" not in arc[:2]]
    net = Net(net.places, [t for t in net.transitions if t.name != "out"], arcs)
    with pytest.raises(RefusedError, match="timeless trap.*from \\((x|y): 1\\)"):
        _ = Analysis(net).chain


def test_the_initial_marking_may_vanish():
    net = (
        NetBuilder()
        .place("a", tokens=1)
        .place("b")
        .place("c")
        .immediate("l", weight=1, inputs="a", outputs="b")
        .immediate("r", weight=4, inputs="a", outputs="c")
        .exponential("t", inputs="b", outputs="c")
        .build()
    )
    chain = Chain.of(explore(net))
    assert chain.initial.tolist() == pytest.approx([0.2, 0.8])
    assert Analysis(net).first_passage("a == 0 and b == 0").mean_time == pytest.approx(0.2)


def test_a_condition_that_holds_for_no_time_has_held():
    assert Analysis(vanishing_cycle()).first_passage("y == 1").mean_time == pytest.approx(0.5)


def test_servers():
    def busy(servers):
        net = (
            NetBuilder()
            .place("up", tokens=4)
            .place("down")
            .exponential("fail", rate=1, servers=servers, inputs="up", outputs="down")
            .exponential("mend", rate=1, inputs="down", outputs="up")
            .build()
        )
        chain = Chain.of(explore(net))
        return chain.exit_rates[0]

    assert [busy(s) for s in (1, 3, None)] == [1, 3, 4]


def test_a_multiple_arc_takes_several_tokens_to_a_server():
    net = (
        NetBuilder()
        .place("a", tokens=7)
        .exponential("t", rate=2, servers=None, inputs={"a": 2})
        .build()
    )
    assert Chain.of(explore(net)).exit_rates.tolist() == [6, 4, 2, 0]


@relaxed
@given(bounded_nets())
def test_transients_are_matrix_exponentials(net):
    try:
        chain = Chain.of(explore(net))
    except RefusedError:
        assume(False)
    generator = chain.rates.toarray() - np.diag(chain.exit_rates)
    for found in transient(chain, [0.3, 0.0, 4.0]):
        assert found.distribution == pytest.approx(
            chain.initial @ expm(generator * found.time), abs=1e-10
        )


def transition_probabilities(generator, time):
    """The exponential of generator * time, by squaring that of a short time. Each row is brought back
    to the sum 1, or else rounding errors grow with every square."""
    squares = max(0, math.ceil(math.log2(time * -generator.diagonal().min() + 1)))
    probabilities = expm(generator * (time / 2**squares))
    for _ in range(squares):
        probabilities = probabilities @ probabilities
        probabilities /= probabilities.sum(axis=1, keepdims=True)
    return probabilities


@relaxed
@given(bounded_nets())
def test_steady_states_are_where_time_leads(net):
    try:
        chain = Chain.of(explore(net))
    except RefusedError:
        assume(False)
    steady = steady_state(chain)
    assert steady.distribution.sum() == pytest.approx(1)
    generator = chain.rates.toarray() - np.diag(chain.exit_rates)
    assert steady.distribution @ generator == pytest.approx(np.zeros(len(chain)), abs=1e-12)
    now, late = chain.initial, chain.initial @ transition_probabilities(generator, 3200)
    for doubled in range(1, 40):  # slow chains need longer
        if np.abs(late - now).max() < 1e-9:
            break
        now, late = late, chain.initial @ transition_probabilities(generator, 3200 * 2**doubled)
    assert steady.distribution == pytest.approx(late, abs=1e-6)
    settled = time_to_steady_state(chain, 0.01, steady=steady)
    for time, apart in ((settled * 1.03, True), (settled * 0.9, False)):
        distance = 0.5 * np.abs(chain.initial @ expm(generator * time) - steady.distribution).sum()
        assert settled == 0 or (distance <= 0.0101 if apart else distance >= 0.0099)


@pytest.mark.long
def test_both_sweepers_and_lu_agree(monkeypatch):
    chain = Chain.of(explore(kanban(2)))
    numbers = []
    for size, sweeper in ((2_000, None), (10_000, None), (2_000, linear._scipy_sweeper)):
        monkeypatch.setattr(linear, "DIRECT_SIZE", size)
        if sweeper is not None:
            monkeypatch.setattr(linear, "sweeper", sweeper)
        steady = steady_state(chain)
        assert steady.residual < 1e-12
        numbers.append((steady.method, Measures(chain, steady.distribution).throughput["leave"]))
    assert [method for method, _ in numbers] == ["Gauss-Seidel", "LU", "Gauss-Seidel"]
    for _, value in numbers:
        assert value == pytest.approx(numbers[0][1], rel=1e-11)


@relaxed
@given(bounded_nets())
def test_sweeps_agree_with_lu(net):
    try:
        chain = Chain.of(explore(net))
    except RefusedError:
        assume(False)
    space = chain.graph
    goal = space.column(0) == space.column(0).max()
    exact, passage = steady_state(chain), first_passage(space, goal)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(linear, "DIRECT_SIZE", 0)
        swept, passage_swept = steady_state(chain), first_passage(space, goal)
    assert swept.distribution == pytest.approx(exact.distribution, abs=1e-10)
    assert passage_swept.probability == pytest.approx(passage.probability, abs=1e-9)
    assert passage_swept.mean_time == pytest.approx(passage.mean_time, rel=1e-9)


def test_a_good_order_saves_sweeps():
    chain = Chain.of(explore(polling(6)))
    states = np.arange(len(chain))
    order = sweep_order(chain, states)
    assert sorted(order) == states.tolist()
    plain, ordered = (
        linear._swept_in_order(
            sparse.csr_matrix(chain.rates.T), chain.exit_rates, None, False, by, Watch()
        )
        for by in (None, order)
    )
    assert ordered.sweeps < plain.sweeps
    assert ordered.values == pytest.approx(plain.values, abs=1e-12)


@pytest.mark.parametrize("stages, states", [(3, 4), (7, 3)])
def test_sweeps_are_damped_where_they_only_turn_the_error_around(stages, states):
    """Every jump leads from one stage to the next, and the sweeps meet them in the wrong order."""
    rates = np.zeros((stages, states, stages, states))
    chance = np.random.default_rng(2)
    for stage in range(stages):
        rates[stage, :, (stage + 1) % stages, :] = chance.uniform(size=(states, states))
    rates = rates.reshape(stages * states, stages * states)
    system = sparse.csr_matrix(rates.T), rates.sum(axis=1), None
    found = solve_linear(*system, backward=True, direct=0)
    assert (found.method, found.residual < 1e-12) == ("Gauss-Seidel", True)
    assert found.values == pytest.approx(solve_linear(*system).values, rel=1e-9)


def test_no_other_order_where_that_of_discovery_is_as_good():
    chain = Chain.of(explore(kanban(2)))
    assert sweep_order(chain, np.arange(len(chain))) is None


@pytest.mark.long
def test_mean_times_are_right_where_they_are_long():
    """A queue that is rarely long, with room for 3000. The mean time has a formula."""
    size, up, down = 3000, 1.0, 1.003
    net = (
        NetBuilder()
        .place("free", tokens=size)
        .place("jobs")
        .exponential("arrive", rate=up, inputs="free", outputs="jobs")
        .exponential("serve", rate=down, inputs="jobs", outputs="free")
        .build()
    )
    passage = Analysis(net).first_passage("free == 0")
    ratio, step, expected = down / up, 1 / up, 0.0
    for _ in range(size):
        expected += step
        step = 1 / up + ratio * step
    assert expected > 5e8
    assert passage.residual < 1e-5  # a bound of the relative error
    assert passage.mean_time == pytest.approx(expected, rel=2e-6)


def two_queues(size, fail):
    """Two queues with a load of a half each, and beside them a machine that fails rarely."""
    builder = NetBuilder("queues").place("up", tokens=1).place("down")
    builder.exponential("fail", rate=fail, inputs="up", outputs="down")
    builder.exponential("repair", rate=1.0, inputs="down", outputs="up")
    full = {}
    for queue in ("a", "b"):
        builder.place(queue).place("free_" + queue, tokens=size)
        builder.exponential("to_" + queue, rate=1.0, inputs="free_" + queue, outputs=queue)
        builder.exponential("from_" + queue, rate=2.0, inputs=queue, outputs="free_" + queue)
        full[queue] = size
    return builder.exponential("both_full", rate=1.0, inputs=full, outputs=full).build()


@pytest.mark.parametrize("size", [7, 20, 40])
def test_a_value_that_is_far_smaller_than_the_others_has_its_digits(size):
    analysis = Analysis(two_queues(size, 1e-13))
    assert analysis.measures.mean_tokens["down"] == pytest.approx(1e-13, rel=1e-9)
    assert (analysis.steady.distribution >= 0).all()


def test_what_has_no_digits_is_said_to_be_unsure():
    size = 40
    data = report(Analysis(two_queues(size, 1e-13)), Questions(structure=False))
    steady = data["steady_state"]
    true = (0.5**size / (2 - 0.5**size)) ** 2
    wrong = abs(steady["throughput"]["both_full"] / true - 1)
    assert wrong > 1e-3
    assert list(steady["unsure"]) == ["throughput"]
    assert set(steady["unsure"]["throughput"]) == {"both_full"}
    assert steady["unsure"]["throughput"]["both_full"] > 0.5 * wrong
    assert "unsure: throughput of both_full, by about" in "\n".join(analysis_text(data))
    assert "unsure" not in report(Analysis(two_queues(20, 1e-13)))["steady_state"]


@pytest.mark.parametrize("seed", [0, 16])
def test_stationary_distributions_of_stiff_chains_are_right_in_every_entry(seed):
    generator = np.random.default_rng(seed)
    size = 8
    rates = 10.0 ** generator.uniform(-9, 9, (size, size)) * (generator.random((size, size)) < 0.3)
    rates[np.arange(size), (np.arange(size) + 1) % size] = 10.0 ** generator.uniform(-9, 9, size)
    np.fill_diagonal(rates, 0.0)
    left = [[Fraction(rate) for rate in row] for row in rates.tolist()]
    for k in range(size - 1, 0, -1):  # the states that are left, seen when they are visited
        out = sum(left[k][:k])
        for i in range(k):
            left[i][k] /= out
            for j in range(k):
                left[i][j] += left[i][k] * left[k][j]
    exact = [Fraction(1)]
    for k in range(1, size):
        exact.append(sum(exact[i] * left[i][k] for i in range(k)))
    exact = [float(value / sum(exact)) for value in exact]
    found = solve_linear(sparse.csr_matrix(rates.T), rates.sum(axis=1), None)
    np.testing.assert_allclose(found.values, exact, rtol=1e-13)


def test_an_answer_with_a_bad_residual_is_not_given(monkeypatch):
    monkeypatch.setattr(linear, "DIRECT_SIZE", 0)
    monkeypatch.setattr(linear, "FALLBACK_SIZE", 0)
    monkeypatch.setattr(linear, "MAX_SWEEPS", 4)
    matrix = sparse.csr_matrix(([1.0, 1.0], ([0, 1], [1, 0])), shape=(2, 2))
    with pytest.raises(LimitError, match="was not solved"):
        solve_linear(matrix, np.array([1.0, 1.0 + 1e-6]), np.array([1.0, 0.0]))


@pytest.mark.parametrize("mean", [1e-3, 0.7, 20.0, 900.0, 1e5])
def test_poisson_weights(mean):
    first, weights = poisson(mean)
    counts = np.arange(first, first + len(weights))
    assert weights.sum() == pytest.approx(1)
    assert (weights * counts).sum() == pytest.approx(mean)
    assert (weights * (counts - mean) ** 2).sum() == pytest.approx(mean, rel=1e-6)


def test_waiting_times_and_rewards():
    measures = Analysis(fork()).measures
    assert measures.mean_waiting_time["right"] == pytest.approx(0.5)
    assert math.isinf(measures.mean_waiting_time["left"])
    assert math.isnan(measures.mean_waiting_time["start"])
    assert measures.reward({"far": 8.0}, {"away": 1.0}) == pytest.approx(3.0)
    assert measures.reward(lambda markings: 4.0 * markings[:, 1]) == pytest.approx(1.0)
    assert sorted(1 / measures.sojourn_times) == pytest.approx([0, 2, 4, 4])
    with pytest.raises(UsageError, match="no place 'nowhere'"):
        measures.reward({"nowhere": 1.0})


def test_times_that_make_no_sense():
    chain = Chain.of(explore(fork()))
    with pytest.raises(UsageError, match="duration of -1"):
        Evolution(chain).advance(-1)
    with pytest.raises(UsageError, match="tolerance"):
        time_to_steady_state(chain, 0)
