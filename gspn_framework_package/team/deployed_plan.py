"""The plan that a team has adopted, as reported by one of its robots."""

from __future__ import annotations

from typing import Mapping, NamedTuple, Optional

from gspn_framework_package.execution.plan_change import plan_of
from gspn_framework_package.execution.team_state import StagedPlan
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.message_filter import json_object


class DeployedPlan(NamedTuple):
    """A plan that the team of ``run`` adopted, with the ``number`` of its stage and a map of names
    in the previous plan -> names in this one."""

    run: str
    number: int
    plan: Plan
    mapping: Mapping[str, str]


def read_deployed(run: str, message: str) -> Optional[DeployedPlan]:
    """Parse a node's answer to the command ``plan``; None if the text is not such an answer."""
    try:
        staged = StagedPlan.from_json(json_object(message) or {})
        return DeployedPlan(run, staged.number, plan_of(staged), staged.mapping)
    except (KeyError, TypeError, ValueError, AttributeError, GspnError):
        return None
