"""The agreement core: one robot's replica of the log, as a pure step function.

:class:`Replica` takes inputs and returns effects
(:mod:`~gspn_framework_package.execution.agreement.interface`). It holds together

- the *ledger*: the log so far, the state of the team, the hash chain;
- the *pool*: facts that wait to get into the log;
- the *consensus*: Paxos for the first open slot;
- the *peers*: who was heard when, who seems lost;
- the *own robot*: where it is and what it does, private moves included.

Protocol, assumptions and a sketch of the proof are in ``docs/agreement.md``.
"""

from __future__ import annotations

from typing import Any, Dict, List

from gspn_framework_package.execution.agreement import interface as io
from gspn_framework_package.execution.agreement import messages
from gspn_framework_package.execution.agreement.core import Limits, Pace
from gspn_framework_package.execution.agreement.pacing import Pacing
from gspn_framework_package.execution.agreement.quorum import is_quorum
from gspn_framework_package.execution.team_state import GONE, RobotState

__all__ = ["Limits", "Pace", "Replica"]


class Replica(Pacing):
    """One robot's (or witness's) replica.

    :param plan: a validated plan; its robots and witnesses are the first team.
    :param robot: our name.
    :param run: name of the run; messages of other runs are ignored.
    :param log_id: id of our log, from its header.
    :param records: the records of our log, in order; empty where it is new.
    :param joining: we are not in the first team (or it has started long ago): learn the log from
        the others, then join.
    :param place: where we come in when we join for the first time; default: our place in the plan,
        else the first of ``spawn``.
    :param pace: times of the protocol, for a team of few.
    :param limits: sizes of the protocol.
    :param trusted: the end of our log is there. Where it may be lost (the machine was started anew,
        and the log was not written through to the disk), what is left is not trusted, and the robot
        joins as one that lost its log.
    :raises LogError: the records contradict each other or the plan.
    """

    def start(self, now: float) -> List[io.Effect]:
        """Begin (once, before any :meth:`step`)."""
        self._now = now
        self._started = True
        self.peers.listen_anew(now)
        if self._records:
            self._resume(self._records)
        else:
            self._note_life()
            self._listen_until = now + min(self.pace.greeting, self.pace.heartbeat)
            if not self.joining:
                self._begin()
        self._records = []
        self._consider_active()
        self._settle()
        return self._flush()

    def step(self, given: io.Input, now: float) -> List[io.Effect]:
        """Take one input; the effects are to be carried out in order.

        :param now: monotonic clock, s.
        """
        if now - self._now > 4 * self.pace.heartbeat:
            self.peers.listen_anew(now)  # suspended, or starved: nobody's silence counts
        self._now = now
        if isinstance(given, io.Received):
            self._request = given.request_id
        if self.halted is None:
            self._take(given)
            self._settle()
        elif isinstance(given, (io.Order, io.ForceEvict)):
            self._put(io.OrderResult(given.order_id, False, self.halted))
        if self._request:
            self._put(io.Reply(self._request, {}))
            self._request = ""
        return self._flush()

    def _take(self, given: io.Input) -> None:
        if isinstance(given, io.Received):
            self._receive(given.message)
        elif isinstance(given, (io.ActionDone, io.ActionFailed)):
            self._action_ended(given)
        elif isinstance(given, io.Order):
            self._order(given)
        elif isinstance(given, io.ForceEvict):
            self._force_evict(given)

    def _settle(self) -> None:
        """Do what is due, and say when to look again."""
        if self.halted is None:
            if self._listen_until and self._now >= self._listen_until:
                self._listen_until = 0.0
                self._consider_active()
                held, self._held = self._held, []
                for order in held:
                    self._order(order)
            if self._now >= self._next_hello:
                self._next_hello = self._now + (
                    self.pace.heartbeat if self.active else min(self.pace.heartbeat, self.pace.greeting)
                )
                self._put(io.Send(io.EVERYBODY, self._signed(self._hello())))
                self._consider_active()
                self._watch()
                self._tell_status()
            if self.leaving:
                self._part()
            elif self.ledger.state.ended is None:
                self._want_to_join()
                self._want_environment()
            self._drive()
        self._put(io.WakeAt(self._wake_at()))

    # -- messages -------------------------------------------------------------------------------------

    def _receive(self, data: Any) -> None:
        try:
            message = messages.parse(data)
        except messages.MessageError as error:
            self._refuse_message(data, str(error))
            return
        sender, body = message.sender, message.body
        if sender == self.name:
            self._hear_own_name(message)
            return
        if message.team != self._tag:
            self._hear_stranger(message)
            return
        peer = self.peers.hear(sender, self._now)
        if self.pool.own:
            self.pool.withdraw_suspicion([sender])
        if sender in self.off:
            self._heard_though_off(sender)
        counts = self._knows(message) and not self.ledger.is_cast_out(sender)
        peer.length = message.length
        if isinstance(body, messages.Hello):
            self._on_hello(message, body)
        elif isinstance(body, messages.Pull):
            self._on_pull(message)
        elif isinstance(body, messages.Event):
            self.add_foreign(self._not_given_up(message, body.items))
            (self._voteless.discard if body.vote else self._voteless.add)(sender)
            if message.length < self.ledger.length:
                self._help(message)
        elif isinstance(body, messages.Learn):
            if self._can_teach(sender):
                self._on_learn(message, body)
        elif self.ledger.is_cast_out(sender):
            return  # what it knows was given up, until it joins again
        elif counts or (isinstance(body, messages.Promise) and not body.vote):
            self._on_vote(message)
        if self.halted is None and peer.length > self.ledger.length and self._can_teach(sender):
            self._pull(sender)

    def _on_vote(self, message: messages.Envelope) -> None:
        """A message of the consensus, of a robot whose memory counts."""
        body = message.body
        if isinstance(body, messages.Prepare):
            self.consensus.on_prepare(message, body)
            if self.consensus.promised == body.ballot:
                self._give_way()
        elif isinstance(body, messages.Accept):
            self.consensus.on_accept(message, body)
        elif isinstance(body, messages.Promise):
            self.consensus.on_promise(message, body, self._now)
        elif isinstance(body, messages.Accepted):
            self.consensus.on_accepted(message, body, self._now)
        elif isinstance(body, messages.Nack) and self.consensus.on_nack(body):
            self._defeats += 1
            self._give_way()

    def _refuse_message(self, data: Any, why: str) -> None:
        """Tell once of each sender that we do not understand it."""
        sender = data.get("from") if isinstance(data, dict) else None
        sender = sender[:100] if isinstance(sender, str) else "somebody"
        if sender != self.name and len(self._complaints) < 100 and (sender, why) not in self._complaints:
            self._complaints.add((sender, why))
            self._fault("a message of %s is not understood: %s" % (sender, why))

    # -- telling --------------------------------------------------------------------------------------

    def _tell_status(self) -> None:
        text = self.waits_for()
        if text != self._text:
            self._text = text
            if text:
                self._put(io.StatusChanged(text))

    def waits_for(self) -> str:
        """What this replica (not its action) waits for, for people; "" if for nothing."""
        if self.halted is not None:
            return "halted: " + self.halted
        if self.ledger.length == 0:
            return "waits for somebody of the team"
        if not self.active and not self.joining and not self.forgetful:
            missing = [
                m for m in self.others() if m not in self.off and self.peers.get(m).welcomes != self.log_id
            ]
            return "waits for %s to start" % ", ".join(missing)
        if self.ledger.state.ended is not None:
            return ""
        if not self.witness and not self.is_settled():
            return "waits to be let into the team" + self._nobody_left()
        if self.fenced:
            return "stopped: no contact to a quorum"
        if self.astray:
            return "the log differs from that of %s; what differs does not count" % ", ".join(sorted(self.astray))
        attempt = self.consensus.attempt
        if attempt is not None and attempt.tries > 1:
            voteless = [m for m in self.others() if not self.peers.get(m).active]
            missing = [m for m in self.consensus.missing() if m not in voteless]
            if missing or not voteless:
                return "waits for an answer of %s" % ", ".join(missing)
            return "has no quorum; without a vote: %s" % ", ".join(voteless) + self._nobody_left()
        if self.is_stuck():
            voteless = [m for m in self.others() if not self.peers.get(m).active]
            return "has no quorum; without a vote: %s" % ", ".join(voteless) + self._nobody_left()
        if not self.has_quorum():
            return "has no quorum; silent: %s" % ", ".join(self._silent())
        if self.partial and self._wants() and self._silent():  # whose attempt it is changes all the time
            return "waits for an answer of %s" % ", ".join(self._silent())
        return ""

    def is_stuck(self) -> bool:
        """Whether the team can never go on by itself: of too many members the logs, and with them
        the votes, are lost."""
        if self.ledger.length == 0 or self.ledger.state.ended is not None or (self.joining and not self.active):
            return False
        members = self.members()
        here = [m for m in members if m == self.name or self.peers.get(m).heard is not None]
        silent = [m for m in members if m not in here]
        voters = [m for m in here if (self.active if m == self.name else self.peers.get(m).active)]
        started = any(self.peers.get(m).length > 1 for m in here) or self.ledger.length > 1
        return started and not is_quorum([*voters, *silent], members) and not self.may_decide(voters)

    def _nobody_left(self) -> str:
        if not self.is_stuck():
            return ""
        return ": too many lost their logs, and those who remember are no quorum; force_evict those who do not"

    def status(self) -> Dict[str, Any]:
        """Everything a person may ask, as a JSON object (ages in s)."""
        state = self.ledger.state
        robots = []
        for robot in state.robots.values():
            mine = robot.name == self.name
            at = self.own.position if mine else None
            heard = self.peers.get(robot.name).heard
            robots.append(
                {
                    "robot": robot.name,
                    "place": self.plan.net.places[at.place if at else robot.place].name,
                    "state": self._state_of(robot),
                    "incarnation": robot.incarnation,
                    "visit": at.visit if at else robot.visit,
                    "attempt": at.attempt if at else robot.attempt,
                    "log_length": self.ledger.length if mine else self.peers.get(robot.name).length,
                    "last_contact": 0.0 if mine else (None if heard is None else round(self._now - heard, 3)),
                    "waits_for": self.ledger.game.why_waiting(state, robot),
                }
            )
        return {
            "robot": self.name,
            "run": self.run,
            "incarnation": self.incarnation,
            "synchronisation": self.plan.synchronisation.value,
            "active": self.active,
            "members": self._member_names(),
            "quorum": self.has_quorum(),
            "leader": "" if self.partial else self.consensus.leader,
            "log_length": self.ledger.length,
            "hash": self.ledger.hash,
            "pending": len(self.pool.own),
            "stuck": self.is_stuck(),
            "astray": sorted(self.astray),
            "waits_for": self.waits_for(),
            "paused": state.paused,
            "ended": state.ended,
            "fenced": self.fenced,
            "marking": self.plan.net.named(self.own.marking(self.ledger), zeros=False),
            "robots": robots,
        }

    def _state_of(self, robot: RobotState) -> str:
        """The words of the thesis (4.3.3) for what a robot is up to."""
        if robot.phase in GONE:
            return "Lost" if robot.phase.value == "lost" else "Left"
        if robot.paused or self.ledger.state.paused:
            return "Paused"
        return {"doing": "Doing", "done": "Waiting", "failed": "Failed"}.get(robot.phase.value, "Inactive")
