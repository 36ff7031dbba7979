"""Writes files of ROS messages without ROS: rosbags (version 2.0), and MCAP files, which Foxglove
and PlotJuggler open as well. The library ``rosbags`` encodes the messages, and ``mcap`` writes MCAP
files; both are optional.
"""

from __future__ import annotations

import csv
import os
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Dict, List, Mapping, Optional, Type

from gspn_framework_package.model.errors import InputError, UsageError

PACKAGE = "gspn_framework_package"

MESSAGE_KINDS = ("RobotActivity", "Marking", "TeamState", "Prediction", "FiredTransition")
"""The types of messages that can be written, in an order such that none needs a later one."""

INSTALL = "pip install rosbags mcap"
"""The command that installs the libraries."""

_COLUMNS = (
    "time",
    "run",
    "robot",
    "place",
    "place_number",
    "state",
    "visit",
    "attempt",
    "task",
    "needs_operator",
    "waits_for",
)
"""The columns of a CSV file; ``time`` is in seconds since 1970."""


class Encoder:
    """Encodes messages as ROS 1 does, by the definitions in ``msg/``.

    :raises UsageError: the library is not installed.
    """

    def __init__(self) -> None:
        try:
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore
        except ModuleNotFoundError as error:
            raise _not_installed(error) from None
        self.store = get_typestore(Stores.ROS1_NOETIC)
        types: Dict[str, Any] = {}
        for kind in MESSAGE_KINDS:
            types.update(get_types_from_msg(definition(kind), ros_type_name(kind)))
        self.store.register(types)

    def definition(self, kind: str) -> str:
        """The definition of a type with those of the types that it contains."""
        text: str = self.store.generate_msgdef(ros_type_name(kind), ros_version=1)[0]
        return text

    def encode(self, number: int, time: float, kind: str, fields: Mapping[str, Any]) -> bytes:
        """A message as bytes, with its ``number`` on its topic and ``time`` in its header."""
        message = self._message(kind, fields, self._header(number, time))
        return bytes(self.store.serialize_ros1(message, ros_type_name(kind)))

    def _message(self, kind: str, fields: Mapping[str, Any], header: Any) -> Any:
        import numpy as np

        values = dict(fields)
        for name, value in fields.items():
            if kind == "TeamState" and name == "robots":
                values[name] = [self._message("RobotActivity", robot, header) for robot in value]
            elif name in ("counts", "feedback"):
                values[name] = np.array(value, dtype=np.int32)
            elif name == "levels":
                values[name] = np.array(value, dtype=np.float64)
        return self.store.types[ros_type_name(kind)](header=header, **values)

    def _header(self, number: int, time: float) -> Any:
        types = self.store.types
        nanoseconds = round(time * 1e9)
        stamp = types["builtin_interfaces/msg/Time"](
            sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9
        )
        return types["std_msgs/msg/Header"](seq=number, stamp=stamp, frame_id="")


class MessageFile:
    """A file of messages being written. It appears under its name when closed; if anything fails
    earlier, nothing is left behind."""

    def __init__(self, path: str) -> None:
        self._path = path
        folder, name = os.path.split(os.path.abspath(path))
        self._beside = os.path.join(folder, ".%s.%d.part" % (name, os.getpid()))

    def write(self, time: float, topic: str, kind: str, fields: Mapping[str, Any]) -> None:
        """Append a message.

        :param time: seconds since 1970, not before the last message.
        :param kind: the name of its type in this package, one of :data:`MESSAGE_KINDS`.
        :param fields: its fields without the header.
        """
        raise NotImplementedError

    def __enter__(self) -> MessageFile:
        return self

    def _opened(self, mode: str, **how: Any) -> IO[Any]:
        try:
            return open(self._beside, mode, **how)
        except OSError as error:
            raise _cannot_write(self._path, error) from None

    def _finish(self) -> None:
        """Complete the file and close it."""
        raise NotImplementedError

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        traceback: Optional[TracebackType],
    ) -> None:
        try:
            self._finish()
            if error is None:
                os.replace(self._beside, self._path)
        except OSError as problem:
            raise _cannot_write(self._path, problem) from None
        finally:
            if os.path.exists(self._beside):
                os.unlink(self._beside)


class _EncodedFile(MessageFile):
    """A file of encoded messages, which knows its topics and counts the messages on each."""

    def __init__(self, path: str, encoder: Encoder) -> None:
        super().__init__(path)
        self._encoder = encoder
        self._topics: Dict[str, Any] = {}
        self._counts: Dict[str, int] = {}

    def write(self, time: float, topic: str, kind: str, fields: Mapping[str, Any]) -> None:
        """See :class:`MessageFile`."""
        if topic not in self._topics:
            self._topics[topic] = self._declare(topic, kind)
            self._counts[topic] = 0
        number = self._counts[topic]
        self._counts[topic] += 1
        data = self._encoder.encode(number, time, kind, fields)
        self._append(self._topics[topic], number, round(time * 1e9), data)

    def _declare(self, topic: str, kind: str) -> Any:
        """Declare a topic; returns its identifier in the file."""
        raise NotImplementedError

    def _append(self, declared: Any, number: int, at: int, data: bytes) -> None:
        """Append a message; ``at`` is in nanoseconds since 1970."""
        raise NotImplementedError


class BagFile(_EncodedFile):
    """A rosbag.

    :param encoder: encodes the messages.
    :raises InputError: the file cannot be written.
    """

    def __init__(self, path: str, encoder: Encoder) -> None:
        from rosbags.rosbag1 import Writer

        super().__init__(path, encoder)
        self._writer = Writer(Path(self._beside))
        try:
            self._writer.open()
        except OSError as error:
            raise _cannot_write(path, error) from None

    def _declare(self, topic: str, kind: str) -> Any:
        return self._writer.add_connection(
            topic, ros_type_name(kind), typestore=self._encoder.store
        )

    def _append(self, declared: Any, number: int, at: int, data: bytes) -> None:
        self._writer.write(declared, at, data)

    def _finish(self) -> None:
        self._writer.close()


class McapFile(_EncodedFile):
    """An MCAP file with messages of ROS 1. The parameters are those of :class:`BagFile`.

    :raises UsageError: the library is not installed.
    """

    def __init__(self, path: str, encoder: Encoder) -> None:
        try:
            from mcap.writer import Writer
        except ModuleNotFoundError as error:
            raise _not_installed(error) from None
        super().__init__(path, encoder)
        self._file = self._opened("wb")
        self._writer = Writer(self._file)
        self._writer.start(profile="ros1", library=PACKAGE)
        self._schemas: Dict[str, int] = {}

    def _declare(self, topic: str, kind: str) -> Any:
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_schema(
                name="%s/%s" % (PACKAGE, kind),
                encoding="ros1msg",
                data=self._encoder.definition(kind).encode(),
            )
        return self._writer.register_channel(
            topic=topic, message_encoding="ros1", schema_id=self._schemas[kind]
        )

    def _append(self, declared: Any, number: int, at: int, data: bytes) -> None:
        self._writer.add_message(
            channel_id=declared, log_time=at, publish_time=at, sequence=number, data=data
        )

    def _finish(self) -> None:
        with self._file:
            self._writer.finish()


class CsvFile(MessageFile):
    """A table of what each robot did: a row for each :data:`RobotActivity <MESSAGE_KINDS>`.
    Messages of other types are left out.

    :raises InputError: the file cannot be written.
    """

    def __init__(self, path: str) -> None:
        super().__init__(path)
        self._file = self._opened("w", newline="", encoding="utf-8")
        self._rows = csv.writer(self._file)
        self._rows.writerow(_COLUMNS)

    def write(self, time: float, topic: str, kind: str, fields: Mapping[str, Any]) -> None:
        """See :class:`MessageFile`."""
        if kind == "RobotActivity":
            row: List[Any] = ["%.6f" % time]
            row += [fields["state_name" if name == "state" else name] for name in _COLUMNS[1:]]
            self._rows.writerow(int(v) if isinstance(v, bool) else v for v in row)

    def _finish(self) -> None:
        self._file.close()


def ros_type_name(kind: str) -> str:
    """The full name of a type of this package, as ``rosbags`` writes it."""
    return "%s/msg/%s" % (PACKAGE, kind)


def definition(kind: str) -> str:
    """The text of the definition of a message type of this package.

    :raises InputError: the package was installed without its definitions.
    """
    here = Path(__file__).resolve().parents[1]
    # in the wheel, in the checkout, and in the install space of catkin
    folders = (here / "msg_files", here.parent / "msg", *_shares(here))
    for folder in folders:
        file = folder / (kind + ".msg")
        if file.is_file():
            return file.read_text(encoding="utf-8")
    raise InputError(
        "the definition of the message %s is missing" % kind,
        file=str(folders[0]),
        hint="reinstall the package",
    )


def _shares(here: Path) -> List[Path]:
    """Where the definitions are for a package in PREFIX/lib/python3/dist-packages."""
    return [parent / "share" / PACKAGE / "msg" for parent in list(here.parents)[3:4]]


def _not_installed(error: ModuleNotFoundError) -> UsageError:
    return UsageError("the Python library '%s' is not installed" % error.name, hint=INSTALL)


def _cannot_write(path: str, error: OSError) -> InputError:
    return InputError("cannot be written (%s)" % (error.strerror or error), file=path)
