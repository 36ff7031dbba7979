"""What replicas do, as steps of ``spec/trace.tla``.

:func:`noting` notes the steps of a simulated team in :class:`Notes`; logs of real runs are noted by
:func:`~agreement.traces.traced_logs`.
"""

from __future__ import annotations

import contextlib
from typing import (
    Any,
    Callable,
    Dict,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
    Type,
    Union,
)
from unittest import mock

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.membership import Membership
from gspn_framework_package.execution.agreement.messages import Batch
from gspn_framework_package.execution.agreement.proposals import ProposalQueue
from gspn_framework_package.execution.agreement.quorum import Ballot
from gspn_framework_package.execution.agreement.replication import Replication
from gspn_framework_package.execution.agreement.state import is_control
from gspn_framework_package.execution.ledger import Item, Origin
from gspn_framework_package.execution.team_state import TeamState

Trace = List[str]
"""The steps, as TLA+ records."""


class Known(NamedTuple):
    """What a robot knows after a step. ``length``: of its log, with the first slot."""

    length: int
    promised: Ballot
    accepted: Optional[Tuple[Ballot, Batch]]
    incarnation: int
    frozen: bool
    tasks: str = "{}"
    logs: Tuple[int, int] = (0, 0)
    """The numbers of the log before a slot and with it."""


class Notes:
    """The steps of a team, as they happen.

    :param names: the robots, in the order of the plan.
    :param beyond: entries with which something begins that the trace does not know.
    """

    def __init__(self, names: Sequence[str], beyond: Tuple[Type[Any], ...]) -> None:
        self.beyond = beyond
        self.robots = {name: number for number, name in enumerate(names, 1)}
        self.steps: Trace = []
        self.lines: List[Tuple[str, int]] = []  # for each step: whose, and the records in its log
        self.logs: Dict[str, List[str]] = {name: [] for name in names}  # ids, as they appear
        self.tasks: Dict[str, int] = {}  # the numbers of tasks, as they appear
        self.chain: List[str] = []  # the hashes of logs, as they appear
        self.alone: Set[Origin] = set()  # the local transitions: records of slots do not say so
        self.busy: List[str] = []  # what a robot does that is one step of the specification
        self.ended = False  # something happened that traces do not know

    def _item(self, item: Item) -> str:
        robot, incarnation, number, log = item.origin
        by = of = self.robots[robot]
        if item.private:
            self.alone.add(item.origin)
        name, life = "Move" if item.origin in self.alone else "Done", 0
        forced = False
        if isinstance(item.entry, log_entries.Join):
            name, life = "Join", item.entry.incarnation
        elif isinstance(item.entry, log_entries.Evict):
            name, life, of = "Evict", item.entry.incarnation, self.robots[item.entry.robot]
            forced = item.entry.forced
        elif isinstance(item.entry, log_entries.Leave):
            name, of = "Leave", self.robots[item.entry.robot]
        elif is_control(item.entry):
            name = "GiveBack"  # the order that the specification knows again and again
        return _record(
            entry='"%s"' % name,
            robot=of,
            life=life,
            forced=str(forced).upper(),
            by=by,
            incarnation=incarnation,
            number=number,
            log=self.log(robot, log),
            told_at=0,
            before="<<>>",
            **self._says(item.entry),
        )

    def _says(self, entry: log_entries.Entry) -> Dict[str, str]:
        """What an entry says about tasks: which may come in (0: one that comes again and again), end,
        and leave the hands of robots."""
        makes, ends, frees = "", "", ""
        if isinstance(entry, log_entries.Submit):
            makes = ends = str(self._task(entry.id))
            if entry.replaces:
                ends += ", %d" % self._task(entry.replaces)
        elif isinstance(entry, log_entries.TaskDue):
            makes = "0"
        elif isinstance(entry, log_entries.CancelTask):
            ends = str(self._task(entry.id))
        elif isinstance(entry, log_entries.GiveBack):
            frees = str(self._task(entry.id))
        return {"makes": "{%s}" % makes, "ends": "{%s}" % ends, "frees": "{%s}" % frees}

    def _task(self, name: str) -> int:
        return self.tasks.setdefault(name, len(self.tasks) + 1)

    def whereabouts(self, team: TeamState) -> str:
        """Where the tasks are that a team knows: with a robot, nowhere else (0), or how they ended,
        and after how many other ends."""
        found = [(each.task.id, "waits", self.robots.get(each.robot, 0)) for each in team.tasks()]
        ended = [each.id for each in team.ended_tasks]
        for at, each in enumerate(team.ended_tasks):
            found.append((each.id, each.outcome, ended[:at].count(each.id)))
        texts = ['<<%d, "%s", %d>>' % (self._task(name), how, of) for name, how, of in found]
        return "{%s}" % ", ".join(texts)

    def _number(self, hash_: Optional[str]) -> int:
        assert hash_ is not None
        if hash_ not in self.chain:
            self.chain.append(hash_)
        return self.chain.index(hash_)

    def log(self, robot: str, id_: str) -> int:
        """The number of a log of a robot, of which this is the id, or its beginning."""
        logs = self.logs[robot]
        for number, known in enumerate(logs, 1):
            if known.startswith(id_) or id_.startswith(known):  # one may be the beginning
                logs[number - 1] = max(known, id_, key=len)
                return number
        if logs:
            self.ended = True  # of a log that it lost before anybody heard of it
        logs.append(id_)
        return len(logs)

    def _batch(self, items: Sequence[Item]) -> str:
        return "<<%s>>" % ", ".join(self._item(item) for item in items)

    def _ballot(self, ballot: Any) -> str:
        log = self.log(ballot.robot, ballot.log) if ballot.counter else 0
        return "<<%d, %d, %d>>" % (ballot.counter, self.robots[ballot.robot], log)

    def note(
        self,
        part: Union[Consensus, Membership, ProposalQueue],
        what: str,
        ballot: Any,
        items: Sequence[Item],
        ids: Sequence[str] = (),
    ) -> None:
        """Note a step that a replica has taken."""
        state, logs = part.state, (0, 0)
        fresh = state.ledger.length == 0 and len(self.logs[part.config.name]) < 2
        if fresh or (what == "decide" and state.ledger.length == 1):
            return  # the specification leaves the first slot out
        if what == "decide":
            before, after = state.hash_at(state.ledger.length - 1), state.ledger.hash
            logs = (self._number(before), self._number(after))
        self.add(
            part.config.name,
            what,
            ballot,
            items,
            Known(
                state.ledger.length,
                state.promised,
                state.accepted,
                state.incarnation,
                state.is_frozen(),
                self.whereabouts(state.ledger.state) if what == "decide" else "{}",
                logs,
            ),
            state.records,
            ids,
        )

    def lose_power(self, robot: str, lines: int) -> None:
        """All but so many records of a robot's log were not on the disk."""
        kept = [k for k, (of, known) in enumerate(self.lines) if of == robot and known <= lines]
        at = max(kept, default=-1) + 1
        synced = _record(what='"sync"', robot=self.robots[robot], batch="<<>>")
        self.steps.insert(at, synced)
        self.lines.insert(at, (robot, lines))

    def add(
        self,
        robot: str,
        what: str,
        ballot: Ballot,
        items: Sequence[Item],
        known: Known,
        lines: int = 0,
        ids: Sequence[str] = (),
    ) -> None:
        """Add a step of a robot, which then knew this, with so many records in its log.

        :param ids: the logs from which another robot continues after a loss of power, the newest
            first.
        """
        self.ended = self.ended or any(isinstance(item.entry, self.beyond) for item in items)
        if self.ended:
            return
        accepted = "<<>>"
        if known.accepted is not None:
            held, batch = known.accepted
            accepted = "<<%s, %s>>" % (self._ballot(held), self._batch(batch.items))
        self.lines.append((robot, lines))
        self.steps.append(
            _record(
                what='"%s"' % what,
                robot=self.robots[robot],
                ballot=self._ballot(ballot),
                batch=self._batch(items),
                length=max(0, known.length - 1),
                promised=self._ballot(known.promised),
                accepted=accepted,
                incarnation=known.incarnation,
                frozen=str(known.frozen).upper(),
                tasks=known.tasks,
                base=known.logs[0],
                log=known.logs[1],
                ids="<<%s>>" % ", ".join(str(self.log(ballot.robot, each)) for each in ids),
            )
        )


def _record(**fields: object) -> str:
    return "[%s]" % ", ".join("%s |-> %s" % pair for pair in fields.items())


@contextlib.contextmanager
def noting(notes: Notes) -> Iterator[None]:
    """While this runs, every step of a consensus is noted, every new life of a robot, what it does
    about a log that it or another one lost, and what it hears of robots that are off."""
    note, busy, note_torn = notes.note, notes.busy, Membership.note_torn
    patches = contextlib.ExitStack()

    def after(part: Type[Any], name: str, do: Callable[..., None], what: str = "") -> None:
        """Call ``do`` with the part, the result and the arguments after each call of a method, and
        ``what`` is in ``busy`` meanwhile."""
        method = getattr(part, name)

        def called(self: Any, *args: Any, **named: Any) -> Any:
            busy.append(what)
            result = method(self, *args, **named)
            busy.pop()
            do(self, result, *args, **named)
            return result

        patches.enter_context(mock.patch.object(part, name, called))

    def promised(self: Consensus, _: None, ballot: Ballot, torn: Any) -> None:
        note(self, "propose" if ballot.robot == self.config.name else "promise", ballot, ())

    def accepted(self: Consensus, _: None, slot: int) -> None:
        assert self.state.accepted is not None
        ballot, batch = self.state.accepted
        mine = ballot.robot == self.config.name
        note(self, "second_phase" if mine else "vote", ballot, batch.items)

    def answered(self: Consensus, _: None, message: Any, body: Any, vote: bool) -> None:
        if self.config.partial and not vote:
            note(self, "answer", body.ballot, ())

    def decided(self: Replication, _: None, batch: Any, ballot: Ballot, **how: Any) -> None:
        length = self.state.ledger.length
        found = self.state.recent.since(length - 1) if length else ()
        notes.ended = notes.ended or not found
        if found:
            note(self.membership, "decide", ballot, found[0][1].items)

    def learned(self: Replication, _: Any, *args: Any) -> None:
        notes.ended = True

    def moved(self: ProposalQueue, origin: Origin, entry: Any, firing: Any) -> None:
        note(self, "move", self.state.promised, (Item(entry, origin, True),))

    def lives(self: Membership, _: None) -> None:
        if "start" in busy and not self.config.trusted:
            if self.state.log_id not in notes.logs[self.config.name]:
                notes.logs[self.config.name].append(self.state.log_id)
            note(self, "outage", self.state.promised, ())
        elif "commit" not in busy:
            note(self, "new_life" if "join" in busy else "resume", self.state.promised, ())

    def forgot(self: Membership, _: None, why: str, keep: bool = False) -> None:
        notes.logs[self.config.name].append(self.state.log_id)
        if "commit" not in busy and ("start" not in busy or self.config.trusted):
            notes.ended = notes.ended or keep
            note(self, "forget", self.state.promised, ())

    def heard(self: Membership, _: None, robot: str, log: str, *, sure: bool) -> None:
        number = notes.log(robot, log)
        if len(notes.logs[self.config.name]) > 1:
            note(self, "hear", Ballot(number, robot, log), ())

    def hear_torn(self: Membership, robot: str, ids: Sequence[str]) -> None:
        known = self.state.peers.torn.get(robot)
        note_torn(self, robot, ids)
        if self.state.peers.torn.get(robot) != known:
            note(self, "torn", Ballot(0, robot), (), ids)

    def asserted(self: Membership, _: None, robot: str, incarnation: int) -> None:
        note(self, "assert" if "force" in busy else "note_off", Ballot(0, robot), ())

    def heard_off(self: Membership, _: None, robot: str) -> None:
        note(self, "heard", Ballot(0, robot), ())

    def active(self: Membership, _: None) -> None:
        if "commit" not in busy and len(notes.logs[self.config.name]) > 1:
            note(self, "active", self.state.promised, ())

    def nothing(*_: Any) -> None:
        pass

    after(Consensus, "_promise", promised)
    after(Consensus, "_persist_accepted", accepted)
    after(Consensus, "_answer_prepare", answered)
    after(Replication, "_commit", decided, "commit")
    after(Replication, "_take_snapshot", learned)
    after(ProposalQueue, "add_local_transition", moved)
    after(Membership, "new_life", lives)
    after(Membership, "forget", forgot)
    after(Membership, "_note_log", heard)
    after(Membership, "become_active", active)
    after(Membership, "_assert_off", asserted)
    after(Membership, "_heard_though_off", heard_off)
    after(Membership, "want_to_join", nothing, "join")
    after(Membership, "evict_by_force", nothing, "force")
    after(Membership, "recall_is_over", nothing, "start")
    with patches, mock.patch.object(Membership, "note_torn", hear_torn):
        yield
