"""Changing a net in its own file, without losing what this package does not read.

The elements that changed are changed in the tree of the XML document (in a file of TINA, their
lines); annotations, the points of
arcs, colours and the data of other tools stay. The result is read back and compared: a file is only
replaced by one that says what it should.
"""

from __future__ import annotations

import difflib
import math
import re
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple, Type, Union

from lxml import etree

from gspn_framework_package.formats import pipe, pnml, pnpro, tina
from gspn_framework_package.formats.draft import ReadOptions, one_line
from gspn_framework_package.formats.format import Format, NetFile
from gspn_framework_package.formats.registry import FORMATS, format_named
from gspn_framework_package.formats.xml_tree import (
    all_of,
    arc_kind,
    child,
    choose_net,
    label,
    number_text,
    parse_xml,
    tag,
    xml_parser,
)
from gspn_framework_package.model.errors import GspnError, NetError
from gspn_framework_package.model.net import Arc, Net, Place, Transition

Node = Union[Place, Transition]

_MANY_LINES = 3000
"""Files of more lines are compared in a way that is faster and finds fewer unchanged lines."""

CLOSE = 1e-5
"""How far a position may be off when it is read back, as a part of its size (or of 1)."""


def update_net(data: bytes, path: str, options: ReadOptions, new: Net) -> Optional[bytes]:
    """Return the content of a net file that holds ``new``.

    :param data: the content of the file.
    :param path: its name, for messages.
    :param options: how it is read.
    :returns: ``data`` itself if it says the same already; None if the format cannot hold the net.
    :raises GspnError: the file cannot be read.
    """
    file = NetFile(data, path)
    format = _format_of(file, options)
    old = _read(format, file, options)
    if same_net(old, new):
        return data
    update = _UPDATES.get(format.name)
    if update is None:
        return None
    try:
        changed = update(data, options, old, new)
        if same_net(_read(format, NetFile(changed, path), options), new):
            return changed
    except (GspnError, _CannotHoldError, ValueError):
        pass
    return None


def _format_of(file: NetFile, options: ReadOptions) -> Format:
    if options.format is not None:
        return format_named(options.format)
    for format in FORMATS.values():
        if format.reader is not None and format.reader.takes(file):
            return format
    raise NetError("not a net in any format that is known", file=file.path)


def _read(format: Format, file: NetFile, options: ReadOptions) -> Net:
    assert format.reader is not None
    return format.reader.read_file(file, format.title, options)[0]


def same_net(a: Net, b: Net) -> bool:
    """Whether two nets say the same; the order of their elements does not matter."""
    if len(a.places) != len(b.places) or len(a.transitions) != len(b.transitions):
        return False
    for mine, others in ((a.places, b.places), (a.transitions, b.transitions)):
        named = {node.name: node for node in others}
        for node in mine:
            other = named.get(node.name)
            if other is None or not same_node(node, other):
                return False
    return sorted(map(_key, a.arcs)) == sorted(map(_key, b.arcs))


def same_node(a: Node, b: Node) -> bool:
    """Whether two nodes say the same, up to the rounding of their positions."""
    if (a.position is None) != (b.position is None):
        return False
    if a.position is not None and b.position is not None:
        for x, y in zip(a.position, b.position):
            if not math.isclose(x, y, rel_tol=CLOSE, abs_tol=CLOSE):
                return False
    return _meaning(a) == _meaning(b)


def _meaning(node: Node) -> Tuple[Any, ...]:
    """The node without its position, and without what its kind does not have."""
    if isinstance(node, Place):
        return (node.name, node.tokens, node.capacity)
    if node.timed:
        return (node.name, True, node.rate, node.servers)
    return (node.name, False, node.weight, node.priority)


def _key(arc: Arc) -> Tuple[str, str, int, bool]:
    return (arc.source, arc.target, arc.weight, arc.inhibitor)


class _CannotHoldError(Exception):
    """The format cannot hold the net, or the file is written in a way that is not changed here."""


def _child(element: Any, name: str) -> Any:
    """As :func:`child`, of an element that has it, or whose caller asks."""
    return child(element, name)


class _Change(NamedTuple):
    """What happens to a node: it is new (``old`` is None), goes (``new`` is None) or changes."""

    old: Optional[Node]
    new: Optional[Node]


def _changes(old: Sequence[Node], new: Sequence[Node]) -> List[_Change]:
    """The changes of places or of transitions. A node that takes the turn of another in the list is
    the same node with a new name."""
    before, after = {n.name: n for n in old}, {n.name: n for n in new}
    renamed: Dict[str, str] = {}
    matcher = difflib.SequenceMatcher(
        None, [n.name for n in old], [n.name for n in new], autojunk=False
    )
    for kind, i, j, k, m in matcher.get_opcodes():
        if kind == "replace" and j - i == m - k:
            for one, other in zip(old[i:j], new[k:m]):
                if one.name not in after and other.name not in before:
                    renamed[one.name] = other.name
    changes = [
        _Change(node, after.get(renamed.get(node.name, node.name)))
        for node in old
        if node != after.get(node.name)
    ]
    taken = set(renamed.values())
    changes += [_Change(None, n) for n in new if n.name not in before and n.name not in taken]
    return changes


# -- XML -------------------------------------------------------------------------------------------


_PROLOGUE = re.compile(
    rb"(?:\xef\xbb\xbf)?(?:\s+|<\?.*?\?>|<!--.*?-->|<!DOCTYPE[^\[>]*(?:\[.*?\]\s*)?>)*", re.DOTALL
)


def _update_xml(
    kind: Type[_XmlNet], data: bytes, options: ReadOptions, old: Net, new: Net
) -> bytes:
    root = _parse(data)
    before: Any = etree.tostring(
        root, encoding=root.getroottree().docinfo.encoding, with_tail=False
    )
    kind(root, options, old, new).change()
    return _serialised(root, data, before)


def _parse(data: bytes) -> Any:
    """The root of a document with all its comments, which :func:`parse_xml` accepts."""
    parse_xml(data)
    return etree.fromstring(data, xml_parser(strip_cdata=False))


def _serialised(root: Any, data: bytes, before: bytes) -> bytes:
    """The document, in which lines that have not changed are those of the file.

    :param data: the file.
    :param before: the root element as it was written before the change.
    """
    encoding = root.getroottree().docinfo.encoding or "UTF-8"
    if encoding.upper().startswith(("UTF-16", "UCS", "UTF-32")):
        whole: Any = etree.tostring(root.getroottree(), encoding=encoding, xml_declaration=True)
        return bytes(whole)
    found = _PROLOGUE.match(data)
    start = found.end() if found else 0
    end = data.rindex(b">") + 1
    closing = data.rfind(b"</", start, end)
    name = re.match(rb"</[^\s>]+\s*>", data[closing:])
    if name is not None and root[-1:] and _is_end(name.group(), root):
        end = closing + name.end()
    now: Any = etree.tostring(root, encoding=encoding, with_tail=False)
    lines = _reconciled(data[start:end], _bare(before), _bare(now), b"\r\n" in data)
    return data[:start] + lines + data[end:]


def _is_end(closing: bytes, root: Any) -> bool:
    return closing[2:-1].strip().split(b":")[-1].decode(errors="replace") == tag(root)


def _bare(text: bytes) -> bytes:
    """An element without the declaration that lxml writes before some encodings."""
    found = _PROLOGUE.match(text)
    return text[found.end() :] if found else text


def _reconciled(file: bytes, before: bytes, now: bytes, carriage: bool) -> bytes:
    """The lines of ``now``; those that are in ``before`` too as the file has them."""
    theirs, old, new = file.split(b"\n"), before.split(b"\n"), now.split(b"\n")
    if carriage:
        old, new = ([line.rstrip(b"\r") for line in lines] for lines in (old, new))
    if len(theirs) != len(old):
        return (b"\r\n" if carriage else b"\n").join(new)
    result: List[bytes] = []
    large = len(old) > _MANY_LINES
    for kind, i, j, k, m in difflib.SequenceMatcher(None, old, new, large).get_opcodes():
        if kind == "equal":
            result += theirs[i:j]
        else:
            result += [line + b"\r" if carriage else line for line in new[k:m]]
    return b"\n".join(result).rstrip(b"\r")


class _XmlNet:
    """A net in an XML document, whose elements correspond in order to those of the net read."""

    donor_format = pipe.FORMAT

    def __init__(self, root: Any, options: ReadOptions, old: Net, new: Net) -> None:
        self.root, self.options, self.old, self.new = root, options, old, new
        self.net = self.find_net()
        self.elements: Dict[str, Any] = {}
        both: Tuple[Tuple[str, Sequence[Node]], ...] = (
            ("place", old.places),
            ("transition", old.transitions),
        )
        for kind, nodes in both:
            found = self.all(kind)
            if len(found) != len(nodes):
                raise _CannotHoldError
            self.elements.update((node.name, e) for node, e in zip(nodes, found))
        arcs = [e for e in self.all("arc") for _ in range(self.arcs_of(e))]
        if len(arcs) != len(old.arcs):
            raise _CannotHoldError
        self.arcs = list(zip(old.arcs, arcs))
        self._donors: Dict[str, List[Any]] = {}
        self._last: Dict[str, Any] = {}
        self.used = {e.get("id") for e in self.root.iter("{*}*") if e.get("id")}
        self.numbers = {
            part: number
            for parts in (new.places, new.transitions, new.arcs)
            for number, part in enumerate(parts)
        }

    def find_net(self) -> Any:
        """The element of the net."""
        nets = [self.root] if tag(self.root) == "net" else all_of(self.root, "net")
        return choose_net(nets, self.options.net, None)

    def all(self, kind: str) -> List[Any]:
        """All elements of that kind, in the order in which they are read."""
        return [e for e in self.net.iter("{*}" + kind) if self.counts(e)]

    def counts(self, element: Any) -> bool:
        """Whether an element with the tag of a node or arc is one."""
        return True

    def arcs_of(self, element: Any) -> int:
        """How many arcs an element is read as."""
        return 1

    def change(self) -> None:
        """Make the document say what the new net says."""
        changes = [
            *_changes(self.old.places, self.new.places),
            *_changes(self.old.transitions, self.new.transitions),
        ]
        if any(not c.old or not c.new or c.old.name != c.new.name for c in changes):
            self._name_by_id()
        names = {c.old.name: c.new.name for c in changes if c.old and c.new}
        wanted: Dict[Tuple[str, str, int, bool], int] = {}
        for arc in self.new.arcs:
            wanted[_key(arc)] = wanted.get(_key(arc), 0) + 1
        spare: List[Tuple[Arc, Any]] = []
        for arc, element in self.arcs:
            now = arc._replace(
                source=names.get(arc.source, arc.source), target=names.get(arc.target, arc.target)
            )
            if wanted.get(_key(now)):
                wanted[_key(now)] -= 1
            else:
                spare.append((now, element))
        added = [arc for arc in self.new.arcs if self._take(wanted, arc)]
        by_ends: Dict[Tuple[str, str], List[Tuple[Arc, Any]]] = {}
        for was, element in spare:
            by_ends.setdefault(was[:2], []).append((was, element))
        fresh = []
        for arc in added:  # another weight or kind: the same arc, changed
            there = by_ends.get(arc[:2])
            if there:
                was, element = there.pop(0)
                self.set_arc(self._alone(element), was, arc)
            else:
                fresh.append(arc)
        for left in by_ends.values():
            for _, element in left:
                _remove(self._alone(element))
        for change in changes:
            if change.old is not None and change.new is None:
                self.remove_node(self.elements.pop(change.old.name))
        renamed = [c for c in changes if c.old and c.new and c.old.name != c.new.name]
        moved = [(c, self.elements.pop(c.old.name)) for c in renamed if c.old]
        for change, element in moved:
            assert change.old is not None and change.new is not None
            self.elements[change.new.name] = element
            self.rename(element, change.old.name, change.new.name)
        for change in changes:
            if change.new is None:
                continue
            if change.old is None:
                self.add_node(change.new)
            else:
                self.set_node(self.elements[change.new.name], change.old, change.new)
        for arc in fresh:
            self.add_arc(arc)

    def _alone(self, element: Any) -> Any:
        """The element of an arc. :raises _CannotHoldError: it is the element of another arc too."""
        if self.arcs_of(element) != 1:
            raise _CannotHoldError
        return element

    def _name_by_id(self) -> None:
        """Write the names of nodes that go by their ids, because others have the same name: it
        might be theirs alone soon."""
        for name, element in self.elements.items():
            shown = one_line(self.shown(element))
            if shown and shown != name:
                self.rename(element, name, name)

    @staticmethod
    def _take(wanted: Dict[Tuple[str, str, int, bool], int], arc: Arc) -> bool:
        left = wanted[_key(arc)]
        wanted[_key(arc)] = left - 1
        return left > 0

    # -- what the formats do differently ---------------------------------------------------------

    def set_node(self, element: Any, old: Node, new: Node) -> None:
        """Change what differs, but for the name."""
        raise NotImplementedError

    def rename(self, element: Any, old: str, new: str) -> None:
        """Give a node another name."""
        raise NotImplementedError

    def shown(self, element: Any) -> Optional[str]:
        """The name of a node, as it is written."""
        raise NotImplementedError

    def set_arc(self, element: Any, old: Arc, new: Arc) -> None:
        """Change the weight or the kind of an arc."""
        raise NotImplementedError

    def remove_node(self, element: Any) -> None:
        """Remove a node."""
        _remove(element)

    def add_node(self, node: Node) -> None:
        """Add a node."""
        kind = "place" if isinstance(node, Place) else "transition"
        element = self.given(kind, self.numbers[node])
        self.fresh(element, node.name)
        self.insert(element, kind)
        self.elements[node.name] = element

    def add_arc(self, arc: Arc) -> None:
        """Add an arc."""
        element = self.given("arc", self.numbers[arc])
        self.connect(element, arc)
        self.insert(element, "arc")

    def fresh(self, element: Any, name: str) -> None:
        """Give a new element what must differ from all others."""

    def connect(self, element: Any, arc: Arc) -> None:
        """Give a new arc its ends."""

    def given(self, kind: str, number: int) -> Any:
        """An element as the format writes it, for a document of this one's namespace."""
        if kind not in self._donors:
            root = parse_xml(self.donor_format.to_bytes(self.new))
            self._donors[kind] = list(root.iter("{*}" + kind))
        found = self._donors[kind][number]
        space = self.net.nsmap.get(self.net.prefix)
        return _in_namespace(found, space)

    def parent_of(self, kind: str) -> Any:
        """The element that holds nodes, or arcs."""
        return self.net

    def insert(self, element: Any, kind: str) -> None:
        """Put a new element behind the last of its kind."""
        if kind not in self._last:
            others = self.all(kind)
            self._last[kind] = others[-1] if others else None
        last = self._last[kind]
        if last is not None:
            _insert_after(last, element)
        else:
            _append(self.parent_of(kind), element)
        self._last[kind] = element
        self.used.add(element.get("id"))


def _in_namespace(element: Any, space: Optional[str]) -> Any:
    """A copy of an element, whose tags are in a namespace."""
    name = tag(element)
    spaces: Any = {None: space} if space else None
    made = etree.Element("{%s}%s" % (space, name) if space else name, nsmap=spaces)
    for key, value in element.items():
        made.set(key, value)
    made.text = element.text
    for inner in element:
        made.append(_in_namespace(inner, space))
    made.tail = None
    return made


def _remove(element: Any) -> None:
    """Remove an element with the space before it."""
    parent, previous, tail = element.getparent(), element.getprevious(), element.tail
    following = element.getnext()
    if following is None:  # what closes the parent stays behind the one before
        if previous is not None:
            previous.tail = tail
        else:
            parent.text = tail
    elif (tail or "").strip():
        if previous is not None:
            previous.tail = (previous.tail or "") + tail
        else:
            parent.text = (parent.text or "") + tail
    element.tail = None
    parent.remove(element)


def _insert_after(other: Any, element: Any) -> None:
    parent, previous = other.getparent(), other.getprevious()
    before = previous.tail if previous is not None else parent.text
    if before is not None and before.strip():
        before = None
    element.tail = other.tail
    other.tail = before
    parent.insert(parent.index(other) + 1, element)


def _append(parent: Any, element: Any) -> None:
    if len(parent):
        _insert_after(parent[-1], element)
        return
    closing = parent.tail if (parent.tail or "").strip() == "" else None
    parent.text = (closing + "  ") if closing and "\n" in closing else parent.text
    element.tail = closing if closing and "\n" in closing else None
    parent.append(element)


def _inner(element: Any, name: str, first: bool = False) -> Any:
    """The child of that name, which is made if there is none."""
    found = _child(element, name)
    if found is None:
        space = element.nsmap.get(element.prefix)
        found = etree.Element("{%s}%s" % (space, name) if space else name)
        if first:
            found.tail = element.text if len(element) else None
            element.insert(0, found)
        else:
            _append(element, found)
    return found


def _set_text(element: Any, outer: str, inner: str, text: str) -> None:
    _inner(_inner(element, outer), inner).text = text


def _set_position(element: Any, new: Node, first: bool) -> None:
    if new.position is None:
        graphics = _child(element, "graphics")
        if graphics is not None:
            for where in all_of(graphics, "position"):
                _remove(where)
        return
    where = _inner(_inner(element, "graphics", first), "position", True)
    where.set("x", number_text(new.position[0]))
    where.set("y", number_text(new.position[1]))


# -- PIPE ------------------------------------------------------------------------------------------


class _PipeNet(_XmlNet):
    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self._class = self._class_in_use()

    def all(self, kind: str) -> List[Any]:
        return all_of(self.net, kind)

    def set_node(self, element: Any, old: Node, new: Node) -> None:
        if old.position != new.position:
            _set_position(element, new, True)
        if isinstance(new, Place) and isinstance(old, Place):
            if old.tokens != new.tokens:
                self._count(element, "initialMarking", new.tokens)
            if old.capacity != new.capacity:
                self._count(element, "capacity", new.capacity or 0, plain=True)
            return
        assert isinstance(new, Transition) and isinstance(old, Transition)
        if new.timed and new.servers not in (None, 1):
            raise _CannotHoldError
        if old.timed != new.timed:
            _set_text(element, "timed", "value", "true" if new.timed else "false")
        value = new.rate if new.timed else new.weight
        if old.timed != new.timed or value != (old.rate if old.timed else old.weight):
            _set_text(element, "rate", "value", number_text(value))
            for specific in all_of(element, "toolspecific"):
                if specific.get("rateDefinition"):
                    specific.set("rateDefinition", number_text(value))
        if new.timed and (not old.timed or old.servers != new.servers):
            infinite = "true" if new.servers is None else "false"
            _set_text(element, "infiniteServer", "value", infinite)
        if not new.timed and (old.timed or old.priority != new.priority):
            _set_text(element, "priority", "value", str(new.priority))

    def _count(self, element: Any, name: str, count: int, plain: bool = False) -> None:
        """Set a number of tokens, as pairs of classes and numbers if it is written like that."""
        outer = _child(element, name)
        was = (outer is not None and _child(outer, "value") is not None) and (
            _child(outer, "value").text or ""
        ).strip()
        text = str(count)
        parts = [p.strip() for p in was.split(",")] if was else []
        if len(parts) > 1 and len(parts) % 2 == 0:
            used = [i for i in range(0, len(parts), 2) if parts[i + 1] not in ("", "0")]
            where = used[0] if used else 0
            for i in range(0, len(parts), 2):
                parts[i + 1] = str(count) if i == where else "0"
            text = ",".join(parts)
        elif not parts and not plain and self._classes():
            text = "%s,%d" % (self._classes()[0], count)
        _set_text(element, name, "value", text)

    def _classes(self) -> List[str]:
        """The classes of tokens that the document declares."""
        found = [*all_of(self.net, "token"), *all_of(self.net, "tokenclass")]
        return [_identifier(e) for e in found if e.get("id")]

    def shown(self, element: Any) -> Optional[str]:
        return label(element, "name", "value")

    def rename(self, element: Any, old: str, new: str) -> None:
        _set_text(element, "name", "value", new)
        identifier = element.get("id")
        if identifier == old and new not in self.used:
            element.set("id", new)
            self.used.add(new)
            for arc in self.all("arc"):
                for end in ("source", "target"):
                    if (arc.get(end) or "").strip() == old:
                        arc.set(end, new)

    def set_arc(self, element: Any, old: Arc, new: Arc) -> None:
        if old.weight != new.weight:
            self._count(element, "inscription", new.weight)
        if old.inhibitor != new.inhibitor:
            _set_kind(element, new.inhibitor)

    def fresh(self, element: Any, name: str) -> None:
        identifier, number = name, 1
        while identifier in self.used:
            number += 1
            identifier = "%s (%d)" % (name, number)
        element.set("id", identifier)
        self._in_class(element, "initialMarking")

    def connect(self, element: Any, arc: Arc) -> None:
        source, target = (_identifier(self.elements[name]) for name in (arc.source, arc.target))
        identifier, number = "%s to %s" % (source, target), 1
        while identifier in self.used:
            number += 1
            identifier = "%s to %s (%d)" % (source, target, number)
        element.set("id", identifier)
        element.set("source", source)
        element.set("target", target)
        self._in_class(element, "inscription")

    def _in_class(self, element: Any, name: str) -> None:
        """Write a number of tokens as this document does: of its class, or plain."""
        outer = _child(element, name)
        if outer is None:
            return
        value = _child(outer, "value")
        number = value.text.rpartition(",")[2]
        value.text = "%s,%s" % (self._class, number) if self._class else number

    def _class_in_use(self) -> str:
        plain = False
        for element in [*self.all("place"), *self.all("arc")]:
            for name in ("initialMarking", "inscription"):
                outer = _child(element, name)
                value = _child(outer, "value") if outer is not None else None
                parts = ((value.text or "") if value is not None else "").split(",")
                for cls, number in zip(parts[::2], parts[1::2]):
                    if number.strip() not in ("", "0"):
                        return cls.strip()
                plain = plain or parts[0].strip().isdigit()
        classes = self._classes()
        return "" if plain else classes[0] if classes else "Default"


def _identifier(element: Any) -> str:
    return str(element.get("id") or "").strip()


def _set_kind(element: Any, inhibitor: bool) -> None:
    """Make an arc a normal or an inhibitor arc, in the way in which the file says it."""
    word = "inhibitor" if inhibitor else "normal"
    for node in all_of(element, "arctype"):
        _inner(node, "text").text = word
    said = element.get("type")
    if said is not None:
        element.set("type", word)
    kinds = all_of(element, "type")
    for node in kinds:
        if node.get("value") is not None:
            node.set("value", word)
        for part in node:
            if tag(part) in ("text", "value"):
                part.text = word
    if said is None and not kinds and not all_of(element, "arctype"):
        _inner(element, "type").set("value", word)


# -- PNML ------------------------------------------------------------------------------------------


class _PnmlNet(_XmlNet):
    donor_format = pnml.FORMAT

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self._counted: Dict[str, int] = {}  # letter -> the number to try next

    def counts(self, element: Any) -> bool:
        return tag(element.getparent()) in ("net", "page")

    def arcs_of(self, element: Any) -> int:
        return 2 if arc_kind(element) == "test" else 1

    def parent_of(self, kind: str) -> Any:
        nodes = [*self.all("place"), *self.all("transition")]
        if nodes:
            return nodes[0].getparent()
        pages = all_of(self.net, "page")
        return pages[0] if pages else self.net

    def set_node(self, element: Any, old: Node, new: Node) -> None:
        if old.position != new.position:
            _set_position(element, new, False)
        if isinstance(new, Place) and isinstance(old, Place):
            if old.tokens != new.tokens:
                _set_text(element, "initialMarking", "text", str(new.tokens))
            if old.capacity != new.capacity:
                capacity = None if new.capacity is None else str(new.capacity)
                _set_property(element, pnml.OWN, "1.0", "capacity", capacity)
            return
        assert isinstance(new, Transition) and isinstance(old, Transition)
        if _meaning(old)[1:] == _meaning(new)[1:]:
            return
        if new.timed:
            self._set_timed(element, old, new)
        else:
            self._set_immediate(element, old, new)
        for delay in all_of(element, "delay"):
            if old.timed != new.timed:
                _remove(delay)

    def _set_timed(self, element: Any, old: Transition, new: Transition) -> None:
        stochastic = (pnml.STOCHASTIC, "0.2")
        if not old.timed or old.rate != new.rate:
            _set_property(element, *stochastic, "distributionType", "EXPONENTIAL")
            value = new.rate
            if _property(element, pnml.OWN, "parameter") != "rate":
                if old.timed or self._prom():
                    value = self._parameter(new.rate)
                else:
                    _set_property(element, pnml.OWN, "1.0", "parameter", "rate")
            _set_property(element, *stochastic, "distributionParameters", number_text(value))
        default = self.options.servers(1)
        if new.servers != (old.servers if old.timed else default):
            servers = "infinite" if new.servers is None else str(new.servers)
            _set_property(element, pnml.OWN, "1.0", "servers", servers)

    def _set_immediate(self, element: Any, old: Transition, new: Transition) -> None:
        stochastic = (pnml.STOCHASTIC, "0.2")
        if old.timed:
            _set_property(element, *stochastic, "distributionType", "IMMEDIATE")
        if old.timed or old.weight != new.weight:
            _set_property(element, *stochastic, "weight", number_text(new.weight))
        if old.timed or old.priority != new.priority:
            _set_property(element, *stochastic, "priority", str(new.priority))

    def _prom(self) -> bool:
        return any(
            e.get("tool") == pnml.STOCHASTIC and (len(e) or len(e.attrib) > 2)
            for e in all_of(self.net, "toolspecific")
        )

    def _parameter(self, rate: float) -> float:
        """The parameter that the file's tool has for a rate."""
        if not self._prom():
            return rate
        mean = 1.0 / rate
        for value in (mean, float(repr(mean))):
            if 1.0 / value == rate:
                return value
        raise _CannotHoldError

    def shown(self, element: Any) -> Optional[str]:
        return label(element, "name", "text")

    def rename(self, element: Any, old: str, new: str) -> None:
        _set_text(element, "name", "text", new)

    def set_arc(self, element: Any, old: Arc, new: Arc) -> None:
        if old.weight != new.weight:
            _set_text(element, "inscription", "text", str(new.weight))
        if old.inhibitor != new.inhibitor:
            _set_kind(element, new.inhibitor)

    def remove_node(self, element: Any) -> None:
        gone = [_identifier(element)]
        _remove(element)
        while gone:
            target = gone.pop()
            for kind in ("referencePlace", "referenceTransition"):
                for reference in list(self.net.iter("{*}" + kind)):
                    if reference.get("ref") == target:
                        gone.append(_identifier(reference))
                        _remove(reference)

    def fresh(self, element: Any, name: str) -> None:
        element.set("id", self._free("p" if tag(element) == "place" else "t"))

    def connect(self, element: Any, arc: Arc) -> None:
        element.set("id", self._free("a"))
        element.set("source", _identifier(self.elements[arc.source]))
        element.set("target", _identifier(self.elements[arc.target]))

    def _free(self, letter: str) -> str:
        number = self._counted.get(letter, 0)
        while "%s%d" % (letter, number) in self.used:
            number += 1
        self._counted[letter] = number + 1
        return "%s%d" % (letter, number)


def _property(element: Any, tool: str, key: str) -> Optional[str]:
    for node in all_of(element, "toolspecific"):
        if node.get("tool") == tool:
            for part in all_of(node, "property"):
                if part.get("key") == key:
                    return (part.text or "").strip()
            if node.get(key) is not None:
                return str(node.get(key))
    return None


def _set_property(element: Any, tool: str, version: str, key: str, value: Optional[str]) -> None:
    """Set a property in the data of a tool, where it is now; None: remove it."""
    nodes = [n for n in all_of(element, "toolspecific") if n.get("tool") == tool]
    for node in reversed(nodes):
        for part in reversed(all_of(node, "property")):
            if part.get("key") == key:
                if value is None:
                    _remove(part)
                else:
                    part.text = value
                return
        if node.get(key) is not None:
            if value is None:
                del node.attrib[key]
            else:
                node.set(key, value)
            return
    if value is None:
        return
    if nodes:
        node = nodes[-1]
    else:
        space = element.nsmap.get(element.prefix)
        node = etree.Element("{%s}toolspecific" % space if space else "toolspecific")
        node.set("tool", tool)
        node.set("version", version)
        _append(element, node)
    space = node.nsmap.get(node.prefix)
    made = etree.Element("{%s}property" % space if space else "property")
    made.set("key", key)
    made.text = value
    _append(node, made)


# -- PNPRO -----------------------------------------------------------------------------------------


class _PnproNet(_XmlNet):
    donor_format = pnpro.FORMAT

    def find_net(self) -> Any:
        nets = [self.root] if tag(self.root) == "gspn" else all_of(self.root, "gspn")
        return choose_net(nets, self.options.net, None)

    def change(self) -> None:
        if any(place.capacity is not None for place in self.new.places):
            raise _CannotHoldError
        super().change()

    def parent_of(self, kind: str) -> Any:
        return _inner(self.net, "edges" if kind == "arc" else "nodes")

    def set_node(self, element: Any, old: Node, new: Node) -> None:
        if isinstance(new, Place) and isinstance(old, Place):
            if old.tokens != new.tokens:
                element.set("marking", str(new.tokens))
            if old.position != new.position:
                _set_corner(element, new, "place")
            return
        assert isinstance(new, Transition) and isinstance(old, Transition)
        kind = "EXP" if new.timed else "IMM"
        if old.timed != new.timed:
            element.set("type", kind)
        if old.timed != new.timed or old.position != new.position:
            _set_corner(element, new, kind)
        if new.timed:
            if not old.timed or old.rate != new.rate:
                element.set("delay", number_text(new.rate))
            if not old.timed or old.servers != new.servers:
                element.set("nservers", "Infinite" if new.servers is None else str(new.servers))
            return
        if old.timed or old.weight != new.weight:
            element.set("weight", number_text(new.weight))
        if old.timed or old.priority != new.priority:
            element.set("priority", str(new.priority))

    def shown(self, element: Any) -> Optional[str]:
        return element.get("name")

    def rename(self, element: Any, old: str, new: str) -> None:
        element.set("name", new)
        for arc, drawn in self.arcs:
            if arc.source == old:
                drawn.set("tail", new)
            if arc.target == old:
                drawn.set("head", new)

    def set_arc(self, element: Any, old: Arc, new: Arc) -> None:
        if old.weight != new.weight:
            key = (
                "multiplicity"
                if element.get("mult") is None and element.get("multiplicity")
                else "mult"
            )
            element.set(key, str(new.weight))
        if old.inhibitor != new.inhibitor:
            key = "kind" if element.get("kind") or not element.get("type") else "type"
            element.set(key, "INHIBITOR" if new.inhibitor else "INPUT")


def _set_corner(element: Any, new: Node, kind: str) -> None:
    if new.position is None:
        for key in ("x", "y"):
            element.attrib.pop(key, None)
        return
    pnpro.write_position(element, new.position, kind)


def _update_tina(data: bytes, options: ReadOptions, old: Net, new: Net) -> bytes:
    mark = b"\xef\xbb\xbf" if data.startswith(b"\xef\xbb\xbf") else b""
    return mark + tina.update_text(data.decode("utf-8-sig"), old, new).encode("utf-8")


_UPDATES: Dict[str, Callable[[bytes, ReadOptions, Net, Net], bytes]] = {
    pipe.FORMAT.name: lambda *given: _update_xml(_PipeNet, *given),
    pnml.FORMAT.name: lambda *given: _update_xml(_PnmlNet, *given),
    pnpro.FORMAT.name: lambda *given: _update_xml(_PnproNet, *given),
    tina.FORMAT.name: _update_tina,
}
