"""What happens at this robot: actions that end, and orders of the operator."""

from __future__ import annotations

from typing import Any

from gspn_framework_package.execution import entries as log
from gspn_framework_package.execution.agreement import interface as io
from gspn_framework_package.execution.agreement.meeting import Meeting
from gspn_framework_package.execution.agreement.own_robot import Goal
from gspn_framework_package.execution.agreement.pool import Own
from gspn_framework_package.execution.agreement.quorum import is_quorum
from gspn_framework_package.execution.firing import (
    Firing,
    firing_to_json,
)
from gspn_framework_package.execution.ledger import Item
from gspn_framework_package.execution.team_state import GONE


class Conduct(Meeting):
    """Turns what happens here into facts for the log, or into private moves."""

    def _action_ended(self, given: Any) -> None:
        goal = Goal(given.incarnation, given.visit, given.attempt)
        if self.fenced or not self.own.report(goal):
            return
        entry: log.Entry
        if isinstance(given, io.ActionFailed):
            entry = log.Failed(self.name, *goal, given.reason, given.detail)
        else:
            result = given.result if given.result not in (None, "None") else ""
            entry = log.Done(self.name, goal.incarnation, goal.visit, result)
            if self._may_move_alone():
                firing = self.own.move(entry, self.ledger)
                if firing is not None:
                    self._move_alone(entry, firing)
                    return
        self._invoke(entry)

    def _may_move_alone(self) -> bool:
        state = self._own_state()
        return (
            self.partial
            and self.is_settled()
            and state is not None
            and not state.paused
            and not self.ledger.state.paused
            and not self.consensus.is_frozen()
            and all(o.item.private or o.suspect for o in self.pool.own)
            and self._surely_a_member()
        )

    def _surely_a_member(self) -> bool:
        """Whether the others cannot have evicted us for our silence by now."""
        limit = self.plan.timing.evict_after
        members = self._member_names()
        return limit <= 0 or is_quorum(self.peers.near(members, self.name, limit, self._now), members)

    def _move_alone(self, entry: log.Done, firing: Firing) -> None:
        origin = self._next_origin()
        self.persist(
            {
                "kind": "private",
                "entry": log.to_json(entry),
                "origin": list(origin),
                "firing": firing_to_json(firing, self.plan.net),
            }
        )
        self.pool.own.append(Own(Item(entry, origin, True)))
        self._put(io.Fired(firing, True, self.ledger.hash, True))
        self._act({})

    # -- the operator ---------------------------------------------------------------------------------

    def _order(self, order: io.Order) -> None:
        if self._now < self._listen_until:
            self._held.append(order)  # we are not in the team yet, but for as long as we listen only
            return
        entry = order.entry
        if isinstance(entry, log.Evict) and entry.incarnation < 0:
            state = self.ledger.state.robots.get(entry.robot)
            entry = entry._replace(incarnation=state.incarnation if state else 0)
        why = self._why_not(entry)
        if why:
            self._put(io.OrderResult(order.order_id, False, why))
        else:
            self._invoke(entry, order.order_id)

    def _why_not(self, entry: log.Entry) -> str:
        """Why an order makes no sense as things stand; "" if it does."""
        if self.ledger.state.ended is not None:
            return "the run is over: %s" % self.ledger.state.ended
        if not self.active or not (self.is_member() or self.witness):
            return "%s is not in the team (yet)" % self.name
        if isinstance(entry, log.Leave) and self._member_names() == [entry.robot]:
            return "%s is the last one of the team; stop the run instead" % entry.robot
        robot = getattr(entry, "robot", "")
        state = self.ledger.state.robots.get(robot)
        if robot and (state is None or state.phase in GONE):
            return "there is no robot '%s' in the team" % robot
        if isinstance(entry, log.SetPlace) and entry.place not in self.plan.action_places:
            return "'%s' is not an action place of the plan" % entry.place
        if isinstance(entry, log.Fire) and entry.transition not in self.plan.net.transition_index:
            return "the net has no transition '%s'" % entry.transition
        if isinstance(entry, log.Retry) and state is not None and state.phase.value != "failed":
            return "the action of %s did not fail" % robot
        return ""

    def _force_evict(self, order: io.ForceEvict) -> None:
        state = self.ledger.state.robots.get(order.robot)
        why = ""
        if self.ledger.state.ended is not None:
            why = "the run is over: %s" % self.ledger.state.ended
        elif order.robot == self.name:
            why = "%s cannot assert that it is off itself" % self.name
        elif state is None or state.phase in GONE:
            why = "there is no robot '%s' in the team" % order.robot
        elif self.forgetful or (self.joining and not self.active):
            why = "%s has no vote; ask a robot that is in the team" % self.name
        elif self.peers.get(order.robot).heard is not None:
            silence = self.peers.silence(order.robot, self._now)
            if silence < 2 * self.pace.heartbeat:
                why = "%s was heard %.1f s ago: it is not off; use evict, or switch it off" % (order.robot, silence)
        if why or state is None:
            self._put(io.OrderResult(order.order_id, False, why))
            return
        self._assert_off(order.robot, state.incarnation)
        self._consider_active()
        self.consensus.abandon()
        self._invoke(log.Evict(order.robot, state.incarnation, True), order.order_id)
        warning = self._what_is_given_up()
        if warning:
            self._fault(warning)

    def _what_is_given_up(self) -> str:
        """What the assertions that some robots are off mean for what they know."""
        members, off = self._member_names(), self.asserted_off()
        left = [m for m in members if m not in off]
        if not left or is_quorum(left, members):
            return ""
        return (
            "%s could have decided without the others: what only they know is given up; they must stay off until "
            "they are evicted, for which the word of all others is needed (%s)"
            % (", ".join(m for m in members if m in off), ", ".join(left))
        )
