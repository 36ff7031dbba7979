"""One process of a searched team: a real replica, its log, and what may be told to it.

A :class:`Process` is a value: a step makes another one, and leaves the first as it was. So
``agreement.search`` can go back and try something else. :func:`Host.key` says which processes count
as the same: those that differ in nothing but times, as far as it does not matter whether a timer
has run out, and how long ago a robot was heard.
"""

from __future__ import annotations

import copyreg
import io
import json
import pickle
import random
from types import MappingProxyType
from typing import Any, Callable, Dict, FrozenSet, List, NamedTuple, Optional, Sequence, Tuple

from agreement.world import ViolationError, changes_members
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.config import Config, Pace
from gspn_framework_package.execution.agreement.messages import Batch
from gspn_framework_package.execution.agreement.peers import Peer
from gspn_framework_package.execution.agreement.quorum import Ballot
from gspn_framework_package.execution.agreement.replica import Replica
from gspn_framework_package.execution.agreement.state import BallotAttempt, Waiting
from gspn_framework_package.execution.event_log import header
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.execution.verifier.merge import is_in_team_after
from gspn_framework_package.model.compact_json import compact
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

PACE = Pace(heartbeat=2.0, greeting=0.2, retry=0.1, takeover=0.3, backoff=0.02)
"""Times of the protocol (s). All timers but those of silence run out within :data:`LEAP`."""

LEAP = 7.9
"""How much time passes where the adversary lets timers run out (s): less than four heartbeats, so
that the robot does not take itself for one that was suspended."""

OLD = 3
"""The number of leaps from which on it makes no difference how long ago something was."""


class Copy:
    """A replica that stays as it is: each one that is taken from it is another's own.

    A walk seldom goes on twice from the same state, and copies take longer than steps. So the first
    one that is taken is the replica itself, and a second is made by taking the same step again.

    :param again: takes the step that led to this state again.
    """

    __slots__ = ("_again", "_data", "_first")

    def __init__(self, first: Optional[Replica], again: Callable[[], Replica]) -> None:
        self._first, self._again, self._data = first, again, b""

    def take(self) -> Replica:
        """A replica in this state, to be changed."""
        first, self._first = self._first, None
        if first is not None:
            return first
        if not self._data:
            first = self._again()
            self._data = dump(first)
            return first
        return load(self._data)

    def keep(self) -> None:
        """Many will be taken, or none for long."""
        if self._first is not None and not self._data:
            self._data, self._first = dump(self._first), None

    def drop(self) -> None:
        """Probably none will be taken."""
        self._first = None


class Process(NamedTuple):
    """A process and its log."""

    replica: Copy
    clock: float
    log: str
    """The id of its log, as in the header."""
    lines: Tuple[str, ...]
    """The records."""
    synced: int
    """How many of them would survive a loss of power."""
    lost: Tuple[Tuple[str, Tuple[str, ...]], ...]
    """The logs that it lost: id and lines."""
    log_id: str
    """The present id of the log."""
    inside: bool
    """Whether it is in the team, as far as its log says."""
    holds: int
    """The slot until whose decision it has promised to make no local transition; -1 for none."""
    votes: FrozenSet[Tuple[str, Tuple[Any, ...], int]]
    """Its promises and votes: kind, ballot, and the line that has to survive a loss of power before
    anybody knows of it (0: none has to)."""
    promised: FrozenSet[Tuple[str, Tuple[Any, ...]]]
    """(log id, ballot) of its promises and votes in all its lives."""
    length: int
    running: Tuple[Any, ...]
    """The action whose end it waits for: incarnation, visit, attempt, result; () for none."""
    stage: int
    """The staged plan on which its host has not said anything yet; 0 for none."""
    halted: bool


class Step(NamedTuple):
    """What came of a step."""

    process: Process
    key: Any
    """Equal for processes that count as the same."""
    sent: List[Tuple[str, str]]
    """The messages: the receiver ("" for everybody, "<" for who asked) and the text."""
    records: int
    """How many records were written."""
    slots: List[Tuple[int, str]]
    """The slots among them that it wrote as a member, and their hashes."""
    relies: List[Tuple[str, str, Tuple[Any, ...]]]
    """The promises that an accept relies on: robot, log id and ballot."""
    replica: Replica
    """What is taken first from :attr:`Process.replica`."""


class Host:
    """Runs the processes of one robot.

    :param plan: the plan of the team.
    :param robot: the name of the robot.
    :param key: distinguishes the process from another one of the same name.
    :param fsync: whether durable records are synced to the disk.
    :param rivals: whether there may be another process of this name, so that this one may halt.
    """

    def __init__(self, plan: Plan, robot: str, key: str, fsync: bool, rivals: bool) -> None:
        self.plan = plan
        self.robot = robot
        self.name = key
        self.fsync = fsync
        self.rivals = rivals
        self.header = header(plan, "sim", "", "")
        self.mono: Optional[int] = None
        """The number of the step, which is written with each record if it is not None."""

    # -- what may happen ---------------------------------------------------------------------------

    def begin(
        self, lost: Tuple[Tuple[str, Tuple[str, ...]], ...] = (), clock: float = 0.0
    ) -> Process:
        """A process before it starts, without a log."""
        log = "%s-log%d" % (self.name, len(lost))
        return Process(
            _NOTHING,
            clock,
            log,
            (),
            0,
            lost,
            log,
            False,
            -1,
            frozenset(),
            frozenset(),
            0,
            (),
            0,
            False,
        )

    def give(self, process: Process, given: interface.Input, cut: int, leap: bool = False) -> Step:
        """Give an input to a process.

        :param cut: the process is killed when it has written so many records, and starts again; -1:
            it is not.
        :param leap: whether so much time has passed that timers have run out.
        """
        clock = process.clock + (LEAP if leap else 0.0)
        replica = process.replica.take()
        effects = replica.step(given, clock)
        copy = Copy(replica, lambda: self.give(process, given, cut, leap).replica)
        after = process._replace(clock=clock, replica=copy)
        return self._carry_out(after, replica, effects, cut, given)

    def start(self, process: Process, trusted: bool = True) -> Step:
        """Kill a process, if it runs, and start it with its log."""
        records = [json.loads(line) for line in process.lines]
        replica = Replica(
            self.plan, self.robot, "sim", process.log, records, pace=PACE, trusted=trusted
        )
        ids = [str(r["log"]) for r in records if r["kind"] in ("reset", "outage")]
        copy = Copy(replica, lambda: self.start(process, trusted).replica)
        after = process._replace(
            replica=copy, log_id=ids[-1] if ids else process.log, holds=-1, running=()
        )
        return self._carry_out(after, replica, replica.start(process.clock), -1, None)

    def lose_log(self, process: Process) -> Step:
        """Kill a process, and start it without its log."""
        lost = (*process.lost, (process.log, process.lines))
        new = self.begin(lost, process.clock)._replace(promised=process.promised)
        return self.start(new)

    def lose_power(self, process: Process, kept: int) -> Step:
        """The power fails, and only so many lines of the log are left."""
        lines = process.lines[:kept]
        inside = False
        for line in lines:
            inside = is_in_team_after(self.robot, json.loads(line), inside)
        votes = frozenset(vote for vote in process.votes if vote[2] <= kept)
        process = process._replace(lines=lines, synced=kept, inside=inside, votes=votes)
        return self.start(process, trusted=self.fsync)

    def sync(self, process: Process) -> Step:
        """The log reaches the disk."""
        process = process._replace(synced=len(process.lines))
        replica = process.replica.take()
        return Step(process, self.key(process, replica), [], 0, [], [], replica)

    # -- effects -----------------------------------------------------------------------------------

    def _carry_out(
        self,
        process: Process,
        replica: Replica,
        effects: Sequence[interface.Effect],
        cut: int,
        given: Optional[interface.Input],
    ) -> Step:
        lines, synced, log_id = list(process.lines), process.synced, process.log_id
        inside, holds = process.inside, process.holds
        votes, promised = set(process.votes), set(process.promised)
        running, stage, halted = process.running, process.stage, process.halted
        sent: List[Tuple[str, str]] = []
        slots: List[Tuple[int, str]] = []
        relies: List[Tuple[str, str, Tuple[Any, ...]]] = []
        durable = dead = False
        written = 0
        for effect in effects:
            if isinstance(effect, interface.Persist):
                if written == cut:
                    dead = True
                    break
                record = effect.record
                written += 1
                if self.mono is not None:
                    record = dict(record, mono=0.001 * self.mono)
                lines.append(compact(record))
                durable = durable or effect.synced or (effect.durable and self.fsync)
                if record["kind"] in ("promised", "accepted"):
                    strict = self.fsync or "torn" in record or changes_members(record)
                    vote = (record["kind"], tuple(record["ballot"]), len(lines) if strict else 0)
                    votes.add(vote)
                    promised.add((log_id, tuple(record["ballot"])))
                elif record["kind"] in ("reset", "outage"):
                    log_id = record["log"]
                elif record["kind"] == "private" and holds == replica.ledger.length:
                    raise ViolationError(
                        "%s moves on its own, though it said that it holds still" % self.name
                    )
                was_inside, inside = inside, is_in_team_after(self.robot, record, inside)
                if record["kind"] == "slot" and was_inside:
                    slots.append((record["slot"], record["hash"]))
                continue
            if durable:
                synced, durable = len(lines), False
            if isinstance(effect, (interface.Send, interface.Reply)) and effect.message:
                message = effect.message
                self._check_written(message, votes, synced)
                if message["kind"] in ("prepare", "promise") and _is_frozen(message, given):
                    holds = message["slot"]
                if message["kind"] == "accept" and not replica.config.partial:
                    logs, ballot = replica.ledger.logs, tuple(message["ballot"])
                    followers = replica.state.followers or ()
                    relies += [(name, logs[name], ballot) for name in followers if logs.get(name)]
                to = effect.to if isinstance(effect, interface.Send) else "<"
                sent.append((to, compact(message)))
            elif isinstance(effect, StartAction):
                key = (effect.incarnation, effect.visit, effect.attempt)
                running = (*key, self._result(replica, effect.place))
            elif isinstance(effect, interface.Examine):
                stage = effect.stage
            elif isinstance(effect, interface.Halted):
                halted = True
                if not self.rivals:
                    raise ViolationError("%s halted: %s" % (self.name, effect.reason))
        if isinstance(given, interface.Examined):
            stage = 0
        if replica.state.running is None:
            running = ()
        after = process._replace(
            replica=_NOTHING if halted else process.replica,
            lines=tuple(lines),
            synced=synced,
            log_id=log_id,
            inside=inside,
            holds=holds,
            votes=frozenset(votes),
            promised=frozenset(promised),
            length=replica.ledger.length,
            running=running,
            stage=stage,
            halted=halted,
        )
        if dead:
            again = self.start(after._replace(halted=False))
            return again._replace(
                sent=sent + again.sent, slots=slots + again.slots, relies=relies, records=written
            )
        return Step(after, self.key(after, replica), sent, written, slots, relies, replica)

    def _check_written(self, message: interface.Message, votes: Any, synced: int) -> None:
        if message["kind"] not in ("promise", "accepted", "accept") or not message.get(
            "vote", True
        ):
            return
        kinds = ("promised", "accepted") if message["kind"] == "promise" else ("accepted",)
        ballot = tuple(message["ballot"])
        lines = [line for kind, of, line in votes if of == ballot and kind in kinds]
        if not lines or min(lines) > synced:
            raise ViolationError(
                "%s says %s before it is on its disk" % (self.name, message["kind"])
            )

    def _result(self, replica: Replica, place: str) -> str:
        """What the action in a place reports: the first transition that it may choose."""
        net = replica.ledger.game.net
        leaving = [net.transitions[t] for t in net.consumers[net.place_number(place)]]
        timed = [t.name for t in leaving if t.timed]
        return timed[0] if timed and len(timed) == len(leaving) else ""

    def key(self, process: Process, replica: Replica) -> Any:
        """What is equal for processes that count as the same."""
        return (
            self.name,
            process.halted or _key_of_replica(replica),
            process.log,
            hash(process.lines),
            process.synced if not self.fsync else 0,
            tuple(log for log, _ in process.lost),
            process.holds,
            process.running,
            process.stage,
        )


def _no_replica() -> Replica:
    raise ValueError("a process that does not run takes no step")


_NOTHING = Copy(None, _no_replica)


def _is_frozen(message: interface.Message, given: Optional[interface.Input]) -> bool:
    """Whether a robot that sends this, in answer to what was given to it, has to hold still."""
    if message["kind"] == "prepare":
        return bool(message["frozen"])
    if not isinstance(given, interface.Received):
        return False
    asked = given.message
    return bool(asked.get("frozen")) and asked["ballot"] == message["ballot"]


# -- which processes are the same ------------------------------------------------------------------


def _key_of_replica(replica: Replica) -> Any:
    state, now = replica.state, replica.state.now
    local = replica.robot

    def due(time: Optional[float]) -> bool:
        return time is not None and time <= now + 1e-9

    def age(time: Optional[float]) -> int:
        return -1 if time is None else int(min(OLD, (now - time) / LEAP + 0.5))

    def attempt_key(attempt: Optional[BallotAttempt]) -> Any:
        if attempt is None:
            return None
        promises = [(r, a and _key_of_vote(a)) for r, a in sorted(attempt.promises.items())]
        return (
            attempt.slot,
            attempt.ballot,
            attempt.frozen,
            tuple(promises),
            frozenset(attempt.answered),
            frozenset(attempt.strangers),
            attempt.all_told,
            _key_of_dict(attempt.torn),
            attempt.batch and _key_of_batch(attempt.batch),
            due(attempt.sent + PACE.retry),
        )

    def peer_key(peer: Peer) -> Any:
        return (
            age(peer.heard),
            int(peer.gap / LEAP + 0.5) if replica.config.plan.timing.evict_after else 0,
            peer.length,
            peer.log,
            age(peer.at_work),
            peer.welcomes,
            peer.silent,
            peer.active,
            peer.joining,
            due(peer.answered + PACE.greeting),
            peer.met,
            _key_of_dict(peer.cast_out),
            peer.life,
            peer.before,
            peer.surprise,
        )

    return (
        state.ledger.hash,
        state.first_hash,
        state.asked_until[0],
        due(state.asked_until[1]),
        (state.records, state.durable, state.log_id, state.incarnation, state.begin_records),
        (state.active, state.joining, state.amnesic, state.damage, state.torn, state.halted),
        (state.leaving, age(state.leaving_since), state.fenced),
        (age(state.superseded_at), age(state.rival_since), age(state.namesake_heard)),
        due(state.namesake_answered + PACE.greeting),
        tuple((r, peer_key(p)) for r, p in sorted(state.peers.all.items())),
        _key_of_dict(state.peers.known),
        frozenset(state.peers.unsure),
        _key_of_dict(state.peers.torn),
        frozenset(state.peers.dead),
        age(state.peers.since),
        _key_of_dict(state.off),
        _key_of_dict(state.astray),
        (bool(state.listen_until), due(state.listen_until), due(state.next_hello)),
        _key_of_waiting(state.own_proposals),
        tuple((r, _key_of_waiting(w)) for r, w in sorted(state.others_proposals.items())),
        state.number,
        tuple(sorted((k, age(t)) for k, (_, t) in state.offered.items())),
        (state.promised, state.accepted and _key_of_vote(state.accepted), state.highest),
        attempt_key(state.attempt),
        state.frozen_by,
        None if state.followers is None else frozenset(state.followers),
        tuple((b, frozenset(v)) for b, v in sorted(state.votes.items())),
        tuple((b, _key_of_dict(t)) for b, t in sorted(state.by_all.items())),
        (state.wait_until is None, due(state.wait_until), due(state.gathers_until)),
        (frozenset(state.busy), frozenset(state.gathers), state.gave_way, min(state.defeats, 2)),
        (age(state.frozen_since), frozenset(state.voteless), state.asked_at is None),
        (state.last_sent[:4], due(state.last_sent[4])) if state.last_sent else (),
        (state.position, state.started, state.running, state.reported),
        (state.examining, state.examined, tuple(o.order_id for o in state.held_orders)),
        tuple(local._led_to.items()),
        tuple(sorted(replica.reactions._orders)),
    )


def _key_of_dict(values: Dict[str, Any]) -> Any:
    return tuple(sorted(values.items()))


def _key_of_batch(batch: Batch) -> Any:
    return tuple((item.origin, item.private, type(item.entry)) for item in batch.items)


def _key_of_vote(vote: Tuple[Ballot, Batch]) -> Any:
    return (vote[0], _key_of_batch(vote[1]))


def _key_of_waiting(waiting: Waiting) -> Any:
    return tuple((p.item.origin, type(p.item.entry), p.order_id) for p in waiting)


# -- copies ----------------------------------------------------------------------------------------

_shared: Dict[int, Any] = {}
"""What copies of replicas share, by their ids: what never changes. (Nothing draws from the random
numbers: no plan of a scope has anything that comes by chance.)"""


def _shared_object(number: int) -> Any:
    return _shared[number]


def _share(thing: Any) -> Tuple[Callable[[int], Any], Tuple[int]]:
    _shared[id(thing)] = thing
    return _shared_object, (id(thing),)


class _Pickler(pickle.Pickler):
    dispatch_table = {
        **copyreg.dispatch_table,
        **dict.fromkeys((Config, Plan, Net, Phase, TokenGame, MappingProxyType), _share),
        random.Random: _share,
    }


def dump(replica: Replica) -> bytes:
    """A copy of a replica, to be loaded in this process."""
    file = io.BytesIO()
    _Pickler(file, pickle.HIGHEST_PROTOCOL).dump(replica)
    return file.getvalue()


def load(copy: bytes) -> Replica:
    """A replica of its own from the copy."""
    replica: Replica = pickle.loads(copy)
    return replica
