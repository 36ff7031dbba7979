"""Reading of JSON files, with errors that name file and line."""

from __future__ import annotations

import json
import math
import re
from typing import Any, Dict, List, NamedTuple, NoReturn, Optional, Sequence, Tuple, Union

from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.model.errors import InputError

Step = Union[str, int]
"""A step from an element to one inside it: a key or an index."""

_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\],:]|[^\s{}\[\],:"]+')
_UNUSUAL = re.compile(r"[0-9]{300}|[eE]\+?[0-9]{3}")  # a number may be too large
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")


class JsonDocument(NamedTuple):
    """A JSON document: its parsed ``data``, and its ``text`` to find the lines of elements."""

    data: Any
    text: str

    def line(self, path: Sequence[Step]) -> Optional[int]:
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
        raise InputError("it is nested too deeply", file=path) from None
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
