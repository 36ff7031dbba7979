"""Readers and writers of net files, which all convert to and from the same model. No ROS.

>>> from gspn_framework_package.formats import read_net, write_net  # doctest: +SKIP
>>> write_net(read_net("patrol.xml"), "patrol.pnpro")  # doctest: +SKIP
[]
"""

from gspn_framework_package.formats.draft import ReadOptions
from gspn_framework_package.formats.format import Format, TextReader, XmlReader
from gspn_framework_package.formats.registry import (
    FORMATS,
    encode_net,
    format_named,
    format_of_name,
    read_net,
    read_net_with_notes,
    register,
    write_net,
)

__all__ = [
    "FORMATS",
    "Format",
    "ReadOptions",
    "TextReader",
    "XmlReader",
    "encode_net",
    "format_named",
    "format_of_name",
    "read_net",
    "read_net_with_notes",
    "register",
    "write_net",
]
