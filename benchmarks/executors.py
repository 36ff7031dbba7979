"""``gspn simulate`` and ``gspn sweep`` on each executor: ``python3 -m
benchmarks.executors``.

Each command runs as a user types it: in one process, on two worker processes, and on a Dask cluster
of two workers on this machine. Seconds are those of the whole command, with its start. The exit
code is 1 if an executor finds anything else than one process does.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

from benchmarks.machine import (
    LIBRARIES,
    describe_machine,
    machine_line,
    table,
)
from gspn_framework_package.formats.example_plans import plans_folder

_LIBRARIES = (*LIBRARIES, "dask", "distributed")


def commands(scale: float) -> List[Tuple[str, List[str]]]:
    """What is measured, with what it is called.

    :param scale: how many of the replications are done.
    """
    patrol, tokens = (os.path.join(plans_folder(), name) for name in ("patrol", "tokens"))
    runs = str(max(2, round(4000 * scale)))
    return [
        (
            "simulate patrol, 30 robots",
            ["simulate", patrol, "--robots", "30", "--time", "600", "--replications", runs],
        ),
        (
            "sweep tokens, 20 points",
            ["sweep", tokens, "--vary", "robots=1..10", "--vary", "rate:t1=1,2"]
            + ["--time", "600", "--replications", runs],
        ),
    ]


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, print, and return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--scale", type=float, default=1.0, help="do this share of the replications (1)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    with _cluster() as address:
        rows = [
            row
            for name, words in commands(args.scale)
            for row in _compared(name, words, ("local", "processes:2", "dask:" + address))
        ]
    if args.json:
        print(json.dumps({"machine": describe_machine(_LIBRARIES), "rows": rows}, indent=2))
    else:
        print(_text(rows))
    return 0 if all(row["same"] for row in rows) else 1


@contextmanager
def _cluster() -> Iterator[str]:
    """The address of a Dask scheduler with two workers on this machine."""
    import distributed

    cluster: Any = distributed.LocalCluster  # it has no types
    with cluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0") as it:
        yield it.scheduler_address


def _compared(name: str, words: Sequence[str], executors: Sequence[str]) -> List[Dict[str, Any]]:
    """The figures of a command on each of the executors, of which the first is one process."""
    rows: List[Dict[str, Any]] = []
    first: Any = None
    answered(words, executors[0])  # the first time, numba compiles what later runs load
    for executor in executors:
        load = os.getloadavg()[0]
        found, seconds = answered(words, executor)
        first = found if first is None else first
        rows.append(
            {
                "command": name,
                "on": executor.split(":")[0] if executor.startswith("dask") else executor,
                "seconds": seconds,
                "faster": rows[0]["seconds"] / seconds if rows else 1.0,
                "same": found == first,
                "load": load,
            }
        )
        print("%s on %s: %.1f s" % (name, executor, seconds), file=sys.stderr, flush=True)
    return rows


def answered(words: Sequence[str], executor: str) -> Tuple[Any, float]:
    """The answers of a command as JSON values, and the seconds that it took."""
    begin = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "gspn_framework_package", *words, "--json", "--on", executor],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        check=True,
    )
    return json.loads(done.stdout), time.monotonic() - begin


def _text(rows: Sequence[Mapping[str, Any]]) -> str:
    head = ("command", "--on", "seconds", "times as fast", "same answers", "load")
    keys = ("command", "on", "seconds", "faster", "same", "load")
    line = machine_line(describe_machine(_LIBRARIES))
    return "%s\n\n%s" % (line, table(head, ([row[key] for key in keys] for row in rows)))


if __name__ == "__main__":
    sys.exit(main())
