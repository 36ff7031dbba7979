"""Deliberate faults in the protocol, the token game and the host, to confirm that they are caught.

A simulation and a checker that find no fault prove nothing unless they find planted ones. Each
mutant breaks one rule on purpose; :func:`hunt` runs schedules until one fails.
"""

from __future__ import annotations

import contextlib
import random
from typing import (
    Any,
    Callable,
    ContextManager,
    Dict,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
)
from unittest import mock

from gspn_framework_package.execution import log_entries, plan_change, turn
from gspn_framework_package.execution import token_game as token_game_module
from gspn_framework_package.execution.agreement import electorate as electorate_module
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement import membership as membership_module
from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.deployment import Deployment
from gspn_framework_package.execution.agreement.electorate import Electorate
from gspn_framework_package.execution.agreement.local_robot import LocalRobot
from gspn_framework_package.execution.agreement.local_transitions import LocalTransitions
from gspn_framework_package.execution.agreement.membership import Membership
from gspn_framework_package.execution.agreement.outbox import Outbox
from gspn_framework_package.execution.agreement.peers import Peers
from gspn_framework_package.execution.agreement.proposals import Proposals
from gspn_framework_package.execution.agreement.quorum import Ballot, is_quorum
from gspn_framework_package.execution.agreement.reactions import Reactions
from gspn_framework_package.execution.agreement.recent_slots import RecentSlots
from gspn_framework_package.execution.agreement.recovery import Recovery
from gspn_framework_package.execution.agreement.replica import Replica
from gspn_framework_package.execution.agreement.replication import Replication
from gspn_framework_package.execution.agreement.state import ReplicaState
from gspn_framework_package.execution.agreement_simulation.schedule import Schedule, run_schedule
from gspn_framework_package.execution.agreement_simulation.world import (
    SimulatedNode,
    ViolationError,
)
from gspn_framework_package.execution.ledger import Ledger
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.net import Net


class Mutant(NamedTuple):
    """A deliberate fault: the ``part`` of the program that it is in, a ``text`` that describes it,
    ``apply``, which patches it in, and whether it shows in ``partial`` synchronisation or full
    (None: in both)."""

    name: str
    part: str
    text: str
    apply: Callable[[], ContextManager[Any]]
    partial: Optional[bool] = None
    robots: int = 3
    """The number of robots in most of the teams."""
    kinds: Sequence[str] = ("",)
    """The kinds of schedules in which it shows."""


class Caught(NamedTuple):
    """The outcome of a hunt: the number of schedules until the mutant was caught (None: not
    caught), the schedule that caught it, and the message."""

    schedules: Optional[int]
    schedule: str
    text: str


def hunt(
    mutant: Mutant, limit: int, first_seed: int = 0, sizes: Sequence[int] = (2, 3, 5)
) -> Caught:
    """Run schedules with the mutant until one fails.

    :param limit: the maximum number of schedules.
    :param first_seed: the seed of the first one; each further seed is one higher.
    :param sizes: team sizes to draw from, besides the mutant's own, which counts twice.
    """
    with mutant.apply():
        for i in range(limit):
            seed = first_seed + i
            source = random.Random("mutants|%d" % seed)
            robots = source.choice([*sizes, mutant.robots, mutant.robots])
            partial = source.random() < 0.5 if mutant.partial is None else mutant.partial
            schedule = Schedule(seed, robots, partial, source.choice(list(mutant.kinds)))
            try:
                run_schedule(schedule)
            except ViolationError as error:
                return Caught(i + 1, str(schedule), str(error))
            except Exception as error:  # a mutant may crash the program itself: also caught
                return Caught(i + 1, str(schedule), "%s: %s" % (type(error).__name__, error))
    return Caught(None, "", "not caught in %d schedules" % limit)


@contextlib.contextmanager
def _all(*patches: ContextManager[Any]) -> Iterator[None]:
    with contextlib.ExitStack() as stack:
        for patch in patches:
            stack.enter_context(patch)
        yield


def _wrap(owner: Any, name: str, make: Callable[[Any], Any]) -> ContextManager[Any]:
    return mock.patch.object(owner, name, make(getattr(owner, name)))


# -- protocol --------------------------------------------------------------------------------------


def _bare_half() -> ContextManager[Any]:
    def half(voters: Any, members: Sequence[str]) -> bool:
        return 2 * sum(1 for m in members if m in voters) >= len(members)

    return _all(
        mock.patch.object(electorate_module, "is_quorum", half),
        mock.patch.object(membership_module, "is_quorum", half),
    )


def _forgets_promises() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_accept(self: Consensus, message: Any, body: Any) -> None:
            self.state.promised = min(self.state.promised, body.ballot)
            original(self, message, body)

        return on_accept

    return _wrap(Consensus, "on_accept", make)


def _ignores_accepted() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_promise(self: Consensus, message: Any, body: Any, now: float) -> None:
            original(self, message, body._replace(accepted=None), now)

        return on_promise

    return _wrap(Consensus, "on_promise", make)


def _amnesia() -> ContextManager[Any]:
    return mock.patch.object(Consensus, "restore", lambda self, record, slot: None)


def _counts_any_vote() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_accepted(self: Consensus, message: Any, body: Any, now: float) -> None:
            ledger, attempt = self.state.ledger, self.state.attempt
            if attempt is not None:
                body = body._replace(ballot=attempt.ballot, slot=ledger.length)
            original(self, message._replace(hash=ledger.hash), body, now)

        return on_accepted

    return _wrap(Consensus, "on_accepted", make)


def _keeps_leading() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def _promise(self: Consensus, ballot: Ballot) -> None:
            state = self.state
            followers, promised = state.followers, state.promised
            original(self, ballot)
            if followers is not None and ballot.robot != self.config.name:
                state.followers, state.promised = followers, promised

        return _promise

    return _wrap(Consensus, "_promise", make)


def _believes_any_next() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_accept(self: Consensus, message: Any, body: Any) -> None:
            held = self.state.accepted
            if held is not None and body.slot == self.state.ledger.length + 1:
                self.log.decided(held[1], held[0], mine=False)
            original(self, message, body)

        return on_accept

    return _wrap(Consensus, "on_accept", make)


def _votes_without_memory() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def consider_active(self: Membership) -> None:
            if not self.state.active and not self.state.joining and self.state.ledger.length:
                self.become_active()

        return consider_active

    return _wrap(Membership, "consider_active", make)


def _no_deduplication() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def append(self: Ledger, items: Any, ballot: Any = None) -> Any:
            self.seen = {}
            return original(self, items, ballot)

        return append

    return _wrap(Ledger, "append", make)


def _asks_only_a_quorum() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def first_phase_over(self: Consensus) -> bool:
            if self.state.attempt is not None:
                self.state.attempt.answered |= set(self.electorate.members())
            return bool(original(self))

        return first_phase_over

    return _wrap(Consensus, "_first_phase_over", make)


def _does_not_freeze() -> ContextManager[Any]:
    return mock.patch.object(ReplicaState, "is_frozen", lambda self: False)


def _everything_private() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def init(self: LocalTransitions, game: TokenGame, robot: str) -> None:
            original(self, game, robot)
            resources = game.plan.resource_places
            for t, ends in enumerate(game.net.outputs):
                places = [
                    p for p, _ in game.net.inputs[t] if game.net.places[p].name not in resources
                ]
                targets = [p for p, _ in ends if game.net.places[p].name not in resources]
                if len(places) == 1 and targets and game.net.transitions[t].timed:
                    self._target[places[0], t] = targets[0]

        return init

    return _wrap(LocalTransitions, "__init__", make)


def _drops_proposals() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_nack(self: Consensus, body: Any) -> bool:
            beaten = bool(original(self, body))
            if beaten:
                self.state.own_proposals = []
            return beaten

        return on_nack

    return _wrap(Consensus, "on_nack", make)


# -- token game ------------------------------------------------------------------------------------


def _no_visit_check() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def current(self: Any, name: str, incarnation: int, visit: int) -> Any:
            robot = self.state.robots.get(name)
            return original(self, name, incarnation, robot.visit if robot else visit)

        return current

    owner = next(
        c for c in vars(token_game_module).values() if isinstance(c, type) and "_current" in vars(c)
    )
    return _wrap(owner, "_current", make)


def _last_comes_first() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def add_waiting(self: TeamState, robot: Any) -> None:
            original(self, robot)
            self.waiting = {robot.name: None, **self.waiting}
            here = self.done_in[robot.place]
            self.done_in[robot.place] = {robot.name: None, **here}

        return add_waiting

    return _wrap(TeamState, "add_waiting", make)


def _local_randomness() -> ContextManager[Any]:
    return mock.patch.object(turn, "uniform", lambda *_: random.random())


def _biased_draw() -> ContextManager[Any]:
    return mock.patch.object(turn, "choose", lambda choices, number: choices[0][0])


def _forgets_inhibitors() -> ContextManager[Any]:
    def careless(self: Net, marking: Sequence[int], t: int) -> bool:
        return all(marking[p] >= weight for p, weight in self.inputs[t])

    return mock.patch.object(Net, "is_enabled", careless)


# -- host ------------------------------------------------------------------------------------------


def _writes_late() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def carry_out(self: SimulatedNode, effects: List[interface.Effect]) -> None:
            late = [e for e in effects if isinstance(e, interface.Persist)]
            original(self, [e for e in effects if not isinstance(e, interface.Persist)] + late)

        return carry_out

    return _wrap(SimulatedNode, "carry_out", make)


def _starts_goals_twice() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def commands(self: LocalRobot, delays: Any) -> Any:
            out = original(self, delays)
            if random.Random(self.state.ledger.length).random() < 0.05:
                self.state.started = None
            return out

        return commands

    return _wrap(LocalRobot, "_commands", make)


def _acts_before_joining() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def commands(self: LocalRobot, delays: Any) -> Any:
            mine = self.state.incarnation
            if self.state.position is not None:
                self.state.incarnation = self.state.position.incarnation
            try:
                return original(self, delays)
            finally:
                self.state.incarnation = mine

        return commands

    return _wrap(LocalRobot, "_commands", make)


def _wrong_results() -> ContextManager[Any]:
    """The host mixes up results: it reports the previous visit's result for the current one."""
    last: Dict[str, str] = {}

    def make(original: Any) -> Any:
        def propose(
            self: Proposals, entry: log_entries.Entry, order_id: str = "", suspect: str = ""
        ) -> None:
            original(self, entry, order_id, suspect)
            name, own = self.config.name, self.state.own_proposals
            if isinstance(entry, log_entries.Done):
                before = last.get(name, entry.result)
                last[name] = entry.result
                item = own[-1].item._replace(entry=entry._replace(result=before))
                own[-1] = own[-1]._replace(item=item)

        return propose

    return _wrap(Proposals, "propose", make)


# -- memory, operators, limits ---------------------------------------------------------------------


def _persists_no_promise() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def persist(self: Outbox, record: Any, *, durable: bool = False) -> None:
            if record["kind"] != "promised":
                original(self, record, durable=durable)

        return persist

    return _wrap(Outbox, "persist", make)


def _keeps_returned() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def next_slot(self: Consensus, keep_lead: bool, returned: Any) -> None:
            original(self, keep_lead, set())

        return next_slot

    return _wrap(Consensus, "next_slot", make)


def _thaws_with_a_nack() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_nack(self: Consensus, body: Any) -> bool:
            beaten = bool(original(self, body))
            if beaten:
                self.state.frozen_by = None
            return beaten

        return on_nack

    return _wrap(Consensus, "on_nack", make)


def _asks_again_without_freezing() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def resend(self: Consensus, now: float) -> None:
            if self.state.attempt is not None:
                self.state.attempt.frozen = False
            original(self, now)

        return resend

    return _wrap(Consensus, "resend", make)


def _numbers_only() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def is_news(self: Ledger, origin: Any) -> bool:
            known = self.seen.get(origin.robot)
            return known is None or origin.number > known[1]

        return is_news

    return _wrap(Ledger, "is_news", make)


def _evicts_alone() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def accusers(self: Peers, robot: str) -> Any:
            return set(self.all)

        return accusers

    return _wrap(Peers, "accusers", make)


def _leaves_at_once() -> ContextManager[Any]:
    return mock.patch.object(membership_module, "LINGER", 0)


def _counts_its_own_sleep() -> ContextManager[Any]:
    return mock.patch.object(
        Peers, "listen_anew", lambda self, now: setattr(self, "since", min(self.since, now))
    )


def _skips_a_slot_of_a_chunk() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def since(self: RecentSlots, slot: int) -> Any:
            slots = original(self, slot)
            return slots[:-1] if slots is not None and len(slots) >= self._chunk else slots

        return since

    return _wrap(RecentSlots, "since", make)


def _newest_first() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def batch(self: Proposals, frozen: bool) -> Any:
            limits = self.config.limits
            self.config.limits = limits._replace(batch=10**6)
            try:
                items = original(self, frozen)
            finally:
                self.config.limits = limits
            return items[-limits.batch :]

        return batch

    return _wrap(Proposals, "batch", make)


def _off_for_ever() -> ContextManager[Any]:
    def asserted_off(self: Electorate) -> Any:
        return {name for name in self.state.off if name in self.members()}

    return _all(
        mock.patch.object(Electorate, "asserted_off", asserted_off),
        mock.patch.object(Membership, "_heard_though_off", lambda self, robot: None),
    )


def _any_of_those_left() -> ContextManager[Any]:
    """As in a former version, the remaining members decide by their own quorum."""

    def may_decide(self: Electorate, voters: Any) -> bool:
        off = self.asserted_off()
        return is_quorum(voters, [m for m in self.members() if m not in off])

    return mock.patch.object(Electorate, "may_decide", may_decide)


def _forgets_who_was_cast_out() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def resume(self: Recovery, records: Any) -> None:
            original(self, records)
            self.state.ledger.cast_out.clear()

        return resume

    return _wrap(Recovery, "resume", make)


def _counts_any_log() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def knows(self: Membership, message: Any) -> bool:
            original(self, message)
            self.state.peers.get(message.sender).surprise = None
            return True

        return knows

    return _all(
        _wrap(Membership, "_knows", make),
        mock.patch.object(Electorate, "is_our_name", lambda self: True),
    )


def _ballots_without_log() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def propose(self: Consensus, now: float, frozen: bool = False) -> None:
            log_id, self.state.log_id = self.state.log_id, ""
            try:
                original(self, now, frozen)
            finally:
                self.state.log_id = log_id

        return propose

    return _wrap(Consensus, "propose", make)


def _trusts_every_end() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def init(self: Replica, *given: Any, **named: Any) -> None:
            original(self, *given, **dict(named, trusted=True))

        return init

    return _wrap(Replica, "__init__", make)


def _never_waits_for_the_disk() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def persist(self: Outbox, record: Any, *, durable: bool = False) -> None:
            original(self, record)

        return persist

    return _wrap(Outbox, "persist", make)


def _waits_for_votes_only_sometimes() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def persist(self: Outbox, record: Any, *, durable: bool = False) -> None:
            original(self, record, durable=durable and record["kind"] != "accepted")

        return persist

    return _wrap(Outbox, "persist", make)


def _keeps_its_log_id() -> ContextManager[Any]:
    return mock.patch.object(Membership, "_renew_log_id", lambda self: None)


def _acts_before_it_knows_more() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def consider(self: Membership) -> None:
            peers = self.state.peers
            lengths = {name: peer.length for name, peer in peers.all.items()}
            for peer in peers.all.values():
                peer.length = 0
            original(self)
            for name, length in lengths.items():
                peers.get(name).length = length

        return consider

    return _wrap(Membership, "consider_active", make)


def _snapshot_without(field: str) -> Callable[[], ContextManager[Any]]:
    def apply() -> ContextManager[Any]:
        def make(original: Any) -> Any:
            def snapshot(self: Ledger) -> Any:
                return {**original(self), field: {}}

            return snapshot

        return _wrap(Ledger, "snapshot", make)

    return apply


def _keeps_promised_low() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def on_accept(self: Consensus, message: Any, body: Any) -> None:
            promised = self.state.promised
            original(self, message, body)
            self.state.promised = promised

        return on_accept

    return _wrap(Consensus, "on_accept", make)


def _learns_what_it_holds() -> ContextManager[Any]:
    def on_chosen(self: Consensus, ballot: Ballot) -> bool:
        held = self.state.accepted
        if held is None:
            return False
        self.log.decided(held[1], held[0], mine=False)
        return True

    return mock.patch.object(Consensus, "on_chosen", on_chosen)


def _moves_while_paused() -> ContextManager[Any]:
    def may(self: LocalRobot) -> bool:
        return self.config.partial and self.electorate.is_settled() and not self.state.is_frozen()

    return mock.patch.object(LocalRobot, "_may_move_alone", may)


def _drops_the_first_proposal() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def batch(self: Proposals, frozen: bool) -> Any:
            items = original(self, frozen)
            return items[1:] if len(items) > 1 else items

        return batch

    return _wrap(Proposals, "batch", make)


def _reads_no_facts_back() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def resume(self: Recovery, records: Any) -> None:
            original(self, [r for r in records if r["kind"] != "private"])

        return resume

    return _wrap(Recovery, "resume", make)


def _takes_its_former_incarnation() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def new_life(self: Membership) -> None:
            before = self.state.incarnation
            original(self)
            if self.state.records > 1:
                self.state.incarnation = before

        return new_life

    return _wrap(Membership, "new_life", make)


def _pulls_without_looking() -> ContextManager[Any]:
    """A replica takes over slots without checking that they follow from its own log."""

    def make(original: Any) -> Any:
        def on_learn(self: Replication, message: Any, body: Any) -> None:
            ledger = self.state.ledger
            if body.slots:
                slots = tuple((b, batch, ledger.hash) for b, batch, _ in body.slots[:1])
                body = body._replace(at=ledger.length, slots=slots)
            original(self, message, body)

        return on_learn

    return _wrap(Replication, "on_learn", make)


# -- events, tasks, data ---------------------------------------------------------------------------

_Reducer: Any = token_game_module._Reducer


def _interrupts_any_visit() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def event(self: Any, entry: log_entries.Interrupt) -> None:
            robot = self.state.robots.get(entry.robot)
            original(self, entry._replace(visit=robot.visit) if robot else entry)

        return event

    return _wrap(_Reducer, "_event", make)


def _result_after_interrupt() -> ContextManager[Any]:
    """A result counts although an event has interrupted its action."""

    def make(original: Any) -> Any:
        def current(self: Any, name: str, incarnation: int, visit: int) -> Any:
            robot = self.state.robots.get(name)
            if robot is not None and robot.interrupted and visit == robot.visit - 1:
                visit = robot.visit
            return original(self, name, incarnation, visit)

        return current

    return _wrap(_Reducer, "_current", make)


def _forgets_held_events() -> ContextManager[Any]:
    return mock.patch.object(turn.Turn, "_fire_held", lambda self: False)


def _holds_for_ever() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def enter(self: Any, robot: Any) -> None:
            held = robot.held
            original(self, robot)
            robot.held = held

        return enter

    return _wrap(turn.Turn, "_enter", make)


def _pause_loses_events() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def event(self: Any, entry: log_entries.Interrupt) -> None:
            robot = self.state.robots.get(entry.robot)
            if not self.state.paused and not (robot and robot.paused):
                original(self, entry)

        return event

    return _wrap(_Reducer, "_event", make)


def _interrupts_in_a_pause() -> ContextManager[Any]:
    return mock.patch.object(
        TokenGame,
        "may_interrupt",
        lambda self, state, robot, t: self.net.is_enabled(state.marking, t),
    )


def _loses_causes() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def interrupt(self: Any, robot: Any, t: int, cause: Any) -> None:
            original(self, robot, t, log_entries.NOTHING)

        return interrupt

    return _wrap(turn.Turn, "_interrupt", make)


def _continues_again() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def enter(self: Any, robot: Any) -> None:
            interrupted = dict(robot.interrupted)
            original(self, robot)
            robot.interrupted = interrupted

        return enter

    return _wrap(turn.Turn, "_enter", make)


def _takes_tasks_again() -> ContextManager[Any]:
    return mock.patch.object(TeamState, "is_known", lambda self, t, task: False)


def _tasks_first() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def requested(self: Any) -> bool:
            return bool(self._fire_submitted() or original(self))

        return requested

    return _wrap(turn.Turn, "_fire_requested", make)


def _newest_task_first() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def pass_tasks(self: Any, *given: Any) -> Any:
            queues = self.state.queues
            for p in queues:
                queues[p] = queues[p][::-1]
            try:
                return original(self, *given)
            finally:
                for p in queues:
                    queues[p] = queues[p][::-1]

        return pass_tasks

    return _wrap(turn.Turn, "_pass_tasks", make)


def _never_done() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def init(self: TokenGame, *given: Any, **named: Any) -> None:
            original(self, *given, **named)
            self.task_done = frozenset()

        return init

    return _wrap(TokenGame, "__init__", make)


def _keeps_what_it_gives_back() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def give_back(self: Any, robot: Any, marking: Any) -> None:
            task = robot.task
            original(self, robot, marking)
            robot.task = task

        return give_back

    return _wrap(_Reducer, "_give_back", make)


def _returns_to_the_end() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def give_back(self: Any, robot: Any, marking: Any) -> None:
            original(self, robot, marking)
            for p, queue in self.state.queues.items():
                self.state.queues[p] = queue[1:] + queue[:1]

        return give_back

    return _wrap(_Reducer, "_give_back", make)


def _last_writer_loses() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def write(self: Any, robot: Any, data: Any) -> bool:
            mine = {n: v for n, v in data.items() if n[5:] not in self.state.data}
            return bool(original(self, robot, mine))

        return write

    return _wrap(turn.Turn, "_write", make)


def _reads_ahead() -> ContextManager[Any]:
    """An action reads what its robot is about to write."""

    def make(original: Any) -> Any:
        def given(self: LocalRobot, at: Any) -> Any:
            data, resumed = original(self, at)
            for own in self.state.own_proposals:
                for name, value in getattr(own.item.entry, "data", {}).items():
                    data = {**data, "robot." + name.split(".")[-1]: value}
            return data, resumed

        return given

    return _wrap(LocalRobot, "_given", make)


def _reads_late() -> ContextManager[Any]:
    """An action reads the data of the goal before."""
    last: Dict[str, Any] = {}

    def make(original: Any) -> Any:
        def given(self: LocalRobot, at: Any) -> Any:
            data, resumed = original(self, at)
            name = self.config.name
            before = last.get(name, data)
            last[name] = data
            return before, resumed

        return given

    return _wrap(LocalRobot, "_given", make)


def _continues_ahead_again() -> ContextManager[Any]:
    return mock.patch.object(LocalRobot, "_places_ahead", lambda self, robot, visit: [])


def _writes_no_offer() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def persist(self: Outbox, record: Any, *, durable: bool = False) -> None:
            if record["kind"] != "offered":
                original(self, record, durable=durable)

        return persist

    return _wrap(Outbox, "persist", make)


def _reads_no_offers_back() -> ContextManager[Any]:
    return mock.patch.object(Reactions, "recall", lambda self, record: None)


def _leaves_tasks_to_the_first() -> ContextManager[Any]:
    return mock.patch.object(Reactions, "_patience", lambda self: 1e9)


def _takes_tasks_for_known() -> ContextManager[Any]:
    """A robot forgets a task once it has proposed it."""

    def make(original: Any) -> Any:
        def want(self: Reactions) -> None:
            original(self)
            for key in self._proposed():
                self.state.offered.pop(key, None)

        return want

    return _wrap(Reactions, "want_tasks", make)


def _snapshot_of_state_without(key: str) -> Callable[[], ContextManager[Any]]:
    def apply() -> ContextManager[Any]:
        def make(original: Any) -> Any:
            def to_json(self: TeamState, net: Net) -> Any:
                data = original(self, net)
                data.pop(key, None)
                for robot in data["robots"]:
                    robot.pop(key, None)
                return data

            return to_json

        return _wrap(TeamState, "to_json", make)

    return apply


_REACT = ("react", "react-operator", "react-calm")
_SNAPSHOTS = ("react-tight", "react-archive")


def _reacting(
    name: str,
    text: str,
    apply: Callable[[], ContextManager[Any]],
    partial: Optional[bool] = None,
    kinds: Sequence[str] = _REACT,
) -> Mutant:
    return Mutant(name, "reactions", text, apply, partial, kinds=kinds)


# -- another plan ----------------------------------------------------------------------------------


def _adopts_without_votes() -> ContextManager[Any]:
    return mock.patch.object(plan_change, "vote_of", lambda state, member: "")


def _keeps_old_names() -> ContextManager[Any]:
    return mock.patch.object(token_game_module._Reducer, "_now", lambda self, name: name)


def _fills_resources_again() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def new_marking(state: Any, old: Any, new: Any, names: Any) -> Dict[str, int]:
            marking: Dict[str, int] = original(state, old, new, names)
            initial = {p.name: p.tokens for p in new.net.places if p.name in new.resource_places}
            return {**marking, **initial}

        return new_marking

    return _wrap(plan_change, "new_marking", make)


def _lets_requests_stand() -> ContextManager[Any]:
    def leave_out(self: Any, asked: Any) -> None:
        self.state.waiting.clear()
        self.state.done_in.clear()
        for name in asked:
            if self.state.robots[name].phase is Phase.DONE:
                self.state.add_waiting(self.state.robots[name])

    return mock.patch.object(token_game_module._Reducer, "_ask_anew", leave_out)


def _plans_without(key: str) -> Callable[[], ContextManager[Any]]:
    def make(original: Any) -> Any:
        def to_json(self: TeamState) -> Dict[str, Any]:
            return {k: v for k, v in original(self).items() if k != key}

        return to_json

    return lambda: _wrap(TeamState, "_plans_to_json", make)


def _acts_by_the_first_plan() -> ContextManager[Any]:
    return mock.patch.object(LocalRobot, "follow_plan", lambda self: None)


def _never_votes_again() -> ContextManager[Any]:
    return mock.patch.object(
        Deployment, "_has_voted", lambda self, staged: self.config.name in staged.votes
    )


_DEPLOYED = ("deploy-tight", "deploy-archive")


def _deploying(
    name: str,
    text: str,
    apply: Callable[[], ContextManager[Any]],
    kinds: Sequence[str] = ("deploy", "deploy-calm"),
) -> Mutant:
    """A fault in putting another plan into the team."""
    return Mutant(name, "deployment", text, apply, kinds=kinds)


MUTANTS = [
    Mutant("bare half", "protocol", "exactly half of the members is a quorum", _bare_half),
    Mutant("promises", "protocol", "an acceptor does not keep its promises", _forgets_promises),
    Mutant(
        "accepted values",
        "protocol",
        "a proposer ignores what others have accepted",
        _ignores_accepted,
    ),
    Mutant("amnesia", "protocol", "promises and votes are not read back after a restart", _amnesia),
    Mutant("any vote", "protocol", "votes of other slots and ballots count", _counts_any_vote),
    Mutant(
        "keeps leading",
        "protocol",
        "a leader does not notice that it was replaced",
        _keeps_leading,
        False,
    ),
    Mutant(
        "any next",
        "protocol",
        "any Accept of the next slot confirms what was held",
        _believes_any_next,
        False,
        5,
    ),
    Mutant(
        "no memory", "protocol", "a robot that lost its log votes at once", _votes_without_memory
    ),
    Mutant("repeats", "protocol", "repeated entries are not left out", _no_deduplication),
    Mutant(
        "dropped proposals",
        "protocol",
        "a proposer that gives way forgets its proposals",
        _drops_proposals,
    ),
    Mutant(
        "quorum only",
        "partial",
        "the first phase does not wait for every member",
        _asks_only_a_quorum,
        True,
        kinds=("freeze",),
    ),
    Mutant(
        "no freeze",
        "partial",
        "local transitions do not stop for orders",
        _does_not_freeze,
        True,
        kinds=("freeze",),
    ),
    Mutant(
        "all private",
        "partial",
        "transitions that touch resources count as local",
        _everything_private,
        True,
    ),
    Mutant(
        "visit check",
        "token game",
        "a Done of any visit counts for the present one",
        _no_visit_check,
    ),
    Mutant("order", "token game", "the robot done last moves first", _last_comes_first),
    Mutant("local dice", "token game", "draws are local randomness", _local_randomness),
    Mutant("loaded dice", "token game", "the first choice is always drawn", _biased_draw),
    Mutant(
        "enabling",
        "token game",
        "inhibitor arcs and capacities are not looked at",
        _forgets_inhibitors,
    ),
    Mutant("late writes", "host", "records are written after the messages went out", _writes_late),
    Mutant("two goals", "host", "a goal now and then goes out twice", _starts_goals_twice),
    Mutant(
        "early goals", "host", "a restarted robot acts before the team knows", _acts_before_joining
    ),
    Mutant("mixed results", "host", "a result is given for the wrong visit", _wrong_results),
    Mutant("lost promises", "memory", "promises are not written down", _persists_no_promise),
    Mutant(
        "returned followers",
        "protocol",
        "a leader counts on promises of a lost memory",
        _keeps_returned,
        False,
        kinds=("archive",),
    ),
    Mutant(
        "nack thaws",
        "partial",
        "a proposer that is beaten lets local transitions go on",
        _thaws_with_a_nack,
        True,
        robots=5,
        kinds=("freeze",),
    ),
    Mutant(
        "warm retry",
        "partial",
        "a first phase that is repeated does not freeze",
        _asks_again_without_freezing,
        True,
        kinds=("freeze",),
    ),
    Mutant(
        "numbers only",
        "memory",
        "proposals count by their number, whatever life they are of",
        _numbers_only,
    ),
    Mutant(
        "no jury",
        "membership",
        "a robot is evicted though only one does not hear it",
        _evicts_alone,
        kinds=("link",),
    ),
    Mutant(
        "leaves at once",
        "membership",
        "a robot that leaves does not wait until others know",
        _leaves_at_once,
        kinds=("leave",),
        robots=2,
    ),
    Mutant(
        "own sleep",
        "membership",
        "who was suspended takes the others to have been silent",
        _counts_its_own_sleep,
        kinds=("sleep",),
    ),
    Mutant(
        "short chunks",
        "limits",
        "the last slot of a full chunk is not sent",
        _skips_a_slot_of_a_chunk,
        kinds=("tight",),
    ),
    Mutant(
        "newest first",
        "limits",
        "a batch keeps the newest proposals where it is full",
        _newest_first,
        kinds=("tight",),
    ),
    Mutant(
        "off for ever",
        "operator",
        "an assertion that a robot is off outlives its return",
        _off_for_ever,
        kinds=("operator",),
    ),
    Mutant(
        "rest decides",
        "operator",
        "a quorum of those who are left decides after an eviction by force",
        _any_of_those_left,
        kinds=("operator",),
    ),
    Mutant(
        "forgets cast out",
        "operator",
        "who was evicted by force is forgotten in a restart",
        _forgets_who_was_cast_out,
        robots=2,
        kinds=("operator",),
    ),
    Mutant(
        "any log",
        "memory",
        "votes count whatever log they are from",
        _counts_any_log,
        kinds=("spare", "amnesia"),
    ),
    Mutant(
        "plain ballots",
        "memory",
        "a robot that lost its log uses its ballots again",
        _ballots_without_log,
        kinds=("amnesia", ""),
    ),
    Mutant(
        "trusts the end",
        "memory",
        "a log whose end is lost is trusted",
        _trusts_every_end,
        kinds=("power",),
    ),
    Mutant(
        "no sync",
        "memory",
        "nothing is waited for until it is on the disk",
        _never_waits_for_the_disk,
        kinds=("power",),
    ),
    Mutant(
        "unsynced votes",
        "memory",
        "votes are told before they are on the disk",
        _waits_for_votes_only_sometimes,
        kinds=("power",),
    ),
    Mutant(
        "same id",
        "memory",
        "a robot that forgot its log goes by the same id",
        _keeps_its_log_id,
        kinds=("power", "amnesia", "spare"),
    ),
    Mutant(
        "eager start",
        "membership",
        "a robot acts before it knows where the team is",
        _acts_before_it_knows_more,
        kinds=("late",),
    ),
    Mutant(
        "snapshot without seen",
        "limits",
        "a snapshot does not say whose proposals are in it",
        _snapshot_without("seen"),
        kinds=("tight",),
    ),
    Mutant(
        "snapshot without logs",
        "limits",
        "a snapshot does not say whose logs count",
        _snapshot_without("logs"),
        kinds=("archive",),
    ),
    Mutant(
        "low promise",
        "protocol",
        "to accept a ballot does not promise it",
        _keeps_promised_low,
        False,
        robots=5,
        kinds=("rivals",),
    ),
    Mutant(
        "learns what it holds",
        "protocol",
        "that a slot is chosen confirms whatever was accepted",
        _learns_what_it_holds,
        False,
        kinds=("rivals",),
    ),
    Mutant(
        "moves while paused",
        "partial",
        "local transitions go on in a pause",
        _moves_while_paused,
        True,
        kinds=("freeze",),
    ),
    Mutant(
        "drops the first",
        "protocol",
        "of several proposals the first is left out",
        _drops_the_first_proposal,
    ),
    Mutant(
        "lost moves",
        "memory",
        "local transitions are not read back after a restart",
        _reads_no_facts_back,
        True,
    ),
    Mutant(
        "same incarnation",
        "membership",
        "a robot that starts again keeps its incarnation",
        _takes_its_former_incarnation,
    ),
    Mutant(
        "blind learning",
        "protocol",
        "slots are learnt whatever log they stand on",
        _pulls_without_looking,
        kinds=("operator", ""),
    ),
    _reacting("stale event", "an event of any visit counts", _interrupts_any_visit),
    _reacting("two winners", "a result counts after an event", _result_after_interrupt),
    _reacting("never held", "an event that is held never fires", _forgets_held_events),
    _reacting("ever held", "an event is held beyond its visit", _holds_for_ever),
    _reacting("lost in a pause", "a pause loses events", _pause_loses_events),
    _reacting("event in a pause", "an event fires in a pause", _interrupts_in_a_pause),
    _reacting("no cause", "firings do not say what caused them", _loses_causes),
    _reacting("continues again", "a visit is continued more than once", _continues_again),
    _reacting(
        "continues ahead",
        "the same, by local transitions that the log does not have",
        _continues_ahead_again,
        True,
    ),
    _reacting("task twice", "a task that came before comes in again", _takes_tasks_again),
    _reacting("tasks first", "a task comes in before robots move", _tasks_first),
    _reacting("newest task", "the newest task of a queue is taken first", _newest_task_first),
    _reacting("never done", "a robot keeps a task that is done", _never_done),
    _reacting("keeps task", "a robot keeps the task that it gave back", _keeps_what_it_gives_back),
    _reacting("back to the end", "a task goes back to the end of its queue", _returns_to_the_end),
    _reacting("first writer", "data of the team is written once", _last_writer_loses),
    _reacting("reads ahead", "an action reads what is not in the log", _reads_ahead),
    _reacting("reads late", "an action reads the data of the goal before", _reads_late),
    _reacting("unwritten task", "a task that came is not written down", _writes_no_offer),
    _reacting("forgotten task", "tasks are not read back", _reads_no_offers_back),
    _reacting("task of the first", "only the first member proposes", _leaves_tasks_to_the_first),
    _reacting("task let go", "a task is let go once it is proposed", _takes_tasks_for_known),
    *(
        _reacting(
            "snapshot without " + key,
            "a snapshot lacks '%s'" % key,
            _snapshot_of_state_without(key),
            kinds=_SNAPSHOTS,
        )
        for key in ("known", "submitted", "queues", "task", "held", "data", "interrupted")
    ),
    _deploying("no votes", "a plan is adopted without votes", _adopts_without_votes),
    _deploying("old names", "what is under way keeps its old names", _keeps_old_names),
    _deploying("new resources", "resources are full again", _fills_resources_again),
    _deploying("old requests", "robots that are done ask the policy", _lets_requests_stand),
    _deploying("acts as before", "a robot acts by the first plan", _acts_by_the_first_plan),
    _deploying("votes once", "a robot that restarts does not vote again", _never_votes_again),
    *(
        _deploying(
            "snapshot without " + key,
            "a snapshot lacks '%s'" % key,
            _plans_without(key),
            _DEPLOYED,
        )
        for key in ("staged", "adopted")
    ),
]
