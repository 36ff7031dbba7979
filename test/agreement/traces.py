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
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from agreement.plans import STEERED, make_plan
from agreement.specification import FOLDER, JAR, why_not
from agreement.trace_notes import Known, Notes, Trace, noting
from agreement.world import SimulatedNode, ViolationError, Weather, World
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.messages import Batch
from gspn_framework_package.execution.agreement.quorum import Ballot
from gspn_framework_package.execution.agreement.state import is_control
from gspn_framework_package.execution.event_log import EventLog, read_log
from gspn_framework_package.execution.ledger import Item, Origin
from gspn_framework_package.model.errors import GspnError, LogError
from gspn_framework_package.model.plan import Synchronisation

CHUNK = 400
"""How many traces TLC plays in one run."""

ITEM = re.compile(r"\[entry [^]]*\]")
"""An item of a batch in the text of a step."""

DEPARTURES = (log_entries.Evict,)
"""The entries after which a robot begins another life that its log does not tell from a restart."""


class Refused(NamedTuple):
    """A trace that the specification does not allow. ``step`` counts from 1; ``differs``: the
    variable, its value in the specification and the replica's; () if no action can be taken."""

    trace: int
    step: int
    text: str
    differs: Tuple[str, ...]


def loses_power(seed: int) -> bool:
    """Whether machines lose power in the trace with this seed."""
    return seed // 4 % 4 == 0


def traced(
    seed: int, robots: int, steps: int = 60, partial: bool = False, more: bool = False
) -> Trace:
    """Run a team, and return its first steps.

    :param more: whether robots leave, too, and operators say that robots are off, and, with some
        seeds (:func:`loses_power`), machines lose power.
    """
    source = random.Random("traces|%d" % seed)
    evict_after = 1.0 if source.random() < 0.3 else 0.0
    plan = make_plan(seed, robots, partial, evict_after, 0.0, False)
    bad = source.random() < 0.7
    weather = Weather(loss=0.2, duplication=0.2, late=0.3) if bad else Weather()
    world = World(plan, seed, weather)
    notes = Notes([robot.name for robot in plan.robots], ())
    with noting(notes), contextlib.suppress(ViolationError):
        for node in world.nodes.values():
            node.start()
        _stop_sometimes(world, source, notes)
        if more:
            _depart_sometimes(world, source, notes, loses_power(seed))
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


def _depart_sometimes(
    world: World, source: random.Random, notes: Notes, without_power: bool
) -> None:
    if without_power:
        world.fsync = False
        world.keep_syncing(0.1)
        world.at(source.uniform(0.1, 0.6), lambda: _lose_power(world, source, notes))
    if source.random() < 0.3:
        world.at(source.uniform(0.1, 1.0), lambda: _assert_off(world, source))
    if source.random() < 0.2:
        world.at(source.uniform(0.1, 1.0), lambda: _leave(world, source))


def _assert_off(world: World, source: random.Random) -> None:
    """Switch robots off or cut them off, say at another one that they are off, and let them return."""
    nodes = list(world.nodes.values())
    if not all(node.replica is not None and node.replica.state.active for node in nodes):
        world.at(world.now + 0.1, lambda: _assert_off(world, source))
        return
    asked = nodes.pop(source.randrange(len(nodes)))
    gone, cut = source.sample(nodes, source.randint(1, len(nodes))), source.random() < 0.4
    links = {(a.key, b.key) for a in gone for b in world.nodes.values() if b not in gone}
    links |= {(b, a) for a, b in links}
    if cut:
        world.blocked |= links
    for node in gone:
        if not cut:
            node.crash()

    def order() -> None:
        for node in gone:
            asked.give(interface.ForceEvict("f%s" % node.name, node.name))

    def back() -> None:
        world.blocked -= links
        for node in gone:
            if not cut:
                node.start()

    world.at(world.now + 0.4, order)
    world.at(world.now + source.uniform(0.5, 1.5), back)


def _lose_power(world: World, source: random.Random, notes: Notes) -> None:
    """The power of some machines fails, or of all, and with it the newest records of their logs."""
    nodes = list(world.nodes.values())
    if not all(node.replica is not None and node.replica.state.active for node in nodes):
        world.at(world.now + 0.1, lambda: _lose_power(world, source, notes))
        return
    some = source.choice([len(nodes), source.randint(1, len(nodes))])
    for node in source.sample(nodes, some):
        disk = node.disk
        assert disk is not None
        whole = [n for name, n in notes.lines if name == node.name and n >= disk.synced]
        disk.synced = source.choice([*whole, len(disk.lines)])  # nothing of a step, or all of it
        del disk.lines[disk.synced :]
        node.lose_power()
        notes.lose_power(node.name, disk.synced)
        world.at(world.now + source.uniform(0.01, 0.5), node.start)


def _leave(world: World, source: random.Random) -> None:
    """A robot leaves in order, and is started again."""
    node = source.choice(world.alive() or list(world.nodes.values()))
    world.operator(log_entries.Leave(node.name), node)

    def back() -> None:
        node.crash()
        node.start()

    world.at(world.now + source.uniform(0.5, 1.5), back)


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
        known[robot] = Known(
            length,
            promised,
            accepted,
            incarnation,
            ballot in frozen,
            "{}",
            (max(0, length - 2), length - 1),
        )
        notes.add(robot, what, ballot, items, known[robot])
    return notes.steps[:steps], len(robots), partial


def check(
    traces: Sequence[Trace],
    robots: int,
    partial: bool = False,
    holds: bool = True,
    outages: bool = False,
) -> List[Refused]:
    """Have TLC play the traces; returns those that it refuses.

    :param holds: whether the traces say when robots make no local transitions.
    :param outages: whether machines lose power in them.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name in ("agreement.tla", "trace.tla"):
            (folder / name).write_text((FOLDER / name).read_text("utf-8"), "utf-8")
        (folder / "traces.tla").write_text(_module(traces), "utf-8")
        (folder / "traces.cfg").write_text(_configuration(robots, partial, holds, outages), "utf-8")
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


def _configuration(robots: int, partial: bool, holds: bool, outages: bool) -> str:
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
    constants.update(Losses="1000", Moves="1000", Pauses="1", Assertions="1")
    constants.update(Outages="1000" if outages else "0")
    lines = ["SPECIFICATION TraceSpec", "CONSTANTS"]
    lines += ["  %s = %s" % pair for pair in constants.items()]
    lines += ["  batches <- TraceBatches", "  counters <- TraceCounters"]
    lines += ["  forced_batches <- TraceForcedBatches", "  not_given_up <- TraceNotGivenUp"]
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
        for kind in range(8):
            robots, partial, outages = 2 + kind % 2, kind & 2 > 0, kind >= 4
            begin = time.monotonic()
            mine = [seed for seed in seeds if seed % 4 == kind % 4 and loses_power(seed) == outages]
            traces = [traced(seed, robots, partial=partial, more=True) for seed in mine]
            steps, refused = sum(map(len, traces)), check(traces, robots, partial, outages=outages)
            wrong += len(refused)
            text = "%s%s" % ("partial" if partial else "full", ", power fails" if outages else "")
            figures = (robots, text, len(traces), steps, len(refused), time.monotonic() - begin)
            print("%d robots, %s: %d traces, %d steps, %d refused, %.1f s" % figures, flush=True)
            for one in refused[:10]:
                print(
                    "refused: seed %d, step %d: %s\n  differs: %s" % (mine[one.trace - 1], *one[1:])
                )
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
