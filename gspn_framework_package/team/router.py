"""A router between the robots of a team: forwards messages, and enforces who may send what."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, List, Optional, Sequence

from gspn_framework_package.formats.source import Stamp, file_stamp
from gspn_framework_package.model.errors import GspnError, UsageError
from gspn_framework_package.team.flood_brake import FloodBrake
from gspn_framework_package.team.keys import TEAM_FILE, KeyFolder, read_keys
from gspn_framework_package.team.tcp_patience import SilenceLimit, ports_of
from gspn_framework_package.team.zenoh_session import TeamAccess, open_session

if TYPE_CHECKING:
    import zenoh

REPLACED = "the allow-list was replaced"
"""Beginning of a router's message about a new allow-list."""


class Router:
    """A router that runs in this process until it is closed.

    :param listen: endpoints at which robots, operators and other routers connect.
    :param connect: endpoints of other routers.
    :param keys_folder: the keys of this router; "" for none, which lets anybody take part.
    :param limited: drop messages that arrive over a connection faster than a robot sends. Do not
        set this without keys if other routers connect; with keys, the router recognises them.
    :raises GspnError: the keys cannot be used, or it cannot listen at an endpoint.

    :ivar members: how many members may take part; None if anybody may.
    """

    def __init__(
        self,
        listen: Sequence[str],
        connect: Sequence[str] = (),
        keys_folder: str = "",
        limited: bool = True,
    ) -> None:
        self._limited = limited
        self._listen, self._connect = tuple(listen), tuple(connect)
        self._folder = keys_folder
        self._seen = self._stamp()
        self._limit = SilenceLimit(ports_of(listen), ports_of(connect))
        self._brake: Optional[FloodBrake] = None
        self._session = self._open()

    def _open(self) -> zenoh.Session:
        access = router_access(self._listen, self._connect, self._folder, self._limited)
        self.members = len(access.keys.members) if access.keys else None
        session = open_session(access)
        self._limit.apply()
        if access.limited:
            self._brake = FloodBrake(ports_of(self._listen))
        return session

    def _stamp(self) -> Optional[Stamp]:
        """A value that changes when the allow-list is replaced."""
        return file_stamp(os.path.join(self._folder, TEAM_FILE)) if self._folder else None

    def follow_keys(self) -> str:
        """Apply the allow-list if it was replaced: close all connections; members that are still on
        the list connect again. Call this about once a second.

        :returns: a message about what was done; "" if nothing was.
        """
        if self._connect:  # there may be a new connection
            self._limit.apply()
        stamp = self._stamp()
        if stamp == self._seen:
            return ""
        self._seen = stamp
        try:
            _keys_of_router(self._folder)
        except GspnError as error:
            return "the previous allow-list stays in force: %s" % error
        self.close()
        try:
            self._session = self._open()
        except GspnError as error:
            self._seen = (-1, -1, -1)  # try again next time
            return "the router is down: %s" % error
        return "%s: %s may take part" % (REPLACED, self.members)

    def floods(self) -> List[str]:
        """Messages about connections that were slowed down or released since the last call."""
        return self._brake.news() if self._brake is not None else []

    def close(self) -> None:
        """Close all connections."""
        if self._brake is not None:
            self._brake.close()
            self._brake = None
        self._session.close()


def router_access(
    listen: Sequence[str], connect: Sequence[str], keys_folder: str, limited: bool
) -> TeamAccess:
    """The access of a :class:`Router` with these parameters.

    :raises GspnError: the keys cannot be used.
    """
    keys = _keys_of_router(keys_folder) if keys_folder else None
    routers = [member for member in keys.members if member.role == "router"] if keys else []
    # a connection to another router carries the messages of many robots and must not be limited
    limited = limited and not connect and len(routers) <= 1
    return TeamAccess(tuple(connect), tuple(listen), keys, router=True, limited=limited)


def _keys_of_router(folder: str) -> KeyFolder:
    keys = read_keys(folder)
    if keys.member.role != "router":
        raise UsageError(
            "these are the keys of %s '%s', not of a router" % (keys.member.role, keys.member.name),
            hint="gspn keys add DIR --routers NAME=HOST",
        )
    return keys
