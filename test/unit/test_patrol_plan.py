"""The rule of the patrol: never two robots in one location (plans/patrol/README.md)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Dict, List, Set, Tuple

import pytest

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.net import Marking
from gspn_framework_package.model.plan import Plan

PLAN = Path(__file__).resolve().parents[2] / "plans" / "patrol"


def reachable(plan: Plan) -> Set[Marking]:
    """The markings that a run can reach: any transition that is enabled may fire, a policy's choice
    only where it gives that transition a chance."""
    net = plan.net
    table = plan.policy.bind(net)
    seen = {net.initial_marking}
    front = [net.initial_marking]
    while front:
        marking = front.pop()
        for t in net.enabled(marking, by_priority=False):
            if not net.transitions[t].timed:
                choice = table.distribution(marking, net.inputs[t][0][0])
                if choice is None or t not in dict(choice.choices):
                    continue
            after = net.fire(marking, t)
            if after not in seen:
                seen.add(after)
                front.append(after)
    return seen


def locations(plan: Plan) -> Dict[str, List[int]]:
    """Location -> its places Check, Alarm and Decide."""
    found: Dict[str, List[int]] = {}
    for p, place in enumerate(plan.net.places):
        kind, location = re.fullmatch(r"p\d+:(\w+)_(L\d)", place.name).groups()  # type: ignore[union-attr]
        if kind != "Wait":
            found.setdefault(location, []).append(p)
    return found


def test_the_net_has_the_names_of_the_thesis() -> None:
    net = read_plan(str(PLAN)).net
    assert (len(net.places), len(net.transitions)) == (16, 24)
    assert "t24:Go_Check_L1" in net.transition_index and "p16:Wait_L4" in net.place_index
    immediate = [t.name for t in net.transitions if not t.timed]
    assert [name.split(":")[1][:8] for name in immediate] == ["Go_Wait_", "Go_Check"] * 4


@pytest.mark.long
@pytest.mark.parametrize("robots", [1, 2, 3, 4, 5])
def test_never_two_robots_in_one_location(robots: int) -> None:
    plan = read_plan(str(PLAN)).for_robots(robots)
    markings = reachable(plan)
    assert len(markings) > 10
    for marking in markings:
        for location, places in locations(plan).items():
            # one that decides may still be in the location, or in the bay: see the next test
            inside = [p for p in places if "Decide" not in plan.net.places[p].name]
            assert sum(marking[p] for p in inside) <= 1, (location, plan.net.named(marking))


@pytest.mark.parametrize("robots", [1, 2, 3, 4])
def test_the_policy_decides_in_every_marking_and_never_into_an_occupied_location(
    robots: int,
) -> None:
    plan = read_plan(str(PLAN)).for_robots(robots)
    net, table = plan.net, plan.policy.bind(plan.net)
    asked: Set[Tuple[int, str]] = set()
    for marking in reachable(plan):
        for p, place in enumerate(net.places):
            if "Decide" in place.name and marking[p]:
                choice = table.distribution(marking, p)
                assert choice is not None and len(choice.choices) == 1
                name = net.transitions[choice.choices[0][0]].name
                asked.add((p, name))
                if "Go_Check" in name:
                    assert not any(marking[q] for q in locations(plan)[name[-2:]])
    assert len(asked) == (8 if robots > 1 else 4)


def test_a_robot_leaves_the_bay_when_the_next_location_is_free_whoever_is_in_its_own() -> None:
    net = read_plan(str(PLAN)).net

    def waiting_is_done(*places: str) -> bool:
        marking = [sum(place.name == name for name in places) for place in net.places]
        return net.transition_index["t5:Wait_Done_L1"] in net.enabled(
            tuple(marking), by_priority=False
        )

    assert waiting_is_done("p4:Wait_L1")
    assert waiting_is_done("p4:Wait_L1", "p1:Check_Temperature_L1", "p9:Check_Temperature_L3")
    for place in ("p5:Check_Temperature_L2", "p6:Alarm_L2", "p7:Decide_L2"):
        assert not waiting_is_done("p4:Wait_L1", place)
