"""The page goes on by events as the server does: both have a board that events change, written in
two languages, and one table of cases and events made at random hold them together. The same for
what is shown of a robot."""

import itertools
import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_state import RobotState, TeamState, reported_phase
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.visualizer.board import Board

CASES = json.loads(
    (Path(__file__).parents[1] / "unit" / "visualizer" / "board_cases.json").read_text()
)

PLAY = """async ([data, events]) => {
  const { applyEvent, boardOf, copyOf } = await import("/static/js/board.js");
  const board = boardOf(data);
  const left = JSON.stringify(toJson(copyOf(board)));
  const kept = copyOf(board);
  for (const event of events) applyEvent(board, event);
  if (JSON.stringify(toJson(kept)) !== left) throw new Error("a copy went along");
  return toJson(board);
  function toJson(board) {
    return { ...board, enabled: [...board.enabled].sort(), robots: [...board.robots.values()] };
  }
}"""

TOLD = """async (robots) => {
  const { robotReport } = await import("/static/js/phases.js");
  return robots.map(([robot, status]) => robotReport(robot, status));
}"""


@pytest.fixture(name="page")
def _page(show_net, open_page):
    site = show_net(NetBuilder("n").place("P", tokens=1).immediate("T", inputs="P").build())
    return open_page(site.address)


SOME = st.sampled_from
NAMES = SOME(["a", "b", "__proto__", "ä b"])
PLACE = SOME([0, 1, 2])
SUBSET = st.lists(PLACE, unique=True)
PHASE = SOME([phase.value for phase in Phase])
ROBOT = st.fixed_dictionaries(
    {"name": NAMES},
    optional={
        "place": SOME([-1, 0, 1, 2, None]),
        "phase": PHASE,
        "why": st.text(max_size=3),
        "paused": st.booleans(),
        "attempt": st.integers(1, 3),
        "since": SOME([0, 7.5]),
    },
)
COUNTS = st.lists(st.integers(0, 9), min_size=3, max_size=3)
STATUS = st.dictionaries(SOME(["ended", "running", "__proto__x"]), SOME([None, True, "over"]))
FIRING = st.fixed_dictionaries(
    {
        "k": SOME(["fire", "undo"]),
        "tr": PLACE,
        "who": NAMES,
        "d": st.lists(st.tuples(PLACE, st.integers(-3, 3)), max_size=4),
        "en": SUBSET,
        "dis": SUBSET,
        "m": st.lists(st.tuples(NAMES, SOME([None, 0]), SOME([None, 0, 1, 2])), max_size=3),
    }
)
MARK = st.fixed_dictionaries(
    {"k": st.just("mark"), "marking": COUNTS, "enabled": SUBSET, "why": st.text(max_size=3)},
    optional={"restart": st.booleans(), "back": st.booleans(), "counts": COUNTS},
)
ROBOTS = st.fixed_dictionaries(
    {"k": st.just("robots"), "r": st.lists(ROBOT, max_size=3)},
    optional={"gone": st.lists(NAMES, max_size=2)},
)
NOTE = st.fixed_dictionaries(
    {"k": st.just("note"), "level": SOME(["info", "fault"]), "robot": NAMES, "text": st.text()}
)
CHANGE = st.fixed_dictionaries({"k": st.just("status"), "status": STATUS})
KEYS = SOME(["a", "__proto__x"])
DATA = st.fixed_dictionaries(
    {"k": st.just("data")},
    optional={
        "team": st.dictionaries(KEYS, st.text(max_size=2), max_size=2),
        "waiting": st.lists(st.tuples(NAMES, NAMES), max_size=2),
        "queues": st.dictionaries(KEYS, st.lists(st.tuples(NAMES), max_size=2), max_size=2),
    },
)
RENUMBERED = st.lists(SOME([None, 0, 1, 2]), min_size=3, max_size=3)
PLAN = st.fixed_dictionaries(
    {
        "k": st.just("plan"),
        "plan": st.integers(1, 9),
        "places": RENUMBERED,
        "transitions": RENUMBERED,
        "size": st.just(3),
        "marking": COUNTS,
        "enabled": SUBSET,
    }
)
EVENT = st.one_of(FIRING, MARK, ROBOTS, NOTE, CHANGE, DATA, PLAN)
BOARD = st.fixed_dictionaries(
    {
        "n": st.just(0),
        "t": st.just(0.0),
        "marking": COUNTS,
        "enabled": SUBSET.map(sorted),
        "counts": COUNTS,
        "robots": st.lists(ROBOT, unique_by=lambda robot: robot["name"], max_size=3),
        "notes": st.just([]),
        "status": STATUS,
    }
)


def test_the_page_goes_on_by_events_as_the_server_does(page):
    for case in CASES:
        assert page.evaluate(PLAY, [case["board"], case["events"]]) == {
            **case["board"],
            **case["after"],
        }, case["case"]

    @settings(max_examples=150, deadline=None)
    @given(BOARD, st.lists(st.tuples(EVENT, SOME([0, 0.25, 3])), max_size=12))
    def any_events(data, steps):
        events = [
            {**event, "n": number, "t": t} for number, (event, t) in enumerate(steps, start=1)
        ]
        board = Board.from_json(data)
        for event in events:
            board.apply(event)
        assert page.evaluate(PLAY, [data, events]) == json.loads(json.dumps(board.to_json()))

    any_events()


def test_the_page_says_of_a_robot_what_is_reported_of_it(page):
    logged = (Phase.DOING, Phase.DONE, Phase.FAILED, Phase.INACTIVE, Phase.LOST, Phase.LEFT)
    facts = list(itertools.product(logged, (False, True), (None, "stopped"), (False, True)))
    asked, expected = [], []
    for phase, paused, ended, finished in facts:
        state = TeamState((1,), ended=ended, finished=finished)
        robot = RobotState("r", 0, phase=phase, paused=paused)
        told = reported_phase(state, robot).report
        expected.append((told.word, told.tone, told.gone, told.needs_operator))
        asked.append(
            [
                {"name": "r", "place": 0, "phase": phase.value, "paused": paused},
                {"ended": ended, "finished": finished},
            ]
        )
    heard = page.evaluate(TOLD, asked)
    assert [(h["word"], h["tone"], h["gone"], h["needs_operator"]) for h in heard] == expected
