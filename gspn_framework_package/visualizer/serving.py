"""The web server that runs the application: waitress, in a thread or in the caller's."""

from __future__ import annotations

import logging
import socket
import threading
from typing import Any, Callable, Dict, Iterable, Optional, Sequence

from flask import Flask

from gspn_framework_package.model.errors import InputError
from gspn_framework_package.visualizer.app import body_limit, create_app, too_large_text
from gspn_framework_package.visualizer.connections import (
    MOST_WAITING_CONNECTIONS,
    RequestRules,
    Server,
)
from gspn_framework_package.visualizer.guard import (
    OPERATOR,
    VIEWER,
    Guard,
    check_tokens,
    is_loopback,
)
from gspn_framework_package.visualizer.project import Project

DEFAULT_PORT = 8090
THREADS_BESIDE_VIEWERS = 8

OUTPUT_BYTES = 1_000_000
"""Bytes buffered for a viewer that does not read, before its thread blocks."""

LAST_REQUESTS = 2.0
"""Seconds that pending requests have to finish when the server stops."""


class WebServer:
    """A page at an address.

    :param project: the content; closed with the server.
    :param host: the address to listen on; should be loopback unless the operator asks for another.
    :param port: the port; 0 for any free one.
    :param names: further host names that browsers may use for this machine.
    :param token: see :class:`~gspn_framework_package.visualizer.guard.Guard`.
    :param viewer_token: the token of read-only viewers.
    :param viewers: how many streams are served at once.
    :raises InputError: the server cannot listen on the address.
    :raises UsageError: a token is too short, or both are the same.
    """

    def __init__(
        self,
        project: Project,
        host: str = "127.0.0.1",
        port: int = DEFAULT_PORT,
        names: Sequence[str] = (),
        token: Optional[str] = None,
        viewers: int = 24,
        viewer_token: Optional[str] = None,
    ) -> None:
        check_tokens(token, viewer_token)
        logging.getLogger("waitress.queue").setLevel(logging.ERROR)
        self.project = project
        self._begun = threading.Event()
        self._stopped = False
        try:
            self._server = Server(
                self._call,
                viewers + MOST_WAITING_CONNECTIONS,
                host=_one_address(host),
                port=port,
                threads=viewers + THREADS_BESIDE_VIEWERS,
                outbuf_high_watermark=OUTPUT_BYTES,
                ident="gspn",
                clear_untrusted_proxy_headers=True,
            )
        except (OSError, ValueError) as error:
            raise InputError(
                "cannot listen on %s port %d: %s" % (host, port, getattr(error, "strerror", error)),
                hint="choose another with --port",
            ) from None
        self.host = host
        self.port = int(self._server.effective_port)
        self.guard = Guard(host, self.port, names, token, viewer_token)
        self._server.rules = RequestRules(self.guard, body_limit, too_large_text)
        self._app: Flask = create_app(project, self.guard, viewers)
        self._thread: Optional[threading.Thread] = None
        self.ended = threading.Event()

    def _call(self, environ: Dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        return self._app(environ, start_response)

    @property
    def address(self) -> str:
        """The address of the page."""
        if is_loopback(self.host):
            name = "[%s]" % self.host if ":" in self.host else self.host
        else:
            name = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host
        return "http://%s:%d/" % (name, self.port)

    @property
    def invitations(self) -> Dict[str, str]:
        """The address for each role, including its token: only for the operator's terminal, never
        for anything that others can read."""
        tokens = {OPERATOR: self.guard.token, VIEWER: self.guard.viewer_token}
        if self.guard.token is None:
            return {OPERATOR: self.address}
        return {
            role: "%s#token=%s" % (self.address, token)
            for role, token in tokens.items()
            if token is not None
        }

    def start(self) -> None:
        """Serve in a thread."""
        self._thread = threading.Thread(target=self._serve, name="web", daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        self._begun.set()
        try:
            self._server.run()
        finally:
            self.ended.set()

    def stop(self) -> None:
        """Stop serving, and close the project."""
        if self._stopped:
            return
        self._stopped = True
        if self._thread is not None and not self._begun.wait(LAST_REQUESTS):
            self._thread = None  # an interrupt came before it began
        streams = self._app.extensions["gspn_streams"]
        streams.close()
        self._app.extensions["gspn_jobs"].close()
        if "gspn_checks" in self._app.extensions:
            self._app.extensions["gspn_checks"].close()
        self.project.close()  # this wakes the streams
        streams.wait(1.0)
        # Waitress expects to stop only with its process. A thread that finishes late writes to the
        # pipe that wakes the server's thread, by file descriptor; if the pipe were already closed,
        # the byte would go to whatever file now has that number. Therefore: accept no more
        # requests, end all threads, then close the pipe.
        self._do(self._hang_up)
        self._server.task_dispatcher.shutdown(cancel_pending=False, timeout=LAST_REQUESTS)
        if not self._server.task_dispatcher.threads:
            self._do(self._watch_nothing)
            if self._thread is not None:
                self._thread.join(LAST_REQUESTS)
            if self._thread is None or not self._thread.is_alive():
                self._server.close()

    def _do(self, action: Callable[[], None]) -> None:
        """Run ``action``, which works on the sockets, on the thread that watches them, since no
        other thread may close them. It may run before or after this method returns."""
        if self._thread is None:
            action()
        else:
            self._server.trigger.pull_trigger(action)

    def _hang_up(self) -> None:
        self._server.accepting = False
        for channel in list(self._server.active_channels.values()):
            channel.handle_close()

    def _watch_nothing(self) -> None:
        """Stop watching all sockets, which ends the thread."""
        self._hang_up()  # peers that connected meanwhile
        self._server.del_channel()
        self._server.trigger.del_channel()


def _one_address(host: str) -> str:
    """The first address of a name, IPv4 before IPv6: ``localhost`` has both, but a server listens
    at one address.

    :raises OSError: the name cannot be resolved.
    """
    found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    return str(min(found)[4][0])
