"""A disk that is full after so many bytes, for whoever writes an event log."""

import errno
import os


class _FullFile:
    def __init__(self, file, left):
        self._file, self._left = file, left

    def write(self, data):
        if not data or self._left <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written = self._file.write(data[: self._left])
        self._left -= written
        return written

    def __getattr__(self, name):
        return getattr(self._file, name)


def fill_the_disk(monkeypatch, after):
    """From now on the disk has room for ``after`` more bytes of each event log."""

    def opened(path, mode="r", *args, **options):
        file = open(path, mode, *args, **options)  # noqa: SIM115
        return _FullFile(file, after) if "a" in mode else file

    monkeypatch.setattr("gspn_framework_package.execution.log_writer.open", opened, raising=False)
