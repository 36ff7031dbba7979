"""The key that a team on one machine makes for its run, so that its messages are sealed although
nobody gave it a key."""

from __future__ import annotations

import os
from typing import Optional, Tuple

from gspn_framework_package.model.errors import KeysError
from gspn_framework_package.team.log_file import log_path
from gspn_framework_package.team.seal import TeamKey, make_team_key, read_team_key

AUTO, NONE = "auto", "none"
"""Given instead of the path of a key: use the key of the run, which is created if it is missing;
use no key."""


def run_key_file(run: str) -> str:
    """The path of the key of a run: ``~/.ros/gspn/RUN/team.key``."""
    return os.path.join(os.path.dirname(log_path("", run, "")), "team.key")


def make_run_key(run: str) -> Tuple[str, bool]:
    """The path of the key of a run, and whether it was made just now. Robots that start at the same
    time, or again after a loss of power, find the same key.

    :raises KeysError: it cannot be written.
    """
    path = run_key_file(run)
    if os.path.lexists(path):
        return path, False
    new = "%s.%d" % (path, os.getpid())
    try:
        os.makedirs(os.path.dirname(path), exist_ok=True)
        make_team_key(new)
        try:
            os.link(new, path)  # a reader never finds half a key
        except FileExistsError:
            return path, False
        finally:
            os.remove(new)
    except OSError as error:
        raise KeysError(
            "cannot be written (%s)" % error.strerror,
            file=path,
            hint="give the team a key of your own, or key:=none to do without",
        ) from None
    return path, True


def find_run_key(run: str) -> Optional[TeamKey]:
    """The key of a run on this machine, if this user may read it."""
    if os.path.basename(run) != run:  # the name comes from a robot, which may be anybody
        return None
    try:
        return read_team_key(run_key_file(run))
    except KeysError:
        return None
