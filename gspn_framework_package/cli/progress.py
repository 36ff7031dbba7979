"""The progress line of long work on a terminal; silent if standard error is a file or a pipe."""

from __future__ import annotations

import sys
from typing import Any


class ProgressLine:
    """Rewrites one line of standard error; leaving the ``with`` block clears it.

    The object itself is the progress callback of the analysis: ``(what, count, seconds)``.
    """

    def __init__(self) -> None:
        self._shown = 0
        self._on = sys.stderr is not None and sys.stderr.isatty()

    def __call__(self, what: str, count: int, seconds: float) -> None:
        """Show the progress of the work."""
        if self._on:
            text = "%s %s, %.0f s (interrupt to stop)" % (format(count, ","), what, seconds)
            sys.stderr.write("\r" + text.ljust(self._shown))
            sys.stderr.flush()
            self._shown = len(text)

    def __enter__(self) -> ProgressLine:
        return self

    def __exit__(self, *_: Any) -> None:
        if self._shown:
            sys.stderr.write("\r" + " " * self._shown + "\r")
            sys.stderr.flush()
            self._shown = 0
