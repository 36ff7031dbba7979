"""The record of a net file format.

To add a format, write a module that reads and writes it, and add its record to the table in
:mod:`~gspn_framework_package.formats.registry`; from outside the package, call
:func:`~gspn_framework_package.formats.registry.register`."""

from __future__ import annotations

import codecs
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Callable, List, Mapping, Optional, Tuple, Union

from gspn_framework_package.formats.draft import ReadOptions
from gspn_framework_package.formats.xml_tree import line_of, parse_xml, tag
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.model.expression import shorten
from gspn_framework_package.model.net import Net

if TYPE_CHECKING:
    from lxml import etree

Bounds = Mapping[str, int]
"""Place -> the maximum number of tokens it can hold, where that is known."""

Updater = Callable[[bytes, ReadOptions, Net, Net], bytes]
"""Returns the content of a file with its net changed. Takes (content, how it is read, the present
net, the new net)."""

NetAndNotes = Tuple[Net, List[str]]
"""The result of a reader: the net, and notes on what it had to assume or left out."""


class CannotHoldError(Exception):
    """The format cannot hold the net, or changing a file written like this is not supported."""


class NetFile:
    """The content of a file, which is parsed or decoded when a reader first needs it.

    :ivar data: the bytes of the file.
    :ivar path: its name, for messages.
    :param hint: the hint for a file that is neither XML nor text.
    """

    def __init__(self, data: bytes, path: str, hint: str = "") -> None:
        self.data = data
        self.path = path
        self._hint = hint

    @cached_property
    def root(self) -> etree._Element:
        """The root element of an XML file.

        :raises InputError: the content is not well-formed XML.
        """
        return parse_xml(self.data, self.path)

    @cached_property
    def text(self) -> str:
        """The content as text. :raises InputError: the content is not UTF-8."""
        try:
            text = self.data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = "\0"
        if "\0" in text:
            raise InputError(
                "neither XML nor text: not a net in any format that is known",
                file=self.path,
                hint=self._hint or None,
            )
        return text

    @cached_property
    def is_xml(self) -> bool:
        """Whether the content looks like XML."""
        return is_xml(self.data)


def is_xml(data: bytes) -> bool:
    """Whether this content looks like XML."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return True
    if data.startswith(codecs.BOM_UTF8):
        data = data[len(codecs.BOM_UTF8) :]
    return data.lstrip()[:1] == b"<"


@dataclass(frozen=True)
class XmlReader:
    """How to recognise and read an XML format.

    :ivar read: reads the net under a root element: (root, path of the file, options).
    :ivar roots: the possible root elements of the format.
    :ivar recognises: whether a document with one of these roots is in this format; needed if
        formats share a root element.
    """

    read: Callable[[etree._Element, Optional[str], ReadOptions], NetAndNotes]
    roots: Tuple[str, ...]
    recognises: Callable[[etree._Element], bool] = lambda root: True

    def takes(self, file: NetFile) -> bool:
        """Whether a file is in this format."""
        return file.is_xml and tag(file.root) in self.roots and self.recognises(file.root)

    def read_file(self, file: NetFile, title: str, options: ReadOptions) -> NetAndNotes:
        """Read a file as this format. :raises InputError: it is in another one, or damaged."""
        if tag(file.root) not in self.roots:
            raise InputError(
                "the root element is <%s>, not <%s> as in %s"
                % (shorten(tag(file.root)), self.roots[0], title),
                file=file.path,
                line=line_of(file.root),
            )
        return self.read(file.root, file.path, options)


@dataclass(frozen=True)
class TextReader:
    """How to recognise and read a text format.

    :ivar read: reads the net in a text: (text, path of the file, options).
    :ivar recognises: whether a text is in this format, judged by its beginning.
    """

    read: Callable[[str, Optional[str], ReadOptions], NetAndNotes]
    recognises: Callable[[str], bool]

    def takes(self, file: NetFile) -> bool:
        """Whether a file is in this format."""
        return not file.is_xml and self.recognises(file.text)

    def read_file(self, file: NetFile, title: str, options: ReadOptions) -> NetAndNotes:
        """Read a file as this format. :raises InputError: it is in another one, or damaged."""
        return self.read(file.text, file.path, options)


@dataclass(frozen=True)
class Format:
    """A file format.

    :ivar name: its name in ``--to`` and ``--from``.
    :ivar title: its name in sentences.
    :ivar extensions: the extensions of its files; the first is the usual one.
    :ivar to_bytes: the writer. It takes a net, and also :data:`Bounds` if ``takes_bounds``.
    :ivar reader: how to recognise and read it; None if it can only be written.
    :ivar losses: returns what the writer leaves out of a net or rewrites, in sentences.
    :ivar takes_bounds: whether the writer needs upper bounds on the tokens of places.
    :ivar update: changes the net in a file and leaves everything else unchanged; it raises
        :class:`CannotHoldError` if it cannot. None if changing files of the format is not
        supported.
    """

    name: str
    title: str
    extensions: Tuple[str, ...]
    to_bytes: Callable[..., bytes]
    reader: Optional[Union[XmlReader, TextReader]] = None
    losses: Callable[[Net], List[str]] = lambda net: []
    takes_bounds: bool = False
    update: Optional[Updater] = None
