"""Changes a net in its own file, without losing content that this package does not read.

The record of each format (``update``) defines how. The result is read back and compared, so that a
file is replaced only by a correct one.
"""

from __future__ import annotations

from typing import Optional

from gspn_framework_package.formats.draft import ReadOptions
from gspn_framework_package.formats.format import CannotHoldError, Format, NetFile
from gspn_framework_package.formats.net_equality import same_net
from gspn_framework_package.formats.registry import FORMATS, format_named
from gspn_framework_package.model.errors import GspnError, NetError
from gspn_framework_package.model.net import Net


def update_net(data: bytes, path: str, options: ReadOptions, new: Net) -> Optional[bytes]:
    """Return the content of a net file that holds ``new``.

    :param data: the content of the file.
    :param path: its name, for messages.
    :param options: how the file is read.
    :returns: ``data`` itself if it already contains an equivalent net; None if the format cannot
        hold the net.
    :raises GspnError: the file cannot be read.
    """
    file = NetFile(data, path)
    format = _format_of(file, options)
    old = _read(format, file, options)
    if same_net(old, new):
        return data
    if format.update is None:
        return None
    try:
        changed = format.update(data, options, old, new)
        if same_net(_read(format, NetFile(changed, path), options), new):
            return changed
    except (GspnError, CannotHoldError, ValueError):
        pass
    return None


def _format_of(file: NetFile, options: ReadOptions) -> Format:
    if options.format is not None:
        return format_named(options.format)
    for format in FORMATS.values():
        if format.reader is not None and format.reader.takes(file):
            return format
    raise NetError("not a net in any format that is known", file=file.path)


def _read(format: Format, file: NetFile, options: ReadOptions) -> Net:
    assert format.reader is not None
    return format.reader.read_file(file, format.title, options)[0]
