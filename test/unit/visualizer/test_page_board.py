"""The board of the server goes on by events as a table of cases says; test_browser_board.py holds
the board of the page to the same table."""

import json
from pathlib import Path

import pytest

from gspn_framework_package.visualizer.board import Board

CASES = json.loads(Path(__file__).with_name("board_cases.json").read_text())


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["case"])
def test_an_event_leads_where_the_table_says(case):
    board = Board.from_json(case["board"])
    for event in case["events"]:
        board.apply(event)
    assert board.to_json() == {**case["board"], **case["after"]}
