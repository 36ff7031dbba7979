"""Distinguishes PIPE, ISO PNML and TAPAAL, which share the root element ``<pnml>`` and most others.

PIPE has its numbers in ``value`` elements. ISO PNML has them in ``text`` elements, and its nets
have pages. TAPAAL has them in attributes of places."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Optional

from gspn_framework_package.formats.xml_tree import tag

if TYPE_CHECKING:
    from lxml import etree

STOCHASTIC = "StochasticPetriNet"
OWN = "gspn_framework_package"
"""Tools whose data in PNML files is read and written."""

PIPE, PNML, TAPAAL = "pipe", "pnml", "tapaal"

_NUMBERS = ("name", "initialMarking", "inscription", "rate", "timed")


class Member(NamedTuple):
    """The format of a document, and the element that identifies it, if there is one."""

    kind: str
    shown_by: Optional[etree._Element] = None


def member(root: etree._Element) -> Member:
    """Return the format of a document with the root ``<pnml>``, judged by the first element that
    identifies it, or by the namespace if the document is empty."""
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
