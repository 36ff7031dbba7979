"""Handles operators' orders to this robot: checks them, holds them while the robot only listens,
then proposes them.

Owns ``held_orders``. Asks the electorate and the log whether an order makes sense, passes it to the
proposals (a forced eviction to the membership), and answers refused orders at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional

from gspn_framework_package.execution import log_entries, plan_change
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.membership import Membership
from gspn_framework_package.execution.agreement.part import ReplicaPart
from gspn_framework_package.execution.agreement.reactions import Reactions
from gspn_framework_package.execution.event_log import ORDER_GIVEN
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_state import RobotState, StagedPlan
from gspn_framework_package.model.errors import GspnError


@dataclass(eq=False)
class Orders(ReplicaPart):
    """Checks and proposes orders."""

    membership: Membership
    reactions: Reactions

    def order(self, order: interface.Order) -> None:
        """Propose an operator's order if it makes sense."""
        if self.state.now < self.state.listen_until:
            # no member knows us yet, but that changes when we have listened
            self.state.held_orders.append(order)
            return
        entry = order.entry
        if isinstance(entry, log_entries.Evict) and entry.incarnation < 0:
            entry = entry._replace(incarnation=self._incarnation(entry.robot))
        staged = self.state.ledger.state.staged
        if isinstance(entry, (log_entries.Adopt, log_entries.Unstage)) and entry.stage < 0:
            entry = entry._replace(stage=staged.number if staged else 0)
        why = self._why_not(entry)
        submits = isinstance(entry, log_entries.Submit)
        if not why and isinstance(entry, log_entries.Submit):
            entry = self.state.ledger.state.with_again(entry, self.state.ledger.game.net)
            submits = not entry.again
            if submits:
                why = self.reactions.take_task(entry, order.order_id)
        if why:
            self.outbox.order_result(order.order_id, False, why)
        elif not submits:
            self.proposals.propose(entry, order.order_id)

    def keep(self, given: interface.OrderGiven) -> None:
        """Record who gave an order in our log, whether or not it can be carried out."""
        self.outbox.persist({"kind": ORDER_GIVEN, **given._asdict()})

    def take_up_held(self) -> None:
        """Take up the orders that arrived while we only listened."""
        held, self.state.held_orders = self.state.held_orders, []
        for order in held:
            self.order(order)

    def force_evict(self, order: interface.ForceEvict) -> None:
        """Accept an operator's assertion that a robot is off, or that all unheard robots are,
        unless something contradicts it."""
        if not order.robot:
            self._trust(order)
            return
        robot = self._robot(order.robot)
        why = self._why_not_force(order.robot, robot)
        if why or robot is None:
            self.outbox.order_result(order.order_id, False, why)
        else:
            entry = log_entries.Evict(order.robot, robot.incarnation, True, order.by)
            self.membership.evict_by_force(entry, order.order_id)

    def _trust(self, order: interface.ForceEvict) -> None:
        """Continue with what the members that are heard know."""
        if self.electorate.is_alone_with_damage():
            self.membership.trust_own_log()
            self.outbox.order_result(order.order_id, True, "continues with what is left of its log")
            return
        why, off = self._why_not_trust(), self._silent()
        if why or not off:
            text = why or "all members are present; the team continues by itself"
            self.outbox.order_result(order.order_id, not why, text)
            return
        for name in off:
            entry = log_entries.Evict(name, self._incarnation(name), True, order.by)
            self.membership.evict_by_force(entry, order.order_id if name == off[-1] else "")

    def _silent(self) -> List[str]:
        """The other members that are not heard."""
        late = self.electorate.heard_within(2 * self.config.pace.heartbeat)
        return [m for m in self.electorate.members() if m not in late]

    def _why_not_trust(self) -> str:
        """Why the members that are heard cannot continue with what they know; "" if they can."""
        state, here = self.state, self.electorate
        if state.ledger.state.ended is not None:
            return "the run is over: %s" % state.ledger.state.ended
        if here.has_quorum() and not here.torn():
            return "the robots that are heard are a quorum: use evict or force_evict on lost robots"
        off = self._silent()
        if not here.is_member() or (here.has_to_join() and not state.torn):
            return (
                "%s does not know the team's state; give this order to another robot"
                % self.config.name
            )
        empty = [m for m in here.missing_after_outage() if m not in off]
        if empty:
            return (
                "%s run without a log; switch them off, repeat this order, then start them again"
                % (", ".join(empty))
            )
        witnesses = [m for m in off if self._robot(m) is None]
        if witnesses:
            return "witness %s is missing; start it" % ", ".join(witnesses)
        return ""

    def _incarnation(self, name: str) -> int:
        robot = self._robot(name)
        return robot.incarnation if robot is not None else 0

    def _robot(self, name: str) -> Optional[RobotState]:
        return self.state.ledger.state.robots.get(name)

    def _why_not(self, entry: log_entries.Entry) -> str:
        """Why an order is not possible at present; "" if it is."""
        state, me, plan = self.state, self.config.name, self.state.ledger.game.plan
        if state.ledger.state.ended is not None:
            return "the run is over: %s" % state.ledger.state.ended
        if not state.active or not (self.electorate.is_member() or self.config.witness):
            return "%s is not in the team (yet): %s" % (me, self.electorate.waits_to_join())
        if isinstance(entry, log_entries.Leave) and self.electorate.members() == [entry.robot]:
            return "%s is the last robot of the team; stop the run instead" % entry.robot
        name = getattr(entry, "robot", "")
        robot = self._robot(name)
        if name and (robot is None or robot.phase.gone):
            return "there is no robot '%s' in the team" % name
        if isinstance(entry, log_entries.SetPlace) and entry.place not in plan.action_places:
            return "'%s' is not an action place of the plan" % entry.place
        if (
            isinstance(entry, (log_entries.Fire, log_entries.Submit))
            and entry.transition not in plan.net.transition_index
        ):
            return "the net has no transition '%s'" % entry.transition
        if (
            isinstance(entry, log_entries.Retry)
            and robot is not None
            and robot.phase is not Phase.FAILED
        ):
            return "the action of %s did not fail" % name
        if isinstance(entry, log_entries.ABOUT_TASKS):
            return self._why_not_about_task(entry)
        if isinstance(entry, log_entries.Submit):
            return self._why_not_submitted(entry)
        return self._why_not_deployed(entry)

    def _why_not_submitted(self, entry: log_entries.Submit) -> str:
        """Why a task cannot be taken at present; "" if it can."""
        team, game = self.state.ledger.state, self.state.ledger.game
        if self.reactions.has((entry.transition, entry.id)):
            return ""  # which the answer says
        if entry.replaces:
            why = team.why_not_one_task(entry.replaces)
            if why:
                return why
        if not entry.to:
            return ""
        if not any(game.is_for(entry.to, robot.name) for robot in team.active()):
            able = any(entry.to in words for words in game.capabilities.values())
            what = "that can '%s'" if able else "'%s'"
            return "there is no robot %s in the team" % (what % entry.to)
        return game.why_not_to(team.present_name(entry.transition))

    def _why_not_about_task(self, entry: log_entries.TaskOrder) -> str:
        """Why an order about a task is not possible at present; "" if it is."""
        team = self.state.ledger.state
        why = team.why_not_one_task(entry.id)
        if not why and isinstance(entry, log_entries.GiveBack):
            why = self.state.ledger.game.why_not_given_back(team, team.tasks_with(entry.id)[0])
        return why

    def _why_not_deployed(self, entry: log_entries.Entry) -> str:
        """Why an order about another plan is not possible at present; "" if it is."""
        team, present = self.state.ledger.state, self.state.ledger.game.plan
        if isinstance(entry, log_entries.StagePlan):
            try:
                log_entries.checked(entry)
                staged = StagedPlan(0, entry.digest, entry.plan, entry.mapping)
                proposed = plan_change.plan_of(staged)
            except GspnError as error:
                return "the plan cannot be staged: %s" % error
            return "; ".join(plan_change.why_never(present, proposed, entry.mapping))
        if isinstance(entry, log_entries.Unstage) and team.staged is None:
            return "no plan is staged"
        if isinstance(entry, log_entries.Adopt):
            why, new = plan_change.why_not_adopted(team, present, entry.stage)
            return "; ".join(why or plan_change.tasks_in_hand(team, new))
        return ""

    def _why_not_force(self, name: str, robot: Optional[RobotState]) -> str:
        """Why we do not believe that a robot is off; "" if we do."""
        state, me = self.state, self.config.name
        if state.ledger.state.ended is not None:
            return "the run is over: %s" % state.ledger.state.ended
        if name == me:
            return "%s cannot be asked to assert that it is switched off itself" % me
        if robot is None or robot.phase.gone:
            return "there is no robot '%s' in the team" % name
        if self.electorate.has_to_join() and not state.torn:
            return "%s has no vote; give the order to a member of the team" % me
        if state.peers.get(name).heard is not None:
            silence = state.peers.silence(name, state.now)
            if silence < 2 * self.config.pace.heartbeat:
                return "%s was heard %.1f s ago, so it is not off; use evict, or switch it off" % (
                    name,
                    silence,
                )
        return ""
