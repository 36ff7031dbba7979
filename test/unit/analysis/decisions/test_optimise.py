"""From a plan and a request to the plan with the best policy."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.decisions.aims import AtLeast, Objective, Request
from gspn_framework_package.analysis.decisions.grouping import Grouping
from gspn_framework_package.analysis.decisions.optimise import optimise
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.preflight.check_plan import check
from gspn_framework_package.analysis.preflight.report import Severity
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration, Evidence
from gspn_framework_package.model.errors import LimitError, RefusedError, UsageError
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy

PLANS = Path(__file__).resolve().parents[4] / "plans"
CHECKS = Objective.long_run({"*:Temperature_*": 1.0})
ALONE = " or ".join(
    "'p%d:Check_Temperature_L%d' + 'p%d:Alarm_L%d' > 1" % (4 * k + 1, k + 1, 4 * k + 2, k + 1)
    for k in range(4)
)


def two_ways(**settings) -> Plan:
    """One robot that walks (2 s) or drives (0.5 s); its present policy lets it walk."""
    net = (
        NetBuilder("two_ways")
        .place("choose", 1)
        .place("far")
        .place("near")
        .immediate("walk", inputs="choose", outputs="far")
        .immediate("drive", inputs="choose", outputs="near")
        .exponential("walked", rate=0.5, inputs="far", outputs="choose")
        .exponential("driven", rate=2.0, inputs="near", outputs="choose")
        .build()
    )
    return Plan(
        net,
        actions={"choose": None},
        robots=(RobotSpec("r", "choose"),),
        policy=Policy.from_table((), [((), {"walk": 1})]),
        **settings,
    )


def test_the_faster_way_is_found_and_said():
    report = optimise(
        two_ways(), Request(Objective.long_run({"walked": 1, "driven": 1})), simulated=0
    )
    assert report.present == pytest.approx(0.5, rel=1e-9)
    assert report.teams[0].value == pytest.approx(2.0, rel=1e-9)
    assert report.gain == pytest.approx(3.0)
    choice = report.choices[0]
    assert (choice.place, choice.present, choice.best) == ("choose", {"walk": 1}, {"drive": 1})
    assert choice.marking == {"choose": 1}
    assert (report.choices_in_all, report.choices_that_differ) == (1, 1)
    text = "\n".join(report.lines())
    assert "best policy: 2 1/s" in text
    assert "(choose: 1) in choose: walk -> drive" in text
    data = json.loads(json.dumps(report.to_json(), allow_nan=False))
    assert data["lower"] <= data["value"] <= data["upper"]
    assert data["plan"]["policy"]["rows"][0]["choose"] == {"drive": 1.0}
    assert data["undecided"] == []
    assert any("the policy decides in choose" in sentence for sentence in data["assumptions"])


@pytest.mark.parametrize(
    ("objective", "value"),
    [
        (Objective.time_to("near == 1 or far == 1"), 0.0),
        (Objective.cost_to("far == 1", {"walk": 3.0, "drive": 5.0}), 3.0),
        (Objective.discounted({"walked": 1.0, "driven": 1.0}, 0.1), 20.0),
        (dataclasses.replace(Objective.long_run({"walked": 1.0}), maximise=False), 0.0),
    ],
)
def test_each_aim_has_its_value(objective, value):
    report = optimise(two_ways(), Request(objective), simulated=0)
    assert report.teams[0].value == pytest.approx(value, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("first", ["go", "stroll"])
def test_of_equally_good_decisions_one_that_comes_to_the_goal_is_taken(first):
    ways = {"go": "goal", "stroll": "walk"}
    builder = NetBuilder().place("hub", tokens=1).place("walk").place("goal")
    for name in sorted(ways, key=lambda name: name != first):
        builder.immediate(name, inputs="hub", outputs=ways[name])
    builder.exponential("walked", rate=1.0, inputs="walk", outputs="hub")
    act = FunctionAction("actions.act", "act")
    plan = Plan(
        builder.build(),
        actions={"hub": None, "walk": act, "goal": act},
        robots=(RobotSpec("r1", "hub"),),
    ).validate()
    report = optimise(plan, Request(Objective.reach("goal >= 1")), simulated=0)
    assert report.teams[0].value == 1.0
    assert not report.undecided
    assert dict(report.plan.policy.rows[0].choices) == {"go": 1.0}


def test_the_present_policy_stays_where_no_decisions_are_found_that_are_better(monkeypatch):
    plan = two_ways()
    plan = plan.with_policy(Policy.from_table((), [((), {"walk": 0.5, "drive": 0.5})]))
    advanced = Grouping._advanced

    def astray(self, chosen, good):
        walk = self._team.problem.plan.net.transition_number("walk")
        return np.full_like(advanced(self, chosen, good), walk)

    monkeypatch.setattr(Grouping, "_advanced", astray)
    aim = Objective.long_run({"walked": 1, "driven": 1})
    report = optimise(plan, Request(aim), simulated=0)
    assert report.plan.policy == plan.policy
    assert report.teams[0].value == pytest.approx(0.8)
    assert any("the present policy stays" in sentence for sentence in report.undecided)
    assert {found.transition for found in report.sensitivities} >= {"walked", "driven"}


def test_a_present_policy_that_is_worth_more_stays():
    """The search lets the robot that chance moves take the tool first; in a run each may."""
    net = (
        NetBuilder("tool")
        .place("a", 2)
        .place("b", 1)
        .place("away_a")
        .place("away_b")
        .place("tool")
        .place("out", 1)
        .immediate("take_a", inputs=["a", "tool"], outputs="away_a")
        .immediate("take_b", inputs=["b", "tool"], outputs="away_b")
        .exponential("back_a", rate=2.0, inputs="away_a", outputs=["a", "out"])
        .exponential("back_b", rate=1.5, inputs="away_b", outputs=["b", "out"])
        .exponential("give", rate=2.0, inputs="out", outputs="tool")
        .build()
    )
    work = FunctionAction("actions.work", "work")
    plan = Plan(
        net,
        actions={"a": None, "b": work, "away_a": work, "away_b": work},
        resource_places=frozenset(["tool", "out"]),
        simulate_environment=True,
    )
    robots = [RobotSpec("a1", "a"), RobotSpec("a2", "a"), RobotSpec("b1", "b")]
    plan = plan.with_robots(robots).validate()
    report = optimise(plan, Request(Objective.discounted({"give": 1}, 0.7)), simulated=0)
    assert report.plan.policy == plan.policy
    assert report.present > 1.3 and report.teams[0].value == report.present
    assert report.teams[0].lower is report.teams[0].upper is None
    assert any("the present one stays" in sentence for sentence in report.undecided)


@pytest.mark.long
@pytest.mark.parametrize(
    ("reading", "robots", "present", "best"),
    [("net", 4, 1.194798945367, 1.325220304), ("run", 3, 1.12022406622, 1.15808613)],
)
def test_the_patrol_with_waiting_keeps_its_rule_in_every_team(reading, robots, present, best):
    plan = read_plan(str(PLANS / "patrol")).for_robots(robots)
    request = Request(CHECKS, never=(ALONE,), may_wait=frozenset({"p*:Decide_*"}), reading=reading)
    report = optimise(plan, request, simulated=0)
    own = report.teams[0]
    assert own.value == pytest.approx(best, rel=1e-7)
    assert own.lower is not None
    assert own.upper is not None
    assert own.upper - own.lower <= 1e-6 * own.upper
    assert own.lower - 1e-9 <= own.value <= own.upper + 1e-9
    assert [team.robots for team in report.teams] == list(range(robots, 0, -1))
    assert report.present == pytest.approx(present, rel=1e-9)
    never = report.constraints[0]
    free = optimise(plan, dataclasses.replace(request, never=()), simulated=0).teams[0].value
    assert never.price == pytest.approx(free - best, rel=1e-6)
    assert "never %s: it costs " % ALONE in "\n".join(report.lines())
    strict = dataclasses.replace(report.plan, strict=True)
    findings = [item for item in check(strict).items if item.severity is not Severity.OK]
    assert {item.check for item in findings} <= {"never_fire"}
    analysis = Analysis(report.plan, timing=reading)
    checks = sum(
        value for name, value in analysis.measures.throughput.items() if ":Temperature_" in name
    )
    assert checks == pytest.approx(own.value, rel=1e-9)
    assert analysis.reach(ALONE).reachable is False


def test_what_cannot_be_kept_is_refused():
    with pytest.raises(RefusedError, match="cannot be avoided"):
        optimise(
            two_ways(),
            Request(Objective.long_run({"walked": 1}), never=("near + far > 0",)),
            simulated=0,
        )


def test_a_policy_that_is_the_best_already_is_kept():
    plan = two_ways()
    plan = plan.with_policy(Policy.from_table((), [((), {"drive": 1})]))
    report = optimise(plan, Request(Objective.long_run({"walked": 1, "driven": 1})), simulated=0)
    assert report.plan.policy == plan.policy
    assert report.gain == 0
    assert report.choices_that_differ == 0


def test_a_constraint_has_its_price():
    plan = two_ways()
    request = Request(
        Objective.long_run({"walked": 1, "driven": 1}), at_least=(AtLeast("walked", 0.2),)
    )
    report = optimise(plan, request, simulated=0)
    # A share y of the time in "far" gives 0.5 y walks and 2 (1 - y) drives a second.
    assert report.teams[0].value == pytest.approx(1.4, rel=1e-6)
    assert report.constraints[0].value == pytest.approx(0.2, rel=1e-6)
    assert report.constraints[0].price == pytest.approx(3.0, rel=1e-6)
    chosen = dict(report.plan.policy.rows[0].choices)
    assert chosen["walk"] == pytest.approx(0.2 / 1.4, rel=1e-6)
    assert "walked: 0.2, at least 0.2; it costs 3 per unit" in "\n".join(report.lines())
    impossible = dataclasses.replace(request, at_least=(AtLeast("walked", 0.6),))
    with pytest.raises(RefusedError, match="walked"):
        optimise(plan, impossible, simulated=0)


@pytest.mark.long
def test_a_constraint_is_kept_although_rows_cannot_draw_between_going_and_waiting():
    plan = read_plan(str(PLANS / "patrol")).for_robots(2)
    request = Request(
        CHECKS,
        may_wait=frozenset({"p*:Decide_*"}),
        at_least=(AtLeast("p4:Wait_L1", 0.05),),
        team_sizes=(2,),
    )
    report = optimise(plan, request, simulated=0)
    own = report.teams[0]
    mean = Analysis(report.plan).measures.mean_tokens["p4:Wait_L1"]
    assert mean == pytest.approx(report.constraints[0].value, rel=1e-6)
    assert mean >= 0.05 * (1 - 1e-6)
    assert own.lower <= own.value <= own.upper * (1 + 1e-9)
    assert own.upper - own.value < 0.01 * own.upper


@pytest.mark.parametrize("reading", ["net", "run"])
def test_the_best_policy_for_the_worst_rates(reading):
    request = Request(
        Objective.long_run({"walked": 1, "driven": 1}),
        uncertain={"driven": (0.1, 4.0)},
        reading=reading,
    )
    report = optimise(two_ways(), request, simulated=0)
    assert report.teams[0].value == pytest.approx(0.5, rel=1e-6)
    assert report.teams[0].upper == pytest.approx(0.5, rel=1e-6)
    assert dict(report.plan.policy.rows[0].choices) == {"walk": 1.0}


def test_the_worst_value_of_a_policy_that_draws_is_not_that_of_its_best_row(monkeypatch):
    drawn = Grouping.drawn

    def draw(self, weights):
        team = self._team
        return drawn(self, np.where(team.decides[team.automaton.row_states], 0.5, weights))

    monkeypatch.setattr(Grouping, "drawn", draw)
    aim = Objective.long_run({"walked": 1, "driven": 1})
    request = Request(aim, uncertain={"driven": (1.0, 4.0)}, reading="net")
    report = optimise(two_ways(), request, simulated=0)
    assert report.teams[0].value == pytest.approx(2 / 3, rel=1e-6)  # 2 in 2 s and 1 s


@pytest.mark.parametrize("reading", ["net", "run"])
def test_how_the_value_depends_on_the_rates(reading):
    request = Request(Objective.long_run({"walked": 1, "driven": 1}), reading=reading)
    report = optimise(two_ways(), request, simulated=0)
    assert [entry.transition for entry in report.sensitivities] == ["driven"]
    assert report.sensitivities[0].derivative == pytest.approx(1.0, rel=1e-9)
    assert report.sensitivities[0].elasticity == pytest.approx(1.0, rel=1e-9)


def test_only_what_has_the_nominal_rates_is_said_with_them():
    plan = two_ways(durations={"near": Duration.exponential(10.0)})
    plan = dataclasses.replace(plan, evidence={("durations", "near"): Evidence(10)})
    aim = Objective.long_run({"walked": 1, "driven": 1})
    fitted = optimise(plan, Request(aim), simulated=0)
    nominal = optimise(plan, Request(aim, fitted=False), simulated=0)
    assert fitted.teams[0].value == pytest.approx(0.5, rel=1e-9)
    assert nominal.teams[0].value == pytest.approx(2.0, rel=1e-9)
    assert nominal.plan.durations == plan.durations


@pytest.mark.long
def test_the_sensitivities_of_a_run_are_the_quotients_of_differences():
    plan = read_plan(str(PLANS / "patrol")).for_robots(2)
    request = Request(CHECKS, team_sizes=(2,))
    found = optimise(plan, request, simulated=0)
    for entry in found.sensitivities[:6]:
        values = []
        for step in (-1e-4, 1e-4):
            changed = plan.with_rates({entry.transition: entry.rate * (1 + step)})
            values.append(optimise(changed, request, simulated=0).teams[0].value)
        quotient = (values[1] - values[0]) / (2e-4 * entry.rate)
        assert entry.derivative == pytest.approx(quotient, rel=1e-4, abs=1e-9)
    assert len(found.sensitivities) > 6


@pytest.mark.long
def test_too_many_states_are_answered_by_simulation_or_not_at_all():
    aim = Objective.long_run({"walked": 1, "driven": 1})
    request = Request(aim, limits=Limits(states=2))
    report = optimise(two_ways(), request, simulated=0.1)
    assert not report.exact
    assert report.present == pytest.approx(0.5, rel=0.1)
    assert report.teams[0].value == pytest.approx(2.0, rel=0.1)
    assert "not decided: the best policy: " in "\n".join(report.lines())
    assert report.to_json()["simulation"]["significant"]
    with pytest.raises(LimitError, match="not decided within 3 states"):
        optimise(two_ways(), request, simulated=0)


def test_a_rate_that_plays_no_part_is_not_uncertain():
    plan = two_ways(durations={"near": Duration.exponential(1.0)})
    request = Request(
        Objective.long_run({"walked": 1, "driven": 1}), uncertain={"driven": (0.1, 4.0)}
    )
    with pytest.raises(UsageError, match="driven: its rate has no effect"):
        optimise(plan, request, simulated=0)


def test_rows_are_not_written_where_nothing_is_for_the_policy_to_decide():
    """By weights a robot never waits for a partner; a row with the same chances would make it."""
    net = (
        NetBuilder()
        .place("work", tokens=2)
        .place("done")
        .immediate("finish", inputs="work", outputs="done", inhibitors="done")
        .immediate("pair", inputs={"work": 2}, outputs={"done": 2})
        .exponential("again", rate=2.0, inputs="done", outputs="work")
        .build()
    )
    plan = Plan(
        net,
        actions={"work": FunctionAction("a.b", "b")},
        durations={"work": Duration.exponential(0.7)},
    )
    report = optimise(plan, Request(Objective.long_run({"finish": 1.0})), simulated=0.0)
    assert report.plan.policy == plan.policy
    assert report.teams[0].value == pytest.approx(Analysis(plan).measures.throughput["finish"])
