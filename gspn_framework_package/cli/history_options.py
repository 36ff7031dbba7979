"""The options of verbs that play recorded runs on another plan."""

from __future__ import annotations

from typing import Dict, List

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.options import Argument, Arguments, repeated
from gspn_framework_package.model.errors import UsageError

HISTORY_OPTIONS: Arguments = {
    repeated("--reward", "NAME=R"): (
        "with --replay: the measure: R per token in a place and second, or per firing of a "
        "transition; a negative R is a cost. NAME may be a pattern. May be repeated (default: "
        "tasks that are done)"
    ),
    Argument("--margin", "PERCENT", numbers.number(0.0, 100.0), 5.0): (
        "with --replay: how much worse than the recorded plan it may be (default %(default)g)"
    ),
}


def read_mapping(pairs: List[str]) -> Dict[str, str]:
    """Parse ``--map OLD=NEW`` options. :raises UsageError: an option has another form, or
    contradicts another one."""
    mapping: Dict[str, str] = {}
    for pair in pairs:
        old, sign, new = pair.partition("=")
        if not old or not sign:
            raise UsageError("--map %s is not of the form OLD=NEW" % pair)
        if mapping.setdefault(old, new) != new:
            raise UsageError("--map gives '%s' two names" % old)
    return mapping
