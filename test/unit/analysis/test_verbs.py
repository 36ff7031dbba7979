"""``gspn analyse``, ``simulate``, ``plot`` and ``check`` as one calls them."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.nets import kanban, philosophers
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.report_measures import Part, keys_of
from gspn_framework_package.cli import analyse
from gspn_framework_package.cli.main import main
from gspn_framework_package.cli.plot import alike
from gspn_framework_package.formats import write_net
from gspn_framework_package.model.builder import NetBuilder

PLANS = Path(__file__).parents[3] / "plans"


@pytest.fixture
def run(capsys):
    def call(*words):
        code = main([str(word) for word in words])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


@pytest.fixture
def saved(tmp_path):
    def save(net):
        path = tmp_path / ("%s.pnpro" % net.name)
        write_net(net, path)
        return path

    return save


def test_the_json_of_a_net(run, saved):
    code, out, err = run("analyse", saved(kanban(1)), "--json", "--servers", "single")
    assert (code, err) == (0, "")
    data = json.loads(out)
    assert (data["kind"], data["places"], data["transitions"]) == ("net", 16, 16)
    assert data["states"] == {"total": 160, "tangible": 160, "vanishing": 0, "arcs": 616}
    assert data["bounded"] is True and set(data["bounds"].values()) == {1} and data["k_safe"] == 1
    assert data["deadlocks"] == {"count": 0, "witness": None, "marking": None}
    assert data["live"] is True and set(data["liveness"].values()) == {"L4"}
    assert data["reversible"] is True and data["conservative"] is True
    assert len(data["place_invariants"]) == 6
    assert {"weights": {"free1": 1, "machine1": 1, "rework1": 1, "out1": 1}, "value": 1} in data[
        "place_invariants"
    ]
    assert {"weights": {"fail1": 1, "back1": 1}} in data["transition_invariants"]
    assert len(data["siphons"]) == 6 and all(s["marked"] for s in data["siphons"] + data["traps"])
    steady = data["steady_state"]
    assert steady["throughput"]["leave"] == pytest.approx(0.0925846346, abs=5e-11)
    assert sum(steady["token_distribution"]["out4"].values()) == pytest.approx(1)
    assert steady["mean_tokens"]["out4"] == pytest.approx(steady["token_distribution"]["out4"]["1"])
    assert steady["residual"] < 1e-12
    assert data["undecided"] == {}


def test_what_is_left_out_is_null_and_says_so(run, saved):
    whole = json.loads(run("analyse", saved(kanban(1)), "--json")[1])
    part = json.loads(run("analyse", saved(kanban(1)), "--json", "--no-structure", "--no-time")[1])
    assert part.keys() == whole.keys()
    left_out = {key for key in whole if part[key] is None}
    keys = keys_of(Part.STRUCTURE, Analysis(kanban(1)))
    assert left_out == part["undecided"].keys() == {*keys, "steady_state"}


def test_questions(run, saved):
    code, out, _ = run(
        "analyse",
        saved(philosophers(4)),
        "--json",
        "--no-structure",
        "--at",
        1,
        5,
        "--reach",
        "deadlock",
        "--reach",
        "eat1 + eat2 + eat3 + eat4 == 3",
        "--cover",
        "eat1=1,eat3=1",
        "--mean-time-to",
        "deadlock",
        "--time-to-steady-state",
        "--reward",
        "eat1=2",
        "--reward",
        "put1=1",
    )
    data = json.loads(out)
    assert code == 0 and data["siphons"] is None
    assert [r["reachable"] for r in data["reach"]] == [True, False]
    assert sorted(data["reach"][0]["witness"]) == ["take_left%d" % i for i in range(1, 5)]
    assert data["reach"][0]["marking"] == {"left%d" % i: 1 for i in range(1, 5)}
    assert data["cover"][0]["coverable"] is True
    (mean,) = data["mean_time_to"]
    assert mean["mean_time"] == pytest.approx(550 / 101) and mean["probability"] == 1
    assert [w["time"] for w in mean["within"]] == [1.0, 5.0]
    assert [t["time"] for t in data["transient"]] == [1.0, 5.0]
    assert data["time_to_steady_state"] > 5
    assert data["steady_state"]["reward"] == 0
    assert data["transient"][0]["reward"] > 0


@pytest.mark.long
def test_a_plan_is_analysed_under_its_policy(run):
    _, out, _ = run("analyse", PLANS / "measure", "--json")
    plan = json.loads(out)
    _, out, _ = run("analyse", PLANS / "measure", "--only-net", "--json")
    net = json.loads(out)
    assert (plan["kind"], net["kind"]) == ("plan", "net")
    assert (
        plan["left_out"] == ["P3"]
        and plan["bounds"]["P3"] == "infinite"
        and plan["bounded"] is False
    )
    assert plan["steady_state"]["throughput"] != net["steady_state"]["throughput"]
    assert plan["undecided"].keys() == {"steady_state.mean_tokens.P3"}


def test_what_is_not_decided_is_null_with_its_reason(run, saved):
    net = (
        NetBuilder("growing")
        .place("a", tokens=1)
        .place("heap")
        .place("free")
        .place("end")
        .exponential("add", inputs="a", outputs=["a", "heap"])
        .exponential("take", inputs={"heap": 2})
        .immediate("x", weight=0, inputs="free", outputs="end")
        .immediate("y", weight=0, inputs="free")
        .build()
    )
    code, out, _ = run("analyse", saved(net), "--json", "--limit", 200, "--reach", "end >= 1")
    data = json.loads(out)
    assert code == 1 and data["bounded"] is False and data["bounds"]["heap"] == "infinite"
    for key in ("states", "liveness", "reversible", "steady_state"):
        assert data[key] is None and data["undecided"][key]
    assert data["deadlocks"]["count"] == 0 and data["reach"][0]["reachable"] is False, "by proofs"
    code, out, _ = run(
        "analyse", saved(net), "--json", "--limit", 200, "--reach", "heap * a >= 999"
    )
    data = json.loads(out)
    assert data["reach"][0]["reachable"] is None and "reach.heap * a >= 999" in data["undecided"]
    assert data["dead_transitions"] == ["x", "y"] and data["live"] is False


def test_nobody_decides(run, saved):
    net = (
        NetBuilder("open")
        .place("a", tokens=1)
        .place("b")
        .immediate("x", weight=0, inputs="a", outputs="b")
        .immediate("y", weight=0, inputs="a", outputs="b")
        .build()
    )
    code, out, _ = run("analyse", saved(net), "--json")
    data = json.loads(out)
    assert code == 1 and data["steady_state"] is None
    assert "no weights decide between x, y" in data["undecided"]["steady_state"]


def test_a_timeless_trap_is_no_answer(run, saved):
    net = (
        NetBuilder("trap")
        .place("a", tokens=1)
        .place("b")
        .place("c")
        .exponential("in", inputs="a", outputs="b")
        .immediate("there", inputs="b", outputs="c")
        .immediate("back", inputs="c", outputs="b")
        .build()
    )
    code, out, _ = run("analyse", saved(net))
    assert code == 1 and "not decided: steady_state: a timeless trap" in out
    assert run("analyse", saved(net), "--no-time")[0] == 0


def test_invariants_prove_a_net_bounded_that_is_too_large_also_without_structure():
    analysis = Analysis(kanban(2), limits=Limits(states=100, tree=10), structure=False)
    assert not analysis.space.complete
    assert analysis.boundedness.bounded is True
    assert set(analysis.boundedness.bounds.values()) == {2}


def test_text_and_csv(run, saved, tmp_path):
    code, out, _ = run(
        "analyse", saved(kanban(1)), "--csv", tmp_path / "numbers.csv", "--servers", "single"
    )
    assert code == 0
    assert "states: 160 (160 tangible, 0 vanishing), 616 arcs" in out
    assert "live: yes, reversible: yes" in out
    with (tmp_path / "numbers.csv").open(newline="") as file:
        rows = {(row["measure"], row["name"]): row["value"] for row in csv.DictReader(file)}
    assert float(rows["steady_state throughput", "leave"]) == pytest.approx(0.0925846346, abs=5e-11)


def test_home_states_and_reversible_say_what_they_are_of(run):
    code, out, _ = run("analyse", PLANS / "measure", "--no-structure", "--no-time")
    assert code == 0
    assert "live: yes, reversible: no (without P3: yes)\nhome states without P3: 8\n" in out
    data = json.loads(run("analyse", PLANS / "measure", "--json")[1])
    assert data["reversible"] is False
    assert (data["home_states"]["count"], data["home_states"]["without"]) == (
        data["states"]["total"],
        ["P3"],
    )


def test_a_counter_that_nothing_feeds_does_not_keep_a_plan_from_its_beginning(run, tmp_path):
    net = {
        "places": [
            {"name": "A", "tokens": 1},
            {"name": "B"},
            {"name": "Never"},
            {"name": "Count", "tokens": 3},
        ],
        "transitions": [{"name": t, "timed": True, "rate": 1} for t in ("go", "back", "count")],
        "arcs": [
            {"from": "A", "to": "go"},
            {"from": "go", "to": "B"},
            {"from": "B", "to": "back"},
            {"from": "back", "to": "A"},
            {"from": "Never", "to": "count"},
            {"from": "count", "to": "Never"},
            {"from": "count", "to": "Count"},
        ],
    }
    plan = {"plan": "idle", "net": net, "resource_places": ["Count"], "robots": {"robot_1": "A"}}
    plan["actions"] = {"A": None, "B": None, "Never": None}
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    code, out, _ = run("analyse", tmp_path, "--no-structure", "--no-time")
    assert code == 0 and "left out, because it is never read: Count" in out
    assert "reversible: yes" in out


def test_a_reason_is_reported_once_with_what_it_concerns(run):
    words = (
        "--limit",
        100,
        "--no-structure",
        "--reach",
        "deadlock",
        "--mean-time-to",
        "deadlock",
        "--at",
        1,
    )
    code, out, _ = run("analyse", PLANS / "patrol", *words)
    lines = out.splitlines()
    told = [line for line in lines if "raise --limit" in line]
    assert code == 1 and len(told) == 1, out
    concerned = re.match("not decided: ([^:]*): within 104 states", told[0]).group(1).split(", ")
    assert concerned == [
        "states",
        "live",
        "liveness",
        "dead_transitions",
        "reversible",
        "home_states",
        "steady_state",
        "transient",
        "mean_time_to.deadlock",
    ]
    assert lines[-1].startswith("gspn simulate can estimate")
    assert (
        "gspn simulate"
        not in run("analyse", PLANS / "patrol", "--limit", 100, "--no-structure", "--no-time")[1]
    )
    assert (
        "gspn simulate"
        not in run("analyse", PLANS / "measure", "--limit", 100, "--no-structure")[1]
    )


def test_conservative_says_what_is_counted(run):
    _, analysed, _ = run("analyse", PLANS / "measure", "--no-time")
    assert "by structure, with the tokens of all places: conservative no" in analysed
    assert (
        "(resource places count too; gspn check says whether robots are created or destroyed)"
        in analysed
    )
    _, checked, _ = run("check", PLANS / "measure")
    assert "every transition moves as many robots in as out, ignoring resource places" in checked


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--reach", "nowhere > 0"], "there is no place 'nowhere'"),
        (["--reach", "free1 >"], "was expected at the end"),
        (["--mean-time-to", "free1"], "is a number, not a condition"),
        (["--cover", "free1"], "expected NAME=NUMBER"),
        (["--cover", "free1=0.5"], "must be a non-negative integer"),
        (["--cover", "nowhere=1"], "there is no place 'nowhere'"),
        (["--reward", "nowhere=1"], "there is no transition 'nowhere'"),
        (["--at", "-1"], "at least 0"),
        (["--limit", "0"], "--limit 0: a limit must be greater than 0"),
        (["--time-to-steady-state", "2"], "tolerance of 2"),
        (["--robots", "2"], "for plans"),
    ],
)
def test_wrong_usage_is_one_clear_message(run, saved, words, message):
    code, out, err = run("analyse", saved(kanban(1)), *words)
    assert code == 2 and out == "" and message in err and len(err.splitlines()) == 1


def test_simulate_a_plan_as_it_runs(run, tmp_path):
    words = ["simulate", PLANS / "rendezvous", "--time", 40]
    code, out, err = run(*words, "--precision", 0.1, "--measure", "Hand_Over")
    assert code == 0 and "relative precision: 0.0" in out and "exponential times" in err
    code, out, _ = run(*words, "--batches", 5, "--json")
    data = json.loads(out)
    assert (code, data["batches"], data["replications"], data["timing"]) == (0, 5, 1, "run")
    assert any("exponential times" in note for note in data["notes"])
    code, out, _ = run(*words, "--replications", 30, "--json", "--losses", 0.1)
    lost = json.loads(out)["throughput"]["Hand_Over"]["mean"]
    code, out, _ = run(*words, "--replications", 30, "--json", "--timing", "net")
    assert lost < json.loads(out)["throughput"]["Hand_Over"]["mean"]
    log = tmp_path / "run.jsonl"
    for option in (["--batches", 5], ["--precision", 0.1], ["--timing", "net"]):
        code, _, err = run(*words, "--log", log, *option)
        assert code == 2 and "--log records" in err and not log.exists()


def test_simulate(run, saved, tmp_path):
    words = [
        "simulate",
        saved(kanban(1)),
        "--servers",
        "single",
        "--time",
        200,
        "--warmup",
        100,
        "--replications",
        50,
    ]
    code, out, _ = run(*words, "--json", "--seed", 4, "--csv", tmp_path / "runs.csv")
    data = json.loads(out)
    assert code == 0 and data["seed"] == 4 and data["replications"] == 50
    leave = data["throughput"]["leave"]
    assert abs(leave["mean"] - 0.0925846346) < 3 * leave["half_width"]
    assert run(*words, "--json", "--seed", 4)[1] == out
    assert "intervals of 95 % confidence" in run(*words)[1]
    code, _, err = run("simulate", saved(kanban(1)))
    assert code == 2 and "how long is a run" in err
    code, out, _ = run(
        "simulate", PLANS / "measure", "--until", "P3 >= 2", "--json", "--replications", 20
    )
    assert json.loads(out)["reached"]["mean"] == 1.0 and json.loads(out)["time"] is None


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["--what", "throughput", "--only", "Fetched"],
        ["--what", "distribution"],
        ["--what", "passage", "--condition", "Low == 1", "--time", "5"],
    ],
)
def test_plot(run, tmp_path, words):
    pytest.importorskip("matplotlib", reason="plots are optional")
    code, _, err = run(
        "plot", PLANS / "rendezvous", "-o", tmp_path / "picture.svg", "--points", 5, *words
    )
    assert (code, err) == (0, "")
    assert "<svg" in (tmp_path / "picture.svg").read_text()


def test_curves_that_are_one_are_drawn_once():
    times = np.linspace(0.0, 1.0, 9)
    groups = alike(
        {"a": times, "b": 1 - times, "c": times + 1e-6, "d": times * 0.9, "e": 1 - times}
    )
    assert groups == [["a", "c"], ["b", "e"], ["d"]]


def test_every_curve_of_a_plot_can_be_told_apart(run, tmp_path, saved):
    pytest.importorskip("matplotlib", reason="plots are optional")
    builder = NetBuilder("many").place("start", tokens=1)
    for i in range(30):
        builder.place("p%d" % i).exponential(
            "t%d" % i, rate=1.0 + i, inputs="start", outputs="p%d" % i
        )
    path = tmp_path / "picture.svg"
    code, _, err = run("plot", saved(builder.build()), "-o", path, "--points", 5)
    assert code == 0 and "matplotlib" not in err and "Warning" not in err
    lines = re.findall(
        r'<g id="line2d_\d+">\s*<path d="[^"]*" (?:clip-path="[^"]*" )?style="([^"]*)"',
        path.read_text(),
    )
    styles = [style.replace(" ", "") for style in lines]  # Matplotlib 3.1 writes none
    curves = [style for style in styles if "stroke:#" in style and "stroke-width:1.5" in style]
    assert len(set(curves)) >= 30  # colour and line


def test_plot_wrong_usage(run, tmp_path):
    assert run("plot", PLANS / "rendezvous", "-o", tmp_path / "picture.txt")[0] == 2
    assert run("plot", PLANS / "rendezvous", "-o", tmp_path / "a.svg", "--what", "passage")[0] == 2
    code, _, err = run("plot", PLANS / "rendezvous", "-o", tmp_path / "a.svg", "--only", "nothing")
    assert code == 2 and "there is no 'nothing'" in err


def test_check(run, tmp_path):
    code, out, _ = run("check", PLANS / "rendezvous", "--json")
    data = json.loads(out)
    assert code == 0 and data["accepted"] is True and data["items"][0]["check"] == "dead_after_loss"
    code, out, _ = run("check", PLANS / "fork_join")
    assert code == 1 and "fork_join refused" in out
    assert run("check", PLANS / "fork_join", "--standalone")[0] == 0
    assert run("check", PLANS / "patrol", "--robots", 2)[0] == 0
    (tmp_path / "plan.json").write_text('{"net": ')
    code, out, err = run("check", tmp_path)
    assert code == 2 and out == "" and "plan.json" in err


_JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


@pytest.mark.long
@given(_JSON)
def test_json_is_indented_as_by_the_library(value):
    text = "".join(analyse._json(value, "\n"))
    assert text == json.dumps(value, indent=2, ensure_ascii=False)
