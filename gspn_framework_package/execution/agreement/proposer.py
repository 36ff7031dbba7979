"""Decides when to propose (as leader, after waiting for the leader, or through a member if we have
no vote), when to retry, and when to give way to another robot's attempt. Safety does not depend on
it.

Owns the timers of the open slot (the fields of proposer in
:class:`~gspn_framework_package.execution.agreement.state.ReplicaState`) and drives the
:class:`~gspn_framework_package.execution.agreement.consensus.Consensus`. Reads the proposals and
the electorate, and sends messages through the outbox.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Set

from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.messages import (
    MOST_ITEMS,
    Accept,
    Accepted,
    Envelope,
    Nack,
    Prepare,
    Promise,
    Proposals,
)
from gspn_framework_package.execution.agreement.part import ReplicaPart
from gspn_framework_package.execution.agreement.quorum import Ballot
from gspn_framework_package.execution.chance import uniform
from gspn_framework_package.model.plan_timing import POLICY

BUSY = 4.0
"""A leader gathers proposals if its slots are at most this many round trips apart."""

LONGEST_GATHER = 0.01
"""Maximum number of seconds to gather. If messages take longer than this, gathering gains
little."""

FLUSH_AT = 100
"""Number of waiting local transitions at which a slot is proposed just for them."""


@dataclass(eq=False)
class Proposer(ReplicaPart):
    """Acts on the clock and on waiting proposals."""

    consensus: Consensus

    # -- inputs ------------------------------------------------------------------------------------

    def on_proposals(self, message: Envelope, body: Proposals) -> None:
        """Take another robot's proposals."""
        self.proposals.add_others(self.electorate.not_given_up(message, body.items))
        voteless = self.state.voteless
        (voteless.discard if body.vote else voteless.add)(message.sender)

    def forget(self, robot: str) -> None:
        """Forget a robot outside the team that has fallen silent."""
        self.state.voteless.discard(robot)

    def on_vote(self, message: Envelope) -> None:
        """Handle a consensus message of a robot whose votes count."""
        body, consensus, now = message.body, self.consensus, self.state.now
        if isinstance(body, Prepare):
            before = self.state.promised
            consensus.on_prepare(message, body)
            if before != self.state.promised == body.ballot:
                self._give_way()  # only once: a robot that keeps asking may never get what it needs
        elif isinstance(body, Accept):
            consensus.on_accept(message, body)
        elif isinstance(body, Promise):
            consensus.on_promise(message, body, now)
        elif isinstance(body, Accepted):
            consensus.on_accepted(message, body, now)
        elif isinstance(body, Nack) and consensus.on_nack(body):
            self.state.defeats += 1
            self._give_way()

    def on_chosen(self, ballot: Ballot) -> bool:
        """Handle the news that the batch accepted under ``ballot`` was chosen in the open slot;
        False if we do not have that batch."""
        return self.consensus.on_chosen(ballot)

    def ask_again(self, robot: str) -> None:
        """Repeat our question to a robot that was behind and could not answer it."""
        self.consensus.ask_again(robot)

    # -- the outcome of the open slot --------------------------------------------------------------

    def next_slot(self, mine: bool, returned: Set[str]) -> None:
        """Move on to the next slot; see
        :meth:`~gspn_framework_package.execution.agreement.consensus.Consensus.next_slot`."""
        state = self.state
        self.consensus.next_slot(mine, returned)
        state.defeats = 0
        state.frozen_since = None
        state.wait_until = None
        state.gave_way = False
        if state.asked_at is not None and not state.own_proposals:
            self.consensus.took(state.now - state.asked_at)
            state.asked_at = None
        # several robots may want the next slot; they should not all start at once
        if self.config.partial and not mine:
            state.wait_until = (
                state.now + max(self.config.pace.backoff, state.delay) * self._spread()
            )

    def begin_anew(self) -> None:
        """Start over with a new log: attempts at the open slot of the old one do not count."""
        self.consensus.next_slot(False, set())

    def abandon(self) -> None:
        """Give up the running attempt and the lead."""
        self.consensus.abandon()

    def lead_from_the_start(self, followers: Set[str]) -> None:
        """Lead as the first robot of a team whose robots are all fresh."""
        self.consensus.lead_from_the_start(followers)

    def lead_on(self, ballot: Ballot, origins: Set[str]) -> bool:
        """After our attempt was chosen, propose a waiting batch at once under the same ballot,
        which also informs the others. Returns whether there was one.

        :param origins: the robots whose proposals were in the batch.
        """
        if self.config.partial:
            return False
        self._gather(origins)
        if self.state.now < self.state.gathers_until and not self._gathered():
            return False
        self.consensus.propose(self.state.now)
        attempt = self.state.attempt
        return attempt is not None and attempt.ballot == ballot

    def _gather(self, origins: Set[str]) -> None:
        """As leader, wait a moment for robots whose actions end together, since each slot costs
        messages to and from every robot. While we decide slot after slot, the robots of the last
        two slots act at the same time, and their next proposals arrive within a round trip."""
        state, wait = self.state, 0.0
        if state.now - state.decided_at <= BUSY * state.round_trip:
            state.gathers = state.busy | origins
            wait = min(2 * state.round_trip, LONGEST_GATHER) if len(state.gathers) > 1 else 0.0
        else:
            state.gathers = set()
        state.busy, state.decided_at = origins, state.now
        state.gathers_until = state.now + max(wait, self.config.pace.gather)

    def _gathered(self) -> bool:
        """Whether everything we gather has arrived, so that we need not wait longer."""
        state = self.state
        if self.config.pace.gather > 0:
            return False
        return state.gathers <= {
            self.config.name if state.own_proposals else "",
            *state.others_proposals,
        }

    # -- time ----------------------------------------------------------------------------

    def wants(self) -> bool:
        """Whether something should get into the log now."""
        state = self.state
        if state.ledger.state.ended is not None:
            return False
        own = state.own_proposals
        if own.asking:
            return True
        if own and (len(own) >= FLUSH_AT or self._somebody_asks_the_policy()):
            return True
        if state.others_proposals and self._others_want():
            return True
        if state.frozen_by is not None and state.frozen_since is not None:
            return state.now >= state.frozen_since + 2 * self.config.pace.takeover
        return False

    def _others_want(self) -> bool:
        """Whether we should propose what others announced: we lead, or they have no vote."""
        if self.consensus.leads():
            return True
        members, voteless = self.electorate.members(), self.state.voteless
        origins = self.proposals.origins()
        without_vote = [o for o in origins if o not in members or o in voteless]
        if not without_vote:
            return False
        return bool(self.electorate.without_ghosts(self.proposals.reported_by(without_vote)))

    def _somebody_asks_the_policy(self) -> bool:
        team, immediate = self.state.ledger.state, self.state.ledger.game.immediate
        asking = (team.robots[name] for name in team.waiting)
        return any(robot.request == POLICY and immediate[robot.place] for robot in asking)

    def drive(self) -> None:
        """Advance the waiting proposals."""
        state, consensus, torn = self.state, self.consensus, self.electorate.needs_all()
        if state.attempt is not None and state.attempt.torn != torn:
            consensus.abandon()  # a robot's machine lost power, or has come back
        again = consensus.resend_at(self.config.pace.retry)
        if again is not None:
            if state.now >= again:
                consensus.resend(state.now)
            return
        if state.frozen_by is not None and state.frozen_since is None:
            state.frozen_since = state.now
        if not self.wants():
            # otherwise another robot's attempt is running, which our next proposal must not defeat
            if not state.gave_way:
                state.wait_until = None
            return
        if torn:
            self._propose_to_all()
        elif not self.electorate.may_vote():
            self._ask_members()
        elif self.config.partial:
            if state.wait_until is None or state.now >= state.wait_until:
                state.wait_until = None
                consensus.propose(state.now, state.is_frozen() or self.proposals.has_control())
        elif consensus.leads():
            if state.now >= state.gathers_until or self._gathered():
                consensus.propose(state.now)
        else:
            self._follow_leader()

    def _propose_to_all(self) -> None:
        """Propose for a slot that needs the votes of all: the first robot proposes, later perhaps
        another."""
        state = self.state
        if state.wait_until is None:
            patience = 0.0 if self.electorate.is_first_running() else self._patience()
            state.wait_until = state.now + patience
        if state.now >= state.wait_until:
            state.wait_until = state.now + self._patience()
            frozen = self.config.partial and (state.is_frozen() or self.proposals.has_control())
            self.consensus.propose(state.now, frozen)

    def _follow_leader(self) -> None:
        state = self.state
        leader = state.leader
        if state.wait_until is None:
            state.wait_until = state.now + self._patience()
        if state.asked_at is None:
            state.asked_at = state.now
        if (
            leader == self.config.name
            or leader not in self.electorate.others()
            or state.now >= state.wait_until
        ):
            state.wait_until = state.now + self._patience()
            self.consensus.propose(state.now)
            return
        self._send_event([leader])

    def _ask_members(self) -> None:
        """We have no vote: let a member that has one propose our proposals."""
        others = self.electorate.others()
        near = self.electorate.whole() or self.electorate.heard_of_late()
        heard = [m for m in others if m in near] or others
        if not heard:
            return
        leader = self.state.leader
        if self.config.partial or leader not in heard:
            turn = int(self.state.now / max(self.config.pace.takeover, 1e-9))
            leader = heard[turn % len(heard)]
        self._send_event([leader])

    def _send_event(self, to: List[str]) -> None:
        state = self.state
        items = self.proposals.own_items()
        sent = (
            tuple(to),
            state.ledger.length,
            len(state.own_proposals),
            tuple(self.proposals.origins()),
        )
        if sent == state.last_sent[:4] and state.now < state.last_sent[4]:
            return
        state.last_sent = (*sent, state.now + self.config.pace.retry)
        extra = self.proposals.in_order(True)[: self.config.limits.batch]
        known = {i.origin for i in items}
        items = items + [i for i in extra if i.origin not in known]
        self.outbox.send_all(to, Proposals(items[:MOST_ITEMS], self.electorate.may_vote()))

    def _patience(self) -> float:
        """How long a proposal waits for the leader (s)."""
        members, me = self.electorate.members(), self.config.name
        rank = members.index(me) if me in members else len(members)
        takeover = max(self.config.pace.takeover, 3 * self.state.delay)
        return takeover * (1 + 0.25 * rank + 0.5 * self._draw())

    def _give_way(self) -> None:
        """Wait for the outcome of another robot's attempt, which takes precedence."""
        state = self.state
        if self.config.partial:
            state.gave_way = True
            needs = 2 * state.delay  # the time of its two phases
            wait = max(needs, self.config.pace.backoff * 2 ** min(state.defeats, 6)) * (
                1 + self._spread()
            )
        else:
            wait = self._patience()
        state.wait_until = state.now + wait

    def _spread(self) -> float:
        """A random part of the time over which robots spread their starts when they want a slot; it
        is longer in a large team, where more robots want one at a time."""
        return self.config.pace.spread * self._draw()

    def _draw(self) -> float:
        """A number in [0, 1) that differs between robots and between calls."""
        state, seed = self.state, self.config.plan.seed
        return uniform(
            seed, state.ledger.length, state.highest.counter, "wait of " + self.config.name
        )

    def wake_times(self) -> List[float]:
        """When to check again (s)."""
        state = self.state
        again = self.consensus.resend_at(self.config.pace.retry)
        if again is not None:
            return [again]
        times = []
        if self.wants():
            if state.wait_until is not None:
                times.append(state.wait_until)
            if self.consensus.leads() and state.gathers_until > state.now:
                times.append(state.gathers_until)
            if state.last_sent and not self.config.partial or not self.electorate.may_vote():
                times.append(
                    state.last_sent[4] if state.last_sent else state.now + self.config.pace.retry
                )
        elif state.frozen_since is not None:
            times.append(state.frozen_since + 2 * self.config.pace.takeover)
        return times
