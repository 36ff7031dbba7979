"""Notices of tasks that ended: a follower of a team receives each once, and may pass them to a web
address."""

from __future__ import annotations

import http.client
import ipaddress
import json
import socket
import ssl
from typing import Any, List, Mapping, Optional, Sequence
from urllib.parse import urlsplit

from gspn_framework_package.model.errors import ExecutionError, UsageError

HOOK_SECONDS = 5.0
"""Seconds that a web address has to answer."""

TaskNotice = Mapping[str, Any]
"""How a task ended, as a team reports it: ``id``, ``outcome``, ``why``."""


class EndedTasks:
    """Finds in a team's answers to ``tasks`` what ended since the last one.

    >>> ended = EndedTasks()
    >>> ended.news([{"id": "o1"}])  # ended before
    []
    >>> ended.news([{"id": "o1"}, {"id": "o2"}])
    [{'id': 'o2'}]
    """

    def __init__(self) -> None:
        self._known: Optional[List[TaskNotice]] = None

    @property
    def begun(self) -> bool:
        """Whether there was an answer."""
        return self._known is not None

    def news(self, ended: Sequence[TaskNotice]) -> List[TaskNotice]:
        """The tasks that ended since the last call; none at the first.

        :param ended: those that the team remembers, the newest last; it forgets the oldest.
        """
        known, self._known = self._known, list(ended)
        if known is None:
            return []
        for forgotten in range(len(known) + 1):
            kept = known[forgotten:]
            if kept == self._known[: len(kept)]:
                return self._known[len(kept) :]
        return []


class WebHook:
    """Posts notices to a web address, as JSON. Follows no redirection.

    :param url: ``http://`` or ``https://``.
    :param private_hosts: the hosts, as in ``url``, that may be called although their address is
        private: of this machine, or of a local network.
    :raises UsageError: the address is none of these.
    """

    def __init__(self, url: str, private_hosts: Sequence[str] = ()) -> None:
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError as error:
            raise UsageError("%.200r is not a web address (%s)" % (url, error)) from None
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise UsageError(
                "%.200r is not a web address" % url, hint="for example https://example.org/tasks"
            )
        self.url, self._host = url, parts.hostname
        self._secure = parts.scheme == "https"
        self._port = port or (443 if self._secure else 80)
        self._path = (parts.path or "/") + ("?" + parts.query if parts.query else "")
        self._private = {host.lower() for host in private_hosts}

    def post(self, notice: TaskNotice) -> None:
        """Post a notice.

        :raises ExecutionError: the host is private and not listed, or does not accept it.
        """
        try:
            # connect to the address that was checked
            connection = http.client.HTTPConnection(self._host, self._port, timeout=HOOK_SECONDS)
            connection.sock = self._connected()
            try:
                headers = {"Content-Type": "application/json"}
                connection.request("POST", self._path, json.dumps(notice), headers)
                status = connection.getresponse().status
            finally:
                connection.close()
        except (OSError, http.client.HTTPException) as error:
            raise ExecutionError("%s cannot be reached: %s" % (self.url, error)) from None
        if not 200 <= status < 300:
            raise ExecutionError("%s answers %d" % (self.url, status))

    def _connected(self) -> socket.socket:
        """A connection to the host. :raises OSError, ExecutionError: there is none."""
        found = socket.getaddrinfo(self._host, self._port, type=socket.SOCK_STREAM)
        address = str(found[0][4][0])
        if (
            self._host not in self._private
            and not ipaddress.ip_address(address.split("%")[0]).is_global
        ):
            raise ExecutionError(
                "%s is a private address (%s)" % (self._host, address),
                hint="list the host with --private-host %s if it may be called" % self._host,
            )
        plain = socket.create_connection((address, self._port), timeout=HOOK_SECONDS)
        if not self._secure:
            return plain
        return ssl.create_default_context().wrap_socket(plain, server_hostname=self._host)
