"""``python3 -m benchmarks.proofs``: how long questions about all markings of plans take, for teams
on maps with the shape of real sites.

For each plan, question and team: the answer, the step that decided, the seconds for it and the
processor time, that for checking its certificate, and the size of that (kB).
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, Iterator, Optional, Sequence, Tuple

from benchmarks.machine import machine_line, table
from benchmarks.sites import SITES, site_plan
from gspn_framework_package.analysis.proofs.checker import check_certificate
from gspn_framework_package.analysis.proofs.ladder import decide_question
from gspn_framework_package.analysis.proofs.questions import (
    APART,
    CAN_MOVE,
    DEAD,
    FIRES,
    NEVER,
    NO_ROW,
    RETURNS,
    MarkingQuestion,
    problem_of,
)
from gspn_framework_package.model.plan import Plan

COLUMNS = {
    "site": "site",
    "robots": "robots",
    "question": "question",
    "verdict": "verdict",
    "decided_by": "decided by",
    "seconds": "seconds",
    "cpu": "CPU [s]",
    "check": "check CPU [s]",
    "size": "kB",
    "firings": "firings",
}


def questions(plan: Plan) -> Iterator[Tuple[str, MarkingQuestion]]:
    """The questions about a site's plan, each with a short name."""
    dock = next(name for name in plan.net.place_index if name.startswith("Free_dock_"))
    charging = [p for p in plan.net.place_index if p.startswith("Charge_" + dock[10:])]
    drives = next(p for p in plan.net.place_index if p.startswith("Drive_"))
    ends = drives[6:].rsplit("_", 1)[0]
    all_due = " and ".join("'%s' = 1" % p for p in plan.net.place_index if p.startswith("Due_"))
    for losses in (False, True):
        more = " (losses)" if losses else ""
        yield "dead marking" + more, MarkingQuestion(DEAD, "", losses)
        yield "no row" + more, MarkingQuestion(NO_ROW, "", losses)
        yield "two on an edge" + more, MarkingQuestion(APART, "Drive_*", losses)
        over = "%s >= 2" % " + ".join(["'%s'" % place for place in charging])
        yield "two in a dock" + more, MarkingQuestion(NEVER, over, losses)
        yield "free edge twice" + more, MarkingQuestion(APART, "Free_%s*" % ends[:4], losses)
        yield "moves" + more, MarkingQuestion(CAN_MOVE, "", losses)
        yield "all tasks due again" + more, MarkingQuestion(RETURNS, all_due, losses)
    first = [p for p in plan.net.places if p.tokens and p.name not in plan.resource_places]
    home = " and ".join("'%s' = %d" % (place.name, place.tokens) for place in first)
    yield "all robots home", MarkingQuestion(RETURNS, home)
    yield "two in a node", MarkingQuestion(APART, "At_*")
    yield "never fires", MarkingQuestion(FIRES, plan.net.transitions[-1].name)


def main(words: Optional[Sequence[str]] = None) -> int:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(prog="python3 -m benchmarks.proofs")
    parser.add_argument("--sites", nargs="*", default=list(SITES), choices=list(SITES))
    parser.add_argument("--robots", nargs="*", type=int, default=[1, 5, 20, 50])
    parser.add_argument("--seconds", type=float, default=120.0, help="budget of a question (s)")
    parser.add_argument("--narrow", action="store_true", help="one robot fits in a node")
    args = parser.parse_args(words)
    print(machine_line(), flush=True)
    rows = []
    for site in args.sites:
        for robots in args.robots:
            with tempfile.TemporaryDirectory() as folder:
                more: Dict[str, Any] = {}
                if args.narrow:
                    names = list(SITES[site]()[0])
                    start = [names[i * len(names) // robots] for i in range(robots)]
                    more = {"node_capacity": 1, "start": start, "docks": dict.fromkeys(start, 1)}
                plan = site_plan(site, robots, Path(folder), **more)
            for name, question in questions(plan):
                begun, used = time.perf_counter(), time.process_time()
                answer = decide_question(plan, question, limit=2_000, seconds=args.seconds)
                seconds, used = time.perf_counter() - begun, time.process_time() - used
                row: Dict[str, Any] = {
                    "site": site,
                    "robots": robots,
                    "question": name,
                    "verdict": answer.verdict,
                    "decided_by": answer.decided_by,
                    "seconds": "%.2f" % seconds,
                    "cpu": "%.2f" % used,
                }
                if answer.sequence is not None:
                    row["firings"] = len(answer.sequence)
                if answer.certificate is not None:
                    text = json.dumps(answer.certificate)
                    used = time.process_time()
                    check_certificate(problem_of(plan, question), json.loads(text))
                    row["check"] = "%.2f" % (time.process_time() - used)
                    row["size"] = len(text) // 1000
                rows.append(row)
                print(row, flush=True)
    print(table(list(COLUMNS.values()), ([row.get(key, "") for key in COLUMNS] for row in rows)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
