"""Helpers for the XML formats: safe parsing, children by local name, labels, positions, output."""

from __future__ import annotations

import math
from contextlib import contextmanager
from functools import lru_cache
from typing import (
    TYPE_CHECKING,
    Any,
    Dict,
    Iterable,
    Iterator,
    List,
    Optional,
    Sequence,
    Tuple,
    cast,
)

from gspn_framework_package.model.errors import InputError, NetError
from gspn_framework_package.model.expression import shorten
from gspn_framework_package.model.net import Net, Point

if TYPE_CHECKING:
    from lxml import etree


def xml_parser(**options: Any) -> etree.XMLParser:
    """A parser that loads nothing from outside the document: no entities, external files, network
    or attribute defaults of a DTD.

    :param options: options of ``lxml.etree.XMLParser`` for what to keep.
    """
    from lxml import etree  # imported by the first XML file: most plans have none

    return etree.XMLParser(
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        dtd_validation=False,
        attribute_defaults=False,
        huge_tree=False,
        **options,
    )


def parse_xml(data: bytes, file: Optional[str] = None) -> etree._Element:
    """Parse an XML document and return its root, without comments and processing instructions.

    Entities, external files, network access and attribute defaults of a DTD are disabled.

    :raises InputError: the document is not well-formed (with the line), or it declares entities.
    """
    from lxml import etree

    parser = xml_parser(remove_comments=True, remove_pis=True, remove_blank_text=False)
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        if b"<!ENTITY" in data or "<!ENTITY".encode("utf-16-le") in data:
            raise _entities(file) from None
        line = error.lineno or None
        text = shorten((error.msg or "the document is empty").split(", line ")[0], 200)
        raise InputError(
            "not well-formed XML: %s" % text,
            file=file,
            line=line,
            hint="the file may be cut off or damaged",
        ) from None
    except ValueError as error:
        raise InputError("not well-formed XML: %s" % shorten(str(error), 200), file=file) from None
    if root is None:
        raise InputError("not well-formed XML: the document is empty", file=file)
    dtd: Any = root.getroottree().docinfo.internalDTD
    if dtd is not None and dtd.entities():
        raise _entities(file)
    return root


def _entities(file: Optional[str]) -> InputError:
    return InputError(
        "the document declares XML entities, which are not read",
        file=file,
        hint="replace the entities by their values",
    )


def tag(element: etree._Element) -> str:
    """Return the tag of an element without its namespace."""
    return _local_name(element.tag)


@lru_cache(maxsize=256)  # a large net has a million elements, of a dozen tags
def _local_name(name: Any) -> str:
    if not isinstance(name, str):  # an undeclared entity reference
        return ""
    return name if name[:1] != "{" else name.rpartition("}")[2]


def child(element: etree._Element, name: str) -> Optional[etree._Element]:
    """Return the first child with that tag in any namespace."""
    if not len(element):  # true of most arcs; a search by lxml costs more
        return None
    return next(element.iterchildren("{*}" + name), None)


def all_of(element: etree._Element, name: str) -> List[etree._Element]:
    """Return all children with that tag in any namespace."""
    if not len(element):
        return []
    return list(element.iterchildren("{*}" + name))


def label(element: etree._Element, name: str, part: str) -> Optional[str]:
    """Return the text of ``element/name/part``, stripped; None if missing or empty."""
    outer = child(element, name)
    return None if outer is None else text_of(outer, part)


def text_of(element: Optional[etree._Element], part: str) -> Optional[str]:
    """Return the text of ``element/part``, stripped; None if missing or empty."""
    for node in element if element is not None else ():
        if tag(node) == part:
            return (node.text or "").strip() or None
    return None


_ARC_KINDS = {"regular": "normal", "inhibition": "inhibitor"}
"""Words that some tools use for the two kinds of arc."""


def arc_kind(element: etree._Element) -> str:
    """Return the kind of an arc: ``normal``, ``inhibitor``, or the word in the file if it is
    another one.

    Tools write it in four ways: an attribute ``type`` of the arc (TAPAAL), ``<type value="..."/>``
    (PIPE, TINA), ``<type><text>`` or ``<type><value>``, and ``<arctype><text>`` (ProM, pm4py).
    If two of them disagree, the result has both words.
    """
    if not len(element) and element.get("type") is None:
        return "normal"
    found = {element.get("type"), label(element, "arctype", "text")}
    for node in all_of(element, "type"):
        found |= {
            node.get("value"),
            label(element, "type", "text"),
            label(element, "type", "value"),
        }
    words = {word.strip().lower() for word in found if word and word.strip()}
    words = {_ARC_KINDS.get(word, word) for word in words}
    return " and ".join(sorted(words)) or "normal"


def line_of(element: etree._Element) -> int:
    """Return the line on which the element begins."""
    return cast(int, element.sourceline or 0)


def attributes(element: etree._Element) -> Dict[str, str]:
    """Return the attributes of the element."""
    return dict(cast(List[Tuple[str, str]], element.items()))


def name_of(element: etree._Element, kind: str) -> str:
    """Return the name of the element for a message: ``place 'p1'``."""
    identifier = element.get("id") or element.get("name")
    return "%s '%s'" % (kind, shorten(identifier)) if identifier else kind


def position(element: etree._Element) -> Optional[Point]:
    """Return the position in ``graphics/position``, None if there is no valid one."""
    graphics = child(element, "graphics")
    return position_in(graphics) if graphics is not None else None


def position_in(graphics: etree._Element) -> Optional[Point]:
    """Return the position in a ``graphics`` element, None if there is no valid one."""
    where = child(graphics, "position")
    return coordinates(where) if where is not None else None


def points(elements: Iterable[etree._Element]) -> Tuple[Point, ...]:
    """Return the positions that elements have in ``x`` and ``y``; invalid ones are left out."""
    return tuple(filter(None, map(coordinates, elements)))


def moved(bends: Iterable[Point], scale: float, shift: float, digits: int = 9) -> Tuple[Point, ...]:
    """Points of a drawing in another unit: ``scale`` times each coordinate, plus ``shift``. They
    are rounded, so that they return as they were."""
    return tuple(
        (round(scale * x + shift, digits), round(scale * y + shift, digits)) for x, y in bends
    )


def write_points(parent: etree._Element, name: str, bends: Iterable[Point]) -> None:
    """Write an element with ``x`` and ``y`` for each point."""
    from lxml import etree

    for x, y in bends:
        etree.SubElement(parent, name, x=number_text(x), y=number_text(y))


def write_graphics(parent: etree._Element, where: Iterable[Optional[Point]]) -> None:
    """Write the points that there are as ``graphics/position``."""
    from lxml import etree

    found = [spot for spot in where if spot is not None]
    if found:
        write_points(etree.SubElement(parent, "graphics"), "position", found)


def coordinates(element: etree._Element) -> Optional[Point]:
    """Return the attributes ``x`` and ``y`` as a position; None unless both are finite numbers."""
    return point(element.get("x", ""), element.get("y", ""))


def point(x_text: str, y_text: str) -> Optional[Point]:
    """Return two coordinates as a position; None unless both are finite numbers."""
    try:
        x, y = float(x_text), float(y_text)
    except ValueError:
        return None
    return (x, y) if math.isfinite(x) and math.isfinite(y) else None


def choose_net(
    nets: Sequence[etree._Element], wanted: Optional[str], file: Optional[str]
) -> etree._Element:
    """Return the net called ``wanted`` (by name or id), or the only net.

    :raises NetError: there is no net, none of that name, or several and ``wanted`` is None.
    """
    if not nets:
        raise NetError("there is no net in the file", file=file)
    names = [_net_names(net) for net in nets]
    known = ", ".join("'%s'" % (n[0] if n else "") for n in names[:20])
    if wanted is not None:
        for net, called in zip(nets, names):
            if wanted in called:
                return net
        raise NetError(
            "there is no net '%s' in the file" % wanted, file=file, hint="the nets are %s" % known
        )
    if len(nets) > 1:
        raise NetError(
            "the file holds %d nets" % len(nets),
            file=file,
            line=line_of(nets[1]),
            hint="choose one by name: %s" % known,
        )
    return nets[0]


def _net_names(net: etree._Element) -> List[str]:
    found = (
        net.get("name"),
        label(net, "name", "value"),
        label(net, "name", "text"),
        net.get("id"),
    )
    return [n.strip() for n in found if n and n.strip()]


def number_text(value: float) -> str:
    """Return a number as text that reads back exactly as the same value."""
    return repr(float(value))


@contextmanager
def writing_names(net: Net) -> Iterator[None]:
    """Report names that cannot be written in XML (control characters) as an error of the net."""
    try:
        yield
    except ValueError as error:
        raise NetError(
            "a name cannot be written in XML: %s" % error, element="net '%s'" % net.name
        ) from None


def serialise(root: etree._Element, depth: int = 2) -> bytes:
    """Return the document as UTF-8 with an XML declaration, with line breaks down to ``depth``
    levels."""
    from lxml import etree

    _break_lines(root, 0, depth)
    return etree.tostring(root, xml_declaration=True, encoding="UTF-8")


def _break_lines(element: etree._Element, level: int, depth: int) -> None:
    if level >= depth or len(element) == 0:
        return
    element.text = "\n" + "  " * (level + 1)
    for node in element:
        node.tail = element.text
        _break_lines(node, level + 1, depth)
    element[-1].tail = "\n" + "  " * level
