"""PNML of ISO/IEC 15909-2, with stochastic data as process-mining tools attach it: read and write.

Pages may be nested, and reference places and transitions stand for the nodes they refer to. Timing
is in ``toolspecific tool="StochasticPetriNet" version="0.2"``: ``distributionType`` IMMEDIATE or
EXPONENTIAL, with ``weight`` and ``priority``, or with the parameter of the distribution. Two tools
disagree on the meaning of that parameter: pm4py writes the rate, ProM the mean. A file whose net
has ProM's own properties (time unit or execution policy) is read as ProM's, any other as pm4py's,
with a note. A transition without such data is exponential with rate 1, with a note, because the
standard itself has no notion of time. TINA writes intervals into ``delay``: ``[0,w[`` means the
same as no interval, ``[0,0]`` means immediate, and others are refused. TINA's test arcs become arcs
in both directions. Symmetric nets are unfolded (:mod:`.coloured`).

Elements and attributes that are not listed here are refused: see :mod:`.vocabulary`.

Data that neither the standard nor those tools can express (capacities, numbers of servers, that a
parameter is a rate) is in ``toolspecific tool="gspn_framework_package"``, which other tools
ignore."""

from __future__ import annotations

from functools import partial
from typing import Callable, Dict, Iterable, List, Mapping, NamedTuple, Optional, Tuple

from lxml import etree

from gspn_framework_package.formats import vocabulary
from gspn_framework_package.formats.coloured import Colours
from gspn_framework_package.formats.draft import NetDraft, ReadOptions
from gspn_framework_package.formats.pnml_family import OWN, PNML, STOCHASTIC, member
from gspn_framework_package.formats.repetition import FileSample
from gspn_framework_package.formats.tool_data import note_other_timing
from gspn_framework_package.formats.vocabulary import ANY_CONTENT, known
from gspn_framework_package.formats.xml_tree import (
    all_of,
    arc_kind,
    attributes,
    child,
    choose_net,
    label,
    line_of,
    name_of,
    number_text,
    parse_xml,
    points,
    position_in,
    serialise,
    tag,
    text_of,
    write_graphics,
    writing_names,
)
from gspn_framework_package.model.expression import shorten
from gspn_framework_package.model.marking_function import Value
from gspn_framework_package.model.net import Net, Point

NAMESPACE = "http://www.pnml.org/version-2009/grammar/pnml"
_NET_TYPE = "http://www.pnml.org/version-2009/grammar/ptnet"

_SYMMETRIC_TYPE = "http://www.pnml.org/version-2009/grammar/symmetricnet"

_COLOURED = ("symmetric", "highlevel", "hlpn", "colored", "coloured")
_TINA = "laas.fr/tina"
_KNOWN_TYPES = ("ptnet", "pnmlcoremodel", "epnml", "p/t", _TINA)
_COLOURED_LABELS = ("hlinitialMarking", "hlinscription", "declaration", "structure")

_TEXT = known(text=True)
_LABEL = known("", {"text": _TEXT}, free="graphics toolspecific")
_DELAY = known(
    "",
    {"interval": known("closure", {"cn": _TEXT, "ci": _TEXT}, repeated="cn ci")},
    free="graphics",
)
_FREE = "name graphics toolspecific comment "
_PLACE = known("id", {"initialMarking": _LABEL}, free=_FREE + "label tagged")
_TRANSITION = known("id", {"delay": _DELAY}, free=_FREE + "label tagged")
_REFERENCE = known("id ref", free=_FREE)
_ARC_TYPE = known("value", {"text": _TEXT, "value": _TEXT}, free="graphics toolspecific")
_ARC = known(
    "id source target type tagged",
    {"inscription": _LABEL, "type": _ARC_TYPE, "arctype": _LABEL},
    free=_FREE + "tagged",
)
_ENDS = frozenset(("id", "source", "target"))
_PAGE = known("id", free=_FREE + "text finalmarkings")
_NET = known("id type name", free=_FREE + "text finalmarkings")
_ROOT = known("version", free="net name toolspecific comment finalmarkings")
_OWN_KEYS = ("capacity", "servers", "parameter", "rate", "weight")

Data = Dict[str, str]
"""Key -> value, as strings."""


class _Reference(NamedTuple):
    target: str
    line: int


def from_xml(
    root: etree._Element, file: Optional[str], options: ReadOptions
) -> Tuple[Net, List[str]]:
    """Read the net in a parsed document, with notes.

    :raises NetError: there is no such net, or it is neither a place/transition net nor a coloured
        one that can be unfolded.
    """
    net = choose_net(all_of(root, "net"), options.net, file)
    kind = _ColouredReader if _is_coloured(net) else _Reader
    reader = kind(net, file, options)
    reader.note_timing(len(reader.untimed))
    return reader.draft.net(reader.name), reader.draft.notes


def from_sample(sample: FileSample, options: ReadOptions) -> Optional[Tuple[Net, List[str]]]:
    """Read the net of a large file from its sample, with notes; None if the file has to be read as
    a whole.

    :raises GspnError: something is wrong in the file; the line in the error is one of the sample.
    """
    root = parse_xml(sample.document)
    if tag(root) != "pnml" or member(root).kind != PNML:
        return None
    element = choose_net(all_of(root, "net"), options.net, None)
    if _is_coloured(element):
        return None
    reader = _Reader(element, None, options)
    net = None if reader.references else reader.draft.net_of_sample(sample, reader.name)
    if net is None:
        return None
    untimed = set(reader.untimed)
    reader.note_timing(sum(sampled in untimed for sampled in sample.transitions.sampled))
    return net, reader.draft.notes


def _is_coloured(net: etree._Element) -> bool:
    """Whether the type of a net says that it has colours."""
    kind = (net.get("type") or "").lower()
    return any(word in kind for word in _COLOURED)


class _Reader:
    """Reads the net in a document, with its pages, in one pass.

    :ivar name: the name of the net.
    :ivar draft: what was read.
    :ivar references: the reference places and transitions, by id.
    :ivar untimed: the ids of the transitions without timing.
    """

    place_words, transition_words, arc_words = _PLACE, _TRANSITION, _ARC

    def __init__(self, net: etree._Element, file: Optional[str], options: ReadOptions) -> None:
        self.net = net
        self.name = label(net, "name", "text") or (net.get("id") or "").strip()
        self.options = options
        self.draft = NetDraft(file, options.constants)
        self.references: Dict[str, _Reference] = {}
        self.arcs: List[etree._Element] = []
        self.untimed: List[Optional[str]] = []
        self.parameters = 0
        self.means = STOCHASTIC in _data({"toolspecific": all_of(net, "toolspecific")})
        self.tina = _TINA in (net.get("type") or "").lower()
        root = net.getroottree().getroot()
        vocabulary.check_element(root, _ROOT, "the document", self.draft.fail)
        self._read()

    def _read(self) -> None:
        kind = (self.net.get("type") or "").lower()
        if kind and not any(word in kind for word in (*_KNOWN_TYPES, *_COLOURED)):
            self.draft.fail(
                "nets of the type '%s' are not known" % shorten(kind),
                line=line_of(self.net),
                hint="place/transition nets are read: %s" % _NET_TYPE,
            )
        vocabulary.check_attributes(self.net, _NET, name_of(self.net, "net"), self.draft.fail)
        self._nodes(self.net, _NET)
        self._finish()

    def _finish(self) -> None:
        """Read the parts that refer to nodes, once all nodes are known."""
        for arc in self.arcs:
            self._arc(arc)

    def note_timing(self, untimed: int) -> None:
        """Note the assumptions about timing; ``untimed`` transitions have none in the file."""
        self.draft.note_untimed(untimed)
        if self.parameters:
            meaning = "means, as ProM writes them" if self.means else "rates, as pm4py writes them"
            self.draft.note("parameters of exponential distributions are read as %s" % meaning)

    def _page(self, page: etree._Element) -> None:
        vocabulary.check_attributes(page, _PAGE, name_of(page, "page"), self.draft.fail)
        self._nodes(page, _PAGE)

    def _nodes(self, page: etree._Element, free: vocabulary.Element) -> None:
        readers = self._readers()
        for element in page:
            kind = tag(element)
            if kind in readers:
                readers[kind](element)
            elif kind in _COLOURED_LABELS:
                self._refuse_colour(element, "net")
            elif kind == "net":
                self.draft.fail(
                    "a net inside a page, as subprocesses of WoPeD have it, is not read",
                    name_of(page, "page"),
                    line_of(element),
                    "put the nodes of the subprocess in the place of its transition",
                )
            elif kind not in free.children:
                everything = free._replace(children={**free.children, **dict.fromkeys(readers)})
                vocabulary.refuse_element(
                    element, everything, name_of(page, tag(page)), self.draft.fail
                )

    def _readers(self) -> Dict[str, Callable[[etree._Element], None]]:
        """The readers of a page's elements, by tag."""
        return {
            "page": self._page,
            "place": self._place,
            "transition": self._transition,
            "referencePlace": self._reference,
            "referenceTransition": self._reference,
            "arc": self.arcs.append,
        }

    def _refuse_colour(self, element: etree._Element, what: str) -> None:
        self.draft.fail(
            "a coloured net: it has a <%s>" % tag(element),
            what,
            line_of(element),
            "the type of a coloured net is %s" % _SYMMETRIC_TYPE,
        )

    def _check(
        self, parent: etree._Element, known_of_it: vocabulary.Element, what: str
    ) -> vocabulary.Children:
        def fail(
            message: str, element: Optional[str], line: Optional[int], hint: Optional[str]
        ) -> None:
            # no vocabulary has these labels, so the check fails wherever one occurs
            for node in parent:
                if tag(node) in _COLOURED_LABELS:
                    self._refuse_colour(node, what)
            self.draft.fail(message, element, line, hint)

        return vocabulary.check_element(parent, known_of_it, what, fail)

    def _own(self, data: Mapping[str, Data], what: str, line: int) -> Data:
        """Return the properties that this package wrote; refuse unknown ones, which a newer version
        may have written."""
        own = data.get(OWN, {})
        for key in own:
            if key not in _OWN_KEYS:
                self.draft.fail(
                    "its property '%s' is not known" % shorten(key),
                    what,
                    line,
                    "the file may have been written by a newer version of this package",
                )
        return own

    def _note_tools(self, parts: vocabulary.Children, what: str) -> None:
        for specific in parts.get("toolspecific", ()):
            note_other_timing(specific, what, self.draft)

    def _place(self, element: etree._Element) -> None:
        what, line = name_of(element, "place"), line_of(element)
        parts = self._check(element, self.place_words, what)
        self._note_tools(parts, what)
        text = _text(parts, "initialMarking")
        tokens = self.draft.count(text, "initial marking", what, line) if text else 0
        text = self._own(_data(parts), what, line).get("capacity")
        capacity = self.draft.count(text, "capacity", what, line) if text else None
        identifier, name = element.get("id"), _text(parts, "name")
        for after, own_tokens in self._contents(element, tokens):
            self.draft.add_place(
                _with(identifier, after),
                _with(name, after),
                own_tokens,
                capacity,
                None if after else _position(parts),
                line,
            )

    def _contents(self, element: etree._Element, tokens: int) -> Iterable[Tuple[str, int]]:
        """For each place that a coloured place becomes: the suffix of its name, and its tokens."""
        return (("", tokens),)

    def _transition(self, element: etree._Element) -> None:
        what, line = name_of(element, "transition"), line_of(element)
        parts = self._check(element, self.transition_words, what)
        self._note_tools(parts, what)
        identifier, name = element.get("id"), _text(parts, "name")
        tools = _data(parts)
        data, own = tools.get(STOCHASTIC, {}), self._own(tools, what, line)
        kind = data.get("distributionType", "").upper()
        if not kind and ("weight" in data or "priority" in data):
            kind = "IMMEDIATE"
        if not kind and "delay" in parts and self._is_immediate_by_delay(parts["delay"][0], what):
            kind = "IMMEDIATE"
        if kind == "IMMEDIATE":
            weight: Value = self.options.missing_weight
            if own.get("weight"):
                weight = self.draft.value(own["weight"], "weight", what, line)
            elif data.get("weight"):
                weight = self.draft.number(data["weight"], "weight", what, line)
            text = data.get("priority")
            priority = self.draft.count(text, "priority", what, line) if text else 1
            add = partial(self.draft.add_immediate, weight=weight, priority=priority)
            self._copy_transition(element, name, add, _position(parts))
            return
        if kind not in ("", "EXPONENTIAL"):
            self.draft.fail(
                "its time has the distribution %s" % shorten(kind),
                what,
                line,
                "immediate and exponential transitions are read",
            )
        text = own.get("servers")
        servers = self.options.servers(1)
        if text:
            servers = (
                None
                if text == "infinite"
                else self.draft.count(text, "number of servers", what, line)
            )
        rate = self._rate(kind, data, own, what, line)
        add = partial(self.draft.add_exponential, rate=rate, servers=servers)
        copies = self._copy_transition(element, name, add, _position(parts))
        if not kind and not data.get("distributionParameters", "").strip("[](){} "):
            self.untimed += [identifier] * copies

    def _copy_transition(
        self,
        element: etree._Element,
        name: Optional[str],
        add: Callable[..., None],
        position: Optional[Point],
    ) -> int:
        """Add a transition as often as it occurs; return how often that is."""
        identifier, copies = element.get("id"), 0
        for after in self._copies(identifier):
            names = _with(identifier, after), _with(name, after)
            add(*names, position=None if after else position, line=line_of(element))
            copies += 1
        return copies

    def _copies(self, identifier: Optional[str]) -> Iterable[str]:
        """The suffixes of the names of the transitions that a coloured transition becomes."""
        return ("",)

    def _is_immediate_by_delay(self, delay: etree._Element, what: str) -> bool:
        """Whether TINA's time interval means "at once"; "any time" means the same as no
        interval."""
        interval = child(delay, "interval")
        if interval is None:
            return False
        ends = [(node.text or "").strip() for node in interval]
        around = {"closed": "[%s]", "closed-open": "[%s[", "open-closed": "]%s]", "open": "]%s["}
        bounds = ",".join("w" if word == "infty" else word for word in ends)
        text = around.get(interval.get("closure", ""), "%s") % bounds
        if text not in ("[0,w[", "[0,0]"):
            self.draft.fail(
                "it has the time interval %s" % shorten(text),
                what,
                line_of(interval),
                "[0,w[ (any time) and [0,0] (immediate) are read",
            )
        return text == "[0,0]"

    def _rate(self, kind: str, data: Data, own: Data, what: str, line: int) -> Value:
        if own.get("rate"):
            return self.draft.value(own["rate"], "rate", what, line)
        text = data.get("distributionParameters", "").strip("[](){} ")
        if not text:
            return 1.0
        value = self.draft.number(text.rstrip(";,"), "rate", what, line)
        if own.get("parameter") == "rate":
            return value
        self.parameters += 1
        if self.means:
            if value <= 0:
                self.draft.fail("its mean time %s is not above 0" % shorten(text), what, line)
            value = 1.0 / value
        return value

    def _reference(self, element: etree._Element) -> None:
        identifier, target = element.get("id"), element.get("ref")
        what = name_of(element, "reference")
        self._check(element, _REFERENCE, what)
        if not identifier or not target:
            self.draft.fail("it needs an id and a ref", what, line_of(element))
        self.references[identifier] = _Reference(target, line_of(element))

    def _resolve(self, end: Optional[str]) -> Optional[str]:
        """Follow a chain of references to the node at its end."""
        seen: Dict[str, None] = {}
        while end is not None and end in self.references:
            if end in seen:
                ring = [*list(seen)[list(seen).index(end) :], end]
                self.draft.fail(
                    "references lead to each other: %s" % shorten(" -> ".join(ring)),
                    "reference '%s'" % end,
                    self.references[end].line,
                )
            seen[end] = None
            end = self.references[end].target
        return end

    def _arc(self, element: etree._Element) -> None:
        said = attributes(element)
        if not len(element) and not element.text and _ENDS.issuperset(said):
            # Most arcs have only a source and a target, and nothing inside to check or look for.
            source, target = said.get("source"), said.get("target")
            if self.references:
                source, target = self._resolve(source), self._resolve(target)
            self.draft.add_arc(said.get("id"), source, target, 1, False, line_of(element))
            return
        what, line = name_of(element, "arc"), line_of(element)
        parts = self._check(element, self.arc_words, what)
        self._note_tools(parts, what)
        kind = arc_kind(element)
        if kind not in ("normal", "inhibitor") and not (kind == "test" and self.tina):
            self.draft.fail(
                "arcs of type '%s' are not known" % shorten(kind),
                what,
                line,
                "normal and inhibitor arcs are read",
            )
        text = label(element, "inscription", "text")
        weight = self.draft.count(text, "weight", what, line) if text else 1
        identifier = element.get("id")
        source, target = self._resolve(element.get("source")), self._resolve(element.get("target"))
        bends = points(all_of(parts["graphics"][0], "position")) if "graphics" in parts else ()
        self.draft.add_arc(identifier, source, target, weight, kind == "inhibitor", line, bends)
        if kind == "test":  # arcs in both directions are equivalent
            self.draft.add_arc(identifier, target, source, weight, False, line)


class _ColouredReader(_Reader):
    """Reads a coloured net: a place for each of its colours, a transition for each binding of its
    variables; see :mod:`.coloured`."""

    place_words = known(
        "id", {"type": ANY_CONTENT, "hlinitialMarking": ANY_CONTENT}, free=_FREE + "label tagged"
    )
    transition_words = known("id", {"condition": ANY_CONTENT}, free=_FREE + "label tagged")
    arc_words = known("id source target", {"hlinscription": ANY_CONTENT}, free=_FREE)

    def _read(self) -> None:
        self._colours = Colours(self.net, self.draft.fail)
        self._places: List[etree._Element] = []
        self._transitions: List[etree._Element] = []
        super()._read()

    def _readers(self) -> Dict[str, Callable[[etree._Element], None]]:
        return {
            **super()._readers(),
            "place": self._places.append,
            "transition": self._transitions.append,
            "declaration": lambda element: None,  # read with the colours
        }

    def _finish(self) -> None:
        for element in self._places:
            self._colours.add_place(element)
        for element in self._transitions:
            self._colours.add_transition(element)
        for element in self.arcs:
            self._check(element, self.arc_words, name_of(element, "arc"))
            ends = self._resolve(element.get("source")), self._resolve(element.get("target"))
            self._colours.add_arc(element, *ends)
        self._colours.demand_size()
        for element in self._places:
            self._place(element)
        for element in self._transitions:
            self._transition(element)
        for arc in self._colours.arcs():
            self.draft.add_arc(arc.identifier, arc.source, arc.target, arc.weight, line=arc.line)
        self.draft.note("unfolded, with the names PLACE.COLOUR and TRANSITION.VALUES")

    def _contents(self, element: etree._Element, tokens: int) -> Iterable[Tuple[str, int]]:
        return self._colours.contents(element.get("id", ""))

    def _copies(self, identifier: Optional[str]) -> Iterable[str]:
        return self._colours.copies(identifier or "")


def _with(name: Optional[str], after: str) -> Optional[str]:
    """A name or id, if there is one, with something after it."""
    return name + after if name and after else name


def _text(parts: vocabulary.Children, name: str) -> Optional[str]:
    """Return the text of the first label of that name."""
    return text_of(parts[name][0], "text") if name in parts else None


def _position(parts: vocabulary.Children) -> Optional[Point]:
    return position_in(parts["graphics"][0]) if "graphics" in parts else None


def _data(parts: vocabulary.Children) -> Dict[str, Data]:
    """Return the data of each tool in the ``toolspecific`` of an element, which may be properties
    (``<property key="weight">2</property>``) or attributes; tools without data are left out."""
    found: Dict[str, Data] = {}
    for node in parts.get("toolspecific", ()):
        said = attributes(node)
        tool = said.pop("tool", "")
        said.pop("version", None)
        for part in node:
            if tag(part) == "property":
                said[part.get("key", "")] = (part.text or "").strip()
        if said:
            found.setdefault(tool, {}).update(said)
    return found


# -- writing -------------------------------------------------------------------------------------


def to_bytes(net: Net) -> bytes:
    """Return the net as an ISO 15909-2 document of one page, with timing as pm4py reads it.

    :raises NetError: a name cannot be written in XML.
    """
    root = etree.Element("pnml", xmlns=NAMESPACE)
    with writing_names(net):
        element = etree.SubElement(root, "net", id=net.name or "net1", type=_NET_TYPE)
        if net.name:
            _write_text(element, "name", net.name)
        page = etree.SubElement(element, "page", id="page1")
        ids = {p.name: "p%d" % i for i, p in enumerate(net.places)}
        ids.update((t.name, "t%d" % i) for i, t in enumerate(net.transitions))
        for place in net.places:
            node = _write_node(page, "place", ids[place.name], place.name, place.position)
            if place.tokens:
                _write_text(node, "initialMarking", str(place.tokens))
            if place.capacity is not None:
                _write_properties(node, OWN, "1.0", {"capacity": str(place.capacity)})
        for transition in net.transitions:
            node = _write_node(
                page, "transition", ids[transition.name], transition.name, transition.position
            )
            own: Data = {}
            text, function = "", transition.function
            if function is None:
                text = number_text(transition.number)
            else:  # other tools could not read it
                own["rate" if transition.timed else "weight"] = function.text
            if transition.timed:
                timing = {
                    "distributionType": "EXPONENTIAL",
                    "distributionParameters": text,
                    "priority": "0",
                    "weight": "1.0",
                }
                servers = "infinite" if transition.servers is None else str(transition.servers)
                own.update(parameter="rate", servers=servers)
            else:
                timing = {
                    "distributionType": "IMMEDIATE",
                    "priority": str(transition.priority),
                    "weight": text,
                }
            _write_properties(node, STOCHASTIC, "0.2", timing)
            _write_properties(node, OWN, "1.0", own)
        for number, arc in enumerate(net.arcs):
            node = etree.SubElement(
                page, "arc", id="a%d" % number, source=ids[arc.source], target=ids[arc.target]
            )
            if arc.weight != 1:
                _write_text(node, "inscription", str(arc.weight))
            if arc.inhibitor:
                etree.SubElement(node, "type", value="inhibitor")
            write_graphics(node, arc.bends)
    return serialise(root, depth=3)


def _write_node(
    parent: etree._Element, kind: str, identifier: str, name: str, where: Optional[Point]
) -> etree._Element:
    node = etree.SubElement(parent, kind, id=identifier)
    _write_text(node, "name", name)
    write_graphics(node, [where])
    return node


def _write_text(parent: etree._Element, name: str, text: str) -> None:
    etree.SubElement(etree.SubElement(parent, name), "text").text = text


def _write_properties(parent: etree._Element, tool: str, version: str, values: Data) -> None:
    """Write the properties that have a text, if any."""
    shown = {key: value for key, value in values.items() if value}
    if not shown:
        return
    node = etree.SubElement(parent, "toolspecific", tool=tool, version=version)
    for key, value in shown.items():
        etree.SubElement(node, "property", key=key).text = value
