"""Reads YAML (and so JSON) as plain data, with the line numbers of its elements; errors name file
and line.

PyYAML's safe loader only builds plain data. In addition, this module rejects duplicate keys, and
aliases that would expand endlessly, or to far more than anyone writes by hand.
"""

from __future__ import annotations

import re
import sys
from typing import Any, Dict, Iterable, Optional, Set, Tuple, Union

import yaml

from gspn_framework_package.formats.json_file import KeyOrIndex
from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.model.errors import InputError

MOST_ELEMENTS = 200_000
"""Default maximum number of elements; elements behind aliases count each time."""

MOST_LEVELS = 100
"""Maximum nesting depth of mappings and lists."""

_MERGE = "tag:yaml.org,2002:merge"  # the tag of the key <<
_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def is_finite_number(value: Any) -> bool:
    """Whether a value is a number that a float can hold; in YAML, ``.nan`` and ``.inf`` are written
    like numbers, too."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_number and abs(value) <= sys.float_info.max


class _Loader(_SafeLoader):
    """Also reads 1e-05 as a number, as in JSON."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)


class YamlDocument:
    """A YAML text: its ``data`` as plain Python objects.

    :param text: one YAML document; bytes are UTF-8 or UTF-16.
    :param file: the name for error messages.
    :param limit: largest number of elements.
    :raises InputError: it is not YAML, is empty, repeats a key in a mapping, holds more than plain
        data, or expands too far.
    """

    def __init__(
        self, text: Union[str, bytes], file: Optional[str] = None, limit: int = MOST_ELEMENTS
    ) -> None:
        self.file = file
        self._limit = limit
        loader = None
        try:
            self._check_size(text)
            loader = _Loader(text)
            self._root: Optional[yaml.Node] = loader.get_single_node()
            if self._root is None:
                raise InputError("the file is empty", file=file)
            self._check(loader)
            self.data: Any = loader.construct_document(self._root)
        except yaml.MarkedYAMLError as error:
            raise self._not_yaml(error, _line_of(text, len(text))) from None
        except yaml.reader.ReaderError as error:
            raise InputError(
                "it is not YAML: the character #x%04x" % error.character,
                file=file,
                line=_line_of(text, error.position),
            ) from None
        finally:
            if loader is not None:
                loader.dispose()

    def _check_size(self, text: Union[str, bytes]) -> None:
        """Refuse deep nesting and large texts by their events, before nodes are composed: composing
        takes longer, and recurses, which in the C library can end the process."""
        depth = elements = 0
        events: Any = yaml.parse(text, Loader=_Loader)
        for event in events:
            line = getattr(event.start_mark, "line", 0) + 1
            elements += isinstance(event, yaml.NodeEvent)
            if elements > self._limit:
                raise self._too_large(line)
            if isinstance(event, (yaml.MappingStartEvent, yaml.SequenceStartEvent)):
                depth += 1
                if depth > MOST_LEVELS:
                    raise InputError("it is nested too deeply", file=self.file, line=line)
            elif isinstance(event, (yaml.MappingEndEvent, yaml.SequenceEndEvent)):
                depth -= 1

    def _too_large(self, line: int) -> InputError:
        return InputError(
            "it has more than %d elements" % self._limit,
            file=self.file,
            line=line,
            hint="use a smaller part of it",
        )

    def _not_yaml(self, error: yaml.MarkedYAMLError, last: int) -> InputError:
        mark = error.problem_mark or error.context_mark
        line = min(mark.line + 1, last) if mark is not None else None
        tag = re.match("could not determine a constructor for the tag '(.*)'", error.problem or "")
        if tag:
            name = tag.group(1).replace("tag:yaml.org,2002:", "!!")
            return InputError(
                "an element with the tag '%.60s' is not plain data" % name,
                file=self.file,
                line=line,
                hint="write the element without the tag",
            )
        words = [word for word in (error.context, error.problem) if word]
        return InputError("it is not YAML: %s" % ", ".join(words), file=self.file, line=line)

    def _check(self, loader: Any) -> None:
        sizes: Dict[int, int] = {}
        open_: Set[int] = set()

        def size(node: yaml.Node) -> int:
            line = node.start_mark.line + 1
            if id(node) in open_:
                raise InputError("an alias that contains itself", file=self.file, line=line)
            if id(node) in sizes:
                return sizes[id(node)]
            open_.add(id(node))
            total = 1
            if isinstance(node, yaml.MappingNode):
                self._refuse_doubles(node)
                total += sum(size(key) + size(value) for key, value in node.value)
            elif isinstance(node, yaml.SequenceNode):
                total += sum(size(child) for child in node.value)
            elif node.tag != _MERGE:
                try:
                    loader.construct_object(node)
                except ValueError:
                    raise InputError(
                        "it is not YAML: '%.40s' is not a value of its kind" % node.value,
                        file=self.file,
                        line=line,
                    ) from None
            if total > self._limit:
                raise self._too_large(line)
            open_.discard(id(node))
            sizes[id(node)] = total
            return total

        assert self._root is not None
        size(self._root)

    def _refuse_doubles(self, node: yaml.MappingNode) -> None:
        seen: Set[Tuple[str, str]] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == _MERGE:
                continue
            if (key.tag, key.value) in seen:
                line = key.start_mark.line + 1
                raise InputError("the key '%s' occurs twice" % key.value, file=self.file, line=line)
            seen.add((key.tag, key.value))

    def line(self, path: Iterable[KeyOrIndex], key: Optional[str] = None) -> int:
        """The line of the element at ``path``, or of the nearest enclosing one that exists.

        :param path: keys and indices.
        :param key: a key of that element, to get the line of the key instead.
        """
        node = self._root
        assert node is not None
        line = node.start_mark.line + 1
        for step in path:
            child = None
            if isinstance(node, yaml.MappingNode):
                child = next((value for name, value in node.value if name.value == str(step)), None)
            elif isinstance(node, yaml.SequenceNode) and isinstance(step, int):
                child = node.value[step] if step < len(node.value) else None
            if child is None:
                return int(line)
            node, line = child, child.start_mark.line + 1
        if key is not None and isinstance(node, yaml.MappingNode):
            line = next(
                (name.start_mark.line + 1 for name, _ in node.value if name.value == key), line
            )
        return int(line)

    def error(self, message: str, path: Iterable[KeyOrIndex], hint: str = "") -> InputError:
        """Return the error for the element at ``path``, with file, line and element."""
        steps = list(path)
        return InputError(
            message,
            file=self.file,
            line=self.line(steps),
            element=path_text(steps) or None,
            hint=hint or None,
        )


def read_yaml(path: str) -> YamlDocument:
    """Read a YAML file.

    :raises InputError: it cannot be read, or as :class:`YamlDocument`.
    """
    return YamlDocument(read_bytes(path), path)


def _line_of(text: Union[str, bytes], position: int) -> int:
    before = text[:position]
    return 1 + (before.count("\n") if isinstance(before, str) else before.count(b"\n"))


def path_text(path: Iterable[KeyOrIndex]) -> str:
    """A path as text: ``locations.L1.bay[2]``."""
    text = ""
    for step in path:
        text += "[%d]" % step if isinstance(step, int) else ("." if text else "") + str(step)
    return text
