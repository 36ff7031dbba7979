"""Marks of the active runs in a folder. They let a restarted server recognise runs that were cut
off.

A mark is a hidden file next to the event log, locked while its process lives. A run that ends
removes its mark; an unlocked mark belongs to a run whose server died.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from typing import Any, Dict, List, NamedTuple, Optional, TextIO

from gspn_framework_package.model.errors import LogError

ENDING = ".running"


class CutRun(NamedTuple):
    """A run that was cut off: the ``path`` of its plan in the served folder, its event ``log``
    (absolute path), the number of ``events`` (records) in it, and the file of its ``mark``."""

    path: str
    log: str
    events: int
    mark: str

    def forget(self) -> None:
        """Remove the mark: a user has taken note of the run."""
        with contextlib.suppress(OSError):
            os.remove(self.mark)


class RunMark:
    """The mark of a run of this process.

    :param log: the event log of the run.
    :param path: the plan, as a path in the served folder.
    :raises LogError: the mark cannot be written.
    """

    def __init__(self, log: str, path: str) -> None:
        folder, name = os.path.split(log)
        self._path = os.path.join(folder, "." + name + ENDING)
        try:
            self._file: Optional[TextIO] = open(self._path, "w", encoding="utf-8")  # noqa: SIM115
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            json.dump({"path": path, "log": name}, self._file)
            self._file.flush()
        except OSError as error:
            self.remove()
            raise LogError("cannot be written (%s)" % error.strerror, file=self._path) from None

    def remove(self) -> None:
        """Remove the mark: the run is over."""
        with contextlib.suppress(OSError):
            os.remove(self._path)
        file, self._file = getattr(self, "_file", None), None
        if file is not None:
            with contextlib.suppress(OSError):  # the file is no longer needed
                file.close()


def cut_runs(folder: str) -> List[CutRun]:
    """The runs recorded in ``folder`` whose server died, oldest first."""
    found = []
    try:
        names = sorted(n for n in os.listdir(folder) if n.startswith(".") and n.endswith(ENDING))
    except OSError:
        return []
    for name in names:
        run = _cut_run(folder, os.path.join(folder, name))
        if run is not None:
            found.append(run)
    return found


def _cut_run(folder: str, mark: str) -> Optional[CutRun]:
    """The run of a mark; None if it is still active, or if the mark cannot be read."""
    try:
        descriptor = os.open(mark, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
        with open(descriptor, encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            said: Dict[str, Any] = json.loads(file.read(100_000))
        log = os.path.join(folder, os.path.basename(str(said["log"])))
        return CutRun(str(said["path"]), log, _records(log), mark)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _records(log: str) -> int:
    """Number of complete lines after the header."""
    lines = 0
    with open(log, "rb") as file:
        for block in iter(lambda: file.read(1 << 20), b""):
            lines += block.count(b"\n")
    return max(0, lines - 1)
