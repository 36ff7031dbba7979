"""What a message over Zenoh costs, without and with mutual TLS, and what a flood does to a team.

``python3 -m benchmarks.carriers`` (needs eclipse-zenoh)

Every robot is a separate process, and so is the router, all on this machine.

- *Round trip*: 500 bytes to another robot and back, one after the other.
- *Team*: ``plans/tokens`` as in :mod:`~benchmarks.latency`.
- *Flood*: the same, while somebody with the keys of a robot sends 10,000 messages a second. The
  processor time of a firing does not count theirs.
"""

from __future__ import annotations

import argparse
import itertools
import json
import queue
import statistics
import sys
import time
from typing import Any, Dict, List, Optional, Sequence

from benchmarks.command import run_command
from benchmarks.harness.processes import end_cleanly_on_signal
from benchmarks.harness.team import RUN, AgentTeam, percentile_99, why_no_zenoh
from benchmarks.latency import plan_of
from benchmarks.machine import describe_machine, machine_line, table
from gspn_framework_package.execution.agreement.interface import Send
from gspn_framework_package.execution.agreement.messages import PROTOCOL_VERSION
from gspn_framework_package.model.errors import ExecutionError, UsageError
from gspn_framework_package.model.plan import Plan, Synchronisation
from gspn_framework_package.team.carrier import Handlers, Operator, OperatorAnswer
from gspn_framework_package.team.keys import NewMember, read_keys
from gspn_framework_package.team.lanes import LANES
from gspn_framework_package.team.zenoh_carrier import ZenohCarrier
from gspn_framework_package.team.zenoh_session import TeamAccess, key_of, open_session

LIBRARIES = ("eclipse-zenoh", "cryptography")
ECHO, FLOODER = "echo", "flooder"
"""Programs beside the robots; each has keys of its name."""
BYTES = 500
FLOOD = 10_000
"""Messages a second."""

_PATIENCE = 30.0


class CarrierTeam(AgentTeam):
    """A team whose router also lets in the programs of this benchmark.

    :param alone: whether there are no robots, only the router.
    """

    def __init__(self, plan: Plan, transport: str, alone: bool = False) -> None:
        super().__init__(plan, keys=transport == "tls")
        if alone:
            self.robots = []

    def members(self) -> List[NewMember]:
        """See :class:`~benchmarks.harness.team.AgentTeam`."""
        return [*super().members(), NewMember(ECHO, "robot"), NewMember(FLOODER, "robot")]

    def start_beside(self, name: str) -> None:
        """Start one of the programs of this benchmark."""
        words = [sys.executable, "-m", "benchmarks.carriers", "--be", name, *self.way(name)]
        self.programs.start(name, words)


# -- the programs beside the robots ----------------------------------------------------------------


def _access(endpoint: str, keys: str) -> TeamAccess:
    return TeamAccess((endpoint,), (), read_keys(keys) if keys else None, patience=_PATIENCE)


def _no_orders(request: object, operator: Operator) -> OperatorAnswer:
    return OperatorAnswer(False, "")


def _echo(access: TeamAccess) -> None:
    """Send every message back, until the process ends."""

    def answer(message: Dict[str, Any]) -> None:
        carrier.send([Send(message["from"], {**message, "from": ECHO})])

    carrier = ZenohCarrier(ECHO, RUN, access, Handlers(answer, _no_orders))
    while True:
        time.sleep(1.0)


def _flood(access: TeamAccess) -> None:
    """Send messages, and print each second how many there were, until the process ends."""
    session = open_session(access)
    keys = [key_of(RUN, FLOODER, "all", str(lane)) for lane in range(LANES)]
    lanes = itertools.cycle([session.declare_publisher(key, express=True) for key in keys])
    message = {"from": FLOODER, "version": PROTOCOL_VERSION, "kind": "pull", "text": "x" * BYTES}
    body = json.dumps(message).encode()
    began, sent, told = time.monotonic(), 0, 0
    while True:
        passed = time.monotonic() - began
        for _ in range(int(passed * FLOOD) - sent):
            next(lanes).put(body)
            sent += 1
        if passed > told:
            told += 1
            print(sent, flush=True)
        time.sleep(0.005)


# -- measurements ----------------------------------------------------------------------------------


def round_trips(transport: str, count: int) -> Dict[str, Any]:
    """Times of ``count`` round trips to another process (ms)."""
    answers: queue.SimpleQueue[Dict[str, Any]] = queue.SimpleQueue()
    plan = plan_of("light", 1, Synchronisation.FULL)
    me = plan.robots[0].name
    with CarrierTeam(plan, transport, alone=True) as team:
        team.start_beside(ECHO)
        _, endpoint, *keys = team.way(me)
        access = _access(endpoint, keys[-1] if keys else "")
        carrier = ZenohCarrier(me, RUN, access, Handlers(answers.put, _no_orders))
        times: List[float] = []
        number, ends = 0, time.monotonic() + _PATIENCE
        while len(times) < count + 200:
            number += 1
            message = {"from": me, "number": number, "text": "x" * BYTES}
            began = time.perf_counter()
            carrier.send([Send(ECHO, message)])
            try:
                while answers.get(timeout=0.5)["number"] != number:
                    pass
            except queue.Empty:  # not connected yet
                if not times and time.monotonic() > ends:
                    raise ExecutionError("no answer from the other process") from None
                continue
            times.append(1000 * (time.perf_counter() - began))
        carrier.close()
    times = times[200:]  # the first ones open the connections
    return {
        "round_trip_median_ms": round(statistics.median(times), 3),
        "round_trip_p99_ms": round(percentile_99(times), 3),
    }


def measure(
    transport: str,
    robots: int,
    window: float,
    load: str = "instant",
    flooded: bool = False,
    mode: Synchronisation = Synchronisation.FULL,
) -> Dict[str, Any]:
    """Firings a second and times between two actions, over ``window`` seconds."""
    with CarrierTeam(plan_of(load, robots, mode), transport) as team:
        if flooded:
            team.start_beside(FLOODER)
        team.await_steady()
        beside = [FLOODER] if flooded else []
        before = _sent(team) if flooded else 0
        found = team.measure(window, [team.hub, *beside])
        flood = (_sent(team) - before) / found.seconds if flooded else 0.0
        team.end()
        violation = team.verdict().violation
    row: Dict[str, Any] = {
        "firings_per_s": round(found.firings_per_s),
        **found.latencies(),
        "router_percent_of_core": round(100 * found.cpu[team.hub]),
        "logs": "rule %d: %s" % violation if violation else "valid",
    }
    if found.moves:
        share = (found.cpu["robots"] + found.cpu[team.hub]) / found.firings_per_s
        row["cpu_ms_per_firing"] = round(1000 * share, 2)
    if flooded:
        row["flood_per_s"] = round(flood)
        row["flooder_percent_of_core"] = round(100 * found.cpu[FLOODER])
    return row


def _sent(team: CarrierTeam) -> int:
    """How many messages the flood has had, as it said last."""
    return int((team.programs.output(FLOODER).split() or ["0"])[-1])


COLUMNS = (
    ("load", "load"),
    ("transport", "transport"),
    ("robots", "robots"),
    ("round_trip_median_ms", "round trip median [ms]"),
    ("round_trip_p99_ms", "p99 [ms]"),
    ("firings_per_s", "firings/s"),
    ("coordinated_median_ms", "coordinated median [ms]"),
    ("coordinated_p99_ms", "p99 [ms]"),
    ("cpu_ms_per_firing", "CPU per firing [ms]"),
    ("router_percent_of_core", "router [% of a core]"),
    ("flood_per_s", "flood/s"),
    ("flooder_percent_of_core", "flooder [% of a core]"),
    ("logs", "logs"),
)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, and print a table or JSON; returns 1 if a log is not valid."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--robots", type=int, nargs="+", default=[3, 5], metavar="N")
    parser.add_argument("--window", type=float, default=10.0, metavar="S", help="seconds (10)")
    parser.add_argument("--count", type=int, default=5000, metavar="N", help="round trips (5000)")
    parser.add_argument(
        "--transport", choices=["tcp", "tls"], nargs="+", default=["tcp", "tls"], metavar="NAME"
    )
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--be", choices=[ECHO, FLOODER], help=argparse.SUPPRESS)
    parser.add_argument("--connect", help=argparse.SUPPRESS)
    parser.add_argument("--keys", default="", help=argparse.SUPPRESS)
    args = parser.parse_args(arguments)
    reason = why_no_zenoh()
    if reason:
        raise UsageError(reason)
    if args.be:
        (_echo if args.be == ECHO else _flood)(_access(args.connect, args.keys))
        return 0
    end_cleanly_on_signal()
    rows: List[Dict[str, Any]] = []

    def note(load: str, robots: int, found: Dict[str, Any]) -> None:
        rows.append({"load": load, "transport": transport, "robots": robots, **found})
        print("carriers: %s" % rows[-1], file=sys.stderr, flush=True)

    for transport in args.transport:
        note("round trip", 2, round_trips(transport, args.count))
        for robots in args.robots:
            for load in ("light", "instant"):
                note(load, robots, measure(transport, robots, args.window, load))
        most = max(args.robots)
        note("flood", most, measure(transport, most, args.window, flooded=True))
    machine = describe_machine(LIBRARIES)
    if args.json:
        print(json.dumps({"machine": machine, "window_s": args.window, "rows": rows}))
    else:
        heads = [head for _, head in COLUMNS]
        print(table(heads, [[row.get(key) for key, _ in COLUMNS] for row in rows]))
        print("\n" + machine_line(machine))
    return 0 if all(row.get("logs", "valid") == "valid" for row in rows) else 1


if __name__ == "__main__":
    run_command("carriers", main)
