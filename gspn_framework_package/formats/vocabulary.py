"""The elements and attributes that a reader of an XML format knows; anything else is refused.

Anything that a reader overlooks could change the net: an arc of an unknown kind, a guard, a time.
So each reader lists what it knows, and :func:`check_element` refuses the rest. Only parts of a
format that do not affect the net (graphics, names, data of one tool) are unrestricted.
"""

from __future__ import annotations

from typing import Dict, FrozenSet, Iterable, List, Mapping, NamedTuple, Optional, Protocol

from lxml import etree

from gspn_framework_package.formats.xml_tree import line_of, tag
from gspn_framework_package.model.expression import shorten

Children = Dict[str, List[etree._Element]]
"""The children of an element by their tags."""

ANY_CONTENT = None
"""Used instead of an :class:`Element`: any content is allowed, and does not affect the net."""

_EVERYWHERE = (
    "{http://www.w3.org/XML/1998/namespace}",
    "{http://www.w3.org/2001/XMLSchema-instance}",
)
"""Attributes of these namespaces (``xml:space``, ``xsi:schemaLocation``) do not affect the net."""


class Element(NamedTuple):
    """A reader's knowledge of an element.

    :ivar attributes: names of its attributes.
    :ivar children: tag -> vocabulary of the child; :data:`ANY_CONTENT` allows any content.
    :ivar repeated: children that may occur several times; a second one of any other child is
        refused, since the reader would overlook it.
    :ivar text: whether the element itself has text.
    :ivar positions: whether attributes that end in ``-x``, ``-y``, ``-k`` or ``-magnet`` are
        positions of labels in the drawing.
    """

    attributes: FrozenSet[str]
    children: Mapping[str, Optional[Element]] = {}
    repeated: FrozenSet[str] = frozenset()
    text: bool = False
    positions: bool = False


class _Fail(Protocol):
    def __call__(
        self, message: str, element: Optional[str], line: Optional[int], hint: Optional[str]
    ) -> None: ...


def known(
    attributes: str = "",
    children: Mapping[str, Optional[Element]] = {},
    *,
    free: str = "",
    repeated: str = "",
    text: bool = False,
    positions: bool = False,
) -> Element:
    """Create an :class:`Element` from words: ``known("id", free="name graphics")``."""
    inside: Dict[str, Optional[Element]] = dict.fromkeys(free.split(), ANY_CONTENT)
    inside.update(children)
    return Element(
        frozenset(attributes.split()),
        inside,
        frozenset((repeated + " " + free).split()),
        text,
        positions,
    )


def check_element(element: etree._Element, vocabulary: Element, what: str, fail: _Fail) -> Children:
    """Refuse anything in ``element`` and its descendants that its vocabulary does not have.

    :param what: name of the element in a message.
    :param fail: raises the error: (message, element, line, hint).
    :returns: the children by tag; a separate search for each tag would double the time.
    """
    children: Children = {}
    check_attributes(element, vocabulary, what, fail)
    text = element.text
    if text and not vocabulary.text and text.strip():
        fail(
            "the text '%s' must not be directly in <%s>" % (shorten(text), tag(element)),
            what,
            line_of(element),
            _words("expected ", vocabulary.children),
        )
    for node in element:
        name = tag(node)
        tail = node.tail
        if tail and tail.strip():
            fail(
                "the text '%s' must not be directly in <%s>" % (shorten(tail), tag(element)),
                what,
                line_of(node),
                "put the text into a separate element",
            )
        if name not in vocabulary.children:
            refuse_element(node, vocabulary, what, fail)
        if name not in children:
            children[name] = [node]
        elif name in vocabulary.repeated:
            children[name].append(node)
        else:
            fail("it has a second <%s>" % name, what, line_of(node), "keep only one of the two")
        inside = vocabulary.children[name]
        if inside is not ANY_CONTENT:
            check_element(node, inside, what, fail)
    return children


def check_attributes(element: etree._Element, vocabulary: Element, what: str, fail: _Fail) -> None:
    """Refuse attributes of ``element`` that its vocabulary does not have."""
    if vocabulary.attributes.issuperset(element.keys()):  # the usual case
        return
    for key, value in element.items():
        name = str(key)
        if name in vocabulary.attributes or name.startswith(_EVERYWHERE):
            continue
        if vocabulary.positions and name.endswith(("-x", "-y", "-k", "-magnet")):
            continue
        fail(
            'the attribute %s="%s" of <%s> is not known; it could change what the net means'
            % (shorten(name.rpartition("}")[2], 30), shorten(str(value), 30), tag(element)),
            what,
            line_of(element),
            _words("known here:", vocabulary.attributes),
        )


def refuse_element(element: etree._Element, vocabulary: Element, what: str, fail: _Fail) -> None:
    """Refuse an element that the vocabulary of its parent does not have."""
    fail(
        "a <%s> in it is not known; it could change what the net means" % shorten(tag(element), 40),
        what,
        line_of(element),
        _words("known here:", vocabulary.children),
    )


def _words(begin: str, names: Iterable[str]) -> str:
    return "%s %s" % (begin, ", ".join(sorted(names)) or "nothing")
