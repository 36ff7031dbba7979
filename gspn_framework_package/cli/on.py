"""``--on``: who computes long work."""

from __future__ import annotations

from typing import Any

from gspn_framework_package.analysis.executors import FORMS


def add_on_argument(parser: Any) -> None:
    """Declare who computes, on a parser or on a group of its arguments."""
    parser.add_argument(
        "--on",
        default="local",
        metavar="EXECUTOR",
        help="who computes: %s (default %%(default)s); the results are the same" % FORMS,
    )
