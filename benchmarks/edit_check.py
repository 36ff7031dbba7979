"""How long the page waits for the check after an edit, for each shipped plan: the first, quick
check, by a process that is warm already. The processor time is that of the check alone; on a
machine that has nothing else to do, both are nearly the same.

``python3 -m benchmarks.edit_check``
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from typing import List

from benchmarks.machine import machine_line, table
from gspn_framework_package.formats.edited_document import document_of
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import PLAN_FILE
from gspn_framework_package.visualizer.editing.check_workers import CheckWorkers
from gspn_framework_package.visualizer.editing.findings import findings
from gspn_framework_package.visualizer.editing.help_routes import QUICK_SECONDS, QUICK_STATES


def main() -> None:
    """Check each plan some times, and print the median and the longest time."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("--times", type=int, default=9, help="checks of each plan")
    args = parser.parse_args()
    workers = CheckWorkers()
    rows: List[List[object]] = []
    try:
        for name in sorted(os.listdir(plans_folder())):
            folder = os.path.join(plans_folder(), name)
            if not os.path.isfile(os.path.join(folder, PLAN_FILE)):
                continue
            document = document_of(folder)
            taken = []
            for _ in range(args.times + 1):
                start = time.perf_counter()
                found = workers.ask(
                    name,
                    "check",
                    QUICK_SECONDS,
                    document=document,
                    path=os.path.join(folder, PLAN_FILE),
                    root=os.path.dirname(folder),
                    limit=QUICK_STATES,
                    standalone=False,
                )
                taken.append(1000 * (time.perf_counter() - start))
            used = []
            for _ in range(args.times + 1):
                began = time.process_time()
                findings(
                    document,
                    os.path.join(folder, PLAN_FILE),
                    os.path.dirname(folder),
                    lambda: False,
                    limit=QUICK_STATES,
                    seconds=60.0,
                )
                used.append(1000 * (time.process_time() - began))
            told = found["answer"]
            warm = taken[1:]  # the first may have waited for the process to start
            row = [name, told["states"], told["decided"]]
            times = [statistics.median(used[1:]), statistics.median(warm), max(warm)]
            rows.append([*row, *(round(value) for value in times)])
    finally:
        workers.close()
    print(machine_line())
    print("load: %s" % " ".join("%.1f" % load for load in os.getloadavg()))
    print(
        table(
            ["plan", "markings", "all decided", "processor (ms)", "median (ms)", "longest (ms)"],
            rows,
        )
    )


if __name__ == "__main__":
    main()
