"""The draft of a net that a reader fills while it goes through a file.

It implements the rules that all formats share: an element is called by its name, or by its id if
the name is empty or not unique; an arc refers to its ends by id, otherwise by name; errors have a
line number."""

from __future__ import annotations

from functools import partial
from itertools import chain
from typing import (
    TYPE_CHECKING,
    Dict,
    List,
    Mapping,
    NamedTuple,
    NoReturn,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from gspn_framework_package.formats.xml_tree import point
from gspn_framework_package.model.errors import ExpressionError, GspnError, NetError, NoValueError
from gspn_framework_package.model.expression import as_whole, evaluate, shorten
from gspn_framework_package.model.marking_function import Value, parse_value
from gspn_framework_package.model.net import Arc, Net, Place, Point, Transition

if TYPE_CHECKING:
    from gspn_framework_package.formats.repetition import FileSample

_MAX_DIGITS = 300  # maximum number of digits of a whole number; longer ones are not token counts

NO_CONSTANTS: Mapping[str, float] = {}


class ReadOptions(NamedTuple):
    """How to read a net: what the reader assumes where tools differ, and the user's settings.

    :ivar format: name of the file's format; None to recognise it by its content.
    :ivar net: name of the net to read from a file that has several.
    :ivar constants: values of constants; they take precedence over those of the file.
    :ivar infinite_servers: whether an exponential transition has infinitely many servers if the
        file does not give their number; None uses the default of the format (PNPRO: infinitely
        many, others: one).
    :ivar missing_weight: weight of an immediate transition if the file does not give one: 1, or 0
        for "controllable", as is usual in robotics.
    """

    format: Optional[str] = None
    net: Optional[str] = None
    constants: Mapping[str, float] = NO_CONSTANTS
    infinite_servers: Optional[bool] = None
    missing_weight: float = 1.0

    def servers(self, format_default: Optional[int]) -> Optional[int]:
        """Return the number of servers (None: infinitely many) for a transition if the file does
        not give it."""
        if self.infinite_servers is None:
            return format_default
        return None if self.infinite_servers else 1


def one_line(text: Optional[str]) -> str:
    """Return a name or id without line breaks and surrounding space."""
    if not text:
        return ""
    if text.isprintable():  # no line break in the name
        return text.strip()
    return " ".join(part.strip() for part in text.splitlines()).strip()


class _Node(NamedTuple):
    identifier: str
    name: str
    line: Optional[int]
    item: Union[Place, Transition]


_ArcLine = Tuple[str, str, str, int, bool, Tuple[Point, ...], Optional[int]]
"""Id, source, target, weight, whether it is an inhibitor arc, bends and line of an arc. A plain
tuple, because a file may have 200,000 arcs."""


class NetDraft:
    """A net under construction.

    :param file: the file that it comes from, for messages.
    :param constants: values that its expressions may use.
    """

    def __init__(
        self, file: Optional[str] = None, constants: Mapping[str, float] = NO_CONSTANTS
    ) -> None:
        self.file = file
        self.constants = constants
        self.notes: List[str] = []
        self._nodes: Dict[str, _Node] = {}
        self._arcs: List[_ArcLine] = []

    # -- filling ---------------------------------------------------------------------------------

    def note(self, text: str) -> None:
        """Add a note for the user; a repeated note is kept once."""
        if text not in self.notes:
            self.notes.append(text)

    def note_untimed(self, count: int) -> None:
        """Note that ``count`` transitions have no timing in the file."""
        if count:
            self.note(
                "%d transition%s without timing: exponential with rate 1"
                % (count, "" if count == 1 else "s")
            )

    def fail(
        self,
        message: str,
        element: Optional[str] = None,
        line: Optional[int] = None,
        hint: Optional[str] = None,
    ) -> NoReturn:
        """Raise a NetError that names this file."""
        raise NetError(message, file=self.file, line=line, element=element, hint=hint)

    def add_place(
        self,
        identifier: Optional[str],
        name: Optional[str],
        tokens: int = 0,
        capacity: Optional[int] = None,
        position: Optional[Point] = None,
        line: Optional[int] = None,
    ) -> None:
        """Add a place; either ``identifier`` or ``name`` may be missing."""
        identifier, name = one_line(identifier), one_line(name)
        self._add(identifier, name, Place(name or identifier, tokens, capacity, position), line)

    def add_immediate(
        self,
        identifier: Optional[str],
        name: Optional[str],
        weight: Value = 1.0,
        priority: int = 1,
        position: Optional[Point] = None,
        line: Optional[int] = None,
    ) -> None:
        """Add an immediate transition; either ``identifier`` or ``name`` may be missing."""
        identifier, name = one_line(identifier), one_line(name)
        item = Transition(name or identifier, False, 1.0, weight, priority, 1, position)
        self._add(identifier, name, item, line)

    def add_exponential(
        self,
        identifier: Optional[str],
        name: Optional[str],
        rate: Value = 1.0,
        servers: Optional[int] = 1,
        position: Optional[Point] = None,
        line: Optional[int] = None,
    ) -> None:
        """Add an exponential transition (``rate`` in 1/s; ``servers`` None: infinitely many)."""
        identifier, name = one_line(identifier), one_line(name)
        item = Transition(name or identifier, True, rate, 1.0, 1, servers, position)
        self._add(identifier, name, item, line)

    def add_arc(
        self,
        identifier: Optional[str],
        source: Optional[str],
        target: Optional[str],
        weight: int = 1,
        inhibitor: bool = False,
        line: Optional[int] = None,
        bends: Tuple[Point, ...] = (),
    ) -> None:
        """Add an arc; its ends are ids or names of nodes, which may come later in the file."""
        source, target = one_line(source), one_line(target)
        if not source or not target:
            element = "arc '%s'" % shorten(identifier) if identifier else "arc"
            self.fail("it has no %s" % ("target" if source else "source"), element, line)
        self._arcs.append((identifier or "", source, target, weight, inhibitor, bends, line))

    def _add(
        self, identifier: str, name: str, item: Union[Place, Transition], line: Optional[int]
    ) -> None:
        key = identifier or name
        if not key:
            self.fail("a %s has neither an id nor a name" % _kind(item), line=line)
        if key in self._nodes:
            other = self._nodes[key]
            where = " in line %d" % other.line if other.line else ""
            self.fail(
                "the id is already taken by a %s%s" % (_kind(other.item), where),
                "%s '%s'" % (_kind(item), key),
                line,
                "ids of places and transitions must differ",
            )
        self._nodes[key] = _Node(key, name, line, item)

    # -- numbers ---------------------------------------------------------------------------------

    def number(self, text: str, what: str, element: str, line: Optional[int]) -> float:
        """Return the value of a number, or of an expression over the constants.

        :param what: what the number means, for the message: ``rate``.
        :raises NetError: the value cannot be computed.
        """
        try:
            return evaluate(text, self.constants)
        except ExpressionError as error:
            hint = error.hint
            if isinstance(error, NoValueError):
                hint = "%s; give a constant its value with --const NAME=VALUE" % hint
            self.fail("its %s cannot be computed: %s" % (what, error.message), element, line, hint)

    def value(self, text: str, what: str, element: str, line: Optional[int]) -> Value:
        """Return a rate or weight: a number, or a function of the marking.

        :raises NetError: see :meth:`number`.
        """
        if "#" not in text:
            return self.number(text, what, element, line)
        try:
            return parse_value(text, self.constants)
        except ExpressionError as error:
            self.fail(
                "its %s cannot be read: %s" % (what, error.message), element, line, error.hint
            )

    def count(self, text: str, what: str, element: str, line: Optional[int]) -> int:
        """Return the value of a whole number, or of an expression with a whole result; it may be
        negative.

        :raises NetError: the value cannot be computed, or is not whole.
        """
        if text.isascii() and text.isdigit() and len(text) <= _MAX_DIGITS:
            return int(text)
        value = as_whole(self.number(text, what, element, line))
        if value is None:
            self.fail("its %s '%s' is not a whole number" % (what, shorten(text)), element, line)
        return value

    # -- the net ---------------------------------------------------------------------------------

    def net(self, name: str) -> Net:
        """Return the finished net.

        :raises NetError: the net is not well formed; the message has the file and the line.
        """
        names = self._names()
        ends = {node.name: names[i] for i, node in self._nodes.items() if node.name}
        ends.update(names)  # an id takes precedence over an equal name of another node
        places: List[Place] = []
        transitions: List[Transition] = []
        renamed = {n.name for i, n in self._nodes.items() if names[i] != n.name}
        for identifier, node in self._nodes.items():
            item = node.item
            function = item.function if isinstance(item, Transition) else None
            for place in () if function is None else function.places:
                if place in renamed:
                    self.fail(
                        "'%s', which it names, is the name of several places or transitions"
                        % place,
                        "transition '%s'" % item.name,
                        node.line,
                        "give each its own name",
                    )
            if item.name != names[identifier]:
                item = item._replace(name=names[identifier])
            if isinstance(item, Place):
                places.append(item)
            else:
                transitions.append(item)
        arcs = []
        for identifier, source, target, weight, inhibitor, bends, line in self._arcs:
            try:
                arcs.append(Arc(ends[source], ends[target], weight, inhibitor, bends))
            except KeyError as error:
                self.fail(
                    "there is no place or transition '%s'" % error.args[0],
                    "arc '%s' from '%s' to '%s'" % (identifier, source, target),
                    line,
                    "an arc joins a place and a transition of the same net",
                )
        if not places and not transitions:
            self.fail("the net has no place and no transition")
        try:
            return Net(places, transitions, arcs, name)
        except GspnError as error:
            line = self._lines(names, arcs).get(error.element or "")
            raise error.located(file=self.file, line=line) from None

    def net_of_sample(self, sample: FileSample, name: str) -> Optional[Net]:
        """Return the net of a file if this is the draft of its sample; None if something in the
        file is unusual or wrong, so that it has to be read as a whole."""
        known = {identifier: node.item for identifier, node in self._nodes.items()}
        kinds = {arc[0]: arc[3:6] for arc in self._arcs}
        sampled = (*sample.places.sampled, *sample.transitions.sampled)
        if (
            known.keys() != set(sampled)
            or any(node.name for node in self._nodes.values())
            or kinds.keys() != set(sample.arcs.sampled)
            or len(kinds) != len(self._arcs)
        ):
            return None
        ids = list(map(str.strip, chain(sample.places.ids, sample.transitions.ids)))
        names = [
            (text or "").strip() or identifier
            for text, identifier in zip(chain(sample.places.names, sample.transitions.names), ids)
        ]
        if not all(ids) or len(set(ids)) < len(ids) or len(set(names)) < len(names):
            return None
        items = list(map(known.__getitem__, sampled))
        positions = [item.position for item in items]
        for nodes, first in ((sample.places, 0), (sample.transitions, len(sample.places.ids))):
            if any(nodes.x):
                for i, (x, y) in enumerate(zip(nodes.x, nodes.y), first):
                    if x is not None and y is not None:
                        positions[i] = point(x, y)
        places: List[Place] = []
        transitions: List[Transition] = []
        for item, called, position in zip(items, names, positions):
            if isinstance(item, Place):
                places.append(Place(called, item[1], item[2], position))
            else:
                transitions.append(Transition(called, *item[1:6], position))
        new_arc = partial(tuple.__new__, Arc)  # a third of the time of Arc(...)
        ends = dict(zip(names, names))
        ends.update(zip(ids, names))
        end_named, kind_of = ends.__getitem__, kinds.__getitem__
        try:
            arcs = [
                new_arc((source, target, *kind))
                for source, target, kind in zip(
                    map(end_named, sample.arcs.sources),
                    map(end_named, sample.arcs.targets),
                    map(kind_of, sample.arcs.sampled),
                )
            ]
            return Net(places, transitions, arcs, name)
        except (KeyError, GspnError):
            return None

    def _lines(self, names: Mapping[str, str], arcs: Sequence[Arc]) -> Dict[str, Optional[int]]:
        """Return the line of each element, by the name that it has in the errors of ``Net``."""
        lines: Dict[str, Optional[int]] = {}
        for identifier, node in self._nodes.items():
            lines["%s '%s'" % (_kind(node.item), names[identifier])] = node.line
        for arc, drafted in zip(arcs, self._arcs):
            kind = "inhibitor arc" if arc.inhibitor else "arc"
            lines.setdefault("%s from '%s' to '%s'" % (kind, arc.source, arc.target), drafted[-1])
        return lines

    def _names(self) -> Dict[str, str]:
        """Return the name for each id: the element's name, or the id if that is empty or not
        unique."""
        names = {i: n.name or i for i, n in self._nodes.items()}
        if len(set(names.values())) == len(names):
            return names
        bearers: Dict[str, List[str]] = {}
        for identifier, name in names.items():
            bearers.setdefault(name, []).append(identifier)
        crowded = [name for name, found in bearers.items() if len(found) > 1]
        while crowded:
            name = crowded.pop()
            for identifier in bearers[name]:
                if identifier != name:
                    names[identifier] = identifier
                    others = bearers.setdefault(identifier, [])
                    others.append(identifier)
                    if len(others) == 2:
                        crowded.append(identifier)
            bearers[name] = [identifier for identifier in bearers[name] if identifier == name]
        renamed = [n for i, n in self._nodes.items() if n.name and names[i] != n.name]
        if renamed:
            self.note(
                "%d element%s with a name that others have too (such as '%s') %s named by id"
                % (
                    len(renamed),
                    "" if len(renamed) == 1 else "s",
                    renamed[0].name,
                    "is" if len(renamed) == 1 else "are",
                )
            )
        return names


def _kind(item: Union[Place, Transition]) -> str:
    return "place" if isinstance(item, Place) else "transition"


def capacity_losses(net: Net) -> List[str]:
    """Return the note for the user if a writer turns capacities of this net into inhibitor arcs."""
    if any(place.capacity is not None for place in net.places):
        return ["capacities are written as equivalent inhibitor arcs"]
    return []
