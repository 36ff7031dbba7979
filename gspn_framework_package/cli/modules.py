"""The option of the verbs that load or look up the functions of plans."""

from __future__ import annotations

import argparse

from gspn_framework_package.execution.plan_modules import names_of


def add_modules(parser: argparse.ArgumentParser) -> None:
    """Declare ``--modules``; the dispatcher allows the named modules before the verb runs."""
    parser.add_argument(
        "--modules",
        type=names_of,
        default=(),
        metavar="M,...",
        help="installed modules, packages or (with a '/') folders whose functions plans may name "
        "in addition to those in their own folders",
    )
