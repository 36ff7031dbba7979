"""What a run shows of a fleet, reduced to stays and moments."""

from __future__ import annotations

from typing import Any, List, Tuple

from game_driver import make_plan
from hypothesis import given, settings
from hypothesis import strategies as st
from logged_runs import Story, ring

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.log_entries import Done, Failed
from gspn_framework_package.fleet.stay_follower import DAY_SECONDS, StayFollower
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.event import Tasks
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.plan import Plan

BEGIN = 1e9


def follow(story: Story, follower: StayFollower) -> None:
    for record in story.records:
        if follower.now is None:
            follower.go_to(record["wall"])
        follower.wait(record["wall"] - (follower.now or 0.0))
        if record["kind"] == "slot":
            follower.take(record)


def told(follower: StayFollower) -> List[Tuple[Any, ...]]:
    return [
        (round(s.begin - BEGIN, 3), s.robot, s.place, s.visit, s.arrived, s[6:11], s.left_by)
        for s in follower.stays
    ]


def kinds(follower: StayFollower) -> List[Tuple[Any, ...]]:
    return [(m.kind, m.robot, m.place, m.slot) for m in follower.moments]


def followed(story: Story, **options: Any) -> StayFollower:
    follower = StayFollower(story.plan, agents=not story.ledger.state.witnesses, **options)
    follow(story, follower)
    follower.cut()
    return follower


def test_a_stay_tells_what_the_robot_did_in_it() -> None:
    story = Story(ring()).start()
    story.slot(1.5, Done("a", 0, 1, "t1"))
    story.slot(4.0, Done("a", 0, 2, "t3"))  # waits for the resource
    story.slot(6.0, log_entries.Pause("a"))
    story.slot(7.0, log_entries.Resume("a"))
    story.slot(9.0, log_entries.Fire("made"))
    assert told(followed(story)) == [
        (0.0, "a", "A", 1, True, (1500, 0, 0, 0, 0), "t1"),
        (1.5, "a", "B", 2, True, (2500, 4000, 1000, 0, 0), "t3"),
        (0.0, "b", "A", 1, True, (9000, 0, 0, 0, 0), ""),
        (9.0, "a", "A", 3, True, (0, 0, 0, 0, 0), ""),
    ]


def test_failures_alarms_and_orders_are_moments() -> None:
    rules = {"A": FailureRule.retry(1)}
    story = Story(ring(on_failure=rules)).start()
    story.slot(1.0, Failed("a", 0, 1, 1, "aborted"))  # is tried again
    story.slot(2.0, Failed("a", 0, 1, 1, "aborted"))  # stale
    story.slot(3.0, Failed("a", 0, 1, 2, "timeout"))
    story.slot(5.0, log_entries.Retry("a"))
    story.slot(6.0, log_entries.SetPlace("a", "B"))
    story.slot(7.0, Done("a", 0, 2, "t1"))  # not a transition that leaves B
    story.slot(8.0, log_entries.Evict("b", 0, True))
    follower = followed(story)
    assert kinds(follower) == [
        ("failure", "a", "A", 1),
        ("failure", "a", "A", 3),
        ("alarm", "a", "A", 3),
        ("intervention", "a", "A", 4),
        ("intervention", "a", "A", 5),
        ("failure", "a", "B", 6),
        ("alarm", "a", "B", 6),
        ("intervention", "b", "A", 7),
        ("alarm", "b", "A", 7),
    ]
    assert [s[6:11] for s in follower.stays if s.robot == "a"] == [
        (4000, 0, 0, 2000, 0),
        (1000, 0, 0, 1000, 0),
    ]
    assert [s[6:11] for s in follower.stays if s.robot == "b"] == [(8000, 0, 0, 0, 0)]


def test_a_failure_counts_for_the_place_that_the_robot_leaves_because_of_it() -> None:
    rules = {"A": FailureRule.fire("t1")}
    story = Story(ring(on_failure=rules)).start()
    story.slot(1.0, Failed("a", 0, 1, 1, "aborted"))
    assert kinds(followed(story)) == [("failure", "a", "A", 1)]


def test_stays_are_cut_at_midnight_and_a_visit_counts_once() -> None:
    story = Story(ring()).start()
    midnight = (BEGIN // DAY_SECONDS + 1) * DAY_SECONDS - BEGIN
    story.slot(midnight + 2 * DAY_SECONDS + 5.0, Done("a", 0, 1, "t1"))
    rows = [row for row in told(followed(story)) if row[1:3] == ("a", "A")]
    assert rows == [
        (0.0, "a", "A", 1, True, (round(midnight * 1000), 0, 0, 0, 0), ""),
        (midnight, "a", "A", 1, False, (DAY_SECONDS * 1000, 0, 0, 0, 0), ""),
        (midnight + DAY_SECONDS, "a", "A", 1, False, (DAY_SECONDS * 1000, 0, 0, 0, 0), ""),
        (midnight + 2 * DAY_SECONDS, "a", "A", 1, False, (5000, 0, 0, 0, 0), "t1"),
    ]


def test_time_that_nobody_observed_counts_for_nothing() -> None:
    story = Story(ring()).start()
    follower = StayFollower(story.plan, agents=True)
    follow(story, follower)
    follower.wait(2.0)
    follower.go_to(BEGIN + 1000.0)
    follower.wait(3.0)
    follower.cut()
    assert [(s.robot, s.acting, s.arrived) for s in follower.stays] == [
        ("a", 2000, True),
        ("b", 2000, True),
        ("a", 3000, False),
        ("b", 3000, False),
    ]


def test_a_run_that_has_ended_uses_no_robots() -> None:
    story = Story(ring()).start()
    story.slot(2.0, log_entries.Stop("enough"))
    story.write(50.0, kind="life", incarnation=1)
    follower = followed(story)
    assert [(s.robot, s.acting, s.left_by) for s in follower.stays] == [
        ("a", 2000, ""),
        ("b", 2000, ""),
    ]
    assert kinds(follower) == [("end", "", "", 1)]


def _long_story(plan: Plan) -> Story:
    story = Story(plan).start()
    t, visits = 0.0, {"a": 1, "b": 1}
    for number in range(12):
        for robot, wish in (("a", "t2"), ("b", "t3")):
            t += 7000.0  # several midnights
            at_a = visits[robot] % 2 == 1
            story.slot(t, Done(robot, 0, visits[robot], "t1" if at_a else wish))
            visits[robot] = story.ledger.state.robots[robot].visit
        story.slot(t + 1.0, log_entries.Fire("made"))
        visits = {r.name: r.visit for r in story.ledger.state.robots.values()}
        t += number
    return story


@settings(derandomize=True, max_examples=25)
@given(st.sets(st.integers(1, 35), max_size=6))
def test_where_reading_stops_and_goes_on_changes_no_sum(breaks: Any) -> None:
    story = _long_story(ring())
    whole = followed(story)
    follower, rows = StayFollower(story.plan, agents=True), []
    for number, record in enumerate(story.records):
        if number in breaks:
            follower.cut()
            rows += follower.stays
            follower = StayFollower(story.plan, agents=True, kept=follower.to_json())
        if follower.now is None:
            follower.go_to(record["wall"])
        follower.wait(record["wall"] - (follower.now or 0.0))
        follower.take(record)
    follower.cut()
    assert sums([*rows, *follower.stays]) == sums(whole.stays)


def sums(stays: Any) -> Any:
    found: Any = {}
    for stay in stays:
        key = (stay.robot, stay.place, int(stay.begin // DAY_SECONDS))
        known = found.get(key, (0,) * 6)
        found[key] = tuple(a + b for a, b in zip(known, (int(stay.arrived), *stay[6:11])))
    return {key: value for key, value in found.items() if any(value)}


def test_how_a_task_ended_and_after_how_long_is_a_moment() -> None:
    net = (
        NetBuilder()
        .place("Idle")
        .place("Deliver")
        .place("Orders")
        .exponential("order", rate=1, outputs="Orders")
        .immediate("take", inputs=["Idle", "Orders"], outputs="Deliver")
        .exponential("delivered", rate=1, inputs="Deliver", outputs="Idle")
        .build()
    )
    tasks = Tasks(("Orders",), ("delivered",), {"Deliver": None})
    story = Story(make_plan(net, ["Idle"], ["Orders"], idle=["Idle"], tasks=tasks)).start()
    begin = int(BEGIN)
    story.slot(1.0, log_entries.Submit("order", "o1", since=begin + 1))
    story.slot(2.0, log_entries.Submit("order", "o2"))
    story.slot(31.0, Done("a", 0, 2, "delivered"))
    story.slot(40.0, log_entries.CancelTask("o2"))
    ends = [(m.robot, m.detail) for m in followed(story).moments if m.kind == "task_end"]
    assert ends == [
        ("a", "o1: done after 30 s (delivered with a)"),
        ("a", "o2: cancelled (with a in Deliver)"),
    ]
