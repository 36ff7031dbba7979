"""Examines a plan that was staged for the team, and votes on it.

Owns ``examining`` and ``examined``. Has the host find out whether the robot can follow the plan,
and proposes the answer. Only the log decides whether the plan is adopted.
"""

from __future__ import annotations

from gspn_framework_package.execution import log_entries, plan_change
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.part import ReplicaPart
from gspn_framework_package.execution.team_state import StagedPlan
from gspn_framework_package.model.errors import GspnError


class Deployment(ReplicaPart):
    """Votes on staged plans."""

    def want_vote(self) -> None:
        """Have a staged plan examined, and vote once the host has answered."""
        state = self.state
        staged = state.ledger.state.staged
        if staged is None or not self._may_speak() or self._has_voted(staged):
            return
        if state.examining != (staged.number, state.incarnation):
            state.examining, state.examined = (staged.number, state.incarnation), None
            self._examine(staged)
        if state.examined is not None:
            why = state.examined[: log_entries.WHY_LIMIT]
            self.proposals.propose(
                log_entries.Staged(self.config.name, state.incarnation, staged.number, why)
            )

    def take(self, given: interface.Examined) -> None:
        """Take the host's answer about a plan."""
        if given.stage == self.state.examining[0]:
            self.state.examined = given.why

    def _may_speak(self) -> bool:
        """Whether the log knows this incarnation of ours, so that its vote counts."""
        if self.config.witness:
            return self.state.active and self.electorate.is_member()
        return self.electorate.is_settled()

    def _has_voted(self, staged: StagedPlan) -> bool:
        vote = staged.votes.get(self.config.name)
        if vote is not None and vote[0] == self.state.incarnation:
            return True
        for own in self.state.own_proposals.asking:
            entry = own.item.entry
            if isinstance(entry, log_entries.Staged) and (entry.incarnation, entry.stage) == (
                self.state.incarnation,
                staged.number,
            ):
                return True
        return False

    def _examine(self, staged: StagedPlan) -> None:
        try:
            plan = plan_change.plan_of(staged)
        except GspnError as error:
            self.state.examined = "cannot read the plan: %s" % error
            return
        why = plan_change.why_never(self.state.ledger.game.plan, plan, staged.mapping)
        if why or self.config.witness:  # a witness runs no actions
            self.state.examined = "; ".join(why)
        else:
            self.outbox.put(interface.Examine(staged.number, plan, staged.folder))
