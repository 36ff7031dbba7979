"""``gspn verify``: checks that the logs of a run are consistent and valid, or proofs of ``gspn
check``."""

from __future__ import annotations

import argparse
import json
import os

from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.cli.proofs import checked_proofs, holds_proofs
from gspn_framework_package.execution.event_log import DamagedLogError, log_files, read_log
from gspn_framework_package.execution.verifier import Verdict, Violation, verify

OPTIONS: Arguments = {
    Argument("logs", "LOG", nargs="+"): (
        "event logs of one run, or a folder of them; or one file with proofs (gspn check "
        "--certificate), which are checked against the plan as it is now"
    ),
    "--settled": (
        "nothing was pending at the end of the run, so that a proposal missing from the log is a "
        "violation"
    ),
    "--incomplete": "some logs are missing, so do not count votes",
    "--json": "print the verdict as one JSON object",
}

EPILOG = (
    "Exit codes: 0 valid, 1 a rule is broken (the first one is explained) or a proof refused, 2 "
    "not logs of one run, nor proofs."
)


def run(args: argparse.Namespace) -> int:
    """Check the logs, or proofs, and print the verdict."""
    if len(args.logs) == 1 and holds_proofs(args.logs[0]):
        return _check_proofs(args)
    files = log_files(args.logs)
    sizes = [os.path.getsize(path) if os.path.exists(path) else None for path in files]
    try:
        logs = [read_log(path, size) for path, size in zip(files, sizes)]
        verdict = verify(logs, settled=args.settled, complete=not args.incomplete)
    except DamagedLogError as error:
        verdict = Verdict(Violation(1, str(error)), 0, 0, 0, len(files), [])
    if args.json:
        print(json.dumps(verdict.to_json(), indent=2))
    else:
        for note in verdict.notes:
            print("note       %s" % note)
        print(
            "%d logs, %d robots, %d slots, %d firings"
            % (verdict.logs, verdict.robots, verdict.slots, verdict.firings)
        )
        if verdict.violation is not None:
            print("VIOLATION  rule %d: %s" % verdict.violation)
        else:
            print("valid")
    return 0 if verdict.violation is None else 1


def _check_proofs(args: argparse.Namespace) -> int:
    results = list(checked_proofs(args.logs[0]))
    if args.json:
        rows = [{"statement": text, "refused": why} for text, why in results]
        print(json.dumps({"proofs": rows}, indent=2))
    else:
        for text, why in results:
            print("REFUSED    %s: %s" % (text, why) if why else "valid      %s" % text)
        print("%d proofs" % len(results))
    return int(any(why for _, why in results))
