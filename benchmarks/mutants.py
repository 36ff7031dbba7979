"""Every seeded fault, and after how many simulated teams it is caught.

``python3 -m benchmarks.mutants``

Exit codes: 0 all caught, 1 one was not, 2 wrong usage.
"""

from __future__ import annotations

import argparse
import json
from typing import List, Optional

from agreement.mutants import MUTANTS, Caught, hunt
from benchmarks.command import run_command
from gspn_framework_package.model.errors import UsageError


def main(arguments: Optional[List[str]] = None) -> int:
    """Hunt the mutants; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these")
    parser.add_argument(
        "--limit", type=int, default=3000, metavar="N", help="schedules each (default %(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="S", help="the first seed (default %(default)s)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object a line")
    args = parser.parse_args(arguments)
    unknown = set(args.names) - {m.name for m in MUTANTS}
    if unknown:
        raise UsageError(
            "there is no mutant '%s'" % unknown.pop(), hint=", ".join(m.name for m in MUTANTS)
        )
    missed = 0
    for mutant in MUTANTS:
        if args.names and mutant.name not in args.names:
            continue
        if mutant.harmless:
            caught = Caught(None, "", mutant.harmless)
        else:
            caught = hunt(mutant, args.limit, args.seed)
            missed += caught.schedules is None
        if args.json:
            print(
                json.dumps({"mutant": mutant.name, "part": mutant.part, **caught._asdict()}),
                flush=True,
            )
        else:
            after = "NOT CAUGHT" if caught.schedules is None else "after %d" % caught.schedules
            after = "harmless" if mutant.harmless else after
            print(
                "%-16s %-11s %-12s %s" % (mutant.name, mutant.part, after, caught.text[:120]),
                flush=True,
            )
    return 1 if missed else 0


if __name__ == "__main__":
    run_command("mutants", main)
