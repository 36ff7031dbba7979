"""Standalone execution: agents on threads (thesis 4.1)."""

from __future__ import annotations

import queue
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Dict, List, Tuple

import pytest
from full_disk import fill_the_disk
from waiting import wait_for

from gspn_framework_package.execution import log_entries, standalone
from gspn_framework_package.execution.event_log import header, read_log
from gspn_framework_package.execution.firing import Firing, TaskEnded
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.standalone import Listener, StandaloneExecutor
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.execution.worker_pool import WorkerPool
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.plan_json import plan_from_json
from gspn_framework_package.making import templates
from gspn_framework_package.model.errors import ExecutionError, PlanError, UsageError
from gspn_framework_package.model.plan import Plan

DEADLINE = 20.0


def write_plan(folder: Path, actions: str, **data: Any) -> Plan:
    """A plan whose net and functions are given as text: ``net`` maps transitions to (timed, in,
    out)."""
    (folder / "work.py").write_text(actions)
    net: Dict[str, Tuple[bool, List[str], List[str]]] = data.pop("net")
    tokens: Dict[str, int] = data.pop("tokens")
    names = sorted({p for _, i, o in net.values() for p in i + o} | set(tokens))
    data["net"] = {
        "places": [{"name": n, "tokens": tokens.get(n, 0)} for n in names],
        "transitions": [{"name": t, "timed": timed} for t, (timed, _, _) in net.items()],
        "arcs": [{"from": p, "to": t} for t, (_, i, _) in net.items() for p in i]
        + [{"from": t, "to": p} for t, (_, _, o) in net.items() for p in o],
    }
    bound = data.pop("bound", {})
    resources = data.get("resource_places", [])
    data["actions"] = {n: bound.get(n, "work.go") for n in names if n not in resources}
    data.setdefault("robots", {})
    plan = plan_from_json(data, folder=str(folder))
    if not plan.robots:
        from gspn_framework_package.formats.plan_json import deal_robots

        plan = plan.with_robots(list(deal_robots(plan.net, plan.resource_places, prefix="")))
    return plan


class Recorder(Listener):
    """Keeps everything, and lets a test wait for it."""

    def __init__(self) -> None:
        self.entries: List[List[Any]] = []
        self.firings: List[Firing] = []
        self.states: Dict[str, List[Phase]] = {}
        self.faults: List[str] = []
        self.feedback: List[Any] = []
        self._news = threading.Condition()

    def on_step(self, slot: int, entries: Any, firings: Any, state: Any) -> None:
        with self._news:
            self.entries.append(list(entries))
            self.firings += firings
            self._news.notify_all()

    def on_phase(self, agent: str, phase: Phase) -> None:
        with self._news:
            self.states.setdefault(agent, []).append(phase)
            self._news.notify_all()

    def on_fault(self, agent: str, message: str) -> None:
        with self._news:
            self.faults.append(message)
            self._news.notify_all()

    def on_feedback(self, agent: str, visit: int, progress: Any) -> None:
        self.feedback.append(progress)

    def until(self, condition: Any) -> None:
        with self._news:
            assert self._news.wait_for(condition, DEADLINE), (self.states, self.faults)


def run(plan: Plan) -> Tuple[StandaloneExecutor, Recorder]:
    recorder = Recorder()
    executor = StandaloneExecutor(plan, recorder)
    executor.start()
    return executor, recorder


RING = {"T1": (True, ["P1"], ["P2"]), "T2": (True, ["P2"], ["P1"])}
LINE = {"T1": (True, ["P1"], ["P2"])}
S = Phase


def test_an_agent_goes_through_the_states_of_figure_4_5(tmp_path: Path) -> None:
    executor, recorder = run(write_plan(tmp_path, "def go(): pass\n", net=LINE, tokens={"P1": 1}))
    ended = executor.wait(DEADLINE)
    assert ended is not None and ended.finished
    assert recorder.states == {"1": [S.FREE, S.DOING, S.DONE, S.FREE, S.DOING, S.DONE, S.INACTIVE]}


def test_agents_that_meet_wait_and_the_surplus_becomes_void(tmp_path: Path) -> None:
    net = {"meet": (True, ["P1", "P2"], ["P3"])}
    plan = write_plan(
        tmp_path,
        "import threading\ngate = threading.Event()\ndef go(): pass\n"
        "def slow(is_cancelled): gate.wait(20)\n",
        net=net,
        tokens={"P1": 1, "P2": 1},
        bound={"P2": "work.slow"},
    )
    executor, recorder = run(plan)
    recorder.until(lambda: S.WAITING in recorder.states.get("1", []))
    assert executor.status()["agents"][0]["why"] == "wants meet: needs a robot in P2"
    import sys

    next(
        m for n, m in sys.modules.items() if getattr(m, "__file__", "") == str(tmp_path / "work.py")
    ).gate.set()
    assert executor.wait(DEADLINE) is not None
    assert recorder.states["1"][:4] == [S.FREE, S.DOING, S.DONE, S.WAITING]
    assert sum(states[-1] is S.VOID for states in recorder.states.values()) == 1
    assert sum(states[-1] is S.INACTIVE for states in recorder.states.values()) == 1


def test_a_fork_makes_agents_and_the_log_rebuilds_the_run_exactly(tmp_path: Path) -> None:
    net = {
        "fork": (True, ["A"], ["B", "B2"]),
        "again": (False, ["B"], ["A"]),
        "end": (False, ["B"], ["C"]),
        "end2": (True, ["B2"], ["C"]),
    }
    plan = write_plan(tmp_path, "def go(): pass\n", net=net, tokens={"A": 3}, seed=5)
    executor, recorder = run(plan)
    assert executor.wait(DEADLINE) is not None
    game = TokenGame(plan, agents=True)
    state = game.new_state()
    firings: List[Firing] = []
    for slot, entries in enumerate(recorder.entries):
        again = [log_entries.from_json(log_entries.to_json(e)) for e in entries]
        firings += game.reduce(state, slot, again).firings
    assert (firings, state) == (recorder.firings, executor.state)
    assert len(state.robots) == state.marking[plan.net.place_index["C"]] > 3


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("raise RuntimeError('no gripper')", "RuntimeError: no gripper"),
        ("return 'T9'", "'T9' does not leave P1"),
        ("return 42", "'42' does not leave P1"),
        ("raise SystemExit(3)", "SystemExit"),
        (
            "from gspn_framework_package.execution.actions import ActionFailed; raise ActionFailed('jammed')",
            "jammed",
        ),
        ("is_cancelled.wait()", "timeout: no result within 0.2 s"),
        ("import time; time.sleep(30)", "timeout: no result within 0.2 s"),
    ],
)
def test_functions_that_do_not_succeed_leave_the_agent_to_the_operator(
    tmp_path: Path, body: str, reason: str
) -> None:
    plan = write_plan(
        tmp_path,
        "def go(is_cancelled):\n    %s\n" % body,
        net=LINE,
        tokens={"P1": 1},
        timeout={"P1": 0.2 if "timeout" in reason else DEADLINE},
    )
    executor, recorder = run(plan)
    recorder.until(lambda: recorder.faults)
    assert reason in recorder.faults[0]
    recorder.until(lambda: S.FAILED in recorder.states["1"])
    assert "waits for the operator" in executor.status()["agents"][0]["why"]
    executor.order(log_entries.Retry("1"))
    recorder.until(lambda: len(recorder.faults) == 2)
    executor.stop()
    ended = executor.wait(DEADLINE)
    assert ended is not None and not ended.finished


def test_retry_gives_the_next_attempt_after_the_delay(tmp_path: Path) -> None:
    plan = write_plan(
        tmp_path,
        "from gspn_framework_package.execution.actions import ActionFailed\n"
        "def go(attempt, feedback):\n    feedback(attempt)\n    if attempt < 3: raise ActionFailed('again')\n",
        net=LINE,
        tokens={"P1": 1},
        on_failure={"*": {"retry": 2, "delay": 0.05}},
    )
    executor, recorder = run(plan)
    ended = executor.wait(DEADLINE)
    assert ended is not None and ended.finished
    assert recorder.feedback == [(1,), (2,), (3,), (1,), (2,), (3,)]


def test_stop_cancels_what_runs_and_does_not_wait_for_what_never_returns(tmp_path: Path) -> None:
    plan = write_plan(
        tmp_path, "import time\ndef go(): time.sleep(60)\n", net=LINE, tokens={"P1": 2}
    )
    executor, recorder = run(plan)
    recorder.until(lambda: list(recorder.states.values()).count([S.FREE, S.DOING]) == 2)
    executor.stop("enough")
    ended = executor.wait(DEADLINE)
    assert ended is not None and (ended.reason, ended.finished) == ("enough", False)
    with pytest.raises(UsageError):
        executor.start()


@pytest.mark.long
def test_a_thousand_agents_at_once(tmp_path: Path) -> None:
    net = {"in": (True, ["P1"], ["P2"]), "all": (False, ["P2"], ["P3"])}
    plan = write_plan(
        tmp_path,
        "import threading\nbarrier = threading.Barrier(1000)\n"
        "def go(place):\n    if place == 'P1': barrier.wait(60)\n",
        net=net,
        tokens={"P1": 1000},
    )
    executor, recorder = run(plan)
    ended = executor.wait(120)
    assert ended is not None and ended.finished
    assert executor.status()["marking"]["P3"] == 1000


@pytest.mark.long
def test_the_environment_fires_at_its_rates(tmp_path: Path) -> None:
    net = {"arrive": (True, [], ["orders"]), "work": (True, ["idle", "orders"], ["idle"])}
    plan = write_plan(
        tmp_path,
        "def go(): pass\n",
        net=net,
        tokens={"idle": 1},
        resource_places=["orders"],
        environment="simulate",
    )
    executor, recorder = run(plan)
    recorder.until(lambda: [f.transition for f in recorder.firings].count("work") >= 2)
    executor.stop()
    assert executor.wait(DEADLINE) is not None


def test_a_run_fires_the_clock_by_the_hours_of_the_day(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hour = [13.0]
    monkeypatch.setattr(standalone, "time", SimpleNamespace(time=lambda: 3600 * hour[0]))
    monkeypatch.setattr(standalone, "_LOOK_AT_CLOCK", 0.01)
    net = {"noon": (True, ["am"], ["pm"]), "night": (True, ["pm"], ["am"]), **RING}
    plan = write_plan(
        tmp_path,
        "def go(is_cancelled): is_cancelled.wait()\n",
        net=net,
        tokens={"P1": 1, "am": 1},
        resource_places=["am", "pm"],
        events={
            "noon": {"from_hour": 12, "to_hour": 0},
            "night": {"from_hour": 0, "to_hour": 12},
        },
    )
    executor, recorder = run(plan)
    recorder.until(lambda: [f.transition for f in recorder.firings] == ["noon"])
    hour[0] = 24.0
    recorder.until(lambda: [f.transition for f in recorder.firings] == ["noon", "night"])
    executor.stop()
    assert executor.wait(DEADLINE) is not None


def test_a_listener_that_breaks_does_not_break_silently(tmp_path: Path) -> None:
    class Broken(Listener):
        def on_step(self, *args: Any) -> None:
            raise ValueError("full disk")

        def on_broken(self, reason: str) -> None:
            told.append(reason)

    told: List[str] = []
    executor = StandaloneExecutor(
        write_plan(tmp_path, "def go(): pass\n", net=LINE, tokens={"P1": 1}), Broken()
    )
    executor.start()
    with pytest.raises(ExecutionError, match="full disk"):
        executor.wait(DEADLINE)
    assert executor.over and told == ["the run failed: ValueError: full disk"]


def test_a_full_log_ends_the_run_and_is_reported_as_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends: List[Tuple[str, bool]] = []

    class Told(Recorder):
        def on_end(self, reason: str, finished: bool) -> None:
            ends.append((reason, finished))

    plan = write_plan(tmp_path, "def go(): pass\n", net=RING, tokens={"P1": 1})
    fill_the_disk(monkeypatch, after=20_000)
    recorder = Told()
    executor = StandaloneExecutor(
        plan, recorder, EventLogWriter(str(tmp_path / "log"), header(plan, "r", "", "x"))
    )
    executor.start()
    with pytest.raises(ExecutionError, match="No space left"):
        executor.wait(DEADLINE)
    assert executor.over and len(ends) == 1 and not ends[0][1] and "No space left" in ends[0][0]
    assert recorder.faults == [ends[0][0]]
    assert len(list(replay(read_log(str(tmp_path / "log"))))) > 5  # what had room can be read


def test_an_end_that_cannot_be_recorded_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends: List[str] = []

    class Told(Recorder):
        def on_end(self, reason: str, finished: bool) -> None:
            ends.append(reason)

    plan = write_plan(
        tmp_path, "def go(is_cancelled): is_cancelled.wait(60)\n", net=RING, tokens={"P1": 1}
    )
    recorder = Told()
    writer = EventLogWriter(str(tmp_path / "log"), header(plan, "r", "", "x"))
    executor = StandaloneExecutor(plan, recorder, writer)
    executor.start()
    recorder.until(lambda: recorder.entries)
    writer.close()  # whatever is written from now on fails, the line about the end too
    executor.stop()
    with pytest.raises(ExecutionError, match="closed file"):
        executor.wait(DEADLINE)
    assert executor.over and len(ends) == 1


def test_an_exception_that_cannot_be_told_fails_its_action_like_any_other(tmp_path: Path) -> None:
    code = (
        "class Mute(Exception):\n    def __str__(self): raise RuntimeError('mute')\n"
        "def go(): raise Mute()\n"
    )
    executor, recorder = run(write_plan(tmp_path, code, net=LINE, tokens={"P1": 1}))
    recorder.until(lambda: recorder.faults)
    assert "Mute" in recorder.faults[0]
    executor.stop()
    assert executor.wait(DEADLINE) is not None


def test_a_place_bound_to_a_server_cannot_run_without_ros(tmp_path: Path) -> None:
    plan = write_plan(
        tmp_path,
        "def go(): pass\n",
        net=LINE,
        tokens={"P1": 1},
        bound={"P1": {"server": "move_base", "type": "move_base_msgs/MoveBaseAction"}},
    )
    with pytest.raises(PlanError, match="move_base"):
        StandaloneExecutor(plan)


def run_thirty_at_once(pool: WorkerPool) -> None:
    """Tasks that end only when all of them run."""
    gate = threading.Barrier(31)
    for _ in range(30):
        pool.submit(lambda: gate.wait(DEADLINE) and None)  # type: ignore[func-returns-value]
    gate.wait(DEADLINE)


def test_the_pool_makes_threads_on_demand_and_uses_idle_ones_again() -> None:
    pool = WorkerPool("test", idle_seconds=600)
    for _ in range(5):
        run_thirty_at_once(pool)
        wait_for(lambda: pool._idle >= 30, seconds=DEADLINE, what="idle threads")
    assert pool._made == 30


@pytest.mark.long
def test_a_task_is_run_even_where_the_idle_threads_are_just_ending() -> None:
    pool = WorkerPool("test", idle_seconds=0.0005)
    for _ in range(100):
        run_thirty_at_once(pool)


def test_a_listener_hears_how_tasks_ended(tmp_path: Path) -> None:
    templates.write("deliver", str(tmp_path / "post"), robots=1)
    told: queue.Queue[TaskEnded] = queue.Queue()

    class Ears(Listener):
        def on_task_ended(self, ended: TaskEnded) -> None:
            told.put(ended)

    executor = StandaloneExecutor(read_plan(str(tmp_path / "post")), Ears())
    executor.start()
    order = executor.submit("order", {"address": "door 7"})
    executor.order(log_entries.CancelTask(order))
    assert told.get(timeout=DEADLINE)[:2] == (order, "cancelled")
    executor.stop()
    assert executor.wait(DEADLINE) is not None
