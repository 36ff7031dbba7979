"""PNPRO, the project files of the GreatSPN editor: read and write.

A project may have several nets; one is chosen by name. Markings, weights, delays and numbers of
servers are expressions over constants. The reader follows the conventions of the tool: ``delay`` of
an exponential transition is its *rate*; missing ``delay``, ``weight``, ``priority`` and ``mult``
are 1; missing ``nservers`` is Infinite. A ``template`` is a constant without a fixed value: unless
the user gives one, it takes the value it was last used with, and the reader adds a note. Coloured,
fluid and general-distribution elements are refused, and so are nets composed of others.

One unit of length in the editor is 16 units in the drawings of this package. The editor stores the
upper left corners of boxes whose width depends on the kind of node; the reader converts them so
that places and transitions aligned in the editor stay aligned."""

from __future__ import annotations

from typing import Dict, List, Mapping, Optional, Tuple

from lxml import etree

from gspn_framework_package.formats import vocabulary
from gspn_framework_package.formats.draft import NetDraft, ReadOptions, capacity_losses
from gspn_framework_package.formats.vocabulary import known
from gspn_framework_package.formats.xml_tree import (
    all_of,
    child,
    choose_net,
    coordinates,
    line_of,
    moved,
    name_of,
    number_text,
    points,
    serialise,
    tag,
    write_points,
    writing_names,
)
from gspn_framework_package.model.capacity import capacities_as_inhibitors
from gspn_framework_package.model.constants import resolve_constants
from gspn_framework_package.model.errors import ExpressionError, NetError
from gspn_framework_package.model.expression import shorten, tokenize
from gspn_framework_package.model.marking_function import (
    MarkingFunction,
    Value,
    quoted_place,
    text_operations,
)
from gspn_framework_package.model.net import Net, Point

_COMPOSITIONS = ("unfolding", "multinet", "composition", "algebra", "dta")
_COLOURED = ("color-class", "color-var")
_FUNCTIONS = {
    "Min": "min",
    "Max": "max",
    "Mod": "mod",
    "Pow": "pow",
    "Fract": "",
    "Abs": "abs",
    "Ceil": "ceil",
    "Floor": "floor",
    "Round": "round",
    "Exp": "exp",
    "Sqrt": "sqrt",
}
"""The functions of the editor that can be read -> their names here."""

_OPERATIONS = text_operations(
    {
        **{s: "(%%s %s %%s)" % s for s in "+-*/"},
        "negate": "(-%s)",
        "^": "Pow[%s, %s]",
        **{name: "%s[...]" % written for written, name in _FUNCTIONS.items() if name},
    }
)

_UNIT = 16.0
"""Drawing units per unit of the editor; a power of two, so that nothing is rounded."""

_CORNER = {"place": 0.0, "EXP": 0.55, "IMM": 0.85}

_DRAWN = "x y width height rotation magnets shown-as alt-name-fn text-size"
_COMPOSED = "superposition-tags superpos-tags"  # used when nets are composed, which is not read
_NODE = "name %s %s" % (_DRAWN, _COMPOSED)
_CONSTANT = known("consttype type value domain last-binding " + _NODE, positions=True)
_NODES = known(
    "",
    {
        "place": known(_NODE + " marking domain type partition", positions=True),
        "transition": known(_NODE + " type delay weight priority nservers guard", positions=True),
        "constant": _CONSTANT,
        "template": _CONSTANT,
    },
    free="text-box label",
    repeated="place transition constant template",
)
_EDGES = known(
    "",
    {
        "arc": known(
            "head tail kind type mult multiplicity broken text-size", free="point", positions=True
        )
    },
    repeated="arc",
)
_SHOWN = (
    "zoom view-rates view-guards view-priorities view-names view-superpos-tags "
    "show-timed-cmd show-color-cmd show-fluid-cmd"
)
_NET = known("name version " + _SHOWN, {"nodes": _NODES, "edges": _EDGES}, positions=True)


def from_xml(
    root: etree._Element, file: Optional[str], options: ReadOptions
) -> Tuple[Net, List[str]]:
    """Read the net in a parsed document, with notes.

    :raises NetError: there is no such net, or it is not a GSPN.
    """
    if tag(root) == "gspn":
        element = choose_net([root], options.net, file)
    else:
        _refuse_composition(root, file, options.net)
        element = choose_net(all_of(root, "gspn"), options.net, file)
    reader = _Reader(element, file, options)
    reader.read()
    return reader.draft.net((element.get("name") or "").strip()), reader.draft.notes


def _refuse_composition(root: etree._Element, file: Optional[str], wanted: Optional[str]) -> None:
    nets = all_of(root, "gspn")
    for element in root:
        if tag(element) in _COMPOSITIONS and (
            element.get("name") == wanted if wanted is not None else not nets
        ):
            names = ", ".join("'%s'" % net.get("name") for net in nets)
            raise NetError(
                "it is composed of other nets, which is not read",
                file=file,
                line=line_of(element),
                element="<%s> '%s'" % (tag(element), element.get("name")),
                hint="the file has the nets %s" % names
                if nets
                else "export the composed net first",
            )


class _Reader:
    """Reads a net element in one pass."""

    def __init__(self, net: etree._Element, file: Optional[str], options: ReadOptions) -> None:
        self.file = file
        self.net = net
        self.options = options
        nodes = child(net, "nodes")
        edges = child(net, "edges")
        self.nodes = [] if nodes is None else list(nodes)
        self.edges = [] if edges is None else list(edges)
        self.draft = NetDraft(file)

    def read(self) -> None:
        """Fill the draft."""
        self._refuse_colours()
        vocabulary.check_attributes(self.net, _NET, name_of(self.net, "net"), self.draft.fail)
        for element in self.net:
            if tag(element) not in _NET.children:
                vocabulary.refuse_element(element, _NET, name_of(self.net, "net"), self.draft.fail)
            group = _NODES if tag(element) == "nodes" else _EDGES
            vocabulary.check_attributes(element, group, name_of(self.net, "net"), self.draft.fail)
        if len(all_of(self.net, "nodes")) > 1 or len(all_of(self.net, "edges")) > 1:
            self.draft.fail(
                "it has <nodes> or <edges> twice", name_of(self.net, "net"), line_of(self.net)
            )
        self._check(self.nodes, _NODES)
        self._check(self.edges, _EDGES)
        self.draft.constants = self._constants()
        readers = {"place": self._place, "transition": self._transition}
        for element in self.nodes:
            kind = tag(element)
            if kind in readers:
                readers[kind](element)
        for element in self.edges:
            self._arc(element)

    def _check(self, elements: List[etree._Element], group: vocabulary.Element) -> None:
        for element in elements:
            kind = tag(element)
            if kind not in group.children:
                vocabulary.refuse_element(element, group, name_of(self.net, "net"), self.draft.fail)
            inside = group.children[kind]
            if inside is not vocabulary.ANY_CONTENT:
                vocabulary.check_element(element, inside, _what(element), self.draft.fail)

    def _refuse_colours(self) -> None:
        for element in self.nodes:
            domain = (element.get("domain") or "").strip()
            if tag(element) in _COLOURED or domain not in ("", "Neutral"):
                self.draft.fail(
                    "a coloured net",
                    name_of(element, tag(element)),
                    line_of(element),
                    "only nets with one class of tokens are read; unfold it first",
                )

    def _constants(self) -> Mapping[str, float]:
        definitions: Dict[str, str] = {}
        lines: Dict[str, int] = {}
        for element in self.nodes:
            kind, name = tag(element), (element.get("name") or "").strip()
            if kind not in ("constant", "template") or not name:
                continue
            lines["constant '%s'" % name] = line_of(element)
            attribute = "value" if kind == "constant" else "last-binding"
            text = (element.get(attribute) or "").strip()
            if not text:
                continue  # an error only if it is used
            definitions[name] = self._expression(
                text, "value", name_of(element, kind), line_of(element)
            )
            if kind == "template" and name not in self.options.constants:
                self.draft.note(
                    "%s = %s: the value that the template was last used with"
                    % (name, shorten(text))
                )
        try:
            return resolve_constants(definitions, self.options.constants)
        except ExpressionError as error:
            raise error.located(file=self.file, line=lines.get(error.element or "")) from None

    def _place(self, element: etree._Element) -> None:
        what, line = name_of(element, "place"), line_of(element)
        kind = (element.get("type") or "DISCRETE").upper()
        if kind != "DISCRETE":
            text = (
                "a fluid place"
                if kind == "CONTINUOUS"
                else "a place of the unknown type '%s'" % shorten(kind)
            )
            self.draft.fail(text, what, line, "only discrete places are read")
        text = (element.get("marking") or "").strip()
        tokens = self._count(text, "initial marking", what, line) if text else 0
        self.draft.add_place(
            None, _name(element), tokens, None, _from_editor(coordinates(element), "place"), line
        )

    def _transition(self, element: etree._Element) -> None:
        what, line = name_of(element, "transition"), line_of(element)
        kind = (element.get("type") or "EXP").strip().upper()
        if kind not in ("EXP", "IMM"):
            known = {"GEN": "of a general distribution", "CONT": "with a continuous flow"}
            self.draft.fail(
                "a transition %s" % known.get(kind, "of the unknown type '%s'" % shorten(kind)),
                what,
                line,
                "exponential (EXP) and immediate (IMM) ones are read",
            )
        guard = (element.get("guard") or "").strip()
        if guard and guard.lower() != "true":
            self.draft.fail(
                "its guard '%s' is not read" % shorten(guard),
                what,
                line,
                "guards belong to coloured nets",
            )
        where = _from_editor(coordinates(element), kind)
        if kind == "EXP":
            rate = self._value(element, "delay", "rate", what, 1.0)
            self.draft.add_exponential(
                None, _name(element), rate, self._servers(element, what), where, line
            )
            return
        text = (element.get("priority") or "").strip()
        priority = self._count(text, "priority", what, line) if text else 1
        weight = self._value(element, "weight", "weight", what, self.options.missing_weight)
        self.draft.add_immediate(None, _name(element), weight, priority, where, line)

    def _value(
        self, element: etree._Element, attribute: str, meaning: str, what: str, default: float
    ) -> Value:
        text = (element.get(attribute) or "").strip()
        if not text:
            return default
        line = line_of(element)
        return self.draft.value(self._expression(text, meaning, what, line), meaning, what, line)

    def _count(self, text: str, meaning: str, what: str, line: int) -> int:
        return self.draft.count(self._expression(text, meaning, what, line), meaning, what, line)

    def _expression(self, text: str, meaning: str, what: str, line: int) -> str:
        """Translate an expression of the editor, which writes ``Max[a, b]``, and ``Fract[a, b]``
        for a / b."""
        if "[" not in text:
            return text
        try:
            tokens = tokenize(text)
        except ExpressionError as error:
            self.draft.fail("its %s cannot be computed: %s" % (meaning, error.message), what, line)
        words: List[str] = []
        # for each open bracket: the number of commas seen, if it is a fraction
        fractions: List[Optional[int]] = []
        for token, following in zip(tokens, tokens[1:]):
            before = text[: token.start]
            words.append(" " * (len(before) - len(before.rstrip())))
            if token.kind == "name" and following.text == "[" and following.kind != "name":
                if token.text not in _FUNCTIONS:
                    self.draft.fail(
                        "its %s uses %s[...], which is not read" % (meaning, shorten(token.text)),
                        what,
                        line,
                        "%s are" % ", ".join(_FUNCTIONS),
                    )
                words.append(_FUNCTIONS[token.text])
                fractions.append(0 if token.text == "Fract" else None)
            elif token.kind == "name":
                words.append(quoted_place(token.text))
            elif token.text == "[":
                words.append("((" if fractions and fractions[-1] is not None else "(")
            elif token.text == "]" and fractions:
                commas = fractions.pop()
                if commas not in (None, 1):
                    self.draft.fail(
                        "its %s has a Fract[...] without two numbers" % meaning, what, line
                    )
                words.append(")" if commas is None else "))")
            elif token.text == "," and fractions and fractions[-1] is not None:
                fractions[-1] += 1
                words.append(")/(")
            else:
                words.append(token.text)
        return "".join(words)

    def _servers(self, element: etree._Element, what: str) -> Optional[int]:
        text = (element.get("nservers") or "").strip()
        if not text:
            return self.options.servers(None)
        if text.lower() in ("infinite", "single"):
            return None if text.lower() == "infinite" else 1
        return self._count(text, "number of servers", what, line_of(element))

    def _arc(self, element: etree._Element) -> None:
        tail, head = element.get("tail"), element.get("head")
        what, line = _what(element), line_of(element)
        kind = (element.get("kind") or element.get("type") or "").strip().upper()
        if kind not in ("INPUT", "OUTPUT", "INHIBITOR"):
            self.draft.fail(
                "arcs of kind '%s' are not known" % shorten(kind),
                what,
                line,
                "INPUT, OUTPUT and INHIBITOR arcs are read",
            )
        text = (element.get("mult") or element.get("multiplicity") or "").strip()
        if text.startswith("<"):
            self.draft.fail("a coloured net: its weight is '%s'" % shorten(text), what, line)
        weight = self._count(text, "weight", what, line) if text else 1
        # a place is two units wide, and its position is its corner
        bends = moved(points(all_of(element, "point")), _UNIT, -_UNIT, 6)
        self.draft.add_arc(None, tail, head, weight, kind == "INHIBITOR", line, bends)


def _what(element: etree._Element) -> str:
    """Return the name of the element for a message."""
    if tag(element) == "arc":
        return "arc from '%s' to '%s'" % (element.get("tail"), element.get("head"))
    return name_of(element, tag(element))


def _name(element: etree._Element) -> str:
    return (element.get("name") or "").strip()


def _from_editor(where: Optional[Point], kind: str) -> Optional[Point]:
    """Convert the position of a node (place, EXP or IMM) to the model's."""
    if where is None:
        return None
    return round((where[0] - _CORNER[kind]) * _UNIT, 6), where[1] * _UNIT


# -- writing -------------------------------------------------------------------------------------


def losses(net: Net) -> List[str]:
    """Return notes for the user on what the format expresses differently."""
    return capacity_losses(net)


def value_text(value: Value, transition: str) -> str:
    """Return the rate or weight of a transition as the editor writes it."""
    if not isinstance(value, MarkingFunction):
        return number_text(value)
    names = {name: "#" + quoted_place(name) for name in value.places}
    return str(value.write(names, _OPERATIONS, "transition '%s'" % transition))


def to_bytes(net: Net) -> bytes:
    """Return the net as a project file of one net; capacities become equivalent inhibitor arcs.

    :raises NetError: a name cannot be written in XML.
    """
    net = capacities_as_inhibitors(net)
    root = etree.Element("project", name=net.name or "net", version="121")
    with writing_names(net):
        gspn = etree.SubElement(root, "gspn", name=net.name or "net")
        nodes, edges = etree.SubElement(gspn, "nodes"), etree.SubElement(gspn, "edges")
        for place in net.places:
            node = etree.SubElement(nodes, "place", name=place.name, marking=str(place.tokens))
            write_position(node, place.position, "place")
        for transition in net.transitions:
            node = etree.SubElement(nodes, "transition", name=transition.name)
            if transition.timed:
                node.set("type", "EXP")
                node.set("delay", value_text(transition.rate, transition.name))
                servers = transition.servers
                node.set("nservers", "Infinite" if servers is None else str(servers))
            else:
                node.set("type", "IMM")
                node.set("weight", value_text(transition.weight, transition.name))
                node.set("priority", str(transition.priority))
            write_position(node, transition.position, node.get("type", ""))
        for arc in net.arcs:
            kind = "INPUT" if arc.source in net.place_index else "OUTPUT"
            edge = etree.SubElement(
                edges,
                "arc",
                tail=arc.source,
                head=arc.target,
                kind="INHIBITOR" if arc.inhibitor else kind,
                mult=str(arc.weight),
            )
            write_points(edge, "point", moved(arc.bends, 1 / _UNIT, 1.0))
    return serialise(root, depth=4)


def write_position(node: etree._Element, where: Optional[Point], kind: str) -> None:
    """Write the position of a node: place, EXP or IMM."""
    if where is not None:
        node.set("x", number_text(round(where[0] / _UNIT + _CORNER[kind], 9)))
        node.set("y", number_text(where[1] / _UNIT))
