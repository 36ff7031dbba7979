"""``gspn new``: writes a starter plan, from a template or as a copy of an example."""

from __future__ import annotations

import argparse
import json
import shlex
from typing import Sequence

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.formats.example_plans import ALL_EXAMPLES, copy_example, example_names
from gspn_framework_package.making import templates
from gspn_framework_package.model.errors import UsageError

OPTIONS: Arguments = {
    Argument("template", "TEMPLATE", nargs="?"): (
        "one of: %s" % ", ".join(templates.templates_by_name())
    ),
    Argument("folder", "DIR", nargs="?"): "the folder to create",
    Argument("--robots", "N", numbers.robots): "number of robots",
    Argument("--places", "PLACE", nargs="+"): (
        "where the robots go (%s)"
        % ", ".join(name for name in templates.templates_by_name() if templates.takes_places(name))
    ),
    Argument("--example", "NAME"): (
        "copy an example plan of the package into DIR instead; %s for all of them" % ALL_EXAMPLES
    ),
    "--list": "list the templates and the examples",
    "--json": "print a JSON object",
}


def run(args: argparse.Namespace) -> int:
    """Write the plan."""
    if args.list:
        if args.json:
            print(json.dumps(templates.templates_by_name(), indent=2))
        else:
            for name, about in templates.templates_by_name().items():
                print("%-12s %s" % (name, about))
            print("examples (--example NAME): %s" % ", ".join([*example_names(), ALL_EXAMPLES]))
        return 0
    if args.example is not None:
        return _copy_example(args)
    if args.template is None or args.folder is None:
        raise UsageError(
            "a template and a folder are required",
            hint="as in 'gspn new patrol my_patrol'; --list lists the templates",
        )
    files = templates.write(args.template, args.folder, args.robots, args.places)
    _print_written(args.folder, files, args.json)
    if not args.json:
        print("Next: gspn check %s" % shlex.quote(args.folder))
        print("README.md says how to run, analyse and test it.")
    return 0


def _copy_example(args: argparse.Namespace) -> int:
    folder = args.template  # the only argument
    if folder is None or args.folder is not None or args.robots is not None or args.places:
        raise UsageError(
            "--example takes only a folder",
            hint="as in 'gspn new --example patrol my_patrol'",
        )
    _print_written(folder, copy_example(args.example, folder), args.json)
    return 0


def _print_written(folder: str, names: Sequence[str], as_json: bool) -> None:
    if as_json:
        print(json.dumps({"folder": folder, "files": names}, indent=2, ensure_ascii=False))
    else:
        print("%s: %s" % (folder, ", ".join(names)))
