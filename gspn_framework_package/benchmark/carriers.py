"""What a message over Zenoh costs, without and with mutual TLS, and what a flood does to a team.

``python3 -m gspn_framework_package.benchmark.carriers`` (needs eclipse-zenoh)

Every robot is a process of its own, and so is the router, all on this machine.

- *Round trip*: 500 bytes to another robot and back, one after the other.
- *Team*: ``plans/tokens`` as in :mod:`~gspn_framework_package.benchmark.latency`.
- *Flood*: the same, while somebody with the keys of a robot sends 10,000 messages a second.
"""

from __future__ import annotations

import argparse
import glob
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

from gspn_framework_package.benchmark.latency import latencies, plan_of
from gspn_framework_package.benchmark.machine import describe_machine, machine_line, table
from gspn_framework_package.benchmark.ports import free_port
from gspn_framework_package.execution.agreement.interface import Send
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.history import verify
from gspn_framework_package.model.plan import Synchronisation
from gspn_framework_package.team.agent import PrintedVoice, make_agent
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


def _robot(site: _Site, robots: int, robot: str, log: str, load: str, stop: Any) -> None:
    plan = plan_of(load, robots, Synchronisation.FULL)
    host = make_agent(
        plan,
        robot,
        HostOptions(RUN, log),
        PrintedVoice(robot, quiet=True),
        lambda host: ZenohCarrier(robot, RUN, site.access(robot), host.handlers),
    )
    host.start(lambda robot: None)
    stop.wait()
    host.stop()
    host.join(10.0)


def _flood(site: _Site, sent: Any, stop: Any) -> None:
    session = open_session(site.access(FLOODER))
    keys = [key_of(RUN, FLOODER, "all", str(lane)) for lane in range(LANES)]
    lanes = itertools.cycle([session.declare_publisher(key, express=True) for key in keys])
    body = json.dumps({"from": FLOODER, "kind": "hello", "text": "x" * BYTES}).encode()
    began = time.monotonic()
    while not stop.is_set():
        due = int((time.monotonic() - began) * FLOOD)
        while sent.value < due:
            next(lanes).put(body)
            sent.value += 1
        time.sleep(0.005)
    session.close()


# -- measurements ----------------------------------------------------------------------------------


class _Processes:
    """Processes that end when the block does."""

    def __init__(self, site: _Site) -> None:
        self.site = site
        self.stop = _SPAWN.Event()
        self._all: List[Any] = []

    def __enter__(self) -> _Processes:
        ready = _SPAWN.Event()
        self.start(_route, ready)
        if not ready.wait(_PATIENCE):
            raise TimeoutError("the router does not start")
        return self

    def start(self, target: Any, *arguments: Any) -> None:
        """Start a function of this module, with the site first and the event to stop last."""
        process = _SPAWN.Process(target=target, args=(self.site, *arguments, self.stop))
        process.start()
        self._all.append(process)

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
                name = "robot_%d" % number
                processes.start(_robot, robots, name, os.path.join(folder, name + ".jsonl"), load)
            if flooded:
                processes.start(_flood, sent)
            _wait_for_logs(folder, robots)
            time.sleep(3.0)  # exclude the connections made in the background
            before, began = sent.value, time.monotonic()
            time.sleep(window)
            flood = (sent.value - before) / window
        logs = [read_log(path) for path in sorted(glob.glob(os.path.join(folder, "*.jsonl")))]
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
        **({"flood_per_s": round(flood)} if flooded else {}),
        "logs": "rule %d: %s" % violation if violation else "valid",
    }


def _wait_for_logs(folder: str, robots: int) -> None:
    """Wait until every robot has started an action."""
    ends = time.monotonic() + 2 * _PATIENCE
    while time.monotonic() < ends:
        paths = glob.glob(os.path.join(folder, "*.jsonl"))
        texts = [open(path, encoding="utf-8").read() for path in paths]  # noqa: SIM115
        if len(texts) == robots and all('"goal"' in text for text in texts):
            return
        time.sleep(0.2)
    raise TimeoutError("not all robots act")


COLUMNS = (
    ("load", "load"),
    ("transport", "transport"),
    ("robots", "robots"),
    ("round_trip_median_ms", "round trip median [ms]"),
    ("round_trip_p99_ms", "p99 [ms]"),
    ("firings_per_s", "firings/s"),
    ("coordinated_median_ms", "coordinated median [ms]"),
    ("coordinated_p99_ms", "p99 [ms]"),
    ("flood_per_s", "flood/s"),
    ("logs", "logs"),
)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--robots", type=int, nargs="+", default=[3, 5], metavar="N")
    parser.add_argument("--window", type=float, default=10.0, metavar="S", help="seconds (10)")
    parser.add_argument("--count", type=int, default=5000, metavar="N", help="round trips (5000)")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    most = max(2, *args.robots)
    rows: List[Dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        keys = os.path.join(folder, "keys")
        names = ["robot_%d" % number for number in range(1, most + 1)] + [FLOODER]
        members = [NewMember(name, "robot") for name in names]
        make_team(keys, [*members, NewMember("hub", "router", ("127.0.0.1",))], 1)
        for transport in ("tcp", "tls"):

            def site(transport: str = transport) -> _Site:
                endpoint = "%s/127.0.0.1:%d" % (transport, free_port())
                return _Site(endpoint, keys if transport == "tls" else "")

            def note(load: str, robots: int, found: Dict[str, Any], name: str = transport) -> None:
                rows.append({"load": load, "transport": name, "robots": robots, **found})
                print("carriers: %s" % rows[-1], file=sys.stderr, flush=True)

            note("round trip", 2, round_trips(site(), args.count))
            for robots in args.robots:
                for load in ("light", "instant"):
                    note(load, robots, team(site(), robots, args.window, load))
            note("flood", most, team(site(), most, args.window, flooded=True))
    machine = describe_machine(LIBRARIES)
    if args.json:
        print(json.dumps({"machine": machine, "window_s": args.window, "rows": rows}))
    else:
        heads = [head for _, head in COLUMNS]
        print(table(heads, [[row.get(key) for key, _ in COLUMNS] for row in rows]))
        print("\n" + machine_line(machine))
    return 0


if __name__ == "__main__":
    sys.exit(main())
