"""``gspn diff``: shows the difference between two plans or nets."""

from __future__ import annotations

import argparse
import json

from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.formats.difference import document_difference
from gspn_framework_package.formats.edited_document import document_of

OPTIONS: Arguments = {
    Argument("old", "OLD"): "a plan file, the folder of a plan, or a net",
    Argument("new", "NEW"): "another plan or net",
    "--json": "print the changes as JSON",
    "--positions": "also list nodes that only moved in the drawing",
}

EPILOG = "Exit codes: 0 no difference, 1 differences, 2 a file cannot be read."


def run(args: argparse.Namespace) -> int:
    """Print what has changed from the old plan to the new one."""
    changes = document_difference(document_of(args.old), document_of(args.new), args.positions)
    if args.json:
        print(json.dumps({"changes": [change.to_json() for change in changes]}, indent=2))
    else:
        for change in changes:
            print(change)
        print("%d change%s" % (len(changes), "" if len(changes) == 1 else "s"))
    return int(bool(changes))
