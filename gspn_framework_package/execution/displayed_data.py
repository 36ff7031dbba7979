"""Formats a team's data, tasks and held events for display: complete for programs, shortened for
people."""

from __future__ import annotations

import itertools
import json
from typing import Any, Dict, List, Mapping, Optional, Sequence

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.rules import Rules
from gspn_framework_package.execution.team_state import RobotState, TeamState
from gspn_framework_package.execution.team_tasks import Task
from gspn_framework_package.model.net import Net

SHOWN_LENGTH = 200
"""Maximum length of a value's text shown to people."""

SHOWN_NAMES = 50
"""Maximum number of names of a robot, task or team shown to people."""

SHOWN_TASKS = 20
"""Maximum number of tasks of a queue shown to people, the next ones first."""


def shown(value: Any) -> str:
    """A JSON value as a short text: strings without quotation marks."""
    if not isinstance(value, str):
        value = json.dumps(value, ensure_ascii=False)
    return value if len(value) <= SHOWN_LENGTH else value[: SHOWN_LENGTH - 1] + "…"


def shown_values(values: Mapping[str, Any]) -> Dict[str, str]:
    """Data as short texts; omitted values are counted under the name "…"."""
    texts = {name: shown(values[name]) for name in itertools.islice(values, SHOWN_NAMES)}
    if len(values) > SHOWN_NAMES:
        texts["…"] = "%d more" % (len(values) - SHOWN_NAMES)
    return texts


def order_text(given: Mapping[str, Any]) -> str:
    """Who gave which order, as a short text.

    :param given: the fields of an ``order`` record of an event log.
    """
    who, proof = given["operator"] or "somebody", given["proof"]
    order = " ".join(filter(None, (given["command"], given["robot"], given["argument"])))
    return "%s (%s) orders: %s" % (shown(who), proof or "not authenticated", shown(order))


def decided_order_text(entry: log_entries.Entry, asked: str) -> str:
    """Who gave an order that is in the agreed log, as a short text; "" if the log does not say.

    :param asked: the robot that was asked.
    """
    by = getattr(entry, "by", log_entries.NOBODY)
    if by == log_entries.NOBODY:
        return ""
    fields = log_entries.to_json(entry)
    argument = next((fields[n] for n in ("place", "transition", "id") if n in fields), "")
    given = {"command": fields["entry"], "robot": fields.get("robot", ""), "argument": argument}
    text = order_text({**given, "operator": by.name, "proof": by.proof})
    return "%s, asking %s" % (text, shown(asked))


def cause_text(cause: Mapping[str, Any]) -> str:
    """The cause of an event as a short text."""
    return shown(", ".join("%s: %s" % item for item in shown_values(cause).items()))


def displayed_team(state: TeamState, net: Net, brief: bool = False) -> Dict[str, Any]:
    """The data of the team, the tasks in its queues, and the tasks waiting outside the net.

    :param brief: whether to shorten it for people.
    :returns: ``team``: name -> value; ``queues``: place -> list of [id, data]; ``waiting``: list of
        [transition, id].
    """
    outside = state.submitted[:SHOWN_TASKS] if brief else state.submitted
    return {
        "team": shown_values(state.data) if brief else dict(state.data),
        "queues": {net.places[p].name: displayed_queue(q, brief) for p, q in state.queues.items()},
        "waiting": [[net.transitions[t].name, task.id] for t, task in outside],
    }


def displayed_queue(tasks: Sequence[Task], brief: bool = False) -> List[List[Any]]:
    """The tasks of a queue, the next one first."""
    if not brief:
        return [task.to_json() for task in tasks]
    return [[task.id, shown_values(task.data)] for task in tasks[:SHOWN_TASKS]]


def displayed_tasks(state: TeamState, rules: Rules) -> Dict[str, Any]:
    """The tasks of a team that are not done, and the last ones that ended.

    :returns: ``tasks``: for each its ``id``, ``where`` it is (in words), the ``transition``,
        ``place`` or ``robot`` there (the others are ""), ``to`` (the only robot that may take it,
        or a capability that such a robot has; "" for any), ``trouble`` ("" if somebody works on it
        or will), ``priority``, ``attempts`` (how often a robot took it) and ``since`` (seconds
        since 1970; None if not known) and ``until`` (when it is late if it still waits; None for
        never), ``at`` (when it comes in; None if it has) and ``every`` (seconds after which another
        one comes in; None if none does).
        ``ended``: for each its ``id``, ``outcome`` and ``why``, the last one last.
    """
    tasks, net = [], rules.net
    present = [robot.name for robot in state.active()]
    for found in state.tasks():
        task = found.task
        waits_for = "" if any(rules.is_for(task.to, name) for name in present) else task.to
        robot = state.robots.get(found.robot)
        place = found.place if robot is None else robot.place
        tasks.append(
            {
                "id": task.id,
                "where": found.where(net),
                "transition": "" if found.before is None else net.transitions[found.before].name,
                "place": "" if place is None else net.places[place].name,
                "robot": found.robot,
                "to": task.to,
                "trouble": _trouble(robot, waits_for),
                "priority": task.priority,
                "attempts": task.attempts,
                "since": task.since or None,
                "until": task.until or None,
                "at": task.at or None,
                "every": task.every or None,
            }
        )
    return {"tasks": tasks, "ended": [ended._asdict() for ended in state.ended_tasks]}


def _trouble(robot: Optional[RobotState], waits_for: str) -> str:
    """Why no robot works on a task, or will; "" if one does.

    :param robot: the robot that has it; None if it waits.
    :param waits_for: the only robots that may take it, if none of them is there; otherwise "".
    """
    if robot is None and waits_for:
        return "only %s may take it, which is gone: cancel it, or submit another" % waits_for
    if robot is None:
        return ""
    if robot.phase.gone:
        return "%s is %s: submit the task again, or cancel it" % (
            robot.name,
            "lost" if robot.phase is Phase.LOST else "no longer in the team",
        )
    if robot.phase is Phase.FAILED:
        return "its action failed (%s)" % robot.why
    return ""


def displayed_robot(robot: RobotState, net: Net, brief: bool = False) -> Dict[str, Any]:
    """The data of a robot, the task that it carries, and the events that it holds.

    :returns: ``data``: name -> value; ``task``: [id, data] or None; ``held``: transition -> cause;
        ``resumed_from``: the visit that the present one continues; 0 for none.
    """
    task = robot.task
    return {
        "data": shown_values(robot.data) if brief else dict(robot.data),
        "task": displayed_queue([task], brief)[0] if task is not None else None,
        "held": {
            net.transitions[t].name: cause_text(cause) if brief else dict(cause)
            for t, cause in robot.held.items()
        },
        "resumed_from": robot.resumed_from,
    }
