"""The colour of each robot, the same on the page, in the world's window and in its films."""

from __future__ import annotations

import re

PALETTE = (
    "#2563b8",
    "#c2410c",
    "#15803d",
    "#9333ab",
    "#b91c4b",
    "#0e7490",
    "#8a6100",
    "#4f46c4",
    "#5b7a1f",
    "#a8327d",
    "#3f6475",
    "#8c4a2f",
)
"""Colours as ``#rrggbb``, dark enough for white text on them."""

_NUMBER = re.compile(r"([0-9]{1,6})$")


def colour_of(name: str) -> str:
    """Return the colour of a robot, ``#rrggbb``. It depends on the number at the end of its name,
    so that neighbours differ, or on the whole name if there is no number. ``static/js/colours.js``
    of the page has the same rule; a test checks that the two agree."""
    digits = _NUMBER.search(name)
    if digits:
        return PALETTE[(int(digits.group(1)) - 1) % len(PALETTE)]
    value = 7
    for character in name:
        value = (value * 31 + ord(character)) & 0xFFFFFFFF
    return PALETTE[value % len(PALETTE)]
