"""Tables of text in aligned columns."""

from __future__ import annotations

from typing import List, Sequence


def aligned(rows: Sequence[Sequence[str]]) -> List[str]:
    """Format rows as aligned lines.

    :param rows: at least one, all of the same length; the first may contain the headings.
    """
    widths = [max(map(len, column)) for column in zip(*rows)]
    return ["  ".join(cell.ljust(w) for cell, w in zip(row, widths)).rstrip() for row in rows]
