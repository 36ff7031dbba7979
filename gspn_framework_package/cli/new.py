"""``gspn new``: writes a plan to begin with, from a template."""

from __future__ import annotations

import argparse
import json
import shlex

from gspn_framework_package.cli import numbers
from gspn_framework_package.making import templates
from gspn_framework_package.model.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    parser.add_argument(
        "template", nargs="?", metavar="TEMPLATE", help="one of: %s" % ", ".join(templates.names())
    )
    parser.add_argument("folder", nargs="?", metavar="DIR", help="the folder to make")
    parser.add_argument("--robots", type=numbers.robots, metavar="N", help="number of robots")
    parser.add_argument(
        "--places",
        nargs="+",
        metavar="PLACE",
        help="where the robots go (%s)"
        % ", ".join(name for name in templates.names() if templates.takes_places(name)),
    )
    parser.add_argument("--list", action="store_true", help="list the templates")
    parser.add_argument("--json", action="store_true", help="print a JSON object")


def run(args: argparse.Namespace) -> int:
    """Write the plan."""
    if args.list:
        if args.json:
            print(json.dumps(templates.names(), indent=2))
        else:
            for name, about in templates.names().items():
                print("%-12s %s" % (name, about))
        return 0
    if args.template is None or args.folder is None:
        raise UsageError(
            "a template and a folder are needed",
            hint="as in 'gspn new patrol my_patrol'; --list lists the templates",
        )
    files = templates.write(args.template, args.folder, args.robots, args.places)
    if args.json:
        print(json.dumps({"folder": args.folder, "files": files}, indent=2, ensure_ascii=False))
    else:
        print("%s: %s" % (args.folder, ", ".join(files)))
        print("Next: gspn check %s" % shlex.quote(args.folder))
        print("README.md says how to run, analyse and test it.")
    return 0
