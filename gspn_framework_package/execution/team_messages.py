"""What a team does, as the JSON objects that watchers read: a firing, the activity of a robot, a
marking, the state of the team. Live robots publish them, and ``gspn export`` reconstructs them from
a log. The messages in ``msg/`` have the same fields, and a header.
"""

from __future__ import annotations

import json
from typing import Any, Dict, List, Mapping, Tuple

from gspn_framework_package.execution.agreement.interface import Fired
from gspn_framework_package.execution.firing import TaskEnded
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_state import RobotState, TeamState, reported_phase
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.net import Marking, Net

MessageFields = Dict[str, Any]
"""Name -> value of the fields."""

_NUMBERED = (
    Phase.UNHEARD,
    Phase.DOING,
    Phase.DONE,
    Phase.WAITING,
    Phase.PAUSED,
    Phase.FAILED,
    Phase.INACTIVE,
    Phase.LOST,
    Phase.LEFT,
)

ROBOT_STATES = tuple(phase.report.state for phase in _NUMBERED)
"""The states of an activity, at the numbers that stand for them; "": unknown."""


_SAME = (
    "run",
    "plan",
    "robot",
    "place",
    "place_number",
    "visit",
    "attempt",
    "task",
    "waits_for",
    "needs_operator",
    "feedback",
)
"""The fields that a robot's own report has under the same name."""


def firing_fields(fired: Fired, run: str) -> Dict[str, Any]:
    """A firing as a JSON object."""
    firing = fired.firing
    moved = [move for move in firing.moves if move.target is not None]
    places, counts = marking_lists(firing.marking, fired.plan.net)
    details: Dict[str, Any] = {}
    if firing.cause:
        details["cause"] = dict(firing.cause)
    if firing.tasks:
        details["tasks"] = [list(move) for move in firing.tasks]
    return {
        "plan": fired.plan.hash(),
        "run": run,
        "transition": firing.transition,
        "robot": firing.robot,
        "incarnation": firing.incarnation,
        "visit": firing.visit,
        "robots": [move.robot for move in moved],
        "robot_places": [str(move.target) for move in moved],
        "places": places,
        "counts": counts,
        "slot": firing.slot,
        "index": firing.index,
        "private_move": fired.private,
        "hash": fired.hash,
        "details": json.dumps(details) if details else "",
    }


def task_fields(ended: TaskEnded, run: str, now: float) -> Dict[str, Any]:
    """A task that ended, as a JSON object; ``seconds`` (None if not known) is how long the team had
    it.

    :param now: the time of day (seconds since 1970).
    """
    return {
        "run": run,
        "id": ended.id,
        "outcome": ended.outcome,
        "why": ended.why,
        "robot": ended.robot,
        "attempts": ended.attempts,
        "seconds": ended.seconds(now),
        "data": dict(ended.data),
    }


def marking_lists(marking: Marking, net: Net) -> Tuple[List[str], List[int]]:
    """A marking as two lists, place names and counts, with every place of the net."""
    return [place.name for place in net.places], list(marking)


def robot_fields(
    game: TokenGame, state: TeamState, robot: RobotState, run: str, plan: str
) -> MessageFields:
    """The activity of a robot, according to a log.

    :param game: the rules that the team follows now.
    :param robot: the robot, one of the state.
    :param plan: the hash of the plan that the team follows.
    """
    phase = reported_phase(state, robot)
    gone = robot.phase.gone
    return {
        "run": run,
        "plan": plan,
        "robot": robot.name,
        "place": "" if gone else game.net.places[robot.place].name,
        "place_number": -1 if gone else robot.place,
        "state": ROBOT_STATES.index(phase.report.state),
        "state_name": phase.report.state,
        "visit": robot.visit,
        "attempt": robot.attempt,
        "task": robot.task.id if robot.task is not None else "",
        "waits_for": game.why_waiting(state, robot) if state.ended is None else "",
        "needs_operator": phase.report.needs_operator and state.ended is None,
        "feedback": [],
    }


def activity_fields(activity: Mapping[str, Any]) -> MessageFields:
    """The activity of a robot, according to its own report ``activity``."""
    fields = {name: activity[name] for name in _SAME}
    state = activity["state"]
    return {**fields, "state": ROBOT_STATES.index(state), "state_name": state}


def marking_fields(game: TokenGame, state: TeamState, run: str, plan: str) -> MessageFields:
    """The fields of ``Marking``. The parameters are those of :func:`robot_fields`."""
    places, counts = marking_lists(state.marking, game.net)
    return {"run": run, "plan": plan, "slot": state.next_slot, "places": places, "counts": counts}


def team_fields(game: TokenGame, state: TeamState, run: str, plan: str) -> MessageFields:
    """The fields of ``TeamState``, whose ``robots`` are :func:`robot_fields`. The parameters are
    those of that function."""
    waiting: List[str] = [task.id for _, queue in sorted(state.queues.items()) for task in queue]
    return {
        "run": run,
        "plan": plan,
        "slot": state.next_slot,
        "paused": state.paused,
        "ended": state.ended is not None,
        "ended_why": state.ended or "",
        "finished": state.finished,
        "fault": state.fault,
        "waiting_tasks": waiting,
        "robots": [
            robot_fields(game, state, state.robots[name], run, plan)
            for name in sorted(state.robots)
        ],
    }
