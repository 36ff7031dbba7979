"""Who may ask this server for what. A browser on a robot network visits other pages too.

Every request: the Host header must be one that the server was started with (a page that rebinds its
name to this machine has another). Every POST: from this very page, as Origin and Sec-Fetch-Site
tell, and with a header that a form of another page cannot send. Beyond loopback: a token. Every
answer: a content security policy that allows nothing from elsewhere.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from typing import FrozenSet, Iterable, Mapping, NamedTuple, Optional

HEADER = "X-Gspn-Page"
"""A header that every POST of the page carries."""

COOKIE = "gspn_token"

SECURITY_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
        "object-src 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}

LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]"})


class Refusal(NamedTuple):
    """An HTTP status and what to tell."""

    status: int
    reason: str


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach ``host``."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


class Guard:
    """The rules of one server.

    :param host: the address it listens on.
    :param port: the port.
    :param names: further names that browsers may call it by.
    :param token: what viewers must know; made up where one is needed and none is given.
    """

    def __init__(
        self, host: str, port: int, names: Iterable[str] = (), token: Optional[str] = None
    ) -> None:
        local = is_loopback(host)
        self.token = token or (None if local else secrets.token_urlsafe(18))
        known = set(LOOPBACK_NAMES) | {_bracketed(n) for n in names}
        if not local:
            known |= _own_names() if host in ("0.0.0.0", "::") else {_bracketed(host)}
        self._hosts: FrozenSet[str] = frozenset(
            {"%s:%d" % (n.lower(), port) for n in known}
            | ({n.lower() for n in known} if port == 80 else set())
        )

    def check(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        cookies: Mapping[str, str],
    ) -> Optional[Refusal]:
        """Why a request is refused; None when it is not."""
        host = headers.get("Host", "").lower()
        if host not in self._hosts:
            return Refusal(421, "this server does not go by the name '%s'" % host[:80])
        if method not in ("GET", "HEAD"):
            refusal = self._check_origin(host, headers)
            if refusal is not None:
                return refusal
        if self.token is not None and path.startswith("/api/") and path != "/api/login":
            given = cookies.get(COOKIE) or headers.get("X-Gspn-Token") or ""
            if not self.knows(given):
                return Refusal(401, "this server asks for its token")
        return None

    def _check_origin(self, host: str, headers: Mapping[str, str]) -> Optional[Refusal]:
        origin = headers.get("Origin")
        if origin is not None and origin.lower() != "http://" + host:
            return Refusal(403, "a page of another origin may not do that")
        if headers.get("Sec-Fetch-Site", "same-origin") not in ("same-origin", "none"):
            return Refusal(403, "a page of another site may not do that")
        if headers.get(HEADER) != "1":
            return Refusal(403, "the header %s is missing" % HEADER)
        return None

    def knows(self, given: str) -> bool:
        """Whether ``given`` is the token (or none is needed)."""
        return self.token is None or hmac.compare_digest(given.encode(), self.token.encode())


def _bracketed(name: str) -> str:
    return "[%s]" % name if ":" in name and not name.startswith("[") else name


def _own_names() -> FrozenSet[str]:
    """The names and addresses that this machine goes by."""
    names = {socket.gethostname(), socket.getfqdn()}
    try:
        import psutil

        for addresses in psutil.net_if_addrs().values():
            for address in addresses:
                if address.family in (socket.AF_INET, socket.AF_INET6):
                    names.add(_bracketed(address.address.split("%")[0]))
    except ImportError:
        pass
    return frozenset(names)
