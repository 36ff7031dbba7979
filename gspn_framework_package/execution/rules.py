"""The rules of a plan, prepared for the token game, and queries on them."""

from __future__ import annotations

import itertools
from typing import List, Mapping

from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_state import RobotState, TeamState
from gspn_framework_package.execution.team_tasks import FoundTask
from gspn_framework_package.model.event import BY_PRIORITY
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import POLICY, unnamed

RUNS_ON = "paused, but its action continues"
"""Why a robot does not move whose action continues in a pause."""


class Rules:
    """The rules of one plan.

    :param plan: a validated plan.
    :param agents: whether this is standalone execution, where transitions may create and destroy
        agents (thesis 4.1.2).
    """

    def __init__(self, plan: Plan, *, agents: bool = False) -> None:
        self.plan = plan
        self.net = net = plan.net
        self.agents = agents
        self.policy = plan.policy.bind(net)
        self.until = plan.ending
        self.acts, self.flows = plan.acts, plan.flows
        alone = [
            t for t, (taken, put) in enumerate(plan.flows) if not taken and (agents or not put)
        ]
        self.spontaneous = [t for t in alone if not net.transitions[t].timed]
        self.environment_transitions = tuple(t for t in alone if net.transitions[t].timed)
        self.immediate = net.immediate_from
        self.queues = frozenset(net.place_number(p) for p in plan.tasks.queues)
        self.capabilities = {r.name: r.capabilities for r in plan.robots if r.capabilities}
        self.queue_orders = {
            net.place_number(p): plan.tasks.order.get(p, BY_PRIORITY) for p in plan.tasks.queues
        }
        """Queue -> the order in which its tasks are taken."""
        self.task_done = frozenset(net.transition_number(t) for t in plan.tasks.done)
        self.on_cancel = {
            net.place_number(p): None if t is None else net.transition_number(t)
            for p, t in plan.tasks.on_cancel.items()
        }
        self.interrupts = {net.transition_number(t): event for t, event in plan.events.items()}
        self.clock = tuple(net.transition_number(t) for t in plan.clock)
        self.unnamed = [unnamed(plan, p) for p in range(len(net.places))]
        """For each place, what a robot requests whose action has named no transition."""
        self.submissions = frozenset(net.transition_number(t) for t in plan.submissions)
        self.takes = {
            t: [(p, weight) for p, weight in net.inputs[t] if p in self.queues]
            for t in range(len(net.transitions))
            if self.flows[t].taken and any(p in self.queues for p, _ in net.inputs[t])
        }
        """The transitions by which robots take tasks -> the queues, and how many of each."""
        self.urgency = [-1 if t.timed else t.priority for t in net.transitions]
        self.top_urgency = max(self.urgency, default=0)

    # -- queries ---------------------------------------------------------------------------------

    def may_fire(self, state: TeamState, t: int) -> bool:
        """Whether ``t`` can fire now: it is enabled in the marking, and enough robots are done and
        free for it."""
        if not self.net.is_enabled(state.marking, t):
            return False
        for p, weight in self.net.inputs[t]:
            if self.acts[p] and not self._has_free(state, p, t, weight):
                return False
        return True

    def may_take(self, state: TeamState, robot: RobotState, t: int) -> bool:
        """Whether the tasks that ``t`` takes are there for ``robot``: those for any robot, and if
        it moves alone, its own."""
        if t not in self.takes:
            return True
        alone = robot.name if self.flows[t].taken == 1 else ""
        for p, weight in self.takes[t]:
            mine = (task for task in state.queues.get(p, ()) if self.is_for(task.to, alone))
            if sum(1 for _ in itertools.islice(mine, weight)) < weight:
                return False
        return True

    def is_for(self, to: str, robot: str) -> bool:
        """Whether a task is for a robot.

        :param to: the only robot that may take it, or a capability that such a robot has; "" for
            any.
        :param robot: the name of a robot; "" for several together.
        """
        return to in ("", robot) or to in self.capabilities.get(robot, ())

    def why_not_to(self, transition: str) -> str:
        """Why no robot can be named for the tasks that come in by a transition; "" if one can."""
        shared = [t for t in self.takes if self.flows[t].taken > 1]
        if shared:
            return "'%s' takes tasks with several robots" % self.net.transitions[shared[0]].name
        into = self.net.outputs[self.net.transition_number(transition)]
        if not any(p in self.queues for p, _ in into):
            return "'%s' leads to no queue" % transition
        return ""

    def gives_back(self, place: int) -> Mapping[str, int]:
        """The resources that a robot returns when it departs from a place: resource place ->
        tokens."""
        return self.plan.on_evict.get(self.net.places[place].name, {})

    def queue_from(self, place: int) -> str:
        """The queue to which a robot that departs from a place returns its task; "" if none."""
        return next((p for p in self.gives_back(place) if p in self.plan.tasks.queues), "")

    def why_not_given_back(self, state: TeamState, found: FoundTask) -> str:
        """Why a task cannot be given back to its queue; "" if it can."""
        robot = state.robots.get(found.robot)
        if robot is None:
            return "no robot has it; it is " + found.where(self.net)
        if robot.phase.gone:
            return "%s is gone: submit the task again" % robot.name
        if not self.queue_from(robot.place):
            return "%s returns it to no queue (on_evict)" % self.net.places[robot.place].name
        return ""

    def may_interrupt(self, state: TeamState, robot: RobotState, t: int) -> bool:
        """Whether ``t``, the transition of an event, can fire now and take ``robot`` along,
        whatever the robot is doing in its place."""
        if state.paused or robot.paused or not self.net.is_enabled(state.marking, t):
            return False
        return self.may_take(state, robot, t)

    def free_robots(self, state: TeamState, p: int, t: int) -> List[RobotState]:
        """The robots that are done in place ``p`` and free for ``t``, in order of completion.

        A robot that named a transition is free for that transition only, so a partner cannot
        override the result of its action. A robot that lets the policy decide is free for every
        immediate transition.
        """
        robots = [state.robots[name] for name in state.done_in.get(p, ())]
        return [r for r in robots if self._is_free(state, r, t)]

    def _is_free(self, state: TeamState, robot: RobotState, t: int) -> bool:
        if robot.paused or not self.may_take(state, robot, t):
            return False
        return robot.request == t or (robot.request == POLICY and not self.net.transitions[t].timed)

    def _has_free(self, state: TeamState, p: int, t: int, weight: int) -> bool:
        for name in state.done_in.get(p, ()):
            if self._is_free(state, state.robots[name], t):
                weight -= 1
                if weight == 0:
                    return True
        return False

    def why_waiting(self, state: TeamState, robot: RobotState) -> str:
        """Why a robot that is done or has failed does not move, and what its action does in a
        pause, for people; "" if it is not waiting."""
        if robot.phase is Phase.FAILED:
            return "its action failed (%s); waits for the operator" % robot.why
        if robot.phase is Phase.DOING and state.is_stopped(robot):
            return "paused: its action is stopped, and starts again on resume"
        if robot.phase is Phase.DOING and (state.paused or robot.paused):
            return RUNS_ON
        if robot.phase is not Phase.DONE:
            return ""
        if state.paused or robot.paused:
            return "paused"
        t = robot.wanted
        if t is None:
            return robot.why or "no transition is enabled"
        missing = self.net.why_disabled(state.marking, t)
        if not missing and not self.may_take(state, robot, t):
            return "wants %s: the tasks there are for others" % self.net.transitions[t].name
        for p, weight in self.net.inputs[t]:
            if self.acts[p]:
                lacking = weight - len(self.free_robots(state, p, t))
                if lacking > 0:
                    missing.append(
                        "needs %s in %s"
                        % (
                            "a robot" if lacking == 1 else "%d robots" % lacking,
                            self.net.places[p].name,
                        )
                    )
        return "wants %s: %s" % (
            self.net.transitions[t].name,
            "; ".join(missing) or "about to fire",
        )
