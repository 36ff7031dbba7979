"""The command: runs scenarios in sequence, and reports the results."""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from typing import Any, Dict, List, Optional, Sequence

from benchmarks.harness.master import why_no_ros
from benchmarks.harness.network import why_impossible
from benchmarks.harness.team import why_no_zenoh
from benchmarks.machine import describe_machine, machine_line
from benchmarks.netns.experiment import TRANSPORTS
from benchmarks.netns.scenarios import (
    HOLD,
    NEED_DELAY,
    OF_TRANSPORT,
    SCENARIOS,
    TAKE_HOLD,
)
from gspn_framework_package.model.errors import GspnError

MODES = ("full", "partial")
PROBE_DELAY = 0.05


def why_not(scenarios: Sequence[str] = (), transport: str = "ros") -> str:
    """Why these scenarios cannot run on this machine; "" if they can."""
    delay = PROBE_DELAY if NEED_DELAY & set(scenarios) else 0.0
    return (why_no_zenoh() if transport == "zenoh" else why_no_ros()) or why_impossible(delay)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the scenarios; returns 0: the team behaved as it must in all of them, 1: it did not, 2:
    not possible here, or wrong usage."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.netns",
        description="Cuts and slows the network of a robot team, each robot in its own network "
        "namespace (needs root).",
        epilog="Exit codes: 0 all as it must be, 1 not so, 2 not possible on this machine, or "
        "wrong usage.",
    )
    parser.add_argument(
        "--scenario", action="append", choices=list(SCENARIOS), help="only this one (repeatable)"
    )
    parser.add_argument(
        "--transport",
        choices=list(TRANSPORTS),
        default="ros",
        help="what carries the messages: ros, with a master in the middle (default); masters: ros, "
        "with a master on each robot; or zenoh, with a router, mutual TLS and robots without ROS",
    )
    parser.add_argument("--mode", action="append", choices=MODES, help="only this synchronisation")
    parser.add_argument(
        "--hold",
        type=float,
        default=HOLD,
        metavar="S",
        help="keep the network cut for S seconds (4)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    if args.hold < 2:
        parser.error("--hold must be at least 2 seconds")
    possible = OF_TRANSPORT[args.transport]
    scenarios = args.scenario or possible
    for name in scenarios:
        if name not in possible:
            parser.error("there is no scenario '%s' on %s" % (name, args.transport))
    reason = why_not(scenarios, args.transport)
    if reason:
        print("not possible here: %s" % reason, file=sys.stderr)
        return 2
    # so that everything is cleaned up
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    results: List[Dict[str, Any]] = []
    try:
        for name in scenarios:
            for mode in args.mode or MODES:
                print(
                    "%s, %s synchronisation ..." % (name, mode),
                    end=" ",
                    file=sys.stderr,
                    flush=True,
                )
                results.append(_run(name, mode, args.hold, args.transport))
                print("%(outcome)s, %(seconds).0f s" % results[-1], file=sys.stderr)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    machine = describe_machine()
    if args.json:
        print(json.dumps({"machine": machine, "results": results}, indent=2))
    else:
        print(machine_line(machine) + "\n")
        for result in results:
            print(_line(result))
    return 0 if all(r["outcome"] == "ok" for r in results) else 1


def _run(name: str, mode: str, hold: float, transport: str) -> Dict[str, Any]:
    begin = time.monotonic()
    result: Dict[str, Any] = {"scenario": name, "mode": mode, "outcome": "ok"}
    result["load"] = os.getloadavg()[0]
    given: Dict[str, Any] = {"hold": hold} if name in TAKE_HOLD else {}
    try:
        result.update(SCENARIOS[name](mode, transport=transport, **given))
    except GspnError as error:
        result.update(outcome="FAILED", why=str(error))
    return dict(result, seconds=time.monotonic() - begin)


def _line(result: Dict[str, Any]) -> str:
    numbers = {
        k: v for k, v in result.items() if k not in ("scenario", "mode", "outcome", "seconds")
    }
    told = ", ".join(
        "%s %s" % (key.replace("_", " "), "%.3g" % value if isinstance(value, float) else value)
        for key, value in numbers.items()
    )
    return "%-13s %-8s %-7s %s" % (result["scenario"], result["mode"], result["outcome"], told)
