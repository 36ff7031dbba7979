"""Puts a plan into a running team for an operator: has it staged, waits for the votes, and has it
adopted."""

from __future__ import annotations

import time
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple

from gspn_framework_package.execution.log_entries import StagePlan
from gspn_framework_package.model.compact_json import compact

POLL = 0.2
"""Seconds between two questions for the votes."""

VOTING_TIME = 30.0
"""Seconds that the members have to look at a plan, unless it is said otherwise."""

Votes = Mapping[str, Optional[str]]
"""Member -> why it cannot follow the plan; "" if it can, None if it has not said yet."""


class DeployOutcome(NamedTuple):
    """Whether a run follows the plan now, and otherwise why not, in a sentence."""

    done: bool
    message: str
    stage: int = 0
    """Number of the stage, 0 if it did not come to one."""
    votes: Votes = {}


class DeployTeam:
    """See the module.

    :param order: gives the team an order (command, argument); returns whether it was carried out,
        and what the robot says.
    :param statuses: asks the robots of the run for their statuses.
    :param tell: receives the votes whenever they change.
    :param wait: seconds that the members have to look at the plan.
    """

    def __init__(
        self,
        order: Callable[[str, str], Tuple[bool, str]],
        statuses: Callable[[], List[Dict[str, Any]]],
        tell: Callable[[Votes], None] = lambda votes: None,
        wait: float = VOTING_TIME,
    ) -> None:
        self._order, self._statuses, self._tell, self._wait = order, statuses, tell, wait

    def deploy(self, entry: StagePlan, stage_only: bool = False) -> DeployOutcome:
        """Put a plan into the team; a stage that comes to nothing is given up.

        :param entry: the entry that stages it.
        :param stage_only: leave it staged.
        """
        argument = {"plan": entry.plan, "map": dict(entry.mapping), "folder": entry.folder}
        done, message = self._order("stage", compact(argument))
        if not done:
            return DeployOutcome(False, message)
        stage, votes, message = self._wait_for_votes(entry.digest)
        if not message and stage_only:
            text = "every robot can follow the plan; it is staged as number %d" % stage
            return DeployOutcome(True, text, stage, votes)
        if not message:
            done, message = self._order("adopt", str(stage))
            if done:
                return DeployOutcome(True, message, stage, votes)
        if stage:
            self._order("unstage", str(stage))
        return DeployOutcome(False, message, stage, votes)

    def _wait_for_votes(self, digest: str) -> Tuple[int, Votes, str]:
        """Wait until every member has looked at the plan: the number of the stage, the votes, and
        why it cannot be adopted ("" if it can)."""
        deadline = time.monotonic() + self._wait
        stage, votes = 0, {}  # type: int, Votes
        while time.monotonic() < deadline:
            # the robot with the longest log has heard of the most votes
            newest = max(self._statuses(), key=lambda s: int(s["log_length"]), default=None)
            staged = newest.get("staged") if newest else None
            if staged is not None and staged["digest"] == digest:
                if staged["votes"] != votes:
                    self._tell(staged["votes"])
                stage, votes = staged["stage"], staged["votes"]
                refused = [
                    "%s cannot follow it: %s" % (who, why) for who, why in votes.items() if why
                ]
                if refused:
                    return stage, votes, "; ".join(refused)
                if None not in votes.values():
                    return stage, votes, ""
            elif stage:
                return stage, votes, "another plan was staged, or this one was given up"
            time.sleep(POLL)
        missing = [who for who, why in votes.items() if why is None] or ["anybody"]
        return stage, votes, "no word within %g s of: %s" % (self._wait, ", ".join(missing))
