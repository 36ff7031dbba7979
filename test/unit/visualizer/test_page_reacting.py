"""Data, tasks and the causes of events on the page: in a run, in its replay, and as a robot reports
them."""

from __future__ import annotations

import contextlib
import json
from dataclasses import replace
from typing import Any, Dict, List

import pytest
from shop_plan import SLOTS, shop

from gspn_framework_package.cli.status import data_lines
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.displayed_data import (
    SHOWN_LENGTH,
    displayed_robot,
    displayed_team,
    shown,
)
from gspn_framework_package.execution.event_log import LogFile, header
from gspn_framework_package.execution.ledger import Ledger
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.errors import DataError, RefusedError
from gspn_framework_package.model.event import Tasks
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.orders import ORDERS, PAGE
from gspn_framework_package.visualizer import recording
from gspn_framework_package.visualizer.board import Board
from gspn_framework_package.visualizer.team_events import TeamEvents


def start_of(game: TokenGame) -> Any:
    """The first to finish goes first, so that it is known who takes which task."""
    return game.start_entry()._replace(draws_ties=False)


def played(plan: Plan) -> Any:
    """The board, all events, and the ledger after the slots above."""
    game = TokenGame(plan)
    ledger = Ledger(game)
    events = TeamEvents(game)
    board = events.board(True)
    told: List[Dict[str, Any]] = []
    for number, entries in enumerate([[start_of(game)], *SLOTS]):
        step = game.reduce(ledger.state, number, entries)
        for event in events.step(entries, step.firings, ledger.state, float(number)):
            event["n"] = board.n + 1
            board.apply(event)
            told.append(event)
    return board, told, ledger


def test_data_tasks_and_causes_are_on_the_board():
    board, told, ledger = played(shop())
    assert board.data["team"] == {"door": "open"}
    assert board.data["queues"] == {
        "Orders": [["o%d" % i, {"pose": "[%d, 0]" % i}] for i in (4, 5, 6)]
    }
    assert board.data["waiting"] == [["order", "o7"]]
    a, b = board.robots["a"], board.robots["b"]
    assert a["data"] == {"charged": "12"} and a["task"] == ["o3", {"pose": "[3, 0]"}]
    assert b["data"] == {"note": shown("x" * 1000)} and len(b["data"]["note"]) == SHOWN_LENGTH
    assert (b["resumed_from"], b["held"]) == (2, {})
    fired = [e for e in told if e["k"] == "fire"]
    assert [e["why"] for e in fired if "why" in e] == ["percentage: 0.1", "percentage: 0.15"]
    assert fired[0]["tk"] == [["o1", "", "place Orders"]]
    assert ["o1", "robot a", "done"] in [move for e in fired for move in e.get("tk", [])]
    held = [r for e in told if e["k"] == "robots" for r in e["r"] if r.get("held")]
    assert [(r["name"], r["held"]) for r in held] == [("b", {"low": "percentage: 0.15"})]
    assert displayed_team(ledger.state, ledger.game.net)["queues"]["Orders"][0] == [
        "o4",
        {"pose": [4, 0]},
    ]
    json.dumps(board.to_json())


def test_a_replay_shows_them_at_any_moment(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "LINES_BETWEEN", 2)
    plan = shop()
    path = str(tmp_path / "run.jsonl")
    ledger = Ledger(TokenGame(plan))
    with contextlib.closing(EventLogWriter(path, header(plan, "run", "", "log"))) as log:
        for slot, entries in enumerate([[start_of(ledger.game)], *SLOTS]):
            step = ledger.game.reduce(ledger.state, slot, entries)
            log.append(ledger.record(slot, entries, [], step))
    live, told, _ = played(plan)
    found = recording.Recording(LogFile(path))
    for _ in found.read():
        pass
    assert len(found._marks) > 2
    last = found.board_at(10**6)
    assert last.data == live.data
    assert {n: {**r, "since": 0} for n, r in last.robots.items()} == {
        n: {**r, "since": 0} for n, r in live.robots.items()
    }
    board = found.first_board()
    for event in found.events(0, 10**6):
        board.apply(event)
        assert found.board_at(event["n"]).to_json() == board.to_json()
    assert [e["why"] for e in found.events(0, 10**6) if "why" in e] == [
        e["why"] for e in told if "why" in e
    ]


def test_a_plan_without_data_tells_nothing_of_it():
    plan = replace(shop(), events={}, tasks=Tasks()).validate()
    game = TokenGame(plan)
    state = game.new_state()
    events = TeamEvents(game)
    board = events.board(True)
    entries = [game.start_entry()]
    step = game.reduce(state, 0, entries)
    for event in events.step(entries, step.firings, state, 0.0):
        assert event["k"] != "data"
        board.apply({**event, "n": board.n + 1})
    assert "data" not in board.to_json() and "task" not in board.robots["a"]


@pytest.mark.parametrize("value, text", [("x", "x"), ({"a": [1, "ä"]}, '{"a": [1, "ä"]}')])
def test_values_are_shown_as_short_texts(value: Any, text: str):
    assert shown(value) == text


def test_a_board_without_data_is_read_as_before():
    assert Board.from_json(Board(0, [1]).to_json()).data == {}


def submission(plan, fields):
    kind = ORDERS["submit"]
    return kind.entry(**kind.values(fields, PAGE, plan))


def test_a_task_of_the_page_is_checked():
    task = submission(shop(), {"transition": "order", "id": " o9 ", "data": {"pose": [1, 2]}})
    assert task == log_entries.Submit("order", "o9", {"pose": [1, 2]})
    made_up = [submission(shop(), {"transition": "order"}).id for _ in range(2)]
    assert all(made_up) and len(set(made_up)) == 2


@pytest.mark.parametrize(
    "fields, error",
    [
        ({"transition": "delivered"}, RefusedError),
        ({}, DataError),
        ({"transition": "order", "id": True}, DataError),
        ({"transition": "order", "id": "x" * 201}, DataError),
        ({"transition": "order", "data": [1]}, DataError),
        ({"transition": "order", "data": {"no name": 1}}, DataError),
        ({"transition": "order", "data": {"task.pose": 1}}, DataError),
        ({"transition": "order", "data": {"a": float("nan")}}, DataError),
        ({"transition": "order", "data": {"a": "x" * 64_000}}, DataError),
    ],
)
def test_a_task_of_the_page_that_cannot_be_taken_is_refused(fields: Any, error: Any):
    with pytest.raises(error):
        submission(shop(), fields)


def test_the_status_command_prints_data_tasks_and_held_events():
    _, _, ledger = played(shop())
    net, state = ledger.game.net, ledger.state
    state.robots["b"].held[net.transition_index["low"]] = {"percentage": 0.1}
    robots = [{"robot": r.name, **displayed_robot(r, net)} for r in state.robots.values()]
    status = {"robots": robots, "data": displayed_team(state, net)}
    assert data_lines(json.loads(json.dumps(status))) == [
        "a has task o3",
        "a task.pose: [3, 0]",
        "a robot.charged: 12",
        "b has task o2",
        "b task.pose: [2, 0]",
        "b holds low: percentage: 0.1",
        "b robot.note: " + "x" * (SHOWN_LENGTH - 1) + "…",
        "team.door: open",
        "queue Orders: o4, o5, o6",
        "order: task o7 is waiting outside",
    ]
    assert data_lines({"robots": [{"robot": "a"}]}) == []
