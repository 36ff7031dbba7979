"""Reads YAML texts as plain data, with the line numbers of their elements; errors name file and
line.

PyYAML's safe loader only builds plain data. In addition, this module rejects duplicate keys, and
aliases that would expand endlessly, or into far more than anyone writes by hand.
"""

from __future__ import annotations

from typing import Any, Dict, Iterable, Optional, Set, Tuple, Union

import yaml

from gspn_framework_package.model.errors import InputError

Step = Union[str, int]
"""One step from an element to a child: a key or an index."""

MOST_ELEMENTS = 200_000
"""Largest number of elements in a text; those behind aliases count each time."""

_MERGE = "tag:yaml.org,2002:merge"  # the tag of the key <<


class YamlDocument:
    """A YAML text.

    :param text: one YAML document.
    :param file: the name for error messages.
    :raises InputError: it is not YAML, repeats a key in a mapping, or expands too far.
    """

    def __init__(self, text: str, file: Optional[str] = None) -> None:
        self.file = file
        try:
            loader = yaml.SafeLoader(text)
            self._root: Optional[yaml.Node] = loader.get_single_node()
            if self._root is None:
                raise InputError("there is nothing in it", file=file)
            self._check(loader)
            self.data: Any = loader.construct_document(self._root)
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            words = [word for word in (error.context, error.problem) if word]
            line = mark.line + 1 if mark is not None else None
            raise InputError("not YAML: %s" % ", ".join(words), file=file, line=line) from None
        except yaml.reader.ReaderError as error:
            line = text.count("\n", 0, error.position) + 1
            raise InputError(
                "not YAML: the character #x%04x" % error.character, file=file, line=line
            ) from None
        except RecursionError:
            raise InputError("it is nested too deeply", file=file) from None

    def _check(self, loader: yaml.SafeLoader) -> None:
        sizes: Dict[int, int] = {}
        open_: Set[int] = set()

        def size(node: yaml.Node) -> int:
            line = node.start_mark.line + 1
            if id(node) in open_:
                raise InputError("an alias that holds itself", file=self.file, line=line)
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
                        "not YAML: '%.40s' is not a value of its kind" % node.value,
                        file=self.file,
                        line=line,
                    ) from None
            if total > MOST_ELEMENTS:
                raise InputError(
                    "it has more than %d elements" % MOST_ELEMENTS, file=self.file, line=line
                )
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

    def line(self, path: Iterable[Step], key: Optional[str] = None) -> int:
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


def path_text(path: Iterable[Step]) -> str:
    """A path as text: ``locations.L1.bay[2]``."""
    text = ""
    for step in path:
        text += "[%d]" % step if isinstance(step, int) else ("." if text else "") + str(step)
    return text
