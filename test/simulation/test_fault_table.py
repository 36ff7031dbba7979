"""The table of faults in ``docs/faults.md`` is complete, and what it names is there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import List, Set

from test_schedules import FAILED, FAILED_AS_LARGE

from agreement.mutants import MUTANTS

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "faults.md").read_text("utf-8")
SCHEDULE = re.compile(r"\d+:\d+:(?:full|partial)[\w:-]*")


def _rows() -> List[List[str]]:
    """The cells of the table: what went wrong, what found it, and what fails if it is back."""
    section = PAGE.split("\n## Every fault that was found\n")[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("| ")]
    return [line.strip("| ").split(" | ") for line in lines if "what went wrong" not in line]


def _schedules_that_showed_a_fault() -> Set[str]:
    lines = Path(FAILED).read_text("utf-8").splitlines()
    found: Set[str] = set()
    fault = False
    for line in lines:
        schedule, _, comment = line.partition("#")
        if schedule.strip():
            # "the same" stands for what the line before it says
            fault = fault if comment.strip().startswith("the same") else "no fault" not in comment
            found |= {schedule.strip()} if fault else set()
    return found


def test_each_schedule_that_showed_a_fault_has_a_row_and_no_other() -> None:
    named = [s for _, found_by, _ in _rows() for s in SCHEDULE.findall(found_by)]
    assert len(named) == len(set(named))
    of_large_teams = set(named) & set(FAILED_AS_LARGE)
    assert set(named) - of_large_teams == _schedules_that_showed_a_fault()
    assert of_large_teams == {FAILED_AS_LARGE[0]}  # the other one showed no fault


def test_what_fails_if_a_fault_is_back_is_there() -> None:
    mutants = {m.name for m in MUTANTS}
    files = {path.stem: path.read_text("utf-8") for path in ROOT.glob("test/**/test_*.py")}
    for text, _, fails in _rows():
        names = re.findall(r"`([^`]+)`", fails)
        assert names or fails == "none that is known", text
        for name in names:
            file, dot, test = name.partition(".")
            assert ("def %s(" % test in files.get(file, "")) if dot else name in mutants, name
