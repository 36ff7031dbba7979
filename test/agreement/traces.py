"""Whether ``spec/agreement.tla`` allows what simulated teams of real replicas do.

A team runs in a simulated network that loses, repeats, delays and reorders messages; its processes
are suspended, evicted, or killed and started again, with their logs or without. Tasks come in, and orders about
them. Every step of its consensus is noted: what the robot did, and what it then knew, also where the tasks are.
TLC plays the notes on the specification (``spec/trace.tla``): each step has to be one of its actions, with the same
outcome, and no slot may do to a task what its entries do not say.

``python3 -m agreement.traces --traces N`` checks N of them. With ``--logs FOLDER...``, it checks real
runs instead: each folder holds the logs of one, written on one machine.
"""

from __future__ import annotations

import argparse
import contextlib
import random
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import (
    Any,
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

from agreement.plans import STEERED, make_plan
from agreement.specification import FOLDER, JAR, why_not
from agreement.world import SimulatedNode, ViolationError, Weather, World
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.membership import Membership
from gspn_framework_package.execution.agreement.messages import Batch
from gspn_framework_package.execution.agreement.proposals import ProposalQueue
from gspn_framework_package.execution.agreement.quorum import Ballot
from gspn_framework_package.execution.agreement.replication import Replication
from gspn_framework_package.execution.agreement.state import is_control
from gspn_framework_package.execution.event_log import EventLog, read_log
from gspn_framework_package.execution.ledger import Item, Origin
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.model.errors import GspnError, LogError
from gspn_framework_package.model.plan import Synchronisation

CHUNK = 400
"""How many traces TLC plays in one run."""

ITEM = re.compile(r"\[entry [^]]*\]")
"""An item of a batch in the text of a step."""

Trace = List[str]
"""The steps, as TLA+ records."""

DEPARTURES = (log_entries.Leave, log_entries.Evict)
"""The entries after which a robot is no member any more."""


class Refused(NamedTuple):
    """A trace that the specification does not allow. ``step`` counts from 1; ``differs``: the
    variable, its value in the specification and the replica's; () if no action can be taken."""

    trace: int
    step: int
    text: str
    differs: Tuple[str, ...]


class Known(NamedTuple):
    """What a robot knows after a step. ``length``: of its log, with the first slot."""

    length: int
    promised: Ballot
    accepted: Optional[Tuple[Ballot, Batch]]
    incarnation: int
    frozen: bool
    tasks: str = "{}"


class Notes:
    """The steps of a team, as they happen.

    :param names: the robots, in the order of the plan.
    :param beyond: entries with which something begins that the trace does not know.
    """

    def __init__(self, names: Sequence[str], beyond: Tuple[Type[Any], ...]) -> None:
        self.beyond = beyond
        self.robots = {name: number for number, name in enumerate(names, 1)}
        self.steps: Trace = []
        self.logs: Dict[str, List[str]] = {name: [] for name in names}  # ids, as they appear
        self.tasks: Dict[str, int] = {}  # the numbers of tasks, as they appear
        self.alone: Set[Origin] = set()  # the local transitions: records of slots do not say so
        self.busy: List[str] = []  # what a robot does that is one step of the specification
        self.ended = False  # something happened that traces do not know

    def _item(self, item: Item) -> str:
        robot, incarnation, number, log = item.origin
        by = of = self.robots[robot]
        if item.private:
            self.alone.add(item.origin)
        name, life = "Move" if item.origin in self.alone else "Done", 0
        if isinstance(item.entry, log_entries.Join):
            name, life = "Join", item.entry.incarnation
        elif isinstance(item.entry, log_entries.Evict):
            name, life, of = "Evict", item.entry.incarnation, self.robots[item.entry.robot]
        elif is_control(item.entry):
            name = "GiveBack"  # the order that the specification knows again and again
        return (
            '[entry |-> "%s", robot |-> %d, life |-> %d, forced |-> FALSE, by |-> %d, '
            "incarnation |-> %d, number |-> %d, log |-> %d, told_at |-> 0, before |-> <<>>, %s]"
            % (
                name,
                of,
                life,
                by,
                incarnation,
                number,
                self.log(robot, log),
                self._says(item.entry),
            )
        )

    def _says(self, entry: log_entries.Entry) -> str:
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
        return "makes |-> {%s}, ends |-> {%s}, frees |-> {%s}" % (makes, ends, frees)

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
    ) -> None:
        """Note a step that a replica has taken."""
        state = part.state
        fresh = state.ledger.length == 0 and len(self.logs[part.config.name]) < 2
        if fresh or (what == "decide" and state.ledger.length == 1):
            return  # the specification leaves the first slot out
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
            ),
        )

    def add(
        self, robot: str, what: str, ballot: Ballot, items: Sequence[Item], known: Known
    ) -> None:
        """Add a step of a robot, which then knew this."""
        self.ended = self.ended or any(isinstance(item.entry, self.beyond) for item in items)
        if self.ended:
            return
        accepted = "<<>>"
        if known.accepted is not None:
            held, batch = known.accepted
            accepted = "<<%s, %s>>" % (self._ballot(held), self._batch(batch.items))
        self.steps.append(
            '[what |-> "%s", robot |-> %d, ballot |-> %s, batch |-> %s, length |-> %d, '
            "promised |-> %s, accepted |-> %s, incarnation |-> %d, frozen |-> %s, tasks |-> %s]"
            % (
                what,
                self.robots[robot],
                self._ballot(ballot),
                self._batch(items),
                max(0, known.length - 1),
                self._ballot(known.promised),
                accepted,
                known.incarnation,
                str(known.frozen).upper(),
                known.tasks,
            )
        )


@contextlib.contextmanager
def noting(notes: Notes) -> Iterator[None]:
    """While this runs, every step of a consensus is noted, every new life of a robot, and what it
    does about a log that it lost."""
    promise, persist, answer = (
        Consensus._promise,
        Consensus._persist_accepted,
        Consensus._answer_prepare,
    )
    commit, take_snapshot = Replication._commit, Replication._take_snapshot
    new_life, forget, hear, join = (
        Membership.new_life,
        Membership.forget,
        Membership._note_log,
        Membership.want_to_join,
    )
    move = ProposalQueue.add_local_transition

    def promising(self: Consensus, ballot: Any, torn: Any) -> None:
        promise(self, ballot, torn)
        mine = ballot.robot == self.config.name
        notes.note(self, "propose" if mine else "promise", ballot, ())

    def accepting(self: Consensus, slot: int) -> None:
        persist(self, slot)
        assert self.state.accepted is not None
        ballot, batch = self.state.accepted
        mine = ballot.robot == self.config.name
        notes.note(self, "second_phase" if mine else "vote", ballot, batch.items)

    def answering(self: Consensus, message: Any, body: Any, vote: bool) -> None:
        answer(self, message, body, vote)
        if self.config.partial and not vote:
            notes.note(self, "answer", body.ballot, ())

    def deciding(self: Replication, batch: Any, ballot: Any, **how: Any) -> None:
        length = self.state.ledger.length
        notes.busy.append("commit")
        commit(self, batch, ballot, **how)
        notes.busy.pop()
        found = self.state.recent.since(length)
        if self.state.ledger.length != length + 1 or not found:
            notes.ended = True
        else:
            notes.note(self.membership, "decide", ballot, found[0][1].items)

    def learning(self: Replication, *args: Any) -> Any:
        notes.ended = True
        return take_snapshot(self, *args)

    def moving(self: ProposalQueue, entry: Any, firing: Any) -> Origin:
        origin = move(self, entry, firing)
        notes.note(self, "move", self.state.promised, (Item(entry, origin, True),))
        return origin

    def resuming(self: Membership) -> None:
        new_life(self)
        if "commit" not in notes.busy:
            what = "new_life" if "join" in notes.busy else "resume"
            notes.note(self, what, self.state.promised, ())

    def joining(self: Membership) -> None:
        notes.busy.append("join")
        join(self)
        notes.busy.pop()

    def forgetting(self: Membership, why: str, keep: bool = False) -> None:
        forget(self, why, keep)
        notes.logs[self.config.name].append(self.state.log_id)
        if "commit" not in notes.busy:
            notes.ended = notes.ended or keep
            notes.note(self, "forget", self.state.promised, ())

    def hearing(self: Membership, robot: str, log: str, *, sure: bool) -> None:
        hear(self, robot, log, sure=sure)
        number = notes.log(robot, log)
        if len(notes.logs[self.config.name]) > 1:
            notes.note(self, "hear", Ballot(number, robot, log), ())

    steps = mock.patch.multiple(
        Consensus,
        _promise=promising,
        _answer_prepare=answering,
        _persist_accepted=accepting,
    )
    slots = mock.patch.multiple(Replication, _commit=deciding, _take_snapshot=learning)
    lives = mock.patch.multiple(
        Membership, new_life=resuming, forget=forgetting, _note_log=hearing, want_to_join=joining
    )
    moves = mock.patch.object(ProposalQueue, "add_local_transition", moving)
    with steps, slots, lives, moves:
        yield


def traced(seed: int, robots: int, steps: int = 60, partial: bool = False) -> Trace:
    """Run a team, and return its first steps."""
    source = random.Random("traces|%d" % seed)
    evict_after = 1.0 if source.random() < 0.3 else 0.0
    plan = make_plan(seed, robots, partial, evict_after, 0.0, False)
    bad = source.random() < 0.7
    weather = Weather(loss=0.2, duplication=0.2, late=0.3) if bad else Weather()
    world = World(plan, seed, weather)
    notes = Notes([robot.name for robot in plan.robots], (log_entries.Leave,))
    with noting(notes), contextlib.suppress(ViolationError):
        for node in world.nodes.values():
            node.start()
        _stop_sometimes(world, source, notes)
        if partial:
            _order_sometimes(world, source)
        if plan.submissions:
            world.steered = plan is make_plan(STEERED, robots, partial, evict_after, 0.0, False)
            world.at(0.1, lambda: world.publish_tasks(0.05))
            world.at(0.1, lambda: world.tell_time(0.05))
            world.at(0.2, lambda: _order_about_tasks(world, source))
        world.run(6.0, lambda: notes.ended or len(notes.steps) >= steps)
    return notes.steps[:steps]


def _stop_sometimes(world: World, source: random.Random, notes: Notes) -> None:
    """Suspend a robot now and then, so that others take over, or evict it; or kill it and start it
    again, perhaps without its log."""
    node = source.choice(list(world.nodes.values()))
    until = world.now + source.uniform(0.05, 2.5 if world.plan.timing.evict_after else 0.6)
    replicas = [each.replica for each in world.nodes.values()]
    begun = node.replica is not None and node.replica.state.ledger.length > 0
    if all(r is not None and r.state.active for r in replicas) and source.random() < 0.2:
        node.crash()
        world.at(until, lambda: _start_without_log(world, node, notes))
    elif begun and source.random() < 0.3:
        node.crash()
        world.at(until, node.start)
    else:
        node.suspended = True
        world.at(until, node.resume)
    pause = source.uniform(0.0, 0.4)
    world.at(until + pause, lambda: _stop_sometimes(world, source, notes))


def _start_without_log(world: World, node: SimulatedNode, notes: Notes) -> None:
    first = Ballot(0, world.plan.robots[0].name)
    notes.log(node.name, node.log_id)
    node.lose_log()
    notes.logs[node.name].append(world.new_log_id(node))
    notes.add(node.name, "lose", first, (), Known(0, first, None, 0, False))
    node.start()


def _order_sometimes(world: World, source: random.Random) -> None:
    """Order a robot to pause or to go on now and then, which local transitions must not pass."""
    name = source.choice(list(world.nodes))
    order = source.choice((log_entries.Pause, log_entries.Resume))
    world.operator(order(name), world.nodes[name])
    world.at(world.now + source.uniform(0.1, 2.0), lambda: _order_sometimes(world, source))


def _order_about_tasks(world: World, source: random.Random) -> None:
    """Order a robot now and then what is to be done with a task."""
    node = source.choice(list(world.nodes.values()))
    if node.replica is not None:
        world.operator(world.order_about_task(node.replica, source), node)
    world.at(world.now + source.uniform(0.02, 0.2), lambda: _order_about_tasks(world, source))


BEYOND = ("reset", "outage", "forced", "snapshot")
"""The records with which something begins that traces of logs do not know."""


def _entries(record: Dict[str, Any]) -> List[log_entries.Entry]:
    """Those of a batch that was accepted, or of a slot; who decides alone writes only the slot."""
    if record["kind"] == "slot":
        return [log_entries.from_json(entry) for entry in record["entries"]]
    return [item.entry for item in Batch.from_json(record["batch"]).items]


def traced_logs(logs: Sequence[EventLog], steps: int = 300) -> Tuple[Trace, int, bool]:
    """The first steps of a real run, the number of its robots, and whether it is one of partial
    synchronisation: then it is not known who answered without a vote, or when robots held still. A trace ends where a member
    departs, or a log is lost.

    :param logs: those of all robots.
    :raises LogError: they are not logs of one run on one machine.
    """
    plan = logs[0].plan
    robots = [robot.name for robot in plan.robots]
    partial = plan.synchronisation is Synchronisation.PARTIAL
    if plan.witness:
        raise LogError("only a team without a witness has traces")
    if sorted(log.robot for log in logs) != sorted(robots):
        raise LogError("not the logs of exactly %s" % ", ".join(robots))
    if len({log.header.get("host") for log in logs}) > 1:
        raise LogError("only the clock of one machine orders what robots do")
    notes, first = Notes(robots, DEPARTURES), Ballot(0, robots[0])
    known = {name: Known(1, first, None, 0, False) for name in robots}
    records = [(r["mono"], log.robot, r) for log in logs for r in log.records]
    alone = {tuple(r["origin"]) for _, _, r in records if r["kind"] == "private"}
    frozen = {
        Ballot.from_json(r["ballot"])
        for _, _, r in records
        if r["kind"] in ("accepted", "slot") and any(map(is_control, _entries(r)))
    }
    for _, robot, record in sorted(records, key=lambda found: found[0]):
        kind = record["kind"]
        if kind in BEYOND or notes.ended:
            break
        if kind == "life" and record["incarnation"] > 0:
            known[robot] = known[robot]._replace(incarnation=record["incarnation"])
            notes.add(robot, "resume", known[robot].promised, (), known[robot])
        if kind == "private":
            item = Item(log_entries.from_json(record["entry"]), Origin(*record["origin"]), True)
            notes.add(robot, "move", known[robot].promised, (item,), known[robot])
        if kind not in ("promised", "accepted", "slot") or record.get("slot") == 0:
            continue
        ballot, mine = Ballot.from_json(record["ballot"]), record["ballot"][1] == robot
        items: Sequence[Item] = ()
        length, promised, accepted, incarnation, *_ = known[robot]
        if kind == "promised":
            what = "propose" if mine else "promise"
            promised = max(promised, ballot)
        elif kind == "accepted":
            batch = Batch.from_json(record["batch"])
            what, items = "second_phase" if mine else "vote", batch.items
            promised, accepted = max(promised, ballot), (ballot, batch)
        else:
            found = zip(record["entries"], record["origins"])
            items = [
                Item(log_entries.from_json(e), Origin(*o), tuple(o) in alone) for e, o in found
            ]
            what, length, accepted = "decide", length + 1, None
        known[robot] = Known(length, promised, accepted, incarnation, ballot in frozen)
        notes.add(robot, what, ballot, items, known[robot])
    return notes.steps[:steps], len(robots), partial


def check(
    traces: Sequence[Trace], robots: int, partial: bool = False, holds: bool = True
) -> List[Refused]:
    """Have TLC play the traces; returns those that it refuses.

    :param holds: whether the traces say when robots make no local transitions.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name in ("agreement.tla", "trace.tla"):
            (folder / name).write_text((FOLDER / name).read_text("utf-8"), "utf-8")
        (folder / "traces.tla").write_text(_module(traces), "utf-8")
        (folder / "traces.cfg").write_text(_configuration(robots, partial, holds), "utf-8")
        done = subprocess.run(
            [
                "java",
                "-XX:+UseSerialGC",
                "-XX:TieredStopAtLevel=1",
                "-Xss64m",
                "-cp",
                str(JAR),
                "tlc2.TLC",
                "-deadlock",
            ]
            + ["-workers", "1", "-config", "traces.cfg", "trace.tla"],
            cwd=scratch,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            check=False,
        )
    text = done.stdout.decode("utf-8", "replace")
    if "No error has been found" not in text:
        raise RuntimeError("TLC ends without an answer:\n" + text[-5000:])
    taken: Dict[int, int] = {}
    for trace, step in re.findall(r'<<"took", (\d+), (\d+)>>', text):
        taken[int(trace)] = max(taken.get(int(trace), 0), int(step))
    refused = []
    for number, steps in enumerate(traces, 1):
        step = taken.get(number, 0)
        if step < len(steps):
            found = re.search(
                r'<<\s*"differs",\s*%d,\s*%d,\s*"(\w+)",(.*?)>>\n(?=<<|\w)' % (number, step + 1),
                text,
                re.S,
            )
            differs = (found.group(1), " ".join(found.group(2).split())) if found else ()
            refused.append(Refused(number, step + 1, steps[step], differs))
    return refused


def _module(traces: Sequence[Trace]) -> str:
    """The module ``traces``. Each item and step is a definition, so that TLC reads it once: most of
    its time went into reading, and the same item is in many steps."""
    definitions: Dict[str, str] = {}

    def name(text: str) -> str:
        return definitions.setdefault(text, "d%d" % len(definitions))

    names = []
    for steps in traces:
        shared = [ITEM.sub(lambda item: name(item.group()), step) for step in steps]
        names.append("<<%s>>" % ", ".join(map(name, shared)))
    lines = ["%s == %s" % (as_, text) for text, as_ in definitions.items()]
    told = "Traces == <<\n%s\n>>" % ",\n".join(names)
    return "\n".join(["---- MODULE traces ----", *lines, told, "====", ""])


def _configuration(robots: int, partial: bool, holds: bool) -> str:
    constants = {
        "Robots": str(robots),
        "Wants": "{}",
        "Spares": "{}",
        "Begun": "TRUE",
        "Partial": str(partial).upper(),
        "Holds": str(partial and holds).upper(),
        "MaxLength": "1000",
        "MaxCounter": "1000",
        "MaxLogs": "1000",
    }
    faults = "Restarts Losses Outages Evictions Assertions Moves Pauses GiveBacks"
    constants.update(dict.fromkeys(faults.split(), "0"), Restarts="1000")
    constants.update(Losses="1000", Moves="1000", Pauses="1")
    lines = ["SPECIFICATION TraceSpec", "CONSTANTS"]
    lines += ["  %s = %s" % pair for pair in constants.items()]
    lines += ["  batches <- TraceBatches", "  counters <- TraceCounters"]
    lines += [
        "  wants <- TraceWants",
        "  spoken_for <- TraceSpokenFor",
        "  partial_batches <- TracePartialBatches",
        "  asking <- TraceAsking",
        "  Item <- TraceItem",
        "INVARIANTS",
        "  Agreement",
        "  PromisesAreKept",
    ]
    return "\n".join(lines) + "\n"


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Check; returns the exit code."""
    parser = argparse.ArgumentParser(prog="agreement.traces", description=__doc__.split("\n")[0])
    parser.add_argument("--traces", type=int, default=200, metavar="N", help="how many")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="the first seed")
    parser.add_argument(
        "--logs", nargs="+", type=Path, metavar="FOLDER", help="the logs of real runs instead"
    )
    args = parser.parse_args(arguments)
    if why_not():
        print("agreement.traces: " + why_not(), file=sys.stderr)
        return 2
    if args.logs:
        return _check_logs(args.logs)
    wrong = 0
    for first in range(args.seed, args.seed + args.traces, CHUNK):
        seeds = range(first, min(first + CHUNK, args.seed + args.traces))
        for robots, partial in ((2, False), (3, False), (2, True), (3, True)):
            begin = time.monotonic()
            mine = [seed for seed in seeds if seed % 4 == robots - 2 + 2 * partial]
            traces = [traced(seed, robots, partial=partial) for seed in mine]
            steps, refused = sum(map(len, traces)), check(traces, robots, partial)
            wrong += len(refused)
            kind, took = "partial" if partial else "full", time.monotonic() - begin
            figures = (robots, kind, len(traces), steps, len(refused), took)
            print("%d robots, %s: %d traces, %d steps, %d refused, %.1f s" % figures, flush=True)
            for one in refused[:10]:
                print("refused: trace %d, step %d: %s\n  differs: %s" % one)
    return int(wrong > 0)


def _check_logs(folders: Sequence[Path]) -> int:
    wrong = 0
    kinds: Dict[Tuple[int, bool], List[Tuple[Path, Trace]]] = {}
    for folder in folders:
        try:
            logs = [read_log(str(path)) for path in sorted(folder.glob("*.jsonl"))]
            if not logs:
                raise LogError("there is no log")
            steps, robots, partial = traced_logs(logs)
        except GspnError as error:
            print("%s: left out: %s" % (folder, error), flush=True)
            continue
        kinds.setdefault((robots, partial), []).append((folder, steps))
    for (robots, partial), found in sorted(kinds.items()):
        refused = check([steps for _, steps in found], robots, partial, holds=False)
        wrong += len(refused)
        kind, total = "partial" if partial else "full", sum(len(each) for _, each in found)
        figures = (robots, kind, len(found), total, len(refused))
        print("%d robots, %s: %d runs, %d steps, %d refused" % figures, flush=True)
        for one in refused:
            print("refused: %s" % found[one.trace - 1][0])
            print("  step %d: %s\n  differs: %s" % one[1:], flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
