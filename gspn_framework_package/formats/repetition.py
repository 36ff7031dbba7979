"""Large XML files, in which most elements have the same content, reduced to a small sample.

A PNML file of 100,000 nodes has some 750,000 elements, but only a few different contents: most
places have no token, most transitions the same timing. So a large file is taken apart by regular
expressions into columns (ids, names, positions, ends of arcs) and contents. One element for each
different content is put into a *sample*: a document with the same beginning and end, which the
format's reader reads as any other. The meaning of a content is that of its element in the sample.

This applies only to files of a plain form: all places, then all transitions, then all arcs, on one
page, without comments, CDATA sections and processing instructions. :func:`sample_of` returns None
for all others, and a reader must give up on any error in the sample, so that the usual reader
reports it with the right line.

If the sample is well-formed, so is the file. Each element is its columns and its content, between
the same two tags as in the sample. A content cannot reach beyond them: there are no comments and
the like, so that each ``<`` begins a tag, and no content has the end tag of its element.
"""

from __future__ import annotations

import re
from itertools import chain
from typing import Any, Iterator, List, NamedTuple, Optional, Sequence, Tuple

_MOST = 40
"""Number of tags in a content at most."""

_SPACE = " \t\r\n"
_S = "[%s]*" % _SPACE
_VALUE = '[^"<&]{0,1000}'
_NAME = "(?:{s}<name>{s}<text>([^<&]{{0,1000}})</text>{s}</name>)?".format(s=_S)
_POSITION = (
    '(?:{s}<graphics>{s}<position x="({value})" y="({value})"{s}/>{s}</graphics>)?'
).format(s=_S, value=_VALUE)


def _content(kind: str) -> str:
    """The pattern of a content. It never passes the begin tag of another element of its kind, so
    that the time for a file without end tags is linear too."""
    return r"((?:[^<]*<(?!/?%s[\s>])[^<>]*>){0,%d}[^<]*)</%s>" % (kind, _MOST, kind)


def _node(kind: str) -> str:
    return '<%s id="(%s)">%s%s%s' % (kind, _VALUE, _NAME, _POSITION, _content(kind))


_PLACE, _TRANSITION = re.compile(_node("place")), re.compile(_node("transition"))
_ARC = re.compile(
    r'<arc id="(%s)" source="(%s)" target="(%s)"%s(?:/>|>%s)'
    % (_VALUE, _VALUE, _VALUE, _S, _content("arc"))
)
_DECLARATION = re.compile(
    r"""<\?xml\s+version=["']1\.0["'](\s+encoding=["']utf-8["'])?\s*\?>""", re.IGNORECASE
)


class Nodes(NamedTuple):
    """The columns of places or transitions.

    :ivar ids: their attributes ``id``.
    :ivar names: their texts in ``name``; None: they are in the content, if anywhere.
    :ivar x: their attributes ``x`` in ``graphics/position``; None as for names.
    :ivar y: likewise.
    :ivar sampled: the id that an element with the same content has in the sample.
    """

    ids: List[str]
    names: List[Optional[str]]
    x: List[Optional[str]]
    y: List[Optional[str]]
    sampled: List[str]


class Arcs(NamedTuple):
    """The columns of arcs; see :class:`Nodes`."""

    ids: List[str]
    sources: List[str]
    targets: List[str]
    sampled: List[str]


class FileSample(NamedTuple):
    """A file as columns, and the sample with which to read it.

    :ivar document: the sample.
    :ivar transitions: its transitions.
    """

    document: bytes
    places: Nodes
    transitions: Nodes
    arcs: Arcs


def sample_of(data: bytes) -> Optional[FileSample]:
    """Take a file apart; None if it is not of the plain form, or would not become much smaller."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        return None
    declaration = _DECLARATION.match(text)
    if (
        "<!" in text
        or "]]>" in text
        or text.find("<?", declaration.end() if declaration else 0) >= 0
    ):
        return None
    begins = [text.find("<%s " % kind) for kind in ("place", "transition", "arc")]
    if not 0 < begins[0] < begins[1] < begins[2]:
        return None
    head = text[: begins[0]]
    sections = (text[i:j] for i, j in zip(begins, [*begins[1:], len(text)]))
    patterns = (_PLACE, _TRANSITION, _ARC)
    columns = [pattern.split(section) for pattern, section in zip(patterns, sections)]
    tail = columns[2].pop()
    for parts, pattern in zip(columns, patterns):
        if "".join(parts[:: pattern.groups + 1]).strip(_SPACE):  # between the elements
            return None
    nodes = [_Contents(parts[5::6], letter) for parts, letter in zip(columns, "pt")]
    arcs = _Contents([content or "" for content in columns[2][4::5]], "a")
    document = "".join(
        (
            head,
            *('<place id="%s">%s</place>' % item for item in nodes[0]),
            *('<transition id="%s">%s</transition>' % item for item in nodes[1]),
            *('<arc id="%s" source="p0" target="t0">%s</arc>' % item for item in arcs),
            tail,
        )
    )
    if len(document) > len(text) // 2 or any("<name" in content for _, content in chain(*nodes)):
        return None
    sample = FileSample(
        document.encode("utf-8"),
        _node_columns(columns[0], nodes[0].sampled),
        _node_columns(columns[1], nodes[1].sampled),
        Arcs(columns[2][1::5], columns[2][2::5], columns[2][3::5], arcs.sampled),
    )
    values = (*sample.places[:4], *sample.transitions[:4], *sample.arcs[:3])
    if not all("".join(filter(None, column)).isprintable() for column in values):
        return None  # there may be characters that XML does not allow, or that end a line
    return sample


def _node_columns(parts: List[Any], sampled: List[str]) -> Nodes:
    """The columns in the parts of the file, which are None where a group did not match."""
    return Nodes(parts[1::6], parts[2::6], parts[3::6], parts[4::6], sampled)


class _Contents:
    """The contents of elements.

    :ivar sampled: the id in the sample for each element.
    """

    def __init__(self, contents: Sequence[str], letter: str) -> None:
        self._ids = {c: letter + str(i) for i, c in enumerate(dict.fromkeys(contents))}
        self.sampled = [self._ids[content] for content in contents]

    def __iter__(self) -> Iterator[Tuple[str, str]]:
        """Yield the id in the sample, and the content, of each different content."""
        return ((name, content) for content, name in self._ids.items())
