"""A team's log, and what is heard of it, as the page shows it: never another marking than the token
game's."""

import random
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.visualizer.fired_follower import (
    FiredFollower,
    RobotSeen,
    TeamSeen,
)
from gspn_framework_package.visualizer.team_events import TeamEvents

PLANS = ["plans/patrol", "plans/rendezvous", "plans/tokens", "plans/measure"]


def random_run(plan, seed, slots=60, evict=0.04):
    """Slots of a random run: (game, entries, firings, state)."""
    game, source = TokenGame(plan), random.Random(seed)
    state = game.new_state()
    yield game, (game.start_entry(),), game.reduce(state, 0, [game.start_entry()]).firings, state
    for slot in range(1, slots):
        busy = [r for r in state.robots.values() if r.phase.value == "doing"]
        if not busy and not state.paused:
            return
        robot = source.choice(busy or list(state.robots.values()))
        timed = [t for t in plan.net.consumers[robot.place] if plan.net.transitions[t].timed]
        result = plan.net.transitions[source.choice(timed)].name if timed else ""
        entry = log_entries.Done(robot.name, robot.incarnation, robot.visit, result)
        if source.random() < evict and len(state.active()) > 1:
            entry = log_entries.Evict(robot.name, robot.incarnation)
        elif state.paused and (not busy or source.random() < 0.3):
            entry = log_entries.Resume("")
        elif not state.paused and source.random() < 0.04:
            entry = log_entries.Pause("")
        yield game, (entry,), game.reduce(state, slot, [entry]).firings, state


@pytest.mark.long
@pytest.mark.parametrize("folder", PLANS)
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_the_board_follows_the_state_of_the_team(folder, seed):
    plan = read_plan(folder)
    board = None
    for game, entries, firings, state in random_run(plan, seed):
        if board is None:
            events = TeamEvents(game)
            board = events.board(True)
        for number, event in enumerate(events.step(entries, firings, state, 1.0), board.n + 1):
            board.apply({**event, "n": number})
        assert tuple(board.marking) == state.marking
        assert sorted(board.enabled) == list(plan.net.enabled(state.marking, by_priority=False))
        assert board.status["paused"] == state.paused
        assert {r["name"]: (r["place"], r["phase"], r["visit"]) for r in board.robots.values()} == {
            r.name: (r.place, r.phase.value, r.visit) for r in state.robots.values()
        }
        for robot in state.active():
            assert board.robots[robot.name]["why"] == game.why_waiting(state, robot)


class Message(NamedTuple):
    """What the page reads of a FiredTransition."""

    transition: str
    robot: str
    visit: int
    robots: list
    robot_places: list
    places: list
    counts: list
    slot: int
    index: int
    private_move: bool


def heard(plan, seed):
    """The messages of a random run, and the final marking."""
    news, marking = [], plan.net.initial_marking
    for _, _, firings, state in random_run(plan, seed, evict=0):
        for f in firings:
            moves = [m for m in f.moves if m.target]
            news.append(
                Message(
                    f.transition,
                    f.robot,
                    f.visit,
                    [m.robot for m in moves],
                    [m.target for m in moves],
                    [p.name for p in plan.net.places],
                    list(f.marking),
                    f.slot,
                    f.index,
                    False,
                )
            )
        marking = state.marking
    return news, marking


@pytest.mark.long
@pytest.mark.parametrize("folder", PLANS)
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32), shuffle=st.integers(1, 6))
def test_messages_late_twice_and_out_of_order_give_one_marking(folder, seed, shuffle):
    plan = read_plan(folder)
    news, marking = heard(plan, seed)
    source = random.Random(seed)
    order = sorted(range(len(news)), key=lambda i: i + source.random() * shuffle)
    follower = FiredFollower(plan)
    fired = []
    for i in order:
        for _ in range(source.choice([1, 1, 2])):
            fired += [e for e in follower.take(news[i], 0.0) if e["k"] == "fire"]
    assert follower.marking == marking
    assert [tuple(e["s"]) for e in fired] == [(n.slot, n.index) for n in news]
    assert not follower.lost_track


def test_a_missing_message_is_noticed_and_the_answer_taken_over():
    plan = read_plan("plans/patrol")
    news, marking = heard(plan, 5)
    follower = FiredFollower(plan)
    for item in news[:5] + news[6:9]:
        follower.take(item, 0.0)
    follower.retry(10.0)
    assert follower.lost_track
    assert news[9].index == 0  # the answer is of a whole slot
    before = tuple(news[8].counts)
    seen = TeamSeen(before, {"robot_1": RobotSeen(0, 3)}, news[8].slot + 1)
    assert [e["k"] for e in follower.adopt(seen, "caught up")] == ["mark"]
    assert follower.marking == before and not follower.lost_track
    for item in news[9:]:
        follower.take(item, 0.0)
    assert follower.marking == marking


def test_with_nobody_to_ask_the_page_goes_on_and_says_so():
    plan = read_plan("plans/patrol")
    news, marking = heard(plan, 6)
    follower = FiredFollower(plan)
    events = []
    for item in news[:4] + news[6:]:
        events += follower.take(item, 0.0)
        follower.retry(10.0)
        while follower.lost_track:
            events += follower.give_up("firings were missed")
    assert follower.marking == marking
    assert [e["why"] for e in events if e["k"] == "mark"] == ["firings were missed"]


def test_opened_in_mid_run_the_marking_is_right_at_once():
    plan = read_plan("plans/patrol")
    news, marking = heard(plan, 7)
    at = next(i for i in range(len(news) // 2, len(news)) if news[i + 1].index == 0)
    follower = FiredFollower(plan)
    seen = TeamSeen(tuple(news[at].counts), {}, news[at].slot + 1)
    assert follower.is_behind(seen)
    follower.adopt(seen, "opened in mid-run")
    for item in news:
        follower.take(item, 0.0)
    assert follower.marking == marking


@pytest.mark.parametrize(
    "details, why, tasks",
    [
        ("", None, None),
        (
            '{"cause": {"percentage": 0.1}, "tasks": [["o1", "", "place X"]]}',
            "percentage: 0.1",
            "o1",
        ),
        ("no JSON", None, None),
        ('{"cause": 7, "tasks": [["o1"]]}', None, None),
    ],
)
def test_a_message_may_tell_the_cause_and_the_tasks(details, why, tasks):
    class Detailed(Message):
        pass

    plan = read_plan("plans/patrol")
    news = Detailed(*heard(plan, 5)[0][0])
    news.details = details
    (event,) = FiredFollower(plan).take(news, 0.0)
    assert event.get("why") == why
    assert event.get("tk") == ([[tasks, "", "place X"]] if tasks else None)
