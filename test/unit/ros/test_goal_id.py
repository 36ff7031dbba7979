"""Goal ids say who asks."""

import pytest

pytest.importorskip("rospy")

from gspn_framework_package.ros.goal_id import GoalIdentity, new_tag, parse_goal_id


@pytest.mark.parametrize("robot", ["robot_1", "carol-the-3rd", "r-1-2-3-4", "ä b"])
def test_what_was_written_is_read(robot):
    identity = GoalIdentity(robot, 2, 17, 1, new_tag())
    assert parse_goal_id(str(identity)) == identity


@pytest.mark.parametrize(
    "text", ["", "/move_base_client-1-1234.567", "a-1-2", "robot-x-1-1-tag", "robot-1--1-tag"]
)
def test_the_ids_of_others_are_nobodys(text):
    assert parse_goal_id(text) is None


def test_goals_of_a_robot_sort_by_age():
    ages = [
        GoalIdentity("r", *which, "t").age for which in ((0, 1, 1), (0, 1, 2), (0, 2, 1), (1, 2, 1))
    ]
    assert ages == sorted(ages)


def test_no_two_starts_share_a_tag():
    assert len({new_tag() for _ in range(100)}) == 100
