"""A ROS service call that can be aborted, and a query of a service's type."""

from __future__ import annotations

import contextlib
import io
import socket
import struct
import threading
import urllib.parse
from typing import Any, Dict, NamedTuple, Optional

import genpy
import rosgraph.network
import rospy

from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.ros.transport.registration import MASTER_ERRORS, address_of

RESPONSE_LIMIT = 1_000_000_000
"""Maximum size of a response, in bytes."""


class ServiceFailed(Exception):  # noqa: N818  # a failed call, not an error of the program
    """A call failed; ``outcome`` is REJECTED, ABORTED or SERVER_DIED."""

    def __init__(self, outcome: Outcome, text: str) -> None:
        super().__init__(text)
        self.outcome = outcome


class ServiceCall:
    """One call of a service. (rospy's ``ServiceProxy`` cannot be interrupted, and waits
    indefinitely for a dead host or master.)

    :param name: absolute name of the service.
    """

    def __init__(self, name: str, service_class: Any) -> None:
        self._name, self._class = name, service_class
        self._lock = threading.Lock()
        self._closed = False
        self._socket: Optional[socket.socket] = None

    def connect(self, uri: str, timeout: float) -> None:
        """Connect to the service.

        :param uri: its address, ``rosrpc://host:port``.
        :param timeout: seconds that this may take.
        :raises OSError: there is no answer.
        :raises ServiceFailed: the service has another type.
        """
        connection = _connect(uri, timeout)
        with self._lock:
            self._socket = connection
            if self._closed:
                connection.close()
                raise OSError("the call was aborted")
        header = {"md5sum": self._class._md5sum, "type": self._class._type}
        answer = _shake_hands(connection, self._name, header)
        if "error" in answer:
            raise ServiceFailed(Outcome.REJECTED, "%s: %s" % (self._name, answer["error"]))
        connection.settimeout(None)

    def ask(self, request: genpy.Message) -> Any:
        """Send the request, and wait for the response; call :meth:`connect` first.

        :raises ServiceFailed: the service raised an error, died, or sent an invalid response.
        """
        buffer = io.BytesIO()
        request.serialize(buffer)
        data = buffer.getvalue()
        try:
            assert self._socket is not None
            self._socket.sendall(struct.pack("<I", len(data)) + data)
            ok, length = struct.unpack("<BI", self._read(5))
            if length > RESPONSE_LIMIT:
                raise ServiceFailed(
                    Outcome.ABORTED, "%s answered with %d bytes" % (self._name, length)
                )
            data = self._read(length)
        except OSError as error:
            text = "%s: %s" % (self._name, error.strerror or error)
            raise ServiceFailed(Outcome.SERVER_DIED, text) from None
        if not ok:
            raise ServiceFailed(Outcome.ABORTED, data.decode(errors="replace"))
        try:
            return self._class._response_class().deserialize(data)
        except genpy.DeserializationError as error:
            text = "%s sent an invalid response: %s" % (self._name, error)
            raise ServiceFailed(Outcome.ABORTED, text) from None

    def close(self) -> None:
        """Abandon the call, from any thread. The service does not learn of it and may continue."""
        with self._lock:
            self._closed = True
            if self._socket is not None:
                with contextlib.suppress(OSError):
                    self._socket.shutdown(socket.SHUT_RDWR)
                self._socket.close()

    def _read(self, length: int) -> bytes:
        assert self._socket is not None
        parts, missing = [], length
        while missing:
            part = self._socket.recv(min(missing, 65_536))
            if not part:
                raise OSError("the service closed the connection")
            parts.append(part)
            missing -= len(part)
        return b"".join(parts)


def service_uri(name: str, timeout: float = 2.0) -> Optional[str]:
    """The address of a service; None if the master does not know it, or does not answer."""
    try:
        return address_of(name, timeout)
    except MASTER_ERRORS:
        return None


class ServiceType(NamedTuple):
    """The type of a service, and the checksum of its definition."""

    type: str
    checksum: str


def service_type(name: str, timeout: float = 2.0) -> Optional[ServiceType]:
    """The type of a service; None if there is no answer."""
    uri = service_uri(name, timeout)
    if uri is None:
        return None
    try:
        with _connect(uri, timeout) as connection:
            answer = _shake_hands(connection, name, {"md5sum": "*", "probe": "1"})
    except OSError:
        return None
    return ServiceType(answer.get("type", ""), answer.get("md5sum", ""))


def _connect(uri: str, timeout: float) -> socket.socket:
    address = urllib.parse.urlparse(uri)
    try:
        connection = socket.create_connection((address.hostname or "", address.port or 0), timeout)
    except ValueError as error:  # not a port
        raise OSError(str(error)) from None
    # detects a vanished host within half a minute
    for option, value in (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 3)):
        if hasattr(socket, option):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def _shake_hands(connection: socket.socket, name: str, header: Dict[str, str]) -> Dict[str, str]:
    """Exchange the headers of the service protocol. :raises OSError: the other side does not answer
    properly."""
    header = {"service": name, "callerid": rospy.get_name(), **header}
    try:
        rosgraph.network.write_ros_handshake_header(connection, header)
        answer: Dict[str, str] = rosgraph.network.read_ros_handshake_header(
            connection, io.BytesIO(), 65_536
        )
    except rosgraph.network.ROSHandshakeException as error:
        raise OSError(str(error)) from None
    return answer
