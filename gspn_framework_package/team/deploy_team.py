"""Deploys a plan to a running team for an operator: stages it, waits for the votes, and orders the
team to adopt it."""

from __future__ import annotations

import time
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple

from gspn_framework_package.execution.log_entries import StagePlan
from gspn_framework_package.team.orders import ORDERS

POLL = 0.2
"""Seconds between two queries of the votes."""

VOTING_TIME = 30.0
"""Seconds that the members have by default to check a plan."""

ADOPTED = "the run follows the plan"
"""The answer where a robot adopted the plan but did not report it in time."""

Votes = Mapping[str, Optional[str]]
"""Member -> why it cannot follow the plan; "" if it can, None if it has not voted yet."""


class DeployOutcome(NamedTuple):
    """Whether a run follows the plan now, and if not, why, in a sentence."""

    done: bool
    message: str
    stage: int = 0
    """Number of the stage; 0 if the plan was not staged."""
    votes: Votes = {}


def deploy_to_team(
    order: Callable[[str, str], Tuple[bool, str]],
    statuses: Callable[[], List[Dict[str, Any]]],
    entry: StagePlan,
    *,
    stage_only: bool = False,
    tell: Callable[[Votes], None] = lambda votes: None,
    wait: float = VOTING_TIME,
) -> DeployOutcome:
    """Deploy a plan to a team; unstage it if it cannot be adopted.

    :param order: gives the team an order (command, argument); returns whether it was carried out,
        and the robot's answer.
    :param statuses: queries the statuses of the run's robots.
    :param entry: the log entry that stages the plan.
    :param stage_only: leave the plan staged, without adopting it.
    :param tell: receives the votes whenever they change.
    :param wait: seconds that the members have to check the plan.
    """
    staged = {"plan": entry.plan, "map": dict(entry.mapping), "folder": entry.folder}
    done, message = order("stage", ORDERS["stage"].argument(staged))
    if not done:
        return DeployOutcome(False, message)
    stage, votes, message = _wait_for_votes(statuses, entry.digest, tell, wait)
    if not message and stage_only:
        text = "every robot can follow the plan; the plan is staged as number %d" % stage
        return DeployOutcome(True, text, stage, votes)
    if not message:
        done, message = order("adopt", str(stage))
        # a robot that answers too late, or whose successor is asked then, may have had it adopted
        if done or _newest(statuses()).get("adopted") == stage:
            return DeployOutcome(True, message if done else ADOPTED, stage, votes)
    if stage:
        order("unstage", str(stage))
    return DeployOutcome(False, message, stage, votes)


def _newest(statuses: List[Dict[str, Any]]) -> Dict[str, Any]:
    """The status of the robot that knows most; empty if none answers."""
    return max(statuses, key=lambda status: int(status["log_length"]), default={})


def _wait_for_votes(
    statuses: Callable[[], List[Dict[str, Any]]],
    digest: str,
    tell: Callable[[Votes], None],
    wait: float,
) -> Tuple[int, Votes, str]:
    """Wait until every member has voted on the plan. Returns the number of the stage, the votes,
    and why the plan cannot be adopted ("" if it can)."""
    deadline = time.monotonic() + wait
    stage, votes = 0, {}  # type: int, Votes
    while time.monotonic() < deadline:
        # the robot with the longest log knows the most votes
        staged = _newest(statuses()).get("staged")
        if staged is not None and staged["digest"] == digest:
            if staged["votes"] != votes:
                tell(staged["votes"])
            stage, votes = staged["stage"], staged["votes"]
            refused = [
                "%s cannot follow the plan: %s" % (who, why) for who, why in votes.items() if why
            ]
            if refused:
                return stage, votes, "; ".join(refused)
            if None not in votes.values():
                return stage, votes, ""
        elif stage:
            return stage, votes, "another plan was staged, or this one was unstaged"
        time.sleep(POLL)
    missing = [who for who, why in votes.items() if why is None] or ["anybody"]
    return stage, votes, "no vote within %g s from: %s" % (wait, ", ".join(missing))
