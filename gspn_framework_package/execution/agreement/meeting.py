"""How replicas get to know each other: hello, who is fresh and who lost its memory, who does not
belong here."""

from __future__ import annotations

from typing import Dict, List, Optional

from gspn_framework_package.execution import entries as log
from gspn_framework_package.execution.agreement import interface as io
from gspn_framework_package.execution.agreement.growth import Growth
from gspn_framework_package.execution.agreement.messages import MOST_ROBOTS, Envelope, Hello, Seen
from gspn_framework_package.execution.agreement.peers import Life
from gspn_framework_package.execution.agreement.pool import Own
from gspn_framework_package.execution.ledger import Item
from gspn_framework_package.execution.team_state import GONE


class Meeting(Growth):
    """Says hello and hears it."""

    def _hello(self) -> Hello:
        limit = self.plan.timing.evict_after
        members = self._member_names()
        silent = self.peers.silent(members, self.name, limit, self._now) if limit > 0 else set()
        return Hello(
            self._begin_records,
            self.active,
            self.joining,
            self._first_hash,
            tuple(sorted(silent)),
            {robot: self.off[robot] for robot in sorted(self.asserted_off())},
            dict(self.ledger.cast_out),
            self._greetings(),
        )

    def _greetings(self) -> Dict[str, Seen]:
        """What we know of those who wait to hear it: who does not take part yet, or would be
        surprised. In a team at work there is nobody, so that a hello does not grow with the team."""
        greets = {}
        for robot, peer in self.peers.all.items():
            if peer.surprise is not None:
                greets[robot] = peer.surprise
            elif not peer.active and peer.log and len(greets) < MOST_ROBOTS:
                greets[robot] = Seen(self.known_log(robot), *peer.life)
        return greets

    def _knows(self, message: Envelope) -> bool:
        """Note whose log a message speaks for; whether it is the one whose votes count."""
        sender = message.sender
        peer = self.peers.get(sender)
        known = self.known_log(sender)
        if not known and len(self.peers.known) < MOST_ROBOTS:
            known = self.peers.known[sender] = message.log
            self.persist({"kind": "peer", "robot": sender, "log": message.log}, durable=True)
        peer.note_life(message)
        peer.surprise = None
        if known and message.log != known:
            peer.surprise = Seen(known, 0, 0)
            return False
        if Life(message.incarnation, message.records) < peer.life:
            peer.surprise = Seen(known, *peer.life)
        elif isinstance(message.body, Hello) and message.body.begin < peer.before.records:
            peer.surprise = Seen(known, *peer.before)
        return True

    def _on_hello(self, message: Envelope, hello: Hello) -> None:
        sender = message.sender
        peer = self.peers.get(sender)
        met = peer.met
        peer.met = True
        peer.active = hello.active
        peer.silent = frozenset(hello.silent)
        peer.evicted_at = hello.cast_out.get(sender, -1)
        if hello.first and self._first_hash and hello.first != self._first_hash:
            self._refuse_stranger(sender, "%s has another first team" % sender)
            return
        if not self.active:
            for robot, incarnation in hello.off.items():
                self._note_off(robot, incarnation)
        seen = hello.greets.get(self.name)
        if seen is not None:
            self._hear_of_ourselves(sender, seen)
        if self._is_given_up(hello.cast_out):
            self._forget("it was given up in an eviction by force, as %s knows" % sender)
        self._consider_active()
        # in a large team answers to everybody's greetings would drown it: there the next hello will do
        waits = not hello.active or peer.surprise is not None
        rested = self._now >= peer.answered + min(self.pace.greeting, self.pace.heartbeat)
        if (not met or (waits and rested)) and (self.is_small or self._request):
            peer.answered = self._now
            self.answer(message, self._hello())
        self._compare(message)

    def _is_given_up(self, theirs: Dict[str, int]) -> bool:
        """Whether our log was given up in an eviction by force, as another's log says.

        Where two logs each say so of the other (operators contradicted each other), the one that evicts
        fewer is kept, else the one that does not evict the first robot. A log that a quorum went on
        with is always kept: the other evicts all of that quorum.
        """
        mine = self.ledger.cast_out
        by_them = {robot for robot, slot in theirs.items() if slot > mine.get(robot, -1)}
        by_us = {robot for robot, slot in mine.items() if slot > theirs.get(robot, -1)}
        if not by_us:
            return self.name in by_them and theirs[self.name] < self.ledger.length
        if len(by_us) != len(by_them):
            return len(by_us) > len(by_them) > 0
        team = [r.name for r in self.plan.robots]
        return min(by_us | by_them, key=lambda r: (team.index(r) if r in team else len(team), r)) in by_us

    def _hear_of_ourselves(self, sender: str, seen: Seen) -> None:
        """What another remembers of us."""
        peer = self.peers.get(sender)
        peer.welcomes = seen.log
        if self.forgetful or (self.joining and not self.active):
            return
        if seen.log != self.log_id:
            if self.ledger.logs.get(self.name) != self.log_id:
                self._forget("%s knows an older one" % sender)
            return
        ours = Life(self.incarnation, self.records)
        theirs = Life(seen.incarnation, seen.records)
        if theirs > ours or (theirs.incarnation < self.incarnation and theirs.records > self._begin_records):
            self._forget("it is shorter than %s remembers" % sender)

    def _can_teach(self, robot: str) -> bool:
        """Whether the log of a robot may hold what we have still to learn. One that was evicted by force, as far as our
        log goes, can where its own log has that eviction: we shall learn that it joined again."""
        slot = self.ledger.cast_out.get(robot, -1) if self.ledger.is_cast_out(robot) else -1
        return self.peers.get(robot).evicted_at >= slot

    def _hash_at(self, length: int) -> Optional[str]:
        """The hash of the first ``length`` slots, None where we do not know (any more)."""
        return self.ledger.hash if length == self.ledger.length else self.history.hash_before(length)

    def _not_given_up(self, message: Envelope, items: List[Item]) -> List[Item]:
        """Leave out what a robot that was evicted by force wants, unless it is told by one who knows of
        the eviction: what it said before was given up, even that it comes back."""
        if not self.ledger.cast_out:
            return items
        same = self._hash_at(message.length) == message.hash
        return [
            i
            for i in items
            if not self.ledger.is_cast_out(i.origin.robot)
            or (same and message.length > self.ledger.cast_out[i.origin.robot])
        ]

    def _compare(self, message: Envelope) -> None:
        """Look whether the sender's log begins as ours does, or ours as its."""
        if message.length > self.ledger.length:
            return
        known = self._hash_at(message.length)
        if known is None:
            return
        if known != message.hash:
            self._conflict(message.sender, message.length)
        else:
            self.astray.pop(message.sender, None)

    def _consider_active(self) -> None:
        """Become active once every other member of the first team knows our log as the first one
        that we have, and nobody knows more than we do."""
        if self.active or self.joining or self.forgetful or self.ledger.length < 1 or self._now < self._listen_until:
            return
        others = [m for m in self.others() if m not in self.off]
        if any(self.peers.get(m).welcomes != self.log_id for m in others):
            return
        if any(peer.length > self.ledger.length and peer.heard is not None for peer in self.peers.all.values()):
            return  # nor act before we know where the team is
        self._become_active()
        team = self._member_names()
        if team and team[0] == self.name and self.incarnation == 0 and not self.partial and self.ledger.length == 1:
            self.consensus.lead_from_the_start(set(team) - set(self.off))
        self._act({})

    # -- robots that are off ----------------------------------------------------------------------------

    def _note_off(self, robot: str, incarnation: int) -> None:
        """Note that an operator asserted that a robot is off."""
        state = self.ledger.state.robots.get(robot)
        if robot == self.name or state is None or state.phase in GONE or state.incarnation != incarnation:
            return
        if self.off.get(robot) != incarnation and self.peers.get(robot).heard is None:
            self._assert_off(robot, incarnation)

    def _assert_off(self, robot: str, incarnation: int) -> None:
        self.off[robot] = incarnation
        self._persist_off()

    def _persist_off(self) -> None:
        self.persist({"kind": "forced", "slot": self.ledger.length, "robots": dict(self.off)}, durable=True)

    def _heard_though_off(self, robot: str) -> None:
        """A robot that was asserted to be off is heard: the assertion was wrong, or is over."""
        was = robot in self.asserted_off()
        del self.off[robot]
        self._persist_off()
        if not was:
            return
        kept = []
        for own in self.pool.own:
            entry = own.item.entry
            if isinstance(entry, log.Evict) and entry.forced and entry.robot == robot:
                self._withdraw(own, "%s is not off: it was heard" % robot)
            else:
                kept.append(own)
        self.pool.own = kept
        self.consensus.abandon()
        self._fault("%s was said to be off, and is heard: it is not evicted" % robot)

    def _withdraw(self, own: Own, why: str) -> None:
        self.persist({"kind": "void", "origin": list(own.item.origin), "why": why})
        if own.order_id:
            self._put(io.OrderResult(own.order_id, False, why))

    # -- who does not belong here -----------------------------------------------------------------------

    def _hear_own_name(self, message: Envelope) -> None:
        body = message.body
        if message.team != self._tag or not isinstance(body, Hello):
            return
        same = message.log == self.log_id
        if message.incarnation > self.incarnation and (same or (body.active and self.active)):
            self._halt("another process runs as %s, and started later" % self.name)
        elif self._superseded_at is not None and not same:
            if self._rival_since is None:
                self._rival_since = self._now
            elif self._now - self._rival_since > 1.5 * self.pace.heartbeat:  # a late message comes but once
                self._halt("another process runs as %s, and was let in after it" % self.name)

    def _hear_stranger(self, message: Envelope) -> None:
        run, _, plan = message.team.rpartition("|")
        if run == self.run and plan != self.plan.hash()[:12]:
            self._refuse_stranger(message.sender, "%s has another plan" % message.sender)

    def _refuse_stranger(self, sender: str, what: str) -> None:
        if sender in self._strangers:
            return
        self._strangers.add(sender)
        if not self.active and self.plan.robots and sender in [r.name for r in self.plan.robots]:
            self._halt("%s (run '%s'); give all robots the same plan" % (what, self.run))
        else:
            self._fault("%s (run '%s'); it is not let in" % (what, self.run))
