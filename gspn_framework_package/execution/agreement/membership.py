"""Membership: how replicas discover each other, join, leave, are evicted, and lose and regain the
right to vote.

Owns who we are (log id, incarnation, whether we are active, amnesic, fenced, leaving, halted) and
what is known of the others (peers, which of them are off, diverged or strangers, and for how long a
fresh robot listens): the fields of membership in
:class:`~gspn_framework_package.execution.agreement.state.ReplicaState`. Proposes joins and
evictions, has the proposer give up its attempts, the local robot stop or act, and the log start
over.
"""

# In one piece: who is in the team and who may vote depend on the same fields

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Dict, List, Protocol, Sequence

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.local_robot import LocalRobot
from gspn_framework_package.execution.agreement.messages import MOST_ROBOTS, Envelope, Hello, Seen
from gspn_framework_package.execution.agreement.part import ReplicaPart
from gspn_framework_package.execution.agreement.peers import Life
from gspn_framework_package.execution.agreement.proposer import Proposer
from gspn_framework_package.execution.agreement.quorum import is_quorum
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.firing import Ended
from gspn_framework_package.execution.ledger import Item
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.plan_change import home_of

RIVAL = 4
"""Number of heartbeats for which a robot replaced by another log listens for a second process of
its name before it tries to rejoin."""

MOST_COMPLAINTS = 100
"""Maximum number of kinds of malformed messages that are counted separately."""

OTHERS = ("others", "not understood")
"""The kind under which all further ones are counted."""

GUESTS = 16
"""Maximum number of robots outside the team, as far as we know, from which we accept messages at
once."""

GUEST_STAY = 4
"""Number of heartbeats of silence after which such a robot is forgotten."""

LINGER = 20
"""Number of heartbeats for which a leaving robot waits until a quorum of the others knows that it
has left."""


class MembershipLog(Protocol):
    """The interface of the replicated log for the membership."""

    def begin_anew(self) -> None:
        """Forget all slots."""

    def keep_slots(self) -> None:
        """Keep all slots under a new log id, without the votes."""


@dataclass(eq=False)
class Membership(ReplicaPart):
    """Sends and receives hellos, and acts on them."""

    proposer: Proposer
    robot: LocalRobot

    def connect(self, log: MembershipLog) -> None:
        """Set the replicated log."""
        self.log: MembershipLog = log

    # -- incarnations and memory -------------------------------------------------------------------

    def begin_first_life(self) -> None:
        """Begin with a new log: listen before taking part, since another robot may know our
        name."""
        state, pace = self.state, self.config.pace
        self._note_life()
        state.listen_until = state.now + min(pace.greeting, pace.heartbeat)

    def new_life(self) -> None:
        """Begin a new incarnation after a restart or return; the log must learn of it."""
        self.state.incarnation = (
            max(self.state.incarnation, self.electorate.known_incarnation()) + 1
        )
        self.proposals.begin_life()
        self._note_life()

    def _note_life(self) -> None:
        state = self.state
        state.begin_records = state.records
        record = {"kind": "life", "incarnation": state.incarnation, "joining": state.joining}
        self.outbox.persist(record, durable=True, synced=True)  # action names must stay unique

    def become_active(self) -> None:
        """Take part from here on, with a vote if we are a member."""
        self.state.active = True
        self.state.amnesic = False
        self.state.torn = ()
        self.state.damage = ""
        self.outbox.persist({"kind": "active"}, durable=True)

    def forget(self, why: str, keep: bool = False) -> None:
        """Discard what we know: fetch the log from the others, then join; we have no vote before
        that. Our log gets a new id, because its earlier votes are forgotten.

        :param why: the reason, for people.
        :param keep: whether to keep the slots and discard only our votes, because we may be the
            only robot that knows a slot that we decided.
        """
        state = self.state
        self._renew_log_id()
        record: Record = {"kind": "reset", "log": state.log_id, "why": why}
        if keep:
            record["keep"] = True
        state.damage = self.config.damage if why == self.config.damage else ""
        if state.damage:
            record["damaged"] = True
        self.outbox.persist(record, durable=True, synced=True)
        if state.active or state.damage:
            self.outbox.fault("discarded its log and is fetching it again: %s" % why)
        self.robot.stop_acting()
        state.active = False
        state.amnesic = True
        state.torn = ()
        state.peers.unsure = set(state.peers.known)
        state.astray.clear()
        state.off.clear()
        if keep:
            self.log.keep_slots()
        else:
            self.log.begin_anew()
        self.proposals.drop_all("%s discarded its log: %s" % (self.config.name, why))
        self.proposer.begin_anew()
        self.robot.follow()

    def _outlive_outage(self) -> None:
        """Handle a power loss that took the end of our log: its content counts, but we may have
        made more promises and votes. Until we are readmitted, our vote counts only together with
        those of all others."""
        state = self.state
        if state.amnesic and not state.torn:
            self.forget("the machine was restarted before the team admitted this robot")
            return
        self._lose_end(
            "the machine was restarted, and the end of the log may not have reached the disk"
        )

    def trust_own_log(self) -> None:
        """Continue with the intact part of our damaged log, as ordered by the operator, since we
        are the whole team."""
        self._lose_end("the log was damaged, and the operator trusts what is left")

    def _lose_end(self, why: str) -> None:
        """Keep the content of our log, which may lack its end."""
        state = self.state
        state.damage = ""
        state.torn = (state.log_id, *state.torn)
        state.active, state.amnesic = False, True
        self._renew_log_id()
        record = {"kind": "outage", "log": state.log_id, "why": why}
        self.outbox.persist(record, durable=True, synced=True)
        self.outbox.fault("waits to be readmitted: %s" % why)

    def note_torn(self, robot: str, ids: Sequence[str]) -> None:
        """Note that a robot's machine lost power: messages that it sent before no longer count.

        :param ids: the ids of its log and of the logs that it continues.
        """
        peers = self.state.peers
        if robot == self.config.name or not ids or ids[0] in peers.dead:
            return
        if peers.torn.get(robot, ()) == tuple(ids) or len(peers.torn) >= MOST_ROBOTS:
            return
        peers.torn[robot] = tuple(ids)
        peers.dead |= set(ids[1:])
        record = {"kind": "peer", "robot": robot, "log": ids[0], "torn": list(ids[1:])}
        self.outbox.persist(record, durable=True, synced=True)

    def _renew_log_id(self) -> None:
        """Give our log a new id, so that its votes are not confused with earlier ones."""
        state = self.state
        text = "%s|%s|%r|%d" % (state.log_id, self.config.name, state.now, state.records)
        state.log_id = hashlib.sha256(text.encode()).hexdigest()[:32]

    def _halt(self, reason: str) -> None:
        self.state.halted = reason
        self.robot.stop_acting()
        self.outbox.put(interface.Halted(reason))

    def recall(self, record: Record) -> None:
        """Take over a record of our own log."""
        state, kind = self.state, record["kind"]
        if kind == "life":
            incarnation = record["incarnation"]
            if type(incarnation) is not int or incarnation < 0:
                raise ValueError("not a whole number: %.80r" % (incarnation,))
            state.incarnation = incarnation
            state.joining = bool(record.get("joining", state.joining))
        elif kind == "active":
            state.active = True
            state.amnesic = False
            state.torn = ()
            state.damage = ""
        elif kind == "outage":
            state.damage = ""
            state.torn = (state.log_id, *state.torn)
            state.active, state.amnesic = False, True
            state.log_id = str(record["log"])
        elif kind == "reset":
            state.active = False
            state.amnesic = True
            state.torn = ()
            state.damage = str(record["why"]) if "damaged" in record else ""
            state.peers.unsure = set(state.peers.known)
            state.log_id = str(record.get("log", state.log_id))
            state.off.clear()
        elif kind == "peer":
            robot = str(record["robot"])
            if "torn" in record:
                ids = [str(log) for log in record["torn"]]
                state.peers.torn[robot] = (str(record["log"]), *ids)
                state.peers.dead |= set(ids)
                return
            state.peers.known[robot] = str(record["log"])
            (state.peers.unsure.add if "unsure" in record else state.peers.unsure.discard)(robot)
        elif kind == "forced":
            robots = record["robots"]
            if isinstance(robots, dict):  # older records do not name the incarnation
                state.off = {str(robot): int(incarnation) for robot, incarnation in robots.items()}

    def recall_is_over(self) -> None:
        """Begin the next life after all records were read, without memory if necessary."""
        if self.config.damage:
            self.forget(self.config.damage, keep=self.state.ledger.length > 0)
        elif not self.config.trusted:
            self._outlive_outage()
        elif self.state.active and not self.electorate.is_our_name():
            self.forget("the team admitted another log as %s" % self.config.name, keep=True)
        self.new_life()

    # -- hello -------------------------------------------------------------------------------------

    def greet(self) -> None:
        """Send a hello, and schedule the next one."""
        state, pace = self.state, self.config.pace
        state.next_hello = state.now + (
            pace.heartbeat if state.active else min(pace.heartbeat, pace.greeting)
        )
        self._forget_guests()
        self.outbox.broadcast(self._hello())
        if not self.config.is_small:  # a busy process of the same name must not delay this
            for peer in state.peers.all.values():
                peer.surprise = None

    def _hello(self) -> Hello:
        state = self.state
        limit = self.config.plan.timing.evict_after
        silent = self.electorate.silent(limit) if limit > 0 else set()
        return Hello(
            state.begin_records,
            state.active,
            self.electorate.has_to_join(),
            state.first_hash,
            tuple(sorted(silent)),
            {robot: state.off[robot] for robot in sorted(self.electorate.asserted_off())},
            dict(state.ledger.cast_out),
            self._greetings(),
        )

    def _greetings(self) -> Dict[str, Seen]:
        """Our knowledge about the robots that need it: those that do not take part yet, or
        whose log we know differently. A working team has none, so the size of a hello does not grow
        with the team."""
        greets = {}
        for robot, peer in self.state.peers.all.items():
            if peer.surprise is not None:
                greets[robot] = Seen(self.electorate.known_log(robot), *peer.surprise)
            elif not peer.active and peer.log and len(greets) < MOST_ROBOTS:
                greets[robot] = Seen(self.electorate.known_log(robot), *peer.life)
        return greets

    def listen_anew(self) -> None:
        """Restart all measurements of silence, because we were not listening."""
        self.state.peers.listen_anew(self.state.now)

    def listened(self) -> bool:
        """Whether the time in which a fresh robot only listens has just ended."""
        state = self.state
        if not state.listen_until or state.now < state.listen_until:
            return False
        state.listen_until = 0.0
        return True

    def wake_times(self) -> List[float]:
        """When to check again (s)."""
        state = self.state
        return [state.next_hello, state.listen_until] if state.listen_until else [state.next_hello]

    def admits(self, message: Envelope) -> bool:
        """Whether to accept messages from the sender of a team message: from robots of the team,
        and from a few others, which must begin with a hello and are forgotten when they fall
        silent. The limit exists because anybody can claim any name."""
        state, sender = self.state, message.sender
        if sender in state.peers.all or self.electorate.is_of_team(sender):
            return True
        hello = message.body
        if not isinstance(hello, Hello):
            return False
        if hello.first and state.first_hash and hello.first != state.first_hash:
            self._refuse_stranger(sender, "%s has a different first team" % sender)
            return False
        return len(self._guests()) < max(GUESTS, len(self.electorate.members()))

    def _guests(self) -> List[str]:
        return [r for r in self.state.peers.all if not self.electorate.is_of_team(r)]

    def _forget_guests(self) -> None:
        """Forget robots outside the team that have fallen silent."""
        state = self.state
        for robot in self._guests():
            heard = state.peers.all[robot].heard
            if heard is None or state.now > heard + GUEST_STAY * self.config.pace.heartbeat:
                del state.peers.all[robot]
                state.astray.pop(robot, None)
                self.proposals.drop_others(robot)
                self.proposer.forget(robot)

    def hear(self, message: Envelope) -> bool:
        """Note a message of the team; returns whether its sender's votes count even in a slot that
        does not need the votes of all."""
        state, sender = self.state, message.sender
        peer = state.peers.hear(sender, state.now)
        if state.own_proposals.asking:
            self.proposals.withdraw_suspicion([sender])
        if sender in state.off:
            self._heard_though_off(sender)
        self.note_torn(sender, message.torn and (message.log, *message.torn))
        self._note_log_of(message)
        counts = self._knows(message) and not state.ledger.is_cast_out(sender)
        counts = counts and not message.torn and message.log not in state.peers.dead
        peer.length = message.length
        return counts

    def _note_log_of(self, message: Envelope) -> None:
        """Note whose log counts for a robot: the first one that we hear of. A replica that lost its
        log also lost these notes, and may hear another process of that name first. Then the process
        that takes part counts, because all robots had to know it."""
        sender, peers = message.sender, self.state.peers
        known = self.electorate.known_log(sender)
        if not known:
            if self.electorate.is_of_team(sender):
                self._note_log(sender, message.log, sure=not self.state.amnesic)
        elif sender in peers.unsure and isinstance(message.body, Hello) and message.body.active:
            self._note_log(sender, message.log, sure=True)

    def _knows(self, message: Envelope) -> bool:
        """Whether a message comes from the log whose votes count for its sender."""
        sender, peers = message.sender, self.state.peers
        peer = peers.get(sender)
        known = self.electorate.known_log(sender)
        peer.note_life(message)
        surprise, counts = None, not known or message.log == known
        if counts and known and isinstance(message.body, Hello) and message.body.active:
            peer.at_work = self.state.now
        if not counts:
            if sender not in peers.unsure or isinstance(message.body, Hello):
                surprise = Life(0, 0)
        elif Life(message.incarnation, message.records) < peer.life:
            surprise = peer.life
        elif isinstance(message.body, Hello) and message.body.begin < peer.before.records:
            surprise = peer.before
        if surprise is not None or self.config.is_small:  # small teams answer each hello at once
            peer.surprise = surprise
        return counts

    def _note_log(self, robot: str, log: str, *, sure: bool) -> None:
        peers = self.state.peers
        peers.known[robot] = log
        record: Record = {"kind": "peer", "robot": robot, "log": log}
        if sure:
            peers.unsure.discard(robot)
        else:
            peers.unsure.add(robot)
            record["unsure"] = True
        # a robot that begins without a log relies on us to know its earlier log
        self.outbox.persist(record, durable=True, synced=True)

    def on_hello(self, message: Envelope, hello: Hello) -> None:
        """Handle a hello of another robot."""
        state, pace, sender = self.state, self.config.pace, message.sender
        peer = state.peers.get(sender)
        met = peer.met
        peer.met = True
        peer.active, peer.joining = hello.active, hello.joining
        peer.silent = frozenset(hello.silent)
        peer.cast_out = hello.cast_out
        if hello.first and state.first_hash and hello.first != state.first_hash:
            self._refuse_stranger(sender, "%s was started with a different team" % sender)
            return
        if not state.active:
            for robot, incarnation in hello.off.items():
                self._note_off(robot, incarnation)
        seen = hello.greets.get(self.config.name)
        if seen is not None:
            self._hear_of_ourselves(message, seen)
        if self._ours_is_given_up(sender):
            self._forget_given_up(sender)
        self.consider_active()
        # in a large team, an answer to every hello would cause a flood: the next regular hello is
        # enough
        waits = not hello.active or peer.surprise is not None
        rested = state.now >= peer.answered + min(pace.greeting, pace.heartbeat)
        if (not met or (waits and rested)) and (self.config.is_small or self.outbox.owes_reply):
            peer.answered = state.now
            self.outbox.answer(message, self._hello())
        self._compare(message)

    def _ours_is_given_up(self, other: str) -> bool:
        """Whether another robot's log, according to its last hello, says that ours was given up."""
        ledger, theirs = self.state.ledger, self.state.peers.get(other).cast_out
        return self._is_given_up(self.config.name, ledger.cast_out, ledger.length, theirs)

    def _theirs_is_given_up(self, other: str) -> bool:
        """Whether our log says that another robot's log was given up."""
        peer = self.state.peers.get(other)
        return self._is_given_up(other, peer.cast_out, peer.length, self.state.ledger.cast_out)

    def _is_given_up(
        self, owner: str, one: Dict[str, int], length: int, other: Dict[str, int]
    ) -> bool:
        """Whether a log was given up by a forced eviction recorded in another log.

        Everything that the eviction did not give up is in both logs. So a log that continues past
        the slot of the eviction without containing it was given up, whoever was evicted: the
        evicted robots could decide alone, and admit others, before they learned of it.

        If two logs each say so of the other (operators contradicted each other), the log that
        evicts fewer robots is kept, or, if they evict equally many, the one that does not evict the
        first robot. A log with which a quorum continued is always kept, because the other evicts
        all of that quorum.

        :param owner: the robot whose log may be given up.
        :param one: the forced evictions in that log: robot -> slot of the last one.
        :param length: the number of slots of that log.
        :param other: the forced evictions in the other log.
        """
        by_one = {robot for robot, slot in one.items() if slot > other.get(robot, -1)}
        by_other = {robot for robot, slot in other.items() if slot > one.get(robot, -1)}
        if not by_one:
            # both evicted the robot, this log earlier: so the other log continued with it
            new = (robot for robot in by_other if robot == owner or robot not in one)
            return any(other[robot] < length for robot in new)
        if len(by_one) != len(by_other):
            return len(by_one) > len(by_other) > 0
        team = [r.name for r in self.config.plan.robots]
        return (
            min(by_one | by_other, key=lambda r: (team.index(r) if r in team else len(team), r))
            in by_one
        )

    def _forget_given_up(self, sender: str) -> None:
        self.forget("%s knows that it was discarded by a forced eviction" % sender)

    def _hear_of_ourselves(self, message: Envelope, seen: Seen) -> None:
        """Handle what another robot remembers about us. A robot that lost its log may have
        forgotten whom it knew, and is no witness of our start, unless nothing was decided since the
        team began: otherwise, removing a log while a team starts would block every later start."""
        state, sender = self.state, message.sender
        begun = state.ledger.length > 1
        known = self.electorate.known_log(sender)
        witness = not begun or known in (message.log, *message.torn)
        if witness:
            state.peers.get(sender).welcomes = seen.log
        if self.electorate.has_to_join():
            return
        if seen.log != state.log_id:
            if witness and state.ledger.logs.get(self.config.name) != state.log_id:
                self.forget("%s knows an older log" % sender)
            return
        ours = Life(state.incarnation, state.records)
        theirs = Life(seen.incarnation, seen.records)
        if theirs > ours or (
            theirs.incarnation < state.incarnation and theirs.records > state.begin_records
        ):
            self.forget("the log is shorter than %s remembers" % sender)

    def consider_active(self) -> None:
        """Become active once every other member of the first team confirms that our log is our
        first one, and no robot knows more than we do."""
        state = self.state
        if (
            state.active
            or state.joining
            or state.amnesic
            or state.ledger.length < 1
            or state.now < state.listen_until
            or self.electorate.has_namesake()
        ):
            return
        if self.electorate.missing_at_start():
            return
        if any(
            peer.length > state.ledger.length and peer.heard is not None
            for peer in state.peers.all.values()
        ):
            return  # do not act before we know the team's state
        if self.electorate.acted_before():
            self.forget("the team's log holds entries of ours that it does not")
            return
        self.become_active()
        team = self.electorate.members()
        fresh = state.incarnation == 0 and state.ledger.length == 1
        if team and team[0] == self.config.name and fresh and not self.config.partial:
            self.proposer.lead_from_the_start(set(team) - set(state.off))
        self.robot.act({})

    # -- diverging logs --------------------------------------------------------------------------

    def _compare(self, message: Envelope) -> None:
        """Check whether one of the two logs, the sender's and ours, is a prefix of the other."""
        if message.length > self.state.ledger.length:
            return
        known = self.state.hash_at(message.length)
        if known is None:
            return
        if known != message.hash:
            self.conflict(message.sender, message.length)
        else:
            self.state.astray.pop(message.sender, None)

    def conflict(self, other: str, slot: int) -> None:
        """Handle a difference between our log and another robot's before ``slot``."""
        state = self.state
        if state.ledger.is_cast_out(other) or other in self.electorate.asserted_off():
            return  # the operator gave up that robot's log
        if not state.active and not (state.torn and self.electorate.is_member()):
            self.forget("the log differs from that of %s" % other)
            return
        if self._ours_is_given_up(other):
            self._forget_given_up(other)
            return
        if self._theirs_is_given_up(other):
            return  # that robot discards its log once it receives our hello
        if other not in state.astray:
            state.astray[other] = slot
            self.outbox.fault(
                "the log of %s differs from ours before slot %d: one of the two is damaged; "
                "ignoring its messages" % (other, slot)
            )
        members = self.electorate.members()
        if is_quorum([m for m in members if m in state.astray], members):
            self.forget(
                "the log differs from that of a quorum (%s)" % ", ".join(sorted(state.astray))
            )

    # -- what the log says about us ----------------------------------------------------------------

    def note_members(self, items: Sequence[Item]) -> None:
        """Handle entries that are now in the log: a robot may have been admitted, perhaps under our
        name, or evicted."""
        state, me = self.state, self.config.name
        for item in items:
            entry = item.entry
            if isinstance(entry, log_entries.Join):
                robot = state.ledger.state.robots.get(entry.robot)
                taken = robot is not None and robot.incarnation == entry.incarnation
                mine = entry.robot == me and entry.log == state.log_id
                if mine and not state.active and (taken or self.config.witness):
                    self.become_active()
                elif state.active and entry.robot == me and not self.electorate.is_our_name():
                    # another process was admitted under our name: from now on its votes count, and
                    # ours do not
                    state.superseded_at, state.rival_since = state.now, None
                    self.forget("the team admitted another log as %s" % me, keep=True)
                    return
            elif isinstance(entry, log_entries.Evict) and state.ledger.is_cast_out(entry.robot):
                self.proposals.drop_others(entry.robot)

    def note_snapshot(self) -> None:
        """Handle an adopted snapshot, which may hold forced evictions and our own ``Join``."""
        state = self.state
        for name in state.ledger.cast_out:
            if state.ledger.is_cast_out(name):
                self.proposals.drop_others(name)
        robot = self.electorate.own_robot()
        if state.active or state.ledger.logs.get(self.config.name) != state.log_id:
            return
        if self.config.witness or (
            robot is not None and not robot.phase.gone and robot.incarnation <= state.incarnation
        ):
            self.become_active()

    def note_own_fate(self) -> None:
        """Check whether the new part of the log says that our robot left or was evicted."""
        state, robot = self.state, self.electorate.own_robot()
        if robot is None or not robot.phase.gone or state.ledger.state.ended is not None:
            return
        if robot.phase is Phase.LEFT and state.active and robot.incarnation == state.incarnation:
            state.leaving = True
        elif state.incarnation <= robot.incarnation:
            self.proposals.keep_orders_only()
            self.new_life()

    # -- joining, leaving --------------------------------------------------------------------------

    def want_to_join(self) -> None:
        """Get this incarnation of ours into the log."""
        state, config = self.state, self.config
        if (
            state.fenced
            or state.leaving
            or state.ledger.length == 0
            or self.electorate.is_settled()
            or self.electorate.has_namesake()
        ):
            return
        if (state.active and config.witness) or not (
            state.active or state.amnesic or state.joining
        ):
            return
        if state.superseded_at is not None:
            if state.now < state.superseded_at + RIVAL * config.pace.heartbeat:
                return  # is this a running process, or a former life of ours?
            state.superseded_at = None
        # visits in a log that was given up are repeated under new numbers
        acted = state.started is not None and state.started.incarnation == state.incarnation
        if acted or self.electorate.known_incarnation() >= state.incarnation:
            self.new_life()
        if any(
            isinstance(own.item.entry, log_entries.Join)
            and own.item.origin.incarnation == state.incarnation
            for own in state.own_proposals.asking
        ):
            return
        place = self._home()
        self.proposals.propose(
            log_entries.Join(config.name, state.incarnation, place, state.log_id)
        )

    def _home(self) -> str:
        """The place where we start when we join; "" if nothing specifies it."""
        name, ledger = self.config.name, self.state.ledger
        plan, place = ledger.game.plan, self.config.place
        if ledger.state.present_name(place) in plan.action_places:
            return place
        if ledger.state.adopted is not None:  # names of the first plan may not exist any more
            return home_of(plan, name)
        return (
            place
            or next((r.place for r in plan.robots if r.name == name), "")
            or (plan.spawn[0] if plan.spawn else "")
        )

    def part(self) -> None:
        """End after leaving, once a quorum of the remaining members knows and the tasks that
        reached us are in the log, or after a timeout. Only members' own processes count."""
        state = self.state
        members = self.electorate.members()
        themselves = [m for m in members if state.peers.get(m).log == self.electorate.known_log(m)]
        know = [m for m in themselves if state.peers.get(m).length >= state.ledger.length]
        if state.leaving_since is None:
            state.leaving_since = state.now
        lingered = state.now - state.leaving_since
        waits = not is_quorum(know, members) or self.state.offered
        if members and waits and lingered < LINGER * self.config.pace.heartbeat:
            return
        state.halted = "%s has left the team" % self.config.name
        self.outbox.put(Ended(state.halted, True))

    # -- silence -----------------------------------------------------------------------------------

    def watch(self) -> None:
        """Look for robots that seem lost, and check whether we have lost contact ourselves."""
        state, timing = self.state, self.config.plan.timing
        members = self.electorate.members()
        if not self.electorate.may_vote() or state.ledger.state.ended is not None:
            state.fenced = False
            return
        if timing.fence_after > 0:
            self._fence(not is_quorum(self.electorate.heard_within(timing.fence_after), members))
        if timing.evict_after > 0:
            silent = self.electorate.silent(timing.evict_after)
            own = state.own_proposals.asking
            self.proposals.withdraw_suspicion(
                o.suspect for o in own if o.suspect and o.suspect not in silent
            )
            accused = {o.suspect for o in state.own_proposals.asking}
            for robot in sorted(silent - accused):
                known = state.ledger.state.robots.get(robot)
                jury = state.peers.accusers(robot) | {self.config.name}
                if known is not None and is_quorum(jury, members):
                    self.proposals.propose(
                        log_entries.Evict(robot, known.incarnation), suspect=robot
                    )

    def _fence(self, fenced: bool) -> None:
        if fenced == self.state.fenced or self.config.witness:
            return
        self.state.fenced = fenced
        if fenced:
            self.robot.stop_acting()
            limit = self.config.plan.timing.fence_after
            self.outbox.fault("stopped: no contact with a quorum for %g s" % limit)
        elif self.electorate.is_settled():
            self.new_life()  # the action restarts

    # -- robots that are off -----------------------------------------------------------------------

    def evict_by_force(self, order: log_entries.Evict, order_id: str) -> None:
        """Propose the eviction of a robot that an operator asserts to be off."""
        self._assert_off(order.robot, order.incarnation)
        self.consider_active()
        self.proposer.abandon()
        self.proposals.propose(order, order_id)
        warning = self._what_is_given_up()
        if warning:
            self.outbox.fault(warning)

    def _what_is_given_up(self) -> str:
        """Describe what knowledge is lost if these robots are evicted as switched off."""
        members, off = self.electorate.members(), self.electorate.asserted_off()
        left = [m for m in members if m not in off]
        if not left or is_quorum(left, members):
            return ""
        return (
            "%s could have made decisions without the others; what only they know will be lost. "
            "Keep them switched off until they are evicted, which requires the consent of all "
            "others (%s)" % (", ".join(m for m in members if m in off), ", ".join(left))
        )

    def _note_off(self, robot: str, incarnation: int) -> None:
        """Note that an operator asserted elsewhere that a robot is off."""
        state = self.state
        known = state.ledger.state.robots.get(robot)
        if (
            robot == self.config.name
            or known is None
            or known.phase.gone
            or known.incarnation != incarnation
        ):
            return
        if state.off.get(robot) != incarnation and state.peers.get(robot).heard is None:
            self._assert_off(robot, incarnation)

    def _assert_off(self, robot: str, incarnation: int) -> None:
        self.state.off[robot] = incarnation
        self._persist_off()

    def _persist_off(self) -> None:
        state = self.state
        record = {"kind": "forced", "slot": state.ledger.length, "robots": dict(state.off)}
        self.outbox.persist(record, durable=True, synced=True)

    def _heard_though_off(self, robot: str) -> None:
        """Handle a message from a robot that was asserted to be off: the assertion was wrong, or no
        longer holds."""
        was = robot in self.electorate.asserted_off()
        if was:  # withdraw first: if we crash in between, the robot's next message leads here again
            self.proposals.withdraw_forced_evictions(
                robot, "%s is not off: a message from it has just arrived" % robot
            )
        del self.state.off[robot]
        self._persist_off()
        if not was:
            return
        self.proposer.abandon()
        self.outbox.fault("%s was declared off but still sends messages; not evicting it" % robot)

    # -- processes that do not belong here ---------------------------------------------------------

    def hear_own_name(self, message: Envelope) -> None:
        """Handle a message in our name: from another process, or our own one coming back."""
        state, body = self.state, message.body
        if message.team != self.config.tag or not isinstance(body, Hello):
            return
        same = message.log == state.log_id
        if not same:
            self._meet_namesake(body)
        both = not same and body.active and state.active
        if message.incarnation > state.incarnation and (same or both):
            self._halt("another process runs as %s and was started later" % self.config.name)
        elif state.superseded_at is not None and not same:
            if self._rival_stays():
                self._halt(
                    "another process runs as %s and was admitted after this one" % self.config.name
                )
        elif both and message.incarnation == state.incarnation:
            # a one-robot team running twice: both may decide alone, so one has to halt; since logs
            # only grow, not both of them do
            ours = (state.ledger.length, state.log_id)
            if (message.length, message.log) > ours and self._rival_stays():
                self._halt("another process runs as %s and has a longer log" % self.config.name)

    def _meet_namesake(self, hello: Hello) -> None:
        """Handle a hello from another process of our name: if one of us is in the team, the other
        waits, and must learn of it before it takes part."""
        state, pace = self.state, self.config.pace
        rested = state.now >= state.namesake_answered + min(pace.greeting, pace.heartbeat)
        if hello.active and not state.active:
            state.namesake_heard = state.now
        elif state.active and not hello.active and rested:
            state.namesake_answered = state.now
            self.outbox.broadcast(self._hello())

    def _rival_stays(self) -> bool:
        """Whether a process of our name was heard repeatedly, since a delayed message arrives only
        once."""
        state = self.state
        if state.rival_since is None:
            state.rival_since = state.now
        return state.now - state.rival_since > 1.5 * self.config.pace.heartbeat

    def hear_stranger(self, message: Envelope) -> None:
        """Handle a message of another run or plan."""
        run, _, plan = message.team.rpartition("|")
        if run == self.config.run and plan != self.config.plan.hash()[:12]:
            self._refuse_stranger(message.sender, "%s has a different plan" % message.sender)

    def _refuse_stranger(self, sender: str, what: str) -> None:
        if sender in self.state.strangers or len(self.state.strangers) >= MOST_COMPLAINTS:
            return
        self.state.strangers.add(sender)
        plan = self.config.plan
        if not self.state.active and plan.robots and sender in [r.name for r in plan.robots]:
            self._halt("%s (run '%s'); give all robots the same plan" % (what, self.config.run))
        else:
            self.outbox.fault("%s (run '%s'); it is not admitted" % (what, self.config.run))

    def refuse_message(self, data: object, why: str) -> None:
        """Count a malformed message, and report the first one of each sender."""
        complaints = self.state.complaints
        sender = data.get("from") if isinstance(data, dict) else None
        sender = sender[:100] if isinstance(sender, str) else "somebody"
        if sender == self.config.name:
            return
        if (sender, why) not in complaints:
            if len(complaints) >= MOST_COMPLAINTS:
                sender, why = OTHERS
            else:
                self.outbox.fault("malformed message from %s: %s" % (sender, why))
        complaints[sender, why] = complaints.get((sender, why), 0) + 1
