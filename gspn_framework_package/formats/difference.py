"""Compares two plans, as edited documents (see ``formats.edited_document``).

Nodes are identified by their names, arcs by their ends, robots by their names, rows of the policy
by what they match. So renaming a node counts as removing one node and adding another. An omitted
value equals its default.
"""

from __future__ import annotations

import json
from typing import (
    Any,
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Sequence,
    Tuple,
)

NODE_DEFAULTS: Mapping[str, Mapping[str, Any]] = {
    "place": {"tokens": 0},
    "transition": {"timed": False, "rate": 1, "weight": 1, "priority": 1, "servers": 1},
    "arc": {"weight": 1, "inhibitor": False},
}

_NET_LISTS = {"place": "places", "transition": "transitions", "arc": "arcs"}
_NAMING = {"name", "from", "to"}
_DRAWN = {"position", "bends"}


class DocumentChange(NamedTuple):
    """One change.

    :ivar what: added, removed or changed.
    :ivar kind: place, transition, arc, action, robot, row (of the policy), order (of a list), or
        setting: any other key of the plan.
    :ivar name: the name of the element; of an arc ``FROM>TO``; of a row what it matches, for
        example ``A: 1, B: 0``; of a setting its key.
    :ivar key: the key of the element that changed, or the member of a setting; "" for the whole.
    :ivar old: the old value; None if there was none.
    :ivar new: the new value, likewise.
    """

    what: str
    kind: str
    name: str
    key: str
    old: Any
    new: Any

    def to_json(self) -> Dict[str, Any]:
        """Convert to a JSON object."""
        data = self._asdict()
        data["from"], data["to"] = data.pop("old"), data.pop("new")
        return dict(data)

    def __str__(self) -> str:
        kind = "policy row" if self.kind == "row" else self.kind
        name = self.name.replace(">", " -> ") if self.kind == "arc" else self.name
        what = "%s %s%s" % (kind, name, ", " + self.key if self.key else "")
        if self.kind == "order":
            return "~ the order of the %s" % self.name
        if self.what == "changed":
            return "~ %s: %s -> %s" % (what, _text(self.old), _text(self.new))
        sign, value = ("+", self.new) if self.what == "added" else ("-", self.old)
        inside = value.get("choose") if self.kind == "row" else value
        if self.kind in _NET_LISTS and isinstance(value, Mapping):
            inside = {k: v for k, v in value.items() if k not in _NAMING | _DRAWN}
        return "%s %s%s" % (sign, what, ": " + _text(inside) if inside not in ({}, None) else "")


def _text(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 120 else text[:90] + " ... " + text[-25:]


def document_difference(
    old: Mapping[str, Any], new: Mapping[str, Any], positions: bool = True
) -> List[DocumentChange]:
    """Return the changes that turn the old document into the new one.

    :param old: an edited document. It may be incomplete: malformed parts are compared as a whole.
    :param new: another edited document.
    :param positions: whether what only moved in the drawing counts as changed.
    """
    changes = [
        *_net(_object(old.get("net")), _object(new.get("net")), positions),
        *_plan(_object(old.get("plan")), _object(new.get("plan"))),
        *_policy(_object(old.get("policy")), _object(new.get("policy"))),
    ]
    if isinstance(old.get("policy"), dict) != isinstance(new.get("policy"), dict) and not any(
        change.kind == "row" or change.name == "policy" for change in changes
    ):
        changes += _value("setting", "policy", "", old.get("policy"), new.get("policy"))
    return changes


def _object(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _same(old: Any, new: Any) -> bool:
    """Whether two JSON values are equal; in Python, True is equal to 1, in JSON it is not."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        return old.keys() == new.keys() and all(_same(old[key], new[key]) for key in old)
    if isinstance(old, (list, tuple)) and isinstance(new, (list, tuple)):
        return len(old) == len(new) and all(map(_same, old, new))
    return isinstance(old, bool) == isinstance(new, bool) and bool(old == new)


_MISSING = object()


def _value(kind: str, name: str, key: str, old: Any, new: Any) -> Iterator[DocumentChange]:
    """The change of one value, if it has changed; ``_MISSING`` (or None) if there is none."""
    before, after = (None if v is _MISSING else v for v in (old, new))
    if _same(before, after):
        return
    what = "added" if before is None else "removed" if after is None else "changed"
    yield DocumentChange(what, kind, name, key, before, after)


# -- the net ---------------------------------------------------------------------------------------


def _net(
    old: Mapping[str, Any], new: Mapping[str, Any], positions: bool
) -> Iterator[DocumentChange]:
    for kind, key in _NET_LISTS.items():
        yield from _elements(kind, key, old.get(key), new.get(key), positions)
    for key in _keys(old, new):
        if key not in _NET_LISTS.values():
            yield from _value("setting", "net", key, old.get(key), new.get(key))


def _elements(
    kind: str, plural: str, old: Any, new: Any, positions: bool
) -> Iterator[DocumentChange]:
    before, after = _named(kind, old), _named(kind, new)
    ignored = _NAMING if positions else _NAMING | _DRAWN
    defaults = NODE_DEFAULTS[kind]

    def values(was: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[_Pair]:
        for key in _keys(was, now):
            if key not in ignored:
                default = defaults.get(key)
                yield key, was.get(key, default), now.get(key, default)

    yield from _compared(kind, before, after, values)
    yield from _order(plural, list(before), list(after))


_Key = Tuple[Any, ...]
"""What identifies an element: its name, and what distinguishes it from others of that name."""

_Pair = Tuple[str, Any, Any]
"""A key of an element, with its old and its new value."""


def _compared(
    kind: str,
    before: Mapping[_Key, Any],
    after: Mapping[_Key, Any],
    values: Callable[[Any, Any], Iterable[_Pair]],
) -> Iterator[DocumentChange]:
    """The elements that were removed, changed and added.

    :param values: the values of an element to compare.
    """
    for name, element in before.items():
        if name not in after:
            yield DocumentChange("removed", kind, name[0], "", element, None)
            continue
        for key, was, now in values(element, after[name]):
            if not _same(was, now):
                yield DocumentChange("changed", kind, name[0], key, was, now)
    for name, element in after.items():
        if name not in before:
            yield DocumentChange("added", kind, name[0], "", None, element)


def _order(plural: str, before: Sequence[Any], after: Sequence[Any]) -> Iterator[DocumentChange]:
    """The change in the order of elements that are in both lists, if any. The order of the arcs
    determines which robot goes where, that of the rows which one takes precedence."""
    old, new = set(before), set(after)
    was, now = [k for k in before if k in new], [k for k in after if k in old]
    if was != now:
        yield DocumentChange(
            "changed", "order", plural, "", [k[0] for k in was], [k[0] for k in now]
        )


def _named(kind: str, elements: Any) -> Dict[_Key, Mapping[str, Any]]:
    """The elements of a list of the net by their identity; duplicates are also numbered."""
    found: Dict[_Key, Mapping[str, Any]] = {}
    for element in elements if isinstance(elements, list) else ():
        if not isinstance(element, Mapping):
            continue
        if kind == "arc":
            ends = "%s>%s" % (element.get("from"), element.get("to"))
            _put(found, (ends, bool(element.get("inhibitor"))), element)
        else:
            _put(found, (str(element.get("name")),), element)
    return found


def _put(found: Dict[_Key, Mapping[str, Any]], key: _Key, value: Mapping[str, Any]) -> None:
    number, whole = 1, key
    while whole in found:
        number += 1
        whole = (*key, number)
    found[whole] = value


def _keys(old: Mapping[str, Any], new: Mapping[str, Any]) -> List[str]:
    return list({**dict.fromkeys(old), **dict.fromkeys(new)})


# -- the plan --------------------------------------------------------------------------------------


def _plan(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[DocumentChange]:
    # an action may be null, which is a value too
    before, after = (
        {(place,): action for place, action in _object(plan.get("actions")).items()}
        for plan in (old, new)
    )
    yield from _compared("action", before, after, lambda was, now: [("", was, now)])
    yield from _compared("robot", _team(old.get("robots")), _team(new.get("robots")), _of_robot)
    for key in _keys(old, new):
        was, now = old.get(key, _MISSING), new.get(key, _MISSING)
        if key in ("actions", "robots"):
            readable = (Mapping,) if key == "actions" else (Mapping, list)
            if not all(v is _MISSING or isinstance(v, readable) for v in (was, now)):
                yield from _value("setting", key, "", was, now)
        elif isinstance(was, Mapping) and isinstance(now, Mapping):
            for member in _keys(was, now):
                yield from _value(
                    "setting", key, member, was.get(member, _MISSING), now.get(member, _MISSING)
                )
        else:
            yield from _value("setting", key, "", was, now)


def _of_robot(was: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[_Pair]:
    for key in _keys(was, now):
        default: Any = {} if key == "actions" else None
        yield key, was.get(key, default), now.get(key, default)


def _team(robots: Any) -> Dict[_Key, Mapping[str, Any]]:
    """The robots of a plan by name, in either of the two forms."""
    if isinstance(robots, Mapping):
        return {(str(name),): {"place": place} for name, place in robots.items()}
    return {
        (str(robot.get("name")),): {key: value for key, value in robot.items() if key != "name"}
        for robot in (robots if isinstance(robots, list) else ())
        if isinstance(robot, Mapping)
    }


# -- the policy ------------------------------------------------------------------------------------


def _policy(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[DocumentChange]:
    before, after = _rows(old), _rows(new)
    yield from _compared(
        "row", before, after, lambda was, now: [("choose", was.get("choose"), now.get("choose"))]
    )
    yield from _order("rows of the policy", list(before), list(after))
    columns = [
        sorted(map(str, p)) if isinstance(p, list) else p
        for p in (old.get("places"), new.get("places"))
    ]
    if not _same(*columns):
        yield from _value("setting", "policy", "places", old.get("places"), new.get("places"))
    for other in _keys(old, new):
        if other not in ("places", "rows"):
            yield from _value("setting", "policy", other, old.get(other), new.get(other))


def _rows(policy: Mapping[str, Any]) -> Dict[_Key, Mapping[str, Any]]:
    """The rows of a policy by what they match, regardless of the order of its places."""
    places = policy.get("places")
    names = [str(p) for p in places] if isinstance(places, list) else []
    rows = policy.get("rows")
    found: Dict[_Key, Mapping[str, Any]] = {}
    for number, row in enumerate(rows if isinstance(rows, list) else (), 1):
        if not isinstance(row, Mapping):
            continue
        cells = row.get("marking")
        counts = [str(c).strip() for c in (cells if isinstance(cells, list) else ())]
        counted = sorted((p, c) for p, c in zip(names, counts) if c != "-")
        matches = ", ".join("%s: %s" % item for item in counted) or "any marking"
        _put(found, (matches,), {"row": number, **row})
    return found
