"""Readers and writers of net files, which all convert to and from the same model. Nothing here
imports ROS.

>>> from gspn_framework_package.formats import read_net, write_net  # doctest: +SKIP
>>> write_net(read_net("patrol.xml"), "patrol.pnpro")  # doctest: +SKIP
[]

Modules: ``colour_terms``, ``coloured``, ``difference``, ``dot``, ``draft``, ``edited_document``,
``example_plans``, ``foreign``, ``format``, ``foxglove``, ``jani``, ``json_file``, ``json_update``,
``markov_chain``, ``message_files``, ``net_equality``, ``net_json``, ``net_update``, ``pipe``,
``pipe_update``, ``plan_file``, ``plan_json``, ``plan_parts``, ``pnml``, ``pnml_family``,
``pnml_update``, ``pnpro``, ``pnpro_update``, ``prism``, ``python_root``, ``registry``,
``repetition``, ``routes``, ``schema_words``, ``smach_machine``, ``source``, ``subnets``,
``symbolic``, ``thesis_input``, ``tina``, ``tool_data``, ``tree_ticks``, ``vocabulary``,
``xml_tree``, ``xml_update``, ``yaml_file``.
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
