"""The check of a plan's events, tasks and data before it runs."""

from dataclasses import replace

import pytest
from test_events import EVENT, guards
from test_run_analysis import plan_of

from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.analysis.preflight.report import Severity
from gspn_framework_package.model.action import (
    FunctionAction,
    PublishAction,
    ServiceAction,
    WaitAction,
)
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.plan import Timing

OK, WARNING, REFUSED = Severity.OK, Severity.WARNING, Severity.REFUSED


def said(plan, name, **options):
    """What the check says about one question: severities and texts."""
    return [(item.severity, item.text) for item in check(plan, **options).of(name)]


# -- events ----------------------------------------------------------------------------------------


def test_a_plan_that_does_not_react_is_reported_nothing_new():
    report = check(replace(guards(), events={}))
    assert not [i for i in report.items if i.check in ("events", "tasks", "data")]


def test_which_event_interrupts_which_place():
    plan = guards(event=EventSource("battery", "a/B", "percentage < 0.2", hold=True))
    assert said(plan, "events") == [
        (OK, "low (topic battery: percentage < 0.2) interrupts Work"),
    ]
    events = [i for i in check(plan).to_json()["items"] if i["check"] == "events"]
    assert events[0]["events"] == [
        {
            "transition": "low",
            "place": "Work",
            "topic": "battery",
            "type": "a/B",
            "when": "percentage < 0.2",
            "hold": True,
        }
    ]


def test_an_event_that_can_never_have_an_effect():
    net = (
        NetBuilder()
        .place("a", 1)
        .place("b")
        .place("tool")
        .exponential("go", rate=1, inputs="a", outputs="a")
        .exponential("call", rate=1, inputs=["a", "tool"], outputs="a")
        .exponential("ring", rate=1, inputs="b", outputs="a")
        .build()
    )
    events = {"call": EVENT, "ring": EVENT}
    plan = plan_of(net, events=events, resource_places=frozenset(["tool"]))
    (severity, text), _ = said(plan, "events")
    assert severity is WARNING
    assert text.startswith("call, ring can never have an effect")
    more = replace(plan, on_evict={"a": {"tool": 1}}, spawn=("b",)).validate()
    assert [severity for severity, _ in said(more, "events")] == [OK]


def test_a_time_that_contradicts_its_rate():
    assert len(said(guards(event=EventSource(after=4.0)), "events")) == 1
    (severity, text), _ = said(guards(event=EventSource(after=40.0)), "events")
    assert severity is WARNING
    assert "low: after 40 s, 3.333 s by its rate" in text


def test_a_robot_that_waits_for_events_only_is_not_stuck():
    net = (
        NetBuilder()
        .place("idle", 1)
        .place("work")
        .exponential("call", rate=0.5, inputs="idle", outputs="work")
        .exponential("door", rate=0.5, inputs="idle", outputs="work")
        .exponential("done", rate=2, inputs="work", outputs="idle")
        .build()
    )
    plan = plan_of(net, events={"call": EVENT, "door": EVENT})
    plan = replace(plan, actions={**plan.actions, "idle": None}).validate()
    report = check(plan)
    assert not report.of("unasked")
    assert [item.severity for item in report.of("dead_markings")] == [OK]


def test_an_event_is_no_way_out_if_it_may_be_blocked():
    """A robot in `a` decides for a partner that never comes."""
    builder = (
        NetBuilder()
        .place("a", 1)
        .place("b")
        .place("tool")
        .immediate("meet", inputs=["a", "b"], outputs=["a", "b"])
    )
    blocked = builder.exponential("call", rate=1, inputs=["a", "tool"], outputs="a").build()
    resources = frozenset(["tool"])
    plan = plan_of(blocked, events={"call": EVENT}, resource_places=resources)
    assert [item.severity for item in check(plan).of("dead_markings")] == [REFUSED]


# -- tasks -----------------------------------------------------------------------------------------


def couriers(done=("deliver",), on_evict=True, robots=2, **more):
    """Robots that take orders from a queue and deliver them."""
    net = (
        NetBuilder("couriers")
        .place("Idle", robots)
        .place("Carry")
        .place("orders", 0, capacity=5)
        .exponential("order", rate=0.5, outputs="orders")
        .immediate("take", inputs=["Idle", "orders"], outputs="Carry")
        .exponential("deliver", rate=1, inputs="Carry", outputs="Idle")
        .exponential("give_up", rate=0.1, inputs="Carry", outputs="Idle")
        .build()
    )
    return plan_of(
        net,
        resource_places=frozenset(["orders"]),
        on_evict={"Carry": {"orders": 1}} if on_evict else {},
        **{"tasks": Tasks(("orders",), done), **more},
    )


def test_a_task_that_is_always_done():
    assert said(couriers(("deliver", "give_up")), "tasks") == [
        (OK, "tasks queue in orders and are done at deliver, give_up; none gets lost "
             "(by structure)")
    ]  # fmt: skip


def test_a_robot_that_takes_a_task_while_it_carries_one():
    (severity, text), *_ = said(couriers(), "tasks")
    assert severity is WARNING
    assert text.startswith("take gives a task to a robot that may still carry one from before (in ")
    assert "(in Idle)" in text


def test_a_lost_robot_with_its_task():
    plan = couriers(("deliver", "give_up"), on_evict=False)
    ((severity, text),) = said(plan, "tasks")
    assert severity is WARNING and "a robot that is lost in Carry keeps its task" in text
    assert said(plan, "tasks", standalone=True)[0][0] is OK
    assert said(replace(plan, timing=Timing(evict_after=0)), "tasks")[0][0] is OK


def test_a_robot_whose_action_fails_and_that_keeps_its_task():
    plan = couriers(
        tasks=Tasks(("orders",), ("deliver",), {"Carry": "give_up"}),
        events={"give_up": EventSource()},
    )
    assert [severity for severity, _ in said(plan, "tasks")] == [OK]
    failing = replace(plan, on_failure={"*": FailureRule.fire("give_up")})
    ((severity, text),) = said(failing, "tasks")
    assert severity is WARNING
    assert text.startswith("a robot whose action fails in Carry fires give_up, which ends no task")


@pytest.mark.long
def test_tasks_that_are_never_done_or_end_with_a_robot():
    texts = [text for _, text in said(couriers(()), "tasks")]
    assert "tasks.done lists no transition: no task is ever done" in texts
    net = (
        NetBuilder()
        .place("Idle", 1)
        .place("Gone")
        .place("orders")
        .exponential("order", rate=1, outputs="orders")
        .exponential("expire", rate=1, inputs="orders")
        .immediate("take", inputs=["Idle", "orders"], outputs="Gone")
        .build()
    )
    resources = frozenset(["orders"])
    plan = plan_of(net, resource_places=resources, tasks=Tasks(("orders",), ("take",)))
    texts = [text for _, text in said(plan, "tasks", standalone=True, limit=2_000, seconds=0)]
    assert texts[0].startswith("expire takes a task from its queue, but no robot gets it")
    assert "a robot can end in Gone with an unfinished task" in texts


@pytest.mark.long
def test_a_task_that_goes_back_to_its_queue_is_not_carried_on():
    net = (
        NetBuilder()
        .place("Idle", 1)
        .place("Carry")
        .place("orders", 0)
        .exponential("order", rate=1, outputs="orders")
        .immediate("take", inputs=["Idle", "orders"], outputs="Carry")
        .exponential("deliver", rate=1, inputs="Carry", outputs="Idle")
        .exponential("low", rate=1, inputs="Carry", outputs=["Idle", "orders"])
        .build()
    )
    plan = plan_of(
        net,
        resource_places=frozenset(["orders"]),
        tasks=Tasks(("orders",), ("deliver",)),
        events={"low": EVENT},
    )
    found = said(plan, "tasks", standalone=True, limit=2_000, seconds=0)
    assert [severity for severity, _ in found] == [OK]


# -- data ------------------------------------------------------------------------------------------

READS = PublishAction("/out", "std_msgs/String", {"data": {"from": "pose"}})
KEEPS = WaitAction("/in", "std_msgs/String", keep={"robot.pose": "data"})
SILENT = ServiceAction("/s", "std_srvs/Empty")


def with_actions(work, charge):
    return replace(guards(), actions={"Work": work, "Charge": charge}).validate()


@pytest.mark.parametrize(
    ("other", "severity", "text"),
    [
        (SILENT, WARNING, "reads 'robot.pose', which is never written: the action fails there"),
        (FunctionAction("a.f", "f"), OK, "only the functions and ExecGSPN servers of Charge can"),
        (KEEPS, OK, "every name that an action reads is written"),
    ],
)
def test_a_name_that_nothing_writes(other, severity, text):
    ((found, said_text),) = said(with_actions(READS, other), "data")
    assert found is severity and text in said_text


def test_data_of_tasks():
    reads = PublishAction("/out", "std_msgs/String", {"data": {"from": "task.pose"}})
    ((severity, text),) = said(with_actions(reads, SILENT), "data")
    assert severity is WARNING and "no robot ever carries a task" in text
    plan = couriers()
    plan = replace(plan, actions={"Idle": None, "Carry": reads}).validate()
    ((severity, text),) = said(plan, "data")
    assert severity is OK and "submitted tasks must contain it" in text
    known = reads._replace(message={"data": {"from": "task.id"}})
    plan = replace(plan, actions={"Idle": None, "Carry": known}).validate()
    assert said(plan, "data") == [(OK, "every name that an action reads is written")]
