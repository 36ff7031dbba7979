"""The history checker on small stories: the true one passes, each small lie is found, and named."""

from __future__ import annotations

import contextlib
import copy
import json
import os
from functools import lru_cache
from typing import Any, Callable, List

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agreement.plans import make_plan
from agreement.world import World
from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.event_log import (
    DamagedLogError,
    EventLog,
    next_hash,
    next_sum,
    read_log,
)
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.execution.verifier.logged_team import LoggedRobot
from gspn_framework_package.execution.verifier.slot_check import SlotCheck
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy, PolicyRow

TOUR, MEET, TOKENS, CROWD, ERRANDS, ROUNDS = range(6)


def story(kind: int, partial: bool = False, robots: int = 3) -> List[EventLog]:
    world = World(make_plan(kind, robots, partial, 0.0, 0.0, False), 3)
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    if world.plan.submissions:
        world.publish_tasks(0.05)
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


@pytest.mark.parametrize("kind", [TOUR, MEET, TOKENS, CROWD, ERRANDS, ROUNDS])
@pytest.mark.parametrize("partial", [False, True])
def test_a_true_story_is_valid(kind: int, partial: bool) -> None:
    verdict = verify(story(kind, partial), settled=True)
    assert verdict.violation is None, verdict.violation
    assert verdict.firings > 5


def test_a_log_of_protocol_4_is_read_as_it_was_written() -> None:
    """In that version, between equals the first to finish went first."""
    log = read_log(os.path.join(os.path.dirname(__file__), "protocol_4.jsonl"))
    firings = 0
    for step in replay(log):
        firings += len(step.firings)
    assert firings > 10
    assert verify([log]).violation is None
    # whoever goes on from there, or from a snapshot, does as before
    net = log.plan.net
    again = TeamState.from_json(step.state.to_json(net), net, frozenset())
    assert not step.state.draws_ties and not again.draws_ties
    start = log.records[0]["entries"][0]
    assert "draws_ties" not in start
    start["draws_ties"] = True
    with pytest.raises(LogError, match="other firings"):
        list(replay(log))


def test_a_log_of_protocol_5_is_read_as_it_was_written() -> None:
    """In that version, tasks had no priority and no time, and a team did not know how they
    ended."""
    log = read_log(os.path.join(os.path.dirname(__file__), "protocol_5.jsonl"))
    assert any(e["entry"] == "submit" for r in log.records for e in r.get("entries", ()))
    last = list(replay(log))[-1]
    assert [e.outcome for e in last.state.ended_tasks] == ["done"]
    assert verify([log]).violation is None
    # whoever goes on from its snapshot does as whoever read all of it
    snapshot = next(i for i, record in enumerate(log.records) if record["kind"] == "snapshot")
    tail = [r for r in log.records[snapshot:] if r["kind"] in ("snapshot", "slot")]
    again = list(replay(EventLog(log.path, log.header, tail, log.plan)))[-1]
    assert again.state.robots == last.state.robots
    assert again.state.queues == last.state.queues


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


def repeated_proposal(logs: List[EventLog]) -> None:
    for log in logs:
        some = slots(log)
        some[5]["entries"].append(some[4]["entries"][0])
        some[5]["origins"].append(some[4]["origins"][0])
    rechain(logs)


def another_proposal(logs: List[EventLog]) -> None:
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


def forgotten_proposal(logs: List[EventLog]) -> None:
    origin = ["r1", 0, 999, "x"]
    entry = {"entry": "retry", "robot": "r1"}
    logs[0].records.append({"kind": "invoked", "entry": entry, "origin": origin, "mono": 2.0})


@pytest.mark.long
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
        (repeated_proposal, {4}),
        (another_proposal, {4}),
        (too_late, {5}),
        (wrong_goal, {8}),
        (second_goal, {8}),
        (forgotten_proposal, {9}),
    ],
)
def test_a_lie_is_found(lie: Callable[[List[EventLog]], None], rules: Any) -> None:
    logs = story(TOKENS)
    lie(logs)
    violation = verify(logs, settled=True).violation
    assert violation is not None
    assert violation.rule in rules, violation


# -- events, tasks, data -----------------------------------------------------------------------


@lru_cache(maxsize=None)
def errands() -> List[EventLog]:
    return story(ERRANDS)


def first_slots(logs: List[EventLog], fits: Callable[[Any], bool]) -> List[Any]:
    """The first slot that fits, in every log."""
    number = next(r["slot"] for r in slots(logs[0]) if fits(r))
    return [r for log in logs for r in slots(log) if r["slot"] == number]


def caused(record: Any) -> List[Any]:
    return [f for f in record["firings"] if f.get("cause")]


def interrupted(record: Any) -> List[Any]:
    who = [(e["robot"], e["visit"]) for e in record["entries"] if e["entry"] == "interrupt"]
    return [f for f in caused(record) if (f["robot"], f["visit"]) in who]


def interrupted_alone(record: Any) -> List[Any]:
    """Interrupts of a slot with no other entry, whose effects would break other rules first."""
    return interrupted(record) if len(record["entries"]) == 1 else []


def moved(target: str) -> Callable[[Any], List[Any]]:
    def find(record: Any) -> List[Any]:
        return [m for f in record["firings"] for m in f.get("tasks", ()) if m[2] == target]

    return find


def without_cause(logs: List[EventLog]) -> None:
    for record in first_slots(logs, caused):
        del caused(record)[0]["cause"]


def without_event(logs: List[EventLog]) -> None:
    for record in first_slots(logs, interrupted_alone):
        at = next(i for i, e in enumerate(record["entries"]) if e["entry"] == "interrupt")
        del record["entries"][at], record["origins"][at]


def without_effect(logs: List[EventLog]) -> None:
    for record in first_slots(logs, interrupted):
        record["firings"].remove(interrupted(record)[0])


def event_of_another(logs: List[EventLog]) -> None:
    for record in first_slots(logs, interrupted_alone):
        next(e for e in record["entries"] if e["entry"] == "interrupt")["visit"] += 1


def lost_task(logs: List[EventLog]) -> None:
    for record in first_slots(logs, moved("place orders")):
        for firing in record["firings"]:
            firing.pop("tasks", None)


def task_never_done(logs: List[EventLog]) -> None:
    for record in first_slots(logs, moved("done")):
        moved("done")(record)[0][2] = "place orders"


def another_task(logs: List[EventLog]) -> None:
    for record in first_slots(logs, moved("done")):
        moved("done")(record)[0][0] = "t0"


def task_again(logs: List[EventLog]) -> None:
    for record in first_slots(logs, moved("done")):
        firing = next(f for f in record["firings"] if f.get("tasks"))
        firing["tasks"].append(["t1", "robot r1", "done"])


def task_out_of_nowhere(logs: List[EventLog]) -> None:
    def comes(record: Any) -> bool:
        return any(e["entry"] == "submit" for e in record["entries"])

    for record in first_slots(logs, lambda r: comes(r) and moved("place orders")(r)):
        at = next(i for i, e in enumerate(record["entries"]) if e["entry"] == "submit")
        del record["entries"][at], record["origins"][at]


def forgotten_task(logs: List[EventLog]) -> None:
    entry = {"entry": "submit", "transition": "order", "id": "t999"}
    logs[0].records.append({"kind": "offered", "entry": entry, "mono": 2.0})


def read_before_written(logs: List[EventLog]) -> None:
    """The log writes less than actions have read (but all of tasks: without it, an action that has
    no task would not fail)."""
    for log in logs:
        for record in log.records:
            voted = [entry for entry, _, _ in record.get("batch", ())]
            for entry in [*record.get("entries", ()), *voted, record.get("entry", {})]:
                data = entry.get("data", {}) if entry.get("entry") == "done" else {}
                if data and not any(name.startswith("task.") for name in data):
                    del entry["data"]


def other_data(logs: List[EventLog]) -> None:
    next(r for log in logs for r in log.records if r.get("reads"))["reads"] = "0" * 16


def continued(logs: List[EventLog]) -> None:
    next(r for log in logs for r in log.records if r["kind"] == "goal")["resumed_from"] = 7


@pytest.mark.parametrize(
    ("lie", "rules"),
    [
        (without_cause, {2}),
        (without_event, {2}),
        (without_effect, {2, 7}),
        (event_of_another, {2}),
        (lost_task, {11}),
        (task_never_done, {11}),
        (another_task, {11}),
        (task_again, {11}),
        (task_out_of_nowhere, {2}),
        (forgotten_task, {9}),
        (read_before_written, {11}),
        (other_data, {11}),
        (continued, {11}),
    ],
)
def test_a_lie_about_events_tasks_and_data_is_found(
    lie: Callable[[List[EventLog]], None], rules: Any
) -> None:
    logs = [
        EventLog(log.path, dict(log.header), copy.deepcopy(log.records), plan=log.plan)
        for log in errands()
    ]
    lie(logs)
    rechain(logs)
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


def test_a_local_transition_that_touches_others_is_found() -> None:
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


def no_ballot(logs: List[EventLog]) -> None:
    for log in logs:
        del slots(log)[-1]["ballot"]


def no_origins(logs: List[EventLog]) -> None:
    for log in logs:
        next(r for r in slots(log) if r["slot"] and r["origins"])["origins"] = []
    rechain(logs)


def no_log(logs: List[EventLog]) -> None:
    del logs[1]


def two_memories(logs: List[EventLog]) -> None:
    """A vote that was given again after the log was lost."""
    records = logs[1].records
    at = max(i for i, r in enumerate(records) if r["kind"] == "accepted")
    vote = dict(records[at], ballot=[records[at]["ballot"][0] + 1, *records[at]["ballot"][1:]])
    again = EventLog(
        "again", dict(logs[1].header, log="again"), [*records[:at], vote], plan=logs[1].plan
    )
    logs.append(again)


@pytest.mark.parametrize(
    ("lie", "rule"), [(no_ballot, 1), (no_origins, 1), (no_log, 9), (two_memories, 1)]
)
def test_what_is_left_out_is_found(lie: Callable[[List[EventLog]], None], rule: int) -> None:
    logs = story(TOKENS)
    lie(logs)
    violation = verify(logs).violation
    assert violation is not None
    assert violation.rule == rule, violation


def what_breaks(logs: List[EventLog]) -> str:
    violation = verify(logs).violation
    assert violation is not None
    return violation.text


def last_vote(log: EventLog) -> int:
    return max(i for i, r in enumerate(log.records) if r["kind"] == "accepted")


def test_votes_of_one_slot_from_two_memories_are_found() -> None:
    logs = story(TOKENS)
    two_memories(logs)
    assert "from two memories" in what_breaks(logs)


def test_a_vote_in_a_slot_that_is_not_open_is_found() -> None:
    logs = story(TOKENS)
    logs[1].records[last_vote(logs[1])]["slot"] += 1
    assert "but its first open slot is" in what_breaks(logs)


def test_a_later_vote_for_another_batch_is_found() -> None:
    logs = story(TOKENS)
    at = last_vote(logs[1])
    later = dict(logs[1].records[at], ballot=[99, "r2", ""], batch=[])
    logs[1].records.insert(at + 1, later)
    assert "after one was chosen" in what_breaks(logs)


def test_a_visit_that_is_skipped_is_named() -> None:
    logs = story(TOKENS)
    everywhere(other_visit)(logs)
    assert "would skip from visit" in what_breaks(logs)


def test_a_draw_that_is_older_than_the_marking_is_named() -> None:
    logs = story(TOUR)
    for log in logs:
        drawn = [f for record in slots(log) for f in record["firings"] if f.get("drawn")]
        drawn[-1]["drawn"] = [1, 0]
    rechain(logs)
    assert "the draw is older than the marking" in what_breaks(logs)


def test_a_local_transition_that_leads_elsewhere_is_found() -> None:
    logs = story(TOKENS, partial=True)
    record = next(r for log in logs for r in log.records if r["kind"] == "private")
    record["firing"]["marking"]["p1"] = 5
    violation = verify(logs).violation
    assert violation is not None
    assert violation.rule == 10


@pytest.mark.long
@pytest.mark.parametrize(
    "nonsense", [7, "text", None, ["list"], {"entry": 5}, {"entry": "done", "robot": 3}]
)
@pytest.mark.parametrize("field", ["entries", "origins", "firings"])
def test_nonsense_in_a_record_is_no_internal_error(field: str, nonsense: Any) -> None:
    logs = story(TOKENS)
    for log in logs:
        for record in [r for r in slots(log) if r["slot"] == 4]:
            record[field][0:1] = [nonsense]
    rechain(logs)
    with contextlib.suppress(LogError):
        assert verify(logs).violation is not None


def as_files(logs: List[EventLog], folder: Any) -> None:
    """Write logs as an event log's writer does, with the times that they have."""
    for log in logs:
        chain, lines = "", []
        for record in [log.header, *log.records]:
            text = json.dumps(record)
            chain = next_sum(chain, text.encode())
            lines.append('%s,"sum":"%s"}\n' % (text[:-1], chain))
        (folder / ("%s.jsonl" % log.robot)).write_text("".join(lines))


@pytest.mark.long
@pytest.mark.parametrize("partial", [False, True])
def test_every_line_that_is_dropped_changed_or_doubled_is_found(
    tmp_path, capsys, partial: bool
) -> None:
    as_files(story(TOKENS, partial), tmp_path)
    path = tmp_path / "r2.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    kinds = {json.loads(line)["kind"] for line in lines[:-1]}
    assert {"header", "life", "peer", "active", "slot", "goal", "accepted", "invoked"} <= kinds
    for number in range(1, len(lines) - 1):
        changed = lines[number].replace('"mono"', '"Mono"', 1)
        for lie in (
            lines[:number] + lines[number + 1 :],
            [*lines[:number], changed, *lines[number + 1 :]],
            [*lines[:number], lines[number], *lines[number:]],
        ):
            path.write_text("".join(lie))
            with pytest.raises(DamagedLogError, match="does not follow from the lines before it"):
                read_log(str(path))
    assert main(["verify", str(tmp_path)]) == 1
    assert "r2.jsonl:%d: does not follow" % len(lines) in capsys.readouterr().out


def test_the_verb(tmp_path, capsys) -> None:
    logs = story(TOKENS, robots=2)
    as_files(logs, tmp_path)
    assert main(["verify", str(tmp_path), "--settled"]) == 0
    assert capsys.readouterr().out.endswith("valid\n")
    broken_chain(logs)
    as_files(logs[:1], tmp_path)
    assert main(["verify", str(tmp_path), "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert answer["violation"]["rule"] == 1
    assert main(["verify", str(tmp_path / "none.jsonl")]) == 2


cells = st.one_of(st.none(), st.integers(0, 1))


@given(
    st.lists(
        st.tuples(st.tuples(cells, cells), st.sampled_from(["", "a", "b", "c", "ac"])),
        min_size=1,
        max_size=6,
    ),
    st.tuples(st.integers(0, 1), st.integers(0, 1)),
    st.sampled_from(["P", "Q"]),
)
def test_it_reads_the_policy_as_the_token_game_does(rows: Any, marking: Any, place: str) -> None:
    """... with wildcards, rows of several places and rows that let robots wait."""
    net = NetBuilder().place("P").place("Q").immediate("a", inputs="P", outputs="Q")
    net.immediate("b", inputs="P").immediate("c", inputs="Q", outputs="P")
    policy = Policy(
        ["P", "Q"], [PolicyRow(cells, tuple((t, 1 / len(ts)) for t in ts)) for cells, ts in rows]
    )
    plan = Plan(net.build(), policy=policy, strict=True)
    table, check = policy.bind(plan.net), SlotCheck(plan)
    check.marking = dict(zip(["P", "Q"], marking))
    found = table.distribution(marking, plan.net.place_number(place))
    assert dict(check._choices(LoggedRobot("r", place, 0))) == {
        plan.net.transitions[t].name: v for t, v in (found.choices if found is not None else ())
    }


def test_a_draw_is_kept_while_others_go_round_where_they_are(tmp_path):
    """The one in `a` has drawn a partner who is busy; the marking does not change meanwhile."""
    net = NetBuilder().place("a", 1).place("b", 1).place("c", 1)
    net.immediate("meet", inputs=["a", "c"], outputs=["a", "c"])
    net.exponential("round", inputs="b", outputs="b")
    times = {"a": 0.5, "b": 1.0, "c": 5.5}
    plan = Plan(
        net.build(),
        policy=Policy(("a",), (PolicyRow((1,), (("meet", 1.0),)),)),
        actions={place: FunctionAction("actions.work", place) for place in times},
        robots=tuple(RobotSpec("r_" + place, place) for place in times),
        durations={place: Duration.deterministic(seconds) for place, seconds in times.items()},
    ).validate()
    log = str(tmp_path / "run.jsonl")
    run = VirtualRun(plan)
    writer = run.record_in(log, "run", "log")
    assert run.run(20.0).firings == {"meet": 3, "round": 20}
    writer.close()
    assert verify([read_log(log)]).violation is None


@pytest.mark.long
def test_a_cycle_without_time_may_begin_with_an_event(tmp_path):
    """The firing of the event is none of those that are counted until the run is cut off."""
    net = NetBuilder().place("a", 1).place("b").exponential("call", inputs="a", outputs="b")
    net.immediate("round", inputs="b", outputs="b")
    plan = Plan(
        net.build(),
        actions={"a": FunctionAction("actions.work", "a"), "b": None},
        robots=(RobotSpec("r", "a"),),
        events={"call": EventSource(after=1.0)},
    ).validate()
    log = str(tmp_path / "run.jsonl")
    run = VirtualRun(plan)
    writer = run.record_in(log, "run", "log")
    assert run.run(20.0).firings == {"call": 1, "round": 10_000}
    writer.close()
    assert verify([read_log(log)]).violation is None
