"""Runs a benchmark as a command."""

from __future__ import annotations

import sys
from typing import Callable, NoReturn

from gspn_framework_package.model.errors import GspnError


def run_command(name: str, main: Callable[[], int]) -> NoReturn:
    """Exit with what ``main`` returns. An error is one line that begins with the name."""
    try:
        sys.exit(main())
    except GspnError as error:
        print("%s: error: %s" % (name, error), file=sys.stderr)
        sys.exit(error.exit_code)
