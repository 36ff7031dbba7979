#!/usr/bin/env python3
"""A campaign: many small plans, put to every statement of what a plan means while it runs; and wrong
rules planted in each of them, which the plans must find.

    python3 test/campaigns/one_meaning.py --plans 2000 --seed 1
    python3 test/campaigns/one_meaning.py --plans 0 --mutants 200

It prints what was compared, each difference with its plan, and for each mutant after how many plans
which comparison found it. Exit codes: 0 all statements agree and all mutants were found, 1 not so.
"""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(TESTS), str(TESTS.parent)]

from meaning.comparing import COMPARISONS, Case, told_by
from meaning.mutant import hunt
from meaning.mutants import MUTANTS
from meaning.plans import FAMILIES, samples


def compare_all(plans: int, seed: int, families, comparisons) -> int:
    """Compare; report the counts and the differences, and return how many there were."""
    told: Counter = Counter()
    spent: Counter = Counter()
    different = 0
    shown = time.monotonic()
    for number, sample in enumerate(samples(seed, plans, families), 1):
        case = Case(sample)
        for name in comparisons:
            begun = time.process_time()
            found = told_by(COMPARISONS[name], case)
            spent[name] += time.process_time() - begun
            told[
                name, "equal" if found == [] else "not compared" if found is None else "DIFFERENT"
            ] += 1
            if found:
                different += 1
                print("%s, %s:\n  %s" % (case.name, name, "\n  ".join(found)), flush=True)
        if time.monotonic() - shown > 10:
            shown = time.monotonic()
            print("%d of %d plans" % (number, plans), file=sys.stderr, flush=True)
    for name in comparisons if plans else ():
        counts = ", ".join("%d %s" % (n, what) for (of, what), n in told.items() if of == name)
        print("%-20s %s; %.1f s of processor time" % (name, counts, spent[name]))
    return different


def hunt_all(limit: int, seed: int, word: str) -> int:
    """Hunt the mutants with ``word`` in their names; return how many were not found."""
    missed = 0
    for mutant in MUTANTS:
        if word not in mutant.name:
            continue
        found = hunt(mutant, limit, seed)
        if found.plans is None:
            missed += 1
            print("%s: NOT FOUND in %d plans" % (mutant.name, limit), flush=True)
        else:
            text = "%s: plan %d (%s), %s: %s"
            values = mutant.name, found.plans, found.plan, found.comparison, found.text[:100]
            print(text % values, flush=True)
    return missed


def main() -> int:
    """Compare plans and hunt mutants."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--plans", type=int, default=1000, help="plans to compare")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--family", action="append", choices=list(FAMILIES), help="only these")
    parser.add_argument(
        "--comparison", action="append", choices=list(COMPARISONS), help="only these"
    )
    parser.add_argument(
        "--mutants", type=int, default=100, metavar="PLANS", help="most plans for each (0: none)"
    )
    parser.add_argument("--only", default="", help="only mutants with this in their names")
    args = parser.parse_args()
    families = args.family or list(FAMILIES)
    wrong = compare_all(args.plans, args.seed, families, args.comparison or list(COMPARISONS))
    if args.mutants:
        wrong += hunt_all(args.mutants, args.seed, args.only)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
