"""Inspects the source of a plan's function without running it: whether the function exists and can
take its settings."""

from __future__ import annotations

import ast
import inspect
from typing import Any, Dict, List, Mapping, Optional, Tuple, Type

from gspn_framework_package.execution.actions import PythonFunction, split_function
from gspn_framework_package.execution.plan_modules import (
    is_installed,
    module_file,
    refuse_other_module,
)
from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.model.errors import InputError, PlanError


def why_not_callable(
    folder: Optional[str], name: str, settings: Mapping[str, Any], kind: Type[PythonFunction]
) -> str:
    """Why the function ``module.function`` of a plan cannot be called with its settings; "" if
    nothing is wrong or the source does not show it.

    :param folder: the plan's folder.
    :param kind: what the function is for.
    """
    within, name = split_function(name)
    module, _, function = name.rpartition(".")
    try:
        file = module_file(folder, within, module)
        if file is None:
            if not is_installed(module):
                return "there is no %s.py beside the plan, and no such module" % module.replace(
                    ".", "/"
                )
            refuse_other_module(module)
            return ""
        tree = ast.parse(read_bytes(file), file)
        imported = imported_from(tree, file, function)
        if imported and module_file(folder, within, imported) is None:
            refuse_other_module(imported)
    except PlanError as error:
        return "%s (%s)" % (error.message, error.hint) if error.hint else error.message
    except (InputError, SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = ", line %s" % error.lineno if isinstance(error, SyntaxError) and error.lineno else ""
        return "%s%s: cannot be read: %s" % (file, line, getattr(error, "msg", None) or error)
    parameters = _parameters(tree, function)
    if parameters is not None:
        try:
            called = _method_to_call(tree, function)
            kind.asked_of(parameters, "", settings)
            if called is not None:
                kind.asked_of(called, "")
        except PlanError as error:
            return error.message
    return ""


def imported_from(tree: ast.Module, file: str, function: str) -> str:
    """The module that a name of a module is imported from; "" if it is not imported, or if the
    source does not show it.

    :raises PlanError: the module has no such name.
    """
    defined = set()
    imported: Dict[str, str] = {}
    waiting: List[ast.AST] = list(tree.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            defined.add(node.name)  # names inside it do not belong to the module
        elif isinstance(node, ast.ImportFrom):
            imported.update({alias.asname or alias.name: node.module or "" for alias in node.names})
        elif isinstance(node, ast.Import):
            defined |= {alias.asname or alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            defined.add(node.id)
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in (
            "globals",
            "setattr",
            "exec",
        ):
            return ""
        else:
            waiting += ast.iter_child_nodes(node)
    if function in defined or "*" in imported or "__getattr__" in defined:
        return ""
    if function not in imported:
        raise PlanError("there is no '%s' in %s" % (function, file))
    return imported[function]


def _parameters(tree: ast.Module, name: str) -> Optional[List[inspect.Parameter]]:
    """The parameters of a function of a module, or of ``__init__`` of a class; None if the source
    does not show them for certain."""
    found = [node for node in tree.body if getattr(node, "name", "") == name]
    if len(found) != 1:
        return None
    (node,) = found
    if isinstance(node, ast.ClassDef):
        if node.decorator_list or node.keywords or not _bases_are_here(node, tree):
            return None
        begin = method_of(node, "__init__", tree)
        return [] if begin is None else _listed(begin, bound=True)
    if not isinstance(node, ast.FunctionDef) or not all(map(_is_ours, node.decorator_list)):
        return None
    return _listed(node, bound=False)


def _method_to_call(tree: ast.Module, name: str) -> Optional[List[inspect.Parameter]]:
    """The parameters of ``__call__`` of a class that :func:`_parameters` knows; None for a
    function, or if the source does not show them for certain.

    :raises PlanError: the class has no such method.
    """
    (node,) = (node for node in tree.body if getattr(node, "name", "") == name)
    if not isinstance(node, ast.ClassDef):
        return None
    call = method_of(node, "__call__", tree)
    if call is not None:
        return _listed(call, bound=True)
    if not node.bases and "__call__" not in ast.dump(node):
        raise PlanError("the class has no method __call__")
    return None


def _is_ours(decorator: ast.expr) -> bool:
    return isinstance(decorator, ast.Name) and decorator.id == "action"


def _bases_are_here(node: ast.ClassDef, tree: ast.Module, deep: int = 0) -> bool:
    """Whether all bases of a class are defined in the same file."""
    for base in node.bases:
        if isinstance(base, ast.Name) and base.id == "object":
            continue
        inside = [
            other
            for other in tree.body
            if isinstance(other, ast.ClassDef) and other.name == getattr(base, "id", "")
        ]
        if len(inside) != 1 or deep > 8 or not _bases_are_here(inside[0], tree, deep + 1):
            return False
    return True


def method_of(
    node: ast.ClassDef, name: str, tree: ast.Module, deep: int = 0
) -> Optional[ast.FunctionDef]:
    """A method of a class, or of one of its bases in the same file."""
    for inside in node.body:
        if isinstance(inside, ast.FunctionDef) and inside.name == name:
            return inside
    bases = [base.id for base in node.bases if isinstance(base, ast.Name)]
    for other in tree.body:
        if isinstance(other, ast.ClassDef) and other.name in bases and deep < 8:
            found = method_of(other, name, tree, deep + 1)
            if found is not None:
                return found
    return None


def _listed(function: ast.FunctionDef, bound: bool) -> List[inspect.Parameter]:
    """The parameters of a function, without the first one if it is ``bound``. A default that is not
    a literal is represented by an ``object``."""
    if function.decorator_list and bound:
        return [inspect.Parameter("more", inspect.Parameter.VAR_KEYWORD)]
    arguments, kinds = function.args, inspect.Parameter
    only = getattr(arguments, "posonlyargs", [])
    listed: List[Tuple[ast.arg, Any]] = [(a, kinds.POSITIONAL_ONLY) for a in only]
    listed += [(a, kinds.POSITIONAL_OR_KEYWORD) for a in arguments.args]
    missing: List[Optional[ast.expr]] = [None] * (len(listed) - len(arguments.defaults))
    pairs: List[Tuple[Any, Optional[ast.expr]]] = list(
        zip(listed, [*missing, *arguments.defaults])
    )[int(bound) :]
    pairs += [
        ((a, kinds.KEYWORD_ONLY), default)
        for a, default in zip(arguments.kwonlyargs, arguments.kw_defaults)
    ]
    found = [
        kinds(argument.arg, kind, default=_value(default), annotation=_annotation(argument))
        for (argument, kind), default in pairs
    ]
    if arguments.kwarg is not None:
        found.append(kinds(arguments.kwarg.arg, kinds.VAR_KEYWORD))
    return found


def _annotation(argument: ast.arg) -> Any:
    found = argument.annotation
    if isinstance(found, ast.Name):
        return found.id
    return inspect.Parameter.empty if found is None else "?"


def _value(default: Optional[ast.expr]) -> Any:
    if default is None:
        return inspect.Parameter.empty
    try:
        return ast.literal_eval(default)
    except (ValueError, TypeError, SyntaxError, RecursionError):
        return object()
