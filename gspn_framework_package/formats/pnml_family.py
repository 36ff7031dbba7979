"""PIPE, ISO PNML and TAPAAL share the root element ``<pnml>`` and most others: which one it is.

PIPE has its numbers in ``value`` elements, ISO PNML in ``text`` elements and nets in pages, TAPAAL
in attributes of places."""

from __future__ import annotations

from typing import NamedTuple, Optional

from lxml import etree

from gspn_framework_package.formats.xml_tree import tag

PIPE, PNML, TAPAAL = "pipe", "pnml", "tapaal"

_NUMBERS = ("name", "initialMarking", "inscription", "rate", "timed")


class Member(NamedTuple):
    """Which format a document is in, and the element that shows it, if one does."""

    kind: str
    shown_by: Optional[etree._Element] = None


def member(root: etree._Element) -> Member:
    """The format of a document with the root ``<pnml>``, by the first element that shows it; an
    empty one by its namespace."""
    for element in root.iter():
        kind = tag(element)
        parent = element.getparent()
        if kind in ("value", "text") and parent is not None and tag(parent) in _NUMBERS:
            return Member(PIPE if kind == "value" else PNML, element)
        if kind == "page":
            return Member(PNML, element)
        if kind == "place" and element.get("initialMarking") is not None:
            return Member(TAPAAL, element)
    is_iso = (root.nsmap.get(None) or "").startswith("http://www.pnml.org")
    return Member(PNML if is_iso else PIPE)
