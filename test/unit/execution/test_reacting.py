"""Events that interrupt, tasks and data in the token game."""

from __future__ import annotations

import dataclasses
from typing import Any, List

import pytest
from game_driver import Run, make_plan
from logged_runs import Story

from gspn_framework_package.execution import log_entries, plan_change, task_turn, team_state
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.event_watch import EventWatch, Visit, asked_anew
from gspn_framework_package.execution.firing import CancelAction, Fault, StartAction, TaskMove
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.verifier import cargo, verify
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.data import check_values
from gspn_framework_package.model.errors import LogError, PlanError
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan


def guard_net() -> Net:
    """A robot works; an event sends it to a charger with one dock, and back."""
    return (
        NetBuilder()
        .place("Work")
        .place("Charge")
        .place("Dock", 1)
        .exponential("finish", rate=1, inputs="Work", outputs="Work")
        .exponential("low", rate=0.1, inputs=["Work", "Dock"], outputs="Charge")
        .exponential("full", rate=1, inputs="Charge", outputs=["Work", "Dock"])
        .build()
    )


def guard(robots: int = 1, **event: Any) -> Run:
    plan = make_plan(
        guard_net(),
        ["Work"] * robots,
        ["Dock"],
        events={"low": EventSource("battery", "a/B", **event)},
    )
    return Run(plan)


def starts(run: Run) -> List[StartAction]:
    return [c for c in run.commands if isinstance(c, StartAction)]


def test_an_event_cancels_the_action_and_moves_the_robot():
    run = guard()
    assert run.event("a", "low", {"percentage": 0.1}) == ["low"]
    assert run.place("a") == "Charge"
    assert [c for c in run.commands if isinstance(c, CancelAction)] == [CancelAction("a", 1)]
    assert starts(run)[-1][:2] == ("a", "Charge")
    # the action had ended in the same moment: too late
    assert run.feed(log_entries.Done("a", 0, 1, "finish")) == []


def test_of_a_result_and_an_event_the_first_in_the_log_wins():
    run = guard()
    late = log_entries.Interrupt("a", 0, 1, "low")
    assert run.done("a", "finish") == ["finish"]
    assert run.feed(late) == []
    assert run.place("a") == "Work"


def test_an_event_whose_transition_is_not_enabled_changes_nothing():
    run = guard(2)
    assert run.event("a", "low") == ["low"]
    assert run.event("b", "low") == []
    assert run.state.robots["b"].phase is Phase.DOING
    assert run.done("a") == ["full"]
    assert run.place("b") == "Work"


def test_a_held_event_fires_as_soon_as_it_can():
    run = guard(2, hold=True)
    run.event("a", "low")
    assert run.event("b", "low", {"percentage": 0.05}) == []
    assert run.done("a") == ["full", "low"]
    assert run.firings[-1].cause == {"percentage": 0.05}
    assert run.place("b") == "Charge"
    assert not run.state.robots["b"].held


def test_a_held_event_is_void_when_the_robot_moves_on():
    run = guard(2, hold=True)
    run.event("a", "low")
    run.event("b", "low")
    assert run.done("b", "finish") == ["finish"]
    assert run.done("a") == ["full"]
    assert run.place("b") == "Work"


def test_a_pause_delays_an_event():
    run = guard()
    run.feed(log_entries.Pause("a"))
    assert run.event("a", "low") == []
    assert run.feed(log_entries.Resume("a")) == ["low"]


def test_an_event_frees_a_robot_whose_action_failed():
    run = guard()
    run.fail("a")
    assert run.event("a", "low") == ["low"]


def test_the_next_visit_learns_which_one_it_continues():
    run = guard(resume=True)
    run.event("a", "low")
    run.done("a")
    assert starts(run)[-1].resumed_from == 1
    run.done("a", "finish")
    assert starts(run)[-1].resumed_from == 0


def test_an_event_of_a_former_life_is_void():
    run = guard()
    run.feed(log_entries.Join("a", 1, "Work"))
    assert run.feed(log_entries.Interrupt("a", 0, 1, "low")) == []
    assert run.feed(log_entries.Interrupt("a", 1, 1, "low")) == ["low"]


def test_an_unknown_event_is_void():
    run = guard()
    assert run.event("a", "finish") == []
    assert run.event("a", "no such") == []


# -- tasks -------------------------------------------------------------------------------------


def shop_net() -> Net:
    """Orders come in, robots take them, deliver them or give them back."""
    return (
        NetBuilder()
        .place("Idle")
        .place("Deliver")
        .place("Orders", capacity=3)
        .exponential("order", rate=1, outputs="Orders")
        .immediate("take", inputs=["Idle", "Orders"], outputs="Deliver")
        .exponential("delivered", rate=1, inputs="Deliver", outputs="Idle")
        .exponential("refused", rate=1, inputs="Deliver", outputs=["Idle", "Orders"])
        .build()
    )


def shop(robots: int = 1, **fields: Any) -> Run:
    plan = make_plan(
        shop_net(),
        ["Idle"] * robots,
        ["Orders"],
        idle=["Idle"],
        tasks=Tasks(("Orders",), ("delivered",)),
        on_evict={"Deliver": {"Orders": 1}},
        **fields,
    )
    return Run(plan, in_order=True)


def submit(number: int, **data: Any) -> log_entries.Submit:
    return log_entries.Submit("order", "o%d" % number, data)


def test_tasks_are_taken_in_the_order_in_which_they_came():
    run = shop()
    assert run.feed(submit(1, pose=[1, 2])) == ["order", "take"]
    assert run.feed(submit(2), submit(3)) == ["order", "order"]
    assert starts(run)[-1].data == {"task.id": "o1", "task.pose": [1, 2]}
    assert run.done("a", "delivered") == ["delivered", "take"]
    assert run.state.robots["a"].task.id == "o2"
    moves = [move for firing in run.firings for move in firing.tasks if move.id == "o1"]
    assert moves == [
        TaskMove("o1", "", "place Orders"),
        TaskMove("o1", "place Orders", "robot a"),
        TaskMove("o1", "robot a", "done"),
    ]


def test_a_task_comes_once():
    run = shop()
    assert run.feed(submit(1), submit(1)) == ["order", "take"]
    assert run.done("a", "delivered") == ["delivered"]
    assert run.feed(submit(1)) == []


def test_a_task_waits_until_its_transition_is_enabled():
    run = shop()
    run.feed(*(submit(n) for n in range(1, 7)))
    assert [task.id for _, task in run.state.submitted] == ["o5", "o6"]
    assert run.done("a", "delivered") == ["delivered", "take", "order"]
    assert [task.id for _, task in run.state.submitted] == ["o6"]


def test_a_task_that_waits_is_never_forgotten(monkeypatch):
    monkeypatch.setattr(task_turn, "KNOWN_TASKS", 2)
    monkeypatch.setattr(cargo, "REMEMBERED_TASKS", 2)
    run = shop()
    checker = cargo.Cargo(run.game.plan, {}, {})
    for number in [*range(1, 9), 5, 8]:  # one is carried, three are in the queue, four wait outside
        run.feed(submit(number))
        checker.comes(submit(number))
    assert [task.id for _, task in run.state.submitted] == ["o5", "o6", "o7", "o8"]
    assert [task.id for _, task in checker.outside] == ["o%d" % n for n in range(1, 9)]
    for _ in range(6):
        run.done("a", "delivered")
    run.feed(submit(9))
    order = run.game.net.transition_number("order")
    assert list(run.state.known[order]) == ["o8", "o9"]  # nothing waits: no more than it says
    assert run.state.submitted == []


def test_so_many_tasks_wait_and_no_more(monkeypatch):
    monkeypatch.setattr(team_state, "OUTSIDE_LIMIT", 2)
    monkeypatch.setattr(cargo, "MOST_OUTSIDE", 2)
    run = shop()
    for number in range(1, 8):  # one is carried, three are in the queue
        run.feed(submit(number))
    assert [task.id for _, task in run.state.submitted] == ["o5", "o6"]
    order = run.game.net.transition_number("order")
    assert not run.state.is_known(order, "o7")
    checker = cargo.Cargo(run.game.plan, {}, {})
    for number in (1, 2, 3):
        checker.comes(submit(number))
    assert [task.id for _, task in checker.outside] == ["o1", "o2"]
    run.done("a", "delivered")
    run.feed(submit(7))  # there is room again
    assert [task.id for _, task in run.state.submitted] == ["o6", "o7"]


def test_a_robot_puts_its_task_back():
    run = shop()
    run.feed(submit(1))
    assert run.done("a", "refused") == ["refused", "take"]
    assert run.state.robots["a"].task.id == "o1"


def test_the_task_of_a_lost_robot_is_the_next():
    run = shop(2)
    run.feed(submit(1), submit(2), submit(3))
    assert {r.name: r.task.id for r in run.state.active()} == {"a": "o1", "b": "o2"}
    run.feed(log_entries.Evict("a", 0))
    assert [task.id for task in next(iter(run.state.queues.values()))] == ["o1", "o3"]
    assert run.done("b", "delivered") == ["delivered", "take"]
    assert run.state.robots["b"].task.id == "o1"
    # it gave back what it held, so it does not go on where it was
    run.feed(log_entries.Join("a", 1, "Idle"))
    assert run.state.robots["a"].task.id == "o3"


def test_a_robot_that_leaves_gives_back_too():
    run = shop(2)
    run.feed(submit(1))
    run.feed(log_entries.Leave("a"))
    assert run.state.robots["b"].task.id == "o1"


def faults(run: Run) -> List[str]:
    return [c.message for c in run.commands if isinstance(c, Fault)]


def carried(run: Run) -> Any:
    return {r.name: r.task.id for r in run.state.robots.values() if r.task is not None}


def test_a_robot_that_is_put_where_no_task_belongs_gives_it_back():
    run = shop(2)
    run.feed(submit(1))
    run.feed(log_entries.SetPlace("a", "Deliver"))  # there it keeps it
    assert carried(run) == {"a": "o1"}
    assert run.feed(log_entries.SetPlace("a", "Idle")) == ["take"]
    assert carried(run) == {"b": "o1"}
    assert "returns task o1 to Orders" in faults(run)
    # as an entry of an earlier version is read
    old = log_entries.from_json({"entry": "set_place", "robot": "b", "place": "Idle"})
    assert not old.returns and log_entries.to_json(old).keys() == {"entry", "robot", "place"}
    assert run.feed(old) == []
    assert carried(run) == {"b": "o1"}


def test_a_task_that_is_with_a_robot_that_is_gone_is_named_and_can_come_again():
    for gone in (log_entries.Leave("a"), log_entries.Evict("a", 0)):
        plan = make_plan(
            shop_net(), ["Idle"] * 2, ["Orders"], idle=["Idle"], tasks=Tasks(("Orders",), ())
        )
        run = Run(plan, in_order=True)
        run.feed(submit(1))
        assert run.fail("a") == []
        assert "waits for the operator, with task o1" in faults(run)[-1]
        run.feed(log_entries.SetPlace("a", "Idle"))
        assert "keeps task o1 in Idle, because Deliver returns it to no queue" in faults(run)[-1]
        assert not run.state.with_again(submit(1), run.game.net).again
        run.feed(gone)
        assert "is gone with task o1, which Idle returns to no queue" in faults(run)[-1]
        assert run.feed(submit(1)) == []  # one that comes twice
        again = run.state.with_again(submit(1), run.game.net)
        assert again.again and run.feed(again, again) == ["order", "take"]
        assert carried(run) == {"b": "o1"}
        run.feed(submit(2))
        run.feed(log_entries.Stop())
        text = "the run ends with 2 unfinished tasks: o1 with b, o2 in Orders"
        assert text in faults(run)


@pytest.mark.parametrize("gives_back", [False, True])
@pytest.mark.parametrize("returns", [False, True])
def test_the_verifier_follows_tasks_that_return_and_that_come_again(tmp_path, gives_back, returns):
    plan = shop(2).game.plan
    if not gives_back:
        plan = dataclasses.replace(plan, on_evict={})
    story = Story(plan).start()
    story.slot(1.0, submit(1, pose=1))
    story.slot(2.0, log_entries.SetPlace("a", "Idle", returns=returns))
    story.slot(3.0, log_entries.Leave("a"))
    team = story.ledger.state
    story.slot(4.0, team.with_again(submit(1, pose=2), plan.net))
    story.slot(5.0, submit(2))
    story.slot(6.0, log_entries.Done("b", 0, team.robots["b"].visit, "delivered"))
    log = read_log(story.save(tmp_path / "run.jsonl"))
    assert verify([log]).violation is None
    done = [m.id for r in story.records for f in r.get("firings", ()) for m in tasks_of(f)]
    assert done == ["o1"]


def tasks_of(firing: Any) -> Any:
    return [TaskMove(*move) for move in firing.get("tasks", ()) if move[2] == "done"]


def test_a_plan_without_a_queue_names_the_tasks_that_robots_keep():
    run = shop()
    run.feed(submit(1))
    plan = make_plan(shop_net(), ["Idle"], ["Orders"], idle=["Idle"])
    stage = plan_change.stage_of(plan, {})
    run.feed(stage, log_entries.Staged("a", 0, 1), log_entries.Adopt(1))
    assert run.state.adopted is not None
    assert "keeps task o1, but the plan has no queue" in faults(run)


def test_a_second_task_pushes_out_the_first_and_that_is_reported():
    net = (
        NetBuilder()
        .place("Go")
        .place("Orders", 2)
        .immediate("take", inputs=["Go", "Orders"], outputs="Go")
        .exponential("order", rate=1, outputs="Orders")
        .build()
    )
    plan = make_plan(net.with_marking({"Orders": 0}), ["Go"], ["Orders"], tasks=Tasks(("Orders",)))
    run = Run(plan)
    run.feed(submit(1))
    run.done("a")
    run.feed(submit(2))
    assert run.done("a") == ["take"]
    assert run.firings[-1].tasks == (
        TaskMove("o1", "robot a", "dropped"),
        TaskMove("o2", "place Orders", "robot a"),
    )
    assert any(isinstance(c, Fault) and "o1" in c.message for c in run.commands)


def test_a_task_for_another_transition_is_refused_and_reported():
    run = shop()
    assert run.feed(log_entries.Submit("delivered", "x")) == []
    assert [c.message for c in run.commands if isinstance(c, Fault)] == [
        "task x is refused: 'delivered' does not take tasks"
    ]


def test_a_task_that_comes_in_without_a_queue_is_done_with_the_firing():
    net = NetBuilder().place("Go").place("rings").exponential("ring", rate=1, outputs="rings")
    plan = make_plan(net.build(), ["Go"], ["rings"], events={"ring": EventSource("bell", "a/B")})
    run = Run(plan)
    run.feed(log_entries.Submit("ring", "r1"))
    assert run.firings[-1].tasks == (TaskMove("r1", "", "done"),)
    assert not [c for c in run.commands if isinstance(c, Fault)]


def test_a_task_that_a_resource_transition_takes_is_dropped_and_that_is_reported():
    net = (
        NetBuilder()
        .place("Go")
        .place("Orders")
        .place("refused")
        .exponential("order", rate=1, outputs="Orders")
        .immediate("refuse", inputs="Orders", outputs="refused")
        .build()
    )
    run = Run(make_plan(net, ["Go"], ["Orders", "refused"], tasks=Tasks(("Orders",))))
    assert run.feed(submit(1)) == ["order", "refuse"]
    assert run.firings[-1].tasks == (TaskMove("o1", "place Orders", "dropped"),)
    assert [c.message for c in run.commands if isinstance(c, Fault)] == [
        "drops task o1, which was not done"
    ]


def test_a_robot_that_waits_for_an_event_asks_no_policy():
    net = NetBuilder().place("Wait").exponential("go", rate=1, inputs="Wait", outputs="Wait")
    event = {"go": EventSource("bell", "a/B")}
    run = Run(make_plan(net.build(), ["Wait"], events=event, strict=True))
    run.done("a")
    assert not [c for c in run.commands if isinstance(c, Fault)]
    assert run.why("a") == "waits for an event"


# -- data --------------------------------------------------------------------------------------


def test_data_reaches_the_next_actions():
    run = shop(2)
    run.feed(submit(1), submit(2))
    run.done("a", "refused", {"speed": 2, "team.door": "open", "task.tried": True})
    assert run.state.data_of(run.state.robots["a"]) == {
        "robot.speed": 2,
        "team.door": "open",
        "task.id": "o1",
        "task.tried": True,
    }
    run.done("b", "refused")
    assert starts(run)[-1].data == {"team.door": "open", "task.id": "o2"}


def test_data_of_a_task_needs_a_task():
    run = guard()
    assert run.done("a", "finish", {"task.x": 1}) == []
    assert run.state.robots["a"].phase is Phase.FAILED


def test_data_is_kept_as_json_keeps_it():
    given = {"x": ({1: "one"},)}
    kept = check_values(given)
    assert kept == {"x": [{"1": "one"}]}
    given["x"][0][1] = "two"
    assert kept == {"x": [{"1": "one"}]}


@pytest.mark.parametrize(
    "data",
    [
        {"a b": 1},
        {"x": float("nan")},
        {"x": "y" * 70_000},
        {"x%d" % n: "y" * 60_000 for n in range(5)},
        {"other.x": 1},
        [1],
    ],
)
def test_data_that_cannot_be_kept_is_no_entry(data: Any):
    entry = {"entry": "done", "robot": "a", "incarnation": 0, "visit": 1, "data": data}
    with pytest.raises(LogError):
        log_entries.from_json(entry)


def test_entries_without_data_are_written_as_before():
    assert log_entries.to_json(log_entries.Done("a", 0, 1, "t")) == {
        "entry": "done",
        "robot": "a",
        "incarnation": 0,
        "visit": 1,
        "result": "t",
    }
    for entry in (submit(1, x=[1]), log_entries.Interrupt("a", 0, 1, "low", {"p": 1})):
        assert log_entries.from_json(log_entries.to_json(entry)) == entry


def test_an_order_says_who_gave_it_if_that_is_known():
    given = log_entries.Pause("a", log_entries.Giver("ann", "certificate"))
    written = {"entry": "pause", "robot": "a", "by": ["ann", "certificate"]}
    assert log_entries.to_json(given) == written
    assert log_entries.from_json(written) == given
    old = {"entry": "pause", "robot": "a"}
    assert log_entries.to_json(log_entries.Pause("a")) == old
    assert log_entries.from_json(old).by == log_entries.NOBODY


@pytest.mark.parametrize(
    "by", ["ann", ["ann"], ["ann", 1], ["ann", "", ""], ["", ""], ["a" * 201, ""], {"a": ""}]
)
def test_who_gave_an_order_has_a_form_and_a_bound(by: Any):
    with pytest.raises(LogError, match="its field 'by' "):
        log_entries.from_json({"entry": "pause", "robot": "a", "by": by})
    with pytest.raises(LogError, match="unexpected keyword"):
        log_entries.from_json(
            {"entry": "staged", "robot": "a", "incarnation": 0, "stage": 1, "by": ["ann", ""]}
        )


# -- the plan ----------------------------------------------------------------------------------


def test_an_event_needs_an_exponential_transition_of_one_robot():
    with pytest.raises(PlanError, match="immediate"):
        make_plan(shop_net(), [], ["Orders"], events={"take": EventSource("t", "a/B")})
    with pytest.raises(PlanError, match="no transition"):
        make_plan(shop_net(), [], ["Orders"], events={"x": EventSource("t", "a/B")})
    with pytest.raises(PlanError, match="not a resource place"):
        make_plan(shop_net(), [], ["Orders"], tasks=Tasks(("Idle",)))


def test_hours_are_for_transitions_that_move_a_clock_and_that_stop():
    net = NetBuilder().place("am", tokens=1).place("pm")
    net.exponential("noon", inputs="am", outputs="pm").exponential(
        "night", inputs="pm", outputs="am"
    )
    net.exponential("order", outputs="pm")
    noon, night = EventSource(from_hour=12, to_hour=0), EventSource(from_hour=0, to_hour=12)
    made = make_plan(net.build(), [], ["am", "pm"], events={"noon": noon, "night": night})
    assert (made.clock, made.submissions) == (("noon", "night"), ())
    assert [noon.seconds_to_hours(3600 * hour) for hour in (11, 12, 23.5, 24)] == [
        3600,
        0,
        0,
        43200,
    ]
    with pytest.raises(PlanError, match="at 11 h the transitions of the clock fire in a cycle"):
        early = {"noon": noon._replace(from_hour=11), "night": night}
        make_plan(net.build(), [], ["am", "pm"], events=early)
    with pytest.raises(PlanError, match="only a transition that takes a resource"):
        make_plan(net.build(), [], ["am", "pm"], events={"order": noon})
    with pytest.raises(PlanError, match="only a transition that takes a resource"):
        make_plan(shop_net(), ["Idle"], ["Orders"], events={"delivered": noon})


def test_a_plan_without_events_and_tasks_keeps_its_hash():
    plan = make_plan(guard_net(), ["Work"], ["Dock"])
    assert "events" not in plan._essence() and "tasks" not in plan._essence()
    assert isinstance(plan, Plan)


def test_what_a_function_showed_before_a_visit_does_not_count_in_it():
    """It is asked anew; a topic is not, and what it showed last still holds."""
    plan = make_plan(
        guard_net(),
        ["Work"],
        ["Dock"],
        events={"low": EventSource("battery", "a/B", function="watch.low")},
    )
    for topics, expected in ((True, 1), (False, 0)):
        watch = EventWatch(plan, "a", asked_anew(plan, topics))
        watch.due(Visit("Charge", 0, 1), 0.0)
        watch.observe("low", True)
        assert len(watch.due(Visit("Work", 0, 2), 1.0)) == expected
    watch.observe("low", True)
    assert len(watch.due(Visit("Work", 0, 2), 2.0)) == 1
