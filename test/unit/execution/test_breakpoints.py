"""Breakpoints hold one robot, in a team of replicas and standalone, and are kept in a file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, List

import pytest
from shop_plan import shop
from waiting import wait_for

from agreement.plans import make_plan
from agreement.world import World
from gspn_framework_package.cli.main import main
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.breakpoints import FILE_NAME, BreakpointFile, Breakpoints
from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.execution.standalone import Listener, StandaloneExecutor
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.formats.plan_json import plan_from_json
from gspn_framework_package.model.errors import InputError, PlanError
from gspn_framework_package.model.plan import Plan


def team(partial: bool) -> World:
    """Three robots on a tour of private places."""
    fields = {"evict_after": 0.0, "fence_after": 0.0, "witness": False}
    world = World(make_plan(0, 3, partial, **fields), 1)
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    return world


def in_log(world: World, kind: type, robot: str) -> List[Any]:
    """The entries of a kind about a robot, in the longest log."""
    logs = [EventLog(d.header["log"], d.header, d.records()) for d in world.logs()]
    verdict = verify(logs)
    assert verdict.violation is None, verdict.violation
    records = max((log.records for log in logs), key=len)
    entries = [e for r in records if r["kind"] == "slot" for e in r["entries"]]
    found = [log_entries.from_json(e) for e in entries]
    return [e for e in found if isinstance(e, kind) and e.robot == robot]


def place_of(world: World, robot: str) -> Any:
    state = world.nodes[robot].replica.ledger.state
    return world.plan.net.places[state.robots[robot].place].name


@pytest.mark.parametrize("partial", [False, True])
def test_a_robot_halts_before_its_action_and_the_others_go_on(partial: bool) -> None:
    world = team(partial)
    node = world.nodes["r1"]
    node.replica.break_at(Breakpoints(("D",)))

    def halted() -> bool:
        return bool(node.replica.ledger.state.robots["r1"].paused)

    assert world.run(20.0, halted)
    assert place_of(world, "r1") == "D"
    assert node.replica.state.running is None
    fired = len(world.published)
    world.run(world.now + 1.0)
    assert halted() and place_of(world, "r1") == "D" and node.replica.state.running is None
    assert len(world.published) > fired + 3
    visit = node.replica.ledger.state.robots["r1"].visit

    node.replica.break_at(Breakpoints())
    world.nodes["r2"].give(interface.Order("go on", log_entries.Resume("r1")))

    def moved() -> bool:
        return bool(node.replica.ledger.state.robots["r1"].visit > visit + 1)

    assert world.run(world.now + 5.0, moved)
    assert len(in_log(world, log_entries.Pause, "r1")) == 1
    assert in_log(world, log_entries.Pause, "r2") == []


@pytest.mark.parametrize("partial", [False, True])
def test_a_robot_halts_before_a_transition(partial: bool) -> None:
    world = team(partial)
    node = world.nodes["r1"]
    node.replica.break_at(Breakpoints((), ("bd", "cd")))

    def halted() -> bool:
        return bool(node.replica.ledger.state.robots["r1"].paused)

    assert world.run(20.0, halted)
    assert place_of(world, "r1") in ("B", "C")
    where = place_of(world, "r1")
    world.run(world.now + 1.0)
    assert place_of(world, "r1") == where
    # it asked for the transition before it halted, so nothing but the resume is missing
    node.replica.break_at(Breakpoints())
    world.nodes["r2"].give(interface.Order("go on", log_entries.Resume("r1")))
    assert world.run(world.now + 2.0, lambda: place_of(world, "r1") != where)


ACTIONS = """
seen = []
def go(robot, visit): seen.append((robot, visit))
def wait(is_cancelled): is_cancelled.wait(60)
"""


def ring(folder: Path, in_a: int = 2, **fields: Any) -> Plan:
    (folder / "ring_actions.py").write_text(ACTIONS)
    data = {
        "net": {
            "places": [
                {"name": "A", "tokens": in_a},
                {"name": "B", "tokens": 2 - in_a},
                {"name": "store", "tokens": 1},
            ],
            "transitions": [
                {"name": "ab", "timed": True},
                {"name": "ba", "timed": True},
                {"name": "late", "timed": True},
            ],
            "arcs": [
                {"from": "A", "to": "ab"},
                {"from": "ab", "to": "B"},
                {"from": "B", "to": "ba"},
                {"from": "ba", "to": "A"},
                {"from": "A", "to": "late"},
                {"from": "late", "to": "B"},
            ],
        },
        "resource_places": ["store"],
        "actions": {"A": "ring_actions.go", "B": "ring_actions.go"},
        "events": {"late": {"after": 1000}},
        "robots": {"a": "A", "b": "A"},
        **fields,
    }
    return plan_from_json(data, folder=str(folder))


class Steps(Listener):
    """Counts the firings of each agent."""

    def __init__(self) -> None:
        self.fired: List[str] = []

    def on_step(self, slot: int, entries: Any, firings: Any, state: Any) -> None:
        self.fired += [f.robot for f in firings]


def test_an_agent_halts_and_goes_on_when_it_is_resumed(tmp_path: Path) -> None:
    steps = Steps()
    executor = StandaloneExecutor(ring(tmp_path), steps)
    executor.break_at = Breakpoints(("B",))
    executor.start()

    def states() -> Any:
        return [(a["place"], executor.state.robots[a["name"]].paused) for a in agents()]

    def agents() -> Any:
        return executor.status()["agents"]

    wait_for(lambda: states() == [("B", True), ("B", True)], what="both to stop")
    assert sorted(steps.fired) == ["a", "b"]
    executor.break_at = Breakpoints((), ("ab",))
    executor.order(log_entries.Resume("a"))
    wait_for(lambda: states() == [("A", True), ("B", True)], what="a to stop before ab")
    executor.break_at = Breakpoints()
    executor.order(log_entries.Resume("a"))
    wait_for(lambda: steps.fired.count("a") > 10, what="a to go on")
    assert steps.fired.count("b") == 1
    executor.stop()
    executor.wait(20)


def test_a_breakpoint_at_an_event_holds_it(tmp_path: Path) -> None:
    plan = ring(
        tmp_path,
        1,
        events={"late": {"after": 0.01}},
        actions={"A": "ring_actions.wait", "B": "ring_actions.wait"},
        robots={"a": "A", "b": "B"},
    )
    steps = Steps()
    executor = StandaloneExecutor(plan, steps)
    executor.break_at = Breakpoints((), ("late",))
    executor.start()
    wait_for(lambda: executor.state.robots and executor.state.robots["a"].held, what="the event")
    assert executor.state.robots["a"].paused and steps.fired == []
    executor.order(log_entries.Resume("a"))
    wait_for(lambda: steps.fired == ["a"], what="the firing")
    executor.stop()
    executor.wait(20)


# -- the file ----------------------------------------------------------------------------------


def test_breakpoints_are_kept_in_a_file_beside_the_plan(tmp_path: Path) -> None:
    plan = ring(tmp_path)
    file, other = BreakpointFile(plan), BreakpointFile(plan)
    assert not other.changed()
    file.write(Breakpoints.of_names(["late", "B", "ab", "B"], plan))
    assert json.loads((tmp_path / FILE_NAME).read_text()) == {
        "places": ["B"],
        "transitions": ["ab", "late"],
    }
    assert not file.changed() and other.changed()
    assert other.breakpoints == Breakpoints(("B",), ("ab", "late"))
    file.write(Breakpoints())
    assert not (tmp_path / FILE_NAME).exists()
    assert other.changed() and other.breakpoints == Breakpoints()
    file.write(Breakpoints())


def test_a_file_that_does_not_fit_changes_nothing_and_is_reported_once(tmp_path: Path) -> None:
    file = BreakpointFile(ring(tmp_path))
    file.write(Breakpoints(("B",)))
    for text in ("{", '{"places": "B"}', '{"places": ["C"]}', '{"robots": []}', "[]"):
        (tmp_path / FILE_NAME).write_text(text)
        with pytest.raises(InputError, match=FILE_NAME):
            file.changed()
        assert not file.changed()
        assert file.breakpoints == Breakpoints(("B",))


@pytest.mark.parametrize(
    "name, why",
    [
        ("Orders", "resource place"),
        ("Idle", "no action, so a robot leaves at once"),
        ("take", "no action precedes it"),
        ("order", "moves no robot"),
        ("nothing", "no place or transition"),
    ],
)
def test_where_no_robot_can_halt(name: str, why: str) -> None:
    with pytest.raises(PlanError, match=why):
        Breakpoints.of_names([name], shop())


def test_a_plan_without_a_file_keeps_them_in_memory() -> None:
    file = BreakpointFile(shop())
    file.write(Breakpoints(("Deliver",)))
    assert file.path == "" and not file.changed() and file.breakpoints.places == ("Deliver",)


def test_the_command_keeps_them_for_a_plan(tmp_path: Path, capsys: Any) -> None:
    ring(tmp_path)
    net = {"places": [{"name": "A", "tokens": 1}], "transitions": [], "arcs": []}
    plan = {"net": net, "actions": {"A": "ring_actions.go"}, "robots": {"a": "A"}}
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    words = ["breakpoints", "--plan", str(tmp_path)]
    for more, code, out in (
        ([], 0, "no breakpoint\n"),
        (["A"], 0, "A\n"),
        (["--json"], 0, '{"places": ["A"], "transitions": []}\n'),
        (["B"], 2, ""),
        (["A", "--clear"], 2, ""),
        ([], 0, "A\n"),
        (["--clear"], 0, "no breakpoint\n"),
    ):
        assert main([*words, *more]) == code, more
        assert capsys.readouterr().out == out
    assert not (tmp_path / FILE_NAME).exists()


def test_a_run_reads_the_file_again_and_tells_what_is_wrong(tmp_path: Path) -> None:
    plan = ring(tmp_path)
    faults: List[str] = []

    class Faults(Listener):
        def on_fault(self, agent: str, message: str) -> None:
            faults.append(message)

    executor = StandaloneExecutor(plan, Faults())
    executor.breakpoint_file = BreakpointFile(plan)
    executor.start()
    (tmp_path / "new.json").write_text('{"places": ["nowhere"]}')
    (tmp_path / "new.json").rename(tmp_path / FILE_NAME)  # it is never seen half written
    wait_for(lambda: faults, what="the fault")
    assert "nowhere" in faults[0] and FILE_NAME in faults[0]
    BreakpointFile(plan).write(Breakpoints(("B",)))
    wait_for(
        lambda: all(r.paused for r in list(executor.state.robots.values())), what="both to stop"
    )
    executor.stop()
    executor.wait(20)
    assert len(faults) == 1
