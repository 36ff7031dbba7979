"""What a replica does as time passes: propose, ask again, give way, suspect, stop."""

from __future__ import annotations

from typing import List

from gspn_framework_package.execution import entries as log
from gspn_framework_package.execution.agreement.conduct import Conduct
from gspn_framework_package.execution.agreement.messages import MOST_ITEMS, Event
from gspn_framework_package.execution.agreement.quorum import is_quorum
from gspn_framework_package.execution.firing import (
    Ended,
)
from gspn_framework_package.execution.team_state import POLICY

FLUSH_AT = 100
"""Private moves that wait before they are brought into the log for their number alone."""

RIVAL = 4
"""Heartbeats for which a robot whose place another log has taken listens for a second process of
its name, before it wants its place back."""

LINGER = 20
"""Heartbeats for which a robot that leaves waits for a quorum of the others to hear of it."""


class Pacing(Conduct):
    """Looks at the clock. Nothing here matters for safety."""

    def _wants(self) -> bool:
        """Whether something should get into the log now."""
        if self.ledger.state.ended is not None:
            return False
        own = self.pool.own
        if any(not o.item.private for o in own):
            return True
        if own and (len(own) >= FLUSH_AT or self._somebody_asks_the_policy()):
            return True
        origins = self.pool.origins()
        if origins and self.consensus.leads():
            return True
        members = set(self._member_names())
        if any(origin not in members or origin in self._voteless for origin in origins):
            return True
        if self.consensus.frozen_by is not None and self._hold_since is not None:
            return self._now >= self._hold_since + 2 * self.pace.takeover
        return False

    def _somebody_asks_the_policy(self) -> bool:
        state = self.ledger.state
        return any(state.robots[name].request == POLICY for name in state.waiting)

    def _drive(self) -> None:
        """Get on with what is wanted."""
        consensus = self.consensus
        again = consensus.resend_at(self.pace.retry)
        if again is not None:
            if self._now >= again:
                consensus.resend(self._now)
            return
        if consensus.frozen_by is not None and self._hold_since is None:
            self._hold_since = self._now
        if not self._wants():
            if not self._gave_way:  # else another's attempt is under way, which the next fact of ours must not defeat
                self._wait_until = None
            return
        if not self.may_vote():
            self._ask_members()
        elif self.partial:
            if self._wait_until is None or self._now >= self._wait_until:
                self._wait_until = None
                consensus.propose(self._now, consensus.is_frozen() or self.pool.has_control())
        elif consensus.leads():
            if self._now >= self._gathers_until:
                consensus.propose(self._now)
        else:
            self._follow_leader()

    def _follow_leader(self) -> None:
        leader = self.consensus.leader
        if self._wait_until is None:
            self._wait_until = self._now + self._patience()
        if leader == self.name or leader not in self.others() or self._now >= self._wait_until:
            self._wait_until = self._now + self._patience()
            self.consensus.propose(self._now)
            return
        self._send_event([leader])

    def _ask_members(self) -> None:
        """We have no vote: have a member propose what we want."""
        others = self.others()
        heard = [m for m in others if self.peers.get(m).heard is not None] or others
        if not heard:
            return
        leader = self.consensus.leader
        if self.partial or leader not in heard:
            turn = int(self._now / max(self.pace.takeover, 1e-9))
            leader = heard[turn % len(heard)]
        self._send_event([leader])

    def _send_event(self, to: List[str]) -> None:
        items = self.own_items()
        foreign_news = tuple(self.pool.origins())
        told = (tuple(to), self.ledger.length, len(items), foreign_news)
        if told == self._told[:4] and self._now < self._told[4]:
            return
        self._told = (*told, self._now + self.pace.retry)
        extra = self.pool.batch(self._member_names(), frozen=True, most=self.limits.batch)
        known = {i.origin for i in items}
        items = items + [i for i in extra if i.origin not in known]
        self.send_all(to, Event(items[:MOST_ITEMS], self.may_vote()))

    def _patience(self) -> float:
        members = self._member_names()
        rank = members.index(self.name) if self.name in members else len(members)
        takeover = max(self.pace.takeover, 3 * self.consensus.round_trip)
        return takeover * (1 + 0.25 * rank + 0.5 * self._draw())

    def _give_way(self) -> None:
        """Another's attempt goes first: wait for its outcome."""
        if self.partial:
            self._gave_way = True
            needs = 2 * self.consensus.round_trip  # its two phases
            wait = max(needs, self.pace.backoff * 2 ** min(self._defeats, 6)) * (1 + self._draw())
        else:
            wait = self._patience()
        self._wait_until = self._now + wait

    def _wake_at(self) -> float:
        times = [self._next_hello]
        if self._listen_until:
            times.append(self._listen_until)
        again = self.consensus.resend_at(self.pace.retry)
        if again is not None:
            times.append(again)
        elif self._wants():
            if self._wait_until is not None:
                times.append(self._wait_until)
            if self.consensus.leads() and self._gathers_until > self._now:
                times.append(self._gathers_until)
            if self._told and not self.partial or not self.may_vote():
                times.append(self._told[4] if self._told else self._now + self.pace.retry)
        elif self._hold_since is not None:
            times.append(self._hold_since + 2 * self.pace.takeover)
        if self.plan.simulate_environment and self.may_vote():
            due = self._environment.next_time(self.ledger.state, self._now)
            times += [due] if due is not None else []
        return max(self._now + 0.001, min(times))

    # -- who is silent --------------------------------------------------------------------------------

    def _watch(self) -> None:
        """Look for robots that seem lost, and whether we are out of contact ourselves."""
        timing = self.plan.timing
        members = self._member_names()
        if not self.may_vote() or self.ledger.state.ended is not None:
            self.fenced = False
            return
        if timing.fence_after > 0:
            near = self.peers.near(members, self.name, timing.fence_after, self._now)
            self._fence(not is_quorum(near, members))
        if timing.evict_after > 0:
            silent = self.peers.silent(members, self.name, timing.evict_after, self._now)
            self.pool.withdraw_suspicion(o.suspect for o in self.pool.own if o.suspect and o.suspect not in silent)
            accused = {o.suspect for o in self.pool.own}
            for robot in sorted(silent - accused):
                state = self.ledger.state.robots.get(robot)
                jury = self.peers.accusers(robot) | {self.name}
                if state is not None and is_quorum(jury, members):
                    self._invoke(log.Evict(robot, state.incarnation), suspect=robot)

    def _fence(self, fenced: bool) -> None:
        if fenced == self.fenced or self.witness:
            return
        self.fenced = fenced
        if fenced:
            self._stop_acting()
            self._fault("has no contact to a quorum for %g s: stops" % self.plan.timing.fence_after)
        elif self.is_settled():
            self._new_life()  # what it was doing is started again

    def has_quorum(self) -> bool:
        """Whether the members that were heard of late (ourselves included) could decide."""
        return self.may_decide(self._near())

    def _near(self) -> List[str]:
        return self.peers.near(self.members(), self.name, 4 * self.pace.heartbeat, self._now)

    def _silent(self) -> List[str]:
        near = self._near()
        return [m for m in self.members() if m not in near]

    # -- what must happen now and then ----------------------------------------------------------------

    def _want_to_join(self) -> None:
        """See that the log gets to know this incarnation of ours."""
        if self.fenced or self.leaving or self.ledger.length == 0 or self.is_settled():
            return
        if (self.active and self.witness) or not (self.active or self.forgetful or self.joining):
            return
        if self._superseded_at is not None:
            if self._now < self._superseded_at + RIVAL * self.pace.heartbeat:
                return  # is it somebody who runs, or a former life of ours?
            self._superseded_at = None
        if self._known_incarnation() >= self.incarnation:
            self._new_life()
        if any(
            isinstance(o.item.entry, log.Join) and o.item.origin.incarnation == self.incarnation for o in self.pool.own
        ):
            return
        place = (
            self.place
            or next((r.place for r in self.plan.robots if r.name == self.name), "")
            or (self.plan.spawn[0] if self.plan.spawn else "")
        )
        self._invoke(log.Join(self.name, self.incarnation, place, self.log_id))

    def _want_environment(self) -> None:
        if not self.plan.simulate_environment or not self.may_vote():
            return
        if any(isinstance(o.item.entry, log.Fire) for o in self.pool.own):
            return
        due = self._environment.next_time(self.ledger.state, self._now)
        if due is None or self._now < due:
            return
        members = self._member_names()
        live = self.peers.near(members, self.name, 3 * self.pace.heartbeat, self._now)
        transition = self._environment.due(self.ledger.state, self._now)
        if live[0] == self.name and transition is not None:
            self._invoke(log.Fire(transition))

    def _part(self) -> None:
        """End once a quorum of those who stay knows that we have left, or none can be reached."""
        members = self._member_names()
        know = [m for m in members if self.peers.get(m).length >= self.ledger.length]
        if self._leaving_since is None:
            self._leaving_since = self._now
        lingered = self._now - self._leaving_since
        if members and not is_quorum(know, members) and lingered < LINGER * self.pace.heartbeat:
            return
        self.halted = "%s has left the team" % self.name
        self._put(Ended(self.halted, True))
