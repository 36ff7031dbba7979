"""Policy look-up beside a linear scan, from 10 rows to 1,000,000: ``python3 -m
gspn_framework_package.benchmark.policy``.

The table of ``n`` rows decides in one place of a net with twelve places: most rows are exact, one
in ten has a wildcard or two, and markings are drawn from those that some row matches. Both methods
must give the same row, or the benchmark fails.
"""

from __future__ import annotations

import argparse
import json
import random
import statistics
import sys
import time
from typing import Any, Dict, List, Optional, Sequence, Tuple

from gspn_framework_package.benchmark.machine import describe_machine, machine_line, table
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.policy import Policy, PolicyRow

SIZES = (10, 100, 1_000, 10_000, 100_000, 1_000_000)
PLACES = 12
CHOICES = ((("left", 0.25), ("right", 0.75)), (("left", 0.5), ("right", 0.5)))


def decision_net() -> Net:
    """A place ``decide`` with two immediate transitions, and places that the policy reads."""
    net = NetBuilder("decision").place("decide", tokens=1)
    for number in range(1, PLACES):
        net.place("p%d" % number)
    net.immediate("left", inputs="decide", outputs="p1")
    net.immediate("right", inputs="decide", outputs="p2")
    return net.build()


def random_policy(net: Net, rows: int, source: random.Random) -> Policy:
    """A policy of ``rows`` different rows; one in ten has one or two wildcards."""
    names = [place.name for place in net.places]
    tokens = 2 + int(rows ** (1 / (PLACES - 3)))
    seen = set()
    made: List[PolicyRow] = []
    while len(made) < rows:
        counts: List[Optional[int]] = [source.randrange(tokens) for _ in names]
        counts[0] = 1
        if len(made) % 10 == 9:
            for column in source.sample(range(PLACES - 3, PLACES), source.choice((1, 2))):
                counts[column] = None
        key = tuple(counts)
        if key not in seen:
            seen.add(key)
            made.append(PolicyRow(key, source.choice(CHOICES)))
    return Policy(names, made)


def scan(policy: Policy, marking: Sequence[int]) -> Optional[int]:
    """Number of the row for ``marking``, found by scanning all rows: fewest wildcards, then file
    order."""
    best, best_wildcards = None, len(marking) + 1
    for number, row in enumerate(policy.rows):
        wildcards = 0
        for count, tokens in zip(row.counts, marking):
            if count is None:
                wildcards += 1
            elif count != tokens:
                break
        else:
            if wildcards < best_wildcards:
                best, best_wildcards = number, wildcards
    return best


def measure(rows: int, budget: float) -> Dict[str, Any]:
    """Times for a policy of ``rows`` rows.

    :param budget: time (s) for the scans; at least three are made.
    :raises AssertionError: look-up and scan disagree.
    """
    net = decision_net()
    policy = random_policy(net, rows, random.Random(rows))
    begin = time.perf_counter()
    bound = policy.bind(net)
    markings = _markings(policy, random.Random(rows + 1))
    bound.distribution(markings[0], 0)
    build = time.perf_counter() - begin
    scanned: List[Tuple[Tuple[int, ...], Optional[int]]] = []
    times: List[float] = []
    end = time.perf_counter() + budget
    for marking in markings:
        begin = time.perf_counter()
        scanned.append((marking, scan(policy, marking)))
        times.append(time.perf_counter() - begin)
        if len(times) >= 3 and time.perf_counter() >= end:
            break
    for marking, number in scanned:
        found = bound.distribution(marking, 0)
        assert found is not None and found.row == number, "look-up and scan disagree"
    lookup = min(_round(bound, markings) for _ in range(5))
    scanning = statistics.median(times)
    return {
        "rows": rows,
        "prepare_s": build,
        "lookup_us": lookup * 1e6,
        "scan_us": scanning * 1e6,
        "ratio": scanning / lookup,
        "scans": len(times),
    }


def _markings(policy: Policy, source: random.Random) -> List[Tuple[int, ...]]:
    """Markings that rows of the policy match, sampled from the whole table."""
    rows = [policy.rows[source.randrange(len(policy.rows))] for _ in range(1_000)]
    return [tuple(source.randrange(3) if c is None else c for c in row.counts) for row in rows]


def _round(bound: Any, markings: Sequence[Sequence[int]]) -> float:
    begin = time.perf_counter()
    for marking in markings:
        bound.distribution(marking, 0)
    return (time.perf_counter() - begin) / len(markings)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(prog="benchmark.policy", description=__doc__.split(":")[0])
    parser.add_argument("--quick", action="store_true", help="up to 10,000 rows")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    sizes = [n for n in SIZES if not args.quick or n <= 10_000]
    results = []
    for rows in sizes:
        if sys.stderr.isatty():
            print("%d rows ..." % rows, file=sys.stderr)
        results.append(measure(rows, budget=0.2 if args.quick else 2.0))
    machine = describe_machine()
    if args.json:
        print(json.dumps({"machine": machine, "results": results}, indent=2))
        return 0
    print(machine_line(machine) + "\n")
    head = ("rows", "preparing [s]", "look-up [us]", "linear scan [us]", "scan / look-up")
    keys = ("rows", "prepare_s", "lookup_us", "scan_us", "ratio")
    print(table(head, [[r[k] for k in keys] for r in results]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
