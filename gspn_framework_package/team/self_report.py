"""What a host reports about its robot to services, people and watchers."""

from __future__ import annotations

import time
from collections import deque
from typing import Any, Callable, Deque, Dict, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution.agreement.interface import OrderGiven
from gspn_framework_package.execution.agreement.replica import Replica
from gspn_framework_package.execution.displayed_data import (
    displayed_robot,
    displayed_tasks,
    displayed_team,
)
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.rules import RUNS_ON
from gspn_framework_package.execution.team_messages import (
    MessageFields,
    marking_fields,
    team_fields,
)
from gspn_framework_package.execution.team_state import reported_phase
from gspn_framework_package.model.net import Marking, Net
from gspn_framework_package.team.carrier import NotTaken
from gspn_framework_package.team.sides import ActionSide
from gspn_framework_package.team.status_reporter import Diagnosis, level_of

MOST_REFUSALS = 20
"""How many kinds of refused messages are reported by name, the most frequent first."""


MOST_ORDERS = 5
"""How many orders are reported, the latest."""


class View(NamedTuple):
    """What a host knows about its robot and the team, including its own local transitions."""

    place: str
    """Name of the robot's place; "" if it has none."""
    robot_state: str
    incarnation: int
    visit: int
    marking: Marking
    net: Net
    slot: int
    hash: str


class SelfReport:
    """Compiles reports from the replica and the action side; belongs to the worker thread.

    :param actions: its action side.
    :param refusals: returns the messages that its carrier refused.
    """

    def __init__(
        self,
        robot: str,
        run: str,
        replica: Replica,
        actions: ActionSide,
        refusals: Callable[[], List[NotTaken]],
    ) -> None:
        self._robot, self._run = robot, run
        self._replica, self._actions = replica, actions
        self._refusals = refusals
        self._refused_before = 0
        self._acts_since: Optional[float] = None
        self._orders: Deque[Dict[str, Any]] = deque(maxlen=MOST_ORDERS)

    @property
    def _net(self) -> Net:
        """The net of the plan that the team follows according to our log."""
        return self._replica.ledger.game.net

    def view(self) -> View:
        """The robot and the team as this host knows them."""
        ledger, own = self._replica.ledger, self._replica.state
        robot = ledger.state.robots.get(self._robot)
        place, visit, phase = "", 0, reported_phase(ledger.state, robot)
        if robot is not None and own.position is not None:
            place, visit = self._net.places[own.position.place].name, own.position.visit
            # there are local transitions that the log does not have yet
            if visit != robot.visit and ledger.state.ended is None:
                phase = Phase.DOING
            if phase is Phase.DOING and own.reported == own.position.goal:
                phase = Phase.DONE  # the log does not have this yet
        elif robot is not None and not robot.phase.gone:
            place, visit = self._net.places[robot.place].name, robot.visit
        return View(
            place,
            phase.report.state,
            self._replica.incarnation,
            visit,
            self._replica.marking(),
            self._net,
            ledger.length,
            ledger.hash,
        )

    def status(self, data: str = "") -> Dict[str, Any]:
        """The result of :meth:`ReplicaHost.status`, except for what only the host knows."""
        status = self._replica.status()
        state = self._replica.ledger.state
        status.update(
            finished=state.finished,
            fault=self._is_faulty(),
            waits_for=self.waits_for(),
            needs_operator=self.needs_operator(),
            refused=self._refused_as_json(),
            orders=list(self._orders),
        )
        if data:
            brief = data == "brief"
            status["data"] = displayed_team(state, self._net, brief)
            for robot in status["robots"]:
                if robot["robot"] in state.robots:
                    robot.update(displayed_robot(state.robots[robot["robot"]], self._net, brief))
        return status

    def tasks(self) -> Dict[str, Any]:
        """The tasks of the team, and how the last ones ended; see
        :func:`~gspn_framework_package.execution.displayed_data.displayed_tasks`."""
        return displayed_tasks(self._replica.ledger.state, self._replica.ledger.game)

    def waits_for(self) -> str:
        """What this robot waits for: its action, the team, or its transition; "" if nothing."""
        replica = self._replica
        if replica.ledger.state.ended is not None:
            return ""
        robot = replica.ledger.state.robots.get(self._robot)
        reasons = [self._actions.doing(), replica.waits_for()]
        if robot is not None:
            why = replica.ledger.game.why_waiting(replica.ledger.state, robot)
            if why == RUNS_ON and self._acts_since is not None:
                why += time.strftime(" since %H:%M:%S", time.localtime(self._acts_since))
            reasons.append(why)
        return "; ".join(filter(None, reasons))

    def needs_operator(self) -> bool:
        """Whether this robot needs the operator to continue: it was evicted, it has halted, its
        action failed, or too many logs of the team are lost."""
        state = self._replica.ledger.state
        robot = state.robots.get(self._robot)
        if self._replica.halted is not None or self._replica.is_stuck():
            return True
        return robot is not None and state.ended is None and robot.phase.report.needs_operator

    def note_start(self) -> None:
        """Note that an action of the robot starts now."""
        self._acts_since = time.time()

    def note_order(self, given: OrderGiven) -> None:
        """Record that an operator gave this robot an order."""
        self._orders.append({**given._asdict(), "wall": round(time.time(), 3)})

    def refused(self) -> List[NotTaken]:
        """The messages that the carrier or the replica refused, the most frequent kinds first."""
        there = [*self._refusals()]
        there += [NotTaken(*kind, times) for kind, times in self._replica.complaints.items()]
        return sorted(there, key=lambda kind: (-kind.times, kind.robot, kind.why))

    def _refused_as_json(self) -> List[Dict[str, Any]]:
        return [kind._asdict() for kind in self.refused()[:MOST_REFUSALS]]

    def _is_faulty(self) -> bool:
        return self._replica.ledger.state.fault or self._replica.halted is not None

    def activity(self, plan: str, attempt: int, progress: Sequence[int]) -> Dict[str, Any]:
        """The robot's activity, a JSON object.

        :param plan: the hash of the plan that the robot follows.
        :param attempt: number of the attempt at its action.
        :param progress: the last feedback of the action.
        """
        view, state = self.view(), self._replica.ledger.state
        robot = state.robots.get(self._robot)
        return {
            "robot": self._robot,
            "run": self._run,
            "plan": plan,
            "place": view.place,
            "place_number": self._net.place_index[view.place] if view.place else -1,
            "state": view.robot_state,
            "visit": view.visit,
            "attempt": attempt,
            "task": robot.task.id if robot is not None and robot.task is not None else "",
            "waits_for": self.waits_for(),
            "needs_operator": self.needs_operator(),
            "feedback": progress,
            "ended": state.ended,
            "finished": state.finished,
            "fault": self._is_faulty(),
            "refused": self._refused_as_json(),
            "orders": list(self._orders),
        }

    def team(self) -> Tuple[MessageFields, MessageFields]:
        """The marking and the state of the team, according to the log (see
        :meth:`Carrier.publish_team`)."""
        ledger = self._replica.ledger
        about = (ledger.game, ledger.state, self._run, ledger.game.plan.hash())
        return marking_fields(*about), team_fields(*about)

    def diagnosis(self) -> Diagnosis:
        """The diagnosis of the robot."""
        view, waits_for = self.view(), self.waits_for()
        message = "%s in %s" % (view.robot_state, view.place or "no place")
        if waits_for:
            message += ", " + waits_for
        status = self._replica.status()
        if status["ended"] is not None:
            message += ", the run is over: " + status["ended"]
        refused = self.refused()
        count = sum(kind.times for kind in refused)
        news, self._refused_before = count > self._refused_before, count
        if news:
            senders = sorted({kind.robot or "somebody" for kind in refused})
            message += "; refuses messages of %s" % ", ".join(senders[:3])
        lost = sorted(
            robot.name
            for robot in self._replica.ledger.state.robots.values()
            if robot.phase is Phase.LOST and robot.name != self._robot
        )
        if lost:
            message += "; lost: " + ", ".join(lost)
        values = {
            "robot": self._robot,
            "run": self._run,
            "place": view.place,
            "state": view.robot_state,
            "visit": view.visit,
            "log length": view.slot,
            "waits for": waits_for,
            "quorum": status["quorum"],
            "lost robots": ", ".join(lost),
            "refused messages": count,
        }
        for kind in refused[:MOST_REFUSALS]:
            values["refused from %s: %s" % (kind.robot or "somebody", kind.why)] = kind.times
        for robot in status["robots"]:
            if robot["robot"] != self._robot:
                values["last contact with " + robot["robot"]] = robot["last_contact"]
        return level_of(self.needs_operator(), bool(waits_for or lost or news)), message, values
