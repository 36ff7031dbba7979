"""The agreement core: one robot's replica of the log, as a pure step function.

:class:`Replica` takes inputs and returns effects
(:mod:`~gspn_framework_package.execution.agreement.interface`). It only assembles the parts and
routes each input to the part that handles it; its state is in one
:class:`~gspn_framework_package.execution.agreement.state.ReplicaState`, of which it owns ``now``.

Protocol, assumptions and a sketch of the proof are in ``docs/agreement.md``.
"""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface, messages
from gspn_framework_package.execution.agreement.config import Config, Pace, ProtocolLimits
from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.deployment import Deployment
from gspn_framework_package.execution.agreement.electorate import Electorate
from gspn_framework_package.execution.agreement.local_robot import LocalRobot
from gspn_framework_package.execution.agreement.membership import Membership
from gspn_framework_package.execution.agreement.orders import Orders
from gspn_framework_package.execution.agreement.outbox import Outbox
from gspn_framework_package.execution.agreement.proposals import ProposalQueue
from gspn_framework_package.execution.agreement.proposer import Proposer
from gspn_framework_package.execution.agreement.reactions import Reactions
from gspn_framework_package.execution.agreement.recent_slots import RecentSlots
from gspn_framework_package.execution.agreement.recovery import Recovery
from gspn_framework_package.execution.agreement.replication import Replication
from gspn_framework_package.execution.agreement.state import ReplicaState
from gspn_framework_package.execution.agreement.status import Status
from gspn_framework_package.execution.breakpoints import Breakpoints, RobotBreakpoints
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.ledger import Ledger
from gspn_framework_package.model.net import Marking
from gspn_framework_package.model.plan import Plan

__all__ = ["ProtocolLimits", "Pace", "Replica"]


class Replica:
    """One robot's (or witness's) replica.

    :param plan: a validated plan; its robots and witnesses are the first team.
    :param robot: our name.
    :param run: name of the run; messages of other runs are ignored.
    :param log_id: id of our log, from its header.
    :param records: the records of our log, in order; empty for a new log.
    :param joining: whether we are not in the first team, or it started long ago, so that we get the
        log from the others and then join.
    :param place: where we start when we first join; by default our place in the plan, otherwise the
        first of ``spawn``.
    :param pace: times of the protocol, for a small team.
    :param limits: sizes of the protocol.
    :param trusted: whether the end of our log is intact. If it may be lost (the machine was
        restarted, and the log was not synced to the disk), the rest is not trusted, and the robot
        joins like a robot that lost its log.
    :param damage: what was damaged in our log, "" for nothing; ``records`` is then the intact part
        before it, our votes do not count, and we join like a robot that lost its log.

    :ivar config: its configuration.
    :ivar state: its state.
    """

    def __init__(
        self,
        plan: Plan,
        robot: str,
        run: str,
        log_id: str,
        records: Sequence[Record] = (),
        *,
        joining: bool = False,
        place: str = "",
        pace: Optional[Pace] = None,
        limits: Optional[ProtocolLimits] = None,
        trusted: bool = True,
        damage: str = "",
    ) -> None:
        self.config = config = Config.make(
            plan,
            robot,
            run,
            joining=joining,
            place=place,
            pace=pace,
            limits=limits,
            trusted=trusted,
            damage=damage,
        )
        self.state = state = ReplicaState(
            ledger=Ledger(config.game),
            recent=RecentSlots(config.limits.kept, config.limits.chunk),
            log_id=log_id,
            joining=config.newcomer,
            records=len(records),
            durable=len(records),
            begin_records=len(records),
        )
        self._records = list(records)
        # each part knows the earlier ones; two need the log, which comes later
        self.outbox = outbox = Outbox(config, state)
        self.electorate = electorate = Electorate(config, state)
        self.proposals = proposals = ProposalQueue(config, state, outbox, electorate)
        self.breaks = breaks = RobotBreakpoints()
        known = config, state, outbox, electorate, proposals
        self.robot = local = LocalRobot(*known, breaks)
        self.consensus = consensus = Consensus(*known)
        self.proposer = proposer = Proposer(*known, consensus)
        self.membership = membership = Membership(*known, proposer, local)
        self.replication = replication = Replication(*known, proposer, membership, local)
        consensus.connect(replication)
        membership.connect(replication)
        self.reactions = reactions = Reactions(*known, local, breaks)
        self.deployment = Deployment(*known)
        self.recovery = Recovery(*known, consensus, membership, replication, reactions)
        self.orders = Orders(*known, membership, reactions)
        self.people = Status(*known, consensus, proposer, local)

    # -- inputs -----------------------------------------------------------------

    def start(self, now: float) -> List[interface.Effect]:
        """Begin (once, before any :meth:`step`).

        :raises LogError: the records contradict each other or the plan.
        """
        self.state.now = now
        self.membership.listen_anew()
        if (
            self._records or self.config.damage or not self.config.trusted
        ):  # the log was not empty, but nothing is left of it
            self.recovery.resume(self._records)
            self.robot.follow_plan()
        else:
            self.membership.begin_first_life()
            if not self.state.joining:
                self.replication.begin()
        self._records = []
        self.membership.consider_active()
        self._settle()
        return self.outbox.flush()

    def step(self, given: interface.Input, now: float) -> List[interface.Effect]:
        """Take one input and return the effects, to be carried out in order.

        :param now: monotonic clock, s.
        """
        return self.step_all((given,), now)

    def step_all(self, given: Sequence[interface.Input], now: float) -> List[interface.Effect]:
        """Take several inputs and return the effects, to be carried out in order. Due work is done
        once, after the last input, so that proposals that arrive together go into one slot.

        :param now: monotonic clock, s.
        """
        state, before = self.state, self.state.now
        state.now = now
        if now - before > 4 * self.config.pace.heartbeat:
            # we were suspended or starved, so the silence of others does not count
            self.membership.listen_anew()
            self.consensus.woke(now)
        halted = False
        for number, one in enumerate(given, 1):
            halted = state.halted is not None
            self._begin(one)
            if number < len(given):
                self.outbox.end()
        if not halted:
            self._settle()
        self.outbox.end()
        return self.outbox.flush()

    def _begin(self, given: interface.Input) -> None:
        if isinstance(given, interface.Received):
            self.outbox.begin(given.request_id)
        if self.state.halted is None:
            self._take(given)
        elif isinstance(given, (interface.Order, interface.ForceEvict)):
            self.outbox.order_result(given.order_id, False, self.state.halted)
        elif isinstance(given, interface.TaskCame):
            self._refuse_task(given.task, self.state.halted)

    def _take(self, given: interface.Input) -> None:
        if isinstance(given, interface.Received):
            self._receive(given.message)
        elif isinstance(given, (interface.ActionDone, interface.AttemptFailed)):
            self.robot.action_ended(given)
        elif isinstance(given, interface.Examined):
            self.deployment.take(given)
        elif isinstance(given, interface.EventObserved):
            self.reactions.observe(given)
        elif isinstance(given, interface.TaskCame):
            why = self.reactions.take_task(given.task)
            if why:
                self._refuse_task(given.task, why)
        elif isinstance(given, interface.TimeOfDay):
            self.reactions.look_at_times(given.seconds)
        elif isinstance(given, interface.Order):
            self.orders.order(given)
        elif isinstance(given, interface.OrderGiven):
            self.orders.keep(given)
        elif isinstance(given, interface.ForceEvict):
            self.orders.force_evict(given)

    def _refuse_task(self, task: log_entries.Submit, why: str) -> None:
        self.outbox.fault("task %s is refused: %s" % (task.id, why))

    def _receive(self, data: Any) -> None:
        try:
            message = messages.parse_envelope(data)
        except messages.MessageError as error:
            self.membership.refuse_message(data, str(error))
            return
        if message.sender == self.config.name:
            self.membership.hear_own_name(message)
        elif message.team != self.config.tag:
            self.membership.hear_stranger(message)
        elif self.membership.admits(message):
            counts = self.membership.hear(message)
            dead = message.log in self.state.peers.dead
            if dead and not isinstance(message.body, messages.Hello):
                return
            self._give(message, counts)
            if self.state.halted is None and self.electorate.can_teach(message.sender):
                self.replication.pull_if_behind(message)

    def _give(self, message: messages.Envelope, counts: bool) -> None:
        """Route a message of the team to the part that handles it.

        :param counts: whether the sender's votes count, also in a slot that does not need the votes
            of all.
        """
        body = message.body
        if isinstance(body, (messages.Prepare, messages.Accept)):
            for robot, ids in body.torn.items():
                self.membership.note_torn(robot, ids)
        if isinstance(body, messages.Hello):
            self.membership.on_hello(message, body)
        elif isinstance(body, messages.Pull):
            self.replication.on_pull(message)
        elif isinstance(body, messages.Proposals):
            self.proposer.on_proposals(message, body)
            self.replication.help_if_behind(message)
        elif isinstance(body, messages.Learn):
            if self.electorate.can_teach(message.sender):
                self.replication.on_learn(message, body)
        elif self.state.ledger.is_cast_out(message.sender):
            return  # its log was given up, until it rejoins
        elif counts or message.torn or (isinstance(body, messages.Promise) and not body.vote):
            self.proposer.on_vote(message)

    def _settle(self) -> None:
        """Do what is due, and request the next tick."""
        state = self.state
        if state.halted is None:
            if self.membership.listened():
                self.membership.consider_active()
                self.orders.take_up_held()
            if state.now >= state.next_hello:
                self.membership.greet()
                self.membership.consider_active()
                self.membership.watch()
                self.people.report()
            self.reactions.follow()
            self.reactions.want_tasks()
            if state.leaving:
                self.membership.part()
            elif state.ledger.state.ended is None:
                self.membership.want_to_join()
                self.robot.want_environment()
                self.reactions.want_events()
                self.deployment.want_vote()
            self.proposer.drive()
            self.reactions.follow()  # a robot that is a quorum by itself has decided by now
        times = [
            *self.membership.wake_times(),
            *self.proposer.wake_times(),
            *self.robot.wake_times(),
            *self.reactions.wake_times(),
        ]
        self.outbox.put(interface.WakeAt(max(state.now + 0.001, min(times))))

    # -- queries by the host ---------------------------------------------------------------------

    @property
    def ledger(self) -> Ledger:
        """The state after the agreed log so far."""
        return self.state.ledger

    @property
    def incarnation(self) -> int:
        """Our present incarnation."""
        return self.state.incarnation

    @property
    def log_id(self) -> str:
        """Id of our log; changes when we discard the log."""
        return self.state.log_id

    @property
    def records(self) -> int:
        """Number of records in our log."""
        return self.state.records

    @property
    def active(self) -> bool:
        """Whether we take part."""
        return self.state.active

    @property
    def fenced(self) -> bool:
        """Whether our action was stopped because we have no contact with a quorum."""
        return self.state.fenced

    @property
    def halted(self) -> Optional[str]:
        """Why we no longer take part; None while we do."""
        return self.state.halted

    @property
    def witness(self) -> bool:
        """Whether we vote and have no token."""
        return self.config.witness

    @property
    def pace(self) -> Pace:
        """The times of the protocol."""
        return self.config.pace

    @property
    def complaints(self) -> Mapping[Tuple[str, str], int]:
        """Malformed messages: (sender, reason) -> count."""
        return self.state.complaints

    def members(self) -> List[str]:
        """See :class:`~gspn_framework_package.execution.agreement.electorate.Electorate`."""
        return self.electorate.members()

    def may_vote(self) -> bool:
        """See :class:`~gspn_framework_package.execution.agreement.electorate.Electorate`."""
        return self.electorate.may_vote()

    def has_namesake(self) -> bool:
        """See :class:`~gspn_framework_package.execution.agreement.electorate.Electorate`."""
        return self.electorate.has_namesake()

    def is_settled(self) -> bool:
        """See :class:`~gspn_framework_package.execution.agreement.electorate.Electorate`."""
        return self.electorate.is_settled()

    def asserted_off(self) -> Set[str]:
        """See :class:`~gspn_framework_package.execution.agreement.electorate.Electorate`."""
        return self.electorate.asserted_off()

    def knows(self, robot: str) -> bool:
        """Whether we exchange messages with a robot; called on any thread."""
        return robot in self.state.peers.all or self.electorate.is_of_team(robot)

    def known_log(self, robot: str) -> str:
        """See :class:`~gspn_framework_package.execution.agreement.electorate.Electorate`."""
        return self.electorate.known_log(robot)

    @property
    def visit(self) -> Tuple[int, int]:
        """Incarnation and number of our robot's present visit; zeros if there is none. When it
        changes, the host restarts the functions of events."""
        at = self.state.position
        return (at.incarnation, at.visit) if at is not None else (0, 0)

    def watches(self, transition: str) -> bool:
        """Whether an event could interrupt our robot in its present visit."""
        return self.reactions.watches(transition)

    def break_at(self, breakpoints: Breakpoints) -> None:
        """Have our robot stop at these places and transitions from now on."""
        self.breaks.breakpoints = breakpoints

    def marking(self) -> Marking:
        """The marking known to this robot: that of the log, with the robot's own local
        transitions."""
        return self.robot.marking()

    def waits_for(self) -> str:
        """What this replica (not its action) waits for, in words; "" for nothing."""
        return self.people.waits_for()

    def is_stuck(self) -> bool:
        """Whether the team can never continue by itself, because too many members lost their
        logs."""
        return self.people.is_stuck()

    def status(self) -> Dict[str, Any]:
        """The complete status for people, as a JSON object (ages in s)."""
        return self.people.as_json()
