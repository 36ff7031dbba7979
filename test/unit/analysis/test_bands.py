"""Plots show the intervals of their curves and bars, as the report has them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from test_few_phases import SOURCES, interrupted, learned, two_roads  # noqa: F401 (a fixture)

from gspn_framework_package.analysis import intervals
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.report import Questions, report
from gspn_framework_package.analysis.report_rows import rows
from gspn_framework_package.analysis.simulation import simulate
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.duration import Duration, Evidence
from gspn_framework_package.model.errors import LimitError

plot = pytest.importorskip("gspn_framework_package.cli.plot")
pytest.importorskip("matplotlib")

TIMES = [0.0, 1.5, 3.0, 4.5, 6.0]


@pytest.fixture(name="plans")
def _plans(learned):  # noqa: F811
    return [read_plan(path) for path in learned]


def drawn(analysis, what, **asked):
    """The axes of a plot at ``TIMES``, and low and high of each of its bands there."""
    (axes,) = plot.figure_of(analysis, what, time=6.0, points=5, **asked).axes
    bands = []
    for band in axes.collections:
        ends = {}
        for x, y in band.get_paths()[0].vertices:
            ends.setdefault(float(x), []).append(float(y))
        bands.append([(min(ends[t]), max(ends[t])) for t in TIMES])
    return axes, bands


@pytest.mark.long
def test_bands_are_the_intervals_of_the_report_and_contain_what_is_simulated(plans, tmp_path):
    true, fitted = plans
    questions = Questions(at=tuple(TIMES), mean_time_to=("Short == 2",))
    data = json.loads(json.dumps(report(Analysis(fitted, phases=4), questions)))
    spans = data["intervals"]
    for what, key, name in (
        ("tokens", "mean_tokens", "Short"),
        ("throughput", "throughput", "back"),
    ):
        axes, (band,) = drawn(Analysis(fitted, phases=4), what, only=[name])
        assert SOURCES in axes.get_xlabel().replace("\n", " ")
        told = [spans["transient.%d.%s" % (i, key)][name] for i in range(len(TIMES))]
        assert np.allclose(band, told, rtol=1e-6, atol=1e-9)
    for i in (2, 4):
        low, high = spans["transient.%d.mean_tokens" % i]["Short"]
        then = simulate(true, time=TIMES[i] + 0.02, warmup=TIMES[i] - 0.02, replications=2000)
        assert 0 < low <= then.mean_tokens["Short"].mean <= high < 3
        shares = data["transient"][i]["token_distribution"]["Short"]
        for count, (low, high) in spans["transient.%d.token_distribution.Short" % i].items():
            assert 0 <= low < shares[count] < high <= 1
            share = then.token_distribution["Short"].get(int(count), 0.0)
            off = 2 * np.sqrt(share * (1 - share) / 2000)  # of the simulated share itself
            assert low - off <= share <= high + off
    axes, (band,) = drawn(Analysis(fitted, phases=4), "passage", condition="Short == 2")
    told = [spans["mean_time_to.0"]["within.%d" % n] for n in range(len(TIMES))]
    assert np.allclose(band, told, rtol=1e-6, atol=1e-9)
    assert SOURCES in axes.get_xlabel().replace("\n", " ")
    low, high = {
        name: ends
        for measure, name, _, *ends in rows(data)
        if measure == "steady_state probability of 2 tokens"
    }["Short"]
    assert [low, high] == spans["steady_state.token_distribution.Short"]["2"]


@pytest.mark.long
def test_bars_of_the_steady_state_have_lines(plans):
    analysis = Analysis(plans[1], phases=4)
    (axes,) = plot.figure_of(analysis, "distribution").axes
    lines = [line for bars in axes.collections for line in bars.get_segments()]
    spans = report(analysis, Questions(structure=False))["intervals"]
    low, high = spans["steady_state.token_distribution.Short"]["0"]
    assert any(np.allclose(line[:, 0], (low, high)) for line in lines)
    assert SOURCES in axes.get_xlabel().replace("\n", " ")


def test_curves_that_coincide_have_one_band():
    from matplotlib.figure import Figure

    axes = Figure().add_subplot()
    plot._band(axes, [0, 1], [[[0.0, 1.0], [0.0, 2.0]], [[0.5, 3.0], None]], "C0")
    (band,) = axes.collections
    assert band.get_paths()[0].vertices[:, 1].max() == 3.0
    assert band.get_paths()[0].vertices[:, 0].max() == 0.0  # at 1 it is not known


def test_exact_curves_have_no_bands_and_what_is_not_known_is_said(monkeypatch):
    plan = two_roads({"Long": Duration.erlang(3, 2.0), "Short": Duration.exponential(1.0)})
    axes, bands = drawn(Analysis(plan), "tokens")
    assert (axes.get_xlabel(), bands) == ("time [s]", [])
    monkeypatch.setattr(intervals, "_DRAWN_STATES", 7)
    analysis = Analysis(replace(plan, evidence={("durations", "Long"): Evidence(50)}))
    axes, bands = drawn(analysis, "tokens")
    assert not bands and axes.get_xlabel().startswith(
        "time [s]\nhow short the logs are is left out"
    )
    assumed = report(analysis, Questions(structure=False))["timing"]["assumptions"]
    assert assumed[-1].startswith("how short the logs are is left out")
    assert not any("left out" in text for text in analysis.timing.assumptions)
    at = Analysis.at
    plan = interrupted(Duration.deterministic(2.0))
    analysis = Analysis(plan, phases=4)

    def refused(of, times):
        if of is not analysis:
            raise LimitError("too long")
        return at(of, times)

    monkeypatch.setattr(Analysis, "at", refused)
    axes, bands = drawn(analysis, "tokens")
    assert not bands and "where no band or line is, it is not known" in axes.get_xlabel()


def test_the_report_says_that_intervals_will_come(plans):
    first = []
    data = report(
        Analysis(plans[1], phases=4), Questions(structure=False), lambda d: first.append({**d})
    )
    assert "intervals" not in first[0] and "intervals" in data
    assert first[0]["interval_sources"] == data["interval_sources"] == SOURCES.split(" and ")


def test_a_sweep_marks_points_whose_interval_is_not_known(learned, tmp_path, monkeypatch):  # noqa: F811
    from gspn_framework_package.cli import sweep_figure

    figures = []
    made = sweep_figure.sweep_figure
    monkeypatch.setattr(
        "gspn_framework_package.cli.sweep.sweep_figure",
        lambda *given: figures.append(made(*given)) or figures[0],
    )
    words = ["--replications", "1", "--time", "10", "--measure", "there"]
    picture = str(tmp_path / "a.png")
    assert main(["sweep", learned[1], "--vary", "robots=1..2", *words, "--plot", picture]) == 0
    (axes,) = figures[0].axes
    assert axes.get_xlabel() == "robots\n○: the interval is not known"
