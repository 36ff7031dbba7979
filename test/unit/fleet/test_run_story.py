"""The story of a run: who waited for whom, why, and what it looks like as a file."""

from __future__ import annotations

import json
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, List, Tuple

import pytest
from game_driver import make_plan
from logged_runs import Story, ring

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.log_entries import Done, Failed
from gspn_framework_package.fleet.run_story import (
    RunStory,
    read_story,
    time_by_use,
    time_text,
    waited_for,
)
from gspn_framework_package.fleet.stay_follower import DAY_SECONDS
from gspn_framework_package.fleet.story_page import story_page
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.failure import FailureRule


def meeting() -> Story:
    """Robots a and b meet; c needs the place that a leaves then, since it has room for one."""
    net = (
        NetBuilder("meeting")
        .place("Scan", tokens=1)
        .place("Come", tokens=1)
        .place("Queue", tokens=1)
        .place("Free")
        .place("Away")
        .exponential("meet", inputs=["Scan", "Come"], outputs=["Away", "Away", "Free"])
        .exponential("enter", inputs=["Queue", "Free"], outputs="Away")
        .build()
    )
    plan = make_plan(
        net,
        ["Scan", "Come", "Queue"],
        resources=["Free"],
        on_failure={"Scan": FailureRule.retry(3)},
    )
    story = Story(plan).start()
    story.slot(1.0, Done("b", 0, 1, "meet"))
    story.slot(2.0, Done("c", 0, 1, "enter"))
    story.slot(31.0, Failed("a", 0, 1, 1, "timeout"))
    story.slot(40.0, Done("a", 0, 1, "meet"))
    return story


def told(story: Story, folder: Path) -> RunStory:
    return read_story(story.save(folder / "run.jsonl"))


def test_a_wait_has_the_robot_that_came_last_as_its_cause(tmp_path: Path) -> None:
    story = told(meeting(), tmp_path)
    assert [(w.robot, w.begin, w.end, w.transition, w.awaited) for w in story.waits] == [
        ("b", 1.0, 40.0, "meet", "a"),
        ("c", 2.0, 40.0, "enter", "a"),  # through the firing of meet, which makes room
    ]
    assert story.waits[0].needs == "wants meet: needs a robot in Scan"
    assert story.waits[0].text() == (
        "waited 39.0 s in Come for a, which failed in Scan at 0:31.0, until it ended its action "
        "in Scan"
    )
    assert waited_for(story) == [{"robot": "a", "seconds": 77.0, "waits": 2, "by": ["b", "c"]}]


def test_a_wait_for_the_environment_is_for_no_robot(tmp_path: Path) -> None:
    story = Story(ring()).start()
    story.slot(1.0, Done("a", 0, 1, "t1"))
    story.slot(2.0, Done("a", 0, 2, "t3"))
    story.slot(9.0, log_entries.Fire("made"))
    read = told(story, tmp_path)
    assert [(w.awaited, w.text()) for w in read.waits] == [
        ("", "waited 7.0 s in B, until the environment fired made")
    ]
    assert waited_for(read) == []


def test_the_cause_of_a_wait_may_have_waited_itself(tmp_path: Path) -> None:
    net = (
        NetBuilder("chain")
        .place("A", tokens=1)
        .place("B", tokens=1)
        .place("C")
        .place("R")
        .place("End")
        .exponential("go", inputs=["A", "R"], outputs="C")
        .exponential("meet", inputs=["C", "B"], outputs=["End", "End"])
        .exponential("made", outputs="R", rate=4.0)
        .build()
    )
    story = Story(make_plan(net, ["A", "B"], resources=["R"])).start()
    story.slot(1.0, Done("a", 0, 1, "go"))
    story.slot(2.0, Done("b", 0, 1, "meet"))
    story.slot(10.0, log_entries.Fire("made"))
    story.slot(15.0, Done("a", 0, 2, "meet"))
    assert told(story, tmp_path).waits[-1].text() == (
        "waited 13.0 s in B for a, which itself waited 8.0 s in A, until it ended its action in C"
    )


def test_a_wait_that_has_not_ended_says_what_is_needed(tmp_path: Path) -> None:
    story = Story(ring()).start()
    story.slot(1.0, Done("a", 0, 1, "t1"))
    story.slot(2.0, Done("a", 0, 2, "t3"))
    story.slot(4.5, Done("b", 0, 1, "t1"))
    assert [w.text() for w in told(story, tmp_path).waits] == [
        "waited 2.5 s in B, to the end of the log: wants t3: R has 0 of 1 token"
    ]


def test_what_is_over_midnight_is_one_wait(tmp_path: Path) -> None:
    story = Story(ring()).start()
    story.slot(1.0, Done("a", 0, 1, "t1"))
    story.slot(2.0, Done("a", 0, 2, "t3"))
    story.slot(2.0 + 2 * DAY_SECONDS, log_entries.Fire("made"))
    read = told(story, tmp_path)
    assert [w.seconds for w in read.waits] == [2.0 * DAY_SECONDS]
    assert time_by_use(read)["a"] == {
        "acting": 2.0,
        "waiting": 2.0 * DAY_SECONDS,
        **dict.fromkeys(("paused", "failed", "resting"), 0.0),
    }


@pytest.mark.parametrize(
    "t, text", [(0.0, "0:00.0"), (59.97, "0:59.9"), (61.25, "1:01.2"), (3725.0, "1:02:05")]
)
def test_times_are_minutes_and_seconds(t: float, text: str) -> None:
    assert time_text(t) == text


class _Read(HTMLParser):
    """Tags with their attributes, and texts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: List[Tuple[str, Any]] = []
        self.said = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.said += data


def test_the_file_needs_no_other_file_and_no_script(tmp_path: Path) -> None:
    story = told(meeting(), tmp_path)
    page = _Read(story_page(story, "run.jsonl", "http://robot:8090/#replay"))
    assert not {"script", "link", "img", "iframe"} & {tag for tag, _ in page.tags}
    links = [a["href"] for t, a in page.tags if t == "a"]
    assert links[:2] == ["http://robot:8090/#replay&slot=4"] * 2
    assert "waited 39.0 s in Come for a, which failed in Scan at 0:31.0" in page.said
    lanes = [a for t, a in page.tags if t == "rect"]
    assert {a["class"] for a in lanes} == {"acting", "waiting"}
    assert all(int(a["width"]) >= 1 for a in lanes)


def test_names_are_only_text(tmp_path: Path) -> None:
    bad = "<script>alert(1)</script>"
    net = (
        NetBuilder("bad").place(bad, tokens=1).place("B").exponential("t", inputs=bad, outputs="B")
    ).build()
    story = Story(make_plan(net, [bad])).start()
    story.slot(1.0, Failed("a", 0, 1, 1, "aborted", bad))
    page = story_page(told(story, tmp_path), bad, '"><script>')
    assert "<script" not in page and "&lt;script&gt;" in page


def test_the_command_prints_writes_and_keeps_what_is_there(tmp_path: Path, capsys: Any) -> None:
    log, out = meeting().save(tmp_path / "run.jsonl"), tmp_path / "report.html"
    assert main(["report", log, "--most", "1"]) == 0
    said = capsys.readouterr().out
    assert "a           77.0 s  2      b, c" in said
    assert said.count(" waited ") == 1  # the longest
    assert main(["report", log, "-o", str(out)]) == 0
    assert out.read_text().startswith("<!doctype html>")
    assert main(["report", log, "-o", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert main(["report", log, "--json"]) == 0
    story = json.loads(capsys.readouterr().out)
    assert [(w["robot"], w["for"], w["t"], w["slot"]) for w in story["waits"]] == [
        ("b", "a", 1.0, 4),
        ("c", "a", 2.0, 4),
    ]
    assert [m["kind"] for m in story["moments"]] == ["failure"] and not story["left_out"]


def test_a_log_that_does_not_follow_is_refused_with_its_line(tmp_path: Path, capsys: Any) -> None:
    story = meeting()
    del story.lines[3]
    assert main(["report", story.save(tmp_path / "run.jsonl")]) == 2
    assert "run.jsonl:4" in capsys.readouterr().err
