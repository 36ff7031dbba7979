"""Changes a net in its own XML document; the part common to all formats.

Only changed elements are modified in the tree of the document, and unchanged lines stay as they are
in the file, including annotations, the points of arcs, colours and the data of other tools.
``pipe_update``, ``pnml_update`` and ``pnpro_update`` implement the differences between the formats.
"""

from __future__ import annotations

import difflib
import re
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple, Type

from lxml import etree

from gspn_framework_package.formats.draft import ReadOptions, one_line
from gspn_framework_package.formats.format import CannotHoldError, Updater
from gspn_framework_package.formats.net_equality import Node
from gspn_framework_package.formats.xml_tree import (
    all_of,
    child,
    choose_net,
    number_text,
    parse_xml,
    tag,
    xml_parser,
)
from gspn_framework_package.model.net import Arc, Net, Place

_MANY_LINES = 3000
"""Number of lines above which files are compared by a faster method that finds fewer unchanged
lines."""

_PROLOGUE = re.compile(
    rb"(?:\xef\xbb\xbf)?(?:\s+|<\?.*?\?>|<!--.*?-->|<!DOCTYPE[^\[>]*(?:\[.*?\]\s*)?>)*", re.DOTALL
)


class _Change(NamedTuple):
    """A change of a node: it is new (``old`` is None), removed (``new`` is None) or changed."""

    old: Optional[Node]
    new: Optional[Node]


def _changes(old: Sequence[Node], new: Sequence[Node]) -> List[_Change]:
    """The changes of places or of transitions. A node at the position of another one in the list
    counts as the same node with a new name."""
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


class Given(NamedTuple):
    """The input for a change of an XML document."""

    root: Any
    """The root element, to be changed."""
    options: ReadOptions
    """How the document is read."""
    old: Net
    """The present net."""
    new: Net
    """The new net."""
    write: Callable[[Net], bytes]
    """The writer of the format, which supplies new elements."""


def xml_updater(kind: Type[XmlNet], write: Callable[[Net], bytes]) -> Updater:
    """Return a function that changes nets in XML documents, for the record of a format.

    :param kind: how the format writes a net.
    :param write: its writer.
    """

    def update(data: bytes, options: ReadOptions, old: Net, new: Net) -> bytes:
        root = _parse(data)
        before: Any = etree.tostring(
            root, encoding=root.getroottree().docinfo.encoding, with_tail=False
        )
        kind(Given(root, options, old, new, write)).change()
        return _serialised(root, data, before)

    return update


def _parse(data: bytes) -> Any:
    """The root of a document with all its comments, which :func:`parse_xml` accepts."""
    parse_xml(data)
    return etree.fromstring(data, xml_parser(strip_cdata=False))


def _serialised(root: Any, data: bytes, before: bytes) -> bytes:
    """The document, in which lines that have not changed are those of the file.

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
    """The lines of ``now``, with those that are also in ``before`` as in the file."""
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


class XmlNet:
    """A net in an XML document, whose elements correspond in order to those of the net read."""

    def __init__(self, given: Given) -> None:
        self.root, self.options, self.old, self.new, self.write = given
        old, new = self.old, self.new
        self.net = self.find_net()
        self.elements: Dict[str, Any] = {}
        both: Tuple[Tuple[str, Sequence[Node]], ...] = (
            ("place", old.places),
            ("transition", old.transitions),
        )
        for kind, nodes in both:
            found = self.all(kind)
            if len(found) != len(nodes):
                raise CannotHoldError
            self.elements.update((node.name, e) for node, e in zip(nodes, found))
        arcs = [e for e in self.all("arc") for _ in range(self.arcs_of(e))]
        if len(arcs) != len(old.arcs):
            raise CannotHoldError
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
        """All elements of a kind, in the order in which they are read."""
        return [e for e in self.net.iter("{*}" + kind) if self.counts(e)]

    def counts(self, element: Any) -> bool:
        """Whether an element with the tag of a node or arc represents one."""
        return True

    def arcs_of(self, element: Any) -> int:
        """The number of arcs that an element represents."""
        return 1

    def change(self) -> None:
        """Change the document to represent the new net."""
        changes = [
            *_changes(self.old.places, self.new.places),
            *_changes(self.old.transitions, self.new.transitions),
        ]
        if any(not c.old or not c.new or c.old.name != c.new.name for c in changes):
            self._name_by_id()
        # no node has the name "": arcs of a removed node must not be taken for those of a node that
        # takes its name
        names = {c.old.name: c.new.name if c.new else "" for c in changes if c.old}
        wanted: Dict[Arc, int] = {}
        for arc in self.new.arcs:
            wanted[arc] = wanted.get(arc, 0) + 1
        spare: List[Tuple[Arc, Any]] = []
        for arc, element in self.arcs:
            now = arc._replace(
                source=names.get(arc.source, arc.source), target=names.get(arc.target, arc.target)
            )
            if wanted.get(now):
                wanted[now] -= 1
            else:
                spare.append((now, element))
        added = [arc for arc in self.new.arcs if self._take(wanted, arc)]
        by_ends: Dict[Tuple[str, str], List[Tuple[Arc, Any]]] = {}
        for was, element in spare:
            by_ends.setdefault(was[:2], []).append((was, element))
        fresh = []
        for arc in added:  # another weight, kind or way: the same arc, changed
            there = by_ends.get(arc[:2])
            if there:
                was, element = there.pop(0)
                self.set_arc(self._alone(element), was, arc)
                if was.bends != arc.bends:
                    self._bend(element, arc)
            else:
                fresh.append(arc)
        for left in by_ends.values():
            for _, element in left:
                remove_element(self._alone(element))
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
        """The element of an arc. :raises CannotHoldError: it also represents another arc."""
        if self.arcs_of(element) != 1:
            raise CannotHoldError
        return element

    def _name_by_id(self) -> None:
        """Write names into nodes that are identified by id because of a duplicate name, since the
        duplicate may soon be gone."""
        for name, element in self.elements.items():
            shown = one_line(self.shown(element))
            if shown and shown != name:
                self.rename(element, name, name)

    @staticmethod
    def _take(wanted: Dict[Arc, int], arc: Arc) -> bool:
        left = wanted[arc]
        wanted[arc] = left - 1
        return left > 0

    def _bend(self, element: Any, new: Arc) -> None:
        """Draw an arc with the bends of a new one."""
        given = self.given("arc", self.numbers[new])
        for outer in self.BENDS[:-1]:
            element, given = inner_element(element, outer), inner_element(given, outer)
        for old in all_of(element, self.BENDS[-1]):
            remove_element(old)
        for bend in all_of(given, self.BENDS[-1]):
            append_element(element, bend)

    # -- differences between formats ---------------------------------------------------------

    BENDS: Tuple[str, ...] = ("graphics", "position")
    """The path of elements, inside that of an arc, to those of its bends."""

    def set_node(self, element: Any, old: Node, new: Node) -> None:
        """Change all differences except the name."""
        raise NotImplementedError

    def rename(self, element: Any, old: str, new: str) -> None:
        """Give a node another name."""
        raise NotImplementedError

    def shown(self, element: Any) -> Optional[str]:
        """The name of a node in written form."""
        raise NotImplementedError

    def set_arc(self, element: Any, old: Arc, new: Arc) -> None:
        """Change the weight or the kind of an arc."""
        raise NotImplementedError

    def remove_node(self, element: Any) -> None:
        """Remove a node."""
        remove_element(element)

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
        """Make the identifiers of a new element unique."""

    def connect(self, element: Any, arc: Arc) -> None:
        """Give a new arc its ends."""

    def given(self, kind: str, number: int) -> Any:
        """An element as written by the format, in this document's namespace."""
        if kind not in self._donors:
            root = parse_xml(self.write(self.new))
            self._donors[kind] = list(root.iter("{*}" + kind))
        found = self._donors[kind][number]
        space = self.net.nsmap.get(self.net.prefix)
        return _in_namespace(found, space)

    def parent_of(self, kind: str) -> Any:
        """The parent element of nodes or arcs."""
        return self.net

    def insert(self, element: Any, kind: str) -> None:
        """Insert a new element after the last of its kind."""
        if kind not in self._last:
            others = self.all(kind)
            self._last[kind] = others[-1] if others else None
        last = self._last[kind]
        if last is not None:
            _insert_after(last, element)
        else:
            append_element(self.parent_of(kind), element)
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


def remove_element(element: Any) -> None:
    """Remove an element with the preceding space."""
    parent, previous, tail = element.getparent(), element.getprevious(), element.tail
    following = element.getnext()
    if following is None:  # the space before the parent's end tag stays after the previous element
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


def append_element(parent: Any, element: Any) -> None:
    """Append an element, spaced like the previous ones."""
    if len(parent):
        _insert_after(parent[-1], element)
        return
    closing = parent.tail if (parent.tail or "").strip() == "" else None
    parent.text = (closing + "  ") if closing and "\n" in closing else parent.text
    element.tail = closing if closing and "\n" in closing else None
    parent.append(element)


def element_like(other: Any, name: str) -> Any:
    """A new element in the namespace of another one."""
    space = other.nsmap.get(other.prefix)
    return etree.Element("{%s}%s" % (space, name) if space else name)


def inner_element(element: Any, name: str, first: bool = False) -> Any:
    """The child of a name, which is created if necessary."""
    found = child_of(element, name)
    if found is None:
        found = element_like(element, name)
        if first:
            found.tail = element.text if len(element) else None
            element.insert(0, found)
        else:
            append_element(element, found)
    return found


def set_text(element: Any, outer: str, inner: str, text: str) -> None:
    """Set the text of the element ``inner`` in the element ``outer`` of an element."""
    inner_element(inner_element(element, outer), inner).text = text


def set_position(element: Any, new: Node, first: bool) -> None:
    """Set the position of a node; ``first``: whether a new ``graphics`` precedes the other
    parts."""
    if new.position is None:
        graphics = child_of(element, "graphics")
        if graphics is not None:
            for where in all_of(graphics, "position"):
                remove_element(where)
        return
    where = inner_element(inner_element(element, "graphics", first), "position", True)
    where.set("x", number_text(new.position[0]))
    where.set("y", number_text(new.position[1]))


def child_of(element: Any, name: str) -> Any:
    """As :func:`child`, for a child that must exist."""
    return child(element, name)


def identifier_of(element: Any) -> str:
    """The identifier of an element, as the arcs name it."""
    return str(element.get("id") or "").strip()


def set_arc_kind(element: Any, inhibitor: bool) -> None:
    """Make an arc a normal or an inhibitor arc, in the notation of the file."""
    word = "inhibitor" if inhibitor else "normal"
    for node in all_of(element, "arctype"):
        inner_element(node, "text").text = word
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
        inner_element(element, "type").set("value", word)
