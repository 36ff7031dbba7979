"""What waits to get into the log: this robot's proposals, and those that others announced to it.

Owns ``own_proposals``, ``others_proposals`` and ``number``. Reads the electorate (what may go into
the log), puts records and the answers to orders into the outbox.
"""

from __future__ import annotations

from typing import Collection, Dict, Iterable, List, Mapping, Optional, Sequence, Set

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement.config import Config
from gspn_framework_package.execution.agreement.electorate import Electorate
from gspn_framework_package.execution.agreement.messages import Batch
from gspn_framework_package.execution.agreement.outbox import Outbox
from gspn_framework_package.execution.agreement.state import CONTROLS, Proposal, ReplicaState
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.firing import Fault, Firing, firing_to_json
from gspn_framework_package.execution.ledger import Item, Origin
from gspn_framework_package.execution.token_game import Step


class Proposals:
    """The proposals on their way. Those of one origin stay in the order of their numbers."""

    def __init__(
        self, config: Config, state: ReplicaState, outbox: Outbox, electorate: Electorate
    ) -> None:
        self.config = config
        self.state = state
        self.outbox = outbox
        self.electorate = electorate
        self._open: Dict[Origin, Item] = {}  # while our log is read back

    # -- in ----------------------------------------------------------------------------------------

    def propose(self, entry: log_entries.Entry, order_id: str = "", suspect: str = "") -> None:
        """Propose an entry for the log."""
        item = Item(entry, self._next_origin())
        if not suspect:  # a suspicion may be withdrawn, and is never taken up again
            origin = list(item.origin)
            self.outbox.persist(
                {"kind": "invoked", "entry": log_entries.to_json(entry), "origin": origin}
            )
        self.state.own_proposals.append(Proposal(item, order_id, suspect))

    def add_local_transition(self, entry: log_entries.Done, firing: Firing) -> None:
        """A local transition was made, and has to get into the log at some time."""
        origin = self._next_origin()
        self.outbox.persist(
            {
                "kind": "private",
                "entry": log_entries.to_json(entry),
                "origin": list(origin),
                "firing": firing_to_json(firing, self.state.ledger.game.net),
            }
        )
        self.state.own_proposals.append(Proposal(Item(entry, origin, True)))

    def add_others(self, items: Sequence[Item]) -> None:
        """Keep the proposals of others."""
        if not items:
            return
        is_news, others = self.state.ledger.is_news, self.state.others_proposals
        peers, is_of_team = self.state.peers, self.electorate.is_of_team
        for item in self.electorate.without_spares(items):
            robot = item.origin.robot  # a name that nobody has is not kept
            if is_news(item.origin) and (robot in peers.all or is_of_team(robot)):
                others.setdefault(item.origin.robot, {})[item.origin] = item

    def drop_others(self, robot: str) -> None:
        """Drop a robot's proposals."""
        self.state.others_proposals.pop(robot, None)

    def _next_origin(self) -> Origin:
        state = self.state
        state.number += 1
        return Origin(self.config.name, state.incarnation, state.number, state.log_id[:8])

    def begin_life(self) -> None:
        """A new incarnation counts from 1."""
        self.state.number = 0

    # -- out ---------------------------------------------------------------------------------------

    def take_out_decided(self, fresh: Set[Origin], step: Optional[Step]) -> None:
        """Drop what is in the log, and answer the operators who ordered it.

        :param fresh: origins of the slot that was just decided.
        :param step: what it brought about.
        """
        state = self.state
        is_news = state.ledger.is_news
        for robot in list(state.others_proposals):
            kept = {o: i for o, i in state.others_proposals[robot].items() if is_news(o)}
            if kept:
                state.others_proposals[robot] = kept
            else:
                del state.others_proposals[robot]
        gone = [own for own in state.own_proposals if not is_news(own.item.origin)]
        if gone:
            state.own_proposals = [own for own in state.own_proposals if is_news(own.item.origin)]
        for own in gone:
            if own.order_id:
                self._answer(own, own.item.origin in fresh, step)

    def _answer(self, own: Proposal, in_log: bool, step: Optional[Step]) -> None:
        slot = self.state.ledger.length - 1
        if not in_log:
            self.outbox.order_result(own.order_id, False, "was overtaken by a newer one")
            return
        why = self._without_effect(own.item.entry, step)
        self.outbox.order_result(own.order_id, not why, why or "done, in slot %d of the log" % slot)

    def _without_effect(self, entry: log_entries.Entry, step: Optional[Step]) -> str:
        """Why an order in the log changed nothing; "" if it did change something."""
        if isinstance(entry, (log_entries.SetPlace, log_entries.Fire, log_entries.Adopt)):
            return "; ".join(
                c.message
                for c in (step.commands if step is not None else ())
                if isinstance(c, Fault)
            )
        if isinstance(
            entry, (log_entries.Leave, log_entries.Evict)
        ) and self.electorate.members() == [entry.robot]:
            return "%s is the last one of the team, and stays; stop the run instead" % entry.robot
        return ""

    def withdraw_suspicion(self, robots: Iterable[str]) -> None:
        """Withdraw the Evicts for silence of robots that were heard again."""
        heard = set(robots)
        self.state.own_proposals = [
            own for own in self.state.own_proposals if own.suspect not in heard or not own.suspect
        ]

    def withdraw_forced_evictions(self, robot: str, why: str) -> None:
        """Withdraw the evictions by force of a robot that is not off."""
        kept = []
        for own in self.state.own_proposals:
            entry = own.item.entry
            if isinstance(entry, log_entries.Evict) and entry.forced and entry.robot == robot:
                self._persist_void(own, why)
                if own.order_id:
                    self.outbox.order_result(own.order_id, False, why)
            else:
                kept.append(own)
        self.state.own_proposals = kept

    def void(self, own: Proposal, why: str) -> None:
        """A local transition does not hold."""
        self.state.own_proposals.remove(own)
        self._persist_void(own, why)

    def _persist_void(self, own: Proposal, why: str) -> None:
        self.outbox.persist({"kind": "void", "origin": list(own.item.origin), "why": why})

    def keep_orders_only(self) -> None:
        """Our robot is gone: drop its own proposals, but not the operators'."""
        self.state.own_proposals = [o for o in self.state.own_proposals if o.order_id]

    def drop_all(self, why: str) -> None:
        """We forget our log, and everything that was to get into it."""
        for own in self.state.own_proposals:
            if own.order_id:
                self.outbox.order_result(own.order_id, False, why)
        self.state.own_proposals = []
        self.state.others_proposals = {}

    # -- questions ---------------------------------------------------------------------------------

    def own_items(self) -> List[Item]:
        """Our own proposals."""
        return [own.item for own in self.state.own_proposals]

    def origins(self) -> List[str]:
        """The robots whose proposals others announced."""
        return list(self.state.others_proposals)

    def told_of(self, robots: Iterable[str]) -> List[Item]:
        """The announced proposals of these robots."""
        others = self.state.others_proposals
        return [
            item
            for robot in robots
            for item in sorted(others[robot].values(), key=lambda i: i.origin)
        ]

    def has_control(self) -> bool:
        """Whether an order waits that needs every robot to freeze its local transitions."""
        return any(isinstance(own.item.entry, CONTROLS) for own in self.state.own_proposals) or any(
            isinstance(item.entry, CONTROLS)
            for items in self.state.others_proposals.values()
            for item in items.values()
        )

    def batch(
        self,
        frozen: bool,
        unasked: Optional[Mapping[str, bool]] = None,
        accepted: Sequence[Item] = (),
    ) -> Batch:
        """The batch for the open slot.

        :param frozen: nobody makes a local transition until the slot is decided.
        :param unasked: members, as in
            :meth:`~gspn_framework_package.execution.agreement.electorate.Electorate.ends_life`: the
            slot cannot be decided without the entries that end the lives of these.
        :param accepted: what comes first, since somebody voted for it.
        """
        held = {i.origin for i in accepted}
        waiting = self.in_order(frozen or not self.config.partial)
        items = [*accepted, *(i for i in waiting if i.origin not in held)]
        items = self.electorate.with_one_who_stays(self.electorate.without_ghosts(items))
        items = self._without_lost_lives(items, unasked or {})
        most = self.config.limits.batch
        if len(items) > most and unasked:
            needed = self._up_to_those_who_end(items, unasked)
            needed |= {n for n, i in enumerate(items) if i.origin in held}
            items = [items[n] for n in sorted(needed)] + [
                i for n, i in enumerate(items) if n not in needed
            ]
            most = max(most, len(needed))
        return Batch.of(items[:most])

    def batch_without_quorum(
        self, frozen: bool, accepted: Sequence[Item], voters: Collection[str], by_all: bool
    ) -> Optional[Batch]:
        """The batch for a slot that is decided by all but the members that are asserted to be off:
        it evicts these by force; None if it cannot, because of an order before that needs a frozen
        attempt. An eviction may have to be proposed anew: the proposal is lost if the robot stopped
        right after it noted the assertion.

        :param frozen: see :meth:`batch`.
        :param accepted: what somebody accepted, or nothing.
        :param voters: who promised.
        :param by_all: as in
            :meth:`~gspn_framework_package.execution.agreement.electorate.Electorate.may_decide`.
        """
        state = self.state
        off = self.electorate.not_cast_out(voters, (), by_all)
        for robot in sorted(off):
            eviction = log_entries.Evict(robot, state.off[robot], True)
            entries = (own.item.entry for own in state.own_proposals)
            evictions = (e for e in entries if isinstance(e, log_entries.Evict))
            # whoever ordered it
            if all(e._replace(by=log_entries.NOBODY) != eviction for e in evictions):
                self.propose(eviction)
        batch = self.batch(frozen, dict.fromkeys(off, False), accepted)
        return None if self.electorate.not_cast_out(voters, batch.items, by_all) else batch

    def _without_lost_lives(self, items: List[Item], unasked: Mapping[str, bool]) -> List[Item]:
        """A process that lacks the memory of its robot may return with the incarnation that this
        memory had, too. What the latter announced is left out, or the return would never be news:
        if it still exists, it begins another life, and announces it again."""
        returns: Dict[str, Origin] = {}
        for item in items:
            entry = item.entry
            if isinstance(entry, log_entries.Join) and self.electorate.ends_life(entry, unasked):
                returns.setdefault(item.origin.robot, item.origin)

        def is_lost(origin: Origin) -> bool:
            back = returns.get(origin.robot)
            return (
                back is not None
                and origin.incarnation == back.incarnation
                and origin.log != back.log
            )

        return [item for item in items if not is_lost(item.origin)] if returns else items

    def _up_to_those_who_end(self, items: List[Item], unasked: Mapping[str, bool]) -> Set[int]:
        """The numbers of the proposals that end the lives of unasked members, of those of their
        robots before them, and, if orders that local transitions must not pass are among these, of
        the local transitions before them."""
        last: Dict[str, int] = {}
        for number, item in enumerate(items):
            if self.electorate.ends_life(item.entry, unasked):
                last[item.origin.robot] = number
        needed = {n for n, i in enumerate(items) if n <= last.get(i.origin.robot, -1)}
        control = max((n for n in needed if isinstance(items[n].entry, CONTROLS)), default=-1)
        return needed | {n for n, i in enumerate(items) if i.private and n < control}

    def in_order(self, frozen: bool, most: Optional[int] = None) -> List[Item]:
        """The first ``most`` items: for each robot, in the order of the members (others after
        them), first its leading local transitions, then the rest. If not ``frozen``: without the
        orders that need it, and without whatever follows them.
        """
        order = self.electorate.members()
        items: Dict[str, List[Item]] = {}
        for own in self.state.own_proposals:
            items.setdefault(own.item.origin.robot, []).append(own.item)
        for robot, others in self.state.others_proposals.items():
            known = items.setdefault(robot, [])
            held = {i.origin for i in known}
            known += [i for o, i in others.items() if o not in held]
        first: List[Item] = []
        rest: List[Item] = []
        for robot in sorted(items, key=lambda r: (_rank(order, r), r)):
            leading = True
            for item in sorted(items[robot], key=lambda i: i.origin):
                if not frozen and isinstance(item.entry, CONTROLS):
                    break
                leading = leading and item.private
                (first if leading else rest).append(item)
        return (first + rest)[:most]

    # -- our own log, read back --------------------------------------------------------------------

    def recall(self, record: Record) -> None:
        """Take over a record of our own log."""
        kind = record["kind"]
        if kind == "reset":
            self._open.clear()
        elif kind == "void":
            self._open.pop(Origin(*record["origin"]), None)
        else:
            item = Item.from_json([record["entry"], record["origin"], kind == "private"])
            self._open[item.origin] = item

    def recall_is_over(self) -> None:
        """All records were read: what is not in the log still waits."""
        for item in self._open.values():
            if self.state.ledger.is_news(item.origin):
                self.state.own_proposals.append(Proposal(item))
        self._open = {}


def _rank(order: Sequence[str], robot: str) -> int:
    return order.index(robot) if robot in order else len(order)
