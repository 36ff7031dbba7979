"""Reads files of bounded size, and writes files completely or not at all."""

from __future__ import annotations

import os

from gspn_framework_package.model.errors import InputError

MAX_BYTES = 90_000_000
"""Maximum size of a file to read, in bytes. A net of 100,000 arcs takes 20 to 40 MB in the most
verbose format."""


def read_bytes(path: str, limit: int = MAX_BYTES) -> bytes:
    """Return the content of a file.

    :raises InputError: the file cannot be read, or is larger than ``limit`` bytes.
    """
    path = os.fspath(path)
    try:
        if os.path.isfile(path) and os.path.getsize(path) > limit:
            raise _too_large(path, limit)
        with open(path, "rb") as file:
            data = file.read(limit + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("cannot read it: %s" % reason, file=path) from None
    if len(data) > limit:
        raise _too_large(path, limit)
    return data


def _too_large(path: str, limit: int) -> InputError:
    return InputError(
        "the file is larger than %d MB" % (limit // 1_000_000),
        file=path,
        hint="no net of a sensible size needs that; is it the right file?",
    )


def write_bytes(path: str, data: bytes) -> None:
    """Write a file atomically: a reader never sees half of it.

    :raises InputError: the file cannot be written.
    """
    path = os.fspath(path)
    if os.path.exists(path) and not os.path.isfile(path):  # a pipe or device cannot be replaced
        _write(path, path, data)
        return
    temporary = "%s.%d.part" % (path, os.getpid())
    _write(temporary, path, data)
    try:
        os.replace(temporary, path)
    except OSError as error:
        os.unlink(temporary)
        raise InputError("cannot write it: %s" % error.strerror, file=path) from None


def _write(where: str, path: str, data: bytes) -> None:
    try:
        with open(where, "wb") as file:
            file.write(data)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("cannot write it: %s" % reason, file=path) from None
