"""Attempts, read from the logs of runs: crafted ones, and those of simulated teams with faults."""

from __future__ import annotations

import json
from typing import Any, Dict, List, Tuple

import pytest
from game_driver import make_plan
from logged_runs import Story, ring, save_logs

from agreement.plans import make_plan as team_plan
from agreement.world import World
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.attempts import OUTAGE, AttemptFollower
from gspn_framework_package.execution.event_log import LogFile
from gspn_framework_package.execution.log_entries import Done, Failed
from gspn_framework_package.execution.log_writer import record_line
from gspn_framework_package.execution.logged_attempts import gather
from gspn_framework_package.execution.net_difference import net_difference
from gspn_framework_package.execution.seen_firings import SeenFiring, attempts_between
from gspn_framework_package.model.attempt import EventCount
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.failure import FAILURE_KINDS, FailureKind, FailureRule
from gspn_framework_package.model.plan import Plan, Timing

TOUR, MEET, TOKENS, CROWD = range(4)


def told(attempts: Any) -> List[Tuple[Any, ...]]:
    """Attempts without the log, with times since the log began."""
    return [
        (
            *(a.robot, a.place, a.visit, a.attempt),
            *(round(a.start - 100.0, 6), round(a.end - 100.0, 6)),
            a.failed or (a.result or "done" if a.completed else "censored"),
        )
        for a in attempts
    ]


def test_attempts_end_with_their_results_and_go_on_at_the_end_of_the_log(tmp_path) -> None:
    story = Story(ring()).start(1.0)
    story.slot(2.5, Done("a", 0, 1, "t1"))
    story.slot(3.0, Done("b", 0, 1))
    story.slot(4.0, Done("a", 0, 2, "t3"))  # waits for the resource
    story.slot(9.0, log_entries.Fire("made"))
    story.slot(9.5, Done("a", 0, 1, "t1"))  # stale
    assert told(gather([story.save(tmp_path / "log.jsonl")]).attempts) == [
        ("a", "A", 1, 1, 1.0, 2.5, "t1"),
        ("a", "B", 2, 1, 2.5, 4.0, "t3"),
        ("a", "A", 3, 1, 9.0, 9.5, "censored"),
        ("b", "A", 1, 1, 1.0, 3.0, "done"),
        ("b", "B", 2, 1, 3.0, 9.5, "censored"),
    ]


def test_failures_and_retries_are_attempts_of_their_own_and_delays_are_not_part_of_them(
    tmp_path,
) -> None:
    rules = {"A": FailureRule.retry(1, 2.0)}
    story = Story(ring(on_failure=rules)).start()
    story.slot(1.0, Failed("a", 0, 1, 1, "aborted"))
    story.slot(1.5, Failed("b", 0, 1, 1, "timeout"))
    story.slot(4.0, Failed("a", 0, 1, 2, "lost"))  # the attempts are used up
    story.slot(6.0, log_entries.Retry("a"))
    story.slot(6.5, Done("b", 0, 1, "t2"))  # does not leave A: tried again
    story.slot(7.0, Done("a", 0, 1, "None"))
    story.slot(8.0, Done("a", 0, 2))  # B has several exponential transitions
    assert told(gather([story.save(tmp_path / "log.jsonl")]).attempts) == [
        ("a", "A", 1, 1, 0.0, 1.0, "aborted"),
        ("a", "A", 1, 2, 3.0, 4.0, "lost"),
        ("a", "A", 1, 3, 6.0, 7.0, "done"),
        ("a", "B", 2, 1, 7.0, 8.0, "bad result"),
        ("b", "A", 1, 1, 0.0, 1.5, "timeout"),
        ("b", "A", 1, 2, 3.5, 6.5, "bad result"),
    ]


def test_a_pause_hides_nothing_and_the_operator_cuts_attempts_off(tmp_path) -> None:
    story = Story(ring()).start()
    story.slot(1.0, log_entries.Pause())
    story.slot(2.0, Done("a", 0, 1))
    story.slot(5.0, log_entries.Resume())
    story.slot(6.0, log_entries.SetPlace("b", "B"))
    story.slot(7.0, log_entries.Leave("a"))
    story.slot(9.0, log_entries.Stop())
    story.write(20.0, kind="peer", robot="b", log="x")
    assert told(gather([story.save(tmp_path / "log.jsonl")]).attempts) == [
        ("a", "A", 1, 1, 0.0, 2.0, "done"),
        ("a", "B", 2, 1, 5.0, 7.0, "censored"),
        ("b", "A", 1, 1, 0.0, 6.0, "censored"),
        ("b", "B", 2, 1, 6.0, 9.0, "censored"),
    ]


def test_a_place_without_action_has_no_attempts(tmp_path) -> None:
    net = NetBuilder("net").place("A", tokens=1).place("B").place("C")
    net.exponential("t1", inputs="A", outputs="B").immediate("t2", inputs="B", outputs="C")
    net.exponential("t3", inputs="C", outputs="A")
    story = Story(make_plan(net.build(), ["A"], idle=["B"])).start()
    story.slot(1.0, Done("a", 0, 1))
    story.slot(3.0, Done("a", 0, 3))
    assert [row[1] for row in told(gather([story.save(tmp_path / "log.jsonl")]).attempts)] == [
        "A",
        "C",
        "A",
    ]


def test_the_environment_is_counted_while_it_can_fire(tmp_path) -> None:
    story = Story(ring()).start()
    story.slot(1.0, log_entries.Fire("made"))
    story.slot(4.0, log_entries.Fire("made"))  # now it is inhibited
    story.slot(9.0, log_entries.Fire("made"))  # refused
    story.slot(10.0, Done("a", 0, 1))
    story.slot(11.0, Done("a", 0, 2, "t3"))
    story.slot(12.0, log_entries.Pause())
    story.slot(15.0, log_entries.Resume())
    story.slot(16.0, log_entries.Stop())
    found = gather([story.save(tmp_path / "log.jsonl")])
    assert found.events == {"made": EventCount(2, 4.0 + 1.0 + 1.0, {1: (2, 6.0)})}


def interrupted(**event: Any) -> Plan:
    """A is left when its action ends, or by an event that needs R; tasks come in as R."""
    net = (
        NetBuilder("interrupted")
        .place("A", tokens=2)
        .place("B")
        .place("R")
        .exponential("t1", inputs="A", outputs="B")
        .exponential("low", inputs=["A", "R"], outputs="B")
        .exponential("t2", inputs="B", outputs="A")
        .exponential("more", outputs="R", inhibitors={"R": 1})
        .build()
    )
    low = EventSource("battery", "a/B", **event)
    events = {"low": low, "more": EventSource("/more", "a/B")}
    return make_plan(net, ["A", "A"], resources=["R"], events=events)


def low(robot: str, visit: int) -> log_entries.Interrupt:
    return log_entries.Interrupt(robot, 0, visit, "low")


def test_an_event_ends_an_attempt_without_a_result_and_is_counted(tmp_path) -> None:
    story = Story(interrupted()).start()
    story.slot(1.0, low("a", 1))  # not enabled
    story.slot(2.0, log_entries.Submit("more", "m1"))
    story.slot(5.0, low("a", 1))
    story.slot(6.0, log_entries.Submit("more", "m2"))
    story.slot(7.0, log_entries.Submit("more", "m3"), log_entries.Submit("more", "m3"))
    story.slot(8.0, Done("b", 0, 1, "t1"))
    story.slot(10.0, log_entries.Stop())
    found = gather([story.save(tmp_path / "log.jsonl")])
    assert told(found.attempts)[:2] == [
        ("a", "A", 1, 1, 0.0, 5.0, "censored"),
        ("a", "B", 2, 1, 5.0, 10.0, "censored"),
    ]
    assert found.events == {
        "low": EventCount(1, 2 * 3.0 + 2.0, {1: (1, 8.0)}),
        "more": EventCount(3, 10.0, {1: (3, 10.0)}),
    }


def test_arrivals_are_counted_by_the_hour_and_by_what_they_bring(tmp_path) -> None:
    story = Story(interrupted()).start()  # 800 s before the end of the hour from 1 to 2
    story.slot(100.0, log_entries.Submit("more", "m1", {"kind": "a", "weight": 1.5, "at": [1, 2]}))
    story.slot(900.0, log_entries.Submit("more", "m2", {"kind": "b"}))
    story.slot(5000.0, log_entries.Submit("more", "m3", {"kind": "a"}))
    story.slot(5000.0, log_entries.Stop())
    more = gather([story.save(tmp_path / "log.jsonl")]).events["more"]
    assert more.hours == {1: (1, 800.0), 2: (1, 3600.0), 3: (1, 600.0)}
    assert more.data == {"kind": {"a": 2, "b": 1}}


def test_an_event_that_is_held_comes_once_in_a_visit(tmp_path) -> None:
    story = Story(interrupted(hold=True)).start()
    story.slot(1.0, low("a", 1))
    story.slot(2.0, low("a", 1))
    story.slot(5.0, log_entries.Submit("more", "m1"))
    story.slot(6.0, log_entries.Stop())
    events = gather([story.save(tmp_path / "log.jsonl")]).events
    assert events["low"] == EventCount(1, 2 * 1.0 + 5.0, {1: (1, 7.0)})


def test_a_result_that_leaves_the_choice_to_one_transition_is_none_of_several_with_events(
    tmp_path,
) -> None:
    story = Story(interrupted()).start()
    story.slot(1.0, Done("a", 0, 1, ""))
    rows = told(gather([story.save(tmp_path / "log.jsonl")]).attempts)
    assert rows[0] == ("a", "A", 1, 1, 0.0, 1.0, "done")


def test_a_firing_of_an_event_tells_no_end_of_an_action() -> None:
    net = NetBuilder().place("A").exponential("go", inputs="A", outputs="A")
    net.exponential("bell", inputs="A", outputs="A")
    plan = make_plan(net.build(), ["A"], events={"bell": EventSource("bell", "a/B")})
    found, _ = attempts_between(
        plan, [fired(1.0, "go", "a", "A"), fired(2.0, "bell", "a", "A"), fired(4.0, "go", "a", "A")]
    )
    assert [(a.result, a.completed) for a in found] == [("", False), ("go", True), ("", False)]


def test_a_follower_tells_of_what_goes_on_now() -> None:
    story = Story(ring(on_failure={"A": FailureRule.retry(1, 2.0)})).start()
    story.slot(1.0, Failed("a", 0, 1, 1, "aborted"))
    follower = AttemptFollower(story.plan, agents=True)
    ended = [attempt for record in story.records for attempt in follower.take(record)]
    assert told(ended) == [("a", "A", 1, 1, 0.0, 1.0, "aborted")]
    assert told(follower.running(102.5)) == [("b", "A", 1, 1, 0.0, 2.5, "censored")]
    assert sorted(told(follower.running(103.5))) == [
        ("a", "A", 1, 2, 3.0, 3.5, "censored"),
        ("b", "A", 1, 1, 0.0, 3.5, "censored"),
    ]


# -- a robot's own log -----------------------------------------------------------------------------


def own_story(plan: Plan) -> Story:
    story = Story(plan, "a")
    story.write(0.0, kind="life", incarnation=0, host="boot")
    story.start(0.1)
    story.write(0.5, kind="active")
    return story


def goal(
    story: Story, t: float, place: str, visit: int, attempt: int, incarnation: int = 0
) -> None:
    story.write(t, kind="goal", place=place, incarnation=incarnation, visit=visit, attempt=attempt)


def test_a_robots_own_log_tells_when_its_goals_were_sent(tmp_path) -> None:
    story = own_story(ring(on_failure={"A": FailureRule.retry(1, 2.0)}))
    goal(story, 0.6, "A", 1, 1)
    story.slot(1.0, Failed("a", 0, 1, 1, "aborted"))
    goal(story, 1.0, "A", 1, 2)
    story.slot(5.0, Done("a", 0, 1, "t1"))
    goal(story, 5.0, "B", 2, 1)
    story.write(6.0, kind="cancel", visit=2)
    story.slot(6.0, log_entries.SetPlace("a", "A"))
    goal(story, 6.5, "A", 3, 1)
    story.write(7.0, kind="promised", slot=1, ballot=[1, "b"])
    # the node died, and comes back: the attempt was last known to go on at 7
    story.write(30.0, kind="life", incarnation=1, host="boot")
    story.slot(31.0, log_entries.Join("a", 1))
    goal(story, 31.5, "A", 3, 2, 1)
    story.slot(33.0, Done("a", 1, 3))
    own = [
        row for row in told(gather([story.save(tmp_path / "a.jsonl")]).attempts) if row[0] == "a"
    ]
    assert own == [
        ("a", "A", 1, 1, 0.6, 1.0, "aborted"),
        ("a", "A", 1, 2, 3.0, 5.0, "t1"),
        ("a", "B", 2, 1, 5.0, 6.0, "censored"),
        ("a", "A", 3, 1, 6.5, 7.0, "censored"),
        ("a", "A", 3, 2, 31.5, 33.0, "done"),
    ]


def test_each_goal_has_the_delay_of_its_own_attempt(tmp_path, monkeypatch) -> None:
    rule = FailureRule("growing", 3, (1.0, 2.0))
    kind = FailureKind(lambda data: rule, lambda rule: {"growing": 3}, {"type": "object"})
    monkeypatch.setitem(FAILURE_KINDS, "growing", kind)
    story = own_story(ring(on_failure={"A": rule}))
    goal(story, 1.0, "A", 1, 1)
    for attempt, end in ((1, 2.0), (2, 4.0), (3, 7.0), (4, 10.0)):
        story.slot(end, Failed("a", 0, 1, attempt, "aborted"))
        if attempt < 4:
            goal(story, end, "A", 1, attempt + 1)
    story.slot(11.0, log_entries.Retry("a"))
    goal(story, 11.0, "A", 1, 5)
    story.slot(12.0, Failed("a", 0, 1, 5, "aborted"))
    goal(story, 12.0, "A", 1, 6)
    story.slot(14.0, Done("a", 0, 1, "t1"))
    log = gather([story.save(tmp_path / "a.jsonl")])
    begun = [row[4] for row in told(log.attempts) if row[:2] == ("a", "A")]
    assert begun == [1.0, 3.0, 6.0, 9.0, 11.0, 13.0]


def test_the_monotonic_clock_of_another_boot_is_not_compared(tmp_path) -> None:
    story = own_story(ring())
    goal(story, 1.0, "A", 1, 1)
    story.slot(2.0, Done("a", 0, 1))
    for t, mono, record in (
        (50.0, 500.0, {"kind": "life", "incarnation": 1, "host": "another boot"}),
        (51.0, 501.0, {"kind": "active"}),
        (52.0, 502.0, {"kind": "goal", "place": "B", "incarnation": 1, "visit": 2, "attempt": 1}),
        (54.0, 504.0, {"kind": "cancel", "visit": 2}),
    ):
        line, story.sum = record_line({**record, "wall": 1e9 + t, "mono": mono}, story.sum)
        story.lines.append(line)
    own = [
        row for row in told(gather([story.save(tmp_path / "a.jsonl")]).attempts) if row[0] == "a"
    ]
    assert own == [
        ("a", "A", 1, 1, 1.0, 2.0, "done"),
        ("a", "B", 2, 1, 52.0, 54.0, "censored"),
    ]


def test_an_evicted_robot_was_last_known_to_act_before_it_fell_silent(tmp_path) -> None:
    story = own_story(ring(timing=Timing(evict_after=3.0)))
    story.slot(1.0, Done("b", 0, 1))
    story.slot(9.0, log_entries.Evict("b", 0))
    story.slot(20.0, log_entries.Join("b", 1))
    story.slot(22.0, log_entries.Evict("b", 1))  # silent for longer than it was back
    others = [
        row for row in told(gather([story.save(tmp_path / "a.jsonl")]).attempts) if row[0] == "b"
    ]
    assert others == [("b", "B", 2, 1, 1.0, 6.0, "censored")]


# -- simulated teams -------------------------------------------------------------------------------


class Watched(World):
    """A simulated team that notes when each action really starts and ends."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.truth: Dict[Tuple[str, int, int], List[Any]] = {}

    def start_action(self, node: Any, given: Any) -> None:
        key = (given.robot, given.visit, given.attempt)
        self.truth[key] = [given.place, self.now + given.delay, None]
        real = self.at

        def note(time: float, what: Any) -> None:
            def end() -> None:
                self.truth[key][2] = self.now
                what()

            real(time, end)

        self.at = note  # type: ignore[method-assign]
        try:
            super().start_action(node, given)
        finally:
            self.at = real  # type: ignore[method-assign]


def team(tmp_path: Any, kind: int, partial: bool, crash: bool = False) -> Tuple[Watched, List[str]]:
    world = Watched(team_plan(kind, 3, partial, 0.0, 0.0, False), 5)
    nodes = list(world.nodes.values())
    for node in nodes:
        node.start()
    world.run(1.0)
    if crash:
        nodes[1].crash()
        world.run(1.5)
        nodes[1].start()
        world.run(3.0)
    world.acting = False
    assert world.run(8.0, world.has_settled)
    return world, save_logs(world, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "partial", "crash"),
    [
        (TOUR, True, False),
        (TOUR, False, True),
        (MEET, False, False),
        (TOKENS, True, True),
        (CROWD, False, True),
        (CROWD, True, False),
    ],
)
def test_the_logs_of_a_team_tell_every_attempt_once(tmp_path, kind, partial, crash) -> None:
    world, paths = team(tmp_path, kind, partial, crash)
    found = gather(paths)
    assert [sorted(run) for run in found.runs] == [list(range(len(paths)))]
    keys = [(a.robot, a.visit, a.attempt) for a in found.attempts]
    assert len(keys) == len(set(keys))
    completed = 0
    for attempt in found.attempts:
        place, start, end = world.truth[attempt.robot, attempt.visit, attempt.attempt]
        assert (attempt.place, round(attempt.start, 6)) == (place, round(start, 6))
        if attempt.completed:
            completed += 1
            assert end is not None
            assert end - 1e-6 <= attempt.end <= end + OUTAGE + 1e-6  # the team has to agree on it
    ended = sum(end is not None for _, _, end in world.truth.values())
    # those that ended as their node was down, or in the last moment, are not in the logs
    assert ended - 6 <= completed <= ended
    assert completed > 15
    assert set(keys) >= {key for key, (_, start, _) in world.truth.items() if start < 1.0}


def test_a_log_that_is_missing_is_made_up_for_by_another(tmp_path) -> None:
    _, paths = team(tmp_path, TOKENS, False)
    whole = gather(paths)
    partly = gather(paths[:2])
    lost = {LogFile(paths[2]).header["robot"]}
    assert any(lost.copy().pop() in note for note in partly.notes), partly.notes

    def of(found: Any, own: bool) -> Dict[Any, Any]:
        return {
            (a.robot, a.visit, a.attempt): a
            for a in found.attempts
            if a.completed and (a.robot not in lost) == own
        }

    assert [a[:6] for a in of(partly, True).values()] == [a[:6] for a in of(whole, True).values()]
    theirs, exact = of(partly, False), of(whole, False)
    assert len(theirs) >= len(exact) - 1  # the first began before anybody took part
    for key, attempt in theirs.items():
        assert attempt.duration == pytest.approx(exact[key].duration, abs=0.1)


def test_without_its_own_log_a_robot_of_a_partial_team_is_left_out(tmp_path) -> None:
    _, paths = team(tmp_path, TOUR, True)
    found = gather(paths[:1])
    assert {a.robot for a in found.attempts} == {"r1"}
    assert any("partial" in note for note in found.notes)


# -- several logs ----------------------------------------------------------------------------------


def simple(plan: Plan, log: str, t: float = 1.0) -> Story:
    story = Story(plan, log=log).start()
    story.slot(t, Done("a", 0, 1))
    return story


def test_several_runs_are_taken_together_and_a_copy_counts_once(tmp_path) -> None:
    one = simple(ring(), "one").save(tmp_path / "one.jsonl")
    two = simple(ring(seed=3), "two", 2.0)
    shorter = two.save(tmp_path / "shorter.jsonl")
    two.slot(3.0, Done("b", 0, 1))
    longer = two.save(tmp_path / "longer.jsonl")
    found = gather([one, shorter, longer])
    assert found.runs == ((0,), (2,))
    assert [(a.robot, a.log) for a in found.attempts if a.completed] == [
        ("a", 0),
        ("a", 2),
        ("b", 2),
    ]
    assert any("same log" in note for note in found.notes)


def test_logs_of_another_net_are_refused(tmp_path) -> None:
    net = NetBuilder("net").place("A", tokens=2).place("B").place("R")
    net.exponential("t1", inputs="A", outputs="B").exponential("t2", inputs="B", outputs="A")
    other = make_plan(net.build(), ["A", "A"], resources=["R"])
    one = simple(ring(), "one").save(tmp_path / "one.jsonl")
    two = simple(other, "two").save(tmp_path / "two.jsonl")
    with pytest.raises(
        LogError, match=r"two.jsonl.*its net differs.*one.jsonl.*no transition 't3'"
    ):
        gather([one, two])
    with pytest.raises(LogError, match="its net differs"):
        gather([two], ring())
    assert net_difference(ring(), ring(seed=8)) == ""


def test_a_log_in_which_a_line_was_changed_is_refused(tmp_path) -> None:
    path = tmp_path / "log.jsonl"
    path.write_text("".join(simple(ring(), "one").lines).replace('"visit":1,', '"visit":2,', 1))
    with pytest.raises(LogError, match=r"log.jsonl:3: does not follow from the lines before it"):
        gather([str(path)])


@pytest.mark.parametrize(
    "record",
    [
        {"kind": "goal", "place": "nowhere", "incarnation": 0, "visit": 1, "attempt": 1},
        {"kind": "goal"},
        {"kind": "cancel"},
        {"kind": "cancel", "visit": "x"},
        {"kind": "private", "entry": 3},
        {"kind": "slot", "slot": 7, "entries": [], "firings": []},
        {"kind": "slot", "entries": [], "firings": []},
        {"kind": "snapshot", "slot": 3, "state": 4},
        {"kind": "life"},
    ],
)
def test_a_record_that_makes_no_sense_is_an_error_with_its_line(tmp_path, record) -> None:
    story = own_story(ring())
    goal(story, 1.0, "A", 1, 1)
    story.write(2.0, **record)
    path = story.save(tmp_path / "a.jsonl")
    with pytest.raises(LogError) as caught:
        gather([path])
    assert "a.jsonl:6" in str(caught.value)


def test_a_cut_last_line_is_left_out_and_said(tmp_path) -> None:
    story = simple(ring(), "one")
    path = tmp_path / "log.jsonl"
    path.write_text("".join(story.lines)[:-5])
    found = gather([str(path)])
    assert any("cut off" in note for note in found.notes)
    assert told(found.attempts) == [
        ("a", "A", 1, 1, 0.0, 0.0, "censored"),
        ("b", "A", 1, 1, 0.0, 0.0, "censored"),
    ]


def test_progress_is_reported(tmp_path) -> None:
    story = Story(ring()).start()
    for k in range(2_500):
        story.write(float(k), kind="peer", robot="x", log=json.dumps(k))
    seen: List[Tuple[str, int, float]] = []
    gather([story.save(tmp_path / "log.jsonl")], progress=lambda *told: seen.append(told))
    assert [count for _, count, _ in seen] == [2_000, 4_000]


# -- firings without a log -------------------------------------------------------------------------


def fired(t: float, transition: str, robot: str, target: str, **more: Any) -> SeenFiring:
    return SeenFiring(t, "run", transition, robot, ((robot, target),), (t,))._replace(**more)


def test_firings_alone_tell_of_the_places_where_nobody_waits() -> None:
    heard = [
        fired(1.0, "t1", "a", "B"),
        fired(2.0, "t1", "b", "B"),
        fired(3.0, "t2", "a", "A"),
        fired(3.0, "t2", "a", "A"),  # heard twice
        fired(4.5, "t1", "a", "B"),
        fired(6.0, "t2", "b", "A"),
        fired(7.0, "t2", "a", "A"),
        fired(9.0, "t2", "b", "A"),  # how b came to B was not heard
        fired(9.5, "t1", "b", "B", run="another"),
    ]
    found, notes = attempts_between(ring(), heard, 3)
    assert [a[:2] + a[4:8] for a in found] == [
        ("a", "A", 3.0, 4.5, True, "t1"),
        ("a", "A", 7.0, 9.0, False, ""),
        ("b", "A", 9.0, 9.0, False, ""),
    ]
    assert {a.log for a in found} == {3}
    assert any("robots may wait in B" in note for note in notes)  # t3 needs the resource
    assert any("1 firings are missing" in note for note in notes)
    with pytest.raises(LogError, match="is not of this net"):
        attempts_between(ring(), [fired(1.0, "t9", "a", "B")])
