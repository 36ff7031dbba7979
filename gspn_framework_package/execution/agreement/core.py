"""What every part of a replica stands on: what it knows, whom it counts, and how it puts out
effects."""

from __future__ import annotations

import hashlib
import math
import random
from typing import Any, Collection, Dict, List, NamedTuple, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution import entries as log
from gspn_framework_package.execution.agreement import interface as io
from gspn_framework_package.execution.agreement.catch_up import History
from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.messages import Envelope
from gspn_framework_package.execution.agreement.own_robot import OwnRobot, goal_record
from gspn_framework_package.execution.agreement.peers import Peers
from gspn_framework_package.execution.agreement.pool import Own, Pool
from gspn_framework_package.execution.agreement.private import PrivateMoves
from gspn_framework_package.execution.agreement.quorum import Ballot, is_quorum
from gspn_framework_package.execution.draw import uniform
from gspn_framework_package.execution.environment import Environment
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.firing import (
    Fault,
)
from gspn_framework_package.execution.ledger import Item, Ledger, Origin
from gspn_framework_package.execution.team_state import GONE, RobotState
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.plan import Plan, Synchronisation, Timing


class Pace(NamedTuple):
    """Times of the protocol (s). None matters for safety."""

    heartbeat: float = 0.5
    """How often a replica tells that it is there."""
    greeting: float = 0.2
    """How often it does until it takes part."""
    retry: float = 0.1
    """After which a message without an answer is sent again (longer and longer, up to 1 s)."""
    takeover: float = 0.3
    """For which a fact waits for the leader before its robot proposes itself."""
    gather: float = 0.0
    """For which the leader lets facts come in between two slots."""
    backoff: float = 0.02
    """For which a proposer gives way after its first defeat; doubled at each one in a row."""

    def for_team(self, size: int, timing: Timing) -> Pace:
        """The pace for a team of that size: what everybody tells everybody is told less often in a
        large one, so that what each replica hears a second grows no further; and a leader that has
        so many to ask is given time, or all want to take over from it at once. One millisecond for
        each robot that a small team would not have is for gathering facts: each slot costs messages
        to and from everybody, however much is in it.

        :param timing: of the plan: nobody shall seem silent for as long as it says only because
            heartbeats are so rare.
        """
        slower = max(1.0, size / SMALL_TEAM)
        silence = min([t for t in (timing.evict_after, timing.fence_after) if t > 0], default=math.inf)
        return self._replace(
            heartbeat=max(self.heartbeat, min(self.heartbeat * slower, silence / 4)),
            greeting=self.greeting * slower,
            retry=self.retry * slower,
            takeover=self.takeover * slower,
            gather=self.gather + 0.001 * max(0, size - SMALL_TEAM),
        )


class Limits(NamedTuple):
    """Sizes of the protocol. None matters for safety; tests make them small."""

    batch: int = 256
    """The most items that one slot takes."""
    kept: int = 2000
    """Slots that are kept in memory; who is further behind gets a snapshot."""
    chunk: int = 200
    """Slots sent at a time."""
    snapshot_every: int = 1000
    """Slots after which the log gets a snapshot, where a restart begins to read."""


SMALL_TEAM = 8
"""Up to that many replicas, greetings are answered at once and the pace is the plain one."""


class Core:
    """The state of a replica (see :class:`~gspn_framework_package.execution.agreement.replica.Replica`
    for the parameters), and the questions and effects that all parts of it share."""

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
        limits: Optional[Limits] = None,
        trusted: bool = True,
    ) -> None:
        self.plan = plan
        self.name = robot
        self.run = run
        self.log_id = log_id
        self.limits = limits or Limits()
        self._trusted = trusted
        self.records = len(records)
        """How many records our log has."""
        self._durable = len(records)
        """Up to which of them it outlives the power supply."""
        self._begin_records = len(records)
        """How many it had when this incarnation began."""
        size = len(plan.robots) + len(plan.witness)
        self.is_small = size <= SMALL_TEAM
        """Everybody may tell everybody something about each slot."""
        self.pace = (pace or Pace()).for_team(size, plan.timing)
        self.partial = plan.synchronisation is Synchronisation.PARTIAL
        self.witness = robot in plan.witness
        self.place = place
        self.incarnation = 0
        self.active = False
        """We take part: we are known as fresh by everybody, or were admitted by a Join."""
        self.forgetful = False
        """We may have voted in this run and do not remember it."""
        self.fenced = False
        self._leaving_since: Optional[float] = None
        self.leaving = False
        """We have left, and stay until those who go on know."""
        self.halted: Optional[str] = None
        game = TokenGame(plan)
        self.ledger = Ledger(game)
        self.pool = Pool()
        self.peers = Peers()
        self.history = History(self.limits.kept, self.limits.chunk)
        team = [r.name for r in plan.robots] + list(plan.witness)
        self.joining = joining or robot not in team
        self.first = "" if self.joining or not team else team[0]
        self.consensus = Consensus(self, self.partial, self.first)
        moves = PrivateMoves(game, robot) if self.partial and not self.witness else None
        self.own = OwnRobot(robot, moves)
        self.off: Dict[str, int] = {}
        """Robots that an operator asserted to be off, with the incarnation that the assertion is about."""
        self.astray: Dict[str, int] = {}
        """Robots whose log differs from ours, with a slot before which it does."""
        self._environment = Environment(game, random.Random("%d|%s" % (plan.seed, robot)))
        self._tag = "%s|%s" % (run, plan.hash()[:12])
        self._number = 0
        self._out: List[io.Effect] = []
        self._request = ""
        self._now = 0.0
        self._started = False
        self._next_hello = 0.0
        self._asked_until = (-1, 0.0)
        self._told: Tuple[Any, ...] = ()
        self._wait_until: Optional[float] = None
        """Before that we do not propose."""
        self._gathers_until = 0.0
        """Before that we do not propose as leader."""
        self._gave_way = False
        """In the open slot of partial synchronisation, to another's attempt."""
        self._defeats = 0
        self._hold_since: Optional[float] = None
        self._first_hash = ""
        self._members: Tuple[Optional[Ledger], int, List[str]] = (None, 0, [])
        self._strangers: Set[str] = set()
        self._complaints: Set[Tuple[str, str]] = set()
        self._listen_until = 0.0
        """Before that a fresh robot does not take part: somebody may know its name."""
        self._held: List[io.Order] = []
        """Orders that came before that."""
        self._superseded_at: Optional[float] = None
        """When another log was let in under our name."""
        self._rival_since: Optional[float] = None
        """Since when we have heard another process of our name after that."""
        self._voteless: Set[str] = set()
        self._text = ""
        self._records = list(records)

    # -- who we are, and who the others are -----------------------------------------------------------

    def _own_state(self) -> Optional[RobotState]:
        return self.ledger.state.robots.get(self.name)

    def _known_incarnation(self) -> int:
        """The newest incarnation of ours that the log has heard of, -1 for none."""
        state = self._own_state()
        seen = self.ledger.seen.get(self.name, (-1, 0, ""))[0]
        return seen if state is None else max(seen, state.incarnation)

    def _member_names(self) -> List[str]:
        known = self._members
        if known[0] is not self.ledger or known[1] != self.ledger.length:
            known = self._members = (self.ledger, self.ledger.length, self.ledger.state.members())
        return known[2]

    def members(self) -> List[str]:
        """The members whose votes count in the open slot, in the order of the log."""
        return self._member_names()

    def others(self) -> List[str]:
        """The members without us."""
        return [m for m in self._member_names() if m != self.name]

    def asserted_off(self) -> Set[str]:
        """The members that an operator asserted to be off. An assertion is about one incarnation: it
        ends when the robot joins again."""
        robots = self.ledger.state.robots
        return {
            name
            for name, incarnation in self.off.items()
            if name in robots and robots[name].phase not in GONE and robots[name].incarnation == incarnation
        }

    def may_decide(self, voters: Collection[str]) -> bool:
        """Whether these members may decide the open slot: a quorum; or, where robots that were
        asserted to be off leave none, *all* the others. A quorum that does not consist of the
        former alone has one of the others in it, whose word is then heard."""
        members = self._member_names()
        if is_quorum(voters, members):
            return True
        off = self.asserted_off()
        if not off:
            return False
        left = [m for m in members if m not in off]
        return bool(left) and not is_quorum(left, members) and all(m in voters for m in left)

    def known_log(self, robot: str) -> str:
        """The id of the log whose votes count for a robot: that with which it was let in, else the
        first one that we heard of; "" for none."""
        return self.ledger.logs.get(robot) or self.peers.known.get(robot, "")

    def is_member(self) -> bool:
        """Whether the log counts us in."""
        return self.name in self._member_names()

    def may_vote(self) -> bool:
        """Whether we are a member, and know what we promised before."""
        return self.active and self.halted is None and self.is_member() and self._is_our_name()

    def _is_our_name(self) -> bool:
        """Whether it is with our log that the robot was let in last, if it was."""
        return self.ledger.logs.get(self.name) in (None, "", self.log_id)

    def is_settled(self) -> bool:
        """Whether the log knows this incarnation of our robot, so that it may act."""
        state = self._own_state()
        return self.active and state is not None and state.phase not in GONE and state.incarnation == self.incarnation

    # -- what the consensus needs of :class:`~gspn_framework_package.execution.agreement.growth.Growth` -----------

    def is_open(self, message: Envelope) -> bool:
        """See :class:`~gspn_framework_package.execution.agreement.host.Host`."""
        raise NotImplementedError

    def decided(self, batch: List[Any], ballot: Ballot, *, mine: bool) -> None:
        """See :class:`~gspn_framework_package.execution.agreement.host.Host`."""
        raise NotImplementedError

    # -- effects --------------------------------------------------------------------------------------

    def _put(self, *effects: io.Effect) -> None:
        self._out += effects

    def _flush(self) -> List[io.Effect]:
        out, self._out = self._out, []
        return out

    def persist(self, record: Record, *, durable: bool = False) -> None:
        """See :class:`~gspn_framework_package.execution.agreement.host.Host`."""
        self.records += 1
        if durable:
            self._durable = self.records
        self._put(io.Persist(record, durable))

    def _signed(self, body: Any) -> io.Message:
        return Envelope(
            self.name,
            self._tag,
            self.log_id,
            self.incarnation,
            self._durable,
            self.ledger.length,
            self.ledger.hash,
            body,
        ).to_json()

    def send_all(self, to: List[str], body: Any) -> None:
        """Send a message to each of these."""
        if to:
            signed = self._signed(body)
            self._put(*(io.Send(robot, signed) for robot in to))

    def answer(self, to: Envelope, body: Any) -> None:
        """Answer a message: with the reply of a call, where it was one."""
        if self._request:
            self._put(io.Reply(self._request, self._signed(body)))
            self._request = ""
        else:
            self.send_all([to.sender], body)

    def _fault(self, message: str) -> None:
        self._put(Fault(self.name, message))

    def _halt(self, reason: str) -> None:
        self.halted = reason
        self._stop_acting()
        self._put(io.Halted(reason))

    # -- what is wanted in the log --------------------------------------------------------------------

    def own_items(self) -> List[Item]:
        """What we want in the log ourselves."""
        return self.pool.own_items()

    def add_foreign(self, items: Sequence[Item]) -> None:
        """Keep what another wants in the log."""
        if items:
            self.pool.add_foreign(items, self.ledger.is_news)

    def batch(self, frozen: bool) -> List[Any]:
        """What should go into the open slot, items as JSON values."""
        frozen = frozen or not self.partial
        items = self.pool.batch(self._member_names(), frozen=frozen)
        items = self._with_one_who_stays(self._without_ghosts(items))
        return [i.to_json() for i in items[: self.limits.batch]]

    def _with_one_who_stays(self, items: List[Item]) -> List[Item]:
        """Where nobody would be left, our own leave or eviction waits for a slot of its own, in which it
        has no effect: the last one stays, and it has to be one who was asked for its private moves."""
        members = self._member_names()
        gone = {i.entry.robot for i in items if isinstance(i.entry, (log.Evict, log.Leave))}
        if len(members) < 2 or not gone.issuperset(members):
            return items
        return [
            i for i in items if not (isinstance(i.entry, (log.Evict, log.Leave)) and i.entry.robot == self.name)
        ]

    def _without_ghosts(self, items: List[Item]) -> List[Item]:
        """Leave robots out that want to join and are not heard themselves, or of which there are so
        many that those who are heard would be no quorum with them: a team must not lose its quorum
        to names that nobody answers to. Nor does a robot come back in the slot that evicts it by force: it
        does not know of it."""
        members = self._member_names()
        refused: Set[str] = set()
        cast_out = {i.entry.robot for i in items if isinstance(i.entry, log.Evict) and i.entry.forced}
        live = set(self.peers.near(members, self.name, 4 * self.pace.heartbeat, self._now))
        now = list(members)
        kept = []
        for item in items:
            entry = item.entry
            name = item.origin.robot
            if isinstance(entry, log.Join) and name not in now:
                heard = self.peers.get(name).heard is not None and self.peers.get(name).log == entry.log
                if name == self.name or (heard and is_quorum(live | {name}, [*now, name])):
                    now.append(name)
                    live.add(name)
                else:
                    refused.add(name)
            if isinstance(entry, log.Join) and name in cast_out:
                refused.add(name)
            if name not in refused:
                kept.append(item)
        return kept

    def _next_origin(self) -> Origin:
        self._number += 1
        return Origin(self.name, self.incarnation, self._number, self.log_id[:8])

    def _invoke(self, entry: log.Entry, order_id: str = "", suspect: str = "") -> None:
        """Want a fact in the log."""
        item = Item(entry, self._next_origin())
        if not suspect:  # a suspicion may be withdrawn, and is never taken up again
            origin = list(item.origin)
            self.persist({"kind": "invoked", "entry": log.to_json(entry), "origin": origin})
        self.pool.own.append(Own(item, order_id, suspect))

    # -- our robot, and its lives ---------------------------------------------------------------------

    def _new_life(self) -> None:
        """We start again, or come back: a new incarnation, which the log must hear of."""
        self.incarnation = max(self.incarnation, self._known_incarnation()) + 1
        self._number = 0
        self._note_life()
        self.own.incarnation = self.incarnation

    def _note_life(self) -> None:
        self._begin_records = self.records
        record = {"kind": "life", "incarnation": self.incarnation, "joining": self.joining}
        self.persist(record, durable=True)

    def _become_active(self) -> None:
        self.active = True
        self.forgetful = False
        self.persist({"kind": "active"}, durable=True)

    def _renew_log_id(self) -> None:
        """What our log says from here on is another memory: its votes must not be taken for those of
        the one before."""
        text = "%s|%s|%r|%d" % (self.log_id, self.name, self._now, self.records)
        self.log_id = hashlib.sha256(text.encode()).hexdigest()[:32]

    def _act(self, delays: Dict[Tuple[int, int], float]) -> None:
        """Start and cancel actions as the log (and our private moves) say."""
        if not self.active or self.fenced or self.halted is not None:
            return
        for command in self.own.commands(self.ledger, delays):
            self.persist(goal_record(command))
            self._put(command)

    def _stop_acting(self) -> None:
        for command in self.own.stop():
            self.persist(goal_record(command))
            self._put(command)

    def _draw(self) -> float:
        """A number in [0, 1) that differs from robot to robot and from time to time."""
        counter = self.consensus.highest.counter
        return uniform(self.plan.seed, self.ledger.length, counter, "wait of " + self.name)
