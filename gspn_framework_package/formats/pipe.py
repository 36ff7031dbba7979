"""PIPE XML, the "xml language" of the thesis (2.x to 5): read and write.

Elements are named by ``name/value``; arcs refer to ids. The generations of the tool differ in what
they write, which is read as follows:

==================  ================================================================================
marking, weight     ``1`` (2.x), ``Default,1`` (3 on), ``Default,0,Red,1`` (coloured: refused when
                    more than one class of tokens is in use); ``@`` stands for a comma inside
                    a function; empty (5) is the default: no token, weight 1
capacity            missing or 0: unlimited
``timed``           missing: immediate, but exponential with rate 1 if ``rate``, ``priority`` and
                    ``infiniteServer`` are missing, too (JARP and PNP have no timing);
                    ``rate`` is the weight of an immediate transition
``infiniteServer``  missing: single server, unless an option says otherwise
``priority``        missing: 1
arc ``type``        missing: normal
``definition``      a constant (a rate parameter), which a rate may name or compute with
==================  ================================================================================
"""

from __future__ import annotations

from typing import Dict, List, Mapping, Optional, Sequence, Set, Tuple

from lxml import etree

from gspn_framework_package.formats import vocabulary
from gspn_framework_package.formats.draft import NetDraft, ReadOptions
from gspn_framework_package.formats.tool_data import note_other_timing
from gspn_framework_package.formats.vocabulary import known
from gspn_framework_package.formats.xml_tree import (
    all_of,
    arc_kind,
    child,
    choose_net,
    label,
    line_of,
    moved,
    name_of,
    number_text,
    points,
    position,
    serialise,
    tag,
    write_graphics,
    write_points,
    writing_names,
)
from gspn_framework_package.model.constants import resolve_constants
from gspn_framework_package.model.errors import ExpressionError, NetError
from gspn_framework_package.model.expression import shorten
from gspn_framework_package.model.net import Arc, Net, Point

_NET_TYPE = "P/T net"
_DEFAULT_CLASS = "Default"
_HALF = 15.0
"""Half the width of PIPE's symbols: a position is the corner of one, a bend where it is drawn."""

_VALUE = known("", {"value": known(text=True)}, free="graphics toolspecific")
_FREE = "name graphics toolspecific comment tagged "
_PLACE = known("id", {"initialMarking": _VALUE, "capacity": _VALUE}, free=_FREE)
_TIMING = ("rate", "timed", "infiniteServer", "priority")
_TRANSITION = known("id", dict.fromkeys(_TIMING, _VALUE), free=_FREE + "orientation")
_ARC_TYPE = known(
    "value", {"value": known(text=True), "text": known(text=True)}, free="graphics toolspecific"
)
_ARC = known(
    "id source target type tagged",
    {"inscription": _VALUE, "type": _ARC_TYPE},
    free=_FREE + "arcpath",
)
_DEFINITION = known("id name expression defType type x y", free="graphics name toolspecific")
_NET = known(
    "id type name",
    {"place": _PLACE, "transition": _TRANSITION, "arc": _ARC, "definition": _DEFINITION},
    free=_FREE + "labels stateGroup stategroup token tokenclass finalmarkings",
    repeated="place transition arc definition",
)
_ROOT = known("version", free="net name toolspecific comment finalmarkings")


def from_xml(
    root: etree._Element, file: Optional[str], options: ReadOptions
) -> Tuple[Net, List[str]]:
    """Read the net in a parsed document, with notes."""
    nets = [root] if tag(root) == "net" else all_of(root, "net")
    element = choose_net(nets, options.net, file)
    if tag(root) == "pnml":
        vocabulary.check_element(root, _ROOT, "the document", NetDraft(file).fail)
    vocabulary.check_attributes(element, _NET, name_of(element, "net"), NetDraft(file).fail)
    reader = _Reader(element, file, options)
    reader.read()
    return reader.draft.net(_net_name(element)), reader.draft.notes


def _net_name(net: etree._Element) -> str:
    return (
        label(net, "name", "value")
        or (net.get("id") or "").strip()
        or (net.get("name") or "").strip()
    )


class _Reader:
    """Reads a net element in one pass."""

    def __init__(self, net: etree._Element, file: Optional[str], options: ReadOptions) -> None:
        self.net = net
        self.options = options
        self.draft = NetDraft(file, self._constants(file))
        self._untimed = 0
        self.classes: Dict[str, int] = {}  # class of tokens in use -> line of its first use

    def read(self) -> None:
        readers = {"place": self._place, "transition": self._transition, "arc": self._arc}
        for element in self.net:
            kind = tag(element)
            if kind == "page":
                self.draft.fail(
                    "a page in a PIPE net",
                    line=line_of(element),
                    hint="pages belong to ISO PNML; read it as format pnml",
                )
            if kind not in _NET.children:
                vocabulary.refuse_element(element, _NET, name_of(self.net, "net"), self.draft.fail)
            inside = _NET.children[kind]
            if inside is not vocabulary.ANY_CONTENT:
                vocabulary.check_element(element, inside, name_of(element, kind), self.draft.fail)
            if kind in readers:
                readers[kind](element)
                for specific in all_of(element, "toolspecific"):
                    note_other_timing(specific, name_of(element, kind), self.draft)
        self.draft.note_untimed(self._untimed)
        if len(self.classes) > 1:
            names = sorted(self.classes)
            self.draft.fail(
                "a coloured net: it uses tokens of the classes %s" % ", ".join(names),
                line=max(self.classes.values()),
                hint="only nets with one class of tokens are read; unfold it first",
            )

    def _constants(self, file: Optional[str]) -> Mapping[str, float]:
        definitions = {}
        for element in all_of(self.net, "definition"):
            name = element.get("name") or element.get("id")
            if name and (element.get("expression") or "").strip():
                definitions[name.strip()] = element.get("expression", "")
        try:
            return resolve_constants(definitions, self.options.constants)
        except ExpressionError as error:
            raise error.located(file=file) from None

    def _place(self, element: etree._Element) -> None:
        what, line = name_of(element, "place"), line_of(element)
        tokens = self._tokens(
            label(element, "initialMarking", "value"), 0, "initial marking", what, line
        )
        capacity = self._tokens(label(element, "capacity", "value"), 0, "capacity", what, line)
        self.draft.add_place(
            element.get("id"),
            label(element, "name", "value"),
            tokens,
            capacity or None,
            position(element),
            line,
        )

    def _transition(self, element: etree._Element) -> None:
        what, line = name_of(element, "transition"), line_of(element)
        identifier, name = element.get("id"), label(element, "name", "value")
        untimed = not any(child(element, part) is not None for part in _TIMING) and not any(
            specific.get("rateDefinition") for specific in all_of(element, "toolspecific")
        )
        self._untimed += untimed
        timed = untimed or self._flag(element, "timed", what)
        rate = self._rate(element, "rate" if timed else "weight", what)
        if timed:
            servers: Optional[int]
            if child(element, "infiniteServer") is None:
                servers = self.options.servers(1)
            else:
                servers = None if self._flag(element, "infiniteServer", what) else 1
            self.draft.add_exponential(
                identifier, name, 1.0 if rate is None else rate, servers, position(element), line
            )
            return
        text = label(element, "priority", "value")
        priority = self.draft.count(text, "priority", what, line) if text else 1
        weight = self.options.missing_weight if rate is None else rate
        self.draft.add_immediate(identifier, name, weight, priority, position(element), line)

    def _rate(self, element: etree._Element, what: str, name: str) -> Optional[float]:
        text = label(element, "rate", "value")
        for specific in all_of(element, "toolspecific"):
            text = specific.get("rateDefinition") or text
        if not text:
            return None
        text = text.replace("@", ",")
        if "#" in text:
            self.draft.fail(
                "its %s '%s' depends on the marking" % (what, shorten(text)),
                name,
                line_of(element),
                "only constant rates and weights are read",
            )
        return self.draft.number(text, what, name, line_of(element))

    def _flag(self, element: etree._Element, what: str, name: str) -> bool:
        text = (label(element, what, "value") or "false").lower()
        if text not in ("true", "false", "1", "0"):
            self.draft.fail(
                "its %s is '%s', neither true nor false" % (what, shorten(text)),
                name,
                line_of(element),
            )
        return text in ("true", "1")

    def _arc(self, element: etree._Element) -> None:
        what, line = name_of(element, "arc"), line_of(element)
        kind = arc_kind(element)
        if kind not in ("normal", "inhibitor"):
            self.draft.fail(
                "arcs of type '%s' are not known" % shorten(kind),
                what,
                line,
                "normal and inhibitor arcs are read",
            )
        weight = self._tokens(label(element, "inscription", "value"), 1, "weight", what, line)
        if weight == 0 and kind == "inhibitor":  # PIPE 5: no weight, one token inhibits
            weight = 1
        self.draft.add_arc(
            element.get("id"),
            element.get("source"),
            element.get("target"),
            weight,
            kind == "inhibitor",
            line,
            moved(points(all_of(element, "arcpath")[1:-1]), 1.0, -_HALF, 6),
        )

    def _tokens(self, text: Optional[str], default: int, what: str, name: str, line: int) -> int:
        """Return the number in ``1`` or ``Default,1`` or ``Default,0,Red,1``."""
        if not text:
            return default
        if text.isdigit():
            count = self.draft.count(text, what, name, line)
            if count:
                self.classes.setdefault(_DEFAULT_CLASS, line)
            return count
        pairs = _classes(text)
        if pairs is None:
            self._constant_only(text, what, name, line)
            if any(c in text for c in ",@;:") and "(" not in text:
                self.draft.fail(
                    "its %s '%s' is neither a number nor pairs of a class of tokens and a number"
                    % (what, shorten(text)),
                    name,
                    line,
                    "'Default,2' is such a pair; of coloured nets, those with one class in use "
                    "are read",
                )
            pairs = [(_DEFAULT_CLASS, text)]
        total = 0
        for token_class, number in pairs:
            self._constant_only(number, what, name, line)
            count = self.draft.count(number.replace("@", ","), what, name, line)
            if count:
                self.classes.setdefault(token_class, line)
            total += count
        return total

    def _constant_only(self, text: str, what: str, name: str, line: int) -> None:
        if "#" in text:
            self.draft.fail(
                "its %s '%s' depends on the marking" % (what, shorten(text)),
                name,
                line,
                "only constant weights are read",
            )


def _classes(text: str) -> Optional[Sequence[Tuple[str, str]]]:
    """Return the pairs (class, number) of ``Default,1,Red,0``; None if the text is a plain
    number."""
    for separator in (",", "@"):
        parts = [p.strip() for p in text.split(separator)]
        if len(parts) >= 2 and len(parts) % 2 == 0 and all(_is_class(p) for p in parts[::2]):
            return list(zip(parts[::2], parts[1::2]))
    return None


def _is_class(text: str) -> bool:
    return (
        bool(text) and not text[0].isdigit() and text.replace("_", "a").replace(" ", "a").isalnum()
    )


# -- writing -------------------------------------------------------------------------------------


def to_bytes(net: Net) -> bytes:
    """Return the net as a document that PIPE 2.5 to 5 and readers of the thesis's xml understand.

    :raises NetError: the net has something that the format cannot express.
    :raises RefusedError: a rate or weight depends on the marking.
    """
    net.require_numbers("a PIPE file")
    root = etree.Element("pnml")
    element = etree.SubElement(root, "net", type=_NET_TYPE)
    etree.SubElement(
        element, "token", id=_DEFAULT_CLASS, enabled="true", red="0", green="0", blue="0"
    )
    with writing_names(net):
        element.set("id", net.name or "Net-One")
        for place in net.places:
            node = _write_node(element, "place", place.name, place.position)
            _write_value(node, "initialMarking", "%s,%d" % (_DEFAULT_CLASS, place.tokens))
            _write_value(node, "capacity", str(place.capacity or 0))
        for transition in net.transitions:
            node = _write_node(element, "transition", transition.name, transition.position)
            _write_value(node, "orientation", "0")
            _write_value(node, "rate", number_text(transition.number))
            _write_value(node, "timed", _boolean(transition.timed))
            if transition.timed and transition.servers not in (None, 1):
                raise NetError(
                    "PIPE files know single and infinite servers, not %d" % transition.servers,
                    element="transition '%s'" % transition.name,
                    hint="PNPRO and PNML files can hold it",
                )
            _write_value(
                node, "infiniteServer", _boolean(transition.timed and transition.servers is None)
            )
            _write_value(node, "priority", str(transition.priority))
        used: Set[str] = set()
        drawn = net.positions
        for arc in net.arcs:
            identifier = unused("%s to %s" % (arc.source, arc.target), used)
            used.add(identifier)
            node = etree.SubElement(
                element, "arc", id=identifier, source=arc.source, target=arc.target
            )
            etree.SubElement(node, "graphics")
            _write_value(node, "inscription", "%s,%d" % (_DEFAULT_CLASS, arc.weight))
            _write_value(node, "tagged", "false")
            _write_path(node, drawn, arc)
            etree.SubElement(node, "type", value="inhibitor" if arc.inhibitor else "normal")
    return serialise(root)


def _write_node(
    parent: etree._Element, kind: str, name: str, where: Optional[Point]
) -> etree._Element:
    node = etree.SubElement(parent, kind, id=name)
    write_graphics(node, [where])
    _write_value(node, "name", name)
    return node


def _write_path(parent: etree._Element, drawn: Mapping[str, Point], arc: Arc) -> None:
    """Write the bends of an arc between its ends; PIPE itself puts those at the symbols' edges."""
    if not arc.bends:
        return
    begin, end = drawn.get(arc.source, arc.bends[0]), drawn.get(arc.target, arc.bends[-1])
    way = [begin, *arc.bends, end]
    write_points(parent, "arcpath", moved(way, 1.0, _HALF))
    for number, point in enumerate(all_of(parent, "arcpath")):
        point.set("id", "%03d" % number)
        point.set("curvePoint", "false")


def _write_value(parent: etree._Element, name: str, text: str) -> None:
    etree.SubElement(etree.SubElement(parent, name), "value").text = text


def _boolean(value: bool) -> str:
    return "true" if value else "false"


def unused(wanted: str, used: Set[str]) -> str:
    """Return an identifier that is not in ``used``: the wanted one, or one with a number."""
    identifier, number = wanted, 1
    while identifier in used:
        number += 1
        identifier = "%s (%d)" % (wanted, number)
    return identifier
