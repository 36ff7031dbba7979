"""The web server around the application: waitress, in a thread of its own or in the caller's."""

from __future__ import annotations

import logging
import threading
from typing import Any, Optional, Sequence

import waitress

from gspn_framework_package.model.errors import InputError
from gspn_framework_package.visualizer.app import UPLOAD_BYTES, create_app
from gspn_framework_package.visualizer.guard import Guard, is_loopback
from gspn_framework_package.visualizer.project import Project

DEFAULT_PORT = 8090
THREADS_BESIDE_VIEWERS = 8

OUTPUT_BYTES = 1_000_000
"""What is buffered at most for a viewer that does not read, before its thread is held."""


class WebServer:
    """A page at an address.

    :param project: what it shows; closed with the server.
    :param host: the address to listen on; other than loopback only on the operator's word.
    :param port: 0 for any free one.
    :param names: further names that browsers may call this machine by.
    :param token: see :class:`~gspn_framework_package.visualizer.guard.Guard`.
    :param viewers: how many streams are served at once.
    :raises InputError: the address cannot be listened on.
    """

    def __init__(
        self,
        project: Project,
        host: str = "127.0.0.1",
        port: int = DEFAULT_PORT,
        names: Sequence[str] = (),
        token: Optional[str] = None,
        viewers: int = 24,
    ) -> None:
        logging.getLogger("waitress.queue").setLevel(logging.ERROR)
        self.project = project
        self._app: Any = None
        self._stopped = False
        try:
            self._server = waitress.create_server(
                self._call,
                host=host,
                port=port,
                threads=viewers + THREADS_BESIDE_VIEWERS,
                outbuf_high_watermark=OUTPUT_BYTES,
                max_request_body_size=UPLOAD_BYTES + 1,  # before it is kept on the disk
                connection_limit=200,
                channel_timeout=60,
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
        self.guard = Guard(host, self.port, names, token)
        self._app = create_app(project, self.guard, viewers)
        self._thread: Optional[threading.Thread] = None

    def _call(self, environ: Any, start_response: Any) -> Any:
        return self._app(environ, start_response)

    @property
    def address(self) -> str:
        """Where the page is, with the token it asks for."""
        if is_loopback(self.host):
            name = "[%s]" % self.host if ":" in self.host else self.host
        else:
            import socket

            name = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host
        token = "#token=%s" % self.guard.token if self.guard.token else ""
        return "http://%s:%d/%s" % (name, self.port, token)

    def run(self) -> None:
        """Serve until interrupted, in this thread."""
        try:
            self._server.run()
        except OSError:
            if not self._stopped:  # its sockets were closed under it, on another thread
                raise

    def start(self) -> None:
        """Serve in a thread."""
        self._thread = threading.Thread(target=self.run, name="web", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop serving, and end what the project runs."""
        streams = self._app.extensions["gspn_streams"]
        streams.close()
        self._app.extensions["gspn_jobs"].close()
        self.project.close()  # which wakes the streams
        streams.wait(1.0)
        self._stopped = True
        self._server.close()
