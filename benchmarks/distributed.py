"""The analysis of a net by several ranks of MPI beside that by one process: ``python3 -m
benchmarks.distributed``.

Every net is analysed by one process and then on each number of ranks, in processes of their own.
Memory is the peak of a rank beyond what it had before the analysis, with all libraries loaded. The
exit code is 1 if a count differs, or a throughput or mean number of tokens by more than 1e-9.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from typing import Any, Dict, List, Mapping, Optional, Sequence

import numpy as np
from scipy import sparse

from benchmarks.machine import (
    LIBRARIES,
    describe_machine,
    machine_line,
    table,
)
from benchmarks.nets import FAMILIES
from benchmarks.processes import peak_mb
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.distributed import DistributedAnalysis
from gspn_framework_package.analysis.distributed.mpi_ranks import MpiRanks
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.solution.linear import sweeper
from gspn_framework_package.model.net import Net

TOLERANCE = 1e-9
"""The largest difference from one process that counts as none."""

_STATES = 10**9
_LIBRARIES = (*LIBRARIES, "mpi4py")
_ENVIRONMENT = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "NUMBA_NUM_THREADS": "1",
}
"""Open MPI in a container, with more ranks than processors, and one core for each process."""


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, print, and return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--family", choices=FAMILIES, default="kanban", help="the nets (kanban)")
    parser.add_argument(
        "--sizes", type=int, nargs="+", default=[3, 4], metavar="N", help="their sizes (3 4)"
    )
    parser.add_argument(
        "--ranks", type=int, nargs="+", default=[1, 2, 4], metavar="N", help="1 2 4"
    )
    parser.add_argument("--no-time", action="store_true", help="leave out the steady state")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args(arguments)
    if args.worker:
        family = FAMILIES[args.family]
        return _work(family(args.sizes[0]), family(2), args.ranks[0], not args.no_time)
    rows: List[Dict[str, Any]] = []
    for size in args.sizes:
        asked = ["--family", args.family, "--sizes", str(size)]
        asked += ["--no-time"] if args.no_time else []
        rows += _rows("%s %d" % (args.family, size), asked, args.ranks)
    if args.json:
        print(json.dumps({"machine": describe_machine(_LIBRARIES), "rows": rows}, indent=2))
    else:
        print(_text(rows))
    return 0 if all(row["same"] for row in rows) else 1


def _rows(name: str, asked: Sequence[str], ranks: Sequence[int]) -> List[Dict[str, Any]]:
    """The figures of one net: first those of one process (``ranks`` 0), then those of the ranks.
    ``shares`` is the memory of a rank in equal shares of that of one rank alone: 1 if it falls as
    1/N."""
    rows: List[Dict[str, Any]] = []
    for size in (0, *ranks):
        load = os.getloadavg()[0]
        found = measured(asked, size)
        alone = rows[0] if rows else {"answers": found["answers"], "counts": found["counts"]}
        row = {
            "net": name,
            "ranks": size,
            **found,
            "difference": _difference(found["answers"], alone["answers"]),
            "load": load,
        }
        row["same"] = row["counts"] == alone["counts"] and row["difference"] <= TOLERANCE
        rows.append(row)
        print("%s, %s: %.1f s" % (name, _who(size), row["seconds"]), file=sys.stderr, flush=True)
    one = next((row["peak_mb"] for row in rows if row["ranks"] == 1), None)
    for row in rows:
        row["shares"] = row["ranks"] * row["peak_mb"] / one if one and row["ranks"] else None
        del row["answers"]
    return rows


def measured(asked: Sequence[str], ranks: int) -> Dict[str, Any]:
    """What the workers found and took.

    :param asked: the arguments that name the net.
    :param ranks: how many there are; 0: one process without MPI.
    """
    command = [sys.executable, "-m", "benchmarks.distributed", "--worker"]
    if ranks:
        command = ["mpiexec", "-n", str(ranks), *command]
    done = subprocess.run(
        [*command, *asked, "--ranks", str(ranks)],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        env={**os.environ, **_ENVIRONMENT},
    )
    found: Dict[str, Any] = json.loads(done.stdout)
    return found


def _difference(found: Mapping[str, float], alone: Mapping[str, float]) -> float:
    return max((abs(value - alone[name]) for name, value in found.items()), default=0.0)


def _work(net: Net, smallest: Net, size: int, timing: bool) -> int:
    """Analyse the net in this process, or as one of the ranks, and print what it took."""
    _load_libraries()
    ranks = MpiRanks() if size else None
    if ranks is not None:
        DistributedAnalysis(smallest, ranks)  # an empty rank has its buffers for messages
    before = peak_mb()
    begin, begin_cpu = time.monotonic(), time.process_time()
    limits = Limits(states=_STATES, memory=1 << 50, seconds=1e9)
    answers: Dict[str, float] = {}
    if ranks is None:
        alone = Analysis(net, limits=limits, structure=False)
        space = alone.space
        counts = [len(space), space.arcs]
        explored = time.monotonic()
        if timing:
            answers = _answers(alone.measures.throughput, alone.measures.mean_tokens)
    else:
        together = DistributedAnalysis(net, ranks, limits=limits)
        total = together.counts()
        counts = [total["total"], total["arcs"]]
        explored = time.monotonic()
        if timing:
            steady = together.steady_state()
            answers = _answers(steady["throughput"], steady["mean_tokens"])
    end = time.monotonic()
    mine = (peak_mb() - before, before, time.process_time() - begin_cpu)
    peak, empty, cpu = np.max([mine] if ranks is None else ranks.gather(mine), axis=0).tolist()
    if ranks is None or ranks.rank == 0:
        found = {
            "counts": counts,
            "answers": answers,
            "explore_seconds": explored - begin,
            "steady_seconds": end - explored if timing else None,
            "seconds": end - begin,
            "cpu_seconds": cpu,
            "peak_mb": peak,
            "empty_mb": empty,
        }
        print(json.dumps(found))
    return 0


def _answers(throughput: Mapping[str, float], tokens: Mapping[str, float]) -> Dict[str, float]:
    return {**{"t:" + name: v for name, v in throughput.items()}, **tokens}


def _load_libraries() -> None:
    """Load what an analysis may load, so that it counts as memory of the empty process."""
    try:
        import gspn_framework_package.analysis.solution.numba_sweeps  # noqa: F401
    except ImportError:
        return
    one = np.ones(1)
    sweeper(sparse.csr_matrix((1, 1)), one, one, False)(one)


def _who(ranks: int) -> str:
    return "one process" if not ranks else "%d rank%s" % (ranks, "s" if ranks > 1 else "")


def _text(rows: Sequence[Mapping[str, Any]]) -> str:
    head = ("net", "by", "states", "arcs", "explore s", "steady s", "CPU s", "MB", "shares")
    keys = ("explore_seconds", "steady_seconds", "cpu_seconds", "peak_mb", "shares", "difference")
    cells = (
        [row["net"], _who(row["ranks"]), *row["counts"], *(row[key] for key in keys), row["load"]]
        for row in rows
    )
    line = machine_line(describe_machine(_LIBRARIES))
    return "%s\n\n%s" % (line, table((*head, "difference", "load"), cells))


if __name__ == "__main__":
    sys.exit(main())
