"""The option of the verbs that load the functions of plans, or look for them."""

from __future__ import annotations

import argparse

from gspn_framework_package.execution.plan_modules import names_of


def add_modules(parser: argparse.ArgumentParser) -> None:
    """Declare ``--modules``; the dispatcher allows what it names before the verb runs."""
    parser.add_argument(
        "--modules",
        type=names_of,
        default=(),
        metavar="M,...",
        help="installed modules, packages or (with a '/') folders whose functions plans may name, "
        "beside those in their own folders",
    )
