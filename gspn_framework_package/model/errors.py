"""The errors of the package: a small hierarchy under one base class.

Every error that a user can cause says *what* is wrong, *where* (file, element, line) and *what to
do*. The command line prints ``str(error)`` and exits with ``error.exit_code``: 1 when the answer
is "no" or a plan must not run, 2 when the input or the usage is wrong.
"""

from __future__ import annotations

import sys
from typing import Iterable, Optional


class GspnError(Exception):
    """Base of all errors of this package.

    :param message: what is wrong, as one sentence without a full stop.
    :param file: the file with the fault.
    :param line: the line in that file, counted from 1.
    :param element: the element of the file or model, e.g. ``arc a3`` or ``policy row 4``.
    :param hint: what to do about it.
    """

    exit_code = 2

    def __init__(
        self,
        message: str,
        *,
        file: Optional[str] = None,
        line: Optional[int] = None,
        element: Optional[str] = None,
        hint: Optional[str] = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.file = str(file) if file is not None else None
        self.line = line
        self.element = element
        self.hint = hint

    def __str__(self) -> str:
        place = ""
        if self.file:
            place = self.file + (":%d" % self.line if self.line else "") + ": "
        elif self.line:
            place = "line %d: " % self.line
        element = self.element + ": " if self.element else ""
        hint = " (%s)" % self.hint if self.hint else ""
        return place + element + self.message + hint

    def located(
        self,
        *,
        file: Optional[str] = None,
        line: Optional[int] = None,
        element: Optional[str] = None,
    ) -> GspnError:
        """Return this error with a position added by an outer reader; a position that is already
        known takes precedence."""
        self.file = self.file or (str(file) if file is not None else None)
        self.line = self.line or line
        self.element = self.element or element
        return self


class InputError(GspnError):
    """Invalid input; the base of all errors with exit code 2."""


class UsageError(InputError):
    """A command or function was called in an invalid way."""


class NetError(InputError):
    """A net is not well formed: duplicate or unknown name, negative weight, arc between two places
    ..."""


class ExpressionError(InputError):
    """A condition or an arithmetic expression cannot be read or evaluated."""


class NoValueError(ExpressionError):
    """An arithmetic expression names a constant that has no value."""


class PolicyError(InputError):
    """A policy is not well formed: a row of the wrong length, probabilities that do not sum to 1,
    an unknown name ..."""


class PlanError(InputError):
    """A plan is invalid: bad syntax, a schema violation or an unknown name."""


class DataError(InputError):
    """Data that an action returns, a task contains or a goal refers to is missing or unusable."""


class LogError(InputError):
    """An event log cannot be read, or its entries contradict each other."""


class KeysError(InputError):
    """The keys of a team are missing, damaged, expired or revoked."""


class WorkersError(InputError):
    """The workers of a long computation are unavailable, have other versions, or died too often."""


class RefusedError(GspnError):
    """The input is well formed, but the answer is no: for example, a plan must not run, or a
    property does not hold."""

    exit_code = 1


class NotEnabledError(RefusedError):
    """A transition was asked to fire in a marking that does not enable it."""


class LimitError(RefusedError):
    """The computation reached a limit on states, steps, memory or time before it had an answer."""


class CancelledError(RefusedError):
    """The caller cancelled a long computation."""


class ExecutionError(RefusedError):
    """A run cannot continue: a missing server, a stalled team, a broken action function."""


EXTRAS = {
    "PIL": "world",
    "cryptography": "team",
    "imageio_ffmpeg": "world",
    "matplotlib": "plots",
    "numba": "fast",
    "pybullet": "world",
    "z3": "proofs",
}
"""Library -> the extra of this package with which pip installs it."""


def missing_library(error: ModuleNotFoundError) -> str:
    """Return the message for a user whose Python lacks a library."""
    return "%s has no Python library '%s' (%s)" % (
        sys.executable,
        error.name,
        how_to_install(error.name or ""),
    )


def how_to_install(library: str) -> str:
    """Return how a user gets a library, for the end of a message."""
    extra = EXTRAS.get(library.partition(".")[0])
    if extra is None:
        return "pip install %s" % library
    return "it comes with the extra [%s]: in a checkout, pip install '.[%s]'" % (extra, extra)


def closest(word: object, known: Iterable[object]) -> str:
    """Return the known word that was probably meant; "" if none is similar."""
    import difflib  # imported only after an error

    close = difflib.get_close_matches(str(word), [str(one) for one in known], 1)
    return close[0] if close else ""
