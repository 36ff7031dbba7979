"""Holds everything that answers for a plan to the same answer: the check, the analysis, the
simulation, ``Scenario``, a run in virtual time, and the verification of its log."""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import replace
from unittest.mock import patch

from generated_plans import small_plans, with_events, with_subnet, with_tasks
from hypothesis import strategies as st

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.analysis.preflight.report import Severity
from gspn_framework_package.analysis.simulation import simulate
from gspn_framework_package.execution import turn
from gspn_framework_package.execution.actions import ActionFailed
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.verifier import slot_check, verify
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import LimitError, RefusedError
from gspn_framework_package.model.plan_timing import PlanTiming, rules_of
from gspn_framework_package.testing import Scenario

CUT_OFF = "a cycle of immediate transitions"
"""How a run ends whose transitions fire without time between them."""

RUNS, TIME, FIRINGS = 2, 20.0, 60
MARKINGS = 500
AT_ONCE = 500
"""Firings after which a run is cut off here: a cycle without time goes on for ever in any case."""


@st.composite
def plans(draw):
    """Plans with subnets, events, tasks and places that are mapped to null."""
    plan = draw(with_subnet(small_plans()) if draw(st.integers(0, 2)) == 2 else small_plans())
    if draw(st.integers(0, 3)) == 0:
        plan = draw(with_events(st.just(plan)))
    if draw(st.booleans()):
        plan = draw(with_tasks(plan))
    idle = draw(st.sampled_from([0.0, 0.0, 0.3, 0.6]))
    actions = {
        p: None if draw(st.floats(0, 1)) < idle else plan.actions[p] for p in plan.action_places
    }
    durations = dict(plan.durations)
    if draw(st.integers(0, 3)) < 3:  # else some actions take no time by the plan
        durations.update(
            (p, Duration.exponential(1.0))
            for p in plan.action_places
            if p not in durations or durations[p].mean == 0
        )
    return replace(plan, actions=actions, durations=durations).validate()


def run_of(plan, seed, log=None, losses=0.0):
    """A run in virtual time, and how it went."""
    run = VirtualRun(plan, seed=seed, agents=losses == 0, loss_rate=losses)
    writer = run.record_in(str(log), "run", "log") if log is not None else None
    result = run.run(TIME, firings=FIRINGS)
    if writer is not None:
        writer.close()
    return run, result


def answers(plan, folder, told=None):
    """Require one answer.

    :param folder: for the log of a run.
    :param told: a counter of what was seen.
    :raises AssertionError: two answer differently.
    """
    with patch.object(turn, "FIRINGS_PER_ENTRY", AT_ONCE), patch.object(
        slot_check, "CYCLE", AT_ONCE
    ):
        _answers(plan, folder, Counter() if told is None else told)


def _answers(plan, folder, told):
    report = check(plan, standalone=True, limit=MARKINGS)
    told["plans"] += 1
    for what in ("subnets", "events", "submissions"):
        told["with " + what] += bool(getattr(plan, what))
    told["refused" if report.refused else "doubtful" if report.doubts else "may run"] += 1
    for name in {item.check for item in report.items if item.severity is Severity.REFUSED}:
        told["refused: " + name] += 1
    runs = [run_of(plan, seed) for seed in range(RUNS)]
    cut_off = any(run.state.ended == CUT_OFF for run, _ in runs)
    told["runs cut off"] += cut_off
    decided = report.complete and not any(i.details.get("undecided") for i in report.items)
    told["decided"] += decided
    # markings do not say which robot is where: with null for some robots only, the check refuses more
    rules = rules_of(plan, PlanTiming(plan))
    exact = rules.idle_places() == rules.idle_places(everybody=True)
    cycle = any(i.severity is Severity.REFUSED for i in report.of("timeless_cycle"))
    told["cycles refused"] += cycle
    told["cycles refused and seen"] += cycle and cut_off
    if decided:
        assert cycle or not cut_off, "a run is cut off, and the check lets it pass"
        for item in report.of("timeless_cycle") if exact else ():
            if item.severity is Severity.REFUSED and item.details.get("sequence") == []:
                assert cut_off, "the check says that every run ends at once: %s" % item.text
    _losing(plan, told)
    _unstuck(plan, report, runs, decided, told)
    _never(plan, report, runs, decided)
    short = max(0.01, min(run.now for run, _ in runs))  # agents may multiply
    foreseen = cycle or bool(report.of("predictions"))
    told["predictions may be refused"] += foreseen and not cycle
    _simulated(plan, short, report, decided, foreseen, told)
    _analysed(plan, decided, foreseen, told)
    # the log of a run is by the rules, and a scenario is the same run
    folder.mkdir(exist_ok=True)
    log = folder / "run.jsonl"
    log.unlink(missing_ok=True)
    run, _ = run_of(plan, 0, log)
    found = verify([read_log(str(log))])
    assert found.violation is None, found.violation
    _scripted(plan, folder)
    scenario = Scenario(plan, seed=0, drawn=True)
    try:
        scenario.advance(min(run.now, TIME))
    except AssertionError as error:
        assert "without time" in str(error) and (cut_off or foreseen)
    count = min(len(scenario.firings), found.firings)
    same = [f.transition for f in scenario.firings][:count]
    assert same == _fired(log)[:count], "a scenario is another run"
    ended = scenario.ended.reason if scenario.ended else None
    if run.result is not None and run.state.ended == CUT_OFF:
        assert ended == CUT_OFF


def _losing(plan, told):
    """A team that loses robots is not cut off, unless the check for teams says so."""
    if plan.timing.evict_after <= 0 or len(plan.robots) < 2:
        return
    run, _ = run_of(plan, 9, losses=0.2)
    if run.state.ended != CUT_OFF:
        return
    told["runs with losses cut off"] += 1
    report = check(plan, limit=MARKINGS)
    sure = report.complete and not report.of("smaller_teams")
    undecided = any(i.details.get("undecided") for i in report.items)
    refused = any(i.severity is Severity.REFUSED for i in report.of("timeless_cycle"))
    assert refused or undecided or not sure, "a team with losses is cut off"


def _scripted(plan, folder):
    """Events, tasks with data that an action reads, and a loss, as a test of the plan says: the log
    is by the rules."""
    log = folder / "scripted.jsonl"
    log.unlink(missing_ok=True)
    moments = random.Random(0)

    def work(attempt):
        if attempt.data.get("task.size", 0) % 2:
            raise ActionFailed("it is odd")
        return ""

    with Scenario(plan, seed=0, log=str(log)) as scenario:
        scenario.action(plan.action_places[0], act=work, times=3)
        for transition in plan.submissions:
            for size in range(4):
                scenario.submit(transition, {"size": size}, at=moments.uniform(0, 4))
        for transition in (t for p in plan.action_places for t in plan.interrupts(p)):
            scenario.event(transition, at=moments.uniform(0, 4))
            scenario.holds(transition, at=moments.uniform(0, 2))
            scenario.holds(transition, False, at=moments.uniform(2, 4))
        if plan.keeps_robots:
            scenario.lose(plan.robots[0].name, at=3.0)
        try:
            scenario.advance(5.0)
        except AssertionError as error:
            assert "without time" in str(error)
    found = verify([read_log(str(log))])
    assert found.violation is None, "scripted: %s" % (found.violation,)


def _fired(log):
    return [f.transition for step in replay(read_log(str(log))) for f in step.firings]


def _unstuck(plan, report, runs, decided, told):
    """No run comes to a dead marking that the check rules out."""
    ruled_out = decided and all(i.severity is Severity.OK for i in report.of("dead_markings"))
    for run, _ in runs:
        team = run.state.active()
        idle = run.result is None and run.now < TIME and not run._running
        stuck = idle and team and all(r.phase in (Phase.DONE, Phase.INACTIVE) for r in team)
        if stuck and not all(r.phase is Phase.INACTIVE for r in team):
            told["stuck runs"] += 1
            enabled = plan.net.enabled(run.state.marking)
            told["stuck with something enabled"] += bool(enabled) and ruled_out
            assert enabled or not ruled_out, "a run is stuck: %s" % (run.state.marking,)


def _never(plan, report, runs, decided):
    """What never fires, by the check, does not fire."""
    if not decided:
        return
    never = {t for item in report.of("never_fire") for t in item.details["transitions"]}
    for _, result in runs:
        fired = {t for t, n in result.firings.items() if n}
        assert not never & fired, "never fires, and fired: %s" % sorted(never & fired)


def _simulated(plan, seconds, report, decided, foreseen, told):
    try:
        simulate(plan, time=seconds, replications=2, seed=5)
    except RefusedError as error:
        without_time = "without time" in str(error)
        told["simulations refused"] += 1
        assert not (without_time and decided) or foreseen, "simulate: %s" % error
        return
    rules = rules_of(plan, PlanTiming(plan))
    if rules.idle_places() != rules.idle_places(everybody=True):
        return
    sure = [i for i in report.of("timeless_cycle") if i.details.get("sequence") == []]
    assert not (decided and sure and sure[0].severity is Severity.REFUSED), "simulate runs it"


def _analysed(plan, decided, foreseen, told):
    """The analysis finds a trap only where the check does."""
    try:
        Analysis(plan, limit=MARKINGS).chain  # noqa: B018
        told["analysed"] += 1
    except LimitError:
        return
    except RefusedError as error:
        if "timeless trap" in str(error):
            told["traps in analysis"] += 1
            assert foreseen or not decided, "analyse: %s" % error
