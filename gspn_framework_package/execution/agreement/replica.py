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
from gspn_framework_package.execution.agreement.core import Pace
from gspn_framework_package.execution.agreement.pacing import Pacing
from gspn_framework_package.execution.agreement.quorum import Ballot
from gspn_framework_package.execution.team_state import GONE, RobotState

__all__ = ["Pace", "Replica"]


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
            self._persist({"kind": "life", "incarnation": 0, "joining": self.joining})
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
            if self._now >= self._next_hello:
                self._next_hello = self._now + (
                    self.pace.heartbeat if self.active else min(self.pace.heartbeat, self.pace.greeting)
                )
                self._put(io.Send(io.EVERYBODY, self._signed(self._hello())))
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

    def _receive(self, message: io.Message) -> None:
        sender = message.get("from")
        if not sender or not isinstance(sender, str):
            return
        if sender == self.name:
            self._hear_own_name(message)
            return
        if message.get("team") != self._tag:
            self._hear_stranger(sender, message)
            return
        peer = self.peers.hear(sender, self._now)
        peer.length = message["length"]
        if self.pool.own:
            self.pool.withdraw_suspicion([sender])
        kind = message["kind"]
        if sender in self.cast_out and kind not in ("hello", "pull", "event"):
            return  # what it knows was given up, until it joins again
        if kind == "hello":
            self._on_hello(message)
        elif kind == "pull":
            self._on_pull(message)
        elif kind == "learn":
            self._on_learn(message)
        elif kind == "event":
            self.add_foreign(message["items"])
            (self._voteless.discard if message["vote"] else self._voteless.add)(sender)
            if message["length"] < self.ledger.length:
                self._help(message)
        elif kind == "prepare":
            self.consensus.on_prepare(message, self._now)
            if self.consensus.promised == Ballot.from_json(message["ballot"]):
                self._give_way()
        elif kind == "accept":
            self.consensus.on_accept(message, self._now)
        elif kind == "promise":
            self.consensus.on_promise(message, self._now)
        elif kind == "accepted":
            self.consensus.on_accepted(message, self._now)
        elif kind == "nack" and self.consensus.on_nack(message, self._now):
            self._defeats += 1
            self._give_way()
        if self.halted is None and peer.length > self.ledger.length:
            self._pull(sender)

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
                m for m in self._all_others() if m not in self.forced and self.peers.get(m).welcomes != self.log_id
            ]
            return "waits for %s to start" % ", ".join(missing)
        if self.ledger.state.ended is not None:
            return ""
        if not self.witness and not self.is_settled():
            return "waits to be let into the team"
        if self.fenced:
            return "stopped: no contact to a quorum"
        attempt = self.consensus.attempt
        if attempt is not None and attempt.tries > 1:
            voteless = [m for m in self.others() if not self.peers.get(m).active]
            missing = [m for m in self.consensus.missing() if m not in voteless]
            if missing or not voteless:
                return "waits for an answer of %s" % ", ".join(missing)
            return "has no quorum; without a vote: %s" % ", ".join(voteless)
        if not self.has_quorum():
            return "has no quorum; silent: %s" % ", ".join(self._silent())
        if self.partial and self._wants() and self._silent():  # whose attempt it is changes all the time
            return "waits for an answer of %s" % ", ".join(self._silent())
        return ""

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
