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

import random
from typing import Any, Dict, Iterable, List, NamedTuple, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution import entries as log
from gspn_framework_package.execution.agreement import interface as io
from gspn_framework_package.execution.agreement.catch_up import History
from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.own_robot import Goal, OwnRobot, goal_record
from gspn_framework_package.execution.agreement.peers import Peers
from gspn_framework_package.execution.agreement.pool import Own, Pool
from gspn_framework_package.execution.agreement.private import PrivateMoves
from gspn_framework_package.execution.agreement.quorum import Ballot, is_quorum
from gspn_framework_package.execution.draw import uniform
from gspn_framework_package.execution.environment import Environment
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.firing import (
    Ended,
    Fault,
    Firing,
    StartAction,
    firing_to_json,
)
from gspn_framework_package.execution.ledger import Item, Ledger, Origin
from gspn_framework_package.execution.team_state import GONE, POLICY, Phase, RobotState
from gspn_framework_package.execution.token_game import Step, TokenGame
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.plan import Plan, Synchronisation


class Pace(NamedTuple):
    """Times of the protocol (s). None matters for safety."""

    heartbeat: float = 0.5
    """How often a replica tells that it is there."""
    retry: float = 0.1
    """After which a message without an answer is sent again (longer and longer, up to 1 s)."""
    takeover: float = 0.3
    """For which a fact waits for the leader before its robot proposes itself."""
    backoff: float = 0.02
    """For which a proposer gives way after its first defeat; doubled at each one in a row."""


SNAPSHOT_EVERY = 1000
"""Slots after which the log gets a snapshot, where a restart begins to read."""

FLUSH_AT = 100
"""Private moves that wait before they are brought into the log for their number alone."""


class Replica:
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
    :raises LogError: the records contradict each other or the plan.
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
    ) -> None:
        self.plan = plan
        self.name = robot
        self.run = run
        self.log_id = log_id
        self.pace = pace or Pace()
        self.partial = plan.synchronisation is Synchronisation.PARTIAL
        self.witness = robot in plan.witness
        self.place = place
        self.incarnation = 0
        self.active = False
        """We take part: we are known as fresh by everybody, or were admitted by a Join."""
        self.forgetful = False
        """We may have voted in this run and do not remember it."""
        self.fenced = False
        self.leaving = False
        """We have left, and stay until those who go on know."""
        self.halted: Optional[str] = None
        game = TokenGame(plan)
        self.ledger = Ledger(game)
        self.pool = Pool()
        self.peers = Peers()
        self.history = History()
        team = [r.name for r in plan.robots] + list(plan.witness)
        self.joining = joining or robot not in team
        self.consensus = Consensus(self, self.partial, "" if self.joining or not team else team[0])
        moves = PrivateMoves(game, robot) if self.partial and not self.witness else None
        self.own = OwnRobot(robot, moves)
        self.forced: Set[str] = set()
        self.cast_out: Set[str] = set()
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
        self._defeats = 0
        self._hold_since: Optional[float] = None
        self._first_hash = ""
        self._members: Tuple[Optional[Ledger], int, List[str]] = (None, 0, [])
        self._strangers: Set[str] = set()
        self._voteless: Set[str] = set()
        self._text = ""
        self._records = list(records)

    # -- inputs ------------------------------------------------------------------------------------

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

    def _flush(self) -> List[io.Effect]:
        out, self._out = self._out, []
        return out

    def _put(self, *effects: io.Effect) -> None:
        self._out += effects

    # -- resuming ----------------------------------------------------------------------------------

    def _resume(self, records: Sequence[Record]) -> None:
        """Take up our own log again."""
        open_facts: Dict[Origin, Item] = {}
        begin = max((i for i, r in enumerate(records) if r["kind"] in ("snapshot", "reset")), default=0)
        for number, record in enumerate(records):
            kind = record["kind"]
            if kind == "life":
                self.incarnation = record["incarnation"]
                self.joining = record.get("joining", self.joining)
            elif kind == "active":
                self.active = True
                self.forgetful = False
            elif kind == "reset":
                self.active = False
                self.forgetful = True
                open_facts.clear()
            elif kind == "peer":
                self.peers.known[record["robot"]] = record["log"]
            elif kind == "forced":
                self.forced |= set(record["robots"])
            elif kind in ("invoked", "private"):
                item = Item.from_json([record["entry"], record["origin"], kind == "private"])
                open_facts[item.origin] = item
            elif kind == "void":
                open_facts.pop(Origin(*record["origin"]), None)
            elif number >= begin and kind == "snapshot":
                self.ledger.restore(record)
                self.history.clear(self.ledger.length)
            elif number >= begin and kind == "slot":
                self._replay(record)
        for record in records:
            if record["kind"] in ("promised", "accepted"):
                self.consensus.restore(record, self.ledger.length)
        for item in open_facts.values():
            if self.ledger.is_news(item.origin):
                self.pool.own.append(Own(item))
        self.forced &= set(self._member_names())
        self._first_hash = next((r["hash"] for r in records if r["kind"] == "slot" and r["slot"] == 0), "")
        self._new_life()
        if self.ledger.length == 0 and not (self.joining or self.forgetful):
            self._begin()

    def _begin(self) -> None:
        """The first slot is the same for all who have the plan: nothing to agree on."""
        start = self.ledger.game.start_entry()
        self._commit([Item(start, Origin("", 0, 0)).to_json()], Ballot(0, ""), mine=False)

    def _replay(self, record: Record) -> None:
        items = [Item(log.from_json(e), Origin(*o)) for e, o in zip(record["entries"], record["origins"])]
        before = self.ledger.hash
        again, _ = self.ledger.append(items)
        if (again["slot"], again["hash"]) != (record["slot"], record["hash"]):
            raise LogError(
                "slot %s of our own log does not follow from what is before it" % record["slot"],
                hint="the file was changed, or belongs to another version of the plan",
            )
        ballot = record.get("ballot", [0, ""])
        self.history.add(record["slot"], ballot, [i.to_json() for i in items], before)

    def _new_life(self) -> None:
        """We start again, or come back: a new incarnation, which the log must hear of."""
        self.incarnation = max(self.incarnation, self._known_incarnation()) + 1
        self._number = 0
        record = {"kind": "life", "incarnation": self.incarnation, "joining": self.joining}
        self._persist(record)
        self.own.incarnation = self.incarnation

    def _known_incarnation(self) -> int:
        """The newest incarnation of ours that the log has heard of, -1 for none."""
        state = self._own_state()
        seen = self.ledger.seen.get(self.name, (-1, 0, ""))[0]
        return seen if state is None else max(seen, state.incarnation)

    # -- what we know of ourselves -----------------------------------------------------------------

    def _own_state(self) -> Optional[RobotState]:
        return self.ledger.state.robots.get(self.name)

    def _member_names(self) -> List[str]:
        known = self._members
        if known[0] is not self.ledger or known[1] != self.ledger.length:
            known = self._members = (self.ledger, self.ledger.length, self.ledger.state.members())
        return known[2]

    def electorate(self) -> List[str]:
        """The members whose votes count in the open slot, in the order of the log."""
        return [m for m in self._member_names() if m not in self.forced]

    def others(self) -> List[str]:
        """The electorate without us."""
        return [m for m in self.electorate() if m != self.name]

    def is_member(self) -> bool:
        """Whether the log counts us in."""
        return self.name in self._member_names()

    def may_vote(self) -> bool:
        """Whether we are a member, and know what we promised before."""
        return self.active and self.halted is None and self.is_member()

    def is_settled(self) -> bool:
        """Whether the log knows this incarnation of our robot, so that it may act."""
        state = self._own_state()
        return self.active and state is not None and state.phase not in GONE and state.incarnation == self.incarnation

    def _consider_active(self) -> None:
        """Become active once every other member of the first team knows our log as the first one
        that we have."""
        if self.active or self.joining or self.forgetful or self.ledger.length < 1:
            return
        others = [m for m in self._member_names() if m != self.name and m not in self.forced]
        if any(self.peers.get(m).welcomes != self.log_id for m in others):
            return
        self._become_active()
        team = self._member_names()
        if team and team[0] == self.name and self.incarnation == 0 and not self.partial:
            self.consensus.lead_from_the_start(set(team) - self.forced)
        self._act({})

    def _become_active(self) -> None:
        self.active = True
        self.forgetful = False
        self._persist({"kind": "active"})

    # -- messages ----------------------------------------------------------------------------------

    def persist(self, record: Record) -> None:
        """Write a record before anything else leaves the process."""
        self._put(io.Persist(record))

    _persist = persist

    def _signed(self, message: io.Message) -> io.Message:
        message["from"] = self.name
        message["team"] = self._tag
        message["length"] = self.ledger.length
        message["hash"] = self.ledger.hash
        return message

    def send_all(self, to: List[str], message: io.Message) -> None:
        """Send a message to each of these."""
        signed = self._signed(message)
        for robot in to:
            self._put(io.Send(robot, signed))

    def answer(self, to: io.Message, message: io.Message) -> None:
        """Answer a message: with the reply of a call, where it was one."""
        if self._request:
            self._put(io.Reply(self._request, self._signed(message)))
            self._request = ""
        else:
            self.send_all([to["from"]], message)

    def own_items(self) -> List[Item]:
        """What we want in the log ourselves."""
        return self.pool.own_items()

    def add_foreign(self, items: Iterable[Any]) -> None:
        """Keep what another wants in the log, items as JSON values."""
        if items:
            self.pool.add_foreign(map(Item.from_json, items), self.ledger.is_news)

    def batch(self, frozen: bool) -> List[Any]:
        """What should go into the open slot, items as JSON values."""
        frozen = frozen or not self.partial
        return [i.to_json() for i in self.pool.batch(self._member_names(), frozen=frozen)]

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

    def is_open(self, message: io.Message) -> bool:
        """Whether a message is about the open slot, on top of the same log; where it is not, the
        one that is behind is helped."""
        slot = message["slot"]
        if slot < self.ledger.length:
            self._help(message)
            return False
        if slot > self.ledger.length:
            self._pull(message["from"])
            return False
        if message["length"] == self.ledger.length and message["hash"] != self.ledger.hash:
            self._conflict(message["from"], slot)
            return False
        return True

    # -- hello: who is there -----------------------------------------------------------------------

    def _hello(self) -> io.Message:
        limit = self.plan.timing.evict_after
        members = self._member_names()
        silent = self.peers.silent(members, self.name, limit, self._now) if limit > 0 else set()
        return {
            "kind": "hello",
            "log": self.log_id,
            "incarnation": self.incarnation,
            "active": self.active,
            "known": dict(self.peers.known),
            "first": self._first_hash,
            "silent": sorted(silent),
            "forced": sorted(self.forced),
            "cast_out": sorted(self.cast_out),
        }

    def _on_hello(self, message: io.Message) -> None:
        sender = message["from"]
        peer = self.peers.get(sender)
        peer.log = message["log"]
        peer.silent = frozenset(message["silent"])
        peer.welcomes = message["known"].get(self.name, "")
        if message["first"] and self._first_hash and message["first"] != self._first_hash:
            self._refuse_stranger(sender, "%s has another first team" % sender)
            return
        fresh = sender not in self.peers.known
        if fresh:
            self.peers.known[sender] = message["log"]
            self._persist({"kind": "peer", "robot": sender, "log": message["log"]})
        if not self.active:
            for robot in message["forced"]:
                self._note_forced(robot)
        peer.cast_out = frozenset(message["cast_out"])
        strange = peer.welcomes not in ("", self.log_id)
        if strange and not (self.active or self.forgetful or self.joining):
            self._forget()
        self._consider_active()
        if fresh or not (message["active"] or message["known"].get(self.name)):
            self.answer(message, self._hello())
        if message["length"] == self.ledger.length and message["hash"] != self.ledger.hash:
            self._conflict(sender, self.ledger.length)
        elif message["length"] < self.ledger.length:
            known = self.history.hash_before(message["length"])
            if known is not None and known != message["hash"]:
                self._conflict(sender, message["length"])

    def _hear_own_name(self, message: io.Message) -> None:
        if message.get("team") != self._tag or message.get("kind") != "hello":
            return
        same = message["log"] == self.log_id
        if message["incarnation"] > self.incarnation and (same or message["active"]):
            self._halt("another process runs as %s, and started later" % self.name)

    def _hear_stranger(self, sender: str, message: io.Message) -> None:
        run, _, plan = str(message.get("team")).rpartition("|")
        if run == self.run and plan != self.plan.hash()[:12]:
            self._refuse_stranger(sender, "%s has another plan" % sender)

    def _refuse_stranger(self, sender: str, what: str) -> None:
        if sender in self._strangers:
            return
        self._strangers.add(sender)
        if not self.active and self.plan.robots and sender in [r.name for r in self.plan.robots]:
            self._halt("%s (run '%s'); give all robots the same plan" % (what, self.run))
        else:
            self._fault("%s (run '%s'); it is not let in" % (what, self.run))

    def _conflict(self, other: str, slot: int) -> None:
        """Our log differs from another's before ``slot``."""
        if other in self.cast_out or other in self.forced:
            return  # the operator gave up what it knows
        if not self.active or self.name in self.peers.get(other).cast_out:
            self._forget()
            return
        self._halt("the log differs from that of %s before slot %d: one of them is broken" % (other, slot))

    def _forget(self) -> None:
        """What we know does not count (any more): learn the log from the others, then join. Until
        then we have no vote."""
        self._persist({"kind": "reset"})
        self._stop_acting()
        self.active = False
        self.forgetful = True
        self.ledger = Ledger(self.ledger.game)
        self.history.clear(0)
        self.pool = Pool()
        self.consensus.next_slot(False, set())
        self.own.follow(self.ledger, ())

    # -- catching up -------------------------------------------------------------------------------

    def _pull(self, robot: str) -> None:
        """Ask a robot that is ahead for what we lack, not too often."""
        length, until = self._asked_until
        if length == self.ledger.length and self._now < until:
            return
        self._asked_until = (self.ledger.length, self._now + self.pace.retry)
        self.send_all([robot], {"kind": "pull"})

    def _help(self, message: io.Message) -> None:
        """Send a robot that is behind what it lacks."""
        slots = self.history.since(message["length"])
        if slots is None:
            record = self.ledger.snapshot()
            self.answer(message, {"kind": "learn", "snapshot": record})
            return
        self.answer(
            message,
            {
                "kind": "learn",
                "at": message["length"],
                "before": self.history.hash_before(message["length"]),
                "slots": slots,
            },
        )

    def _on_pull(self, message: io.Message) -> None:
        if message["length"] < self.ledger.length:
            self._help(message)

    def _on_learn(self, message: io.Message) -> None:
        if "snapshot" in message:
            if message["snapshot"]["slot"] >= self.ledger.length:
                self._take_snapshot(message["snapshot"])
        elif "slots" in message:
            at = message["at"]
            for slot, (ballot, batch) in enumerate(message["slots"], at):
                if slot == at and slot == self.ledger.length and (message["before"] != self.ledger.hash):
                    self._conflict(message["from"], slot)
                    return
                if slot == self.ledger.length and self.halted is None:
                    self.decided(batch, Ballot.from_json(ballot), mine=False)
        elif message["slot"] == self.ledger.length and not self.consensus.on_chosen(
            Ballot.from_json(message["ballot"])
        ):
            self._pull(message["from"])

    def _take_snapshot(self, record: Record) -> None:
        self.ledger.restore(record)
        self._persist(record)
        self.history.clear(self.ledger.length)
        self.consensus.next_slot(False, set())
        self._after_slot(set(), {})

    # -- the log grows -----------------------------------------------------------------------------

    def decided(self, batch: List[Any], ballot: Ballot, *, mine: bool) -> None:
        """The batch is chosen in the open slot; ``mine``: by our own attempt."""
        slot = self.ledger.length
        self._commit(batch, ballot, mine=mine)
        if mine and self.halted is None:
            self._tell_chosen(slot, ballot, {origin[0] for _, origin, _ in batch})

    def _tell_chosen(self, slot: int, ballot: Ballot, origins: Set[str]) -> None:
        """Tell the others, unless what comes next tells it too."""
        if not self.partial:
            self.consensus.propose(self._now)
            attempt = self.consensus.attempt
            if attempt is not None and attempt.ballot == ballot:
                return
        told = [m for m in self._all_others() if self.partial or m not in origins]
        self.send_all(told, {"kind": "learn", "slot": slot, "ballot": list(ballot)})

    def _all_others(self) -> List[str]:
        return [m for m in self._member_names() if m != self.name]

    def _commit(self, batch: List[Any], ballot: Ballot, *, mine: bool) -> None:
        items = [Item.from_json(i) for i in batch]
        before = self.ledger.hash
        record, step = self.ledger.append(items, ballot)
        slot = record["slot"]
        fresh = [Origin(*o) for o in record["origins"]]
        kept = [i for i in items if i.origin in set(fresh)]
        self.history.add(slot, list(ballot), [i.to_json() for i in kept], before)
        self._persist(record)
        if slot == 0:
            self._first_hash = self.ledger.hash
        returned = {i.entry.robot for i in kept if isinstance(i.entry, log.Join)}
        self.consensus.next_slot(mine, returned)
        self._defeats = 0
        self._hold_since = None
        self._wait_until = None
        if self.partial and not mine:  # several may want the next slot: not all at once
            self._wait_until = self._now + self.pace.backoff * self._draw()
        for firing in step.firings:
            published = mine and not self._was_private(firing, kept)
            self._put(io.Fired(firing, published, self.ledger.hash))
        self._put(*(c for c in step.commands if isinstance(c, (Fault, Ended))))
        self._note_members(kept)
        delays = {
            (c.visit, c.attempt): c.delay
            for c in step.commands
            if isinstance(c, StartAction) and c.robot == self.name and c.delay > 0
        }
        self._after_slot(set(fresh), delays, step)
        if slot and slot % SNAPSHOT_EVERY == 0:
            self._persist(self.ledger.snapshot())

    def _was_private(self, firing: Firing, items: Sequence[Item]) -> bool:
        return any(
            i.private
            and isinstance(i.entry, log.Done)
            and (i.entry.robot, i.entry.incarnation, i.entry.visit) == (firing.robot, firing.incarnation, firing.visit)
            for i in items
        )

    def _note_members(self, items: Sequence[Item]) -> None:
        for item in items:
            entry = item.entry
            if isinstance(entry, log.Join):
                self.forced.discard(entry.robot)
                self.cast_out.discard(entry.robot)
                state = self.ledger.state.robots.get(entry.robot)
                taken = state is not None and state.incarnation == entry.incarnation
                mine = entry.robot == self.name and entry.log == self.log_id
                if mine and not self.active and (taken or self.witness):
                    self._become_active()
            elif isinstance(entry, log.Evict):
                self.forced.discard(entry.robot)
                if entry.forced:
                    self.cast_out.add(entry.robot)

    def _after_slot(
        self,
        fresh: Set[Origin],
        delays: Dict[Tuple[int, int], float],
        step: Optional[Step] = None,
    ) -> None:
        for own in self.pool.prune(self.ledger.is_news):
            if own.order_id:
                self._answer_order(own, own.item.origin in fresh, step)
        state = self._own_state()
        if state is not None and state.incarnation > self.incarnation and self.active:
            self._new_life()  # a Join of a former life of ours, late; a second process would be heard
        self._follow()
        if state is not None and state.phase in GONE and self.ledger.state.ended is None:
            self._on_gone(state)
        self._act(delays)

    def _answer_order(self, own: Own, in_log: bool, step: Optional[Step]) -> None:
        slot = self.ledger.length - 1
        if not in_log:
            self._put(io.OrderResult(own.order_id, False, "was overtaken by a newer one"))
            return
        faults = [
            c.message
            for c in (step.commands if step is not None else ())
            if isinstance(c, Fault) and isinstance(own.item.entry, (log.SetPlace, log.Fire))
        ]
        self._put(io.OrderResult(own.order_id, not faults, "; ".join(faults) or "done, in slot %d of the log" % slot))

    def _follow(self) -> None:
        """Take over where the log says that our robot is; private moves that it rules out are
        void."""
        for own in self.own.follow(self.ledger, self.pool.own):
            self.pool.own.remove(own)
            origin = list(own.item.origin)
            self._persist({"kind": "void", "origin": origin, "why": "the log rules it out"})

    def _on_gone(self, state: RobotState) -> None:
        """The log says that we were evicted, or have left."""
        if state.phase is Phase.LEFT and self.active and state.incarnation == self.incarnation:
            self.leaving = True
        elif self.incarnation <= state.incarnation:
            self.pool.own = [o for o in self.pool.own if o.order_id]
            self._new_life()

    # -- our robot ---------------------------------------------------------------------------------

    def _act(self, delays: Dict[Tuple[int, int], float]) -> None:
        """Start and cancel actions as the log (and our private moves) say."""
        if not self.active or self.fenced or self.halted is not None:
            return
        for command in self.own.commands(self.ledger, delays):
            self._persist(goal_record(command))
            self._put(command)

    def _stop_acting(self) -> None:
        for command in self.own.stop():
            self._persist(goal_record(command))
            self._put(command)

    def _action_ended(self, given: Any) -> None:
        goal = Goal(given.incarnation, given.visit, given.attempt)
        if self.fenced or not self.own.report(goal):
            return
        entry: log.Entry
        if isinstance(given, io.ActionFailed):
            entry = log.Failed(self.name, *goal, given.reason, given.detail)
        else:
            result = given.result if given.result not in (None, "None") else ""
            entry = log.Done(self.name, goal.incarnation, goal.visit, result)
            if self._may_move_alone():
                firing = self.own.move(entry, self.ledger)
                if firing is not None:
                    self._move_alone(entry, firing)
                    return
        self._invoke(entry)

    def _may_move_alone(self) -> bool:
        state = self._own_state()
        return (
            self.partial
            and self.is_settled()
            and state is not None
            and not state.paused
            and not self.ledger.state.paused
            and not self.consensus.is_frozen()
            and all(o.item.private or o.suspect for o in self.pool.own)
        )

    def _move_alone(self, entry: log.Done, firing: Firing) -> None:
        origin = self._next_origin()
        self._persist(
            {
                "kind": "private",
                "entry": log.to_json(entry),
                "origin": list(origin),
                "firing": firing_to_json(firing, self.plan.net),
            }
        )
        self.pool.own.append(Own(Item(entry, origin, True)))
        self._put(io.Fired(firing, True, self.ledger.hash, True))
        self._act({})

    def _next_origin(self) -> Origin:
        self._number += 1
        return Origin(self.name, self.incarnation, self._number, self.log_id[:8])

    def _invoke(self, entry: log.Entry, order_id: str = "", suspect: str = "") -> None:
        """Want a fact in the log."""
        item = Item(entry, self._next_origin())
        if not suspect:  # a suspicion may be withdrawn, and is never taken up again
            origin = list(item.origin)
            self._persist({"kind": "invoked", "entry": log.to_json(entry), "origin": origin})
        self.pool.own.append(Own(item, order_id, suspect))

    # -- the operator ------------------------------------------------------------------------------

    def _order(self, order: io.Order) -> None:
        entry = order.entry
        if isinstance(entry, log.Evict) and entry.incarnation < 0:
            state = self.ledger.state.robots.get(entry.robot)
            entry = entry._replace(incarnation=state.incarnation if state else 0)
        why = self._why_not(entry)
        if why:
            self._put(io.OrderResult(order.order_id, False, why))
        else:
            self._invoke(entry, order.order_id)

    def _why_not(self, entry: log.Entry) -> str:
        """Why an order makes no sense as things stand; "" if it does."""
        if self.ledger.state.ended is not None:
            return "the run is over: %s" % self.ledger.state.ended
        if not self.active or not (self.is_member() or self.witness):
            return "%s is not in the team (yet): %s" % (self.name, self.waits_for())
        if isinstance(entry, log.Leave) and self._member_names() == [entry.robot]:
            return "%s is the last one of the team; stop the run instead" % entry.robot
        robot = getattr(entry, "robot", "")
        state = self.ledger.state.robots.get(robot)
        if robot and (state is None or state.phase in GONE):
            return "there is no robot '%s' in the team" % robot
        if isinstance(entry, log.SetPlace) and entry.place not in self.plan.action_places:
            return "'%s' is not an action place of the plan" % entry.place
        if isinstance(entry, log.Fire) and entry.transition not in self.plan.net.transition_index:
            return "the net has no transition '%s'" % entry.transition
        if isinstance(entry, log.Retry) and state is not None and state.phase.value != "failed":
            return "the action of %s did not fail" % robot
        return ""

    def _force_evict(self, order: io.ForceEvict) -> None:
        state = self.ledger.state.robots.get(order.robot)
        why = ""
        if order.robot == self.name:
            why = "%s cannot assert that it is off itself" % self.name
        elif state is None or state.phase in GONE:
            why = "there is no robot '%s' in the team" % order.robot
        if why or state is None:
            self._put(io.OrderResult(order.order_id, False, why))
            return
        self._note_forced(order.robot)
        self._consider_active()
        self.consensus.abandon()
        self._invoke(log.Evict(order.robot, state.incarnation, True), order.order_id)

    def _note_forced(self, robot: str) -> None:
        if robot != self.name and robot in self._member_names() and robot not in self.forced:
            self.forced.add(robot)
            slot = self.ledger.length
            self._persist({"kind": "forced", "slot": slot, "robots": sorted(self.forced)})

    def _part(self) -> None:
        """End once a quorum of those who stay knows that we have left."""
        members = self._member_names()
        know = [m for m in members if self.peers.get(m).length >= self.ledger.length]
        if members and not is_quorum(know, members):
            return
        self.halted = "%s has left the team" % self.name
        self._put(Ended(self.halted, True))

    # -- time --------------------------------------------------------------------------------------

    def _settle(self) -> None:
        """Do what is due, and say when to look again."""
        if self.halted is None:
            if self._now >= self._next_hello:
                self._next_hello = self._now + (self.pace.heartbeat if self.active else min(self.pace.heartbeat, 0.2))
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

    def _want_to_join(self) -> None:
        """See that the log gets to know this incarnation of ours."""
        if self.fenced or self.leaving or self.ledger.length == 0 or self.is_settled():
            return
        if (self.active and self.witness) or not (self.active or self.forgetful or self.joining):
            return
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
            self._wait_until = None
            return
        if not self.may_vote():
            self._ask_members()
        elif self.partial:
            if self._wait_until is None or self._now >= self._wait_until:
                self._wait_until = None
                consensus.propose(self._now, frozen=self.pool.has_control())
        elif consensus.leads():
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
        others = self._all_others()
        heard = [m for m in others if self.peers.get(m).heard is not None] or others
        if not heard:
            return
        leader = self.consensus.leader
        if self.partial or leader not in heard:
            turn = int(self._now / max(self.pace.takeover, 1e-9))
            leader = heard[turn % len(heard)]
        self._send_event([leader])

    def _send_event(self, to: List[str]) -> None:
        items = [i.to_json() for i in self.own_items()]
        foreign_news = tuple(self.pool.origins())
        told = (tuple(to), self.ledger.length, len(items), foreign_news)
        if told == self._told[:4] and self._now < self._told[4]:
            return
        self._told = (*told, self._now + self.pace.retry)
        extra = self.pool.batch(self._member_names(), frozen=True)
        known = {tuple(i[1]) for i in items}
        items += [i.to_json() for i in extra if tuple(i.origin) not in known]
        self.send_all(to, {"kind": "event", "items": items, "vote": self.may_vote()})

    def _patience(self) -> float:
        members = self._member_names()
        rank = members.index(self.name) if self.name in members else len(members)
        return self.pace.takeover * (1 + 0.25 * rank + 0.5 * self._draw())

    def _draw(self) -> float:
        """A number in [0, 1) that differs from robot to robot and from time to time."""
        counter = self.consensus.highest.counter
        return uniform(self.plan.seed, self.ledger.length, counter, "wait of " + self.name)

    def _give_way(self) -> None:
        """Another's attempt goes first: wait for its outcome."""
        if self.partial:
            wait = self.pace.backoff * 2 ** min(self._defeats, 6) * (1 + self._draw())
        else:
            wait = self._patience()
        self._wait_until = self._now + wait

    def _wake_at(self) -> float:
        times = [self._next_hello]
        again = self.consensus.resend_at(self.pace.retry)
        if again is not None:
            times.append(again)
        elif self._wants():
            if self._wait_until is not None:
                times.append(self._wait_until)
            if self._told and not self.partial or not self.may_vote():
                times.append(self._told[4] if self._told else self._now + self.pace.retry)
        elif self._hold_since is not None:
            times.append(self._hold_since + 2 * self.pace.takeover)
        if self.plan.simulate_environment and self.may_vote():
            due = self._environment.next_time(self.ledger.state, self._now)
            times += [due] if due is not None else []
        return max(self._now + 0.001, min(times))

    # -- telling -----------------------------------------------------------------------------------

    def _fault(self, message: str) -> None:
        self._put(Fault(self.name, message))

    def _halt(self, reason: str) -> None:
        self.halted = reason
        self._stop_acting()
        self._put(io.Halted(reason))

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
            return "waits for an answer of %s" % ", ".join(self.consensus.missing())
        if self._wants() and not self.has_quorum():
            return "waits for a quorum; silent: %s" % ", ".join(self._silent())
        return ""

    def has_quorum(self) -> bool:
        """Whether the members that were heard of late (ourselves included) could decide."""
        electorate = self.electorate()
        near = self.peers.near(electorate, self.name, 4 * self.pace.heartbeat, self._now)
        return is_quorum(near, electorate)

    def _silent(self) -> List[str]:
        near = self.peers.near(self.electorate(), self.name, 4 * self.pace.heartbeat, self._now)
        return [m for m in self.electorate() if m not in near]

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
