"""Temporary files for data that does not fit into memory.

The files have no name: the system frees their space when they are closed or when the process ends
for any reason.
"""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from pathlib import Path
from typing import Optional, Set, Union

import numpy as np

from gspn_framework_package.analysis.arrays import Floats
from gspn_framework_package.model.errors import LimitError, UsageError

_RESERVE = 64 << 20
"""Bytes of a disk left free for others."""

_LARGE_FILES = "/var/tmp"
"""The folder for large temporary files; ``/tmp`` may be in memory."""


class Scratch:
    """Space for temporary files in a folder.

    :param folder: the folder; None: that of the environment variable ``TMPDIR``, or ``/var/tmp``.
    :ivar used: bytes in use.
    :ivar peak: most bytes that were in use.
    :raises UsageError: there is no such folder, or no file can be made in it.
    """

    def __init__(self, folder: Union[str, Path, None] = None) -> None:
        if folder is None:
            folder = os.environ.get("TMPDIR") or (
                _LARGE_FILES if os.access(_LARGE_FILES, os.W_OK) else tempfile.gettempdir()
            )
        self.folder = Path(folder)
        self.used = 0
        self.peak = 0
        self._files: Set[ScratchFile] = set()
        try:
            self.file().close()
        except OSError as error:
            raise UsageError(
                "cannot create a temporary file in '%s': %s" % (folder, error.strerror),
                hint="give --scratch a folder to write to",
            ) from None

    def file(self) -> ScratchFile:
        """A new, empty file."""
        file = ScratchFile(self)
        self._files.add(file)
        return file

    def closed(self, file: ScratchFile) -> None:
        """Record that a file was closed."""
        self._files.discard(file)
        self.used -= file.size

    def close(self) -> None:
        """Close all files."""
        for file in list(self._files):
            file.close()

    def require(self, size: int) -> None:
        """Check for space. :raises LimitError: there is no space for ``size`` more bytes."""
        free = shutil.disk_usage(self.folder).free
        if size + _RESERVE > free:
            raise self.full(size, free)

    def full(self, size: int, free: Optional[int] = None) -> LimitError:
        """The error for too little space for ``size`` more bytes."""
        left = shutil.disk_usage(self.folder).free if free is None else free
        return LimitError(
            "the disk of '%s' is full: %.3g GB more are needed, and %.3g GB are free; %.3g GB are "
            "in use here" % (self.folder, size / 1e9, left / 1e9, self.used / 1e9),
            hint="free some space, or name a folder on a larger disk with --scratch",
        )

    def grow(self, size: int) -> None:
        """Count ``size`` more bytes as in use."""
        self.used += size
        self.peak = max(self.peak, self.used)


class ScratchFile:
    """A temporary file of arrays."""

    def __init__(self, scratch: Scratch) -> None:
        self._scratch = scratch
        self._file = tempfile.TemporaryFile(  # noqa: SIM115 (closed by close())
            dir=str(scratch.folder), buffering=0
        )
        self.size = 0

    def append(self, array: np.ndarray) -> int:
        """Write an array at the end; returns its position in bytes.

        :raises LimitError: the disk is full.
        """
        begin = self.size
        self.write(begin, array)
        return begin

    def write(self, position: int, array: np.ndarray) -> None:
        """Write an array to ``position`` (bytes).

        :raises LimitError: the disk is full.
        """
        left = np.ascontiguousarray(array).view(np.uint8).reshape(-1).data
        try:
            while len(left):
                written = os.pwrite(self._file.fileno(), left, position)
                left = left[written:]
                position += written
                self._scratch.grow(max(position - self.size, 0))
                self.size = max(self.size, position)
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                raise
            raise self._scratch.full(len(left)) from None

    def read(self, position: int, into: np.ndarray) -> np.ndarray:
        """Fill an array from ``position`` (bytes) on; returns the array."""
        left = into.view(np.uint8).reshape(-1).data
        while len(left):
            got = os.preadv(self._file.fileno(), [left], position)
            if not got:
                raise EOFError("a temporary file is shorter than expected")
            left = left[got:]
            position += got
        return into

    def close(self) -> None:
        """Free its space."""
        if not self._file.closed:
            self._file.close()
            self._scratch.closed(self)


class ScratchVector:
    """Floats in a temporary file, read and written in parts.

    :param size: their number.
    """

    def __init__(self, scratch: Scratch, size: int) -> None:
        self._file = scratch.file()
        self._size = size

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> Floats:
        begin, end, _ = part.indices(self._size)
        return self._file.read(8 * begin, np.empty(max(end - begin, 0), dtype=np.float64))

    def __setitem__(self, part: slice, values: Floats) -> None:
        begin, _, _ = part.indices(self._size)
        self._file.write(8 * begin, np.asarray(values, dtype=np.float64))

    def close(self) -> None:
        """Free its space."""
        self._file.close()
