"""``gspn convert``: a net from one format into another."""

from __future__ import annotations

import argparse
import json
import sys

from gspn_framework_package.cli.net_input import add_net_arguments, print_notes, read_net_argument
from gspn_framework_package.formats import (
    FORMATS,
    encode_net,
    format_named,
    format_of_name,
    write_net,
)
from gspn_framework_package.model.errors import UsageError

NAME = "convert"
HELP = "write a net in another format"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    add_net_arguments(parser)
    parser.add_argument("output", metavar="OUT", help="the file to write, - for standard output")
    parser.add_argument(
        "--to",
        metavar="FORMAT",
        help="its format, when its name does not tell: %s"
        % ", ".join("%s (%s)" % (f.name, f.extensions[0]) for f in FORMATS.values()),
    )
    parser.add_argument("--json", action="store_true", help="print what was done as a JSON object")


def run(args: argparse.Namespace) -> int:
    """Convert the net."""
    if args.output == "-" and args.to is None:
        raise UsageError("--to is needed to write to standard output")
    if args.output == "-" and args.json:
        raise UsageError("--json and the net cannot both go to standard output")
    target = format_named(args.to) if args.to else format_of_name(args.output)
    net, notes = read_net_argument(args)
    if args.output == "-":
        data, losses = encode_net(net, target)
        sys.stdout.buffer.write(data)
    else:
        losses = write_net(net, args.output, target.name)
    if args.json:
        done = {
            "output": args.output,
            "format": target.name,
            "net": net.name,
            "places": len(net.places),
            "transitions": len(net.transitions),
            "arcs": len(net.arcs),
            "notes": notes + losses,
        }
        print(json.dumps(done, indent=2, ensure_ascii=False))
    else:
        print_notes(notes + losses)
    return 0
