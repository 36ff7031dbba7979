"""A plan that uses a failure rule, a family of durations, a source of events, a kind of action and
an operator's order of somebody else's, in every verb.

A robot sets out for its work, or rests, until a timer rings after 3 s. An attempt at its work takes
1 s and then an exponential time of 1 s. Half of them fail; then it is patient for 2 s, tries once
more, and gives up if that fails too. So a visit to Work takes 2 + (2 + 2) / 2 = 4 s, and it gives up
in one of four.
"""

import json
import math
import re

import jsonschema
import pytest

from gspn_framework_package.analysis.executors import open_executor
from gspn_framework_package.analysis.simulation import simulate
from gspn_framework_package.cli import main as dispatcher
from gspn_framework_package.formats import write_net
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.plan_json import plan_to_short_json
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.visualizer.app import create_app
from gspn_framework_package.visualizer.guard import Guard
from gspn_framework_package.visualizer.project import Project

WORK, REST = 4.0, 3.0
IF_BEGUN_ALWAYS = 0.75 / (WORK + REST)
IF_BEGUN_HALF_THE_TIME = 0.75 / (WORK + 2 * REST)


@pytest.fixture
def toy_tables(add, toy_kind):
    from toys import toy_family, toy_order, toy_rule, toy_source

    add("a failure rule", ("patience", toy_rule.PATIENCE))
    add("a family of durations", ("at-least", toy_family.AT_LEAST))
    add("a family of durations", ("rayleigh", toy_family.RAYLEIGH))
    add("a source of events", ("timer", toy_source.TIMER))
    add("an order of the operator", ("greet", toy_order.GREET))


def plan_in(folder, **changes):
    net = NetBuilder("toy").place("Start", tokens=1).place("Work").place("Rest")
    net.immediate("begin", inputs="Start", outputs="Work")
    net.immediate("skip", inputs="Start", outputs="Rest")
    net.immediate("done", inputs="Work", outputs="Rest")
    net.immediate("give_up", inputs="Work", outputs="Rest")
    net.exponential("ring", rate=1 / REST, inputs="Rest", outputs="Start")
    folder.mkdir(exist_ok=True)
    write_net(net.build(), folder / "net.xml")
    plan = {
        "net": "net.xml",
        "actions": {"Start": None, "Work": {"say": "hello"}, "Rest": None},
        "durations": {"Work": {"distribution": "at-least", "least": 1, "rest": 1}},
        "outcomes": {"Work": {"probabilities": {"done": 1}}},
        "failures": {"Work": {"probability": 0.5}},
        "on_failure": {"Work": {"patience": 1, "delay": 2, "then": "fire give_up"}},
        "events": {"ring": {"timer": {"minutes": REST / 60}}},
        **changes,
    }
    (folder / "plan.json").write_text(json.dumps(plan))
    return str(folder)


@pytest.fixture
def folder(toy_tables, tmp_path):
    return plan_in(tmp_path / "plan")


@pytest.fixture
def gspn(capsys):
    """Runs a verb, and returns what it says."""

    def gspn(*words):
        code = dispatcher.main([*words])
        said = capsys.readouterr()
        assert code == 0, said
        return said.out

    return gspn


def test_it_is_checked(folder, gspn):
    assert "ring (timer) interrupts Rest" in gspn("check", folder)


def test_it_is_written_and_read_again(folder, gspn, tmp_path):
    gspn("convert", folder, str(tmp_path / "one.json"))
    plan, again = read_plan(folder), read_plan(str(tmp_path / "one.json"))
    assert (again.on_failure, again.durations) == (plan.on_failure, plan.durations)
    assert (again.events, again.actions) == (plan.events, plan.actions)
    assert again.hash() == plan.hash()
    other = read_plan(plan_in(tmp_path / "other", on_failure={"Work": "fire give_up"}))
    assert other.hash() != plan.hash()


def test_the_analysis_has_its_means(folder, gspn):
    found = json.loads(gspn("analyse", folder, "--json"))
    rates = {"begin": 0.1, "skip": 0.1, "ring": 0.2, "done": 0.075, "give_up": 0.025}
    steady = found["steady_state"]
    assert steady["throughput"] == pytest.approx(rates)
    assert steady["mean_tokens"] == pytest.approx({"Start": 0, "Work": 0.4, "Rest": 0.6})
    assumed = found["timing"]["assumptions"]
    assert any("ring come at the rates of the net" in said for said in assumed)


def test_the_simulation_holds_them_in_its_intervals(folder, gspn):
    words = ["simulate", folder, "--time", "3000", "--warmup", "100", "--replications", "60"]
    found = json.loads(gspn(*words, "--json", "--seed", "7"))
    for name, mean in (("done", IF_BEGUN_HALF_THE_TIME), ("give_up", 0.025), ("ring", 0.2)):
        estimate = found["throughput"][name]
        assert abs(estimate["mean"] - mean) <= estimate["half_width"] < 0.05 * mean


def test_other_processes_are_given_it(folder):
    plan = read_plan(folder)
    with open_executor("processes:2") as two:
        assert simulate(plan, time=200.0, replications=8, on=two) == simulate(
            plan, time=200.0, replications=8
        )


def test_the_best_policy_never_skips(folder, gspn, tmp_path):
    words = ["optimise", folder, "--reward", "done=1", "--simulate", "1", "--json"]
    words += ["-o", str(tmp_path / "best.json")]
    found = json.loads(gspn(*words))
    assert found["choices"][0]["best"] == {"begin": 1.0}
    assert found["value"] == pytest.approx(IF_BEGUN_ALWAYS)
    better = found["simulation"]["difference"]
    assert better["low"] < IF_BEGUN_ALWAYS - IF_BEGUN_HALF_THE_TIME < better["high"]
    analysed = json.loads(gspn("analyse", str(tmp_path / "best.json"), "--json"))
    assert analysed["steady_state"]["throughput"]["done"] == pytest.approx(IF_BEGUN_ALWAYS)


def test_what_a_log_shows_is_learned_and_compared_with_it(folder, gspn, tmp_path):
    log, learned = str(tmp_path / "log.jsonl"), str(tmp_path / "learned.json")
    gspn("simulate", folder, "--time", "4000", "--seed", "3", "--log", log)
    assert gspn("verify", log).splitlines()[-1] == "valid"
    words = ["fit", folder, log, "-o", learned, "--durations", "at-least", "--json"]
    place = json.loads(gspn(*words))["places"]["Work"]
    assert place["interval"][0] < 2.0 < place["interval"][1]
    assert place["failure"]["interval"][0] < 0.5 < place["failure"]["interval"][1]
    assert (place["distribution"], place["test"]["p"] > 0.01) == ("at-least", True)
    least, rest = read_plan(learned).durations["Work"].parameters
    assert (least, rest) == pytest.approx((1.0, 1.0), rel=0.1)
    compared = json.loads(gspn("compare", folder, log, "--json"))
    assert not compared["departs"]


def test_a_family_that_is_made_of_no_others(toy_tables, gspn, tmp_path):
    """An attempt that takes longer than its mean of 2 s is cut off: one of exp(-pi / 4)."""
    folder = plan_in(
        tmp_path / "plan",
        durations={"Work": {"distribution": "rayleigh", "scale": 2 * math.sqrt(2 / math.pi)}},
        timeout={"Work": 2.0},
        failures={},
        on_failure={"Work": "fire give_up"},
    )
    assert "ring (timer) interrupts Rest" in gspn("check", folder)
    late, log = math.exp(-math.pi / 4), str(tmp_path / "log.jsonl")
    fired = json.loads(gspn("analyse", folder, "--json"))["steady_state"]["throughput"]
    assert fired["give_up"] / fired["begin"] == pytest.approx(late, abs=1e-3)
    words = ["simulate", folder, "--time", "3000", "--warmup", "100", "--replications", "20"]
    found = json.loads(gspn(*words, "--json", "--seed", "7"))["throughput"]
    share = found["give_up"]["mean"] / found["begin"]["mean"]
    assert share == pytest.approx(late, abs=0.025)  # some 6,000 attempts
    words = ["optimise", folder, "--reward", "done=1", "--json", "--simulate", "0"]
    assert json.loads(gspn(*words))["choices"][0]["best"] == {"begin": 1.0}
    gspn("simulate", folder, "--time", "1500", "--seed", "3", "--log", log)
    assert gspn("verify", log).splitlines()[-1] == "valid"
    assert not json.loads(gspn("compare", folder, log, "--json"))["departs"]
    learned = str(tmp_path / "learned.json")
    gspn("fit", folder, log, "-o", learned, "--durations", "rayleigh")
    assert read_plan(learned).durations["Work"].describe().startswith("rayleigh")
    plan_in(tmp_path / "plan", durations={"Work": {"distribution": "rayleigh", "scale": 0.05}})
    gspn("run", folder, "--firings", "4")


def test_another_rule_is_seen_in_a_comparison(folder, gspn, tmp_path):
    log = str(tmp_path / "log.jsonl")
    other = plan_in(tmp_path / "other", on_failure={"Work": "fire give_up"})
    gspn("simulate", other, "--time", "4000", "--seed", "3", "--log", log)
    assert dispatcher.main(["compare", folder, log, "--json"]) == 1


def test_it_runs_and_its_log_is_verified(toy_tables, gspn, tmp_path):
    folder = plan_in(
        tmp_path / "plan",
        actions={"Start": None, "Work": {"say": ""}, "Rest": None},  # which fails
        on_failure={"Work": {"patience": 2, "delay": 0.02, "then": "fire give_up"}},
        events={"ring": {"timer": {"minutes": 0.001}}},
        policy={"places": [], "rows": [{"marking": [], "choose": {"begin": 0.5, "done": 0.5}}]},
    )
    log = tmp_path / "log.jsonl"
    gspn("run", folder, "--firings", "4", "--log", str(log))
    text = log.read_text()
    assert re.findall(r'"transition": ?"(begin|give_up|ring)"', text)[:2] == ["begin", "give_up"]
    tried = re.findall(r'"attempt":(\d),"reason":"aborted","detail":"ValueError: nothing', text)
    assert tried[:3] == ["1", "2", "3"]
    assert gspn("verify", str(log)).splitlines()[-1] == "valid"


def test_the_page_is_given_its_forms(folder):
    client = create_app(Project(), Guard("127.0.0.1", 8090)).test_client()
    schema = client.get("/plan.schema.json", base_url="http://127.0.0.1:8090").get_json()
    data = plan_to_short_json(read_plan(folder))
    data["net"] = "net.xml"
    check = jsonschema.Draft7Validator(schema).iter_errors
    assert not list(check(data))
    assert schema["definitions"]["duration"]["parameters"]["at-least"] == ["least", "rest"]
    rules = schema["properties"]["on_failure"]["additionalProperties"]["oneOf"]
    assert rules[-1]["title"] == "be patient, then fire"
    for wrong in (
        {"on_failure": {"Work": {"patience": 1}}},
        {"durations": {"Work": {"distribution": "at-most"}}},
        {"events": {"ring": {"timer": {"hours": 1}}}},
        {"events": {"ring": {"timer": {"minutes": 1}, "after": 60}}},
    ):
        assert list(check({**data, **wrong})), wrong


def test_who_has_not_entered_it_refuses_the_plan(tmp_path, capsys):
    """It says what it does not know."""
    folder = plan_in(tmp_path / "plan", actions={"Start": None, "Work": None, "Rest": None})
    given = json.loads((tmp_path / "plan" / "plan.json").read_text())
    for key, name in (("on_failure", "patience"), ("durations", "least"), ("events", "timer")):
        plan = {k: v for k, v in given.items() if k not in ("on_failure", "durations", "events")}
        (tmp_path / "plan" / "plan.json").write_text(json.dumps({**plan, key: given[key]}))
        for verb in ("check", "run", "simulate", "analyse", "verify"):
            assert dispatcher.main([verb, folder]) in (1, 2)
            said = capsys.readouterr()
            assert "internal error" not in said.err + said.out
            assert name in said.err + said.out or verb == "verify", said
