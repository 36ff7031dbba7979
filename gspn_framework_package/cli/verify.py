"""``gspn verify``: checks that the logs of a run are consistent and valid."""

from __future__ import annotations

import argparse
import json
import os

from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.execution.event_log import DamagedLogError, log_files, read_log
from gspn_framework_package.execution.verifier import Verdict, Violation, verify

OPTIONS: Arguments = {
    Argument("logs", "LOG", nargs="+"): "event logs of one run, or a folder of them",
    "--settled": (
        "nothing was pending at the end of the run, so that a proposal missing from the log is a "
        "violation"
    ),
    "--incomplete": "some logs are missing, so do not count votes",
    "--json": "print the verdict as one JSON object",
}

EPILOG = (
    "Exit codes: 0 valid, 1 a rule is broken (the first one is explained), 2 not logs of one run."
)


def run(args: argparse.Namespace) -> int:
    """Check the logs and print the verdict."""
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
