"""Durations that get fewer phases than they need, and the intervals of the answers that follow."""

import csv
import json

import numpy as np
import pytest
from test_run_analysis import plan_of

from gspn_framework_package.analysis import intervals
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.intervals import steady_intervals
from gspn_framework_package.analysis.monitoring.prediction import Parameters
from gspn_framework_package.analysis.queries.answers import answer_query
from gspn_framework_package.analysis.report import Questions, report
from gspn_framework_package.analysis.sweeps.variation import read_variation, varied
from gspn_framework_package.cli.main import main
from gspn_framework_package.cli.queries import query_lines
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration, Evidence
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.run_net.phases import number_of_phases, phases_of

KINDS = {
    "tiny and constant": Duration.deterministic(1e-6),
    "constant": Duration.deterministic(2.0),
    "almost constant": Duration.gamma(15_000.0, 0.5),
    "less than exponential": Duration.gamma(7.5, 1.3),
    "many phases": Duration.erlang(12, 0.8),
    "more than exponential": Duration.gamma(0.4, 0.7),
    "heavy tail": Duration.lognormal(1.8, 1.5),
    "mixture": Duration.hyper_erlang([(0.8, 3, 0.4), (0.2, 2, 3.0)]),
    "two values": Duration.empirical([0.1] * 50 + [0.11] + [4.0] * 50),
    "uniform": Duration.uniform(0.2, 1.4),
}


@pytest.mark.parametrize("most", [0.5, 1, 2, 3, 7])
@pytest.mark.parametrize("duration", KINDS.values(), ids=KINDS)
def test_fewer_phases_have_the_mean_and_the_nearest_variance(duration, most):
    phases = phases_of(duration, most)
    assert len(phases.rates) == number_of_phases(duration, most) <= max(most, 2)
    used = phases.duration
    assert used.mean == pytest.approx(duration.mean, rel=1e-9)
    nearest = 1.0 if most == 1 else max(duration.variation**2, 1 / most)
    assert used.variation**2 == pytest.approx(nearest, rel=1e-6)
    times = np.concatenate([d.quantile(np.linspace(0.0, 0.9999, 4_001)) for d in (duration, used)])
    largest = np.abs(duration.cdf(times) - used.cdf(times)).max()
    assert phases.distance(duration) == pytest.approx(largest, abs=2e-3)


def interrupted(duration, rate=0.8):
    """A robot whose action is interrupted at a rate, and begins again."""
    net = (
        NetBuilder("interrupted")
        .place("Work", 1)
        .place("Rest")
        .exponential("done", inputs="Work", outputs="Rest")
        .exponential("alarm", rate=rate, inputs="Work", outputs="Rest")
        .exponential("back", rate=1.0, inputs="Rest", outputs="Work")
        .build()
    )
    return plan_of(net, {"Work": duration}, events={"alarm": EventSource(function="actions.work")})


@pytest.mark.parametrize("most", [1, 2, 6])
@pytest.mark.parametrize("duration", KINDS.values(), ids=KINDS)
def test_the_interval_contains_what_the_duration_itself_gives(duration, most):
    """A robot works for E[min(T, alarm)] = (1 - E[exp(-rate T)]) / rate, and is done with
    probability E[exp(-rate T)]."""
    plan, rate = interrupted(duration), 0.8
    analysis = Analysis(plan, phases=most)
    questions = Questions(at=(1.0,), mean_time_to=("Rest == 1",))
    data = report(analysis, questions)
    steps = np.linspace(0.0, 1.0, 40_001)
    times = duration.quantile((steps[:-1] + steps[1:]) / 2)
    done = np.exp(-rate * times).mean()
    works = (1 - done) / rate
    spans = data.get("intervals")
    if spans is None:  # represented exactly, or as no time
        assert data["mean_time_to"][0]["mean_time"] == pytest.approx(works, rel=1e-4, abs=2e-6)
        return
    low, high = spans["mean_time_to.0"]["mean_time"]
    assert low - 1e-9 <= works <= high + 1e-9
    low, high = spans["steady_state.throughput"]["done"]
    assert low - 1e-9 <= done / (works + 1) <= high + 1e-9
    low, high = spans["steady_state.mean_tokens"]["Work"]
    assert low - 1e-9 <= works / (works + 1) <= high + 1e-9


def two_roads(durations):
    """Three robots take a long road and a short one, one after the other."""
    net = NetBuilder("two_roads").place("Long", 3).place("Short")
    net.exponential("there", inputs="Long", outputs="Short")
    net.exponential("back", inputs="Short", outputs="Long")
    return plan_of(net.build(), durations)


def analysed(tmp_path, capsys, plan, *words):
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(plan_to_json(plan)))
    code = main(["analyse", str(path), "--no-structure", *words])
    return code, capsys.readouterr()


def test_a_time_that_is_tiny_beside_the_others_takes_none(tmp_path, capsys):
    tiny, constant = Duration.deterministic(1e-6), Duration.deterministic(2.0)
    plan = two_roads({"Long": constant, "Short": tiny})
    code, printed = analysed(tmp_path, capsys, plan, "--json")
    data = json.loads(printed.out)
    used = " ".join(data["timing"]["assumptions"])
    assert code == 0
    assert "Short (deterministic, mean 1e-06 s) counts as 0, since it is tiny" in used
    assert "mean 2 s) was replaced by phases of the same mean: Erlang with 28 phases, vari" in used
    low, high = data["intervals"]["steady_state.throughput"]["there"]
    assert low - 1e-6 <= 3 / (2.0 + 1e-6) <= high + 1e-6
    code, printed = analysed(tmp_path, capsys, plan, "--phases", "2")
    assert code == 0
    assert "Erlang with 2 phases, variation 0.707 instead of 0; their distributions" in printed.out
    assert "in brackets: " in printed.out


def test_no_intervals_where_durations_are_phases_and_bad_numbers_are_refused(tmp_path, capsys):
    plan = two_roads({"Long": Duration.erlang(3, 2.0), "Short": Duration.exponential(1.0)})
    code, printed = analysed(tmp_path, capsys, plan, "--json")
    assert code == 0
    assert "intervals" not in json.loads(printed.out)
    for words in (["--phases", "0"], ["--only-net", "--phases", "3"]):
        code, printed = analysed(tmp_path, capsys, plan, *words)
        assert (code, printed.err.count("\n")) == (2, 1), printed.err


def test_what_shows_numbers_says_that_durations_are_replaced(tmp_path, capsys):
    plan = interrupted(Duration.deterministic(2.0))
    query = ["--phases", "4", "--query", "S=? [ Work = 1 ]", "--query", "S>=0.5 [ Work = 1 ]"]
    code, printed = analysed(tmp_path, capsys, plan, *query, "--json")
    number, bound = json.loads(printed.out)["queries"]
    assert number["interval_sources"] == ["durations are replaced"]
    low, high = number["interval"]
    works = (1 - np.exp(-0.8 * 2.0)) / 0.8
    assert low < works / (works + 1) < high < low + 0.2 and low < number["value"] < high
    assert (code, bound["holds"], bound["undecided"]) == (
        1,
        None,
        "the interval contains the bound",
    )
    path, said = (
        str(tmp_path / "plan.json"),
        "was replaced by phases of the same mean: Erlang with 3",
    )
    for words in (
        ["plot", path, "-o", str(tmp_path / "a.png"), "--time", "3", "--points", "3"],
        ["convert", path, str(tmp_path / "a.drn")],
        ["convert", path, str(tmp_path / "a.jani"), "--run-net"],
        ["explain", path, "--run-net"],
        ["draw", path, "-o", str(tmp_path / "a.dot"), "--what", "chain"],
    ):
        assert main([*words, "--phases", "3"]) == 0
        assert said in capsys.readouterr().err, words
        assert main([*words, "--phases", "0"]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_tables_have_the_intervals(tmp_path, capsys):
    plan, file = interrupted(Duration.deterministic(2.0)), tmp_path / "a.csv"
    done = np.exp(-0.8 * 2.0)
    truth = done / ((1 - done) / 0.8 + 1)
    code, _ = analysed(tmp_path, capsys, plan, "--csv", str(file), "--mean-time-to", "Rest=1")
    rows = {(measure, name): rest for measure, name, *rest in csv.reader(file.open())}
    assert (code, rows["measure", "name"]) == (0, ["value", "low", "high"])
    value, low, high = map(float, rows["steady_state throughput", "done"])
    assert low <= truth <= high and low < value < high
    value, low, high = map(float, rows["mean_time_to", "Rest=1"])
    assert low <= (1 - done) / 0.8 <= high and low < value < high
    assert rows["places", ""] == ["2", "", ""]
    words = ["--vary", "rate:alarm=0.8", "--exact", "--measure", "done", "--output", str(file)]
    assert main(["sweep", str(tmp_path / "plan.json"), *words]) == 0
    assert "durations are replaced" in capsys.readouterr().err
    (row,) = csv.DictReader(file.open())
    mean, half = float(row["mean"]), float(row["half_width"])
    assert 0 < half < 0.1 and mean - half <= truth <= mean + half


def test_a_sweep_has_as_many_phases_as_asked_for(tmp_path, capsys):
    plan, path, table = interrupted(Duration.deterministic(2.0)), tmp_path / "plan.json", "a.csv"
    asked = ["--vary", "rate:alarm=0.8", "--exact", "--measure", "done", "--json"]
    asked += ["--output", str(tmp_path / table)]
    for words in (["--phases", "3"], ["--phases", "9"], []):
        _, printed = analysed(tmp_path, capsys, plan, "--json", *words)
        mean = json.loads(printed.out)["steady_state"]["throughput"]["done"]
        assert main(["sweep", str(path), *asked, *words]) == 0
        found = json.loads(capsys.readouterr().out)
        (point,) = found["points"]
        assert point["measures"]["throughput"]["done"]["mean"] == pytest.approx(mean, rel=1e-9)
        assert found["kept"] == 0  # a point with other phases is another one
    for words in (["--exact", "--phases", "0"], ["--phases", "3"]):
        assert main(["sweep", str(path), "--vary", "rate:alarm=0.8", *words]) == 2
        assert capsys.readouterr().err.count("\n") == 1


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """A plan of two roads, and what was learned from a minute of it: two plan files."""
    folder = tmp_path_factory.mktemp("learned")
    durations = {"Long": Duration.gamma(30.0, 2.0), "Short": Duration.exponential(1.0)}
    true, log, fitted = (str(folder / name) for name in ("true.json", "run.jsonl", "fitted.json"))
    with open(true, "w", encoding="utf-8") as file:
        json.dump(plan_to_json(two_roads(durations)), file)
    assert main(["simulate", true, "--time", "60", "--seed", "2", "--log", log]) == 0
    assert main(["fit", true, log, "-o", fitted]) == 0
    return true, fitted


SOURCES = "durations are replaced and the logs that values were learned from are short"


def test_half_widths_of_sweeps_hold_phases_and_logs(learned, tmp_path, capsys):
    true, fitted = learned
    capsys.readouterr()
    table = str(tmp_path / "a.csv")
    asked = ["--vary", "robots=2..3", "--exact", "--phases", "4", "--measure", "there", "--json"]
    for kept in (0, 2):  # the second time from the store
        assert main(["sweep", fitted, *asked, "--output", table]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["kept"] == kept
        assert "the intervals take into account that " + SOURCES in found["notes"]
        for point in found["points"]:
            pace = point["measures"]["throughput"]["there"]
            truth = point["values"]["robots"] / 3.0  # a round takes 3 s
            assert 0 < pace["half_width"] < 0.5 * truth
            assert abs(pace["mean"] - truth) <= pace["half_width"]
    assert main(["analyse", fitted, "--phases", "4", "--no-structure", "--json"]) == 0
    low, high = json.loads(capsys.readouterr().out)["intervals"]["steady_state.throughput"]["there"]
    assert high - low == pytest.approx(2 * pace["half_width"], rel=1e-6)
    assert main(["simulate", true, "--time", "500", "--replications", "20", "--json"]) == 0
    simulated = json.loads(capsys.readouterr().out)["throughput"]["there"]["mean"]
    assert low <= simulated <= high


def test_a_value_that_a_sweep_gives_is_not_uncertain(learned, capsys):
    plan = read_plan(learned[1])
    given, words = plan, ["duration:Long=2", "duration:Short=1"]
    assert {name for key, name in plan.evidence if key == "durations"} == {"Long", "Short"}
    for text in words:
        variation = read_variation(text)
        given = varied(given, [variation], variation.values, {})
    assert not [key for key, _ in given.evidence if key == "durations"]


def test_intervals_of_learned_values_follow_a_factor(learned):
    plan = read_plan(learned[1])

    def relative(factor):
        """The half width, relative to its mean and to what the times change of it."""
        changed = Parameters({"Short": factor}, {}, {}, {}).apply(plan)
        tokens = steady_intervals(Analysis(changed, phases=1))[0]["mean_tokens"]
        mean, half = tokens["Short"]
        return half / mean / tokens["Long"][0]

    evidence = plan.evidence["durations", "Short"]
    assert Evidence(3, (), None).scaled(2.0).interval is None
    assert evidence.scaled(2.0).interval == tuple(2 * end for end in evidence.interval)
    assert relative(0.8) == pytest.approx(relative(1.0), rel=0.01)


def test_an_interval_that_was_not_computed_is_not_known(learned, monkeypatch):
    analysis = Analysis(read_plan(learned[1]), phases=4)
    monkeypatch.setattr(intervals, "_DRAWN_STATES", 7 * 4)
    found, notes = steady_intervals(analysis)
    assert "how short the logs are is left out" in notes[1]
    assert notes[0] == "the intervals take into account that durations are replaced"
    query = answer_query(analysis, "S=? [ Short >= 1 ]")
    assert query.left_out == notes[1] and notes[1] in "".join(query_lines([query], {}))

    def refuse(other):
        raise LimitError("not solved")

    here = {"throughput": analysis.measures.throughput}
    monkeypatch.undo()
    widths = intervals.half_widths(analysis, here, refuse).widths
    assert set(widths["throughput"].values()) == {np.inf}


def test_short_logs_make_intervals_wider(tmp_path, capsys):
    widths = []
    for observations in (10, 1_000):
        plan = two_roads({"Long": Duration.exponential(2.0), "Short": Duration.erlang(2, 1.0)})
        data = plan_to_json(plan)
        for duration in data["durations"].values():
            duration["of"] = {"observations": observations, "logs": ["a.jsonl"]}
        path = tmp_path / "learned.json"
        path.write_text(json.dumps(data))
        assert main(["analyse", str(path), "--no-structure", "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["interval_sources"] == ["the logs that values were learned from are short"]
        low, high = found["intervals"]["steady_state.throughput"]["there"]
        assert low < found["steady_state"]["throughput"]["there"] < high
        widths.append(high - low)
    assert 5 < widths[0] / widths[1] < 20  # sqrt(100), but for chance in the draws
