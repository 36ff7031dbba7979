"""Converts positions in files of GreatSPN, which uses its own units and reference corners."""

from __future__ import annotations

from typing import Optional

from lxml import etree

from gspn_framework_package.formats.xml_tree import number_text
from gspn_framework_package.model.net import Point

UNIT = 16.0
"""Drawing units per unit of the editor; a power of two, so that nothing is rounded."""

_CORNER = {"place": 0.0, "EXP": 0.55, "IMM": 0.85}


def from_editor(where: Optional[Point], kind: str) -> Optional[Point]:
    """Convert the position of a node (place, EXP or IMM) to the model's."""
    if where is None:
        return None
    return round((where[0] - _CORNER[kind]) * UNIT, 6), where[1] * UNIT


def write_position(node: etree._Element, where: Optional[Point], kind: str) -> None:
    """Write the position of a node: place, EXP or IMM."""
    if where is not None:
        node.set("x", number_text(round(where[0] / UNIT + _CORNER[kind], 9)))
        node.set("y", number_text(where[1] / UNIT))
