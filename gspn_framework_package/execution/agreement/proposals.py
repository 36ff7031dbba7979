"""The entries waiting to get into the log: this robot's proposals, and those announced by others.

Owns ``own_proposals``, ``others_proposals`` and ``number``. Reads the electorate (what may go into
the log), puts records and answers to orders into the outbox.
"""

from __future__ import annotations

from typing import Collection, Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Set

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement.config import Config
from gspn_framework_package.execution.agreement.electorate import Electorate
from gspn_framework_package.execution.agreement.messages import MOST_ITEMS, Batch
from gspn_framework_package.execution.agreement.outbox import Outbox
from gspn_framework_package.execution.agreement.state import (
    Proposal,
    ReplicaState,
    Waiting,
    is_control,
)
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.firing import Fault, Firing, firing_to_json
from gspn_framework_package.execution.ledger import Item, Origin
from gspn_framework_package.execution.team_tasks import TASK_CANCELLED
from gspn_framework_package.execution.token_game import Step

PARTING = (log_entries.SetPlace, log_entries.Leave, log_entries.Evict, log_entries.Stop)
"""The orders that may take a task from its robot; the answer says what becomes of it."""


class ProposalQueue:
    """The waiting proposals. Those of one robot stay in the order of their numbers."""

    def __init__(
        self, config: Config, state: ReplicaState, outbox: Outbox, electorate: Electorate
    ) -> None:
        self.config = config
        self.state = state
        self.outbox = outbox
        self.electorate = electorate
        self._open: Dict[Origin, Item] = {}  # while our log is being read

    # -- adding ------------------------------------------------------------------------------------

    def propose(self, entry: log_entries.Entry, order_id: str = "", suspect: str = "") -> None:
        """Propose an entry for the log."""
        item = Item(entry, self._next_origin())
        if not suspect:  # a suspicion may be withdrawn, and is not restored after a restart
            origin = list(item.origin)
            self.outbox.persist(
                {"kind": "invoked", "entry": log_entries.to_json(entry), "origin": origin}
            )
        self.state.own_proposals.append(Proposal(item, order_id, suspect))

    def add_local_transition(self, entry: log_entries.Done, firing: Firing) -> Origin:
        """Add a local transition that was made and has to get into the log eventually."""
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
        return origin

    def add_others(self, items: Sequence[Item]) -> None:
        """Add the proposals of other robots."""
        if not items:
            return
        is_news, others = self.state.ledger.is_news, self.state.others_proposals
        peers, is_of_team = self.state.peers, self.electorate.is_of_team
        for item in self.electorate.without_spares(items):
            robot = item.origin.robot  # ignore unknown names
            if is_news(item.origin) and (robot in peers.all or is_of_team(robot)):
                others.setdefault(robot, Waiting()).append(Proposal(item))

    def drop_others(self, robot: str) -> None:
        """Drop a robot's proposals."""
        self.state.others_proposals.pop(robot, None)

    def _next_origin(self) -> Origin:
        state = self.state
        state.number += 1
        return Origin(self.config.name, state.incarnation, state.number, state.log_id[:8])

    def begin_life(self) -> None:
        """Restart the numbering at 1 for a new incarnation."""
        self.state.number = 0

    # -- removing ----------------------------------------------------------------------------------

    def take_out_decided(self, fresh: Set[Origin], step: Optional[Step]) -> None:
        """Drop proposals that are now in the log, and answer the operators who ordered them.

        :param fresh: origins of the slot that was just decided.
        :param step: the effects of the slot.
        """
        state = self.state
        is_news = state.ledger.is_news
        others = state.others_proposals
        changed = {o.robot for o in fresh} if step is not None else set(others)
        for robot in changed.intersection(others):
            waiting = others[robot]
            for origin in [o for o in waiting.origins if not is_news(o)]:
                waiting.remove(origin)
            if not waiting:
                del others[robot]
        # each of our incarnations has one log, so proposals that are already known come first
        for own in state.own_proposals.pop_while(lambda origin: not is_news(origin)):
            if own.order_id:
                self._answer(own, own.item.origin in fresh, step)

    def _answer(self, own: Proposal, in_log: bool, step: Optional[Step]) -> None:
        slot = self.state.ledger.length - 1
        if not in_log:
            self.outbox.order_result(own.order_id, False, "was superseded by a newer one")
            return
        entry = own.item.entry
        why = self._without_effect(entry, step)
        text = "done, in slot %d of the log" % slot
        if isinstance(entry, log_entries.ABOUT_TASKS):
            text = self._about_task(entry)
        elif isinstance(entry, PARTING) and step is not None:
            who = getattr(entry, "robot", "")
            faults = [c for c in step.commands if isinstance(c, Fault) and c.about_task]
            text = "; ".join([text, *(c.message for c in faults if c.robot == who)])
        self.outbox.order_result(own.order_id, not why, why or text)

    def _about_task(self, entry: log_entries.TaskOrder) -> str:
        """The effect of an order on a task."""
        ledger = self.state.ledger
        text = ledger.state.whereabouts(entry.id, ledger.game.net)
        if isinstance(entry, log_entries.PrioritiseTask):
            text = "priority %d: %s" % (entry.priority, text)
        elif isinstance(entry, log_entries.GiveBack):
            text = "the task was given back; " + text
        return text

    def _without_effect(self, entry: log_entries.Entry, step: Optional[Step]) -> str:
        """Why an order in the log had no effect; "" if it had one."""
        faults = [c for c in (step.commands if step is not None else ()) if isinstance(c, Fault)]
        why = "; ".join(c.message for c in faults if c.void == entry)
        if why:
            return why
        team = self.state.ledger.state
        if step is not None and entry in step.late:
            return "the run is over: %s" % team.ended
        if isinstance(entry, (log_entries.GiveBack, log_entries.PrioritiseTask)):
            return team.why_not_one_task(entry.id)
        if isinstance(entry, log_entries.CancelTask):
            ended = team.end_of(entry.id)
            cancelled = ended is not None and ended.outcome == TASK_CANCELLED
            return "" if cancelled else team.why_not_one_task(entry.id)
        if isinstance(
            entry, (log_entries.Leave, log_entries.Evict)
        ) and self.electorate.members() == [entry.robot]:
            return "%s is the last robot of the team and stays; stop the run instead" % entry.robot
        return ""

    def withdraw_suspicion(self, robots: Iterable[str]) -> None:
        """Withdraw proposals to evict robots for silence that were heard again."""
        heard, waiting = set(robots), self.state.own_proposals
        for own in [own for own in waiting.asking if own.suspect and own.suspect in heard]:
            waiting.remove(own.item.origin)

    def withdraw_forced_evictions(self, robot: str, why: str) -> None:
        """Withdraw forced evictions of a robot that is not off."""
        for own in list(self.state.own_proposals.asking):
            entry = own.item.entry
            if isinstance(entry, log_entries.Evict) and entry.forced and entry.robot == robot:
                self.void(own, why)
                if own.order_id:
                    self.outbox.order_result(own.order_id, False, why)

    def void(self, own: Proposal, why: str) -> None:
        """Drop a proposal that is void."""
        self.state.own_proposals.remove(own.item.origin)
        self.outbox.persist({"kind": "void", "origin": list(own.item.origin), "why": why})

    def keep_orders_only(self) -> None:
        """Drop our robot's own proposals, because it is gone, but keep the operators'."""
        orders = [own for own in self.state.own_proposals.asking if own.order_id]
        self.state.own_proposals = Waiting()
        for own in orders:
            self.state.own_proposals.append(own)

    def drop_all(self, why: str) -> None:
        """Drop everything, because we discard our log."""
        for own in self.state.own_proposals.asking:
            if own.order_id:
                self.outbox.order_result(own.order_id, False, why)
        self.state.own_proposals = Waiting()
        self.state.others_proposals = {}

    # -- queries ---------------------------------------------------------------------------------

    def own_items(
        self, local: int = MOST_ITEMS, without: Collection[Origin] = frozenset()
    ) -> List[Item]:
        """The first of our own proposals, without gaps, up to a number of local transitions and to
        what a message holds.

        :param without: proposals to leave out.
        """
        items: List[Item] = []
        for own in self.state.own_proposals:
            if local == 0 or len(items) == MOST_ITEMS:
                break
            if own.item.origin not in without:
                items.append(own.item)
                local -= own.item.private
        return items

    def origins(self) -> List[str]:
        """The robots whose announced proposals we hold."""
        return list(self.state.others_proposals)

    def reported_by(self, robots: Iterable[str]) -> List[Item]:
        """The announced proposals of some robots."""
        return [own.item for robot in robots for own in self.state.others_proposals[robot]]

    def has_control(self) -> bool:
        """Whether an order is waiting that needs every robot to freeze its local transitions."""
        return any(is_control(entry) for entry in self._asking())

    def end_lives(self, robots: Mapping[str, bool]) -> bool:
        """Whether a waiting proposal ends the life of one of these members, as in
        :meth:`~gspn_framework_package.execution.agreement.electorate.Electorate.ends_life`."""
        return any(self.electorate.ends_life(entry, robots) for entry in self._asking())

    def _asking(self) -> Iterator[log_entries.Entry]:
        """All waiting proposals except local transitions."""
        waiting = (self.state.own_proposals, *self.state.others_proposals.values())
        return (own.item.entry for one in waiting for own in one.asking)

    def batch(
        self,
        frozen: bool,
        unasked: Optional[Mapping[str, bool]] = None,
        accepted: Sequence[Item] = (),
    ) -> Batch:
        """The batch for the open slot.

        :param frozen: no robot makes a local transition until the slot is decided, and all earlier
            ones are known.
        :param unasked: members, as in
            :meth:`~gspn_framework_package.execution.agreement.electorate.Electorate.ends_life`: the
            slot must contain the entries that end their lives.
        :param accepted: items that come first, since they have been voted for.
        """
        held = {i.origin for i in accepted}
        most = self.config.limits.batch
        whole = frozen or bool(unasked) or not self.config.partial
        waiting = self.in_order(
            frozen or not self.config.partial, local=None if whole else most + len(held)
        )
        items = [*accepted, *(i for i in waiting if i.origin not in held)]
        items = self.electorate.with_one_who_stays(self.electorate.without_ghosts(items))
        items = self._without_lost_lives(items, unasked or {})
        if frozen and self.config.partial:  # in the same slot as the order for which they wait
            most = min(MOST_ITEMS, most + sum(i.private for i in items))
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
        """The batch for a slot that is decided without the members asserted to be off: it evicts
        these by force. None if it cannot, because an earlier order needs a frozen attempt. An
        eviction may have to be proposed again: the proposal is lost if the robot stopped right
        after it noted the assertion.

        :param frozen: see :meth:`batch`.
        :param accepted: a batch that was accepted before, if any.
        :param voters: the robots that promised.
        :param by_all: as in
            :meth:`~gspn_framework_package.execution.agreement.electorate.Electorate.may_decide`.
        """
        state = self.state
        off = self.electorate.not_cast_out(voters, (), by_all)
        for robot in sorted(off):
            eviction = log_entries.Evict(robot, state.off[robot], True)
            entries = (own.item.entry for own in state.own_proposals.asking)
            evictions = (e for e in entries if isinstance(e, log_entries.Evict))
            # by whichever robot
            if all(e._replace(by=log_entries.NOBODY) != eviction for e in evictions):
                self.propose(eviction)
        batch = self.batch(frozen, dict.fromkeys(off, False), accepted)
        return None if self.electorate.not_cast_out(voters, batch.items, by_all) else batch

    def _without_lost_lives(self, items: List[Item], unasked: Mapping[str, bool]) -> List[Item]:
        """Leave out announcements from lost memories: a process that lacks its robot's memory may
        return with the same incarnation that the memory had, and those announcements would hide its
        return. If the memory still exists, it begins another life and announces its proposals
        again."""
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
        """How many proposals to take of each robot so that the lives of unasked members end;
        includes local transitions that precede an order which they must not pass."""
        last: Dict[str, int] = {}
        for number, item in enumerate(items):
            if self.electorate.ends_life(item.entry, unasked):
                last[item.origin.robot] = number
        needed = {n for n, i in enumerate(items) if n <= last.get(i.origin.robot, -1)}
        control = max((n for n in needed if is_control(items[n].entry)), default=-1)
        return needed | {n for n, i in enumerate(items) if i.private and n < control}

    def in_order(self, frozen: bool, local: Optional[int] = None) -> List[Item]:
        """All waiting proposals: for each robot, in the order of the members (then others), first
        its leading local transitions, then the rest. If not ``frozen``, without the orders that
        need a frozen slot and everything after them.

        :param local: take at most this many local transitions of members, and nothing after them.
        """
        order, others = self.electorate.members(), self.state.others_proposals
        first: List[Item] = []
        rest: List[Item] = []
        for robot in sorted({self.config.name, *others}, key=lambda r: (_rank(order, r), r)):
            leading = True
            for own in self._waiting_of(robot):
                item = own.item
                if not frozen and is_control(item.entry):
                    break
                leading = leading and item.private
                (first if leading else rest).append(item)
                if len(first) == local and robot in order:
                    return first
        return first + rest

    def _waiting_of(self, robot: str) -> Iterable[Proposal]:
        """The waiting proposals of a robot; for ours, including those of another process of its
        name."""
        received = self.state.others_proposals.get(robot, ())
        if robot != self.config.name:
            return received
        own = self.state.own_proposals
        if not received:
            return own
        more = [p for p in received if p.item.origin not in own]
        return sorted([*own, *more], key=lambda p: p.item.origin)

    # -- reading our own log --------------------------------------------------------------------

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
        """Finish reading: proposals that are not in the agreed log are still waiting."""
        for item in self._open.values():
            if self.state.ledger.is_news(item.origin):
                self.state.own_proposals.append(Proposal(item))
        self._open = {}


def _rank(order: Sequence[str], robot: str) -> int:
    return order.index(robot) if robot in order else len(order)
