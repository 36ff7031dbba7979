"""Reading of YAML (and so of JSON) files, with the lines of their elements."""

from __future__ import annotations

from typing import Any, List, Sequence, Union

import yaml

from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.model.errors import InputError

_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class LocatedYaml:
    """A YAML file: its ``data``, made of plain Python objects.

    :raises InputError: the file cannot be read, or is not YAML.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self._root: Any = None
        try:
            loader = _Loader(read_bytes(path))
            try:
                self._root = loader.get_single_node()
                _refuse_doubles(self._root, path)
                self.data = None if self._root is None else loader.construct_document(self._root)
            finally:
                loader.dispose()
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            raise InputError(
                "it is not YAML: %s" % (error.problem or error.context),
                file=path,
                line=mark.line + 1 if mark else None,
            ) from None
        except (yaml.YAMLError, UnicodeDecodeError, ValueError) as error:
            raise InputError("it is not YAML: %s" % str(error).splitlines()[0], file=path) from None
        except RecursionError:
            raise InputError("it is nested too deeply", file=path) from None

    def line(self, steps: Sequence[Union[str, int]]) -> int:
        """Return the line of an element, given by keys and indices; of one that is not there, that
        of the innermost element around it."""
        node, line = self._root, 1
        for step in steps:
            if isinstance(node, yaml.MappingNode):
                found = [(k, v) for k, v in node.value if str(k.value) == str(step)]
                if not found:
                    break
                line, node = found[0][0].start_mark.line + 1, found[0][1]
            elif isinstance(node, yaml.SequenceNode) and isinstance(step, int):
                if not 0 <= step < len(node.value):
                    break
                node = node.value[step]
                line = node.start_mark.line + 1
            else:
                break
        return line

    def error(self, message: str, steps: Sequence[Union[str, int]], hint: str = "") -> InputError:
        """Return the error for an element, with file, line and element."""
        return InputError(
            message,
            file=self.path,
            line=self.line(steps),
            element=".".join(map(str, steps)) or None,
            hint=hint or None,
        )


def _refuse_doubles(root: Any, path: str) -> None:
    seen, front = set(), [root]
    while front:
        node = front.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        if isinstance(node, yaml.SequenceNode):
            front += node.value
        elif isinstance(node, yaml.MappingNode):
            keys: List[Any] = []
            for key, value in node.value:
                front.append(value)
                if isinstance(key, yaml.ScalarNode):
                    if key.value in keys and key.value != "<<":
                        raise InputError(
                            "the key '%s' occurs twice" % key.value,
                            file=path,
                            line=key.start_mark.line + 1,
                        )
                    keys.append(key.value)
