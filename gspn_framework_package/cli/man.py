"""``gspn man``: prints a manual page, made from the parsers of all verbs."""

from __future__ import annotations

import argparse
import re
from typing import Dict, Iterator

from gspn_framework_package import __version__
from gspn_framework_package.cli.options import Arguments

OPTIONS: Arguments = {}
EPILOG = "'gspn man | man -l -' shows it; the Debian package installs it."

_HEAD = """\
.TH GSPN 1 "" "gspn_framework_package %s"
.SH NAME
gspn \\- execute, simulate and analyse Generalized Stochastic Petri Net plans of robot teams
.SH SYNOPSIS
.B gspn
.I VERB
\\&...
.SH VERBS"""

_TAIL = """\
.SH EXIT STATUS
0 success or yes, 1 plan refused or answer no, 2 wrong input or usage."""


def run(args: argparse.Namespace) -> int:
    """Print the page."""
    from gspn_framework_package.cli.main import parsers

    print("\n".join(manual_page(parsers())))
    return 0


def manual_page(parsers: Dict[str, argparse.ArgumentParser]) -> Iterator[str]:
    """Yield the lines of the page, for ``man``.

    :param parsers: verb -> its parser.
    """
    yield _HEAD % __version__
    for verb, parser in parsers.items():
        yield ".SS %s" % _roff(verb)
        usage = " ".join(parser.format_usage().split())
        yield ".B %s\n.PP" % _roff(usage[len("usage: ") :])
        yield _roff(parser.description or "")
        formatter = parser._get_formatter()
        for action in parser._actions:
            if action.help in (None, argparse.SUPPRESS) or action.dest == "help":
                continue
            yield ".TP\n.B %s" % _roff(formatter._format_action_invocation(action))
            yield _roff(formatter._expand_help(action))
        if parser.epilog:
            yield ".PP\n%s" % _roff(parser.epilog.strip())
    yield _TAIL


def _roff(text: str) -> str:
    """A text, with what means something to ``man`` escaped."""
    escaped = text.replace("\\", "\\e").replace("-", "\\-")
    return re.sub(r"(?m)^([.'])", r"\\&\1", escaped)
