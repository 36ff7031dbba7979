#!/usr/bin/env python3
"""A campaign: many random plans, and everything that answers for them held to the same answer.

    python3 test/campaigns/one_answer.py --plans 3000 --seed 1

It prints what was seen, and of each kind of difference the smallest plan. Exit codes: 0 all said
the same, 1 two differed.
"""

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(TESTS / "unit" / "analysis"), str(TESTS.parent)]
sys.path = [p for p in sys.path if Path(p or ".").resolve() != Path(__file__).parent]

from hypothesis import HealthCheck, Phase, given, seed, settings
from one_answer import answers, plans

from gspn_framework_package.formats.plan_json import plan_to_short_json


def main() -> int:
    """Try the plans; report the counts and the differences."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plans", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    told: Counter = Counter()
    different: dict = {}
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:

        @seed(args.seed)
        @settings(
            max_examples=args.plans,
            deadline=None,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(plan=plans())
        def every(plan):
            try:
                answers(plan, Path(folder) / "logs", told)
            except Exception as error:
                told["DIFFERENT"] += 1
                text = json.dumps(plan_to_short_json(plan))
                kind = "%s: %s" % (type(error).__name__, str(error).split(":")[0].split("\n")[0])
                different[kind] = min(different.get(kind, text), text, key=len)

        every()
    for what, count in told.items():
        print("%8d  %s" % (count, what))
    print("%8.1f  seconds" % (time.monotonic() - begun))
    for kind, text in different.items():
        print("%s\n  %s" % (kind, text))
    return int(bool(different))


if __name__ == "__main__":
    sys.exit(main())
