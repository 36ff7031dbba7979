"""Changing a JSON file without touching the rest of its text.

Unchanged values keep their text: the order of keys, the spelling of numbers, line breaks and
spaces. Only changes are rewritten. A value that no longer fits in one line gets a line for each
member.
"""

from __future__ import annotations

import json
import re
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.formats.json_file import (
    LINE_WIDTH,
    RECORD,
    has_records,
    is_container,
    json_layout,
)

_SPACE = re.compile(r"[ \t\r\n]*")
_SCAN = json.JSONDecoder().raw_decode


class _Part(NamedTuple):
    """A member of an object or array: its key (None in an array), its value, where it begins (with
    its key), where its value begins and ends, and the space before it and before its comma."""

    key: Optional[str]
    value: Any
    begin: int
    start: int
    end: int
    before: str
    after: str


def same(old: Any, new: Any) -> bool:
    """Whether two JSON values are equivalent: numbers are compared as in a browser, and the order
    of keys does not matter."""
    if isinstance(old, bool) or isinstance(new, bool):
        return old is new
    if isinstance(old, (int, float)) and isinstance(new, (int, float)):
        return old == new or _float(old) == _float(new)
    if isinstance(old, dict) and isinstance(new, dict):
        return old.keys() == new.keys() and all(same(v, new[k]) for k, v in old.items())
    if isinstance(old, list) and isinstance(new, list):
        return len(old) == len(new) and all(map(same, old, new))
    return type(old) is type(new) and bool(old == new)


def _float(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:
        return float("inf")


def update_json(text: str, new: Any, ordered: Sequence[str] = ()) -> str:
    """Return the text of a JSON file with the content ``new``.

    :param text: the file, which is JSON.
    :param ordered: keys of the outermost object whose values are objects with significant key
        order.
    """
    start = _skip(text, 1 if text[:1] == "\ufeff" else 0)
    old, end = _SCAN(text, start)
    changed = _Update(text, ordered).value(start, end, old, new, "", 0)
    return text[:start] + changed + text[end:]


def _skip(text: str, at: int) -> int:
    found = _SPACE.match(text, at)
    return found.end() if found else at


class _Update:
    def __init__(self, text: str, ordered: Sequence[str]) -> None:
        self.text = text
        self.ordered = ordered
        self.line = "\r\n" if "\r\n" in text else "\n"
        found = re.match(r"\s*[{\[][ \t]*\r?\n([ \t]+)", text)
        self.unit = found.group(1) if found else "  "

    def value(
        self, start: int, end: int, old: Any, new: Any, indent: Optional[str], depth: int
    ) -> str:
        """Return the new text of the value that spans ``start`` to ``end``.

        :param indent: the indentation of its line; None to keep it in one line.
        """
        text = self.text[start:end]
        if same(old, new) and not (depth == 0 and self._reordered(old, new)):
            return text
        if type(old) is not type(new) or not is_container(old):
            return self.written(new, indent)
        broken = "\n" in text
        inner = indent if broken else None
        parts = list(self._parts(start, isinstance(old, dict)))
        if isinstance(old, dict):
            changed = self._object(start, end, parts, new, inner, depth)
        else:
            changed = self._array(start, end, parts, new, inner)
        if indent is None or broken or self._stays(text, changed, old, new, indent):
            return changed
        return json_layout(json.loads(changed), indent, self.unit, self.line)

    @staticmethod
    def _stays(text: str, changed: str, old: Any, new: Any, indent: str) -> bool:
        """Whether a one-line value stays in one line: if it fits, or if it did not fit before
        either and has no parts that could have separate lines."""
        if len(indent) + len(changed) <= LINE_WIDTH:
            return has_records(old) or not has_records(new)
        return len(indent) + len(text) > LINE_WIDTH and not any(map(is_container, _members(new)))

    def _reordered(self, old: Any, new: Any) -> bool:
        return any(self._order_differs(old, new, key) for key in self.ordered)

    def _order_differs(self, old: Any, new: Any, key: str) -> bool:
        if not isinstance(old, dict) or not isinstance(new, dict):
            return False
        ours, theirs = old.get(key), new.get(key)
        return (
            isinstance(ours, dict)
            and isinstance(theirs, dict)
            and [k for k in ours if k in theirs] != [k for k in theirs if k in ours]
        )

    def _parts(self, start: int, is_object: bool) -> Iterator[_Part]:
        """The members of the object or array that begins at ``start``."""
        text, at = self.text, start + 1
        while True:
            begin = _skip(text, at)
            if text[begin] in "}]":
                return
            key, value_at = None, begin
            if is_object:
                key, colon = _SCAN(text, begin)
                value_at = _skip(text, _skip(text, colon) + 1)
            value, end = _SCAN(text, value_at)
            comma = _skip(text, end)
            last = text[comma] != ","
            after = "" if last else text[end:comma]
            yield _Part(key, value, begin, value_at, end, text[at:begin], after)
            if last:
                return
            at = comma + 1

    def _object(
        self,
        start: int,
        end: int,
        parts: List[_Part],
        new: Dict[str, Any],
        indent: Optional[str],
        depth: int,
    ) -> str:
        known = {part.key: part for part in parts}
        order = [part.key for part in parts if part.key in new]
        before: Optional[str] = None
        for key in new:
            if key not in known:
                order.insert(order.index(before) + 1 if before is not None else 0, key)
            before = key
        if not order:
            return "{}"
        inside = self._inside(parts, indent)
        colon = ": "
        if parts:
            first = parts[0]
            _, quoted = _SCAN(self.text, first.begin)
            colon = self.text[quoted : first.start]
        pieces = []
        for key in order:
            part = known.get(key)
            if part is None:
                text = json.dumps(key, ensure_ascii=False) + colon + self.written(new[key], inside)
            else:
                text = self.text[part.begin : part.start]
                old, value = part.value, new[key]
                is_ordered = depth == 0 and key in self.ordered
                if is_ordered and self._order_differs({key: old}, {key: value}, key):
                    text += self.written(value, inside)
                else:
                    text += self.value(part.start, part.end, old, value, inside, depth + 1)
            pieces.append((part, text))
        return "{%s}" % self._joined(start, end, parts, pieces, indent)

    def _array(
        self, start: int, end: int, parts: List[_Part], new: List[Any], indent: Optional[str]
    ) -> str:
        if not new:
            return "[]"
        inside = self._inside(parts, indent)
        pieces: List[Tuple[Optional[_Part], str]] = []
        for part, value in zip(_partners(parts, new), new):
            if part is None:
                pieces.append((part, self.written(value, inside, RECORD)))
            else:
                # items that fill one line stay that way: nodes, arcs, rows
                deeper = inside if "\n" in self.text[part.start : part.end] else None
                text = self.value(part.start, part.end, part.value, value, deeper, 1)
                pieces.append((part, text))
        return "[%s]" % self._joined(start, end, parts, pieces, indent)

    def _inside(self, parts: List[_Part], indent: Optional[str]) -> Optional[str]:
        if indent is not None and parts and "\n" in parts[0].before:
            return parts[0].before.rpartition("\n")[2]
        return None if indent is None else indent + self.unit

    def _joined(
        self,
        start: int,
        end: int,
        parts: List[_Part],
        pieces: Sequence[Tuple[Optional[_Part], str]],
        indent: Optional[str],
    ) -> str:
        """Join the members with the space between them, as in the file."""
        if parts:
            lead, tail = parts[0].before, self.text[parts[-1].end : end - 1]
            between = parts[1].before if len(parts) > 1 else lead if "\n" in lead else " "
        else:
            lead, between, tail = "", " ", ""
            if indent is not None:
                lead = between = self.line + indent + self.unit
                tail = self.line + indent
        found = []
        for number, (part, text) in enumerate(pieces):
            if number == 0:
                space = lead
            else:
                space = part.before if part is not None and part is not parts[0] else between
            after = part.after if part is not None and number < len(pieces) - 1 else ""
            found.append(space + text + after)
        return ",".join(found) + tail

    def written(self, value: Any, indent: Optional[str], width: int = LINE_WIDTH) -> str:
        """Format a new value."""
        if indent is None:
            return json.dumps(value, ensure_ascii=False, allow_nan=False)
        return json_layout(value, indent, self.unit, self.line, width)


def _members(value: Any) -> Sequence[Any]:
    return list(value.values()) if isinstance(value, dict) else value


def _partners(parts: List[_Part], new: List[Any]) -> List[Optional[_Part]]:
    """For each new item, the old one that it replaces: an equal one, one with the same name, or, if
    equally many remain on both sides, the one at the same position."""
    found: List[Optional[_Part]] = [None] * len(new)
    left = list(parts)
    for identity in (_content, _identity):
        free: Dict[Any, List[_Part]] = {}
        for part in left:
            free.setdefault(identity(part.value), []).append(part)
        for waiting in free.values():
            waiting.reverse()
        for number, value in enumerate(new):
            if found[number] is None:
                key = identity(value)
                if key is not None and free.get(key):
                    found[number] = free[key].pop()
        taken = {id(part) for part in found if part is not None}
        left = [part for part in left if id(part) not in taken]
    open_places = [number for number, part in enumerate(found) if part is None]
    if len(open_places) == len(left):
        for number, part in zip(open_places, left):
            found[number] = part
    return found


def _content(value: Any) -> Any:
    """A key that is equal for exactly those values that :func:`same` considers equal."""
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return (type(value).__name__, value)
    if isinstance(value, (int, float)):
        return ("number", _float(value))
    if isinstance(value, dict):
        return ("object", frozenset((key, _content(member)) for key, member in value.items()))
    return ("array", tuple(map(_content, value)))


def _identity(value: Any) -> Any:
    """The identity of an item in an array: the name of a node or robot, the ends of an arc, the
    marking of a row."""
    if not isinstance(value, dict):
        return None
    for keys in (("name",), ("from", "to", "inhibitor"), ("marking",)):
        if keys[0] in value:
            return _content([value.get(key) for key in keys])
    return None
