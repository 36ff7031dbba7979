"""Access control of the web server. A browser on a robot network also visits other pages.

- Every request: the Host header must be one that the server was started with (under DNS rebinding
  it would differ), and a request to ``/api/`` must not come from another site, according to
  Sec-Fetch-Site.
- Every POST must come from this page, according to Origin too, and carry a header that a form of
  another page cannot send.
- Beyond loopback, a request needs a token. There are two: the operator's, and the viewer's, which
  is read-only.
- Every answer has a content security policy that allows nothing from other servers.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import os
import secrets
import socket
import stat
import threading
import time
from collections import OrderedDict, deque
from typing import Callable, Deque, FrozenSet, Iterable, Mapping, NamedTuple, Optional, Tuple

from gspn_framework_package.formats.source import open_file
from gspn_framework_package.model.errors import InputError, UsageError

HEADER = "X-Gspn-Page"
"""A header that every POST of the page carries."""

TOKEN_HEADER = "X-Gspn-Token"
"""The header in which a program without cookies sends its token."""

OPERATOR, VIEWER = "operator", "viewer"

SHORTEST_TOKEN = 16
"""Shortest token, in characters."""

GUESSES = 10
"""Number of wrong tokens that a peer may send within :data:`GUESS_TIME`; further tokens are not
compared at all."""

GUESS_TIME = 60.0
"""Seconds for which a wrong token counts."""

PEERS = 1000
"""Number of peers whose wrong guesses are remembered; if there are more, the latest are kept."""

LOGINS = 1000
"""Number of valid cookies that are remembered, so that they are not treated as guesses."""

SECURITY_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; img-src 'self' blob:; "  # the page draws a PNG from its own SVG
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
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
    """An HTTP status and a message."""

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


def check_tokens(token: Optional[str], viewer_token: Optional[str]) -> None:
    """Check the given tokens. :raises UsageError: one is too short, or both are the same."""
    for given in (token, viewer_token):
        if given is not None and (
            len(given) < SHORTEST_TOKEN or not given.isascii() or not given.isprintable()
        ):
            raise UsageError(
                "a token needs at least %d characters, all of them ASCII" % SHORTEST_TOKEN,
                hint="leave it out to have one generated",
            )
    if token is not None and token == viewer_token:
        raise UsageError("the operator's token and the viewer's are the same")


class Admission(NamedTuple):
    """The decision on a request: its ``role``, or a refusal."""

    role: str
    refusal: Optional[Refusal] = None


class Guard:
    """The rules of one server.

    :param host: the address it listens on.
    :param names: further host names that browsers may use for it.
    :param token: the operator's token; generated if one is needed and none is given.
    :param viewer_token: the read-only token of viewers; generated beyond loopback.
    :param time_source: returns monotonic seconds.
    :raises UsageError: a token is too short, or both are the same.
    """

    def __init__(
        self,
        host: str,
        port: int,
        names: Iterable[str] = (),
        token: Optional[str] = None,
        viewer_token: Optional[str] = None,
        time_source: Callable[[], float] = time.monotonic,
    ) -> None:
        check_tokens(token, viewer_token)
        local = is_loopback(host)
        needed = not local or viewer_token is not None
        self.token = token or (secrets.token_urlsafe(18) if needed else None)
        self.viewer_token = viewer_token or (None if local else secrets.token_urlsafe(18))
        # all ports of a host share cookies, and several servers may run on one machine
        self.cookie = "gspn_token_%d" % port
        self._guesses, self._cookie_guesses = _Guesses(time_source), _Guesses(time_source)
        self._logins: OrderedDict[str, str] = OrderedDict()
        self._lock = threading.Lock()
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
        peer: str = "",
    ) -> Admission:
        """Decide on a request.

        :param peer: the address it comes from.
        """
        host = headers.get("Host", "").lower()
        if host not in self._hosts:
            return _refused(421, "this server does not have the name '%s'" % host[:80])
        if path.startswith("/api/") and headers.get("Sec-Fetch-Site", "same-origin") not in (
            "same-origin",
            "none",
        ):
            return _refused(403, "a page of another site may not do that")
        if method not in ("GET", "HEAD"):
            refusal = self._check_origin(host, headers)
            if refusal is not None:
                return Admission("", refusal)
        if self.token is None:
            return Admission(OPERATOR)
        if not path.startswith("/api/") or path == "/api/login":
            return Admission("")
        role = self._role_of_cookie(cookies.get(self.cookie, ""), peer) or ""
        given = headers.get(TOKEN_HEADER, "")
        if not role and given:
            if self._guesses.too_many(peer):
                return _refused(429, TOO_MANY)
            role = self.role_of(given, peer) or ""
        if not role:
            return _refused(401, "this server needs a token")
        if role == VIEWER and method not in ("GET", "HEAD"):
            return _refused(403, "the viewer's token is read-only")
        return Admission(role)

    def login(self, given: str, peer: str = "") -> str:
        """Make a cookie for a peer that sends a valid token.

        :returns: the cookie's value, "" if no token is needed.
        :raises LoginError: the token is wrong, or the peer has guessed too often.
        """
        if self.token is None:
            return ""
        if self._guesses.too_many(peer):
            raise LoginError(429, TOO_MANY)
        role = self.role_of(given, peer)
        if role is None:
            raise LoginError(401, "wrong token")
        nonce = secrets.token_hex(12)
        cookie = nonce + self._seal(nonce, role)
        self._remember(cookie, role)
        return cookie

    def role_of(self, given: str, peer: str = "") -> Optional[str]:
        """The role of a token; None if it is wrong, which counts as a guess of ``peer``."""
        encoded = given.encode("utf-8", "surrogatepass")
        found = None
        for role, token in ((OPERATOR, self.token), (VIEWER, self.viewer_token)):
            if token is not None and hmac.compare_digest(encoded, token.encode()):
                found = role
        if found is None:
            self._guesses.wrong(peer)
        return found

    def _role_of_cookie(self, cookie: str, peer: str) -> Optional[str]:
        """The role of a cookie, None if it is wrong.

        A cookie is a nonce with a seal that can only be made with the token. It stays valid if the
        server is restarted with the same token. A cookie that was valid before is recognised no
        matter how often its peer guesses. Wrong cookies are counted separately from wrong tokens: a
        page with a cookie from an earlier server process does not lock its peer out of the
        login."""
        with self._lock:
            if not cookie or cookie in self._logins:
                return self._logins.get(cookie)
        if len(cookie) != 24 + 64 or not cookie.isascii() or self._cookie_guesses.too_many(peer):
            return None
        nonce, seal = cookie[:24], cookie[24:]
        for role in (OPERATOR, VIEWER):
            if hmac.compare_digest(seal, self._seal(nonce, role)):
                self._remember(cookie, role)
                return role
        self._cookie_guesses.wrong(peer)
        return None

    def _remember(self, cookie: str, role: str) -> None:
        with self._lock:
            self._logins[cookie] = role
            while len(self._logins) > LOGINS:
                self._logins.popitem(last=False)

    def _seal(self, nonce: str, role: str) -> str:
        token = self.token if role == OPERATOR else self.viewer_token
        key = (token or secrets.token_hex(16)).encode()
        return hmac.new(
            key, ("gspn page %s %s" % (nonce, role)).encode(), hashlib.sha256
        ).hexdigest()

    def _check_origin(self, host: str, headers: Mapping[str, str]) -> Optional[Refusal]:
        origin = headers.get("Origin")
        if origin is not None and origin.lower() != "http://" + host:
            return Refusal(403, "a page of another origin may not do that")
        if headers.get(HEADER) != "1":
            return Refusal(403, "the header %s is missing" % HEADER)
        return None


TOO_MANY = "too many wrong tokens from your address; wait a minute"


class LoginError(Exception):
    """The login is refused, with an HTTP ``status`` and a message."""

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


class _Guesses:
    """The recent wrong tokens, by peer."""

    def __init__(self, time_source: Callable[[], float]) -> None:
        self._clock = time_source
        self._lock = threading.Lock()
        self._wrong: OrderedDict[str, Deque[float]] = OrderedDict()

    def wrong(self, peer: str) -> None:
        """Count a wrong token of a peer."""
        with self._lock:
            times = self._wrong.setdefault(_network(peer), deque(maxlen=GUESSES))
            times.append(self._clock())
            self._wrong.move_to_end(_network(peer))
            while len(self._wrong) > PEERS:
                self._wrong.popitem(last=False)

    def too_many(self, peer: str) -> bool:
        """Whether to ignore the next token of the peer."""
        with self._lock:
            times = self._wrong.get(_network(peer))
            return (
                times is not None
                and len(times) >= GUESSES
                and times[0] > self._clock() - GUESS_TIME
            )


def _network(peer: str) -> str:
    """The owner of an address: with IPv6, a peer is assigned a whole network."""
    try:
        address = ipaddress.ip_address(peer.split("%")[0])
    except ValueError:
        return peer
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped is None:
        return str(ipaddress.ip_network((int(address), 64), strict=False))
    return str(address)


def read_tokens(path: str) -> Tuple[Optional[str], Optional[str]]:
    """Read the operator's and the viewers' token from the first two lines of a file; None for a
    missing line.

    :raises InputError: it cannot be read, contains no token, or other users may read it.
    """
    try:
        with open_file(path) as file:
            mode = os.fstat(file.fileno()).st_mode
            lines = [line.strip() for line in file.read(10_000).decode().splitlines()[:2]]
    except OSError as error:
        raise InputError("cannot be read (%s)" % error.strerror, file=path) from None
    except UnicodeDecodeError:
        raise InputError("holds no token", file=path) from None
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise InputError(
            "other users may read it, but it contains tokens", file=path, hint="chmod 600"
        )
    token, viewer_token = [line or None for line in (lines + ["", ""])[:2]]
    if token is None:
        raise InputError("holds no token", file=path, hint="its first line is the operator's token")
    return token, viewer_token


def _refused(status: int, reason: str) -> Admission:
    return Admission("", Refusal(status, reason))


def _bracketed(name: str) -> str:
    return "[%s]" % name if ":" in name and not name.startswith("[") else name


def _own_names() -> FrozenSet[str]:
    """The names and addresses of this machine."""
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
