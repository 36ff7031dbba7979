"""A shell in a pseudo-terminal, for commands that are typed as a person types them."""

from __future__ import annotations

import os
import pty
import re
import select
import subprocess
import time
from pathlib import Path
from typing import Mapping, Tuple

ENDED = r"<ended (\d+)>"


class Terminal:
    """A shell in a pseudo-terminal of its own.

    :param folder: where it begins.
    :param environment: its variables.
    """

    def __init__(self, folder: Path, environment: Mapping[str, str]) -> None:
        self._master, slave = pty.openpty()
        self._shell = subprocess.Popen(
            ["bash", "--norc", "--noediting", "-i"],
            cwd=str(folder),
            env={**environment, "PS1": "", "TERM": "xterm"},
            stdin=slave,
            stdout=slave,
            stderr=slave,
            preexec_fn=_take_terminal,
        )
        os.close(slave)

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._master)  # who still runs in it is hung up
        try:
            self._shell.wait(10)
        except subprocess.TimeoutExpired:
            self._shell.kill()
            self._shell.wait()

    def type(self, line: str, patience: float = 120.0) -> Tuple[int, str]:
        """Type a line, and wait for its end: its exit code, and what the terminal showed."""
        self.begin(line)
        return self.end(patience)

    def begin(self, line: str) -> None:
        """Type a line."""
        os.write(self._master, (line + "; echo \"<ended\" $?'>'\n").encode())

    def shows(self, pattern: str, patience: float = 120.0) -> str:
        """Wait until a line that was begun shows something: all that it has shown by then."""
        shown = self._read(pattern + "|" + ENDED, patience)
        assert not re.search(ENDED, shown), "it ended, and did not show %s:\n%s" % (pattern, shown)
        return shown

    def interrupt(self) -> None:
        """Press Ctrl-C."""
        os.write(self._master, b"\x03")

    def end(self, patience: float = 120.0) -> Tuple[int, str]:
        """Wait for the end of the line that was begun: its exit code, and what the terminal showed
        since."""
        shown = self._read(ENDED, patience)
        ended = re.search(ENDED, shown)
        assert ended
        return int(ended.group(1)), shown

    def _read(self, pattern: str, patience: float) -> str:
        shown = ""
        deadline = time.monotonic() + patience
        while not re.search(pattern, shown):
            left = deadline - time.monotonic()
            assert left > 0, "waited %g s for %s:\n%s" % (patience, pattern, shown)
            if select.select([self._master], [], [], left)[0]:
                shown += os.read(self._master, 65536).decode("utf-8", "replace")
        return shown


def _take_terminal() -> None:
    """Make the standard input the controlling terminal, so that Ctrl-C is heard."""
    import fcntl
    import termios

    os.setsid()
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
