"""Reads regular files of bounded size, and writes files completely or not at all."""

from __future__ import annotations

import errno
import os
import stat
from typing import BinaryIO, Optional, Tuple, cast

from gspn_framework_package.model.errors import InputError, RefusedError

MAX_BYTES = 90_000_000
"""Maximum size of a file to read, in bytes. A net of 100,000 arcs takes 20 to 40 MB in the most
verbose format."""


def open_file(path: str) -> BinaryIO:
    """Open a file to read bytes. Anything but a regular file is refused without waiting: a pipe may
    never deliver data, and a device may never end.

    :raises OSError: it is not a regular file, or cannot be opened; ``strerror`` says why.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError as error:  # a zero byte in the name
        raise OSError(errno.EINVAL, str(error), path) from None
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return cast(BinaryIO, os.fdopen(descriptor, "rb"))
    os.close(descriptor)
    what = "a folder" if stat.S_ISDIR(mode) else "a pipe" if stat.S_ISFIFO(mode) else "a device"
    raise OSError(errno.EINVAL, "it is %s, not a file" % what, path)


Stamp = Tuple[int, int, int]
"""The state of a file, which differs when the file was changed or replaced."""


def file_stamp(path: str) -> Optional[Stamp]:
    """The state of a file; None if there is none."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino


def read_bytes(path: str, limit: int = MAX_BYTES) -> bytes:
    """Return the content of a regular file.

    :raises InputError: the file cannot be read, or is larger than ``limit`` bytes.
    """
    path = os.fspath(path)
    try:
        with open_file(path) as file:
            if os.fstat(file.fileno()).st_size > limit:
                raise _too_large(path, limit)
            data = file.read(limit + 1)
    except OSError as error:
        raise InputError("cannot read it: %s" % error.strerror, file=path) from None
    if len(data) > limit:
        raise _too_large(path, limit)
    return data


def read_text(path: str, limit: int = MAX_BYTES) -> str:
    """Return the text of a file in UTF-8.

    :raises InputError: as :func:`read_bytes`, or it is not UTF-8 text.
    """
    try:
        return read_bytes(path, limit).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError("it is not UTF-8 text", file=os.fspath(path)) from None


def is_inside(path: str, folder: str) -> bool:
    """Whether a path, after following links, is in a folder or the folder itself."""
    folder = os.path.realpath(folder).rstrip(os.sep)
    return (os.path.realpath(path) + os.sep).startswith(folder + os.sep)


def named_file(name: str, folder: str, within: Optional[str]) -> str:
    """The path of a file that a plan names. All such names are resolved here.

    :param name: the name in the plan: relative to its folder, or absolute.
    :param folder: the folder of the plan.
    :param within: the folder that must contain the file; None for no restriction.
    :raises InputError: the name is not a file name.
    :raises RefusedError: it is not in the folder ``within``.
    """
    if not name.strip() or "\0" in name:
        raise InputError("%.100r is not the name of a file" % name)
    path = os.path.join(folder, name)
    if within is not None and not is_inside(path, within):
        raise RefusedError(
            "it names '%.200s', which is outside the folder and is not opened"
            % os.path.basename(name)
        )
    return path


def _too_large(path: str, limit: int) -> InputError:
    return InputError(
        "the file is larger than %d MB" % (limit // 1_000_000),
        file=path,
        hint="no reasonable net is that large; check that it is the right file",
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
