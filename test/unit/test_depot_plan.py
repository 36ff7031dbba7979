"""The depot is what its map gives, does not jam, and would without its groups (plans/depot)."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.depot import ROBOTS, in_the_room, in_virtual_time, without_measures
from gspn_framework_package.analysis.proofs.ladder import PROVEN, VIOLATED, decide_question
from gspn_framework_package.analysis.proofs.questions import DEAD, NEVER, MarkingQuestion
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.making.site_plan import SitePlan, build_site_plan
from gspn_framework_package.making.site_traffic import waiting_circles

FOLDER = Path(__file__).resolve().parents[2] / "plans" / "depot"
PLAN = read_plan(str(FOLDER))
AISLES = [("a1", "a2", "a3"), ("b1", "b2", "b3"), ("c1", "c2", "c3")]


@pytest.fixture(scope="module")
def made() -> SitePlan:
    """The plan of the map with the groups that ``--deadlock-free`` adds."""
    files = str(FOLDER / "map.yaml"), str(FOLDER / "tasks.yaml")
    plain = build_site_plan(*files, ROBOTS)
    circles = waiting_circles(plain.limits.values(), plain.moves)
    assert [circle.nodes for circle in circles] == AISLES
    groups = {"lane_%d" % (k + 1): circle.group(1) for k, circle in enumerate(circles)}
    return build_site_plan(*files, ROBOTS, groups=groups)


def test_its_files_are_those_that_the_map_gives(made: SitePlan, tmp_path: Path) -> None:
    for name in made.write(str(tmp_path / "made")):
        assert (tmp_path / "made" / name).read_bytes() == (FOLDER / name).read_bytes(), name


@pytest.mark.parametrize("aisle", AISLES)
def test_two_robots_are_never_in_one_aisle(made: SitePlan, aisle: tuple) -> None:
    places = ["'%s'" % place for node in aisle for place in made.rests[node]]
    two = MarkingQuestion(NEVER, " + ".join(places) + " >= 2", losses=True)
    assert decide_question(PLAN, two, seconds=60.0).verdict == PROVEN


def test_without_the_groups_robots_get_stuck() -> None:
    found = decide_question(without_measures(), MarkingQuestion(DEAD), seconds=60.0)
    assert found.verdict == VIOLATED and found.sequence
    assert found.marking is not None
    inside = [p for p, n in found.marking.items() if n and p[:4] in ("At_a", "At_b", "At_c")]
    assert len(inside) >= 2


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_half_an_hour_in_virtual_time_jams_without_the_groups_only(seed: int) -> None:
    free = in_virtual_time(PLAN, 30.0, seed)
    assert free["jammed"] == 0 and free["tasks"] > 80
    assert in_virtual_time(without_measures(), 30.0, seed)["jammed"] >= 2


def test_robots_that_drive_go_through_the_gate() -> None:
    run = in_the_room(PLAN.for_robots(2), 1.0, 0)
    assert run["contacts"] == run["failed_actions"] == run["goals_given_up"] == 0
    assert run["tasks"] >= 1, "the first one is in the aisle behind the gate"
