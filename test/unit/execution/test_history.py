"""The history checker on small stories: the true one passes, each small lie is found, and named."""

from __future__ import annotations

import copy
import json
from typing import Any, Callable, List

import pytest

from gspn_framework_package.benchmark.team.plans import make_plan
from gspn_framework_package.benchmark.team.world import World
from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.event_log import EventLog, next_hash
from gspn_framework_package.execution.history import verify
from gspn_framework_package.model.errors import LogError

TOUR, MEET, TOKENS, CROWD = range(4)


def story(kind: int, partial: bool = False, robots: int = 3) -> List[EventLog]:
    world = World(make_plan(kind, robots, partial, 0.0, 0.0, False), 3)
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    world.run(1.0)
    world.acting = False
    assert world.run(4.0, world.has_settled)
    return [EventLog(d.header["log"], d.header, d.records(), plan=world.plan) for d in world.logs()]


def rechain(logs: List[EventLog]) -> None:
    """Make the hash chain fit again, as a careful liar would."""
    for log in logs:
        chain = log.header["plan_hash"]
        for record in log.records:
            if record["kind"] == "slot":
                chain = next_hash(chain, record["entries"], record["origins"], record["firings"])
                record["hash"] = chain


def slots(log: EventLog) -> List[Any]:
    return [r for r in log.records if r["kind"] == "slot"]


@pytest.mark.parametrize("kind", [TOUR, MEET, TOKENS, CROWD])
@pytest.mark.parametrize("partial", [False, True])
def test_a_true_story_is_valid(kind: int, partial: bool) -> None:
    verdict = verify(story(kind, partial), settled=True)
    assert verdict.violation is None, verdict.violation
    assert verdict.firings > 5


def everywhere(lie: Callable[[Any], None]) -> Callable[[List[EventLog]], None]:
    """The same lie in all logs, with the chain mended."""

    def tell(logs: List[EventLog]) -> None:
        for log in logs:
            fired = [r for r in slots(log) if r["slot"] > 3 and r["firings"]]
            lie(fired[0])
        rechain(logs)

    return tell


def other_marking(record: Any) -> None:
    record["firings"][0]["marking"]["p1"] = 7


def no_firing(record: Any) -> None:
    record["firings"].clear()


def twice(record: Any) -> None:
    record["firings"].append(copy.deepcopy(record["firings"][0]))


def other_visit(record: Any) -> None:
    record["firings"][0]["moves"][0][3] += 1


def teleport(record: Any) -> None:
    record["firings"][0]["moves"][0][2] = "p7"


def other_position(record: Any) -> None:
    record["firings"][0]["index"] = 5


def one_differs(logs: List[EventLog]) -> None:
    slots(logs[1])[4]["entries"][0]["result"] = "x"
    rechain(logs[1:2])


def broken_chain(logs: List[EventLog]) -> None:
    slots(logs[0])[2]["hash"] = "0" * 32


def a_slot_is_missing(logs: List[EventLog]) -> None:
    logs[0].records.remove(slots(logs[0])[3])


def repeated_fact(logs: List[EventLog]) -> None:
    for log in logs:
        some = slots(log)
        some[5]["entries"].append(some[4]["entries"][0])
        some[5]["origins"].append(some[4]["origins"][0])
    rechain(logs)


def another_fact(logs: List[EventLog]) -> None:
    record = next(r for r in logs[0].records if r["kind"] == "invoked")
    record["entry"]["result"] = "t7"


def too_late(logs: List[EventLog]) -> None:
    mine = [r for r in logs[0].records if r["kind"] == "invoked"]
    mine[0]["mono"] = 0.9


def wrong_goal(logs: List[EventLog]) -> None:
    next(r for r in logs[0].records if r["kind"] == "goal")["visit"] = 9


def second_goal(logs: List[EventLog]) -> None:
    at = next(i for i, r in enumerate(logs[0].records) if r["kind"] == "goal")
    logs[0].records.insert(at, logs[0].records[at])


def broken_promise(logs: List[EventLog]) -> None:
    at = next(i for i, r in enumerate(logs[1].records) if r["kind"] == "accepted")
    slot = logs[1].records[at]["slot"]
    logs[1].records.insert(at, {"kind": "promised", "slot": slot, "ballot": [99, "r9"]})


def no_votes(logs: List[EventLog]) -> None:
    for log in logs[1:]:
        log.records[:] = [r for r in log.records if r["kind"] != "accepted"]


def forgotten_fact(logs: List[EventLog]) -> None:
    origin = ["r1", 0, 999, "x"]
    entry = {"entry": "retry", "robot": "r1"}
    logs[0].records.append({"kind": "invoked", "entry": entry, "origin": origin, "mono": 2.0})


@pytest.mark.parametrize(
    ("lie", "rules"),
    [
        (one_differs, {1}),
        (broken_chain, {1}),
        (a_slot_is_missing, {1}),
        (everywhere(other_position), {1, 2}),
        (broken_promise, {1}),
        (no_votes, {1}),
        (everywhere(other_marking), {2}),
        (everywhere(twice), {2}),
        (everywhere(other_visit), {2}),
        (everywhere(teleport), {2}),
        (everywhere(no_firing), {2, 7}),
        (repeated_fact, {4}),
        (another_fact, {4}),
        (too_late, {5}),
        (wrong_goal, {8}),
        (second_goal, {8}),
        (forgotten_fact, {9}),
    ],
)
def test_a_lie_is_found(lie: Callable[[List[EventLog]], None], rules: Any) -> None:
    logs = story(TOKENS)
    lie(logs)
    violation = verify(logs, settled=True).violation
    assert violation is not None
    assert violation.rule in rules, violation


def test_another_draw_of_the_policy_is_found() -> None:
    logs = story(TOUR)
    for log in logs:
        for record in slots(log):
            for entry in record["entries"]:
                if entry["entry"] == "start":
                    entry["seed"] = 12345
    rechain(logs)
    violation = verify(logs).violation
    assert violation is not None
    assert violation.rule == 2
    assert "draw" in violation.text


def test_a_private_move_that_touches_others_is_found() -> None:
    logs = story(TOKENS, partial=True)
    record = next(r for log in logs for r in log.records if r["kind"] == "private")
    record["firing"]["transition"] = "t3"
    violation = verify(logs).violation
    assert violation is not None
    assert violation.rule == 10


def test_logs_of_different_runs_are_refused() -> None:
    logs = story(TOKENS, robots=2)
    logs[0].header = dict(logs[0].header, run="other")
    with pytest.raises(LogError, match="different runs"):
        verify(logs)


def test_the_verb(tmp_path, capsys) -> None:
    logs = story(TOKENS, robots=2)
    for log in logs:
        lines = [json.dumps(r) for r in [log.header, *log.records]]
        (tmp_path / ("%s.jsonl" % log.robot)).write_text("\n".join(lines) + "\n")
    assert main(["verify", str(tmp_path), "--settled"]) == 0
    assert capsys.readouterr().out.endswith("valid\n")
    broken_chain(logs)
    lines = [json.dumps(r) for r in [logs[0].header, *logs[0].records]]
    (tmp_path / "r1.jsonl").write_text("\n".join(lines) + "\n")
    assert main(["verify", str(tmp_path), "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert answer["violation"]["rule"] == 1
    assert main(["verify", str(tmp_path / "none.jsonl")]) == 2
