"""Functions of a plan that are written in the page: reading the source of one, checking it, and
putting it into its module's file. Nothing here imports or runs it; only a run does."""

from __future__ import annotations

import ast
import hashlib
import keyword
import os
import re
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

from gspn_framework_package.execution.actions import split_function
from gspn_framework_package.execution.function_source import imported_from
from gspn_framework_package.execution.plan_modules import is_installed
from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.model.errors import InputError, PlanError, RefusedError, UsageError
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.editing.atomic import write_all
from gspn_framework_package.visualizer.editing.palette import SOURCE_BYTES, described_function

LONGEST_FUNCTION = 20_000
"""Maximum number of characters of a function that is written in the page."""

_NAME = re.compile(r"(\w[\w .+-]*/)*([A-Za-z]\w*\.)+[A-Za-z]\w*", re.ASCII)
_LOADED_BY_OTHERS = ("conftest", "setup", "sitecustomize", "usercustomize")
"""Modules that other programs run when they find them in a folder."""


class FunctionSource(NamedTuple):
    """The source of a function.

    :ivar file: its file, relative to the folder of the plan.
    :ivar text: its source; "" if there is none yet.
    :ivar version: a hash of it as it is in the file; "" if there is none.
    """

    file: str
    text: str
    version: str


def is_source(value: object) -> bool:
    """Whether a value of JSON has the fields of a :class:`FunctionSource`."""
    fields = FunctionSource._fields
    return (
        isinstance(value, dict)
        and value.keys() == set(fields)
        and all(isinstance(value[key], str) for key in fields)
        and len(value["text"]) <= LONGEST_FUNCTION
    )


def read_function(place: str, name: object) -> FunctionSource:
    """Read a function of a plan.

    :param place: the folder of the plan.
    :param name: ``module.function``, as in an action.
    :raises GspnError: it is not such a name, its file is not in that folder, or something else has
        that name there.
    """
    file, function = _where(place, name)
    return _source(os.path.relpath(file, os.path.realpath(place)), _content(file), function)


def problem_of_function(name: object, text: object) -> Dict[str, Any]:
    """Check the source of a function, without running it.

    :returns: ``problem``: what is wrong with it, "" if nothing is; ``line``: its line, or null;
        ``parameters``: the settings that it takes.
    :raises UsageError: the name is not that of a function.
    """
    problem, line, node = _parsed(_function_in(name), text)
    parameters: List[Any] = []
    if node is not None:
        found = described_function(node, "", ast.Module([node], []))
        parameters = found["parameters"] if found is not None else []
    return {"problem": problem, "line": line, "parameters": parameters}


def write_function(
    folder: Folder, place: str, name: object, text: object, version: object
) -> FunctionSource:
    """Put a function into its file, whose other bytes stay as they are.

    :param folder: the served folder.
    :param place: the folder of the plan.
    :param version: that of the source that ``text`` replaces; "" for a new function.
    :raises GspnError: it cannot be written; in this case, nothing has changed.
    """
    file, function = _where(place, name)
    problem, line, node = _parsed(function, text)
    if node is None:
        raise InputError(problem, line=line)
    shown = os.path.relpath(file, os.path.realpath(place))
    old = _content(file)
    if _source(shown, old, function).version != version:
        raise RefusedError(
            "'%s' has changed since you opened it: nothing was written" % function,
            file=shown,
            hint="copy your text, and open the function again",
        )
    new = _put(old, function, str(text))
    if len(new) > SOURCE_BYTES:
        raise RefusedError("the file would be larger than %d bytes" % SOURCE_BYTES, file=shown)
    if not _differs_only_in(function, node, old, new):
        raise RefusedError(
            "the function cannot be put into it without changing the rest",
            file=shown,
            hint="edit it with a text editor",
        )
    write_all(folder, place, {file: new})
    return _source(shown, new, function)


def _function_in(name: object) -> str:
    """The function in ``module.function``. :raises UsageError: it is not such a name."""
    if isinstance(name, str) and len(name) <= 200 and _NAME.fullmatch(name):
        parts = split_function(name)[1].split(".")
        if not any(map(keyword.iskeyword, parts)):
            return parts[-1]
    raise UsageError(
        "that is not the name of a function",
        hint="module.function, of letters, digits and '_', such as actions.fetch",
    )


def _where(place: str, name: object) -> Tuple[str, str]:
    """The file of a function, and its name there."""
    function = _function_in(name)
    within, dotted = split_function(str(name))
    modules = dotted.split(".")[:-1]
    whole = os.path.join(os.path.realpath(place), within, *modules)
    file, shown = whole + ".py", os.path.join(within, *modules) + ".py"
    if os.path.realpath(file) != file:
        raise RefusedError("a link leads there: nothing is written", file=shown)
    there = os.path.lexists(file)
    if os.path.isdir(whole):
        raise RefusedError("there is a folder of this name", file=shown)
    if modules[-1] in _LOADED_BY_OTHERS or (not there and is_installed(modules[0])):
        raise RefusedError(
            "'%s' is a module of Python or of another program" % ".".join(modules),
            hint="choose another name for the module",
        )
    if not os.path.isdir(os.path.dirname(file)):
        raise InputError("there is no such folder beside the plan", file=os.path.dirname(shown))
    return file, function


def _content(file: str) -> bytes:
    try:
        return read_bytes(file, SOURCE_BYTES) if os.path.lexists(file) else b""
    except InputError as error:
        error.file = os.path.basename(file)
        raise


def _parsed(function: str, text: object) -> Tuple[str, Optional[int], Optional[ast.FunctionDef]]:
    """The error in the source of a function, with its line, or else its syntax node."""
    if not isinstance(text, str):
        raise UsageError("'text' is missing")
    if len(text) > LONGEST_FUNCTION:
        return "it is longer than %d characters" % LONGEST_FUNCTION, None, None
    try:
        text.encode()
        compile(text, "function", "exec", dont_inherit=True)
        tree = ast.parse(text)
        ast.dump(tree)
    except SyntaxError as error:
        return error.msg, error.lineno, None
    except ValueError:
        return "it has a character that no source may have", None, None
    except (RecursionError, MemoryError):
        return "it is nested too deeply", None, None
    here = [n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == function]
    others = [n for n in tree.body if n not in here] + here[1:]
    if others:
        line = others[0].lineno
        return "only 'def %s' is written here: imports go inside it" % function, line, None
    if not here:
        return "'def %s' is missing" % function, None, None
    return "", None, here[0]


def _tree(data: bytes) -> ast.Module:
    """The syntax tree of a file. :raises InputError: it has none."""
    try:
        tree = ast.parse(data)
        ast.dump(tree)
    except SyntaxError as error:
        raise InputError("the file is not valid: %s" % error.msg, line=error.lineno) from None
    except (ValueError, RecursionError, MemoryError):
        raise InputError("the file cannot be read as Python") from None
    return tree


def _lines_of(data: bytes, function: str) -> Optional[Tuple[int, int]]:
    """The lines of a function in a file, from 0, the last one excluded; None if nothing has its
    name."""
    tree = _tree(data)
    found = [node for node in tree.body if getattr(node, "name", "") == function]
    if not found:
        try:
            imported_from(tree, "", function)
        except PlanError:
            return None
    node = found[0] if len(found) == 1 else None
    if not isinstance(node, ast.FunctionDef):
        raise RefusedError("'%s' is, or may be, something else there already" % function)
    first = min([node.lineno, *(each.lineno for each in node.decorator_list)])
    assert node.end_lineno is not None
    return first - 1, node.end_lineno


def _source(shown: str, data: bytes, function: str) -> FunctionSource:
    try:
        lines = _lines_of(data, function)
        if lines is None:
            return FunctionSource(shown, "", "")
        part = b"".join(data.splitlines(keepends=True)[slice(*lines)])
        text = part.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError("it is not UTF-8 text", file=shown) from None
    except (InputError, RefusedError) as error:
        raise error.located(file=shown) from None
    return FunctionSource(shown, text, hashlib.sha256(part).hexdigest())


def _put(old: bytes, function: str, text: str) -> bytes:
    """The content of a file with the function in it."""
    ending = "\r\n" if b"\r\n" in old else "\n"
    source = text.replace("\r\n", "\n").replace("\r", "\n").strip("\n").rstrip() + "\n"
    new = source.replace("\n", ending).encode()
    lines = _lines_of(old, function)
    if lines is not None:
        all_lines = old.splitlines(keepends=True)
        return b"".join([*all_lines[: lines[0]], new, *all_lines[lines[1] :]])
    if not old:
        return new
    gap = ending.encode()
    return old + (b"" if old.endswith((b"\n", b"\r")) else gap) + 2 * gap + new


def _differs_only_in(function: str, node: ast.FunctionDef, old: bytes, new: bytes) -> bool:
    """Whether the new content means what the old one does, with the function as in ``node``."""
    body = _tree(old).body
    wanted = [ast.dump(each) for each in body]
    at = [n for n, each in enumerate(body) if getattr(each, "name", "") == function]
    wanted[slice(at[0], at[0] + 1) if at else slice(len(wanted), None)] = [ast.dump(node)]
    return [ast.dump(each) for each in _tree(new).body] == wanted
