"""JSON files, with errors that tell file and line."""

from __future__ import annotations

import json
from typing import Any, Dict, List, Tuple

from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.model.errors import InputError


def read_json(path: str) -> Any:
    """The content of a JSON file (UTF-8, with or without a byte order mark).

    :raises InputError: it cannot be read, is not JSON, or an object has one key twice.
    """
    data = read_bytes(path)
    try:
        return json.loads(data.decode("utf-8-sig"), object_pairs_hook=_without_doubles)
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise InputError("it is not UTF-8 text", file=path, line=line) from None
    except json.JSONDecodeError as error:
        raise InputError(
            "it is not JSON: %s (column %d)" % (error.msg, error.colno),
            file=path,
            line=error.lineno,
        ) from None
    except RecursionError:
        raise InputError("it is nested too deeply", file=path) from None
    except _DoubleKeyError as error:
        raise InputError("the key '%s' stands twice in one object" % error, file=path) from None


class _DoubleKeyError(ValueError):
    """Carries the key."""


def _without_doubles(pairs: List[Tuple[str, Any]]) -> Dict[str, Any]:
    items = dict(pairs)
    if len(items) != len(pairs):
        keys = [key for key, _ in pairs]
        raise _DoubleKeyError(next(key for key in keys if keys.count(key) > 1))
    return items
