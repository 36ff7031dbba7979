"""Searches what small teams of real replicas can do, by an adversary without a clock.

``python3 -m benchmarks.agreement_search --transitions 1000000``

Exit codes: 0 no violation, 1 a violation (reported with what leads to it), 2 wrong usage.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import time
from typing import List, Optional

from agreement.mutants import MUTANTS
from agreement.search import SCOPES, Found, Scope, Search
from benchmarks.command import run_command
from gspn_framework_package.model.errors import UsageError

PART = 200_000
"""Transitions after which a search of a scope starts again, so that its memory stays small."""


class Totals:
    """What a search of one scope has done."""

    def __init__(self, scope: Scope) -> None:
        self.scope = scope
        self.transitions = self.states = self.depth = self.steps = self.slots = self.verified = 0
        self.seconds = 0.0

    def add(self, search: Search) -> None:
        """Add the figures of a part."""
        self.transitions += search.transitions
        self.states = max(self.states, search.states)
        self.depth = max(self.depth, search.depth)
        self.steps += search.steps
        self.slots = max(self.slots, search.longest)
        self.verified += search.verified


def search_scope(scope: Scope, transitions: int, seed: int, walks: bool) -> Totals:
    """Search a scope: half of the transitions breadth first, the rest at random; with ``walks`` all
    at random.

    :raises Found: a rule is broken.
    """
    totals, begin = Totals(scope), time.process_time()
    if not walks:
        wide = Search(scope)
        wide.breadth_first(transitions // 2)
        totals.add(wide)
    left = transitions - totals.transitions
    while left > 0:
        deep = Search(scope)
        deep.walk(min(left, PART), seed)
        totals.add(deep)
        left, seed = left - deep.transitions, seed + 1
    totals.seconds = time.process_time() - begin
    return totals


def main(arguments: Optional[List[str]] = None) -> int:
    """Search; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("scopes", nargs="*", metavar="SCOPE", help="only these; all: %s" % names())
    parser.add_argument(
        "--transitions",
        type=int,
        default=100_000,
        metavar="N",
        help="steps of each team (default %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the walks (default 0)")
    parser.add_argument(
        "--walks", action="store_true", help="all at random, as a part of a longer search"
    )
    parser.add_argument("--mutant", default="", metavar="NAME", help="with this seeded fault")
    parser.add_argument("--json", action="store_true", help="print one JSON object a line")
    args = parser.parse_args(arguments)
    unknown = set(args.scopes) - {scope.name for scope in SCOPES}
    if unknown:
        raise UsageError("there is no scope '%s'" % unknown.pop(), hint=names())
    mutants = [m for m in MUTANTS if m.name == args.mutant]
    if args.mutant and not mutants:
        raise UsageError("there is no mutant '%s'" % args.mutant)
    total = wrong = 0
    gc.set_threshold(50_000)  # nearly all that a search makes, it keeps
    with mutants[0].apply() if mutants else contextlib.nullcontext():
        for scope in SCOPES:
            if args.scopes and scope.name not in args.scopes:
                continue
            try:
                found = search_scope(scope, args.transitions, args.seed, args.walks)
            except Found as error:
                wrong += 1
                print("%s\n%s" % (error, "\n".join("  " + line for line in error.story)))
                continue
            total += found.transitions
            figures = {k: v for k, v in vars(found).items() if k != "scope"}
            if args.json:
                print(json.dumps({"scope": scope.name, **figures}), flush=True)
            else:
                print(
                    "%-28s %9d transitions, %8d states to depth %d complete, up to %d slots, %.0f s"
                    % (
                        scope.name,
                        found.transitions,
                        found.states,
                        found.depth,
                        found.slots,
                        found.seconds,
                    ),
                    flush=True,
                )
    if not args.json:
        print("%d transitions, %d violations" % (total, wrong))
    return 1 if wrong else 0


def names() -> str:
    """The names of the scopes."""
    return "; ".join(scope.name for scope in SCOPES)


if __name__ == "__main__":
    run_command("agreement_search", main)
