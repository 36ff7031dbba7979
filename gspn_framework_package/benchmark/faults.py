"""A soak: teams of real nodes under random faults, whose logs are verified after each round.

``python3 -m gspn_framework_package.benchmark.faults --minutes 30`` (needs ROS; has a master of its own)

A round is a fresh team of 2, 3 or 5 robots, in full or partial synchronisation, that executes ``plans/tokens`` for a
while. Meanwhile faults are injected, each undone after some seconds: a robot is killed (SIGKILL, also while it writes)
and restarted with or without its log, stopped (SIGSTOP) for a moment or beyond its eviction, the ROS master is killed
and restarted, a robot joins, one leaves. Then the team is paused until it rests, and the history checker looks at its
logs. Exit codes: 0 no violation, 1 a violation or a team that did not come to rest, 2 wrong usage.
"""

from __future__ import annotations

import argparse
import glob
import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from typing import Any, Callable, Dict, List, Optional, Sequence

from gspn_framework_package.benchmark.machine import describe_machine, machine_line
from gspn_framework_package.benchmark.plans import tokens_plan
from gspn_framework_package.benchmark.team_run import need_ros
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.history import verify
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.errors import ExecutionError, GspnError
from gspn_framework_package.model.plan import FunctionAction, Synchronisation, Timing

NODE = (
    "from gspn_framework_package.ros import node_main, node_process\n"
    "node_process.exit_with(node_main.run_execution_node())"
)
"""What a robot's process runs."""

EVICT_AFTER = 3.0
REST_TIME = 60.0
"""Seconds within which a team must rest after the last fault was undone."""

QUIET = 1.5
"""Seconds for which nothing may change in a team that rests."""


class Soak:
    """One round: a team, its faults, and what the checker says of it."""

    def __init__(self, master: _Master, robots: int, mode: Synchronisation, source: random.Random) -> None:
        self._master, self._source = master, source
        self.folder = tempfile.mkdtemp(prefix="gspn_soak_")
        action = FunctionAction("gspn_framework_package.benchmark.load.brief", "work")
        plan = tokens_plan().for_robots(robots)
        actions = {place: action._replace(server=place) for place in plan.actions}
        plan = replace(plan, actions=actions, synchronisation=mode, timing=Timing(evict_after=EVICT_AFTER))
        with open(os.path.join(self.folder, "plan.json"), "w", encoding="utf-8") as file:
            json.dump(plan_to_json(plan), file)
        self.mode, self.robots = mode, robots
        self.injected: Counter[str] = Counter()
        self._processes: Dict[str, Any] = {}
        self._gone: List[str] = []
        self._joined = 0
        for robot in plan.robots:
            self._start(robot.name)

    # -- processes ---------------------------------------------------------------------------------

    def _start(self, name: str, place: str = "") -> None:
        words = ["_plan:=" + self.folder, "_robot:=" + name, "_run:=soak", "_log_dir:=" + self.folder]
        with open(os.path.join(self.folder, name + ".txt"), "ab") as output:
            self._processes[name] = subprocess.Popen(
                [sys.executable, "-c", NODE, "__ns:=/" + name, "__name:=executor", "_place:=" + place, *words],
                stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
            )  # fmt: skip

    def _alive(self) -> List[str]:
        return [name for name, process in self._processes.items() if process.poll() is None]

    def close(self) -> None:
        """End every node."""
        for process in self._processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.send_signal(signal.SIGTERM)
        for process in self._processes.values():
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    # -- faults ------------------------------------------------------------------------------------

    def run(self, seconds: float) -> None:
        """Inject faults, one after the other, for that long."""
        self.wait_until(self._everybody_is_in, 60, "the start")
        deadline = time.monotonic() + seconds
        faults = [
            self._kill, self._kill, self._kill_without_log, self._stop_briefly, self._stop_long,
            self._kill_master, self._join, self._leave,
        ]  # fmt: skip
        while time.monotonic() < deadline:
            time.sleep(self._source.uniform(0.5, 3.0))
            fault = self._source.choice(faults)
            if fault():
                self.injected[fault.__name__.strip("_")] += 1
            self._revive()

    def _everybody_is_in(self) -> bool:
        try:
            return all(status["active"] for status in self.statuses())
        except ExecutionError:
            return False

    def _revive(self) -> None:
        """Start those again that have ended because they began while the master was away."""
        for name, process in list(self._processes.items()):
            if process.poll() is not None and name not in self._gone:
                self._start(name)

    def _victim(self) -> str:
        return self._source.choice(sorted(self._alive()))

    def _kill(self) -> bool:
        name = self._victim()
        self._processes[name].kill()
        self._processes[name].wait()
        time.sleep(self._source.choice([0.0, 0.5, 2.0]))
        self._start(name)
        return True

    def _kill_without_log(self) -> bool:
        # only one at a time may have lost its memory, and the others must be able to let it in again
        if len(self._alive()) < 3 or not self._everybody_is_in():
            return False
        name = self._victim()
        self._processes[name].kill()
        self._processes[name].wait()
        log = os.path.join(self.folder, "soak", name + ".jsonl")
        if os.path.exists(log):
            os.replace(log, "%s.%d.jsonl" % (log[: -len(".jsonl")], time.monotonic_ns()))
        self._start(name)
        return True

    def _stop_briefly(self) -> bool:
        return self._stop(self._source.uniform(0.1, 1.5))

    def _stop_long(self) -> bool:
        return self._stop(EVICT_AFTER + self._source.uniform(1.0, 4.0))

    def _stop(self, seconds: float) -> bool:
        process = self._processes[self._victim()]
        process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        process.send_signal(signal.SIGCONT)
        return True

    def _kill_master(self) -> bool:
        self._master.kill()
        time.sleep(self._source.uniform(0.5, 3.0))
        self._master.start()
        return True

    def _join(self) -> bool:
        if self._joined >= 2:
            return False
        self._joined += 1
        self._start("joined_%d" % self._joined, "p1")
        return True

    def _leave(self) -> bool:
        leaver = "joined_%d" % self._joined
        if leaver not in self._alive() or leaver in self._gone:
            return False
        self._gone.append(leaver)
        return self.order("leave", leaver)

    # -- the end -----------------------------------------------------------------------------------

    def order(self, command: str, robot: str) -> bool:
        """Give the team an order; whether it was carried out."""
        from gspn_framework_package.ros.operator_client import OperatorClient

        try:
            return OperatorClient().order(command, robot, "")[0]
        except ExecutionError:
            return False

    def statuses(self) -> List[Dict[str, Any]]:
        """What the nodes that are alive tell; :raises ExecutionError: one of them does not."""
        from gspn_framework_package.ros.operator_client import OperatorClient

        known = {n.namespace: s for n, s in OperatorClient().statuses().items() if s and s["run"] == "soak"}
        missing = [name for name in self._alive() if "/" + name not in known]
        if missing:
            raise ExecutionError("no answer of %s" % ", ".join(missing))
        return [known["/" + name] for name in self._alive()]

    def wait_until(self, condition: Callable[[], bool], seconds: float, what: str) -> None:
        """Wait for a condition on the team. :raises ExecutionError: it did not hold in time."""
        deadline = time.monotonic() + seconds
        last = ""
        while time.monotonic() < deadline:
            try:
                if condition():
                    return
            except ExecutionError as error:
                last = str(error)
            time.sleep(0.1)
        raise ExecutionError("waited %g s for %s" % (seconds, what), hint=last or None)

    def rest(self) -> None:
        """Pause the team, and wait until nothing changes any more."""
        self.wait_until(lambda: self.order("pause", ""), REST_TIME, "a pause of the team")
        last: List[Any] = [None, 0.0]

        def quiet() -> bool:
            told = self.statuses()
            now = {(s["log_length"], s["hash"]) for s in told}
            busy = any(s["pending"] or not s["active"] for s in told)
            if busy or len(now) > 1 or now != last[0]:
                last[:] = [now, time.monotonic()]
            return time.monotonic() - last[1] >= QUIET

        self.wait_until(quiet, REST_TIME, "all replicas to rest at one position")

    def verdict(self) -> Any:
        """What the history checker says of the logs."""
        logs = [read_log(path) for path in sorted(glob.glob(os.path.join(self.folder, "soak", "*.jsonl")))]
        return verify(logs, settled=True)


class _Master:
    """A ROS master that can be killed, and comes back on its port."""

    def __init__(self) -> None:
        with socket.socket() as probe:
            probe.bind(("localhost", 0))
            self._port = probe.getsockname()[1]
        os.environ["ROS_MASTER_URI"] = "http://localhost:%d" % self._port
        os.environ["ROS_HOSTNAME"] = "localhost"
        os.environ.pop("ROS_IP", None)
        self._process: Any = None

    def start(self) -> None:
        import rosgraph

        self._process = subprocess.Popen(
            ["rosmaster", "--core", "-p", str(self._port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        deadline = time.monotonic() + 30
        while not rosgraph.is_master_online():
            if time.monotonic() > deadline:
                raise ExecutionError("the ROS master did not start")
            time.sleep(0.05)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run rounds until the time is over; print what was injected and what was verified."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--minutes", type=float, default=30.0, metavar="M", help="of the whole soak (30)")
    parser.add_argument("--round", type=float, default=45.0, metavar="S", help="seconds of faults in a round (45)")
    parser.add_argument("--robots", type=int, nargs="+", default=[2, 3, 5], metavar="N", help="sizes of the teams")
    parser.add_argument("--seed", type=int, default=None, help="of the faults (new)")
    parser.add_argument("--keep", action="store_true", help="keep the logs of good rounds too")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    need_ros()
    seed = args.seed if args.seed is not None else random.SystemRandom().randrange(2**32)
    print("faults: seed %d" % seed, file=sys.stderr)
    source = random.Random(seed)
    master = _Master()
    master.start()
    total: Counter[str] = Counter()
    rounds, bad = [], []
    deadline = time.monotonic() + args.minutes * 60
    try:
        while time.monotonic() < deadline:
            robots, mode = source.choice(args.robots), source.choice(list(Synchronisation))
            row = _round(master, robots, mode, source, args.round, args.keep)
            rounds.append(row)
            total.update(row["injected"])
            if row["fault"]:
                bad.append(row)
            print(
                "faults: %d robots, %s: %s, %d firings, %s"
                % (robots, mode.value, row["injected"], row["firings"], row["fault"] or "valid"), file=sys.stderr,
            )  # fmt: skip
    finally:
        master.kill()
    report = {
        "machine": describe_machine(), "seed": seed, "rounds": len(rounds), "injected": dict(total),
        "firings": sum(r["firings"] for r in rounds), "slots": sum(r["slots"] for r in rounds), "bad": bad,
    }  # fmt: skip
    if args.json:
        print(json.dumps(report))
    else:
        print("%d rounds; injected: %s" % (len(rounds), ", ".join("%s %d" % item for item in total.most_common())))
        print("%d firings in %d slots verified, %d rounds bad" % (report["firings"], report["slots"], len(bad)))
        for row in bad:
            print("bad: %d robots, %s: %s; logs: %s" % (row["robots"], row["mode"], row["fault"], row["folder"]))
        print(machine_line())
    return 1 if bad else 0


def _round(
    master: _Master, robots: int, mode: Synchronisation, source: random.Random, seconds: float, keep: bool
) -> Dict[str, Any]:
    soak = Soak(master, robots, mode, source)
    fault, firings, slots = "", 0, 0
    try:
        soak.run(seconds)
        soak.rest()
        soak.close()
        verdict = soak.verdict()
        firings, slots = verdict.firings, verdict.slots
        if verdict.violation is not None:
            fault = "rule %d: %s" % verdict.violation
    except GspnError as error:
        fault = str(error)
    finally:
        soak.close()
    if not fault and not keep:
        shutil.rmtree(soak.folder, ignore_errors=True)
    return {
        "robots": robots, "mode": mode.value, "injected": dict(soak.injected), "firings": firings, "slots": slots,
        "fault": fault, "folder": soak.folder,
    }  # fmt: skip


if __name__ == "__main__":
    try:
        sys.exit(main())
    except GspnError as error:
        print("faults: error: %s" % error, file=sys.stderr)
        sys.exit(error.exit_code)
