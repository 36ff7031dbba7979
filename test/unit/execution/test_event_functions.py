"""Events and tasks of standalone runs: from functions, by time, and submitted."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple

import pytest
from game_driver import make_plan
from test_reacting import guard_net, shop_net
from test_standalone import DEADLINE, Recorder
from waiting import wait_for

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_functions import EventFunctions, EventHost
from gspn_framework_package.execution.standalone import StandaloneExecutor
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import DataError, PlanError, UsageError
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.plan import Plan

PARTS = """
import threading

low, other, deaf = threading.Event(), threading.Event(), threading.Event()
ran = []

def act(place, data, visit, resumed_from, is_cancelled):
    ran.append((place, visit, resumed_from, dict(data)))
    if place == "Work":
        is_cancelled.wait(60)
        if deaf.is_set():
            other.wait(60)
    if place == "Charge":
        return None, {"battery": 1}
    if place == "Deliver":
        return "delivered", {"team.last": data["task.id"]}
    return None

def is_low(robot):
    return {"level": 0.1, "of": robot} if low.is_set() else False

def pressed(emit, is_cancelled, data):
    while not is_cancelled():
        if low.wait(0.01):
            low.clear()
            emit(seen=sorted(data))

def orders():
    return [{"id": 1, "pose": [1, 2]}, {"pose": [3, 4]}] if low.is_set() else None

def send(emit):
    emit(id="x", pose=[5])

def is_empty(data):
    return data.get("robot.battery", 0) < 1

def broken():
    raise ValueError("no sensor")

def odd():
    return "yes"
"""


def in_folder(folder: Path, plan: Plan) -> Plan:
    """The plan, with the functions above in its folder."""
    (folder / "parts.py").write_text(PARTS)
    actions: Dict[str, Any] = {
        place: FunctionAction("parts.act", place) if action is not None else None
        for place, action in plan.actions.items()
    }
    return replace(plan, folder=str(folder), actions=actions).validate()


def guard(folder: Path, function: str = "", robots: int = 1, **event: Any) -> Plan:
    source = EventSource(**{"function": function and "parts." + function, "every": 0.01, **event})
    plan = make_plan(guard_net(), ["Work"] * robots, ["Dock"], events={"low": source})
    return in_folder(folder, replace(plan, cancel_grace=0.05))


def shop(folder: Path, function: str = "", **fields: Any) -> Plan:
    events = {"order": EventSource(function="parts." + function, every=0.01)} if function else {}
    plan = make_plan(
        shop_net(),
        ["Idle"],
        ["Orders"],
        idle=["Idle"],
        tasks=Tasks(("Orders",), ("delivered",)),
        events=events,
        **fields,
    )
    return in_folder(folder, plan)


class Run:
    """A run that ends with the test."""

    def __init__(self, plan: Plan) -> None:
        self.recorder = Recorder()
        self.executor = StandaloneExecutor(plan, self.recorder)
        file = str(Path(str(plan.folder)) / "parts.py")
        self.parts = next(m for m in sys.modules.values() if getattr(m, "__file__", "") == file)

    def __enter__(self) -> Run:
        self.executor.start()
        return self

    def __exit__(self, *error: Any) -> None:
        self.parts.other.set()
        self.executor.stop()
        self.executor.wait(DEADLINE)

    def until_fired(self, *transitions: str) -> None:
        self.recorder.until(lambda: self.fired()[: len(transitions)] == list(transitions))

    def fired(self) -> List[str]:
        return [firing.transition for firing in self.recorder.firings]

    def entries(self, kind: type) -> List[Any]:
        return [e for batch in self.recorder.entries for e in batch if isinstance(e, kind)]


def test_a_function_interrupts_an_action_and_gives_the_cause(tmp_path: Path) -> None:
    with Run(guard(tmp_path, "is_low", resume=True)) as run:
        run.parts.low.set()
        run.until_fired("low", "full", "low")  # it still holds when the robot is back
        run.parts.low.clear()
        assert run.entries(log_entries.Interrupt)[0] == (
            "a",
            0,
            1,
            "low",
            {"level": 0.1, "of": "a"},
        )
        # two threads write: each visit to Work ends at once
        wait_for(lambda: ("Work", 3, 1) in [r[:3] for r in run.parts.ran], DEADLINE)
        assert ("Work", 1, 0) in [r[:3] for r in run.parts.ran]


def test_what_a_function_said_of_the_data_before_does_not_count(tmp_path: Path) -> None:
    with Run(guard(tmp_path, "is_empty", every=30.0)) as run:
        run.until_fired("low", "full")
        wait_for(lambda: ("Work", 3, 0) in [r[:3] for r in run.parts.ran], DEADLINE)
        run.executor.order(log_entries.Pause())
        run.recorder.until(lambda: run.entries(log_entries.Pause))
        assert run.fired() == ["low", "full"]


def test_with_edge_an_event_that_lasts_interrupts_once(tmp_path: Path) -> None:
    with Run(guard(tmp_path, "is_low", edge=True)) as run:
        run.parts.low.set()
        run.until_fired("low", "full")
        run.parts.low.clear()
        wait_for(lambda: len(run.parts.ran) == 3, DEADLINE)
        run.executor.order(log_entries.Pause())
        run.recorder.until(lambda: run.entries(log_entries.Pause))
        assert run.fired() == ["low", "full"]


def test_a_function_that_emits_runs_once_for_each_agent(tmp_path: Path) -> None:
    with Run(guard(tmp_path, "pressed")) as run:
        run.parts.low.set()
        run.until_fired("low", "full")
        wait_for(lambda: run.parts.ran[-1][0] == "Work", DEADLINE)
        run.parts.low.set()
        run.until_fired("low", "full", "low")
        causes = [e.cause for e in run.entries(log_entries.Interrupt)]
        assert causes == [{"seen": []}, {"seen": ["robot.battery"]}]


def test_time_interrupts_each_visit(tmp_path: Path) -> None:
    with Run(guard(tmp_path, after=0.05)) as run:
        run.until_fired("low", "full", "low", "full", "low")
        assert run.entries(log_entries.Interrupt)[0].cause == {"after": 0.05}


def test_an_action_that_does_not_end_when_it_is_cancelled_is_reported(tmp_path: Path) -> None:
    with Run(guard(tmp_path, after=0.05)) as run:
        run.parts.deaf.set()
        run.recorder.until(lambda: run.recorder.faults)
        assert run.recorder.faults[0] == (
            "the action of its visit 1 was cancelled, but has not ended for 0.05 s"
        )


@pytest.mark.parametrize(
    ("function", "text"),
    [
        ("broken", "failed: ValueError: no sensor"),
        ("odd", "failed: the function returned 'yes', not True"),
    ],
)
def test_a_function_that_fails_is_reported_once(tmp_path: Path, function: str, text: str) -> None:
    with Run(guard(tmp_path, function)) as run:
        run.recorder.until(lambda: run.recorder.faults)
        assert text in run.recorder.faults[0]
        assert "parts.%s" % function in run.recorder.faults[0]
        run.executor.order(log_entries.Retry("a"))
        run.recorder.until(lambda: run.entries(log_entries.Retry))
        assert len(run.recorder.faults) == 1


def test_a_missing_function_is_found_before_the_run(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match="no 'missing'"):
        StandaloneExecutor(guard(tmp_path, "missing"))
    (tmp_path / "more.py").write_text("def f(place): pass\n")
    with pytest.raises(PlanError, match="'place' is not one that an event function can ask for"):
        StandaloneExecutor(replace(guard(tmp_path), events={"low": EventSource(function="more.f")}))


# -- tasks -------------------------------------------------------------------------------------


def test_a_function_lets_tasks_in(tmp_path: Path) -> None:
    with Run(shop(tmp_path, "orders")) as run:
        run.parts.low.set()
        wait_for(lambda: len(run.parts.ran) >= 3, DEADLINE)
        run.parts.low.clear()
        found = [r[3]["task.pose"] for r in run.parts.ran if r[3]["task.id"] == "1"]
        assert found == [[1, 2]]  # asked many times, with the same id
        others = [r[3] for r in run.parts.ran if r[3]["task.id"] != "1"]
        assert others[0]["task.id"] == "order-1"
        assert others[0]["team.last"] == "1"


def test_a_function_may_emit_a_task(tmp_path: Path) -> None:
    with Run(shop(tmp_path, "send")) as run:
        run.until_fired("order", "take", "delivered")
        assert run.parts.ran[0][3] == {"task.id": "x", "task.pose": [5]}


def test_tasks_are_submitted_once_by_id(tmp_path: Path) -> None:
    with Run(shop(tmp_path)) as run:
        executor = run.executor
        assert executor.submit("order", {"pose": 1}, "a") == "a"
        assert executor.submit("order", {"pose": 2}, "a") == "a"
        assert executor.submit("order", {"pose": 3}) == "order-1"
        wait_for(lambda: len(run.parts.ran) == 2, DEADLINE)
        assert [r[3]["task.pose"] for r in run.parts.ran] == [1, 3]
        with pytest.raises(UsageError, match="'take' does not take tasks"):
            executor.submit("take")
        with pytest.raises(DataError, match="'task.pose' is not a valid name"):
            executor.submit("order", {"task.pose": 1})
        with pytest.raises(DataError, match="is not JSON"):
            executor.submit("order", {"pose": {1, 2}})


def test_the_simulated_environment_makes_tasks(tmp_path: Path) -> None:
    plan = shop(tmp_path, simulate_environment=True)
    plan = plan.with_rates({"order": 100.0})
    with Run(plan) as run:
        wait_for(lambda: len(run.parts.ran) >= 3, DEADLINE)
        ids = [r[3]["task.id"] for r in run.parts.ran]
        assert len(set(ids)) == len(ids)
        assert all(i.startswith("order-") for i in ids)
    # a task that a function lets in is not drawn as well
    with Run(replace(plan, events={"order": EventSource(function="parts.send")})) as run:
        run.until_fired("order", "take", "delivered")
        assert {e.id for e in run.entries(log_entries.Submit)} == {"x"}


# -- the functions by themselves ---------------------------------------------------------------


class Host:
    """Keeps what the functions report."""

    def __init__(self) -> None:
        self.seen: List[Tuple[str, str, Optional[bool], Mapping[str, Any]]] = []
        self.tasks: List[log_entries.Submit] = []
        self.faults: List[Tuple[str, str]] = []
        self.host = EventHost(
            lambda *seen: self.seen.append(seen),
            self.tasks.append,
            lambda *fault: self.faults.append(fault),
            lambda robot: {"robot.name": robot},
        )

    def until(self, condition: Callable[[], Any]) -> None:
        wait_for(condition, DEADLINE)


def test_only_changes_are_reported(tmp_path: Path) -> None:
    (tmp_path / "more.py").write_text(
        "import threading\nstep = threading.Semaphore(0)\nanswers = [False, True, True, {'a': 1}, "
        "None, {}, True]\ndef f():\n    step.acquire()\n    return answers.pop(0)\n"
    )
    plan = replace(
        guard(tmp_path), events={"low": EventSource(function="more.f", every=0.001)}
    ).validate()
    host = Host()
    functions = EventFunctions(plan, host.host, topics=False)
    more = next(
        m for m in sys.modules.values() if getattr(m, "__file__", "") == str(tmp_path / "more.py")
    )
    functions.watch("a")
    for _ in range(6):
        more.step.release()
    host.until(lambda: len(host.seen) == 3)
    functions.forget("a")
    more.step.release()  # it is in its last call, or will not be called again
    assert host.seen == [
        ("a", "low", True, {}),
        ("a", "low", False, {}),
        ("a", "low", True, {}),
    ]


def test_with_topics_at_hand_a_function_beside_one_is_not_used(tmp_path: Path) -> None:
    plan = guard(tmp_path, "is_low", topic="battery", type="a/B")
    assert EventFunctions(plan, Host().host, topics=True).interrupts == ()
    assert EventFunctions(plan, Host().host, topics=False).interrupts == ("low",)
