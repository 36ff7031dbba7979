"""Who takes part: how replicas get to know each other, join, leave, are evicted, and lose and
regain the right to vote.

Owns who we are (log id, incarnation, whether we are active, amnesic, fenced, leaving, halted) and
what is known of the others (peers, who is off, astray or a stranger, and for how long a fresh robot
listens): the fields of membership in
:class:`~gspn_framework_package.execution.agreement.state.ReplicaState`. Proposes joins and
evictions, makes the proposer give up its attempts and the local robot stop or act, and lets the log
begin anew.
"""

from __future__ import annotations

import hashlib
from typing import Dict, List, Protocol, Sequence

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.config import Config
from gspn_framework_package.execution.agreement.electorate import Electorate
from gspn_framework_package.execution.agreement.local_robot import LocalRobot
from gspn_framework_package.execution.agreement.messages import MOST_ROBOTS, Envelope, Hello, Seen
from gspn_framework_package.execution.agreement.outbox import Outbox
from gspn_framework_package.execution.agreement.peers import Life
from gspn_framework_package.execution.agreement.proposals import ProposalQueue
from gspn_framework_package.execution.agreement.proposer import Proposer
from gspn_framework_package.execution.agreement.quorum import is_quorum
from gspn_framework_package.execution.agreement.state import ReplicaState
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.firing import Ended
from gspn_framework_package.execution.ledger import Item
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.plan_change import home_of

RIVAL = 4
"""Heartbeats for which a robot whose place another log has taken listens for a second process of
its name, before it wants its place back."""

MOST_COMPLAINTS = 100
"""Kinds of messages that were not understood, which are counted apart."""

OTHERS = ("others", "not understood")
"""As what further kinds are counted."""

GUESTS = 16
"""Robots that are not in the team, as far as we know, to which we listen at once."""

GUEST_STAY = 4
"""Heartbeats of silence after which such a robot is forgotten."""

LINGER = 20
"""Heartbeats for which a leaving robot waits for a quorum of the others to hear of it."""


class MembershipLog(Protocol):
    """What membership needs of the replicated log."""

    def begin_anew(self) -> None:
        """Forget all slots."""

    def keep_slots(self) -> None:
        """Begin a new memory with all slots."""


class Membership:
    """Sends hellos, receives them, and acts on them."""

    def __init__(
        self,
        config: Config,
        state: ReplicaState,
        outbox: Outbox,
        electorate: Electorate,
        proposals: ProposalQueue,
        proposer: Proposer,
        robot: LocalRobot,
    ) -> None:
        self.config = config
        self.state = state
        self.outbox = outbox
        self.electorate = electorate
        self.proposals = proposals
        self.proposer = proposer
        self.robot = robot
        self.log: MembershipLog

    def connect(self, log: MembershipLog) -> None:
        """Set the log that begins anew where what we know does not count."""
        self.log = log

    # -- incarnations and memory -------------------------------------------------------------------

    def begin_first_life(self) -> None:
        """Our log is new: listen before taking part, since another robot may know our name."""
        state, pace = self.state, self.config.pace
        self._note_life()
        state.listen_until = state.now + min(pace.greeting, pace.heartbeat)

    def new_life(self) -> None:
        """We restart or come back: a new incarnation, which the log must hear of."""
        self.state.incarnation = (
            max(self.state.incarnation, self.electorate.known_incarnation()) + 1
        )
        self.proposals.begin_life()
        self._note_life()

    def _note_life(self) -> None:
        state = self.state
        state.begin_records = state.records
        record = {"kind": "life", "incarnation": state.incarnation, "joining": state.joining}
        self.outbox.persist(record, durable=True, synced=True)  # no two actions have one name

    def become_active(self) -> None:
        """Take part from here on, with a vote if we are a member."""
        self.state.active = True
        self.state.amnesic = False
        self.state.torn = ()
        self.state.damage = ""
        self.outbox.persist({"kind": "active"}, durable=True)

    def forget(self, why: str, keep: bool = False) -> None:
        """Discard what we know: learn the log from the others, then join; until then we have no
        vote. Our log gets a new id, because its earlier votes are forgotten.

        :param why: the reason, for people.
        :param keep: whether to keep the slots and discard only our votes, because perhaps no other
            robot knows yet a slot that we decided.
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
            self.outbox.fault("discards its log and fetches it again: %s" % why)
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
        self.proposals.drop_all("%s forgot its log: %s" % (self.config.name, why))
        self.proposer.begin_anew()
        self.robot.follow()

    def _outlive_outage(self) -> None:
        """The machine lost power, and the end of our log with it: what it holds counts, but we may
        have promised and voted more. Until we are let in, our vote counts only beside those of all
        others."""
        state = self.state
        if state.amnesic and not state.torn:
            self.forget("the machine was restarted before the team let it in")
            return
        self._lose_end(
            "the machine was restarted, and the end of the log may not have reached the disk"
        )

    def trust_own_log(self) -> None:
        """We are the whole team, and our log was damaged: the operator has us go on with what is
        whole."""
        self._lose_end("its log was damaged, and the operator trusts what is left")

    def _lose_end(self, why: str) -> None:
        """What our log holds counts, but it may lack its end."""
        state = self.state
        state.damage = ""
        state.torn = (state.log_id, *state.torn)
        state.active, state.amnesic = False, True
        self._renew_log_id()
        record = {"kind": "outage", "log": state.log_id, "why": why}
        self.outbox.persist(record, durable=True, synced=True)
        self.outbox.fault("waits to be let in again: %s" % why)

    def note_torn(self, robot: str, ids: Sequence[str]) -> None:
        """A robot's machine lost power: what it sent before does not count any more.

        :param ids: the ids of its log, and of those that it goes on from.
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
        """From here on our log is another memory: its votes must not be confused with those of the
        one before."""
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
        """All records were read: begin the next life, without memory if necessary."""
        if self.config.damage:
            self.forget(self.config.damage, keep=self.state.ledger.length > 0)
        elif not self.config.trusted:
            self._outlive_outage()
        elif self.state.active and not self.electorate.is_our_name():
            self.forget("another log was let in as %s" % self.config.name, keep=True)
        self.new_life()

    # -- hello -------------------------------------------------------------------------------------

    def greet(self) -> None:
        """Send a hello, and set when the next one is due."""
        state, pace = self.state, self.config.pace
        state.next_hello = state.now + (
            pace.heartbeat if state.active else min(pace.heartbeat, pace.greeting)
        )
        self._forget_guests()
        self.outbox.broadcast(self._hello())
        if not self.config.is_small:  # a busy namesake must not keep us from saying it
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
        """What we know of the robots that need it: those that do not take part yet, or that would
        be surprised. A team at work has none, so a hello does not grow with the team."""
        greets = {}
        for robot, peer in self.state.peers.all.items():
            if peer.surprise is not None:
                greets[robot] = Seen(self.electorate.known_log(robot), *peer.surprise)
            elif not peer.active and peer.log and len(greets) < MOST_ROBOTS:
                greets[robot] = Seen(self.electorate.known_log(robot), *peer.life)
        return greets

    def listen_anew(self) -> None:
        """We were not listening: no silence counts so far."""
        self.state.peers.listen_anew(self.state.now)

    def listened(self) -> bool:
        """Whether the time in which a fresh robot only listens ends just now."""
        state = self.state
        if not state.listen_until or state.now < state.listen_until:
            return False
        state.listen_until = 0.0
        return True

    def wake_times(self) -> List[float]:
        """When to look again (s)."""
        state = self.state
        return [state.next_hello, state.listen_until] if state.listen_until else [state.next_hello]

    def admits(self, message: Envelope) -> bool:
        """Whether to listen to the sender of a message of the team: to a robot of the team; and to
        a few others, which begin with a hello, and are forgotten when they fall silent. Anybody
        can say any name."""
        state, sender = self.state, message.sender
        if sender in state.peers.all or self.electorate.is_of_team(sender):
            return True
        hello = message.body
        if not isinstance(hello, Hello):
            return False
        if hello.first and state.first_hash and hello.first != state.first_hash:
            self._refuse_stranger(sender, "%s has another first team" % sender)
            return False
        return len(self._guests()) < max(GUESTS, len(self.electorate.members()))

    def _guests(self) -> List[str]:
        return [r for r in self.state.peers.all if not self.electorate.is_of_team(r)]

    def _forget_guests(self) -> None:
        """Forget those who are not in the team and have fallen silent."""
        state = self.state
        for robot in self._guests():
            heard = state.peers.all[robot].heard
            if heard is None or state.now > heard + GUEST_STAY * self.config.pace.heartbeat:
                del state.peers.all[robot]
                state.astray.pop(robot, None)
                self.proposals.drop_others(robot)
                self.proposer.forget(robot)

    def hear(self, message: Envelope) -> bool:
        """Note that a message of the team came in; returns whether its sender's votes count, also
        in a slot that does not need the votes of all."""
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
        """Note the log of a robot whose votes count: the first one that we hear of. Whoever lost
        its log lost what it had noted, and may first hear another process of that name. The one
        that takes part is the one that counts: all had to know it."""
        sender, peers = message.sender, self.state.peers
        known = self.electorate.known_log(sender)
        if not known:
            if self.electorate.is_of_team(sender):
                self._note_log(sender, message.log, sure=not self.state.amnesic)
        elif sender in peers.unsure and isinstance(message.body, Hello) and message.body.active:
            self._note_log(sender, message.log, sure=True)

    def _knows(self, message: Envelope) -> bool:
        """Whether the log that a message speaks for is the one whose votes count."""
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
        # whoever begins without a log relies on it that we would know another one
        self.outbox.persist(record, durable=True, synced=True)

    def on_hello(self, message: Envelope, hello: Hello) -> None:
        """Another announces itself."""
        state, pace, sender = self.state, self.config.pace, message.sender
        peer = state.peers.get(sender)
        met = peer.met
        peer.met = True
        peer.active, peer.joining = hello.active, hello.joining
        peer.silent = frozenset(hello.silent)
        peer.cast_out = hello.cast_out
        if hello.first and state.first_hash and hello.first != state.first_hash:
            self._refuse_stranger(sender, "%s started with a different team" % sender)
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
        # in a large team, answers to everybody's greetings would flood it: the next hello is
        # enough
        waits = not hello.active or peer.surprise is not None
        rested = state.now >= peer.answered + min(pace.greeting, pace.heartbeat)
        if (not met or (waits and rested)) and (self.config.is_small or self.outbox.owes_reply):
            peer.answered = state.now
            self.outbox.answer(message, self._hello())
        self._compare(message)

    def _ours_is_given_up(self, other: str) -> bool:
        """Whether another's log, as it last said hello, says that ours was given up."""
        ledger, theirs = self.state.ledger, self.state.peers.get(other).cast_out
        return self._is_given_up(self.config.name, ledger.cast_out, ledger.length, theirs)

    def _theirs_is_given_up(self, other: str) -> bool:
        """Whether our log says that another's was given up."""
        peer = self.state.peers.get(other)
        return self._is_given_up(other, peer.cast_out, peer.length, self.state.ledger.cast_out)

    def _is_given_up(
        self, owner: str, one: Dict[str, int], length: int, other: Dict[str, int]
    ) -> bool:
        """Whether one log was given up in an eviction by force that is in another one.

        All that the eviction did not give up is in both logs. So a log that goes on past its slot
        without it was given up, whoever was evicted: the robots that are off could decide alone
        before they heard of it, and let others in.

        If two logs each say so of the other (operators contradicted each other), the one that
        evicts fewer is kept, else the one that does not evict the first robot. A log that a quorum
        went on with is always kept, because the other evicts all of that quorum.

        :param owner: the robot whose log may be given up.
        :param one: the evictions by force of that log: robot -> slot of the last.
        :param length: the slots of that log.
        :param other: the evictions by force of the other log.
        """
        by_one = {robot for robot, slot in one.items() if slot > other.get(robot, -1)}
        by_other = {robot for robot, slot in other.items() if slot > one.get(robot, -1)}
        if not by_one:
            # a robot that both evicted, earlier in the one: it is the other that went on with it
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
        """What another remembers of us. One that lost its log may have forgotten whom it knew, and
        is no witness of our start, unless nothing was decided since the team began: whoever removes
        logs while a team starts would have to help all that start later."""
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
                self.forget("%s knows an older one" % sender)
            return
        ours = Life(state.incarnation, state.records)
        theirs = Life(seen.incarnation, seen.records)
        if theirs > ours or (
            theirs.incarnation < state.incarnation and theirs.records > state.begin_records
        ):
            self.forget("it is shorter than %s remembers" % sender)

    def consider_active(self) -> None:
        """Become active once every other member of the first team knows our log as the first one
        that we have, and nobody knows more than we do."""
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
            return  # do not act before we know where the team is
        if self.electorate.acted_before():
            self.forget("the team's log holds entries of ours that it does not")
            return
        self.become_active()
        team = self.electorate.members()
        fresh = state.incarnation == 0 and state.ledger.length == 1
        if team and team[0] == self.config.name and fresh and not self.config.partial:
            self.proposer.lead_from_the_start(set(team) - set(state.off))
        self.robot.act({})

    # -- logs that differ --------------------------------------------------------------------------

    def _compare(self, message: Envelope) -> None:
        """Check whether the sender's log begins as ours does, or ours as its."""
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
        """Our log differs from another's before ``slot``."""
        state = self.state
        if state.ledger.is_cast_out(other) or other in self.electorate.asserted_off():
            return  # the operator gave up what that robot knows
        if not state.active and not (state.torn and self.electorate.is_member()):
            self.forget("it differs from that of %s" % other)
            return
        if self._ours_is_given_up(other):
            self._forget_given_up(other)
            return
        if self._theirs_is_given_up(other):
            return  # it forgets, once it hears our hello
        if other not in state.astray:
            state.astray[other] = slot
            self.outbox.fault(
                "the log of %s differs from ours before slot %d: one of them is damaged; its "
                "messages are ignored" % (other, slot)
            )
        members = self.electorate.members()
        if is_quorum([m for m in members if m in state.astray], members):
            self.forget("it differs from that of a quorum (%s)" % ", ".join(sorted(state.astray)))

    # -- what the log says about us ----------------------------------------------------------------

    def note_members(self, items: Sequence[Item]) -> None:
        """These entries are in the log now: somebody may have been let in, perhaps as us, or cast
        out."""
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
                    # somebody was let in under our name: from here on its votes count, and ours do
                    # not
                    state.superseded_at, state.rival_since = state.now, None
                    self.forget("another log was let in as %s" % me, keep=True)
                    return
            elif isinstance(entry, log_entries.Evict) and state.ledger.is_cast_out(entry.robot):
                self.proposals.drop_others(entry.robot)

    def note_snapshot(self) -> None:
        """We adopted a snapshot, which may hold forced evictions and our own ``Join``."""
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
        """The log has grown: check whether it says that our robot left, or was evicted."""
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
        """Make the log learn this incarnation of ours."""
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
                return  # is it somebody who runs, or a former life of ours?
            state.superseded_at = None
        # visits that were made in a log that was given up are made again, and not under their names
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
        """Where we start when we join; "" where nothing says it."""
        name, ledger = self.config.name, self.state.ledger
        plan, place = ledger.game.plan, self.config.place
        if ledger.state.present_name(place) in plan.action_places:
            return place
        if ledger.state.adopted is not None:  # the names of the first plan may mean nothing now
            return home_of(plan, name)
        return (
            place
            or next((r.place for r in plan.robots if r.name == name), "")
            or (plan.spawn[0] if plan.spawn else "")
        )

    def part(self) -> None:
        """We have left: end once a quorum of those who stay knows and the tasks that reached us are
        in the log, or after a while. What another process of a robot knows does not count."""
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
        """Look for robots that seem lost, and check whether we are out of contact ourselves."""
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
            self.outbox.fault("had no contact with a quorum for %g s: stops" % limit)
        elif self.electorate.is_settled():
            self.new_life()  # its action is restarted

    # -- robots that are off -----------------------------------------------------------------------

    def evict_by_force(self, order: log_entries.Evict, order_id: str) -> None:
        """An operator asserts that a robot is off: propose its eviction."""
        self._assert_off(order.robot, order.incarnation)
        self.consider_active()
        self.proposer.abandon()
        self.proposals.propose(order, order_id)
        warning = self._what_is_given_up()
        if warning:
            self.outbox.fault(warning)

    def _what_is_given_up(self) -> str:
        """What follows from the assertions that some robots are off for what they know."""
        members, off = self.electorate.members(), self.electorate.asserted_off()
        left = [m for m in members if m not in off]
        if not left or is_quorum(left, members):
            return ""
        return (
            "%s could have decided without the others: what only they know is lost. Keep them "
            "switched off until they are evicted, which needs the consent of all others (%s)"
            % (", ".join(m for m in members if m in off), ", ".join(left))
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
        """A robot that was asserted to be off is heard: the assertion was wrong, or has ended."""
        was = robot in self.electorate.asserted_off()
        if was:  # withdraw first: if we crash in between, we hear the robot again
            self.proposals.withdraw_forced_evictions(
                robot, "%s is not off: a message from it has just arrived" % robot
            )
        del self.state.off[robot]
        self._persist_off()
        if not was:
            return
        self.proposer.abandon()
        self.outbox.fault(
            "%s was declared off, but still sends messages: it is not evicted" % robot
        )

    # -- who does not belong here ------------------------------------------------------------------

    def hear_own_name(self, message: Envelope) -> None:
        """Another process runs under our name, or our own message came back."""
        state, body = self.state, message.body
        if message.team != self.config.tag or not isinstance(body, Hello):
            return
        same = message.log == state.log_id
        if not same:
            self._meet_namesake(body)
        both = not same and body.active and state.active
        if message.incarnation > state.incarnation and (same or both):
            self._halt("another process runs as %s and started later" % self.config.name)
        elif state.superseded_at is not None and not same:
            if self._rival_stays():
                self._halt(
                    "another process runs as %s and was let in after this one" % self.config.name
                )
        elif both and message.incarnation == state.incarnation:
            # the only robot of a team, twice: both may decide alone, so one has to go; its log only
            # grows, so that never both do
            ours = (state.ledger.length, state.log_id)
            if (message.length, message.log) > ours and self._rival_stays():
                self._halt("another process runs as %s and has a longer log" % self.config.name)

    def _meet_namesake(self, hello: Hello) -> None:
        """Another process of our name is there: if one of us is in the team, the other waits, and
        has to hear of it before it takes part."""
        state, pace = self.state, self.config.pace
        rested = state.now >= state.namesake_answered + min(pace.greeting, pace.heartbeat)
        if hello.active and not state.active:
            state.namesake_heard = state.now
        elif state.active and not hello.active and rested:
            state.namesake_answered = state.now
            self.outbox.broadcast(self._hello())

    def _rival_stays(self) -> bool:
        """Whether a process of our name was heard for a while: a late message comes only once."""
        state = self.state
        if state.rival_since is None:
            state.rival_since = state.now
        return state.now - state.rival_since > 1.5 * self.config.pace.heartbeat

    def hear_stranger(self, message: Envelope) -> None:
        """A message of another run, or of another plan."""
        run, _, plan = message.team.rpartition("|")
        if run == self.config.run and plan != self.config.plan.hash()[:12]:
            self._refuse_stranger(message.sender, "%s has another plan" % message.sender)

    def _refuse_stranger(self, sender: str, what: str) -> None:
        if sender in self.state.strangers or len(self.state.strangers) >= MOST_COMPLAINTS:
            return
        self.state.strangers.add(sender)
        plan = self.config.plan
        if not self.state.active and plan.robots and sender in [r.name for r in plan.robots]:
            self._halt("%s (run '%s'); give all robots the same plan" % (what, self.config.run))
        else:
            self.outbox.fault("%s (run '%s'); it is not let in" % (what, self.config.run))

    def refuse_message(self, data: object, why: str) -> None:
        """Count a message that we do not understand, and report the first of each sender."""
        complaints = self.state.complaints
        sender = data.get("from") if isinstance(data, dict) else None
        sender = sender[:100] if isinstance(sender, str) else "somebody"
        if sender == self.config.name:
            return
        if (sender, why) not in complaints:
            if len(complaints) >= MOST_COMPLAINTS:
                sender, why = OTHERS
            else:
                self.outbox.fault("a message from %s cannot be read: %s" % (sender, why))
        complaints[sender, why] = complaints.get((sender, why), 0) + 1
