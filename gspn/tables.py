"""Tables of records, as text and as HTML."""

from __future__ import annotations

import html
from typing import Any, Iterator, List, Mapping, Sequence

Records = Sequence[Mapping[str, Any]]
"""Rows of a table: column -> value; all have the same columns."""

SHOWN = 40
"""The most rows that are shown; a data frame has all of them."""


def text_table(records: Records) -> Iterator[str]:
    """Yield the lines of a table."""
    rows = list(_rows(records))
    numeric = [all(_is_number(record[column]) for record in records) for column in records[0]]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        cells = [
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(row, widths, numeric)
        ]
        yield "  ".join(cells).rstrip()
    yield from _rest(records)


def html_table(records: Records) -> str:
    """Return a table as HTML."""
    head, *rows = _rows(records)
    lines = ["<table>", _html_row(head, "th"), *(_html_row(row, "td") for row in rows), "</table>"]
    return "\n".join([*lines, *("<p>%s</p>" % html.escape(line) for line in _rest(records))])


def _html_row(row: Sequence[str], tag: str) -> str:
    cells = "".join("<%s>%s</%s>" % (tag, html.escape(cell), tag) for cell in row)
    return "<tr>%s</tr>" % cells


def _rows(records: Records) -> Iterator[List[str]]:
    yield list(records[0])
    for record in records[:SHOWN]:
        yield [_text(value) for value in record.values()]


def _rest(records: Records) -> Iterator[str]:
    if len(records) > SHOWN:
        yield "... and %d more" % (len(records) - SHOWN)


def _is_number(value: Any) -> bool:
    return value is None or isinstance(value, (int, float)) and not isinstance(value, bool)


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "%.6g" % value if isinstance(value, float) else str(value)
