"""What a message over Zenoh costs, without and with mutual TLS, and what a flood does to a team.

``python3 -m benchmarks.carriers`` (needs eclipse-zenoh)

Every robot is a process of its own, and so is the router, all on this machine.

- *Round trip*: 500 bytes to another robot and back, one after the other.
- *Team*: ``plans/tokens`` as in :mod:`~benchmarks.latency`.
- *Flood*: the same, while somebody with the keys of a robot sends 10,000 messages a second. The
  processor time of a firing does not count theirs.

``--large N`` starts N robots, ten in a process, and measures how long it takes until all have
fired, and what they need.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import os
import queue
import statistics
import sys
import tempfile
import time
from typing import Any, Dict, List, NamedTuple, Optional, Sequence

import psutil

from benchmarks.latency import latencies, plan_of
from benchmarks.machine import describe_machine, machine_line, table
from benchmarks.ports import free_port
from benchmarks.processes import (
    child,
    cost_of,
    cpu_seconds,
    end_cleanly_on_signal,
)
from gspn_framework_package.execution.agreement.interface import Send
from gspn_framework_package.execution.agreement.messages import PROTOCOL_VERSION
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.model.plan import Synchronisation
from gspn_framework_package.team.agent import PrintedReporter, make_agent
from gspn_framework_package.team.carrier import Handlers, Operator, OperatorAnswer
from gspn_framework_package.team.host import HostOptions
from gspn_framework_package.team.keys import NewMember, make_team, read_keys
from gspn_framework_package.team.lanes import LANES
from gspn_framework_package.team.router import Router
from gspn_framework_package.team.zenoh_carrier import ZenohCarrier
from gspn_framework_package.team.zenoh_session import TeamAccess, key_of, open_session

LIBRARIES = ("eclipse-zenoh", "cryptography")
RUN = "carriers"
FLOODER = "flooder"
BYTES = 500
FLOOD = 10_000
"""Messages a second."""

_SPAWN = multiprocessing.get_context("spawn")  # no session survives a fork
_PATIENCE = 30.0


class _Site(NamedTuple):
    """Where the router is, and the keys; a folder "" for none."""

    endpoint: str
    keys: str

    def access(self, name: str) -> TeamAccess:
        """How a robot reaches the team."""
        keys = read_keys(os.path.join(self.keys, name)) if self.keys else None
        return TeamAccess((self.endpoint,), (), keys, patience=_PATIENCE)


# -- processes -------------------------------------------------------------------------------------


def _route(site: _Site, ready: Any, stop: Any) -> None:
    router = Router([site.endpoint], (), os.path.join(site.keys, "hub") if site.keys else "")
    ready.set()
    stop.wait()
    router.close()


def _no_orders(request: object, operator: Operator) -> OperatorAnswer:
    return OperatorAnswer(False, "")


def _echo(site: _Site, stop: Any) -> None:
    def answer(message: Dict[str, Any]) -> None:
        carrier.send([Send(message["from"], {**message, "from": "robot_2"})])

    handlers = Handlers(answer, _no_orders)
    carrier = ZenohCarrier("robot_2", RUN, site.access("robot_2"), handlers)
    stop.wait()
    carrier.close()


def _log_of(folder: str, robot: str) -> str:
    return os.path.join(folder, robot + ".jsonl")


def _robots(
    site: _Site, robots: int, names: Sequence[str], folder: str, load: str, stop: Any
) -> None:
    plan = plan_of(load, robots, Synchronisation.FULL)
    hosts = [
        make_agent(
            plan,
            robot,
            HostOptions(RUN, _log_of(folder, robot)),
            PrintedReporter(robot, quiet=True),
            lambda host: ZenohCarrier(host.robot, RUN, site.access(host.robot), host.handlers),
        )
        for robot in names
    ]
    for host in hosts:
        host.start(lambda robot: None)
    stop.wait()
    for host in hosts:
        host.stop()
    for host in hosts:
        host.join(10.0)


def _flood(site: _Site, sent: Any, stop: Any) -> None:
    session = open_session(site.access(FLOODER))
    keys = [key_of(RUN, FLOODER, "all", str(lane)) for lane in range(LANES)]
    lanes = itertools.cycle([session.declare_publisher(key, express=True) for key in keys])
    message = {"from": FLOODER, "version": PROTOCOL_VERSION, "kind": "pull", "text": "x" * BYTES}
    body = json.dumps(message).encode()
    began = time.monotonic()
    while not stop.is_set():
        due = int((time.monotonic() - began) * FLOOD)
        while sent.value < due:
            next(lanes).put(body)
            sent.value += 1
        time.sleep(0.005)
    session.close()


_PARTS = (_route, _robots, _flood)


# -- measurements ----------------------------------------------------------------------------------


class _Processes:
    """Processes that end when the block does."""

    def __init__(self, site: _Site) -> None:
        self.site = site
        self.stop = _SPAWN.Event()
        self._all: List[Any] = []
        self._parts: Dict[Any, List[int]] = {}

    def __enter__(self) -> _Processes:
        ready = _SPAWN.Event()
        self.start(_route, ready)
        if not ready.wait(_PATIENCE):
            raise TimeoutError("the router does not start")
        return self

    def start(self, target: Any, *arguments: Any) -> None:
        """Start a function of this module, with the site first and the event to stop last."""
        process = child(target, self.site, *arguments, self.stop)
        process.start()
        self._all.append(process)
        self._parts.setdefault(target, []).append(process.pid)

    def seconds(self, target: Any) -> float:
        """Processor seconds so far of the processes that were started with a function."""
        found = cpu_seconds(psutil.Process(pid) for pid in self._parts.get(target, []))
        return sum(found.values())

    def usage(self) -> Dict[str, float]:
        """Processor seconds, and memory (MB, what is shared divided among those who share it)."""
        cost = cost_of(psutil.Process(started.pid) for started in self._all)
        return {"cpu_s": cost.cpu_seconds, "memory_mb": cost.pss_mb}

    def __exit__(self, *_: object) -> None:
        self.stop.set()
        for process in reversed(self._all):
            process.join(15.0)
            if process.is_alive():
                process.kill()


def round_trips(site: _Site, count: int) -> Dict[str, Any]:
    """Times of ``count`` round trips between two robots (ms)."""
    answers: queue.SimpleQueue[Dict[str, Any]] = queue.SimpleQueue()
    with _Processes(site) as processes:
        processes.start(_echo)
        handlers = Handlers(answers.put, _no_orders)
        carrier = ZenohCarrier("robot_1", RUN, site.access("robot_1"), handlers)
        times: List[float] = []
        number, ends = 0, time.monotonic() + _PATIENCE
        while len(times) < count + 200:
            number += 1
            message = {"from": "robot_1", "number": number, "text": "x" * BYTES}
            began = time.perf_counter()
            carrier.send([Send("robot_2", message)])
            try:
                while answers.get(timeout=0.5)["number"] != number:
                    pass
            except queue.Empty:  # not connected yet
                if not times and time.monotonic() > ends:
                    raise TimeoutError("no answer from the other robot") from None
                continue
            times.append(1000 * (time.perf_counter() - began))
        carrier.close()
    times = sorted(times[200:])  # the first ones open the connections
    return {
        "round_trip_median_ms": round(statistics.median(times), 3),
        "round_trip_p99_ms": round(times[int(len(times) * 0.99)], 3),
    }


def team(
    site: _Site, robots: int, window: float, load: str = "instant", flooded: bool = False
) -> Dict[str, Any]:
    """Firings a second and times between two actions, over ``window`` seconds."""
    sent = _SPAWN.Value("q", 0, lock=False)
    with tempfile.TemporaryDirectory() as folder:
        with _Processes(site) as processes:
            for number in range(1, robots + 1):
                processes.start(_robots, robots, [_name(number)], folder, load)
            if flooded:
                processes.start(_flood, sent)
            _wait_for_logs(folder, robots)
            time.sleep(3.0)  # exclude the connections made in the background
            before, began = sent.value, time.monotonic()
            used = {part: processes.seconds(part) for part in _PARTS}
            time.sleep(window)
            flood = (sent.value - before) / window
            used = {part: processes.seconds(part) - used[part] for part in _PARTS}
        logs = [
            read_log(path)
            for path in [_log_of(folder, _name(number)) for number in range(1, robots + 1)]
        ]
    moves, coordinated = 0, []
    for log in logs:
        records = [r for r in log.records if r.get("mono", 0) < began + window]
        moves += sum(1 for r in records if r["kind"] == "goal" and r["mono"] >= began)
        coordinated += latencies(records, began)[1]
    coordinated.sort()
    violation = verify(logs).violation
    return {
        "firings_per_s": round(moves / window),
        "coordinated_median_ms": round(statistics.median(coordinated), 2) if moves else None,
        "coordinated_p99_ms": round(coordinated[int(len(coordinated) * 0.99)], 2)
        if moves
        else None,
        "cpu_ms_per_firing": round(1000 * (used[_robots] + used[_route]) / moves, 2)
        if moves
        else None,
        "router_percent_of_core": round(100 * used[_route] / window),
        **({"flood_per_s": round(flood)} if flooded else {}),
        **({"flooder_percent_of_core": round(100 * used[_flood] / window)} if flooded else {}),
        "logs": "rule %d: %s" % violation if violation else "valid",
    }


def large(site: _Site, robots: int, window: float, together: int = 10) -> Dict[str, Any]:
    """A large team, ``together`` robots in a process: seconds from the start of the first process
    until all robots have fired, and what they do and need over ``window`` seconds after that."""
    with tempfile.TemporaryDirectory() as folder:
        with _Processes(site) as processes:
            began = time.monotonic()
            names = [_name(number) for number in range(1, robots + 1)]
            for first in range(0, robots, together):
                processes.start(_robots, robots, names[first : first + together], folder, "light")
            _wait_for_logs(folder, robots)
            acting = time.monotonic() - began
            _wait_for_logs(folder, robots, goals=2)
            fired = time.monotonic() - began
            before = processes.usage()
            time.sleep(window)
            after = processes.usage()
            ends = time.monotonic()
        logs = [read_log(_log_of(folder, name)) for name in names]
    goals = [r for log in logs for r in log.records if r["kind"] == "goal"]
    moves = sum(1 for r in goals if ends - window <= r["mono"] < ends)
    violation = verify(logs).violation
    return {
        "all_act_s": round(acting, 1),
        "all_fired_s": round(fired, 1),
        "firings_per_s": round(moves / window, 1),
        "cpu_percent_of_core": round(100 * (after["cpu_s"] - before["cpu_s"]) / window),
        "memory_mb": round(after["memory_mb"]),
        "logs": "rule %d: %s" % violation if violation else "valid",
    }


def _name(number: int) -> str:
    return "robot_%d" % number


def _wait_for_logs(folder: str, robots: int, goals: int = 1) -> None:
    """Wait until every robot has started an action, or ``goals``."""
    waiting = {_log_of(folder, _name(number)) for number in range(1, robots + 1)}
    ends = time.monotonic() + 2 * _PATIENCE + robots
    while waiting:
        for path in sorted(waiting):
            if os.path.exists(path):
                with open(path, encoding="utf-8") as file:
                    if sum('"kind":"goal"' in line for line in file) >= goals:
                        waiting.discard(path)
        if time.monotonic() > ends:
            raise TimeoutError("%d robots do not act" % len(waiting))
        time.sleep(0.2)


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

LARGE_COLUMNS = (
    ("robots", "robots"),
    ("transport", "transport"),
    ("all_act_s", "all act [s]"),
    ("all_fired_s", "all fired [s]"),
    ("firings_per_s", "firings/s"),
    ("cpu_percent_of_core", "CPU [% of a core]"),
    ("memory_mb", "memory [MB]"),
    ("logs", "logs"),
)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--robots", type=int, nargs="+", default=[3, 5], metavar="N")
    parser.add_argument("--window", type=float, default=10.0, metavar="S", help="seconds (10)")
    parser.add_argument("--count", type=int, default=5000, metavar="N", help="round trips (5000)")
    parser.add_argument(
        "--large", type=int, nargs="+", metavar="N", help="only teams of N robots, ten in a process"
    )
    parser.add_argument(
        "--transport", choices=["tcp", "tls"], nargs="+", default=["tcp", "tls"], metavar="NAME"
    )
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    end_cleanly_on_signal()
    most = max([2, *args.robots, *(args.large or [])])
    rows: List[Dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        keys = os.path.join(folder, "keys")
        names = [_name(number) for number in range(1, most + 1)] + [FLOODER]
        members = [NewMember(name, "robot") for name in names]
        make_team(keys, [*members, NewMember("hub", "router", ("127.0.0.1",))], 1)
        for transport in args.transport:

            def site(transport: str = transport) -> _Site:
                endpoint = "%s/127.0.0.1:%d" % (transport, free_port())
                return _Site(endpoint, keys if transport == "tls" else "")

            def note(load: str, robots: int, found: Dict[str, Any], name: str = transport) -> None:
                rows.append({"load": load, "transport": name, "robots": robots, **found})
                print("carriers: %s" % rows[-1], file=sys.stderr, flush=True)

            if args.large:
                for robots in args.large:
                    note("large", robots, large(site(), robots, args.window))
                continue
            note("round trip", 2, round_trips(site(), args.count))
            for robots in args.robots:
                for load in ("light", "instant"):
                    note(load, robots, team(site(), robots, args.window, load))
            note("flood", most, team(site(), most, args.window, flooded=True))
    machine = describe_machine(LIBRARIES)
    if args.json:
        print(json.dumps({"machine": machine, "window_s": args.window, "rows": rows}))
    else:
        columns = LARGE_COLUMNS if args.large else COLUMNS
        heads = [head for _, head in columns]
        print(table(heads, [[row.get(key) for key, _ in columns] for row in rows]))
        print("\n" + machine_line(machine))
    return 0


if __name__ == "__main__":
    sys.exit(main())
