"""Reads JSON files, with errors that name file and line, and formats JSON for people."""

from __future__ import annotations

import json
import math
import re
from typing import Any, Dict, List, NamedTuple, NoReturn, Optional, Sequence, Tuple, Union

from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.model.errors import InputError

KeyOrIndex = Union[str, int]
"""A step from an element to one inside it: a key or an index."""

_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\],:]|[^\s{}\[\],:"]+')
LINE_WIDTH = 100
"""Maximum length of a value written in one line."""

RECORD = 160
"""Maximum length of a list item written in one line: a node, an arc, a row."""

_ENCODE = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode
_UNUSUAL = re.compile(r"[0-9]{300}|[eE]\+?[0-9]{3}")  # a number may be too large
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")


class JsonDocument(NamedTuple):
    """A JSON document: its parsed ``data``, and its ``text`` to find the lines of elements."""

    data: Any
    text: str

    def line(self, path: Sequence[KeyOrIndex]) -> Optional[int]:
        """Return the line of the element at ``path`` (keys and indices); for a member of an object
        this is the line of its key."""
        wanted = [str(step) for step in path]
        # for each open bracket: whether it is an object; the current key or index
        inside: List[List[Any]] = []
        for match in _TOKEN.finditer(self.text):
            word = match.group()
            if word == ",":
                inside[-1][1] = None if inside[-1][0] else inside[-1][1] + 1
                continue
            if word in "]}":
                inside.pop()
                continue
            if word == ":":
                continue
            is_key = bool(inside) and inside[-1][0] and inside[-1][1] is None
            if is_key:
                inside[-1][1] = json.loads(word)
            if (is_key or not inside or not inside[-1][0]) and [
                str(step) for _, step in inside
            ] == wanted:
                return self.text.count("\n", 0, match.start()) + 1
            if word in "{[":
                inside.append([word == "{", None if word == "{" else 0])
        return None


def json_text(data: Any) -> str:
    """The text of a JSON file as people write one: see :func:`json_layout`; the members of the
    whole are on separate lines, however few they are."""
    return (_lines(data, "", "  ", "\n") if data and is_container(data) else _ENCODE(data)) + "\n"


def json_layout(
    value: Any, indent: str = "", unit: str = "  ", newline: str = "\n", width: int = LINE_WIDTH
) -> str:
    """Format a JSON value: in one line if it fits, otherwise with a line for each member.

    In a list of objects (nodes, arcs, rows, robots) each has its own line, so that a change to one
    gives a diff of one line. Lists of numbers are not split.

    :param indent: the indentation of the line in which the value begins.
    :param unit: the additional indentation of members.
    :param width: the maximum length of a one-line value, with its indentation.
    """
    flat = _ENCODE(value)
    if not value or not is_container(value):
        return flat
    if not has_records(value) and (len(indent) + len(flat) <= width or _is_row(value)):
        return flat
    return _lines(value, indent, unit, newline)


def is_container(value: Any) -> bool:
    """Whether a JSON value is an object or a list."""
    return isinstance(value, (dict, list, tuple))


def has_records(value: Any) -> bool:
    """Whether there is a list of several objects, or an object of several lists (groups), in a
    JSON value."""
    if isinstance(value, dict):
        members = value.values()
        lists = len(value) > 1 and all(isinstance(member, (list, tuple)) for member in members)
        return lists or any(map(has_records, members))
    if not isinstance(value, (list, tuple)):
        return False
    return sum(isinstance(item, dict) for item in value) > 1 or any(map(has_records, value))


def _is_row(value: Any) -> bool:
    """Whether a value is a list of numbers, such as the marking of a row of a policy, in which
    short texts such as "-", any number, may stand too."""
    return isinstance(value, (list, tuple)) and all(
        isinstance(item, (int, float)) or isinstance(item, str) and len(item) <= 4 for item in value
    )


def _lines(value: Any, indent: str, unit: str, newline: str) -> str:
    inside = indent + unit
    if isinstance(value, dict):
        ends = "{}"
        members = [
            "%s: %s" % (_ENCODE(str(key)), json_layout(member, inside, unit, newline))
            for key, member in value.items()
        ]
    else:
        ends, members = "[]", [json_layout(item, inside, unit, newline, RECORD) for item in value]
    space = newline + inside
    return ends[0] + space + ("," + space).join(members) + newline + indent + ends[1]


DEEPEST_JSON = 100
"""Maximum nesting depth of lists and objects; plans and logs need less than 20."""


TOO_DEEP = "it is nested too deeply"


def is_too_deep(data: Any) -> bool:
    """Whether a value of JSON is nested deeper than :data:`DEEPEST_JSON`: traversing it could
    exhaust the stack."""
    level = [data] if isinstance(data, (dict, list)) else []
    for _ in range(DEEPEST_JSON):
        level = [
            inner
            for value in level
            for inner in (value.values() if type(value) is dict else value)
            if type(inner) in (dict, list)
        ]
        if not level:
            return False
    return True


def read_json(path: str) -> Any:
    """Return the content of a JSON file; see :func:`read_document`."""
    return read_document(path).data


def read_document(path: str) -> JsonDocument:
    """Read a JSON file (UTF-8, with or without a byte order mark).

    :raises InputError: the file cannot be read, is not JSON, has an object with a duplicate key, or
        has a number or character that cannot be written back: NaN, 1e999, half a surrogate pair.
    """
    raw = read_bytes(path)
    try:
        text = raw.decode("utf-8-sig")
        unusual = _UNUSUAL.search(text) is not None
        data = json.loads(
            text,
            object_pairs_hook=_without_doubles,
            parse_constant=_refuse_number,
            parse_float=_finite if unusual else None,
            parse_int=_whole if unusual else None,
        )
        if _SURROGATE.search(text):
            json.dumps(data, ensure_ascii=False).encode("utf-8")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise InputError("it is not UTF-8 text", file=path, line=line) from None
    except UnicodeEncodeError as error:
        half = _SURROGATE.search(text)
        raise InputError(
            "a character that does not exist (%s)" % ascii(error.object[error.start]),
            file=path,
            line=text.count("\n", 0, half.start()) + 1 if half else None,
            hint="half of a surrogate pair: write the character itself",
        ) from None
    except json.JSONDecodeError as error:
        raise InputError(
            "it is not JSON: %s (column %d)" % (error.msg, error.colno),
            file=path,
            line=error.lineno,
        ) from None
    except RecursionError:
        raise InputError(TOO_DEEP, file=path) from None
    except _DoubleKeyError as error:
        raise InputError("the key '%s' occurs twice in one object" % error, file=path) from None
    except _NumberError as error:
        word = str(error)
        found = re.search(r"(?<![\w.+-])%s(?![\w.])" % re.escape(word), text)
        raise InputError(
            "%s is not a number that can be used"
            % (word if len(word) <= 40 else word[:30] + "..."),
            file=path,
            line=text.count("\n", 0, found.start()) + 1 if found else None,
        ) from None
    if is_too_deep(data):
        raise InputError(TOO_DEEP, file=path)
    return JsonDocument(data, text)


class _DoubleKeyError(ValueError):
    """Carries the duplicate key."""


class _NumberError(ValueError):
    """Carries the rejected number, as written."""


def _without_doubles(pairs: List[Tuple[str, Any]]) -> Dict[str, Any]:
    items = dict(pairs)
    if len(items) != len(pairs):
        keys = [key for key, _ in pairs]
        raise _DoubleKeyError(next(key for key in keys if keys.count(key) > 1))
    return items


def _refuse_number(word: str) -> NoReturn:
    raise _NumberError(word)


def _finite(word: str) -> float:
    value = float(word)
    if not math.isfinite(value):
        raise _NumberError(word)
    return value


def _whole(word: str) -> int:
    if len(word) > 300:  # far too large for any count
        raise _NumberError(word)
    return int(word)
